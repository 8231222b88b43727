/* clip_inside: shared by the files of clip. */
#ifndef SHERF_ESTIMATE_CLIP_INSIDE_H
#define SHERF_ESTIMATE_CLIP_INSIDE_H

#include "estimate/clip.h"
#include "estimate/fit.h"
#include "io/video_read.h"

/* A photo_person takes 260 KB; of a frame 17 KB are kept. */
enum { CLIP_MASK_SIDE = PERSON_MASK_SIDE / 2 };
typedef struct {
    float score;
    photo_region region, next;
    landmark landmark[LANDMARKS];
    uint8_t inside[CLIP_MASK_SIDE * CLIP_MASK_SIDE]; /* probabilities of 2 x 2, in 255ths */
    bool swapped; /* left and right were exchanged; the landmarks here are corrected */
    bool fitted;
    body_fit_result fit;
} clip_frame;

/* A picture's mean colours, to find cuts by. */
enum { CLIP_CELLS = 16 };
typedef struct {
    uint8_t rgb[CLIP_CELLS * CLIP_CELLS][3];
} clip_thumbnail;

typedef struct {
    clip_frame **frame; /* NULL: the person was not seen, or the video's picture is the one before */
    int count, room;
    bool *repeated; /* the picture was the one before */
    clip_thumbnail *thumbnail;
    int cuts, read, start; /* cuts and frames of the video; of these, the frames before frame 0 here */
    int width, height;     /* of the pictures that the networks saw */
    int people;            /* in the first frame that shows anybody */
    double fps, scale;     /* pixels of the full video per pixel of those pictures */
} clip_track;
void clip_track_free(clip_track *t);
/* Runs the networks on all frames of the video (clip_look.c). */
sherf_status clip_look(context *c, const pose_networks *n, const char *path, const sherf_clip_options *o,
                       clip_track *t);
void clip_frame_person(const clip_frame *f, photo_person *out);

void clip_thumbnail_make(const image_u8 *picture, clip_thumbnail *out);
/* Whether another shot begins with frame n, as far as thumbnails before frame `end` tell (clip_cuts.c). */
bool clip_cut_at(const clip_track *t, int n, int end);
/* Keeps of a video with cuts the shot that shows the person in most frames. Flashes are not cuts. */
void clip_keep_shot(clip_track *t);

/* Where the networks took front for back for less than about a second, exchanges left and right again;
 * returns the number of such frames. */
sherf_status clip_repair(context *c, clip_track *t, int *repaired);

/* min over x of sum_i weight_i (x_i - value_i)^2 + stiffness sum_i (x_{i-1} - 2 x_i + x_{i+1})^2
 * + sum_i pull_i (x_{i+1} - x_i - step_i)^2 (clip_smooth.c). pull and step may both be NULL; value and out
 * are count x dims with one row a frame, the others count. Two weights at least must not be 0, or one where
 * count is 1. */
typedef struct {
    int count, dims;
    double stiffness;
    const double *weight, *value, *pull, *step;
} path_problem;
sherf_status path_solve(context *c, const path_problem *p, double *out);
/* The stiffness that halves a swing of `cut_hz`. */
double path_stiffness(double fps, double cut_hz);

/* From fits to a motion (clip_smooth.c). first and last: the first and last frame fitted. known: the shape
 * and the camera. */
sherf_status clip_settle(context *c, const body_model *body, const clip_track *t, int first, int last,
                         const body_fit_result *known, double smooth, sherf_motion **out);
#endif
