/* torch: files of torch.save, the zip form (1.6 and later: NAME/data.pkl and NAME/data/KEY) and the legacy
 * form (torch_legacy.c); and files of any form by their first bytes. */
#include <string.h>

#include "base/path.h"
#include "io/archive.h"
#include "io/image.h"
#include "io/torch.h"
#include "io/utf16.h"

static const size_t torch_bytes_max = (size_t)8 << 30;

/* Of the zip form. */
typedef struct {
    torch_storages storages;
    zip_t *zip;         /* source of the bytes */
    const char *prefix; /* "NAME/" */
    size_t prefix_length;
} storage_table;

/* ---------------------------------------------------------------- zip -------------------------------- */
/* A member whose name ends in /data.pkl: a torch file. */
static bool torch_zip_is(zip_t *zip, uint64_t *member) {
    zip_int64_t count = zip_get_num_entries(zip, 0);
    for (zip_int64_t i = 0; i < count; i++) {
        const char *name = zip_get_name(zip, (zip_uint64_t)i, 0);
        if (!name || !path_ends(name, "/data.pkl")) continue;
        *member = (uint64_t)i;
        return true;
    }
    return false;
}

static unsigned char *zip_bytes(builder *b, zip_t *zip, uint64_t i, size_t *bytes) {
    if (!archive_size(b, zip, i, bytes)) return NULL;
    unsigned char *data = build_memory(b, *bytes, 1);
    return data && archive_member(b, zip, i, data, *bytes) ? data : NULL;
}

static zip_int64_t locate(storage_table *t, const char *name) {
    char path[1024];
    size_t n = strlen(name);
    if (t->prefix_length + n >= sizeof path) return -1;
    memcpy(path, t->prefix, t->prefix_length);
    memcpy(path + t->prefix_length, name, n + 1);
    return zip_name_locate(t->zip, path, 0);
}

static torch_storage *zip_storage(void *user, builder *b, dtype type, const char *key, int64_t count) {
    storage_table *t = user;
    torch_storage *s = torch_storage_named(&t->storages, b, type, key, count);
    char name[256] = "data/";
    if (!s || s->data) return s;
    size_t bytes;
    if (strlen(key) > 200) return build_fail(b, SHERF_BAD_FILE, "torch: a storage with an impossible name");
    zip_int64_t i = locate(t, strcat(name, key));
    if (i < 0) return build_fail(b, SHERF_BAD_FILE, "torch: storage %s is missing", key);
    s->data = zip_bytes(b, t->zip, (uint64_t)i, &bytes);
    if (!s->data) return NULL;
    if (bytes != (uint64_t)count * dtype_size(type))
        return build_fail(b, SHERF_BAD_FILE, "torch: storage %s has %zu bytes", key, bytes);
    return s;
}

static value *torch_zip_build(builder *b, zip_t *zip) {
    uint64_t member;
    size_t bytes;
    if (!torch_zip_is(zip, &member)) return build_fail(b, SHERF_BAD_FILE, "not a torch file: no data.pkl");
    storage_table *table = mem_zero(b->c, 1, sizeof *table);
    if (!table) {
        b->status = SHERF_NO_MEMORY;
        return NULL;
    }
    table->zip = zip;
    table->prefix = zip_get_name(zip, member, 0);
    table->prefix_length = strlen(table->prefix) - strlen("data.pkl");
    value *root = NULL;
    zip_int64_t order = locate(table, "byteorder");
    unsigned char *data = zip_bytes(b, zip, member, &bytes), *text;
    size_t n;
    if (order >= 0 && data && (text = zip_bytes(b, zip, (uint64_t)order, &n)) &&
        (n != 6 || memcmp(text, "little", 6)))
        build_fail(b, SHERF_UNSUPPORTED, "torch: written on a big-endian machine");
    const pickle_source source = {zip_storage, table, torch_legacy_build, 0};
    if (data) root = pickle_finish(b, pickle_build(b, data, bytes, &source, NULL));
    mem_free(table);
    return root;
}

/* ---------------------------------------------------------------- files ------------------------------ */
static sherf_status parse_legacy(context *c, const unsigned char *data, size_t bytes, document **out) {
    builder b;
    *out = NULL;
    if (!build_start(&b, c, build_limit(bytes))) return b.status;
    return build_finish(&b, pickle_finish(&b, torch_legacy_build(&b, data, bytes, 0)), out);
}

