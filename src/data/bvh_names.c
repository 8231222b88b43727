/* Finds a rig's joints by the words in their names. Names are split into words (at blanks, points,
 * underscores and capitals), so that a rig's prefixes ("mixamorig", "Bip01", "DEF", "J_Bip") are ignored and
 * a side may be anywhere: LeftArm, l_uparm, thigh.L, Bip01 R Thigh. */
#include "data/bvh_names.h"

#include <ctype.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

enum { WORDS_MAX = 12, LIMB_JOINTS = 9 };
typedef enum { MIDDLE, LEFT, RIGHT } side;
static const int8_t limb_joint[LIMB_JOINTS] = {1, 4, 7, 10, 13, 16, 18, 20, 22}; /* the left ones */

/* The words of a name without its side, joined, in lower case. "a|b" means any of several. */
typedef struct {
    const char *whose;
    const char *limb[LIMB_JOINTS]; /* thigh, shin, foot, toes, collar, upper arm, forearm, hand, fingers */
} family;
static const family families[] = {
    {"a common rig",
     {"upleg|upperleg|thigh|thighbend|uleg|upperleg01", "leg|lowerleg01|lowerleg|lowleg|shin|calf|shank",
      "foot|ankle", "toebase|toe|toes|ball|toe0", "shoulder|clavicle|collar",
      "arm|upperarm|uparm|uarm|shldr|shldrbend|upperarm01",
      "forearm|lowerarm|lowarm|farm|forearmbend|lowerarm01", "hand|wrist", ""}},
    {"SOMA", {"leg", "shin", "foot", "toebase|toe|toes", "shoulder|clavicle", "arm", "forearm", "hand", ""}},
    {"SMPL",
     {"hip|buttock|thigh", "knee|shin", "ankle", "foot|toe|toes|toebase", "collar|clavicle", "shoulder|shldr",
      "elbow|forearm", "wrist", "hand"}},
    {"iPi", {"thigh", "shin", "foot", "toe", "clavicle", "shoulder", "forearm", "hand", ""}},
    {"ASF", {"femur", "tibia", "foot", "toes", "clavicle", "humerus", "radius", "wrist", "hand"}},
};
/* Rigs of the first family, recognised by a word that others use differently. */
static const struct {
    const char *shin, *arm, *forearm, *whose;
} rigs[] = {
    {"leg", "arm", "forearm", "Mixamo"},
    {"lowerleg", "upperarm", "lowerarm", "Unity or VRM"},
    {"calf", "upperarm", "lowerarm", "Unreal"},
    {"calf", "upperarm", "forearm", "Biped"},
    {"shin", "upperarm", "forearm", "Rigify"},
    {"shin", "uarm", "farm", "OptiTrack"},
    {"lowleg", "uparm", "lowarm", "MHR"},
    {"shin", "shldr", "forearm", "Poser"},
    {"shin", "shldrbend", "forearmbend", "DAZ"},
    {"shin", "arm", "forearm", "Rokoko"},
    {"lowerleg01", "upperarm01", "lowerarm01", "MakeHuman"},
};

static const int8_t needed[] = {1, 2, 4, 5, 16, 17, 18, 19}; /* they determine the pelvis */
static const char *const smpl_names[BODY_JOINTS] = {
    "pelvis",     "left_hip",    "right_hip",    "spine1",      "left_knee",     "right_knee",
    "spine2",     "left_ankle",  "right_ankle",  "spine3",      "left_foot",     "right_foot",
    "neck",       "left_collar", "right_collar", "head",        "left_shoulder", "right_shoulder",
    "left_elbow", "right_elbow", "left_wrist",   "right_wrist", "left_hand",     "right_hand"};

const char *joint_name(int j) {
    return smpl_names[j];
}

/* ---- a name's words ---- */

typedef struct {
    char text[BVH_NAME + WORDS_MAX]; /* small letters, a 0 after each word */
    uint8_t at[WORDS_MAX];
    int count;
} words;

/* Whether a word begins at name[i], which is a letter or digit. */
static bool begins(const char *name, size_t i) {
    if (!i || !isalnum((unsigned char)name[i - 1])) return true;
    if (!isupper((unsigned char)name[i])) return false;
    return !isupper((unsigned char)name[i - 1]) || islower((unsigned char)name[i + 1]);
}

static void words_of(const char *name, words *out) {
    size_t n = 0;
    const char *colon = strrchr(name, ':'), *bar = strrchr(name, '|'); /* namespaces, and paths of Maya's */
    if (colon) name = colon + 1;
    if (bar && bar + 1 > name) name = bar + 1;
    out->count = 0;
    for (size_t i = 0; name[i]; i++) {
        if (!isalnum((unsigned char)name[i])) continue;
        if (begins(name, i) && out->count < WORDS_MAX) {
            if (n) out->text[n++] = 0;
            out->at[out->count++] = (uint8_t)n;
        }
        out->text[n++] = (char)tolower((unsigned char)name[i]);
    }
    out->text[n] = 0;
}

