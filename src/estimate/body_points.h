/* body_points: positions of chosen points of the body for given unknowns, and their derivatives by each of
 * them. A fit uses only a few hundred points: joints, places fixed to joints, and vertices. */
#ifndef SHERF_ESTIMATE_BODY_POINTS_H
#define SHERF_ESTIMATE_BODY_POINTS_H

#include "body/body.h"

/* The order of the unknowns. The turn is a small rotation put before the root's (exp(turn) root), so that no
 * orientation is special; joints are axis-angle vectors and change by adding. */
enum {
    BODY_TURN = 0,
    BODY_BEND = 3, /* joints 1 to 23 */
    BODY_SHAPE = BODY_BEND + 3 * (BODY_JOINTS - 1),
    BODY_SHIFT = BODY_SHAPE + BODY_SHAPES,
    BODY_UNKNOWNS = BODY_SHIFT + 3
};

/* x = root (x_smpl - pelvis) + pelvis_m, in any frame: the fit's is the camera's. */
typedef struct {
    double root[9];              /* a rotation */
    double bend[BODY_JOINTS][3]; /* axis-angle, radians; [0] is not used */
    double shape[BODY_SHAPES];
    double pelvis_m[3];
} body_state;

/* vertex >= 0: that vertex. Otherwise the place that is `offset_m` from the joint in the rest pose and turns
 * with it. */
typedef struct {
    int vertex, joint;
    double offset_m[3];
} body_point;

typedef struct body_points body_points;
/* Keeps a pointer to the body and copies the rest. */
sherf_status body_points_create(context *c, const body_model *body, int count, const body_point *point,
                                body_points **out);
void body_points_free(body_points *p);
int body_points_count(const body_points *p);
/* place: count x 3. slope (may be NULL): count x 3 x BODY_UNKNOWNS. blend (may be NULL): count x 9, the
 * blended rotation of each point, for vectors that turn with it. */
void body_points_place(const body_points *p, const body_state *s, double *place, double *slope,
                       double *blend);
/* s moved by a step: BODY_UNKNOWNS numbers. out may be s. */
void body_state_move(const body_state *s, const double *step, body_state *out);

/* exp of a rotation vector, and J with exp(w + dw) = exp(J dw) exp(w) for small dw. jacobian may be NULL. */
void rotation_exp(const double w[3], double R[9], double jacobian[9]);
#endif
