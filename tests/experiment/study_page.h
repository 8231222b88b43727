/* The contents of a study's page, read as a browser would. */
#ifndef TEST_STUDY_PAGE_H
#define TEST_STUDY_PAGE_H

#include <string.h>

#include "base/path.h"
#include "io/value.h"
#include "support.h"

/* The JSON in FOLDER/study.html. */
static inline document *study_page(context *c, const char *folder) {
    static const char mark[] = "id=\"study\">";
    char path[1400];
    unsigned char *text;
    size_t bytes;
    document *d;
    snprintf(path, sizeof path, "%s/study.html", folder);
    assert_ok(c, file_read(c, path, 1 << 24, &text, &bytes));
    const char *from = strstr((char *)text, mark);
    assert_non_null(from);
    from += strlen(mark);
    assert_ok(c, json_parse(c, from, (size_t)(strstr(from, "</script>") - from), &d));
    mem_free(text);
    return d;
}

/* Picture `part` (0 input, 1 a, 2 b) of a trial: the bytes of its PNG, in static storage. */
static inline const unsigned char *study_png(const document *page, size_t trial, size_t part, size_t *bytes) {
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    static unsigned char out[1 << 20];
    const value *t = value_at(value_get(page->root, "trials"), trial), *index = value_at(t, part);
    const value *picture = value_at(value_get(page->root, "pictures"), (size_t)index->integer);
    const char *text = strchr(picture->string.text, ',') + 1;
    unsigned held = 0;
    int bits = 0;
    *bytes = 0;
    for (; *text && *text != '='; text++) {
        const char *at = strchr(digits, *text);
        assert_non_null(at);
        held = held << 6 | (unsigned)(at - digits);
        if ((bits += 6) < 8) continue;
        bits -= 8;
        assert_true(*bytes < sizeof out);
        out[(*bytes)++] = (unsigned char)(held >> bits);
    }
    return out;
}

#endif
