/* Finds what a picture shows of the body in front of its camera, and where the features of the rest are read:
 * at the mirror image, or at the nearest place whose pixel is the body's own (network.md, "What the picture
 * does not show"). With several pictures each vertex is read in one. */
#include <math.h>
#include <string.h>

#include "body/deform_point.h"
#include "scene/scene.h"

/* Vertices this much deeper than the body's first surface are hidden. */
static const float behind_m = 0.02f;
/* A limb this much in front of a vertex covers it. */
static const float before_m = 0.03f;
/* Features are also not read this close to a limb's edge: clothed bodies are wider, and estimated ones are
 * slightly off. */
static const float margin_m = 0.015f;
enum { BESIDE_PX_MAX = 16, APART_MIN = 2 };
/* Smaller connected groups of vertices are not read at their mirror image: the open body has 13380 vertices.
 */
enum { ISLAND_MIN = 64 };

typedef struct {
    const body_model *body;
    const sherf_camera *camera;
    const float *image; /* black outside the person; or NULL */
    float beside_m;
    raster *drawn;
    uint8_t apart[BODY_JOINTS][BODY_JOINTS]; /* number of bones between two joints */
    uint8_t *joint;                          /* V: the heaviest */
    float *uv, *depth;                       /* V x 2, V */
    int32_t *faces;                          /* V: it faces the camera */
    uint8_t *shown;                          /* V */
} shown_job;

static int bones_between(const body_model *body, int a, int b) {
    int bones = 0;
    for (; a != b; bones++) { /* parents have smaller numbers */
        if (a > b)
            a = body->parent[a];
        else
            b = body->parent[b];
    }
    return bones;
}

