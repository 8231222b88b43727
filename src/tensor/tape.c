/* The tape: calls kernels, records steps as a list from the newest on, and runs them backward. A gradient is
 * made when something first adds to it; during the backward pass a listener is called when a parameter's
 * gradient is final. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/only_read.h"
#include "tensor/tensor.h"

/* One recorded step, newest first. */
typedef struct node node;
struct node {
    node *previous;
    tape_backward_function backward; /* NULL: the op's kernel */
    void *payload;
    op_id op;
    tensor *in[OP_MAX_IN], *out[OP_MAX_OUT];
    const void *attr;
    void *saved;
};

/* An object that is released with the tape's memory. */
typedef struct owned owned;
struct owned {
    owned *previous;
    void *object;
    void (*release)(void *object);
};

/* Memory of dropped tensors, in the tape's own memory. */
enum { SPARES = 64 };
typedef struct {
    char *data;
    size_t bytes;
} spare;

struct tape {
    context *c;
    tape_options options;
    arena *memory;  /* tensors' structs, nodes, attributes: in host memory */
    arena *data;    /* data of kernels, in the backend's memory; `memory` if that is the host's */
    arena *scratch; /* in the backend's memory too; rewound after every kernel */
    node *newest;
    owned *owned;
    int spares;
    spare spare[SPARES];
    sherf_status status;
    tape *nested[2]; /* not recording, recording */
    tape_final_function on_final;
    void *on_final_user;
};

static const char *const op_names[OP_COUNT] = {
#define NAME(name) #name,
    OPS(NAME, NAME, NAME)};
static const bool op_differentiable[OP_COUNT] = {
#define YES(name) true,
#define NO(name) false,
    OPS(YES, NO, YES)};

const char *op_name(op_id op) {
    return op_names[op];
}

tape *tape_create(context *c, tape_options options) {
    tape *t = mem_zero(c, 1, sizeof *t);
    if (!t) return NULL;
    t->c = c;
    t->options = options;
    const tensor_memory *place = options.backend->memory;
    t->memory = arena_create(c);
    t->data = place ? arena_create_from(c, &place->source) : t->memory;
    t->scratch = t->data ? arena_create_from(c, place ? &place->source : NULL) : NULL;
    if (!t->memory || !t->scratch) {
        tape_free(t);
        return NULL;
    }
    return t;
}

static void release_owned(tape *t) {
    for (owned *o = t->owned; o; o = o->previous) o->release(o->object);
    t->owned = NULL;
}

bool tape_own(tape *t, void *object, void (*release)(void *object)) {
    owned *o = tape_alloc(t, 1, sizeof *o);
    if (!o) {
        release(object);
        return false;
    }
    *o = (owned){t->owned, object, release};
    t->owned = o;
    return true;
}

void tape_free(tape *t) {
    if (!t) return;
    release_owned(t);
    for (int i = 0; i < 2; i++) tape_free(t->nested[i]);
    if (t->data != t->memory) arena_free(t->data);
    arena_free(t->memory);
    arena_free(t->scratch);
    mem_free(t);
}

void tape_reset(tape *t) {
    release_owned(t);
    arena_reset(t->memory);
    if (t->data != t->memory) arena_reset(t->data);
    arena_reset(t->scratch);
    t->newest = NULL;
    t->spares = 0;
    t->status = SHERF_OK;
}

context *tape_context(tape *t) {
    return t->c;
}
const backend *tape_backend(const tape *t) {
    return t->options.backend;
}
bool tape_records(const tape *t) {
    return t->options.record;
}
tape_options tape_settings(const tape *t) {
    return t->options;
}
sherf_status tape_status(const tape *t) {
    return t->status;
}
size_t tape_peak(const tape *t) {
    return arena_peak(t->memory) + (t->data == t->memory ? 0 : arena_peak(t->data)) + arena_peak(t->scratch);
}

tensor *tape_fail(tape *t, sherf_status status, const char *format, ...) {
    if (t->status != SHERF_OK) return NULL; /* the first error stays */
    char text[512];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof text, format, args);
    va_end(args);
    t->status = failure(t->c, status, "%s", text);
    return NULL;
}

void *tape_alloc(tape *t, size_t count, size_t size) {
    if (t->status != SHERF_OK) return NULL;
    void *p = arena_alloc(t->c, t->memory, count, size);
    if (!p) t->status = SHERF_NO_MEMORY;
    return p;
}

arena *tape_scratch(tape *t) {
    return t->scratch;
}

/* Memory for kernels. */
static void *data_alloc(tape *t, size_t count, size_t size) {
    if (t->status != SHERF_OK) return NULL;
    void *p = arena_alloc(t->c, t->data, count, size);
    if (!p) t->status = SHERF_NO_MEMORY;
    return p;
}

