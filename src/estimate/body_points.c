/* Skinning of chosen points with its derivatives. With w_j a point's weights, u its place in the rest pose,
 * R_j and g_j a joint's rotation and place, J_j its place at rest: x = sum_j w_j (R_j (u - J_j) + g_j) A turn
 * of joint k by a small vector o moves what hangs on it: dx = o x sum_{j below k} w_j (R_j (u - J_j) + g_j -
 * g_k), so one sum from the leaves to the root gives all joints at once. */
#include "estimate/body_points.h"

#include <math.h>
#include <string.h>

#include "base/vector3.h"

typedef struct {
    double rest[3], shape[3][BODY_SHAPES], weight[BODY_JOINTS];
    double kept[BODY_JOINTS]; /* pose_volume's k, see body.h */
} point_data;

struct body_points {
    const body_model *body;
    int count;
    point_data *point;
    float *posedirs; /* count x 207 x 3; NULL: none */
    bool volume;
};

/* The quantities shared by all points. */
typedef struct {
    double local[BODY_JOINTS][9];     /* R of each joint about its parent */
    double change[BODY_JOINTS][3][9]; /* its derivative by each component */
    double global[BODY_JOINTS][9], rest[BODY_JOINTS][3], place[BODY_JOINTS][3];
    double axis[BODY_JOINTS][9];                     /* columns: o for each component of bend */
    double place_shape[BODY_JOINTS][3][BODY_SHAPES]; /* d g_j - R_j d J_j: the joint's derivative by shape */
    double feature[BODY_JOINTS][9];                  /* R - I */
} chain;

void rotation_exp(const double w[3], double R[9], double jacobian[9]) {
    double t2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2], t = sqrt(t2);
    /* sin t / t, (1 - cos t) / t^2, (t - sin t) / t^3, by series where they would cancel */
    double a = t > 1e-2 ? sin(t) / t : 1 - t2 / 6 * (1 - t2 / 20);
    double b = t > 1e-2 ? (1 - cos(t)) / t2 : 0.5 - t2 / 24 * (1 - t2 / 30);
    double d = t > 1e-2 ? (t - sin(t)) / (t2 * t) : 1. / 6 - t2 / 120 * (1 - t2 / 42);
    const double K[9] = {0, -w[2], w[1], w[2], 0, -w[0], -w[1], w[0], 0};
    for (int i = 0; i < 9; i++) {
        double KK = w[i / 3] * w[i % 3] - (i % 4 == 0 ? t2 : 0), one = i % 4 == 0;
        R[i] = one + a * K[i] + b * KK;
        if (jacobian) jacobian[i] = one + b * K[i] + d * KK;
    }
}

void body_state_move(const body_state *s, const double *step, body_state *out) {
    double R[9];
    if (out != s) *out = *s;
    rotation_exp(step + BODY_TURN, R, NULL);
    multiply3(R, out->root, out->root);
    for (int j = 1; j < BODY_JOINTS; j++)
        for (int k = 0; k < 3; k++) out->bend[j][k] += step[BODY_BEND + 3 * (j - 1) + k];
    for (int b = 0; b < BODY_SHAPES; b++) out->shape[b] += step[BODY_SHAPE + b];
    for (int k = 0; k < 3; k++) out->pelvis_m[k] += step[BODY_SHIFT + k];
}

/* ---- choosing ---- */

static void take_vertex(const body_model *body, size_t v, point_data *p, float *posedirs) {
    double sum = 0;
    for (int k = 0; k < 3; k++) {
        p->rest[k] = (double)body->v_template[3 * v + (size_t)k];
        for (int b = 0; b < BODY_SHAPES; b++)
            p->shape[k][b] = (double)body->shapedirs[(3 * v + (size_t)k) * BODY_SHAPES + (size_t)b];
    }
    for (int j = 0; j < BODY_JOINTS; j++) {
        sum += p->weight[j] = (double)body->weights[v * BODY_JOINTS + (size_t)j];
        if (body->pose_volume) p->kept[j] = (double)body->pose_volume[v * BODY_JOINTS + (size_t)j];
    }
    for (int j = 0; j < BODY_JOINTS; j++) p->weight[j] /= sum;
    for (size_t f = 0; f < BODY_POSE_FEATURES && posedirs; f++)
        for (size_t k = 0; k < 3; k++)
            posedirs[3 * f + k] = body->posedirs[(f * (size_t)body->vertices + v) * 3 + k];
}

