/* pickle: the machine. It knows every opcode of protocols 0 to 5 and nothing that runs code: a call of a
 * known constructor becomes an array or container; any other call or object becomes a record of its class's
 * name, arguments and state. No opcode recurses.
 * https://github.com/python/cpython/blob/main/Lib/pickletools.py documents the opcodes. */
#include <errno.h>
#include <locale.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "io/pickle.h"

typedef struct {
    builder *b;
    const unsigned char *data;
    size_t bytes, pos;
    value **stack; /* NULL entries are marks */
    size_t depth, stack_room;
    value **memo;
    size_t memo_count, memo_room; /* highest used + 1 */
    const pickle_source *source;
    value *result;
} pickle_machine;

static void *fail_at(pickle_machine *machine, const char *what) {
    return build_fail(machine->b, SHERF_BAD_FILE, "pickle: %s at byte %zu", what, machine->pos);
}

/* ---------------------------------------------------------------- stack and memo --------------------- */
static bool ensure(pickle_machine *machine, value ***table, size_t *have, size_t want) {
    if (want <= *have) return true;
    size_t more = *have ? *have : 64;
    while (more < want) more *= 2;
    if (more > (machine->b->limit - machine->b->used) / sizeof(value *)) {
        fail_at(machine, "too many values");
        return false;
    }
    value **grown = mem_grow(machine->b->c, *table, *have, more, sizeof **table);
    if (!grown) {
        if (machine->b->status == SHERF_OK) machine->b->status = SHERF_NO_MEMORY;
        return false;
    }
    memset(grown + *have, 0, (more - *have) * sizeof *grown);
    *table = grown;
    *have = more;
    return true;
}

static bool push_any(pickle_machine *machine, value *v) {
    if (!ensure(machine, &machine->stack, &machine->stack_room, machine->depth + 1)) return false;
    machine->stack[machine->depth++] = v;
    return true;
}

static bool push(pickle_machine *machine, value *v) {
    return v && push_any(machine, v);
}

static value *top(pickle_machine *machine) {
    if (!machine->depth || !machine->stack[machine->depth - 1])
        return fail_at(machine, "nothing on the stack");
    return machine->stack[machine->depth - 1];
}

static value *pop(pickle_machine *machine) {
    value *v = top(machine);
    if (v) machine->depth--;
    return v;
}

/* The first entry above the newest mark, or SIZE_MAX. */
static size_t above_mark(pickle_machine *machine) {
    size_t i = machine->depth;
    while (i && machine->stack[i - 1]) i--;
    if (i) return i;
    fail_at(machine, "no mark on the stack");
    return SIZE_MAX;
}

static value *pop_marked_list(pickle_machine *machine) {
    size_t first = above_mark(machine);
    if (first == SIZE_MAX) return NULL;
    value *list = build_value(machine->b, VALUE_LIST);
    if (!list) return NULL;
    size_t n = machine->depth - first;
    if (n) {
        list->list.item = build_memory(machine->b, n, sizeof(value *));
        if (!list->list.item) return NULL;
        memcpy(list->list.item, machine->stack + first, n * sizeof(value *));
        list->list.count = n;
        object_of(list)->capacity = n;
    }
    machine->depth = first - 1;
    return list;
}

static bool remember(pickle_machine *machine, uint64_t index) {
    value *v = top(machine);
    if (!v) return false;
    /* writers count what they keep, and everything kept takes at least a byte */
    if (index > machine->bytes || !ensure(machine, &machine->memo, &machine->memo_room, (size_t)index + 1))
        return fail_at(machine, "impossible memo index") != NULL;
    machine->memo[index] = v;
    if (index >= machine->memo_count) machine->memo_count = (size_t)index + 1;
    return true;
}

static bool recall(pickle_machine *machine, uint64_t index) {
    if (index >= machine->memo_room || !machine->memo[index])
        return fail_at(machine, "unknown memo index") != NULL;
    return push(machine, machine->memo[index]);
}

/* ---------------------------------------------------------------- reading --------------------------- */
static const unsigned char *take(pickle_machine *machine, uint64_t n) {
    if (n > machine->bytes - machine->pos) return fail_at(machine, "truncated");
    const unsigned char *p = machine->data + machine->pos;
    machine->pos += (size_t)n;
    return p;
}

