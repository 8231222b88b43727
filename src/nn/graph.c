/* graph: checks nodes and infers their sizes as they are added; at the end values get places in one workspace
 * by their lifetimes. */
#include <math.h>
#include <string.h>

#include "nn/graph.h"
#include "nn/graph_kernels.h"
#include "tensor/cpu/dnnl_layer.h"

const char *const graph_kind_names[GRAPH_KINDS] = {"input",      "convolution", "depthwise", "add",
                                                   "activation", "max_pool",    "resize",    "unfold",
                                                   "pad",        "reshape",     "concat"};
const char *const graph_activation_names[GRAPH_ACTIVATIONS] = {"linear", "relu", "relu6", "sigmoid"};

static const int64_t node_values_max = (int64_t)1 << 24, memory_values_max = (int64_t)1 << 27,
                     side_max = 1 << 15;
static const double products_max = 0x1p36;
enum { OUTPUTS_MAX = 16, OUTSIDE = -1, NOWHERE = -2 };

typedef struct {
    graph_node node; /* without name and weights */
    int rank;
    int64_t size[GRAPH_RANK], count;
    int64_t before[2]; /* convolutions, pool: zeros above and to the left */
    layer *layer;      /* of a convolution */
    double products;
    bool wanted;
    int last;  /* The last node that reads the value; for outputs a number greater than all nodes'. */
    int place; /* in the workspace; OUTSIDE: the caller's */
} step;

struct graph {
    int count, room;
    step *step;
    double products;
    int64_t layers_values; /* weights */
    int outputs, output[OUTPUTS_MAX], input;
    int places;
    int64_t *place_values, *place_begin;
    int64_t workspace_values;
    size_t scratch_bytes;
};

graph *graph_begin(context *c) {
    graph *g = mem_zero(c, 1, sizeof *g);
    if (g) g->input = NOWHERE;
    return g;
}

void graph_free(graph *g) {
    if (!g) return;
    for (int i = 0; i < g->count; i++) layer_free(g->step[i].layer);
    mem_free(g->step);
    mem_free(g->place_values);
    mem_free(g->place_begin);
    mem_free(g);
}

/* ---------------------------------------------------------------- checks and sizes ------------------- */
#define REFUSE(...) return failure(c, SHERF_BAD_FILE, __VA_ARGS__)

static sherf_status set_size(context *c, step *s, int rank, const int64_t *size) {
    if (rank < 1 || rank > GRAPH_RANK) REFUSE("a value of %d dimensions", rank);
    s->rank = rank;
    s->count = 1;
    for (int i = 0; i < rank; i++) {
        if (size[i] < 1 || size[i] > node_values_max / s->count)
            REFUSE("its value has no size, or more than %lld numbers", (long long)node_values_max);
        s->size[i] = size[i];
        s->count *= size[i];
    }
    return SHERF_OK;
}

/* `count` pixels seen through a window of `kernel` at every `stride`, with zeros around. */
static sherf_status window(context *c, const graph_node *n, int axis, int64_t count, int64_t kernel,
                           int64_t *before, int64_t *after, int64_t *out) {
    const int64_t stride = n->stride[axis];
    if (kernel < 1 || kernel > 64 || stride < 1 || stride > 64) REFUSE("an impossible kernel or stride");
    if (n->same) {
        *out = (count + stride - 1) / stride;
        int64_t lacks = (*out - 1) * stride + kernel - count;
        if (lacks < 0) lacks = 0;
        *before = lacks / 2;
        *after = lacks - *before;
        return SHERF_OK;
    }
    *before = n->pad[2 * axis];
    *after = n->pad[2 * axis + 1];
    if (*before < 0 || *after < 0 || *before >= kernel || *after >= kernel)
        REFUSE("as much padding as its kernel is wide, or more");
    if (count + *before + *after < kernel) REFUSE("a kernel wider than its input");
    *out = (count + *before + *after - kernel) / stride + 1;
    return SHERF_OK;
}

