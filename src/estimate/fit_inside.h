/* fit_inside: shared by the files of the fit. Everything is in the camera's frame, metres, until the result
 * is made. */
#ifndef SHERF_ESTIMATE_FIT_INSIDE_H
#define SHERF_ESTIMATE_FIT_INSIDE_H

#include "estimate/body_points.h"
#include "estimate/fit.h"

/* Unknowns besides the body's. */
enum {
    FIT_PITCH = BODY_UNKNOWNS,
    FIT_ROLL,
    FIT_FOCAL,   /* its logarithm */
    FIT_SCALE,   /* the logarithm of the scale of the landmarks in 3D */
    FIT_CLOTHES, /* how far clothes lie beyond the body, relative to the usual */
    FIT_UNKNOWNS
};
typedef struct {
    body_state body;
    double pitch, roll, log_focal, log_scale, clothes;
} fit_state;

/* ---- landmarks on the body (fit_tables.c) ---- */
typedef struct {
    int joint; /* -1: not used */
    double offset_m[3];
    double spread_m; /* of its place in 2D, across the ray */
    /* of its place in 3D, across the ray and along it, after the depth's correction */
    double across_m, along_m;
} fit_landmark;
extern const fit_landmark fit_landmarks[LANDMARKS];

/* ---- the networks' depths corrected (fit_depths.c) ---- */
/* The regressors: for each used landmark its place in 3D, the difference of its place in the picture from
 * that, and its visibility; and 1. Lengths are the networks' metres, axes those of the region. */
enum { FIT_DEPTHS = 27, FIT_DEPTH_NUMBERS = 6 * FIT_DEPTHS + 1 };
#define FIT_DEPTH_UNIT (1. / 8192)
extern const int16_t fit_depth_weights[FIT_DEPTHS][FIT_DEPTH_NUMBERS];
/* numbers: the regressors. *px_per_m: of the networks' metres. false: all landmarks are in one place. */
bool fit_depth_numbers(const photo_person *p, double number[FIT_DEPTH_NUMBERS], double *px_per_m);
/* The most likely depths behind the middle of the hips, in the networks' metres; 0 for unused landmarks. */
void fit_depths(const photo_person *p, double depth_m[LANDMARKS]);

/* ---- what people wear (fit_clothes_table.c) ---- */
/* How far the mask's edge usually lies beyond the bare body, for clothes, hair and soles, where skin that
 * follows the joint makes the contour: beyond_m + along_m . n, n the skin's normal in the rest pose. */
typedef struct {
    float beyond_m, along_m[3];
} fit_clothes;
extern const fit_clothes fit_clothes_table[BODY_JOINTS];
/* The same for one vertex, blended with its skinning weights. */
double fit_clothes_at(const body_model *body, int vertex, const double normal[3]);

/* One joint: the usual bend, from which a fit starts, and its limits. */
typedef struct {
    double usual[3], lowest[3], highest[3];
} fit_joint;
extern const fit_joint fit_joints[BODY_JOINTS];
/* Shares of the body's mass by joint; sums to 1. */
extern const double fit_mass[BODY_JOINTS];

/* ---- poses that people are photographed in (fit_poses.c) ---- */
/* The numbers that describe a pose: the bends of fit_pose_joint's joints, and the vertical's parts along the
 * pelvis' x and z (a tilted root). A mixture of Gaussians: each kind of pose has a mean and the upper
 * triangle, row by row, of a matrix that whitens deviations from it, in units of FIT_POSE_..._UNIT. */
enum { FIT_POSE_JOINTS = 19, FIT_POSE_NUMBERS = 3 * FIT_POSE_JOINTS + 2, FIT_POSE_KINDS = 6 };
#define FIT_POSE_MEAN_UNIT 1e-4
#define FIT_POSE_WHITEN_UNIT (1. / 1024)
typedef struct {
    double cost; /* -2 log of the density at its mean, less that of the first */
    int16_t mean[FIT_POSE_NUMBERS], whiten[FIT_POSE_NUMBERS * (FIT_POSE_NUMBERS + 1) / 2];
} fit_pose_kind;
extern const int fit_pose_joint[FIT_POSE_JOINTS];
extern const fit_pose_kind fit_pose_kinds[FIT_POSE_KINDS];
/* The kind with the lowest cost at x, and its whitened residuals. *cost: -2 log of the density, less the
 * first kind's peak. */
