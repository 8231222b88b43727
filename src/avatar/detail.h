/* detail: restores in frames and surfaces what the observation shows and the network's colours lack. */
#ifndef SHERF_DETAIL_H
#define SHERF_DETAIL_H

#include "avatar/avatar.h"

/* A texel is a pixel of the observed picture. */
typedef struct {
    float difference[3]; /* observation minus the avatar's own picture of that view */
    float weight;        /* 0: not to be used; 1: seen well */
    float depth;         /* metres along the camera's axis, of the avatar's own picture, smoothed */
    /* of the observation: the mean over about 3 cm, and the difference from that mean */
    float color[3], pattern[3];
} detail_texel;
typedef struct {
    int width, height;
    sherf_camera camera;
    const posed_body *posed; /* the avatar's, in the picture's pose */
    detail_texel *texel;
    float *seen;      /* V: how well the observation sees the place near the vertex, 0 to 1 */
    float *patterned; /* V: how far the pattern there may continue elsewhere, 0 to 1 */
} detail_view;
/* Which places are opposite each other (detail_carry.c). */
typedef struct {
    int32_t *opposite; /* V: the vertex on the other side of trunk or limb, front to back; -1: none.
                        * NULL: nothing is lent */
    float *two_sides;  /* V: 0 where front and back are not alike (head, hands, feet), to 1 */
} detail_carry;
/* One of several ways to fill in unseen parts (variant.c). */
typedef struct {
    float light;   /* brightness of unseen parts; 1: the network's guess */
    float pattern; /* contrast of borrowed patterns; 1: the best guess */
    /* 0 to 1: weights of the place on the left-right mirrored side, of the one through the body, and of that
     * one's mirrored side. */
    float beside, through, across;
} detail_variant;
typedef struct {
    int views; /* pictures of the observation; 0: there is no detail */
    detail_view view[OBSERVED_PICTURES_MAX];
    detail_carry carry;
    detail_variant variant;
} avatar_detail;

/* Renders the avatar in the observed views and compares. Free with detail_free. */
sherf_status detail_create(context *c, const sherf_avatar *a, const body_model *body, avatar_detail *out);
void detail_free(avatar_detail *d);
typedef struct lazy_detail {
    pthread_mutex_t lock;
    avatar_detail made;
} lazy_detail;
lazy_detail *lazy_detail_create(context *c);
void lazy_detail_free(lazy_detail *l); /* NULL is fine */
/* The avatar's detail, made by the first call. */
sherf_status avatar_detail_of(context *c, const sherf_avatar *a, const body_model *body,
                              const avatar_detail **out);

/* What the observation contributes to the colour of a point. */
typedef struct {
    float add[3], seen; /* the colour to add, and how well the place is seen, 0 to 1 */
    /* How far the place is unseen but the opposite one is seen; that one's colour and pattern. */
    float toward[3], pattern[3], lent;
} detail_gift;
/* Contributions to `n` canonical points of the surface, [n, 3], weighted by how far their texels can be
 * trusted; nearest: each point's nearest canonical vertex. */
void detail_look_up(const avatar_detail *d, const body_model *body, int64_t n, const float *points_canonical,
                    const int32_t *nearest, detail_gift *out);
/* Applies a contribution to a colour; seen, lent, hidden: the gift's own values (hidden: 1 - seen), or
 * smoothed ones. */
void detail_give(const avatar_detail *d, const detail_gift *g, float seen, float lent, float hidden,
                 float rgb[3]);
/* Applies detail to a frame over `background`, then calls detail_make_firm. posed is a whole body with its
 * grid (points_prepare). */
sherf_status detail_apply(context *c, const avatar_detail *d, const body_model *body, const posed_body *posed,
                          const sherf_camera *camera, const float background[3], sherf_frame *frame);

