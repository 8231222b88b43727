/* parts: a radiance field as plain arrays in the host's memory, for other backends: the bank after the linear
 * layers before fusion, and the layers after the algebra that does not depend on points (inside.h). */
#ifndef SHERF_RADIANCE_PARTS_H
#define SHERF_RADIANCE_PARTS_H

#include "model/sherf/fused/inside.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    radiance_field *n; /* sizes, bank and vectors */
    radiance_matrices m;
    float bank_max; /* the largest magnitude of maps and levels */
} radiance_parts;

sherf_status radiance_parts_create(context *c, const radiance_sizes *sizes, const radiance_weights *weights,
                                   const radiance_bank *bank, radiance_parts *out);
void radiance_parts_free(radiance_parts *p);

#ifdef __cplusplus
}
#endif
#endif
