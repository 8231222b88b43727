/* SMPL files: loads pickle, npz and safetensors into a body model, and saves safetensors. */
#include <string.h>

#include "base/path.h"
#include "data/data.h"
#include "data/parse.h"

static const char *const body_keys[] = {"v_template", "shapedirs",    "weights", "J_regressor",
                                        "f",          "kintree_table"}; /* posedirs may be missing */

bool document_is_body(const document *d) {
    if (!d || !d->root) return false;
    for (size_t i = 0; i < COUNT_OF(body_keys); i++)
        if (!value_get(d->root, body_keys[i])) return false;
    return true;
}

/* An array of this rank with the given dimensions (0: any), as doubles. */
static sherf_status body_array(context *c, const value *root, const char *key, int rank, int64_t dim[3],
                               double **out) {
    const value *v = value_get(root, key);
    if (!v) return failure(c, SHERF_BAD_FILE, "not an SMPL body: %s is missing", key);
    if (v->kind != VALUE_ARRAY || v->array.rank != rank)
        return failure(c, SHERF_BAD_FILE, "%s: not an array of %d axes", key, rank);
    size_t count = 1;
    for (int i = 0; i < rank; i++) {
        if (dim[i] && v->array.dim[i] != dim[i])
            return failure(c, SHERF_BAD_FILE, "%s: axis %d is %lld long, expected %lld", key, i,
                           (long long)v->array.dim[i], (long long)dim[i]);
        dim[i] = v->array.dim[i];
        count *= (size_t)dim[i];
    }
    *out = mem_alloc(c, count, sizeof **out);
    if (!*out) return SHERF_NO_MEMORY;
    return value_doubles(c, v, key, count, *out);
}

/* (V, 3, 207), or smplx's layouts: (V * 3, 207) or (207, V * 3). */
static sherf_status posedirs_array(context *c, const value *root, int64_t vertices, double **out) {
    const value *v = value_get(root, "posedirs");
    const int64_t rows = vertices * 3, features = BODY_POSE_FEATURES;
    int64_t whole[3] = {vertices, 3, features}, flat[3] = {rows, features}, turned[3] = {features, rows};
    if (v->kind != VALUE_ARRAY || v->array.rank != 2) return body_array(c, root, "posedirs", 3, whole, out);
    if (v->array.dim[0] != features) return body_array(c, root, "posedirs", 2, flat, out);
    double *columns = NULL;
    sherf_status status = body_array(c, root, "posedirs", 2, turned, &columns);
    if (!status && !(*out = mem_alloc(c, (size_t)(rows * features), sizeof **out))) status = SHERF_NO_MEMORY;
    for (int64_t i = 0; i < rows && !status; i++)
        for (int64_t k = 0; k < features; k++) (*out)[i * features + k] = columns[k * rows + i];
    mem_free(columns);
    return status;
}

/* Whole numbers; 2^32 - 1 (the root's parent, as unsigned) and anything else out of range becomes -1. */
static sherf_status to_indices(context *c, const double *from, size_t count, int64_t **out) {
    int64_t *index = mem_alloc(c, count, sizeof *index);
    if (!index) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < count; i++)
        index[i] = from[i] >= 0 && from[i] < BODY_VERTICES_MAX ? (int64_t)from[i] : -1;
    *out = index;
    return SHERF_OK;
}

/* A body's arrays as read from the file, and their sizes. */
typedef struct {
    double *v_template, *shapedirs, *posedirs, *weights, *regressor, *volume, *face, *tree;
    int64_t *face_index, *parent;
    int64_t vertices, faces, shapes;
} body_sources;

static void sources_free(body_sources *p) {
    double *const read[] = {p->v_template, p->shapedirs, p->posedirs, p->weights,
                            p->regressor,  p->volume,    p->face,     p->tree};
    for (size_t i = 0; i < COUNT_OF(read); i++) mem_free(read[i]);
    mem_free(p->face_index);
    mem_free(p->parent);
}

static sherf_status vertices_read(context *c, const value *root, body_sources *p) {
    int64_t dim[3] = {0, 3};
    sherf_status status = body_array(c, root, "v_template", 2, dim, &p->v_template);
    p->vertices = dim[0];
    if (status == SHERF_OK && (dim[0] < 4 || dim[0] > BODY_VERTICES_MAX))
        return failure(c, SHERF_BAD_FILE, "v_template: %lld vertices, expected 4 to %d", (long long)dim[0],
                       BODY_VERTICES_MAX);
    return status;
}

static sherf_status weights_read(context *c, const value *root, body_sources *p) {
    int64_t dim[3] = {p->vertices, 0};
    sherf_status status = body_array(c, root, "weights", 2, dim, &p->weights);
    if (status != SHERF_OK || dim[1] == BODY_JOINTS) return status;
    return failure(c, SHERF_UNSUPPORTED, "a body of %lld joints%s; sherf takes SMPL bodies (24 joints)",
                   (long long)dim[1],
                   dim[1] == 52   ? " (SMPL-H)"
                   : dim[1] == 55 ? " (SMPL-X)"
                                  : "");
}

