/* The weights as they are in the device's memory, packed there into fragments: the forward ones as
 * network_bf16.cu has them, and transposed ones for the way back. */
#include "model/sherf/cuda/train.h"

namespace cuda_backend {

struct plain_matrix {
    const float *w;
    int rows, columns;
    __device__ float at(int row, int column) const {
        return row >= 0 && row < rows && column >= 0 && column < columns ? w[(int64_t)row * columns + column]
                                                                         : 0;
    }
};

/* The fragments of k_tiles x n_tiles; value(output, input). */
template <typename F> static void pack_kept(uint32_t *to, int k_tiles, int n_tiles, F value) {
    each(k_tiles * n_tiles * FRAGMENT, [=] __device__(int64_t i) {
        const int word = (int)(i % FRAGMENT), fragment = (int)(i / FRAGMENT);
        const int lane = word / 2, half = word % 2, k = fragment / n_tiles, n = fragment % n_tiles;
        const int in = 16 * k + 8 * half + 2 * (lane % 4), out = 8 * n + lane / 4;
        to[i] = pack_bf16(value(out, in), value(out, in + 1));
    });
}

/* The same as stages of the stream; returns what is behind them. */
template <typename F>
static uint32_t *pack_stages(uint32_t *to, int each_words, int k_tiles, int n_tiles, F value) {
    each(k_tiles * n_tiles * FRAGMENT, [=] __device__(int64_t i) {
        const int word = (int)(i % FRAGMENT), fragment = (int)(i / FRAGMENT);
        const int lane = word / 2, half = word % 2, k = fragment / n_tiles, n = fragment % n_tiles;
        const int in = 16 * k + 8 * half + 2 * (lane % 4), out = 8 * n + lane / 4;
        to[k / STAGE_TILES * each_words + (k % STAGE_TILES * n_tiles / 2 + n / 2) * 2 * FRAGMENT + n % 2 * 2 +
           lane * 4 + half] = pack_bf16(value(out, in), value(out, in + 1));
    });
    return to + tiles_stages(k_tiles) * each_words;
}

static void copy_floats(float *to, const float *from, int count) {
    each(count, [=] __device__(int64_t i) { to[i] = from[i]; });
}

static plain_matrix layer_of(const train_network *n, int layer) {
    const network_sizes &s = n->s;
    const int x = s.position_width + TOKEN;
    return {n->w.pts_w[layer], s.decoder_width,
            layer == 0                    ? x
            : layer == s.decoder_skip + 1 ? x + s.decoder_width
                                          : s.decoder_width};
}

/* M = V F: the view layer's first columns times the feature layer; its bias V b_F + b_V behind it. */
static void merge_views(const train_network *n, float *merged, float *bias) {
    const int h = n->s.decoder_width, columns = h + n->s.direction_width + TOKEN;
    const float *v = n->w.views_w, *f = n->w.feature_w, *bf = n->w.feature_b, *bv = n->w.views_b;
    each(n->s.view_width * (h + 1), [=] __device__(int64_t i) {
        const int o = (int)(i / (h + 1)), k = (int)(i % (h + 1));
        float sum = k < h ? 0 : bv[o];
        for (int j = 0; j < h; j++)
            sum += v[(int64_t)o * columns + j] * (k < h ? f[(int64_t)j * h + k] : bf[j]);
        if (k < h)
            merged[(int64_t)o * h + k] = sum;
        else
            bias[o] = sum;
    });
}

/* value(output, input) of the merged view layer; columns as views_column has them. */
struct merged_views {
    const float *merged, *w;
    int rows, h, columns;
    __device__ float at(int row, int column) const {
        if (row < 0 || row >= rows || column < 0 || column >= columns) return 0;
        return column < h ? merged[(int64_t)row * h + column] : w[(int64_t)row * columns + column];
    }
};

static void pack_resident(const train_network *n, const resident_places &at, uint32_t *to) {
    const network_sizes s = n->s;
    const int first = n->feature_channels % TOKEN, width = s.head_width, all = s.all;
    const float scale = 1.44269504f / sqrtf((float)width); /* attention's, and log2 e for exp2 */
    const plain_matrix token = {n->w.token_projection_w, TOKEN, TOKENS}, qkv = {n->w.qkv_w, 3 * all, TOKEN};
    const plain_matrix out = {n->w.attention_out_w, TOKEN, all}, mlp0 = {n->w.mlp0_w, TOKEN, TOKEN};
    const plain_matrix mlp1 = {n->w.mlp1_w, TOKEN, TOKEN}, alpha = {n->w.alpha_w, 1, s.decoder_width};
    const plain_matrix rgb = {n->w.rgb_w, 3, s.view_width};
    pack_kept(to + at.color * FRAGMENT, COLOR_TILES, TOKEN_N, [=] __device__(int o, int i) {
        return i < s.color_width ? token.at(o, TOKEN + first + i) : 0.0f;
    });
    for (int h = 0; h < s.heads; h++) {
        uint32_t *head = to + (at.heads + h * HEAD_EACH) * FRAGMENT;
        for (int part = 0; part < 3; part++)
            pack_kept(head + 4 * part * FRAGMENT, TOKEN_TILES, 2, [=] __device__(int o, int i) {
                return o < width ? qkv.at(part * all + h * width + o, i) * (part == 0 ? scale : 1) : 0.0f;
            });
        pack_kept(head + HEAD_QKV * FRAGMENT, 1, TOKEN_N,
                  [=] __device__(int o, int i) { return i < width ? out.at(o, h * width + i) : 0.0f; });
    }
    pack_kept(to + at.mlp0 * FRAGMENT, TOKEN_TILES, TOKEN_N,
              [=] __device__(int o, int i) { return mlp0.at(o, i); });
    pack_kept(to + at.mlp1 * FRAGMENT, TOKEN_TILES, TOKEN_N,
              [=] __device__(int o, int i) { return mlp1.at(o, i); });
    /* what bf16 keeps of a weight in the even columns, what it drops in the odd ones */
    const auto split = [=] __device__(const plain_matrix &m, int o, int i) {
        const float v = m.at(o / 2, i), high = unpack_bf16(pack_bf16(v, 0), 0);
        return o % 2 ? v - high : high;
    };
    pack_kept(to + at.alpha * FRAGMENT, n->h_tiles, 1,
              [=] __device__(int o, int i) { return split(alpha, o, i); });
    pack_kept(to + at.rgb * FRAGMENT, VIEW_TILES, 1,
              [=] __device__(int o, int i) { return split(rgb, o, i); });
}

static void pack_floats(const train_network *n, const resident_places &at, const float *views_b, float *to) {
    const radiance_weights &w = n->w;
    const float *tw = w.token_projection_w, *tb = w.token_projection_b, *vb = w.volume_projection_b;
    each(TOKENS, [=] __device__(int64_t i) { /* and what the volume projection's bias becomes in it */
                                             float sum = tb[i % TOKEN];
                                             for (int j = 0; j < TOKEN; j++)
                                                 sum += tw[i % TOKEN * TOKENS + 2 * TOKEN + j] *
                                                        vb[i / TOKEN * TOKEN + j];
                                             to[at.token_b + i] = sum;
    });
    copy_floats(to + at.norm0_w, w.norm0_w, TOKEN);
    copy_floats(to + at.norm0_b, w.norm0_b, TOKEN);
    copy_floats(to + at.norm1_w, w.norm1_w, TOKEN);
    copy_floats(to + at.norm1_b, w.norm1_b, TOKEN);
    copy_floats(to + at.out_b, w.attention_out_b, TOKEN);
    copy_floats(to + at.mlp0_b, w.mlp0_b, TOKEN);
    copy_floats(to + at.mlp1_b, w.mlp1_b, TOKEN);
    copy_floats(to + at.views_b, views_b, n->s.view_width);
    copy_floats(to + at.rgb_b, w.rgb_b, 3);
    copy_floats(to + at.rgb_b + 3, w.alpha_b, 1);
    for (int i = 0; i < n->s.decoder_depth; i++)
        copy_floats(to + at.pts_b + 16 * n->h_tiles * i, w.pts_b[i], n->s.decoder_width);
}

static void pack_back(const train_network *n, uint32_t *to) {
    const network_sizes s = n->s;
    const back_places at = back_layout(s.heads);
    const int width = s.head_width, all = s.all;
    const float scale = 1.44269504f / sqrtf((float)width);
    const plain_matrix qkv = {n->w.qkv_w, 3 * all, TOKEN}, out = {n->w.attention_out_w, TOKEN, all};
    const plain_matrix mlp0 = {n->w.mlp0_w, TOKEN, TOKEN}, mlp1 = {n->w.mlp1_w, TOKEN, TOKEN};
    const plain_matrix rgb = {n->w.rgb_w, 3, s.view_width};
    pack_kept(to + at.rgb * FRAGMENT, 1, VIEW_N, [=] __device__(int o, int i) { return rgb.at(i, o); });
    for (int h = 0; h < s.heads; h++) {
        uint32_t *head = to + (at.heads + h * BACK_EACH) * FRAGMENT;
        pack_kept(head, TOKEN_TILES, 2,
                  [=] __device__(int o, int i) { return o < width ? out.at(i, h * width + o) : 0.0f; });
        pack_kept(head + BACK_OUT * FRAGMENT, 3, TOKEN_N, [=] __device__(int o, int i) {
            const int part = i / 16, row = i % 16;
            return row < width ? qkv.at(part * all + h * width + row, o) * (part == 0 ? scale : 1) : 0.0f;
        });
    }
    pack_kept(to + at.mlp0 * FRAGMENT, TOKEN_TILES, TOKEN_N,
              [=] __device__(int o, int i) { return mlp0.at(i, o); });
    pack_kept(to + at.mlp1 * FRAGMENT, TOKEN_TILES, TOKEN_N,
              [=] __device__(int o, int i) { return mlp1.at(i, o); });
}

/* The decoder's stages, in the order in which decoder_kernel takes them. */
static void pack_stream(const train_network *n, uint32_t *to) {
    const network_sizes s = n->s;
    const int H = n->h_tiles, words = STAGE_TILES * 2 * H * FRAGMENT, h = s.decoder_width;
    const merged_views views = {n->merged, n->w.views_w, s.view_width, h, h + s.direction_width + TOKEN};
    const plain_matrix alpha = {n->w.alpha_w, 1, h};
    for (int layer = 0; layer < s.decoder_depth; layer++) {
        const plain_matrix m = layer_of(n, layer);
        to = pack_stages(to, words, layer_tiles(s, layer, H), 2 * H,
                         [=] __device__(int o, int i) { return m.at(o, pts_column(s, layer, i)); });
    }
    to = pack_stages(to, words, H + DIRECTION_TILES + TOKEN_TILES, VIEW_N,
                     [=] __device__(int o, int i) { return views.at(o, views_column(s, H, i)); });
    to = pack_stages(to, words, VIEW_TILES + 1, 2 * H, [=] __device__(int o, int i) {
        return o >= h ? 0.0f : i < 16 * VIEW_TILES ? views.at(i, o) : alpha.at(i - 16 * VIEW_TILES, o);
    });
    to = pack_stages(to, words, VIEW_TILES, TOKEN_N,
                     [=] __device__(int o, int i) { return views.at(i, h + s.direction_width + o); });
    for (int layer = s.decoder_depth - 1; layer >= 0; layer--) {
        const plain_matrix m = layer_of(n, layer);
        const bool wide = layer > 0 && layer == s.decoder_skip + 1;
        if (layer == 0 || wide)
            to = pack_stages(to, words, H, TOKEN_N,
                             [=] __device__(int o, int i) { return m.at(i, s.position_width + o); });
        if (layer > 0) {
            const int first = wide ? s.position_width + TOKEN : 0;
            to = pack_stages(to, words, H, 2 * H,
                             [=] __device__(int o, int i) { return o < h ? m.at(i, first + o) : 0.0f; });
        }
    }
}

sherf_status train_pack(tape *t, train_network *n) {
    const network_sizes &s = n->s;
    const int H = n->h_tiles;
    const resident_places at = resident_layout(s.heads, H, s.decoder_depth);
    const bool wide = s.decoder_skip >= 0 && s.decoder_skip + 1 < s.decoder_depth;
    int stages = tiles_stages(H + DIRECTION_TILES + TOKEN_TILES);
    for (int i = 0; i < s.decoder_depth; i++) stages += tiles_stages(layer_tiles(s, i, H));
    n->back_stages = tiles_stages(VIEW_TILES + 1) + tiles_stages(VIEW_TILES) +
                     tiles_stages(H) * (s.decoder_depth - 1 + 1 + (wide ? 1 : 0));
    const int64_t stream = (int64_t)(stages + n->back_stages) * STAGE_TILES * 2 * H * FRAGMENT;
    const int64_t kept = resident_words(at), back = back_layout(s.heads).fragments * FRAGMENT;
    const int64_t merged = (int64_t)s.view_width * s.decoder_width,
                  all = stream + kept + back + merged + s.view_width;
    const tensor *space = tape_tensor(t, T_I32, 1, &all);
    if (!space) return tape_status(t);
    uint32_t *words = (uint32_t *)space->data, *resident = words + stream, *there = resident + kept;
    float *views = (float *)(there + back), *views_b = views + merged;
    each(all, [=] __device__(int64_t i) { words[i] = 0; });
    n->merged = views;
    merge_views(n, views, views_b);
    pack_stream(n, words);
    pack_resident(n, at, resident);
    pack_floats(n, at, views_b, (float *)(resident + at.fragments * FRAGMENT));
    pack_back(n, there);
    n->layers = {(const uint4 *)words, (const uint4 *)resident, stages, (int)(kept * 4)};
    n->back = (const uint4 *)there;
    return finished_work(tape_context(t), "packing a radiance field");
}

} // namespace cuda_backend
