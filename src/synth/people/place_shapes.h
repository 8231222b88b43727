/* place_shapes: simple textured objects, gathered by material into meshes of a traced scene. */
#ifndef SHERF_PLACE_SHAPES_H
#define SHERF_PLACE_SHAPES_H

#include "synth/people/place_pattern.h"

enum { SHAPES_MAX = 64, SHAPES_TEXTURE_SIDE = 256 };

/* One material's mesh. Metres; x right, y up, z away from the camera, the person stands at 0. */
typedef struct {
    trace_material material;
    trace_texture *texture; /* owned */
    float repeat_m;         /* the texture's side */
    int vertices, faces, vertex_room, face_room;
    float *vertex, *uv; /* V x 3, V x 2 */
    uint32_t *face;     /* F x 3 */
} shape_mesh;

/* The first failure sticks, and later calls do nothing. */
typedef struct {
    context *c;
    sherf_status status;
    int meshes;
    shape_mesh mesh[SHAPES_MAX];
    shape_mesh spare; /* receives objects if there are too many meshes */
    float turn_rad;   /* about the vertical through (0, 0, 0), for all added objects */
} shapes;
void shapes_free(shapes *s);

/* A new mesh; valid until shapes_free. repeat_m: the texture's side. */
shape_mesh *shapes_mesh(shapes *s, place_pattern pattern, const float color[PATTERN_COLORS][3], uint64_t key,
                        float repeat_m);

/* corner + i a + j b, 0 <= i, j <= 1, cut into cells of at most cell_m, so that light is computed finely. */
void shapes_quad(shapes *s, shape_mesh *mesh, const float corner[3], const float a[3], const float b[3],
                 float cell_m);
/* Its foot's middle, its sizes along its own x, y and z, and its rotation about the vertical. */
void shapes_box(shapes *s, shape_mesh *mesh, const float foot[3], const float size[3], float turn_rad);
/* From foot upwards; with its lid. */
void shapes_cylinder(shapes *s, shape_mesh *mesh, const float foot[3], float radius_low, float radius_high,
                     float height);
void shapes_ball(shapes *s, shape_mesh *mesh, const float middle[3], const float radius[3]);
/* Squares in all directions inside the ball: foliage, with a texture of leaves. */
void shapes_cards(shapes *s, shape_mesh *mesh, const float middle[3], const float radius[3], int count,
                  float side, uint64_t key);

#endif
