/* Which pictures an evaluation compares: by lists, at random, or by the protocol. */
#include <stdlib.h>
#include <string.h>

#include "data/dataset.h"
#include "eval/selection.h"

/* A number at *text, which moves behind it; -1 when there is none or it is too large. */
static int number(const char **text) {
    const char *p = *text;
    int64_t n = 0;
    if (*p < '0' || *p > '9') return -1;
    for (; *p >= '0' && *p <= '9'; p++)
        if ((n = n * 10 + (*p - '0')) > INT32_MAX) return -1;
    *text = p;
    return (int)n;
}

/* One item of a list: N, or first:step:count. */
static bool list_item(const char **text, int *first, int *step, int *count) {
    *step = *count = 1;
    if ((*first = number(text)) < 0) return false;
    if (**text != ':') return true;
    (*text)++;
    if ((*step = number(text)) < 1 || **text != ':') return false;
    (*text)++;
    return (*count = number(text)) >= 1;
}

sherf_status selection_list(context *c, const char *text, const char *what, int limit, int **out,
                            int *count) {
    sherf_status status = SHERF_OK;
    int n = 0;
    *out = NULL;
    *count = 0;
    int *list = mem_alloc(c, (size_t)limit + 1, sizeof *list);
    bool *seen = mem_zero(c, (size_t)limit + 1, sizeof *seen);
    if (!list || !seen) {
        status = SHERF_NO_MEMORY;
        goto done;
    }
    for (const char *p = text;;) {
        int first, step, items;
        if (!list_item(&p, &first, &step, &items) || (*p && *p != ',')) {
            status = failure(c, SHERF_BAD_ARGUMENT,
                             "%s \"%s\": numbers with commas between, or "
                             "first:step:count, are expected",
                             what, text);
            goto done;
        }
        for (int64_t i = 0; i < items; i++) {
            int64_t v = first + i * step;
            if (v >= limit) {
                status = failure(c, SHERF_BAD_ARGUMENT, "%s \"%s\": there is no number %lld, the last is %d",
                                 what, text, (long long)v, limit - 1);
                goto done;
            }
            if (seen[v]) {
                status =
                    failure(c, SHERF_BAD_ARGUMENT, "%s \"%s\": %lld comes twice", what, text, (long long)v);
                goto done;
            }
            seen[v] = true;
            list[n++] = (int)v;
        }
        if (!*p) break;
        p++;
    }
    *out = list;
    *count = n;
    list = NULL;
done:
    mem_free(list);
    mem_free(seen);
    return status;
}

sherf_status selection_pictures(context *c, const char *text, int poses, int views, picture **out,
                                int *count) {
    size_t n = 1;
    *out = NULL;
    *count = 0;
    for (const char *p = text; *p; p++) n += *p == ',';
    picture *list = mem_alloc(c, n, sizeof *list);
    if (!list) return SHERF_NO_MEMORY;
    const char *p = text;
    for (size_t i = 0; i < n; i++) {
        bool ok = (list[i].pose = number(&p)) >= 0 && *p == ':';
        if (ok) p++;
        ok = ok && (list[i].view = number(&p)) >= 0 && *p == (i + 1 < n ? ',' : 0);
        if (!ok) {
            mem_free(list);
            return failure(c, SHERF_BAD_ARGUMENT, "observation \"%s\": POSE:VIEW is expected", text);
        }
        if (list[i].pose >= poses || list[i].view >= views) {
            mem_free(list);
            return failure(c, SHERF_BAD_ARGUMENT,
                           "observation \"%s\": the person has poses 0 to %d and views 0 to %d", text,
                           poses - 1, views - 1);
        }
        for (size_t k = 0; k < i; k++)
            if (list[k].pose == list[i].pose && list[k].view == list[i].view) {
                mem_free(list);
                return failure(c, SHERF_BAD_ARGUMENT, "observation \"%s\": one comes twice", text);
            }
        p++;
    }
    *out = list;
    *count = (int)n;
    return SHERF_OK;
}

void selection_free(selection *s) {
    mem_free(s->observation);
    mem_free(s->novel_pose);
    mem_free(s->pose);
    mem_free(s->view);
    *s = (selection){0};
}

picture selection_picture(const selection *s, int i, int k) {
    const picture first = s->observation[i];
    return k ? (picture){first.pose, (first.view + k * s->all_views / s->pictures) % s->all_views} : first;
}

static bool contains(const int *list, int n, int v) {
    for (int i = 0; i < n; i++)
        if (list[i] == v) return true;
    return false;
}

bool selection_target(const selection *s, int i, picture target, bool *novel_pose) {
    picture o = s->observation[i];
    *novel_pose = target.pose != o.pose;
    if (*novel_pose && (s->one_pose || target.pose < s->novel_pose_first)) return false;
    if (!*novel_pose && s->view_poses && !contains(s->pose, s->view_poses, target.pose)) return false;
    for (int k = 0; k < s->pictures && !*novel_pose; k++)
        if (target.view == selection_picture(s, i, k).view) return false;
    return *novel_pose ? s->novel_pose[i] : target.view != o.view;
}

int64_t selection_pairs(const selection *s) {
    int64_t n = 0;
    bool novel_pose;
    for (int i = 0; i < s->observations; i++)
        for (int p = 0; p < s->poses; p++)
            for (int v = 0; v < s->views; v++)
                n += selection_target(s, i, (picture){s->pose[p], s->view[v]}, &novel_pose);
    return n;
}

