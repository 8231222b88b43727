/* Fewer triangles by collapsing edges, cheapest first (Garland and Heckbert, "Surface Simplification Using
 * Quadric Error Metrics", 1997). An edge collapses only if its ends have exactly two neighbours in common and
 * no triangle turns over, so that a closed manifold stays one. */
#include <math.h>
#include <string.h>

#include "baked/baked.h"

enum { END = -1 };

/* Sum of squared distances to planes as x^T A x + 2 b x + c; A symmetric: xx xy xz yy yz zz. */
typedef struct {
    double A[6], b[3], c;
} quadric;

typedef struct {
    double cost;
    uint32_t a, b, stamp_a, stamp_b;
    float place[3];
} candidate;

typedef struct {
    surface *s;
    quadric *q;
    int64_t left;    /* triangles */
    int32_t *first;  /* V: a corner (3 triangle + k), or END */
    int32_t *next;   /* 3 T: the next corner at the same vertex */
    uint32_t *stamp; /* V: changes whenever the vertex or its quadric does */
    uint32_t *mark;  /* V */
    uint32_t marks;
    uint8_t *gone; /* T */
    candidate *heap;
    size_t count, room;
} reducer;

/* ---- the heap ---- */
static sherf_status heap_push(context *c, reducer *r, const candidate *e) {
    if (r->count == r->room) {
        size_t room = r->room ? r->room + r->room / 2 : 1 << 12;
        candidate *grown = mem_grow(c, r->heap, r->room, room, sizeof *grown);
        if (!grown) return SHERF_NO_MEMORY;
        r->heap = grown;
        r->room = room;
    }
    size_t i = r->count++;
    for (; i && r->heap[(i - 1) / 2].cost > e->cost; i = (i - 1) / 2) r->heap[i] = r->heap[(i - 1) / 2];
    r->heap[i] = *e;
    return SHERF_OK;
}

static candidate heap_pop(reducer *r) {
    candidate top = r->heap[0], last = r->heap[--r->count];
    size_t i = 0;
    for (size_t k; (k = 2 * i + 1) < r->count; i = k) {
        if (k + 1 < r->count && r->heap[k + 1].cost < r->heap[k].cost) k++;
        if (!(r->heap[k].cost < last.cost)) break;
        r->heap[i] = r->heap[k];
    }
    if (r->count) r->heap[i] = last;
    return top;
}

/* ---- quadrics ---- */
static void quadric_add(quadric *q, const quadric *p) {
    for (int k = 0; k < 6; k++) q->A[k] += p->A[k];
    for (int k = 0; k < 3; k++) q->b[k] += p->b[k];
    q->c += p->c;
}

/* The plane through p with unit normal n, `weight` times. */
static void quadric_plane(quadric *q, const double n[3], const float p[3], double weight) {
    double d = -(n[0] * p[0] + n[1] * p[1] + n[2] * p[2]);
    const quadric plane = {{weight * n[0] * n[0], weight * n[0] * n[1], weight * n[0] * n[2],
                            weight * n[1] * n[1], weight * n[1] * n[2], weight * n[2] * n[2]},
                           {weight * d * n[0], weight * d * n[1], weight * d * n[2]},
                           weight * d * d};
    quadric_add(q, &plane);
}

static double quadric_at(const quadric *q, const double x[3]) {
    const double *A = q->A, *b = q->b;
    return A[0] * x[0] * x[0] + A[3] * x[1] * x[1] + A[5] * x[2] * x[2] +
           2 * (A[1] * x[0] * x[1] + A[2] * x[0] * x[2] + A[4] * x[1] * x[2]) +
           2 * (b[0] * x[0] + b[1] * x[1] + b[2] * x[2]) + q->c;
}

/* The minimum of the quadric; false: it is flat in some direction. */
static bool quadric_minimum(const quadric *q, double x[3]) {
    const double *A = q->A, *b = q->b;
    double c0 = A[3] * A[5] - A[4] * A[4], c1 = A[2] * A[4] - A[1] * A[5], c2 = A[1] * A[4] - A[2] * A[3];
    double det = A[0] * c0 + A[1] * c1 + A[2] * c2, size = A[0] + A[3] + A[5];
    if (!(fabs(det) > 1e-4 * size * size * size)) return false;
    double c3 = A[0] * A[5] - A[2] * A[2], c4 = A[1] * A[2] - A[0] * A[4], c5 = A[0] * A[3] - A[1] * A[1];
    x[0] = -(c0 * b[0] + c1 * b[1] + c2 * b[2]) / det;
    x[1] = -(c1 * b[0] + c3 * b[1] + c4 * b[2]) / det;
    x[2] = -(c2 * b[0] + c4 * b[1] + c5 * b[2]) / det;
    return true;
}

static void triangle_cross(const float *a, const float *b, const float *d, double out[3]) {
    double u[3], v[3];
    for (int k = 0; k < 3; k++) u[k] = (double)b[k] - a[k], v[k] = (double)d[k] - a[k];
    out[0] = u[1] * v[2] - u[2] * v[1];
    out[1] = u[2] * v[0] - u[0] * v[2];
    out[2] = u[0] * v[1] - u[1] * v[0];
}

