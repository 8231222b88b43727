/* COLMAP's text model: cameras.txt (lenses) and images.txt (two lines an image: its place, its points). */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/path.h"
#include "data/camera_files.h"

enum { LINE_MAX_BYTES = 1024, NUMBERS_MAX = 16, LENSES_MAX = 1 << 20 };
static const size_t text_bytes_max = (size_t)1 << 30;

/* Models by the places of their parameters: fx fy cx cy, then OpenCV's k1 k2 p1 p2 k3 k4 k5 k6; -1: 0. */
static const struct {
    const char *name;
    int count;
    int8_t K[4], D[8];
} models[] = {
    {"SIMPLE_PINHOLE", 3, {0, 0, 1, 2}, {-1, -1, -1, -1, -1, -1, -1, -1}},
    {"PINHOLE", 4, {0, 1, 2, 3}, {-1, -1, -1, -1, -1, -1, -1, -1}},
    {"SIMPLE_RADIAL", 4, {0, 0, 1, 2}, {3, -1, -1, -1, -1, -1, -1, -1}},
    {"RADIAL", 5, {0, 0, 1, 2}, {3, 4, -1, -1, -1, -1, -1, -1}},
    {"OPENCV", 8, {0, 1, 2, 3}, {4, 5, 6, 7, -1, -1, -1, -1}},
    {"FULL_OPENCV", 12, {0, 1, 2, 3}, {4, 5, 6, 7, 8, 9, 10, 11}},
};

typedef struct {
    int64_t id, width, height;
    double K[9], D[8];
} lens;

typedef struct {
    context *c;
    const char *path, *at, *end;
    int line;
    char text[LINE_MAX_BYTES]; /* the line read last, cut off */
} lines;

static sherf_status bad_line(const lines *l, const char *why) {
    return failure(l->c, SHERF_BAD_FILE, "%s, line %d: %s", l->path, l->line, why);
}

static bool next_line(lines *l) {
    if (l->at == l->end) return false;
    const char *end = memchr(l->at, '\n', (size_t)(l->end - l->at));
    size_t n = (size_t)((end ? end : l->end) - l->at);
    if (n && l->at[n - 1] == '\r') n--;
    if (n >= sizeof l->text) n = sizeof l->text - 1;
    memcpy(l->text, l->at, n);
    l->text[n] = 0;
    l->at = end ? end + 1 : l->end;
    l->line++;
    return true;
}

/* The next line that is neither empty nor a comment. */
static bool next_entry(lines *l) {
    while (next_line(l))
        if (l->text[strspn(l->text, " \t")] && *l->text != '#') return true;
    return false;
}

/* Numbers at *text, which is moved behind them; at most `max`. */
static int numbers_at(char **text, double *out, int max) {
    int n = 0;
    for (char *end; n < max; n++, *text = end) {
        out[n] = strtod(*text, &end);
        if (end == *text || (*end && *end != ' ' && *end != '\t')) break;
    }
    return n;
}

/* CAMERA_ID MODEL WIDTH HEIGHT PARAMS. COLMAP counts pixels from their corners, OpenCV from their centres. */
static sherf_status lens_of(lines *l, lens *out) {
    char model[32], *text = l->text;
    double number[NUMBERS_MAX], head[3];
    int used = 0;
    if (numbers_at(&text, head, 1) != 1 || sscanf(text, " %31s%n", model, &used) != 1)
        return bad_line(l, "not CAMERA_ID MODEL WIDTH HEIGHT PARAMS");
    text += used;
    const int sides = numbers_at(&text, head + 1, 2), count = numbers_at(&text, number, NUMBERS_MAX);
    size_t m = 0;
    while (m < COUNT_OF(models) && strcmp(model, models[m].name)) m++;
    if (m == COUNT_OF(models))
        return failure(l->c, SHERF_UNSUPPORTED,
                       "%s, line %d: COLMAP's model %s is not read: undistort by colmap image_undistorter",
                       l->path, l->line, model);
    if (sides != 2 || count != models[m].count || !(head[0] >= 0 && head[0] < 1e15) ||
        !(head[1] >= 1 && head[1] < 1e6) || !(head[2] >= 1 && head[2] < 1e6))
        return bad_line(l, "numbers are missing, too many, or no sizes");
    *out = (lens){(int64_t)head[0], (int64_t)head[1], (int64_t)head[2], {[8] = 1}, {0}};
    for (int i = 0; i < 4; i++)
        out->K[(const int[]){0, 4, 2, 5}[i]] = number[models[m].K[i]] - (i > 1 ? 0.5 : 0);
    for (int i = 0; i < 8; i++) out->D[i] = models[m].D[i] < 0 ? 0 : number[models[m].D[i]];
    return SHERF_OK;
}

