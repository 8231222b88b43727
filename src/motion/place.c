/* A clip's place: the up axis, the movement of the root, the start. */
#include <math.h>
#include <string.h>

#include "base/vector3.h"
#include "motion/motion.h"

/* p' = q p + shift, for every frame. */
static void move(clip *k, const float q[4], const double shift[3]) {
    for (int i = 0; i < k->frames; i++) {
        double p[3] = {k->pelvis_m[i][0], k->pelvis_m[i][1], k->pelvis_m[i][2]};
        quaternion_rotate(q, p, p);
        for (int a = 0; a < 3; a++) k->pelvis_m[i][a] = (float)(p[a] + shift[a]);
        quaternion_multiply(q, k->turn[i][0], k->turn[i][0]);
    }
}

void clip_upright(clip *k, sherf_up up) {
    static const double none[3];
    static const float z_to_y[4] = {0.70710678f, -0.70710678f, 0, 0}, over[4] = {0, 1, 0, 0};
    if (up == SHERF_UP_Z) move(k, z_to_y, none);
    if (up == SHERF_UP_MINUS_Y) move(k, over, none);
}

void clip_mean_up(const clip *k, double up[3]) {
    static const double own[3] = {0, 1, 0};
    up[0] = up[1] = up[2] = 0;
    for (int i = 0; i < k->frames; i++) {
        double v[3];
        quaternion_rotate(k->turn[i][0], own, v);
        for (int a = 0; a < 3; a++) up[a] += v[a] / k->frames;
    }
}

void clip_root(clip *k, const skeleton *s, sherf_root root) {
    static const double up[3] = {0, 1, 0};
    for (int i = 0; i < k->frames; i++) {
        if (root == SHERF_ROOT_DROPPED)
            for (int a = 0; a < 3; a += 2) k->pelvis_m[i][a] = k->pelvis_m[0][a];
        if (root == SHERF_ROOT_GROUNDED)
            k->pelvis_m[i][1] -= (float)skeleton_lowest(s, (const float(*)[4])k->turn[i], k->pelvis_m[i], up);
    }
}

/* ---- axes of a standing body ---- */

/* Columns of B: left = up x front, up, front orthogonalised to up. `spare` replaces a front parallel to up.
 */
static void axes_from(const double up[3], const double front[3], const double spare[3], double B[9]) {
    double f[3];
    const double *candidate[3] = {front, spare, (const double[3]){up[1], up[2], up[0]}};
    for (int n = 0; n < 3; n++) {
        double along = dot3(candidate[n], up), length = 0;
        for (int i = 0; i < 3; i++) f[i] = candidate[n][i] - along * up[i], length += f[i] * f[i];
        for (int i = 0; i < 3; i++) f[i] /= length > 0 ? sqrt(length) : 1;
        if (length > 1e-6) break;
    }
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        B[3 * i] = up[j] * f[k] - up[k] * f[j];
        B[3 * i + 1] = up[i];
        B[3 * i + 2] = f[i];
    }
}

/* The columns of a rotation as vectors. */
static void columns(const double R[9], double column[3][3]) {
    for (int i = 0; i < 9; i++) column[i % 3][i / 3] = R[i];
}

void pose_axes(const sherf_pose *pose, double B[9]) {
    double root[9], world[9], own[3][3], up[3];
    float R[9];
    rodrigues(pose->poses_rad, R);
    for (int i = 0; i < 9; i++) root[i] = R[i];
    for (int i = 0; i < 9; i++)
        world[i] = (double)pose->R[i / 3 * 3] * root[i % 3] +
                   (double)pose->R[i / 3 * 3 + 1] * root[3 + i % 3] +
                   (double)pose->R[i / 3 * 3 + 2] * root[6 + i % 3];
    columns(world, own);
    memcpy(up, own[1], sizeof up);
    for (int i = 0; i < 3; i++)
        if (fabs(own[1][i]) > cos(30 * M_PI / 180)) {
            double sign = own[1][i] > 0 ? 1 : -1;
            up[0] = up[1] = up[2] = 0;
            up[i] = sign;
            break;
        }
    const double behind[3] = {-own[1][0], -own[1][1], -own[1][2]};
    axes_from(up, own[2], behind, B);
}

void pose_to_turns(const sherf_pose *pose, const skeleton *s, float turn[BODY_JOINTS][4], float pelvis_m[3]) {
    double R[9];
    float world[4];
    for (int j = 0; j < BODY_JOINTS; j++) {
        double v[3];
        for (int k = 0; k < 3; k++) v[k] = pose->poses_rad[3 * j + k];
        quaternion_from_axis_angle(v, turn[j]);
    }
    for (int i = 0; i < 9; i++) R[i] = pose->R[i];
    quaternion_from_matrix(R, world);
    quaternion_multiply(world, turn[0], turn[0]);
    for (int i = 0; i < 3; i++) pelvis_m[i] = (float)(dot3(R + 3 * i, s->rest_m[0]) + pose->Th_m[i]);
}

void clip_start_at(clip *k, const skeleton *s, const sherf_pose *pose) {
    static const double y[3] = {0, 1, 0}, none[3];
    double to[9], from[9], A[9], root[9], own[3][3], up[3], shift[3];
    float turn[BODY_JOINTS][4], pelvis[3], q[4];
    pose_axes(pose, to);
    quaternion_to_matrix(k->turn[0][0], root);
    columns(root, own);
    const double behind[3] = {-own[1][0], -own[1][1], -own[1][2]};
    axes_from(y, own[2], behind, from);
    for (int i = 0; i < 9; i++) A[i] = dot3(to + i / 3 * 3, from + i % 3 * 3); /* to from^T */
    for (int i = 0; i < 3; i++) up[i] = to[3 * i + 1];
    quaternion_from_matrix(A, q);
    move(k, q, none);
    pose_to_turns(pose, s, turn, pelvis);
    /* The same place on the ground, and the same ground: aligns the lowest parts along up. */
    double rise = skeleton_lowest(s, (const float(*)[4])turn, pelvis, up) -
                  skeleton_lowest(s, (const float(*)[4])k->turn[0], k->pelvis_m[0], up);
    double across[3], along = 0;
    for (int i = 0; i < 3; i++) across[i] = (double)pelvis[i] - k->pelvis_m[0][i];
    along = dot3(across, up);
    for (int i = 0; i < 3; i++) shift[i] = across[i] + (rise - along) * up[i];
    move(k, (const float[4]){1, 0, 0, 0}, shift);
}
