/* Makes the atlas. Charts grow from triangle to triangle as long as the triangles face the chart's direction.
 * They are projected along it and give up triangles that would overlap; then they are packed on shelves, at
 * the largest scale that fits. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "baked/atlas.h"

enum { NOBODY = -1, GUTTER_PX = 3, TURNS = 12 };
static const double grow_cosine = 0.6, flat_cosine = 0.25;
/* The largest extent of a chart from its seed, in square roots of the surface's area: large charts pack
 * badly. */
static const double chart_reach = 0.3;

typedef struct {
    double axis[3], u[3], v[3]; /* the direction it faces, and the axes of its plane */
    double min[2], max[2];      /* of its corners, metres in the plane */
    int32_t first, count;       /* in `order` */
    int x, y, width, height;    /* in the picture, with gutter */
} chart;

typedef struct {
    const surface *s;
    int32_t *neighbour; /* T x 3, across the edge from corner k to k + 1 */
    float *facing;      /* T x 3: mean of the corners' normals */
    float *flat;        /* T x 3: the triangle's own normal */
    int32_t *owner;     /* T: chart */
    int32_t *order;     /* T: triangles by chart */
    chart *chart;
    int32_t charts, chart_room, placed; /* placed: triangles in order */
    double reach_m;
} cutter;

static double dot(const double a[3], const float b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* ---- neighbours ---- */
typedef struct {
    uint64_t key; /* smaller vertex, larger vertex */
    int32_t side; /* 3 triangle + corner */
} edge_side;

static int compare_sides(const void *a, const void *b) {
    const edge_side *x = a, *y = b;
    if (x->key != y->key) return x->key < y->key ? -1 : 1;
    return (x->side > y->side) - (x->side < y->side);
}

static sherf_status find_neighbours(context *c, const surface *s, int32_t *neighbour) {
    const size_t n = 3 * (size_t)s->triangles;
    edge_side *side = mem_alloc(c, n, sizeof *side);
    if (!side) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) {
        uint32_t a = s->triangle[i], b = s->triangle[i / 3 * 3 + (i + 1) % 3];
        side[i].key = a < b ? (uint64_t)a << 32 | b : (uint64_t)b << 32 | a;
        side[i].side = (int32_t)i;
        neighbour[i] = NOBODY;
    }
    qsort(side, n, sizeof *side, compare_sides);
    for (size_t i = 0; i + 1 < n; i++)
        if (side[i].key == side[i + 1].key) {
            neighbour[side[i].side] = side[i + 1].side / 3;
            neighbour[side[i + 1].side] = side[i].side / 3;
        }
    mem_free(side);
    return SHERF_OK;
}

static void find_normals(const surface *s, float *facing, float *flat) {
    for (int64_t t = 0; t < s->triangles; t++) {
        double sum[3] = {0}, n[3], long_sum = 0, long_flat = 0;
        surface_cross(s, t, n);
        for (int k = 0; k < 3; k++) {
            for (int i = 0; i < 3; i++) sum[k] += s->normal[3 * (size_t)s->triangle[3 * t + i] + (size_t)k];
            long_flat += n[k] * n[k];
            long_sum += sum[k] * sum[k];
        }
        for (int k = 0; k < 3; k++) {
            facing[3 * t + k] = (float)(long_sum > 0 ? sum[k] / sqrt(long_sum) : k == 1);
            /* a triangle without area takes its corners' direction */
            flat[3 * t + k] = long_flat > 0 ? (float)(n[k] / sqrt(long_flat)) : facing[3 * t + k];
        }
    }
}

/* ---- growing ---- */
static void set_axis(chart *k, const double axis[3]) {
    double length = sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]);
    int min = 0;
    for (int i = 0; i < 3; i++) k->axis[i] = length > 0 ? axis[i] / length : i == 1;
    for (int i = 1; i < 3; i++)
        if (fabs(k->axis[i]) < fabs(k->axis[min])) min = i;
    double along[3] = {min == 0, min == 1, min == 2};
    const double *a = k->axis;
    double u[3] = {along[1] * a[2] - along[2] * a[1], along[2] * a[0] - along[0] * a[2],
                   along[0] * a[1] - along[1] * a[0]};
    length = sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2]);
    for (int i = 0; i < 3; i++) k->u[i] = u[i] / length;
    for (int i = 0; i < 3; i++) { /* seen from outside: u to the right, v down */
        int p = (i + 1) % 3, q = (i + 2) % 3;
        k->v[i] = -(a[p] * k->u[q] - a[q] * k->u[p]);
    }
}

