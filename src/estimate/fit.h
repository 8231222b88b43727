/* fit: camera, pose and shape of a body from the networks' landmarks and mask of a person in a photo.
 *
 * Nonlinear least squares over the body's turn, 23 rotations, 10 shapes, its place, the focal length, which
 * way is up, and the scale of the landmarks in 3D, with analytic derivatives (body_points.h). docs/photo.md
 * has the terms and the accuracy. */
#ifndef SHERF_ESTIMATE_FIT_H
#define SHERF_ESTIMATE_FIT_H

#include "body/body.h"
#include "estimate/person.h"

typedef struct body_fit_result body_fit_result;
typedef struct {
    const photo_person *person;
    int width_px, height_px; /* of the photo */
    double focal_px;         /* 0: unknown; then it is estimated, near 1.3 times the longer side */
    const sherf_image *mask; /* width_px x height_px x 1, probabilities; NULL: the person's own `inside` */
    /* For a video's frames, or NULL. known: its shape, focal length, pitch and roll are kept. before: the fit
     * of the same person a moment ago, with the known camera; this fit starts from it. */
    const body_fit_result *known, *before;
    /* BODY_SHAPES numbers, kept fixed as those of `known` are; NULL: they are estimated */
    const float *shape;
} body_fit_input;

/* The world is upright: y up, floor at y = 0 under the lowest part of the body, the pelvis above the origin;
 * the camera looks along -z, down by pitch_rad. R of the pose is the identity: joint 0 has the whole turn. */
struct body_fit_result {
    sherf_camera camera;
    sherf_pose pose;
    double pitch_rad, roll_rad; /* of the camera: looking down, turned clockwise as seen by it */
    double height_px;           /* the body's height in the picture, head to feet, whether cut off or not */
    double landmarks_px;        /* mean distance of the landmarks that are seen, weighted by visibility */
    double mask_covered;        /* share of the mask that the body covers */
    double body_inside;         /* share of the body's silhouette that is inside the mask */
    double iou;                 /* of the two, in the picture */
    double lean_rad;            /* of the trunk against the vertical, forward positive */
    /* Facts for a caller's warnings. */
    bool from_behind;        /* the person's back is turned to the camera */
    bool cut_feet, cut_head; /* outside the picture */
    bool stands;             /* on straight legs: the fit then assumed that the feet carry the body */
    bool hidden_arms;        /* an elbow or wrist is not seen: its pose is a guess */
    bool small;              /* fewer than 150 pixels high */
    bool poor;               /* the body fits landmarks or mask badly: look at the overlay */
};

/* Same input, same bits, for any number of threads. SHERF_BAD_ARGUMENT where the input is not finite or no
 * landmark is seen; SHERF_MISMATCH where no body comes near the landmarks. */
sherf_status body_fit(context *c, const body_model *body, const body_fit_input *in, body_fit_result *out);

#endif
