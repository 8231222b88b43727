/* fit_inside: what the parts of the fit share. Everything is in the camera's frame, metres, until the result
 * is made. */
#ifndef SHERF_ESTIMATE_FIT_INSIDE_H
#define SHERF_ESTIMATE_FIT_INSIDE_H

#include "estimate/body_points.h"
#include "estimate/fit.h"

/* Beside the body's unknowns. */
enum {
    FIT_PITCH = BODY_UNKNOWNS,
    FIT_ROLL,
    FIT_FOCAL, /* its logarithm */
    FIT_SCALE, /* the logarithm of the scale of the landmarks in 3D */
    FIT_UNKNOWNS
};
typedef struct {
    body_state body;
    double pitch, roll, log_focal, log_scale;
} fit_state;

/* ---- landmarks on the body, and the networks' faults (fit_tables.c) ---- */
typedef struct {
    int joint; /* -1: not used */
    double offset_m[3];
    double spread_m; /* of its place in 2D, across the ray */
    /* In 3D the networks see depth x + (a, b): along the ray depth_slope z + depth_shift_m, and what lies in
     * the body's axes, body_shift_m. */
    double depth_slope, depth_shift_m, body_shift_m[3], across_m, along_m;
} fit_landmark;
extern const fit_landmark fit_landmarks[LANDMARKS];

/* A prior of one joint: the usual bend, how far it spreads, and how far the joint goes. */
typedef struct {
    double usual[3], spread[3], lowest[3], highest[3];
} fit_joint;
extern const fit_joint fit_joints[BODY_JOINTS];
/* Shares of the body's mass by joint; sums to 1. */
extern const double fit_mass[BODY_JOINTS];

/* ---- the mask as a fit uses it (fit_mask.c) ---- */
enum { FIT_MASK_SIDE = 256, FIT_OUTLINE_MOST = 320 };
typedef struct {
    int width, height; /* cells */
    double left, top,
        cell_px;       /* cell (x, y) has its centre at left + cell_px x, top + cell_px y in the photo */
    float *inside;     /* width x height, probabilities */
    float *outside_px; /* how far outside of the mask a cell lies; 0 inside */
    int outline;       /* points of the mask's edge that do not lie at the photo's border */
    double point_px[FIT_OUTLINE_MOST][2], normal[FIT_OUTLINE_MOST][2]; /* normals outwards */
} fit_mask;
sherf_status fit_mask_create(context *c, const body_fit_input *in, fit_mask **out);
void fit_mask_free(fit_mask *m);
/* Distance outside the mask at a place, and its slope. Beyond the grid it goes on growing. */
double fit_mask_outside(const fit_mask *m, const double place_px[2], double slope[2]);

/* ---- terms (fit_terms.c) ---- */
enum { FIT_MARKS = LANDMARKS + BODY_JOINTS };
typedef struct {
    const body_model *m;
    const body_fit_input *in;
    const fit_mask *mask;
    body_points *marks, *skin; /* landmarks and then joints; vertices all over the body */
    double (*skin_normal)[3];  /* in the rest pose */
    double centre_px[2], focal_guess_px, focal_spread;
    double seen[LANDMARKS]; /* 0 to 1: how much a landmark counts */
    double seen_3d[LANDMARKS];
    double place_m[LANDMARKS][3]; /* in 3D, about the hips, turned from the ray's to the camera's frame */
    double ray[9];                /* the rotation that does so */
    double px_per_m;              /* at the body, of the state at hand; fixed during a stage */
    double upright;               /* how much a trunk that leans costs */
    double stands;                /* 0 to 1: how sure it is that the feet carry the body */
    /* which terms count */
    double weight_2d, weight_3d, weight_mask;
    /* scratch */
    double *mark_place, *mark_slope, *skin_place, *skin_slope, *skin_blend;
} fit_problem;

typedef struct {
    double A[FIT_UNKNOWNS][FIT_UNKNOWNS], b[FIT_UNKNOWNS], cost;
} fit_equations;
/* The sum of all terms at s, and where `equations` is not NULL the Gauss-Newton normal equations A step = -b.
 */
double fit_cost(fit_problem *p, const fit_state *s, fit_equations *equations);
void fit_up(const fit_state *s, double up[3]); /* against gravity, in the camera's frame */

/* ---- solving (fit_solve.c) ---- */
/* Levenberg-Marquardt; returns the cost. */
double fit_solve(fit_problem *p, fit_state *s, int steps, fit_equations *scratch);

#endif
