/* Files of tests/data/io, and their readers by name. */
#ifndef SAMPLE_H
#define SAMPLE_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "support.h"

#include "base/path.h"
#include "io/image.h"
#include "io/safetensors.h"
#include "io/value.h"

static inline const char *sample_path(const char *name) {
    static char path[4][256];
    static int next;
    next = (next + 1) % 4;
    snprintf(path[next], sizeof path[next], "data/io/%s", name);
    return path[next];
}

static inline document *sample_read(context *c, const char *name, const char *kind) {
    document *d = NULL;
    const char *found = NULL;
    assert_ok(c, document_read(c, sample_path(name), &d, &found));
    assert_string_equal(found, kind);
    return d;
}

static inline void assert_shape(const value *v, dtype type, int rank, const int64_t *dim) {
    assert_non_null(v);
    assert_int_equal(v->kind, VALUE_ARRAY);
    assert_int_equal(v->array.type, type);
    assert_int_equal(v->array.rank, rank);
    for (int i = 0; i < rank; i++) assert_int_equal(v->array.dim[i], dim[i]);
}

/* Checks that the numbers of v are exactly these. */
static inline void assert_numbers(context *c, const value *v, size_t n, const double *want) {
    double *have = calloc(n + 1, sizeof *have);
    assert_non_null(v);
    assert_ok(c, value_doubles(c, v, "numbers", n, have));
    for (size_t i = 0; i < n; i++) assert_true(have[i] == want[i]);
    free(have);
}
#endif
