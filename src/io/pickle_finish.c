/* pickle: turns the machine's result into plain values. */
#include "io/pickle.h"

enum { WHITE, GREY, BLACK };
typedef struct {
    object *o;
    size_t next;
} visit;

/* The i-th reference from o to another value, or NULL. */
static value **child(object *o, size_t i) {
    value *v = &o->v;
    switch (v->kind) {
    case VALUE_LIST:
        return i < v->list.count ? &v->list.item[i] : NULL;
    case VALUE_DICT:
        if (i / 2 >= v->dict.count) return NULL;
        return i % 2 ? &v->dict.pair[i / 2].item : &v->dict.pair[i / 2].key;
    case VALUE_RECORD:
        return i == 0 ? &v->record.arguments : i == 1 ? &v->record.state : NULL;
    default:
        return NULL;
    }
}

static bool settle(builder *b, object *o) {
    o->colour = GREY;
    o->height = 0;
    if (o->role == ROLE_BORROWED) {
        value *copy = build_string(b, o->v.string.text, o->v.string.length);
        if (!copy) return false;
        o->v.string.text = copy->string.text;
    } else if ((o->role == ROLE_TENSOR || o->role == ROLE_STORAGE) && !pickle_settle(b, o))
        return false;
    o->role = ROLE_PLAIN;
    return true;
}

/* Depth first, without recursion. A reference back to a value that is still open (a list inside itself) is
 * cut, and no tree is deeper than BUILD_NESTING, so that readers may recurse. */
static bool finish(builder *b, value *root, visit **stack, size_t *space) {
    size_t depth = 0;
    if (!settle(b, object_of(root))) return false;
    (*stack)[depth++] = (visit){object_of(root), 0};
    while (depth) {
        visit *at = &(*stack)[depth - 1];
        object *o = at->o;
        value **place = child(o, at->next++);
        if (!place) {
            o->colour = BLACK;
            if (o->height > BUILD_NESTING) {
                build_fail(b, SHERF_BAD_FILE, "nested deeper than %d", BUILD_NESTING);
                return false;
            }
            depth--;
            if (depth && (*stack)[depth - 1].o->height < o->height + 1)
                (*stack)[depth - 1].o->height = o->height + 1;
            continue;
        }
        if (!*place) continue;
        object *next = object_of(*place);
        if (next->colour == GREY) {
            *place = pickle_record(b, "(a value that holds this one)", NULL);
            if (!*place) return false;
            object_of(*place)->colour = BLACK;
        } else if (next->colour == BLACK) {
            if (o->height < next->height + 1) o->height = next->height + 1;
        } else {
            if (!settle(b, next)) return false;
            if (depth == *space) {
                visit *grown = mem_grow(b->c, *stack, *space, *space * 2, sizeof **stack);
                if (!grown) {
                    b->status = SHERF_NO_MEMORY;
                    return false;
                }
                *stack = grown;
                *space *= 2;
            }
            (*stack)[depth++] = (visit){next, 0};
        }
    }
    return true;
}

value *pickle_finish(builder *b, value *root) {
    if (!root || b->status != SHERF_OK) return NULL;
    size_t space = 64;
    visit *stack = mem_alloc(b->c, space, sizeof *stack);
    if (!stack) {
        b->status = SHERF_NO_MEMORY;
        return NULL;
    }
    bool ok = finish(b, root, &stack, &space);
    mem_free(stack);
    return ok ? root : NULL;
}
