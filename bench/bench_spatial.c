/* bench_spatial [points [filter]]: the spatial ops at the network's shapes, forward and gradient, reference
 * and CPU backend in float32 and bf16, in turn: best and median in milliseconds, and the medians' ratios.
 * Points lie along rays through a thick shell, as they do around a body. The network takes its points 8192 at
 * a time; 300000 is a training picture. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tensor/tensor.h"

static tensor *made(context *c, dtype type, int rank, const int64_t *dim) {
    tensor *t = tensor_create(c, type, rank, dim);
    if (!t) {
        fprintf(stderr, "%s\n", c->message);
        exit(1);
    }
    return t;
}
#define MADE(type, ...)                                                                                      \
    made(c, type, (int)COUNT_OF(((int64_t[]){__VA_ARGS__})), (const int64_t[]){__VA_ARGS__})

static tensor *filled(context *c, tensor *t, float low, float high, bool gradient) {
    static uint64_t key = 1;
    key++;
    for (int64_t i = 0; i < tensor_count(t); i++)
        tensor_f32(t)[i] = low + (high - low) * (float)random_uniform(key, (uint64_t)i);
    t->needs_grad = gradient;
    if (gradient) t->grad = made(c, T_F32, t->rank, t->dim);
    return t;
}
#define FILLED(low, high, gradient, ...) filled(c, MADE(T_F32, __VA_ARGS__), low, high, gradient)

/* Points in [0, 1]^3 on rays along z: eight behind each other, about the shell. */
static void shell_point(int64_t i, int64_t points, float p[3]) {
    const int64_t rays = (points + 7) / 8, side = (int64_t)ceil(sqrt((double)rays)), ray = i / 8;
    const double x = 2 * (double)(ray % side) / (double)side - 1,
                 y = 2 * (double)(ray / side) / (double)side - 1;
    const double inside = 1 - 0.5 * (x * x + y * y), z = (i % 8 < 4 ? -1 : 1) * sqrt(inside > 0 ? inside : 0);
    p[0] = (float)(0.5 + 0.45 * x);
    p[1] = (float)(0.5 + 0.45 * y);
    p[2] = (float)(0.5 + 0.42 * z + 0.02 * (double)(i % 4)); /* below 1 */
}

static tensor *positions(context *c, int64_t points, int axes, const int64_t *size) {
    tensor *t = MADE(T_F32, points, axes);
    for (int64_t i = 0; i < points; i++) {
        float p[3];
        shell_point(i, points, p);
        for (int k = 0; k < axes; k++) tensor_f32(t)[axes * i + k] = p[k] * (float)size[k];
    }
    return t;
}

/* A grid with voxels where points of a coarse shell fall; returns their number. */
static int32_t grid_fill(tensor *grid, int64_t points) {
    int32_t rows = 0;
    const int64_t D = grid->dim[0], H = grid->dim[1], W = grid->dim[2];
    memset(grid->data, 0xff, (size_t)tensor_count(grid) * sizeof(int32_t));
    for (int64_t i = 0; i < points; i++) {
        float p[3];
        shell_point(i, points, p);
        tensor_i32(grid)[((int64_t)(p[2] * (float)D) * H + (int64_t)(p[1] * (float)H)) * W +
                         (int64_t)(p[0] * (float)W)] = 1;
    }
    for (int64_t i = 0; i < D * H * W; i++)
        if (tensor_i32(grid)[i] > 0) tensor_i32(grid)[i] = rows++;
    return rows;
}

/* The submanifold rule of a grid. */
static tensor *rule_of(context *c, const tensor *grid, int32_t rows) {
    tensor *rule = MADE(T_I32, rows, 27);
    const int64_t D = grid->dim[0], H = grid->dim[1], W = grid->dim[2];
    for (int64_t z = 0; z < D; z++)
        for (int64_t y = 0; y < H; y++)
            for (int64_t x = 0; x < W; x++) {
                const int32_t a = tensor_i32(grid)[(z * H + y) * W + x];
                for (int k = 0; a >= 0 && k < 27; k++) {
                    const int64_t u = x + k % 3 - 1, v = y + k / 3 % 3 - 1, w = z + k / 9 - 1;
                    const bool inside = u >= 0 && u < W && v >= 0 && v < H && w >= 0 && w < D;
                    tensor_i32(rule)[a * 27 + k] = inside ? tensor_i32(grid)[(w * H + v) * W + u] : -1;
                }
            }
    return rule;
}

