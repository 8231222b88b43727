/* sherf estimate: photos to observation folders, a video to a motion. */
#include <dirent.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>

#include "photo.h"
#include "verbs.h"

enum { PHOTOS_MAX = 10000 };
static struct { const char *body, *output; } set;

static const option options[] = {
    {'o', "output", OPTION_FILE, &set.output, "FOLDER",
     "for one photo its observation; for several, a folder for each, named after the photo; for a video "
     "FILE.npz, the motion",
     .needed = true},
    {'b', "body", OPTION_FILE, &set.body, "FILE", "body model to fit (the open body)"},
    PHOTO_OPTIONS,
    {0},
};

typedef struct {
    char *path[PHOTOS_MAX];
    int count;
    bool folder; /* one was given */
} photo_list;

static int by_name(const void *a, const void *b) {
    return strcmp(*(char *const *)a, *(char *const *)b);
}

static int list_add(photo_list *l, const char *folder, const char *name) {
    char path[4096];
    if (l->count == PHOTOS_MAX) return session_failure("more than %d photos", PHOTOS_MAX);
    if (snprintf(path, sizeof path, "%s%s%s", folder, *folder ? "/" : "", name) >= (int)sizeof path)
        return session_failure("%.60s...: path too long", name);
    if (!(l->path[l->count] = strdup(path))) return session_failure("out of memory");
    l->count++;
    return EXIT_DONE;
}

/* A folder's pictures, by name, including files that only have a picture's ending; other files are skipped.
 */
static int list_folder(photo_list *l, const char *folder) {
    DIR *d = opendir(folder);
    int status = EXIT_DONE, first = l->count;
    if (!d) return session_failure("%s: cannot be read", folder);
    for (struct dirent *f; !status && (f = readdir(d));) {
        char path[4096];
        struct stat st;
        if (f->d_name[0] == '.' ||
            snprintf(path, sizeof path, "%s/%s", folder, f->d_name) >= (int)sizeof path)
            continue;
        if (stat(path, &st) == 0 && S_ISREG(st.st_mode) && photo_is(path))
            status = list_add(l, folder, f->d_name);
    }
    closedir(d);
    qsort(l->path + first, (size_t)(l->count - first), sizeof *l->path, by_name);
    if (!status && l->count == first) status = session_failure("%s: no pictures in it", folder);
    l->folder = true;
    return status;
}

/* The folder of photo i: OUTPUT, or OUTPUT/NAME without the ending. */
static int output_of(const photo_list *l, int i, char out[4096]) {
    const char *name = strrchr(l->path[i], '/'), *end;
    name = name ? name + 1 : l->path[i];
    end = strrchr(name, '.');
    const int length = end && end != name ? (int)(end - name) : (int)strlen(name);
    int n = l->count == 1 && !l->folder ? snprintf(out, 4096, "%s", set.output)
                                        : snprintf(out, 4096, "%s/%.*s", set.output, length, name);
    return n < 4096 ? EXIT_DONE : session_failure("%.60s...: path too long", set.output);
}

/* Two photos whose names differ only in the ending would write into one folder. */
static int check_names(const photo_list *l) {
    int status = EXIT_DONE;
    char **name = calloc((size_t)l->count + 1, sizeof *name);
    if (!name) return session_failure("out of memory");
    for (int i = 0; !status && i < l->count; i++) {
        char path[4096];
        status = output_of(l, i, path);
        if (!status && !(name[i] = strdup(path))) status = session_failure("out of memory");
    }
    if (!status) qsort(name, (size_t)l->count, sizeof *name, by_name);
    for (int i = 1; !status && i < l->count; i++)
        if (!strcmp(name[i - 1], name[i]))
            status = session_failure("two photos would be written to %s: rename one of them", name[i]);
    for (int i = 0; i < l->count; i++) free(name[i]);
    free(name);
    return status;
}

