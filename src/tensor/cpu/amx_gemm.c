/* Matrix products on AMX: operands are rounded to bf16 and packed as tiles; 32 x 32 sums stay in registers.
 * One form packs B once for many rows, the other splits a long k into blocks. */
#include "tensor/cpu/amx_gemm.h"

#if defined(__x86_64__)
#include <string.h>

#include "tensor/cpu/amx_tiles.h"

/* c[32][32] = or += A (two tile rows, a_step values between k's tiles, 2nd row at a2) times B (likewise).
 * wide: the second column of tiles exists. */
AMX_INLINE void product_32(const uint16_t *a, const uint16_t *a2, int64_t a_step, const uint16_t *b,
                           const uint16_t *b2, int64_t b_step, int64_t depth, float *c, float *c2, float *d,
                           float *d2, int64_t ldc, bool sum, bool wide, bool tall) {
    const int64_t bytes = ldc * (int64_t)sizeof(float);
    if (sum) {
        tile_load(0, c, bytes);
        if (wide) tile_load(1, c2, bytes);
        if (tall) tile_load(2, d, bytes);
        if (wide && tall) tile_load(3, d2, bytes);
    } else {
        _tile_zero(0);
        _tile_zero(1);
        _tile_zero(2);
        _tile_zero(3);
    }
    for (int64_t k = 0; k < depth; k++) {
        tile_load(4, a + k * a_step, 64);
        tile_load(6, b + k * b_step, 64);
        tile_product(0, 4, 6);
        if (tall) {
            tile_load(5, a2 + k * a_step, 64);
            tile_product(2, 5, 6);
        }
        if (wide) {
            tile_load(7, b2 + k * b_step, 64);
            tile_product(1, 4, 7);
            if (tall) tile_product(3, 5, 7);
        }
    }
    _tile_stored(0, c, bytes);
    if (wide) _tile_stored(1, c2, bytes);
    if (tall) _tile_stored(2, d, bytes);
    if (wide && tall) _tile_stored(3, d2, bytes);
}

/* ---- many rows ---- */
typedef struct {
    amx_product p;
    int64_t columns, depth; /* tiles along n and k */
    uint16_t *b;            /* [columns][depth] tiles */
    uint16_t *a;            /* [2][depth] tiles for each thread */
} rows_job;

AMX static void pack_b(const rows_job *j) {
    const amx_product *p = &j->p;
    __m512i v[16];
    for (int64_t n = 0; n < j->columns; n++)
        for (int64_t k = 0; k < j->depth; k++) {
            const int64_t n0 = n * SIDE, k0 = k * DEPTH;
            if (p->b_across) {
                load_across(p->b + n0 * p->ldb + k0, p->ldb, p->N - n0, p->K - k0, v);
                transpose_16x16(v);
            } else {
                load_down(p->b + k0 * p->ldb + n0, p->ldb, p->K - k0, p->N - n0, v);
            }
            tile_write(v, j->b + (n * j->depth + k) * TILE);
        }
}

/* Writes the sums of a block to C: rows x columns of sum[32][32]. */
AMX_INLINE void finish(const amx_product *p, const float *sum, int64_t m, int64_t n, int64_t rows) {
    const __m512 gain = _mm512_set1_ps(p->gain);
    for (int64_t column = n; column < n + 32 && column < p->N; column += 16) {
        const __mmask16 mask = lanes(p->N - column);
        const __m512 bias = p->bias ? _mm512_maskz_loadu_ps(mask, p->bias + column) : _mm512_setzero_ps();
        for (int64_t r = 0; r < rows; r++) {
            float *to = p->c + (m + r) * p->ldc + column;
            const __m512 old = p->add ? _mm512_maskz_loadu_ps(mask, to) : bias;
            _mm512_mask_storeu_ps(to, mask,
                                  _mm512_fmadd_ps(_mm512_load_ps(sum + r * 32 + column - n), gain, old));
        }
    }
}

