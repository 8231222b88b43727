/* PIFu's filters of the picture, and its networks of points. */
#include <stdio.h>
#include <string.h>

#include "model/pifu/pifu.h"

const pifu_sizes pifu_paper = {4, 256, 64, {1024, 512, 256, 128}};

static const double last_deviation = 0.02; /* of the layers before sigmoids */
static const float eps = 1e-5f, momentum = 0.1f, slope = 0.01f;

/* ---- layers ---- */
static tensor *weights(declaration *d, int64_t out, int64_t in, int64_t size, const char *name) {
    return declare_weights(d, true, DIMS(out, in, size, size), name);
}

static tensor *bias(declaration *d, int64_t out, const char *name) {
    return declare(d, (first_values){0}, DIMS(out), "%s.bias", name);
}

static batch_norm norm(declaration *d, const char *name, const char *part, int64_t channels) {
    char full[LAYER_NAME + 16];
    snprintf(full, sizeof full, "%s.%s", name, part);
    return batch_norm_declare(d, full, true, channels, eps, momentum);
}

static void block_declare(declaration *d, const char *name, int64_t out, int64_t in, pifu_block *b) {
    const int64_t width[4] = {in, out / 2, out / 4, out / 4};
    char full[LAYER_NAME + 16], part[16];
    for (int i = 0; i < 3; i++) {
        snprintf(part, sizeof part, "bn%d", i + 1);
        b->norm[i] = norm(d, name, part, width[i]);
        snprintf(full, sizeof full, "%s.conv%d", name, i + 1);
        b->conv[i] = weights(d, width[i + 1], width[i], 3, full);
    }
    if (in == out) return;
    b->way_norm = norm(d, name, "bn4", in);
    snprintf(full, sizeof full, "%s.downsample", name);
    b->way = weights(d, out, in, 1, full);
}

static pifu_mix mix_declare(declaration *d, const char *name, const char *part, int64_t width) {
    char full[LAYER_NAME + 16];
    snprintf(full, sizeof full, "%s.%s", name, part);
    return (pifu_mix){weights(d, width, width, 1, full), bias(d, width, full)};
}

static void stack_declare(declaration *d, int number, bool last, int64_t width, pifu_stack *s) {
    char name[LAYER_NAME], full[LAYER_NAME + 24];
    snprintf(name, sizeof name, "filter.stack%d", number);
    for (int i = 0; i < PIFU_HOURGLASS; i++) {
        snprintf(full, sizeof full, "%s.hourglass.%d", name, i);
        block_declare(d, full, width, width, &s->hourglass[i]);
    }
    snprintf(full, sizeof full, "%s.top", name);
    block_declare(d, full, width, width, &s->last);
    s->mix = mix_declare(d, name, "mix", width);
    s->norm = norm(d, name, "norm", width);
    s->out = mix_declare(d, name, "out", width);
    if (last) return;
    s->features_back = mix_declare(d, name, "features_back", width);
    s->out_back = mix_declare(d, name, "out_back", width);
}

/* in: a point's values, which every layer reads besides the layer before. */
static void points_declare(declaration *d, const char *name, const pifu_sizes *s, int64_t in, int64_t out,
                           pifu_points *p) {
    char full[LAYER_NAME + 16];
    int64_t before = 0;
    bool last = false;
    for (p->layers = 0; !last; p->layers++) {
        last = p->layers == PIFU_HIDDEN || !s->hidden[p->layers];
        const int64_t width = last ? out : s->hidden[p->layers];
        snprintf(full, sizeof full, "%s.%d", name, p->layers);
        if (last)
            p->layer[p->layers] = (linear_layer){declare(d, (first_values){.deviation = last_deviation},
                                                         DIMS(width, before + in), "%s.weight", full),
                                                 bias(d, width, full)};
        else
            p->layer[p->layers] = linear_declare(d, full, true, width, before + in);
        before = width;
    }
}

static void color_declare(declaration *d, const pifu_sizes *s, pifu_network *n) {
    const int64_t width[4] = {3, s->color_width, 2 * s->color_width, 4 * s->color_width};
    char name[LAYER_NAME], part[16];
    for (int i = 0; i < 3; i++) {
        snprintf(name, sizeof name, "color.filter.%d", i);
        n->color_conv[i] = weights(d, width[i + 1], width[i], i ? 3 : 7, name);
        n->color_norm[i] = norm(d, name, "norm", width[i + 1]);
    }
    for (int b = 0; b < PIFU_BLOCKS; b++)
        for (int i = 0; i < 2; i++) {
            snprintf(name, sizeof name, "color.block%d.%d", b, i);
            snprintf(part, sizeof part, "norm");
            n->residual[b].conv[i] = weights(d, width[3], width[3], 3, name);
            if (b < PIFU_BLOCKS - 1 || !i) n->residual[b].norm[i] = norm(d, name, part, width[3]);
        }
    points_declare(d, "color.points", s, s->width + width[3] + 1, 3, &n->color);
}

