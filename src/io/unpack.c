/* Files packed by the usual programs, through libarchive. */
#include <archive.h>
#include <archive_entry.h>
#include <string.h>

#include "io/build.h"

const char *packed_kind(const unsigned char *data, size_t bytes) {
    static const struct {
        const char *sign;
        size_t count;
        const char *name;
    } kinds[] = {{"\x1f\x8b", 2, "gzip"},
                 {"\xfd"
                  "7zXZ\0",
                  6, "xz"},
                 {"BZh", 3, "bzip2"},
                 {"\x5d\0\0", 3, "lzma"},
                 {"\x28\xb5\x2f\xfd", 4, "zstd"}};
    for (size_t i = 0; i < COUNT_OF(kinds); i++)
        if (bytes >= kinds[i].count && !memcmp(data, kinds[i].sign, kinds[i].count)) return kinds[i].name;
    return NULL;
}

static struct archive *opened(const unsigned char *data, size_t bytes) {
    struct archive *a = archive_read_new();
    struct archive_entry *entry;
    if (!a) return NULL;
    archive_read_support_filter_gzip(a);
    archive_read_support_filter_xz(a);
    archive_read_support_filter_bzip2(a);
    archive_read_support_filter_lzma(a);
    archive_read_support_filter_zstd(a);
    archive_read_support_format_raw(a);
    if (archive_read_open_memory(a, data, bytes) == ARCHIVE_OK &&
        archive_read_next_header(a, &entry) == ARCHIVE_OK && archive_filter_code(a, 0) != ARCHIVE_FILTER_NONE)
        return a;
    archive_read_free(a);
    return NULL;
}

sherf_status packed_unpack(context *c, const unsigned char *data, size_t bytes, unsigned char **out,
                           size_t *length) {
    const size_t limit = build_limit(bytes);
    const char *kind = packed_kind(data, bytes);
    size_t room = 0;
    la_ssize_t got = 1;
    sherf_status status = SHERF_OK;
    *out = NULL;
    *length = 0;
    struct archive *a = opened(data, bytes);
    if (!a) return failure(c, SHERF_BAD_FILE, "packed by %s, but damaged or truncated", kind);
    while (!status && got > 0) {
        if (*length == room) {
            const size_t more = room ? 2 * room : 4 * bytes + 4096;
            unsigned char *grown = more > limit ? NULL : mem_grow(c, *out, room, more, 1);
            if (grown) *out = grown, room = more;
            if (!grown)
                status = more > limit
                             ? failure(c, SHERF_BAD_FILE, "unpacks to more than a file of its size may")
                             : SHERF_NO_MEMORY;
        }
        if (!status) got = archive_read_data(a, *out + *length, room - *length);
        if (!status && got < 0)
            status = failure(c, SHERF_BAD_FILE, "packed by %s, but damaged or truncated", kind);
        if (!status) *length += (size_t)got;
    }
    archive_read_free(a);
    if (!status) return SHERF_OK;
    mem_free(*out);
    *out = NULL;
    return status;
}
