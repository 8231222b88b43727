/* The names of a body's parts. Sources: SMPL-X's own package, AMASS, EasyMocap, CLIFF, HMR 2 and 4D-Humans,
 * SMPLify-X, ROMP, TRAM, LHM and ExAvatar, aitviewer, AIST++, GVHMR; descriptions of these files by the
 * projects and their users. */
#include "data/parts.h"

#include <ctype.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

static const char *const poses_names[] = {
    "poses",    "pose",         "smpl_poses",   "smpl_pose",   "thetas", "smpl_thetas", "full_pose",
    "fullpose", "pred_rotmat",  "pred_pose",    "pred_thetas", "theta",  "rotvec",      "poses_6d",
    "pose_6d",  "smpl_pose_6d", "pred_pose_6d", "rot6d",       NULL};
static const char *const body_names[] = {"body_pose",      "pose_body",         "poses_body",
                                         "pred_body_pose", "smpl_body_pose",    "smplx_body_pose",
                                         "body_pose_6d",   "pred_body_pose_6d", NULL};
static const char *const root_names[] = {"global_orient",
                                         "root_orient",
                                         "root_pose",
                                         "poses_root",
                                         "pred_global_orient",
                                         "smplx_root_pose",
                                         "smpl_global_orient",
                                         "global_orientation",
                                         "global_pose",
                                         "global_orient_6d",
                                         "pred_global_orient_6d",
                                         "root_orient_6d",
                                         NULL};
static const char *const shapes_names[] = {"shapes",     "betas",      "shape",       "smpl_betas", "beta",
                                           "pred_betas", "pred_shape", "smplx_shape", NULL};
static const char *const turn_names[] = {"R", "Rh", NULL};
static const char *const place_names[] = {"Th",
                                          "transl",
                                          "trans",
                                          "smpl_trans",
                                          "translation",
                                          "smplx_transl",
                                          "smpl_transl",
                                          "root_translation",
                                          "root_trans",
                                          "root_transl",
                                          "pred_transl",
                                          "pred_trans",
                                          "global_translation",
                                          NULL};
static const char *const camera_turn_names[] = {"camera_rotation", "cam_R", NULL};
/* In the whole picture first: pred_cam_t may mean the crop that the network saw. */
static const char *const camera_place_names[] = {
    "pred_cam_t_full", "cam_t_full", "pred_cam_t", "cam_t", "camera_translation", "cam_trans", "global_t",
    "trans_cam",       "transl_cam", "cam_transl", NULL};
static const char *const pelvis_names[] = {"transl_pelvis", NULL};

static const char *const *const part_names[PARTS] = {
    [PART_POSES] = poses_names,
    [PART_BODY] = body_names,
    [PART_ROOT] = root_names,
    [PART_SHAPES] = shapes_names,
    [PART_TURN] = turn_names,
    [PART_PLACE] = place_names,
    [PART_CAMERA_TURN] = camera_turn_names,
    [PART_CAMERA_PLACE] = camera_place_names,
    [PART_PELVIS] = pelvis_names,
};

/* Dicts that hold the body inside another one. Of GVHMR's two, that in the camera's frame. */
static const char *const inner_names[] = {"smpl_params_incam",
                                          "smplx_cam",
                                          "smpl_cam",
                                          "pred_smpl_params",
                                          "smpl_params",
                                          "smplx_params",
                                          "smpl_param",
                                          "smplx_param",
                                          "smpl",
                                          "smplx",
                                          "body",
                                          "body_params",
                                          "params",
                                          "results",
                                          NULL};
/* Limits for a dict that may contain a body under any name: its keys, and that body's. */
enum { BESIDE_MAX = 32, INSIDE_MAX = 256 };

/* Words in other keys that do not concern pose, shape and place: faces and fingers, which stay at rest,
 * detections, and confidences. */
static const char *const idle_words[] = {
    "joint",     "keypoint",   "kp",        "vert", "vertices", "vertex", "face",       "facial",
    "expr",      "expression", "jaw",       "eye",  "leye",     "reye",   "hand",       "lhand",
    "rhand",     "lefthand",   "righthand", "bbox", "box",      "conf",   "confidence", "score",
    "detection", "loss",       "dmpl",      "num",  "label",    "marker", "princpt",    "pad"};
