/* Convolutions on AMX tiles. Every pass is a correlation over flat positions. A map is rounded to bf16 and
 * stored as padded rows of fixed width, one after the other, 32 channels at a time. The neighbour of a
 * position under a kernel tap is then always the same distance away, so a tile is sixteen consecutive
 * positions for any width of the map; results in the padding between rows are dropped. For stride 2 the map
 * is split into its four phases (even or odd row, even or odd column), and each tap reads one phase. */
#include "tensor/cpu/amx_conv.h"

enum { MAX_KERNEL = 7, MAX_TAPS = MAX_KERNEL * MAX_KERNEL };

bool amx_conv_fits(const conv_shape *s) {
    return s->k <= MAX_KERNEL && (s->stride == 1 || s->stride == 2);
}

#if defined(__x86_64__)
#include <string.h>

#include "tensor/cpu/amx_tiles.h"

/* ---- flat maps ---- */
enum { SLACK = 64 }; /* zero positions after the end, which the last tile reads */

typedef struct {
    int64_t H, W, C;     /* the map */
    int64_t step, pad;   /* phases a side; rows and columns of zeros before the map */
    int64_t rows, width; /* of one phase, in positions */
    int64_t positions;   /* of all phases, with SLACK */
    int64_t blocks;      /* of 32 channels */
    const float *from;
    uint16_t *data; /* [blocks][positions][32] */
} flat_map;

/* Flat row `row`: row i of phase (a, b) holds the padded map's pixels (step i + a, step j + b). */
AMX static void flatten_range(void *arg, int64_t begin, int64_t end, int thread) {
    const flat_map *f = arg;
    for (int64_t row = begin; row < end; row++) {
        const int64_t phase = row / f->rows, i = row % f->rows;
        const int64_t y = f->step * i + phase / f->step - f->pad;
        for (int64_t j = 0; j < f->width; j++) {
            const int64_t x = f->step * j + phase % f->step - f->pad;
            const bool inside = y >= 0 && y < f->H && x >= 0 && x < f->W;
            const float *from = f->from + (inside ? (y * f->W + x) * f->C : 0);
            uint16_t *to = f->data + (row * f->width + j) * 32;
            for (int64_t c = 0; c < f->C; c += 32, to += f->positions * 32) {
                __m512i v = _mm512_setzero_si512();
                if (inside)
                    v = (__m512i)_mm512_cvtne2ps_pbh(
                        _mm512_maskz_loadu_ps(lanes(f->C - c - 16), from + c + 16),
                        _mm512_maskz_loadu_ps(lanes(f->C - c), from + c));
                _mm512_store_si512(to, v);
            }
        }
    }
}

/* map.H .. map.width are given. */
static bool flatten(op_call *call, flat_map *f, const float *from) {
    const int64_t rows = f->step * f->step * f->rows;
    f->from = from;
    f->positions = rows * f->width + SLACK;
    f->blocks = tiles(f->C, 32);
    f->data = arena_alloc(call->c, call->scratch, (size_t)(f->blocks * f->positions), 32 * sizeof *f->data);
    if (!f->data) return false;
    for (int64_t b = 0; b < f->blocks; b++)
        memset(f->data + ((b + 1) * f->positions - SLACK) * 32, 0, SLACK * 32 * sizeof *f->data);
    parallel_for(call->c, rows, 1 + (1 << 14) / (f->width * f->C), flatten_range, f);
    return true;
}

/* ---- correlation ---- */
typedef struct {
    int count;
    int64_t offset[MAX_TAPS]; /* in positions */
    int index[MAX_TAPS];      /* which of the kernel's taps */
} tap_list;

/* out[p + step_out * (i, j), n] (+)= gain sum over taps and k of map[i, j + offset, k] w */
typedef struct {
    flat_map map;
    tap_list taps;
    const float *w;
    int64_t O, I, T;  /* of w [O, I, T] */
    bool k_is_output; /* the sum runs over w's O and the result's channels are its I; else the other way */
    int64_t K, N;
    int64_t rows, columns;              /* of the result, for this list of taps */
    int64_t step, top, left, out_width; /* their place in out */
    float *out, gain;
    bool add;
    int64_t groups, pairs; /* GROUP positions; two tiles of N */
    uint16_t *b;           /* [pairs][blocks of K][taps][2] tiles */
} correlation;
enum { GROUP = 256 };

