/* safetensors: reading, strictly, and writing. */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <zlib.h>

#include "base/only_read.h"
#include "base/path.h"
#include "io/image.h"
#include "io/build.h"
#include "io/half.h"
#include "io/safetensors.h"

static const uint64_t header_bytes_max = (uint64_t)32 << 20;

/* ---------------------------------------------------------------- names ------------------------------ */
static const struct {
    const char *name;
    dtype type;
} types[] = {{"F32", T_F32}, {"F64", T_F64},   {"I32", T_I32}, {"I64", T_I64},
             {"U8", T_U8},   {"BF16", T_BF16}, {"F16", T_F16}, {"BOOL", T_U8}};

static bool type_named(const value *v, dtype *out) {
    for (size_t i = 0; i < COUNT_OF(types); i++)
        if (value_is_string(v, types[i].name)) {
            *out = types[i].type;
            return true;
        }
    return false;
}

static const char *type_name(dtype t) {
    for (size_t i = 0; i < COUNT_OF(types); i++)
        if (types[i].type == t) return types[i].name;
    return "?";
}

static void shape_text(int rank, const int64_t *dim, char out[160]) {
    size_t n = (size_t)snprintf(out, 160, "[");
    for (int i = 0; i < rank; i++)
        n += (size_t)snprintf(out + n, 160 - n, i ? ", %lld" : "%lld", (long long)dim[i]);
    snprintf(out + n, 160 - n, "]");
}

/* ---------------------------------------------------------------- checksum --------------------------- */
enum { CHECKSUM_DIGITS = 8 };
static const char checksum_lead[] = "{\"__metadata__\":{\"crc32\":\"", checksum_none[] = "00000000";
enum { CHECKSUM_AT = sizeof checksum_lead - 1 };

static uint32_t sum_bytes(uint32_t sum, const void *data, size_t bytes) {
    return (uint32_t)crc32_z(sum, data, bytes);
}

static void checksum_text(uint32_t sum, char text[CHECKSUM_DIGITS + 1]) {
    snprintf(text, CHECKSUM_DIGITS + 1, "%08x", (unsigned)sum);
}

/* Whether a header states a checksum, and the sum of the file up to the header's end. */
static bool header_sum(const unsigned char start[8], const char *text, size_t n, uint32_t *sum) {
    const size_t behind = CHECKSUM_AT + CHECKSUM_DIGITS;
    if (n < behind || memcmp(text, checksum_lead, CHECKSUM_AT)) return false;
    *sum = sum_bytes(0, start, 8);
    *sum = sum_bytes(*sum, text, CHECKSUM_AT);
    *sum = sum_bytes(*sum, checksum_none, CHECKSUM_DIGITS);
    *sum = sum_bytes(*sum, text + behind, n - behind);
    return true;
}

/* ---------------------------------------------------------------- reading ---------------------------- */
typedef struct {
    safetensor *tensor;
    int64_t begin, end;
} span;

typedef struct {
    context *c;
    arena *a;
    safetensors *s;
    span *spans;
    bool summed; /* has a checksum */
    uint32_t sum;
} reader;

static char *copy_text(reader *r, const value *v) {
    char *text = arena_alloc(r->c, r->a, v->string.length + 1, 1);
    if (text) memcpy(text, v->string.text, v->string.length + 1);
    return text;
}

