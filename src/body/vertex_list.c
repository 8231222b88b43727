/* Lists of the vertices that can be nearest to a point in a voxel. U is the smallest, over all vertices, of a
 * vertex's largest distance to the voxel, so some vertex is within U of every point inside. A vertex is
 * listed if its smallest distance to the voxel is at most U. Voxels are processed in blocks of 4 x 4 x 4 that
 * share the vertices around them. */
#include <pthread.h>
#include <float.h>
#include <math.h>
#include <string.h>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "body/vertex_grid.h"

#define INLINE static inline __attribute__((always_inline))
#define AVX2 __attribute__((target("avx2")))
#define AVX512 __attribute__((target("avx512f,avx512vl,avx512dq,avx512bw,avx2")))

/* ---- the search of a list ---- */
INLINE void take(nearest_state *best, float d2, int32_t index) {
    if (d2 < best->d2 || (d2 == best->d2 && index < best->index)) best->d2 = d2, best->index = index;
}

static void list_plain(const vertex_block *block, int blocks, const float p[3], nearest_state *best) {
    for (int b = 0; b < blocks; b++, block++) {
        float d2[16];
        for (int i = 0; i < 16; i++) {
            float dx = block->x[i] - p[0], dy = block->y[i] - p[1], dz = block->z[i] - p[2];
            d2[i] = (dx * dx + dy * dy) + dz * dz;
        }
        for (int i = 0; i < 16; i++) take(best, d2[i], block->index[i]);
    }
}

#if defined(__x86_64__)
/* Lanes keep their own best; the end compares them. */
AVX2 static void list_avx2(const vertex_block *block, int blocks, const float p[3], nearest_state *best) {
    __m256 px = _mm256_set1_ps(p[0]), py = _mm256_set1_ps(p[1]), pz = _mm256_set1_ps(p[2]);
    __m256 d2_min = _mm256_set1_ps(best->d2);
    __m256i at = _mm256_set1_epi32(best->index);
    for (int b = 0; b < 2 * blocks; b++) {
        const vertex_block *k = block + b / 2;
        int half = 8 * (b % 2);
        __m256 dx = _mm256_sub_ps(_mm256_load_ps(k->x + half), px);
        __m256 dy = _mm256_sub_ps(_mm256_load_ps(k->y + half), py);
        __m256 dz = _mm256_sub_ps(_mm256_load_ps(k->z + half), pz);
        __m256 d2 =
            _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(dx, dx), _mm256_mul_ps(dy, dy)), _mm256_mul_ps(dz, dz));
        __m256i index = _mm256_load_si256((const __m256i *)(k->index + half));
        __m256 closer = _mm256_cmp_ps(d2, d2_min, _CMP_LT_OQ), same = _mm256_cmp_ps(d2, d2_min, _CMP_EQ_OQ);
        __m256 lower = _mm256_castsi256_ps(_mm256_cmpgt_epi32(at, index));
        __m256 better = _mm256_or_ps(closer, _mm256_and_ps(same, lower));
        d2_min = _mm256_blendv_ps(d2_min, d2, better);
        at = _mm256_castps_si256(
            _mm256_blendv_ps(_mm256_castsi256_ps(at), _mm256_castsi256_ps(index), better));
    }
    float d2[8];
    int32_t index[8];
    _mm256_storeu_ps(d2, d2_min);
    _mm256_storeu_si256((__m256i *)index, at);
    for (int i = 0; i < 8; i++) take(best, d2[i], index[i]);
}

AVX512 static void list_avx512(const vertex_block *block, int blocks, const float p[3], nearest_state *best) {
    __m512 px = _mm512_set1_ps(p[0]), py = _mm512_set1_ps(p[1]), pz = _mm512_set1_ps(p[2]);
    __m512 d2_min = _mm512_set1_ps(best->d2);
    __m512i at = _mm512_set1_epi32(best->index);
    for (int b = 0; b < blocks; b++, block++) {
        __m512 dx = _mm512_sub_ps(_mm512_load_ps(block->x), px);
        __m512 dy = _mm512_sub_ps(_mm512_load_ps(block->y), py);
        __m512 dz = _mm512_sub_ps(_mm512_load_ps(block->z), pz);
        __m512 d2 =
            _mm512_add_ps(_mm512_add_ps(_mm512_mul_ps(dx, dx), _mm512_mul_ps(dy, dy)), _mm512_mul_ps(dz, dz));
        __m512i index = _mm512_load_si512(block->index);
        __mmask16 better = _mm512_cmp_ps_mask(d2, d2_min, _CMP_LT_OQ);
        __mmask16 same = _mm512_cmp_ps_mask(d2, d2_min, _CMP_EQ_OQ);
        better |= _mm512_mask_cmplt_epi32_mask(same, index, at);
        d2_min = _mm512_mask_mov_ps(d2_min, better, d2);
        at = _mm512_mask_mov_epi32(at, better, index);
    }
    float d2 = _mm512_reduce_min_ps(d2_min);
    __mmask16 same = _mm512_cmp_ps_mask(d2_min, _mm512_set1_ps(d2), _CMP_EQ_OQ);
    if (!same) return; /* the point is NaN */
    best->d2 = d2;
    best->index = same & (same - 1)
                      ? _mm512_mask_reduce_min_epi32(same, at)
                      : _mm_cvtsi128_si32(_mm512_castsi512_si128(_mm512_maskz_compress_epi32(same, at)));
}
#endif

