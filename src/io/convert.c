/* convert: sherf_convert. A file's contents determine its kind: an SMPL body, a snapshot of the authors',
 * torch weights of ResNet-18, VGG16 or LPIPS's heads, or TensorFlow.js weights of ResNet-50 or graphs. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/path.h"
#include "io/build.h"
#include "io/checkpoint.h"
#include "io/convert.h"
#include "io/tfjs.h"

/* ---------------------------------------------------------------- the output --------------------------- */

/* Adds an array under a name, as the given type (float32, float64, I32 or I64) and shape. */
static sherf_status put(conversion *o, const char *name, const value *v, dtype type, int rank,
                        const int64_t *dim) {
    int64_t n = build_count(v->array.rank, v->array.dim);
    size_t size = dtype_size(type);
    void *data = v->array.data;
    if (v->array.type != type || type == T_I64) {
        data = convert_memory(o, n, size);
        if (!data) return SHERF_NO_MEMORY;
        bool whole = v->array.type == T_I64 || v->array.type == T_I32;
        for (int64_t i = 0; i < n; i++)
            if (type == T_F32)
                ((float *)data)[i] = (float)value_array_number(v, i);
            else if (type == T_F64)
                ((double *)data)[i] = value_array_number(v, i);
            else {
                int64_t k = v->array.type == T_I64 ? ((const int64_t *)v->array.data)[i]
                            : whole                ? ((const int32_t *)v->array.data)[i]
                                                   : (int64_t)value_array_number(v, i);
                if (type == T_I64 && k == UINT32_MAX) k = -1; /* "no parent" of the tree's root */
                if (type == T_I32 && (k < INT32_MIN || k > INT32_MAX))
                    return failure(o->c, SHERF_BAD_FILE, "%s: index %lld is too large", name, (long long)k);
                if (type == T_I32)
                    ((int32_t *)data)[i] = (int32_t)k;
                else
                    ((int64_t *)data)[i] = k;
            }
    }
    return convert_add(o, name, type, rank, dim, data);
}

static sherf_status put_floats(conversion *o, const char *name, const value *v) {
    return put(o, name, v, T_F32, v->array.rank, v->array.dim);
}

/* ---------------------------------------------------------------- SMPL ------------------------------- */
enum { JOINTS = 24, SHAPES = 10, POSE_FEATURES = 207 };

/* A body's array of the wanted shape; -1 in `want` allows any size and is replaced by it. */
static sherf_status body_array(conversion *o, const value *root, const char *key, int rank, int64_t *want,
                               const value **out) {
    const value *v = value_get(root, key);
    if (!v) return failure(o->c, SHERF_BAD_FILE, "body: %s is missing", key);
    if (v->kind == VALUE_RECORD)
        return failure(o->c, SHERF_UNSUPPORTED, "body: %s is a %s, which is not read", key,
                       v->record.class_name);
    if (v->kind != VALUE_ARRAY) return failure(o->c, SHERF_BAD_FILE, "body: %s is no array", key);
    bool same = v->array.rank == rank;
    for (int i = 0; same && i < rank; i++) {
        if (want[i] < 0) want[i] = v->array.dim[i];
        same = v->array.dim[i] == want[i];
    }
    if (!same) return failure(o->c, SHERF_BAD_FILE, "body: %s has another shape than a body's", key);
    *out = v;
    return SHERF_OK;
}

/* Writes the first SHAPES of the shape components; missing ones become zeros. */
static sherf_status put_shapes(conversion *o, const value *v) {
    int64_t vertices = v->array.dim[0], have = v->array.dim[2], dim[3] = {vertices, 3, SHAPES};
    float *data = convert_memory(o, vertices * 3 * SHAPES, sizeof *data);
    if (!data) return SHERF_NO_MEMORY;
    for (int64_t i = 0; i < vertices * 3; i++)
        for (int64_t k = 0; k < SHAPES; k++)
            data[i * SHAPES + k] = k < have ? (float)value_array_number(v, i * have + k) : 0;
    value whole = {.kind = VALUE_ARRAY};
    whole.array.type = T_F32;
    whole.array.rank = 3;
    memcpy(whole.array.dim, dim, sizeof dim);
    whole.array.data = data;
    return put(o, "shapedirs", &whole, T_F32, 3, dim);
}

