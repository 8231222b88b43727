/* Meshes of the ray tracer: topology, smooth normals, and the points where light is computed. */
#include <stdlib.h>
#include <string.h>

#include "synth/trace/trace_inside.h"

enum { MESH_MAX = 1 << 23 }; /* vertices, faces */

trace_material trace_material_plain(void) {
    return (trace_material){.tint = {1, 1, 1}, .roughness = 1, .cutoff = 0.5f};
}

static sherf_status check_mesh(context *c, const trace_mesh *mesh) {
    int64_t uvs = mesh->uv ? mesh->uvs : 0;
    if (mesh->vertices < 1 || mesh->vertices > MESH_MAX || mesh->faces < 1 || mesh->faces > MESH_MAX ||
        uvs < 0 || uvs > 3 * (int64_t)MESH_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "mesh: %lld vertices, %lld faces, %lld texture coordinates",
                       (long long)mesh->vertices, (long long)mesh->faces, (long long)uvs);
    const uint32_t *uv_of = mesh->face_uv ? mesh->face_uv : mesh->face;
    for (int64_t i = 0; i < 3 * mesh->faces; i++) {
        if (mesh->face[i] >= mesh->vertices)
            return failure(c, SHERF_BAD_ARGUMENT, "mesh: face %lld names vertex %u of %lld", (long long)i / 3,
                           mesh->face[i], (long long)mesh->vertices);
        if (mesh->uv && uv_of[i] >= uvs)
            return failure(c, SHERF_BAD_ARGUMENT, "mesh: face %lld names texture coordinate %u of %lld",
                           (long long)i / 3, uv_of[i], (long long)uvs);
    }
    for (int64_t i = 0; i < 3 * mesh->vertices; i++)
        if (!isfinite(mesh->rest[i]))
            return failure(c, SHERF_BAD_ARGUMENT, "mesh: vertex %lld is not finite", (long long)i / 3);
    for (int64_t i = 0; i < 2 * uvs; i++)
        if (!isfinite(mesh->uv[i]))
            return failure(c, SHERF_BAD_ARGUMENT, "mesh: texture coordinate %lld is not finite",
                           (long long)i / 2);
    return SHERF_OK;
}

typedef struct {
    uint64_t ends; /* the larger vertex in the high half */
    uint32_t corner;
} half_edge;

static int by_ends(const void *a, const void *b) {
    const half_edge *x = a, *y = b;
    if (x->ends != y->ends) return x->ends < y->ends ? -1 : 1;
    return (x->corner > y->corner) - (x->corner < y->corner);
}

static float distance(const float *a, const float *b) {
    float d[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
    return sqrtf(dot3(d, d));
}

static float edge_length(const half_edge *e, const float *rest) {
    return distance(rest + 3 * (e->ends >> 32), rest + 3 * (e->ends & UINT32_MAX));
}

/* The side of a square with the area of two such faces: a strip's long edges are not cut finer than that. */
static float face_size(const scene_mesh *mesh, const float *rest, uint32_t face) {
    const float *p[3];
    float a[3], b[3], n[3];
    for (int k = 0; k < 3; k++) p[k] = rest + 3 * (size_t)mesh->face[3 * (size_t)face + (size_t)k];
    for (int k = 0; k < 3; k++) a[k] = p[1][k] - p[0][k], b[k] = p[2][k] - p[0][k];
    cross3(a, b, n);
    return sqrtf(sqrtf(dot3(n, n)));
}

/* Numbers the edges and chooses into how many parts each is cut: the power of two that is nearest to the
 * spacing. */
static sherf_status find_edges(context *c, scene_mesh *mesh, const float *rest, float spacing_m) {
    size_t n = 3 * (size_t)mesh->faces;
    half_edge *half = mem_alloc(c, n, sizeof *half);
    if (!half) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) {
        uint32_t a = mesh->face[i], b = mesh->face[i % 3 == 2 ? i - 2 : i + 1];
        half[i] = (half_edge){(uint64_t)(a > b ? a : b) << 32 | (a > b ? b : a), (uint32_t)i};
    }
    qsort(half, n, sizeof *half, by_ends);
    mesh->edges = 0;
    for (size_t first = 0, end; first < n; first = end) { /* the half edges [first, end) are one edge */
        float size = edge_length(&half[first], rest);
        for (end = first; end < n && half[end].ends == half[first].ends; end++) {
            float of_face = face_size(mesh, rest, half[end].corner / 3);
            size = of_face < size ? of_face : size;
            mesh->edge[half[end].corner] = (uint32_t)mesh->edges;
        }
        int level = 1;
        while ((float)level * (float)M_SQRT2 < size / spacing_m && level < LIGHT_LEVEL_MAX) level *= 2;
        mesh->edge_level[mesh->edges++] = (uint8_t)level;
    }
    mem_free(half);
    return SHERF_OK;
}