static bool within_reach(const cutter *w, int32_t seed, int32_t t) {
    const float *a = w->s->position + 3 * (size_t)w->s->triangle[3 * (size_t)seed],
                *b = w->s->position + 3 * (size_t)w->s->triangle[3 * (size_t)t];
    double d2 = 0;
    for (int k = 0; k < 3; k++) d2 += ((double)a[k] - b[k]) * ((double)a[k] - b[k]);
    return d2 <= w->reach_m * w->reach_m;
}

/* Marks the triangles that can be reached from `seed` and face the axis with the chart's number. */
static int32_t grow(cutter *w, int32_t seed, const chart *k, int32_t number, int32_t *queue) {
    int32_t count = 0;
    queue[count++] = seed;
    w->owner[seed] = number;
    for (int32_t i = 0; i < count; i++)
        for (int e = 0; e < 3; e++) {
            int32_t t = w->neighbour[3 * (size_t)queue[i] + (size_t)e];
            if (t < 0 || w->owner[t] != NOBODY || !within_reach(w, seed, t)) continue;
            if (dot(k->axis, w->facing + 3 * (size_t)t) < grow_cosine ||
                dot(k->axis, w->flat + 3 * (size_t)t) < flat_cosine)
                continue;
            w->owner[t] = number;
            queue[count++] = t;
        }
    return count;
}

/* Grows along the seed's direction, then again along the mean direction of the triangles reached. */
static int32_t grow_chart(cutter *w, int32_t seed, chart *k, int32_t number) {
    enum { ROUNDS = 3 };
    int32_t *queue = w->order + w->placed, count = 0;
    double axis[3];
    for (int i = 0; i < 3; i++) axis[i] = w->facing[3 * (size_t)seed + (size_t)i];
    for (int round = 0; round < ROUNDS; round++) {
        set_axis(k, axis);
        if (round && dot(k->axis, w->flat + 3 * (size_t)seed) < flat_cosine) break; /* the seed must stay */
        for (int32_t i = 0; i < count; i++) w->owner[queue[i]] = NOBODY;
        count = grow(w, seed, k, number, queue);
        for (int i = 0; i < 3; i++) axis[i] = 0;
        for (int32_t i = 0; i < count; i++)
            for (int d = 0; d < 3; d++) axis[d] += w->facing[3 * (size_t)queue[i] + (size_t)d];
    }
    return count; /* round 0 takes the seed at least */
}

static void flatten(const chart *k, const float p[3], double out[2]) {
    out[0] = dot(k->u, p);
    out[1] = dot(k->v, p);
}

/* ---- overlaps ---- */
/* Calls `f` for the grid points (i, j) inside a triangle, edges included. */
typedef bool texel_function(void *user, int i, int j, const double bary[3]);
static bool cover(const double p[3][2], texel_function *f, void *user) {
    double low[2], high[2],
        area = (p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) - (p[1][1] - p[0][1]) * (p[2][0] - p[0][0]);
    if (!(fabs(area) > 1e-12)) return true;
    for (int k = 0; k < 2; k++) {
        low[k] = fmin(p[0][k], fmin(p[1][k], p[2][k]));
        high[k] = fmax(p[0][k], fmax(p[1][k], p[2][k]));
    }
    for (int j = (int)ceil(low[1]); j <= (int)floor(high[1]); j++)
        for (int i = (int)ceil(low[0]); i <= (int)floor(high[0]); i++) {
            double b[3];
            b[1] = ((i - p[0][0]) * (p[2][1] - p[0][1]) - (j - p[0][1]) * (p[2][0] - p[0][0])) / area;
            b[2] = ((p[1][0] - p[0][0]) * (j - p[0][1]) - (p[1][1] - p[0][1]) * (i - p[0][0])) / area;
            b[0] = 1 - b[1] - b[2];
            if (b[0] >= 0 && b[1] >= 0 && b[2] >= 0 && !f(user, i, j, b)) return false;
        }
    return true;
}

