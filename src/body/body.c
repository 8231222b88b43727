/* The body model: checked and copied arrays, fingerprint, normals; the public functions on a body. */
#include <math.h>
#include <string.h>

#include "body/body.h"

/* big pose: legs apart, feet as they stand then */
const float body_big_pose[72] = {[5] = 0.785398163397448f,
                                 [8] = -0.785398163397448f,
                                 [23] = -0.523598775598299f,
                                 [26] = 0.523598775598299f};

static sherf_status copy_finite(context *c, const char *name, size_t n, const double *in, float *out) {
    bool finite = true;
    for (size_t i = 0; i < n; i++) {
        out[i] = (float)in[i];
        finite &= isfinite(out[i]) != 0;
    }
    return finite ? SHERF_OK : failure(c, SHERF_BAD_FILE, "body: %s holds values that are not finite", name);
}

static sherf_status copy_weights(context *c, const body_arrays *a, float *out) {
    sherf_status status = copy_finite(c, "weights", (size_t)a->vertices * BODY_JOINTS, a->weights, out);
    if (status != SHERF_OK) return status;
    for (int v = 0; v < a->vertices; v++) {
        double sum = 0, min = 0;
        for (int j = 0; j < BODY_JOINTS; j++) {
            double w = a->weights[(size_t)v * BODY_JOINTS + j];
            sum += w;
            if (w < min) min = w;
        }
        if (fabs(sum - 1) > 1e-3 || min < -1e-3)
            return failure(c, SHERF_BAD_FILE, "body: weights of vertex %d sum to %g, not to 1", v, sum);
    }
    return SHERF_OK;
}

static sherf_status copy_indices(context *c, const body_arrays *a, body_model *body) {
    for (size_t i = 0; i < 3 * (size_t)a->faces; i++) {
        if (a->face[i] < 0 || a->face[i] >= a->vertices)
            return failure(c, SHERF_BAD_FILE, "body: face %zu names vertex %lld of %d", i / 3,
                           (long long)a->face[i], a->vertices);
        body->face[i] = (uint32_t)a->face[i];
    }
    body->parent[0] = -1;
    for (int j = 1; j < BODY_JOINTS; j++) {
        if (a->parent[j] < 0 || a->parent[j] >= j)
            return failure(c, SHERF_BAD_FILE, "body: the parent of joint %d is %lld, which is not before it",
                           j, (long long)a->parent[j]);
        body->parent[j] = (int)a->parent[j];
    }
    return SHERF_OK;
}

/* Transposes posedirs V x 3 x 207 to 207 x V x 3, in blocks that stay in cache. */
static sherf_status copy_posedirs(context *c, const body_arrays *a, float *out) {
    enum { BLOCK = 64 };
    size_t rows = 3 * (size_t)a->vertices;
    bool finite = true;
    for (size_t r0 = 0; r0 < rows; r0 += BLOCK) {
        size_t r1 = r0 + BLOCK < rows ? r0 + BLOCK : rows;
        for (size_t k = 0; k < BODY_POSE_FEATURES; k++)
            for (size_t r = r0; r < r1; r++) {
                float x = (float)a->posedirs[r * BODY_POSE_FEATURES + k];
                finite &= isfinite(x) != 0;
                out[k * rows + r] = x;
            }
    }
    return finite ? SHERF_OK : failure(c, SHERF_BAD_FILE, "body: posedirs holds values that are not finite");
}

/* A vertex that turns with joint j's branch by the share s of its weights is blended half way, s R + (1 - s)
 * I, and comes closer to the joint by |s R + (1 - s) I|: at a right angle sqrt(s^2 + (1 - s)^2). The offset
 * that makes up for it there is linear in R, as pose blend shapes are: for a turn by t about a, (F + F^T) / 2
 * = (cos t - 1)(I - a a^T). */