static tensor *tensor_shell(tape *t, dtype type, int rank, const int64_t *dim) {
    tensor *x = tape_alloc(t, 1, sizeof *x);
    if (!x) return NULL;
    *x = (tensor){.type = type, .rank = rank, .memory = t->options.backend->memory};
    for (int i = 0; i < rank; i++) {
        if (dim[i] < 0) return tape_fail(t, SHERF_BAD_ARGUMENT, "a tensor of negative size");
        x->dim[i] = dim[i];
    }
    return x;
}

/* ---- memory that is free again ---- */
static size_t room_bytes(const tensor *x) {
    size_t bytes;
    if (__builtin_mul_overflow((size_t)tensor_count(x), dtype_size(x->type), &bytes) || bytes > SIZE_MAX / 2)
        return SIZE_MAX; /* no spare has that */
    return bytes ? (bytes + 63) / 64 * 64 : 64;
}

static tensor *base_of(tensor *x) {
    while (x && x->view_of) x = x->view_of;
    return x;
}

/* The beginning of the smallest spare that is large enough; NULL: there is none. */
static void *spare_take(tape *t, size_t bytes) {
    spare *best = NULL;
    for (int i = 0; i < t->spares; i++)
        if (t->spare[i].bytes >= bytes && (!best || t->spare[i].bytes < best->bytes)) best = &t->spare[i];
    if (!best) return NULL;
    void *data = best->data;
    best->data += bytes;
    best->bytes -= bytes;
    if (!best->bytes) *best = t->spare[--t->spares];
    return data;
}

/* Joins it with adjacent spares; if there is no slot, drops the smallest. */
static void spare_give(tape *t, char *data, size_t bytes) {
    for (int i = 0; i < t->spares;) {
        const spare s = t->spare[i];
        if (s.data + s.bytes != data && data + bytes != s.data) {
            i++;
            continue;
        }
        if (s.data < data) data = s.data;
        bytes += s.bytes;
        t->spare[i] = t->spare[--t->spares];
        i = 0;
    }
    int at = t->spares;
    if (at == SPARES) {
        for (int i = at = 0; i < SPARES; i++)
            if (t->spare[i].bytes < t->spare[at].bytes) at = i;
        if (t->spare[at].bytes >= bytes) return;
    } else
        t->spares++;
    t->spare[at] = (spare){data, bytes};
}

void tape_drop(tape *t, tensor *x) {
    x = base_of(x);
    if (!x || x->room != t || t->options.record || t->status != SHERF_OK) return;
    spare_give(t, x->data, room_bytes(x));
    x->data = NULL;
    x->room = NULL;
}

tensor *tape_instead(tape *t, tensor *y, tensor *x) {
    if (base_of(y) != base_of(x)) tape_drop(t, x);
    return y;
}

tensor *tape_tensor(tape *t, dtype type, int rank, const int64_t *dim) {
    tensor *x = tensor_shell(t, type, rank, dim);
    if (!x) return NULL;
    if (t->spares) x->data = spare_take(t, room_bytes(x));
    if (!x->data) x->data = data_alloc(t, (size_t)tensor_count(x), dtype_size(type));
    x->room = t;
    return x->data ? x : NULL;
}

/* False: the tape takes the status. */
static bool done(tape *t, sherf_status status) {
    if (status != SHERF_OK && t->status == SHERF_OK) t->status = status;
    return status == SHERF_OK;
}

tensor *tape_zeros(tape *t, dtype type, int rank, const int64_t *dim) {
    tensor *x = tape_tensor(t, type, rank, dim);
    return x && done(t, tensor_clear(t->c, x)) ? x : NULL;
}

tensor *tape_input(tape *t, const float *data, int rank, const int64_t *dim) {
    tensor *x = tape_tensor(t, t->options.backend->real, rank, dim);
    if (!x) return NULL;
    if (x->type == T_F32) return done(t, tensor_upload(t->c, x, data)) ? x : NULL;
    for (int64_t i = 0, n = tensor_count(x); i < n; i++) ((double *)x->data)[i] = data[i];
    return x;
}

tensor *tape_input_i32(tape *t, const int32_t *data, int rank, const int64_t *dim) {
    tensor *x = tape_tensor(t, T_I32, rank, dim);
    return x && done(t, tensor_upload(t->c, x, data)) ? x : NULL;
}

tensor *tape_constant(tape *t, dtype type, int rank, const int64_t *dim, const void *data) {
    if (t->options.backend->memory) {
        tensor *x = tape_tensor(t, type, rank, dim);
        return x && done(t, tensor_upload(t->c, x, data)) ? x : NULL;
    }
    tensor *x = tensor_shell(t, type, rank, dim);
    if (x) x->data = only_read(data); /* kernels do not write into inputs without gradient */
    return x;
}

