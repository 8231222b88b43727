/* Active voxels of a volume's levels and the rules of its sparse convolutions. */
#include "model/sparse_levels.h"

#include <stdlib.h>
#include <string.h>

/* Rows [begin, end) of a stride-1 or stride-2 rule: out[o] = sum_k W[k] in[stride * o + k - 1]. */
typedef struct {
    const int32_t *zyx;  /* of the output voxels, 3 each */
    const int32_t *grid; /* of the input level */
    const int *size;     /* of the input level */
    int stride;
    int32_t *rule;
} rule_job;

static void rule_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const rule_job *j = arg;
    for (int64_t o = begin; o < end; o++)
        for (int k = 0; k < 27; k++) {
            int z = j->zyx[3 * o] * j->stride + k / 9 - 1;
            int y = j->zyx[3 * o + 1] * j->stride + k / 3 % 3 - 1;
            int x = j->zyx[3 * o + 2] * j->stride + k % 3 - 1;
            bool inside = z >= 0 && y >= 0 && x >= 0 && z < j->size[0] && y < j->size[1] && x < j->size[2];
            j->rule[27 * o + k] = inside ? j->grid[((int64_t)z * j->size[1] + y) * j->size[2] + x] : -1;
        }
}

static int32_t *rule_create(context *c, int64_t voxels, const int32_t *zyx, const int32_t *grid,
                            const int size[3], int stride) {
    int32_t *rule = mem_alloc(c, (size_t)voxels * 27, sizeof *rule);
    if (!rule) return NULL;
    rule_job job = {zyx, grid, size, stride, rule};
    parallel_for(c, voxels, 256, rule_rows, &job);
    return rule;
}

static int compare_i64(const void *a, const void *b) {
    int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

/* Sorted, unique linear voxel numbers -> the level's grid and the voxels' z, y, x. */
static sherf_status level_fill(context *c, sparse_level *level, int64_t *number, int64_t count,
                               int32_t **zyx) {
    const int *size = level->size;
    qsort(number, (size_t)count, sizeof *number, compare_i64);
    int64_t unique = 0;
    for (int64_t i = 0; i < count; i++)
        if (!i || number[i] != number[i - 1]) number[unique++] = number[i];
    size_t cells = (size_t)size[0] * (size_t)size[1] * (size_t)size[2];
    int32_t *grid = mem_alloc(c, cells, sizeof *grid);
    *zyx = mem_alloc(c, (size_t)unique * 3, sizeof **zyx);
    level->grid = grid;
    level->voxels = unique;
    if (!grid || !*zyx) return SHERF_NO_MEMORY;
    memset(grid, 0xff, cells * sizeof *grid);
    for (int64_t i = 0; i < unique; i++) {
        grid[number[i]] = (int32_t)i;
        (*zyx)[3 * i] = (int32_t)(number[i] / ((int64_t)size[1] * size[2]));
        (*zyx)[3 * i + 1] = (int32_t)(number[i] / size[2] % size[1]);
        (*zyx)[3 * i + 2] = (int32_t)(number[i] % size[2]);
    }
    return SHERF_OK;
}

/* The voxels a stride-2 layer reaches: 2 o + k - 1 = i for some k in 0..2. At most two per axis. */
static int64_t *reached(context *c, int64_t voxels, const int32_t *zyx, const int size[3], int64_t *count) {
    int64_t *number = mem_alloc(c, (size_t)voxels * 8 + 1, sizeof *number), n = 0;
    if (!number) return NULL;
    for (int64_t i = 0; i < voxels; i++) {
        int low[3], high[3];
        for (int a = 0; a < 3; a++) {
            int v = zyx[3 * i + a];
            low[a] = v / 2; /* ceil((v - 1) / 2) for v >= 0 */
            high[a] = (v + 1) / 2 < size[a] ? (v + 1) / 2 : size[a] - 1;
        }
        for (int z = low[0]; z <= high[0]; z++)
            for (int y = low[1]; y <= high[1]; y++)
                for (int x = low[2]; x <= high[2]; x++)
                    number[n++] = ((int64_t)z * size[1] + y) * size[2] + x;
    }
    *count = n;
    return number;
}

sherf_status sparse_levels_create(context *c, sparse_level *level, int levels, int ruled, int vertices,
                                  const int32_t *vertex_zyx) {
    int32_t *zyx = NULL, *next_zyx = NULL;
    int64_t count = vertices, *number = mem_alloc(c, (size_t)vertices, sizeof *number);
    sherf_status status = number ? SHERF_OK : SHERF_NO_MEMORY;
    for (int v = 0; number && v < vertices; v++) number[v] = sparse_voxel(level, vertex_zyx + 3 * (int64_t)v);
    for (int l = 0; l < levels && status == SHERF_OK; l++) {
        status = level_fill(c, &level[l], number, count, &next_zyx);
        mem_free(number);
        number = NULL;
        if (status != SHERF_OK) break;
        if (l) {
            level[l - 1].down_rule =
                rule_create(c, level[l].voxels, next_zyx, level[l - 1].grid, level[l - 1].size, 2);
            if (!level[l - 1].down_rule) status = SHERF_NO_MEMORY;
        }
        mem_free(zyx);
        zyx = next_zyx;
        next_zyx = NULL;
        if (l < ruled && status == SHERF_OK) {
            level[l].rule = rule_create(c, level[l].voxels, zyx, level[l].grid, level[l].size, 1);
            if (!level[l].rule) status = SHERF_NO_MEMORY;
        }
        if (l + 1 < levels && status == SHERF_OK) {
            number = reached(c, level[l].voxels, zyx, level[l + 1].size, &count);
            if (!number) status = SHERF_NO_MEMORY;
        }
    }
    mem_free(number);
    mem_free(zyx);
    mem_free(next_zyx);
    return status;
}

void sparse_levels_free(sparse_level *level, int levels) {
    for (int l = 0; l < levels; l++) {
        mem_free(level[l].grid);
        mem_free(level[l].rule);
        mem_free(level[l].down_rule);
    }
}
