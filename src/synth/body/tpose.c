/* tpose: poses MakeHuman's rig in SMPL's rest pose. */
#include "synth/body/tpose.h"

#include <math.h>
#include <string.h>

#include "synth/body/affine.h"

/* The pelvis of SMPL's neutral template. */
const double tpose_pelvis_m[3] = {0, -0.223, 0.028};
const int tpose_parent[BODY_JOINTS] = {-1, 0, 0, 0,  1,  2,  3,  4,  5,  6,  7,  8,
                                       9,  9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21};
const char *const tpose_joint_names[BODY_JOINTS] = {
    "pelvis",     "left_hip",    "right_hip",    "spine1",      "left_knee",     "right_knee",
    "spine2",     "left_ankle",  "right_ankle",  "spine3",      "left_foot",     "right_foot",
    "neck",       "left_collar", "right_collar", "head",        "left_shoulder", "right_shoulder",
    "left_elbow", "right_elbow", "left_wrist",   "right_wrist", "left_hand",     "right_hand"};

enum {
    PELVIS,
    HIP,
    SPINE1 = 3,
    KNEE,
    SPINE2 = 6,
    ANKLE,
    SPINE3 = 9,
    FOOT,
    NECK = 12,
    COLLAR,
    HEAD = 15,
    SHOULDER,
    ELBOW = 18,
    WRIST = 20,
    HAND = 22
};

/* Bones that begin a joint's part of the body; all bones below belong to it until the next such bone. Names
 * of the left side; the right joint is the next one. */
static const struct {
    const char *bone;
    int joint;
} begins[] = {
    {"root", PELVIS},        {"spine03", SPINE1},   {"spine02", SPINE2},    {"spine01", SPINE3},
    {"neck01", NECK},        {"neck03", HEAD},      {"clavicle.L", COLLAR}, {"upperarm01.L", SHOULDER},
    {"lowerarm01.L", ELBOW}, {"wrist.L", WRIST},    {"finger2-1.L", HAND},  {"finger3-1.L", HAND},
    {"finger4-1.L", HAND},   {"finger5-1.L", HAND}, {"upperleg01.L", HIP},  {"lowerleg01.L", KNEE},
    {"foot.L", ANKLE},       {"toe1-1.L", FOOT},    {"toe2-1.L", FOOT},     {"toe3-1.L", FOOT},
    {"toe4-1.L", FOOT},      {"toe5-1.L", FOOT},
};

/* Joints as weighted means of bones' heads in T-pose. SMPL has its pelvis 9 cm above the hips and its collars
 * between neck and shoulder, where MakeHuman's bones do not end; the others are the pivots that the rig's
 * weights were painted for. */
static const struct {
    int joint;
    const char *bone;
    double weight;
} places[] = {
    {PELVIS, "spine05", 0.5},    {PELVIS, "spine04", 0.5},      {SPINE1, "spine03", 1},
    {SPINE2, "spine02", 1},      {SPINE3, "spine01", 1},        {NECK, "neck01", 1},
    {HEAD, "neck03", 1},         {COLLAR, "upperarm01.L", 0.5}, {COLLAR, "spine01", 0.35},
    {COLLAR, "neck01", 0.15},    {SHOULDER, "upperarm01.L", 1}, {ELBOW, "lowerarm01.L", 1},
    {WRIST, "wrist.L", 1},       {HAND, "finger2-1.L", 0.25},   {HAND, "finger3-1.L", 0.25},
    {HAND, "finger4-1.L", 0.25}, {HAND, "finger5-1.L", 0.25},   {HIP, "upperleg01.L", 1},
    {KNEE, "lowerleg01.L", 1},   {ANKLE, "foot.L", 1},          {FOOT, "toe1-1.L", 0.2},
    {FOOT, "toe2-1.L", 0.2},     {FOOT, "toe3-1.L", 0.2},       {FOOT, "toe4-1.L", 0.2},
    {FOOT, "toe5-1.L", 0.2},
};

/* The bones that turn themselves on the way to the T-pose; the others follow their parents. */
enum limb {
    CLAVICLE,
    SHOULDER01,
    UPPERARM,
    LOWERARM1,
    LOWERARM2,
    PALM,
    INDEX,
    MIDDLE,
    LITTLE,
    THIGH,
    SHIN,
    SOLE,
    LIMBS
};
static const char *const limb_names[LIMBS] = {"clavicle.L",   "shoulder01.L", "upperarm01.L", "lowerarm01.L",
                                              "lowerarm02.L", "wrist.L",      "finger2-1.L",  "finger3-1.L",
                                              "finger5-1.L",  "upperleg01.L", "lowerleg01.L", "foot.L"};

