/* Runs the program under test as a person or a script does, and makes small files for it. */
#ifndef SHERF_TESTS_PROGRAM_H
#define SHERF_TESTS_PROGRAM_H

#include "support.h"

#include <cjson/cJSON.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

/* The smallest model with every kind of layer; it takes a tenth of the time of "small". */
#define TINY "small,encoder_width=8,style_width=16,plane_resolution=16,channel_max=16"

enum { WORDS_MAX = 40, TEXT_MAX = 1 << 16 };

typedef struct {
    int status; /* exit status; -1: a signal ended it */
    char out[TEXT_MAX], err[TEXT_MAX];
} outcome;

static inline void text_read(const char *path, char *text) {
    FILE *f = fopen(path, "rb");
    size_t n = f ? fread(text, 1, TEXT_MAX - 1, f) : 0;
    text[n] = 0;
    if (f) fclose(f);
}

/* Maximum size of a file that the program may write, to imitate a full disk; 0: no limit. */
static rlim_t file_bytes_max;

static inline void limit_files(void) {
    if (!file_bytes_max) return;
    signal(SIGXFSZ, SIG_IGN);
    setrlimit(RLIMIT_FSIZE, &(struct rlimit){file_bytes_max, file_bytes_max});
}

static inline pid_t start(const char *words, const char *out, const char *err) {
    static char line[8192];
    char *argument[WORDS_MAX + 2], *rest = line;
    int count = 0;
    snprintf(line, sizeof line, "%s", words);
    argument[count++] = getenv("SHERF_PROGRAM");
    for (char *w; (w = strsep(&rest, " ")) && count < WORDS_MAX;)
        if (*w) argument[count++] = w;
    argument[count] = NULL;
    fflush(NULL);
    pid_t child = fork();
    if (child == 0) {
        limit_files();
        int o = open(out, O_WRONLY | O_CREAT | O_TRUNC, 0600),
            e = open(err, O_WRONLY | O_CREAT | O_TRUNC, 0600);
        int i = open("/dev/null", O_RDONLY);
        if (i < 0 || dup2(i, 0) < 0 || dup2(o, 1) < 0 || dup2(e, 2) < 0) _exit(99);
        execv(argument[0], argument);
        _exit(99);
    }
    assert_true(child > 0);
    return child;
}

/* Runs the program with `words`, split at spaces. The result is valid until the next call. */
static const outcome *run(const char *format, ...) {
    static outcome o;
    char words[8000], out[4096], err[4096];
    va_list list;
    va_start(list, format);
    vsnprintf(words, sizeof words, format, list);
    va_end(list);
    snprintf(out, sizeof out, "%s", test_path("stdout"));
    snprintf(err, sizeof err, "%s", test_path("stderr"));
    int status;
    pid_t child = start(words, out, err);
    assert_int_equal(waitpid(child, &status, 0), child);
    o.status = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
    text_read(out, o.out);
    text_read(err, o.err);
    return &o;
}

static inline void assert_contains(const char *text, const char *part) {
    if (!strstr(text, part)) fail_msg("no \"%s\" in \"%s\"", part, text);
}

/* Exit status, nothing on stdout, one line on stderr that contains both parts. */
static inline void assert_error(const outcome *o, int status, const char *part, const char *other) {
    if (o->status != status) fail_msg("status %d, not %d: %s", o->status, status, o->err);
    assert_string_equal(o->out, "");
    assert_int_equal(strncmp(o->err, "sherf", 5), 0);
    const char *end = strchr(o->err, '\n');
    if (!end || end[1]) fail_msg("not one line: %s", o->err);
    assert_contains(o->err, part);
    assert_contains(o->err, other);
}

/* The JSON on stdout; delete it. */
static inline cJSON *json_of(const outcome *o) {
    if (o->status != 0) fail_msg("status %d: %s", o->status, o->err);
    const char *end;
    cJSON *json = cJSON_ParseWithOpts(o->out, &end, 0);
    if (!json) fail_msg("not JSON: %s", o->out);
    if (end[strspn(end, " \n")]) fail_msg("more than JSON: %s", o->out);
    return json;
}

static inline double number(const cJSON *json, const char *name) {
    const cJSON *n = cJSON_GetObjectItem(json, name);
    if (!cJSON_IsNumber(n)) fail_msg("no number \"%s\"", name);
    return n->valuedouble;
}

static inline void text_write(const char *path, const char *text) {
    FILE *f = fopen(path, "wb");
    assert_non_null(f);
    fputs(text, f);
    fclose(f);
}

static inline long file_size(const char *path) {
    struct stat st;
    return stat(path, &st) == 0 ? (long)st.st_size : -1;
}

/* A person with joints named as SMPL exporters do, who turns for this many frames. */
static inline void bvh_write(const char *path, int frames) {
    static const char *const limb[][3] = {{"L_Hip", "L_Knee", "L_Ankle"},
                                          {"R_Hip", "R_Knee", "R_Ankle"},
                                          {"L_Shoulder", "L_Elbow", "L_Wrist"},
                                          {"R_Shoulder", "R_Elbow", "R_Wrist"}};
    FILE *f = fopen(path, "wb");
    assert_non_null(f);
    fprintf(
        f,
        "HIERARCHY\nROOT Pelvis { OFFSET 0 0 0 CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation "
        "Yrotation\n");
    for (int l = 0; l < 4; l++) {
        int side = l % 2 ? -1 : 1, leg = l < 2;
        for (int j = 0; j < 3; j++)
            fprintf(f, "JOINT %s\n{ OFFSET %d %d 0 CHANNELS 3 Zrotation Xrotation Yrotation\n", limb[l][j],
                    j && leg ? 0 : (leg ? 10 : 25) * side,
                    leg ? j ? -40 : -5
                    : j ? 0
                        : 40);
        fprintf(f, "End Site { OFFSET 0 -1 0 } } } }\n");
    }
    fprintf(f, "}\nMOTION\nFrames: %d\nFrame Time: 0.04\n", frames);
    for (int i = 0; i < frames; i++) {
        fprintf(f, "0 90 0 0 0 %d", 3 * i);
        for (int k = 0; k < 36; k++) fprintf(f, " %d", k % 7);
        fprintf(f, "\n");
    }
    fclose(f);
}

#endif