static sherf_status one_tensor(reader *r, const value *key, const value *item, int64_t data_bytes) {
    context *c = r->c;
    const char *name = key->string.text;
    const value *type = value_get(item, "dtype"), *shape = value_get(item, "shape"),
                *offsets = value_get(item, "data_offsets");
    span *at = &r->spans[r->s->count];
    safetensor *t = &r->s->tensor[r->s->count];
    *t = (safetensor){0};
    if (!type || type->kind != VALUE_STRING || !shape || shape->kind != VALUE_LIST ||
        value_count(offsets) != 2 || value_count(item) != 3)
        return failure(c, SHERF_BAD_FILE, "tensor %.200s: dtype, shape and data_offsets expected", name);
    if (!type_named(type, &t->type))
        return failure(c, SHERF_UNSUPPORTED, "tensor %.200s: type %.40s is not read", name,
                       type->string.text);
    if (value_count(shape) > TENSOR_RANK)
        return failure(c, SHERF_UNSUPPORTED, "tensor %.200s: more than %d dimensions", name, TENSOR_RANK);
    t->rank = (int)value_count(shape);
    for (int i = 0; i < t->rank; i++) {
        const value *n = value_at(shape, (size_t)i);
        if (n->kind != VALUE_INTEGER || n->integer < 0)
            return failure(c, SHERF_BAD_FILE, "tensor %.200s: an impossible shape", name);
        t->dim[i] = n->integer;
    }
    const value *begin = value_at(offsets, 0), *end = value_at(offsets, 1);
    int64_t count = build_count(t->rank, t->dim);
    if (begin->kind != VALUE_INTEGER || end->kind != VALUE_INTEGER || begin->integer < 0 ||
        end->integer < begin->integer || end->integer > data_bytes)
        return failure(c, SHERF_BAD_FILE, "tensor %.200s: its data is not within the file", name);
    if (count < 0 || end->integer - begin->integer != count * (int64_t)dtype_size(t->type))
        return failure(c, SHERF_BAD_FILE, "tensor %.200s: its data has %lld bytes, its shape says otherwise",
                       name, (long long)(end->integer - begin->integer));
    t->name = copy_text(r, key);
    *at = (span){t, begin->integer, end->integer};
    r->s->count++;
    return t->name ? SHERF_OK : SHERF_NO_MEMORY;
}

static sherf_status read_metadata(reader *r, const value *metadata) {
    if (metadata->kind != VALUE_DICT) return failure(r->c, SHERF_BAD_FILE, "metadata that is no dict");
    size_t n = value_count(metadata);
    r->s->metadata_key = arena_alloc(r->c, r->a, n, sizeof(char *));
    r->s->metadata_value = arena_alloc(r->c, r->a, n, sizeof(char *));
    if (!r->s->metadata_key || !r->s->metadata_value) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) {
        if (metadata->dict.pair[i].item->kind != VALUE_STRING)
            return failure(r->c, SHERF_BAD_FILE, "metadata that is no text");
        r->s->metadata_key[i] = copy_text(r, metadata->dict.pair[i].key);
        r->s->metadata_value[i] = copy_text(r, metadata->dict.pair[i].item);
        if (!r->s->metadata_key[i] || !r->s->metadata_value[i]) return SHERF_NO_MEMORY;
    }
    r->s->metadata_count = n;
    return SHERF_OK;
}

static int by_begin(const void *x, const void *y) {
    const span *a = x, *b = y;
    if (a->begin != b->begin) return a->begin < b->begin ? -1 : 1;
    if (a->end != b->end) return a->end < b->end ? -1 : 1;
    return a->tensor < b->tensor ? -1 : a->tensor > b->tensor;
}

static int by_name(const void *x, const void *y) {
    return strcmp(((const span *)x)->tensor->name, ((const span *)y)->tensor->name);
}

/* Names must differ; data must lie without overlap or hole, in the order of the sorted spans. */
static sherf_status check_spans(reader *r, int64_t data_bytes) {
    size_t n = r->s->count;
    qsort(r->spans, n, sizeof *r->spans, by_name);
    for (size_t i = 1; i < n; i++)
        if (!by_name(&r->spans[i - 1], &r->spans[i]))
            return failure(r->c, SHERF_BAD_FILE, "tensor %.200s is there twice", r->spans[i].tensor->name);
    qsort(r->spans, n, sizeof *r->spans, by_begin);
    int64_t at = 0;
    for (size_t i = 0; i < n; i++) {
        if (r->spans[i].begin != at)
            return failure(r->c, SHERF_BAD_FILE, "tensor %.200s: its data %s", r->spans[i].tensor->name,
                           r->spans[i].begin < at ? "overlaps another's" : "leaves a hole before it");
        at = r->spans[i].end;
    }
    if (at != data_bytes)
        return failure(r->c, SHERF_BAD_FILE, "%lld bytes behind the tensors", (long long)(data_bytes - at));
    return SHERF_OK;
}