static void number_points(scene_mesh *mesh) {
    uint64_t next = (uint64_t)mesh->vertices;
    for (int64_t e = 0; e < mesh->edges; e++) {
        mesh->edge_first[e] = (uint32_t)next;
        next += (uint64_t)mesh->edge_level[e] - 1;
    }
    for (int64_t f = 0; f < mesh->faces; f++) {
        int level = 1;
        for (int k = 0; k < 3; k++) {
            int l = mesh->edge_level[mesh->edge[3 * f + k]];
            level = l > level ? l : level;
        }
        mesh->face_level[f] = (uint8_t)level;
        mesh->face_first[f] = (uint32_t)next;
        next += (uint64_t)((level - 1) * (level - 2) / 2);
    }
    mesh->points = (int64_t)next; /* at most 2^23 (1 + 3 x 15 + 105): fits 32 bits */
}

static void set_uv(scene_mesh *mesh, const trace_mesh *from) {
    const uint32_t *uv_of = from->face_uv ? from->face_uv : from->face;
    for (int64_t f = 0; f < mesh->faces; f++) {
        float *uv = mesh->corner_uv + 6 * f, a[3], b[3], normal[3];
        for (int k = 0; k < 3; k++)
            memcpy(uv + 2 * k, from->uv + 2 * (size_t)uv_of[3 * f + k], 2 * sizeof *uv);
        const float *p[3];
        for (int k = 0; k < 3; k++) p[k] = from->rest + 3 * (size_t)mesh->face[3 * f + k];
        for (int k = 0; k < 3; k++) a[k] = p[1][k] - p[0][k], b[k] = p[2][k] - p[0][k];
        cross3(a, b, normal);
        float area = sqrtf(dot3(normal, normal));
        float area_uv = fabsf((uv[2] - uv[0]) * (uv[5] - uv[1]) - (uv[4] - uv[0]) * (uv[3] - uv[1]));
        float ratio = area > 0 ? area_uv / area : 0;
        mesh->uv_per_m[f] = ratio < 1e12f ? sqrtf(ratio) : 1e6f;
    }
}

/* A face of a garment with holes that has no hole itself is drawn and casts shadows as if it had no alpha. */
static void find_solid(scene_mesh *mesh) {
    const trace_material *material = &mesh->material;
    float min = material->alpha == TRACE_CUTOUT ? material->cutoff : 0.99f;
    bool opaque = material->alpha == TRACE_OPAQUE || !material->color || !mesh->corner_uv;
    for (int64_t f = 0; f < mesh->faces; f++) {
        float low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
        for (int k = 0; k < 6 && !opaque; k++) {
            float x = mesh->corner_uv[6 * f + k];
            low[k % 2] = x < low[k % 2] ? x : low[k % 2];
            high[k % 2] = x > high[k % 2] ? x : high[k % 2];
        }
        mesh->solid[f] = opaque || texture_min_opacity(material->color, low, high) >= min;
    }
}

sherf_status scene_mesh_create(context *c, const trace_mesh *from, const trace_material *material,
                               float spacing_m, scene_mesh *out) {
    *out = (scene_mesh){.material = *material, .vertices = from->vertices, .faces = from->faces};
    sherf_status status = check_mesh(c, from);
    if (status != SHERF_OK) return status;
    scene_mesh *mesh = out;
    size_t V = (size_t)mesh->vertices, F = (size_t)mesh->faces;
    mesh->face = mem_alloc(c, F, 3 * sizeof *mesh->face);
    mesh->vertex = mem_zero(c, V + 2, 3 * sizeof *mesh->vertex);
    mesh->normal = mem_zero(c, V, 3 * sizeof *mesh->normal);
    mesh->edge = mem_alloc(c, F, 3 * sizeof *mesh->edge);
    mesh->edge_first = mem_alloc(c, 3 * F, sizeof *mesh->edge_first);
    mesh->edge_level = mem_alloc(c, 3 * F, sizeof *mesh->edge_level);
    mesh->face_first = mem_alloc(c, F, sizeof *mesh->face_first);
    mesh->face_level = mem_alloc(c, F, sizeof *mesh->face_level);
    mesh->solid = mem_alloc(c, F, sizeof *mesh->solid);
    mesh->uv_per_m = mem_zero(c, F, sizeof *mesh->uv_per_m);
    if (from->uv) mesh->corner_uv = mem_alloc(c, F, 6 * sizeof *mesh->corner_uv);
    status = SHERF_NO_MEMORY;
    if (!mesh->face || !mesh->vertex || !mesh->normal || !mesh->edge || !mesh->edge_first ||
        !mesh->edge_level || !mesh->face_first || !mesh->face_level || !mesh->solid || !mesh->uv_per_m ||
        (from->uv && !mesh->corner_uv))
        goto fail;
    memcpy(mesh->face, from->face, F * 3 * sizeof *mesh->face);
    if (from->uv) set_uv(mesh, from);
    find_solid(mesh);
    if ((status = find_edges(c, mesh, from->rest, spacing_m))) goto fail;
    number_points(mesh);
    return SHERF_OK;
fail:
    scene_mesh_free(mesh);
    return status;
}

