/* detail: what the observation shows and the network's colours do not, given back to frames and surfaces. */
#ifndef SHERF_DETAIL_H
#define SHERF_DETAIL_H

#include "avatar/avatar.h"

/* A texel is a pixel of the observed picture. */
typedef struct {
    float difference[3];        /* observation minus the avatar's own picture of that view */
    float weight;               /* 0: not to be used; 1: seen well */
    float depth;                /* metres along the camera's axis, of the avatar's own picture, smoothed */
    float color[3], pattern[3]; /* of the observation: the mean of some 3 cm, and what it differs from that */
} detail_texel;
typedef struct {
    int width, height;
    sherf_camera camera;
    const posed_body *posed; /* the avatar's, in the picture's pose */
    detail_texel *texel;
    float *seen;      /* V: how much the observation sees of what is near the vertex, 0 to 1 */
    float *patterned; /* V: how much of the pattern there may go on elsewhere, 0 to 1 */
} detail_view;
/* What is opposite of what (detail_carry.c). */
typedef struct {
    int32_t *opposite; /* V: the vertex on the other side of trunk or limb, front to back; -1: none.
                        * NULL: nothing is lent */
    float *two_sides;  /* V: 0 where front and back are not alike (head, hands, feet), to 1 */
} detail_carry;
/* One of several ways to fill in what no picture showed (variant.c). */
typedef struct {
    float light;   /* brightness of what was not seen; 1: as the network guesses it */
    float pattern; /* contrast of what is lent; 1: as the best guess has it */
    /* 0 to 1: how much a place at the other side counts, one through the body, and that one's other side. */
    float beside, through, across;
} detail_variant;
typedef struct {
    int views; /* the observation's pictures; 0: nothing was made */
    detail_view view[OBSERVED_PICTURES_MAX];
    detail_carry carry;
    detail_variant variant;
} avatar_detail;

/* The avatar's pictures of the observed views rendered and compared. Free with detail_free. */
sherf_status detail_create(context *c, const sherf_avatar *a, const body_model *body, avatar_detail *out);
void detail_free(avatar_detail *d);
typedef struct lazy_detail {
    pthread_mutex_t lock;
    avatar_detail made;
} lazy_detail;
lazy_detail *lazy_detail_create(context *c);
void lazy_detail_free(lazy_detail *l); /* NULL is fine */
/* The avatar's, made now where there is none yet. */
sherf_status avatar_detail_of(context *c, const sherf_avatar *a, const body_model *body,
                              const avatar_detail **out);

/* What the observation gives to the colour of a point. */
typedef struct {
    float add[3], seen; /* how much of the place it sees, 0 to 1, and what it adds there */
    /* How much of it is not seen, but what is opposite: that one's colour and pattern. */
    float toward[3], pattern[3], lent;
} detail_gift;
/* To `n` canonical points of the surface, [n, 3], as far as the points' texels are to be trusted; nearest:
 * each one's nearest canonical vertex. */
void detail_look_up(const avatar_detail *d, const body_model *body, int64_t n, const float *points_canonical,
                    const int32_t *nearest, detail_gift *out);
/* Into a colour; seen, lent, hidden: the gift's (hidden: 1 - seen), or what they have been smoothed to. */
void detail_give(const avatar_detail *d, const detail_gift *g, float seen, float lent, float hidden,
                 float rgb[3]);
/* Into the colours of a frame over `background`; then detail_make_firm. posed is whole, with its grid
 * (points_prepare). */
sherf_status detail_apply(context *c, const avatar_detail *d, const body_model *body, const posed_body *posed,
                          const sherf_camera *camera, const float background[3], sherf_frame *frame);

/* ---- detail_carry.c: what is opposite ---- */
enum { CARRY_PLACES = 3, CARRY_RADIUS_MAX = 40 };
typedef struct {
    float x[3]; /* canonical */
    int32_t nearest;
    float sure, prefer; /* 0 to 1: how alike it is; how much it counts beside others that are as alike */
} carry_place;
sherf_status carry_create(context *c, const body_model *body, detail_carry *out);
void carry_free(detail_carry *d);
/* Where something like the canonical point x may be seen. Returns how many. */
int carry_places(const detail_carry *d, const detail_variant *variant, const body_model *body,
                 const float x[3], int32_t nearest, carry_place out[CARRY_PLACES]);
