/* Rays, and the samples near the body, found as in rays.c and points.c, in the same order. Candidates are
 * found by the grid's cells, counted for each ray, summed and written. Then one thread for each candidate
 * searches its nearest vertex, the kept ones are summed again, and one thread for each maps it to canonical
 * space and to the observation's picture. Compiled without fused operations: the same points as on the CPU.
 */
#include "body/deform_point.h"
#include "sampling/cuda/cells.h"

namespace cuda_backend {

enum { WORD = 32, RANGE_PARTS = 64 };

sherf_status points_room(context *c, arena *a, int64_t rays, int samples_max, int64_t max,
                         placed_points *out) {
    *out = {};
    out->rays = rays;
    out->words = (samples_max + WORD - 1) / WORD;
    out->max = max;
    const int64_t longest = rays > max ? rays : max;
    out->direction = room<float>(c, a, 3 * rays);
    out->near = room<float>(c, a, rays);
    out->far = room<float>(c, a, rays);
    out->at_box = room<uint8_t>(c, a, rays);
    out->bits = room<uint32_t>(c, a, rays * out->words);
    out->first = room<int32_t>(c, a, rays + 1);
    out->candidate_ray = room<int32_t>(c, a, max);
    out->candidate_sample = room<int32_t>(c, a, max);
    out->candidate_nearest = room<int32_t>(c, a, max);
    out->slot = room<int32_t>(c, a, max + 1);
    out->ray = room<int32_t>(c, a, max);
    out->sample = room<int32_t>(c, a, max);
    out->nearest = room<int32_t>(c, a, max);
    out->canonical = room<float>(c, a, 3 * max);
    out->direction_canonical = room<float>(c, a, 3 * max);
    out->observed_px = room<float>(c, a, 2 * max);
    out->sums = room<int32_t>(c, a, scan_sums(longest));
    out->head = room<frame_head>(c, a, 1);
    out->range = room<float>(c, a, 3 * RANGE_PARTS);
    out->many = room<int32_t>(c, a, RANGE_PARTS);
    const void *all[] = {out->direction,
                         out->near,
                         out->far,
                         out->at_box,
                         out->bits,
                         out->first,
                         out->candidate_ray,
                         out->candidate_sample,
                         out->candidate_nearest,
                         out->slot,
                         out->ray,
                         out->sample,
                         out->nearest,
                         out->canonical,
                         out->direction_canonical,
                         out->observed_px,
                         out->range,
                         out->many,
                         out->sums,
                         out->head};
    for (const void *one : all)
        if (!one) return SHERF_NO_MEMORY;
    return SHERF_OK;
}

static __device__ void sample_place(const placed_points &p, const placed_pose &pose, int64_t ray, int i,
                                    float out[3]) {
    const float near = p.near[ray], t = near + (p.far[ray] - near) * ray_fraction(i, p.head->samples);
    ray_point_smpl(p.origin, p.direction + 3 * ray, t, pose.R, pose.Th, out);
}

/* ---- rays ---- */
static __device__ float direction_length(const placed_points &p, int64_t n) {
    const float *v = p.direction + 3 * n;
    return sqrtf(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

/* For each part of the rays: the smallest and largest depth, and the longest path through the box. */
__global__ static void range_kernel(placed_points p) {
    __shared__ float low[BLOCK], high[BLOCK], way[BLOCK];
    const int t = (int)threadIdx.x;
    float depth_min = INFINITY, depth_max = -INFINITY, longest = 0;
    for (int64_t i = (int64_t)blockIdx.x * BLOCK + t; i < p.rays; i += (int64_t)gridDim.x * BLOCK) {
        const float near = p.near[i], far = p.far[i];
        depth_min = fminf(depth_min, fminf(near, far));
        depth_max = fmaxf(depth_max, fmaxf(near, far));
        if (p.at_box[i]) longest = fmaxf(longest, (far - near) * direction_length(p, i));
    }
    low[t] = depth_min, high[t] = depth_max, way[t] = longest;
    for (int step = BLOCK / 2; step > 0; step /= 2) {
        __syncthreads();
        if (t >= step) continue;
        low[t] = fminf(low[t], low[t + step]);
        high[t] = fmaxf(high[t], high[t + step]);
        way[t] = fmaxf(way[t], way[t + step]);
    }
    if (t != 0) return;
    float *to = p.range + 3 * blockIdx.x;
    to[0] = low[0], to[1] = high[0], to[2] = way[0];
}

/* As rays_even_steps: how many depths, and the longest step, or 0 where nothing changes. */
static __device__ void even_steps(const sample_request &request, frame_head *head) {
    const float longest = head->longest_m, step_m = request.step_max_m;
    head->samples = request.samples;
    head->step_m = 0;
    if (!request.max || request.samples < 2 || !(longest > step_m * (float)(request.samples - 1))) return;
    const float needed = ceilf(longest / step_m) + 1;
    const int count = needed < (float)request.max     ? (int)needed
                      : request.max > request.samples ? request.max
                                                      : request.samples;
    head->samples = count;
    head->step_m = fmaxf(step_m, longest / (float)(count - 1));
}

static void make_rays(const ray_optics &optics, const sample_request &request, const placed_points &p) {
    each(p.rays, [=] __device__(int64_t n) {
        float direction[3], near = 0, far = 1;
        ray_direction(&optics, (int)(n % p.width), (int)(n / p.width), direction);
        bool hits = p.head->finite && cross_box(p.origin, direction, p.head->min, p.head->max, &near, &far);
        if (request.repair && p.head->finite) /* as rays_repair */
            hits |= cross_slabs(p.origin, direction, p.head->min, p.head->max, &near, &far);
        for (int k = 0; k < 3; k++) p.direction[3 * n + k] = direction[k];
        p.near[n] = near;
        p.far[n] = far;
        p.at_box[n] = hits;
    });
    launch(range_kernel, dim3(RANGE_PARTS), dim3(BLOCK), p);
    each(1, [=] __device__(int64_t) {
        float depth_min = INFINITY, depth_max = -INFINITY, longest = 0;
        for (int i = 0; i < RANGE_PARTS; i++) {
            depth_min = fminf(depth_min, p.range[3 * i]);
            depth_max = fmaxf(depth_max, p.range[3 * i + 1]);
            longest = fmaxf(longest, p.range[3 * i + 2]);
        }
        p.head->depth_min = depth_min;
        p.head->depth_max = depth_max;
        p.head->longest_m = longest;
        even_steps(request, p.head);
    });
    each(p.rays, [=] __device__(int64_t n) {
        const float step = p.head->step_m;
        if (step == 0 || !p.at_box[n]) return;
        const float own = (p.far[n] - p.near[n]) / (float)(request.samples - 1);
        p.far[n] = p.near[n] + fminf(own, step / direction_length(p, n)) * (float)(p.head->samples - 1);
    });
}

/* ---- candidates: one warp a ray, its samples side by side ---- */
__global__ static void many_kernel(placed_points p) {
    __shared__ int64_t part[BLOCK];
    const int t = (int)threadIdx.x;
    int64_t sum = 0;
    for (int64_t i = (int64_t)blockIdx.x * BLOCK + t; i < p.rays; i += (int64_t)gridDim.x * BLOCK)
        sum += p.first[i];
    part[t] = sum;
    for (int step = BLOCK / 2; step > 0; step /= 2) {
        __syncthreads();
        if (t < step) part[t] += part[t + step];
    }
    if (t == 0) p.many[blockIdx.x] = part[0] < INT32_MAX / 3 ? (int32_t)part[0] : INT32_MAX / 3;
}

static void find_candidates(const placed_pose &pose, const placed_points &p) {
    each_row(p.rays, [=] __device__(int64_t n, int lane) {
        int count = 0;
        for (int w = 0; p.at_box[n] && WORD * w < p.head->samples;
             w++) { /* the condition is the same for the whole warp */
            const int i = WORD * w + lane;
            float x[3];
            bool candidate = false;
            if (i < p.head->samples) {
                sample_place(p, pose, n, i, x);
                candidate = cell_is_near(pose.cells, x);
            }
            const uint32_t bits = warp_ballot(candidate);
            count += bits_set(bits);
            if (lane == 0) p.bits[n * p.words + w] = bits;
        }
        if (lane == 0) p.first[n] = count;
    });
    /* too many for an int32: none are taken, and the frame fails */
    launch(many_kernel, dim3(RANGE_PARTS), dim3(BLOCK), p);
    each(1, [=] __device__(int64_t) {
        int64_t sum = 0;
        for (int i = 0; i < RANGE_PARTS; i++) sum += p.many[i];
        p.head->too_many = sum >= INT32_MAX / 3;
    });
    each(p.rays, [=] __device__(int64_t n) {
        if (p.head->too_many) p.first[n] = 0;
    });
    scan(p.rays, nullptr, p.first, p.sums);
    each_row(p.rays, [=] __device__(int64_t n, int lane) {
        int64_t at = p.first[n];
        if (n == 0 && lane == 0) p.head->candidates = p.first[p.rays];
        if (p.first[n + 1] == at) return;
        for (int w = 0; WORD * w < p.head->samples; w++) {
            const uint32_t bits = p.bits[n * p.words + w], before = bits & (((uint32_t)1 << lane) - 1);
            const int64_t to = at + bits_set(before);
            if (bits >> lane & 1 && to < p.max) {
                p.candidate_ray[to] = (int32_t)n;
                p.candidate_sample[to] = WORD * w + lane;
            }
            at += bits_set(bits);
        }
    });
}

/* ---- the kept ones ---- */
static __device__ void to_canonical(const placed_body &b, const placed_pose &pose, int32_t nearest,
                                    float x[3], float *direction) {
    const vertex_mapping g = {pose.vertices,     pose.to_canonical, pose.blend_m,
                              b.neighbour_first, b.neighbour,       false};
    float blended[12], y[3];
    const float *map = g.maps + 12 * (int64_t)nearest;
    if (g.blend_m != 0) {
        map_blend(&g, (size_t)nearest, x, blended);
        map = blended;
    }
    map_rotate(map, x, y);
    for (int k = 0; k < 3; k++) x[k] = y[k] + map[4 * k + 3];
    if (!direction) return;
    map_rotate(map, direction, y);
    for (int k = 0; k < 3; k++) direction[k] = y[k];
}

static void keep_near(const placed_body &b, const placed_pose &pose, const occupancy_grid &empty,
                      const placed_points &p) {
    const float limit_d2 = nextafterf(BODY_SHELL_M * BODY_SHELL_M, 0); /* strictly closer */
    each_counted(&p.head->candidates, p.max, [=] __device__(int64_t i) {
        float x[3];
        sample_place(p, pose, p.candidate_ray[i], p.candidate_sample[i], x);
        int32_t nearest = nearest_vertex(pose.cells, x, limit_d2, -1);
        if (nearest >= 0 && empty.bit) {
            to_canonical(b, pose, nearest, x, nullptr);
            if (cell_is_empty(&empty, x)) nearest = -1;
        }
        p.candidate_nearest[i] = nearest;
        p.slot[i] = nearest >= 0;
    });
    scan(p.max, &p.head->candidates, p.slot, p.sums);
    /* first[]: of candidates, now of points */
    each(p.rays + 1, [=] __device__(int64_t n) {
        const int64_t end = p.head->candidates < p.max ? p.head->candidates : p.max;
        p.first[n] = p.slot[p.first[n] < end ? p.first[n] : end];
        if (n == p.rays) p.head->points = p.first[n];
    });
}

static void map_points(const placed_body &b, const placed_pose &pose, const placed_observation &seen,
                       const placed_points &p) {
    each_counted(&p.head->candidates, p.max, [=] __device__(int64_t i) {
        const int32_t nearest = p.candidate_nearest[i], n = p.candidate_ray[i];
        const int64_t at = p.slot[i];
        if (nearest < 0) return;
        float x[3], direction[3];
        const float *d = p.direction + 3 * (int64_t)n, *R = pose.R;
        for (int k = 0; k < 3; k++) direction[k] = d[0] * R[k] + d[1] * R[3 + k] + d[2] * R[6 + k];
        sample_place(p, pose, n, p.candidate_sample[i], x);
        to_canonical(b, pose, nearest, x, direction);
        p.ray[at] = n;
        p.sample[at] = p.candidate_sample[i];
        p.nearest[at] = nearest;
        for (int k = 0; k < 3; k++) {
            p.canonical[3 * at + k] = x[k];
            p.direction_canonical[3 * at + k] = direction[k];
        }
        const vertex_mapping g = {b.canonical_vertices, seen.maps,   seen.blend_m,
                                  b.neighbour_first,    b.neighbour, seen.apart};
        int32_t own = nearest_vertex(b.canonical, x, INFINITY, nearest);
        if (own < 0) own = 0;
        float blended[12], world[3];
        const float *map = g.maps + 12 * (int64_t)own;
        if (g.blend_m != 0) {
            map_blend(&g, (size_t)own, x, blended);
            map = blended;
        }
        map_rotate(map, x, world);
        for (int k = 0; k < 3; k++) world[k] += map[4 * k + 3];
        project_point(seen.camera.K, seen.camera.R, seen.camera.T, world, p.observed_px + 2 * at);
    });
}

void points_fill(const placed_body *b, const placed_pose *pose, const ray_optics *optics, int width,
                 const sample_request *request, const placed_observation *observed,
                 const occupancy_grid *empty, placed_points *p) {
    const occupancy_grid none = {};
    p->width = width;
    memcpy(p->origin, optics->origin, sizeof p->origin);
    make_rays(*optics, *request, *p);
    find_candidates(*pose, *p);
    keep_near(*b, *pose, empty ? *empty : none, *p);
    map_points(*b, *pose, *observed, *p);
}

} // namespace cuda_backend
