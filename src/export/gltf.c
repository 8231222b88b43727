/* Binary glTF 2.0 (Khronos): a JSON chunk that describes views of a binary chunk. The Khronos validator
 * reports nothing on it. */
#include <math.h>
#include <string.h>

#include "base/path.h"
#include "data/text.h"
#include "export/gltf.h"

/* SMPL's names of the joints. */
static const char *const gltf_joint_name[BODY_JOINTS] = {
    "pelvis",     "left_hip",    "right_hip",    "spine1",      "left_knee",     "right_knee",
    "spine2",     "left_ankle",  "right_ankle",  "spine3",      "left_foot",     "right_foot",
    "neck",       "left_collar", "right_collar", "head",        "left_shoulder", "right_shoulder",
    "left_elbow", "right_elbow", "left_wrist",   "right_wrist", "left_hand",     "right_hand"};

/* Component types and buffer targets by glTF's numbers. */
enum {
    UNSIGNED_BYTE = 5121,
    UNSIGNED_INT = 5125,
    FLOAT = 5126,
    NO_TARGET = 0,
    ARRAY = 34962,
    ELEMENTS = 34963
};
enum { PIECES_MAX = 96 };

typedef struct {
    const void *data;
    size_t bytes, at;
    int target;
} piece;

typedef struct {
    context *c;
    piece piece[PIECES_MAX]; /* buffer views */
    int pieces, accessors;
    size_t bytes;
    text_builder views, accessor_text;
} writer;

static int add_view(writer *w, const void *data, size_t bytes, int target) {
    piece *p = &w->piece[w->pieces];
    *p = (piece){data, bytes, w->bytes, target};
    text_add(&w->views, "%s{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu", w->pieces ? "," : "", p->at,
             bytes);
    if (target) text_add(&w->views, ",\"target\":%d", target);
    text_add(&w->views, "}");
    w->bytes += (bytes + 3) / 4 * 4;
    return w->pieces++;
}

static void add_bounds(writer *w, const float *value, int64_t count, int width) {
    for (int side = 0; side < 2; side++) {
        text_add(&w->accessor_text, ",\"%s\":[", side ? "max" : "min");
        for (int k = 0; k < width; k++) {
            float best = value[k];
            for (int64_t i = 1; i < count; i++) {
                float x = value[i * width + k];
                best = side ? fmaxf(best, x) : fminf(best, x);
            }
            text_add(&w->accessor_text, "%s%.9g", k ? "," : "", (double)best);
        }
        text_add(&w->accessor_text, "]");
    }
}

/* type: SCALAR, VEC2, ... of `width` components. */
static int add_accessor(writer *w, const void *data, int64_t count, const char *type, int width,
                        int component, int target, bool bounds) {
    size_t size = component == UNSIGNED_BYTE ? 1 : 4;
    int view = add_view(w, data, (size_t)count * (size_t)width * size, target);
    text_add(&w->accessor_text, "%s{\"bufferView\":%d,\"componentType\":%d,\"count\":%lld,\"type\":\"%s\"",
             w->accessors ? "," : "", view, component, (long long)count, type);
    if (bounds) add_bounds(w, data, count, width);
    text_add(&w->accessor_text, "}");
    return w->accessors++;
}

/* ---- rotations and places of the nodes ---- */
/* x y z w, with the sign that is nearer to `before`. */
static void quaternion_of(const float axis_angle[3], const float before[4], float out[4]) {
    double x = axis_angle[0], y = axis_angle[1], z = axis_angle[2], angle = sqrt(x * x + y * y + z * z);
    double s = angle > 1e-12 ? sin(angle / 2) / angle : 0.5, q[4] = {s * x, s * y, s * z, cos(angle / 2)};
    double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]), along = 0;
    for (int k = 0; k < 4; k++) along += before ? q[k] * before[k] : 0;
    for (int k = 0; k < 4; k++) out[k] = (float)((along < 0 ? -q[k] : q[k]) / length);
}

