/* Weights files: ours, and what sherf convert makes of the authors' checkpoints. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "io/safetensors.h"
#include "model/model.h"

/* Shapes agree up to trailing dimensions of 1 (1 x 1 convolutions are stored with them). */
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
    if (q->channels_last) {
        file.dim[0] = q->value.dim[2];
        file.dim[1] = q->value.dim[0];
        file.dim[2] = q->value.dim[1];
    }
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
    if (status == SHERF_OK && q->channels_last)
        status = transpose(c, q->value.data, q->value.dim[2], q->value.dim[0] * q->value.dim[1]);
    return status;
}

sherf_status model_load(context *c, const char *path, model **out) {
    *out = NULL;
    safetensors *s = NULL;
    model *m = NULL;
    model_config config;
    sherf_status status = safetensors_read(c, path, &s);
    if (status != SHERF_OK) return status;
    const char *format = safetensors_metadata(s, "format");
    if (format && !strcmp(format, "sherf-checkpoint")) {
        status = failure(
            c, SHERF_BAD_FILE,
            "%s: a checkpoint of a training, not a model: give model.safetensors, which lies beside it",
            path);
        goto done;
    }
    if (format && strcmp(format, "sherf-model")) {
        status = failure(c, SHERF_BAD_FILE, "%s: holds a %s, not a model", path, format);
        goto done;
    }
    status = model_config_of_file(c, s, NULL, true, &config);
    if (status == SHERF_OK) status = model_shape(c, &config, &m);
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

/* Number of floats in tensors whose layout differs in files. */
static size_t turned_floats(const parameters *p) {
    size_t n = 0;
    for (int i = 0; i < p->count; i++)
        if (p->item[i]->channels_last) n += (size_t)tensor_count(&p->item[i]->value);
    return n;
}

sherf_status model_items(context *c, const model *m, const float *values, safetensor_item **out,
                         float **memory) {
    const parameters *p = m->weights;
    safetensor_item *item = mem_zero(c, (size_t)p->count, sizeof *item);
    float *turned = mem_alloc(c, turned_floats(p) + 1, sizeof *turned);
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
        if (!q->channels_last) continue;
        const int64_t C = q->value.dim[2], P = q->value.dim[0] * q->value.dim[1];
        for (int64_t k = 0; k < P * C; k++) turned[k % C * P + k / C] = values[q->offset + k];
        item[i].data = turned;
        item[i].dim[0] = C;
        item[i].dim[1] = q->value.dim[0];
        item[i].dim[2] = q->value.dim[1];
        turned += P * C;
    }
    return SHERF_OK;
}

sherf_status model_save_values(context *c, const model *m, const float *values, const char *path) {
    safetensor_item *item = NULL;
    float *memory = NULL;
    char key[MODEL_KEY], *text = model_config_text(c, &m->config);
    sherf_status status = text ? model_items(c, m, values, &item, &memory) : SHERF_NO_MEMORY;
    model_metadata_key(m->config.kind, key);
    if (status == SHERF_OK) {
        safetensor_metadata metadata[] = {
            SAFETENSORS_CHECKSUM, {"format", "sherf-model"}, {"model", m->config.kind->name}, {key, text}};
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

/* Sets the parameters named PREFIX..., if any, all or none. None are set where the network has another width
 * (*other). */
static sherf_status take_resnet(context *c, model *m, const safetensors *s, const char *prefix, bool *taken,
                                bool *other) {
    const size_t length = strlen(prefix);
    for (int i = 0; i < m->weights->count; i++) {
        parameter *q = m->weights->item[i];
        if (strncmp(q->name, prefix, length)) continue;
        const char *name = q->name + length;
        const safetensor *t = safetensors_find(s, name);
        if (!t) return failure(c, SHERF_MISMATCH, "%s is missing: no ResNet-18, or not all of it", name);
        if (!same_values(&q->value, t)) {
            *other = !*taken && !strcmp(name, "conv1.weight");
            if (*other) return SHERF_OK;
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
    safetensors *s = NULL;
    const model_kind *kind = m->config.kind;
    const char *other = NULL; /* an encoder of another width */
    bool any = false;
    if (!kind->resnets)
        return failure(c, SHERF_MISMATCH, "%s: model %s has no ResNet-18 to start", path, kind->name);
    sherf_status status = safetensors_read(c, path, &s);
    if (status != SHERF_OK) return status;
    for (const char *const *prefix = kind->resnets; *prefix && status == SHERF_OK; prefix++) {
        bool taken = false, wider = false;
        status = take_resnet(c, m, s, *prefix, &taken, &wider);
        any |= taken;
        if (wider) other = *prefix;
    }
    safetensors_free(s);
    if (status == SHERF_OK && !any)
        status =
            failure(c, SHERF_MISMATCH,
                    "no encoder of this %s model is as wide as a converted ResNet, 64 channels", kind->name);
    if (status == SHERF_OK && other)
        log_line(c, SHERF_LOG_INFO, "%s* begins anew: it is not as wide as the ResNet", other);
    return status == SHERF_OK ? SHERF_OK : failure_prefix(c, status, "%s", path);
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
