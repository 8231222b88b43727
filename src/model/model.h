/* model: what a model is, and the operations that trainer, loader, evaluator, avatars, frames and exports
 * need. The data flow: geometry (no tape: body, camera) -> encode (feature bank) -> query (raw density and
 * colour of points) -> compositing. The same functions run inference, training (a recording tape) and
 * evaluation. A model is an entry of the table (table.c); code outside its folder knows only this. */
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
/* All sizes of a network; stored in the weights' metadata. */
typedef struct {
    const model_kind *kind;
    char preset[32];
    int samples;    /* per ray */
    int image_size; /* width of the pictures it was trained on; 0: unknown */
    int px_per_m;   /* scale of people in these pictures, at their distance; 0: unknown */
    /* Points move with their nearest vertex's map, as in the paper (0), or with a blend of it and its
     * neighbours' within this many millimetres (body.h, blend_m), which avoids jagged silhouettes. */
    int skin_blend_mm;
    /* Where hidden points read the observed picture: straight through the body, whatever limb is in front (0,
     * as in the paper), beside the limb that covers them (1), or also at the mirrored place (2); see scene.h,
     * body_read_pictures. */
    int occlusion;
    union { /* the model's own settings, a struct of int and float */
        double alignment;
        unsigned char bytes[MODEL_SETTINGS_ROOM];
    } own;
} model_config;
/* offset: into model_config. multiple: the setting is an int from low to high in steps of `multiple`; 0: it
 * is a float. */
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
/* One line "PRESET,name=value,...", which model_config_parse_as reads back. Free with mem_free. */
char *model_config_text(context *c, const model_config *config);
sherf_status model_config_check(context *c, const model_config *config);
/* A file's metadata hold the model's name under "model" and its settings under model_metadata_key, or under
 * `key` if that is not NULL. Files without a name belong to the table's first model. infer: derives the
 * settings from the tensors where the file has none. */
void model_metadata_key(const model_kind *kind, char key[MODEL_KEY]);
sherf_status model_config_of_file(context *c, const safetensors *s, const char *key, bool infer,
                                  model_config *out);

/* ---- geometry of body and camera, once per observation ---- */
typedef struct {
    const model_kind *kind;
    int width, height, vertices;
    float *image;     /* H x W x 3, black outside the mask; owned */
    posed_body *body; /* observation pose */
    sherf_camera camera;
    void *own; /* the model's own geometry, from its observe */
} observation_geometry;
/* training: also makes the parts that only training needs. */
sherf_status observation_geometry_create(context *c, const model_config *config, const body_model *body,
                                         const sherf_image *image_rgb, const sherf_camera *camera,
                                         const sherf_pose *pose, bool training, observation_geometry **out);
void observation_geometry_free(observation_geometry *g);

/* ---- several pictures (sheet.c) ---- */
enum { OBSERVED_PICTURES_MAX = SHERF_PICTURES_MAX };
/* One picture of the person, in its own pose. image: H x W x 3, black outside the person; not owned. */
typedef struct {
    sherf_image image;
    sherf_camera camera;
    sherf_pose pose;
} observed_picture;
/* What models read from an observation. One picture: itself, its camera, its body. Several pictures: they lie
 * side by side in one sheet, before one camera, with the first one's body, each vertex of which is read in
 * the picture that shows it best. So later stages need not know of several pictures. Owned. */
typedef struct {
    int width, height;
    float *image; /* H x W x 3 */
    sherf_camera camera;
    posed_body *body;
} observed_sheet;
/* SHERF_UNSUPPORTED, with a message, where the model cannot read several. */
sherf_status observed_sheet_create(context *c, const model_config *config, const body_model *body, int count,
                                   const observed_picture *picture, observed_sheet *out);
void observed_sheet_free(observed_sheet *s);
sherf_status observation_geometry_of(context *c, const model_config *config, const body_model *body,
                                     int count, const observed_picture *picture, bool training,
                                     observation_geometry **out);

/* ---- and once per target ---- */
/* Draws some of a target's rays, for trainings that do not render whole pictures. */
typedef struct {
    int count;           /* distinct rays at the box to draw; 0: all */
    float inside;        /* this share of them where the mask is not 0, if there are enough */
    const uint8_t *mask; /* H x W */
    bool jitter;         /* moves all depths of a ray by the same amount, up to half a step */
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
/* Treats rays that are not drawn as if they missed the box. */
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
    int count; /* tensors that queries read and give gradients for */
    tensor *tensor[MODEL_BANK];
    void *own;      /* the model's own data, on the tape; or NULL */
    tensor *coarse; /* [N, 5] of the last frame's first pass, which also enters the loss; or NULL */
} model_bank;

