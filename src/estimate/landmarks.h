/* landmarks: finds people and their landmarks in a photo or in a video's frames. */
#ifndef SHERF_ESTIMATE_LANDMARKS_H
#define SHERF_ESTIMATE_LANDMARKS_H

#include "estimate/networks.h"
#include "estimate/person.h"

enum { PHOTO_PEOPLE_MAX = 8 };
/* At most `max` (1 to PHOTO_PEOPLE_MAX) people of an RGB photo, the largest first: *out holds *count of them,
 * freed with mem_free; none: *out is NULL and that is no failure. The same bits for any number of threads. */
sherf_status people_find(context *c, const pose_networks *n, const sherf_image *photo, int max,
                         photo_person **out, int *count);
/* One look at one region; out->score says whether it shows a person. */
sherf_status landmarks_find(context *c, const pose_networks *n, const sherf_image *photo,
                            const photo_region *region, photo_person *out);
/* Finds the person of the previous frame in the next one, without the detector. *there: the person is still
 * visible; otherwise *out is what was seen instead. `out` may be `before`. */
sherf_status landmarks_track(context *c, const pose_networks *n, const sherf_image *frame,
                             const photo_person *before, photo_person *out, bool *there);
#endif