const fit_pose_kind *fit_pose_nearest(const double x[FIT_POSE_NUMBERS], double r[FIT_POSE_NUMBERS],
                                      double *cost);

/* ---- the mask as a fit uses it (fit_mask.c) ---- */
enum { FIT_MASK_SIDE = 256, FIT_OUTLINE_MAX = 320 };
typedef struct {
    int width, height; /* cells */
    double left, top,
        cell_px;       /* cell (x, y) has its centre at left + cell_px x, top + cell_px y in the photo */
    float *inside;     /* width x height, probabilities */
    float *outside_px; /* distance of a cell outside the mask; 0 inside */
    int outline;       /* points of the mask's edge that do not lie at the photo's border */
    double point_px[FIT_OUTLINE_MAX][2], normal[FIT_OUTLINE_MAX][2]; /* normals outwards */
} fit_mask;
sherf_status fit_mask_create(context *c, const body_fit_input *in, fit_mask **out);
void fit_mask_free(fit_mask *mask);
/* Distance outside the mask at a place, and its gradient. It keeps growing beyond the grid. */
double fit_mask_outside(const fit_mask *mask, const double place_px[2], double slope[2]);

/* ---- terms (fit_terms.c) ---- */
enum { FIT_MARKS = LANDMARKS + BODY_JOINTS };
typedef struct {
    const body_model *body;
    const body_fit_input *in;
    fit_mask *mask;            /* owned */
    body_points *marks, *skin; /* landmarks and then joints; vertices all over the body */
    double (*skin_normal)[3];  /* in the rest pose */
    double *skin_clothes_m;    /* the usual distance of the mask's edge beyond it */
    int *skin_vertex;
    double centre_px[2], focal_guess_px, focal_spread;
    double seen[LANDMARKS]; /* 0 to 1: weight of a landmark */
    double seen_3d[LANDMARKS];
    double depth_m[LANDMARKS]; /* corrected */
    double ray[9];             /* the rotation that does so */
    double px_per_m;           /* at the body, of the state at hand; fixed during a stage */
    double upright;            /* cost of a leaning trunk */
    double stands;             /* 0 to 1: confidence that the feet carry the body */
    /* which terms count */
    double weight_2d, weight_3d, weight_mask;
    /* scratch */
    double *mark_place, *mark_slope, *skin_place, *skin_slope, *skin_blend;
} fit_problem;

/* Makes a problem of this input, without weights; it points to `in` and `body`. fit_problem_clear frees what
 * it holds, even after a failure. */
sherf_status fit_problem_begin(context *c, const body_model *body, const body_fit_input *in, fit_problem *p);
void fit_problem_clear(fit_problem *p);

/* A place of the skin on the body's contour near a point of the mask's edge. off_px: how far the contour lies
 * beyond the edge, negative where clothes cover it. */
typedef struct {
    int outline, skin;
    double off_px;
} fit_edge;
/* The points of the mask's outline that have such skin near them, for vertices at p->skin_place with
 * p->skin_blend; at most FIT_OUTLINE_MAX. */
int fit_edges(fit_problem *p, double focal_px, fit_edge *edge);

typedef struct {
    double A[FIT_UNKNOWNS][FIT_UNKNOWNS], b[FIT_UNKNOWNS], cost;
} fit_equations;
/* The sum of all terms at s, and where `equations` is not NULL the Gauss-Newton normal equations A step = -b.
 */
double fit_cost(fit_problem *p, const fit_state *s, fit_equations *equations);
const float *fit_shape(const body_fit_input *in); /* the fixed shape; NULL: it is estimated */
void fit_up(const fit_state *s, double up[3]);    /* against gravity, in the camera's frame */

/* ---- solving (fit_solve.c) ---- */
/* Levenberg-Marquardt; returns the cost. */
double fit_solve(fit_problem *p, fit_state *s, int steps, fit_equations *scratch);

#endif
