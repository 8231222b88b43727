/* Sparse convolutions on AMX tiles. Output rows are sorted by the set of their taps, so that 32 consecutive
 * rows have mostly the same ones. A tap that none of the 32 has is skipped. For the others the rows are
 * gathered from a bf16 copy, with a row of zeros where an input is missing. On the shells of bodies, one
 * product in five involves zeros after sorting; in the voxels' order it would be one in three to three in
 * four. The order depends only on the rule, and every sum runs in that order on one thread. */
#include "tensor/cpu/amx_sparse.h"

enum { TAPS = 27, GROUP = 32, CHANNELS_MIN = 16 };

bool amx_sparse_fits(const tensor *w) {
    return w->dim[0] >= CHANNELS_MIN && w->dim[4] >= CHANNELS_MIN;
}

#if defined(__x86_64__)
#include <string.h>

#include "tensor/cpu/amx_tiles.h"

/* ---- the order of rows ---- */
typedef struct {
    int64_t rows, groups;
    const int32_t *rule; /* [rows, 27] */
    int32_t *order;      /* [groups][GROUP]: rows sorted by mask, -1 after the last */
    uint32_t *mask;      /* [rows] the taps that a row has */
    uint32_t *present;   /* [groups] the taps that any of its rows has */
} row_order;

AMX static void mask_range(void *arg, int64_t begin, int64_t end, int thread) {
    const row_order *s = arg;
    const __m512i zero = _mm512_setzero_si512();
    for (int64_t a = begin; a < end; a++) {
        const int32_t *rule = s->rule + a * TAPS;
        const __m512i low = _mm512_loadu_si512(rule), high = _mm512_maskz_loadu_epi32(0x7ff, rule + 16);
        s->mask[a] = (uint32_t)_mm512_cmpge_epi32_mask(low, zero) |
                     (uint32_t)_mm512_mask_cmpge_epi32_mask(0x7ff, high, zero) << 16;
    }
}

/* Three passes of a radix sort, nine taps each. */
static void masks_sort(row_order *s, int32_t *spare) {
    int32_t *from = s->order, *to = spare;
    for (int64_t a = 0; a < s->rows; a++) spare[a] = (int32_t)a;
    for (int pass = 0; pass < 3; pass++) {
        int32_t *swap = from;
        from = to;
        to = swap;
        int64_t next[513] = {0};
        for (int64_t a = 0; a < s->rows; a++) next[(s->mask[a] >> 9 * pass & 511) + 1]++;
        for (int i = 0; i < 511; i++) next[i + 1] += next[i];
        for (int64_t a = 0; a < s->rows; a++) to[next[s->mask[from[a]] >> 9 * pass & 511]++] = from[a];
    }
}

static bool rows_sort(op_call *call, row_order *s) {
    s->groups = tiles(s->rows, GROUP);
    const size_t all = (size_t)s->groups * GROUP;
    s->order = arena_alloc(call->c, call->scratch, all, sizeof *s->order);
    s->mask = arena_alloc(call->c, call->scratch, all, sizeof *s->mask);
    s->present = arena_alloc(call->c, call->scratch, (size_t)s->groups, sizeof *s->present);
    int32_t *spare = arena_alloc(call->c, call->scratch, all, sizeof *spare);
    if (!s->order || !s->mask || !s->present || !spare) return false;
    parallel_for(call->c, s->rows, 1 << 12, mask_range, s);
    masks_sort(s, spare);
    memset(s->present, 0, (size_t)s->groups * sizeof *s->present);
    for (int64_t i = 0; i < s->rows; i++) s->present[i / GROUP] |= s->mask[s->order[i]];
    for (int64_t i = s->rows; i < s->groups * GROUP; i++) s->order[i] = -1;
    return true;
}

/* ---- gathering ---- */
typedef struct {
    int64_t rows, channels, blocks; /* of 32 channels */
    const float *from;
    uint16_t *data; /* [rows + 1][blocks][32], zeros in the last row */
} bf16_rows;

