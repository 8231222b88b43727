/* Shared by the tests of the models next to SHERF (rival.h). */
#include "rival.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "data/data.h"

static char root[512];

int rival_data(void **state) {
    context *c = test_context();
    const sherf_synth_options synth = {
        .people = 2, .poses = 2, .views = 4, .size_px = 32, .seed = 5, .surfaces = 1};
    snprintf(root, sizeof root, "%s", test_path("people"));
    sherf_status status = sherf_synth_tube(c, root, &synth);
    sherf_context_free(c);
    return status != SHERF_OK;
}

const char *rival_file(const char *name) {
    static char path[4][700];
    static int next;
    next = (next + 1) % 4;
    snprintf(path[next], sizeof path[next], "%s/%s", root, name);
    return path[next];
}

void rival_observation(context *c, int pose, int view, sherf_body **body, sherf_observation **o) {
    char picture[700];
    snprintf(picture, sizeof picture, "thuman:%s#tube_000/%d/%d", root, pose, view);
    if (body) assert_ok(c, sherf_body_load(c, rival_file("tubeman.safetensors"), body));
    assert_ok(c, sherf_observation_load(c, picture, o));
}

void rival_scene_open(context *c, const model_config *config, int pose, int rays, rival_scene *s) {
    sherf_observation *shown;
    *s = (rival_scene){0};
    rival_observation(c, 0, 0, &s->body, &s->observation);
    rival_observation(c, pose, 1, NULL, &shown);
    s->camera = *sherf_observation_camera(s->observation);
    assert_ok(c, observation_geometry_create(c, config, s->body, sherf_observation_image(s->observation),
                                             &s->camera, sherf_observation_pose(s->observation), true,
                                             &s->geometry));
    const ray_draw draw = {.count = rays, .inside = 0.7f, .mask = shown->mask, .key = 9};
    assert_ok(c, target_geometry_draw(c, config, s->body, sherf_observation_camera(shown),
                                      sherf_observation_pose(shown), s->geometry, &draw, &s->target));
    sherf_observation_free(shown);
}

void rival_scene_close(rival_scene *s) {
    target_geometry_free(s->target);
    observation_geometry_free(s->geometry);
    sherf_observation_free(s->observation);
    sherf_body_free(s->body);
}

void rival_box_middle(context *c, const rival_scene *s, double middle[3]) {
    float *v = malloc((size_t)s->body->vertices * 3 * sizeof *v);
    assert_ok(c, sherf_body_pose(c, s->body, sherf_observation_pose(s->observation), v, NULL));
    for (int k = 0; k < 3; k++) {
        double low = INFINITY, high = -INFINITY;
        for (int i = 0; i < s->body->vertices; i++) {
            low = fmin(low, v[3 * i + k]);
            high = fmax(high, v[3 * i + k]);
        }
        middle[k] = (low + high) / 2;
    }
    free(v);
}

double rival_direction(const ray_bundle *r, int ray, double d[3]) {
    for (int k = 0; k < 3; k++) d[k] = r->direction[3 * ray + k];
    return sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
}

/* ---- weights ---- */
void rival_shake(model *m) {
    for (int i = 0; i < m->weights->count; i++) {
        const parameter *q = m->weights->item[i];
        const int64_t n = tensor_count(&q->value);
        const double deviation = 0.3 / sqrt((double)n / (double)q->value.dim[0] + 1);
        for (int64_t k = 0; k < n && !q->buffer; k++)
            tensor_f32(&q->value)[k] += (float)(deviation * random_normal(fnv1a64(q->name), (uint64_t)k));
    }
}

void rival_weights_take(const model *m, rival_weights *w) {
    w->count = 0;
    for (int i = 0; i < m->weights->count; i++) {
        const parameter *q = m->weights->item[i];
        if (q->buffer) continue;
        assert_true(w->count < (int)COUNT_OF(w->item) && strlen(q->name) < sizeof w->item[0].name);
        strcpy(w->item[w->count].name, q->name);
        const int64_t n = w->item[w->count].floats = tensor_count(&q->value);
        w->item[w->count].rows = q->value.dim[0];
        double *v = w->item[w->count++].v = malloc((size_t)n * sizeof *v);
        for (int64_t k = 0; k < n; k++) v[k] = (double)tensor_f32(&q->value)[k];
    }
}

