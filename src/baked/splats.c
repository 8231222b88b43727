/* Splats: places by dart throwing (Poisson disks). A dart too near to an earlier one is rejected; after too
 * many rejections the minimum distance shrinks. */
#include <math.h>
#include <string.h>

#include "baked/splats.h"

/* ---- taken places, in a hash of cells ---- */
typedef struct {
    int32_t *head, *next; /* END: none */
    size_t mask;
    float cell_m;
} taken;
enum { END = -1 };

static size_t cell_hash(const taken *h, const int64_t cell[3]) {
    uint64_t key =
        (uint64_t)cell[0] * 73856093u ^ (uint64_t)cell[1] * 19349663u ^ (uint64_t)cell[2] * 83492791u;
    return (size_t)(splitmix64(key) & h->mask);
}

static void cell_of(const taken *h, const float p[3], int64_t cell[3]) {
    for (int k = 0; k < 3; k++) cell[k] = (int64_t)floorf(p[k] / h->cell_m);
}

/* Whether any place is nearer than radius (at most a cell's side). */
static bool near_taken(const taken *h, const splats *s, const float p[3], float radius) {
    int64_t own[3], cell[3];
    cell_of(h, p, own);
    for (int n = 0; n < 27; n++) {
        for (int k = 0, body = n; k < 3; k++, body /= 3) cell[k] = own[k] + body % 3 - 1;
        for (int32_t i = h->head[cell_hash(h, cell)]; i != END; i = h->next[i]) {
            float d2 = 0;
            for (int k = 0; k < 3; k++)
                d2 += (s->position[3 * i + k] - p[k]) * (s->position[3 * i + k] - p[k]);
            if (d2 < radius * radius) return true;
        }
    }
    return false;
}

static void take(taken *h, const splats *s, int32_t i) {
    int64_t cell[3];
    cell_of(h, s->position + 3 * (size_t)i, cell);
    size_t at = cell_hash(h, cell);
    h->next[i] = h->head[at];
    h->head[at] = i;
}

/* ---- darts ---- */
/* Cumulative areas: of the triangles up to and including t. */
static double areas_of(const surface *s, double *sum) {
    double all = 0;
    for (int64_t t = 0; t < s->triangles; t++) {
        double n[3];
        surface_cross(s, t, n);
        sum[t] = all += sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) / 2;
    }
    return all;
}

static int32_t triangle_at(const double *sum, int64_t n, double x) {
    int64_t low = 0, high = n - 1;
    while (low < high) {
        int64_t middle = (low + high) / 2;
        if (sum[middle] > x)
            high = middle;
        else
            low = middle + 1;
    }
    return (int32_t)low;
}

static void place(const surface *s, const float *of, const splats *p, int64_t i, float out[3]) {
    const uint32_t *t = s->triangle + 3 * (size_t)p->face[i];
    const float b1 = p->barycentric[2 * i], b2 = p->barycentric[2 * i + 1];
    for (size_t k = 0; k < 3; k++)
        out[k] = (1 - b1 - b2) * of[3 * (size_t)t[0] + k] + b1 * of[3 * (size_t)t[1] + k] +
                 b2 * of[3 * (size_t)t[2] + k];
}

static sherf_status throw_darts(context *c, const surface *s, int64_t count, const double *sum, taken *h,
                                splats *out) {
    const uint64_t key = random_key(0, "splats", 0);
    const double area = sum[s->triangles - 1];
    /* the densest even covering has a place each sqrt(3) / 2 d^2; darts reach some 70 % of it */
    float radius = h->cell_m;
    uint64_t dart = 0;
    int64_t missed = 0;
    while (out->count < count) {
        const int64_t i = out->count;
        double u = random_uniform(key, 3 * dart + 1), v = random_uniform(key, 3 * dart + 2);
        if (u + v > 1) u = 1 - u, v = 1 - v;
        out->face[i] = triangle_at(sum, s->triangles, area * random_uniform(key, 3 * dart));
        out->barycentric[2 * i] = (float)u;
        out->barycentric[2 * i + 1] = (float)v;
        dart++;
        place(s, s->position, out, i, out->position + 3 * i);
        if (near_taken(h, out, out->position + 3 * i, radius)) {
            if (++missed > 2 * count) radius *= 0.85f, missed = 0;
            if (dart % 65536 == 0 && cancelled(c)) return failure(c, SHERF_CANCELLED, "cancelled");
            continue;
        }
        take(h, out, (int32_t)i);
        out->count++;
    }
    return SHERF_OK;
}

sherf_status splats_make(context *c, const surface *s, int64_t count, splats *out) {
    *out = (splats){.opacity = 0.95f};
    if (count < 1 || count > SPLATS_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "%lld splats: must be 1 to %d", (long long)count, SPLATS_MAX);
    const size_t n = (size_t)count;
    taken h = {.mask = 1};
    while (h.mask < n) h.mask = 2 * h.mask + 1;
    double *sum = mem_alloc(c, (size_t)s->triangles, sizeof *sum);
    h.head = mem_alloc(c, h.mask + 1, sizeof *h.head);
    h.next = mem_alloc(c, n, sizeof *h.next);
    out->face = mem_alloc(c, n, sizeof *out->face);
    out->barycentric = mem_alloc(c, n, 2 * sizeof(float));
    out->position = mem_alloc(c, n, 3 * sizeof(float));
    out->normal = mem_alloc(c, n, 3 * sizeof(float));
    out->rgb = mem_zero(c, n, 3 * sizeof(float));
    bool good =
        sum && h.head && h.next && out->face && out->barycentric && out->position && out->normal && out->rgb;
    sherf_status status = good ? SHERF_OK : SHERF_NO_MEMORY;
    if (good) {
        memset(h.head, 0xff, (h.mask + 1) * sizeof *h.head);
        const double area = areas_of(s, sum), spacing = sqrt(area / (double)count);
        h.cell_m = (float)(0.75 * spacing);
        out->across_m = (float)(0.6 * spacing);
        out->along_m = 0.15f * out->across_m;
        if (!(h.cell_m > 0))
            status = failure(c, SHERF_BAD_ARGUMENT, "export: the surface has no area");
        else
            status = throw_darts(c, s, count, sum, &h, out);
    }
    mem_free(sum);
    mem_free(h.head);
    mem_free(h.next);
    if (status != SHERF_OK) splats_free(out);
    return status;
}

void splats_place(const surface *s, const float *position, const float *normal, splats *p) {
    for (int64_t i = 0; i < p->count; i++) {
        float *n = p->normal + 3 * i;
        place(s, position, p, i, p->position + 3 * i);
        place(s, normal, p, i, n);
        float length = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        for (int k = 0; k < 3; k++) n[k] = length > 1e-6f ? n[k] / length : k == 1;
    }
}

void splats_free(splats *s) {
    mem_free(s->face);
    mem_free(s->barycentric);
    mem_free(s->position);
    mem_free(s->normal);
    mem_free(s->rgb);
    *s = (splats){0};
}

/* Half-way between z and n is the axis of a half turn; the shorter turn is w = 1 + z.n, xyz = z x n. */
void splat_rotation(const float n[3], float out[4]) {
    double w = 1 + (double)n[2], x = -n[1], y = n[0];
    if (w < 1e-6) w = 0, x = 1, y = 0; /* n is -z: half a turn about x */
    double length = sqrt(w * w + x * x + y * y);
    out[0] = (float)(w / length);
    out[1] = (float)(x / length);
    out[2] = (float)(y / length);
    out[3] = 0;
}
