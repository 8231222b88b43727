/* Retargeting. A joint takes the whole rotation of the file's joint, after the body's bone at rest was turned
 * to its direction in the file's rest pose. Bone directions then agree, and the twist is the file's. For
 * files whose rest pose is not a person's, see bvh_calibrate.c. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/vector3.h"
#include "data/bvh_body.h"

/* Bones whose rest direction differs between skeletons, and the joints where they end. */
static const int8_t bone_end[BODY_JOINTS] = {
    [1] = 4, [2] = 5, [4] = 7, [5] = 8, [16] = 18, [17] = 19, [18] = 20, [19] = 21};
static const int8_t parent[BODY_JOINTS] = {-1, 0, 0, 0,  1,  2,  3,  4,  5,  6,  7,  8,
                                           9,  9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21};

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

/* Rows: left orthogonalised to up, up, front. false: there is none. */
static bool standing_frame(const double left[3], const double up[3], double F[9]) {
    static const double none[3];
    double across[3], along = 0;
    if (!unit_vector(none, up, F + 3)) return false;
    for (int k = 0; k < 3; k++) along += left[k] * F[3 + k];
    for (int k = 0; k < 3; k++) across[k] = left[k] - along * F[3 + k];
    if (!unit_vector(none, across, F)) return false;
    for (int k = 0; k < 3; k++)
        F[6 + k] = F[(k + 1) % 3] * F[3 + (k + 2) % 3] - F[(k + 2) % 3] * F[3 + (k + 1) % 3];
    return true;
}

/* A rest pose that faces between two axes, by more than 30 degrees: G takes the body's own frame to it. */
static bool turned_axes(const double left[3], const double up[3], const float rest[BODY_JOINTS][3],
                        double G[9]) {
    double own_left[3], own_up[3], own[9], theirs[9], near = 1;
    for (int k = 0; k < 3; k++) {
        own_left[k] = (double)rest[1][k] - rest[2][k];
        own_up[k] = (double)rest[16][k] + rest[17][k] - rest[1][k] - rest[2][k];
    }
    if (!standing_frame(left, up, theirs) || !standing_frame(own_left, own_up, own)) return false;
    for (int i = 0; i < 2; i++)
        near = fmin(near, fmax(fabs(theirs[3 * i]), fmax(fabs(theirs[3 * i + 1]), fabs(theirs[3 * i + 2]))));
    if (near > cos(30 * M_PI / 180)) return false;
    for (int i = 0; i < 9; i++)
        G[i] = theirs[i / 3] * own[i % 3] + theirs[3 + i / 3] * own[3 + i % 3] +
               theirs[6 + i / 3] * own[6 + i % 3];
    return true;
}

/* The file's rest pose may use other axes (z up, or facing x): G takes the body's left, up and front to the
 * axes nearest to the file's left (hip to hip) and up (hips to shoulders). */
static void rest_axes(const bvh *b, const int joint[BODY_JOINTS], const float rest[BODY_JOINTS][3],
                      double G[9]) {
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
    if (turned_axes(left, up, rest, G)) return;
    memset(G, 0, 9 * sizeof *G);
    if (x == y) x = 0, y = 1, left[0] = up[1] = 1; /* no direction is known */
    int z = 3 - x - y;
    double sx = left[x] < 0 ? -1 : 1, sy = up[y] < 0 ? -1 : 1;
    G[3 * x] = sx;
    G[3 * y + 1] = sy;
    G[3 * z + 2] = ((y - x + 3) % 3 == 1 ? 1 : -1) * sx * sy; /* left x up = front */
}

/* Directions of a bone in the body's rest pose, turned by G, and in the file's; false: one has no length. */
static bool bone_directions(const bvh *b, const bvh_body *map, const float rest[BODY_JOINTS][3],
                            const double G[9], int from, int to, double mine[3], double theirs[3]) {
    double own[3], end[3], straight[3];
    rest_position(b, map->joint[from], own);
    rest_position(b, map->joint[to], end);
    if (!unit_vector(own, end, theirs)) return false;
    for (int k = 0; k < 3; k++) own[k] = rest[from][k], end[k] = rest[to][k];
    if (!unit_vector(own, end, straight)) return false;
    for (int k = 0; k < 3; k++)
        mine[k] = G[3 * k] * straight[0] + G[3 * k + 1] * straight[1] + G[3 * k + 2] * straight[2];
    return true;
}

