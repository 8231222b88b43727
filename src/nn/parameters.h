/* parameters: a model's named tensors. All their values are in one aligned block, and so are the gradients.
 * The trained ones come first in both, so that the optimiser sees plain arrays. */
#ifndef SHERF_PARAMETERS_H
#define SHERF_PARAMETERS_H

#include "tensor/tensor.h"

/* A parameter's initial value: one number everywhere, or, if deviation is not 0, normal numbers of mean 0. */
typedef struct {
    float constant;
    double deviation;
} first_values;

typedef struct {
    char *name;   /* as in the authors' checkpoints */
    tensor value; /* F32; data in the block; value.grad once gradients exist */
    tensor grad;
    bool buffer;    /* running statistics: stored and averaged, never trained */
    int64_t offset; /* floats into the block */
    first_values first;
    bool channels_last; /* [H, W, C] here and [C, H, W] in files */
} parameter;

typedef struct {
    int count, capacity;
    parameter **item; /* in the order of the additions */
    bool laid_out;
    int64_t trained_floats; /* offsets below this are trained (padded to 16 floats each) */
    int64_t total_floats;
    const tensor_memory *memory; /* of the two blocks; NULL: the host's */
    float *values;               /* total_floats */
    float *grads;                /* trained_floats, or NULL */
} parameters;

parameters *parameters_create(context *c);
void parameters_free(parameters *p);
/* Before parameters_lay_out. Returns the tensor (its data is NULL until then), or NULL: out of memory. */
tensor *parameter_add(context *c, parameters *p, bool buffer, int rank, const int64_t *dim,
                      const char *name_format, ...) PRINTF_LIKE(6, 7);
/* Allocates the block, zeroed. */
sherf_status parameters_lay_out(context *c, parameters *p);
/* Sets all initial values. They depend only on the seed and the parameter's name. In host memory. */
void parameters_initialise(parameters *p, uint64_t seed);
/* Makes the gradients' block (zeroed) and marks the trained tensors needs_grad. */
sherf_status parameters_make_grads(context *c, parameters *p);
void parameters_zero_grads(parameters *p);
/* Moves the values to another memory, before gradients are made. NULL: they stay. */
sherf_status parameters_place(context *c, parameters *p, const tensor_memory *memory);
/* The values for the host to read: its own block, or a *copy (else NULL) for the caller to mem_free. */
sherf_status parameters_read(context *c, const parameters *p, const float **values, float **copy);
parameter *parameter_find(const parameters *p, const char *name);
int64_t parameters_trained_count(const parameters *p); /* scalars, without padding */

#endif
