/* people_cameras: places cameras round made people. */
#ifndef SHERF_PEOPLE_CAMERAS_H
#define SHERF_PEOPLE_CAMERAS_H

#include "synth/people/people.h"

/* A ring about the world's origin: view views / 2 looks at the front, heights vary, and the distances make a
 * ball of this radius fit. */
void people_cameras_ring(uint64_t key, float radius_m, int views, int size_px, sherf_camera *out);

/* Cameras as people hold telephones: 0.8 to 1.65 m above the floor, about level, 26 to 70 mm (for 36 x 24 mm
 * film held upright), up to 0.35 rad off the ring's places. The points, which represent everything visible,
 * fill 55 to 95 % of the picture's height or at most its width, off centre. */
sherf_status people_cameras_photo(context *c, uint64_t key, int64_t points, const float *points_world,
                                  float floor_world, int views, int size_px, sherf_camera *out);

#endif
