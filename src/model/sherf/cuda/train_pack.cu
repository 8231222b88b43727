/* Packs the weights in the device's memory into fragments for a training step: the forward ones as for frames
 * (network_pack.cu), and transposed ones for the backward pass. */
#include "model/sherf/cuda/pack.h"
#include "model/sherf/cuda/train.h"

namespace cuda_backend {

static plain_matrix layer_of(const train_network *n, int layer) {
    const network_sizes &s = n->s;
    const int x = s.position_width + TOKEN;
    const int columns = layer == 0 ? x : layer == s.decoder_skip + 1 ? x + s.decoder_width : s.decoder_width;
    return {n->w.pts_w[layer], s.decoder_width, columns, columns};
}

/* M = V F: the view layer's first columns times the feature layer; its bias V b_F + b_V after it. */
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

/* The tokens' biases, including the volume projection's bias after its projection. */
static void merge_token_bias(const train_network *n, float *bias) {
    const float *tw = n->w.token_projection_w, *tb = n->w.token_projection_b, *vb = n->w.volume_projection_b;
    each(TOKENS, [=] __device__(int64_t i) {
        float sum = tb[i % TOKEN];
        for (int j = 0; j < TOKEN; j++)
            sum += tw[i % TOKEN * TOKENS + 2 * TOKEN + j] * vb[i / TOKEN * TOKEN + j];
        bias[i] = sum;
    });
}

static forward_weights forward_of(const train_network *n, const float *views_b, const float *token_b) {
    const network_sizes &s = n->s;
    const radiance_weights &w = n->w;
    const int h = s.decoder_width, rest = s.direction_width + TOKEN, first = n->feature_channels % TOKEN;
    forward_weights f = {};
    f.color = {w.token_projection_w + TOKEN + first, TOKEN, s.color_width, TOKENS};
    f.qkv = {w.qkv_w, 3 * s.all, TOKEN, TOKEN};
    f.attention_out = {w.attention_out_w, TOKEN, s.all, s.all};
    f.mlp0 = {w.mlp0_w, TOKEN, TOKEN, TOKEN};
    f.mlp1 = {w.mlp1_w, TOKEN, TOKEN, TOKEN};
    f.alpha = {w.alpha_w, 1, h, h};
    f.rgb = {w.rgb_w, 3, s.view_width, s.view_width};
    f.views_h = {n->merged, s.view_width, h, h};
    f.views_rest = {w.views_w + h, s.view_width, rest, h + rest};
    f.token_b = token_b;
    f.norm0_w = w.norm0_w, f.norm0_b = w.norm0_b, f.norm1_w = w.norm1_w, f.norm1_b = w.norm1_b;
    f.attention_out_b = w.attention_out_b;
    f.mlp0_b = w.mlp0_b, f.mlp1_b = w.mlp1_b, f.views_b = views_b;
    f.rgb_b = w.rgb_b, f.alpha_b = w.alpha_b;
    for (int i = 0; i < s.decoder_depth; i++) {
        f.pts[i] = layer_of(n, i);
        f.pts_b[i] = w.pts_b[i];
    }
    return f;
}

static void pack_back(const forward_weights &f, const network_sizes &s, uint32_t *to) {
    const back_places at = back_layout(s.heads);
    const int width = s.head_width, all = s.all;
    const float scale = query_scale(s);
    const plain_matrix qkv = f.qkv, out = f.attention_out, mlp0 = f.mlp0, mlp1 = f.mlp1, rgb = f.rgb;
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

/* The decoder's stages for the backward pass, in the order in which decoder_kernel takes them. */
static void pack_stream_back(const forward_weights &f, const network_sizes &sizes, int H, uint32_t *to) {
    const network_sizes s = sizes;
    const int words = stage_words(H), h = s.decoder_width;
    const plain_matrix views = f.views_h, rest = f.views_rest, alpha = f.alpha;
    to = pack_stages(to, words, VIEW_TILES + 1, 2 * H, [=] __device__(int o, int i) {
        return o >= h ? 0.0f : i < 16 * VIEW_TILES ? views.at(i, o) : alpha.at(i - 16 * VIEW_TILES, o);
    });
    to = pack_stages(to, words, VIEW_TILES, TOKEN_N,
                     [=] __device__(int o, int i) { return rest.at(i, s.direction_width + o); });
    for (int layer = s.decoder_depth - 1; layer >= 0; layer--) {
        const plain_matrix m = f.pts[layer];
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
    const int stages = forward_stages(s, H);
    n->back_stages = tiles_stages(VIEW_TILES + 1) + tiles_stages(VIEW_TILES) +
                     tiles_stages(H) * (s.decoder_depth - 1 + 1 + (wide ? 1 : 0));
    const int64_t stream = (int64_t)(stages + n->back_stages) * stage_words(H);
    const int64_t kept = resident_words(at), back = back_layout(s.heads).fragments * FRAGMENT;
    const int64_t merged = (int64_t)s.view_width * s.decoder_width,
                  all = stream + kept + back + merged + s.view_width + TOKENS;
    const tensor *space = tape_tensor(t, T_I32, 1, &all);
    if (!space) return tape_status(t);
    uint32_t *words = (uint32_t *)space->data, *resident = words + stream, *there = resident + kept;
    float *views = (float *)(there + back), *views_b = views + merged, *token_b = views_b + s.view_width;
    each(all, [=] __device__(int64_t i) { words[i] = 0; });
    n->merged = views;
    merge_views(n, views, views_b);
    merge_token_bias(n, token_b);
    const forward_weights f = forward_of(n, views_b, token_b);
    pack_stream_back(f, s, H, pack_forward(f, s, H, words, resident));
    pack_back(f, s, there);
    n->layers = {(uint4 *)words, (uint4 *)resident, stages, (int)(kept * 4)};
    n->back = (const uint4 *)there;
    return finished_work(tape_context(t), "packing a radiance field");
}

} // namespace cuda_backend