static sherf_status read_header(reader *r, const value *root, int64_t data_bytes) {
    if (root->kind != VALUE_DICT) return failure(r->c, SHERF_BAD_FILE, "a header that is no dict");
    size_t n = value_count(root);
    bool described = false;
    r->spans = arena_alloc(r->c, r->a, n, sizeof *r->spans);
    r->s->tensor = arena_alloc(r->c, r->a, n, sizeof *r->s->tensor);
    if (!r->spans || !r->s->tensor) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) {
        const value_pair *p = &root->dict.pair[i];
        bool metadata = value_is_string(p->key, "__metadata__");
        if (metadata && described) return failure(r->c, SHERF_BAD_FILE, "two pieces of metadata");
        described |= metadata;
        sherf_status status =
            metadata ? read_metadata(r, p->item) : one_tensor(r, p->key, p->item, data_bytes);
        if (status != SHERF_OK) return status;
    }
    return check_spans(r, data_bytes);
}

/* Reads every tensor's bytes to its own 64-byte aligned place, in file order; the list then has that
 * order. */
static sherf_status read_data(reader *r, FILE *f) {
    size_t total = 0, n = r->s->count;
    for (size_t i = 0; i < n; i++) total += ((size_t)(r->spans[i].end - r->spans[i].begin) + 63) / 64 * 64;
    char *data = arena_alloc(r->c, r->a, total, 1);
    safetensor *ordered = arena_alloc(r->c, r->a, n, sizeof *ordered);
    if (!data || !ordered) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) {
        size_t bytes = (size_t)(r->spans[i].end - r->spans[i].begin);
        if (bytes && fread(data, 1, bytes, f) != bytes)
            return failure(r->c, SHERF_BAD_FILE, "truncated in tensor %.200s", r->spans[i].tensor->name);
        if (r->summed) r->sum = sum_bytes(r->sum, data, bytes);
        ordered[i] = *r->spans[i].tensor;
        ordered[i].data = data;
        data += (bytes + 63) / 64 * 64;
    }
    r->s->tensor = ordered;
    return SHERF_OK;
}

/* After read_data: checks the bytes against the checksum that the header `text` states, if any. */
static sherf_status check_sum(const reader *r, const char *text) {
    char digits[CHECKSUM_DIGITS + 1];
    checksum_text(r->sum, digits);
    if (!r->summed || !memcmp(text + CHECKSUM_AT, digits, CHECKSUM_DIGITS)) return SHERF_OK;
    return failure(r->c, SHERF_BAD_FILE,
                   "damaged: its bytes do not give its checksum; take another copy or make it anew (what was "
                   "changed on purpose must not have crc32 in its metadata)");
}

/* What a file from others' releases is that sherf convert reads; NULL: none. A torch ZIP has data.pkl first.
 */
static const char *convertible(const unsigned char *start, size_t n) {
    static const char zip[] = "PK\3\4", inside[] = "/data.pkl";
    if (n > 2 && start[0] == 0x80 && start[1] >= 2 && start[1] <= 5) return "a pickle";
    for (size_t i = 0; n > 100 && !memcmp(start, zip, 4) && i < 90; i++)
        if (!memcmp(start + i, inside, sizeof inside - 1)) return "a PyTorch file";
    return NULL;
}

/* Names the kind of a file that is not safetensors, if it is known. */
static sherf_status not_one(context *c, FILE *f) {
    unsigned char start[IMAGE_KIND_BYTES];
    rewind(f);
    const size_t n = fread(start, 1, sizeof start, f);
    const char *kind = convertible(start, n);
    image_other_name(c, start, n);
    return kind ? failure(c, SHERF_BAD_FILE, "%s: convert it first (sherf convert FILE -o NEW.safetensors)",
                          kind)
                : SHERF_BAD_FILE;
}

