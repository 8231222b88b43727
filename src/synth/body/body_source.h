/* body_source: what the builder of the open body needs to know, whoever has it. MakeHuman's data is one
 * (body_makehuman.c); a newer or another mesh with its own rig and shapes can be the next. */
#ifndef SHERF_BODY_SOURCE_H
#define SHERF_BODY_SOURCE_H

#include "body/body.h"

enum { SOURCE_PARAMETERS_MAX = 16 };

typedef struct body_source {
    const char *name, *version, *licence; /* for the file's metadata */
    uint64_t fingerprint;                 /* of the source's files */
    int vertices, triangles, uvs;
    const uint32_t *triangle, *triangle_uv; /* T x 3 each */
    const float *uv;                        /* uvs x 2, v upwards */
    const float *weights;                   /* V x 24, each sums to 1 */
    int parameters;
    const char *parameter[SOURCE_PARAMETERS_MAX]; /* names of what a sample is drawn by */
    const void *arg;
    /* Adult number `key`'s mesh in SMPL's rest pose (V x 3, metres, the pelvis in one place for all), where
     * the 24 joints are in it, and its parameters. Called from several threads at once. */
    sherf_status (*sample)(context *c, const void *arg, uint64_t key, float *vertices,
                           double joints[BODY_JOINTS][3], double *parameter);
} body_source;

#endif
