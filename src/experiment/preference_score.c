/* Scores files of answers: shares of preference with their intervals, and agreement between raters. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "experiment/experiment.h"
#include "experiment/study.h"

enum { MISSES_MAX = 1, RESAMPLES = 2000 }; /* raters with more misses of catch trials are left out */

typedef struct {
    context *c;
    study s;
    study_answers a;
    bool *kept; /* raters */
    int left_out;
} votes;

static void votes_free(votes *v) {
    mem_free(v->kept);
    study_answers_free(&v->a);
    study_free(&v->s);
}

/* ---- who counts ---- */
static sherf_status raters_check(votes *v) {
    int *missed = mem_zero(v->c, (size_t)v->a.raters + 1, sizeof *missed);
    v->kept = mem_zero(v->c, (size_t)v->a.raters + 1, sizeof *v->kept);
    const bool room = missed && v->kept;
    for (int i = 0; i < v->a.votes && room; i++) {
        const study_vote *k = &v->a.vote[i];
        const study_trial *t = &v->s.trial[k->trial];
        if (t->is_catch && k->chosen == t->blurred) missed[k->rater]++;
    }
    for (int i = 0; i < v->a.raters && room; i++) {
        v->kept[i] = missed[i] <= MISSES_MAX;
        v->left_out += !v->kept[i];
    }
    mem_free(missed);
    if (!room) return SHERF_NO_MEMORY;
    if (v->left_out < v->a.raters) return SHERF_OK;
    return failure(v->c, SHERF_BAD_ARGUMENT, "no rater is left: all missed two catch trials or more");
}

/* The method that is compared with the subject in a counted vote, or 0. */
static int other_of(const votes *v, const study_vote *k) {
    const study_trial *t = &v->s.trial[k->trial];
    return t->is_catch || k->repeat || !v->kept[k->rater] ? 0 : t->method[0] + t->method[1];
}

static bool subject_won(const votes *v, const study_vote *k) {
    return v->s.trial[k->trial].method[k->chosen] == 0;
}

/* ---- shares ---- */
/* stratum -1: all strata. */
static void count_wins(const votes *v, int other, int stratum, int64_t *won, int64_t *all) {
    *won = *all = 0;
    for (int i = 0; i < v->a.votes; i++) {
        const study_vote *k = &v->a.vote[i];
        if (other_of(v, k) != other || (stratum >= 0 && v->s.trial[k->trial].stratum != stratum)) continue;
        *won += subject_won(v, k);
        ++*all;
    }
}

static void resample(uint64_t key, int round, int n, double *weight) {
    memset(weight, 0, (size_t)n * sizeof *weight);
    for (int i = 0; i < n; i++) weight[random_below(key, (uint64_t)round * (uint64_t)n + (uint64_t)i, n)]++;
}

/* Votes of one rater are correlated, and so are votes on one person: both are resampled. */
static sherf_status share_bootstrap(const votes *v, int other, interval *out) {
    const int raters = v->a.raters, people = v->s.people;
    const uint64_t key[2] = {random_key(1, "study.raters", 0), random_key(1, "study.people", 0)};
    double *weight = mem_alloc(v->c, (size_t)raters + (size_t)people + 1, sizeof *weight);
    double *share = mem_alloc(v->c, RESAMPLES, sizeof *share);
    int known = 0;
    const bool room = weight && share;
    for (int round = 0; round < RESAMPLES && room; round++) {
        double won = 0, all = 0;
        resample(key[0], round, raters, weight);
        resample(key[1], round, people, weight + raters);
        for (int i = 0; i < v->a.votes; i++) {
            const study_vote *k = &v->a.vote[i];
            if (other_of(v, k) != other) continue;
            const double w = weight[k->rater] * weight[raters + v->s.trial[k->trial].person];
            all += w;
            won += subject_won(v, k) ? w : 0;
        }
        if (all > 0) share[known++] = won / all;
    }
    if (known > 1) {
        numbers_sort(known, share);
        out->low = share[(int)(0.025 * (known - 1))];
        out->high = share[(int)ceil(0.975 * (known - 1))];
    }
    mem_free(weight);
    mem_free(share);
    return room ? SHERF_OK : SHERF_NO_MEMORY;
}

static interval percent(interval v) {
    return (interval){100 * v.mean, 100 * v.low, 100 * v.high};
}

