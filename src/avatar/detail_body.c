/* What the body's mesh says about a hazy surface: which parts the observation saw, and how deep they can
 * lie. */
#include <math.h>
#include <string.h>

#include "avatar/detail.h"
#include "base/vector3.h"

/* How far a vertex may lie behind the rasterised body: its weight falls from the first number on and is 0 at
 * the second. */
static const float behind_m[2] = {0.02f, 0.04f};
/* Cosines of a vertex' angle to the ray. */
static const float facing[2] = {-0.05f, 0.3f};
static const float blend_m = 0.025f;
/* Depths up to the first number inside the body are haze; from the second on they belong to another limb. */
static const float sunk_m[2] = {0.06f, 0.1f};
/* At an outline that no picture shows, the network's opacity rises too early, outside the true outline, and
 * over more than a large pixel. */
static const detail_firmness of_known = {0.15f, 1}, of_guessed = {0.3f, 1}, of_coarse = {0.25f, 0.9f};
static const float solid_inside = 0.5f;
/* Pixels up to the first of these sizes are fine, those from the second on coarse. */
static const float coarse_m[2] = {0.004f, 0.012f};
/* The outline counts as known while the camera sees the pelvis from about the same direction as an observed
 * camera (cosines of the angle between them) and the joints have moved little (mean, metres). */
static const float beside_observed[2] = {0.77f, 0.98f}, elsewhere_m[2] = {0.01f, 0.06f};
enum { ROUNDS = 4, HOLE_ROUNDS = 6, HEAD = 15 };

/* The body's largest depth in the 3 x 3 pixels round a place; 0 outside the picture. */
static float body_depth(const raster *r, const float px[2]) {
    float max = 0;
    if (!(fabsf(px[0]) < 1e6f && fabsf(px[1]) < 1e6f)) return 0;
    const int x0 = (int)lrintf(px[0]), y0 = (int)lrintf(px[1]);
    for (int y = y0 - 1; y <= y0 + 1; y++)
        for (int x = x0 - 1; x <= x0 + 1; x++)
            if (x >= 0 && y >= 0 && x < r->width && y < r->height)
                max = fmaxf(max, r->depth[(size_t)y * (size_t)r->width + (size_t)x]);
    return max;
}

static float cosine_to(const sherf_camera *camera, const float world[3], const float normal[3]) {
    float at[3], d[3], dn = 0, dd = 0;
    camera_position(camera, at);
    for (int k = 0; k < 3; k++) {
        d[k] = at[k] - world[k];
        dn += d[k] * normal[k];
        dd += d[k] * d[k];
    }
    return dn / sqrtf(dd + 1e-20f);
}

static void spread(const body_model *body, float *seen, float *room) {
    for (int round = 0; round < ROUNDS; round++) {
        for (int v = 0; v < body->vertices; v++) {
            const int32_t first = body->neighbour_first[v], end = body->neighbour_first[v + 1];
            float sum = 0;
            for (int32_t i = first; i < end; i++) sum += seen[body->neighbour[i]];
            room[v] = end > first ? 0.5f * (seen[v] + sum / (float)(end - first)) : seen[v];
        }
        memcpy(seen, room, (size_t)body->vertices * sizeof *seen);
    }
}

static bool of_head(const body_model *body, int v) {
    return body->weights[(size_t)v * BODY_JOINTS + HEAD] > 0.5f;
}

/* Fills the head's holes (mouth, eyes, nostrils, ears) from their surroundings: the maximum within a few
 * edges, then the minimum (a morphological closing). The rest of the body is left alone: it has thin parts,
 * and their far side is not a hole. */
static void close_holes(const body_model *body, float *seen, float *room) {
    for (int round = 0; round < 2 * HOLE_ROUNDS; round++) {
        for (int v = 0; v < body->vertices; v++) {
            room[v] = seen[v];
            for (int32_t i = body->neighbour_first[v]; i < body->neighbour_first[v + 1]; i++) {
                const float other = seen[body->neighbour[i]];
                if (of_head(body, v) && of_head(body, body->neighbour[i]))
                    room[v] = round < HOLE_ROUNDS ? fmaxf(room[v], other) : fminf(room[v], other);
            }
        }
        memcpy(seen, room, (size_t)body->vertices * sizeof *seen);
    }
}

