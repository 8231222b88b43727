/* The 24 joints at rest and posed, without a mesh. */
#include <math.h>
#include <string.h>

#include "motion/motion.h"

const int8_t skeleton_parent[BODY_JOINTS] = {-1, 0, 0, 0,  1,  2,  3,  4,  5,  6,  7,  8,
                                             9,  9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21};

/* The open body's, rounded to millimetres; its soles are at y = -1.138. */
static const double average_m[BODY_JOINTS][3] = {
    {0, -0.223, 0.028},      {0.104, -0.275, 0.039}, {-0.104, -0.275, 0.039}, {0, -0.12, 0.023},
    {0.137, -0.66, 0.034},   {-0.137, -0.66, 0.034}, {0, -0.045, 0.022},      {0.123, -1.068, -0.01},
    {-0.123, -1.068, -0.01}, {0, 0.093, 0.013},      {0.145, -1.113, 0.115},  {-0.145, -1.113, 0.115},
    {0, 0.266, 0.045},       {0.088, 0.175, 0.039},  {-0.088, 0.175, 0.039},  {0, 0.333, 0.064},
    {0.175, 0.206, 0.056},   {-0.175, 0.206, 0.056}, {0.413, 0.206, 0.056},   {-0.413, 0.206, 0.056},
    {0.646, 0.206, 0.056},   {-0.646, 0.206, 0.056}, {0.74, 0.204, 0.049},    {-0.74, 0.204, 0.049}};
static const double average_sole_m = -1.138;
/* Of the open body, for parts that seldom touch the ground; the feet's follow from the sole. */
static const double part_radius_m[BODY_JOINTS] = {0.13, 0.1,  0.1,  0.1,  0.06, 0.06, 0.1,  0,
                                                  0,    0.1,  0,    0,    0.06, 0.06, 0.06, 0.1,
                                                  0.05, 0.05, 0.04, 0.04, 0.03, 0.03, 0.03, 0.03};

void skeleton_of(const body_model *body, const float *shapes, skeleton *out) {
    double sole = average_sole_m;
    memcpy(out->rest_m, average_m, sizeof average_m);
    memcpy(out->radius_m, part_radius_m, sizeof part_radius_m);
    if (body) {
        for (int j = 0; j < BODY_JOINTS; j++)
            for (int k = 0; k < 3; k++) {
                out->rest_m[j][k] = body->joint_template[j][k];
                for (int b = 0; b < BODY_SHAPES && shapes; b++)
                    out->rest_m[j][k] += shapes[b] * body->joint_shape[j][k][b];
            }
        sole = INFINITY;
        for (size_t v = 0; v < (size_t)body->vertices; v++) {
            double y = body->v_template[3 * v + 1];
            for (size_t b = 0; b < BODY_SHAPES && shapes; b++)
                y += (double)shapes[b] * body->shapedirs[(3 * v + 1) * BODY_SHAPES + b];
            sole = fmin(sole, y);
        }
    }
    for (int j = 7; j <= 11; j++)
        if (j != 9) out->radius_m[j] = fmax(0, out->rest_m[j][1] - sole);
}

void skeleton_joints(const skeleton *s, const float (*turn)[4], const float pelvis_m[3],
                     double joints_m[BODY_JOINTS][3]) {
    float world[BODY_JOINTS][4];
    for (int j = 0; j < BODY_JOINTS; j++) {
        int p = skeleton_parent[j];
        if (p < 0) {
            memcpy(world[j], turn[j], sizeof world[j]);
            for (int k = 0; k < 3; k++) joints_m[j][k] = pelvis_m[k];
            continue;
        }
        double bone[3];
        quaternion_multiply(world[p], turn[j], world[j]);
        for (int k = 0; k < 3; k++) bone[k] = s->rest_m[j][k] - s->rest_m[p][k];
        quaternion_rotate(world[p], bone, bone);
        for (int k = 0; k < 3; k++) joints_m[j][k] = joints_m[p][k] + bone[k];
    }
}

double skeleton_lowest(const skeleton *s, const float (*turn)[4], const float pelvis_m[3],
                       const double up[3]) {
    double joint[BODY_JOINTS][3], lowest = INFINITY;
    skeleton_joints(s, turn, pelvis_m, joint);
    for (int j = 0; j < BODY_JOINTS; j++)
        lowest =
            fmin(lowest, joint[j][0] * up[0] + joint[j][1] * up[1] + joint[j][2] * up[2] - s->radius_m[j]);
    return lowest;
}
