/* Skin: how places of the canonical surface move with the joints. A place takes a blend of the weights and
 * offsets of its nearest canonical vertices, which changes without jumps; a frame takes only the nearest
 * one's. It keeps at most four joints, as other programs require. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "baked/skin.h"

/* ---- the nearest few vertices ---- */
typedef struct {
    const float *vertex;
    int cells[3];
    float min[3], cell_m;
    int32_t *start, *index; /* by cell */
} bins;

static int bin_along(const bins *b, int k, float x) {
    float at = (x - b->min[k]) / b->cell_m;
    return at > 0 ? at < (float)(b->cells[k] - 1) ? (int)at : b->cells[k] - 1 : 0;
}

static size_t bin_of(const bins *b, const float p[3]) {
    return ((size_t)bin_along(b, 2, p[2]) * (size_t)b->cells[1] + (size_t)bin_along(b, 1, p[1])) *
               (size_t)b->cells[0] +
           (size_t)bin_along(b, 0, p[0]);
}

static void bins_free(bins *b) {
    mem_free(b->start);
    mem_free(b->index);
}

static sherf_status bins_make(context *c, const body_model *body, bins *b) {
    enum { CELLS_MAX = 256 };
    float max[3], longest = 0;
    *b = (bins){.vertex = body->canonical->vertices_smpl};
    body_canonical_bounds(body, b->min, max);
    for (int k = 0; k < 3; k++) longest = fmaxf(longest, max[k] - b->min[k]);
    b->cell_m = fmaxf(0.03f, longest / CELLS_MAX);
    size_t count = 1;
    for (int k = 0; k < 3; k++) {
        b->cells[k] = (int)((max[k] - b->min[k]) / b->cell_m) + 1;
        count *= (size_t)b->cells[k];
    }
    b->start = mem_zero(c, count + 2, sizeof *b->start);
    b->index = mem_alloc(c, (size_t)body->vertices, sizeof *b->index);
    if (!b->start || !b->index) {
        bins_free(b);
        return SHERF_NO_MEMORY;
    }
    for (int32_t v = 0; v < body->vertices; v++) b->start[bin_of(b, b->vertex + 3 * v) + 2]++;
    for (size_t i = 0; i < count; i++) b->start[i + 2] += b->start[i + 1];
    for (int32_t v = 0; v < body->vertices; v++) b->index[b->start[bin_of(b, b->vertex + 3 * v) + 1]++] = v;
    return SHERF_OK;
}

/* Squared distances, ascending, and their vertices. */
typedef struct {
    int count;
    float d2[SKIN_NEAR + 1];
    int32_t index[SKIN_NEAR + 1];
} near_list;

static void near_add(near_list *l, float d2, int32_t index) {
    int at = l->count;
    if (at == SKIN_NEAR + 1 && d2 >= l->d2[at - 1]) return;
    if (at == SKIN_NEAR + 1) at--;
    for (; at && l->d2[at - 1] > d2; at--) l->d2[at] = l->d2[at - 1], l->index[at] = l->index[at - 1];
    l->d2[at] = d2;
    l->index[at] = index;
    if (l->count <= SKIN_NEAR) l->count++;
}

static void near_scan(const bins *b, const float p[3], int x, int y, int z, near_list *l) {
    size_t cell = ((size_t)z * (size_t)b->cells[1] + (size_t)y) * (size_t)b->cells[0] + (size_t)x;
    for (int32_t i = b->start[cell]; i < b->start[cell + 1]; i++) {
        const float *v = b->vertex + 3 * (size_t)b->index[i];
        float d2 = 0;
        for (int k = 0; k < 3; k++) d2 += (v[k] - p[k]) * (v[k] - p[k]);
        near_add(l, d2, b->index[i]);
    }
}

/* The SKIN_NEAR + 1 nearest vertices: cells in growing cubes about the point's own until none can be nearer.
 */
static void near_find(const bins *b, const float p[3], near_list *l) {
    int at[3], max = 0;
    float margin = INFINITY; /* from the point to the nearest side of its cell, negative outside the box */
    for (int k = 0; k < 3; k++) {
        at[k] = bin_along(b, k, p[k]);
        max = b->cells[k] > max ? b->cells[k] : max;
        float low = p[k] - (b->min[k] + b->cell_m * (float)at[k]);
        margin = fminf(margin, fminf(low, b->cell_m - low));
    }
    l->count = 0;
    for (int r = 0; r <= max; r++) {
        float reach = margin + b->cell_m * (float)(r - 1);
        if (l->count == SKIN_NEAR + 1 && reach > 0 && l->d2[SKIN_NEAR] <= reach * reach) return;
        for (int z = at[2] - r; z <= at[2] + r; z++)
            for (int y = at[1] - r; y <= at[1] + r; y++) {
                if (z < 0 || y < 0 || z >= b->cells[2] || y >= b->cells[1]) continue;
                bool side = abs(z - at[2]) == r || abs(y - at[1]) == r;
                for (int x = at[0] - r; x <= at[0] + r; x += side || !r ? 1 : 2 * r)
                    if (x >= 0 && x < b->cells[0]) near_scan(b, p, x, y, z, l);
            }
    }
}

