/* Draws a sample's person, pose and views. */
#include "data/dataset.h"
#include "train/draw.h"

/* People are usually shown before black, so random backgrounds are black with this probability. */
enum { BLACK_ONE_IN = 4 };

void sampling_free(sampling *s) {
    mem_free(s->person);
    mem_free(s->poses);
    mem_free(s->views);
    mem_free(s->before);
    *s = (sampling){0};
}

static int clipped(int limit, int n) {
    return limit > 0 && limit < n ? limit : n;
}

sherf_status sampling_create(context *c, const sherf_dataset *d, const char *people, bool front_view,
                             int targets, uint64_t seed, sampling *out) {
    const data_protocol *p = dataset_protocol(d);
    *out = (sampling){.seed = seed, .targets = targets};
    sherf_status status = dataset_people(c, d, people, true, &out->person, &out->people);
    if (status != SHERF_OK) goto fail;
    out->poses = mem_alloc(c, (size_t)out->people, sizeof *out->poses);
    out->views = mem_alloc(c, (size_t)out->people, sizeof *out->views);
    out->before = mem_zero(c, (size_t)out->people + 1, sizeof *out->before);
    if (!out->poses || !out->views || !out->before) {
        status = SHERF_NO_MEMORY;
        goto fail;
    }
    out->pose_step = p->train_pose_step > 0 ? p->train_pose_step : 1;
    for (int i = 0; i < out->people; i++) {
        const person_record *record;
        if ((status = dataset_record(c, d, out->person[i], &record)) != SHERF_OK) goto fail;
        int has_poses = sherf_dataset_pose_count(d, out->person[i]);
        int has_views = sherf_dataset_view_count(d, out->person[i]);
        out->poses[i] = clipped(p->train_poses, (has_poses + out->pose_step - 1) / out->pose_step);
        out->views[i] = clipped(p->views, has_views);
        out->before[i + 1] = out->before[i] + (int64_t)out->poses[i] * out->views[i];
    }
    if (front_view) out->front = p;
    if (sampling_pictures(out) > 0) return SHERF_OK;
    status = failure(c, SHERF_BAD_ARGUMENT, "there is no picture to train on");
fail:
    sampling_free(out);
    return status;
}

int64_t sampling_pictures(const sampling *s) {
    return s->before[s->people];
}

/* A Feistel network over the smallest even number of bits that holds n, walked until it lands below n. */
int64_t permuted(uint64_t key, int64_t i, int64_t n) {
    int half = 1;
    while (half < 31 && ((int64_t)1 << (2 * half)) < n) half++;
    const uint64_t mask = ((uint64_t)1 << half) - 1;
    uint64_t x = (uint64_t)i;
    do {
        uint64_t left = x >> half, right = x & mask;
        for (uint64_t round = 0; round < 4; round++) {
            uint64_t next = left ^ (splitmix64(key ^ splitmix64(right + (round << 40))) & mask);
            left = right;
            right = next;
        }
        x = left << half | right;
    } while (x >= (uint64_t)n);
    return (int64_t)x;
}

/* Further pictures of the observation: other views than its own, one each, in a pose of their own. */
static void draw_also(const sampling *s, int i, int64_t number, draw *d) {
    const uint64_t key = random_key(s->seed, "train.pictures", (uint64_t)number);
    const int64_t views = s->views[i];
    const int max = s->pictures < views ? s->pictures : (int)views;
    if (max < 2 || d->estimated || random_below(key, 0, 2)) return;
    d->also = 1 + (int)random_below(key, 1, max - 1);
    for (int k = 0, at = 0; k < d->also; at++) {
        const int view = (int)permuted(splitmix64(key), at, views);
        if (view == d->observed_view) continue;
        d->also_of[k].view = view;
        d->also_of[k].pose = (int)random_below(key, 2 + (uint64_t)k, s->poses[i]) * s->pose_step;
        if (s->one_pose) d->also_of[k].pose = d->pose;
        k++;
    }
}

draw sampling_draw(const sampling *s, int64_t number) {
    const int64_t n = sampling_pictures(s);
    int64_t at = permuted(random_key(s->seed, "train.epoch", (uint64_t)(number / n)), number % n, n);
    int i = 0;
    while (at >= s->before[i + 1]) i++;
    at -= s->before[i];
    uint64_t key = random_key(s->seed, "train.image", (uint64_t)number);
    draw d = {.person = s->person[i],
              .pose = (int)(at / s->views[i]) * s->pose_step,
              .view = (int)(at % s->views[i]),
              .observed_view = s->front ? protocol_front(s->front, s->views[i]) : 0,
              .noise_key = splitmix64(key + 1) | 1};
    if (!s->front) d.observed_view = (int)random_below(key, 0, s->views[i]);
    d.estimated = random_uniform(random_key(s->seed, "train.estimated", (uint64_t)number), 0) < s->estimated;
    draw_also(s, i, number, &d);
    d.further = s->targets - 1;
    for (int k = 0; k < d.further; k++) {
        d.more[k].pose = (int)random_below(key, 2 + 2 * (uint64_t)k, s->poses[i]) * s->pose_step;
        if (s->one_pose) d.more[k].pose = d.pose;
        d.more[k].view = (int)random_below(key, 3 + 2 * (uint64_t)k, s->views[i]);
    }
    const uint64_t ground = random_key(s->seed, "train.background", (uint64_t)number);
    for (int k = 0; k <= d.further; k++)
        if (s->random_background && random_below(ground, 2 * (uint64_t)k, BLACK_ONE_IN))
            d.background[k] = (float)random_uniform(ground, 2 * (uint64_t)k + 1);
    return d;
}
