/* A radiance field on the GPU: shared by its kernels. */
#ifndef SHERF_CUDA_NETWORK_H
#define SHERF_CUDA_NETWORK_H

#include "model/sherf/fused/gpu.h"
#include "sampling/cuda/frame.h"

namespace cuda_backend {

/* ---- training (train.cu) ---- */
extern const gpu_point_training points_training;

/* ---- the network (network.cu, network_bf16.cu) ---- */
struct placed_network;
sherf_status network_place(context *c, arena *a, const tensor_memory *memory, const radiance_parts *p,
                           bool bf16, placed_network **out);
void network_free(placed_network *n);
bool network_in_bf16(const placed_network *n);
/* Points to process: list[i] for i < *count, at most `max`. result[point] gets red, green, blue, raw density.
 */
struct network_points {
    const float *canonical, *direction, *observed_px;
    const int32_t *list, *count;
    int64_t max;
    float4 *result;
};
/* Memory from the arena that network_run needs for at most `max` points. */
struct network_scratch {
    int64_t max; /* points at a time */
    void *tokens;
    float *color, *layers;
};
sherf_status network_room(context *c, arena *a, const placed_network *n, int64_t max, network_scratch *out);
void network_run(const placed_network *n, const network_points *points, const network_scratch *scratch);

/* All pointers are the device's. Maps and levels have float32 values, or float16 times the bank's scale. */
struct placed_bank {
    int width, fused, map_tokens; /* of a token; of three; tokens with values of the map */
    float plane_min[3], plane_scale[3], map_scale[2], image_scale[2], volume_min[3];
    radiance_map plane[3], map;
    int image_width, image_height;
    const float4 *image;
    radiance_level level[POINT_LEVELS];
    float scale;
};

struct float_layers {
    radiance_matrices m;
    const float *norm0_w, *norm0_b, *norm1_w, *norm1_b, *token_b;
};

/* Sizes that kernels read, from radiance_field. */
struct network_sizes {
    int width, fused, heads, head_width, all, color_width, color_token, color_frequencies;
    int position_width, position_frequencies, direction_width, direction_frequencies;
    int decoder_width, decoder_depth, decoder_skip, view_width;
};

/* Weights as the tensor cores' fragments (network_bf16.cu). */
struct bf16_layers {
    uint4 *stream;   /* of the decoder, stage by stage */
    uint4 *resident; /* resident in shared memory: fusion's fragments, then all biases */
    int stages, resident_bytes;
};

struct placed_network {
    bool bf16;
    network_sizes s;
    placed_bank bank;
    float_layers layers; /* float32 */
    bf16_layers fragments;
};

/* tokens[i][fused] of the points list[base + i], 0 <= i < max; color[i][3]. Without token_b, times the
 * bank's scale. */
void sample_tokens(const placed_network *n, const network_points *points, int64_t base, int64_t max,
                   void *tokens, float *color);

/* network_float.cu */
int64_t float_rows(const network_sizes *s); /* of scratch, 32 floats each, for one block */
int float_blocks();
void float_run(const placed_network *n, const network_points *points, int64_t base, int64_t max,
               const network_scratch *scratch);
/* network_bf16.cu */
network_sizes network_sizes_of(const radiance_field *n);
bool bf16_fits(const network_sizes &s);
/* Allocates the layers' memory, zeroed; packs the layers into it, in the stream's order. */
sherf_status bf16_room(context *c, arena *a, const network_sizes &s, bf16_layers *out);
void bf16_pack(const float_layers &l, const network_sizes &s, const bf16_layers &to);
void bf16_run(const placed_network *n, const network_points *points, int64_t base, int64_t max,
              const network_scratch *scratch);

} // namespace cuda_backend
#endif
