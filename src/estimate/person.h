/* person: what networks see of one person in a photo, before a body is fitted to it. */
#ifndef SHERF_ESTIMATE_PERSON_H
#define SHERF_ESTIMATE_PERSON_H

#include "base/base.h"

/* BlazePose's landmarks; left and right are the person's own. */
enum {
    LANDMARK_NOSE = 0,
    LANDMARK_LEFT_EYE = 2,
    LANDMARK_RIGHT_EYE = 5,
    LANDMARK_LEFT_EAR = 7,
    LANDMARK_RIGHT_EAR,
    LANDMARK_LEFT_SHOULDER = 11,
    LANDMARK_RIGHT_SHOULDER,
    LANDMARK_LEFT_ELBOW,
    LANDMARK_RIGHT_ELBOW,
    LANDMARK_LEFT_WRIST,
    LANDMARK_RIGHT_WRIST,
    LANDMARK_LEFT_PINKY,
    LANDMARK_RIGHT_PINKY,
    LANDMARK_LEFT_INDEX,
    LANDMARK_RIGHT_INDEX,
    LANDMARK_LEFT_THUMB,
    LANDMARK_RIGHT_THUMB,
    LANDMARK_LEFT_HIP,
    LANDMARK_RIGHT_HIP,
    LANDMARK_LEFT_KNEE,
    LANDMARK_RIGHT_KNEE,
    LANDMARK_LEFT_ANKLE,
    LANDMARK_RIGHT_ANKLE,
    LANDMARK_LEFT_HEEL,
    LANDMARK_RIGHT_HEEL,
    LANDMARK_LEFT_TOE,
    LANDMARK_RIGHT_TOE,
    LANDMARKS
};

typedef struct {
    float place_px[2];      /* in the photo; a pixel's centre is a whole number */
    float place_m[3];       /* from the middle of the hips; x right, y down, z away from the camera */
    float visible, present; /* probabilities */
} landmark;

/* A square of the photo, turned: (u, v) in [0, 1]^2 of it is centre + side R(angle) (u - 1/2, v - 1/2), with
 * R(angle) = [cos, -sin; sin, cos] in the photo's axes (x right, y down). */
typedef struct {
    float centre_px[2], side_px, angle_rad;
} photo_region;

enum { PERSON_MASK_SIDE = 256 };
typedef struct {
    float score;         /* probability that this is a person */
    photo_region region; /* in which the networks looked */
    photo_region next; /* in which they would look for the same person again: nearer, or in the next frame */
    landmark landmark[LANDMARKS];
    /* Row-major: probability that the centre ((column + 1/2) / side, (row + 1/2) / side) of the region shows
     * the person. */
    float inside[PERSON_MASK_SIDE * PERSON_MASK_SIDE];
} photo_person;

#endif
