/* bvh: motion files in Biovision's format: a tree of joints with Euler channels, then frames of numbers. */
#ifndef SHERF_BVH_H
#define SHERF_BVH_H

#include "base/base.h"

enum { BVH_JOINTS_MAX = 1024, BVH_DEPTH_MAX = 128, BVH_NAME = 64 };

typedef enum {
    BVH_X_POSITION,
    BVH_Y_POSITION,
    BVH_Z_POSITION,
    BVH_X_ROTATION,
    BVH_Y_ROTATION,
    BVH_Z_ROTATION
} bvh_channel;

typedef struct {
    char name[BVH_NAME]; /* "" for an end site; longer names are cut */
    int parent;          /* -1 for the root; parent < own index */
    bool end;            /* an end site: an offset without channels */
    double offset[3];    /* from the parent, in the file's unit */
    int first, channels; /* range of a frame's numbers */
    uint8_t channel[6];  /* bvh_channel, in the order in which rotations are multiplied */
} bvh_joint;

typedef struct {
    int joints, channels, frames;
    double frame_time_s; /* 0 or more; exactly as in the file */
    bvh_joint *joint;
    float *value; /* frames x channels; degrees and the file's unit */
} bvh;

sherf_status bvh_read(context *c, const char *path, bvh **out);
sherf_status bvh_parse(context *c, const unsigned char *data, size_t bytes, bvh **out);
void bvh_free(bvh *b);
/* Rotations of one frame (0 <= frame < frames) from the file's rest pose, in the file's axes: joints x 9,
 * row-major. Either may be NULL. */
void bvh_rotations(const bvh *b, int frame, double *local, double *global);
/* The root's position in that frame: its offset, or its position channels if it has them. */
void bvh_root_position(const bvh *b, int frame, double position[3]);
/* Any joint's position and rotation (9, row-major; may be NULL) in that frame, in the file's axes and unit.
 */
void bvh_joint_position(const bvh *b, int frame, int joint, double position[3], double rotation[9]);
/* Index of a joint by name; -1: there is none. */
int bvh_find(const bvh *b, const char *name);

#endif
