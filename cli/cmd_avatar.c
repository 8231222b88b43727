/* sherf avatar: makes, from one or several pictures of a person, the file that frames are rendered from. */
#include <string.h>
#include <sys/stat.h>

#include "photo.h"
#include "shared.h"
#include "variants.h"
#include "verbs.h"

static struct {
    const char *model, *body, *output;
    bool whole;
    int64_t variant, variants;
} set;

static const option options[] = {
    SHARED_WEIGHTS(&set.model),
    SHARED_BODY_OF_DATA(&set.body),
    {'o', "output", OPTION_FILE, &set.output, "FILE", "the avatar, .safetensors", .needed = true},
    {0, "whole", OPTION_FLAG, &set.whole, NULL,
     "encode the picture as it is, without cropping it round the person and scaling it for the model"},
    {0, "variant", OPTION_INTEGER, &set.variant, "N",
     "one of many plausible guesses for unseen parts, the same for the same N (0, the best guess)", 0, 1e9},
    {0, "variants", OPTION_INTEGER, &set.variants, "N",
     "also draw a sheet of the best guess and variants 1 to N from behind, beside the avatar", 1,
     VARIANTS_MAX},
    PHOTO_OPTIONS,
    {0, "overlay", OPTION_FILE, &photo_wanted.overlay, "PNG", "draw the estimated body over a photo"},
    {0},
};

/* path: "me-variants.png" of me.safetensors. */
static int draw_variants(session *s, sherf_avatar *avatar, const sherf_body *body, char path[4096]) {
    static const char end[] = "-variants.png";
    const char *dot = strrchr(set.output, '.'), *slash = strrchr(set.output, '/');
    const size_t stem = dot && (!slash || dot > slash) ? (size_t)(dot - set.output) : strlen(set.output);
    if (stem + sizeof end > 4096) return session_failure("%s: the name is too long", set.output);
    memcpy(path, set.output, stem);
    memcpy(path + stem, end, sizeof end);
    const int status = variants_sheet(s, avatar, body, (int)set.variants, path);
    if (!status)
        session_remark("%s: the best guess, then variants 1 to %d, from behind; take one with --variant",
                       path, (int)set.variants);
    return status;
}

/* sheet: of its variants; "": none. */
static int report(session *s, double avatar_s, const char *sheet) {
    struct stat st;
    double bytes = stat(set.output, &st) == 0 ? (double)st.st_size : 0;
    if (!common.json) {
        session_remark("%s: %.1f MB, made in %.0f ms", set.output, bytes / 1e6, 1e3 * avatar_s);
        return EXIT_DONE;
    }
    cJSON *json = cJSON_CreateObject();
    cJSON_AddStringToObject(json, "avatar", set.output);
    cJSON_AddNumberToObject(json, "bytes", bytes);
    if (*sheet) cJSON_AddStringToObject(json, "variants", sheet);
    cJSON_AddNumberToObject(json, "avatar_ms", 1e3 * avatar_s);
    cJSON_AddStringToObject(json, "precision", session_precision(s));
    cJSON_AddStringToObject(json, "device", session_device(s));
    session_json(json);
    return EXIT_DONE;
}

/* Options about one photo do not fit several. */
static int check_several(const session *s, int count) {
    const char *single = photo_wanted.mask ? "--mask" : photo_wanted.overlay ? "--overlay" : "--person";
    if (count == 1 || !(photo_wanted.mask || photo_wanted.overlay || photo_wanted.person)) return EXIT_DONE;
    return usage_error(s->verb_name,
                       "%s is for one photo: give it to sherf estimate, for each into a folder, and the "
                       "folders here",
                       single);
}

static int run(session *s, int count, char **argument) {
    sherf_body *body = NULL;
    sherf_model *model = NULL;
    sherf_observation *observation[SHERF_PICTURES_MAX] = {NULL};
    sherf_avatar *avatar = NULL;
    sherf_context *c = s->context;
    double begun_s = 0, avatar_s = 0;
    char sheet[4096] = "";
    if (check_several(s, count)) return EXIT_USAGE;
    const char *body_path = session_body(s, set.body, argument[0]);
    const char *model_path = body_path ? session_model(s, set.model) : NULL;
    if (!body_path || !model_path) return EXIT_USAGE;
    int status = session_status(s, sherf_body_load(c, body_path, &body));
    if (!status) status = session_status(s, sherf_model_load(c, model_path, &model));
    if (!status)
        status = session_observations(s, count, (const char *const *)argument, model, body, set.whole,
                                      observation);
    begun_s = seconds_now();
    if (!status)
        status = session_status_of(s, count > 1 ? "avatar of several pictures" : argument[0],
                                   sherf_avatar_create_several(c, model, body, count,
                                                               (const sherf_observation *const *)observation,
                                                               &avatar));
    avatar_s = seconds_now() - begun_s;
    if (!status && set.variant)
        status = session_status(s, sherf_avatar_choose(c, avatar, (uint64_t)set.variant));
    if (!status) status = session_status(s, sherf_avatar_save(c, avatar, set.output));
    if (!status && set.variants) status = draw_variants(s, avatar, body, sheet);
    if (!status) status = report(s, avatar_s, sheet);
    sherf_avatar_free(avatar);
    for (int i = 0; i < count; i++) sherf_observation_free(observation[i]);
    sherf_model_free(model);
    sherf_body_free(body);
    return status;
}

const verb verb_avatar = {
    .name = "avatar",
    .arguments = "OBSERVATION...",
    .summary = "make an avatar from one picture of a person, or several",
    .description =
        "Encodes an observation (picture, mask, camera, body pose and shape) into an avatar: one "
        "file with everything that rendering the person needs. OBSERVATION is a photo, of which "
        "the rest is estimated (see sherf estimate), a folder or JSON file, or a picture of a data "
        "set as DATA#PERSON/POSE/VIEW. From several (up to 8: the front, the back, a side), each in any "
        "pose, the avatar takes every place of the body from the picture that shows it best. Places that "
        "none shows are guessed; --variants shows other guesses, --variant takes one.",
    .example =
        "sherf avatar me.jpg -o me.safetensors\n"
        "sherf avatar front.jpg back.jpg -o me.safetensors\n"
        "sherf avatar me.jpg -o me.safetensors --variants 8\n"
        "sherf avatar ann/ --model model.safetensors --body body.safetensors -o ann.safetensors\n"
        "sherf avatar thuman:people#0007/0/4 -m model.safetensors -b body.safetensors -o 7.safetensors",
    .options = options,
    .arguments_min = 1,
    .arguments_max = SHERF_PICTURES_MAX,
    .computes = true,
    .run = run,
};
