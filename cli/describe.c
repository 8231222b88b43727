/* Help, man pages and shell completion, all from the option tables. */
#include "options.h"

#include <ctype.h>
#include <string.h>

#include "sherf/sherf.h"

enum { LINE = 96, COLUMN = 28 };

/* Writes the words of `text` from column `at`, continued at column `indent`. */
static void wrap(FILE *f, const char *text, int at, int indent) {
    while (*text) {
        if (*text == '\n') {
            fprintf(f, "\n%*s", indent, "");
            at = indent;
            text++;
            continue;
        }
        int n = (int)strcspn(text, " \n");
        if (at > indent && at + n + 1 > LINE) {
            fprintf(f, "\n%*s", indent, "");
            at = indent;
        } else if (at > indent) {
            fputc(' ', f);
            at++;
        }
        fprintf(f, "%.*s", n, text);
        at += n;
        text += n;
        while (*text == ' ') text++;
    }
    fputc('\n', f);
}

static void describe_option(FILE *f, const option *o) {
    int at = o->letter ? fprintf(f, "  -%c, --%s", o->letter, o->name) : fprintf(f, "      --%s", o->name);
    if (o->argument) at += fprintf(f, " %s", o->argument);
    if (at + 2 > COLUMN) {
        fputc('\n', f);
        at = 0;
    }
    fprintf(f, "%*s", COLUMN - at, "");
    wrap(f, o->help, COLUMN, COLUMN);
}

static void describe_usage(FILE *f, const verb *v) {
    fprintf(f, "sherf %s%s%s", v->name, *v->arguments ? " " : "", v->arguments);
    for (const option *o = v->options; o && o->name; o++)
        if (o->needed) {
            if (o->letter)
                fprintf(f, " -%c %s", o->letter, o->argument);
            else
                fprintf(f, " --%s %s", o->name, o->argument);
        }
    fputs(" [options]", f);
}

/* Writes each line of `text` after `before`. */
static void lines(FILE *f, const char *before, const char *text) {
    for (;;) {
        int n = (int)strcspn(text, "\n");
        fprintf(f, "%s%.*s\n", before, n, text);
        if (!text[n]) return;
        text += n + 1;
    }
}

void describe_verb(FILE *f, const verb *v) {
    fputs("usage: ", f);
    describe_usage(f, v);
    fputs("\n\n", f);
    wrap(f, v->description, 0, 0);
    if (v->options && v->options->name) fputs("\noptions\n", f);
    for (const option *o = v->options; o && o->name; o++) describe_option(f, o);
    fputs("\ncommon options\n", f);
    for (const option *o = common_table; o->name; o++) describe_option(f, o);
    fputs("\nexample\n", f);
    lines(f, "  ", v->example);
}

void describe_program(FILE *f, const verb *const *verbs) {
    fputs("usage: sherf VERB [arguments] [options]\n\n"
          "One picture of a person in, an animatable person out, from any camera, in any pose.\n\nverbs\n",
          f);
    for (; *verbs; verbs++) fprintf(f, "  %-10s %s\n", (*verbs)->name, (*verbs)->summary);
    fputs("\n'sherf VERB --help' tells about one. Exit status: 0 done, 1 failed, 2 wrong usage.\n", f);
}

/* ---- man pages ---- */
static void roff(FILE *f, const char *text) {
    for (bool start = true; *text; start = *text++ == '\n') {
        if (start && (*text == '.' || *text == '\'')) fputs("\\&", f);
        if (*text == '-' || *text == '\\')
            fputs(*text == '-' ? "\\-" : "\\e", f);
        else if (*text == '\'')
            fputs("\\(aq", f);
        else
            fputc(*text, f);
    }
}

static void man_options(FILE *f, const option *o) {
    for (; o && o->name; o++) {
        fputs(".TP\n\\fB", f);
        if (o->letter) fprintf(f, "\\-%c\\fR, \\fB", o->letter);
        fputs("\\-\\-", f);
        roff(f, o->name);
        fputs("\\fR", f);
        if (o->argument) {
            fputs(" \\fI", f);
            roff(f, o->argument);
            fputs("\\fR", f);
        }
        fputc('\n', f);
        roff(f, o->help);
        fputc('\n', f);
    }
}

static void man_common(FILE *f) {
    fputs(".SH COMMON OPTIONS\n", f);
    man_options(f, common_table);
    fputs(".SH EXIT STATUS\n0 done, 1 failed, 2 wrong usage.\n", f);
}

static void man_verb(FILE *f, const verb *v) {
    fprintf(f, ".TH SHERF\\-%s 1 \"\" \"sherf %s\" \"sherf\"\n.SH NAME\nsherf\\-%s \\- ", v->name,
            SHERF_VERSION, v->name);
    roff(f, v->summary);
    fprintf(f, "\n.SH SYNOPSIS\n.nf\n");
    describe_usage(f, v);
    fputs("\n.fi\n.SH DESCRIPTION\n", f);
    roff(f, v->description);
    fputs("\n", f);
    if (v->options && v->options->name) fputs(".SH OPTIONS\n", f);
    man_options(f, v->options);
    man_common(f);
    fputs(".SH EXAMPLE\n.nf\n", f);
    roff(f, v->example);
    fputs("\n.fi\n.SH SEE ALSO\n.BR sherf (1)\n", f);
}

void describe_man(FILE *f, const verb *const *verbs, const verb *v) {
    if (v) {
        man_verb(f, v);
        return;
    }
    fprintf(
        f,
        ".TH SHERF 1 \"\" \"sherf %s\" \"sherf\"\n.SH NAME\nsherf \\- an animatable person from one "
        "picture\n.SH SYNOPSIS\n.B sherf\n.I VERB\n[arguments] [options]\n.SH DESCRIPTION\n"
        "One picture of a person in, an animatable person out, from any camera, in any pose.\n.SH VERBS\n",
        SHERF_VERSION);
    for (; *verbs; verbs++) {
        fprintf(f, ".TP\n.BR sherf\\-%s (1)\n", (*verbs)->name);
        roff(f, (*verbs)->summary);
        fputc('\n', f);
    }
    man_common(f);
}

