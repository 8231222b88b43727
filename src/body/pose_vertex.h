/* How a pose moves one vertex, for the CPU's loops (pose.c) and for GPU kernels: the same source, so both
 * give the same bits. Affine maps are 3 x 4, row-major. */
#ifndef SHERF_POSE_VERTEX_H
#define SHERF_POSE_VERTEX_H

#include <math.h>
#include <string.h>

#include "body/body.h"

HOST_AND_DEVICE static inline void affine_multiply(const double a[12], const double b[12], double out[12]) {
    for (int r = 0; r < 3; r++)
        for (int k = 0; k < 4; k++)
            out[4 * r + k] = a[4 * r] * b[k] + a[4 * r + 1] * b[4 + k] + a[4 * r + 2] * b[8 + k] +
                             (k == 3 ? a[4 * r + 3] : 0);
}

HOST_AND_DEVICE static inline bool affine_invert(const double a[12], double out[12]) {
    double c00 = a[5] * a[10] - a[6] * a[9], c01 = a[6] * a[8] - a[4] * a[10],
           c02 = a[4] * a[9] - a[5] * a[8];
    double det = a[0] * c00 + a[1] * c01 + a[2] * c02;
    if (!(fabs(det) > 1e-6)) return false; /* blended rotations have a determinant of at most 1 */
    double s = 1 / det;
    double m[9] = {c00 * s, (a[2] * a[9] - a[1] * a[10]) * s, (a[1] * a[6] - a[2] * a[5]) * s,
                   c01 * s, (a[0] * a[10] - a[2] * a[8]) * s, (a[2] * a[4] - a[0] * a[6]) * s,
                   c02 * s, (a[1] * a[8] - a[0] * a[9]) * s,  (a[0] * a[5] - a[1] * a[4]) * s};
    for (int r = 0; r < 3; r++) {
        memcpy(out + 4 * r, m + 3 * r, 3 * sizeof *m);
        out[4 * r + 3] = -(m[3 * r] * a[3] + m[3 * r + 1] * a[7] + m[3 * r + 2] * a[11]);
    }
    return true;
}

HOST_AND_DEVICE static inline void blend_transforms(const float *weights,
                                                    const double transform[BODY_JOINTS][12], double out[12]) {
    memset(out, 0, 12 * sizeof *out);
    for (int j = 0; j < BODY_JOINTS; j++) {
        double w = weights[j];
        if (w == 0) continue;
        for (int k = 0; k < 12; k++) out[k] += w * transform[j][k];
    }
}

/* Joints twisted against each other can blend to a singular matrix; then the heaviest joint's is used. */
HOST_AND_DEVICE static inline void blend_inverse(const float *weights,
                                                 const double transform[BODY_JOINTS][12],
                                                 const double blended[12], double out[12]) {
    if (affine_invert(blended, out)) return;
    int heaviest = 0;
    for (int j = 1; j < BODY_JOINTS; j++)
        if (weights[j] > weights[heaviest]) heaviest = j;
    affine_invert(transform[heaviest], out); /* a rotation: always invertible */
}

/* Axis r of vertex v's pose offset, from `offset` by removing the volume-preserving parts at bent joints
 * (body.h). weight: the vertex's row of pose_volume; feature: R(pose)[1:] - I. */
HOST_AND_DEVICE static inline float volume_kept(float offset, int r, const float *weight,
                                                const float *v_template,
                                                const double joint_template[BODY_JOINTS][3],
                                                const double *feature) {
    for (int j = 1; j < BODY_JOINTS; j++) {
        const double k = weight[j];
        const double *F = feature + 9 * (j - 1);
        if (k == 0) continue;
        double sum = 0;
        for (int i = 0; i < 3; i++) {
            const double p = (double)v_template[i] - joint_template[j][i];
            sum += 0.5 * (F[3 * r + i] + F[3 * i + r]) * p;
        }
        offset -= (float)(k * sum);
    }
    return offset;
}

HOST_AND_DEVICE static inline float shape_offset_of(const float *shapedirs, const float shape[BODY_SHAPES]) {
    double sum = 0;
    for (int b = 0; b < BODY_SHAPES; b++) sum += (double)shape[b] * shapedirs[b];
    return (float)sum;
}

/* A vertex in the posed body's own space: A (template + shape + pose offset). */
HOST_AND_DEVICE static inline void pose_vertex(const double A[12], const float *v_template,
                                               const float *shape, const float *pose, float out[3]) {
    double x[3];
    for (int k = 0; k < 3; k++) x[k] = (double)v_template[k] + shape[k] + pose[k];
    for (int k = 0; k < 3; k++)
        out[k] = (float)(A[4 * k] * x[0] + A[4 * k + 1] * x[1] + A[4 * k + 2] * x[2] + A[4 * k + 3]);
}

/* The maps of a vertex. With A the blended transform of this pose, B that of the big pose, o the offsets:
 *   to_canonical   x -> B (A^-1 x - o_pose - o_shape + o_pose,big)
 *   from_canonical x -> [R Th] A (B^-1 x - o_pose,big + o_shape + o_pose) */
HOST_AND_DEVICE static inline void vertex_to_canonical(const double A_inverse[12], const double B[12],
                                                       const float *big_offset, const float *pose,
                                                       const float *shape, float out[12]) {
    double to[12], shifted[12];
    memcpy(shifted, A_inverse, sizeof shifted);
    for (int k = 0; k < 3; k++) shifted[4 * k + 3] += (double)big_offset[k] - pose[k] - shape[k];
    affine_multiply(B, shifted, to);
    for (int k = 0; k < 12; k++) out[k] = (float)to[k];
}

HOST_AND_DEVICE static inline void vertex_from_canonical(const double A[12], const double B_inverse[12],
                                                         const double to_world[12], const float *big_offset,
                                                         const float *pose, const float *shape,
                                                         float out[12]) {
    double from[12], shifted[12];
    memcpy(shifted, B_inverse, sizeof shifted);
    for (int k = 0; k < 3; k++) shifted[4 * k + 3] -= (double)big_offset[k] - pose[k] - shape[k];
    affine_multiply(A, shifted, from);
    affine_multiply(to_world, from, shifted);
    for (int k = 0; k < 12; k++) out[k] = (float)shifted[k];
}

#endif
