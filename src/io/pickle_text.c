/* pickle: strings of protocol 0, with their escapes. */
#include <string.h>

#include "io/pickle.h"
#include "io/utf16.h"

static int hex(char ch) {
    return ch >= '0' && ch <= '9'   ? ch - '0'
           : ch >= 'a' && ch <= 'f' ? ch - 'a' + 10
           : ch >= 'A' && ch <= 'F' ? ch - 'A' + 10
                                    : -1;
}

static value *fault(const char **wrong, const char *what) {
    *wrong = what;
    return NULL;
}

value *pickle_quoted(builder *b, const char *p, size_t n, const char **wrong) {
    size_t used = 0;
    if (n && p[n - 1] == '\r') n--;
    if (n < 2 || (p[0] != '\'' && p[0] != '"') || p[n - 1] != p[0])
        return fault(wrong, "a string without quotes");
    char *text = build_memory(b, n, 1);
    if (!text) return NULL;
    for (size_t i = 1; i < n - 1; i++) {
        if (p[i] != '\\') {
            text[used++] = p[i];
            continue;
        }
        if (++i >= n - 1) return fault(wrong, "a broken escape");
        const char *plain = "\\'\"abfnrtv", *meant = "\\'\"\a\b\f\n\r\t\v", *at = strchr(plain, p[i]);
        if (p[i] && at)
            text[used++] = meant[at - plain];
        else if (p[i] == 'x' && i + 2 < n - 1 && hex(p[i + 1]) >= 0 && hex(p[i + 2]) >= 0) {
            text[used++] = (char)(hex(p[i + 1]) * 16 + hex(p[i + 2]));
            i += 2;
        } else if (p[i] >= '0' && p[i] <= '7') {
            int octal = 0;
            for (int k = 0; k < 3 && i < n - 1 && p[i] >= '0' && p[i] <= '7'; k++)
                octal = octal * 8 + (p[i++] - '0');
            i--;
            text[used++] = (char)octal;
        } else {
            text[used++] = '\\';
            text[used++] = p[i];
        }
    }
    return build_string(b, text, used);
}

value *pickle_unicode(builder *b, const char *p, size_t n, const char **wrong) {
    size_t used = 0;
    char *text = build_memory(b, n * 2 + 1, 1);
    if (!text) return NULL;
    for (size_t i = 0; i < n; i++) {
        uint32_t u = (unsigned char)p[i];
        if (u == '\\' && i + 1 < n && (p[i + 1] == 'u' || p[i + 1] == 'U')) {
            size_t digits = p[i + 1] == 'u' ? 4 : 8;
            if (n - i - 2 < digits) return fault(wrong, "a broken escape");
            u = 0;
            for (size_t k = 0; k < digits; k++) {
                int h = hex(p[i + 2 + k]);
                if (h < 0 || u > 0x10ffff) return fault(wrong, "a broken escape");
                u = u * 16 + (uint32_t)h;
            }
            if (u > 0x10ffff) return fault(wrong, "a broken escape");
            i += digits + 1;
        }
        used += utf8_put(text + used, u);
    }
    return build_string(b, text, used);
}
