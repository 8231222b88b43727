/* person_pose: poses of people who stand, walk, run, sit or reach, as SMPL poses. Every pose follows from its
 * key. */
#ifndef SHERF_PERSON_POSE_H
#define SHERF_PERSON_POSE_H

#include "body/body.h"

typedef enum {
    POSE_WALK,     /* curves */
    POSE_RUN,      /* curves */
    POSE_FREE,     /* random within joint limits, about a few postures */
    POSE_POSTURE,  /* about a given posture: those of MakeHuman's package */
    POSE_CAPTURED, /* a frame of a given motion */
    POSE_KINDS
} pose_kind;

typedef struct pose_library pose_library;
sherf_status pose_library_create(context *c, pose_library **out);
void pose_library_free(pose_library *l);
/* Copied. name is kept for messages. */
sherf_status pose_library_add_posture(context *c, pose_library *l, const char *name,
                                      const float pose_rad[72]);
/* Frames of a BVH file whose joints have names that bvh_body.h knows, one every `every` seconds. */
sherf_status pose_library_add_bvh(context *c, pose_library *l, const char *path,
                                  const float joints_rest[BODY_JOINTS][3], double every_s);
/* A pose with joint 0 upright or tilted as its kind requires; the caller sets the rotation about the
 * vertical. */
pose_kind pose_draw(const pose_library *l, uint64_t key, float pose_rad[72]);
/* Poses of photographed people: half of them stand or talk, upright, a quarter walk, and the others do
 * anything. */
void pose_draw_photo(const pose_library *l, uint64_t key, float pose_rad[72]);
/* How many metres the centre of mass lies outside the soles, and how far one foot hangs above the other
 * beyond a step's needs; 0: it stands. vertices: in the world, y up. */
float pose_imbalance(const body_model *body, const float *vertices_world);
/* Phase 0 to 1 of one step of each leg. */
void pose_walk(double phase, double vigour, float pose_rad[72]);

/* Ranges of the axis-angle components. */
extern const float pose_lowest[BODY_JOINTS][3], pose_highest[BODY_JOINTS][3];
bool pose_within(const float pose_rad[72]); /* with 1e-4 to spare; joint 0 is free */
void pose_clamp(float pose_rad[72]);

/* How deep arms are in the trunk and thighs, or legs in each other: the share of the limbs' vertices more
 * than 2 cm inside. vertices: of the body in this pose, in SMPL space. */
sherf_status pose_overlap(context *c, const body_model *body, const float *vertices_smpl, float *share);

#endif
