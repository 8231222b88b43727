/* field: what answers points of an encoded observation, for one context: packed for its processor, or in its
 * GPU's memory. */
#ifndef SHERF_FIELD_H
#define SHERF_FIELD_H

#include "model/model.h"
#include "scene/solid.h"

/* What a field is made of, an avatar's: all that is pointed to outlives it and is not changed. */
typedef struct {
    const model_config *config;
    const parameters *weights; /* what queries read, in the host's memory */
    const kept_bank *kept;
    const observed_sheet *sheet; /* of the pictures */
    int pictures;
    const observed_picture *picture;
} field_source;

typedef struct field_kind {
    sherf_status (*create)(context *c, const field_source *from, const body_model *body, void **out);
    void (*release)(void *field); /* NULL is fine */
    /* On any thread, several at once: rgb [P, 3] and raw density [P], and a frame as tiles_render. */
    sherf_status (*run)(context *c, void *field, const body_model *body, const point_set *points, float *rgb,
                        float *sigma);
    sherf_status (*render)(context *c, void *field, const body_model *body, const ray_bundle *rays,
                           const point_set *points, const float background[3], bool early_stop,
                           sherf_frame *frame);
    /* Frames made whole from a pose's joints, on a GPU; all NULL: never. */
    bool (*takes_joints)(const void *field);
    size_t (*device_bytes)(const void *field); /* of the GPU's memory, so far */
    sherf_status (*render_joints)(context *c, void *field, const posed_body *posed,
                                  const sherf_camera *camera, const gpu_frame_options *options,
                                  sherf_frame *frame);
    /* The triangles that frames are drawn from, in the observed world. Then render gets no points, and there
     * is no run. NULL: frames are made of points. */
    solid_mesh (*surface)(const void *field);
} field_kind;

extern const field_kind field_of_ops; /* any model's: its `query`, op by op (field.c) */

#endif
