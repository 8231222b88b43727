/* Fuzz target: avatar files behind their safetensors reader (fuzz_safetensors). A tiny avatar of each model
 * is made once, and the input changes its tensors and settings. Avatars that can be read are rendered. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "avatar/avatar.h"
#include "data/data.h"
#include "fuzz_folder.h"
#include "synth/tube/tubeman.h"

#define OURS                                                                                                 \
    "sherf:small,encoder_width=8,style_width=16,plane_resolution=16,channel_base=256,channel_max=16,"        \
    "volume_channels0=8,volume_channels1=8,volume_channels2=8,decoder_width=16,decoder_depth=2,"             \
    "decoder_skip=0,view_width=16,voxel_size_m=0.05,samples=4,image_size=0"
#define NHP                                                                                                  \
    "nhp:matched-small,encoder_width=8,width=16,volume_channels0=4,volume_channels1=4,volume_channels2=4,"   \
    "volume_channels3=4,voxel_size_m=0.05,samples=4,image_size=0"
static const char *const preset[] = {OURS,
                                     "pixelnerf:matched-small,encoder_width=8,width=8,samples=4,image_size=0",
                                     "mps-nerf:matched-small,encoder_width=8,value_width=8,mlp_width=8,width="
                                     "8,view_width=8,samples=4,image_size=0",
                                     NHP};
enum { KINDS = COUNT_OF(preset), SIDE = 32, FRAME = 12, TENSORS = 256, CHANGES = 8 };

static sherf_body *body;
static safetensors *whole[KINDS];

/* Every STEP-th vertex of the tube body, without faces, since vertices take the time. A joint is its nearest
 * vertex. */
static sherf_status small_body_create(context *c, body_model **out) {
    enum { STEP = 53 };
    tubeman_arrays t;
    sherf_status status = tubeman_arrays_create(c, &t);
    if (status) return status;
    body_arrays a = t.arrays;
    const int all = a.vertices, vertices = a.vertices = (all + STEP - 1) / STEP;
    double *regressor = calloc((size_t)(BODY_JOINTS * vertices), sizeof *regressor);
    if (!regressor) abort();
    for (int j = 0; j < BODY_JOINTS; j++) {
        double at[3] = {0}, best = INFINITY;
        int nearest = 0;
        for (int v = 0; v < all; v++)
            for (int k = 0; k < 3; k++) at[k] += t.regressor[j * all + v] * t.v_template[3 * v + k];
        for (int v = 0; v < vertices; v++) {
            const double *p = t.v_template + 3 * STEP * v;
            const double off = hypot(hypot(p[0] - at[0], p[1] - at[1]), p[2] - at[2]);
            if (off < best) best = off, nearest = v;
        }
        regressor[j * vertices + nearest] = 1;
    }
    for (int v = 0; v < vertices; v++) { /* in place: the source is never before the destination */
        const size_t from = (size_t)(STEP * v), to = (size_t)v;
        memmove(t.v_template + 3 * to, t.v_template + 3 * from, 3 * sizeof(double));
        memmove(t.shapedirs + 30 * to, t.shapedirs + 30 * from, 30 * sizeof(double));
        memmove(t.posedirs + 621 * to, t.posedirs + 621 * from, 621 * sizeof(double));
        memmove(t.weights + 24 * to, t.weights + 24 * from, 24 * sizeof(double));
    }
    a.regressor = regressor;
    a.faces = 0;
    status = body_create(c, &a, out);
    free(regressor);
    tubeman_arrays_free(&t);
    return status;
}

