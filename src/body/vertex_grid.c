/* Exact nearest vertex: from a voxel's list if there is one (vertex_list.c), elsewhere by rings. Vertices are
 * sorted by the cell of a uniform grid, x fastest, so a run of cells along x is one contiguous run of
 * vertices. A search visits rows (y, z) in rings around the point's own row and stops when a ring is farther
 * than the best vertex so far. This file is compiled without fused multiply-add, so every instruction set
 * gives the same squared distances. */
#include <float.h>
#include <math.h>
#include <string.h>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "body/vertex_grid.h"

#define INLINE static inline __attribute__((always_inline))

INLINE void improve(const vertex_grid *g, nearest_state *best, float d2, int32_t index) {
    if (d2 < best->d2 || (d2 == best->d2 && index < best->index)) {
        if (d2 < best->d2) best->reach = sqrtf(d2) * 1.00001f + g->slack_m;
        best->d2 = d2;
        best->index = index;
    }
}

INLINE float squared(float dx, float dy, float dz) {
    return (dx * dx + dy * dy) + dz * dz;
}

typedef void scan_function(const vertex_grid *g, const float p[3], int32_t begin, int32_t end,
                           nearest_state *best);

INLINE void scan_plain(const vertex_grid *g, const float p[3], int32_t begin, int32_t end,
                       nearest_state *best) {
    for (int32_t i = begin; i < end; i++) {
        float d2 = squared(g->x[i] - p[0], g->y[i] - p[1], g->z[i] - p[2]);
        if (d2 <= best->d2) improve(g, best, d2, g->index[i]);
    }
}

/* Lower bound of the distance between x and cell `cell` along an axis, 0 inside. */
INLINE float slab_distance(const vertex_grid *g, int axis, int cell, float x) {
    float low = g->min[axis] + (float)cell * g->cell_m, high = g->min[axis] + (float)(cell + 1) * g->cell_m;
    float d = x < low ? low - x : x > high ? x - high : 0;
    d = d * 0.99999f - g->slack_m;
    return d > 0 ? d : 0;
}

INLINE void scan_row(const vertex_grid *g, const float p[3], int y, int z, float d2, nearest_state *best,
                     scan_function *scan) {
    if (d2 > best->d2) return;
    const int32_t *row = g->start + ((int64_t)z * g->cells[1] + y) * g->cells[0];
    int32_t begin = row[vertex_grid_cell(g, 0, p[0] - best->reach)],
            end = row[vertex_grid_cell(g, 0, p[0] + best->reach) + 1];
    if (begin < end) scan(g, p, begin, end, best);
}

INLINE void search_rings(const vertex_grid *g, const float p[3], nearest_state *best, scan_function *scan) {
    int ny = g->cells[1], nz = g->cells[2], cy = vertex_grid_cell(g, 1, p[1]),
        cz = vertex_grid_cell(g, 2, p[2]);
    float own_y = slab_distance(g, 1, cy, p[1]), own_z = slab_distance(g, 2, cz, p[2]);
    scan_row(g, p, cy, cz, own_y * own_y + own_z * own_z, best, scan);
    for (int k = 1;; k++) {
        int y0 = cy - k, y1 = cy + k, z0 = cz - k, z1 = cz + k;
        float left = y0 >= 0 ? slab_distance(g, 1, y0, p[1]) : INFINITY;
        float right = y1 < ny ? slab_distance(g, 1, y1, p[1]) : INFINITY;
        float below = z0 >= 0 ? slab_distance(g, 2, z0, p[2]) : INFINITY;
        float above = z1 < nz ? slab_distance(g, 2, z1, p[2]) : INFINITY;
        float d_min = fminf(fminf(left, right), fminf(below, above));
        if (d_min == INFINITY || d_min * d_min > best->d2) return;
        for (int z = z0 < 0 ? 0 : z0; z <= z1 && z < nz; z++) {
            bool edge = z == z0 || z == z1;
            float dz = edge ? z == z0 ? below : above : slab_distance(g, 2, z, p[2]);
            dz *= dz;
            if (dz > best->d2) continue;
            if (y0 >= 0) scan_row(g, p, y0, z, dz + left * left, best, scan);
            for (int y = y0 < 0 ? 0 : y0 + 1; edge && y < y1 && y < ny; y++) {
                float dy = slab_distance(g, 1, y, p[1]);
                scan_row(g, p, y, z, dz + dy * dy, best, scan);
            }
            if (y1 < ny) scan_row(g, p, y1, z, dz + right * right, best, scan);
        }
    }
}