static sherf_status sources_read(context *c, const value *root, body_sources *p) {
    sherf_status status;
    if ((status = vertices_read(c, root, p)) || (status = weights_read(c, root, p))) return status;
    const int64_t V = p->vertices;
    int64_t shape_dim[3] = {V, 3, 0}, regressor_dim[3] = {BODY_JOINTS, V}, face_dim[3] = {0, 3},
            tree_dim[3] = {2, BODY_JOINTS}, volume_dim[3] = {BODY_JOINTS};
    if ((status = body_array(c, root, "shapedirs", 3, shape_dim, &p->shapedirs)) ||
        (value_get(root, "posedirs") && (status = posedirs_array(c, root, V, &p->posedirs))) ||
        (value_get(root, "pose_volume") &&
         (status = body_array(c, root, "pose_volume", 1, volume_dim, &p->volume))) ||
        (status = body_array(c, root, "J_regressor", 2, regressor_dim, &p->regressor)) ||
        (status = body_array(c, root, "f", 2, face_dim, &p->face)) ||
        (status = body_array(c, root, "kintree_table", 2, tree_dim, &p->tree)))
        return status;
    p->faces = face_dim[0];
    p->shapes = shape_dim[2];
    if (p->faces > 4 * (int64_t)BODY_VERTICES_MAX)
        return failure(c, SHERF_BAD_FILE, "f: %lld faces are too many", (long long)p->faces);
    if ((status = to_indices(c, p->face, (size_t)p->faces * 3, &p->face_index)) ||
        (status = to_indices(c, p->tree, BODY_JOINTS, &p->parent)))
        return status;
    if (p->shapes < 1 || p->shapes > 4096)
        return failure(c, SHERF_BAD_FILE, "shapedirs: %lld shape components", (long long)p->shapes);
    return SHERF_OK;
}

static sherf_status body_from_document(context *c, const document *d, body_model **out) {
    body_sources p = {0};
    *out = NULL;
    sherf_status status = sources_read(c, d->root, &p);
    if (status == SHERF_OK) {
        const body_arrays arrays = {.vertices = (int)p.vertices,
                                    .faces = (int)p.faces,
                                    .shape_count = (int)p.shapes,
                                    .v_template = p.v_template,
                                    .shapedirs = p.shapedirs,
                                    .posedirs = p.posedirs,
                                    .weights = p.weights,
                                    .regressor = p.regressor,
                                    .volume = p.volume,
                                    .face = p.face_index,
                                    .parent = p.parent};
        status = body_create(c, &arrays, out);
    }
    sources_free(&p);
    return status;
}

sherf_status body_load(context *c, const char *path, body_model **out) {
    *out = NULL;
    document *d = NULL;
    const char *kind = "file";
    sherf_status status = parse_file(c, path, &d, &kind);
    if (status) return status;
    if (!value_get(d->root, "v_template"))
        status = failure(c, SHERF_BAD_FILE, "%s: a %s that holds no SMPL body", path, kind);
    else if ((status = body_from_document(c, d, out)))
        failure_prefix(c, status, "%s", path);
    document_free(d);
    return status;
}

sherf_status sherf_body_load(sherf_context *c, const char *path, sherf_body **out) {
    return body_load(c, path, out);
}

sherf_status body_save(context *c, const body_model *body, const char *path) {
    sherf_status status = SHERF_NO_MEMORY;
    size_t V = (size_t)body->vertices;
    int64_t tree[2 * BODY_JOINTS];
    for (int j = 0; j < BODY_JOINTS; j++) {
        tree[j] = body->parent[j];
        tree[BODY_JOINTS + j] = j;
    }
    float *posedirs = body->posedirs ? mem_alloc(c, V * 3 * BODY_POSE_FEATURES, sizeof *posedirs) : NULL;
    int32_t *face = mem_alloc(c, (size_t)body->faces * 3, sizeof *face);
    if ((body->posedirs && !posedirs) || !face) goto done;
    for (size_t i = 0; i < (size_t)body->faces * 3; i++) face[i] = (int32_t)body->face[i];
    for (size_t k = 0; k < BODY_POSE_FEATURES && posedirs; k++) /* back to the files' order, vertex major */
        for (size_t i = 0; i < V * 3; i++)
            posedirs[i * BODY_POSE_FEATURES + k] = body->posedirs[k * V * 3 + i];
    safetensor_item item[] = {
        {"v_template", T_F32, 2, {body->vertices, 3}, body->v_template},
        {"shapedirs", T_F32, 3, {body->vertices, 3, BODY_SHAPES}, body->shapedirs},
        {"weights", T_F32, 2, {body->vertices, BODY_JOINTS}, body->weights},
        {"J_regressor", T_F64, 2, {BODY_JOINTS, body->vertices}, body->regressor},
        {"f", T_I32, 2, {body->faces, 3}, face},
        {"kintree_table", T_I64, 2, {2, BODY_JOINTS}, tree},
        {"pose_volume", T_F32, 1, {BODY_JOINTS}, body->volume},
        {"posedirs", T_F32, 3, {body->vertices, 3, BODY_POSE_FEATURES}, posedirs},
    };
    size_t count = COUNT_OF(item) - 2; /* the last two may be missing */
    if (body->pose_volume) count++;
    if (!body->pose_volume) item[count] = item[COUNT_OF(item) - 1];
    if (posedirs) count++;
    safetensor_metadata metadata[] = {{"format", "sherf-body"}};
    status = safetensors_write(c, path, count, item, COUNT_OF(metadata), metadata);
done:
    mem_free(posedirs);
    mem_free(face);
    return status;
}
