/* detect: where people are in a picture. */
#ifndef SHERF_ESTIMATE_DETECT_H
#define SHERF_ESTIMATE_DETECT_H

#include "estimate/networks.h"
#include "estimate/person.h"

typedef struct {
    float score;     /* probability that this is a person */
    float box_px[4]; /* left, top, right, bottom, about the head; identifies detections of the same person */
    photo_region region; /* the whole person */
} detection;

enum { DETECTIONS_MAX = 24 };
/* Up to DETECTIONS_MAX of them into out, the largest first; their boxes show who was found twice. Searches
 * the whole photo, then squares of half its longer side, then, if only small people were found or none, of a
 * quarter. */
sherf_status people_detect(context *c, const pose_networks *n, const sherf_image *photo, detection *out,
                           int *count);
#endif
