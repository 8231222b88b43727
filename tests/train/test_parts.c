/* Tests of the trainer's parts on their own: optimiser, schedule, average, order of pictures, sums of a step.
 */
#include <math.h>
#include <string.h>

#include "support.h"
#include "train/adam.h"
#include "train/draw.h"
#include "train/trainer.h"

static void adam_follows_its_equations(void **state) {
    enum { N = 40000 };
    static float x[N], g[N];
    static double want[N], v[N];
    context *c = test_context();
    adam a;
    assert_ok(c, adam_create(c, N, &a));
    test_centred("adam.x", N, 1, x);
    for (int i = 0; i < N; i++) want[i] = x[i];
    for (int t = 1; t <= 5; t++) {
        char name[32];
        snprintf(name, sizeof name, "adam.g%d", t);
        test_centred(name, N, pow(10, -t), g);
        g[7] = 0;
        assert_ok(c, adam_step(c, &a, x, g, 2e-3));
        for (int i = 0; i < N; i++) {
            v[i] = 0.99 * v[i] + 0.01 * (double)g[i] * g[i];
            want[i] -= 2e-3 * g[i] / (sqrt(v[i] / (1 - pow(0.99, t))) + 1e-8);
        }
    }
    for (int i = 0; i < N; i++) assert_true(fabs(x[i] - want[i]) < 2e-6);
    double square = 0;
    for (int i = 0; i < N; i++) square += (double)g[i] * g[i];
    double got;
    assert_ok(c, gradients_square_sum(c, &a, g, &got));
    assert_true(fabs(got / square - 1) < 1e-12);
    for (int k = 0; k < 2; k++) {
        g[39999] = k ? NAN : INFINITY;
        assert_ok(c, gradients_square_sum(c, &a, g, &got));
        assert_false(isfinite(got));
    }
    adam_free(&a);
    sherf_context_free(c);
}

/* With a first moment, as the authors of other models train. */
static void momentum_follows_its_equations(void **state) {
    enum { N = 20000 };
    static float x[N], g[N];
    static double want[N], m[N], v[N];
    context *c = test_context();
    adam a;
    assert_ok(c, adam_create_with(c, N, 0.9, 0.999, &a));
    test_centred("momentum.x", N, 1, x);
    for (int i = 0; i < N; i++) want[i] = x[i];
    for (int t = 1; t <= 6; t++) {
        char name[32];
        snprintf(name, sizeof name, "momentum.g%d", t);
        test_centred(name, N, pow(10, -t / 2.0), g);
        assert_ok(c, adam_step(c, &a, x, g, 1e-3));
        for (int i = 0; i < N; i++) {
            m[i] = 0.9 * m[i] + 0.1 * (double)g[i];
            v[i] = 0.999 * v[i] + 0.001 * (double)g[i] * g[i];
            want[i] -= 1e-3 * m[i] / (1 - pow(0.9, t)) / (sqrt(v[i] / (1 - pow(0.999, t))) + 1e-8);
        }
    }
    for (int i = 0; i < N; i++) assert_true(fabs(x[i] - want[i]) < 2e-6);
    adam_free(&a);
    sherf_context_free(c);
}

static void schedule_and_average(void **state) {
    assert_true(schedule_rate(2e-3, 0, 10) == 2e-3 && schedule_rate(2e-3, 9, 10) == 2e-3);
    assert_true(schedule_rate(2e-3, 10, 10) == 1e-3 && schedule_rate(2e-3, 39, 10) == 2.5e-4);
    assert_true(fabs(average_decay(20) - 0.5) < 1e-12); /* half-life of one step */
    assert_true(fabs(pow(average_decay(1000000), 312.5) - 0.5) < 1e-9);
    context *c = test_context();
    float a[3] = {1, 2, 3}, x[3] = {3, 2, -1};
    assert_ok(c, average_update(c, NULL, 3, a, x, 0.75));
    assert_true(a[0] == 1.5f && a[1] == 2 && a[2] == 2);
    sherf_context_free(c);
}

static void permutations_are_permutations(void **state) {
    static bool seen[3000];
    const int64_t sizes[] = {1, 2, 3, 4, 5, 16, 17, 1000, 3000};
    for (size_t k = 0; k < COUNT_OF(sizes); k++) {
        int64_t moved = 0;
        memset(seen, 0, sizeof seen);
        for (int64_t i = 0; i < sizes[k]; i++) {
            int64_t p = permuted(42 + k, i, sizes[k]);
            assert_true(p >= 0 && p < sizes[k] && !seen[p]);
            seen[p] = true;
            moved += p != i;
        }
        if (sizes[k] >= 16) assert_true(moved > sizes[k] / 2);
    }
}

