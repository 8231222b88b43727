/* A picture with its mask, camera and pose, assembled the way the data sets' loaders do. */
#ifndef SHERF_DATA_VIEW_H
#define SHERF_DATA_VIEW_H

#include "data/parse.h"

/* Maximum sides of files and of the pictures made from them. An observation is scaled down to the last one,
 * because larger pictures cost gigabytes (4 GB, and an avatar of 0.3 GB, at 2048 x 2048) for details that
 * networks have not seen in training. */
enum { VIEW_READ_SIDE_MAX = IMAGE_SIDE_MAX, VIEW_SIDE_MAX = 4096, VIEW_OBSERVED_SIDE_MAX = 2048 };

/* Which of a mask's values are the person, where it is no soft one. */
typedef struct {
    enum {
        MASK_LABEL_ANY,
        MASK_LABEL_ALL,
        MASK_LABEL_ONE
    } kind;         /* any: all, unless they are several people */
    uint32_t color; /* of the one: 0xrrggbb */
} mask_label;
/* color: the mask's file with 4 channels. mask: 1 where the person may be, made smaller; soft: by a
 * threshold. Fails for several people apart, and where no pixel is of the label; the message lists the
 * labels. */
sherf_status mask_labels(context *c, const char *path, const image_u8 *color, const mask_label *wanted,
                         bool soft, image_u8 *mask);

typedef struct {
    const char *image, *mask; /* paths; mask NULL: the picture's alpha channel */
    mask_label label;
    parsed_camera camera; /* for the unscaled picture in the file */
    sherf_pose pose;
    double scale;  /* used when width is 0 */
    int width;     /* 0: by scale */
    bool observed; /* the result is no longer than VIEW_OBSERVED_SIDE_MAX, width is 0, the mask may be soft */
    bool whole;    /* the background stays in the picture */
    bool edge_band; /* ZJU-MoCap: a 5-pixel band along the mask's edge is uncertain */
} view_source;
sherf_status view_assemble(context *c, const view_source *source, data_view **out);
#endif
