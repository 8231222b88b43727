/* Fuzz target: safetensors. */
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    context *c = fuzz_context();
    size_t live = mem_live();
    safetensors *s;
    volatile uint64_t sum = 0;
    sherf_status status = safetensors_parse(c, data, size, &s);
    if ((status == SHERF_OK) != (s != NULL)) abort();
    for (size_t i = 0; s && i < s->count; i++) {
        const safetensor *t = &s->tensor[i];
        size_t n = dtype_size(t->type);
        for (int k = 0; k < t->rank; k++)
            if (!t->dim[k]) n = 0;
        for (int k = 0; k < t->rank && n; k++) n *= (size_t)t->dim[k];
        sum += fuzz_sum(t->data, n);
        if (safetensors_find(s, t->name) != t) abort();
    }
    (void)sum;
    safetensors_free(s);
    return fuzz_end(c, status, live);
}