void rival_weights_free(rival_weights *w) {
    for (int i = 0; i < w->count; i++) free(w->item[i].v);
}

static int weight_at(const rival_weights *w, const char *name) {
    for (int i = 0; i < w->count; i++)
        if (!strcmp(w->item[i].name, name)) return i;
    fail_msg("no weight %s", name);
    return 0;
}

double *rival_weight(const rival_weights *w, const char *format, ...) {
    char name[160];
    va_list args;
    va_start(args, format);
    vsnprintf(name, sizeof name, format, args);
    va_end(args);
    return w->item[weight_at(w, name)].v;
}

/* ---- layers ---- */
rival_map rival_map_new(int height, int width, int channels) {
    rival_map map = {height, width, channels, calloc((size_t)(height * width * channels), sizeof *map.v)};
    return map;
}

rival_map rival_image(const sherf_observation *o, double factor, double offset) {
    const sherf_image *image = sherf_observation_image(o);
    rival_map map = rival_map_new(image->height, image->width, 3);
    for (int i = 0; i < map.height * map.width * 3; i++) map.v[i] = factor * (double)image->data[i] + offset;
    return map;
}

rival_map rival_map_copy(rival_map x) {
    rival_map map = rival_map_new(x.height, x.width, x.channels);
    memcpy(map.v, x.v, (size_t)(x.height * x.width * x.channels) * sizeof *map.v);
    return map;
}

/* Batch norm of one picture: mean and biased variance of each channel over its pixels. */
void rival_norm(const rival_weights *w, const char *name, rival_map x, bool relu) {
    const double *gain = rival_weight(w, "%s.weight", name), *bias = rival_weight(w, "%s.bias", name);
    const int n = x.height * x.width;
    for (int c = 0; c < x.channels; c++) {
        double mean = 0, variance = 0;
        for (int i = 0; i < n; i++) mean += x.v[i * x.channels + c] / n;
        for (int i = 0; i < n; i++) variance += pow(x.v[i * x.channels + c] - mean, 2) / n;
        for (int i = 0; i < n; i++) {
            double *v = &x.v[i * x.channels + c];
            *v = (*v - mean) / sqrt(variance + 1e-5) * gain[c] + bias[c];
            if (relu) *v = fmax(*v, 0);
        }
    }
}

rival_map rival_convolved(const rival_weights *w, rival_map x, const char *conv, int stride, int pad) {
    char name[128];
    snprintf(name, sizeof name, "%s.weight", conv);
    const int at = weight_at(w, name), out = (int)w->item[at].rows;
    const double *v = w->item[at].v;
    const int k = (int)lround(sqrt((double)w->item[at].floats / out / x.channels));
    rival_map y =
        rival_map_new((x.height + 2 * pad - k) / stride + 1, (x.width + 2 * pad - k) / stride + 1, out);
    for (int i = 0; i < y.height; i++)
        for (int j = 0; j < y.width; j++)
            for (int r = 0; r < k; r++)
                for (int s = 0; s < k; s++) {
                    const int a = i * stride + r - pad, b = j * stride + s - pad;
                    if (a < 0 || b < 0 || a >= x.height || b >= x.width) continue;
                    const double *from = x.v + (a * x.width + b) * x.channels;
                    double *to = y.v + (i * y.width + j) * out;
                    for (int o = 0; o < out; o++)
                        for (int c = 0; c < x.channels; c++)
                            to[o] += v[((o * x.channels + c) * k + r) * k + s] * from[c];
                }
    return y;
}

rival_map rival_conv_norm(const rival_weights *w, rival_map x, const char *conv, const char *name, int stride,
                          int pad, bool relu) {
    rival_map y = rival_convolved(w, x, conv, stride, pad);
    free(x.v);
    rival_norm(w, name, y, relu);
    return y;
}

