/* The command line: long and short options, checked against the verb's table and stored; lists,
 * pairs and sizes. */
#include "options.h"

#include <errno.h>
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>

#include "sherf/sherf.h"

common_options common;
const option common_table[] = {
    {0, "device", OPTION_CHOICE, &common.device, "auto|cpu|cuda",
     "where networks compute; auto takes an NVIDIA GPU where the build has CUDA and the machine one"},
    {0, "precision", OPTION_CHOICE, &common.precision, "auto|fp32|bf16",
     "arithmetic of the networks; auto takes bf16 on a GPU and where the processor has AMX"},
    {'t', "threads", OPTION_INTEGER, &common.threads, "N", "threads; 0, the default, is one a core", 0, 1024},
    {0, "seed", OPTION_INTEGER, &common.seed, "N", "seed of everything that is drawn by chance (0)", 0, 9e15},
    {'q', "quiet", OPTION_FLAG, &common.quiet, NULL, "no progress and no remarks, only results and errors"},
    {0, "json", OPTION_FLAG, &common.json, NULL, "results as JSON on standard output"},
    {'h', "help", OPTION_FLAG, &common.help, NULL, "this text"},
    {0, "version", OPTION_FLAG, &common.version, NULL, "the program's version"},
    {0},
};

int usage_error(const char *verb_name, const char *format, ...) {
    char line[3000];
    va_list list;
    va_start(list, format);
    vsnprintf(line, sizeof line, format, list);
    va_end(list);
    fprintf(stderr, "sherf%s%s: %s (see 'sherf%s%s --help')\n", verb_name ? " " : "",
            verb_name ? verb_name : "", line, verb_name ? " " : "", verb_name ? verb_name : "");
    return EXIT_USAGE;
}

/* The index of `text` among the words of "a|b|c"; -1: it is not one of them. */
static int word_index(const char *words, const char *text) {
    size_t length = strlen(text);
    for (int i = 0;; i++) {
        size_t n = strcspn(words, "|");
        if (n == length && strncmp(words, text, n) == 0) return i;
        if (!words[n]) return -1;
        words += n + 1;
    }
}

/* Reads a non-negative integer at *text and moves *text past it; -1: there is none. */
static int number_take(const char **text) {
    if (**text < '0' || **text > '9') return -1;
    char *end;
    errno = 0;
    long v = strtol(*text, &end, 10);
    if (errno || v > 1000000) return -1;
    *text = end;
    return (int)v;
}

int *list_parse(const char *text, int *count) {
    enum { LIST_MAX = 100000 };
    const char *p = text;
    int first = number_take(&p);
    if (first < 0) return NULL;
    if (*p == ':') {
        p++;
        int step = number_take(&p);
        if (step < 0 || *p++ != ':') return NULL;
        int n = number_take(&p);
        if (n < 1 || n > LIST_MAX || *p || (int64_t)first + (int64_t)step * n > 100000000) return NULL;
        int *list = malloc((size_t)n * sizeof *list);
        for (int i = 0; list && i < n; i++) list[i] = first + i * step;
        *count = n;
        return list;
    }
    size_t max = 1;
    for (const char *q = text; *q; q++) max += *q == ',';
    if (max > LIST_MAX) return NULL;
    int *list = malloc(max * sizeof *list);
    if (!list) return NULL;
    for (p = text, *count = 0;; p++) {
        int v = number_take(&p);
        if (v < 0 || (*p && *p != ',')) {
            free(list);
            return NULL;
        }
        list[(*count)++] = v;
        if (!*p) return list;
    }
}

bool list_valid(const char *text) {
    int count, *list = list_parse(text, &count);
    free(list);
    return list != NULL;
}

static bool pairs_valid(const char *text) {
    if (strcmp(text, "random") == 0) return true;
    for (;; text++) {
        if (number_take(&text) < 0 || *text++ != ':' || number_take(&text) < 0) return false;
        if (!*text) return true;
        if (*text != ',') return false;
    }
}

