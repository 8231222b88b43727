/* The radiance field in bf16 on tensor cores (mma.sync, 8.0 and newer; sums in float32). A warp takes 16
 * points through all of fusion and decoder. Activations never leave its registers, since two neighbouring
 * fragments of a product's result are one fragment of the next product's input (warp.h).
 *
 * A block has 8 warps, 128 points at a time, and stays for the kernel's duration, one on each multiprocessor:
 *
 * Shared memory, with the paper's sizes: three stages of the decoder's weights, 3 x 16 KB, which asynchronous
 * copies refill in rotation while the previous stage is used (21 stages of four k-tiles, 344 KB for a tile of
 * 128 points); the fusion's weights and all biases stay resident, 27 KB; encodings on their way into
 * fragments, 8 x 1.75 KB. 89 KB in all; 104 KB are requested.
 *
 * Registers: sums of a layer 64, its input 32, the decoder's first input (kept for the skip) 20, token 1 8;
 * with addresses and weights in transit nvcc 13 uses 231 to 243 of 255 for each thread, without spills.
 * Fusion goes head by head and stays below that. Each warp reads every fragment of weights for 16 points: 256
 * bytes for a product of 2048, which keeps shared memory (128 bytes a clock) as busy as 8.0's tensor cores
 * and twice as busy as half of 9.0's. More points for each warp would need more registers than there are;
 * wgmma, which reads weights from shared memory itself, is the next step.
 *
 * The stream of stages and every barrier are the same for all warps, whether their points exist or not. */
#include "model/sherf/cuda/pack.h"

namespace cuda_backend {

bool bf16_fits(const network_sizes &s) {
    return s.width == TOKEN && s.heads <= HEADS_MAX && s.head_width <= 16 && s.decoder_width <= 128 &&
           s.view_width <= 8 * VIEW_N && s.position_width + 3 <= 16 * PLACE_TILES &&
           s.direction_width + 3 <= 16 * DIRECTION_TILES && s.color_width <= 16 * COLOR_TILES &&
           (s.color_width == 0 || s.color_token == 2);
}

/* ---- packing ---- */
static plain_matrix plain_of(const radiance_matrix &m) {
    return {m.w, m.rows, m.columns, m.columns};
}

static forward_weights forward_of(const float_layers &l, const network_sizes &s) {
    const radiance_matrices &m = l.m;
    const int h = s.decoder_width, columns = m.views.columns;
    forward_weights f = {};
    f.color = plain_of(m.color);
    f.qkv = plain_of(m.qkv);
    f.attention_out = plain_of(m.attention_out);
    f.mlp0 = plain_of(m.mlp0);
    f.mlp1 = plain_of(m.mlp1);
    f.alpha = plain_of(m.alpha);
    f.rgb = plain_of(m.rgb);
    f.views_h = {m.views.w, m.views.rows, h, columns};
    f.views_rest = {m.views.w + h, m.views.rows, columns - h, columns};
    f.token_b = l.token_b;
    f.norm0_w = l.norm0_w, f.norm0_b = l.norm0_b, f.norm1_w = l.norm1_w, f.norm1_b = l.norm1_b;
    f.attention_out_b = m.attention_out.b;
    f.mlp0_b = m.mlp0.b, f.mlp1_b = m.mlp1.b, f.views_b = m.views.b;
    f.rgb_b = m.rgb.b, f.alpha_b = m.alpha.b;
    for (int i = 0; i < s.decoder_depth; i++) {
        f.pts[i] = plain_of(m.pts[i]);
        f.pts_b[i] = m.pts[i].b;
    }
    return f;
}

sherf_status bf16_room(context *c, arena *a, const network_sizes &s, bf16_layers *out) {
    const int h_tiles = h_tiles_of(s.decoder_width), stages = forward_stages(s, h_tiles);
    const int64_t words = (int64_t)stages * stage_words(h_tiles);
    const int64_t kept = resident_words(resident_layout(s.heads, h_tiles, s.decoder_depth));
    uint32_t *stream = room<uint32_t>(c, a, words), *resident = room<uint32_t>(c, a, kept);
    if (!stream || !resident) return SHERF_NO_MEMORY;
    each(words, [=] __device__(int64_t i) { stream[i] = 0; });
    each(kept, [=] __device__(int64_t i) { resident[i] = 0; });
    *out = {(uint4 *)stream, (uint4 *)resident, stages, (int)(kept * 4)};
    return SHERF_OK;
}

void bf16_pack(const float_layers &l, const network_sizes &s, const bf16_layers &to) {
    pack_forward(forward_of(l, s), s, h_tiles_of(s.decoder_width), (uint32_t *)to.stream,
                 (uint32_t *)to.resident);
}

struct frame_task {
    static constexpr bool KEEPS = false;
    warp_points at;
    network_points points;
    float token_scale;
    const uint16_t *sampled;
    const float *colors;

