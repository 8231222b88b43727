/* Frames of an avatar on the GPU: pose, rays, points, the network in rounds of a few points for each ray,
 * compositing. The picture and a few numbers come back at the end; nothing is downloaded before. The room for
 * points is a guess: if it was too small, the numbers say so, and the frame is made again with more. */
#include <stdio.h>

#include "model/sherf/cuda/network.h"

using namespace cuda_backend;

struct gpu_avatar {
    arena *own, *frame; /* permanent memory, and memory that each frame takes anew */
    placed_body body;
    placed_observation observed;
    placed_network *network;
    int64_t max; /* points that there is room for */
    void *pinned;
    size_t pinned_bytes;
    occupancy_grid empty; /* its bits are the GPU's */
    const uint32_t *empty_from;
};

namespace cuda_backend {

constexpr float opaque = 1e-3f; /* transmittance at which the rest of a ray is dropped, as on the CPU */
enum { SIDE = 16, SIDE_RAYS = SIDE * SIDE };

/* A ray's progress from front to back. */
struct ray_ways {
    int32_t *at; /* the next point */
    float *transmittance, *color, *opacity, *depth;
};

/* Rays in blocks of 16 x 16 pixels, so that neighbours in a tile of points are close together. */
struct ray_ranks {
    int width, height, across;
    int64_t count;
    ray_ranks(int columns, int rows)
        : width(columns), height(rows), across((columns + SIDE - 1) / SIDE),
          count((int64_t)across * ((rows + SIDE - 1) / SIDE) * SIDE_RAYS) {}
    __device__ int64_t ray(int64_t rank) const { /* -1: beyond the picture */
        const int64_t block = rank / SIDE_RAYS;
        const int within = (int)(rank % SIDE_RAYS);
        const int x = (int)(block % across) * SIDE + within % SIDE,
                  y = (int)(block / across) * SIDE + within / SIDE;
        return x < width && y < height ? (int64_t)y * width + x : -1;
    }
};

struct frame_room {
    ray_ways way;
    int32_t *take, *list, *sums; /* by rank: points of this round; and they, rank by rank */
    float4 *result;              /* by point */
    float *picture;              /* N x 3, N, N */
    network_scratch scratch;
};

static sherf_status frame_room_make(context *c, arena *a, const placed_network *n, const placed_points *p,
                                    const ray_ranks &ranks, frame_room *f) {
    const int64_t N = p->rays;
    f->way.at = room<int32_t>(c, a, N);
    f->way.transmittance = room<float>(c, a, N);
    f->way.color = room<float>(c, a, 3 * N);
    f->way.opacity = room<float>(c, a, N);
    f->way.depth = room<float>(c, a, N);
    f->take = room<int32_t>(c, a, ranks.count + 1);
    f->sums = room<int32_t>(c, a, scan_sums(ranks.count));
    f->list = room<int32_t>(c, a, p->max);
    f->result = room<float4>(c, a, p->max);
    f->picture = room<float>(c, a, 5 * N);
    if (!f->way.at || !f->way.transmittance || !f->way.color || !f->way.opacity || !f->way.depth ||
        !f->take || !f->sums || !f->list || !f->result || !f->picture)
        return SHERF_NO_MEMORY;
    return network_room(c, a, n, p->max, &f->scratch);
}

/* ---- compositing ----
 * One thread for each ray, a few points at a time: a picture has a hundred times as many rays as the GPU has
 * warps, a ray has about six points, and a round at most four, which are 64 contiguous bytes. */
static void composite(const placed_points &p, const ray_ranks &ranks, const frame_room &f) {
    const ray_ways w = f.way;
    const int32_t *take = f.take;
    const float4 *result = f.result;
    each(ranks.count, [=] __device__(int64_t rank) {
        const int64_t n = ranks.ray(rank);
        const int32_t count = take[rank + 1] - take[rank];
        if (n < 0 || count == 0) return;
        const float *d = p.direction + 3 * n, near = p.near[n], far = p.far[n];
        const int samples = p.head->samples;
        const float step = samples > 1 ? (far - near) / (float)(samples - 1) : 0;
        const float delta = step * sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        float T = w.transmittance[n], opacity = w.opacity[n], depth = w.depth[n];
        float color[3] = {w.color[3 * n], w.color[3 * n + 1], w.color[3 * n + 2]};
        const int32_t begin = w.at[n];
        for (int32_t i = begin; i < begin + count; i++) {
            const float4 y = result[i];
            if (!(y.w > 0)) continue;
            const int sample = p.sample[i], last = samples - 1;
            const float alpha = 1.0f - expf(-y.w * (sample == last ? 1e10f : delta)), weight = alpha * T;
            color[0] += weight * y.x;
            color[1] += weight * y.y;
            color[2] += weight * y.z;
            opacity += weight;
            depth += weight * (sample == last ? far : near + step * (float)sample);
            T *= 1.0f - alpha + 1e-10f;
        }
        w.at[n] = begin + count;
        w.transmittance[n] = T;
        w.opacity[n] = opacity;
        w.depth[n] = depth;
        for (int k = 0; k < 3; k++) w.color[3 * n + k] = color[k];
    });
}

/* Runs the network on the next `chunk` points of each ray that still lets light through, and composites them.
 */
static void round_run(const placed_network *network, const placed_points &p, const ray_ranks &ranks,
                      const frame_room &f, int chunk, bool early_stop) {
    const ray_ways w = f.way;
    int32_t *take = f.take, *list = f.list;
    each(ranks.count, [=] __device__(int64_t rank) {
        const int64_t n = ranks.ray(rank);
        int32_t left = n < 0 ? 0 : p.first[n + 1] - w.at[n];
        if (n >= 0 && early_stop && w.transmittance[n] < opaque) left = 0;
        take[rank] = left < chunk ? left : chunk;
    });
    scan(ranks.count, nullptr, take, f.sums);
    each(ranks.count, [=] __device__(int64_t rank) {
        const int64_t n = ranks.ray(rank);
        for (int32_t i = take[rank]; i < take[rank + 1]; i++) list[i] = w.at[n] + (i - take[rank]);
    });
    const int64_t all = chunk < p.max / p.rays ? chunk * p.rays : p.max;
    const network_points points = {
        p.canonical, p.direction_canonical, p.observed_px, list, take + ranks.count, all, f.result};
    network_run(network, &points, &f.scratch);
    composite(p, ranks, f);
}

static void rays_start(const placed_points &p, const ray_ways &w) {
    each(p.rays, [=] __device__(int64_t n) {
        w.at[n] = p.first[n];
        w.transmittance[n] = 1;
        w.opacity[n] = w.depth[n] = 0;
        for (int k = 0; k < 3; k++) w.color[3 * n + k] = 0;
    });
}

struct background {
    float color[3];
};

static void picture_write(const placed_points &p, const frame_room &f, background behind) {
    const ray_ways w = f.way;
    const int64_t N = p.rays;
    const frame_head *head = p.head;
    float *picture = f.picture;
    each(N, [=] __device__(int64_t n) {
        const float opacity = w.opacity[n];
        for (int k = 0; k < 3; k++)
            picture[3 * n + k] = w.color[3 * n + k] + (1.0f - opacity) * behind.color[k];
        picture[3 * N + n] = opacity;
        const float depth = opacity > 0 ? w.depth[n] / opacity : head->depth_max;
        picture[4 * N + n] = fminf(fmaxf(depth, head->depth_min), head->depth_max);
    });
}

/* ---- an avatar ---- */
static void avatar_release(gpu_avatar *a) {
    if (!a) return;
    network_free(a->network);
    arena_free(a->own);
    arena_free(a->frame);
    pinned_give(a->pinned);
    mem_free(a);
}

static sherf_status avatar_place(context *c, const body_model *body, const posed_body *observed,
                                 const sherf_camera *observed_camera, const radiance_parts *network,
                                 bool bf16, gpu_avatar **out) {
    *out = nullptr;
    sherf_status status = SHERF_NO_MEMORY;
    gpu_avatar *a = (gpu_avatar *)mem_zero(c, 1, sizeof *a);
    if (!a) return SHERF_NO_MEMORY;
    a->own = arena_create_from(c, &device_memory.source);
    a->frame = arena_create_from(c, &device_memory.source);
    const int64_t floats = 12 * (int64_t)body->vertices;
    const float *from = observed->read_from ? observed->read_from : observed->from_canonical;
    if (a->own && a->frame) status = body_place(c, a->own, &device_memory, body, &a->body);
    float *maps = status ? nullptr : room<float>(c, a->own, floats);
    if (!status) status = maps ? SHERF_OK : SHERF_NO_MEMORY;
    if (!status) status = device_memory.upload(c, maps, from, (size_t)floats * sizeof *maps);
    if (!status) status = network_place(c, a->own, &device_memory, network, bf16, &a->network);
    if (status) {
        avatar_release(a);
        return status;
    }
    a->observed = {maps, observed->blend_m, observed->read_from != nullptr, {}};
    memcpy(a->observed.camera.K, observed_camera->K, sizeof a->observed.camera.K);
    memcpy(a->observed.camera.R, observed_camera->R, sizeof a->observed.camera.R);
    memcpy(a->observed.camera.T, observed_camera->T_m, sizeof a->observed.camera.T);
    *out = a;
    return SHERF_OK;
}

static bool avatar_in_bf16(const gpu_avatar *a) {
    return network_in_bf16(a->network);
}

static size_t avatar_bytes(const gpu_avatar *a) {
    return arena_peak(a->own) + arena_peak(a->frame);
}

static sherf_status place_empty(context *c, gpu_avatar *a, const occupancy_grid *empty) {
    if (!empty || !empty->bit || empty->bit == a->empty_from) return SHERF_OK;
    const size_t words = (size_t)empty->words * (size_t)empty->cells[1] * (size_t)empty->cells[2];
    uint32_t *bits = room<uint32_t>(c, a->own, (int64_t)words);
    sherf_status status =
        bits ? device_memory.upload(c, bits, empty->bit, words * sizeof *bits) : SHERF_NO_MEMORY;
    if (status) return status;
    a->empty = *empty;
    a->empty.bit = bits;
    a->empty_from = empty->bit;
    return SHERF_OK;
}

/* Computes pose and points of a frame, in the frame's arena. */
static sherf_status points_make(context *c, gpu_avatar *a, const posed_body *posed,
                                const sherf_camera *camera, const gpu_frame_options *o, placed_points *p) {
    ray_optics optics;
    placed_pose pose;
    const int64_t rays = (int64_t)camera->width_px * camera->height_px;
    const sample_request request = {o->samples, o->samples_max, o->step_max_m, o->repair};
    const int samples_max = o->samples_max > o->samples ? o->samples_max : o->samples;
    if (a->max < 4 * rays) a->max = 4 * rays;
    if (a->max < 4096) a->max = 4096;
    arena_reset(a->frame);
    sherf_status status = place_empty(c, a, o->empty);
    if (!status) status = pose_room(c, a->frame, &a->body, &pose);
    if (!status) status = points_room(c, a->frame, rays, samples_max, a->max, p);
    if (status) return status;
    int32_t *scratch = room<int32_t>(c, a->frame, CELLS_MAX + scan_sums(CELLS_MAX));
    if (!scratch) return SHERF_NO_MEMORY;
    ray_optics_of(camera, &optics);
    pose_fill(c, &device_memory, &a->body, posed, &pose, p->head, scratch);
    points_fill(&a->body, &pose, &optics, camera->width_px, &request, &a->observed,
                o->empty && o->empty->bit ? &a->empty : nullptr, p);
    return SHERF_OK;
}

/* Checks the frame's numbers: SHERF_OK with *again if there was too little room. */
static sherf_status head_judge(context *c, gpu_avatar *a, const frame_head *head, bool *again) {
    *again = head->candidates > a->max;
    if (*again) a->max = (int64_t)head->candidates * 5 / 4;
    if (head->too_many)
        return failure(c, SHERF_BAD_ARGUMENT, "points: samples near the body are too many for one frame");
    if (head->finite) return SHERF_OK;
    return failure(c, SHERF_BAD_ARGUMENT, "pose: shapes or pose put a vertex beyond 1000 km");
}

static sherf_status pinned_room(context *c, gpu_avatar *a, size_t bytes) {
    if (a->pinned_bytes >= bytes) return SHERF_OK;
    pinned_give(a->pinned);
    a->pinned_bytes = 0;
    a->pinned = pinned_take(c, bytes);
    if (!a->pinned) return SHERF_NO_MEMORY;
    a->pinned_bytes = bytes;
    return SHERF_OK;
}

struct unpacking {
    const float *from;
    float *color, *opacity, *depth;
    int64_t pixels;
};

static void unpack(void *arg, int64_t begin, int64_t end, int thread) {
    const unpacking *u = (const unpacking *)arg;
    const size_t bytes = (size_t)(end - begin) * sizeof(float);
    memcpy(u->color + 3 * begin, u->from + 3 * begin, 3 * bytes);
    memcpy(u->opacity + begin, u->from + 3 * u->pixels + begin, bytes);
    memcpy(u->depth + begin, u->from + 4 * u->pixels + begin, bytes);
}

/* Launches one frame, then waits for its picture. */
static sherf_status frame_try(context *c, gpu_avatar *a, const posed_body *posed, const sherf_camera *camera,
                              const gpu_frame_options *o, frame_head *head) {
    placed_points p;
    frame_room f;
    const ray_ranks ranks(camera->width_px, camera->height_px);
    sherf_status status = points_make(c, a, posed, camera, o, &p);
    if (!status) status = frame_room_make(c, a->frame, a->network, &p, ranks, &f);
    if (status) return status;
    rays_start(p, f.way);
    /* most rays end within the first rounds; the last one takes the rest */
    static const int chunks[] = {4, 4, 8};
    for (int i = 0; o->early_stop && i < (int)COUNT_OF(chunks); i++)
        round_run(a->network, p, ranks, f, chunks[i], true);
    round_run(a->network, p, ranks, f, INT32_MAX, o->early_stop);
    picture_write(p, f, {{o->background[0], o->background[1], o->background[2]}});
    const size_t bytes = 5 * (size_t)p.rays * sizeof(float);
    status = finished_work(c, "rendering");
    if (!status) status = pinned_room(c, a, bytes);
    if (!status) status = device_memory.download(c, a->pinned, f.picture, bytes);
    if (!status) status = device_memory.download(c, head, p.head, sizeof *head);
    return status;
}

static sherf_status avatar_frame(context *c, gpu_avatar *a, const posed_body *posed,
                                 const sherf_camera *camera, const gpu_frame_options *options,
                                 sherf_frame *frame) {
    frame_head head;
    gpu_frame_options o = *options;
    o.early_stop = o.early_stop && avatar_in_bf16(a);
    bool again = true;
    sherf_status status = frame_shape(c, camera->width_px, camera->height_px, frame);
    while (!status && again) {
        status = cancelled(c) ? failure(c, SHERF_CANCELLED, "cancelled")
                              : frame_try(c, a, posed, camera, &o, &head);
        if (!status) status = head_judge(c, a, &head, &again);
    }
    if (status) return status;
    unpacking u = {(const float *)a->pinned, frame->color.data, frame->opacity.data, frame->depth.data,
                   (int64_t)camera->width_px * camera->height_px};
    parallel_for(c, u.pixels, 65536, unpack, &u);
    frame->points = head.points;
    return SHERF_OK;
}

/* ---- for tests and for questions that are no frames ---- */
static sherf_status points_fetch(context *c, const placed_points *p, const frame_head *head,
                                 point_set **out) {
    point_set *s = (point_set *)mem_zero(c, 1, sizeof *s);
    *out = s;
    if (!s) return SHERF_NO_MEMORY;
    const size_t n = (size_t)head->points, N = (size_t)p->rays + 1;
    s->count = head->points;
    s->rays = p->rays;
    s->samples = head->samples;
    const struct {
        void **to;
        const void *from;
        size_t count, size;
    } all[] = {{(void **)&s->first, p->first, N, sizeof(int32_t)},
               {(void **)&s->ray, p->ray, n, sizeof(int32_t)},
               {(void **)&s->sample, p->sample, n, sizeof(int32_t)},
               {(void **)&s->nearest, p->nearest, n, sizeof(int32_t)},
               {(void **)&s->canonical, p->canonical, n, 3 * sizeof(float)},
               {(void **)&s->direction_canonical, p->direction_canonical, n, 3 * sizeof(float)},
               {(void **)&s->observed_px, p->observed_px, n, 2 * sizeof(float)}};
    for (const auto &one : all) {
        if (!(*one.to = mem_alloc(c, one.count, one.size))) return SHERF_NO_MEMORY;
        if (!one.count) continue;
        const sherf_status status = device_memory.download(c, *one.to, one.from, one.count * one.size);
        if (status) return status;
    }
    return SHERF_OK;
}

static sherf_status avatar_points(context *c, gpu_avatar *a, const posed_body *posed,
                                  const sherf_camera *camera, const gpu_frame_options *options,
                                  point_set **out) {
    placed_points p;
    frame_head head;
    bool again = true;
    sherf_status status = SHERF_OK;
    *out = nullptr;
    while (!status && again) {
        status = points_make(c, a, posed, camera, options, &p);
        if (!status) status = finished_work(c, "finding points");
        if (!status) status = device_memory.download(c, &head, p.head, sizeof head);
        if (!status) status = head_judge(c, a, &head, &again);
    }
    if (!status) status = points_fetch(c, &p, &head, out);
    if (!status) return SHERF_OK;
    points_free(*out);
    *out = nullptr;
    return status;
}

static sherf_status avatar_run(context *c, gpu_avatar *a, const point_set *points, float *rgb, float *sigma) {
    const int64_t n = points->count;
    if (n == 0) return SHERF_OK;
    if (n > INT32_MAX / 4) return failure(c, SHERF_BAD_ARGUMENT, "radiance field: too many points at once");
    arena_reset(a->frame);
    float *canonical = room<float>(c, a->frame, 3 * n), *direction = room<float>(c, a->frame, 3 * n);
    float *px = room<float>(c, a->frame, 2 * n);
    int32_t *list = room<int32_t>(c, a->frame, n), *count = room<int32_t>(c, a->frame, 1);
    float4 *result = room<float4>(c, a->frame, n);
    network_scratch scratch;
    if (!canonical || !direction || !px || !list || !count || !result) return SHERF_NO_MEMORY;
    const size_t floats = (size_t)n * sizeof(float);
    sherf_status status = network_room(c, a->frame, a->network, n, &scratch);
    if (!status) status = device_memory.upload(c, canonical, points->canonical, 3 * floats);
    if (!status) status = device_memory.upload(c, direction, points->direction_canonical, 3 * floats);
    if (!status) status = device_memory.upload(c, px, points->observed_px, 2 * floats);
    float *four = (float *)mem_alloc(c, (size_t)n, 4 * sizeof *four);
    if (!status && !four) status = SHERF_NO_MEMORY;
    if (!status) {
        each(n, [=] __device__(int64_t i) {
            list[i] = (int32_t)i;
            if (i == 0) *count = (int32_t)n;
        });
        const network_points all = {canonical, direction, px, list, count, n, result};
        network_run(a->network, &all, &scratch);
        status = finished_work(c, "the radiance field");
    }
    if (!status) status = device_memory.download(c, four, result, 4 * floats);
    for (int64_t i = 0; i < n && !status; i++) {
        memcpy(rgb + 3 * i, four + 4 * i, 3 * sizeof *rgb);
        sigma[i] = four[4 * i + 3];
    }
    mem_free(four);
    return status;
}

} // namespace cuda_backend

const gpu_renderer gpu_renderer_cuda = {&device_memory, avatar_place, avatar_release,
                                        avatar_in_bf16, avatar_bytes, avatar_frame,
                                        avatar_points,  avatar_run,   &cuda_backend::points_training};
