/* Tests of the whole trainer on a small made-up data set: the loss falls, a stopped training continues with
 * the same bits, and several processes equal one. */
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/path.h"
#include "data/thuman_write.h"
#include "io/image.h"
#include "io/safetensors.h"
#include "io/value.h"
#include "model/model.h"
#include "tube_training.h"

static char program[4096]; /* this program, started again under mpirun */

static context *float_context(int threads) {
    context *c;
    const sherf_options o = {.threads = threads, .precision = SHERF_PRECISION_FP32};
    if (sherf_context_create(&o, &c) != SHERF_OK) abort();
    return c;
}

static int make_data(void **state) {
    context *c = float_context(1);
    const sherf_synth_options synth = {.people = 2, .poses = 2, .views = 4, .size_px = 48, .seed = 5};
    const sherf_status status = tubes_make(c, &synth);
    sherf_context_free(c);
    return status != SHERF_OK;
}

static sherf_train_options options_for(const char *output, int64_t steps) {
    return tube_training(TINY ",samples=16", output, steps);
}

/* The largest difference of two files' tensors relative to the largest value of each; both have the same
 * names. */
static double difference(context *c, const char *a, const char *b) {
    safetensors *x, *y;
    double worst = 0;
    assert_ok(c, safetensors_read(c, a, &x));
    assert_ok(c, safetensors_read(c, b, &y));
    assert_int_equal(x->count, y->count);
    for (size_t i = 0; i < x->count; i++) {
        const safetensor *p = &x->tensor[i], *q = safetensors_find(y, p->name);
        assert_non_null(q);
        int64_t n = 1;
        for (int k = 0; k < p->rank; k++) n *= p->dim[k];
        double max = 0, off = 0;
        for (int64_t k = 0; k < n; k++) {
            double u = ((const float *)p->data)[k], v = ((const float *)q->data)[k];
            max = fmax(max, fabs(u));
            off = fmax(off, fabs(u - v));
        }
        if (max > 0) worst = fmax(worst, off / max);
    }
    safetensors_free(x);
    safetensors_free(y);
    return worst;
}

static void learns_and_writes(void **state) {
    context *c = float_context(1);
    const char *run = path_of("learn");
    sherf_train_options o = options_for(run, 60);
    o.sample_every = 30;
    o.halve_every = 1000;
    assert_ok(c, sherf_train(c, &o));
    double first = 0, last = 0;
    for (int i = 1; i <= 10; i++) {
        first += logged(c, run, i, "loss");
        last += logged(c, run, 50 + i, "loss");
    }
    assert_true(last < 0.7 * first);
    assert_true(logged(c, run, 60, "step") == 60 && isnan(logged(c, run, 60, "lpips")));
    const char *files[] = {"learn/checkpoint.safetensors", "learn/model.safetensors", "learn/loss.png",
                           "learn/samples/000030.png", "learn/samples/000060.png"};
    for (size_t i = 0; i < COUNT_OF(files); i++) assert_true(path_is_file(path_of(files[i])));
    sherf_model *m;
    assert_ok(c, sherf_model_load(c, path_of("learn/model.safetensors"), &m));
    sherf_model_free(m);
    assert_ok(c, sherf_train(c, &o)); /* nothing is left to do */
    assert_true(logged(c, run, 60, "step") == 60);
    sherf_context_free(c);
}

static void resuming_gives_the_same_bits(void **state) {
    context *c = float_context(1);
    const size_t live = mem_live();
    const char *whole = path_of("whole"), *parts = path_of("parts");
    sherf_train_options o = options_for(whole, 7);
    assert_ok(c, sherf_train(c, &o));
    o = options_for(parts, 3);
    assert_ok(c, sherf_train(c, &o));
    o = options_for(parts, 7);
    o.workers = 5;
    assert_ok(c, sherf_train(c, &o));
    assert_true(
        difference(c, path_of("whole/checkpoint.safetensors"), path_of("parts/checkpoint.safetensors")) == 0);
    assert_true(difference(c, path_of("whole/model.safetensors"), path_of("parts/model.safetensors")) == 0);
    for (int i = 1; i <= 7; i++) assert_true(logged(c, whole, i, "loss") == logged(c, parts, i, "loss"));
    assert_int_equal(mem_live(), live);
    sherf_context_free(c);
}