void scene_mesh_free(scene_mesh *mesh) {
    mem_free(mesh->face);
    mem_free(mesh->corner_uv);
    mem_free(mesh->uv_per_m);
    mem_free(mesh->vertex);
    mem_free(mesh->normal);
    mem_free(mesh->edge);
    mem_free(mesh->edge_first);
    mem_free(mesh->edge_level);
    mem_free(mesh->face_first);
    mem_free(mesh->face_level);
    mem_free(mesh->solid);
    *mesh = (scene_mesh){0};
}

/* Vertex normals: the area-weighted mean of the surrounding faces' normals. */
void scene_mesh_pose(scene_mesh *mesh, const float *position) {
    memcpy(mesh->vertex, position, (size_t)mesh->vertices * 3 * sizeof *mesh->vertex);
    memset(mesh->normal, 0, (size_t)mesh->vertices * 3 * sizeof *mesh->normal);
    for (int64_t f = 0; f < mesh->faces; f++) {
        const uint32_t *v = mesh->face + 3 * f;
        const float *p[3];
        float a[3], b[3], n[3];
        for (int k = 0; k < 3; k++) p[k] = mesh->vertex + 3 * (size_t)v[k];
        for (int k = 0; k < 3; k++) a[k] = p[1][k] - p[0][k], b[k] = p[2][k] - p[0][k];
        cross3(a, b, n);
        for (int k = 0; k < 9; k++) mesh->normal[3 * (size_t)v[k / 3] + (size_t)(k % 3)] += n[k % 3];
    }
    for (int64_t i = 0; i < mesh->vertices; i++) unit3(mesh->normal + 3 * i);
}

/* ---- the points where light is computed ----
 * A face of level n has the points (i, j), i + j <= n, at barycentric (n - i - j, i, j) / n. Its corners are
 * vertices and its sides are edges, so faces share them. An edge coarser than the face lends its points, with
 * linear weights: neighbours of different levels agree along their edge. */

static void add_vertex(uint32_t vertex, float weight, light_corner *out) {
    *out =
        (light_corner){.point = vertex, .weight = weight, .vertex = {vertex, vertex, vertex}, .share = {1}};
}

/* Point q of 0 .. level on the edge from `low` to `high`. */
static void add_on_edge(const scene_mesh *mesh, uint32_t edge, uint32_t low, uint32_t high, int q,
                        float weight, light_corner *out) {
    int level = mesh->edge_level[edge];
    if (q == 0 || q == level) {
        add_vertex(q ? high : low, weight, out);
        return;
    }
    float t = (float)q / (float)level;
    *out = (light_corner){.point = mesh->edge_first[edge] + (uint32_t)q - 1,
                          .weight = weight,
                          .vertex = {low, high, low},
                          .share = {1 - t, t},
                          .kind = AT_EDGE,
                          .edge = edge,
                          .i = q};
}

/* `p` of n steps along the side that starts at `corner`. */
static int add_side(const scene_mesh *mesh, uint32_t face, int corner, int p, int n, float weight,
                    light_corner *out) {
    uint32_t edge = mesh->edge[3 * (size_t)face + (size_t)corner];
    uint32_t a = mesh->face[3 * (size_t)face + (size_t)corner];
    uint32_t b = mesh->face[3 * (size_t)face + (size_t)((corner + 1) % 3)];
    int level = mesh->edge_level[edge];
    if (a > b) {
        uint32_t swap = a;
        a = b, b = swap, p = n - p;
    }
    int q = p * level / n, rest = p * level - q * n;
    if (!rest) {
        add_on_edge(mesh, edge, a, b, q, weight, out);
        return 1;
    }
    float share = (float)rest / (float)n;
    add_on_edge(mesh, edge, a, b, q, weight * (1 - share), out);
    add_on_edge(mesh, edge, a, b, q + 1, weight * share, out + 1);
    return 2;
}

