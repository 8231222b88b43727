/* torch: shared by the forms of torch.save's files (torch.c, torch_legacy.c) and its tensors. */
#ifndef SHERF_TORCH_H
#define SHERF_TORCH_H

#include "io/pickle.h"

enum { TORCH_BUCKETS = 4096 };

typedef struct {
    torch_storage *bucket[TORCH_BUCKETS]; /* lists by the key's hash */
} torch_storages;
torch_storage *torch_storage_find(const torch_storages *t, const char *key); /* NULL: none */
/* The storage with this key, made if it is new. NULL: failed. */
torch_storage *torch_storage_named(torch_storages *t, builder *b, dtype type, const char *key, int64_t count);

/* Whether the data start like a stream of torch.save before 1.6. */
bool torch_legacy_is(const unsigned char *data, size_t bytes);

#endif
