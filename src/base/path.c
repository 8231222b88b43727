/* Reads whole files, up to a limit; writes output as NAME.PID.part until it is committed; folders. */
#include <errno.h>
#include <ftw.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/path.h"

sherf_status file_read(context *c, const char *path, size_t limit_bytes, unsigned char **data,
                       size_t *bytes) {
    *data = NULL;
    *bytes = 0;
    sherf_status status = SHERF_OK;
    unsigned char *buffer = NULL;
    FILE *f = fopen(path, "rb");
    if (!f) return failure(c, SHERF_NO_FILE, "%s: cannot be opened: %s", path, strerror(errno));
    struct stat info;
    if (fstat(fileno(f), &info) || !S_ISREG(info.st_mode)) {
        status = failure(c, SHERF_BAD_FILE, "%s: not a file", path);
        goto done;
    }
    if ((uint64_t)info.st_size > limit_bytes) {
        status = failure(c, SHERF_BAD_FILE, "%s: %lld bytes, more than the %zu allowed", path,
                         (long long)info.st_size, limit_bytes);
        goto done;
    }
    size_t n = (size_t)info.st_size;
    buffer = mem_alloc(c, n + 1, 1);
    if (!buffer) {
        status = SHERF_NO_MEMORY;
        goto done;
    }
    if (fread(buffer, 1, n, f) != n) {
        status = failure(c, SHERF_BAD_FILE, "%s: cannot be read: %s", path,
                         ferror(f) ? strerror(errno) : "it shrank");
        goto done;
    }
    buffer[n] = 0;
    *data = buffer;
    *bytes = n;
    buffer = NULL;
done:
    mem_free(buffer);
    fclose(f);
    return status;
}

sherf_status output_open(context *c, const char *path, output_file *out) {
    *out = (output_file){0};
    if (snprintf(out->final, sizeof out->final, "%s", path) >= (int)sizeof out->final ||
        snprintf(out->temporary, sizeof out->temporary, "%s.%ld.part", path, (long)getpid()) >=
            (int)sizeof out->temporary)
        return failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", path);
    struct stat info; /* the rename would replace a device by a file: root would lose /dev/null */
    if (stat(path, &info) == 0 && !S_ISREG(info.st_mode))
        return failure(c, SHERF_WRITE_FAILED, "%s: cannot be written: it is a %s", path,
                       S_ISDIR(info.st_mode) ? "folder" : "device or pipe, and files are put in place whole");
    out->file = fopen(out->temporary, "wb");
    if (!out->file) return failure(c, SHERF_WRITE_FAILED, "%s: cannot be written: %s", path, strerror(errno));
    return SHERF_OK;
}

sherf_status output_try(context *c, const char *path) {
    output_file file;
    sherf_status status = output_open(c, path, &file);
    output_abort(&file);
    return status;
}

sherf_status output_write(context *c, output_file *out, const void *data, size_t bytes) {
    if (!bytes || fwrite(data, 1, bytes, out->file) == bytes) return SHERF_OK;
    return failure(c, SHERF_WRITE_FAILED, "%s: cannot be written: %s", out->final, strerror(errno));
}

sherf_status output_print(context *c, output_file *out, const char *format, ...) {
    char text[4096];
    va_list args;
    va_start(args, format);
    int n = vsnprintf(text, sizeof text, format, args);
    va_end(args);
    if (n < 0 || (size_t)n >= sizeof text)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: a line is too long", out->final);
    return output_write(c, out, text, (size_t)n);
}

sherf_status output_commit(context *c, output_file *out) {
    if (!out->file) return SHERF_OK;
    bool ok = fflush(out->file) == 0 && fsync(fileno(out->file)) == 0;
    int why = errno;
    if (fclose(out->file) != 0 && ok) {
        ok = false;
        why = errno;
    }
    out->file = NULL;
    if (ok && rename(out->temporary, out->final) != 0) {
        ok = false;
        why = errno;
    }
    if (ok) return SHERF_OK;
    unlink(out->temporary);
    return failure(c, SHERF_WRITE_FAILED, "%s: cannot be written: %s", out->final, strerror(why));
}

void output_abort(output_file *out) {
    if (!out->file) return;
    fclose(out->file);
    unlink(out->temporary);
    out->file = NULL;
}

sherf_status file_write(context *c, const char *path, const void *data, size_t bytes) {
    output_file out = {0};
    sherf_status status = output_open(c, path, &out);
    if (status == SHERF_OK) status = output_write(c, &out, data, bytes);
    if (status == SHERF_OK) status = output_commit(c, &out);
    output_abort(&out);
    return status;
}

static int remove_entry(const char *path, const struct stat *info, int type, struct FTW *ftw) {
    return remove(path);
}

void folder_remove(const char *path) {
    nftw(path, remove_entry, 16, FTW_DEPTH | FTW_PHYS);
}

sherf_status folder_make(context *c, const char *path) {
    char part[PATH_LENGTH];
    if (!*path) return failure(c, SHERF_BAD_ARGUMENT, "the folder's name is empty");
    if (snprintf(part, sizeof part, "%s", path) >= (int)sizeof part)
        return failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", path);
    for (char *p = part + 1;; p++) {
        if (*p != '/' && *p) continue;
        char old = *p;
        *p = 0;
        if (mkdir(part, 0777) != 0 && errno != EEXIST)
            return failure(c, SHERF_WRITE_FAILED, "%s: cannot be made: %s", part, strerror(errno));
        *p = old;
        if (!old) break;
    }
    if (!path_is_folder(path)) return failure(c, SHERF_WRITE_FAILED, "%s: not a folder", path);
    return SHERF_OK;
}

bool path_is_folder(const char *path) {
    struct stat info;
    return stat(path, &info) == 0 && S_ISDIR(info.st_mode);
}

bool path_is_file(const char *path) {
    struct stat info;
    return stat(path, &info) == 0 && S_ISREG(info.st_mode);
}

bool path_has(const char *folder, const char *name) {
    char path[PATH_LENGTH];
    int n = snprintf(path, sizeof path, "%s/%s", folder, name);
    return n > 0 && n < (int)sizeof path && (path_is_file(path) || path_is_folder(path));
}

bool path_ends(const char *path, const char *suffix) {
    size_t n = strlen(path), m = strlen(suffix);
    return n >= m && !strcasecmp(path + n - m, suffix);
}
