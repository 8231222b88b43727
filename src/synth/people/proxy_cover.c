/* Finds which surfaces cover others: samples surfaces as points with normals a few millimetres apart, and
 * looks up nearest points. */
#include <math.h>
#include <string.h>

#include "body/body.h"
#include "synth/people/proxy.h"

static const float spacing_m = 0.007f;
enum { POINTS_MAX = 1 << 21, STEPS_MAX = 48 };

typedef struct {
    int64_t points;
    float *point, *normal; /* points x 3; unit normals */
    vertex_grid *grid;
} cloud;

static void cloud_free(cloud *k) {
    mem_free(k->point);
    mem_free(k->normal);
    vertex_grid_free(k->grid);
}

static float normalise(float v[3]) {
    float length = sqrtf(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (int k = 0; k < 3; k++) v[k] = length > 1e-12f ? v[k] / length : 0;
    return length;
}

static void face_cross(const proxy_surface *s, int t, float n[3]) {
    const float *a = s->vertex + 3 * s->triangle[3 * t], *b = s->vertex + 3 * s->triangle[3 * t + 1],
                *d = s->vertex + 3 * s->triangle[3 * t + 2];
    for (int k = 0; k < 3; k++) {
        int p = (k + 1) % 3, q = (k + 2) % 3;
        n[k] = (b[p] - a[p]) * (d[q] - a[q]) - (b[q] - a[q]) * (d[p] - a[p]);
    }
}

/* Area-weighted unit normals; V x 3. */
static void surface_normals(const proxy_surface *s, float *normal) {
    memset(normal, 0, (size_t)s->vertices * 3 * sizeof *normal);
    for (int t = 0; t < s->triangles; t++) {
        float n[3];
        face_cross(s, t, n);
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++) normal[3 * s->triangle[3 * t + i] + k] += n[k];
    }
    for (int v = 0; v < s->vertices; v++) normalise(normal + 3 * v);
}

/* The number of parts into which a triangle's longest edge is cut. */
static int triangle_steps(const proxy_surface *s, int t) {
    float longest = 0;
    for (int i = 0; i < 3; i++) {
        const float *a = s->vertex + 3 * s->triangle[3 * t + i],
                    *b = s->vertex + 3 * s->triangle[3 * t + (i + 1) % 3];
        float d[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]};
        longest = fmaxf(longest, normalise(d));
    }
    float steps = ceilf(longest / spacing_m);
    return steps < 1 || !isfinite(steps) ? 1 : steps > STEPS_MAX ? STEPS_MAX : (int)steps;
}

static sherf_status cloud_create(context *c, const proxy_surface *s, float radius_m, cloud *out) {
    memset(out, 0, sizeof *out);
    int64_t points = 0, at = 0;
    for (int t = 0; t < s->triangles; t++) {
        int64_t n = triangle_steps(s, t);
        points += (n + 1) * (n + 2) / 2;
    }
    if (points > POINTS_MAX)
        return failure(c, SHERF_UNSUPPORTED, "a surface of %d triangles is too large", s->triangles);
    float *normal = mem_alloc(c, (size_t)s->vertices, 3 * sizeof *normal);
    out->point = mem_alloc(c, (size_t)points, 3 * sizeof *out->point);
    out->normal = mem_alloc(c, (size_t)points, 3 * sizeof *out->normal);
    sherf_status status = SHERF_NO_MEMORY;
    if (!normal || !out->point || !out->normal) goto done;
    surface_normals(s, normal);
    for (int t = 0; t < s->triangles; t++) {
        int n = triangle_steps(s, t);
        for (int i = 0; i <= n; i++)
            for (int k = 0; i + k <= n; k++, at++) {
                float w[3] = {(float)i / (float)n, (float)k / (float)n, (float)(n - i - k) / (float)n};
                for (int x = 0; x < 3; x++) {
                    float p = 0, m = 0;
                    for (int v = 0; v < 3; v++) {
                        p += w[v] * s->vertex[3 * s->triangle[3 * t + v] + x];
                        m += w[v] * normal[3 * s->triangle[3 * t + v] + x];
                    }
                    out->point[3 * at + x] = p, out->normal[3 * at + x] = m;
                }
                normalise(out->normal + 3 * at);
            }
    }
    out->points = points;
    status = vertex_grid_create(c, points, out->point, radius_m, &out->grid);
done:
    mem_free(normal);
    if (status) cloud_free(out), memset(out, 0, sizeof *out);
    return status;
}