static bool npz_is(zip_t *zip) {
    const zip_int64_t count = zip_get_num_entries(zip, 0);
    for (zip_int64_t i = 0; i < count; i++) {
        const char *name = zip_get_name(zip, (zip_uint64_t)i, 0);
        if (name && path_ends(name, ".npy")) return true;
    }
    return count < 1; /* npz of nothing */
}

/* A zip as downloaded: the error names files in it that may be meant. */
static value *zip_of_files(builder *b, zip_t *zip) {
    const zip_int64_t count = zip_get_num_entries(zip, 0);
    const char *named = zip_get_name(zip, 0, 0);
    for (zip_int64_t i = 0; i < count; i++) {
        const char *name = zip_get_name(zip, (zip_uint64_t)i, 0);
        if (name && (path_ends(name, ".pkl") || path_ends(name, ".npz") || path_ends(name, ".pt")))
            named = name;
    }
    return build_fail(b, SHERF_UNSUPPORTED,
                      "a ZIP archive of %lld files (%.100s, ...): unpack it, and name one", (long long)count,
                      named ? named : "?");
}

/* Either kind of zip file. */
static value *zip_build(builder *b, zip_t *zip, const char **kind) {
    uint64_t member;
    bool torch = zip && torch_zip_is(zip, &member);
    value *root = !zip          ? NULL
                  : torch       ? torch_zip_build(b, zip)
                  : npz_is(zip) ? npz_build(b, zip)
                                : zip_of_files(b, zip);
    if (zip) zip_discard(zip);
    *kind = torch ? "torch" : "npz";
    return root;
}

static sherf_status read_zip(context *c, const char *path, document **out, const char **kind) {
    builder b;
    *out = NULL;
    if (!build_start(&b, c, archive_limit(path))) return b.status;
    return build_finish(&b, zip_build(&b, archive_open(&b, path), kind), out);
}

static sherf_status parse_zip(context *c, const unsigned char *data, size_t bytes, document **out,
                              const char **kind) {
    builder b;
    *out = NULL;
    if (!build_start(&b, c, build_limit(bytes))) return b.status;
    return build_finish(&b, zip_build(&b, archive_open_bytes(&b, data, bytes), kind), out);
}

static size_t beginning(const char *path, unsigned char *data, size_t room) {
    FILE *f = fopen(path, "rb");
    size_t n = f && path_is_file(path) ? fread(data, 1, room, f) : 0;
    if (f) fclose(f);
    return n;
}

sherf_status torch_read(context *c, const char *path, document **out) {
    unsigned char start[4], *data = NULL;
    size_t bytes = 0;
    sherf_status status;
    *out = NULL;
    if (beginning(path, start, 4) == 4 && !memcmp(start, "PK\3\4", 4)) {
        const char *kind;
        status = read_zip(c, path, out, &kind);
        if (status == SHERF_OK && strcmp(kind, "torch")) {
            document_free(*out);
            *out = NULL;
            status = failure(c, SHERF_BAD_FILE, "not a torch file: no data.pkl");
        }
    } else {
        status = file_read(c, path, torch_bytes_max, &data, &bytes);
        if (status != SHERF_OK) return status;
        status = parse_legacy(c, data, bytes, out);
        mem_free(data);
    }
    return status == SHERF_OK ? status : failure_prefix(c, status, "%s", path);
}

/* A text that starts like JSON. */
static bool json_is(const unsigned char *data, size_t bytes) {
    size_t i = bytes >= 3 && !memcmp(data, "\xef\xbb\xbf", 3) ? 3 : 0;
    while (i < bytes && (data[i] == ' ' || (data[i] >= 9 && data[i] <= 13))) i++;
    return i < bytes && (data[i] == '{' || data[i] == '[');
}

/* safetensors: the length of a header that starts with '{'. */
static bool safetensors_is(const unsigned char *data, size_t bytes) {
    return bytes > 8 && data[8] == '{' && data[5] == 0 && data[6] == 0 && data[7] == 0;
}

