/* The level of the surface: the density at which its silhouettes are the person's. First one number is found
 * for the whole person. Then a level is found for places of the surface, along their tangents: an outline's
 * opacity depends on how much of the body a ray grazes, so a finger must be denser than a back. */
#include <math.h>
#include <string.h>

#include "baked/baked.h"

static const double half_opaque = 0.6931471805599453; /* optical depth ln 2 */

static size_t grid_count(const cubes_grid *g) {
    return (size_t)g->size[0] * (size_t)g->size[1] * (size_t)g->size[2];
}

/* ---- one level for all ---- */
enum { LEVEL_BINS = 512 };
static const double bins_per_octave = 32;

/* Bins of densities 1 to 65536 per metre, logarithmic. */
static int bin_of(double density) {
    if (!(density > 1)) return 0;
    double b = bins_per_octave * log2(density);
    return b < LEVEL_BINS - 1 ? (int)b : LEVEL_BINS - 1;
}

sherf_status field_level(context *c, const cubes_grid *g, float *level) {
    /* columns by the bin of their largest density: opaque ones, and those that are not but hold some
     * density */
    int64_t opaque[LEVEL_BINS] = {0}, clear[LEVEL_BINS] = {0}, opaque_total = 0;
    const size_t stride[3] = {1, (size_t)g->size[0], (size_t)g->size[0] * (size_t)g->size[1]};
    for (int a = 0; a < 3; a++) {
        int u = (a + 1) % 3, v = (a + 2) % 3;
        for (int j = 0; j < g->size[v]; j++)
            for (int i = 0; i < g->size[u]; i++) {
                const float *at = g->value + (size_t)i * stride[u] + (size_t)j * stride[v];
                double depth = 0, max = 0;
                for (int k = 0; k < g->size[a]; k++) {
                    double density = at[(size_t)k * stride[a]];
                    depth += density < 0 ? half_opaque : density * g->step_m; /* the core is opaque */
                    max = fmax(max, density);
                }
                if (depth >= half_opaque)
                    opaque[bin_of(max)]++, opaque_total++;
                else
                    clear[bin_of(max)]++;
            }
    }
    if (!opaque_total)
        return failure(
            c, SHERF_BAD_ARGUMENT,
            "export: the avatar is nowhere opaque, so that it has no surface (was its model trained?)");
    /* columns judged wrongly when the level lies below bin b: clear ones from b on, opaque ones before it.
     * Takes the middle of the best bins, which are many where the density jumps. */
    int64_t wrong = 0, best;
    int first = 0, last = 0;
    for (int b = 0; b < LEVEL_BINS; b++) wrong += clear[b];
    best = wrong;
    for (int b = 1; b < LEVEL_BINS; b++) {
        wrong += opaque[b - 1] - clear[b - 1];
        if (wrong < best) best = wrong, first = b;
        if (wrong == best) last = b;
    }
    *level = (float)exp2((first + last) / (2 * bins_per_octave));
    return SHERF_OK;
}

/* ---- a level for each place ---- */
enum { TANGENTS = 8, TANGENT_SAMPLES = 16, OFFSETS = 19 };
/* The opacity that defines the outline. At 0.5 the outline lies a few millimetres outside the true one:
 * docs/baked.md has scores. */
static const float outline_opacity_min = 0.75f;
static const float tangent_step_m = 0.005f, offset_first_m = 0.0225f, offset_step_m = 0.0025f;
static const float site_m = 0.014f, coarse_m = 0.015f;         /* between sites; between smooth levels */
static const float level_lowest = 0.2f, level_highest = 10.0f; /* relative to the global level */

