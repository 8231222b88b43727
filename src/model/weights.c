/* Weights files: ours, and what sherf convert makes of the authors' checkpoints (sizes read from the
 * tensors). */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "io/safetensors.h"
#include "model/model.h"

static const char const_name[] = "backbone.synthesis.b4.const"; /* [4, 4, C] here, [C, 4, 4] in files */

static const safetensor *tensor_of(const safetensors *s, const char *format, int i) {
    char name[128];
    snprintf(name, sizeof name, format, i);
    return safetensors_find(s, name);
}

static int dimension(const safetensors *s, const char *name, int axis) {
    const safetensor *t = safetensors_find(s, name);
    return t && t->rank > axis && t->dim[axis] < 1 << 20 ? (int)t->dim[axis] : 0;
}

/* The sizes a checkpoint without our metadata was built with. */
static sherf_status config_infer(context *c, const safetensors *s, model_config *k) {
    sherf_status status = model_config_parse(c, "paper", k);
    if (status != SHERF_OK) return status;
    k->encoder_width = dimension(s, "encoder_2d.backbone.conv1.weight", 0);
    k->feature_width = dimension(s, "encoder_2d_feature.backbone.conv1.weight", 0);
    k->style_width = dimension(s, "backbone.mapping.fc0.weight", 0);
    for (k->mapping_layers = 0; tensor_of(s, "backbone.mapping.fc%d.weight", k->mapping_layers);)
        k->mapping_layers++;
    int r = 4, channels = dimension(s, "backbone.synthesis.b4.conv1.weight", 0);
    k->channel_max = channels;
    while (r < 1 << 16 && tensor_of(s, "backbone.synthesis.b%d.conv1.weight", 2 * r)) r *= 2;
    const safetensor *last = tensor_of(s, "backbone.synthesis.b%d.conv1.weight", r);
    k->plane_resolution = r;
    k->channel_base = last && last->rank > 0 && last->dim[0] < 1 << 20 ? (int)last->dim[0] * r : 0;
    k->volume_channels[0] = dimension(s, "renderer.encoder_3d.conv1.0.weight", 0);
    k->volume_channels[1] = dimension(s, "renderer.encoder_3d.conv2.0.weight", 0);
    k->volume_channels[2] = dimension(s, "renderer.encoder_3d.conv3.0.weight", 0);
    k->token_width = dimension(s, "renderer.conv1d_reprojection.weight", 0);
    k->head_width = dimension(s, "renderer.transformer.layers.0.0.fn.fn.to_qkv.weight", 0) / 3 / k->heads;
    k->decoder_width = dimension(s, "decoder.pts_linears.0.weight", 0);
    k->view_width = dimension(s, "decoder.views_linear.weight", 0);
    for (k->decoder_depth = 0; tensor_of(s, "decoder.pts_linears.%d.weight", k->decoder_depth);) {
        const safetensor *w = tensor_of(s, "decoder.pts_linears.%d.weight", k->decoder_depth);
        if (k->decoder_depth && w->rank == 2 && w->dim[1] != k->decoder_width)
            k->decoder_skip = k->decoder_depth - 1;
        k->decoder_depth++;
    }
    k->image_size = 0;
    return model_config_check(c, k);
}

/* Shapes agree up to dimensions of 1 at the end (1 x 1 convolutions kept as such). */
static bool same_values(const tensor *x, const safetensor *t) {
    int a = x->rank, b = t->rank;
    while (a > 0 && x->dim[a - 1] == 1) a--;
    while (b > 0 && t->dim[b - 1] == 1) b--;
    if (a != b) return false;
    for (int i = 0; i < a; i++)
        if (x->dim[i] != t->dim[i]) return false;
    return true;
}

static sherf_status finite_check(context *c, const tensor *x, const char *name) {
    for (int64_t i = 0, n = tensor_count(x); i < n; i++)
        if (!isfinite(((const float *)x->data)[i]))
            return failure(c, SHERF_BAD_FILE, "tensor %s holds a number that is not finite", name);
    return SHERF_OK;
}

