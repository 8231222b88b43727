/* The samples near the body, as points.c finds them, in the same order: candidates by the grid's cells,
 * counted a ray, summed up and written; then one thread a candidate searches its nearest vertex, the kept
 * ones are summed up again, and one thread each maps them to canonical space and to the observation's
 * picture. Compiled without fused operations: the same points as on the CPU. */
#include "body/deform_point.h"
#include "render/cuda/cells.h"

namespace cuda_backend {

enum { WORD = 32 };

sherf_status points_room(context *c, arena *a, int64_t rays, int samples, int64_t most, placed_points *out) {
    *out = {};
    out->rays = rays;
    out->samples = samples;
    out->words = (samples + WORD - 1) / WORD;
    out->most = most;
    const int64_t longest = rays > most ? rays : most;
    out->direction = room<float>(c, a, 3 * rays);
    out->near = room<float>(c, a, rays);
    out->far = room<float>(c, a, rays);
    out->at_box = room<uint8_t>(c, a, rays);
    out->bits = room<uint32_t>(c, a, rays * out->words);
    out->first = room<int32_t>(c, a, rays + 1);
    out->candidate_ray = room<int32_t>(c, a, most);
    out->candidate_sample = room<int32_t>(c, a, most);
    out->candidate_nearest = room<int32_t>(c, a, most);
    out->slot = room<int32_t>(c, a, most + 1);
    out->ray = room<int32_t>(c, a, most);
    out->sample = room<int32_t>(c, a, most);
    out->nearest = room<int32_t>(c, a, most);
    out->canonical = room<float>(c, a, 3 * most);
    out->direction_canonical = room<float>(c, a, 3 * most);
    out->observed_px = room<float>(c, a, 2 * most);
    out->sums = room<int32_t>(c, a, scan_sums(longest));
    out->head = room<frame_head>(c, a, 1);
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
                         out->sums,
                         out->head};
    for (const void *one : all)
        if (!one) return SHERF_NO_MEMORY;
    return SHERF_OK;
}

static __device__ void sample_place(const placed_points &p, const placed_pose &pose, int64_t ray, int i,
                                    float out[3]) {
    const float near = p.near[ray], t = near + (p.far[ray] - near) * ray_fraction(i, p.samples);
    ray_point_smpl(p.origin, p.direction + 3 * ray, t, pose.R, pose.Th, out);
}

/* ---- candidates: one warp a ray, its samples side by side ---- */
static void find_candidates(const placed_pose &pose, const ray_optics &optics, const placed_points &p) {
    each_row(p.rays, [=] __device__(int64_t n, int lane) {
        float direction[3], near = 0, far = 1;
        ray_direction(&optics, (int)(n % p.width), (int)(n / p.width), direction);
        const bool hits =
            cross_box(p.origin, direction, p.head->min, p.head->max, &near, &far) && p.head->finite;
        int count = 0;
        for (int w = 0; w < p.words; w++) {
            const int i = WORD * w + lane;
            bool candidate = false;
            if (hits && i < p.samples) {
                const float t = near + (far - near) * ray_fraction(i, p.samples);
                float x[3];
                ray_point_smpl(p.origin, direction, t, pose.R, pose.Th, x);
                candidate = cell_is_near(pose.cells, x);
            }
            const uint32_t bits = hits ? warp_ballot(candidate) : 0; /* the warp is of one mind */
            count += bits_set(bits);
            if (lane == 0) p.bits[n * p.words + w] = bits;
        }
        if (lane != 0) return;
        for (int k = 0; k < 3; k++) p.direction[3 * n + k] = direction[k];
        p.near[n] = hits ? near : 0;
        p.far[n] = hits ? far : 1;
        p.at_box[n] = hits;
        p.first[n] = count;
    });
    scan(p.rays, nullptr, p.first, p.sums);
    each_row(p.rays, [=] __device__(int64_t n, int lane) {
        int64_t at = p.first[n];
        if (n == 0 && lane == 0) p.head->candidates = p.first[p.rays];
        if (p.first[n + 1] == at) return;
        for (int w = 0; w < p.words; w++) {
            const uint32_t bits = p.bits[n * p.words + w], before = bits & (((uint32_t)1 << lane) - 1);
            const int64_t to = at + bits_set(before);
            if (bits >> lane & 1 && to < p.most) {
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
    const vertex_mapping g = {pose.vertices, pose.to_canonical, pose.blend_m, b.neighbour_first, b.neighbour};
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

static void keep_near(const placed_body &b, const placed_pose &pose, const empty_cells &empty,
                      const placed_points &p) {
    const float limit_d2 = nextafterf(near_m * near_m, 0); /* strictly closer */
    each_counted(&p.head->candidates, p.most, [=] __device__(int64_t i) {
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
    scan(p.most, &p.head->candidates, p.slot, p.sums);
    /* first[]: of candidates, now of points */
    each(p.rays + 1, [=] __device__(int64_t n) {
        const int64_t end = p.head->candidates < p.most ? p.head->candidates : p.most;
        p.first[n] = p.slot[p.first[n] < end ? p.first[n] : end];
        if (n == p.rays) p.head->points = p.first[n];
    });
}

struct observation_maps {
    const float *maps;
    float blend_m;
    placed_camera camera;
};

static void map_points(const placed_body &b, const placed_pose &pose, const observation_maps &seen,
                       const placed_points &p) {
    each_counted(&p.head->candidates, p.most, [=] __device__(int64_t i) {
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
        const vertex_mapping g = {b.canonical_vertices, seen.maps, seen.blend_m, b.neighbour_first,
                                  b.neighbour};
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
                 const float *observed_maps, float observed_blend_m, const placed_camera *observed_camera,
                 const empty_cells *empty, placed_points *p) {
    const empty_cells none = {};
    p->width = width;
    memcpy(p->origin, optics->origin, sizeof p->origin);
    find_candidates(*pose, *optics, *p);
    keep_near(*b, *pose, empty ? *empty : none, *p);
    map_points(*b, *pose, {observed_maps, observed_blend_m, *observed_camera}, *p);
}

} // namespace cuda_backend
