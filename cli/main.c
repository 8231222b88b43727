/* sherf: the program. Finds the verb, reads the options, and runs the verb. */
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "session.h"
#include "verbs.h"

#define VERB_ENTRY(name) &verb_##name,
static const verb *const verbs[] = {VERBS(VERB_ENTRY) NULL};

static const verb *verb_find(const char *name) {
    for (const verb *const *v = verbs; *v; v++)
        if (strcmp((*v)->name, name) == 0) return *v;
    return NULL;
}

/* For the build: "--describe man", "man-VERB", "bash", "zsh". */
static int describe(const char *what) {
    if (strcmp(what, "man") == 0)
        describe_man(stdout, verbs, NULL);
    else if (strncmp(what, "man-", 4) == 0 && verb_find(what + 4))
        describe_man(stdout, verbs, verb_find(what + 4));
    else if (strcmp(what, "bash") == 0)
        describe_bash(stdout, verbs);
    else if (strcmp(what, "zsh") == 0)
        describe_zsh(stdout, verbs);
    else
        return usage_error(NULL, "--describe: '%s' is none of man, man-VERB, bash, zsh", what);
    return EXIT_DONE;
}

static int version(void) {
    printf("sherf %s\n", sherf_version());
    return EXIT_DONE;
}

static int verb_run(const verb *v, int count, char **argument) {
    int status = options_parse(v, &count, argument);
    if (status) return status;
    if (common.version) return version();
    if (common.help) {
        describe_verb(stdout, v);
        return EXIT_DONE;
    }
    session s;
    status = session_open(&s, v);
    if (status) return status;
    status = v->run(&s, count, argument);
    session_close(&s);
    return status;
}

static int run(int count, char **argument) {
    if (count < 2) {
        describe_program(stderr, verbs);
        return EXIT_USAGE;
    }
    const char *first = argument[1];
    if (strcmp(first, "--version") == 0) return version();
    if (strcmp(first, "--describe") == 0 && count == 3) return describe(argument[2]);
    if (strcmp(first, "--help") == 0 || strcmp(first, "-h") == 0 || strcmp(first, "help") == 0) {
        const verb *v = count > 2 ? verb_find(argument[2]) : NULL;
        if (count > 2 && !v) return usage_error(NULL, "'%s' is not a verb", argument[2]);
        if (v)
            describe_verb(stdout, v);
        else
            describe_program(stdout, verbs);
        return EXIT_DONE;
    }
    const verb *v = verb_find(first);
    if (!v)
        return usage_error(NULL, first[0] == '-' ? "the verb comes before '%s'" : "'%s' is not a verb",
                           first);
    return verb_run(v, count - 2, argument + 2);
}

/* By default the OpenMP runtime lets idle threads spin for milliseconds, which halves everyone's speed as
 * soon as two programs share the cores. It reads its settings before main, so a shorter spin (some tens of
 * microseconds with gcc's runtime, which obeys the count before the policy; none with LLVM's) needs a second
 * start. A policy set by the user stays. */
static void spin_briefly(char **argument) {
    if (getenv("GOMP_SPINCOUNT") || getenv("OMP_WAIT_POLICY")) return;
    if (setenv("GOMP_SPINCOUNT", "2000", 1) == 0 && setenv("OMP_WAIT_POLICY", "passive", 1) == 0)
        execv("/proc/self/exe", argument); /* continues if this fails */
}

int main(int count, char **argument) {
    spin_briefly(argument);
    int status = run(count, argument);
    if (fflush(stdout) || ferror(stdout)) {
        if (status == EXIT_DONE) status = session_failure("standard output: cannot be written");
    }
    return status;
}