static sherf_status share_row(const votes *v, int other, page_table *t) {
    page_row *row = page_add_row(v->c, t, "%s against %s", v->s.method[0], v->s.method[other]);
    int64_t won, all;
    if (!row) return SHERF_NO_MEMORY;
    count_wins(v, other, -1, &won, &all);
    row->value[0] = percent(wilson(won, all));
    interval hung = interval_of(row->value[0].mean / 100);
    sherf_status status = share_bootstrap(v, other, &hung);
    row->value[1] = percent(hung);
    row->value[2] = interval_of((double)all);
    row->value[3] = interval_of(binomial_p(won, all));
    for (int k = 0; k < STUDY_STRATA; k++) {
        count_wins(v, other, k, &won, &all);
        row->value[4 + k] = percent(wilson(won, all));
    }
    return status;
}

static sherf_status shares_table(const votes *v, page *p) {
    static const struct {
        const char *group, *name;
        int decimals;
    } column[] = {{"all", "preferred %", 1},
                  {"all", "over raters and people %", 1},
                  {"all", "votes", 0},
                  {"all", "p", 4},
                  {"by what is shown", "near view %", 1},
                  {"by what is shown", "far view %", 1},
                  {"by what is shown", "novel pose %", 1}};
    page_table *t = page_add_table(v->c, p, "How often %s is preferred", v->s.method[0]);
    sherf_status status = t ? SHERF_OK : SHERF_NO_MEMORY;
    for (size_t k = 0; k < COUNT_OF(column) && status == SHERF_OK; k++)
        status = page_add_column(v->c, t, column[k].group, column[k].name, column[k].decimals, 0);
    for (int i = 1; i < v->s.methods && status == SHERF_OK; i++) status = share_row(v, i, t);
    return status;
}

static sherf_status strengths_table(const votes *v, page *p) {
    double wins[STUDY_METHODS * STUDY_METHODS] = {0}, strength[STUDY_METHODS];
    const int n = v->s.methods;
    for (int i = 0; i < v->a.votes; i++) {
        const study_vote *k = &v->a.vote[i];
        const int other = other_of(v, k);
        if (other) wins[subject_won(v, k) ? other : other * n]++;
    }
    bradley_terry(n, wins, strength);
    page_table *t = page_add_table(v->c, p, "Strengths (Bradley-Terry)");
    sherf_status status = t ? page_add_column(v->c, t, "", "strength", 3, 1) : SHERF_NO_MEMORY;
    for (int i = 0; i < n && status == SHERF_OK; i++) {
        page_row *row = page_add_row(v->c, t, "%s", v->s.method[i]);
        if (row) row->value[0] = interval_of(strength[i]);
        status = row ? SHERF_OK : SHERF_NO_MEMORY;
    }
    return status;
}

/* ---- agreement ---- */
static sherf_status kappa_of(const votes *v, double *kappa) {
    int *count = mem_zero(v->c, 2 * (size_t)v->s.trials + 1, sizeof *count);
    if (!count) return SHERF_NO_MEMORY;
    for (int i = 0; i < v->a.votes; i++)
        if (other_of(v, &v->a.vote[i])) count[2 * v->a.vote[i].trial + subject_won(v, &v->a.vote[i])]++;
    *kappa = fleiss_kappa(v->s.trials, count);
    mem_free(count);
    return SHERF_OK;
}

/* Counts repeats with the same answer as before. */
static void repeats_count(const votes *v, int64_t *same, int64_t *all) {
    *same = *all = 0;
    for (int i = 0; i < v->a.votes; i++) {
        const study_vote *k = &v->a.vote[i];
        if (!k->repeat || !v->kept[k->rater]) continue;
        for (int b = i - 1; b >= 0 && v->a.vote[b].rater == k->rater; b--)
            if (v->a.vote[b].trial == k->trial) *same += v->a.vote[b].chosen == k->chosen;
        ++*all;
    }
}

