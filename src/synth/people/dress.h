/* dress: a person as meshes in SMPL's rest pose with the open body's weights and textures, and the same
 * meshes posed. */
#ifndef SHERF_DRESS_H
#define SHERF_DRESS_H

#include "synth/body/makehuman.h"
#include "synth/people/person.h"
#include "synth/body/tpose.h"
#include "synth/trace/trace.h"
#include "synth/people/wardrobe.h"

/* Data shared by all people. */
typedef struct {
    makehuman *human;
    tpose_rig *rig;
    float *weights; /* V x 24 */
    body_model *body;
    wardrobe *wardrobe;
} studio;
/* source: the unpacked package; takes over nothing. body: the open body's file. */
sherf_status studio_open(context *c, const char *source, const char *body_path, studio **out);
void studio_close(studio *s);

enum { DRESSED_MAX = 16 };
typedef struct {
    int vertices, triangles, uvs;
    float *rest;                      /* V x 3, T-pose, metres */
    float *weights;                   /* V x 24 */
    uint32_t *triangle, *triangle_uv; /* without hidden ones */
    const float *uv;                  /* borrowed */
    trace_texture *texture;
    trace_material material;
    wear_kind kind; /* WEAR_KINDS: the body */
} dressed_mesh;
typedef struct {
    int meshes;
    dressed_mesh mesh[DRESSED_MAX]; /* the body first */
    float shape[BODY_SHAPES];       /* the nearest shape of the open body */
} dressed;
sherf_status dressed_create(context *c, studio *s, const person *p, dressed **out);
void dressed_free(dressed *d);
/* Posed positions of mesh i: V x 3, world. posed: of the open body. */
void dressed_pose(const studio *s, const dressed *d, int i, const posed_body *posed, float *positions);

/* The texture in another colour, with the brightness kept relative to the median of its opaque part. */
sherf_status tint_texture(context *c, const image_u8 *in, const float color[3], float detail, image_u8 *out);

#endif