/* Fine-tuning; runs after learns_and_writes. */
static void a_training_starts_from_weights(void **state) {
    context *c = float_context(1);
    const char *run = path_of("tuned"), *weights = path_of("learn/model.safetensors");
    sherf_train_options o = options_for(run, 2);
    o.start = weights;
    o.learning_rate = 1e-6;
    assert_ok(c, sherf_train(c, &o));
    assert_true(logged(c, run, 1, "loss") < 0.7 * logged(c, path_of("learn"), 1, "loss"));
    /* running statistics move */
    assert_true(difference(c, weights, path_of("tuned/model.safetensors")) < 0.5);
    o.output = path_of("seeing"); /* other settings without their own weights */
    o.preset = TINY ",samples=16,occlusion=2";
    assert_ok(c, sherf_train(c, &o));
    assert_true(difference(c, weights, path_of("seeing/model.safetensors")) < 0.5);
    sherf_model *m;
    assert_ok(c, sherf_model_load(c, path_of("seeing/model.safetensors"), &m));
    assert_int_equal(m->config.occlusion, 2);
    sherf_model_free(m);
    o.output = path_of("other");
    o.preset = "small";
    assert_fails(c, sherf_train(c, &o), SHERF_MISMATCH, "not sherf:small");
    o.start = path_of("learn/loss.png");
    assert_fails(c, sherf_train(c, &o), SHERF_BAD_FILE, "loss.png");
    o.start = NULL;
    o.estimated = 0.5;
    assert_fails(c, sherf_train(c, &o), SHERF_BAD_ARGUMENT, "networks that see people");
    o.estimated = 1.5;
    assert_fails(c, sherf_train(c, &o), SHERF_BAD_ARGUMENT, "out of range");
    assert_false(path_is_folder(o.output));
    sherf_context_free(c);
}

static void stop_after_first(void *user, const char *text, double done, double total) {
    if (done >= 2) sherf_cancel(*(context **)user);
}

static void cancelling_saves(void **state) {
    context *c;
    const sherf_options told = {
        .threads = 1, .precision = SHERF_PRECISION_FP32, .progress = stop_after_first, .user = &c};
    assert_int_equal(sherf_context_create(&told, &c), SHERF_OK);
    sherf_train_options o = options_for(path_of("cancelled"), 7);
    assert_int_equal(sherf_train(c, &o), SHERF_CANCELLED);
    assert_non_null(strstr(c->message, "after step 2"));
    sherf_context_free(c);
    c = float_context(1);
    assert_ok(c, sherf_train(c, &o)); /* it finds its checkpoint by itself */
    assert_true(difference(c, path_of("whole/checkpoint.safetensors"),
                           path_of("cancelled/checkpoint.safetensors")) == 0);
    sherf_context_free(c);
}

/* A checkpoint stores the terms left out of the loss, and Adam's beta2. */
static void losses_and_beta2_are_kept(void **state) {
    context *c = float_context(1);
    const char *whole = path_of("less"), *parts = path_of("less_parts");
    sherf_train_options o = options_for(whole, 5);
    o.without = "mask,ssim";
    o.beta2 = 0.992;
    assert_ok(c, sherf_train(c, &o));
    assert_true(isnan(logged(c, whole, 1, "ssim")));
    assert_true(fabs(logged(c, whole, 1, "loss") - 100 * logged(c, whole, 1, "color")) < 1e-3);
    o.output = parts;
    o.steps = 2;
    assert_ok(c, sherf_train(c, &o));
    o = options_for(parts, 5); /* not given again */
    assert_ok(c, sherf_train(c, &o));
    assert_true(difference(c, path_of("less/checkpoint.safetensors"),
                           path_of("less_parts/checkpoint.safetensors")) == 0);
    o = options_for(path_of("usual"), 5);
    o.without = "mask,ssim";
    assert_ok(c, sherf_train(c, &o));
    assert_true(
        difference(c, path_of("less/checkpoint.safetensors"), path_of("usual/checkpoint.safetensors")) > 0);
    o.output = path_of("refused");
    o.without = "lpip";
    assert_fails(c, sherf_train(c, &o), SHERF_BAD_ARGUMENT, "not 'lpip'");
    o.without = NULL;
    o.beta2 = 1;
    assert_fails(c, sherf_train(c, &o), SHERF_BAD_ARGUMENT, "out of range");
    sherf_context_free(c);
}

