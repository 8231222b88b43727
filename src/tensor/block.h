/* block: plain arrays of numbers in a memory (NULL: the host's): models' weights, their gradients, an
 * optimiser's state. Copies and the arithmetic of training run in that memory, in the order of the calls;
 * only downloads wait. */
#ifndef SHERF_BLOCK_H
#define SHERF_BLOCK_H

#include "tensor/tensor.h"

#ifdef __cplusplus
extern "C" {
#endif

void *block_take(context *c, const tensor_memory *memory, size_t count, size_t size); /* zeroed */
void block_give(const tensor_memory *memory, void *block);                            /* NULL is fine */
sherf_status block_upload(context *c, const tensor_memory *memory, void *to, const void *from, size_t bytes);
sherf_status block_download(context *c, const tensor_memory *memory, void *to, const void *from,
                            size_t bytes);
sherf_status block_copy(context *c, const tensor_memory *memory, void *to, const void *from, size_t bytes);
sherf_status block_clear(context *c, const tensor_memory *memory, void *to, size_t bytes);

/* One update of train/adam.h: m <- beta1 m + (1 - beta1) g; v <- beta2 v + (1 - beta2) g^2;
 * x <- x - rate correction1 m / (sqrt(correction v) + eps) */
typedef struct {
    float beta1, beta2, rate, correction1, correction, eps;
} adam_factors;
enum { SQUARE_SUMS = 256 }; /* parts of a block's square sum; the block's size determines theirs */

/* Arithmetic for a memory that is not the host's; train/ has the host's. n floats each. */
struct block_kernels {
    sherf_status (*add)(context *c, int64_t n, float *to, const float *from); /* to += from */
    sherf_status (*adam)(context *c, int64_t n, float *values, float *first /* NULL: beta1 is 0 */,
                         float *second, const float *gradients, adam_factors f);
    /* average <- value + decay (average - value) */
    sherf_status (*average)(context *c, int64_t n, float *average, const float *values, float decay);
    /* sums[SQUARE_SUMS], in that memory: the sum of squares of each part. */
    sherf_status (*square_sums)(context *c, int64_t n, const float *x, double *sums);
    /* to[i] = mean over the rows of from[row * n + i], taken in double. */
    sherf_status (*mean_rows)(context *c, int64_t rows, int64_t n, const float *from, float *to);
};

/* Sums over processes with a device each. One process makes a name; all that know it join the group. */
enum { GROUP_NAME = 128 };
typedef struct block_group block_group;
struct block_groups {
    sherf_status (*name)(context *c, char *name); /* GROUP_NAME bytes; NULL: whether groups can be made */
    sherf_status (*join)(context *c, const char name[GROUP_NAME], int rank, int count, block_group **out);
    /* values <- the sum over processes. It starts after all work requested so far and runs beside work
     * requested later, which must not touch the values until `wait`. All processes request the same sums in
     * the same order. */
    sherf_status (*sum)(context *c, block_group *g, int64_t n, float *values);
    sherf_status (*wait)(context *c, block_group *g); /* work requested from now on runs after the sums */
    /* Frees the group. broken: other processes may not have requested sums that this one has; they are
     * abandoned. */
    void (*leave)(block_group *g, bool broken);
};

#ifdef __cplusplus
}
#endif
#endif