/* Vertices next to an uncovered one become uncovered. */
static void erode(const proxy_surface *s, uint8_t *covered, uint8_t *next) {
    memcpy(next, covered, (size_t)s->vertices);
    for (int t = 0; t < s->triangles; t++) {
        const uint32_t *v = s->triangle + 3 * t;
        if (covered[v[0]] && covered[v[1]] && covered[v[2]]) continue;
        for (int i = 0; i < 3; i++) next[v[i]] = 0;
    }
    memcpy(covered, next, (size_t)s->vertices);
}

sherf_status proxy_cover(context *c, const proxy_surface *below, const proxy_surface *above, float reach_m,
                         int rings, uint8_t *hidden) {
    cloud cover = {0};
    size_t V = (size_t)below->vertices;
    float *normal = mem_alloc(c, V, 3 * sizeof *normal);
    uint8_t *covered = mem_zero(c, V, 1), *next = mem_alloc(c, V, 1);
    sherf_status status = SHERF_NO_MEMORY;
    if (!normal || !covered || !next || (status = cloud_create(c, above, reach_m, &cover))) goto done;
    surface_normals(below, normal);
    for (size_t v = 0; v < V; v++) {
        const float *p = below->vertex + 3 * v, *n = normal + 3 * v;
        float squared;
        int32_t near = vertex_grid_nearest(cover.grid, p, &squared);
        if (near < 0) continue;
        float height = 0, aside = 0;
        for (int k = 0; k < 3; k++) height += (cover.point[3 * near + k] - p[k]) * n[k];
        aside = sqrtf(fmaxf(squared - height * height, 0));
        covered[v] = height > -0.005f && aside < fmaxf(spacing_m, 0.5f * height);
    }
    for (int i = 0; i < rings; i++) erode(below, covered, next);
    for (size_t v = 0; v < V; v++) hidden[v] |= covered[v];
done:
    cloud_free(&cover);
    mem_free(normal);
    mem_free(covered);
    mem_free(next);
    return status;
}

/* Spreads shifts to the neighbours, so that a pushed patch has no step at its border. */
static void spread(const proxy_surface *s, float *shift, float *sum, float *count) {
    memset(sum, 0, (size_t)s->vertices * 3 * sizeof *sum);
    memset(count, 0, (size_t)s->vertices * sizeof *count);
    for (int t = 0; t < s->triangles; t++)
        for (int i = 0; i < 3; i++) {
            uint32_t a = s->triangle[3 * t + i], b = s->triangle[3 * t + (i + 1) % 3];
            for (int k = 0; k < 3; k++)
                sum[3 * a + k] += shift[3 * b + k], sum[3 * b + k] += shift[3 * a + k];
            count[a]++, count[b]++;
        }
    for (int v = 0; v < s->vertices; v++) {
        float own = 0, mean = 0;
        for (int k = 0; k < 3; k++) {
            own += shift[3 * v + k] * shift[3 * v + k];
            sum[3 * v + k] /= count[v] > 0 ? count[v] : 1;
            mean += sum[3 * v + k] * sum[3 * v + k];
        }
        if (mean > own) memcpy(shift + 3 * v, sum + 3 * v, 3 * sizeof *shift);
    }
}

sherf_status proxy_push(context *c, const proxy_surface *below, const proxy_surface *above, float gap_m,
                        float *vertex_above) {
    cloud under = {0};
    size_t V = (size_t)above->vertices;
    float *shift = mem_zero(c, V, 3 * sizeof *shift), *sum = mem_alloc(c, V, 3 * sizeof *sum),
          *count = mem_alloc(c, V, sizeof *count);
    sherf_status status = SHERF_NO_MEMORY;
    if (!shift || !sum || !count || (status = cloud_create(c, below, 0.03f, &under))) goto done;
    for (size_t v = 0; v < V; v++) {
        const float *p = above->vertex + 3 * v;
        float squared, depth = 0;
        int32_t near = vertex_grid_nearest(under.grid, p, &squared);
        if (near < 0) continue;
        for (int k = 0; k < 3; k++) depth += (p[k] - under.point[3 * near + k]) * under.normal[3 * near + k];
        for (int k = 0; k < 3 && depth < gap_m; k++)
            shift[3 * v + k] = (gap_m - depth) * under.normal[3 * near + k];
    }
    for (int i = 0; i < 2; i++) spread(above, shift, sum, count);
    for (size_t i = 0; i < V * 3; i++) vertex_above[i] = above->vertex[i] + shift[i];
done:
    cloud_free(&under);
    mem_free(shift);
    mem_free(sum);
    mem_free(count);
    return status;
}