bool size_parse(const char *text, int *width, int *height) {
    enum { SIDE_MAX = 32768 };
    *width = number_take(&text);
    *height = 0;
    if (*text == 'x') {
        text++;
        *height = number_take(&text);
        if (*height == 0) return false;
    }
    return !*text && *width > 0 && *width <= SIDE_MAX && *height >= 0 && *height <= SIDE_MAX;
}

static bool is_png(const char *name) {
    const size_t n = strlen(name);
    return n > 4 && !strcasecmp(name + n - 4, ".png");
}

/* Stores `text` as the value of o; returns the error, or NULL. */
static const char *value_store(const option *o, const char *text) {
    char *end;
    errno = 0;
    switch (o->kind) {
    case OPTION_FLAG:
        *(bool *)o->value = true;
        return NULL;
    case OPTION_TEXT:
    case OPTION_FILE:
        if (!*text) return "is empty";
        if (!strcmp(o->argument, "PNG") && !is_png(text)) return "should end in .png: a PNG is written there";
        *(const char **)o->value = text;
        return NULL;
    case OPTION_FILES: {
        option_files *files = o->value;
        if (!*text) return "is empty";
        if (files->count == OPTION_FILES_MAX) return "is one too many";
        files->file[files->count++] = text;
        return NULL;
    }
    case OPTION_LIST:
        if (!list_valid(text)) return "is not a list like 0,2,4 or first:step:count";
        *(const char **)o->value = text;
        return NULL;
    case OPTION_PAIRS:
        if (!pairs_valid(text)) return "is neither a list like POSE:VIEW,POSE:VIEW nor random";
        *(const char **)o->value = text;
        return NULL;
    case OPTION_CHOICE: {
        int i = word_index(o->argument, text);
        if (i < 0) return "is not a choice";
        *(int *)o->value = i;
        return NULL;
    }
    case OPTION_INTEGER: {
        long long v = strtoll(text, &end, 10);
        if (end == text || *end || errno) return "is not a whole number";
        if (o->minimum < o->maximum && ((double)v < o->minimum || (double)v > o->maximum))
            return "is out of range";
        *(int64_t *)o->value = v;
        return NULL;
    }
    case OPTION_REAL: {
        double v = strtod(text, &end);
        if (end == text || *end || !isfinite(v)) return "is not a number";
        if (o->minimum < o->maximum && (v < o->minimum || v > o->maximum)) return "is out of range";
        *(double *)o->value = v;
        return NULL;
    }
    }
    return NULL;
}

static int store(const verb *v, const option *o, const char *text) {
    if (!strcmp(o->name, "output") && !strcmp(text, "-") && !v->to_stdout)
        return usage_error(v->name,
                           "--output -: nothing goes to standard output here, name a file or folder");
    /* sherf_output_kind does not treat .safetensors as an ending: it is longer */
    if (!strcmp(o->name, "output") && !v->many_kinds && sherf_output_kind(text) != SHERF_OUTPUT_FOLDER)
        return usage_error(v->name, "--output %s: no %s is written here; %s", text, strrchr(text, '.'),
                           !strcmp(o->argument, "FILE") ? "this becomes a .safetensors"
                                                        : "for a folder of that name put / behind it");
    const char *wrong = value_store(o, text);
    if (!wrong) return EXIT_DONE;
    if (o->kind == OPTION_CHOICE)
        return usage_error(v->name, "--%s: '%s' is none of %s", o->name, text, o->argument);
    if (strcmp(wrong, "is out of range") == 0)
        return usage_error(v->name, "--%s: '%s' is not in %.10g to %.10g", o->name, text, o->minimum,
                           o->maximum);
    return usage_error(v->name, "--%s: '%s' %s", o->name, text, wrong);
}