/* Rotation of joint j in its parent's axes; the pelvis also takes the body's rotation in the world. */
static void joint_rotation(const sherf_pose *pose, int j, const float before[4], float out[4]) {
    float own[9], R[9], turn[3];
    if (j) {
        quaternion_of(pose->poses_rad + 3 * j, before, out);
        return;
    }
    rodrigues(pose->poses_rad, own);
    for (int r = 0; r < 3; r++)
        for (int k = 0; k < 3; k++)
            R[3 * r + k] =
                pose->R[3 * r] * own[k] + pose->R[3 * r + 1] * own[3 + k] + pose->R[3 * r + 2] * own[6 + k];
    rotation_to_axis_angle(R, turn);
    quaternion_of(turn, before, out);
}

/* x_world = R (R_0 (x - J_0) + J_0) + Th: the pelvis is at R J_0 + Th. */
static void pelvis_place(const sherf_pose *pose, const float rest[3], float out[3]) {
    for (int k = 0; k < 3; k++)
        out[k] = pose->R[3 * k] * rest[0] + pose->R[3 * k + 1] * rest[1] + pose->R[3 * k + 2] * rest[2] +
                 pose->Th_m[k];
}

/* ---- the parts of the JSON ---- */
enum { MESH_NODE = BODY_JOINTS }; /* nodes 0 to 23 are the joints */

static void add_nodes(text_builder *t, const gltf_person *g) {
    text_add(t, "\"nodes\":[");
    for (int j = 0; j < BODY_JOINTS; j++) {
        float at[3], turn[4] = {0, 0, 0, 1};
        for (int k = 0; k < 3; k++) at[k] = g->joints_rest[j][k] - (j ? g->joints_rest[g->parent[j]][k] : 0);
        if (g->pose && !j) pelvis_place(g->pose, g->joints_rest[0], at);
        if (g->pose) joint_rotation(g->pose, j, NULL, turn);
        text_add(t, "%s{\"name\":\"%s\",\"translation\":[%.9g,%.9g,%.9g],\"rotation\":[%.9g,%.9g,%.9g,%.9g]",
                 j ? "," : "", gltf_joint_name[j], (double)at[0], (double)at[1], (double)at[2],
                 (double)turn[0], (double)turn[1], (double)turn[2], (double)turn[3]);
        bool first = true;
        for (int k = j + 1; k < BODY_JOINTS; k++)
            if (g->parent[k] == j) {
                text_add(t, "%s%d", first ? ",\"children\":[" : ",", k);
                first = false;
            }
        text_add(t, first ? "}" : "]}");
    }
    text_add(t, ",{\"name\":\"person\",\"mesh\":0,\"skin\":0}]");
}

static void add_material(text_builder *t, const gltf_person *g) {
    text_add(t, ",\"materials\":[{\"name\":\"person\",\"pbrMetallicRoughness\":{");
    if (g->uv) text_add(t, "\"baseColorTexture\":{\"index\":0},");
    text_add(t, "\"metallicFactor\":0,\"roughnessFactor\":0.9}%s}]",
             g->lit ? "" : ",\"extensions\":{\"KHR_materials_unlit\":{}}");
    if (!g->lit) text_add(t, ",\"extensionsUsed\":[\"KHR_materials_unlit\"]");
}

static void add_texture(writer *w, text_builder *t, const gltf_person *g) {
    int view = add_view(w, g->png, g->png_bytes, NO_TARGET);
    text_add(t,
             ",\"images\":[{\"name\":\"colour\",\"mimeType\":\"image/png\",\"bufferView\":%d}],"
             "\"samplers\":[{\"magFilter\":9729,\"minFilter\":9987,\"wrapS\":33071,\"wrapT\":33071}],"
             "\"textures\":[{\"sampler\":0,\"source\":0}]",
             view);
}

/* Writes the clip as times, pelvis positions and rotations, joint by joint. */
static void clip_fill(const gltf_person *g, float *time, float *place, float *turn) {
    for (int f = 0; f < g->frames; f++) {
        time[f] = (float)(f / g->fps);
        pelvis_place(&g->clip[f], g->joints_rest[0], place + 3 * f);
        for (int j = 0; j < BODY_JOINTS; j++) {
            float *to = turn + 4 * ((size_t)j * (size_t)g->frames + (size_t)f);
            joint_rotation(&g->clip[f], j, f ? to - 4 : NULL, to);
        }
    }
}