/* Two people, 3 and 2 poses on a grid of 5, 4 views. */
static sampling two_people(const data_protocol *front) {
    static int person[] = {4, 9}, poses[] = {3, 2}, views[] = {4, 4};
    static int64_t before[] = {0, 12, 20};
    return (sampling){.seed = 3,
                      .people = 2,
                      .person = person,
                      .poses = poses,
                      .views = views,
                      .before = before,
                      .pose_step = 5,
                      .targets = 3,
                      .front = front};
}

static void every_picture_once_an_epoch(void **state) {
    sampling s = two_people(NULL);
    int seen[2][3][4] = {0}, same_order = 0, observed[4] = {0}, other_pose = 0;
    for (int64_t i = 0; i < 40; i++) {
        draw d = sampling_draw(&s, i);
        assert_true(d.person == 4 || d.person == 9);
        assert_true(d.pose % 5 == 0 && d.view < 4 && d.observed_view < 4 && d.noise_key);
        seen[d.person == 9][d.pose / 5][d.view]++;
        assert_int_equal(d.further, 2);
        for (int k = 0; k < 2; k++) {
            assert_true(d.more[k].pose % 5 == 0 && d.more[k].pose / 5 < (d.person == 9 ? 2 : 3));
            assert_true(d.more[k].view >= 0 && d.more[k].view < 4);
            other_pose += d.more[k].pose != d.pose;
        }
        observed[d.observed_view]++;
        draw e = sampling_draw(&s, (i + 20) % 40);
        same_order += e.person == d.person && e.pose == d.pose && e.view == d.view;
        draw again = sampling_draw(&s, i);
        assert_true(again.person == d.person && again.pose == d.pose && again.view == d.view);
        assert_true(again.observed_view == d.observed_view && again.noise_key == d.noise_key);
        assert_memory_equal(again.more, d.more, sizeof d.more); /* no padding inside */
    }
    for (int p = 0; p < 2; p++)
        for (int q = 0; q < 3 - p; q++)
            for (int v = 0; v < 4; v++) assert_int_equal(seen[p][q][v], 2);
    assert_true(same_order < 12);
    assert_true(other_pose > 20);
    for (int v = 0; v < 4; v++) assert_true(observed[v] > 2);
    /* half way round, where people have 4 views as where they have 24 */
    static const data_protocol few = {.views = 4, .front_view = 2}, many = {.views = 24, .front_view = 12};
    sampling front = two_people(&few), front_of_many = two_people(&many);
    for (int64_t i = 0; i < 20; i++) {
        draw a = sampling_draw(&front, i), b = sampling_draw(&s, i);
        assert_true(a.observed_view == 2 && a.pose == b.pose && a.view == b.view);
        assert_int_equal(sampling_draw(&front_of_many, i).observed_view, 2);
    }
}

/* For a model that shows only the observed pose, targets are other views of it, as before. */
static void targets_can_keep_the_pose(void **state) {
    sampling any = two_people(NULL), one = any;
    one.one_pose = true;
    for (int64_t i = 0; i < 20; i++) {
        draw a = sampling_draw(&any, i), b = sampling_draw(&one, i);
        for (int k = 0; k < 2; k++) assert_true(b.more[k].pose == b.pose && b.more[k].view == a.more[k].view);
        assert_true(a.pose == b.pose && a.view == b.view && a.observed_view == b.observed_view);
    }
}

static void backgrounds_are_black_or_drawn(void **state) {
    sampling s = two_people(NULL), random = s;
    random.random_background = true;
    int black = 0, dark = 0, different = 0;
    for (int64_t i = 0; i < 100; i++) {
        draw plain = sampling_draw(&s, i), d = sampling_draw(&random, i), again = sampling_draw(&random, i);
        for (int k = 0; k < 3; k++) {
            assert_true(plain.background[k] == 0);
            assert_true(d.background[k] >= 0 && d.background[k] < 1 &&
                        d.background[k] == again.background[k]);
            black += d.background[k] == 0;
            dark += d.background[k] > 0 && d.background[k] < 0.5f;
        }
        different += d.background[0] != d.background[1];
        d.background[0] = d.background[1] = d.background[2] = 0; /* all other draws are unchanged */
        assert_true(d.person == plain.person && d.view == plain.view && d.noise_key == plain.noise_key);
        assert_memory_equal(d.more, plain.more, sizeof d.more);
    }
    assert_true(black > 45 && black < 105 && dark > 80 && dark < 150 && different > 80);
}

