/* Tests of the ray tracer against results computed by hand: silhouettes, depth, normals, light, shadow,
 * opacity. */
#include "support.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "synth/trace/trace.h"

/* ---- scenes ---- */

typedef struct {
    float *vertex, *uv;
    uint32_t *face;
    int64_t vertices, faces;
} shape;

static void *allocated(size_t count, size_t size) {
    void *p = calloc(count, size);
    if (!p) abort();
    return p;
}

static void shape_free(shape *s) {
    free(s->vertex), free(s->uv), free(s->face);
    *s = (shape){0};
}

/* columns x rows quads over origin + u a + v b, counter-clockwise around a x b. */
static shape make_sheet(int columns, int rows, const float origin[3], const float a[3], const float b[3]) {
    shape s = {.vertices = (int64_t)(columns + 1) * (rows + 1), .faces = 2 * (int64_t)columns * rows};
    s.vertex = allocated((size_t)s.vertices, 12), s.uv = allocated((size_t)s.vertices, 8);
    s.face = allocated((size_t)s.faces, 12);
    for (int j = 0, n = 0; j <= rows; j++)
        for (int i = 0; i <= columns; i++, n++) {
            float u = (float)i / (float)columns, v = (float)j / (float)rows;
            for (int k = 0; k < 3; k++) s.vertex[3 * n + k] = origin[k] + u * a[k] + v * b[k];
            s.uv[2 * n] = u, s.uv[2 * n + 1] = v;
        }
    uint32_t *f = s.face, across = (uint32_t)columns + 1;
    for (uint32_t j = 0; j < (uint32_t)rows; j++)
        for (uint32_t i = 0; i < (uint32_t)columns; i++, f += 6) {
            uint32_t p = j * across + i, six[6] = {p, p + 1, p + across + 1, p, p + across + 1, p + across};
            memcpy(f, six, sizeof six);
        }
    return s;
}

static shape make_sphere(int columns, int rows, const float centre[3], float radius) {
    shape s = make_sheet(columns, rows, (float[3]){0}, (float[3]){1, 0, 0}, (float[3]){0, 1, 0});
    for (int64_t n = 0; n < s.vertices; n++) {
        double u = 2 * M_PI * s.vertex[3 * n], v = M_PI * s.vertex[3 * n + 1];
        if (s.vertex[3 * n] == 1) u = 0;
        s.vertex[3 * n] = centre[0] + radius * (float)(sin(v) * sin(u));
        s.vertex[3 * n + 1] = centre[1] - radius * (float)cos(v);
        s.vertex[3 * n + 2] = centre[2] + radius * (float)(sin(v) * cos(u));
    }
    for (int64_t i = 0; i < 3 * s.faces;
         i++) /* one seam and one vertex at each pole: smooth normals everywhere */
        if (s.face[i] % (uint32_t)(columns + 1) == (uint32_t)columns) s.face[i] -= (uint32_t)columns;
    return s;
}

static void add(context *c, trace_scene *scene, const shape *s, const trace_material *material) {
    trace_material plain = trace_material_plain();
    trace_mesh mesh = {s->vertices, s->faces, s->face, s->vertices, s->uv, NULL, s->vertex};
    assert_ok(c, trace_scene_add(c, scene, &mesh, material ? material : &plain));
}

static trace_light dark(void) {
    return (trace_light){.up = {0, 1, 0}, .seed = 7};
}

static trace_light even_sky(void) {
    return (trace_light){.up = {0, 1, 0}, .zenith = {1, 1, 1}, .horizon = {1, 1, 1}, .ground = {1, 1, 1}};
}

/* A camera that looks from this distance at the origin, from the person's front; elevation as in
 * sherf_camera_orbit. */
static sherf_camera camera_at(float distance, float elevation, int size) {
    sherf_camera camera;
    sherf_camera_orbit((float[3]){0}, distance, 0, elevation, 0.8f, size, size, &camera);
    return camera;
}

/* The picture's value at the projection of a point in the world. */
static size_t pixel_of(const sherf_camera *camera, const float place[3]) {
    float uv[2];
    camera_project(camera, 1, place, uv, NULL);
    int x = (int)lrintf(uv[0]), y = (int)lrintf(uv[1]);
    assert_true(x >= 0 && x < camera->width_px && y >= 0 && y < camera->height_px);
    return (size_t)y * (size_t)camera->width_px + (size_t)x;
}

