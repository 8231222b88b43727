/* interval: a mean and how sure it is. */
#ifndef SHERF_INTERVAL_H
#define SHERF_INTERVAL_H

#include <math.h>

#include "base/base.h"

/* low and high are NaN where nothing is known of them; mean as well where there is no number. */
typedef struct {
    double mean, low, high;
} interval;
static const interval interval_none = {(double)NAN, (double)NAN, (double)NAN};
interval interval_of(double mean); /* without ends */
void numbers_sort(int n, double *x);

/* The mean of n numbers, one a person, weighted by how many pictures each is of (NULL: alike), with the 95 %
 * interval of the percentile bootstrap over people (2000 resamples by `key`; the same key gives the same
 * people, so differences are paired). NaNs and weights of 0 are left out; one number has no ends. Fails for
 * want of memory only. */
sherf_status interval_bootstrap(context *c, int n, const double *x, const double *weight, uint64_t key,
                                interval *out);

#endif