typedef struct {
    tensor *in[8];
    int64_t a, b;
} bench_data;
typedef struct {
    const char *name;
    void (*make)(context *c, bench_data *d, int64_t P);
    tensor *(*build)(tape *t, bench_data *d);
    int64_t a, b; /* channels, sizes: by kind */
} bench_case;

static void bilinear_make(context *c, bench_data *d, int64_t P) {
    const int64_t size[] = {d->b, d->b};
    d->in[0] = FILLED(-1, 1, true, d->b, d->b, d->a);
    d->in[1] = positions(c, P, 2, size);
}
static tensor *bilinear_build(tape *t, bench_data *d) {
    return op_sample_bilinear(t, d->in[0], d->in[1]);
}

static void trilinear_make(context *c, bench_data *d, int64_t P) {
    const int64_t size[] = {d->b, d->b, d->b / 4};
    d->in[1] = MADE(T_I32, size[2], size[1], size[0]);
    d->in[0] = FILLED(-1, 1, true, grid_fill(d->in[1], d->b * d->b * 8 / 16), d->a);
    d->in[2] = positions(c, P, 3, size);
}
static tensor *trilinear_build(tape *t, bench_data *d) {
    return op_sample_trilinear(t, d->in[0], d->in[1], d->in[2]);
}

static void sparse_make(context *c, bench_data *d, int64_t P) {
    tensor *grid = MADE(T_I32, d->b / 4, d->b, d->b);
    const int32_t rows = grid_fill(grid, d->b * d->b * 8);
    d->in[0] = FILLED(-1, 1, true, rows, d->a);
    d->in[1] = FILLED(-1, 1, true, d->a, 3, 3, 3, d->a);
    d->in[2] = rule_of(c, grid, rows);
    int64_t pairs = 0;
    for (int64_t i = 0; i < tensor_count(d->in[2]); i++) pairs += tensor_i32(d->in[2])[i] >= 0;
    printf("%d voxels, %.1f taps each, %.2f GFLOP each way\n", rows, (double)pairs / rows,
           2e-9 * (double)(pairs * d->a * d->a));
    tensor_free(grid);
}
static tensor *sparse_build(tape *t, bench_data *d) {
    return op_sparse_conv(t, d->in[0], d->in[1], d->in[2]);
}

static void scatter_make(context *c, bench_data *d, int64_t P) {
    d->in[0] = FILLED(-1, 1, true, 6890, 32);
    d->in[1] = MADE(T_I32, 6890);
    for (int i = 0; i < 6890; i++) tensor_i32(d->in[1])[i] = i < 6000 ? i : (i * 7) % 6000;
}
static tensor *scatter_build(tape *t, bench_data *d) {
    return op_scatter_mean(t, d->in[0], d->in[1], 6000);
}

static void rows_make(context *c, bench_data *d, int64_t P) {
    d->in[0] = FILLED(-2, 2, true, P, 3, d->a);
    d->in[1] = FILLED(0.5, 1.5, true, d->a);
    d->in[2] = FILLED(-1, 1, true, d->a);
}
static tensor *norm_build(tape *t, bench_data *d) {
    return op_layer_norm(t, d->in[0], d->in[1], d->in[2]);
}
static tensor *attention_build(tape *t, bench_data *d) {
    return op_token_attention(t, d->in[0], 3, 3, 16);
}
static tensor *gelu_build(tape *t, bench_data *d) {
    return op_gelu(t, d->in[0]);
}