/* first, first + step, ... below limit; *missing: how many of them are not. */
static sherf_status sequence(context *c, int first, int step, int count, int limit, int **out, int *n,
                             int *missing) {
    *n = 0;
    if (!(*out = mem_alloc(c, (size_t)count + 1, sizeof **out))) return SHERF_NO_MEMORY;
    for (int i = 0; i < count; i++)
        if (first + i * step < limit)
            (*out)[(*n)++] = first + i * step;
        else
            (*missing)++;
    return SHERF_OK;
}

/* Behind the poses of novel view those that only novel poses have: RenderPeople's list of targets begins at
 * the observed pose, the others' where novel view's begins. */
static sherf_status protocol_novel_poses(context *c, const data_protocol *p, int has_poses, selection *s,
                                         int *missing) {
    const int from = p->observation_pose < has_poses ? p->observation_pose : 0;
    int *all = mem_alloc(c, (size_t)s->poses + (size_t)p->pose_count, sizeof *all);
    if (!all) return SHERF_NO_MEMORY;
    memcpy(all, s->pose, (size_t)s->poses * sizeof *all);
    mem_free(s->pose);
    s->pose = all;
    s->view_poses = s->poses;
    s->novel_pose_first = from + p->pose_step;
    for (int i = 1; i < p->pose_count; i++) {
        const int pose = from + i * p->pose_step;
        if (contains(s->pose, s->view_poses, pose)) continue;
        if (pose < has_poses)
            s->pose[s->poses++] = pose;
        else if (pose >= p->pose_first + p->pose_count * p->pose_step)
            ++*missing;
    }
    return SHERF_OK;
}

/* Every listed pose from every observation view of the protocol, and the pose that novel poses are made from.
 */
static sherf_status protocol_observations(context *c, const data_protocol *p, int poses, int views,
                                          selection *s, int *missing) {
    const int viewed = s->view_poses ? s->view_poses : s->poses;
    size_t limit = ((size_t)viewed + 1) * COUNT_OF(p->observation_views);
    s->observation = mem_alloc(c, limit, sizeof *s->observation);
    s->novel_pose = mem_zero(c, limit, sizeof *s->novel_pose);
    if (!s->observation || !s->novel_pose) return SHERF_NO_MEMORY;
    int from = p->observation_pose < poses ? p->observation_pose : 0;
    bool extra = !contains(s->pose, viewed, from);
    for (size_t k = 0; k < COUNT_OF(p->observation_views); k++) {
        if (p->observation_views[k] >= views) {
            (*missing)++;
            continue;
        }
        for (int i = 0; i < viewed + extra; i++) {
            int pose = i < viewed ? s->pose[i] : from;
            s->novel_pose[s->observations] = pose == from;
            s->observation[s->observations++] = (picture){pose, p->observation_views[k]};
        }
    }
    return SHERF_OK;
}

bool selection_is_random(const char *observations) {
    return observations && !strcmp(observations, "random");
}

/* What the caller names, or one by chance. */
static sherf_status named_observations(context *c, const sherf_dataset *d, const char *observations,
                                       uint64_t seed, selection *s) {
    int views = sherf_dataset_view_count(d, s->person);
    sherf_status status = SHERF_OK;
    if (!selection_is_random(observations)) {
        status = selection_pictures(c, observations, sherf_dataset_pose_count(d, s->person), views,
                                    &s->observation, &s->observations);
    } else if (s->poses && views) {
        uint64_t key = random_key(seed, "eval.observation", fnv1a64(sherf_dataset_person(d, s->person)));
        if (!(s->observation = mem_alloc(c, 1, sizeof *s->observation))) return SHERF_NO_MEMORY;
        s->observation[s->observations++] =
            (picture){s->pose[random_below(key, 0, s->poses)], (int)random_below(key, 1, views)};
    }
    if (status == SHERF_OK && !(s->novel_pose = mem_alloc(c, (size_t)s->observations, sizeof *s->novel_pose)))
        status = SHERF_NO_MEMORY;
    for (int i = 0; i < s->observations && status == SHERF_OK; i++) s->novel_pose[i] = true;
    return status;
}

sherf_status selection_create(context *c, const sherf_dataset *d, int person, const char *observations,
                              const char *poses, const char *views, uint64_t seed, selection *out) {
    const data_protocol *p = dataset_protocol(d);
    int has_poses = sherf_dataset_pose_count(d, person), has_views = sherf_dataset_view_count(d, person);
    int missing = 0;
    const person_record *record;
    *out = (selection){.person = person, .all_views = has_views};
    sherf_status status = dataset_record(c, d, person, &record); /* reports why, if it has no poses */
    if (status != SHERF_OK) return status;
    status = poses ? selection_list(c, poses, "poses", has_poses, &out->pose, &out->poses)
                   : sequence(c, p->pose_first, p->pose_step, p->pose_count, has_poses, &out->pose,
                              &out->poses, &missing);
    if (status != SHERF_OK) goto fail;
    int step = p->view_step > 0 ? p->view_step : 1;
    status = views ? selection_list(c, views, "views", has_views, &out->view, &out->views)
                   : sequence(c, 0, step, (p->views + step - 1) / step, has_views, &out->view, &out->views,
                              &missing);
    if (status != SHERF_OK) goto fail;
    if (!poses && !observations) status = protocol_novel_poses(c, p, has_poses, out, &missing);
    if (status != SHERF_OK) goto fail;
    status = observations ? named_observations(c, d, observations, seed, out)
                          : protocol_observations(c, p, has_poses, has_views, out, &missing);
    if (status != SHERF_OK) goto fail;
    if (missing)
        log_line(c, SHERF_LOG_WARNING,
                 "%s: %d poses and views of the paper's protocol are not there and are left out",
                 sherf_dataset_person(d, person), missing);
    return SHERF_OK;
fail:
    selection_free(out);
    return status;
}
