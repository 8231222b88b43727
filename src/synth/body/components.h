/* components: principal components of many long rows, and small least squares. */
#ifndef SHERF_COMPONENTS_H
#define SHERF_COMPONENTS_H

#include "base/base.h"

/* rows: N x D, centred (the caller subtracted the mean). direction: count x D, orthogonal, each as long as
 * one standard deviation of the rows along it; share: of the whole variance, descending. N >= count + 2.
 * Signs are arbitrary. */
sherf_status components_find(context *c, int64_t n, int64_t d, const float *rows, int count,
                             double *direction, double *share);
/* Solves the symmetric positive definite A x = b (n x n), destroys A; false: not positive definite. */
bool solve_positive(int n, double *A, double *x);

#endif
