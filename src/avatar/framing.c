/* Cameras whose picture shows the whole person, or the whole motion. */
#include <math.h>
#include <string.h>

#include "base/vector3.h"
#include "motion/motion.h"
#include "scene/scene.h"

enum { POSES_FITTED = 64, SIZE_DEFAULT = 512 };
static const double fov_default = 30 * M_PI / 180, spare = 1.08, turn_default_s = 8;

/* An upright camera in the axes B (columns left, up, front), around `centre` of the world. */
static void camera_around(const double B[9], const double centre[3], double distance, double azimuth,
                          double elevation, double fov, int width, int height, sherf_camera *out) {
    const float origin[3] = {0, 0, 0};
    sherf_camera upright;
    sherf_camera_orbit(origin, (float)distance, (float)azimuth, (float)elevation, (float)fov, width, height,
                       &upright);
    *out = upright; /* x_camera = R B^T (x - centre) + T, with R and T in the axes B */
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double v = 0;
            for (int a = 0; a < 3; a++) v += (double)upright.R[3 * i + a] * B[3 * j + a];
            out->R[3 * i + j] = (float)v;
            out->T_m[i] -= (float)(v * (float)centre[j]);
        }
}

/* The distance at which a camera on a circle sees all of an upright cylinder about its centre, near side
 * included, with a margin of 8 %. */
static double orbit_distance(double half_height, double radius, double fov, double aspect) {
    return spare * fmax(half_height, radius / aspect) / tan(fov / 2) + radius;
}

/* ---- round a body in some poses ---- */

/* Middle and half lengths of the box, along B's axes, of the body's vertices. */
static sherf_status body_extent(context *c, const body_model *body, const sherf_pose *poses, int count,
                                const double B[9], double centre[3], double half[3]) {
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    float *vertices = mem_alloc(c, (size_t)body->vertices, 3 * sizeof *vertices);
    sherf_status status = vertices ? SHERF_OK : SHERF_NO_MEMORY;
    for (int p = 0; p < count && !status; p += 1 + count / POSES_FITTED) {
        status = sherf_body_pose(c, body, &poses[p], vertices, NULL);
        for (int v = 0; v < body->vertices && !status; v++)
            for (int a = 0; a < 3; a++) {
                const float *x = vertices + 3 * v;
                double along = x[0] * B[a] + x[1] * B[3 + a] + x[2] * B[6 + a];
                if (along < low[a]) low[a] = along;
                if (along > high[a]) high[a] = along;
            }
    }
    for (int i = 0; i < 3; i++) {
        half[i] = (high[i] - low[i]) / 2;
        centre[i] = 0;
        for (int a = 0; a < 3; a++) centre[i] += B[3 * i + a] * (low[a] + high[a]) / 2;
    }
    mem_free(vertices);
    return status;
}

sherf_status sherf_cameras_orbit(sherf_context *c, const sherf_body *body, const sherf_pose *poses,
                                 int pose_count, const sherf_orbit_options *o, int cameras,
                                 sherf_camera *out) {
    double B[9], centre[3], half[3], distance = o->distance_m,
                                     fov = o->fov_rad > 0 ? o->fov_rad : fov_default;
    if (pose_count < 1 || cameras < 1 || o->width_px < 1 || o->height_px < 1 || !(fov < 3.1))
        return failure(c, SHERF_BAD_ARGUMENT, "orbit: no poses, cameras or pixels, or too wide a view");
    pose_axes(&poses[0], B);
    sherf_status status = body_extent(c, body, poses, pose_count, B, centre, half);
    if (status) return status;
    if (!(distance > 0))
        distance = orbit_distance(half[1], hypot(half[0], half[2]), fov, (double)o->width_px / o->height_px);
    for (int n = 0; n < cameras; n++)
        camera_around(B, centre, distance, o->azimuth_rad + 2 * M_PI * n / cameras, o->elevation_rad, fov,
                      o->width_px, o->height_px, &out[n]);
    return SHERF_OK;
}

/* ---- along with a motion ---- The person is represented by its joints in every frame, each a ball that
 * holds the flesh around it. */

static const double ball_m[BODY_JOINTS] = {
    [0] = 0.2,   [3] = 0.18,  [6] = 0.18,  [9] = 0.2,   [4] = 0.12,  [5] = 0.12,  [7] = 0.1,   [8] = 0.1,
    [10] = 0.12, [11] = 0.12, [12] = 0.15, [15] = 0.24, [20] = 0.14, [21] = 0.14, [22] = 0.12, [23] = 0.12};

