/* The results of every step, in log.jsonl. */
#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/path.h"
#include "io/value.h"
#include "train/history.h"

static sherf_status remember(context *c, history *h, history_point p) {
    if (h->count == h->capacity) {
        int64_t capacity = h->capacity ? 2 * h->capacity : 1024;
        history_point *grown = mem_grow(c, h->point, (size_t)h->count, (size_t)capacity, sizeof *grown);
        if (!grown) return SHERF_NO_MEMORY;
        h->point = grown;
        h->capacity = capacity;
    }
    h->point[h->count++] = p;
    return SHERF_OK;
}

static double number(const document *d, const char *key) {
    const value *v = value_get(d->root, key);
    if (v && v->kind == VALUE_REAL) return v->real;
    return v && v->kind == VALUE_INTEGER ? (double)v->integer : NAN;
}

/* A line that is not ours, or cut off, is dropped. *keep: it belongs to a step up to `step`. */
static sherf_status read_line(context *c, history *h, const char *text, size_t bytes, int64_t step,
                              bool *keep) {
    document *d = NULL;
    *keep = false;
    sherf_status status = json_parse(c, text, bytes, &d);
    if (status == SHERF_NO_MEMORY) return status;
    if (status != SHERF_OK) return SHERF_OK;
    double n = number(d, "step");
    if (n >= 1 && n <= (double)step) {
        history_point p = {(int64_t)n,
                           {number(d, "loss"), number(d, "color"), number(d, "mask"), number(d, "ssim"),
                            number(d, "lpips"), number(d, "resnet50")}};
        *keep = true;
        status = remember(c, h, p);
    } else {
        status = SHERF_OK;
    }
    document_free(d);
    return status;
}

/* Rewrites the log without the lines behind `step`. */
static sherf_status take_over(context *c, const char *path, int64_t step, history *h) {
    unsigned char *data = NULL;
    size_t bytes;
    output_file out = {0};
    if (!path_is_file(path)) return SHERF_OK;
    sherf_status status = file_read(c, path, (size_t)1 << 30, &data, &bytes);
    if (status == SHERF_OK) status = output_open(c, path, &out);
    for (size_t at = 0; at < bytes && status == SHERF_OK;) {
        const unsigned char *end = memchr(data + at, '\n', bytes - at);
        size_t length = end ? (size_t)(end - (data + at)) : bytes - at;
        bool keep = false;
        if (end) status = read_line(c, h, (const char *)data + at, length, step, &keep);
        if (status == SHERF_OK && keep) status = output_write(c, &out, data + at, length + 1);
        at += length + 1;
    }
    if (status == SHERF_OK) status = output_commit(c, &out);
    output_abort(&out);
    mem_free(data);
    return status;
}

sherf_status history_open(context *c, const char *path, int64_t step, history *out) {
    *out = (history){0};
    sherf_status status = step ? take_over(c, path, step, out) : SHERF_OK;
    if (status == SHERF_OK && !(out->file = fopen(path, step ? "a" : "w")))
        status = failure(c, SHERF_WRITE_FAILED, "%s: cannot be written: %s", path, strerror(errno));
    if (status != SHERF_OK) history_close(out);
    return status;
}

void history_close(history *h) {
    if (h->file) fclose(h->file);
    mem_free(h->point);
    *h = (history){0};
}

static void put(FILE *f, const char *key, double v) {
    if (isfinite(v))
        fprintf(f, ", \"%s\": %.7g", key, v);
    else
        fprintf(f, ", \"%s\": null", key);
}

sherf_status history_add(context *c, history *h, history_point p, const history_extra *extra) {
    fprintf(h->file, "{\"step\": %" PRId64, p.step);
    put(h->file, "loss", p.loss.total);
    put(h->file, "color", p.loss.color);
    put(h->file, "mask", p.loss.mask);
    put(h->file, "ssim", p.loss.ssim);
    put(h->file, "lpips", p.loss.lpips);
    put(h->file, "resnet50", p.loss.resnet50);
    put(h->file, "rate", extra->rate);
    put(h->file, "seconds", extra->seconds);
    put(h->file, "waited", extra->waited_seconds);
    put(h->file, "eta", extra->eta_seconds);
    fprintf(h->file, "%s}\n", extra->skipped ? ", \"skipped\": true" : "");
    if (fflush(h->file) != 0)
        return failure(c, SHERF_WRITE_FAILED, "log.jsonl: cannot be written: %s", strerror(errno));
    return remember(c, h, p);
}