struct tpose_rig {
    int *joint;                     /* by bone */
    int place[2][COUNT_OF(places)]; /* bones, left and right */
    int limb[2][LIMBS];             /* bones */
};

static int find_side(const makehuman *human, const char *name, int right) {
    char other[64];
    size_t n = strlen(name);
    memcpy(other, name, n + 1);
    if (right && n > 2 && other[n - 2] == '.') other[n - 1] = 'R';
    return makehuman_bone_find(human, other);
}

static bool has_sides(int joint) {
    static const bool sides[BODY_JOINTS] = {
        [HIP] = 1,      [KNEE] = 1,  [ANKLE] = 1, [FOOT] = 1, [COLLAR] = 1,
        [SHOULDER] = 1, [ELBOW] = 1, [WRIST] = 1, [HAND] = 1};
    return sides[joint];
}

static sherf_status fill_rig(context *c, const makehuman *human, tpose_rig *rig) {
    for (int b = 0; b < human->bones; b++) rig->joint[b] = -1;
    for (int right = 0; right < 2; right++) {
        for (size_t i = 0; i < COUNT_OF(begins); i++) {
            int b = find_side(human, begins[i].bone, right);
            if (b < 0) return failure(c, SHERF_BAD_FILE, "the rig has no bone %s", begins[i].bone);
            rig->joint[b] = begins[i].joint + (right && has_sides(begins[i].joint));
        }
        for (size_t i = 0; i < COUNT_OF(places); i++)
            if ((rig->place[right][i] = find_side(human, places[i].bone, right)) < 0)
                return failure(c, SHERF_BAD_FILE, "the rig has no bone %s", places[i].bone);
        for (size_t i = 0; i < LIMBS; i++)
            if ((rig->limb[right][i] = find_side(human, limb_names[i], right)) < 0)
                return failure(c, SHERF_BAD_FILE, "the rig has no bone %s", limb_names[i]);
    }
    for (int b = 0; b < human->bones; b++) /* parents come first */
        if (rig->joint[b] < 0)
            rig->joint[b] = human->bone[b].parent < 0 ? PELVIS : rig->joint[human->bone[b].parent];
    return SHERF_OK;
}

sherf_status tpose_rig_create(context *c, const makehuman *human, tpose_rig **out) {
    *out = NULL;
    tpose_rig *rig = mem_zero(c, 1, sizeof *rig);
    if (!rig) return SHERF_NO_MEMORY;
    rig->joint = mem_alloc(c, (size_t)human->bones, sizeof *rig->joint);
    sherf_status status = rig->joint ? fill_rig(c, human, rig) : SHERF_NO_MEMORY;
    if (status)
        tpose_rig_free(rig);
    else
        *out = rig;
    return status;
}

void tpose_rig_free(tpose_rig *rig) {
    if (!rig) return;
    mem_free(rig->joint);
    mem_free(rig);
}

/* ---- the turns ---- */

typedef struct {
    const makehuman *human;
    const double *point; /* the rig's points in A-pose */
    double (*turn)[9];   /* by bone: own global rotation, only if `own` */
    bool *own;
} turning;

static const double *head_of(const turning *t, int bone) {
    return t->point + 3 * (size_t)t->human->bone[bone].head;
}

/* Turns the direction from bone a's head to bone b's head by `before`, and then to `to`; assigns the total to
 * `bone`. */
static void aim(turning *t, const double before[9], int a, int b, const double to[3], int bone) {
    double d[3], R[9];
    for (int k = 0; k < 3; k++) d[k] = head_of(t, b)[k] - head_of(t, a)[k];
    rotate3(before, d, d);
    turn_to3(d, to, R);
    multiply3(R, before, t->turn[bone]);
    t->own[bone] = true;
}

static const double identity[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};

static void turn_arm(turning *t, const int limb[LIMBS], double side) {
    static const double z[3] = {0, 0, 1};
    const double out[3] = {side, 0, 0};
    /* the shoulder girdle's share in raising the arm by about 45 degrees */
    const double girdle_rad[2] = {0.133, 0.316};
    for (int i = 0; i < 2; i++) {
        turn3(z, side * girdle_rad[i], t->turn[limb[CLAVICLE + i]]);
        t->own[limb[CLAVICLE + i]] = true;
    }
    aim(t, identity, limb[UPPERARM], limb[LOWERARM1], out, limb[UPPERARM]);
    aim(t, t->turn[limb[UPPERARM]], limb[LOWERARM1], limb[PALM], out, limb[LOWERARM1]);
    aim(t, t->turn[limb[LOWERARM1]], limb[PALM], limb[MIDDLE], out, limb[PALM]);
    /* Palm down: the knuckles from little finger to index finger point forward. The forearm takes its share.
     */
    double across[3], R[9];
    for (int k = 0; k < 3; k++) across[k] = head_of(t, limb[INDEX])[k] - head_of(t, limb[LITTLE])[k];
    rotate3(t->turn[limb[PALM]], across, across);
    double twist = atan2(side * across[1], across[2]); /* about `out` */
    const double share[3] = {0.25, 0.75, 1};
    const int bone[3] = {limb[LOWERARM1], limb[LOWERARM2], limb[PALM]};
    double forearm[9];
    memcpy(forearm, t->turn[limb[LOWERARM1]], sizeof forearm);
    for (int i = 0; i < 3; i++) {
        turn3(out, share[i] * twist, R);
        multiply3(R, i < 2 ? forearm : t->turn[limb[PALM]], t->turn[bone[i]]);
        t->own[bone[i]] = true;
    }
}

