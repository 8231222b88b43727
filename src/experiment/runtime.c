/* The methods' run times on this machine: an avatar and frames of one person, in turn, in one process. */
#include <stdio.h>
#include <string.h>

#include "avatar/avatar.h"
#include "experiment/experiment.h"

enum { WARM = 3, REPEATS = 20, SMOKE_REPEATS = 3, SIDE = 512 };
static const double person_share = 0.8, azimuth_rad = 1.0, elevation_rad = 0.15;

typedef enum { ENCODE, RENDER, BOTH, SHOW, TIMES } timing;
typedef struct {
    const experiment_method *method;
    sherf_model *model;
    sherf_avatar *avatar; /* for frames to look at; finds empty space once */
    double ms[TIMES][REPEATS];
    int64_t points[2]; /* of frames as scored and as shown */
} timed_method;
typedef struct {
    experiment_job *j;
    sherf_body *body;
    sherf_observation *observation;
    sherf_camera camera;
    int methods, repeats;
    timed_method method[EXPERIMENT_METHODS];
    sherf_frame frame;
} runtime;

static void runtime_free(runtime *t) {
    for (int i = 0; i < t->methods; i++) {
        sherf_avatar_free(t->method[i].avatar);
        sherf_model_free(t->method[i].model);
    }
    sherf_frame_free(&t->frame);
    sherf_observation_free(t->observation);
    sherf_body_free(t->body);
}

/* ---- the timed steps ---- */
/* Zooms and centres the picture so that the body's larger extent takes this share of it. */
static sherf_status zoom(context *c, const sherf_body *body, const sherf_pose *pose, sherf_camera *camera) {
    const int V = sherf_body_vertex_count(body);
    float low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    float *vertex = mem_alloc(c, (size_t)V, 5 * sizeof *vertex), *px = vertex + 3 * (size_t)V;
    if (!vertex) return SHERF_NO_MEMORY;
    sherf_status status = sherf_body_pose(c, body, pose, vertex, NULL);
    if (status == SHERF_OK) camera_project(camera, V, vertex, px, NULL);
    for (int i = 0; i < 2 * V && status == SHERF_OK; i++) {
        low[i % 2] = fminf(low[i % 2], px[i]);
        high[i % 2] = fmaxf(high[i % 2], px[i]);
    }
    mem_free(vertex);
    const float scale = (float)(person_share * SIDE) / fmaxf(high[0] - low[0], high[1] - low[1]);
    for (int k = 0; k < 2 && status == SHERF_OK; k++) {
        camera->K[4 * k] *= scale;
        camera->K[3 * k + 2] = (camera->K[3 * k + 2] - (low[k] + high[k]) / 2) * scale + SIDE / 2.0f;
    }
    return status;
}

/* The first test person, pose and observation view of the protocol. */
static sherf_status person_open(runtime *t) {
    experiment_job *j = t->j;
    context *c = j->c;
    sherf_dataset *data = NULL;
    int *person = NULL, count;
    const experiment_data *d = &j->data[0];
    sherf_status status = sherf_dataset_open(c, d->test, &data);
    if (status == SHERF_OK) status = sherf_body_load(c, d->body, &t->body);
    if (status == SHERF_OK) status = dataset_people(c, data, data_test_people(j, d), false, &person, &count);
    if (status == SHERF_OK) {
        const data_protocol *p = dataset_protocol(data);
        const int views = sherf_dataset_view_count(data, person[0]),
                  view = p->observation_views[0] < views ? p->observation_views[0] : 0;
        status = dataset_observation(c, data, person[0], p->pose_first, view, SIDE, &t->observation);
    }
    const sherf_orbit_options orbit = {
        .width_px = SIDE, .height_px = SIDE, .azimuth_rad = azimuth_rad, .elevation_rad = elevation_rad};
    if (status == SHERF_OK)
        status = sherf_cameras_orbit(c, t->body, &t->observation->pose, 1, &orbit, 1, &t->camera);
    if (status == SHERF_OK) status = zoom(c, t->body, &t->observation->pose, &t->camera);
    mem_free(person);
    sherf_dataset_free(data);
    return status;
}

static sherf_status methods_open(runtime *t) {
    experiment_job *j = t->j;
    char path[PATH_LENGTH];
    run r;
    for (int i = 0; run_at(j, i, &r); i++) {
        timed_method *method = &t->method[t->methods++];
        method->method = r.method;
        sherf_status status = run_path(j, &r, "model.safetensors", path);
        if (status == SHERF_OK) status = sherf_model_load(j->c, path, &method->model);
        if (status == SHERF_OK)
            status = sherf_avatar_create(j->c, method->model, t->body, t->observation, &method->avatar);
        if (status != SHERF_OK) return status;
    }
    return SHERF_OK;
}

/* ---- timing ---- */
static sherf_status render(runtime *t, const sherf_avatar *a, bool scored, double *ms, int64_t *points) {
    const sherf_render_options how = {
        .samples = SHERF_SAMPLES_MODEL, .exact = scored, .detail = SHERF_DETAIL_OFF};
    const double begun = time_seconds();
    sherf_status status =
        sherf_render(t->j->c, a, t->body, &t->observation->pose, &t->camera, &how, &t->frame);
    *ms = 1000 * (time_seconds() - begun);
    *points = t->frame.points;
    return status;
}