static const float *place_of(const reducer *r, uint32_t v) {
    return r->s->position + 3 * (size_t)v;
}

/* ---- edges ---- */
static sherf_status add_edge(context *c, reducer *r, uint32_t a, uint32_t b) {
    quadric q = r->q[a];
    quadric_add(&q, &r->q[b]);
    const float *pa = place_of(r, a), *pb = place_of(r, b);
    double middle[3], x[3], length2 = 0, away2 = 0, best;
    for (int k = 0; k < 3; k++) {
        middle[k] = ((double)pa[k] + pb[k]) / 2;
        length2 += ((double)pa[k] - pb[k]) * ((double)pa[k] - pb[k]);
    }
    bool found = quadric_minimum(&q, x);
    for (int k = 0; k < 3 && found; k++) away2 += (x[k] - middle[k]) * (x[k] - middle[k]);
    if (!found || !(away2 < length2)) memcpy(x, middle, sizeof x);
    best = quadric_at(&q, x);
    candidate e = {.a = a, .b = b, .stamp_a = r->stamp[a], .stamp_b = r->stamp[b]};
    for (int k = 0; k < 3; k++) e.place[k] = (float)x[k];
    /* on flat parts short edges collapse first, which keeps triangles of similar size */
    e.cost = fmax(best, 0) + 1e-4 * length2 * length2;
    return heap_push(c, r, &e);
}

static const uint32_t *triangle_of(const reducer *r, int32_t corner) {
    return r->s->triangle + 3 * (size_t)(corner / 3);
}

/* Triangles at v. */
static int degree_of(const reducer *r, uint32_t v) {
    int count = 0;
    for (int32_t i = r->first[v]; i != END; i = r->next[i]) count += !r->gone[i / 3];
    return count;
}

/* Marks the neighbours of v with `mark`. Counts those that had the mark `common`; a neighbour with three
 * triangles, which would be left with two, counts as three. */
static int mark_neighbours(reducer *r, uint32_t v, uint32_t mark, uint32_t common) {
    int shared = 0;
    for (int32_t i = r->first[v]; i != END; i = r->next[i]) {
        if (r->gone[i / 3]) continue;
        for (int k = 0; k < 3; k++) {
            uint32_t n = triangle_of(r, i)[k];
            if (n == v || r->mark[n] == mark) continue;
            if (r->mark[n] == common) shared += degree_of(r, n) > 3 ? 1 : 3;
            r->mark[n] = mark;
        }
    }
    return shared;
}

/* Whether a triangle at v, but not at `other`, would turn by more than 75 degrees or lose its area. */
static bool turns_over(const reducer *r, uint32_t v, uint32_t other, const float place[3]) {
    for (int32_t i = r->first[v]; i != END; i = r->next[i]) {
        const uint32_t *t = triangle_of(r, i);
        if (r->gone[i / 3] || t[0] == other || t[1] == other || t[2] == other) continue;
        const float *before[3], *after[3];
        double m[3], n[3], mn = 0, mm = 0, nn = 0;
        for (int k = 0; k < 3; k++) {
            before[k] = place_of(r, t[k]);
            after[k] = t[k] == v ? place : before[k];
        }
        triangle_cross(before[0], before[1], before[2], m);
        triangle_cross(after[0], after[1], after[2], n);
        double longest2 = 0;
        for (int k = 0; k < 3; k++) {
            double side2 = 0;
            for (int d = 0; d < 3; d++) {
                double x = (double)after[k][d] - after[(k + 1) % 3][d];
                side2 += x * x;
            }
            longest2 = fmax(longest2, side2);
            mn += m[k] * n[k], mm += m[k] * m[k], nn += n[k] * n[k];
        }
        if (!(nn > 0.0025 * longest2 * longest2)) { /* a needle: only if it was none before */
            if (!(nn > mm)) return true;
        }
        if (mm > 0 && !(mn > 0.25 * sqrt(mm * nn))) return true;
    }
    return false;
}

/* b becomes a. */
static sherf_status collapse(context *c, reducer *r, const candidate *e) {
    int32_t last = END;
    memcpy(r->s->position + 3 * (size_t)e->a, e->place, sizeof e->place);
    for (int32_t i = r->first[e->b]; i != END; i = r->next[i]) {
        uint32_t *t = r->s->triangle + 3 * (size_t)(i / 3);
        last = i;
        if (r->gone[i / 3]) continue;
        if (t[0] == e->a || t[1] == e->a || t[2] == e->a) {
            r->gone[i / 3] = 1;
            r->left--;
        } else
            t[i % 3] = e->a;
    }
    if (last != END) {
        r->next[last] = r->first[e->a];
        r->first[e->a] = r->first[e->b];
    }
    r->first[e->b] = END;
    quadric_add(&r->q[e->a], &r->q[e->b]);
    r->stamp[e->a]++;
    r->stamp[e->b]++;
    /* without the corners of triangles that went */
    for (int32_t *at = &r->first[e->a]; *at != END;)
        if (r->gone[*at / 3])
            *at = r->next[*at];
        else
            at = &r->next[*at];
    const uint32_t mark = ++r->marks;
    sherf_status status = SHERF_OK;
    for (int32_t i = r->first[e->a]; i != END && status == SHERF_OK; i = r->next[i])
        for (int k = 0; k < 3 && status == SHERF_OK; k++) {
            uint32_t n = triangle_of(r, i)[k];
            if (n == e->a || r->mark[n] == mark) continue;
            r->mark[n] = mark;
            status = add_edge(c, r, e->a, n);
        }
    return status;
}