/* Little-endian unsigned number of n <= 8 bytes. */
static bool number(pickle_machine *machine, int n, uint64_t *out) {
    const unsigned char *p = take(machine, (uint64_t)n);
    if (!p) return false;
    *out = 0;
    for (int i = 0; i < n; i++) *out |= (uint64_t)p[i] << 8 * i;
    return true;
}

/* A line without its end. */
static const char *line(pickle_machine *machine, size_t *length) {
    const unsigned char *p = machine->data + machine->pos,
                        *end = memchr(p, '\n', machine->bytes - machine->pos);
    if (!end) return fail_at(machine, "truncated line");
    *length = (size_t)(end - p);
    machine->pos += *length + 1;
    return (const char *)p;
}

static value *borrowed(pickle_machine *machine, int length_bytes) {
    uint64_t n;
    if (!number(machine, length_bytes, &n)) return NULL;
    const unsigned char *p = take(machine, n);
    value *v = p ? build_value(machine->b, VALUE_STRING) : NULL;
    if (!v) return NULL;
    v->string.text = (const char *)p; /* copied when the tree is finished */
    v->string.length = (size_t)n;
    object_of(v)->role = ROLE_BORROWED;
    return v;
}

/* Two's complement, little-endian. What does not fit in 64 bits becomes a real. */
static value *long_bytes(pickle_machine *machine, uint64_t n) {
    const unsigned char *p = take(machine, n);
    if (!p) return NULL;
    bool negative = n && (p[n - 1] & 0x80);
    while (n > 1 && p[n - 1] == (negative ? 0xff : 0) && (p[n - 2] >> 7) == negative) n--;
    if (n <= 8) {
        uint64_t x = negative ? UINT64_MAX : 0;
        for (uint64_t i = n; i-- > 0;) x = x << 8 | p[i];
        return build_integer(machine->b, (int64_t)x);
    }
    double x = negative ? -1 : 0; /* the bytes' sum, with sign bits repeated forever */
    for (uint64_t i = n; i-- > 0 && isfinite(x);) x = x * 256 + p[i];
    return build_real(machine->b, x);
}

static value *text_number(pickle_machine *machine, bool real) {
    size_t n = 0;
    const char *p = line(machine, &n);
    char text[64], *end;
    if (!p) return NULL;
    if (n == 2 && !real && p[0] == '0' && (p[1] == '0' || p[1] == '1'))
        return build_bool(machine->b, p[1] == '1');
    if (n && p[n - 1] == 'L') n--;
    if (!n || n >= sizeof text) return fail_at(machine, "a number that is not one");
    memcpy(text, p, n);
    text[n] = 0;
    errno = 0;
    if (!real) {
        long long i = strtoll(text, &end, 10);
        if (*end) return fail_at(machine, "a number that is not one");
        if (!errno) return build_integer(machine->b, i);
    }
    char *point = strchr(text, '.');
    if (point) *point = *localeconv()->decimal_point;
    double r = strtod(text, &end);
    if (*end) return fail_at(machine, "a number that is not one");
    return build_real(machine->b, r);
}

/* STRING and UNICODE; their lines contain escapes. */
static value *escaped(pickle_machine *machine,
                      value *(*decode)(builder *, const char *, size_t, const char **)) {
    size_t n = 0;
    const char *p = line(machine, &n), *wrong = NULL;
    value *v = p ? decode(machine->b, p, n, &wrong) : NULL;
    return wrong ? fail_at(machine, wrong) : v;
}

/* ---------------------------------------------------------------- classes ---------------------------- */

static value *class_value(pickle_machine *machine, const char *module, size_t n, const char *name, size_t k) {
    if (!n || !k || n > 512 || k > 512) return fail_at(machine, "a class without a proper name");
    char *text = build_memory(machine->b, n + k + 2, 1);
    if (!text) return NULL;
    memcpy(text, module, n);
    text[n] = '.';
    memcpy(text + n + 1, name, k);
    text[n + k + 1] = 0;
    for (size_t i = 0; i < n + k + 1; i++)
        if ((unsigned char)text[i] <= ' ' || (unsigned char)text[i] >= 0x7f) text[i] = '?';
    value *v = pickle_record(machine->b, text, NULL);
    if (v) object_of(v)->role = ROLE_CLASS;
    return v;
}

static value *global_lines(pickle_machine *machine) {
    size_t n = 0, k = 0;
    const char *module = line(machine, &n), *name = module ? line(machine, &k) : NULL;
    return name ? class_value(machine, module, n, name, k) : NULL;
}

