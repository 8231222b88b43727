/* buckets: sums gradients over processes that have a device each, while the backward pass of a process's last
 * sample still runs. The gradients' block is cut into stretches, which are summed in a fixed order, the last
 * one first. That is the same order in every process, and about the one in which the backward pass finishes
 * them. */
#ifndef SHERF_BUCKETS_H
#define SHERF_BUCKETS_H

#include "nn/parameters.h"
#include "train/ranks.h"

typedef struct buckets buckets;
/* Called before a stretch of n floats is summed: adds what is still missing. */
typedef sherf_status (*buckets_ready_function)(context *c, void *user, int64_t begin, int64_t n);
sherf_status buckets_create(context *c, const parameters *weights, const ranks *r,
                            buckets_ready_function ready, void *user, buckets **out);
void buckets_free(buckets *b); /* NULL is fine */
/* Between buckets_begin and buckets_finish, gradients that are final are summed: for tape_on_final. */
void buckets_begin(buckets *b);
void buckets_final(void *b, tensor *value);
/* Sums the rest; work requested from now on runs after all sums. */
sherf_status buckets_finish(context *c, buckets *b);

#endif
