/* Writes a study's page and key, and reads the key. */
#include "experiment/study.h"

#include <stdio.h>
#include <string.h>

#include "base/path.h"
#include "data/parse.h"
#include "data/text.h"
#include "io/value.h"
#include "train/draw.h"

const char *const study_stratum[STUDY_STRATA] = {"near", "far", "pose"};
static const char *const key_format = "sherf-preference-key";

void study_free(study *s) {
    mem_free(s->person);
    mem_free(s->trial);
    *s = (study){0};
}

/* ---- a blurred copy ---- */
/* One pass of a box filter along values `stride` apart; the window stays inside. */
static void blur_line(const uint8_t *from, uint8_t *to, int n, size_t stride, int radius) {
    for (int i = 0; i < n; i++) {
        int sum = 0, count = 0;
        for (int k = i - radius; k <= i + radius; k++)
            if (k >= 0 && k < n) sum += from[(size_t)k * stride], count++;
        to[(size_t)i * stride] = (uint8_t)((sum + count / 2) / count);
    }
}

sherf_status study_blur(context *c, const image_u8 *from, image_u8 *out) {
    enum { PASSES = 2, SHARE = 32 };
    const size_t row = 3 * (size_t)from->width, bytes = row * (size_t)from->height;
    const int radius = from->width / SHARE > 2 ? from->width / SHARE : 2;
    uint8_t *work = mem_alloc(c, bytes, 1);
    *out = (image_u8){from->width, from->height, 3, mem_alloc(c, bytes, 1)};
    if (!work || !out->data) {
        mem_free(work);
        mem_free(out->data);
        out->data = NULL;
        return SHERF_NO_MEMORY;
    }
    memcpy(out->data, from->data, bytes);
    for (int pass = 0; pass < PASSES; pass++) {
        for (int y = 0; y < from->height; y++)
            for (size_t k = 0; k < 3; k++)
                blur_line(out->data + (size_t)y * row + k, work + (size_t)y * row + k, from->width, 3,
                          radius);
        for (size_t x = 0; x < row; x++) blur_line(work + x, out->data + x, from->height, row, radius);
    }
    mem_free(work);
    return SHERF_OK;
}

