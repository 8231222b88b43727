/* pickle: whole pickles, as files or inside an npy file. */
#include "io/pickle.h"

value *pickle_whole(builder *b, const unsigned char *data, size_t bytes) {
    const pickle_source source = {.stream = torch_legacy_build};
    return pickle_finish(b, pickle_build(b, data, bytes, &source, NULL));
}

/* A text (protocol 0) with Windows line ends in all lines. */
static bool has_windows_lines(const unsigned char *data, size_t bytes) {
    size_t lines = 0;
    if (!bytes || data[0] == 0x80) return false;
    for (size_t i = 0; i < bytes; i++) {
        if (data[i] != '\n') continue;
        if (!i || data[i - 1] != '\r') return false;
        lines++;
    }
    return lines > 0;
}

static sherf_status parse_plain(context *c, const unsigned char *data, size_t bytes, document **out) {
    builder b;
    if (!build_start(&b, c, build_limit(bytes))) return b.status;
    return build_finish(&b, pickle_whole(&b, data, bytes), out);
}

static sherf_status parse_windows_lines(context *c, const unsigned char *data, size_t bytes, document **out) {
    unsigned char *plain = mem_alloc(c, bytes, 1);
    size_t n = 0;
    if (!plain) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < bytes; i++)
        if (data[i] != '\r' || i + 1 == bytes || data[i + 1] != '\n') plain[n++] = data[i];
    sherf_status status = parse_plain(c, plain, n, out);
    mem_free(plain);
    return status;
}

sherf_status pickle_parse(context *c, const unsigned char *data, size_t bytes, document **out) {
    *out = NULL;
    return has_windows_lines(data, bytes) ? parse_windows_lines(c, data, bytes, out)
                                          : parse_plain(c, data, bytes, out);
}
