/* study: a web page of blind pairs of pictures, its key, and the raters' answers. */
#ifndef SHERF_STUDY_H
#define SHERF_STUDY_H

#include "experiment/interval.h"
#include "io/image.h"

/* ---- the page's parts (made by the build of web/): study.html, study.css, study.js ---- */
typedef struct {
    const char *name, *type;
    const unsigned char *data;
    size_t bytes;
} study_file;
extern const study_file study_files[];
extern const int study_file_count;

/* ---- trials ---- */
enum { STUDY_NEAR, STUDY_FAR, STUDY_POSE, STUDY_STRATA };
enum { STUDY_METHODS = 8, STUDY_TRIALS_MAX = 4096, STUDY_NAME = 64 };
extern const char *const study_stratum[STUDY_STRATA]; /* "near", ... */
/* Two pictures, by the methods that made them. A catch trial pairs a method's picture with its blurred copy.
 */
typedef struct {
    int person, stratum, method[2]; /* a and b */
    int picture[3];                 /* on the page: input, a, b; not in the key */
    bool is_catch;
    int blurred; /* of a catch trial: 0 or 1 */
} study_trial;
typedef struct {
    char id[20]; /* of the page's content */
    int people, methods, trials;
    char (*person)[STUDY_NAME];
    char method[STUDY_METHODS][STUDY_NAME]; /* labels; the first is the subject, which is in every pair */
    study_trial *trial;
} study;
void study_free(study *s);

/* One PNG. */
typedef struct {
    uint8_t *png;
    size_t bytes;
} study_picture;
/* What a rater gets: this many of the pairs, all catch trials, and some pairs a second time. */
enum { STUDY_DRAWN = 50, STUDY_CATCHES = 5, STUDY_REPEATS = 5 };
/* Writes FOLDER/study.html, which needs no other file, and FOLDER/key.json, which raters must not see. `key`
 * shuffles trials and pictures, so that their numbers reveal nothing; sets s->id. */
sherf_status study_write(context *c, study *s, int pictures, const study_picture *picture, uint64_t key,
                         const char *folder);
sherf_status study_read_key(context *c, const char *path, study *out);
/* A copy that is clearly less sharp. */
sherf_status study_blur(context *c, const image_u8 *from, image_u8 *out);

/* ---- answers ---- */
typedef struct {
    int rater, trial, ms;
    int chosen; /* 0: a, 1: b */
    bool left_a, repeat;
} study_vote;
typedef struct {
    int raters, votes, capacity;
    char (*rater)[STUDY_NAME + 1];
    study_vote *vote;
} study_answers;
void study_answers_free(study_answers *a);
/* Adds a file of answers to the others. Refuses in one line anything that the page does not write. */
sherf_status study_read_answers(context *c, const study *s, const char *path, study_answers *a);

/* ---- numbers (study_numbers.c) ---- */
/* Wilson's 95 % interval of k of n; NaN for n = 0. */
interval wilson(int64_t k, int64_t n);
/* The exact two-sided test against one half. */
double binomial_p(int64_t k, int64_t n);
/* Strengths with P(i preferred to k) = strength[i] / (strength[i] + strength[k]) and sum 1, from wins[i * n +
 * k]; half a win is added to both sides of each pair that met. */
void bradley_terry(int n, const double *wins, double *strength);
/* Over items of two categories, count[2 i] and count[2 i + 1]; items with fewer than two answers are left
 * out. NaN if nothing can be compared. */
double fleiss_kappa(int64_t items, const int *count);

#endif
