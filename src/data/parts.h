/* parts: the parts of a body in a dict, by the names that the tools which write them use. One table for
 * observations, files of poses and motions. */
#ifndef SHERF_DATA_PARTS_H
#define SHERF_DATA_PARTS_H

#include "data/six.h"

typedef enum {
    PART_POSES,        /* all joints: poses, smpl_thetas, ... */
    PART_BODY,         /* all joints but the root: body_pose, pose_body, ... */
    PART_ROOT,         /* global_orient, root_pose, ... */
    PART_SHAPES,       /* betas, shape, ... */
    PART_TURN,         /* R, Rh: beside the root's rotation */
    PART_PLACE,        /* the body's translation: transl, Th, ... */
    PART_CAMERA_TURN,  /* of a camera that the tool puts the body before: camera_rotation */
    PART_CAMERA_PLACE, /* cam_t, camera_translation, global_t, ... */
    PART_PELVIS        /* where the pelvis is, instead of a translation: transl_pelvis; mesh_infos' Th */
} body_part;
enum { PARTS = PART_PELVIS + 1 };

typedef struct {
    const char *name; /* the name in the file; NULL: missing */
    const value *item;
} named_value;
typedef struct {
    named_value part[PARTS];
    /* Whether it is SMPL-X, as faces and eyes beside it and names show (55 joints show it as well). At rest
     * its pelvis is offset from SMPL's by smplx_pelvis_m, so the same translation means another position. */
    bool smplx;
    six_kind six;        /* what the file says of rotations with six numbers */
    named_value scaling; /* AIST++'s: its vertices are SMPL's times it, and moved by the translation */
} body_parts;
extern const double smplx_pelvis_m[3];
extern const double smpl_pelvis_m[3]; /* the pelvis of SMPL's neutral template */

/* The first of these names (up to NULL) that the dict has and that is not null; item NULL: none. */
named_value value_first(const value *dict, const char *const *names);
/* The parts of a dict or record. If it holds the body in an inner dict (pred_smpl_params, smpl, results, ...;
 * or under any key, if no other inner dict has poses), parts inside take precedence over parts beside it. */
void body_parts_find(const value *v, body_parts *out);
/* Logs the keys that are neither parts nor known to be irrelevant, in one warning that begins with `what`;
 * and in another warning a body whose root has no rotation. */
void body_parts_warn(context *c, const value *v, const char *what);
/* Fails for a dict without poses; the message says what it has instead. */
sherf_status body_parts_missing(context *c, const value *v);
/* Fails with `what` and the keys that exist. */
sherf_status keys_missing(context *c, const value *v, const char *what);
/* Logs the keys of any dict that are not among `known` (up to NULL). */
void unknown_keys_warn(context *c, const value *v, const char *const *known, const char *what);

#endif
