/* nhp: Neural Human Performer of one picture (Kwon et al., NeurIPS 2021), a rival of SHERF: a volume painted
 * by the observed body and pixel-aligned features, a field in the space of the observed pose
 * (docs/rivals.md). */
#ifndef SHERF_MODEL_NHP_H
#define SHERF_MODEL_NHP_H

#include "model/model.h"
#include "model/sparse_levels.h"
#include "nn/resnet.h"

enum { NHP_STAGES = 3, NHP_LEVELS = 4, NHP_CONVOLUTIONS = 3 };

/* Settings; the paper's in brackets. */
typedef struct {
    int encoder_width; /* channels of the ResNet-18's stem; the map has four times as many [64] */
    int width;         /* of the field's network [256] */
    int volume_channels[NHP_LEVELS]; /* of levels 1 to 4; level 0 has as many as level 1 [64 64 128 128] */
    float voxel_size_m;              /* [0.005] */
    int own;                         /* 1: trained as its authors do, in the whole box; 0: as SHERF is [1] */
} nhp_settings;
static inline const nhp_settings *nhp_settings_of(const model_config *config) {
    return (const nhp_settings *)config->own.bytes;
}

/* What the body and the camera determine: observation_geometry.own. */
typedef struct {
    int32_t *visible;      /* V: not hidden from the camera by the body */
    float *vertex_px;      /* V x 2 */
    int32_t *vertex_voxel; /* V: row of level 0 */
    float min_smpl[3];     /* of the volume, in the space of the pose */
    sparse_level level[NHP_LEVELS + 1];
} nhp_geometry;
sherf_status nhp_observe(context *c, const model_config *config, const body_model *body, bool training,
                         observation_geometry *g);
void nhp_observed_free(void *own);
/* Replaces level l's rows by those of these voxels [voxels], which come from an avatar's file. */
sherf_status nhp_level_is(context *c, nhp_geometry *g, int l, int64_t voxels, const int32_t *voxel);
/* Samples the levels, [P, sum of channels], at points [P, 3] of the observation's world. */
tensor *nhp_volume_at(tape *t, const nhp_settings *k, const observation_geometry *g,
                      tensor *const level[NHP_LEVELS], const float *points_world, int64_t count);

typedef struct {
    linear_layer project;
    sparse_layer conv[NHP_LEVELS + 1][NHP_CONVOLUTIONS], down[NHP_LEVELS];
} nhp_volume;
void nhp_volume_declare(declaration *d, const nhp_settings *k, nhp_volume *v);
/* Paints the map's features into the volume at the observed body and runs the levels. */
void nhp_volume_encode(tape *t, const nhp_volume *v, const observation_geometry *g, tensor *map,
                       tensor *level[NHP_LEVELS]);

typedef struct {
    resnet encoder;
    nhp_volume volume;
    linear_layer from_volume, from_pixel;   /* h and q */
    linear_layer volume_value, pixel_value; /* their attention values: with one view the weight is 1 */
    linear_layer hidden, geometry, density[2];
    linear_layer color_geometry, color_pixel, view, view_pixel, last, color;
} nhp_network;

#endif
