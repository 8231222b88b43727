#include "model/sherf/sherf.h"

static tensor *named(tape *t, const model *m, const char *name, const char *suffix) {
    tensor *w = model_tensor(m, "%s%s", name, suffix);
    return w ? w : tape_fail(t, SHERF_MISMATCH, "the model has no tensor %s%s", name, suffix);
}

tensor *layer_linear_scaled(tape *t, const model *m, tensor *x, const char *name, float gain,
                            float bias_gain) {
    tensor *w = named(t, m, name, ".weight"), *b = model_tensor(m, "%s.bias", name);
    if (w && w->rank > 2) w = tape_reshape(t, w, 2, (int64_t[]){w->dim[0], tensor_count(w) / w->dim[0]});
    return op_linear(t, x, w, b, gain, bias_gain);
}

tensor *layer_linear(tape *t, const model *m, tensor *x, const char *name) {
    return layer_linear_scaled(t, m, x, name, 1, 1);
}

tensor *layer_batch_norm(tape *t, const model *m, tensor *x, const char *name, float eps, float momentum,
                         bool relu) {
    tensor *w = named(t, m, name, ".weight"), *b = named(t, m, name, ".bias");
    tensor *mean = named(t, m, name, ".running_mean"), *var = named(t, m, name, ".running_var");
    return op_batch_norm(t, x, w, b, mean, var, eps, momentum, relu);
}