/* The texels' color and pattern, and d->patterned; after detail_see_body. own: the avatar's picture of the
 * view; room: two floats a texel. */
sherf_status carry_pattern(context *c, const body_model *body, detail_view *d, const float *image,
                           const sherf_frame *own, float *room);

/* ---- variant.c ---- */
/* Of a seed, the same for the same; 0: the best single guess. */
detail_variant variant_draw(uint64_t seed);

/* ---- detail_body.c: what the body's mesh tells ---- */
/* d->seen, from d->camera; drawn: the observed body in its picture. */
sherf_status detail_see_body(context *c, const body_model *body, const raster *drawn, detail_view *d);
/* How much the observation sees of what is near a canonical point: of its nearest vertex v and that one's
 * neighbours, as their maps are blended (deform_point.h). */
float detail_seen_near(const detail_view *d, const body_model *body, const float x[3], int32_t v);
/* The posed body in a picture; free with raster_free. */
sherf_status detail_draw_body(context *c, const body_model *body, const posed_body *posed,
                              const sherf_camera *camera, raster **out);
/* The picture's depths (metres along the camera's axis) that lie a little way in the body are brought to its
 * surface. */
void detail_bound(const raster *drawn, float *depth);
/* What is made of opacities round the person: up to `haze` 0, from `solid` on 1. */
typedef struct {
    float haze, solid;
} detail_firmness;
/* Firmer where no picture shows about this outline, that is, about this pose from about this side; `solid`
 * is less than 1 only where pixels are large. */
detail_firmness detail_firmness_of(const avatar_detail *d, const posed_body *posed,
                                   const sherf_camera *camera);
/* Opacities are made firm: haze round the person goes, and where the body is, little shines through. Colours
 * follow, as far as they are the frame's own and not the background's. */
void detail_make_firm(const context *c, const raster *drawn, detail_firmness firm, const float background[3],
                      sherf_frame *frame);
/* What floats goes: opaque pixels that no others join to the body's or to the picture's edge (slabs under
 * bare feet, where the network has learned soles). Nothing, where the body is not in the picture. */
sherf_status detail_clear_islands(context *c, const raster *drawn, const float background[3],
                                  sherf_frame *frame);

/* ---- detail_smooth.c: pictures of a hazy surface ---- */
/* 0 up to edge[0], 1 from edge[1] on. */
static inline float detail_rise(float x, const float edge[2]) {
    const float t = (x - edge[0]) / (edge[1] - edge[0]), u = t < 0 ? 0 : t > 1 ? 1 : t;
    return u * u * (3 - 2 * u);
}
/* How large a picture shows the body's root. */
float detail_px_per_m(const sherf_camera *camera, const posed_body *posed);
/* So many pixels are about `m` metres where the body's root is; 1 to max. */
int detail_pixels(const sherf_camera *camera, const posed_body *posed, float m, int max);
/* Takes means over neighbours within `radius` pixels, twice, weighted by opacity and by how near their depths
 * are, and smooths `value` in place (NULL: the depths themselves). room: scratch as large as one of them.
 * Pixels with an opacity below 0.3 neither count nor change. */
void detail_smooth(const context *c, const sherf_image *opacity, int radius, float *depth, float *value,
                   float *room);
/* The largest step of depth to the pixels `reach` away. */
float detail_jump(const float *depth, int width, int height, int reach, int x, int y);
/* How much a pixel is surface, and not an edge where two of them mix: 0 to 1. */
float detail_solid(float opacity, float jump);
/* World points of a picture's depths. */
typedef struct {
    float origin[3], to_world[9];
} detail_optics;
void detail_optics_of(const sherf_camera *camera, detail_optics *out);
static inline void detail_point(const detail_optics *o, int x, int y, float depth, float out[3]) {
    for (int k = 0; k < 3; k++) {
        const float *m = o->to_world + 3 * k;
        out[k] = o->origin[k] + depth * (m[0] * (float)x + m[1] * (float)y + m[2]);
    }
}

#endif
