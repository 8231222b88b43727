/* detect: where people are in a picture. */
#ifndef SHERF_ESTIMATE_DETECT_H
#define SHERF_ESTIMATE_DETECT_H

#include "estimate/networks.h"
#include "estimate/person.h"

typedef struct {
    float score;         /* probability that this is a person */
    float box_px[4];     /* left, top, right, bottom, about the head; tells detections of one person */
    photo_region region; /* the whole person */
} detection;

enum { DETECTIONS_MAX = 32 };
/* Up to DETECTIONS_MAX of them into out, the largest first; people who are found twice are told apart by
 * their boxes. The whole photo is looked at first; while only small people are found in it, or none, squares
 * of a half and then of a quarter of its longer side are. */
sherf_status people_detect(context *c, const pose_networks *n, const sherf_image *photo, detection *out,
                           int *count);
#endif
