/* Maps each texel to a part of the garment and a place on the body. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "synth/people/dye.h"

enum { GROWTH = 10 }; /* texels round an island that count as its own, for filters and mip levels */
static const float same_color = 0.14f;

typedef struct {
    int parent;
    int64_t texels;
    double color[3], height;
    int part;
} island;

static int find_root(int *parent, int i) {
    while (parent[i] != i) i = parent[i] = parent[parent[i]];
    return i;
}

/* Texels with their centre in the triangle get its number, place and island. */
static void paint_triangle(const proxy *p, const float *vertex, int t, int mark, dye_map *map, int *owner) {
    float u[3], v[3];
    for (int i = 0; i < 3; i++) {
        u[i] = p->uv[2 * p->triangle_uv[3 * t + i]] * (float)map->width - 0.5f;
        v[i] = (1 - p->uv[2 * p->triangle_uv[3 * t + i] + 1]) * (float)map->height - 0.5f;
        if (!(fabsf(u[i]) < 1e5f && fabsf(v[i]) < 1e5f)) return;
    }
    float area = (u[1] - u[0]) * (v[2] - v[0]) - (u[2] - u[0]) * (v[1] - v[0]);
    if (fabsf(area) < 1e-9f) return;
    int x0 = (int)ceilf(fminf(u[0], fminf(u[1], u[2])) - 0.5f),
        x1 = (int)floorf(fmaxf(u[0], fmaxf(u[1], u[2])) + 0.5f);
    int y0 = (int)ceilf(fminf(v[0], fminf(v[1], v[2])) - 0.5f),
        y1 = (int)floorf(fmaxf(v[0], fmaxf(v[1], v[2])) + 0.5f);
    x0 = x0 < 0 ? 0 : x0, y0 = y0 < 0 ? 0 : y0;
    x1 = x1 >= map->width ? map->width - 1 : x1, y1 = y1 >= map->height ? map->height - 1 : y1;
    for (int y = y0; y <= y1; y++)
        for (int x = x0; x <= x1; x++) {
            float fx = (float)x, fy = (float)y, w[3];
            w[1] = ((fx - u[0]) * (v[2] - v[0]) - (u[2] - u[0]) * (fy - v[0])) / area;
            w[2] = ((u[1] - u[0]) * (fy - v[0]) - (fx - u[0]) * (v[1] - v[0])) / area;
            w[0] = 1 - w[1] - w[2];
            if (w[0] < -0.01f || w[1] < -0.01f || w[2] < -0.01f) continue;
            size_t at = (size_t)y * (size_t)map->width + (size_t)x;
            owner[at] = mark;
            for (int k = 0; k < 3; k++) {
                float sum = 0;
                for (int i = 0; i < 3; i++) sum += w[i] * vertex[3 * p->triangle[3 * t + i] + k];
                map->place[3 * at + k] = sum;
            }
        }
}

/* Unowned texels next to owned ones take over owner, place and colour. */
static void grow(dye_map *map, int *owner, int *next, image_u8 *texture) {
    int W = map->width, H = map->height;
    memcpy(next, owner, (size_t)W * (size_t)H * sizeof *next);
    for (int y = 0; y < H; y++)
        for (int x = 0; x < W; x++) {
            size_t at = (size_t)y * (size_t)W + (size_t)x;
            for (int k = 0; k < 4 && owner[at] < 0 && next[at] < 0; k++) {
                int nx = x + (k == 0) - (k == 1), ny = y + (k == 2) - (k == 3);
                if (nx < 0 || ny < 0 || nx >= W || ny >= H) continue;
                size_t from = (size_t)ny * (size_t)W + (size_t)nx;
                if (owner[from] < 0) continue;
                next[at] = owner[from];
                memcpy(map->place + 3 * at, map->place + 3 * from, 3 * sizeof *map->place);
                memcpy(texture->data + 4 * at, texture->data + 4 * from, 4);
            }
        }
    memcpy(owner, next, (size_t)W * (size_t)H * sizeof *next);
}

static float distance(const double a[3], const float b[3]) {
    double sum = 0;
    for (int k = 0; k < 3; k++) sum += (a[k] - b[k]) * (a[k] - b[k]);
    return (float)sqrt(sum);
}

static int larger_first(const void *a, const void *b) {
    const island *const *x = a, *const *y = b;
    if ((*x)->texels != (*y)->texels) return (*x)->texels < (*y)->texels ? 1 : -1;
    return *x < *y ? -1 : 1;
}

/* Islands, from large to small, join a part of their zone and colour or start one; if there are too many
 * parts they join the nearest. */
static void form_parts(dye_map *map, island **order, int islands, bool split, float waist_m) {
    int zone[DYE_PARTS];
    qsort(order, (size_t)islands, sizeof *order, larger_first);
    for (int i = 0; i < islands; i++) {
        island *own_island = order[i];
        int own = split && own_island->height > waist_m, part = -1;
        float min = INFINITY;
        for (int k = 0; k < map->parts; k++) {
            float d = distance(own_island->color, map->of[k].color) + (zone[k] == own ? 0 : 10);
            if (d < min) min = d, part = k;
        }
        if (min > same_color && map->parts < DYE_PARTS) {
            part = map->parts++;
            zone[part] = own;
            for (int k = 0; k < 3; k++) map->of[part].color[k] = (float)own_island->color[k];
        }
        own_island->part = part;
    }
}