static bool finite_all(const float *x, int64_t count) {
    for (int64_t i = 0; i < count; i++)
        if (!isfinite(x[i])) return false;
    return true;
}

static sherf_status check_weights(context *c, const graph_node *n, int64_t channels) {
    const int64_t *w = n->weight_size;
    const bool depthwise = n->kind == GRAPH_DEPTHWISE;
    int64_t count = 1;
    if (!n->weight) REFUSE("no weights");
    for (int i = 0; i < 4; i++) {
        if (w[i] < 1 || w[i] > node_values_max / count) REFUSE("weights of an impossible size");
        count *= w[i];
    }
    if (w[2] != channels || (depthwise && w[3] != 1))
        REFUSE("weights [%lld, %lld, %lld, %lld] for %lld channels", (long long)w[0], (long long)w[1],
               (long long)w[2], (long long)w[3], (long long)channels);
    if (depthwise && channels % 8) /* otherwise oneDNN 2.6 reads sums unaligned, which crashes on SSE */
        REFUSE("a depthwise convolution of %lld channels, which are no multiple of 8", (long long)channels);
    const int64_t out = depthwise ? channels : w[3];
    if (n->bias && n->bias_size != out)
        REFUSE("%lld biases for %lld channels", (long long)n->bias_size, (long long)out);
    if (!finite_all(n->weight, count) || (n->bias && !finite_all(n->bias, out)))
        REFUSE("weights that are not finite");
    return SHERF_OK;
}

static sherf_status convolution(context *c, graph *g, step *s, const graph_node *n, const step *x) {
    static const layer_activation then[] = {LAYER_LINEAR, LAYER_RELU, LAYER_RELU6};
    const bool depthwise = n->kind == GRAPH_DEPTHWISE;
    int64_t size[3], after[2];
    if (x->rank != 3) REFUSE("no picture to convolve");
    if (n->then > GRAPH_RELU6) REFUSE("another activation than relu and relu6");
    sherf_status status = check_weights(c, n, x->size[2]);
    for (int k = 0; k < 2 && status == SHERF_OK; k++)
        status = window(c, n, k, x->size[k], n->weight_size[k], &s->before[k], &after[k], &size[k]);
    if (status != SHERF_OK) return status;
    size[2] = depthwise ? x->size[2] : n->weight_size[3];
    if ((status = set_size(c, s, 3, size)) != SHERF_OK) return status;
    const int64_t window_values = n->weight_size[0] * n->weight_size[1];
    s->products = (double)s->count * (double)window_values * (double)(depthwise ? 1 : x->size[2]);
    g->layers_values += window_values * size[2] * (depthwise ? 1 : x->size[2]);
    if (g->layers_values > memory_values_max) REFUSE("a network with too many weights");
    layer_shape shape = {.in = (int)x->size[2],
                         .out = (int)size[2],
                         .depthwise = depthwise,
                         .adds = n->inputs > 1,
                         .then = then[n->then]};
    for (int k = 0; k < 2; k++) {
        shape.size[k] = (int)x->size[k];
        shape.kernel[k] = (int)n->weight_size[k];
        shape.stride[k] = (int)n->stride[k];
        shape.before[k] = (int)s->before[k];
        shape.after[k] = (int)after[k];
    }
    return layer_create(c, &shape, n->weight, n->bias, &s->layer);
}

static sherf_status max_pool(context *c, step *s, const graph_node *n, const step *x) {
    int64_t size[3], after;
    if (x->rank != 3) REFUSE("no picture to pool");
    for (int k = 0; k < 2; k++) {
        sherf_status status = window(c, n, k, x->size[k], n->kernel[k], &s->before[k], &after, &size[k]);
        if (status != SHERF_OK) return status;
    }
    size[2] = x->size[2];
    sherf_status status = set_size(c, s, 3, size);
    s->products = (double)s->count * (double)(n->kernel[0] * n->kernel[1]); /* comparisons */
    return status;
}

