/* Every other texel of an atlas, and the means between them. */
#include "baked/texels.h"

#include <string.h>

/* Texels that are neighbours on the surface are at most this many times the usual distance apart. */
static const float apart_max = 3;

static float square_apart(const float *p, const float *q) {
    float sum = 0;
    for (int k = 0; k < 3; k++) sum += (p[k] - q[k]) * (p[k] - q[k]);
    return sum;
}

/* The mean of the squared distances between texels side by side in a row. */
static float square_side(const atlas *a, const float *positions) {
    double sum = 0;
    int64_t count = 0;
    for (int64_t i = 0; i + 1 < a->texels; i++)
        if (a->texel[i + 1] == a->texel[i] + 1 && a->face[i] == a->face[i + 1]) {
            sum += (double)square_apart(positions + 3 * i, positions + 3 * i + 3);
            count++;
        }
    return count ? (float)(sum / (double)count) : 0;
}

/* Finds the texels of even row and column around texel i, one to four. Returns 0 if one of them is missing or
 * on another piece. at: the texel of each place of the picture, -1: none. */
static int neighbours(const atlas *a, const float *positions, const int32_t *at, float square_max, int64_t i,
                      int32_t out[4]) {
    const int row = a->texel[i] / a->side_px, column = a->texel[i] % a->side_px;
    int n = 0;
    for (int dr = -(row & 1); dr <= (row & 1); dr += 2 - !(row & 1))
        for (int dc = -(column & 1); dc <= (column & 1); dc += 2 - !(column & 1)) {
            if (row + dr >= a->side_px || column + dc >= a->side_px) return 0;
            const int32_t t = at[(row + dr) * a->side_px + column + dc];
            if (t < 0 || square_apart(positions + 3 * i, positions + 3 * (int64_t)t) > square_max) return 0;
            out[n++] = t;
        }
    return n;
}

sherf_status texel_mesh_make(context *c, const atlas *a, const float *positions, texel_mesh *out) {
    const size_t n = (size_t)a->texels, places = (size_t)a->side_px * (size_t)a->side_px;
    const float square_max = 2 * apart_max * apart_max * square_side(a, positions);
    int32_t *at = mem_alloc(c, places, sizeof *at), *number = mem_alloc(c, n, sizeof *number);
    *out = (texel_mesh){.texel = mem_alloc(c, n, sizeof *out->texel),
                        .from = mem_alloc(c, n, 4 * sizeof *out->from)};
    if (!at || !number || !out->texel || !out->from) {
        mem_free(at);
        mem_free(number);
        return SHERF_NO_MEMORY;
    }
    memset(at, 0xff, places * sizeof *at);
    for (int64_t i = 0; i < a->texels; i++) at[a->texel[i]] = (int32_t)i;
    for (int64_t i = 0; i < a->texels; i++) {
        int32_t *from = out->from + 4 * i;
        const int row = a->texel[i] / a->side_px, column = a->texel[i] % a->side_px;
        const int count = (row | column) & 1 ? neighbours(a, positions, at, square_max, i, from) : 0;
        for (int k = count; k < 4; k++) from[k] = -1;
        number[i] = count ? -1 : (int32_t)out->count;
        if (!count) out->texel[out->count++] = (int32_t)i;
    }
    for (int64_t i = 0; i < a->texels; i++) {
        int32_t *from = out->from + 4 * i;
        if (number[i] >= 0) from[0] = number[i];
        for (int k = 0; k < 4 && number[i] < 0 && from[k] >= 0; k++) from[k] = number[from[k]];
    }
    mem_free(at);
    mem_free(number);
    return SHERF_OK;
}

void texel_mesh_free(texel_mesh *mesh) {
    mem_free(mesh->texel);
    mem_free(mesh->from);
    *mesh = (texel_mesh){0};
}

void texel_mesh_spread(const atlas *a, const texel_mesh *mesh, const float *some, float *all) {
    for (int64_t i = 0; i < a->texels; i++) {
        const int32_t *from = mesh->from + 4 * i;
        float sum[3] = {0};
        int n = 0;
        for (; n < 4 && from[n] >= 0; n++)
            for (int k = 0; k < 3; k++) sum[k] += some[3 * (size_t)from[n] + (size_t)k];
        for (int k = 0; k < 3; k++) all[3 * i + k] = sum[k] / (float)n;
    }
}
