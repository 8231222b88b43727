/* The picture's own detail. The network's colours are soft; the difference between the observation and the
 * avatar's own picture of that view is kept once per avatar. Frames and exported surfaces add it wherever
 * they show what the observation saw: a point is mapped to the observation's space, as samples are, and
 * looked up there. Unseen places borrow colour and pattern from the opposite side (detail_carry.c). This goes
 * beyond the paper. It does not query the network; the cost is one point per pixel.
 *
 * Two sources say what the observation saw. The body's mesh gives a smooth answer without haze: it separates
 * front from back and limbs that overlap. The smoothed depths of the observed view answer for the rest: hair,
 * clothes. Depths of either view must not lie inside the body (detail_body.c): where haze lets rays in, one
 * place would have two depths, and the look-up would be displaced. */
#include <math.h>
#include <string.h>

#include "avatar/detail.h"

/* Cosines of the surface's angle to the ray. */
static const float facing[2] = {0.1f, 0.45f};
static const float smooth_m = 0.01f, fade_m = 0.006f;
enum { RADIUS_MAX = 8, FADE_MAX = 4 };

/* ---- from the avatar's own picture of the observed view ---- */
static float facing_at(const detail_optics *o, const float *depth, int width, int height, int x, int y) {
    float p[5][3], u[3], v[3];
    if (x < 1 || y < 1 || x + 1 >= width || y + 1 >= height) return 0;
    for (int i = 0; i < 5; i++) {
        const int px = x + (i == 1) - (i == 0), py = y + (i == 3) - (i == 2);
        detail_point(o, px, py, depth[(size_t)py * (size_t)width + (size_t)px], p[i]);
    }
    for (int k = 0; k < 3; k++) u[k] = p[1][k] - p[0][k], v[k] = p[3][k] - p[2][k];
    const float d[3] = {p[4][0] - o->origin[0], p[4][1] - o->origin[1], p[4][2] - o->origin[2]};
    const float n[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
    const float nn = n[0] * n[0] + n[1] * n[1] + n[2] * n[2], dd = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    return fabsf(n[0] * d[0] + n[1] * d[1] + n[2] * d[2]) / sqrtf(nn * dd + 1e-30f);
}

/* The minimum over squares of side 2 r + 1, then the mean over them: the result fades to 0 inside the edge,
 * not beyond it. */
static void fade_inwards(float *weight, float *room, int width, int height, int r) {
    for (int pass = 0; pass < 4; pass++) {
        const bool across = pass % 2 == 0, min = pass < 2;
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
                room[(size_t)y * (size_t)width + (size_t)x] = min ? low : sum / (float)(2 * r + 1);
            }
        memcpy(weight, room, (size_t)width * (size_t)height * sizeof *weight);
    }
}

/* Whether a pixel lies outside the mask, where the picture is black, or at its edge, where it is mixed with
 * black. */
static bool at_mask_edge(const float *image, int width, int height, int x, int y) {
    enum { STRAIGHT_EDGE = 3 };
    int black = 0;
    for (int j = y > 0 ? y - 1 : 0; j <= y + 1 && j < height; j++)
        for (int i = x > 0 ? x - 1 : 0; i <= x + 1 && i < width; i++) {
            const float *p = image + 3 * ((size_t)j * (size_t)width + (size_t)i);
            black += !(p[0] > 0 || p[1] > 0 || p[2] > 0);
        }
    return black >= STRAIGHT_EDGE;
}

/* room: two floats per texel. */
static void keep_difference(const context *c, detail_view *d, const float *image, sherf_frame *own,
                            float *room) {
    const int width = d->width, height = d->height;
    const int reach = detail_pixels(&d->camera, d->posed, 0.004f, FADE_MAX);
    const size_t pixels = (size_t)width * (size_t)height;
    float *weight = room + pixels, *depth = own->depth.data;
    detail_optics o;
    detail_optics_of(&d->camera, &o);
    detail_smooth(c, &own->opacity, detail_pixels(&d->camera, d->posed, smooth_m, RADIUS_MAX), depth, NULL,
                  room);
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            const size_t n = (size_t)y * (size_t)width + (size_t)x;
            weight[n] = detail_solid(own->opacity.data[n], detail_jump(depth, width, height, reach, x, y)) *
                        detail_rise(facing_at(&o, depth, width, height, x, y), facing);
            if (weight[n] > 0 && at_mask_edge(image, width, height, x, y)) weight[n] = 0;
        }
    fade_inwards(weight, room, width, height, detail_pixels(&d->camera, d->posed, fade_m, FADE_MAX));
    for (size_t n = 0; n < pixels; n++) {
        d->texel[n].weight = weight[n];
        d->texel[n].depth = depth[n];
        for (size_t k = 0; k < 3; k++)
            d->texel[n].difference[k] = image[3 * n + k] - own->color.data[3 * n + k];
    }
}

