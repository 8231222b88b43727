/* Statistics of a study's votes. */
#include <math.h>

#include "experiment/study.h"

static const double z95 = 1.959963984540054;

interval wilson(int64_t k, int64_t n) {
    if (n < 1) return interval_none;
    const double N = (double)n, p = (double)k / N, z2 = z95 * z95;
    const double middle = (p + z2 / (2 * N)) / (1 + z2 / N),
                 half = z95 / (1 + z2 / N) * sqrt(p * (1 - p) / N + z2 / (4 * N * N));
    return (interval){p, middle - half, middle + half};
}

double binomial_p(int64_t k, int64_t n) {
    const double N = (double)n;
    double tail = 0;
    if (n < 1) return NAN;
    if (2 * k > n) k = n - k;
    for (int64_t i = 0; i <= k; i++)
        tail += exp(lgamma(N + 1) - lgamma((double)i + 1) - lgamma(N - (double)i + 1) - N * log(2));
    return fmin(1, 2 * tail);
}

/* Hunter's minorisation: s_i <- W_i / sum_k n_ik / (s_i + s_k). */
void bradley_terry(int n, const double *wins, double *strength) {
    enum { ROUNDS = 5000 };
    for (int i = 0; i < n; i++) strength[i] = 1.0 / n;
    for (int round = 0; round < ROUNDS; round++) {
        double sum = 0, next[STUDY_METHODS];
        for (int i = 0; i < n; i++) {
            double won = 0, met = 0;
            for (int k = 0; k < n; k++) {
                const double both = wins[i * n + k] + wins[k * n + i];
                if (k == i || both <= 0) continue;
                won += wins[i * n + k] + 0.5;
                met += (both + 1) / (strength[i] + strength[k]);
            }
            sum += next[i] = met > 0 ? won / met : 0;
        }
        for (int i = 0; i < n && sum > 0; i++) strength[i] = next[i] / sum;
    }
}

double fleiss_kappa(int64_t items, const int *count) {
    double agreement = 0, total[2] = {0}, n = 0;
    for (int64_t i = 0; i < items; i++) {
        const double a = count[2 * i], b = count[2 * i + 1], all = a + b;
        if (all < 2) continue;
        agreement += (a * (a - 1) + b * (b - 1)) / (all * (all - 1));
        total[0] += a, total[1] += b;
        n++;
    }
    if (!(n > 0)) return NAN;
    const double share = total[0] / (total[0] + total[1]), chance = share * share + (1 - share) * (1 - share);
    return chance < 1 ? (agreement / n - chance) / (1 - chance) : NAN;
}
