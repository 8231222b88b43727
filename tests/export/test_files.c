/* Tests of the exported files of a tube person's avatar, read as other programs would. */
#include <cjson/cJSON.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "base/path.h"
#include "closed.h"
#include "baked/skin.h"
#include "io/image.h"
#include "solid_avatar.h"

enum { SIDE = SOLID_SIDE };
static body_model *body;
static sherf_avatar *avatar;

static int make_avatar(void **state) {
    *state = test_context();
    return solid_avatar_make(*state, &body, &avatar) != SHERF_OK;
}

static int free_avatar(void **state) {
    sherf_avatar_free(avatar);
    sherf_body_free(body);
    sherf_context_free(*state);
    return mem_live() != 0;
}

/* A file in the test's folder, or in $SHERF_EXPORT_FOLDER, where other programs read it
 * (tools/check_export.sh). */
static const char *kept(const char *name) {
    static char path[700];
    const char *folder = getenv("SHERF_EXPORT_FOLDER");
    if (!folder) return test_path(name);
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return path;
}

static const sherf_export_options quick = {
    .resolution = 40, .triangles = 1500, .texture_px = 256, .splats = 700};

static unsigned char *read_all(context *c, const char *path, size_t *bytes) {
    static unsigned char *data;
    assert_ok(c, file_read(c, path, 1 << 28, &data, bytes));
    return data;
}

/* ---- the field ---- */
static void field_is_empty_outside(void **state) {
    context *c = *state;
    float point[9], direction[9] = {0, 0, -1, 0, 0, -1, 0, 0, -1}, rgb[9], sigma[3];
    memcpy(point, body->canonical->vertices_smpl + 30, 3 * sizeof *point);
    for (int k = 0; k < 3; k++) point[3 + k] = 10, point[6 + k] = NAN;
    assert_ok(c, field_query(c, avatar, body, 3, point, direction, rgb, sigma));
    assert_float_equal(sigma[0], 60, 0.5);
    for (int i = 1; i < 3; i++) {
        assert_true(sigma[i] == -80);
        for (int k = 0; k < 3; k++) assert_true(rgb[3 * i + k] == 0);
    }
    for (int k = 0; k < 3; k++) assert_true(rgb[k] > -0.01 && rgb[k] < 1.01);
}

/* ---- skin ---- */
static void skin_follows_the_body(void **state) {
    context *c = *state;
    const int V = body->vertices;
    skin s;
    sherf_pose pose;
    posed_body *p;
    float *out = malloc((size_t)V * 3 * sizeof *out), *normal = malloc((size_t)V * 3 * sizeof *normal),
          *turned = malloc((size_t)V * 3 * sizeof *turned);
    assert_ok(c, skin_make(c, body, V, body->canonical->vertices_smpl, &s));
    for (int v = 0; v < V; v++) {
        double sum = 0, shares = 0;
        for (int i = 0; i < 4; i++) {
            float w = s.weight[4 * v + i];
            assert_true(w >= 0 && s.joint[4 * v + i] < BODY_JOINTS);
            assert_true(!i || w <= s.weight[4 * v + i - 1] + 1e-6f);
            if (w == 0) assert_int_equal(s.joint[4 * v + i], 0);
            for (int k = 0; k < i && w > 0; k++) assert_true(s.joint[4 * v + k] != s.joint[4 * v + i]);
            sum += w;
        }
        for (int i = 0; i < SKIN_NEAR; i++) shares += s.share[SKIN_NEAR * v + i];
        assert_float_equal(sum, 1, 2e-7);
        assert_float_equal(shares, 1, 1e-5);
    }
    assert_ok(c, body_normals(c, body, body->canonical->vertices_smpl, normal));
    sherf_pose_canonical(&pose);
    assert_ok(c, posed_body_create(c, body, pose.poses_rad, pose.shapes, pose.R, pose.Th_m, &p));
    skin_pose(c, body, &s, p, normal, out, turned);
    for (int i = 0; i < 3 * V; i++) {
        assert_float_equal(out[i], body->canonical->vertices_smpl[i], 2e-5);
        assert_float_equal(turned[i], normal[i], 1e-3);
    }
    posed_body_free(p);
    /* in another pose, position and shape the body's surface stays near its own */
    pose = *sherf_avatar_pose(avatar);
    for (int i = 0; i < 72; i++) pose.poses_rad[i] += 0.2f * (float)sin(i);
    pose.shapes[0] += 1;
    assert_ok(c, posed_body_create(c, body, pose.poses_rad, pose.shapes, pose.R, pose.Th_m, &p));
    skin_pose(c, body, &s, p, normal, out, turned);
    float *world = malloc((size_t)V * 3 * sizeof *world);
    body_vertices_world(body, p, world);
    double sum = 0;
    for (int v = 0; v < V; v++) {
        double d2 = 0, n2 = 0;
        for (int k = 0; k < 3; k++) {
            double d = (double)out[3 * v + k] - world[3 * v + k];
            d2 += d * d;
            n2 += (double)turned[3 * v + k] * turned[3 * v + k];
        }
        assert_float_equal(n2, 1, 1e-4);
        sum += sqrt(d2) / V;
        assert_true(d2 < 0.05 * 0.05);
    }
    assert_true(sum < 0.006);
    posed_body_free(p);
    skin_free(&s);
    free(out), free(normal), free(turned), free(world);
}