static value *stack_global(pickle_machine *machine) {
    value *name = pop(machine), *module = name ? pop(machine) : NULL;
    if (!module) return NULL;
    if (name->kind != VALUE_STRING || module->kind != VALUE_STRING)
        return fail_at(machine, "a class without a name");
    return class_value(machine, module->string.text, module->string.length, name->string.text,
                       name->string.length);
}

/* ---------------------------------------------------------------- plain Python ----------------------- */
static bool is_builtin(const char *name, const char *what) {
    return pickle_name_is(name, "builtins", what) || pickle_name_is(name, "__builtin__", what);
}

/* list(x), tuple(x), set(x): a new list of x's items. */
static value *list_of(pickle_machine *machine, value *arguments) {
    value *v = build_value(machine->b, VALUE_LIST);
    if (!v || !arguments->list.count) return v;
    value *items = arguments->list.item[0];
    if (items->kind != VALUE_LIST) return fail_at(machine, "a container made of something else");
    for (size_t i = 0; i < items->list.count; i++)
        if (!build_append(machine->b, v, items->list.item[i])) return NULL;
    return v;
}

/* dict(x), OrderedDict(x): of another dict or of pairs. */
static value *dict_of(pickle_machine *machine, value *arguments) {
    value *v = build_value(machine->b, VALUE_DICT);
    if (!v || !arguments->list.count) return v;
    value *items = arguments->list.item[0];
    if (items->kind == VALUE_DICT) {
        for (size_t i = 0; i < items->dict.count; i++)
            if (!build_pair(machine->b, v, items->dict.pair[i].key, items->dict.pair[i].item)) return NULL;
        return v;
    }
    if (items->kind != VALUE_LIST) return fail_at(machine, "a dict made of something else");
    for (size_t i = 0; i < items->list.count; i++) {
        value *pair = items->list.item[i];
        if (pair->kind != VALUE_LIST || pair->list.count != 2)
            return fail_at(machine, "a dict made of something else");
        if (!build_pair(machine->b, v, pair->list.item[0], pair->list.item[1])) return NULL;
    }
    return v;
}

/* _codecs.encode(text, 'latin1'): Python 3 writes bytes so in protocols below 3. */
static value *encoded(pickle_machine *machine, value *arguments) {
    value *text = arguments->list.count ? arguments->list.item[0] : NULL;
    if (!text || text->kind != VALUE_STRING) return fail_at(machine, "encode of something else than text");
    value *how = arguments->list.count > 1 ? arguments->list.item[1] : NULL;
    bool latin = how && how->kind == VALUE_STRING && how->string.length >= 5 &&
                 !strncasecmp(how->string.text, "latin", 5);
    if (!latin) return text;
    const unsigned char *p = (const unsigned char *)text->string.text;
    size_t n = text->string.length, used = 0;
    char *out = build_memory(machine->b, n + 1, 1);
    if (!out) return NULL;
    for (size_t i = 0; i < n; i++) {
        if (p[i] >= 0x80 && ((p[i] != 0xc2 && p[i] != 0xc3) || i + 1 >= n || (p[i + 1] & 0xc0) != 0x80))
            return fail_at(machine, "bytes that are not Latin-1");
        if (p[i] >= 0x80) {
            out[used++] = (char)((p[i] & 3) << 6 | (p[i + 1] & 63));
            i++;
        } else
            out[used++] = (char)p[i];
    }
    return build_string(machine->b, out, used);
}

static value *call_plain(pickle_machine *machine, const char *name, value *arguments, bool *known) {
    builder *b = machine->b;
    *known = true;
    if (is_builtin(name, "list") || is_builtin(name, "tuple") || is_builtin(name, "set") ||
        is_builtin(name, "frozenset") || pickle_name_is(name, "sets", "Set") || !strcmp(name, "torch.Size"))
        return list_of(machine, arguments);
    if (is_builtin(name, "dict") || !strcmp(name, "collections.OrderedDict"))
        return dict_of(machine, arguments);
    if (!strcmp(name, "collections.defaultdict")) return build_value(b, VALUE_DICT);
    if (!strcmp(name, "_codecs.encode")) return encoded(machine, arguments);
    if (is_builtin(name, "bytes") || is_builtin(name, "bytearray") || is_builtin(name, "str")) {
        if (arguments->list.count && arguments->list.item[0]->kind == VALUE_STRING)
            return arguments->list.item[0];
        if (!arguments->list.count) return build_string(b, "", 0);
    }
    *known = false;
    return NULL;
}