static const option *find(const verb *v, const char *name, size_t length, char letter) {
    const option *tables[] = {v->options, common_table};
    for (int t = 0; t < 2; t++)
        for (const option *o = tables[t]; o && o->name; o++)
            if (letter ? o->letter == letter : strlen(o->name) == length && !strncmp(o->name, name, length))
                return o;
    return NULL;
}

/* argument[*at] is "--name" or "--name=value". */
static int parse_long(const verb *v, int count, char **argument, int *at) {
    const char *name = argument[*at] + 2;
    size_t length = strcspn(name, "=");
    const option *o = find(v, name, length, 0);
    if (!o) return usage_error(v->name, "--%.*s is not an option", (int)(length < 80 ? length : 80), name);
    if (o->kind == OPTION_FLAG) {
        if (name[length]) return usage_error(v->name, "--%s takes no value", o->name);
        return store(v, o, "");
    }
    if (name[length]) return store(v, o, name + length + 1);
    if (*at + 1 >= count) return usage_error(v->name, "--%s wants a value (%s)", o->name, o->argument);
    return store(v, o, argument[++*at]);
}

/* argument[*at] is "-x", "-xy" of flags, or "-oVALUE". */
static int parse_short(const verb *v, int count, char **argument, int *at) {
    for (const char *p = argument[*at] + 1; *p; p++) {
        const option *o = find(v, NULL, 0, *p);
        if (!o) return usage_error(v->name, "-%c is not an option", *p);
        if (o->kind != OPTION_FLAG) {
            if (p[1]) return store(v, o, p + 1);
            if (*at + 1 >= count) return usage_error(v->name, "-%c wants a value (%s)", *p, o->argument);
            return store(v, o, argument[++*at]);
        }
        store(v, o, "");
    }
    return EXIT_DONE;
}

static bool given(const option *o) {
    return o->kind == OPTION_INTEGER || o->kind == OPTION_REAL || *(const char **)o->value != NULL;
}

static int arguments_check(const verb *v, int count, char **argument) {
    if (count < v->arguments_min) return usage_error(v->name, "%s is missing", v->arguments);
    if (count > v->arguments_max)
        return usage_error(v->name, "'%s' is one argument too many", argument[v->arguments_max]);
    if (v->words && word_index(v->words, argument[0]) < 0)
        return usage_error(v->name, "'%s' is none of %s", argument[0], v->words);
    for (const option *o = v->options; o && o->name; o++)
        if (o->needed && !given(o)) return usage_error(v->name, "--%s %s is missing", o->name, o->argument);
    return EXIT_DONE;
}

/* Refuses to write --output over a file that is read. */
static int output_check(const verb *v, int count, char **argument) {
    const option *o = find(v, "output", strlen("output"), 0);
    const char *output = o && o->kind == OPTION_FILE ? *(const char **)o->value : NULL;
    struct stat to, from;
    if (!output || stat(output, &to) || !S_ISREG(to.st_mode)) return EXIT_DONE;
    for (int i = 0; i < count; i++)
        if (!stat(argument[i], &from) && from.st_dev == to.st_dev && from.st_ino == to.st_ino)
            return usage_error(
                v->name, "--output %s: that is the input, which would be lost; name another file", output);
    return EXIT_DONE;
}

int options_parse(const verb *v, int *count, char **argument) {
    int kept = 0;
    bool only_arguments = false;
    for (int i = 0; i < *count; i++) {
        char *a = argument[i];
        int status = EXIT_DONE;
        if (only_arguments || a[0] != '-' || !a[1]) {
            argument[kept++] = a;
        } else if (strcmp(a, "--") == 0) {
            only_arguments = true;
        } else if (a[1] == '-') {
            status = parse_long(v, *count, argument, &i);
        } else {
            status = parse_short(v, *count, argument, &i);
        }
        if (status) return status;
    }
    *count = kept;
    if (common.help || common.version) return EXIT_DONE;
    const int status = arguments_check(v, kept, argument);
    return status ? status : output_check(v, kept, argument);
}
