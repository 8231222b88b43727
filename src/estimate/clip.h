/* clip: a video of one person to a motion. Landmarks are tracked from frame to frame; the shape, the focal
 * length and the camera's pitch are found once; a body is fitted to every frame, beginning with the one
 * before; then rotations and places are smoothed, and standing feet are held in place (docs/photo.md). */
#ifndef SHERF_ESTIMATE_CLIP_H
#define SHERF_ESTIMATE_CLIP_H

#include "estimate/networks.h"
#include "motion/motion.h"

enum { CLIP_FRAMES_MAX = 36000, CLIP_SIDE_PX = 1280 };

/* facts may be NULL, o not. *out is freed with sherf_motion_free. Same video, same bits, for any number of
 * threads. The errors are those of video_read.h, and SHERF_BAD_FILE where nobody is seen or no body fits. */
sherf_status clip_estimate(context *c, const pose_networks *n, const body_model *body, const char *path,
                           const sherf_clip_options *o, sherf_motion **out, sherf_clip_facts *facts);
#endif
