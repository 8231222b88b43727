/* model: what a model is, and what trainer, loader, evaluator, avatars, frames and exports do with one. The
 * way of the data: geometry (no tape: body, camera) -> encode (feature bank) -> query (raw density and colour
 * of points) -> compositing. The same functions run inference, training (a recording tape) and evaluation. A
 * model is an entry of the table (table.c); nothing outside its folder knows more of it than this. */
#ifndef SHERF_MODEL_H
#define SHERF_MODEL_H

#include "body/body.h"
#include "io/safetensors.h"
#include "nn/layers.h"
#include "sampling/sampling.h"
#include "tensor/tensor.h"

typedef struct model_kind model_kind;
typedef struct sherf_model model;

/* ---- settings ---- */
enum { MODEL_SETTINGS_ROOM = 256, MODEL_KEY = 64 };
/* Every size of a network; kept in the weights' metadata. */
typedef struct {
    const model_kind *kind;
    char preset[32];
    int samples;    /* per ray */
    int image_size; /* width of the pictures it was trained on; 0: unknown */
    int px_per_m;   /* how large people were in them, at their distance; 0: unknown */
    /* Points move with their nearest vertex's map, the paper's way (0), or with a blend of it and its
     * neighbours' within so many millimetres (body.h, blend_m), which leaves no teeth at silhouettes. */
    int skin_blend_mm;
    /* What the observed picture does not show is read straight through the body, whatever limb is there (0,
     * the paper's way), or beside the limb that covers it (1), or at its mirror image too (2): scene.h,
     * body_read_pictures. */
    int occlusion;
    union { /* the model's own, a struct of int and float */
        double alignment;
        unsigned char bytes[MODEL_SETTINGS_ROOM];
    } own;
} model_config;
/* offset: into model_config. multiple: an int, from low to high in steps of so many; 0: a float. */
typedef struct {
    const char *name;
    size_t offset;
    double low, high;
    int multiple;
} model_setting;
#define MODEL_SETTING_AT(settings_struct, field)                                                             \
    (offsetof(model_config, own) + offsetof(settings_struct, field))
/* Settings that are not the defaults, as "name=value,...". */
typedef struct {
    const char *name, *settings;
} model_preset;

/* "[MODEL:]PRESET[,name=value...]", as "small,plane_resolution=64"; without MODEL the table's first. */
sherf_status model_config_parse(context *c, const char *text, model_config *out);
sherf_status model_config_parse_as(context *c, const model_kind *kind, const char *text, model_config *out);
/* One line "PRESET,name=value,...": what model_config_parse_as reads back. Free with mem_free. */
char *model_config_text(context *c, const model_config *config);
sherf_status model_config_check(context *c, const model_config *config);
/* A file's metadata have its model's name under "model" and its settings under model_metadata_key, or under
 * `key` where that is not NULL. Files without a name are the first model's. infer: from the tensors, where
 * the file has no settings. */
void model_metadata_key(const model_kind *kind, char key[MODEL_KEY]);
sherf_status model_config_of_file(context *c, const safetensors *s, const char *key, bool infer,
                                  model_config *out);

/* ---- what the body and the camera decide, once per observation ---- */
typedef struct {
    const model_kind *kind;
    int width, height, vertices;
    float *image;     /* H x W x 3, black outside the mask; owned */
    posed_body *body; /* observation pose */
    sherf_camera camera;
    void *own; /* the model's, from its observe */
} observation_geometry;
/* training: also what only training needs. */
sherf_status observation_geometry_create(context *c, const model_config *config, const body_model *body,
                                         const sherf_image *image_rgb, const sherf_camera *camera,
                                         const sherf_pose *pose, bool training, observation_geometry **out);
void observation_geometry_free(observation_geometry *g);

