/* Lines about people of a data set: those that differ in the person's name alone become one. */
#include "data/alike.h"

#include <ctype.h>
#include <string.h>

/* Whether `name` begins here as a whole: at the line's begin or as a part of a path. */
static bool name_is_at(const char *text, const char *at, const char *name, size_t length) {
    const bool begins = at == text || at[-1] == '/' || at[-1] == ' ';
    return begins && !strncmp(at, name, length) && !isalnum((unsigned char)at[length]) && at[length] != '_';
}

/* The text without the name; it is no longer than the text. */
static char *without_name(context *c, const char *text, const char *name) {
    const size_t length = strlen(name);
    char *rest = mem_alloc(c, strlen(text) + 1, 1), *to = rest;
    if (!rest) return NULL;
    for (const char *at = text; *at;) {
        if (length && name_is_at(text, at, name, length)) {
            *to++ = '\1';
            at += length;
        } else
            *to++ = *at++;
    }
    *to = 0;
    return rest;
}

static alike_line *find(const alike_lines *a, const char *rest) {
    for (int i = 0; i < a->count; i++)
        if (a->line[i].rest && !strcmp(a->line[i].rest, rest)) return &a->line[i];
    return NULL;
}

static bool reserve(alike_lines *a) {
    if (a->count < a->room) return true;
    const int room = 2 * a->room + 64;
    alike_line *more = mem_grow(a->c, a->line, (size_t)a->room, (size_t)room, sizeof *more);
    if (!more) return false;
    a->line = more, a->room = room;
    return true;
}

bool alike_add(alike_lines *a, char *text, const char *name, int person, bool merge) {
    char *rest = text && merge ? without_name(a->c, text, name) : NULL;
    alike_line *same = rest ? find(a, rest) : NULL;
    if (same) {
        same->more += same->person != person;
        same->person = person;
    }
    if (same || !text || (merge && !rest) || !reserve(a)) {
        a->failed |= !same;
        mem_free(text);
        mem_free(rest);
        return false;
    }
    a->line[a->count++] = (alike_line){text, rest, person, 0};
    return true;
}

void alike_write(alike_lines *a, text_builder *out) {
    for (int i = 0; i < a->count; i++) {
        const alike_line *l = &a->line[i];
        text_add(out, "%s", l->text);
        if (l->more) text_add(out, " (and so for %d more %s)", l->more, l->more == 1 ? "person" : "people");
        text_add(out, "\n");
        mem_free(l->text);
        mem_free(l->rest);
    }
    mem_free(a->line);
    out->failed |= a->failed;
    *a = (alike_lines){.c = a->c};
}