AMX static void rows_range(void *arg, int64_t begin, int64_t end, int thread) {
    const rows_job *j = arg;
    const amx_product *p = &j->p;
    uint16_t *a = j->a + thread * 2 * j->depth * TILE, *a2 = a + j->depth * TILE;
    float sum[32 * 32] __attribute__((aligned(64)));
    __m512i v[16];
    tiles_begin();
    for (int64_t block = begin; block < end; block++) {
        const int64_t m = block * 32, rows = p->M - m < 32 ? p->M - m : 32;
        const float *from = p->a + m * p->lda;
        for (int64_t k = 0; k < j->depth; k++) {
            load_across(from + k * DEPTH, p->lda, rows, p->K - k * DEPTH, v);
            tile_write(v, a + k * TILE);
            load_across(from + 16 * p->lda + k * DEPTH, p->lda, rows - 16, p->K - k * DEPTH, v);
            tile_write(v, a2 + k * TILE);
        }
        for (int64_t n = 0; n < j->columns; n += 2) {
            const uint16_t *b = j->b + n * j->depth * TILE, *b2 = b + j->depth * TILE;
            float *d = sum + 16 * 32;
            if (n + 1 < j->columns)
                product_32(a, a2, TILE, b, b2, TILE, j->depth, sum, sum + 16, d, d + 16, 32, false, true,
                           true);
            else
                product_32(a, a2, TILE, b, b, TILE, j->depth, sum, sum, d, d, 32, false, false, true);
            finish(p, sum, m, n * SIDE, rows);
        }
    }
    _tile_release();
}

sherf_status amx_gemm_rows(op_call *call, const amx_product *p) {
    rows_job j = {.p = *p, .columns = tiles(p->N, SIDE), .depth = tiles(p->K, DEPTH)};
    j.b = arena_alloc(call->c, call->scratch, (size_t)(j.columns * j.depth), TILE * sizeof *j.b);
    j.a = arena_alloc(call->c, call->scratch, 2 * (size_t)call->c->threads * (size_t)j.depth,
                      TILE * sizeof *j.a);
    if (!j.a || !j.b) return SHERF_NO_MEMORY;
    pack_b(&j);
    const int64_t work = p->N * p->K; /* a thread is worth starting for 2^20 products */
    parallel_for(call->c, tiles(p->M, 32), 1 + (1 << 15) / (work + 1), rows_range, &j);
    return SHERF_OK;
}

/* ---- many k ---- */
enum { STEPS = 8 }; /* tiles of k packed at once: 256 rows of activations */

typedef struct {
    amx_product p;
    int64_t rows, columns;       /* tiles along m and n */
    int64_t block_depth, blocks; /* tiles of k in a block */
    float *sums;                 /* [blocks][rows][columns] tiles of 16 x 16 */
    uint16_t *pack;              /* [rows + columns][STEPS] tiles for each thread */
} deep_job;

AMX_INLINE void pack_deep(const deep_job *j, int64_t k, int64_t steps, uint16_t *a, uint16_t *b) {
    const amx_product *p = &j->p;
    __m512i v[16];
    for (int64_t s = 0; s < steps; s++) {
        const int64_t k0 = (k + s) * DEPTH;
        for (int64_t m = 0; m < j->rows; m++) {
            load_down(p->a + k0 * p->lda + m * SIDE, p->lda, p->K - k0, p->M - m * SIDE, v);
            transpose_16x16(v);
            tile_write(v, a + (m * STEPS + s) * TILE);
        }
        for (int64_t n = 0; n < j->columns; n++) {
            load_down(p->b + k0 * p->ldb + n * SIDE, p->ldb, p->K - k0, p->N - n * SIDE, v);
            tile_write(v, b + (n * STEPS + s) * TILE);
        }
    }
}

AMX_INLINE void multiply_deep(const deep_job *j, int64_t steps, const uint16_t *a, const uint16_t *b,
                              float *sums) {
    for (int64_t m = 0; m < j->rows; m += 2)
        for (int64_t n = 0; n < j->columns; n += 2) {
            const uint16_t *a1 = a + m * STEPS * TILE, *a2 = a1 + STEPS * TILE;
            const uint16_t *b1 = b + n * STEPS * TILE, *b2 = b1 + STEPS * TILE;
            float *c = sums + (m * j->columns + n) * 256, *d = c + j->columns * 256;
            const bool wide = n + 1 < j->columns, tall = m + 1 < j->rows;
            if (wide && tall)
                product_32(a1, a2, TILE, b1, b2, TILE, steps, c, c + 256, d, d + 256, 16, true, true, true);
            else if (wide)
                product_32(a1, a1, TILE, b1, b2, TILE, steps, c, c + 256, c, c, 16, true, true, false);
            else if (tall)
                product_32(a1, a2, TILE, b1, b1, TILE, steps, c, c, d, d, 16, true, false, true);
            else
                product_32(a1, a1, TILE, b1, b1, TILE, steps, c, c, c, c, 16, true, false, false);
        }
}