/* f is at its beginning and `bytes` long. */
static sherf_status load(context *c, FILE *f, uint64_t bytes, safetensors **out) {
    unsigned char start[8];
    uint64_t header = 0;
    document *d = NULL;
    char *text = NULL;
    reader r = {.c = c};
    sherf_status status = SHERF_NO_MEMORY;
    *out = NULL;
    if (bytes < 8 || fread(start, 1, 8, f) != 8)
        return failure(c, SHERF_BAD_FILE, "not a safetensors file: too short");
    for (int i = 0; i < 8; i++) header |= (uint64_t)start[i] << 8 * i;
    if (header < 2 || header > header_bytes_max || header > bytes - 8) {
        failure(c, SHERF_BAD_FILE, "not a safetensors file, or truncated: a header of %llu bytes",
                (unsigned long long)header);
        return not_one(c, f);
    }
    text = mem_alloc(c, (size_t)header + 1, 1);
    r.a = text ? arena_create(c) : NULL;
    r.s = r.a ? arena_alloc(c, r.a, 1, sizeof *r.s) : NULL;
    if (!r.s) goto done;
    *r.s = (safetensors){.memory = r.a};
    if (fread(text, 1, (size_t)header, f) != header || text[0] != '{') {
        status = failure(c, SHERF_BAD_FILE, "not a safetensors file: no header");
        goto done;
    }
    r.summed = header_sum(start, text, (size_t)header, &r.sum);
    status = json_parse(c, text, (size_t)header, &d);
    if (status == SHERF_OK) status = read_header(&r, d->root, (int64_t)(bytes - 8 - header));
    if (status == SHERF_OK) status = read_data(&r, f);
    if (status == SHERF_OK) status = check_sum(&r, text);
    r.s->memory_bytes = arena_peak(r.a);
done:
    document_free(d);
    mem_free(text);
    if (status == SHERF_OK)
        *out = r.s;
    else if (r.a)
        arena_free(r.a);
    return status;
}

sherf_status safetensors_read(context *c, const char *path, safetensors **out) {
    struct stat info;
    *out = NULL;
    FILE *f = fopen(path, "rb");
    if (!f) return failure(c, SHERF_NO_FILE, "%s: cannot be opened: %s", path, strerror(errno));
    sherf_status status;
    if (fstat(fileno(f), &info) || !S_ISREG(info.st_mode))
        status = failure(c, SHERF_BAD_FILE, "not a file");
    else
        status = load(c, f, (uint64_t)info.st_size, out);
    fclose(f);
    return status == SHERF_OK ? status : failure_prefix(c, status, "%s", path);
}

sherf_status safetensors_parse(context *c, const void *data, size_t bytes, safetensors **out) {
    *out = NULL;
    FILE *f = bytes ? fmemopen(only_read(data), bytes, "rb") : NULL;
    if (!f) return failure(c, SHERF_BAD_FILE, "not a safetensors file: too short");
    sherf_status status = load(c, f, bytes, out);
    fclose(f);
    return status;
}

void safetensors_free(safetensors *s) {
    if (s) arena_free(s->memory); /* s lives there */
}

const safetensor *safetensors_find(const safetensors *s, const char *name) {
    for (size_t i = 0; i < s->count; i++)
        if (!strcmp(s->tensor[i].name, name)) return &s->tensor[i];
    return NULL;
}

const char *safetensors_metadata(const safetensors *s, const char *key) {
    for (size_t i = 0; i < s->metadata_count; i++)
        if (!strcmp(s->metadata_key[i], key)) return s->metadata_value[i];
    return NULL;
}

