/* Fuzz target: graphs of networks. */
#include "estimate/graph_file.h"
#include "fuzz.h"

/* A safetensors file with the graph "g" and its output "y"; small networks are run as well. */
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const char *const output[] = {"y"};
    context *c = fuzz_context();
    const size_t live = mem_live();
    safetensors *file;
    graph *g = NULL;
    sherf_status status = safetensors_parse(c, data, size, &file);
    if (status == SHERF_OK) {
        status = graph_read(c, file, "g", 1, output, &g);
        if ((status == SHERF_OK) != (g != NULL)) abort();
        safetensors_free(file);
    }
    const int64_t input[3] = {8, 8, 3};
    int64_t shape[GRAPH_RANK];
    arena *memory = g && graph_input_is(g, 3, input) && graph_products(g) < 1e7 ? arena_create(c) : NULL;
    if (memory) {
        float x[8 * 8 * 3];
        const float *y;
        for (int i = 0; i < 8 * 8 * 3; i++) x[i] = (float)(i % 7) - 3;
        if (graph_run(c, g, x, memory, &y) == SHERF_OK) {
            size_t count = 1;
            for (int k = graph_output_size(g, 0, shape) - 1; k >= 0; k--) count *= (size_t)shape[k];
            volatile uint64_t sum = fuzz_sum(y, count * sizeof *y);
            (void)sum;
        }
        arena_free(memory);
    }
    graph_free(g);
    return fuzz_end(c, status, live);
}