static sherf_status time_once(runtime *t, timed_method *method, int round) {
    sherf_avatar *avatar = NULL;
    double ms[TIMES];
    const double begun = time_seconds();
    sherf_status status = sherf_avatar_create(t->j->c, method->model, t->body, t->observation, &avatar);
    ms[ENCODE] = 1000 * (time_seconds() - begun);
    if (status == SHERF_OK) status = render(t, avatar, true, &ms[RENDER], &method->points[0]);
    ms[BOTH] = ms[ENCODE] + ms[RENDER];
    sherf_avatar_free(avatar);
    if (status == SHERF_OK) status = render(t, method->avatar, false, &ms[SHOW], &method->points[1]);
    for (int k = 0; k < TIMES && round >= WARM && status == SHERF_OK; k++)
        method->ms[k][round - WARM] = ms[k];
    return status;
}

static sherf_status time_all(runtime *t) {
    for (int round = 0; round < WARM + t->repeats; round++)
        for (int i = 0; i < t->methods; i++) {
            sherf_status status = time_once(t, &t->method[i], round);
            if (status == SHERF_OK)
                status = progress(t->j->c, "timings", round * t->methods + i + 1,
                                  (WARM + t->repeats) * t->methods);
            if (status != SHERF_OK) return status;
        }
    return SHERF_OK;
}

/* ---- the page ---- */
/* The median and the quartiles. */
static interval quartiles(const runtime *t, double ms[REPEATS]) {
    const int n = t->repeats;
    numbers_sort(n, ms);
    return (interval){(ms[(n - 1) / 2] + ms[n / 2]) / 2, ms[n / 4], ms[3 * n / 4]};
}

static sherf_status table_add(runtime *t, page *p) {
    static const struct {
        const char *group, *name;
        int decimals, better;
    } column[] = {{"as scored, ms", "encode + render", 1, -1},
                  {"as scored, ms", "encode", 1, -1},
                  {"as scored, ms", "render", 1, -1},
                  {"as scored", "frames a second", 2, 1},
                  {"as scored", "points", 0, 0},
                  {"as sherf render does", "ms", 1, -1},
                  {"as sherf render does", "points", 0, 0}};
    context *c = t->j->c;
    page_table *to = page_add_table(c, p, "Time of an avatar and a frame");
    sherf_status status = to ? SHERF_OK : SHERF_NO_MEMORY;
    for (size_t k = 0; k < COUNT_OF(column) && status == SHERF_OK; k++)
        status =
            page_add_column(c, to, column[k].group, column[k].name, column[k].decimals, column[k].better);
    for (int i = 0; i < t->methods && status == SHERF_OK; i++) {
        timed_method *method = &t->method[i];
        page_row *row = page_add_row(c, to, "%s", method->method->label);
        if (!row) return SHERF_NO_MEMORY;
        const interval both = quartiles(t, method->ms[BOTH]);
        const interval column_value[] = {both,
                                         quartiles(t, method->ms[ENCODE]),
                                         quartiles(t, method->ms[RENDER]),
                                         interval_of(1000 / both.mean),
                                         interval_of((double)method->points[0]),
                                         quartiles(t, method->ms[SHOW]),
                                         interval_of((double)method->points[1])};
        memcpy(row->value, column_value, sizeof column_value);
    }
    return status;
}

static sherf_status notes_add(runtime *t, page *p) {
    context *c = t->j->c;
    char device[200];
    if (c->device != SHERF_DEVICE_CUDA || sherf_device_find(c->device, device, sizeof device) != SHERF_OK)
        snprintf(device, sizeof device, "the processor (%s)", isa_name(isa_best()));
    sherf_status status =
        page_add_note(c, p,
                      "Medians of %d, quartiles in brackets, after %d to warm up, the "
                      "methods in turn in one process; %s, %d thread%s, "
                      "float32. The observation is %d x %d pixels, the person takes %.1f "
                      "of the frame's %d x %d. A person without "
                      "canonical space is shown in the observed pose, so all are.",
                      t->repeats, WARM, device, c->threads, c->threads == 1 ? "" : "s",
                      t->observation->image.width, t->observation->image.height, person_share, SIDE, SIDE);
    if (status != SHERF_OK) return status;
    return page_add_note(
        c, p,
        "As scored: the network is queried for each sample near the body, and the avatar is encoded for "
        "every "
        "frame, as the release's test loop does. As sherf render does: of an avatar that was encoded before, "
        "without the samples that lie in empty space.");
}

sherf_status report_runtime(experiment_job *j, page *p) {
    runtime *t = mem_zero(j->c, 1, sizeof *t);
    const sherf_precision precision = j->c->precision;
    if (!t) return SHERF_NO_MEMORY;
    t->j = j;
    t->repeats = j->set.scale == SCALE_SMOKE ? SMOKE_REPEATS : REPEATS;
    j->c->precision = SHERF_PRECISION_FP32;
    sherf_status status = person_open(t);
    if (status == SHERF_OK) status = methods_open(t);
    if (status == SHERF_OK) status = time_all(t);
    if (status == SHERF_OK) status = table_add(t, p);
    if (status == SHERF_OK) status = notes_add(t, p);
    j->c->precision = precision;
    runtime_free(t);
    mem_free(t);
    return status == SHERF_OK ? report_end(j, p) : status;
}
