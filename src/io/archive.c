/* archive: zip members, and the npz file, which is a zip of npy files. */
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include "base/path.h"
#include "io/archive.h"

enum { ARCHIVE_MEMBERS = 1 << 20 };

static zip_t *opened(builder *b, zip_t *zip, zip_error_t *error) {
    if (!zip) {
        bool memory = zip_error_code_zip(error) == ZIP_ER_MEMORY;
        return build_fail(b, memory ? SHERF_NO_MEMORY : SHERF_BAD_FILE, "not a zip file, or damaged: %s",
                          zip_error_strerror(error));
    }
    if (zip_get_num_entries(zip, 0) <= ARCHIVE_MEMBERS) return zip;
    zip_discard(zip);
    return build_fail(b, SHERF_BAD_FILE, "more than %d members", ARCHIVE_MEMBERS);
}

static zip_t *open_source(builder *b, zip_source_t *source, zip_error_t *error) {
    zip_t *zip = source ? zip_open_from_source(source, ZIP_RDONLY, error) : NULL;
    if (!zip && source) zip_source_free(source);
    return opened(b, zip, error);
}

size_t archive_limit(const char *path) {
    struct stat info;
    return build_limit(stat(path, &info) == 0 && info.st_size > 0 ? (size_t)info.st_size : 0);
}

zip_t *archive_open(builder *b, const char *path) {
    zip_error_t error;
    if (b->status != SHERF_OK) return NULL;
    FILE *f = fopen(path, "rb"); /* for a plain error message */
    if (!f) return build_fail(b, SHERF_NO_FILE, "cannot be opened");
    fclose(f);
    zip_error_init(&error);
    zip_t *zip = open_source(b, zip_source_file_create(path, 0, -1, &error), &error);
    zip_error_fini(&error);
    return zip;
}

zip_t *archive_open_bytes(builder *b, const unsigned char *data, size_t bytes) {
    zip_error_t error;
    if (b->status != SHERF_OK) return NULL;
    zip_error_init(&error);
    zip_t *zip = open_source(b, zip_source_buffer_create(data, bytes, 0, &error), &error);
    zip_error_fini(&error);
    return zip;
}

bool archive_size(builder *b, zip_t *zip, uint64_t i, size_t *bytes) {
    zip_stat_t info;
    zip_uint64_t need = ZIP_STAT_SIZE | ZIP_STAT_COMP_METHOD | ZIP_STAT_ENCRYPTION_METHOD;
    if (b->status != SHERF_OK) return false;
    if (zip_stat_index(zip, i, 0, &info) || (info.valid & need) != need) {
        build_fail(b, SHERF_BAD_FILE, "zip: member %llu is damaged", (unsigned long long)i);
        return false;
    }
    if (info.encryption_method != ZIP_EM_NONE ||
        (info.comp_method != ZIP_CM_STORE && info.comp_method != ZIP_CM_DEFLATE)) {
        build_fail(b, SHERF_UNSUPPORTED, "zip: member %.80s is encrypted or packed in an unusual way",
                   info.name);
        return false;
    }
    if (info.size > b->limit - b->used) {
        build_fail(b, SHERF_BAD_FILE, "zip: member %.80s unpacks to %llu MB, too much for this file",
                   info.name, (unsigned long long)(info.size >> 20));
        return false;
    }
    *bytes = (size_t)info.size;
    return true;
}

bool archive_member(builder *b, zip_t *zip, uint64_t i, unsigned char *out, size_t bytes) {
    if (b->status != SHERF_OK) return false;
    zip_file_t *f = zip_fopen_index(zip, i, 0);
    size_t have = 0;
    bool ok = f != NULL;
    while (ok && have < bytes) {
        zip_int64_t n = zip_fread(f, out + have, bytes - have);
        ok = n > 0 && (uint64_t)n <= bytes - have;
        if (ok) have += (size_t)n;
    }
    unsigned char more; /* libzip checks the checksum only at the end of the data */
    ok = ok && zip_fread(f, &more, 1) == 0;
    if (f) zip_fclose(f);
    if (!ok) {
        const char *name = zip_get_name(zip, i, 0);
        build_fail(b, SHERF_BAD_FILE, "zip: member %.80s is damaged", name ? name : "?");
    }
    return ok;
}