/* Of steps and epochs, whichever end first count. */
static void the_first_end_counts(void **state) {
    context *c = float_context(1);
    sherf_train_options o = options_for(path_of("one"), 1);
    assert_ok(c, sherf_train(c, &o));
    o = options_for(path_of("short"), 5);
    o.epochs = 1e-9;
    assert_ok(c, sherf_train(c, &o));
    assert_true(difference(c, path_of("one/model.safetensors"), path_of("short/model.safetensors")) == 0);
    o.steps = 2;
    o.epochs = 1000;
    assert_ok(c, sherf_train(c, &o));
    assert_true(logged(c, path_of("short"), 2, "loss") > 0);
    sherf_context_free(c);
}

static size_t tensor_bytes_of(const safetensor *t) {
    size_t n = dtype_size(t->type);
    for (int k = 0; k < t->rank; k++) n *= (size_t)t->dim[k];
    return n;
}

/* As in the release: the rate is halved by target pictures, and the last weights are written. */
static void as_the_release_trains(void **state) {
    context *c = float_context(1);
    const char *run = path_of("released");
    sherf_train_options o = options_for(run, 3);
    o.halve_pictures = 17; /* 8 per step: 2 steps */
    o.last_weights = 1;
    assert_ok(c, sherf_train(c, &o));
    const double rate = logged(c, run, 1, "rate");
    assert_true(logged(c, run, 2, "rate") == rate && logged(c, run, 3, "rate") == rate / 2);
    safetensors *checkpoint, *weights;
    assert_ok(c, safetensors_read(c, path_of("released/checkpoint.safetensors"), &checkpoint));
    assert_ok(c, safetensors_read(c, path_of("released/model.safetensors"), &weights));
    bool averaged = false;
    for (size_t i = 0; i < weights->count; i++) {
        const safetensor *w = &weights->tensor[i];
        char name[300];
        snprintf(name, sizeof name, "model.%s", w->name);
        const safetensor *last = safetensors_find(checkpoint, name);
        snprintf(name, sizeof name, "average.%s", w->name);
        const safetensor *average = safetensors_find(checkpoint, name);
        assert_non_null(last);
        const size_t bytes = tensor_bytes_of(w);
        if (strstr(w->name, ".const")) continue; /* its rows are in another order */
        assert_memory_equal(w->data, last->data, bytes);
        averaged |= memcmp(average->data, last->data, bytes) != 0;
    }
    assert_true(averaged);
    safetensors_free(checkpoint);
    safetensors_free(weights);
    o.output = path_of("refused");
    o.halve_every = 2;
    assert_fails(c, sherf_train(c, &o), SHERF_BAD_ARGUMENT, "not both");
    sherf_context_free(c);
}

/* Replaces words of a file without a checksum by others of the same length, or makes the last number
 * infinite. */
static void spoil(context *c, const char *path, const char *word, const char *other, bool number) {
    unsigned char *data;
    size_t bytes;
    assert_ok(c, file_read(c, path, (size_t)1 << 30, &data, &bytes));
    unsigned char *sum = memmem(data, bytes, "crc32", 5), *at = memmem(data, bytes, word, strlen(word));
    assert_non_null(at);
    memcpy(at, other, strlen(word));
    if (sum) sum[0] = 'x'; /* another key */
    if (number) memset(data + bytes - 4, 0xff, 4);
    assert_ok(c, file_write(c, path, data, bytes));
    mem_free(data);
}