static sherf_status observe(context *c, sherf_observation **out) {
    static float pixel[SIDE * SIDE * 3], mask[SIDE * SIDE];
    const float centre[3] = {0, -0.3f, 0};
    sherf_camera camera;
    sherf_pose pose;
    for (int i = 0; i < SIDE * SIDE; i++) {
        mask[i] = i / SIDE > 2 && i / SIDE < 30 && i % SIDE > 8 && i % SIDE < 24;
        for (int k = 0; k < 3; k++) pixel[3 * i + k] = (float)(i % (7 + k)) / 10;
    }
    sherf_pose_identity(&pose);
    sherf_camera_orbit(centre, 2.6f, 0, 0, 0.8f, SIDE, SIDE, &camera);
    const sherf_image picture = {SIDE, SIDE, 3, pixel}, person = {SIDE, SIDE, 1, mask};
    return sherf_observation_create(c, &picture, &person, &camera, &pose, out);
}

static void make(context *c, int kind) {
    sherf_observation *o = NULL;
    sherf_model *m = NULL;
    sherf_avatar *a = NULL;
    char path[128];
    snprintf(path, sizeof path, "%s/avatar", fuzz_folder());
    sherf_status status = body ? SHERF_OK : small_body_create(c, &body);
    if (!status) status = observe(c, &o);
    if (!status) status = sherf_model_create(c, preset[kind], 3, &m);
    if (!status) status = sherf_avatar_create(c, m, body, o, &a);
    if (!status) status = sherf_avatar_save(c, a, path);
    if (!status) status = safetensors_read(c, path, &whole[kind]);
    if (status || whole[kind]->count > TENSORS) {
        fprintf(stderr, "%s: %s\n", preset[kind], c->message);
        abort();
    }
    sherf_avatar_free(a);
    sherf_model_free(m);
    sherf_observation_free(o);
}

/* ---- changes that a file could have: data is as long as the shape says ---- */
typedef struct {
    safetensors file;
    safetensor tensor[TENSORS];
    void *own[TENSORS]; /* data of the changed avatar alone */
    char config[1024];
} changed;

static size_t bytes_of(const safetensor *t) {
    size_t n = dtype_size(t->type);
    for (int i = 0; i < t->rank; i++) n *= (size_t)t->dim[i];
    return n;
}

/* Fills data of exactly the new size with copies of `from`. Returns false if it would be too large. */
static bool take_data(changed *f, size_t i, const safetensor *from) {
    enum { BYTES_MAX = 1 << 20 };
    const size_t bytes = bytes_of(&f->tensor[i]), there = bytes_of(from);
    if (bytes > BYTES_MAX) return false;
    unsigned char *data = malloc(bytes + !bytes);
    if (!data) abort();
    for (size_t k = 0; k < bytes; k++) data[k] = there ? ((const unsigned char *)from->data)[k % there] : 0;
    free(f->own[i]);
    f->tensor[i].data = f->own[i] = data;
    return true;
}

static void change_size(changed *f, size_t i, uint8_t x, uint8_t y) {
    static const int64_t size[] = {0,  1,  2,  3,  4,  5,  7,   8,   9,    15,  16,
                                   17, 24, 31, 32, 33, 64, 100, 117, 1000, 4097};
    const safetensor before = f->tensor[i];
    safetensor *t = &f->tensor[i];
    if (x >= 192 && t->rank < TENSOR_RANK)
        t->dim[t->rank++] = 1 + y % 2;
    else if (x >= 128 && t->rank)
        t->rank--;
    else if (x >= 96 && t->rank >= 2)
        t->dim[0] = before.dim[1], t->dim[1] = before.dim[0];
    else if (t->rank)
        t->dim[x % t->rank] = size[y % COUNT_OF(size)];
    if (!take_data(f, i, &before)) *t = before;
}

static void change_type(changed *f, size_t i, uint8_t x) {
    static const dtype type[] = {T_F32, T_F64, T_I32, T_I64, T_U8, T_F16};
    const safetensor before = f->tensor[i];
    f->tensor[i].type = type[x % COUNT_OF(type)];
    if (!take_data(f, i, &before)) f->tensor[i] = before;
}

