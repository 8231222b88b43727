/* A folder for the files of a fuzz target whose reader takes paths; removed at the end. */
#ifndef FUZZ_FOLDER_H
#define FUZZ_FOLDER_H

#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "fuzz.h"

static char fuzz_folder_path[64];

static inline void fuzz_folder_remove(void) {
    char command[128];
    snprintf(command, sizeof command, "rm -rf '%s'", fuzz_folder_path);
    if (system(command)) fprintf(stderr, "%s stays\n", fuzz_folder_path);
}

static inline const char *fuzz_folder(void) {
    if (*fuzz_folder_path) return fuzz_folder_path;
    /* in memory, where flushing a file takes no time */
    snprintf(fuzz_folder_path, sizeof fuzz_folder_path, "%s/fuzz_XXXXXX",
             access("/dev/shm", W_OK) ? "/tmp" : "/dev/shm");
    if (!mkdtemp(fuzz_folder_path)) abort();
    atexit(fuzz_folder_remove);
    return fuzz_folder_path;
}

/* Writes a file in the folder and returns its path (static). */
static inline const char *fuzz_file(const char *name, const void *data, size_t size) {
    static char path[128];
    snprintf(path, sizeof path, "%s/%s", fuzz_folder(), name);
    FILE *f = fopen(path, "wb");
    if (!f || fwrite(data, 1, size, f) != size || fclose(f)) abort();
    return path;
}
#endif