/* ---- weights ---- */
typedef struct {
    const body_model *body;
    const bins *bins;
    const float *position;
    skin *s;
} skin_job;

/* Weights of the nearest vertices: (1 - d / d_last)^2, so that a vertex enters and leaves with weight 0. */
static void shares_of(const near_list *l, int32_t *index, float *share) {
    float sum = 0, last = sqrtf(l->d2[l->count - 1]);
    for (int i = 0; i < SKIN_NEAR; i++) {
        bool there = i < l->count;
        float x = there && last > 0 ? 1 - sqrtf(l->d2[i]) / last : 0;
        index[i] = there ? l->index[i] : 0;
        sum += share[i] = x * x;
    }
    if (!(sum > 0)) sum = share[0] = 1; /* all equally far */
    for (int i = 0; i < SKIN_NEAR; i++) share[i] /= sum;
}

/* The four heaviest joints, their weights summing to 1; joint 0 with weight 0 where there are fewer. */
static void heaviest(const double weight[BODY_JOINTS], uint8_t joint[4], float out[4]) {
    bool taken[BODY_JOINTS] = {false};
    double sum = 0, kept[4];
    for (int i = 0; i < 4; i++) {
        int best = -1;
        for (int j = 0; j < BODY_JOINTS; j++)
            if (!taken[j] && weight[j] > 1e-4 && (best < 0 || weight[j] > weight[best])) best = j;
        if (best >= 0) taken[best] = true;
        joint[i] = (uint8_t)(best < 0 ? 0 : best);
        sum += kept[i] = best < 0 ? 0 : weight[best];
    }
    for (int i = 0; i < 4; i++) out[i] = sum > 0 ? (float)(kept[i] / sum) : i == 0;
}

static void blend(const uint8_t joint[4], const float weight[4], const float transform[BODY_JOINTS][12],
                  double out[12]) {
    memset(out, 0, 12 * sizeof *out);
    for (int i = 0; i < 4; i++)
        for (int k = 0; k < 12 && weight[i] > 0; k++) out[k] += (double)weight[i] * transform[joint[i]][k];
}

/* The inverse of the linear part, times its determinant, which is positive for anything sensible. */
static double adjugate(const double a[12], double out[9]) {
    for (int r = 0; r < 3; r++)
        for (int k = 0; k < 3; k++) {
            int r1 = (k + 1) % 3, r2 = (k + 2) % 3, c1 = (r + 1) % 3, c2 = (r + 2) % 3;
            out[3 * r + k] = a[4 * r1 + c1] * a[4 * r2 + c2] - a[4 * r1 + c2] * a[4 * r2 + c1];
        }
    return a[0] * out[0] + a[1] * out[3] + a[2] * out[6];
}

static void skin_range(void *arg, int64_t begin, int64_t end, int thread) {
    const skin_job *job = arg;
    const body_model *body = job->body;
    skin *s = job->s;
    for (int64_t v = begin; v < end; v++) {
        near_list l;
        const float *p = job->position + 3 * v;
        int32_t *index = s->near + SKIN_NEAR * v;
        float *share = s->share + SKIN_NEAR * v;
        double weight[BODY_JOINTS] = {0}, B[12], inverse[9], x[3];
        near_find(job->bins, p, &l);
        shares_of(&l, index, share);
        for (int i = 0; i < SKIN_NEAR; i++)
            for (int j = 0; j < BODY_JOINTS && share[i] > 0; j++)
                weight[j] += (double)share[i] * body->weights[(size_t)index[i] * BODY_JOINTS + (size_t)j];
        heaviest(weight, s->joint + 4 * v, s->weight + 4 * v);
        blend(s->joint + 4 * v, s->weight + 4 * v, body->canonical->transform, B);
        double det = adjugate(B, inverse);
        if (!(fabs(det) > 1e-6)) { /* joints twisted against each other: only the heaviest is used */
            memcpy(s->weight + 4 * v, (float[]){1, 0, 0, 0}, 4 * sizeof(float));
            memset(s->joint + 4 * v + 1, 0, 3);
            blend(s->joint + 4 * v, s->weight + 4 * v, body->canonical->transform, B);
            det = adjugate(B, inverse);
        }
        for (int k = 0; k < 3; k++) x[k] = p[k] - B[4 * k + 3];
        for (int k = 0; k < 3; k++) {
            double rest = 0;
            for (int i = 0; i < 3; i++) rest += inverse[3 * k + i] / det * x[i];
            for (int i = 0; i < SKIN_NEAR; i++)
                rest -= (double)share[i] * body->canonical->pose_offset[3 * (size_t)index[i] + (size_t)k];
            s->rest[3 * v + k] = (float)rest;
        }
    }
}

