/* Retargeting: a joint takes the whole rotation of the file's joint, after the bone at rest was turned to
 * where the file's rest pose has it. Bone directions then agree; twist is the file's. */
#include <ctype.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "data/bvh_body.h"

/* Names in small letters; what is not a letter or digit is left out, as is the prefix of Mixamo. Several may
 * be meant: "a|b". Of limbs the left one's, "left..." or "l...", from which the right one's follows. */
enum { TORSO_JOINTS = 6, LIMB_JOINTS = 9 };
static const int8_t torso_joint[TORSO_JOINTS] = {0, 3, 6, 9, 12, 15},
                    limb_joint[LIMB_JOINTS] = {1, 4, 7, 10, 13, 16, 18, 20, 22};
/* thigh, shin, foot, toes, collar, upper arm, forearm, hand, fingers: by bones, and by joints */
static const char *const limbs_bones[LIMB_JOINTS] = {
    "leftupleg|leftthigh",      "leftleg|leftshin", "leftfoot",
    "lefttoebase|lefttoe",      "leftshoulder",     "leftarm|leftupperarm",
    "leftforearm|leftlowerarm", "lefthand",         ""};
static const char *const limbs_joints[LIMB_JOINTS] = {
    "lhip|lefthip",           "lknee|leftknee",     "lankle|leftankle",
    "lfoot|leftfoot|lefttoe", "lcollar|leftcollar", "lshoulder|leftshoulder",
    "lelbow|leftelbow",       "lwrist|leftwrist",   "lhand|lefthand"};
static const struct {
    const char *names, *torso[TORSO_JOINTS];
    const char *const *limbs;
} family[] = {
    {"CMU", {"hips", "lowerback", "spine", "spine1", "neck1", "head"}, limbs_bones},
    {"Mixamo", {"hips", "spine", "spine1", "spine2", "neck", "head"}, limbs_bones},
    {"SMPL", {"pelvis", "spine1", "spine2", "spine3", "neck", "head"}, limbs_joints},
    {"Poser", {"hips|hip", "ab|abdomen", "", "chest", "neck", "head"}, limbs_joints},
};

/* Bones whose direction at rest differs between skeletons, and where they end. */
static const int8_t bone_end[BODY_JOINTS] = {
    [1] = 4, [2] = 5, [4] = 7, [5] = 8, [16] = 18, [17] = 19, [18] = 20, [19] = 21};
static const int8_t needed[] = {0, 1, 2, 4, 5, 16, 17, 18, 19};
static const int8_t parent[BODY_JOINTS] = {-1, 0, 0, 0,  1,  2,  3,  4,  5,  6,  7,  8,
                                           9,  9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21};

static void plain_name(const char *name, char out[BVH_NAME]) {
    const char *colon = strrchr(name, ':');
    size_t n = 0;
    for (name = colon ? colon + 1 : name; *name; name++)
        if (isalnum((unsigned char)*name)) out[n++] = (char)tolower((unsigned char)*name);
    out[n] = 0;
}

/* Whether `name` is one of "a|b"; on the right side with the side's letter or word exchanged. */
static bool name_is(const char *name, const char *wanted, bool right) {
    char side[BVH_NAME + 8];
    if (right) {
        if (!strncmp(name, "right", 5))
            snprintf(side, sizeof side, "left%s", name + 5);
        else if (*name == 'r')
            snprintf(side, sizeof side, "l%s", name + 1);
        else
            return false;
        name = side;
    }
    for (size_t n = strlen(name); *wanted; wanted += *wanted == '|') {
        size_t length = strcspn(wanted, "|");
        if (length == n && !memcmp(name, wanted, n)) return true;
        wanted += length;
    }
    return false;
}

static int find_named(const bvh *b, const char *wanted, bool right) {
    for (int i = 0; i < b->joints; i++) {
        char name[BVH_NAME];
        plain_name(b->joint[i].name, name);
        if (*name && name_is(name, wanted, right)) return i;
    }
    return -1;
}

static int match_family(const bvh *b, size_t f, int joint[BODY_JOINTS]) {
    int found = 0;
    for (int j = 0; j < BODY_JOINTS; j++) joint[j] = -1;
    for (int i = 0; i < TORSO_JOINTS; i++) joint[torso_joint[i]] = find_named(b, family[f].torso[i], false);
    for (int i = 0; i < 2 * LIMB_JOINTS; i++)
        joint[limb_joint[i / 2] + i % 2] = find_named(b, family[f].limbs[i / 2], i % 2);
    for (int j = 0; j < BODY_JOINTS; j++) found += joint[j] >= 0;
    return found;
}

static void rest_position(const bvh *b, int joint, double out[3]) {
    out[0] = out[1] = out[2] = 0;
    for (; joint >= 0; joint = b->joint[joint].parent)
        for (int k = 0; k < 3; k++) out[k] += b->joint[joint].offset[k];
}

static bool unit_vector(const double from[3], const double to[3], double out[3]) {
    double length = 0;
    for (int k = 0; k < 3; k++) out[k] = to[k] - from[k], length += out[k] * out[k];
    length = sqrt(length);
    for (int k = 0; k < 3; k++) out[k] /= length > 0 ? length : 1;
    return length > 0;
}