AMX static void pack_range(void *arg, int64_t begin, int64_t end, int thread) {
    const correlation *q = arg;
    const __m512i step =
        _mm512_mullo_epi32(_mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15),
                           _mm512_set1_epi32((int)q->T));
    const __m512i order = pair_order();
    const __m512 zero = _mm512_setzero_ps();
    __m512i v[16];
    for (int64_t at = begin; at < end; at++) { /* one tile of N */
        const int64_t n0 = at * 16;
        for (int64_t block = 0; block < q->map.blocks; block++)
            for (int t = 0; t < q->taps.count; t++) {
                const int64_t k0 = block * 32;
                const float *w = q->w + q->taps.index[t];
                for (int j = 0; j < 16; j++) {
                    const int64_t k = q->k_is_output ? k0 + 2 * j : k0, n = q->k_is_output ? n0 : n0 + j;
                    __m512 low = zero, high = zero;
                    if (q->k_is_output) { /* pairs of w's outputs k, k + 1 for its inputs n .. n + 15 */
                        const __mmask16 mask = lanes(q->N - n);
                        if (k < q->K)
                            low = _mm512_mask_i32gather_ps(zero, mask, step, w + (k * q->I + n) * q->T, 4);
                        if (k + 1 < q->K)
                            high = _mm512_mask_i32gather_ps(zero, mask, step, w + ((k + 1) * q->I + n) * q->T,
                                                            4);
                        v[j] = _mm512_permutexvar_epi16(order, (__m512i)_mm512_cvtne2ps_pbh(high, low));
                    } else { /* w's inputs k .. k + 31 for its output n */
                        if (n < q->N) {
                            const float *from = w + (n * q->I + k) * q->T;
                            low = _mm512_mask_i32gather_ps(zero, lanes(q->K - k), step, from, 4);
                            high = _mm512_mask_i32gather_ps(zero, lanes(q->K - k - 16), step,
                                                            from + 16 * q->T, 4);
                        }
                        v[j] = (__m512i)_mm512_cvtne2ps_pbh(high, low);
                    }
                }
                if (!q->k_is_output) transpose_16x16(v);
                const int64_t pair = ((at / 2) * q->map.blocks + block) * q->taps.count + t;
                tile_write(v, q->b + (pair * 2 + at % 2) * TILE);
            }
    }
}

/* 32 positions from `first`, 32 channels from n, out of sum[32][32]. */
AMX_INLINE void spread(const correlation *q, const float *sum, int64_t first, int64_t n) {
    const __mmask16 low = lanes(q->N - n), high = lanes(q->N - n - 16);
    const __m512 gain = _mm512_set1_ps(q->gain);
    int64_t i = first / q->map.width, j = first % q->map.width;
    for (int r = 0; r < 32; r++, j++) {
        if (j == q->map.width) {
            j = 0;
            i++;
        }
        if (j >= q->columns || i >= q->rows) continue;
        float *to = q->out + ((q->step * i + q->top) * q->out_width + q->step * j + q->left) * q->N + n;
        __m512 a = _mm512_mul_ps(_mm512_load_ps(sum + r * 32), gain);
        __m512 b = _mm512_mul_ps(_mm512_load_ps(sum + r * 32 + 16), gain);
        if (q->add) {
            a = _mm512_add_ps(a, _mm512_maskz_loadu_ps(low, to));
            b = _mm512_add_ps(b, _mm512_maskz_loadu_ps(high, to + 16));
        }
        _mm512_mask_storeu_ps(to, low, a);
        _mm512_mask_storeu_ps(to + 16, high, b);
    }
}

