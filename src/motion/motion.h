/* motion: clips of a person's rotations, operations on them, and their sources. A clip lives in a world of
 * metres; its quaternions are unit ones, real part first. */
#ifndef SHERF_MOTION_H
#define SHERF_MOTION_H

#include "body/body.h"

enum { MOTION_FRAMES_MAX = 1000000 };

/* ---- quaternions (quaternion.c): w x y z ---- */
void quaternion_from_axis_angle(const double axis_angle_rad[3], float q[4]);
void quaternion_from_matrix(const double R[9], float q[4]);               /* R: a rotation */
void quaternion_to_axis_angle(const float q[4], float axis_angle_rad[3]); /* angle 0 to pi */
void quaternion_to_matrix(const float q[4], double R[9]);
void quaternion_multiply(const float a[4], const float b[4], float out[4]); /* b first; out may alias */
void quaternion_inverse(const float q[4], float out[4]);
/* From a (t = 0) to b (t = 1) along the shorter arc at constant speed. */
void quaternion_slerp(const float a[4], const float b[4], double t, float out[4]);
void quaternion_rotate(const float q[4], const double v[3], double out[3]);
double quaternion_angle(const float a[4], const float b[4]); /* between the two rotations, 0 to pi */

/* ---- the skeleton (skeleton.c) ---- */
typedef struct {
    double rest_m[BODY_JOINTS][3]; /* T-pose, y up */
    double radius_m[BODY_JOINTS];  /* how far below the joint the body reaches */
} skeleton;
extern const int8_t skeleton_parent[BODY_JOINTS];
/* body NULL: the average adult of the open body; shapes NULL: zeros. */
void skeleton_of(const body_model *body, const float *shapes, skeleton *out);
/* Joints with the pelvis at `pelvis_m`, joint 0 turning the whole. */
void skeleton_joints(const skeleton *s, const float (*turn)[4], const float pelvis_m[3],
                     double joints_m[BODY_JOINTS][3]);
/* The lowest part of the body along the unit vector `up`: min over joints of joint . up - radius. */
double skeleton_lowest(const skeleton *s, const float (*turn)[4], const float pelvis_m[3],
                       const double up[3]);

/* ---- clips (clip.c) ---- */
typedef struct {
    int frames;
    double fps;
    float (*turn)[BODY_JOINTS][4]; /* frames; joint 0 in the world, the others in their parent's axes */
    float (*pelvis_m)[3];          /* frames; in the world */
} clip;
sherf_status clip_create(context *c, int frames, double fps, clip *out);
void clip_free(clip *k); /* and zeroes it */
/* The clip at frame `at` (0 to frames - 1, need not be whole). */
void clip_at(const clip *k, double at, float turn[BODY_JOINTS][4], float pelvis_m[3]);
/* These replace the clip's content. On failure the clip is unchanged. */
/* Frame i becomes frame number[i] - number[0]; gaps are filled by interpolation. number ascends. */
sherf_status clip_spread(context *c, clip *k, const int64_t *number);
sherf_status clip_crop(context *c, clip *k, int first, int count);
sherf_status clip_resample(context *c, clip *k, double fps);
/* Smooths with a Gaussian of this standard deviation. Movement and rotation at constant speed stay
 * unchanged. */
sherf_status clip_smooth(context *c, clip *k, double seconds);
/* The same for a path of places; sigma in frames, more than 0. out: another array. */
void path_smooth(const float (*path)[3], int count, double sigma, float (*out)[3]);
/* Closes a loop: removes the root's change from beginning to end evenly over the clip, and the joints'
 * difference within its last half second (or half). The last frame, now equal to the first, is dropped. Needs
 * at least 2 frames. */
void clip_loop(clip *k);
/* Puts `count` frames in front that blend from the given pose to the clip's first, with a slow start and
 * end. */
sherf_status clip_lead_in(context *c, clip *k, int count, const float turn[BODY_JOINTS][4],
                          const float pelvis_m[3]);

/* ---- placing a clip (place.c) ---- */
/* Turns the clip from a world with this up axis (not AUTO) into one with y up. */
void clip_upright(clip *k, sherf_up up);
/* Mean of the body's own up over the frames. */
void clip_mean_up(const clip *k, double up[3]);
void clip_root(clip *k, const skeleton *s, sherf_root root);
/* Up, front and left of a body in the world as columns of B (left, up, front): up is the axis of the world
 * nearest to the body's own when they are within 30 degrees, else the body's own. */
void pose_axes(const sherf_pose *pose, double B[9]);
/* The first frame stands where the pose stands, on the same ground, facing where it faces. y is up before. */
void clip_start_at(clip *k, const skeleton *s, const sherf_pose *pose);
void pose_to_turns(const sherf_pose *pose, const skeleton *s, float turn[BODY_JOINTS][4], float pelvis_m[3]);

/* ---- save_glb.c ---- */
sherf_status motion_save_glb(context *c, const sherf_motion *motion, const char *path);

struct sherf_motion {
    clip clip;
    skeleton skeleton;
    float shapes[BODY_SHAPES]; /* of the poses handed out */
    bool file_has_shapes, loop;
    float file_shapes[BODY_SHAPES];
    int blend_frames;
    char description[400];
};

#endif