typedef struct {
    const cutter *w;
    int32_t *taken; /* width x height: triangle, or NOBODY */
    int width;
    int32_t self;
} overlap_job;

static bool free_here(void *user, int i, int j, const double bary[3]) {
    const overlap_job *o = user;
    return o->taken[(size_t)j * (size_t)o->width + (size_t)i] == NOBODY;
}

static bool take(void *user, int i, int j, const double bary[3]) {
    overlap_job *o = user;
    if (bary[0] > 1e-6 && bary[1] > 1e-6 && bary[2] > 1e-6) /* points on edges belong to several triangles */
        o->taken[(size_t)j * (size_t)o->width + (size_t)i] = o->self;
    return true;
}

static bool strictly_free(void *user, int i, int j, const double bary[3]) {
    return !(bary[0] > 1e-6 && bary[1] > 1e-6 && bary[2] > 1e-6) || free_here(user, i, j, bary);
}

/* Goes through the triangles in the order in which they were reached; those that would overlap earlier ones
 * leave the chart. */
static sherf_status drop_overlaps(context *c, cutter *w, chart *k, double cell_m) {
    const surface *s = w->s;
    int32_t *queue = w->order + w->placed, kept = 0;
    cell_m = fmax(cell_m, fmax(k->max[0] - k->min[0], k->max[1] - k->min[1]) / 4096);
    cell_m = cell_m > 0 ? cell_m : 1;
    const int width = (int)((k->max[0] - k->min[0]) / cell_m) + 3,
              height = (int)((k->max[1] - k->min[1]) / cell_m) + 3;
    overlap_job o = {w, mem_alloc(c, (size_t)width * (size_t)height, sizeof(int32_t)), width, 0};
    if (!o.taken) return SHERF_NO_MEMORY;
    memset(o.taken, 0xff, (size_t)width * (size_t)height * sizeof *o.taken);
    for (int32_t i = 0; i < k->count; i++) {
        double p[3][2];
        for (int q = 0; q < 3; q++) {
            flatten(k, s->position + 3 * (size_t)s->triangle[3 * (size_t)queue[i] + (size_t)q], p[q]);
            for (int d = 0; d < 2; d++) p[q][d] = (p[q][d] - k->min[d]) / cell_m + 1;
        }
        o.self = queue[i];
        if (i && !cover(p, strictly_free, &o)) {
            w->owner[queue[i]] = NOBODY;
            continue;
        }
        cover(p, take, &o);
        queue[kept++] = queue[i];
    }
    k->count = kept;
    mem_free(o.taken);
    return SHERF_OK;
}

static void measure(const cutter *w, chart *k, const int32_t *triangle) {
    for (int d = 0; d < 2; d++) k->min[d] = INFINITY, k->max[d] = -INFINITY;
    for (int32_t i = 0; i < k->count; i++)
        for (int q = 0; q < 3; q++) {
            double p[2];
            flatten(k, w->s->position + 3 * (size_t)w->s->triangle[3 * (size_t)triangle[i] + (size_t)q], p);
            for (int d = 0; d < 2; d++) k->min[d] = fmin(k->min[d], p[d]), k->max[d] = fmax(k->max[d], p[d]);
        }
}

/* Turns the chart in its plane so that its box is smallest, with the longer side horizontal. */
static void turn_chart(const cutter *w, chart *k, const int32_t *triangle) {
    chart best = *k, tried = *k;
    double min = INFINITY;
    for (int i = 0; i < 2 * TURNS; i++) {
        double angle = M_PI / 2 * i / TURNS, co = cos(angle), si = sin(angle);
        for (int d = 0; d < 3; d++) {
            tried.u[d] = co * k->u[d] + si * k->v[d];
            tried.v[d] = co * k->v[d] - si * k->u[d];
        }
        measure(w, &tried, triangle);
        double x = tried.max[0] - tried.min[0], y = tried.max[1] - tried.min[1];
        if (x >= y && x * y < min) min = x * y, best = tried;
    }
    *k = best;
    measure(w, k, triangle);
}

