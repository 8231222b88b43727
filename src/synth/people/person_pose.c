/* Random poses, and given ones. x points to the person's left, y up, z forward; arms rest to the sides. */
#include "synth/people/person_pose.h"

#include <math.h>
#include <string.h>

#include "data/bvh_body.h"

typedef struct {
    char name[32];
    float pose[72];
} posture;

struct pose_library {
    posture *given, *captured;
    int givens, captures;
};

/* ---- limits ---- */
#define BOTH(x0, x1, y0, y1, z0, z1, lowest)                                                                 \
    { (lowest) ? (x0) : (x1), (lowest) ? (y0) : (y1), (lowest) ? (z0) : (z1) }
#define LIMITS(low)                                                                                          \
    {                                                                                                        \
        BOTH(-4, 4, -4, 4, -4, 4, low),                       /* root: free */                               \
            BOTH(-2.2f, 0.7f, -0.8f, 0.8f, -0.4f, 1.1f, low), /* left hip */                                 \
            BOTH(-2.2f, 0.7f, -0.8f, 0.8f, -1.1f, 0.4f, low), /* right hip */                                \
            BOTH(-0.4f, 0.8f, -0.5f, 0.5f, -0.4f, 0.4f, low), /* spine */                                    \
            BOTH(-0.1f, 2.5f, -0.4f, 0.4f, -0.3f, 0.3f, low), /* knees */                                    \
            BOTH(-0.1f, 2.5f, -0.4f, 0.4f, -0.3f, 0.3f, low),                                                \
            BOTH(-0.3f, 0.6f, -0.5f, 0.5f, -0.4f, 0.4f, low),                                                \
            BOTH(-0.8f, 0.9f, -0.5f, 0.5f, -0.5f, 0.5f, low), /* ankles */                                   \
            BOTH(-0.8f, 0.9f, -0.5f, 0.5f, -0.5f, 0.5f, low),                                                \
            BOTH(-0.3f, 0.5f, -0.5f, 0.5f, -0.4f, 0.4f, low),                                                \
            BOTH(-0.7f, 0.4f, -0.2f, 0.2f, -0.2f, 0.2f, low), /* toes */                                     \
            BOTH(-0.7f, 0.4f, -0.2f, 0.2f, -0.2f, 0.2f, low),                                                \
            BOTH(-0.6f, 0.7f, -0.8f, 0.8f, -0.5f, 0.5f, low), /* neck */                                     \
            BOTH(-0.3f, 0.3f, -0.4f, 0.4f, -0.4f, 0.4f, low), /* collars */                                  \
            BOTH(-0.3f, 0.3f, -0.4f, 0.4f, -0.4f, 0.4f, low),                                                \
            BOTH(-0.6f, 0.7f, -0.9f, 0.9f, -0.5f, 0.5f, low),  /* head */                                    \
            BOTH(-1.5f, 1.5f, -2.0f, 1.2f, -1.6f, 1.5f, low),  /* left shoulder */                           \
            BOTH(-1.5f, 1.5f, -1.2f, 2.0f, -1.5f, 1.6f, low),  /* right shoulder */                          \
            BOTH(-1.2f, 1.2f, -2.4f, 0.15f, -0.8f, 0.8f, low), /* left elbow */                              \
            BOTH(-1.2f, 1.2f, -0.15f, 2.4f, -0.8f, 0.8f, low), /* right elbow */                             \
            BOTH(-0.9f, 0.9f, -0.7f, 0.7f, -1.2f, 1.2f, low),  /* wrists */                                  \
            BOTH(-0.9f, 0.9f, -0.7f, 0.7f, -1.2f, 1.2f, low), BOTH(0, 0, 0, 0, 0, 0, low),                   \
            BOTH(0, 0, 0, 0, 0, 0, low),                                                                     \
    }
const float pose_lowest[BODY_JOINTS][3] = LIMITS(true), pose_highest[BODY_JOINTS][3] = LIMITS(false);

bool pose_within(const float pose_rad[72]) {
    for (int j = 1; j < BODY_JOINTS; j++)
        for (int k = 0; k < 3; k++) {
            float a = pose_rad[3 * j + k];
            if (!(a >= pose_lowest[j][k] - 1e-4f && a <= pose_highest[j][k] + 1e-4f)) return false;
        }
    return true;
}

