/* The radiance field's bank on the GPU, and how points read it. Sampling is a separate kernel before the
 * layers: it waits for memory, so it wants as many threads as possible, while the layers want all registers.
 * Between them 200 bytes of each point pass through the L2 cache, of 6 KB that are read from the bank. */
#include "model/sherf/cuda/network.h"

namespace cuda_backend {

/* Points in one launch: tokens are stored for this many. */
constexpr int64_t points_at_a_time = 1 << 19;

/* ---- placing ---- */
static bool place_floats(context *c, arena *a, const tensor_memory *memory, const float *from, int64_t count,
                         float **to) {
    *to = room<float>(c, a, count);
    return *to && (count == 0 || memory->upload(c, *to, from, (size_t)count * sizeof **to) == SHERF_OK);
}

/* Stored as float16 times scale. */
static bool place_halves(context *c, arena *a, const tensor_memory *memory, const float *from, int64_t count,
                         float scale, uint16_t **to) {
    uint16_t *half = *to = room<uint16_t>(c, a, count);
    const arena_mark mark = arena_position(a);
    const int64_t max = 1 << 22; /* at a time */
    float *part = half ? room<float>(c, a, count < max ? count : max) : nullptr;
    for (int64_t i = 0; part && i < count; i += max) {
        const int64_t some = count - i < max ? count - i : max;
        if (memory->upload(c, part, from + i, (size_t)some * sizeof(float)) != SHERF_OK) return false;
        each(some, [=] __device__(int64_t k) { half[i + k] = half_of(part[k] * scale); });
    }
    arena_rewind(a, mark); /* in the stream's order */
    return part != nullptr;
}

/* scale 0: as float32. */
static bool place_values(context *c, arena *a, const tensor_memory *memory, const float *from, int64_t count,
                         float scale, float **whole, uint16_t **half) {
    return scale == 0 ? place_floats(c, a, memory, from, count, whole)
                      : place_halves(c, a, memory, from, count, scale, half);
}

static bool place_map(context *c, arena *a, const tensor_memory *memory, const radiance_map *from,
                      float scale, radiance_map *to) {
    *to = {from->width, from->height, from->stride, nullptr, nullptr};
    return place_values(c, a, memory, from->texel, (int64_t)from->width * from->height * from->stride, scale,
                        &to->texel, &to->half);
}

static bool place_integers(context *c, arena *a, const tensor_memory *memory, const int32_t *from,
                           int64_t count, int32_t **to) {
    *to = room<int32_t>(c, a, count);
    return *to && (count == 0 || memory->upload(c, *to, from, (size_t)count * sizeof **to) == SHERF_OK);
}

static bool place_level(context *c, arena *a, const tensor_memory *memory, const radiance_level *from,
                        float scale, radiance_level *to) {
    const int64_t cells = (int64_t)(from->size[0] + 1) * (from->size[1] + 1) * (from->size[2] + 1);
    *to = *from;
    return place_integers(c, a, memory, from->cell, cells, &to->cell) &&
           place_integers(c, a, memory, from->corner[0], 8 * from->corners, (int32_t **)&to->corner) &&
           place_values(c, a, memory, from->value, from->rows * from->stride, scale, &to->value, &to->half);
}

static sherf_status place_bank(context *c, arena *a, const tensor_memory *memory, const radiance_parts *p,
                               bool half, placed_bank *b) {
    const radiance_field *n = p->n;
    b->width = n->s.token_width;
    b->fused = n->fused;
    b->map_tokens = n->map_tokens;
    memcpy(b->plane_min, n->plane_min, sizeof b->plane_min);
    memcpy(b->plane_scale, n->plane_scale, sizeof b->plane_scale);
    memcpy(b->map_scale, n->map_scale, sizeof b->map_scale);
    memcpy(b->image_scale, n->image_scale, sizeof b->image_scale);
    memcpy(b->volume_min, n->volume_min, sizeof b->volume_min);
    b->image_width = n->image_width;
    b->image_height = n->image_height;
    b->scale = 1;
    /* as on the CPU: a sum of all parts stays far from float16's 65504, small values far from 6e-8 */
    if (half) b->scale = exp2f(floorf(log2f(4096.0f / fmaxf(p->bank_max, 1e-20f))));
    if (!isfinite(b->scale) || b->scale <= 0)
        return failure(c, SHERF_BAD_ARGUMENT, "radiance field: the avatar's features are not finite");
    const float scale = half ? b->scale : 0;
    float *image;
    bool placed = place_map(c, a, memory, &n->map, scale, &b->map) &&
                  place_floats(c, a, memory, n->image, 4 * (int64_t)n->image_width * n->image_height, &image);
    for (int i = 0; i < 3 && placed; i++) placed = place_map(c, a, memory, &n->plane[i], scale, &b->plane[i]);
    for (int l = 0; l < POINT_LEVELS && placed; l++)
        placed = place_level(c, a, memory, &n->level[l], scale, &b->level[l]);
    if (!placed) return SHERF_NO_MEMORY;
    b->image = (const float4 *)image;
    return SHERF_OK;
}

static bool place_matrix(context *c, arena *a, const tensor_memory *memory, const radiance_matrix *from,
                         radiance_matrix *to) {
    *to = {from->rows, from->columns, nullptr, nullptr};
    return !from->w || (place_floats(c, a, memory, from->w, (int64_t)from->rows * from->columns, &to->w) &&
                        place_floats(c, a, memory, from->b, from->rows, &to->b));
}

static sherf_status place_layers(context *c, arena *a, const tensor_memory *memory, const radiance_parts *p,
                                 float_layers *l) {
    const radiance_field *n = p->n;
    const int D = n->s.token_width;
#define PLACE(to, name)                                                                                      \
    if (!place_matrix(c, a, memory, &p->m.name, &to.name)) return SHERF_NO_MEMORY;
    RADIANCE_LAYERS(PLACE, l->m)
#undef PLACE
    for (int i = 0; i < n->s.decoder_depth; i++)
        if (!place_matrix(c, a, memory, &p->m.pts[i], &l->m.pts[i])) return SHERF_NO_MEMORY;
    const struct {
        const float *from, **to;
        int count;
    } vectors[] = {{n->norm0_w, &l->norm0_w, D},
                   {n->norm0_b, &l->norm0_b, D},
                   {n->norm1_w, &l->norm1_w, D},
                   {n->norm1_b, &l->norm1_b, D},
                   {n->token_b, &l->token_b, n->fused}};
    for (const auto &one : vectors) {
        float *placed;
        if (!place_floats(c, a, memory, one.from, one.count, &placed)) return SHERF_NO_MEMORY;
        *one.to = placed;
    }
    return SHERF_OK;
}

/* The unpacked layers' memory is freed after packing. */
static sherf_status place_fragments(context *c, arena *a, const tensor_memory *memory,
                                    const radiance_parts *p, placed_network *n) {
    float_layers layers;
    sherf_status status = bf16_room(c, a, n->s, &n->fragments);
    if (status) return status;
    const arena_mark mark = arena_position(a);
    status = place_layers(c, a, memory, p, &layers);
    if (!status) bf16_pack(layers, n->s, n->fragments);
    arena_rewind(a, mark); /* in the stream's order */
    return status;
}

network_sizes network_sizes_of(const radiance_field *n) {
    const radiance_sizes *s = &n->s;
    return {s->token_width,     n->fused,
            s->heads,           s->head_width,
            n->attention_width, n->color_width,
            n->color_token,     s->color_frequencies,
            n->position_width,  s->position_frequencies,
            n->direction_width, s->direction_frequencies,
            s->decoder_width,   s->decoder_depth,
            s->decoder_skip,    s->view_width};
}

sherf_status network_place(context *c, arena *a, const tensor_memory *memory, const radiance_parts *p,
                           bool bf16, placed_network **out) {
    *out = nullptr;
    placed_network *n = (placed_network *)mem_zero(c, 1, sizeof *n);
    if (!n) return SHERF_NO_MEMORY;
    n->s = network_sizes_of(p->n);
    n->bf16 = bf16 && bf16_fits(n->s);
    sherf_status status = place_bank(c, a, memory, p, n->bf16, &n->bank);
    if (!status && n->bf16) status = place_fragments(c, a, memory, p, n);
    if (!status && !n->bf16) status = place_layers(c, a, memory, p, &n->layers);
    if (!status) status = finished_work(c, "placing a radiance field");
    if (status)
        mem_free(n);
    else
        *out = n;
    return status;
}

void network_free(placed_network *n) {
    mem_free(n); /* the arena owns everything that it points to */
}

bool network_in_bf16(const placed_network *n) {
    return n->bf16;
}

/* ---- sampling: one thread a point and some channels of its tokens ---- */
/* Channels that a thread reads, 16 bytes of them or one. */
template <typename V> struct channels;
template <> struct channels<float> {
    enum { COUNT = 1 };
    float sum[1];
    static __device__ const float *values(const float *whole, const uint16_t *) { return whole; }
    __device__ void add(const void *row, float weight) { sum[0] += *(const float *)row * weight; }
    __device__ void store(void *to) const { *(float *)to = sum[0]; }
};
template <> struct channels<uint16_t> {
    enum { COUNT = 8 };
    float sum[8];
    static __device__ const uint16_t *values(const float *, const uint16_t *half) { return half; }
    __device__ void add(const void *row, float weight) {
        const uint4 v = *(const uint4 *)row;
        const uint32_t word[4] = {v.x, v.y, v.z, v.w};
        UNROLL
        for (int i = 0; i < 4; i++) {
            sum[2 * i] += half_value((uint16_t)word[i]) * weight;
            sum[2 * i + 1] += half_value((uint16_t)(word[i] >> 16)) * weight;
        }
    }
    __device__ void store(void *to) const {
        uint32_t word[4];
        UNROLL
        for (int i = 0; i < 4; i++) word[i] = half_of(sum[2 * i]) | (uint32_t)half_of(sum[2 * i + 1]) << 16;
        *(uint4 *)to = make_uint4(word[0], word[1], word[2], word[3]);
    }
};

/* Floor and fraction of a position; -2 when it is outside [-1, size) (a NaN is). */
static __device__ int low_corner(float x, int size, float *fraction) {
    *fraction = 0;
    if (!(x >= -1.0f && x < (float)size)) return -2;
    const float low = floorf(x);
    *fraction = x - low;
    return (int)low;
}

/* take(texel's number, weight) for those of the four around (x, y) that exist. */
template <typename F> static __device__ void bilinear(int width, int height, float x, float y, F take) {
    float fx, fy;
    const int ix = low_corner(x, width, &fx), iy = low_corner(y, height, &fy);
    if (ix < -1 || iy < -1) return;
    UNROLL
    for (int k = 0; k < 4; k++) {
        const int cx = ix + (k & 1), cy = iy + (k >> 1);
        if (cx < 0 || cy < 0 || cx >= width || cy >= height) continue;
        take((int64_t)cy * width + cx, ((k & 1) ? fx : 1.0f - fx) * ((k >> 1) ? fy : 1.0f - fy));
    }
}

template <typename V>
static __device__ void sample_level(const radiance_level &l, const float at[3], int channel,
                                    channels<V> &sum) {
    float fx, fy, fz;
    const int x = low_corner(at[0] * l.voxels_per_m[0], l.size[2], &fx),
              y = low_corner(at[1] * l.voxels_per_m[1], l.size[1], &fy),
              z = low_corner(at[2] * l.voxels_per_m[2], l.size[0], &fz);
    if (x < -1 || y < -1 || z < -1) return;
    const int32_t cell = l.cell[((int64_t)(z + 1) * (l.size[1] + 1) + (y + 1)) * (l.size[2] + 1) + (x + 1)];
    if (cell < 0) return;
    const int32_t *corner = l.corner[cell];
    UNROLL
    for (int k = 0; k < 8; k++) {
        const int32_t row = corner[k];
        if (!row) continue;
        sum.add(channels<V>::values(l.value, l.half) + (int64_t)row * l.stride + channel,
                ((k & 1) ? fx : 1.0f - fx) * ((k & 2) ? fy : 1.0f - fy) * ((k & 4) ? fz : 1.0f - fz));
    }
}

/* Channels [channel, channel + COUNT) of a point's tokens; they are of one token. */
template <typename V>
static __device__ channels<V> sample_channels(const placed_bank &b, const float x[3], const float uv[2],
                                              int channel) {
    channels<V> sum = {};
    const int i = channel / b.width, within = channel - i * b.width;
    const int across = i == 2 ? 2 : 0, down = i == 1 ? 2 : 1; /* planes: (x, y), (x, z), (z, y) */
    const radiance_map &p = b.plane[i];
    bilinear(p.width, p.height, (x[across] - b.plane_min[across]) * b.plane_scale[across] - 0.5f,
             (x[down] - b.plane_min[down]) * b.plane_scale[down] - 0.5f, [&](int64_t texel, float weight) {
                 sum.add(channels<V>::values(p.texel, p.half) + texel * p.stride + within, weight);
             });
    if (i < b.map_tokens)
        bilinear(b.map.width, b.map.height, uv[0] * b.map_scale[0], uv[1] * b.map_scale[1],
                 [&](int64_t texel, float weight) {
                     sum.add(channels<V>::values(b.map.texel, b.map.half) + texel * b.map.stride + channel,
                             weight);
                 });
    const float at[3] = {x[0] - b.volume_min[0], x[1] - b.volume_min[1], x[2] - b.volume_min[2]};
    for (int l = 0; l < POINT_LEVELS; l++) sample_level<V>(b.level[l], at, channel, sum);
    return sum;
}

static __device__ void sample_color(const placed_bank &b, const float uv[2], float out[3]) {
    float sum[3] = {0, 0, 0};
    bilinear(b.image_width, b.image_height, uv[0] * b.image_scale[0], uv[1] * b.image_scale[1],
             [&](int64_t texel, float weight) {
                 const float4 v = b.image[texel];
                 sum[0] += weight * v.x;
                 sum[1] += weight * v.y;
                 sum[2] += weight * v.z;
             });
    for (int k = 0; k < 3; k++) out[k] = sum[k];
}

/* The last of a point's threads reads the picture. */
template <typename V>
__global__ void __launch_bounds__(BLOCK)
    sample_kernel(placed_bank b, network_points points, int64_t base, int64_t max, V *tokens, float *color) {
    const int groups = b.fused / channels<V>::COUNT + 1;
    const int64_t left = *points.count - base, end = (left < max ? left : max) * groups;
    const int64_t step = (int64_t)gridDim.x * blockDim.x;
    for (int64_t i = (int64_t)blockIdx.x * blockDim.x + threadIdx.x; i < end; i += step) {
        const int64_t at = i / groups, p = points.list[base + at];
        const int group = (int)(i - at * groups), channel = group * channels<V>::COUNT;
        const float uv[2] = {points.observed_px[2 * p], points.observed_px[2 * p + 1]};
        if (group == groups - 1) {
            sample_color(b, uv, color + 3 * at);
            continue;
        }
        const float x[3] = {points.canonical[3 * p], points.canonical[3 * p + 1],
                            points.canonical[3 * p + 2]};
        sample_channels<V>(b, x, uv, channel).store(tokens + at * b.fused + channel);
    }
}

template <typename V>
static void sample_as(const placed_network *n, const network_points *points, int64_t base, int64_t max,
                      void *tokens, float *color) {
    const int64_t blocks = divided_up(max * (n->bank.fused / channels<V>::COUNT + 1), BLOCK);
    launch(sample_kernel<V>, dim3((unsigned)(blocks < 1 << 16 ? blocks : 1 << 16)), dim3(BLOCK), n->bank,
           *points, base, max, (V *)tokens, color);
}

void sample_tokens(const placed_network *n, const network_points *points, int64_t base, int64_t max,
                   void *tokens, float *color) {
    if (n->bf16)
        sample_as<uint16_t>(n, points, base, max, tokens, color);
    else
        sample_as<float>(n, points, base, max, tokens, color);
}

/* ---- the whole ---- */
sherf_status network_room(context *c, arena *a, const placed_network *n, int64_t max, network_scratch *out) {
    *out = {max < points_at_a_time ? max : points_at_a_time, nullptr, nullptr, nullptr};
    const int64_t tokens = out->max * n->s.fused;
    out->tokens = n->bf16 ? (void *)room<uint16_t>(c, a, tokens) : (void *)room<float>(c, a, tokens);
    out->color = room<float>(c, a, 3 * out->max);
    if (!n->bf16) out->layers = room<float>(c, a, float_blocks() * float_rows(&n->s) * WARP);
    return out->tokens && out->color && (n->bf16 || out->layers) ? SHERF_OK : SHERF_NO_MEMORY;
}

void network_run(const placed_network *n, const network_points *points, const network_scratch *scratch) {
    for (int64_t base = 0; base < points->max; base += scratch->max) {
        const int64_t left = points->max - base, max = left < scratch->max ? left : scratch->max;
        sample_tokens(n, points, base, max, scratch->tokens, scratch->color);
        if (n->bf16)
            bf16_run(n, points, base, max, scratch);
        else
            float_run(n, points, base, max, scratch);
    }
}

} // namespace cuda_backend