/* A standing rest pose: turns each bone the shortest way to the file's direction. */
static void align_standing(const bvh *b, bvh_body *map, const float rest[BODY_JOINTS][3], const double G[9]) {
    for (int j = 0; j < BODY_JOINTS; j++) {
        double *A = map->align[j], mine[3], theirs[3];
        const int to = bone_end[j];
        memcpy(A, G, 9 * sizeof *A);
        if (j == 20 || j == 21) memcpy(A, map->align[j - 2], 9 * sizeof *A); /* hands as forearms */
        if (!to || map->joint[to] < 0 || map->joint[j] < 0) continue;
        if (!bone_directions(b, map, rest, G, j, to, mine, theirs)) continue;
        double bend[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
        smallest_rotation(mine, theirs, bend);
        multiply3(bend, G, A);
    }
}

/* Whether pelvis and chest have the body's axes: the lines of collars and shoulders within 60 degrees of the
 * hips', the first bone of the spine within 75 of straight up, the neck within 90. */
static bool trunk_stands(const bvh *b, const bvh_body *map, const float rest[BODY_JOINTS][3],
                         const double G[9]) {
    static const int8_t bones[][2] = {{2, 1}, {17, 16}, {14, 13}, {0, 3}, {9, 12}};
    static const double least[] = {0.5, 0.5, 0.5, 0.26, 0};
    for (size_t i = 0; i < COUNT_OF(bones); i++) {
        double mine[3], theirs[3];
        const int from = bones[i][0], to = bones[i][1];
        if (map->joint[from] < 0 || map->joint[to] < 0) continue;
        if (!bone_directions(b, map, rest, G, from, to, mine, theirs)) continue;
        if (dot3(mine, theirs) < least[i]) return false;
    }
    return true;
}

/* Whether legs hang within 60 degrees of straight down, and arms point within 110 of sideways. */
static bool limbs_stand(const bvh *b, const bvh_body *map, const float rest[BODY_JOINTS][3],
                        const double G[9]) {
    static const int8_t bones[] = {1, 2, 4, 5, 16, 17, 18, 19};
    for (size_t i = 0; i < COUNT_OF(bones); i++) {
        double mine[3], theirs[3];
        const int j = bones[i], to = bone_end[j];
        if (map->joint[to] < 0 || !bone_directions(b, map, rest, G, j, to, mine, theirs)) continue;
        const double along = dot3(mine, theirs);
        if (along < (j < 16 ? 0.5 : -0.34)) return false;
    }
    return true;
}

sherf_status bvh_body_match(context *c, const bvh *b, const value *given,
                            const float joints_rest[BODY_JOINTS][3], bvh_body *out) {
    memset(out, 0, sizeof *out);
    sherf_status status = bvh_names_match(c, b, given, out->joint, &out->names);
    if (status) return status;
    double G[9];
    rest_axes(b, out->joint, joints_rest, G);
    out->calibrated = !limbs_stand(b, out, joints_rest, G) || !trunk_stands(b, out, joints_rest, G);
    if (out->calibrated) return bvh_calibrate(c, b, joints_rest, out);
    align_standing(b, out, joints_rest, G);
    return SHERF_OK;
}

void bvh_body_pose(const bvh *b, const bvh_body *map, int frame, float pose_rad[72]) {
    double global[BVH_JOINTS_MAX * 9], body[BODY_JOINTS][9];
    bvh_rotations(b, frame, NULL, global);
    for (int j = 0; j < BODY_JOINTS; j++) {
        float local[9];
        if (map->joint[j] < 0) { /* same as its parent; the root always exists */
            memcpy(body[j], body[parent[j]], sizeof body[j]);
        } else {
            const double *Q = global + 9 * map->joint[j], *A = map->align[j];
            multiply3(Q, A, body[j]);
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