static int by_id(const void *a, const void *b) {
    const lens *x = a, *y = b;
    return (x->id > y->id) - (x->id < y->id);
}

static sherf_status lenses_read(context *c, const char *path, lens **out, size_t *count) {
    unsigned char *data;
    size_t bytes, room = 0;
    sherf_status status = file_read(c, path, text_bytes_max, &data, &bytes);
    if (status) return status;
    lines l = {c, path, (const char *)data, (const char *)data + bytes, 0, ""};
    while (!status && next_entry(&l)) {
        if (*count == LENSES_MAX) status = bad_line(&l, "too many cameras");
        if (!status && *count == room) {
            lens *grown = mem_grow(c, *out, room, room ? 2 * room : 16, sizeof *grown);
            if (grown) *out = grown, room = room ? 2 * room : 16;
            if (!grown) status = SHERF_NO_MEMORY;
        }
        if (!status) status = lens_of(&l, &(*out)[*count]);
        *count += !status;
    }
    mem_free(data);
    if (!status && !*count) status = failure(c, SHERF_BAD_FILE, "%s: no cameras", path);
    if (!status) qsort(*out, *count, sizeof **out, by_id);
    return status;
}

static value *array_of(builder *b, int count, const double *number) {
    const int64_t dim[1] = {count};
    value *v = build_array(b, T_F64, 1, dim);
    if (v) memcpy(v->array.data, number, (size_t)count * sizeof *number);
    return v;
}

static value *camera_of(builder *b, const lens *own, const double place[7], const char *name) {
    value *camera = build_value(b, VALUE_DICT);
    if (!camera || !build_entry(b, camera, "name", build_string(b, name, strlen(name))) ||
        !build_entry(b, camera, "K", array_of(b, 9, own->K)) ||
        !build_entry(b, camera, "D", array_of(b, 8, own->D)) ||
        !build_entry(b, camera, "width", build_integer(b, own->width)) ||
        !build_entry(b, camera, "height", build_integer(b, own->height)) ||
        !build_entry(b, camera, "qvec", array_of(b, 4, place)) ||
        !build_entry(b, camera, "tvec", array_of(b, 3, place + 4)))
        return NULL;
    return camera;
}

/* IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME. */
static sherf_status image_of(lines *l, builder *b, const lens *lenses, size_t count, value *list) {
    double number[9];
    char *name = l->text;
    if (numbers_at(&name, number, 9) != 9 || !name[strspn(name, " \t")])
        return bad_line(l, "not IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME");
    name += strspn(name, " \t");
    const lens wanted = {.id = number[8] >= 0 && number[8] < 1e15 ? (int64_t)number[8] : -1};
    const lens *own = bsearch(&wanted, lenses, count, sizeof *lenses, by_id);
    if (!own) return bad_line(l, "its camera is not in cameras.txt");
    if (!build_append(b, list, camera_of(b, own, number + 1, name))) return b->status;
    next_line(l); /* the points, perhaps none */
    return SHERF_OK;
}

static sherf_status images_read(builder *b, const char *path, const lens *lenses, size_t count, value *list) {
    unsigned char *data;
    size_t bytes;
    sherf_status status = file_read(b->c, path, text_bytes_max, &data, &bytes);
    if (status) return status;
    lines l = {b->c, path, (const char *)data, (const char *)data + bytes, 0, ""};
    while (!status && next_entry(&l)) status = image_of(&l, b, lenses, count, list);
    mem_free(data);
    return !status && !list->list.count ? failure(b->c, SHERF_BAD_FILE, "%s: no images", path) : status;
}

sherf_status colmap_read(context *c, const char *cameras, const char *images, document **out) {
    builder b;
    lens *lenses = NULL;
    size_t count = 0;
    *out = NULL;
    sherf_status status = lenses_read(c, cameras, &lenses, &count);
    if (!status && !build_start(&b, c, (size_t)2 << 30)) status = b.status;
    if (status) {
        mem_free(lenses);
        return status;
    }
    value *list = build_value(&b, VALUE_LIST), *root = build_value(&b, VALUE_DICT);
    if (list && root) status = images_read(&b, images, lenses, count, list);
    mem_free(lenses);
    if (status && !b.status) b.status = status;
    if (!b.status && !build_entry(&b, root, "cameras", list)) root = NULL;
    status = build_finish(&b, b.status ? NULL : root, out);
    if (!status)
        log_line(c, SHERF_LOG_INFO, "%s: COLMAP's unit of length is its own: the body must be in it", images);
    return status;
}
