/* The bf16 tile for AMX with AVX512-FP16 (the build compiles this file for them). */
#if (defined(__AMX_BF16__) || defined(__AMXBF16__)) && defined(__AVX512FP16__) /* clang 14 says AMXBF16 */
#define AMX_GROUPS (POINT_TILE / 16)
#include "model/sherf/fused/tile_amx.h"

/* Scratch of the fusion: B tiles of the norms and of attention, sums. */
typedef struct {
    char *normed, *mixed;
    float *sums;
} fusion_space;

enum { ONE = WIDTH * GROUP, ALL = 3 * ONE };

/* Adds eight rows, from R * 8 on, of the previous sums, while tile instructions run. */
#define ADD(R)                                                                                               \
    do {                                                                                                     \
        ORDER();                                                                                             \
        for (int row = (R)*8 * GROUP; row < ((R) + 1) * 8 * GROUP; row += GROUP)                             \
            _mm512_store_ps(to + row, _mm512_add_ps(_mm512_load_ps(to + row), _mm512_load_ps(from + row)));  \
        ORDER();                                                                                             \
    } while (0)

/* Tokens 0 and 1 of all groups += W x. x: B tiles of group and token, `pitch` bytes apart; the weights, up to
 * two blocks, stay in tiles 4 to 7. Sums start at zero and the vector units add them: loading a tile of sums
 * is expensive. sums: room for two tokens, alternating. */
static void add_tokens(const tiles *l, const char *x, size_t pitch, float *sums, float *token) {
    const char *weight = (const char *)l->w;
    const bool two = l->blocks > 1;
    float *to = sums + ONE, *from = sums + ONE; /* nothing useful before the first */
    tile_load(4, weight, 64);
    tile_load(5, weight + TILE, 64);
    if (two) {
        tile_load(6, weight + 2 * TILE, 64);
        tile_load(7, weight + 3 * TILE, 64);
    }
    for (int k = 0; k < 2 * AMX_GROUPS; k++, x += pitch) {
        _tile_zero(0);
        _tile_zero(1);
        tile_load(2, x, 64);
        if (two) tile_load(3, x + TILE, 64);
        _tile_dpbf16ps(0, 4, 2);
        ADD(0);
        _tile_dpbf16ps(1, 5, 2);
        ADD(1);
        if (two) _tile_dpbf16ps(0, 6, 3);
        ADD(2);
        if (two) _tile_dpbf16ps(1, 7, 3);
        ADD(3);
        from = sums + (k & 1) * ONE;
        to = token + (k >> 1) * ALL + (k & 1) * ONE;
        _tile_stored(0, from, 64);
        _tile_stored(1, from + ONE / 2, 64);
    }
    for (int r = 0; r < 4; r++) ADD(r);
}

/* A token's sums of the first feed-forward layer, with its bias through GELU to a B tile. */
static inline void gelu_tile(const float *x, const float *bias, char *out) {
    for (int r = 0; r < WIDTH; r += 2, x += 2 * GROUP)
        _mm512_store_si512(
            out + r * 32,
            pairs(gelu_16(_mm512_add_ps(_mm512_load_ps(x), _mm512_set1_ps(bias[r]))),
                  gelu_16(_mm512_add_ps(_mm512_load_ps(x + GROUP), _mm512_set1_ps(bias[r + 1])))));
}

/* normed: of tokens 0 and 1 of all groups; through the first layer and GELU in place, with one token's GELU
 * running during the next one's products. sums: room for two tokens. */
static void mlp_tokens(const tiles *l, char *normed, float *sums) {
    tile_load(4, (const char *)l->w, 64);
    tile_load(5, (const char *)l->w + TILE, 64);
    for (int k = 0; k < 2 * AMX_GROUPS; k++) {
        float *y = sums + (k & 1) * ONE;
        _tile_zero(0);
        _tile_zero(1);
        tile_load(2, normed + k * TILE, 64);
        tile_product(0, 4, 2);
        tile_product(1, 5, 2);
        ORDER();
        if (k) gelu_tile(sums + (~k & 1) * ONE, l->bias, normed + (k - 1) * TILE);
        ORDER();
        _tile_stored(0, y, 64);
        _tile_stored(1, y + ONE / 2, 64);
    }
    ORDER();
    gelu_tile(sums + ONE, l->bias, normed + (2 * AMX_GROUPS - 1) * TILE);
    ORDER();
}

/* token [group][3 x 32][16]: tokens 0 and 1 in place (token 2 is only key and value, since the decoder never
 * reads its result); the reader adds the last bias, mlp1's. */
static void transformer(const radiance_field *n, float *token, fusion_space f) {
    const radiance_amx *a = n->amx;
    size_t mixed = (size_t)a->mixed_blocks * TILE;
    for (int k = 0; k < 3 * AMX_GROUPS; k++)
        norm_tile(token + k * ONE, n->norm0_w, n->norm0_b, f.normed + k * TILE);
    for (int g = 0; g < AMX_GROUPS; g++) {
        qkv_product(n, f.normed + g * 3 * TILE, f.sums);
        attention(n, f.sums, f.mixed + (size_t)g * 2 * mixed, NULL);
    }
    ORDER();
    if (a->mixed_blocks <= 2)
        add_tokens(&a->attention_out, f.mixed, mixed, f.sums, token);
    else
        for (int k = 0; k < 2 * AMX_GROUPS; k++)
            add_product(&a->attention_out, f.mixed + (size_t)k * mixed,
                        token + (k >> 1) * ALL + (k & 1) * ONE);
    ORDER();
    for (int k = 0; k < 2 * AMX_GROUPS; k++)
        norm_tile(token + (k >> 1) * ALL + (k & 1) * ONE, n->norm1_w, n->norm1_b, f.normed + k * TILE);
    ORDER();
    mlp_tokens(&a->mlp0, f.normed, f.sums);
    add_tokens(&a->mlp1, f.normed, TILE, f.sums, token);
}

/* ---- the tile ---- */
/* x: [PE(position), token 0], h; v: h, [PE(direction), token 1] */
static void decoder(const radiance_field *n, channels x, channels v, channels a, channels b, float *c,
                    point_tile *t) {
    const radiance_amx *p = n->amx;
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

void radiance_tile_amx(const radiance_field *n, point_tile *t, void *scratch) {
    const radiance_amx *p = n->amx;
    char *base = scratch;
    channels x = {base + p->x, p->x_pitch}, v = {base + p->v, p->v_pitch}, a = {base + p->a, p->h_pitch},
             b = {base + p->b, p->h_pitch};
    float *token = (float *)(base + p->token), *row = (float *)(base + p->row);
    fusion_space f = {base + p->normed, base + p->mixed, (float *)(base + p->sums)};
    tiles_begin();
    memset(base + p->color_tiles, 0, (size_t)p->color.blocks * TILE);
    for (int g = 0; g < AMX_GROUPS; g++)
        sample_group(n, t, g * GROUP, (samples *)(base + p->sample), row, base + p->color_tiles,
                     token + g * 3 * WIDTH * GROUP);
    /* two ones for its bias after attention's result, then zeros */
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
void radiance_halve_amx(const float *from, float scale, uint16_t *to, int64_t count) {
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