/* ---- sums of a step ---- */
static parameters *made_up_weights(context *c) {
    parameters *p = parameters_create(c);
    assert_non_null(p);
    assert_non_null(parameter_add(c, p, false, 2, (int64_t[]){5, 7}, "w"));
    assert_non_null(parameter_add(c, p, true, 1, (int64_t[]){6}, "s.running_mean"));
    assert_ok(c, parameters_lay_out(c, p));
    assert_ok(c, parameters_make_grads(c, p));
    for (int64_t i = 0; i < p->total_floats; i++) p->values[i] = (float)i / 7;
    return p;
}

/* What the samples [begin, end) of 8 add to gradients and statistics. The second of two targets is as good as
 * the first in even samples and missing in odd ones. */
static void run_share(context *c, parameters *p, int begin, int end, step_total *s) {
    assert_ok(c, total_create(c, p, 8, begin, end, 2, s));
    assert_ok(c, total_start(c, s));
    for (int i = begin; i < end; i++) {
        char name[32];
        float *g = p->grads, *b = p->values + p->trained_floats;
        snprintf(name, sizeof name, "total.%d", i);
        float add[64];
        test_centred(name, 48, pow(3, i % 4), add);
        for (int64_t k = 0; k < p->trained_floats; k++) g[k] += add[k % 48];
        for (int64_t k = 0; k < 6; k++) b[k] += 0.1f * (add[k] - b[k]);
        for (int k = 0; k < 2 - i % 2; k++) { /* SSIM is part of the total, so the stored value lacks its 1 */
            const float row[LOSSES] = {i == 3 ? 3 : (float)i - 1, 1, 2, i == 3 ? NAN : 0.5f, NAN, NAN};
            memcpy(total_rows(s, i) + k * LOSSES, row, sizeof row);
        }
        assert_ok(c, total_add(c, s, i));
    }
}

static void shares_add_up_to_the_same_bits(void **state) {
    context *c = test_context();
    const ranks alone = {.count = 1};
    loss_values mean;
    step_total whole, half[2];
    parameters *p = made_up_weights(c), *q[2] = {made_up_weights(c), made_up_weights(c)};
    run_share(c, p, 0, 8, &whole);
    assert_ok(c, total_finish(c, &whole, &alone, &mean));
    assert_true(mean.total == 3.5 && mean.ssim == 0.5 && isnan(mean.lpips));
    for (int k = 0; k < 2; k++) run_share(c, q[k], 4 * k, 4 * k + 4, &half[k]);
    const size_t row = (size_t)half[0].buffers;
    for (size_t i = 0; i < 8 * row; i++) { /* the effect of ranks_sum on the rows */
        const int k = i / row >= 4;
        assert_true(half[!k].statistics[i] == 0);
        half[0].statistics[i] += half[1].statistics[i];
    }
    for (int k = 0; k < 2; k++) assert_ok(c, total_finish(c, &half[k], &alone, &mean));
    for (int64_t i = 0; i < p->trained_floats; i++)
        assert_true(p->grads[i] == q[0]->grads[i] + q[1]->grads[i]);
    size_t bytes = (size_t)(p->total_floats - p->trained_floats) * sizeof(float);
    assert_memory_equal(p->values + p->trained_floats, q[0]->values + p->trained_floats, bytes);
    assert_ok(c, total_undo(c, &whole));
    for (int64_t i = 0; i < p->total_floats; i++) assert_true(p->values[i] == (float)i / 7);
    total_free(&whole);
    for (int k = 0; k < 2; k++) {
        total_free(&half[k]);
        parameters_free(q[k]);
    }
    parameters_free(p);
    sherf_context_free(c);
}

