/* components: uses the rows' N x N products and computes only their first few eigenvectors: orthogonal
 * iteration, then Jacobi's rotations inside the space found. All sums run in a fixed order. */
#include "synth/body/components.h"

#include <math.h>
#include <string.h>

enum { SPARE = 8, ROUNDS = 200, SWEEPS = 60, WANTED_MAX = 32 };

typedef struct {
    int64_t n, d;
    const float *rows;
    double *gram;
} gram_job;

static double product(int64_t d, const float *a, const float *b) {
    double s[8] = {0};
    int64_t i = 0;
    for (; i + 8 <= d; i += 8)
        for (int k = 0; k < 8; k++) s[k] += (double)a[i + k] * (double)b[i + k];
    for (; i < d; i++) s[0] += (double)a[i] * (double)b[i];
    return ((s[0] + s[1]) + (s[2] + s[3])) + ((s[4] + s[5]) + (s[6] + s[7]));
}

/* Row pairs (r, n - 1 - r), which have equal work. */
static void gram_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const gram_job *job = arg;
    for (int64_t half = begin; half < end; half++)
        for (int side = 0; side < 2; side++) {
            int64_t i = side ? job->n - 1 - half : half;
            if (side && i == half) continue;
            for (int64_t j = 0; j <= i; j++)
                job->gram[i * job->n + j] = job->gram[j * job->n + i] =
                    product(job->d, job->rows + i * job->d, job->rows + j * job->d);
        }
}

/* Gram-Schmidt, twice; vectors are rows of v (count x n). */
static void orthonormal(int count, int64_t n, double *v) {
    for (int a = 0; a < count; a++) {
        double *x = v + a * n;
        for (int twice = 0; twice < 2; twice++)
            for (int b = 0; b < a; b++) {
                const double *y = v + b * n;
                double dot = 0;
                for (int64_t i = 0; i < n; i++) dot += x[i] * y[i];
                for (int64_t i = 0; i < n; i++) x[i] -= dot * y[i];
            }
        double length = 0;
        for (int64_t i = 0; i < n; i++) length += x[i] * x[i];
        length = sqrt(length);
        for (int64_t i = 0; i < n; i++) x[i] = length > 0 ? x[i] / length : i == a;
    }
}

static void apply(const gram_job *job, int count, const double *v, double *out) {
    int64_t n = job->n;
    for (int a = 0; a < count; a++)
        for (int64_t i = 0; i < n; i++) {
            double sum = 0;
            for (int64_t j = 0; j < n; j++) sum += job->gram[i * n + j] * v[a * n + j];
            out[a * n + i] = sum;
        }
}

/* Eigenvalues on the diagonal of A (n x n), eigenvectors as columns of E. */
static void jacobi(int n, double *A, double *E) {
    for (int i = 0; i < n * n; i++) E[i] = i % (n + 1) == 0;
    for (int sweep = 0; sweep < SWEEPS; sweep++)
        for (int p = 0; p < n; p++)
            for (int q = p + 1; q < n; q++) {
                if (fabs(A[p * n + q]) <= 1e-18 * (fabs(A[p * n + p]) + fabs(A[q * n + q]))) continue;
                double theta = 0.5 * atan2(2 * A[p * n + q], A[q * n + q] - A[p * n + p]);
                double co = cos(theta), si = sin(theta);
                for (int k = 0; k < n; k++) {
                    double x = A[k * n + p], y = A[k * n + q];
                    A[k * n + p] = co * x - si * y, A[k * n + q] = si * x + co * y;
                }
                for (int k = 0; k < n; k++) {
                    double x = A[p * n + k], y = A[q * n + k];
                    A[p * n + k] = co * x - si * y, A[q * n + k] = si * x + co * y;
                }
                for (int k = 0; k < n; k++) {
                    double x = E[k * n + p], y = E[k * n + q];
                    E[k * n + p] = co * x - si * y, E[k * n + q] = si * x + co * y;
                }
            }
}

/* Ritz vectors of the space spanned by v, in falling order, into out (count x n); value: their eigenvalues.
 */
