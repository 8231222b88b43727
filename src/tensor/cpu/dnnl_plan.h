/* oneDNN behind a cache: a plan is a primitive for one shape together with its weights' reorder, made once
 * and kept. For cpu/dnnl_*.c only. */
#ifndef SHERF_DNNL_PLAN_H
#define SHERF_DNNL_PLAN_H

#include <dnnl.h>

#include "tensor/cpu/cpu.h"

typedef enum { PASS_FORWARD, PASS_DATA, PASS_WEIGHTS, PASS_COUNT } plan_pass;

/* A plan's key; 4-byte fields only, compared as bytes. */
typedef struct {
    int32_t transpose; /* transposed convolution */
    int32_t pass;
    int32_t bf16;
    int32_t threads; /* oneDNN splits its work for a thread count when it makes the primitive */
    int32_t H, W, I; /* the input x [H, W, I] */
    int32_t O, k, stride, pad;
    float gain;
} plan_key;

typedef struct {
    dnnl_primitive_desc_t main_desc, weights_desc;
    dnnl_primitive_t main, weights; /* weights: OIHW to the packed form, or back, adding, in PASS_WEIGHTS */
    const dnnl_memory_desc_t *x, *w, *y, *scratch, *weights_scratch; /* of main; owned by the descs */
    dnnl_memory_desc_t w_plain;
    plan_key key;
    int users;     /* calls that are running it */
    uint64_t used; /* the cache's clock at its last use; 0: the slot is free */
} plan;

/* Fills in the primitives of p for p->key. */
typedef dnnl_status_t plan_build(plan *p, dnnl_engine_t engine);
/* Finds or makes the plan. SHERF_UNSUPPORTED, without a message: oneDNN has no implementation. */
sherf_status plan_acquire(context *c, const plan_key *key, plan_build *build, plan **out);
void plan_release(plan *p);

/* Limits oneDNN to SHERF_ISA's instructions, like our own kernels. Must precede any other call of oneDNN,
 * which reads the mask once. */
void dnnl_mask(void);
/* Whether there is memory for the code that oneDNN is about to write: it writes through NULL if it gets none.
 */
bool dnnl_room(void);
/* oneDNN's engine on this processor, limited to SHERF_ISA; it lives until the process ends. NULL: none. */
dnnl_engine_t plan_engine(void);

/* Sets the number of threads for the OpenMP regions that oneDNN opens from here; returns the previous one. */
int threads_set(int n);

/* One argument of a primitive: its number, layout and address. */
typedef struct {
    int arg;
    const dnnl_memory_desc_t *desc;
    void *data;
} plan_arg;
enum { PLAN_ARGS = 6 }; /* maximum for a primitive */
/* Runs a primitive and waits for it. */
dnnl_status_t plan_execute(dnnl_primitive_t primitive, dnnl_engine_t engine, int count, const plan_arg *args);
/* Runs a primitive with its scratchpad taken from the call's scratch; waits for it. */
sherf_status plan_run(op_call *call, dnnl_primitive_t primitive, const dnnl_memory_desc_t *scratch, int count,
                      const plan_arg *args);
#endif