void detail_free(avatar_detail *d) {
    for (int i = 0; i < d->views; i++) {
        mem_free(d->view[i].texel);
        mem_free(d->view[i].seen);
        mem_free(d->view[i].patterned);
    }
    carry_free(&d->carry);
    *d = (avatar_detail){0};
}

/* The body in the pose of picture i, counted from 0. Owned by the avatar. */
static const posed_body *posed_in(const sherf_avatar *a, int picture) {
    return a->pictures > 1 ? a->posed[picture] : a->sheet.body;
}

/* The observation's picture i that is compared: its image, or the finer picture behind it. */
static float *picture_of(context *c, const sherf_avatar *a, int i, detail_view *d) {
    const observed_picture *p = &a->picture[i];
    const fine_picture *fine = &a->fine[i];
    *d = (detail_view){p->image.width, p->image.height, p->camera, posed_in(a, i)};
    if (fine->data) {
        d->width = fine->width;
        d->height = fine->height;
        camera_resize(&d->camera, d->width, d->height);
    }
    const size_t n = (size_t)d->width * (size_t)d->height * 3;
    float *image = mem_alloc(c, n, sizeof *image);
    for (size_t k = 0; image && k < n; k++) image[k] = fine->data ? fine->data[k] / 255.0f : p->image.data[k];
    return image;
}

static sherf_status view_create(context *c, const sherf_avatar *a, const body_model *body, int i,
                                detail_view *d) {
    const sherf_render_options plain = {.detail = SHERF_DETAIL_OFF};
    sherf_frame own = {0};
    posed_body *posed = NULL;
    raster *drawn = NULL;
    float *image = picture_of(c, a, i, d);
    const size_t n = (size_t)d->width * (size_t)d->height;
    float *room = mem_alloc(c, 2 * n, sizeof *room);
    d->texel = mem_alloc(c, n, sizeof *d->texel);
    sherf_status status = image && room && d->texel ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = avatar_pose(c, a, body, &a->picture[i].pose, &posed);
    if (status == SHERF_OK) status = avatar_frame(c, a, body, posed, &d->camera, &plain, &own);
    if (status == SHERF_OK) status = detail_draw_body(c, body, d->posed, &d->camera, &drawn);
    if (status == SHERF_OK) detail_bound(drawn, own.depth.data);
    if (status == SHERF_OK) status = detail_see_body(c, body, drawn, d);
    if (status == SHERF_OK) {
        keep_difference(c, d, image, &own, room);
        status = carry_pattern(c, body, d, image, &own, room);
    }
    mem_free(room);
    mem_free(image);
    raster_free(drawn);
    posed_body_free(posed);
    sherf_frame_free(&own);
    return status;
}

sherf_status detail_create(context *c, const sherf_avatar *a, const body_model *body, avatar_detail *out) {
    *out = (avatar_detail){.variant = variant_draw(a->variant)};
    sherf_status status = carry_create(c, body, &out->carry);
    while (out->views < a->pictures && status == SHERF_OK) {
        const int i = out->views++;
        status = view_create(c, a, body, i, &out->view[i]);
    }
    if (status != SHERF_OK) detail_free(out);
    return status;
}

lazy_detail *lazy_detail_create(context *c) {
    lazy_detail *l = mem_zero(c, 1, sizeof *l);
    if (l) pthread_mutex_init(&l->lock, NULL);
    return l;
}

void lazy_detail_free(lazy_detail *l) {
    if (!l) return;
    pthread_mutex_destroy(&l->lock);
    detail_free(&l->made);
    mem_free(l);
}

sherf_status avatar_detail_of(context *c, const sherf_avatar *a, const body_model *body,
                              const avatar_detail **out) {
    lazy_detail *l = a->detail;
    sherf_status status = SHERF_OK;
    pthread_mutex_lock(&l->lock);
    if (!l->made.views) status = detail_create(c, a, body, &l->made);
    pthread_mutex_unlock(&l->lock);
    *out = &l->made;
    return status;
}

/* ---- once per frame ---- */
typedef struct {
    const avatar_detail *d;
    const body_model *body;
    const posed_body *posed;
    detail_optics optics;
    int reach;
    float *depth, *seen, *lent, *hidden; /* of pixels: smoothed, to be smoothed */
    detail_gift *gift;
    sherf_frame *frame;
} apply_job;

enum { BATCH = 256 };
/* The pixels of a batch, and where they are. */
typedef struct {
    int count;
    size_t pixel[BATCH];
    float weight[BATCH], point[3 * BATCH];
    int32_t nearest[BATCH];
    detail_gift gift[BATCH];
} batch;

/* A point is looked up through the vertex that it moves with in the frame. Using the nearest vertex in
 * canonical space instead would tear hair between head and shoulders. */
