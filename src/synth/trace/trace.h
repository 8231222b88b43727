/* trace: pictures of textured triangle meshes by ray tracing, for synthetic people.
 *
 * What light reaches the surface is traced once a pose at points a few millimetres apart (the vertices, and
 * points on edges and in faces where these are large), when a camera first sees them, and shared by all
 * cameras of that pose; colour, alpha, highlights and silhouettes are traced for every sample of every pixel.
 * A point's light depends on the point alone, so a picture is the same to the last bit for any number of
 * threads and any order of cameras. */
#ifndef SHERF_TRACE_H
#define SHERF_TRACE_H

#include "scene/scene.h"

/* ---- textures ---- */
typedef struct trace_texture trace_texture;
/* channels 1 (grey), 3 (sRGB) or 4 (sRGB and straight alpha), row 0 the top one; copied. (0, 0) of the
 * texture coordinates is the lower left corner, and the picture repeats. */
sherf_status trace_texture_create(context *c, int width, int height, int channels, const uint8_t *data,
                                  trace_texture **out);
void trace_texture_free(trace_texture *t);

/* ---- meshes ---- */
typedef enum {
    TRACE_OPAQUE, /* the texture's alpha is not looked at */
    TRACE_CUTOUT, /* there where alpha is at least `cutoff`, else not */
    TRACE_BLENDED /* alpha is opacity: hair, lashes */
} trace_alpha;

/* Who sees a mesh: for ceilings, for walls of a room that is open to a lamp, and for people who only cast
 * shadows. */
typedef enum {
    TRACE_BY_ALL,
    TRACE_BY_CAMERAS,   /* it casts no shadow */
    TRACE_NOT_BY_LAMPS, /* it darkens the sky alone */
    TRACE_NOT_BY_CAMERAS
} trace_seen;

typedef struct {
    const trace_texture *color; /* NULL: white. Borrowed: it must live as long as the scene */
    float tint[3];              /* linear, times the colour */
    trace_alpha alpha;
    float cutoff;
    float specular;  /* reflectance seen head-on: skin 0.03, wet eyes 0.04, cloth 0.01 to 0.02 */
    float roughness; /* of those reflections, 0.05 (wet) to 1 (dull) */
    float wrap[3];   /* how far light creeps round by colour: 0 Lambert, skin {0.35, 0.18, 0.12} */
    /* 0 to 15: skin 0, shirts 1, jackets 2. Where the front of a surface has that of a higher layer less than
     * TRACE_COVER_M behind it, and nothing between, it pokes through by mistake and is not drawn. */
    int layer;
    float near_m;   /* what is nearer than this does not darken: hair 0.005, so that its layers do not */
    bool coat;      /* reflections are there where alpha is not: the cornea */
    bool one_sided; /* cameras look through the back */
    float glow[3];  /* linear: light of its own, times the colour; it does not light others */
    trace_seen seen;
} trace_material;
#define TRACE_COVER_M 0.025f
trace_material trace_material_plain(void); /* white, opaque, Lambert, no reflections */

typedef struct {
    int64_t vertices, faces;
    const uint32_t *face; /* faces x 3 */
    int64_t uvs;
    const float *uv;         /* uvs x 2; NULL: none */
    const uint32_t *face_uv; /* faces x 3; NULL: as `face` */
    const float *rest;       /* vertices x 3, metres, any pose: decides how fine the light is taken */
} trace_mesh;

/* ---- light ---- */
enum { TRACE_LAMPS = 3 };
/* Far away and as large in the sky as the angle says. */
typedef struct {
    float to_lamp[3];     /* any length but 0 */
    float half_angle_rad; /* 0 (sharp shadows) to 1 */
    float color[3];       /* what a white surface that faces it shows, linear */
} trace_lamp;
/* The sky is seen by a white surface that faces up, and sees nothing else, as (horizon + 2 zenith) / 3. */
typedef struct {
    float up[3];
    float zenith[3], horizon[3], ground[3]; /* linear; the ground fills the lower half */
    trace_lamp lamp[TRACE_LAMPS];
    int lamps;
    float bounce;  /* 0 to 1: how much light near surfaces of the same colour hand on to each other */
    int sky_rays;  /* a point; multiple of 16, 16 to 1024; 0: 64 */
    int lamp_rays; /* a point and lamp in half-shadow; multiple of 16, 16 to 256; 0: 48 */
    uint64_t seed;
} trace_light;

/* ---- scenes ---- */
typedef struct trace_scene trace_scene;
/* spacing_m: the largest distance of the points where light is taken, 0.001 to 1; about the size of a pixel.
 */
sherf_status trace_scene_create(context *c, float spacing_m, trace_scene **out);
void trace_scene_free(trace_scene *s);
/* Copies the mesh; meshes are numbered from 0 in the order in which they are added. Nothing can be added
 * after the first pose. */
sherf_status trace_scene_add(context *c, trace_scene *s, const trace_mesh *mesh,
                             const trace_material *material);
/* A new pose: positions[i] is mesh i's vertices x 3, in the world, metres. Forgets the light of the old pose.
 */
sherf_status trace_scene_pose(context *c, trace_scene *s, const float *const *positions,
                              const trace_light *light);

/* ---- pictures ---- */
typedef struct {
    int samples; /* a pixel: 4, 8, 16, 32 or 64; 0: 16 */
    bool depth;  /* fill depth_m and normal_world */
    uint64_t seed;
} trace_options;
typedef struct {
    int width, height;
    float *color;        /* H x W x 3, linear, premultiplied: over black */
    float *alpha;        /* H x W, share of the pixel that is covered */
    float *depth_m;      /* H x W, z in the camera of the pixel's middle, infinity where empty; or NULL */
    float *normal_world; /* H x W x 3, there, towards the camera; 0 where empty; or NULL */
} trace_picture;
/* Several threads may draw one scene at a time, each with its own context. */
sherf_status trace_render(context *c, const trace_scene *s, const sherf_camera *camera,
                          const trace_options *options, trace_picture *out);
void trace_picture_free(trace_picture *p);
/* The colour in sRGB that a place on a face shows to who looks at it along its normal, in the light of the
 * scene's pose: from the side from which the face is counter-clockwise, or from behind. weight: of the
 * face's corners. False where the face is not opaque there, or something lies less than TRACE_COVER_M before
 * it. For any thread. */
bool trace_face_color(const trace_scene *s, int mesh, uint32_t face, const float weight[3], bool behind,
                      uint8_t rgb[3]);
/* Over a background (linear) into sRGB, H x W x 3. What is brighter than 0.8 is compressed softly. */
void trace_picture_srgb(const trace_picture *p, const float background[3], uint8_t *rgb);

#endif
