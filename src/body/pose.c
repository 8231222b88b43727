/* Posing a body: blend shapes, joint transforms, skinning, and the per-vertex maps between its spaces. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "body/pose_vertex.h"

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

/* Through the quaternion; starts with its largest component, so that angles near pi stay exact. */
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

/* ---- posing ---- */
typedef struct {
    const body_model *body;
    posed_body *p;
    joint_pose j;
} pose_job;

/* Adds the volume-preserving offsets, see body.h. */
static void add_volume(const pose_job *job, size_t begin, size_t end) {
    const body_model *body = job->body;
    for (size_t i = begin; i < end; i++)
        job->p->pose_offset[i] =
            volume_kept(job->p->pose_offset[i], (int)(i % 3), body->pose_volume + i / 3 * BODY_JOINTS,
                        body->v_template + i / 3 * 3, body->joint_template, job->j.feature);
}

/* Rows (vertex, axis) [begin, end): pose blend shapes, streaming each feature once per block. */
static void add_blend_shapes(const pose_job *job, size_t begin, size_t end) {
    const body_model *body = job->body;
    size_t rows = 3 * (size_t)body->vertices;
    float *pose = job->p->pose_offset, *shape = job->p->shape_offset;
    memset(pose + begin, 0, (end - begin) * sizeof *pose);
    for (size_t k = 0; k < BODY_POSE_FEATURES && body->posedirs; k++) {
        float f = (float)job->j.feature[k];
        const float *dir = body->posedirs + k * rows;
        if (f == 0) continue;
        for (size_t i = begin; i < end; i++) pose[i] += f * dir[i];
    }
    if (body->pose_volume) add_volume(job, begin, end);
    for (size_t i = begin; i < end; i++)
        shape[i] = shape_offset_of(body->shapedirs + i * BODY_SHAPES, job->j.shape);
}

static void make_maps(const pose_job *job, size_t v, const double A[12], const double A_inverse[12],
                      const float *big_offset) {
    posed_body *p = job->p;
    const float *pose = p->pose_offset + 3 * v, *shape = p->shape_offset + 3 * v;
    vertex_to_canonical(A_inverse, job->body->canonical_blend + 12 * v, big_offset, pose, shape,
                        p->to_canonical + 12 * v);
    vertex_from_canonical(A, job->body->canonical_inverse + 12 * v, job->j.to_world, big_offset, pose, shape,
                          p->from_canonical + 12 * v);
}

static void pose_vertices(void *arg, int64_t begin, int64_t end, int thread) {
    enum { BLOCK = 256 };
    pose_job *job = arg;
    const body_model *body = job->body;
    posed_body *p = job->p;
    for (int64_t b = begin; b < end; b += BLOCK) {
        int64_t stop = b + BLOCK < end ? b + BLOCK : end;
        add_blend_shapes(job, 3 * (size_t)b, 3 * (size_t)stop);
        for (size_t v = (size_t)b; v < (size_t)stop; v++) {
            const float *weights = body->weights + v * BODY_JOINTS;
            double A[12], A_inverse[12];
            blend_transforms(weights, job->j.transform, A);
            pose_vertex(A, body->v_template + 3 * v, p->shape_offset + 3 * v, p->pose_offset + 3 * v,
                        p->vertices_smpl + 3 * v);
            blend_inverse(weights, job->j.transform, A, A_inverse);
            if (!body->canonical) { /* this is the canonical body itself */
                memcpy(body->canonical_blend + 12 * v, A, sizeof A);
                memcpy(body->canonical_inverse + 12 * v, A_inverse, sizeof A_inverse);
            }
            make_maps(job, v, A, A_inverse, (body->canonical ? body->canonical : p)->pose_offset + 3 * v);
        }
    }
}

/* A_k: the chain of rotations about the joints, relative to the rest pose. */
static void pose_joints(const body_model *body, const float pose_rad[72], joint_pose *job, posed_body *p) {
    double rest[BODY_JOINTS][3], global[BODY_JOINTS][12];
    for (int j = 0; j < BODY_JOINTS; j++) {
        int parent = body->parent[j];
        double R[9], local[12];
        for (int k = 0; k < 3; k++) {
            rest[j][k] = body->joint_template[j][k];
            for (int b = 0; b < BODY_SHAPES; b++) rest[j][k] += job->shape[b] * body->joint_shape[j][k][b];
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

static void joints_make(const body_model *body, const float pose_rad[72], const float shape[10],
                        const float R[9], const float Th[3], joint_pose *j, posed_body *p) {
    memcpy(j->shape, shape, sizeof j->shape);
    memcpy(j->pose_rad, pose_rad, sizeof j->pose_rad);
    memcpy(p->R, R, sizeof p->R);
    memcpy(p->Th, Th, sizeof p->Th);
    for (int r = 0; r < 3; r++) {
        for (int k = 0; k < 3; k++) j->to_world[4 * r + k] = R[3 * r + k];
        j->to_world[4 * r + 3] = Th[r];
    }
    pose_joints(body, pose_rad, j, p);
}

sherf_status posed_joints_create(context *c, const body_model *body, const float pose_rad[72],
                                 const float shape[10], const float R[9], const float Th[3],
                                 posed_body **out) {
    *out = NULL;
    sherf_status status = check_pose(c, pose_rad, shape, R, Th);
    if (status != SHERF_OK) return status;
    posed_body *p = mem_zero(c, 1, sizeof *p);
    if (p) p->joints = mem_zero(c, 1, sizeof *p->joints);
    if (!p || !p->joints) {
        mem_free(p);
        return SHERF_NO_MEMORY;
    }
    joints_make(body, pose_rad, shape, R, Th, p->joints, p);
    *out = p;
    return SHERF_OK;
}

sherf_status posed_body_create(context *c, const body_model *body, const float pose_rad[72],
                               const float shape[10], const float R[9], const float Th[3], posed_body **out) {
    *out = NULL;
    sherf_status status = check_pose(c, pose_rad, shape, R, Th);
    if (status != SHERF_OK) return status;
    size_t n = (size_t)body->vertices;
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
    p->isa = isa_best();
    job->body = body;
    job->p = p;
    joints_make(body, pose_rad, shape, R, Th, &job->j, p);
    parallel_for(c, body->vertices, 1024, pose_vertices, job);
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
    mem_free(p->read_from);
    mem_free(p->together);
    mem_free(p->seen);
    mem_free(p->joints);
    vertex_grid_free(p->near);
    mem_free(p);
}

void body_vertices_world(const body_model *body, const posed_body *p, float *vertices_world) {
    for (size_t v = 0; v < (size_t)body->vertices; v++) {
        const float *x = p->vertices_smpl + 3 * v;
        float y[3];
        for (int k = 0; k < 3; k++)
            y[k] = p->R[3 * k] * x[0] + p->R[3 * k + 1] * x[1] + p->R[3 * k + 2] * x[2] + p->Th[k];
        memcpy(vertices_world + 3 * v, y, sizeof y);
    }
}
