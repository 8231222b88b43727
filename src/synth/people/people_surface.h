/* people_surface: a made person's surface in a pose, as a file for training models. */
#ifndef SHERF_PEOPLE_SURFACE_H
#define SHERF_PEOPLE_SURFACE_H

#include "data/surface_truth.h"
#include "synth/people/truth.h"

/* scene: of the person, in the same pose as `position` and in its light. */
sherf_status people_surface_write(context *c, const studio *s, const dressed *d, const trace_scene *scene,
                                  float *const *position, uint64_t key, const char *path);
/* SHERF_MISMATCH if the person in `folder` has another pose here: another version drew it. */
sherf_status people_surface_same(context *c, const char *folder, int pose, int vertices,
                                 const float *vertices_world);

#endif
