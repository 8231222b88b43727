/* variants: a sheet of an avatar's guesses for unseen parts, to choose one from. */
#ifndef CLI_VARIANTS_H
#define CLI_VARIANTS_H

#include "session.h"

enum { VARIANTS_MAX = 15 };
/* Writes `path`: a column for the best guess and for each of `count` variants, counted from 1, eight per
 * line. A column shows the person from behind, and half from behind on both sides. The avatar's own variant
 * does not change. Returns an exit status. */
int variants_sheet(session *s, sherf_avatar *avatar, const sherf_body *body, int count, const char *path);
#endif
