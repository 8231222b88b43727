/* Pictures that need no network: the mean colour, and the body painted with the observed picture. */
#include <math.h>
#include <string.h>

#include "eval/baseline.h"

/* The picture at (u, v), bilinear; false where one of the four pixels is not the person's. */
static bool sample_inside(const sherf_observation *o, float u, float v, float color[3]) {
    const int W = o->image.width, H = o->image.height;
    if (!(u >= 0 && v >= 0 && u <= (float)(W - 1) && v <= (float)(H - 1))) return false;
    int x = (int)u, y = (int)v;
    if (x > W - 2) x = W > 1 ? W - 2 : 0;
    if (y > H - 2) y = H > 1 ? H - 2 : 0;
    const float fx = u - (float)x, fy = v - (float)y;
    memset(color, 0, 3 * sizeof *color);
    for (int corner = 0; corner < 4; corner++) {
        int i = x + (corner & 1), j = y + (corner >> 1);
        if (i >= W || j >= H || !o->mask[(size_t)j * (size_t)W + (size_t)i]) return false;
        const float share = (corner & 1 ? fx : 1 - fx) * (corner >> 1 ? fy : 1 - fy);
        for (int k = 0; k < 3; k++)
            color[k] += share * o->image.data[3 * ((size_t)j * (size_t)W + (size_t)i) + (size_t)k];
    }
    return true;
}

/* Fills seen and, where it is 1, color. */
static sherf_status look(context *c, const body_model *body, const sherf_observation *o, baselines *y) {
    const size_t V = (size_t)body->vertices;
    float *world = mem_alloc(c, V, 3 * sizeof *world), *uv = mem_alloc(c, V, 2 * sizeof *uv);
    uint8_t *shown = mem_alloc(c, V, sizeof *shown);
    sherf_status status = world && uv && shown ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = sherf_body_pose(c, body, &o->pose, world, NULL);
    if (status == SHERF_OK) status = body_shown(c, body, world, &o->camera, NULL, 0, shown);
    if (status == SHERF_OK) {
        camera_project(&o->camera, body->vertices, world, uv, NULL);
        for (size_t v = 0; v < V; v++)
            y->seen[v] =
                shown[v] == SHOWN_SEEN && sample_inside(o, uv[2 * v], uv[2 * v + 1], y->color + 3 * v);
    }
    mem_free(shown);
    mem_free(uv);
    mem_free(world);
    return status;
}

/* Colours of the vertices that were not seen; without any that was, the mean colour. */
static sherf_status guess(context *c, const body_model *body, baselines *y) {
    const int V = body->vertices;
    int seen = 0;
    vertex_grid *grid = NULL;
    int32_t *index = mem_alloc(c, (size_t)V, sizeof *index);
    float *rest = mem_alloc(c, (size_t)V, 3 * sizeof *rest);
    sherf_status status = index && rest ? SHERF_OK : SHERF_NO_MEMORY;
    if (status != SHERF_OK) goto done;
    for (int v = 0; v < V; v++) {
        if (!y->seen[v]) continue;
        memcpy(rest + 3 * seen, body->v_template + 3 * v, 3 * sizeof *rest);
        index[seen++] = v;
    }
    if (seen && (status = vertex_grid_create(c, seen, rest, 0, &grid)) != SHERF_OK) goto done;
    for (int v = 0; v < V; v++) {
        if (y->seen[v]) continue;
        int32_t other = body->mirror[v], near = -1;
        if (other >= 0 && !y->seen[other]) other = -1;
        if (other < 0 && grid) near = vertex_grid_nearest(grid, body->v_template + 3 * v, NULL);
        if (near >= 0) other = index[near];
        memcpy(y->color + 3 * v, other >= 0 ? y->color + 3 * other : y->mean_color, sizeof y->mean_color);
    }
done:
    vertex_grid_free(grid);
    mem_free(index);
    mem_free(rest);
    return status;
}

sherf_status baselines_create(context *c, const body_model *body, const sherf_observation *o,
                              baselines *out) {
    double sum[3] = {0}, count = 0;
    *out = (baselines){.color = mem_zero(c, (size_t)body->vertices, 3 * sizeof *out->color),
                       .seen = mem_zero(c, (size_t)body->vertices, sizeof *out->seen)};
    for (size_t i = 0; i < (size_t)o->image.width * (size_t)o->image.height; i++) {
        if (!o->mask[i]) continue;
        for (size_t k = 0; k < 3; k++) sum[k] += o->image.data[3 * i + k];
        count++;
    }
    for (int k = 0; k < 3; k++) out->mean_color[k] = (float)(sum[k] / fmax(count, 1));
    sherf_status status = out->color && out->seen ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = look(c, body, o, out);
    if (status == SHERF_OK) status = guess(c, body, out);
    if (status != SHERF_OK) baselines_free(out);
    return status;
}

void baselines_free(baselines *y) {
    mem_free(y->color);
    mem_free(y->seen);
    *y = (baselines){0};
}

void baseline_mean_color(const baselines *y, const data_view *target, float *out) {
    for (size_t i = 0; i < (size_t)target->image.width * (size_t)target->image.height; i++)
        for (size_t k = 0; k < 3; k++) out[3 * i + k] = target->mask[i] ? y->mean_color[k] : 0;
}

/* The mean of fine x fine samples per pixel. */
static void draw(const raster *r, int fine, const body_model *body, const float *color, float *out) {
    const size_t width = (size_t)(r->width / fine), height = (size_t)(r->height / fine);
    const float share = 1 / (float)(fine * fine);
    memset(out, 0, width * height * 3 * sizeof *out);
    for (size_t j = 0; j < height * (size_t)fine; j++)
        for (size_t i = 0; i < width * (size_t)fine; i++) {
            const size_t n = j * (size_t)r->width + i;
            if (r->face[n] < 0) continue;
            float *to = out + 3 * (j / (size_t)fine * width + i / (size_t)fine);
            const uint32_t *corner = body->face + 3 * (size_t)r->face[n];
            for (int q = 0; q < 3; q++)
                for (int k = 0; k < 3; k++)
                    to[k] +=
                        share * r->barycentric[3 * n + (size_t)q] * color[3 * (size_t)corner[q] + (size_t)k];
        }
}

sherf_status baseline_painted_body(context *c, const baselines *y, const body_model *body,
                                   const sherf_camera *camera, const sherf_pose *pose, float *out) {
    const int fine = camera->width_px > 1024 || camera->height_px > 1024 ? 2 : 4;
    raster *r = NULL;
    float *world = mem_alloc(c, (size_t)body->vertices, 3 * sizeof *world);
    if (!world) return SHERF_NO_MEMORY;
    sherf_status status = sherf_body_pose(c, body, pose, world, NULL);
    if (status == SHERF_OK)
        status = raster_create(c, camera, fine, body->vertices, world, body->faces, body->face, &r);
    if (status == SHERF_OK) draw(r, fine, body, y->color, out);
    raster_free(r);
    mem_free(world);
    return status;
}
