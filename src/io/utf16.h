/* utf16: texts of two bytes a character, as Windows' tools save them. */
#ifndef SHERF_UTF16_H
#define SHERF_UTF16_H

#include "base/base.h"

/* By their mark, or by letters with a 0 beside each. */
bool utf16_is(const unsigned char *data, size_t bytes);
/* To UTF-8 with a 0 behind it; *out is mem_free'd by the caller. */
sherf_status utf16_narrow(context *c, const unsigned char *data, size_t bytes, unsigned char **out,
                          size_t *length);
size_t utf8_put(char *out, uint32_t u); /* 1 to 4 bytes, how many */

#endif
