/* Preparation, once per avatar: applies the linear layers before fusion to the bank. Sampling is linear and
 * zero outside, so a layer without bias commutes with it; biases are added once per point. */
#include <math.h>
#include <string.h>

#include "model/sherf/fused/inside.h"

enum { PARTS = 64 };

/* y[rows][stride] = x[rows][columns] m^T; m as the kernel wants it. */
typedef struct {
    radiance_project *kernel;
    const float *x, *m;
    float *y;
    int columns, stride;
} row_job;

static void project_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const row_job *j = arg;
    j->kernel(j->x + begin * j->columns, end - begin, j->columns, j->m, j->stride, j->y + begin * j->stride);
}

typedef struct {
    const float *from;
    uint16_t *to;
    float scale;
} half_job;

static void to_half(void *arg, int64_t begin, int64_t end, int thread) {
#if defined(__x86_64__)
    const half_job *j = arg;
    radiance_halve_amx(j->from + begin, j->scale, j->to + begin, end - begin); /* bf16 runs on AMX only */
#endif
}

/* Rows of x through m (out x columns); *y is new. stride: out rounded up to POINT_PAD. */
static sherf_status project(context *c, const float *x, int64_t rows, int columns, const double *m, int out,
                            int stride, float **y) {
    float *blocks = mem_zero(c, (size_t)columns * (size_t)stride, sizeof *blocks);
    *y = blocks ? mem_alloc(c, (size_t)rows, (size_t)stride * sizeof(float)) : NULL;
    if (*y) {
        for (int o = 0; o < out; o++)
            for (int k = 0; k < columns; k++)
                blocks[((size_t)(o / POINT_PAD) * (size_t)columns + (size_t)k) * POINT_PAD +
                       (size_t)(o % POINT_PAD)] = (float)m[(size_t)o * columns + k];
        row_job j = {(ISA_CHOICE(isa_best(), &radiance))->project, x, blocks, *y, columns, stride};
        parallel_for(c, rows, 256, project_rows, &j);
    }
    mem_free(blocks);
    return *y ? SHERF_OK : SHERF_NO_MEMORY;
}

static sherf_status prepare_planes(context *c, radiance_field *n, const radiance_weights *w,
                                   const radiance_bank *bank) {
    int d = n->s.token_width, size = bank->plane_size;
    double *m = mem_alloc(c, (size_t)d * (size_t)d, sizeof *m);
    if (!m) return SHERF_NO_MEMORY;
    for (int o = 0; o < d; o++)
        for (int k = 0; k < d; k++) m[o * d + k] = w->token_projection_w[(size_t)o * n->fused + k];
    sherf_status status = SHERF_OK;
    for (int i = 0; i < 3 && !status; i++) {
        radiance_map *p = &n->plane[i];
        *p = (radiance_map){.width = size, .height = size, .stride = round_up(d, POINT_PAD)};
        int64_t rows = (int64_t)size * size;
        if (bank->merged) continue;
        status = project(c, bank->planes + (size_t)i * (size_t)rows * (size_t)d, rows, d, m, d, p->stride,
                         &p->texel);
    }
    for (int i = 0; i < 3; i++) {
        n->plane_min[i] = bank->plane_min[i];
        n->plane_scale[i] = (float)size / (bank->plane_max[i] - bank->plane_min[i]);
    }
    mem_free(m);
    return status;
}

/* The pixel-aligned values are [features, PE(color)], cut into three runs of D; token i gets run i. */
static sherf_status prepare_map(context *c, radiance_field *n, const radiance_weights *w,
                                const radiance_bank *bank) {
    int d = n->s.token_width, f = n->s.feature_channels, out = n->map_tokens * d;
    double *m = mem_zero(c, (size_t)out * (size_t)f, sizeof *m);
    if (!m) return SHERF_NO_MEMORY;
    for (int k = 0; k < f; k++)
        for (int o = 0; o < d; o++)
            m[(size_t)(k / d * d + o) * f + k] = w->token_projection_w[(size_t)o * n->fused + d + k % d];
    radiance_map *p = &n->map;
    *p = (radiance_map){
        .width = bank->feature_width, .height = bank->feature_height, .stride = round_up(out, POINT_PAD)};
    sherf_status status = bank->merged ? SHERF_OK
                                       : project(c, bank->features, (int64_t)p->width * p->height, f, m, out,
                                                 p->stride, &p->texel);
    mem_free(m);
    if (status) return status;
    n->image_width = bank->image_width;
    n->image_height = bank->image_height;
    float width = (float)bank->image_width, height = (float)bank->image_height;
    n->map_scale[0] = (float)(p->width - 1) / width;
    n->map_scale[1] = (float)(p->height - 1) / height;
    n->image_scale[0] = (width - 1) / width;
    n->image_scale[1] = (height - 1) / height;
    size_t pixels = (size_t)bank->image_width * (size_t)bank->image_height;
    n->image = mem_alloc(c, pixels, 4 * sizeof(float));
    if (!n->image) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < pixels; i++) {
        memcpy(n->image + 4 * i, bank->image + 3 * i, 3 * sizeof(float));
        n->image[4 * i + 3] = 0;
    }
    return SHERF_OK;
}