static sherf_status smpl(conversion *o, const value *root, char **said) {
    int64_t v_dim[] = {-1, 3}, f_dim[] = {-1, 3}, tree_dim[] = {2, -1}, w_dim[] = {-1, -1},
            s_dim[] = {-1, 3, -1}, p_dim[] = {-1, 3, POSE_FEATURES}, r_dim[] = {JOINTS, -1};
    const value *v, *f, *tree, *weights, *shapes, *poses, *regressor;
    sherf_status status = body_array(o, root, "v_template", 2, v_dim, &v);
    if (status == SHERF_OK) status = body_array(o, root, "weights", 2, w_dim, &weights);
    if (status != SHERF_OK) return status;
    if (w_dim[1] != JOINTS)
        return failure(o->c, SHERF_UNSUPPORTED,
                       "a body of %lld joints; only SMPL bodies (24 joints) are taken", (long long)w_dim[1]);
    s_dim[0] = p_dim[0] = r_dim[1] = v_dim[0];
    tree_dim[1] = JOINTS;
    if (status == SHERF_OK && w_dim[0] != v_dim[0])
        return failure(o->c, SHERF_BAD_FILE, "body: weights are not one row a vertex");
    if (status == SHERF_OK) status = body_array(o, root, "f", 2, f_dim, &f);
    if (status == SHERF_OK) status = body_array(o, root, "kintree_table", 2, tree_dim, &tree);
    if (status == SHERF_OK) status = body_array(o, root, "shapedirs", 3, s_dim, &shapes);
    if (status == SHERF_OK) status = body_array(o, root, "posedirs", 3, p_dim, &poses);
    if (status == SHERF_OK) status = body_array(o, root, "J_regressor", 2, r_dim, &regressor);
    if (status == SHERF_OK) status = put(o, "v_template", v, T_F32, 2, v_dim);
    if (status == SHERF_OK) status = put_shapes(o, shapes);
    if (status == SHERF_OK) status = put(o, "posedirs", poses, T_F32, 3, p_dim);
    if (status == SHERF_OK) status = put(o, "weights", weights, T_F32, 2, w_dim);
    /* sums over thousands of vertices: kept at the file's precision */
    if (status == SHERF_OK)
        status = put(o, "J_regressor", regressor, regressor->array.type == T_F32 ? T_F32 : T_F64, 2, r_dim);
    if (status == SHERF_OK) status = put(o, "f", f, T_I32, 2, f_dim);
    if (status == SHERF_OK) status = put(o, "kintree_table", tree, T_I64, 2, tree_dim);
    if (status != SHERF_OK) return status;
    convert_describe(o, "format", "sherf-body");
    *said = convert_text(o, "SMPL body: %lld vertices, %lld faces, %lld shape components%s",
                         (long long)v_dim[0], (long long)f_dim[0], (long long)s_dim[2],
                         s_dim[2] > SHAPES ? " (the first 10 are kept)" : "");
    return *said ? SHERF_OK : SHERF_NO_MEMORY;
}

/* ---------------------------------------------------------------- snapshots -------------------------- */
static char *plain_text(conversion *o, const value *v) {
    if (!v) return NULL;
    switch (v->kind) {
    case VALUE_BOOL:
        return convert_text(o, "%s", v->boolean ? "true" : "false");
    case VALUE_INTEGER:
        return convert_text(o, "%lld", (long long)v->integer);
    case VALUE_REAL:
        return convert_text(o, "%.9g", v->real);
    case VALUE_STRING:
        for (size_t i = 0; i < v->string.length; i++)
            if (v->string.text[i] < ' ' || v->string.text[i] > '~') return NULL;
        return convert_text(o, "%.200s", v->string.text);
    default:
        return NULL;
    }
}

/* The snapshot's settings, for people to read; the model's sizes follow from its tensors. */
static void snapshot_settings(conversion *o, const value *root, const value *network) {
    static const struct {
        const char *key, *of_rendering, *of_network;
    } setting[] = {{"snapshot.image_resolution", "image_resolution", NULL},
                   {"snapshot.depth_resolution", "depth_resolution", NULL},
                   {"snapshot.white_back", "white_back", NULL},
                   {"snapshot.density_noise", "density_noise", NULL},
                   {"snapshot.use_1d_feature", NULL, "use_1d_feature"},
                   {"snapshot.use_2d_feature", NULL, "use_2d_feature"},
                   {"snapshot.use_3d_feature", NULL, "use_3d_feature"},
                   {"snapshot.z_dim", NULL, "z_dim"},
                   {"snapshot.w_dim", NULL, "w_dim"}};
    const value *rendering = value_get(network, "rendering_kwargs");
    const value *widths = value_get(network, "_init_kwargs"), *data = value_get(root, "training_set_kwargs");
    convert_describe(o, "snapshot.class", network->record.class_name);
    for (size_t i = 0; i < COUNT_OF(setting); i++)
        convert_describe(o, setting[i].key,
                         plain_text(o, setting[i].of_network
                                           ? value_get(network, setting[i].of_network)
                                           : value_get(rendering, setting[i].of_rendering)));
    convert_describe(o, "snapshot.channel_base", plain_text(o, value_get(widths, "channel_base")));
    convert_describe(o, "snapshot.channel_max", plain_text(o, value_get(widths, "channel_max")));
    convert_describe(o, "snapshot.data", plain_text(o, value_get(data, "class_name")));
    convert_describe(o, "snapshot.data_resolution", plain_text(o, value_get(data, "resolution")));
}

