/* interval: a mean and its confidence interval. */
#ifndef SHERF_INTERVAL_H
#define SHERF_INTERVAL_H

#include <math.h>

#include "base/base.h"

/* low and high are NaN if unknown; so is mean if there is no number. */
typedef struct {
    double mean, low, high;
} interval;
static const interval interval_none = {(double)NAN, (double)NAN, (double)NAN};
interval interval_of(double mean); /* without ends */
void numbers_sort(int n, double *x);

/* The mean of n numbers, one for each person, weighted by each person's number of pictures (NULL: equally),
 * with the 95 % interval of the percentile bootstrap over people (2000 resamples by `key`; the same key draws
 * the same people, so differences are paired). NaNs and weights of 0 are left out; a single number has no
 * interval. Fails only when out of memory. */
sherf_status interval_bootstrap(context *c, int n, const double *x, const double *weight, uint64_t key,
                                interval *out);

#endif