/* ---- .glb ---- */
typedef struct {
    unsigned char *file;
    const unsigned char *bin;
    size_t bin_bytes;
    cJSON *json;
} glb;

static uint32_t u32_at(const unsigned char *p) {
    return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static glb glb_open(context *c, const char *path) {
    size_t bytes;
    glb g = {.file = read_all(c, path, &bytes)};
    assert_memory_equal(g.file, "glTF", 4);
    assert_int_equal(u32_at(g.file + 4), 2);
    assert_int_equal(u32_at(g.file + 8), bytes);
    size_t json_bytes = u32_at(g.file + 12);
    assert_memory_equal(g.file + 16, "JSON", 4);
    assert_int_equal(json_bytes % 4, 0);
    g.json = cJSON_ParseWithLength((const char *)g.file + 20, json_bytes);
    assert_non_null(g.json);
    g.bin = g.file + 20 + json_bytes + 8;
    g.bin_bytes = u32_at(g.file + 20 + json_bytes);
    assert_memory_equal(g.bin - 4, "BIN", 4);
    assert_int_equal(20 + json_bytes + 8 + g.bin_bytes, bytes);
    return g;
}

static void glb_close(glb *g) {
    cJSON_Delete(g->json);
    mem_free(g->file);
}

static const cJSON *at(const cJSON *list, int i) {
    const cJSON *item = cJSON_GetArrayItem(list, i);
    assert_non_null(item);
    return item;
}
static const cJSON *get(const cJSON *o, const char *name) {
    const cJSON *item = cJSON_GetObjectItem(o, name);
    if (!item) fail_msg("no %s", name);
    return item;
}
static int number(const cJSON *o, const char *name) {
    return (int)get(o, name)->valuedouble;
}

/* The bytes of accessor i, which has `count` elements of `size` bytes. */
static const void *accessor(const glb *g, int i, int *count, size_t size) {
    const cJSON *a = at(get(g->json, "accessors"), i),
                *view = at(get(g->json, "bufferViews"), number(a, "bufferView"));
    *count = number(a, "count");
    assert_int_equal(number(view, "byteLength"), (size_t)*count * size);
    assert_true((size_t)number(view, "byteOffset") + (size_t)number(view, "byteLength") <= g->bin_bytes);
    assert_int_equal(number(view, "byteOffset") % 4, 0);
    return g->bin + number(view, "byteOffset");
}

/* A clip of three poses, as EasyMocap writes them. */
static sherf_motion *walk(context *c) {
    char folder[600], path[700];
    sherf_motion *motion = NULL;
    snprintf(folder, sizeof folder, "%s", test_path("clip"));
    assert_ok(c, folder_make(c, folder));
    for (int i = 0; i < 3; i++) {
        snprintf(path, sizeof path, "%s/%06d.json", folder, i);
        FILE *f = fopen(path, "wb");
        assert_non_null(f);
        fprintf(f, "[{\"id\": 0, \"Rh\": [[0, %g, 0]], \"Th\": [[%g, 1, 0]], \"poses\": [[0", 0.5 * i,
                0.1 * i);
        for (int k = 1; k < 72; k++) fprintf(f, ", %g", k == 3 ? -0.4 * i : 0.0);
        fputs("]], \"shapes\": [[0, 0, 0, 0, 0, 0, 0, 0, 0, 0]]}]\n", f);
        fclose(f);
    }
    const sherf_motion_options o = {
        .body = body, .shapes = sherf_avatar_pose(avatar)->shapes, .up = SHERF_UP_Y, .source_fps = 25};
    assert_ok(c, sherf_motion_load(c, folder, &o, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), 3);
    return motion;
}

/* Vertices joined by position form the closed surface again. */
static void assert_welded(const float *position, int vertices, const uint32_t *index, int indices) {
    uint32_t *first = malloc((size_t)vertices * sizeof *first),
             *joined = malloc((size_t)indices * sizeof *joined);
    uint32_t count = 0;
    for (int v = 0; v < vertices; v++) {
        int u = 0;
        while (u < v && memcmp(position + 3 * u, position + 3 * v, 3 * sizeof *position) != 0) u++;
        first[v] = u < v ? first[u] : count++;
    }
    for (int i = 0; i < indices; i++) joined[i] = first[index[i]];
    const char *flaw = flaw_of(count, indices / 3, joined);
    if (flaw) fail_msg("%s", flaw);
    free(first), free(joined);
}

/* The animation, read like any other motion, equals the written one. */
static void assert_reads_back(context *c, const char *path, const sherf_motion *wrote) {
    sherf_motion *motion = NULL;
    const sherf_motion_options o = {.body = body, .shapes = sherf_avatar_pose(avatar)->shapes};
    sherf_status status = sherf_motion_load(c, path, &o, &motion);
    if (status == SHERF_UNSUPPORTED && strstr(c->message, "libassimp")) return; /* a build without assimp */
    assert_ok(c, status);
    assert_non_null(strstr(sherf_motion_description(motion), "GLB"));
    assert_int_equal(sherf_motion_frame_count(motion), sherf_motion_frame_count(wrote));
    assert_float_equal(sherf_motion_fps(motion), sherf_motion_fps(wrote), 1e-3);
    for (int i = 0; i < sherf_motion_frame_count(motion); i++) {
        sherf_pose now, then;
        sherf_motion_pose(motion, i, &now);
        sherf_motion_pose(wrote, i, &then);
        for (int k = 0; k < 72; k++) assert_float_equal(now.poses_rad[k], then.poses_rad[k], 1e-3);
        for (int k = 0; k < 3; k++) assert_float_equal(now.Th_m[k], then.Th_m[k], 1e-3);
    }
    sherf_motion_free(motion);
}

/* Joints, weights and normals of a mesh's corners. */
static void check_corners(const glb *g, const cJSON *attribute, int vertices) {
    int count;
    const float *normal = accessor(g, number(attribute, "NORMAL"), &count, 12);
    assert_int_equal(count, vertices);
    const unsigned char *joint = accessor(g, number(attribute, "JOINTS_0"), &count, 4);
    const float *weight = accessor(g, number(attribute, "WEIGHTS_0"), &count, 16);
    for (int v = 0; v < vertices; v++) {
        float sum = 0, length = 0;
        for (int i = 0; i < 4; i++) {
            assert_true(joint[4 * v + i] < 24 && weight[4 * v + i] >= 0);
            sum += weight[4 * v + i];
        }
        for (int k = 0; k < 3; k++) length += normal[3 * v + k] * normal[3 * v + k];
        assert_float_equal(sum, 1, 4e-7);
        assert_float_equal(length, 1, 1e-4);
    }
}

/* Inverse bind matrices undo the joints' places in the rest pose. */
static void check_bind(const glb *g, const cJSON *skinned, const cJSON *nodes) {
    int count;
    const float *bind = accessor(g, number(skinned, "inverseBindMatrices"), &count, 64);
    double place[24][3];
    for (int j = 0; j < 24; j++)
        for (int k = 0; k < 3; k++) {
            int parent = body->parent[j];
            place[j][k] = at(get(at(nodes, j), "translation"), k)->valuedouble + (j ? place[parent][k] : 0);
            assert_float_equal(place[j][k], -bind[16 * j + 12 + k], 1e-5);
        }
}

/* 25 channels, unit quaternions, and the pelvis at the motion's place. */
static void check_clip(context *c, const glb *g, const sherf_motion *motion) {
    int count;
    const cJSON *clip = at(get(g->json, "animations"), 0);
    assert_int_equal(cJSON_GetArraySize(get(clip, "channels")), 25);
    const float *time = accessor(g, number(at(get(clip, "samplers"), 0), "input"), &count, 4);
    assert_int_equal(count, sherf_motion_frame_count(motion));
    assert_float_equal(time[1], 0.04, 1e-4);
    const float *moved = accessor(g, number(at(get(clip, "samplers"), 0), "output"), &count, 12);
    sherf_pose pose;
    float joints[72];
    sherf_motion_pose(motion, 2, &pose);
    assert_ok(c, sherf_body_pose(c, body, &pose, NULL, joints));
    for (int k = 0; k < 3; k++) assert_float_equal(moved[6 + k], joints[k], 1e-4);
    for (int s = 1; s < 25; s++) {
        const float *q = accessor(g, number(at(get(clip, "samplers"), s), "output"), &count, 16);
        for (int f = 0; f < count; f++)
            assert_float_equal(q[4 * f] * q[4 * f] + q[4 * f + 1] * q[4 * f + 1] +
                                   q[4 * f + 2] * q[4 * f + 2] + q[4 * f + 3] * q[4 * f + 3],
                               1, 1e-5);
    }
}

static void glb_is_a_rigged_person(void **state) {
    context *c = *state;
    const char *path = kept("person.glb");
    sherf_export_options o = quick;
    sherf_exported e;
    int count, vertices, indices;
    sherf_motion *motion = walk(c);
    o.motion = motion;
    assert_ok(c, sherf_export(c, avatar, body, &o, path, &e));
    assert_true(e.triangles > 500 && e.triangles <= 1500 && e.charts > 0);
    glb g = glb_open(c, path);
    assert_string_equal(get(get(get(g.json, "asset"), "extras"), "up")->valuestring, "+Y");
    const cJSON *nodes = get(g.json, "nodes"), *skinned = at(get(g.json, "skins"), 0);
    assert_int_equal(cJSON_GetArraySize(nodes), 25);
    assert_int_equal(cJSON_GetArraySize(get(skinned, "joints")), 24);
    assert_string_equal(get(at(nodes, 0), "name")->valuestring, "pelvis");
    assert_string_equal(get(at(nodes, 23), "name")->valuestring, "right_hand");
    const cJSON *primitive = at(get(at(get(g.json, "meshes"), 0), "primitives"), 0);
    const cJSON *attribute = get(primitive, "attributes");
    const float *position = accessor(&g, number(attribute, "POSITION"), &vertices, 12);
    const uint32_t *index = accessor(&g, number(primitive, "indices"), &indices, 4);
    assert_int_equal(indices, 3 * e.triangles);
    assert_welded(position, vertices, index, indices);
    const float *uv = accessor(&g, number(attribute, "TEXCOORD_0"), &count, 8);
    for (int i = 0; i < 2 * count; i++) assert_true(uv[i] > 0 && uv[i] < 1);
    check_corners(&g, attribute, vertices);
    check_bind(&g, skinned, nodes);
    /* the picture */
    const cJSON *view = at(get(g.json, "bufferViews"), number(at(get(g.json, "images"), 0), "bufferView"));
    image_u8 picture;
    assert_ok(c, image_parse(c, g.bin + number(view, "byteOffset"), (size_t)number(view, "byteLength"), 3,
                             &picture));
    assert_int_equal(picture.width, 256);
    mem_free(picture.data);
    check_clip(c, &g, motion);
    glb_close(&g);
    assert_reads_back(c, path, motion);
    sherf_motion_free(motion);
}

static void glb_with_vertex_colors(void **state) {
    context *c = *state;
    const char *path = kept("plain.glb");
    sherf_export_options o = quick;
    o.texture_px = -1;
    o.lit = 1;
    int count;
    assert_ok(c, sherf_export(c, avatar, body, &o, path, NULL));
    glb g = glb_open(c, path);
    const cJSON *attribute = get(at(get(at(get(g.json, "meshes"), 0), "primitives"), 0), "attributes");
    const float *color = accessor(&g, number(attribute, "COLOR_0"), &count, 12);
    for (int i = 0; i < 3 * count; i++) assert_true(color[i] >= 0 && color[i] <= 1);
    assert_null(cJSON_GetObjectItem(g.json, "images"));
    assert_null(cJSON_GetObjectItem(g.json, "animations"));
    assert_null(cJSON_GetObjectItem(g.json, "extensionsUsed"));
    glb_close(&g);
}

/* ---- .ply and .obj ---- */
static long header_number(const char *text, const char *before) {
    const char *found = strstr(text, before);
    if (!found) fail_msg("no %s", before);
    return strtol(found + strlen(before), NULL, 10);
}

static void ply_is_a_closed_mesh(void **state) {
    context *c = *state;
    const char *path = test_path("person.ply");
    sherf_export_options o = quick;
    sherf_pose canonical;
    size_t bytes;
    sherf_pose_canonical(&canonical);
    o.pose = &canonical;
    o.triangles = -1;
    assert_ok(c, sherf_export(c, avatar, body, &o, path, NULL));
    unsigned char *file = read_all(c, path, &bytes);
    long vertices = header_number((char *)file, "element vertex "),
         faces = header_number((char *)file, "element face ");
    const unsigned char *row = (unsigned char *)strstr((char *)file, "end_header\n") + 11;
    assert_int_equal(bytes, (size_t)(row - file) + 27 * (size_t)vertices + 13 * (size_t)faces);
    surface s = {.vertices = vertices, .triangles = faces};
    s.position = calloc((size_t)vertices, 12);
    s.triangle = calloc((size_t)faces, 12);
    float low[3], high[3], min[3] = {9, 9, 9}, max[3] = {-9, -9, -9};
    for (long v = 0; v < vertices; v++, row += 27) {
        memcpy(s.position + 3 * v, row, 12);
        for (int k = 0; k < 3; k++) {
            min[k] = fminf(min[k], s.position[3 * v + k]);
            max[k] = fmaxf(max[k], s.position[3 * v + k]);
        }
    }
    for (long t = 0; t < faces; t++, row += 13) {
        assert_int_equal(row[0], 3);
        memcpy(s.triangle + 3 * t, row + 1, 12);
    }
    assert_closed(&s);
    assert_true(volume_of(&s) > 0);
    body_canonical_bounds(body, low, high); /* 5 cm off the body, like the shell */
    const float cell = (high[1] - low[1]) / 40;
    for (int k = 0; k < 3; k++) {
        assert_float_equal(min[k], low[k], 1.5 * cell);
        assert_float_equal(max[k], high[k], 1.5 * cell);
    }
    free(s.position), free(s.triangle);
    mem_free(file);
}

static void obj_brings_its_picture(void **state) {
    context *c = *state;
    const char *path = test_path("person.obj");
    sherf_export_options o = quick;
    sherf_exported e;
    size_t bytes;
    o.up = SHERF_UP_Z;
    assert_ok(c, sherf_export(c, avatar, body, &o, path, &e));
    char *text = (char *)read_all(c, path, &bytes);
    long long v = 0, vt = 0, vn = 0, f = 0;
    float high = -9, low = 9;
    for (char *line = strtok(text, "\n"); line; line = strtok(NULL, "\n")) {
        float x[3];
        long long n[9];
        if (sscanf(line, "v %f %f %f", x, x + 1, x + 2) == 3)
            v++, high = fmaxf(high, x[2]), low = fminf(low, x[2]);
        vt += !strncmp(line, "vt ", 3);
        vn += !strncmp(line, "vn ", 3);
        if (strncmp(line, "f ", 2)) continue;
        f++;
        assert_int_equal(sscanf(line, "f %lld/%lld/%lld %lld/%lld/%lld %lld/%lld/%lld", n, n + 1, n + 2,
                                n + 3, n + 4, n + 5, n + 6, n + 7, n + 8),
                         9);
        for (int k = 0; k < 9; k++) assert_true(n[k] >= 1 && n[k] <= (k % 3 == 1 ? vt : v));
    }
    assert_int_equal(v, e.vertices);
    assert_int_equal(vn, e.vertices);
    assert_int_equal(f, e.triangles);
    assert_true(high - low > 1.2); /* the body stands along z */
    mem_free(text);
    image_u8 picture;
    char beside[600];
    snprintf(beside, sizeof beside, "%.*s.png", (int)strlen(path) - 4, path);
    assert_ok(c, image_read(c, beside, 3, &picture));
    assert_int_equal(picture.width, 256);
    mem_free(picture.data);
    snprintf(beside, sizeof beside, "%.*s.mtl", (int)strlen(path) - 4, path);
    text = (char *)read_all(c, beside, &bytes);
    assert_non_null(strstr(text, "map_Kd person.png"));
    mem_free(text);
}

static void splats_are_read_back(void **state) {
    context *c = *state;
    const char *path = kept("splats.ply");
    sherf_export_options o = quick;
    sherf_exported e;
    size_t bytes;
    o.format = "splats";
    o.pose = sherf_avatar_pose(avatar);
    assert_ok(c, sherf_export(c, avatar, body, &o, path, &e));
    assert_int_equal(e.splats, 700);
    unsigned char *file = read_all(c, path, &bytes);
    assert_int_equal(header_number((char *)file, "element vertex "), 700);
    assert_non_null(strstr((char *)file, "property float f_dc_0\n"));
    assert_non_null(strstr((char *)file, "property float rot_3\nend_header"));
    const unsigned char *row = (unsigned char *)strstr((char *)file, "end_header\n") + 11;
    assert_int_equal(bytes, (size_t)(row - file) + 700 * 17 * 4);
    posed_body *p;
    const sherf_pose *pose = sherf_avatar_pose(avatar);
    float min[3], max[3];
    assert_ok(c, posed_body_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, &p));
    body_world_box(body, p, min, max);
    posed_body_free(p);
    for (int i = 0; i < 700; i++, row += 68) {
        float x[17];
        memcpy(x, row, sizeof x);
        for (int k = 0; k < 17; k++) assert_true(isfinite(x[k]));
        for (int k = 0; k < 3; k++) {
            assert_true(x[k] > min[k] - 0.1f && x[k] < max[k] + 0.1f);
            float color = 0.5f + 0.28209479f * x[6 + k];
            assert_true(color > -1e-3f && color < 1.001f);
            assert_true(x[10 + k] < logf(0.1f) && x[10 + k] > logf(1e-4f));
        }
        assert_true(x[12] < x[10]); /* flat, perpendicular to the normal */
        assert_float_equal(x[13] * x[13] + x[14] * x[14] + x[15] * x[15] + x[16] * x[16], 1, 1e-4);
        assert_float_equal(1 / (1 + expf(-x[9])), 0.95, 1e-3);
    }
    mem_free(file);
}

