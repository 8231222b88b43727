/* alike: lines about people of a data set, of which those that differ in the person's name alone become one.
 */
#ifndef SHERF_DATA_ALIKE_H
#define SHERF_DATA_ALIKE_H

#include "data/text.h"

typedef struct {
    char *text, *rest; /* the line, and without the person's name; mem_alloc'd */
    int person;        /* the last one it was said of */
    int more;          /* people it was said of, after the first */
} alike_line;
/* Zeros, but for the context. */
typedef struct {
    context *c;
    alike_line *line;
    int count, room;
    bool failed; /* out of memory: the rest is dropped */
} alike_lines;

/* Takes over `text` (mem_alloc'd; NULL: out of memory). merge: whether it may become one with an earlier
 * line. True: it is a line of its own. */
bool alike_add(alike_lines *a, char *text, const char *name, int person, bool merge);
/* Writes them in the order of their first people, each with how many more it concerns, and frees them. */
void alike_write(alike_lines *a, text_builder *out);
#endif
