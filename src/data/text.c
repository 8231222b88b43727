/* Text that grows. */
#include "data/text.h"

#include <stdio.h>
#include <string.h>

static bool reserve(text_builder *t, size_t bytes) {
    if (t->failed) return false;
    if (t->room - t->bytes > bytes) return true;
    size_t room = 2 * (t->bytes + bytes) + 256;
    char *more = mem_grow(t->c, t->data, t->bytes, room, 1);
    if (!more) {
        t->failed = true;
        return false;
    }
    t->data = more;
    t->room = room;
    return true;
}

void text_add_list(text_builder *t, const char *format, va_list args) {
    va_list again;
    va_copy(again, args);
    int n = vsnprintf(NULL, 0, format, again);
    va_end(again);
    if (n < 0 || !reserve(t, (size_t)n)) return;
    vsnprintf(t->data + t->bytes, t->room - t->bytes, format, args);
    t->bytes += (size_t)n;
}

void text_add(text_builder *t, const char *format, ...) {
    va_list args;
    va_start(args, format);
    text_add_list(t, format, args);
    va_end(args);
}

/* Length of the UTF-8 sequence at p, 0 when it is none. */
static int utf8_length(const unsigned char *p) {
    int n = p[0] < 0x80                   ? 1
            : p[0] >= 0xc2 && p[0] < 0xe0 ? 2
            : p[0] >= 0xe0 && p[0] < 0xf0 ? 3
            : p[0] >= 0xf0 && p[0] < 0xf5 ? 4
                                          : 0;
    for (int i = 1; i < n; i++)
        if ((p[i] & 0xc0) != 0x80) return 0;
    return n;
}

void text_add_json(text_builder *t, const char *text) {
    text_add(t, "\"");
    for (const unsigned char *p = (const unsigned char *)text; *p;) {
        int n = utf8_length(p);
        if (!n)
            text_add(t, "?");
        else if (*p == '"' || *p == '\\')
            text_add(t, "\\%c", *p);
        else if (*p < 0x20)
            text_add(t, "\\u%04x", *p);
        else
            text_add(t, "%.*s", n, (const char *)p);
        p += n ? n : 1;
    }
    text_add(t, "\"");
}

char *text_take(text_builder *t) {
    if (!reserve(t, 0)) {
        mem_free(t->data);
        *t = (text_builder){.c = t->c, .failed = true};
        return NULL;
    }
    t->data[t->bytes] = 0;
    char *data = t->data;
    *t = (text_builder){.c = t->c};
    return data;
}