static void change_number(changed *f, size_t i, uint8_t x, uint8_t y) {
    static const uint32_t bits[] = {0,          1,          0x7fffffff, 0x80000000, 0xffffffff, 0x7fc00000,
                                    0x7f800000, 0xff800000, 0x7f7fffff, 0x00000001, 0x3f800000, 0xbf800000,
                                    0x47c35000, 255,        256,        0x0000ffff};
    const safetensor before = f->tensor[i];
    if (!take_data(f, i, &before)) return;
    const size_t bytes = bytes_of(&before), at = bytes ? ((size_t)x * 65537 + y / 16) * 4 % bytes : 0;
    for (size_t k = 0; k < 4 && at + k < bytes; k++)
        ((unsigned char *)f->own[i])[at + k] = (unsigned char)(bits[y % 16] >> 8 * k);
}

static void change(changed *f, const uint8_t four[4]) {
    const size_t i = (four[0] / 8 + (size_t)four[1] * 32) % f->file.count;
    switch (four[0] % 8) {
    case 0:
    case 1:
        change_size(f, i, four[2], four[3]);
        break;
    case 2:
        change_type(f, i, four[2]);
        break;
    case 3:
        f->tensor[i].name = "gone";
        break;
    default:
        change_number(f, i, four[2], four[3]);
        break;
    }
}

/* The input is the number of changes, then the changes. If the number is 128 or more, the rest is appended to
 * the settings. */
static void changed_make(changed *f, int kind, const uint8_t *data, size_t size) {
    static char *key[16], *text[16];
    f->file = *whole[kind];
    memcpy(f->tensor, f->file.tensor, f->file.count * sizeof *f->tensor);
    f->file.tensor = f->tensor;
    const size_t changes = size ? data[0] % (CHANGES + 1) : 0;
    size_t at = size ? 1 : 0;
    for (size_t i = 0; i < changes && at + 4 <= size; i++, at += 4) change(f, data + at);
    if (at >= size || data[0] < 128 || f->file.metadata_count > COUNT_OF(text)) return;
    for (size_t i = 0; i < f->file.metadata_count; i++) {
        key[i] = f->file.metadata_key[i];
        text[i] = f->file.metadata_value[i];
        if (!strstr(key[i], ".config")) continue;
        snprintf(f->config, sizeof f->config, "%s,%.*s", text[i], (int)(size - at), (const char *)data + at);
        text[i] = f->config;
    }
    f->file.metadata_key = key;
    f->file.metadata_value = text;
}

static void draw(context *c, const sherf_avatar *a) {
    const sherf_render_options o = {.exact = 1, .samples = 4, .detail = SHERF_DETAIL_OFF};
    const sherf_pose *pose = sherf_avatar_pose(a);
    sherf_frame frame = {0};
    sherf_camera camera;
    sherf_camera_orbit(pose->Th_m, 2.6f, 1, 0.2f, 0.8f, FRAME, FRAME, &camera);
    if (sherf_render(c, a, body, pose, &camera, &o, &frame) == SHERF_OK) {
        volatile uint64_t sum = fuzz_sum(frame.color.data, sizeof(float) * 3 * FRAME * FRAME);
        (void)sum;
    }
    sherf_frame_free(&frame);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static changed f;
    context *c = fuzz_context();
    if (!size) return 0;
    const int kind = data[0] % KINDS;
    if (!whole[kind]) make(c, kind);
    c->message[0] = 0;
    changed_make(&f, kind, data + 1, size - 1);
    const size_t live = mem_live();
    sherf_avatar *a = NULL;
    sherf_status status = avatar_read(c, &f.file, body, &a);
    if ((status == SHERF_OK) != (a != NULL)) abort();
    if (a) draw(c, a);
    sherf_avatar_free(a);
    for (size_t i = 0; i < TENSORS; i++) {
        free(f.own[i]);
        f.own[i] = NULL;
    }
    return fuzz_end(c, status, live);
}