static void a_bad_checkpoint_is_one_line(void **state) {
    context *c = float_context(1);
    const size_t live = mem_live();
    sherf_train_options o = options_for(path_of("bad"), 7);
    o.resume = path_of("whole/model.safetensors"); /* weights, not a checkpoint */
    assert_int_equal(sherf_train(c, &o), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "model.safetensors: not a checkpoint"));
    assert_false(path_is_folder(path_of("bad")));
    o.resume = path_of("none.safetensors");
    assert_int_equal(sherf_train(c, &o), SHERF_NO_FILE);
    o = options_for(path_of("bad"), 7);
    o.preset = "tiny";
    assert_int_equal(sherf_train(c, &o), SHERF_BAD_ARGUMENT);
    o = options_for(path_of("bad"), 7);
    o.resume = path_of("whole/checkpoint.safetensors");
    o.preset = "base";
    assert_int_equal(sherf_train(c, &o), SHERF_MISMATCH);
    assert_non_null(strstr(c->message, "not sherf:base"));
    assert_false(path_is_folder(path_of("bad")));
    o.preset = NULL; /* the checkpoint's preset */
    assert_ok(c, sherf_train(c, &o));
    folder_remove(path_of("bad"));
    o = options_for(path_of("bad"), 7);
    o.learning_rate = 1e30;
    assert_int_equal(sherf_train(c, &o), SHERF_OK); /* seven steps are too few to give up */
    folder_remove(path_of("bad"));
    o = options_for(path_of("bad"), 2);
    assert_ok(c, sherf_train(c, &o));
    o = options_for(path_of("bad"), 7);
    o.learning_rate = 1e308; /* lost weights do not replace good ones */
    assert_int_equal(sherf_train(c, &o), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(c->message, "diverged"));
    o = options_for(path_of("bad"), 7);
    assert_ok(c, sherf_train(c, &o));
    assert_true(
        difference(c, path_of("whole/checkpoint.safetensors"), path_of("bad/checkpoint.safetensors")) == 0);
    unlink(path_of("bad/checkpoint-before.safetensors"));
    spoil(c, path_of("bad/checkpoint.safetensors"), "crc32", "xrc32", true);
    assert_int_equal(sherf_train(c, &o), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "bad/checkpoint.safetensors: tensor second."));
    assert_non_null(strstr(c->message, "not finite"));
    spoil(c, path_of("bad/checkpoint.safetensors"), "\"batch\":\"4\"", "\"batch\":\"0\"", false);
    assert_fails(c, sherf_train(c, &o), SHERF_BAD_FILE,
                 "bad/checkpoint.safetensors: batch is '0': must be 1 to 65536");
    spoil(c, path_of("bad/checkpoint.safetensors"), "\"batch\"", "\"hatch\"", false);
    assert_fails(c, sherf_train(c, &o), SHERF_BAD_FILE, "bad/checkpoint.safetensors: batch is missing");
    assert_int_equal(mem_live(), live);
    sherf_context_free(c);
}

static void flip_a_bit(const char *path) {
    FILE *f = fopen(path, "r+b");
    assert_non_null(f);
    assert_int_equal(fseek(f, -4, SEEK_END), 0);
    const int byte = fgetc(f);
    assert_int_equal(fseek(f, -4, SEEK_END), 0);
    assert_true(fputc(byte ^ 1, f) != EOF);
    assert_int_equal(fclose(f), 0);
}

/* Of seven steps with a checkpoint every two, those of 6 and 7 are kept. If the one of 7 is damaged, the
 * training continues from that of 6, and the end has the bits of an undisturbed training. */
