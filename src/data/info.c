/* Describes a file's kind and contents, as lines or as one JSON object. */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include "data/dataset.h"
#include "data/text.h"

enum { LISTED_MAX = 40, DEPTH_MAX = 3 }; /* of the lines form */

typedef struct {
    context *c;
    bool json, first;
    text_builder text;
} teller;

static void key(teller *t, const char *name) {
    if (t->json) {
        text_add(&t->text, "%s", t->first ? "" : ", ");
        text_add_json(&t->text, name);
        text_add(&t->text, ": ");
    } else {
        text_add(&t->text, "%-12s ", name);
    }
    t->first = false;
}

static void PRINTF_LIKE(3, 4) tell(teller *t, const char *name, const char *format, ...) {
    char line[2048];
    va_list args;
    va_start(args, format);
    vsnprintf(line, sizeof line, format, args);
    va_end(args);
    key(t, name);
    if (t->json)
        text_add_json(&t->text, line);
    else
        text_add(&t->text, "%s\n", line);
}

static void tell_number(teller *t, const char *name, double number) {
    key(t, name);
    if (t->json && !isfinite(number))
        text_add(&t->text, "null");
    else
        text_add(&t->text, number == floor(number) && fabs(number) < 1e15 ? "%.0f" : "%.9g", number);
    if (!t->json) text_add(&t->text, "\n");
}

static void shape_text(int rank, const int64_t *dim, char out[256]) {
    int n = snprintf(out, 256, "[");
    for (int i = 0; i < rank && n < 230; i++)
        n += snprintf(out + n, (size_t)(256 - n), "%s%lld", i ? ", " : "", (long long)dim[i]);
    snprintf(out + n, (size_t)(256 - n), "]");
}

/* ---- safetensors ---- */

static const char *format_says(const char *format) {
    static const struct {
        const char *name, *says;
    } known[] = {
        {"sherf-model", "model weights"},
        {"sherf-avatar", "an avatar"},
        {"sherf-avatar-of-several", "an avatar of several pictures"},
        {"sherf-baked-avatar", "a baked avatar"},
        {"sherf-checkpoint", "a training checkpoint"},
        {"sherf-body", "a body model"},
        {"resnet18", "ResNet-18 weights"},
        {"resnet34", "ResNet-34 weights"},
        {"vgg16", "VGG16 weights"},
        {"lpips-heads", "LPIPS heads"},
        {"lpips", "VGG16 with LPIPS heads"},
        {"graph", "networks as graphs of nodes"},
    };
    for (size_t i = 0; format && i < COUNT_OF(known); i++)
        if (!strcmp(format, known[i].name)) return known[i].says;
    return "tensors";
}

static void tell_tensors(teller *t, const safetensors *s) {
    if (t->json) {
        key(t, "tensors");
        text_add(&t->text, "[");
    }
    for (size_t i = 0; i < s->count; i++) {
        const safetensor *x = &s->tensor[i];
        char shape[256];
        shape_text(x->rank, x->dim, shape);
        if (!t->json && i == LISTED_MAX && s->count > LISTED_MAX + 1) {
            text_add(&t->text, "  ... and %zu more (all with --json)\n", s->count - i);
            break;
        }
        if (t->json) {
            text_add(&t->text, "%s{\"name\": ", i ? ", " : "");
            text_add_json(&t->text, x->name);
            text_add(&t->text, ", \"type\": \"%s\", \"shape\": %s}", dtype_name(x->type), shape);
        } else {
            text_add(&t->text, "  %s %s %s\n", x->name, dtype_name(x->type), shape);
        }
    }
    if (t->json) text_add(&t->text, "]");
}

static sherf_status info_safetensors(teller *t, const char *path) {
    safetensors *s = NULL;
    sherf_status status = safetensors_read(t->c, path, &s);
    if (status) return status;
    double values = 0, bytes = 0;
    for (size_t i = 0; i < s->count; i++) {
        double n = 1;
        for (int k = 0; k < s->tensor[i].rank; k++) n *= (double)s->tensor[i].dim[k];
        values += n;
        bytes += n * (double)dtype_size(s->tensor[i].type);
    }
    tell(t, "kind", "safetensors");
    const char *format = safetensors_metadata(s, "format"), *variant = safetensors_metadata(s, "variant");
    tell(t, "what", "%s", format_says(format));
    if (format && !strncmp(format, "sherf-avatar", strlen("sherf-avatar")))
        tell(t, "variant", "%s", variant ? variant : "0"); /* the best guess */
    tell_number(t, "count", (double)s->count);
    tell_number(t, "values", values);
    tell_number(t, "bytes", bytes);
    if (t->json && s->metadata_count) {
        key(t, "metadata");
        text_add(&t->text, "{");
        t->first = true;
    }
    for (size_t i = 0; i < s->metadata_count; i++) {
        const char *k = s->metadata_key[i], *v = s->metadata_value[i];
        if (!strncmp(k, "graph.", 6))
            tell(t, k, "%zu characters of nodes", strlen(v));
        else if (v != variant || t->json) /* said above */
            tell(t, k, "%s", v);
    }
    if (t->json && s->metadata_count) text_add(&t->text, "}");
    t->first = false;
    tell_tensors(t, s);
    safetensors_free(s);
    return SHERF_OK;
}

