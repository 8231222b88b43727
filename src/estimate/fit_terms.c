/* The terms of the fit's cost. Each has rows of residuals in units of their spread, with derivatives by the
 * unknowns. Robust ones count k^2 log(1 + r^2 / k^2) instead of r^2 ("tail" k), so that outliers lose weight.
 */
#include <math.h>
#include <string.h>

#include "base/vector3.h"
#include "estimate/fit_inside.h"

/* ---- rows ---- */

typedef struct {
    fit_problem *p;
    const fit_state *s;
    fit_equations *e; /* NULL: only computes the cost */
    double cost, up[3], up_pitch[3], up_roll[3], focal;
} terms;

typedef double row[FIT_UNKNOWNS];

/* tail 0: squares. */
static void add(terms *t, int rows, const double *r, const row *slope, double weight, double tail) {
    double squared = 0, keep = 1;
    for (int i = 0; i < rows; i++) squared += r[i] * r[i];
    if (tail > 0) {
        keep = 1 / (1 + squared / (tail * tail));
        t->cost += weight * tail * tail * log1p(squared / (tail * tail));
    } else {
        t->cost += weight * squared;
    }
    if (!t->e) return;
    for (int i = 0; i < rows; i++) {
        int at[FIT_UNKNOWNS], n = 0;
        for (int u = 0; u < FIT_UNKNOWNS; u++)
            if (slope[i][u] != 0) at[n++] = u;
        for (int a = 0; a < n; a++) {
            double g = weight * keep * slope[i][at[a]];
            t->e->b[at[a]] += g * r[i];
            double *A = t->e->A[at[a]];
            for (int b = 0; b <= a; b++) A[at[b]] += g * slope[i][at[b]];
        }
    }
}

static const double *mark(const terms *t, int i) {
    return t->p->mark_place + 3 * i;
}

/* into += scale * d (coordinate k of a mark) */
static void mark_slope(const terms *t, int i, int k, double scale, row into) {
    if (!t->e || scale == 0) return;
    const double *d = t->p->mark_slope + ((size_t)i * 3 + (size_t)k) * BODY_UNKNOWNS;
    for (int u = 0; u < BODY_UNKNOWNS; u++) into[u] += scale * d[u];
}

/* ---- the picture ---- */

/* A point's pixel, and the slopes of its two coordinates times `scale`. x: its place; d: 3 x BODY_UNKNOWNS.
 */
static void project(const terms *t, const double *x, const double *d, double scale, double px[2],
                    row slope[2]) {
    double z = fmax(x[2], 0.1);
    for (int k = 0; k < 2; k++) {
        px[k] = t->focal * x[k] / z + t->p->centre_px[k];
        if (!slope) continue;
        double by_x = scale * t->focal / z, by_z = -by_x * x[k] / z;
        for (int u = 0; u < BODY_UNKNOWNS; u++)
            slope[k][u] = by_x * d[k * BODY_UNKNOWNS + u] + by_z * d[2 * BODY_UNKNOWNS + u];
        for (int u = BODY_UNKNOWNS; u < FIT_UNKNOWNS; u++) slope[k][u] = 0;
        slope[k][FIT_FOCAL] = scale * t->focal * x[k] / z;
    }
}

static void landmarks_in_picture(terms *t) {
    const fit_problem *p = t->p;
    for (int l = 0; l < LANDMARKS && p->weight_2d > 0; l++) {
        if (!(p->seen[l] > 0)) continue;
        double scale = 1 / (fit_landmarks[l].spread_m * p->px_per_m), px[2], r[2];
        row slope[2];
        project(t, mark(t, l), p->mark_slope + (size_t)l * 3 * BODY_UNKNOWNS, scale, px, t->e ? slope : NULL);
        for (int k = 0; k < 2; k++) r[k] = scale * (px[k] - (double)p->in->person->landmark[l].place_px[k]);
        add(t, 2, r, (const row *)slope, p->weight_2d * p->seen[l], 2.5);
    }
}

/* ---- landmarks in 3D ---- */

