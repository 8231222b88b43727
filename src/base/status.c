/* Messages, each kept to one line; the log, progress and cancelling. */
#include <stdio.h>
#include <string.h>

#include "base/base.h"

static void one_line(char *text) {
    for (char *p = text; *p; p++)
        if ((unsigned char)*p < 0x20 || *p == 0x7f) *p = ' ';
}

sherf_status failure(context *c, sherf_status status, const char *format, ...) {
    va_list args;
    va_start(args, format);
    vsnprintf(c->message, sizeof c->message, format, args);
    va_end(args);
    one_line(c->message);
    return status;
}

sherf_status failure_prefix(context *c, sherf_status status, const char *format, ...) {
    char old[sizeof c->message], prefix[512];
    memcpy(old, c->message, sizeof old);
    va_list args;
    va_start(args, format);
    vsnprintf(prefix, sizeof prefix, format, args);
    va_end(args);
    snprintf(c->message, sizeof c->message, "%.500s: %.500s", prefix, old);
    one_line(c->message);
    return status;
}

void log_line(context *c, sherf_log_level level, const char *format, ...) {
    if (!c->log) return;
    char line[1024];
    va_list args;
    va_start(args, format);
    vsnprintf(line, sizeof line, format, args);
    va_end(args);
    one_line(line);
    c->log(c->user, level, line);
}

bool cancelled(context *c) {
    return atomic_load_explicit(&c->cancelled, memory_order_relaxed) != 0;
}

sherf_status progress(context *c, const char *text, double done, double total) {
    if (c->progress) c->progress(c->user, text, done, total);
    return cancelled(c) ? failure(c, SHERF_CANCELLED, "cancelled") : SHERF_OK;
}
