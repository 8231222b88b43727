/* look: what the network of landmarks sees in a region of a photo, and in its mirror image. */
#ifndef SHERF_ESTIMATE_LOOK_H
#define SHERF_ESTIMATE_LOOK_H

#include "estimate/networks.h"
#include "estimate/person.h"

/* One look at one region. Mirrored: the network sees the region's mirror image, and what it says is mirrored
 * back, left and right exchanged. */
sherf_status look_once(context *c, const pose_networks *n, const sherf_image *photo,
                       const photo_region *region, bool mirrored, photo_person *out);
/* Looks until the region stops moving. *there: a person, and none of the `count` who are known. */
sherf_status look_until_settled(context *c, const pose_networks *n, const sherf_image *photo,
                                const photo_region *region, const photo_person *known, int count,
                                photo_person *out, bool *there);
/* Looks at the mirror image of p's region as well and joins the two; where they do not agree which way the
 * person is turned, further looks vote. *doubt: how far apart the two place the limbs, as a part of the
 * region's side; 1: the mirror image shows nobody. For people who are wholly in their region it is 0.004 to
 * 0.014, for what is nobody or a piece of somebody 0.02 to 1. */
sherf_status look_mirrored(context *c, const pose_networks *n, const sherf_image *photo, photo_person *p,
                           float *doubt);
/* Hair over the face, or a hat from behind, make the network take front for back. So it looks once more with
 * the head hidden; where it then sees the person the other way round, mirrored too, and so do both looks at
 * the upper half, p's landmarks become those without the head. Mostly one look. */
sherf_status look_without_head(context *c, const pose_networks *n, const sherf_image *photo, photo_person *p);
/* Whether a look can be had: not a point, and not beside the photo. */
bool look_is_sound(const sherf_image *photo, const photo_region *r);
#endif
