/* Threads that read the samples of coming steps. */
#include <pthread.h>
#include <string.h>

#include "train/loader.h"

void sample_free(sample *s) {
    sherf_observation_free(s->observation);
    sherf_observation_free(s->target);
    observation_geometry_free(s->observation_geometry);
    target_geometry_free(s->target_geometry);
    surface_draw_free(&s->surface);
    for (int k = 0; k < s->drawn.further; k++) {
        sherf_observation_free(s->more[k].target);
        target_geometry_free(s->more[k].geometry);
    }
    *s = (sample){0};
}

/* Adds to the message whose picture failed. */
static sherf_status named(context *c, sherf_status status, const sherf_dataset *d, int person, int pose,
                          int view) {
    if (status == SHERF_OK) return status;
    return failure_prefix(c, status, "%s, pose %d, view %d", sherf_dataset_person(d, person), pose, view);
}

/* w NULL: the target is where the data set has it. */
static sherf_status target_load(context *c, const sample_source *from, const carried *w, int person, int pose,
                                int view, const observation_geometry *observation, uint64_t key, int targets,
                                data_view **target, target_geometry **geometry) {
    sherf_status status = dataset_person_view(c, from->data, person, pose, view, from->width, target);
    if (status != SHERF_OK) return status;
    const data_view *t = *target;
    sherf_camera camera = t->camera;
    sherf_pose moved = t->pose;
    if (w) {
        carried_camera(w, &t->camera, &camera);
        status = carried_pose(c, w, from->body, &t->pose, false, &moved);
    }
    const training_recipe *r = model_recipe(from->config);
    const ray_draw rays = {.count = r ? (r->rays + targets - 1) / targets : 0,
                           .inside = r ? r->rays_inside : 0,
                           .mask = t->mask,
                           .jitter = r && r->jitter,
                           .key = random_key(key, "train.rays", 0)};
    if (status == SHERF_OK)
        status =
            target_geometry_draw(c, from->config, from->body, &camera, &moved, observation, &rays, geometry);
    if (status == SHERF_OK) status = body_in_picture(c, from->body, (*geometry)->body, &camera, t->mask);
    return named(c, status, from->data, person, pose, view);
}

/* The picture that is observed. *by_estimate: w says where its world lies. */
static sherf_status observation_load(context *c, const sample_source *from, draw drawn, data_view **out,
                                     carried *w, bool *by_estimate) {
    data_view *truth = NULL, *found = NULL;
    *by_estimate = false;
    sherf_status status = dataset_person_view(c, from->data, drawn.person, drawn.pose, drawn.observed_view,
                                              from->width, &truth);
    if (status == SHERF_OK && drawn.estimated && from->estimator)
        status = estimated_observation(c, from->estimator, from->data, drawn.person, drawn.pose,
                                       drawn.observed_view, truth, &found);
    if (status == SHERF_OK && found) {
        status = carried_create(c, from->body, truth, found, w);
        *by_estimate = true;
    }
    if (status == SHERF_OK && !found) {
        *out = truth;
        return SHERF_OK;
    }
    sherf_observation_free(truth);
    if (status != SHERF_OK) sherf_observation_free(found), found = NULL;
    *out = found;
    return status;
}

/* Makes the input of the encoders: the observation's picture o with the further ones beside it, which are not
 * needed afterwards. */
static sherf_status geometry_load(context *c, const sample_source *from, const draw *drawn,
                                  const data_view *o, observation_geometry **out) {
    data_view *also[OBSERVED_PICTURES_MAX - 1] = {NULL};
    observed_picture read[OBSERVED_PICTURES_MAX] = {{o->image, o->camera, o->pose}};
    sherf_status status = SHERF_OK;
    for (int k = 0; k < drawn->also && status == SHERF_OK; k++) {
        status = dataset_person_view(c, from->data, drawn->person, drawn->also_of[k].pose,
                                     drawn->also_of[k].view, from->width, &also[k]);
        if (status == SHERF_OK)
            read[k + 1] = (observed_picture){also[k]->image, also[k]->camera, also[k]->pose};
    }
    if (status == SHERF_OK)
        status = observation_geometry_of(c, from->config, from->body, 1 + drawn->also, read, true, out);
    for (int k = 0; k < drawn->also; k++) sherf_observation_free(also[k]);
    if (status != SHERF_OK) return status;
    if (!drawn->also) return body_in_picture(c, from->body, (*out)->body, &o->camera, o->mask);
    return SHERF_OK;
}

/* A sample of a model that is trained on surfaces: the observation and the surface. */
static sherf_status surface_load(context *c, const sample_source *from, draw drawn, sample *out) {
    const model_surface_training *k = from->config->kind->surfaces;
    sherf_status status = dataset_person_view(c, from->data, drawn.person, drawn.pose, drawn.observed_view,
                                              from->width, &out->observation);
    if (status != SHERF_OK) return status;
    status = geometry_load(c, from, &drawn, out->observation, &out->observation_geometry);
    named(c, status, from->data, drawn.person, drawn.pose, drawn.observed_view);
    if (status == SHERF_OK)
        status = surface_draw_create(c, from->data, drawn.person, drawn.pose, k->count(from->config),
                                     drawn.noise_key, &out->surface);
    return status;
}