static void search_plain(const vertex_grid *g, const float p[3], nearest_state *best) {
    search_rings(g, p, best, scan_plain);
}

#if defined(__x86_64__)
#define AVX2 __attribute__((target("avx2")))
#define AVX512 __attribute__((target("avx512f,avx512vl,avx512dq,avx512bw,avx2")))

AVX2 INLINE void scan_avx2(const vertex_grid *g, const float p[3], int32_t begin, int32_t end,
                           nearest_state *best) {
    __m256 px = _mm256_set1_ps(p[0]), py = _mm256_set1_ps(p[1]), pz = _mm256_set1_ps(p[2]);
    for (int32_t i = begin; i < end; i += 8) { /* reading the padding is fine */
        __m256 dx = _mm256_sub_ps(_mm256_loadu_ps(g->x + i), px);
        __m256 dy = _mm256_sub_ps(_mm256_loadu_ps(g->y + i), py);
        __m256 dz = _mm256_sub_ps(_mm256_loadu_ps(g->z + i), pz);
        __m256 d2 =
            _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(dx, dx), _mm256_mul_ps(dy, dy)), _mm256_mul_ps(dz, dz));
        unsigned near = (unsigned)_mm256_movemask_ps(_mm256_cmp_ps(d2, _mm256_set1_ps(best->d2), _CMP_LE_OQ));
        if (end - i < 8) near &= (1u << (end - i)) - 1;
        if (!near) continue;
        float d[8];
        _mm256_storeu_ps(d, d2);
        for (; near; near &= near - 1) {
            int lane = __builtin_ctz(near);
            improve(g, best, d[lane], g->index[i + lane]);
        }
    }
}

AVX512 INLINE void scan_avx512(const vertex_grid *g, const float p[3], int32_t begin, int32_t end,
                               nearest_state *best) {
    __m512 px = _mm512_set1_ps(p[0]), py = _mm512_set1_ps(p[1]), pz = _mm512_set1_ps(p[2]);
    for (int32_t i = begin; i < end; i += 16) { /* reading the padding is fine */
        __m512 dx = _mm512_sub_ps(_mm512_loadu_ps(g->x + i), px);
        __m512 dy = _mm512_sub_ps(_mm512_loadu_ps(g->y + i), py);
        __m512 dz = _mm512_sub_ps(_mm512_loadu_ps(g->z + i), pz);
        __m512 d2 =
            _mm512_add_ps(_mm512_add_ps(_mm512_mul_ps(dx, dx), _mm512_mul_ps(dy, dy)), _mm512_mul_ps(dz, dz));
        __mmask16 in = end - i < 16 ? (__mmask16)((1u << (end - i)) - 1) : (__mmask16)0xFFFF;
        __mmask16 near = _mm512_mask_cmp_ps_mask(in, d2, _mm512_set1_ps(best->d2), _CMP_LE_OQ);
        if (!near) continue;
        if (!(near & (near - 1))) { /* a single one, the usual case */
            int lane = __builtin_ctz(near);
            improve(g, best, _mm512_cvtss_f32(_mm512_maskz_compress_ps(near, d2)), g->index[i + lane]);
            continue;
        }
        float d_min = _mm512_mask_reduce_min_ps(near, d2);
        near = _mm512_mask_cmp_ps_mask(near, d2, _mm512_set1_ps(d_min), _CMP_EQ_OQ);
        improve(g, best, d_min, _mm512_mask_reduce_min_epi32(near, _mm512_loadu_si512(g->index + i)));
    }
}

