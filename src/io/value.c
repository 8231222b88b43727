/* value: the tree's lookups and numbers, and the builder that makes trees. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "io/build.h"
#include "io/half.h"

/* ---------------------------------------------------------------- builder ---------------------------- */
static const size_t slab_bytes = (size_t)64 << 10;

size_t build_limit(size_t input_bytes) {
    size_t limit;
    if (__builtin_mul_overflow(input_bytes, (size_t)16, &limit)) return SIZE_MAX / 4;
    return limit > SIZE_MAX / 4 ? SIZE_MAX / 4 : limit + ((size_t)512 << 20);
}

bool build_start(builder *b, context *c, size_t limit) {
    *b = (builder){.c = c, .limit = limit};
    b->memory = arena_create(c);
    if (!b->memory) b->status = SHERF_NO_MEMORY;
    return b->memory != NULL;
}

sherf_status build_finish(builder *b, value *root, document **out) {
    *out = NULL;
    document *d = root ? build_memory(b, 1, sizeof *d) : NULL;
    if (d && b->status == SHERF_OK) {
        d->memory = b->memory;
        d->root = root;
        *out = d;
        return SHERF_OK;
    }
    arena_free(b->memory);
    b->memory = NULL;
    return b->status ? b->status : failure(b->c, SHERF_BAD_FILE, "nothing in it");
}

void document_free(document *d) {
    if (d) arena_free(d->memory); /* d itself lives there */
}

void *build_fail(builder *b, sherf_status status, const char *format, ...) {
    if (b->status != SHERF_OK) return NULL;
    char text[sizeof b->c->message];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof text, format, args);
    va_end(args);
    b->status = failure(b->c, status, "%s", text);
    return NULL;
}

void *build_memory(builder *b, size_t count, size_t size) {
    size_t bytes;
    if (b->status != SHERF_OK) return NULL;
    if (__builtin_mul_overflow(count, size, &bytes) || bytes > b->limit - b->used)
        return build_fail(b, SHERF_BAD_FILE, "needs more memory than a file of its size may (%zu MB)",
                          b->limit >> 20);
    bytes = bytes ? (bytes + 15) & ~(size_t)15 : 16;
    void *p = NULL;
    if (bytes >= slab_bytes / 16) {
        p = arena_alloc(b->c, b->memory, bytes, 1);
    } else {
        if (bytes > b->slab_left) {
            b->slab = arena_alloc(b->c, b->memory, slab_bytes, 1);
            b->slab_left = b->slab ? slab_bytes : 0;
        }
        if (b->slab) {
            p = b->slab;
            b->slab += bytes;
            b->slab_left -= bytes;
        }
    }
    if (!p) {
        b->status = SHERF_NO_MEMORY; /* the message is already set */
        return NULL;
    }
    b->used = bytes > b->limit - b->used ? b->limit : b->used + bytes;
    return p;
}

value *build_value(builder *b, value_kind kind) {
    object *o = build_memory(b, 1, sizeof *o);
    if (!o) return NULL;
    memset(o, 0, sizeof *o);
    o->v.kind = kind;
    return &o->v;
}

value *build_integer(builder *b, int64_t i) {
    value *v = build_value(b, VALUE_INTEGER);
    if (v) v->integer = i;
    return v;
}

value *build_real(builder *b, double r) {
    value *v = build_value(b, VALUE_REAL);
    if (v) v->real = r;
    return v;
}

value *build_bool(builder *b, bool truth) {
    object **o = &b->truth[truth];
    if (!*o) *o = (object *)build_value(b, VALUE_BOOL);
    if (*o) (*o)->v.boolean = truth;
    return *o ? &(*o)->v : NULL;
}

value *build_none(builder *b) {
    if (!b->none) b->none = (object *)build_value(b, VALUE_NONE);
    return b->none ? &b->none->v : NULL;
}

value *build_string(builder *b, const char *text, size_t length) {
    value *v = build_value(b, VALUE_STRING);
    char *copy = v ? build_memory(b, length + 1, 1) : NULL;
    if (!copy) return NULL;
    if (length) memcpy(copy, text, length);
    copy[length] = 0;
    v->string.text = copy;
    v->string.length = length;
    return v;
}

