/* How points read the bank in training, and how gradients return to it: one warp for each point and one warp
 * for each row, with lanes over a token's channels. */
#include "model/sherf/cuda/train.h"
#include "tensor/cuda/scatter.h"

namespace cuda_backend {

static train_part part_of(int axes, bool pixel, const int axis[3], const int size[3]) {
    train_part p = {};
    p.axes = axes;
    p.pixel = pixel;
    for (int i = 0; i < 3; i++) {
        p.axis[i] = axis[i];
        p.size[i] = size[i];
    }
    return p;
}

void train_bank_of(const radiance_sizes *s, const radiance_bank *b, train_bank *out) {
    static const int axis[3][3] = {{0, 1, 0}, {0, 2, 0}, {2, 1, 0}}, straight[3] = {0, 1, 2};
    *out = {};
    for (int k = 0; k < 3; k++) {
        train_part *p = &out->part[k];
        const int side[3] = {b->plane_size, b->plane_size, 1};
        *p = part_of(2, false, axis[k], side);
        for (int i = 0; i < 2; i++) {
            const int a = p->axis[i];
            p->origin[i] = b->plane_min[a];
            p->scale[i] = (float)b->plane_size / (b->plane_max[a] - b->plane_min[a]);
        }
        p->half = 0.5f;
        p->token = k;
        p->tokens = 1;
        p->rows = (int64_t)b->plane_size * b->plane_size;
        p->values = b->merged->plane[k];
    }
    train_part *map = &out->part[3], *image = &out->image;
    const int map_size[3] = {b->feature_width, b->feature_height, 1},
              image_size[3] = {b->image_width, b->image_height, 1};
    *map = part_of(2, true, straight, map_size);
    map->tokens = s->feature_channels / s->token_width;
    map->rows = (int64_t)b->feature_width * b->feature_height;
    map->values = b->merged->map;
    *image = part_of(2, true, straight, image_size);
    image->values = b->image;
    map->scale[0] = (float)(b->feature_width - 1) / (float)b->image_width;
    map->scale[1] = (float)(b->feature_height - 1) / (float)b->image_height;
    image->scale[0] = (float)(b->image_width - 1) / (float)b->image_width;
    image->scale[1] = (float)(b->image_height - 1) / (float)b->image_height;
    for (int l = 0; l < POINT_LEVELS; l++) {
        train_part *p = &out->part[4 + l];
        const int size[3] = {b->level[l].size[2], b->level[l].size[1], b->level[l].size[0]};
        *p = part_of(3, false, straight, size);
        for (int i = 0; i < 3; i++) {
            p->origin[i] = b->volume_min[i];
            p->scale[i] = (float)((p->size[i] - 1) / ((double)b->voxel_size_m * b->volume_size[2 - i]));
        }
        p->grid = b->level[l].grid;
        p->tokens = 3;
        p->rows = b->level[l].voxels;
        p->values = b->merged->level[l];
    }
}

/* The cells around a position: take(corner, row, weight) for those that exist. */
template <typename F>
static __device__ void corners_of(const train_part &p, const float *x, const float *px, F take) {
    int64_t low[3] = {0, 0, 0};
    float fraction[3] = {0, 0, 0};
    for (int i = 0; i < p.axes; i++) {
        const float v = ((p.pixel ? px : x)[p.axis[i]] - p.origin[i]) * p.scale[i] - p.half;
        if (!(v > -1 && v < (float)p.size[i])) return; /* NaN, too */
        low[i] = (int64_t)floorf(v);
        fraction[i] = v - (float)low[i];
    }
    for (int k = 0; k < 1 << p.axes; k++) {
        int64_t cell = 0, stride = 1;
        float weight = 1;
        bool inside = true;
        for (int i = 0; i < p.axes; i++) {
            const int64_t at = low[i] + (k >> i & 1);
            weight *= k >> i & 1 ? fraction[i] : 1 - fraction[i];
            inside = inside && at >= 0 && at < p.size[i];
            cell += at * stride;
            stride *= p.size[i];
        }
        const int64_t row = !inside ? -1 : p.grid ? p.grid[cell] : cell;
        if (row >= 0) take(k, row, weight);
    }
}

void train_sample(const train_network *n, const train_run &r) {
    const train_bank bank = n->bank;
    const train_run run = r;
    each_row(r.max, [=] __device__(int64_t i, int lane) {
        if (i >= chunk_points(run)) return;
        const int64_t point = run.list[run.base + i];
        const float *x = run.canonical + 3 * point, *px = run.observed_px + 2 * point;
        float sum[3] = {0, 0, 0}, color = 0;
        for (int k = 0; k < TRAIN_PARTS; k++) {
            const train_part &p = bank.part[k];
            corners_of(p, x, px, [&](int, int64_t row, float weight) {
                const float *from = p.values + row * p.tokens * TOKEN + lane;
                UNROLL
                for (int j = 0; j < 3; j++)
                    if (j >= p.token && j < p.token + p.tokens)
                        sum[j] += weight * from[(j - p.token) * TOKEN];
            });
        }
        if (lane < 3)
            corners_of(bank.image, x, px, [&](int, int64_t row, float weight) {
                color += weight * bank.image.values[3 * row + lane];
            });
        for (int j = 0; j < 3; j++) run.tokens[i * TOKENS + j * TOKEN + lane] = sum[j];
        if (lane < 3) run.color[3 * i + lane] = color;
    });
}

/* grad[row] += sum over the corners that read it of weight dtoken[point], in the list's order. */
static sherf_status scatter_part(op_call *call, const train_part &part, const train_run &run, int64_t points,
                                 float *grad) {
    const train_part p = part;
    const int corners = 1 << p.axes;
    const int64_t entries = points * corners;
    int32_t *key = scratch<int32_t>(call, entries);
    float *weight = scratch<float>(call, entries);
    sorted by_row;
    if (!key || !weight) return SHERF_NO_MEMORY;
    const train_run r = run;
    each(points, [=] __device__(int64_t i) {
        for (int k = 0; k < corners; k++) key[i * corners + k] = (int32_t)p.rows;
        if (i >= *r.count) return;
        const int64_t point = r.list[i];
        corners_of(p, r.canonical + 3 * point, r.observed_px + 2 * point,
                   [&](int k, int64_t row, float share) {
                       key[i * corners + k] = (int32_t)row;
                       weight[i * corners + k] = share;
                   });
    });
    if (!sort_keys(call, entries, p.rows, key, &by_row)) return SHERF_NO_MEMORY;
    each_row(p.rows, [=] __device__(int64_t row, int lane) {
        const int64_t begin = first_of(by_row, row), end = first_of(by_row, row + 1);
        if (begin == end) return;
        float sum[3] = {0, 0, 0};
        for (int64_t e = begin; e < end; e++) {
            const int32_t from = by_row.entry[e];
            const float *d = r.dtokens + (int64_t)(from / corners) * TOKENS + p.token * TOKEN + lane;
            UNROLL
            for (int j = 0; j < 3; j++)
                if (j < p.tokens) sum[j] += weight[from] * d[j * TOKEN];
        }
        for (int j = 0; j < p.tokens; j++) grad[(row * p.tokens + j) * TOKEN + lane] += sum[j];
    });
    return SHERF_OK;
}

sherf_status train_scatter(context *c, arena *space, const train_network *n, const train_run &all,
                           int64_t points, const radiance_gradients *out) {
    float *grad[TRAIN_PARTS] = {out->plane[0], out->plane[1], out->plane[2], out->map,
                                out->level[0], out->level[1], out->level[2]};
    op_call call = {};
    call.c = c;
    call.scratch = space;
    for (int k = 0; k < TRAIN_PARTS; k++) {
        const arena_mark mark = arena_position(space);
        const sherf_status status = scatter_part(&call, n->bank.part[k], all, points, grad[k]);
        arena_rewind(space, mark); /* in the stream's order */
        if (status) return status;
    }
    return SHERF_OK;
}

} // namespace cuda_backend