AVX2 static void search_avx2(const vertex_grid *g, const float p[3], nearest_state *best) {
    search_rings(g, p, best, scan_avx2);
}
AVX512 static void search_avx512(const vertex_grid *g, const float p[3], nearest_state *best) {
    search_rings(g, p, best, scan_avx512);
}
#endif

static search_function *search_best(void) {
    return ISA_CHOICE_X86(isa_best(), search);
}

/* About a dozen cells for each vertex: for a person, cells of 2.5 cm with two vertices in each that is not
 * empty. */
static void choose_cells(vertex_grid *g, const float max[3]) {
    double extent[3], largest = 0, volume = 1;
    for (int k = 0; k < 3; k++) {
        extent[k] = (double)max[k] - g->min[k];
        largest = fmax(largest, extent[k]);
    }
    if (!(largest > 0)) largest = 1;
    for (int k = 0; k < 3; k++) volume *= fmax(extent[k], 1e-3 * largest);
    double cell = cbrt(volume / (12.0 * g->vertices)), count;
    do {
        cell *= 1.1;
        count = 1;
        for (int k = 0; k < 3; k++) count *= floor(extent[k] / cell) + 1;
    } while (count > 16.0 * g->vertices + 64);
    g->cell_m = fmaxf((float)cell, FLT_MIN * 16);
    g->per_m = 1 / g->cell_m;
    double scale = 0;
    for (int k = 0; k < 3; k++) {
        g->cells[k] = (int)(extent[k] / cell) + 1;
        scale = fmax(scale, fmax(fabs((double)g->min[k]), fabs((double)max[k])));
    }
    g->slack_m = (float)(2e-6 * scale);
}

static int32_t cell_index(const vertex_grid *g, const float p[3]) {
    return (vertex_grid_cell(g, 2, p[2]) * g->cells[1] + vertex_grid_cell(g, 1, p[1])) * g->cells[0] +
           vertex_grid_cell(g, 0, p[0]);
}

/* Counting sort by cell; within a cell in the order of the vertices. */
static void sort_vertices(vertex_grid *g, size_t cells) {
    for (int32_t v = 0; v < g->vertices; v++) g->start[cell_index(g, g->vertex + 3 * (size_t)v) + 1]++;
    for (size_t i = 0; i < cells; i++) g->start[i + 1] += g->start[i];
    for (int32_t v = g->vertices - 1; v >= 0; v--) {
        const float *p = g->vertex + 3 * (size_t)v;
        /* from the back: start[i + 1] counts down to the start of cell i */
        int32_t slot = --g->start[cell_index(g, p) + 1];
        g->x[slot] = p[0], g->y[slot] = p[1], g->z[slot] = p[2];
        g->index[slot] = v;
    }
    /* start[i + 1] is the start of cell i now: shift */
    memmove(g->start, g->start + 1, cells * sizeof *g->start);
    g->start[cells] = g->vertices;
}

sherf_status vertex_grid_create(context *c, int64_t vertices, const float *vertex, float radius_m,
                                vertex_grid **out) {
    enum { PADDING = 16 };
    *out = NULL;
    if (vertices < 1 || vertices > 16 * BODY_VERTICES_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "vertex grid: %lld vertices, must be 1 to %d",
                       (long long)vertices, 16 * BODY_VERTICES_MAX);
    vertex_grid *g = mem_zero(c, 1, sizeof *g);
    if (!g) return SHERF_NO_MEMORY;
    sherf_status status = SHERF_NO_MEMORY;
    size_t n = (size_t)vertices;
    float max[3];
    g->vertices = (int32_t)vertices;
    for (size_t k = 0; k < 3; k++) g->min[k] = INFINITY, max[k] = -INFINITY;
    for (size_t i = 0; i < 3 * n; i++) {
        if (!(fabsf(vertex[i]) < 1e15f)) {
            status =
                failure(c, SHERF_BAD_ARGUMENT, "vertex grid: vertex %zu is not finite or far too far", i / 3);
            goto fail;
        }
        g->min[i % 3] = fminf(g->min[i % 3], vertex[i]);
        max[i % 3] = fmaxf(max[i % 3], vertex[i]);
    }
    choose_cells(g, max);
    size_t cells = (size_t)g->cells[0] * (size_t)g->cells[1] * (size_t)g->cells[2];
    g->x = mem_zero(c, n + PADDING, sizeof *g->x);
    g->y = mem_zero(c, n + PADDING, sizeof *g->y);
    g->z = mem_zero(c, n + PADDING, sizeof *g->z);
    g->index = mem_zero(c, n + PADDING, sizeof *g->index);
    g->vertex = mem_alloc(c, 3 * n, sizeof *g->vertex);
    g->start = mem_zero(c, cells + 1, sizeof *g->start);
    if (!g->x || !g->y || !g->z || !g->index || !g->vertex || !g->start) goto fail;
    memcpy(g->vertex, vertex, 3 * n * sizeof *vertex);
    sort_vertices(g, cells);
    g->limit_d2 = radius_m > 0 ? nextafterf(radius_m * radius_m, 0) : INFINITY; /* strictly closer */
    g->search = search_best();
    *out = g;
    return SHERF_OK;
fail:
    vertex_grid_free(g);
    return status;
}

