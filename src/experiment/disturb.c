/* Disturbs true bodies at random, by as much as estimators err. */
#include "experiment/disturb.h"

#include <math.h>
#include <string.h>

#include "eval/pose_error.h"

static const double shape_deviation = 0.5, depth_share = 0.05, deviation_max = 1.5;

/* A number that depends on the true body alone. */
static uint64_t key_of(const sherf_pose *p) {
    uint64_t key = fnv1a64("experiment.disturb");
    for (int i = 0; i < 72; i++) {
        uint32_t bits;
        memcpy(&bits, &p->poses_rad[i], sizeof bits);
        key = splitmix64(key ^ bits);
    }
    return key;
}

static void bend(const sherf_pose *truth, double deviation, uint64_t key, sherf_pose *out) {
    for (int i = 0; i < 72; i++)
        out->poses_rad[i] = (float)(truth->poses_rad[i] +
                                    deviation * (i < 3 ? 1.0 / 3 : 1) * random_normal(key, (uint64_t)i));
    for (int i = 0; i < 10 && deviation > 0; i++)
        out->shapes[i] = (float)(truth->shapes[i] + shape_deviation * random_normal(key, 72 + (uint64_t)i));
}

/* Moves the root along its ray from the camera, to `scale` times the true distance. */
static sherf_status root_place(context *c, const sherf_body *body, const sherf_camera *camera,
                               const sherf_pose *truth, double scale, sherf_pose *out) {
    float was[24][3], is[24][3], eye[3];
    sherf_status status = sherf_body_pose(c, body, truth, NULL, was[0]);
    if (status == SHERF_OK) status = sherf_body_pose(c, body, out, NULL, is[0]);
    if (status != SHERF_OK) return status;
    camera_position(camera, eye);
    for (int k = 0; k < 3; k++) out->Th_m[k] += (float)(eye[k] + scale * (was[0][k] - eye[k]) - is[0][k]);
    return SHERF_OK;
}

sherf_status disturbed_pose(context *c, const disturbance *d, const sherf_camera *camera,
                            const sherf_pose *truth, sherf_pose *out) {
    const uint64_t key = key_of(truth);
    *out = *truth;
    if (!(d->deviation_rad > 0)) return SHERF_OK;
    bend(truth, d->deviation_rad, key, out);
    const double nearer = depth_share * (2 * random_uniform(key, 200) - 1);
    return root_place(c, d->body, camera, truth, 1 + nearer, out);
}

sherf_status estimate_by_disturbance(context *c, void *state, const sherf_image *photo,
                                     const sherf_observation *truth, sherf_observation **out) {
    const disturbance *d = state;
    sherf_pose pose;
    *out = NULL;
    sherf_status status = disturbed_pose(c, d, &truth->camera, &truth->pose, &pose);
    const size_t pixels = (size_t)truth->image.width * (size_t)truth->image.height;
    sherf_image mask = {truth->image.width, truth->image.height, 1, NULL};
    if (status != SHERF_OK) return status;
    if (!(mask.data = mem_alloc(c, pixels, sizeof(float)))) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < pixels; i++) mask.data[i] = truth->mask[i] != 0;
    status = sherf_observation_create(c, &truth->image, &mask, &truth->camera, &pose, out);
    mem_free(mask.data);
    return status;
}

/* ---- how far joints are moved ---- */
static sherf_status joints_of(context *c, const sherf_body *body, const sherf_pose *pose, double out[24][3]) {
    float joint[24][3];
    sherf_status status = sherf_body_pose(c, body, pose, NULL, joint[0]);
    for (int i = 0; i < 72 && status == SHERF_OK; i++) out[i / 3][i % 3] = joint[i / 3][i % 3];
    return status;
}

static sherf_status mean_error_mm(context *c, const disturbance *d, int bodies, const sherf_camera *camera,
                                  const sherf_pose *truth, double *mm) {
    double sum = 0, was[24][3], is[24][3];
    for (int i = 0; i < bodies; i++) {
        sherf_pose pose;
        sherf_status status = disturbed_pose(c, d, &camera[i], &truth[i], &pose);
        if (status == SHERF_OK) status = joints_of(c, d->body, &truth[i], was);
        if (status == SHERF_OK) status = joints_of(c, d->body, &pose, is);
        if (status != SHERF_OK) return status;
        sum += 1000 * procrustes_distance(24, (const double(*)[3])is, (const double(*)[3])was);
    }
    *mm = sum / bodies;
    return SHERF_OK;
}

sherf_status disturbance_for(context *c, const sherf_body *body, int bodies, const sherf_camera *camera,
                             const sherf_pose *truth, double aligned_mm, double *deviation_rad) {
    double low = 0, high = deviation_max, mm;
    *deviation_rad = 0;
    if (!(aligned_mm > 0)) return SHERF_OK;
    for (int i = 0; i < 24; i++) {
        const disturbance d = {body, (low + high) / 2};
        sherf_status status = mean_error_mm(c, &d, bodies, camera, truth, &mm);
        if (status != SHERF_OK) return status;
        *(mm < aligned_mm ? &low : &high) = d.deviation_rad;
    }
    *deviation_rad = (low + high) / 2;
    return SHERF_OK;
}