sherf_status sample_load(context *c, const sample_source *from, draw drawn, sample *out) {
    const int targets = 1 + drawn.further;
    carried world;
    bool by_estimate;
    *out = (sample){.drawn = drawn};
    if (from->config->kind->surfaces) {
        const sherf_status read = surface_load(c, from, drawn, out);
        if (read != SHERF_OK) sample_free(out);
        return read;
    }
    sherf_status status = observation_load(c, from, drawn, &out->observation, &world, &by_estimate);
    if (status != SHERF_OK) goto fail;
    const data_view *o = out->observation;
    const carried *w = by_estimate ? &world : NULL;
    status = geometry_load(c, from, &drawn, o, &out->observation_geometry);
    named(c, status, from->data, drawn.person, drawn.pose, drawn.observed_view);
    if (status == SHERF_OK)
        status = target_load(c, from, w, drawn.person, drawn.pose, drawn.view, out->observation_geometry,
                             drawn.noise_key, targets, &out->target, &out->target_geometry);
    for (int k = 0; k < drawn.further && status == SHERF_OK; k++)
        status = target_load(c, from, w, drawn.person, drawn.more[k].pose, drawn.more[k].view,
                             out->observation_geometry, splitmix64(drawn.noise_key + 1 + (uint64_t)k),
                             targets, &out->more[k].target, &out->more[k].geometry);
    if (status == SHERF_OK) return SHERF_OK;
fail:
    sample_free(out);
    if (status != SHERF_MISMATCH || !by_estimate) return status;
    drawn.estimated = false; /* an estimate that cannot be used */
    return sample_load(c, from, drawn, out);
}

/* A slot holds sample number n of this loader, n % slots being its place. */
typedef struct {
    bool ready;
    sherf_status status;
    sample sample;
    char message[sizeof((context *)0)->message];
} slot;

struct loader {
    loader_options options;
    int slots, started;
    slot *slot;
    int64_t claimed, taken; /* samples given to workers, samples handed out */
    bool stop;
    double waited;
    pthread_mutex_t lock;
    pthread_cond_t ready, room;
    struct worker {
        loader *loader;
        context *c;
        pthread_t thread;
    } * worker;
};

static int64_t sample_number(const loader_options *o, int64_t n) {
    int64_t share = o->end - o->begin;
    return (o->first_step + n / share) * o->batch + o->begin + n % share;
}

static void *work(void *arg) {
    struct worker *w = arg;
    loader *l = w->loader;
    pthread_mutex_lock(&l->lock);
    for (;;) {
        while (!l->stop && l->claimed >= l->taken + l->slots) pthread_cond_wait(&l->room, &l->lock);
        if (l->stop) break;
        int64_t n = l->claimed++;
        slot *s = &l->slot[n % l->slots];
        pthread_mutex_unlock(&l->lock);
        draw drawn = sampling_draw(l->options.sampling, sample_number(&l->options, n));
        s->status = sample_load(w->c, &l->options.source, drawn, &s->sample);
        memcpy(s->message, w->c->message, sizeof s->message);
        pthread_mutex_lock(&l->lock);
        s->ready = true;
        pthread_cond_broadcast(&l->ready);
    }
    pthread_mutex_unlock(&l->lock);
    return NULL;
}

void loader_free(loader *l) {
    if (!l) return;
    pthread_mutex_lock(&l->lock);
    l->stop = true;
    pthread_cond_broadcast(&l->room);
    pthread_mutex_unlock(&l->lock);
    for (int i = 0; l->worker && i < l->options.workers; i++) {
        if (i < l->started) {
            sherf_cancel(l->worker[i].c);
            pthread_join(l->worker[i].thread, NULL);
        }
        if (l->worker[i].c) sherf_context_free(l->worker[i].c);
    }
    for (int i = 0; l->slot && i < l->slots; i++) sample_free(&l->slot[i].sample);
    pthread_cond_destroy(&l->ready);
    pthread_cond_destroy(&l->room);
    pthread_mutex_destroy(&l->lock);
    mem_free(l->worker);
    mem_free(l->slot);
    mem_free(l);
}

sherf_status loader_create(context *c, const loader_options *options, loader **out) {
    *out = NULL;
    loader *l = mem_zero(c, 1, sizeof *l);
    if (!l) return SHERF_NO_MEMORY;
    pthread_mutex_init(&l->lock, NULL);
    pthread_cond_init(&l->ready, NULL);
    pthread_cond_init(&l->room, NULL);
    l->options = *options;
    l->slots = options->workers + 1;
    l->slot = mem_zero(c, (size_t)l->slots, sizeof *l->slot);
    l->worker = mem_zero(c, (size_t)options->workers, sizeof *l->worker);
    sherf_status status = l->slot && l->worker ? SHERF_OK : SHERF_NO_MEMORY;
    const sherf_options quiet = {.threads = 1, .precision = c->precision, .device = SHERF_DEVICE_CPU};
    for (int i = 0; i < options->workers && status == SHERF_OK; i++) {
        l->worker[i].loader = l;
        status = sherf_context_create(&quiet, &l->worker[i].c);
        if (status != SHERF_OK) {
            failure(c, status, "out of memory: a loading thread");
        } else if (pthread_create(&l->worker[i].thread, NULL, work, &l->worker[i])) {
            status = failure(c, SHERF_NO_MEMORY, "a loading thread cannot be started");
        } else {
            l->started++;
        }
    }
    if (status != SHERF_OK) {
        loader_free(l);
        return status;
    }
    *out = l;
    return SHERF_OK;
}

sherf_status loader_next(context *c, loader *l, sample *out) {
    double start = time_seconds();
    *out = (sample){0};
    pthread_mutex_lock(&l->lock);
    slot *s = &l->slot[l->taken % l->slots];
    while (!s->ready) pthread_cond_wait(&l->ready, &l->lock);
    sherf_status status = s->status;
    if (status == SHERF_OK)
        *out = s->sample;
    else
        failure(c, status, "%s", s->message);
    s->sample = (sample){0};
    s->ready = false;
    l->taken++;
    pthread_cond_broadcast(&l->room);
    l->waited += time_seconds() - start;
    pthread_mutex_unlock(&l->lock);
    return status;
}

double loader_waited(const loader *l) {
    return l->waited;
}
