/* torch: streams of torch.save before 1.6: four pickles, the list of storage keys, then each key's count and
 * bytes. */
#include <string.h>

#include "io/torch.h"

/* 0x1950a86a20f9469cfc6c as a pickled long, after the protocol (and frame) instructions. */
bool torch_legacy_is(const unsigned char *data, size_t bytes) {
    static const unsigned char magic[] = {0x8a, 10,   0x6c, 0xfc, 0x9c, 0x46, 0xf9,
                                          0x20, 0x6a, 0xa8, 0x50, 0x19, '.'};
    if (bytes < 2 + sizeof magic || data[0] != 0x80) return false;
    size_t start = data[2] == 0x95 ? 11 : 2;
    return bytes >= start + sizeof magic && !memcmp(data + start, magic, sizeof magic);
}

static torch_storage *legacy_storage(void *user, builder *b, dtype type, const char *key, int64_t count) {
    return torch_storage_named(user, b, type, key, count);
}

typedef struct {
    builder *b;
    const unsigned char *data;
    size_t bytes;
} stream;

static value *next_pickle(stream *s, const pickle_source *source) {
    size_t used = 0;
    value *v = pickle_build(s->b, s->data, s->bytes, source, &used);
    s->data += used;
    s->bytes -= used;
    return v;
}

static bool storage_bytes(stream *s, torch_storages *t, const value *key) {
    builder *b = s->b;
    uint64_t count = 0;
    value *text =
        key && key->kind == VALUE_STRING ? build_string(b, key->string.text, key->string.length) : NULL;
    torch_storage *storage = text ? torch_storage_find(t, text->string.text) : NULL;
    if (!storage) {
        build_fail(b, SHERF_BAD_FILE, "torch: a storage that nothing refers to");
        return false;
    }
    if (s->bytes < 8) {
        build_fail(b, SHERF_BAD_FILE, "torch: truncated");
        return false;
    }
    for (int i = 0; i < 8; i++) count |= (uint64_t)s->data[i] << 8 * i;
    s->data += 8;
    s->bytes -= 8;
    size_t unit = dtype_size(storage->type);
    if (count != (uint64_t)storage->count || count > s->bytes / unit) {
        build_fail(b, SHERF_BAD_FILE, "torch: storage %.40s is truncated or of another size", storage->key);
        return false;
    }
    storage->data = s->data;
    s->data += (size_t)count * unit;
    s->bytes -= (size_t)count * unit;
    return true;
}

value *torch_legacy_build(builder *b, const unsigned char *data, size_t bytes, int level) {
    if (!torch_legacy_is(data, bytes))
        return build_fail(b, SHERF_BAD_FILE, "torch: not a stream of torch.save");
    torch_storages *table = mem_zero(b->c, 1, sizeof *table);
    if (!table) {
        b->status = SHERF_NO_MEMORY;
        return NULL;
    }
    stream s = {b, data, bytes};
    const pickle_source plain = {.stream = torch_legacy_build, .level = level};
    const pickle_source source = {legacy_storage, table, torch_legacy_build, level};
    value *root = NULL, *magic = next_pickle(&s, &plain), *protocol = magic ? next_pickle(&s, &plain) : NULL;
    value *system = protocol ? next_pickle(&s, &plain) : NULL;
    const value *little = value_get(system, "little_endian");
    if (protocol && (protocol->kind != VALUE_INTEGER || protocol->integer != 1001))
        build_fail(b, SHERF_BAD_FILE, "torch: another protocol than 1001");
    if (little && little->kind == VALUE_BOOL && !little->boolean)
        build_fail(b, SHERF_UNSUPPORTED, "torch: written on a big-endian machine");
    if (system) root = next_pickle(&s, &source);
    value *keys = root ? next_pickle(&s, &plain) : NULL;
    if (keys && keys->kind != VALUE_LIST) build_fail(b, SHERF_BAD_FILE, "torch: no list of storages");
    for (size_t i = 0; keys && b->status == SHERF_OK && i < keys->list.count; i++)
        if (!storage_bytes(&s, table, keys->list.item[i])) break;
    mem_free(table);
    return b->status == SHERF_OK ? root : NULL;
}