/* Numbers the cells that touch a voxel and stores the 8 rows at their corners. */
static sherf_status make_cells(context *c, radiance_level *l, const int32_t *grid) {
    int64_t sx = l->size[2], sy = l->size[1], sz = l->size[0];
    size_t cells = (size_t)(sx + 1) * (size_t)(sy + 1) * (size_t)(sz + 1);
    l->cell = mem_alloc(c, cells, sizeof *l->cell);
    if (!l->cell) return SHERF_NO_MEMORY;
    memset(l->cell, 0xff, cells * sizeof *l->cell);
    for (int pass = 0; pass < 2; pass++) {
        int64_t count = 0;
        for (int64_t z = 0; z < sz; z++)
            for (int64_t y = 0; y < sy; y++)
                for (int64_t x = 0; x < sx; x++) {
                    int32_t row = grid[(z * sy + y) * sx + x];
                    for (int k = 0; k < 8 && row >= 0; k++) {
                        int64_t cx = x + 1 - (k & 1), cy = y + 1 - (k >> 1 & 1), cz = z + 1 - (k >> 2);
                        int32_t *cell = &l->cell[(cz * (sy + 1) + cy) * (sx + 1) + cx];
                        if (pass)
                            l->corner[*cell][k] = row + 1;
                        else if (*cell < 0)
                            *cell = (int32_t)count++;
                    }
                }
        if (!pass) l->corner = mem_zero(c, (size_t)(l->corners = count) + 1, sizeof *l->corner);
        if (!l->corner) return SHERF_NO_MEMORY;
    }
    return SHERF_OK;
}

static sherf_status project_level(context *c, radiance_field *n, const radiance_weights *w,
                                  const radiance_bank *bank, int level, int first_column) {
    int d = n->s.token_width, channels = n->s.volume_channels[level], columns = 0;
    for (int i = 0; i < POINT_LEVELS; i++) columns += n->s.volume_channels[i];
    double *m = mem_zero(c, (size_t)n->fused * (size_t)channels, sizeof *m);
    if (!m) return SHERF_NO_MEMORY;
    for (int row = 0; row < n->fused; row++)
        for (int k = 0; k < channels; k++)
            for (int j = 0; j < d; j++)
                m[(size_t)row * channels + k] +=
                    (double)w->token_projection_w[(size_t)(row % d) * n->fused + 2 * d + j] *
                    w->volume_projection_w[(size_t)(row / d * d + j) * columns + first_column + k];
    /* row 0 is for corners without a voxel */
    radiance_level *l = &n->level[level];
    int64_t voxels = bank->level[level].voxels;
    float *value = NULL;
    sherf_status status =
        project(c, bank->level[level].value, voxels, channels, m, n->fused, l->stride, &value);
    mem_free(m);
    if (status) return status;
    l->value = mem_zero(c, (size_t)voxels + 1, (size_t)l->stride * sizeof(float));
    if (l->value && voxels)
        memcpy(l->value + l->stride, value, (size_t)voxels * (size_t)l->stride * sizeof(float));
    mem_free(value);
    return l->value ? SHERF_OK : SHERF_NO_MEMORY;
}

static void shape_level(radiance_field *n, const radiance_bank *bank, int level) {
    radiance_level *l = &n->level[level];
    l->stride = round_up(n->fused, POINT_PAD);
    l->rows = bank->level[level].voxels + 1;
    memcpy(l->size, bank->level[level].size, sizeof l->size);
    for (int i = 0; i < 3; i++)
        l->voxels_per_m[i] =
            (float)((l->size[2 - i] - 1) / ((double)bank->voxel_size_m * bank->volume_size[2 - i]));
}

