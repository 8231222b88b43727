/* What is known of landmarks, joints and masses. */
#include "estimate/fit_inside.h"

/* Measured on 320 pictures of 40 made people (`sherf synth people --seed 5000 --people 40 --poses 2 --views 4
 * --size 512` before plain backgrounds; BlazePose heavy), whose bodies are known, by robust least squares,
 * left and right mirrored: where on the body a landmark lies, how far it strays, and what is wrong with it in
 * 3D. Knees come 3 cm too near and ankles 4 cm too far, so that straight legs look bent by 11 degrees; depths
 * shrink by a quarter. */
#define SIDES(left, right, j, x, y, z, spread, slope, shift, bx, by, bz, across, along)                      \
    [left] = {j, {x, y, z}, spread, slope, shift, {bx, by, bz}, across, along}, [right] = {                  \
                                                                                    j + 1,  {-(x), y, z},    \
                                                                                    spread, slope,           \
                                                                                    shift,  {-(bx), by, bz}, \
                                                                                    across, along}
#define HEAD(left, right, x, y, z, spread, slope, shift, bx, by, bz, across, along)                          \
    [left] = {15, {x, y, z}, spread, slope, shift, {bx, by, bz}, across, along}, [right] = {15,              \
                                                                                            {-(x), y, z},    \
                                                                                            spread,          \
                                                                                            slope,           \
                                                                                            shift,           \
                                                                                            {-(bx), by, bz}, \
                                                                                            across,          \
                                                                                            along}
#define NONE                                                                                                 \
    { .joint = -1 }
const fit_landmark fit_landmarks[LANDMARKS] = {
    [LANDMARK_NOSE] = {15, {0, 0.045, 0.129}, 0.020, 0.91, -0.052, {0, -0.009, 0.028}, 0.040, 0.090},
    [1] = NONE,
    [3] = NONE,
    [4] = NONE,
    [6] = NONE,
    [9] = NONE,
    [10] = NONE,
    HEAD(LANDMARK_LEFT_EYE, LANDMARK_RIGHT_EYE, 0.025, 0.074, 0.097, 0.020, 0.85, -0.077, -0.007, -0.017,
         0.034, 0.040, 0.090),
    HEAD(LANDMARK_LEFT_EAR, LANDMARK_RIGHT_EAR, 0.052, 0.062, 0.040, 0.020, 0.78, -0.076, 0.024, -0.051,
         -0.016, 0.040, 0.080),
    SIDES(LANDMARK_LEFT_SHOULDER, LANDMARK_RIGHT_SHOULDER, 16, -0.014, -0.006, 0.001, 0.022, 0.80, 0.020,
          0.003, 0.016, -0.002, 0.045, 0.070),
    SIDES(LANDMARK_LEFT_ELBOW, LANDMARK_RIGHT_ELBOW, 18, 0.014, -0.014, 0.013, 0.025, 0.77, -0.025, 0.005,
          0.020, 0, 0.040, 0.080),
    SIDES(LANDMARK_LEFT_WRIST, LANDMARK_RIGHT_WRIST, 20, 0.017, -0.022, -0.001, 0.022, 0.71, -0.022, 0.005,
          0.017, -0.008, 0.045, 0.120),
    SIDES(LANDMARK_LEFT_PINKY, LANDMARK_RIGHT_PINKY, 20, 0.078, -0.016, -0.014, 0.035, 0.71, -0.030, -0.001,
          0.036, -0.003, 0.060, 0.140),
    SIDES(LANDMARK_LEFT_INDEX, LANDMARK_RIGHT_INDEX, 20, 0.085, -0.019, 0.011, 0.035, 0.69, -0.038, -0.010,
          0.043, 0.004, 0.060, 0.140),
    SIDES(LANDMARK_LEFT_THUMB, LANDMARK_RIGHT_THUMB, 20, 0.060, -0.031, 0.018, 0.035, 0.68, -0.034, 0.002,
          0.030, -0.025, 0.060, 0.130),
    [LANDMARK_LEFT_HIP] = {0, {0.096, -0.067, 0.034}, 0.025, 1, 0, {0, 0, 0}, 0.025, 0.040},
    [LANDMARK_RIGHT_HIP] = {0, {-0.096, -0.067, 0.034}, 0.025, 1, 0, {0, 0, 0}, 0.025, 0.040},
    SIDES(LANDMARK_LEFT_KNEE, LANDMARK_RIGHT_KNEE, 4, -0.011, -0.016, -0.004, 0.026, 0.66, -0.029, 0.004,
          -0.010, 0.007, 0.045, 0.070),
    SIDES(LANDMARK_LEFT_ANKLE, LANDMARK_RIGHT_ANKLE, 7, -0.002, 0.002, 0.015, 0.022, 0.75, 0.042, 0.003,
          -0.006, -0.017, 0.045, 0.095),
    SIDES(LANDMARK_LEFT_HEEL, LANDMARK_RIGHT_HEEL, 7, -0.011, -0.066, -0.032, 0.030, 0.79, 0.037, 0.019,
          0.015, 0.032, 0.050, 0.100),
    SIDES(LANDMARK_LEFT_TOE, LANDMARK_RIGHT_TOE, 7, 0.015, -0.075, 0.159, 0.040, 0.85, 0.012, -0.004, 0.034,
          -0.039, 0.055, 0.120),
};

