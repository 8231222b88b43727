/* archive: zip files (npz, torch) through libzip. */
#ifndef SHERF_ARCHIVE_H
#define SHERF_ARCHIVE_H

#include <zip.h>

#include "io/build.h"

/* NULL if the builder failed; close it with zip_discard. The bytes must stay until then. */
zip_t *archive_open(builder *b, const char *path);
zip_t *archive_open_bytes(builder *b, const unsigned char *data, size_t bytes);
/* The limit on members' unpacked bytes: build_limit of the file's length. */
size_t archive_limit(const char *path);
/* The unpacked length of member i; refuses more than the builder's limit. */
bool archive_size(builder *b, zip_t *zip, uint64_t i, size_t *bytes);
/* Unpacks all `bytes` of member i and checks its checksum. */
bool archive_member(builder *b, zip_t *zip, uint64_t i, unsigned char *out, size_t bytes);

value *npz_build(builder *b, zip_t *zip);
#endif