/* ---- tests ---- */

static void test_sphere(void **state) {
    context *c = *state;
    trace_scene *scene;
    trace_picture p;
    trace_light light = dark();
    const float radius = 0.6f, distance = 2.5f, to_lamp[3] = {0.36f, 0.48f, 0.8f};
    shape ball = make_sphere(256, 128, (float[3]){0}, radius);
    const float *positions[1] = {ball.vertex};
    trace_material grey = trace_material_plain();
    for (int k = 0; k < 3; k++) grey.tint[k] = 0.25f * (float)(k + 1);
    light.lamps = 1;
    light.lamp[0] = (trace_lamp){{3.6f, 4.8f, 8}, 0.001f, {2, 1, 0.5f}};
    sherf_camera camera = camera_at(distance, 0.3f, 200);
    assert_ok(c, trace_scene_create(c, 0.02f, &scene));
    add(c, scene, &ball, &grey);
    assert_ok(c, trace_scene_pose(c, scene, positions, &light));
    assert_ok(c, trace_render(c, scene, &camera, &(trace_options){.depth = true}, &p));
    double area = 0, outline = camera.K[0] * radius / sqrt(distance * distance - radius * radius);
    float eye[3];
    camera_position(&camera, eye);
    int inner = 0;
    for (int i = 0; i < 200 * 200; i++) {
        area += p.alpha[i];
        /* the ray through the pixel's middle, intersected with the sphere */
        float d[3], x = ((float)(i % 200) - camera.K[2]) / camera.K[0],
                    y = ((float)(i / 200) - camera.K[5]) / camera.K[4];
        for (int k = 0; k < 3; k++) d[k] = camera.R[k] * x + camera.R[3 + k] * y + camera.R[6 + k];
        double dd = 0, de = 0, ee = 0;
        for (int k = 0; k < 3; k++) dd += d[k] * d[k], de += d[k] * eye[k], ee += eye[k] * eye[k];
        double root = de * de - dd * (ee - radius * radius), t = (-de - sqrt(root)) / dd;
        if (!(root > 0.05)) { /* near the outline the depth of the facets differs more */
            if (root < -0.01) assert_true(isinf(p.depth_m[i]) && p.alpha[i] == 0 && p.color[3 * i] == 0);
            continue;
        }
        assert_float_equal(p.depth_m[i], t, 3e-4);
        assert_float_equal(p.alpha[i], 1, 0);
        double n[3], cosine = 0;
        for (int k = 0; k < 3; k++) {
            n[k] = (eye[k] + t * d[k]) / radius, cosine += n[k] * to_lamp[k];
            assert_float_equal(p.normal_world[3 * i + k], n[k], 5e-3);
        }
        for (int k = 0; k < 3; k++)
            assert_float_equal(p.color[3 * i + k], grey.tint[k] * light.lamp[0].color[k] * fmax(cosine, 0),
                               0.01);
        inner++;
    }
    assert_true(inner > 8000);
    assert_float_equal(area / (M_PI * outline * outline), 1, 0.002);
    trace_picture_free(&p);
    trace_scene_free(scene);
    shape_free(&ball);
}

/* A coarse sphere has no dark triangles near the terminator, and wrapping brings light beyond it. */
static void test_terminator(void **state) {
    context *c = *state;
    trace_scene *scene;
    trace_light light = dark();
    shape ball = make_sphere(24, 16, (float[3]){0}, 0.6f);
    const float *positions[1] = {ball.vertex};
    sherf_camera camera = camera_at(2.5f, 0, 128);
    light.lamps = 1;
    light.lamp[0] = (trace_lamp){{1, 0, 0}, 0.02f, {1, 1, 1}};
    for (int wrapped = 0; wrapped < 2; wrapped++) {
        trace_picture p;
        trace_material skin = trace_material_plain();
        for (int k = 0; k < 3 && wrapped; k++) skin.wrap[k] = 0.3f;
        assert_ok(c, trace_scene_create(c, 0.02f, &scene));
        add(c, scene, &ball, &skin);
        assert_ok(c, trace_scene_pose(c, scene, positions, &light));
        assert_ok(c, trace_render(c, scene, &camera, &(trace_options){.depth = true}, &p));
        for (int i = 0; i < 128 * 128; i++) {
            if (p.alpha[i] < 1 || isinf(p.depth_m[i])) continue;
            float wrap = skin.wrap[0], soft = (p.normal_world[3 * i] + wrap) / (1 + wrap);
            assert_float_equal(p.color[3 * i], soft > 0 ? soft : 0, 0.06);
        }
        trace_picture_free(&p);
        trace_scene_free(scene);
    }
    shape_free(&ball);
}