static const char *word(const words *w, int i) {
    return w->text + w->at[i];
}

static side side_of(const char *text) {
    if (!strcmp(text, "left") || !strcmp(text, "l")) return LEFT;
    return !strcmp(text, "right") || !strcmp(text, "r") ? RIGHT : MIDDLE;
}

typedef struct {
    char key[BVH_NAME + 1];
    side side;
} plain_name;

/* Words that only mean a joint, a rig, or the middle. */
static bool is_filler(const char *text) {
    static const char *const filler[] = {"joint", "jnt", "bip", "c", "m", "x", "stretch"};
    for (size_t i = 0; i < COUNT_OF(filler); i++)
        if (!strcmp(text, filler[i])) return true;
    return false;
}

/* Removes the first `skip` words, sides and fillers. */
static void plain_of(const words *w, int skip, plain_name *out) {
    size_t n = 0;
    out->side = MIDDLE;
    for (int i = skip; i < w->count; i++) {
        const char *text = word(w, i);
        const side s = side_of(text);
        if (s != MIDDLE) out->side = s;
        if (s != MIDDLE || is_filler(text)) continue;
        n += (size_t)snprintf(out->key + n, sizeof out->key - n, "%s", text);
        if (n >= sizeof out->key) n = sizeof out->key - 1;
    }
    out->key[n] = 0;
}

/* The number of leading words that most names share: the rig's own. */
static int rig_words(const words *all, int count) {
    int skip = 0;
    for (; skip < WORDS_MAX; skip++) {
        int best = 0, named = 0;
        for (int i = 0; i < count; i++) named += all[i].count > 0;
        for (int i = 0; i < count && i < 64; i++) {
            int same = 0;
            if (all[i].count <= skip + 1 || side_of(word(&all[i], skip)) != MIDDLE) continue;
            for (int k = 0; k < count; k++)
                same += all[k].count > skip && !strcmp(word(&all[k], skip), word(&all[i], skip));
            if (same > best) best = same;
        }
        if (best * 10 < named * 8) break;
    }
    return skip;
}

static sherf_status plain_names(context *c, const bvh *b, plain_name **out) {
    words *all = mem_alloc(c, (size_t)b->joints, sizeof *all);
    *out = mem_alloc(c, (size_t)b->joints, sizeof **out);
    if (all && *out) {
        for (int i = 0; i < b->joints; i++) words_of(b->joint[i].name, &all[i]);
        const int skip = rig_words(all, b->joints);
        for (int i = 0; i < b->joints; i++) {
            /* names without the rig's words, among others that have them */
            const bool has = all[i].count > skip;
            plain_of(&all[i], has ? skip : 0, &(*out)[i]);
        }
    }
    const bool ok = all && *out;
    mem_free(all);
    return ok ? SHERF_OK : SHERF_NO_MEMORY;
}

/* ---- limbs ---- */

static bool is_one_of(const char *key, const char *wanted) {
    for (size_t n = strlen(key); *wanted && n; wanted += *wanted == '|') {
        const size_t length = strcspn(wanted, "|");
        if (length == n && !memcmp(key, wanted, n)) return true;
        wanted += length;
    }
    return false;
}

/* "lhip" and "rightknee" are single words: the side is the first letter or word. */
static bool name_is(const plain_name *name, const char *wanted, side s) {
    const char letter = s == LEFT ? 'l' : 'r', *whole = s == LEFT ? "left" : "right";
    if (name->side == s) return is_one_of(name->key, wanted);
    if (name->side != MIDDLE || name->key[0] != letter) return false;
    return is_one_of(name->key + 1, wanted) ||
           (!strncmp(name->key, whole, strlen(whole)) && is_one_of(name->key + strlen(whole), wanted));
}

static int find_named(const bvh *b, const plain_name *name, const char *wanted, side s) {
    for (int i = 0; i < b->joints; i++)
        if (!b->joint[i].end && name_is(&name[i], wanted, s)) return i;
    return -1;
}

/* ---- the trunk ---- */

static int depth_of(const bvh *b, int i) {
    int depth = 0;
    for (; i >= 0; i = b->joint[i].parent) depth++;
    return depth;
}

/* The lowest joint above both, or one of them itself. */
static int common_ancestor(const bvh *b, int i, int k) {
    if (i < 0 || k < 0) return i < 0 ? k : i;
    for (int di = depth_of(b, i), dk = depth_of(b, k); i != k;)
        if (di >= dk)
            i = b->joint[i].parent, di--;
        else
            k = b->joint[k].parent, dk--;
    return i;
}

