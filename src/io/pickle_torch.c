/* pickle: tensors of torch. A tensor is a view (offset, sizes, strides) of a storage (torch_storage.c);
 * persistent ids name storages, or whole streams of their own embed them. */
#include <string.h>

#include "io/pickle.h"

enum { TORCH_LEVELS = 3 };

/* "FloatStorage", "float32" */
static bool torch_dtype(const char *name, size_t length, dtype *out) {
    static const struct {
        const char *storage, *plain;
        dtype type;
    } known[] = {{"FloatStorage", "float32", T_F32},  {"DoubleStorage", "float64", T_F64},
                 {"HalfStorage", "float16", T_F16},   {"BFloat16Storage", "bfloat16", T_BF16},
                 {"LongStorage", "int64", T_I64},     {"IntStorage", "int32", T_I32},
                 {"ByteStorage", "uint8", T_U8},      {"BoolStorage", "bool", T_U8},
                 {"UntypedStorage", "untyped", T_U8}, {"_UntypedStorage", "untyped", T_U8}};
    for (size_t i = 0; i < COUNT_OF(known); i++)
        if ((strlen(known[i].storage) == length && !memcmp(known[i].storage, name, length)) ||
            (strlen(known[i].plain) == length && !memcmp(known[i].plain, name, length))) {
            *out = known[i].type;
            return true;
        }
    return false;
}

/* ("storage", class, key, place, count) and, in old files, a view, which must be None. Legacy files of whole
 * networks have ("module", class, source file, source) for each class: the source is ignored. */
value *pickle_persistent(builder *b, value *id, const pickle_source *source) {
    value *class = pickle_item(id, 1);
    const value *key = value_at(id, 2), *view = value_at(id, 5);
    const char *name = pickle_class(class), *last = name ? strrchr(name, '.') : NULL;
    int64_t count;
    dtype type;
    if (source->storage && name && value_is_string(value_at(id, 0), "module")) return class;
    if (!source->storage || !value_is_string(value_at(id, 0), "storage"))
        return pickle_record(b, "(persistent id)", id);
    if (!last || !key || key->kind != VALUE_STRING || !pickle_integer(value_at(id, 4), &count) || count < 0 ||
        (view && view->kind != VALUE_NONE))
        return build_fail(b, SHERF_BAD_FILE, "torch: a storage that is not understood");
    if (!torch_dtype(last + 1, strlen(last + 1), &type))
        return build_fail(b, SHERF_UNSUPPORTED, "torch: %s is not read", name);
    value *text = build_string(b, key->string.text, key->string.length);
    value *v = text ? pickle_record(b, name, NULL) : NULL;
    torch_storage *storage = v ? source->storage(source->user, b, type, text->string.text, count) : NULL;
    if (!storage) return NULL;
    object_of(v)->role = ROLE_STORAGE;
    object_of(v)->storage = storage;
    return v;
}

/* (storage, offset, sizes, strides, ...); version 3 names the element type of an untyped storage. */
static value *make_view(builder *b, const value *arguments, bool typed) {
    object *storage = object_of(pickle_item(arguments, 0));
    torch_view *view = build_memory(b, 1, sizeof *view);
    if (!view) return NULL;
    memset(view, 0, sizeof *view);
    int strides;
    if (!storage || storage->role != ROLE_STORAGE || !pickle_integer(value_at(arguments, 1), &view->offset) ||
        !pickle_dims(value_at(arguments, 2), &view->rank, view->dim) ||
        !pickle_dims(value_at(arguments, 3), &strides, view->stride) || strides != view->rank)
        return build_fail(b, SHERF_BAD_FILE, "torch: a tensor that is not understood");
    view->storage = storage->storage;
    view->type = storage->storage->type;
    if (typed) {
        const char *name = pickle_class(value_at(arguments, 6)), *last = name ? strrchr(name, '.') : NULL;
        if (!last || !torch_dtype(last + 1, strlen(last + 1), &view->type))
            return build_fail(b, SHERF_UNSUPPORTED, "torch: tensors of %s are not read",
                              name ? name : "this type");
    }
    value *v = pickle_record(b, "torch.Tensor", NULL);
    if (!v) return NULL;
    object_of(v)->role = ROLE_TENSOR;
    object_of(v)->view = view;
    return v;
}

/* _load_from_bytes(b): a storage saved as a whole legacy stream. */
static value *embedded(builder *b, const value *arguments, const pickle_source *source) {
    const value *data = value_at(arguments, 0);
    if (!data || data->kind != VALUE_STRING)
        return build_fail(b, SHERF_BAD_FILE, "torch: an embedded storage without bytes");
    if (source->level >= TORCH_LEVELS)
        return build_fail(b, SHERF_BAD_FILE, "torch: storages within storages");
    /* the same bytes may be loaded many times, so that work counts as memory */
    if (data->string.length > b->limit - b->used)
        return build_fail(b, SHERF_BAD_FILE, "torch: too many embedded storages");
    b->used += data->string.length;
    return source->stream(b, (const unsigned char *)data->string.text, data->string.length,
                          source->level + 1);
}

value *pickle_call_torch(builder *b, const char *name, value *arguments, const pickle_source *source,
                         bool *known) {
    *known = true;
    if (!strcmp(name, "torch._tensor._rebuild_from_type_v2") && arguments->list.count >= 3) {
        const char *inner = pickle_class(value_at(arguments, 0));
        if (inner && strcmp(inner, name) && arguments->list.item[2]->kind == VALUE_LIST) {
            name = inner;
            arguments = arguments->list.item[2];
        }
    }
    if (!strcmp(name, "torch._utils._rebuild_tensor") || !strcmp(name, "torch._utils._rebuild_tensor_v2"))
        return make_view(b, arguments, false);
    if (!strcmp(name, "torch._utils._rebuild_tensor_v3")) return make_view(b, arguments, true);
    if ((!strcmp(name, "torch._utils._rebuild_parameter") ||
         !strcmp(name, "torch._utils._rebuild_parameter_with_state") ||
         !strcmp(name, "torch.nn.parameter.Parameter")) &&
        arguments->list.count >= 1)
        return arguments->list.item[0];
    if (!strcmp(name, "torch.storage._load_from_bytes")) return embedded(b, arguments, source);
    *known = false;
    return NULL;
}
