/* The radiance field in bf16 on tensor cores: shared by its kernels for frames (network_bf16.cu) and for
 * training (train_*.cu): where weights are stored, how they are loaded, and how a warp takes 16 points
 * through a layer. */
#ifndef SHERF_CUDA_NETWORK_BF16_H
#define SHERF_CUDA_NETWORK_BF16_H

#include "model/sherf/cuda/network.h"

namespace cuda_backend {

enum {
    WARPS = 8,
    TILE_POINTS = 16, /* in a warp */
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
    HEADS_MAX = 4,
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

__host__ __device__ inline resident_places resident_layout(int heads, int h_tiles, int depth) {
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

__host__ __device__ inline int resident_words(const resident_places &p) {
    return (p.fragments * FRAGMENT + p.floats + 3) / 4 * 4;
}

__host__ __device__ inline int h_tiles_of(int decoder_width) {
    return decoder_width <= 96 ? 6 : 8;
}

/* The decoder's number of stages: its layers' inputs in k-tiles, each of which starts a new stage. */
__host__ __device__ inline int tiles_stages(int k_tiles) {
    return (k_tiles + STAGE_TILES - 1) / STAGE_TILES;
}
enum { X_TILES = PLACE_TILES + TOKEN_TILES };
inline int layer_tiles(const network_sizes &s, int layer, int h_tiles) {
    return layer == 0 ? X_TILES : layer == s.decoder_skip + 1 ? X_TILES + h_tiles : h_tiles;
}

/* The column for each input of an encoding's k-tiles: the values, then the low parts of the first three
 * again. */
__host__ __device__ inline int encoded_column(int input, int width) {
    return input < width ? input : input < width + 3 ? input - width : -1;
}

/* [encoded position, token 0, h] */
__host__ __device__ inline int pts_column(const network_sizes &s, int layer, int input) {
    const bool first = layer == 0, wide = layer == s.decoder_skip + 1;
    if (!first && !wide) return input;
    if (input < 16 * PLACE_TILES) return encoded_column(input, s.position_width);
    if (input < 16 * X_TILES) return s.position_width + input - 16 * PLACE_TILES;
    return s.position_width + TOKEN + input - 16 * X_TILES;
}

/* [h, encoded direction, token 1] */
__host__ __device__ inline int views_column(const network_sizes &s, int h_tiles, int input) {
    const int h = s.decoder_width, direction = 16 * h_tiles, token = direction + 16 * DIRECTION_TILES;
    if (input < direction) return input < h ? input : -1;
    if (input < token) {
        const int column = encoded_column(input - direction, s.direction_width);
        return column < 0 ? -1 : h + column;
    }
    return h + s.direction_width + input - token;
}

/* ---- fragments ---- */
struct input { /* 16 points x 16 channels */
    uint32_t a[4];
};
struct sums { /* 16 points x 8 channels */
    float c[4];
};

/* Two neighbouring sums as input. */
__device__ inline input input_of(const sums &low, const sums &high) {
    return {{pack_bf16(low.c[0], low.c[1]), pack_bf16(low.c[2], low.c[3]), pack_bf16(high.c[0], high.c[1]),
             pack_bf16(high.c[2], high.c[3])}};
}

__device__ inline sums positive(const sums &s) {
    return {{fmaxf(s.c[0], 0), fmaxf(s.c[1], 0), fmaxf(s.c[2], 0), fmaxf(s.c[3], 0)}};
}

/* The initial values of this lane's sums of n-tile n. */
__device__ inline sums bias_of(const float *b, int n, int t) {
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

    /* x, then sin(2^k x), cos(2^k x), for one component of one point; and the bits of x that bf16 drops.
     * Sines of doubled angles are computed from the first: an error of 1e-7 grows to at most 6e-6. */
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

    /* One head: out[i] += its contribution to the attention's result, for tokens 0 and 1. */
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

    /* Tokens 0 and 1 through attention and feed-forward, in place; token 2 is only key and value. */
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
    int64_t next, end; /* the next one to copy, in this block's whole work */
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

    /* Waits for the next stage's weights. Called by all threads of the block. */
    __device__ const uint32_t *take() {
        async_wait_but(STAGES - 2);
        __syncthreads(); /* everybody's copies have arrived, and everybody has left the previous stage */
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

constexpr size_t resident_max = 40 << 10; /* bytes */

/* ---- fusion and decoder, forwards ---- */
template <int H> __host__ __device__ constexpr size_t decoder_shared() {
    return (size_t)STAGES * STAGE_TILES * 2 * H * FRAGMENT * 4 + WARPS * TILE_POINTS * ENCODED_PITCH * 2 +
           resident_max;
}

/* A warp's points, from list[base + first] on. Beyond the end the last one is repeated and not written. */
struct warp_points {
    const int32_t *list;
    int64_t base, first, end;
    __device__ int64_t place(int point) const { return first + point < end ? first + point : end - 1; }
    __device__ int64_t number(int point) const { return list[base + place(point)]; }
};

/* A block's work, tile by tile; H: k-tiles of the decoder's width. `shared` begins with decoder_shared<H>()
 * bytes: stages, encodings, the resident part. */
template <int H> struct decoder_block {
    enum {
        N = 2 * H,
        STAGE_WORDS = STAGE_TILES * N * FRAGMENT,
        ENCODED_BYTES = TILE_POINTS * ENCODED_PITCH * 2
    };
    int warp;
    int64_t tiles;
    resident_places at;
    network_warp w;
    weight_stream<STAGE_WORDS> stream;

    /* False: the block has none of the `end` points. */
    __device__ bool begin(const network_sizes &s, const bf16_layers &layers, int stages, int64_t end,
                          unsigned char *shared) {
        uint32_t *ring = (uint32_t *)shared,
                 *resident = ring + STAGES * STAGE_WORDS + WARPS * ENCODED_BYTES / 4;
        const int lane = (int)threadIdx.x % WARP;
        warp = (int)threadIdx.x / WARP;
        at = resident_layout(s.heads, H, s.decoder_depth);
        w = {resident,
             (const float *)(resident + at.fragments * FRAGMENT),
             (uint16_t *)(ring + STAGES * STAGE_WORDS) + warp * (ENCODED_BYTES / 2),
             lane,
             lane / 4,
             lane % 4};
        tiles = end > 0 ? (end + WARPS * TILE_POINTS - 1) / (WARPS * TILE_POINTS) : 0;
        const int64_t own = tiles > blockIdx.x ? (tiles - blockIdx.x - 1) / gridDim.x + 1 : 0;
        if (own == 0) return false;
        stream = {layers.stream, ring, stages, 0, own * stages, 0};
        for (int i = (int)threadIdx.x; i < layers.resident_bytes / 16; i += THREADS)
            ((uint4 *)resident)[i] = layers.resident[i];
        stream.begin();
        return true;
    }

    /* The view layer, from the last layer's result, the direction and the second token. */
    template <typename T>
    __device__ void show(const network_sizes &s, const T &task, const input *h, const input *seen,
                         input *shown) {
        sums view[VIEW_N];
        input all[H + DIRECTION_TILES + TOKEN_TILES];
        UNROLL
        for (int k = 0; k < H; k++) all[k] = h[k];
        w.template encode<DIRECTION_TILES>([&](int p, int k) { return task.direction(p, k); },
                                           s.direction_frequencies, s.direction_width, all + H);
        UNROLL
        for (int k = 0; k < TOKEN_TILES; k++) all[H + DIRECTION_TILES + k] = seen[k];
        if constexpr (T::KEEPS) task.turned(w, all + H);
        UNROLL
        for (int n = 0; n < VIEW_N; n++) view[n] = bias_of(w.values + at.views_b, n, w.t);
        stream.template layer<H + DIRECTION_TILES + TOKEN_TILES, VIEW_N>(w.lane, all, view);
        if constexpr (T::KEEPS) task.view_sums(view);
        UNROLL
        for (int k = 0; k < VIEW_TILES; k++)
            shown[k] = input_of(positive(view[2 * k]), positive(view[2 * k + 1]));
    }

    /* Takes the warp's points through fusion and decoder. h: the last layer's result; shown: the view
     * layer's. The task reads the points, given by p and k, and, if it KEEPS something, sees the values
     * between layers. */
    template <typename T>
    __device__ void forward(const network_sizes &s, const T &task, input *h, input *shown) {
        const int t = w.t;
        input x[X_TILES], seen[TOKEN_TILES];
        {
            sums token[3][TOKEN_N];
            task.tokens(w, w.values + at.token_b, token);
            if (s.color_width) {
                input encoded[COLOR_TILES];
                w.template encode<COLOR_TILES>([&](int p, int k) { return task.color(p, k); },
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
        w.template encode<PLACE_TILES>([&](int p, int k) { return task.position(p, k); },
                                       s.position_frequencies, s.position_width, x);
        if constexpr (T::KEEPS) task.fused(w, x, seen);
        for (int layer = 0; layer < s.decoder_depth; layer++) {
            sums y[N];
            const float *b = w.values + at.pts_b + 8 * N * layer;
            UNROLL
            for (int n = 0; n < N; n++) y[n] = bias_of(b, n, t);
            if (layer == 0) {
                stream.template layer<X_TILES, N>(w.lane, x, y);
            } else if (layer == s.decoder_skip + 1) {
                input both[X_TILES + H];
                UNROLL
                for (int k = 0; k < X_TILES + H; k++)
                    both[k] = k < X_TILES ? x[k] : h[k < X_TILES ? 0 : k - X_TILES];
                stream.template layer<X_TILES + H, N>(w.lane, both, y);
            } else {
                stream.template layer<H, N>(w.lane, h, y);
            }
            if constexpr (T::KEEPS) task.layer_sums(layer, y);
            UNROLL
            for (int k = 0; k < H; k++) {
                h[k] = input_of(positive(y[2 * k]), positive(y[2 * k + 1]));
                if constexpr (T::KEEPS) task.layer_result(w, layer, k, h[k]);
            }
        }
        show(s, task, h, seen, shown);
    }

    /* Computes colour and raw density of the points from forward's output: put(number, channel, value). */
    template <typename F>
    __device__ void answer(const warp_points &points, const input *h, const input *shown, F put) const {
        const int t = w.t;
        sums density = {}, rgb = {};
        w.template product<H, 1>(h, at.alpha, &density);
        w.template product<VIEW_TILES, 1>(shown, at.rgb, &rgb);
        UNROLL
        for (int r = 0; r < 2; r++) { /* lane t has colour t; lane 0 also the density */
            if (points.first + w.g + 8 * r >= points.end) continue;
            const int64_t number = points.number(w.g + 8 * r);
            const float y = rgb.c[2 * r] + rgb.c[2 * r + 1] + w.values[at.rgb_b + (t < 3 ? t : 0)];
            if (t < 3) put(number, t, 1.002f / (1.0f + expf(-y)) - 0.001f);
            if (t == 0) put(number, 3, density.c[2 * r] + density.c[2 * r + 1] + w.values[at.rgb_b + 3]);
        }
    }
};

/* Runs the kernel over this many points, one block on each multiprocessor. */
template <typename K, typename... A>
void decoder_launch(K kernel, int64_t points, size_t shared, A... arguments) {
    const int64_t tiles = divided_up(points, WARPS * TILE_POINTS);
    const int blocks = multiprocessors();
    if (tiles > 0)
        launch_wide(kernel, dim3((unsigned)(tiles < blocks ? tiles : blocks)), dim3(THREADS), shared,
                    arguments...);
}

} // namespace cuda_backend
#endif
