/* tensor: arrays with a shape, the tape that records ops, and the table of kernels per backend.
 *
 * Layout inside the engine: everything is "rows x channels", channels last. Images and feature maps are
 * [H, W, C], points [P, C], voxels [A, C], tokens [P, T, D] (= [P, T*D]). There is no batch dimension: one
 * sample at a time, as batch norms take one picture's statistics. Weights keep the checkpoints' shapes (conv
 * [O, I, k, k], linear [O, I], sparse conv [O, 3, 3, 3, I]). A tensor is contiguous. `real` tensors have the
 * tape's type (F32, or F64 for the gradient checks); index tensors are I32. */
#ifndef SHERF_TENSOR_H
#define SHERF_TENSOR_H

#include "base/base.h"
#include "tensor/ops.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum { T_F32, T_F64, T_I32, T_I64, T_U8, T_BF16, T_F16 } dtype;
enum { TENSOR_RANK = 5 };

/* Memory for tensors that host code cannot read: a GPU's. NULL means the host's own. Work runs in the order
 * of the calls, kernels included; only download waits for it. */
struct block_kernels; /* tensor/block.h */
struct block_groups;
typedef struct {
    const char *name; /* "CUDA" */
    memory_source source;
    sherf_status (*upload)(context *c, void *to, const void *from,
                           size_t bytes); /* from the host's memory, which may change afterwards */
    sherf_status (*download)(context *c, void *to, const void *from, size_t bytes);
    sherf_status (*copy)(context *c, void *to, const void *from, size_t bytes); /* within */
    sherf_status (*clear)(context *c, void *to, size_t bytes);                  /* zeroes */
    size_t (*peak)(void); /* the peak of the bytes in use */
    const struct block_kernels *blocks;
    const struct block_groups *groups; /* sums over processes */
} tensor_memory;

struct tensor {
    dtype type;
    int rank;
    int64_t dim[TENSOR_RANK];
    void *data;
    const tensor_memory *memory; /* of data; NULL: the host's */
    bool needs_grad;             /* a parameter, or computed from one while the tape records */
    tensor *grad;                /* same shape; NULL before the first addition */
    tensor *view_of;             /* tape_reshape: the tensor whose data and gradient data this one shares */
    const void *room;            /* the tape that owns its memory (tape_tensor); NULL: another owner */
    const char *name;            /* parameters only, for messages */
    const void *first_use; /* parameters only, during a backward pass: the step after which its gradient is
                              final; NULL: unknown, or passed */
};

size_t dtype_size(dtype t);
const char *dtype_name(dtype t);
int64_t tensor_count(const tensor *t);
int64_t tensor_columns(const tensor *t); /* last dimension (1 for rank 0) */
int64_t tensor_rows(const tensor *t);    /* product of the others */
bool tensor_same_shape(const tensor *a, const tensor *b);
void tensor_shape_text(const tensor *t, char text[64]); /* "[3, 4]" */
static inline float *tensor_f32(const tensor *t) {
    return (float *)t->data;
}
static inline int32_t *tensor_i32(const tensor *t) {
    return (int32_t *)t->data;
}

/* Copies between a tensor and the host, and between two tensors in one memory. */
sherf_status tensor_upload(context *c, tensor *to, const void *from);
sherf_status tensor_download(context *c, const tensor *from, void *to);
sherf_status tensor_clear(context *c, tensor *x); /* zeroes */
/* Copies `rows` rows; columns and type must be the same. */
sherf_status tensor_copy_rows(context *c, tensor *to, int64_t to_begin, const tensor *from,
                              int64_t from_begin, int64_t rows);

/* A tensor on the heap, zeroed (parameters, file contents). */
tensor *tensor_create(context *c, dtype type, int rank, const int64_t *dim);
void tensor_free(tensor *t); /* and its grad */
/* Moves such a tensor's values from host memory to another memory, before it has a gradient. NULL: it stays.
 */
sherf_status tensor_place(context *c, tensor *t, const tensor_memory *memory);

/* ---- ops by number ---- */
typedef enum {
#define OP_NUMBER(name) OP_##name,
    OPS(OP_NUMBER, OP_NUMBER, OP_NUMBER)
#undef OP_NUMBER
        OP_COUNT
} op_id;
const char *op_name(op_id op);
enum { OP_MAX_IN = 8, OP_MAX_OUT = 3, OP_MAX_ATTR = 96 };

/* One call of a kernel. Forward: reads in[], attr, and writes every out[] (uninitialised before). Backward:
 * reads in[], out[], dout[] (NULL if no gradient arrived: it is zero), and ADDS to din[i] if it is not NULL,
 * in the order of i if two are the same. `saved` is a buffer of saved_bytes that the forward kernel may fill
 * for the backward one (the op's shape rule sets the sizes). Kernels take scratch memory from `scratch`,
 * which the caller rewinds after the kernel. */
typedef struct op_call {
    context *c;
    op_id op;
    tensor *in[OP_MAX_IN]; /* NULL: optional input not given */
    tensor *out[OP_MAX_OUT];
    tensor *din[OP_MAX_IN];
    bool fresh[OP_MAX_IN]; /* din[i] is uninitialised: the kernel writes every value and adds to none */
    tensor *dout[OP_MAX_OUT];
    const void *attr; /* the op's attr struct from ops.h */
    void *saved;
    arena *scratch;
    bool bf16;     /* products may be taken in bf16 with float32 sums */
    bool training; /* batch norms use and update batch statistics */
} op_call;

