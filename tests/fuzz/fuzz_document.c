/* Fuzz target: every format that is recognised by its first bytes, including npz, torch zips and torch legacy
 * streams. */
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    context *c = fuzz_context();
    size_t live = mem_live();
    document *d;
    sherf_status status = document_parse(c, data, size, &d, NULL);
    return fuzz_document(c, status, d, live);
}
