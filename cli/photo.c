/* Photos instead of observations: the estimate, and the messages about it. */
#include "photo.h"

#include <string.h>
#include <strings.h>

enum { PHOTO_PEOPLE_MAX = 8 }; /* more are not searched for */

photo_request photo_wanted;

bool photo_is(const char *path) {
    static const char *const endings[] = {".jpg", ".jpeg", ".png", ".webp", ".heic", ".heif", ".avif",
                                          ".tif", ".tiff", ".gif", ".bmp",  ".jxl",  ".jp2",  ".dng",
                                          ".nef", ".cr2",  ".cr3", ".arw",  ".svg",  ".pdf",  ".psd"};
    const char *end = strrchr(path, '.');
    if (strchr(path, '#')) return false; /* a data set's picture */
    for (size_t i = 0; end && i < sizeof endings / sizeof *endings; i++)
        if (!strcasecmp(end, endings[i])) return true;
    return sherf_image_kind(path) != NULL;
}

const char *photo_networks(void) {
    const char *path = session_asset(NULL, PHOTO_NETWORKS);
    if (!path)
        session_failure("%s, the networks that find people, is not among the assets (looked in %s; set "
                        "SHERF_ASSETS to the folder that has it)",
                        PHOTO_NETWORKS, session_asset_places());
    return path;
}

int photo_estimator(session *s, sherf_estimator **out) {
    const char *path = photo_networks();
    *out = NULL;
    return path ? session_status(s, sherf_estimator_load(s->context, path, out)) : EXIT_FAILED;
}

static void warn(const char *path, unsigned warnings) {
    static const struct {
        unsigned bit;
        const char *text;
    } lines[] = {
        {SHERF_ESTIMATE_POOR, "the body lies badly on the person: look at the overlay, and correct"},
        {SHERF_ESTIMATE_FROM_BEHIND, "seen from behind: the face will be a guess"},
        {SHERF_ESTIMATE_CUT_FEET, "the feet are outside the photo: the legs are a guess"},
        {SHERF_ESTIMATE_CUT_HEAD, "the head is outside the photo"},
        {SHERF_ESTIMATE_SMALL, "the person is very small: little will be recognised"},
        {SHERF_ESTIMATE_HIDDEN_ARMS, "an arm is hidden: its pose is a guess, and it may leave its print"},
        {SHERF_ESTIMATE_MASK_CUT, "the cut-out may end before the person does"},
    };
    for (size_t i = 0; i < sizeof lines / sizeof *lines; i++)
        if (warnings & lines[i].bit) session_remark("%s: %s", path, lines[i].text);
}

static void say(const char *path, const sherf_estimate_facts *f) {
    char which[64] = "one person";
    if (f->people > 1)
        snprintf(which, sizeof which, "%d people%s, number %d%s taken", f->people,
                 f->people == PHOTO_PEOPLE_MAX ? " or more" : "", f->person,
                 f->person == 1 ? ", the largest," : "");
    session_remark(
        "%s: %s, %.0f px high; the body covers %.0f %% of the person, landmarks are %.1f %% of the "
        "height off (%.1f s)",
        path, which, f->person_px, 100 * f->mask_covered, 100 * f->landmarks_off,
        1e-3 * (f->find_ms + f->mask_ms + f->fit_ms));
}

/* Estimates, and prints the line about the result, without the warnings. */
static int estimate(session *s, const sherf_estimator *n, const sherf_body *body, const char *path,
                    sherf_estimate **out) {
    const sherf_estimate_options o = {
        .person = (int)photo_wanted.person, .focal_px = photo_wanted.focal_px, .mask = photo_wanted.mask};
    const int status = session_status(s, sherf_estimate_photo(s->context, n, body, path, &o, out));
    if (!status) say(path, sherf_estimate_found(*out));
    return status;
}

