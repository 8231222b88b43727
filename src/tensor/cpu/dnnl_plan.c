/* Keeps and runs oneDNN's primitives for conv2d and conv2d_transpose. They are found by shape under one lock;
 * if all slots are taken, the least recently used one is freed. */
#include <omp.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "tensor/cpu/dnnl_plan.h"

/* Enough for every shape in a network's forward and backward pass at two picture sizes. */
enum { PLANS = 512 };

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static plan *plans[PLANS];
static uint64_t now;
static dnnl_engine_t engine;

static void plan_clear(plan *p) {
    if (p->main) dnnl_primitive_destroy(p->main);
    if (p->weights) dnnl_primitive_destroy(p->weights);
    if (p->main_desc) dnnl_primitive_desc_destroy(p->main_desc);
    if (p->weights_desc) dnnl_primitive_desc_destroy(p->weights_desc);
    free(p);
}

/* Runs before oneDNN's own statics are destroyed, since they were made before this was registered. */
static void forget_all(void) {
    pthread_mutex_lock(&lock);
    for (int i = 0; i < PLANS; i++) {
        if (plans[i] && !plans[i]->users) plan_clear(plans[i]);
        plans[i] = NULL;
    }
    if (engine) dnnl_engine_destroy(engine);
    engine = NULL;
    pthread_mutex_unlock(&lock);
}

static void mask_set(void) {
    static const dnnl_cpu_isa_t isa[] = {[ISA_PLAIN] = dnnl_cpu_isa_sse41,
                                         [ISA_NEON] = dnnl_cpu_isa_all,
                                         [ISA_AVX2] = dnnl_cpu_isa_avx2,
                                         [ISA_AVX512] = dnnl_cpu_isa_avx512_core,
                                         [ISA_AMX] = dnnl_cpu_isa_avx512_core_amx};
    dnnl_set_max_cpu_isa(isa[isa_best()]);
}

void dnnl_mask(void) {
    static pthread_once_t once = PTHREAD_ONCE_INIT;
    pthread_once(&once, mask_set);
}

bool dnnl_room(void) {
    return mem_room((size_t)32 << 20); /* a primitive has dozens of kernels of up to 256 KiB */
}

/* Under the lock. */
static bool engine_ready(void) {
    if (engine) return true;
    dnnl_mask();
    if (dnnl_engine_create(&engine, dnnl_cpu, 0) != dnnl_success) {
        engine = NULL;
        return false;
    }
    atexit(forget_all);
    return true;
}

dnnl_engine_t plan_engine(void) {
    pthread_mutex_lock(&lock);
    dnnl_engine_t ready = engine_ready() ? engine : NULL;
    pthread_mutex_unlock(&lock);
    return ready;
}

/* Under the lock: the slot for a new plan, which is the least recently used one's; -1 if all are running. */
static int slot_free(void) {
    int best = -1;
    for (int i = 0; i < PLANS; i++) {
        if (!plans[i]) return i;
        if (!plans[i]->users && (best < 0 || plans[i]->used < plans[best]->used)) best = i;
    }
    return best;
}

/* Under the lock. */
static plan *plan_find(const plan_key *key) {
    for (int i = 0; i < PLANS && plans[i]; i++)
        if (!memcmp(&plans[i]->key, key, sizeof *key)) return plans[i];
    return NULL;
}

static sherf_status plan_make(context *c, const plan_key *key, plan_build *build, plan **out) {
    plan *p = calloc(1, sizeof *p); /* not the context's memory: the plan outlives it */
    if (!p || !dnnl_room()) {
        free(p);
        return failure(c, SHERF_NO_MEMORY, "out of memory: a convolution's plan");
    }
    p->key = *key;
    dnnl_status_t status = build(p, engine);
    if (status == dnnl_success) {
        *out = p;
        return SHERF_OK;
    }
    plan_clear(p);
    if (status == dnnl_unimplemented) return SHERF_UNSUPPORTED;
    return failure(c, SHERF_NO_MEMORY, "oneDNN: status %d while making a convolution", (int)status);
}

/* Under the lock. */
static sherf_status plan_get(context *c, const plan_key *key, plan_build *build, plan **out) {
    if (!engine_ready()) return failure(c, SHERF_NO_MEMORY, "oneDNN: no engine");
    if ((*out = plan_find(key))) return SHERF_OK;
    const int slot = slot_free();
    if (slot < 0) return failure(c, SHERF_NO_MEMORY, "more than %d convolutions at once", PLANS);
    sherf_status status = plan_make(c, key, build, out);
    if (status != SHERF_OK) return status;
    if (plans[slot]) plan_clear(plans[slot]);
    plans[slot] = *out;
    return SHERF_OK;
}

sherf_status plan_acquire(context *c, const plan_key *key, plan_build *build, plan **out) {
    pthread_mutex_lock(&lock);
    sherf_status status = plan_get(c, key, build, out);
    if (status == SHERF_OK) {
        (*out)->users++;
        (*out)->used = ++now;
    }
    pthread_mutex_unlock(&lock);
    return status;
}

void plan_release(plan *p) {
    pthread_mutex_lock(&lock);
    p->users--;
    pthread_mutex_unlock(&lock);
}

int threads_set(int n) {
    const int before = omp_get_max_threads();
    if (n != before) omp_set_num_threads(n);
    return before;
}

dnnl_status_t plan_execute(dnnl_primitive_t primitive, dnnl_engine_t on, int count, const plan_arg *args) {
    dnnl_exec_arg_t list[PLAN_ARGS];
    dnnl_memory_t memory[PLAN_ARGS] = {NULL};
    dnnl_stream_t stream = NULL;
    dnnl_status_t status = dnnl_success;
    for (int i = 0; i < count && status == dnnl_success; i++) {
        status = dnnl_memory_create(&memory[i], args[i].desc, on, args[i].data);
        list[i] = (dnnl_exec_arg_t){args[i].arg, memory[i]};
    }
    if (status == dnnl_success) status = dnnl_stream_create(&stream, on, dnnl_stream_default_flags);
    if (status == dnnl_success) status = dnnl_primitive_execute(primitive, stream, count, list);
    if (status == dnnl_success) status = dnnl_stream_wait(stream);
    if (stream) dnnl_stream_destroy(stream);
    for (int i = 0; i < count; i++)
        if (memory[i]) dnnl_memory_destroy(memory[i]);
    return status;
}

sherf_status plan_run(op_call *call, dnnl_primitive_t primitive, const dnnl_memory_desc_t *scratch, int count,
                      const plan_arg *args) {
    plan_arg all[PLAN_ARGS];
    memcpy(all, args, (size_t)count * sizeof *args);
    size_t bytes = scratch ? dnnl_memory_desc_get_size(scratch) : 0;
    if (bytes) {
        void *space = arena_alloc(call->c, call->scratch, bytes, 1);
        if (!space) return SHERF_NO_MEMORY;
        all[count++] = (plan_arg){DNNL_ARG_SCRATCHPAD, scratch, space};
    }
    const int threads = threads_set(call->c->threads);
    const dnnl_status_t status = plan_execute(primitive, engine, count, all);
    threads_set(threads);
    if (status == dnnl_success) return SHERF_OK;
    return failure(call->c, SHERF_NO_MEMORY, "oneDNN: status %d in a convolution", (int)status);
}