/* Arrays of a bank in the host's memory, as an avatar and its file store them. */
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
/* An array from a file; its sizes must be those in out->dim. */
sherf_status kept_array_read(context *c, const safetensors *s, kept_array *out);

/* All kept arrays of a model's bank, from the bank or from a file. Free with kept_free, even after an
 * error. */
sherf_status kept_make(context *c, const model *m, const observation_geometry *g, const model_bank *bank,
                       kept_bank *out);
sherf_status kept_read(context *c, const safetensors *s, const model_config *config, kept_bank *out);

/* ---- surfaces, for models that are trained on them ---- */
/* Points, half of them inside a person, and places on the visible surface, in the observed world; drawn anew
 * for every sample (train/surfaces.h). Owned. */
typedef struct {
    int64_t points, places;
    float *point, *inside; /* P x 3; P: 1 or 0 */
    float *place, *color;  /* N x 3; N x 3, 0 to 1 */
} surface_draw;
/* Used instead of frames and their losses. */
typedef struct {
    int64_t (*count)(const model_config *config); /* of points, and of places */
    /* The losses: whether points are inside, and the places' colours. */
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

/* How a model's authors train it, where that differs from SHERF's way (train/); used on request. */
typedef struct {
    float mask_weight; /* the loss is mean squared colour, of both passes, plus this times the mean square of
                          (opacity - mask) */
    int rays; /* rays of an observed person, drawn anew for each sample and shared among its targets */
    float rays_inside; /* share of the rays in the mask */
    bool jitter;       /* as ray_draw's */
    int batch;         /* samples per step */
    double learning_rate, beta1, beta2;
    double halve_every; /* steps; 0: never */
} training_recipe;

struct model_kind {
    const char *name; /* in files and before presets: letters, digits, - */
    /* settings */
    const model_preset *presets;   /* ends with one without a name; the first is the default */
    const model_setting *settings; /* up to one without a name */
    void (*defaults)(model_config *out);
    /* checks what ranges cannot express; or NULL */
    sherf_status (*check)(context *c, const model_config *config);
    /* Derives the settings of weights without metadata from their tensors; or NULL. */
    sherf_status (*infer)(context *c, const safetensors *s, model_config *out);
    /* parameters: declares them into layers, which lie in m->network: network_bytes, zeroed */
    size_t network_bytes;
    void (*declare)(declaration *d, const model_config *config, void *network);
    /* prefixes of names, ended by NULL */
    const char *const *queried; /* of the parameters that `query` reads and avatars keep; NULL: all */
    /* of the encoders that can start from a converted ResNet; NULL: there are none */
    const char *const *resnets;
    /* makes the observation's geometry, g->own, which observed_free frees; both NULL: there is none */
    sherf_status (*observe)(context *c, const model_config *config, const body_model *body, bool training,
                            observation_geometry *g);
    void (*observed_free)(void *own);
    /* encodes the observation into its bank */
    sherf_status (*encode)(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                           model_bank *bank);
    /* Raw density [P, 1] and colour [P, 3] of the points [begin, end) of the set, op by op. NULL for a model
     * with a surface instead of a density: it is trained with `surfaces`, has one_pose, and its own field. */
    sherf_status (*query)(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          const model_bank *bank, const point_set *points, int64_t begin, int64_t end,
                          tensor **sigma, tensor **rgb);
    const model_fused_training *fused_training; /* or NULL */
    const model_surface_training *surfaces;     /* or NULL */
    /* The field lives in the observed moment's world: no other pose, no canonical space to find empty space
     * in or to export. */
    bool one_pose;
    /* Points read the picture at point_set.observed_px, so that `occlusion` can move the place. */
    bool reads_observed_px;
    /* Whether, in the observed pose, all samples in the box are points; or NULL. */
    bool (*whole_box)(const model_config *config);
    /* Makes the frame for model_frame where that is more than one pass over target->points (model_pass); or
     * NULL. */
    sherf_status (*frame)(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          model_bank *bank, const target_geometry *target, float background,
                          uint64_t noise_key, tensor **frame);
    const training_recipe *(*recipe)(const model_config *config); /* NULL, or it returns NULL: SHERF's way */
    /* Names and shapes of the arrays that an avatar keeps, without data. Where keep is NULL they are the
     * bank's tensors in their order. */
    void (*kept)(const model_config *config, kept_bank *out);
    sherf_status (*keep)(context *c, const model *m, const observation_geometry *g, const model_bank *bank,
                         kept_bank *out);
    /* Makes the bank from those arrays, which are passed as tensors in the same order too; NULL: the arrays
     * are the bank. May adapt the geometry to them. */
    sherf_status (*restore)(tape *t, const model *m, observation_geometry *g, const kept_bank *arrays,
                            const model_bank *tensors, model_bank *bank);
    /* A faster `query` for frames (field.h). If this is NULL, or returns NULL, frames are made op by op. */
    const struct field_kind *(*field)(const model_config *config);
    /* Multiply-adds per point in such a frame, for `sherf bench`; or NULL. */
    double (*point_products)(const model_config *config);
};

/* name NULL: the table's first. */
sherf_status model_kind_find(context *c, const char *name, size_t length, const model_kind **out);
void model_kind_add(const model_kind *kind); /* for tests: adds a kind to the table; NULL: removes it */

/* ---- a model ---- */
struct sherf_model {
    model_config config;
    parameters *weights;
    void *network; /* the kind's layers, whose tensors are the weights' */
};

sherf_status model_create(context *c, const model_config *config, uint64_t seed, model **out);
/* The same with undefined weights, for callers that set all of them. */
sherf_status model_shape(context *c, const model_config *config, model **out);
void model_free(model *m);
/* Moves the weights to the context's device; does nothing for the CPU. Call it before there are gradients. */
sherf_status model_place(context *c, model *m);
bool model_is_queried(const model_kind *kind, const char *name);
/* A parameter by name; NULL: there is none. For tests. */
tensor *model_tensor(const model *m, const char *format, ...) PRINTF_LIKE(2, 3);

/* NULL: trained as SHERF is. */
const training_recipe *model_recipe(const model_config *config);
/* SHERF_UNSUPPORTED, with a message, where the model has no canonical space. */
sherf_status model_needs_canonical(context *c, const model_config *config);
bool model_has_whole_box(const model_config *config);

sherf_status model_encode(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          model_bank *bank);
/* A tape for work of which only the result is needed: a scratch tape, or `t` itself where it records. keep:
 * moves such a result to `t`; everything else on `work` is dropped. */
tape *tape_for_parts(tape *t);
tensor *tape_keep(tape *t, tape *work, tensor *x);

/* Raw density sigma [P, 1] and colour rgb [P, 3] of all points, in chunks of which the tape keeps nothing. */
sherf_status model_query(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                         const model_bank *bank, const point_set *points, tensor *sigma, tensor *rgb);
/* One pass: queries the points on the tape and composites them, at their own depths where they have some.
 * *sigma (or NULL): [P, 1] without noise; *frame: [N, 5]. The set must live as long as the tape. */
sherf_status model_pass(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                        model_bank *bank, const target_geometry *target, const point_set *points,
                        float background, uint64_t noise_key, tensor **sigma, tensor **frame);
/* The whole frame on the tape: [N, 5] colour, opacity, depth. The points are queried in chunks whose
 * intermediate values are not kept but computed again in the backward pass. noise_key != 0: standard normal
 * noise is added to the raw density (training). */
sherf_status model_frame(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                         model_bank *bank, const target_geometry *target, float background,
                         uint64_t noise_key, tensor **frame);

/* ---- files ---- */
sherf_status model_load(context *c, const char *path, model **out); /* ours, or converted from the authors' */
sherf_status model_save(context *c, const model *m, const char *path);
/* Saves other values instead of the weights' own (moving averages): total_floats of them. */
sherf_status model_save_values(context *c, const model *m, const float *values, const char *path);
/* All tensors as a file holds them, for checkpoints; mem_free both results. */
sherf_status model_items(context *c, const model *m, const float *values, safetensor_item **out,
                         float **memory);
/* Copies a converted ResNet's values into the model's encoders of the same width. */
sherf_status model_load_resnet(context *c, model *m, const char *path);

#endif
