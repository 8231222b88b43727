/* The picture's own detail in frames. The network's colours are soft; what its picture of the observed view
 * lacks against the observation is kept once per avatar and given back to frames where they show a surface
 * that the observation saw: each pixel's expected surface point goes to the observation's space, as samples
 * do, and is looked up there. Beyond the paper; the network is not asked, so it costs a point a pixel. */
#include <math.h>
#include <string.h>

#include "model/detail.h"

/* How far behind the observed view's surface a point may lie, and how far apart neighbours' depths may be:
 * from the first number on it counts less, at the second not at all. Where the surface is hazy expected
 * depths are further off, and specks stand there; wider bounds let more through to the hidden side. */
static const float hidden_m[2] = {0.012f, 0.035f}, jump_m[2] = {0.03f, 0.07f};
/* Cosine of the observed surface's angle to the ray, and opacity. */
static const float facing[2] = {0.15f, 0.5f}, opaque[2] = {0.7f, 0.95f};
enum { BATCH = 256 };

/* 0 up to low, 1 from high on. */
static float rise(float x, const float edge[2]) {
    const float t = fminf(fmaxf((x - edge[0]) / (edge[1] - edge[0]), 0), 1);
    return t * t * (3 - 2 * t);
}

/* World points of a picture's depths; t along rays whose z_camera is 1. */
static void surface_point(const ray_bundle *r, const sherf_image *depth, size_t n, float out[3]) {
    for (size_t k = 0; k < 3; k++) out[k] = r->origin_world[k] + depth->data[n] * r->direction[3 * n + k];
}

/* The largest step of depth to a neighbour in the picture. */
static float jump_at(const sherf_image *depth, int x, int y) {
    const size_t w = (size_t)depth->width, n = (size_t)y * w + (size_t)x;
    const float *d = depth->data;
    float most = 0;
    if (x > 0) most = fmaxf(most, fabsf(d[n] - d[n - 1]));
    if (y > 0) most = fmaxf(most, fabsf(d[n] - d[n - w]));
    if (x + 1 < depth->width) most = fmaxf(most, fabsf(d[n] - d[n + 1]));
    if (y + 1 < depth->height) most = fmaxf(most, fabsf(d[n] - d[n + w]));
    return most;
}

/* ---- once per avatar ---- */
static float facing_at(const ray_bundle *r, const sherf_image *depth, int x, int y) {
    const size_t w = (size_t)depth->width, n = (size_t)y * w + (size_t)x;
    float p[4][3], u[3], v[3];
    if (x < 1 || y < 1 || x + 1 >= depth->width || y + 1 >= depth->height) return 0;
    surface_point(r, depth, n - 1, p[0]);
    surface_point(r, depth, n + 1, p[1]);
    surface_point(r, depth, n - w, p[2]);
    surface_point(r, depth, n + w, p[3]);
    for (int k = 0; k < 3; k++) u[k] = p[1][k] - p[0][k], v[k] = p[3][k] - p[2][k];
    const float *d = r->direction + 3 * n;
    const float m[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
    const float mm = m[0] * m[0] + m[1] * m[1] + m[2] * m[2], dd = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    return fabsf(m[0] * d[0] + m[1] * d[1] + m[2] * d[2]) / sqrtf(mm * dd + 1e-30f);
}

/* The smallest value in a square of 2 r + 1, then the mean of one: edges fade inwards and hold none back. */
static void fade_inwards(float *weight, float *room, int width, int height, int r) {
    for (int pass = 0; pass < 4; pass++) {
        const bool across = pass % 2 == 0, least = pass < 2;
        for (int y = 0; y < height; y++)
            for (int x = 0; x < width; x++) {
                float low = INFINITY, sum = 0;
                for (int i = -r; i <= r; i++) {
                    const int px = across ? x + i : x, py = across ? y : y + i;
                    const bool inside = px >= 0 && py >= 0 && px < width && py < height;
                    const float value = inside ? weight[(size_t)py * (size_t)width + (size_t)px] : 0;
                    low = fminf(low, value);
                    sum += value;
                }
                room[(size_t)y * (size_t)width + (size_t)x] = least ? low : sum / (float)(2 * r + 1);
            }
        memcpy(weight, room, (size_t)width * (size_t)height * sizeof *weight);
    }
}

static void keep_difference(avatar_detail *d, const sherf_avatar *a, const ray_bundle *r,
                            const sherf_frame *own, float *room) {
    const int width = d->width, height = d->height;
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            const size_t n = (size_t)y * (size_t)width + (size_t)x;
            const float jump = jump_at(&own->depth, x, y);
            float w = 0;
            if (jump < jump_m[1] && own->opacity.data[n] > opaque[0])
                w = rise(own->opacity.data[n], opaque) * (1 - rise(jump, jump_m)) *
                    rise(facing_at(r, &own->depth, x, y), facing);
            d->texel[n].weight = w;
        }
    float *weight = room + (size_t)width * (size_t)height;
    for (size_t n = 0; n < (size_t)width * (size_t)height; n++) weight[n] = d->texel[n].weight;
    fade_inwards(weight, room, width, height, 1);
    for (size_t n = 0; n < (size_t)width * (size_t)height; n++) {
        d->texel[n].weight = weight[n];
        d->texel[n].depth = own->depth.data[n];
        for (size_t k = 0; k < 3; k++)
            d->texel[n].difference[k] = a->bank.image[3 * n + k] - own->color.data[3 * n + k];
    }
}

void detail_free(avatar_detail *d) {
    mem_free(d->texel);
    *d = (avatar_detail){0};
}

