/* The radiance field in training: forward to its result, or forward and back through the decoder. As in
 * network_bf16.cu a warp takes 16 points through all layers in its registers, and the stages of the weights
 * rotate; the backward pass's stages, transposed, follow the forward ones. The backward pass needs from the
 * forward one the signs of each layer's sums, 2 words for each lane and layer, in shared memory. The group's
 * record receives what the weights' gradients need. Points beyond the end repeat the last one with gradients
 * of 0. */
#include "model/sherf/cuda/train.h"

namespace cuda_backend {

constexpr size_t mask_bytes = (POINT_DECODER_MAX + 1) * 2 * THREADS * 4;
template <int H> constexpr size_t train_shared() {
    return decoder_shared<H>() + mask_bytes + VIEW_N * FRAGMENT * 4;
}

/* Stores the signs of N sums of 16 x 8 as bits of this lane. */
template <int N> static __device__ void signs_keep(uint32_t *mask, const sums *y) {
    uint32_t bits[2] = {0, 0};
    UNROLL
    for (int n = 0; n < N; n++) {
        UNROLL
        for (int e = 0; e < 4; e++)
            if (y[n].c[e] > 0) bits[n / 8] |= 1u << (n % 8 * 4 + e);
    }
    mask[0] = bits[0];
    mask[THREADS] = bits[1];
}

template <int N> static __device__ void signs_apply(const uint32_t *mask, sums *y) {
    const uint32_t bits[2] = {mask[0], mask[THREADS]};
    UNROLL
    for (int n = 0; n < N; n++) {
        UNROLL
        for (int e = 0; e < 4; e++)
            if (!(bits[n / 8] >> (n % 8 * 4 + e) & 1)) y[n].c[e] = 0;
    }
}

/* Stores one token's sums in the points' rows of 2 TOKEN. */
static __device__ void store_token(float *to, int64_t first, int g, int t, const sums *y) {
    UNROLL
    for (int n = 0; n < TOKEN_N; n++) {
        UNROLL
        for (int e = 0; e < 4; e++)
            to[(first + g + e / 2 * 8) * (2 * TOKEN) + 8 * n + 2 * t + e % 2] = y[n].c[e];
    }
}

template <int H, bool BACK> struct train_task {
    static constexpr bool KEEPS = BACK;
    warp_points at;
    const train_run &r;
    uint4 *record;
    uint32_t *mask;

    __device__ void tokens(const network_warp &w, const float *token_b, sums (*token)[TOKEN_N]) const {
        const int64_t rows[2] = {at.place(w.g), at.place(w.g + 8)};
        load_tokens(r, token_b, rows, w.t, 3, token);
    }
    __device__ float color(int p, int k) const { return r.color[3 * at.place(p) + k]; }
    __device__ float position(int p, int k) const { return r.canonical[3 * at.number(p) + k]; }
    __device__ float direction(int p, int k) const { return r.direction[3 * at.number(p) + k]; }
    __device__ void fused(const network_warp &w, const input *x, const input *seen) const {
        UNROLL
        for (int k = 0; k < X_TILES; k++) keep(record, r.at.x + k, w.lane, x[k]);
        UNROLL
        for (int k = 0; k < TOKEN_TILES; k++) keep(record, r.at.token1 + k, w.lane, seen[k]);
    }
    __device__ void layer_sums(int layer, const sums *y) const {
        signs_keep<2 * H>(mask + layer * 2 * THREADS, y);
    }
    __device__ void layer_result(const network_warp &w, int layer, int k, const input &h) const {
        keep(record, r.at.h + layer * H + k, w.lane, h);
    }
    __device__ void turned(const network_warp &w, const input *direction) const {
        UNROLL
        for (int k = 0; k < DIRECTION_TILES; k++) keep(record, r.at.direction + k, w.lane, direction[k]);
    }
    __device__ void view_sums(const sums *view) const {
        signs_keep<VIEW_N>(mask + r.s.decoder_depth * 2 * THREADS, view);
    }
};

/* Takes the gradients of a tile's colours back through the sigmoid and the view layer, and of its densities:
 * gone, the view layer's and, last, the density's. */
static __device__ void shown_back(const train_run &r, const network_warp &w, const warp_points &at,
                                  uint4 *record, const uint32_t *mask, uint32_t *back, const input *shown,
                                  input *gone) {
    input dout = {};
    gone[VIEW_TILES] = {};
    UNROLL
    for (int i = 0; i < 2; i++) {
        if (at.first + w.g + 8 * i >= at.end) continue;
        const int64_t point = at.number(w.g + 8 * i);
        float d[2] = {0, 0};
        for (int e = 0; e < 2; e++)
            if (2 * w.t + e < 3) { /* y = 1.002 v - 0.001 */
                const float v = (r.rgb[3 * point + 2 * w.t + e] + 0.001f) / 1.002f;
                d[e] = r.drgb[3 * point + 2 * w.t + e] * 1.002f * v * (1 - v);
            }
        dout.a[i] = pack_bf16(d[0], d[1]);
        if (w.t == 0) gone[VIEW_TILES].a[i] = pack_bf16(r.dsigma[point], 0);
    }
    UNROLL
    for (int k = 0; k < VIEW_TILES; k++) keep(record, r.at.shown + k, w.lane, shown[k]);
    keep(record, r.at.dout, w.lane, dout);
    keep(record, r.at.dalpha, w.lane, gone[VIEW_TILES]);
    network_warp wb = w;
    wb.fragments = back;
    sums view[VIEW_N] = {};
    wb.template product<1, VIEW_N>(&dout, 0, view);
    signs_apply<VIEW_N>(mask + r.s.decoder_depth * 2 * THREADS, view);
    UNROLL
    for (int k = 0; k < VIEW_TILES; k++) {
        gone[k] = input_of(view[2 * k], view[2 * k + 1]);
        keep(record, r.at.dviews + k, w.lane, gone[k]);
    }
}

/* Takes a tile's gradients back from there to its tokens. h: scratch. */
template <int H>
static __device__ void decoder_back(const train_run &r, decoder_block<H> &block, int64_t first, uint4 *record,
                                    const uint32_t *mask, const input *gone, input *h) {
    enum { N = 2 * H };
    auto &stream = block.stream;
    const int lane = block.w.lane, g = block.w.g, t = block.w.t;
    sums y[N];
    UNROLL
    for (int n = 0; n < N; n++) y[n] = {};
    stream.template layer<VIEW_TILES + 1, N>(lane, gone, y);
    {
        sums dtoken[TOKEN_N] = {};
        stream.template layer<VIEW_TILES, TOKEN_N>(lane, gone, dtoken);
        store_token(r.dfused + TOKEN, first, g, t, dtoken);
    }
    sums dtoken[TOKEN_N] = {};
    for (int layer = r.s.decoder_depth - 1; layer >= 0; layer--) {
        signs_apply<N>(mask + layer * 2 * THREADS, y);
        UNROLL
        for (int k = 0; k < H; k++) {
            h[k] = input_of(y[2 * k], y[2 * k + 1]);
            keep(record, r.at.dh + layer * H + k, lane, h[k]);
        }
        if (layer == 0 || layer == r.s.decoder_skip + 1) stream.template layer<H, TOKEN_N>(lane, h, dtoken);
        if (layer == 0) break;
        UNROLL
        for (int n = 0; n < N; n++) y[n] = {};
        stream.template layer<H, N>(lane, h, y);
    }
    store_token(r.dfused, first, g, t, dtoken);
}

/* H: k-tiles of the decoder's width. */
template <int H, bool BACK> __global__ void __launch_bounds__(THREADS, 1) decoder_kernel(train_run r) {
    WIDE_SHARED(shared, train_shared<H>());
    uint32_t *back = (uint32_t *)(shared + decoder_shared<H>()),
             *mask = back + VIEW_N * FRAGMENT + threadIdx.x;
    const network_sizes &s = r.s;
    const int64_t end = chunk_points(r);
    decoder_block<H> block;
    if (!block.begin(s, r.layers, r.layers.stages + (BACK ? r.back_stages : 0), end, shared)) return;
    if (BACK)
        for (int i = (int)threadIdx.x; i < VIEW_N * FRAGMENT / 4; i += THREADS)
            ((uint4 *)back)[i] = r.back[i];
    __syncthreads();

    for (int64_t tile = blockIdx.x; tile < block.tiles; tile += gridDim.x) {
        const int64_t group = tile * WARPS + block.warp, first = group * TILE_POINTS;
        uint4 *record = BACK ? r.records + group * r.at.tiles * WARP : nullptr;
        const train_task<H, BACK> task = {{r.list, r.base, first, end}, r, record, mask};
        input h[H], shown[VIEW_TILES];
        block.forward(s, task, h, shown);
        if constexpr (BACK) {
            input gone[VIEW_TILES + 1];
            shown_back(r, block.w, task.at, record, mask, back, shown, gone);
            decoder_back<H>(r, block, first, record, mask, gone, h);
        } else {
            block.answer(task.at, h, shown, [&](int64_t number, int channel, float value) {
                if (channel < 3)
                    r.rgb[3 * number + channel] = value;
                else
                    r.sigma[number] = value;
            });
        }
    }
    async_wait_but(0);
}

template <int H, bool BACK> static void decode_as(const train_run &r) {
    decoder_launch(decoder_kernel<H, BACK>, r.max, train_shared<H>(), r);
}

void train_decode(const train_network *n, const train_run &r, bool back) {
    if (n->h_tiles == 6)
        back ? decode_as<6, true>(r) : decode_as<6, false>(r);
    else
        back ? decode_as<8, true>(r) : decode_as<8, false>(r);
}

} // namespace cuda_backend