static void find_parts(shown_job *j) {
    for (int a = 0; a < BODY_JOINTS; a++)
        for (int b = 0; b < BODY_JOINTS; b++) j->apart[a][b] = (uint8_t)bones_between(j->body, a, b);
    for (int64_t v = 0; v < j->body->vertices; v++) {
        const float *w = j->body->weights + v * BODY_JOINTS;
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

/* Whether another limb is in front of the vertex, or next to it in the picture. */
static bool is_covered(const shown_job *j, int64_t v, int x, int y) {
    const raster *r = j->drawn;
    const float px = j->beside_m * j->camera->K[0] / j->depth[v];
    const int reach = px < BESIDE_PX_MAX ? (int)lrintf(px) : BESIDE_PX_MAX;
    const uint8_t *apart = j->apart[j->joint[v]];
    for (int b = y - reach < 0 ? 0 : y - reach; b <= y + reach && b < r->height; b++)
        for (int a = x - reach < 0 ? 0 : x - reach; a <= x + reach && a < r->width; a++) {
            const size_t at = (size_t)b * (size_t)r->width + (size_t)a;
            if (r->face[at] < 0 || r->depth[at] > j->depth[v] - before_m) continue;
            if (apart[j->joint[j->body->face[3 * (size_t)r->face[at]]]] >= APART_MIN) return true;
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

sherf_status body_shown(context *c, const body_model *body, const float *vertices_world,
                        const sherf_camera *camera, const float *image, float beside_m, uint8_t *shown) {
    const size_t V = (size_t)body->vertices;
    shown_job j = {.body = body, .camera = camera, .image = image, .beside_m = beside_m, .shown = shown};
    j.joint = mem_alloc(c, V, sizeof *j.joint);
    j.uv = mem_alloc(c, V, 2 * sizeof *j.uv);
    j.depth = mem_alloc(c, V, sizeof *j.depth);
    j.faces = mem_alloc(c, V, sizeof *j.faces);
    sherf_status status = j.joint && j.uv && j.depth && j.faces ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        find_parts(&j);
        camera_project(camera, (int64_t)V, vertices_world, j.uv, j.depth);
        status = vertices_visible(c, body, vertices_world, camera, j.faces);
    }
    if (status == SHERF_OK)
        status =
            raster_create(c, camera, 1, body->vertices, vertices_world, body->faces, body->face, &j.drawn);
    if (status == SHERF_OK) parallel_for(c, (int64_t)V, 256, look_at, &j);
    raster_free(j.drawn);
    mem_free(j.joint);
    mem_free(j.uv);
    mem_free(j.depth);
    mem_free(j.faces);
    return status;
}

/* ---- which picture shows a vertex best ---- */
enum { PICTURES_MAX = 127, EVEN_ROUNDS = 4 };
/* The picture in which most neighbours are read wins if it shows the vertex at least this well. */
static const float nearly_as_well = 0.5f;

typedef struct {
    const body_model *body;
    int count;
    const body_picture *picture;
    uint8_t *shown; /* count x V, then V: in the picture that is read */
    float *well;    /* count x V: foreshortened pixels a metre of the vertex's surface */
    int8_t *in;     /* V: the picture that v is read in */
    int8_t *room;   /* V */
} choice;

/* Pixels a metre, and the cosine of the angle to the ray. */
static float seen_well(const sherf_camera *camera, const float eye[3], const float at[3],
                       const float normal[3]) {
    float px[2], depth, dot = 0, length = 0;
    camera_project(camera, 1, at, px, &depth);
    for (int k = 0; k < 3; k++) {
        dot += normal[k] * (eye[k] - at[k]);
        length += (eye[k] - at[k]) * (eye[k] - at[k]);
    }
    return depth > 0 ? fabsf(dot) / sqrtf(length) * camera->K[0] / depth : 0;
}

static sherf_status look_at_picture(context *c, choice *j, int k, float *world, float *normal) {
    const size_t V = (size_t)j->body->vertices;
    const body_picture *from = &j->picture[k];
    float eye[3];
    body_vertices_world(j->body, from->body, world);
    sherf_status status =
        body_shown(c, j->body, world, from->camera, from->image, margin_m, j->shown + (size_t)k * V);
    if (status != SHERF_OK || j->count == 1) return status;
    status = body_normals(c, j->body, world, normal);
    camera_position(from->camera, eye);
    for (size_t v = 0; status == SHERF_OK && v < V; v++)
        j->well[(size_t)k * V + v] = seen_well(from->camera, eye, world + 3 * v, normal + 3 * v);
    return status;
}

static bool is_better(const choice *j, size_t v, int a, int b) {
    const size_t V = (size_t)j->body->vertices, of_a = (size_t)a * V + v, of_b = (size_t)b * V + v;
    if (j->shown[of_a] != j->shown[of_b]) return j->shown[of_a] < j->shown[of_b];
    return j->well[of_a] > j->well[of_b];
}

/* The picture in which most vertices around v are read; -1: none beats v's own. */
static int majority(const choice *j, size_t v) {
    int votes[PICTURES_MAX] = {0}, best = -1;
    for (int32_t i = j->body->neighbour_first[v]; i < j->body->neighbour_first[v + 1]; i++) {
        const int k = j->in[j->body->neighbour[i]];
        if (++votes[k] > (best < 0 ? 0 : votes[best])) best = k;
    }
    return best >= 0 && votes[best] > votes[j->in[v]] ? best : -1;
}

/* Shortens the borders between pictures: each picture has its own light, and its own error of the body. */
static void even_out(choice *j) {
    const size_t V = (size_t)j->body->vertices;
    for (int round = 0; round < EVEN_ROUNDS; round++) {
        memcpy(j->room, j->in, V);
        for (size_t v = 0; v < V; v++) {
            const int k = majority(j, v);
            if (k < 0 || j->shown[(size_t)k * V + v] != j->shown[(size_t)j->in[v] * V + v]) continue;
            if (j->well[(size_t)k * V + v] >= nearly_as_well * j->well[(size_t)j->in[v] * V + v])
                j->room[v] = (int8_t)k;
        }
        memcpy(j->in, j->room, V);
    }
}

static sherf_status choose(context *c, choice *j) {
    const size_t V = (size_t)j->body->vertices, n = (size_t)j->count;
    float *world = mem_alloc(c, V, 3 * sizeof *world), *normal = mem_alloc(c, V, 3 * sizeof *normal);
    j->shown = mem_alloc(c, (n + 1) * V, sizeof *j->shown);
    j->well = mem_zero(c, n * V, sizeof *j->well);
    j->in = mem_zero(c, V, 1);
    j->room = mem_alloc(c, V, 1);
    sherf_status status =
        world && normal && j->shown && j->well && j->in && j->room ? SHERF_OK : SHERF_NO_MEMORY;
    for (int k = 0; k < j->count && status == SHERF_OK; k++) status = look_at_picture(c, j, k, world, normal);
    for (size_t v = 0; v < V && status == SHERF_OK; v++)
        for (int k = 1; k < j->count; k++)
            if (is_better(j, v, k, j->in[v])) j->in[v] = (int8_t)k;
    if (status == SHERF_OK && j->count > 1) even_out(j);
    for (size_t v = 0; v < V && status == SHERF_OK; v++)
        j->shown[n * V + v] = j->shown[(size_t)j->in[v] * V + v];
    mem_free(world);
    mem_free(normal);
    return status;
}

static void choice_free(choice *j) {
    mem_free(j->shown);
    mem_free(j->well);
    mem_free(j->in);
    mem_free(j->room);
}

/* ---- where it is read ---- */
typedef struct {
    const body_model *body;
    const body_picture *picture;
    posed_body *p;
    const uint8_t *shown; /* V */
    const int8_t *in;     /* V: the picture */
    int32_t *read;        /* V: the vertex at which v is read, or ~ of it: mirrored */
} read_job;

/* Number of mirrored vertices connected with v, which go into list. met: marks all of them. */
static int32_t island_of(const read_job *j, int32_t v, uint8_t *met, int32_t *list) {
    int32_t count = 0;
    list[count++] = v;
    met[v] = 1;
    for (int32_t i = 0; i < count; i++)
        for (int32_t k = j->body->neighbour_first[list[i]]; k < j->body->neighbour_first[list[i] + 1]; k++) {
            const int32_t other = j->body->neighbour[k];
            if (met[other] || j->read[other] >= 0) continue;
            met[other] = 1;
            list[count++] = other;
        }
    return count;
}

/* A few unseen vertices among seen ones, as next to a nose, would become facets of the other side: they are
 * read like vertices without another side. list: room for all vertices. */
static sherf_status drop_islands(context *c, read_job *j, int32_t *list) {
    uint8_t *met = mem_zero(c, (size_t)j->body->vertices, 1);
    for (int32_t v = 0; met && v < j->body->vertices; v++) {
        if (met[v] || j->read[v] >= 0) continue;
        const int32_t count = island_of(j, v, met, list);
        for (int32_t i = 0; i < count && count < ISLAND_MIN; i++)
            if (j->shown[list[i]] == SHOWN_BEHIND) j->read[list[i]] = list[i];
    }
    mem_free(met);
    return met ? SHERF_OK : SHERF_NO_MEMORY;
}

/* Where each vertex is read: seen ones at themselves; others at their mirror image if that is seen, or
 * straight through the body if their pixel is its own; the rest at the nearest of all these. */
static sherf_status find_places(context *c, read_job *j, bool mirror) {
    const body_model *body = j->body;
    const uint8_t *shown = j->shown;
    vertex_grid *grid = NULL;
    int32_t settled = 0, *index = mem_alloc(c, (size_t)body->vertices, sizeof *index);
    float *place = mem_alloc(c, (size_t)body->vertices, 3 * sizeof *place);
    sherf_status status = index && place ? SHERF_OK : SHERF_NO_MEMORY;
    for (int32_t v = 0; status == SHERF_OK && v < body->vertices; v++) {
        const int32_t other = mirror ? body->mirror[v] : -1;
        const bool mirrored = shown[v] != SHOWN_SEEN && other >= 0 && shown[other] == SHOWN_SEEN;
        j->read[v] = mirrored ? ~other : v;
    }
    if (status == SHERF_OK && mirror) status = drop_islands(c, j, index);
    for (int32_t v = 0; status == SHERF_OK && v < body->vertices; v++) {
        if (j->read[v] >= 0 && shown[v] >= SHOWN_COVERED) continue;
        memcpy(place + 3 * (size_t)settled, body->canonical->vertices_smpl + 3 * (size_t)v,
               3 * sizeof *place);
        index[settled++] = v;
    }
    if (status == SHERF_OK && settled) status = vertex_grid_create(c, settled, place, 0, &grid);
    for (int32_t v = 0; status == SHERF_OK && settled && v < body->vertices; v++) {
        if (j->read[v] < 0 || shown[v] < SHOWN_COVERED) continue;
        const int32_t near = vertex_grid_nearest(grid, body->canonical->vertices_smpl + 3 * (size_t)v, NULL);
        if (near >= 0) j->read[v] = index[near]; /* whose place may itself be mirrored */
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

/* The map of x by `map`, then by `on`. */
static void map_follow(float map[12], const float on[12]) {
    double out[12];
    for (int r = 0; r < 3; r++)
        for (int k = 0; k < 4; k++) {
            out[4 * r + k] = k == 3 ? (double)on[4 * r + 3] : 0;
            for (int i = 0; i < 3; i++) out[4 * r + k] += (double)on[4 * r + i] * (double)map[4 * i + k];
        }
    for (int i = 0; i < 12; i++) map[i] = (float)out[i];
}

static void make_maps(void *arg, int64_t begin, int64_t end, int thread) {
    const read_job *j = arg;
    const body_model *body = j->body;
    const float *at = body->canonical->vertices_smpl;
    for (int64_t v = begin; v < end; v++) {
        float *map = j->p->read_from + 12 * v;
        const int64_t like = j->read[v] >= 0 ? j->read[v] : v, other = j->read[like];
        const int64_t from = other < 0 ? ~other : other;
        const body_picture *in = &j->picture[j->in[from]];
        memcpy(map, in->body->from_canonical + 12 * from, 12 * sizeof *map);
        if (other < 0) map_mirror(map, body->mirror_x_m);
        if (like != v) map_shift(map, at + 3 * v, at + 3 * like);
        if (in->sheet) map_follow(map, in->sheet);
    }
}

static void find_together(void *arg, int64_t begin, int64_t end, int thread) {
    const read_job *j = arg;
    const body_model *body = j->body;
    const float *maps = j->p->read_from;
    for (int64_t v = begin; v < end; v++)
        for (int32_t i = body->neighbour_first[v]; i < body->neighbour_first[v + 1]; i++)
            j->p->together[i] = maps_join(maps + 12 * v, maps + 12 * (size_t)body->neighbour[i],
                                          body->canonical->vertices_smpl + 3 * v);
}

sherf_status body_read_pictures(context *c, const body_model *body, int count, const body_picture *picture,
                                bool mirror, posed_body *p) {
    const size_t V = (size_t)body->vertices;
    choice k = {.body = body, .count = count, .picture = picture};
    read_job j = {body, picture, p, NULL, NULL, mem_alloc(c, V, sizeof *j.read)};
    p->read_from = mem_alloc(c, V, 12 * sizeof *p->read_from);
    p->together = mem_alloc(c, (size_t)body->neighbour_first[V] + 1, sizeof *p->together);
    p->seen = mem_alloc(c, V, sizeof *p->seen);
    const bool room = j.read && p->read_from && p->together && p->seen;
    sherf_status status = room ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = choose(c, &k);
    if (status == SHERF_OK) {
        j.shown = k.shown + (size_t)count * V;
        j.in = k.in;
        status = find_places(c, &j, mirror);
    }
    if (status == SHERF_OK) parallel_for(c, (int64_t)V, 1024, make_maps, &j);
    if (status == SHERF_OK) parallel_for(c, (int64_t)V, 1024, find_together, &j);
    for (size_t v = 0; v < V && status == SHERF_OK; v++) p->seen[v] = j.shown[v] == SHOWN_SEEN;
    choice_free(&k);
    mem_free(j.read);
    return status;
}