/* [C, P] <-> [P, C] in place of a small tensor. */
static sherf_status transpose(context *c, float *v, int64_t rows, int64_t columns) {
    float *copy = mem_alloc(c, (size_t)(rows * columns), sizeof *copy);
    if (!copy) return SHERF_NO_MEMORY;
    memcpy(copy, v, (size_t)(rows * columns) * sizeof *copy);
    for (int64_t i = 0; i < rows; i++)
        for (int64_t j = 0; j < columns; j++) v[j * rows + i] = copy[i * columns + j];
    mem_free(copy);
    return SHERF_OK;
}

static sherf_status parameter_read(context *c, const safetensors *s, parameter *q) {
    const safetensor *t = safetensors_find(s, q->name);
    if (!t) return failure(c, SHERF_MISMATCH, "no tensor %s: not the weights of this model", q->name);
    tensor file = q->value;
    bool is_const = !strcmp(q->name, const_name);
    if (is_const) file.dim[0] = q->value.dim[2], file.dim[2] = 4;
    if (!same_values(&file, t)) {
        char want[64], got[64];
        tensor have = {.rank = t->rank};
        for (int i = 0; i < t->rank; i++) have.dim[i] = t->dim[i];
        tensor_shape_text(&file, want);
        tensor_shape_text(&have, got);
        return failure(c, SHERF_MISMATCH, "tensor %s has shape %s, should be %s: weights of another preset?",
                       q->name, got, want);
    }
    sherf_status status = safetensors_floats(c, s, q->name, t->rank, t->dim, q->value.data);
    if (status == SHERF_OK) status = finite_check(c, &q->value, q->name);
    if (status == SHERF_OK && is_const) status = transpose(c, q->value.data, q->value.dim[2], 16);
    return status;
}

sherf_status model_load(context *c, const char *path, model **out) {
    *out = NULL;
    safetensors *s = NULL;
    model *m = NULL;
    model_config config;
    sherf_status status = safetensors_read(c, path, &s);
    if (status != SHERF_OK) return status;
    const char *format = safetensors_metadata(s, "format"), *text = safetensors_metadata(s, "sherf.config");
    if (format && strcmp(format, "sherf-model") && strcmp(format, "sherf-checkpoint")) {
        status = failure(c, SHERF_BAD_FILE, "%s: holds a %s, not a model", path, format);
        goto done;
    }
    status = text ? model_config_parse(c, text, &config) : config_infer(c, s, &config);
    if (status == SHERF_OK) status = model_create(c, &config, 0, &m);
    for (int i = 0; status == SHERF_OK && i < m->weights->count; i++)
        status = parameter_read(c, s, m->weights->item[i]);
    if (status != SHERF_OK) status = failure_prefix(c, status, "%s", path);
done:
    safetensors_free(s);
    if (status == SHERF_OK)
        *out = m;
    else
        model_free(m);
    return status;
}

sherf_status model_items(context *c, const model *m, const float *values, safetensor_item **out,
                         float **memory) {
    const parameters *p = m->weights;
    safetensor_item *item = mem_zero(c, (size_t)p->count, sizeof *item);
    float *turned = mem_alloc(c, (size_t)(16 * model_channels(&m->config, 4)), sizeof *turned);
    *out = item;
    *memory = turned;
    if (!item || !turned) {
        mem_free(item);
        mem_free(turned);
        *out = NULL;
        *memory = NULL;
        return SHERF_NO_MEMORY;
    }
    for (int i = 0; i < p->count; i++) {
        const parameter *q = p->item[i];
        item[i] = (safetensor_item){
            .name = q->name, .type = T_F32, .rank = q->value.rank, .data = values + q->offset};
        memcpy(item[i].dim, q->value.dim, sizeof item[i].dim);
        if (strcmp(q->name, const_name)) continue;
        int64_t C = q->value.dim[2];
        for (int64_t k = 0; k < 16 * C; k++) turned[k % C * 16 + k / C] = values[q->offset + k];
        item[i].data = turned;
        item[i].dim[0] = C;
        item[i].dim[1] = item[i].dim[2] = 4;
    }
    return SHERF_OK;
}