void pifu_declare(declaration *d, const pifu_sizes *s, pifu_network *n) {
    const int64_t width[4] = {s->width / 4, s->width / 2, s->width / 2, s->width};
    char name[LAYER_NAME];
    *n = (pifu_network){.sizes = *s};
    n->stem = weights(d, width[0], 3, 7, "filter.stem");
    n->stem_bias = bias(d, width[0], "filter.stem");
    n->stem_norm = norm(d, "filter.stem", "norm", width[0]);
    for (int i = 0; i < 3; i++) {
        snprintf(name, sizeof name, "filter.block%d", i);
        block_declare(d, name, width[i + 1], width[i], &n->block[i]);
    }
    for (int i = 0; i < s->stacks; i++) stack_declare(d, i, i == s->stacks - 1, s->width, &n->stack[i]);
    points_declare(d, "occupancy", s, s->width + 1, 1, &n->occupancy);
    color_declare(d, s, n);
}

/* ---- resampled maps ---- */
/* [height, width, C] of the map read at (x(j), y(i)), where the two axes are independent. */
static tensor *map_read(tape *t, tensor *map, int64_t height, int64_t width,
                        float (*at)(int64_t i, int64_t from, int64_t to)) {
    if (!map) return NULL;
    float *position = tape_alloc(t, (size_t)(height * width), 2 * sizeof *position);
    if (!position) return NULL;
    for (int64_t i = 0; i < height; i++)
        for (int64_t j = 0; j < width; j++) {
            position[2 * (i * width + j)] = at(j, map->dim[1], width);
            position[2 * (i * width + j) + 1] = at(i, map->dim[0], height);
        }
    tensor *x = op_sample_bilinear(t, map, tape_input(t, position, 2, (int64_t[]){height * width, 2}));
    return x ? tape_reshape(t, x, 3, (int64_t[]){height, width, map->dim[2]}) : NULL;
}

/* The mean of two by two pixels. */
static float at_half(int64_t i, int64_t from, int64_t to) {
    return 2 * (float)i + 0.5f;
}

static float at_corners(int64_t i, int64_t from, int64_t to) {
    return to > 1 ? (float)i * (float)(from - 1) / (float)(to - 1) : 0;
}

/* Borders mirrored at their pixels. */
static float at_mirrored(int64_t i, int64_t from, int64_t to) {
    int64_t k = i - (to - from) / 2;
    k = k < 0 ? -k : k;
    return (float)(k >= from ? 2 * from - 2 - k : k);
}

static tensor *halved(tape *t, tensor *x) {
    return x ? map_read(t, x, x->dim[0] / 2, x->dim[1] / 2, at_half) : NULL;
}

static tensor *mirrored_conv(tape *t, tensor *x, tensor *w, int64_t pad) {
    x = x ? map_read(t, x, x->dim[0] + 2 * pad, x->dim[1] + 2 * pad, at_mirrored) : NULL;
    return op_conv2d(t, x, w, 1, 0, 1);
}

/* ---- the geometry's filter ---- */
static tensor *block_forward(tape *t, const pifu_block *b, tensor *x) {
    tensor *part[3], *y = x;
    for (int i = 0; i < 3; i++)
        y = part[i] = op_conv2d(t, batch_norm_forward(t, &b->norm[i], y, true), b->conv[i], 1, 1, 1);
    tensor *way = x;
    if (b->way) way = op_conv2d(t, batch_norm_forward(t, &b->way_norm, x, true), b->way, 1, 0, 1);
    return op_add(t, op_concat(t, 3, part), way);
}

static tensor *mix_forward(tape *t, const pifu_mix *mix, tensor *x) {
    return op_bias_act(t, op_conv2d(t, x, mix->w, 1, 0, 1), mix->b, 1, 1, 0);
}

/* Two levels: the upper branch at this size, the lower one at half of it and back. blocks: of the outer level
 * upper, down, up; of the inner one upper, down, middle, up. */
