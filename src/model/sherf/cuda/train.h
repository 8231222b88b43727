/* The fused radiance field in training (bf16): shared by its kernels. The forward pass takes every tile of
 * 128 points through train_decoder.cu as a frame does. The backward pass works on a chunk of points at a
 * time: the decoder forward again and backward (train_decoder.cu), then fusion forward again and backward
 * (train_fusion.cu). Both store each layer's input and the gradient of its output as fragments in a record
 * for each group of 16 points. Then every matrix's gradient is computed from the records, in a fixed number
 * of slabs (train_weights.cu). Last, the gradients of sampled values go to the bank, sorted by their places
 * (train_bank.cu). There are no atomic additions. */
#ifndef SHERF_CUDA_TRAIN_H
#define SHERF_CUDA_TRAIN_H

#include "model/sherf/cuda/network_bf16.h"

namespace cuda_backend {

#ifdef CUDA_EMULATED
constexpr int64_t train_at_a_time = 512; /* so that tests have more than one */
#else
constexpr int64_t train_at_a_time = 1 << 15; /* points of a chunk; a multiple of a block's */
#endif
enum {
    BLOCK_POINTS = WARPS * TILE_POINTS,
    FUSION_BLOCKS = 128, /* each with its own sums, on any GPU */
    SLABS = 32,          /* of a chunk's groups, each with its own sums */
    TOKENS = 3 * TOKEN,
    TRAIN_PARTS = 3 + 1 + POINT_LEVELS
};

/* ---- the bank ---- */
/* One of its arrays and how points read it: at coordinate[axis] a cell is (x - origin) scale - half. */
struct train_part {
    int axes; /* 2 or 3 */
    bool pixel;
    int axis[3], size[3]; /* the first runs fastest */
    float origin[3], scale[3], half;
    const int32_t *grid; /* row of a cell, or -1; NULL: the cell is the row */
    int token, tokens;   /* whose channels a row has */
    int64_t rows;
    const float *values;
};
struct train_bank {
    train_part part[TRAIN_PARTS], image; /* tokens of the image: 0, it has three values per row */
};

/* ---- a group's record, in tiles of 16 channels ---- */
struct record_places {
    int x, h, direction, token1, shown; /* inputs of the decoder's layers; h by layer */
    int dh, dviews, dout, dalpha;       /* gradients of outputs */
    int color, n0, mixed, n1, gelu;     /* fusion's, by token */
    int dcolor, dqkv, dattended, dpre, dlast;
    int tiles;
};

/* ---- gradients of matrices, as sums [16 row tiles][16 column tiles] and of rows ---- */
struct matrix_sums {
    int row_tiles, column_tiles;
    int64_t w, b;
};
struct all_sums {
    RADIANCE_MEMBERS(matrix_sums) /* views: h, direction, token 1 */
    int64_t floats;
};
/* A warp's part of a matrix: up to 2 x 4 tiles. */
struct sums_unit {
    int dy, x, rows, columns; /* tiles of the record, and how many */
    int tokens, dy_step, x_step;
    int pitch;    /* floats of a row */
    int64_t w, b; /* b: -1 where another unit has the rows' sums */
};

/* ---- sums of vectors' gradients, by lane (train_fusion.cu) ---- */
enum { NORM0_W, NORM0_B, NORM1_W, NORM1_B, TOKEN_B, VECTORS = TOKEN_B + 3, VECTOR_SLOTS = VECTORS * 8 };

/* ---- weights of the backward pass that stay in shared memory, as fragments ---- */
struct back_places {
    int rgb, heads, mlp0, mlp1, fragments;
};
enum { BACK_OUT = 4, BACK_EACH = BACK_OUT + 3 * TOKEN_N }; /* of a head: out, then q, k, v */
__host__ __device__ inline back_places back_layout(int heads) {
    back_places p;
    p.rgb = 0;
    p.heads = VIEW_N;
    p.mlp0 = p.heads + heads * BACK_EACH;
    p.mlp1 = p.mlp0 + TOKEN_TILES * TOKEN_N;
    p.fragments = p.mlp1 + TOKEN_TILES * TOKEN_N;
    return p;
}
constexpr size_t back_max = (VIEW_N + HEADS_MAX * BACK_EACH + 2 * TOKEN_TILES * TOKEN_N) * FRAGMENT * 4;

/* ---- one chunk ---- */
struct train_run {
    network_sizes s;
    bf16_layers layers; /* its stages: the forward ones, then the backward ones */
    int back_stages;
    const uint4 *back; /* resident */
    record_places at;
    const float *canonical, *direction, *observed_px;
    const int32_t *list, *count; /* points list[base + i], i < max, base + i < *count */
    int64_t base, max;
    float *tokens, *color; /* sampled: max x TOKENS, max x 3 */
    float *rgb, *sigma;    /* of all points: the forward pass writes them, the backward pass reads rgb */
    const float *drgb, *dsigma;
    uint4 *records;
    float *dfused;  /* max x 2 TOKEN: gradients of fusion's result */
    float *dtokens; /* [index in the list][TOKENS]: of sampled values */
    float *vectors; /* FUSION_BLOCKS x VECTOR_SLOTS x THREADS */
};

__device__ inline int64_t chunk_points(const train_run &r) {
    const int64_t left = *r.count - r.base;
    return left < r.max ? left : r.max;
}

/* Stores a tile in the group's record, transposed: it is then 16 outputs x 16 points of a product's left
 * side, or two fragments of 16 points x 8 inputs of its right side. */
__device__ inline void keep(uint4 *record, int tile, int lane, const input &x) {
    record[tile * WARP + lane] =
        make_uint4(transpose8(x.a[0]), transpose8(x.a[2]), transpose8(x.a[1]), transpose8(x.a[3]));
}

/* Loads the sampled values of the points `row` of the chunk, with their biases. */
__device__ inline void load_tokens(const train_run &r, const float *token_b, const int64_t row[2], int t,
                                   int count, sums (*token)[TOKEN_N]) {
    UNROLL
    for (int half = 0; half < 2; half++) {
        const float *from = r.tokens + row[half] * TOKENS + 2 * t, *b = token_b + 2 * t;
        UNROLL
        for (int i = 0; i < 3 * TOKEN_N; i++) {
            if (i >= count * TOKEN_N) continue;
            token[i / TOKEN_N][i % TOKEN_N].c[2 * half] = from[8 * i] + b[8 * i];
            token[i / TOKEN_N][i % TOKEN_N].c[2 * half + 1] = from[8 * i + 1] + b[8 * i + 1];
        }
    }
}

/* ---- made once per observation ---- */
struct train_network {
    network_sizes s;
    int h_tiles, feature_channels;
    train_bank bank;
    radiance_weights w;  /* the device's */
    const float *merged; /* the view layer's with the feature layer in it: [view_width][decoder_width] */
    bf16_layers layers;
    int back_stages;
    const uint4 *back;
    record_places at;
    all_sums sums;
    int units;
    const sums_unit *unit;
};

/* train_pack.cu */
sherf_status train_pack(tape *t, train_network *n);
/* train_bank.cu */
void train_bank_of(const radiance_sizes *s, const radiance_bank *b, train_bank *out);
void train_sample(const train_network *n, const train_run &r);
sherf_status train_scatter(context *c, arena *scratch, const train_network *n, const train_run &all,
                           int64_t points, const radiance_gradients *out);
/* train_decoder.cu */
void train_decode(const train_network *n, const train_run &r, bool back);
/* train_fusion.cu */
void train_fusion(const train_run &r);
/* train_weights.cu */
void train_sums_plan(const network_sizes &s, int h_tiles, record_places *at, all_sums *out);
/* The units of all matrices; unit may be NULL. Returns their number. */
int train_units(const network_sizes &s, int h_tiles, const record_places &at, const all_sums &sums,
                sums_unit *unit);
void train_weights(const train_network *n, const train_run &r, float *partial);
/* Adds the sums to the gradients of the weights. total: n->sums.floats; vector: VECTORS x TOKEN. */
void train_unpack(const train_network *n, const float *partial, const float *vectors, float *total,
                  float *vector, const radiance_gradients *out);

} // namespace cuda_backend
#endif
