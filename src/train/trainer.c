/* sherf_train: steps, checkpoints, and when to stop. */
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <unistd.h>

#include "base/path.h"
#include "eval/lpips_file.h"
#include "eval/resnet50_file.h"
#include "train/picture.h"
#include "train/trainer.h"

static const char *const checkpoint_now = "checkpoint.safetensors";
static const char *const checkpoint_before = "checkpoint-before.safetensors";
enum { SKIPS_IN_A_ROW = 20 };
static const int64_t halve_never = (int64_t)1 << 40;
/* Smaller people are refused: something must be wrong with their cameras. */
static const double px_per_m_min = 2;

typedef struct {
    context *c;
    const sherf_train_options *options;
    ranks ranks;
    sherf_dataset *data;
    body_model *body;
    lpips_network *lpips; /* NULL, and resnet50 as well: three losses */
    resnet50_network *resnet50;
    model *model, *average;
    adam adam;
    train_state state;
    sampling sampling;
    photo_estimator photos; /* for observations by estimate */
    eval_estimator estimator;
    loader *loader; /* NULL: this process has no share of a step */
    tape *tape;
    step_total total;
    history history; /* of rank 0 */
    int64_t first_step, last_step;
    double started, waited;
    int skips_in_a_row;
    bool resumed;
    bool folder_is_new;
    int lock;           /* rank 0's lock on the output folder, or -1 */
    int64_t saved_step; /* step of the existing checkpoint, or -1 if that is not worth keeping */
} trainer;

static void trainer_free(trainer *t) {
    loader_free(t->loader);
    history_close(&t->history);
    total_free(&t->total);
    tape_free(t->tape);
    sampling_free(&t->sampling);
    adam_free(&t->adam);
    model_free(t->model);
    model_free(t->average);
    lpips_free(t->lpips);
    resnet50_free(t->resnet50);
    sherf_estimator_free(t->photos.networks);
    sherf_body_free(t->body);
    sherf_dataset_free(t->data);
    if (t->lock >= 0) close(t->lock);
}

