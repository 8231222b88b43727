/* The scene: avatars and motions, the camera's place relative to them, and recently posed bodies. */
#include <cjson/cJSON.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/vector3.h"
#include "io/image.h"
#include "scene/scene.h"
#include "viewer/viewer.h"

static const double fov_rad = 30 * M_PI / 180; /* vertical, at zoom 1 in a square picture */

/* ---- made once ---- */
static cJSON *avatar_json(const sherf_viewer_avatar *a, int number) {
    const sherf_image *image = &a->avatar->picture[0].image;
    char plain[32];
    cJSON *json = cJSON_CreateObject();
    snprintf(plain, sizeof plain, "avatar %d", number + 1);
    cJSON_AddStringToObject(json, "name", a->name ? a->name : plain);
    cJSON_AddBoolToObject(json, "picture", image->data != NULL);
    cJSON_AddNumberToObject(json, "width", image->width);
    cJSON_AddNumberToObject(json, "height", image->height);
    cJSON_AddBoolToObject(json, "baked", a->avatar->form != NULL);
    return json;
}

static sherf_status about_make(context *c, viewer_scene *s, const sherf_viewer_options *o) {
    static const char *const own[VIEWER_OWN_MOTIONS] = {"picture's pose", "T-pose"};
    cJSON *json = cJSON_CreateObject(), *avatars = cJSON_AddArrayToObject(json, "avatars"),
          *motions = cJSON_AddArrayToObject(json, "motions");
    for (int i = 0; i < s->avatar_count; i++) cJSON_AddItemToArray(avatars, avatar_json(&s->avatars[i], i));
    for (int i = 0; i < s->motion_count; i++) {
        cJSON *motion = cJSON_CreateObject();
        const char *name = i < VIEWER_OWN_MOTIONS ? own[i] : o->motions[i - VIEWER_OWN_MOTIONS].name;
        cJSON_AddStringToObject(motion, "name", name ? name : "motion");
        cJSON_AddNumberToObject(motion, "frames", s->motions[i].count);
        cJSON_AddNumberToObject(motion, "fps", s->motions[i].fps);
        cJSON_AddItemToArray(motions, motion);
    }
    cJSON_AddNumberToObject(json, "side", s->side_max);
    cJSON_AddNumberToObject(json, "film_side",
                            s->side_max < VIEWER_FILM_SIDE ? s->side_max : VIEWER_FILM_SIDE);
    cJSON_AddNumberToObject(json, "film_long", VIEWER_FILM_LONG);
    cJSON_AddNumberToObject(json, "film_frames", VIEWER_FILM_FRAMES);
    cJSON_AddStringToObject(json, "version", SHERF_VERSION);
    char *text = avatars && motions ? cJSON_PrintUnformatted(json) : NULL;
    if (text) s->about = mem_string(c, text);
    cJSON_free(text);
    cJSON_Delete(json);
    return s->about ? SHERF_OK : failure(c, SHERF_NO_MEMORY, "out of memory");
}

static sherf_status options_check(context *c, const sherf_viewer_options *o) {
    if (o->avatar_count < 1 || o->avatar_count > VIEWER_AVATARS)
        return failure(c, SHERF_BAD_ARGUMENT, "viewer: %d avatars, must be 1 to %d", o->avatar_count,
                       VIEWER_AVATARS);
    if (o->motion_count < 0 || o->motion_count > VIEWER_MOTIONS)
        return failure(c, SHERF_BAD_ARGUMENT, "viewer: %d motions, must be at most %d", o->motion_count,
                       VIEWER_MOTIONS);
    for (int i = 0; i < o->motion_count; i++)
        if (o->motions[i].count < 1 || !(o->motions[i].fps >= 0 && o->motions[i].fps <= 1000))
            return failure(c, SHERF_BAD_ARGUMENT, "viewer: motion %d has %d poses, %g a second", i,
                           o->motions[i].count, o->motions[i].fps);
    if (o->size_px && (o->size_px < 64 || o->size_px > VIEWER_SIDE_MAX))
        return failure(c, SHERF_BAD_ARGUMENT, "viewer: pictures of %d pixels, must be 64 to %d", o->size_px,
                       VIEWER_SIDE_MAX);
    for (int i = 0; i < o->avatar_count; i++)
        if (o->avatars[i].body->fingerprint != o->avatars[i].avatar->body_fingerprint)
            return failure(c, SHERF_MISMATCH, "viewer: avatar %d was made with another body", i);
    return SHERF_OK;
}