static sherf_status snapshot(conversion *o, const value *root, named_arrays *arrays, char **said) {
    bool average = module_is(value_get(root, "G_ema"));
    const value *network = value_get(root, average ? "G_ema" : "G");
    sherf_status status = module_flatten(o->c, network, arrays);
    if (status != SHERF_OK) return status;
    if (!named_arrays_find(arrays, "renderer.encoder_3d.conv0.0.weight") ||
        !named_arrays_find(arrays, "backbone.synthesis.b4.const"))
        return failure(o->c, SHERF_MISMATCH,
                       "a snapshot of %.200s with %zu tensors, which is no SHERF network",
                       network->record.class_name, arrays->count);
    int64_t numbers = 0;
    for (size_t i = 0; i < arrays->count && status == SHERF_OK; i++) {
        status = put_floats(o, arrays->item[i].name, arrays->item[i].array);
        numbers += build_count(arrays->item[i].array->array.rank, arrays->item[i].array->array.dim);
    }
    if (status != SHERF_OK) return status;
    convert_describe(o, "format", "sherf-model");
    convert_describe(o, "source", "snapshot");
    snapshot_settings(o, root, network);
    *said = convert_text(o, "SHERF snapshot (%s): %zu tensors, %.1f million numbers", average ? "G_ema" : "G",
                         arrays->count, (double)numbers * 1e-6);
    return *said ? SHERF_OK : SHERF_NO_MEMORY;
}

/* ---------------------------------------------------------------- torch weights ---------------------- */
static const int vgg_index[13] = {0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28};
static const int vgg_width[13] = {64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512};
static const int vgg_stage[13] = {1, 1, 2, 2, 3, 3, 3, 4, 4, 4, 5, 5, 5};
static const int head_width[5] = {64, 128, 256, 512, 512};

/* 18 or 34: the layers of a ResNet of basic blocks; else 0. */
static int resnet_depth(const named_arrays *n) {
    const int64_t first[] = {64, 3, 7, 7}, last[] = {512, 512, 3, 3};
    if (!named_arrays_has_shape(n, "conv1.weight", 4, first) ||
        !named_arrays_find(n, "layer1.0.conv1.weight") || named_arrays_find(n, "layer1.0.conv3.weight"))
        return 0;
    if (named_arrays_find(n, "layer1.2.conv1.weight"))
        return named_arrays_find(n, "layer3.5.conv1.weight") &&
                       named_arrays_has_shape(n, "layer4.2.conv2.weight", 4, last)
                   ? 34
                   : 0;
    return named_arrays_has_shape(n, "layer4.1.conv2.weight", 4, last) ? 18 : 0;
}

/* The tensor of VGG16's layer k, by torchvision's name or by that of the LPIPS package's slices. */
static const value *vgg_tensor(const named_arrays *n, int k, const char *part) {
    char name[64];
    snprintf(name, sizeof name, "features.%d.%s", vgg_index[k], part);
    const value *v = named_arrays_find(n, name);
    if (v) return v;
    snprintf(name, sizeof name, "net.slice%d.%d.%s", vgg_stage[k], vgg_index[k], part);
    return named_arrays_find(n, name);
}

/* Whether it is VGG16, or a file that is meant to be: it has most of the 26 tensors. `fault` then says what
 * is wrong with the others; empty: nothing. */