static sherf_status output_path(trainer *t, char path[PATH_LENGTH], const char *name) {
    if (snprintf(path, PATH_LENGTH, "%s/%s", t->options->output, name) < PATH_LENGTH) return SHERF_OK;
    return failure(t->c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", t->options->output);
}

/* Two trainings in one folder would write over each other's files. So the folder itself is locked (flock).
 * The system releases the lock when the process ends, however it ends, so no stale lock can be in the way.
 * File systems without locks go without. */
static sherf_status folder_hold(trainer *t) {
    const char *folder = t->options->output;
    if (t->ranks.rank || t->lock >= 0) return SHERF_OK;
    t->lock = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (t->lock < 0 || !flock(t->lock, LOCK_EX | LOCK_NB) || errno != EWOULDBLOCK) return SHERF_OK;
    return failure(t->c, SHERF_BAD_ARGUMENT,
                   "%s: another training is at work in this folder: wait for its end, or give another folder",
                   folder);
}

/* ---- beginning ---- */

static sherf_status options_check(context *c, const sherf_train_options *o) {
    if (!o->data || !o->body || !o->output)
        return failure(c, SHERF_BAD_ARGUMENT, "a data set, a body and an output folder are needed");
    if (o->size_px < 0 || o->epochs < 0 || o->steps < 0 || o->seconds < 0 || o->batch < 0 ||
        o->batch > BATCH_MAX || o->targets < 0 || o->targets > TARGETS_MAX || o->learning_rate < 0 ||
        o->halve_every < 0 || o->halve_pictures < 0 || o->sample_every < 0 || o->save_every < 0 ||
        o->pictures < 0 || o->pictures > OBSERVED_PICTURES_MAX || o->workers < 0 || o->workers > 1024 ||
        !(o->perceptual_weight >= 0 && o->perceptual_weight <= 1e6) ||
        !(o->estimated >= 0 && o->estimated <= 1) || !(o->beta2 >= 0 && o->beta2 < 1) ||
        !isfinite(o->learning_rate) || !isfinite(o->epochs) || !isfinite(o->seconds))
        return failure(c, SHERF_BAD_ARGUMENT, "a training option is out of range");
    if (o->halve_every && o->halve_pictures)
        return failure(c, SHERF_BAD_ARGUMENT, "the rate is halved after so many steps or pictures, not both");
    if (o->background && strcmp(o->background, "black") && strcmp(o->background, "random"))
        return failure(c, SHERF_BAD_ARGUMENT, "a training's background is 'black' or 'random', not '%.100s'",
                       o->background);
    return SHERF_OK;
}

/* What weights record for use on pictures of other sizes: the training pictures' width, and the scale of
 * people in them (the mean over the first pictures of the first people). */
static sherf_status pictures_measure(trainer *t, model_config *config) {
    enum { PEOPLE_MAX = 16 };
    const int people = t->sampling.people < PEOPLE_MAX ? t->sampling.people : PEOPLE_MAX;
    sherf_camera camera;
    sherf_pose pose;
    double sum = 0;
    for (int i = 0; i < people; i++) {
        const int person = t->sampling.person[i];
        double one;
        sherf_status status = dataset_camera(t->c, t->data, person, 0, &camera);
        if (status == SHERF_OK) status = dataset_pose(t->c, t->data, person, 0, &pose);
        if (status == SHERF_OK) status = body_px_per_m(t->c, t->body, &pose, &camera, &one);
        if (status != SHERF_OK) return status;
        if (!i) config->image_size = t->state.size_px ? t->state.size_px : camera.width_px;
        sum += one * config->image_size / camera.width_px;
    }
    if (!(sum / people >= px_per_m_min))
        return failure(
            t->c, SHERF_MISMATCH,
            "%s: people would be %.2g pixels tall: cameras and bodies do not belong together (metres? "
            "see sherf check)",
            t->options->data, 1.7 * sum / people);
    config->px_per_m = (int)fmin(sum / people + 0.5, 100000);
    return SHERF_OK;
}

/* A data set may have too many masks to check all before the first step. One mask of each of these people is
 * checked, so that wholly wrong masks are not found hours later. */
static sherf_status masks_look_over(trainer *t) {
    enum { PEOPLE_MAX = 64 };
    const sampling *s = &t->sampling;
    const int people = s->people < PEOPLE_MAX ? s->people : PEOPLE_MAX;
    for (int i = 0; i < people; i++) {
        const int k = (int)((int64_t)i * s->people / people);
        if (!s->views[k] || !s->poses[k]) continue;
        if (cancelled(t->c)) return failure(t->c, SHERF_CANCELLED, "cancelled");
        sherf_status status = dataset_mask_check(t->c, t->data, s->person[k], 0, i % s->views[k]);
        if (status != SHERF_OK) return status;
    }
    return SHERF_OK;
}

/* A given preset must match the weights of a checkpoint or, with `start`, of --start; settings that a
 * training measures itself are not compared. */
static sherf_status same_preset(context *c, const char *path, bool start, const char *preset,
                                const model_config *has) {
    const char *colon = strchr(preset, ':');
    model_config wanted;
    sherf_status status = model_config_parse(c, preset, &wanted);
    if (status != SHERF_OK) return status;
    wanted.image_size = has->image_size;
    wanted.px_per_m = has->px_per_m;
    char *a = model_config_text(c, &wanted), *b = model_config_text(c, has);
    status = a && b ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK && (wanted.kind != has->kind || strcmp(a, b) != 0))
        status = failure(c, SHERF_MISMATCH, "%s: of preset %s:%s, not %s:%s: leave the preset out to go on%s",
                         path, has->kind->name, b, wanted.kind->name, colon ? colon + 1 : preset,
                         start ? " with these weights" : ", or train into another folder");
    mem_free(a);
    mem_free(b);
    return status;
}

/* Copies another model's values; false where their tensors differ by name or shape. */
static bool take_values(const model *from, const model *to) {
    if (from->config.kind != to->config.kind || from->weights->count != to->weights->count) return false;
    for (int i = 0; i < to->weights->count; i++) {
        parameter *p = to->weights->item[i];
        const parameter *q = parameter_find(from->weights, p->name);
        if (!q || q->value.rank != p->value.rank ||
            memcmp(q->value.dim, p->value.dim, (size_t)p->value.rank * sizeof *q->value.dim))
            return false;
        memcpy(p->value.data, q->value.data, (size_t)tensor_count(&q->value) * sizeof(float));
    }
    return true;
}

/* Settings that no weight depends on may differ from those the weights were trained with. */
static sherf_status change_settings(trainer *t, const char *preset) {
    model_config wanted;
    model *other = NULL;
    sherf_status status = model_config_parse(t->c, preset, &wanted);
    if (status == SHERF_OK) status = model_create(t->c, &wanted, t->state.seed, &other);
    if (status == SHERF_OK && !take_values(t->model, other))
        status = same_preset(t->c, t->options->start, true, preset, &t->model->config);
    if (status == SHERF_OK) {
        model_free(t->model);
        t->model = other;
        return SHERF_OK;
    }
    model_free(other);
    return status;
}

