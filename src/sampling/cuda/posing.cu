/* The body on the GPU: its constants, a pose's vertices and maps (pose_vertex.h has the formulas, in double
 * as on the CPU), the cells of its vertices. Compiled without fused operations: the same bits as on the CPU.
 */
#include <float.h>

#include "sampling/cuda/cells.h"

namespace cuda_backend {

/* `count` values of the host's, placed; NULL: out of memory. */
template <typename T>
static T *placed(context *c, arena *a, const tensor_memory *memory, const T *from, int64_t count) {
    T *to = room<T>(c, a, count);
    if (to && count > 0 && memory->upload(c, to, from, (size_t)count * sizeof(T)) != SHERF_OK) return nullptr;
    return to;
}

sherf_status cells_room(context *c, arena *a, int vertices, bool near, vertex_cells *out) {
    *out = {};
    out->head = room<cells_head>(c, a, 1);
    out->start = room<int32_t>(c, a, CELLS_MAX + 1);
    out->x = room<float>(c, a, vertices);
    out->y = room<float>(c, a, vertices);
    out->z = room<float>(c, a, vertices);
    out->index = room<int32_t>(c, a, vertices);
    if (near) out->near = room<uint8_t>(c, a, CELLS_MAX);
    return out->head && out->start && out->x && out->y && out->z && out->index && (!near || out->near)
               ? SHERF_OK
               : SHERF_NO_MEMORY;
}

/* ---- the cells ---- */
struct body_bounds { /* what the thread has seen so far */
    float min[3], max[3], min_world[3], max_world[3];
    int finite;
};

static __device__ void bounds_join(body_bounds &a, const body_bounds &b) {
    for (int k = 0; k < 3; k++) {
        a.min[k] = fminf(a.min[k], b.min[k]), a.max[k] = fmaxf(a.max[k], b.max[k]);
        a.min_world[k] = fminf(a.min_world[k], b.min_world[k]);
        a.max_world[k] = fmaxf(a.max_world[k], b.max_world[k]);
    }
    a.finite &= b.finite;
}

/* Cells of about half of BODY_SHELL_M, so that BODY_SHELL_M covers two cells, with three more around the
 * vertices, so that all points within BODY_SHELL_M are in the grid. Cells are larger if there would be too
 * many. */
static __device__ void shape_cells(const body_bounds &b, cells_head *h) {
    float cell = BODY_SHELL_M * 0.502f, scale = 0;
    int finite = b.finite;
    for (int k = 0; k < 3; k++) scale = fmaxf(scale, fmaxf(fabsf(b.min[k]), fabsf(b.max[k])));
    for (;; cell *= 1.1f) {
        float count = 1;
        for (int k = 0; k < 3; k++) {
            const float n = finite ? floorf((b.max[k] - b.min[k]) / cell) + 7 : 1;
            h->cells[k] = n < 1e6f ? (int)n : 1000000;
            count *= n;
        }
        if (count <= (float)CELLS_MAX) break;
    }
    for (int k = 0; k < 3; k++) {
        h->min[k] = finite ? b.min[k] - 3 * cell : 0;
        h->max[k] = b.max[k];
    }
    h->cell_m = cell;
    h->per_m = 1 / cell;
    h->slack_m = finite ? 2e-6f * (scale + 6 * cell) : 0;
    h->count = h->cells[0] * h->cells[1] * h->cells[2];
}

/* One block. R, Th by value; frame may be NULL. */
struct rigid {
    float R[9], Th[3];
};
__global__ static void bounds_kernel(int vertices, const float *vertex, rigid to, cells_head *head,
                                     frame_head *frame) {
    __shared__ body_bounds part[BLOCK];
    body_bounds b;
    for (int k = 0; k < 3; k++) {
        b.min[k] = b.min_world[k] = INFINITY;
        b.max[k] = b.max_world[k] = -INFINITY;
    }
    b.finite = 1;
    for (int v = (int)threadIdx.x; v < vertices; v += BLOCK) {
        const float *x = vertex + 3 * (int64_t)v;
        for (int k = 0; k < 3; k++) {
            b.finite &= fabsf(x[k]) < 1e6f;
            b.min[k] = x[k] < b.min[k] ? x[k] : b.min[k];
            b.max[k] = x[k] > b.max[k] ? x[k] : b.max[k];
            const float y = to.R[3 * k] * x[0] + to.R[3 * k + 1] * x[1] + to.R[3 * k + 2] * x[2] + to.Th[k];
            if (y < b.min_world[k]) b.min_world[k] = y;
            if (y > b.max_world[k]) b.max_world[k] = y;
        }
    }
    part[threadIdx.x] = b;
    for (int step = BLOCK / 2; step > 0; step /= 2) {
        __syncthreads();
        if ((int)threadIdx.x < step) bounds_join(part[threadIdx.x], part[threadIdx.x + step]);
    }
    if (threadIdx.x != 0) return;
    b = part[0];
    shape_cells(b, head);
    if (!frame) return;
    frame->finite = b.finite;
    for (int k = 0; k < 3; k++) { /* as body_world_box, and then rays_create */
        frame->min[k] = b.min_world[k] - BODY_SHELL_M - BOX_SPARE_M;
        frame->max[k] = b.max_world[k] + BODY_SHELL_M + BOX_SPARE_M;
    }
}

static __device__ int64_t cell_at(const cells_head &h, const float *x) {
    return cell_number(h, cell_of(h, 0, x[0]), cell_of(h, 1, x[1]), cell_of(h, 2, x[2]));
}

void cells_fill(context *c, const tensor_memory *memory, int vertices, vertex_cells *out, int32_t *scratch) {
    const vertex_cells g = *out;
    int32_t *filled = scratch, *sums = scratch + CELLS_MAX;
    memory->clear(c, g.start, (CELLS_MAX + 1) * sizeof *g.start);
    memory->clear(c, filled, CELLS_MAX * sizeof *filled);
    each(vertices, [=] __device__(int64_t v) { atomicAdd(g.start + cell_at(*g.head, g.vertex + 3 * v), 1); });
    scan(CELLS_MAX, &g.head->count, g.start, sums);
    /* The order within a cell is arbitrary; no search depends on it. */
    each(vertices, [=] __device__(int64_t v) {
        const float *x = g.vertex + 3 * v;
        const int64_t cell = cell_at(*g.head, x);
        const int32_t at = g.start[cell] + atomicAdd(filled + cell, 1);
        g.x[at] = x[0], g.y[at] = x[1], g.z[at] = x[2];
        g.index[at] = (int32_t)v;
    });
    if (!g.near) return;
    memory->clear(c, g.near, CELLS_MAX);
    enum { REACH = 2, SIDE = 2 * REACH + 1 };
    each((int64_t)vertices * SIDE * SIDE, [=] __device__(int64_t i) {
        const cells_head &h = *g.head;
        const float *x = g.vertex + 3 * (i / (SIDE * SIDE));
        const int dy = (int)(i % SIDE) - REACH, dz = (int)(i / SIDE % SIDE) - REACH;
        const int cx = cell_of(h, 0, x[0]), y = cell_of(h, 1, x[1]) + dy, z = cell_of(h, 2, x[2]) + dz;
        if (y < 0 || z < 0 || y >= h.cells[1] || z >= h.cells[2]) return;
        const int place[3] = {0, y, z};
        float away2 = 0;
        for (int k = 1; k < 3; k++) {
            const float low = h.min[k] + (float)place[k] * h.cell_m - h.slack_m;
            const float high = low + h.cell_m + 2 * h.slack_m;
            const float d = x[k] < low ? low - x[k] : x[k] > high ? x[k] - high : 0;
            away2 += d * d;
        }
        for (int at = cx - REACH; at <= cx + REACH; at++) {
            if (at < 0 || at >= h.cells[0]) continue;
            const float low = h.min[0] + (float)at * h.cell_m - h.slack_m;
            const float high = low + h.cell_m + 2 * h.slack_m;
            const float d = x[0] < low ? low - x[0] : x[0] > high ? x[0] - high : 0;
            if (away2 + d * d <= BODY_SHELL_M * BODY_SHELL_M * 1.0001f) g.near[cell_number(h, at, y, z)] = 1;
        }
    });
}

/* ---- the body ---- */
sherf_status body_place(context *c, arena *a, const tensor_memory *memory, const body_model *body,
                        placed_body *out) {
    const int64_t V = body->vertices;
    *out = {};
    out->vertices = body->vertices;
    out->v_template = placed(c, a, memory, body->v_template, 3 * V);
    out->shapedirs = placed(c, a, memory, body->shapedirs, 3 * V * BODY_SHAPES);
    out->weights = placed(c, a, memory, body->weights, V * BODY_JOINTS);
    out->canonical_blend = placed(c, a, memory, body->canonical_blend, 12 * V);
    out->joint_template = placed(c, a, memory, &body->joint_template[0][0], 3 * BODY_JOINTS);
    out->big_offset = placed(c, a, memory, body->canonical->pose_offset, 3 * V);
    out->canonical_vertices = placed(c, a, memory, body->canonical->vertices_smpl, 3 * V);
    out->neighbour_first = placed(c, a, memory, body->neighbour_first, V + 1);
    out->neighbour = placed(c, a, memory, body->neighbour, body->neighbour_first[V]);
    bool good = out->v_template && out->shapedirs && out->weights && out->canonical_blend &&
                out->joint_template && out->big_offset && out->canonical_vertices && out->neighbour_first &&
                out->neighbour;
    if (good && body->posedirs)
        good = (out->posedirs = placed(c, a, memory, body->posedirs, 3 * V * BODY_POSE_FEATURES)) != nullptr;
    if (good && body->pose_volume)
        good = (out->pose_volume = placed(c, a, memory, body->pose_volume, V * BODY_JOINTS)) != nullptr;
    if (!good || cells_room(c, a, body->vertices, false, &out->canonical) != SHERF_OK) return SHERF_NO_MEMORY;
    int32_t *scratch = room<int32_t>(c, a, CELLS_MAX + scan_sums(CELLS_MAX));
    if (!scratch) return SHERF_NO_MEMORY;
    out->canonical.vertex = out->canonical_vertices;
    launch(bounds_kernel, dim3(1), dim3(BLOCK), body->vertices, (const float *)out->canonical_vertices,
           rigid{}, out->canonical.head, (frame_head *)nullptr);
    cells_fill(c, memory, body->vertices, &out->canonical, scratch);
    return finished_work(c, "placing a body");
}

sherf_status pose_room(context *c, arena *a, const placed_body *b, placed_pose *out) {
    const int64_t V = b->vertices;
    *out = {};
    out->pose_offset = room<float>(c, a, 3 * V);
    out->shape_offset = room<float>(c, a, 3 * V);
    out->vertices = room<float>(c, a, 3 * V);
    out->to_canonical = room<float>(c, a, 12 * V);
    if (!out->pose_offset || !out->shape_offset || !out->vertices || !out->to_canonical)
        return SHERF_NO_MEMORY;
    return cells_room(c, a, b->vertices, true, &out->cells);
}

/* Each below the 4 KB that a launch takes as arguments. */
struct pose_features {
    double feature[BODY_POSE_FEATURES];
    float shape[BODY_SHAPES];
};
struct pose_transforms {
    double transform[BODY_JOINTS][12];
};

void pose_fill(context *c, const tensor_memory *memory, const placed_body *body, const posed_body *posed,
               placed_pose *out, frame_head *head, int32_t *scratch) {
    const placed_body b = *body;
    pose_features features;
    pose_transforms joints;
    rigid to;
    memcpy(features.feature, posed->joints->feature, sizeof features.feature);
    memcpy(features.shape, posed->joints->shape, sizeof features.shape);
    memcpy(joints.transform, posed->joints->transform, sizeof joints.transform);
    memcpy(to.R, posed->R, sizeof to.R);
    memcpy(to.Th, posed->Th, sizeof to.Th);
    memcpy(out->R, posed->R, sizeof out->R);
    memcpy(out->Th, posed->Th, sizeof out->Th);
    out->blend_m = posed->blend_m;
    out->cells.vertex = out->vertices;
    const placed_pose p = *out;
    const int64_t rows = 3 * (int64_t)b.vertices;
    each(rows, [=] __device__(int64_t i) {
        const int64_t v = i / 3;
        float offset = 0;
        for (int k = 0; b.posedirs && k < BODY_POSE_FEATURES; k++) {
            const float f = (float)features.feature[k];
            if (f != 0) offset += f * b.posedirs[k * rows + i];
        }
        if (b.pose_volume)
            offset = volume_kept(offset, (int)(i % 3), b.pose_volume + v * BODY_JOINTS, b.v_template + 3 * v,
                                 (const double(*)[3])b.joint_template, features.feature);
        p.pose_offset[i] = offset;
        p.shape_offset[i] = shape_offset_of(b.shapedirs + i * BODY_SHAPES, features.shape);
    });
    each(b.vertices, [=] __device__(int64_t v) {
        double A[12], A_inverse[12];
        const float *weights = b.weights + v * BODY_JOINTS, *pose = p.pose_offset + 3 * v,
                    *shape = p.shape_offset + 3 * v;
        blend_transforms(weights, joints.transform, A);
        pose_vertex(A, b.v_template + 3 * v, shape, pose, p.vertices + 3 * v);
        blend_inverse(weights, joints.transform, A, A_inverse);
        vertex_to_canonical(A_inverse, b.canonical_blend + 12 * v, b.big_offset + 3 * v, pose, shape,
                            p.to_canonical + 12 * v);
    });
    launch(bounds_kernel, dim3(1), dim3(BLOCK), b.vertices, (const float *)p.vertices, to, p.cells.head,
           head);
    cells_fill(c, memory, b.vertices, &out->cells, scratch);
}

} // namespace cuda_backend