AMX static void correlate_range(void *arg, int64_t begin, int64_t end, int thread) {
    const correlation *q = arg;
    const int64_t all = (q->rows - 1) * q->map.width + q->columns;
    float sum[32 * 32] __attribute__((aligned(64)));
    tiles_begin();
    for (int64_t at = begin; at < end; at++) {
        const int64_t group = at / q->pairs, pair = at % q->pairs;
        const int64_t last = (group + 1) * GROUP < all ? (group + 1) * GROUP : all;
        for (int64_t first = group * GROUP; first < last; first += 32) {
            const uint16_t *b = q->b + pair * q->map.blocks * q->taps.count * 2 * TILE;
            _tile_zero(0);
            _tile_zero(1);
            _tile_zero(2);
            _tile_zero(3);
            for (int64_t block = 0; block < q->map.blocks; block++) {
                const uint16_t *map = q->map.data + (block * q->map.positions + first) * 32;
                for (int t = 0; t < q->taps.count; t++, b += 2 * TILE) {
                    const uint16_t *a = map + q->taps.offset[t] * 32;
                    tile_load(4, a, 64);
                    tile_load(5, a + TILE, 64);
                    tile_load(6, b, 64);
                    tile_load(7, b + TILE, 64);
                    tile_product(0, 4, 6);
                    tile_product(1, 4, 7);
                    tile_product(2, 5, 6);
                    tile_product(3, 5, 7);
                }
            }
            _tile_stored(0, sum, 128);
            _tile_stored(1, sum + 16, 128);
            _tile_stored(2, sum + 16 * 32, 128);
            _tile_stored(3, sum + 16 * 32 + 16, 128);
            spread(q, sum, first, pair * 32);
        }
    }
    _tile_release();
}

static sherf_status correlate(op_call *call, correlation *q) {
    if (q->rows <= 0 || q->columns <= 0 || (q->add && !q->taps.count)) return SHERF_OK;
    const int64_t tiles_n = 2 * tiles(q->N, 32), sets = q->map.blocks * (q->taps.count + !q->taps.count);
    q->pairs = tiles_n / 2;
    q->groups = tiles((q->rows - 1) * q->map.width + q->columns, GROUP);
    q->b = arena_alloc(call->c, call->scratch, (size_t)(tiles_n * sets), TILE * sizeof *q->b);
    if (!q->b) return SHERF_NO_MEMORY;
    parallel_for(call->c, tiles_n, 1 + 256 / sets, pack_range, q);
    parallel_for(call->c, q->groups * q->pairs, 1 + 32 / sets, correlate_range, q);
    return SHERF_OK;
}

static void tap_add(tap_list *l, int64_t offset, int64_t index) {
    l->offset[l->count] = offset;
    l->index[l->count++] = (int)index;
}

/* out[i,j] = sum over taps of map[stride i + r - pad, stride j + s - pad]: conv2d forward, and the gradient
 * of conv2d_transpose (its dy is the map). */
static sherf_status correlate_strided(op_call *call, const conv_shape *s, correlation *q, const float *from) {
    const int64_t step = s->stride;
    q->map.step = step;
    q->map.pad = s->pad;
    q->map.rows = q->rows + (s->k - 1) / step;
    q->map.width = q->columns + (s->k - 1) / step;
    if (!flatten(call, &q->map, from)) return SHERF_NO_MEMORY;
    for (int64_t r = 0; r < s->k; r++)
        for (int64_t c = 0; c < s->k; c++) {
            const int64_t phase = r % step * step + c % step;
            tap_add(&q->taps, (phase * q->map.rows + r / step) * q->map.width + c / step, r * s->k + c);
        }
    q->step = 1;
    q->out_width = q->columns;
    return correlate(call, q);
}

/* out[i,j] = sum over taps of map[(i + pad - r) / stride, ...] where the division is exact: conv2d_transpose
 * forward, and the gradient of conv2d. One correlation for each phase of the result, H x W. */
static sherf_status correlate_spread(op_call *call, const conv_shape *s, correlation *q, const float *from,
                                     int64_t H, int64_t W) {
    const int64_t step = s->stride, pad = step == 1 ? s->k - 1 - s->pad : s->k / 2;
    const int64_t reach = (step - 1 + s->pad) / step + pad; /* the furthest tap */
    q->map.step = 1;
    q->map.pad = pad;
    q->map.width = (W + step - 1) / step + reach;
    q->map.rows = (H + step - 1) / step + reach;
    if (!flatten(call, &q->map, from)) return SHERF_NO_MEMORY;
    q->step = step;
    q->out_width = W;
    for (q->top = 0; q->top < step; q->top++)
        for (q->left = 0; q->left < step; q->left++) {
            q->taps.count = 0;
            for (int64_t r = (q->top + s->pad) % step; r < s->k; r += step)
                for (int64_t c = (q->left + s->pad) % step; c < s->k; c += step)
                    tap_add(&q->taps,
                            ((q->top + s->pad - r) / step + pad) * q->map.width +
                                (q->left + s->pad - c) / step + pad,
                            r * s->k + c);
            q->rows = (H - q->top + step - 1) / step;
            q->columns = (W - q->left + step - 1) / step;
            const arena_mark mark = arena_position(call->scratch);
            sherf_status status = correlate(call, q);
            if (status != SHERF_OK) return status;
            arena_rewind(call->scratch, mark);
        }
    return SHERF_OK;
}

