#include "model/model.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* Declares the parameters of one part after another; a failure sticks. */
typedef struct {
    context *c;
    parameters *p;
    bool failed;
} builder;

#define DIMS(...)                                                                                            \
    (int)COUNT_OF(((int64_t[]){__VA_ARGS__})), (int64_t[]) {                                                 \
        __VA_ARGS__                                                                                          \
    }

static void add(builder *b, bool buffer, const char *prefix, const char *name, int rank, const int64_t *dim) {
    if (!b->failed && !parameter_add(b->c, b->p, buffer, rank, dim, "%s%s", prefix, name)) b->failed = true;
}

static void add_norm(builder *b, bool buffer, const char *prefix, int64_t channels) {
    add(b, buffer, prefix, ".weight", DIMS(channels));
    add(b, buffer, prefix, ".bias", DIMS(channels));
    add(b, true, prefix, ".running_mean", DIMS(channels));
    add(b, true, prefix, ".running_var", DIMS(channels));
}

static void add_linear(builder *b, const char *prefix, int64_t out, int64_t in) {
    add(b, false, prefix, ".weight", DIMS(out, in));
    add(b, false, prefix, ".bias", DIMS(out));
}

/* torchvision's ResNet-18: stem and `stages` of its four stages, first width w. */
static void add_resnet(builder *b, const char *prefix, int64_t w, int stages) {
    char name[128];
    snprintf(name, sizeof name, "%s.backbone.conv1.weight", prefix);
    add(b, false, name, "", DIMS(w, 3, 7, 7));
    snprintf(name, sizeof name, "%s.backbone.bn1", prefix);
    add_norm(b, false, name, w);
    int64_t in = w;
    for (int stage = 1; stage <= stages; stage++)
        for (int block = 0; block < 2; block++) {
            int64_t out = w << (stage - 1);
            for (int i = 1; i <= 2; i++) {
                snprintf(name, sizeof name, "%s.backbone.layer%d.%d.conv%d.weight", prefix, stage, block, i);
                add(b, false, name, "", DIMS(out, i == 1 ? in : out, 3, 3));
                snprintf(name, sizeof name, "%s.backbone.layer%d.%d.bn%d", prefix, stage, block, i);
                add_norm(b, false, name, out);
            }
            if (in != out) {
                snprintf(name, sizeof name, "%s.backbone.layer%d.%d.downsample.0.weight", prefix, stage,
                         block);
                add(b, false, name, "", DIMS(out, in, 1, 1));
                snprintf(name, sizeof name, "%s.backbone.layer%d.%d.downsample.1", prefix, stage, block);
                add_norm(b, false, name, out);
            }
            in = out;
        }
}

/* One modulated layer of the generator with its style affine. */
static void add_synthesis(builder *b, const model_config *k, int resolution, const char *layer, int64_t out,
                          int64_t in, int64_t size) {
    char name[128];
    int n = snprintf(name, sizeof name, "backbone.synthesis.b%d.%s", resolution, layer);
    add(b, false, name, ".weight", DIMS(out, in, size, size));
    add(b, false, name, ".bias", DIMS(out));
    snprintf(name + n, sizeof name - (size_t)n, ".affine");
    add_linear(b, name, in, k->style_width);
}

static void add_generator(builder *b, const model_config *k) {
    char name[128];
    for (int i = 0; i < k->mapping_layers; i++) {
        snprintf(name, sizeof name, "backbone.mapping.fc%d", i);
        add_linear(b, name, k->style_width, i ? k->style_width : model_latent_width(k));
    }
    int64_t in = model_channels(k, 4);
    /* channels last here, [C, 4, 4] in the files */
    add(b, false, "backbone.synthesis.b4.const", "", DIMS(4, 4, in));
    for (int r = 4; r <= k->plane_resolution; r *= 2) {
        int64_t out = model_channels(k, r);
        if (r > 4) add_synthesis(b, k, r, "conv0", out, in, 3);
        add_synthesis(b, k, r, "conv1", out, out, 3);
        add_synthesis(b, k, r, "torgb", 3 * k->token_width, out, 1);
        in = out;
    }
}

static void add_sparse(builder *b, bool buffer, const char *layer, int index, int64_t out, int64_t in) {
    char name[128];
    snprintf(name, sizeof name, "renderer.encoder_3d.%s.%d.weight", layer, index);
    add(b, buffer, name, "", DIMS(out, 3, 3, 3, in));
    snprintf(name, sizeof name, "renderer.encoder_3d.%s.%d", layer, index + 1);
    add_norm(b, buffer, name, out);
}

