/* Shared by several test programs (support.h). */
#include <ftw.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "support.h"

context *test_context(void) {
    sherf_options options = {.threads = 2, .precision = SHERF_PRECISION_FP32, .device = SHERF_DEVICE_CPU};
    context *c = NULL;
    if (sherf_context_create(&options, &c) != SHERF_OK) abort();
    return c;
}

int test_open(void **state) {
    *state = test_context();
    return 0;
}

int test_close(void **state) {
    sherf_context_free(*state);
    return mem_live() == 0 ? 0 : -1;
}

double test_psnr(const sherf_image *a, const sherf_image *b) {
    const int64_t n = (int64_t)a->width * a->height * a->channels;
    double sum = 0;
    for (int64_t i = 0; i < n; i++)
        sum += ((double)a->data[i] - b->data[i]) * ((double)a->data[i] - b->data[i]);
    return sum > 0 ? -10 * log10(sum / (double)n) : 200;
}

void test_centred(const char *name, int64_t n, double scale, float *out) {
    uint64_t key = fnv1a64(name);
    for (int64_t i = 0; i < n; i++) out[i] = (float)(scale * (2.0 * random_uniform(key, (uint64_t)i) - 1.0));
}

static char folder[64];

static int remove_entry(const char *path, const struct stat *info, int type, struct FTW *ftw) {
    return remove(path);
}

static void remove_folder(void) {
    nftw(folder, remove_entry, 16, FTW_DEPTH | FTW_PHYS);
}

const char *test_path(const char *name) {
    static char path[4][512];
    static int next;
    if (!folder[0]) {
        strcpy(folder, "/tmp/sherf-test-XXXXXX");
        if (!mkdtemp(folder)) abort();
        atexit(remove_folder);
    }
    next = (next + 1) % 4;
    snprintf(path[next], sizeof path[next], "%s/%s", folder, name);
    return path[next];
}

static char *given_isa; /* SHERF_ISA as it was when the program started, or NULL */

__attribute__((constructor)) static void keep_isa(void) {
    const char *given = getenv("SHERF_ISA");
    given_isa = given ? strdup(given) : NULL;
}

void test_isa_restore(void) {
    if (given_isa)
        setenv("SHERF_ISA", given_isa, 1);
    else
        unsetenv("SHERF_ISA");
}

isa_level test_isa_highest(void) {
    const char *now = getenv("SHERF_ISA");
    char *kept = now ? strdup(now) : NULL;
    test_isa_restore();
    const isa_level highest = isa_best();
    if (kept)
        setenv("SHERF_ISA", kept, 1);
    else
        unsetenv("SHERF_ISA");
    free(kept);
    return highest;
}

bool test_isa(isa_level level) {
    if (level > test_isa_highest()) return false;
    const char *now = getenv("SHERF_ISA");
    char *kept = now ? strdup(now) : NULL;
    setenv("SHERF_ISA", isa_name(level), 1);
    const bool done = isa_best() == level;
    if (!done && kept) setenv("SHERF_ISA", kept, 1);
    if (!done && !kept) unsetenv("SHERF_ISA");
    free(kept);
    return done;
}
