/* Tables of landmarks, joints and masses. */
#include "estimate/fit_inside.h"

/* Measured on 320 pictures of 40 synthetic people (`sherf synth people --seed 5000 --people 40 --poses 2
 * --views 4 --size 512` before plain backgrounds; BlazePose heavy), whose bodies are known, by robust least
 * squares, left and right mirrored: where on the body a landmark lies and how far it strays in the picture;
 * in 3D along the ray, the residual after bench/fit_depths.c. */
#define SIDES(left, right, j, x, y, z, spread, across, along)                                                \
    [left] = {j, {x, y, z}, spread, across, along}, [right] = {j + 1, {-(x), y, z}, spread, across, along}
#define HEAD(left, right, x, y, z, spread, across, along)                                                    \
    [left] = {15, {x, y, z}, spread, across, along}, [right] = {15, {-(x), y, z}, spread, across, along}
#define NONE                                                                                                 \
    { .joint = -1 }
const fit_landmark fit_landmarks[LANDMARKS] = {
    [LANDMARK_NOSE] = {15, {0, 0.045, 0.129}, 0.020, 0.120, 0.060},
    [1] = NONE,
    [3] = NONE,
    [4] = NONE,
    [6] = NONE,
    [9] = NONE,
    [10] = NONE,
    HEAD(LANDMARK_LEFT_EYE, LANDMARK_RIGHT_EYE, 0.025, 0.074, 0.097, 0.020, 0.120, 0.060),
    HEAD(LANDMARK_LEFT_EAR, LANDMARK_RIGHT_EAR, 0.052, 0.062, 0.040, 0.020, 0.120, 0.056),
    SIDES(LANDMARK_LEFT_SHOULDER, LANDMARK_RIGHT_SHOULDER, 16, -0.014, -0.006, 0.001, 0.022, 0.135, 0.046),
    SIDES(LANDMARK_LEFT_ELBOW, LANDMARK_RIGHT_ELBOW, 18, 0.014, -0.014, 0.013, 0.025, 0.120, 0.052),
    SIDES(LANDMARK_LEFT_WRIST, LANDMARK_RIGHT_WRIST, 20, 0.017, -0.022, -0.001, 0.022, 0.135, 0.089),
    SIDES(LANDMARK_LEFT_PINKY, LANDMARK_RIGHT_PINKY, 20, 0.078, -0.016, -0.014, 0.035, 0.180, 0.100),
    SIDES(LANDMARK_LEFT_INDEX, LANDMARK_RIGHT_INDEX, 20, 0.085, -0.019, 0.011, 0.035, 0.180, 0.100),
    SIDES(LANDMARK_LEFT_THUMB, LANDMARK_RIGHT_THUMB, 20, 0.060, -0.031, 0.018, 0.035, 0.180, 0.096),
    [LANDMARK_LEFT_HIP] = {0, {0.096, -0.067, 0.034}, 0.025, 0.075, 0.015},
    [LANDMARK_RIGHT_HIP] = {0, {-0.096, -0.067, 0.034}, 0.025, 0.075, 0.015},
    SIDES(LANDMARK_LEFT_KNEE, LANDMARK_RIGHT_KNEE, 4, -0.011, -0.016, -0.004, 0.026, 0.135, 0.049),
    SIDES(LANDMARK_LEFT_ANKLE, LANDMARK_RIGHT_ANKLE, 7, -0.002, 0.002, 0.015, 0.022, 0.135, 0.076),
    SIDES(LANDMARK_LEFT_HEEL, LANDMARK_RIGHT_HEEL, 7, -0.011, -0.066, -0.032, 0.030, 0.150, 0.083),
    SIDES(LANDMARK_LEFT_TOE, LANDMARK_RIGHT_TOE, 7, 0.015, -0.075, 0.159, 0.040, 0.165, 0.084),
};

/* The usual bend of a joint is that of a person standing with hanging arms. Limits: people/person_pose.c. The
 * right side mirrors the left. */
#define JOINT(u0, u1, u2, l0, l1, l2, h0, h1, h2)                                                            \
    {                                                                                                        \
        {u0, u1, u2}, {l0, l1, l2}, {                                                                        \
            h0, h1, h2                                                                                       \
        }                                                                                                    \
    }
#define MIRRORED(j, u0, u1, u2, l0, l1, l2, h0, h1, h2)                                                      \
    [j] = JOINT(u0, u1, u2, l0, l1, l2, h0, h1, h2),                                                         \
    [j + 1] = JOINT(u0, -(u1), -(u2), l0, -(h1), -(h2), h0, -(l1), -(l2))
const fit_joint fit_joints[BODY_JOINTS] = {
    [0] = JOINT(0, 0, 0, -9, -9, -9, 9, 9, 9),
    MIRRORED(1, -0.06, 0.05, 0.05, -2.2, -0.8, -0.4, 0.6, 0.8, 1.1), /* hips */
    [3] = JOINT(0.03, 0, 0, -0.4, -0.5, -0.4, 0.8, 0.5, 0.4),
    MIRRORED(4, 0.10, 0, 0, 0.0, -0.4, -0.3, 2.5, 0.4, 0.3), /* knees */
    [6] = JOINT(0.03, 0, 0, -0.3, -0.5, -0.4, 0.6, 0.5, 0.4),
    MIRRORED(7, 0, 0, -0.03, -0.8, -0.5, -0.5, 0.9, 0.5, 0.5), /* ankles */
    [9] = JOINT(0.02, 0, 0, -0.3, -0.5, -0.4, 0.5, 0.5, 0.4),
    MIRRORED(10, 0, 0, 0, -0.7, -0.2, -0.2, 0.4, 0.2, 0.2), /* toes */
    [12] = JOINT(0, 0, 0, -0.6, -0.8, -0.5, 0.7, 0.8, 0.5),
    MIRRORED(13, 0, 0, -0.04, -0.3, -0.4, -0.4, 0.3, 0.4, 0.4), /* collars */
    [15] = JOINT(0, 0, 0, -0.6, -0.9, -0.5, 0.7, 0.9, 0.5),
    MIRRORED(16, 0, -0.20, -1.0, -1.5, -2.0, -1.6, 1.5, 1.2, 1.5),  /* shoulders */
    MIRRORED(18, 0, -0.45, 0.05, -1.2, -2.4, -0.8, 1.2, 0.05, 0.8), /* elbows */
    MIRRORED(20, 0, 0, -0.02, -0.9, -0.7, -1.2, 0.9, 0.7, 1.2),     /* wrists */
    MIRRORED(22, 0, 0, 0, -0.1, -0.1, -0.1, 0.1, 0.1, 0.1),
};

/* Segments' shares as anatomy books have them (head 8 %, trunk 43 %, an arm 5.5 %, a leg 19 %), halves to the
 * joints at their ends. */
const double fit_mass[BODY_JOINTS] = {
    [0] = 0.14,  [1] = 0.05,  [2] = 0.05,  [3] = 0.08,  [4] = 0.085, [5] = 0.085,
    [6] = 0.12,  [7] = 0.045, [8] = 0.045, [9] = 0.12,  [15] = 0.08, [16] = 0.02,
    [17] = 0.02, [18] = 0.02, [19] = 0.02, [20] = 0.01, [21] = 0.01};
