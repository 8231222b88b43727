/* Files packed by zlib, as joblib.dump(..., compress=...) writes around a pickle. */
#define ZLIB_CONST /* unpacked data stays const */
#include <zlib.h>

#include "io/build.h"

bool zlib_is(const unsigned char *data, size_t bytes) {
    return bytes >= 2 && data[0] == 0x78 && (data[0] << 8 | data[1]) % 31 == 0;
}

sherf_status zlib_unpack(context *c, const unsigned char *data, size_t bytes, unsigned char **out,
                         size_t *length) {
    const size_t limit = build_limit(bytes);
    z_stream z = {0};
    size_t room = 0;
    int code = Z_OK;
    *out = NULL;
    *length = 0;
    if (bytes > UINT32_MAX) return failure(c, SHERF_BAD_FILE, "packed files of more than 4 GB are not read");
    if (inflateInit(&z) != Z_OK) return failure(c, SHERF_NO_MEMORY, "out of memory");
    z.next_in = data;
    z.avail_in = (uInt)bytes;
    sherf_status status = SHERF_OK;
    while (!status && code == Z_OK) {
        if (*length == room) {
            size_t more = room ? 2 * room : 4 * bytes + 4096;
            unsigned char *grown =
                more > limit ? NULL : mem_grow(c, *out, room, more, 1); /* the old one stays if this fails */
            if (!grown) {
                status = more > limit
                             ? failure(c, SHERF_BAD_FILE, "unpacks to more than a file of its size may")
                             : SHERF_NO_MEMORY;
                break;
            }
            *out = grown, room = more;
        }
        size_t free_bytes = room - *length < ((size_t)1 << 30) ? room - *length : (size_t)1 << 30;
        z.next_out = *out + *length;
        z.avail_out = (uInt)free_bytes;
        code = inflate(&z, Z_NO_FLUSH);
        *length += free_bytes - z.avail_out;
        if (code == Z_BUF_ERROR && z.avail_in == 0) break; /* truncated */
        if (code == Z_BUF_ERROR) code = Z_OK;
    }
    inflateEnd(&z);
    if (!status && code != Z_STREAM_END)
        status = code == Z_MEM_ERROR ? failure(c, SHERF_NO_MEMORY, "out of memory")
                                     : failure(c, SHERF_BAD_FILE, "packed by zlib, but damaged or truncated");
    if (status) {
        mem_free(*out);
        *out = NULL;
    }
    return status;
}