static void turn_leg(turning *t, const int limb[LIMBS], double side) {
    static const double y[3] = {0, 1, 0};
    const double thigh[3] = {side * 0.0325, -0.376, -0.0045}, shin[3] = {side * -0.0137, -0.398, -0.0437};
    aim(t, identity, limb[THIGH], limb[SHIN], thigh, limb[THIGH]);
    aim(t, t->turn[limb[THIGH]], limb[SHIN], limb[SOLE], shin, limb[SHIN]);
    turn3(y, side * 0.1, t->turn[limb[SOLE]]); /* toes out, soles flat */
    t->own[limb[SOLE]] = true;
}

/* Chains the rotations: bone (bones x 12), A-pose to T-pose before the pelvis is placed. */
static void chain(const turning *t, double *bone) {
    for (int b = 0; b < t->human->bones; b++) {
        int parent = t->human->bone[b].parent;
        const double *up = parent >= 0 ? bone + 12 * (size_t)parent : NULL, *head = head_of(t, b);
        double R[9], at[3];
        for (int i = 0; i < 9; i++)
            R[i] = t->own[b] ? t->turn[b][i] : up ? up[4 * (i / 3) + i % 3] : identity[i];
        for (int k = 0; k < 3; k++) at[k] = up ? dot3(up + 4 * k, head) + up[4 * k + 3] : head[k];
        double *to = bone + 12 * (size_t)b;
        for (int k = 0; k < 3; k++) {
            for (int i = 0; i < 3; i++) to[4 * k + i] = R[3 * k + i];
            to[4 * k + 3] = at[k] - dot3(R + 3 * k, head);
        }
    }
}

static void place_joints(const turning *t, const tpose_rig *rig, const double *bone,
                         double joints[BODY_JOINTS][3]) {
    memset(joints, 0, BODY_JOINTS * sizeof *joints);
    for (int right = 0; right < 2; right++)
        for (size_t i = 0; i < COUNT_OF(places); i++) {
            if (right && !has_sides(places[i].joint)) continue;
            int b = rig->place[right][i];
            const double *A = bone + 12 * (size_t)b, *head = head_of(t, b);
            for (int k = 0; k < 3; k++)
                joints[places[i].joint + right][k] +=
                    places[i].weight * (dot3(A + 4 * k, head) + A[4 * k + 3]);
        }
}

static void move_vertices(const makehuman *human, const double *bone, const float *vertices, float *out) {
    for (size_t v = 0; v < (size_t)human->vertices; v++) {
        double x[3] = {(double)vertices[3 * v], (double)vertices[3 * v + 1], (double)vertices[3 * v + 2]};
        double y[3] = {0};
        for (size_t i = 0; i < MAKEHUMAN_SKIN; i++) {
            double w = (double)human->skin_weight[MAKEHUMAN_SKIN * v + i];
            const double *A = bone + 12 * (size_t)human->skin_bone[MAKEHUMAN_SKIN * v + i];
            for (int k = 0; k < 3 && w > 0; k++) y[k] += w * (dot3(A + 4 * k, x) + A[4 * k + 3]);
        }
        for (int k = 0; k < 3; k++) out[3 * v + k] = (float)y[k];
    }
}