sherf_status safetensors_floats(context *c, const safetensors *s, const char *name, int rank,
                                const int64_t *dim, float *out) {
    const safetensor *t = safetensors_find(s, name);
    if (!t) return failure(c, SHERF_MISMATCH, "tensor %s is missing", name);
    bool same = t->rank == rank;
    for (int i = 0; same && i < rank; i++) same = t->dim[i] == dim[i];
    if (!same) {
        char have[160], want[160];
        shape_text(t->rank, t->dim, have);
        shape_text(rank, dim, want);
        return failure(c, SHERF_MISMATCH, "tensor %s is %s, not %s", name, have, want);
    }
    int64_t n = build_count(rank, dim);
    if (t->type == T_F32)
        memcpy(out, t->data, (size_t)n * sizeof *out);
    else if (t->type == T_F64)
        for (int64_t i = 0; i < n; i++) out[i] = (float)((const double *)t->data)[i];
    else if (t->type == T_F16)
        for (int64_t i = 0; i < n; i++) out[i] = half_to_float(((const uint16_t *)t->data)[i]);
    else if (t->type == T_BF16)
        for (int64_t i = 0; i < n; i++) out[i] = bf16_to_float(((const uint16_t *)t->data)[i]);
    else
        return failure(c, SHERF_MISMATCH, "tensor %s holds %s, not floats", name, type_name(t->type));
    return SHERF_OK;
}

static value *as_value(builder *b, const safetensors *s) {
    value *root = build_value(b, VALUE_DICT), *metadata = build_value(b, VALUE_DICT);
    for (size_t i = 0; i < s->metadata_count; i++) {
        const char *k = s->metadata_key[i], *v = s->metadata_value[i];
        if (!build_pair(b, metadata, build_string(b, k, strlen(k)), build_string(b, v, strlen(v))))
            return NULL;
    }
    if (s->metadata_count && !build_pair(b, root, build_string(b, "__metadata__", 12), metadata)) return NULL;
    for (size_t i = 0; i < s->count; i++) {
        const safetensor *t = &s->tensor[i];
        value *v = build_array(b, t->type, t->rank, t->dim);
        if (!v || !build_pair(b, root, build_string(b, t->name, strlen(t->name)), v)) return NULL;
        memcpy(v->array.data, t->data, (size_t)build_count(t->rank, t->dim) * dtype_size(t->type));
    }
    return root;
}

/* Takes over s. */
static sherf_status as_document(context *c, safetensors *s, document **out) {
    builder b;
    sherf_status status = SHERF_NO_MEMORY;
    if (build_start(&b, c, SIZE_MAX / 4)) status = build_finish(&b, as_value(&b, s), out);
    safetensors_free(s);
    return status;
}

sherf_status safetensors_document(context *c, const char *path, document **out) {
    safetensors *s;
    *out = NULL;
    sherf_status status = safetensors_read(c, path, &s);
    return status == SHERF_OK ? as_document(c, s, out) : status;
}

sherf_status safetensors_document_parse(context *c, const void *data, size_t bytes, document **out) {
    safetensors *s;
    *out = NULL;
    sherf_status status = safetensors_parse(c, data, bytes, &s);
    return status == SHERF_OK ? as_document(c, s, out) : status;
}

/* ---------------------------------------------------------------- writing ---------------------------- */
typedef struct {
    context *c;
    char *data;
    size_t count, room;
    bool failed;
} text_buffer;

static void add(text_buffer *t, const char *text, size_t n) {
    if (t->failed) return;
    if (t->room - t->count < n) {
        size_t room = t->room ? t->room * 2 : 4096;
        while (room - t->count < n) room *= 2;
        char *grown = mem_grow(t->c, t->data, t->count, room, 1);
        if (!grown) {
            t->failed = true;
            return;
        }
        t->data = grown;
        t->room = room;
    }
    memcpy(t->data + t->count, text, n);
    t->count += n;
}

static void add_text(text_buffer *t, const char *text) {
    add(t, text, strlen(text));
}

static void add_quoted(text_buffer *t, const char *text) {
    add(t, "\"", 1);
    for (; *text; text++) {
        char code[8];
        if ((unsigned char)*text < 0x20) {
            snprintf(code, sizeof code, "\\u%04x", (unsigned char)*text);
            add_text(t, code);
        } else {
            if (*text == '"' || *text == '\\') add(t, "\\", 1);
            add(t, text, 1);
        }
    }
    add(t, "\"", 1);
}