static sherf_status resize(context *c, step *s, const graph_node *n, const step *x) {
    if (x->rank != 3) REFUSE("no picture to resize");
    if (n->half_pixel && n->corners) REFUSE("two ways to resize at once");
    for (int k = 0; k < 2; k++)
        if (n->size[k] < 1 || n->size[k] > side_max) REFUSE("an impossible size");
    return set_size(c, s, 3, (int64_t[]){n->size[0], n->size[1], x->size[2]});
}

static sherf_status unfold(context *c, step *s, const graph_node *n, const step *x) {
    const int64_t b = n->block;
    if (x->rank != 3 || b < 1 || b > 64 || x->size[2] % (b * b)) REFUSE("blocks that do not fit");
    if (x->size[0] > side_max || x->size[1] > side_max) REFUSE("an impossible size");
    return set_size(c, s, 3, (int64_t[]){x->size[0] * b, x->size[1] * b, x->size[2] / (b * b)});
}

static sherf_status pad(context *c, step *s, const graph_node *n, const step *x) {
    int64_t size[3];
    if (x->rank != 3) REFUSE("no picture to pad");
    for (int k = 0; k < 3; k++) {
        const int64_t before = n->pad[2 * k], after = n->pad[2 * k + 1];
        if (before < 0 || after < 0 || before > side_max || after > side_max) REFUSE("impossible padding");
        size[k] = before + x->size[k] + after;
    }
    return set_size(c, s, 3, size);
}

static sherf_status reshape(context *c, step *s, const graph_node *n, const step *x) {
    int64_t size[GRAPH_RANK], known = 1;
    int open = -1;
    if (n->rank < 1 || n->rank > GRAPH_RANK) REFUSE("a value of %d dimensions", n->rank);
    for (int k = 0; k < n->rank; k++) {
        size[k] = n->size[k];
        if (size[k] == -1 && open < 0)
            open = k;
        else if (size[k] < 1 || size[k] > x->count / known)
            REFUSE("another number of values than its input's");
        else
            known *= size[k];
    }
    if (open >= 0) size[open] = x->count / known;
    if (x->count != known * (open >= 0 ? size[open] : 1)) REFUSE("another number of values than its input's");
    return set_size(c, s, n->rank, size);
}

static sherf_status concat(context *c, const graph *g, step *s, const graph_node *n, const step *x) {
    int64_t size[GRAPH_RANK];
    const int64_t axis = n->axis == -1 ? x->rank - 1 : n->axis;
    if (axis < 0 || axis >= x->rank) REFUSE("an axis that is not there");
    memcpy(size, x->size, sizeof size);
    for (int i = 1; i < n->inputs; i++) {
        const step *y = &g->step[n->input[i]];
        if (y->rank != x->rank) REFUSE("inputs of different sizes");
        for (int k = 0; k < x->rank; k++)
            if (k != axis && y->size[k] != x->size[k]) REFUSE("inputs of different sizes");
        size[axis] += y->size[axis];
    }
    s->node.axis = axis;
    return set_size(c, s, x->rank, size);
}

static bool same_size(const step *a, const step *b) {
    if (a->rank != b->rank) return false;
    for (int i = 0; i < a->rank; i++)
        if (a->size[i] != b->size[i]) return false;
    return true;
}

static sherf_status infer(context *c, graph *g, step *s, const graph_node *n) {
    const step *x = n->inputs ? &g->step[n->input[0]] : NULL;
    switch (n->kind) {
    case GRAPH_INPUT:
        if (g->input >= 0) REFUSE("a second input");
        g->input = g->count;
        return set_size(c, s, n->rank, n->size);
    case GRAPH_CONVOLUTION:
    case GRAPH_DEPTHWISE:
        return convolution(c, g, s, n, x);
    case GRAPH_ADD:
    case GRAPH_ACTIVATION:
        return set_size(c, s, x->rank, x->size);
    case GRAPH_MAX_POOL:
        return max_pool(c, s, n, x);
    case GRAPH_RESIZE:
        return resize(c, s, n, x);
    case GRAPH_UNFOLD:
        return unfold(c, s, n, x);
    case GRAPH_PAD:
        return pad(c, s, n, x);
    case GRAPH_RESHAPE:
        return reshape(c, s, n, x);
    case GRAPH_CONCAT:
        return concat(c, g, s, n, x);
    case GRAPH_KINDS:
        break;
    }
    REFUSE("an unknown kind");
}