static void add_animation(writer *w, text_builder *t, const gltf_person *g, const float *time,
                          const float *place, const float *turn) {
    int input = add_accessor(w, time, g->frames, "SCALAR", 1, FLOAT, NO_TARGET, true);
    int output = add_accessor(w, place, g->frames, "VEC3", 3, FLOAT, NO_TARGET, false);
    text_add(t, ",\"animations\":[{\"name\":\"motion\",\"samplers\":[{\"input\":%d,\"output\":%d}", input,
             output);
    for (int j = 0; j < BODY_JOINTS; j++) {
        output = add_accessor(w, turn + 4 * (size_t)j * (size_t)g->frames, g->frames, "VEC4", 4, FLOAT,
                              NO_TARGET, false);
        text_add(t, ",{\"input\":%d,\"output\":%d}", input, output);
    }
    text_add(t, "],\"channels\":[{\"sampler\":0,\"target\":{\"node\":0,\"path\":\"translation\"}}");
    for (int j = 0; j < BODY_JOINTS; j++)
        text_add(t, ",{\"sampler\":%d,\"target\":{\"node\":%d,\"path\":\"rotation\"}}", j + 1, j);
    text_add(t, "]}]");
}

static void add_mesh(writer *w, text_builder *t, const gltf_person *g, const float *colors) {
    text_add(t, ",\"meshes\":[{\"name\":\"person\",\"primitives\":[{\"material\":0,\"attributes\":{");
    text_add(t, "\"POSITION\":%d", add_accessor(w, g->position, g->vertices, "VEC3", 3, FLOAT, ARRAY, true));
    text_add(t, ",\"NORMAL\":%d", add_accessor(w, g->normal, g->vertices, "VEC3", 3, FLOAT, ARRAY, false));
    if (g->uv)
        text_add(t, ",\"TEXCOORD_0\":%d",
                 add_accessor(w, g->uv, g->vertices, "VEC2", 2, FLOAT, ARRAY, false));
    else
        text_add(t, ",\"COLOR_0\":%d", add_accessor(w, colors, g->vertices, "VEC3", 3, FLOAT, ARRAY, false));
    text_add(t, ",\"JOINTS_0\":%d",
             add_accessor(w, g->joint, g->vertices, "VEC4", 4, UNSIGNED_BYTE, ARRAY, false));
    text_add(t, ",\"WEIGHTS_0\":%d},",
             add_accessor(w, g->weight, g->vertices, "VEC4", 4, FLOAT, ARRAY, false));
    text_add(t, "\"indices\":%d}]}]",
             add_accessor(w, g->triangle, 3 * g->triangles, "SCALAR", 1, UNSIGNED_INT, ELEMENTS, false));
}

static void add_skin(writer *w, text_builder *t, const float *inverse_bind) {
    text_add(t, ",\"skins\":[{\"name\":\"smpl\",\"skeleton\":0,\"inverseBindMatrices\":%d,\"joints\":[",
             add_accessor(w, inverse_bind, BODY_JOINTS, "MAT4", 16, FLOAT, NO_TARGET, false));
    for (int j = 0; j < BODY_JOINTS; j++) text_add(t, "%s%d", j ? "," : "", j);
    text_add(t, "]}]");
}