/* StyleGAN's persistent objects carry {class_name, state, source text ...} in one dict. */
static value *persistent_object(pickle_machine *machine, const char *name, value *arguments) {
    const value *meta = arguments->list.count ? arguments->list.item[0] : NULL;
    const value *class_name = value_get(meta, "class_name");
    value *state = pickle_entry(meta, "state");
    value *v = pickle_record(machine->b, name, NULL);
    if (v && class_name && class_name->kind == VALUE_STRING && state) {
        value *text = build_string(machine->b, class_name->string.text, class_name->string.length);
        if (!text) return NULL;
        v->record.class_name = text->string.text;
        v->record.state = state;
    } else if (v)
        v->record.arguments = arguments;
    return v;
}

static value *call(pickle_machine *machine, value *function, value *arguments) {
    builder *b = machine->b;
    const char *name = pickle_class(function);
    if (arguments->kind != VALUE_LIST) return fail_at(machine, "arguments that are no tuple");
    if (!name) return pickle_record(b, "(call of an object)", arguments);
    bool known = false;
    value *v = call_plain(machine, name, arguments, &known);
    if (!known) v = pickle_call_numpy(b, name, function, arguments, &known);
    if (!known) v = pickle_call_torch(b, name, arguments, machine->source, &known);
    if (known) return v;
    if (pickle_name_is(name, "torch_utils.persistence", "_reconstruct_persistent_obj"))
        return persistent_object(machine, name, arguments);
    /* objects: copyreg._reconstructor(class, base, state) and copyreg.__newobj__(class, ...) */
    const char *of = arguments->list.count ? pickle_class(arguments->list.item[0]) : NULL;
    if (of && (pickle_name_is(name, "copy_reg", "_reconstructor") ||
               pickle_name_is(name, "copyreg", "_reconstructor"))) {
        value *inner = call_plain(machine, of, build_value(b, VALUE_LIST), &known);
        if (b->status != SHERF_OK) return NULL;
        if (known) return inner;
        value *items = pickle_item(arguments, 2);
        v = pickle_record(b, of, NULL);
        if (v && items && (items->kind == VALUE_LIST || items->kind == VALUE_DICT)) v->record.state = items;
        return v; /* items: of a class derived from list or dict */
    }
    if (of &&
        (pickle_name_is(name, "copy_reg", "__newobj__") || pickle_name_is(name, "copyreg", "__newobj__"))) {
        value *rest = build_value(b, VALUE_LIST);
        for (size_t i = 1; i < arguments->list.count; i++)
            if (!build_append(b, rest, arguments->list.item[i])) return NULL;
        return pickle_record(b, of, rest);
    }
    return pickle_record(b, name, arguments);
}

static value *new_object(pickle_machine *machine, value *class, value *arguments) {
    const char *name = pickle_class(class);
    if (arguments->kind != VALUE_LIST) return fail_at(machine, "arguments that are no tuple");
    if (!name) return fail_at(machine, "an object without a class");
    bool known = false;
    value *v = call_plain(machine, name, arguments, &known);
    return known ? v : pickle_record(machine->b, name, arguments);
}

/* ---------------------------------------------------------------- filling ---------------------------- */
/* Items and pairs may also go to a record, for classes derived from list and dict. */
static bool append(pickle_machine *machine, value *target, value *item) {
    if (target->kind == VALUE_RECORD && object_of(target)->role == ROLE_PLAIN) {
        if (!target->record.state) target->record.state = build_value(machine->b, VALUE_LIST);
        target = target->record.state;
    }
    if (!target) return false;
    if (target->kind != VALUE_LIST) return fail_at(machine, "an item for something that is no list") != NULL;
    return build_append(machine->b, target, item);
}

static bool set_pair(pickle_machine *machine, value *target, value *key, value *item) {
    if (target->kind == VALUE_RECORD && object_of(target)->role == ROLE_PLAIN) {
        if (!target->record.state) target->record.state = build_value(machine->b, VALUE_DICT);
        target = target->record.state;
    }
    if (!target) return false;
    if (target->kind != VALUE_DICT) return fail_at(machine, "a pair for something that is no dict") != NULL;
    return build_pair(machine->b, target, key, item);
}