double tape_value(tape *t, const tensor *x) {
    union {
        float f;
        double d;
    } v;
    if (!x || t->status != SHERF_OK || !done(t, tensor_download(t->c, x, &v))) return NAN;
    return x->type == T_F64 ? v.d : (double)v.f;
}

tape *tape_nested(tape *t, bool record) {
    if (t->status != SHERF_OK) return NULL;
    if (!t->nested[record]) {
        tape_options options = t->options;
        options.record = record;
        t->nested[record] = tape_create(t->c, options);
        if (!t->nested[record]) t->status = SHERF_NO_MEMORY;
    }
    return t->nested[record];
}

tensor *tape_reshape(tape *t, tensor *x, int rank, const int64_t *dim) {
    if (!x) return NULL;
    tensor *y = tensor_shell(t, x->type, rank, dim);
    if (!y) return NULL;
    if (tensor_count(y) != tensor_count(x)) {
        char a[64], b[64];
        tensor_shape_text(x, a);
        tensor_shape_text(y, b);
        return tape_fail(t, SHERF_BAD_ARGUMENT, "reshape of %s to %s", a, b);
    }
    y->data = x->data;
    y->memory = x->memory;
    y->needs_grad = x->needs_grad;
    y->view_of = x;
    return y;
}

/* *fresh: it was made here and is not cleared. */
static tensor *grad_uncleared(tape *t, tensor *x, bool *fresh) {
    if (x->grad) return x->grad;
    tensor *g;
    if (x->view_of) {
        tensor *base = grad_uncleared(t, x->view_of, fresh);
        g = base ? tensor_shell(t, x->type, x->rank, x->dim) : NULL;
        if (g) {
            g->data = base->data;
            g->memory = base->memory;
        }
    } else {
        g = tape_tensor(t, x->type, x->rank, x->dim);
        *fresh = true;
    }
    return x->grad = g;
}

tensor *tape_grad(tape *t, tensor *x) {
    bool fresh = false;
    tensor *g = grad_uncleared(t, x, &fresh);
    return g && (!fresh || done(t, tensor_clear(t->c, g))) ? g : NULL;
}

static sherf_status run(tape *t, kernel k, op_call *call) {
    call->c = t->c;
    call->scratch = t->scratch;
    call->bf16 = t->options.bf16;
    call->training = t->options.training || t->options.batch_statistics;
    arena_mark mark = arena_position(t->scratch);
    sherf_status status = k(call);
    arena_rewind(t->scratch, mark);
    return status;
}

static bool refuse(tape *t, op_id op, tensor *const *in, const char *what) {
    char shape[64] = "";
    if (in[0]) tensor_shape_text(in[0], shape);
    tape_fail(t, SHERF_UNSUPPORTED, "the %s backend has no %s of %s for %s", t->options.backend->name, what,
              op_names[op], shape);
    return false;
}

/* Whether every tensor is in the memory of the backend's kernels. */
static bool within_reach(tape *t, op_id op, int inputs, tensor *const *in) {
    const tensor_memory *here = t->options.backend->memory;
    for (int i = 0; i < inputs; i++) {
        if (!in[i] || in[i]->memory == here) continue;
        char shape[64];
        tensor_shape_text(in[i], shape);
        tape_fail(t, SHERF_BAD_ARGUMENT, "%s: input %d %s lies in %s memory, the %s backend's in %s",
                  op_names[op], i, shape, in[i]->memory ? in[i]->memory->name : "the host's",
                  t->options.backend->name, here ? here->name : "the host's");
        return false;
    }
    return true;
}

static node *node_push(tape *t) {
    node *n = tape_alloc(t, 1, sizeof *n);
    if (!n) return NULL;
    *n = (node){.previous = t->newest};
    t->newest = n;
    return n;
}

bool tape_call(tape *t, op_id op, int inputs, tensor *const *in, int outputs, tensor *const *out,
               const void *attr, size_t attr_bytes, size_t saved_bytes) {
    if (t->status != SHERF_OK) return false;
    kernel forward = t->options.backend->forward[op];
    if (!forward) return refuse(t, op, in, "kernel");
    if (!within_reach(t, op, inputs, in)) return false;
    op_call call = {.op = op};
    bool wanted = false;
    for (int i = 0; i < inputs; i++) {
        call.in[i] = in[i];
        if (in[i] && in[i]->needs_grad) wanted = true;
    }
    for (int i = 0; i < outputs; i++) call.out[i] = out[i];
    wanted = wanted && t->options.record && op_differentiable[op];
    if (wanted && !t->options.backend->backward[op]) return refuse(t, op, in, "gradient");
    call.attr = attr;
    if (saved_bytes && !(call.saved = data_alloc(t, saved_bytes, 1))) return false;
    sherf_status status = run(t, forward, &call);
    if (status != SHERF_OK) {
        t->status = status;
        return false;
    }
    if (!wanted) return true;
    node *n = node_push(t);
    void *copy = attr_bytes ? tape_alloc(t, attr_bytes, 1) : NULL;
    if (!n || (attr_bytes && !copy)) return false;
    if (copy) memcpy(copy, attr, attr_bytes);
    n->op = op;
    n->attr = copy;
    n->saved = call.saved;
    memcpy(n->in, call.in, sizeof n->in);
    memcpy(n->out, call.out, sizeof n->out);
    for (int i = 0; i < outputs; i++) out[i]->needs_grad = true;
    return true;
}

