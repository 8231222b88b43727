/* open_body: makes a body model from a source's samples. */
#include "synth/body/open_body.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "io/safetensors.h"
#include "synth/body/affine.h"
#include "synth/body/components.h"

enum { SAMPLES_MIN = 64, SAMPLES_MAX = 4096, BATCH = 64, RING = 32 };

typedef struct {
    context *c;
    const body_source *source;
    int n, first;         /* samples; the first of the current batch */
    size_t width;         /* 3 V */
    float *mesh;          /* N x V x 3; minus the mean once that is known */
    double *joint;        /* N x 24 x 3 */
    double *parameter;    /* N x SOURCE_PARAMETERS_MAX */
    double *mean;         /* V x 3 */
    double *direction;    /* 10 x V x 3, one standard deviation each */
    double *beta;         /* N x 10 */
    double *regressor;    /* 24 x V */
    double *scratch;      /* V x 3 */
    sherf_status *status; /* N */
} building;

static void draw_samples(void *arg, int64_t begin, int64_t end, int thread) {
    building *b = arg;
    for (int64_t i = b->first + begin; i < b->first + end; i++) {
        double joints[BODY_JOINTS][3];
        context own = {.threads = 1, .precision = SHERF_PRECISION_FP32};
        b->status[i] = b->source->sample(&own, b->source->arg, (uint64_t)i, b->mesh + (size_t)i * b->width,
                                         joints, b->parameter + i * SOURCE_PARAMETERS_MAX);
        memcpy(b->joint + i * BODY_JOINTS * 3, joints, sizeof joints);
    }
}

static sherf_status take_samples(building *b) {
    for (b->first = 0; b->first < b->n; b->first += BATCH) {
        sherf_status status = progress(b->c, "people", b->first, b->n);
        if (status) return status;
        parallel_for(b->c, b->n - b->first < BATCH ? b->n - b->first : BATCH, 1, draw_samples, b);
    }
    for (int i = 0; i < b->n; i++) {
        if (b->status[i]) return failure(b->c, b->status[i], "person %d cannot be made", i);
        for (size_t k = 0; k < b->width; k++)
            if (!isfinite(b->mesh[(size_t)i * b->width + k]))
                return failure(b->c, SHERF_BAD_FILE, "person %d has a vertex that is not finite", i);
    }
    return SHERF_OK;
}

static void take_mean(building *b) {
    memset(b->mean, 0, b->width * sizeof *b->mean);
    for (int i = 0; i < b->n; i++)
        for (size_t k = 0; k < b->width; k++) b->mean[k] += (double)b->mesh[(size_t)i * b->width + k] / b->n;
    /* the template is float32: the remainder goes into the deviations */
    for (size_t k = 0; k < b->width; k++) b->mean[k] = (double)(float)b->mean[k];
    for (int i = 0; i < b->n; i++)
        for (size_t k = 0; k < b->width; k++)
            b->mesh[(size_t)i * b->width + k] =
                (float)((double)b->mesh[(size_t)i * b->width + k] - b->mean[k]);
}

/* ---- measures ---- */

double mesh_volume(int64_t triangles, const uint32_t *triangle, const float *vertices) {
    double sum = 0;
    for (int64_t t = 0; t < triangles; t++) {
        double p[3][3], n[3];
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++) p[i][k] = (double)vertices[3 * (size_t)triangle[3 * t + i] + k];
        cross3(p[1], p[2], n);
        sum += dot3(p[0], n);
    }
    return sum / 6;
}

static double stature(size_t width, const double *vertices) {
    double low = INFINITY, high = -INFINITY;
    for (size_t k = 1; k < width; k += 3) {
        if (vertices[k] < low) low = vertices[k];
        if (vertices[k] > high) high = vertices[k];
    }
    return high - low;
}

static double volume(const building *b, const double *vertices) {
    double sum = 0;
    for (int64_t t = 0; t < b->source->triangles; t++) {
        const uint32_t *i = b->source->triangle + 3 * t;
        double n[3];
        cross3(vertices + 3 * (size_t)i[1], vertices + 3 * (size_t)i[2], n);
        sum += dot3(vertices + 3 * (size_t)i[0], n);
    }
    return sum / 6;
}

