/* place: where made people stand: rooms, streets, gardens, studios and clutter, made by rule.
 *
 * A place is built for one picture, beyond the person as the camera sees it, so that nothing comes between
 * the two. It is traced on its own with the light that falls on the person, who is there for shadows alone.
 */
#ifndef SHERF_PLACE_H
#define SHERF_PLACE_H

#include "synth/people/place_shapes.h"

typedef enum { PLACE_ROOM, PLACE_STREET, PLACE_GREEN, PLACE_STUDIO, PLACE_CLUTTER, PLACE_KINDS } place_kind;

enum { PLACE_NEAR_COLORS = 4 };
typedef struct {
    place_kind kind;
    uint64_t key;                           /* everything in it follows from this */
    float floor_world;                      /* y of the floor */
    float near_color[PLACE_NEAR_COLORS][3]; /* of the person, sRGB: some things have one like it */
} place;

/* A kind of place and the light that it has: lamps indoors, sun or clouds outdoors. */
place_kind place_light(uint64_t key, trace_light *out);

/* The place's bodies about a person at (0, 0, 0); camera_m: how far away the camera is. shapes_free them. */
sherf_status place_build(context *c, const place *p, float camera_m, shapes *out);

/* People who cast shadows: meshes, their materials and vertices' places in the world. */
typedef struct {
    int meshes;
    const trace_mesh *mesh;
    const trace_material *material;
    const float *const *position;
} place_people;
/* The camera's picture without the people, opaque all over, linear, as sharp as a lens of the place's own
 * makes it that is focused on the world's origin. */
sherf_status place_picture(context *c, const place *p, const trace_light *light, const place_people *people,
                           const sherf_camera *camera, trace_picture *out);

#endif
