/* The occupancy grid: an avatar's density and colour in cells of canonical space. The density at a point
 * depends only on its canonical place, not on pose or camera, and colour hardly depends on the direction. So
 * the network is queried once on a lattice. Frames skip the space that is empty there or, with coarse fields,
 * query the network only for samples of large weight. */
#include <math.h>
#include <string.h>

#include "avatar/canonical.h"

/* Features jump where the nearest vertex changes, so a cell counts as empty only when its neighbours are
 * empty too. Cells below the skin are not queried for that: they are full, or hidden. */
static const float cell_m = 0.01f, known_m = 0.06f, below_m = 0.01f;
enum { CELLS_MAX = 1 << 24, UNKNOWN = 0, EMPTY = 1, FULL = 2 };

typedef struct {
    int cells[3];
    float min[3], per_m;
} lattice;

/* Results by cell go to `value`, or else to `state`. */
typedef struct {
    const sherf_avatar *a;
    const body_model *body;
    lattice cells;
    float lowest; /* the smallest height above the skin that is queried */
    float (*value)[4];
    float *normal;    /* of the canonical vertices */
    int32_t *nearest; /* by cell: the canonical vertex nearest to its middle, -1: not queried */
    uint8_t *state;   /* by cell */
    canonical_batch batch;
    int32_t *cell; /* of its points */
} empty_job;

static void middle(const lattice *e, size_t cell, float at[3]) {
    const size_t x = (size_t)e->cells[0], y = (size_t)e->cells[1];
    const size_t i[3] = {cell % x, cell / x % y, cell / x / y};
    for (int k = 0; k < 3; k++) at[k] = e->min[k] + ((float)i[k] + 0.5f) / e->per_m;
}

/* Above the vertex's tangent plane. */
static float height(const empty_job *j, const float at[3], int32_t vertex) {
    const float *v = j->body->canonical->vertices_smpl + 3 * (size_t)vertex,
                *n = j->normal + 3 * (size_t)vertex;
    return (at[0] - v[0]) * n[0] + (at[1] - v[1]) * n[1] + (at[2] - v[2]) * n[2];
}

static void near_range(void *arg, int64_t begin, int64_t end, int thread) {
    const empty_job *j = arg;
    const vertex_grid *grid = body_canonical_grid(j->body);
    const vertex_shell *shell = vertex_grid_shell(grid);
    const int64_t row = j->cells.cells[0];
    for (int64_t i = begin * row; i < end * row; i++) {
        float at[3], d2 = INFINITY;
        int voxel[3];
        bool inside = true;
        middle(&j->cells, (size_t)i, at);
        for (int k = 0; k < 3; k++) {
            const float v = (at[k] - shell->min[k]) / shell->cell_m;
            inside = inside && v >= 0 && v < (float)shell->cells[k];
            voxel[k] = inside ? (int)v : 0;
        }
        const size_t word =
            ((size_t)voxel[2] * (size_t)shell->cells[1] + (size_t)voxel[1]) * (size_t)shell->words +
            (size_t)voxel[0] / 32;
        inside = inside && shell->bit[word] >> (voxel[0] % 32) & 1; /* a search elsewhere takes long */
        const int32_t found = inside ? vertex_grid_nearest_from(grid, at, -1, &d2) : -1;
        j->nearest[i] = found >= 0 && d2 < known_m * known_m && height(j, at, found) > j->lowest ? found : -1;
    }
}

static sherf_status query_batch(context *c, empty_job *j) {
    canonical_batch *b = &j->batch;
    sherf_status status = canonical_batch_run(c, j->a, j->body, b);
    for (int64_t i = 0; i < b->set.count && status == SHERF_OK; i++) {
        if (j->state) j->state[j->cell[i]] = b->sigma[i] > 0 ? FULL : EMPTY;
        if (!j->value) continue;
        j->value[j->cell[i]][0] = b->sigma[i];
        memcpy(j->value[j->cell[i]] + 1, b->rgb + 3 * i, 3 * sizeof *b->rgb);
    }
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
            middle(&j->cells, (size_t)i, b->set.canonical + 3 * k);
            for (int d = 0; d < 3; d++) /* as a ray meets the skin */
                b->set.direction_canonical[3 * k + d] = -j->normal[3 * (size_t)j->nearest[i] + (size_t)d];
        }
        if (b->set.count == CANONICAL_BATCH || (i + 1 == count && b->set.count)) status = query_batch(c, j);
    }
    canonical_batch_free(b);
    mem_free(j->cell);
    return status;
}