sherf_status amx_conv_forward(op_call *call, const conv_shape *s, const float *x, const float *w, float *y) {
    correlation q = {
        .map = {.H = s->H, .W = s->W, .C = s->I}, .w = w, .O = s->O, .I = s->I, .T = s->k * s->k};
    q.K = s->I;
    q.N = s->O;
    q.out = y;
    q.gain = s->gain;
    if (s->transpose) return correlate_spread(call, s, &q, x, s->Ho, s->Wo);
    q.rows = s->Ho;
    q.columns = s->Wo;
    return correlate_strided(call, s, &q, x);
}

sherf_status amx_conv_data(op_call *call, const conv_shape *s, const float *dy, const float *w, bool add,
                           float *dx) {
    correlation q = {
        .map = {.H = s->Ho, .W = s->Wo, .C = s->O}, .w = w, .O = s->O, .I = s->I, .T = s->k * s->k};
    q.k_is_output = true;
    q.K = s->O;
    q.N = s->I;
    q.out = dx;
    q.gain = s->gain;
    q.add = add;
    if (!s->transpose) return correlate_spread(call, s, &q, dy, s->H, s->W);
    q.rows = s->H;
    q.columns = s->W;
    return correlate_strided(call, s, &q, dy);
}

/* ---- gradient of the weights ---- */
/* sums[m,n,t] = sum over positions of u[position, m] v[position + offset_t, n]. For conv2d u is dy and v is
 * x, for conv2d_transpose u is x and v is dy. Positions are processed in chunks that fit in the L2 cache with
 * all of u's channels and 32 of v's; all products over a chunk are taken then. */
typedef struct {
    flat_map u, v;
    tap_list taps;
    int64_t k;             /* taps in a row of the kernel: one unit of work */
    int64_t steps, chunk;  /* of 32 positions */
    int64_t rows, columns; /* pairs of tiles along m and n */
    int64_t window;        /* positions of a phase of v that a chunk reads */
    uint16_t *u_tiles;     /* [2 rows][steps] tiles: m by pairs of positions */
    uint32_t *v_pairs;     /* one for each thread: [2][phases][window][16], (v[position], v[position + 1]) */
    float *sums;           /* [rows][columns][taps][2][2] tiles */
    float *dw, gain;
    int64_t m_step, n_step; /* in dw */
} weight_job;

AMX static void u_range(void *arg, int64_t begin, int64_t end, int thread) {
    const weight_job *j = arg;
    __m512i v[16];
    for (int64_t at = begin; at < end; at++) { /* one tile */
        const int64_t m = at / j->steps, first = at % j->steps * 32;
        const uint16_t *from = j->u.data + (m / 2 * j->u.positions + first) * 32 + m % 2 * 16;
        for (int p = 0; p < 16; p++) {
            const __m512i a = _mm512_cvtepu16_epi32(_mm256_load_si256((const __m256i *)(from + 64 * p)));
            const __m512i b = _mm512_cvtepu16_epi32(_mm256_load_si256((const __m256i *)(from + 64 * p + 32)));
            v[p] = _mm512_or_si512(a, _mm512_slli_epi32(b, 16));
        }
        transpose_16x16(v);
        tile_write(v, j->u_tiles + at * TILE);
    }
}

