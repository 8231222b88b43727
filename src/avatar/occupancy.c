/* Where an avatar has nothing. The density at a point depends on its place in canonical space alone, whatever
 * the pose and the camera, so the network is queried once on a lattice and frames leave out what lies in the
 * empty cells of this occupancy grid. */
#include <math.h>
#include <string.h>

#include "avatar/canonical.h"

/* The features jump where the nearest vertex changes, so a cell counts as empty only when its neighbours do.
 * Cells below the skin are not queried: they are full, or hidden. */
static const float cell_m = 0.01f, known_m = 0.06f, below_m = 0.01f;
enum { CELLS_MAX = 1 << 24, UNKNOWN = 0, EMPTY = 1, FULL = 2 };

typedef struct {
    const sherf_avatar *a;
    const body_model *m;
    occupancy_grid *cells;
    float *normal;    /* of the canonical vertices */
    int32_t *nearest; /* by cell: the canonical vertex nearest to its middle, -1: not queried */
    uint8_t *state;   /* by cell */
    canonical_batch batch;
    int32_t *cell; /* of its points */
} empty_job;

static void middle(const occupancy_grid *e, size_t cell, float at[3]) {
    const size_t x = (size_t)e->cells[0], y = (size_t)e->cells[1];
    const size_t i[3] = {cell % x, cell / x % y, cell / x / y};
    for (int k = 0; k < 3; k++) at[k] = e->min[k] + ((float)i[k] + 0.5f) / e->per_m;
}

/* Above the vertex's tangent plane. */
static float height(const empty_job *j, const float at[3], int32_t vertex) {
    const float *v = j->m->canonical->vertices_smpl + 3 * (size_t)vertex, *n = j->normal + 3 * (size_t)vertex;
    return (at[0] - v[0]) * n[0] + (at[1] - v[1]) * n[1] + (at[2] - v[2]) * n[2];
}

static void near_range(void *arg, int64_t begin, int64_t end, int thread) {
    const empty_job *j = arg;
    const vertex_grid *grid = body_canonical_grid(j->m);
    const vertex_shell *shell = vertex_grid_shell(grid);
    const int64_t row = j->cells->cells[0];
    for (int64_t i = begin * row; i < end * row; i++) {
        float at[3], d2 = INFINITY;
        int voxel[3];
        bool inside = true;
        middle(j->cells, (size_t)i, at);
        for (int k = 0; k < 3; k++) {
            const float v = (at[k] - shell->min[k]) / shell->cell_m;
            inside = inside && v >= 0 && v < (float)shell->cells[k];
            voxel[k] = inside ? (int)v : 0;
        }
        const size_t word =
            ((size_t)voxel[2] * (size_t)shell->cells[1] + (size_t)voxel[1]) * (size_t)shell->words +
            (size_t)voxel[0] / 32;
        inside = inside && shell->bit[word] >> (voxel[0] % 32) & 1; /* elsewhere a search takes long */
        const int32_t found = inside ? vertex_grid_nearest_from(grid, at, -1, &d2) : -1;
        j->nearest[i] = found >= 0 && d2 < known_m * known_m && height(j, at, found) > -below_m ? found : -1;
    }
}

static sherf_status query_batch(context *c, empty_job *j) {
    canonical_batch *b = &j->batch;
    sherf_status status = canonical_batch_run(c, j->a, j->m, b);
    for (int64_t i = 0; i < b->set.count && status == SHERF_OK; i++)
        j->state[j->cell[i]] = b->sigma[i] > 0 ? FULL : EMPTY;
    b->set.count = 0;
    return status;
}

static sherf_status query_all(context *c, empty_job *j, int64_t count) {
    canonical_batch *b = &j->batch;
    sherf_status status = canonical_batch_make(c, CANONICAL_BATCH, b);
    j->cell = mem_alloc(c, CANONICAL_BATCH, sizeof *j->cell);
    if (!j->cell) status = SHERF_NO_MEMORY;
    for (int64_t i = 0; i < count && status == SHERF_OK; i++) {
        if (j->nearest[i] >= 0) {
            const int64_t k = b->set.count++;
            j->cell[k] = (int32_t)i;
            b->nearest[k] = j->nearest[i];
            middle(j->cells, (size_t)i, b->set.canonical + 3 * k);
        }
        if (b->set.count == CANONICAL_BATCH || (i + 1 == count && b->set.count)) status = query_batch(c, j);
    }
    canonical_batch_free(b);
    mem_free(j->cell);
    return status;
}