/* The JSON, padded with blanks to a multiple of 4; w->piece holds the other chunk's data. */
static char *describe(writer *w, const gltf_person *g, const float *colors, const float *inverse_bind,
                      const float *time, const float *place, const float *turn) {
    text_builder t = {.c = w->c};
    text_add(&t,
             "{\"asset\":{\"version\":\"2.0\",\"generator\":\"sherf " SHERF_VERSION
             "\",\"extras\":{\"up\":\"+Y\",\"front\":\"+Z\",\"unit\":\"metre\","
             "\"bind_pose\":\"T\",\"skeleton\":\"SMPL\"}},"
             "\"scene\":0,\"scenes\":[{\"name\":\"scene\",\"nodes\":[0,%d]}],",
             MESH_NODE);
    add_nodes(&t, g);
    add_mesh(w, &t, g, colors);
    add_skin(w, &t, inverse_bind);
    add_material(&t, g);
    if (g->uv) add_texture(w, &t, g);
    if (g->frames) add_animation(w, &t, g, time, place, turn);
    char *views = text_take(&w->views), *accessors = text_take(&w->accessor_text);
    if (views && accessors)
        text_add(&t, ",\"accessors\":[%s],\"bufferViews\":[%s],\"buffers\":[{\"byteLength\":%zu}]}",
                 accessors, views, w->bytes);
    else
        t.failed = true;
    while (!t.failed && t.bytes % 4) text_add(&t, " ");
    mem_free(views);
    mem_free(accessors);
    return text_take(&t);
}

/* ---- the file ---- */
static sherf_status write_chunks(context *c, const writer *w, const char *json, const char *path) {
    static const uint8_t zeros[4] = {0};
    const size_t json_bytes = strlen(json), total = 12 + 8 + json_bytes + 8 + w->bytes;
    if (total > UINT32_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: more than 4 GB do not go into a .glb", path);
    const uint32_t head[5] = {0x46546c67, 2, (uint32_t)total, (uint32_t)json_bytes, 0x4e4f534a};
    const uint32_t middle[2] = {(uint32_t)w->bytes, 0x004e4942};
    output_file f;
    sherf_status status = output_open(c, path, &f);
    if (status != SHERF_OK) return status;
    status = output_write(c, &f, head, sizeof head);
    if (status == SHERF_OK) status = output_write(c, &f, json, json_bytes);
    if (status == SHERF_OK) status = output_write(c, &f, middle, sizeof middle);
    for (int i = 0; i < w->pieces && status == SHERF_OK; i++) {
        status = output_write(c, &f, w->piece[i].data, w->piece[i].bytes);
        if (status == SHERF_OK) status = output_write(c, &f, zeros, (4 - w->piece[i].bytes % 4) % 4);
    }
    if (status == SHERF_OK) status = output_commit(c, &f);
    output_abort(&f);
    return status;
}

/* glTF's vertex colours are linear. */
static float linear_of(float srgb) {
    return srgb <= 0.04045f ? srgb / 12.92f : powf((srgb + 0.055f) / 1.055f, 2.4f);
}

sherf_status gltf_write(context *c, const char *path, const gltf_person *g) {
    const size_t F = (size_t)g->frames, V = (size_t)g->vertices;
    float inverse_bind[16 * BODY_JOINTS] = {0};
    char *json = NULL;
    writer *w = mem_zero(c, 1, sizeof *w);
    float *time = mem_alloc(c, F, sizeof *time), *place = mem_alloc(c, F, 3 * sizeof *place);
    float *turn = mem_alloc(c, F, BODY_JOINTS * 4 * sizeof *turn);
    float *colors = g->uv ? NULL : mem_alloc(c, V, 3 * sizeof *colors);
    sherf_status status = w && time && place && turn && (g->uv || colors) ? SHERF_OK : SHERF_NO_MEMORY;
    if (status != SHERF_OK) goto done;
    for (int j = 0; j < BODY_JOINTS; j++) { /* column-major; bones are not rotated in the rest pose */
        float *m = inverse_bind + 16 * j;
        m[0] = m[5] = m[10] = m[15] = 1;
        for (int k = 0; k < 3; k++) m[12 + k] = -g->joints_rest[j][k];
    }
    for (size_t i = 0; colors && i < 3 * V; i++) colors[i] = linear_of(g->rgb[i]);
    clip_fill(g, time, place, turn);
    w->c = w->views.c = w->accessor_text.c = c;
    json = describe(w, g, colors, inverse_bind, time, place, turn);
    status = json ? write_chunks(c, w, json, path) : SHERF_NO_MEMORY;
done:
    mem_free(json);
    mem_free(w);
    mem_free(time);
    mem_free(place);
    mem_free(turn);
    mem_free(colors);
    return status;
}