/* Builds the chunk from step `first` on, for one pair of tiles along n. */
AMX_INLINE void v_build(const weight_job *j, int64_t column, int64_t first, uint32_t *to) {
    const int64_t phases = j->v.step * j->v.step;
    for (int64_t phase = 0; phase < phases; phase++) {
        const int64_t start = phase * j->v.rows * j->v.width + first * 32;
        const uint16_t *from = j->v.data + (column * j->v.positions + start) * 32;
        uint32_t *low = to + phase * j->window * 16, *high = low + phases * j->window * 16;
        for (int64_t p = 0; p < j->window; p++) {
            if (start + p + 1 >= j->v.positions) {
                memset(low + p * 16, 0, 64);
                memset(high + p * 16, 0, 64);
                continue;
            }
            const __m512i a = _mm512_load_si512(from + p * 32), b = _mm512_load_si512(from + p * 32 + 32);
            const __m512i even = _mm512_cvtepu16_epi32(_mm512_castsi512_si256(a));
            const __m512i odd = _mm512_cvtepu16_epi32(_mm512_castsi512_si256(b));
            const __m512i even2 = _mm512_cvtepu16_epi32(_mm512_extracti64x4_epi64(a, 1));
            const __m512i odd2 = _mm512_cvtepu16_epi32(_mm512_extracti64x4_epi64(b, 1));
            _mm512_store_si512(low + p * 16, _mm512_or_si512(even, _mm512_slli_epi32(odd, 16)));
            _mm512_store_si512(high + p * 16, _mm512_or_si512(even2, _mm512_slli_epi32(odd2, 16)));
        }
    }
}

/* sums[2][2] tiles = or += u's two rows of tiles times v's two columns, over some steps. */
AMX_INLINE void weight_product(const uint16_t *a, const uint16_t *a2, const uint32_t *b, const uint32_t *b2,
                               int64_t steps, bool add, float *sums) {
    sums_begin(add, sums);
    for (int64_t s = 0; s < steps; s++) {
        tile_load(4, a + s * TILE, 64);
        tile_load(5, a2 + s * TILE, 64);
        tile_load(6, b + s * 512, 128);
        tile_load(7, b2 + s * 512, 128);
        tile_product(0, 4, 6);
        tile_product(1, 4, 7);
        tile_product(2, 5, 6);
        tile_product(3, 5, 7);
    }
    sums_end(sums);
}

/* One row of taps, one pair of tiles each way, one chunk; a few steps at a time, so that every tap finds them
 * in the first cache. */
AMX_INLINE void weight_unit(const weight_job *j, int64_t row, int64_t column, int64_t tap, int64_t first,
                            const uint32_t *v) {
    enum { FEW = 8 };
    const int64_t last = first + j->chunk < j->steps ? first + j->chunk : j->steps;
    const int64_t phase = j->v.rows * j->v.width, half = j->v.step * j->v.step * j->window * 16;
    for (int64_t at = first; at < last; at += FEW) {
        const int64_t steps = last - at < FEW ? last - at : FEW;
        const uint16_t *a = j->u_tiles + (2 * row * j->steps + at) * TILE;
        for (int64_t t = tap; t < tap + j->k; t++) {
            const int64_t offset = j->taps.offset[t];
            const uint32_t *b = v + (offset / phase * j->window + (at - first) * 32 + offset % phase) * 16;
            weight_product(a, a + j->steps * TILE, b, b + half, steps, at > 0,
                           j->sums + ((row * j->columns + column) * j->taps.count + t) * 1024);
        }
    }
}

AMX static void weight_range(void *arg, int64_t begin, int64_t end, int thread) {
    const weight_job *j = arg;
    const int64_t groups = j->taps.count / j->k;
    uint32_t *v = j->v_pairs + thread * 2 * j->v.step * j->v.step * j->window * 16;
    tiles_begin();
    for (int64_t first = 0; first < j->steps; first += j->chunk)
        for (int64_t at = begin, built = -1; at < end; at++) {
            const int64_t row = at / groups % j->rows, column = at / groups / j->rows;
            if (column != built) v_build(j, column, first, v);
            built = column;
            weight_unit(j, row, column, at % groups * j->k, first, v);
        }
    _tile_release();
}

/* dw += gain sums, one pair of tiles each way at a time. */
AMX static void weight_add_range(void *arg, int64_t begin, int64_t end, int thread) {
    const weight_job *j = arg;
    const __m512 gain = _mm512_set1_ps(j->gain);
    const __m512i step =
        _mm512_mullo_epi32(_mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15),
                           _mm512_set1_epi32((int)j->n_step));
    for (int64_t at = begin; at < end; at++) {
        const float *sums = j->sums + at * j->taps.count * 1024;
        const int64_t m0 = at / j->columns * 32, n0 = at % j->columns * 32;
        for (int64_t m = m0; m < m0 + 32 && m < j->u.C; m++)
            for (int64_t n = n0; n < n0 + 32 && n < j->v.C; n += 16)
                for (int64_t t = 0; t < j->taps.count; t++) {
                    const int64_t tile = (m - m0) / 16 * 2 + (n - n0) / 16;
                    const __m512 v = _mm512_load_ps(sums + t * 1024 + tile * 256 + (m % 16) * 16);
                    float *to = j->dw + m * j->m_step + n * j->n_step + j->taps.index[t];
                    const __mmask16 mask = lanes(j->v.C - n);
                    const __m512 old = _mm512_mask_i32gather_ps(_mm512_setzero_ps(), mask, step, to, 4);
                    _mm512_mask_i32scatter_ps(to, mask, step, _mm512_fmadd_ps(v, gain, old), 4);
                }
    }
}