AMX static void copy_range(void *arg, int64_t begin, int64_t end, int thread) {
    const bf16_rows *x = arg;
    for (int64_t r = begin; r < end; r++)
        for (int64_t c = 0; c < x->blocks * 32; c += 32) {
            const float *from = x->from + r * x->channels + c;
            const __m512 low = _mm512_maskz_loadu_ps(lanes(x->channels - c), from);
            const __m512 high = _mm512_maskz_loadu_ps(lanes(x->channels - c - 16), from + 16);
            _mm512_store_si512(x->data + r * x->blocks * 32 + c, (__m512i)_mm512_cvtne2ps_pbh(high, low));
        }
}

static bool rows_copy(op_call *call, bf16_rows *x, const tensor *from) {
    *x = (bf16_rows){.rows = from->dim[0], .channels = from->dim[1], .from = from->data};
    x->blocks = tiles(x->channels, 32);
    const int64_t wide = x->blocks * 32;
    x->data = arena_alloc(call->c, call->scratch, (size_t)((x->rows + 1) * wide), sizeof *x->data);
    if (!x->data) return false;
    memset(x->data + x->rows * wide, 0, (size_t)wide * sizeof *x->data);
    parallel_for(call->c, x->rows, 1 + (1 << 15) / wide, copy_range, x);
    return true;
}

/* Where the 32 rows of a group find their inputs at a tap, or the row of zeros. Without branches, which would
 * be mispredicted more often than not. */
AMX_INLINE void group_from(const row_order *s, const bf16_rows *x, int64_t group, int tap,
                           int32_t from[GROUP]) {
    const __m512i none = _mm512_set1_epi32((int)x->rows);
    for (int i = 0; i < GROUP; i += 16) {
        const __m512i row = _mm512_load_si512(s->order + group * GROUP + i);
        const __m512i at = _mm512_mullo_epi32(row, _mm512_set1_epi32(TAPS));
        const __m512i found = _mm512_mask_i32gather_epi32(
            none, _mm512_cmpge_epi32_mask(row, _mm512_setzero_si512()), at, s->rule + tap, 4);
        _mm512_store_si512(from + i, _mm512_min_epu32(found, none));
    }
}

/* ---- rows of the result ---- */
enum { FEW = 8 }; /* pairs of tiles gathered at once: 16 KiB */
typedef struct {
    row_order sorted;
    bf16_rows x;
    const float *w;
    int64_t O, I, N;
    bool back, add;
    int64_t columns; /* tiles of N */
    uint16_t *b;     /* [pairs of columns][27][blocks][2] tiles; a single last column is alone */
    uint16_t *a;     /* for each thread: [FEW, or blocks if more][2] tiles */
    float *sums;     /* for each thread: [pairs of columns][2][2] tiles */
    int64_t a_set;
    float *y;
} rows_job;

AMX static void pack_range(void *arg, int64_t begin, int64_t end, int thread) {
    const rows_job *j = arg;
    const int64_t blocks = j->x.blocks;
    __m512i v[16];
    for (int64_t at = begin; at < end; at++) { /* a column and a tap */
        const int64_t column = at / TAPS, tap = at % TAPS, n = column * SIDE;
        for (int64_t block = 0; block < blocks; block++) {
            const int64_t k = block * DEPTH;
            if (j->back) {
                load_down(j->w + (k * TAPS + tap) * j->I + n, TAPS * j->I, j->O - k, j->I - n, v);
            } else {
                load_across(j->w + (n * TAPS + tap) * j->I + k, TAPS * j->I, j->O - n, j->I - k, v);
                transpose_16x16(v);
            }
            tile_write(v, j->b + (((column / 2 * TAPS + tap) * blocks + block) * 2 + column % 2) * TILE);
        }
    }
}

/* Two tiles for each block of 32 channels: the group's rows at a tap. */
AMX_INLINE void group_gather(const rows_job *j, int64_t group, int tap, int64_t blocks, uint16_t *a) {
    int32_t from[GROUP] __attribute__((aligned(64)));
    group_from(&j->sorted, &j->x, group, tap, from);
    for (int r = 0; r < GROUP; r++) {
        const uint16_t *x = j->x.data + from[r] * blocks * 32;
        for (int64_t block = 0; block < blocks; block++)
            _mm512_store_si512(a + block * 2 * TILE + r * 32, _mm512_load_si512(x + block * 32));
    }
}

/* sum[2][2] tiles = or += the group's rows at some taps times a pair of columns; wide: the second column
 * exists. */