static void look_up_batch(const apply_job *j, batch *b) {
    deform_to_canonical(j->body, j->posed, b->count, b->point, NULL, b->nearest, b->point, NULL);
    detail_look_up(j->d, j->body, b->count, b->point, b->nearest, b->gift);
    for (int i = 0; i < b->count; i++) {
        j->seen[b->pixel[i]] = b->weight[i] * b->gift[i].seen;
        j->lent[b->pixel[i]] = b->weight[i] * b->gift[i].lent;
        j->hidden[b->pixel[i]] = b->weight[i] * (1 - b->gift[i].seen);
        j->gift[b->pixel[i]] = b->gift[i];
    }
    b->count = 0;
}

/* A pixel's point in the body's space and its nearest vertex, or -1. Where haze lets a ray through, its mean
 * depth can lie so deep inside the body that no vertex is near; the point is then moved outwards. */
static int32_t find_surface(const apply_job *j, int x, int y, int32_t guess, float point_smpl[3]) {
    const float *R = j->posed->R, *Th = j->posed->Th;
    const float depth = j->depth[(size_t)y * (size_t)j->frame->color.width + (size_t)x];
    for (int step = 0; step < 3; step++) {
        float p[3];
        detail_point(&j->optics, x, y, depth - 0.02f * (float)step, p);
        for (int k = 0; k < 3; k++) p[k] -= Th[k];
        for (int k = 0; k < 3; k++) point_smpl[k] = p[0] * R[k] + p[1] * R[3 + k] + p[2] * R[6 + k];
        const int32_t found = vertex_grid_nearest_from(j->posed->near, point_smpl, guess, NULL);
        if (found >= 0) return found;
    }
    return -1;
}

static void look_up_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const apply_job *j = arg;
    const int width = j->frame->color.width, height = j->frame->color.height;
    batch b = {0};
    int32_t guess = -1;
    for (int y = (int)begin; y < (int)end; y++)
        for (int x = 0; x < width; x++) {
            const size_t n = (size_t)y * (size_t)width + (size_t)x;
            const float opacity = j->frame->opacity.data[n];
            j->seen[n] = j->lent[n] = j->hidden[n] = 0;
            j->gift[n] = (detail_gift){0};
            if (!(detail_solid(opacity, 0) > 0)) continue;
            const float solid = detail_solid(opacity, detail_jump(j->depth, width, height, j->reach, x, y));
            const int32_t found = find_surface(j, x, y, guess, b.point + 3 * b.count);
            if (found < 0) continue;
            b.nearest[b.count] = guess = found;
            b.pixel[b.count] = n;
            b.weight[b.count] = solid;
            if (++b.count == BATCH) look_up_batch(j, &b);
        }
    if (b.count) look_up_batch(j, &b);
}

static void add_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const apply_job *j = arg;
    const int64_t width = j->frame->color.width;
    for (int64_t n = begin * width; n < end * width; n++)
        if (j->seen[n] > 0 || j->hidden[n] > 0)
            detail_give(j->d, &j->gift[n], j->seen[n], j->lent[n], j->hidden[n],
                        j->frame->color.data + 3 * n);
}

sherf_status detail_apply(context *c, const avatar_detail *d, const body_model *body, const posed_body *posed,
                          const sherf_camera *camera, const float background[3], sherf_frame *frame) {
    const int height = frame->color.height, radius = detail_pixels(camera, posed, smooth_m, RADIUS_MAX);
    const size_t pixels = (size_t)frame->color.width * (size_t)height;
    raster *drawn = NULL;
    float *room = mem_alloc(c, pixels, 5 * sizeof *room);
    detail_gift *gift = mem_alloc(c, pixels, sizeof *gift);
    sherf_status status = room && gift ? detail_draw_body(c, body, posed, camera, &drawn) : SHERF_NO_MEMORY;
    if (status != SHERF_OK) goto done;
    apply_job job = {.d = d, .body = body, .posed = posed, .frame = frame, .gift = gift};
    job.reach = detail_pixels(camera, posed, 0.004f, RADIUS_MAX);
    job.depth = room + pixels;
    job.seen = job.depth + pixels;
    job.lent = job.seen + pixels;
    job.hidden = job.lent + pixels;
    detail_optics_of(camera, &job.optics);
    memcpy(job.depth, frame->depth.data, pixels * sizeof *job.depth);
    detail_bound(drawn, job.depth);
    detail_smooth(c, &frame->opacity, radius, job.depth, NULL, room);
    parallel_for(c, height, 8, look_up_rows, &job);
    detail_smooth(c, &frame->opacity, radius, job.depth, job.seen, room);
    detail_smooth(c, &frame->opacity, radius, job.depth, job.lent, room);
    if (d->variant.light != 1) detail_smooth(c, &frame->opacity, radius, job.depth, job.hidden, room);
    parallel_for(c, height, 8, add_rows, &job);
    detail_make_firm(c, drawn, detail_firmness_of(d, posed, camera), background, frame);
    status = detail_clear_islands(c, drawn, background, frame);
done:
    raster_free(drawn);
    mem_free(gift);
    mem_free(room);
    return status;
}
