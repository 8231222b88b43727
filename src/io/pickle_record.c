/* pickle: records, which represent unknown objects, and small values read from values under construction. */
#include <string.h>

#include "io/pickle.h"

const char *pickle_class(const value *v) {
    return v && v->kind == VALUE_RECORD && ((const object *)v)->role == ROLE_CLASS ? v->record.class_name
                                                                                   : NULL;
}

bool pickle_name_is(const char *class_name, const char *module, const char *name) {
    size_t n = strlen(module);
    return !strncmp(class_name, module, n) && class_name[n] == '.' && !strcmp(class_name + n + 1, name);
}

value *pickle_record(builder *b, const char *class_name, value *arguments) {
    value *v = build_value(b, VALUE_RECORD);
    if (!v) return NULL;
    v->record.class_name = class_name; /* lives in the same arena */
    v->record.arguments = arguments;
    return v;
}

bool pickle_integer(const value *v, int64_t *out) {
    if (v && v->kind == VALUE_INTEGER)
        *out = v->integer;
    else if (v && v->kind == VALUE_BOOL)
        *out = v->boolean;
    else
        return false;
    return true;
}

bool pickle_dims(const value *v, int *rank, int64_t dim[8]) {
    if (!v || v->kind != VALUE_LIST || v->list.count > 8) return false;
    *rank = (int)v->list.count;
    for (int i = 0; i < *rank; i++)
        if (!pickle_integer(v->list.item[i], &dim[i])) return false;
    return true;
}