/* mean + factor * direction k */
static const double *moved(const building *b, int k, double factor) {
    for (size_t i = 0; i < b->width; i++)
        b->scratch[i] = b->mean[i] + factor * b->direction[(size_t)k * b->width + i];
    return b->scratch;
}

/* Chooses a component's sign: where its largest stretch along y, or else outward, is positive. */
static void choose_signs(building *b) {
    for (int k = 0; k < BODY_SHAPES; k++) {
        double taller = stature(b->width, moved(b, k, 1)) - stature(b->width, moved(b, k, -1));
        double fuller = volume(b, moved(b, k, 1)) - volume(b, moved(b, k, -1));
        double *d = b->direction + (size_t)k * b->width;
        double sign = fabs(taller) > 0.02 ? taller : fuller;
        for (size_t i = 0; i < b->width && sign < 0; i++) d[i] = -d[i];
    }
}

static void measure(building *b, open_body_report *report) {
    double square = 0;
    for (int k = 0; k < BODY_SHAPES; k++) {
        report->stature_m[k] = 0.5 * (stature(b->width, moved(b, k, 1)) - stature(b->width, moved(b, k, -1)));
        report->volume_l[k] = 500 * (volume(b, moved(b, k, 1)) - volume(b, moved(b, k, -1)));
        const double *d = b->direction + (size_t)k * b->width;
        double length = 0;
        for (size_t i = 0; i < b->width; i++) length += d[i] * d[i];
        for (int s = 0; s < b->n; s++) {
            const float *x = b->mesh + (size_t)s * b->width;
            double dot = 0;
            for (size_t i = 0; i < b->width; i++) dot += d[i] * (double)x[i];
            b->beta[s * BODY_SHAPES + k] = length > 0 ? dot / length : 0;
        }
    }
    for (int s = 0; s < b->n; s++) {
        const float *x = b->mesh + (size_t)s * b->width;
        for (size_t i = 0; i < b->width; i++) {
            double left = (double)x[i];
            for (int k = 0; k < BODY_SHAPES; k++)
                left -= b->beta[s * BODY_SHAPES + k] * b->direction[(size_t)k * b->width + i];
            square += left * left;
        }
    }
    report->error_mm = 1000 * sqrt(square / ((double)b->n * (double)b->width / 3));
    for (int k = 0; k < BODY_SHAPES; k++)
        for (int p = 0; p < b->source->parameters; p++) {
            double x = 0, xx = 0, xy = 0, yy = 0;
            for (int s = 0; s < b->n; s++) x += b->parameter[s * SOURCE_PARAMETERS_MAX + p] / b->n;
            for (int s = 0; s < b->n; s++) {
                double u = b->parameter[s * SOURCE_PARAMETERS_MAX + p] - x, v = b->beta[s * BODY_SHAPES + k];
                xx += u * u, xy += u * v, yy += v * v;
            }
            report->correlation[k][p] = xx > 0 && yy > 0 ? xy / sqrt(xx * yy) : 0;
        }
}

/* ---- joints ---- */