static void landmark_in_3d(terms *t, int l) {
    const fit_problem *p = t->p;
    const fit_landmark *f = &fit_landmarks[l];
    const double *x = mark(t, l), *a = mark(t, LANDMARK_LEFT_HIP), *b = mark(t, LANDMARK_RIGHT_HIP);
    const float *at = p->in->person->landmark[l].place_m;
    const double scale = exp(t->s->log_scale), place[3] = {(double)at[0], (double)at[1], p->depth_m[l]};
    double r[3];
    row slope[3] = {{0}};
    for (int i = 0; i < 3; i++) {
        const double spread = i == 2 ? f->along_m : f->across_m;
        double sum = -scale * place[i];
        slope[i][FIT_SCALE] = sum / spread;
        for (int k = 0; k < 3; k++) {
            const double turned = p->ray[3 * k + i]; /* the ray's axis i in the camera's frame */
            sum += turned * (x[k] - 0.5 * (a[k] + b[k]));
            mark_slope(t, l, k, turned / spread, slope[i]);
            mark_slope(t, LANDMARK_LEFT_HIP, k, -0.5 * turned / spread, slope[i]);
            mark_slope(t, LANDMARK_RIGHT_HIP, k, -0.5 * turned / spread, slope[i]);
        }
        r[i] = sum / spread;
    }
    add(t, 3, r, (const row *)slope, p->weight_3d * p->seen_3d[l], 2.5);
}

/* ---- priors of poses and shapes ---- */

static void one(terms *t, int unknown, double value, double spread, double weight, double tail) {
    row slope = {0};
    slope[unknown] = 1 / spread;
    double r = value / spread;
    add(t, 1, &r, (const row *)&slope, weight, tail);
}

/* Pulls towards the poses that people are photographed in. A pose unlike any of them costs less than its
 * square: tail. */
static void usual_pose(terms *t, double weight, double tail) {
    enum { N = FIT_POSE_NUMBERS, TILT = N - 2 };
    const double *root = t->s->body.root;
    double x[N], r[N], cost, axis[2][3], squared = 0;
    for (int i = 0; i < TILT; i++) x[i] = t->s->body.bend[fit_pose_joint[i / 3]][i % 3];
    for (int i = 0; i < 2; i++) {
        for (int k = 0; k < 3; k++) axis[i][k] = root[3 * k + 2 * i];
        x[TILT + i] = dot3(axis[i], t->up);
    }
    const fit_pose_kind *kind = fit_pose_nearest(x, r, &cost);
    for (int i = 0; i < N; i++) squared += r[i] * r[i];
    t->cost += weight * (kind->cost + tail * tail * log1p(squared / (tail * tail)));
    if (!t->e) return;
    const double keep = weight / (1 + squared / (tail * tail)), before = t->cost;
    const int16_t *whiten = kind->whiten;
    for (int i = 0; i < N; i++) {
        row slope = {0};
        for (int j = i; j < N; j++) {
            double w = FIT_POSE_WHITEN_UNIT * *whiten++;
            if (j < TILT) {
                slope[BODY_BEND + 3 * (fit_pose_joint[j / 3] - 1) + j % 3] = w;
                continue;
            }
            const double *a = axis[j - TILT];
            for (int k = 0; k < 3; k++) /* d (axis . up) = turn . (axis x up) */
                slope[BODY_TURN + k] +=
                    w * (a[(k + 1) % 3] * t->up[(k + 2) % 3] - a[(k + 2) % 3] * t->up[(k + 1) % 3]);
            slope[FIT_PITCH] += w * dot3(a, t->up_pitch);
            slope[FIT_ROLL] += w * dot3(a, t->up_roll);
        }
        add(t, 1, &r[i], (const row *)&slope, keep, 0);
    }
    t->cost = before; /* counted already */
}

const float *fit_shape(const body_fit_input *in) {
    return in->known ? in->known->pose.shapes : in->shape;
}

