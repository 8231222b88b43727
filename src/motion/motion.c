/* The public motion: poses of a clip ready for playback. */
#include <math.h>
#include <string.h>

#include "io/value.h"
#include "motion/motion.h"

void sherf_motion_free(sherf_motion *motion) {
    if (!motion) return;
    clip_free(&motion->clip);
    mem_free(motion);
}

int sherf_motion_frame_count(const sherf_motion *motion) {
    return motion->clip.frames;
}
double sherf_motion_fps(const sherf_motion *motion) {
    return motion->clip.fps;
}
int sherf_motion_blend_frames(const sherf_motion *motion) {
    return motion->blend_frames;
}
const char *sherf_motion_description(const sherf_motion *motion) {
    return motion->description;
}
const float *sherf_motion_shapes(const sherf_motion *motion) {
    return motion->file_has_shapes ? motion->file_shapes : NULL;
}

static void pose_of(const sherf_motion *motion, const float (*turn)[4], const float pelvis_m[3],
                    sherf_pose *out) {
    sherf_pose_identity(out);
    memcpy(out->shapes, motion->shapes, sizeof out->shapes);
    for (int j = 0; j < BODY_JOINTS; j++) quaternion_to_axis_angle(turn[j], out->poses_rad + 3 * j);
    for (int a = 0; a < 3; a++) out->Th_m[a] = (float)(pelvis_m[a] - motion->skeleton.rest_m[0][a]);
}

void sherf_motion_pose(const sherf_motion *motion, int frame, sherf_pose *out) {
    frame = frame < 0 ? 0 : frame < motion->clip.frames ? frame : motion->clip.frames - 1;
    pose_of(motion, (const float(*)[4])motion->clip.turn[frame], motion->clip.pelvis_m[frame], out);
}

void sherf_motion_pose_at(const sherf_motion *motion, double seconds, sherf_pose *out) {
    float turn[BODY_JOINTS][4], pelvis_m[3];
    const clip *k = &motion->clip;
    double at = isfinite(seconds) ? seconds * k->fps : 0;
    int begin = motion->blend_frames, period = k->frames - begin;
    if (motion->loop && at >= k->frames - 1) at = begin + fmod(at - begin, period);
    if (motion->loop && at > k->frames - 1) { /* from the last frame to the first again */
        double t = at - (k->frames - 1);
        for (int j = 0; j < BODY_JOINTS; j++)
            quaternion_slerp(k->turn[k->frames - 1][j], k->turn[begin][j], t, turn[j]);
        for (int a = 0; a < 3; a++)
            pelvis_m[a] = (float)((1 - t) * k->pelvis_m[k->frames - 1][a] + t * k->pelvis_m[begin][a]);
    } else
        clip_at(k, at, turn, pelvis_m);
    pose_of(motion, (const float(*)[4])turn, pelvis_m, out);
}