/* A square roof 0.5 m above a floor, under a lamp of half-angle a straight above: shadow, light, and between
 * them a penumbra with the visible part of a disc. */
static void test_shadow(void **state) {
    context *c = *state;
    trace_scene *scene;
    trace_picture p;
    trace_light light = dark();
    shape floor = make_sheet(40, 40, (float[3]){-1, 0, 1}, (float[3]){2, 0, 0}, (float[3]){0, 0, -2});
    shape roof =
        make_sheet(1, 1, (float[3]){-0.4f, 0.5f, 0.4f}, (float[3]){0.8f, 0, 0}, (float[3]){0, 0, -0.8f});
    const float *positions[2] = {floor.vertex, roof.vertex};
    const float angle = 0.2f, half = 0.5f * tanf(angle); /* share of the penumbra's width */
    light.lamps = 1;
    light.lamp_rays = 256;
    light.lamp[0] = (trace_lamp){{0, 1, 0}, angle, {1, 1, 1}};
    assert_ok(c, trace_scene_create(c, 0.01f, &scene));
    add(c, scene, &floor, NULL);
    trace_material glass = trace_material_plain();
    glass.one_sided = true; /* cameras below see through the roof, light does not */
    add(c, scene, &roof, &glass);
    assert_ok(c, trace_scene_pose(c, scene, positions, &light));
    sherf_camera camera = camera_at(2.2f, 0.2f, 256);
    assert_ok(c, trace_render(c, scene, &camera, NULL, &p));
    float lit = p.color[3 * pixel_of(&camera, (float[3]){0.8f, 0, 0})];
    assert_float_equal(lit, 1, 1e-3);
    assert_float_equal(p.color[3 * pixel_of(&camera, (float[3]){0, 0, 0})], 0, 1e-3);
    assert_float_equal(p.color[3 * pixel_of(&camera, (float[3]){0.4f, 0, 0})], 0.5, 0.06);
    /* a quarter of the width outside: the part of a disc on one side of a line half a radius from its middle
     */
    double seen = 1 - (acos(0.5) - 0.5 * sqrt(0.75)) / M_PI;
    assert_float_equal(p.color[3 * pixel_of(&camera, (float[3]){0.4f + half / 2, 0, 0})], seen, 0.06);
    assert_float_equal(p.color[3 * pixel_of(&camera, (float[3]){0.4f + 1.3f * half, 0, 0})], 1, 1e-3);
    trace_picture_free(&p);
    trace_scene_free(scene);
    shape_free(&floor), shape_free(&roof);
}

/* A floor beside a wall of height H under a uniform sky: at distance d the wall hides (1 - d / sqrt(d^2 +
 * H^2)) / 2 of the light. */
