/* graph: a small executor for feed-forward networks on pictures, for inference. A graph is a list of nodes
 * that refer to earlier ones. Sizes are fixed and known when it is made, weights are packed once, and the
 * memory of values that are no longer read is reused. float32 on the CPU, for any device of the context. A
 * value is [H, W, C], [R, C] or [C]; there is no batch. */
#ifndef SHERF_GRAPH_H
#define SHERF_GRAPH_H

#include "base/base.h"

typedef enum {
    GRAPH_INPUT,       /* of `size` */
    GRAPH_CONVOLUTION, /* input 0 over weight [kernel, kernel, in, out]; input 1, if given, is added */
    GRAPH_DEPTHWISE,   /* the same with weight [kernel, kernel, in, 1]; in: a multiple of 8 */
    GRAPH_ADD,         /* of two values of one size */
    GRAPH_ACTIVATION,
    GRAPH_MAX_POOL,
    GRAPH_RESIZE,  /* bilinear, to size[0] x size[1] */
    GRAPH_UNFOLD,  /* depth to space: channels (down, across, c) of a pixel become block x block pixels */
    GRAPH_PAD,     /* zeros before and after each dimension */
    GRAPH_RESHAPE, /* to `size`, of which one may be -1 */
    GRAPH_CONCAT,  /* along `axis`; -1: the last */
    GRAPH_KINDS
} graph_kind;
extern const char *const graph_kind_names[GRAPH_KINDS]; /* as in files */

typedef enum { GRAPH_LINEAR, GRAPH_RELU, GRAPH_RELU6, GRAPH_SIGMOID, GRAPH_ACTIVATIONS } graph_activation;
extern const char *const graph_activation_names[GRAPH_ACTIVATIONS];

enum { GRAPH_INPUTS = 8, GRAPH_RANK = 3, GRAPH_NODES_MAX = 4096 };

/* Fields that a kind does not use are 0. */
typedef struct {
    const char *name; /* for messages */
    graph_kind kind;
    int inputs, input[GRAPH_INPUTS]; /* numbers of earlier nodes */
    graph_activation then;           /* convolutions (not sigmoid), add, activation */
    int rank;                        /* input, reshape: of size */
    int64_t size[GRAPH_RANK];
    const float *weight, *bias; /* bias NULL: none */
    int64_t weight_size[4], bias_size;
    int64_t kernel[2], stride[2]; /* down, across; kernel: of a pool */
    bool same; /* convolutions, pool: zero padding (in a pool, none counts) as in TensorFlow's SAME */
    int64_t pad[2 * GRAPH_RANK]; /* else top, bottom, left, right; pad: and before and after the channels */
    int64_t block, axis;
    bool half_pixel, corners; /* resize: aligns the pixels' centres, or those of the corner pixels; neither:
                                 the first pixel's centre */
} graph_node;

typedef struct graph graph;
graph *graph_begin(context *c); /* NULL: out of memory */
/* Adds the next node. Checks everything, and refuses it with the node's name; copies weights. A node's values
 * (2^24), the products of all nodes (2^36) and their memory (2^27 values) are bounded. */
sherf_status graph_add(context *c, graph *g, const graph_node *node);
/* After the last node: selects the nodes whose values are wanted, at least one. Drops all that they do not
 * need. */
sherf_status graph_finish(context *c, graph *g, int outputs, const int *node);
void graph_free(graph *g);

/* The rank of output i of a finished graph, and its size. */
int graph_output_size(const graph *g, int i, int64_t size[GRAPH_RANK]);
/* Whether the graph has one input of this size. */
bool graph_input_is(const graph *g, int rank, const int64_t *size);
double graph_products(const graph *g); /* multiply-adds in a run */
/* output[i] points to the values of output i in `memory`, valid until that is rewound. Several contexts may
 * run g at once. The result does not depend on the number of threads. */
sherf_status graph_run(context *c, const graph *g, const float *input, arena *memory, const float **output);
#endif
