/* components: principal components of many long rows, and small least squares. */
#ifndef SHERF_COMPONENTS_H
#define SHERF_COMPONENTS_H

#include "base/base.h"

/* rows: N x D, centred (the caller took the mean away). direction: count x D, orthogonal, each as long as one
 * standard deviation of the rows along it; share: of the whole variance, falling. N >= count + 2. Signs are
 * as they come. */
sherf_status components_find(context *c, int64_t n, int64_t d, const float *rows, int count,
                             double *direction, double *share);
/* Solves the symmetric positive definite A x = b (n x n), A is destroyed; false: not positive definite. */
bool solve_positive(int n, double *A, double *x);

#endif