static void test_corner(void **state) {
    context *c = *state;
    trace_scene *scene;
    trace_picture p;
    trace_light light = even_sky();
    const float H = 0.6f;
    shape floor = make_sheet(100, 20, (float[3]){-10, 0, 1}, (float[3]){20, 0, 0}, (float[3]){0, 0, -1});
    shape wall = make_sheet(100, 10, (float[3]){-10, 0, 0}, (float[3]){20, 0, 0}, (float[3]){0, H, 0});
    const float *positions[2] = {floor.vertex, wall.vertex};
    light.sky_rays = 256;
    assert_ok(c, trace_scene_create(c, 0.02f, &scene));
    add(c, scene, &floor, NULL);
    add(c, scene, &wall, NULL);
    assert_ok(c, trace_scene_pose(c, scene, positions, &light));
    sherf_camera camera = camera_at(2.5f, 0.6f, 128);
    assert_ok(c, trace_render(c, scene, &camera, NULL, &p));
    for (float d = 0.05f; d < 0.9f; d += 0.1f) {
        double sum = 0, hidden = 0.5 * (1 - d / sqrt(d * d + H * H));
        for (int i = 0; i < 9; i++)
            sum += p.color[3 * pixel_of(&camera, (float[3]){-0.4f + 0.1f * (float)i, 0, d})] / 9;
        assert_float_equal(sum, 1 - hidden, 0.02);
    }
    trace_picture_free(&p);
    /* reflected light: a / (1 - r (1 - a)) for white surfaces */
    light.bounce = 0.5f;
    assert_ok(c, trace_scene_pose(c, scene, positions, &light));
    assert_ok(c, trace_render(c, scene, &camera, NULL, &p));
    double a = 1 - 0.5 * (1 - 0.3 / sqrt(0.09 + H * H)), sum = 0;
    for (int i = 0; i < 9; i++)
        sum += p.color[3 * pixel_of(&camera, (float[3]){-0.4f + 0.1f * (float)i, 0, 0.3f})] / 9;
    assert_float_equal(sum, a / (1 - 0.5 * (1 - a)), 0.02);
    trace_picture_free(&p);
    trace_scene_free(scene);
    shape_free(&floor), shape_free(&wall);
}

/* Upward, level and downward rays under a sky of three colours. */
static void test_sky(void **state) {
    context *c = *state;
    trace_light light = dark();
    light.zenith[0] = 1, light.horizon[1] = 1, light.ground[2] = 1;
    const float along[3][2][3] = {{{1, 0, 0}, {0, 0, -1}}, {{1, 0, 0}, {0, 1, 0}}, {{1, 0, 0}, {0, 0, 1}}};
    const float elevation[3] = {1.2f, 0, -1.2f};
    const float expected[3][3] = {{2 / 3.0f, 1 / 3.0f, 0}, {0.2122f, 0.2878f, 0.5f}, {0, 0, 1}};
    for (int i = 0; i < 3; i++) {
        trace_scene *scene;
        trace_picture p;
        float origin[3];
        for (int k = 0; k < 3; k++) origin[k] = -0.5f * (along[i][0][k] + along[i][1][k]);
        shape sheet = make_sheet(1, 1, origin, along[i][0], along[i][1]);
        const float *positions[1] = {sheet.vertex};
        sherf_camera camera = camera_at(2, elevation[i], 32);
        assert_ok(c, trace_scene_create(c, 0.1f, &scene));
        add(c, scene, &sheet, NULL);
        assert_ok(c, trace_scene_pose(c, scene, positions, &light));
        assert_ok(c, trace_render(c, scene, &camera, NULL, &p));
        const float *rgb = p.color + 3 * pixel_of(&camera, (float[3]){0});
        for (int k = 0; k < 3; k++) assert_float_equal(rgb[k], expected[i][k], 2e-3);
        trace_picture_free(&p);
        trace_scene_free(scene);
        shape_free(&sheet);
    }
}

static trace_texture *make_texture(context *c, int alpha_even, int alpha_odd) {
    enum { SIDE = 64 };
    static uint8_t texel[SIDE][SIDE][4];
    trace_texture *t;
    for (int y = 0; y < SIDE; y++)
        for (int x = 0; x < SIDE; x++) {
            int odd = (x / 8 + y / 8) % 2;
            uint8_t rgba[4] = {odd ? 0 : 188, 188, y < SIDE / 2 ? 255 : 0,
                               (uint8_t)(odd ? alpha_odd : alpha_even)};
            memcpy(texel[y][x], rgba, 4);
        }
    assert_ok(c, trace_texture_create(c, SIDE, SIDE, 4, texel[0][0], &t));
    return t;
}

static double covered(const trace_picture *p) {
    double sum = 0;
    for (int i = 0; i < p->width * p->height; i++) sum += p->alpha[i];
    return sum;
}