/* The settings of the weights that a training starts from: new ones, or those of another training. */
static sherf_status config_new(trainer *t, model_config *config) {
    const sherf_train_options *o = t->options;
    if (!o->start) return model_config_parse(t->c, o->preset ? o->preset : "paper", config);
    sherf_status status = model_load(t->c, o->start, &t->model);
    if (status == SHERF_OK && o->preset) status = change_settings(t, o->preset);
    if (status == SHERF_OK) *config = t->model->config;
    return status;
}

static sherf_status weights_new(trainer *t, model_config *config) {
    context *c = t->c;
    sherf_status status = pictures_measure(t, config);
    if (status == SHERF_OK && !t->model) status = model_create(c, config, t->state.seed, &t->model);
    if (status == SHERF_OK) t->model->config = *config;
    if (status == SHERF_OK && t->options->resnet) status = model_load_resnet(c, t->model, t->options->resnet);
    if (status == SHERF_OK) status = model_create(c, config, t->state.seed, &t->average);
    if (status == SHERF_OK)
        memcpy(t->average->weights->values, t->model->weights->values,
               (size_t)t->model->weights->total_floats * sizeof(float));
    return status;
}

/* The number of steps after which the rate is halved, if the options give one; else 0. */
static int64_t halve_steps(const sherf_train_options *o, const train_state *s) {
    const int64_t pictures = (int64_t)s->batch * s->targets, n = o->halve_pictures;
    if (!n) return o->halve_every;
    return n > pictures ? (n + pictures / 2) / pictures : 1;
}

/* New weights, and the state from the options. */
static sherf_status begin_new(trainer *t) {
    const sherf_train_options *o = t->options;
    model_config config;
    sherf_status status = config_new(t, &config);
    if (status != SHERF_OK) return status;
    const training_recipe *own = model_recipe(&config);
    t->state = (train_state){.seed = o->seed,
                             .batch = o->batch ? o->batch
                                      : own    ? own->batch
                                               : 4,
                             .size_px = o->size_px,
                             .front_view = o->front_view != 0,
                             .random_background = o->background && !strcmp(o->background, "random"),
                             .targets = o->targets ? o->targets : 1,
                             .estimated = o->estimated,
                             .pictures = o->pictures ? o->pictures : 1,
                             .beta2 = o->beta2,
                             .learning_rate = o->learning_rate > 0 ? o->learning_rate
                                              : own                ? own->learning_rate
                                                                   : 2e-3};
    status = sampling_create(t->c, t->data, o->people, o->front_view, t->state.targets, t->state.seed,
                             &t->sampling);
    if (status != SHERF_OK) return status;
    int64_t epoch = sampling_pictures(&t->sampling) / t->state.batch;
    if (own) epoch = own->halve_every > 0 ? (int64_t)own->halve_every : halve_never;
    const int64_t halve = halve_steps(o, &t->state);
    t->state.halve_every = halve ? halve : epoch > 1 ? epoch : 1;
    if ((status = weights_new(t, &config)) != SHERF_OK) return status;
    if (own && o->without && *o->without)
        return failure(t->c, SHERF_BAD_ARGUMENT,
                       "a model that is trained by its authors' recipe has no loss to leave out");
    status = losses_parse(t->c, o->without, &t->state.without);
    return status == SHERF_OK ? adam_of_model(t->c, t->model, t->state.beta2, &t->adam) : status;
}

/* The folder's own checkpoint, or the previous one if that is damaged or missing. */
static sherf_status folder_checkpoint(trainer *t, const char *path) {
    char before[PATH_LENGTH], reason[sizeof t->c->message];
    sherf_status status = output_path(t, before, checkpoint_before);
    if (status != SHERF_OK) return status;
    if (!path_is_file(path))
        snprintf(reason, sizeof reason, "%s: not there", path);
    else {
        status = checkpoint_read(t->c, path, &t->model, &t->average, &t->adam, &t->state);
        t->saved_step = t->state.step;
        if (status != SHERF_BAD_FILE || !path_is_file(before)) return status;
        memcpy(reason, t->c->message, sizeof reason);
    }
    status = checkpoint_read(t->c, before, &t->model, &t->average, &t->adam, &t->state);
    if (status != SHERF_OK)
        return failure(t->c, status, "%.300s; nor can the one before it be read, %s", reason,
                       checkpoint_before);
    t->saved_step = -1;
    if (!t->ranks.rank)
        log_line(t->c, SHERF_LOG_WARNING, "%.300s: the one before it is taken, of step %" PRId64, reason,
                 t->state.step);
    return SHERF_OK;
}