static sherf_status make_volume(context *c, const body_arrays *a, body_model *body) {
    bool any = false;
    for (int j = 1; j < BODY_JOINTS && a->volume; j++) {
        if (!(a->volume[j] >= 0 && a->volume[j] <= 2))
            return failure(c, SHERF_BAD_FILE, "body: pose_volume of joint %d is %g, must be 0 to 2", j,
                           a->volume[j]);
        body->volume[j] = (float)a->volume[j];
        any |= body->volume[j] > 0;
    }
    if (!any) return SHERF_OK;
    body->pose_volume = mem_zero(c, (size_t)body->vertices * BODY_JOINTS, sizeof *body->pose_volume);
    if (!body->pose_volume) return SHERF_NO_MEMORY;
    for (size_t v = 0; v < (size_t)body->vertices; v++) {
        double s[BODY_JOINTS];
        for (int j = 0; j < BODY_JOINTS; j++) s[j] = body->weights[v * BODY_JOINTS + j];
        for (int j = BODY_JOINTS - 1; j > 0; j--) s[body->parent[j]] += s[j]; /* children come later */
        for (int j = 1; j < BODY_JOINTS; j++)
            if (s[j] > 0 && s[j] < 1)
                body->pose_volume[v * BODY_JOINTS + j] =
                    (float)(body->volume[j] * (1 / sqrt(s[j] * s[j] + (1 - s[j]) * (1 - s[j])) - 1));
    }
    return SHERF_OK;
}

static uint64_t mix(uint64_t hash, uint64_t word) {
    hash = (hash ^ word) * 0x9E3779B97F4A7C15u;
    return hash ^ hash >> 29;
}

static uint64_t mix_floats(uint64_t hash, size_t n, const float *x) {
    for (size_t i = 0; i < n; i++) {
        uint32_t bits;
        float value = x[i] + 0.0f; /* -0 is 0 */
        memcpy(&bits, &value, sizeof bits);
        hash = mix(hash, bits);
    }
    return hash;
}

/* Of the float32 values, so that a body is the same whichever file format it came from. */
static uint64_t fingerprint_of(const body_model *body) {
    size_t n = (size_t)body->vertices;
    uint64_t hash = mix(mix(fnv1a64("sherf-body"), (uint64_t)body->vertices), (uint64_t)body->faces);
    hash = mix_floats(hash, 3 * n, body->v_template);
    hash = mix_floats(hash, 3 * n * BODY_SHAPES, body->shapedirs);
    if (body->posedirs) hash = mix_floats(hash, 3 * n * BODY_POSE_FEATURES, body->posedirs);
    if (body->pose_volume) hash = mix_floats(hash, BODY_JOINTS, body->volume);
    hash = mix_floats(hash, n * BODY_JOINTS, body->weights);
    for (size_t i = 0; i < n * BODY_JOINTS; i++) {
        float value = (float)body->regressor[i];
        hash = mix_floats(hash, 1, &value);
    }
    for (size_t i = 0; i < 3 * (size_t)body->faces; i++) hash = mix(hash, body->face[i]);
    for (int j = 0; j < BODY_JOINTS; j++) hash = mix(hash, (uint64_t)(body->parent[j] + 1));
    return hash;
}

/* J(shape) = regressor * (template + shapedirs * shape) is linear: computes its two parts. */
static sherf_status regress_joints(context *c, body_model *body) {
    for (int j = 0; j < BODY_JOINTS; j++) {
        double(*shape)[BODY_SHAPES] = body->joint_shape[j], *rest = body->joint_template[j], sum = 0;
        const double *row = body->regressor + (size_t)j * body->vertices;
        for (size_t v = 0; v < (size_t)body->vertices; v++) {
            sum += row[v];
            if (row[v] == 0) continue;
            for (size_t a = 0; a < 3; a++) {
                rest[a] += row[v] * body->v_template[3 * v + a];
                for (size_t b = 0; b < BODY_SHAPES; b++)
                    shape[a][b] += row[v] * body->shapedirs[(3 * v + a) * BODY_SHAPES + b];
            }
        }
        if (!isfinite(sum) || !isfinite(rest[0] + rest[1] + rest[2]))
            return failure(c, SHERF_BAD_FILE, "body: J_regressor holds values that are not finite");
    }
    return SHERF_OK;
}

