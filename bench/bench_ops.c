/* bench_ops [--cpu] [filter]: the dense ops of the CPU backend at the network's shapes, forward and both
 * gradients, float32 and bf16: milliseconds (best of 15) and GFLOP/s. --cpu: one thread and its processor
 * time, which is meaningful on a busy machine too. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "tensor/tensor.h"

typedef struct {
    const char *name;
    op_id op;
    int in[4], w[4], out[4]; /* ranks end at the first 0 */
    conv2d_attr conv;
    int times; /* how often the encoders and the generator run it, for the total */
} bench_case;

#define CONV(n, h, c, o, k, s, p, times)                                                                     \
    {                                                                                                        \
        n, OP_conv2d, {h, h, c}, {o, c, k, k}, {(h + 2 * p - k) / s + 1, (h + 2 * p - k) / s + 1, o},        \
            {s, p, 1}, times                                                                                 \
    }
#define UP(n, h, c, o)                                                                                       \
    { n, OP_conv2d_transpose, {h, h, c}, {o, c, 3, 3}, {2 * h + 1, 2 * h + 1, o}, {2, 0, 1}, 1 }
#define LINEAR(n, r, i, o)                                                                                   \
    { n, OP_linear, {r, i}, {o, i}, {r, o}, {0}, 0 }

static const bench_case cases[] = {
    CONV("stem 7x7 s2 3-64 at 512", 512, 3, 64, 7, 2, 3, 2),
    CONV("layer1 3x3 64-64 at 256", 256, 64, 64, 3, 1, 1, 4),
    CONV("layer1 3x3 64-64 at 128", 128, 64, 64, 3, 1, 1, 4),
    CONV("layer2 3x3 s2 64-128 at 128", 128, 64, 128, 3, 2, 1, 1),
    CONV("layer2 1x1 s2 64-128 at 128", 128, 64, 128, 1, 2, 0, 1),
    CONV("layer2 3x3 128-128 at 64", 64, 128, 128, 3, 1, 1, 3),
    CONV("layer3 3x3 s2 128-256 at 64", 64, 128, 256, 3, 2, 1, 1),
    CONV("layer3 1x1 s2 128-256 at 64", 64, 128, 256, 1, 2, 0, 1),
    CONV("layer3 3x3 256-256 at 32", 32, 256, 256, 3, 1, 1, 3),
    CONV("layer4 3x3 s2 256-512 at 32", 32, 256, 512, 3, 2, 1, 1),
    CONV("layer4 1x1 s2 256-512 at 32", 32, 256, 512, 1, 2, 0, 1),
    CONV("layer4 3x3 512-512 at 16", 16, 512, 512, 3, 1, 1, 3),
    CONV("generator 3x3 512-512 at 4", 4, 512, 512, 3, 1, 1, 1),
    CONV("generator 3x3 512-512 at 8", 8, 512, 512, 3, 1, 1, 1),
    CONV("generator 3x3 512-512 at 16", 16, 512, 512, 3, 1, 1, 1),
    CONV("generator 3x3 512-512 at 32", 32, 512, 512, 3, 1, 1, 1),
    CONV("generator 3x3 512-512 at 64", 64, 512, 512, 3, 1, 1, 1),
    CONV("generator 3x3 256-256 at 128", 128, 256, 256, 3, 1, 1, 1),
    CONV("generator 3x3 128-128 at 256", 256, 128, 128, 3, 1, 1, 1),
    CONV("planes 1x1 512-96 at 4", 4, 512, 96, 1, 1, 0, 1),
    CONV("planes 1x1 512-96 at 8", 8, 512, 96, 1, 1, 0, 1),
    CONV("planes 1x1 512-96 at 16", 16, 512, 96, 1, 1, 0, 1),
    CONV("planes 1x1 512-96 at 32", 32, 512, 96, 1, 1, 0, 1),
    CONV("planes 1x1 512-96 at 64", 64, 512, 96, 1, 1, 0, 1),
    CONV("planes 1x1 256-96 at 128", 128, 256, 96, 1, 1, 0, 1),
    CONV("planes 1x1 128-96 at 256", 256, 128, 96, 1, 1, 0, 1),
    UP("up 3x3 512-512 at 4", 4, 512, 512),
    UP("up 3x3 512-512 at 8", 8, 512, 512),
    UP("up 3x3 512-512 at 16", 16, 512, 512),
    UP("up 3x3 512-512 at 32", 32, 512, 512),
    UP("up 3x3 512-256 at 64", 64, 512, 256),
    UP("up 3x3 256-128 at 128", 128, 256, 128),
    CONV("vgg 3x3 3-64 at 512", 512, 3, 64, 3, 1, 1, 0),
    CONV("vgg 3x3 64-64 at 512", 512, 64, 64, 3, 1, 1, 0),
    CONV("vgg 3x3 512-512 at 32", 32, 512, 512, 3, 1, 1, 0),
    LINEAR("linear 300000 x 96-32", 300000, 96, 32),
    LINEAR("linear 300000 x 32-144", 300000, 32, 144),
    LINEAR("linear 300000 x 71-128", 300000, 71, 128),
    LINEAR("linear 300000 x 128-128", 300000, 128, 128),
    LINEAR("linear 300000 x 199-128", 300000, 199, 128),
    LINEAR("linear 300000 x 187-64", 300000, 187, 64),
    LINEAR("linear 300000 x 128-1", 300000, 128, 1),
    LINEAR("linear 300000 x 64-3", 300000, 64, 3),
    LINEAR("linear 4096 x 128-128", 4096, 128, 128),
    LINEAR("linear 1 x 512-512", 1, 512, 512),
};