list_function *vertex_list_best(void) {
    return ISA_CHOICE_X86(isa_best(), list);
}

/* ---- making the lists ---- */
enum { SIDE = 4, GATHERED_MAX = 4096 };

/* Vertices around a block of voxels. */
typedef struct {
    int count;
    float x[GATHERED_MAX], y[GATHERED_MAX], z[GATHERED_MAX], d2[GATHERED_MAX];
    int32_t index[GATHERED_MAX], chosen[GATHERED_MAX];
} gathered;

typedef void choose_function(gathered *a, const float low[3], const float high[3], float limit_d2,
                             float *nearest, int *chosen);

/* Chooses the vertices for the voxel [low, high] into a->chosen; *nearest: the least squared distance to it.
 */
INLINE void choose_any(gathered *a, const float low[3], const float high[3], float limit_d2, float *nearest,
                       int *chosen) {
    float within = limit_d2, d2_min = FLT_MAX;
    for (int i = 0; i < a->count; i++) {
        float x = a->x[i], y = a->y[i], z = a->z[i];
        float x0 = low[0] - x, x1 = x - high[0], y0 = low[1] - y, y1 = y - high[1], z0 = low[2] - z,
              z1 = z - high[2];
        /* the distance to the far side is -min(x0, x1), to the near side max(x0, x1, 0) */
        float fx = x0 < x1 ? x0 : x1, fy = y0 < y1 ? y0 : y1, fz = z0 < z1 ? z0 : z1;
        float nx = x0 > x1 ? x0 : x1, ny = y0 > y1 ? y0 : y1, nz = z0 > z1 ? z0 : z1;
        nx = nx > 0 ? nx : 0, ny = ny > 0 ? ny : 0, nz = nz > 0 ? nz : 0;
        float far2 = fx * fx + fy * fy + fz * fz, near2 = nx * nx + ny * ny + nz * nz;
        a->d2[i] = near2;
        within = far2 < within ? far2 : within;
        d2_min = near2 < d2_min ? near2 : d2_min;
    }
    within *= 1.0001f; /* rounding */
    int n = 0;
    for (int i = 0; i < a->count; i++) {
        a->chosen[n] = i;
        n += a->d2[i] <= within;
    }
    *nearest = d2_min;
    *chosen = n;
}

static void choose_plain(gathered *a, const float low[3], const float high[3], float limit_d2, float *nearest,
                         int *chosen) {
    choose_any(a, low, high, limit_d2, nearest, chosen);
}
#if defined(__x86_64__)
AVX2 static float min_of(__m256 x) {
    __m128 half = _mm_min_ps(_mm256_castps256_ps128(x), _mm256_extractf128_ps(x, 1));
    half = _mm_min_ps(half, _mm_movehl_ps(half, half));
    return _mm_cvtss_f32(_mm_min_ss(half, _mm_shuffle_ps(half, half, 1)));
}

