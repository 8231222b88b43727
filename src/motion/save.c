/* Saves a motion in AMASS's form, and as BVH. */
#include <math.h>
#include <string.h>

#include "base/path.h"
#include "io/value.h"
#include "motion/motion.h"

static sherf_status save_npz(context *c, const sherf_motion *motion, const char *path) {
    int frames = motion->clip.frames;
    sherf_status status = SHERF_NO_MEMORY;
    float *poses = mem_alloc(c, (size_t)frames, 72 * sizeof *poses);
    float *trans = mem_alloc(c, (size_t)frames, 3 * sizeof *trans);
    float rate = (float)motion->clip.fps;
    if (!poses || !trans) goto done;
    for (int i = 0; i < frames; i++) {
        static const float y_to_z[4] = {0.70710678f, 0.70710678f, 0, 0};
        double place[3] = {motion->clip.pelvis_m[i][0], motion->clip.pelvis_m[i][1],
                           motion->clip.pelvis_m[i][2]};
        float root[4];
        for (int j = 1; j < BODY_JOINTS; j++)
            quaternion_to_axis_angle(motion->clip.turn[i][j], poses + 72 * i + 3 * j);
        quaternion_multiply(y_to_z, motion->clip.turn[i][0], root);
        quaternion_to_axis_angle(root, poses + 72 * i);
        quaternion_rotate(y_to_z, place, place);
        for (int a = 0; a < 3; a++) trans[3 * i + a] = (float)(place[a] - motion->skeleton.rest_m[0][a]);
    }
    const npz_member member[] = {
        {"poses", 2, {frames, 72}, poses},           {"trans", 2, {frames, 3}, trans},
        {"betas", 1, {BODY_SHAPES}, motion->shapes}, {"mocap_frame_rate", 0, {0}, &rate},
        {.name = "gender", .text = "neutral"},
    };
    status = npz_write(c, path, COUNT_OF(member), member);
done:
    mem_free(poses);
    mem_free(trans);
    return status;
}

/* ---- BVH: SMPL's joints with the rest pose of its T, in centimetres, y up ---- */

static const char *const bvh_names[BODY_JOINTS] = {
    "Pelvis",     "L_Hip",      "R_Hip",   "Spine1",  "L_Knee",  "R_Knee",   "Spine2",   "L_Ankle",
    "R_Ankle",    "Spine3",     "L_Foot",  "R_Foot",  "Neck",    "L_Collar", "R_Collar", "Head",
    "L_Shoulder", "R_Shoulder", "L_Elbow", "R_Elbow", "L_Wrist", "R_Wrist",  "L_Hand",   "R_Hand"};

typedef struct {
    context *c;
    output_file file;
    const sherf_motion *motion;
    int order[BODY_JOINTS], count; /* joints as the file has them */
} bvh_writer;

static sherf_status write_joint(bvh_writer *w, int j) {
    const double(*rest)[3] = w->motion->skeleton.rest_m;
    const int p = skeleton_parent[j];
    double offset[3];
    bool leaf = true;
    w->order[w->count++] = j;
    for (int k = 0; k < 3; k++) offset[k] = p < 0 ? 0 : 100 * (rest[j][k] - rest[p][k]);
    sherf_status status =
        output_print(w->c, &w->file, "%s %s\n{\nOFFSET %.6f %.6f %.6f\nCHANNELS %s\n",
                     p < 0 ? "ROOT" : "JOINT", bvh_names[j], offset[0], offset[1], offset[2],
                     p < 0 ? "6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"
                           : "3 Zrotation Xrotation Yrotation");
    for (int i = j + 1; i < BODY_JOINTS && !status; i++)
        if (skeleton_parent[i] == j) status = write_joint(w, i), leaf = false;
    if (!status && leaf) /* half the last bone's offset */
        status = output_print(w->c, &w->file, "End Site\n{\nOFFSET %.6f %.6f %.6f\n}\n", offset[0] / 2,
                              offset[1] / 2, offset[2] / 2);
    return status ? status : output_print(w->c, &w->file, "}\n");
}

/* R = Rz Rx Ry. */
static void euler_zxy(const float q[4], double degrees[3]) {
    double R[9];
    quaternion_to_matrix(q, R);
    degrees[1] = asin(fmax(-1, fmin(1, R[7]))) * 180 / M_PI;
    if (fabs(R[7]) > 1 - 1e-9) { /* z and y turn about the same axis */
        degrees[0] = atan2(R[3], R[0]) * 180 / M_PI;
        degrees[2] = 0;
        return;
    }
    degrees[0] = atan2(-R[1], R[4]) * 180 / M_PI;
    degrees[2] = atan2(-R[6], R[8]) * 180 / M_PI;
}

static sherf_status write_frame(bvh_writer *w, int i) {
    const clip *k = &w->motion->clip;
    sherf_status status = output_print(w->c, &w->file, "%.6f %.6f %.6f", 100. * k->pelvis_m[i][0],
                                       100. * k->pelvis_m[i][1], 100. * k->pelvis_m[i][2]);
    for (int n = 0; n < w->count && !status; n++) {
        double angle[3];
        euler_zxy(k->turn[i][w->order[n]], angle);
        status = output_print(w->c, &w->file, " %.6f %.6f %.6f", angle[0], angle[1], angle[2]);
    }
    return status ? status : output_print(w->c, &w->file, "\n");
}

static sherf_status save_bvh(context *c, const sherf_motion *motion, const char *path) {
    bvh_writer w = {.c = c, .motion = motion};
    sherf_status status = output_open(c, path, &w.file);
    if (!status) status = output_print(c, &w.file, "HIERARCHY\n");
    if (!status) status = write_joint(&w, 0);
    if (!status)
        status = output_print(c, &w.file, "MOTION\nFrames: %d\nFrame Time: %.9g\n", motion->clip.frames,
                              1 / motion->clip.fps);
    for (int i = 0; i < motion->clip.frames && !status; i++) status = write_frame(&w, i);
    if (!status) status = output_commit(c, &w.file);
    output_abort(&w.file);
    return status;
}

sherf_status sherf_motion_save(sherf_context *c, const sherf_motion *motion, const char *path) {
    if (path_ends(path, ".bvh")) return save_bvh(c, motion, path);
    if (path_ends(path, ".npz")) return save_npz(c, motion, path);
    if (path_ends(path, ".glb")) return motion_save_glb(c, motion, path);
    return failure(c, SHERF_BAD_ARGUMENT, "%s: motions are written as .npz, .bvh or .glb", path);
}
