/* Renders pictures: camera rays in packets, which pass through one layer after another where surfaces are not
 * opaque. */
#include <string.h>

#include "synth/trace/trace_inside.h"

enum { PACKET = 16, SAMPLES_MAX = 64, LAYERS_MAX = 32, BLOCK = 4 };
/* Less light than this from behind is ignored. */
static const float through_min = 1 / 256.0f;
/* A less opaque place's colour does not represent others. */
static const float typical_min = 0.25f;
/* Between one layer and the next, metres of depth. */
static const float layer_gap_m = 2e-5f;
/* Surfaces closer than this touch each other, metres of depth. */
static const float touching_m = 3e-4f;

typedef struct {
    const trace_scene *s;
    const sherf_camera *camera;
    trace_picture *out;
    float origin[3];
    float ray[9]; /* times (x, y, 1): the direction whose z_camera is 1 */
    int samples;
    int group;       /* samples of a quarter of a pixel: neighbours in `sobol` */
    float footprint; /* side of a shaded part of a pixel one metre away, m */
    uint32_t sobol[SAMPLES_MAX][2];
    uint64_t key;
    int blocks_x, blocks_y;
    uint8_t *touched; /* by block: something may be visible there */
    int32_t *block;   /* the touched ones */
    int64_t blocks;
} render_job;

/* ---- which blocks of pixels can see anything ---- */

static void touch(render_job *job, int x0, int x1, int y0, int y1) {
    for (int y = y0 / BLOCK; y <= y1 / BLOCK; y++)
        memset(job->touched + (size_t)y * (size_t)job->blocks_x + (size_t)(x0 / BLOCK), 1,
               (size_t)(x1 / BLOCK - x0 / BLOCK + 1));
}

/* First and last pixel of the values' range; false when it misses the picture. */
static bool pixel_span(float a, float b, float c, int size, int *first, int *last) {
    const float spare = 0.02f;
    float low = a < b ? a : b, high = a < b ? b : a;
    low = (low < c ? low : c) + 0.5f - spare;
    high = (high > c ? high : c) + 0.5f + spare;
    if (!(high >= 0 && low < (float)size)) return false;
    *first = low > 0 ? (int)low : 0;
    *last = high < (float)(size - 1) ? (int)high : size - 1;
    return true;
}

static void touch_mesh(render_job *job, const scene_mesh *mesh, const float *uv, const float *depth) {
    const float near = 1e-3f;
    int width = job->out->width, height = job->out->height, x0, x1, y0, y1;
    for (int64_t f = 0; f < mesh->faces; f++) {
        const uint32_t *v = mesh->face + 3 * f;
        const float *a = uv + 2 * (size_t)v[0], *b = uv + 2 * (size_t)v[1], *c = uv + 2 * (size_t)v[2];
        int front = (depth[v[0]] > near) + (depth[v[1]] > near) + (depth[v[2]] > near);
        if (front == 0) continue;
        if (front < 3)
            touch(job, 0, width - 1, 0, height - 1); /* across the camera's own plane */
        else if (pixel_span(a[0], b[0], c[0], width, &x0, &x1) &&
                 pixel_span(a[1], b[1], c[1], height, &y0, &y1))
            touch(job, x0, x1, y0, y1);
    }
}

static sherf_status find_blocks(context *c, render_job *job) {
    const trace_scene *s = job->s;
    job->blocks_x = (job->out->width + BLOCK - 1) / BLOCK;
    job->blocks_y = (job->out->height + BLOCK - 1) / BLOCK;
    size_t blocks = (size_t)job->blocks_x * (size_t)job->blocks_y, max = 1;
    for (int i = 0; i < s->meshes; i++)
        if ((size_t)s->mesh[i].vertices > max) max = (size_t)s->mesh[i].vertices;
    job->touched = mem_zero(c, blocks, 1);
    job->block = mem_alloc(c, blocks, sizeof *job->block);
    float *uv = mem_alloc(c, max, 2 * sizeof *uv), *depth = mem_alloc(c, max, sizeof *depth);
    bool made = job->touched && job->block && uv && depth;
    for (int i = 0; i < s->meshes && made; i++) {
        camera_project(job->camera, s->mesh[i].vertices, s->mesh[i].vertex, uv, depth);
        touch_mesh(job, &s->mesh[i], uv, depth);
    }
    for (size_t i = 0; i < blocks && made; i++)
        if (job->touched[i]) job->block[job->blocks++] = (int32_t)i;
    mem_free(uv);
    mem_free(depth);
    return made ? SHERF_OK : SHERF_NO_MEMORY;
}