/* ---- completion ---- */
static void bash_values(FILE *f, const option *o) {
    for (; o && o->name; o++) {
        if (o->kind == OPTION_FLAG) continue;
        fputs("    ", f);
        if (o->letter) fprintf(f, "-%c|", o->letter);
        fprintf(f, "--%s) ", o->name);
        if (o->kind == OPTION_CHOICE) {
            fputs("COMPREPLY=($(compgen -W \"", f);
            for (const char *p = o->argument; *p; p++) fputc(*p == '|' ? ' ' : *p, f);
            fputs("\" -- \"$word\"))", f);
        } else if (o->kind == OPTION_FILE || o->kind == OPTION_FILES) {
            fputs("COMPREPLY=($(compgen -f -- \"$word\"))", f);
        } else {
            fputs("COMPREPLY=()", f);
        }
        fputs("; return;;\n", f);
    }
}

static void bash_names(FILE *f, const option *o) {
    for (; o && o->name; o++) fprintf(f, " --%s", o->name);
}

void describe_bash(FILE *f, const verb *const *verbs) {
    fputs("# bash completion of sherf, made from its option tables\n_sherf() {\n"
          "  local word=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]} names=\n"
          "  COMPREPLY=()\n  compopt -o filenames 2>/dev/null\n"
          "  if [ \"$COMP_CWORD\" = 1 ]; then COMPREPLY=($(compgen -W \"",
          f);
    for (const verb *const *v = verbs; *v; v++) fprintf(f, "%s ", (*v)->name);
    fputs("help --help --version\" -- \"$word\")); return; fi\n  case ${COMP_WORDS[1]} in\n", f);
    for (const verb *const *v = verbs; *v; v++) {
        fprintf(f, "  %s) case $before in\n", (*v)->name);
        bash_values(f, (*v)->options);
        fputs("    esac\n    names=\"", f);
        bash_names(f, (*v)->options);
        fputs("\"\n", f);
        if ((*v)->words) {
            fputs("    if [ \"$COMP_CWORD\" = 2 ]; then names=\"", f);
            for (const char *p = (*v)->words; *p; p++) fputc(*p == '|' ? ' ' : *p, f);
            fputs(" --help\"; COMPREPLY=($(compgen -W \"$names\" -- \"$word\")); return; fi\n", f);
        }
        fputs("    ;;\n", f);
    }
    fputs("  esac\n  case $before in\n", f);
    bash_values(f, common_table);
    fputs("  esac\n  case $word in\n  -*) COMPREPLY=($(compgen -W \"$names", f);
    bash_names(f, common_table);
    fputs("\" -- \"$word\"));;\n  *) COMPREPLY=($(compgen -f -- \"$word\"));;\n  esac\n}\n"
          "complete -F _sherf sherf\n",
          f);
}

/* A phrase inside a zsh _arguments specification in single quotes. */
static void zsh_text(FILE *f, const char *text) {
    for (; *text; text++) {
        if (*text == '\'')
            fputs("'\\''", f);
        else if (strchr("[]:\\", *text))
            fprintf(f, "\\%c", *text);
        else
            fputc(*text, f);
    }
}

static void zsh_options(FILE *f, const option *o) {
    for (; o && o->name; o++) {
        if (o->letter && o->kind == OPTION_FILES)
            fprintf(f, "    '*'{-%c,--%s}'[", o->letter, o->name);
        else if (o->letter)
            fprintf(f, "    '(-%c --%s)'{-%c,--%s}'[", o->letter, o->name, o->letter, o->name);
        else
            fprintf(f, "    '--%s[", o->name);
        zsh_text(f, o->help);
        fputc(']', f);
        if (o->kind != OPTION_FLAG) {
            fputc(':', f);
            zsh_text(f, o->kind == OPTION_CHOICE ? "choice" : o->argument);
            fputc(':', f);
            if (o->kind == OPTION_FILE || o->kind == OPTION_FILES) fputs("_files", f);
            if (o->kind == OPTION_CHOICE) {
                fputc('(', f);
                for (const char *p = o->argument; *p; p++) fputc(*p == '|' ? ' ' : *p, f);
                fputc(')', f);
            }
        }
        fputs("' \\\n", f);
    }
}

void describe_zsh(FILE *f, const verb *const *verbs) {
    fputs("#compdef sherf\n# zsh completion of sherf, made from its option tables\n_sherf() {\n"
          "  local -a verbs\n  verbs=(\n",
          f);
    for (const verb *const *v = verbs; *v; v++) {
        fprintf(f, "    '%s:", (*v)->name);
        zsh_text(f, (*v)->summary);
        fputs("'\n", f);
    }
    fputs("  )\n  if (( CURRENT == 2 )); then _describe verb verbs; return; fi\n"
          "  shift words; (( CURRENT-- ))\n  case $words[1] in\n",
          f);
    for (const verb *const *v = verbs; *v; v++) {
        fprintf(f, "  %s) _arguments \\\n", (*v)->name);
        zsh_options(f, (*v)->options);
        zsh_options(f, common_table);
        if ((*v)->words) {
            fputs("    '1:what:(", f);
            for (const char *p = (*v)->words; *p; p++) fputc(*p == '|' ? ' ' : *p, f);
            fputs(")' \\\n", f);
        }
        fputs("    '*:file:_files';;\n", f);
    }
    fputs("  esac\n}\n_sherf \"$@\"\n", f);
}