static void priors(terms *t) {
    const fit_problem *p = t->p;
    usual_pose(t, 0.4, 15);
    for (int j = 1; j < BODY_JOINTS; j++)
        for (int k = 0; k < 3; k++) {
            const fit_joint *f = &fit_joints[j];
            double x = t->s->body.bend[j][k];
            int u = BODY_BEND + 3 * (j - 1) + k;
            if (j == 10 || j == 11) one(t, u, x, k ? 0.02 : 0.05, 1, 2); /* toes */
            if (j >= 22) one(t, u, x, 0.01, 1, 2);                       /* hands */
            if (x < f->lowest[k]) one(t, u, x - f->lowest[k], 0.05, 1, 0);
            if (x > f->highest[k]) one(t, u, x - f->highest[k], 0.05, 1, 0);
        }
    const body_fit_result *known = p->in->known;
    const float *shape = fit_shape(p->in);
    const double sure = 1e-3;
    for (int b = 0; b < BODY_SHAPES; b++)
        one(t, BODY_SHAPE + b, t->s->body.shape[b] - (shape ? (double)shape[b] : 0),
            shape ? sure
            : b   ? 0.7
                  : 0.9,
            1, 0);
    one(t, FIT_PITCH, t->s->pitch - (known ? known->pitch_rad : 0.12), known ? sure : 0.15, 1, 0);
    one(t, FIT_ROLL, t->s->roll - (known ? known->roll_rad : 0), known ? sure : 0.06, 1, 0);
    one(t, FIT_FOCAL, t->s->log_focal - log(p->focal_guess_px), p->focal_spread, 1, 0);
    one(t, FIT_SCALE, t->s->log_scale, 0.05, 1, 0);
    one(t, FIT_CLOTHES, t->s->clothes - 1, 0.5, 1, 0);
}

/* ---- standing ---- */

void fit_up(const fit_state *s, double up[3]) {
    up[0] = sin(s->roll) * cos(s->pitch);
    up[1] = -cos(s->roll) * cos(s->pitch);
    up[2] = -sin(s->pitch);
}

/* A linear combination of marks: v = sum_i share_i mark_i. */
typedef struct {
    int count, mark[2 * BODY_JOINTS];
    double share[2 * BODY_JOINTS];
} blend;

static void take(blend *b, int i, double share) {
    b->mark[b->count] = i;
    b->share[b->count++] = share;
}

static void blend_place(const terms *t, const blend *b, double v[3]) {
    v[0] = v[1] = v[2] = 0;
    for (int i = 0; i < b->count; i++)
        for (int k = 0; k < 3; k++) v[k] += b->share[i] * mark(t, b->mark[i])[k];
}

/* The row (axis . v - aim) / spread. The axis turns with `up`: `along` is the derivative of the row, before
 * the division, by a small change of `up`. */
static void along_axis(terms *t, const blend *b, const double axis[3], double aim, const double along[3],
                       double spread, double weight, double tail) {
    double v[3], r;
    row slope = {0};
    blend_place(t, b, v);
    r = (dot3(axis, v) - aim) / spread;
    for (int i = 0; i < b->count && t->e; i++)
        for (int k = 0; k < 3; k++) mark_slope(t, b->mark[i], k, b->share[i] * axis[k] / spread, slope);
    slope[FIT_PITCH] = dot3(along, t->up_pitch) / spread;
    slope[FIT_ROLL] = dot3(along, t->up_roll) / spread;
    add(t, 1, &r, (const row *)&slope, weight, tail);
}

/* v has no part along a horizontal direction d. With up, d turns: dd = -(d . dup) up. */
static void level(terms *t, const blend *b, const double d[3], double aim, double spread, double weight,
                  double tail) {
    double v[3], along[3];
    blend_place(t, b, v);
    for (int k = 0; k < 3; k++) along[k] = -dot3(t->up, v) * d[k];
    along_axis(t, b, d, aim, along, spread, weight, tail);
}

static void upright(terms *t, const blend *b, double spread, double weight, double tail) {
    double v[3];
    blend_place(t, b, v);
    along_axis(t, b, t->up, 0, v, spread, weight, tail);
}

/* The place where a foot carries: 5 cm in front of the ankle. */
static void take_foot(blend *b, int side, double share) {
    take(b, LANDMARK_LEFT_HEEL + side, 0.55 * share);
    take(b, LANDMARK_LEFT_TOE + side, 0.45 * share);
}

/* A person on straight legs is carried by the feet: the centre of mass is above the line between them, soles
 * and ankles are level, and the trunk leans little. */
