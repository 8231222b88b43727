/* The CUDA kernels of layer_norm and token_attention. */
#include "tensor/cuda/cuda.h"

namespace cuda_backend {

/* Mean and 1 / sqrt(variance + 1e-5) of one row, in every lane. */
struct row_statistics {
    float mean, scale;
    __device__ row_statistics(const float *x, int64_t C, int lane) {
        float sum = 0, square = 0;
        for (int64_t c = lane; c < C; c += WARP) sum += x[c];
        mean = warp_sum(sum) / (float)C;
        for (int64_t c = lane; c < C; c += WARP) square += (x[c] - mean) * (x[c] - mean);
        scale = 1 / sqrtf(warp_sum(square) / (float)C + 1e-5f);
    }
};

sherf_status layer_norm_forward(op_call *call) {
    const int64_t C = tensor_columns(call->in[0]);
    const float *x = values(call->in[0]), *w = values(call->in[1]), *b = values(call->in[2]);
    float *y = values(call->out[0]);
    each_row(tensor_rows(call->in[0]), [=] __device__(int64_t r, int lane) {
        const row_statistics row(x + r * C, C, lane);
        for (int64_t c = lane; c < C; c += WARP)
            y[r * C + c] = (x[r * C + c] - row.mean) * row.scale * w[c] + b[c];
    });
    return finished(call);
}

sherf_status layer_norm_backward(op_call *call) {
    const int64_t R = tensor_rows(call->in[0]), C = tensor_columns(call->in[0]);
    const float *x = values(call->in[0]), *w = values(call->in[1]), *dy = values(call->dout[0]);
    float *dx = values(call->din[0]), *dw = values(call->din[1]), *db = values(call->din[2]);
    float *mean = scratch<float>(call, R), *scale = scratch<float>(call, R);
    if (!mean || !scale) return SHERF_NO_MEMORY;
    each_row(R, [=] __device__(int64_t r, int lane) {
        const row_statistics row(x + r * C, C, lane);
        float sum = 0, dot = 0;
        for (int64_t c = lane; c < C; c += WARP) {
            const float g = dy[r * C + c] * w[c];
            sum += g;
            dot += g * (x[r * C + c] - row.mean) * row.scale;
        }
        sum = warp_sum(sum) / (float)C;
        dot = warp_sum(dot) / (float)C;
        if (lane == 0) {
            mean[r] = row.mean;
            scale[r] = row.scale;
        }
        /* dx = (dn - mean(dn) - n mean(dn n)) / sqrt(var + 1e-5), dn = dy weight */
        for (int64_t c = lane; dx && c < C; c += WARP) {
            const float n = (x[r * C + c] - row.mean) * row.scale;
            dx[r * C + c] += (dy[r * C + c] * w[c] - sum - n * dot) * row.scale;
        }
    });
    sherf_status status = SHERF_OK;
    if (dw || db)
        status = column_sums<2>(
            call, R, C,
            [=] __device__(int64_t r, int64_t c) {
                const float g = dy[r * C + c];
                return several<2>{{g * (x[r * C + c] - mean[r]) * scale[r], g}};
            },
            [=] __device__(int64_t c, several<2> sum) {
                if (dw) dw[c] += sum.v[0];
                if (db) db[c] += sum.v[1];
            });
    return status == SHERF_OK ? finished(call) : status;
}

/* ---- attention among a point's tokens ---- */
constexpr int tokens_max = 16; /* of one point; the paper has 3 */

static sherf_status tokens_check(op_call *call) {
    const attention_attr *a = (const attention_attr *)call->attr;
    if (a->tokens <= tokens_max) return SHERF_OK;
    return failure(call->c, SHERF_UNSUPPORTED,
                   "token_attention: %d tokens, and the CUDA backend takes %d at most", a->tokens,
                   tokens_max);
}

/* One head of one point: q, k and v of token j are `row` after those of token j - 1. */
struct head {
    const float *q, *k, *v;
    int64_t row;
    int tokens, width;
    __device__ head(const float *qkv, attention_attr a, int64_t point, int h)
        : row(3 * (int64_t)a.heads * a.width), tokens(a.tokens), width(a.width) {
        q = qkv + point * a.tokens * row + h * a.width;
        k = q + row / 3;
        v = k + row / 3;
    }
    /* p[j] = softmax over j of q_i . k_j / sqrt(width) */
    __device__ void softmax(int i, float *p) const {
        const float scale = 1 / sqrtf((float)width);
        float largest = -INFINITY, sum = 0;
        for (int j = 0; j < tokens; j++) {
            p[j] = 0;
            for (int d = 0; d < width; d++) p[j] += q[i * row + d] * k[j * row + d];
            p[j] *= scale;
            largest = p[j] > largest ? p[j] : largest;
        }
        for (int j = 0; j < tokens; j++) sum += p[j] = expf(p[j] - largest);
        for (int j = 0; j < tokens; j++) p[j] /= sum;
    }
    /* ds[j] = p[j] (dp[j] - sum p dp) / sqrt(width), dp[j] = dy_i . v_j */
    __device__ void softmax_gradient(const float *dy, const float *p, float *ds) const {
        float mean = 0;
        for (int j = 0; j < tokens; j++) {
            ds[j] = 0;
            for (int d = 0; d < width; d++) ds[j] += dy[d] * v[j * row + d];
            mean += p[j] * ds[j];
        }
        for (int j = 0; j < tokens; j++) ds[j] = p[j] * (ds[j] - mean) / sqrtf((float)width);
    }
};

/* One thread for each token and head. */
sherf_status token_attention_forward(op_call *call) {
    const attention_attr a = *(const attention_attr *)call->attr;
    const int64_t R = tensor_rows(call->in[0]), D = (int64_t)a.heads * a.width;
    const float *x = values(call->in[0]);
    float *y = values(call->out[0]);
    sherf_status status = tokens_check(call);
    if (status != SHERF_OK) return status;
    each(R * a.heads, [=] __device__(int64_t n) {
        const int h = (int)(n % a.heads), i = (int)(n / a.heads % a.tokens);
        const head one(x, a, n / a.heads / a.tokens, h);
        float p[tokens_max];
        one.softmax(i, p);
        for (int d = 0; d < a.width; d++) {
            float sum = 0;
            for (int j = 0; j < a.tokens; j++) sum += p[j] * one.v[j * one.row + d];
            y[n / a.heads * D + h * a.width + d] = sum;
        }
    });
    return finished(call);
}

/* The thread of token t computes its dq, dk and dv, each from all of the point's tokens. */
sherf_status token_attention_backward(op_call *call) {
    const attention_attr a = *(const attention_attr *)call->attr;
    const int64_t R = tensor_rows(call->in[0]), D = (int64_t)a.heads * a.width;
    const float *x = values(call->in[0]), *dy = values(call->dout[0]);
    float *dx = values(call->din[0]);
    sherf_status status = tokens_check(call);
    if (status != SHERF_OK) return status;
    each(R * a.heads, [=] __device__(int64_t n) {
        const int h = (int)(n % a.heads), t = (int)(n / a.heads % a.tokens);
        const int64_t point = n / a.heads / a.tokens;
        const head one(x, a, point, h);
        const float *dy_head = dy + point * a.tokens * D + h * a.width;
        float *dq = dx + n / a.heads * one.row + h * a.width, *dk = dq + D, *dv = dk + D;
        float p[tokens_max], ds[tokens_max];
        for (int i = 0; i < a.tokens; i++) {
            one.softmax(i, p);
            one.softmax_gradient(dy_head + i * D, p, ds);
            for (int d = 0; d < a.width; d++) {
                dv[d] += p[t] * dy_head[i * D + d];
                dk[d] += ds[t] * one.q[i * one.row + d];
                for (int j = 0; i == t && j < a.tokens; j++) dq[d] += ds[j] * one.k[j * one.row + d];
            }
        }
    });
    return finished(call);
}

} // namespace cuda_backend
