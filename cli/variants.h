/* variants: a sheet of the ways in which what was not seen may look, to choose one from. */
#ifndef CLI_VARIANTS_H
#define CLI_VARIANTS_H

#include "session.h"

enum { VARIANTS_MAX = 15 };
/* Writes `path`: a column for the best guess and each of `count` variants, counted from 1, eight a line; in a
 * column the person from behind, and half from behind at both sides. The avatar's own variant stays. An exit
 * status. */
int variants_sheet(session *s, sherf_avatar *avatar, const sherf_body *body, int count, const char *path);
#endif