/* ---- detail_carry.c: the opposite side ---- */
enum { CARRY_PLACES = 3, CARRY_RADIUS_MAX = 40 };
typedef struct {
    float x[3]; /* canonical */
    int32_t nearest;
    float sure, prefer; /* 0 to 1: how alike the places are; weight among places that are equally alike */
} carry_place;
sherf_status carry_create(context *c, const body_model *body, detail_carry *out);
void carry_free(detail_carry *d);
/* Places where something like the canonical point x may be seen. Returns their number. */
int carry_places(const detail_carry *d, const detail_variant *variant, const body_model *body,
                 const float x[3], int32_t nearest, carry_place out[CARRY_PLACES]);
/* Computes the texels' color and pattern, and d->patterned. Call it after detail_see_body. own: the avatar's
 * picture of the view; room: two floats per texel. */
sherf_status carry_pattern(context *c, const body_model *body, detail_view *d, const float *image,
                           const sherf_frame *own, float *room);

/* ---- variant.c ---- */
/* The variant of a seed; seed 0: the best single guess. */
detail_variant variant_draw(uint64_t seed);

/* ---- detail_body.c: visibility and depths from the body's mesh ---- */
/* Computes d->seen as d->camera sees it; drawn: the observed body rasterised in its picture. */
sherf_status detail_see_body(context *c, const body_model *body, const raster *drawn, detail_view *d);
/* How well the observation sees the place near a canonical point: the value of its nearest vertex v, blended
 * with its neighbours' as their maps are (deform_point.h). */
float detail_seen_near(const detail_view *d, const body_model *body, const float x[3], int32_t v);
/* Rasterises the posed body; free with raster_free. */
sherf_status detail_draw_body(context *c, const body_model *body, const posed_body *posed,
                              const sherf_camera *camera, raster **out);
/* Moves depths (metres along the camera's axis) that lie slightly inside the body to its surface. */
void detail_bound(const raster *drawn, float *depth);
/* Opacities round the person up to `haze` become 0, those from `solid` on 1. */
typedef struct {
    float haze, solid;
} detail_firmness;
/* More is haze where no picture shows roughly this outline (roughly this pose from this side). `solid` is
 * less than 1 only where pixels are large. */
detail_firmness detail_firmness_of(const avatar_detail *d, const posed_body *posed,
                                   const sherf_camera *camera);
/* Makes opacities firm: removes haze round the person and makes the body nearly solid. Colours change with
 * the opacity, in the share that is the frame's and not the background's. */
void detail_make_firm(const context *c, const raster *drawn, detail_firmness firm, const float background[3],
                      sherf_frame *frame);
/* Removes floating islands: opaque pixels with no opaque path to the body's pixels or to the picture's edge
 * (slabs under bare feet, where the network has learned soles). Does nothing where the body is not in the
 * picture. */
sherf_status detail_clear_islands(context *c, const raster *drawn, const float background[3],
                                  sherf_frame *frame);

/* ---- detail_smooth.c: pictures of a hazy surface ---- */
/* 0 up to edge[0], 1 from edge[1] on. */
static inline float detail_rise(float x, const float edge[2]) {
    const float t = (x - edge[0]) / (edge[1] - edge[0]), u = t < 0 ? 0 : t > 1 ? 1 : t;
    return u * u * (3 - 2 * u);
}
/* The scale at which a picture shows the body's root. */
float detail_px_per_m(const sherf_camera *camera, const posed_body *posed);
/* The number of pixels that length_m takes at the body's root; 1 to max. */
int detail_pixels(const sherf_camera *camera, const posed_body *posed, float length_m, int max);
/* Smooths `value` in place (NULL: the depths themselves) by means over neighbours within `radius` pixels,
 * taken twice and weighted by opacity and by how close their depths are. room: scratch as large as one of
 * them. Pixels with an opacity below 0.3 neither count nor change. */
void detail_smooth(const context *c, const sherf_image *opacity, int radius, float *depth, float *value,
                   float *room);
/* The largest step of depth to the pixels `reach` away. */
float detail_jump(const float *depth, int width, int height, int reach, int x, int y);
/* How far a pixel shows one surface and not an edge where two mix: 0 to 1. */
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
