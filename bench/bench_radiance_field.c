/* The radiance field at the paper's sizes on a 512 x 512 picture: seconds per frame for every instruction set
 * and precision, in one process, as medians of interleaved runs, beside the machine's measured peaks.
 * bench_radiance_field [threads [rounds [picture]]] */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "model/radiance_field_made.h"

#if defined(__x86_64__)
#include <immintrin.h>

/* 16 independent chains of 16-wide FMAs; multiply-adds a second. */
__attribute__((target("avx512f"))) static void fma_peak(void *arg, int64_t begin, int64_t end, int thread) {
    __m512 x[16], a = _mm512_set1_ps(0.999f), b = _mm512_set1_ps(0.001f);
    for (int k = 0; k < 16; k++) x[k] = _mm512_set1_ps((float)k);
    for (int i = 0; i < 1000000; i++) {
        for (int k = 0; k < 16; k++) x[k] = _mm512_fmadd_ps(x[k], a, b);
    }
    for (int k = 1; k < 16; k++) x[0] = _mm512_add_ps(x[0], x[k]);
    ((float *)arg)[thread * 16] = _mm512_reduce_add_ps(x[0]);
}

/* 4 independent chains of tile products, 16 x 16 x 32 multiply-adds each. */
__attribute__((target("amx-tile,amx-bf16"))) static void amx_peak(void *arg, int64_t begin, int64_t end,
                                                                  int thread) {
    struct {
        uint8_t palette, start, reserved[14];
        uint16_t bytes[16];
        uint8_t rows[16];
    } config __attribute__((aligned(64))) = {.palette = 1};
    for (int i = 0; i < 8; i++) {
        config.bytes[i] = 64;
        config.rows[i] = 16;
    }
    __asm__ volatile("" : : "r"(&config) : "memory"); /* gcc's intrinsic names 8 of the 64 bytes */
    _tile_loadconfig(&config);
    _tile_zero(0);
    _tile_zero(1);
    _tile_zero(2);
    _tile_zero(3);
    _tile_zero(4);
    _tile_zero(5);
    _tile_zero(6);
    _tile_zero(7);
    for (int i = 0; i < 500000; i++) {
        _tile_dpbf16ps(0, 4, 6);
        _tile_dpbf16ps(1, 4, 7);
        _tile_dpbf16ps(2, 5, 6);
        _tile_dpbf16ps(3, 5, 7);
    }
    _tile_release();
}
#endif

/* Processor time of all threads, divided by their number: steadier than wall time on a busy machine. */
static double busy_seconds(int threads) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return ((double)t.tv_sec + 1e-9 * (double)t.tv_nsec) / threads;
}

static double peak(const context *c, range_function f, double work_a_thread) {
    static float sink[1024];
    double best = 0;
    for (int i = 0; i < 5; i++) {
        double t = busy_seconds(c->threads);
        parallel_for(c, c->threads, 1, f, sink);
        best = fmax(best, work_a_thread * c->threads / (busy_seconds(c->threads) - t));
    }
    return best;
}

