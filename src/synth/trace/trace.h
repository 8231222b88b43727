/* trace: renders textured triangle meshes by ray tracing, for synthetic people.
 *
 * Incoming light is traced once for each pose, at points a few millimetres apart (the vertices, and points on
 * large edges and faces), when a camera first sees them, and all cameras of that pose share it. Colour,
 * alpha, highlights and silhouettes are traced for every sample of every pixel. A point's light depends only
 * on the point, so a picture is the same to the last bit for any number of threads and any order of cameras.
 */
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
    TRACE_OPAQUE, /* ignores the texture's alpha */
    TRACE_CUTOUT, /* visible where alpha is at least `cutoff` */
    TRACE_BLENDED /* alpha is opacity: hair, lashes */
} trace_alpha;

/* Who sees a mesh: for ceilings, for walls of a room that is open to a lamp, and for people who only cast
 * shadows. */
typedef enum {
    TRACE_BY_ALL,
    TRACE_BY_CAMERAS,   /* it casts no shadow */
    TRACE_NOT_BY_LAMPS, /* it darkens only the sky */
    TRACE_NOT_BY_CAMERAS
} trace_seen;

typedef struct {
    const trace_texture *color; /* NULL: white. Borrowed: it must live as long as the scene */
    float tint[3];              /* linear, times the colour */
    trace_alpha alpha;
    float cutoff;
    float specular;  /* reflectance seen head-on: skin 0.03, wet eyes 0.04, cloth 0.01 to 0.02 */
    float roughness; /* of those reflections, 0.05 (wet) to 1 (dull) */
    float wrap[3];   /* how far light wraps around, by colour: 0 Lambert, skin {0.35, 0.18, 0.12} */
    /* 0 to 15: skin 0, shirts 1, jackets 2. If the front of a higher layer is less than TRACE_COVER_M behind
     * the front of a surface, with nothing in between, the surface pokes through by mistake and is not drawn.
     */
    int layer;
    float near_m;   /* nearer surfaces do not darken: hair 0.005, so that its layers do not */
    bool coat;      /* reflections are visible where alpha is 0: the cornea */
    bool one_sided; /* cameras look through the back */
    float glow[3];  /* linear: emitted light, times the colour; it does not light others */
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
    const float *rest; /* vertices x 3, metres, any pose: determines the spacing of the light's points */
} trace_mesh;

/* ---- light ---- */
enum { TRACE_LAMPS = 3 };
/* Far away; the angle gives its size in the sky. */
typedef struct {
    float to_lamp[3];     /* any length but 0 */
    float half_angle_rad; /* 0 (sharp shadows) to 1 */
    float color[3];       /* the colour of a white surface that faces it, linear */
} trace_lamp;
/* A white surface that faces up and sees only the sky shows (horizon + 2 zenith) / 3. */
typedef struct {
    float up[3];
    float zenith[3], horizon[3], ground[3]; /* linear; the ground fills the lower half */
    trace_lamp lamp[TRACE_LAMPS];
    int lamps;
    float bounce;  /* 0 to 1: how much light near surfaces of the same colour reflect to each other */
    int sky_rays;  /* a point; multiple of 16, 16 to 1024; 0: 64 */
    int lamp_rays; /* a point and lamp in half-shadow; multiple of 16, 16 to 256; 0: 48 */
    uint64_t seed;
} trace_light;

/* ---- scenes ---- */
typedef struct trace_scene trace_scene;
/* spacing_m: the largest distance between points where light is computed, 0.001 to 1; about the size of a
 * pixel. */
sherf_status trace_scene_create(context *c, float spacing_m, trace_scene **out);
void trace_scene_free(trace_scene *s);
/* Copies the mesh; meshes are numbered from 0 in the order of their addition. Nothing can be added after the
 * first pose. */
sherf_status trace_scene_add(context *c, trace_scene *s, const trace_mesh *mesh,
                             const trace_material *material);
/* A new pose: positions[i] is mesh i's vertices x 3, in the world, metres. Forgets the light of the old pose.
 */
sherf_status trace_scene_pose(context *c, trace_scene *s, const float *const *positions,
                              const trace_light *light);

/* ---- pictures ---- */
typedef struct {
    int samples; /* in each pixel: 4, 8, 16, 32 or 64; 0: 16 */
    bool depth;  /* fill depth_m and normal_world */
    uint64_t seed;
} trace_options;
typedef struct {
    int width, height;
    float *color;        /* H x W x 3, linear, premultiplied: over black */
    float *alpha;        /* H x W, coverage of the pixel */
    float *depth_m;      /* H x W, z in the camera at the pixel's middle, infinity if empty; or NULL */
    float *normal_world; /* H x W x 3, at the same place, towards the camera; 0 if empty; or NULL */
} trace_picture;
/* Several threads may draw one scene at once, each with its own context. */
sherf_status trace_render(context *c, const trace_scene *s, const sherf_camera *camera,
                          const trace_options *options, trace_picture *out);
void trace_picture_free(trace_picture *p);
/* The sRGB colour of a place on a face, seen along its normal, in the light of the scene's pose: from the
 * side on which the face is counter-clockwise, or from behind. weight: of the face's corners. False if the
 * face is not opaque there, or something is less than TRACE_COVER_M in front of it. For any thread. */
bool trace_face_color(const trace_scene *s, int mesh, uint32_t face, const float weight[3], bool behind,
                      uint8_t rgb[3]);
/* Composites over a background (linear) and converts to sRGB, H x W x 3. Values over 0.8 are compressed
 * softly. */
void trace_picture_srgb(const trace_picture *p, const float background[3], uint8_t *rgb);

#endif