static void ritz(const gram_job *job, int size, const double *v, double *scratch, int count, double *out,
                 double *value) {
    double A[(WANTED_MAX + SPARE) * (WANTED_MAX + SPARE)], E[(WANTED_MAX + SPARE) * (WANTED_MAX + SPARE)];
    int64_t n = job->n;
    apply(job, size, v, scratch);
    for (int a = 0; a < size; a++)
        for (int b = 0; b < size; b++) {
            double sum = 0;
            for (int64_t i = 0; i < n; i++) sum += v[a * n + i] * scratch[b * n + i];
            A[a * size + b] = sum;
        }
    jacobi(size, A, E);
    bool used[WANTED_MAX + SPARE] = {0};
    for (int k = 0; k < count; k++) {
        int best = -1;
        for (int a = 0; a < size; a++)
            if (!used[a] && (best < 0 || A[a * size + a] > A[best * size + best])) best = a;
        used[best] = true;
        value[k] = A[best * size + best];
        for (int64_t i = 0; i < n; i++) {
            double sum = 0;
            for (int a = 0; a < size; a++) sum += E[a * size + best] * v[a * n + i];
            out[k * n + i] = sum;
        }
    }
}

sherf_status components_find(context *c, int64_t n, int64_t d, const float *rows, int count,
                             double *direction, double *share) {
    if (count < 1 || count > WANTED_MAX || n < count + 2)
        return failure(c, SHERF_BAD_ARGUMENT, "%d components of %lld rows", count, (long long)n);
    int size = n < count + SPARE ? (int)n : count + SPARE;
    double value[WANTED_MAX], whole = 0;
    sherf_status status = SHERF_NO_MEMORY;
    gram_job job = {n, d, rows, mem_alloc(c, (size_t)n * (size_t)n, sizeof(double))};
    double *v = mem_alloc(c, (size_t)size * (size_t)n, sizeof *v);
    double *next = mem_alloc(c, (size_t)size * (size_t)n, sizeof *next);
    if (!job.gram || !v || !next) goto done;
    parallel_for(c, (n + 1) / 2, 1, gram_rows, &job);
    for (int64_t i = 0; i < n; i++) whole += job.gram[i * n + i];
    for (int64_t i = 0; i < size * n; i++) v[i] = random_uniform(fnv1a64("components"), (uint64_t)i) - 0.5;
    orthonormal(size, n, v);
    for (int r = 0; r < ROUNDS; r++) {
        apply(&job, size, v, next);
        memcpy(v, next, (size_t)(size * n) * sizeof *v);
        orthonormal(size, n, v);
    }
    double *vector = next; /* scratch and result differ: ritz needs both */
    double *scratch = mem_alloc(c, (size_t)size * (size_t)n, sizeof *scratch);
    if (!scratch) goto done;
    ritz(&job, size, v, scratch, count, vector, value);
    mem_free(scratch);
    /* rows^T u / sqrt(n): u is a unit vector, so this has the length of one standard deviation */
    for (int k = 0; k < count; k++) {
        double *to = direction + k * d, scale = 1 / sqrt((double)n);
        memset(to, 0, (size_t)d * sizeof *to);
        for (int64_t i = 0; i < n; i++) {
            double w = vector[k * n + i] * scale;
            for (int64_t j = 0; j < d; j++) to[j] += w * (double)rows[i * d + j];
        }
        share[k] = whole > 0 ? value[k] / whole : 0;
    }
    status = SHERF_OK;
done:
    mem_free(job.gram);
    mem_free(v);
    mem_free(next);
    return status;
}

bool solve_positive(int n, double *A, double *x) {
    for (int i = 0; i < n; i++) /* Cholesky, lower */
        for (int j = 0; j <= i; j++) {
            double sum = A[i * n + j];
            for (int k = 0; k < j; k++) sum -= A[i * n + k] * A[j * n + k];
            if (i > j)
                A[i * n + j] = sum / A[j * n + j];
            else if (sum > 0)
                A[i * n + i] = sqrt(sum);
            else
                return false;
        }
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < i; k++) x[i] -= A[i * n + k] * x[k];
        x[i] /= A[i * n + i];
    }
    for (int i = n - 1; i >= 0; i--) {
        for (int k = i + 1; k < n; k++) x[i] -= A[k * n + i] * x[k];
        x[i] /= A[i * n + i];
    }
    return true;
}