int photo_estimate(session *s, const sherf_estimator *n, const sherf_body *body, const char *path,
                   sherf_estimate **out) {
    const int status = estimate(s, n, body, path, out);
    if (!status) warn(path, sherf_estimate_found(*out)->warnings);
    return status;
}

/* The face is a guess only where every photo is from behind. */
static void warn_all(int count, const char *const *path, sherf_estimate *const *e) {
    unsigned unless = SHERF_ESTIMATE_FROM_BEHIND;
    for (int i = 0; i < count; i++) unless &= sherf_estimate_found(e[i])->warnings;
    for (int i = 0; i < count; i++)
        warn(path[i],
             sherf_estimate_found(e[i])->warnings & (~(unsigned)SHERF_ESTIMATE_FROM_BEHIND | unless));
}

/* Estimates several photos of one person, with one shape, and draws the requested picture. */
static int estimate_all(session *s, const sherf_body *body, int count, const char *const *path,
                        sherf_estimate **e) {
    sherf_estimator *n = NULL;
    int status = photo_estimator(s, &n);
    for (int i = 0; i < count && !status; i++) status = estimate(s, n, body, path[i], &e[i]);
    if (!status) warn_all(count, path, e);
    if (!status) status = session_status(s, sherf_estimate_share_shape(s->context, body, count, e));
    if (!status && photo_wanted.overlay)
        status = session_status(s, sherf_estimate_overlay(s->context, e[0], body, photo_wanted.overlay));
    sherf_estimator_free(n);
    return status;
}

int photo_observations(session *s, const sherf_body *body, int count, const char *const *path,
                       sherf_observation **out) {
    sherf_estimate *e[SHERF_PICTURES_MAX] = {NULL};
    int status = count ? estimate_all(s, body, count, path, e) : EXIT_DONE;
    for (int i = 0; i < count && !status; i++)
        status = session_status_of(s, path[i], sherf_estimate_observation(s->context, e[i], &out[i]));
    for (int i = 0; i < count; i++) sherf_estimate_free(e[i]);
    return status;
}

cJSON *photo_json(const char *path, const sherf_estimate_facts *f) {
    static const char *const words[] = {"from_behind", "cut_feet", "cut_head", "small",
                                        "hidden_arms", "poor",     "mask_cut"};
    cJSON *json = cJSON_CreateObject();
    cJSON_AddStringToObject(json, "photo", path);
    cJSON_AddNumberToObject(json, "people", f->people);
    cJSON_AddNumberToObject(json, "person", f->person);
    cJSON_AddNumberToObject(json, "width_px", f->width_px);
    cJSON_AddNumberToObject(json, "height_px", f->height_px);
    double box[4];
    for (int i = 0; i < 4; i++) box[i] = (double)f->box_px[i];
    cJSON_AddItemToObject(json, "box_px", cJSON_CreateDoubleArray(box, 4));
    cJSON_AddNumberToObject(json, "person_px", f->person_px);
    cJSON_AddNumberToObject(json, "focal_px", f->focal_px);
    cJSON_AddNumberToObject(json, "pitch_deg", f->pitch_deg);
    cJSON_AddNumberToObject(json, "lean_deg", f->lean_deg);
    cJSON_AddNumberToObject(json, "landmarks_off", f->landmarks_off);
    cJSON_AddNumberToObject(json, "mask_covered", f->mask_covered);
    cJSON_AddNumberToObject(json, "body_inside", f->body_inside);
    cJSON *warnings = cJSON_AddArrayToObject(json, "warnings");
    for (size_t i = 0; i < sizeof words / sizeof *words; i++)
        if (f->warnings & 1u << i) cJSON_AddItemToArray(warnings, cJSON_CreateString(words[i]));
    cJSON_AddNumberToObject(json, "find_ms", f->find_ms);
    cJSON_AddNumberToObject(json, "mask_ms", f->mask_ms);
    cJSON_AddNumberToObject(json, "fit_ms", f->fit_ms);
    return json;
}
