/* Winograd's convolutions for AVX2 without AVX-512 (the build compiles this file for AVX2): a band of rows of
 * tiles is transformed, multiplied and transformed back by one thread. On other processors, stubs. */
#include "tensor/cpu/conv_winograd.h"

#if defined(__AVX2__)
#include <string.h>

#define LANES 8
#define PIXELS 6
#define VECTORS 2
#include "tensor/cpu/conv_block_float.h"

enum {
    STEP = 4, /* a tile's outputs a side */
    SIDE = 6, /* and inputs */
    PLACES = SIDE * SIDE,
    BAND_FLOATS = 512 << 10, /* a thread's transformed tiles, if there are few channels, */
    BAND_TILES = 128,        /* or many, so that the weights are read less often */
    SHIFT = 16               /* so that the places of a tile do not meet in the same set of the cache */
};

/* y [H][W][O] = or += gain times the sums over taps and inputs of x [H][W][I], with a border of zeros, and w.
 */
typedef struct {
    const float *x, *w;
    float *y;
    int64_t H, W, I, O;
    int64_t o_step, i_step; /* of w; a tap's step is 1 */
    bool turned;            /* the taps of w from the last to the first */
    bool add;
    float gain;
    int64_t blocks, across, down, band; /* of outputs; tiles; rows of tiles a band */
    int64_t in_step, out_step;          /* floats from one place to the next */
    float *weights;                     /* [place][block][input][OUT] */
    float *in, *out, *edge; /* one part a thread: [place][tile][I or blocks OUT]; [SIDE][SIDE][I] */
} job;

bool conv_winograd_fits(const conv_shape *s) {
    return isa_best() == ISA_AVX2 && !s->transpose && s->k == 3 && s->stride == 1 && s->pad == 1 &&
           s->I % LANES == 0 && s->O % LANES == 0 && s->I >= 32 && s->O >= 32 && s->W >= 32;
}

/* ---- weights: G g G^T ---- */
INLINE void weights_1d(vf a, vf b, vf c, vf *to, int step) {
    const vf even = (a + c) * (-1.0f / 6), far = a * (1.0f / 24) + c * (1.0f / 6);
    to[0] = a * 0.25f;
    to[step] = even - b * (1.0f / 6);
    to[2 * step] = even + b * (1.0f / 6);
    to[3 * step] = far + b * (1.0f / 12);
    to[4 * step] = far - b * (1.0f / 12);
    to[5 * step] = c;
}

/* LANES outputs' taps of one input, with the gain. */
static void taps_load(const job *j, int64_t out, int64_t input, vf tap[9]) {
    float some[9][LANES] = {0};
    for (int o = 0; o < LANES && out + o < j->O; o++)
        for (int t = 0; t < 9; t++)
            some[t][o] = j->gain * j->w[(out + o) * j->o_step + input * j->i_step + (j->turned ? 8 - t : t)];
    for (int t = 0; t < 9; t++) tap[t] = load(some[t]);
}

static void weights_range(void *arg, int64_t begin, int64_t end, int thread) {
    const job *j = arg;
    for (int64_t at = begin; at < end; at++) { /* a block's input */
        for (int v = 0; v < VECTORS; v++) {
            vf tap[9], half[SIDE * 3], all[PLACES];
            taps_load(j, at / j->I * OUT + v * LANES, at % j->I, tap);
            for (int x = 0; x < 3; x++) weights_1d(tap[x], tap[3 + x], tap[6 + x], half + x, 3);
            for (int y = 0; y < SIDE; y++)
                weights_1d(half[3 * y], half[3 * y + 1], half[3 * y + 2], all + SIDE * y, 1);
            for (int p = 0; p < PLACES; p++)
                store(j->weights + (p * j->blocks * j->I + at) * OUT + v * LANES, all[p]);
        }
    }
}

/* ---- inputs: B^T d B ---- */
INLINE void inputs_1d(const vf d[SIDE], vf *to, int step) {
    const vf even = d[4] - 4 * d[2], odd = d[3] - 4 * d[1], far_even = d[4] - d[2],
             far_odd = 2 * (d[3] - d[1]);
    to[0] = 4 * d[0] - 5 * d[2] + d[4];
    to[step] = even + odd;
    to[2 * step] = even - odd;
    to[3 * step] = far_even + far_odd;
    to[4 * step] = far_even - far_odd;
    to[5 * step] = 4 * d[1] - 5 * d[3] + d[5];
}