sherf_status detail_see_body(context *c, const body_model *body, const raster *drawn, detail_view *d) {
    const size_t V = (size_t)body->vertices;
    float *world = mem_alloc(c, V, 3 * sizeof *world), *normal = mem_alloc(c, V, 3 * sizeof *normal);
    float *room = mem_alloc(c, V, sizeof *room);
    d->seen = mem_alloc(c, V, sizeof *d->seen);
    sherf_status status = world && normal && room && d->seen ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        body_vertices_world(body, d->posed, world);
        status = body_normals(c, body, world, normal);
    }
    if (status == SHERF_OK) {
        for (size_t v = 0; v < V; v++) {
            float px[2], depth;
            camera_project(&d->camera, 1, world + 3 * v, px, &depth);
            d->seen[v] = detail_rise(cosine_to(&d->camera, world + 3 * v, normal + 3 * v), facing) *
                         (1 - detail_rise(depth - body_depth(drawn, px), behind_m));
            if (!(depth > 0)) d->seen[v] = 0;
        }
        close_holes(body, d->seen, room);
        spread(body, d->seen, room);
    }
    mem_free(world);
    mem_free(normal);
    mem_free(room);
    return status;
}

float detail_seen_near(const detail_view *d, const body_model *body, const float x[3], int32_t v) {
    const float *vertex = body->canonical->vertices_smpl;
    float sum = d->seen[v], weights = 1, own = 0;
    for (int k = 0; k < 3; k++) own += (x[k] - vertex[3 * v + k]) * (x[k] - vertex[3 * v + k]);
    for (int32_t i = body->neighbour_first[v]; i < body->neighbour_first[v + 1]; i++) {
        const int32_t u = body->neighbour[i];
        float other = 0;
        for (int k = 0; k < 3; k++) other += (x[k] - vertex[3 * u + k]) * (x[k] - vertex[3 * u + k]);
        float w = 1 - (other - own) / (blend_m * blend_m);
        if (!(w > 0)) continue;
        w = w < 1 ? w * w : 1;
        sum += w * d->seen[u];
        weights += w;
    }
    return sum / weights;
}

sherf_status detail_draw_body(context *c, const body_model *body, const posed_body *posed,
                              const sherf_camera *camera, raster **out) {
    float *world = mem_alloc(c, (size_t)body->vertices, 3 * sizeof *world);
    *out = NULL;
    if (!world) return SHERF_NO_MEMORY;
    body_vertices_world(body, posed, world);
    const sherf_status status =
        raster_create(c, camera, 1, body->vertices, world, body->faces, body->face, out);
    mem_free(world);
    return status;
}

void detail_bound(const raster *drawn, float *depth) {
    for (size_t n = 0; n < (size_t)drawn->width * (size_t)drawn->height; n++) {
        const float sunk = depth[n] - drawn->depth[n];
        if (sunk > 0) depth[n] -= sunk * (1 - detail_rise(sunk, sunk_m));
    }
}

/* A place in SMPL space, from the pelvis in its own axes. */
static void from_pelvis(const posed_body *posed, const float smpl[3], double out[3]) {
    const float *turn = posed->transform[0];
    for (int k = 0; k < 3; k++) {
        out[k] = 0;
        for (int i = 0; i < 3; i++)
            out[k] += (double)turn[4 * i + k] * ((double)smpl[i] - posed->joints_smpl[0][i]);
    }
}

/* The direction from the pelvis to the camera, in the pelvis' axes. */
static void camera_side(const sherf_camera *camera, const posed_body *posed, double out[3]) {
    float world[3], smpl[3];
    for (int k = 0; k < 3; k++) {
        world[k] = -posed->Th[k];
        for (int i = 0; i < 3; i++) world[k] -= camera->R[3 * i + k] * camera->T_m[i];
    }
    for (int k = 0; k < 3; k++)
        smpl[k] = world[0] * posed->R[k] + world[1] * posed->R[3 + k] + world[2] * posed->R[6 + k];
    from_pelvis(posed, smpl, out);
    unit3(out);
}

/* The mean distance, in metres, that joints move from one pose to the other, relative to the pelvis. */
static float moved_m(const posed_body *a, const posed_body *b) {
    double sum = 0;
    for (int j = 1; j < BODY_JOINTS; j++) {
        double p[3], q[3];
        from_pelvis(a, a->joints_smpl[j], p);
        from_pelvis(b, b->joints_smpl[j], q);
        for (int k = 0; k < 3; k++) q[k] -= p[k];
        sum += sqrt(dot3(q, q));
    }
    return (float)(sum / (BODY_JOINTS - 1));
}

static detail_firmness between(detail_firmness a, detail_firmness b, float share) {
    return (detail_firmness){a.haze + share * (b.haze - a.haze), a.solid + share * (b.solid - a.solid)};
}

detail_firmness detail_firmness_of(const avatar_detail *d, const posed_body *posed,
                                   const sherf_camera *camera) {
    double from[3];
    float known = 0;
    camera_side(camera, posed, from);
    for (int i = 0; i < d->views; i++) {
        const detail_view *v = &d->view[i];
        double observed[3];
        camera_side(&v->camera, v->posed, observed);
        const float as_posed = 1 - detail_rise(moved_m(posed, v->posed), elsewhere_m);
        known = fmaxf(known, as_posed * detail_rise((float)dot3(from, observed), beside_observed));
    }
    const float pixel_m = 1 / fmaxf(detail_px_per_m(camera, posed), 1e-3f);
    return between(between(of_guessed, of_coarse, detail_rise(pixel_m, coarse_m)), of_known, known);
}