/* The grid's magnitude at a point, trilinear; 0 outside. (The core is opaque, with a negative sign.) */
static float density_at(const cubes_grid *g, const float p[3]) {
    size_t low[3];
    float part[3];
    for (int k = 0; k < 3; k++) {
        float x = (p[k] - g->min[k]) / g->step_m;
        if (!(x >= 0 && x < (float)(g->size[k] - 1))) return 0;
        low[k] = (size_t)x;
        part[k] = x - (float)low[k];
    }
    const size_t X = (size_t)g->size[0], XY = X * (size_t)g->size[1];
    const float *at = g->value + cubes_at(g, (int)low[0], (int)low[1], (int)low[2]);
    float line[4];
    for (size_t i = 0; i < 4; i++) {
        const float *v = at + (i & 1) * X + (i >> 1) * XY;
        line[i] = fabsf(v[0]) + part[0] * (fabsf(v[1]) - fabsf(v[0]));
    }
    float z0 = line[0] + part[1] * (line[1] - line[0]), z1 = line[2] + part[1] * (line[3] - line[2]);
    return z0 + part[2] * (z1 - z0);
}

/* What cameras see at a place on the body's outline: the mean opacity of rays through it at right angles to
 * the normal. In a direction of strong curvature many cameras see the place on the outline, and the path
 * through the body is short, so a direction is weighted by the path's optical depth to the power of -4. */
static float outline_opacity(const cubes_grid *g, const float p[3], const float u[3], const float v[3]) {
    float sum = 0, weights = 0;
    for (int d = 0; d < TANGENTS; d++) {
        float angle = 3.14159265f * (float)d / TANGENTS, depth = 0, along[3];
        for (int k = 0; k < 3; k++) along[k] = tangent_step_m * (cosf(angle) * u[k] + sinf(angle) * v[k]);
        for (int i = -TANGENT_SAMPLES; i <= TANGENT_SAMPLES; i++) {
            float q[3];
            for (int k = 0; k < 3; k++) q[k] = p[k] + (float)i * along[k];
            depth += tangent_step_m * density_at(g, q);
        }
        float weight = 1 / (depth * depth * depth * depth + 1e-4f);
        sum += weight * (1 - expf(-depth));
        weights += weight;
    }
    return sum / weights;
}

typedef struct {
    float place[3], level; /* level 0: no level was found */
} level_site;

typedef struct {
    const cubes_grid *g, *smooth;
    float level;
    level_site *site;
} site_job;

/* Two unit vectors at right angles to the downhill direction; false where it is flat. */
static bool tangents_of(const cubes_grid *g, const float p[3], float n[3], float u[3], float v[3]) {
    float length = 0;
    for (int k = 0; k < 3; k++) {
        float low[3] = {p[0], p[1], p[2]}, high[3] = {p[0], p[1], p[2]};
        low[k] -= 2 * g->step_m;
        high[k] += 2 * g->step_m;
        n[k] = density_at(g, low) - density_at(g, high);
        length += n[k] * n[k];
    }
    if (!(length > 0)) return false;
    length = sqrtf(length);
    for (int k = 0; k < 3; k++) n[k] /= length;
    int min = fabsf(n[0]) < fabsf(n[1]) ? 0 : 1;
    if (fabsf(n[2]) < fabsf(n[min])) min = 2;
    float across = sqrtf(1 - n[min] * n[min]);
    for (int k = 0; k < 3; k++) u[k] = ((float)(k == min) - n[min] * n[k]) / across;
    for (int k = 0; k < 3; k++) v[k] = n[(k + 1) % 3] * u[(k + 2) % 3] - n[(k + 2) % 3] * u[(k + 1) % 3];
    return true;
}

/* Goes inwards along the normal to the outline. Where nothing is opaque enough there is only haze, and the
 * level is put above all of it. Where it is opaque from the start, other parts are in the way. */