rival_map rival_max_pool(rival_map x) {
    rival_map y = rival_map_new((x.height - 1) / 2 + 1, (x.width - 1) / 2 + 1, x.channels);
    for (int i = 0; i < y.height; i++)
        for (int j = 0; j < y.width; j++)
            for (int c = 0; c < x.channels; c++) {
                double max = -INFINITY;
                for (int a = 2 * i - 1; a < 2 * i + 2; a++)
                    for (int b = 2 * j - 1; b < 2 * j + 2; b++)
                        if (a >= 0 && b >= 0 && a < x.height && b < x.width)
                            max = fmax(max, x.v[(a * x.width + b) * x.channels + c]);
                y.v[(i * y.width + j) * y.channels + c] = max;
            }
    free(x.v);
    return y;
}

rival_map rival_resnet_stage(const rival_weights *w, rival_map x, const char *prefix, int stage, int blocks) {
    char block[96], conv[128], bn[128];
    for (int b = 0; b < blocks; b++) {
        const int stride = stage > 1 && !b ? 2 : 1;
        snprintf(block, sizeof block, "%s.layer%d.%d", prefix, stage, b);
        rival_map y = rival_map_copy(x);
        for (int k = 1; k <= 2; k++) {
            snprintf(conv, sizeof conv, "%s.conv%d", block, k);
            snprintf(bn, sizeof bn, "%s.bn%d", block, k);
            y = rival_conv_norm(w, y, conv, bn, k == 1 ? stride : 1, 1, k == 1);
        }
        if (stride == 2) {
            snprintf(conv, sizeof conv, "%s.downsample.0", block);
            snprintf(bn, sizeof bn, "%s.downsample.1", block);
            x = rival_conv_norm(w, x, conv, bn, 2, 0, false);
        }
        for (int i = 0; i < y.height * y.width * y.channels; i++) y.v[i] = fmax(y.v[i] + x.v[i], 0);
        free(x.v);
        x = y;
    }
    return x;
}

void rival_bilinear(rival_map map, double x, double y, double *out) {
    const int x0 = (int)floor(x), y0 = (int)floor(y);
    memset(out, 0, (size_t)map.channels * sizeof *out);
    for (int k = 0; k < 4; k++) {
        const int a = y0 + k / 2, b = x0 + k % 2;
        const double share = (k / 2 ? y - y0 : 1 - (y - y0)) * (k % 2 ? x - x0 : 1 - (x - x0));
        if (a < 0 || b < 0 || a >= map.height || b >= map.width) continue;
        for (int c = 0; c < map.channels; c++)
            out[c] += share * map.v[(a * map.width + b) * map.channels + c];
    }
}

rival_map rival_side_by_side(int count, rival_map *stage) {
    const int h = stage[0].height, w = stage[0].width;
    int channels = 0;
    for (int i = 0; i < count; i++) channels += stage[i].channels;
    rival_map all = rival_map_new(h, w, channels);
    for (int i = 0, at = 0; i < count; at += stage[i++].channels)
        for (int y = 0; y < h; y++)
            for (int x = 0; x < w; x++)
                rival_bilinear(stage[i], x * (stage[i].width - 1.0) / (w - 1),
                               y * (stage[i].height - 1.0) / (h - 1), all.v + (y * w + x) * channels + at);
    for (int i = 0; i < count; i++) free(stage[i].v);
    return all;
}

void rival_linear(const rival_weights *w, const char *name, int in, const double *x, int out, double *y) {
    const double *weight = rival_weight(w, "%s.weight", name), *bias = rival_weight(w, "%s.bias", name);
    for (int o = 0; o < out; o++) {
        y[o] = bias[o];
        for (int i = 0; i < in; i++) y[o] += weight[o * in + i] * x[i];
    }
}

void rival_composite(int count, const double *sigma, const double *rgb, const double *way, double length,
                     double *weight, double out[4]) {
    double light = 1;
    memset(out, 0, 4 * sizeof *out);
    for (int i = 0; i < count; i++) {
        const double alpha = 1 - exp(-fmax(sigma[i], 0) * way[i] * length);
        weight[i] = alpha * light;
        light *= 1 - alpha + 1e-10;
        for (int k = 0; k < 3; k++) out[k] += weight[i] * rgb[3 * i + k];
        out[3] += weight[i];
    }
}

