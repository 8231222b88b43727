/* model: SHERF by the paper's names. Encoders, tri-plane, volume, pixel-aligned features, fusion, decoder.
 * The way of the data: geometry (no tape: body, camera) -> model_encode (feature bank) -> model_points ->
 * compositing. The same functions run inference, training (a recording tape) and evaluation. */
#ifndef SHERF_MODEL_H
#define SHERF_MODEL_H

#include <pthread.h>

#include "body/body.h"
#include "io/safetensors.h"
#include "nn/parameters.h"
#include "model/sherf/fused/gpu.h"
#include "render/render.h"
#include "tensor/ops.h"

/* Every size of the network; kept in the weights' metadata. The paper's in brackets. */
typedef struct {
    char preset[32];
    int encoder_width;    /* first width of the global ResNet-18 [64]; its latent has 8 times this */
    int feature_width;    /* channels of the feature map [64] */
    int style_width;      /* width of the mapping and its style [512] */
    int mapping_layers;   /* [2] */
    int plane_resolution; /* [256] */
    int channel_base;     /* generator channels: min(channel_max, channel_base / resolution) [32768] */
    int channel_max;      /* [512] */
    int volume_channels[POINT_LEVELS];                          /* [32 64 96] */
    int token_width;                                            /* [32] */
    int heads, head_width;                                      /* [3 16] */
    int decoder_width, decoder_depth, decoder_skip, view_width; /* [128 8 4 64] */
    int samples;                                                /* per ray [48] */
    float voxel_size_m;                                         /* [0.005] */
    int image_size; /* width of the pictures it was trained on; 0: unknown [512] */
    int px_per_m;   /* how large people were in them, at their distance; 0: unknown [0] */
    /* Points move with their nearest vertex's map, the paper's way [0], or with a blend of it and its
     * neighbours' within so many millimetres (body.h, blend_m), which leaves no teeth at silhouettes. */
    int skin_blend_mm;
} model_config;

/* "small" or "small,plane_resolution=64". */
sherf_status model_config_parse(context *c, const char *text, model_config *out);
/* One line "preset,name=value,...": what model_config_parse reads back to the same sizes. Free with mem_free.
 */
char *model_config_text(context *c, const model_config *config);
sherf_status model_config_check(context *c, const model_config *config);
int model_latent_width(const model_config *config);
int model_channels(const model_config *config, int resolution); /* of the generator */
void model_point_sizes(const model_config *config, point_sizes *out);

struct sherf_model {
    model_config config;
    parameters *weights;
};
typedef struct sherf_model model;

sherf_status model_create(context *c, const model_config *config, uint64_t seed, model **out);
void model_free(model *m);
/* Moves the weights to where the context's device computes; nothing for the CPU. Before there are gradients.
 */
sherf_status model_place(context *c, model *m);
/* The tensors of the point network alone (renderer.*, decoder.*), as an avatar keeps them. */
bool model_is_point_weight(const char *name);
void model_point_weights(const parameters *weights, const model_config *config, point_weights *out);
/* By name; NULL never happens for names of the configuration. */
tensor *model_tensor(const model *m, const char *format, ...) PRINTF_LIKE(2, 3);

/* ---- what the body and the camera decide, once per observation ---- */
typedef struct {
    int width, height, vertices;
    float *image;     /* H x W x 3, black outside the mask; owned */
    posed_body *body; /* observation pose */
    sherf_camera camera;
    int32_t *visible; /* V */
    float *vertex_px; /* V x 2 */
    /* the sparse volume */
    float volume_min[3]; /* canonical box without the extra z */
    float voxel_size_m;
    int volume_size[3];    /* z y x */
    int32_t *vertex_zyx;   /* V x 3, voxel of each vertex */
    int32_t *vertex_voxel; /* V: row of the active voxel list of level 0 */
    struct {
        int size[3]; /* z y x */
        int64_t voxels;
        int32_t *grid;         /* size z*y*x: row or -1 */
        int32_t *rule;         /* [voxels, 27] submanifold */
        int32_t *down_rule;    /* [next level's voxels, 27] stride 2 from this level; NULL at the last */
    } level[POINT_LEVELS + 2]; /* 0: full resolution, 1..3: read by points, 4: down3, only in training */
} observation_geometry;
/* down3: also the level that only moves down3's batch statistics. fixed_voxels (tests): V x 3 given instead,
 * or NULL. */
sherf_status observation_geometry_create(context *c, const model_config *config, const body_model *body,
                                         const sherf_image *image_rgb, const sherf_camera *camera,
                                         const sherf_pose *pose, bool down3, const int32_t *fixed_voxels,
                                         observation_geometry **out);
/* Full-resolution size of the sparse volume, z y x: ceil(extent / voxel) | 31, plus 1. */
sherf_status volume_size_of(context *c, const model_config *config, const body_model *body, int size_zyx[3]);
void observation_geometry_free(observation_geometry *g);

/* ---- and once per target ---- */
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
void target_geometry_free(target_geometry *g);