static bool hangs_on(const bvh *b, int i, int on) {
    while (i >= 0 && i != on) i = b->joint[i].parent;
    return i == on && i >= 0;
}

static bool begins_with(const plain_name *name, const char *text) {
    return !strncmp(name->key, text, strlen(text));
}

static void match_trunk(const bvh *b, const plain_name *name, int joint[BODY_JOINTS]) {
    int chain[BVH_DEPTH_MAX], n = 0, head = -1;
    int chest = common_ancestor(b, joint[16], joint[17]);
    joint[0] = common_ancestor(b, common_ancestor(b, joint[1], joint[2]), chest);
    for (int i = 0; i < b->joints && head < 0; i++)
        if (!b->joint[i].end && name[i].side == MIDDLE && is_one_of(name[i].key, "head|head1|head01"))
            head = i;
    /* Biped's collars are children of the neck. */
    if (chest > 0 && begins_with(&name[chest], "neck") && b->joint[chest].parent >= 0)
        joint[12] = chest, chest = b->joint[chest].parent;
    for (int i = chest; i >= 0 && i != joint[0] && n < BVH_DEPTH_MAX; i = b->joint[i].parent) chain[n++] = i;
    if (n) joint[3] = chain[n - 1];
    if (n > 1) joint[9] = chain[0];
    if (n > 2) joint[6] = chain[n / 2];
    if (!hangs_on(b, head, chest)) return;
    joint[15] = head;
    if (joint[12] < 0 && b->joint[head].parent != chest) joint[12] = b->joint[head].parent;
}

/* A collar must be between the chest and the upper arm (a name may mean another joint). */
static void drop_stray_collars(const bvh *b, int joint[BODY_JOINTS]) {
    for (int j = 13; j <= 14; j++)
        if (joint[j] >= 0 && !hangs_on(b, joint[j + 3], joint[j])) joint[j] = -1;
}

/* ---- joints that no name identifies: found from the hierarchy ---- */

/* The only child of a joint; -1: none, or several. */
static int only_child(const bvh *b, int joint) {
    int found = -1;
    for (int i = 0; i < b->joints; i++) {
        if (b->joint[i].parent != joint || b->joint[i].end) continue;
        if (found >= 0) return -1;
        found = i;
    }
    return found;
}

/* The child of the chest that leads to an arm. */
static void place_collar(const bvh *b, int chest, int collar, int joint[BODY_JOINTS]) {
    int i = joint[collar + 3];
    if (joint[collar] >= 0 || !hangs_on(b, i, chest)) return;
    while (b->joint[i].parent != chest && i != chest) i = b->joint[i].parent;
    if (i != joint[collar + 3] && i != chest) joint[collar] = i;
}

/* Rigify's spine continues to the head: the longest chain from the chest without an arm. */
static void place_head(const bvh *b, const plain_name *name, int chest, int joint[BODY_JOINTS]) {
    int longest = 0, second = 0, neck = -1, head = -1;
    if (joint[15] >= 0) return;
    for (int i = 0; i < b->joints; i++) {
        if (b->joint[i].parent != chest || b->joint[i].end || name[i].side != MIDDLE) continue;
        if (hangs_on(b, joint[16], i) || hangs_on(b, joint[17], i)) continue;
        int end = i, length = 1;
        for (int next; (next = only_child(b, end)) >= 0; length++) end = next;
        if (length > longest)
            second = longest, longest = length, neck = i, head = end;
        else if (length > second)
            second = length;
    }
    if (!longest || longest == second) return;
    if (joint[12] < 0 && (neck != head || begins_with(&name[neck], "neck"))) joint[12] = neck;
    if (neck != head || joint[12] != neck) joint[15] = head;
}

static void place_nameless(const bvh *b, const plain_name *name, int joint[BODY_JOINTS]) {
    const int chest = common_ancestor(b, joint[16], joint[17]);
    for (int j = 10; j <= 11; j++)
        if (joint[j] < 0 && joint[j - 3] >= 0) joint[j] = only_child(b, joint[j - 3]);
    if (chest < 0) return;
    for (int j = 13; j <= 14; j++) place_collar(b, chest, j, joint);
    place_head(b, name, joint[12] >= 0 && joint[12] == chest ? b->joint[chest].parent : chest, joint);
}

/* ---- all of it ---- */

static int found_of(const int joint[BODY_JOINTS]) {
    int found = 0;
    for (int j = 0; j < BODY_JOINTS; j++) found += joint[j] >= 0;
    for (size_t i = 0; i < COUNT_OF(needed); i++)
        if (joint[needed[i]] < 0) found -= BODY_JOINTS;
    return found;
}