AVX2 static void choose_avx2(gathered *a, const float low[3], const float high[3], float limit_d2,
                             float *nearest, int *chosen) {
    const __m256 zero = _mm256_setzero_ps(), none = _mm256_set1_ps(FLT_MAX);
    const __m256i lane = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    __m256 within = _mm256_set1_ps(limit_d2), d2_min = none;
    const float *axis[3] = {a->x, a->y, a->z};
    for (int i = 0; i < a->count; i += 8) { /* the arrays have room for whole vectors */
        const __m256 in = _mm256_castsi256_ps(_mm256_cmpgt_epi32(_mm256_set1_epi32(a->count - i), lane));
        __m256 far2 = zero, near2 = zero;
        for (int k = 0; k < 3; k++) {
            __m256 x = _mm256_loadu_ps(axis[k] + i);
            __m256 x0 = _mm256_sub_ps(_mm256_set1_ps(low[k]), x),
                   x1 = _mm256_sub_ps(x, _mm256_set1_ps(high[k]));
            __m256 f = _mm256_min_ps(x0, x1), n = _mm256_max_ps(_mm256_max_ps(x0, x1), zero);
            far2 = _mm256_add_ps(far2, _mm256_mul_ps(f, f));
            near2 = _mm256_add_ps(near2, _mm256_mul_ps(n, n));
        }
        near2 = _mm256_blendv_ps(none, near2, in);
        _mm256_storeu_ps(a->d2 + i, near2);
        within = _mm256_min_ps(within, _mm256_blendv_ps(none, far2, in));
        d2_min = _mm256_min_ps(d2_min, near2);
    }
    *nearest = min_of(d2_min);
    within = _mm256_set1_ps(min_of(within) * 1.0001f);
    int n = 0;
    for (int i = 0; i < a->count; i += 8) {
        unsigned in =
            (unsigned)_mm256_movemask_ps(_mm256_cmp_ps(_mm256_loadu_ps(a->d2 + i), within, _CMP_LE_OQ));
        if (i + 8 > a->count) in &= (1u << (a->count - i)) - 1;
        for (; in; in &= in - 1) a->chosen[n++] = i + __builtin_ctz(in);
    }
    *chosen = n;
}

AVX512 static void choose_avx512(gathered *a, const float low[3], const float high[3], float limit_d2,
                                 float *nearest, int *chosen) {
    __m512 within = _mm512_set1_ps(limit_d2), d2_min = _mm512_set1_ps(FLT_MAX), zero = _mm512_setzero_ps();
    const float *axis[3] = {a->x, a->y, a->z};
    for (int i = 0; i < a->count; i += 16) {
        __mmask16 in = a->count - i < 16 ? (__mmask16)((1u << (a->count - i)) - 1) : (__mmask16)0xFFFF;
        __m512 far2 = zero, near2 = zero;
        for (int k = 0; k < 3; k++) {
            __m512 x = _mm512_loadu_ps(axis[k] + i);
            __m512 x0 = _mm512_sub_ps(_mm512_set1_ps(low[k]), x),
                   x1 = _mm512_sub_ps(x, _mm512_set1_ps(high[k]));
            __m512 f = _mm512_min_ps(x0, x1), n = _mm512_max_ps(_mm512_max_ps(x0, x1), zero);
            far2 = _mm512_add_ps(far2, _mm512_mul_ps(f, f));
            near2 = _mm512_add_ps(near2, _mm512_mul_ps(n, n));
        }
        _mm512_storeu_ps(a->d2 + i, near2);
        within = _mm512_mask_min_ps(within, in, within, far2);
        d2_min = _mm512_mask_min_ps(d2_min, in, d2_min, near2);
    }
    *nearest = _mm512_reduce_min_ps(d2_min);
    within = _mm512_set1_ps(_mm512_reduce_min_ps(within) * 1.0001f);
    int n = 0;
    __m512i lane = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    for (int i = 0; i < a->count; i += 16) {
        __mmask16 in = a->count - i < 16 ? (__mmask16)((1u << (a->count - i)) - 1) : (__mmask16)0xFFFF;
        in = _mm512_mask_cmp_ps_mask(in, _mm512_loadu_ps(a->d2 + i), within, _CMP_LE_OQ);
        __m512i number = _mm512_maskz_compress_epi32(in, _mm512_add_epi32(lane, _mm512_set1_epi32(i)));
        int count = __builtin_popcount(in);
        _mm512_mask_storeu_epi32(a->chosen + n, (__mmask16)((1u << count) - 1), number);
        n += count;
    }
    *chosen = n;
}
#endif

typedef struct {
    vertex_grid *g;
    int blocks[3]; /* of SIDE voxels */
    choose_function *choose;
    bool failed;
} refine_job;

/* The thread's current slab. */
typedef struct {
    int used, slab; /* used == SLAB_BLOCKS: a new one is needed */
} slab_cursor;

/* For the grid's list of slabs; an OpenMP critical section would export a symbol from the shared library. */
static pthread_mutex_t slab_lock = PTHREAD_MUTEX_INITIALIZER;