AMX_INLINE void group_product(const int *tap, int taps, int64_t blocks, const uint16_t *a, const uint16_t *b,
                              bool wide, bool add, float *sum) {
    sums_begin(add, sum);
    for (int t = 0; t < taps; t++) {
        const uint16_t *w = b + tap[t] * blocks * 2 * TILE;
        for (int64_t block = 0; block < blocks; block++, a += 2 * TILE, w += 2 * TILE) {
            tile_load(4, a, 64);
            tile_load(5, a + TILE, 64);
            tile_load(6, w, 64);
            tile_product(0, 4, 6);
            tile_product(2, 5, 6);
            if (!wide) continue;
            tile_load(7, w + TILE, 64);
            tile_product(1, 4, 7);
            tile_product(3, 5, 7);
        }
    }
    sums_end(sum);
}

AMX_INLINE void group_store(const rows_job *j, int64_t group, int64_t n, const float *sum) {
    const __mmask16 low = lanes(j->N - n), high = lanes(j->N - n - 16);
    for (int r = 0; r < GROUP && j->sorted.order[group * GROUP + r] >= 0; r++) {
        float *to = j->y + j->sorted.order[group * GROUP + r] * j->N + n;
        const float *at = sum + r / 16 * 512 + r % 16 * 16;
        __m512 u = _mm512_load_ps(at), v = _mm512_load_ps(at + 256);
        if (j->add) {
            u = _mm512_add_ps(u, _mm512_maskz_loadu_ps(low, to));
            v = _mm512_add_ps(v, _mm512_maskz_loadu_ps(high, to + 16));
        }
        _mm512_mask_storeu_ps(to, low, u);
        _mm512_mask_storeu_ps(to + 16, high, v);
    }
}

/* A few taps at a time, so that the gathered rows stay in the L1 cache for all columns. */
AMX_INLINE void group_sums(const rows_job *j, int64_t group, int64_t blocks, uint16_t *a, float *sums) {
    const int64_t set = TAPS * blocks * 2 * TILE;
    const int max = blocks < FEW ? (int)(FEW / blocks) : 1;
    bool add = false;
    for (uint32_t left = j->sorted.present[group]; left || !add; add = true) {
        int tap[FEW], taps = 0;
        for (; left && taps < max; left &= left - 1, taps++) {
            tap[taps] = __builtin_ctz(left);
            group_gather(j, group, tap[taps], blocks, a + taps * blocks * 2 * TILE);
        }
        for (int64_t column = 0; column < j->columns; column += 2) {
            const uint16_t *b = j->b + column / 2 * set;
            float *sum = sums + column / 2 * 1024;
            if (column + 1 < j->columns)
                group_product(tap, taps, blocks, a, b, true, add, sum);
            else
                group_product(tap, taps, blocks, a, b, false, add, sum);
        }
    }
}

AMX static void rows_range(void *arg, int64_t begin, int64_t end, int thread) {
    const rows_job *j = arg;
    uint16_t *a = j->a + thread * j->a_set;
    float *sums = j->sums + thread * tiles(j->columns, 2) * 1024;
    tiles_begin();
    for (int64_t group = begin; group < end; group++) {
        if (j->x.blocks == 1)
            group_sums(j, group, 1, a, sums);
        else if (j->x.blocks == 2)
            group_sums(j, group, 2, a, sums);
        else
            group_sums(j, group, j->x.blocks, a, sums);
        for (int64_t column = 0; column < j->columns; column += 2)
            group_store(j, group, column * SIDE, sums + column / 2 * 1024);
    }
    _tile_release();
}