static bool vgg16_is(const named_arrays *n, char *fault, size_t size) {
    int there = 0;
    fault[0] = 0;
    for (int k = 0, in = 3; k < 13; in = vgg_width[k++])
        for (int bias = 0; bias < 2; bias++) {
            const char *part = bias ? "bias" : "weight";
            const int64_t dim[] = {vgg_width[k], in, 3, 3};
            const value *v = vgg_tensor(n, k, part);
            bool same = v && v->array.rank == (bias ? 1 : 4);
            for (int i = 0; same && i < v->array.rank; i++) same = v->array.dim[i] == dim[i];
            there += v != NULL;
            if (!same && !fault[0])
                snprintf(fault, size, "VGG16's features.%d.%s %s", vgg_index[k], part,
                         v ? "has another shape" : "is missing");
        }
    return there > 20;
}

static const value *head(const named_arrays *n, int k) {
    static const char *const form[] = {"lin%d.model.1.weight", "lin%d.weight", "lin%d",
                                       "lins.%d.model.1.weight"};
    char name[64];
    for (size_t i = 0; i < COUNT_OF(form); i++) {
        snprintf(name, sizeof name, form[i], k);
        const value *v = named_arrays_find(n, name);
        if (v && build_count(v->array.rank, v->array.dim) == head_width[k]) return v;
    }
    return NULL;
}

static sherf_status put_vgg16(conversion *o, const named_arrays *n) {
    static const char *const part[] = {"weight", "bias"};
    sherf_status status = SHERF_OK;
    for (int i = 0; i < 26 && status == SHERF_OK; i++) {
        const char *name = convert_text(o, "features.%d.%s", vgg_index[i / 2], part[i % 2]);
        status = name ? put_floats(o, name, vgg_tensor(n, i / 2, part[i % 2])) : SHERF_NO_MEMORY;
    }
    return status;
}

static sherf_status put_heads(conversion *o, const named_arrays *n) {
    sherf_status status = SHERF_OK;
    for (int k = 0; k < 5 && status == SHERF_OK; k++) {
        const char *name = convert_text(o, "lin%d", k);
        const int64_t dim[1] = {head_width[k]};
        status = name ? put(o, name, head(n, k), T_F32, 1, dim) : SHERF_NO_MEMORY;
    }
    return status;
}

static sherf_status weights(conversion *o, const value *root, const char *kind, named_arrays *n,
                            char **said) {
    sherf_status status = state_dict_flatten(o->c, root, n);
    if (status == SHERF_BAD_FILE)
        return failure(o->c, SHERF_MISMATCH,
                       "a %s file that is neither a body nor a snapshot nor known weights", kind);
    if (status != SHERF_OK) return status;
    char fault[96];
    const int depth = resnet_depth(n);
    bool heads = true, vgg = vgg16_is(n, fault, sizeof fault);
    if (vgg && fault[0]) return failure(o->c, SHERF_MISMATCH, "%s", fault);
    for (int k = 0; k < 5; k++) heads = heads && head(n, k);
    if (depth) {
        convert_describe(o, "format", depth == 18 ? "resnet18" : "resnet34");
        *said = convert_text(o, "ResNet-%d: %zu tensors", depth, n->count);
        for (size_t i = 0; i < n->count && status == SHERF_OK; i++)
            status = put_floats(o, n->item[i].name, n->item[i].array);
    } else if (vgg || heads) {
        convert_describe(o, "format", vgg && heads ? "lpips" : vgg ? "vgg16" : "lpips-heads");
        *said = convert_text(o, vgg && heads ? "LPIPS: VGG16 and its five heads"
                                : vgg        ? "VGG16: its 13 convolutions"
                                             : "LPIPS: five heads");
        if (vgg) status = put_vgg16(o, n);
        if (heads && status == SHERF_OK) status = put_heads(o, n);
    } else
        return failure(
            o->c, SHERF_MISMATCH,
            "%zu tensors (%.100s ...), which are neither ResNet-18 or 34 nor VGG16 nor heads of LPIPS",
            n->count, n->item[0].name);
    return status == SHERF_OK && !*said ? SHERF_NO_MEMORY : status;
}

/* ---------------------------------------------------------------- graphs ----------------------------- */
/* The two that find people and their landmarks: a folder with both becomes one file. */
static const char *const pose_graphs[] = {"blazepose-detector", "blazepose-heavy"};

