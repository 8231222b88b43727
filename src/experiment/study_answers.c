/* Raters' files. Strangers send them: anything that the page would not have written is refused. */
#include <stdio.h>
#include <string.h>

#include "experiment/study.h"
#include "base/path.h"
#include "io/value.h"

enum { FILE_BYTES_MAX = 1 << 20, RATERS_MAX = 10000, MS_MAX = 100000000 };

void study_answers_free(study_answers *a) {
    mem_free(a->rater);
    mem_free(a->vote);
    *a = (study_answers){0};
}

static sherf_status grow(context *c, study_answers *a, size_t votes) {
    if (a->raters >= RATERS_MAX) return failure(c, SHERF_BAD_ARGUMENT, "more than %d raters", RATERS_MAX);
    void *raters = mem_grow(c, a->rater, (size_t)a->raters, (size_t)a->raters + 1, sizeof *a->rater);
    if (raters) a->rater = raters;
    void *more = mem_grow(c, a->vote, (size_t)a->votes, (size_t)a->votes + votes + 1, sizeof *a->vote);
    if (more) a->vote = more;
    return raters && more ? SHERF_OK : SHERF_NO_MEMORY;
}

static bool truth(const value *o, const char *key, bool *out) {
    const value *v = value_get(o, key);
    if (!v || v->kind != VALUE_BOOL) return false;
    *out = v->boolean;
    return true;
}

/* The index of the matching word of two, or -1. */
static int word(const value *o, const char *key, const char *first, const char *second) {
    const value *v = value_get(o, key);
    if (!v) return -1;
    return value_is_string(v, first) ? 0 : value_is_string(v, second) ? 1 : -1;
}

static bool whole(const value *o, const char *key, int64_t limit, int *out) {
    const value *v = value_get(o, key);
    if (!v || v->kind != VALUE_INTEGER || v->integer < 0 || v->integer >= limit) return false;
    *out = (int)v->integer;
    return true;
}

static bool read_vote(const value *o, const study *s, int rater, study_vote *out) {
    *out = (study_vote){.rater = rater};
    if (!o || o->kind != VALUE_DICT) return false;
    const int left = word(o, "left", "a", "b"), side = word(o, "chose", "left", "right");
    out->left_a = !left;
    out->chosen = left ^ side;
    return left >= 0 && side >= 0 && whole(o, "trial", s->trials, &out->trial) &&
           whole(o, "ms", MS_MAX, &out->ms) && truth(o, "repeat", &out->repeat);
}

/* A pair is answered once, and at most once more as a repeat; catch trials are not repeated. */
static const char *vote_out_of_place(const study *s, const study_answers *a, const study_vote *v) {
    bool before = false;
    for (int i = a->votes - 1; i >= 0 && a->vote[i].rater == v->rater; i--) {
        if (a->vote[i].trial != v->trial) continue;
        if (a->vote[i].repeat == v->repeat) return "comes twice";
        before = true;
    }
    if (before != v->repeat) return v->repeat ? "is repeated and was not there before" : "comes twice";
    return v->repeat && s->trial[v->trial].is_catch ? "is never repeated" : NULL;
}

static sherf_status read_rater(context *c, const value *root, study_answers *a) {
    const value *name = value_get(root, "rater");
    const char *text = name && name->kind == VALUE_STRING ? name->string.text : "";
    const size_t n = strlen(text);
    if (!n || n > STUDY_NAME || n != name->string.length ||
        strspn(text, "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ-") != n)
        return failure(c, SHERF_BAD_FILE, "no rater, or not one that the page makes");
    for (int i = 0; i < a->raters; i++)
        if (!strcmp(a->rater[i], text))
            return failure(c, SHERF_BAD_ARGUMENT, "rater %s has another file among these: give one", text);
    snprintf(a->rater[a->raters], sizeof *a->rater, "%s", text);
    return SHERF_OK;
}

static sherf_status read_votes(context *c, const value *list, const study *s, study_answers *a) {
    for (size_t i = 0; i < value_count(list); i++) {
        study_vote v;
        if (!read_vote(value_at(list, i), s, a->raters, &v))
            return failure(c, SHERF_BAD_FILE, "answer %zu is not one of this study", i + 1);
        const char *wrong = vote_out_of_place(s, a, &v);
        if (wrong) return failure(c, SHERF_BAD_FILE, "answer %zu: trial %d %s", i + 1, v.trial, wrong);
        a->vote[a->votes++] = v;
    }
    a->raters++;
    return SHERF_OK;
}

static sherf_status read_root(context *c, const value *root, const study *s, study_answers *a) {
    const value *format = root ? value_get(root, "format") : NULL,
                *id = format ? value_get(root, "study") : NULL,
                *list = format ? value_get(root, "trials") : NULL;
    bool consent;
    if (!format || !value_is_string(format, "sherf-preference-answers") || !id || id->kind != VALUE_STRING ||
        !list || list->kind != VALUE_LIST)
        return failure(c, SHERF_BAD_FILE, "not the answers of a study");
    if (!value_is_string(id, s->id))
        return failure(c, SHERF_MISMATCH, "the answers are to another study: %.20s, not %s", id->string.text,
                       s->id);
    if (!truth(root, "consent", &consent) || !consent)
        return failure(c, SHERF_BAD_FILE, "the rater has not consented");
    if (value_count(list) > 2 * (size_t)s->trials)
        return failure(c, SHERF_BAD_FILE, "%zu answers to %d trials", value_count(list), s->trials);
    sherf_status status = grow(c, a, value_count(list));
    if (status == SHERF_OK) status = read_rater(c, root, a);
    return status == SHERF_OK ? read_votes(c, list, s, a) : status;
}

sherf_status study_read_answers(context *c, const study *s, const char *path, study_answers *a) {
    unsigned char *text = NULL;
    size_t bytes;
    document *d = NULL;
    const int votes = a->votes;
    sherf_status status = file_read(c, path, FILE_BYTES_MAX, &text, &bytes);
    if (status != SHERF_OK) return status;
    status = json_parse(c, (const char *)text, bytes, &d);
    if (status == SHERF_OK) status = read_root(c, d->root, s, a);
    document_free(d);
    mem_free(text);
    if (status == SHERF_OK) return status;
    a->votes = votes;
    return failure_prefix(c, status, "%s", path);
}
