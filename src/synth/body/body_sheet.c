/* body_sheet: draws the open body in a few poses and shapes, to check by eye. */
#include <math.h>
#include <string.h>

#include "io/image.h"
#include "synth/body/affine.h"
#include "synth/body/open_body.h"
#include "scene/scene.h"

enum { TILE_W = 240, TILE_H = 320, COLUMNS = 10, SAMPLES = 3 };

typedef struct {
    float pose[72];
} sheet_pose;

/* pose[joint] = rotation about axis (x, y, z) after its present one. */
static void turn(sheet_pose *p, int joint, double x, double y, double z) {
    double before[3] = {(double)p->pose[3 * joint], (double)p->pose[3 * joint + 1],
                        (double)p->pose[3 * joint + 2]};
    double axis[3] = {x, y, z}, A[9], B[9];
    float R[9], out[3];
    turn3(axis, sqrt(dot3(axis, axis)), A);
    turn3(before, sqrt(dot3(before, before)), B);
    multiply3(A, B, A);
    for (int i = 0; i < 9; i++) R[i] = (float)A[i];
    rotation_to_axis_angle(R, out);
    memcpy(p->pose + 3 * joint, out, sizeof out);
}

static void arms_down(sheet_pose *p) {
    turn(p, 16, 0, 0, -1.2);
    turn(p, 17, 0, 0, 1.2);
}

static void walk(sheet_pose *p) {
    turn(p, 1, -0.5, 0, 0);
    turn(p, 2, 0.4, 0, 0);
    turn(p, 4, 0.2, 0, 0);
    turn(p, 5, 0.55, 0, 0);
    turn(p, 8, 0.2, 0, 0);
    turn(p, 3, 0.05, 0.08, 0);
    turn(p, 18, 0, -0.35, 0); /* in the arm's own frame: forearms forward */
    turn(p, 19, 0, 0.5, 0);
    arms_down(p);
    turn(p, 16, 0.45, 0, 0);
    turn(p, 17, -0.45, 0, 0);
}

static void sit(sheet_pose *p) {
    for (int side = 0; side < 2; side++) {
        turn(p, 1 + side, -1.55, 0, 0);
        turn(p, 4 + side, 1.55, 0, 0);
        turn(p, 18 + side, 0, side ? 1.2 : -1.2, 0);
    }
    arms_down(p);
}

static void arms_up(sheet_pose *p) {
    turn(p, 13, 0, 0, 0.25);
    turn(p, 14, 0, 0, -0.25);
    turn(p, 16, 0, 0, 1.15);
    turn(p, 17, 0, 0, -1.15);
}

static void bent(sheet_pose *p) { /* elbows and knees at right angles, one arm across */
    turn(p, 18, 0, -1.57, 0);
    turn(p, 19, 0, 1.57, 0);
    turn(p, 4, 1.57, 0, 0);
    turn(p, 16, 0, -0.9, 0);
}

static sherf_status draw(context *c, const body_model *body, const sheet_pose *p,
                         const float shape[BODY_SHAPES], double azimuth_rad, uint8_t *to, size_t stride) {
    static const float R[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, Th[3], centre[3] = {0, -0.28f, 0};
    posed_body *posed = NULL;
    raster *r = NULL;
    sherf_camera camera;
    sherf_camera_orbit(centre, 3.6f, (float)azimuth_rad, 0.1f, 0.62f, TILE_W, TILE_H, &camera);
    float *normal = mem_alloc(c, (size_t)body->vertices * 3, sizeof *normal);
    sherf_status status =
        normal ? posed_body_create(c, body, p->pose, shape, R, Th, &posed) : SHERF_NO_MEMORY;
    if (!status) status = body_normals(c, body, posed->vertices_smpl, normal);
    if (!status)
        status = raster_create(c, &camera, SAMPLES, body->vertices, posed->vertices_smpl, body->faces,
                               body->face, &r);
    for (int y = 0; y < TILE_H && !status; y++)
        for (int x = 0; x < TILE_W; x++) {
            double sum[3] = {0};
            for (int s = 0; s < SAMPLES * SAMPLES; s++) {
                size_t at = (size_t)(y * SAMPLES + s / SAMPLES) * (size_t)r->width +
                            (size_t)(x * SAMPLES + s % SAMPLES);
                double light = 1, n[3] = {0};
                if (r->face[at] >= 0) {
                    for (int i = 0; i < 3; i++)
                        for (int k = 0; k < 3; k++)
                            n[k] += (double)(r->barycentric[3 * at + i] *
                                             normal[3 * (size_t)body->face[3 * (size_t)r->face[at] + i] + k]);
                    unit3(n);
                    const double lamp[3] = {0.35 * cos(azimuth_rad) + 0.6 * sin(azimuth_rad), 0.6,
                                            0.6 * cos(azimuth_rad) - 0.35 * sin(azimuth_rad)};
                    double d = dot3(n, lamp) / sqrt(dot3(lamp, lamp));
                    light = 0.25 + 0.6 * (d > 0 ? d : 0);
                }
                sum[0] += light;
                sum[1] += r->face[at] >= 0 ? light * 0.92 : light;
                sum[2] += r->face[at] >= 0 ? light * 0.85 : light;
            }
            for (int k = 0; k < 3; k++)
                to[(size_t)y * stride + 3 * (size_t)x + (size_t)k] =
                    float_to_u8((float)(sum[k] / (SAMPLES * SAMPLES)));
        }
    raster_free(r);
    posed_body_free(posed);
    mem_free(normal);
    return status;
}

sherf_status open_body_sheet(context *c, const body_model *body, const char *png) {
    enum { POSES = 5, ROWS = 4 };
    static void (*const make[POSES])(sheet_pose *) = {NULL, walk, sit, arms_up, bent};
    size_t stride = 3 * (size_t)(COLUMNS * TILE_W);
    uint8_t *sheet = mem_zero(c, stride, ROWS * TILE_H);
    if (!sheet) return SHERF_NO_MEMORY;
    sherf_status status = SHERF_OK;
    for (int i = 0; i < 4 * POSES && !status; i++) { /* two rows: five poses from four sides */
        sheet_pose pose = {0};
        static const float mean[BODY_SHAPES];
        if (make[i / 4]) make[i / 4](&pose);
        status = draw(c, body, &pose, mean, M_PI / 2 * (i % 4) + (i % 4 ? 0 : 0.0),
                      sheet + (size_t)(i / COLUMNS) * TILE_H * stride + (size_t)(i % COLUMNS) * TILE_W * 3,
                      stride);
    }
    for (int i = 0; i < 2 * BODY_SHAPES && !status; i++) {
        sheet_pose pose = {0};
        float shape[BODY_SHAPES] = {0};
        shape[i % BODY_SHAPES] = i < BODY_SHAPES ? -2 : 2;
        arms_down(&pose);
        status = draw(c, body, &pose, shape, 0.35,
                      sheet + (size_t)(2 + i / BODY_SHAPES) * TILE_H * stride +
                          (size_t)(i % BODY_SHAPES) * TILE_W * 3,
                      stride);
    }
    if (!status) status = png_write(c, png, COLUMNS * TILE_W, ROWS * TILE_H, 3, sheet);
    mem_free(sheet);
    return status;
}
