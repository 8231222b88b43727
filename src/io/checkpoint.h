/* checkpoint: other people's weights, found in a value tree and listed under flat names. */
#ifndef SHERF_CHECKPOINT_H
#define SHERF_CHECKPOINT_H

#include "io/value.h"

typedef struct {
    char *name; /* "layer1.0.conv1.weight" */
    const value *array;
} named_array;

typedef struct {
    context *c;
    arena *memory; /* of the names */
    named_array *item;
    size_t count, room;
    size_t visits;
} named_arrays;

void named_arrays_free(named_arrays *n);
const value *named_arrays_find(const named_arrays *n, const char *name);
bool named_arrays_has_shape(const named_arrays *n, const char *name, int rank, const int64_t *dim);

/* A torch module: a record whose state has _parameters, _buffers, _modules. Lists its tensors under the names
 * that torch's state_dict would give them. */
bool module_is(const value *v);
sherf_status module_flatten(context *c, const value *module, named_arrays *out);
/* A state dict: names to tensors, perhaps inside "state_dict" or "model", perhaps with the prefix "module.".
 * A module is flattened. SHERF_BAD_FILE: it is neither. */
sherf_status state_dict_flatten(context *c, const value *root, named_arrays *out);
#endif
