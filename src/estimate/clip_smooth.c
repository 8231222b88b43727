/* From a body in every frame to a motion: smooths, fills gaps and holds standing feet in place. All of it by
 * least squares with a penalty on accelerations, which looks as far ahead as back and leaves a steady motion
 * unchanged. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "estimate/clip_inside.h"

/* Above these frequencies there is more noise than motion. */
static const double cut_limbs_hz = 3.5, cut_trunk_hz = 2.5, cut_root_hz = 3.5, cut_across_hz = 3,
                    cut_depth_hz = 0.9, cut_held_hz = 4;
/* Over longer times than this (twice that in depth) the picture wins where standing feet say otherwise. */
static const double held_s = 0.2;
static const double turn_tail_rad = 0.35, root_tail_rad = 0.7,
                    place_tail = 0.03; /* larger distances are mistakes */
enum { ROUNDS = 3 };

double path_stiffness(double fps, double cut_hz) {
    const double w = fps / (2 * M_PI * cut_hz);
    return w * w * w * w;
}

/* The matrix has five diagonals: diagonal d, below the main one, is band[i][d]; L D L^T in place. */
static void factor(double (*band)[3], int count) {
    for (int i = 0; i < count; i++) {
        /* rows i - 1 and i - 2 hold their D in [0] and L in [1] (of i) and [2] */
        double l2 = i >= 2 ? band[i][2] / band[i - 2][0] : 0;
        double l1 = i >= 1 ? band[i][1] - (i >= 2 ? l2 * band[i - 2][0] * band[i - 1][1] : 0) : 0;
        if (i >= 1) l1 /= band[i - 1][0];
        band[i][0] -= (i >= 1 ? l1 * l1 * band[i - 1][0] : 0) + (i >= 2 ? l2 * l2 * band[i - 2][0] : 0);
        band[i][1] = l1;
        band[i][2] = l2;
    }
}

static void solve(const double (*band)[3], int count, int dims, int k, double *x) {
    for (int i = 0; i < count; i++) {
        double sum = x[i * dims + k];
        if (i >= 1) sum -= band[i][1] * x[(i - 1) * dims + k];
        if (i >= 2) sum -= band[i][2] * x[(i - 2) * dims + k];
        x[i * dims + k] = sum;
    }
    for (int i = 0; i < count; i++) x[i * dims + k] /= band[i][0];
    for (int i = count - 1; i >= 0; i--) {
        double sum = x[i * dims + k];
        if (i + 1 < count) sum -= band[i + 1][1] * x[(i + 1) * dims + k];
        if (i + 2 < count) sum -= band[i + 2][2] * x[(i + 2) * dims + k];
        x[i * dims + k] = sum;
    }
}

sherf_status path_solve(context *c, const path_problem *p, double *out) {
    static const double second[3] = {1, -2, 1};
    const int n = p->count;
    double(*band)[3] = mem_zero(c, (size_t)n, sizeof *band);
    if (!band) return SHERF_NO_MEMORY;
    for (int i = 0; i < n; i++) {
        band[i][0] += p->weight[i];
        for (int k = 0; k < p->dims; k++) out[i * p->dims + k] = p->weight[i] * p->value[i * p->dims + k];
    }
    for (int i = 0; i + 2 < n; i++)
        for (int a = 0; a < 3; a++)
            for (int b = 0; b <= a; b++) band[i + a][a - b] += p->stiffness * second[a] * second[b];
    for (int i = 0; p->pull && i + 1 < n; i++) {
        band[i][0] += p->pull[i];
        band[i + 1][0] += p->pull[i];
        band[i + 1][1] -= p->pull[i];
        for (int k = 0; k < p->dims; k++) {
            const double force = p->pull[i] * p->step[i * p->dims + k];
            out[i * p->dims + k] -= force;
            out[(i + 1) * p->dims + k] += force;
        }
    }
    factor(band, n);
    for (int k = 0; k < p->dims; k++) solve((const double(*)[3])band, n, p->dims, k, out);
    mem_free(band);
    return SHERF_OK;
}

/* ---- rotations ---- */

typedef struct {
    const body_model *body;
    const clip_track *t;
    const body_fit_result *known;
    skeleton skeleton;
    clip clip; /* in the camera's place, upright: its pelvis_m from there */
    int first, count;
    double smooth;
    double *weight, *value, *out, *robust; /* scratch, count x 4 */
    double (*place)[3];                    /* pelvis */
} settling;

static const clip_frame *frame_of(const settling *s, int i) {
    const clip_frame *f = s->t->frame[s->first + i];
    return f && f->fitted ? f : NULL;
}

