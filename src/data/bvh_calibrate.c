/* Rest poses that are not a person's. The rotation from the body's bones to the file's is then found joint by
 * joint: the bone's direction in the joint's own axes gives everything but the rotation about the bone, and
 * that rotation is chosen so that the bone is not twisted against its parent, on average over the frames.
 * Pelvis and chest, which carry several bones, need no frames. */
#include <math.h>
#include <string.h>

#include "base/vector3.h"
#include "data/bvh_body.h"

enum { FRAMES_MAX = 400, CARRIED_MAX = 3 };
/* Where a joint's bone ends; 0: it carries several, or none. */
static const int8_t bone_end[BODY_JOINTS] = {
    [1] = 4,   [2] = 5,   [3] = 6,   [4] = 7,   [5] = 8,   [6] = 9,   [7] = 10, [8] = 11,
    [12] = 15, [13] = 16, [14] = 17, [16] = 18, [17] = 19, [18] = 20, [19] = 21};
static const int8_t parent[BODY_JOINTS] = {-1, 0, 0, 0,  1,  2,  3,  4,  5,  6,  7,  8,
                                           9,  9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21};

typedef struct {
    const bvh *b;
    bvh_body *map;
    const float (*rest)[3];
    double (*global)[9]; /* frames x body's joints: the file's rotations of the joints matched */
    int frames;
} calibration;

static bool normalise(double v[3]) {
    const double length = sqrt(dot3(v, v));
    for (int k = 0; k < 3 && length > 1e-9; k++) v[k] /= length;
    return length > 1e-9;
}

/* out = a^T b; must alias neither. */
static void across(const double a[9], const double b[9], double out[9]) {
    for (int i = 0; i < 9; i++)
        out[i] = a[i / 3] * b[i % 3] + a[3 + i / 3] * b[3 + i % 3] + a[6 + i / 3] * b[6 + i % 3];
}

/* From one of the body's joints to another, in the body's rest pose. */
static bool own_bone(const calibration *k, int from, int to, double out[3]) {
    for (int i = 0; i < 3; i++) out[i] = (double)k->rest[to][i] - k->rest[from][i];
    return normalise(out);
}

/* The same for the file, in the axes of its joint `from`. */
static bool file_bone(const calibration *k, int from, int to, double out[3]) {
    out[0] = out[1] = out[2] = 0;
    for (int i = k->map->joint[to]; i >= 0 && i != k->map->joint[from]; i = k->b->joint[i].parent)
        for (int a = 0; a < 3; a++) out[a] += k->b->joint[i].offset[a];
    return k->map->joint[from] >= 0 && k->map->joint[to] >= 0 && normalise(out);
}

/* Rows of B: x, y orthogonalised to x, and z. */
static bool frame_of(const double x[3], const double y[3], double B[9]) {
    memcpy(B, x, 3 * sizeof *B);
    cross3(x, y, B + 6);
    if (!normalise(B) || !normalise(B + 6)) return false;
    cross3(B + 6, B, B + 3);
    return true;
}

/* To the nearest of the 24 rotations of a cube, if all axes are within 30 degrees of it. */
static void snap(double A[9]) {
    double cube[9] = {0};
    for (int i = 0; i < 9; i++)
        if (fabs(A[i]) > cos(30 * M_PI / 180)) cube[i] = A[i] > 0 ? 1 : -1;
    double sum = 0;
    for (int i = 0; i < 9; i++) sum += fabs(cube[i]);
    if (sum == 3) memcpy(A, cube, 9 * sizeof *A);
}

/* For a joint that carries a left, a right and a middle bone: uses the line from right to left, and the
 * middle bone. A rig's axes are those of the body, so nearly aligned ones are snapped. */
static bool align_carrier(calibration *k, int j, int left, int right, int middle) {
    double own_left[3], own_right[3], own_up[3], left_of[3], right_of[3], up_of[3], own[9], of[9],
        *A = k->map->align[j];
    if (!own_bone(k, j, left, own_left) || !own_bone(k, j, right, own_right) ||
        !own_bone(k, j, middle, own_up) || !file_bone(k, j, left, left_of) ||
        !file_bone(k, j, right, right_of) || !file_bone(k, j, middle, up_of))
        return false;
    for (int i = 0; i < 3; i++) own_left[i] -= own_right[i], left_of[i] -= right_of[i];
    if (!frame_of(own_left, own_up, own) || !frame_of(left_of, up_of, of)) return false;
    across(of, own, A);
    return true;
}

/* Some rotation that takes the unit vector a to b. */
static void any_rotation(const double a[3], const double b[3], double out[9]) {
    double spare[3] = {0}, own[9], to[9];
    int smallest = 0;
    for (int k = 1; k < 3; k++)
        if (fabs(a[k]) < fabs(a[smallest])) smallest = k;
    spare[smallest] = 1;
    frame_of(a, spare, own);
    spare[smallest] = 0, smallest = 0;
    for (int k = 1; k < 3; k++)
        if (fabs(b[k]) < fabs(b[smallest])) smallest = k;
    spare[smallest] = 1;
    frame_of(b, spare, to);
    across(to, own, out);
}

/* The nearest matched joint above, which is already aligned. */
static int joint_above(const calibration *k, int j) {
    for (j = parent[j]; j >= 0 && k->map->joint[j] < 0;) j = parent[j];
    return j;
}

