/* The radiance field: preparation and dispatch. */
#include "model/sherf/fused/radiance_field.h"

#include <string.h>

#include "model/sherf/fused/inside.h"

/* ---- creation ---- */
static sherf_status check_sizes(context *c, const radiance_sizes *s) {
    bool good = s->token_width >= 1 && s->token_width <= 256 && s->feature_channels >= 1 &&
                s->feature_channels <= 3 * s->token_width && s->heads >= 1 && s->heads <= 64 &&
                s->head_width >= 1 && s->head_width <= 256 && s->decoder_width >= 1 &&
                s->decoder_width <= 2048 && s->decoder_depth >= 1 && s->decoder_depth <= POINT_DECODER_MAX &&
                s->decoder_skip < s->decoder_depth - 1 && s->view_width >= 1 && s->view_width <= 2048;
    for (int i = 0; i < POINT_LEVELS; i++)
        good = good && s->volume_channels[i] >= 1 && s->volume_channels[i] <= 2048;
    good = good && s->position_frequencies >= 0 && s->position_frequencies <= 16 &&
           s->direction_frequencies >= 0 && s->direction_frequencies <= 16 && s->color_frequencies >= 0 &&
           s->color_frequencies <= 16;
    if (!good) return failure(c, SHERF_BAD_ARGUMENT, "radiance field: sizes out of range");
    if (3 * s->token_width - s->feature_channels > 3 * (1 + 2 * s->color_frequencies))
        return failure(c, SHERF_BAD_ARGUMENT,
                       "radiance field: %d feature channels and the encoded color do not fill 3 tokens of %d",
                       s->feature_channels, s->token_width);
    return SHERF_OK;
}

sherf_status radiance_layer_pack(context *c, int block, bool padded, int rows, int columns, const float *w,
                                 int row_step, int column_step, const float *b, radiance_layer *out) {
    const int room = padded ? round_up(rows, block) : rows;
    *out = (radiance_layer){.rows = rows, .columns = columns, .block = block};
    out->w = mem_zero(c, (size_t)room * (size_t)columns, sizeof(float));
    out->b = mem_zero(c, (size_t)room, sizeof(float));
    if (!out->w || !out->b) return SHERF_NO_MEMORY;
    if (b) memcpy(out->b, b, (size_t)rows * sizeof(float));
    for (int r = 0; r < rows; r++) {
        const int first = r / block * block, left = room - first, height = left < block ? left : block;
        for (int k = 0; k < columns; k++)
            out->w[(size_t)first * (size_t)columns + (size_t)(k * height + r - first)] =
                w[(size_t)r * (size_t)row_step + (size_t)k * (size_t)column_step];
    }
    return SHERF_OK;
}

static sherf_status pack(context *c, int block, const radiance_matrix *m, radiance_layer *out) {
    return radiance_layer_pack(c, block, false, m->rows, m->columns, m->w, m->columns, 1, m->b, out);
}

static sherf_status pack_float(context *c, radiance_field *n, const radiance_matrices *m) {
    const radiance_kernels *k = ISA_CHOICE(n->isa, &radiance);
    sherf_status status = SHERF_OK;
#define PACK(to, name)                                                                                       \
    if (!status && m->name.w) status = pack(c, k->rows, &m->name, &to->name);
    RADIANCE_LAYERS(PACK, n) /* there is no `color` where its width is 0 */
#undef PACK
    for (int i = 0; i < n->s.decoder_depth && !status; i++) status = pack(c, k->rows, &m->pts[i], &n->pts[i]);
    n->tile = k->tile;
    n->scratch_bytes = radiance_tile_float_bytes(n);
    return status;
}

static float *copy(context *c, const float *from, int count) {
    float *to = mem_alloc(c, (size_t)count, sizeof *to);
    if (to) memcpy(to, from, (size_t)count * sizeof *to);
    return to;
}

/* token_b: the projection's bias, and the volume projection's bias after its projection. */
static sherf_status copy_vectors(context *c, radiance_field *n, const radiance_weights *w) {
    int d = n->s.token_width;
    n->norm0_w = copy(c, w->norm0_w, d);
    n->norm0_b = copy(c, w->norm0_b, d);
    n->norm1_w = copy(c, w->norm1_w, d);
    n->norm1_b = copy(c, w->norm1_b, d);
    n->token_b = mem_alloc(c, (size_t)n->fused, sizeof(float));
    if (!n->norm0_w || !n->norm0_b || !n->norm1_w || !n->norm1_b || !n->token_b) return SHERF_NO_MEMORY;
    for (int row = 0; row < n->fused; row++) {
        double sum = w->token_projection_b[row % d];
        for (int j = 0; j < d; j++)
            sum += (double)w->token_projection_w[(size_t)(row % d) * n->fused + 2 * d + j] *
                   w->volume_projection_b[row / d * d + j];
        n->token_b[row] = (float)sum;
    }
    return SHERF_OK;
}

