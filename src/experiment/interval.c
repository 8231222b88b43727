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

/* Interpolates linearly between the sorted values. */
static double percentile(int n, const double *sorted, double share) {
    const double at = share * (n - 1);
    const int i = (int)at < n - 1 ? (int)at : n - 2;
    return sorted[i] + (at - i) * (sorted[i + 1] - sorted[i]);
}

typedef struct {
    double x, weight;
} weighted;

/* The mean of all values, or of a random sample of the same size. */
static double mean_of(int n, const weighted *v, const uint64_t *key, int round) {
    double sum = 0, weight = 0;
    for (int i = 0; i < n; i++) {
        const int64_t at = key ? random_below(*key, (uint64_t)round * (uint64_t)n + (uint64_t)i, n) : i;
        sum += v[at].weight * v[at].x;
        weight += v[at].weight;
    }
    return sum / weight;
}

sherf_status interval_bootstrap(context *c, int n, const double *x, const double *weight, uint64_t key,
                                interval *out) {
    int known = 0;
    *out = interval_none;
    weighted *values = mem_alloc(c, (size_t)n + 1, sizeof *values);
    double *means = mem_alloc(c, RESAMPLES, sizeof *means);
    const bool room = values && means;
    for (int i = 0; i < n && room; i++)
        if (!isnan(x[i]) && (!weight || weight[i] > 0))
            values[known++] = (weighted){x[i], weight ? weight[i] : 1};
    if (known) out->mean = mean_of(known, values, NULL, 0);
    for (int r = 0; r < RESAMPLES && known > 1; r++) means[r] = mean_of(known, values, &key, r);
    if (known > 1) {
        numbers_sort(RESAMPLES, means);
        out->low = percentile(RESAMPLES, means, 0.025);
        out->high = percentile(RESAMPLES, means, 0.975);
    }
    mem_free(values);
    mem_free(means);
    return room ? SHERF_OK : SHERF_NO_MEMORY;
}
