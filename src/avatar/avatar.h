/* avatar: an observation encoded once, with the weights that queries read, and the frames made from it. A
 * file calls only those that stand above it here. */
#ifndef SHERF_AVATAR_H
#define SHERF_AVATAR_H

#include <pthread.h>

#include "model/field.h"
#include "sampling/coarse.h"

/* A picture with more pixels than its image, H x W x 3; data NULL: none. Owned. */
typedef struct {
    int width, height;
    uint8_t *data;
} fine_picture;
/* An avatar that is not drawn by its network (baked/): how it is rendered, saved and freed. */
typedef struct {
    const char *name;
    sherf_status (*render)(context *c, const sherf_avatar *a, const body_model *body, const sherf_pose *pose,
                           const sherf_camera *camera, const sherf_render_options *options,
                           sherf_frame *frame);
    sherf_status (*save)(context *c, const sherf_avatar *a, const char *path);
    void (*release)(void *form);
} avatar_form;
struct sherf_avatar {
    const avatar_form *form; /* NULL: the network's. Otherwise only what `form` says, the body's fingerprint,
                                and pose and camera of the first picture are there */
    void *formed;
    model_config config;
    uint64_t body_fingerprint;
    parameters *weights;                             /* what queries read, in the host's memory */
    kept_bank kept;                                  /* of its bank */
    int pictures;                                    /* of the observation, at least 1 */
    observed_picture picture[OBSERVED_PICTURES_MAX]; /* as they were encoded; images are owned */
    fine_picture fine[OBSERVED_PICTURES_MAX];
    posed_body
        *posed[OBSERVED_PICTURES_MAX]; /* in the pose of each picture; with one it is the sheet's body */
    observed_sheet sheet;              /* where features are read */
    const field_kind *field_kind;
    void *field; /* answers its points, for the context that it was made or loaded in */
    /* Made when a frame first needs them, under locks of their own: any thread may use an avatar. */
    struct lazy_occupancy *occupancy;
    struct lazy_detail *detail;
    uint64_t variant; /* what was not seen, of several guesses (detail.h); 0: the best one */
};

/* ---- avatar.c ---- */
/* sherf_avatar_create_several; batch_statistics: as in tape_options. */
sherf_status avatar_create(context *c, const model *m, const body_model *body, int count,
                           const sherf_observation *const *observation, bool batch_statistics,
                           sherf_avatar **out);

/* ---- device.c: what answers its points, on the processor or on a GPU ---- */
/* The field for this context, from all the rest. */
sherf_status avatar_place(context *c, const body_model *body, sherf_avatar *a);
/* rgb [P, 3] and raw density [P] of points that the avatar's body has (points_create, canonical.h). */
sherf_status avatar_query(context *c, const sherf_avatar *a, const body_model *body, const point_set *points,
                          float *rgb, float *sigma);
/* A frame of rays and points of the caller's, as tiles_render. */
sherf_status avatar_composite(context *c, const sherf_avatar *a, const body_model *body,
                              const ray_bundle *rays, const point_set *points, const float background[3],
                              bool early_stop, sherf_frame *frame);
/* Whether frames are made whole from a pose's joints, on a GPU (posed_joints_create). */
bool avatar_takes_joints(const sherf_avatar *a);
/* The body posed and ready for points_create, or its joints where the avatar is on a GPU; freed with
 * posed_body_free. */
sherf_status avatar_pose(context *c, const sherf_avatar *a, const body_model *body, const sherf_pose *pose,
                         posed_body **out);

/* ---- occupancy.c ---- */
/* Cells of canonical space (1 cm) where the avatar's density is 0, as far as its values in their middles and
 * in those of their 6 neighbours tell. `out` has no bits when they are fewer than a tenth of what is within
 * 6 cm of the body. Free with occupancy_free. */
sherf_status occupancy_find(context *c, const sherf_avatar *a, const body_model *body, occupancy_grid *out);
void occupancy_free(occupancy_grid *e);
/* The same, with cells in the body too, and the avatar's answers in the middles of all within 6 cm of it;
 * what is further off has density 0. `f` has no values for a body of a size nobody has. Free both. */
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
/* The avatar's, found now where nobody has looked yet. *cells NULL: there is nothing to leave out; *coarse
 * NULL: frames do without. */
sherf_status avatar_occupancy(context *c, const sherf_avatar *a, const body_model *body,
                              const occupancy_grid **cells, const coarse_field **coarse);

/* ---- frame.c ---- */
/* A frame as the network has it, without detail. */
sherf_status avatar_frame(context *c, const sherf_avatar *a, const body_model *body, const posed_body *posed,
                          const sherf_camera *camera, const sherf_render_options *options,
                          sherf_frame *frame);

/* ---- detail.c, see detail.h ---- */

/* ---- avatar.c: made of an observation ---- */
sherf_avatar *avatar_new(context *c); /* empty, NULL on lack; freed with sherf_avatar_free */
/* The weights of a model that its queries read; parameters_free, whatever the answer. */
sherf_status avatar_weights(context *c, const model *m, parameters **out);
/* Sets what follows from a file or an observation: the sheet, the bodies, and avatar_place. */
sherf_status avatar_finish(context *c, const body_model *body, sherf_avatar *a);

/* ---- avatar_file.c, render.c ---- */
/* A picture's pose and camera, without its size, as one row of a file, and back: SHERF_BAD_FILE, with the
 * tensor's name, where one is not finite or the camera is none. */
enum { OBSERVED_NUMBERS = 72 + 10 + 9 + 3 + 9 + 9 + 3 };
void observed_numbers(const observed_picture *p, float n[OBSERVED_NUMBERS]);
sherf_status observed_from_numbers(context *c, const char *name, const float n[OBSERVED_NUMBERS], int width,
                                   int height, observed_picture *out);
/* Of a file that safetensors_read read; sherf_avatar_load (baked/form_read.c) is for people. */
sherf_status avatar_read(context *c, const safetensors *s, const body_model *body, sherf_avatar **out);
/* SHERF_UNSUPPORTED, in one line, where `what` needs the network and this avatar has another form. */
sherf_status avatar_needs_network(context *c, const sherf_avatar *a, const char *what);
/* sherf_render of a body that avatar_pose posed, for many frames of one pose. */
sherf_status avatar_render(context *c, const sherf_avatar *a, const body_model *body, const posed_body *posed,
                           const sherf_camera *camera, const sherf_render_options *options,
                           sherf_frame *frame);
/* What SHERF_DETAIL_ON does to a frame over `background` that was rendered without, for those who render in
 * parts. */
sherf_status avatar_give_detail(context *c, const sherf_avatar *a, const body_model *body,
                                const posed_body *posed, const sherf_camera *camera,
                                const float background[3], sherf_frame *frame);

#endif
