/* avatar: an observation encoded once, with the weights that queries read, and the frames made from it. A
 * file calls only files listed above it here. */
#ifndef SHERF_AVATAR_H
#define SHERF_AVATAR_H

#include <pthread.h>

#include "model/field.h"
#include "sampling/coarse.h"

/* The unscaled picture of an image, with more pixels, H x W x 3; data NULL: there is none. Owned. */
typedef struct {
    int width, height;
    uint8_t *data;
} fine_picture;
/* How an avatar that is not drawn by its network (baked/) is rendered, saved and freed. */
typedef struct {
    const char *name;
    sherf_status (*render)(context *c, const sherf_avatar *a, const body_model *body, const sherf_pose *pose,
                           const sherf_camera *camera, const sherf_render_options *options,
                           sherf_frame *frame);
    sherf_status (*save)(context *c, const sherf_avatar *a, const char *path);
    void (*release)(void *form);
} avatar_form;
struct sherf_avatar {
    /* NULL: drawn by the network. Otherwise the avatar holds only what `form` needs, the body's fingerprint,
     * and the first picture's pose and camera */
    const avatar_form *form;
    void *formed;
    model_config config;
    uint64_t body_fingerprint;
    parameters *weights;                             /* the weights that queries read, in the host's memory */
    kept_bank kept;                                  /* the part of its bank that is kept */
    int pictures;                                    /* pictures of the observation, at least 1 */
    observed_picture picture[OBSERVED_PICTURES_MAX]; /* as they were encoded; images are owned */
    fine_picture fine[OBSERVED_PICTURES_MAX];
    /* the body in the pose of each picture; with one picture it is the sheet's body */
    posed_body *posed[OBSERVED_PICTURES_MAX];
    observed_sheet sheet; /* where features are read */
    const field_kind *field_kind;
    void *field; /* answers queries, in the context that the avatar was made or loaded in */
    /* Made when a frame first needs them, under locks of their own: any thread may use an avatar. */
    struct lazy_occupancy *occupancy;
    struct lazy_detail *detail;
    char *path;       /* the file it was loaded from, which errors name; NULL: it was made here */
    uint64_t variant; /* which guess of the unseen parts is shown (detail.h); 0: the best one */
};

/* ---- avatar.c ---- */
/* sherf_avatar_create_several; batch_statistics: as in tape_options. */
sherf_status avatar_create(context *c, const model *m, const body_model *body, int count,
                           const sherf_observation *const *observation, bool batch_statistics,
                           sherf_avatar **out);

/* ---- refusal.c ---- */
/* Puts the name of the avatar's file, if it has one, before the context's message. Returns `status`. */
sherf_status avatar_named(context *c, const sherf_avatar *a, sherf_status status);
/* SHERF_MISMATCH, with a message, where the avatar was made with another body. */
sherf_status avatar_check_body(context *c, const sherf_avatar *a, const body_model *body);
/* SHERF_UNSUPPORTED, with a message, where `what` ("an export needs") needs the network and this avatar has
 * another form. */
sherf_status avatar_needs_network(context *c, const sherf_avatar *a, const char *what);

/* ---- device.c: the field that answers queries, on the processor or on a GPU ---- */
/* Makes the field for this context from the avatar's other members. */
sherf_status avatar_place(context *c, const body_model *body, sherf_avatar *a);
/* rgb [P, 3] and raw density [P] of points made for the avatar's body (points_create, canonical.h). */
sherf_status avatar_query(context *c, const sherf_avatar *a, const body_model *body, const point_set *points,
                          float *rgb, float *sigma);
/* Renders a frame from the caller's rays and points, as tiles_render does. */
sherf_status avatar_composite(context *c, const sherf_avatar *a, const body_model *body,
                              const ray_bundle *rays, const point_set *points, const float background[3],
                              bool early_stop, sherf_frame *frame);
/* Whether a GPU makes whole frames from a pose's joints (posed_joints_create). */
bool avatar_takes_joints(const sherf_avatar *a);
/* The body posed and ready for points_create, or its joints where the avatar is on a GPU; freed with
 * posed_body_free. */