/* The checkpoint's state; options that differ override it and are logged. */
static sherf_status begin_again(trainer *t, const char *path) {
    const sherf_train_options *o = t->options;
    train_state *s = &t->state;
    sherf_status status = o->resume ? checkpoint_read(t->c, path, &t->model, &t->average, &t->adam, s)
                                    : folder_checkpoint(t, path);
    if (status == SHERF_OK && o->preset)
        status = same_preset(t->c, path, false, o->preset, &t->model->config);
    if (status != SHERF_OK) return status;
    t->resumed = true;
    train_state old = *s;
    if (o->seed) s->seed = o->seed;
    if (o->batch) s->batch = o->batch;
    if (o->size_px) s->size_px = o->size_px;
    if (o->targets) s->targets = o->targets;
    if (o->front_view) s->front_view = 1;
    if (o->background) s->random_background = !strcmp(o->background, "random");
    if (o->estimated > 0) s->estimated = o->estimated;
    if (o->pictures) s->pictures = o->pictures;
    if (o->learning_rate > 0) s->learning_rate = o->learning_rate;
    if (halve_steps(o, s)) s->halve_every = halve_steps(o, s);
    if (o->beta2 > 0) t->adam.beta2 = s->beta2 = o->beta2;
    if (o->without && (status = losses_parse(t->c, o->without, &s->without)) != SHERF_OK) return status;
    if (old.seed != s->seed || old.batch != s->batch || old.size_px != s->size_px ||
        old.targets != s->targets || old.front_view != s->front_view ||
        old.random_background != s->random_background || old.estimated != s->estimated ||
        old.pictures != s->pictures || old.learning_rate != s->learning_rate ||
        old.halve_every != s->halve_every || old.beta2 != s->beta2 || old.without != s->without)
        log_line(t->c, SHERF_LOG_WARNING,
                 "%s was made with other options: the training goes on with those given now", path);
    status = sampling_create(t->c, t->data, o->people, s->front_view, s->targets, s->seed, &t->sampling);
    if (status == SHERF_OK && !t->model->config.px_per_m) { /* older weights without this record */
        status = pictures_measure(t, &t->model->config);
        t->average->config = t->model->config;
    }
    return status;
}

static sherf_status photos_ready(trainer *t) {
    if (!t->options->estimator)
        return failure(t->c, SHERF_BAD_ARGUMENT,
                       "training on estimated observations needs the networks that see people in photos");
    t->photos.body = t->body;
    t->estimator = (eval_estimator){estimate_by_photo, &t->photos};
    return sherf_estimator_load(t->c, t->options->estimator, &t->photos.networks);
}

/* A model that learns from surfaces: of each observed person, as the data set has him. */
static sherf_status surfaces_check(trainer *t) {
    const char *name = t->model->config.kind->name;
    if (!t->model->config.kind->surfaces) return SHERF_OK;
    if (t->state.targets > 1)
        return failure(t->c, SHERF_BAD_ARGUMENT,
                       "a %s learns from surfaces and has no target pictures, %d were requested", name,
                       t->state.targets);
    if (t->state.estimated > 0)
        return failure(t->c, SHERF_UNSUPPORTED,
                       "a %s learns from surfaces, which estimated observations do not fit", name);
    return surfaces_are_there(t->c, t->data, &t->sampling);
}

/* By steps or by epochs; by both: whichever ends first. */
static int64_t last_step_of(const trainer *t) {
    const sherf_train_options *o = t->options;
    const double epochs = o->epochs > 0 ? o->epochs : o->steps ? INFINITY : 5;
    const double steps = ceil(epochs * (double)sampling_pictures(&t->sampling) / t->state.batch);
    const int64_t by_epochs = (int64_t)fmin(fmax(steps, 1), 1e15);
    return o->steps && o->steps < by_epochs ? o->steps : by_epochs;
}

