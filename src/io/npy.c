/* npy: the file of one array.
 * https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/path.h"
#include "io/build.h"

static const size_t npy_bytes_max = (size_t)8 << 30;

typedef struct {
    const char *p, *end;
} scanner;

static void blanks(scanner *s) {
    while (s->p < s->end && strchr(" \t\r\n", *s->p) && *s->p) s->p++;
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

/* "(3, 4)", "(5,)", "()"; Python 2's L is allowed. */
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
    if (h.type.kind == 'O') return pickle_whole(b, payload, bytes);
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