static void one_sample_is_the_plain_update(void **state) {
    context *c = test_context();
    const ranks alone = {.count = 1};
    loss_values mean;
    step_total s;
    parameters *p = made_up_weights(c);
    assert_ok(c, total_create(c, p, 1, 0, 1, 1, &s));
    assert_ok(c, total_start(c, &s));
    float moved[6];
    for (int k = 0; k < 6; k++) moved[k] = p->values[p->trained_floats + k] += 0.1f * (float)k / 3;
    memcpy(total_rows(&s, 0), (float[LOSSES]){0, 1, 1, 1, 1, NAN}, LOSSES * sizeof(float));
    assert_ok(c, total_add(c, &s, 0));
    assert_ok(c, total_finish(c, &s, &alone, &mean));
    assert_true(mean.total == 1 && mean.lpips == 1 && isnan(mean.resnet50));
    assert_memory_equal(p->values + p->trained_floats, moved, sizeof moved);
    total_free(&s);
    parameters_free(p);
    sherf_context_free(c);
}

/* ---- final gradients ---- */
enum { WATCHED = 4, WIDE = 3 };
typedef struct {
    parameters *p;
    float grads[WATCHED][WIDE * WIDE];
    int told[WATCHED], count;
} watch;

static void finished(void *user, tensor *which) {
    watch *w = user;
    for (int i = 0; i < WATCHED; i++) {
        tensor *one = &w->p->item[i]->value;
        if (which ? which != one : one->first_use != NULL || w->told[i]) continue;
        assert_int_equal(w->told[i], 0);
        w->told[i] = ++w->count;
        memcpy(w->grads[i], one->grad->data, sizeof w->grads[i]);
    }
}

typedef struct {
    tensor *y;
    tensor *weight;
} own_node;

static sherf_status own_backward(tape *t, void *payload) {
    own_node *n = payload;
    float *d = tensor_f32(tape_grad(t, n->weight));
    for (int i = 0; i < WIDE * WIDE; i++) d[i] += 1;
    return SHERF_OK;
}

/* Weights 0 and 1 of layers before a step of its own kind, which uses 3; weight 2 is before and after it, as
 * a view. */
static void gradients_are_told_when_final(void **state) {
    context *c = test_context();
    parameters *p = parameters_create(c);
    const int64_t square[2] = {WIDE, WIDE};
    for (int i = 0; i < WATCHED; i++) assert_non_null(parameter_add(c, p, false, 2, square, "w%d", i));
    assert_ok(c, parameters_lay_out(c, p));
    assert_ok(c, parameters_make_grads(c, p));
    test_centred("w", p->total_floats, 1, p->values);
    tape *t = tape_create(c, (tape_options){.backend = &backend_ref_f32, .record = true});
    for (int own = 0; own < 2; own++) {
        watch w = {.p = p};
        tensor *weight[WATCHED];
        float x[WIDE * WIDE];
        tape_reset(t);
        parameters_zero_grads(p);
        for (int i = 0; i < WATCHED; i++) weight[i] = &p->item[i]->value;
        test_centred("x", WIDE * WIDE, 1, x);
        tensor *y = tape_input(t, x, 2, square);
        y = op_linear(t, y, weight[0], NULL, 1, 1);
        y = op_linear(t, y, weight[2], NULL, 1, 1);
        y = op_linear(t, y, weight[1], NULL, 1, 1);
        own_node n = {y, weight[3]};
        if (own) tape_record(t, own_backward, &n);
        y = op_linear(t, y, tape_reshape(t, weight[2], 2, square), NULL, 1, 1);
        y = op_linear(t, y, weight[1], NULL, 1, 1);
        tape_on_final(t, finished, &w);
        assert_ok(c, tape_backward(t, op_mean_square(t, y, tape_input(t, x, 2, square), NULL), 1));
        for (int i = 0; i < WATCHED; i++) {
            assert_true(w.told[i] > 0);
            assert_memory_equal(w.grads[i], weight[i]->grad->data, sizeof w.grads[i]);
        }
        assert_true(w.told[3] < w.told[1] && w.told[1] < w.told[2] && w.told[2] < w.told[0]);
    }
    tape_free(t);
    parameters_free(p);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(adam_follows_its_equations),     cmocka_unit_test(momentum_follows_its_equations),
        cmocka_unit_test(schedule_and_average),           cmocka_unit_test(permutations_are_permutations),
        cmocka_unit_test(every_picture_once_an_epoch),    cmocka_unit_test(targets_can_keep_the_pose),
        cmocka_unit_test(backgrounds_are_black_or_drawn), cmocka_unit_test(shares_add_up_to_the_same_bits),
        cmocka_unit_test(one_sample_is_the_plain_update), cmocka_unit_test(gradients_are_told_when_final)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
