/* bvh_body: the motion of a BVH file on the 24 joints of the body. */
#ifndef SHERF_BVH_BODY_H
#define SHERF_BVH_BODY_H

#include "body/body.h"
#include "data/bvh_names.h"

typedef struct {
    int joint[BODY_JOINTS];       /* the file's joint whose rotation is taken; -1: the parent's */
    double align[BODY_JOINTS][9]; /* turns the body's bone at rest to the file's bone at rest */
    const char *names;            /* whose names the file uses: "CMU", "Mixamo", "SMPL"; static */
    bool calibrated;              /* the rest pose is no pose of a person; bvh_calibrate */
} bvh_body;

/* Recognises the joints (bvh_names_match). joints_rest: of the body in T-pose. Fails when hips, knees,
 * shoulders or elbows are not found. */
sherf_status bvh_body_match(context *c, const bvh *b, const value *given,
                            const float joints_rest[BODY_JOINTS][3], bvh_body *out);
/* For rigs whose rest pose is not a person's (all bones along one axis, as in LAFAN1): computes `align` of
 * the matched joints from the bones' directions in the joints' own axes, and from the frames, assuming that
 * on average no bone is twisted against its parent. Fails where the pelvis' axes cannot be determined. */
sherf_status bvh_calibrate(context *c, const bvh *b, const float joints_rest[BODY_JOINTS][3], bvh_body *map);
/* The body's pose in one frame; joint 0 takes the root's rotation. */
void bvh_body_pose(const bvh *b, const bvh_body *map, int frame, float pose_rad[72]);

#endif