/* ---- rays ---- */

typedef struct {
    unsigned mesh, face;
    int side;
    float u, v, depth, ng[3];
} found;

typedef struct {
    _Alignas(64) struct RTCRayHit16 at;
    _Alignas(64) int valid[PACKET];
    found under[PACKET], over[PACKET]; /* the first is drawn unless the second is close behind it */
    enum { STRAIGHT, SEEKS_COVER, CHECKS_BETWEEN } phase[PACKET];
    float color[PACKET][3], through[PACKET];
    float depth[PACKET], normal[PACKET][3]; /* where half of the light is blocked */
} packet;

static void packet_ray(const render_job *job, packet *p, int lane, float x, float y) {
    const float *m = job->ray;
    struct RTCRay16 *r = &p->at.ray;
    r->org_x[lane] = job->origin[0], r->org_y[lane] = job->origin[1], r->org_z[lane] = job->origin[2];
    r->dir_x[lane] = m[0] * x + m[1] * y + m[2];
    r->dir_y[lane] = m[3] * x + m[4] * y + m[5];
    r->dir_z[lane] = m[6] * x + m[7] * y + m[8];
    r->tnear[lane] = 0, r->tfar[lane] = INFINITY, r->time[lane] = 0;
    r->mask[lane] = ~seen_mask(TRACE_NOT_BY_CAMERAS), r->id[lane] = (unsigned)lane, r->flags[lane] = 0;
    p->at.hit.geomID[lane] = RTC_INVALID_GEOMETRY_ID;
    p->at.hit.instID[0][lane] = RTC_INVALID_GEOMETRY_ID;
    p->valid[lane] = -1;
    for (int k = 0; k < 3; k++) p->color[lane][k] = 0, p->normal[lane][k] = 0;
    p->through[lane] = 1;
    p->phase[lane] = STRAIGHT;
    p->depth[lane] = INFINITY;
}

/* One place's colour, reused for other samples of that quarter of the pixel. */
typedef struct {
    bool set;
    found at;
    float rgb[3], normal[3];
} shaded;

static bool same_place(const render_job *job, const shaded *was, const found *f) {
    const float nearby = 8, alike = 0.95f; /* of a footprint; cosine */
    if (!was->set || was->at.mesh != f->mesh || was->at.side != f->side ||
        !(fabsf(f->depth - was->at.depth) < nearby * job->footprint * f->depth))
        return false;
    if (was->at.face == f->face) return true;
    float cosine = dot3(f->ng, was->at.ng);
    return cosine > 0 && cosine * cosine > alike * alike * dot3(f->ng, f->ng) * dot3(was->at.ng, was->at.ng);
}

static void stop_light(packet *p, int lane, float depth, float opacity, const float normal[3]) {
    float before = p->through[lane];
    p->through[lane] = before * (1 - opacity);
    if (before > 0.5f && p->through[lane] <= 0.5f) {
        p->depth[lane] = depth;
        memcpy(p->normal[lane], normal, sizeof p->normal[lane]);
    }
}

static void place_at(const render_job *job, const found *f, surface *out) {
    surface_at(job->s, (int)f->mesh, f->face, f->u, f->v, f->side, job->footprint * f->depth, out);
}

/* Draws one surface in front of everything still to come; false: nothing more can be visible. */
static bool draw_surface(const render_job *job, packet *p, int lane, const found *f, bool shade,
                         shaded *last) {
    const scene_mesh *mesh = &job->s->mesh[f->mesh];
    const trace_material *material = &mesh->material;
    bool again = same_place(job, last, f);
    if (again && mesh->solid[f->face]) {
        for (int k = 0; k < 3; k++) p->color[lane][k] += p->through[lane] * last->rgb[k];
        stop_light(p, lane, f->depth, 1, last->normal);
        return false;
    }
    surface at;
    place_at(job, f, &at);
    float opacity = at.rgba[3], rgb[3] = {0}, coat[3] = {0};
    if (again) {
        memcpy(rgb, last->rgb, sizeof rgb);
    } else if (shade && (opacity > 0 || material->coat)) {
        const struct RTCRay16 *r = &p->at.ray;
        float d[3] = {r->dir_x[lane], r->dir_y[lane], r->dir_z[lane]};
        unit3(d);
        surface_shade(job->s, &at, d, rgb, coat);
    }
    for (int k = 0; k < 3; k++) p->color[lane][k] += p->through[lane] * (opacity * rgb[k] + coat[k]);
    stop_light(p, lane, f->depth, opacity, at.normal);
    if (!again && opacity > typical_min && !material->coat) {
        *last = (shaded){.set = true, .at = *f};
        memcpy(last->rgb, rgb, sizeof rgb);
        memcpy(last->normal, at.normal, sizeof at.normal);
    }
    return p->through[lane] >= through_min;
}

