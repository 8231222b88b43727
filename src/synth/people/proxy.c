/* Reading proxies and fitting them. */
#include "synth/people/proxy.h"

#include <math.h>
#include <string.h>

#include "base/path.h"

static const float unit_m = 0.1f; /* files are in decimetres */

/* ---- reading ---- */

/* Rows of three numbers. */
static sherf_status rows_of_three(context *c, const value *v, const char *what, int rows, double **out) {
    *out = NULL;
    if (value_count(v) != (size_t)rows) return failure(c, SHERF_BAD_FILE, "%s: %d rows expected", what, rows);
    double *row = mem_alloc(c, (size_t)rows, 3 * sizeof *row);
    if (!row) return SHERF_NO_MEMORY;
    for (int i = 0; i < rows; i++) {
        sherf_status status = value_doubles(c, value_at(v, (size_t)i), what, 3, row + 3 * i);
        if (status) {
            mem_free(row);
            return status;
        }
    }
    *out = row;
    return SHERF_OK;
}

static sherf_status read_binding(context *c, const value *root, int base_vertices, const float *base_vertex,
                                 proxy *p) {
    double *ref = NULL, *weight = NULL, *offset = NULL;
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    size_t rows = value_count(value_get(root, "ref_vIdxs"));
    if (rows < 3 || rows > PROXY_VERTICES_MAX)
        return failure(c, SHERF_BAD_FILE, "ref_vIdxs: 3 to %d rows expected", PROXY_VERTICES_MAX);
    p->vertices = (int)rows;
    sherf_status status = rows_of_three(c, value_get(root, "ref_vIdxs"), "ref_vIdxs", p->vertices, &ref);
    if (!status) status = rows_of_three(c, value_get(root, "weights"), "weights", p->vertices, &weight);
    if (!status) status = rows_of_three(c, value_get(root, "offsets"), "offsets", p->vertices, &offset);
    if (status) goto done;
    p->ref = mem_alloc(c, rows * 3, sizeof *p->ref);
    p->weight = mem_alloc(c, rows * 3, sizeof *p->weight);
    p->offset = mem_alloc(c, rows * 3, sizeof *p->offset);
    if (!p->ref || !p->weight || !p->offset) {
        status = SHERF_NO_MEMORY;
        goto done;
    }
    for (size_t i = 0; i < rows * 3; i++) {
        if (!(ref[i] >= 0 && ref[i] < base_vertices) || ref[i] != floor(ref[i]) || !(fabs(weight[i]) < 1e3) ||
            !(fabs(offset[i]) < 1e3)) {
            status = failure(c, SHERF_BAD_FILE, "row %zu: bound to no vertex of the base mesh", i / 3);
            goto done;
        }
        p->ref[i] = (uint32_t)ref[i];
        p->weight[i] = (float)weight[i];
        p->offset[i] = (float)offset[i] * unit_m;
        for (int k = 0; k < 3; k++) {
            float x = base_vertex[3 * p->ref[i] + k];
            low[k] = fminf(low[k], x), high[k] = fmaxf(high[k], x);
        }
    }
    for (int k = 0; k < 3; k++) p->extent[k] = high[k] - low[k];
done:
    mem_free(ref);
    mem_free(weight);
    mem_free(offset);
    return status;
}

static sherf_status read_uvs(context *c, const value *root, proxy *p) {
    const value *list = value_at(value_get(root, "uvs"), 0);
    size_t n = value_count(list);
    if (!n || n % 2 || n > 8 * PROXY_VERTICES_MAX) return failure(c, SHERF_BAD_FILE, "uvs: not pairs");
    p->uv = mem_alloc(c, n, sizeof *p->uv);
    if (!p->uv) return SHERF_NO_MEMORY;
    p->uvs = (int)(n / 2);
    return value_floats(c, list, "uvs", n, p->uv);
}

/* Reads faces in three.js' format 3: flags, corners, then the parts that the flags name. */
enum {
    FACE_QUAD = 1,
    FACE_MATERIAL = 2,
    FACE_CORNER_UV = 8,
    FACE_CORNER_NORMAL = 32,
    FACE_KNOWN = 1 | 2 | 8 | 32
};

