/* bvh_names: which of a BVH file's joints are the body's, by their names and by what hangs on what. */
#ifndef SHERF_BVH_NAMES_H
#define SHERF_BVH_NAMES_H

#include "body/body.h"
#include "io/bvh.h"
#include "io/value.h"

/* SMPL's name of joint j, in small letters: "left_hip". */
const char *joint_name(int j);

/* The file's joint for each of the body's, or -1; and whose names they are ("Mixamo"; static). Limbs are told
 * by name, on both sides; the trunk by what hangs on what: the pelvis carries legs and spine, the chest the
 * arms. given: a dict of SMPL's names and the file's (or the other way round), which go first; or NULL. Fails
 * when hips, knees, shoulders or elbows are not found, or a name is not there. */
sherf_status bvh_names_match(context *c, const bvh *b, const value *given, int joint[BODY_JOINTS],
                             const char **whose);

#endif
