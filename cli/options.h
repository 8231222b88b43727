/* options: one table for each verb. The parser, --help, the man pages and the completion all read these
 * tables, so they cannot disagree. */
#ifndef CLI_OPTIONS_H
#define CLI_OPTIONS_H

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

typedef enum {
    OPTION_FLAG,    /* bool */
    OPTION_TEXT,    /* const char * */
    OPTION_FILE,    /* const char *; completed as a file name; with the argument "PNG" it ends in .png */
    OPTION_FILES,   /* option_files; may be repeated */
    OPTION_INTEGER, /* int64_t */
    OPTION_REAL,    /* double */
    OPTION_CHOICE,  /* int: index into the words of `argument`, "a|b|c" */
    OPTION_LIST,    /* const char *: "0,2,4" or "first:step:count", see list_parse */
    OPTION_PAIRS    /* const char *: "POSE:VIEW,..." or "random" */
} option_kind;

enum { OPTION_FILES_MAX = 256 };
typedef struct {
    const char *file[OPTION_FILES_MAX];
    int count;
} option_files;

typedef struct {
    char letter;      /* 0: no short form */
    const char *name; /* without the dashes; NULL ends a table */
    option_kind kind;
    void *value;             /* destination, of the type above; holds the default initially */
    const char *argument;    /* the value's name in the help; a choice's words */
    const char *help;        /* a phrase without a full stop */
    double minimum, maximum; /* of numbers, both ends allowed; equal: any */
    bool needed;
} option;

typedef struct session session;
typedef struct {
    const char *name;
    const char *arguments; /* as in the usage line: "OBSERVATION"; "" for none */
    const char *summary;   /* one phrase, for the list of verbs */
    const char *description;
    const char *example; /* complete command lines, one per line */
    const option *options;
    int arguments_min, arguments_max;
    const char *words; /* the allowed first arguments, "render|train"; NULL: anything */
    bool computes;     /* runs networks, on the device */
    bool to_stdout;    /* --output - is standard output */
    bool many_kinds;   /* --output may have endings that the verb itself checks */
    int (*run)(session *s, int count, char **argument); /* the exit status */
} verb;

enum { EXIT_DONE = 0, EXIT_FAILED = 1, EXIT_USAGE = 2 };

/* Options every verb has. */
typedef struct {
    bool help, version, quiet, json;
    bool silent;   /* not an option: another process of this run prints the messages */
    int device;    /* as sherf_device */
    int precision; /* as sherf_precision */
    int64_t threads, seed;
} common_options;
extern common_options common;
extern const option common_table[];

/* Stores the values of v's and the common options, moves the other arguments to the front of argument[] and
 * sets *count to their number. EXIT_DONE, or EXIT_USAGE after one line on stderr. */
int options_parse(const verb *v, int *count, char **argument);
/* Prints one line on stderr that refers to --help; returns EXIT_USAGE. */
int usage_error(const char *verb_name, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Parses "0,2,4" or "first:step:count". NULL: not such a list. Free the result with free. */
int *list_parse(const char *text, int *count);
bool list_valid(const char *text);
/* "512" (*height is then 0) or "640x360", each 1 to 32768. */
bool size_parse(const char *text, int *width, int *height);

/* ---- texts made from the tables (describe.c); verbs end with a NULL ---- */
void describe_program(FILE *f, const verb *const *verbs);
void describe_verb(FILE *f, const verb *v);
void describe_man(FILE *f, const verb *const *verbs, const verb *v); /* v NULL: the program's page */
void describe_bash(FILE *f, const verb *const *verbs);
void describe_zsh(FILE *f, const verb *const *verbs);

#endif