static int add_point(const scene_mesh *mesh, uint32_t face, int i, int j, float weight, light_corner *out) {
    int n = mesh->face_level[face], k = n - i - j;
    const uint32_t *v = mesh->face + 3 * (size_t)face;
    if (weight == 0) return 0;
    if (k == n || i == n || j == n) {
        add_vertex(v[k == n ? 0 : i == n ? 1 : 2], weight, out);
        return 1;
    }
    if (j == 0) return add_side(mesh, face, 0, i, n, weight, out);
    if (k == 0) return add_side(mesh, face, 1, j, n, weight, out);
    if (i == 0) return add_side(mesh, face, 2, k, n, weight, out);
    int index = (j - 1) * (2 * n - 2 - j) / 2 + i - 1; /* rows of n - 2, n - 3, ... points */
    *out = (light_corner){.point = mesh->face_first[face] + (uint32_t)index,
                          .weight = weight,
                          .vertex = {v[0], v[1], v[2]},
                          .share = {(float)k / (float)n, (float)i / (float)n, (float)j / (float)n},
                          .kind = AT_FACE,
                          .i = i,
                          .j = j};
    return 1;
}

int light_corners(const scene_mesh *mesh, uint32_t face, const float barycentric[3],
                  light_corner out[LIGHT_CORNERS]) {
    int n = mesh->face_level[face];
    float x = barycentric[1] * (float)n, y = barycentric[2] * (float)n;
    int i = (int)x, j = (int)y, count = 0;
    i = i < 0 ? 0 : i < n ? i : n - 1;
    j = j < 0 ? 0 : j < n ? j : n - 1;
    if (i + j > n - 1) i = n - 1 - j;
    float u = clamp01(x - (float)i), v = clamp01(y - (float)j);
    if (u + v <= 1 || i + j == n - 1) {
        float scale = u + v > 1 ? 1 / (u + v) : 1;
        u *= scale, v *= scale;
        float w = 1 - u - v;
        count += add_point(mesh, face, i, j, w > 0 ? w : 0, out);
        count += add_point(mesh, face, i + 1, j, u, out + count);
        count += add_point(mesh, face, i, j + 1, v, out + count);
    } else {
        count += add_point(mesh, face, i + 1, j + 1, u + v - 1, out);
        count += add_point(mesh, face, i, j + 1, 1 - u, out + count);
        count += add_point(mesh, face, i + 1, j, 1 - v, out + count);
    }
    return count;
}

/* With 2^mesh the largest power of two that divides i, j and n - i - j, exactly two of the three quotients
 * are odd (their sum is even, and they are not all even): the point halves the line on which these two
 * change. */
static int face_parents(const scene_mesh *mesh, uint32_t face, const light_corner *at, light_corner out[4],
                        float *apart_m) {
    int n = mesh->face_level[face], c[3] = {n - at->i - at->j, at->i, at->j};
    int step = (c[0] | c[1] | c[2]) & -(c[0] | c[1] | c[2]), a = c[0] & step ? 0 : 1, b = c[2] & step ? 2 : 1;
    const uint32_t *v = mesh->face + 3 * (size_t)face;
    *apart_m = 2 * (float)step / (float)n *
               distance(mesh->vertex + 3 * (size_t)v[a], mesh->vertex + 3 * (size_t)v[b]);
    c[a] -= step, c[b] += step;
    int count = add_point(mesh, face, c[1], c[2], 0.5f, out);
    c[a] += 2 * step, c[b] -= 2 * step;
    return count + add_point(mesh, face, c[1], c[2], 0.5f, out + count);
}

int light_parents(const scene_mesh *mesh, uint32_t face, const light_corner *at, light_corner out[4],
                  float *apart_m) {
    if (at->kind == AT_FACE) return face_parents(mesh, face, at, out, apart_m);
    const float *low = mesh->vertex + 3 * (size_t)at->vertex[0],
                *high = mesh->vertex + 3 * (size_t)at->vertex[1];
    int step = at->i & -at->i;
    *apart_m = 2 * (float)step / (float)mesh->edge_level[at->edge] * distance(low, high);
    add_on_edge(mesh, at->edge, at->vertex[0], at->vertex[1], at->i - step, 0.5f, out);
    add_on_edge(mesh, at->edge, at->vertex[0], at->vertex[1], at->i + step, 0.5f, out + 1);
    return 2;
}
