/* The radiance field in bf16 on tensor cores (mma.sync, 8.0 and newer; sums in float32). A warp takes 16
 * points through the whole of fusion and decoder; activations never leave its registers, since two
 * neighbouring fragments of a product's result are one fragment of the next product's input (warp.h).
 *
 * A block has 8 warps, 128 points at a time, and stays for the kernel's length, one on each multiprocessor:
 *   shared memory, paper's sizes: three stages of the decoder's weights, 3 x 16 KB, that come round and round
 * by asynchronous copies while the stage before is used (21 stages of four k-tiles, 344 KB a tile of 128
 * points); the fusion's weights and all biases to stay, 27 KB; encodings on their way into fragments, 8
 * x 1.75 KB. 89 KB in all; 104 KB are asked for. registers: sums of a layer 64, its input 32, the decoder's
 * first input (kept for the skip) 20, token 1 8; with addresses and weights on their way nvcc 13 takes 231 to
 * 243 of 255 a thread, without spills. Fusion goes head by head and stays below that. Every fragment of
 * weights is read by each warp for 16 points: 256 bytes a product of 2048, which keeps shared memory (128
 * bytes a clock) as busy as 8.0's tensor cores and twice as busy as half of 9.0's. More points a warp want
 * more registers than there are; wgmma, which reads weights from shared memory itself, is the way from there.
 *
 * The stream of stages and every barrier are the same for all warps, whether their points exist or not. */
#include "model/sherf/cuda/network_bf16.h"

