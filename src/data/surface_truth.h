/* surface_truth: a person's surface in a pose, for models that are trained on surfaces and for scores of
 * surfaces: its triangles, places on it with their colours, and points near and far that are known to be
 * inside or outside. It lies in the person's folder as surface/POSE.safetensors (docs/datasets.md). Positions
 * are in the data set's world, metres. */
#ifndef SHERF_SURFACE_TRUTH_H
#define SHERF_SURFACE_TRUTH_H

#include "base/path.h"
#include "data/data.h"
#include "scene/solid.h"

typedef struct {
    int64_t vertices, triangles, places, points;
    float *vertex;      /* V x 3 */
    uint32_t *triangle; /* T x 3 */
    float *place;       /* on the visible part of the surface, by area: N x 3 */
    float *normal;      /* N x 3, unit, outwards */
    uint8_t *color;     /* N x 3, sRGB */
    float *point;       /* P x 3 */
    uint8_t *inside;    /* P: 1, or 0 */
} surface_truth;
void surface_truth_free(surface_truth *t);

/* The colour of a place seen from its front or from behind; false: it is not visible. */
typedef bool (*surface_color)(void *user, const solid_point *place, bool behind, uint8_t rgb[3]);
typedef struct {
    int meshes;
    const solid_mesh *drawn, *walls; /* the visible triangles, and those that stop the flood (solid.h) */
    float cell_m;
    int seal; /* of solid_grid_create */
    uint64_t key;
    surface_color color;
    void *user;
} surface_source;
/* Of triangles. Points: 24576 round places of the surface, off by a normal deviation of 5 cm along each axis,
 * and 4096 anywhere in a cube of 2.6 m about its middle, as PIFu is trained with. SHERF_BAD_ARGUMENT where
 * nothing is seen or nothing is inside. */
sherf_status surface_truth_make(context *c, const surface_source *from, surface_truth *out);

enum { TRUTH_MESH = 1, TRUTH_SAMPLES = 2 };
sherf_status surface_truth_write(context *c, const surface_truth *t, const char *path);
/* parts: TRUTH_MESH (vertices, triangles) and TRUTH_SAMPLES (places, points), checked: finite, indices in
 * range, points of both kinds. */
sherf_status surface_truth_read(context *c, const char *path, unsigned parts, surface_truth *out);
/* The file of a data set's person in a pose. SHERF_NO_FILE: there is none; the message says how to make it.
 */
sherf_status surface_truth_find(context *c, const sherf_dataset *d, int person, int pose,
                                char path[PATH_LENGTH]);
/* Its surface. */
sherf_status surface_truth_load(context *c, const sherf_dataset *d, int person, int pose, unsigned parts,
                                surface_truth *out);
/* Whether the data set has it. */
bool surface_truth_is_there(context *c, const sherf_dataset *d, int person, int pose);
/* folder/surface/POSE.safetensors. */
sherf_status surface_truth_path(context *c, const char *folder, int pose, char out[PATH_LENGTH]);

#endif
