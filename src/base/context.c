/* Contexts: device and precision are resolved when one is made; cancelling, and small public calls. */
#include <stdlib.h>
#include <string.h>

#include "base/device.h"

sherf_status sherf_context_create(const sherf_options *options, sherf_context **out) {
    *out = NULL;
    const sherf_device device = device_resolve(options ? options->device : SHERF_DEVICE_AUTO);
    sherf_status status = sherf_device_find(device, NULL, 0);
    if (status != SHERF_OK) return status;
    context boot = {0};
    context *c = mem_zero(&boot, 1, sizeof *c);
    if (!c) return SHERF_NO_MEMORY;
    if (options) {
        c->log = options->log;
        c->progress = options->progress;
        c->user = options->user;
        c->threads = options->threads;
        c->precision = options->precision;
    }
    c->device = device;
    if (c->threads <= 0) c->threads = threads_available();
    const int threads = threads_make(c->threads);
    if (threads < c->threads)
        log_line(c, SHERF_LOG_WARNING, "%d threads: the system gives no more than %d", c->threads, threads);
    c->threads = threads;
    const sherf_precision wanted = c->precision;
    c->precision = precision_resolve(c, wanted);
    if (wanted == SHERF_PRECISION_BF16 && c->precision != wanted)
        log_line(c, SHERF_LOG_WARNING, "bf16 needs a processor with AMX: computing in float32 (%s)",
                 isa_name(isa_best()));
    *out = c;
    return SHERF_OK;
}

sherf_precision precision_resolve(const context *c, sherf_precision wanted) {
    const bool has = c->device == SHERF_DEVICE_CUDA || isa_has_bf16(); /* every supported GPU has it */
    return has && wanted != SHERF_PRECISION_FP32 ? SHERF_PRECISION_BF16 : SHERF_PRECISION_FP32;
}

void sherf_context_free(sherf_context *c) {
    mem_free(c);
}
const char *sherf_message(const sherf_context *c) {
    return c->message;
}
void sherf_cancel(sherf_context *c) {
    atomic_store(&c->cancelled, 1);
}
void sherf_cancel_reset(sherf_context *c) {
    atomic_store(&c->cancelled, 0);
}
sherf_precision sherf_precision_used(const sherf_context *c) {
    return c->precision;
}
sherf_device sherf_device_used(const sherf_context *c) {
    return c->device;
}
const char *sherf_version(void) {
    return SHERF_VERSION;
}
void sherf_free(void *p) {
    mem_free(p);
}
