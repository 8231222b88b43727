/* Blocks: by mem_*, memcpy and memset in the host's memory, by a memory's own functions elsewhere. */
#include <string.h>

#include "tensor/block.h"

void *block_take(context *c, const tensor_memory *memory, size_t count, size_t size) {
    size_t bytes;
    if (!memory) return mem_zero(c, count, size);
    if (__builtin_mul_overflow(count, size, &bytes)) {
        failure(c, SHERF_NO_MEMORY, "out of memory: %zu x %zu bytes is too much", count, size);
        return NULL;
    }
    void *block = memory->source.take(c, bytes ? bytes : 1);
    if (!block || memory->clear(c, block, bytes) == SHERF_OK) return block;
    memory->source.give(block);
    return NULL;
}

void block_give(const tensor_memory *memory, void *block) {
    if (memory && block)
        memory->source.give(block);
    else
        mem_free(block);
}

sherf_status block_upload(context *c, const tensor_memory *memory, void *to, const void *from, size_t bytes) {
    if (memory) return memory->upload(c, to, from, bytes);
    memcpy(to, from, bytes);
    return SHERF_OK;
}

sherf_status block_download(context *c, const tensor_memory *memory, void *to, const void *from,
                            size_t bytes) {
    if (memory) return memory->download(c, to, from, bytes);
    memcpy(to, from, bytes);
    return SHERF_OK;
}

sherf_status block_copy(context *c, const tensor_memory *memory, void *to, const void *from, size_t bytes) {
    if (memory) return memory->copy(c, to, from, bytes);
    memcpy(to, from, bytes);
    return SHERF_OK;
}

sherf_status block_clear(context *c, const tensor_memory *memory, void *to, size_t bytes) {
    if (memory) return memory->clear(c, to, bytes);
    memset(to, 0, bytes);
    return SHERF_OK;
}
