/* radiance_field: the per-point network (network.md 2 to 6), fused: tiles of points stay in cache from
 * sampling through fusion and decoder. It equals the op-by-op path (model/) within: float32 3e-4 of each
 * stage's largest value, bf16 45 dB of the picture. Linear layers before fusion are applied once per avatar
 * to planes, volumes and map instead of per point. */
#ifndef SHERF_RADIANCE_FIELD_H
#define SHERF_RADIANCE_FIELD_H

#include "sampling/sampling.h"
#include "tensor/tensor.h"

#ifdef __cplusplus /* CUDA's sources */
extern "C" {
#endif

enum { POINT_LEVELS = 3, POINT_TOKENS = 3, POINT_DECODER_MAX = 16 };

/* The layers after sampling, except the decoder's first ones, which are an array `pts`: LAYER(with, name).
 * color: the token projection of encoded colours; views: merged with the feature layer. */
#define RADIANCE_LAYERS(LAYER, with)                                                                         \
    LAYER(with, color)                                                                                       \
    LAYER(with, qkv)                                                                                         \
    LAYER(with, attention_out)                                                                               \
    LAYER(with, mlp0) LAYER(with, mlp1) LAYER(with, alpha) LAYER(with, views) LAYER(with, rgb)
#define RADIANCE_MEMBER(type, name) type name;
/* Members of a struct: one of `type` for each layer. */
#define RADIANCE_MEMBERS(type) RADIANCE_LAYERS(RADIANCE_MEMBER, type) type pts[POINT_DECODER_MAX];

/* Sizes; the paper's in brackets. All but the token width may differ in other presets. */
typedef struct {
    int token_width;                   /* D [32]; also the channels of a plane */
    int feature_channels;              /* of the feature map [64]; feature_channels + 32 = 3 D */
    int volume_channels[POINT_LEVELS]; /* [32 64 96]; their sum is projected to 3 D */
    int heads, head_width;             /* [3, 16] */
    int decoder_width;                 /* [128] */
    int decoder_depth;                 /* [8] */
    int decoder_skip;                  /* x is concatenated after this layer, counted from 0 [4] */
    int view_width;                    /* [64] */
    int position_frequencies, direction_frequencies, color_frequencies; /* [6 4 5] */
} radiance_sizes;

/* float32 weights [out, in] and biases, named as in the checkpoints; owned by somebody else. */
typedef struct {
    const float *volume_projection_w,
        *volume_projection_b; /* renderer.conv1d_projection [3D, sum volume_channels] */
    const float *token_projection_w, *token_projection_b; /* renderer.conv1d_reprojection [D, 3D] */
    const float *norm0_w, *norm0_b;                       /* renderer.transformer.layers.0.0.fn.norm */
    const float *qkv_w;                             /* ...0.0.fn.fn.to_qkv [3*heads*head_width, D], no bias */
    const float *attention_out_w, *attention_out_b; /* ...0.0.fn.fn.to_out.0 [D, heads*head_width] */
    const float *norm1_w, *norm1_b;                 /* ...0.1.fn.norm */
    const float *mlp0_w, *mlp0_b, *mlp1_w, *mlp1_b; /* ...0.1.fn.fn.net.0, net.3 [D, D] */
    const float *pts_w[POINT_DECODER_MAX],
        *pts_b[POINT_DECODER_MAX];  /* decoder.pts_linears.N; input 0: PE(position) 39 + token 0; after skip:
                                       x, h */
    const float *alpha_w, *alpha_b; /* decoder.alpha_linear [1, width] */
    const float *feature_w, *feature_b; /* decoder.feature_linear [width, width] */
    const float *views_w, *views_b;     /* decoder.views_linear [view_width, width + 27 + D] */
    const float *rgb_w, *rgb_b;         /* decoder.rgb_linear [3, view_width] */
} radiance_weights;

/* The arrays to sample after the linear layers before fusion have been applied, without their biases: planes
 * and map through the token projection's columns for them, levels through volume and token projection.
 * float32. */
typedef struct {
    const float *plane[3];            /* [plane_size, plane_size, D] */
    const float *map;                 /* [feature_height, feature_width, feature_channels], a multiple of D */
    const float *level[POINT_LEVELS]; /* [voxels, 3 D] */
} radiance_merged;

/* The feature bank of one avatar, float32, channels last; owned by somebody else. */
typedef struct {
    const radiance_merged *merged; /* instead of planes, features and level[].value; or NULL */
    int plane_size;
    const float *planes;              /* [3, plane_size, plane_size, D] */
    float plane_min[3], plane_max[3]; /* canonical box with the extra z: to [-1, 1] */
    int feature_width, feature_height;
    const float *features; /* [feature_height, feature_width, feature_channels] */
    int image_width, image_height;
    const float *image;  /* [image_height, image_width, 3], black outside the mask */
    float volume_min[3]; /* canonical box without the extra z */
    float voxel_size_m;  /* 0.005 */
    int volume_size[3];  /* full resolution, z y x */
    struct {
        int64_t voxels;
        const float *value;  /* [voxels, volume_channels[level]] */
        const int32_t *grid; /* [size z, y, x]: row of value, or -1 */
        int size[3];         /* of this level, z y x */
    } level[POINT_LEVELS];
} radiance_bank;

typedef struct radiance_field radiance_field;
/* Packs the weights and applies the linear layers before fusion to the bank. bf16: products in bf16 (AMX,
 * AVX512-BF16), sums in float32; otherwise float32 throughout (AVX-512, AVX2 or plain C, by isa_best()). The
 * result owns all it needs. */
sherf_status radiance_field_create(context *c, const radiance_sizes *sizes, const radiance_weights *weights,
                                   const radiance_bank *bank, bool bf16, radiance_field **out);
void radiance_field_free(radiance_field *n);
bool radiance_field_in_bf16(const radiance_field *n); /* as it was created, where the machine supports bf16 */

/* rgb [P, 3] and raw density [P] of every point of the set. */
sherf_status radiance_field_run(context *c, const radiance_field *n, const point_set *points, float *rgb,
                                float *sigma);

/* Colour, opacity, depth pictures of one frame from rays and points (compositing as network.md 6); out as in
 * sherf_frame, background RGB; early_stop: opaque rays skip the rest of their points. */
sherf_status radiance_field_render(context *c, const radiance_field *n, const ray_bundle *rays,
                                   const point_set *points, const float background[3], bool early_stop,
                                   sherf_frame *frame);

#ifdef __cplusplus
}
#endif
#endif
