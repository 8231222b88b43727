/* Posing a body: blend shapes, joint transforms, skinning, and the per-vertex maps between its spaces. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "body/body.h"

/* ---- rotations ---- */
static void rodrigues_double(const float axis_angle_rad[3], double R[9]) {
    double x = axis_angle_rad[0], y = axis_angle_rad[1], z = axis_angle_rad[2];
    double angle = sqrt(x * x + y * y + z * z), s = sin(angle), t = 1 - cos(angle);
    if (angle > 0) x /= angle, y /= angle, z /= angle;
    const double out[9] = {1 - t * (y * y + z * z), t * x * y - s * z,       t * x * z + s * y,
                           t * x * y + s * z,       1 - t * (x * x + z * z), t * y * z - s * x,
                           t * x * z - s * y,       t * y * z + s * x,       1 - t * (x * x + y * y)};
    memcpy(R, out, sizeof out);
}

void rodrigues(const float axis_angle_rad[3], float R[9]) {
    double wide[9];
    rodrigues_double(axis_angle_rad, wide);
    for (int i = 0; i < 9; i++) R[i] = (float)wide[i];
}

/* Through the quaternion whose largest component is found first, so that angles near pi stay exact. */
void rotation_to_axis_angle(const float R[9], float axis_angle_rad[3]) {
    double trace = (double)R[0] + R[4] + R[8], q[4]; /* w x y z, times some positive number */
    if (trace > R[0] && trace > R[4] && trace > R[8]) {
        q[0] = 1 + trace;
        q[1] = (double)R[7] - R[5], q[2] = (double)R[2] - R[6], q[3] = (double)R[3] - R[1];
    } else {
        int i = R[4] > R[0] ? 1 : 0;
        if (R[8] > R[4 * i]) i = 2;
        int j = (i + 1) % 3, k = (i + 2) % 3;
        q[0] = (double)R[3 * k + j] - R[3 * j + k];
        q[1 + i] = 1 + (double)R[4 * i] - R[4 * j] - R[4 * k];
        q[1 + j] = (double)R[3 * i + j] + R[3 * j + i];
        q[1 + k] = (double)R[3 * i + k] + R[3 * k + i];
    }
    double sine = sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    double sign = q[0] < 0 ? -1 : 1, angle = 2 * atan2(sine, sign * q[0]);
    /* sine is 0 for the identity; the limit of angle / sine is 2 / |q| then */
    double scale = sine > 0 ? sign * angle / sine : 0;
    for (int k = 0; k < 3; k++) axis_angle_rad[k] = (float)(scale * q[1 + k]);
}

/* ---- 3 x 4 affine maps in double ---- */
static void affine_multiply(const double a[12], const double b[12], double out[12]) {
    for (int r = 0; r < 3; r++)
        for (int k = 0; k < 4; k++)
            out[4 * r + k] = a[4 * r] * b[k] + a[4 * r + 1] * b[4 + k] + a[4 * r + 2] * b[8 + k] +
                             (k == 3 ? a[4 * r + 3] : 0);
}

