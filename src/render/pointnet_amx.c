/* The bf16 tile for AMX with AVX512-FP16 (the build compiles this file for them). */
#if (defined(__AMX_BF16__) || defined(__AMXBF16__)) && defined(__AVX512FP16__) /* clang 14 says AMXBF16 */
#define AMX_GROUPS (POINT_TILE / 16)
#include "render/pointnet_amx.h"

/* Scratch of the fusion: B tiles of the norms and of attention, sums. */
typedef struct {
    char *normed, *mixed;
    float *sums;
} fusion_space;

/* token [group][3 x 32][16]: tokens 0 and 1 in place (token 2 serves as key and value only, since the decoder
 * never reads its result); the last bias, mlp1's, is left to the reader. */
static void transformer(const point_network *n, float *token, fusion_space f) {
    const point_amx *a = n->amx;
    enum { ONE = WIDTH * GROUP, ALL = 3 * ONE };
    size_t mixed = (size_t)a->mixed_blocks * TILE;
    for (int k = 0; k < 3 * AMX_GROUPS; k++)
        norm_tile(token + k * ONE, n->norm0_w, n->norm0_b, f.normed + k * TILE);
    for (int g = 0; g < AMX_GROUPS; g++) {
        qkv_product(n, f.normed + g * 3 * TILE, f.sums);
        attention(n, f.sums, f.mixed + (size_t)g * 2 * mixed, NULL);
    }
    ORDER();
    for (int k = 0; k < 2 * AMX_GROUPS; k++)
        add_product(&a->attention_out, f.mixed + (size_t)k * mixed, token + (k >> 1) * ALL + (k & 1) * ONE);
    ORDER();
    for (int k = 0; k < 2 * AMX_GROUPS; k++)
        norm_tile(token + (k >> 1) * ALL + (k & 1) * ONE, n->norm1_w, n->norm1_b, f.normed + k * TILE);
    for (int k = 0; k < 2 * AMX_GROUPS; k++) mlp_product(&a->mlp0, f.normed + k * TILE, f.sums + k * 512);
    for (int k = 0; k < 2 * AMX_GROUPS; k++)
        for (int r = 0; r < WIDTH; r += 2) {
            const float *x = f.sums + k * 512 + r * GROUP, *bias = a->mlp0.bias + r;
            _mm512_store_si512(
                f.normed + k * TILE + r * 32,
                pairs(gelu_16(_mm512_add_ps(_mm512_load_ps(x), _mm512_set1_ps(bias[0]))),
                      gelu_16(_mm512_add_ps(_mm512_load_ps(x + GROUP), _mm512_set1_ps(bias[1])))));
        }
    ORDER();
    for (int k = 0; k < 2 * AMX_GROUPS; k++)
        add_product(&a->mlp1, f.normed + k * TILE, token + (k >> 1) * ALL + (k & 1) * ONE);
    ORDER();
}

/* ---- the tile ---- */
/* x: [PE(position), token 0], h; v: h, [PE(direction), token 1] */
static void decoder(const point_network *n, channels x, channels v, channels a, channels b, float *c,
                    point_tile *t) {
    const point_amx *p = n->amx;
    channels in = x;
    waiting w = {0};
    for (int i = 0; i < n->s.decoder_depth; i++) {
        bool last = i == n->s.decoder_depth - 1, skip = i == n->s.decoder_skip && !last;
        channels out = last ? v : skip ? further(x, p->x_blocks) : in.at == a.at ? b : a;
        dense(&p->pts[i], in, out, 0, c, &w);
        in = skip ? x : out;
    }
    dense(&p->views, v, a, 0, c, &w);
    finish_all(&w);
    float *y = c + AMX_GROUPS * 256;
    dense_last(&p->alpha, v, c);
    dense_last(&p->rgb, a, y);
    for (int g = 0; g < AMX_GROUPS; g++, c += 256, y += 256) {
        __m512 sigma = _mm512_add_ps(_mm512_load_ps(c), _mm512_load_ps(c + GROUP));
        _mm512_store_ps(t->out[3] + g * GROUP, _mm512_add_ps(sigma, _mm512_set1_ps(p->alpha.bias[0])));
        for (int k = 0; k < 3; k++) {
            __m512 e = _mm512_add_ps(_mm512_load_ps(y + k * GROUP), _mm512_load_ps(y + (k + 3) * GROUP));
            e = _mm512_add_ps(e, _mm512_set1_ps(p->rgb.bias[k]));
            e = exp2_16(_mm512_mul_ps(e, _mm512_set1_ps(-1.44269504f)));
            e = _mm512_div_ps(_mm512_set1_ps(1.002f), _mm512_add_ps(e, _mm512_set1_ps(1)));
            _mm512_store_ps(t->out[k] + g * GROUP, _mm512_sub_ps(e, _mm512_set1_ps(0.001f)));
        }
    }
}

void point_tile_amx(const point_network *n, point_tile *t, void *scratch) {
    const point_amx *p = n->amx;
    char *base = scratch;
    channels x = {base + p->x, p->x_pitch}, v = {base + p->v, p->v_pitch}, a = {base + p->a, p->h_pitch},
             b = {base + p->b, p->h_pitch};
    float *token = (float *)(base + p->token), *row = (float *)(base + p->row);
    fusion_space f = {base + p->normed, base + p->mixed, (float *)(base + p->sums)};
    load_config();
    memset(base + p->color_tiles, 0, (size_t)p->color.blocks * TILE);
    for (int g = 0; g < AMX_GROUPS; g++)
        sample_group(n, t, g * GROUP, (samples *)(base + p->sample), row, base + p->color_tiles,
                     token + g * 3 * WIDTH * GROUP);
    /* behind attention's result: two ones for its bias, then zeros */
    const __m512i ones = _mm512_set1_epi32(0x3f803f80);
    for (int k = 0; k < 2 * AMX_GROUPS; k++)
        for (int r = n->attention_width / 2; r < p->mixed_blocks * 16; r++)
            _mm512_store_si512(f.mixed + k * p->mixed_blocks * TILE + r * PAIR,
                               r == n->attention_width / 2 ? ones : _mm512_setzero_si512());
    transformer(n, token, f);
    for (int g = 0; g < AMX_GROUPS; g++) {
        const float *first = token + g * 3 * WIDTH * GROUP;
        pack_input((const float(*)[POINT_TILE])t->position, g, n->s.position_frequencies, first, p->mlp1_b,
                   row, x.at + (size_t)g * x.pitch, p->x_blocks);
        pack_input((const float(*)[POINT_TILE])t->direction, g, n->s.direction_frequencies,
                   first + WIDTH * GROUP, p->mlp1_b, row,
                   v.at + (size_t)g * v.pitch + (size_t)p->h_blocks * TILE, p->v_blocks);
    }
    ORDER();
    decoder(n, x, v, a, b, (float *)(base + p->c), t);
    _tile_release();
}
void point_halve_amx(const float *from, float scale, uint16_t *to, int64_t count) {
    const __m512 s = _mm512_set1_ps(scale);
    for (int64_t i = 0; i < count; i += 16) {
        const __mmask16 mask = count - i < 16 ? (__mmask16)((1u << (count - i)) - 1) : (__mmask16)0xffff;
        __m512 x = _mm512_mul_ps(_mm512_maskz_loadu_ps(mask, from + i), s);
        _mm256_mask_storeu_epi16(to + i, mask,
                                 _mm512_cvtps_ph(x, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC));
    }
}
#else
typedef int nothing_here;
#endif