static void site_range(void *arg, int64_t begin, int64_t end, int thread) {
    const site_job *job = arg;
    for (int64_t i = begin; i < end; i++) {
        level_site *s = &job->site[i];
        float n[3], u[3], v[3], before = 0, density_before = 0, max = 0;
        s->level = 0;
        if (!tangents_of(job->smooth, s->place, n, u, v)) continue;
        int o = 0;
        for (; o < OFFSETS; o++) {
            float p[3];
            for (int k = 0; k < 3; k++)
                p[k] = s->place[k] + (offset_first_m - offset_step_m * (float)o) * n[k];
            float opacity = outline_opacity(job->g, p, u, v),
                  density = field_desaturate(density_at(job->smooth, p), job->level);
            max = fmaxf(max, density);
            if (opacity >= outline_opacity_min) {
                if (!o) break;
                float part = (outline_opacity_min - before) / (opacity - before);
                s->level = density_before + part * (density - density_before);
                break;
            }
            before = opacity;
            density_before = density;
        }
        if (o == OFFSETS) s->level = 1.2f * max;
        if (s->level > 0)
            s->level = fminf(fmaxf(s->level, level_lowest * job->level), level_highest * job->level);
    }
}

/* Places about site_m apart where the value crosses the level between grid points; sites: room for all, or
 * NULL to count them. */
static int64_t sites_list(const cubes_grid *g, float level, level_site *sites) {
    const int stride = (int)fmaxf(1, roundf(site_m / g->step_m));
    int64_t count = 0;
    for (int z = 0; z + stride < g->size[2]; z += stride)
        for (int y = 0; y + stride < g->size[1]; y += stride)
            for (int x = 0; x + stride < g->size[0]; x += stride)
                for (int a = 0; a < 3; a++) {
                    int to[3] = {x, y, z};
                    to[a] += stride;
                    float from = g->value[cubes_at(g, x, y, z)],
                          next = g->value[cubes_at(g, to[0], to[1], to[2])];
                    if ((from < level) == (next < level)) continue;
                    if (sites) {
                        const float at[3] = {(float)x, (float)y, (float)z};
                        float *p = sites[count].place;
                        for (int k = 0; k < 3; k++) p[k] = g->min[k] + g->step_m * at[k];
                        p[a] += (level - from) / (next - from) * (float)stride * g->step_m;
                    }
                    count++;
                }
    return count;
}

/* ---- smooth levels ---- */
/* Sums over sites at the points of a coarse lattice: of weights, and of weights times log2(level). */
typedef struct {
    int size[3];
    float min[3];
    float *sum; /* pairs: weight, weight * log2 */
} level_lattice;

static size_t lattice_count(const level_lattice *l) {
    return (size_t)l->size[0] * (size_t)l->size[1] * (size_t)l->size[2];
}

/* The eight lattice points around p with their weights. */
static void lattice_corners(const level_lattice *l, const float p[3], size_t at[8], float share[8]) {
    int low[3];
    float part[3];
    for (int k = 0; k < 3; k++) {
        float x = (p[k] - l->min[k]) / coarse_m, last = (float)(l->size[k] - 2);
        x = x > 0 ? x < last ? x : last : 0;
        low[k] = (int)x;
        part[k] = fminf(x - (float)low[k], 1);
    }
    for (int i = 0; i < 8; i++) {
        size_t x = (size_t)(low[0] + (i & 1)), y = (size_t)(low[1] + (i >> 1 & 1)),
               z = (size_t)(low[2] + (i >> 2));
        at[i] = (z * (size_t)l->size[1] + y) * (size_t)l->size[0] + x;
        share[i] = (i & 1 ? part[0] : 1 - part[0]) * (i & 2 ? part[1] : 1 - part[1]) *
                   (i & 4 ? part[2] : 1 - part[2]);
    }
}

/* Blurs with 1 2 1 along each axis, `times` times; points outside have no weight. */
static void lattice_blur(level_lattice *l, int times) {
    const size_t stride[3] = {2, 2 * (size_t)l->size[0], 2 * (size_t)l->size[0] * (size_t)l->size[1]};
    for (int pass = 0; pass < 3 * times; pass++) {
        int a = pass % 3, u = (a + 1) % 3, v = (a + 2) % 3;
        for (int j = 0; j < l->size[v]; j++)
            for (int i = 0; i < l->size[u]; i++) {
                float *line = l->sum + (size_t)i * stride[u] + (size_t)j * stride[v], before[2] = {0, 0};
                for (int n = 0; n < l->size[a]; n++)
                    for (size_t k = 0; k < 2; k++) {
                        float *x = line + (size_t)n * stride[a] + k, own = *x;
                        *x = 0.25f * before[k] + 0.5f * own + (n + 1 < l->size[a] ? 0.25f * x[stride[a]] : 0);
                        before[k] = own;
                    }
            }
    }
}