void tape_record(tape *t, tape_backward_function backward, void *payload) {
    node *n = node_push(t);
    if (!n) return;
    n->backward = backward;
    n->payload = payload;
}

static sherf_status node_backward(tape *t, node *n) {
    if (n->backward) return n->backward(t, n->payload);
    op_call call = {.op = n->op, .attr = n->attr, .saved = n->saved};
    bool any = false;
    for (int i = 0; i < OP_MAX_OUT; i++) {
        call.out[i] = n->out[i];
        call.dout[i] = n->out[i] ? n->out[i]->grad : NULL;
        if (call.dout[i]) any = true;
    }
    if (!any) return SHERF_OK;
    for (int i = 0; i < OP_MAX_IN; i++) {
        call.in[i] = n->in[i];
        if (!n->in[i] || !n->in[i]->needs_grad) continue;
        if (!(call.din[i] = grad_uncleared(t, n->in[i], &call.fresh[i]))) return t->status;
        if (!call.fresh[i] || t->options.backend->writes[n->op] >> i & 1) continue;
        if (!done(t, tensor_clear(t->c, call.din[i]))) return t->status;
        call.fresh[i] = false;
    }
    return run(t, t->options.backend->backward[n->op], &call);
}

/* ---- final gradients ---- */
void tape_on_final(tape *t, tape_final_function f, void *user) {
    t->on_final = f;
    t->on_final_user = user;
}

/* The parameter that a node reads, itself or through a view; NULL: x is none. */
static tensor *parameter_of(tensor *x) {
    while (x && x->view_of) x = x->view_of;
    return x && x->name && x->needs_grad ? x : NULL;
}

/* Custom nodes may read any parameter, so nothing is final before the oldest of them: that one, or else the
 * oldest node that reads it, is a parameter's first use. */
static const node *first_uses(tape *t) {
    const node *oldest = NULL;
    for (const node *n = t->newest; n; n = n->previous)
        if (n->backward) oldest = n;
    bool after = oldest != NULL; /* n is newer than it */
    for (const node *n = t->newest; n; n = n->previous) {
        if (n == oldest) after = false;
        for (int i = 0; i < OP_MAX_IN && !n->backward; i++) {
            tensor *p = parameter_of(n->in[i]);
            if (p) p->first_use = after ? oldest : n;
        }
    }
    return oldest;
}

/* Among the nodes from `n` to older ones, up to `end`: reports the parameters that are final after `at`. */
static void tell_final(tape *t, const node *n, const node *end, const node *at) {
    for (; n != end; n = n->previous)
        for (int i = 0; i < OP_MAX_IN && !n->backward; i++) {
            tensor *p = parameter_of(n->in[i]);
            if (!p || p->first_use != at) continue;
            p->first_use = NULL;
            t->on_final(t->on_final_user, p);
        }
}

sherf_status tape_backward_seeded(tape *t) {
    const node *oldest = t->on_final ? first_uses(t) : NULL;
    if (t->on_final && !oldest) t->on_final(t->on_final_user, NULL);
    for (node *n = t->newest; n && t->status == SHERF_OK; n = n->previous) {
        sherf_status status = node_backward(t, n);
        if (status != SHERF_OK)
            t->status = status;
        else if (t->on_final && n == oldest) {
            tell_final(t, t->newest, n, n);
            t->on_final(t->on_final_user, NULL);
        } else if (t->on_final)
            tell_final(t, n, n->previous, n);
    }
    return t->status;
}

sherf_status tape_backward(tape *t, tensor *loss, double scale) {
    if (t->status != SHERF_OK) return t->status;
    const double before = loss->grad ? tape_value(t, loss->grad) : 0;
    tensor *g = tape_grad(t, loss);
    if (!g) return t->status;
    const double d = before + scale;
    const float f = (float)before + (float)scale;
    if (!done(t, tensor_upload(t->c, g, g->type == T_F64 ? (const void *)&d : &f))) return t->status;
    return tape_backward_seeded(t);
}