/* The kernel's offsets are 32 bits. */
static bool amx_possible(const radiance_sizes *s, const radiance_bank *b) {
#if defined(__x86_64__)
    return isa_has_bf16() && (int64_t)b->feature_width * b->feature_height <= 10000000 &&
           (int64_t)b->image_width * b->image_height <= 100000000 && radiance_amx_fits(s);
#else
    return false;
#endif
}

sherf_status radiance_field_start(context *c, const radiance_sizes *sizes, const radiance_weights *weights,
                                  const radiance_bank *bank, bool bf16, radiance_matrices *m,
                                  radiance_field **out) {
    *out = NULL;
    sherf_status status = check_sizes(c, sizes);
    if (status) return status;
    radiance_field *n = mem_zero(c, 1, sizeof *n);
    if (!n) return SHERF_NO_MEMORY;
    n->s = *sizes;
    n->isa = isa_best();
    n->bf16 = bf16;
    n->fused = 3 * sizes->token_width;
    n->position_width = 3 * (1 + 2 * sizes->position_frequencies);
    n->direction_width = 3 * (1 + 2 * sizes->direction_frequencies);
    n->color_width = n->fused - sizes->feature_channels;
    n->color_token = sizes->feature_channels / sizes->token_width;
    n->map_tokens = (sizes->feature_channels + sizes->token_width - 1) / sizes->token_width;
    n->attention_width = sizes->heads * sizes->head_width;
    status = radiance_bank_prepare(c, n, weights, bank);
    if (!status) status = copy_vectors(c, n, weights);
    if (!status) status = radiance_matrices_make(c, n, weights, m);
    if (status)
        radiance_field_free(n);
    else
        *out = n;
    return status;
}

sherf_status radiance_field_create(context *c, const radiance_sizes *sizes, const radiance_weights *weights,
                                   const radiance_bank *bank, bool bf16, radiance_field **out) {
    radiance_matrices m = {0};
    radiance_field *n = NULL;
    *out = NULL;
    bf16 = bf16 && amx_possible(sizes, bank);
    sherf_status status = radiance_field_start(c, sizes, weights, bank, bf16, &m, &n);
#if defined(__x86_64__)
    if (!status && n->bf16) status = radiance_amx_create(c, n, &m);
#endif
    if (!status && !n->bf16) status = pack_float(c, n, &m);
    radiance_matrices_free(&m);
    if (status)
        radiance_field_free(n);
    else
        *out = n;
    return status;
}

void radiance_layer_free(radiance_layer *l) {
    mem_free(l->w);
    mem_free(l->b);
}

void radiance_field_free(radiance_field *n) {
    if (!n) return;
#define FREE(of, name) radiance_layer_free(&of->name);
    RADIANCE_LAYERS(FREE, n)
#undef FREE
    for (int i = 0; i < POINT_DECODER_MAX; i++) radiance_layer_free(&n->pts[i]);
    for (int i = 0; i < 3; i++) {
        mem_free(n->plane[i].texel);
        mem_free(n->plane[i].half);
    }
    mem_free(n->map.texel);
    mem_free(n->map.half);
    mem_free(n->image);
    for (int i = 0; i < POINT_LEVELS; i++) {
        mem_free(n->level[i].cell);
        mem_free(n->level[i].corner);
        mem_free(n->level[i].value);
        mem_free(n->level[i].half);
    }
#if defined(__x86_64__)
    radiance_amx_free(n->amx);
#endif
    mem_free(n->norm0_w);
    mem_free(n->norm0_b);
    mem_free(n->norm1_w);
    mem_free(n->norm1_b);
    mem_free(n->token_b);
    mem_free(n);
}

/* ---- points through the network ---- */
bool radiance_field_in_bf16(const radiance_field *n) {
    return n->bf16;
}

static void answer(const void *self, point_tile *t, void *scratch) {
    const radiance_field *n = self;
    n->tile(n, t, scratch);
}

static tile_source source_of(const radiance_field *n) {
    return (tile_source){n, answer, n->scratch_bytes, n->bf16};
}

sherf_status radiance_field_run(context *c, const radiance_field *n, const point_set *points, float *rgb,
                                float *sigma) {
    const tile_source source = source_of(n);
    return tiles_run(c, &source, points, rgb, sigma);
}

sherf_status radiance_field_render(context *c, const radiance_field *n, const ray_bundle *rays,
                                   const point_set *points, const float background[3], bool early_stop,
                                   sherf_frame *frame) {
    const tile_source source = source_of(n);
    return tiles_render(c, &source, rays, points, background, early_stop, frame);
}