/* Bounds that balls put on the camera's place, in its axes: a ball must satisfy a < tx w to be in the
 * picture. */
typedef struct {
    double B[9], fov, tx, ty; /* tangents of half the view */
    int width, height;
    double axis[3][3]; /* right, down, forward of the camera, in the world */
    double side[2][2]; /* by right and down: max of a - t w + r s, min of a + t w - r s; s = sqrt(1 + t^2) */
    double height_range[2], radius; /* along and about the vertical, from the path */
} view;

static void view_aim(view *w, double azimuth, double elevation) {
    static const double none[3];
    sherf_camera k;
    camera_around(w->B, none, 0, azimuth, elevation, w->fov, w->width, w->height, &k);
    for (int i = 0; i < 9; i++) w->axis[i / 3][i % 3] = k.R[i];
}

/* Adds a ball, placed relative to the path. */
static void view_take(view *w, const double x[3], double r) {
    const double t[2] = {w->tx, w->ty}, up[3] = {w->B[1], w->B[4], w->B[7]};
    double depth = dot3(w->axis[2], x), rise = dot3(up, x);
    for (int i = 0; i < 2; i++) {
        double a = dot3(w->axis[i], x), s = r * sqrt(1 + t[i] * t[i]);
        w->side[i][0] = fmax(w->side[i][0], a - t[i] * depth + s);
        w->side[i][1] = fmin(w->side[i][1], a + t[i] * depth - s);
    }
    w->height_range[0] = fmin(w->height_range[0], rise - r);
    w->height_range[1] = fmax(w->height_range[1], rise + r);
    w->radius = fmax(w->radius, sqrt(fmax(0, dot3(x, x) - rise * rise)) + r);
}

static void view_take_clip(view *w, const sherf_motion *motion, const float (*path)[3]) {
    w->side[0][0] = w->side[1][0] = w->height_range[1] = -INFINITY;
    w->side[0][1] = w->side[1][1] = w->height_range[0] = INFINITY;
    w->radius = 0;
    for (int f = 0; f < motion->clip.frames; f++) {
        double joint[BODY_JOINTS][3];
        skeleton_joints(&motion->skeleton, (const float(*)[4])motion->clip.turn[f], motion->clip.pelvis_m[f],
                        joint);
        for (int j = 0; j < BODY_JOINTS; j++) {
            if (!(ball_m[j] > 0)) continue;
            for (int a = 0; a < 3; a++) joint[j][a] -= path[f][a];
            view_take(w, joint[j], ball_m[j]);
        }
    }
}

/* Where a camera with these axes must stand to just show all balls. It is centred on them sideways and up,
 * and as near as the tighter of the two directions allows. A `distance` other than 0 is kept from the middle
 * of the path instead. */
static void view_place(const view *w, double distance, double place[3]) {
    const double t[2] = {w->tx, w->ty};
    double across[2], depth = INFINITY;
    for (int i = 0; i < 2; i++) {
        across[i] = (w->side[i][0] + w->side[i][1]) / 2;
        depth = fmin(depth, (w->side[i][1] - w->side[i][0]) / (2 * t[i]));
    }
    if (distance > 0) depth = -distance;
    for (int a = 0; a < 3; a++)
        place[a] = across[0] * w->axis[0][a] + across[1] * w->axis[1][a] + depth * w->axis[2][a];
}

static void camera_stand(sherf_camera *k, const double place[3]) {
    for (int i = 0; i < 3; i++)
        k->T_m[i] =
            (float)-(k->R[3 * i] * place[0] + k->R[3 * i + 1] * place[1] + k->R[3 * i + 2] * place[2]);
}

/* The direction that the picture was taken from, relative to the body in it. */
static void observed_aim(const sherf_avatar *avatar, const skeleton *s, double *azimuth, double *elevation) {
    float turn[BODY_JOINTS][4], pelvis[3], camera[3];
    double B[9], own[3], length;
    pose_axes(sherf_avatar_pose(avatar), B);
    pose_to_turns(sherf_avatar_pose(avatar), s, turn, pelvis);
    camera_position(sherf_avatar_camera(avatar), camera);
    for (int i = 0; i < 3; i++) {
        own[i] = 0;
        for (int a = 0; a < 3; a++) own[i] += B[3 * a + i] * ((double)camera[a] - pelvis[a]);
    }
    length = sqrt(dot3(own, own));
    *azimuth = atan2(own[0], own[2]);
    *elevation = length > 0 ? asin(fmax(-0.99, fmin(0.99, own[1] / length))) : 0;
}