static void a_damaged_checkpoint_gives_way_to_the_one_before(void **state) {
    context *c = float_context(1);
    const size_t live = mem_live();
    char now[4096], before[4096];
    snprintf(now, sizeof now, "%s", path_of("kept/checkpoint.safetensors"));
    snprintf(before, sizeof before, "%s", path_of("kept/checkpoint-before.safetensors"));
    sherf_train_options o = options_for(path_of("kept"), 7);
    o.save_every = 2;
    assert_ok(c, sherf_train(c, &o));
    assert_true(path_is_file(before));
    assert_true(difference(c, now, before) > 0);
    flip_a_bit(now);
    assert_ok(c, sherf_train(c, &o));
    assert_true(difference(c, path_of("whole/checkpoint.safetensors"), now) == 0);
    assert_true(difference(c, now, before) > 0); /* the damaged one did not replace it */
    assert_int_equal(unlink(now), 0);
    assert_ok(c, sherf_train(c, &o));
    assert_true(difference(c, path_of("whole/checkpoint.safetensors"), now) == 0);
    flip_a_bit(now);
    o.resume = now; /* requested by name: no other one is used instead */
    assert_int_equal(sherf_train(c, &o), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "checkpoint.safetensors: damaged"));
    o.resume = NULL;
    flip_a_bit(before);
    assert_int_equal(sherf_train(c, &o), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "nor can the one before it be read"));
    assert_null(strchr(c->message, '\n'));
    assert_int_equal(mem_live(), live);
    sherf_context_free(c);
}

/* A process that locks the folder and then dies as if killed. */
static void two_trainings_in_one_folder_are_refused(void **state) {
    context *c = float_context(1);
    sherf_train_options o = options_for(path_of("held"), 1);
    assert_ok(c, folder_make(c, path_of("held")));
    int ready[2];
    char byte;
    assert_int_equal(pipe(ready), 0);
    const pid_t other = fork();
    if (!other) {
        const int folder = open(path_of("held"), O_RDONLY);
        byte = folder >= 0 && !flock(folder, LOCK_EX | LOCK_NB);
        if (write(ready[1], &byte, 1) == 1) pause();
        _exit(0);
    }
    assert_true(other > 0);
    assert_int_equal(read(ready[0], &byte, 1), 1);
    assert_int_equal(byte, 1);
    assert_int_equal(sherf_train(c, &o), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(c->message, "held: another training is at work in this folder"));
    assert_false(path_is_file(path_of("held/log.jsonl")));
    kill(other, SIGKILL);
    assert_int_equal(waitpid(other, NULL, 0), other);
    close(ready[0]);
    close(ready[1]);
    assert_ok(c, sherf_train(c, &o));
    assert_ok(c, sherf_train(c, &o)); /* a training does not hold the lock after it ends */
    sherf_context_free(c);
}

/* Cameras of tube_000 with T scaled and then moved along x. */
static void write_cameras(context *c, const char *spec, const char *person, float scale, float shift) {
    enum { VIEWS = 3 };
    sherf_dataset *d;
    sherf_camera camera[VIEWS];
    assert_ok(c, sherf_dataset_open(c, spec, &d));
    for (int v = 0; v < VIEWS; v++) {
        assert_ok(c, sherf_dataset_camera(c, d, 0, v, &camera[v]));
        for (int i = 0; i < 3; i++) camera[v].T_m[i] *= scale;
        camera[v].T_m[0] += shift;
    }
    sherf_dataset_free(d);
    assert_ok(c, thuman_write_annots(c, person, 1, VIEWS, camera));
}