/* ---- trees ---- */

static void value_text(const value *v, char *out, size_t size) {
    char shape[256];
    switch (v->kind) {
    case VALUE_NONE:
        snprintf(out, size, "none");
        break;
    case VALUE_BOOL:
        snprintf(out, size, v->boolean ? "true" : "false");
        break;
    case VALUE_INTEGER:
        snprintf(out, size, "%lld", (long long)v->integer);
        break;
    case VALUE_REAL:
        snprintf(out, size, "%.9g", v->real);
        break;
    case VALUE_STRING:
        snprintf(out, size, "\"%.200s\"", v->string.text);
        break;
    case VALUE_ARRAY:
        shape_text(v->array.rank, v->array.dim, shape);
        snprintf(out, size, "%s %s", dtype_name(v->array.type), shape);
        break;
    case VALUE_LIST:
        snprintf(out, size, "list of %zu", v->list.count);
        break;
    case VALUE_DICT:
        snprintf(out, size, "dict of %zu", v->dict.count);
        break;
    case VALUE_RECORD:
        snprintf(out, size, "object of class %.200s", v->record.class_name);
        break;
    }
}

/* Prints name: value, and the value's contents; for a list only the first element. `left` bounds the lines.
 */
static void tell_tree(teller *t, const value *v, const char *name, int depth, int *left) {
    char line[512], inner[64];
    if ((*left)-- <= 0) {
        if (*left == -1 && !t->json) text_add(&t->text, "  ...\n");
        return;
    }
    value_text(v, line, sizeof line);
    if (t->json) {
        text_add(&t->text, "%s", t->first ? "" : ", ");
        text_add_json(&t->text, name);
        text_add(&t->text, ": ");
        text_add_json(&t->text, line);
        t->first = false;
    } else {
        text_add(&t->text, "%*s%s %s\n", 2 + 2 * depth, "", name, line);
    }
    if (depth == DEPTH_MAX || t->json) return;
    if (v->kind == VALUE_RECORD && v->record.state) tell_tree(t, v->record.state, "state", depth + 1, left);
    if (v->kind == VALUE_LIST && v->list.count) tell_tree(t, v->list.item[0], "[0]", depth + 1, left);
    for (size_t i = 0; v->kind == VALUE_DICT && i < v->dict.count; i++) {
        const value *k = v->dict.pair[i].key;
        if (k->kind == VALUE_INTEGER) snprintf(inner, sizeof inner, "%lld", (long long)k->integer);
        tell_tree(t, v->dict.pair[i].item,
                  k->kind == VALUE_STRING    ? k->string.text
                  : k->kind == VALUE_INTEGER ? inner
                                             : "(key)",
                  depth + 1, left);
    }
}

static const char *tree_says(const document *d) {
    const value *root = d->root;
    while (root->kind == VALUE_LIST && root->list.count == 1) root = root->list.item[0];
    if (document_is_body(d)) return "an SMPL body model";
    if (value_get(root, "G_ema")) return "a snapshot of networks";
    if (value_get(root, "cams") && value_get(root, "ims")) return "a data set's cameras and pictures";
    if (value_get(root, "image") && value_get(root, "camera")) return "an observation";
    if (value_get(root, "cameras") || value_get(root, "camera0000") || value_get(root, "kinect_color_000"))
        return "cameras";
    if (value_get(root, "poses") || value_get(root, "body_pose") || value_get(root, "smpl")) return "poses";
    return root->kind == VALUE_ARRAY ? "an array" : "values";
}

static sherf_status info_tree(teller *t, const char *path) {
    document *d = NULL;
    const char *kind = NULL;
    sherf_status status = document_read(t->c, path, &d, &kind);
    if (status) return status;
    tell(t, "kind", "%s", kind);
    tell(t, "what", "%s", tree_says(d));
    if (document_is_body(d)) {
        const value *v = value_get(d->root, "v_template");
        tell_number(t, "vertices", (double)parse_rows(v));
        tell_number(t, "faces", (double)parse_rows(value_get(d->root, "f")));
    }
    int left = t->json ? 10000 : LISTED_MAX;
    const value *root = d->root;
    if (t->json) {
        key(t, "content");
        text_add(&t->text, "{");
        t->first = true;
    }
    if (root->kind == VALUE_DICT)
        for (size_t i = 0; i < root->dict.count; i++) {
            const value *k = root->dict.pair[i].key;
            tell_tree(t, root->dict.pair[i].item, k->kind == VALUE_STRING ? k->string.text : "(key)", 0,
                      &left);
        }
    else
        tell_tree(t, root, "value", 0, &left);
    if (t->json) text_add(&t->text, "}");
    t->first = false;
    document_free(d);
    return SHERF_OK;
}

/* ---- pictures, folders ---- */