sherf_status amx_sparse_rows(op_call *call, const tensor *x, const int32_t *rule, bool back, bool add,
                             tensor *y) {
    const tensor *w = call->in[1];
    rows_job j = {.sorted = {.rows = y->dim[0], .rule = rule}, .w = w->data, .O = w->dim[0], .I = w->dim[4]};
    j.back = back;
    j.add = add;
    j.y = y->data;
    j.N = y->dim[1];
    j.columns = tiles(j.N, SIDE);
    if (!rows_sort(call, &j.sorted) || !rows_copy(call, &j.x, x)) return SHERF_NO_MEMORY;
    const size_t set = (size_t)(TAPS * j.x.blocks * 2) * TILE, threads = (size_t)call->c->threads;
    j.b = arena_alloc(call->c, call->scratch, (size_t)tiles(j.columns, 2) * set, sizeof *j.b);
    j.a_set = (j.x.blocks < FEW ? FEW : j.x.blocks) * 2 * TILE;
    j.a = arena_alloc(call->c, call->scratch, threads * (size_t)j.a_set, sizeof *j.a);
    j.sums =
        arena_alloc(call->c, call->scratch, threads * (size_t)tiles(j.columns, 2), 1024 * sizeof *j.sums);
    if (!j.a || !j.b || !j.sums) return SHERF_NO_MEMORY;
    parallel_for(call->c, j.columns * TAPS, 64, pack_range, &j);
    parallel_for(call->c, j.sorted.groups, 4, rows_range, &j);
    return SHERF_OK;
}

/* ---- gradient of the weights ---- */
/* A unit of work is a tap and a pair of input tiles, over all rows: a few groups of 32 rows are gathered at a
 * time and multiplied with all outputs. */
enum { FEW_GROUPS = 16 };
typedef struct {
    row_order sorted;
    bf16_rows x;
    const float *dy;
    int64_t O, rows;    /* outputs; pairs of output tiles */
    uint16_t *dy_tiles; /* [2 rows][groups] tiles: outputs by pairs of sorted rows */
    uint16_t *x_tiles;  /* for each thread: [FEW_GROUPS][2] tiles: pairs of sorted rows by inputs */
    float *sums;        /* for each thread: [rows][2][2] tiles */
    float *dw;
} weight_job;

AMX static void turn_range(void *arg, int64_t begin, int64_t end, int thread) {
    const weight_job *j = arg;
    const __m512i order = pair_order();
    __m512i v[16];
    for (int64_t at = begin; at < end; at++) { /* one tile */
        const int64_t o = at / j->sorted.groups * SIDE, group = at % j->sorted.groups;
        const int32_t *row = j->sorted.order + group * GROUP;
        const __mmask16 mask = lanes(j->O - o);
        for (int p = 0; p < 16; p++) {
            const int64_t r = row[2 * p], s = row[2 * p + 1];
            const __m512 a = _mm512_maskz_loadu_ps(r < 0 ? 0 : mask, j->dy + (r < 0 ? 0 : r * j->O + o));
            const __m512 b = _mm512_maskz_loadu_ps(s < 0 ? 0 : mask, j->dy + (s < 0 ? 0 : s * j->O + o));
            v[p] = _mm512_permutexvar_epi16(order, (__m512i)_mm512_cvtne2ps_pbh(b, a));
        }
        transpose_16x16(v);
        tile_write(v, j->dy_tiles + at * TILE);
    }
}

/* Two tiles: pairs of the group's rows by 32 inputs. */
AMX_INLINE void pairs_gather(const weight_job *j, int64_t group, int tap, int64_t block, uint16_t *to) {
    const uint16_t *x = j->x.data + block * 32;
    const int64_t wide = j->x.blocks * 32;
    const __m512i order = pair_order();
    int32_t from[GROUP] __attribute__((aligned(64)));
    group_from(&j->sorted, &j->x, group, tap, from);
    for (int p = 0; p < 16; p++) {
        const __m512i a = _mm512_load_si512(x + from[2 * p] * wide);
        const __m512i b = _mm512_load_si512(x + from[2 * p + 1] * wide);
        const __m512i low = _mm512_inserti64x4(a, _mm512_castsi512_si256(b), 1);
        const __m512i high = _mm512_shuffle_i64x2(a, b, 0xee);
        _mm512_store_si512(to + p * 32, _mm512_permutexvar_epi16(order, low));
        _mm512_store_si512(to + TILE + p * 32, _mm512_permutexvar_epi16(order, high));
    }
}

