/* What a picture shows of the body before its camera, and where features of the rest are read: at the mirror
 * image, or at the next place whose pixel is the body's own (network.md, "What the picture does not show").
 */
#include <math.h>
#include <string.h>

#include "scene/scene.h"

/* What lies deeper than that behind the body's first surface is hidden. */
static const float behind_m = 0.02f;
/* A limb this much before a vertex covers it. */
static const float before_m = 0.03f;
/* Features are not read this close beside a limb either: bodies are wider in their clothes, and estimated
 * ones are not quite where the person is. */
static const float margin_m = 0.015f;
enum { BESIDE_PX_MAX = 16, APART_MIN = 2 };

typedef struct {
    const body_model *m;
    const sherf_camera *camera;
    const float *image; /* black outside the person; or NULL */
    float beside_m;
    raster *drawn;
    uint8_t apart[BODY_JOINTS][BODY_JOINTS]; /* how many bones lie between two joints */
    uint8_t *joint;                          /* V: the heaviest */
    float *uv, *depth;                       /* V x 2, V */
    int32_t *faces;                          /* V: it faces the camera */
    uint8_t *shown;                          /* V */
} shown_job;

static int bones_between(const body_model *m, int a, int b) {
    int bones = 0;
    for (; a != b; bones++) { /* parents have smaller numbers */
        if (a > b)
            a = m->parent[a];
        else
            b = m->parent[b];
    }
    return bones;
}

static void find_parts(shown_job *j) {
    for (int a = 0; a < BODY_JOINTS; a++)
        for (int b = 0; b < BODY_JOINTS; b++) j->apart[a][b] = (uint8_t)bones_between(j->m, a, b);
    for (int64_t v = 0; v < j->m->vertices; v++) {
        const float *w = j->m->weights + v * BODY_JOINTS;
        int heaviest = 0;
        for (int k = 1; k < BODY_JOINTS; k++)
            if (w[k] > w[heaviest]) heaviest = k;
        j->joint[v] = (uint8_t)heaviest;
    }
}

/* The vertex's pixel; false outside the picture. */
static bool pixel_of(const shown_job *j, int64_t v, int *x, int *y) {
    const float *uv = j->uv + 2 * v;
    if (!(j->depth[v] > 0 && uv[0] > -0.5f && uv[1] > -0.5f && uv[0] < (float)j->drawn->width - 0.5f &&
          uv[1] < (float)j->drawn->height - 0.5f))
        return false;
    *x = (int)lrintf(uv[0]);
    *y = (int)lrintf(uv[1]);
    return *x < j->drawn->width && *y < j->drawn->height;
}

/* Whether another limb lies before the vertex, or next to it in the picture. */
static bool is_covered(const shown_job *j, int64_t v, int x, int y) {
    const raster *r = j->drawn;
    const float px = j->beside_m * j->camera->K[0] / j->depth[v];
    const int reach = px < BESIDE_PX_MAX ? (int)lrintf(px) : BESIDE_PX_MAX;
    const uint8_t *apart = j->apart[j->joint[v]];
    for (int b = y - reach < 0 ? 0 : y - reach; b <= y + reach && b < r->height; b++)
        for (int a = x - reach < 0 ? 0 : x - reach; a <= x + reach && a < r->width; a++) {
            const size_t at = (size_t)b * (size_t)r->width + (size_t)a;
            if (r->face[at] < 0 || r->depth[at] > j->depth[v] - before_m) continue;
            if (apart[j->joint[j->m->face[3 * (size_t)r->face[at]]]] >= APART_MIN) return true;
        }
    return false;
}

static bool is_black(const shown_job *j, int x, int y) {
    if (!j->image) return false;
    const float *rgb = j->image + 3 * ((size_t)y * (size_t)j->drawn->width + (size_t)x);
    return rgb[0] == 0 && rgb[1] == 0 && rgb[2] == 0;
}

static int shown_of(const shown_job *j, int64_t v) {
    int x, y;
    if (!pixel_of(j, v, &x, &y) || is_black(j, x, y)) return SHOWN_OUTSIDE;
    if (is_covered(j, v, x, y)) return SHOWN_COVERED;
    const float first = j->drawn->depth[(size_t)y * (size_t)j->drawn->width + (size_t)x];
    return j->faces[v] && j->depth[v] <= first + behind_m ? SHOWN_SEEN : SHOWN_BEHIND;
}

static void look_at(void *arg, int64_t begin, int64_t end, int thread) {
    const shown_job *j = arg;
    for (int64_t v = begin; v < end; v++) j->shown[v] = (uint8_t)shown_of(j, v);
}

sherf_status body_shown(context *c, const body_model *m, const float *vertices_world,
                        const sherf_camera *camera, const float *image, float beside_m, uint8_t *shown) {
    const size_t V = (size_t)m->vertices;
    shown_job j = {.m = m, .camera = camera, .image = image, .beside_m = beside_m, .shown = shown};
    j.joint = mem_alloc(c, V, sizeof *j.joint);
    j.uv = mem_alloc(c, V, 2 * sizeof *j.uv);
    j.depth = mem_alloc(c, V, sizeof *j.depth);
    j.faces = mem_alloc(c, V, sizeof *j.faces);
    sherf_status status = j.joint && j.uv && j.depth && j.faces ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        find_parts(&j);
        camera_project(camera, (int64_t)V, vertices_world, j.uv, j.depth);
        status = vertices_visible(c, m, vertices_world, camera, j.faces);
    }
    if (status == SHERF_OK)
        status = raster_create(c, camera, 1, m->vertices, vertices_world, m->faces, m->face, &j.drawn);
    if (status == SHERF_OK) parallel_for(c, (int64_t)V, 256, look_at, &j);
    raster_free(j.drawn);
    mem_free(j.joint);
    mem_free(j.uv);
    mem_free(j.depth);
    mem_free(j.faces);
    return status;
}