static sherf_status agreement_table(const votes *v, page *p) {
    static const char *const name[] = {"raters", "left out", "same answer again %", "Fleiss' kappa"};
    static const int decimals[] = {0, 0, 1, 3};
    page_table *t = page_add_table(v->c, p, "Raters");
    sherf_status status = t ? SHERF_OK : SHERF_NO_MEMORY;
    double kappa;
    int64_t same, all;
    for (size_t k = 0; k < COUNT_OF(name) && status == SHERF_OK; k++)
        status = page_add_column(v->c, t, "", name[k], decimals[k], 0);
    if (status == SHERF_OK) status = kappa_of(v, &kappa);
    page_row *row = status == SHERF_OK ? page_add_row(v->c, t, "all") : NULL;
    if (!row) return status == SHERF_OK ? SHERF_NO_MEMORY : status;
    repeats_count(v, &same, &all);
    row->value[0] = interval_of(v->a.raters - v->left_out);
    row->value[1] = interval_of(v->left_out);
    row->value[2] = percent(wilson(same, all));
    row->value[3] = interval_of(kappa);
    return SHERF_OK;
}

static sherf_status notes_add(const votes *v, page *p) {
    return page_add_note(
        v->c, p,
        "Each vote is one of two pictures, of the same person, pose and camera. In brackets: Wilson's 95 %% "
        "intervals of the votes; \"over raters and people\": percentiles of a bootstrap that draws both "
        "anew, which is the wider and the better one, since votes of one rater hang together. p: exact, "
        "two-sided, against one half. Raters who missed two catch trials or more are left out, by a rule "
        "that stood before. Strengths: each pair has half a vote added on either side; their sum is 1. "
        "votes.csv has every vote.");
}

/* ---- all ---- */
static sherf_status votes_write(const votes *v, const char *folder) {
    text_builder t = {.c = v->c};
    text_add(&t, "rater,kept,person,shown,first,second,first_on_the_left,chosen,repeat,ms\n");
    for (int i = 0; i < v->a.votes; i++) {
        const study_vote *k = &v->a.vote[i];
        const study_trial *q = &v->s.trial[k->trial];
        const char *name[2] = {q->is_catch && q->blurred == 0 ? "blurred" : v->s.method[q->method[0]],
                               q->is_catch && q->blurred == 1 ? "blurred" : v->s.method[q->method[1]]};
        text_add(&t, "%s,%d,%s,%s,%s,%s,%d,%s,%d,%d\n", v->a.rater[k->rater], v->kept[k->rater],
                 v->s.person[q->person], study_stratum[q->stratum], name[0], name[1], k->left_a,
                 name[k->chosen], k->repeat, k->ms);
    }
    char *text = text_take(&t);
    const sherf_status status = page_file_write(v->c, folder, "votes.csv", text);
    mem_free(text);
    return status;
}

static sherf_status tables_write(const votes *v, const char *folder) {
    page *p = mem_zero(v->c, 1, sizeof *p);
    if (!p) return SHERF_NO_MEMORY;
    snprintf(p->name, sizeof p->name, "preference");
    snprintf(p->title, sizeof p->title, "Preference: the raters' answers");
    sherf_status status = shares_table(v, p);
    if (status == SHERF_OK) status = strengths_table(v, p);
    if (status == SHERF_OK) status = agreement_table(v, p);
    if (status == SHERF_OK) status = notes_add(v, p);
    if (status == SHERF_OK) status = folder_make(v->c, folder);
    if (status == SHERF_OK) status = votes_write(v, folder);
    if (status == SHERF_OK) status = page_write(v->c, p, folder);
    page_free(p);
    mem_free(p);
    return status;
}

sherf_status preference_score(experiment_job *j, text_builder *text) {
    votes v = {.c = j->c};
    char path[PATH_LENGTH];
    unsigned char *table = NULL;
    size_t bytes;
    sherf_status status = job_path(j, path, "preference/key.json");
    if (status == SHERF_OK) status = study_read_key(j->c, path, &v.s);
    for (int i = 0; i < j->options->answer_count && status == SHERF_OK; i++)
        status = study_read_answers(j->c, &v.s, j->options->answers[i], &v.a);
    if (status == SHERF_OK) status = raters_check(&v);
    if (status == SHERF_OK) status = job_path(j, path, "preference/answers");
    if (status == SHERF_OK) status = tables_write(&v, path);
    if (status == SHERF_OK) status = job_path(j, path, "preference/answers/table.md");
    if (status == SHERF_OK) status = file_read(j->c, path, (size_t)1 << 24, &table, &bytes);
    if (status == SHERF_OK) text_add(text, "%s", (const char *)table);
    mem_free(table);
    votes_free(&v);
    return status;
}