/* Words for the origin: a key may contain them together with a part, like "transl_frame", and is then
 * reported. */
static const char *const origin_words[] = {
    "img",   "image",     "imgname",   "imgpath", "filename", "frame",   "framerate", "fps",
    "time",  "timestamp", "gender",    "name",    "track",    "tracked", "tracklet",  "id",
    "focal", "int",       "intrinsic", "comment", "version",  "model"};
/* Words of the parts. */
static const char *const part_words[] = {"pose",  "theta", "beta", "shape",  "transl", "trans", "translation",
                                         "place", "root",  "rot",  "orient", "rotmat", "th",    "rh"};

/* The neutral templates' pelves: (0.0031, -0.3514, 0.0120) less (-0.0018, -0.2233, 0.0282). */
const double smplx_pelvis_m[3] = {0.0049, -0.1281, -0.0162};
const double smpl_pelvis_m[3] = {-0.0018, -0.2233, 0.0282};

static bool among(const char *key, const char *const *names) {
    for (; *names; names++)
        if (!strcmp(key, *names)) return true;
    return false;
}

named_value value_first(const value *dict, const char *const *names) {
    for (; *names; names++) {
        const value *item = value_get(dict, *names);
        if (item && item->kind != VALUE_NONE) return (named_value){*names, item};
    }
    return (named_value){NULL, NULL};
}

static bool has_poses(const value *v) {
    return value_first(v, poses_names).item || value_first(v, body_names).item;
}

/* For a dict without poses: the only dict in it that has some, under any key (arr_0, data, person_0). */
static const value *only_inside(const value *v) {
    const value *found = NULL;
    if (!v || v->kind != VALUE_DICT || v->dict.count > BESIDE_MAX || has_poses(v)) return NULL;
    for (size_t i = 0; i < v->dict.count; i++) {
        const value *inner = value_unwrapped(v->dict.pair[i].item);
        if (!inner || inner->kind != VALUE_DICT || inner->dict.count > INSIDE_MAX) continue;
        const value *poses = value_first(inner, poses_names).item,
                    *body = value_first(inner, body_names).item;
        if (value_numbers(poses) < 1 && value_numbers(body) < 1) continue; /* a text may have this name */
        if (found) return NULL;
        found = inner;
    }
    return found;
}

/* The dict inside that holds the body; NULL: there is none, or the parts are not in it. */
static const value *inner_of(const value *v) {
    const value *inner = value_unwrapped(value_first(v, inner_names).item);
    return has_poses(inner) ? inner : only_inside(v);
}

/* The word or its plural. */
static bool word_is(const char *text, size_t n, const char *word) {
    const size_t length = strlen(word);
    if (n < length || strncasecmp(text, word, length)) return false;
    return n == length || (n == length + 1 && tolower((unsigned char)text[length]) == 's') ||
           (n == length + 2 && !strncasecmp(text + length, "es", 2));
}

/* Whether one of the key's words is among these: consecutive letters; a capital after a small letter starts a
 * new word. */
static bool has_word(const char *key, const char *const *words, size_t count) {
    for (size_t i = 0, n; key[i]; i += n ? n : 1) {
        for (n = 0; isalpha((unsigned char)key[i + n]); n++)
            if (n && isupper((unsigned char)key[i + n]) && islower((unsigned char)key[i + n - 1])) break;
        for (size_t k = 0; k < count && n; k++)
            if (word_is(key + i, n, words[k])) return true;
    }
    return false;
}

/* Only SMPL-X's bodies have a jaw, eyes and expressions; GVHMR's parameters, Inter-X's and Multi-HMR's are
 * SMPL-X's too. */
static bool smplx_told(const value *v) {
    static const char *const words[] = {"jaw", "eye", "leye", "reye", "expression", "expr", "smplx"};
    static const char *const models[] = {"surface_model_type", "model_type", "model", NULL},
                             *const keys[] = {"smpl_params_incam", "smpl_params_global", "pose_lhand",
                                              "rotvec", NULL};
    if (v && v->kind == VALUE_RECORD) v = v->record.state;
    const value *model = value_first(v, models).item;
    if (model && model->kind == VALUE_STRING && !strncasecmp(model->string.text, "smplx", 5)) return true;
    if (model && model->kind == VALUE_STRING && !strncasecmp(model->string.text, "smplh", 5)) return false;
    for (size_t i = 0; v && v->kind == VALUE_DICT && i < v->dict.count; i++) {
        const value *key = v->dict.pair[i].key, *item = v->dict.pair[i].item;
        if (key->kind != VALUE_STRING || !item || item->kind == VALUE_NONE) continue;
        if (!strcasecmp(key->string.text, "eye")) continue; /* a camera's place */
        if (has_word(key->string.text, words, COUNT_OF(words))) return true;
    }
    return value_first(v, keys).item != NULL;
}

