/* surfaces: points and places for a sample of a model that is trained on surfaces. */
#ifndef SHERF_TRAIN_SURFACES_H
#define SHERF_TRAIN_SURFACES_H

#include "model/model.h"
#include "train/draw.h"

/* `count` points of the person's in the pose, half of them inside, and as many places, each moved along its
 * normal by a normal deviation of a millimetre; drawn by the key. */
sherf_status surface_draw_create(context *c, const sherf_dataset *d, int person, int pose, int64_t count,
                                 uint64_t key, surface_draw *out);
void surface_draw_free(surface_draw *s);
/* Allocates this many, without values. */
sherf_status surface_draw_room(context *c, int64_t count, surface_draw *out);
/* Checks before a training that every pose of its people has a surface; otherwise fails with
 * surface_truth_find's message. */
sherf_status surfaces_are_there(context *c, const sherf_dataset *d, const sampling *s);

#endif