/* A checkered sheet in front of a black wall, drawn as cut-out, blended and opaque. */
static void test_opacity(void **state) {
    context *c = *state;
    trace_light light = even_sky();
    shape sheet = make_sheet(4, 4, (float[3]){-0.5f, -0.5f, 0}, (float[3]){1, 0, 0}, (float[3]){0, 1, 0});
    const float *positions[1] = {sheet.vertex};
    sherf_camera camera = camera_at(2, 0, 128);
    double full = camera.K[0] / 2 * camera.K[0] / 2; /* pixels per square metre at 2 m */
    const double expected[3] = {1, 0.5, (0.2 + 0.4) / 2};
    for (int mode = TRACE_OPAQUE; mode <= TRACE_BLENDED; mode++) {
        trace_scene *scene;
        trace_picture p;
        trace_texture *t = mode == TRACE_BLENDED ? make_texture(c, 51, 102) : make_texture(c, 255, 0);
        trace_material material = trace_material_plain();
        material.color = t;
        material.alpha = (trace_alpha)mode;
        assert_ok(c, trace_scene_create(c, 0.1f, &scene));
        add(c, scene, &sheet, &material);
        assert_ok(c, trace_scene_pose(c, scene, positions, &light));
        assert_ok(c, trace_render(c, scene, &camera, NULL, &p));
        assert_float_equal(covered(&p) / full, expected[mode], 0.01);
        /* the middle of the square of row 2, column 2 (from the top): even; linear 188 is 0.503 */
        const float place[3] = {-0.5f + 2.5f / 8, 0.5f - 2.5f / 8, 0};
        size_t n = pixel_of(&camera, place);
        double opacity = mode == TRACE_BLENDED ? 0.2 : 1;
        assert_float_equal(p.alpha[n], opacity, 1e-3);
        assert_float_equal(p.color[3 * n], 0.503 * opacity, 3e-3);
        assert_float_equal(p.color[3 * n + 2], opacity, 3e-3);
        trace_picture_free(&p);
        trace_scene_free(scene);
        trace_texture_free(t);
    }
    shape_free(&sheet);
}

/* The same sheets as a roof above a floor: light falls through the holes, and through blended parts by
 * chance. */
static void test_opacity_shadow(void **state) {
    context *c = *state;
    trace_light light = even_sky();
    shape floor = make_sheet(1, 1, (float[3]){-1, -0.01f, 1}, (float[3]){2, 0, 0}, (float[3]){0, 0, -2});
    shape roof = make_sheet(1, 1, (float[3]){-4, 0.25f, 4}, (float[3]){8, 0, 0}, (float[3]){0, 0, -8});
    const float *positions[2] = {floor.vertex, roof.vertex};
    sherf_camera camera = camera_at(1.2f, 0.1f, 64);
    light.sky_rays = 1024;
    for (int i = 0; i < 2; i++) {
        trace_scene *scene;
        trace_picture p;
        trace_texture *t = i ? make_texture(c, 77, 77) : make_texture(c, 255, 0);
        trace_material material = trace_material_plain();
        material.color = t;
        material.alpha = i ? TRACE_BLENDED : TRACE_CUTOUT;
        material.one_sided = true;
        assert_ok(c, trace_scene_create(c, 0.2f, &scene));
        add(c, scene, &floor, NULL);
        add(c, scene, &roof, &material);
        assert_ok(c, trace_scene_pose(c, scene, positions, &light));
        assert_ok(c, trace_render(c, scene, &camera, NULL, &p));
        double sum = 0;
        for (int k = 0; k < 9; k++)
            sum += p.color[3 * pixel_of(&camera, (float[3]){-0.2f + 0.05f * (float)k, 0, 0.2f})] / 9;
        assert_float_equal(sum, i ? 1 - 77 / 255.0 : 0.5, i ? 0.03 : 0.15);
        trace_picture_free(&p);
        trace_scene_free(scene);
        trace_texture_free(t);
    }
    shape_free(&floor), shape_free(&roof);
}

/* Skin 5 mm outside a shirt is not drawn and does not darken it. A bead of skin in front of the shirt and an
 * arm beyond its edge are drawn. */
