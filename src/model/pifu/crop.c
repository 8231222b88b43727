/* The square of the picture that PIFu reads, and where points of the world lie in it. */
#include <math.h>

#include "model/pifu/settings.h"

static const float standing = 0.88f, reaching = 0.96f; /* of the square's side */
static const float z_scale = 2.25f;

void pifu_crop_free(void *crop) {
    pifu_crop *k = crop;
    if (!k) return;
    mem_free(k->image);
    mem_free(k);
}

/* Height of the body at rest, without pose-dependent offsets. */
static float standing_height(const body_model *body, const posed_body *p) {
    float low = INFINITY, high = -INFINITY;
    for (int64_t v = 0; v < body->vertices; v++) {
        const float y = body->v_template[3 * v + 1] + p->shape_offset[3 * v + 1];
        low = fminf(low, y);
        high = fmaxf(high, y);
    }
    return high - low;
}

static void world_of(const posed_body *p, const float smpl[3], float out[3]) {
    for (int k = 0; k < 3; k++)
        out[k] = p->R[3 * k] * smpl[0] + p->R[3 * k + 1] * smpl[1] + p->R[3 * k + 2] * smpl[2] + p->Th[k];
}

/* Bounds of the body's vertices before the camera, in pixels. */
static bool bounds(context *c, const body_model *body, const observation_geometry *g, float low[2],
                   float high[2], sherf_status *status) {
    const int64_t n = body->vertices;
    float *world = mem_alloc(c, (size_t)n, 6 * sizeof *world);
    bool any = false;
    low[0] = low[1] = INFINITY;
    high[0] = high[1] = -INFINITY;
    *status = world ? SHERF_OK : SHERF_NO_MEMORY;
    if (!world) return false;
    float *px = world + 3 * n, *z = world + 5 * n;
    body_vertices_world(body, g->body, world);
    camera_project(&g->camera, n, world, px, z);
    for (int64_t i = 0; i < n; i++) {
        if (!(z[i] > 0)) continue;
        any = true;
        for (int k = 0; k < 2; k++) {
            low[k] = fminf(low[k], px[2 * i + k]);
            high[k] = fmaxf(high[k], px[2 * i + k]);
        }
    }
    mem_free(world);
    return any;
}

/* Back from the middle of the square at the root's depth: x = R^T (z K^-1 (u, v, 1) - T). */
static void middle_of(const sherf_camera *k, pifu_crop *crop) {
    const double z = (double)crop->root_z_m, v = (double)(crop->top_px + crop->side_px / 2),
                 u = (double)(crop->left_px + crop->side_px / 2), y = (v - (double)k->K[5]) / (double)k->K[4],
                 x = (u - (double)k->K[2] - (double)k->K[1] * y) / (double)k->K[0];
    const double at[3] = {x * z - (double)k->T_m[0], y * z - (double)k->T_m[1], z - (double)k->T_m[2]};
    for (int i = 0; i < 3; i++)
        crop->middle[i] =
            (float)((double)k->R[i] * at[0] + (double)k->R[3 + i] * at[1] + (double)k->R[6 + i] * at[2]);
}

static sherf_status lay_out(context *c, const body_model *body, const observation_geometry *g,
                            pifu_crop *crop) {
    float root[3], px[2], low[2], high[2];
    sherf_status status;
    world_of(g->body, g->body->joints_smpl[0], root);
    camera_project(&g->camera, 1, root, px, &crop->root_z_m);
    const bool any = bounds(c, body, g, low, high, &status);
    if (status != SHERF_OK) return status;
    const float focal = sqrtf(fabsf(g->camera.K[0] * g->camera.K[4])),
                height = standing_height(body, g->body);
    if (!any || !(crop->root_z_m > 0) || !(height > 0))
        return failure(c, SHERF_MISMATCH, "the person is not before the camera");
    crop->side_px = focal * height / crop->root_z_m / standing;
    for (int k = 0; k < 2; k++) crop->side_px = fmaxf(crop->side_px, (high[k] - low[k]) / reaching);
    crop->left_px = (low[0] + high[0] - crop->side_px) / 2;
    crop->top_px = (low[1] + high[1] - crop->side_px) / 2;
    crop->height_m = standing * crop->side_px * crop->root_z_m / focal;
    if (!isfinite(crop->side_px) || !(crop->side_px > 1) || !isfinite(crop->left_px + crop->top_px))
        return failure(c, SHERF_MISMATCH, "the person is too small in the picture, or too near");
    middle_of(&g->camera, crop);
    return SHERF_OK;
}

