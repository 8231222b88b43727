/* Layers shared by several parts of a network. */
#include "nn/layers.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>

static const float sparse_eps = 1e-3f, sparse_momentum = 0.01f;

tensor *declare(declaration *d, first_values first, int rank, const int64_t *dim, const char *name_format,
                ...) {
    char name[256];
    va_list args;
    if (d->failed) return NULL;
    va_start(args, name_format);
    vsnprintf(name, sizeof name, name_format, args);
    va_end(args);
    tensor *x = parameter_add(d->c, d->p, false, rank, dim, "%s", name);
    d->failed = !x;
    if (x) d->p->item[d->p->count - 1]->first = first;
    return x;
}

static tensor *declare_buffer(declaration *d, float constant, int rank, const int64_t *dim, const char *name,
                              const char *suffix) {
    tensor *x = declare(d, (first_values){.constant = constant}, rank, dim, "%s%s", name, suffix);
    if (x) d->p->item[d->p->count - 1]->buffer = true;
    return x;
}

first_values first_of_fan_in(bool before_relu, int rank, const int64_t *dim) {
    double fan_in = 1;
    for (int i = 1; i < rank; i++) fan_in *= (double)dim[i];
    return (first_values){.deviation = sqrt((before_relu ? 2 : 1) / fan_in)};
}

tensor *declare_weights(declaration *d, bool before_relu, int rank, const int64_t *dim, const char *name) {
    return declare(d, first_of_fan_in(before_relu, rank, dim), rank, dim, "%s.weight", name);
}

linear_layer linear_declare(declaration *d, const char *name, bool before_relu, int64_t out, int64_t in) {
    tensor *w = declare_weights(d, before_relu, DIMS(out, in), name);
    return (linear_layer){w, declare(d, (first_values){0}, DIMS(out), "%s.bias", name)};
}

tensor *linear_forward_scaled(tape *t, const linear_layer *l, tensor *x, float gain, float bias_gain) {
    return op_linear(t, x, l->w, l->b, gain, bias_gain);
}

tensor *linear_forward(tape *t, const linear_layer *l, tensor *x) {
    return linear_forward_scaled(t, l, x, 1, 1);
}

layer_norm layer_norm_declare(declaration *d, const char *name, int64_t channels) {
    tensor *w = declare(d, (first_values){.constant = 1}, DIMS(channels), "%s.weight", name);
    return (layer_norm){w, declare(d, (first_values){0}, DIMS(channels), "%s.bias", name)};
}

tensor *layer_norm_forward(tape *t, const layer_norm *n, tensor *x) {
    return op_layer_norm(t, x, n->w, n->b);
}

batch_norm batch_norm_declare(declaration *d, const char *name, bool trained, int64_t channels, float eps,
                              float momentum) {
    batch_norm n = {.eps = eps, .momentum = momentum};
    if (trained) {
        const layer_norm scale = layer_norm_declare(d, name, channels);
        n.w = scale.w;
        n.b = scale.b;
    } else {
        n.w = declare_buffer(d, 1, DIMS(channels), name, ".weight");
        n.b = declare_buffer(d, 0, DIMS(channels), name, ".bias");
    }
    n.mean = declare_buffer(d, 0, DIMS(channels), name, ".running_mean");
    n.var = declare_buffer(d, 1, DIMS(channels), name, ".running_var");
    return n;
}

tensor *batch_norm_forward(tape *t, const batch_norm *n, tensor *x, bool relu) {
    const float momentum = tape_settings(t).batch_statistics ? 0 : n->momentum;
    return op_batch_norm(t, x, n->w, n->b, n->mean, n->var, n->eps, momentum, relu);
}

sparse_layer sparse_declare(declaration *d, const char *name, int index, bool trained, int64_t out,
                            int64_t in) {
    char full[LAYER_NAME];
    sparse_layer l;
    snprintf(full, sizeof full, "%s.%d", name, index);
    l.w = declare_weights(d, true, DIMS(out, 3, 3, 3, in), full);
    if (l.w) d->p->item[d->p->count - 1]->buffer = !trained;
    snprintf(full, sizeof full, "%s.%d", name, index + 1);
    l.norm = batch_norm_declare(d, full, trained, out, sparse_eps, sparse_momentum);
    return l;
}

tensor *sparse_forward(tape *t, const sparse_layer *l, tensor *x, tensor *rule) {
    return batch_norm_forward(t, &l->norm, op_sparse_conv(t, x, l->w, rule), true);
}
