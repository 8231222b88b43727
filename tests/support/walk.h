/* A walk on the open body, with turning, swaying and moving along. All formats must give the same walk. */
#ifndef TEST_MOTION_WALK_H
#define TEST_MOTION_WALK_H
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "data/data.h"
#include "motion/source.h"
#include "synth/people/person_pose.h"
#include "support.h"

enum { WALK_FRAMES = 12 };
static const double walk_fps = 20;

typedef struct {
    sherf_pose pose[WALK_FRAMES]; /* y up, R the identity */
    skeleton skeleton;
} walk;

static inline void walk_make(const body_model *body, walk *w) {
    skeleton_of(body, NULL, &w->skeleton);
    for (int i = 0; i < WALK_FRAMES; i++) {
        sherf_pose *p = &w->pose[i];
        double t = i / walk_fps, turn[3] = {0.05 * sin(5 * t), 0.6 + 0.8 * t, 0.04 * cos(4 * t)};
        sherf_pose_identity(p);
        pose_walk(t, 1, p->poses_rad);
        for (int k = 0; k < 3; k++) p->poses_rad[k] = (float)turn[k];
        p->Th_m[0] = (float)(0.4 + 0.9 * t);
        p->Th_m[1] = (float)(1.13 + 0.02 * sin(9 * t));
        p->Th_m[2] = (float)(-0.3 + 0.5 * t);
    }
}

static inline void walk_root(const walk *w, int i, double R[9], double pelvis_m[3]) {
    float wide[9];
    rodrigues(w->pose[i].poses_rad, wide);
    for (int k = 0; k < 9; k++) R[k] = wide[k];
    for (int k = 0; k < 3; k++) pelvis_m[k] = w->skeleton.rest_m[0][k] + w->pose[i].Th_m[k];
}

/* The state of every test in a program. */
typedef struct {
    context *c;
    body_model *body;
    walk walk;
} walk_fixture;

static inline int walk_setup(void **state) {
    static walk_fixture f;
    f.c = test_context();
    assert_ok(f.c, body_load(f.c, "../assets/body.safetensors", &f.body));
    walk_make(f.body, &f.walk);
    *state = &f;
    return 0;
}

static inline int walk_teardown(void **state) {
    walk_fixture *f = *state;
    sherf_body_free(f->body);
    sherf_context_free(f->c);
    return mem_live() == 0 ? 0 : -1;
}

/* Converts to a world whose axes, seen from ours, are the rows of C: the root is turned, the translation is
 * SMPL's kind. */
static inline void walk_in(const walk *w, int i, const double C[9], float root[3], float trans[3]) {
    double R[9], pelvis[3];
    float turned[9];
    walk_root(w, i, R, pelvis);
    for (int r = 0; r < 3; r++) {
        for (int k = 0; k < 3; k++)
            turned[3 * r + k] = (float)(C[3 * r] * R[k] + C[3 * r + 1] * R[3 + k] + C[3 * r + 2] * R[6 + k]);
        double place = C[3 * r] * pelvis[0] + C[3 * r + 1] * pelvis[1] + C[3 * r + 2] * pelvis[2];
        trans[r] = (float)(place - w->skeleton.rest_m[0][r]);
    }
    rotation_to_axis_angle(turned, root);
}