int rival_ascending(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

void rival_frame_agrees(tape *t, tensor *frame, int rays, const int *ray, double want[][4], double mix[][4],
                        double tolerance) {
    float *grad = tensor_f32(tape_grad(t, frame));
    double opaque = 0;
    for (int n = 0; n < rays; n++) {
        for (int k = 0; k < 4; k++) {
            const double got = (double)tensor_f32(frame)[5 * ray[n] + k];
            if (!(fabs(got - want[n][k]) <= tolerance)) fail_msg("ray %d: %g, not %g", n, got, want[n][k]);
            grad[5 * ray[n] + k] = (float)mix[n][k];
        }
        opaque += want[n][3] / rays;
    }
    if (!(opaque > 0.2 && opaque < 0.98)) fail_msg("opacity %g", opaque);
}

void rival_gradients_agree(const model *m, rival_weights *w, int each, double tolerance,
                           double (*f)(void *self, const void *arg), void *self, const void *arg) {
    const double step = 1e-6; /* larger steps cross kinks of ReLUs */
    double worst = 0;
    for (int i = 0; i < w->count; i++) {
        const parameter *q = parameter_find(m->weights, w->item[i].name);
        const float *grad = tensor_f32(&q->grad);
        double largest = 0;
        for (int64_t k = 0; k < w->item[i].floats; k++) largest = fmax(largest, fabs((double)grad[k]));
        if (!(largest > 0)) fail_msg("%s has no gradient", q->name);
        for (int n = 0; n < each; n++) {
            const int64_t k = random_below(fnv1a64(q->name), (uint64_t)n, w->item[i].floats);
            const double kept = w->item[i].v[k];
            w->item[i].v[k] = kept + step;
            const double above = f(self, arg);
            w->item[i].v[k] = kept - step;
            const double difference = (above - f(self, arg)) / (2 * step);
            w->item[i].v[k] = kept;
            const double error = fabs((double)grad[k] - difference) / largest;
            worst = fmax(worst, error);
            if (!(error <= tolerance))
                fail_msg("%s[%d]: %.9g, not %.9g (largest %.3g)", q->name, (int)k, (double)grad[k],
                         difference, largest);
        }
    }
    print_message("gradients of %d tensors: at most %.2g of the largest apart\n", w->count, worst);
}

/* ---- use ---- */
void rival_use(const char *preset) {
    context *c = test_context();
    sherf_model *m;
    sherf_body *body;
    sherf_observation *o;
    sherf_avatar *a;
    sherf_frame frame[3] = {0};
    const sherf_render_options exact = {
        .exact = 1, .detail = SHERF_DETAIL_OFF, .background = {0.5f, 0.25f, 1}};
    const sherf_render_options usual = {0};
    assert_ok(c, sherf_model_create(c, preset, 3, &m));
    rival_observation(c, 0, 0, &body, &o);
    const sherf_camera *camera = sherf_observation_camera(o);
    const sherf_pose *pose = sherf_observation_pose(o);
    const size_t n = (size_t)camera->width_px * (size_t)camera->height_px;
    assert_ok(c, sherf_avatar_create(c, m, body, o, &a));
    assert_ok(c, sherf_render(c, a, body, pose, camera, &exact, &frame[0]));
    assert_ok(c, sherf_render(c, a, body, pose, camera, &usual, &frame[1]));
    assert_ok(c, sherf_avatar_save(c, a, rival_file("avatar.safetensors")));
    sherf_avatar_free(a);
    assert_ok(c, sherf_avatar_load(c, rival_file("avatar.safetensors"), body, &a));
    assert_ok(c, sherf_render(c, a, body, pose, camera, &exact, &frame[2]));
    double sum = 0, corner = 0;
    for (size_t i = 0; i < n; i++) sum += (double)frame[0].opacity.data[i];
    for (int k = 0; k < 3; k++) corner += fabs((double)(frame[0].color.data[k] - exact.background[k]));
    if (!(frame[0].points > 100 && sum > (double)n / 200 && frame[1].points > 0 && corner == 0))
        fail_msg("%lld points, opacity %g, corner off by %g", (long long)frame[0].points, sum, corner);
    assert_memory_equal(frame[0].color.data, frame[2].color.data, 3 * n * sizeof(float));
    for (int i = 0; i < 3; i++) sherf_frame_free(&frame[i]);
    sherf_avatar_free(a);
    sherf_observation_free(o);
    sherf_body_free(body);
    sherf_model_free(m);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

const char *rival_avatar(context *c, const char *preset, sherf_body **body) {
    sherf_model *m;
    sherf_observation *o;
    sherf_avatar *a;
    assert_ok(c, sherf_model_create(c, preset, 3, &m));
    rival_observation(c, 0, 0, body, &o);
    assert_ok(c, sherf_avatar_create(c, m, *body, o, &a));
    const char *path = rival_file("avatar.safetensors");
    assert_ok(c, sherf_avatar_save(c, a, path));
    sherf_avatar_free(a);
    sherf_observation_free(o);
    sherf_model_free(m);
    return path;
}

void rival_moves(const char *preset) {
    context *c = test_context();
    sherf_body *body;
    sherf_observation *other;
    sherf_avatar *a;
    sherf_frame frame[2] = {0};
    const sherf_render_options exact = {.exact = 1, .detail = SHERF_DETAIL_OFF};
    const char *path = rival_avatar(c, preset, &body);
    assert_ok(c, sherf_avatar_load(c, path, body, &a));
    rival_observation(c, 1, 0, NULL, &other);
    const sherf_camera *camera = sherf_observation_camera(other);
    assert_ok(c, sherf_render(c, a, body, sherf_avatar_pose(a), camera, &exact, &frame[0]));
    assert_ok(c, sherf_render(c, a, body, sherf_observation_pose(other), camera, &exact, &frame[1]));
    double apart = 0;
    for (int i = 0; i < camera->width_px * camera->height_px; i++)
        apart += fabs((double)(frame[0].opacity.data[i] - frame[1].opacity.data[i]));
    assert_true(frame[1].points > 100 && apart > 5);
    for (int i = 0; i < 2; i++) sherf_frame_free(&frame[i]);
    sherf_observation_free(other);
    sherf_avatar_free(a);
    sherf_body_free(body);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

void rival_no_memory(const char *preset) {
    context *c = test_context();
    sherf_body *body;
    sherf_observation *o;
    rival_observation(c, 0, 0, &body, &o);
    const sherf_render_options exact = {.exact = 1, .detail = SHERF_DETAIL_OFF};
    sherf_camera small = *sherf_observation_camera(o);
    camera_resize(&small, 8, 8);
    const size_t live = mem_live();
    bool done = false;
    for (long k = 0; !done; k++) {
        sherf_model *m = NULL;
        sherf_avatar *a = NULL;
        sherf_frame frame = {0};
        mem_fail_after(k);
        sherf_status status = sherf_model_create(c, preset, 3, &m);
        if (!status) status = sherf_avatar_create(c, m, body, o, &a);
        if (!status) status = sherf_render(c, a, body, sherf_observation_pose(o), &small, &exact, &frame);
        mem_fail_after(-1);
        done = !status;
        if (!done && status != SHERF_NO_MEMORY) fail_msg("allocation %ld: status %d", k, (int)status);
        sherf_frame_free(&frame);
        sherf_avatar_free(a);
        sherf_model_free(m);
        assert_int_equal(mem_live(), live);
        if (k > 5000) fail();
    }
    sherf_observation_free(o);
    sherf_body_free(body);
    sherf_context_free(c);
}

void rival_counts(int presets, const rival_count *known) {
    context *c = test_context();
    for (int i = 0; i < presets; i++) {
        sherf_model *m;
        assert_ok(c, sherf_model_create(c, known[i].preset, 1, &m));
        assert_int_equal(sherf_model_parameter_count(m), known[i].count);
        sherf_model_free(m);
    }
    sherf_context_free(c);
}

static void train(context *c, const char *preset, const char *folder, int steps) {
    static char data[700], body[700], output[700];
    snprintf(data, sizeof data, "thuman:%s", root);
    snprintf(body, sizeof body, "%s", rival_file("tubeman.safetensors"));
    snprintf(output, sizeof output, "%s", rival_file(folder));
    model_config config;
    assert_ok(c, model_config_parse(c, preset, &config));
    const sherf_train_options o = {.data = data,
                                   .people = "0-0",
                                   .body = body,
                                   .output = output,
                                   .preset = preset,
                                   .steps = steps,
                                   .batch = 1,
                                   .targets = config.kind->surfaces ? 1 : 2,
                                   .seed = 3,
                                   .learning_rate = 2e-3,
                                   .halve_every = 1000,
                                   .sample_every = 100000};
    assert_ok(c, sherf_train(c, &o));
}

void rival_losses(context *c, const char *preset, const char *folder, int steps, double *loss) {
    char path[800], line[1024];
    train(c, preset, folder, steps);
    snprintf(path, sizeof path, "%s/log.jsonl", rival_file(folder));
    FILE *f = fopen(path, "r");
    assert_non_null(f);
    int n = 0;
    for (const char *at; n < steps && fgets(line, sizeof line, f); n++) {
        assert_non_null(at = strstr(line, "\"loss\": "));
        loss[n] = atof(at + 8);
    }
    fclose(f);
    assert_int_equal(n, steps);
    snprintf(path, sizeof path, "%s/checkpoint.safetensors", rival_file(folder));
    remove(path); /* the next training starts anew */
}

void rival_trains(const char *preset, int steps, double factor) {
    enum { STEPS_MAX = 200 };
    context *c = test_context();
    double loss[STEPS_MAX], first = 0, last = 0;
    assert_true(steps <= STEPS_MAX);
    rival_losses(c, preset, "trained", steps, loss);
    for (int i = 0; i < steps / 10; i++) {
        first += loss[i];
        last += loss[steps - 1 - i];
    }
    print_message("%s: loss %g, then %g of it\n", preset, first / (steps / 10.0), last / first);
    if (!(last < factor * first)) fail_msg("the loss went to %g of what it was", last / first);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

void rival_goes_on(const char *preset) {
    context *c = test_context();
    sherf_model *m[2];
    train(c, preset, "once", 6);
    train(c, preset, "twice", 3);
    train(c, preset, "twice", 6);
    assert_ok(c, sherf_model_load(c, rival_file("once/model.safetensors"), &m[0]));
    assert_ok(c, sherf_model_load(c, rival_file("twice/model.safetensors"), &m[1]));
    assert_memory_equal(m[0]->weights->values, m[1]->weights->values,
                        (size_t)m[0]->weights->total_floats * sizeof(float));
    for (int i = 0; i < 2; i++) sherf_model_free(m[i]);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

void rival_is_scored(const char *preset, int novel_poses) {
    context *c = test_context();
    sherf_model *m;
    sherf_scores s;
    char data[700], model_path[700], body[700];
    snprintf(data, sizeof data, "thuman:%s", root);
    snprintf(body, sizeof body, "%s", rival_file("tubeman.safetensors"));
    snprintf(model_path, sizeof model_path, "%s", rival_file("scored.safetensors"));
    assert_ok(c, sherf_model_create(c, preset, 3, &m));
    assert_ok(c, sherf_model_save(c, m, model_path));
    sherf_model_free(m);
    const sherf_eval_options o = {.data = data,
                                  .people = "0-0",
                                  .body = body,
                                  .model = model_path,
                                  .observations = "0:0",
                                  .poses = "0,1",
                                  .views = "0,1,2"};
    assert_ok(c, sherf_eval(c, &o, &s));
    assert_int_equal(s.novel_view.count, 2);
    assert_int_equal(s.novel_pose.count, novel_poses);
    sherf_free(s.table);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}
