/* Packs the radiance field's layers, in the forward form for frames and training, on the device into bf16
 * fragments: the decoder as stages of a stream, fusion and all biases as the resident part of shared memory.
 */
#include "model/sherf/cuda/pack.h"

namespace cuda_backend {

static void copy_floats(float *to, const float *from, int count) {
    each(count, [=] __device__(int64_t i) { to[i] = from[i]; });
}

static void pack_heads(const forward_weights &f, const network_sizes &s, uint32_t *heads) {
    const plain_matrix qkv = f.qkv, out = f.attention_out;
    const int width = s.head_width, all = s.all;
    const float scale = query_scale(s);
    for (int h = 0; h < s.heads; h++) {
        uint32_t *head = heads + h * HEAD_EACH * FRAGMENT;
        for (int part = 0; part < 3; part++) /* q, k, v */
            pack_kept(head + 4 * part * FRAGMENT, TOKEN_TILES, 2, [=] __device__(int o, int i) {
                return o < width ? qkv.at(part * all + h * width + o, i) * (part == 0 ? scale : 1) : 0.0f;
            });
        pack_kept(head + HEAD_QKV * FRAGMENT, 1, TOKEN_N,
                  [=] __device__(int o, int i) { return i < width ? out.at(o, h * width + i) : 0.0f; });
    }
}

static void pack_plain(uint32_t *to, int k_tiles, const plain_matrix &m) {
    pack_kept(to, k_tiles, TOKEN_N, [=] __device__(int o, int i) { return m.at(o, i); });
}

/* The bits of a weight that bf16 keeps, in even columns, and those that it drops, in odd ones. */
static void pack_split(uint32_t *to, int k_tiles, const plain_matrix &m) {
    pack_kept(to, k_tiles, 1, [=] __device__(int o, int i) {
        const float v = m.at(o / 2, i), high = unpack_bf16(pack_bf16(v, 0), 0);
        return o % 2 ? v - high : high;
    });
}

static void pack_floats(const forward_weights &f, const network_sizes &s, int h_tiles,
                        const resident_places &at, float *to) {
    const struct {
        int at;
        const float *from;
        int count;
    } all[] = {{at.token_b, f.token_b, 3 * TOKEN},    {at.norm0_w, f.norm0_w, TOKEN},
               {at.norm0_b, f.norm0_b, TOKEN},        {at.norm1_w, f.norm1_w, TOKEN},
               {at.norm1_b, f.norm1_b, TOKEN},        {at.out_b, f.attention_out_b, TOKEN},
               {at.mlp0_b, f.mlp0_b, TOKEN},          {at.mlp1_b, f.mlp1_b, TOKEN},
               {at.views_b, f.views_b, s.view_width}, {at.rgb_b, f.rgb_b, 3},
               {at.rgb_b + 3, f.alpha_b, 1}};
    for (const auto &one : all) copy_floats(to + one.at, one.from, one.count);
    for (int i = 0; i < s.decoder_depth; i++)
        copy_floats(to + at.pts_b + 16 * h_tiles * i, f.pts_b[i], s.decoder_width);
}

int forward_stages(const network_sizes &s, int h_tiles) {
    int stages = tiles_stages(h_tiles + DIRECTION_TILES + TOKEN_TILES);
    for (int i = 0; i < s.decoder_depth; i++) stages += tiles_stages(layer_tiles(s, i, h_tiles));
    return stages;
}

uint32_t *pack_forward(const forward_weights &f, const network_sizes &sizes, int h_tiles, uint32_t *stream,
                       uint32_t *resident) {
    const network_sizes s = sizes;
    const resident_places at = resident_layout(s.heads, h_tiles, s.decoder_depth);
    const int words = stage_words(h_tiles);
    pack_plain(resident + at.color * FRAGMENT, COLOR_TILES, f.color);
    pack_heads(f, s, resident + at.heads * FRAGMENT);
    pack_plain(resident + at.mlp0 * FRAGMENT, TOKEN_TILES, f.mlp0);
    pack_plain(resident + at.mlp1 * FRAGMENT, TOKEN_TILES, f.mlp1);
    pack_split(resident + at.alpha * FRAGMENT, h_tiles, f.alpha);
    pack_split(resident + at.rgb * FRAGMENT, VIEW_TILES, f.rgb);
    pack_floats(f, s, h_tiles, at, (float *)(resident + at.fragments * FRAGMENT));
    for (int layer = 0; layer < s.decoder_depth; layer++) {
        const plain_matrix m = f.pts[layer];
        stream = pack_stages(stream, words, layer_tiles(s, layer, h_tiles), 2 * h_tiles,
                             [=] __device__(int o, int i) { return m.at(o, pts_column(s, layer, i)); });
    }
    const plain_matrix h = f.views_h, rest = f.views_rest;
    return pack_stages(
        stream, words, h_tiles + DIRECTION_TILES + TOKEN_TILES, VIEW_N,
        [=] __device__(int o, int i) { return joined_at(h, rest, o, views_column(s, h_tiles, i)); });
}

} // namespace cuda_backend
