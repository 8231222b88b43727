/* utf16: texts with two bytes for each character, as Windows' tools save them. */
#ifndef SHERF_UTF16_H
#define SHERF_UTF16_H

#include "base/base.h"

/* Recognised by the byte order mark, or by letters with a 0 next to each. */
bool utf16_is(const unsigned char *data, size_t bytes);
/* Converts to UTF-8 with a terminating 0; the caller mem_frees *out. */
sherf_status utf16_narrow(context *c, const unsigned char *data, size_t bytes, unsigned char **out,
                          size_t *length);
size_t utf8_put(char *out, uint32_t u); /* 1 to 4 bytes; returns their number */

#endif
