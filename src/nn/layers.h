/* layers: the building blocks of networks. A layer holds its tensors: it is declared once, with its names in
 * the checkpoints and its initial values, and then used on any tape. */
#ifndef SHERF_LAYERS_H
#define SHERF_LAYERS_H

#include "nn/parameters.h"
#include "tensor/tensor.h"

/* Declares the parameters of one layer after another; a failure (out of memory) sticks. */
typedef struct {
    context *c;
    parameters *p;
    bool failed;
} declaration;

#define DIMS(...)                                                                                            \
    (int)COUNT_OF(((int64_t[]){__VA_ARGS__})), (int64_t[]) {                                                 \
        __VA_ARGS__                                                                                          \
    }
enum { LAYER_NAME = 128 }; /* room for a layer's name */

/* The parameters own the tensor; NULL after a failure. */
tensor *declare(declaration *d, first_values first, int rank, const int64_t *dim, const char *name_format,
                ...) PRINTF_LIKE(5, 6);
/* Initial values for weights [out, in, ...] that keep the scale of values; before_relu: He's rule. */
first_values first_of_fan_in(bool before_relu, int rank, const int64_t *dim);
/* Declares `name`.weight by that rule. */
tensor *declare_weights(declaration *d, bool before_relu, int rank, const int64_t *dim, const char *name);

/* y = x W^T + b: NAME.weight [out, in], NAME.bias [out]. */
typedef struct {
    tensor *w, *b; /* b may be NULL */
} linear_layer;
linear_layer linear_declare(declaration *d, const char *name, bool before_relu, int64_t out, int64_t in);
tensor *linear_forward(tape *t, const linear_layer *l, tensor *x);
/* The same with run-time factors. */
tensor *linear_forward_scaled(tape *t, const linear_layer *l, tensor *x, float gain, float bias_gain);

/* NAME.weight, .bias [channels]. */
typedef struct {
    tensor *w, *b;
} layer_norm;
layer_norm layer_norm_declare(declaration *d, const char *name, int64_t channels);
tensor *layer_norm_forward(tape *t, const layer_norm *n, tensor *x);

/* NAME.weight, .bias, .running_mean, .running_var [channels]. */
typedef struct {
    tensor *w, *b, *mean, *var;
    float eps, momentum;
} batch_norm;
/* trained: false if only the running statistics matter. */
batch_norm batch_norm_declare(declaration *d, const char *name, bool trained, int64_t channels, float eps,
                              float momentum);
tensor *batch_norm_forward(tape *t, const batch_norm *n, tensor *x, bool relu);

/* A sparse convolution without bias, batch norm and ReLU: NAME.INDEX.weight [out, 3, 3, 3, in] and the norm's
 * NAME.INDEX+1. */
typedef struct {
    tensor *w;
    batch_norm norm;
} sparse_layer;
sparse_layer sparse_declare(declaration *d, const char *name, int index, bool trained, int64_t out,
                            int64_t in);
tensor *sparse_forward(tape *t, const sparse_layer *l, tensor *x, tensor *rule); /* op_sparse_conv's rule */

#endif
