/* Shared by the fuzz targets. A target accepts any input; it visits everything that a reader returns and
 * reads it to the last byte. Nothing may leak, and a failure must have a message. */
#ifndef FUZZ_H
#define FUZZ_H

#include <stdlib.h>

#include "io/image.h"
#include "io/safetensors.h"
#include "io/value.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static inline context *fuzz_context(void) {
    static const sherf_options alone = {.threads =
                                            1}; /* one thread: there is a target on every core already */
    static sherf_context *c;
    if (!c && sherf_context_create(&alone, &c) != SHERF_OK) abort();
    c->message[0] = 0;
    return c;
}

static inline uint64_t fuzz_sum(const void *data, size_t bytes) {
    uint64_t sum = 0;
    for (size_t i = 0; i < bytes; i++) sum = sum * 31 + ((const uint8_t *)data)[i];
    return sum;
}

/* Trees share parts, so the traversal is bounded. It may recurse, because finished trees have limited depth.
 */
static inline void fuzz_walk(const value *v, size_t *visits, uint64_t *sum) {
    if (!v || ++*visits > 100000) return;
    size_t n = 1;
    switch (v->kind) {
    case VALUE_STRING:
        *sum += fuzz_sum(v->string.text, v->string.length + 1);
        break;
    case VALUE_ARRAY:
        for (int i = 0; i < v->array.rank; i++)
            if (!v->array.dim[i]) n = 0;
        for (int i = 0; i < v->array.rank && n; i++) n *= (size_t)v->array.dim[i];
        *sum += fuzz_sum(v->array.data, n * dtype_size(v->array.type));
        break;
    case VALUE_LIST:
        for (size_t i = 0; i < v->list.count; i++) fuzz_walk(v->list.item[i], visits, sum);
        break;
    case VALUE_DICT:
        for (size_t i = 0; i < v->dict.count; i++) {
            fuzz_walk(v->dict.pair[i].key, visits, sum);
            fuzz_walk(v->dict.pair[i].item, visits, sum);
        }
        break;
    case VALUE_RECORD:
        fuzz_walk(v->record.arguments, visits, sum);
        fuzz_walk(v->record.state, visits, sum);
        break;
    default:
        break;
    }
}

/* Ends one round. live: mem_live() at its beginning. */
static inline int fuzz_end(context *c, sherf_status status, size_t live) {
    if (status != SHERF_OK && !c->message[0]) abort();
    if (mem_live() != live) abort();
    return 0;
}

static inline int fuzz_document(context *c, sherf_status status, document *d, size_t live) {
    volatile uint64_t sum = 0;
    if ((status == SHERF_OK) != (d != NULL)) abort();
    if (d) {
        size_t visits = 0;
        uint64_t s = 0;
        fuzz_walk(d->root, &visits, &s);
        sum = s + (uint64_t)value_numbers(d->root) + (value_get(d->root, "K") != NULL);
        document_free(d);
    }
    (void)sum;
    return fuzz_end(c, status, live);
}

static inline int fuzz_picture(const uint8_t *data, size_t size) {
    context *c = fuzz_context();
    size_t live = mem_live();
    image_u8 p;
    volatile uint64_t sum;
    sherf_status status = image_parse(c, data, size, size % 2 ? 3 : 1, &p);
    if ((status == SHERF_OK) != (p.data != NULL)) abort();
    sum = p.data ? fuzz_sum(p.data, (size_t)p.width * (size_t)p.height * (size_t)p.channels) : 0;
    (void)sum;
    mem_free(p.data);
    return fuzz_end(c, status, live);
}
#endif