static sherf_status weight_run(op_call *call, weight_job *j) {
    context *c = call->c;
    j->steps = tiles(j->u.rows * j->u.width, 32);
    j->rows = j->u.blocks;
    j->columns = j->v.blocks;
    const int64_t phases = j->v.step * j->v.step;
    j->chunk = (3 << 12) / (32 * j->u.blocks * phases); /* u's part of a chunk: 768 KiB */
    if (j->chunk < 8) j->chunk = 8;
    if (j->chunk > j->steps) j->chunk = j->steps;
    const int64_t reach = (j->k - 1) / j->v.step;
    j->window = j->chunk * 32 + reach * (j->v.width + 1);
    const size_t units = (size_t)(j->rows * j->columns), pairs = (size_t)(phases * j->window * c->threads);
    j->u_tiles = arena_alloc(c, call->scratch, 2 * (size_t)(j->rows * j->steps), TILE * sizeof *j->u_tiles);
    j->v_pairs = arena_alloc(c, call->scratch, 2 * pairs, 16 * sizeof *j->v_pairs);
    j->sums = arena_alloc(c, call->scratch, units * (size_t)j->taps.count, 1024 * sizeof *j->sums);
    if (!j->u_tiles || !j->v_pairs || !j->sums) return SHERF_NO_MEMORY;
    parallel_for(c, 2 * j->rows * j->steps, 64, u_range, j);
    parallel_for(c, (int64_t)units * (j->taps.count / j->k), 1 + 32 / (j->steps * j->k), weight_range, j);
    parallel_for(c, (int64_t)units, 1 + 8 / j->taps.count, weight_add_range, j);
    return SHERF_OK;
}

sherf_status amx_conv_weights(op_call *call, const conv_shape *s, const float *x, const float *dy,
                              float *dw) {
    const int64_t T = s->k * s->k, step = s->stride;
    const flat_map in = {.H = s->H, .W = s->W, .C = s->I}, out = {.H = s->Ho, .W = s->Wo, .C = s->O};
    weight_job j = {
        .u = s->transpose ? in : out, .v = s->transpose ? out : in, .k = s->k, .dw = dw, .gain = s->gain};
    j.m_step = s->transpose ? T : s->I * T;
    j.n_step = s->transpose ? s->I * T : T;
    j.v.step = step;
    j.v.pad = s->pad;
    j.v.rows = j.u.H + (s->k - 1) / step;
    j.v.width = j.u.W + (s->k - 1) / step;
    j.u.step = 1;
    j.u.rows = j.u.H;
    j.u.width = j.v.width; /* the columns after u's own are zero and cancel v's values there */
    if (!flatten(call, &j.u, s->transpose ? x : dy) || !flatten(call, &j.v, s->transpose ? dy : x))
        return SHERF_NO_MEMORY;
    for (int64_t r = 0; r < s->k; r++)
        for (int64_t c = 0; c < s->k; c++) {
            const int64_t phase = r % step * step + c % step;
            tap_add(&j.taps, (phase * j.v.rows + r / step) * j.v.width + c / step, r * s->k + c);
        }
    return weight_run(call, &j);
}

#else
sherf_status amx_conv_forward(op_call *call, const conv_shape *s, const float *x, const float *w, float *y) {
    return failure(call->c, SHERF_UNSUPPORTED, "no AMX on this processor");
}
sherf_status amx_conv_data(op_call *call, const conv_shape *s, const float *dy, const float *w, bool add,
                           float *dx) {
    return failure(call->c, SHERF_UNSUPPORTED, "no AMX on this processor");
}
sherf_status amx_conv_weights(op_call *call, const conv_shape *s, const float *x, const float *dy,
                              float *dw) {
    return failure(call->c, SHERF_UNSUPPORTED, "no AMX on this processor");
}
#endif
