/* bvh_body: the motion of a BVH file on the 24 joints of the body. */
#ifndef SHERF_BVH_BODY_H
#define SHERF_BVH_BODY_H

#include "body/body.h"
#include "io/bvh.h"

typedef struct {
    int joint[BODY_JOINTS];       /* the file's joint whose rotation is taken; -1: the parent's */
    double align[BODY_JOINTS][9]; /* turns the body's bone at rest to the file's bone at rest */
    const char *names;            /* whose names the file uses: "CMU", "Mixamo", "SMPL"; static */
} bvh_body;

/* Recognises the joints by name (those of CMU's conversion, Mixamo and SMPL exporters). joints_rest: of the
 * body in T-pose. Fails when hips, knees, shoulders or elbows are not found. */
sherf_status bvh_body_match(context *c, const bvh *b, const float joints_rest[BODY_JOINTS][3], bvh_body *out);
/* The body's pose in one frame; joint 0 takes the root's rotation. */
void bvh_body_pose(const bvh *b, const bvh_body *map, int frame, float pose_rad[72]);

#endif