static void add_volume(builder *b, const model_config *k) {
    const int *v = k->volume_channels;
    int64_t D = k->token_width;
    add_linear(b, "conv1d_projection", v[0], 3 * D);
    for (int i = 0; i < 2; i++) add_sparse(b, false, "conv0", 3 * i, v[0], v[0]);
    add_sparse(b, false, "down0", 0, v[0], v[0]);
    for (int i = 0; i < 2; i++) add_sparse(b, false, "conv1", 3 * i, v[0], v[0]);
    add_sparse(b, false, "down1", 0, v[1], v[0]);
    for (int i = 0; i < 3; i++) add_sparse(b, false, "conv2", 3 * i, v[1], v[1]);
    add_sparse(b, false, "down2", 0, v[2], v[1]);
    for (int i = 0; i < 3; i++) add_sparse(b, false, "conv3", 3 * i, v[2], v[2]);
    /* runs in training only, for its statistics: never trained */
    add_sparse(b, true, "down3", 0, v[2], v[2]);
}

static void add_fusion(builder *b, const model_config *k) {
    int64_t D = k->token_width, inner = (int64_t)k->heads * k->head_width;
    const char *layer = "renderer.transformer.layers.0.";
    char name[128];
    add_linear(b, "renderer.conv1d_projection", 3 * D,
               k->volume_channels[0] + k->volume_channels[1] + k->volume_channels[2]);
    add_linear(b, "renderer.conv1d_reprojection", D, 3 * D);
    for (int i = 0; i < 2; i++) {
        snprintf(name, sizeof name, "%s%d.fn.norm", layer, i);
        add(b, false, name, ".weight", DIMS(D));
        add(b, false, name, ".bias", DIMS(D));
    }
    snprintf(name, sizeof name, "%s0.fn.fn.to_qkv.weight", layer);
    add(b, false, name, "", DIMS(3 * inner, D));
    snprintf(name, sizeof name, "%s0.fn.fn.to_out.0", layer);
    add_linear(b, name, D, inner);
    for (int i = 0; i < 2; i++) {
        snprintf(name, sizeof name, "%s1.fn.fn.net.%d", layer, 3 * i);
        add_linear(b, name, D, D);
    }
}

static void add_decoder(builder *b, const model_config *k) {
    int64_t W = k->decoder_width, x = 39 + k->token_width;
    char name[64];
    for (int i = 0; i < k->decoder_depth; i++) {
        snprintf(name, sizeof name, "decoder.pts_linears.%d", i);
        add_linear(b, name, W, i == 0 ? x : i == k->decoder_skip + 1 ? W + x : W);
    }
    add_linear(b, "decoder.views_linear", k->view_width, W + 27 + k->token_width);
    add_linear(b, "decoder.feature_linear", W, W);
    add_linear(b, "decoder.alpha_linear", 1, W);
    add_linear(b, "decoder.rgb_linear", 3, k->view_width);
}

bool model_is_point_weight(const char *name) {
    if (!strncmp(name, "decoder.", 8)) return true;
    return !strncmp(name, "renderer.", 9) && strncmp(name, "renderer.encoder_3d.", 20) != 0;
}

static bool ends(const char *name, const char *suffix) {
    size_t n = strlen(name), m = strlen(suffix);
    return n >= m && !strcmp(name + n - m, suffix);
}

/* Standard deviation of a weight's first values; 0: zeros. He's rule for what a ReLU follows. */
static double initial_deviation(const char *name, const tensor *w) {
    double fan_in = 1;
    for (int i = 1; i < w->rank; i++) fan_in *= (double)w->dim[i];
    if (strstr(name, "backbone.mapping")) return 1 / 0.01; /* undone by the run-time factor 0.01 */
    if (strstr(name, "backbone.synthesis")) return 1;
    if (strstr(name, "pts_linears") || strstr(name, "views_linear") || strstr(name, "encoder_"))
        return sqrt(2 / fan_in);
    return sqrt(1 / fan_in);
}

static void initialise(parameter *q, uint64_t seed) {
    float *v = q->value.data;
    int64_t n = tensor_count(&q->value);
    uint64_t key = random_key(seed, q->name, 0);
    if (ends(q->name, ".running_mean")) return;
    if (ends(q->name, ".running_var") || (q->value.rank == 1 && ends(q->name, ".weight")) ||
        (strstr(q->name, ".affine.") && ends(q->name, ".bias"))) {
        for (int64_t i = 0; i < n; i++) v[i] = 1;
    } else if (ends(q->name, ".bias")) {
        return;
    } else {
        double deviation = ends(q->name, ".const") ? 1 : initial_deviation(q->name, &q->value);
        for (int64_t i = 0; i < n; i++) v[i] = (float)(deviation * random_normal(key, (uint64_t)i));
    }
}