namespace cuda_backend {

bool bf16_fits(const network_sizes &s) {
    return s.width == TOKEN && s.heads <= HEADS_MAX && s.head_width <= 16 && s.decoder_width <= 128 &&
           s.view_width <= 8 * VIEW_N && s.position_width + 3 <= 16 * PLACE_TILES &&
           s.direction_width + 3 <= 16 * DIRECTION_TILES && s.color_width <= 16 * COLOR_TILES &&
           (s.color_width == 0 || s.color_token == 2);
}

/* ---- packing, on the host ---- */
static uint32_t host_bf16(float x) {
    uint32_t u;
    memcpy(&u, &x, sizeof u);
    return (u + 0x7fff + (u >> 16 & 1)) >> 16;
}
static float host_rounded(float x) {
    const uint32_t u = host_bf16(x) << 16;
    memcpy(&x, &u, sizeof x);
    return x;
}

/* The fragment of inputs 16 k .. and outputs 8 n ..; value(output, input) is 0 where there is none. words:
 * two a lane, `step` apart from lane to lane. */
template <typename F> static void pack_fragment(int k, int n, F value, uint32_t *words, int step) {
    for (int lane = 0; lane < WARP; lane++) {
        const int g = lane / 4, t = lane % 4;
        for (int half = 0; half < 2; half++) {
            const int input = 16 * k + 8 * half + 2 * t, output = 8 * n + g;
            words[lane * step + half] = host_bf16(value(output, input)) | host_bf16(value(output, input + 1))
                                                                              << 16;
        }
    }
}

template <typename F>
static void pack_resident(uint32_t *fragments, int first, int k_tiles, int n_tiles, F value) {
    for (int k = 0; k < k_tiles; k++)
        for (int n = 0; n < n_tiles; n++)
            pack_fragment(k, n, value, fragments + (first + k * n_tiles + n) * FRAGMENT, 2);
}

static float matrix_at(const radiance_matrix &m, int row, int column) {
    return row >= 0 && row < m.rows && column >= 0 && column < m.columns
               ? m.w[(size_t)row * m.columns + column]
               : 0;
}

static void pack_heads(const radiance_parts *p, const resident_places &at, uint32_t *fragments) {
    const int all = p->n->attention_width, width = p->n->s.head_width;
    const float scale = 1.44269504f / sqrtf((float)width); /* attention's, and log2 e for exp2 */
    for (int h = 0; h < p->n->s.heads; h++) {
        const int first = at.heads + h * HEAD_EACH;
        for (int part = 0; part < 3; part++) /* q, k, v */
            pack_resident(fragments, first + 4 * part, TOKEN_TILES, 2, [=](int output, int input) {
                const float w =
                    output < width ? matrix_at(p->m.qkv, part * all + h * width + output, input) : 0;
                return part == 0 ? w * scale : w;
            });
        pack_resident(fragments, first + HEAD_QKV, 1, TOKEN_N, [=](int output, int input) {
            return input < width ? matrix_at(p->m.attention_out, output, h * width + input) : 0;
        });
    }
}

/* What bf16 keeps of a weight in the even columns, what it drops in the odd ones. */
static float split(const radiance_matrix &m, int output, int input) {
    const float w = matrix_at(m, output / 2, input), high = host_rounded(w);
    return output % 2 ? w - high : high;
}

static void pack_floats(const radiance_parts *p, const resident_places &at, int h_tiles, float *to) {
    const struct {
        int at;
        const float *from;
        int count;
    } all[] = {{at.token_b, p->n->token_b, 3 * TOKEN},
               {at.norm0_w, p->n->norm0_w, TOKEN},
               {at.norm0_b, p->n->norm0_b, TOKEN},
               {at.norm1_w, p->n->norm1_w, TOKEN},
               {at.norm1_b, p->n->norm1_b, TOKEN},
               {at.out_b, p->m.attention_out.b, TOKEN},
               {at.mlp0_b, p->m.mlp0.b, TOKEN},
               {at.mlp1_b, p->m.mlp1.b, TOKEN},
               {at.views_b, p->m.views.b, p->m.views.rows},
               {at.rgb_b, p->m.rgb.b, 3},
               {at.rgb_b + 3, p->m.alpha.b, 1}};
    for (const auto &one : all) memcpy(to + one.at, one.from, (size_t)one.count * sizeof *to);
    for (int i = 0; i < p->n->s.decoder_depth; i++)
        memcpy(to + at.pts_b + 16 * h_tiles * i, p->m.pts[i].b, (size_t)p->m.pts[i].rows * sizeof *to);
}

/* Stages follow each other at the same distance, that of the widest: 16 bytes a lane are two neighbouring
 * n-tiles. */
static int stage_words(int h_tiles) {
    return STAGE_TILES * 2 * h_tiles * FRAGMENT;
}

template <typename F>
static uint32_t *pack_stages(uint32_t *to, int each_words, int k_tiles, int n_tiles, F value) {
    for (int k = 0; k < k_tiles; k++)
        for (int n = 0; n < n_tiles; n++)
            pack_fragment(k, n, value,
                          to + k / STAGE_TILES * each_words +
                              (k % STAGE_TILES * n_tiles / 2 + n / 2) * 2 * FRAGMENT + n % 2 * 2,
                          4);
    return to + tiles_stages(k_tiles) * each_words;
}

sherf_status bf16_place(context *c, arena *a, const tensor_memory *memory, const radiance_parts *p,
                        const network_sizes &s, bf16_layers *out) {
    const int h_tiles = h_tiles_of(p->n->s.decoder_width), each_words = stage_words(h_tiles);
    const int views_tiles = h_tiles + DIRECTION_TILES + TOKEN_TILES, depth = p->n->s.decoder_depth;
    const resident_places at = resident_layout(p->n->s.heads, h_tiles, depth);
    int stages = tiles_stages(views_tiles);
    for (int i = 0; i < depth; i++) stages += tiles_stages(layer_tiles(s, i, h_tiles));
    const size_t words = (size_t)stages * each_words, kept = (size_t)resident_words(at);
    uint32_t *stream = (uint32_t *)mem_zero(c, words, sizeof *stream);
    uint32_t *resident = (uint32_t *)mem_zero(c, kept, sizeof *resident);
    uint32_t *stream_there = room<uint32_t>(c, a, (int64_t)words),
             *resident_there = room<uint32_t>(c, a, (int64_t)kept);
    sherf_status status = stream && resident && stream_there && resident_there ? SHERF_OK : SHERF_NO_MEMORY;
    if (!status) {
        pack_resident(resident, at.color, COLOR_TILES, TOKEN_N,
                      [=](int output, int input) { return matrix_at(p->m.color, output, input); });
        pack_heads(p, at, resident);
        pack_resident(resident, at.mlp0, TOKEN_TILES, TOKEN_N,
                      [=](int output, int input) { return matrix_at(p->m.mlp0, output, input); });
        pack_resident(resident, at.mlp1, TOKEN_TILES, TOKEN_N,
                      [=](int output, int input) { return matrix_at(p->m.mlp1, output, input); });
        pack_resident(resident, at.alpha, h_tiles, 1,
                      [=](int output, int input) { return split(p->m.alpha, output, input); });
        pack_resident(resident, at.rgb, VIEW_TILES, 1,
                      [=](int output, int input) { return split(p->m.rgb, output, input); });
        pack_floats(p, at, h_tiles, (float *)(resident + at.fragments * FRAGMENT));
        uint32_t *to = stream;
        for (int i = 0; i < depth; i++)
            to = pack_stages(to, each_words, layer_tiles(s, i, h_tiles), 2 * h_tiles,
                             [=](int output, int input) {
                                 return matrix_at(p->m.pts[i], output, pts_column(s, i, input));
                             });
        pack_stages(to, each_words, views_tiles, VIEW_N, [=](int output, int input) {
            return matrix_at(p->m.views, output, views_column(s, h_tiles, input));
        });
        status = memory->upload(c, stream_there, stream, words * sizeof *stream);
    }
    if (!status) status = memory->upload(c, resident_there, resident, kept * sizeof *resident);
    *out = {(const uint4 *)stream_there, (const uint4 *)resident_there, stages,
            (int)(kept * sizeof *resident)};
    mem_free(stream);
    mem_free(resident);
    return status;
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
