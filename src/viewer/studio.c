/* Makes pictures in bands of some tens of milliseconds each, so that clients take turns and a replaced
 * request ends soon. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "io/image.h"
#include "scene/scene.h"
#include "viewer/viewer.h"

static const double band_s = 0.06; /* wanted time of a band */
enum { BAND_ROWS_MIN = 16, BAND_PIXELS_FIRST = 8192, SMALL_PIXELS = 160 * 1024 };

static sherf_status job_begin(context *c, viewer *v, viewer_job *job) {
    const viewer_request *r = &job->request;
    size_t pixels = (size_t)r->width * (size_t)r->height;
    sherf_status status = scene_framing(c, &v->scene, r->avatar, r->motion, &job->framing);
    if (status == SHERF_OK) {
        scene_camera(&v->scene, job->framing, r, &job->camera, &job->scale_m);
        job->color = mem_alloc(c, pixels, 5 * sizeof(float));
        if (job->color) {
            job->opacity = job->color + 3 * pixels;
            job->depth = job->opacity + pixels;
            return SHERF_OK;
        }
        status = SHERF_NO_MEMORY;
    }
    job->framing = NULL;
    return status;
}

static int band_rows(const viewer *v, const viewer_job *job) {
    double pixel_s = v->pixel_s[job->request.avatar];
    double pixels = pixel_s > 0 ? band_s / pixel_s : BAND_PIXELS_FIRST;
    int left = job->request.height - job->rows_done;
    int rows = (int)fmin(pixels / job->request.width, 4096) / BAND_ROWS_MIN * BAND_ROWS_MIN;
    if (rows < BAND_ROWS_MIN) rows = BAND_ROWS_MIN;
    return rows * 4 > left * 3 ? left : rows; /* avoids a small last band */
}

/* Detail smooths depths over neighbours, so it waits for the whole picture, which is over black until it is
 * painted. */
static sherf_status job_detail(context *c, viewer *v, viewer_job *job, const posed_body *posed) {
    static const float black[3] = {0, 0, 0};
    const viewer_request *r = &job->request;
    const sherf_viewer_avatar *a = &v->scene.avatars[r->avatar];
    sherf_frame f = {.color = {r->width, r->height, 3, job->color},
                     .opacity = {r->width, r->height, 1, job->opacity},
                     .depth = {r->width, r->height, 1, job->depth}};
    if (!v->scene.detail) return SHERF_OK;
    return avatar_give_detail(c, a->avatar, a->body, posed, &job->camera, black, &f);
}

/* Draws the whole picture at once from the baked surface. */
static sherf_status job_draw(context *c, viewer *v, viewer_job *job, const sherf_avatar *baked) {
    const viewer_request *r = &job->request;
    const sherf_pose pose = scene_pose(&v->scene, r->avatar, r->motion, r->frame);
    const size_t n = (size_t)r->width * (size_t)r->height;
    sherf_status status =
        sherf_render(c, baked, v->scene.avatars[r->avatar].body, &pose, &job->camera, NULL, &v->band);
    if (status != SHERF_OK) return status;
    memcpy(job->color, v->band.color.data, 3 * n * sizeof(float));
    memcpy(job->opacity, v->band.opacity.data, n * sizeof(float));
    memcpy(job->depth, v->band.depth.data, n * sizeof(float));
    job->rows_done = r->height;
    job->baked = !v->scene.avatars[r->avatar].avatar->form;
    return SHERF_OK;
}

sherf_status job_render(context *c, viewer *v, viewer_job *job, bool *complete) {
    const viewer_request *r = &job->request;
    const posed_body *posed;
    double begun = time_seconds();
    *complete = false;
    sherf_status status = job->framing ? SHERF_OK : job_begin(c, v, job);
    const bool draws = r->quick || v->scene.avatars[r->avatar].avatar->form;
    const sherf_avatar *baked = draws && !job->rows_done ? live_avatar(v, r->avatar) : NULL;
    if (status == SHERF_OK && baked) {
        status = job_draw(c, v, job, baked);
        *complete = status == SHERF_OK;
        job->render_s += time_seconds() - begun;
        return status;
    }
    if (status == SHERF_OK) status = scene_posed(c, &v->scene, r, &posed);
    if (status != SHERF_OK) return status;
    double posed_s = time_seconds();
    int rows = band_rows(v, job);
    sherf_camera camera = job->camera;
    camera.height_px = rows;
    camera.K[5] -= (float)job->rows_done;
    const sherf_viewer_avatar *a = &v->scene.avatars[r->avatar];
    const sherf_render_options plain = {.detail = SHERF_DETAIL_OFF};
    status = avatar_render(c, a->avatar, a->body, posed, &camera, &plain, &v->band);
    if (status != SHERF_OK) return status;
    size_t first = (size_t)job->rows_done * (size_t)r->width, count = (size_t)rows * (size_t)r->width;
    memcpy(job->color + 3 * first, v->band.color.data, 3 * count * sizeof(float));
    memcpy(job->opacity + first, v->band.opacity.data, count * sizeof(float));
    memcpy(job->depth + first, v->band.depth.data, count * sizeof(float));
    job->rows_done += rows;
    job->points += v->band.points;
    double now = time_seconds(), *pixel_s = &v->pixel_s[r->avatar];
    double latest = (now - posed_s) / (double)count;
    *pixel_s = *pixel_s > 0 ? 0.7 * *pixel_s + 0.3 * latest : latest;
    *complete = job->rows_done == r->height;
    if (*complete) status = job_detail(c, v, job, posed);
    job->render_s += time_seconds() - begun;
    return status;
}

sherf_status job_paint(context *c, const viewer_job *job, int channels, uint8_t **out) {
    const viewer_request *r = &job->request;
    const viewer_framing *f = job->framing;
    size_t pixels = (size_t)r->width * (size_t)r->height;
    float slope = sinf(r->elevation_rad), radius = (float)hypot(f->half_m[0], f->half_m[2]); /* in depth */
    radius = radius * sqrtf(1 - slope * slope) + (float)f->half_m[1] * fabsf(slope);
    viewer_optics o = {.focal_px = job->camera.K[0],
                       .centre_px = {job->camera.K[2], job->camera.K[5]},
                       .near_m = (float)f->distance_m - radius,
                       .far_m = (float)f->distance_m + radius};
    *out = mem_alloc(c, pixels, (size_t)channels);
    float *scratch = r->mode == VIEWER_NORMAL ? mem_alloc(c, pixels, 2 * sizeof *scratch) : NULL;
    bool good = *out && (scratch || r->mode != VIEWER_NORMAL);
    if (good) paint(r, &o, job->color, job->opacity, job->depth, channels, scratch, *out);
    mem_free(scratch);
    if (good) return SHERF_OK;
    mem_free(*out);
    *out = NULL;
    return SHERF_NO_MEMORY;
}

sherf_status job_encode(context *c, viewer_job *job) {
    const viewer_request *r = &job->request;
    int channels = r->transparent ? 4 : 3, pixels = r->width * r->height;
    uint8_t *picture;
    sherf_status status = job_paint(c, job, channels, &picture);
    if (status != SHERF_OK) return status;
    job->png = r->transparent || r->lossless;
    if (job->png)
        status = png_to_memory(c, r->width, r->height, channels, picture, r->lossless ? 6 : 1, &job->data,
                               &job->bytes);
    else
        status = jpeg_to_memory(c, r->width, r->height, picture, r->fine || pixels < SMALL_PIXELS ? 92 : 85,
                                &job->data, &job->bytes);
    mem_free(picture);
    return status;
}
