/* Deformation: a point moves by its nearest vertex's affine map, made with the pose (pose.c), or by a blend
 * of that map with the vertex's neighbours' maps. */
#include <string.h>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "body/deform_point.h"

#define INLINE static inline __attribute__((always_inline))
#define AVX2 __attribute__((target("avx2")))

typedef void blend_function(const vertex_mapping *g, size_t v, const float x[3], float map[12]);

INLINE void apply_any(const vertex_mapping *g, int64_t n, const float *points, const float *directions,
                      const int32_t *nearest, float *points_out, float *directions_out,
                      blend_function *blend) {
    for (int64_t i = 0; i < n; i++) {
        const int64_t v = nearest ? nearest[i] < 0 ? 0 : nearest[i] : i;
        const float *map = g->maps + 12 * v;
        float x[3], y[3], blended[12];
        memcpy(x, points + 3 * i, sizeof x);
        if (nearest && g->blend_m != 0) {
            blend(g, (size_t)v, x, blended);
            map = blended;
        }
        map_rotate(map, x, y);
        for (int k = 0; k < 3; k++) points_out[3 * i + k] = y[k] + map[4 * k + 3];
        if (!directions) continue;
        memcpy(x, directions + 3 * i, sizeof x);
        map_rotate(map, x, directions_out + 3 * i);
    }
}

static void apply_plain(const vertex_mapping *g, int64_t n, const float *points, const float *directions,
                        const int32_t *nearest, float *points_out, float *directions_out) {
    apply_any(g, n, points, directions, nearest, points_out, directions_out, map_blend);
}

#if defined(__x86_64__)
/* The weights of up to eight of v's neighbours, from number `first` on, before any is left out. */
AVX2 INLINE void weights_avx2(const vertex_mapping *g, const float x[3], float d0, int32_t first, int count,
                              float weight[8]) {
    const __m256i lane = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    const __m256i in = _mm256_cmpgt_epi32(_mm256_set1_epi32(count), lane);
    const __m256i index = _mm256_maskload_epi32(g->neighbour + first, in);
    const __m256i at = _mm256_add_epi32(_mm256_add_epi32(index, index), index);
    const __m256 zero = _mm256_setzero_ps(), one = _mm256_set1_ps(1);
    __m256 d = zero;
    for (int k = 0; k < 3; k++) {
        const __m256 other = _mm256_mask_i32gather_ps(zero, g->vertex + k, at, _mm256_castsi256_ps(in), 4);
        const __m256 by = _mm256_sub_ps(_mm256_set1_ps(x[k]), other);
        d = _mm256_add_ps(d, _mm256_mul_ps(by, by));
    }
    const __m256 reach = _mm256_set1_ps(1 / (g->blend_m * g->blend_m));
    __m256 w = _mm256_sub_ps(one, _mm256_mul_ps(_mm256_sub_ps(d, _mm256_set1_ps(d0)), reach));
    w = _mm256_min_ps(_mm256_max_ps(w, zero), one); /* 0 where w is NaN */
    _mm256_storeu_ps(weight, _mm256_mul_ps(w, w));
}

/* As map_blend, the same bits. */
AVX2 INLINE void blend_avx2(const vertex_mapping *g, size_t v, const float x[3], float map[12]) {
    const float *own = g->vertex + 3 * v;
    const int32_t end = g->neighbour_first[v + 1];
    float d0 = 0, sum = 1, weight[8];
    for (int k = 0; k < 3; k++) d0 += (x[k] - own[k]) * (x[k] - own[k]);
    __m256 low = _mm256_loadu_ps(g->maps + 12 * v);
    __m128 high = _mm_loadu_ps(g->maps + 12 * v + 8);
    for (int32_t first = g->neighbour_first[v]; first < end; first += 8) {
        const int count = end - first < 8 ? end - first : 8;
        weights_avx2(g, x, d0, first, count, weight);
        for (int i = 0; i < count && g->apart; i++)
            if (weight[i] > 0 && map_is_apart(g, v, first + i, x, d0)) weight[i] = 0;
        for (int i = 0; i < count; i++) {
            const float *by = g->maps + 12 * (size_t)g->neighbour[first + i];
            if (!(weight[i] > 0)) continue;
            sum += weight[i];
            low = _mm256_add_ps(low, _mm256_mul_ps(_mm256_set1_ps(weight[i]), _mm256_loadu_ps(by)));
            high = _mm_add_ps(high, _mm_mul_ps(_mm_set1_ps(weight[i]), _mm_loadu_ps(by + 8)));
        }
    }
    _mm256_storeu_ps(map, _mm256_div_ps(low, _mm256_set1_ps(sum)));
    _mm_storeu_ps(map + 8, _mm_div_ps(high, _mm_set1_ps(sum)));
}

AVX2 static void apply_avx2(const vertex_mapping *g, int64_t n, const float *points, const float *directions,
                            const int32_t *nearest, float *points_out, float *directions_out) {
    apply_any(g, n, points, directions, nearest, points_out, directions_out, blend_avx2);
}
#endif

static void apply(isa_level isa, const vertex_mapping *g, int64_t n, const float *points,
                  const float *directions, const int32_t *nearest, float *points_out, float *directions_out) {
#if defined(__x86_64__)
    if (isa >= ISA_AVX2) {
        apply_avx2(g, n, points, directions, nearest, points_out, directions_out);
        return;
    }
#endif
    apply_plain(g, n, points, directions, nearest, points_out, directions_out);
}

void deform_to_canonical(const body_model *body, const posed_body *p, int64_t n, const float *points_smpl,
                         const float *directions_smpl, const int32_t *nearest, float *points_canonical,
                         float *directions_canonical) {
    const vertex_mapping g = {p->vertices_smpl, p->to_canonical, p->blend_m, body->neighbour_first,
                              body->neighbour,  false,           NULL};
    apply(p->isa, &g, n, points_smpl, directions_smpl, nearest, points_canonical, directions_canonical);
}

static void from_canonical(const body_model *body, const posed_body *p, bool reads, int64_t n,
                           const float *points_canonical, const int32_t *nearest, float *points_world) {
    const vertex_mapping g = {body->canonical->vertices_smpl,
                              reads ? p->read_from : p->from_canonical,
                              p->blend_m,
                              body->neighbour_first,
                              body->neighbour,
                              reads,
                              p->together};
    apply(p->isa, &g, n, points_canonical, NULL, nearest, points_world, NULL);
}

void deform_from_canonical(const body_model *body, const posed_body *p, int64_t n,
                           const float *points_canonical, const int32_t *nearest, float *points_world) {
    from_canonical(body, p, false, n, points_canonical, nearest, points_world);
}

void deform_to_picture(const body_model *body, const posed_body *p, int64_t n, const float *points_canonical,
                       const int32_t *nearest, float *points_world) {
    from_canonical(body, p, p->read_from != NULL, n, points_canonical, nearest, points_world);
}