/* The usual bend is that of somebody who stands with arms hanging; the spreads are those of the poses of
 * `synth people` (curves of walking and running, MakeHuman's postures, CMU's clips 01_01 and 01_03, free
 * poses: pose_draw), left and right mirrored, and what is hinged is kept so. Limits: people/person_pose.c.
 * Right is left mirrored. */
#define JOINT(u0, u1, u2, s0, s1, s2, l0, l1, l2, h0, h1, h2)                                                \
    {                                                                                                        \
        {u0, u1, u2}, {s0, s1, s2}, {l0, l1, l2}, {                                                          \
            h0, h1, h2                                                                                       \
        }                                                                                                    \
    }
#define MIRRORED(j, u0, u1, u2, s0, s1, s2, l0, l1, l2, h0, h1, h2)                                          \
    [j] = JOINT(u0, u1, u2, s0, s1, s2, l0, l1, l2, h0, h1, h2),                                             \
    [j + 1] = JOINT(u0, -(u1), -(u2), s0, s1, s2, l0, -(h1), -(h2), h0, -(l1), -(l2))
const fit_joint fit_joints[BODY_JOINTS] = {
    [0] = JOINT(0, 0, 0, 1, 1, 1, -9, -9, -9, 9, 9, 9),
    MIRRORED(1, -0.06, 0.05, 0.05, 0.40, 0.15, 0.15, -2.2, -0.8, -0.4, 0.6, 0.8, 1.1), /* hips */
    [3] = JOINT(0.03, 0, 0, 0.13, 0.11, 0.08, -0.4, -0.5, -0.4, 0.8, 0.5, 0.4),
    MIRRORED(4, 0.10, 0, 0, 0.40, 0.08, 0.08, 0.0, -0.4, -0.3, 2.5, 0.4, 0.3), /* knees */
    [6] = JOINT(0.03, 0, 0, 0.09, 0.10, 0.08, -0.3, -0.5, -0.4, 0.6, 0.5, 0.4),
    MIRRORED(7, 0, 0, -0.03, 0.18, 0.10, 0.12, -0.8, -0.5, -0.5, 0.9, 0.5, 0.5), /* ankles */
    [9] = JOINT(0.02, 0, 0, 0.09, 0.11, 0.07, -0.3, -0.5, -0.4, 0.5, 0.5, 0.4),
    MIRRORED(10, 0, 0, 0, 0.05, 0.02, 0.02, -0.7, -0.2, -0.2, 0.4, 0.2, 0.2), /* toes */
    [12] = JOINT(0, 0, 0, 0.15, 0.22, 0.10, -0.6, -0.8, -0.5, 0.7, 0.8, 0.5),
    MIRRORED(13, 0, 0, -0.04, 0.07, 0.10, 0.13, -0.3, -0.4, -0.4, 0.3, 0.4, 0.4), /* collars */
    [15] = JOINT(0, 0, 0, 0.12, 0.17, 0.09, -0.6, -0.9, -0.5, 0.7, 0.9, 0.5),
    MIRRORED(16, 0, -0.20, -1.0, 0.40, 0.42, 0.50, -1.5, -2.0, -1.6, 1.5, 1.2, 1.5),  /* shoulders */
    MIRRORED(18, 0, -0.45, 0.05, 0.20, 0.55, 0.20, -1.2, -2.4, -0.8, 1.2, 0.05, 0.8), /* elbows */
    MIRRORED(20, 0, 0, -0.02, 0.20, 0.11, 0.16, -0.9, -0.7, -1.2, 0.9, 0.7, 1.2),     /* wrists */
    MIRRORED(22, 0, 0, 0, 0.01, 0.01, 0.01, -0.1, -0.1, -0.1, 0.1, 0.1, 0.1),
};

/* Segments' shares as anatomy books have them (head 8 %, trunk 43 %, an arm 5.5 %, a leg 19 %), halves to the
 * joints at their ends. */
const double fit_mass[BODY_JOINTS] = {
    [0] = 0.14,  [1] = 0.05,  [2] = 0.05,  [3] = 0.08,  [4] = 0.085, [5] = 0.085,
    [6] = 0.12,  [7] = 0.045, [8] = 0.045, [9] = 0.12,  [15] = 0.08, [16] = 0.02,
    [17] = 0.02, [18] = 0.02, [19] = 0.02, [20] = 0.01, [21] = 0.01};