/* ---- the feature bank, as tensors on a tape ---- */
typedef struct {
    tensor *latent;              /* [L] global feature */
    tensor *style;               /* [style_width] */
    tensor *plane[3];            /* [R, R, D] each */
    tensor *features;            /* [H/2, W/2, F] */
    tensor *image;               /* [H, W, 3] */
    tensor *level[POINT_LEVELS]; /* [voxels, channels] */
    struct fused_bank *fused;    /* points_fused.c; made at the first frame when NULL */
} model_bank;
/* Stages for the parity tests; NULL in normal use. */
typedef struct {
    tensor *block_x[16], *block_image[16];
    int blocks;
} model_stages;
sherf_status model_encode(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          model_bank *bank, model_stages *stages);

/* How large a person in this pose is in the picture, in pixels a metre at the joints' mean distance; 0 where
 * that lies behind the camera. What px_per_m of the configuration is compared with (sherf_observation_fit).
 */
sherf_status model_px_per_m(context *c, const body_model *body, const sherf_pose *pose,
                            const sherf_camera *camera, double *out);

/* Raw density [P, 1] and colour [P, 3] of the points [begin, end) of the set, op by op on the tape. */
typedef struct {
    tensor *plane[3], *volume, *fusion, *sigma, *rgb;
} point_outputs;
sherf_status model_points(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          const model_bank *bank, const point_set *points, int64_t begin, int64_t end,
                          point_outputs *out);

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
/* Values of all tensors of `from` (a converted ResNet-18) into both encoders where shapes agree. */
sherf_status model_load_resnet(context *c, model *m, const char *path);

/* ---- avatar ---- */
/* model/detail.h; a texel is a pixel of the observed picture. */
typedef struct {
    float difference[3]; /* observation minus the avatar's own picture of that view */
    float weight;        /* 0: not to be used; 1: seen well */
    float depth;         /* metres along the camera's axis, of the avatar's own picture, smoothed */
} detail_texel;
typedef struct {
    int width, height;
    sherf_camera camera;
    detail_texel *texel; /* NULL: none */
    float *seen;         /* V: how much the observation sees of what is near the vertex, 0 to 1 */
} avatar_detail;
struct sherf_avatar {
    model_config config;
    sherf_pose pose; /* the observation's */
    sherf_camera camera;
    uint64_t body_fingerprint;
    parameters *weights; /* the point network's only */
    point_bank bank;     /* its arrays are the avatar's own */
    uint8_t *picture;    /* the observation with more pixels than the bank's image, RGB; NULL: none */
    int picture_width, picture_height;
    posed_body *observed;   /* observation pose, for the pixel-aligned features */
    point_network *network; /* packed for the context's precision it was made or loaded in; NULL on a GPU */
    struct gpu_avatar *gpu; /* in the memory of the GPU that its context has, or NULL */
    const gpu_renderer *renderer;
    pthread_mutex_t gpu_lock; /* frames of one avatar share its room there */
    /* Found before the first frame that may leave something out. */
    struct {
        pthread_mutex_t lock;
        bool looked;
        empty_cells cells;
    } empty;
    /* Made before the first frame that wants it. */
    struct {
        pthread_mutex_t lock;
        avatar_detail kept;
    } detail;
};

/* avatar_network.c: the network of an avatar whose bank, weights and observation are there. */
sherf_status avatar_network_start(context *c, sherf_avatar *a, const body_model *body);
void avatar_network_free(sherf_avatar *a);
/* As point_network_run, wherever the network is. */
sherf_status avatar_ask(context *c, const sherf_avatar *a, const point_set *points, float *rgb, float *sigma);
/* The network on the processor, made now where it is on a GPU alone. The avatar's. */
sherf_status avatar_host_network(context *c, const sherf_avatar *a, const point_network **out);
sherf_status avatar_render_gpu(context *c, const sherf_avatar *a, const posed_body *posed,
                               const sherf_camera *camera, const gpu_frame_options *options,
                               sherf_frame *frame);

/* Cells of canonical space (1 cm) where the avatar's density is 0, as far as its values in their middles and
 * in those of their 6 neighbours tell. `out` has no bits when they are fewer than a tenth of what is within
 * 6 cm of the body. Free with empty_cells_free. */
sherf_status empty_cells_find(context *c, const sherf_avatar *a, const body_model *m, empty_cells *out);
void empty_cells_free(empty_cells *e);

/* sherf_render in two steps, for many frames of one pose: the body posed and ready for points_create, or its
 * joints where the avatar is on a GPU (freed with posed_body_free), and a frame of it. */
sherf_status avatar_pose(context *c, const sherf_avatar *a, const body_model *body, const sherf_pose *pose,
                         posed_body **out);
sherf_status avatar_render(context *c, const sherf_avatar *a, const body_model *body, const posed_body *posed,
                           const sherf_camera *camera, const sherf_render_options *options,
                           sherf_frame *frame);
/* What SHERF_DETAIL_ON does to a frame over `background` that was rendered without, for those who render in
 * parts. */
sherf_status avatar_give_detail(context *c, const sherf_avatar *a, const body_model *body,
                                const posed_body *posed, const sherf_camera *camera,
                                const float background[3], sherf_frame *frame);
/* The avatar's detail, made now where there is none yet. */
sherf_status avatar_detail_of(context *c, const sherf_avatar *a, const body_model *body,
                              const avatar_detail **out);

#endif