typedef struct {
    const context *c;
    radiance_field *n;
    const radiance_bank *bank;
    sherf_status status[POINT_LEVELS];
} cells_job;

static void cells_range(void *arg, int64_t begin, int64_t end, int thread) {
    cells_job *j = arg;
    for (int64_t l = begin; l < end; l++) {
        context own = *j->c; /* a copy for its own message; memory is shared */
        j->status[l] = make_cells(&own, &j->n->level[l], j->bank->level[l].grid);
    }
}

/* The largest magnitude, as bits: floats of one sign order like integers, and NaN is above all. */
typedef struct {
    const float *x;
    uint32_t top[PARTS];
    int64_t each, count;
} top_job;

static void top_range(void *arg, int64_t begin, int64_t end, int thread) {
    top_job *j = arg;
    for (int64_t i = begin; i < end; i++) {
        uint32_t top = 0;
        int64_t stop = (i + 1) * j->each < j->count ? (i + 1) * j->each : j->count;
        for (int64_t k = i * j->each; k < stop; k++) {
            uint32_t bits;
            memcpy(&bits, &j->x[k], 4);
            bits &= 0x7fffffffu;
            top = bits > top ? bits : top;
        }
        j->top[i] = top;
    }
}

uint32_t radiance_largest(const context *c, const float *x, int64_t count, uint32_t so_far) {
    top_job j = {.x = x, .each = (count + PARTS - 1) / PARTS, .count = count};
    parallel_for(c, PARTS, 1, top_range, &j);
    for (int i = 0; i < PARTS; i++) so_far = j.top[i] > so_far ? j.top[i] : so_far;
    return so_far;
}

typedef struct {
    float *own;        /* to be freed, or NULL */
    const float *from; /* [count] */
    uint16_t **to;     /* made: `zeros` values 0, then the values */
    int64_t count, zeros;
} half_part;

static sherf_status halve(context *c, const half_part *p, float scale) {
    uint16_t *to = mem_alloc(c, (size_t)(p->zeros + p->count), sizeof *to);
    *p->to = to;
    if (!to) return SHERF_NO_MEMORY;
    memset(to, 0, (size_t)p->zeros * sizeof *to);
    half_job j = {p->from, to + p->zeros, scale};
    parallel_for(c, p->count, 4096, to_half, &j);
    return SHERF_OK;
}

/* The bank in float16, scaled so that a sum of all its parts stays far from the type's 65504 and small values
 * far from 6e-8. */
static sherf_status prepare_half(context *c, radiance_field *n, const radiance_bank *bank) {
    const radiance_merged *merged = bank->merged;
    half_part part[4 + POINT_LEVELS];
    for (int i = 0; i < 3; i++) {
        radiance_map *p = &n->plane[i];
        part[i] = (half_part){p->texel, merged ? merged->plane[i] : p->texel, &p->half,
                              (int64_t)p->width * p->height * p->stride, 0};
        p->texel = NULL;
    }
    part[3] = (half_part){n->map.texel, merged ? merged->map : n->map.texel, &n->map.half,
                          (int64_t)n->map.width * n->map.height * n->map.stride, 0};
    n->map.texel = NULL;
    for (int i = 0; i < POINT_LEVELS; i++) {
        radiance_level *l = &n->level[i];
        part[4 + i] = (half_part){l->value, merged ? merged->level[i] : l->value + l->stride, &l->half,
                                  (l->rows - 1) * l->stride, l->stride};
        l->value = NULL;
    }
    uint32_t bits = 0;
    for (size_t i = 0; i < COUNT_OF(part); i++) bits = radiance_largest(c, part[i].from, part[i].count, bits);
    float top;
    memcpy(&top, &bits, 4);
    if (top < 1e-20f) top = 1e-20f;
    n->bank_scale = exp2f(floorf(log2f(4096.0f / top)));
    sherf_status status = SHERF_OK;
    if (!isfinite(n->bank_scale) || n->bank_scale <= 0)
        status = failure(c, SHERF_BAD_ARGUMENT, "radiance field: the avatar's features are not finite");
    for (size_t i = 0; i < COUNT_OF(part) && !status; i++) status = halve(c, &part[i], n->bank_scale);
    for (size_t i = 0; i < COUNT_OF(part); i++) mem_free(part[i].own);
    return status;
}

typedef struct {
    float *to;
    const float *from;
} copy_job;

