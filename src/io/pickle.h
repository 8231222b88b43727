/* pickle: shared by the machine (pickle.c), its strings (pickle_text.c), its records (pickle_record.c), the
 * classes that it builds (pickle_numpy.c, pickle_torch.c) and the finishing (pickle_finish.c). */
#ifndef SHERF_PICKLE_H
#define SHERF_PICKLE_H

#include "io/build.h"

static inline object *object_of(value *v) {
    return (object *)v;
}

/* Like value_at and value_get, for values under construction. */
static inline value *pickle_item(const value *list, size_t i) {
    return list && list->kind == VALUE_LIST && i < list->list.count ? list->list.item[i] : NULL;
}

static inline value *pickle_entry(const value *dict, const char *key) {
    if (dict && dict->kind == VALUE_RECORD) dict = dict->record.state;
    for (size_t i = dict && dict->kind == VALUE_DICT ? dict->dict.count : 0; i-- > 0;)
        if (value_is_string(dict->dict.pair[i].key, key)) return dict->dict.pair[i].item;
    return NULL;
}

/* Name of a class or function: "module.name". NULL: v is none. */
const char *pickle_class(const value *v);
bool pickle_name_is(const char *class_name, const char *module, const char *name);
value *pickle_record(builder *b, const char *class_name, value *arguments);
bool pickle_integer(const value *v, int64_t *out);
bool pickle_dims(const value *v, int *rank, int64_t dim[8]); /* a tuple of up to 8 sizes */

/* STRING: 'text' with backslash escapes, protocol 0 of Python 2. UNICODE: Latin-1 with \uXXXX and \UXXXXXXXX,
 * to UTF-8. For a bad line, *wrong says what is wrong with it. */
value *pickle_quoted(builder *b, const char *line, size_t length, const char **wrong);
value *pickle_unicode(builder *b, const char *line, size_t length, const char **wrong);

/* Calls function(*arguments) if it is known: sets *known and returns the value (NULL: failed). */
value *pickle_call_numpy(builder *b, const char *name, value *function, value *arguments, bool *known);
value *pickle_call_torch(builder *b, const char *name, value *arguments, const pickle_source *source,
                         bool *known);
/* Sets the state of an object of a known class in place; *known as above. */
bool pickle_state_numpy(builder *b, value *v, value *state, bool *known);
/* joblib's arrays: builds the array that a wrapper of class pickle_joblib_class with this state announces;
 * its bytes follow the wrapper directly in the stream. *used: their number. */
extern const char pickle_joblib_class[];
value *pickle_joblib(builder *b, const value *state, const unsigned char *data, size_t left, size_t *used);
/* The storage that a persistent id names. */
value *pickle_persistent(builder *b, value *id, const pickle_source *source);
/* Turns an open view or storage into an array (torch_storage.c). */
bool pickle_settle(builder *b, object *o);
#endif
