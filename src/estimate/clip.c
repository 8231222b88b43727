/* Video to motion, the steps in their order: medians over some frames' own fits give the shape and the
 * camera, then every frame is fitted with these. */
#include "estimate/clip.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "estimate/clip_inside.h"

enum { SAMPLES = 12 };
static const double begun_s = 0.3; /* a fit at most this old can start the next one */

static bool hopeless(sherf_status status) { /* a frame that failed for good reason; others may succeed */
    return status == SHERF_BAD_ARGUMENT || status == SHERF_MISMATCH;
}

static sherf_status fit_frame(context *c, const body_model *body, const clip_track *t, const clip_frame *f,
                              double focal_px, const body_fit_result *known, const body_fit_result *before,
                              body_fit_result *out) {
    photo_person *person = mem_alloc(c, 1, sizeof *person);
    if (!person) return SHERF_NO_MEMORY;
    clip_frame_person(f, person);
    const body_fit_input in = {.person = person,
                               .width_px = t->width,
                               .height_px = t->height,
                               .focal_px = focal_px,
                               .known = known,
                               .before = before};
    sherf_status status = body_fit(c, body, &in, out);
    mem_free(person);
    return status;
}

/* ---- the person and the camera ---- */

static int by_value(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

static double median(double *x, int count) {
    qsort(x, (size_t)count, sizeof *x, by_value);
    return 0.5 * (x[(count - 1) / 2] + x[count / 2]);
}

/* The frame of stretch i of `parts` in which most of the person is seen; NULL: nobody is. */
static const clip_frame *best_of(const clip_track *t, int part, int parts) {
    const clip_frame *best = NULL;
    double max = 0;
    for (int i = (int)((int64_t)t->count * part / parts); i < (int)((int64_t)t->count * (part + 1) / parts);
         i++) {
        const clip_frame *f = t->frame[i];
        double seen = 0;
        for (int l = LANDMARK_LEFT_SHOULDER; f && l < LANDMARKS; l++)
            seen += (double)(f->landmark[l].visible * f->landmark[l].present);
        if (f && !f->swapped && seen > max) max = seen, best = f;
    }
    return best;
}

/* When a person walks nearer, the ground under them tells how far the camera looks down, better than any
 * single frame. floor_m: places on it in the camera's frame, y and z. */
static double pitch_of(const double (*floor_m)[2], int count, double guess_rad) {
    const double spread_m = 0.04, spread_rad = 0.05;
    double mean[2] = {0}, zz = 0, zy = 0;
    for (int i = 0; i < count; i++)
        for (int k = 0; k < 2; k++) mean[k] += floor_m[i][k] / count;
    for (int i = 0; i < count; i++) {
        const double y = floor_m[i][0] - mean[0], z = floor_m[i][1] - mean[1];
        zz += z * z / (spread_m * spread_m);
        zy += z * y / (spread_m * spread_m);
    }
    const double sure = 1 / (spread_rad * spread_rad);
    return atan((sure * tan(guess_rad) - zy) / (sure + zz));
}

/* Medians over some frames' own fits. */
static sherf_status find_known(context *c, const body_model *body, const clip_track *t, double focal_px,
                               body_fit_result *known) {
    double value[BODY_SHAPES + 3][SAMPLES], floor_m[SAMPLES][2];
    const int parts = t->count < SAMPLES ? t->count : SAMPLES;
    int count = 0;
    body_fit_result r;
    memset(known, 0, sizeof *known);
    for (int poor = 0; poor < 2 && !count; poor++)
        for (int i = 0; i < parts; i++) {
            const clip_frame *f = best_of(t, i, parts);
            if (!f) continue;
            sherf_status status = fit_frame(c, body, t, f, focal_px, NULL, NULL, &r);
            if (status != SHERF_OK && !hopeless(status)) return status;
            if (status != SHERF_OK || (r.poor && !poor)) continue;
            for (int b = 0; b < BODY_SHAPES; b++) value[b][count] = (double)r.pose.shapes[b];
            for (int k = 0; k < 2; k++) floor_m[count][k] = (double)r.camera.T_m[k + 1];
            value[BODY_SHAPES][count] = log((double)r.camera.K[0]);
            value[BODY_SHAPES + 1][count] = r.pitch_rad;
            value[BODY_SHAPES + 2][count++] = r.roll_rad;
            known->camera = r.camera;
        }
    if (!count) return failure(c, SHERF_BAD_FILE, "no body lies on the person in any frame");
    for (int b = 0; b < BODY_SHAPES; b++) known->pose.shapes[b] = (float)median(value[b], count);
    known->camera.K[0] = known->camera.K[4] = (float)exp(median(value[BODY_SHAPES], count));
    known->pitch_rad = pitch_of((const double(*)[2])floor_m, count, median(value[BODY_SHAPES + 1], count));
    known->roll_rad = median(value[BODY_SHAPES + 2], count);
    return SHERF_OK;
}

/* ---- every frame ---- */

static double worth(const body_fit_result *r) {
    return r->iou - 10 * r->landmarks_px / fmax(r->height_px, 1);
}

/* Fits each frame from the fit before, and starts anew if the result is bad. */
static sherf_status fit_next(context *c, const body_model *body, const clip_track *t, clip_frame *f,
                             const body_fit_result *known, const body_fit_result *before) {
    body_fit_result anew;
    sherf_status status = SHERF_MISMATCH;
    if (before) status = fit_frame(c, body, t, f, 0, known, before, &f->fit);
    f->fitted = status == SHERF_OK;
    if (status != SHERF_OK && !hopeless(status)) return status;
    if (f->fitted && !f->fit.poor) return SHERF_OK;
    status = fit_frame(c, body, t, f, 0, known, NULL, &anew);
    if (status != SHERF_OK) return hopeless(status) ? SHERF_OK : status;
    if (!f->fitted || worth(&anew) > worth(&f->fit)) f->fit = anew;
    f->fitted = true;
    return SHERF_OK;
}

static sherf_status fit_all(context *c, const body_model *body, clip_track *t, const body_fit_result *known,
                            int *first, int *last) {
    *first = *last = -1;
    for (int i = 0; i < t->count; i++) {
        clip_frame *f = t->frame[i];
        if (!f) continue;
        const bool begun = *last >= 0 && i - *last <= fmax(1, begun_s * t->fps);
        sherf_status status = fit_next(c, body, t, f, known, begun ? &t->frame[*last]->fit : NULL);
        if (status == SHERF_OK) status = progress(c, "bodies fitted", i + 1, t->count);
        if (status != SHERF_OK) return status;
        if (!f->fitted) continue;
        if (*first < 0) *first = i;
        *last = i;
    }
    return *first >= 0 ? SHERF_OK : failure(c, SHERF_BAD_FILE, "no body lies on the person in any frame");
}

static void tell(const clip_track *t, int first, int last, const body_fit_result *known,
                 sherf_clip_facts *out) {
    int fitted = 0, run = 0;
    out->frames = last - first + 1;
    out->fps = t->fps;
    out->people = t->people;
    out->left_out = t->read - out->frames;
    out->cuts = t->cuts;
    out->start_s = (t->start + first) / t->fps;
    out->focal_px = (double)known->camera.K[0] * t->scale;
    out->pitch_rad = known->pitch_rad;
    out->roll_rad = known->roll_rad;
    memcpy(out->shapes, known->pose.shapes, sizeof out->shapes);
    for (int i = first; i <= last; i++) {
        const clip_frame *f = t->frame[i];
        if (f && f->fitted) {
            out->landmarks += f->fit.landmarks_px / fmax(f->fit.height_px, 1);
            out->poor += f->fit.poor;
            fitted++;
        }
        run = (f && f->fitted) || t->repeated[i] ? 0 : run + 1;
        out->filled += run > 0;
        out->filled_longest = run > out->filled_longest ? run : out->filled_longest;
    }
    out->landmarks /= fitted;
}

static sherf_status check_options(context *c, const sherf_clip_options *o) {
    if (o->person < 0 || o->person > 7)
        return failure(c, SHERF_BAD_ARGUMENT, "person %d: they are counted from 0 to 7", o->person);
    if (!(o->focal_px >= 0 && o->focal_px < 1e6) || !(o->fps >= 0 && o->fps <= 60) || !(o->smooth < 100))
        return failure(c, SHERF_BAD_ARGUMENT,
                       "focal length %g pixels, %g frames a second, smooth %g: out of range", o->focal_px,
                       o->fps, o->smooth);
    return SHERF_OK;
}

sherf_status clip_estimate(context *c, const pose_networks *n, const body_model *body, const char *path,
                           const sherf_clip_options *o, sherf_motion **out, sherf_clip_facts *facts) {
    sherf_clip_facts all = {0};
    body_fit_result known;
    clip_track t = {0};
    int first = 0, last = 0;
    double seen = 0;
    const double begun = time_seconds();
    *out = NULL;
    sherf_status status = check_options(c, o);
    if (status == SHERF_OK) status = clip_look(c, n, path, o, &t);
    if (status != SHERF_OK) return status;
    clip_keep_shot(&t);
    for (int i = 0; i < t.count; i++) seen += t.frame[i] != NULL;
    const double looked = time_seconds();
    if (!(seen > 0))
        status = failure(c, SHERF_BAD_FILE,
                         "nobody is seen in any frame: a whole person, at least 60 pixels high, is needed");
    if (status == SHERF_OK) status = clip_repair(c, &t, &all.repaired);
    if (status == SHERF_OK) status = find_known(c, body, &t, o->focal_px / t.scale, &known);
    if (status == SHERF_OK) status = fit_all(c, body, &t, &known, &first, &last);
    const double fitted = time_seconds();
    if (status == SHERF_OK) {
        tell(&t, first, last, &known, &all);
        status = clip_settle(c, body, &t, first, last, &known, o->smooth, out);
    }
    clip_track_free(&t);
    if (status != SHERF_OK) return failure_prefix(c, status, "%s", path);
    all.seconds[0] = looked - begun;
    all.seconds[1] = fitted - looked;
    all.seconds[2] = time_seconds() - fitted;
    if (facts) *facts = all;
    return SHERF_OK;
}

sherf_status sherf_estimate_clip(sherf_context *c, const char *networks, const sherf_body *body,
                                 const char *video, const sherf_clip_options *options, const char *output,
                                 sherf_clip_facts *facts) {
    static const sherf_clip_options usual;
    pose_networks *n = NULL;
    sherf_motion *motion = NULL;
    if (facts) *facts = (sherf_clip_facts){0};
    sherf_status status = pose_networks_load(c, networks, &n);
    if (status == SHERF_OK)
        status = clip_estimate(c, n, body, video, options ? options : &usual, &motion, facts);
    if (status == SHERF_OK) status = sherf_motion_save(c, motion, output);
    sherf_motion_free(motion);
    pose_networks_free(n);
    return status;
}