static sherf_status second_graph(conversion *o, char *folder) {
    char path[PATH_LENGTH];
    document *d;
    if (snprintf(path, sizeof path, "%s/%s.json", folder, pose_graphs[1]) >= (int)sizeof path)
        return failure(o->c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", folder);
    sherf_status status = json_read(o->c, path, &d);
    if (status != SHERF_OK) return status;
    status = tfjs_is_graph(d->root) ? convert_graph(o, d->root, pose_graphs[1], folder)
                                    : failure(o->c, SHERF_MISMATCH, "%s: no TensorFlow.js graph model", path);
    document_free(d);
    return status;
}

/* Named after its file. */
static sherf_status graphs(conversion *o, const value *root, const char *file, char *folder, bool both,
                           char **said) {
    const char *slash = strrchr(file, '/'), *name = slash ? slash + 1 : file;
    const int length = (int)strcspn(name, ".");
    char *named = convert_text(o, "%.*s", length < 100 ? length : 100, name);
    convert_describe(o, "format", "graph");
    sherf_status status = named ? convert_graph(o, root, named, folder) : SHERF_NO_MEMORY;
    if (status == SHERF_OK && both) status = second_graph(o, folder);
    if (status != SHERF_OK) return status;
    *said = convert_text(o, "%s%s%s: %zu arrays of weights in float16", both ? "graphs " : "graph ", named,
                         both ? " and blazepose-heavy" : "", o->count);
    return *said ? SHERF_OK : SHERF_NO_MEMORY;
}

/* ---------------------------------------------------------------- the verb --------------------------- */
static sherf_status recognise(conversion *o, const value *root, const char *kind, const char *file,
                              char *folder, bool both, named_arrays *arrays, char **said) {
    const value *format = value_get(value_get(root, "__metadata__"), "format");
    if (!strcmp(kind, "safetensors") && format && format->kind == VALUE_STRING)
        return failure(o->c, SHERF_BAD_ARGUMENT, "is converted already (%.40s)", format->string.text);
    if (value_get(root, "v_template") || (value_get(root, "kintree_table") && value_get(root, "shapedirs")))
        return smpl(o, root, said);
    if (tfjs_is_graph(root)) return graphs(o, root, file, folder, both, said);
    if (tfjs_is(root)) return convert_resnet50(o, root, folder, said);
    if (root->kind == VALUE_DICT && (module_is(value_get(root, "G_ema")) || module_is(value_get(root, "G"))))
        return snapshot(o, root, arrays, said);
    return weights(o, root, kind, arrays, said);
}

/* Finds the file to read and its folder: a TensorFlow.js model may be given as its folder, and so may both of
 * pose_graphs. */
static sherf_status input_paths(context *c, const char *input, char file[PATH_LENGTH],
                                char folder[PATH_LENGTH], bool *both) {
    bool inside = path_is_folder(input);
    *both = false;
    if (snprintf(file, PATH_LENGTH, inside ? "%s/model.json" : "%s", input) >= PATH_LENGTH - 32)
        return failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", input);
    if (inside && !path_is_file(file)) {
        snprintf(file, PATH_LENGTH, "%s/%s.json", input, pose_graphs[0]);
        *both = path_is_file(file);
        if (!*both)
            return failure(c, SHERF_NO_FILE, "%s: a folder without a model.json (TensorFlow.js)", input);
    }
    memcpy(folder, file, PATH_LENGTH);
    char *slash = strrchr(folder, '/');
    if (!slash)
        memcpy(folder, ".", 2);
    else
        slash[slash == folder] = 0;
    return SHERF_OK;
}

sherf_status sherf_convert(sherf_context *c, const char *input, const char *path, char **description) {
    char file[PATH_LENGTH], folder[PATH_LENGTH];
    document *d = NULL;
    const char *kind;
    char *said = NULL;
    conversion o = {.c = c};
    named_arrays arrays = {0};
    bool both;
    if (description) *description = NULL;
    sherf_status status = input_paths(c, input, file, folder, &both);
    if (status == SHERF_OK) status = document_read(c, file, &d, &kind);
    if (status != SHERF_OK) return status;
    o.memory = arena_create(c);
    status = o.memory ? recognise(&o, d->root, kind, file, folder, both, &arrays, &said) : SHERF_NO_MEMORY;
    if (status != SHERF_OK) {
        failure_prefix(c, status, "%s", input);
        goto done;
    }
    if (description && !(*description = mem_string(c, said))) {
        status = SHERF_NO_MEMORY;
        goto done;
    }
    status = safetensors_write(c, path, o.count, o.item, o.metadata_count, o.metadata);
    if (status != SHERF_OK && description) {
        mem_free(*description);
        *description = NULL;
    }
done:
    named_arrays_free(&arrays);
    mem_free(o.item);
    if (o.memory) arena_free(o.memory);
    document_free(d);
    return status;
}