static sherf_status cut(context *c, cutter *w, double cell_m) {
    const int32_t T = (int32_t)w->s->triangles;
    sherf_status status = SHERF_OK;
    for (int32_t t = 0; t < T; t++) w->owner[t] = NOBODY;
    for (int32_t seed = 0; seed < T && status == SHERF_OK; seed++) {
        while (w->owner[seed] == NOBODY && status == SHERF_OK) {
            if (w->charts == w->chart_room) {
                size_t room = w->chart_room ? 2 * (size_t)w->chart_room : 256;
                chart *grown = mem_grow(c, w->chart, (size_t)w->chart_room, room, sizeof *grown);
                if (!grown) return SHERF_NO_MEMORY;
                w->chart = grown;
                w->chart_room = (int32_t)room;
            }
            chart *k = &w->chart[w->charts];
            *k = (chart){.first = w->placed};
            k->count = grow_chart(w, seed, k, w->charts);
            measure(w, k, w->order + w->placed);
            status = drop_overlaps(c, w, k, cell_m);
            turn_chart(w, k, w->order + w->placed);
            w->placed += k->count;
            w->charts++;
        }
    }
    return status;
}

/* ---- packing ---- */
static int compare_heights(const void *a, const void *b) {
    const chart *x = *(chart *const *)a, *y = *(chart *const *)b;
    if (x->height != y->height) return x->height < y->height ? 1 : -1;
    return (x > y) - (x < y);
}

/* Packs on shelves, tallest first; false: the side is too short. */
static bool pack(chart **by_height, int32_t charts, double texels_per_m, int side) {
    int x = 0, y = 0, shelf = 0;
    for (int32_t i = 0; i < charts; i++) {
        chart *k = by_height[i];
        double across = (k->max[0] - k->min[0]) * texels_per_m, down = (k->max[1] - k->min[1]) * texels_per_m;
        if (!(across < side && down < side)) return false;
        k->width = (int)ceil(across) + 1 + 2 * GUTTER_PX;
        k->height = (int)ceil(down) + 1 + 2 * GUTTER_PX;
    }
    qsort(by_height, (size_t)charts, sizeof *by_height, compare_heights);
    for (int32_t i = 0; i < charts; i++) {
        chart *k = by_height[i];
        if (x + k->width > side) x = 0, y += shelf, shelf = 0;
        if (k->width > side || y + k->height > side) return false;
        k->x = x;
        k->y = y;
        x += k->width;
        shelf = k->height > shelf ? k->height : shelf;
    }
    return true;
}

/* The largest scale that fits, to 1 %. */
static sherf_status pack_best(context *c, cutter *w, int side, double *texels_per_m) {
    chart **by_height = mem_alloc(c, (size_t)w->charts, sizeof *by_height);
    if (!by_height) return SHERF_NO_MEMORY;
    for (int32_t i = 0; i < w->charts; i++) by_height[i] = &w->chart[i];
    double low = 0, high = 1e5;
    if (!pack(by_height, w->charts, low, side)) {
        mem_free(by_height);
        return failure(
            c, SHERF_BAD_ARGUMENT,
            "texture of %d texels: too small for the surface's %d pieces; give a larger one or fewer "
            "triangles",
            side, w->charts);
    }
    for (int i = 0; i < 60 && high - low > 0.01 * low; i++) {
        double middle = (low + high) / 2;
        if (pack(by_height, w->charts, middle, side))
            low = middle;
        else
            high = middle;
    }
    pack(by_height, w->charts, low, side);
    *texels_per_m = low;
    mem_free(by_height);
    return SHERF_OK;
}