static sherf_status canonical_create(context *c, body_model *body) {
    static const float shape[BODY_SHAPES], R[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, Th[3];
    body->canonical_inverse = mem_alloc(c, (size_t)body->vertices, 12 * sizeof *body->canonical_inverse);
    body->canonical_blend = mem_alloc(c, (size_t)body->vertices, 12 * sizeof *body->canonical_blend);
    if (!body->canonical_inverse || !body->canonical_blend) return SHERF_NO_MEMORY;
    sherf_status status = posed_body_create(c, body, body_big_pose, shape, R, Th, &body->canonical);
    if (status != SHERF_OK) return failure_prefix(c, status, "body: canonical pose");
    status = vertex_grid_create(c, body->vertices, body->canonical->vertices_smpl, 0, &body->canonical_grid);
    /* points closer than 5 cm to a posed vertex are hardly ever farther from the canonical body */
    if (status == SHERF_OK) status = vertex_grid_refine(c, body->canonical_grid, 0.06f, 0.02f);
    return status;
}

/* Joints that come in pairs, left and right. */
static const int pairs[][2] = {{1, 2},   {4, 5},   {7, 8},   {10, 11}, {13, 14},
                               {16, 17}, {18, 19}, {20, 21}, {22, 23}};

static sherf_status find_mirror(context *c, body_model *body) {
    const size_t V = (size_t)body->vertices;
    double middle = 0;
    vertex_grid *grid = NULL;
    for (size_t i = 0; i < COUNT_OF(pairs); i++)
        middle += body->joint_template[pairs[i][0]][0] + body->joint_template[pairs[i][1]][0];
    body->mirror_x_m = (float)(middle / (2 * COUNT_OF(pairs)));
    float *mirrored = mem_alloc(c, V, 3 * sizeof *mirrored);
    body->mirror = mem_alloc(c, V, sizeof *body->mirror);
    sherf_status status = mirrored && body->mirror ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = vertex_grid_create(c, body->vertices, body->v_template, 0, &grid);
    if (status == SHERF_OK) {
        memcpy(mirrored, body->v_template, V * 3 * sizeof *mirrored);
        for (size_t v = 0; v < V; v++) mirrored[3 * v] = 2 * body->mirror_x_m - mirrored[3 * v];
        vertex_grid_nearest_many(c, grid, body->vertices, mirrored, body->mirror);
    }
    vertex_grid_free(grid);
    mem_free(mirrored);
    return status;
}

/* Visits the edges twice: counts, then writes; an edge of two faces counts once. */
static sherf_status find_neighbours(context *c, body_model *body) {
    enum { MAX = 32 }; /* neighbours of a vertex: meshes have 6, files may contain anything */
    const size_t corners = 3 * (size_t)body->faces;
    int32_t *first = body->neighbour_first = mem_zero(c, (size_t)body->vertices + 1, sizeof *first);
    int32_t *list = body->neighbour = mem_alloc(c, 2 * corners + 1, sizeof *list);
    if (!first || !list) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < corners; i++) first[body->face[i] + 1] += 2;
    for (int v = 0; v < body->vertices; v++) first[v + 1] += first[v];
    for (size_t i = corners; i-- > 0;) { /* decrements first[v + 1] to v's first */
        const size_t face = i / 3 * 3, corner = i % 3;
        for (size_t k = 1; k < 3; k++)
            list[--first[body->face[i] + 1]] = (int32_t)body->face[face + (corner + k) % 3];
    }
    int32_t kept = 0, at = 0;
    for (int v = 0; v < body->vertices; v++) {
        const int32_t begin = kept, end = v + 1 < body->vertices ? first[v + 2] : (int32_t)(2 * corners);
        for (; at < end; at++) {
            bool known = list[at] == v || kept - begin == MAX;
            for (int32_t k = begin; k < kept; k++) known = known || list[k] == list[at];
            if (!known) list[kept++] = list[at];
        }
        first[v] = begin;
    }
    first[body->vertices] = kept;
    return SHERF_OK;
}