/* ---- of several pictures (sheet.c) ---- */
enum { OBSERVED_PICTURES_MAX = SHERF_PICTURES_MAX };
/* The person in a pose of its own. image: H x W x 3, black outside the person; not owned. */
typedef struct {
    sherf_image image;
    sherf_camera camera;
    sherf_pose pose;
} observed_picture;
/* What models read of an observation. One picture: itself, its camera, its body. Several: side by side in one
 * picture, before one camera; the first one's body, of which each vertex is read in the picture that shows it
 * best. So nobody behind this needs to know of several. Owned. */
typedef struct {
    int width, height;
    float *image; /* H x W x 3 */
    sherf_camera camera;
    posed_body *body;
} observed_sheet;
/* SHERF_UNSUPPORTED, in one line, where the model cannot read several. */
sherf_status observed_sheet_create(context *c, const model_config *config, const body_model *body, int count,
                                   const observed_picture *picture, observed_sheet *out);
void observed_sheet_free(observed_sheet *s);
sherf_status observation_geometry_of(context *c, const model_config *config, const body_model *body,
                                     int count, const observed_picture *picture, bool training,
                                     observation_geometry **out);

/* ---- and once per target ---- */
/* Some of a target's rays, for trainings of the kind. */
typedef struct {
    int count;           /* of the rays at the box, distinct; 0: all */
    float inside;        /* this part of them from where mask is not 0, as far as there are */
    const uint8_t *mask; /* H x W */
    bool jitter;         /* the depths of each ray are moved by up to half a step, all alike */
    uint64_t key;
} ray_draw;
typedef struct {
    posed_body *body;
    ray_bundle *rays;
    point_set *points;
    float depth_min, depth_max; /* range of all depths of the frame */
} target_geometry;
sherf_status target_geometry_create(context *c, const model_config *config, const body_model *body,
                                    const sherf_camera *camera, const sherf_pose *pose,
                                    const observation_geometry *observation, bool keep_stages,
                                    target_geometry **out);
/* As if no other rays met the box than those that are drawn. */
sherf_status target_geometry_draw(context *c, const model_config *config, const body_model *body,
                                  const sherf_camera *camera, const sherf_pose *pose,
                                  const observation_geometry *observation, const ray_draw *draw,
                                  target_geometry **out);
/* The points of a frame, by the model's kind: points_create, or points_of_box. */
sherf_status model_points_create(context *c, const model_config *config, const body_model *body,
                                 const posed_body *target, const ray_bundle *rays, int samples,
                                 const posed_body *observation, const sherf_camera *observation_camera,
                                 const occupancy_grid *empty, bool keep_stages, point_set **out);
void target_geometry_free(target_geometry *g);

/* ---- the feature bank, as tensors on a tape ---- */
enum { MODEL_BANK = 16 };
typedef struct {
    int count; /* of the tensors that queries read, whose gradients they give */
    tensor *tensor[MODEL_BANK];
    void *own; /* the model's, on the tape; or NULL */
    tensor *
        coarse; /* [N, 5] of the last frame's first pass, which is compared with the truth as well; or NULL */
} model_bank;

/* Arrays of a bank in the host's memory, as an avatar and its file keep them. */
typedef struct {
    const char *name; /* in the file */
    dtype type;       /* T_F32 or T_I32 */
    int rank;
    int64_t dim[4]; /* 0 in model_kind.kept: any size */
    void *data;     /* owned */
} kept_array;
typedef struct {
    int count;
    kept_array array[MODEL_BANK];
} kept_bank;
void kept_free(kept_bank *k);
/* An array from a float32 tensor, wherever it lies. */
sherf_status kept_take(context *c, const tensor *x, kept_array *out);
/* An array of a file, whose sizes must be those that out->dim gives. */
sherf_status kept_array_read(context *c, const safetensors *s, kept_array *out);

/* All of a model's bank, and from a file; free with kept_free, whatever the answer. */
sherf_status kept_make(context *c, const model *m, const observation_geometry *g, const model_bank *bank,
                       kept_bank *out);
sherf_status kept_read(context *c, const safetensors *s, const model_config *config, kept_bank *out);

/* ---- surfaces, for models that learn from them ---- */
/* Points of which half are inside a person, and places on what is seen of it, in the observed world; drawn
 * anew for every sample (train/surfaces.h). Owned. */