static void points_make(context *c, bench_data *d, int64_t P) {
    d->in[0] = FILLED(-1, 1, true, P, 3);
}
static tensor *sigmoid_build(tape *t, bench_data *d) {
    return op_sigmoid(t, d->in[0], 1.002f, -0.001f);
}
static tensor *encode_build(tape *t, bench_data *d) {
    return op_positional_encode(t, d->in[0], 6, 39);
}

static void composite_make(context *c, bench_data *d, int64_t P) {
    const int64_t N = P / 6 + 1;
    d->in[0] = FILLED(-20, 20, true, P, 1);
    d->in[1] = FILLED(0, 1, true, P, 3);
    d->in[2] = MADE(T_I32, N + 1);
    d->in[3] = MADE(T_I32, P);
    for (int64_t n = 0; n <= N; n++) tensor_i32(d->in[2])[n] = (int32_t)(6 * n < P ? 6 * n : P);
    for (int64_t p = 0; p < P; p++) tensor_i32(d->in[3])[p] = (int32_t)(20 + p % 6);
    d->in[4] = FILLED(2, 2.5, false, N);
    d->in[5] = FILLED(3, 4, false, N);
    d->in[6] = FILLED(1, 1.3f, false, N);
}
static tensor *composite_build(tape *t, bench_data *d) {
    composite_attr attr = {48, 0, 2, 4};
    return op_composite(t, d->in[0], d->in[1], d->in[2], d->in[3], d->in[4], d->in[5], d->in[6], NULL, attr);
}

static void images_make(context *c, bench_data *d, int64_t P) {
    for (int i = 0; i < 2; i++) d->in[i] = FILLED(0, 1, i == 0, d->b, d->b / 2, d->a);
}
static tensor *square_build(tape *t, bench_data *d) {
    return op_mean_square(t, d->in[0], d->in[1], NULL);
}
static tensor *ssim_build(tape *t, bench_data *d) {
    return op_ssim(t, d->in[0], d->in[1]);
}
static tensor *distance_build(tape *t, bench_data *d) {
    return op_feature_distance(t, d->in[0], d->in[1], NULL);
}

static const bench_case cases[] = {
    {"sample_bilinear plane 256 x 32", bilinear_make, bilinear_build, 32, 256},
    {"sample_bilinear features 256 x 64", bilinear_make, bilinear_build, 64, 256},
    {"sample_bilinear image 512 x 3", bilinear_make, bilinear_build, 3, 512},
    {"sample_trilinear level 1, 32", trilinear_make, trilinear_build, 32, 192},
    {"sample_trilinear level 2, 64", trilinear_make, trilinear_build, 64, 96},
    {"sample_trilinear level 3, 96", trilinear_make, trilinear_build, 96, 48},
    {"scatter_mean 6890 x 32", scatter_make, scatter_build, 0, 0},
    {"sparse_conv 32", sparse_make, sparse_build, 32, 64},
    {"sparse_conv 64", sparse_make, sparse_build, 64, 48},
    {"sparse_conv 96", sparse_make, sparse_build, 96, 32},
    {"layer_norm 3P x 32", rows_make, norm_build, 32, 0},
    {"token_attention 3 x 3 x 16", rows_make, attention_build, 144, 0},
    {"gelu 3P x 32", rows_make, gelu_build, 32, 0},
    {"sigmoid P x 3", points_make, sigmoid_build, 0, 0},
    {"positional_encode P x 39", points_make, encode_build, 0, 0},
    {"composite", composite_make, composite_build, 0, 0},
    {"mean_square 512 x 256 x 3", images_make, square_build, 3, 512},
    {"ssim 512 x 256 x 3", images_make, ssim_build, 3, 512},
    {"feature_distance 512 x 256 x 64", images_make, distance_build, 64, 512},
    {"feature_distance 64 x 32 x 512", images_make, distance_build, 512, 64},
};

