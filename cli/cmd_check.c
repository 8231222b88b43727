/* sherf check: the library's findings about a body, an observation or a data set. Any error makes
 * the exit status 1. */
#include <string.h>
#include <sys/stat.h>

#include "session.h"
#include "verbs.h"

static struct { const char *body, *overlay; } set;

static const option options[] = {
    {'b', "body", OPTION_FILE, &set.body, "FILE",
     "body model to check data and observations against (one beside them, or else the open body)"},
    {'p', "overlay", OPTION_FILE, &set.overlay, "PNG", "draw the body over the picture"},
    {0},
};

static int report(const sherf_findings *f) {
    const char *text = f->text ? f->text : "";
    if (common.json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddNumberToObject(json, "errors", f->errors);
        cJSON_AddNumberToObject(json, "warnings", f->warnings);
        cJSON *list = cJSON_AddArrayToObject(json, "findings");
        for (size_t n; *text; text += n + (text[n] == '\n')) {
            n = strcspn(text, "\n");
            char line[1024];
            snprintf(line, sizeof line, "%.*s", (int)(n < 1000 ? n : 1000), text);
            if (n) cJSON_AddItemToArray(list, cJSON_CreateString(line));
        }
        session_json(json);
    } else {
        fputs(text, stdout);
        printf("%d error%s, %d warning%s\n", f->errors, f->errors == 1 ? "" : "s", f->warnings,
               f->warnings == 1 ? "" : "s");
    }
    return f->errors ? EXIT_FAILED : EXIT_DONE;
}

/* Whether the input contains a body: an observation or a data set, rather than a body's own file. */
static bool has_people(const char *path) {
    struct stat info;
    const char *end = strrchr(path, '.');
    return strpbrk(path, ":#") || (stat(path, &info) == 0 && S_ISDIR(info.st_mode)) ||
           (end && !strcmp(end, ".json"));
}

static int run(session *s, int count, char **argument) {
    if (!set.body && has_people(argument[0]) && !(set.body = session_body(s, NULL, argument[0])))
        return EXIT_USAGE;
    if (set.overlay && !set.body) return usage_error(s->verb_name, "--overlay needs --body");
    sherf_body *body = NULL;
    sherf_findings findings = {0};
    int status = EXIT_DONE;
    if (set.body) status = session_status(s, sherf_body_load(s->context, set.body, &body));
    if (!status)
        status = session_status(s, sherf_check(s->context, argument[0], body, set.overlay, &findings));
    if (!status) status = report(&findings);
    sherf_free(findings.text);
    sherf_body_free(body);
    return status;
}

const verb verb_check = {
    .name = "check",
    .arguments = "PATH",
    .summary = "say what is wrong with a body, data set or observation",
    .description =
        "Looks for what is missing or inconsistent: cameras in millimetres, wrong shapes, masks of "
        "another size, a body that does not cover the mask. Exit status 1 when there are errors.",
    .example = "sherf check ann/ --body body.safetensors --overlay ann-body.png\n"
               "sherf check zju:CoreView --body body.safetensors",
    .options = options,
    .arguments_min = 1,
    .arguments_max = 1,
    .run = run,
};
