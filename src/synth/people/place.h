/* place: procedural surroundings for made people: rooms, streets, gardens, studios and clutter.
 *
 * A place is built for one picture. It lies beyond the person as seen by the camera, so nothing comes between
 * the two. It is traced separately with the light that falls on the person, who only casts shadows in it. */
#ifndef SHERF_PLACE_H
#define SHERF_PLACE_H

#include "synth/people/place_shapes.h"

typedef enum { PLACE_ROOM, PLACE_STREET, PLACE_GREEN, PLACE_STUDIO, PLACE_CLUTTER, PLACE_KINDS } place_kind;

enum { PLACE_NEAR_COLORS = 4 };
typedef struct {
    place_kind kind;
    uint64_t key;                           /* everything in it follows from this */
    float floor_world;                      /* y of the floor */
    float near_color[PLACE_NEAR_COLORS][3]; /* of the person, sRGB: some things have a similar one */
} place;

/* A kind of place and its light: lamps indoors, sun or clouds outdoors. */
place_kind place_light(uint64_t key, trace_light *out);

/* The place's objects around a person at (0, 0, 0); camera_m: the camera's distance. shapes_free them. */
sherf_status place_build(context *c, const place *p, float camera_m, shapes *out);

/* People who cast shadows: meshes, their materials and their vertices' places in the world. */
typedef struct {
    int meshes;
    const trace_mesh *mesh;
    const trace_material *material;
    const float *const *position;
} place_people;
/* The camera's picture without the people, fully opaque, linear, with the sharpness of the place's own lens,
 * which is focused on the world's origin. */
sherf_status place_picture(context *c, const place *p, const trace_light *light, const place_people *people,
                           const sherf_camera *camera, trace_picture *out);

#endif
