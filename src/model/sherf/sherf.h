/* sherf: the paper's model (Hu, Hong et al., ICCV 2023), one file per stage. Hierarchical features (section
 * 3.3): global (global.c), point-level (point.c, with visible vertices and voxels in geometry.c),
 * pixel-aligned (pixel.c). Section 3.4: the feature fusion transformer (fusion.c) and the NeRF decoder
 * (decoder.c). model.c joins them. docs/network.md has a table of the paper's terms. */
#ifndef SHERF_MODEL_SHERF_H
#define SHERF_MODEL_SHERF_H

#include "model/model.h"
#include "model/sherf/fused/radiance_field.h"
#include "model/sparse_levels.h"
#include "nn/resnet.h"

/* ---- config.c: settings; the paper's in brackets ---- */
enum { POINT_LEVELS_MAX = 4 };
typedef struct {
    int encoder_width;    /* first width of the global ResNet-18 [64]; its latent has 8 times this */
    int feature_width;    /* channels of the feature map [64] */
    int style_width;      /* width of the mapping and its style [512] */
    int mapping_layers;   /* [2] */
    int plane_resolution; /* [256] */
    int channel_base;     /* generator channels: min(channel_max, channel_base / resolution) [32768] */
    int channel_max;      /* [512] */
    int point_levels;     /* of the sparse volume that points read [3] */
    int volume_channels[POINT_LEVELS_MAX];                              /* of each [32 64 96] */
    int token_width;                                                    /* [32] */
    int heads, head_width;                                              /* [3 16] */
    int decoder_width, decoder_depth, decoder_skip, view_width;         /* [128 8 4 64] */
    int position_frequencies, direction_frequencies, color_frequencies; /* of the encodings [6 4 5] */
    float voxel_size_m;                                                 /* [0.005] */
    /* Variants of the paper's ablation; features that are off have no parameters. */
    int use_global, use_point, use_pixel; /* features [1] */
    int fusion;                           /* a fusion_kind [FUSION_TRANSFORMER] */
} sherf_settings;
/* Without the transformer: how the decoder reads the three projected tokens. */
typedef enum {
    FUSION_TRANSFORMER,
    FUSION_NONE, /* density reads token 0, colour token 1: the release's switch, which drops token 2 */
    FUSION_FAIR, /* a linear layer of all three tokens, whose result density and colour read */
    /* Without the projection: the global token is the style of the other two; then a linear layer as in
     * FUSION_FAIR. */
    FUSION_ADAIN, /* scale and shift of their normalised mixture */
    FUSION_SIREN, /* frequency and phase of two layers of sines, 15 f + 30 */
    FUSION_FILM,  /* the same with f + 1 */
    FUSIONS
} fusion_kind;
const sherf_settings *model_sherf_settings(const model_config *config);
extern const model_preset model_sherf_presets[];
extern const model_setting model_sherf_setting_list[];
void model_sherf_defaults(model_config *out);
sherf_status model_sherf_check(context *c, const model_config *config);
sherf_status model_sherf_infer(context *c, const safetensors *s, model_config *out);
/* Whether the fused network supports these settings; otherwise points go op by op. */
bool model_sherf_is_fused(const model_config *config);
void model_sherf_sizes(const model_config *config, radiance_sizes *out);
/* Multiply-adds per point, without the parts that are computed once per avatar (docs/speed.md). */
double model_sherf_point_products(const model_config *config);

/* ---- geometry.c: the inputs of the point-level features, determined by body and camera ---- */
typedef struct {
    int32_t *visible; /* V */
    float *vertex_px; /* V x 2 */
    /* the sparse volume */
    float volume_min[3]; /* canonical box without the extra z */
    float voxel_size_m;
    int levels;            /* that points read */
    int volume_size[3];    /* z y x */
    int32_t *vertex_zyx;   /* V x 3, voxel of each vertex */
    int32_t *vertex_voxel; /* V: row of the active voxel list of level 0 */
    /* 0: full resolution, then those read by points, and in training one more */
    sparse_level level[POINT_LEVELS_MAX + 2];
} sherf_geometry;
sherf_geometry *model_sherf_geometry(const observation_geometry *g);
sherf_status model_sherf_observe(context *c, const model_config *config, const body_model *body,
                                 bool training, observation_geometry *g);
/* Replaces g->own, with the vertices' voxels given, V x 3, unless that is NULL. For tests. */
sherf_status model_sherf_observe_at(context *c, const model_config *config, const body_model *body,
                                    bool training, const int32_t *voxels, observation_geometry *g);
void model_sherf_geometry_free(void *geometry);
/* Full-resolution size of the sparse volume, z y x: ceil(extent / voxel) | 31, plus 1. */
sherf_status model_sherf_volume_size(context *c, const model_config *config, const body_model *body,
                                     int size_zyx[3]);

/* ---- the bank ---- */
enum {
    BANK_PLANE = 0,
    BANK_FEATURES = 3,
    BANK_IMAGE = 4,
    BANK_LEVEL = 5 /* point_levels of them */
};
typedef struct {    /* model_bank.own; planes [R, R, D], features [H/2, W/2, F], levels [voxels, channels] */
    tensor *latent; /* [L] of the global feature */
    tensor *style;  /* [style_width] */
    struct fused_bank *fused; /* points_fused.c; NULL until the first frame makes it */
} sherf_bank;

