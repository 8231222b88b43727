/* Convolutions: blocks of PIXELS x VECTORS vectors of outputs stay in registers over all taps and inputs. A
 * thread packs a band of rows with their borders and computes every block of outputs from it. One file for
 * each instruction set includes this; it defines LANES, PIXELS, VECTORS, LEVEL (ISA_...), and KERNEL,
 * CHANNELS and WIDTH, from which on this is faster than oneDNN. */
#include <string.h>

#include "tensor/cpu/conv_block_float.h"
#include "tensor/cpu/conv_rows.h"

enum { BAND_FLOATS = 64 << 10 };

/* y [Ho][Wo][O] = or += gain times the sums over taps and inputs of x [H][W][I] and w. */
typedef struct {
    const float *x, *w;
    float *y;
    int64_t H, W, I, Ho, Wo, O, k, step, pad;
    int64_t o_step, i_step; /* of w; a tap's step is 1 */
    bool turned;            /* the taps of w from the last to the first */
    bool add;
    float gain;
    int64_t blocks, width, band,
        band_rows; /* of outputs; a packed row's pixels; rows of y; rows of x for them */
    float *packed; /* [block][tap][input][OUT] */
    float *rows;   /* one part a thread: [band_rows][width][I] */
} job;

bool conv_rows_fits(const conv_shape *s, bool back) {
    const bool way = back ? s->transpose || s->stride == 1 : !s->transpose;
    return isa_best() == LEVEL && way && s->k >= KERNEL && s->pad < s->k && s->I >= CHANNELS &&
           s->O >= CHANNELS && (back ? s->W : s->Wo) >= WIDTH;
}

static void pack_range(void *arg, int64_t begin, int64_t end, int thread) {
    const job *j = arg;
    const int64_t T = j->k * j->k;
    for (int64_t at = begin; at < end; at++) { /* a block's input */
        const int64_t block = at / j->I, i = at % j->I;
        for (int64_t t = 0; t < T; t++)
            for (int64_t o = 0; o < OUT; o++) {
                const int64_t out = block * OUT + o;
                j->packed[((block * T + t) * j->I + i) * OUT + o] =
                    out < j->O ? j->w[out * j->o_step + i * j->i_step + (j->turned ? T - 1 - t : t)] : 0;
            }
    }
}

/* Copies row y of x with its borders; rows outside are zeros. */
static void fill_row(const job *j, int64_t y, float *to) {
    const int64_t left = j->pad, right = j->width - left < j->W ? j->width - left : j->W;
    const bool inside = y >= 0 && y < j->H && right > 0;
    if (!inside) {
        memset(to, 0, (size_t)(j->width * j->I) * sizeof(float));
        return;
    }
    memset(to, 0, (size_t)(left * j->I) * sizeof(float));
    memcpy(to + left * j->I, j->x + y * j->W * j->I, (size_t)(right * j->I) * sizeof(float));
    memset(to + (left + right) * j->I, 0, (size_t)((j->width - left - right) * j->I) * sizeof(float));
}

/* y [count pixels][outputs] from x, a packed row's first pixel of the block. */
INLINE void block(const job *j, const float *x, const float *w, float *y, int64_t count, int64_t outputs) {
    const int64_t row = j->width * j->I, pixel = j->step * j->I, run = j->k * j->I;
    block_sums sum;
    block_clear(sum);
    for (int64_t ky = 0; ky < j->k; ky++, x += row, w += run * OUT) /* a row of taps is contiguous, as in w */
        add_run(x, pixel, w, run, sum);
    UNROLL for (int p = 0; p < PIXELS; p++) {
        if (p >= count) break;
        float *to = y + p * j->O;
        if (outputs == OUT)
            UNROLL for (int v = 0; v < VECTORS; v++) store(
                to + v * LANES, j->add ? load(to + v * LANES) + j->gain * sum[p][v] : j->gain * sum[p][v]);
        else
            for (int64_t o = 0; o < outputs; o++)
                to[o] = (j->add ? to[o] : 0) + j->gain * sum[p][o / LANES][o % LANES];
    }
}

