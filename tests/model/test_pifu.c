/* Tests of PIFu's networks: their sizes, and values and gradients against a second implementation in double,
 * written from docs/rivals.md with plain loops. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model/pifu/pifu.h"
#include "rival.h"

enum { SIDE = 32, POINTS = 24, STACKS = 2 };
static const pifu_sizes tiny = {STACKS, 16, 4, {12, 8}};

/* ---- sizes ---- */
static int64_t count_of(const parameters *p, const char *begins) {
    int64_t n = 0;
    for (int i = 0; i < p->count; i++)
        if (!p->item[i]->buffer && !strncmp(p->item[i]->name, begins, strlen(begins)))
            n += tensor_count(&p->item[i]->value);
    return n;
}

/* The numbers in docs/rivals.md. Its count of the filter includes norms that the authors declare in blocks as
 * wide as their input but never use: 16,640 weights. */
static void as_many_weights(void **state) {
    context *c = test_context();
    declaration d = {c, parameters_create(c), false};
    static pifu_network n;
    pifu_declare(&d, &pifu_paper, &n);
    assert_false(d.failed);
    assert_int_equal(count_of(d.p, "filter."), 14420864 - 16640);
    assert_int_equal(count_of(d.p, "occupancy."), 1183874);
    assert_int_equal(count_of(d.p, "color."), 9139398);
    parameters_free(d.p);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* ---- in double ---- */
typedef struct {
    const rival_weights *w;
    double image[SIDE * SIDE * 3], uv[2 * POINTS], z[POINTS], label[POINTS], color[3 * POINTS];
    double occupancy[STACKS][POINTS], painted[3 * POINTS];
} second;

/* Valid until sixteen more are made. */
static const char *named(const char *name, const char *part) {
    enum { KEPT = 16 };
    static char text[KEPT][128];
    static int next;
    next = (next + 1) % KEPT;
    snprintf(text[next], sizeof text[next], "%s.%s", name, part);
    return text[next];
}

static rival_map of_image(const second *s) {
    rival_map map = rival_map_new(SIDE, SIDE, 3);
    memcpy(map.v, s->image, sizeof s->image);
    return map;
}

/* Returns conv(relu(norm(x))); does not free x. */
static rival_map norm_conv(const second *s, rival_map x, const char *norm, const char *conv, int pad) {
    rival_map y = rival_map_copy(x);
    rival_norm(s->w, norm, y, true);
    rival_map z = rival_convolved(s->w, y, conv, 1, pad);
    free(y.v);
    return z;
}

/* Frees x. */
static rival_map block(const second *s, const char *name, rival_map x, bool widens) {
    static const char *const norm[] = {"bn1", "bn2", "bn3"}, *const conv[] = {"conv1", "conv2", "conv3"};
    rival_map part[3], y = x;
    for (int i = 0; i < 3; i++) y = part[i] = norm_conv(s, y, named(name, norm[i]), named(name, conv[i]), 1);
    rival_map out =
        widens ? norm_conv(s, x, named(name, "bn4"), named(name, "downsample"), 0) : rival_map_copy(x);
    for (int i = 0; i < x.height * x.width; i++) {
        double *to = out.v + i * out.channels;
        for (int k = 0; k < 3; k++)
            for (int c = 0; c < part[k].channels; c++) *to++ += part[k].v[i * part[k].channels + c];
    }
    for (int k = 0; k < 3; k++) free(part[k].v);
    free(x.v);
    return out;
}

static rival_map half(rival_map x) {
    rival_map y = rival_map_new(x.height / 2, x.width / 2, x.channels);
    for (int i = 0; i < y.height; i++)
        for (int j = 0; j < y.width; j++)
            for (int c = 0; c < x.channels; c++)
                for (int k = 0; k < 4; k++)
                    y.v[(i * y.width + j) * x.channels + c] +=
                        x.v[((2 * i + k / 2) * x.width + 2 * j + k % 2) * x.channels + c] / 4;
    return y;
}

/* Adds x, resized with aligned corners; frees x. */
static void add_resized(rival_map to, rival_map x) {
    double *v = malloc((size_t)x.channels * sizeof *v);
    for (int i = 0; i < to.height; i++)
        for (int j = 0; j < to.width; j++) {
            rival_bilinear(x, j * (x.width - 1.0) / (to.width - 1), i * (x.height - 1.0) / (to.height - 1),
                           v);
            for (int c = 0; c < x.channels; c++) to.v[(i * to.width + j) * x.channels + c] += v[c];
        }
    free(v);
    free(x.v);
}

static rival_map two_levels(const second *s, const char *name, rival_map x) {
    char b[7][128];
    for (int i = 0; i < 7; i++) snprintf(b[i], sizeof b[i], "%s.hourglass.%d", name, i);
    rival_map outer = block(s, b[0], rival_map_copy(x), false);
    rival_map low = block(s, b[1], half(x), false);
    rival_map inner = block(s, b[3], rival_map_copy(low), false);
    rival_map lowest = block(s, b[6], block(s, b[5], block(s, b[4], half(low), false), false), false);
    free(low.v);
    add_resized(inner, lowest);
    add_resized(outer, block(s, b[2], inner, false));
    free(x.v);
    return outer;
}

/* 1 x 1 convolution with bias; does not free x. */
static rival_map mix(const second *s, const char *name, rival_map x) {
    rival_map y = rival_convolved(s->w, x, name, 1, 0);
    const double *bias = rival_weight(s->w, "%s.bias", name);
    for (int i = 0; i < y.height * y.width * y.channels; i++) y.v[i] += bias[i % y.channels];
    return y;
}

static void add_to(rival_map to, rival_map x) {
    for (int i = 0; i < to.height * to.width * to.channels; i++) to.v[i] += x.v[i];
    free(x.v);
}

static void geometry_maps(const second *s, rival_map out[STACKS]) {
    rival_map image = of_image(s), x = rival_convolved(s->w, image, "filter.stem", 2, 3);
    const double *bias = rival_weight(s->w, "filter.stem.bias");
    for (int i = 0; i < x.height * x.width * x.channels; i++) x.v[i] += bias[i % x.channels];
    rival_norm(s->w, "filter.stem.norm", x, true);
    free(image.v);
    x = block(s, "filter.block0", x, true);
    rival_map small = half(x);
    free(x.v);
    x = block(s, "filter.block2", block(s, "filter.block1", small, false), true);
    for (int i = 0; i < STACKS; i++) {
        const char *const name = i ? "filter.stack1" : "filter.stack0";
        rival_map deep = two_levels(s, name, rival_map_copy(x)),
                  y = block(s, named(name, "top"), deep, false);
        rival_map mixed = mix(s, named(name, "mix"), y);
        free(y.v);
        rival_norm(s->w, named(name, "norm"), mixed, true);
        out[i] = mix(s, named(name, "out"), mixed);
        if (i < STACKS - 1) {
            add_to(x, mix(s, named(name, "features_back"), mixed));
            add_to(x, mix(s, named(name, "out_back"), out[i]));
        }
        free(mixed.v);
    }
    free(x.v);
}

/* Frees x. */
static rival_map mirrored(rival_map x, int pad) {
    rival_map y = rival_map_new(x.height + 2 * pad, x.width + 2 * pad, x.channels);
    for (int i = 0; i < y.height; i++)
        for (int j = 0; j < y.width; j++) {
            int a = abs(i - pad), b = abs(j - pad);
            if (a > x.height - 1) a = 2 * (x.height - 1) - a;
            if (b > x.width - 1) b = 2 * (x.width - 1) - b;
            memcpy(y.v + (i * y.width + j) * x.channels, x.v + (a * x.width + b) * x.channels,
                   (size_t)x.channels * sizeof *y.v);
        }
    free(x.v);
    return y;
}

static rival_map color_map(const second *s) {
    rival_map x =
        rival_conv_norm(s->w, mirrored(of_image(s), 3), "color.filter.0", "color.filter.0.norm", 1, 0, true);
    x = rival_conv_norm(s->w, x, "color.filter.1", "color.filter.1.norm", 2, 1, true);
    x = rival_conv_norm(s->w, x, "color.filter.2", "color.filter.2.norm", 2, 1, true);
    for (int b = 0; b < PIFU_BLOCKS; b++) {
        char conv[2][64], norm[2][64];
        for (int i = 0; i < 2; i++) {
            snprintf(conv[i], sizeof conv[i], "color.block%d.%d", b, i);
            snprintf(norm[i], sizeof norm[i], "color.block%d.%d.norm", b, i);
        }
        rival_map y =
            mirrored(rival_conv_norm(s->w, mirrored(rival_map_copy(x), 1), conv[0], norm[0], 1, 0, true), 1);
        if (b < PIFU_BLOCKS - 1) {
            y = rival_conv_norm(s->w, y, conv[1], norm[1], 1, 0, false);
        } else {
            rival_map last = rival_convolved(s->w, y, conv[1], 1, 0);
            free(y.v);
            y = last;
        }
        add_to(x, y);
    }
    return x;
}

/* Every layer but the first gets the input again. */
static void point_network(const second *s, const char *name, int in, const double *x, int out, double *y) {
    double both[128], next[64];
    int before = 0;
    for (int layer = 0; layer <= 2; layer++) {
        const int width = layer == 2 ? out : tiny.hidden[layer];
        char full[64];
        for (int i = 0; i < in; i++) both[before + i] = x[i];
        snprintf(full, sizeof full, "%s.%d", name, layer);
        rival_linear(s->w, full, before + in, both, width, next);
        for (int i = 0; i < width; i++)
            if (layer == 2)
                y[i] = next[i];
            else
                both[i] = next[i] > 0 ? next[i] : 0.01 * next[i];
        before = width;
    }
}

static void read_at(const second *s, int p, rival_map map, double *out) {
    rival_bilinear(map, (s->uv[2 * p] + 1) / 2 * (map.width - 1),
                   (s->uv[2 * p + 1] + 1) / 2 * (map.height - 1), out);
}

static void second_run(second *s) {
    rival_map map[STACKS], colors = color_map(s);
    geometry_maps(s, map);
    for (int p = 0; p < POINTS; p++) {
        double x[64], y[3];
        for (int i = 0; i < STACKS; i++) {
            read_at(s, p, map[i], x);
            x[tiny.width] = s->z[p];
            point_network(s, "occupancy", tiny.width + 1, x, 1, y);
            s->occupancy[i][p] = 1 / (1 + exp(-y[0]));
        }
        read_at(s, p, map[STACKS - 1], x);
        read_at(s, p, colors, x + tiny.width);
        x[2 * tiny.width] = s->z[p];
        point_network(s, "color.points", 2 * tiny.width + 1, x, 3, y);
        for (int k = 0; k < 3; k++) s->painted[3 * p + k] = tanh(y[k]);
    }
    for (int i = 0; i < STACKS; i++) free(map[i].v);
    free(colors.v);
}

/* The mean over stacks of the mean of (occupancy - label)^2 and the mean of (colour - truth)^2. */
static double second_loss(void *self, const void *arg) {
    second *s = self;
    double sum = 0;
    second_run(s);
    for (int i = 0; i < STACKS; i++)
        for (int p = 0; p < POINTS; p++) sum += pow(s->occupancy[i][p] - s->label[p], 2) / POINTS / STACKS;
    for (int i = 0; i < 3 * POINTS; i++) sum += pow(s->painted[i] - s->color[i], 2) / (3 * POINTS);
    return sum;
}

/* ---- both implementations ---- */
typedef struct {
    float image[SIDE * SIDE * 3], uv[2 * POINTS], z[POINTS], label[POINTS], color[3 * POINTS];
} inputs;

static void draw(int n, float *out, double *same, const char *what, double low, double high) {
    for (int i = 0; i < n; i++) {
        out[i] = (float)(low + (high - low) * random_uniform(random_key(3, what, 0), (uint64_t)i));
        same[i] = (double)out[i];
    }
}

static void draw_all(inputs *in, second *s) {
    draw(SIDE * SIDE * 3, in->image, s->image, "image", -1, 1);
    draw(2 * POINTS, in->uv, s->uv, "uv", -0.98, 0.98);
    draw(POINTS, in->z, s->z, "z", -1, 1);
    draw(POINTS, in->label, s->label, "label", 0, 1);
    draw(3 * POINTS, in->color, s->color, "color", -1, 1);
}

static tensor *loss_of(tape *t, const pifu_network *n, const inputs *in, tensor *map[PIFU_STACKS],
                       tensor **painted, tensor *occupancy[STACKS]) {
    tensor *image = tape_input(t, in->image, 3, (int64_t[]){SIDE, SIDE, 3}),
           *z = tape_input(t, in->z, 2, (int64_t[]){POINTS, 1}),
           *label = tape_input(t, in->label, 2, (int64_t[]){POINTS, 1}),
           *color = tape_input(t, in->color, 2, (int64_t[]){POINTS, 3}), *sum = NULL;
    pifu_maps(t, n, image, map);
    for (int i = 0; i < STACKS; i++) {
        occupancy[i] = pifu_occupancy(t, n, map[i], in->uv, z, POINTS);
        tensor *term = op_scale(t, op_mean_square(t, occupancy[i], label, NULL), 1.0f / STACKS);
        sum = sum ? op_add(t, sum, term) : term;
    }
    *painted = pifu_color(t, n, map[STACKS - 1], pifu_color_map(t, n, image), in->uv, z, POINTS);
    return op_add(t, sum, op_mean_square(t, *painted, color, NULL));
}

/* The weights that a batch norm does not cancel. A bias before a norm, or one that reaches every norm as one
 * number per channel, has no effect. The values are w's. */
static void with_gradients(const rival_weights *w, rival_weights *out) {
    out->count = 0;
    for (int i = 0; i < w->count; i++) {
        const char *name = w->item[i].name;
        if (strcmp(name, "filter.stem.bias") && !strstr(name, ".mix.bias") && !strstr(name, "_back.bias"))
            out->item[out->count++] = w->item[i];
    }
    assert_int_equal(w->count - out->count, 1 + STACKS + 2);
}

static void values_and_gradients(void **state) {
    static inputs in;
    static second s;
    static rival_weights w, checked;
    static pifu_network n;
    context *c = test_context();
    declaration d = {c, parameters_create(c), false};
    pifu_declare(&d, &tiny, &n);
    model m = {.weights = d.p};
    assert_ok(c, parameters_lay_out(c, d.p));
    parameters_initialise(d.p, 8); /* a seed with which no ReLU is at its kink */
    rival_shake(&m);
    assert_ok(c, parameters_make_grads(c, d.p));
    rival_weights_take(&m, &w);
    s.w = &w;
    draw_all(&in, &s);
    tensor *map[PIFU_STACKS], *painted, *occupancy[STACKS];
    tape *t = tape_create(c, (tape_options){.backend = backend_of(c), .record = true, .training = true});
    tensor *loss = loss_of(t, &n, &in, map, &painted, occupancy);
    assert_ok(c, tape_status(t));
    assert_int_equal(map[0]->dim[0], SIDE / 4);
    assert_int_equal(map[0]->dim[2], tiny.width);
    const double want = second_loss(&s, NULL), low = 1e-3;
    double worst = 0, spread = 0;
    for (int i = 0; i < STACKS; i++)
        for (int p = 0; p < POINTS; p++) {
            worst = fmax(worst, fabs((double)tensor_f32(occupancy[i])[p] - s.occupancy[i][p]));
            spread = fmax(spread, fabs(s.occupancy[i][p] - s.occupancy[i][0]));
        }
    for (int i = 0; i < 3 * POINTS; i++)
        worst = fmax(worst, fabs((double)tensor_f32(painted)[i] - s.painted[i]));
    print_message("values at most %.2g apart, occupancies spread over %.2g\n", worst, spread);
    assert_true(worst < 2e-5 && spread > low && fabs(tape_value(t, loss) - want) < 1e-5);
    assert_ok(c, tape_backward(t, loss, 1));
    with_gradients(&w, &checked);
    rival_gradients_agree(&m, &checked, 1, 1e-4, second_loss, &s, NULL);
    rival_weights_free(&w);
    tape_free(t);
    parameters_free(d.p);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* From the declaration to the loss, with memory running out at each allocation in turn. */
static void memory_runs_out(void **state) {
    static inputs in;
    static second s;
    static pifu_network n;
    draw_all(&in, &s);
    for (int64_t left = 0;; left += left < 8 ? 1 : 37) {
        context *c = test_context();
        mem_fail_after(left);
        declaration d = {c, parameters_create(c), false};
        tensor *map[PIFU_STACKS], *painted, *occupancy[STACKS];
        bool done = false;
        if (d.p) pifu_declare(&d, &tiny, &n);
        if (d.p && !d.failed && parameters_lay_out(c, d.p) == SHERF_OK) {
            tape *t = tape_create(c, (tape_options){.backend = backend_of(c), .training = true});
            if (t) loss_of(t, &n, &in, map, &painted, occupancy);
            done = t && tape_status(t) == SHERF_OK;
            tape_free(t);
        }
        mem_fail_after(-1);
        parameters_free(d.p);
        sherf_context_free(c);
        assert_int_equal(mem_live(), 0);
        if (done) break;
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(as_many_weights),
                                       cmocka_unit_test(values_and_gradients),
                                       cmocka_unit_test(memory_runs_out)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
