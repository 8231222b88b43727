/* people_photo: a traced person in front of a place, as a camera would store it. */
#ifndef SHERF_PEOPLE_PHOTO_H
#define SHERF_PEOPLE_PHOTO_H

#include "synth/people/dress.h"
#include "synth/people/place.h"

/* picture: the person, over black; its alpha becomes the mask's. position: of the dressed meshes, world.
 * p->near_color is filled in. rgb: H x W x 3, with a little grain; mask: 255 where the person covers half a
 * pixel or more. */
sherf_status people_photo(context *c, place *p, const trace_light *light, const dressed *d,
                          const float *const *position, const sherf_camera *camera, trace_picture *picture,
                          uint8_t *rgb, uint8_t *mask);

#endif