/* ---- where it is read ---- */
typedef struct {
    const body_model *m;
    posed_body *p;
    const uint8_t *shown; /* V */
    int32_t *read;        /* V: the vertex beside which v is read, or ~ of it: mirrored */
} read_job;

/* Who is read where: seen vertices at themselves, others at their mirror image if that is seen, or straight
 * through the body if their pixel is its own. The rest as the nearest of all these. */
static sherf_status find_places(context *c, read_job *j, bool mirror) {
    const body_model *m = j->m;
    const uint8_t *shown = j->shown;
    vertex_grid *grid = NULL;
    int32_t settled = 0, *index = mem_alloc(c, (size_t)m->vertices, sizeof *index);
    float *place = mem_alloc(c, (size_t)m->vertices, 3 * sizeof *place);
    sherf_status status = index && place ? SHERF_OK : SHERF_NO_MEMORY;
    for (int32_t v = 0; status == SHERF_OK && v < m->vertices; v++) {
        const int32_t other = mirror ? m->mirror[v] : -1;
        const bool mirrored = shown[v] != SHOWN_SEEN && other >= 0 && shown[other] == SHOWN_SEEN;
        j->read[v] = mirrored ? ~other : v;
        if (!mirrored && shown[v] >= SHOWN_COVERED) continue;
        memcpy(place + 3 * (size_t)settled, m->canonical->vertices_smpl + 3 * (size_t)v, 3 * sizeof *place);
        index[settled++] = v;
    }
    if (status == SHERF_OK && settled) status = vertex_grid_create(c, settled, place, 0, &grid);
    for (int32_t v = 0; status == SHERF_OK && settled && v < m->vertices; v++) {
        if (j->read[v] < 0 || shown[v] < SHOWN_COVERED) continue;
        const int32_t near = vertex_grid_nearest(grid, m->canonical->vertices_smpl + 3 * (size_t)v, NULL);
        if (near >= 0) j->read[v] = index[near]; /* whose own place may be a mirrored one */
    }
    vertex_grid_free(grid);
    mem_free(index);
    mem_free(place);
    return status;
}

/* The map of x's mirror image at the plane x = middle. */
static void map_mirror(float map[12], float middle) {
    for (int r = 0; r < 3; r++) {
        map[4 * r + 3] = (float)(map[4 * r + 3] + 2.0 * (double)middle * map[4 * r]);
        map[4 * r] = -map[4 * r];
    }
}

/* The map of x + to - from. */
static void map_shift(float map[12], const float from[3], const float to[3]) {
    for (int r = 0; r < 3; r++) {
        double by = map[4 * r + 3];
        for (int k = 0; k < 3; k++) by += (double)map[4 * r + k] * (to[k] - from[k]);
        map[4 * r + 3] = (float)by;
    }
}

static void make_maps(void *arg, int64_t begin, int64_t end, int thread) {
    const read_job *j = arg;
    const body_model *m = j->m;
    const float *at = m->canonical->vertices_smpl;
    for (int64_t v = begin; v < end; v++) {
        float *map = j->p->read_from + 12 * v;
        const int64_t like = j->read[v] >= 0 ? j->read[v] : v, other = j->read[like];
        memcpy(map, j->p->from_canonical + 12 * (other < 0 ? ~other : other), 12 * sizeof *map);
        if (other < 0) map_mirror(map, m->mirror_x_m);
        if (like != v) map_shift(map, at + 3 * v, at + 3 * like);
    }
}

sherf_status body_read_picture(context *c, const body_model *m, const sherf_camera *camera,
                               const float *image, bool mirror, posed_body *p) {
    const size_t V = (size_t)m->vertices;
    uint8_t *shown = mem_alloc(c, V, sizeof *shown);
    float *world = mem_alloc(c, V, 3 * sizeof *world);
    read_job j = {m, p, shown, mem_alloc(c, V, sizeof *j.read)};
    p->read_from = mem_alloc(c, V, 12 * sizeof *p->read_from);
    p->seen = mem_alloc(c, V, sizeof *p->seen);
    sherf_status status = shown && world && j.read && p->read_from && p->seen ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        body_vertices_world(m, p, world);
        status = body_shown(c, m, world, camera, image, margin_m, shown);
    }
    if (status == SHERF_OK) status = find_places(c, &j, mirror);
    if (status == SHERF_OK) parallel_for(c, (int64_t)V, 1024, make_maps, &j);
    for (size_t v = 0; v < V && status == SHERF_OK; v++) p->seen[v] = shown[v] == SHOWN_SEEN;
    mem_free(shown);
    mem_free(world);
    mem_free(j.read);
    return status;
}