static tensor *hourglass(tape *t, const pifu_block *block, int level, tensor *x) {
    const pifu_block *const inner = block + 3;
    tensor *upper = block_forward(t, &block[0], x);
    tensor *lower = block_forward(t, &block[1], halved(t, x));
    lower = level ? hourglass(t, inner, level - 1, lower) : block_forward(t, &block[2], lower);
    lower = block_forward(t, &block[level ? 2 : 3], lower);
    if (!upper || !lower) return NULL;
    return op_add(t, upper, map_read(t, lower, upper->dim[0], upper->dim[1], at_corners));
}

tensor *pifu_maps(tape *t, const pifu_network *n, tensor *image, tensor *map[PIFU_STACKS]) {
    const pifu_sizes *s = &n->sizes;
    tensor *x = op_bias_act(t, op_conv2d(t, image, n->stem, 2, 3, 1), n->stem_bias, 1, 1, 0);
    x = block_forward(t, &n->block[0], batch_norm_forward(t, &n->stem_norm, x, true));
    x = block_forward(t, &n->block[1], halved(t, x));
    x = block_forward(t, &n->block[2], x);
    for (int i = 0; i < s->stacks; i++) {
        const pifu_stack *k = &n->stack[i];
        tensor *y = block_forward(t, &k->last, hourglass(t, k->hourglass, 1, x));
        y = batch_norm_forward(t, &k->norm, mix_forward(t, &k->mix, y), true);
        map[i] = mix_forward(t, &k->out, y);
        if (i == s->stacks - 1) break;
        x = op_add(t, x, mix_forward(t, &k->features_back, y));
        x = op_add(t, x, mix_forward(t, &k->out_back, map[i]));
    }
    return map[s->stacks - 1];
}

/* ---- the colour's ---- */
tensor *pifu_color_map(tape *t, const pifu_network *n, tensor *image) {
    tensor *x = mirrored_conv(t, image, n->color_conv[0], 3);
    x = batch_norm_forward(t, &n->color_norm[0], x, true);
    for (int i = 1; i < 3; i++)
        x = batch_norm_forward(t, &n->color_norm[i], op_conv2d(t, x, n->color_conv[i], 2, 1, 1), true);
    for (int b = 0; b < PIFU_BLOCKS; b++) {
        const pifu_residual *r = &n->residual[b];
        tensor *y = batch_norm_forward(t, &r->norm[0], mirrored_conv(t, x, r->conv[0], 1), true);
        y = mirrored_conv(t, y, r->conv[1], 1);
        if (r->norm[1].w) y = batch_norm_forward(t, &r->norm[1], y, false);
        x = op_add(t, x, y);
    }
    return x;
}

/* ---- points ---- */
static tensor *map_at(tape *t, tensor *map, const float *uv, int64_t count) {
    if (!map) return NULL;
    float *position = tape_alloc(t, (size_t)count + 1, 2 * sizeof *position);
    if (!position) return NULL;
    for (int64_t i = 0; i < count; i++)
        for (int k = 0; k < 2; k++)
            position[2 * i + k] = (uv[2 * i + k] + 1) / 2 * (float)(map->dim[1 - k] - 1);
    return op_sample_bilinear(t, map, tape_input(t, position, 2, (int64_t[]){count, 2}));
}

static tensor *points_forward(tape *t, const pifu_points *p, tensor *in) {
    tensor *x = linear_forward(t, &p->layer[0], in);
    for (int i = 1; i < p->layers; i++) {
        tensor *both[2] = {op_bias_act(t, x, NULL, slope, 1, 0), in};
        x = linear_forward(t, &p->layer[i], op_concat(t, 2, both));
    }
    return x;
}

tensor *pifu_occupancy(tape *t, const pifu_network *n, tensor *map, const float *uv, tensor *z,
                       int64_t count) {
    tensor *in[2] = {map_at(t, map, uv, count), z};
    return op_sigmoid(t, points_forward(t, &n->occupancy, op_concat(t, 2, in)), 1, 0);
}

tensor *pifu_color(tape *t, const pifu_network *n, tensor *map, tensor *color_map, const float *uv, tensor *z,
                   int64_t count) {
    tensor *in[3] = {map_at(t, map, uv, count), map_at(t, color_map, uv, count), z};
    tensor *x = points_forward(t, &n->color, op_concat(t, 3, in));
    return op_sigmoid(t, op_scale(t, x, 2), 2, -1); /* tanh */
}