/* ---- the page ---- */
static void add_base64(text_builder *t, const uint8_t *data, size_t bytes) {
    static const char digit[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    char four[4 * 256 + 1];
    size_t n = 0;
    for (size_t i = 0; i < bytes; i += 3) {
        const unsigned a = data[i], b = i + 1 < bytes ? data[i + 1] : 0, d = i + 2 < bytes ? data[i + 2] : 0,
                       all = a << 16 | b << 8 | d;
        four[n++] = digit[all >> 18];
        four[n++] = digit[all >> 12 & 63];
        four[n++] = i + 1 < bytes ? digit[all >> 6 & 63] : '=';
        four[n++] = i + 2 < bytes ? digit[all & 63] : '=';
        if (n + 4 < sizeof four && i + 3 < bytes) continue;
        four[n] = 0;
        text_add(t, "%s", four);
        n = 0;
    }
}

/* The page's data without its id: catch trials appear only as "always". */
static void add_content(text_builder *t, const study *s, int pictures, const study_picture *picture,
                        const int *at) {
    text_add(t, "\"draw\": %d, \"repeats\": %d, \"always\": [", STUDY_DRAWN, STUDY_REPEATS);
    for (int i = 0, n = 0; i < s->trials; i++)
        if (s->trial[i].is_catch) text_add(t, "%s%d", n++ ? ", " : "", i);
    text_add(t, "],\n\"trials\": [");
    for (int i = 0; i < s->trials; i++) {
        const int *p = s->trial[i].picture;
        text_add(t, "%s[%d, %d, %d]", i ? ", " : "", at[p[0]], at[p[1]], at[p[2]]);
    }
    text_add(t, "],\n\"pictures\": [");
    for (int k = 0; k < pictures; k++)
        for (int i = 0; i < pictures; i++) {
            if (at[i] != k) continue;
            text_add(t, "%s\n\"data:image/png;base64,", k ? "," : "");
            add_base64(t, picture[i].png, picture[i].bytes);
            text_add(t, "\"");
        }
    text_add(t, "]}\n");
}

static const study_file *file_named(const char *name) {
    for (int i = 0; i < study_file_count; i++)
        if (!strcmp(study_files[i].name, name)) return &study_files[i];
    return &study_files[0];
}

/* The page's text with the parts inserted where it names them. */
static char *page_text(context *c, const char *json) {
    const study_file *html = file_named("study.html"), *css = file_named("study.css"),
                     *js = file_named("study.js");
    const char *at = (const char *)html->data, *end = at + html->bytes;
    text_builder t = {.c = c};
    while (at < end) {
        const char *mark = memchr(at, '@', (size_t)(end - at));
        text_add(&t, "%.*s", (int)((mark ? mark : end) - at), at);
        if (!mark) break;
        if (!strncmp(mark, "@STYLE@", 7)) {
            text_add(&t, "%.*s", (int)css->bytes, (const char *)css->data);
            at = mark + 7;
        } else if (!strncmp(mark, "@SCRIPT@", 8)) {
            text_add(&t, "%.*s", (int)js->bytes, (const char *)js->data);
            at = mark + 8;
        } else if (!strncmp(mark, "@STUDY@", 7)) {
            text_add(&t, "%s", json);
            at = mark + 7;
        } else {
            text_add(&t, "@");
            at = mark + 1;
        }
    }
    return text_take(&t);
}

/* ---- the key ---- */
static char *key_text(context *c, const study *s) {
    text_builder t = {.c = c};
    text_add(&t, "{\"format\": \"%s\", \"version\": 1, \"study\": \"%s\",\n\"methods\": [", key_format,
             s->id);
    for (int i = 0; i < s->methods; i++) {
        text_add(&t, "%s", i ? ", " : "");
        text_add_json(&t, s->method[i]);
    }
    text_add(&t, "],\n\"people\": [");
    for (int i = 0; i < s->people; i++) {
        text_add(&t, "%s", i ? ", " : "");
        text_add_json(&t, s->person[i]);
    }
    text_add(&t, "],\n\"trials\": [");
    for (int i = 0; i < s->trials; i++) {
        const study_trial *k = &s->trial[i];
        text_add(&t, "%s\n{\"person\": %d, \"stratum\": \"%s\", \"a\": %d, \"b\": %d, \"blurred\": %s}",
                 i ? "," : "", k->person, study_stratum[k->stratum], k->method[0], k->method[1],
                 !k->is_catch ? "null"
                 : k->blurred ? "\"b\""
                              : "\"a\"");
    }
    text_add(&t, "]}\n");
    return text_take(&t);
}

/* Shuffles, so that numbers reveal nothing. */
static sherf_status trials_shuffle(context *c, study *s, uint64_t key) {
    study_trial *old = mem_alloc(c, (size_t)s->trials + 1, sizeof *old);
    if (!old) return SHERF_NO_MEMORY;
    memcpy(old, s->trial, (size_t)s->trials * sizeof *old);
    for (int i = 0; i < s->trials; i++)
        s->trial[permuted(random_key(key, "study.trials", 0), i, s->trials)] = old[i];
    mem_free(old);
    return SHERF_OK;
}

static sherf_status file_put(context *c, const char *folder, const char *name, const char *text) {
    char path[PATH_LENGTH];
    if (!text) return failure(c, SHERF_NO_MEMORY, "out of memory: %s", name);
    const sherf_status status = path_join(c, path, sizeof path, folder, name);
    return status == SHERF_OK ? file_write(c, path, text, strlen(text)) : status;
}

sherf_status study_write(context *c, study *s, int pictures, const study_picture *picture, uint64_t key,
                         const char *folder) {
    text_builder content = {.c = c}, json = {.c = c};
    int *at = mem_alloc(c, (size_t)pictures + 1, sizeof *at);
    sherf_status status = at ? trials_shuffle(c, s, key) : SHERF_NO_MEMORY;
    if (status != SHERF_OK) goto done;
    for (int i = 0; i < pictures; i++)
        at[i] = (int)permuted(random_key(key, "study.pictures", 0), i, pictures);
    add_content(&content, s, pictures, picture, at);
    char *text = text_take(&content);
    if (text) {
        snprintf(s->id, sizeof s->id, "%016llx", (unsigned long long)fnv1a64(text));
        text_add(&json, "{\"id\": \"%s\", %s", s->id, text);
    }
    char *whole = text ? text_take(&json) : NULL, *page = whole ? page_text(c, whole) : NULL,
         *secret = page ? key_text(c, s) : NULL;
    status = file_put(c, folder, "key.json", secret);
    if (status == SHERF_OK) status = file_put(c, folder, "study.html", page);
    mem_free(secret);
    mem_free(page);
    mem_free(whole);
    mem_free(text);
done:
    mem_free(at);
    return status;
}

/* ---- the key read ---- */
static bool small_number(const value *o, const char *key, int limit, int *out) {
    const value *v = o ? value_get(o, key) : NULL;
    if (!v || v->kind != VALUE_INTEGER || v->integer < 0 || v->integer >= limit) return false;
    *out = (int)v->integer;
    return true;
}

static bool read_trial(const value *o, const study *s, study_trial *out) {
    const value *stratum = o ? value_get(o, "stratum") : NULL, *blurred = o ? value_get(o, "blurred") : NULL;
    int i = 0;
    *out = (study_trial){0};
    while (i < STUDY_STRATA && stratum && !value_is_string(stratum, study_stratum[i])) i++;
    out->stratum = i;
    out->is_catch = blurred && blurred->kind == VALUE_STRING;
    out->blurred = out->is_catch && value_is_string(blurred, "b");
    return stratum && i < STUDY_STRATA && small_number(o, "person", s->people, &out->person) &&
           small_number(o, "a", s->methods, &out->method[0]) &&
           small_number(o, "b", s->methods, &out->method[1]);
}

static bool read_name(const value *v, char out[STUDY_NAME]) {
    if (!v || v->kind != VALUE_STRING) return false;
    snprintf(out, STUDY_NAME, "%s", v->string.text);
    return true;
}

static sherf_status read_lists(context *c, const value *root, study *s) {
    const value *people = value_get(root, "people"), *methods = value_get(root, "methods"),
                *trials = value_get(root, "trials"), *id = value_get(root, "study");
    const size_t n[3] = {people ? value_count(people) : 0, methods ? value_count(methods) : 0,
                         trials ? value_count(trials) : 0};
    if (!id || id->kind != VALUE_STRING || strlen(id->string.text) >= sizeof s->id || n[0] < 1 ||
        n[0] > STUDY_TRIALS_MAX || n[1] < 2 || n[1] > STUDY_METHODS || n[2] < 1 || n[2] > STUDY_TRIALS_MAX)
        return failure(c, SHERF_BAD_FILE, "not the key of a study");
    snprintf(s->id, sizeof s->id, "%s", id->string.text);
    s->person = mem_zero(c, n[0], sizeof *s->person);
    s->trial = mem_zero(c, n[2], sizeof *s->trial);
    if (!s->person || !s->trial) return SHERF_NO_MEMORY;
    bool good = true;
    for (; s->people < (int)n[0]; s->people++)
        good &= read_name(value_at(people, (size_t)s->people), s->person[s->people]);
    for (; s->methods < (int)n[1]; s->methods++)
        good &= read_name(value_at(methods, (size_t)s->methods), s->method[s->methods]);
    for (; s->trials < (int)n[2]; s->trials++)
        good &= read_trial(value_at(trials, (size_t)s->trials), s, &s->trial[s->trials]);
    return good ? SHERF_OK : failure(c, SHERF_BAD_FILE, "not the key of a study");
}

sherf_status study_read_key(context *c, const char *path, study *out) {
    document *d = NULL;
    *out = (study){0};
    sherf_status status = json_read(c, path, &d);
    if (status != SHERF_OK) return status;
    const value *format = value_get(d->root, "format");
    if (format && value_is_string(format, key_format))
        status = read_lists(c, d->root, out);
    else
        status = failure(c, SHERF_BAD_FILE, "not the key of a study");
    document_free(d);
    if (status == SHERF_OK) return status;
    study_free(out);
    return failure_prefix(c, status, "%s", path);
}