/* Rows: x, y, z of the file's world in our axes. */
static const double walk_y_up[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
static const double walk_z_up[9] = {1, 0, 0, 0, 0, -1, 0, 1, 0};
static const double walk_y_down[9] = {1, 0, 0, 0, -1, 0, 0, 0, -1};

/* The largest distance of a vertex between a frame of the motion and the walk's. */
static inline double walk_distance(context *c, const body_model *body, const sherf_pose *a,
                                   const sherf_pose *b) {
    size_t n = (size_t)body->vertices * 3;
    float *x = malloc(n * sizeof *x), *y = malloc(n * sizeof *y);
    double max = 0;
    assert_ok(c, sherf_body_pose(c, body, a, x, NULL));
    assert_ok(c, sherf_body_pose(c, body, b, y, NULL));
    for (size_t i = 0; i < n; i += 3)
        max = fmax(max, sqrt(pow((double)x[i] - y[i], 2) + pow((double)x[i + 1] - y[i + 1], 2) +
                             pow((double)x[i + 2] - y[i + 2], 2)));
    free(x);
    free(y);
    return max;
}

/* ---- BVH with the body's own skeleton ---- */

/* The angles of R = Rz(a) Rx(b) Ry(c), degrees. */
static inline void walk_euler_zxy(const double R[9], double degrees[3]) {
    degrees[0] = atan2(-R[1], R[4]) * 180 / M_PI;
    degrees[1] = asin(fmax(-1, fmin(1, R[7]))) * 180 / M_PI;
    degrees[2] = atan2(-R[6], R[8]) * 180 / M_PI;
}

static inline void walk_multiply(const double a[9], const double b[9], double out[9]) {
    for (int i = 0; i < 9; i++)
        out[i] = a[i / 3 * 3] * b[i % 3] + a[i / 3 * 3 + 1] * b[3 + i % 3] + a[i / 3 * 3 + 2] * b[6 + i % 3];
}

/* Whether `joint` is `other` or a descendant of it. */
static inline bool walk_below(int joint, int other) {
    while (joint > other) joint = skeleton_parent[joint];
    return joint == other;
}

/* At rest the arms are `spread` radians below the T (an A-pose). The rest pose is in the axes whose rows are
 * `axes`, in our world. The file's rotations are relative to it. */
typedef struct {
    const char *const *names;
    int joints;
    double unit, spread;
    const double *axes; /* NULL: ours */
    /* For each joint, the rotation at rest from our axes to its own (as columns); NULL: none. The rest pose
     * is then not that of a person. Not to be combined with spread or axes. */
    const double (*own)[9];
    bool placed; /* bones are given only by the positions in every frame; every offset is 0 */
} bvh_style;

/* Offset from the parent, in the file's unit. */
static inline void walk_bvh_offset(const walk *w, const bvh_style *style, int j, double turned[3]) {
    double offset[3];
    int parent = skeleton_parent[j];
    for (int k = 0; k < 3; k++)
        offset[k] = parent < 0 ? 0 : w->skeleton.rest_m[j][k] - w->skeleton.rest_m[parent][k];
    double side = walk_below(parent, 16) ? -1 : walk_below(parent, 17) ? 1 : 0, angle = side * style->spread;
    turned[0] = cos(angle) * offset[0] - sin(angle) * offset[1];
    turned[1] = sin(angle) * offset[0] + cos(angle) * offset[1];
    turned[2] = offset[2];
    memcpy(offset, turned, sizeof offset);
    for (int k = 0; k < 3 && style->axes; k++)
        turned[k] = style->axes[3 * k] * offset[0] + style->axes[3 * k + 1] * offset[1] +
                    style->axes[3 * k + 2] * offset[2];
    for (int k = 0; k < 3 && style->own && parent >= 0; k++)
        turned[k] = style->own[parent][k] * offset[0] + style->own[parent][3 + k] * offset[1] +
                    style->own[parent][6 + k] * offset[2];
    for (int k = 0; k < 3; k++) turned[k] /= style->unit;
}

static inline void walk_bvh_joint(FILE *f, const walk *w, const bvh_style *style, int j) {
    static const double none[3];
    double offset[3];
    const int parent = skeleton_parent[j];
    walk_bvh_offset(w, style, j, offset);
    if (style->placed) memcpy(offset, none, sizeof offset);
    fprintf(f, "%s %s\n{\nOFFSET %.9g %.9g %.9g\n", parent < 0 ? "ROOT" : "JOINT", style->names[j], offset[0],
            offset[1], offset[2]);
    fprintf(f, "CHANNELS %s Zrotation Xrotation Yrotation\n",
            parent < 0 || style->placed ? "6 Xposition Yposition Zposition" : "3");
    bool leaf = true;
    for (int i = j + 1; i < style->joints; i++)
        if (skeleton_parent[i] == j) walk_bvh_joint(f, w, style, i), leaf = false;
    if (leaf) fprintf(f, "End Site\n{\nOFFSET 0 1 0\n}\n");
    fprintf(f, "}\n");
}

/* The order of the joints in the file: depth first. */
static inline int walk_bvh_order(int j, int joints, int *order, int count) {
    order[count++] = j;
    for (int i = j + 1; i < joints; i++)
        if (skeleton_parent[i] == j) count = walk_bvh_order(i, joints, order, count);
    return count;
}

static inline void walk_write_bvh(const walk *w, const char *path, const bvh_style *style) {
    const int joints = style->joints;
    const double unit = style->unit;
    int order[BODY_JOINTS];
    FILE *f = fopen(path, "wb");
    assert_non_null(f);
    fprintf(f, "HIERARCHY\n");
    walk_bvh_joint(f, w, style, 0);
    fprintf(f, "MOTION\nFrames: %d\nFrame Time: %.7g\n", WALK_FRAMES, 1 / walk_fps);
    assert_int_equal(walk_bvh_order(0, joints, order, 0), joints);
    for (int i = 0; i < WALK_FRAMES; i++) {
        double global[BODY_JOINTS][9], file[BODY_JOINTS][9], pelvis[3], root[9];
        walk_root(w, i, root, pelvis);
        for (int j = 0; j < joints; j++) {
            float R[9];
            double local[9];
            rodrigues(w->pose[i].poses_rad + 3 * j, R);
            for (int k = 0; k < 9; k++) local[k] = R[k];
            if (j)
                walk_multiply(global[skeleton_parent[j]], local, global[j]);
            else
                memcpy(global[j], local, sizeof local);
            /* file * (rest bone of the file) = global * (rest bone of the body) */
            double side = walk_below(j, 16) ? -1 : walk_below(j, 17) ? 1 : 0, a = side * style->spread;
            double back_of[9], back[9] = {cos(a), sin(a), 0, -sin(a), cos(a), 0, 0, 0, 1};
            if (style->axes) { /* the rest pose is undone first */
                double turn_back[9];
                for (int k = 0; k < 9; k++) turn_back[k] = style->axes[k % 3 * 3 + k / 3];
                walk_multiply(back, turn_back, back_of);
            } else
                memcpy(back_of, back, sizeof back);
            walk_multiply(global[j], style->own ? style->own[j] : back_of, file[j]);
        }
        fprintf(f, "%.9g %.9g %.9g", pelvis[0] / unit, pelvis[1] / unit, pelvis[2] / unit);
        for (int n = 0; n < joints; n++) {
            int j = order[n];
            double up[9], local[9], angle[3];
            for (int k = 0; k < 9; k++) up[k] = j ? file[skeleton_parent[j]][k % 3 * 3 + k / 3] : k % 4 == 0;
            walk_multiply(up, file[j], local);
            walk_euler_zxy(local, angle);
            double at[3];
            walk_bvh_offset(w, style, j, at);
            if (j && style->placed) fprintf(f, " %.9g %.9g %.9g", at[0], at[1], at[2]);
            fprintf(f, " %.9g %.9g %.9g", angle[0], angle[1], angle[2]);
        }
        fprintf(f, "\n");
    }
    fclose(f);
}

static const char *const walk_smpl_names[BODY_JOINTS] = {
    "Pelvis",     "L_Hip",      "R_Hip",   "Spine1",  "L_Knee",  "R_Knee",   "Spine2",   "L_Ankle",
    "R_Ankle",    "Spine3",     "L_Foot",  "R_Foot",  "Neck",    "L_Collar", "R_Collar", "Head",
    "L_Shoulder", "R_Shoulder", "L_Elbow", "R_Elbow", "L_Wrist", "R_Wrist",  "L_Hand",   "R_Hand"};
static const char *const walk_mixamo_names[BODY_JOINTS] = {
    "mixamorig:Hips",        "mixamorig:LeftUpLeg",       "mixamorig:RightUpLeg",
    "mixamorig:Spine",       "mixamorig:LeftLeg",         "mixamorig:RightLeg",
    "mixamorig:Spine1",      "mixamorig:LeftFoot",        "mixamorig:RightFoot",
    "mixamorig:Spine2",      "mixamorig:LeftToeBase",     "mixamorig:RightToeBase",
    "mixamorig:Neck",        "mixamorig:LeftShoulder",    "mixamorig:RightShoulder",
    "mixamorig:Head",        "mixamorig:LeftArm",         "mixamorig:RightArm",
    "mixamorig:LeftForeArm", "mixamorig:RightForeArm",    "mixamorig:LeftHand",
    "mixamorig:RightHand",   "mixamorig:LeftHandMiddle1", "mixamorig:RightHandMiddle1"};
/* Names of other rigs, for 22 joints. */
static const char *const walk_ipi_names[BODY_JOINTS] = {
    "Hip",       "LThigh",    "RThigh",   "LowerSpine", "LShin", "RShin",     "MiddleSpine", "LFoot",
    "RFoot",     "Chest",     "LToe",     "RToe",       "Neck",  "LClavicle", "RClavicle",   "Head",
    "LShoulder", "RShoulder", "LForearm", "RForearm",   "LHand", "RHand"};
static const char *const walk_asf_names[BODY_JOINTS] = {
    "root",     "lfemur",   "rfemur",  "lowerback", "ltibia",    "rtibia",    "upperback", "lfoot",
    "rfoot",    "thorax",   "ltoes",   "rtoes",     "lowerneck", "lclavicle", "rclavicle", "head",
    "lhumerus", "rhumerus", "lradius", "rradius",   "lwrist",    "rwrist"};
static const char *const walk_unreal_names[BODY_JOINTS] = {
    "pelvis",     "thigh_l",    "thigh_r",    "spine_01",   "calf_l",  "calf_r",     "spine_02",   "foot_l",
    "foot_r",     "spine_03",   "ball_l",     "ball_r",     "neck_01", "clavicle_l", "clavicle_r", "head",
    "upperarm_l", "upperarm_r", "lowerarm_l", "lowerarm_r", "hand_l",  "hand_r"};
static const char *const walk_vrm_names[BODY_JOINTS] = {
    "J_Bip_C_Hips",     "J_Bip_L_UpperLeg", "J_Bip_R_UpperLeg", "J_Bip_C_Spine",    "J_Bip_L_LowerLeg",
    "J_Bip_R_LowerLeg", "J_Bip_C_Chest",    "J_Bip_L_Foot",     "J_Bip_R_Foot",     "J_Bip_C_UpperChest",
    "J_Bip_L_ToeBase",  "J_Bip_R_ToeBase",  "J_Bip_C_Neck",     "J_Bip_L_Shoulder", "J_Bip_R_Shoulder",
    "J_Bip_C_Head",     "J_Bip_L_UpperArm", "J_Bip_R_UpperArm", "J_Bip_L_LowerArm", "J_Bip_R_LowerArm",
    "J_Bip_L_Hand",     "J_Bip_R_Hand"};
static const char *const walk_unity_names[BODY_JOINTS] = {
    "Hips",         "LeftUpperLeg",  "RightUpperLeg", "Spine",      "LeftLowerLeg", "RightLowerLeg",
    "Chest",        "LeftFoot",      "RightFoot",     "UpperChest", "LeftToes",     "RightToes",
    "Neck",         "LeftShoulder",  "RightShoulder", "Head",       "LeftUpperArm", "RightUpperArm",
    "LeftLowerArm", "RightLowerArm", "LeftHand",      "RightHand"};
static const char *const walk_biped_names[BODY_JOINTS] = {
    "Bip01 Pelvis", "Bip01 L Thigh",    "Bip01 R Thigh",    "Bip01 Spine",      "Bip01 L Calf",
    "Bip01 R Calf", "Bip01 Spine1",     "Bip01 L Foot",     "Bip01 R Foot",     "Bip01 Spine2",
    "Bip01 L Toe0", "Bip01 R Toe0",     "Bip01 Neck",       "Bip01 L Clavicle", "Bip01 R Clavicle",
    "Bip01 Head",   "Bip01 L UpperArm", "Bip01 R UpperArm", "Bip01 L Forearm",  "Bip01 R Forearm",
    "Bip01 L Hand", "Bip01 R Hand"};
static const char *const walk_rigify_names[BODY_JOINTS] = {
    "DEF-spine",  "DEF-thigh.L",     "DEF-thigh.R",     "DEF-spine.001",  "DEF-shin.L",
    "DEF-shin.R", "DEF-spine.002",   "DEF-foot.L",      "DEF-foot.R",     "DEF-spine.003",
    "DEF-toe.L",  "DEF-toe.R",       "DEF-spine.004",   "DEF-shoulder.L", "DEF-shoulder.R",
    "DEF-head",   "DEF-upper_arm.L", "DEF-upper_arm.R", "DEF-forearm.L",  "DEF-forearm.R",
    "DEF-hand.L", "DEF-hand.R"};
static const char *const walk_optitrack_names[BODY_JOINTS] = {
    "Bob_Hip",    "Bob_LThigh",    "Bob_RThigh",    "Bob_Ab",    "Bob_LShin", "Bob_RShin",
    "Bob_Spine2", "Bob_LFoot",     "Bob_RFoot",     "Bob_Chest", "Bob_LToe",  "Bob_RToe",
    "Bob_Neck",   "Bob_LShoulder", "Bob_RShoulder", "Bob_Head",  "Bob_LUArm", "Bob_RUArm",
    "Bob_LFArm",  "Bob_RFArm",     "Bob_LHand",     "Bob_RHand"};
static const char *const walk_mhr_names[BODY_JOINTS] = {
    "root",    "l_upleg",  "r_upleg",  "c_spine0", "l_lowleg", "r_lowleg",   "c_spine1",   "l_foot",
    "r_foot",  "c_spine3", "l_ball",   "r_ball",   "c_neck",   "l_clavicle", "r_clavicle", "c_head",
    "l_uparm", "r_uparm",  "l_lowarm", "r_lowarm", "l_wrist",  "r_wrist"};
static const char *const walk_soma_names[BODY_JOINTS] = {
    "Hips",        "LeftLeg",      "RightLeg",      "Spine1",   "LeftShin",    "RightShin",
    "Spine2",      "LeftFoot",     "RightFoot",     "Chest",    "LeftToeBase", "RightToeBase",
    "Neck1",       "LeftShoulder", "RightShoulder", "Head",     "LeftArm",     "RightArm",
    "LeftForeArm", "RightForeArm", "LeftHand",      "RightHand"};
static const char *const walk_arkit_names[BODY_JOINTS] = {
    "hips_joint",       "left_upLeg_joint",      "right_upLeg_joint",      "spine_1_joint",
    "left_leg_joint",   "right_leg_joint",       "spine_4_joint",          "left_foot_joint",
    "right_foot_joint", "spine_7_joint",         "left_toes_joint",        "right_toes_joint",
    "neck_1_joint",     "left_shoulder_1_joint", "right_shoulder_1_joint", "head_joint",
    "left_arm_joint",   "right_arm_joint",       "left_forearm_joint",     "right_forearm_joint",
    "left_hand_joint",  "right_hand_joint"};
static const char *const walk_other_names[BODY_JOINTS] = {
    "a0",  "a1",  "a2",  "a3",  "a4",  "a5",  "a6",  "a7",  "a8",  "a9",  "a10",
    "a11", "a12", "a13", "a14", "a15", "a16", "a17", "a18", "a19", "a20", "a21"};
#endif
