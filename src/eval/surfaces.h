/* surfaces: how far one surface is from another, as reconstructions of people are scored. */
#ifndef SHERF_SURFACES_H
#define SHERF_SURFACES_H

#include "scene/solid.h"

/* Means over places, distributed by area, on the outside of either surface. */
typedef struct {
    double to_truth_m;   /* from the prediction's places to the nearest of the truth: point to surface */
    double from_truth_m; /* from the truth's to the nearest of the prediction */
    double chamfer_m;    /* the mean of both */
    double normal_deg;   /* between a place's normal and that of its nearest place, both ways */
    double overlap;      /* of the insides, surfaces_overlap */
} surface_scores;
/* `places` of each, drawn by `key`; cell_m: cells of the grids that determine visibility (solid.h). Normals
 * are those of the triangles, whichever side they were made from. The overlap stays 0. SHERF_BAD_ARGUMENT
 * where a surface has no outside. */
sherf_status surfaces_compare(context *c, int64_t places, uint64_t key, float cell_m, int meshes,
                              const solid_mesh *prediction, int truth_meshes, const solid_mesh *truth,
                              surface_scores *out);

/* Intersection over union of the prediction's inside and the truth's, counted over points [P, 3] that are
 * known to be inside the truth (1) or outside (0). The prediction is closed: an open shell has no inside.
 * cell_m: as above. */
sherf_status surfaces_overlap(context *c, float cell_m, int meshes, const solid_mesh *prediction,
                              int64_t points, const float *point, const uint8_t *inside, double *out);

#endif