sherf_status avatar_pose(context *c, const sherf_avatar *a, const body_model *body, const sherf_pose *pose,
                         posed_body **out);

/* ---- occupancy.c ---- */
/* Finds cells of canonical space (1 cm) where the avatar's density is 0, judged by its values in the middles
 * of the cell and of its 6 neighbours. `out` has no bits when these cells are fewer than a tenth of those
 * within 6 cm of the body. Free with occupancy_free. */
sherf_status occupancy_find(context *c, const sherf_avatar *a, const body_model *body, occupancy_grid *out);
void occupancy_free(occupancy_grid *e);
/* The same, with cells inside the body too. `f` gets the avatar's density and colour in the middles of all
 * cells within 6 cm of the body; cells further away have density 0. `f` has no values for a body of an
 * impossible size. Free both. */
sherf_status coarse_field_find(context *c, const sherf_avatar *a, const body_model *body, occupancy_grid *e,
                               coarse_field *f);
void coarse_field_free(coarse_field *f);
typedef struct lazy_occupancy {
    pthread_mutex_t lock;
    bool looked;
    occupancy_grid cells;
    coarse_field coarse; /* for frames in float32 */
} lazy_occupancy;
lazy_occupancy *lazy_occupancy_create(context *c);
void lazy_occupancy_free(lazy_occupancy *l); /* NULL is fine */
/* The avatar's grid and coarse field, computed by the first call. *cells NULL: no space can be skipped;
 * *coarse NULL: frames do without a coarse field. */
sherf_status avatar_occupancy(context *c, const sherf_avatar *a, const body_model *body,
                              const occupancy_grid **cells, const coarse_field **coarse);

/* ---- frame.c ---- */
/* A frame from the network, without detail. */
sherf_status avatar_frame(context *c, const sherf_avatar *a, const body_model *body, const posed_body *posed,
                          const sherf_camera *camera, const sherf_render_options *options,
                          sherf_frame *frame);

/* ---- detail.c, see detail.h ---- */

/* ---- avatar.c: made of an observation ---- */
sherf_avatar *avatar_new(context *c); /* empty, NULL: out of memory; free it with sherf_avatar_free */
/* Copies the weights that a model's queries read; parameters_free them, even after an error. */
sherf_status avatar_weights(context *c, const model *m, parameters **out);
/* Sets what an observation or a file determines (the sheet, the bodies) and calls avatar_place. */
sherf_status avatar_finish(context *c, const body_model *body, sherf_avatar *a);

/* ---- avatar_file.c, render.c ---- */
/* Writes a picture's pose and camera, without its size, as one row of a file, and reads them back.
 * SHERF_BAD_FILE, with the tensor's name: a number is not finite or the camera is invalid. */
enum { OBSERVED_NUMBERS = 72 + 10 + 9 + 3 + 9 + 9 + 3 };
void observed_numbers(const observed_picture *p, float n[OBSERVED_NUMBERS]);
sherf_status observed_from_numbers(context *c, const char *name, const float n[OBSERVED_NUMBERS], int width,
                                   int height, observed_picture *out);
/* Makes an avatar of a file that safetensors_read read. sherf_avatar_load (baked/form_read.c) is the public
 * function. */
sherf_status avatar_read(context *c, const safetensors *s, const body_model *body, sherf_avatar **out);
/* As sherf_render, with a body posed by avatar_pose: for many frames of one pose. */
sherf_status avatar_render(context *c, const sherf_avatar *a, const body_model *body, const posed_body *posed,
                           const sherf_camera *camera, const sherf_render_options *options,
                           sherf_frame *frame);
/* Adds detail to a frame over `background` that was rendered without it, as SHERF_DETAIL_ON does. For callers
 * that render in parts. */
sherf_status avatar_give_detail(context *c, const sherf_avatar *a, const body_model *body,
                                const posed_body *posed, const sherf_camera *camera,
                                const float background[3], sherf_frame *frame);

#endif
