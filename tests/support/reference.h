/* The reference network: weights and inputs by the stated rules, outputs from
 * tests/data/reference_*.safetensors (a selection of the outputs of the authors' PyTorch network, float32 on
 * a CPU). */
#ifndef TEST_REFERENCE_H
#define TEST_REFERENCE_H

#include "io/safetensors.h"
#include "model/model.h"
#include "support.h"

enum { REFERENCE_SIZE = 128 };
/* Weights by the rules: value i of NAME is centred(NAME, shape, s), in the files' order. */
void reference_weights(model *m);
safetensors *reference_read(context *c, const char *file);
const float *reference_floats(const safetensors *s, const char *name, int64_t count);
/* who: "target" or "observation". */
void reference_camera(const safetensors *s, const char *who, sherf_camera *out);
void reference_pose(const safetensors *s, const char *who, sherf_pose *out);
void reference_image(context *c, bool target, sherf_image *out); /* sherf_image_free */

/* Fails unless |got - want| <= largest * max |want| and the root mean square error <= rms * max |want|.
 * `stride`: floats from one row of got to the next; rows have `columns` values. */
typedef struct {
    double largest, rms;
} reference_bound;
void reference_compare(const char *what, const float *want, const float *got, int64_t count,
                       reference_bound bound);
#endif