static void observed_size(const sherf_camera *k, const sherf_animate_options *o, int *width, int *height) {
    bool theirs = o->camera == SHERF_CAMERA_OBSERVATION;
    *width = o->width_px > 0 ? o->width_px : theirs ? k->width_px : SIZE_DEFAULT;
    *height = o->height_px > 0 ? o->height_px
              : theirs         ? (int)lround((double)k->height_px * *width / k->width_px)
                               : *width;
    if (*height < 1) *height = 1;
}

/* The path that the camera follows: its fixed middle, or the pelvis's path, smoothed. */
static void path_find(const sherf_motion *motion, bool along, float (*path)[3]) {
    const clip *k = &motion->clip;
    if (along && k->frames > 1) {
        path_smooth((const float(*)[3])k->pelvis_m, k->frames, 0.5 * k->fps, path);
        return;
    }
    double sum[3] = {0};
    for (int f = 0; f < k->frames; f++)
        for (int a = 0; a < 3; a++) sum[a] += k->pelvis_m[f][a];
    for (int f = 0; f < k->frames; f++)
        for (int a = 0; a < 3; a++) path[f][a] = (float)(sum[a] / k->frames);
}

static void aim_all(const sherf_motion *motion, const sherf_animate_options *o, view *w, double azimuth,
                    double elevation, const float (*path)[3], sherf_camera *out) {
    bool orbit = o->camera == SHERF_CAMERA_ORBITING;
    double turn_s = o->turn_s > 0 ? o->turn_s : turn_default_s, place[3], distance = o->distance_m;
    view_aim(w, azimuth, elevation);
    view_take_clip(w, motion, path);
    view_place(w, distance, place);
    double half = (w->height_range[1] - w->height_range[0]) / 2;
    if (!(distance > 0)) distance = orbit_distance(half, w->radius, w->fov, (double)w->width / w->height);
    for (int f = 0; f < motion->clip.frames; f++) {
        double at[3], rise = (w->height_range[0] + w->height_range[1]) / 2;
        double turned = orbit ? 2 * M_PI * f / motion->clip.fps / turn_s : 0;
        for (int a = 0; a < 3; a++) at[a] = path[f][a] + (orbit ? rise * w->B[3 * a + 1] : place[a]);
        camera_around(w->B, at, orbit ? distance : 0, azimuth + turned, elevation, w->fov, w->width,
                      w->height, &out[f]);
        if (!orbit) camera_stand(&out[f], at);
    }
}

sherf_status sherf_animate_cameras(sherf_context *c, const sherf_avatar *avatar, const sherf_body *body,
                                   const sherf_motion *motion, const sherf_animate_options *options,
                                   sherf_camera *out) {
    static const sherf_animate_options none;
    const sherf_animate_options *o = options ? options : &none;
    const sherf_camera *theirs = sherf_avatar_camera(avatar);
    view w = {0};
    double azimuth = o->azimuth_rad, elevation = o->elevation_rad;
    sherf_pose first;
    observed_size(theirs, o, &w.width, &w.height);
    if (o->camera == SHERF_CAMERA_OBSERVATION) {
        for (int f = 0; f < motion->clip.frames; f++) {
            out[f] = *theirs;
            camera_resize(&out[f], w.width, w.height);
        }
        return SHERF_OK;
    }
    w.fov = o->fov_rad > 0 ? o->fov_rad : 2 * atan(0.5 * theirs->height_px / fabs((double)theirs->K[4]));
    if (!(w.fov > 0.01 && w.fov < 3.1) || !isfinite(azimuth) || !(fabs(elevation) < 1.57) ||
        !(o->distance_m >= 0 && o->distance_m < 1e5))
        return failure(c, SHERF_BAD_ARGUMENT, "animate: view, elevation or distance out of range");
    float(*path)[3] = mem_alloc(c, (size_t)motion->clip.frames, sizeof *path);
    if (!path) return SHERF_NO_MEMORY;
    if (!o->aimed) observed_aim(avatar, &motion->skeleton, &azimuth, &elevation);
    sherf_motion_pose(motion, 0, &first);
    pose_axes(&first, w.B);
    w.ty = tan(w.fov / 2) / spare;
    w.tx = w.ty * w.width / w.height;
    path_find(motion, o->camera != SHERF_CAMERA_FIXED, path);
    aim_all(motion, o, &w, azimuth, elevation, (const float(*)[3])path, out);
    mem_free(path);
    return SHERF_OK;
}