sherf_status model_create(context *c, const model_config *config, uint64_t seed, model **out) {
    *out = NULL;
    sherf_status status = model_config_check(c, config);
    if (status != SHERF_OK) return status;
    model *m = mem_zero(c, 1, sizeof *m);
    if (!m) return SHERF_NO_MEMORY;
    m->config = *config;
    m->weights = parameters_create(c);
    builder b = {c, m->weights, !m->weights};
    if (!b.failed) {
        add_volume(&b, config);
        add_fusion(&b, config);
        add_resnet(&b, "encoder_2d", config->encoder_width, 4);
        add_resnet(&b, "encoder_2d_feature", config->feature_width, 1);
        add_generator(&b, config);
        add_decoder(&b, config);
    }
    status = b.failed ? SHERF_NO_MEMORY : parameters_lay_out(c, m->weights);
    if (status != SHERF_OK) {
        model_free(m);
        return status;
    }
    for (int i = 0; i < m->weights->count; i++) initialise(m->weights->item[i], seed);
    *out = m;
    return SHERF_OK;
}

void model_free(model *m) {
    if (!m) return;
    parameters_free(m->weights);
    mem_free(m);
}

sherf_status model_place(context *c, model *m) {
    return parameters_place(c, m->weights, backend_of(c)->memory);
}

tensor *model_tensor(const model *m, const char *format, ...) {
    char name[256];
    va_list args;
    va_start(args, format);
    vsnprintf(name, sizeof name, format, args);
    va_end(args);
    parameter *q = parameter_find(m->weights, name);
    return q ? &q->value : NULL;
}

static const float *values_of(const parameters *p, const char *name, const char *suffix) {
    char full[160];
    snprintf(full, sizeof full, "%s%s", name, suffix);
    parameter *q = parameter_find(p, full);
    return q ? q->value.data : NULL;
}

void model_point_weights(const parameters *p, const model_config *k, point_weights *w) {
    const char *layer0 = "renderer.transformer.layers.0.0.fn.",
               *layer1 = "renderer.transformer.layers.0.1.fn.";
    char name[128];
    *w = (point_weights){0};
    w->volume_projection_w = values_of(p, "renderer.conv1d_projection", ".weight");
    w->volume_projection_b = values_of(p, "renderer.conv1d_projection", ".bias");
    w->token_projection_w = values_of(p, "renderer.conv1d_reprojection", ".weight");
    w->token_projection_b = values_of(p, "renderer.conv1d_reprojection", ".bias");
    w->norm0_w = values_of(p, layer0, "norm.weight");
    w->norm0_b = values_of(p, layer0, "norm.bias");
    w->qkv_w = values_of(p, layer0, "fn.to_qkv.weight");
    w->attention_out_w = values_of(p, layer0, "fn.to_out.0.weight");
    w->attention_out_b = values_of(p, layer0, "fn.to_out.0.bias");
    w->norm1_w = values_of(p, layer1, "norm.weight");
    w->norm1_b = values_of(p, layer1, "norm.bias");
    w->mlp0_w = values_of(p, layer1, "fn.net.0.weight");
    w->mlp0_b = values_of(p, layer1, "fn.net.0.bias");
    w->mlp1_w = values_of(p, layer1, "fn.net.3.weight");
    w->mlp1_b = values_of(p, layer1, "fn.net.3.bias");
    for (int i = 0; i < k->decoder_depth; i++) {
        snprintf(name, sizeof name, "decoder.pts_linears.%d", i);
        w->pts_w[i] = values_of(p, name, ".weight");
        w->pts_b[i] = values_of(p, name, ".bias");
    }
    w->alpha_w = values_of(p, "decoder.alpha_linear", ".weight");
    w->alpha_b = values_of(p, "decoder.alpha_linear", ".bias");
    w->feature_w = values_of(p, "decoder.feature_linear", ".weight");
    w->feature_b = values_of(p, "decoder.feature_linear", ".bias");
    w->views_w = values_of(p, "decoder.views_linear", ".weight");
    w->views_b = values_of(p, "decoder.views_linear", ".bias");
    w->rgb_w = values_of(p, "decoder.rgb_linear", ".weight");
    w->rgb_b = values_of(p, "decoder.rgb_linear", ".bias");
}

sherf_status sherf_model_create(sherf_context *c, const char *preset, uint64_t seed, sherf_model **out) {
    *out = NULL;
    model_config config;
    sherf_status status = model_config_parse(c, preset, &config);
    if (status == SHERF_OK) status = model_create(c, &config, seed, out);
    if (status == SHERF_OK && (status = model_place(c, *out)) != SHERF_OK) {
        model_free(*out);
        *out = NULL;
    }
    return status;
}

void sherf_model_free(sherf_model *m) {
    model_free(m);
}
int64_t sherf_model_parameter_count(const sherf_model *m) {
    return parameters_trained_count(m->weights);
}