sherf_status model_save_values(context *c, const model *m, const float *values, const char *path) {
    safetensor_item *item = NULL;
    float *memory = NULL;
    char *text = model_config_text(c, &m->config);
    sherf_status status = text ? model_items(c, m, values, &item, &memory) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        safetensor_metadata metadata[] = {{"format", "sherf-model"}, {"sherf.config", text}};
        status = safetensors_write(c, path, (size_t)m->weights->count, item, COUNT_OF(metadata), metadata);
    }
    mem_free(item);
    mem_free(memory);
    mem_free(text);
    return status;
}

sherf_status model_save(context *c, const model *m, const char *path) {
    float *copy;
    const float *values;
    sherf_status status = parameters_read(c, m->weights, &values, &copy);
    if (status == SHERF_OK) status = model_save_values(c, m, values, path);
    mem_free(copy);
    return status;
}

/* One encoder starts from ResNet-18 whole or not at all: not where it has another width (*taken stays false).
 */
static sherf_status encoder_from_resnet(context *c, model *m, const safetensors *s, const char *encoder,
                                        bool *taken) {
    const size_t length = strlen(encoder);
    for (int i = 0; i < m->weights->count; i++) {
        parameter *q = m->weights->item[i];
        if (strncmp(q->name, encoder, length)) continue;
        const char *name = q->name + length;
        const safetensor *t = safetensors_find(s, name);
        if (!t) return failure(c, SHERF_MISMATCH, "%s is missing: no ResNet-18, or not all of it", name);
        if (!same_values(&q->value, t)) {
            if (!*taken && !strcmp(name, "conv1.weight")) return SHERF_OK;
            char want[64], got[64];
            tensor have = {.rank = t->rank};
            for (int k = 0; k < t->rank; k++) have.dim[k] = t->dim[k];
            tensor_shape_text(&q->value, want);
            tensor_shape_text(&have, got);
            return failure(c, SHERF_MISMATCH, "%s has shape %s, ResNet-18's is %s", name, got, want);
        }
        sherf_status status = safetensors_floats(c, s, name, t->rank, t->dim, q->value.data);
        if (status == SHERF_OK) status = finite_check(c, &q->value, name);
        if (status != SHERF_OK) return status;
        *taken = true;
    }
    return SHERF_OK;
}

sherf_status model_load_resnet(context *c, model *m, const char *path) {
    static const char *const encoder[] = {"encoder_2d.backbone.", "encoder_2d_feature.backbone."};
    safetensors *s = NULL;
    bool taken[2] = {0};
    sherf_status status = safetensors_read(c, path, &s);
    if (status != SHERF_OK) return status;
    for (int i = 0; i < 2 && status == SHERF_OK; i++)
        status = encoder_from_resnet(c, m, s, encoder[i], &taken[i]);
    if (status == SHERF_OK && !taken[0] && !taken[1])
        status =
            failure(c, SHERF_MISMATCH, "no ResNet-18 of 64 channels, as the encoders of preset paper are");
    if (status != SHERF_OK)
        status = failure_prefix(c, status, "%s", path);
    else if (!taken[0])
        log_line(c, SHERF_LOG_INFO, "%s: starts the feature encoder alone, the global one is %d wide, not 64",
                 path, m->config.encoder_width);
    safetensors_free(s);
    return status;
}

sherf_status sherf_model_load(sherf_context *c, const char *path, sherf_model **out) {
    sherf_status status = model_load(c, path, out);
    if (status == SHERF_OK && (status = model_place(c, *out)) != SHERF_OK) {
        model_free(*out);
        *out = NULL;
    }
    return status;
}
sherf_status sherf_model_save(sherf_context *c, const sherf_model *m, const char *path) {
    return model_save(c, m, path);
}
