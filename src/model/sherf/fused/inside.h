/* The inside of the radiance field: what its files share. The network is prepared once (prepare.c), then
 * every tile of points goes through one function of the best instruction set. */
#ifndef SHERF_POINTNET_INSIDE_H
#define SHERF_POINTNET_INSIDE_H

#include "model/sherf/fused/radiance_field.h"
#include "render/tiles.h"

/* Rows of the bank are padded with zeros to a multiple of this. */
enum { POINT_PAD = 32 };
/* Rows of a product that the float32 kernels keep in registers. */
enum { POINT_ROWS_PLAIN = 4, POINT_ROWS_AVX2 = 4, POINT_ROWS_AVX512 = 4 };

/* A map after the linear layer: height x width texels of `stride` values (padded with zeros). */
typedef struct {
    int width, height, stride;
    float *texel;
    uint16_t *half; /* the same in float16 times the bank's scale; one of the two is NULL */
} point_map;

/* A volume level after the linear layers. A cell is the cube between 8 voxels; cell (x, y, z) has its low
 * corner at voxel (x - 1, y - 1, z - 1), so that cells half outside exist. */
typedef struct {
    int size[3];           /* z y x, voxels */
    float voxels_per_m[3]; /* along x y z */
    int32_t *cell;         /* [z + 1][y + 1][x + 1]: index of corner, or -1: nothing there */
    int32_t (*corner)[8];  /* rows of value, x fastest; 0: the row of zeros */
    int64_t rows;
    int stride; /* values a row */
    float *value;
    uint16_t *half;
} point_level;

/* y = w x + b; rows in blocks of `block`: w[row block][column][block], padded with zeros. */
typedef struct {
    int rows, columns, block;
    float *w, *b;
} point_layer;

/* Row-major matrix, before packing. */
typedef struct {
    int rows, columns;
    float *w, *b; /* b may be NULL */
} point_matrix;

/* The network after algebra that does not depend on the points (all exact in real arithmetic):
 * token = bank + color_w PE(color) + token_b; the feature layer is multiplied into the view layer. */
typedef struct {
    point_matrix color; /* rows: tokens color_token.. of D each; columns: color_width; b: all 3 D biases */
    point_matrix qkv, attention_out, mlp0, mlp1;
    point_matrix pts[POINT_DECODER_MAX];
    point_matrix alpha, rgb;
    point_matrix views; /* columns: h, PE(direction), token 1 */
} point_matrices;

typedef struct point_amx point_amx; /* packed for AMX (tile_amx.c) */

struct point_network {
    point_sizes s;
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
    point_map plane[3];
    point_map map;      /* map_tokens x D */
    float map_scale[2]; /* texel = pixel * scale */
    int image_width, image_height;
    float image_scale[2];
    float *image; /* 4 values a pixel: red, green, blue, 0 */
    float volume_min[3];
    point_level level[POINT_LEVELS];
    float bank_scale; /* of the float16 values: stored = value * scale */
    /* the layers */
    float *norm0_w, *norm0_b, *norm1_w, *norm1_b;
    float *token_b;
    point_layer color, qkv, attention_out, mlp0, mlp1, pts[POINT_DECODER_MAX], alpha, views, rgb;
    point_amx *amx;
    /* runs one tile; scratch has scratch_bytes, 64-byte aligned, one a thread */
    void (*tile)(const point_network *n, point_tile *t, void *scratch);
    size_t scratch_bytes;
};

/* radiance_field.c: all but the packing of the layers for a kind of tile. *m is made even where it fails;
 * free it.
 */
sherf_status point_network_start(context *c, const point_sizes *sizes, const point_weights *weights,
                                 const point_bank *bank, bool bf16, point_matrices *m, point_network **out);

/* prepare.c */
/* The largest magnitude of x, or so_far where that is more, as the bits of a float; NaN is above all. */
uint32_t point_largest(const context *c, const float *x, int64_t count, uint32_t so_far);
sherf_status point_bank_prepare(context *c, point_network *n, const point_weights *w, const point_bank *bank);
sherf_status point_matrices_make(context *c, const point_network *n, const point_weights *w,
                                 point_matrices *out);
void point_matrices_free(point_matrices *m);

/* One float32 file per instruction set, all from tile_float.h. */
void point_tile_plain(const point_network *n, point_tile *t, void *scratch);
void point_tile_avx2(const point_network *n, point_tile *t, void *scratch);
void point_tile_avx512(const point_network *n, point_tile *t, void *scratch);
/* to [rows][stride] = from [rows][columns] times m, [block of POINT_PAD outputs][column][POINT_PAD]. */
typedef void point_project(const float *from, int64_t rows, int columns, const float *m, int stride,
                           float *to);
point_project point_project_plain, point_project_avx2, point_project_avx512;
size_t point_tile_float_bytes(const point_network *n);

/* amx_pack.c: bf16. m is used up. */
bool point_amx_fits(const point_sizes *s);
sherf_status point_amx_create(context *c, point_network *n, point_matrices *m);
void point_amx_free(point_amx *a);
/* to = float16(from * scale), to nearest even; the products must be finite and below 65504. */
void point_halve_amx(const float *from, float scale, uint16_t *to, int64_t count);

static inline int round_up(int n, int to) {
    return (n + to - 1) / to * to;
}

#endif
