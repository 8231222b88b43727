/* Fuzz target: proxies, the clothes of MakeHuman's people, bound to a base mesh of 16 vertices. Proxies that
 * open are fitted. */
#include <math.h>

#include "fuzz.h"
#include "synth/people/proxy.h"

enum { BASE = 16 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    context *c = fuzz_context();
    const size_t live = mem_live();
    float base[3 * BASE], rows[2 * BASE];
    document *d = NULL;
    proxy *p = NULL;
    for (int i = 0; i < 3 * BASE; i++) base[i] = (float)(i * 7 % 11) / 10;
    for (int i = 0; i < 2 * BASE; i++) rows[i] = 0.5f;
    sherf_status status = json_parse(c, (const char *)data, size, &d);
    if (!status) status = proxy_parse(c, d->root, "hat", BASE, base, &p);
    if ((status == SHERF_OK) != (p != NULL)) abort();
    if (p) {
        float *vertex = malloc(sizeof *vertex * 3 * (size_t)p->vertices);
        float *row = malloc(sizeof *row * 2 * (size_t)p->vertices);
        proxy_fit(p, base, vertex);
        proxy_carry(p, 2, rows, row);
        for (int i = 0; i < 3 * p->triangles; i++)
            if (p->triangle[i] >= (uint32_t)p->vertices || p->triangle_uv[i] >= (uint32_t)p->uvs) abort();
        for (int i = 0; i < 2 * p->uvs; i++)
            if (!isfinite(p->uv[i])) abort();
        free(vertex);
        free(row);
    }
    proxy_free(p);
    document_free(d);
    return fuzz_end(c, status, live);
}