static double cut(const settling *s, double usual_hz) {
    return usual_hz / (s->smooth > 0 ? s->smooth : 1);
}

/* The landmark (of the left side) whose visibility says how well a joint is known; -1: other landmarks do. */
static const int8_t tells[BODY_JOINTS] = {-1, 25, 25, -1, 27, 27, -1, 31, 31, -1, 31, 31,
                                          -1, -1, -1, -1, 13, 13, 15, 15, 19, 19, 19, 19};

static double known_of(const clip_frame *f, int joint) {
    static const uint8_t is_right[BODY_JOINTS] = {
        [2] = 1, [5] = 1, [8] = 1, [11] = 1, [17] = 1, [19] = 1, [21] = 1, [23] = 1};
    double certainty = f->fit.poor ? 0.3 : 1;
    if (tells[joint] < 0) return certainty;
    const landmark *l = &f->landmark[tells[joint] + is_right[joint]];
    return certainty * (0.1 + 0.9 * (double)(l->visible * l->present));
}

/* Smooths quaternions as plain numbers, each with the sign that is nearest to the one before; then normalises
 * them. */
static sherf_status smooth_joint(context *c, settling *s, int joint) {
    const double cut_hz = !joint ? cut_root_hz : tells[joint] >= 0 ? cut_limbs_hz : cut_trunk_hz;
    const double tail = joint ? turn_tail_rad : root_tail_rad;
    const path_problem p = {.count = s->count,
                            .dims = 4,
                            .stiffness = path_stiffness(s->t->fps, cut(s, cut_hz)),
                            .weight = s->robust,
                            .value = s->value};
    float before[4] = {1, 0, 0, 0};
    sherf_status status = SHERF_OK;
    for (int i = 0; i < s->count; i++) {
        const clip_frame *f = frame_of(s, i);
        s->weight[i] = s->robust[i] = f ? known_of(f, joint) : 0;
        if (!f) continue;
        double v[3], side = 0;
        float q[4];
        for (int k = 0; k < 3; k++) v[k] = (double)f->fit.pose.poses_rad[3 * joint + k];
        quaternion_from_axis_angle(v, q);
        for (int k = 0; k < 4; k++) side += (double)(q[k] * before[k]);
        for (int k = 0; k < 4; k++) s->value[4 * i + k] = (double)(before[k] = side < 0 ? -q[k] : q[k]);
    }
    for (int round = 0; round < (s->smooth < 0 ? 1 : ROUNDS) && status == SHERF_OK; round++) {
        path_problem now = p;
        if (s->smooth < 0) now.stiffness = 1e-6; /* gaps are filled even so */
        status = path_solve(c, &now, s->out);
        for (int i = 0; i < s->count && status == SHERF_OK; i++) {
            double length = 0, along = 0;
            for (int k = 0; k < 4; k++) length += s->out[4 * i + k] * s->out[4 * i + k];
            length = sqrt(fmax(length, 1e-12));
            for (int k = 0; k < 4; k++) {
                s->out[4 * i + k] /= length;
                along += s->out[4 * i + k] * s->value[4 * i + k];
            }
            const double off = 2 * acos(fmin(1, fabs(along))) / tail;
            s->robust[i] = s->weight[i] / (1 + off * off);
            for (int k = 0; k < 4; k++) s->clip.turn[i][joint][k] = (float)s->out[4 * i + k];
        }
    }
    return status;
}

/* ---- the place ---- */

/* Directions are seen well, distances badly, so each has its own band. In the camera's frame. */
static sherf_status smooth_place(context *c, settling *s) {
    const sherf_camera *k = NULL;
    float R[9];
    for (int i = 0; i < s->count; i++) {
        const clip_frame *f = frame_of(s, i);
        s->weight[i] = f ? (f->fit.poor ? 0.3 : 1) : 0;
        if (!f) continue;
        double x[3];
        k = &f->fit.camera;
        memcpy(R, k->R, sizeof R);
        for (int a = 0; a < 3; a++) {
            x[a] = (double)k->T_m[a];
            for (int b = 0; b < 3; b++)
                x[a] += (double)k->R[3 * a + b] * ((double)f->fit.pose.Th_m[b] + s->skeleton.rest_m[0][b]);
        }
        for (int a = 0; a < 2; a++) s->place[i][a] = x[a] / x[2];
        s->place[i][2] = log(x[2]);
    }
    for (int a = 0; a < 3; a++) {
        path_problem p = {.count = s->count,
                          .dims = 1,
                          .stiffness =
                              path_stiffness(s->t->fps, cut(s, a == 2 ? cut_depth_hz : cut_across_hz)),
                          .weight = s->robust,
                          .value = s->value};
        if (s->smooth < 0) p.stiffness = 1e-6;
        for (int i = 0; i < s->count; i++) s->value[i] = s->place[i][a], s->robust[i] = s->weight[i];
        for (int round = 0; round < (s->smooth < 0 ? 1 : ROUNDS); round++) {
            sherf_status status = path_solve(c, &p, s->out);
            if (status != SHERF_OK) return status;
            for (int i = 0; i < s->count; i++) {
                const double off = (s->out[i] - s->value[i]) / place_tail;
                s->robust[i] = s->weight[i] / (1 + off * off);
            }
        }
        for (int i = 0; i < s->count; i++) s->place[i][a] = s->out[i];
    }
    for (int i = 0; i < s->count; i++) {
        const double z = exp(s->place[i][2]), x[3] = {s->place[i][0] * z, s->place[i][1] * z, z};
        for (int a = 0; a < 3; a++)
            s->place[i][a] = (double)R[a] * x[0] + (double)R[3 + a] * x[1] + (double)R[6 + a] * x[2];
    }
    return SHERF_OK;
}