static sherf_status write_header(context *c, text_buffer *t, size_t count, const safetensor_item *item,
                                 size_t metadata_count, const safetensor_metadata *metadata) {
    uint64_t at = 0;
    const char *comma = "";
    add_text(t, "{");
    if (metadata_count) {
        add_text(t, "\"__metadata__\":{");
        for (size_t i = 0; i < metadata_count; i++) {
            add_text(t, i ? "," : "");
            add_quoted(t, metadata[i].key);
            add_text(t, ":");
            add_quoted(t, metadata[i].value ? metadata[i].value : checksum_none);
        }
        add_text(t, "}");
        comma = ",";
    }
    for (size_t i = 0; i < count; i++) {
        char text[128];
        int64_t n =
            item[i].rank >= 0 && item[i].rank <= TENSOR_RANK ? build_count(item[i].rank, item[i].dim) : -1;
        if (n < 0) return failure(c, SHERF_BAD_ARGUMENT, "tensor %s has an impossible shape", item[i].name);
        add_text(t, comma);
        comma = ",";
        add_quoted(t, item[i].name);
        snprintf(text, sizeof text, ":{\"dtype\":\"%s\",\"shape\":[", type_name(item[i].type));
        add_text(t, text);
        for (int k = 0; k < item[i].rank; k++) {
            snprintf(text, sizeof text, k ? ",%lld" : "%lld", (long long)item[i].dim[k]);
            add_text(t, text);
        }
        uint64_t end = at + (uint64_t)n * dtype_size(item[i].type);
        snprintf(text, sizeof text, "],\"data_offsets\":[%llu,%llu]}", (unsigned long long)at,
                 (unsigned long long)end);
        add_text(t, text);
        at = end;
    }
    add_text(t, "}");
    while (!t->failed && (t->count + 8) % 64) add(t, " ", 1);
    return t->failed ? SHERF_NO_MEMORY : SHERF_OK;
}

static size_t item_bytes(const safetensor_item *item) {
    return (size_t)build_count(item->rank, item->dim) * dtype_size(item->type);
}

/* Writes the checksum's digits into the header. */
static void fill_sum(const unsigned char start[8], text_buffer *t, size_t count,
                     const safetensor_item *item) {
    char digits[CHECKSUM_DIGITS + 1];
    uint32_t sum;
    if (!header_sum(start, t->data, t->count, &sum)) return;
    for (size_t i = 0; i < count; i++)
        if (item_bytes(&item[i])) sum = sum_bytes(sum, item[i].data, item_bytes(&item[i]));
    checksum_text(sum, digits);
    memcpy(t->data + CHECKSUM_AT, digits, CHECKSUM_DIGITS);
}

sherf_status safetensors_write(context *c, const char *path, size_t count, const safetensor_item *item,
                               size_t metadata_count, const safetensor_metadata *metadata) {
    text_buffer t = {.c = c};
    output_file file = {0};
    unsigned char start[8];
    sherf_status status = write_header(c, &t, count, item, metadata_count, metadata);
    if (status != SHERF_OK) goto done;
    for (int i = 0; i < 8; i++) start[i] = (unsigned char)((uint64_t)t.count >> 8 * i);
    if (metadata_count && !metadata[0].value) fill_sum(start, &t, count, item);
    status = output_open(c, path, &file);
    if (status == SHERF_OK) status = output_write(c, &file, start, 8);
    if (status == SHERF_OK) status = output_write(c, &file, t.data, t.count);
    for (size_t i = 0; i < count && status == SHERF_OK; i++)
        status = output_write(c, &file, item[i].data, item_bytes(&item[i]));
    if (status == SHERF_OK) status = output_commit(c, &file);
done:
    output_abort(&file);
    mem_free(t.data);
    return status;
}