static void standing(terms *t) {
    double weight = t->p->stands, apart[3], v[3], line[3], across[3], half;
    if (!(weight > 0)) return;
    blend feet = {0}, mass = {0}, ankles = {0};
    take_foot(&feet, 0, 1);
    take_foot(&feet, 1, -1);
    blend_place(t, &feet, apart);
    double rise = dot3(apart, t->up);
    for (int k = 0; k < 3; k++) line[k] = apart[k] - rise * t->up[k];
    half = 0.5 * sqrt(dot3(line, line));
    if (half < 0.02) { /* side by side in one place: any direction will do */
        double rise_x = t->up[0];
        for (int k = 0; k < 3; k++) line[k] = (k == 0) - rise_x * t->up[k];
    }
    double length = sqrt(dot3(line, line));
    for (int k = 0; k < 3; k++) line[k] /= length;
    for (int k = 0; k < 3; k++)
        across[k] = t->up[(k + 1) % 3] * line[(k + 2) % 3] - t->up[(k + 2) % 3] * line[(k + 1) % 3];
    for (int j = 0; j < BODY_JOINTS; j++)
        if (fit_mass[j] > 0) take(&mass, LANDMARKS + j, fit_mass[j]);
    for (int side = 0; side < 2; side++) take_foot(&mass, side, -0.5);
    blend_place(t, &mass, v);
    level(t, &mass, across, 0, 0.05, weight, 2);
    double beside = dot3(v, line);
    if (fabs(beside) > half) level(t, &mass, line, beside > 0 ? half : -half, 0.05, weight, 2);
    for (int side = 0; side < 2; side++) {
        blend sole = {0};
        take(&sole, LANDMARK_LEFT_TOE + side, 1);
        take(&sole, LANDMARK_LEFT_HEEL + side, -1);
        upright(t, &sole, 0.025, weight, 1.5);
    }
    take(&ankles, LANDMARKS + 7, 1);
    take(&ankles, LANDMARKS + 8, -1);
    upright(t, &ankles, 0.03, weight, 1.5);
}

/* An upright trunk leans 3 degrees forward, measured from the pelvis to the neck. */
static void trunk_upright(terms *t) {
    const double *root = t->s->body.root, weight = 0.6 * t->p->upright, spread = 0.05;
    double ahead[3] = {root[2], root[5], root[8]}, aside[3], v[3];
    blend trunk = {0};
    if (!(weight > 0)) return;
    double rise = dot3(ahead, t->up);
    for (int k = 0; k < 3; k++) ahead[k] -= rise * t->up[k];
    double length = sqrt(dot3(ahead, ahead));
    if (length < 0.3) return; /* lying */
    for (int k = 0; k < 3; k++) ahead[k] /= length;
    for (int k = 0; k < 3; k++)
        aside[k] = t->up[(k + 1) % 3] * ahead[(k + 2) % 3] - t->up[(k + 2) % 3] * ahead[(k + 1) % 3];
    take(&trunk, LANDMARKS + 12, 1);
    take(&trunk, LANDMARKS, -1);
    blend_place(t, &trunk, v);
    double high = sqrt(dot3(v, v));
    level(t, &trunk, ahead, 0.055 * high, spread, weight, 1.5);
    level(t, &trunk, aside, 0, spread, weight, 1.5);
}

/* ---- the mask ---- */

/* Vertices outside the mask: clothes are wider than the body, so these cost much. */
static void body_in_mask(terms *t, int points, double weight) {
    const fit_problem *p = t->p;
    double spread = 0.012 * p->px_per_m;
    for (int i = 0; i < points; i++) {
        const double *x = p->skin_place + 3 * i;
        double px[2], down[2], r;
        project(t, x, NULL, 0, px, NULL);
        if (px[0] < 0 || px[1] < 0 || px[0] > p->in->width_px - 1 || px[1] > p->in->height_px - 1) continue;
        r = fit_mask_outside(p->mask, px, down) / spread;
        if (r == 0) continue;
        row both[2], slope;
        if (t->e) {
            project(t, x, p->skin_slope + (size_t)i * 3 * BODY_UNKNOWNS, 1 / spread, px, both);
            for (int u = 0; u < FIT_UNKNOWNS; u++) slope[u] = down[0] * both[0][u] + down[1] * both[1][u];
        }
        add(t, 1, &r, (const row *)&slope, weight, 4);
    }
}

/* Places and outward normals, in the picture, of skin on the contour; the normal is 0 elsewhere. */
static void find_contour(fit_problem *p, double focal_px, double (*px)[2], double (*n)[2]) {
    const terms t = {.p = p, .focal = focal_px};
    for (int i = 0; i < body_points_count(p->skin); i++) {
        const double *x = p->skin_place + 3 * i, *B = p->skin_blend + 9 * i, *rest = p->skin_normal[i];
        double normal[3], along = 0, length;
        for (int k = 0; k < 3; k++) normal[k] = dot3(B + 3 * k, rest);
        along = dot3(normal, x) / sqrt(dot3(x, x) * dot3(normal, normal) + 1e-12);
        length = hypot(normal[0], normal[1]);
        project(&t, x, NULL, 0, px[i], NULL);
        bool contour = fabs(along) < 0.5 && length > 0.1;
        n[i][0] = contour ? normal[0] / length : 0;
        n[i][1] = contour ? normal[1] / length : 0;
    }
}