/* Joint j relative to the one above in a frame, in the body's axes. */
static void local_of(const calibration *k, int frame, int j, int above, double out[9]) {
    double own[9], up[9];
    multiply3(k->global[(size_t)frame * BODY_JOINTS + (size_t)j], k->map->align[j], own);
    multiply3(k->global[(size_t)frame * BODY_JOINTS + (size_t)above], k->map->align[above], up);
    across(up, own, out);
}

/* The rotation about a bone along d that leaves no twist on average: each frame's twist is that of the
 * quaternion's part along d, and its weight decreases with the bone's swing. */
static double mean_twist(const calibration *k, int j, int above, const double d[3]) {
    double x = 0, y = 0;
    for (int i = 0; i < k->frames; i++) {
        double R[9];
        local_of(k, i, j, above, R);
        /* tan(twist / 2) = q_d / w, of w = (1 + trace) / 4w and q_d = antisymmetric part / 4w */
        const double w = 1 + R[0] + R[4] + R[8];
        const double along = d[0] * (R[7] - R[5]) + d[1] * (R[2] - R[6]) + d[2] * (R[3] - R[1]);
        const double twist = 2 * atan2(along, w), weight = hypot(along, w);
        x += weight * cos(twist), y += weight * sin(twist);
    }
    return x != 0 || y != 0 ? atan2(y, x) : 0;
}

static void turn_about(const double d[3], double angle, double R[9]) {
    const double c = cos(angle), s = sin(angle);
    for (int i = 0; i < 9; i++) R[i] = (1 - c) * d[i / 3] * d[i % 3] + (i % 4 == 0 ? c : 0);
    R[1] -= s * d[2], R[2] += s * d[1], R[3] += s * d[2];
    R[5] -= s * d[0], R[6] -= s * d[1], R[7] += s * d[0];
}

static bool align_bone(calibration *k, int j, int above) {
    double own[3], of[3], turn[9], first[9], *A = k->map->align[j];
    if (!bone_end[j] || !own_bone(k, j, bone_end[j], own) || !file_bone(k, j, bone_end[j], of)) return false;
    any_rotation(own, of, A);
    turn_about(own, -mean_twist(k, j, above, own), turn);
    memcpy(first, A, sizeof first);
    multiply3(first, turn, A);
    return true;
}

/* A joint without a bone: straight on average. The mean of rotations is the rotation nearest to their sum. */
static void align_end(calibration *k, int j, int above) {
    static const double unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    double sum[9] = {0}, B[9], *A = k->map->align[j];
    memcpy(A, unit, sizeof unit);
    for (int i = 0; i < k->frames; i++) {
        double up[9], R[9];
        multiply3(k->global[(size_t)i * BODY_JOINTS + (size_t)above], k->map->align[above], up);
        across(k->global[(size_t)i * BODY_JOINTS + (size_t)j], up, R);
        for (int a = 0; a < 9; a++) sum[a] += R[a];
    }
    double columns[9]; /* the sum's columns as rows, orthonormalised */
    for (int a = 0; a < 9; a++) columns[a] = sum[a % 3 * 3 + a / 3];
    if (!frame_of(columns, columns + 3, B)) return;
    for (int a = 0; a < 9; a++) A[a] = B[a % 3 * 3 + a / 3];
}

static sherf_status gather_frames(context *c, calibration *k) {
    k->frames = k->b->frames < FRAMES_MAX ? k->b->frames : FRAMES_MAX;
    k->global = mem_alloc(c, (size_t)k->frames * BODY_JOINTS, sizeof *k->global);
    if (!k->global) return SHERF_NO_MEMORY;
    for (int i = 0; i < k->frames; i++) {
        double all[BVH_JOINTS_MAX * 9];
        bvh_rotations(k->b, (int)((int64_t)i * k->b->frames / k->frames), NULL, all);
        for (int j = 0; j < BODY_JOINTS; j++)
            if (k->map->joint[j] >= 0)
                memcpy(k->global[(size_t)i * BODY_JOINTS + (size_t)j], all + 9 * k->map->joint[j],
                       sizeof *k->global);
    }
    return SHERF_OK;
}

sherf_status bvh_calibrate(context *c, const bvh *b, const float joints_rest[BODY_JOINTS][3], bvh_body *map) {
    calibration k = {.b = b, .map = map, .rest = joints_rest};
    const int up = map->joint[3] >= 0 ? 3 : map->joint[9] >= 0 ? 9 : map->joint[12] >= 0 ? 12 : 16;
    if (up == 16 || !align_carrier(&k, 0, 1, 2, up))
        return failure(
            c, SHERF_UNSUPPORTED,
            "the rest pose is none of a person, and its hips and spine do not tell which way it stands: "
            "export the motion with a rest pose that stands (a T-pose)");
    snap(map->align[0]); /* spines lean in any direction, but a rig's pelvis has the axes of the body */
    sherf_status status = gather_frames(c, &k);
    for (int j = 1; j < BODY_JOINTS && !status; j++) {
        if (map->joint[j] < 0) continue;
        const int above = joint_above(&k, j);
        const int left = map->joint[13] >= 0 ? 13 : 16, right = map->joint[14] >= 0 ? 14 : 17;
        const int neck = map->joint[12] >= 0 ? 12 : 15;
        const bool chest = j == (map->joint[9] >= 0 ? 9 : 3);
        if (chest && map->joint[neck] >= 0 && align_carrier(&k, j, left, right, neck)) continue;
        if (!align_bone(&k, j, above)) align_end(&k, j, above);
    }
    mem_free(k.global);
    return status;
}