/* sums += a pair of tiles of outputs times the gathered inputs, over some groups. */
AMX_INLINE void weight_product(const weight_job *j, int64_t row, const int64_t *group, int count,
                               const uint16_t *x, float *sums) {
    const uint16_t *a = j->dy_tiles + 2 * row * j->sorted.groups * TILE, *a2 = a + j->sorted.groups * TILE;
    sums_begin(true, sums);
    for (int s = 0; s < count; s++, x += 2 * TILE) {
        tile_load(4, a + group[s] * TILE, 64);
        tile_load(5, a2 + group[s] * TILE, 64);
        tile_load(6, x, 64);
        tile_load(7, x + TILE, 64);
        tile_product(0, 4, 6);
        tile_product(1, 4, 7);
        tile_product(2, 5, 6);
        tile_product(3, 5, 7);
    }
    sums_end(sums);
}

/* dw += the sums of a tap and of 32 inputs from i. */
AMX_INLINE void weight_add(const weight_job *j, int tap, int64_t i, const float *sums) {
    const int64_t I = j->x.channels;
    for (int64_t o = 0; o < j->O; o++)
        for (int64_t c = i; c < i + 32 && c < I; c += 16) {
            const __mmask16 mask = lanes(I - c);
            const float *from = sums + o / 32 * 1024 + (o / 16 % 2 * 2 + (c - i) / 16) * 256 + o % 16 * 16;
            float *to = j->dw + (o * TAPS + tap) * I + c;
            _mm512_mask_storeu_ps(to, mask,
                                  _mm512_add_ps(_mm512_load_ps(from), _mm512_maskz_loadu_ps(mask, to)));
        }
}

AMX static void weight_range(void *arg, int64_t begin, int64_t end, int thread) {
    const weight_job *j = arg;
    uint16_t *x = j->x_tiles + thread * FEW_GROUPS * 2 * TILE;
    float *sums = j->sums + thread * j->rows * 1024;
    tiles_begin();
    for (int64_t at = begin; at < end; at++) {
        const int tap = (int)(at % TAPS);
        const int64_t block = at / TAPS;
        memset(sums, 0, (size_t)j->rows * 1024 * sizeof *sums);
        for (int64_t group = 0; group < j->sorted.groups;) {
            int64_t taken[FEW_GROUPS];
            int count = 0;
            for (; group < j->sorted.groups && count < FEW_GROUPS; group++) {
                if (!(j->sorted.present[group] >> tap & 1)) continue;
                pairs_gather(j, group, tap, block, x + count * 2 * TILE);
                taken[count++] = group;
            }
            for (int64_t row = 0; count && row < j->rows; row++)
                weight_product(j, row, taken, count, x, sums + row * 1024);
        }
        weight_add(j, tap, block * 32, sums);
    }
    _tile_release();
}

sherf_status amx_sparse_weights(op_call *call, const tensor *x, const int32_t *rule, const tensor *dy,
                                tensor *dw) {
    weight_job j = {.sorted = {.rows = dy->dim[0], .rule = rule}, .dy = dy->data, .O = dy->dim[1]};
    j.dw = dw->data;
    j.rows = tiles(j.O, 32);
    if (!rows_sort(call, &j.sorted) || !rows_copy(call, &j.x, x)) return SHERF_NO_MEMORY;
    const size_t threads = (size_t)call->c->threads, dy_tiles = (size_t)(2 * j.rows * j.sorted.groups);
    j.dy_tiles = arena_alloc(call->c, call->scratch, dy_tiles, TILE * sizeof *j.dy_tiles);
    j.x_tiles = arena_alloc(call->c, call->scratch, threads * FEW_GROUPS * 2, TILE * sizeof *j.x_tiles);
    j.sums = arena_alloc(call->c, call->scratch, threads * (size_t)j.rows, 1024 * sizeof *j.sums);
    if (!j.dy_tiles || !j.x_tiles || !j.sums) return SHERF_NO_MEMORY;
    parallel_for(call->c, (int64_t)dy_tiles, 64, turn_range, &j);
    parallel_for(call->c, j.x.blocks * TAPS, 1, weight_range, &j);
    return SHERF_OK;
}

#else
sherf_status amx_sparse_rows(op_call *call, const tensor *x, const int32_t *rule, bool back, bool add,
                             tensor *y) {
    return failure(call->c, SHERF_UNSUPPORTED, "no AMX on this processor");
}
sherf_status amx_sparse_weights(op_call *call, const tensor *x, const int32_t *rule, const tensor *dy,
                                tensor *dw) {
    return failure(call->c, SHERF_UNSUPPORTED, "no AMX on this processor");
}
#endif