int fit_edges(fit_problem *p, double focal_px, fit_edge *edge) {
    const fit_mask *mask = p->mask;
    const int points = body_points_count(p->skin);
    const double reach = 0.25 * p->px_per_m;
    double(*px)[2] = (double(*)[2])(p->skin_place + 3 * (size_t)points), (*n)[2] = px + points; /* spare */
    int count = 0;
    find_contour(p, focal_px, px, n);
    for (int o = 0; o < mask->outline; o++) {
        int best = -1;
        double nearest = reach * reach;
        for (int i = 0; i < points; i++) {
            double alike = n[i][0] * mask->normal[o][0] + n[i][1] * mask->normal[o][1];
            if (alike < 0.6) continue;
            double dx = px[i][0] - mask->point_px[o][0], dy = px[i][1] - mask->point_px[o][1];
            if (dx * dx + dy * dy < nearest) nearest = dx * dx + dy * dy, best = i;
        }
        if (best < 0) continue;
        edge[count++] = (fit_edge){o, best,
                                   (px[best][0] - mask->point_px[o][0]) * mask->normal[o][0] +
                                       (px[best][1] - mask->point_px[o][1]) * mask->normal[o][1]};
    }
    return count;
}

/* Expects the mask's edge as far beyond the body's contour as clothes, hair and soles usually reach there.
 * Wider clothes cost less than narrower ones. */
static void edge_on_body(terms *t, double weight) {
    fit_problem *p = t->p;
    fit_edge edge[FIT_OUTLINE_MAX];
    const int count = fit_edges(p, t->focal, edge);
    for (int k = 0; k < count; k++) {
        const int i = edge[k].skin;
        const double *normal = p->mask->normal[edge[k].outline],
                     clothes_px = p->skin_clothes_m[i] * p->px_per_m,
                     off = edge[k].off_px + t->s->clothes * clothes_px,
                     spread = (off > 0 ? 0.01 : 0.015) * p->px_per_m, r = off / spread;
        double px[2];
        row both[2], slope;
        if (t->e) {
            project(t, p->skin_place + 3 * i, p->skin_slope + (size_t)i * 3 * BODY_UNKNOWNS, 1 / spread, px,
                    both);
            for (int u = 0; u < FIT_UNKNOWNS; u++) slope[u] = normal[0] * both[0][u] + normal[1] * both[1][u];
            slope[FIT_CLOTHES] = clothes_px / spread;
        }
        add(t, 1, &r, (const row *)&slope, weight, 2);
    }
}

/* ---- all of it ---- */

double fit_cost(fit_problem *p, const fit_state *s, fit_equations *e) {
    terms t = {.p = p, .s = s, .e = e, .focal = exp(s->log_focal)};
    fit_up(s, t.up);
    double cp = cos(s->pitch), sp = sin(s->pitch), cr = cos(s->roll), sr = sin(s->roll);
    const double by_pitch[3] = {-sr * sp, cr * sp, -cp}, by_roll[3] = {cr * cp, sr * cp, 0};
    memcpy(t.up_pitch, by_pitch, sizeof by_pitch);
    memcpy(t.up_roll, by_roll, sizeof by_roll);
    if (e) memset(e, 0, sizeof *e);
    body_points_place(p->marks, &s->body, p->mark_place, e ? p->mark_slope : NULL, NULL);
    landmarks_in_picture(&t);
    for (int l = 0; l < LANDMARKS && p->weight_3d > 0; l++)
        if (p->seen_3d[l] > 0) landmark_in_3d(&t, l);
    priors(&t);
    if (p->weight_2d > 0) {
        standing(&t);
        trunk_upright(&t);
    }
    if (p->mask && p->mask->outline && p->weight_mask > 0) {
        int points = body_points_count(p->skin);
        body_points_place(p->skin, &s->body, p->skin_place, e ? p->skin_slope : NULL, p->skin_blend);
        body_in_mask(&t, points, p->weight_mask / points);
        edge_on_body(&t, p->weight_mask / p->mask->outline);
    }
    if (e) e->cost = t.cost;
    return t.cost;
}