    __device__ void tokens(const network_warp &w, const float *token_b, sums (*token)[TOKEN_N]) const {
        UNROLL
        for (int r = 0; r < 2; r++) {
            const uint16_t *from = sampled + at.place(w.g + 8 * r) * (3 * TOKEN);
            UNROLL
            for (int i = 0; i < 3 * TOKEN_N; i++) {
                const uint32_t two = *(const uint32_t *)(from + 8 * i + 2 * w.t);
                const float *b = token_b + 8 * i + 2 * w.t;
                token[i / TOKEN_N][i % TOKEN_N].c[2 * r] = half_value((uint16_t)two) * token_scale + b[0];
                token[i / TOKEN_N][i % TOKEN_N].c[2 * r + 1] =
                    half_value((uint16_t)(two >> 16)) * token_scale + b[1];
            }
        }
    }
    __device__ float color(int p, int k) const { return colors[3 * at.place(p) + k]; }
    __device__ float position(int p, int k) const { return points.canonical[3 * at.number(p) + k]; }
    __device__ float direction(int p, int k) const { return points.direction[3 * at.number(p) + k]; }
};

template <int H>
__global__ void __launch_bounds__(THREADS, 1)
    bf16_kernel(network_sizes s, bf16_layers layers, network_points points, float token_scale, int64_t base,
                int64_t max, const uint16_t *tokens, const float *color) {
    WIDE_SHARED(shared, decoder_shared<H>());
    const int64_t left = *points.count - base, end = left < max ? left : max;
    decoder_block<H> block;
    if (!block.begin(s, layers, layers.stages, end, shared)) return;
    __syncthreads();
    for (int64_t tile = blockIdx.x; tile < block.tiles; tile += gridDim.x) {
        const int64_t first = (tile * WARPS + block.warp) * TILE_POINTS;
        const frame_task task = {{points.list, base, first, end}, points, token_scale, tokens, color};
        input h[H], shown[VIEW_TILES];
        block.forward(s, task, h, shown);
        block.answer(task.at, h, shown, [&](int64_t number, int channel, float value) {
            ((float *)(points.result + number))[channel] = value;
        });
    }
    async_wait_but(0);
}

template <int H>
static void run_as(const placed_network *n, const network_points *points, int64_t base, int64_t max,
                   const network_scratch *scratch) {
    decoder_launch(bf16_kernel<H>, max, decoder_shared<H>(), n->s, n->fragments, *points, 1 / n->bank.scale,
                   base, max, (const uint16_t *)scratch->tokens, (const float *)scratch->color);
}

void bf16_run(const placed_network *n, const network_points *points, int64_t base, int64_t max,
              const network_scratch *scratch) {
    if (h_tiles_of(n->s.decoder_width) == 6)
        run_as<6>(n, points, base, max, scratch);
    else
        run_as<8>(n, points, base, max, scratch);
}

} // namespace cuda_backend
