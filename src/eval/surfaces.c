/* Nearest places on triangles by Embree's point queries, and their means. */
#include "eval/surfaces.h"

#include <embree3/rtcore.h>
#include <math.h>
#include <string.h>

#include "base/vector3.h"

typedef struct {
    RTCDevice device;
    RTCScene scene;
    int meshes;
    const solid_mesh *mesh;
} tree;

static void tree_free(tree *t) {
    if (t->scene) rtcReleaseScene(t->scene);
    if (t->device) rtcReleaseDevice(t->device);
}

static sherf_status tree_check(context *c, const tree *t, const char *what) {
    const enum RTCError error = rtcGetDeviceError(t->device);
    if (error == RTC_ERROR_NONE) return SHERF_OK;
    return failure(c, error == RTC_ERROR_OUT_OF_MEMORY ? SHERF_NO_MEMORY : SHERF_UNSUPPORTED,
                   "Embree: %s: error %d", what, (int)error);
}

static void mesh_attach(tree *t, const solid_mesh *mesh) {
    const size_t vertices = (size_t)mesh->vertices, triangles = (size_t)mesh->triangles;
    RTCGeometry g = rtcNewGeometry(t->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    float *vertex =
        rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float), vertices);
    uint32_t *corner = rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                               3 * sizeof(uint32_t), triangles);
    if (vertex) memcpy(vertex, mesh->vertex, 3 * vertices * sizeof *vertex);
    if (corner) memcpy(corner, mesh->triangle, 3 * triangles * sizeof *corner);
    rtcCommitGeometry(g);
    rtcAttachGeometry(t->scene, g);
    rtcReleaseGeometry(g);
}

static sherf_status tree_create(context *c, int meshes, const solid_mesh *mesh, tree *out) {
    *out = (tree){.meshes = meshes, .mesh = mesh};
    out->device = rtcNewDevice("threads=1,set_affinity=0");
    if (!out->device) return failure(c, SHERF_UNSUPPORTED, "Embree does not start");
    out->scene = rtcNewScene(out->device);
    for (int i = 0; i < meshes && out->scene; i++) mesh_attach(out, &mesh[i]);
    if (out->scene) rtcCommitScene(out->scene);
    return tree_check(c, out, "a surface");
}

/* ---- the nearest place ---- */
/* The place on a - b that is nearest to p. */
static void nearest_on_edge(const double a[3], const double b[3], const double p[3], double out[3]) {
    double way[3], from[3];
    for (int k = 0; k < 3; k++) way[k] = b[k] - a[k], from[k] = p[k] - a[k];
    const double length = dot3(way, way), at = length > 0 ? fmin(1, fmax(0, dot3(from, way) / length)) : 0;
    for (int k = 0; k < 3; k++) out[k] = a[k] + at * way[k];
}

static double square_distance(const double a[3], const double b[3]) {
    double sum = 0;
    for (int k = 0; k < 3; k++) sum += (a[k] - b[k]) * (a[k] - b[k]);
    return sum;
}

/* The squared distance to a triangle: to its plane if the foot is inside, otherwise to an edge. */
static double triangle_distance(const double v[3][3], const double p[3], double normal[3]) {
    double edge[2][3], from[3], foot[3], least = INFINITY;
    for (int k = 0; k < 3; k++)
        edge[0][k] = v[1][k] - v[0][k], edge[1][k] = v[2][k] - v[0][k], from[k] = p[k] - v[0][k];
    for (int k = 0; k < 3; k++)
        normal[k] = edge[0][(k + 1) % 3] * edge[1][(k + 2) % 3] - edge[0][(k + 2) % 3] * edge[1][(k + 1) % 3];
    const double aa = dot3(edge[0], edge[0]), ab = dot3(edge[0], edge[1]), bb = dot3(edge[1], edge[1]),
                 a = dot3(from, edge[0]), b = dot3(from, edge[1]), area = dot3(normal, normal);
    const double u = area > 0 ? (bb * a - ab * b) / area : -1, w = area > 0 ? (aa * b - ab * a) / area : -1;
    if (u >= 0 && w >= 0 && u + w <= 1) return dot3(from, normal) * dot3(from, normal) / area;
    for (int i = 0; i < 3; i++) {
        nearest_on_edge(v[i], v[(i + 1) % 3], p, foot);
        least = fmin(least, square_distance(p, foot));
    }
    return least;
}

typedef struct {
    const tree *tree;
    double place[3], distance, normal[3];
} nearest;

