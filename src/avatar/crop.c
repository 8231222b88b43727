/* Crops and scales an observation to the size of people that a model was trained on. */
#include <math.h>
#include <string.h>

#include "data/view.h"
#include "model/model.h"

/* Scales within this factor of the model's are left alone, as people vary by as much in training. */
static const double scale_tolerance = 1.25;
/* Larger people are scaled to this many times the mean size in training, which keeps the most detail at a
 * size still common there. */
static const double large = 1.15;
/* Room round the body for clothes and hair, in metres. */
static const double margin_m = 0.15;
/* The picture before scaling is kept for detail, at most twice as large and at most this many pixels wide,
 * unless it is hardly larger. */
enum { FINE_TIMES = 2, FINE_SIDE_MAX = 768 };
static const double fine_min = 1.2;

/* The square of the picture that contains the body, at least `side_min` wide, in whole pixels. False: a joint
 * is behind the camera. */
static bool square_round(const float joint[BODY_JOINTS][3], const sherf_camera *camera, double margin_px,
                         double side_min, int *left, int *top, int *side) {
    double min[2] = {INFINITY, INFINITY}, max[2] = {-INFINITY, -INFINITY};
    for (int j = 0; j < BODY_JOINTS; j++) {
        const float *p = joint[j];
        if (!(p[2] > 1e-3f)) return false;
        for (int i = 0; i < 2; i++) {
            const float *k = camera->K + 3 * i;
            double at = (double)(k[0] * p[0] + k[1] * p[1] + k[2] * p[2]) / (double)p[2];
            min[i] = fmin(min[i], at - margin_px);
            max[i] = fmax(max[i], at + margin_px);
        }
    }
    double s = ceil(fmax(side_min, fmax(max[0] - min[0], max[1] - min[1])));
    double corner[2] = {floor((min[0] + max[0] - s) / 2), floor((min[1] + max[1] - s) / 2)};
    if (!(s <= IMAGE_SIDE_MAX && fabs(corner[0]) < 1e6 && fabs(corner[1]) < 1e6)) return false;
    *left = (int)corner[0];
    *top = (int)corner[1];
    *side = (int)s;
    return true;
}

/* Copies a part of the picture and its mask; beyond their edges it is black and empty. */
static sherf_status cut_out(context *c, const sherf_observation *o, int left, int top, int side,
                            sherf_image *image, image_u8 *mask) {
    const size_t n = (size_t)side * (size_t)side;
    *image = (sherf_image){side, side, 3, mem_zero(c, 3 * n, sizeof(float))};
    *mask = (image_u8){.width = side, .height = side, .channels = 1, .data = mem_zero(c, n, 1)};
    if (!image->data || !mask->data) return SHERF_NO_MEMORY;
    const int x0 = left > 0 ? left : 0, x1 = left + side < o->image.width ? left + side : o->image.width;
    for (int y = 0; y < side; y++) {
        const int from = y + top;
        if (from < 0 || from >= o->image.height || x1 <= x0) continue;
        const size_t in = (size_t)from * (size_t)o->image.width + (size_t)x0;
        const size_t out = (size_t)y * (size_t)side + (size_t)(x0 - left), count = (size_t)(x1 - x0);
        memcpy(image->data + 3 * out, o->image.data + 3 * in, 3 * count * sizeof(float));
        memcpy(mask->data + out, o->mask + in, count);
    }
    return SHERF_OK;
}

/* Makes an observation that takes over this picture and mask. After an error (NULL) they stay the
 * caller's. */
static sherf_observation *observation_of(context *c, sherf_image *image, uint8_t **mask,
                                         const sherf_camera *camera, const sherf_pose *pose) {
    sherf_observation *o = mem_zero(c, 1, sizeof *o);
    if (!o) return NULL;
    *o = (sherf_observation){.image = *image, .mask = *mask, .camera = *camera, .pose = *pose};
    *image = (sherf_image){0};
    *mask = NULL;
    return o;
}