/* Bits of the empty cells without a full one around them; false where they are too few to be of use. */
static bool mark(empty_job *j) {
    const occupancy_grid *e = j->cells;
    const int X = e->cells[0], Y = e->cells[1], Z = e->cells[2];
    int64_t known = 0, empty = 0;
    for (int z = 0; z < Z; z++)
        for (int y = 0; y < Y; y++)
            for (int x = 0; x < X; x++) {
                const size_t row = (size_t)z * (size_t)Y + (size_t)y, at = row * (size_t)X + (size_t)x;
                if (j->state[at] != UNKNOWN) known++;
                if (j->state[at] != EMPTY) continue;
                const size_t up = (size_t)X, behind = (size_t)X * (size_t)Y;
                if ((x && j->state[at - 1] == FULL) || (x + 1 < X && j->state[at + 1] == FULL) ||
                    (y && j->state[at - up] == FULL) || (y + 1 < Y && j->state[at + up] == FULL) ||
                    (z && j->state[at - behind] == FULL) || (z + 1 < Z && j->state[at + behind] == FULL))
                    continue;
                e->bit[row * (size_t)e->words + (size_t)x / 32] |= 1u << (x % 32);
                empty++;
            }
    return empty > known / 10;
}

void occupancy_free(occupancy_grid *e) {
    mem_free(e->bit);
    *e = (occupancy_grid){0};
}

sherf_status occupancy_find(context *c, const sherf_avatar *a, const body_model *m, occupancy_grid *out) {
    occupancy_grid *e = out;
    empty_job job = {.a = a, .m = m, .cells = e};
    float max[3];
    *e = (occupancy_grid){.per_m = 1 / cell_m};
    body_canonical_bounds(m, e->min, max);
    double count = 1;
    for (int k = 0; k < 3; k++) {
        const double cells = ceil(((double)max[k] - e->min[k]) * e->per_m) + 1;
        count *= cells;
        if (!(count <= CELLS_MAX)) return SHERF_OK; /* a body of a size nobody has: nothing is left out */
        e->cells[k] = (int)cells;
    }
    e->words = (e->cells[0] + 31) / 32;
    const int64_t rows = (int64_t)e->cells[1] * e->cells[2], cells = rows * e->cells[0];
    job.normal = mem_alloc(c, (size_t)m->vertices, 3 * sizeof *job.normal);
    job.nearest = mem_alloc(c, (size_t)cells, sizeof *job.nearest);
    job.state = mem_zero(c, (size_t)cells, 1);
    e->bit = mem_zero(c, (size_t)rows, (size_t)e->words * sizeof *e->bit);
    sherf_status status = job.normal && job.nearest && job.state && e->bit ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = body_normals(c, m, m->canonical->vertices_smpl, job.normal);
    if (status == SHERF_OK) parallel_for(c, rows, 16, near_range, &job);
    if (status == SHERF_OK) status = query_all(c, &job, cells);
    if (status != SHERF_OK || !mark(&job)) occupancy_free(e);
    mem_free(job.normal);
    mem_free(job.nearest);
    mem_free(job.state);
    return status;
}

lazy_occupancy *lazy_occupancy_create(context *c) {
    lazy_occupancy *l = mem_zero(c, 1, sizeof *l);
    if (l) pthread_mutex_init(&l->lock, NULL);
    return l;
}

void lazy_occupancy_free(lazy_occupancy *l) {
    if (!l) return;
    pthread_mutex_destroy(&l->lock);
    occupancy_free(&l->cells);
    mem_free(l);
}

sherf_status avatar_occupancy(context *c, const sherf_avatar *a, const body_model *body,
                              const occupancy_grid **out) {
    lazy_occupancy *l = a->occupancy;
    sherf_status status = SHERF_OK;
    pthread_mutex_lock(&l->lock);
    if (!l->looked) {
        status = occupancy_find(c, a, body, &l->cells);
        l->looked = status == SHERF_OK;
    }
    pthread_mutex_unlock(&l->lock);
    *out = l->cells.bit ? &l->cells : NULL;
    return status;
}
