/* tests/data/body_reference.safetensors: a selection of the reference's stages of body and rays. Rows: every
 * 35th vertex ("vertex"), every 83rd ray ("ray"), every 16th picked point ("point", rows of "pick.ray",
 * "pick.sample"). */
#ifndef BODY_REFERENCE_H
#define BODY_REFERENCE_H
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "support.h"
#include "synth/tube/tubeman.h"
#include "io/safetensors.h"
#include "scene/scene.h"

typedef struct {
    context *c;
    safetensors *file;
    body_model *body;
    posed_body *target, *observation;
    sherf_camera target_camera, observation_camera;
} body_reference;

static inline const safetensor *reference_find(const body_reference *r, const char *name) {
    const safetensor *t = safetensors_find(r->file, name);
    if (!t) fail_msg("no %s", name);
    return t;
}
static inline const float *reference_floats(const body_reference *r, const char *name) {
    return reference_find(r, name)->data;
}
static inline const int32_t *reference_ints(const body_reference *r, const char *name, int64_t *n) {
    const safetensor *t = reference_find(r, name);
    if (n) *n = t->dim[0];
    return t->data;
}

static inline posed_body *reference_pose(const body_reference *r, const char *who) {
    static const char *part[4] = {"poses", "shapes", "R", "Th"};
    const float *x[4];
    char name[64];
    posed_body *p;
    for (int i = 0; i < 4; i++) {
        snprintf(name, sizeof name, "in.%s.%s", who, part[i]);
        x[i] = reference_floats(r, name);
    }
    assert_ok(r->c, posed_body_create(r->c, r->body, x[0], x[1], x[2], x[3], &p));
    return p;
}

static inline sherf_camera reference_camera(const body_reference *r, const char *who) {
    sherf_camera camera = {.width_px = 128, .height_px = 128};
    char name[64];
    snprintf(name, sizeof name, "in.%s.camera.K", who);
    memcpy(camera.K, reference_floats(r, name), sizeof camera.K);
    snprintf(name, sizeof name, "in.%s.camera.R", who);
    memcpy(camera.R, reference_floats(r, name), sizeof camera.R);
    snprintf(name, sizeof name, "in.%s.camera.T", who);
    memcpy(camera.T_m, reference_floats(r, name), sizeof camera.T_m);
    return camera;
}

static inline int body_reference_open(void **state) {
    static body_reference r;
    r.c = test_context();
    assert_ok(r.c, safetensors_read(r.c, "data/body_reference.safetensors", &r.file));
    assert_ok(r.c, tubeman_create(r.c, &r.body));
    r.target = reference_pose(&r, "target");
    r.observation = reference_pose(&r, "observation");
    r.target_camera = reference_camera(&r, "target");
    r.observation_camera = reference_camera(&r, "observation");
    *state = &r;
    return 0;
}

static inline int body_reference_close(void **state) {
    body_reference *r = *state;
    posed_body_free(r->target);
    posed_body_free(r->observation);
    sherf_body_free(r->body);
    safetensors_free(r->file);
    sherf_context_free(r->c);
    return 0;
}

/* Compares rows `row` of `ours` (width values each) with the stored rows. */
static inline void assert_rows(const float *ours, const float *stored, const int32_t *row, int64_t rows,
                               int width, double tolerance, const char *what) {
    for (int64_t i = 0; i < rows; i++)
        for (int k = 0; k < width; k++) {
            double a = ours[(int64_t)row[i] * width + k], b = stored[i * width + k];
            if (!(fabs(a - b) <= tolerance))
                fail_msg("%s, row %d, %d: %.9g, should be %.9g", what, row[i], k, a, b);
        }
}
/* The rays of a camera that looks at the target. */
static inline ray_bundle *target_rays(body_reference *r, const sherf_camera *camera) {
    float min[3], max[3];
    ray_bundle *rays;
    body_world_box(r->body, r->target, min, max);
    assert_ok(r->c, rays_create(r->c, camera, min, max, &rays));
    return rays;
}

/* Makes rays at the target and calls `make`, which frees its own result, while every allocation fails in
 * turn. There are more than `least` allocations. */
static inline void target_no_memory(body_reference *r,
                                    sherf_status (*make)(body_reference *r, const sherf_camera *small,
                                                         const ray_bundle *rays),
                                    long least) {
    sherf_camera small = r->target_camera;
    camera_resize(&small, 16, 16);
    float min[3], max[3];
    body_world_box(r->body, r->target, min, max);
    const size_t live = mem_live();
    for (long n = 0;; n++) {
        ray_bundle *rays = NULL;
        mem_fail_after(n);
        sherf_status status = rays_create(r->c, &small, min, max, &rays);
        if (status == SHERF_OK) status = make(r, &small, rays);
        mem_fail_after(-1);
        rays_free(rays);
        assert_int_equal(mem_live(), live);
        if (status == SHERF_OK) {
            assert_true(n > least);
            return;
        }
        assert_int_equal(status, SHERF_NO_MEMORY);
    }
}

#endif