static sherf_status keep_fine(context *c, const sherf_image *image, int width, sherf_image *out) {
    const size_t n = (size_t)image->width * (size_t)image->width * 3;
    int side = image->width < FINE_TIMES * width ? image->width : FINE_TIMES * width;
    if (side > FINE_SIDE_MAX) side = FINE_SIDE_MAX;
    if (side < fine_min * width) return SHERF_OK;
    *out = *image;
    out->data = mem_alloc(c, n, sizeof *out->data);
    if (!out->data) return SHERF_NO_MEMORY;
    memcpy(out->data, image->data, n * sizeof *out->data);
    return image_resize_area(c, out, side, side);
}

/* Cut to the square, scaled to `width`. */
static sherf_status cut_and_scale(context *c, const sherf_observation *o, int left, int top, int side,
                                  int width, sherf_observation **out) {
    sherf_image image = {0}, fine = {0};
    image_u8 mask = {0};
    sherf_camera camera = o->camera;
    const float scale = (float)width / (float)side;
    camera.width_px = camera.height_px = width;
    for (int k = 0; k < 3; k++) {
        camera.K[k] = scale * (o->camera.K[k] - (float)left * o->camera.K[6 + k]);
        camera.K[3 + k] = scale * (o->camera.K[3 + k] - (float)top * o->camera.K[6 + k]);
    }
    sherf_status status = cut_out(c, o, left, top, side, &image, &mask);
    if (status == SHERF_OK) status = keep_fine(c, &image, width, &fine);
    if (status == SHERF_OK) status = image_resize_area(c, &image, width, width);
    if (status == SHERF_OK) status = image_resize_nearest(c, &mask, width, width);
    if (status == SHERF_OK && !(*out = observation_of(c, &image, &mask.data, &camera, &o->pose)))
        status = SHERF_NO_MEMORY;
    if (status == SHERF_OK)
        (*out)->fine = fine;
    else
        mem_free(fine.data);
    mem_free(image.data);
    mem_free(mask.data);
    return status;
}

static sherf_status observation_copy(context *c, const sherf_observation *o, sherf_observation **out) {
    const size_t n = (size_t)o->image.width * (size_t)o->image.height;
    sherf_image image = o->image;
    uint8_t *mask = mem_alloc(c, n, 1);
    image.data = mem_alloc(c, 3 * n, sizeof(float));
    if (mask && image.data) {
        memcpy(image.data, o->image.data, 3 * n * sizeof(float));
        memcpy(mask, o->mask, n);
        *out = observation_of(c, &image, &mask, &o->camera, &o->pose);
    }
    mem_free(image.data);
    mem_free(mask);
    return *out ? SHERF_OK : SHERF_NO_MEMORY;
}

sherf_status sherf_observation_crop(sherf_context *c, const sherf_model *m, const sherf_body *body,
                                    const sherf_observation *o, sherf_observation **out) {
    const model_config *config = &m->config;
    const int longest = o->image.width > o->image.height ? o->image.width : o->image.height;
    float joint[BODY_JOINTS][3];
    double now;
    int left, top, side;
    *out = NULL;
    if (!config->px_per_m || !config->image_size) return observation_copy(c, o, out);
    /* cropping to the body would hide the mismatch */
    sherf_status status = observation_check_body(c, o, body);
    if (status != SHERF_OK) return status;
    status = body_px_per_m(c, body, &o->pose, &o->camera, &now);
    if (status == SHERF_OK) status = body_joints_camera(c, body, &o->pose, &o->camera, joint);
    if (status != SHERF_OK) return status;
    double factor = now / config->px_per_m;
    const bool fits = factor > 1 / scale_tolerance && factor < scale_tolerance;
    if (factor > large) factor /= large;
    if (!(factor > 0) || (fits && longest <= 1.5 * config->image_size) ||
        !square_round(joint, &o->camera, margin_m * now, factor * config->image_size, &left, &top, &side))
        return observation_copy(c, o, out); /* encoding it reports what is wrong */
    const double wide = side / factor;
    const int width = wide < VIEW_OBSERVED_SIDE_MAX ? (int)(wide + 0.5) : VIEW_OBSERVED_SIDE_MAX;
    status = cut_and_scale(c, o, left, top, side, width > 0 ? width : 1, out);
    if (status == SHERF_OK)
        log_line(
            c, SHERF_LOG_INFO,
            "the picture was cut out round the person and scaled from %d to %d pixels, the size that the "
            "model knows",
            side, width);
    return status;
}