/* ---- refused requests ---- */
static void assert_refused(context *c, const sherf_export_options *o, const char *path, const char *word) {
    assert_int_equal(sherf_export(c, avatar, body, o, path, NULL), SHERF_BAD_ARGUMENT);
    if (!strstr(c->message, word)) fail_msg("no '%s' in '%s'", word, c->message);
    assert_int_not_equal(access(path, F_OK), 0);
}

static void wrong_options_are_refused(void **state) {
    context *c = *state;
    const char *ply = test_path("wrong.ply"), *glb_path = test_path("wrong.glb");
    sherf_motion *motion = walk(c);
    assert_refused(c, NULL, test_path("wrong.stl"), ".glb, .obj or .ply");
    const sherf_export_options bad[] = {
        {.resolution = 8}, {.resolution = 100000}, {.level = -1},  {.level = NAN},         {.islands = 2},
        {.triangles = 3},  {.texture_px = 100000}, {.splats = -5}, {.splats = 2000000000}, {.format = "stl"},
        {.up = 77}};
    for (size_t i = 0; i < COUNT_OF(bad); i++) assert_refused(c, &bad[i], ply, "");
    assert_refused(c, &(sherf_export_options){.format = "stl"}, ply, "glb, obj, ply or splats");
    sherf_export_options o = quick;
    o.motion = motion;
    assert_refused(c, &o, ply, "motion");
    o = quick;
    o.up = SHERF_UP_Z;
    assert_refused(c, &o, glb_path, "+Y");
    o = quick;
    o.level = 1e5;
    assert_refused(c, &o, ply, "nowhere that dense");
    sherf_pose pose;
    sherf_pose_identity(&pose);
    pose.poses_rad[5] = NAN;
    o = quick;
    o.pose = &pose;
    assert_refused(c, &o, ply, "finite");
    assert_refused(c, &o, glb_path, "finite");
    assert_int_equal(sherf_export(c, avatar, body, &quick, test_path("no/folder/x.ply"), NULL),
                     SHERF_WRITE_FAILED);
    sherf_cancel(c);
    assert_int_equal(sherf_export(c, avatar, body, &quick, ply, NULL), SHERF_CANCELLED);
    sherf_cancel_reset(c);
    assert_int_not_equal(access(ply, F_OK), 0);
    sherf_motion_free(motion);
}