static void test_layers(void **state) {
    context *c = *state;
    trace_scene *scene;
    trace_picture p;
    trace_light light = even_sky();
    const float bead_at[3] = {0, 0, 0.512f};
    shape skin = make_sphere(64, 48, (float[3]){0}, 0.5f), shirt = make_sphere(64, 48, (float[3]){0}, 0.495f);
    shape bead = make_sphere(16, 12, bead_at, 0.006f),
          arm = make_sphere(24, 16, (float[3]){0.7f, 0, 0}, 0.15f);
    const float *positions[4] = {skin.vertex, shirt.vertex, bead.vertex, arm.vertex};
    trace_material red = trace_material_plain(), blue = trace_material_plain();
    red.tint[1] = red.tint[2] = 0;
    blue.tint[0] = blue.tint[1] = 0;
    blue.layer = 2;
    assert_ok(c, trace_scene_create(c, 0.02f, &scene));
    add(c, scene, &skin, &red);
    add(c, scene, &shirt, &blue);
    add(c, scene, &bead, &red);
    add(c, scene, &arm, &red);
    assert_ok(c, trace_scene_pose(c, scene, positions, &light));
    sherf_camera camera = camera_at(2, 0, 200);
    assert_ok(c, trace_render(c, scene, &camera, &(trace_options){.depth = true}, &p));
    size_t in_front = pixel_of(&camera, bead_at), beside = pixel_of(&camera, (float[3]){0.7f, 0, 0.15f});
    assert_true(p.color[3 * in_front] > 0.5f && p.color[3 * in_front + 2] < 0.01f);
    assert_float_equal(p.depth_m[in_front], 2 - 0.518, 1e-3);
    assert_true(p.color[3 * beside] > 0.5f && p.color[3 * beside + 2] == 0);
    for (float y = -0.4f; y < 0.41f; y += 0.1f) {
        size_t n = pixel_of(&camera, (float[3]){-0.1f, y, sqrtf(0.245f - 0.01f - y * y)});
        assert_float_equal(p.color[3 * n], 0, 0);
        assert_float_equal(p.color[3 * n + 2], 1, 0.04); /* grazing rays meet the skin farther away */
    }
    trace_picture_free(&p);
    trace_scene_free(scene);
    shape_free(&skin), shape_free(&shirt), shape_free(&bead), shape_free(&arm);
}

static void must_be_equal(const trace_picture *a, const trace_picture *b) {
    size_t pixels = (size_t)a->width * (size_t)a->height;
    assert_memory_equal(a->color, b->color, pixels * 3 * sizeof(float));
    assert_memory_equal(a->alpha, b->alpha, pixels * sizeof(float));
    assert_memory_equal(a->depth_m, b->depth_m, pixels * sizeof(float));
    assert_memory_equal(a->normal_world, b->normal_world, pixels * 3 * sizeof(float));
}

/* The bits are the same for any number of threads and any order of cameras, and differ for another seed. */
static void test_same_bits(void **state) {
    context *c = *state;
    int threads = c->threads;
    trace_picture first[2];
    trace_light light = even_sky();
    trace_texture *t = make_texture(c, 200, 60);
    shape ball = make_sphere(30, 20, (float[3]){0, 0.3f, 0}, 0.4f);
    shape hair = make_sphere(20, 12, (float[3]){0, 0.35f, 0}, 0.45f);
    shape floor = make_sheet(8, 8, (float[3]){-1, -0.1f, 1}, (float[3]){2, 0, 0}, (float[3]){0, 0, -2});
    const float *positions[3] = {ball.vertex, hair.vertex, floor.vertex};
    trace_material blended = trace_material_plain(), shiny = trace_material_plain();
    blended.color = t, blended.alpha = TRACE_BLENDED;
    shiny.specular = 0.04f, shiny.roughness = 0.3f;
    light.lamps = 2;
    light.lamp[0] = (trace_lamp){{1, 2, 1}, 0.1f, {0.5f, 0.5f, 0.4f}};
    light.lamp[1] = (trace_lamp){{-1, 1, 1}, 0.3f, {0.3f, 0.3f, 0.4f}};
    light.seed = 11;
    for (int run = 0; run < 4; run++) {
        trace_scene *scene;
        trace_picture p[2];
        c->threads = run == 1 ? 3 : 1;
        light.seed = run == 3 ? 12 : 11;
        assert_ok(c, trace_scene_create(c, 0.03f, &scene));
        add(c, scene, &ball, &shiny);
        add(c, scene, &hair, &blended);
        add(c, scene, &floor, NULL);
        assert_ok(c, trace_scene_pose(c, scene, positions, &light));
        for (int i = 0; i < 2; i++) {
            int view = run == 2 ? 1 - i : i;
            sherf_camera camera = camera_at(2, view ? 0.9f : 0.2f, 75);
            trace_options options = {.depth = true, .seed = 3, .samples = view ? 8 : 16};
            assert_ok(c, trace_render(c, scene, &camera, &options, &p[view]));
        }
        for (int i = 0; i < 2; i++) {
            if (run == 0) {
                first[i] = p[i];
                continue;
            }
            if (run < 3)
                must_be_equal(&p[i], &first[i]);
            else
                assert_true(memcmp(p[i].color, first[i].color, 75 * 75 * 3 * sizeof(float)) != 0);
            trace_picture_free(&p[i]);
        }
        trace_scene_free(scene);
    }
    for (int i = 0; i < 2; i++) trace_picture_free(&first[i]);
    trace_texture_free(t);
    shape_free(&ball), shape_free(&hair), shape_free(&floor);
    c->threads = threads;
}

