/* The point network in bf16 on tensor cores (mma.sync, 8.0 and newer; sums in float32). A warp takes 16
 * points through the whole of fusion and decoder; activations never leave its registers, since two
 * neighbouring fragments of a product's result are one fragment of the next product's input (warp.h).
 *
 * A block has 8 warps, 128 points at a time, and stays for the kernel's length, one on each multiprocessor:
 *   shared memory, paper's sizes: three stages of the decoder's weights, 3 x 16 KB, that come round and round
 * by asynchronous copies while the stage before is used (21 stages of four k-tiles, 344 KB a tile of 128
 * points); the fusion's weights and all biases to stay, 27 KB; encodings on their way into fragments, 8
 * x 1.75 KB. 89 KB in all; 104 KB are asked for. registers: sums of a layer 64, its input 32, the decoder's
 * first input (kept for the skip) 20, token 1 8; with addresses and weights on their way nvcc 13 takes 229 to
 * 242 of 255 a thread, without spills. Fusion goes head by head and stays below that. Every fragment of
 * weights is read by each warp for 16 points: 256 bytes a product of 2048, which keeps shared memory (128
 * bytes a clock) as busy as 8.0's tensor cores and twice as busy as half of 9.0's. More points a warp want
 * more registers than there are; wgmma, which reads weights from shared memory itself, is the way from there.
 *
 * The stream of stages and every barrier are the same for all warps, whether their points exist or not. */
#include "render/cuda/network.h"

