/* bench: the median time of several runs. */
#include <stdlib.h>

#include "train/bench.h"

static int compare(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

sherf_status bench_timed(bench *b, sherf_status (*once)(bench *b, void *arg), void *arg, double *ms) {
    const double budget_s = 5;
    static const int min = 5, max = 200;
    double *took = mem_alloc(b->c, REPEATS_MAX, sizeof *took);
    if (!took) return SHERF_NO_MEMORY;
    int n = 0;
    sherf_status status = once(b, arg);
    const double start = time_seconds();
    while (status == SHERF_OK) {
        double from = time_seconds();
        if (b->repeats ? n >= b->repeats : n >= max || (n >= min && from - start > budget_s)) break;
        if (cancelled(b->c)) {
            status = failure(b->c, SHERF_CANCELLED, "cancelled");
            break;
        }
        status = once(b, arg);
        took[n++] = 1e3 * (time_seconds() - from);
    }
    if (status == SHERF_OK) {
        qsort(took, (size_t)n, sizeof *took, compare);
        *ms = n % 2 ? took[n / 2] : (took[n / 2 - 1] + took[n / 2]) / 2;
    }
    mem_free(took);
    return status;
}
