/* The CUDA kernels of sample_bilinear, sample_trilinear and scatter_mean. Their gradients sort the corners of
 * all points by position. */
#include "tensor/cuda/scatter.h"

namespace cuda_backend {

/* The 2^N corners of a position among size[] cells on each axis, axis 0 running fastest: corner k has bit i
 * set if it is the upper neighbour on axis i. place[k] is -1 outside. */
template <int N> struct corners {
    int64_t place[1 << N];
    float weight[1 << N];
    __device__ corners(const float *p, const int64_t *size) {
        bool near_by = true; /* false for NaN, too */
        for (int i = 0; i < N; i++)
            if (!(p[i] > -1 && p[i] < (float)size[i])) near_by = false;
        for (int k = 0; k < 1 << N; k++) {
            int64_t at = 0, stride = 1;
            bool inside = near_by;
            float w = 1;
            for (int i = 0; i < N && inside; i++) {
                const int64_t low = (int64_t)floorf(p[i]), cell = low + (k >> i & 1);
                const float f = p[i] - (float)low;
                w *= k >> i & 1 ? f : 1 - f;
                inside = cell >= 0 && cell < size[i];
                at += cell * stride;
                stride *= size[i];
            }
            place[k] = inside ? at : -1;
            weight[k] = inside ? w : 0;
        }
    }
};

/* The source of sampling: rows of `channels` values, found by cell, or through a grid of row numbers (-1:
 * none). */
template <int N> struct sampled {
    int64_t points, channels, rows, size[N];
    const float *position;
    const int32_t *grid; /* NULL: the cell is the row */
    /* Row of a corner's cell, or -1. */
    __device__ int64_t row(int64_t place) const { return place < 0 || !grid ? place : grid[place]; }
};

static sampled<2> map_of(const op_call *call) {
    const tensor *map = call->in[0], *position = call->in[1];
    return {position->dim[0],           map->dim[2],      map->dim[0] * map->dim[1],
            {map->dim[1], map->dim[0]}, values(position), nullptr};
}

static sampled<3> volume_of(const op_call *call) {
    const tensor *x = call->in[0], *grid = call->in[1], *position = call->in[2];
    return {position->dim[0], x->dim[1],     x->dim[0], {grid->dim[2], grid->dim[1], grid->dim[0]},
            values(position), integers(grid)};
}

/* One warp for each point: the corners once, then channels in parallel. */
template <int N> static sherf_status sample_forward(op_call *call, const sampled<N> &s) {
    const float *x = values(call->in[0]);
    float *y = values(call->out[0]);
    each_row(s.points, [=] __device__(int64_t p, int lane) {
        const corners<N> c(s.position + N * p, s.size);
        int64_t row[1 << N];
        for (int k = 0; k < 1 << N; k++) row[k] = s.row(c.place[k]);
        for (int64_t i = lane; i < s.channels; i += WARP) {
            float sum = 0;
            for (int k = 0; k < 1 << N; k++)
                if (row[k] >= 0) sum += c.weight[k] * x[row[k] * s.channels + i];
            y[p * s.channels + i] = sum;
        }
    });
    return finished(call);
}

/* dx[row] = sum over the corners that read it of weight dy[point], in the points' order. */
template <int N> static sherf_status sample_backward(op_call *call, const sampled<N> &s) {
    enum { CORNERS = 1 << N };
    const float *dy = values(call->dout[0]);
    float *dx = values(call->din[0]);
    if (!dx) return SHERF_OK;
    if (s.points * CORNERS > INT32_MAX || s.rows >= INT32_MAX)
        return failure(call->c, SHERF_UNSUPPORTED, "%s: more points than the CUDA backend takes",
                       op_name(call->op));
    int32_t *key = scratch<int32_t>(call, s.points * CORNERS);
    float *weight = scratch<float>(call, s.points * CORNERS);
    sorted by_row;
    if (!key || !weight) return SHERF_NO_MEMORY;
    each(s.points, [=] __device__(int64_t p) {
        const corners<N> c(s.position + N * p, s.size);
        for (int k = 0; k < CORNERS; k++) {
            const int64_t row = s.row(c.place[k]);
            key[p * CORNERS + k] = (int32_t)(row < 0 ? s.rows : row);
            weight[p * CORNERS + k] = c.weight[k];
        }
    });
    if (!sort_keys(call, s.points * CORNERS, s.rows, key, &by_row)) return SHERF_NO_MEMORY;
    each_row(s.rows, [=] __device__(int64_t r, int lane) {
        const int64_t begin = first_of(by_row, r), end = first_of(by_row, r + 1);
        for (int64_t i = lane; begin < end && i < s.channels; i += WARP) {
            float sum = 0;
            for (int64_t e = begin; e < end; e++) {
                const int32_t from = by_row.entry[e];
                sum += weight[from] * dy[from / CORNERS * s.channels + i];
            }
            dx[r * s.channels + i] += sum;
        }
    });
    return finished(call);
}

sherf_status sample_bilinear_forward(op_call *call) {
    return sample_forward(call, map_of(call));
}
sherf_status sample_bilinear_backward(op_call *call) {
    return sample_backward(call, map_of(call));
}
sherf_status sample_trilinear_forward(op_call *call) {
    return sample_forward(call, volume_of(call));
}
sherf_status sample_trilinear_backward(op_call *call) {
    return sample_backward(call, volume_of(call));
}

/* Sorts the rows by voxel. */
static bool by_voxel(op_call *call, sorted *out) {
    const int64_t rows = tensor_count(call->in[1]);
    const int32_t *index = integers(call->in[1]);
    int32_t *key = scratch<int32_t>(call, rows);
    if (!key) return false;
    each(rows, [=] __device__(int64_t v) { key[v] = index[v]; });
    return sort_keys(call, rows, ((const scatter_attr *)call->attr)->voxels, key, out);
}

sherf_status scatter_mean_forward(op_call *call) {
    const int64_t C = call->in[0]->dim[1];
    const float *x = values(call->in[0]);
    float *y = values(call->out[0]);
    sorted rows;
    if (!by_voxel(call, &rows)) return SHERF_NO_MEMORY;
    each_row(((const scatter_attr *)call->attr)->voxels, [=] __device__(int64_t a, int lane) {
        const int64_t begin = first_of(rows, a), end = first_of(rows, a + 1);
        for (int64_t c = lane; c < C; c += WARP) {
            float sum = 0;
            for (int64_t e = begin; e < end; e++) sum += x[rows.entry[e] * C + c];
            y[a * C + c] = begin < end ? sum / (float)(end - begin) : 0;
        }
    });
    return finished(call);
}

sherf_status scatter_mean_backward(op_call *call) {
    const int64_t C = call->in[0]->dim[1];
    const float *dy = values(call->dout[0]);
    float *dx = values(call->din[0]);
    sorted rows;
    if (!dx) return SHERF_OK;
    if (!by_voxel(call, &rows)) return SHERF_NO_MEMORY;
    each_row(((const scatter_attr *)call->attr)->voxels, [=] __device__(int64_t a, int lane) {
        const int64_t begin = first_of(rows, a), end = first_of(rows, a + 1);
        for (int64_t e = begin; e < end; e++)
            for (int64_t c = lane; c < C; c += WARP)
                dx[rows.entry[e] * C + c] += dy[a * C + c] / (float)(end - begin);
    });
    return finished(call);
}

} // namespace cuda_backend