static sherf_status read_faces(context *c, const value *root, proxy *p) {
    const value *list = value_get(root, "faces");
    size_t n = value_count(list), at = 0;
    double *number = mem_alloc(c, n + 1, sizeof *number);
    if (!number) return SHERF_NO_MEMORY;
    sherf_status status =
        n ? value_doubles(c, list, "faces", n, number) : failure(c, SHERF_BAD_FILE, "no faces");
    if (status) goto done;
    status = SHERF_NO_MEMORY; /* a face of two triangles takes at least nine numbers */
    p->triangle = mem_alloc(c, n / 9 * 2 + 2, 3 * sizeof *p->triangle);
    p->triangle_uv = mem_alloc(c, n / 9 * 2 + 2, 3 * sizeof *p->triangle_uv);
    if (!p->triangle || !p->triangle_uv) goto done;
    size_t room = n / 9 * 2 + 2;
    while (at < n) {
        int flags = number[at] >= 0 && number[at] < 256 ? (int)number[at] : 0;
        size_t corners = flags & FACE_QUAD ? 4 : 3, first = at + 1,
               uv = first + corners + (flags & FACE_MATERIAL ? 1 : 0);
        at = uv + corners + (flags & FACE_CORNER_NORMAL ? corners : 0);
        status = failure(c, SHERF_BAD_FILE, "a face that is not of triangles or quads with uvs");
        if ((flags & ~FACE_KNOWN) || !(flags & FACE_CORNER_UV) || at > n || (size_t)p->triangles + 2 > room)
            goto done;
        for (size_t k = 0; k < corners; k++)
            if (!(number[first + k] >= 0 && number[first + k] < p->vertices) ||
                !(number[uv + k] >= 0 && number[uv + k] < p->uvs))
                goto done;
        for (size_t k = 2; k < corners; k++) {
            uint32_t *t = p->triangle + 3 * p->triangles, *u = p->triangle_uv + 3 * p->triangles;
            const size_t corner[3] = {0, k - 1, k};
            for (int i = 0; i < 3; i++) {
                t[i] = (uint32_t)number[first + corner[i]];
                u[i] = (uint32_t)number[uv + corner[i]];
            }
            p->triangles++;
        }
    }
    status = SHERF_OK;
done:
    mem_free(number);
    return status;
}

static sherf_status read_textures(context *c, const value *root, proxy *p) {
    const value *materials = value_get(root, "materials");
    for (size_t i = 0; i < value_count(materials) && p->textures < PROXY_TEXTURES_MAX; i++) {
        const value *map = value_get(value_at(materials, i), "mapDiffuse");
        if (!map || map->kind != VALUE_STRING) continue;
        if (*map->string.text == '/' || strstr(map->string.text, ".."))
            return failure(c, SHERF_BAD_FILE, "mapDiffuse: leads out of the folder");
        p->texture[p->textures] = mem_string(c, map->string.text);
        if (!p->texture[p->textures++]) return SHERF_NO_MEMORY;
    }
    return SHERF_OK;
}

static sherf_status read_hidden(context *c, const value *root, int base_vertices, proxy *p) {
    const value *list = value_get(value_get(root, "metadata"), "deleteVerts");
    size_t n = value_count(list);
    p->hides = mem_zero(c, (size_t)base_vertices, 1);
    if (!p->hides) return SHERF_NO_MEMORY;
    if (n != (size_t)base_vertices) return SHERF_OK; /* the file names none */
    for (size_t i = 0; i < n; i++) {
        const value *v = value_at(list, i);
        p->hides[i] =
            v && ((v->kind == VALUE_BOOL && v->boolean) || (v->kind == VALUE_INTEGER && v->integer) ||
                  (v->kind == VALUE_REAL && v->real != 0));
        p->hidden += p->hides[i];
    }
    return SHERF_OK;
}