sherf_status scene_create(context *c, const sherf_viewer_options *o, viewer_scene *s) {
    *s = (viewer_scene){0};
    pthread_mutex_init(&s->framing_lock, NULL);
    sherf_status status = options_check(c, o);
    if (status != SHERF_OK) return status;
    s->avatar_count = o->avatar_count;
    s->motion_count = VIEWER_OWN_MOTIONS + o->motion_count;
    s->side_max = o->size_px ? o->size_px : 1024;
    s->detail = o->detail != SHERF_DETAIL_OFF;
    s->avatars = mem_alloc(c, (size_t)s->avatar_count, sizeof *s->avatars);
    s->motions = mem_zero(c, (size_t)s->motion_count, sizeof *s->motions);
    s->framings = mem_zero(c, (size_t)s->avatar_count * (size_t)s->motion_count, sizeof *s->framings);
    if (!s->avatars || !s->motions || !s->framings) return SHERF_NO_MEMORY;
    memcpy(s->avatars, o->avatars, (size_t)s->avatar_count * sizeof *s->avatars);
    sherf_pose_identity(&s->rest);
    s->motions[0] = (viewer_motion){.count = 1}; /* each avatar's own pose */
    s->motions[1] = (viewer_motion){.poses = &s->rest, .count = 1};
    for (int i = 0; i < o->motion_count; i++) {
        const sherf_viewer_motion *motion = &o->motions[i];
        s->motions[VIEWER_OWN_MOTIONS + i] =
            (viewer_motion){motion->name, motion->poses, motion->count, motion->fps};
    }
    return about_make(c, s, o);
}

void scene_free(viewer_scene *s) {
    pthread_mutex_destroy(&s->framing_lock);
    for (int i = 0; i < VIEWER_POSED; i++) posed_body_free(s->posed[i].body);
    mem_free(s->avatars);
    mem_free(s->motions);
    mem_free(s->framings);
    mem_free(s->about);
    *s = (viewer_scene){0};
}

const char *request_misfit(const viewer_scene *s, const viewer_request *r) {
    const int shorter = r->width < r->height ? r->width : r->height;
    if (r->avatar >= s->avatar_count) return "avatar: there is no such one";
    if (r->motion >= s->motion_count) return "motion: there is no such one";
    if (r->frame >= s->motions[r->motion].count) return "frame: the motion has no such one";
    if (shorter > s->side_max || r->width > 2 * s->side_max || r->height > 2 * s->side_max)
        return "w, h: more pixels than the viewer makes";
    return NULL;
}

sherf_pose scene_pose(const viewer_scene *s, int avatar, int motion, int frame) {
    const sherf_pose *own = sherf_avatar_pose(s->avatars[avatar].avatar);
    sherf_pose pose = motion == 0 ? *own : s->motions[motion].poses[frame];
    memcpy(pose.shapes, own->shapes, sizeof pose.shapes);
    return pose;
}

/* ---- camera ----
 * Up is the world axis nearest to the body's own if they are within 30 degrees; azimuth 0 is the body's front
 * in its first pose. */
static void body_axes(const sherf_pose *pose, double B[9]) {
    float root[9];
    double up[3], front[3];
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
    double along = dot3(front, up), length = 0;
    for (int i = 0; i < 3; i++) {
        front[i] -= along * up[i];
        length += front[i] * front[i];
    }
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        B[3 * i] = (up[j] * front[k] - up[k] * front[j]) / sqrt(length);
        B[3 * i + 1] = up[i];
    }
    for (int i = 0; i < 3; i++) B[3 * i + 2] = front[i] / sqrt(length);
}