static sherf_status check_inputs(context *c, const graph *g, const graph_node *n) {
    static const struct {
        int min, max;
    } wanted[GRAPH_KINDS] = {
        [GRAPH_INPUT] = {0, 0},   [GRAPH_CONVOLUTION] = {1, 2},      [GRAPH_DEPTHWISE] = {1, 2},
        [GRAPH_ADD] = {2, 2},     [GRAPH_ACTIVATION] = {1, 1},       [GRAPH_MAX_POOL] = {1, 1},
        [GRAPH_RESIZE] = {1, 1},  [GRAPH_UNFOLD] = {1, 1},           [GRAPH_PAD] = {1, 1},
        [GRAPH_RESHAPE] = {1, 1}, [GRAPH_CONCAT] = {1, GRAPH_INPUTS}};
    if ((unsigned)n->kind >= GRAPH_KINDS || (unsigned)n->then >= GRAPH_ACTIVATIONS)
        REFUSE("an unknown kind or activation");
    if (n->inputs < wanted[n->kind].min || n->inputs > wanted[n->kind].max) REFUSE("%d inputs", n->inputs);
    for (int i = 0; i < n->inputs; i++)
        if (n->input[i] < 0 || n->input[i] >= g->count) REFUSE("an input that is no earlier node");
    return SHERF_OK;
}

static sherf_status add_step(context *c, graph *g, const graph_node *n) {
    if (g->count == GRAPH_NODES_MAX) REFUSE("more than %d nodes", GRAPH_NODES_MAX);
    if (g->count == g->room) {
        const int room = g->room ? 2 * g->room : 64;
        step *grown = mem_grow(c, g->step, (size_t)g->count, (size_t)room, sizeof *grown);
        if (!grown) return SHERF_NO_MEMORY;
        g->step = grown;
        g->room = room;
    }
    sherf_status status = check_inputs(c, g, n);
    if (status != SHERF_OK) return status;
    step *s = &g->step[g->count];
    *s = (step){.node = *n, .place = NOWHERE};
    s->node.name = NULL;
    s->node.weight = s->node.bias = NULL;
    status = infer(c, g, s, n);
    if (status == SHERF_OK && n->inputs == 2 && n->kind != GRAPH_CONCAT &&
        !same_size(n->kind == GRAPH_ADD ? &g->step[n->input[0]] : s, &g->step[n->input[1]]))
        status = failure(c, SHERF_BAD_FILE, "a sum of different sizes");
    if (status == SHERF_OK && g->products + s->products > products_max)
        status = failure(c, SHERF_BAD_FILE, "a network with too many products");
    if (status != SHERF_OK) {
        layer_free(s->layer);
        return status;
    }
    g->products += s->products;
    g->count++;
    return SHERF_OK;
}

sherf_status graph_add(context *c, graph *g, const graph_node *n) {
    sherf_status status = add_step(c, g, n);
    if (status == SHERF_OK) return status;
    const bool known = (unsigned)n->kind < GRAPH_KINDS;
    return failure_prefix(c, status, "node %.200s (%s)", n->name ? n->name : "?",
                          known ? graph_kind_names[n->kind] : "?");
}

/* ---------------------------------------------------------------- places ----------------------------- */
/* Which values are needed, and until when. */
static void find_lives(graph *g) {
    for (int i = g->count - 1; i >= 0; i--) {
        step *s = &g->step[i];
        if (!s->wanted) {
            layer_free(s->layer);
            s->layer = NULL;
            g->products -= s->products;
            continue;
        }
        for (int k = 0; k < s->node.inputs; k++) {
            step *x = &g->step[s->node.input[k]];
            if (!x->wanted) x->last = i; /* the last reader comes first */
            x->wanted = true;
        }
    }
}

