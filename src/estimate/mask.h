/* mask: a person cut out of a photo. The network's mask is coarse (256 x 256 over the person's region) but
 * mostly right; the picture's edges tell where exactly the person ends. */
#ifndef SHERF_ESTIMATE_MASK_H
#define SHERF_ESTIMATE_MASK_H

#include "estimate/person.h"

typedef struct {
    float area;      /* share of the photo's pixels that are the person's */
    float cut_off;   /* share of the region's outline inside the photo that the person crosses */
    bool over;       /* the person extends beyond the region: some of it is missing */
    float border[4]; /* share of the photo's left, top, right and bottom border that is the person's */
} person_mask_facts;

/* The network's mask alone, at the photo's resolution: [H, W, 1], bilinear, 0 outside the region. */
sherf_status person_mask_network(context *c, const sherf_image *photo, const photo_person *person,
                                 sherf_image *mask);

/* mask: [H, W, 1], in [0, 1], soft at hair and at blurred edges, 0 outside the person's region; freed with
 * sherf_image_free. photo: RGB in [0, 1]. Removes the bodies of the others (there may be none). facts may be
 * NULL. A mask without anybody is a failure. The same bits for any number of threads. */
sherf_status person_mask(context *c, const sherf_image *photo, const photo_person *person,
                         const photo_person *others, int other_count, sherf_image *mask,
                         person_mask_facts *facts);

/* out: the photo, [H, W, 3], with the person's own colours where the mask is soft and in a band inside its
 * edge, where the camera mixed them with the background's; unchanged elsewhere. A mask of any origin will do,
 * hard or soft.
 *
 * An observation's mask is hard: the person is where the soft mask is at least a half, with these colours. It
 * then needs no shrinking; without these colours a rim of background remains. */
sherf_status mask_free_colors(context *c, const sherf_image *photo, const sherf_image *mask,
                              sherf_image *out);
#endif