/* A tile whose first input is at x, rows `row` floats apart; `to` has its first place. */
static void tile_inputs(const job *j, const float *x, int64_t row, float *to) {
    for (int64_t i = 0; i < j->I; i += LANES) {
        vf half[PLACES], all[PLACES];
        UNROLL for (int c = 0; c < SIDE; c++) {
            vf d[SIDE];
            UNROLL for (int r = 0; r < SIDE; r++) d[r] = load(x + r * row + c * j->I + i);
            inputs_1d(d, half + c, SIDE);
        }
        UNROLL for (int r = 0; r < SIDE; r++) inputs_1d(half + SIDE * r, all + SIDE * r, 1);
        for (int p = 0; p < PLACES; p++) store(to + p * j->in_step + i, all[p]);
    }
}

/* The inputs of a tile that reaches over the picture's edge, from row y and column x on. */
static void edge_copy(const job *j, int64_t y, int64_t x, float *edge) {
    const int64_t left = x < 0 ? -x : 0, right = x + SIDE > j->W ? j->W - x : SIDE;
    memset(edge, 0, (size_t)(PLACES * j->I) * sizeof *edge);
    for (int64_t r = 0; r < SIDE; r++)
        if (y + r >= 0 && y + r < j->H)
            memcpy(edge + (r * SIDE + left) * j->I, j->x + ((y + r) * j->W + x + left) * j->I,
                   (size_t)((right - left) * j->I) * sizeof *edge);
}

static void band_inputs(const job *j, int64_t first, int64_t tiles, float *edge, float *to) {
    for (int64_t t = 0; t < tiles; t++, to += j->I) {
        const int64_t y = (first + t / j->across) * STEP - 1, x = t % j->across * STEP - 1;
        if (y >= 0 && x >= 0 && y + SIDE <= j->H && x + SIDE <= j->W) {
            tile_inputs(j, j->x + (y * j->W + x) * j->I, j->W * j->I, to);
            continue;
        }
        edge_copy(j, y, x, edge);
        tile_inputs(j, edge, SIDE * j->I, to);
    }
}

/* ---- products ---- */
/* Each place's [tiles][I] x [I][O]; tiles are a multiple of PIXELS. */
static void band_products(const job *j, int64_t tiles, const float *in, float *out) {
    const int64_t O = j->blocks * OUT;
    for (int64_t p = 0; p < PLACES; p++)
        for (int64_t b = 0; b < j->blocks; b++) {
            const float *w = j->weights + (p * j->blocks + b) * j->I * OUT;
            for (int64_t t = 0; t < tiles; t += PIXELS) {
                block_sums sum;
                block_clear(sum);
                add_run(in + p * j->in_step + t * j->I, j->I, w, j->I, sum);
                float *to = out + p * j->out_step + t * O + b * OUT;
                UNROLL for (int k = 0; k < PIXELS; k++) UNROLL for (int v = 0; v < VECTORS; v++)
                    store(to + k * O + v * LANES, sum[k][v]);
            }
        }
}

/* ---- outputs: A^T m A ---- */
INLINE void outputs_1d(const vf m[SIDE], vf *to, int step) {
    const vf even = m[1] + m[2], odd = m[1] - m[2], far_even = m[3] + m[4], far_odd = m[3] - m[4];
    to[0] = m[0] + even + far_even;
    to[step] = odd + 2 * far_odd;
    to[2 * step] = even + 4 * far_even;
    to[3 * step] = odd + 8 * far_odd + m[5];
}

/* From a tile's first place to y, its first output; `rows` x `columns` of them are inside the picture. */
static void tile_outputs(const job *j, const float *from, float *y, int64_t rows, int64_t columns) {
    for (int64_t o = 0; o < j->O; o += LANES) {
        vf half[STEP * SIDE], all[STEP * STEP];
        UNROLL for (int c = 0; c < SIDE; c++) {
            vf m[SIDE];
            UNROLL for (int r = 0; r < SIDE; r++) m[r] = load(from + (r * SIDE + c) * j->out_step + o);
            outputs_1d(m, half + c, SIDE);
        }
        UNROLL for (int r = 0; r < STEP; r++) outputs_1d(half + SIDE * r, all + STEP * r, 1);
        for (int64_t r = 0; r < rows; r++)
            for (int64_t c = 0; c < columns; c++) {
                float *to = y + (r * j->W + c) * j->O + o;
                store(to, all[r * STEP + c] + (j->add ? load(to) : splat(0)));
            }
    }
}