/* Whether a convolution's sum may overwrite the summand: nothing may read that afterwards. */
static bool sums_in_place(const graph *g, int i) {
    const graph_node *n = &g->step[i].node;
    if (!g->step[i].layer || n->inputs < 2 || n->input[0] == n->input[1]) return false;
    const step *summand = &g->step[n->input[1]];
    return summand->last == i && summand->place >= 0;
}

/* The best-fitting free place, else the largest free one enlarged, else a new one. */
static int place_take(graph *g, bool *taken, int64_t values) {
    int best = -1;
    for (int k = 0; k < g->places; k++) {
        if (taken[k]) continue;
        const int64_t room = g->place_values[k], have = best < 0 ? 0 : g->place_values[best];
        if (best < 0 || (have < values ? room > have : room >= values && room < have)) best = k;
    }
    if (best < 0) {
        best = g->places++;
        g->place_values[best] = 0;
    }
    if (g->place_values[best] < values) g->place_values[best] = values;
    taken[best] = true;
    return best;
}

static sherf_status find_places(context *c, graph *g) {
    bool *taken = mem_zero(c, (size_t)g->count, sizeof *taken);
    g->place_values = mem_zero(c, (size_t)g->count, sizeof *g->place_values);
    g->place_begin = mem_zero(c, (size_t)g->count, sizeof *g->place_begin);
    sherf_status status = taken && g->place_values && g->place_begin ? SHERF_OK : SHERF_NO_MEMORY;
    for (int i = 0; i < g->count && status == SHERF_OK; i++) {
        step *s = &g->step[i];
        if (!s->wanted) continue;
        const bool in_place = sums_in_place(g, i);
        if (i == g->input)
            s->place = OUTSIDE;
        else if (in_place)
            s->place = g->step[s->node.input[1]].place;
        else
            s->place = place_take(g, taken, (s->count + 15) / 16 * 16);
        for (int k = 0; k < s->node.inputs; k++) {
            const step *x = &g->step[s->node.input[k]];
            if (x->last == i && x->place >= 0 && x->place != s->place) taken[x->place] = false;
        }
    }
    for (int k = 0; k < g->places && status == SHERF_OK; k++) {
        g->place_begin[k] = g->workspace_values;
        g->workspace_values += g->place_values[k];
        if (g->workspace_values > memory_values_max)
            status = failure(c, SHERF_BAD_FILE, "a network that needs more than %lld numbers of memory",
                             (long long)memory_values_max);
    }
    mem_free(taken);
    return status;
}

sherf_status graph_finish(context *c, graph *g, int outputs, const int *node) {
    if (outputs < 1 || outputs > OUTPUTS_MAX) REFUSE("a graph of %d outputs", outputs);
    if (g->input < 0) REFUSE("a graph without an input");
    for (int i = 0; i < outputs; i++) {
        if (node[i] < 0 || node[i] >= g->count) REFUSE("output %d is no node", i);
        g->output[i] = node[i];
        g->step[node[i]].wanted = true;
        g->step[node[i]].last = g->count;
    }
    g->outputs = outputs;
    find_lives(g);
    g->step[g->input].wanted = true;
    for (int i = 0; i < g->count; i++) {
        if (!g->step[i].layer) continue;
        const size_t bytes = layer_scratch_bytes(g->step[i].layer);
        if (bytes > g->scratch_bytes) g->scratch_bytes = bytes;
    }
    return find_places(c, g);
}

/* ---------------------------------------------------------------- running ---------------------------- */
int graph_output_size(const graph *g, int i, int64_t size[GRAPH_RANK]) {
    const step *s = &g->step[g->output[i]];
    memcpy(size, s->size, sizeof s->size);
    return s->rank;
}

bool graph_input_is(const graph *g, int rank, const int64_t *size) {
    const step *s = &g->step[g->input];
    return s->rank == rank && !memcmp(s->size, size, (size_t)rank * sizeof *size);
}

double graph_products(const graph *g) {
    return g->products;
}