static void match_family(const bvh *b, const plain_name *name, const family *f, const int given[BODY_JOINTS],
                         int joint[BODY_JOINTS]) {
    for (int j = 0; j < BODY_JOINTS; j++) joint[j] = -1;
    for (int i = 0; i < 2 * LIMB_JOINTS; i++) {
        const int j = limb_joint[i / 2] + i % 2;
        joint[j] = given[j] >= 0 ? given[j] : find_named(b, name, f->limb[i / 2], i % 2 ? RIGHT : LEFT);
    }
    drop_stray_collars(b, joint);
    if (joint[1] >= 0 && joint[2] >= 0 && joint[16] >= 0 && joint[17] >= 0) match_trunk(b, name, joint);
    for (int j = 0; j < BODY_JOINTS; j++)
        if (given[j] >= 0) joint[j] = given[j];
}

static const char *rig_of(const bvh *b, const plain_name *name, const family *f,
                          const int joint[BODY_JOINTS]) {
    if (f != &families[0]) return f->whose;
    for (int i = 0; i < b->joints; i++)
        if (!strcmp(name[i].key, "lowerback")) return "CMU";
    for (size_t i = 0; i < COUNT_OF(rigs); i++)
        if (name_is(&name[joint[4]], rigs[i].shin, LEFT) && name_is(&name[joint[16]], rigs[i].arm, LEFT) &&
            name_is(&name[joint[18]], rigs[i].forearm, LEFT))
            return rigs[i].whose;
    return f->whose;
}

/* The joint that a text names; -1: none. */
static int smpl_joint(const value *text) {
    for (int j = 0; j < BODY_JOINTS; j++)
        if (value_is_string(text, smpl_names[j])) return j;
    return -1;
}

static sherf_status read_given(context *c, const bvh *b, const value *given, int joint[BODY_JOINTS]) {
    for (int j = 0; j < BODY_JOINTS; j++) joint[j] = -1;
    if (!given) return SHERF_OK;
    if (given->kind != VALUE_DICT)
        return failure(c, SHERF_BAD_FILE, "joints: a dict of SMPL's names and the file's is expected");
    for (size_t i = 0; i < given->dict.count; i++) {
        const value *smpl = given->dict.pair[i].key, *name = given->dict.pair[i].item;
        if (smpl_joint(smpl) < 0 && smpl_joint(name) >= 0) /* in the reverse order */
            smpl = given->dict.pair[i].item, name = given->dict.pair[i].key;
        const int j = smpl_joint(smpl);
        const char *text = name->kind == VALUE_STRING ? name->string.text : "";
        if (j < 0)
            return failure(c, SHERF_BAD_FILE, "joints: '%.60s' is no joint of SMPL (pelvis, left_hip, ...)",
                           smpl->kind == VALUE_STRING ? smpl->string.text : "");
        joint[j] = bvh_find(b, text);
        if (joint[j] < 0 || b->joint[joint[j]].end)
            return failure(c, SHERF_BAD_FILE, "joints: %s: the file has no joint '%.60s'", smpl_names[j],
                           text);
    }
    return SHERF_OK;
}

static sherf_status not_found(context *c, const bvh *b, const int joint[BODY_JOINTS]) {
    char missing[200] = "", some[240] = "";
    for (size_t i = 0; i < COUNT_OF(needed); i++)
        if (joint[needed[i]] < 0)
            snprintf(missing + strlen(missing), sizeof missing - strlen(missing), "%s%s",
                     *missing ? ", " : "", smpl_names[needed[i]]);
    for (int i = 0, n = 0; i < b->joints && n < 6; i++)
        if (!b->joint[i].end)
            snprintf(some + strlen(some), sizeof some - strlen(some), "%s%.30s", n++ ? ", " : "",
                     b->joint[i].name);
    return failure(c, SHERF_UNSUPPORTED,
                   "joints are named as by no rig that is known here: no %s among %s, ...; name them by "
                   "--joints map.json (docs/motion.md)",
                   missing, some);
}

sherf_status bvh_names_match(context *c, const bvh *b, const value *given, int joint[BODY_JOINTS],
                             const char **whose) {
    int wanted[BODY_JOINTS], now[BODY_JOINTS], best = 0;
    const family *taken = NULL;
    plain_name *name = NULL;
    *whose = given ? "the map" : NULL;
    sherf_status status = read_given(c, b, given, wanted);
    if (status) return status;
    status = plain_names(c, b, &name);
    for (size_t f = 0; f < COUNT_OF(families) && !status; f++) {
        match_family(b, name, &families[f], wanted, now);
        const int found = found_of(now);
        if (taken && found <= best) continue;
        taken = &families[f], best = found;
        memcpy(joint, now, sizeof now);
    }
    if (!status && best < 0) status = not_found(c, b, joint);
    if (!status) place_nameless(b, name, joint);
    if (!status && !given) *whose = rig_of(b, name, taken, joint);
    mem_free(name);
    return status;
}