typedef struct {
    int64_t points, places;
    float *point, *inside; /* P x 3; P: 1 or 0 */
    float *place, *color;  /* N x 3; N x 3, 0 to 1 */
} surface_draw;
/* In the place of frames and their losses. */
typedef struct {
    int64_t (*count)(const model_config *config); /* of points, and of places */
    /* What is to become small: whether points are inside, and the places' colours. */
    sherf_status (*losses)(tape *t, const model *m, const observation_geometry *g, const model_bank *bank,
                           const surface_draw *truth, tensor **inside, tensor **color);
} model_surface_training;

/* ---- the table ---- */
/* The same network as `query`, a tile of points at a time, for training. */
typedef struct {
    bool (*possible)(tape *t, const model *m);
    /* All points at once, recorded; sigma [P, 1] and rgb [P, 3] are filled. */
    sherf_status (*run)(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                        model_bank *bank, const point_set *points, tensor *sigma, tensor *rgb);
} model_fused_training;

/* How a model's authors train it, if not in SHERF's way (train/), for those who want their recipe. */
typedef struct {
    float mask_weight; /* the loss is mean squared colour, of both passes, plus this times the mean square of
                          (opacity - mask) */
    int rays;          /* of an observed person, drawn anew for each sample and shared among its targets */
    float rays_inside; /* this part of them from the mask */
    bool jitter;       /* as ray_draw's */
    int batch;         /* samples a step */
    double learning_rate, beta1, beta2;
    double halve_every; /* steps; 0: never */
} training_recipe;

struct model_kind {
    const char *name; /* in files and before presets: letters, digits, - */
    /* settings */
    const model_preset *presets;   /* up to one without a name; the first is the default */
    const model_setting *settings; /* up to one without a name */
    void (*defaults)(model_config *out);
    sherf_status (*check)(context *c, const model_config *config); /* what ranges do not say; or NULL */
    /* The settings of weights without metadata, from their tensors; or NULL. */
    sherf_status (*infer)(context *c, const safetensors *s, model_config *out);
    /* parameters: declares them into layers, which lie in m->network: network_bytes, zeroed */
    size_t network_bytes;
    void (*declare)(declaration *d, const model_config *config, void *network);
    /* how names begin, up to NULL */
    const char *const *queried; /* of what `query` reads, and avatars keep; NULL: all */
    const char *const *resnets; /* of the encoders that a converted ResNet starts; NULL: there are none */
    /* geometry of an observation into g->own, which observed_free frees; both NULL: there is none */
    sherf_status (*observe)(context *c, const model_config *config, const body_model *body, bool training,
                            observation_geometry *g);
    void (*observed_free)(void *own);
    /* the observation -> its bank */
    sherf_status (*encode)(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                           model_bank *bank);
    /* Raw density [P, 1] and colour [P, 3] of the points [begin, end) of the set, op by op. NULL for a model
     * that has a surface in the place of a density: it is trained with `surfaces`, is of one pose, and has a
     * field of its own. */
    sherf_status (*query)(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          const model_bank *bank, const point_set *points, int64_t begin, int64_t end,
                          tensor **sigma, tensor **rgb);
    const model_fused_training *fused_training; /* or NULL */
    const model_surface_training *surfaces;     /* or NULL */
    /* A field of the observed moment's world: no other pose, no canonical space to look for nothing in or to
     * export. */
    bool one_pose;
    /* What points read of the picture they read at point_set.observed_px, so that `occlusion` can move it. */
    bool reads_observed_px;
    /* Points of the observed pose are all samples of the box; or NULL. */
    bool (*whole_box)(const model_config *config);
    /* The frame of model_frame where that is not one pass over target->points (model_pass); or NULL. */
    sherf_status (*frame)(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          model_bank *bank, const target_geometry *target, float background,
                          uint64_t noise_key, tensor **frame);
    const training_recipe *(*recipe)(const model_config *config); /* NULL, or gives NULL: SHERF's way */
    /* Names and shapes of what an avatar keeps, without data. Where keep is NULL they are the bank's tensors
     * in their order. */
    void (*kept)(const model_config *config, kept_bank *out);
    sherf_status (*keep)(context *c, const model *m, const observation_geometry *g, const model_bank *bank,
                         kept_bank *out);
    /* The bank from those arrays, which are tensors in the same order too; NULL: they are it. The geometry
     * may be brought in line with them. */
    sherf_status (*restore)(tape *t, const model *m, observation_geometry *g, const kept_bank *arrays,
                            const model_bank *tensors, model_bank *bank);
    /* Does the same as `query`, faster, for frames (field.h). If this is NULL, or returns NULL, frames go op
     * by op. */
    const struct field_kind *(*field)(const model_config *config);
    /* Multiply-adds that a point takes in such a frame, for `sherf bench`; or NULL. */
    double (*point_products)(const model_config *config);
};

