/* surfaces: what a sample of a model that learns from surfaces is made of. */
#ifndef SHERF_TRAIN_SURFACES_H
#define SHERF_TRAIN_SURFACES_H

#include "model/model.h"
#include "train/draw.h"

/* `count` points of the person's in the pose, half of them inside, and as many places, each moved along its
 * normal by a normal deviation of a millimetre; drawn by the key. */
sherf_status surface_draw_create(context *c, const sherf_dataset *d, int person, int pose, int64_t count,
                                 uint64_t key, surface_draw *out);
void surface_draw_free(surface_draw *s);
/* Memory for so many, without values. */
sherf_status surface_draw_room(context *c, int64_t count, surface_draw *out);
/* Before a training: whether every pose of its people has a surface; otherwise surface_truth_find's line. */
sherf_status surfaces_are_there(context *c, const sherf_dataset *d, const sampling *s);

#endif
