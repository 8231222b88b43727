/* Shared by the tests of the models beside SHERF: the parts of a second implementation in double, written
 * from their definitions as plainly as possible, and the use of such a model. */
#ifndef TEST_RIVAL_H
#define TEST_RIVAL_H

#include "support.h"

#include "model/model.h"

/* ---- one tube person, as observation and as target ---- */
/* A preset's trained weights. */
typedef struct {
    const char *preset;
    int64_t count;
} rival_count;
void rival_counts(int presets, const rival_count *known);

const char *rival_file(const char *name); /* a path in the data's folder; static storage, 4 at a time */
int rival_data(void **state); /* setup of a test group: two tube people of 32 x 32 pixels, 2 poses, 4 views */
typedef struct {
    sherf_body *body;
    sherf_observation *observation; /* pose 0, view 0 */
    sherf_camera camera;            /* the observation's camera */
    observation_geometry *geometry; /* for training */
    target_geometry *target;        /* view 1 of a pose: some rays, drawn from the mask and around it */
} rival_scene;
void rival_scene_open(context *c, const model_config *config, int pose, int rays, rival_scene *out);
void rival_scene_close(rival_scene *s);
void rival_observation(context *c, int pose, int view, sherf_body **body, sherf_observation **o);
void rival_box_middle(context *c, const rival_scene *s,
                      double middle[3]);                           /* of the observed body's vertices */
double rival_direction(const ray_bundle *r, int ray, double d[3]); /* returns its length */

/* ---- weights in double ---- */
typedef struct {
    int count;
    struct {
        char name[96];
        int64_t rows, floats; /* rows: the first dimension */
        double *v;
    } item[256];
} rival_weights;
void rival_shake(model *m); /* every weight gets noise, so that none is 0 or 1 */
void rival_weights_take(const model *m, rival_weights *out);
void rival_weights_free(rival_weights *w);
double *rival_weight(const rival_weights *w, const char *format, ...) PRINTF_LIKE(2, 3);

/* ---- layers; maps are [height, width, channels] ---- */
typedef struct {
    int height, width, channels;
    double *v; /* malloc'd */
} rival_map;
rival_map rival_image(const sherf_observation *o, double factor, double offset);
rival_map rival_map_new(int height, int width, int channels); /* zeroed */
rival_map rival_map_copy(rival_map x);
/* Batch norm of a single picture, in place. */
void rival_norm(const rival_weights *w, const char *name, rival_map x, bool relu);
/* Convolves with CONV.weight, which is square; does not free x. */
rival_map rival_convolved(const rival_weights *w, rival_map x, const char *conv, int stride, int pad);
/* Functions that take a map free it. */
rival_map rival_conv_norm(const rival_weights *w, rival_map x, const char *conv, const char *norm, int stride,
                          int pad, bool relu);
rival_map rival_max_pool(rival_map x); /* 3 x 3, stride 2, padding 1 */
rival_map rival_resnet_stage(const rival_weights *w, rival_map x, const char *prefix, int stage, int blocks);
/* Resizes all maps to the size of the first with aligned corners and concatenates them; frees all. */
rival_map rival_side_by_side(int count, rival_map *stage);
void rival_bilinear(rival_map map, double x, double y, double *out); /* zero outside */
void rival_linear(const rival_weights *w, const char *name, int in, const double *x, int out, double *y);
/* r, g, b, opacity over black; weight [count] of each sample; `way`: the interval in depth; `length`: of the
 * direction. */
void rival_composite(int count, const double *sigma, const double *rgb, const double *way, double length,
                     double *weight, double out[4]);
int rival_ascending(const void *a, const void *b);

/* Checks that frame [N, 5] equals `want` at each ray within `tolerance`, and is neither all opaque nor empty.
 * `mix` becomes its gradient. */
void rival_frame_agrees(tape *t, tensor *frame, int rays, const int *ray, double want[][4], double mix[][4],
                        double tolerance);
/* Moves `each` numbers of every trained tensor by `step` and checks that the central difference of f is the
 * model's gradient, within `tolerance` of the tensor's largest. */
void rival_gradients_agree(const model *m, rival_weights *w, int each, double tolerance,
                           double (*f)(void *self, const void *arg), void *self, const void *arg);

/* ---- use ---- */
/* Makes, renders, saves and loads an avatar and renders it the same; also a frame with detail. */
void rival_use(const char *preset);
/* Renders the same avatar in another pose, which must look different. */
void rival_moves(const char *preset);
/* The file of an avatar; static storage. */
const char *rival_avatar(context *c, const char *preset, sherf_body **body);
/* From settings to a frame, with memory running out at each allocation in turn. */
void rival_no_memory(const char *preset);
/* The loss of each step of a new training in that folder of the data's. */
void rival_losses(context *c, const char *preset, const char *folder, int steps, double *loss);
/* The mean loss of the last tenth of `steps` is below `factor` times that of the first tenth. */
void rival_trains(const char *preset, int steps, double factor);
/* Checks that six steps in two runs equal six steps in one. */
void rival_goes_on(const char *preset);
/* Scores a new model on two novel views and `novel_poses` pictures in novel poses. */
void rival_is_scored(const char *preset, int novel_poses);

#endif
