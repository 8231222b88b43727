/* Tests of training, avatars and evaluation on the emulated GPU (tests/support/cuda) through the API, against
 * the CPU's: the same losses and weights within float32's rounding, the same bits from run to run, one kind
 * of file for both devices, and one error line if the device's memory is too small. */
#include "support.h"

#include <stdio.h>

#ifdef HAVE_CUDA_EMULATED
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "base/device.h"
#include "base/path.h"
#include "io/safetensors.h"
#include "io/value.h"
#include "model/model.h"
#include "nn/resnet50.h"
#include "tube_training.h"

extern const backend backend_emulated;
extern int cuda_emulated_order;
extern size_t cuda_emulated_bytes;

static bool on_gpu;
static char program[4096]; /* this program, started again under mpirun */

static context *device_context(bool gpu) {
    context *c = test_context();
    if (gpu) c->device = SHERF_DEVICE_CUDA;
    return c;
}

static int make_data(void **state) {
    context *c = test_context();
    const sherf_synth_options synth = {.people = 2, .poses = 2, .views = 3, .size_px = 32, .seed = 5};
    const sherf_status status = tubes_make(c, &synth);
    sherf_context_free(c);
    return status != SHERF_OK;
}

static sherf_train_options options_for(const char *output, int64_t steps) {
    sherf_train_options o = tube_training(TINY ",samples=6", output, steps);
    o.batch = 3;
    return o;
}

static void train(bool gpu, const char *output, int64_t steps) {
    context *c = device_context(gpu);
    const size_t live = mem_live();
    sherf_train_options o = options_for(output, steps);
    assert_ok(c, sherf_train(c, &o));
    assert_int_equal(mem_live(), live);
    sherf_context_free(c);
}

/* |a - b| / |b| over all tensors of two files, and the largest of a single tensor whose name begins with
 * `prefix`. */
static double difference(context *c, const char *a, const char *b, const char *prefix, double *worst) {
    safetensors *x, *y;
    double all_size = 0, all_off = 0;
    *worst = 0;
    assert_ok(c, safetensors_read(c, a, &x));
    assert_ok(c, safetensors_read(c, b, &y));
    assert_int_equal(x->count, y->count);
    for (size_t i = 0; i < x->count; i++) {
        const safetensor *p = &x->tensor[i], *q = safetensors_find(y, p->name);
        assert_non_null(q);
        int64_t n = 1;
        for (int k = 0; k < p->rank; k++) n *= p->dim[k];
        double size = 0, off = 0;
        for (int64_t k = 0; k < n; k++) {
            const double u = ((const float *)p->data)[k], v = ((const float *)q->data)[k];
            size += v * v;
            off += (u - v) * (u - v);
        }
        all_size += size;
        all_off += off;
        if (off > 0 && !strncmp(p->name, prefix, strlen(prefix))) *worst = fmax(*worst, sqrt(off / size));
    }
    safetensors_free(x);
    safetensors_free(y);
    return all_off > 0 ? sqrt(all_off / all_size) : 0;
}

/* ---- training ---- */
enum { STEPS = 2 };

static void losses_agree(context *c, const char *a, const char *b, double bound) {
    static const char *const keys[] = {"loss", "color", "mask", "ssim"};
    for (int step = 1; step <= STEPS; step++)
        for (size_t k = 0; k < COUNT_OF(keys); k++) {
            const double x = logged(c, path_of(a), step, keys[k]), y = logged(c, path_of(b), step, keys[k]);
            if (!(fabs(x - y) <= bound * fabs(y)))
                fail_msg("step %d, %s: %.9g and %.9g", step, keys[k], x, y);
        }
}

/* Adam's first steps are as large for a gradient of rounding errors as for any other, so single weights may
 * differ. Its stored moments of the gradients may not. */
