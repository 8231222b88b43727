/* Shared by the files of frames on the GPU. Everything is plain pointers into the GPU's memory; kernels take
 * them by value. Only the GPU knows the number of points: kernels over points are launched for as many as
 * there is room for and read the number. */
#ifndef SHERF_CUDA_FRAME_H
#define SHERF_CUDA_FRAME_H

#include "body/pose_vertex.h"
#include "sampling/cuda/warp.h"
#include "scene/ray.h"
#include "sampling/sampling.h"

namespace cuda_backend {

/* ---- helpers (scan.cu) ---- */
template <typename F> __global__ void each_counted_kernel(const int32_t *n, int64_t max, F f) {
    const int64_t step = (int64_t)gridDim.x * blockDim.x, end = *n < max ? *n : max;
    for (int64_t i = (int64_t)blockIdx.x * blockDim.x + threadIdx.x; i < end; i += step) f(i);
}

/* f(i) for 0 <= i < *n, where *n may be more than `max`. */
template <typename F> void each_counted(const int32_t *n, int64_t max, F f) {
    const int64_t blocks = divided_up(max, BLOCK);
    if (max > 0)
        launch(each_counted_kernel<F>, dim3((unsigned)(blocks < 8192 ? blocks : 8192)), dim3(BLOCK), n, max,
               f);
}

/* value[i] = sum of the values before it for 0 <= i <= n: room for n + 1. If counted is not NULL, only for i
 * <= *counted, if that is less. sums: room for scan_sums(n). */
void scan(int64_t n, const int32_t *counted, int32_t *value, int32_t *sums);
enum { SCAN_RUN = 8, SCAN_BLOCK = SCAN_RUN * BLOCK };
inline int64_t scan_sums(int64_t n) {
    return divided_up(n, SCAN_BLOCK) + 1;
}

/* Room for `count` values in an arena of the GPU's; NULL: out of memory. */
template <typename T> T *room(context *c, arena *a, int64_t count) {
    return (T *)arena_alloc(c, a, (size_t)(count > 0 ? count : 1), sizeof(T));
}

/* ---- the body (posing.cu) ---- */
/* Vertices by the cells of a uniform grid, for the exact nearest one (cells.h). */
struct cells_head {
    float min[3], max[3], cell_m, per_m, slack_m;
    int cells[3], count;
};
struct vertex_cells {
    cells_head *head;
    int32_t *start;   /* CELLS_MAX + 1 */
    float *x, *y, *z; /* by cell */
    int32_t *index;   /* their vertices */
    uint8_t *near;    /* by cell: whether any part may be within `reach` of a vertex; or NULL */
    const float *vertex;
};
constexpr int64_t CELLS_MAX = 1 << 19;

struct placed_body {
    int vertices, neighbours;
    float *v_template, *shapedirs, *posedirs, *weights, *pose_volume; /* posedirs, pose_volume: may be NULL */
    double *canonical_blend, *joint_template;
    float *big_offset, *canonical_vertices;
    int32_t *neighbour_first, *neighbour;
    vertex_cells canonical;
};

/* A frame's own numbers. */
struct frame_head {
    float min[3], max[3];       /* the box that clips rays, in the world */
    float depth_min, depth_max; /* of all rays, in the box */
    float longest_m, step_m;    /* the longest path of a ray through the box; even step length, or 0 */
    int32_t finite;             /* whether the vertices are finite and plausible */
    int32_t samples;            /* per ray */
    int32_t too_many;           /* more candidates than any room */
    int32_t candidates, points;
};

struct placed_pose {
    float *pose_offset, *shape_offset, *vertices, *to_canonical; /* by vertex; to_canonical 12 */
    float R[9], Th[3], blend_m;
    vertex_cells cells;
};

sherf_status body_place(context *c, arena *a, const tensor_memory *memory, const body_model *body,
                        placed_body *out);
/* Allocates the cells of `vertices`. */
sherf_status cells_room(context *c, arena *a, int vertices, bool near, vertex_cells *out);
/* Sorts them; scratch: scan_sums(CELLS_MAX) + CELLS_MAX. */
void cells_fill(context *c, const tensor_memory *memory, int vertices, vertex_cells *g, int32_t *scratch);
sherf_status pose_room(context *c, arena *a, const placed_body *b, placed_pose *out);
/* Computes vertices, maps, cells and box. */
void pose_fill(context *c, const tensor_memory *memory, const placed_body *b, const posed_body *posed,
               placed_pose *out, frame_head *head, int32_t *scratch);

/* ---- points (points.cu) ---- */
struct placed_camera { /* the observation's */
    float K[9], R[9], T[3];
};
/* Where canonical points are read: maps V x 12, from_canonical or read_from of its body (apart), with its
 * blending. */
struct placed_observation {
    const float *maps;
    float blend_m;
    bool apart;
    placed_camera camera;
};

struct placed_points {
    int64_t rays, max; /* room for candidates and points */
    int width, words;  /* of `bits` a ray: for the maximum of samples */
    frame_head *head;
    float origin[3];
    float *direction, *near, *far; /* N x 3, N, N */
    uint8_t *at_box;
    uint32_t *bits;                                                       /* N x words: the candidates */
    int32_t *first;                                                       /* N + 1: candidates, then points */
    int32_t *candidate_ray, *candidate_sample, *candidate_nearest, *slot; /* slot: max + 1 */
    int32_t *ray, *sample, *nearest;
    float *canonical, *direction_canonical, *observed_px;
    int32_t *sums; /* for scans */
    float *range;  /* RANGE_PARTS x 3 */
    int32_t *many; /* RANGE_PARTS */
};
/* A ray's number of depths: see gpu_frame_options. */
struct sample_request {
    int samples, max;
    float step_max_m;
    bool repair;
};
sherf_status points_room(context *c, arena *a, int64_t rays, int samples_max, int64_t max,
                         placed_points *out);
void points_fill(const placed_body *b, const placed_pose *pose, const ray_optics *optics, int width,
                 const sample_request *request, const placed_observation *observed,
                 const occupancy_grid *empty, placed_points *p);

} // namespace cuda_backend
#endif