static bool find_surface(const packet *p, int lane, found *f) {
    const struct RTCHit16 *h = &p->at.hit;
    const struct RTCRay16 *r = &p->at.ray;
    if (h->geomID[lane] == RTC_INVALID_GEOMETRY_ID) return false;
    *f = (found){.mesh = h->geomID[lane],
                 .face = h->primID[lane],
                 .u = h->u[lane],
                 .v = h->v[lane],
                 .depth = r->tfar[lane],
                 .ng = {h->Ng_x[lane], h->Ng_y[lane], h->Ng_z[lane]}};
    f->side = dot3(f->ng, (float[3]){r->dir_x[lane], r->dir_y[lane], r->dir_z[lane]}) > 0;
    return true;
}

static bool covers(const render_job *job, const found *under, const found *over) {
    const scene_mesh *mesh = &job->s->mesh[over->mesh];
    if (over->side || mesh->material.layer <= job->s->mesh[under->mesh].material.layer) return false;
    if (mesh->solid[over->face]) return true;
    surface at;
    place_at(job, over, &at);
    return at.rgba[3] > 0.5f;
}

/* The ray's next part: surfaces of layers from `layer` on, between the depths near and far. */
static bool go_on(packet *p, int lane, float near, float far, int layer) {
    p->at.ray.tnear[lane] = near;
    p->at.ray.tfar[lane] = far;
    p->at.ray.mask[lane] = ~0u << layer & ~seen_mask(TRACE_NOT_BY_CAMERAS);
    p->at.hit.geomID[lane] = RTC_INVALID_GEOMETRY_ID;
    return true;
}

/* Chooses the visible one of a surface and a possible cover, once that is known. False: the ray must continue
 * first. */
static bool settle(const render_job *job, packet *p, int lane, bool met, found *f, bool *settled) {
    const found *under = &p->under[lane];
    int was = (int)p->phase[lane];
    p->phase[lane] = STRAIGHT;
    if (was == SEEKS_COVER && met && covers(job, under, f)) {
        if (f->depth < under->depth + touching_m) return true;
        p->over[lane] = *f;
        p->phase[lane] = CHECKS_BETWEEN;
        go_on(p, lane, under->depth + layer_gap_m, f->depth - layer_gap_m, 0);
        return false;
    }
    *settled = was == SEEKS_COVER || met;
    *f = *settled ? *under : p->over[lane];
    return true;
}

/* Processes the ray's hit. True: the ray must continue. */
static bool take_surface(const render_job *job, packet *p, int lane, bool shade, shaded *last) {
    found f;
    bool met = find_surface(p, lane, &f), settled = false;
    if (p->phase[lane] == STRAIGHT) {
        if (!met) return false;
    } else if (!settle(job, p, lane, met, &f, &settled)) {
        return true;
    }
    const trace_material *material = &job->s->mesh[f.mesh].material;
    if (!settled && !f.side && material->layer < job->s->top_layer) {
        p->under[lane] = f;
        p->phase[lane] = SEEKS_COVER;
        float near = f.depth - touching_m;
        return go_on(p, lane, near > 0 ? near : 0, f.depth + TRACE_COVER_M, material->layer + 1);
    }
    if (!(f.side && material->one_sided) && !draw_surface(job, p, lane, &f, shade, last)) return false;
    return go_on(p, lane, f.depth + layer_gap_m, INFINITY, 0);
}

