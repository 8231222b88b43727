#include "shots.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { SIZE_DEFAULT = 512, POSES_FITTED = 64 };

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
    int count, *pose = list_parse(list, &count);
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

static int from_data(session *s, const shots_wish *wish, shots *out) {
    sherf_dataset *d = NULL;
    int status = session_status(s, sherf_dataset_open(s->context, wish->data, &d));
    int person = status ? -1 : person_find(d, wish->people);
    if (!status && person < 0) status = session_failure("%s: has no person '%s'", wish->data, wish->people);
    if (!status && wish->poses && list_valid(wish->poses))
        status = data_poses(s, d, person, wish->poses, out);
    if (!status && !wish->orbit && !wish->cameras) status = data_cameras(s, d, person, wish->views, out);
    sherf_dataset_free(d);
    return status;
}

/* ---- an orbit ----
 * About the middle of the body, its up the world axis nearest to the body's own when they are within 30
 * degrees, its azimuth 0 the body's front in the first pose. */
static void rodrigues(const float r[3], double R[9]) {
    double angle = sqrt((double)r[0] * r[0] + (double)r[1] * r[1] + (double)r[2] * r[2]);
    double s = angle > 1e-8 ? 1 / angle : 0, x = r[0] * s, y = r[1] * s, z = r[2] * s;
    double cosine = cos(angle), sine = sin(angle), k = 1 - cosine;
    double M[9] = {cosine + k * x * x,   k * x * y - sine * z, k * x * z + sine * y,
                   k * x * y + sine * z, cosine + k * y * y,   k * y * z - sine * x,
                   k * x * z - sine * y, k * y * z + sine * x, cosine + k * z * z};
    memcpy(R, M, sizeof M);
}

/* The orbit's axes as the columns of B: right, up, front, in the world. */
static void orbit_axes(const sherf_pose *pose, double B[9]) {
    double root[9], up[3], front[3];
    rodrigues(pose->poses_rad, root);
    for (int i = 0; i < 3; i++) {
        up[i] = front[i] = 0;
        for (int k = 0; k < 3; k++) {
            up[i] += (double)pose->R[3 * i + k] * root[3 * k + 1];
            front[i] += (double)pose->R[3 * i + k] * root[3 * k + 2];
        }
    }
    for (int i = 0; i < 3; i++)
        if (fabs(up[i]) > cos(30 * M_PI / 180)) {
            double sign = up[i] > 0 ? 1 : -1;
            up[0] = up[1] = up[2] = 0;
            up[i] = sign;
            break;
        }
    double along = front[0] * up[0] + front[1] * up[1] + front[2] * up[2], length = 0;
    for (int i = 0; i < 3; i++) {
        front[i] -= along * up[i];
        length += front[i] * front[i];
    }
    for (int i = 0; i < 3; i++) front[i] /= sqrt(length);
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        B[3 * i] = up[j] * front[k] - up[k] * front[j];
        B[3 * i + 1] = up[i];
        B[3 * i + 2] = front[i];
    }
}

/* Middle of the box, along B's axes, of the body in its poses, and the radius of a ball about the middle that
 * holds it, less the corners of the box, which are empty. */
static int orbit_extent(session *s, const sherf_body *body, const shots *t, const double B[9],
                        float centre[3], double half[3]) {
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    int step = 1 + t->pose_count / POSES_FITTED, vertices = sherf_body_vertex_count(body);
    for (int p = 0; p < t->pose_count; p += step) {
        int status = session_status(s, sherf_body_pose(s->context, body, &t->pose[p], t->vertices_m, NULL));
        if (status) return status;
        for (int v = 0; v < vertices; v++)
            for (int a = 0; a < 3; a++) {
                const float *x = t->vertices_m + 3 * v;
                double along = x[0] * B[a] + x[1] * B[3 + a] + x[2] * B[6 + a];
                if (along < low[a]) low[a] = along;
                if (along > high[a]) high[a] = along;
            }
    }
    for (int i = 0; i < 3; i++) {
        half[i] = (high[i] - low[i]) / 2;
        centre[i] = 0;
        for (int a = 0; a < 3; a++) centre[i] += (float)(B[3 * i + a] * (low[a] + high[a]) / 2);
    }
    return EXIT_DONE;
}

