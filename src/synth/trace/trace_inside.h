/* Shared by the ray tracer's files. */
#ifndef SHERF_TRACE_INSIDE_H
#define SHERF_TRACE_INSIDE_H

#include <embree3/rtcore.h>
#include <math.h>

#include "synth/trace/trace.h"

/* ---- small vectors ---- */
static inline float dot3(const float a[3], const float b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
static inline void cross3(const float a[3], const float b[3], float out[3]) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}
/* A zero vector stays 0. */
static inline void unit3(float v[3]) {
    float square = dot3(v, v), scale = square > 0 ? 1 / sqrtf(square) : 0;
    for (int k = 0; k < 3; k++) v[k] *= scale;
}
/* Two vectors orthogonal to the unit vector n and to each other (Duff et al. 2017). */
static inline void frame3(const float n[3], float a[3], float b[3]) {
    float sign = copysignf(1, n[2]), f = -1 / (sign + n[2]), g = n[0] * n[1] * f;
    a[0] = 1 + sign * n[0] * n[0] * f, a[1] = sign * g, a[2] = -sign * n[0];
    b[0] = g, b[1] = sign + n[1] * n[1] * f, b[2] = -n[1];
}
static inline float clamp01(float x) {
    return x > 0 ? x < 1 ? x : 1 : 0; /* NaN becomes 0 */
}

/* ---- textures (texture.c) ---- */
enum { TEXTURE_LEVELS = 16 };
struct trace_texture {
    int levels;
    struct {
        int width, height;
        uint8_t *texel;      /* RGBA, straight alpha */
    } level[TEXTURE_LEVELS]; /* each half as large; [0] owns the memory of all */
    bool has_alpha;
    int shadow_level;  /* fine enough to decide whether a shadow ray passes */
    float linear[256]; /* of an sRGB byte */
};
/* Bilinear, at the level whose texels are about `width_uv` of a unit square wide. rgba: linear colour,
 * opacity. */
void texture_sample(const trace_texture *t, const float uv[2], float width_uv, float rgba[4]);
/* The least opacity of the texels that affect places in a box; 0 if it is too large to check. */
float texture_min_opacity(const trace_texture *t, const float low_uv[2], const float high_uv[2]);
/* The nearest texel's opacity. */
float texture_opacity(const trace_texture *t, const float uv[2]);
float srgb_of_linear(float x);

/* ---- meshes (trace_mesh.c) ---- */
enum { LIGHT_LEVEL_MAX = 16 }; /* parts of an edge */
typedef struct {
    trace_material material;
    int64_t vertices, faces, edges;
    uint32_t *face;        /* F x 3 */
    float *corner_uv;      /* F x 6; NULL: none */
    float *uv_per_m;       /* F, side of the unit square per metre */
    uint8_t *solid;        /* F: fully opaque, whatever the material says */
    float *vertex;         /* V x 3 and 16 bytes of padding, world */
    float *normal;         /* V x 3, world */
    uint32_t *edge;        /* F x 3: the edge that starts at that corner */
    uint32_t *edge_first;  /* E: the first point inside an edge */
    uint8_t *edge_level;   /* E: parts, a power of two */
    uint32_t *face_first;  /* F: the first point inside a face */
    uint8_t *face_level;   /* F: the largest of its edges' */
    int64_t points;        /* vertices first, then edges', then faces' */
    int64_t points_before; /* of the meshes before this one */
} scene_mesh;
sherf_status scene_mesh_create(context *c, const trace_mesh *from, const trace_material *material,
                               float spacing_m, scene_mesh *out);
void scene_mesh_free(scene_mesh *mesh);
void scene_mesh_pose(scene_mesh *mesh, const float *position);
/* A point where light is computed: the mean of its vertices by `share`. */
typedef struct {
    uint32_t point;
    float weight;
    uint32_t vertex[3];
    float share[3];
    enum { AT_VERTEX, AT_EDGE, AT_FACE } kind;
    uint32_t edge; /* AT_EDGE: from vertex[0] to vertex[1] */
    int i, j;      /* AT_EDGE: step i; AT_FACE: its indices, see trace_mesh.c */
} light_corner;
/* Points around a place in a face: at most 6 (places between two points of an edge that is coarser than the
 * face count twice); their weights sum to 1. */
