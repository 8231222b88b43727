/* convert: the file under construction: its tensors, its metadata, and the memory of both. */
#include <stdio.h>
#include <string.h>

#include "io/convert.h"

char *convert_text(conversion *o, const char *format, ...) {
    char line[1024];
    va_list args;
    va_start(args, format);
    vsnprintf(line, sizeof line, format, args);
    va_end(args);
    size_t n = strlen(line) + 1;
    char *p = arena_alloc(o->c, o->memory, n, 1);
    if (p) memcpy(p, line, n);
    return p;
}

void *convert_memory(conversion *o, int64_t count, size_t size) {
    return arena_alloc(o->c, o->memory, (size_t)count, size);
}

void convert_describe(conversion *o, const char *key, const char *said) {
    if (said && o->metadata_count < COUNT_OF(o->metadata))
        o->metadata[o->metadata_count++] = (safetensor_metadata){key, said};
}

sherf_status convert_add(conversion *o, const char *name, dtype type, int rank, const int64_t *dim,
                         const void *data) {
    if (rank > TENSOR_RANK)
        return failure(o->c, SHERF_UNSUPPORTED, "tensor %s has more than %d dimensions", name, TENSOR_RANK);
    if (o->count == o->room) {
        size_t room = o->room ? o->room * 2 : 64;
        safetensor_item *grown = mem_grow(o->c, o->item, o->count, room, sizeof *grown);
        if (!grown) return SHERF_NO_MEMORY;
        o->item = grown;
        o->room = room;
    }
    safetensor_item *item = &o->item[o->count++];
    *item = (safetensor_item){.name = name, .type = type, .rank = rank, .data = data};
    for (int i = 0; i < rank; i++) item->dim[i] = dim[i];
    return SHERF_OK;
}
