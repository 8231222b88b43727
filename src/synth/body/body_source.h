/* body_source: what the open body's builder needs from any source. MakeHuman's data is one
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
    const char *parameter[SOURCE_PARAMETERS_MAX]; /* names of a sample's parameters */
    const void *arg;
    /* Mesh of adult number `key` in SMPL's rest pose (V x 3, metres, the pelvis always in the same place),
     * the positions of the 24 joints in it, and its parameters. Called from several threads at once. */
    sherf_status (*sample)(context *c, const void *arg, uint64_t key, float *vertices,
                           double joints[BODY_JOINTS][3], double *parameter);
} body_source;

#endif