static int by_value(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

enum { WAYS = 7, ROUNDS_MAX = 101 };
typedef struct {
    const char *name, *isa;
    bool bf16, early_stop;
    int every; /* runs in every n-th round: slow variants need fewer */
    radiance_field *n;
    double seconds[ROUNDS_MAX], wall[ROUNDS_MAX]; /* processor time over threads; wall clock */
    int count;
} way;

/* Runs rounds of all variants in turn. False: one failed. */
static bool measure(context *c, const made *fixture, way ways[WAYS], int rounds) {
    static const float black[3];
    sherf_frame frame = {0};
    const char *only = getenv("BENCH_ONLY");
    for (int r = -1; r < rounds; r++) /* round -1 warms up */
        for (int i = 0; i < WAYS; i++) {
            way *w = &ways[i];
            if (!w->name || (r >= 0 && r % w->every)) continue;
            if (only && !strstr(w->name, only)) continue;
            setenv("SHERF_ISA", w->isa, 1);
            if (strcmp(isa_name(isa_best()), w->isa)) continue; /* needs another machine */
            if (!w->n) {
                double t = time_seconds();
                if (radiance_field_create(c, &fixture->s, &fixture->w, &fixture->bank, w->bf16, &w->n))
                    return false;
                printf("%-20s made in %.3f s\n", w->name, time_seconds() - t);
            }
            double t = busy_seconds(c->threads), wall = time_seconds();
            if (radiance_field_render(c, w->n, &fixture->rays, &fixture->points, black, w->early_stop,
                                      &frame))
                return false;
            if (r < 0) continue;
            w->wall[w->count] = time_seconds() - wall;
            w->seconds[w->count++] = busy_seconds(c->threads) - t;
        }
    sherf_frame_free(&frame);
    return true;
}

/* Prints medians next to the peaks that a variant can reach. */
static void report(way ways[WAYS], const made *fixture, double macs, double fma, double amx) {
    double first = 0;
    for (int i = 0; i < WAYS; i++) {
        way *w = &ways[i];
        if (!w->count) continue;
        qsort(w->seconds, (size_t)w->count, sizeof(double), by_value);
        qsort(w->wall, (size_t)w->count, sizeof(double), by_value);
        double median = w->seconds[w->count / 2];
        if (!first) first = median;
        double rate = macs * (double)fixture->points.count / median, top = w->bf16 ? amx : fma;
        printf("%-20s median %.4f s (best %.4f; wall %.4f, best %.4f), %.0f ns a point, %.1f x the first, "
               "%.0f GMAC/s",
               w->name, median, w->seconds[0], w->wall[w->count / 2], w->wall[0],
               median / (double)fixture->points.count * 1e9, first / median, rate * 1e-9);
        if (top > 0) printf(", %.0f %% of peak", 100 * rate / top);
        printf("\n");
        radiance_field_free(w->n);
    }
}

int main(int argc, char **argv) {
    int threads = argc > 1 ? atoi(argv[1]) : 2, rounds = argc > 2 ? atoi(argv[2]) : 7;
    int side = argc > 3 ? atoi(argv[3]) : 512;
    if (rounds < 1 || rounds > ROUNDS_MAX) rounds = 7;
    sherf_options options = {.threads = threads};
    context *c = NULL;
    if (sherf_context_create(&options, &c) != SHERF_OK) return 1;
    made fixture;
    made_create(&fixture, &made_paper, 256, 512, 0.005f, side, side, 48);
    isa_level best = isa_best();
    double macs = 32 * 32 + 3 * (32 * 144 + 48 * 32 + 2 * 32 * 32) + 71 * 128 + 6 * 128 * 128 + 199 * 128 +
                  128 + 187 * 64 + 64 * 3;
    printf("%lld points, %d x %d, %d threads, best %s; %.0f multiply-adds a point after merging\n",
           (long long)fixture.points.count, side, side, threads, isa_name(best), macs);
    double fma = 0, amx = 0;
#if defined(__x86_64__)
    if (best >= ISA_AVX512) fma = peak(c, fma_peak, 1e6 * 16 * 16);
    if (best >= ISA_AMX) amx = peak(c, amx_peak, 5e5 * 4 * 8192);
    printf("peak: %.0f GMAC/s AVX-512 FMA, %.0f GMAC/s AMX bf16\n", fma * 1e-9, amx * 1e-9);
#endif
    way ways[WAYS] = {
        {.name = "float32 plain", .isa = "plain", .every = 4},
        {.name = "float32 neon", .isa = "neon", .every = 1},
        {.name = "float32 avx2", .isa = "avx2", .every = 2},
        {.name = "float32 avx512", .isa = "avx512", .every = 1},
        {.name = "bf16 amx", .isa = "amx", .bf16 = true, .every = 1},
        {.name = "bf16 amx early stop", .isa = "amx", .bf16 = true, .early_stop = true, .every = 1},
    };
    if (!measure(c, &fixture, ways, rounds)) return 1;
    report(ways, &fixture, macs, fma, amx);
    made_free(&fixture);
    sherf_context_free(c);
    return 0;
}