static int one(session *s, const sherf_estimator *n, const sherf_body *body, const photo_list *l, int i,
               cJSON *json) {
    char folder[4096];
    sherf_estimate *e = NULL;
    int status = output_of(l, i, folder);
    if (!status) status = photo_estimate(s, n, body, l->path[i], &e);
    if (!status) status = session_status(s, sherf_estimate_save(s->context, e, body, folder));
    if (!status && json) {
        cJSON *said = photo_json(l->path[i], sherf_estimate_found(e));
        cJSON_AddStringToObject(said, "observation", folder);
        cJSON_AddItemToArray(json, said);
    } else if (!status) {
        const bool slash = folder[strlen(folder) - 1] == '/';
        session_remark("%s: the observation; look at %s%soverlay.png", folder, folder, slash ? "" : "/");
    }
    sherf_estimate_free(e);
    return status;
}

static int run_photos(session *s, int count, char **argument) {
    photo_list *l = calloc(1, sizeof *l);
    sherf_body *body = NULL;
    sherf_estimator *n = NULL;
    cJSON *json = common.json ? cJSON_CreateArray() : NULL;
    int status = l ? EXIT_DONE : session_failure("out of memory"), failed = 0;
    for (int i = 0; !status && i < count; i++) {
        struct stat st;
        const bool folder = stat(argument[i], &st) == 0 && S_ISDIR(st.st_mode);
        status = folder ? list_folder(l, argument[i]) : list_add(l, "", argument[i]);
    }
    if (!status && l->count > 1 && (photo_wanted.mask || photo_wanted.focal_px > 0))
        status = usage_error(s->verb_name, "--mask and --focal-px are for one photo, these are %d", l->count);
    if (!status) status = check_names(l);
    const char *path = status ? NULL : session_body(s, set.body, NULL);
    if (!status && !path) status = EXIT_USAGE;
    if (!status) status = session_status(s, sherf_body_load(s->context, path, &body));
    if (!status) status = photo_estimator(s, &n);
    for (int i = 0; !status && i < l->count; i++) {
        const int result = one(s, n, body, l, i, json);
        if (result) failed++; /* already reported; the others go on */
        if (session_interrupted()) break;
    }
    if (!status && failed) status = EXIT_FAILED;
    if (!status && json) session_json(json), json = NULL;
    if (failed && l->count > 1) session_remark("%d of %d photos failed", failed, l->count);
    if (json && failed < l->count) session_json(json), json = NULL;
    cJSON_Delete(json);
    sherf_estimator_free(n);
    sherf_body_free(body);
    for (int i = 0; l && i < l->count; i++) free(l->path[i]);
    free(l);
    return status;
}

/* ---- a video ---- */
static bool ends(const char *path, const char *ending) {
    const size_t n = strlen(path), m = strlen(ending);
    return n > m && !strcasecmp(path + n - m, ending);
}

static bool is_video(const char *path) {
    static const char *const endings[] = {".mp4", ".mov", ".m4v", ".webm", ".mkv", ".avi", ".mpg", ".ts"};
    for (size_t i = 0; i < sizeof endings / sizeof *endings; i++)
        if (ends(path, endings[i])) return true;
    return false;
}