static void any_allocation_may_fail(void **state) {
    context *c = *state;
    const char *glb_path = test_path("memory.glb"), *splat_path = test_path("memory.ply");
    for (int kind = 0; kind < 2; kind++) {
        sherf_export_options o = {.resolution = 24, .triangles = 300, .texture_px = 256, .splats = 50};
        if (kind) o.format = "splats";
        const char *path = kind ? splat_path : glb_path;
        const size_t live = mem_live();
        for (long n = 0;; n += 1 + n / 8) {
            mem_fail_after(n);
            sherf_status status = sherf_export(c, avatar, body, &o, path, NULL);
            mem_fail_after(-1);
            assert_int_equal(mem_live(), live);
            if (status == SHERF_OK) break;
            assert_int_equal(status, SHERF_NO_MEMORY);
            assert_int_not_equal(access(path, F_OK), 0);
        }
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(field_is_empty_outside), cmocka_unit_test(skin_follows_the_body),
        cmocka_unit_test(glb_is_a_rigged_person), cmocka_unit_test(glb_with_vertex_colors),
        cmocka_unit_test(ply_is_a_closed_mesh),   cmocka_unit_test(obj_brings_its_picture),
        cmocka_unit_test(splats_are_read_back),   cmocka_unit_test(wrong_options_are_refused),
        cmocka_unit_test(any_allocation_may_fail)};
    return cmocka_run_group_tests(tests, make_avatar, free_avatar);
}