static sherf_status check_sizes(context *c, const body_arrays *a) {
    if (a->vertices < 1 || a->vertices > BODY_VERTICES_MAX)
        return failure(c, SHERF_BAD_FILE, "body: %d vertices, must be 1 to %d", a->vertices,
                       BODY_VERTICES_MAX);
    if (a->faces < 0 || a->faces > 4 * BODY_VERTICES_MAX)
        return failure(c, SHERF_BAD_FILE, "body: %d faces, must be 0 to %d", a->faces, 4 * BODY_VERTICES_MAX);
    if (a->shape_count < 0)
        return failure(c, SHERF_BAD_FILE, "body: %d shapes, must be at least 0", a->shape_count);
    return SHERF_OK;
}

sherf_status body_create(context *c, const body_arrays *a, body_model **out) {
    *out = NULL;
    sherf_status status = check_sizes(c, a);
    if (status != SHERF_OK) return status;
    size_t n = (size_t)a->vertices;
    body_model *body = mem_zero(c, 1, sizeof *body);
    if (!body) return SHERF_NO_MEMORY;
    status = SHERF_NO_MEMORY;
    body->vertices = a->vertices;
    body->faces = a->faces;
    body->v_template = mem_alloc(c, 3 * n, sizeof *body->v_template);
    body->shapedirs = mem_zero(c, 3 * n * BODY_SHAPES, sizeof *body->shapedirs);
    if (a->posedirs) body->posedirs = mem_alloc(c, 3 * n * BODY_POSE_FEATURES, sizeof *body->posedirs);
    body->weights = mem_alloc(c, n * BODY_JOINTS, sizeof *body->weights);
    body->regressor = mem_alloc(c, n * BODY_JOINTS, sizeof *body->regressor);
    body->face = mem_alloc(c, 3 * (size_t)a->faces, sizeof *body->face);
    if (!body->v_template || !body->shapedirs || (a->posedirs && !body->posedirs) || !body->weights ||
        !body->regressor || !body->face)
        goto fail;
    if ((status = copy_finite(c, "v_template", 3 * n, a->v_template, body->v_template)) != SHERF_OK)
        goto fail;
    int shapes = a->shape_count < BODY_SHAPES ? a->shape_count : BODY_SHAPES;
    for (size_t i = 0; i < 3 * n; i++) {
        status = copy_finite(c, "shapedirs", (size_t)shapes, a->shapedirs + i * (size_t)a->shape_count,
                             body->shapedirs + i * BODY_SHAPES);
        if (status != SHERF_OK) goto fail;
    }
    if (a->posedirs && (status = copy_posedirs(c, a, body->posedirs)) != SHERF_OK) goto fail;
    if ((status = copy_weights(c, a, body->weights)) != SHERF_OK) goto fail;
    if ((status = copy_indices(c, a, body)) != SHERF_OK) goto fail;
    memcpy(body->regressor, a->regressor, n * BODY_JOINTS * sizeof *body->regressor);
    if ((status = regress_joints(c, body)) != SHERF_OK) goto fail;
    if ((status = make_volume(c, a, body)) != SHERF_OK) goto fail;
    body->fingerprint = fingerprint_of(body);
    if ((status = find_neighbours(c, body)) != SHERF_OK) goto fail;
    if ((status = find_mirror(c, body)) != SHERF_OK) goto fail;
    if ((status = canonical_create(c, body)) != SHERF_OK) goto fail;
    *out = body;
    return SHERF_OK;
fail:
    sherf_body_free(body);
    return status;
}