static bool affine_invert(const double a[12], double out[12]) {
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

static void blend(const float *weights, double transform[BODY_JOINTS][12], double out[12]) {
    memset(out, 0, 12 * sizeof *out);
    for (int j = 0; j < BODY_JOINTS; j++) {
        double w = weights[j];
        if (w == 0) continue;
        for (int k = 0; k < 12; k++) out[k] += w * transform[j][k];
    }
}

/* Joints twisted against each other can blend to a singular matrix: then the heaviest joint alone. */
static void blend_inverse(const float *weights, double transform[BODY_JOINTS][12], const double blended[12],
                          double out[12]) {
    if (affine_invert(blended, out)) return;
    int heaviest = 0;
    for (int j = 1; j < BODY_JOINTS; j++)
        if (weights[j] > weights[heaviest]) heaviest = j;
    affine_invert(transform[heaviest], out); /* a rotation: always has one */
}

/* ---- posing ---- */
typedef struct {
    const body_model *m;
    posed_body *p;
    double feature[BODY_POSE_FEATURES];
    double transform[BODY_JOINTS][12], to_world[12];
    float shape[BODY_SHAPES];
} pose_job;

/* The offsets that keep volume, see body.h. */
static void add_volume(const pose_job *job, size_t begin, size_t end) {
    const body_model *m = job->m;
    for (size_t v = begin / 3; v < end / 3; v++)
        for (size_t j = 1; j < BODY_JOINTS; j++) {
            double k = m->pose_volume[v * BODY_JOINTS + j];
            const double *F = job->feature + 9 * (j - 1);
            if (k == 0) continue;
            double p[3];
            for (int i = 0; i < 3; i++) p[i] = (double)m->v_template[3 * v + i] - m->joint_template[j][i];
            for (int r = 0; r < 3; r++) {
                double sum = 0;
                for (int i = 0; i < 3; i++) sum += 0.5 * (F[3 * r + i] + F[3 * i + r]) * p[i];
                job->p->pose_offset[3 * v + r] -= (float)(k * sum);
            }
        }
}

/* Rows (vertex, axis) [begin, end): pose blend shapes, streaming each feature once per block. */
static void add_blend_shapes(const pose_job *job, size_t begin, size_t end) {
    const body_model *m = job->m;
    size_t rows = 3 * (size_t)m->vertices;
    float *pose = job->p->pose_offset, *shape = job->p->shape_offset;
    memset(pose + begin, 0, (end - begin) * sizeof *pose);
    for (size_t k = 0; k < BODY_POSE_FEATURES && m->posedirs; k++) {
        float f = (float)job->feature[k];
        const float *dir = m->posedirs + k * rows;
        if (f == 0) continue;
        for (size_t i = begin; i < end; i++) pose[i] += f * dir[i];
    }
    if (m->pose_volume) add_volume(job, begin, end);
    for (size_t i = begin; i < end; i++) {
        double sum = 0;
        for (size_t b = 0; b < BODY_SHAPES; b++)
            sum += (double)job->shape[b] * m->shapedirs[i * BODY_SHAPES + b];
        shape[i] = (float)sum;
    }
}

/* The maps of vertex v. With A the blended transform of this pose, B that of the big pose, o the offsets:
 *   to_canonical   x -> B (A^-1 x - o_pose - o_shape + o_pose,big)
 *   from_canonical x -> [R Th] A (B^-1 x - o_pose,big + o_shape + o_pose) */
static void make_maps(const pose_job *job, size_t v, const double A[12], const double A_inverse[12],
                      const float *big_offset) {
    posed_body *p = job->p;
    const double *B = job->m->canonical_blend + 12 * v, *B_inverse = job->m->canonical_inverse + 12 * v;
    double to[12], from[12], shifted[12];
    memcpy(shifted, A_inverse, sizeof shifted);
    for (int k = 0; k < 3; k++)
        shifted[4 * k + 3] += (double)big_offset[k] - p->pose_offset[3 * v + k] - p->shape_offset[3 * v + k];
    affine_multiply(B, shifted, to);
    memcpy(shifted, B_inverse, sizeof shifted);
    for (int k = 0; k < 3; k++)
        shifted[4 * k + 3] -= (double)big_offset[k] - p->pose_offset[3 * v + k] - p->shape_offset[3 * v + k];
    affine_multiply(A, shifted, from);
    affine_multiply(job->to_world, from, shifted);
    for (int k = 0; k < 12; k++) {
        p->to_canonical[12 * v + k] = (float)to[k];
        p->from_canonical[12 * v + k] = (float)shifted[k];
    }
}

static void pose_vertices(void *arg, int64_t begin, int64_t end, int thread) {
    enum { BLOCK = 256 };
    pose_job *job = arg;
    const body_model *m = job->m;
    posed_body *p = job->p;
    for (int64_t b = begin; b < end; b += BLOCK) {
        int64_t stop = b + BLOCK < end ? b + BLOCK : end;
        add_blend_shapes(job, 3 * (size_t)b, 3 * (size_t)stop);
        for (size_t v = (size_t)b; v < (size_t)stop; v++) {
            const float *weights = m->weights + v * BODY_JOINTS;
            double A[12], A_inverse[12], x[3];
            blend(weights, job->transform, A);
            for (size_t k = 0; k < 3; k++)
                x[k] =
                    (double)m->v_template[3 * v + k] + p->shape_offset[3 * v + k] + p->pose_offset[3 * v + k];
            for (size_t k = 0; k < 3; k++)
                p->vertices_smpl[3 * v + k] =
                    (float)(A[4 * k] * x[0] + A[4 * k + 1] * x[1] + A[4 * k + 2] * x[2] + A[4 * k + 3]);
            blend_inverse(weights, job->transform, A, A_inverse);
            if (!m->canonical) { /* this is the canonical body itself */
                memcpy(m->canonical_blend + 12 * v, A, sizeof A);
                memcpy(m->canonical_inverse + 12 * v, A_inverse, sizeof A_inverse);
            }
            make_maps(job, v, A, A_inverse, (m->canonical ? m->canonical : p)->pose_offset + 3 * v);
        }
    }
}

/* A_k: the chain of rotations about the joints, relative to the rest pose. */
static void pose_joints(pose_job *job, const float pose_rad[72]) {
    const body_model *m = job->m;
    posed_body *p = job->p;
    double rest[BODY_JOINTS][3], global[BODY_JOINTS][12];
    for (int j = 0; j < BODY_JOINTS; j++) {
        int parent = m->parent[j];
        double R[9], local[12];
        for (int k = 0; k < 3; k++) {
            rest[j][k] = m->joint_template[j][k];
            for (int b = 0; b < BODY_SHAPES; b++) rest[j][k] += job->shape[b] * m->joint_shape[j][k][b];
        }
        rodrigues_double(pose_rad + 3 * j, R);
        for (int k = 0; k < 9 && j > 0; k++) job->feature[9 * (j - 1) + k] = R[k] - (k % 4 == 0);
        for (int k = 0; k < 3; k++) {
            memcpy(local + 4 * k, R + 3 * k, 3 * sizeof *R);
            local[4 * k + 3] = rest[j][k] - (parent >= 0 ? rest[parent][k] : 0);
        }
        if (parent >= 0)
            affine_multiply(global[parent], local, global[j]);
        else
            memcpy(global[j], local, sizeof local);
        double *A = job->transform[j];
        memcpy(A, global[j], sizeof local);
        for (int k = 0; k < 3; k++)
            A[4 * k + 3] -= A[4 * k] * rest[j][0] + A[4 * k + 1] * rest[j][1] + A[4 * k + 2] * rest[j][2];
        for (int k = 0; k < 12; k++) p->transform[j][k] = (float)A[k];
        for (int k = 0; k < 3; k++) {
            p->joints_rest[j][k] = (float)rest[j][k];
            p->joints_smpl[j][k] = (float)global[j][4 * k + 3];
        }
    }
}

static sherf_status check_pose(context *c, const float pose_rad[72], const float shape[10], const float R[9],
                               const float Th[3]) {
    for (int i = 0; i < 72; i++)
        if (!isfinite(pose_rad[i]))
            return failure(c, SHERF_BAD_ARGUMENT, "pose: rotation of joint %d is not finite", i / 3);
    for (int i = 0; i < BODY_SHAPES; i++)
        if (!isfinite(shape[i])) return failure(c, SHERF_BAD_ARGUMENT, "pose: shape %d is not finite", i);
    for (int i = 0; i < 3; i++)
        if (!isfinite(Th[i])) return failure(c, SHERF_BAD_ARGUMENT, "pose: translation Th is not finite");
    if (!rotation_is_valid(R))
        return failure(c, SHERF_BAD_ARGUMENT, "pose: R is not a rotation (rows of length 1 at right angles)");
    return SHERF_OK;
}

bool rotation_is_valid(const float R[9]) {
    for (int r = 0; r < 3; r++)
        for (int s = 0; s <= r; s++) {
            double dot = (double)R[3 * r] * R[3 * s] + (double)R[3 * r + 1] * R[3 * s + 1] +
                         (double)R[3 * r + 2] * R[3 * s + 2];
            if (!(fabs(dot - (r == s)) < 1e-2)) return false; /* also when not finite */
        }
    double det = R[0] * ((double)R[4] * R[8] - (double)R[5] * R[7]) -
                 R[1] * ((double)R[3] * R[8] - (double)R[5] * R[6]) +
                 R[2] * ((double)R[3] * R[7] - (double)R[4] * R[6]);
    return det > 0;
}

/* Box of the vertices; false where one is not finite (huge inputs overflow). */
static bool bounds_of(const posed_body *p, size_t vertices, float min[3], float max[3]) {
    for (size_t k = 0; k < 3; k++) min[k] = FLT_MAX, max[k] = -FLT_MAX;
    bool finite = true;
    for (size_t i = 0; i < 3 * vertices; i += 3)
        for (size_t k = 0; k < 3; k++) {
            float x = p->vertices_smpl[i + k];
            finite &= fabsf(x) < 1e6f;
            min[k] = x < min[k] ? x : min[k];
            max[k] = x > max[k] ? x : max[k];
        }
    return finite;
}

sherf_status posed_body_create(context *c, const body_model *m, const float pose_rad[72],
                               const float shape[10], const float R[9], const float Th[3], posed_body **out) {
    *out = NULL;
    sherf_status status = check_pose(c, pose_rad, shape, R, Th);
    if (status != SHERF_OK) return status;
    size_t n = (size_t)m->vertices;
    status = SHERF_NO_MEMORY;
    pose_job *job = mem_zero(c, 1, sizeof *job);
    posed_body *p = mem_zero(c, 1, sizeof *p);
    if (!job || !p) goto fail;
    p->vertices_smpl = mem_alloc(c, 3 * n, sizeof *p->vertices_smpl);
    p->pose_offset = mem_alloc(c, 3 * n, sizeof *p->pose_offset);
    p->shape_offset = mem_alloc(c, 3 * n, sizeof *p->shape_offset);
    p->to_canonical = mem_alloc(c, 12 * n, sizeof *p->to_canonical);
    p->from_canonical = mem_alloc(c, 12 * n, sizeof *p->from_canonical);
    if (!p->vertices_smpl || !p->pose_offset || !p->shape_offset || !p->to_canonical || !p->from_canonical)
        goto fail;
    job->m = m;
    job->p = p;
    memcpy(job->shape, shape, sizeof job->shape);
    memcpy(p->R, R, sizeof p->R);
    memcpy(p->Th, Th, sizeof p->Th);
    for (int r = 0; r < 3; r++) {
        for (int k = 0; k < 3; k++) job->to_world[4 * r + k] = R[3 * r + k];
        job->to_world[4 * r + 3] = Th[r];
    }
    pose_joints(job, pose_rad);
    parallel_for(c, m->vertices, 1024, pose_vertices, job);
    if (!bounds_of(p, n, p->min_smpl, p->max_smpl)) {
        status = failure(c, SHERF_BAD_ARGUMENT, "pose: shapes or pose put a vertex beyond 1000 km");
        goto fail;
    }
    mem_free(job);
    *out = p;
    return SHERF_OK;
fail:
    mem_free(job);
    posed_body_free(p);
    return status;
}

void posed_body_free(posed_body *p) {
    if (!p) return;
    mem_free(p->vertices_smpl);
    mem_free(p->pose_offset);
    mem_free(p->shape_offset);
    mem_free(p->to_canonical);
    mem_free(p->from_canonical);
    vertex_grid_free(p->near);
    mem_free(p);
}

void body_vertices_world(const body_model *m, const posed_body *p, float *vertices_world) {
    for (size_t v = 0; v < (size_t)m->vertices; v++) {
        const float *x = p->vertices_smpl + 3 * v;
        float y[3];
        for (int k = 0; k < 3; k++)
            y[k] = p->R[3 * k] * x[0] + p->R[3 * k + 1] * x[1] + p->R[3 * k + 2] * x[2] + p->Th[k];
        memcpy(vertices_world + 3 * v, y, sizeof y);
    }
}
