/* tpose: poses a shaped MakeHuman mesh (A-pose) as SMPL's rest pose, with SMPL's 24 joints. Arms lie along +x
 * and -x, palms down, thumbs forward. Legs are as SMPL's (thighs 5 degrees out, shins 2 in and 6 back), soles
 * are flat, trunk and head stay as they are. The mesh's own rig moves it with four weights, and its helpers
 * (to which clothes, hair and eyes are bound) move with the body. The pelvis moves to tpose_pelvis_m, SMPL's
 * place, so SMPL poses with their translations drive it unchanged. */
#ifndef SHERF_TPOSE_H
#define SHERF_TPOSE_H

#include "body/body.h"
#include "synth/body/makehuman.h"

extern const double tpose_pelvis_m[3];
extern const int tpose_parent[BODY_JOINTS]; /* SMPL's tree */
extern const char *const tpose_joint_names[BODY_JOINTS];

/* Data that depend only on the rig. Read-only after creation; threads may share it. */
typedef struct tpose_rig tpose_rig;
sherf_status tpose_rig_create(context *c, const makehuman *human, tpose_rig **out);
void tpose_rig_free(tpose_rig *rig);
/* vertices: V x 3 as makehuman_shape gives them. out: V x 3, may be the same array. joints: where the rig has
 * SMPL's joints in that mesh (a body file regresses them from its vertices: within a few mm). bone (may be
 * NULL): bones x 12, row-major 3 x 4, A-pose to T-pose of each bone: a pose of MakeHuman's rig (global
 * rotation G of a bone) is SMPL's global rotation G * transpose(bone's rotation). */
sherf_status tpose_apply(context *c, const makehuman *human, const tpose_rig *rig, const float *vertices,
                         float *out, double joints[BODY_JOINTS][3], double *bone);

/* Blend weights of SMPL's joints for all V vertices, V x 24: the rig's, merged, and smoothed along the mesh
 * `rounds` times (0: not; the open body's: TPOSE_SMOOTHING). Each sums to 1; at most 8 are not 0. */
enum { TPOSE_SMOOTHING = 4 };
sherf_status tpose_weights(context *c, const makehuman *human, const tpose_rig *rig, int rounds,
                           float *weights);

#endif
