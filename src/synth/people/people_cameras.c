/* Cameras in a ring, and hand-held cameras. */
#include "synth/people/people_cameras.h"

#include <math.h>
#include <string.h>

#include "scene/scene.h"

static float between(uint64_t key, uint64_t i, double low, double high) {
    return (float)(low + (high - low) * random_uniform(key, i));
}

void people_cameras_ring(uint64_t key, float radius_m, int views, int size_px, sherf_camera *out) {
    static const float centre[3] = {0, 0, 0};
    float fov = between(key, 1000, 0.55, 0.85);
    float min = (radius_m + 0.06f) / sinf(0.5f * fov); /* hair, hats and hems extend beyond the body */
    for (int v = 0; v < views; v++) {
        float azimuth = (float)(2 * M_PI * (v - views / 2) / views);
        float distance = min * between(key, (uint64_t)v * 2, 1.0, 1.08);
        float elevation = between(key, (uint64_t)v * 2 + 1, -0.12, 0.45);
        sherf_camera_orbit(centre, distance, azimuth, elevation, fov, size_px, size_px, &out[v]);
    }
}

/* ---- photos ---- */

typedef struct {
    float low[2], high[2]; /* pixels */
} extent;

typedef struct {
    int64_t points;
    const float *point;
    float *uv, *depth; /* of the points, scratch */
    float middle_world, floor_world;
} subject;

static extent seen_from(const subject *s, const sherf_camera *camera) {
    extent e = {{INFINITY, INFINITY}, {-INFINITY, -INFINITY}};
    camera_project(camera, s->points, s->point, s->uv, s->depth);
    for (int64_t i = 0; i < s->points; i++)
        for (int k = 0; k < 2; k++) {
            float x = s->depth[i] > 0.05f ? s->uv[2 * i + k] : INFINITY;
            e.low[k] = fminf(e.low[k], x);
            e.high[k] = fmaxf(e.high[k], x);
        }
    return e;
}

static void stand_at(const subject *s, float distance_m, float azimuth, float eye_m, float fov, int size,
                     sherf_camera *out) {
    const float centre[3] = {0, s->middle_world, 0};
    const float steepest = 0.21f; /* tangent: people step back or stoop rather than look steeply down */
    float above = s->floor_world + eye_m - s->middle_world;
    above = fminf(fmaxf(above, -steepest * distance_m), steepest * distance_m);
    sherf_camera_orbit(centre, hypotf(distance_m, above), azimuth, atan2f(above, distance_m), fov, size, size,
                       out);
}

/* Turns the camera in place: right and down by these angles, then about its axis. */
static void turn_camera(sherf_camera *camera, float right, float down, float roll) {
    const float y[9] = {cosf(right), 0, -sinf(right), 0, 1, 0, sinf(right), 0, cosf(right)};
    const float x[9] = {1, 0, 0, 0, cosf(down), -sinf(down), 0, sinf(down), cosf(down)};
    const float z[9] = {cosf(roll), -sinf(roll), 0, sinf(roll), cosf(roll), 0, 0, 0, 1};
    const float *const turn[] = {y, x, z};
    for (size_t n = 0; n < COUNT_OF(turn); n++) {
        const float *q = turn[n];
        float R[9], T[3];
        for (int i = 0; i < 9; i++) {
            R[i] = 0;
            for (int k = 0; k < 3; k++) R[i] += q[i / 3 * 3 + k] * camera->R[3 * k + i % 3];
        }
        for (int i = 0; i < 3; i++)
            T[i] = q[3 * i] * camera->T_m[0] + q[3 * i + 1] * camera->T_m[1] + q[3 * i + 2] * camera->T_m[2];
        memcpy(camera->R, R, sizeof R);
        memcpy(camera->T_m, T, sizeof T);
    }
}

static bool inside(const extent *e, float size) {
    const float rim = 0.012f * size;
    for (int k = 0; k < 2; k++)
        if (!(e->low[k] > rim && e->high[k] < size - 1 - rim)) return false;
    return true;
}

static void photo(const subject *s, uint64_t key, float azimuth, int size, sherf_camera *out) {
    const float film_mm = 36;
    float focal_mm = expf(between(key, 0, log(26), log(70))), fov = 2 * atanf(0.5f * film_mm / focal_mm);
    float share = between(key, 1, 0.55, 0.95), eye_m = between(key, 2, 0.8, 1.65), side = (float)size;
    float distance_m = 3, focal_px = 0.5f * side / tanf(0.5f * fov);
    sherf_camera centred;
    extent e;
    for (int i = 0; i < 40; i++) { /* nearer or farther, until the person fits */
        stand_at(s, distance_m, azimuth, eye_m, fov, size, out);
        e = seen_from(s, out);
        float ratio = fmaxf((e.high[1] - e.low[1]) / (share * side), (e.high[0] - e.low[0]) / (0.93f * side));
        distance_m *= isfinite(ratio) ? fminf(fmaxf(ratio, 0.5f), 2) : 2;
    }
    /* The free space is split at random between the sides; if that cuts something off, in half. */
    for (int attempt = 0; attempt < 2; attempt++) {
        centred = *out;
        float angle[2];
        for (int k = 0; k < 2; k++) {
            float room = side - (e.high[k] - e.low[k]);
            float low = room * (attempt ? 0.5f : between(key, 3 + (uint64_t)k, 0.2, 0.8));
            float from = 0.5f * (e.low[k] + e.high[k]) - 0.5f * side, to = from + low - e.low[k];
            angle[k] = atanf(to / focal_px) - atanf(from / focal_px);
        }
        turn_camera(&centred, -angle[0], -angle[1], attempt ? 0 : between(key, 5, -0.025, 0.025));
        extent now = seen_from(s, &centred);
        if (attempt || inside(&now, side)) break;
    }
    *out = centred;
}

sherf_status people_cameras_photo(context *c, uint64_t key, int64_t points, const float *points_world,
                                  float floor_world, int views, int size_px, sherf_camera *out) {
    subject s = {points,
                 points_world,
                 mem_alloc(c, (size_t)points, 2 * sizeof(float)),
                 mem_alloc(c, (size_t)points, sizeof(float)),
                 0,
                 floor_world};
    sherf_status status = s.uv && s.depth ? SHERF_OK : SHERF_NO_MEMORY;
    float low = INFINITY, high = -INFINITY, max = fminf(0.35f, 1.2f / (float)views);
    for (int64_t i = 0; i < points; i++) {
        low = fminf(low, points_world[3 * i + 1]);
        high = fmaxf(high, points_world[3 * i + 1]);
    }
    s.middle_world = 0.5f * (low + high);
    for (int v = 0; v < views && !status; v++) {
        uint64_t own = random_key(key, "people.photo", (uint64_t)v);
        float azimuth = (float)(2 * M_PI * (v - views / 2) / views) + between(own, 100, -max, max);
        photo(&s, own, azimuth, size_px, &out[v]);
    }
    mem_free(s.uv);
    mem_free(s.depth);
    return status;
}
