/* The YAML that OpenCV's FileStorage writes: names with matrices, lists, numbers or texts. No nested maps. */
#include <ctype.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "io/build.h"

enum { WORD_MAX = 256 };

typedef struct {
    builder *b;
    const char *at, *end; /* at: the beginning of a line, outside of a value in brackets */
    int line;             /* of `at`, from 1 */
} reader;

/* One line without its end and the spaces around it. */
typedef struct {
    const char *text;
    size_t length;
    int indent;
} row;

static void *refuse(reader *r, const char *why) {
    return build_fail(r->b, SHERF_BAD_FILE, "YAML, line %d: %s", r->line, why);
}

static void trim(const char **text, size_t *length) {
    while (*length && isspace((unsigned char)**text)) ++*text, --*length;
    while (*length && isspace((unsigned char)(*text)[*length - 1])) --*length;
}

static void skip_line(reader *r) {
    const char *end = memchr(r->at, '\n', (size_t)(r->end - r->at));
    r->at = end ? end + 1 : r->end;
    r->line++;
}

/* "%YAML", "---", "...". */
static bool is_mark(const row *line) {
    if (line->indent) return false;
    return *line->text == '%' || (line->length >= 3 && !memcmp(line->text, "---", 3)) ||
           (line->length == 3 && !memcmp(line->text, "...", 3));
}

/* The next line with something in it, without going past it; false: there is none. */
static bool peek(reader *r, row *out) {
    for (; r->at < r->end; skip_line(r)) {
        const char *end = memchr(r->at, '\n', (size_t)(r->end - r->at));
        *out = (row){r->at, (size_t)((end ? end : r->end) - r->at), 0};
        while ((size_t)out->indent < out->length && out->text[out->indent] == ' ') out->indent++;
        trim(&out->text, &out->length);
        if (out->length && *out->text != '#' && !is_mark(out)) return true;
    }
    return false;
}

/* "key: rest". */
static bool split(const row *line, row *key, row *rest) {
    const char *colon = memchr(line->text, ':', line->length);
    if (!colon) return false;
    *key = (row){line->text, (size_t)(colon - line->text), line->indent};
    *rest = (row){colon + 1, line->length - key->length - 1, 0};
    trim(&key->text, &key->length);
    trim(&rest->text, &rest->length);
    if (key->length > 1 && *key->text == '"' && key->text[key->length - 1] == '"')
        key->text++, key->length -= 2;
    return key->length > 0;
}

static bool is(const row *line, const char *text) {
    return line->length == strlen(text) && !memcmp(line->text, text, line->length);
}

/* A number, or a text with or without quotes. */
static value *scalar(reader *r, const char *text, size_t length) {
    char word[WORD_MAX], *end;
    if (length >= sizeof word) return refuse(r, "a word of more than 255 bytes");
    if (length > 1 && *text == '"' && text[length - 1] == '"')
        return build_string(r->b, text + 1, length - 2);
    memcpy(word, text, length);
    word[length] = 0;
    const double number = strtod(word, &end);
    const bool code = word[0] == '0' && isdigit((unsigned char)word[1]); /* 01: a name */
    if (end == word || *end || code) {
        if (!strcasecmp(word, ".nan") || !strcasecmp(word, ".inf") || !strcasecmp(word, "-.inf"))
            return refuse(r, "a number that is not finite");
        return build_string(r->b, text, length);
    }
    if (!isfinite(number)) return refuse(r, "a number that is not finite");
    return number == floor(number) && fabs(number) < 1e15 ? build_integer(r->b, (int64_t)number)
                                                          : build_real(r->b, number);
}

/* [a, b, ...], over as many lines as it takes; from the bracket at `from` to the line after its end. */
static value *flow(reader *r, const char *from) {
    value *list = build_value(r->b, VALUE_LIST);
    const char *p = from + 1, *begin = p;
    int lines = 0;
    for (; list && p < r->end; p++) {
        if (*p == '\n') lines++;
        if (*p == '[' || *p == '{') return refuse(r, "brackets within brackets");
        if (*p != ',' && *p != ']') continue;
        size_t length = (size_t)(p - begin);
        trim(&begin, &length);
        if (!length && *p == ']' && !list->list.count) break;
        if (!length) return refuse(r, "a comma too many");
        if (!build_append(r->b, list, scalar(r, begin, length))) return NULL;
        if (*p == ']') break;
        begin = p + 1;
    }
    if (list && p == r->end) return refuse(r, "a bracket is not closed");
    r->at = p + (list != NULL);
    r->line += lines;
    row rest;
    const char *end = memchr(r->at, '\n', (size_t)(r->end - r->at));
    rest = (row){r->at, (size_t)((end ? end : r->end) - r->at), 0};
    trim(&rest.text, &rest.length);
    if (list && rest.length && *rest.text != '#') return refuse(r, "something follows a bracket");
    skip_line(r);
    return list;
}