static void files_agree(context *c, const char *a, const char *b, double bound, double second_bound) {
    double second;
    const double off = difference(c, path_of(a), path_of(b), "second.", &second);
    print_message("%s and %s: %.2g, Adam's moments %.2g\n", a, b, off, second);
    assert_true(off <= bound && second <= second_bound);
}

static void training_follows_the_cpus(void **state) {
    context *c = test_context();
    train(false, path_of("cpu"), STEPS);
    train(true, path_of("gpu"), STEPS);
    losses_agree(c, "gpu", "cpu", 1e-3);
    files_agree(c, "gpu/checkpoint.safetensors", "cpu/checkpoint.safetensors", 1e-3, 1e-2);
    files_agree(c, "gpu/model.safetensors", "cpu/model.safetensors", 1e-3, 1e-2);
    sherf_context_free(c);
}

static void training_gives_the_same_bits(void **state) {
    context *c = test_context();
    cuda_emulated_order = 1; /* threads and blocks in the opposite order */
    train(true, path_of("again"), STEPS);
    cuda_emulated_order = 0;
    train(true, path_of("parts"), 1);
    train(true, path_of("parts"), STEPS);
    const char *const runs[] = {"again", "parts"};
    for (int k = 0; k < 2; k++) {
        char file[64];
        losses_agree(c, runs[k], "gpu", 0);
        snprintf(file, sizeof file, "%s/checkpoint.safetensors", runs[k]);
        files_agree(c, file, "gpu/checkpoint.safetensors", 0, 0);
    }
    sherf_context_free(c);
}

/* A checkpoint can be continued on the other device. */
static void devices_take_turns(void **state) {
    context *c = test_context();
    train(false, path_of("turns"), 1);
    train(true, path_of("turns"), STEPS);
    losses_agree(c, "turns", "cpu", 1e-3);
    files_agree(c, "turns/checkpoint.safetensors", "cpu/checkpoint.safetensors", 1e-3, 1e-2);
    sherf_context_free(c);
}

/* ---- avatars ---- */
static void avatar_make(bool gpu, const char *path) {
    context *c = device_context(gpu);
    const size_t live = mem_live();
    sherf_model *m;
    sherf_body *body;
    sherf_observation *o;
    sherf_avatar *a;
    char picture[600];
    snprintf(picture, sizeof picture, "thuman:%s#tube_000/0/0", root);
    assert_ok(c, sherf_body_load(c, path_of("tubeman.safetensors"), &body));
    assert_ok(c, sherf_model_load(c, path_of("cpu/model.safetensors"), &m));
    assert_true((m->weights->memory != NULL) == gpu);
    assert_ok(c, sherf_observation_load(c, picture, &o));
    assert_ok(c, sherf_avatar_create(c, m, body, o, &a));
    assert_ok(c, sherf_avatar_save(c, a, path));
    assert_ok(c, sherf_model_save(c, m, path_of("copy.safetensors")));
    sherf_avatar_free(a);
    sherf_observation_free(o);
    sherf_model_free(m);
    sherf_body_free(body);
    assert_int_equal(mem_live(), live);
    sherf_context_free(c);
}

static void avatars_agree(void **state) {
    context *c = test_context();
    avatar_make(false, path_of("cpu.safetensors"));
    avatar_make(true, path_of("gpu.safetensors"));
    files_agree(c, "gpu.safetensors", "cpu.safetensors", 1e-5, 0);
    files_agree(c, "copy.safetensors", "cpu/model.safetensors", 0, 0);
    sherf_context_free(c);
}

/* ---- several processes, each with its GPU ---- */
static sherf_train_options options_for_ranks(const char *output) {
    sherf_train_options o = options_for(output, 1);
    o.batch = 4; /* each of two processes gets a whole branch of the sum */
    o.targets = 1;
    return o;
}

