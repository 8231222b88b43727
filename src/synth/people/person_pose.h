/* person_pose: what people do: standing, walking, running, sitting, reaching, as SMPL poses. Every pose
 * follows from its key. */
#ifndef SHERF_PERSON_POSE_H
#define SHERF_PERSON_POSE_H

#include "body/body.h"

typedef enum {
    POSE_WALK,     /* curves */
    POSE_RUN,      /* curves */
    POSE_FREE,     /* drawn within what joints reach, about a few postures */
    POSE_POSTURE,  /* about a posture that was given: those of MakeHuman's package */
    POSE_CAPTURED, /* a frame of a motion that was given */
    POSE_KINDS
} pose_kind;

typedef struct pose_library pose_library;
sherf_status pose_library_create(context *c, pose_library **out);
void pose_library_free(pose_library *l);
/* Copied. name is kept for messages. */
sherf_status pose_library_add_posture(context *c, pose_library *l, const char *name,
                                      const float pose_rad[72]);
/* Frames of a BVH file whose joints are named as bvh_body.h says, some `every` seconds. */
sherf_status pose_library_add_bvh(context *c, pose_library *l, const char *path,
                                  const float joints_rest[BODY_JOINTS][3], double every_s);
/* A pose with joint 0 upright or tilted as the kind wants it; the turn about the vertical is the caller's. */
pose_kind pose_draw(const pose_library *l, uint64_t key, float pose_rad[72]);
/* What people do who are photographed: half of them stand or talk, upright, a quarter walk, and the others do
 * anything. */
void pose_draw_photo(const pose_library *l, uint64_t key, float pose_rad[72]);
/* Metres by which the body's weight lies outside its soles, and by which one foot hangs above the other
 * beyond what a step needs; 0: it stands. vertices: in the world, y up. */
float pose_imbalance(const body_model *body, const float *vertices_world);
/* Phase 0 to 1 of one step of each leg. */
void pose_walk(double phase, double vigour, float pose_rad[72]);

/* Ranges of the axis-angle components. */
extern const float pose_lowest[BODY_JOINTS][3], pose_highest[BODY_JOINTS][3];
bool pose_within(const float pose_rad[72]); /* with 1e-4 to spare; joint 0 is free */
void pose_clamp(float pose_rad[72]);

/* How deeply arms lie in the trunk and thighs, or legs in each other: the share of the limbs' vertices that
 * are more than 2 cm inside. vertices: of the body in this pose, in SMPL space. */
sherf_status pose_overlap(context *c, const body_model *body, const float *vertices_smpl, float *share);

#endif
