/* numpy: element types, and arrays of them. */
#include <string.h>

#include "io/build.h"

static bool one_of(char ch, const char *set) {
    return ch && strchr(set, ch);
}

/* ---------------------------------------------------------------- element types ---------------------- */
/* "<f8", "|b1", "O", ">i4", "f4", "|S6", "<U3". False for a kind or size that no numpy type has. */
bool numpy_type_parse(const char *text, size_t length, numpy_type *out) {
    size_t i = 0;
    *out = (numpy_type){0};
    if (i < length && one_of(text[i], "<>=|")) out->big_endian = text[i++] == '>';
    if (i >= length || !one_of(text[i], "biufcSUVOMma?")) return false;
    out->kind = text[i] == '?' ? 'b' : text[i] == 'a' ? 'S' : text[i];
    i++;
    bool digits = i < length && text[i] >= '0' && text[i] <= '9';
    for (; i < length && text[i] >= '0' && text[i] <= '9'; i++) {
        if (out->size > INT32_MAX / 10 - 9) return false;
        out->size = out->size * 10 + (text[i] - '0');
    }
    if (out->kind == 'b') return (!digits || out->size == 1) && (out->size = 1, i == length);
    if (out->kind == 'O') {
        out->size = 8;
        return i == length;
    }
    if (out->kind == 'U') {
        if (out->size > INT32_MAX / 4) return false;
        out->size *= 4;
    }
    if (out->kind == 'M' || out->kind == 'm') return true; /* "[ns]" may follow; such arrays are refused */
    if (one_of(out->kind, "iuf") && (out->size < 1 || out->size > 16)) return false;
    return i == length;
}

/* The type that stores such elements here; false: none does. */
static bool held_as(numpy_type t, dtype *out) {
    if (t.kind == 'b' || (t.kind == 'u' && t.size == 1))
        *out = T_U8;
    else if ((t.kind == 'i' && (t.size == 1 || t.size == 2 || t.size == 4)) || (t.kind == 'u' && t.size == 2))
        *out = T_I32;
    else if ((t.kind == 'i' && t.size == 8) || (t.kind == 'u' && (t.size == 4 || t.size == 8)))
        *out = T_I64;
    else if (t.kind == 'f' && t.size == 2)
        *out = T_F16;
    else if (t.kind == 'f' && t.size == 4)
        *out = T_F32;
    else if (t.kind == 'f' && t.size == 8)
        *out = T_F64;
    else
        return false;
    return true;
}

/* Stores one element, its bytes in little-endian order, in slot i. uint64 above INT64_MAX wraps: in a body
 * file, 2^64 - 1 means "no parent". */
static void store(numpy_type t, dtype type, const unsigned char *p, void *data, size_t i) {
    uint64_t bits = 0;
    memcpy(&bits, p, (size_t)t.size);
    if (type == T_U8)
        ((uint8_t *)data)[i] = t.kind == 'b' ? bits != 0 : (uint8_t)bits;
    else if (type == T_I32)
        ((int32_t *)data)[i] = t.kind == 'u' ? (int32_t)bits
                               : t.size == 1 ? (int8_t)bits
                               : t.size == 2 ? (int16_t)bits
                                             : (int32_t)bits;
    else if (type == T_I64 || type == T_F64)
        ((uint64_t *)data)[i] = bits;
    else if (type == T_F32)
        ((uint32_t *)data)[i] = (uint32_t)bits;
    else
        ((uint16_t *)data)[i] = (uint16_t)bits;
}

/* ---------------------------------------------------------------- order of elements ------------------ */
/* Visits an array's elements in row-major order; `at` is the element's index in the file. */
typedef struct {
    int rank;
    int64_t dim[8], step[8], index[8], at;
} walk;

static walk walk_start(int rank, const int64_t *dim, bool fortran) {
    walk w = {.rank = rank};
    int64_t step = 1;
    for (int k = 0; k < rank; k++) {
        int i = fortran ? k : rank - 1 - k;
        w.dim[i] = dim[i];
        w.step[i] = step;
        step *= dim[i];
    }
    return w;
}

static void walk_next(walk *w) {
    for (int i = w->rank - 1; i >= 0; i--) {
        w->at += w->step[i];
        if (++w->index[i] < w->dim[i]) return;
        w->at -= w->step[i] * w->dim[i];
        w->index[i] = 0;
    }
}

/* Nested lists of the items in row-major order; rank 0 is the item itself. */
static value *nest(builder *b, int rank, const int64_t *dim, value **item, size_t *next) {
    if (rank == 0) return item[(*next)++];
    value *list = build_value(b, VALUE_LIST);
    for (int64_t i = 0; list && i < dim[0]; i++)
        if (!build_append(b, list, nest(b, rank - 1, dim + 1, item, next))) return NULL;
    return list;
}