void skin_free(skin *s) {
    mem_free(s->joint);
    mem_free(s->weight);
    mem_free(s->near);
    mem_free(s->share);
    mem_free(s->rest);
    *s = (skin){0};
}

sherf_status skin_make(context *c, const body_model *body, int64_t vertices, const float *positions_canonical,
                       skin *out) {
    const size_t V = (size_t)vertices;
    bins b;
    *out = (skin){.vertices = vertices};
    sherf_status status = bins_make(c, body, &b);
    if (status != SHERF_OK) return status;
    out->joint = mem_alloc(c, V, 4 * sizeof *out->joint);
    out->weight = mem_alloc(c, V, 4 * sizeof *out->weight);
    out->near = mem_alloc(c, V, SKIN_NEAR * sizeof *out->near);
    out->share = mem_alloc(c, V, SKIN_NEAR * sizeof *out->share);
    out->rest = mem_alloc(c, V, 3 * sizeof *out->rest);
    if (out->joint && out->weight && out->near && out->share && out->rest) {
        skin_job job = {body, &b, positions_canonical, out};
        parallel_for(c, vertices, 256, skin_range, &job);
    } else {
        status = SHERF_NO_MEMORY;
        skin_free(out);
    }
    bins_free(&b);
    return status;
}

/* ---- posing ---- */
typedef struct {
    const body_model *body;
    const skin *s;
    const posed_body *p;
    const float *normal;
    float *position_out, *normal_out;
} pose_job;

static void rotate_normal(const pose_job *job, int64_t v, const double A[12], float out[3]) {
    /* n turns with the inverse transpose of A B^-1, that is A^-T B^T, up to a positive factor */
    const skin *s = job->s;
    double B[12], inverse[9], y[3], x[3], length = 0;
    blend(s->joint + 4 * v, s->weight + 4 * v, job->body->canonical->transform, B);
    double det = adjugate(A, inverse);
    const float *n = job->normal + 3 * v;
    for (int k = 0; k < 3; k++) y[k] = B[k] * n[0] + B[4 + k] * n[1] + B[8 + k] * n[2];
    for (int k = 0; k < 3; k++) {
        x[k] = inverse[k] * y[0] + inverse[3 + k] * y[1] + inverse[6 + k] * y[2];
        if (det < 0) x[k] = -x[k];
    }
    for (int k = 0; k < 3; k++) {
        const float *R = job->p->R + 3 * k;
        y[k] = R[0] * x[0] + R[1] * x[1] + R[2] * x[2];
        length += y[k] * y[k];
    }
    length = sqrt(length);
    for (int k = 0; k < 3; k++) out[k] = length > 1e-12 ? (float)(y[k] / length) : n[k];
}

static void pose_range(void *arg, int64_t begin, int64_t end, int thread) {
    const pose_job *job = arg;
    const skin *s = job->s;
    const posed_body *p = job->p;
    for (int64_t v = begin; v < end; v++) {
        double A[12], x[3], y[3];
        blend(s->joint + 4 * v, s->weight + 4 * v, p->transform, A);
        for (int k = 0; k < 3; k++) {
            x[k] = s->rest[3 * v + k];
            for (int i = 0; i < SKIN_NEAR; i++) {
                size_t at = 3 * (size_t)s->near[SKIN_NEAR * v + i] + (size_t)k;
                x[k] +=
                    (double)s->share[SKIN_NEAR * v + i] * ((double)p->shape_offset[at] + p->pose_offset[at]);
            }
        }
        for (int k = 0; k < 3; k++)
            y[k] = A[4 * k] * x[0] + A[4 * k + 1] * x[1] + A[4 * k + 2] * x[2] + A[4 * k + 3];
        for (int k = 0; k < 3; k++)
            job->position_out[3 * v + k] =
                (float)(p->R[3 * k] * y[0] + p->R[3 * k + 1] * y[1] + p->R[3 * k + 2] * y[2] + p->Th[k]);
        if (job->normal) rotate_normal(job, v, A, job->normal_out + 3 * v);
    }
}

void skin_pose(const context *c, const body_model *body, const skin *s, const posed_body *p,
               const float *normals_canonical, float *positions_world, float *normals_world) {
    pose_job job = {body, s, p, normals_canonical, positions_world, normals_world};
    parallel_for(c, s->vertices, 1024, pose_range, &job);
}
