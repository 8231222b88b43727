/* Files: read completely; written completely or not at all (temporary name, then rename). */
#ifndef SHERF_PATH_H
#define SHERF_PATH_H

#include <stdio.h>

#include "base/base.h"

enum { PATH_LENGTH = 4096 };

/* The file's bytes with a 0 after them; mem_free them. Fails if it exceeds the limit. */
sherf_status file_read(context *c, const char *path, size_t limit_bytes, unsigned char **data, size_t *bytes);

typedef struct {
    FILE *file; /* NULL once committed or aborted */
    char final[PATH_LENGTH], temporary[PATH_LENGTH];
} output_file;
sherf_status output_open(context *c, const char *path, output_file *out);
sherf_status output_try(context *c, const char *path); /* whether it could be opened; leaves nothing */
sherf_status output_write(context *c, output_file *out, const void *data, size_t bytes);
/* At most 4095 bytes at a time. */
sherf_status output_print(context *c, output_file *out, const char *format, ...) PRINTF_LIKE(3, 4);
sherf_status output_commit(context *c,
                           output_file *out); /* flush, close, rename; on failure nothing is left */
void output_abort(output_file *out);          /* close and remove; fine after a commit or on zeroes */
/* A whole file at once. */
sherf_status file_write(context *c, const char *path, const void *data, size_t bytes);

sherf_status folder_make(context *c, const char *path); /* with parents; fine if it exists */
void folder_remove(
    const char *path); /* with its contents, without following links; fine if it does not exist */
bool path_is_folder(const char *path);
bool path_is_file(const char *path);
bool path_has(const char *folder, const char *name);  /* a file or a folder */
bool path_ends(const char *path, const char *suffix); /* ignoring case */
#endif
