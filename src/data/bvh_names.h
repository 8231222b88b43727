/* bvh_names: finds the body's joints in a BVH file, by their names and by the hierarchy. */
#ifndef SHERF_BVH_NAMES_H
#define SHERF_BVH_NAMES_H

#include "body/body.h"
#include "io/bvh.h"
#include "io/value.h"

/* SMPL's name of joint j, in lower case: "left_hip". */
const char *joint_name(int j);

/* The file's joint for each of the body's, or -1; and whose names they are ("Mixamo"; static). Limbs are
 * found by name, on both sides, and the trunk by the hierarchy: the pelvis carries legs and spine, the chest
 * the arms. given: a dict from SMPL's names to the file's (or from the file's to SMPL's), which takes
 * precedence; or NULL. Fails if hips, knees, shoulders or elbows are not found, or if the file has no joint
 * of a given name. */
sherf_status bvh_names_match(context *c, const bvh *b, const value *given, int joint[BODY_JOINTS],
                             const char **whose);

#endif