static vertex_block *blocks_take(refine_job *job, slab_cursor *at, int blocks, int32_t *number) {
    vertex_grid *g = job->g;
    if (at->used + blocks > SLAB_BLOCKS) {
        bool taken = false;
        pthread_mutex_lock(&slab_lock);
        if (g->slabs < SLABS_MAX) {
            context quiet = {0}; /* this thread must not write the caller's message */
            vertex_block *slab = mem_alloc(&quiet, SLAB_BLOCKS, sizeof *slab);
            if (slab) {
                at->slab = g->slabs;
                g->slab[g->slabs++] = slab;
                taken = true;
            } else {
                job->failed = true;
            }
        }
        pthread_mutex_unlock(&slab_lock);
        if (!taken) return NULL;
        at->used = 0;
    }
    *number = at->slab * SLAB_BLOCKS + at->used;
    at->used += blocks;
    return g->slab[at->slab] + *number % SLAB_BLOCKS;
}

/* False: there are too many. */
static bool gather(const vertex_grid *g, const float low[3], const float high[3], float radius, gathered *a) {
    int first[3], last[3];
    a->count = 0;
    for (int k = 0; k < 3; k++) {
        first[k] = vertex_grid_cell(g, k, low[k] - radius);
        last[k] = vertex_grid_cell(g, k, high[k] + radius);
    }
    for (int z = first[2]; z <= last[2]; z++)
        for (int y = first[1]; y <= last[1]; y++) {
            const int32_t *row = g->start + ((int64_t)z * g->cells[1] + y) * g->cells[0];
            int begin = row[first[0]], count = row[last[0] + 1] - begin;
            if (a->count + count > GATHERED_MAX - 16) return false;
            memcpy(a->x + a->count, g->x + begin, (size_t)count * sizeof *a->x);
            memcpy(a->y + a->count, g->y + begin, (size_t)count * sizeof *a->y);
            memcpy(a->z + a->count, g->z + begin, (size_t)count * sizeof *a->z);
            memcpy(a->index + a->count, g->index + begin, (size_t)count * sizeof *a->index);
            a->count += count;
        }
    return true;
}

static int32_t store_list(refine_job *job, slab_cursor *at, const gathered *a, int chosen) {
    int blocks = (chosen + 15) / 16;
    int32_t number;
    if (blocks < 1 || blocks > LIST_BLOCKS_MAX) return LIST_NONE;
    vertex_block *block = blocks_take(job, at, blocks, &number);
    if (!block) return LIST_NONE;
    for (int i = 0; i < 16 * blocks; i++) {
        vertex_block *b = block + i / 16;
        int from = a->chosen[i < chosen ? i : 0];
        b->x[i % 16] = i < chosen ? a->x[from] : FLT_MAX;
        b->y[i % 16] = a->y[from];
        b->z[i % 16] = a->z[from];
        b->index[i % 16] = i < chosen ? a->index[from] : INT32_MAX;
    }
    return number << 6 | blocks;
}

static void refine_block(refine_job *job, slab_cursor *at, gathered *a, int64_t n) {
    vertex_grid *g = job->g;
    vertex_shell *s = &g->shell;
    int first[3] = {(int)(n % job->blocks[0]), (int)(n / job->blocks[0] % job->blocks[1]),
                    (int)(n / job->blocks[0] / job->blocks[1])},
        last[3];
    float low[3], high[3], limit = g->limit_d2, reach2 = g->reach_m * g->reach_m;
    for (int k = 0; k < 3; k++) {
        first[k] *= SIDE;
        last[k] = first[k] + SIDE < s->cells[k] ? first[k] + SIDE : s->cells[k];
        low[k] = s->min[k] + (float)first[k] * s->cell_m;
        high[k] = s->min[k] + (float)last[k] * s->cell_m;
    }
    /* candidates: within U <= reach + the voxel's diagonal, or within the grid's own radius */
    float radius = g->reach_m + 1.7321f * s->cell_m;
    if (limit < radius * radius) radius = fmaxf(sqrtf(limit), g->reach_m);
    radius = radius * 1.001f + g->slack_m;
    bool few = gather(g, low, high, radius, a);
    if (few && a->count == 0) return;
    for (int z = first[2]; z < last[2]; z++)
        for (int y = first[1]; y < last[1]; y++)
            for (int x = first[0]; x < last[0]; x++) {
                const int cell[3] = {x, y, z};
                float nearest = 0;
                int chosen = GATHERED_MAX;
                for (int k = 0; k < 3; k++) { /* larger: rounding may reach the next voxel */
                    float margin = 1e-4f * s->cell_m + g->slack_m;
                    low[k] = s->min[k] + (float)cell[k] * s->cell_m - margin;
                    high[k] = s->min[k] + (float)(cell[k] + 1) * s->cell_m + margin;
                }
                if (few) job->choose(a, low, high, limit, &nearest, &chosen);
                if (nearest > reach2) continue;
                size_t row = (size_t)z * (size_t)s->cells[1] + (size_t)y;
                s->bit[row * (size_t)s->words + (size_t)x / 32] |= 1u << (x % 32);
                g->entry[row * (size_t)s->cells[0] + (size_t)x] =
                    few ? store_list(job, at, a, chosen) : LIST_NONE;
            }
}