void pose_clamp(float pose_rad[72]) {
    for (int j = 1; j < BODY_JOINTS; j++)
        for (int k = 0; k < 3; k++) { /* fminf and fmaxf may return either zero, but the bits must not vary */
            float *x = &pose_rad[3 * j + k];
            *x = *x > pose_lowest[j][k] ? *x : pose_lowest[j][k];
            *x = *x < pose_highest[j][k] ? *x : pose_highest[j][k];
        }
}

/* ---- small rotations ---- */

static void multiply(const float a[9], const float b[9], float out[9]) {
    float m[9];
    for (int i = 0; i < 9; i++)
        m[i] = a[i / 3 * 3] * b[i % 3] + a[i / 3 * 3 + 1] * b[3 + i % 3] + a[i / 3 * 3 + 2] * b[6 + i % 3];
    memcpy(out, m, sizeof m);
}

/* R = Ry(turn) Rx(swing) Rz(lift) Rx(twist): the twist is about an arm's own axis. */
static void set_joint(float pose[72], int joint, double turn, double swing, double lift, double twist) {
    float axis[4][3] = {{0, (float)turn, 0}, {(float)swing, 0, 0}, {0, 0, (float)lift}, {(float)twist, 0, 0}};
    float R[9], next[9];
    rodrigues(axis[0], R);
    for (int i = 1; i < 4; i++) {
        rodrigues(axis[i], next);
        multiply(R, next, R);
    }
    rotation_to_axis_angle(R, pose + 3 * joint);
}

/* The same on the left (side 0) or, mirrored, on the right (side 1). */
static void set_limb(float pose[72], int left_joint, int side, double turn, double swing, double lift,
                     double twist) {
    double sign = side ? -1 : 1;
    set_joint(pose, left_joint + side, sign * turn, swing, sign * lift, twist);
}

enum { HIP = 1, KNEE = 4, ANKLE = 7, TOE = 10, SHOULDER = 16, ELBOW = 18, WRIST = 20 };
static const int spine[3] = {3, 6, 9};

static double more(double a, double b) {
    return a > b ? a : b;
}

/* ---- curves ---- */

void pose_walk(double phase, double vigour, float pose[72]) {
    memset(pose, 0, 72 * sizeof *pose);
    double t = 2 * M_PI * phase;
    for (int side = 0; side < 2; side++, t += M_PI) {
        double hip = -0.08 - vigour * 0.42 * sin(t), lifted = more(0, cos(t));
        double knee = 0.12 + vigour * (0.75 * lifted * lifted + 0.12 * more(0, -cos(t)) * more(0, sin(t)));
        double push = more(0, -sin(t + 0.5)); /* the heel lifts off behind */
        set_limb(pose, HIP, side, 0.05, hip, 0.03, 0);
        set_limb(pose, KNEE, side, 0, knee, 0, 0);
        set_limb(pose, ANKLE, side, 0,
                 0.08 + vigour * (0.3 * push - 0.12 * lifted) - 0.25 * (hip + knee - 0.1), 0, 0);
        set_limb(pose, TOE, side, 0, -0.35 * vigour * push, 0, 0);
        set_limb(pose, SHOULDER, side, 0, vigour * 0.5 * sin(t), -1.22, 0);
        set_limb(pose, ELBOW, side, -0.25 - vigour * 0.3 * more(0, -sin(t)), 0, 0, 0);
    }
    for (int i = 0; i < 3; i++) set_joint(pose, spine[i], 0.05 * vigour * sin(t) * (i ? 1 : -1), 0.02, 0, 0);
}

static void pose_run(double phase, double vigour, float pose[72]) {
    memset(pose, 0, 72 * sizeof *pose);
    double t = 2 * M_PI * phase;
    for (int side = 0; side < 2; side++, t += M_PI) {
        double hip = -0.3 - vigour * 0.75 * sin(t), lifted = more(0, cos(t + 0.4));
        double knee = 0.45 + vigour * 1.2 * lifted * lifted;
        double push = more(0, -sin(t + 0.3));
        set_limb(pose, HIP, side, 0.05, hip, 0.02, 0);
        set_limb(pose, KNEE, side, 0, knee, 0, 0);
        set_limb(pose, ANKLE, side, 0, -0.05 + vigour * 0.5 * push, 0, 0);
        set_limb(pose, TOE, side, 0, -0.3 * vigour * push, 0, 0);
        set_limb(pose, SHOULDER, side, 0, vigour * 0.75 * sin(t) + 0.15, -1.15, 0);
        set_limb(pose, ELBOW, side, -1.5 - 0.2 * sin(t), 0, 0, 0);
    }
    for (int i = 0; i < 3; i++) set_joint(pose, spine[i], 0.08 * vigour * sin(t) * (i ? 1 : -1), 0.05, 0, 0);
    set_joint(pose, 0, 0, 0.12 * vigour, 0, 0);
    set_joint(pose, 12, 0, -0.15, 0, 0);
}

