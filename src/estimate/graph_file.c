/* Nodes of a graph from JSON and tensors: every field is checked, and a key that is not known is an error. */
#include <stdio.h>
#include <string.h>

#include "estimate/graph_file.h"
#include "io/build.h"
#include "io/value.h"

enum { OUTPUTS_MAX = 16, TENSORS_MAX = 2 * GRAPH_NODES_MAX };

/* ---------------------------------------------------------------- fields of a node ------------------- */
static int index_of(const value *v, int count, const char *const *names) {
    for (int i = 0; i < count; i++)
        if (value_is_string(v, names[i])) return i;
    return -1;
}

/* Reads a list of min to max whole numbers; *count of them. Changes nothing where there is no such field. */
static sherf_status integers(context *c, const value *node, const char *key, int min, int max, int64_t *out,
                             int *count) {
    const value *list = value_get(node, key);
    if (!list) return SHERF_OK;
    const size_t n = value_count(list);
    if (list->kind != VALUE_LIST || n < (size_t)min || n > (size_t)max)
        return failure(c, SHERF_BAD_FILE, "\"%s\" is no list of %d to %d numbers", key, min, max);
    for (size_t i = 0; i < n; i++) {
        const value *v = list->list.item[i];
        if (v->kind != VALUE_INTEGER || v->integer < -1 || v->integer > INT32_MAX)
            return failure(c, SHERF_BAD_FILE, "\"%s\" holds what is no size or number of a node", key);
        out[i] = v->integer;
    }
    if (count) *count = (int)n;
    return SHERF_OK;
}

static sherf_status integer(context *c, const value *node, const char *key, int64_t *out) {
    const value *v = value_get(node, key);
    if (!v) return SHERF_OK;
    if (v->kind != VALUE_INTEGER) return failure(c, SHERF_BAD_FILE, "\"%s\" is no whole number", key);
    *out = v->integer;
    return SHERF_OK;
}

static sherf_status truth(context *c, const value *node, const char *key, bool *out) {
    const value *v = value_get(node, key);
    if (!v) return SHERF_OK;
    if (v->kind != VALUE_BOOL) return failure(c, SHERF_BAD_FILE, "\"%s\" is neither true nor false", key);
    *out = v->boolean;
    return SHERF_OK;
}

static sherf_status keys_are_known(context *c, const value *node) {
    static const char *const known[] = {"name",   "kind",   "in",  "then",  "size", "weight",     "bias",
                                        "kernel", "stride", "pad", "block", "axis", "half_pixel", "corners"};
    for (size_t i = 0; i < node->dict.count; i++) {
        const value *key = node->dict.pair[i].key;
        if (index_of(key, COUNT_OF(known), known) < 0)
            return failure(c, SHERF_UNSUPPORTED, "\"%.40s\" is not known",
                           key->kind == VALUE_STRING ? key->string.text : "?");
    }
    return SHERF_OK;
}

/* The tensor that the field names, as floats for mem_free; NULL where there is no such field. */
static sherf_status floats(context *c, const safetensors *file, const value *node, const char *key, int rank,
                           int64_t *size, float **out) {
    const value *name = value_get(node, key);
    *out = NULL;
    if (!name) return SHERF_OK;
    const safetensor *t = name->kind == VALUE_STRING ? safetensors_find(file, name->string.text) : NULL;
    if (!t || t->rank != rank)
        return failure(c, SHERF_BAD_FILE, "\"%s\" names no tensor of %d dimensions", key, rank);
    memcpy(size, t->dim, (size_t)rank * sizeof *size);
    const int64_t count = build_count(rank, size);
    if (!(*out = mem_alloc(c, (size_t)count + 1, sizeof **out))) return SHERF_NO_MEMORY;
    return safetensors_floats(c, file, t->name, rank, size, *out);
}

static sherf_status parse_fields(context *c, const value *node, graph_node *n) {
    const value *pad = value_get(node, "pad");
    int64_t input[GRAPH_INPUTS];
    n->stride[0] = n->stride[1] = 1;
    sherf_status status = keys_are_known(c, node);
    if (status == SHERF_OK) status = integers(c, node, "in", 0, GRAPH_INPUTS, input, &n->inputs);
    if (status == SHERF_OK) status = integers(c, node, "size", 1, GRAPH_RANK, n->size, &n->rank);
    if (status == SHERF_OK) status = integers(c, node, "kernel", 2, 2, n->kernel, NULL);
    if (status == SHERF_OK) status = integers(c, node, "stride", 2, 2, n->stride, NULL);
    if (status == SHERF_OK) status = integer(c, node, "block", &n->block);
    if (status == SHERF_OK) status = integer(c, node, "axis", &n->axis);
    if (status == SHERF_OK) status = truth(c, node, "half_pixel", &n->half_pixel);
    if (status == SHERF_OK) status = truth(c, node, "corners", &n->corners);
    for (int i = 0; i < n->inputs && status == SHERF_OK; i++) n->input[i] = (int)input[i];
    if (status != SHERF_OK) return status;
    if (value_is_string(pad, "same"))
        n->same = true;
    else
        status = integers(c, node, "pad", 4, 2 * GRAPH_RANK, n->pad, NULL);
    return status;
}

