/* Retargeting: a joint takes the whole rotation of the file's joint, after the bone at rest was turned to
 * where the file's rest pose has it. Bone directions then agree; twist is the file's. */
#include <ctype.h>
#include <math.h>
#include <string.h>

#include "data/bvh_body.h"

/* Small letters; what is not a letter or digit is left out, as is the prefix of Mixamo. */
static const struct {
    const char *names, *joint[BODY_JOINTS];
} family[] = {
    {"CMU",
     {"hips",
      "leftupleg",
      "rightupleg",
      "lowerback",
      "leftleg",
      "rightleg",
      "spine",
      "leftfoot",
      "rightfoot",
      "spine1",
      "lefttoebase",
      "righttoebase",
      "neck1",
      "leftshoulder",
      "rightshoulder",
      "head",
      "leftarm",
      "rightarm",
      "leftforearm",
      "rightforearm",
      "lefthand",
      "righthand",
      "",
      ""}},
    {"Mixamo",
     {"hips",
      "leftupleg",
      "rightupleg",
      "spine",
      "leftleg",
      "rightleg",
      "spine1",
      "leftfoot",
      "rightfoot",
      "spine2",
      "lefttoebase",
      "righttoebase",
      "neck",
      "leftshoulder",
      "rightshoulder",
      "head",
      "leftarm",
      "rightarm",
      "leftforearm",
      "rightforearm",
      "lefthand",
      "righthand",
      "",
      ""}},
    {"SMPL", {"pelvis",    "lhip",      "rhip",   "spine1", "lknee",  "rknee",   "spine2",  "lankle",
              "rankle",    "spine3",    "lfoot",  "rfoot",  "neck",   "lcollar", "rcollar", "head",
              "lshoulder", "rshoulder", "lelbow", "relbow", "lwrist", "rwrist",  "lhand",   "rhand"}},
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

static int match_family(const bvh *b, size_t f, int joint[BODY_JOINTS]) {
    int found = 0;
    for (int j = 0; j < BODY_JOINTS; j++) {
        joint[j] = -1;
        for (int i = 0; i < b->joints && joint[j] < 0 && *family[f].joint[j]; i++) {
            char name[BVH_NAME];
            plain_name(b->joint[i].name, name);
            if (!strcmp(name, family[f].joint[j])) joint[j] = i;
        }
        found += joint[j] >= 0;
    }
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
            return failure(c, SHERF_UNSUPPORTED, "joints are not named as by CMU, Mixamo or SMPL exporters");
    for (int j = 0; j < BODY_JOINTS; j++) {
        double *A = out->align[j], own[3], end[3], mine[3], theirs[3];
        A[0] = A[4] = A[8] = 1;
        int to = bone_end[j];
        if (j == 20 || j == 21) memcpy(A, out->align[j - 2], sizeof out->align[j]); /* hands as forearms */
        if (!to || out->joint[to] < 0) continue;
        rest_position(b, out->joint[j], own);
        rest_position(b, out->joint[to], end);
        if (!unit_vector(own, end, theirs)) continue;
        for (int k = 0; k < 3; k++) own[k] = joints_rest[j][k], end[k] = joints_rest[to][k];
        if (unit_vector(own, end, mine)) smallest_rotation(mine, theirs, A);
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