/* Where the root joint goes. It rotates about itself, so its place in SMPL space depends on the shape only.
 */
static void root_world(const posed_body *p, float out[3]) {
    for (int i = 0; i < 3; i++) {
        out[i] = p->Th[i];
        for (int k = 0; k < 3; k++) out[i] += p->R[3 * i + k] * p->joints_smpl[0][k];
    }
}

/* The root's displacement along the ground since the first frame, in world axes. */
static void root_way(const viewer_framing *f, const float root_m[3], float way[3]) {
    double up = 0;
    for (int i = 0; i < 3; i++) up += ((double)root_m[i] - f->root_m[i]) * f->axes[3 * i + 1];
    for (int i = 0; i < 3; i++) way[i] = (float)((double)root_m[i] - f->root_m[i] - up * f->axes[3 * i + 1]);
}

void scene_root_way(const viewer_framing *f, const posed_body *p, float way[3]) {
    float root[3];
    root_world(p, root);
    root_way(f, root, way);
}

/* Widens [low, high], along the body's axes and moving with the root, by the posed body. */
static void extent_add(const viewer_framing *f, const body_model *body, const posed_body *p,
                       float *vertices_world, double low[3], double high[3]) {
    float way[3];
    scene_root_way(f, p, way);
    body_vertices_world(body, p, vertices_world);
    for (int v = 0; v < body->vertices; v++)
        for (int a = 0; a < 3; a++) {
            const float *x = vertices_world + 3 * (size_t)v;
            double along = 0;
            for (int i = 0; i < 3; i++) along += ((double)x[i] - way[i]) * f->axes[3 * i + a];
            low[a] = along < low[a] ? along : low[a];
            high[a] = along > high[a] ? along : high[a];
        }
}

static sherf_status framing_make(context *c, const viewer_scene *s, int avatar, int motion,
                                 viewer_framing *f) {
    enum { LOOKED_AT = 12 };
    const body_model *body = s->avatars[avatar].body;
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    int count = s->motions[motion].count, looks = count < LOOKED_AT ? count : LOOKED_AT;
    float *vertices = mem_alloc(c, (size_t)body->vertices, 3 * sizeof *vertices);
    sherf_status status = vertices ? SHERF_OK : SHERF_NO_MEMORY;
    for (int i = 0; i < looks && status == SHERF_OK; i++) {
        sherf_pose pose = scene_pose(s, avatar, motion, (int)((int64_t)i * count / looks));
        posed_body *p = NULL;
        if (i == 0) body_axes(&pose, f->axes);
        status = posed_body_create(c, body, pose.poses_rad, pose.shapes, pose.R, pose.Th_m, &p);
        if (status == SHERF_OK && i == 0) root_world(p, f->root_m);
        if (status == SHERF_OK) extent_add(f, body, p, vertices, low, high);
        posed_body_free(p);
    }
    mem_free(vertices);
    if (status != SHERF_OK) return status;
    for (int i = 0; i < 3; i++) f->half_m[i] = (high[i] - low[i]) / 2;
    for (int i = 0; i < 3; i++) {
        double x = 0;
        for (int a = 0; a < 3; a++) x += f->axes[3 * i + a] * (low[a] + high[a]) / 2;
        f->centre_m[i] = (float)x;
    }
    double across = hypot(f->half_m[0], f->half_m[2]);
    f->distance_m = 1.08 * fmax(f->half_m[1], across) / tan(fov_rad / 2) + across;
    f->known = true;
    return SHERF_OK;
}

sherf_status scene_framing(context *c, viewer_scene *s, int avatar, int motion, const viewer_framing **out) {
    viewer_framing *f = &s->framings[avatar * s->motion_count + motion];
    pthread_mutex_lock(&s->framing_lock);
    sherf_status status = f->known ? SHERF_OK : framing_make(c, s, avatar, motion, f);
    pthread_mutex_unlock(&s->framing_lock);
    *out = f;
    return status;
}

