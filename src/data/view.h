/* A picture with its mask, camera and pose, assembled the way the data sets' loaders do. */
#ifndef SHERF_DATA_VIEW_H
#define SHERF_DATA_VIEW_H

#include "data/parse.h"

/* Longer sides would need gigabytes in the encoders; the message says to scale the picture down. */
enum { VIEW_SIDE_MAX = 4096 };

typedef struct {
    const char *image, *mask; /* paths; mask NULL: the picture's alpha channel */
    parsed_camera camera;     /* for the picture as it is in the file */
    sherf_pose pose;
    double scale;   /* used when width is 0 */
    int width;      /* 0: by scale */
    bool edge_band; /* ZJU-MoCap: a 5-pixel band along the mask's edge is unsure */
} view_source;
sherf_status view_assemble(context *c, const view_source *source, data_view **out);
#endif