sherf_status detail_create(context *c, const sherf_avatar *a, const body_model *body, avatar_detail *out) {
    const sherf_render_options plain = {.detail = SHERF_DETAIL_OFF};
    const size_t n = (size_t)a->bank.image_width * (size_t)a->bank.image_height;
    sherf_frame own = {0};
    posed_body *posed = NULL;
    ray_bundle *rays = NULL;
    float min[3], max[3], *room = NULL;
    *out = (avatar_detail){.width = a->bank.image_width, .height = a->bank.image_height};
    sherf_status status = avatar_pose(c, a, body, &a->pose, &posed);
    if (status == SHERF_OK) status = avatar_render(c, a, body, posed, &a->camera, &plain, &own);
    if (status == SHERF_OK) {
        body_world_box(body, a->observed, min, max);
        status = rays_create(c, &a->camera, min, max, &rays);
    }
    if (status == SHERF_OK) {
        out->texel = mem_alloc(c, n, sizeof *out->texel);
        room = mem_alloc(c, 2 * n, sizeof *room);
        if (!out->texel || !room) status = SHERF_NO_MEMORY;
    }
    if (status == SHERF_OK) keep_difference(out, a, rays, &own, room);
    mem_free(room);
    rays_free(rays);
    posed_body_free(posed);
    sherf_frame_free(&own);
    if (status != SHERF_OK) detail_free(out);
    return status;
}

/* ---- once per frame ---- */
typedef struct {
    const sherf_avatar *a;
    const avatar_detail *d;
    const body_model *m;
    const posed_body *posed;
    const ray_bundle *rays;
    sherf_frame *frame;
} apply_job;

/* The pixels of a batch, and where they are. */
typedef struct {
    int count;
    size_t pixel[BATCH];
    float weight[BATCH], point[3 * BATCH], px[2 * BATCH], depth[BATCH];
    int32_t nearest[BATCH];
} batch;

/* What the observation adds at px to a point at this depth: the mean over four texels that see it. */
static void look_up(const avatar_detail *d, const float px[2], float depth, float out[3]) {
    memset(out, 0, 3 * sizeof *out);
    if (!(px[0] >= 0 && px[1] >= 0 && px[0] < (float)(d->width - 1) && px[1] < (float)(d->height - 1)))
        return;
    const int x = (int)px[0], y = (int)px[1];
    const float fx = px[0] - (float)x, fy = px[1] - (float)y;
    for (int i = 0; i < 4; i++) {
        const detail_texel *t = d->texel + (size_t)(y + i / 2) * (size_t)d->width + (size_t)(x + i % 2);
        const float share = (i % 2 ? fx : 1 - fx) * (i / 2 ? fy : 1 - fy);
        if (!(t->weight > 0)) continue;
        const float w = share * t->weight * (1 - rise(depth - t->depth, hidden_m));
        for (int k = 0; k < 3; k++) out[k] += w * t->difference[k];
    }
}

static void give_back(const apply_job *j, batch *b) {
    deform_to_canonical(j->m, j->posed, b->count, b->point, NULL, b->nearest, b->point, NULL);
    for (int i = 0; i < b->count; i++)
        b->nearest[i] =
            vertex_grid_nearest_from(body_canonical_grid(j->m), b->point + 3 * i, b->nearest[i], NULL);
    deform_from_canonical(j->m, j->a->observed, b->count, b->point, b->nearest, b->point);
    camera_project(&j->a->camera, b->count, b->point, b->px, b->depth);
    for (int i = 0; i < b->count; i++) {
        float *color = j->frame->color.data + 3 * b->pixel[i], add[3];
        if (!(b->depth[i] > 0)) continue;
        look_up(j->d, b->px + 2 * i, b->depth[i], add);
        for (int k = 0; k < 3; k++) color[k] = fminf(fmaxf(color[k] + b->weight[i] * add[k], 0), 1);
    }
    b->count = 0;
}

static void apply_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const apply_job *j = arg;
    const float *R = j->posed->R, *Th = j->posed->Th;
    const int width = j->frame->color.width;
    batch b = {0};
    int32_t guess = -1;
    for (int y = (int)begin; y < (int)end; y++)
        for (int x = 0; x < width; x++) {
            const size_t n = (size_t)y * (size_t)width + (size_t)x;
            const float opacity = j->frame->opacity.data[n];
            if (!(opacity > opaque[0])) continue;
            const float jump = jump_at(&j->frame->depth, x, y);
            if (!(jump < jump_m[1])) continue;
            float p[3], *s = b.point + 3 * b.count;
            surface_point(j->rays, &j->frame->depth, n, p);
            for (int k = 0; k < 3; k++) p[k] -= Th[k];
            for (int k = 0; k < 3; k++) s[k] = p[0] * R[k] + p[1] * R[3 + k] + p[2] * R[6 + k];
            const int32_t found = vertex_grid_nearest_from(j->posed->near, s, guess, NULL);
            if (found < 0) continue;
            b.nearest[b.count] = guess = found;
            b.pixel[b.count] = n;
            b.weight[b.count] = rise(opacity, opaque) * (1 - rise(jump, jump_m));
            if (++b.count == BATCH) give_back(j, &b);
        }
    if (b.count) give_back(j, &b);
}

void detail_apply(context *c, const sherf_avatar *a, const avatar_detail *d, const body_model *m,
                  const posed_body *posed, const ray_bundle *rays, sherf_frame *frame) {
    apply_job job = {a, d, m, posed, rays, frame};
    if (d->texel) parallel_for(c, frame->color.height, 8, apply_rows, &job);
}