static void packet_trace(const render_job *job, packet *p, bool shade) {
    struct RTCIntersectContext how;
    rtcInitIntersectContext(&how);
    how.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    for (int layer = 0, left = 1; layer < LAYERS_MAX && left; layer++) {
        shaded last = {0};
        rtcIntersect16(p->valid, job->s->scene, &how, &p->at);
        left = 0;
        for (int i = 0; i < PACKET; i++) {
            if (!shade || i % job->group == 0) last.set = false;
            if (!p->valid[i]) continue;
            p->valid[i] = take_surface(job, p, i, shade, &last) ? -1 : 0;
            left |= p->valid[i];
        }
    }
    for (int i = 0; i < PACKET; i++)
        if (p->through[i] < through_min) p->through[i] = 0;
}

/* ---- pixels ---- */

/* Pixel `n` of a block; false beyond the picture's border. */
static bool block_pixel(const render_job *job, int32_t block, int n, int *x, int *y) {
    *x = block % job->blocks_x * BLOCK + n % BLOCK;
    *y = block / job->blocks_x * BLOCK + n / BLOCK;
    return *x < job->out->width && *y < job->out->height;
}

static void draw_colors(const render_job *job, int32_t block, packet *p) {
    float sum[BLOCK * BLOCK][4] = {{0}}, share = 1 / (float)job->samples;
    for (int first = 0; first < BLOCK * BLOCK * job->samples; first += PACKET) {
        for (int i = 0; i < PACKET; i++) {
            int n = (first + i) / job->samples, sample = (first + i) % job->samples, x, y;
            p->valid[i] = 0, p->through[i] = 1;
            for (int k = 0; k < 3; k++) p->color[i][k] = 0;
            if (!block_pixel(job, block, n, &x, &y)) continue;
            uint64_t scramble = splitmix64(job->key + (uint64_t)y * (uint64_t)job->out->width + (uint64_t)x);
            float dx = fraction32(job->sobol[sample][0] ^ (uint32_t)scramble);
            float dy = fraction32(job->sobol[sample][1] ^ (uint32_t)(scramble >> 32));
            packet_ray(job, p, i, (float)x - 0.5f + dx, (float)y - 0.5f + dy);
        }
        packet_trace(job, p, true);
        for (int i = 0; i < PACKET; i++) {
            float *to = sum[(first + i) / job->samples];
            for (int k = 0; k < 3; k++) to[k] += share * p->color[i][k];
            to[3] += share * (1 - p->through[i]);
        }
    }
    for (int n = 0, x, y; n < BLOCK * BLOCK; n++) {
        if (!block_pixel(job, block, n, &x, &y)) continue;
        size_t at = (size_t)y * (size_t)job->out->width + (size_t)x;
        memcpy(job->out->color + 3 * at, sum[n], 3 * sizeof(float));
        job->out->alpha[at] = clamp01(sum[n][3]);
    }
}

static void draw_depth(const render_job *job, int32_t block, packet *p) {
    int x, y;
    for (int n = 0; n < BLOCK * BLOCK; n++) {
        p->valid[n] = 0;
        if (block_pixel(job, block, n, &x, &y)) packet_ray(job, p, n, (float)x, (float)y);
    }
    packet_trace(job, p, false);
    for (int n = 0; n < BLOCK * BLOCK; n++) {
        if (!block_pixel(job, block, n, &x, &y)) continue;
        size_t at = (size_t)y * (size_t)job->out->width + (size_t)x;
        job->out->depth_m[at] = p->depth[n];
        memcpy(job->out->normal_world + 3 * at, p->normal[n], sizeof p->normal[n]);
    }
}

/* ---- the whole ---- */

static sherf_status make_picture(context *c, int width, int height, bool depth, trace_picture *out) {
    size_t pixels = (size_t)width * (size_t)height;
    *out = (trace_picture){
        width, height, mem_zero(c, pixels, 3 * sizeof(float)), mem_zero(c, pixels, sizeof(float)),
        NULL,  NULL};
    if (depth) {
        out->depth_m = mem_alloc(c, pixels, sizeof(float));
        out->normal_world = mem_zero(c, pixels, 3 * sizeof(float));
    }
    if (out->color && out->alpha && (!depth || (out->depth_m && out->normal_world))) {
        for (size_t i = 0; i < pixels && depth; i++) out->depth_m[i] = INFINITY;
        return SHERF_OK;
    }
    trace_picture_free(out);
    return SHERF_NO_MEMORY;
}