void sherf_body_free(sherf_body *body) {
    if (!body) return;
    mem_free(body->v_template);
    mem_free(body->shapedirs);
    mem_free(body->posedirs);
    mem_free(body->pose_volume);
    mem_free(body->weights);
    mem_free(body->regressor);
    mem_free(body->face);
    posed_body_free(body->canonical);
    mem_free(body->canonical_blend);
    mem_free(body->canonical_inverse);
    vertex_grid_free(body->canonical_grid);
    mem_free(body->neighbour_first);
    mem_free(body->neighbour);
    mem_free(body->mirror);
    mem_free(body);
}

int sherf_body_vertex_count(const sherf_body *body) {
    return body->vertices;
}
int sherf_body_face_count(const sherf_body *body) {
    return body->faces;
}
const uint32_t *sherf_body_faces(const sherf_body *body) {
    return body->face;
}
const vertex_grid *body_canonical_grid(const body_model *body) {
    return body->canonical_grid;
}

void body_canonical_bounds(const body_model *body, float min_canonical[3], float max_canonical[3]) {
    for (int k = 0; k < 3; k++) {
        min_canonical[k] = body->canonical->min_smpl[k] - BODY_SHELL_M;
        max_canonical[k] = body->canonical->max_smpl[k] + BODY_SHELL_M;
    }
}

void body_canonical_bounds_z(const body_model *body, float min_canonical[3], float max_canonical[3]) {
    body_canonical_bounds(body, min_canonical, max_canonical);
    min_canonical[2] -= 0.1f;
    max_canonical[2] += 0.1f;
}

sherf_status body_normals(context *c, const body_model *body, const float *vertices, float *normals) {
    double *sum = mem_zero(c, (size_t)body->vertices, 3 * sizeof *sum);
    if (!sum) return SHERF_NO_MEMORY;
    for (int f = 0; f < body->faces; f++) {
        const uint32_t *i = body->face + 3 * (size_t)f;
        const float *a = vertices + 3 * (size_t)i[0], *b = vertices + 3 * (size_t)i[1],
                    *d = vertices + 3 * (size_t)i[2];
        double u[3], w[3];
        for (int k = 0; k < 3; k++) u[k] = (double)b[k] - a[k], w[k] = (double)d[k] - a[k];
        double n[3] = {u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]};
        double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        if (!(length > 0)) continue; /* a face without area has no normal */
        for (int corner = 0; corner < 3; corner++)
            for (int k = 0; k < 3; k++) sum[3 * (size_t)i[corner] + k] += n[k] / length;
    }
    for (size_t v = 0; v < (size_t)body->vertices; v++) {
        const double *n = sum + 3 * v;
        double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        for (int k = 0; k < 3; k++) normals[3 * v + k] = length > 0 ? (float)(n[k] / length) : 0;
    }
    mem_free(sum);
    return SHERF_OK;
}

void sherf_pose_identity(sherf_pose *out) {
    *out = (sherf_pose){.R = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
}

sherf_status sherf_body_pose(sherf_context *c, const sherf_body *body, const sherf_pose *pose,
                             float *vertices_world_m, float *joints_world_m) {
    posed_body *p;
    sherf_status status = posed_body_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, &p);
    if (status != SHERF_OK) return status;
    if (vertices_world_m) body_vertices_world(body, p, vertices_world_m);
    for (int j = 0; j < BODY_JOINTS && joints_world_m; j++)
        for (int k = 0; k < 3; k++)
            joints_world_m[3 * j + k] = p->R[3 * k] * p->joints_smpl[j][0] +
                                        p->R[3 * k + 1] * p->joints_smpl[j][1] +
                                        p->R[3 * k + 2] * p->joints_smpl[j][2] + p->Th[k];
    posed_body_free(p);
    return SHERF_OK;
}
