/* PIFu's surface: the cube about the person from coarse to fine, marching cubes, colours; and its frames. */
#include <math.h>
#include <string.h>

#include "model/pifu/settings.h"
#include "sampling/tiles.h"
#include "scene/cubes.h"

enum { CHUNK = 8192, SAMPLES = 4 };
static const float level = 0.5f, alike = 0.01f;    /* a cell whose corners differ by less is uniform */
static const float cube_heights = 256.0f / 180.0f; /* the cube's side */

/* ---- the network at many points ---- */
typedef struct {
    tape *tape;
    const model *m;
    const observation_geometry *g;
    const model_bank *bank;
    int64_t count;
    float *world, *uv, *z; /* CHUNK x 3, x 2, x 1 */
    uint8_t *in;
    float *answer; /* CHUNK x 3 */
} querier;

static void querier_free(querier *a) {
    tape_free(a->tape);
    mem_free(a->world);
    mem_free(a->in);
}

static sherf_status querier_create(context *c, const model *m, const observation_geometry *g,
                                   const model_bank *bank, querier *a) {
    *a = (querier){.m = m, .g = g, .bank = bank};
    a->tape = tape_create(
        c, (tape_options){.backend = backend_of(c), .bf16 = c->precision == SHERF_PRECISION_BF16});
    a->world = mem_alloc(c, CHUNK, 9 * sizeof *a->world);
    a->in = mem_alloc(c, CHUNK, 1);
    if (!a->tape || !a->world || !a->in) return SHERF_NO_MEMORY;
    a->uv = a->world + 3 * CHUNK;
    a->z = a->uv + 2 * CHUNK;
    a->answer = a->z + CHUNK;
    return SHERF_OK;
}

/* Queries the points in a->world: occupancy, or colour (three values). */
static sherf_status query(querier *a, bool color) {
    const pifu_network *n = a->m->network;
    tensor *const *map = a->bank->tensor;
    context *c = tape_context(a->tape);
    if (cancelled(c)) return failure(c, SHERF_CANCELLED, "cancelled");
    pifu_crop_place(a->g->own, &a->g->camera, a->count, a->world, a->uv, a->z, a->in);
    tape_reset(a->tape);
    tensor *z = tape_input(a->tape, a->z, 2, (int64_t[]){a->count, 1});
    tensor *y = color ? pifu_color(a->tape, n, map[0], map[1], a->uv, z, a->count)
                      : pifu_occupancy(a->tape, n, map[0], a->uv, z, a->count);
    return y ? tensor_download(c, y, a->answer) : tape_status(a->tape);
}

/* ---- the grid ---- */
static void grid_place(const cubes_grid *g, const int at[3], float out[3]) {
    for (int k = 0; k < 3; k++) out[k] = g->min[k] + g->step_m * (float)at[k];
}

typedef struct {
    querier *querier;
    cubes_grid *grid;
    uint8_t *known;
    size_t *where; /* CHUNK: places of the points that are queried */
} search;

static sherf_status flush(search *s) {
    const querier *a = s->querier;
    if (!a->count) return SHERF_OK;
    const sherf_status status = query(s->querier, false);
    for (int64_t i = 0; i < a->count && status == SHERF_OK; i++)
        s->grid->value[s->where[i]] = a->in[i] ? a->answer[i] : 0;
    s->querier->count = 0;
    return status;
}

/* Queries every lattice point that is not known yet. */
static sherf_status lattice(search *s, int step) {
    const cubes_grid *g = s->grid;
    sherf_status status = SHERF_OK;
    int at[3];
    for (at[2] = 0; at[2] < g->size[2]; at[2] += step)
        for (at[1] = 0; at[1] < g->size[1]; at[1] += step)
            for (at[0] = 0; at[0] < g->size[0]; at[0] += step) {
                const size_t place = cubes_at(g, at[0], at[1], at[2]);
                if (s->known[place]) continue;
                s->known[place] = 1;
                s->where[s->querier->count] = place;
                grid_place(g, at, s->querier->world + 3 * s->querier->count++);
                if (s->querier->count == CHUNK && (status = flush(s)) != SHERF_OK) return status;
            }
    return flush(s);
}