static sherf_status add_node(context *c, graph *g, const safetensors *file, const value *node, size_t i) {
    const value *name = value_get(node, "name"), *then = value_get(node, "then");
    graph_node n = {0};
    float *weight = NULL, *bias = NULL;
    if (!node || node->kind != VALUE_DICT || !name || name->kind != VALUE_STRING)
        return failure(c, SHERF_BAD_FILE, "node %zu has no name", i);
    n.name = name->string.text;
    const int kind = index_of(value_get(node, "kind"), GRAPH_KINDS, graph_kind_names),
              activation = then ? index_of(then, GRAPH_ACTIVATIONS, graph_activation_names) : GRAPH_LINEAR;
    if (kind < 0 || activation < 0) {
        const value *what = kind < 0 ? value_get(node, "kind") : then;
        return failure(c, SHERF_UNSUPPORTED, "node %.200s: the %s %.40s is not known", n.name,
                       kind < 0 ? "kind" : "activation",
                       what && what->kind == VALUE_STRING ? what->string.text : "?");
    }
    n.kind = (graph_kind)kind;
    n.then = (graph_activation)activation;
    sherf_status status = parse_fields(c, node, &n);
    if (status == SHERF_OK) status = floats(c, file, node, "weight", 4, n.weight_size, &weight);
    if (status == SHERF_OK) status = floats(c, file, node, "bias", 1, &n.bias_size, &bias);
    if (status != SHERF_OK) {
        failure_prefix(c, status, "node %.200s", n.name);
    } else {
        n.weight = weight;
        n.bias = bias;
        status = graph_add(c, g, &n);
    }
    mem_free(weight);
    mem_free(bias);
    return status;
}

static sherf_status add_nodes(context *c, graph *g, const safetensors *file, const value *root) {
    const value *nodes = value_get(root, "nodes");
    sherf_status status = SHERF_OK;
    if (!nodes || nodes->kind != VALUE_LIST || nodes->list.count > GRAPH_NODES_MAX)
        return failure(c, SHERF_BAD_FILE, "no list of up to %d nodes", GRAPH_NODES_MAX);
    for (size_t i = 0; i < nodes->list.count && status == SHERF_OK; i++)
        status = add_node(c, g, file, nodes->list.item[i], i);
    return status;
}

static sherf_status finish(context *c, graph *g, const value *root, int outputs, const char *const *output) {
    int node[OUTPUTS_MAX];
    if (outputs > OUTPUTS_MAX) return failure(c, SHERF_BAD_ARGUMENT, "%d outputs", outputs);
    for (int i = 0; i < outputs; i++) {
        const value *v = value_get(value_get(root, "outputs"), output[i]);
        if (!v || v->kind != VALUE_INTEGER || v->integer < 0 || v->integer >= GRAPH_NODES_MAX)
            return failure(c, SHERF_MISMATCH, "there is no output %s", output[i]);
        node[i] = (int)v->integer;
    }
    return graph_finish(c, g, outputs, node);
}

sherf_status graph_read(context *c, const safetensors *file, const char *name, int outputs,
                        const char *const *output, graph **out) {
    char key[128];
    document *d = NULL;
    graph *g = NULL;
    *out = NULL;
    snprintf(key, sizeof key, "graph.%s", name);
    const char *text = safetensors_metadata(file, key);
    if (!text) return failure(c, SHERF_MISMATCH, "holds no graph %s", name);
    if (file->count > TENSORS_MAX) return failure(c, SHERF_BAD_FILE, "more than %d tensors", TENSORS_MAX);
    sherf_status status = json_parse(c, text, strlen(text), &d);
    if (status == SHERF_OK && !(g = graph_begin(c))) status = SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = add_nodes(c, g, file, d->root);
    if (status == SHERF_OK) status = finish(c, g, d->root, outputs, output);
    document_free(d);
    if (status == SHERF_OK) {
        *out = g;
        return status;
    }
    graph_free(g);
    return failure_prefix(c, status, "graph %s", name);
}