/* The smallest rotation that takes the unit vector a to b: 1 + [v] + [v]^2 / (1 + a b), v = a x b. */
static void smallest_rotation(const double a[3], const double b[3], double R[9]) {
    double v[3], c = 1;
    for (int k = 0; k < 3; k++) {
        v[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
        c += a[k] * b[k];
    }
    if (c < 1e-6) return; /* opposite: no smallest one; the file is odd */
    double x[9] = {0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0};
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            double square = 0;
            for (int n = 0; n < 3; n++) square += x[3 * i + n] * x[3 * n + k];
            R[3 * i + k] = (i == k) + x[3 * i + k] + square / c;
        }
}

/* The file's rest pose may stand on other axes (z up, or facing x): G takes the body's left, up and front to
 * the axes nearest to the file's left (hip to hip) and up (hips to shoulders). */
static void rest_axes(const bvh *b, const int joint[BODY_JOINTS], double G[9]) {
    double at[4][3], left[3], up[3];
    static const int8_t of[4] = {1, 2, 16, 17};
    int x = 0, y = 0;
    for (int i = 0; i < 4; i++) rest_position(b, joint[of[i]], at[i]);
    for (int k = 0; k < 3; k++) {
        left[k] = at[0][k] - at[1][k];
        up[k] = at[2][k] + at[3][k] - at[0][k] - at[1][k];
        if (fabs(left[k]) > fabs(left[x])) x = k;
        if (fabs(up[k]) > fabs(up[y])) y = k;
    }
    memset(G, 0, 9 * sizeof *G);
    if (x == y) x = 0, y = 1, left[0] = up[1] = 1; /* nothing to go by */
    int z = 3 - x - y;
    double sx = left[x] < 0 ? -1 : 1, sy = up[y] < 0 ? -1 : 1;
    G[3 * x] = sx;
    G[3 * y + 1] = sy;
    G[3 * z + 2] = ((y - x + 3) % 3 == 1 ? 1 : -1) * sx * sy; /* left x up = front */
}

sherf_status bvh_body_match(context *c, const bvh *b, const float joints_rest[BODY_JOINTS][3],
                            bvh_body *out) {
    int best = 0, joint[BODY_JOINTS];
    memset(out, 0, sizeof *out);
    for (size_t f = 0; f < COUNT_OF(family); f++) {
        int found = match_family(b, f, joint);
        if (found <= best) continue;
        best = found;
        out->names = family[f].names;
        memcpy(out->joint, joint, sizeof joint);
    }
    for (size_t i = 0; i < COUNT_OF(needed); i++)
        if (!best || out->joint[needed[i]] < 0)
            return failure(c, SHERF_UNSUPPORTED,
                           "joints are not named as by CMU, Mixamo, Poser or SMPL exporters");
    double G[9];
    rest_axes(b, out->joint, G);
    for (int j = 0; j < BODY_JOINTS; j++) {
        double *A = out->align[j], own[3], end[3], mine[3], theirs[3], turned[3];
        memcpy(A, G, sizeof G);
        int to = bone_end[j];
        if (j == 20 || j == 21) memcpy(A, out->align[j - 2], sizeof out->align[j]); /* hands as forearms */
        if (!to || out->joint[to] < 0) continue;
        rest_position(b, out->joint[j], own);
        rest_position(b, out->joint[to], end);
        if (!unit_vector(own, end, theirs)) continue;
        for (int k = 0; k < 3; k++) own[k] = joints_rest[j][k], end[k] = joints_rest[to][k];
        if (!unit_vector(own, end, mine)) continue;
        for (int k = 0; k < 3; k++)
            turned[k] = G[3 * k] * mine[0] + G[3 * k + 1] * mine[1] + G[3 * k + 2] * mine[2];
        double bend[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
        smallest_rotation(turned, theirs, bend);
        for (int i = 0; i < 9; i++)
            A[i] = bend[i / 3 * 3] * G[i % 3] + bend[i / 3 * 3 + 1] * G[3 + i % 3] +
                   bend[i / 3 * 3 + 2] * G[6 + i % 3];
    }
    return SHERF_OK;
}

void bvh_body_pose(const bvh *b, const bvh_body *map, int frame, float pose_rad[72]) {
    double global[BVH_JOINTS_MAX * 9], body[BODY_JOINTS][9];
    bvh_rotations(b, frame, NULL, global);
    for (int j = 0; j < BODY_JOINTS; j++) {
        float local[9];
        if (map->joint[j] < 0) { /* as its parent; the root is always there */
            memcpy(body[j], body[parent[j]], sizeof body[j]);
        } else {
            const double *Q = global + 9 * map->joint[j], *A = map->align[j];
            for (int i = 0; i < 9; i++)
                body[j][i] = Q[i / 3 * 3] * A[i % 3] + Q[i / 3 * 3 + 1] * A[3 + i % 3] +
                             Q[i / 3 * 3 + 2] * A[6 + i % 3];
        }
        for (int i = 0; i < 9; i++) {
            double sum = body[j][i];
            if (j) {
                const double *P = body[parent[j]];
                sum = 0;
                for (int n = 0; n < 3; n++) sum += P[3 * n + i / 3] * body[j][3 * n + i % 3];
            }
            local[i] = (float)sum;
        }
        rotation_to_axis_angle(local, pose_rad + 3 * j);
    }
}