/* Room for one more of `count` pieces; the old memory stays in the arena. */
static void *room(builder *b, object *o, void *old, size_t count, size_t size) {
    if (count < o->capacity) return old;
    size_t capacity = o->capacity ? o->capacity * 2 : 4;
    void *p = build_memory(b, capacity, size);
    if (!p) return NULL;
    if (count) memcpy(p, old, count * size);
    o->capacity = capacity;
    return p;
}

bool build_append(builder *b, value *list, value *item) {
    if (!list || !item) return false;
    value **items = room(b, (object *)list, list->list.item, list->list.count, sizeof *items);
    if (!items) return false;
    list->list.item = items;
    items[list->list.count++] = item;
    return true;
}

bool build_pair(builder *b, value *dict, value *key, value *item) {
    if (!dict || !key || !item) return false;
    value_pair *pairs = room(b, (object *)dict, dict->dict.pair, dict->dict.count, sizeof *pairs);
    if (!pairs) return false;
    dict->dict.pair = pairs;
    pairs[dict->dict.count++] = (value_pair){key, item};
    return true;
}

bool build_entry(builder *b, value *dict, const char *key, value *item) {
    return build_pair(b, dict, build_string(b, key, strlen(key)), item);
}

int64_t build_count(int rank, const int64_t *dim) {
    int64_t n = 1;
    bool zero = false;
    for (int i = 0; i < rank; i++) {
        if (dim[i] < 0) return -1;
        if (dim[i] == 0)
            zero = true;
        else if (__builtin_mul_overflow(n, dim[i], &n) || n > INT64_MAX / 64)
            return -1;
    }
    return zero ? 0 : n;
}

value *build_array(builder *b, dtype type, int rank, const int64_t *dim) {
    if (rank < 0 || rank > 8)
        return build_fail(b, SHERF_BAD_FILE, "an array of %d dimensions, more than 8", rank);
    int64_t n = build_count(rank, dim);
    if (n < 0) return build_fail(b, SHERF_BAD_FILE, "an array's shape is impossible");
    value *v = build_value(b, VALUE_ARRAY);
    void *data = v ? build_memory(b, (size_t)n, dtype_size(type)) : NULL;
    if (!data) return NULL;
    v->array.type = type;
    v->array.rank = rank;
    for (int i = 0; i < rank; i++) v->array.dim[i] = dim[i];
    v->array.data = data;
    return v;
}

/* ---------------------------------------------------------------- lookups ---------------------------- */
bool value_is_string(const value *v, const char *text) {
    size_t n = strlen(text);
    return v && v->kind == VALUE_STRING && v->string.length == n && !memcmp(v->string.text, text, n);
}

const value *value_get(const value *d, const char *key) {
    if (d && d->kind == VALUE_RECORD) d = d->record.state;
    if (!d || d->kind != VALUE_DICT) return NULL;
    for (size_t i = d->dict.count; i-- > 0;) /* from the end: the last of equal keys counts */
        if (value_is_string(d->dict.pair[i].key, key)) return d->dict.pair[i].item;
    return NULL;
}

const value *value_at(const value *list, size_t i) {
    return list && list->kind == VALUE_LIST && i < list->list.count ? list->list.item[i] : NULL;
}

const value *value_unwrapped(const value *v) {
    while (v && v->kind == VALUE_LIST && v->list.count == 1) v = v->list.item[0];
    return v;
}

size_t value_count(const value *v) {
    if (!v) return 0;
    return v->kind == VALUE_LIST ? v->list.count : v->kind == VALUE_DICT ? v->dict.count : 0;
}

/* ---------------------------------------------------------------- numbers ---------------------------- */
/* Lists may hold the same list many times (pickles share), so traversals are bounded by visits, not depth. */
enum { NUMBERS_VISITS = 1 << 26, NUMBERS_DEPTH = 16 };

static int64_t numbers(const value *v, int depth, int64_t *visits) {
    if (++*visits > NUMBERS_VISITS || depth > NUMBERS_DEPTH) return -1;
    switch (v->kind) {
    case VALUE_INTEGER:
    case VALUE_REAL:
    case VALUE_BOOL:
        return 1;
    case VALUE_ARRAY:
        return build_count(v->array.rank, v->array.dim);
    case VALUE_LIST: {
        int64_t sum = 0;
        for (size_t i = 0; i < v->list.count; i++) {
            int64_t n = numbers(v->list.item[i], depth + 1, visits);
            if (n < 0 || __builtin_add_overflow(sum, n, &sum)) return -1;
        }
        return sum;
    }
    default:
        return -1;
    }
}