/* ---- free poses ---- */

typedef struct {
    double low, high;
} range;

/* Postures of people; each side is drawn separately. Legs: forward is negative for hips, bent is positive for
 * knees. Arms: lift 0 is to the side, -1.3 hanging, 1.2 up; swing and turn are negative forward. */
static const struct {
    double share;
    range hip, spread, knee, lift, swing, turn, elbow, bend, root;
} manner[] = {
    /* standing */
    {5,
     {-0.15, 0.1},
     {0.0, 0.18},
     {0, 0.15},
     {-1.35, -1.05},
     {-0.3, 0.25},
     {-0.2, 0.1},
     {0.05, 0.6},
     {-0.05, 0.12},
     {-0.04, 0.06}},
    /* arms away from the body, up or to the front */
    {3,
     {-0.2, 0.1},
     {0.0, 0.25},
     {0, 0.25},
     {-1.2, 0.6},
     {-0.7, 0.5},
     {-1.1, 0.2},
     {0.05, 1.6},
     {-0.08, 0.15},
     {-0.05, 0.08}},
    /* talking: hands before the belly */
    {3,
     {-0.15, 0.1},
     {0.0, 0.2},
     {0, 0.2},
     {-1.3, -0.8},
     {-0.5, 0.1},
     {-0.4, 0.0},
     {0.9, 1.9},
     {-0.05, 0.15},
     {-0.04, 0.06}},
    /* reaching up or forward */
    {2,
     {-0.2, 0.15},
     {0.0, 0.25},
     {0, 0.2},
     {-0.2, 1.25},
     {-0.5, 0.3},
     {-1.4, 0.1},
     {0.05, 0.9},
     {-0.15, 0.2},
     {-0.05, 0.1}},
    /* T and A */
    {1,
     {-0.05, 0.05},
     {0.02, 0.3},
     {0, 0.06},
     {-0.9, 0.15},
     {-0.1, 0.1},
     {-0.15, 0.1},
     {0, 0.15},
     {-0.02, 0.05},
     {-0.02, 0.02}},
    /* a wide stance, a lunge */
    {2,
     {-0.9, 0.35},
     {0.05, 0.5},
     {0.1, 1.0},
     {-1.2, 0.2},
     {-0.7, 0.5},
     {-0.8, 0.2},
     {0.1, 1.5},
     {-0.05, 0.2},
     {-0.05, 0.15}},
    /* crouching, sitting down */
    {1.5,
     {-1.5, -0.6},
     {0.05, 0.35},
     {0.7, 1.8},
     {-1.2, -0.2},
     {-0.9, 0.0},
     {-0.9, 0.0},
     {0.2, 1.3},
     {0.05, 0.3},
     {0.05, 0.4}},
    /* sitting on a chair */
    {2,
     {-1.6, -1.35},
     {0.02, 0.3},
     {1.25, 1.6},
     {-1.3, -0.9},
     {-0.8, -0.1},
     {-0.4, 0.0},
     {0.3, 1.5},
     {-0.05, 0.12},
     {-0.1, 0.1}},
    /* bending to the front */
    {1,
     {-1.0, -0.4},
     {0.0, 0.25},
     {0, 0.5},
     {-1.2, -0.4},
     {-1.0, -0.2},
     {-0.7, 0.0},
     {0.1, 0.9},
     {0.1, 0.35},
     {0.1, 0.4}},
};

typedef struct {
    uint64_t key, next;
} dice;

/* The mean of two draws: the ends of a range are rarer than its middle. */
static double draw(dice *d, range r) {
    double u = 0.5 * (random_uniform(d->key, d->next) + random_uniform(d->key, d->next + 1));
    d->next += 2;
    return r.low + (r.high - r.low) * u;
}