static void band_outputs(const job *j, int64_t first, int64_t tiles, const float *from) {
    for (int64_t t = 0; t < tiles; t++, from += j->blocks * OUT) {
        const int64_t y = (first + t / j->across) * STEP, x = t % j->across * STEP;
        const int64_t rows = j->H - y < STEP ? j->H - y : STEP, columns = j->W - x < STEP ? j->W - x : STEP;
        tile_outputs(j, from, j->y + (y * j->W + x) * j->O, rows, columns);
    }
}

static int64_t whole_blocks(int64_t tiles) {
    return (tiles + PIXELS - 1) / PIXELS * PIXELS;
}

static void band_range(void *arg, int64_t begin, int64_t end, int thread) {
    const job *j = arg;
    float *in = j->in + thread * PLACES * j->in_step, *out = j->out + thread * PLACES * j->out_step;
    for (int64_t at = begin; at < end; at++) {
        const int64_t first = at * j->band, left = j->down - first;
        const int64_t tiles = (left < j->band ? left : j->band) * j->across;
        band_inputs(j, first, tiles, j->edge + thread * PLACES * j->I, in);
        band_products(j, whole_blocks(tiles), in, out);
        band_outputs(j, first, tiles, out);
    }
}

static sherf_status run(op_call *call, job *j) {
    context *c = call->c;
    j->blocks = (j->O + OUT - 1) / OUT;
    j->across = (j->W + STEP - 1) / STEP;
    j->down = (j->H + STEP - 1) / STEP;
    const int64_t few = BAND_FLOATS / (PLACES * (j->I + j->blocks * OUT)),
                  tiles = few > BAND_TILES ? few : BAND_TILES,
                  shared = (j->down + c->threads - 1) / c->threads;
    j->band = (tiles + j->across - 1) / j->across;
    if (j->band > shared) j->band = shared;
    j->in_step = whole_blocks(j->band * j->across) * j->I + SHIFT;
    j->out_step = whole_blocks(j->band * j->across) * j->blocks * OUT + SHIFT;
    const size_t part = PLACES * (size_t)c->threads * sizeof(float);
    j->weights = arena_alloc(c, call->scratch, (size_t)(PLACES * j->blocks * j->I), OUT * sizeof(float));
    j->in = arena_alloc(c, call->scratch, (size_t)j->in_step, part);
    j->out = arena_alloc(c, call->scratch, (size_t)j->out_step, part);
    j->edge = arena_alloc(c, call->scratch, (size_t)j->I, part);
    if (!j->weights || !j->in || !j->out || !j->edge) return SHERF_NO_MEMORY;
    parallel_for(c, j->blocks * j->I, 64, weights_range, j);
    parallel_for(c, (j->down + j->band - 1) / j->band, 1, band_range, j);
    return SHERF_OK;
}

sherf_status conv_winograd_forward(op_call *call, const conv_shape *s, const float *x, const float *w,
                                   float *y) {
    return run(call, &(job){.x = x,
                            .w = w,
                            .y = y,
                            .H = s->H,
                            .W = s->W,
                            .I = s->I,
                            .O = s->O,
                            .o_step = s->I * 9,
                            .i_step = 9,
                            .gain = s->gain});
}

/* A convolution of dy with inputs and outputs exchanged and taps reversed. */
sherf_status conv_winograd_data(op_call *call, const conv_shape *s, const float *dy, const float *w, bool add,
                                float *dx) {
    return run(call, &(job){.x = dy,
                            .w = w,
                            .y = dx,
                            .H = s->H,
                            .W = s->W,
                            .I = s->O,
                            .O = s->I,
                            .o_step = 9,
                            .i_step = s->I * 9,
                            .turned = true,
                            .add = add,
                            .gain = s->gain});
}
#else
bool conv_winograd_fits(const conv_shape *s) {
    return false;
}
sherf_status conv_winograd_forward(op_call *call, const conv_shape *s, const float *x, const float *w,
                                   float *y) {
    return failure(call->c, SHERF_UNSUPPORTED, "no Winograd convolutions for this processor");
}
sherf_status conv_winograd_data(op_call *call, const conv_shape *s, const float *dy, const float *w, bool add,
                                float *dx) {
    return failure(call->c, SHERF_UNSUPPORTED, "no Winograd convolutions for this processor");
}
#endif
