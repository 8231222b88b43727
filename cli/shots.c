/* Poses and cameras of frames: from files, from a data set's person, on an orbit, or the avatar's own. */
#include "shots.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { SIZE_DEFAULT = 512 };

void shots_free(shots *t) {
    free(t->pose);
    free(t->camera);
    free(t->vertices_m);
    *t = (shots){0};
}

const sherf_pose *shots_pose(const shots *t, int n) {
    return &t->pose[t->every ? n / t->camera_count : n % t->pose_count];
}

const sherf_camera *shots_camera(const shots *t, int n) {
    return &t->camera[n % t->camera_count];
}

static void *array(size_t count, size_t size) {
    void *p = calloc(count ? count : 1, size);
    if (!p) session_failure("out of memory");
    return p;
}

/* ---- a data set's person ---- */
static int person_find(const sherf_dataset *d, const char *name) {
    int people = sherf_dataset_person_count(d);
    for (int i = 0; i < people; i++)
        if (strcmp(sherf_dataset_person(d, i), name) == 0) return i;
    char *end;
    long line = strtol(name, &end, 10);
    return *name && !*end && line >= 0 && line < people ? (int)line : -1;
}

static int data_poses(session *s, const sherf_dataset *d, int person, const char *list, shots *out) {
    int count = 0, *pose = list_parse(list, &count);
    if (!pose) return session_failure("out of memory");
    out->pose = pose ? array((size_t)count, sizeof *out->pose) : NULL;
    int status = out->pose ? EXIT_DONE : EXIT_FAILED;
    for (int i = 0; i < count && !status; i++)
        status = session_status(s, sherf_dataset_pose(s->context, d, person, pose[i], &out->pose[i]));
    out->pose_count = count;
    free(pose);
    return status;
}

static int data_cameras(session *s, const sherf_dataset *d, int person, const char *list, shots *out) {
    char all[32];
    snprintf(all, sizeof all, "0:1:%d", sherf_dataset_view_count(d, person));
    int count = 0, *view = list_parse(list ? list : all, &count);
    if (!view) return session_failure("%s has no views", sherf_dataset_person(d, person));
    out->camera = array((size_t)count, sizeof *out->camera);
    int status = out->camera ? EXIT_DONE : EXIT_FAILED;
    for (int i = 0; i < count && !status; i++)
        status = session_status(s, sherf_dataset_camera(s->context, d, person, view[i], &out->camera[i]));
    out->camera_count = count;
    free(view);
    return status;
}

static int from_data(session *s, const shots_request *request, shots *out) {
    sherf_dataset *d = NULL;
    int status = session_status(s, sherf_dataset_open(s->context, request->data, &d));
    int person = status ? -1 : person_find(d, request->people);
    if (!status && person < 0)
        status = session_failure("%s: has no person '%s'", request->data, request->people);
    if (!status && request->poses && list_valid(request->poses))
        status = data_poses(s, d, person, request->poses, out);
    if (!status && !request->orbit && !request->cameras)
        status = data_cameras(s, d, person, request->views, out);
    sherf_dataset_free(d);
    return status;
}

static int orbit(session *s, const shots_request *request, const sherf_body *body, int width, int height,
                 shots *t) {
    const double degree = M_PI / 180;
    const sherf_orbit_options o = {.azimuth_rad = request->azimuth_deg * degree,
                                   .elevation_rad = request->elevation_deg * degree,
                                   .distance_m = request->distance_m,
                                   .fov_rad = request->fov_deg * degree,
                                   .width_px = width,
                                   .height_px = height};
    t->camera_count = (int)request->orbit;
    t->camera = array((size_t)t->camera_count, sizeof *t->camera);
    if (!t->camera) return EXIT_FAILED;
    return session_status(
        s, sherf_cameras_orbit(s->context, body, t->pose, t->pose_count, &o, t->camera_count, t->camera));
}

/* ---- putting it together ---- */
static void camera_scale(sherf_camera *k, int width, int height) {
    if (!height) height = (int)lround((double)k->height_px * width / k->width_px);
    if (height < 1) height = 1;
    for (int i = 0; i < 3; i++) {
        k->K[i] *= (float)width / (float)k->width_px;
        k->K[3 + i] *= (float)height / (float)k->height_px;
    }
    k->width_px = width;
    k->height_px = height;
}