/* ---- corners and texels ---- */
static sherf_status lay_out(context *c, const cutter *w, double texels_per_m, atlas *a) {
    const surface *s = w->s;
    const size_t T = (size_t)s->triangles;
    int32_t *corner_of = mem_alloc(c, (size_t)s->vertices, sizeof *corner_of),
            *chart_of = mem_alloc(c, (size_t)s->vertices, sizeof *chart_of);
    a->vertex = mem_alloc(c, 3 * T, sizeof *a->vertex);
    a->uv = mem_alloc(c, 3 * T, 2 * sizeof *a->uv);
    a->triangle = mem_alloc(c, 3 * T, sizeof *a->triangle);
    sherf_status status =
        corner_of && chart_of && a->vertex && a->uv && a->triangle ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) memset(chart_of, 0xff, (size_t)s->vertices * sizeof *chart_of);
    for (int32_t n = 0; n < w->charts && status == SHERF_OK; n++) {
        const chart *k = &w->chart[n];
        for (int32_t i = 0; i < 3 * k->count; i++) {
            const size_t at = 3 * (size_t)w->order[k->first + i / 3] + (size_t)(i % 3);
            const uint32_t v = s->triangle[at];
            if (chart_of[v] != n) {
                double p[2];
                chart_of[v] = n;
                corner_of[v] = (int32_t)a->corners;
                a->vertex[a->corners] = v;
                flatten(k, s->position + 3 * (size_t)v, p);
                a->uv[2 * a->corners] = (float)((p[0] - k->min[0]) * texels_per_m + k->x + GUTTER_PX);
                a->uv[2 * a->corners + 1] = (float)((p[1] - k->min[1]) * texels_per_m + k->y + GUTTER_PX);
                a->corners++;
            }
            a->triangle[at] = (uint32_t)corner_of[v];
        }
    }
    a->charts = w->charts;
    mem_free(corner_of);
    mem_free(chart_of);
    return status;
}

typedef struct {
    int side;
    int32_t *face; /* side x side, NOBODY */
    float *barycentric;
    int32_t self;
} texel_job;

static bool set_texel(void *user, int i, int j, const double bary[3]) {
    texel_job *o = user;
    if (i < 0 || j < 0 || i >= o->side || j >= o->side) return true;
    size_t at = (size_t)j * (size_t)o->side + (size_t)i;
    o->face[at] = o->self;
    o->barycentric[2 * at] = (float)bary[1];
    o->barycentric[2 * at + 1] = (float)bary[2];
    return true;
}

static sherf_status find_texels(context *c, const surface *s, atlas *a) {
    const size_t count = (size_t)a->side_px * (size_t)a->side_px;
    a->face = mem_alloc(c, count, sizeof *a->face);
    a->texel = mem_alloc(c, count, sizeof *a->texel);
    a->barycentric = mem_alloc(c, count, 2 * sizeof *a->barycentric);
    if (!a->face || !a->texel || !a->barycentric) return SHERF_NO_MEMORY;
    memset(a->face, 0xff, count * sizeof *a->face);
    texel_job o = {a->side_px, a->face, a->barycentric, 0};
    for (int64_t t = 0; t < s->triangles; t++) {
        double p[3][2];
        for (int q = 0; q < 3; q++)
            for (int d = 0; d < 2; d++) p[q][d] = a->uv[2 * (size_t)a->triangle[3 * t + q] + (size_t)d];
        o.self = (int32_t)t;
        cover(p, set_texel, &o);
    }
    for (size_t at = 0; at < count; at++) {
        if (a->face[at] == NOBODY) continue;
        a->face[a->texels] = a->face[at];
        a->barycentric[2 * a->texels] = a->barycentric[2 * at];
        a->barycentric[2 * a->texels + 1] = a->barycentric[2 * at + 1];
        a->texel[a->texels++] = (int32_t)at;
    }
    return SHERF_OK;
}

void atlas_free(atlas *a) {
    mem_free(a->vertex);
    mem_free(a->uv);
    mem_free(a->triangle);
    mem_free(a->texel);
    mem_free(a->face);
    mem_free(a->barycentric);
    *a = (atlas){0};
}

static double area_of(const surface *s) {
    double sum = 0;
    for (int64_t t = 0; t < s->triangles; t++) {
        double n[3];
        surface_cross(s, t, n);
        sum += sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) / 2;
    }
    return sum;
}