static sherf_status begin(trainer *t) {
    context *c = t->c;
    const sherf_train_options *o = t->options;
    char path[PATH_LENGTH], before[PATH_LENGTH];
    sherf_status status = sherf_dataset_open(c, o->data, &t->data);
    if (status == SHERF_OK) status = sherf_body_load(c, o->body, &t->body);
    if (status == SHERF_OK && o->lpips)
        status = lpips_load(c, o->lpips, &t->lpips);
    else if (status == SHERF_OK && o->perceptual)
        status = resnet50_load(c, o->perceptual, &t->resnet50);
    if (status == SHERF_OK) status = output_path(t, path, checkpoint_now);
    if (status != SHERF_OK) return status;
    if ((status = folder_hold(t)) != SHERF_OK ||
        (status = output_path(t, before, checkpoint_before)) != SHERF_OK)
        return status;
    if (o->resume)
        status = begin_again(t, o->resume);
    else
        status = path_is_file(path) || path_is_file(before) ? begin_again(t, path) : begin_new(t);
    if (status == SHERF_OK) status = surfaces_check(t);
    if (status == SHERF_OK) status = masks_look_over(t);
    if (status != SHERF_OK) return status;
    if (!t->ranks.rank)
        dataset_body_warn(c, t->data, t->body, o->body, t->sampling.person, t->sampling.people);
    if (t->state.estimated > 0 && (status = photos_ready(t)) != SHERF_OK) return status;
    if (t->state.pictures > 1 && !t->model->config.kind->reads_observed_px)
        return failure(c, SHERF_UNSUPPORTED, "a %s takes one picture of a person, up to %d were requested",
                       t->model->config.kind->name, t->state.pictures);
    t->sampling.random_background = t->state.random_background;
    t->sampling.estimated = t->state.estimated;
    t->sampling.pictures = t->state.pictures;
    t->sampling.one_pose = t->model->config.kind->one_pose;
    t->first_step = t->state.step;
    t->last_step = last_step_of(t);
    return SHERF_OK;
}

/* Everything to where the context's device computes. */
static sherf_status place(trainer *t) {
    context *c = t->c;
    const tensor_memory *memory = backend_of(c)->memory;
    sherf_status status = model_place(c, t->model);
    if (status == SHERF_OK) status = model_place(c, t->average);
    if (status == SHERF_OK) status = adam_place(c, &t->adam, memory);
    if (status == SHERF_OK) status = lpips_place(c, t->lpips, memory);
    if (status == SHERF_OK) status = resnet50_place(c, t->resnet50, memory);
    return status == SHERF_OK ? parameters_make_grads(c, t->model->weights) : status;
}

/* Threads, arrays and files of the loop. */
static sherf_status prepare(trainer *t) {
    context *c = t->c;
    const sherf_train_options *o = t->options;
    const train_state *s = &t->state;
    char path[PATH_LENGTH];
    int begins = (int)((int64_t)s->batch * t->ranks.rank / t->ranks.count);
    int ends = (int)((int64_t)s->batch * (t->ranks.rank + 1) / t->ranks.count);
    sherf_status status = place(t);
    if (status == SHERF_OK)
        status = total_create(c, t->model->weights, s->batch, begins, ends, s->targets, &t->total);
    if (status == SHERF_OK) status = total_overlap(c, &t->total, &t->ranks);
    if (status != SHERF_OK) return status;
    t->tape = tape_create(c, (tape_options){.backend = backend_of(c),
                                            .record = true,
                                            .training = true,
                                            .bf16 = c->precision == SHERF_PRECISION_BF16});
    if (!t->tape) return SHERF_NO_MEMORY;
    const loader_options load = {.source = {t->data, t->body, &t->model->config, &t->estimator, s->size_px},
                                 .sampling = &t->sampling,
                                 .first_step = t->first_step,
                                 .batch = s->batch,
                                 .begin = begins,
                                 .end = ends,
                                 .workers = o->workers ? o->workers : 2};
    if (begins < ends && t->first_step < t->last_step)
        if ((status = loader_create(c, &load, &t->loader)) != SHERF_OK) return status;
    if (t->ranks.rank) return SHERF_OK;
    t->folder_is_new = !path_is_folder(o->output);
    if ((status = output_path(t, path, "samples")) != SHERF_OK) return status;
    if ((status = folder_make(c, path)) != SHERF_OK) return status;
    if ((status = folder_hold(t)) != SHERF_OK) return status;
    if ((status = output_path(t, path, "log.jsonl")) != SHERF_OK) return status;
    return history_open(c, path, t->first_step, &t->history);
}

/* Names the front view of the first person who has not the protocol's. */
static void say_front(const trainer *t) {
    const sampling *s = &t->sampling;
    for (int i = 0; i < s->people && s->front; i++) {
        if (s->front->front_view < s->views[i]) continue;
        log_line(t->c, SHERF_LOG_INFO, "%s has %d views: view %d is taken for the front view",
                 sherf_dataset_person(t->data, s->person[i]), s->views[i],
                 protocol_front(s->front, s->views[i]));
        return;
    }
}