sherf_status body_points_create(context *c, const body_model *body, int count, const body_point *point,
                                body_points **out) {
    *out = NULL;
    for (int i = 0; i < count; i++)
        if (point[i].vertex >= body->vertices ||
            (point[i].vertex < 0 && (point[i].joint < 0 || point[i].joint >= BODY_JOINTS)))
            return failure(c, SHERF_BAD_ARGUMENT, "body: no vertex %d or joint %d", point[i].vertex,
                           point[i].joint);
    body_points *p = mem_zero(c, 1, sizeof *p);
    if (!p) return SHERF_NO_MEMORY;
    p->body = body;
    p->count = count;
    p->volume = body->pose_volume != NULL;
    p->point = mem_zero(c, (size_t)count, sizeof *p->point);
    if (body->posedirs)
        p->posedirs = mem_zero(c, (size_t)count, 3 * BODY_POSE_FEATURES * sizeof *p->posedirs);
    if (!p->point || (body->posedirs && !p->posedirs)) {
        body_points_free(p);
        return SHERF_NO_MEMORY;
    }
    for (int i = 0; i < count; i++) {
        point_data *q = &p->point[i];
        if (point[i].vertex >= 0) {
            take_vertex(body, (size_t)point[i].vertex, q,
                        p->posedirs ? p->posedirs + (size_t)i * 3 * BODY_POSE_FEATURES : NULL);
            continue;
        }
        int j = point[i].joint;
        for (int k = 0; k < 3; k++) q->rest[k] = body->joint_template[j][k] + point[i].offset_m[k];
        memcpy(q->shape, body->joint_shape[j], sizeof q->shape);
        q->weight[j] = 1;
    }
    *out = p;
    return SHERF_OK;
}

void body_points_free(body_points *p) {
    if (!p) return;
    mem_free(p->point);
    mem_free(p->posedirs);
    mem_free(p);
}

int body_points_count(const body_points *p) {
    return p->count;
}

/* ---- joints ---- */

static void chain_turns(const body_model *body, const body_state *s, chain *t) {
    for (int j = 0; j < BODY_JOINTS; j++) {
        int parent = body->parent[j];
        double J[9];
        for (int k = 0; k < 3; k++) {
            t->rest[j][k] = body->joint_template[j][k];
            for (int b = 0; b < BODY_SHAPES; b++) t->rest[j][k] += s->shape[b] * body->joint_shape[j][k][b];
        }
        if (parent < 0) {
            memcpy(t->global[j], s->root, sizeof t->global[j]);
            memcpy(t->place[j], s->pelvis_m, sizeof t->place[j]);
            continue;
        }
        rotation_exp(s->bend[j], t->local[j], J);
        multiply3(t->global[parent], t->local[j], t->global[j]);
        multiply3(t->global[parent], J, t->axis[j]);
        for (int i = 0; i < 9; i++) t->feature[j][i] = t->local[j][i] - (i % 4 == 0);
        for (int i = 0; i < 3; i++) { /* d local = [J e_i]x local */
            const double o[3] = {J[i], J[3 + i], J[6 + i]};
            const double K[9] = {0, -o[2], o[1], o[2], 0, -o[0], -o[1], o[0], 0};
            multiply3(K, t->local[j], t->change[j][i]);
        }
        const double bone[3] = {t->rest[j][0] - t->rest[parent][0], t->rest[j][1] - t->rest[parent][1],
                                t->rest[j][2] - t->rest[parent][2]};
        rotate3(t->global[parent], bone, t->place[j]);
        for (int k = 0; k < 3; k++) t->place[j][k] += t->place[parent][k];
    }
}

static void chain_shapes(const body_model *body, chain *t) {
    double moved[BODY_JOINTS][3][BODY_SHAPES] = {0}; /* d g_j */
    for (int j = 0; j < BODY_JOINTS; j++) {
        int parent = body->parent[j];
        for (int b = 0; b < BODY_SHAPES; b++) {
            double bone[3],
                own[3] = {body->joint_shape[j][0][b], body->joint_shape[j][1][b], body->joint_shape[j][2][b]};
            if (parent >= 0) {
                for (int k = 0; k < 3; k++) bone[k] = own[k] - body->joint_shape[parent][k][b];
                rotate3(t->global[parent], bone, bone);
                for (int k = 0; k < 3; k++) moved[j][k][b] = moved[parent][k][b] + bone[k];
            }
            rotate3(t->global[j], own, own);
            for (int k = 0; k < 3; k++) t->place_shape[j][k][b] = moved[j][k][b] - own[k];
        }
    }
}

/* ---- a point ---- */

static void rest_place(const body_points *p, size_t i, const body_state *s, const chain *t, double u[3]) {
    const point_data *q = &p->point[i];
    for (int k = 0; k < 3; k++) {
        u[k] = q->rest[k];
        for (int b = 0; b < BODY_SHAPES; b++) u[k] += s->shape[b] * q->shape[k][b];
    }
    for (int j = 1; j < BODY_JOINTS && p->volume; j++) {
        if (q->kept[j] == 0) continue;
        const double *F = t->feature[j], *J = p->body->joint_template[j];
        const double from[3] = {q->rest[0] - J[0], q->rest[1] - J[1], q->rest[2] - J[2]};
        for (int r = 0; r < 3; r++)
            for (int k = 0; k < 3; k++) u[r] -= 0.5 * q->kept[j] * (F[3 * r + k] + F[3 * k + r]) * from[k];
    }
    if (!p->posedirs) return;
    const float *dirs = p->posedirs + i * 3 * BODY_POSE_FEATURES;
    for (int f = 0; f < BODY_POSE_FEATURES; f++)
        for (int k = 0; k < 3; k++) u[k] += t->feature[1 + f / 9][f % 9] * (double)dirs[3 * f + k];
}

