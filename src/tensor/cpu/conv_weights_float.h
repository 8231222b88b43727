/* Gradients of convolutions' weights: sums over pixels of u[pixel][a] v[tap of the pixel][b]. u is the
 * smaller of the two pictures (the result, or the input of a transposed convolution); v is read at k x k taps
 * of a step. A band of rows is packed. Then each thread takes its own columns b and rows of taps, so every
 * sum belongs to one thread. One file for each instruction set includes this; it defines LANES, U_BLOCK x
 * VECTORS (the block of sums in registers), LEVEL (ISA_...), and CHANNELS and WIDTH, from which on this is
 * faster than oneDNN. */
#include <string.h>

#include "base/simd.h"
#include "tensor/cpu/conv_weights.h"

enum { A = U_BLOCK, B = LANES * VECTORS };
#define UNROLL _Pragma("GCC unroll 8")

typedef struct {
    const float *at;
    int64_t H, W, C;
} picture;

typedef struct {
    picture u, v;
    int64_t k, step, pad;
    int64_t a_blocks, b_blocks, v_width; /* columns of v that a row of u reads */
    int64_t first, rows, band;           /* rows of u in this band, and in any band */
    float *u_rows;                       /* [row][a block][W][A] */
    float *v_rows;                       /* [row][b block][v_width][B], row 0 and column 0 `pad` before v */
    float *sums;                         /* [k][k][b block][a block][A][B] */
    float gain, *dw;
    int64_t a_step, b_step; /* of dw */
} job;

bool conv_weights_fits(const conv_shape *s) {
    const int64_t width = s->transpose ? s->W : s->Wo;
    return isa_best() == LEVEL && s->I >= CHANNELS && s->O >= CHANNELS && width >= WIDTH;
}

/* ---- a band of rows, packed ---- */
static void pack_u(const job *j, int64_t row) {
    const picture *u = &j->u;
    const float *from = u->at + (j->first + row) * u->W * u->C;
    float *to = j->u_rows + row * j->a_blocks * u->W * A;
    for (int64_t a = 0; a < u->C; a += A, to += u->W * A) {
        const int64_t count = u->C - a < A ? u->C - a : A;
        if (count == A)
            for (int64_t x = 0; x < u->W; x++) memcpy(to + x * A, from + x * u->C + a, A * sizeof(float));
        else
            for (int64_t x = 0; x < u->W; x++)
                for (int64_t i = 0; i < A; i++) to[x * A + i] = i < count ? from[x * u->C + a + i] : 0;
    }
}

static void pack_v(const job *j, int64_t row) {
    const picture *v = &j->v;
    const int64_t y = j->first * j->step + row - j->pad;
    float *to = j->v_rows + row * j->b_blocks * j->v_width * B;
    if (y < 0 || y >= v->H) return; /* not read */
    for (int64_t b = 0; b < v->C; b += B, to += j->v_width * B) {
        const int64_t count = v->C - b < B ? v->C - b : B;
        memset(to, 0, (size_t)(j->v_width * B) * sizeof(float));
        for (int64_t x = 0; x < j->v_width; x++) {
            const int64_t at = x - j->pad;
            if (at >= 0 && at < v->W)
                memcpy(to + x * B, v->at + (y * v->W + at) * v->C + b, (size_t)count * sizeof(float));
        }
    }
}

static void pack_range(void *arg, int64_t begin, int64_t end, int thread) {
    const job *j = arg;
    for (int64_t i = begin; i < end; i++) i < j->rows ? pack_u(j, i) : pack_v(j, i - j->rows);
}

/* ---- products ---- */
/* sums [A][B] += over a row's pixels of u [A] v [B]; v_step: floats from one pixel's tap to the next's. */
INLINE void row_block(const float *u, const float *v, int64_t width, int64_t v_step, float *sums) {
    vf sum[A][VECTORS];
    UNROLL for (int a = 0; a < A; a++) UNROLL for (int i = 0; i < VECTORS; i++) sum[a][i] =
        load(sums + a * B + i * LANES);
    for (int64_t x = 0; x < width; x++, u += A, v += v_step) {
        vf in[VECTORS];
        numbers some[A / NUMBERS];
        UNROLL for (int i = 0; i < VECTORS; i++) in[i] = load(v + i * LANES);
        UNROLL for (int a = 0; a < A / NUMBERS; a++) some[a] = numbers_load(u + a * NUMBERS);
        UNROLL for (int a = 0; a < A; a++) {
            const vf one = number(some[a / NUMBERS], a % NUMBERS);
            UNROLL for (int i = 0; i < VECTORS; i++) sum[a][i] += one * in[i];
        }
    }
    UNROLL for (int a = 0; a < A; a++) UNROLL for (int i = 0; i < VECTORS; i++)
        store(sums + a * B + i * LANES, sum[a][i]);
}

