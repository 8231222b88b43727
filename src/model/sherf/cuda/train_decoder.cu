/* The radiance field in training: forwards for its result, or forwards and through the decoder back. As in
 * network_bf16.cu a warp takes 16 points through all layers in its registers, and the stages of the weights
 * come round; those of the way back, transposed, follow the forward ones. What the way back needs of the
 * forward one are the signs of each layer's sums, 2 words a lane and layer, in shared memory; what the
 * weights' gradients need goes to the group's record. Points beyond the end are the last one again with
 * gradients of 0. */
#include "model/sherf/cuda/train.h"

namespace cuda_backend {

constexpr size_t mask_bytes = (POINT_DECODER_MAX + 1) * 2 * THREADS * 4;
template <int H> constexpr size_t decoder_shared() {
    return (size_t)STAGES * STAGE_TILES * 2 * H * FRAGMENT * 4 + WARPS * TILE_POINTS * ENCODED_PITCH * 2 +
           resident_max + mask_bytes + VIEW_N * FRAGMENT * 4;
}

/* The signs of N sums of 16 x 8, as bits of this lane. */
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

/* Sums of one token to the points' rows of 2 TOKEN. */
static __device__ void store_token(float *to, int64_t first, int g, int t, const sums *y) {
    UNROLL
    for (int n = 0; n < TOKEN_N; n++) {
        UNROLL
        for (int e = 0; e < 4; e++)
            to[(first + g + e / 2 * 8) * (2 * TOKEN) + 8 * n + 2 * t + e % 2] = y[n].c[e];
    }
}

/* H: k-tiles of the decoder's width. */
template <int H, bool BACK> __global__ void __launch_bounds__(THREADS, 1) decoder_kernel(train_run r) {
    enum {
        N = 2 * H,
        STAGE_WORDS = STAGE_TILES * N * FRAGMENT,
        ENCODED_BYTES = TILE_POINTS * ENCODED_PITCH * 2
    };
    WIDE_SHARED(shared, decoder_shared<H>());
    uint32_t *ring = (uint32_t *)shared, *resident = ring + STAGES * STAGE_WORDS + WARPS * ENCODED_BYTES / 4;
    uint32_t *back = resident + resident_max / 4, *mask = back + VIEW_N * FRAGMENT + threadIdx.x;
    const network_sizes &s = r.s;
    const int lane = (int)threadIdx.x % WARP, warp = (int)threadIdx.x / WARP, g = lane / 4, t = lane % 4;
    const resident_places at = resident_layout(s.heads, H, s.decoder_depth);
    const network_warp w = {resident,
                            (const float *)(resident + at.fragments * FRAGMENT),
                            (uint16_t *)(ring + STAGES * STAGE_WORDS) + warp * (ENCODED_BYTES / 2),
                            lane,
                            g,
                            t};
    const int64_t end = chunk_points(r);
    const int64_t tiles = end > 0 ? (end + BLOCK_POINTS - 1) / BLOCK_POINTS : 0;
    const int64_t own = tiles > blockIdx.x ? (tiles - blockIdx.x - 1) / gridDim.x + 1 : 0;
    if (own == 0) return;
    const int stages = r.layers.stages + (BACK ? r.back_stages : 0);
    weight_stream<STAGE_WORDS> stream = {r.layers.stream, ring, stages, 0, own * stages, 0};
    for (int i = (int)threadIdx.x; i < r.layers.resident_bytes / 16; i += THREADS)
        ((uint4 *)resident)[i] = r.layers.resident[i];
    if (BACK)
        for (int i = (int)threadIdx.x; i < VIEW_N * FRAGMENT / 4; i += THREADS)
            ((uint4 *)back)[i] = r.back[i];
    stream.begin();
    __syncthreads();

    for (int64_t tile = blockIdx.x; tile < tiles; tile += gridDim.x) {
        const int64_t group = tile * WARPS + warp, first = group * TILE_POINTS;
        const auto place = [&](int point) { return first + point < end ? first + point : end - 1; };
        const auto number = [&](int point) { return (int64_t)r.list[r.base + place(point)]; };
        uint4 *record = BACK ? r.records + group * r.at.tiles * WARP : nullptr;
        input x[X_TILES], seen[TOKEN_TILES];
        {
            sums token[3][TOKEN_N];
            const int64_t rows[2] = {place(g), place(g + 8)};
            load_tokens(r, w.values + at.token_b, rows, t, 3, token);
            if (s.color_width) {
                input encoded[COLOR_TILES];
                w.template encode<COLOR_TILES>([&](int p, int k) { return r.color[3 * place(p) + k]; },
                                               s.color_frequencies, s.color_width, encoded);
                w.template product<COLOR_TILES, TOKEN_N>(encoded, at.color, token[2]);
            }
            w.transform(s, at, token);
            UNROLL
            for (int k = 0; k < TOKEN_TILES; k++) {
                x[PLACE_TILES + k] = input_of(token[0][2 * k], token[0][2 * k + 1]);
                seen[k] = input_of(token[1][2 * k], token[1][2 * k + 1]);
            }
        }
        w.template encode<PLACE_TILES>([&](int p, int k) { return r.canonical[3 * number(p) + k]; },
                                       s.position_frequencies, s.position_width, x);
        if (BACK) {
            UNROLL
            for (int k = 0; k < X_TILES; k++) keep(record, r.at.x + k, lane, x[k]);
            UNROLL
            for (int k = 0; k < TOKEN_TILES; k++) keep(record, r.at.token1 + k, lane, seen[k]);
        }
        input h[H];
        for (int layer = 0; layer < s.decoder_depth; layer++) {
            sums y[N];
            const float *b = w.values + at.pts_b + 8 * N * layer;
            UNROLL
            for (int n = 0; n < N; n++) y[n] = bias_of(b, n, t);
            if (layer == 0) {
                stream.template layer<X_TILES, N>(lane, x, y);
            } else if (layer == s.decoder_skip + 1) {
                input both[X_TILES + H];
                UNROLL
                for (int k = 0; k < X_TILES + H; k++)
                    both[k] = k < X_TILES ? x[k] : h[k < X_TILES ? 0 : k - X_TILES];
                stream.template layer<X_TILES + H, N>(lane, both, y);
            } else {
                stream.template layer<H, N>(lane, h, y);
            }
            if (BACK) signs_keep<N>(mask + layer * 2 * THREADS, y);
            UNROLL
            for (int k = 0; k < H; k++) {
                h[k] = input_of(positive(y[2 * k]), positive(y[2 * k + 1]));
                if (BACK) keep(record, r.at.h + layer * H + k, lane, h[k]);
            }
        }
        sums view[VIEW_N];
        {
            input all[H + DIRECTION_TILES + TOKEN_TILES];
            UNROLL
            for (int k = 0; k < H; k++) all[k] = h[k];
            w.template encode<DIRECTION_TILES>([&](int p, int k) { return r.direction[3 * number(p) + k]; },
                                               s.direction_frequencies, s.direction_width, all + H);
            UNROLL
            for (int k = 0; k < TOKEN_TILES; k++) all[H + DIRECTION_TILES + k] = seen[k];
            if (BACK) {
                UNROLL
                for (int k = 0; k < DIRECTION_TILES; k++) keep(record, r.at.direction + k, lane, all[H + k]);
            }
            UNROLL
            for (int n = 0; n < VIEW_N; n++) view[n] = bias_of(w.values + at.views_b, n, t);
            stream.template layer<H + DIRECTION_TILES + TOKEN_TILES, VIEW_N>(lane, all, view);
        }
        input shown[VIEW_TILES];
        UNROLL
        for (int k = 0; k < VIEW_TILES; k++)
            shown[k] = input_of(positive(view[2 * k]), positive(view[2 * k + 1]));
        if (!BACK) {
            sums density = {}, rgb = {};
            w.template product<H, 1>(h, at.alpha, &density);
            w.template product<VIEW_TILES, 1>(shown, at.rgb, &rgb);
            UNROLL
            for (int i = 0; i < 2; i++) { /* lane t has colour t; lane 0 the density, too */
                if (first + g + 8 * i >= end) continue;
                const int64_t point = number(g + 8 * i);
                const float y = rgb.c[2 * i] + rgb.c[2 * i + 1] + w.values[at.rgb_b + (t < 3 ? t : 0)];
                if (t < 3) r.rgb[3 * point + t] = 1.002f / (1.0f + expf(-y)) - 0.001f;
                if (t == 0) r.sigma[point] = density.c[2 * i] + density.c[2 * i + 1] + w.values[at.rgb_b + 3];
            }
            continue;
        }
        /* back */
        sums y[N];
        input gone[VIEW_TILES + 1]; /* the view layer's gradient, and the density's */
        {
            input dout = {};
            gone[VIEW_TILES] = {};
            UNROLL
            for (int i = 0; i < 2; i++) {
                if (first + g + 8 * i >= end) continue;
                const int64_t point = number(g + 8 * i);
                float d[2] = {0, 0};
                for (int e = 0; e < 2; e++)
                    if (2 * t + e < 3) { /* through the sigmoid: y = 1.002 v - 0.001 */
                        const float v = (r.rgb[3 * point + 2 * t + e] + 0.001f) / 1.002f;
                        d[e] = r.drgb[3 * point + 2 * t + e] * 1.002f * v * (1 - v);
                    }
                dout.a[i] = pack_bf16(d[0], d[1]);
                if (t == 0) gone[VIEW_TILES].a[i] = pack_bf16(r.dsigma[point], 0);
            }
            UNROLL
            for (int k = 0; k < VIEW_TILES; k++) keep(record, r.at.shown + k, lane, shown[k]);
            keep(record, r.at.dout, lane, dout);
            keep(record, r.at.dalpha, lane, gone[VIEW_TILES]);
            signs_keep<VIEW_N>(mask + s.decoder_depth * 2 * THREADS, view);
            network_warp wb = w;
            wb.fragments = back;
            UNROLL
            for (int n = 0; n < VIEW_N; n++) view[n] = {};
            wb.template product<1, VIEW_N>(&dout, 0, view);
            signs_apply<VIEW_N>(mask + s.decoder_depth * 2 * THREADS, view);
            UNROLL
            for (int k = 0; k < VIEW_TILES; k++) {
                gone[k] = input_of(view[2 * k], view[2 * k + 1]);
                keep(record, r.at.dviews + k, lane, gone[k]);
            }
        }
        UNROLL
        for (int n = 0; n < N; n++) y[n] = {};
        stream.template layer<VIEW_TILES + 1, N>(lane, gone, y);
        {
            sums dtoken[TOKEN_N] = {};
            stream.template layer<VIEW_TILES, TOKEN_N>(lane, gone, dtoken);
            store_token(r.dfused + TOKEN, first, g, t, dtoken);
        }
        sums dtoken[TOKEN_N] = {};
        for (int layer = s.decoder_depth - 1; layer >= 0; layer--) {
            signs_apply<N>(mask + layer * 2 * THREADS, y);
            UNROLL
            for (int k = 0; k < H; k++) {
                h[k] = input_of(y[2 * k], y[2 * k + 1]);
                keep(record, r.at.dh + layer * H + k, lane, h[k]);
            }
            if (layer == 0 || layer == s.decoder_skip + 1) stream.template layer<H, TOKEN_N>(lane, h, dtoken);
            if (layer == 0) break;
            UNROLL
            for (int n = 0; n < N; n++) y[n] = {};
            stream.template layer<H, N>(lane, h, y);
        }
        store_token(r.dfused, first, g, t, dtoken);
    }
    async_wait_but(0);
}

template <int H, bool BACK> static void decode_as(const train_run &r) {
    const int64_t tiles = divided_up(r.max, BLOCK_POINTS);
    const int blocks = multiprocessors();
    if (tiles > 0)
        launch_wide(decoder_kernel<H, BACK>, dim3((unsigned)(tiles < blocks ? tiles : blocks)), dim3(THREADS),
                    decoder_shared<H>(), r);
}

void train_decode(const train_network *n, const train_run &r, bool back) {
    if (n->h_tiles == 6)
        back ? decode_as<6, true>(r) : decode_as<6, false>(r);
    else
        back ? decode_as<8, true>(r) : decode_as<8, false>(r);
}

} // namespace cuda_backend