/* The derivative of the point's rest place by component `a` of joint j; false: it is zero. */
static bool rest_slope(const body_points *p, size_t i, const chain *t, int j, int a, double du[3]) {
    const point_data *q = &p->point[i];
    const double *dR = t->change[j][a];
    du[0] = du[1] = du[2] = 0;
    bool moves = false;
    if (p->volume && q->kept[j] != 0) {
        const double *J = p->body->joint_template[j];
        const double from[3] = {q->rest[0] - J[0], q->rest[1] - J[1], q->rest[2] - J[2]};
        for (int r = 0; r < 3; r++)
            for (int k = 0; k < 3; k++) du[r] -= 0.5 * q->kept[j] * (dR[3 * r + k] + dR[3 * k + r]) * from[k];
        moves = true;
    }
    if (p->posedirs) {
        const float *dirs = p->posedirs + i * 3 * BODY_POSE_FEATURES + 27 * (size_t)(j - 1);
        for (int f = 0; f < 9; f++)
            for (int k = 0; k < 3; k++) du[k] += dR[f] * (double)dirs[3 * f + k];
        moves = true;
    }
    return moves;
}

static void slopes(const body_points *p, size_t i, const chain *t, const double B[9],
                   const double below[BODY_JOINTS][4], double (*out)[BODY_UNKNOWNS]) {
    const point_data *q = &p->point[i];
    memset(out, 0, 3 * sizeof *out);
    for (int j = 0; j < BODY_JOINTS; j++) {
        double arm[3], d[3], du[3];
        for (int k = 0; k < 3; k++) arm[k] = below[j][k] - below[j][3] * t->place[j][k];
        for (int a = 0; a < 3; a++) {
            double o[3] = {a == 0, a == 1, a == 2};
            for (int k = 0; k < 3 && j > 0; k++) o[k] = t->axis[j][3 * k + a];
            d[0] = d[1] = d[2] = 0;
            if (below[j][3] != 0) cross3(o, arm, d);
            if (j > 0 && rest_slope(p, i, t, j, a, du)) {
                rotate3(B, du, du);
                for (int k = 0; k < 3; k++) d[k] += du[k];
            }
            int column = j ? BODY_BEND + 3 * (j - 1) + a : BODY_TURN + a;
            for (int k = 0; k < 3; k++) out[k][column] = d[k];
        }
    }
    for (int b = 0; b < BODY_SHAPES; b++) {
        double d[3] = {q->shape[0][b], q->shape[1][b], q->shape[2][b]};
        rotate3(B, d, d);
        for (int k = 0; k < 3; k++) {
            for (int j = 0; j < BODY_JOINTS; j++)
                if (q->weight[j] != 0) d[k] += q->weight[j] * t->place_shape[j][k][b];
            out[k][BODY_SHAPE + b] = d[k];
        }
    }
    for (int k = 0; k < 3; k++) out[k][BODY_SHIFT + k] = 1;
}

void body_points_place(const body_points *p, const body_state *s, double *place, double *slope,
                       double *blend) {
    chain t;
    memset(&t, 0, sizeof t);
    chain_turns(p->body, s, &t);
    if (slope) chain_shapes(p->body, &t);
    for (size_t i = 0; i < (size_t)p->count; i++) {
        const point_data *q = &p->point[i];
        double u[3], B[9] = {0}, below[BODY_JOINTS][4] = {{0}};
        rest_place(p, i, s, &t, u);
        for (int j = 0; j < BODY_JOINTS; j++) {
            double w = q->weight[j], x[3] = {u[0] - t.rest[j][0], u[1] - t.rest[j][1], u[2] - t.rest[j][2]};
            if (w == 0) continue;
            rotate3(t.global[j], x, x);
            for (int k = 0; k < 3; k++) below[j][k] = w * (x[k] + t.place[j][k]);
            below[j][3] = w;
            for (int k = 0; k < 9; k++) B[k] += w * t.global[j][k];
        }
        for (int j = BODY_JOINTS - 1; j > 0; j--)
            for (int k = 0; k < 4; k++) below[p->body->parent[j]][k] += below[j][k];
        memcpy(place + 3 * i, below[0], 3 * sizeof *place);
        if (blend) memcpy(blend + 9 * i, B, sizeof B);
        if (slope)
            slopes(p, i, &t, B, (const double(*)[4])below,
                   (double(*)[BODY_UNKNOWNS])(slope + i * 3 * BODY_UNKNOWNS));
    }
}