/* Sets the bits of empty cells without full neighbours; false where they are too few to be useful. */
static bool mark(const empty_job *j, occupancy_grid *e) {
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

/* False for a body of an impossible size. */
static bool lattice_of(const body_model *body, lattice *out) {
    float max[3];
    double count = 1;
    out->per_m = 1 / cell_m;
    body_canonical_bounds(body, out->min, max);
    for (int k = 0; k < 3; k++) {
        const double cells = ceil(((double)max[k] - out->min[k]) * out->per_m) + 1;
        count *= cells;
        if (!(count <= CELLS_MAX)) return false;
        out->cells[k] = (int)cells;
    }
    return true;
}

/* Queries all cells near the body, into the job's value or state. */
static sherf_status answers(context *c, empty_job *j) {
    const int64_t rows = (int64_t)j->cells.cells[1] * j->cells.cells[2], cells = rows * j->cells.cells[0];
    j->normal = mem_alloc(c, (size_t)j->body->vertices, 3 * sizeof *j->normal);
    j->nearest = mem_alloc(c, (size_t)cells, sizeof *j->nearest);
    sherf_status status = j->normal && j->nearest ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = body_normals(c, j->body, j->body->canonical->vertices_smpl, j->normal);
    if (status == SHERF_OK) parallel_for(c, rows, 16, near_range, j);
    if (status == SHERF_OK) status = query_all(c, j, cells);
    mem_free(j->normal);
    mem_free(j->nearest);
    return status;
}

/* values: receives the results of all cells near the body; NULL: only cells at the skin and outside are
 * queried, and no values are kept. */
static sherf_status find(context *c, const sherf_avatar *a, const body_model *body, occupancy_grid *e,
                         coarse_field *values) {
    empty_job job = {.a = a, .body = body, .lowest = values ? -INFINITY : -below_m};
    const lattice *l = &job.cells;
    if (!lattice_of(body, &job.cells)) return SHERF_OK; /* nothing is skipped */
    *e = (occupancy_grid){.per_m = l->per_m, .words = (l->cells[0] + 31) / 32};
    memcpy(e->min, l->min, sizeof e->min);
    memcpy(e->cells, l->cells, sizeof e->cells);
    const size_t rows = (size_t)l->cells[1] * (size_t)l->cells[2];
    job.state = mem_zero(c, rows, (size_t)l->cells[0]);
    e->bit = mem_zero(c, rows, (size_t)e->words * sizeof *e->bit);
    if (values) {
        *values = (coarse_field){.per_m = l->per_m};
        memcpy(values->min, l->min, sizeof l->min);
        memcpy(values->cells, l->cells, sizeof l->cells);
        values->value = job.value = mem_zero(c, rows * (size_t)l->cells[0], sizeof *values->value);
    }
    const bool room = job.state && e->bit && (!values || values->value);
    sherf_status status = room ? answers(c, &job) : SHERF_NO_MEMORY;
    if (status != SHERF_OK || !mark(&job, e)) occupancy_free(e);
    if (status != SHERF_OK && values) coarse_field_free(values);
    mem_free(job.state);
    return status;
}

sherf_status occupancy_find(context *c, const sherf_avatar *a, const body_model *body, occupancy_grid *e) {
    *e = (occupancy_grid){0};
    return find(c, a, body, e, NULL);
}

sherf_status coarse_field_find(context *c, const sherf_avatar *a, const body_model *body, occupancy_grid *e,
                               coarse_field *f) {
    *e = (occupancy_grid){0};
    *f = (coarse_field){0};
    return find(c, a, body, e, f);
}

void coarse_field_free(coarse_field *f) {
    mem_free(f->value);
    *f = (coarse_field){0};
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
    coarse_field_free(&l->coarse);
    mem_free(l);
}

/* Where whole frames are made on a GPU, only empty space is skipped. */
static bool takes_coarse(const sherf_avatar *a) {
    return !avatar_takes_joints(a);
}

sherf_status avatar_occupancy(context *c, const sherf_avatar *a, const body_model *body,
                              const occupancy_grid **cells, const coarse_field **coarse) {
    lazy_occupancy *l = a->occupancy;
    sherf_status status = SHERF_OK;
    pthread_mutex_lock(&l->lock);
    if (!l->looked) {
        status = takes_coarse(a) ? coarse_field_find(c, a, body, &l->cells, &l->coarse)
                                 : occupancy_find(c, a, body, &l->cells);
        l->looked = status == SHERF_OK;
    }
    pthread_mutex_unlock(&l->lock);
    *cells = l->cells.bit ? &l->cells : NULL;
    *coarse = l->coarse.value ? &l->coarse : NULL;
    return status;
}