static void announce(trainer *t) {
    context *c = t->c;
    const train_state *s = &t->state;
    char device[200];
    const model_config *config = &t->model->config;
    if (t->ranks.rank) return;
    if (t->first_step >= t->last_step) {
        log_line(c, SHERF_LOG_INFO,
                 "%s: nothing is left to train: step %" PRId64
                 " is done, and the last was to be step %" PRId64,
                 t->options->output, t->first_step, t->last_step);
        return;
    }
    log_line(c, SHERF_LOG_INFO,
             "training %s:%s (%.1f million parameters) on %" PRId64
             " pictures of %d people, %d sample%s a step, "
             "steps %" PRId64 " to %" PRId64,
             config->kind->name, config->preset, (double)parameters_trained_count(t->model->weights) / 1e6,
             sampling_pictures(&t->sampling), t->sampling.people, s->batch, s->batch == 1 ? "" : "s",
             t->first_step + 1, t->last_step);
    if (c->device == SHERF_DEVICE_CUDA && sherf_device_find(c->device, device, sizeof device) == SHERF_OK)
        log_line(c, SHERF_LOG_INFO, "on %s", device);
    const char *unread = t->options->start ? t->options->start : t->options->resnet;
    if (t->resumed)
        log_line(c, SHERF_LOG_INFO, "going on after step %" PRId64 "%s%s%s", s->step, unread ? "; " : "",
                 unread ? unread : "", unread ? " is of use for a new training only and is not read" : "");
    say_front(t);
    if (config->kind->surfaces)
        log_line(c, SHERF_LOG_INFO, "on the people's surfaces: what is inside is the loss, and the colours");
    else if (model_recipe(&t->model->config))
        log_line(c, SHERF_LOG_INFO, "as its authors train it: the squared error of drawn rays is the loss");
    else if (t->resnet50)
        log_line(c, SHERF_LOG_INFO, "the loss has the resnet50 distance (%s) where the paper's has LPIPS",
                 t->options->perceptual);
    else if (!t->lpips)
        log_line(c, SHERF_LOG_INFO, "LPIPS is left out of the loss: no VGG16 weights were given");
}

/* ---- a step ---- */

static sherf_status share(trainer *t) {
    context *c = t->c;
    const double scale = 1.0 / t->state.batch;
    const loss_networks networks = {t->lpips, t->resnet50, t->options->perceptual_weight, t->state.without};
    for (int i = t->total.begin; i < t->total.end; i++) {
        sample s;
        if (cancelled(c)) return failure(c, SHERF_CANCELLED, "cancelled");
        sherf_status status = loader_next(c, t->loader, &s);
        total_watch(&t->total, t->tape, i);
        if (status == SHERF_OK)
            status =
                sample_gradients(t->tape, t->model, t->body, &networks, &s, scale, total_rows(&t->total, i));
        sample_free(&s);
        if (status == SHERF_OK) status = total_add(c, &t->total, i);
        if (status != SHERF_OK) return status;
    }
    return SHERF_OK;
}

/* After a failure, whose message stays. */
static void undo(trainer *t) {
    context quiet = {0};
    total_undo(&quiet, &t->total);
}

/* One step; on failure the model is as before it. */
static sherf_status step(trainer *t, loss_values *mean, bool *skipped) {
    context *c = t->c;
    parameters *p = t->model->weights;
    train_state *s = &t->state;
    double squares = 0;
    sherf_status status = total_start(c, &t->total);
    status = ranks_agree(c, &t->ranks, status == SHERF_OK ? share(t) : status);
    if (status == SHERF_OK) status = total_finish(c, &t->total, &t->ranks, mean);
    if (status == SHERF_OK) status = gradients_square_sum(c, &t->adam, p->grads, &squares);
    if (status != SHERF_OK) {
        undo(t);
        return status;
    }
    *skipped = !isfinite(squares) || !isfinite(mean->total);
    s->step++;
    if (*skipped) {
        if ((status = total_undo(c, &t->total)) != SHERF_OK) return status;
        s->skipped++;
        log_line(c, SHERF_LOG_WARNING, "step %" PRId64 ": its gradients are not finite and are left out",
                 s->step);
        if (++t->skips_in_a_row < SKIPS_IN_A_ROW) return SHERF_OK;
        return failure(c, SHERF_BAD_ARGUMENT,
                       "the loss diverged: %d steps in a row gave gradients that are not finite; a "
                       "lower learning rate may help",
                       SKIPS_IN_A_ROW);
    }
    t->skips_in_a_row = 0;
    status = adam_step(c, &t->adam, p->values, p->grads,
                       schedule_rate(s->learning_rate, s->step - 1, s->halve_every));
    if (status != SHERF_OK) return status;
    return average_update(c, p->memory, p->total_floats, t->average->weights->values, p->values,
                          average_decay(s->step));
}

/* ---- files ---- */

static bool finite_weights(const model *m, const float *values) {
    for (int64_t i = 0; i < m->weights->total_floats; i++)
        if (!isfinite(values[i])) return false;
    return true;
}