static bool append_marked(pickle_machine *machine) {
    size_t first = above_mark(machine);
    if (first == SIZE_MAX) return false;
    size_t end = machine->depth;
    machine->depth = first - 1; /* the mark is gone */
    value *target = top(machine);
    for (size_t i = first; i < end && target; i++)
        if (!append(machine, target, machine->stack[i])) return false;
    return target != NULL;
}

static bool pairs_marked(pickle_machine *machine) {
    size_t first = above_mark(machine);
    if (first == SIZE_MAX) return false;
    size_t end = machine->depth;
    if ((end - first) % 2) return fail_at(machine, "a key without a value") != NULL;
    machine->depth = first - 1;
    value *target = top(machine);
    for (size_t i = first; i < end && target; i += 2)
        if (!set_pair(machine, target, machine->stack[i], machine->stack[i + 1])) return false;
    return target != NULL;
}

static value *dict_marked(pickle_machine *machine) {
    value *flat = pop_marked_list(machine), *dict = flat ? build_value(machine->b, VALUE_DICT) : NULL;
    if (!dict) return NULL;
    if (flat->list.count % 2) return fail_at(machine, "a key without a value");
    for (size_t i = 0; i < flat->list.count; i += 2)
        if (!build_pair(machine->b, dict, flat->list.item[i], flat->list.item[i + 1])) return NULL;
    return dict;
}

static bool set_joblib(pickle_machine *machine, value *target, const value *state) {
    size_t used = 0;
    const value *array =
        pickle_joblib(machine->b, state, machine->data + machine->pos, machine->bytes - machine->pos, &used);
    if (!array) return false;
    machine->pos += used;
    *target = *array;
    return true;
}

static bool set_state(pickle_machine *machine) {
    value *state = pop(machine), *target = state ? top(machine) : NULL;
    if (!target) return false;
    if (target->kind == VALUE_RECORD && object_of(target)->role == ROLE_PLAIN &&
        !strcmp(target->record.class_name, pickle_joblib_class))
        return set_joblib(machine, target, state);
    bool known = false, ok = pickle_state_numpy(machine->b, target, state, &known);
    if (known) return ok;
    if (target->kind != VALUE_RECORD) return true; /* attributes of an OrderedDict and the like: dropped */
    if (object_of(target)->role != ROLE_PLAIN) return fail_at(machine, "a state for a class") != NULL;
    value *have = target->record.state;
    if (have && have->kind == VALUE_DICT && state->kind == VALUE_DICT && have != state) {
        for (size_t i = 0; i < state->dict.count; i++)
            if (!build_pair(machine->b, have, state->dict.pair[i].key, state->dict.pair[i].item))
                return false;
        return true;
    }
    target->record.state = state;
    return true;
}

/* ---------------------------------------------------------------- opcodes ---------------------------- */
static bool push_number(pickle_machine *machine, int bytes, bool is_signed) {
    uint64_t n;
    if (!number(machine, bytes, &n)) return false;
    return push(machine, build_integer(machine->b, is_signed ? (int32_t)(uint32_t)n : (int64_t)n));
}

static bool push_float(pickle_machine *machine) {
    const unsigned char *p = take(machine, 8);
    if (!p) return false;
    uint64_t bits = 0;
    double r;
    for (int i = 0; i < 8; i++) bits = bits << 8 | p[i];
    memcpy(&r, &bits, sizeof r);
    return push(machine, build_real(machine->b, r));
}

static bool push_long(pickle_machine *machine, int length_bytes) {
    uint64_t n;
    return number(machine, length_bytes, &n) && push(machine, long_bytes(machine, n));
}

/* Makes a tuple of the newest n values. */
static bool push_tuple(pickle_machine *machine, size_t n) {
    if (machine->depth < n) return fail_at(machine, "nothing on the stack") != NULL;
    value *list = build_value(machine->b, VALUE_LIST);
    for (size_t i = machine->depth - n; i < machine->depth && list; i++) {
        if (!machine->stack[i]) return fail_at(machine, "a mark in a tuple") != NULL;
        if (!build_append(machine->b, list, machine->stack[i])) return false;
    }
    if (!list) return false;
    machine->depth -= n;
    return push(machine, list);
}