/* Bilinear; black outside the picture. */
static void picture_at(const observation_geometry *g, float x, float y, float rgb[3]) {
    const float column = floorf(x), row = floorf(y),
                weight[2][2] = {{column + 1 - x, x - column}, {row + 1 - y, y - row}};
    for (int i = 0; i < 4; i++) {
        const float u = column + (float)(i & 1), v = row + (float)(i >> 1);
        if (!(u >= 0 && v >= 0 && u < (float)g->width && v < (float)g->height)) continue;
        const float *p = g->image + 3 * ((size_t)v * (size_t)g->width + (size_t)u);
        for (int k = 0; k < 3; k++) rgb[k] += weight[0][i & 1] * weight[1][i >> 1] * p[k];
    }
}

/* Averages over as many places per pixel as the picture has pixels there. */
static void fill(const observation_geometry *g, pifu_crop *crop) {
    enum { PLACES_MAX = 16 };
    const float step = crop->side_px / (float)(crop->side - 1);
    const int n = (int)fminf(fmaxf(ceilf(step), 1), PLACES_MAX);
    for (int y = 0; y < crop->side; y++)
        for (int x = 0; x < crop->side; x++) {
            float rgb[3] = {0};
            for (int i = 0; i < n * n; i++)
                picture_at(g, crop->left_px + step * ((float)x + ((float)(i % n) + 0.5f) / (float)n - 0.5f),
                           crop->top_px + step * ((float)y + ((float)(i / n) + 0.5f) / (float)n - 0.5f), rgb);
            for (int k = 0; k < 3; k++)
                crop->image[3 * ((size_t)y * (size_t)crop->side + (size_t)x) + (size_t)k] =
                    2 * rgb[k] / (float)(n * n) - 1;
        }
}

sherf_status pifu_crop_create(context *c, const body_model *body, const observation_geometry *g,
                              const pifu_settings *k, pifu_crop **out) {
    pifu_crop *crop = mem_zero(c, 1, sizeof *crop);
    *out = NULL;
    if (!crop) return SHERF_NO_MEMORY;
    crop->side = k->side_px;
    crop->z_scale = z_scale * k->z_gain;
    crop->image = mem_alloc(c, (size_t)k->side_px * (size_t)k->side_px, 3 * sizeof *crop->image);
    const sherf_status status = crop->image ? lay_out(c, body, g, crop) : SHERF_NO_MEMORY;
    if (status != SHERF_OK) {
        pifu_crop_free(crop);
        return status;
    }
    fill(g, crop);
    *out = crop;
    return SHERF_OK;
}

void pifu_crop_place(const pifu_crop *crop, const sherf_camera *camera, int64_t n, const float *points_world,
                     float *uv, float *z, uint8_t *in) {
    for (int64_t i = 0; i < n; i++) {
        float px[2], depth;
        camera_project(camera, 1, points_world + 3 * i, px, &depth);
        uv[2 * i] = 2 * (px[0] - crop->left_px) / crop->side_px - 1;
        uv[2 * i + 1] = 2 * (px[1] - crop->top_px) / crop->side_px - 1;
        z[i] = crop->z_scale * (depth - crop->root_z_m) / crop->height_m;
        in[i] = depth > 0 && fabsf(uv[2 * i]) <= 1 && fabsf(uv[2 * i + 1]) <= 1;
        if (!in[i]) uv[2 * i] = uv[2 * i + 1] = z[i] = 0;
    }
}