/* Multi-HMR's transl is where the head is. */
static bool place_is_head(const body_parts *p) {
    const char *poses = p->part[PART_POSES].name, *place = p->part[PART_PLACE].name;
    return poses && place && !strcmp(poses, "rotvec") && !strcmp(place, "transl");
}

/* HumanNeRF's mesh_infos: where the T-pose's pelvis is at the origin, Th is where the body's is. */
static bool place_is_pelvis(const value *v, const body_parts *p) {
    enum { JOINTS = 24 };
    static const double near_m = 0.02; /* SMPL's own is 0.22 away */
    const value *joints = value_get(v, "tpose_joints");
    const char *place = p->part[PART_PLACE].name;
    if (!place || strcmp(place, "Th") || !joints || joints->kind != VALUE_ARRAY ||
        value_numbers(joints) != 3 * JOINTS)
        return false;
    for (int k = 0; k < 3; k++)
        if (!(fabs(value_array_number(joints, k)) < near_m)) return false;
    return true;
}

void body_parts_find(const value *v, body_parts *out) {
    v = value_unwrapped(v);
    const value *inner = inner_of(v);
    out->smplx = smplx_told(inner) || smplx_told(v);
    out->six = six_said(inner) ? six_said(inner) : six_said(v);
    out->scaling = (named_value){"smpl_scaling", value_get(v, "smpl_scaling")};
    for (int p = 0; p < PARTS; p++) {
        out->part[p] = value_first(inner, part_names[p]);
        if (!out->part[p].item) out->part[p] = value_first(v, part_names[p]);
    }
    if (place_is_pelvis(inner ? inner : v, out)) out->part[PART_PELVIS] = out->part[PART_PLACE];
    if (out->part[PART_PELVIS].item || place_is_head(out)) out->part[PART_PLACE] = (named_value){NULL, NULL};
}

static bool is_part(const char *key) {
    for (int p = 0; p < PARTS; p++)
        if (among(key, part_names[p])) return true;
    return among(key, inner_names);
}

static bool is_idle(const char *key) {
    if (has_word(key, idle_words, COUNT_OF(idle_words))) return true;
    if (has_word(key, origin_words, COUNT_OF(origin_words)))
        return !has_word(key, part_words, COUNT_OF(part_words));
    return !strcasecmp(key, "mask") || !strcasecmp(key, "camera") || /* an observation's */
           !strcmp(key, "smpl_scaling");                             /* read by its own name */
}

/* Keys found so far, "a, b, c"; keys that no longer fit are counted. */
typedef struct {
    char text[400];
    size_t bytes;
    int more;
} key_list;

static void add_key(key_list *l, const char *key) {
    int n = snprintf(l->text + l->bytes, sizeof l->text - l->bytes, "%s%.40s", l->bytes ? ", " : "", key);
    if (n > 0 && (size_t)n < sizeof l->text - l->bytes)
        l->bytes += (size_t)n;
    else
        l->text[l->bytes] = 0, l->more++;
}

static void say(context *c, const key_list *l, const char *what, const char *hint) {
    char more[32] = "";
    if (l->more) snprintf(more, sizeof more, " and %d more", l->more);
    if (l->bytes) log_line(c, SHERF_LOG_WARNING, "%s: not read: %s%s%s", what, l->text, more, hint);
}

/* inner: what is read of it elsewhere. */
static void unread_of(const value *v, const value *inner, key_list *l) {
    if (v && v->kind == VALUE_RECORD) v = v->record.state;
    for (size_t i = 0; v && v->kind == VALUE_DICT && i < v->dict.count; i++) {
        const value *key = v->dict.pair[i].key;
        if (inner && value_unwrapped(v->dict.pair[i].item) == inner) continue;
        if (value_is_string(key, "rotations") && six_said(v)) continue;
        if (key->kind == VALUE_STRING && !is_part(key->string.text) && !is_idle(key->string.text))
            add_key(l, key->string.text);
    }
}