static sherf_status info_picture(teller *t, const char *path, const char *kind) {
    photo_info photo;
    sherf_status status = image_photo_info(t->c, path, &photo);
    if (status) return status;
    tell(t, "kind", "%s", kind);
    tell(t, "what", "a picture");
    tell_number(t, "width", photo.width);
    tell_number(t, "height", photo.height);
    tell_number(t, "channels", photo.channels);
    if (photo.orientation > 1) tell_number(t, "orientation", photo.orientation);
    if (photo.focal_px > 0) tell_number(t, "focal_px", photo.focal_px);
    return SHERF_OK;
}

static sherf_status info_dataset(teller *t, const char *spec) {
    sherf_dataset *d = NULL;
    sherf_camera camera;
    const person_record *r;
    sherf_status status = sherf_dataset_open(t->c, spec, &d);
    if (status) return status;
    const data_protocol *p = dataset_protocol(d);
    tell(t, "kind", "%s", p->name);
    tell(t, "what", "a multi-view data set");
    tell_number(t, "people", d->people);
    tell(t, "first", "%s", d->name[0]);
    if (d->people > 1) tell(t, "last", "%s", d->name[d->people - 1]);
    status = dataset_record(t->c, d, 0, &r);
    if (!status) {
        tell_number(t, "poses", r->poses);
        tell_number(t, "views", r->views);
        status = dataset_camera(t->c, d, 0, 0, &camera);
    }
    if (!status) {
        tell_number(t, "width", camera.width_px);
        tell_number(t, "height", camera.height_px);
        tell_number(t, "scale", p->image_scale);
        tell_number(t, "focal", camera.K[0]);
    }
    sherf_dataset_free(d);
    return status;
}

static sherf_status info_observation(teller *t, const char *path) {
    sherf_observation *o = NULL;
    sherf_status status = sherf_observation_load(t->c, path, &o);
    if (status) return status;
    size_t n = (size_t)o->image.width * o->image.height, person = 0;
    float centre[3];
    for (size_t i = 0; i < n; i++) person += o->mask[i];
    camera_position(&o->camera, centre);
    tell(t, "kind", "observation");
    tell(t, "what", "one picture of a person, with mask, camera and body");
    tell_number(t, "width", o->image.width);
    tell_number(t, "height", o->image.height);
    tell_number(t, "person", (double)person / (double)n);
    tell_number(t, "focal", o->camera.K[0]);
    tell(t, "camera", "%.3f %.3f %.3f", centre[0], centre[1], centre[2]);
    tell(t, "body", "%.3f %.3f %.3f", o->pose.Th_m[0], o->pose.Th_m[1], o->pose.Th_m[2]);
    sherf_observation_free(o);
    return SHERF_OK;
}

/* An 8-byte length and then the brace of the JSON header. */
static bool is_safetensors(const char *path) {
    unsigned char start[9] = {0};
    FILE *f = fopen(path, "rb");
    size_t n = f ? fread(start, 1, sizeof start, f) : 0;
    if (f) fclose(f);
    return n == sizeof start && start[8] == '{' && !start[5] && !start[6] && !start[7];
}

static sherf_status info_any(teller *t, const char *path) {
    char inside[PATH_LENGTH];
    const char *picture;
    struct stat stat_of;
    if (path_is_folder(path)) {
        context quiet = {.threads = 1};
        sherf_dataset *d = NULL;
        bool dataset = sherf_dataset_open(&quiet, path, &d) == SHERF_OK;
        sherf_dataset_free(d);
        if (dataset) return info_dataset(t, path);
        sherf_status status = path_join(t->c, inside, sizeof inside, path, "observation.json");
        if (status) return status;
        if (path_is_file(inside)) return info_observation(t, path);
        status = path_join(t->c, inside, sizeof inside, path, "camera.json");
        if (status || path_is_file(inside)) return status ? status : info_observation(t, path);
        return failure(t->c, SHERF_BAD_FILE, "%s: a folder that is neither a data set nor an observation",
                       path);
    }
    if (!path_is_file(path) && strchr(path, '#')) return info_observation(t, path);
    if (!path_is_file(path) && strchr(path, ':')) return info_dataset(t, path);
    if (stat(path, &stat_of) == 0) tell_number(t, "size", (double)stat_of.st_size);
    if ((picture = image_file_kind(path))) return info_picture(t, path, picture);
    return is_safetensors(path) ? info_safetensors(t, path) : info_tree(t, path);
}

sherf_status sherf_info(sherf_context *c, const char *path, int json, char **text) {
    *text = NULL;
    teller t = {.c = c, .json = json != 0, .first = true, .text = {.c = c}};
    if (t.json) text_add(&t.text, "{");
    tell(&t, "path", "%.1500s", path);
    sherf_status status = info_any(&t, path);
    if (t.json) text_add(&t.text, "}\n");
    *text = text_take(&t.text);
    if (!status && !*text) status = SHERF_NO_MEMORY;
    if (status) {
        mem_free(*text);
        *text = NULL;
    }
    return status;
}