/* Where a cell's eight corners agree, all points in it take their value. */
static void fill(search *s, int step) {
    const cubes_grid *g = s->grid;
    for (int z = 0; z + step < g->size[2]; z += step)
        for (int y = 0; y + step < g->size[1]; y += step)
            for (int x = 0; x + step < g->size[0]; x += step) {
                float low = INFINITY, high = -INFINITY;
                for (int k = 0; k < 8; k++) {
                    const float v = g->value[cubes_at(g, x + (k & 1) * step, y + (k >> 1 & 1) * step,
                                                      z + (k >> 2) * step)];
                    low = fminf(low, v);
                    high = fmaxf(high, v);
                }
                if (!(high - low < alike)) continue;
                for (int k = z; k <= z + step; k++)
                    for (int j = y; j <= y + step; j++)
                        for (int i = x; i <= x + step; i++) {
                            const size_t at = cubes_at(g, i, j, k);
                            if (!s->known[at]) g->value[at] = (low + high) / 2;
                            s->known[at] = 1;
                        }
            }
}

/* Marks the outermost points as outside, so that the surface is closed. */
static void close_rim(cubes_grid *g) {
    for (int z = 0; z < g->size[2]; z++)
        for (int y = 0; y < g->size[1]; y++)
            for (int x = 0; x < g->size[0]; x++)
                if (!x || !y || !z || x + 1 == g->size[0] || y + 1 == g->size[1] || z + 1 == g->size[2])
                    g->value[cubes_at(g, x, y, z)] = 0;
}

static sherf_status grid_fill(context *c, querier *a, cubes_grid *g) {
    const pifu_crop *crop = a->g->own;
    const pifu_settings *k = pifu_settings_of(&a->m->config);
    const int resolution = k->resolution;
    const size_t side = (size_t)resolution + 1, n = side * side * side;
    *g = (cubes_grid){.size = {resolution + 1, resolution + 1, resolution + 1},
                      .step_m = cube_heights * crop->height_m / (float)resolution};
    for (int i = 0; i < 3; i++) g->min[i] = crop->middle[i] - cube_heights * crop->height_m / 2;
    g->value = mem_zero(c, n, sizeof *g->value);
    search s = {a, g, mem_zero(c, n, 1), mem_alloc(c, CHUNK, sizeof *s.where)};
    sherf_status status = g->value && s.known && s.where ? SHERF_OK : SHERF_NO_MEMORY;
    for (int step = resolution > k->coarse ? resolution / k->coarse : 1; step && status == SHERF_OK;
         step /= 2) {
        status = lattice(&s, step);
        if (status == SHERF_OK && step > 1) fill(&s, step);
    }
    if (status == SHERF_OK) close_rim(g);
    mem_free(s.known);
    mem_free(s.where);
    return status;
}

/* ---- the surface ---- */
static sherf_status colors_query(querier *a, const surface *s, float *rgb) {
    sherf_status status = SHERF_OK;
    for (int64_t begin = 0; begin < s->vertices && status == SHERF_OK; begin += CHUNK) {
        a->count = s->vertices - begin < CHUNK ? s->vertices - begin : CHUNK;
        memcpy(a->world, s->position + 3 * begin, 3 * (size_t)a->count * sizeof *a->world);
        status = query(a, true);
        for (int64_t i = 0; i < 3 * a->count && status == SHERF_OK; i++)
            rgb[3 * begin + i] = (a->answer[i] + 1) / 2;
    }
    return status;
}

/* An avatar's arrays must not be empty. */
static sherf_status nothing(context *c, const pifu_crop *crop, surface *s) {
    s->position = mem_alloc(c, 1, 3 * sizeof *s->position);
    s->triangle = mem_zero(c, 1, 3 * sizeof *s->triangle);
    if (!s->position || !s->triangle) return SHERF_NO_MEMORY;
    memcpy(s->position, crop->middle, sizeof crop->middle);
    s->vertices = s->triangles = 1;
    return SHERF_OK;
}

sherf_status pifu_surface(context *c, const model *m, const observation_geometry *g, const model_bank *bank,
                          kept_bank *out) {
    querier a;
    cubes_grid grid = {0};
    surface s = {0};
    float *rgb = NULL;
    sherf_status status = querier_create(c, m, g, bank, &a);
    if (status == SHERF_OK) status = grid_fill(c, &a, &grid);
    if (status == SHERF_OK) status = cubes_surface(c, &grid, level, &s);
    if (status == SHERF_OK && !s.triangles) {
        surface_free(&s);
        status = nothing(c, g->own, &s);
    }
    if (status == SHERF_OK && !(rgb = mem_alloc(c, (size_t)s.vertices, 3 * sizeof *rgb)))
        status = SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = colors_query(&a, &s, rgb);
    cubes_grid_free(&grid);
    querier_free(&a);
    if (status != SHERF_OK) {
        surface_free(&s);
        mem_free(rgb);
        return status;
    }
    out->array[PIFU_VERTICES].dim[0] = out->array[PIFU_COLORS].dim[0] = s.vertices;
    out->array[PIFU_TRIANGLES].dim[0] = s.triangles;
    out->array[PIFU_VERTICES].data = s.position;
    out->array[PIFU_TRIANGLES].data = s.triangle;
    out->array[PIFU_COLORS].data = rgb;
    mem_free(s.normal);
    return SHERF_OK;
}