/* "- item" on each line. */
static value *items(reader *r) {
    value *list = build_value(r->b, VALUE_LIST);
    for (row line; list && peek(r, &line) && *line.text == '-'; skip_line(r)) {
        line.text++, line.length--;
        trim(&line.text, &line.length);
        if (!build_append(r->b, list, scalar(r, line.text, line.length))) return NULL;
    }
    return list;
}

static int64_t whole(const value *v) {
    return v && v->kind == VALUE_INTEGER ? v->integer : -1;
}

static value *matrix_of(reader *r, int64_t rows, int64_t columns, const value *data) {
    const int64_t dim[2] = {rows, columns};
    if (rows < 0 || columns < 0 || rows > 1 << 20 || columns > 1 << 20 || !data)
        return refuse(r, "a matrix without rows, cols or data before it");
    if ((int64_t)data->list.count != rows * columns)
        return refuse(r, "a matrix whose data are not rows x cols");
    value *v = build_array(r->b, T_F64, 2, dim);
    for (size_t i = 0; v && i < data->list.count; i++) {
        const value *item = data->list.item[i];
        if (item->kind != VALUE_REAL && item->kind != VALUE_INTEGER) return refuse(r, "a matrix of texts");
        ((double *)v->array.data)[i] = item->kind == VALUE_REAL ? item->real : (double)item->integer;
    }
    return v;
}

/* The lines below "!!opencv-matrix". */
static value *matrix(reader *r) {
    int64_t rows = -1, columns = -1;
    const value *data = NULL;
    for (row line, key, rest; peek(r, &line) && line.indent > 0;) {
        if (!split(&line, &key, &rest)) return refuse(r, "a matrix has rows, cols, dt and data");
        if (is(&key, "data")) {
            if (!rest.length || *rest.text != '[') return refuse(r, "data of a matrix are in brackets");
            if (!(data = flow(r, rest.text))) return NULL;
            continue;
        }
        const value *item = scalar(r, rest.text, rest.length);
        if (!item) return NULL;
        if (is(&key, "rows")) rows = whole(item);
        if (is(&key, "cols")) columns = whole(item);
        skip_line(r);
    }
    return matrix_of(r, rows, columns, data);
}

value *opencv_yaml_build(builder *b, const char *text, size_t bytes) {
    reader r = {b, text, text + bytes, 1};
    if (bytes >= 3 && !memcmp(text, "\xef\xbb\xbf", 3)) r.at += 3;
    value *dict = build_value(b, VALUE_DICT);
    for (row line, key, rest; dict && peek(&r, &line);) {
        value *item;
        if (line.indent || !split(&line, &key, &rest))
            return refuse(&r,
                          "neither a matrix, a list, a number nor a text (as OpenCV's FileStorage writes)");
        value *name = build_string(b, key.text, key.length);
        if (rest.length && *rest.text == '[') {
            item = flow(&r, rest.text);
        } else {
            skip_line(&r);
            item = is(&rest, "!!opencv-matrix") ? matrix(&r)
                   : rest.length                ? scalar(&r, rest.text, rest.length)
                                                : items(&r);
        }
        if (!build_pair(b, dict, name, item)) return NULL;
    }
    return dict;
}

bool opencv_yaml_is(const unsigned char *data, size_t bytes) {
    const size_t at = bytes >= 3 && !memcmp(data, "\xef\xbb\xbf", 3) ? 3 : 0;
    return bytes >= at + 5 && !memcmp(data + at, "%YAML", 5);
}

sherf_status opencv_yaml_parse(context *c, const unsigned char *data, size_t bytes, document **out) {
    builder b;
    *out = NULL;
    /* a value takes about 150 bytes, a number in the text as few as two */
    if (!build_start(&b, c, ((size_t)64 << 20) + (bytes < SIZE_MAX / 512 ? bytes * 128 : 0))) return b.status;
    return build_finish(&b, opencv_yaml_build(&b, (const char *)data, bytes), out);
}
