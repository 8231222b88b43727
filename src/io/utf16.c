/* UTF-16 to UTF-8. */
#include "io/utf16.h"

#include <string.h>

typedef struct {
    const unsigned char *data;
    size_t bytes, at;
    bool big;
} reader;

static uint32_t unit(reader *r) {
    const unsigned char *p = r->data + r->at;
    r->at += 2;
    return r->big ? (uint32_t)p[0] << 8 | p[1] : (uint32_t)p[1] << 8 | p[0];
}

/* The next character; invalid ones become '?'. */
static uint32_t character(reader *r) {
    const uint32_t first = unit(r);
    if (first < 0xd800 || first > 0xdfff) return first;
    if (first > 0xdbff || r->at + 2 > r->bytes) return '?';
    const uint32_t second = unit(r);
    return second >= 0xdc00 && second <= 0xdfff ? 0x10000 + ((first & 0x3ff) << 10) + (second & 0x3ff) : '?';
}

size_t utf8_put(char *out, uint32_t u) {
    if (u < 0x80) {
        out[0] = (char)u;
        return 1;
    }
    const int more = u < 0x800 ? 1 : u < 0x10000 ? 2 : 3;
    out[0] = (char)((0xff00 >> (more + 1) & 0xff) | u >> 6 * more);
    for (int i = 1; i <= more; i++) out[i] = (char)(0x80 | (u >> 6 * (more - i) & 63));
    return (size_t)more + 1;
}

static bool has_mark(const unsigned char *data, size_t bytes) {
    return bytes >= 2 && (!memcmp(data, "\xff\xfe", 2) || !memcmp(data, "\xfe\xff", 2));
}

/* Without a byte order mark: letters, each next to a 0. */
static bool looks_wide(const unsigned char *data, size_t bytes) {
    if (bytes < 8) return false;
    const size_t letter = data[0] == 0;
    for (size_t i = 0; i < 8; i += 2) {
        const unsigned char text = data[i + letter], none = data[i + !letter];
        if (none || text < 9 || text > 126) return false;
    }
    return true;
}

bool utf16_is(const unsigned char *data, size_t bytes) {
    return has_mark(data, bytes) || looks_wide(data, bytes);
}

sherf_status utf16_narrow(context *c, const unsigned char *data, size_t bytes, unsigned char **out,
                          size_t *length) {
    const bool marked = has_mark(data, bytes);
    reader r = {.data = data,
                .bytes = bytes & ~(size_t)1,
                .at = marked ? 2 : 0,
                .big = marked ? data[0] == 0xfe : bytes && !data[0]};
    size_t n = 0;
    *length = 0;
    *out = mem_alloc(c, bytes / 2 * 3 + 1, 1); /* at most three bytes for two */
    if (!*out) return SHERF_NO_MEMORY;
    while (r.at < r.bytes) n += utf8_put((char *)*out + n, character(&r));
    (*out)[n] = 0;
    *length = n;
    return SHERF_OK;
}
