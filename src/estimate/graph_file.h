/* graph_file: a network's graph from a safetensors file. Its nodes are JSON in the metadata, graph.NAME:
 * {"nodes": [{"name", "kind", "in", ...}], "outputs": {"name": node}}, as docs/photo.md says; weights are
 * tensors. Files may be hostile: unknown keys and kinds are refused with the node's name, and sizes are
 * bounded (nn/graph.h). */
#ifndef SHERF_GRAPH_FILE_H
#define SHERF_GRAPH_FILE_H

#include "io/safetensors.h"
#include "nn/graph.h"

/* Keeps only what the outputs of these names, in this order, need. */
sherf_status graph_read(context *c, const safetensors *file, const char *name, int outputs,
                        const char *const *output, graph **out);
#endif