/* ---- the stages: each declares its parameters and goes forwards ---- */
/* global.c: the tri-plane features of a ResNet-18's latent. */
enum { GLOBAL_LAYERS = 16, GLOBAL_BLOCKS = 9 };
typedef struct {
    linear_layer affine; /* of the style */
    tensor *w, *b;
} modulated_layer;
typedef struct {
    resnet encoder;
    int mapping_layers, blocks;
    float style_width;
    linear_layer mapping[GLOBAL_LAYERS];
    tensor *constant; /* [4, 4, C] */
    struct {
        modulated_layer conv0, conv1, planes; /* conv0: not in the first */
    } block[GLOBAL_BLOCKS];                   /* 4 x 4, 8 x 8, ... */
} global_stage;
typedef struct { /* for the parity tests; NULL in normal use */
    tensor *block_x[16], *block_image[16];
    int blocks;
} model_stages;
void global_declare(declaration *d, const sherf_settings *k, global_stage *s);
tensor *global_latent(tape *t, const global_stage *s, tensor *image); /* [H, W, 3] -> [L] */
tensor *global_style(tape *t, const global_stage *s, tensor *latent); /* [L] -> [style_width] */
tensor *global_planes(tape *t, const global_stage *s, tensor *style, model_stages *stages); /* [R, R, 3 D] */
/* [P, D] of plane 0..2 at canonical points. */
void global_sample(tape *t, const body_model *body, const model_bank *bank, const float *points_canonical,
                   int64_t count, tensor *out[3]);

/* pixel.c: the pixel-aligned features. */
typedef struct {
    resnet encoder;
    int frequencies, color_width; /* of a colour's encoding */
} pixel_stage;
void pixel_declare(declaration *d, const sherf_settings *k, pixel_stage *s);
tensor *pixel_features(tape *t, const pixel_stage *s, tensor *image); /* [H, W, 3] -> [H/2, W/2, F] */
/* 96 values of each position: feature map and colour encoding. position_px [P, 2]. */
tensor *pixel_sample(tape *t, const pixel_stage *s, const model_bank *bank, const float *position_px,
                     int64_t count);

/* point.c: the point-level features. */
enum { POINT_CONVOLUTIONS = 3 };
typedef struct {
    linear_layer projection;
    int levels;
    sparse_layer conv[POINT_LEVELS_MAX + 1][POINT_CONVOLUTIONS], down[POINT_LEVELS_MAX + 1];
} point_stage;
void point_declare(declaration *d, const sherf_settings *k, point_stage *s);
/* Computes the bank's levels; features and image must be there. */
sherf_status point_encode(tape *t, const point_stage *s, const pixel_stage *pixel,
                          const observation_geometry *g, model_bank *bank);
/* [P, sum of channels] at canonical points. */
tensor *point_sample(tape *t, const observation_geometry *g, const model_bank *bank,
                     const float *points_canonical, int64_t count);

/* fusion.c: the feature fusion transformer. */
typedef struct {
    int token_width, heads, head_width, parts; /* parts: features that are on */
    fusion_kind kind;
    linear_layer point_projection, token_projection, out, mlp[2],
        fair;                                /* token_projection: of two parts or three */
    linear_layer content, style[2], sine[2]; /* AdaIN: style is scale and shift; SIREN: the mapping */
    layer_norm norm[2];
    tensor *qkv;
} fusion_stage;
void fusion_declare(declaration *d, const sherf_settings *k, fusion_stage *s);
/* [P, 3 D]: the three tokens side by side; [P, 2 D] from FUSION_FAIR on. Features that are off are NULL, and
 * so is plane[0] then. */
tensor *fusion_forward(tape *t, const fusion_stage *s, tensor *const plane[3], tensor *pixel, tensor *volume);

/* decoder.c: the NeRF decoder. */
typedef struct {
    int token_width, depth, skip, position_frequencies, direction_frequencies;
    linear_layer pts[POINT_DECODER_MAX], views, feature, alpha, rgb;
} decoder_stage;
void decoder_declare(declaration *d, const sherf_settings *k, decoder_stage *s);
void decoder_forward(tape *t, const decoder_stage *s, tensor *tokens, const float *points_canonical,
                     const float *directions_canonical, int64_t count, tensor **sigma, tensor **rgb);

/* ---- model.c: the stages together ---- */
typedef struct {
    global_stage global;
    point_stage point;
    pixel_stage pixel;
    fusion_stage fusion;
    decoder_stage decoder;
} sherf_network;
static inline const sherf_network *model_sherf_network(const model *m) {
    return m->network;
}
sherf_status model_sherf_encode(tape *t, const model *m, const body_model *body,
                                const observation_geometry *g, model_bank *bank, model_stages *stages);
typedef struct {
    tensor *plane[3], *volume, *fusion, *sigma, *rgb;
} point_outputs;
sherf_status model_sherf_points(tape *t, const model *m, const body_model *body,
                                const observation_geometry *g, const model_bank *bank,
                                const point_set *points, int64_t begin, int64_t end, point_outputs *out);
/* weights.c: the weights that the fused network reads. */
void model_sherf_weights(const parameters *weights, const model_config *config, radiance_weights *out);

/* points_fused.c: training through the fused network (fused/train.h). */
extern const model_fused_training model_sherf_fused_training;
/* fused/field.c: frames through the fused network. */
extern const struct field_kind model_sherf_field;

#endif