static int by_size(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

enum { REFERENCE, FLOAT32, BF16, KINDS, ROUNDS = 21 };
static const struct {
    const backend *backend;
    bool bf16;
} kinds[KINDS] = {{&backend_ref_f32, false}, {&backend_cpu, false}, {&backend_cpu, true}};

/* One run: seconds forward and backward. */
static void run(tape *t, const bench_case *k, bench_data *d, double took[2]) {
    tape_reset(t);
    const double start = time_seconds();
    tensor *y = k->build(t, d);
    const double middle = time_seconds();
    tensor *g = y ? tape_grad(t, y) : NULL;
    for (int64_t i = 0; g && i < tensor_count(g); i++) tensor_f32(g)[i] = 1e-3f * (float)(i % 7);
    const double again = time_seconds();
    if (!g || tape_backward_seeded(t) != SHERF_OK) {
        fprintf(stderr, "%s: %s\n", k->name, tape_context(t)->message);
        exit(1);
    }
    took[0] = middle - start;
    took[1] = time_seconds() - again;
}

/* Up to 21 rounds, about two seconds, of all kinds in turn (the reference in the first three rounds): best
 * and median of forward (0, 1) and backward (2, 3). */
static void measure(context *c, const bench_case *k, bench_data *d, double result[KINDS][4]) {
    double took[KINDS][2][ROUNDS], begin = time_seconds();
    tape *t[KINDS];
    int rounds = 0;
    for (int i = 0; i < KINDS; i++)
        if (!(t[i] = tape_create(
                  c, (tape_options){.backend = kinds[i].backend, .record = true, .bf16 = kinds[i].bf16})))
            exit(1);
    for (; rounds < ROUNDS && (rounds < 3 || time_seconds() - begin < 2); rounds++)
        for (int i = rounds < 3 ? 0 : 1; i < KINDS; i++) {
            double both[2];
            run(t[i], k, d, both);
            for (int way = 0; way < 2; way++) took[i][way][rounds] = both[way];
        }
    for (int i = 0; i < KINDS; i++) {
        const int n = i == REFERENCE ? 3 : rounds;
        tape_free(t[i]);
        for (int way = 0; way < 2; way++) {
            qsort(took[i][way], (size_t)n, sizeof(double), by_size);
            result[i][2 * way] = 1e3 * took[i][way][0];
            result[i][2 * way + 1] = 1e3 * took[i][way][n / 2];
        }
    }
}

int main(int argc, char **argv) {
    const int64_t P = argc > 1 ? atoll(argv[1]) : 300000;
    const sherf_options options = {.threads = argc > 2 ? atoi(argv[2]) : 0};
    context *c;
    if (P < 1 || sherf_context_create(&options, &c) != SHERF_OK) return 1;
    printf("%lld points, %d threads, %s; milliseconds: best (median)\n", (long long)P, c->threads,
           isa_name(isa_best()));
    printf("%-34s %19s %19s %19s %19s %19s %19s\n", "", "reference forward", "backward", "float32 forward",
           "backward", "bf16 forward", "backward");
    for (size_t i = 0; i < COUNT_OF(cases); i++) {
        if (argc > 3 && !strstr(cases[i].name, argv[3])) continue;
        bench_data d = {.a = cases[i].a, .b = cases[i].b};
        double r[KINDS][4];
        cases[i].make(c, &d, P);
        measure(c, &cases[i], &d, r);
        printf("%-34s", cases[i].name);
        for (int j = 0; j < 4 * KINDS; j += 2) printf(" %8.3f (%8.3f)", r[j / 4][j % 4], r[j / 4][j % 4 + 1]);
        printf("  x %.1f, %.1f; bf16 x %.1f, %.1f\n", r[REFERENCE][1] / r[FLOAT32][1],
               r[REFERENCE][3] / r[FLOAT32][3], r[FLOAT32][1] / r[BF16][1], r[FLOAT32][3] / r[BF16][3]);
        fflush(stdout);
        for (int j = 0; j < 8; j++) tensor_free(d.in[j]);
    }
    sherf_context_free(c);
    return 0;
}