static void copy_range(void *arg, int64_t begin, int64_t end, int thread) {
    const copy_job *j = arg;
    memcpy(j->to + begin, j->from + begin, (size_t)(end - begin) * sizeof(float));
}

/* Allocates *to: `zeros` zeros, then the values. */
static sherf_status keep(context *c, const float *from, int64_t count, int64_t zeros, float **to) {
    *to = mem_alloc(c, (size_t)(zeros + count), sizeof(float));
    if (!*to) return SHERF_NO_MEMORY;
    memset(*to, 0, (size_t)zeros * sizeof(float));
    parallel_for(c, count, 65536, copy_range, &(copy_job){*to + zeros, from});
    return SHERF_OK;
}

/* A merged bank in float32, which has rows without padding. */
static sherf_status keep_merged(context *c, radiance_field *n, const radiance_merged *merged) {
    if (n->s.token_width % POINT_PAD != 0 || n->s.feature_channels % n->s.token_width != 0)
        return failure(c, SHERF_UNSUPPORTED,
                       "radiance field: no merged bank for tokens of %d and %d features", n->s.token_width,
                       n->s.feature_channels);
    sherf_status status = SHERF_OK;
    for (int i = 0; i < 3 && !status; i++) {
        radiance_map *p = &n->plane[i];
        status = keep(c, merged->plane[i], (int64_t)p->width * p->height * p->stride, 0, &p->texel);
    }
    radiance_map *p = &n->map;
    if (!status) status = keep(c, merged->map, (int64_t)p->width * p->height * p->stride, 0, &p->texel);
    for (int i = 0; i < POINT_LEVELS && !status; i++) { /* row 0 is for corners without a voxel */
        radiance_level *l = &n->level[i];
        status = keep(c, merged->level[i], (l->rows - 1) * l->stride, l->stride, &l->value);
    }
    return status;
}

static sherf_status check_bank(context *c, const radiance_field *n, const radiance_bank *b) {
    if (b->plane_size < 1 || b->plane_size > 4096 || b->feature_width < 1 || b->feature_width > 16384 ||
        b->feature_height < 1 || b->feature_height > 16384 || b->image_width < 1 || b->image_width > 32768 ||
        b->image_height < 1 || b->image_height > 32768)
        return failure(c, SHERF_BAD_ARGUMENT, "radiance field: planes, map or picture have an odd size");
    for (int i = 0; i < 3; i++)
        if (!(b->plane_max[i] > b->plane_min[i]) || b->volume_size[i] < 1 || !(b->voxel_size_m > 0))
            return failure(c, SHERF_BAD_ARGUMENT, "radiance field: the canonical box is empty");
    for (int l = 0; l < POINT_LEVELS; l++) {
        int64_t count = 1;
        for (int i = 0; i < 3; i++) {
            int size = b->level[l].size[i];
            if (size < 1 || size > 4096)
                count = INT64_MAX / 8192;
            else
                count *= size;
        }
        if (count > (int64_t)1 << 30 || b->level[l].voxels < 0 || b->level[l].voxels >= INT32_MAX)
            return failure(c, SHERF_BAD_ARGUMENT, "radiance field: volume level %d has an odd size", l);
        for (int64_t i = 0; i < count; i++)
            if (b->level[l].grid[i] < -1 || b->level[l].grid[i] >= b->level[l].voxels)
                return failure(c, SHERF_BAD_ARGUMENT, "radiance field: volume level %d: row %d of %lld", l,
                               (int)b->level[l].grid[i], (long long)b->level[l].voxels);
    }
    return SHERF_OK;
}

sherf_status radiance_bank_prepare(context *c, radiance_field *n, const radiance_weights *w,
                                   const radiance_bank *bank) {
    sherf_status status = check_bank(c, n, bank);
    if (!status) status = prepare_planes(c, n, w, bank);
    if (!status) status = prepare_map(c, n, w, bank);
    int column = 0;
    for (int i = 0; i < POINT_LEVELS && !status; i++) {
        shape_level(n, bank, i);
        if (!bank->merged) status = project_level(c, n, w, bank, i, column);
        column += n->s.volume_channels[i];
    }
    memcpy(n->volume_min, bank->volume_min, sizeof n->volume_min);
    cells_job cells = {.c = c, .n = n, .bank = bank};
    if (!status) parallel_for(c, POINT_LEVELS, 1, cells_range, &cells);
    for (int i = 0; i < POINT_LEVELS && !status; i++) status = cells.status[i];
    if (!status && n->bf16) status = prepare_half(c, n, bank);
    if (!status && bank->merged && !n->bf16) status = keep_merged(c, n, bank->merged);
    return status;
}