static int poses_find(session *s, const shots_request *request, const sherf_avatar *avatar, shots *t) {
    if (t->pose) return EXIT_DONE;
    sherf_pose *loaded = NULL;
    t->pose_count = 1;
    if (request->poses) {
        int status = session_status(s, sherf_poses_load(s->context, request->poses, &loaded, &t->pose_count));
        if (status) return status;
    }
    t->pose = array((size_t)t->pose_count, sizeof *t->pose);
    if (t->pose)
        memcpy(t->pose, loaded ? loaded : sherf_avatar_pose(avatar), (size_t)t->pose_count * sizeof *t->pose);
    sherf_free(loaded);
    for (int p = 0; p < t->pose_count && t->pose && !request->their_shape; p++)
        memcpy(t->pose[p].shapes, sherf_avatar_pose(avatar)->shapes, sizeof t->pose[p].shapes);
    return t->pose ? EXIT_DONE : EXIT_FAILED;
}

static int cameras_find(session *s, const shots_request *request, const sherf_body *body,
                        const sherf_avatar *avatar, shots *t) {
    int width = 0, height = 0;
    if (request->size) size_parse(request->size, &width, &height);
    if (request->orbit) {
        if (!width) width = SIZE_DEFAULT;
        return orbit(s, request, body, width, height ? height : width, t);
    }
    if (!t->camera) {
        sherf_camera *loaded = NULL;
        t->camera_count = 1;
        if (request->cameras) {
            int status = session_status(
                s, sherf_cameras_load(s->context, request->cameras, &loaded, &t->camera_count));
            if (status) return status;
        }
        t->camera = array((size_t)t->camera_count, sizeof *t->camera);
        if (t->camera)
            memcpy(t->camera, loaded ? loaded : sherf_avatar_camera(avatar),
                   (size_t)t->camera_count * sizeof *t->camera);
        sherf_free(loaded);
        if (!t->camera) return EXIT_FAILED;
    }
    for (int i = 0; i < t->camera_count; i++) {
        sherf_camera *k = &t->camera[i];
        if (k->width_px < 1 || k->height_px < 1) { /* a file may leave that out */
            if (!height)
                return session_failure("%s: no width and height in it; give --size WxH", request->cameras);
            k->width_px = width;
            k->height_px = height;
        }
        if (width) camera_scale(k, width, height);
    }
    return EXIT_DONE;
}

int shots_create(session *s, const shots_request *request, const sherf_body *body, const sherf_avatar *avatar,
                 shots *out) {
    enum { SHOTS_MAX = 1000000 };
    *out = (shots){.every = request->every};
    out->vertices_m = array((size_t)sherf_body_vertex_count(body), 3 * sizeof *out->vertices_m);
    if (!out->vertices_m) return EXIT_FAILED;
    int status = request->data ? from_data(s, request, out) : EXIT_DONE;
    if (!status) status = poses_find(s, request, avatar, out);
    if (!status) status = cameras_find(s, request, body, avatar, out);
    if (status) return status;
    int64_t max = out->pose_count > out->camera_count ? out->pose_count : out->camera_count;
    if (request->every) max = (int64_t)out->pose_count * out->camera_count;
    if (max > SHOTS_MAX) return session_failure("%lld frames: that is too many", (long long)max);
    out->count = (int)max;
    return EXIT_DONE;
}

int shots_depth_range(session *s, const shots *t, const sherf_body *body, int n, float range_m[2]) {
    const sherf_camera *k = shots_camera(t, n);
    int status = session_status(s, sherf_body_pose(s->context, body, shots_pose(t, n), t->vertices_m, NULL));
    range_m[0] = INFINITY;
    range_m[1] = -INFINITY;
    for (int v = 0; v < sherf_body_vertex_count(body) && !status; v++) {
        const float *x = t->vertices_m + 3 * v;
        float z = k->R[6] * x[0] + k->R[7] * x[1] + k->R[8] * x[2] + k->T_m[2];
        range_m[0] = fminf(range_m[0], z);
        range_m[1] = fmaxf(range_m[1], z);
    }
    return status;
}
