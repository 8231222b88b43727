/* gltf: a person as binary glTF 2.0: mesh, skin with 24 joints, texture or vertex colours, animation. */
#ifndef SHERF_EXPORT_GLTF_H
#define SHERF_EXPORT_GLTF_H

#include "body/body.h"

/* The mesh for drawing: a position, a normal and texture coordinates for each vertex. */
typedef struct {
    int64_t vertices, triangles;
    const float *position; /* V x 3, the rest pose (T) of the person's shape, y up, metres */
    const float *normal;   /* V x 3, unit */
    const float *uv;       /* V x 2, v down from the picture's upper edge; NULL: vertex colours */
    const float *rgb;      /* V x 3, as in pictures (sRGB); used if uv is NULL */
    const uint8_t *joint;  /* V x 4 */
    const float *weight;   /* V x 4 */
    const uint32_t *triangle;
    const unsigned char *png; /* of the texture */
    size_t png_bytes;
    const int *parent;             /* 24 */
    const float (*joints_rest)[3]; /* 24, of the person's shape */
    const sherf_pose *pose;        /* of the nodes without animation; NULL: the rest pose */
    int frames;                    /* of the animation; 0: none */
    double fps;
    const sherf_pose *clip; /* frames */
    bool lit;               /* light affects the material; otherwise it shows its colours as they are */
} gltf_person;
sherf_status gltf_write(context *c, const char *path, const gltf_person *g);

#endif