void scene_camera(const viewer_scene *s, const viewer_framing *f, const viewer_request *r,
                  sherf_camera *camera, float *scale_m) {
    const float origin[3] = {0, 0, 0};
    sherf_camera upright;
    sherf_camera_orbit(origin, (float)f->distance_m, r->azimuth_rad, r->elevation_rad, (float)fov_rad,
                       r->width, r->height, &upright);
    /* At zoom 1 the nearest part of the body fits the height and the width. */
    double across = hypot(f->half_m[0], f->half_m[2]), nearest = f->distance_m - across;
    double wide = fmax(f->half_m[0], f->half_m[2]), tall = fmax(f->half_m[1], across * 0.5);
    double focal = fmin(0.5 * r->height / (1.08 * tall), 0.5 * r->width / (1.08 * wide)) * nearest * r->zoom;
    upright.K[0] = upright.K[4] = (float)focal;
    *scale_m = (float)(f->distance_m * r->height / focal);
    /* x_camera = R B^T (x - centre - B offset - way) + T, with R and T in the body's axes. */
    float target[3], way[3] = {0, 0, 0};
    if (r->follow) {
        const sherf_pose pose = scene_pose(s, r->avatar, r->motion, r->frame);
        /* the root joint of this frame: R J0 + Th; J0 is the first frame's */
        const sherf_pose first = scene_pose(s, r->avatar, r->motion, 0);
        float root[3], joint[3] = {0, 0, 0};
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++) joint[i] += first.R[3 * k + i] * (f->root_m[k] - first.Th_m[k]);
        for (int i = 0; i < 3; i++) {
            root[i] = pose.Th_m[i];
            for (int k = 0; k < 3; k++) root[i] += pose.R[3 * i + k] * joint[k];
        }
        root_way(f, root, way);
    }
    for (int i = 0; i < 3; i++) {
        double x = (double)f->centre_m[i] + way[i];
        for (int a = 0; a < 3; a++) x += f->axes[3 * i + a] * r->offset_m[a];
        target[i] = (float)x;
    }
    *camera = upright;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double v = 0;
            for (int a = 0; a < 3; a++) v += (double)upright.R[3 * i + a] * f->axes[3 * j + a];
            camera->R[3 * i + j] = (float)v;
            camera->T_m[i] -= (float)(v * target[j]);
        }
}

/* ---- bodies posed lately ---- */
sherf_status scene_posed(context *c, viewer_scene *s, const viewer_request *r, const posed_body **out) {
    viewer_posed *oldest = &s->posed[0];
    *out = NULL;
    for (int i = 0; i < VIEWER_POSED; i++) {
        viewer_posed *p = &s->posed[i];
        if (p->used && p->avatar == r->avatar && p->motion == r->motion && p->frame == r->frame) {
            p->used = ++s->clock;
            *out = p->body;
            return SHERF_OK;
        }
        if (p->used < oldest->used) oldest = p;
    }
    const sherf_viewer_avatar *a = &s->avatars[r->avatar];
    sherf_pose pose = scene_pose(s, r->avatar, r->motion, r->frame);
    posed_body *body = NULL;
    sherf_status status = avatar_pose(c, a->avatar, a->body, &pose, &body);
    if (status != SHERF_OK) return status;
    posed_body_free(oldest->body);
    *oldest = (viewer_posed){++s->clock, r->avatar, r->motion, r->frame, body};
    *out = body;
    return SHERF_OK;
}

sherf_status scene_picture(context *c, const viewer_scene *s, int avatar, uint8_t **out, size_t *bytes) {
    const sherf_image *image = &s->avatars[avatar].avatar->picture[0].image;
    if (!image->data) return failure(c, SHERF_UNSUPPORTED, "a baked avatar does not hold its picture");
    size_t n = (size_t)image->width * (size_t)image->height * 3;
    uint8_t *rgb = mem_alloc(c, n, 1);
    if (!rgb) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) rgb[i] = float_to_u8(image->data[i]);
    sherf_status status = png_to_memory(c, image->width, image->height, 3, rgb, 4, out, bytes);
    mem_free(rgb);
    return status;
}
