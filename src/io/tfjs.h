/* tfjs: a TensorFlow.js model, of layers or of a graph's nodes: model.json has the network (modelTopology)
 * and the list of arrays in each group of files (weightsManifest). */
#ifndef SHERF_TFJS_H
#define SHERF_TFJS_H

#include "io/value.h"

bool tfjs_is(const value *root);
bool tfjs_is_graph(const value *root); /* rather than of layers */

/* Returns the bytes of one file of the manifest, to be freed with mem_free; fails if they exceed the limit.
 * `path` is relative and stays below the model's folder. */
typedef sherf_status (*tfjs_reader)(void *user, context *c, const char *path, size_t limit_bytes,
                                    unsigned char **data, size_t *bytes);
/* A dict of name to float32 array, or int32 if the model has that. float32 is read as it is or, with
 * `quantization`, from float16, or from uint8 or uint16 as minimum + scale * stored. */
sherf_status tfjs_arrays(context *c, const value *root, tfjs_reader reader, void *user, document **out);
/* A reader whose `user` is the folder's path. Refuses links out of the folder. */
sherf_status tfjs_read_below(void *folder, context *c, const char *path, size_t limit_bytes,
                             unsigned char **data, size_t *bytes);

/* The settings of a layer of modelTopology by its name, of this class; NULL: there is none. */
const value *tfjs_layer(const value *root, const char *class_name, const char *name);
#endif