/* ---- feet ---- */

static double fade(double x, double full, double none) {
    return fmin(1, fmax(0, (none - x) / (none - full)));
}

typedef struct {
    double foot[2][3], low[2], lowest; /* middle of the sole, its lowest part, the body's; from the pelvis */
} stance;

static void stance_of(const settling *s, int i, stance *out) {
    static const float none[3];
    static const double up[3] = {0, 1, 0};
    double joint[BODY_JOINTS][3];
    const skeleton *k = &s->skeleton;
    skeleton_joints(k, (const float(*)[4])s->clip.turn[i], none, joint);
    for (int side = 0; side < 2; side++) {
        const double *ankle = joint[7 + side], *toe = joint[10 + side];
        for (int a = 0; a < 3; a++) out->foot[side][a] = 0.5 * (ankle[a] + toe[a]);
        out->low[side] = fmin(ankle[1] - k->radius_m[7 + side], toe[1] - k->radius_m[10 + side]);
    }
    out->lowest = skeleton_lowest(k, (const float(*)[4])s->clip.turn[i], none, up);
}

/* How likely a foot carries the body between frame i and the next: it is the lowest part, and slow. */
static double carries(const settling *s, const stance *st, int i, int side) {
    double speed = 0;
    for (int a = 0; a < 3; a++) {
        const double d = s->place[i + 1][a] + st[i + 1].foot[side][a] - s->place[i][a] - st[i].foot[side][a];
        speed += d * d;
    }
    speed = sqrt(speed) * s->t->fps;
    return fade(speed, 0.35, 0.9) * fade(st[i].low[side] - st[i].lowest, 0.03, 0.09) *
           fade(st[i + 1].low[side] - st[i + 1].lowest, 0.03, 0.09);
}

/* Steps of the pelvis according to the carrying feet, into pull and step (rows of 3); floor: the height under
 * them. */
static void find_steps(settling *s, const stance *st, double *pull, double (*step)[3]) {
    memset(pull, 0, (size_t)s->count * sizeof *pull);
    for (int i = 0; i + 1 < s->count; i++) {
        double sum = 0;
        memset(step[i], 0, sizeof step[i]);
        for (int side = 0; side < 2; side++) {
            const double certainty = carries(s, st, i, side);
            sum += certainty;
            for (int a = 0; a < 3; a++)
                step[i][a] -= certainty * (st[i + 1].foot[side][a] - st[i].foot[side][a]);
        }
        for (int a = 0; a < 3 && sum > 0; a++) step[i][a] /= sum;
        pull[i] = fmin(1, sum);
    }
}