/* ---------------------------------------------------------------- npz -------------------------------- */
value *npz_build(builder *b, zip_t *zip) {
    value *dict = build_value(b, VALUE_DICT);
    zip_int64_t count = zip_get_num_entries(zip, 0);
    for (zip_int64_t i = 0; i < count && dict; i++) {
        const char *name = zip_get_name(zip, (zip_uint64_t)i, 0);
        size_t n = name ? strlen(name) : 0, bytes;
        if (n < 4 || strcmp(name + n - 4, ".npy"))
            return build_fail(b, SHERF_BAD_FILE, "npz: member %.80s is no .npy", name ? name : "?");
        if (!archive_size(b, zip, (zip_uint64_t)i, &bytes)) return NULL;
        unsigned char *data = mem_alloc(b->c, bytes + 1, 1);
        if (!data) {
            b->status = SHERF_NO_MEMORY;
            return NULL;
        }
        value *item = NULL;
        if (archive_member(b, zip, (zip_uint64_t)i, data, bytes)) item = npy_build(b, data, bytes);
        mem_free(data);
        if (!item) {
            if (b->status == SHERF_BAD_FILE) failure_prefix(b->c, b->status, "%.80s", name);
            return NULL;
        }
        if (!build_pair(b, dict, build_string(b, name, n - 4), item)) return NULL;
    }
    return dict;
}

sherf_status npz_read(context *c, const char *path, document **out) {
    builder b;
    *out = NULL;
    if (!build_start(&b, c, archive_limit(path))) return b.status;
    zip_t *zip = archive_open(&b, path);
    value *root = zip ? npz_build(&b, zip) : NULL;
    if (zip) zip_discard(zip);
    sherf_status status = build_finish(&b, root, out);
    return status == SHERF_OK ? status : failure_prefix(c, status, "%s", path);
}

/* One member: npy header and data in one block, which must live until the archive is closed. */
static sherf_status add_member(context *c, const char *path, zip_t *zip, const npz_member *member,
                               unsigned char **block) {
    enum { TEXT_MAX = 1000 };
    char header[256], name[256], descr[32] = "<f4";
    size_t letters = member->text ? strlen(member->text) : 0;
    int64_t n = member->rank >= 0 && member->rank <= 5 ? build_count(member->rank, member->dim) : -1;
    if (member->text) n = letters <= TEXT_MAX ? (int64_t)letters : -1;
    if (member->text) snprintf(descr, sizeof descr, "<U%zu", letters);
    if (n < 0 || snprintf(name, sizeof name, "%s.npy", member->name) >= (int)sizeof name)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: array %s cannot be written", path, member->name);
    size_t length = npy_header_text(descr, member->rank, member->dim, header),
           bytes = (size_t)n * sizeof *member->data;
    *block = mem_alloc(c, length + bytes, 1);
    if (!*block) return SHERF_NO_MEMORY;
    memcpy(*block, header, length);
    if (member->text) /* four bytes for each letter */
        for (size_t i = 0; i < bytes; i++)
            (*block)[length + i] = i % 4 ? 0 : (unsigned char)member->text[i / 4];
    else if (bytes)
        memcpy(*block + length, member->data, bytes);
    zip_source_t *source = zip_source_buffer(zip, *block, length + bytes, 0);
    if (!source) return failure(c, SHERF_NO_MEMORY, "out of memory");
    zip_int64_t i = zip_file_add(zip, name, source, ZIP_FL_ENC_UTF_8);
    if (i < 0) {
        zip_source_free(source);
        return failure(c, SHERF_WRITE_FAILED, "%s: %s", path, zip_strerror(zip));
    }
    zip_set_file_compression(zip, (zip_uint64_t)i, ZIP_CM_STORE, 0);
    return SHERF_OK;
}

sherf_status npz_write(context *c, const char *path, int count, const npz_member *member) {
    int code = 0;
    if (count < 0) return failure(c, SHERF_BAD_ARGUMENT, "%s: a negative number of arrays", path);
    unsigned char **block = mem_zero(c, (size_t)count + 1, sizeof *block);
    if (!block) return SHERF_NO_MEMORY;
    sherf_status status = SHERF_OK;
    /* libzip writes to a temporary name beside the path and renames in zip_close */
    zip_t *zip = zip_open(path, ZIP_CREATE | ZIP_TRUNCATE, &code);
    if (!zip) status = failure(c, SHERF_WRITE_FAILED, "%s: cannot be written", path);
    for (int i = 0; i < count && status == SHERF_OK; i++)
        status = add_member(c, path, zip, &member[i], &block[i]);
    if (zip && (status != SHERF_OK || zip_close(zip))) {
        if (status == SHERF_OK) status = failure(c, SHERF_WRITE_FAILED, "%s: %s", path, zip_strerror(zip));
        zip_discard(zip);
    }
    for (int i = 0; i < count; i++) mem_free(block[i]);
    mem_free(block);
    return status;
}