/* One line names the file or the error, and no folder is left of a run that never made a step. */
static void broken_data_is_one_line(void **state) {
    context *c = float_context(1);
    const size_t live = mem_live();
    char spec[600], body[600];
    const sherf_synth_options synth = {.people = 1, .poses = 1, .views = 3, .size_px = 48, .seed = 6};
    assert_ok(c, sherf_synth_tube(c, path_of("broken"), &synth));
    snprintf(spec, sizeof spec, "thuman:%s", path_of("broken"));
    snprintf(body, sizeof body, "%s", path_of("broken/tubeman.safetensors"));
    sherf_train_options o = options_for(path_of("broken_run"), 3);
    o.data = spec;
    o.body = body;
    o.people = "0";
    write_cameras(c, spec, path_of("broken/tube_000"), 1, 50);
    assert_int_equal(sherf_train(c, &o), SHERF_MISMATCH);
    assert_non_null(strstr(c->message, "tube_000, pose 0, view "));
    assert_non_null(strstr(c->message, "the body lies outside the picture"));
    assert_false(path_is_folder(path_of("broken_run")));
    write_cameras(c, spec, path_of("broken/tube_000"), 1, -50);
    for (int v = 0; v < 3; v++) { /* any of them may be drawn first */
        char name[64];
        snprintf(name, sizeof name, "broken/tube_000/mask_cihp/view%02d/000000.png", v);
        assert_int_equal(unlink(path_of(name)), 0);
    }
    assert_int_equal(sherf_train(c, &o), SHERF_NO_FILE);
    assert_non_null(strstr(c->message, "broken/tube_000/mask_cihp/view0"));
    assert_false(path_is_folder(path_of("broken_run")));
    write_cameras(c, spec, path_of("broken/tube_000"), 1000, 0);
    assert_int_equal(sherf_train(c, &o), SHERF_MISMATCH);
    assert_non_null(strstr(c->message, "metres?"));
    assert_false(path_is_folder(path_of("broken_run")));
    assert_int_equal(truncate(path_of("broken/tube_000/annots.npy"), 200), 0);
    assert_int_equal(sherf_train(c, &o), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "broken/tube_000/annots.npy"));
    assert_false(path_is_folder(path_of("broken_run")));
    assert_int_equal(mem_live(), live);
    sherf_context_free(c);
}

/* Sets every pixel of the masks of a pose of "masks", whose first mask is 000000.png. */
static void fill_masks(context *c, int pose, int views, bool keep, uint8_t with) {
    for (int v = 0; v < views; v++) {
        char name[80], kept[90];
        image_u8 mask;
        snprintf(name, sizeof name, "masks/tube_000/mask_cihp/view%02d/%06d.png", v, pose);
        snprintf(kept, sizeof kept, "%s.kept", name);
        if (!keep) {
            assert_int_equal(rename(path_of(kept), path_of(name)), 0);
            continue;
        }
        assert_int_equal(rename(path_of(name), path_of(kept)), 0);
        assert_ok(c, image_read(c, path_of(kept), IMAGE_MASK, &mask));
        memset(mask.data, with, (size_t)mask.width * (size_t)mask.height);
        assert_ok(c, png_write(c, path_of(name), mask.width, mask.height, 1, mask.data));
        mem_free(mask.data);
    }
}

/* Wrong masks of first pictures are found before the first step. One that is drawn later ends the training
 * with its name; the progress is saved, and with the mask repaired the training continues as if nothing had
 * happened. */
static void an_empty_or_full_mask_ends_it(void **state) {
    enum { VIEWS = 3 };
    context *c = float_context(1);
    const size_t live = mem_live();
    char spec[600], body[600];
    const sherf_synth_options synth = {.people = 1, .poses = 2, .views = VIEWS, .size_px = 48, .seed = 6};
    assert_ok(c, sherf_synth_tube(c, path_of("masks"), &synth));
    snprintf(spec, sizeof spec, "thuman:%s", path_of("masks"));
    snprintf(body, sizeof body, "%s", path_of("masks/tubeman.safetensors"));
    sherf_train_options o = options_for(path_of("masks_run"), 5);
    o.data = spec, o.body = body, o.people = "0", o.batch = 1, o.targets = 1, o.seed = 3;
    for (int with = 0; with < 2; with++) {
        const char *says = with ? "covers the whole picture" : "is empty";
        fill_masks(c, 0, 1, true, with ? 255 : 0);
        assert_int_equal(sherf_train(c, &o), SHERF_BAD_ARGUMENT);
        assert_non_null(strstr(c->message, "mask_cihp/view00/000000.png: the mask "));
        assert_non_null(strstr(c->message, says));
        assert_false(path_is_folder(path_of("masks_run")));
        fill_masks(c, 0, 1, false, 0);

        fill_masks(c, 1, VIEWS, true, with ? 255 : 0);
        assert_int_equal(sherf_train(c, &o), SHERF_BAD_ARGUMENT);
        assert_non_null(strstr(c->message, "/000001.png: the mask "));
        assert_non_null(strstr(c->message, says));
        assert_true(path_is_file(path_of("masks_run/checkpoint.safetensors")));
        assert_true(logged(c, path_of("masks_run"), 1, "step") == 1);
        fill_masks(c, 1, VIEWS, false, 0);
        assert_ok(c, sherf_train(c, &o));
        o.output = path_of("masks_whole");
        assert_ok(c, sherf_train(c, &o));
        assert_true(difference(c, path_of("masks_run/checkpoint.safetensors"),
                               path_of("masks_whole/checkpoint.safetensors")) == 0);
        o.output = path_of("masks_run");
        folder_remove(path_of("masks_run"));
    }
    assert_int_equal(mem_live(), live);
    sherf_context_free(c);
}

