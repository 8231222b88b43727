/* Continues patterns and colours where no picture shows the person. The back of trunk and limbs is much like
 * their front, and one side like the other, but the network averages what it has not seen: its backs are
 * smooth and dull. So an unseen place borrows from the opposite place, if that one is seen.
 *
 * Not everything continues. Faces, feet and hands differ in front and behind. A print on a plain shirt, a row
 * of buttons or a tie is not a pattern: the more a place's contrast exceeds that of its garment elsewhere,
 * the less of it is lent. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "avatar/detail.h"

enum { PARTS = 6, HEAD = 1 };
/* Trunk, head, upper arms, forearms, thighs, shins: parts that are usually covered by one cloth. */
static const int8_t part_of[BODY_JOINTS] = {0, 4, 4, 0, 5, 5, 0, 5, 5, 0, 5, 5,
                                            0, 0, 0, 1, 2, 2, 3, 3, 3, 3, 3, 3};
/* The largest contrast of a pattern, as a multiple of its part's median. */
static const float contrast_max = 1.5f;
/* Grid cells for the search of the opposite side. */
static const float cell_m = 0.02f;
enum { CELLS = 128 };

static int part(const body_model *body, int v) {
    const float *w = body->weights + (size_t)v * BODY_JOINTS;
    int best = 0;
    for (int j = 1; j < BODY_JOINTS; j++)
        if (w[j] > w[best]) best = j;
    return part_of[best];
}

/* ---- the other side ---- */

/* How far a vertex belongs to parts whose back is like their front. */
static float has_two_sides(const body_model *body, int v) {
    static const int8_t not [] = {7, 8, 10, 11, 12, 15, 20, 21, 22, 23}; /* feet, neck, head, hands */
    float sum = 0;
    for (size_t i = 0; i < COUNT_OF(not ); i++)
        sum += body->weights[(size_t)v * BODY_JOINTS + (size_t) not [i]];
    return sum < 1 ? 1 - sum : 0;
}

static int cell_of(const float *x, const float *min) {
    int at[2];
    for (int k = 0; k < 2; k++) {
        at[k] = 1 + (int)((x[k] - min[k]) / cell_m);
        if (!(at[k] < CELLS - 1)) at[k] = CELLS - 2;
    }
    return at[1] * CELLS + at[0];
}

/* Vertices by cell: those of cell i are list[first[i]] up to first[i + 1]. */
static void sort_by_cell(const body_model *body, const float *min, int32_t *first, int32_t *list) {
    const float *x = body->canonical->vertices_smpl;
    memset(first, 0, (CELLS * CELLS + 1) * sizeof *first);
    for (int v = 0; v < body->vertices; v++) first[cell_of(x + 3 * v, min) + 1]++;
    for (int i = 0; i < CELLS * CELLS; i++) first[i + 1] += first[i];
    for (int v = body->vertices - 1; v >= 0; v--) list[--first[cell_of(x + 3 * v, min) + 1]] = v;
    memmove(first, first + 1, CELLS * CELLS * sizeof *first);
    first[CELLS * CELLS] = body->vertices;
}

/* The nearest vertex in x and y among those across the canonical body's z whose normal looks the other way;
 * -1: none. */
static int32_t opposite(const body_model *body, const float *normal, const float *min, const int32_t *first,
                        const int32_t *list, int v) {
    const float *x = body->canonical->vertices_smpl, *p = x + 3 * v;
    const int middle = cell_of(p, min);
    int32_t best = -1;
    float nearest = INFINITY;
    for (int row = -1; row <= 1; row++)
        for (int32_t i = first[middle + row * CELLS - 1]; i < first[middle + row * CELLS + 2]; i++) {
            const int32_t u = list[i];
            const float dx = x[3 * u] - p[0], dy = x[3 * u + 1] - p[1], dz = x[3 * u + 2] - p[2];
            const float far = dx * dx + dy * dy + 0.01f * dz * dz;
            if (!(normal[3 * u + 2] * normal[3 * v + 2] < 0) || !(far < nearest)) continue;
            nearest = far;
            best = u;
        }
    return best;
}

sherf_status carry_create(context *c, const body_model *body, detail_carry *out) {
    const size_t V = (size_t)body->vertices;
    float *normal = mem_alloc(c, V, 3 * sizeof *normal), min[3], max[3];
    int32_t *first = mem_alloc(c, CELLS * CELLS + 1, sizeof *first), *list = mem_alloc(c, V, sizeof *list);
    out->opposite = mem_alloc(c, V, sizeof *out->opposite);
    out->two_sides = mem_alloc(c, V, sizeof *out->two_sides);
    sherf_status status =
        normal && first && list && out->opposite && out->two_sides ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = body_normals(c, body, body->canonical->vertices_smpl, normal);
    if (status == SHERF_OK) {
        body_canonical_bounds(body, min, max);
        sort_by_cell(body, min, first, list);
        for (int v = 0; v < body->vertices; v++) {
            out->opposite[v] = opposite(body, normal, min, first, list, v);
            out->two_sides[v] = has_two_sides(body, v);
        }
    }
    mem_free(normal);
    mem_free(first);
    mem_free(list);
    return status;
}