static tensor *filled(context *c, const int *shape, uint64_t key) {
    int64_t dim[4];
    int rank = 0;
    for (; rank < 4 && shape[rank]; rank++) dim[rank] = shape[rank];
    tensor *t = tensor_create(c, T_F32, rank, dim);
    if (!t) exit(1);
    for (int64_t i = 0; i < tensor_count(t); i++)
        tensor_f32(t)[i] = (float)random_uniform(key, (uint64_t)i) - 0.5f;
    return t;
}

static bool processor_time;

static double seconds_now(void) {
    if (!processor_time) return time_seconds();
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* The shortest of up to 15 runs, which other programs disturbed least. */
static double best_time(op_call *call, kernel k) {
    double best = 1e9, begin = time_seconds();
    for (int n = 0; n < 15 && (n < 3 || time_seconds() - begin < 0.4); n++) {
        const double start = seconds_now();
        arena_mark mark = arena_position(call->scratch);
        if (k(call) != SHERF_OK) {
            fprintf(stderr, "%s\n", call->c->message);
            exit(1);
        }
        arena_rewind(call->scratch, mark);
        const double took = seconds_now() - start;
        if (took < best) best = took;
    }
    return best;
}

/* Milliseconds of forward, gradient of x, gradient of w. */
static void measure(context *c, arena *scratch, const bench_case *b, bool bf16, double seconds[3]) {
    tensor *x = filled(c, b->in, 1), *w = filled(c, b->w, 2), *y = filled(c, b->out, 3);
    tensor *dx = filled(c, b->in, 4), *dw = filled(c, b->w, 5), *dy = filled(c, b->out, 6);
    linear_attr linear = {1, 1};
    op_call call = {
        .c = c, .op = b->op, .in = {x, w}, .out = {y}, .dout = {dy}, .scratch = scratch, .bf16 = bf16};
    call.attr = b->op == OP_linear ? (const void *)&linear : &b->conv;
    seconds[0] = best_time(&call, backend_cpu.forward[b->op]);
    call.din[0] = dx;
    seconds[1] = best_time(&call, backend_cpu.backward[b->op]);
    call.din[0] = NULL;
    call.din[1] = dw;
    seconds[2] = best_time(&call, backend_cpu.backward[b->op]);
    tensor *all[] = {x, w, y, dx, dw, dy};
    for (int i = 0; i < 6; i++) tensor_free(all[i]);
    arena_reset(scratch);
}

static double flops(const bench_case *b) {
    if (b->op == OP_linear) return 2.0 * b->in[0] * b->in[1] * b->out[1];
    const int *at = b->op == OP_conv2d ? b->out : b->in;
    return 2.0 * at[0] * at[1] * b->w[0] * b->w[1] * b->w[2] * b->w[3];
}

int main(int argc, char **argv) {
    context *c;
    processor_time = argc > 1 && !strcmp(argv[1], "--cpu");
    const char *filter = argc > 1 + processor_time ? argv[1 + processor_time] : "";
    if (sherf_context_create(&(sherf_options){.threads = processor_time}, &c) != SHERF_OK) return 1;
    arena *scratch = arena_create(c);
    if (!scratch) return 1;
    double total[2][3] = {{0}};
    printf("%d threads, %s\n%-32s %27s   %27s   (ms forward, dx, dw; GFLOP/s)\n", c->threads,
           isa_name(isa_best()), "", "float32", "bf16");
    for (size_t i = 0; i < COUNT_OF(cases); i++) {
        const bench_case *b = &cases[i];
        if (!strstr(b->name, filter)) continue;
        printf("%-32s", b->name);
        for (int bf16 = 0; bf16 < 2; bf16++) {
            double s[3];
            measure(c, scratch, b, bf16, s);
            for (int k = 0; k < 3; k++) {
                printf(" %7.2f %5.0f", s[k] * 1e3, flops(b) / s[k] * 1e-9);
                total[bf16][k] += b->times * s[k];
            }
            printf("  |");
            fflush(stdout);
        }
        printf("\n");
    }
    for (int bf16 = 0; bf16 < 2; bf16++)
        printf("both encoders and the generator, %s: forward %.0f ms, dx %.0f ms, dw %.0f ms, together %.0f "
               "ms\n",
               bf16 ? "bf16" : "float32", total[bf16][0] * 1e3, total[bf16][1] * 1e3, total[bf16][2] * 1e3,
               (total[bf16][0] + total[bf16][1] + total[bf16][2]) * 1e3);
    arena_free(scratch);
    sherf_context_free(c);
    return 0;
}
