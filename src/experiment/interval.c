/* The bootstrap over people. */
#include "experiment/interval.h"

#include <stdlib.h>
#include <string.h>

enum { RESAMPLES = 2000 };

interval interval_of(double mean) {
    return (interval){mean, NAN, NAN};
}

static int by_value(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

void numbers_sort(int n, double *x) {
    qsort(x, (size_t)n, sizeof *x, by_value);
}

static double mean_of(int n, const double *x) {
    double sum = 0;
    for (int i = 0; i < n; i++) sum += x[i];
    return sum / n;
}

/* Linear between the sorted values. */
static double percentile(int n, const double *sorted, double share) {
    const double at = share * (n - 1);
    const int i = (int)at < n - 1 ? (int)at : n - 2;
    return sorted[i] + (at - i) * (sorted[i + 1] - sorted[i]);
}

static double resample(int n, const double *x, uint64_t key, int r) {
    double sum = 0;
    for (int i = 0; i < n; i++) sum += x[random_below(key, (uint64_t)r * (uint64_t)n + (uint64_t)i, n)];
    return sum / n;
}

sherf_status interval_bootstrap(context *c, int n, const double *x, uint64_t key, interval *out) {
    int known = 0;
    *out = interval_none;
    double *values = mem_alloc(c, (size_t)n + RESAMPLES, sizeof *values), *means = values + n;
    if (!values) return SHERF_NO_MEMORY;
    for (int i = 0; i < n; i++)
        if (!isnan(x[i])) values[known++] = x[i];
    if (known) out->mean = mean_of(known, values);
    for (int r = 0; r < RESAMPLES && known > 1; r++) means[r] = resample(known, values, key, r);
    if (known > 1) {
        numbers_sort(RESAMPLES, means);
        out->low = percentile(RESAMPLES, means, 0.025);
        out->high = percentile(RESAMPLES, means, 0.975);
    }
    mem_free(values);
    return SHERF_OK;
}