int64_t value_numbers(const value *v) {
    int64_t visits = 0;
    if (!v || (v->kind != VALUE_ARRAY && v->kind != VALUE_LIST)) return -1;
    return numbers(v, 0, &visits);
}

double value_array_number(const value *v, int64_t i) {
    switch (v->array.type) {
    case T_F32:
        return ((const float *)v->array.data)[i];
    case T_F64:
        return ((const double *)v->array.data)[i];
    case T_I32:
        return ((const int32_t *)v->array.data)[i];
    case T_I64:
        return (double)((const int64_t *)v->array.data)[i];
    case T_U8:
        return ((const uint8_t *)v->array.data)[i];
    case T_BF16:
        return bf16_to_float(((const uint16_t *)v->array.data)[i]);
    case T_F16:
        return half_to_float(((const uint16_t *)v->array.data)[i]);
    }
    return 0;
}

typedef struct {
    float *f; /* one of these */
    double *d;
    size_t next, count;
    bool finite;
} number_sink;

static void put(number_sink *s, double x) {
    if (s->next >= s->count) return;
    if (!isfinite(x)) s->finite = false;
    if (s->f) {
        s->f[s->next] = (float)x;
        if (!isfinite(s->f[s->next])) s->finite = false;
    } else
        s->d[s->next] = x;
    s->next++;
}

static void collect(const value *v, number_sink *s) { /* v passed numbers(), which bounds the traversal */
    switch (v->kind) {
    case VALUE_INTEGER:
        put(s, (double)v->integer);
        break;
    case VALUE_REAL:
        put(s, v->real);
        break;
    case VALUE_BOOL:
        put(s, v->boolean);
        break;
    case VALUE_ARRAY: {
        int64_t n = build_count(v->array.rank, v->array.dim);
        for (int64_t i = 0; i < n; i++) put(s, value_array_number(v, (size_t)i));
        break;
    }
    case VALUE_LIST:
        for (size_t i = 0; i < v->list.count; i++) collect(v->list.item[i], s);
        break;
    default:
        break;
    }
}

static sherf_status gather(context *c, const value *v, const char *what, number_sink s) {
    if (!v) return failure(c, SHERF_BAD_FILE, "%s is missing", what);
    int64_t visits = 0, n = numbers(v, 0, &visits);
    if (n < 0) return failure(c, SHERF_BAD_FILE, "%s is not made of numbers", what);
    if ((uint64_t)n != s.count)
        return failure(c, SHERF_BAD_FILE, "%s has %lld numbers, not %zu", what, (long long)n, s.count);
    s.finite = true;
    collect(v, &s);
    if (!s.finite) return failure(c, SHERF_BAD_FILE, "%s holds a number that is not finite", what);
    return SHERF_OK;
}

sherf_status value_floats(context *c, const value *v, const char *what, size_t count, float *out) {
    return gather(c, v, what, (number_sink){.f = out, .count = count});
}

sherf_status value_doubles(context *c, const value *v, const char *what, size_t count, double *out) {
    return gather(c, v, what, (number_sink){.d = out, .count = count});
}

sherf_status value_integer(context *c, const value *v, const char *what, int64_t *out) {
    if (v && v->kind == VALUE_INTEGER) {
        *out = v->integer;
        return SHERF_OK;
    }
    if (v && v->kind == VALUE_ARRAY && v->array.type == T_I64 &&
        build_count(v->array.rank, v->array.dim) == 1) {
        *out = *(const int64_t *)v->array.data;
        return SHERF_OK;
    }
    double x;
    sherf_status status = value_doubles(c, v, what, 1, &x);
    if (status != SHERF_OK) return status;
    if (x != floor(x) || fabs(x) > 9007199254740992.0)
        return failure(c, SHERF_BAD_FILE, "%s is %g, not a whole number", what, x);
    *out = (int64_t)x;
    return SHERF_OK;
}
