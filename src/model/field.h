/* field: answers queries at points of an encoded observation, for one context: packed for its processor, or
 * in its GPU's memory. */
#ifndef SHERF_FIELD_H
#define SHERF_FIELD_H

#include "model/model.h"
#include "scene/solid.h"

/* What a field is made of, taken from an avatar. All that it points to outlives the field and does not
 * change. */
typedef struct {
    const model_config *config;
    const parameters *weights; /* arrays that queries read, in the host's memory */
    const kept_bank *kept;
    const observed_sheet *sheet; /* of the pictures */
    int pictures;
    const observed_picture *picture;
} field_source;

typedef struct field_kind {
    sherf_status (*create)(context *c, const field_source *from, const body_model *body, void **out);
    void (*release)(void *field); /* NULL is fine */
    /* May be called on any thread, several at once: query points for rgb [P, 3] and raw density [P]; render a
     * frame as tiles_render does. */
    sherf_status (*run)(context *c, void *field, const body_model *body, const point_set *points, float *rgb,
                        float *sigma);
    sherf_status (*render)(context *c, void *field, const body_model *body, const ray_bundle *rays,
                           const point_set *points, const float background[3], bool early_stop,
                           sherf_frame *frame);
    /* Whole frames from a pose's joints, on a GPU; all NULL: not supported. */
    bool (*takes_joints)(const void *field);
    size_t (*device_bytes)(const void *field); /* bytes of the GPU's memory used so far */
    sherf_status (*render_joints)(context *c, void *field, const posed_body *posed,
                                  const sherf_camera *camera, const gpu_frame_options *options,
                                  sherf_frame *frame);
    /* The triangles that frames are drawn from, in the observed world. With it render gets no points, and
     * there is no run. NULL: frames are made from points. */
    solid_mesh (*surface)(const void *field);
} field_kind;

extern const field_kind field_of_ops; /* any model's: its `query`, op by op (field.c) */

#endif