static void posture_pose(uint64_t key, size_t kind, float pose[72]) {
    dice d = {key, 10};
    memset(pose, 0, 72 * sizeof *pose);
    bool alike = random_uniform(key, 1) < 0.3; /* both sides are the same */
    dice sides = d;
    for (int side = 0; side < 2; side++) {
        if (alike) d = sides;
        double hip = draw(&d, manner[kind].hip), knee = draw(&d, manner[kind].knee);
        set_limb(pose, HIP, side, draw(&d, (range){-0.2, 0.35}), hip, draw(&d, manner[kind].spread), 0);
        set_limb(pose, KNEE, side, 0, knee, 0, 0);
        set_limb(pose, ANKLE, side, draw(&d, (range){-0.1, 0.1}),
                 -0.5 * (hip + knee) + draw(&d, (range){-0.15, 0.15}), 0, 0);
        set_limb(pose, 13, side, draw(&d, (range){-0.15, 0.1}), 0, draw(&d, (range){-0.1, 0.15}), 0);
        double turn = draw(&d, manner[kind].turn), swing = draw(&d, manner[kind].swing),
               lift = draw(&d, manner[kind].lift);
        set_limb(pose, SHOULDER, side, turn, swing, lift, draw(&d, (range){-0.5, 0.5}));
        set_limb(pose, ELBOW, side, -draw(&d, manner[kind].elbow), 0, 0, draw(&d, (range){-0.5, 0.5}));
        set_limb(pose, WRIST, side, draw(&d, (range){-0.3, 0.3}), draw(&d, (range){-0.3, 0.3}),
                 draw(&d, (range){-0.5, 0.4}), 0);
    }
    double bend = draw(&d, manner[kind].bend), lean = draw(&d, (range){-0.14, 0.14}),
           turn = draw(&d, (range){-0.25, 0.25});
    for (int i = 0; i < 3; i++) set_joint(pose, spine[i], turn, bend, lean, 0);
    set_joint(pose, 12, draw(&d, (range){-0.45, 0.45}), draw(&d, (range){-0.25, 0.3}),
              draw(&d, (range){-0.2, 0.2}), 0);
    set_joint(pose, 15, draw(&d, (range){-0.45, 0.45}), draw(&d, (range){-0.25, 0.3}),
              draw(&d, (range){-0.2, 0.2}), 0);
    set_joint(pose, 0, 0, draw(&d, manner[kind].root), draw(&d, (range){-0.06, 0.06}), 0);
}

static void free_pose(uint64_t key, float pose[72]) {
    double sum = 0, at = 0;
    size_t kind = 0;
    for (size_t i = 0; i < COUNT_OF(manner); i++) sum += manner[i].share;
    at = sum * random_uniform(key, 0);
    while (kind + 1 < COUNT_OF(manner) && at >= manner[kind].share) at -= manner[kind++].share;
    posture_pose(key, kind, pose);
}

/* Rotates every joint of the posture slightly. */
static void about(const float from[72], uint64_t key, double spread, float pose[72]) {
    for (int j = 0; j < BODY_JOINTS; j++) {
        float turn[3], R[9], S[9];
        double own = j == 0 || j == 10 || j == 11 || j > 21   ? 0
                     : j == 7 || j == 8 || j == 13 || j == 14 ? 0.4
                                                              : 1;
        for (uint64_t k = 0; k < 3; k++)
            turn[k] = (float)(own * spread * random_normal(key, 3 * (uint64_t)j + k));
        rodrigues(from + 3 * j, R);
        rodrigues(turn, S);
        multiply(R, S, R);
        rotation_to_axis_angle(R, pose + 3 * j);
    }
}

/* Left and right exchanged. */
static void mirror(float pose[72]) {
    static const int8_t other[BODY_JOINTS] = {0,  2,  1,  3,  5,  4,  6,  8,  7,  9,  11, 10,
                                              12, 14, 13, 15, 17, 16, 19, 18, 21, 20, 23, 22};
    float was[72];
    memcpy(was, pose, sizeof was);
    for (int j = 0; j < BODY_JOINTS; j++)
        for (int k = 0; k < 3; k++) pose[3 * j + k] = (k ? -1 : 1) * was[3 * other[j] + k];
}

