/* Computes separate errors for the parts that the observed picture shows and does not show. */
#include <math.h>

#include "eval/regions.h"

sherf_status regions_look(context *c, const body_model *body, const sherf_observation *o, uint8_t **shown) {
    const size_t V = (size_t)body->vertices;
    float *world = mem_alloc(c, V, 3 * sizeof *world);
    uint8_t *all = mem_alloc(c, V, sizeof *all);
    *shown = NULL;
    sherf_status status = world && all ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = sherf_body_pose(c, body, &o->pose, world, NULL);
    if (status == SHERF_OK) status = body_shown(c, body, world, &o->camera, o->image.data, 0, all);
    mem_free(world);
    if (status == SHERF_OK)
        *shown = all;
    else
        mem_free(all);
    return status;
}

void regions_join(const body_model *body, uint8_t **shown, uint8_t **to) {
    for (int v = 0; *to && v < body->vertices; v++) /* SHOWN_SEEN is the least */
        if ((*shown)[v] < (*to)[v]) (*to)[v] = (*shown)[v];
    if (*to) return;
    *to = *shown;
    *shown = NULL;
}

static void add_pixel(region_errors *e, int region, double error) {
    e->error[region] += error;
    e->pixels[region]++;
}

static void measure_pixel(const body_model *body, const uint8_t *shown, const raster *r, size_t at,
                          const float *truth, const float *prediction, region_errors *out) {
    const float *share = r->barycentric + 3 * at;
    const int corner = share[1] > share[0] ? share[2] > share[1] ? 2 : 1 : share[2] > share[0] ? 2 : 0;
    const int how = shown[body->face[3 * (size_t)r->face[at] + (size_t)corner]];
    double error = 0;
    for (size_t k = 0; k < 3; k++) {
        const double d = (double)prediction[3 * at + k] - truth[3 * at + k];
        error += d * d;
    }
    if (how == SHOWN_SEEN) add_pixel(out, REGION_SEEN, error);
    if (how == SHOWN_BEHIND || how == SHOWN_COVERED) add_pixel(out, REGION_UNSEEN, error);
    if (how == SHOWN_COVERED) add_pixel(out, REGION_COVERED, error);
}

sherf_status regions_measure(context *c, const body_model *body, const uint8_t *shown, const data_view *truth,
                             const float *prediction, region_errors *out) {
    raster *r = NULL;
    *out = (region_errors){0};
    float *world = mem_alloc(c, (size_t)body->vertices, 3 * sizeof *world);
    sherf_status status = world ? sherf_body_pose(c, body, &truth->pose, world, NULL) : SHERF_NO_MEMORY;
    if (status == SHERF_OK)
        status = raster_create(c, &truth->camera, 1, body->vertices, world, body->faces, body->face, &r);
    for (size_t i = 0; status == SHERF_OK && i < (size_t)r->width * (size_t)r->height; i++)
        if (r->face[i] >= 0 && truth->mask[i])
            measure_pixel(body, shown, r, i, truth->image.data, prediction, out);
    raster_free(r);
    mem_free(world);
    return status;
}

void regions_add(region_errors *to, const region_errors *from) {
    for (int i = 0; i < REGIONS; i++) {
        to->error[i] += from->error[i];
        to->pixels[i] += from->pixels[i];
    }
}

double regions_psnr(const region_errors *e, int region) {
    const double mean = e->error[region] / (3.0 * (double)e->pixels[region]);
    return e->pixels[region] ? fmin(-10 * log10(mean), 100) : NAN;
}
