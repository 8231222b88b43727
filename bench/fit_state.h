/* fit_state: the true body of a data set's view, as a fit has it. */
#ifndef SHERF_FIT_STATE_H
#define SHERF_FIT_STATE_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "data/data.h"
#include "estimate/body_points.h"

/* The body of a view in its camera's frame. */
static void body_in_camera(context *c, const body_model *body, const data_view *v, body_state *s) {
    posed_body *p;
    double R[9];
    float root[9];
    memset(s, 0, sizeof *s);
    if (posed_joints_create(c, body, v->pose.poses_rad, v->pose.shapes, v->pose.R, v->pose.Th_m, &p) !=
        SHERF_OK) {
        fprintf(stderr, "%s\n", c->message);
        exit(1);
    }
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
