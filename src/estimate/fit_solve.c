/* Levenberg-Marquardt over the normal equations: about ninety unknowns, so Cholesky. */
#include <math.h>
#include <string.h>

#include "estimate/fit_inside.h"

/* Solves (A + damping diag(A)) x = -b; false where that is not positive. A: the lower triangle is read. */
static bool step_of(const fit_equations *e, double damping, double L[FIT_UNKNOWNS][FIT_UNKNOWNS],
                    double x[FIT_UNKNOWNS]) {
    for (int i = 0; i < FIT_UNKNOWNS; i++)
        for (int j = 0; j <= i; j++) {
            double sum = e->A[i][j];
            if (i == j) sum += damping * e->A[i][i] + 1e-9;
            for (int k = 0; k < j; k++) sum -= L[i][k] * L[j][k];
            if (i == j) {
                if (!(sum > 1e-12)) return false;
                L[i][i] = sqrt(sum);
            } else {
                L[i][j] = sum / L[j][j];
            }
        }
    for (int i = 0; i < FIT_UNKNOWNS; i++) {
        double sum = -e->b[i];
        for (int k = 0; k < i; k++) sum -= L[i][k] * x[k];
        x[i] = sum / L[i][i];
    }
    for (int i = FIT_UNKNOWNS - 1; i >= 0; i--) {
        double sum = x[i];
        for (int k = i + 1; k < FIT_UNKNOWNS; k++) sum -= L[k][i] * x[k];
        x[i] = sum / L[i][i];
    }
    return true;
}

/* Angles move by half a radian at most, the body by a fifth of its distance: longer steps are wrong. */
static void shorten(const fit_state *s, double step[FIT_UNKNOWNS]) {
    double max = 0;
    for (int i = 0; i < BODY_SHAPE; i++) max = fmax(max, fabs(step[i]) / 0.5);
    for (int i = BODY_SHAPE; i < BODY_SHIFT; i++) max = fmax(max, fabs(step[i]));
    for (int k = 0; k < 3; k++) max = fmax(max, fabs(step[BODY_SHIFT + k]) / (0.2 * s->body.pelvis_m[2]));
    for (int i = BODY_UNKNOWNS; i < FIT_UNKNOWNS; i++) max = fmax(max, fabs(step[i]) / 0.2);
    for (int i = 0; i < FIT_UNKNOWNS && max > 1; i++) step[i] /= max;
}

double fit_solve(fit_problem *p, fit_state *s, int steps, fit_equations *e) {
    double L[FIT_UNKNOWNS][FIT_UNKNOWNS], step[FIT_UNKNOWNS], damping = 1e-3, before = fit_cost(p, s, e);
    for (int n = 0; n < steps; n++) {
        double cost = INFINITY;
        fit_state next = *s;
        for (int tries = 0; tries < 6; tries++, damping *= 8) {
            if (!step_of(e, damping, L, step)) continue;
            shorten(s, step);
            next = *s;
            body_state_move(&s->body, step, &next.body);
            next.pitch += step[FIT_PITCH];
            next.roll += step[FIT_ROLL];
            next.log_focal += step[FIT_FOCAL];
            next.log_scale += step[FIT_SCALE];
            next.clothes += step[FIT_CLOTHES];
            cost = next.body.pelvis_m[2] > 0.05 ? fit_cost(p, &next, NULL) : INFINITY;
            if (cost < before) break;
        }
        if (!(cost < before)) break;
        *s = next;
        damping = fmax(damping / 5, 1e-6);
        bool done = before - cost < 1e-4 * before;
        if (n + 1 < steps && !done) fit_cost(p, s, e);
        before = cost;
        if (done) break;
    }
    return before;
}
