/* The float32 tile for any processor: short vectors, which the compiler lowers to its instructions. */
#define LANES 4
#define ROWS 4
#define VECTORS 2
#define KERNELS radiance_plain
#include "model/sherf/fused/tile_float.h"

/* The same for all. */
size_t radiance_tile_float_bytes(const radiance_field *n) {
    const radiance_sizes *s = &n->s;
    int a = more(9 * n->attention_width, more(s->view_width, s->decoder_width));
    a = more(a, more(n->fused, 8)); /* four points' tokens with a margin each */
    int b = more(3 * n->attention_width, more(s->decoder_width, more(n->fused, n->color_width + 6)));
    int x = n->position_width + s->token_width + s->decoder_width;
    int v = s->decoder_width + n->direction_width + s->token_width;
    int rows = n->fused + a + b + x + v;
    return (size_t)rows * POINT_TILE * sizeof(float);
}
