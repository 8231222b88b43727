/* Text that grows. */
#ifndef SHERF_DATA_TEXT_H
#define SHERF_DATA_TEXT_H

#include "base/base.h"

typedef struct {
    context *c;
    char *data; /* NULL while empty */
    size_t bytes, room;
    bool failed; /* out of memory: the rest is dropped */
} text_builder;
void text_add(text_builder *t, const char *format, ...) PRINTF_LIKE(2, 3);
void text_add_list(text_builder *t, const char *format, va_list args);
/* With quotes, escaped for JSON; bytes that are not UTF-8 become '?'. */
void text_add_json(text_builder *t, const char *text);
/* The text (never NULL, mem_free), or NULL when memory ran out. */
char *text_take(text_builder *t);
#endif
