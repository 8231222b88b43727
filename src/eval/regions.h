/* regions: errors apart by what the observed picture shows. A target's pixel belongs to the surface of the
 * true body that is drawn there, and that to what the observed camera saw of it (scene.h, body_shown). */
#ifndef SHERF_REGIONS_H
#define SHERF_REGIONS_H

#include "data/data.h"

enum {
    REGION_SEEN,
    REGION_UNSEEN,  /* on the other side of the body, or covered */
    REGION_COVERED, /* of these: another limb lies before it */
    REGIONS
};
typedef struct {
    double error[REGIONS]; /* sums of squared differences of 3 channels */
    int64_t pixels[REGIONS];
} region_errors;
/* What the observation shows of the body's vertices, V; mem_free it. */
sherf_status regions_look(context *c, const body_model *body, const sherf_observation *o, uint8_t **shown);
/* Into *to what one of several pictures shows: of each vertex the better. *to NULL: takes over `shown`, which
 * is then NULL. */
void regions_join(const body_model *body, uint8_t **shown, uint8_t **to);
/* Over the pixels of the person on which the body is drawn. prediction: H x W x 3. */
sherf_status regions_measure(context *c, const body_model *body, const uint8_t *shown, const data_view *truth,
                             const float *prediction, region_errors *out);
void regions_add(region_errors *to, const region_errors *from);
/* Of all pixels that were added up; NaN without any. */
double regions_psnr(const region_errors *e, int region);

#endif