/* A scene moved to its second pose equals a scene that was made in that pose. */
static void test_second_pose(void **state) {
    context *c = *state;
    trace_light light = even_sky();
    shape ball = make_sphere(30, 20, (float[3]){0, 0.1f, 0}, 0.4f);
    shape moved = make_sphere(30, 20, (float[3]){0.2f, 0, 0.1f}, 0.3f);
    const float *positions[1] = {ball.vertex}, *then[1] = {moved.vertex};
    sherf_camera camera = camera_at(2, 0.2f, 64);
    trace_picture p[2];
    for (int i = 0; i < 2; i++) {
        trace_scene *scene;
        assert_ok(c, trace_scene_create(c, 0.05f, &scene));
        add(c, scene, &ball, NULL);
        if (i == 0) {
            assert_ok(c, trace_scene_pose(c, scene, positions, &light));
            assert_ok(c, trace_render(c, scene, &camera, NULL, &p[i]));
            trace_picture_free(&p[i]);
        }
        assert_ok(c, trace_scene_pose(c, scene, then, &light));
        assert_ok(c, trace_render(c, scene, &camera, &(trace_options){.depth = true}, &p[i]));
        trace_scene_free(scene);
    }
    must_be_equal(&p[0], &p[1]);
    for (int i = 0; i < 2; i++) trace_picture_free(&p[i]);
    shape_free(&ball), shape_free(&moved);
}

static void test_srgb(void **state) {
    float color[6] = {0.25f, 0, 4, 0, 0, 0}, alpha[2] = {0.5f, 0};
    trace_picture p = {2, 1, color, alpha, NULL, NULL};
    uint8_t rgb[6];
    trace_picture_srgb(&p, (float[3]){0.5f, 0, 0}, rgb);
    assert_int_equal(rgb[0], 188); /* linear 0.25 + 0.5 x 0.5 = 0.5 */
    assert_int_equal(rgb[1], 0);
    assert_int_equal(rgb[2], 255);
    assert_int_equal(rgb[3], 188);
    assert_int_equal(rgb[5], 0);
}

static sherf_status everything(context *c, const shape *s, const uint8_t *texel) {
    trace_texture *t = NULL;
    trace_scene *scene = NULL;
    trace_picture p = {0};
    trace_light light = even_sky();
    trace_mesh mesh = {s->vertices, s->faces, s->face, s->vertices, s->uv, NULL, s->vertex};
    const float *positions[1] = {s->vertex};
    sherf_camera camera = camera_at(2, 0, 16);
    trace_material material = trace_material_plain();
    sherf_status status = trace_texture_create(c, 4, 4, 3, texel, &t);
    material.color = t;
    if (!status) status = trace_scene_create(c, 0.1f, &scene);
    if (!status) status = trace_scene_add(c, scene, &mesh, &material);
    if (!status) status = trace_scene_pose(c, scene, positions, &light);
    if (!status) status = trace_render(c, scene, &camera, &(trace_options){.depth = true}, &p);
    trace_picture_free(&p);
    trace_scene_free(scene);
    trace_texture_free(t);
    return status;
}