static bool text_index(pickle_machine *machine, uint64_t *index) {
    size_t n = 0;
    const char *p = line(machine, &n);
    if (!p) return false;
    *index = 0;
    if (!n || n > 12) return fail_at(machine, "impossible memo index") != NULL;
    for (size_t i = 0; i < n; i++) {
        if (p[i] < '0' || p[i] > '9') return fail_at(machine, "impossible memo index") != NULL;
        *index = *index * 10 + (uint64_t)(p[i] - '0');
    }
    return true;
}

static bool put_or_get(pickle_machine *machine, int bytes, bool get) {
    uint64_t index;
    if (bytes ? !number(machine, bytes, &index) : !text_index(machine, &index)) return false;
    return get ? recall(machine, index) : remember(machine, index);
}

static bool do_call(pickle_machine *machine, value *(*how)(pickle_machine *, value *, value *)) {
    value *arguments = pop(machine), *function = arguments ? pop(machine) : NULL;
    return function && push(machine, how(machine, function, arguments));
}

/* NEWOBJ_EX has keyword arguments; they are stored after the others. */
static bool do_newobj_ex(pickle_machine *machine) {
    value *keywords = pop(machine), *arguments = keywords ? pop(machine) : NULL,
          *class = arguments ? pop(machine) : NULL;
    if (!class) return false;
    if (value_count(keywords)) {
        value *both = build_value(machine->b, VALUE_LIST);
        if (!build_append(machine->b, both, arguments) || !build_append(machine->b, both, keywords))
            return false;
        arguments = both;
    }
    return push(machine, new_object(machine, class, arguments));
}

/* OBJ: mark, class, arguments; INST: the class in two lines, mark, arguments. */
static bool do_old_object(pickle_machine *machine, bool inst) {
    value *class = inst ? global_lines(machine) : NULL, *arguments;
    if (inst && !class) return false;
    arguments = pop_marked_list(machine);
    if (!arguments) return false;
    if (!inst) {
        if (!arguments->list.count) return fail_at(machine, "an object without a class") != NULL;
        class = arguments->list.item[0];
        arguments->list.item++;
        arguments->list.count--;
        object_of(arguments)->capacity--;
    }
    return push(machine, new_object(machine, class, arguments));
}

static bool do_persistent(pickle_machine *machine, bool binary) {
    value *id;
    if (binary)
        id = pop(machine);
    else {
        size_t n = 0;
        const char *p = line(machine, &n);
        id = p ? build_string(machine->b, p, n) : NULL;
    }
    return id && push(machine, pickle_persistent(machine->b, id, machine->source));
}

/* The memo, and opcodes that are refused. */
static bool step_memo(pickle_machine *machine, unsigned char op) {
    switch (op) {
    case 'p':
        return put_or_get(machine, 0, false);
    case 'q':
        return put_or_get(machine, 1, false);
    case 'r':
        return put_or_get(machine, 4, false);
    case 0x94:
        return remember(machine, machine->memo_count);
    case 'g':
        return put_or_get(machine, 0, true);
    case 'h':
        return put_or_get(machine, 1, true);
    case 'j':
        return put_or_get(machine, 4, true);
    case 0x82:
    case 0x83:
    case 0x84:
        return fail_at(machine, "an extension code, which nothing explains,") != NULL;
    case 0x97:
    case 0x98:
        return fail_at(machine, "a buffer outside the file") != NULL;
    default:
        machine->pos--;
        build_fail(machine->b, SHERF_BAD_FILE,
                   "not a pickle, or damaged: byte 0x%02x at %zu is no instruction", op, machine->pos);
        return false;
    }
}

/* Classes and objects. */
static bool step_object(pickle_machine *machine, unsigned char op) {
    switch (op) {
    case 'c':
        return push(machine, global_lines(machine));
    case 0x93:
        return push(machine, stack_global(machine));
    case 'R':
        return do_call(machine, call);
    case 0x81:
        return do_call(machine, new_object);
    case 0x92:
        return do_newobj_ex(machine);
    case 'o':
    case 'i':
        return do_old_object(machine, op == 'i');
    case 'b':
        return set_state(machine);
    case 'P':
    case 'Q':
        return do_persistent(machine, op == 'Q');
    default:
        return step_memo(machine, op);
    }
}

