/* The inside of the radiance field, shared by its files. The network is prepared once (prepare.c), then every
 * tile of points goes through one function of the best instruction set. */
#ifndef SHERF_RADIANCE_INSIDE_H
#define SHERF_RADIANCE_INSIDE_H

#include "model/sherf/fused/radiance_field.h"
#include "sampling/tiles.h"

#ifdef __cplusplus /* CUDA's sources */
extern "C" {
#endif

/* Rows of the bank are padded with zeros to a multiple of this. */
enum { POINT_PAD = 32 };

/* A map after the linear layer: height x width texels of `stride` values (padded with zeros). */
typedef struct {
    int width, height, stride;
    float *texel;
    uint16_t *half; /* the same in float16 times the bank's scale; one of the two is NULL */
} radiance_map;

/* A volume level after the linear layers. A cell is the cube between 8 voxels; cell (x, y, z) has its low
 * corner at voxel (x - 1, y - 1, z - 1), so that cells half outside exist. */
typedef struct {
    int size[3];           /* z y x, voxels */
    float voxels_per_m[3]; /* along x y z */
    int32_t *cell;         /* [z + 1][y + 1][x + 1]: index of corner, or -1: nothing there */
    int32_t (*corner)[8];  /* rows of value, x fastest; 0: the row of zeros */
    int64_t corners, rows;
    int stride; /* values per row */
    float *value;
    uint16_t *half;
} radiance_level;

/* y = w x + b; rows in blocks of `block`: w[row block][column][row]. The last block has the remaining rows;
 * in training it is padded with zeros to a whole block. */
typedef struct {
    int rows, columns, block;
    float *w, *b;
} radiance_layer;

/* Row-major matrix, before packing; y = w x + b. */
typedef struct {
    int rows, columns;
    float *w, *b; /* b may be NULL */
} radiance_matrix;

/* The network after algebra that does not depend on the points (all exact in real arithmetic):
 * token = bank + color_w PE(color) + token_b; the feature layer is multiplied into the view layer. */
typedef struct {
    /* color: rows are tokens color_token.. of D each; columns: color_width; b: all 3 D biases.
     * views: columns are h, PE(direction), token 1 */
    RADIANCE_MEMBERS(radiance_matrix)
} radiance_matrices;

typedef struct radiance_amx radiance_amx; /* packed for AMX (tile_amx.c) */

struct radiance_field {
    radiance_sizes s;
    bool bf16; /* the AMX way is used */
    isa_level isa;
    /* derived widths */
    int fused;           /* 3 D */
    int position_width;  /* of PE(position) */
    int direction_width; /* of PE(direction) */
    int color_width;     /* of PE(color), cut off */
    int color_token;     /* the first token with color values */
    int map_tokens;      /* tokens with feature map values */
    int attention_width; /* heads x head_width */
    /* the bank */
    float plane_min[3], plane_scale[3]; /* texel = (x - min) * scale - 0.5 */
    radiance_map plane[3];
    radiance_map map;   /* map_tokens x D */
    float map_scale[2]; /* texel = pixel * scale */
    int image_width, image_height;
    float image_scale[2];
    float *image; /* 4 values per pixel: red, green, blue, 0 */
    float volume_min[3];
    radiance_level level[POINT_LEVELS];
    float bank_scale; /* of the float16 values: stored = value * scale */
    /* the layers */
    float *norm0_w, *norm0_b, *norm1_w, *norm1_b;
    float *token_b;
    RADIANCE_MEMBERS(radiance_layer)
    radiance_amx *amx;
    /* runs one tile; scratch has scratch_bytes, 64-byte aligned, one per thread */
    void (*tile)(const radiance_field *n, point_tile *t, void *scratch);
    size_t scratch_bytes;
};

/* radiance_field.c: all but the packing of the layers for a kind of tile. *m must be freed even after a
 * failure. */
sherf_status radiance_field_start(context *c, const radiance_sizes *sizes, const radiance_weights *weights,
                                  const radiance_bank *bank, bool bf16, radiance_matrices *m,
                                  radiance_field **out);
/* y = W x + b, W(row, column) = w[row * row_step + column * column_step]; b may be NULL. padded: see
 * radiance_layer. */
sherf_status radiance_layer_pack(context *c, int block, bool padded, int rows, int columns, const float *w,
                                 int row_step, int column_step, const float *b, radiance_layer *out);
void radiance_layer_free(radiance_layer *l);

/* prepare.c */
/* The larger of so_far and the largest magnitude of x, as the bits of a float. NaN counts as above all. */
uint32_t radiance_largest(const context *c, const float *x, int64_t count, uint32_t so_far);
sherf_status radiance_bank_prepare(context *c, radiance_field *n, const radiance_weights *w,
                                   const radiance_bank *bank);
sherf_status radiance_matrices_make(context *c, const radiance_field *n, const radiance_weights *w,
                                    radiance_matrices *out);
void radiance_matrices_free(radiance_matrices *m);

/* to [rows][stride] = from [rows][columns] times m, [block of POINT_PAD outputs][column][POINT_PAD]. */
typedef void radiance_project(const float *from, int64_t rows, int columns, const float *m, int stride,
                              float *to);
/* float32: one file per instruction set, all from tile_float.h. */
typedef struct {
    int rows; /* of a product's block that stays in registers */
    void (*tile)(const radiance_field *n, point_tile *t, void *scratch);
    radiance_project *project;
} radiance_kernels;
extern const radiance_kernels radiance_plain, radiance_neon, radiance_avx2, radiance_avx512;
size_t radiance_tile_float_bytes(const radiance_field *n);

/* amx_pack.c: bf16. Overwrites m. */
bool radiance_amx_fits(const radiance_sizes *s);
sherf_status radiance_amx_create(context *c, radiance_field *n, radiance_matrices *m);
void radiance_amx_free(radiance_amx *a);
/* to = float16(from * scale), to nearest even; the products must be finite and below 65504. */
void radiance_halve_amx(const float *from, float scale, uint16_t *to, int64_t count);

static inline int round_up(int n, int to) {
    return (n + to - 1) / to * to;
}

#ifdef __cplusplus
}
#endif

#endif