/* ---- frames ---- */
typedef struct {
    solid_mesh mesh;
    const float *rgb; /* V x 3 */
} drawn;

static void release(void *field) {
    mem_free(field);
}

/* Checked, since an avatar's file may hold anything. */
static sherf_status create(context *c, const field_source *from, const body_model *body, void **out) {
    const kept_array *k = from->kept->array;
    const drawn d = {
        {k[PIFU_VERTICES].dim[0], k[PIFU_TRIANGLES].dim[0], k[PIFU_VERTICES].data, k[PIFU_TRIANGLES].data},
        k[PIFU_COLORS].data};
    *out = NULL;
    if (k[PIFU_COLORS].dim[0] != d.mesh.vertices)
        return failure(c, SHERF_BAD_FILE, "the surface has %lld vertices and %lld colours",
                       (long long)d.mesh.vertices, (long long)k[PIFU_COLORS].dim[0]);
    for (int64_t i = 0; i < 3 * d.mesh.vertices; i++)
        if (!isfinite(d.mesh.vertex[i]) || !isfinite(d.rgb[i]))
            return failure(c, SHERF_BAD_FILE, "a place or colour of the surface is not finite");
    for (int64_t i = 0; i < 3 * d.mesh.triangles; i++)
        if (d.mesh.triangle[i] >= d.mesh.vertices)
            return failure(c, SHERF_BAD_FILE, "a triangle has a corner that is not there");
    drawn *kept = mem_alloc(c, 1, sizeof *kept);
    if (!kept) return SHERF_NO_MEMORY;
    *kept = d;
    *out = kept;
    return SHERF_OK;
}

/* Sums colour and depth over a pixel's samples; returns how many hit the surface. */
static int pixel(const drawn *d, const raster *r, int x, int y, float rgb[3], float *depth) {
    int hits = 0;
    for (int i = 0; i < SAMPLES * SAMPLES; i++) {
        const size_t at =
            (size_t)(y * SAMPLES + i / SAMPLES) * (size_t)r->width + (size_t)(x * SAMPLES + i % SAMPLES);
        if (r->face[at] < 0) continue;
        const uint32_t *corner = d->mesh.triangle + 3 * (size_t)r->face[at];
        for (int n = 0; n < 3; n++)
            for (int k = 0; k < 3; k++)
                rgb[k] += r->barycentric[3 * at + (size_t)n] * d->rgb[3 * (size_t)corner[n] + (size_t)k];
        *depth += r->depth[at];
        hits++;
    }
    return hits;
}

static void shade(const drawn *d, const raster *r, const ray_bundle *rays, const float background[3],
                  sherf_frame *frame) {
    const float all = SAMPLES * SAMPLES;
    for (int y = 0; y < rays->height; y++)
        for (int x = 0; x < rays->width; x++) {
            const size_t at = (size_t)y * (size_t)rays->width + (size_t)x;
            float rgb[3] = {0}, depth = 0;
            const int hits = rays->at_box[at] ? pixel(d, r, x, y, rgb, &depth) : 0;
            const float opacity = (float)hits / all;
            for (int k = 0; k < 3; k++)
                frame->color.data[3 * at + (size_t)k] = rgb[k] / all + (1 - opacity) * background[k];
            frame->opacity.data[at] = opacity;
            frame->depth.data[at] = hits ? depth / (float)hits : rays->far[at];
        }
}

static sherf_status render(context *c, void *field, const body_model *body, const ray_bundle *rays,
                           const point_set *points, const float background[3], bool early_stop,
                           sherf_frame *frame) {
    const drawn *d = field;
    raster *r;
    sherf_status status = frame_shape(c, rays->width, rays->height, frame);
    if (status == SHERF_OK)
        status = raster_create(c, &rays->camera, SAMPLES, d->mesh.vertices, d->mesh.vertex, d->mesh.triangles,
                               d->mesh.triangle, &r);
    if (status != SHERF_OK) return status;
    shade(d, r, rays, background, frame);
    frame->points = 0;
    raster_free(r);
    return SHERF_OK;
}

static solid_mesh surface_of(const void *field) {
    return ((const drawn *)field)->mesh;
}

const field_kind pifu_field = {.create = create, .release = release, .render = render, .surface = surface_of};