pose_kind pose_draw(const pose_library *l, uint64_t key, float pose[72]) {
    static const double share[POSE_KINDS] = {0.2, 0.08, 0.42, 0.18, 0.12};
    double at = random_uniform(key, 0);
    int kind = 0;
    while (kind + 1 < POSE_KINDS && at >= share[kind]) at -= share[kind++];
    if ((kind == POSE_POSTURE && !l->givens) || (kind == POSE_CAPTURED && !l->captures)) kind = POSE_FREE;
    uint64_t own = random_key(key, "pose", (uint64_t)kind);
    double phase = random_uniform(own, 0), vigour = 0.55 + 0.6 * random_uniform(own, 1);
    if (kind == POSE_WALK) {
        pose_walk(phase, vigour, pose);
        about(pose, own + 99, 0.06, pose);
    } else if (kind == POSE_RUN) {
        pose_run(phase, vigour, pose);
        about(pose, own + 99, 0.06, pose);
    } else if (kind == POSE_POSTURE) {
        about(l->given[random_below(own, 2, l->givens)].pose, own + 99, 0.1, pose);
    } else if (kind == POSE_CAPTURED) {
        about(l->captured[random_below(own, 2, l->captures)].pose, own + 99, 0.05, pose);
    } else {
        free_pose(own, pose);
    }
    if (random_uniform(own, 3) < 0.5) mirror(pose);
    pose_clamp(pose);
    return (pose_kind)kind;
}

/* ---- for photos ---- */

void pose_draw_photo(const pose_library *l, uint64_t key, float pose[72]) {
    enum { STANDS = 0, TALKS = 2 };
    const float straight = 0.4f; /* free poses bend the spine by this share */
    double what = random_uniform(key, 0);
    uint64_t own = random_key(key, "pose.photo", 0);
    if (what >= 0.75) {
        pose_draw(l, own, pose);
        return;
    }
    if (what < 0.5) {
        posture_pose(own, what < 0.35 ? STANDS : TALKS, pose);
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++) pose[3 * spine[i] + k] *= straight;
    } else {
        pose_walk(random_uniform(own, 0), 0.4 + 0.5 * random_uniform(own, 1), pose);
        about(pose, own + 99, 0.05, pose);
    }
    pose_clamp(pose);
}

float pose_imbalance(const body_model *body, const float *vertices) {
    const float sole_m = 0.04f, step_m = 0.08f;
    float lowest[2] = {INFINITY, INFINITY}, box[2][2] = {{INFINITY, INFINITY}, {-INFINITY, -INFINITY}};
    double weight[2] = {0, 0}; /* the centre of mass, along the floor */
    for (int v = 0; v < body->vertices; v++) {
        const float *w = body->weights + (size_t)v * BODY_JOINTS, *p = vertices + 3 * (size_t)v;
        for (int side = 0; side < 2; side++)
            if (w[7 + side] + w[10 + side] > 0.5f) lowest[side] = fminf(lowest[side], p[1]);
        for (int k = 0; k < 2; k++) weight[k] += (double)p[2 * k] / body->vertices;
    }
    float floor = fminf(lowest[0], lowest[1]), apart = fabsf(lowest[0] - lowest[1]) - step_m;
    for (int v = 0; v < body->vertices; v++) {
        const float *p = vertices + 3 * (size_t)v;
        for (int k = 0; k < 2 && p[1] < floor + sole_m; k++) {
            box[0][k] = fminf(box[0][k], p[2 * k]);
            box[1][k] = fmaxf(box[1][k], p[2 * k]);
        }
    }
    float out = fmaxf(apart, 0);
    for (int k = 0; k < 2; k++)
        out += fmaxf(0, fmaxf(box[0][k] - (float)weight[k], (float)weight[k] - box[1][k]));
    return isfinite(out) ? out : 1;
}

/* ---- given poses ---- */

sherf_status pose_library_create(context *c, pose_library **out) {
    *out = mem_zero(c, 1, sizeof **out);
    return *out ? SHERF_OK : SHERF_NO_MEMORY;
}

void pose_library_free(pose_library *l) {
    if (!l) return;
    mem_free(l->given);
    mem_free(l->captured);
    mem_free(l);
}

static sherf_status add(context *c, posture **list, int *count, const char *name, const float pose[72]) {
    posture *grown = mem_grow(c, *list, (size_t)*count, (size_t)*count + 1, sizeof *grown);
    if (!grown) return SHERF_NO_MEMORY;
    *list = grown;
    posture *p = &grown[(*count)++];
    memset(p, 0, sizeof *p);
    strncpy(p->name, name, sizeof p->name - 1);
    memcpy(p->pose, pose, sizeof p->pose);
    return SHERF_OK;
}