static sherf_status start(context *c, reducer *r) {
    surface *s = r->s;
    const size_t V = (size_t)s->vertices, T = (size_t)s->triangles;
    r->left = s->triangles;
    r->q = mem_zero(c, V, sizeof *r->q);
    r->first = mem_alloc(c, V, sizeof *r->first);
    r->next = mem_alloc(c, 3 * T, sizeof *r->next);
    r->stamp = mem_zero(c, V, sizeof *r->stamp);
    r->mark = mem_zero(c, V, sizeof *r->mark);
    r->gone = mem_zero(c, T, 1);
    if (!r->q || !r->first || !r->next || !r->stamp || !r->mark || !r->gone) return SHERF_NO_MEMORY;
    for (size_t v = 0; v < V; v++) r->first[v] = END;
    for (size_t t = 0; t < T; t++) {
        const uint32_t *at = s->triangle + 3 * t;
        double n[3], length = 0;
        triangle_cross(place_of(r, at[0]), place_of(r, at[1]), place_of(r, at[2]), n);
        for (int k = 0; k < 3; k++) length += n[k] * n[k];
        length = sqrt(length);
        for (int k = 0; k < 3; k++) n[k] = length > 0 ? n[k] / length : 0;
        for (int k = 0; k < 3; k++) {
            if (length > 0) quadric_plane(&r->q[at[k]], n, place_of(r, at[0]), length / 6);
            r->next[3 * t + (size_t)k] = r->first[at[k]];
            r->first[at[k]] = (int32_t)(3 * t) + k;
        }
    }
    sherf_status status = SHERF_OK;
    for (size_t t = 0; t < T && status == SHERF_OK; t++)
        for (int k = 0; k < 3 && status == SHERF_OK; k++) {
            uint32_t a = s->triangle[3 * t + (size_t)k], b = s->triangle[3 * t + (size_t)(k + 1) % 3];
            if (a < b) status = add_edge(c, r, a, b); /* the other triangle has the edge as b, a */
        }
    return status;
}

/* Writes the remaining vertices and triangles, in their order. */
static void finish(reducer *r) {
    surface *s = r->s;
    uint32_t *number = r->stamp;
    int64_t vertices = 0, triangles = 0;
    for (int64_t v = 0; v < s->vertices; v++) {
        if (r->first[v] == END) continue;
        memmove(s->position + 3 * vertices, s->position + 3 * v, 3 * sizeof *s->position);
        number[v] = (uint32_t)vertices++;
    }
    for (int64_t t = 0; t < s->triangles; t++) {
        if (r->gone[t]) continue;
        for (int k = 0; k < 3; k++) s->triangle[3 * triangles + k] = number[s->triangle[3 * t + k]];
        triangles++;
    }
    s->vertices = vertices;
    s->triangles = triangles;
    mem_free(s->normal);
    s->normal = NULL;
}

sherf_status surface_reduce(context *c, surface *s, int64_t triangles) {
    if (s->triangles <= triangles) return SHERF_OK;
    if (s->triangles > INT32_MAX / 3)
        return failure(c, SHERF_BAD_ARGUMENT, "export: the surface is too large to be reduced");
    reducer r = {.s = s};
    sherf_status status = start(c, &r);
    while (status == SHERF_OK && r.left > triangles && r.count) {
        const candidate e = heap_pop(&r);
        if (e.stamp_a != r.stamp[e.a] || e.stamp_b != r.stamp[e.b]) continue;
        r.marks += 2;
        mark_neighbours(&r, e.a, r.marks - 1, UINT32_MAX);
        if (mark_neighbours(&r, e.b, r.marks, r.marks - 1) != 2) continue;
        if (turns_over(&r, e.a, e.b, e.place) || turns_over(&r, e.b, e.a, e.place)) continue;
        status = collapse(c, &r, &e);
        if (status == SHERF_OK && cancelled(c)) status = failure(c, SHERF_CANCELLED, "cancelled");
    }
    if (status == SHERF_OK) finish(&r);
    mem_free(r.q);
    mem_free(r.first);
    mem_free(r.next);
    mem_free(r.stamp);
    mem_free(r.mark);
    mem_free(r.gone);
    mem_free(r.heap);
    return status;
}