/* ---- the layers ---- */
static bool matrix(context *c, radiance_matrix *m, int rows, int columns, const float *w, const float *b) {
    m->rows = rows;
    m->columns = columns;
    m->w = mem_zero(c, (size_t)rows * (size_t)(columns ? columns : 1), sizeof(float));
    m->b = mem_zero(c, (size_t)rows, sizeof(float));
    if (!m->w || !m->b) return false;
    if (w) memcpy(m->w, w, (size_t)rows * (size_t)columns * sizeof(float));
    if (b) memcpy(m->b, b, (size_t)rows * sizeof(float));
    return true;
}

/* feature_linear has no activation, so views(feature(h)) is one layer: W_v W_f h + (W_v b_f + b_v). */
static bool merge_views(context *c, const radiance_field *n, const radiance_weights *w, radiance_matrix *m) {
    int h = n->s.decoder_width, rest = n->direction_width + n->s.token_width;
    if (!matrix(c, m, n->s.view_width, h + rest, NULL, w->views_b)) return false;
    for (int o = 0; o < m->rows; o++) {
        const float *from = w->views_w + (size_t)o * (size_t)(h + rest);
        float *to = m->w + (size_t)o * (size_t)(h + rest);
        double bias = m->b[o];
        for (int f = 0; f < h; f++) bias += (double)from[f] * w->feature_b[f];
        m->b[o] = (float)bias;
        for (int k = 0; k < h; k++) {
            double sum = 0;
            for (int f = 0; f < h; f++)
                sum += (double)from[f] * w->feature_w[(size_t)f * (size_t)h + (size_t)k];
            to[k] = (float)sum;
        }
        memcpy(to + h, from + h, (size_t)rest * sizeof(float));
    }
    return true;
}

static bool color_matrix(context *c, const radiance_field *n, const radiance_weights *w, radiance_matrix *m) {
    int d = n->s.token_width, f = n->s.feature_channels;
    if (!matrix(c, m, (3 - n->color_token) * d, n->color_width, NULL, NULL)) return false;
    for (int q = 0; q < n->color_width; q++)
        for (int o = 0; o < d; o++) {
            int row = ((f + q) / d - n->color_token) * d + o;
            m->w[(size_t)row * m->columns + q] =
                w->token_projection_w[(size_t)o * n->fused + d + (f + q) % d];
        }
    return true;
}

sherf_status radiance_matrices_make(context *c, const radiance_field *n, const radiance_weights *w,
                                    radiance_matrices *out) {
    const radiance_sizes *s = &n->s;
    int d = s->token_width, all = n->attention_width, x = n->position_width + d, h = s->decoder_width;
    memset(out, 0, sizeof *out);
    bool good = (!n->color_width || color_matrix(c, n, w, &out->color)) &&
                matrix(c, &out->qkv, 3 * all, d, w->qkv_w, NULL) &&
                matrix(c, &out->attention_out, d, all, w->attention_out_w, w->attention_out_b) &&
                matrix(c, &out->mlp0, d, d, w->mlp0_w, w->mlp0_b) &&
                matrix(c, &out->mlp1, d, d, w->mlp1_w, w->mlp1_b) &&
                matrix(c, &out->alpha, 1, h, w->alpha_w, w->alpha_b) &&
                matrix(c, &out->rgb, 3, s->view_width, w->rgb_w, w->rgb_b) &&
                merge_views(c, n, w, &out->views);
    for (int i = 0; i < s->decoder_depth && good; i++)
        good = matrix(c, &out->pts[i], h,
                      i == 0                     ? x
                      : i == s->decoder_skip + 1 ? x + h
                                                 : h,
                      w->pts_w[i], w->pts_b[i]);
    return good ? SHERF_OK : SHERF_NO_MEMORY;
}

static void matrix_free(radiance_matrix *m) {
    mem_free(m->w);
    mem_free(m->b);
}

void radiance_matrices_free(radiance_matrices *m) {
#define FREE(of, name) matrix_free(&of->name);
    RADIANCE_LAYERS(FREE, m)
#undef FREE
    for (int i = 0; i < POINT_DECODER_MAX; i++) matrix_free(&m->pts[i]);
}