namespace cuda_backend {

enum {
    WARPS = 8,
    TILE_POINTS = 16, /* of a warp */
    THREADS = WARPS * WARP,
    STAGES = 3,          /* in shared memory */
    STAGE_TILES = 4,     /* k-tiles of a stage */
    TOKEN = 32,          /* the only width supported */
    TOKEN_TILES = 2,     /* k-tiles of a token */
    TOKEN_N = 4,         /* n-tiles of a token */
    PLACE_TILES = 3,     /* k-tiles of the encoded position, */
    DIRECTION_TILES = 2, /* of the direction */
    COLOR_TILES = 2,     /* and the colour */
    VIEW_N = 8,
    VIEW_TILES = VIEW_N / 2,
    HEADS_MOST = 4,
    FRAGMENT = 2 * WARP,                 /* 32-bit words: 16 inputs x 8 outputs */
    ENCODED_PITCH = 16 * PLACE_TILES + 8 /* bf16 a point: without bank conflicts */
};

/* ---- where things are in the resident part: fragments, then floats ---- */
struct resident_places {
    int color, heads, head_each, mlp0, mlp1, alpha, rgb, fragments; /* fragments */
    int token_b, norm0_w, norm0_b, norm1_w, norm1_b, out_b, mlp0_b, mlp1_b, views_b, rgb_b, pts_b, floats;
};

enum {
    HEAD_QKV = 4 * 3,
    HEAD_EACH = HEAD_QKV + TOKEN_N
}; /* q, k, v: 2 k-tiles x 2 n-tiles each; out: 1 x 4 */

static __host__ __device__ resident_places resident_layout(int heads, int h_tiles, int depth) {
    resident_places p;
    int at = 0;
    p.color = at, at += COLOR_TILES * TOKEN_N;
    p.heads = at, at += heads * HEAD_EACH;
    p.mlp0 = at, at += TOKEN_TILES * TOKEN_N;
    p.mlp1 = at, at += TOKEN_TILES * TOKEN_N;
    p.alpha = at, at += h_tiles;
    p.rgb = at, at += VIEW_TILES;
    p.fragments = at;
    at = 0;
    p.token_b = at, at += 3 * TOKEN;
    p.norm0_w = at, at += TOKEN;
    p.norm0_b = at, at += TOKEN;
    p.norm1_w = at, at += TOKEN;
    p.norm1_b = at, at += TOKEN;
    p.out_b = at, at += TOKEN;
    p.mlp0_b = at, at += TOKEN;
    p.mlp1_b = at, at += TOKEN;
    p.views_b = at, at += 8 * VIEW_N;
    p.rgb_b = at, at += 4; /* red, green, blue, density */
    p.pts_b = at, at += 16 * h_tiles * depth;
    p.floats = at;
    return p;
}

static __host__ __device__ int resident_words(const resident_places &p) {
    return (p.fragments * FRAGMENT + p.floats + 3) / 4 * 4;
}

static int h_tiles_of(int decoder_width) {
    return decoder_width <= 96 ? 6 : 8;
}

/* Stages of the decoder: its layers' inputs in k-tiles, each begun with a new stage. */
static __host__ __device__ int tiles_stages(int k_tiles) {
    return (k_tiles + STAGE_TILES - 1) / STAGE_TILES;
}
enum { X_TILES = PLACE_TILES + TOKEN_TILES };
static int layer_tiles(const point_sizes &s, int layer, int h_tiles) {
    return layer == 0 ? X_TILES : layer == s.decoder_skip + 1 ? X_TILES + h_tiles : h_tiles;
}

bool bf16_fits(const point_parts *p) {
    const point_sizes &s = p->s;
    return s.token_width == TOKEN && s.heads <= HEADS_MOST && s.head_width <= 16 && s.decoder_width <= 128 &&
           s.view_width <= 8 * VIEW_N && p->position_width + 3 <= 16 * PLACE_TILES &&
           p->direction_width + 3 <= 16 * DIRECTION_TILES && p->color_width <= 16 * COLOR_TILES &&
           (p->color_width == 0 || p->color_token == 2);
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

static float matrix_at(const point_part_matrix &m, int row, int column) {
    return row >= 0 && row < m.rows && column >= 0 && column < m.columns
               ? m.w[(size_t)row * m.columns + column]
               : 0;
}

/* A column for each input of an encoding's k-tiles: the values, then the low parts of the first three again.
 */
static int encoded_column(int input, int width) {
    return input < width ? input : input < width + 3 ? input - width : -1;
}

/* [encoded position, token 0, h] */
static int pts_column(const point_parts *p, int layer, int input) {
    const bool first = layer == 0, wide = layer == p->s.decoder_skip + 1;
    if (!first && !wide) return input;
    if (input < 16 * PLACE_TILES) return encoded_column(input, p->position_width);
    if (input < 16 * X_TILES) return p->position_width + input - 16 * PLACE_TILES;
    return p->position_width + TOKEN + input - 16 * X_TILES;
}

/* [h, encoded direction, token 1] */
static int views_column(const point_parts *p, int h_tiles, int input) {
    const int h = p->s.decoder_width, direction = 16 * h_tiles, token = direction + 16 * DIRECTION_TILES;
    if (input < direction) return input < h ? input : -1;
    if (input < token) {
        const int column = encoded_column(input - direction, p->direction_width);
        return column < 0 ? -1 : h + column;
    }
    return h + p->direction_width + input - token;
}

static void pack_heads(const point_parts *p, const resident_places &at, uint32_t *fragments) {
    const int all = p->attention_width, width = p->s.head_width;
    const float scale = 1.44269504f / sqrtf((float)width); /* attention's, and log2 e for exp2 */
    for (int h = 0; h < p->s.heads; h++) {
        const int first = at.heads + h * HEAD_EACH;
        for (int part = 0; part < 3; part++) /* q, k, v */
            pack_resident(fragments, first + 4 * part, TOKEN_TILES, 2, [=](int output, int input) {
                const float w =
                    output < width ? matrix_at(p->qkv, part * all + h * width + output, input) : 0;
                return part == 0 ? w * scale : w;
            });
        pack_resident(fragments, first + HEAD_QKV, 1, TOKEN_N, [=](int output, int input) {
            return input < width ? matrix_at(p->attention_out, output, h * width + input) : 0;
        });
    }
}

/* What bf16 keeps of a weight in the even columns, what it drops in the odd ones. */
static float split(const point_part_matrix &m, int output, int input) {
    const float w = matrix_at(m, output / 2, input), high = host_rounded(w);
    return output % 2 ? w - high : high;
}

static void pack_floats(const point_parts *p, const resident_places &at, int h_tiles, float *to) {
    const struct {
        int at;
        const float *from;
        int count;
    } all[] = {{at.token_b, p->token_b, 3 * TOKEN},
               {at.norm0_w, p->norm0_w, TOKEN},
               {at.norm0_b, p->norm0_b, TOKEN},
               {at.norm1_w, p->norm1_w, TOKEN},
               {at.norm1_b, p->norm1_b, TOKEN},
               {at.out_b, p->attention_out.b, TOKEN},
               {at.mlp0_b, p->mlp0.b, TOKEN},
               {at.mlp1_b, p->mlp1.b, TOKEN},
               {at.views_b, p->views.b, p->views.rows},
               {at.rgb_b, p->rgb.b, 3},
               {at.rgb_b + 3, p->alpha.b, 1}};
    for (const auto &one : all) memcpy(to + one.at, one.from, (size_t)one.count * sizeof *to);
    for (int i = 0; i < p->s.decoder_depth; i++)
        memcpy(to + at.pts_b + 16 * h_tiles * i, p->pts[i].b, (size_t)p->pts[i].rows * sizeof *to);
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

sherf_status bf16_place(context *c, arena *a, const tensor_memory *memory, const point_parts *p,
                        bf16_layers *out) {
    const int h_tiles = h_tiles_of(p->s.decoder_width), each_words = stage_words(h_tiles);
    const int views_tiles = h_tiles + DIRECTION_TILES + TOKEN_TILES, depth = p->s.decoder_depth;
    const resident_places at = resident_layout(p->s.heads, h_tiles, depth);
    int stages = tiles_stages(views_tiles);
    for (int i = 0; i < depth; i++) stages += tiles_stages(layer_tiles(p->s, i, h_tiles));
    const size_t words = (size_t)stages * each_words, kept = (size_t)resident_words(at);
    uint32_t *stream = (uint32_t *)mem_zero(c, words, sizeof *stream);
    uint32_t *resident = (uint32_t *)mem_zero(c, kept, sizeof *resident);
    uint32_t *stream_there = room<uint32_t>(c, a, (int64_t)words),
             *resident_there = room<uint32_t>(c, a, (int64_t)kept);
    sherf_status status = stream && resident && stream_there && resident_there ? SHERF_OK : SHERF_NO_MEMORY;
    if (!status) {
        pack_resident(resident, at.color, COLOR_TILES, TOKEN_N,
                      [=](int output, int input) { return matrix_at(p->color, output, input); });
        pack_heads(p, at, resident);
        pack_resident(resident, at.mlp0, TOKEN_TILES, TOKEN_N,
                      [=](int output, int input) { return matrix_at(p->mlp0, output, input); });
        pack_resident(resident, at.mlp1, TOKEN_TILES, TOKEN_N,
                      [=](int output, int input) { return matrix_at(p->mlp1, output, input); });
        pack_resident(resident, at.alpha, h_tiles, 1,
                      [=](int output, int input) { return split(p->alpha, output, input); });
        pack_resident(resident, at.rgb, VIEW_TILES, 1,
                      [=](int output, int input) { return split(p->rgb, output, input); });
        pack_floats(p, at, h_tiles, (float *)(resident + at.fragments * FRAGMENT));
        uint32_t *to = stream;
        for (int i = 0; i < depth; i++)
            to = pack_stages(
                to, each_words, layer_tiles(p->s, i, h_tiles), 2 * h_tiles,
                [=](int output, int input) { return matrix_at(p->pts[i], output, pts_column(p, i, input)); });
        pack_stages(to, each_words, views_tiles, VIEW_N, [=](int output, int input) {
            return matrix_at(p->views, output, views_column(p, h_tiles, input));
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

/* ---- fragments ---- */
struct input { /* 16 points x 16 channels */
    uint32_t a[4];
};
struct sums { /* 16 points x 8 channels */
    float c[4];
};

/* Two neighbouring sums as input. */
static __device__ input input_of(const sums &low, const sums &high) {
    return {{pack_bf16(low.c[0], low.c[1]), pack_bf16(low.c[2], low.c[3]), pack_bf16(high.c[0], high.c[1]),
             pack_bf16(high.c[2], high.c[3])}};
}

static __device__ sums positive(const sums &s) {
    return {{fmaxf(s.c[0], 0), fmaxf(s.c[1], 0), fmaxf(s.c[2], 0), fmaxf(s.c[3], 0)}};
}

/* What this lane's sums of n-tile n begin with. */
static __device__ sums bias_of(const float *b, int n, int t) {
    const float low = b[8 * n + 2 * t], high = b[8 * n + 2 * t + 1];
    return {{low, high, low, high}};
}

struct network_warp {
    const uint32_t *fragments; /* resident */
    const float *values;
    uint16_t *encoded; /* TILE_POINTS x ENCODED_PITCH, the warp's own */
    int lane, g, t;    /* g = lane / 4: points g and g + 8; t: channels 2 t, 2 t + 1 */

    /* to[n] += x times the resident fragments from `first` on. */
    template <int K, int N> __device__ void product(const input *x, int first, sums *to) const {
        UNROLL
        for (int k = 0; k < K; k++) {
            UNROLL
            for (int n = 0; n < N; n++) {
                const uint2 w = *(const uint2 *)(fragments + (first + k * N + n) * FRAGMENT + 2 * lane);
                const uint32_t b[2] = {w.x, w.y};
                mma_bf16(to[n].c, x[k].a, b);
            }
        }
    }

    /* x, then sin(2^k x), cos(2^k x), of the values of one point's component; and what bf16 drops of x. The
     * sines of doubled angles come from the first: an error of 1e-7 becomes 6e-6 at most. */
    __device__ void encode_one(int point, int component, float x, int frequencies, int width) const {
        uint16_t *to = encoded + point * ENCODED_PITCH;
        const uint32_t high = pack_bf16(x, 0);
        if (component < width) to[component] = (uint16_t)high;
        if (width + component < ENCODED_PITCH - 8)
            to[width + component] = (uint16_t)pack_bf16(x - unpack_bf16(high, 0), 0);
        float s, c;
        sincosf(x, &s, &c);
        for (int k = 0; k < frequencies; k++) {
            const int sine = 3 + 6 * k + component;
            if (sine < width) to[sine] = (uint16_t)pack_bf16(s, 0);
            if (sine + 3 < width) to[sine + 3] = (uint16_t)pack_bf16(c, 0);
            const float doubled = 2 * s * c;
            c = 1 - 2 * s * s;
            s = doubled;
        }
    }

    /* value(point, component) of this warp's points as K inputs. */
    template <int K, typename F>
    __device__ void encode(F value, int frequencies, int width, input *to) const {
        warp_barrier();
        uint32_t *words = (uint32_t *)encoded;
        for (int i = lane; i < TILE_POINTS * ENCODED_PITCH / 2; i += WARP) words[i] = 0;
        warp_barrier();
        for (int i = lane; i < 3 * TILE_POINTS; i += WARP)
            encode_one(i / 3, i % 3, value(i / 3, i % 3), frequencies, width);
        warp_barrier();
        UNROLL
        for (int k = 0; k < K; k++) {
            const uint32_t *low = words + (g * ENCODED_PITCH + 16 * k) / 2 + t,
                           *high = low + 4 * ENCODED_PITCH;
            to[k] = {{low[0], high[0], low[4], high[4]}};
        }
    }

    /* The points' rows of `token`, normalised. */
    __device__ void norm(const sums *token, int w, int b, input *out) const {
        float mean[2] = {0, 0}, scale[2] = {0, 0};
        sums y[TOKEN_N];
        UNROLL
        for (int n = 0; n < TOKEN_N; n++)
            for (int i = 0; i < 4; i++) mean[i / 2] += token[n].c[i];
        for (int r = 0; r < 2; r++) mean[r] = quad_sum(mean[r]) * (1.0f / TOKEN);
        UNROLL
        for (int n = 0; n < TOKEN_N; n++)
            for (int i = 0; i < 4; i++) {
                y[n].c[i] = token[n].c[i] - mean[i / 2];
                scale[i / 2] += y[n].c[i] * y[n].c[i];
            }
        for (int r = 0; r < 2; r++) scale[r] = 1.0f / sqrtf(quad_sum(scale[r]) * (1.0f / TOKEN) + 1e-5f);
        UNROLL
        for (int n = 0; n < TOKEN_N; n++)
            for (int i = 0; i < 4; i++) {
                const int channel = 8 * n + 2 * t + i % 2;
                y[n].c[i] = y[n].c[i] * scale[i / 2] * values[w + channel] + values[b + channel];
            }
        UNROLL
        for (int k = 0; k < TOKEN_TILES; k++) out[k] = input_of(y[2 * k], y[2 * k + 1]);
    }

    /* One head: out[i] += its part of the attention's result, for tokens 0 and 1. */
    __device__ void attend(const input (*x)[TOKEN_TILES], int first, sums (*out)[TOKEN_N]) const {
        sums q[2][2] = {}, k[3][2] = {}, v[3][2] = {};
        UNROLL
        for (int i = 0; i < 3; i++) {
            if (i < 2) product<TOKEN_TILES, 2>(x[i], first, q[i]);
            product<TOKEN_TILES, 2>(x[i], first + 4, k[i]);
            product<TOKEN_TILES, 2>(x[i], first + 8, v[i]);
        }
        UNROLL
        for (int i = 0; i < 2; i++) {
            sums mixed[2] = {};
            UNROLL
            for (int r = 0; r < 2; r++) { /* points g and g + 8 */
                float dot[3], sum = 0;
                UNROLL
                for (int j = 0; j < 3; j++) {
                    dot[j] = 0;
                    for (int n = 0; n < 2; n++)
                        for (int e = 2 * r; e < 2 * r + 2; e++) dot[j] += q[i][n].c[e] * k[j][n].c[e];
                    dot[j] = quad_sum(dot[j]);
                }
                const float top = fmaxf(fmaxf(dot[0], dot[1]), dot[2]);
                for (int j = 0; j < 3; j++) sum += dot[j] = exp2f(dot[j] - top);
                UNROLL
                for (int n = 0; n < 2; n++)
                    for (int e = 2 * r; e < 2 * r + 2; e++)
                        for (int j = 0; j < 3; j++) mixed[n].c[e] += dot[j] / sum * v[j][n].c[e];
            }
            const input y = input_of(mixed[0], mixed[1]);
            product<1, TOKEN_N>(&y, first + HEAD_QKV, out[i]);
        }
    }

    /* Tokens 0 and 1 through attention and feed-forward, in place; token 2 is key and value only. */
    __device__ void transform(const network_sizes &s, const resident_places &at,
                              sums (*token)[TOKEN_N]) const {
        input x[3][TOKEN_TILES];
        UNROLL
        for (int i = 0; i < 3; i++) norm(token[i], at.norm0_w, at.norm0_b, x[i]);
        UNROLL
        for (int i = 0; i < 2; i++)
            for (int n = 0; n < TOKEN_N; n++) {
                const sums b = bias_of(values + at.out_b, n, t);
                for (int e = 0; e < 4; e++) token[i][n].c[e] += b.c[e];
            }
        for (int h = 0; h < s.heads; h++) attend(x, at.heads + h * HEAD_EACH, token);
        UNROLL
        for (int i = 0; i < 2; i++) {
            sums hidden[TOKEN_N];
            norm(token[i], at.norm1_w, at.norm1_b, x[i]);
            UNROLL
            for (int n = 0; n < TOKEN_N; n++) {
                const sums b = bias_of(values + at.mlp1_b, n, t);
                hidden[n] = bias_of(values + at.mlp0_b, n, t);
                for (int e = 0; e < 4; e++) token[i][n].c[e] += b.c[e];
            }
            product<TOKEN_TILES, TOKEN_N>(x[i], at.mlp0, hidden);
            UNROLL
            for (int n = 0; n < TOKEN_N; n++)
                for (int e = 0; e < 4; e++) {
                    const float y = hidden[n].c[e];
                    hidden[n].c[e] = 0.5f * y * (1.0f + erff(y * 0.707106781f));
                }
            UNROLL
            for (int k = 0; k < TOKEN_TILES; k++) x[i][k] = input_of(hidden[2 * k], hidden[2 * k + 1]);
            product<TOKEN_TILES, TOKEN_N>(x[i], at.mlp1, token[i]);
        }
    }
};

/* ---- the decoder's weights, stage by stage ---- */
template <int STAGE_WORDS> struct weight_stream {
    const uint4 *from;
    uint32_t *ring;
    int stages;        /* of the stream */
    int64_t next, end; /* the next one to copy, of this block's whole work */
    int64_t used;

    __device__ void copy() {
        if (next < end) {
            const uint4 *source = from + next % stages * (STAGE_WORDS / 4);
            uint32_t *to = ring + next % STAGES * STAGE_WORDS;
            for (int i = (int)threadIdx.x; i < STAGE_WORDS / 4; i += THREADS)
                async_copy(to + 4 * i, source + i);
        }
        next++;
        async_commit();
    }

    __device__ void begin() {
        for (int i = 0; i < STAGES - 1; i++) copy();
    }

    /* The next stage's weights. All threads of the block. */
    __device__ const uint32_t *take() {
        async_wait_but(STAGES - 2);
        __syncthreads(); /* everybody's copies are there, and everybody has left the stage before this one */
        copy();
        return ring + used++ % STAGES * STAGE_WORDS;
    }

    /* to[n] += x times the k-tiles [first, first + COUNT) of a stage of N n-tiles. */
    template <int COUNT, int N>
    static __device__ void product(const uint32_t *stage, int first, int lane, const input *x, sums *to) {
        UNROLL
        for (int k = 0; k < COUNT; k++) {
            UNROLL
            for (int n = 0; n < N; n += 2) {
                const uint4 w =
                    *(const uint4 *)(stage + ((first + k) * (N / 2) + n / 2) * 2 * FRAGMENT + 4 * lane);
                const uint32_t low[2] = {w.x, w.y}, high[2] = {w.z, w.w};
                mma_bf16(to[n].c, x[k].a, low);
                mma_bf16(to[n + 1].c, x[k].a, high);
            }
        }
    }

    /* Over all K k-tiles of a layer, from stage to stage. */
    template <int K, int N> __device__ void layer(int lane, const input *x, sums *to) {
        UNROLL
        for (int k = 0; k < K / STAGE_TILES; k++)
            product<STAGE_TILES, N>(take(), 0, lane, x + k * STAGE_TILES, to);
        if (K % STAGE_TILES)
            product<K % STAGE_TILES, N>(take(), 0, lane, x + K / STAGE_TILES * STAGE_TILES, to);
    }
};

constexpr size_t resident_most = 40 << 10; /* bytes */
template <int H> constexpr size_t bf16_shared() {
    return (size_t)STAGES * STAGE_TILES * 2 * H * FRAGMENT * 4 + WARPS * TILE_POINTS * ENCODED_PITCH * 2 +
           resident_most;
}

/* H: k-tiles of the decoder's width. */
template <int H>
__global__ void __launch_bounds__(THREADS, 1)
    bf16_kernel(network_sizes s, bf16_layers layers, network_points points, float token_scale, int64_t base,
                int64_t most, const uint16_t *tokens, const float *color) {
    enum {
        N = 2 * H,
        STAGE_WORDS = STAGE_TILES * N * FRAGMENT,
        ENCODED_BYTES = TILE_POINTS * ENCODED_PITCH * 2
    };
    WIDE_SHARED(shared, bf16_shared<H>());
    uint32_t *ring = (uint32_t *)shared, *resident = ring + STAGES * STAGE_WORDS + WARPS * ENCODED_BYTES / 4;
    const int lane = (int)threadIdx.x % WARP, warp = (int)threadIdx.x / WARP, g = lane / 4, t = lane % 4;
    const resident_places at = resident_layout(s.heads, H, s.decoder_depth);
    const network_warp w = {resident,
                            (const float *)(resident + at.fragments * FRAGMENT),
                            (uint16_t *)(ring + STAGES * STAGE_WORDS) + warp * (ENCODED_BYTES / 2),
                            lane,
                            g,
                            t};
    const int64_t left = *points.count - base, end = left < most ? left : most;
    const int64_t tiles = end > 0 ? (end + WARPS * TILE_POINTS - 1) / (WARPS * TILE_POINTS) : 0;
    const int64_t own = tiles > blockIdx.x ? (tiles - blockIdx.x - 1) / gridDim.x + 1 : 0;
    if (own == 0) return;
    weight_stream<STAGE_WORDS> stream = {layers.stream, ring, layers.stages, 0, own * layers.stages, 0};
    for (int i = (int)threadIdx.x; i < layers.resident_bytes / 16; i += THREADS)
        ((uint4 *)resident)[i] = layers.resident[i];
    stream.begin();
    __syncthreads();

    for (int64_t tile = blockIdx.x; tile < tiles; tile += gridDim.x) {
        const int64_t first = (tile * WARPS + warp) * TILE_POINTS;
        /* points beyond the end are the last one again, and not written */
        const auto place = [&](int point) { return first + point < end ? first + point : end - 1; };
        const auto number = [&](int point) { return (int64_t)points.list[base + place(point)]; };
        input x[X_TILES], seen[TOKEN_TILES];
        {
            sums token[3][TOKEN_N];
            UNROLL
            for (int r = 0; r < 2; r++) {
                const uint16_t *from = tokens + place(g + 8 * r) * (3 * TOKEN);
                UNROLL
                for (int i = 0; i < 3 * TOKEN_N; i++) {
                    const uint32_t two = *(const uint32_t *)(from + 8 * i + 2 * t);
                    const float *b = w.values + at.token_b + 8 * i + 2 * t;
                    token[i / TOKEN_N][i % TOKEN_N].c[2 * r] = half_value((uint16_t)two) * token_scale + b[0];
                    token[i / TOKEN_N][i % TOKEN_N].c[2 * r + 1] =
                        half_value((uint16_t)(two >> 16)) * token_scale + b[1];
                }
            }
            if (s.color_width) {
                input encoded[COLOR_TILES];
                w.template encode<COLOR_TILES>([&](int p, int k) { return color[3 * place(p) + k]; },
                                               s.color_frequencies, s.color_width, encoded);
                w.template product<COLOR_TILES, TOKEN_N>(encoded, at.color, token[2]);
            }
            w.transform(s, at, token);
            UNROLL
            for (int k = 0; k < TOKEN_TILES; k++) {
                x[PLACE_TILES + k] = input_of(token[0][2 * k], token[0][2 * k + 1]);
                seen[k] = input_of(token[1][2 * k], token[1][2 * k + 1]);
            }
        }
        w.template encode<PLACE_TILES>([&](int p, int k) { return points.canonical[3 * number(p) + k]; },
                                       s.position_frequencies, s.position_width, x);
        input h[H];
        for (int layer = 0; layer < s.decoder_depth; layer++) {
            sums y[N];
            const float *b = w.values + at.pts_b + 8 * N * layer;
            UNROLL
            for (int n = 0; n < N; n++) y[n] = bias_of(b, n, t);
            if (layer == 0) {
                stream.template layer<X_TILES, N>(lane, x, y);
            } else if (layer == s.decoder_skip + 1) {
                input both[X_TILES + H];
                UNROLL
                for (int k = 0; k < X_TILES + H; k++)
                    both[k] = k < X_TILES ? x[k] : h[k < X_TILES ? 0 : k - X_TILES];
                stream.template layer<X_TILES + H, N>(lane, both, y);
            } else {
                stream.template layer<H, N>(lane, h, y);
            }
            UNROLL
            for (int k = 0; k < H; k++) h[k] = input_of(positive(y[2 * k]), positive(y[2 * k + 1]));
        }
        sums density = {}, rgb = {}, view[VIEW_N];
        w.template product<H, 1>(h, at.alpha, &density);
        {
            input all[H + DIRECTION_TILES + TOKEN_TILES];
            UNROLL
            for (int k = 0; k < H; k++) all[k] = h[k];
            w.template encode<DIRECTION_TILES>(
                [&](int p, int k) { return points.direction[3 * number(p) + k]; }, s.direction_frequencies,
                s.direction_width, all + H);
            UNROLL
            for (int k = 0; k < TOKEN_TILES; k++) all[H + DIRECTION_TILES + k] = seen[k];
            UNROLL
            for (int n = 0; n < VIEW_N; n++) view[n] = bias_of(w.values + at.views_b, n, t);
            stream.template layer<H + DIRECTION_TILES + TOKEN_TILES, VIEW_N>(lane, all, view);
        }
        input shown[VIEW_TILES];
        UNROLL
        for (int k = 0; k < VIEW_TILES; k++)
            shown[k] = input_of(positive(view[2 * k]), positive(view[2 * k + 1]));
        w.template product<VIEW_TILES, 1>(shown, at.rgb, &rgb);
        UNROLL
        for (int r = 0; r < 2; r++) { /* lane t has colour t; lane 0 the density, too */
            if (first + g + 8 * r >= end) continue;
            float *to = (float *)(points.result + number(g + 8 * r));
            const float y = rgb.c[2 * r] + rgb.c[2 * r + 1] + w.values[at.rgb_b + (t < 3 ? t : 0)];
            if (t < 3) to[t] = 1.002f / (1.0f + expf(-y)) - 0.001f;
            if (t == 0) to[3] = density.c[2 * r] + density.c[2 * r + 1] + w.values[at.rgb_b + 3];
        }
    }
    async_wait_but(0);
}

template <int H>
static void run_as(const placed_network *n, const network_points *points, int64_t base, int64_t most,
                   const network_scratch *scratch) {
    const int64_t tiles = divided_up(most, WARPS * TILE_POINTS);
    const int blocks = multiprocessors();
    if (tiles > 0)
        launch_wide(bf16_kernel<H>, dim3((unsigned)(tiles < blocks ? tiles : blocks)), dim3(THREADS),
                    bf16_shared<H>(), n->s, n->fragments, *points, 1 / n->bank.scale, base, most,
                    (const uint16_t *)scratch->tokens, (const float *)scratch->color);
}

void bf16_run(const placed_network *n, const network_points *points, int64_t base, int64_t most,
              const network_scratch *scratch) {
    if (h_tiles_of(n->s.decoder_width) == 6)
        run_as<6>(n, points, base, most, scratch);
    else
        run_as<8>(n, points, base, most, scratch);
}

} // namespace cuda_backend