static void test_allocation_failures(void **state) {
    context *c = *state;
    static const uint8_t texel[48];
    shape ball = make_sphere(8, 6, (float[3]){0}, 0.5f);
    assert_ok(c, everything(c, &ball, texel));
    size_t live = mem_live();
    sherf_status status = SHERF_NO_MEMORY;
    int n = 0;
    for (; status != SHERF_OK; n++) {
        mem_fail_after(n);
        status = everything(c, &ball, texel);
        mem_fail_after(-1);
        if (status != SHERF_OK) assert_int_equal(status, SHERF_NO_MEMORY);
        assert_int_equal(mem_live(), live);
        assert_true(n < 100);
    }
    assert_true(n > 20);
    shape_free(&ball);
}

static void test_rejections(void **state) {
    context *c = *state;
    trace_scene *scene;
    trace_texture *t;
    trace_picture p;
    shape ball = make_sphere(8, 6, (float[3]){0}, 0.5f);
    const float *positions[1] = {ball.vertex};
    trace_mesh mesh = {ball.vertices, ball.faces, ball.face, ball.vertices, ball.uv, NULL, ball.vertex};
    trace_material plain = trace_material_plain(), bad = plain;
    trace_light light = even_sky(), wrong = light;
    sherf_camera camera = camera_at(2, 0, 16);
    assert_int_equal(trace_texture_create(c, 0, 4, 3, NULL, &t), SHERF_BAD_ARGUMENT);
    assert_int_equal(trace_texture_create(c, 4, 4, 2, NULL, &t), SHERF_BAD_ARGUMENT);
    assert_int_equal(trace_scene_create(c, 0, &scene), SHERF_BAD_ARGUMENT);
    assert_ok(c, trace_scene_create(c, 0.1f, &scene));
    assert_int_equal(trace_scene_pose(c, scene, positions, &light),
                     SHERF_BAD_ARGUMENT); /* nothing is there */
    assert_int_equal(trace_render(c, scene, &camera, NULL, &p), SHERF_BAD_ARGUMENT);
    mesh.vertices = ball.vertices - 2; /* a face names the last vertex but one */
    assert_int_equal(trace_scene_add(c, scene, &mesh, &plain), SHERF_BAD_ARGUMENT);
    mesh.vertices = ball.vertices, mesh.uvs = 3;
    assert_int_equal(trace_scene_add(c, scene, &mesh, &plain), SHERF_BAD_ARGUMENT);
    mesh.uvs = ball.vertices, bad.roughness = NAN;
    assert_int_equal(trace_scene_add(c, scene, &mesh, &bad), SHERF_BAD_ARGUMENT);
    assert_ok(c, trace_scene_add(c, scene, &mesh, &plain));
    wrong.lamps = 1;
    assert_int_equal(trace_scene_pose(c, scene, positions, &wrong), SHERF_BAD_ARGUMENT);
    wrong = light, wrong.sky_rays = 17;
    assert_int_equal(trace_scene_pose(c, scene, positions, &wrong), SHERF_BAD_ARGUMENT);
    assert_ok(c, trace_scene_pose(c, scene, positions, &light));
    assert_int_equal(trace_scene_add(c, scene, &mesh, &plain), SHERF_BAD_ARGUMENT); /* too late */
    assert_int_equal(trace_render(c, scene, &camera, &(trace_options){.samples = 5}, &p), SHERF_BAD_ARGUMENT);
    ball.vertex[4] = NAN;
    assert_int_equal(trace_scene_pose(c, scene, positions, &light), SHERF_BAD_ARGUMENT);
    ball.vertex[4] = 0;
    assert_ok(c, trace_scene_pose(c, scene, positions, &light));
    assert_ok(c, trace_render(c, scene, &camera, NULL, &p));
    trace_picture_free(&p);
    trace_scene_free(scene);
    shape_free(&ball);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_sphere),
        cmocka_unit_test(test_terminator),
        cmocka_unit_test(test_shadow),
        cmocka_unit_test(test_corner),
        cmocka_unit_test(test_sky),
        cmocka_unit_test(test_opacity),
        cmocka_unit_test(test_opacity_shadow),
        cmocka_unit_test(test_layers),
        cmocka_unit_test(test_same_bits),
        cmocka_unit_test(test_second_pose),
        cmocka_unit_test(test_srgb),
        cmocka_unit_test(test_allocation_failures),
        cmocka_unit_test(test_rejections),
    };
    return cmocka_run_group_tests(tests, test_open, test_close);
}
