/* person: an avatar converted for files of other programs: a posed surface with a skin, with its colours as a
 * texture or at the vertices, or splats on it. */
#ifndef SHERF_BAKED_PERSON_H
#define SHERF_BAKED_PERSON_H

#include "baked/atlas.h"
#include "baked/skin.h"
#include "baked/splats.h"

typedef struct {
    int resolution; /* cells along the longest side of the canonical body */
    double level;   /* density of the surface, per metre; 0: where its silhouettes match the frames' */
    double islands; /* components with less than this share of the largest one's area are removed */
    int triangles;  /* reduce the surface to this many; 0: no reduction */
    int texture_px; /* side of the texture; 0: colours of the vertices */
    int splats;     /* this many splats instead of the surface's colours; 0: none */
    bool detail;    /* colours with the observation's detail */
    /* the world and pose of the surface; NULL: the rest pose of its shape */
    const sherf_pose *pose;
} baked_options;

typedef struct {
    surface surface; /* in the world of `posed`, y up, with normals */
    skin skin;
    posed_body *posed;
    float *rgb;       /* V x 3; NULL with a texture or splats */
    atlas atlas;      /* with a texture */
    uint8_t *picture; /* side x side x 3, of the atlas; NULL: none */
    splats splats;    /* in canonical space: splats_place moves them to the surface */
    sherf_exported report;
} baked_person;

/* SHERF_BAD_ARGUMENT where the avatar is nowhere as dense as the level. baked_person_free in any case. */
sherf_status baked_person_make(context *c, const sherf_avatar *a, const body_model *body,
                               const baked_options *o, baked_person *out);
void baked_person_free(baked_person *p);

#endif
