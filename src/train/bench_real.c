/* sherf bench, the work that people wait for: an avatar of a person by the model that ships, its first and
 * further frames, and its export. */
#include <math.h>
#include <stdlib.h>
#include <unistd.h>

#include "train/bench.h"

bool bench_has_real(const bench *b) {
    return b->real_model && b->real_body && b->real_observation;
}

static sherf_status avatar_once(bench *b, void *arg) {
    sherf_avatar **avatar = arg;
    sherf_avatar_free(*avatar);
    *avatar = NULL;
    return sherf_avatar_create(b->c, b->real_model, b->real_body, b->real_observation, avatar);
}

sherf_status bench_real_avatar(bench *b, double *ms) {
    sherf_avatar *avatar = NULL;
    const sherf_status status = bench_timed(b, avatar_once, &avatar, ms);
    sherf_avatar_free(avatar);
    return status;
}

typedef struct {
    sherf_avatar *avatar;
    sherf_camera camera;
    sherf_frame frame;
} frame_job;

static sherf_status frame_once(bench *b, void *arg) {
    frame_job *j = arg;
    return sherf_render(b->c, j->avatar, b->real_body, sherf_observation_pose(b->real_observation),
                        &j->camera, NULL, &j->frame);
}

/* Each run has its own avatar, since an avatar keeps what its first frame computes. */
static sherf_status first_once(bench *b, frame_job *j, double *ms) {
    sherf_status status = avatar_once(b, &j->avatar);
    const double from = time_seconds();
    if (status == SHERF_OK) status = frame_once(b, j);
    *ms = 1e3 * (time_seconds() - from);
    return status;
}

enum { FIRSTS = 3 };
static double between(const double x[FIRSTS]) {
    return fmax(fmin(x[0], x[1]), fmin(fmax(x[0], x[1]), x[2]));
}

sherf_status bench_real_render(bench *b, bench_real_times *out) {
    const sherf_orbit_options orbit = {.azimuth_rad = 0.5, .width_px = b->size, .height_px = b->size};
    const sherf_pose *pose = sherf_observation_pose(b->real_observation);
    const int firsts = b->repeats == 1 ? 1 : FIRSTS;
    frame_job job = {0};
    double first[FIRSTS];
    sherf_status status = sherf_cameras_orbit(b->c, b->real_body, pose, 1, &orbit, 1, &job.camera);
    if (status == SHERF_OK) status = bench_timed(b, avatar_once, &job.avatar, &out->avatar_ms);
    for (int i = 0; i < firsts && status == SHERF_OK; i++) status = first_once(b, &job, &first[i]);
    if (status == SHERF_OK) {
        out->first_frame_ms = firsts < FIRSTS ? first[0] : between(first);
        status = bench_timed(b, frame_once, &job, &out->frame_ms);
    }
    sherf_frame_free(&job.frame);
    sherf_avatar_free(job.avatar);
    return status;
}

typedef struct {
    sherf_avatar *avatar;
    char *path;
    sherf_exported exported;
} export_timed;

static sherf_status export_once(bench *b, void *arg) {
    export_timed *j = arg;
    return sherf_export(b->c, j->avatar, b->real_body, NULL, j->path, &j->exported);
}

sherf_status bench_real_export(bench *b, double *ms, double parts_ms[4]) {
    const char *folder = getenv("TMPDIR");
    export_timed job = {0};
    job.path =
        mem_format(b->c, "%s/sherf-bench-%ld.glb", folder && *folder ? folder : "/tmp", (long)getpid());
    sherf_status status = job.path ? avatar_once(b, &job.avatar) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = bench_timed(b, export_once, &job, ms);
    for (int i = 0; i < 4; i++) parts_ms[i] = 1e3 * job.exported.seconds[i];
    if (job.path) unlink(job.path);
    mem_free(job.path);
    sherf_avatar_free(job.avatar);
    return status;
}