typedef struct {
    const raster *drawn;
    detail_firmness firm;
    const float *background;
    sherf_frame *frame;
} firm_job;

/* 0 outside the body and at its outline, 1 a pixel further in. */
static float inside_body(const raster *r, int x, int y) {
    int count = 0;
    for (int j = y - 1; j <= y + 1; j++)
        for (int i = x - 1; i <= x + 1; i++) {
            const int column = i < 0 ? 0 : i < r->width ? i : r->width - 1;
            const int row = j < 0 ? 0 : j < r->height ? j : r->height - 1;
            count += r->face[(size_t)row * (size_t)r->width + (size_t)column] >= 0;
        }
    return fmaxf(0, (float)count / 4.5f - 1);
}

static void firm_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const firm_job *j = arg;
    for (int y = (int)begin; y < (int)end; y++)
        for (int x = 0; x < j->drawn->width; x++) {
            const size_t n = (size_t)y * (size_t)j->drawn->width + (size_t)x;
            float *opacity = j->frame->opacity.data + n, *color = j->frame->color.data + 3 * n;
            if (!(*opacity > 0)) continue;
            const float inside = inside_body(j->drawn, x, y), min = j->firm.haze * (1 - inside),
                        max = j->firm.solid + inside * (solid_inside - j->firm.solid);
            const float share = (*opacity - min) / (max - min);
            const float is = fminf(fmaxf(share, 0), 1);
            for (int k = 0; k < 3; k++) {
                const float own = color[k] - (1 - *opacity) * j->background[k];
                color[k] = fminf(fmaxf(own * (is / *opacity) + (1 - is) * j->background[k], 0), 1);
            }
            *opacity = is;
        }
}

void detail_make_firm(const context *c, const raster *drawn, detail_firmness firm, const float background[3],
                      sherf_frame *frame) {
    firm_job job = {drawn, firm, background, frame};
    parallel_for(c, drawn->height, 8, firm_rows, &job);
}

/* ---- islands ---- */

/* Marks the opaque, unmarked neighbours of place n and appends them to the queue. */
static size_t reach(const sherf_frame *f, size_t n, uint8_t *reached, size_t *queue, size_t end) {
    const int width = f->opacity.width, height = f->opacity.height;
    const int column = (int)(n % (size_t)width), row = (int)(n / (size_t)width);
    for (int y = row - 1; y <= row + 1; y++)
        for (int x = column - 1; x <= column + 1; x++) {
            if (x < 0 || y < 0 || x >= width || y >= height) continue;
            const size_t at = (size_t)y * (size_t)width + (size_t)x;
            if (reached[at] || !(f->opacity.data[at] > 0)) continue;
            reached[at] = 1;
            queue[end++] = at;
        }
    return end;
}

/* Whether pixels beside the body touch the pixel. */
static bool at_outline(const raster *r, int x, int y) {
    for (int j = y > 0 ? y - 1 : 0; j <= y + 1 && j < r->height; j++)
        for (int i = x > 0 ? x - 1 : 0; i <= x + 1 && i < r->width; i++)
            if (r->face[(size_t)j * (size_t)r->width + (size_t)i] < 0) return true;
    return false;
}

sherf_status detail_clear_islands(context *c, const raster *drawn, const float background[3],
                                  sherf_frame *frame) {
    const size_t width = (size_t)drawn->width, count = width * (size_t)drawn->height;
    size_t end = 0;
    bool seen = false;
    uint8_t *reached = mem_zero(c, count, 1);
    size_t *queue = mem_alloc(c, count, sizeof *queue);
    for (int y = 0; y < drawn->height && reached && queue; y++)
        for (int x = 0; x < drawn->width; x++) {
            const size_t n = (size_t)y * width + (size_t)x;
            const bool edge = y == 0 || y + 1 == drawn->height || x == 0 || x + 1 == drawn->width;
            seen |= drawn->face[n] >= 0;
            if (!(frame->opacity.data[n] > 0) || (!edge && drawn->face[n] < 0)) continue;
            reached[n] = 1;
            if (edge || at_outline(drawn, x, y)) queue[end++] = n; /* all others touch only marked pixels */
        }
    for (size_t n = 0; n < end; n++) end = reach(frame, queue[n], reached, queue, end);
    for (size_t n = 0; n < count && seen && reached && queue; n++) {
        if (reached[n] || !(frame->opacity.data[n] > 0)) continue;
        frame->opacity.data[n] = 0;
        memcpy(frame->color.data + 3 * n, background, 3 * sizeof *background);
    }
    const sherf_status status = reached && queue ? SHERF_OK : SHERF_NO_MEMORY;
    mem_free(reached);
    mem_free(queue);
    return status;
}
