/* look: runs the landmark network on a region of a photo, and on its mirror image. */
#ifndef SHERF_ESTIMATE_LOOK_H
#define SHERF_ESTIMATE_LOOK_H

#include "estimate/networks.h"
#include "estimate/person.h"

/* One look at one region. Mirrored: the network sees the region's mirror image, and its result is mirrored
 * back with left and right swapped. */
sherf_status look_once(context *c, const pose_networks *n, const sherf_image *photo,
                       const photo_region *region, bool mirrored, photo_person *out);
/* Looks until the region stops moving. *there: it shows a person, and none of the `count` known ones. */
sherf_status look_until_settled(context *c, const pose_networks *n, const sherf_image *photo,
                                const photo_region *region, const photo_person *known, int count,
                                photo_person *out, bool *there);
/* Looks at the mirror image of p's region as well and joins the two; where they do not agree which way the
 * person is turned, further looks vote. *doubt: how far apart the two place the limbs, as a part of the
 * region's side; 1: the mirror image shows nobody. For people wholly in their region it is 0.004 to 0.014;
 * for no person, or a part of one, 0.02 to 1. */
sherf_status look_mirrored(context *c, const pose_networks *n, const sherf_image *photo, photo_person *p,
                           float *doubt);
/* Hair over the face, or a hat from behind, make the network take front for back. So it looks once more with
 * the head hidden. If that shows the person the other way round, the mirrored look and both looks at the
 * upper half are tried too; if all agree, p's landmarks become those without the head. Usually one look is
 * enough. */
sherf_status look_without_head(context *c, const pose_networks *n, const sherf_image *photo, photo_person *p);
/* Whether a look is possible: the region is not a point and not outside the photo. */
bool look_is_sound(const sherf_image *photo, const photo_region *r);
#endif
