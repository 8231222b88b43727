/* stages: joins an encoder's maps of several sizes to one, and finds a picture's points in it. For models
 * whose pixel-aligned features come from several ResNet stages. */
#ifndef SHERF_STAGES_H
#define SHERF_STAGES_H

#include "model/model.h"

/* The setting `encoder`: a ResNet of 18 or 34 layers. */
sherf_status encoder_check(context *c, int layers);
/* Maps [h, w, C], 2 to 4 of them, resized to the size of the first, corners on corners, side by side. */
tensor *stages_side_by_side(tape *t, int count, tensor *const *stage);
/* Pixel (u, v) of a W x H picture is at (u W_f / W, v H_f / H) in a map, clamped to it. */
typedef struct {
    float across, down, right, bottom;
} map_place;
map_place map_place_of(const tensor *map, int width, int height);
void map_position(const map_place *p, const float px[2], float out[2]);

#endif
