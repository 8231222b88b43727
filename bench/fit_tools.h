/* fit_tools: shared by the programs that make the fit's tables. */
#ifndef SHERF_FIT_TOOLS_H
#define SHERF_FIT_TOOLS_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "data/data.h"
#include "estimate/body_points.h"

static inline void must(context *c, sherf_status status) {
    if (status == SHERF_OK) return;
    fprintf(stderr, "%s\n", c->message);
    exit(1);
}

static inline void need(bool there, const char *what) {
    if (there) return;
    fprintf(stderr, "%s\n", what);
    exit(1);
}

/* Left for right. */
static inline int other_joint(int j) {
    static const int8_t other[BODY_JOINTS] = {0,  2,  1,  3,  5,  4,  6,  8,  7,  9,  11, 10,
                                              12, 14, 13, 15, 17, 16, 19, 18, 21, 20, 23, 22};
    return other[j];
}

/* The body of a view in its camera's frame. */
static inline void body_in_camera(context *c, const body_model *body, const data_view *v, body_state *s) {
    posed_body *p;
    double R[9];
    float root[9];
    memset(s, 0, sizeof *s);
    must(c, posed_joints_create(c, body, v->pose.poses_rad, v->pose.shapes, v->pose.R, v->pose.Th_m, &p));
    rodrigues(v->pose.poses_rad, root);
    for (int i = 0; i < 9; i++) {
        R[i] = 0;
        for (int k = 0; k < 3; k++) R[i] += (double)v->camera.R[i / 3 * 3 + k] * (double)p->R[3 * k + i % 3];
    }
    for (int i = 0; i < 9; i++)
        for (int k = 0; k < 3; k++) s->root[i] += R[i / 3 * 3 + k] * (double)root[3 * k + i % 3];
    for (int k = 0; k < 3; k++) {
        s->pelvis_m[k] = (double)v->camera.T_m[k];
        for (int i = 0; i < 3; i++)
            s->pelvis_m[k] += (double)v->camera.R[3 * k + i] * (double)p->Th[i] +
                              R[3 * k + i] * (double)p->joints_smpl[0][i];
    }
    for (int j = 1; j < BODY_JOINTS; j++)
        for (int k = 0; k < 3; k++) s->bend[j][k] = (double)v->pose.poses_rad[3 * j + k];
    for (int b = 0; b < BODY_SHAPES; b++) s->shape[b] = (double)v->pose.shapes[b];
    posed_body_free(p);
}

#endif