static void band_range(void *arg, int64_t begin, int64_t end, int thread) {
    const job *j = arg;
    float *rows = j->rows + thread * j->band_rows * j->width * j->I;
    for (int64_t at = begin; at < end; at++) {
        const int64_t first = at * j->band, count = j->Ho - first < j->band ? j->Ho - first : j->band;
        for (int64_t r = 0; r < (count - 1) * j->step + j->k; r++)
            fill_row(j, first * j->step + r - j->pad, rows + r * j->width * j->I);
        for (int64_t b = 0; b < j->blocks; b++) {
            const float *w = j->packed + b * j->k * j->k * j->I * OUT;
            const int64_t outputs = j->O - b * OUT < OUT ? j->O - b * OUT : OUT;
            for (int64_t r = 0; r < count; r++)
                for (int64_t x = 0; x < j->Wo; x += PIXELS)
                    block(j, rows + (r * j->step * j->width + x * j->step) * j->I, w,
                          j->y + ((first + r) * j->Wo + x) * j->O + b * OUT, j->Wo - x, outputs);
        }
    }
}

static sherf_status run(op_call *call, job *j) {
    context *c = call->c;
    j->blocks = (j->O + OUT - 1) / OUT;
    j->width = ((j->Wo + PIXELS - 1) / PIXELS * PIXELS - 1) * j->step + j->k;
    const int64_t row = j->width * j->I * j->step, shared = (j->Ho + c->threads - 1) / c->threads;
    j->band = BAND_FLOATS / row;                                     /* rows that stay in the L2 cache, */
    j->band = j->band < 1 ? 1 : j->band > shared ? shared : j->band; /* but enough for all threads */
    j->band_rows = (j->band - 1) * j->step + j->k;
    const size_t floats = (size_t)(j->band_rows * j->width * j->I);
    j->packed = arena_alloc(c, call->scratch, (size_t)(j->blocks * j->k * j->k * j->I), OUT * sizeof(float));
    j->rows = arena_alloc(c, call->scratch, (size_t)c->threads * floats, sizeof(float));
    if (!j->packed || !j->rows) return SHERF_NO_MEMORY;
    parallel_for(c, j->blocks * j->I, 64, pack_range, j);
    parallel_for(c, (j->Ho + j->band - 1) / j->band, 1, band_range, j);
    return SHERF_OK;
}

sherf_status conv_rows_forward(op_call *call, const conv_shape *s, const float *x, const float *w, float *y) {
    const int64_t T = s->k * s->k;
    return run(call, &(job){.x = x,
                            .w = w,
                            .y = y,
                            .H = s->H,
                            .W = s->W,
                            .I = s->I,
                            .Ho = s->Ho,
                            .Wo = s->Wo,
                            .O = s->O,
                            .k = s->k,
                            .step = s->stride,
                            .pad = s->pad,
                            .o_step = s->I * T,
                            .i_step = T,
                            .gain = s->gain});
}

/* A convolution of dy with inputs and outputs exchanged: for conv2d with its taps reversed, for
 * conv2d_transpose in steps of two. */
sherf_status conv_rows_data(op_call *call, const conv_shape *s, const float *dy, const float *w, bool add,
                            float *dx) {
    const int64_t T = s->k * s->k;
    return run(call, &(job){.x = dy,
                            .w = w,
                            .y = dx,
                            .H = s->Ho,
                            .W = s->Wo,
                            .I = s->O,
                            .Ho = s->H,
                            .Wo = s->W,
                            .O = s->I,
                            .k = s->k,
                            .step = s->stride,
                            .pad = s->transpose ? 0 : s->k - 1 - s->pad,
                            .o_step = T,
                            .i_step = s->I * T,
                            .turned = !s->transpose,
                            .add = add,
                            .gain = s->gain});
}