/* Refuses weights that are not finite: a diverged state must not replace the existing checkpoint. */
static sherf_status lost_check(trainer *t) {
    const model *const m[] = {t->model, t->average};
    bool finite = true;
    for (int i = 0; i < 2 && finite; i++) {
        const float *values;
        float *copy = NULL;
        sherf_status status = parameters_read(t->c, m[i]->weights, &values, &copy);
        finite = status == SHERF_OK && finite_weights(m[i], values);
        mem_free(copy);
        if (status != SHERF_OK) return status;
    }
    if (finite) return SHERF_OK;
    return failure(t->c, SHERF_BAD_ARGUMENT,
                   "the loss diverged: after step %" PRId64
                   " the weights are not finite; a lower learning rate may help",
                   t->state.step);
}

/* Links the checkpoint under its second name as well; the next one then takes the first name, so there is a
 * checkpoint at every moment. */
static sherf_status keep_before(trainer *t, const char *path) {
    char before[PATH_LENGTH], between[PATH_LENGTH];
    sherf_status status = output_path(t, before, checkpoint_before);
    if (status == SHERF_OK) status = output_path(t, between, ".checkpoint-between");
    if (status != SHERF_OK || t->saved_step < 0 || t->saved_step == t->state.step || !path_is_file(path))
        return status;
    unlink(between);
    /* Where a file cannot have two names it is moved; until the next one is written, training continues from
     * it. */
    if ((link(path, between) ? rename(path, before) : rename(between, before)) == 0) return SHERF_OK;
    return failure(t->c, SHERF_WRITE_FAILED, "%s: %s", before, strerror(errno));
}

static sherf_status save(trainer *t) {
    char path[PATH_LENGTH];
    if (t->ranks.rank) return SHERF_OK;
    sherf_status status = lost_check(t);
    if (status == SHERF_OK) status = output_path(t, path, checkpoint_now);
    if (status == SHERF_OK) status = keep_before(t, path);
    if (status == SHERF_OK) status = checkpoint_write(t->c, path, t->model, t->average, &t->adam, &t->state);
    if (status == SHERF_OK) t->saved_step = t->state.step;
    if (status == SHERF_OK) status = output_path(t, path, "model.safetensors");
    if (status == SHERF_OK)
        status = sherf_model_save(t->c, t->options->last_weights ? t->model : t->average, path);
    if (status == SHERF_OK) status = output_path(t, path, "loss.png");
    if (status == SHERF_OK) status = history_plot(t->c, &t->history, path);
    return status;
}

static sherf_status sample_picture(trainer *t) {
    char name[64], path[PATH_LENGTH];
    if (t->ranks.rank) return SHERF_OK;
    uint64_t at = random_key(t->state.seed, "train.sample", (uint64_t)t->state.step);
    draw drawn = sampling_draw(&t->sampling, random_below(at, 0, sampling_pictures(&t->sampling)));
    snprintf(name, sizeof name, "samples/%06" PRId64 ".png", t->state.step);
    sherf_status status = output_path(t, path, name);
    if (status != SHERF_OK) return status;
    return picture_write(t->c, t->data, t->average, t->body, drawn, t->state.size_px, path);
}

/* The line of the log, progress with the steps that are still to come in the time allowed. */
static sherf_status tell(trainer *t, const loss_values *mean, double step_seconds, bool skipped) {
    const train_state *s = &t->state;
    const double elapsed = time_seconds() - t->started;
    const double pace = elapsed / (double)(s->step - t->first_step);
    double left = (double)(t->last_step - s->step);
    if (t->options->seconds > 0) left = fmin(left, fmax(t->options->seconds - elapsed, 0) / pace);
    if (t->ranks.rank) return SHERF_OK;
    double waited = t->loader ? loader_waited(t->loader) : 0;
    const history_extra extra = {.rate = schedule_rate(s->learning_rate, s->step - 1, s->halve_every),
                                 .seconds = step_seconds,
                                 .eta_seconds = left * pace,
                                 .waited_seconds = waited - t->waited,
                                 .skipped = skipped};
    t->waited = waited;
    if (t->c->progress)
        t->c->progress(t->c->user, "training steps", (double)s->step, ceil((double)s->step + left));
    return history_add(t->c, &t->history, (history_point){s->step, *mean}, &extra);
}

/* Whether every process stops here: asked to, or out of time. */
static sherf_status stop(trainer *t, bool *cancel, bool *stops) {
    double limit = t->options->seconds;
    int flags[2] = {cancelled(t->c), limit > 0 && time_seconds() - t->started >= limit};
    sherf_status status = ranks_max(t->c, &t->ranks, 2, flags);
    *cancel = flags[0];
    *stops = flags[0] || flags[1];
    return status;
}