static int orbit(session *s, const shots_wish *wish, const sherf_body *body, int width, int height,
                 shots *t) {
    double B[9], half[3];
    float centre[3], origin[3] = {0, 0, 0};
    orbit_axes(&t->pose[0], B);
    int status = orbit_extent(s, body, t, B, centre, half);
    if (status) return status;
    double fov = wish->fov_deg * M_PI / 180, distance = wish->distance_m;
    double aspect = (double)width / height, across = hypot(half[0], half[2]);
    if (distance <= 0) {
        double rise = half[1] > across / aspect ? half[1] : across / aspect;
        distance = 1.08 * rise / tan(fov / 2) + across; /* 8 % to spare at the part nearest to the camera */
    }
    t->camera_count = (int)wish->orbit;
    t->camera = array((size_t)t->camera_count, sizeof *t->camera);
    if (!t->camera) return EXIT_FAILED;
    for (int n = 0; n < t->camera_count; n++) {
        sherf_camera *k = &t->camera[n], upright;
        double azimuth = wish->azimuth_deg * M_PI / 180 + 2 * M_PI * n / t->camera_count;
        sherf_camera_orbit(origin, (float)distance, (float)azimuth, (float)(wish->elevation_deg * M_PI / 180),
                           (float)fov, width, height, &upright);
        /* x_camera = R B^T (x - centre) + T, with R and T in the orbit's own axes. */
        *k = upright;
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                double v = 0;
                for (int a = 0; a < 3; a++) v += (double)upright.R[3 * i + a] * B[3 * j + a];
                k->R[3 * i + j] = (float)v;
                k->T_m[i] -= (float)(v * centre[j]);
            }
    }
    return EXIT_DONE;
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

static int poses_find(session *s, const shots_wish *wish, const sherf_avatar *avatar, shots *t) {
    if (t->pose) return EXIT_DONE;
    sherf_pose *loaded = NULL;
    t->pose_count = 1;
    if (wish->poses) {
        int status = session_status(s, sherf_poses_load(s->context, wish->poses, &loaded, &t->pose_count));
        if (status) return status;
    }
    t->pose = array((size_t)t->pose_count, sizeof *t->pose);
    if (t->pose)
        memcpy(t->pose, loaded ? loaded : sherf_avatar_pose(avatar), (size_t)t->pose_count * sizeof *t->pose);
    sherf_free(loaded);
    for (int p = 0; p < t->pose_count && t->pose && !wish->their_shape; p++)
        memcpy(t->pose[p].shapes, sherf_avatar_pose(avatar)->shapes, sizeof t->pose[p].shapes);
    return t->pose ? EXIT_DONE : EXIT_FAILED;
}

static int cameras_find(session *s, const shots_wish *wish, const sherf_body *body,
                        const sherf_avatar *avatar, shots *t) {
    int width = 0, height = 0;
    if (wish->size) size_parse(wish->size, &width, &height);
    if (wish->orbit) {
        if (!width) width = SIZE_DEFAULT;
        return orbit(s, wish, body, width, height ? height : width, t);
    }
    if (!t->camera) {
        sherf_camera *loaded = NULL;
        t->camera_count = 1;
        if (wish->cameras) {
            int status =
                session_status(s, sherf_cameras_load(s->context, wish->cameras, &loaded, &t->camera_count));
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
                return session_failure("%s: no width and height in it; give --size WxH", wish->cameras);
            k->width_px = width;
            k->height_px = height;
        }
        if (width) camera_scale(k, width, height);
    }
    return EXIT_DONE;
}

int shots_create(session *s, const shots_wish *wish, const sherf_body *body, const sherf_avatar *avatar,
                 shots *out) {
    enum { SHOTS_MOST = 1000000 };
    *out = (shots){.every = wish->every};
    out->vertices_m = array((size_t)sherf_body_vertex_count(body), 3 * sizeof *out->vertices_m);
    if (!out->vertices_m) return EXIT_FAILED;
    int status = wish->data ? from_data(s, wish, out) : EXIT_DONE;
    if (!status) status = poses_find(s, wish, avatar, out);
    if (!status) status = cameras_find(s, wish, body, avatar, out);
    if (status) return status;
    int64_t most = out->pose_count > out->camera_count ? out->pose_count : out->camera_count;
    if (wish->every) most = (int64_t)out->pose_count * out->camera_count;
    if (most > SHOTS_MOST) return session_failure("%lld frames: that is too many", (long long)most);
    out->count = (int)most;
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