static int run_rank(const char *data, const char *output) {
    context *c = device_context(true);
    snprintf(root, sizeof root, "%s", data);
    sherf_train_options o = options_for_ranks(output);
    const sherf_status status = sherf_train(c, &o);
    if (status != SHERF_OK) fprintf(stderr, "%s\n", c->message);
    sherf_context_free(c);
    return status != SHERF_OK;
}

static void processes_equal_one(void **state) {
    char command[16384];
    if (on_gpu) skip(); /* there may be only one GPU */
    if (system("command -v mpirun >/dev/null 2>&1")) skip();
    context *c = device_context(true);
    sherf_train_options o = options_for_ranks(path_of("one"));
    assert_ok(c, sherf_train(c, &o));
    snprintf(
        command, sizeof command,
        "ASAN_OPTIONS=detect_leaks=0 mpirun --allow-run-as-root --oversubscribe -n 2 '%s' --rank '%s' '%s' "
        ">'%s.txt' 2>&1",
        program, root, path_of("two"), path_of("two"));
    const int rc = system(command);
    if (rc != 0) fail_msg("%s: %d", command, rc);
    files_agree(c, "two/checkpoint.safetensors", "one/checkpoint.safetensors", 0, 0);
    assert_true(logged(c, path_of("two"), 1, "loss") == logged(c, path_of("one"), 1, "loss"));
    sherf_context_free(c);
}

/* ---- other networks, evaluation ---- */
static double distance(context *c, const float *a, const float *b, int side) {
    resnet50_network *n;
    tape *t = tape_create(c, (tape_options){.backend = backend_of(c)});
    assert_ok(c, resnet50_create(c, &n));
    for (int i = 0; i < RESNET50_CONVOLUTIONS; i++) {
        char name[16];
        snprintf(name, sizeof name, "w%d", i);
        const double count = (double)(tensor_count(n->weight[i]) / n->weight[i]->dim[0]);
        test_centred(name, tensor_count(n->weight[i]), sqrt(6 / count), n->weight[i]->data);
    }
    assert_ok(c, resnet50_place(c, n, tape_backend(t)->memory));
    const int64_t shape[3] = {side, side, 3};
    const double d =
        tape_value(t, resnet50_distance(t, n, tape_input(t, a, 3, shape), tape_input(t, b, 3, shape)));
    resnet50_free(n);
    tape_free(t);
    return d;
}

static void networks_are_placed(void **state) {
    enum { SIDE = 16 };
    static float a[SIDE * SIDE * 3], b[SIDE * SIDE * 3];
    context *c = device_context(false), *gpu = device_context(true);
    test_centred("a", COUNT_OF(a), 0.5, a);
    test_centred("b", COUNT_OF(b), 0.5, b);
    const double want = distance(c, a, b, SIDE), got = distance(gpu, a, b, SIDE);
    assert_true(want > 0.01 && fabs(got - want) < 1e-4 * want);
    sherf_context_free(c);
    sherf_context_free(gpu);
}

static sherf_status evaluate(context *c, sherf_scores *scores) {
    char spec[600], body[600], weights[1100];
    snprintf(spec, sizeof spec, "thuman:%s", root);
    snprintf(body, sizeof body, "%s", path_of("tubeman.safetensors"));
    snprintf(weights, sizeof weights, "%s", path_of("cpu/model.safetensors"));
    const sherf_eval_options o = {.data = spec,
                                  .people = "0",
                                  .body = body,
                                  .model = weights,
                                  .observations = "0:0",
                                  .poses = "0",
                                  .views = "0,1"};
    return sherf_eval(c, &o, scores);
}

static void scores_agree(void **state) {
    sherf_scores scores[2];
    for (int gpu = 0; gpu < 2; gpu++) {
        context *c = device_context(gpu);
        assert_ok(c, evaluate(c, &scores[gpu]));
        sherf_free(scores[gpu].table);
        sherf_context_free(c);
    }
    assert_true(scores[0].novel_view.count == 1 && scores[1].novel_view.count == 1);
    assert_true(fabs(scores[1].novel_view.psnr - scores[0].novel_view.psnr) < 1e-3);
}