static bool same_numbers(const value *a, const value *b) {
    const int64_t n = value_numbers(a);
    if (n != value_numbers(b) || a->kind != VALUE_ARRAY || b->kind != VALUE_ARRAY) return false;
    for (int64_t i = 0; i < n; i++)
        if (!(fabs(value_array_number(a, i) - value_array_number(b, i)) < 1e-5)) return false;
    return true;
}

/* Another translation or root rotation in the same dict, with other numbers. */
static void second_warn(context *c, const value *v, const named_value *taken, const char *const *names,
                        const char *what) {
    if (!taken->item || value_get(v, taken->name) != taken->item) return;
    for (; *names; names++) {
        const value *other = value_get(v, *names);
        if (!strcmp(*names, taken->name) || value_numbers(other) < 1 || same_numbers(other, taken->item))
            continue;
        log_line(c, SHERF_LOG_WARNING, "%s: not read: %s, because %s is there too and is taken", what, *names,
                 taken->name);
    }
}

void body_parts_warn(context *c, const value *v, const char *what) {
    key_list l = {{0}, 0, 0};
    body_parts parts;
    v = value_unwrapped(v);
    body_parts_find(v, &parts);
    const named_value *part = parts.part;
    unread_of(inner_of(v), NULL, &l);
    unread_of(v, inner_of(v), &l);
    for (int i = 0; i < 2; i++) {
        const value *in = i ? v : inner_of(v);
        second_warn(c, in, &part[PART_PLACE], place_names, what);
        second_warn(c, in, &part[PART_ROOT], root_names, what);
    }
    const bool placed = part[PART_PLACE].item || part[PART_CAMERA_PLACE].item || part[PART_PELVIS].item;
    say(c, &l, what, placed ? "" : "; no translation is among what is (transl, Th, cam_t, ...)");
    if (!placed && part[PART_POSES].name && !strcmp(part[PART_POSES].name, "rotvec"))
        log_line(c, SHERF_LOG_WARNING,
                 "%s: no place is read: Multi-HMR's transl is its head's, transl_pelvis is needed", what);
    if (part[PART_BODY].item && !part[PART_POSES].item && !part[PART_ROOT].item && !part[PART_TURN].item)
        log_line(c, SHERF_LOG_WARNING,
                 "%s: %s without the root's rotation (global_orient, root_orient, ...): taken as not turned",
                 what, part[PART_BODY].name);
}

sherf_status keys_missing(context *c, const value *v, const char *what) {
    key_list l = {{0}, 0, 0};
    for (size_t i = 0; v && v->kind == VALUE_DICT && i < v->dict.count; i++)
        if (v->dict.pair[i].key->kind == VALUE_STRING) add_key(&l, v->dict.pair[i].key->string.text);
    return failure(c, SHERF_BAD_FILE, "%s%s%s", what, l.bytes ? "; this has " : "", l.text);
}

sherf_status body_parts_missing(context *c, const value *v) {
    v = value_unwrapped(v);
    if (v && v->kind == VALUE_DICT && v->dict.count == 1) { /* npz of one pickled dict */
        const value *only = value_unwrapped(v->dict.pair[0].item);
        if (only && only->kind == VALUE_DICT) v = only;
    }
    if (value_get(v, "mhr_model_params") || value_get(v, "body_pose_params"))
        return failure(
            c, SHERF_UNSUPPORTED,
            "SAM 3D Body's own body (MHR), not SMPL: convert it with its authors' MHR to SMPL tool");
    if (v && v->kind == VALUE_RECORD) v = v->record.state;
    return keys_missing(c, v, "a body needs poses (72 numbers) or body_pose (69)");
}

void unknown_keys_warn(context *c, const value *v, const char *const *known, const char *what) {
    key_list l = {{0}, 0, 0};
    for (size_t i = 0; v && v->kind == VALUE_DICT && i < v->dict.count; i++) {
        const value *key = v->dict.pair[i].key;
        if (key->kind == VALUE_STRING && !among(key->string.text, known)) add_key(&l, key->string.text);
    }
    say(c, &l, what, "");
}
