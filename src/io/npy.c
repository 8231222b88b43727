/* npy: numpy's element types, arrays of them, and the .npy file.
 * https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/path.h"
#include "io/build.h"

static bool one_of(char ch, const char *set) {
    return ch && strchr(set, ch);
}

static const size_t npy_bytes_max = (size_t)8 << 30;

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

/* The type that holds such elements here; false when none does. */
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

/* One element, its bytes in little-endian order, to slot i. uint64 above INT64_MAX wraps: a body file's
 * 2^64 - 1 means "no parent". */
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
/* Walks the places of an array in row-major order; `at` is the place's number in the file. */
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
    if (n == 0) return build_value(b, VALUE_LIST); /* (0, 2^60) must not become many lists */
    value **ordered = build_memory(b, count, sizeof *ordered);
    if (!ordered) return NULL;
    walk w = walk_start(rank, dim, fortran);
    for (size_t i = 0; i < count; i++, walk_next(&w)) ordered[i] = item[w.at];
    size_t next = 0;
    return nest(b, rank, dim, ordered, &next);
}

/* A fixed-width string: S holds bytes, U UTF-32; both padded with zeros. */
static value *fixed_string(builder *b, numpy_type t, const unsigned char *p) {
    if (t.kind == 'S') {
        size_t n = (size_t)t.size;
        while (n && !p[n - 1]) n--;
        return build_string(b, (const char *)p, n);
    }
    char *text = build_memory(b, (size_t)t.size + 1, 1); /* 4 bytes never become more than 4 */
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

/* ---------------------------------------------------------------- the file --------------------------- */
typedef struct {
    const char *p, *end;
} scanner;

static void blanks(scanner *s) {
    while (s->p < s->end && one_of(*s->p, " \t\r\n")) s->p++;
}
static bool take(scanner *s, char ch) {
    blanks(s);
    if (s->p >= s->end || *s->p != ch) return false;
    s->p++;
    return true;
}
static bool take_word(scanner *s, const char *word) {
    blanks(s);
    size_t n = strlen(word);
    if ((size_t)(s->end - s->p) < n || memcmp(s->p, word, n)) return false;
    s->p += n;
    return true;
}
static bool take_quoted(scanner *s, const char **text, size_t *length) {
    blanks(s);
    if (s->p >= s->end || (*s->p != '\'' && *s->p != '"')) return false;
    char quote = *s->p++;
    *text = s->p;
    while (s->p < s->end && *s->p != quote) s->p++;
    *length = (size_t)(s->p - *text);
    return s->p++ < s->end;
}

/* "(3, 4)", "(5,)", "()", with the L of Python 2 allowed. */
static bool take_shape(scanner *s, int *rank, int64_t dim[8]) {
    *rank = 0;
    if (!take(s, '(')) return false;
    while (!take(s, ')')) {
        if (*rank == 8) return false;
        blanks(s);
        int64_t n = 0;
        const char *start = s->p;
        for (; s->p < s->end && *s->p >= '0' && *s->p <= '9'; s->p++)
            if (__builtin_mul_overflow(n, (int64_t)10, &n) || __builtin_add_overflow(n, *s->p - '0', &n))
                return false;
        if (s->p == start) return false;
        take(s, 'L');
        dim[(*rank)++] = n;
        if (!take(s, ',')) {
            if (!take(s, ')')) return false;
            break;
        }
    }
    return true;
}

typedef struct {
    numpy_type type;
    bool fortran;
    int rank;
    int64_t dim[8];
} npy_header;

static bool header_parse(scanner s, npy_header *h) {
    int seen = 0; /* bits: descr, order, shape */
    if (!take(&s, '{')) return false;
    while (!take(&s, '}')) {
        const char *key, *text;
        size_t n, length;
        if (!take_quoted(&s, &key, &n) || !take(&s, ':')) return false;
        if (n == 5 && !memcmp(key, "descr", n)) {
            if (!take_quoted(&s, &text, &length) || !numpy_type_parse(text, length, &h->type)) return false;
            seen |= 1;
        } else if (n == 13 && !memcmp(key, "fortran_order", n)) {
            h->fortran = take_word(&s, "True");
            if (!h->fortran && !take_word(&s, "False")) return false;
            seen |= 2;
        } else if (n == 5 && !memcmp(key, "shape", n)) {
            if (!take_shape(&s, &h->rank, h->dim)) return false;
            seen |= 4;
        } else
            return false;
        if (!take(&s, ',')) {
            if (!take(&s, '}')) return false;
            break;
        }
    }
    return seen == 7;
}

value *npy_build(builder *b, const unsigned char *data, size_t bytes) {
    if (bytes < 10 || memcmp(data, "\x93NUMPY", 6)) return build_fail(b, SHERF_BAD_FILE, "not an npy file");
    size_t start = data[6] == 1 ? 10 : 12, length = data[8] | (size_t)data[9] << 8;
    if (data[6] < 1 || data[6] > 3)
        return build_fail(b, SHERF_BAD_FILE, "npy version %d, which is not known", data[6]);
    if (bytes < start) return build_fail(b, SHERF_BAD_FILE, "npy: truncated header");
    if (start == 12) length |= (size_t)data[10] << 16 | (size_t)data[11] << 24;
    if (length > bytes - start) return build_fail(b, SHERF_BAD_FILE, "npy: truncated header");
    npy_header h = {0};
    const char *text = (const char *)data + start;
    if (!header_parse((scanner){text, text + length}, &h))
        return build_fail(b, SHERF_BAD_FILE, "npy: header not understood: %.*s",
                          (int)(length < 100 ? length : 100), text);
    const unsigned char *payload = data + start + length;
    bytes -= start + length;
    if (h.type.kind == 'O') return pickle_finish(b, pickle_build(b, payload, bytes, NULL, NULL));
    int64_t n = build_count(h.rank, h.dim), total;
    if (n < 0 || __builtin_mul_overflow(n, h.type.size, &total) || (uint64_t)total > bytes)
        return build_fail(b, SHERF_BAD_FILE, "npy: truncated, or its shape is wrong (%zu bytes of data)",
                          bytes);
    return numpy_array(b, h.type, h.rank, h.dim, h.fortran, payload, (size_t)total);
}

sherf_status npy_parse(context *c, const unsigned char *data, size_t bytes, document **out) {
    builder b;
    *out = NULL;
    if (!build_start(&b, c, build_limit(bytes))) return b.status;
    return build_finish(&b, npy_build(&b, data, bytes), out);
}

sherf_status npy_read(context *c, const char *path, document **out) {
    unsigned char *data;
    size_t bytes;
    *out = NULL;
    sherf_status status = file_read(c, path, npy_bytes_max, &data, &bytes);
    if (status != SHERF_OK) return status;
    status = npy_parse(c, data, bytes, out);
    mem_free(data);
    return status == SHERF_OK ? status : failure_prefix(c, status, "%s", path);
}

/* ---------------------------------------------------------------- writing ---------------------------- */
size_t npy_header_text(const char *descr, int rank, const int64_t *dim, char out[256]) {
    char shape[160] = "";
    size_t n = 0;
    for (int i = 0; i < rank; i++)
        n += (size_t)snprintf(shape + n, sizeof shape - n, i ? ", %lld" : "%lld", (long long)dim[i]);
    if (rank == 1) snprintf(shape + n, sizeof shape - n, ",");
    memset(out, ' ', 256);
    int text =
        snprintf(out + 10, 246, "{'descr': '%s', 'fortran_order': False, 'shape': (%s), }", descr, shape);
    size_t total = ((size_t)text + 11 + 63) / 64 * 64; /* the data is 64-byte aligned */
    memcpy(out, "\x93NUMPY\x01\x00", 8);
    out[8] = (char)((total - 10) & 255);
    out[9] = (char)((total - 10) >> 8);
    out[10 + text] = ' ';
    out[total - 1] = '\n';
    return total;
}

sherf_status npy_write_f32(context *c, const char *path, int rank, const int64_t *dim, const float *data) {
    char header[256];
    int64_t n = rank >= 0 && rank <= 5 ? build_count(rank, dim) : -1;
    if (n < 0) return failure(c, SHERF_BAD_ARGUMENT, "%s: an array of this shape cannot be written", path);
    size_t length = npy_header_text("<f4", rank, dim, header);
    output_file file;
    sherf_status status = output_open(c, path, &file);
    if (status == SHERF_OK) status = output_write(c, &file, header, length);
    if (status == SHERF_OK) status = output_write(c, &file, data, (size_t)n * sizeof *data);
    if (status == SHERF_OK) status = output_commit(c, &file);
    output_abort(&file);
    return status;
}