static bool look(struct RTCPointQueryFunctionArguments *args) {
    nearest *n = args->userPtr;
    const solid_mesh *mesh = &n->tree->mesh[args->geomID];
    const uint32_t *corner = mesh->triangle + 3 * (size_t)args->primID;
    double v[3][3], normal[3];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) v[i][k] = (double)mesh->vertex[3 * (size_t)corner[i] + (size_t)k];
    const double distance = sqrt(triangle_distance(v, n->place, normal));
    if (!(distance < n->distance)) return false;
    n->distance = distance;
    memcpy(n->normal, normal, sizeof normal);
    args->query->radius = nextafterf((float)distance, INFINITY);
    return true;
}

/* ---- means ---- */
/* The places' mean distance to the tree, and the mean angle of normals. */
static void measure(const tree *to, int64_t count, const solid_point *place, double *distance_m,
                    double *angle_deg) {
    *distance_m = *angle_deg = 0;
    for (int64_t i = 0; i < count; i++) {
        nearest n = {.tree = to, .distance = INFINITY};
        struct RTCPointQueryContext how;
        struct RTCPointQuery query = {.x = place[i].position[0],
                                      .y = place[i].position[1],
                                      .z = place[i].position[2],
                                      .radius = INFINITY};
        double own[3];
        for (int k = 0; k < 3; k++)
            n.place[k] = (double)place[i].position[k], own[k] = (double)place[i].normal[k];
        rtcInitPointQueryContext(&how);
        rtcPointQuery(to->scene, &query, &how, look, &n);
        const double length = sqrt(dot3(n.normal, n.normal));
        const double cosine = length > 0 ? dot3(own, n.normal) / length : 0;
        *distance_m += n.distance / (double)count;
        *angle_deg += acos(fmin(1, fmax(-1, cosine))) * 180 / M_PI / (double)count;
    }
}

/* Draws places on the visible part of a surface; *place is mem_free'd, whatever the result. */
static sherf_status places_draw(context *c, int64_t places, uint64_t key, float cell_m, int meshes,
                                const solid_mesh *mesh, solid_point **place, int64_t *found) {
    solid_grid g;
    *place = mem_alloc(c, (size_t)places + 1, sizeof **place);
    if (!*place) return SHERF_NO_MEMORY;
    sherf_status status = solid_grid_create(c, meshes, mesh, cell_m, 0, &g);
    if (status == SHERF_OK) status = solid_points(c, &g, meshes, mesh, key, places, *place, found);
    if (status == SHERF_OK && !*found)
        status = failure(c, SHERF_BAD_ARGUMENT, "nothing of a surface is seen");
    solid_grid_free(&g);
    return status;
}

sherf_status surfaces_compare(context *c, int64_t places, uint64_t key, float cell_m, int meshes,
                              const solid_mesh *prediction, int truth_meshes, const solid_mesh *truth,
                              surface_scores *out) {
    const int count[2] = {meshes, truth_meshes};
    const solid_mesh *const mesh[2] = {prediction, truth};
    solid_point *place[2] = {NULL, NULL};
    tree t[2] = {{0}, {0}};
    int64_t found[2];
    double distance[2], angle[2];
    sherf_status status = SHERF_OK;
    *out = (surface_scores){0};
    if (places < 1) return failure(c, SHERF_BAD_ARGUMENT, "surfaces are compared at one place or more");
    for (int i = 0; i < 2 && status == SHERF_OK; i++) {
        status = places_draw(c, places, random_key(key, "surfaces", (uint64_t)i), cell_m, count[i], mesh[i],
                             &place[i], &found[i]);
        if (status == SHERF_OK) status = tree_create(c, count[i], mesh[i], &t[i]);
    }
    for (int i = 0; i < 2 && status == SHERF_OK; i++)
        measure(&t[1 - i], found[i], place[i], &distance[i], &angle[i]);
    if (status == SHERF_OK)
        *out = (surface_scores){.to_truth_m = distance[0],
                                .from_truth_m = distance[1],
                                .chamfer_m = (distance[0] + distance[1]) / 2,
                                .normal_deg = (angle[0] + angle[1]) / 2};
    for (int i = 0; i < 2; i++) {
        tree_free(&t[i]);
        mem_free(place[i]);
    }
    return status;
}

sherf_status surfaces_overlap(context *c, float cell_m, int meshes, const solid_mesh *prediction,
                              int64_t points, const float *point, const uint8_t *inside, double *out) {
    solid_grid g;
    int64_t both = 0, either = 0;
    *out = 0;
    const sherf_status status = solid_grid_create(c, meshes, prediction, cell_m, 0, &g);
    if (status != SHERF_OK) return status;
    for (int64_t i = 0; i < points; i++) {
        const bool predicted = solid_contains(&g, point + 3 * i);
        both += predicted && inside[i];
        either += predicted || inside[i];
    }
    solid_grid_free(&g);
    *out = either ? (double)both / (double)either : 1;
    return SHERF_OK;
}
