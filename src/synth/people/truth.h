/* truth: made people as surfaces, in their drawn poses or any others. Meshes are not written with the
 * pictures: a person's number reproduces them exactly. */
#ifndef SHERF_TRUTH_H
#define SHERF_TRUTH_H

#include "scene/solid.h"
#include "synth/people/dress.h"

typedef struct people_truth people_truth;
/* source, body_path: as in sherf_people_options, and as used to draw the people. */
sherf_status people_truth_open(context *c, const char *source, const char *body_path, people_truth **out);
void people_truth_close(people_truth *t); /* NULL is fine */
/* The number in a made person's name, "person_001234"; false: it is no such name. */
bool people_truth_number(const char *name, uint64_t *number);
/* Body and clothes, the body first. Hair and lashes are half transparent, so they are left out. */
typedef struct {
    int meshes;
    int mesh[DRESSED_MAX];         /* which of the person's (dress.h) each is */
    solid_mesh drawn[DRESSED_MAX]; /* as in pictures: open shells with missing hidden faces */
    solid_mesh walls[DRESSED_MAX]; /* the same with all faces of the body, for solid_grid_create: drawn bodies
                                      have no skin under a shirt's hem, and the flood would enter there */
} people_surface;
/* The surface of meshes at `position` (dressed_pose); valid as long as they are. */
void people_surface_of(const studio *s, const dressed *d, float *const *position, people_surface *out);
/* Person `number` in this pose, in its world, metres. *out belongs to t and holds until the next call. */
sherf_status people_truth_pose(context *c, people_truth *t, uint64_t number, const sherf_pose *pose,
                               const people_surface **out);

#endif
