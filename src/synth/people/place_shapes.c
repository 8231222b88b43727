/* Boxes, cylinders, balls and cards; every flat side has its own vertices, so that it is shaded flat. */
#include "synth/people/place_shapes.h"

#include <math.h>
#include <string.h>

enum { ROUND = 20, RINGS = 10, PARTS_MAX = 128 };

void shapes_free(shapes *s) {
    for (int i = 0; i <= s->meshes; i++) {
        shape_mesh *mesh = i < s->meshes ? &s->mesh[i] : &s->spare;
        trace_texture_free(mesh->texture);
        mem_free(mesh->vertex);
        mem_free(mesh->uv);
        mem_free(mesh->face);
    }
    *s = (shapes){0};
}

shape_mesh *shapes_mesh(shapes *s, place_pattern pattern, const float color[PATTERN_COLORS][3], uint64_t key,
                        float repeat_m) {
    if (s->status || s->meshes == SHAPES_MAX) return &s->spare;
    shape_mesh *mesh = &s->mesh[s->meshes++];
    *mesh = (shape_mesh){.material = trace_material_plain(), .repeat_m = repeat_m};
    s->status = place_pattern_create(s->c, pattern, color, key, SHAPES_TEXTURE_SIDE, &mesh->texture);
    mesh->material.color = mesh->texture;
    if (pattern == PATTERN_LEAVES) mesh->material.alpha = TRACE_CUTOUT;
    return mesh;
}

/* ---- growing ---- */

/* Makes room for more of both, doubling it. */
static bool make_room(shapes *s, shape_mesh *mesh, int vertices, int faces) {
    if (s->status || mesh == &s->spare) return false;
    if (mesh->vertices + vertices > mesh->vertex_room) {
        int room = 2 * (mesh->vertices + vertices);
        float *vertex =
            mem_grow(s->c, mesh->vertex, (size_t)mesh->vertex_room, (size_t)room, 3 * sizeof *vertex);
        if (vertex) mesh->vertex = vertex;
        float *uv =
            vertex ? mem_grow(s->c, mesh->uv, (size_t)mesh->vertex_room, (size_t)room, 2 * sizeof *uv) : NULL;
        if (uv) mesh->uv = uv, mesh->vertex_room = room;
        if (!uv) s->status = SHERF_NO_MEMORY;
    }
    if (!s->status && mesh->faces + faces > mesh->face_room) {
        int room = 2 * (mesh->faces + faces);
        uint32_t *face = mem_grow(s->c, mesh->face, (size_t)mesh->face_room, (size_t)room, 3 * sizeof *face);
        if (face) mesh->face = face, mesh->face_room = room;
        if (!face) s->status = SHERF_NO_MEMORY;
    }
    return !s->status;
}

static void put_vertex(const shapes *s, shape_mesh *mesh, const float at[3], float u, float v) {
    float c = cosf(s->turn_rad), n = sinf(s->turn_rad);
    float *to = mesh->vertex + 3 * (size_t)mesh->vertices, *uv = mesh->uv + 2 * (size_t)mesh->vertices;
    to[0] = c * at[0] + n * at[2], to[1] = at[1], to[2] = c * at[2] - n * at[0];
    uv[0] = u, uv[1] = v;
    mesh->vertices++;
}

/* A lattice of `across` + 1 vertices per row, the last of them from vertex `first` on. */
static void put_faces(shape_mesh *mesh, int first, int across, int rows) {
    for (int j = 0; j < rows; j++)
        for (int i = 0; i < across; i++) {
            uint32_t at = (uint32_t)(first + j * (across + 1) + i), up = at + (uint32_t)across + 1;
            const uint32_t two[6] = {at, at + 1, up + 1, at, up + 1, up};
            memcpy(mesh->face + 3 * (size_t)mesh->faces, two, sizeof two);
            mesh->faces += 2;
        }
}

static float length3(const float a[3]) {
    return sqrtf(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]);
}

static int parts(float length, float cell_m) {
    int n = (int)ceilf(length / cell_m);
    return n < 1 ? 1 : n < PARTS_MAX ? n : PARTS_MAX;
}

/* ---- bodies ---- */

void shapes_quad(shapes *s, shape_mesh *mesh, const float corner[3], const float a[3], const float b[3],
                 float cell_m) {
    float wide = length3(a), tall = length3(b), repeat = mesh->repeat_m;
    int across = parts(wide, cell_m), rows = parts(tall, cell_m), first = mesh->vertices;
    if (!make_room(s, mesh, (across + 1) * (rows + 1), 2 * across * rows)) return;
    for (int j = 0; j <= rows; j++)
        for (int i = 0; i <= across; i++) {
            float x = (float)i / (float)across, y = (float)j / (float)rows, at[3];
            for (int k = 0; k < 3; k++) at[k] = corner[k] + x * a[k] + y * b[k];
            /* repeat 0: the texture fills the quad once */
            put_vertex(s, mesh, at, repeat > 0 ? x * wide / repeat : x, repeat > 0 ? y * tall / repeat : y);
        }
    put_faces(mesh, first, across, rows);
}