typedef sherf_status (*kernel)(op_call *call);
typedef struct {
    const char *name;
    dtype real;
    const tensor_memory *memory; /* where its kernels' tensors are, saved and scratch too; NULL: the host's */
    kernel forward[OP_COUNT]; /* NULL: this backend cannot do the op; the error names the op and its shapes */
    kernel backward[OP_COUNT]; /* NULL for ops declared non-differentiable */
    unsigned writes[OP_COUNT]; /* bit i: the backward kernel obeys fresh[i]; else the tape clears din[i] */
} backend;
extern const backend backend_ref_f32; /* plain C, the definition of every op */
extern const backend backend_ref_f64; /* the same source in double */
extern const backend backend_cuda;    /* in builds with SHERF_CUDA only; docs/cuda.md */
extern const backend backend_cpu; /* oneDNN, SIMD, OpenMP; float32, products in bf16 where the tape says so */
const backend *backend_of(const context *c); /* of the context's device */
void backend_stand_in(const backend *gpu);   /* for tests: the backend of GPU contexts from now on */

/* ---- the tape ---- */
typedef struct {
    const backend *backend;
    bool record;   /* record what the backward pass needs */
    bool training; /* batch norms */
    bool bf16;
    bool batch_statistics; /* batch norms use statistics of their input, as in training, and keep the running
                              ones */
} tape_options;
tape *tape_create(context *c, tape_options options);
void tape_free(tape *t);
void tape_reset(tape *t); /* forgets everything recorded, frees its memory in O(1), clears its status */
context *tape_context(tape *t);
const backend *tape_backend(const tape *t);
bool tape_records(const tape *t);
tape_options tape_settings(const tape *t);
sherf_status
tape_status(const tape *t); /* The first error of any op since the reset. Ops after it do nothing. */
/* Puts an error on the tape (if a shape rule does not hold) and returns NULL. */
tensor *tape_fail(tape *t, sherf_status status, const char *format, ...) PRINTF_LIKE(3, 4);
size_t tape_peak(const tape *t); /* bytes */

/* A tensor in the tape's arena, which is in the backend's memory (not zeroed; valid until the reset). NULL if
 * the tape has failed. Ops take only tensors of that memory. */
tensor *tape_tensor(tape *t, dtype type, int rank, const int64_t *dim);
tensor *tape_zeros(tape *t, dtype type, int rank, const int64_t *dim);
/* Copies a float32 array into a real tensor of the tape's type. */
tensor *tape_input(tape *t, const float *data, int rank, const int64_t *dim);
tensor *tape_input_i32(tape *t, const int32_t *data, int rank, const int64_t *dim);
tensor *tape_reshape(tape *t, tensor *x, int rank, const int64_t *dim); /* same data and gradient data */
/* Host values that their owner keeps at least until the reset: read in place if the backend can, otherwise
 * copied. They have no gradient. */
tensor *tape_constant(tape *t, dtype type, int rank, const int64_t *dim, const void *data);
/* Declares that x is no longer read. If the tape does not record, later tensors reuse its memory, which is in
 * the caches and whose pages the system has cleared already. Does nothing for NULL and for tensors of another
 * tape. */
void tape_drop(tape *t, tensor *x);
/* Returns y, which was computed from x; drops x. */
tensor *tape_instead(tape *t, tensor *y, tensor *x);
/* Where kernels take scratch, in the backend's memory: a custom node rewinds it at its end. */
arena *tape_scratch(tape *t);
void *tape_alloc(tape *t, size_t count, size_t size); /* plain host memory with the same lifetime */
/* The value of a scalar: waits for it. NaN for NULL and when the tape has failed. */
double tape_value(tape *t, const tensor *x);

/* Releases the object at the reset, or now if it cannot be recorded (false, the status of `t`). */
bool tape_own(tape *t, void *object, void (*release)(void *object));

/* A tape inside this one, with the same backend and settings but its own memory, for work that is thrown away
 * or repeated in the backward pass. Owned by `t`, one that records and one that does not; reset it before
 * use. Its ops may read tensors of `t` and add to their gradients, which must exist (tape_grad on `t`)
 * before. NULL: out of memory (the status of `t`). */
tape *tape_nested(tape *t, bool record);

/* Runs the op's forward kernel and records it. For ref/rules.c only. Copies attr. */
bool tape_call(tape *t, op_id op, int inputs, tensor *const *in, int outputs, tensor *const *out,
               const void *attr, size_t attr_bytes, size_t saved_bytes);
/* Records a custom node: `backward` is called in reverse order with `payload` (in the tape's arena); it reads
 * the gradients of its outputs and adds to those of its inputs through tape_grad. */
typedef sherf_status (*tape_backward_function)(tape *t, void *payload);
void tape_record(tape *t, tape_backward_function backward, void *payload);
/* The gradient of x, made and zeroed on first use; a parameter's gradient lives with the parameter. */
tensor *tape_grad(tape *t, tensor *x);
/* Called during a backward pass when nothing more will be added to a parameter's gradient; called once with
 * NULL when that holds for all parameters whose first_use is NULL. Concurrent passes must then not share
 * parameters' structs. f NULL: no calls. */
typedef void (*tape_final_function)(void *user, tensor *parameter);
void tape_on_final(tape *t, tape_final_function f, void *user);
/* Seeds d(loss)/d(loss) = scale (loss has one element) and runs the tape backwards. Gradients add up over
 * calls. */
sherf_status tape_backward(tape *t, tensor *loss, double scale);
/* The same, from gradients that were already set on tensors with tape_grad. */
sherf_status tape_backward_seeded(tape *t);

#ifdef __cplusplus
}
#endif
#endif