enum { LIGHT_CORNERS = 6 };
int light_corners(const scene_mesh *mesh, uint32_t face, const float barycentric[3],
                  light_corner out[LIGHT_CORNERS]);
/* A point that is not a vertex is the midpoint of two places of the next coarser lattice. Returns these
 * places' points: at most 4, with weights that sum to 1; *apart_m: the distance between the two places. */
int light_parents(const scene_mesh *mesh, uint32_t face, const light_corner *at, light_corner out[4],
                  float *apart_m);

/* ---- the scene (trace_scene.c) ---- */
/* Rays test bits 0 to 15, one for each layer, and these; the filter functions do the rest. */
static inline unsigned seen_mask(trace_seen seen) {
    return 1u << (16 + seen);
}
enum { SKY_STEPS = 256 };
typedef struct { /* read and written by many threads */
    _Atomic uint64_t word;
} lit_word;
struct trace_scene {
    RTCDevice device;
    RTCScene scene; /* NULL before the first pose */
    float spacing_m;
    int meshes;
    scene_mesh *mesh;
    int64_t points;
    int top_layer;
    lit_word *lit;     /* 2 x points (front, back): visible_pack; 0: not traced yet */
    trace_light light; /* lamps normalised, defaults filled in */
    float lamp_u[TRACE_LAMPS][3], lamp_v[TRACE_LAMPS][3]; /* axes across the lamp, times its radius */
    float sky[SKY_STEPS + 1][3]; /* colour of a white surface under the open sky, by normal . up -1 .. 1 */
    float (*sky_sample)[2];      /* sky_rays points of the unit square, neighbours adjacent */
    float (*lamp_sample)[2];     /* lamp_rays */
};

/* ---- light (trace_light.c) ---- */
/* The shares of the sky's and of each lamp's light that arrive. */
typedef struct {
    float sky, lamp[TRACE_LAMPS];
} visible;
sherf_status light_prepare(context *c, trace_scene *s, const trace_light *light);
void light_forget(trace_scene *s);
/* At a place in a face; traced now unless known. side: 0 if the face is counter-clockwise, 1 behind. */
void light_at(const trace_scene *s, int mesh, uint32_t face, const float barycentric[3], int side,
              visible *out);
/* RTCFilterFunctionN of meshes with alpha (lets a shadow ray pass at random) and of low layers. */
void light_filter(const struct RTCFilterFunctionNArguments *args);

/* ---- shading (trace_shade.c) ---- */
typedef struct {
    int mesh;
    uint32_t face;
    int side;
    float barycentric[3];
    float normal[3]; /* smooth, on the side of the viewer */
    float rgba[4];   /* albedo and opacity */
} surface;
/* width_m: of the sample's footprint there. */
void surface_at(const trace_scene *s, int mesh, uint32_t face, float u, float v, int side, float width_m,
                surface *out);
/* Light towards the viewer; direction: of the ray, unit. coat: additional light where it is not opaque. */
void surface_shade(const trace_scene *s, const surface *at, const float direction[3], float rgb[3],
                   float coat[3]);

/* ---- samples ---- */
/* Point i of Sobol's first two dimensions, as fractions of 2^32. */
static inline void sobol2(uint32_t i, uint32_t out[2]) {
    uint32_t x = 0, y = 0;
    for (uint32_t bit = 1u << 31, direction = 1u << 31; i; i >>= 1, bit >>= 1, direction ^= direction >> 1)
        if (i & 1) x ^= bit, y ^= direction;
    out[0] = x, out[1] = y;
}
static inline float fraction32(uint32_t x) {
    return (float)(x >> 8) * 0x1p-24f;
}

#endif