static int by_value(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

/* The median height of the lowest part, over frames in which a foot carries, if there are any. */
static double find_floor(settling *s, const stance *st, const double *pull) {
    int count = 0;
    for (int round = 0; round < 2 && !count; round++)
        for (int i = 0; i < s->count; i++)
            if (round || pull[i] > 0.5) s->value[count++] = s->place[i][1] + st[i].lowest;
    qsort(s->value, (size_t)count, sizeof *s->value, by_value);
    return s->value[count / 2];
}

/* Horizontally, carrying feet give the pelvis' movement; vertically, they are on the floor. */
static sherf_status hold_feet(context *c, settling *s) {
    const double stiffness = path_stiffness(s->t->fps, cut(s, cut_held_hz));
    const double held = s->t->fps * s->t->fps * held_s * held_s;
    sherf_status status = SHERF_NO_MEMORY;
    stance *st = mem_alloc(c, (size_t)s->count, sizeof *st);
    double *pull = mem_alloc(c, (size_t)s->count, sizeof *pull);
    double(*step)[3] = mem_alloc(c, (size_t)s->count, sizeof *step), floor_m;
    if (!st || !pull || !step) goto done;
    for (int i = 0; i < s->count; i++) stance_of(s, i, &st[i]);
    find_steps(s, st, pull, step);
    floor_m = find_floor(s, st, pull);
    for (int a = 0; a < 3; a++) {
        path_problem p = {
            .count = s->count, .dims = 1, .stiffness = stiffness, .weight = s->weight, .value = s->value};
        for (int i = 0; i < s->count; i++) {
            double stands = i + 1 < s->count ? pull[i] : 0;
            if (i > 0) stands = fmax(stands, pull[i - 1]);
            /* a person close above the floor is on it, sliding or not */
            stands = fmax(stands, fade(fabs(s->place[i][1] + st[i].lowest - floor_m), 0.05, 0.12));
            s->value[i] = s->place[i][a];
            s->weight[i] = a == 2 ? 0.3 : 1; /* the camera looks along -z */
            if (a == 1) s->value[i] += stands * (floor_m - st[i].lowest - s->value[i]);
            if (a == 1) s->weight[i] += 4 * stands;
        }
        double *steps = s->robust;
        for (int i = 0; i < s->count; i++) steps[i] = step[i][a];
        if (a != 1) {
            for (int i = 0; i < s->count; i++) pull[i] *= held;
            p.pull = pull;
            p.step = steps;
        }
        status = path_solve(c, &p, s->out);
        if (a != 1)
            for (int i = 0; i < s->count; i++) pull[i] /= held;
        if (status != SHERF_OK) goto done;
        for (int i = 0; i < s->count; i++) s->place[i][a] = s->out[i];
    }
    for (int i = 0; i < s->count; i++) s->place[i][1] -= floor_m;
done:
    mem_free(st);
    mem_free(pull);
    mem_free(step);
    return status;
}

/* ---- all of it ---- */

static sherf_status settle(context *c, settling *s) {
    const size_t n = (size_t)s->count;
    sherf_status status = clip_create(c, s->count, s->t->fps, &s->clip);
    if (status != SHERF_OK) return status;
    s->weight = mem_zero(c, n, sizeof *s->weight);
    s->robust = mem_zero(c, n, sizeof *s->robust);
    s->value = mem_zero(c, n, 4 * sizeof *s->value);
    s->out = mem_zero(c, n, 4 * sizeof *s->out);
    s->place = mem_zero(c, n, sizeof *s->place);
    if (!s->weight || !s->robust || !s->value || !s->out || !s->place) return SHERF_NO_MEMORY;
    for (int j = 0; j < BODY_JOINTS && status == SHERF_OK; j++) status = smooth_joint(c, s, j);
    if (status == SHERF_OK) status = smooth_place(c, s);
    if (status == SHERF_OK) status = hold_feet(c, s);
    for (int i = 0; i < s->count && status == SHERF_OK; i++)
        for (int a = 0; a < 3; a++)
            s->clip.pelvis_m[i][a] = (float)(s->place[i][a] - (a == 1 ? 0 : s->place[0][a]));
    return status;
}

sherf_status clip_settle(context *c, const body_model *body, const clip_track *t, int first, int last,
                         const body_fit_result *known, double smooth, sherf_motion **out) {
    settling s = {
        .body = body, .t = t, .known = known, .first = first, .count = last - first + 1, .smooth = smooth};
    *out = NULL;
    skeleton_of(body, known->pose.shapes, &s.skeleton);
    sherf_status status = settle(c, &s);
    sherf_motion *motion = status == SHERF_OK ? mem_zero(c, 1, sizeof *motion) : NULL;
    if (status == SHERF_OK && !motion) status = SHERF_NO_MEMORY;
    if (motion) {
        motion->clip = s.clip;
        motion->skeleton = s.skeleton;
        motion->file_has_shapes = true;
        memcpy(motion->shapes, known->pose.shapes, sizeof motion->shapes);
        memcpy(motion->file_shapes, known->pose.shapes, sizeof motion->file_shapes);
        snprintf(motion->description, sizeof motion->description,
                 "estimated from a video: %d frames, %.4g a second, y up, metres, with a body shape", s.count,
                 t->fps);
        *out = motion;
    } else {
        clip_free(&s.clip);
    }
    mem_free(s.weight);
    mem_free(s.robust);
    mem_free(s.value);
    mem_free(s.out);
    mem_free(s.place);
    return status;
}