static void say_clip(const char *video, int person, const sherf_clip_facts *f) {
    if (common.json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "motion", set.output);
        cJSON_AddNumberToObject(json, "frames", f->frames);
        cJSON_AddNumberToObject(json, "fps", f->fps);
        cJSON_AddNumberToObject(json, "people", f->people);
        cJSON_AddNumberToObject(json, "filled", f->filled);
        cJSON_AddNumberToObject(json, "repaired", f->repaired);
        cJSON_AddNumberToObject(json, "left_out", f->left_out);
        cJSON_AddNumberToObject(json, "poor", f->poor);
        cJSON_AddNumberToObject(json, "cuts", f->cuts);
        cJSON_AddNumberToObject(json, "start_s", f->start_s);
        cJSON_AddNumberToObject(json, "focal_px", f->focal_px);
        cJSON_AddNumberToObject(json, "landmarks_off", f->landmarks);
        cJSON_AddNumberToObject(json, "seconds", f->seconds[0] + f->seconds[1] + f->seconds[2]);
        session_json(json);
        return;
    }
    if (f->people > 1)
        session_remark(
            "%s: %d people where anybody is seen first, number %d%s followed (--person N takes another)",
            video, f->people, person, person == 1 ? ", the largest," : "");
    if (f->cuts)
        session_remark(
            "%s: %d cut%s; the motion is of the shot that shows the person longest, %.1f to %.1f s "
            "(to use another shot, make a video of it alone)",
            video, f->cuts, f->cuts == 1 ? "" : "s", f->start_s, f->start_s + f->frames / f->fps);
    session_remark(
        "%s: %d frame%s at %.4g a second; %d without the person are filled in, %d lie badly, %d before "
        "and after are left out; landmarks are %.1f %% of the height off",
        set.output, f->frames, f->frames == 1 ? "" : "s", f->fps, f->filled, f->poor, f->left_out,
        100 * f->landmarks);
}

static int run_video(session *s, const char *video) {
    sherf_body *body = NULL;
    sherf_clip_facts facts;
    if (photo_wanted.mask) return usage_error(s->verb_name, "--mask is for photos");
    const char *path = session_body(s, set.body, NULL), *networks = path ? photo_networks() : NULL;
    if (!networks) return path ? EXIT_FAILED : EXIT_USAGE;
    const sherf_clip_options o = {.person = photo_wanted.person > 0 ? (int)photo_wanted.person - 1 : 0,
                                  .focal_px = photo_wanted.focal_px};
    int status = session_status(s, sherf_body_load(s->context, path, &body));
    if (!status)
        status =
            session_status(s, sherf_estimate_clip(s->context, networks, body, video, &o, set.output, &facts));
    if (!status) say_clip(video, o.person + 1, &facts);
    sherf_body_free(body);
    return status;
}

static int run(session *s, int count, char **argument) {
    const bool motion = ends(set.output, ".npz") || ends(set.output, ".bvh") || ends(set.output, ".glb");
    for (int i = 0; i < count; i++)
        if ((motion && count > 1) || (!motion && is_video(argument[i])))
            return usage_error(s->verb_name, "%s: one video goes into a motion, -o FILE.npz", argument[i]);
    if (motion && sherf_image_kind(argument[0]))
        return usage_error(s->verb_name, "%s is a photo, not a video: it goes into a folder, -o FOLDER",
                           argument[0]);
    if (!motion && sherf_output_kind(set.output) != SHERF_OUTPUT_FOLDER)
        return usage_error(s->verb_name,
                           "--output %s: photos go into a folder (%s/), a video into a .npz, .bvh or .glb",
                           set.output, set.output);
    return motion ? run_video(s, argument[0]) : run_photos(s, count, argument);
}

const verb verb_estimate = {
    .name = "estimate",
    .arguments = "PHOTO...|VIDEO",
    .summary = "find the person in a photo: mask, camera, body pose and shape",
    .description =
        "Writes the observation of a photo as a folder: the picture, a soft mask to paint in, camera and "
        "body "
        "as numbers to correct (observation.json), and overlay.png to look at. All verbs that take an "
        "observation take such a folder. PHOTO is a JPEG, PNG, WebP, HEIC or AVIF file, or a folder of them. "
        "Of a video of one person, taken by a camera that stands still, the motion is written for sherf "
        "animate.",
    .example = "sherf estimate me.jpg -o me/\n"
               "sherf avatar me/ -o me.safetensors\n"
               "sherf estimate holiday/ -o people/ --json\n"
               "sherf estimate dance.mp4 -o dance.npz",
    .options = options,
    .arguments_min = 1,
    .arguments_max = 1000,
    .computes = true,
    .many_kinds = true,
    .run = run,
};
