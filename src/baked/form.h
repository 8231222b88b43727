/* form: a baked avatar, which is drawn without its network: a skinned surface with a texture, in the rest
 * pose of the person's shape. It is a sherf_avatar whose form this is (avatar/avatar.h). */
#ifndef SHERF_BAKED_FORM_H
#define SHERF_BAKED_FORM_H

#include "avatar/avatar.h"
#include "io/safetensors.h"

enum { BAKED_RESOLUTION = 256, BAKED_TRIANGLES = 40000, BAKED_TEXTURE = 1024 }; /* unless said otherwise */
#define BAKED_ISLANDS 0.02 /* as islands of baked_options */
enum { BAKED_LEVELS = 4, BAKED_CORNERS_MAX = 1 << 22, BAKED_SIDE_MIN = 64, BAKED_SIDE_MAX = 4096 };

/* Owned. */
typedef struct {
    int64_t corners, triangles;
    float *rest;    /* C x 3, metres: the surface in the rest pose */
    float *uv;      /* C x 2, in texels from the middle of the upper left one */
    uint8_t *joint; /* C x 4 */
    float *weight;  /* C x 4, sum 1 */
    /* How far the body keeps its volume at bent joints (body.h, pose_volume), or NULL. Each of four joints
     * moves a corner's rest place by -(F + F^T) / 2 times fold, where F is the joint's rotation less the
     * identity. */
    uint8_t *fold_joint; /* C x 4 */
    float *fold;         /* C x 4 x 3, metres */
    uint32_t *triangle;  /* T x 3 corners, counter-clockwise seen from outside */
    int side_px;
    uint8_t *texture[BAKED_LEVELS]; /* side x side x 3; each level has half the side of the one before */
    uint8_t *png;                   /* of the texture, as files have it */
    size_t png_bytes;
} baked_form;
void baked_form_free(baked_form *f); /* frees f itself, too */
/* The coarser levels from the first. */
sherf_status baked_levels_make(context *c, baked_form *f);

/* ---- draw.c ---- */
/* A frame of the body in a pose. Deterministic, whatever the number of threads. */
sherf_status baked_draw(context *c, const baked_form *f, const body_model *body, const sherf_pose *pose,
                        const sherf_camera *camera, const float background[3], sherf_frame *frame);
/* Where the corners are in the pose's world, C x 3, metres. */
sherf_status baked_places(context *c, const baked_form *f, const body_model *body, const sherf_pose *pose,
                          float *world);

/* ---- soften.c ---- */
typedef struct {
    int left, right, top, bottom; /* the rectangle of the picture to soften, in pixels */
    float radius_px;              /* of the tent filter */
    const float *background;
} baked_soft;
/* Makes opacity rise over twice the radius at silhouettes; with a radius of less than a pixel, over
 * 1 / (2 - radius) pixels, and two thirds of one at least. Over a background, colours follow. */
sherf_status baked_soften(context *c, const baked_soft *s, sherf_frame *frame);

extern const avatar_form baked_avatar_form;

/* ---- form_save.c, form_read.c ---- */
#define BAKED_FORMAT "sherf-baked-avatar"
enum {
    BAKED_NUMBERS = OBSERVED_NUMBERS + 2 /* the picture's size */
};                                       /* of the observation */
sherf_status baked_save(context *c, const sherf_avatar *a, const char *path);
/* Makes a baked avatar from its file's tensors; every size and index is checked. */
sherf_status baked_read(context *c, const safetensors *s, const body_model *body, sherf_avatar **out);

#endif