/* Computes medians over a part's texels, and its bounds. */
static sherf_status measure(context *c, dye_map *map, const int *exact, const image_u8 *texture) {
    int64_t texels = (int64_t)map->width * map->height, all = 0;
    int64_t(*count)[4][256] = mem_zero(c, DYE_PARTS, sizeof *count);
    if (!count) return SHERF_NO_MEMORY;
    int64_t of[DYE_PARTS] = {0};
    for (int k = 0; k < map->parts; k++)
        for (int i = 0; i < 3; i++) map->of[k].low[i] = INFINITY, map->of[k].high[i] = -INFINITY;
    for (int64_t at = 0; at < texels; at++) {
        if (exact[at] < 0) continue;
        const uint8_t *rgb = texture->data + 4 * at;
        int part = map->part[at];
        of[part]++, all++;
        for (int k = 0; k < 3; k++) {
            count[part][k][rgb[k]]++;
            map->of[part].low[k] = fminf(map->of[part].low[k], map->place[3 * at + k]);
            map->of[part].high[k] = fmaxf(map->of[part].high[k], map->place[3 * at + k]);
        }
        count[part][3][(rgb[0] * 299 + rgb[1] * 587 + rgb[2] * 114) / 1000]++;
    }
    for (int part = 0; part < map->parts; part++) {
        for (int k = 0; k < 4; k++) {
            int64_t sum = 0;
            int level = 0;
            while (level < 255 && (sum += count[part][k][level]) * 2 < of[part]) level++;
            if (k < 3)
                map->of[part].color[k] = (float)level / 255;
            else
                map->of[part].luminance = (float)level / 255;
        }
        map->of[part].share = all ? (float)of[part] / (float)all : 0;
    }
    mem_free(count);
    return SHERF_OK;
}

static void count_islands(const dye_map *map, const int *owner, const image_u8 *texture, island *of) {
    for (int64_t at = 0; at < (int64_t)map->width * map->height; at++) {
        if (owner[at] < 0) continue;
        island *i = &of[owner[at]];
        i->texels++;
        i->height += map->place[3 * at + 1];
        for (int k = 0; k < 3; k++) i->color[k] += texture->data[4 * at + k] / 255.0;
    }
}

sherf_status dye_map_create(context *c, const proxy *p, const float *vertex, bool split, float waist_m,
                            image_u8 *texture, dye_map **out) {
    *out = NULL;
    if (texture->channels != 4) return failure(c, SHERF_BAD_ARGUMENT, "a texture without alpha");
    size_t texels = (size_t)texture->width * (size_t)texture->height;
    dye_map *map = mem_zero(c, 1, sizeof *map);
    int *parent = mem_alloc(c, (size_t)p->uvs, sizeof *parent), *owner = mem_alloc(c, texels, sizeof *owner),
        *exact = mem_alloc(c, texels, sizeof *exact), *next = mem_alloc(c, texels, sizeof *next);
    island *of = mem_zero(c, (size_t)p->uvs, sizeof *of),
           **order = mem_alloc(c, (size_t)p->uvs, sizeof *order);
    sherf_status status = SHERF_NO_MEMORY;
    if (!map || !parent || !owner || !exact || !next || !of || !order) goto done;
    map->width = texture->width, map->height = texture->height;
    map->part = mem_alloc(c, texels, 1);
    map->place = mem_zero(c, texels, 3 * sizeof *map->place);
    if (!map->part || !map->place) goto done;
    for (int i = 0; i < p->uvs; i++) parent[i] = i;
    for (int t = 0; t < p->triangles; t++)
        for (int k = 1; k < 3; k++)
            parent[find_root(parent, (int)p->triangle_uv[3 * t + k])] =
                find_root(parent, (int)p->triangle_uv[3 * t]);
    for (size_t i = 0; i < texels; i++) owner[i] = -1;
    for (int t = 0; t < p->triangles; t++)
        paint_triangle(p, vertex, t, find_root(parent, (int)p->triangle_uv[3 * t]), map, owner);
    memcpy(exact, owner, texels * sizeof *exact);
    count_islands(map, owner, texture, of);
    for (int i = 0; i < p->uvs; i++) {
        of[i].part = -1;
        for (int k = 0; k < 3 && of[i].texels; k++) of[i].color[k] /= (double)of[i].texels;
        if (of[i].texels) of[i].height /= (double)of[i].texels;
    }
    int islands = 0;
    for (int i = 0; i < p->uvs; i++)
        if (of[i].texels) order[islands++] = &of[i];
    form_parts(map, order, islands, split, waist_m);
    for (int i = 0; i < GROWTH; i++) grow(map, owner, next, texture);
    for (size_t i = 0; i < texels; i++) map->part[i] = owner[i] < 0 ? DYE_NONE : (uint8_t)of[owner[i]].part;
    status = measure(c, map, exact, texture);
done:
    mem_free(parent);
    mem_free(owner);
    mem_free(exact);
    mem_free(next);
    mem_free(of);
    mem_free(order);
    if (status)
        dye_map_free(map);
    else
        *out = map;
    return status;
}

void dye_map_free(dye_map *map) {
    if (!map) return;
    mem_free(map->part);
    mem_free(map->place);
    mem_free(map);
}