/* ray = R^T K^-1; the last row of K is 0 0 1. */
static void prepare_rays(render_job *job) {
    const sherf_camera *camera = job->camera;
    double K[9], inverse[9] = {0};
    for (int i = 0; i < 9; i++) K[i] = camera->K[i];
    double det = K[0] * K[4] - K[1] * K[3];
    inverse[0] = K[4] / det, inverse[1] = -K[1] / det, inverse[2] = (K[1] * K[5] - K[2] * K[4]) / det;
    inverse[3] = -K[3] / det, inverse[4] = K[0] / det, inverse[5] = (K[2] * K[3] - K[0] * K[5]) / det;
    inverse[8] = 1;
    for (int r = 0; r < 3; r++)
        for (int k = 0; k < 3; k++) {
            double sum = 0;
            for (int i = 0; i < 3; i++) sum += camera->R[3 * i + r] * inverse[3 * i + k];
            job->ray[3 * r + k] = (float)sum;
        }
    camera_position(camera, job->origin);
    job->footprint = (float)(0.5 / sqrt(fabs(det)));
}

/* Quarter by quarter; a scramble by XOR keeps quarters together. */
static void prepare_samples(render_job *job) {
    int count = 0;
    for (uint32_t quarter = 0; quarter < 4; quarter++)
        for (int i = 0; i < job->samples; i++) {
            uint32_t at[2];
            sobol2((uint32_t)i, at);
            if ((at[0] >> 31 | at[1] >> 31 << 1) == quarter) memcpy(job->sobol[count++], at, sizeof at);
        }
    job->group = job->samples / 4;
}

sherf_status trace_render(context *c, const trace_scene *s, const sherf_camera *camera,
                          const trace_options *options, trace_picture *out) {
    static const trace_options usual = {0};
    const trace_options *o = options ? options : &usual;
    *out = (trace_picture){0};
    sherf_status status = camera_check(c, camera);
    if (status != SHERF_OK) return status;
    render_job job = {.s = s, .camera = camera, .out = out, .samples = o->samples ? o->samples : 16};
    if (job.samples < 4 || job.samples > SAMPLES_MAX || (job.samples & (job.samples - 1)))
        return failure(c, SHERF_BAD_ARGUMENT, "trace: %d samples a pixel, must be 4, 8, 16, 32 or 64",
                       o->samples);
    if (!s->scene) return failure(c, SHERF_BAD_ARGUMENT, "trace: the scene has no pose yet");
    job.key = random_key(o->seed, "trace.pixels", 0);
    prepare_samples(&job);
    prepare_rays(&job);
    if ((status = make_picture(c, camera->width_px, camera->height_px, o->depth, out))) return status;
    if ((status = find_blocks(c, &job))) goto done;
#pragma omp parallel for schedule(dynamic, 8) num_threads(c->threads)
    for (int64_t b = 0; b < job.blocks; b++) {
        packet p;
        if (o->depth) draw_depth(&job, job.block[b], &p);
        draw_colors(&job, job.block[b], &p);
    }
    if (cancelled(c)) status = failure(c, SHERF_CANCELLED, "cancelled");
done:
    mem_free(job.touched);
    mem_free(job.block);
    if (status != SHERF_OK) trace_picture_free(out);
    return status;
}

void trace_picture_free(trace_picture *p) {
    if (!p) return;
    mem_free(p->color);
    mem_free(p->alpha);
    mem_free(p->depth_m);
    mem_free(p->normal_world);
    *p = (trace_picture){0};
}

void trace_picture_srgb(const trace_picture *p, const float background[3], uint8_t *rgb) {
    const float knee = 0.8f;
    size_t pixels = (size_t)p->width * (size_t)p->height;
    uint8_t empty[3];
    for (int k = 0; k < 3; k++) empty[k] = (uint8_t)(255 * srgb_of_linear(clamp01(background[k])) + 0.5f);
    for (size_t i = 0; i < pixels; i++)
        for (int k = 0; k < 3; k++) {
            float v = p->color[3 * i + k];
            if (p->alpha[i] == 0 && v == 0) {
                rgb[3 * i + k] = empty[k];
                continue;
            }
            v += (1 - p->alpha[i]) * background[k];
            if (v > knee) v = 1 - (1 - knee) * expf((knee - v) / (1 - knee));
            rgb[3 * i + k] = (uint8_t)(255 * srgb_of_linear(clamp01(v)) + 0.5f);
        }
}