void carry_free(detail_carry *d) {
    mem_free(d->opposite);
    mem_free(d->two_sides);
    *d = (detail_carry){0};
}

/* Through the body: beside vertex u as x is beside v. */
static carry_place through(const body_model *body, const float x[3], int32_t v, int32_t u) {
    const float *at = body->canonical->vertices_smpl;
    return (carry_place){.x = {x[0], x[1], at[3 * u + 2] - (x[2] - at[3 * v + 2])}, .nearest = u};
}

static carry_place mirrored(const body_model *body, const float x[3], int32_t u) {
    return (carry_place){.x = {2 * body->mirror_x_m - x[0], x[1], x[2]}, .nearest = u};
}

static carry_place with(carry_place p, float sure, float prefer) {
    p.sure = sure;
    p.prefer = prefer;
    return p;
}

int carry_places(const detail_carry *d, const detail_variant *variant, const body_model *body,
                 const float x[3], int32_t nearest, carry_place out[CARRY_PLACES]) {
    const int32_t v = nearest, across = d->opposite[v];
    out[0] = with(mirrored(body, x, body->mirror[v]), 1, variant->beside);
    if (across < 0 || !(d->two_sides[v] > 0)) return 1;
    out[1] = with(through(body, x, v, across), d->two_sides[v], variant->through);
    out[2] = with(mirrored(body, out[1].x, body->mirror[across]), d->two_sides[v], variant->across);
    return 3;
}

/* ---- patterns ---- */

/* Splits the picture into the colour around each pixel and the pattern on it. room: two floats per texel; its
 * second half receives the pattern's squared contrast around each pixel. */
static void split_picture(const context *c, detail_view *d, const float *image, const sherf_frame *own,
                          int radius, float *room) {
    const size_t pixels = (size_t)d->width * (size_t)d->height;
    float *plane = room + pixels, *depth = own->depth.data;
    for (size_t k = 0; k < 3; k++) {
        for (size_t n = 0; n < pixels; n++) plane[n] = image[3 * n + k];
        detail_smooth(c, &own->opacity, radius, depth, plane, room);
        for (size_t n = 0; n < pixels; n++) {
            d->texel[n].color[k] = plane[n];
            d->texel[n].pattern[k] = image[3 * n + k] - plane[n];
        }
    }
    for (size_t n = 0; n < pixels; n++) {
        const float *p = d->texel[n].pattern;
        plane[n] = p[0] * p[0] + p[1] * p[1] + p[2] * p[2];
    }
    detail_smooth(c, &own->opacity, radius, depth, plane, room);
}

static int ascending(const void *a, const void *b) {
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

/* The median over each part's seen vertices; 0 where none is seen. room: V. */
static void part_medians(const body_model *body, const float *seen, const float *contrast, float *room,
                         float median[PARTS]) {
    for (int p = 0; p < PARTS; p++) {
        size_t count = 0;
        for (int v = 0; v < body->vertices; v++)
            if (seen[v] > 0.5f && part(body, v) == p) room[count++] = contrast[v];
        qsort(room, count, sizeof *room, ascending);
        median[p] = count ? room[count / 2] : 0;
    }
}

sherf_status carry_pattern(context *c, const body_model *body, detail_view *d, const float *image,
                           const sherf_frame *own, float *room) {
    const size_t V = (size_t)body->vertices, pixels = (size_t)d->width * (size_t)d->height;
    float *world = mem_alloc(c, V, 3 * sizeof *world), *sorted = mem_alloc(c, V, sizeof *sorted),
          median[PARTS];
    float *contrast = d->patterned = mem_zero(c, V, sizeof *d->patterned);
    const sherf_status status = world && sorted && contrast ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        split_picture(c, d, image, own, detail_pixels(&d->camera, d->posed, 0.03f, CARRY_RADIUS_MAX), room);
        body_vertices_world(body, d->posed, world);
        for (size_t v = 0; v < V; v++) {
            float px[2], depth;
            camera_project(&d->camera, 1, world + 3 * v, px, &depth);
            if (depth > 0 && px[0] >= 0 && px[1] >= 0 && px[0] < (float)d->width && px[1] < (float)d->height)
                contrast[v] = room[pixels + (size_t)px[1] * (size_t)d->width + (size_t)px[0]];
        }
        part_medians(body, d->seen, contrast, sorted, median);
        for (int v = 0; v < body->vertices; v++) {
            const float max = contrast_max * sqrtf(median[part(body, v)]), is = sqrtf(contrast[v]);
            d->patterned[v] = is > max ? max / is : 1;
        }
    }
    mem_free(world);
    mem_free(sorted);
    return status;
}