sherf_status pose_library_add_posture(context *c, pose_library *l, const char *name, const float pose[72]) {
    return add(c, &l->given, &l->givens, name, pose);
}

/* Removes the rotation about the vertical: it is chosen elsewhere. */
static void face_forward(float pose[72]) {
    float R[9];
    rodrigues(pose, R);
    float turn = atan2f(R[2], R[8]), undo[3] = {0, -turn, 0}, U[9];
    rodrigues(undo, U);
    multiply(U, R, R);
    rotation_to_axis_angle(R, pose);
}

sherf_status pose_library_add_bvh(context *c, pose_library *l, const char *path,
                                  const float joints_rest[BODY_JOINTS][3], double every_s) {
    bvh *b;
    bvh_body map;
    sherf_status status = bvh_read(c, path, &b);
    if (status) return status;
    if ((status = bvh_body_match(c, b, NULL, joints_rest, &map))) {
        failure_prefix(c, status, "%s", path);
        goto done;
    }
    int step = (int)fmin(every_s / fmax(b->frame_time_s, 1e-6), b->frames);
    for (int frame = step > 0 ? step : 1; frame < b->frames && !status; frame += step > 0 ? step : 1) {
        float pose[72];
        bvh_body_pose(b, &map, frame, pose);
        face_forward(pose);
        status = add(c, &l->captured, &l->captures, path, pose);
    }
done:
    bvh_free(b);
    return status;
}

/* ---- overlap ---- */

/* 0 the trunk and head, 1 and 2 the legs, 3 and 4 the arms below the elbow; -1 parts next to others. */
static const int8_t region_of[BODY_JOINTS] = {0, -1, -1, 0, 1,  2,  0, 1, 2, 0, 1, 2,
                                              0, -1, -1, 0, -1, -1, 3, 4, 3, 4, 3, 4};

sherf_status pose_overlap(context *c, const body_model *body, const float *vertices, float *share) {
    size_t V = (size_t)body->vertices;
    *share = 0;
    float *normal = mem_alloc(c, V, 3 * sizeof *normal), *point = mem_alloc(c, V, 3 * sizeof *point);
    int8_t *region = mem_alloc(c, V, 1);
    int32_t *index = mem_alloc(c, V, sizeof *index);
    vertex_grid *grid = NULL;
    sherf_status status = SHERF_NO_MEMORY;
    if (!normal || !point || !region || !index || (status = body_normals(c, body, vertices, normal)))
        goto done;
    for (size_t v = 0; v < V; v++) {
        int heaviest = 0;
        for (int j = 1; j < BODY_JOINTS; j++)
            if (body->weights[v * BODY_JOINTS + (size_t)j] >
                body->weights[v * BODY_JOINTS + (size_t)heaviest])
                heaviest = j;
        region[v] = region_of[heaviest];
    }
    int64_t limb = 0, inside = 0;
    for (int other = 0; other < 5; other++) { /* vertices of every limb against every other region */
        int64_t points = 0;
        for (size_t v = 0; v < V; v++)
            if (region[v] == other) {
                memcpy(point + 3 * points, vertices + 3 * v, 3 * sizeof *point);
                index[points++] = (int32_t)v;
            }
        if (!points) continue;
        if ((status = vertex_grid_create(c, points, point, 0.15f, &grid))) goto done;
        for (size_t v = 0; v < V; v += 3) {
            if (region[v] < 1 || region[v] == other) continue;
            limb += other == 0;
            const float *p = vertices + 3 * v;
            float squared, depth = 0;
            int32_t near = vertex_grid_nearest(grid, p, &squared);
            if (near < 0) continue;
            size_t at = 3 * (size_t)index[near];
            for (int k = 0; k < 3; k++) depth += (p[k] - vertices[at + (size_t)k]) * normal[at + (size_t)k];
            inside += depth < -0.02f;
        }
        vertex_grid_free(grid);
        grid = NULL;
    }
    *share = limb ? (float)inside / (float)limb : 0;
done:
    vertex_grid_free(grid);
    mem_free(normal);
    mem_free(point);
    mem_free(region);
    mem_free(index);
    return status;
}
