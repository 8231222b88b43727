/* Fuzz target: pickles. */
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    context *c = fuzz_context();
    size_t live = mem_live();
    document *d;
    sherf_status status = pickle_parse(c, data, size, &d);
    return fuzz_document(c, status, d, live);
}
