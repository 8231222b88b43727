/* body: the SMPL-like body model, its poses, and skinning between its spaces.
 * Spaces: _smpl the posed body's own (before R, Th), _world, _canonical (shape 0, big pose), _camera. */
#ifndef SHERF_BODY_H
#define SHERF_BODY_H

#include "base/base.h"

#ifdef __cplusplus /* CUDA's sources */
extern "C" {
#endif

enum { BODY_JOINTS = 24, BODY_SHAPES = 10, BODY_POSE_FEATURES = 207, BODY_VERTICES_MAX = 1 << 20 };

struct sherf_body {
    int vertices, faces;
    float *v_template; /* V x 3 */
    float *shapedirs;  /* V x 3 x 10 */
    float *posedirs;   /* 207 x V x 3 (pose feature major, so that applying it streams); NULL: none */
    /* Volume preservation at bent joints without posedirs (docs/body.md): strength for each joint, 0 to 1;
     * all 0: none. pose_volume (V x 24, NULL: none): k of the offset -k (F + F^T) / 2 (v - J), F = R_joint -
     * I. */
    float volume[BODY_JOINTS];
    float *pose_volume;
    float *weights;          /* V x 24 */
    double *regressor;       /* 24 x V, dense */
    uint32_t *face;          /* F x 3 */
    int parent[BODY_JOINTS]; /* -1 for the root; parent[j] < j */
    uint64_t fingerprint;    /* of all of the above */
    /* derived once: regressor * template, regressor * shapedirs; the canonical body (shape 0, big pose), its
     * blended transform per vertex and that one's inverse, and a grid over its vertices */
    double joint_template[BODY_JOINTS][3], joint_shape[BODY_JOINTS][3][BODY_SHAPES];
    struct posed_body *canonical;
    double *canonical_blend, *canonical_inverse; /* V x 12 each */
    struct vertex_grid *canonical_grid;
    /* The vertices that share an edge with v: neighbour[i] for neighbour_first[v] <= i <
     * neighbour_first[v + 1]. */
    int32_t *neighbour_first, *neighbour;
    /* The body's other side: the vertex nearest to v's mirror image in the template, and the x of the mirror
     * plane, which is the middle of the paired joints. */
    int32_t *mirror;
    float mirror_x_m;
};
typedef struct sherf_body body_model;

/* A pose without the vertices: R(pose)[1:] - I, the joints' transforms (rest to posed, relative to the rest
 * pose), the body's transform to the world. */
typedef struct {
    double feature[BODY_POSE_FEATURES], transform[BODY_JOINTS][12], to_world[12];
    float shape[BODY_SHAPES], pose_rad[72];
} joint_pose;

/* 3 x 4 affine maps, row-major. */
typedef struct posed_body {
    float *vertices_smpl;              /* V x 3 */
    float *pose_offset;                /* V x 3: posedirs * vec(R(pose)[1:] - I), and pose_volume's */
    float *shape_offset;               /* V x 3: shapedirs * shape */
    float joints_rest[BODY_JOINTS][3]; /* J: regressed from the shaped template */
    float joints_smpl[BODY_JOINTS][3];
    float transform[BODY_JOINTS][12]; /* A_k: rest to posed, relative to the rest pose */
    float R[9], Th[3];                /* body to world */
    isa_level isa;                    /* of the loops over points (deform.c) */
    float min_smpl[3], max_smpl[3];
    /* V x 12: the complete map of a point whose nearest vertex is v (see deform.c). If the blended rotation
     * is singular, the vertex follows its heaviest joint only. */
    float *to_canonical;      /* SMPL space to canonical */
    float *from_canonical;    /* canonical to world */
    struct vertex_grid *near; /* of vertices_smpl, made by points_prepare; NULL: none */
    float blend_m;            /* radius for blending with the neighbours' maps; 0: no blending */
    /* V x 12, as from_canonical, for features: from canonical space to the place in the world at which a
     * point is read in the picture (scene.h, body_read_pictures). NULL: its own place. */
    float *read_from;
    uint8_t *together;  /* with read_from, by neighbour of body_model: maps_join (deform_point.h) */
    int32_t *seen;      /* V, with read_from: whether the picture shows the vertex */
    joint_pose *joints; /* from posed_joints_create only, which leaves out all per-vertex data */
} posed_body;

extern const float body_big_pose[72];

/* No part of a person is further from the body's nearest vertex, as in the paper's code: samples stay within
 * this distance, and every box round the body is larger by it. */
#define BODY_SHELL_M 0.05f

/* Takes ownership of nothing: copies the arrays, checks them (finite, weights sum to 1 within 1e-3, indices
 * in range, a tree), computes the canonical body and fingerprint. Arrays: v_template V x 3, shapedirs V x 3 x
 * shape_count (first 10 used, fewer are padded with zeros), posedirs V x 3 x 207 or NULL, weights V x 24,
 * regressor 24 x V, kintree_parent 24 (anything for the root). */
typedef struct {
    int vertices, faces, shape_count;
    const double *v_template, *shapedirs, *posedirs, *weights, *regressor;
    const double *volume; /* 24, or NULL */
    const int64_t *face, *parent;
} body_arrays;
sherf_status body_create(context *c, const body_arrays *arrays, body_model **out);
/* body_load: by content, .pkl .npz .safetensors, is in data/body_file.h (it needs io). */

/* Refuses values that are not finite and an R that is not a rotation. */
sherf_status posed_body_create(context *c, const body_model *body, const float pose_rad[72],
                               const float shape[10], const float R[9], const float Th[3], posed_body **out);
/* For a GPU, which poses the vertices itself: no per-vertex arrays, no bounds, no grid. */
sherf_status posed_joints_create(context *c, const body_model *body, const float pose_rad[72],
                                 const float shape[10], const float R[9], const float Th[3],
                                 posed_body **out);
void posed_body_free(posed_body *p);
void body_vertices_world(const body_model *body, const posed_body *p, float *vertices_world); /* V x 3 */
void rodrigues(const float axis_angle_rad[3], float R[9]);
void rotation_to_axis_angle(const float R[9], float axis_angle_rad[3]);
bool rotation_is_valid(const float R[9]); /* finite, orthonormal within 1e-2, right-handed */

/* Canonical box (network.md): min/max of the canonical vertices -/+ BODY_SHELL_M, without and with the
 * further 0.1 in z. */
void body_canonical_bounds(const body_model *body, float min_canonical[3], float max_canonical[3]);
void body_canonical_bounds_z(const body_model *body, float min_canonical[3], float max_canonical[3]);

/* Unit vertex normals: sum of the unit normals (b-a) x (c-a) of the faces at the vertex, normalised. V x 3.
 */
sherf_status body_normals(context *c, const body_model *body, const float *vertices, float *normals);

/* ---- deformation (network.md: Target to canonical, Canonical to observation) ---- */
/* In both directions: if the body's blend_m r is not 0 and `nearest` is given, the maps of the nearest
 * vertex's neighbours contribute, each with weight (1 - (d^2 - d0^2) / r^2)^2, where d is its distance from
 * the point and d0 the nearest vertex's; the weight is 0 if d^2 - d0^2 exceeds r^2. So the map hardly jumps
 * where the nearest vertex changes. */
/* Points of the posed body's SMPL space to canonical space by the inverse LBS of their nearest vertex.
 * directions may be NULL; they take the rotations only. Any of the out arrays may alias its input. nearest
 * NULL: point i belongs to vertex i. A negative nearest (a point that is not finite) counts as vertex 0. */
void deform_to_canonical(const body_model *body, const posed_body *p, int64_t n, const float *points_smpl,
                         const float *directions_smpl, const int32_t *nearest, float *points_canonical,
                         float *directions_canonical);
/* Canonical points to the posed body's world space; nearest: nearest canonical vertex of each point. */
void deform_from_canonical(const body_model *body, const posed_body *p, int64_t n,
                           const float *points_canonical, const int32_t *nearest, float *points_world);

/* As deform_from_canonical, but to the place in the picture at which the point is read: by read_from, if the
 * body has it. Only maps that lead to the same place are blended. */
void deform_to_picture(const body_model *body, const posed_body *p, int64_t n, const float *points_canonical,
                       const int32_t *nearest, float *points_world);

/* ---- nearest vertex: exact, over a uniform grid ---- */
typedef struct vertex_grid vertex_grid;
/* Answers queries with a nearest vertex closer than `radius_m` (squared distances in float32, dx dx + dy dy +
 * dz dz from the left without fused operations, lowest index on a tie); further away the answer is -1.
 * radius_m 0: no limit; then only a point that is not finite gets -1. */
sherf_status vertex_grid_create(context *c, int64_t vertices, const float *vertex, float radius_m,
                                vertex_grid **out);
void vertex_grid_free(vertex_grid *g);
int32_t vertex_grid_nearest(const vertex_grid *g, const float point[3], float *distance_squared);
void vertex_grid_nearest_many(const context *c, const vertex_grid *g, int64_t n, const float *points,
                              int32_t *nearest);
/* The same answer, faster if `guess` (a vertex, or -1) is near the point. */
int32_t vertex_grid_nearest_from(const vertex_grid *g, const float point[3], int32_t guess,
                                 float *distance_squared);
/* For voxels near the vertices (with a point closer than `reach_m` to one): stores the list of the vertices
 * that can be nearest inside. A search there takes a few dozen nanoseconds; elsewhere, if reach_m is at least
 * the grid's radius, no search is needed. Voxels have sides of voxel_m for SMPL's 6890 vertices, smaller for
 * more. With 2 cm, lists take about 5 MB and 30 ms of a core for a person; with 4 cm a third of that, and
 * searches take a fifth longer. */
sherf_status vertex_grid_refine(context *c, vertex_grid *g, float reach_m, float voxel_m);
/* Those voxels as bits: bit x % 32 of bit[(z * cells[1] + y) * words + x / 32]; the outermost voxels are 0.
 */
typedef struct {
    int cells[3], words;
    float min[3], cell_m;
    uint32_t *bit;
} vertex_shell;
const vertex_shell *vertex_grid_shell(const vertex_grid *g); /* NULL before vertex_grid_refine */
/* The body's canonical vertices have one grid, made with the body. */
const vertex_grid *body_canonical_grid(const body_model *body);

#ifdef __cplusplus
}
#endif
#endif
