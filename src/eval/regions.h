/* regions: separate errors of the parts that the observed picture shows and does not show. A target's pixel
 * belongs to the place of the true body drawn there, which the observed camera saw or not (scene.h,
 * body_shown). */
#ifndef SHERF_REGIONS_H
#define SHERF_REGIONS_H

#include "data/data.h"

enum {
    REGION_SEEN,
    REGION_UNSEEN,  /* on the other side of the body, or covered */
    REGION_COVERED, /* those of them with another limb in front */
    REGIONS
};
typedef struct {
    double error[REGIONS]; /* sums of squared differences of 3 channels */
    int64_t pixels[REGIONS];
} region_errors;
/* What the observation shows of the body's vertices, V; mem_free it. */
sherf_status regions_look(context *c, const body_model *body, const sherf_observation *o, uint8_t **shown);
/* Merges the parts that another picture shows into *to: each vertex takes the better of both. *to NULL: takes
 * over `shown`, which is then NULL. */
void regions_join(const body_model *body, uint8_t **shown, uint8_t **to);
/* Over the pixels of the person on which the body is drawn. prediction: H x W x 3. */
sherf_status regions_measure(context *c, const body_model *body, const uint8_t *shown, const data_view *truth,
                             const float *prediction, region_errors *out);
void regions_add(region_errors *to, const region_errors *from);
/* Over all added pixels; NaN without any. */
double regions_psnr(const region_errors *e, int region);

#endif