AMX static void deep_range(void *arg, int64_t begin, int64_t end, int thread) {
    const deep_job *j = arg;
    uint16_t *a = j->pack + thread * (j->rows + j->columns) * STEPS * TILE, *b = a + j->rows * STEPS * TILE;
    const int64_t all = tiles(j->p.K, DEPTH);
    tiles_begin();
    for (int64_t block = begin; block < end; block++) {
        float *sums = j->sums + block * j->rows * j->columns * 256;
        memset(sums, 0, (size_t)(j->rows * j->columns) * 256 * sizeof *sums);
        const int64_t first = block * j->block_depth;
        const int64_t last = first + j->block_depth < all ? first + j->block_depth : all;
        for (int64_t k = first; k < last; k += STEPS) {
            const int64_t steps = last - k < STEPS ? last - k : STEPS;
            pack_deep(j, k, steps, a, b);
            multiply_deep(j, steps, a, b, sums);
        }
    }
    _tile_release();
}

/* Rows of tiles of C: the blocks' sums in order. */
AMX static void join_range(void *arg, int64_t begin, int64_t end, int thread) {
    const deep_job *j = arg;
    const amx_product *p = &j->p;
    const __m512 gain = _mm512_set1_ps(p->gain);
    const int64_t block = j->rows * j->columns * 256;
    for (int64_t m = begin * SIDE; m < p->M && m < end * SIDE; m++)
        for (int64_t n = 0; n < j->columns; n++) {
            const float *from = j->sums + ((m / SIDE) * j->columns + n) * 256 + (m % SIDE) * 16;
            const __mmask16 mask = lanes(p->N - n * SIDE);
            float *to = p->c + m * p->ldc + n * SIDE;
            __m512 sum = _mm512_load_ps(from);
            for (int64_t i = 1; i < j->blocks; i++)
                sum = _mm512_add_ps(sum, _mm512_load_ps(from + i * block));
            _mm512_mask_storeu_ps(to, mask, _mm512_fmadd_ps(sum, gain, _mm512_maskz_loadu_ps(mask, to)));
        }
}

sherf_status amx_gemm_deep(op_call *call, const amx_product *p) {
    deep_job j = {.p = *p, .rows = tiles(p->M, SIDE), .columns = tiles(p->N, SIDE)};
    const int64_t depth = tiles(p->K, DEPTH);
    /* at most 32 blocks of at least 512 rows */
    j.block_depth = depth / 32 < 16 ? 16 : (depth + 31) / 32;
    j.blocks = tiles(depth, j.block_depth);
    const size_t pack = (size_t)call->c->threads * (size_t)(j.rows + j.columns) * STEPS;
    j.sums =
        arena_alloc(call->c, call->scratch, (size_t)(j.blocks * j.rows * j.columns), 256 * sizeof *j.sums);
    j.pack = arena_alloc(call->c, call->scratch, pack, TILE * sizeof *j.pack);
    if (!j.sums || !j.pack) return SHERF_NO_MEMORY;
    parallel_for(call->c, j.blocks, 1, deep_range, &j);
    parallel_for(call->c, j.rows, 1 + (1 << 14) / (p->N * 16 * j.blocks + 1), join_range, &j);
    return SHERF_OK;
}

#else
sherf_status amx_gemm_rows(op_call *call, const amx_product *p) {
    return failure(call->c, SHERF_UNSUPPORTED, "no AMX on this processor");
}
sherf_status amx_gemm_deep(op_call *call, const amx_product *p) {
    return failure(call->c, SHERF_UNSUPPORTED, "no AMX on this processor");
}
#endif