static sherf_status loop(trainer *t, bool *cancel) {
    const int64_t sample_every = t->options->sample_every ? t->options->sample_every : 500;
    const int64_t save_every = t->options->save_every ? t->options->save_every : 500;
    while (t->state.step < t->last_step) {
        bool stops, skipped = false;
        loss_values mean;
        sherf_status status = stop(t, cancel, &stops);
        if (status != SHERF_OK || stops) return status;
        double begins = time_seconds();
        status = step(t, &mean, &skipped);
        if (status == SHERF_CANCELLED) *cancel = true;
        if (status != SHERF_OK) return status == SHERF_CANCELLED ? SHERF_OK : status;
        status = tell(t, &mean, time_seconds() - begins, skipped);
        if (status == SHERF_OK && t->state.step % sample_every == 0) status = sample_picture(t);
        if (status == SHERF_OK && t->state.step % save_every == 0) status = save(t);
        if (status == SHERF_CANCELLED) {
            *cancel = true;
            status = SHERF_OK;
        }
        if ((status = ranks_agree(t->c, &t->ranks, status)) != SHERF_OK) return status;
    }
    return SHERF_OK;
}

/* A first run that fails before its first step leaves nothing behind. */
static void leave_nothing(trainer *t) {
    char path[PATH_LENGTH];
    if (t->ranks.rank || !t->folder_is_new) return;
    history_close(&t->history);
    if (output_path(t, path, "log.jsonl") == SHERF_OK) unlink(path);
    if (output_path(t, path, "samples") == SHERF_OK) rmdir(path);
    rmdir(t->options->output);
}

/* Runs the loop and saves the result, even after a failure, whose message is kept. */
static sherf_status run(trainer *t) {
    context *c = t->c;
    bool cancel = false;
    char message[sizeof c->message];
    t->started = time_seconds();
    announce(t);
    sherf_status status = loop(t, &cancel);
    if (status != SHERF_OK && status != SHERF_CANCELLED && t->state.step > t->first_step) {
        char reason[sizeof c->message];
        memcpy(reason, c->message, sizeof reason);
        if (lost_check(t) == SHERF_OK) memcpy(c->message, reason, sizeof reason);
    }
    memcpy(message, c->message, sizeof message);
    const bool nothing = status != SHERF_OK && t->state.step == t->first_step;
    sherf_status saved = t->skips_in_a_row < SKIPS_IN_A_ROW && !nothing ? save(t) : SHERF_OK;
    if (status != SHERF_OK) {
        if (nothing)
            leave_nothing(t);
        else if (saved == SHERF_OK && t->skips_in_a_row < SKIPS_IN_A_ROW && !t->ranks.rank)
            log_line(c, SHERF_LOG_INFO,
                     "what was learned in %" PRId64 " steps is saved; the same command goes on from %s",
                     t->state.step, t->options->output);
        memcpy(c->message, message, sizeof message);
        return status;
    }
    if (saved != SHERF_OK) return saved;
    if (cancel)
        return failure(c, SHERF_CANCELLED, "stopped after step %" PRId64 "; the same command goes on from %s",
                       t->state.step, t->options->output);
    return SHERF_OK;
}

sherf_status sherf_train(sherf_context *c, const sherf_train_options *options) {
    trainer t = {.c = c, .options = options, .lock = -1};
    const int threads = c->threads;
    sherf_status status = options_check(c, options);
    if (status == SHERF_OK) status = ranks_open(c, &t.ranks);
    if (status != SHERF_OK) return status;
    /* Processes of one machine share its cores, unless the caller has said how many each takes. */
    if (t.ranks.local > 1 && threads == threads_available())
        c->threads = threads > t.ranks.local ? threads / t.ranks.local : 1;
    status = ranks_join(c, &t.ranks, backend_of(c)->memory);
    if (status == SHERF_OK) status = begin(&t);
    if (status == SHERF_OK) status = prepare(&t);
    status = ranks_agree(c, &t.ranks, status);
    if (status == SHERF_OK) status = run(&t);
    if (status == SHERF_NO_MEMORY && t.model)
        failure_prefix(c, status, "training %s:%s on pictures %d wide, %d samples a step",
                       t.model->config.kind->name, t.model->config.preset,
                       t.state.size_px ? t.state.size_px : t.model->config.image_size, t.state.batch);
    ranks_close(&t.ranks, status != SHERF_OK);
    trainer_free(&t);
    c->threads = threads;
    return status;
}