void vertex_grid_free(vertex_grid *g) {
    if (!g) return;
    mem_free(g->shell.bit);
    mem_free(g->entry);
    for (int i = 0; i < g->slabs; i++) mem_free(g->slab[i]);
    mem_free(g->x);
    mem_free(g->y);
    mem_free(g->z);
    mem_free(g->index);
    mem_free(g->vertex);
    mem_free(g->start);
    mem_free(g);
}

int32_t vertex_grid_nearest_from(const vertex_grid *g, const float point[3], int32_t guess,
                                 float *distance_squared) {
    nearest_state best = {g->limit_d2, INFINITY, INT32_MAX};
    int32_t entry = LIST_NONE;
    if (g->entry) {
        const vertex_shell *s = &g->shell;
        int x = vertex_shell_cell(g, 0, point[0]), y = vertex_shell_cell(g, 1, point[1]),
            z = vertex_shell_cell(g, 2, point[2]);
        entry = g->entry[((int64_t)z * s->cells[1] + y) * s->cells[0] + x];
        if (entry == 0 && g->reach_m * g->reach_m < g->limit_d2) entry = LIST_NONE;
    }
    if (entry > LIST_NONE) {
        int32_t block = entry >> 6;
        g->list(g->slab[block / SLAB_BLOCKS] + block % SLAB_BLOCKS, entry & 63, point, &best);
    } else if (entry == LIST_NONE) {
        best.reach = sqrtf(g->limit_d2) * 1.00001f + g->slack_m;
        if (guess >= 0) {
            const float *v = g->vertex + 3 * (size_t)guess;
            float d2 = squared(v[0] - point[0], v[1] - point[1], v[2] - point[2]);
            if (d2 <= best.d2) improve(g, &best, d2, guess);
        }
        g->search(g, point, &best);
    }
    if (distance_squared) *distance_squared = best.d2;
    return best.index == INT32_MAX ? -1 : best.index;
}

int32_t vertex_grid_nearest(const vertex_grid *g, const float point[3], float *distance_squared) {
    return vertex_grid_nearest_from(g, point, -1, distance_squared);
}

typedef struct {
    const vertex_grid *g;
    const float *points;
    int32_t *nearest;
} many_job;

static void nearest_range(void *arg, int64_t begin, int64_t end, int thread) {
    const many_job *job = arg;
    int32_t guess = -1; /* neighbouring points tend to share their vertex */
    for (int64_t i = begin; i < end; i++) {
        int32_t found = vertex_grid_nearest_from(job->g, job->points + 3 * i, guess, NULL);
        if (found >= 0) guess = found;
        job->nearest[i] = found;
    }
}

void vertex_grid_nearest_many(const context *c, const vertex_grid *g, int64_t n, const float *points,
                              int32_t *nearest) {
    many_job job = {g, points, nearest};
    parallel_for(c, n, 1024, nearest_range, &job);
}