typedef enum {
    FORM_ZIP,
    FORM_PACKED,
    FORM_ZLIB,
    FORM_NPY,
    FORM_SAFETENSORS,
    FORM_TORCH,
    FORM_JSON,
    FORM_YAML,
    FORM_PICKLE
} form;
static const char *const form_name[] = {"zip",   "packed", "pickle", "npy",   "safetensors",
                                        "torch", "json",   "yaml",   "pickle"};

static form form_of(const unsigned char *start, size_t n) {
    /* first: the length that it begins with may look like zlib's or gzip's mark */
    if (safetensors_is(start, n)) return FORM_SAFETENSORS;
    if (n >= 4 && (!memcmp(start, "PK\3\4", 4) || !memcmp(start, "PK\5\6", 4))) return FORM_ZIP;
    if (packed_kind(start, n)) return FORM_PACKED;
    if (zlib_is(start, n)) return FORM_ZLIB;
    if (n >= 6 && !memcmp(start, "\x93NUMPY", 6)) return FORM_NPY;
    if (torch_legacy_is(start, n)) return FORM_TORCH;
    if (opencv_yaml_is(start, n)) return FORM_YAML;
    return json_is(start, n) || utf16_is(start, n) ? FORM_JSON : FORM_PICKLE;
}

/* Unpacks once only, against bombs. */
static sherf_status parse_packed(context *c, bool zlib, const unsigned char *data, size_t bytes,
                                 document **out, const char **kind) {
    unsigned char *unpacked;
    size_t length;
    sherf_status status = zlib ? zlib_unpack(c, data, bytes, &unpacked, &length)
                               : packed_unpack(c, data, bytes, &unpacked, &length);
    if (status) return status;
    if (packed_kind(unpacked, length) || zlib_is(unpacked, length))
        status = failure(c, SHERF_UNSUPPORTED, "packed twice; unpack it first");
    else
        status = document_parse(c, unpacked, length, out, kind);
    mem_free(unpacked);
    return status;
}

sherf_status document_parse(context *c, const unsigned char *data, size_t bytes, document **out,
                            const char **kind) {
    form f = form_of(data, bytes < 64 ? bytes : 64);
    const char *found = form_name[f];
    sherf_status status = SHERF_OK;
    *out = NULL;
    switch (f) {
    case FORM_ZIP:
        status = parse_zip(c, data, bytes, out, &found);
        break;
    case FORM_PACKED:
    case FORM_ZLIB:
        status = parse_packed(c, f == FORM_ZLIB, data, bytes, out, &found);
        break;
    case FORM_NPY:
        status = npy_parse(c, data, bytes, out);
        break;
    case FORM_SAFETENSORS:
        status = safetensors_document_parse(c, data, bytes, out);
        break;
    case FORM_TORCH:
        status = parse_legacy(c, data, bytes, out);
        break;
    case FORM_JSON:
        status = json_parse(c, (const char *)data, bytes, out);
        break;
    case FORM_YAML:
        status = opencv_yaml_parse(c, data, bytes, out);
        break;
    case FORM_PICKLE:
        status = pickle_parse(c, data, bytes, out);
        if (status == SHERF_BAD_FILE) image_other_name(c, data, bytes);
        break;
    }
    if (kind) *kind = status == SHERF_OK ? found : NULL;
    return status;
}

/* Zip and safetensors files are read piece by piece; others are read whole. */
sherf_status document_read(context *c, const char *path, document **out, const char **kind) {
    unsigned char start[64], *data = NULL;
    size_t bytes;
    form f = form_of(start, beginning(path, start, sizeof start));
    const char *found = form_name[f];
    sherf_status status;
    *out = NULL;
    if (kind) *kind = NULL;
    if (f == FORM_SAFETENSORS) {
        status = safetensors_document(c, path, out); /* names the file itself */
    } else if (f == FORM_ZIP) {
        status = read_zip(c, path, out, &found);
        if (status != SHERF_OK) failure_prefix(c, status, "%s", path);
    } else {
        status = file_read(c, path, torch_bytes_max, &data, &bytes);
        if (status != SHERF_OK) return status;
        status = document_parse(c, data, bytes, out, &found);
        mem_free(data);
        if (status != SHERF_OK) failure_prefix(c, status, "%s", path);
    }
    if (kind && status == SHERF_OK) *kind = found;
    return status;
}