/* ---- too little memory ---- */
static void check_lack(context *c, const char *what, sherf_status status) {
    print_message("%s: %s\n", what, c->message);
    assert_int_equal(status, SHERF_NO_MEMORY);
    assert_non_null(strstr(c->message, "out of GPU memory: "));
    assert_non_null(strstr(c->message, " MB requested, "));
    assert_null(strchr(c->message, '\n'));
}

static void lack_of_memory_is_one_line(void **state) {
    if (on_gpu) skip(); /* enough memory */
    context *c = device_context(true);
    const size_t live = mem_live();
    sherf_model *m;
    sherf_scores scores;
    static const size_t limits[] = {100 << 10, 1 << 20, 3 << 20, 6 << 20};
    sherf_train_options o = options_for(path_of("lack"), 1);
    for (size_t i = 0; i < COUNT_OF(limits); i++) {
        cuda_emulated_bytes = limits[i];
        check_lack(c, "train", sherf_train(c, &o));
        assert_false(path_is_folder(path_of("lack")));
        assert_int_equal(mem_live(), live);
    }
    cuda_emulated_bytes = limits[0];
    check_lack(c, "model", sherf_model_load(c, path_of("cpu/model.safetensors"), &m));
    assert_null(m);
    cuda_emulated_bytes = limits[2];
    check_lack(c, "eval", evaluate(c, &scores));
    cuda_emulated_bytes = 0;
    assert_int_equal(mem_live(), live);
    sherf_context_free(c);
}

/* A model of one device in a context of another. */
static void devices_are_not_mixed(void **state) {
    context *c = device_context(false), *gpu = device_context(true);
    sherf_model *m;
    sherf_body *body;
    sherf_observation *o;
    sherf_avatar *a;
    char picture[600];
    snprintf(picture, sizeof picture, "thuman:%s#tube_000/0/0", root);
    assert_ok(c, sherf_body_load(c, path_of("tubeman.safetensors"), &body));
    assert_ok(c, sherf_model_load(gpu, path_of("cpu/model.safetensors"), &m));
    assert_ok(c, sherf_observation_load(c, picture, &o));
    assert_int_equal(sherf_avatar_create(c, m, body, o, &a), SHERF_MISMATCH);
    assert_non_null(strstr(c->message, "another device"));
    sherf_observation_free(o);
    sherf_model_free(m);
    sherf_body_free(body);
    sherf_context_free(c);
    sherf_context_free(gpu);
}

int main(int argc, char **argv) {
    char line[160];
    on_gpu = device_gpu_present(line, sizeof line);
    if (!on_gpu) backend_stand_in(&backend_emulated);
    printf("%s: %s\n", on_gpu ? "on a GPU" : "on no GPU", line);
    if (argc == 4 && !strcmp(argv[1], "--rank")) return run_rank(argv[2], argv[3]);
    const ssize_t n = readlink("/proc/self/exe", program, sizeof program - 1);
    program[n > 0 ? n : 0] = 0;
    const struct CMUnitTest tests[] = {cmocka_unit_test(training_follows_the_cpus),
                                       cmocka_unit_test(training_gives_the_same_bits),
                                       cmocka_unit_test(devices_take_turns),
                                       cmocka_unit_test(avatars_agree),
                                       cmocka_unit_test(scores_agree),
                                       cmocka_unit_test(networks_are_placed),
                                       cmocka_unit_test(lack_of_memory_is_one_line),
                                       cmocka_unit_test(devices_are_not_mixed),
                                       cmocka_unit_test(processes_equal_one)};
    if (argc == 2) cmocka_set_test_filter(argv[1]);
    return cmocka_run_group_tests(tests, make_data, NULL);
}
#else
int main(void) {
    puts("skipped: there was no C++ compiler for the emulated kernels");
    return 77;
}
#endif