value *numpy_objects(builder *b, int rank, const int64_t *dim, bool fortran, value **item, size_t count) {
    int64_t n = rank <= 8 ? build_count(rank, dim) : -1;
    if (n < 0 || (size_t)n != count)
        return build_fail(b, SHERF_BAD_FILE, "an object array's shape does not fit its %zu items", count);
    if (n == 0) return build_value(b, VALUE_LIST); /* (0, 2^60) must not make many lists */
    value **ordered = build_memory(b, count, sizeof *ordered);
    if (!ordered) return NULL;
    walk w = walk_start(rank, dim, fortran);
    for (size_t i = 0; i < count; i++, walk_next(&w)) ordered[i] = item[w.at];
    size_t next = 0;
    return nest(b, rank, dim, ordered, &next);
}

/* A fixed-width string: S holds bytes, U UTF-32; both are padded with zeros. */
static value *fixed_string(builder *b, numpy_type t, const unsigned char *p) {
    if (t.kind == 'S') {
        size_t n = (size_t)t.size;
        while (n && !p[n - 1]) n--;
        return build_string(b, (const char *)p, n);
    }
    char *text = build_memory(b, (size_t)t.size + 1, 1); /* 4 bytes never become more than 4 bytes */
    if (!text) return NULL;
    size_t n = 0;
    for (int64_t i = 0; i + 4 <= t.size; i += 4) {
        const unsigned char *q = p + i;
        uint32_t u = t.big_endian ? (uint32_t)q[0] << 24 | q[1] << 16 | q[2] << 8 | q[3]
                                  : (uint32_t)q[3] << 24 | q[2] << 16 | q[1] << 8 | q[0];
        if (!u) break;
        if (u > 0x10ffff) return build_fail(b, SHERF_BAD_FILE, "a string that is not Unicode");
        if (u < 0x80)
            text[n++] = (char)u;
        else {
            int more = u < 0x800 ? 1 : u < 0x10000 ? 2 : 3;
            text[n++] = (char)((0xff00 >> (more + 1) & 0xff) | u >> 6 * more);
            while (more--) text[n++] = (char)(0x80 | (u >> 6 * more & 63));
        }
    }
    return build_string(b, text, n);
}

static value *string_array(builder *b, numpy_type t, int rank, const int64_t *dim, bool fortran,
                           const unsigned char *data, size_t count) {
    value **item = build_memory(b, count, sizeof *item);
    if (!item) return NULL;
    for (size_t i = 0; i < count; i++) {
        item[i] = fixed_string(b, t, data + i * (size_t)t.size);
        if (!item[i]) return NULL;
    }
    return numpy_objects(b, rank, dim, fortran, item, count);
}

value *numpy_array(builder *b, numpy_type t, int rank, const int64_t *dim, bool fortran,
                   const unsigned char *data, size_t bytes) {
    int64_t n = rank >= 0 && rank <= 8 ? build_count(rank, dim) : -1, total;
    if (n < 0 || __builtin_mul_overflow(n, t.size, &total))
        return build_fail(b, SHERF_BAD_FILE, "an array's shape is impossible");
    if ((uint64_t)total != bytes)
        return build_fail(b, SHERF_BAD_FILE, "an array of %lld bytes with %zu bytes of data",
                          (long long)total, bytes);
    if ((t.kind == 'S' || t.kind == 'U') && (n <= 1 || t.size > 0))
        return string_array(b, t, rank, dim, fortran, data, (size_t)n);
    dtype type;
    if (!held_as(t, &type))
        return build_fail(b, SHERF_BAD_FILE, "an array of type %c%lld, which is not read", t.kind,
                          (long long)t.size);
    value *v = build_array(b, type, rank, dim);
    if (!v || !n) return v;
    bool in_order = !fortran || rank < 2;
    if (in_order && !t.big_endian && (size_t)t.size == dtype_size(type) && t.kind != 'b') {
        memcpy(v->array.data, data, bytes);
        return v;
    }
    walk w = walk_start(rank, dim, fortran);
    for (size_t i = 0; i < (size_t)n; i++, walk_next(&w)) {
        const unsigned char *p = data + (size_t)w.at * (size_t)t.size;
        unsigned char turned[8];
        if (t.big_endian) {
            for (int64_t k = 0; k < t.size; k++) turned[k] = p[t.size - 1 - k];
            p = turned;
        }
        store(t, type, p, v->array.data, i);
    }
    return v;
}