/* ---- several processes ---- */

static void processes_equal_one(void **state) {
    char command[16384];
    if (system("command -v mpirun >/dev/null 2>&1")) skip();
    context *c = float_context(1);
    sherf_train_options o = options_for(path_of("one"), 3);
    assert_ok(c, sherf_train(c, &o));
    const int counts[] = {2, 3};
    /* Open MPI keeps memory of plugins that it has unloaded, and no suppression can name it; our own leaks
     * are counted by mem_live above. */
    for (size_t i = 0; i < COUNT_OF(counts); i++) {
        char name[32];
        snprintf(name, sizeof name, "ranks%d", counts[i]);
        snprintf(command, sizeof command,
                 "ASAN_OPTIONS=detect_leaks=0 mpirun --allow-run-as-root --oversubscribe -n %d '%s' --rank "
                 "'%s' '%s' >'%s.txt' 2>&1",
                 counts[i], program, root, path_of(name), path_of(name));
        int rc = system(command);
        if (rc != 0) fail_msg("%s: %d", command, rc);
        char a[64];
        snprintf(a, sizeof a, "%s/model.safetensors", name);
        double off = difference(c, path_of("one/model.safetensors"), path_of(a));
        print_message("%d processes against one: %.2g of the largest weight\n", counts[i], off);
        assert_true(off <= 1e-5);
        for (int k = 1; k <= 3; k++) {
            double want = logged(c, path_of("one"), k, "loss");
            assert_true(fabs(logged(c, path_of(name), k, "loss") / want - 1) < 1e-5);
        }
    }
    sherf_context_free(c);
}

static int run_rank(const char *data, const char *output) {
    context *c = float_context(1);
    snprintf(root, sizeof root, "%s", data);
    sherf_train_options o = options_for(output, 3);
    sherf_status status = sherf_train(c, &o);
    if (status != SHERF_OK) fprintf(stderr, "%s\n", c->message);
    sherf_context_free(c);
    return status != SHERF_OK;
}

int main(int argc, char **argv) {
    if (argc == 4 && !strcmp(argv[1], "--rank")) return run_rank(argv[2], argv[3]);
    ssize_t n = readlink("/proc/self/exe", program, sizeof program - 1);
    program[n > 0 ? n : 0] = 0;
    const struct CMUnitTest tests[] = {cmocka_unit_test(learns_and_writes),
                                       cmocka_unit_test(resuming_gives_the_same_bits),
                                       cmocka_unit_test(a_training_starts_from_weights),
                                       cmocka_unit_test(cancelling_saves),
                                       cmocka_unit_test(losses_and_beta2_are_kept),
                                       cmocka_unit_test(the_first_end_counts),
                                       cmocka_unit_test(as_the_release_trains),
                                       cmocka_unit_test(a_bad_checkpoint_is_one_line),
                                       cmocka_unit_test(a_damaged_checkpoint_gives_way_to_the_one_before),
                                       cmocka_unit_test(two_trainings_in_one_folder_are_refused),
                                       cmocka_unit_test(broken_data_is_one_line),
                                       cmocka_unit_test(an_empty_or_full_mask_ends_it),
                                       cmocka_unit_test(processes_equal_one)};
    return cmocka_run_group_tests(tests, make_data, NULL);
}