static double distance2(const double a[3], const double b[3]) {
    double d[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
    return dot3(d, d);
}

/* Chooses RING vertices around a joint, spread over those not much farther than the nearest ones: each next
 * one is as far as possible from the chosen ones. */
static void choose_ring(const building *b, const double joint[3], int ring[RING]) {
    int V = b->source->vertices;
    double *gap = b->scratch, nearest = INFINITY; /* distance to the chosen ones; negative: not in the pool */
    for (int v = 0; v < V; v++) {
        double d = distance2(b->mean + 3 * (size_t)v, joint);
        if (d < nearest) nearest = d;
    }
    double reach = 1.5 * sqrt(nearest) + 0.02;
    for (int wider = 0; wider < 20; wider++, reach *= 1.25) {
        int pool = 0;
        for (int v = 0; v < V; v++) pool += distance2(b->mean + 3 * (size_t)v, joint) < reach * reach;
        if (pool >= 4 * RING || pool >= V) break;
    }
    for (int v = 0; v < V; v++) {
        double d = distance2(b->mean + 3 * (size_t)v, joint);
        gap[v] = d < reach * reach ? 1e3 - d : -1; /* the nearest one is chosen first */
    }
    for (int i = 0; i < RING; i++) {
        int best = 0;
        for (int v = 1; v < V; v++)
            if (gap[v] > gap[best]) best = v;
        ring[i] = best;
        for (int v = 0; v < V; v++) {
            double d = distance2(b->mean + 3 * (size_t)v, b->mean + 3 * (size_t)best);
            if (gap[v] >= 0 && d < gap[v]) gap[v] = d;
        }
        gap[best] = -1;
    }
}

/* Weights of the ring's vertices that sum to 1 and fit the samples' joints best, regularised to equal
 * weights: minimise |M w - j|^2 + ridge |w - 1/RING|^2. */
static sherf_status fit_joint(building *b, int j, const int ring[RING], double *row) {
    double A[RING * RING] = {0}, B[RING * RING], x[RING] = {0}, y[RING], trace = 0, sum_x = 0, sum_y = 0;
    for (int s = 0; s < b->n; s++)
        for (int k = 0; k < 3; k++) {
            double m[RING], target = b->joint[((size_t)s * BODY_JOINTS + (size_t)j) * 3 + (size_t)k];
            for (int i = 0; i < RING; i++) {
                size_t at = 3 * (size_t)ring[i] + (size_t)k;
                m[i] = b->mean[at] + (double)b->mesh[(size_t)s * b->width + at] - target;
            }
            for (int a = 0; a < RING; a++)
                for (int i = 0; i <= a; i++) A[a * RING + i] += m[a] * m[i];
        }
    for (int i = 0; i < RING; i++) trace += A[i * RING + i];
    double ridge = 1e-5 * trace / RING;
    for (int i = 0; i < RING; i++) {
        A[i * RING + i] += ridge;
        x[i] = ridge / RING;
        y[i] = 1;
    }
    memcpy(B, A, sizeof B);
    if (!(ridge > 0) || !solve_positive(RING, A, x) || !solve_positive(RING, B, y))
        return failure(b->c, SHERF_BAD_FILE, "joint %d cannot be regressed from the mesh", j);
    for (int i = 0; i < RING; i++) sum_x += x[i], sum_y += y[i];
    for (int i = 0; i < RING; i++) row[ring[i]] = (double)(float)(x[i] + y[i] * (1 - sum_x) / sum_y);
    return SHERF_OK;
}

static sherf_status fit_joints(building *b, open_body_report *report) {
    double max = 0, mean = 0;
    for (int j = 0; j < BODY_JOINTS; j++) {
        double at[3] = {0};
        int ring[RING];
        for (int s = 0; s < b->n; s++)
            for (int k = 0; k < 3; k++)
                at[k] += b->joint[((size_t)s * BODY_JOINTS + (size_t)j) * 3 + (size_t)k] / b->n;
        choose_ring(b, at, ring);
        double *row = b->regressor + (size_t)j * (size_t)b->source->vertices;
        sherf_status status = fit_joint(b, j, ring, row);
        if (status) return status;
        for (int s = 0; s < b->n; s++) {
            double d[3];
            for (int k = 0; k < 3; k++) {
                d[k] = -b->joint[((size_t)s * BODY_JOINTS + (size_t)j) * 3 + (size_t)k];
                for (int i = 0; i < RING; i++) {
                    size_t v = 3 * (size_t)ring[i] + (size_t)k;
                    d[k] += row[ring[i]] * (b->mean[v] + (double)b->mesh[(size_t)s * b->width + v]);
                }
            }
            double error = 1000 * sqrt(dot3(d, d));
            mean += error / (b->n * BODY_JOINTS);
            if (error > max) max = error;
        }
    }
    report->joint_error_mm = max;
    report->joint_error_mean_mm = mean;
    return SHERF_OK;
}

/* ---- the whole ---- */

static sherf_status make_model(building *b, body_model **out) {
    const body_source *s = b->source;
    static const int64_t parent[BODY_JOINTS] = {-1, 0, 0, 0,  1,  2,  3,  4,  5,  6,  7,  8,
                                                9,  9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21};
    /* full at elbows and knees; less where it would bulge: at hips, and at shoulders, which hang in most
     * poses */
    static const double volume[BODY_JOINTS] = {0,    0.75, 0.75, 0.75, 1,    1,    0.75, 1, 1, 0.75, 1, 1,
                                               0.75, 0.35, 0.35, 0.75, 0.35, 0.35, 1,    1, 1, 1,    1, 1};
    sherf_status status = SHERF_NO_MEMORY;
    size_t V = (size_t)s->vertices, T = (size_t)s->triangles;
    double *shapedirs = mem_alloc(b->c, b->width * BODY_SHAPES, sizeof *shapedirs);
    double *weights = mem_alloc(b->c, V * BODY_JOINTS, sizeof *weights);
    int64_t *face = mem_alloc(b->c, T * 3, sizeof *face);
    if (!shapedirs || !weights || !face) goto done;
    for (size_t i = 0; i < b->width; i++)
        for (size_t k = 0; k < BODY_SHAPES; k++)
            shapedirs[i * BODY_SHAPES + k] = b->direction[k * b->width + i];
    for (size_t i = 0; i < V * BODY_JOINTS; i++) weights[i] = (double)s->weights[i];
    for (size_t i = 0; i < T * 3; i++) face[i] = s->triangle[i];
    body_arrays arrays = {.vertices = s->vertices,
                          .faces = s->triangles,
                          .shape_count = BODY_SHAPES,
                          .v_template = b->mean,
                          .shapedirs = shapedirs,
                          .weights = weights,
                          .regressor = b->regressor,
                          .volume = volume,
                          .face = face,
                          .parent = parent};
    status = body_create(b->c, &arrays, out);
done:
    mem_free(shapedirs);
    mem_free(weights);
    mem_free(face);
    return status;
}

sherf_status open_body_create(context *c, const body_source *source, int samples, body_model **out,
                              open_body_report *report) {
    *out = NULL;
    *report = (open_body_report){.samples = samples};
    if (samples < SAMPLES_MIN || samples > SAMPLES_MAX || source->vertices < 4 * RING ||
        source->parameters > SOURCE_PARAMETERS_MAX)
        return failure(c, SHERF_BAD_ARGUMENT,
                       "%d people of %d vertices: %d to %d people, %d vertices at least", samples,
                       source->vertices, SAMPLES_MIN, SAMPLES_MAX, 4 * RING);
    building b = {.c = c, .source = source, .n = samples, .width = 3 * (size_t)source->vertices};
    size_t n = (size_t)samples, V = (size_t)source->vertices;
    sherf_status status = SHERF_NO_MEMORY;
    b.mesh = mem_alloc(c, n * b.width, sizeof *b.mesh);
    b.joint = mem_alloc(c, n * BODY_JOINTS * 3, sizeof *b.joint);
    b.parameter = mem_zero(c, n * SOURCE_PARAMETERS_MAX, sizeof *b.parameter);
    b.mean = mem_alloc(c, b.width, sizeof *b.mean);
    b.direction = mem_alloc(c, BODY_SHAPES * b.width, sizeof *b.direction);
    b.beta = mem_alloc(c, n * BODY_SHAPES, sizeof *b.beta);
    b.regressor = mem_zero(c, BODY_JOINTS * V, sizeof *b.regressor);
    b.scratch = mem_alloc(c, b.width, sizeof *b.scratch);
    b.status = mem_zero(c, n, sizeof *b.status);
    if (!b.mesh || !b.joint || !b.parameter || !b.mean || !b.direction || !b.beta || !b.regressor ||
        !b.scratch || !b.status)
        goto done;
    if ((status = take_samples(&b))) goto done;
    take_mean(&b);
    if ((status =
             components_find(c, samples, (int64_t)b.width, b.mesh, BODY_SHAPES, b.direction, report->share)))
        goto done;
    for (int k = 0; k < BODY_SHAPES; k++) report->kept += report->share[k];
    choose_signs(&b);
    measure(&b, report);
    status = fit_joints(&b, report);
    if (!status) status = make_model(&b, out);
done:
    mem_free(b.mesh);
    mem_free(b.joint);
    mem_free(b.parameter);
    mem_free(b.mean);
    mem_free(b.direction);
    mem_free(b.beta);
    mem_free(b.regressor);
    mem_free(b.scratch);
    mem_free(b.status);
    return status;
}

/* "37.2 % of the variance; stature +7.9 cm, volume +8.1 l; with sex 0.81, height 0.44" */
void open_body_describe(const body_source *source, const open_body_report *r, int k,
                        char out[OPEN_BODY_LINE]) {
    int n = snprintf(out, 256, "%.1f %% of the variance; stature %+.1f cm, volume %+.1f l", 100 * r->share[k],
                     100 * r->stature_m[k], r->volume_l[k]);
    const char *before = "; goes with";
    for (int p = 0; p < source->parameters && n < 200; p++)
        if (fabs(r->correlation[k][p]) >= 0.3) {
            n += snprintf(out + n, (size_t)(256 - n), "%s %s %+.2f", before, source->parameter[p],
                          r->correlation[k][p]);
            before = ",";
        }
}

sherf_status open_body_save(context *c, const body_source *source, const body_model *body,
                            const open_body_report *report, const char *path) {
    enum { TEXTS = 9 };
    size_t V = (size_t)body->vertices;
    char text[TEXTS + BODY_SHAPES][256], key[BODY_SHAPES][16];
    int64_t tree[2 * BODY_JOINTS];
    for (int j = 0; j < BODY_JOINTS; j++) {
        tree[j] = body->parent[j];
        tree[BODY_JOINTS + j] = j;
    }
    float *regressor = mem_alloc(c, V * BODY_JOINTS, sizeof *regressor);
    if (!regressor) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < V * BODY_JOINTS; i++) regressor[i] = (float)body->regressor[i];
    safetensor_item item[] = {
        {"v_template", T_F32, 2, {body->vertices, 3}, body->v_template},
        {"shapedirs", T_F32, 3, {body->vertices, 3, BODY_SHAPES}, body->shapedirs},
        {"weights", T_F32, 2, {body->vertices, BODY_JOINTS}, body->weights},
        {"J_regressor", T_F32, 2, {BODY_JOINTS, body->vertices}, regressor},
        {"f", T_I32, 2, {body->faces, 3}, body->face},
        {"kintree_table", T_I64, 2, {2, BODY_JOINTS}, tree},
        {"pose_volume", T_F32, 1, {BODY_JOINTS}, body->volume},
        {"uv", T_F32, 2, {source->uvs, 2}, source->uv},
        {"f_uv", T_I32, 2, {source->triangles, 3}, source->triangle_uv},
    };
    safetensor_metadata metadata[TEXTS + BODY_SHAPES] = {
        {"format", "sherf-body"},
        {"name", "sherf open body"},
        {"source", source->name},
        {"source_version", source->version},
        {"source_fingerprint", text[4]},
        {"licence", source->licence},
        {"shape_samples", text[6]},
        {"shape_variance_kept", text[7]},
        {"pose", text[8]},
    };
    snprintf(text[4], sizeof text[4], "%016llx", (unsigned long long)source->fingerprint);
    snprintf(text[6], sizeof text[6], "%d adults", report->samples);
    snprintf(text[7], sizeof text[7], "%.4f", report->kept);
    snprintf(text[8], sizeof text[8], "T-pose, y up, facing +z, metres; joints as SMPL's");
    for (int k = 0; k < BODY_SHAPES; k++) {
        snprintf(key[k], sizeof key[k], "shape_%d", k);
        open_body_describe(source, report, k, text[TEXTS + k]);
        metadata[TEXTS + k] = (safetensor_metadata){key[k], text[TEXTS + k]};
    }
    sherf_status status = safetensors_write(c, path, COUNT_OF(item), item, COUNT_OF(metadata), metadata);
    mem_free(regressor);
    return status;
}

sherf_status open_body_project(context *c, const body_model *body, const float *vertices,
                               float shape[BODY_SHAPES]) {
    double A[BODY_SHAPES * BODY_SHAPES] = {0}, x[BODY_SHAPES] = {0};
    for (size_t i = 0; i < 3 * (size_t)body->vertices; i++) {
        const float *d = body->shapedirs + i * BODY_SHAPES;
        double left = (double)vertices[i] - (double)body->v_template[i];
        for (int a = 0; a < BODY_SHAPES; a++) {
            x[a] += left * (double)d[a];
            for (int b = 0; b <= a; b++) A[a * BODY_SHAPES + b] += (double)d[a] * (double)d[b];
        }
    }
    if (!solve_positive(BODY_SHAPES, A, x))
        return failure(c, SHERF_UNSUPPORTED, "the body's shape components depend on each other");
    for (int k = 0; k < BODY_SHAPES; k++) shape[k] = (float)x[k];
    return SHERF_OK;
}