/* Layers of blocks along z: each thread writes its own rows. */
static void refine_layers(void *arg, int64_t begin, int64_t end, int thread) {
    refine_job *job = arg;
    int64_t layer = (int64_t)job->blocks[0] * job->blocks[1];
    slab_cursor at = {.used = SLAB_BLOCKS};
    context quiet = {0};
    gathered *a = mem_alloc(&quiet, 1, sizeof *a);
    if (!a) {
#pragma omp atomic write
        job->failed = true;
        return;
    }
    for (int64_t n = begin * layer; n < end * layer; n++) refine_block(job, &at, a, n);
    mem_free(a);
}

/* voxel_m for 6890 vertices, smaller if they are denser; at least two empty voxels on all sides. */
static sherf_status shell_create(context *c, vertex_grid *g, float reach_m, float voxel_m) {
    const double voxels_max = 1 << 22;
    vertex_shell *s = &g->shell;
    double cell = voxel_m * sqrt(6890.0 / g->vertices), count;
    float max[3];
    for (int k = 0; k < 3; k++) max[k] = -FLT_MAX;
    for (int64_t i = 0; i < 3 * (int64_t)g->vertices; i++) max[i % 3] = fmaxf(max[i % 3], g->vertex[i]);
    if (cell < 0.002) cell = 0.002;
    if (cell > voxel_m) cell = voxel_m;
    if (cell < 1e-3 * reach_m) cell = 1e-3 * reach_m;
    for (;; cell *= 1.1) {
        count = 1;
        for (int k = 0; k < 3; k++) count *= ceil(((double)max[k] - g->min[k] + 2 * reach_m) / cell) + 4;
        if (count <= voxels_max) break;
    }
    s->cell_m = (float)cell;
    g->shell_per_m = 1 / s->cell_m;
    g->reach_m = reach_m;
    for (int k = 0; k < 3; k++) {
        s->cells[k] = (int)ceil(((double)max[k] - g->min[k] + 2 * reach_m) / cell) + 4;
        s->min[k] = g->min[k] - reach_m - 2 * s->cell_m;
    }
    s->words = (s->cells[0] + 31) / 32;
    size_t rows = (size_t)s->cells[1] * (size_t)s->cells[2];
    s->bit = mem_zero(c, rows, (size_t)s->words * sizeof *s->bit);
    g->entry = mem_zero(c, rows, (size_t)s->cells[0] * sizeof *g->entry);
    return s->bit && g->entry ? SHERF_OK : SHERF_NO_MEMORY;
}

sherf_status vertex_grid_refine(context *c, vertex_grid *g, float reach_m, float voxel_m) {
    if (g->entry || !(reach_m > 0 && reach_m < 1e6f) || !(voxel_m > 0 && voxel_m < 1e6f))
        return failure(c, SHERF_BAD_ARGUMENT,
                       "vertex grid: refined to %g m in voxels of %g m, must be once and positive", reach_m,
                       voxel_m);
    sherf_status status = shell_create(c, g, reach_m, voxel_m);
    if (status != SHERF_OK) return status;
    refine_job job = {.g = g, .choose = ISA_CHOICE_X86(isa_best(), choose)};
    for (int k = 0; k < 3; k++) job.blocks[k] = (g->shell.cells[k] + SIDE - 1) / SIDE;
    g->list = vertex_list_best();
    parallel_for(c, job.blocks[2], 1, refine_layers, &job);
    if (job.failed) return failure(c, SHERF_NO_MEMORY, "out of memory: lists of nearest vertices");
    return SHERF_OK;
}

const vertex_shell *vertex_grid_shell(const vertex_grid *g) {
    return g->entry ? &g->shell : NULL;
}