sherf_status tpose_apply(context *c, const makehuman *human, const tpose_rig *rig, const float *vertices,
                         float *out, double joints[BODY_JOINTS][3], double *bone) {
    sherf_status status = SHERF_NO_MEMORY;
    double *point = mem_alloc(c, (size_t)human->points * 3, sizeof *point);
    double *map = bone ? bone : mem_alloc(c, (size_t)human->bones * 12, sizeof *map);
    turning t = {.human = human, .point = point};
    t.turn = mem_alloc(c, (size_t)human->bones, sizeof *t.turn);
    t.own = mem_zero(c, (size_t)human->bones, sizeof *t.own);
    if (!point || !map || !t.turn || !t.own) goto done;
    makehuman_points(human, vertices, point);
    for (int right = 0; right < 2; right++) {
        turn_arm(&t, rig->limb[right], right ? -1 : 1);
        turn_leg(&t, rig->limb[right], right ? -1 : 1);
    }
    chain(&t, map);
    place_joints(&t, rig, map, joints);
    double move[3];
    for (int k = 0; k < 3; k++) move[k] = tpose_pelvis_m[k] - joints[PELVIS][k];
    for (int j = 0; j < BODY_JOINTS; j++)
        for (int k = 0; k < 3; k++) joints[j][k] += move[k];
    for (int b = 0; b < human->bones; b++)
        for (int k = 0; k < 3; k++) map[12 * (size_t)b + 4 * k + 3] += move[k];
    move_vertices(human, map, vertices, out);
    status = SHERF_OK;
done:
    mem_free(point);
    if (map != bone) mem_free(map);
    mem_free(t.turn);
    mem_free(t.own);
    return status;
}

/* ---- weights ---- */

/* One round: each vertex moves half-way to the mean of its neighbours. */
static void smooth(const makehuman *human, const int *neighbours, const float *in, float *out) {
    memset(out, 0, (size_t)human->vertices * BODY_JOINTS * sizeof *out);
    for (size_t q = 0; q < (size_t)human->quads; q++)
        for (int i = 0; i < 4; i++) {
            size_t a = human->quad[4 * q + i], b = human->quad[4 * q + (i + 1) % 4];
            if (a == b) continue;
            /* an edge between two quads occurs twice, once in each direction */
            for (size_t j = 0; j < BODY_JOINTS; j++) {
                out[a * BODY_JOINTS + j] += in[b * BODY_JOINTS + j];
                out[b * BODY_JOINTS + j] += in[a * BODY_JOINTS + j];
            }
        }
    for (size_t v = 0; v < (size_t)human->vertices; v++)
        for (size_t j = 0; j < BODY_JOINTS; j++) {
            size_t i = v * BODY_JOINTS + j;
            out[i] = neighbours[v] ? 0.5f * in[i] + 0.5f * out[i] / (float)neighbours[v] : in[i];
        }
}

/* Keeps the largest `max` weights, which then sum to 1. */
static void tidy(float *w, int max) {
    for (int cut = 0; cut < BODY_JOINTS - max; cut++) {
        int min = -1;
        for (int j = 0; j < BODY_JOINTS; j++)
            if (w[j] > 0 && (min < 0 || w[j] < w[min])) min = j;
        int count = 0;
        for (int j = 0; j < BODY_JOINTS; j++) count += w[j] > 0;
        if (count > max) w[min] = 0;
    }
    double sum = 0;
    for (int j = 0; j < BODY_JOINTS; j++) {
        if (w[j] < 1e-4f) w[j] = 0;
        sum += (double)w[j];
    }
    for (int j = 0; j < BODY_JOINTS; j++) w[j] = (float)((double)w[j] / sum);
}

sherf_status tpose_weights(context *c, const makehuman *human, const tpose_rig *rig, int rounds,
                           float *weights) {
    sherf_status status = SHERF_NO_MEMORY;
    size_t n = (size_t)human->vertices * BODY_JOINTS;
    float *other = mem_alloc(c, n, sizeof *other);
    int *neighbours = mem_zero(c, (size_t)human->vertices, sizeof *neighbours);
    if (!other || !neighbours) goto done;
    memset(weights, 0, n * sizeof *weights);
    for (size_t v = 0; v < (size_t)human->vertices; v++)
        for (size_t i = 0; i < MAKEHUMAN_SKIN; i++)
            weights[v * BODY_JOINTS + (size_t)rig->joint[human->skin_bone[MAKEHUMAN_SKIN * v + i]]] +=
                human->skin_weight[MAKEHUMAN_SKIN * v + i];
    for (size_t q = 0; q < (size_t)human->quads; q++)
        for (int i = 0; i < 4; i++) {
            uint32_t a = human->quad[4 * q + i], b = human->quad[4 * q + (i + 1) % 4];
            if (a != b) neighbours[a]++, neighbours[b]++;
        }
    for (int r = 0; r < rounds; r++) {
        smooth(human, neighbours, weights, other);
        memcpy(weights, other, n * sizeof *weights);
    }
    for (size_t v = 0; v < (size_t)human->vertices; v++) tidy(weights + v * BODY_JOINTS, 8);
    status = SHERF_OK;
done:
    mem_free(other);
    mem_free(neighbours);
    return status;
}