typedef struct {
    cubes_grid *g;
    const level_lattice *lattice;
    float level;
} even_job;

static void even_range(void *arg, int64_t begin, int64_t end, int thread) {
    const even_job *job = arg;
    cubes_grid *g = job->g;
    const float prior = 0.02f;
    for (int64_t row = begin; row < end; row++) {
        int y = (int)(row % g->size[1]), z = (int)(row / g->size[1]);
        for (int x = 0; x < g->size[0]; x++) {
            float *value = g->value + cubes_at(g, x, y, z);
            if (!(*value > 0)) continue;
            float p[3] = {g->min[0] + g->step_m * (float)x, g->min[1] + g->step_m * (float)y,
                          g->min[2] + g->step_m * (float)z};
            size_t at[8];
            float share[8], sum = 0, weight = prior;
            lattice_corners(job->lattice, p, at, share);
            for (int i = 0; i < 8; i++) {
                weight += share[i] * job->lattice->sum[2 * at[i]];
                sum += share[i] * job->lattice->sum[2 * at[i] + 1];
            }
            *value *= exp2f(-sum / weight);
        }
    }
}

/* Divides the densities by the sites' levels, which are spread over some centimetres. */
static sherf_status even_out(context *c, cubes_grid *g, float level, const level_site *site, int64_t sites) {
    level_lattice l;
    for (int k = 0; k < 3; k++) {
        l.min[k] = g->min[k];
        l.size[k] = (int)((float)g->size[k] * g->step_m / coarse_m) + 2;
    }
    l.sum = mem_zero(c, lattice_count(&l), 2 * sizeof *l.sum);
    if (!l.sum) return SHERF_NO_MEMORY;
    for (int64_t i = 0; i < sites; i++) {
        size_t at[8];
        float share[8];
        if (!(site[i].level > 0)) continue;
        lattice_corners(&l, site[i].place, at, share);
        for (int k = 0; k < 8; k++) {
            l.sum[2 * at[k]] += share[k];
            l.sum[2 * at[k] + 1] += share[k] * log2f(site[i].level / level);
        }
    }
    lattice_blur(&l, 2);
    even_job job = {g, &l, level};
    parallel_for(c, (int64_t)g->size[1] * g->size[2], 16, even_range, &job);
    mem_free(l.sum);
    return SHERF_OK;
}

sherf_status field_level_places(context *c, cubes_grid *g, float level) {
    enum { SITE_BATCH = 1 << 14 };
    cubes_grid smooth = *g;
    level_site *site = NULL;
    const size_t count = grid_count(g);
    sherf_status status = SHERF_OK;
    smooth.value = mem_alloc(c, count, sizeof *smooth.value);
    if (!smooth.value) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < count; i++) smooth.value[i] = field_saturate(fabsf(g->value[i]), level);
    field_smooth(c, &smooth);
    const int64_t sites = sites_list(&smooth, level, NULL);
    if (!sites) goto done;
    site = mem_alloc(c, (size_t)sites, sizeof *site);
    if (!site) status = SHERF_NO_MEMORY;
    if (site) sites_list(&smooth, level, site);
    for (int64_t at = 0; at < sites && status == SHERF_OK; at += SITE_BATCH) {
        site_job job = {g, &smooth, level, site + at};
        parallel_for(c, sites - at < SITE_BATCH ? sites - at : SITE_BATCH, 64, site_range, &job);
        if (cancelled(c)) status = failure(c, SHERF_CANCELLED, "cancelled");
    }
    if (status == SHERF_OK) status = even_out(c, g, level, site, sites);
done:
    mem_free(site);
    mem_free(smooth.value);
    return status;
}