/* Lists, tuples, dicts and sets. */
static bool step_container(pickle_machine *machine, unsigned char op) {
    switch (op) {
    case ']':
    case ')':
    case 0x8f:
        return push(machine, build_value(machine->b, VALUE_LIST));
    case '}':
        return push(machine, build_value(machine->b, VALUE_DICT));
    case 'l':
    case 't':
    case 0x91:
        return push(machine, pop_marked_list(machine));
    case 'd':
        return push(machine, dict_marked(machine));
    case 0x85:
    case 0x86:
    case 0x87:
        return push_tuple(machine, (size_t)(op - 0x84));
    case 'a': {
        value *item = pop(machine), *target = item ? top(machine) : NULL;
        return target && append(machine, target, item);
    }
    case 'e':
    case 0x90:
        return append_marked(machine);
    case 's': {
        value *item = pop(machine), *key = item ? pop(machine) : NULL, *target = key ? top(machine) : NULL;
        return target && set_pair(machine, target, key, item);
    }
    case 'u':
        return pairs_marked(machine);
    default:
        return step_object(machine, op);
    }
}

/* Texts and bytes. */
static bool step_text(pickle_machine *machine, unsigned char op) {
    switch (op) {
    case 'S':
        return push(machine, escaped(machine, pickle_quoted));
    case 'V':
        return push(machine, escaped(machine, pickle_unicode));
    case 'T': /* BINSTRING, BINUNICODE, BINBYTES */
    case 'X':
    case 'B':
        return push(machine, borrowed(machine, 4));
    case 'U': /* their short forms */
    case 'C':
    case 0x8c:
        return push(machine, borrowed(machine, 1));
    case 0x8d: /* BINUNICODE8, BINBYTES8, BYTEARRAY8 */
    case 0x8e:
    case 0x96:
        return push(machine, borrowed(machine, 8));
    default:
        return step_container(machine, op);
    }
}

/* None, truth and numbers. */
static bool step_number(pickle_machine *machine, unsigned char op) {
    switch (op) {
    case 'N':
        return push(machine, build_none(machine->b));
    case 0x88:
    case 0x89:
        return push(machine, build_bool(machine->b, op == 0x88));
    case 'I':
    case 'L':
    case 'F':
        return push(machine, text_number(machine, op == 'F'));
    case 'J':
        return push_number(machine, 4, true);
    case 'K':
        return push_number(machine, 1, false);
    case 'M':
        return push_number(machine, 2, false);
    case 'G':
        return push_float(machine);
    case 0x8a:
        return push_long(machine, 1);
    case 0x8b:
        return push_long(machine, 4);
    default:
        return step_text(machine, op);
    }
}

/* Framing and the stack. */
static bool step(pickle_machine *machine, unsigned char op) {
    uint64_t n;
    switch (op) {
    case 0x80: /* PROTO */
        if (!number(machine, 1, &n)) return false;
        if (n > 5) return fail_at(machine, "a newer protocol than 5") != NULL;
        return true;
    case 0x95: /* FRAME */
        return number(machine, 8, &n);
    case '(':
        return push_any(machine, NULL);
    case '0': /* POP; of a mark as well */
        if (!machine->depth) return fail_at(machine, "nothing on the stack") != NULL;
        machine->depth--;
        return true;
    case '1': /* POP_MARK */ {
        size_t first = above_mark(machine);
        if (first == SIZE_MAX) return false;
        machine->depth = first - 1;
        return true;
    }
    case '2':
        return push(machine, top(machine));
    default:
        return step_number(machine, op);
    }
}

value *pickle_build(builder *b, const unsigned char *data, size_t bytes, const pickle_source *source,
                    size_t *used) {
    pickle_machine machine = {.b = b, .data = data, .bytes = bytes, .source = source};
    value *result = NULL;
    for (size_t count = 0;; count++) {
        if ((count & 0xffff) == 0xffff && cancelled(b->c)) {
            build_fail(b, SHERF_CANCELLED, "cancelled");
            break;
        }
        if (machine.pos >= bytes) {
            fail_at(&machine, "truncated");
            break;
        }
        unsigned char op = data[machine.pos++];
        if (op == '.') {
            result = pop(&machine);
            break;
        }
        if (!step(&machine, op)) {
            if (b->status == SHERF_OK) fail_at(&machine, "an instruction that cannot be followed");
            break;
        }
    }
    if (used) *used = machine.pos;
    mem_free(machine.stack);
    mem_free(machine.memo);
    return b->status == SHERF_OK ? result : NULL;
}