sherf_status atlas_make(context *c, const surface *s, int side_px, atlas *out) {
    const size_t T = (size_t)s->triangles;
    *out = (atlas){.side_px = side_px};
    if (side_px < ATLAS_SIDE_MIN || side_px > ATLAS_SIDE_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "texture of %d texels: must be %d to %d", side_px,
                       ATLAS_SIDE_MIN, ATLAS_SIDE_MAX);
    if (T > INT32_MAX / 3) return failure(c, SHERF_BAD_ARGUMENT, "export: the surface is too large");
    cutter w = {.s = s};
    double texels_per_m = 0;
    w.neighbour = mem_alloc(c, 3 * T, sizeof *w.neighbour);
    w.facing = mem_alloc(c, 3 * T, sizeof *w.facing);
    w.flat = mem_alloc(c, 3 * T, sizeof *w.flat);
    w.owner = mem_alloc(c, T, sizeof *w.owner);
    w.order = mem_alloc(c, T, sizeof *w.order);
    bool good = w.neighbour && w.facing && w.flat && w.owner && w.order;
    sherf_status status = good ? find_neighbours(c, s, w.neighbour) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        find_normals(s, w.facing, w.flat);
        const double size_m = sqrt(area_of(s));
        w.reach_m = chart_reach * size_m;
        status = cut(c, &w, size_m / side_px);
    }
    if (status == SHERF_OK) status = pack_best(c, &w, side_px, &texels_per_m);
    if (status == SHERF_OK) status = lay_out(c, &w, texels_per_m, out);
    if (status == SHERF_OK) status = find_texels(c, s, out);
    mem_free(w.neighbour);
    mem_free(w.facing);
    mem_free(w.flat);
    mem_free(w.owner);
    mem_free(w.order);
    mem_free(w.chart);
    if (status != SHERF_OK) atlas_free(out);
    return status;
}

/* ---- painting ---- */
/* Rings of empty texels around charts take the mean of their painted neighbours; the others take the mean of
 * all. */
sherf_status atlas_paint(context *c, const atlas *a, const float *rgb, uint8_t *picture) {
    enum { RINGS = 8 };
    const int side = a->side_px;
    const size_t count = (size_t)side * (size_t)side;
    uint8_t *ring = mem_alloc(c, count, 1); /* RINGS + 1: empty */
    double mean[3] = {0};
    if (!ring) return SHERF_NO_MEMORY;
    memset(ring, RINGS + 1, count);
    for (int64_t i = 0; i < a->texels; i++) {
        ring[a->texel[i]] = 0;
        for (int k = 0; k < 3; k++) {
            mean[k] += rgb[3 * i + k] / (double)a->texels;
            picture[3 * (size_t)a->texel[i] + (size_t)k] =
                (uint8_t)(fminf(fmaxf(rgb[3 * i + k], 0), 1) * 255 + 0.5f);
        }
    }
    for (int r = 1; r <= RINGS + 1; r++)
        for (size_t at = 0; at < count; at++) {
            if (ring[at] <= RINGS) continue;
            int sum[3] = {0}, found = 0, x = (int)(at % (size_t)side), y = (int)(at / (size_t)side);
            for (int d = 0; d < 9 && r <= RINGS; d++) {
                int i = x + d % 3 - 1, j = y + d / 3 - 1;
                if (i < 0 || j < 0 || i >= side || j >= side) continue;
                size_t near = (size_t)j * (size_t)side + (size_t)i;
                if (ring[near] >= r) continue;
                found++;
                for (int k = 0; k < 3; k++) sum[k] += picture[3 * near + (size_t)k];
            }
            if (!found && r <= RINGS) continue;
            if (found) ring[at] = (uint8_t)r;
            for (int k = 0; k < 3; k++)
                picture[3 * at + (size_t)k] =
                    (uint8_t)(found ? (sum[k] + found / 2) / found : (int)(mean[k] * 255 + 0.5));
        }
    mem_free(ring);
    return SHERF_OK;
}