sherf_status proxy_parse(context *c, const value *root, const char *name, int base_vertices,
                         const float *base_vertex, proxy **out) {
    *out = NULL;
    proxy *p = mem_zero(c, 1, sizeof *p);
    if (!p) return SHERF_NO_MEMORY;
    sherf_status status = SHERF_NO_MEMORY;
    p->name = mem_string(c, name);
    if (p->name && !(status = read_binding(c, root, base_vertices, base_vertex, p)) &&
        !(status = read_uvs(c, root, p)) && !(status = read_faces(c, root, p)) &&
        !(status = read_textures(c, root, p)) && !(status = read_hidden(c, root, base_vertices, p))) {
        *out = p;
        return SHERF_OK;
    }
    proxy_free(p);
    return status;
}

sherf_status proxy_read(context *c, const char *folder, int base_vertices, const float *base_vertex,
                        proxy **out) {
    *out = NULL;
    const char *slash = strrchr(folder, '/'), *name = slash ? slash + 1 : folder;
    char path[PATH_LENGTH];
    document *d;
    int n = snprintf(path, sizeof path, "%s/%s.json", folder, name);
    if (n < 0 || n >= PATH_LENGTH) return failure(c, SHERF_BAD_ARGUMENT, "%.200s: path too long", folder);
    sherf_status status = json_read(c, path, &d);
    if (status) return status;
    status = proxy_parse(c, d->root, name, base_vertices, base_vertex, out);
    document_free(d);
    return status == SHERF_BAD_FILE ? failure_prefix(c, status, "%s", path) : status;
}

void proxy_free(proxy *p) {
    if (!p) return;
    for (int i = 0; i < p->textures; i++) mem_free(p->texture[i]);
    mem_free(p->name);
    mem_free(p->ref);
    mem_free(p->weight);
    mem_free(p->offset);
    mem_free(p->triangle);
    mem_free(p->triangle_uv);
    mem_free(p->uv);
    mem_free(p->hides);
    mem_free(p);
}

/* ---- fitting ---- */

/* Offsets scale with the part of the body that carries them. This package's files do not name the measure, so
 * it is the bound part's size, within bounds that keep cloth from swelling on long arms. */
static void offset_scale(const proxy *p, const float *base_vertex, float scale[3]) {
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (int i = 0; i < 3 * p->vertices; i++)
        for (int k = 0; k < 3; k++) {
            float x = base_vertex[3 * p->ref[i] + k];
            low[k] = fminf(low[k], x), high[k] = fmaxf(high[k], x);
        }
    for (int k = 0; k < 3; k++) {
        scale[k] = p->extent[k] > 1e-6f ? (high[k] - low[k]) / p->extent[k] : 1;
        scale[k] = fminf(fmaxf(scale[k], 0.8f), 1.3f);
    }
}

void proxy_fit(const proxy *p, const float *base_vertex, float *vertex) {
    float scale[3];
    offset_scale(p, base_vertex, scale);
    for (int i = 0; i < p->vertices; i++)
        for (int k = 0; k < 3; k++) {
            float x = p->offset[3 * i + k] * scale[k];
            for (int n = 0; n < 3; n++) x += p->weight[3 * i + n] * base_vertex[3 * p->ref[3 * i + n] + k];
            vertex[3 * i + k] = x;
        }
}

void proxy_carry(const proxy *p, int count, const float *base_row, float *row) {
    for (int i = 0; i < p->vertices; i++) {
        float *out = row + (size_t)i * (size_t)count, total = 0, w[3];
        for (int n = 0; n < 3; n++) total += w[n] = fmaxf(p->weight[3 * i + n], 0); /* no extrapolation */
        for (int n = 0; n < 3 && !(total > 0); n++) w[n] = 1;
        if (!(total > 0)) total = 3;
        memset(out, 0, (size_t)count * sizeof *out);
        for (int n = 0; n < 3; n++) {
            const float *from = base_row + (size_t)p->ref[3 * i + n] * (size_t)count;
            for (int k = 0; k < count; k++) out[k] += w[n] / total * from[k];
        }
    }
}