typedef struct {
    const graph *g;
    const float *input;
    float *workspace;
    void *scratch;
} run;

static float *place_of(const run *r, int place) {
    return r->workspace + r->g->place_begin[place];
}

static const float *value_of(const run *r, int i) {
    const int place = r->g->step[i].place;
    return place == OUTSIDE ? r->input : place_of(r, place);
}

static void run_concat(const run *r, const step *s, float *y) {
    int64_t outer = 1, inner = 1, at = 0;
    for (int k = 0; k < s->node.axis; k++) outer *= s->size[k];
    for (int k = (int)s->node.axis + 1; k < s->rank; k++) inner *= s->size[k];
    const int64_t row = s->size[s->node.axis] * inner;
    for (int i = 0; i < s->node.inputs; i++) {
        const float *x = value_of(r, s->node.input[i]);
        const int64_t part = r->g->step[s->node.input[i]].size[s->node.axis] * inner;
        for (int64_t k = 0; k < outer; k++) memcpy(y + k * row + at, x + k * part, (size_t)part * sizeof *y);
        at += part;
    }
}

static sherf_status run_step(context *c, const run *r, int i) {
    const step *s = &r->g->step[i], *from = s->node.inputs ? &r->g->step[s->node.input[0]] : NULL;
    const float *x = from ? value_of(r, s->node.input[0]) : NULL;
    const float *second = s->node.inputs > 1 ? value_of(r, s->node.input[1]) : NULL;
    float *y = place_of(r, s->place);
    switch (s->node.kind) {
    case GRAPH_CONVOLUTION:
    case GRAPH_DEPTHWISE:
        if (second && second != y) memcpy(y, second, (size_t)s->count * sizeof *y);
        return layer_run(c, s->layer, x, y, r->scratch);
    case GRAPH_ADD:
    case GRAPH_ACTIVATION:
        graph_sum(c, s->count, s->node.then, x, second, y);
        break;
    case GRAPH_MAX_POOL: {
        const graph_pool p = {{from->size[0], from->size[1]},
                              {s->size[0], s->size[1]},
                              s->size[2],
                              {s->node.kernel[0], s->node.kernel[1]},
                              {s->node.stride[0], s->node.stride[1]},
                              {s->before[0], s->before[1]}};
        graph_max_pool(c, &p, x, y);
        break;
    }
    case GRAPH_RESIZE: {
        const graph_scaling scaling = {{from->size[0], from->size[1]},
                                       {s->size[0], s->size[1]},
                                       s->size[2],
                                       s->node.half_pixel,
                                       s->node.corners};
        graph_resize(c, &scaling, x, y);
        break;
    }
    case GRAPH_UNFOLD:
        graph_unfold(c, from->size[0], from->size[1], s->size[2], s->node.block, x, y);
        break;
    case GRAPH_PAD:
        graph_pad(from->size, s->size, (int64_t[]){s->node.pad[0], s->node.pad[2], s->node.pad[4]}, x, y);
        break;
    case GRAPH_RESHAPE:
        memcpy(y, x, (size_t)s->count * sizeof *y);
        break;
    case GRAPH_CONCAT:
        run_concat(r, s, y);
        break;
    case GRAPH_INPUT:
    case GRAPH_KINDS:
        break;
    }
    return SHERF_OK;
}

sherf_status graph_run(context *c, const graph *g, const float *input, arena *memory, const float **output) {
    run r = {.g = g, .input = input};
    r.workspace = arena_alloc(c, memory, (size_t)g->workspace_values, sizeof *r.workspace);
    r.scratch = r.workspace ? arena_alloc(c, memory, g->scratch_bytes + 1, 1) : NULL;
    if (!r.scratch) return SHERF_NO_MEMORY;
    for (int i = 0; i < g->count; i++) {
        if (!g->step[i].wanted || i == g->input) continue;
        sherf_status status = run_step(c, &r, i);
        if (status != SHERF_OK) return status;
    }
    for (int i = 0; i < g->outputs; i++) output[i] = value_of(&r, g->output[i]);
    return SHERF_OK;
}