/* A unit: a block of b and a row of taps. */
static void product_range(void *arg, int64_t begin, int64_t end, int thread) {
    const job *j = arg;
    for (int64_t unit = begin; unit < end; unit++) {
        const int64_t b = unit / j->k, ky = unit % j->k;
        for (int64_t row = 0; row < j->rows; row++) {
            const int64_t v_row = row * j->step + ky, y = j->first * j->step + v_row - j->pad;
            if (y < 0 || y >= j->v.H) continue;
            const float *v = j->v_rows + (v_row * j->b_blocks + b) * j->v_width * B;
            for (int64_t kx = 0; kx < j->k; kx++)
                for (int64_t a = 0; a < j->a_blocks; a++)
                    row_block(j->u_rows + (row * j->a_blocks + a) * j->u.W * A, v + kx * B, j->u.W,
                              j->step * B,
                              j->sums + (((ky * j->k + kx) * j->b_blocks + b) * j->a_blocks + a) * A * B);
        }
    }
}

/* A row a of the weights: += gain times its sums. */
static void add_range(void *arg, int64_t begin, int64_t end, int thread) {
    const job *j = arg;
    for (int64_t a = begin; a < end; a++)
        for (int64_t b = 0; b < j->v.C; b++)
            for (int64_t t = 0; t < j->k * j->k; t++) {
                const float *sums = j->sums + ((t * j->b_blocks + b / B) * j->a_blocks + a / A) * A * B;
                j->dw[a * j->a_step + b * j->b_step + t] += j->gain * sums[a % A * B + b % B];
            }
}

static sherf_status run(op_call *call, job *j) {
    context *c = call->c;
    const size_t u_floats = (size_t)(j->a_blocks * j->u.W * A),
                 v_floats = (size_t)(j->b_blocks * j->v_width * B), taps = (size_t)(j->k * j->k),
                 sums = taps * (size_t)(j->a_blocks * j->b_blocks * A * B);
    j->band = (int64_t)((256 << 10) / (u_floats + v_floats * (size_t)j->step)); /* a megabyte */
    j->band = j->band < 8 ? 8 : j->band > 64 ? 64 : j->band;
    if (j->band > j->u.H) j->band = j->u.H;
    j->u_rows = arena_alloc(c, call->scratch, (size_t)j->band * u_floats, sizeof(float));
    j->v_rows = arena_alloc(c, call->scratch, (size_t)(j->band * j->step + j->k) * v_floats, sizeof(float));
    j->sums = arena_alloc(c, call->scratch, sums, sizeof(float));
    if (!j->u_rows || !j->v_rows || !j->sums) return SHERF_NO_MEMORY;
    memset(j->sums, 0, sums * sizeof(float));
    for (j->first = 0; j->first < j->u.H; j->first += j->band) {
        j->rows = j->u.H - j->first < j->band ? j->u.H - j->first : j->band;
        parallel_for(c, j->rows + (j->rows - 1) * j->step + j->k, 1, pack_range, j);
        parallel_for(c, j->b_blocks * j->k, 1, product_range, j);
    }
    parallel_for(c, j->u.C, 1 + 4096 / (j->v.C * (int64_t)taps), add_range, j);
    return SHERF_OK;
}

sherf_status conv_weights_add(op_call *call, const conv_shape *s, const float *x, const float *dy,
                              float *dw) {
    const int64_t T = s->k * s->k;
    const picture in = {x, s->H, s->W, s->I}, out = {dy, s->Ho, s->Wo, s->O};
    job j = {.u = s->transpose ? in : out,
             .v = s->transpose ? out : in,
             .k = s->k,
             .step = s->stride,
             .pad = s->pad,
             .gain = s->gain,
             .dw = dw,
             .a_step = s->transpose ? T : s->I * T,
             .b_step = s->transpose ? s->I * T : T};
    j.a_blocks = (j.u.C + A - 1) / A;
    j.b_blocks = (j.v.C + B - 1) / B;
    j.v_width = (j.u.W - 1) * j.step + j.k;
    return run(call, &j);
}