/* name NULL: the table's first. */
sherf_status model_kind_find(context *c, const char *name, size_t length, const model_kind **out);
void model_kind_add(const model_kind *kind); /* for tests: one more from now on; NULL: none */

/* ---- a model ---- */
struct sherf_model {
    model_config config;
    parameters *weights;
    void *network; /* the kind's layers, whose tensors are the weights' */
};

sherf_status model_create(context *c, const model_config *config, uint64_t seed, model **out);
/* The same with weights of any value, for those who give every one its own. */
sherf_status model_shape(context *c, const model_config *config, model **out);
void model_free(model *m);
/* Moves the weights to where the context's device computes; nothing for the CPU. Before there are gradients.
 */
sherf_status model_place(context *c, model *m);
bool model_is_queried(const model_kind *kind, const char *name);
/* By name; NULL where there is none. For tests. */
tensor *model_tensor(const model *m, const char *format, ...) PRINTF_LIKE(2, 3);

/* NULL: trained as SHERF is. */
const training_recipe *model_recipe(const model_config *config);
/* SHERF_UNSUPPORTED, in one line, where the model has no canonical space. */
sherf_status model_needs_canonical(context *c, const model_config *config);
bool model_has_whole_box(const model_config *config);

sherf_status model_encode(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          model_bank *bank);
/* A tape for work whose results alone are wanted: `t` where it records. keep: such a result, on `t`; what
 * else is on `work` is gone. */
tape *tape_for_parts(tape *t);
tensor *tape_keep(tape *t, tape *work, tensor *x);

/* Raw density and colour of all points, in chunks of which the tape keeps nothing: into sigma [P, 1] and rgb
 * [P, 3]. */
sherf_status model_query(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                         const model_bank *bank, const point_set *points, tensor *sigma, tensor *rgb);
/* One pass: the points on the tape and composited, at their own depths where they have some: *sigma (or NULL)
 * [P, 1] without noise, *frame [N, 5]. The set must live as long as the tape. */
sherf_status model_pass(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                        model_bank *bank, const target_geometry *target, const point_set *points,
                        float background, uint64_t noise_key, tensor **sigma, tensor **frame);
/* The whole frame on the tape: [N, 5] colour, opacity, depth. The points go through in chunks whose inside is
 * not kept but computed again in the backward pass. noise_key != 0: standard normal noise is added to the raw
 * density (training). */
sherf_status model_frame(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                         model_bank *bank, const target_geometry *target, float background,
                         uint64_t noise_key, tensor **frame);

/* ---- files ---- */
sherf_status model_load(context *c, const char *path, model **out); /* ours, or converted from the authors' */
sherf_status model_save(context *c, const model *m, const char *path);
/* With other values in the place of the weights' own (moving averages): total_floats of them. */
sherf_status model_save_values(context *c, const model *m, const float *values, const char *path);
/* All tensors as a file holds them; mem_free both results. For checkpoints. */
sherf_status model_items(context *c, const model *m, const float *values, safetensor_item **out,
                         float **memory);
/* A converted ResNet's values into the model's encoders of its width. */
sherf_status model_load_resnet(context *c, model *m, const char *path);

#endif