void shapes_box(shapes *s, shape_mesh *mesh, const float foot[3], const float size[3], float turn_rad) {
    float c = cosf(turn_rad), n = sinf(turn_rad);
    const float x[3] = {c * size[0], 0, -n * size[0]}, y[3] = {0, size[1], 0},
                z[3] = {n * size[2], 0, c * size[2]};
    const float minus_x[3] = {-x[0], -x[1], -x[2]}, minus_z[3] = {-z[0], -z[1], -z[2]};
    float low[3], high[3], top[3];
    for (int k = 0; k < 3; k++) {
        low[k] = foot[k] - 0.5f * (x[k] + z[k]);
        high[k] = foot[k] + 0.5f * (x[k] + z[k]);
        top[k] = low[k] + y[k];
    }
    shapes_quad(s, mesh, low, x, y, 0.4f);
    shapes_quad(s, mesh, high, minus_x, y, 0.4f);
    shapes_quad(s, mesh, low, y, z, 0.4f);
    shapes_quad(s, mesh, high, y, minus_z, 0.4f);
    shapes_quad(s, mesh, top, x, z, 0.4f);
    shapes_quad(s, mesh, low, z, x, 0.4f);
}

/* The surface of revolution of rings (radius, height), with a row of vertices for each. */
static void revolve(shapes *s, shape_mesh *mesh, const float foot[3], int rings, const float radius[][2],
                    const float *height) {
    int first = mesh->vertices;
    if (!make_room(s, mesh, rings * (ROUND + 1), 2 * (rings - 1) * ROUND)) return;
    float repeat = mesh->repeat_m > 0 ? mesh->repeat_m : 1;
    for (int j = 0; j < rings; j++)
        for (int i = 0; i <= ROUND; i++) {
            float angle = 2 * (float)M_PI * (float)i / ROUND;
            float at[3] = {foot[0] + radius[j][0] * cosf(angle), foot[1] + height[j],
                           foot[2] + radius[j][1] * sinf(angle)};
            put_vertex(s, mesh, at, angle * (radius[j][0] + 0.05f) / repeat, height[j] / repeat);
        }
    put_faces(mesh, first, ROUND, rings - 1);
}

void shapes_cylinder(shapes *s, shape_mesh *mesh, const float foot[3], float radius_low, float radius_high,
                     float height) {
    enum { CYLINDER_RINGS = 5 };
    float radius[CYLINDER_RINGS][2], at[CYLINDER_RINGS];
    for (int i = 0; i < CYLINDER_RINGS; i++) {
        float t = (float)i / (CYLINDER_RINGS - 1);
        at[i] = t * height;
        radius[i][0] = radius[i][1] = radius_low + t * (radius_high - radius_low);
    }
    revolve(s, mesh, foot, CYLINDER_RINGS, radius, at);
    const float lid[2][2] = {{radius_high, radius_high}, {0.001f, 0.001f}}, level[2] = {height, height};
    revolve(s, mesh, foot, 2, lid, level);
}

void shapes_ball(shapes *s, shape_mesh *mesh, const float middle[3], const float radius[3]) {
    float ring[RINGS + 1][2], at[RINGS + 1];
    for (int i = 0; i <= RINGS; i++) {
        float angle = (float)M_PI * ((float)i / RINGS - 0.5f);
        ring[i][0] = radius[0] * fmaxf(cosf(angle), 0.001f);
        ring[i][1] = radius[2] * fmaxf(cosf(angle), 0.001f);
        at[i] = radius[1] * sinf(angle);
    }
    revolve(s, mesh, middle, RINGS + 1, ring, at);
}

void shapes_cards(shapes *s, shape_mesh *mesh, const float middle[3], const float radius[3], int count,
                  float side, uint64_t key) {
    const float repeat = mesh->repeat_m;
    mesh->repeat_m = 0;
    for (int i = 0; i < count; i++) {
        uint64_t at = 16 * (uint64_t)i;
        float turn = (float)(2 * M_PI * random_uniform(key, at)),
              tilt = (float)random_normal(key, at + 4) * 0.6f;
        float d[3], length, corner[3], own = side * (float)(0.7 + 0.6 * random_uniform(key, at + 1));
        for (uint64_t k = 0; k < 3; k++) d[k] = (float)random_normal(key, at + 5 + k);
        length = length3(d) + 1e-6f;
        float out = (float)cbrt(0.15 + 0.85 * random_uniform(key, at + 2)) / length;
        const float a[3] = {own * cosf(turn), 0, own * sinf(turn)};
        const float b[3] = {-own * sinf(tilt) * sinf(turn), own * cosf(tilt), own * sinf(tilt) * cosf(turn)};
        for (int k = 0; k < 3; k++) corner[k] = middle[k] + out * radius[k] * d[k] - 0.5f * (a[k] + b[k]);
        shapes_quad(s, mesh, corner, a, b, own);
    }
    mesh->repeat_m = repeat;
}
