/* graph_file: a network's graph from a safetensors file. Its nodes are JSON in the metadata, graph.NAME:
 * {"nodes": [{"name", "kind", "in", ...}], "outputs": {"name": node}}, as docs/photo.md says; weights are
 * tensors. Files are hostile: what is unknown is refused with the node's name, sizes are bounded
 * (nn/graph.h). */
#ifndef SHERF_GRAPH_FILE_H
#define SHERF_GRAPH_FILE_H

#include "io/safetensors.h"
#include "nn/graph.h"

/* The outputs of these names, in this order; the rest of the graph is not kept. */
sherf_status graph_read(context *c, const safetensors *file, const char *name, int outputs,
                        const char *const *output, graph **out);
#endif
