/* Tests of the surroundings of people: patterns, shadows of invisible people, hand-held cameras. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "synth/tube/tubeman.h"
#include "synth/people/people_cameras.h"
#include "synth/people/place.h"
#include "synth/trace/trace_inside.h"
#include "support.h"

/* ---- patterns ---- */

static void noise_repeats(void **state) {
    for (int i = 0; i < 200; i++) {
        float u = (float)random_uniform(1, (uint64_t)i), v = (float)random_uniform(2, (uint64_t)i);
        float x = place_clouds(7, 5, 4, u, v);
        assert_true(x >= 0 && x <= 1);
        assert_float_equal(x, place_clouds(7, 5, 4, u + 1, v - 2), 1e-4f);
    }
    assert_float_equal(place_noise(3, 4, 0.99999f, 0.3f), place_noise(3, 4, 0, 0.3f), 1e-3f);
}

static void patterns_follow_from_their_key(void **state) {
    static const float color[PATTERN_COLORS][3] = {
        {0.7f, 0.5f, 0.3f}, {0.5f, 0.4f, 0.3f}, {0.2f, 0.2f, 0.2f}};
    context *c = test_context();
    for (int kind = 0; kind < PATTERN_KINDS; kind++) {
        trace_texture *a, *b, *other;
        assert_ok(c, place_pattern_create(c, (place_pattern)kind, color, 11, 64, &a));
        assert_ok(c, place_pattern_create(c, (place_pattern)kind, color, 11, 64, &b));
        assert_ok(c, place_pattern_create(c, (place_pattern)kind, color, 12, 64, &other));
        int differ = 0, holes = 0;
        for (int i = 0; i < 64 * 64; i++) {
            float uv[2] = {((float)(i % 64) + 0.5f) / 64, ((float)(i / 64) + 0.5f) / 64}, x[4], y[4], z[4];
            texture_sample(a, uv, 1 / 64.f, x);
            texture_sample(b, uv, 1 / 64.f, y);
            texture_sample(other, uv, 1 / 64.f, z);
            assert_memory_equal(x, y, sizeof x);
            differ += memcmp(x, z, sizeof x) != 0;
            holes += x[3] < 0.5f;
        }
        assert_true(differ > 64);
        assert_int_equal(holes > 0, kind == PATTERN_LEAVES);
        trace_texture_free(a);
        trace_texture_free(b);
        trace_texture_free(other);
    }
    sherf_context_free(c);
}

/* ---- visibility ---- */

static const uint32_t two_faces[6] = {0, 1, 2, 0, 2, 3};

static void add_square(context *c, trace_scene *s, float side, float y, trace_material material,
                       float corner[12]) {
    const float at[12] = {-side, y, -side, -side, y, side, side, y, side, side, y, -side};
    memcpy(corner, at, sizeof at);
    const trace_mesh mesh = {.vertices = 4, .faces = 2, .face = two_faces, .rest = corner};
    assert_ok(c, trace_scene_add(c, s, &mesh, &material));
}

/* The brightness of a floor below a roof, seen straight down from a camera between them or above both. */
static float floor_below(trace_seen roof, bool lamp, float eye_m) {
    context *c = test_context();
    trace_scene *s;
    trace_picture p;
    sherf_camera camera;
    float a[12], b[12];
    const float *position[2] = {a, b}, centre[3] = {0, 0, 0};
    trace_material material = trace_material_plain();
    trace_light light = {.up = {0, 1, 0}};
    assert_ok(c, trace_scene_create(c, 0.1f, &s));
    add_square(c, s, 0.5f, 0, material, a);
    material.seen = roof;
    for (int k = 0; k < 3; k++) material.tint[k] = 0.25f;
    add_square(c, s, 40, 1, material, b);
    if (lamp)
        light.lamps = 1, light.lamp[0] = (trace_lamp){.to_lamp = {0, 1, 0}, .color = {0.5f, 0.5f, 0.5f}};
    else
        for (int k = 0; k < 3; k++) light.zenith[k] = light.horizon[k] = 0.5f;
    assert_ok(c, trace_scene_pose(c, s, position, &light));
    sherf_camera_orbit(centre, eye_m, 0, (float)M_PI_2, 0.1f, 4, 4, &camera);
    assert_ok(c, trace_render(c, s, &camera, NULL, &p));
    float seen = p.color[3 * 5];
    trace_picture_free(&p);
    trace_scene_free(s);
    sherf_context_free(c);
    return seen;
}

static void meshes_are_there_for_some(void **state) {
    enum { BELOW = 0, ABOVE = 1 };
    static const struct {
        trace_seen roof;
        float sky, lamp; /* share of 0.5 that reaches the floor */
        bool hides;      /* from a camera above the roof */
    } expected[] = {{TRACE_BY_ALL, 0, 0, true},
                    {TRACE_BY_CAMERAS, 0.5f, 0.5f, true},
                    {TRACE_NOT_BY_LAMPS, 0, 0.5f, true},
                    {TRACE_NOT_BY_CAMERAS, 0, 0, false}};
    for (size_t i = 0; i < COUNT_OF(expected); i++) {
        assert_float_equal(floor_below(expected[i].roof, false, 0.6f), expected[i].sky, 0.03f);
        assert_float_equal(floor_below(expected[i].roof, true, 0.6f), expected[i].lamp, 0.01f);
        /* the roof's upper side is lit and a quarter as bright */
        assert_float_equal(floor_below(expected[i].roof, true, 3), expected[i].hides ? 0.125f : 0, 0.01f);
    }
}

static void glowing_things_need_no_light(void **state) {
    context *c = test_context();
    trace_scene *s;
    trace_picture p;
    sherf_camera camera;
    float a[12];
    const float *position[1] = {a}, centre[3] = {0, 0, 0};
    trace_material material = trace_material_plain();
    const trace_light dark = {.up = {0, 1, 0}};
    material.glow[0] = 0.75f, material.tint[0] = 0.5f;
    assert_ok(c, trace_scene_create(c, 0.1f, &s));
    add_square(c, s, 1, 0, material, a);
    assert_ok(c, trace_scene_pose(c, s, position, &dark));
    sherf_camera_orbit(centre, 1, 0, (float)M_PI_2, 0.1f, 4, 4, &camera);
    assert_ok(c, trace_render(c, s, &camera, NULL, &p));
    assert_float_equal(p.color[0], 0.375f, 1e-5f);
    assert_float_equal(p.color[1], 0, 1e-6f);
    trace_picture_free(&p);
    trace_scene_free(s);
    sherf_context_free(c);
}

/* ---- places ---- */

enum { SIDE = 40, PIXELS = SIDE * SIDE };

/* A board, 1.6 m tall, in the place of a person. */
static const float board[12] = {-0.3f, -0.9f, 0, 0.3f, -0.9f, 0, 0.3f, 0.7f, 0, -0.3f, 0.7f, 0};

static void draw_place(place_kind kind, uint64_t key, bool with_board, int threads, trace_picture *out) {
    context *c = test_context();
    const trace_material material = trace_material_plain();
    const trace_mesh mesh = {.vertices = 4, .faces = 2, .face = two_faces, .rest = board};
    const float *position = board, centre[3] = {0, -0.1f, 0};
    const place_people people = {with_board, &mesh, &material, &position};
    const trace_light light = {.up = {0, 1, 0},
                               .zenith = {0.5f, 0.5f, 0.5f},
                               .horizon = {0.4f, 0.4f, 0.4f},
                               .ground = {0.2f, 0.2f, 0.2f},
                               .lamp[0] = {.to_lamp = {0.5f, 1, 0.8f}, .color = {0.5f, 0.5f, 0.5f}},
                               .lamps = 1};
    place p = {.kind = kind, .key = key, .floor_world = -0.9f, .near_color = {{0.8f, 0.2f, 0.2f}}};
    sherf_camera camera;
    c->threads = threads;
    sherf_camera_orbit(centre, 3, 0.2f, 0.1f, 0.7f, SIDE, SIDE, &camera);
    assert_ok(c, place_picture(c, &p, &light, &people, &camera, out));
    sherf_context_free(c);
}

static void places_fill_the_picture(void **state) {
    for (int kind = 0; kind < PLACE_KINDS; kind++) {
        trace_picture a;
        float sum = 0;
        draw_place((place_kind)kind, 5, true, 1, &a);
        for (int i = 0; i < 3 * PIXELS; i++) {
            assert_true(a.alpha[i / 3] == 1);
            assert_true(a.color[i] >= 0 && a.color[i] < 4);
            sum += a.color[i];
        }
        assert_true(sum > 0.03f * 3 * PIXELS);
        trace_picture_free(&a);
    }
}

static void places_follow_from_their_key(void **state) {
    trace_picture a, b, other;
    float apart = 0;
    draw_place(PLACE_ROOM, 5, true, 1, &a);
    draw_place(PLACE_ROOM, 5, true, 2, &b);
    draw_place(PLACE_ROOM, 6, true, 2, &other);
    assert_memory_equal(a.color, b.color, 3 * PIXELS * sizeof *a.color);
    for (int i = 0; i < 3 * PIXELS; i++) apart += fabsf(a.color[i] - other.color[i]);
    assert_true(apart > 0.01f * 3 * PIXELS);
    trace_picture_free(&a);
    trace_picture_free(&b);
    trace_picture_free(&other);
}

/* Where the board would hide the floor behind it, the picture still shows the floor, but in the board's
 * shadow. */
static void people_cast_shadows_and_are_not_seen(void **state) {
    trace_picture with, without;
    draw_place(PLACE_STUDIO, 5, true, 1, &with);
    draw_place(PLACE_STUDIO, 5, false, 1, &without);
    int darker = 0, brighter = 0;
    for (int i = 0; i < PIXELS; i++) {
        darker += with.color[3 * i] < 0.9f * without.color[3 * i];
        brighter += with.color[3 * i] > 1.05f * without.color[3 * i];
    }
    assert_in_range(darker, PIXELS / 50, PIXELS / 3);
    assert_true(brighter == 0);
    trace_picture_free(&with);
    trace_picture_free(&without);
}

static void light_belongs_to_the_place(void **state) {
    int kinds[PLACE_KINDS] = {0};
    for (uint64_t i = 0; i < 300; i++) {
        trace_light l, again;
        place_kind kind = place_light(i, &l);
        assert_int_equal(place_light(i, &again), kind);
        assert_memory_equal(&l, &again, sizeof l);
        kinds[kind]++;
        assert_true(l.lamps >= 1 && l.lamps <= TRACE_LAMPS);
        for (int k = 0; k < l.lamps; k++) assert_true(l.lamp[k].to_lamp[1] > 0.2f); /* no light from below */
        bool outdoors = kind == PLACE_STREET || kind == PLACE_GREEN;
        assert_true(outdoors || l.lamp[0].half_angle_rad > 0.1f); /* only the sun is sharp */
    }
    for (int k = 0; k < PLACE_KINDS; k++) assert_true(kinds[k] > 8);
}

/* ---- cameras and poses of photos ---- */

static void photos_show_people_whole(void **state) {
    enum { VIEWS = 8, POINTS = 400, PICTURE = 512 };
    context *c = test_context();
    float point[3 * POINTS], uv[2 * POINTS], depth[POINTS];
    for (uint64_t who = 0; who < 40; who++) {
        sherf_camera camera[VIEWS], again[VIEWS];
        float wide = who % 4 ? 0.35f : 0.9f; /* arms down, or out */
        for (int i = 0; i < POINTS; i++) {
            point[3 * i] = (float)(random_uniform(who, 3 * (uint64_t)i) * 2 - 1) * wide;
            point[3 * i + 1] = -0.9f + 1.7f * (float)i / (POINTS - 1);
            point[3 * i + 2] = (float)(random_uniform(who, 3 * (uint64_t)i + 1) * 2 - 1) * 0.2f;
        }
        assert_ok(c, people_cameras_photo(c, who, POINTS, point, -0.9f, VIEWS, PICTURE, camera));
        assert_ok(c, people_cameras_photo(c, who, POINTS, point, -0.9f, VIEWS, PICTURE, again));
        assert_memory_equal(camera, again, sizeof camera);
        for (int v = 0; v < VIEWS; v++) {
            float low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY}, at[3];
            assert_ok(c, camera_check(c, &camera[v]));
            camera_project(&camera[v], POINTS, point, uv, depth);
            for (int i = 0; i < 2 * POINTS; i++) {
                low[i % 2] = fminf(low[i % 2], uv[i]);
                high[i % 2] = fmaxf(high[i % 2], uv[i]);
            }
            assert_true(low[0] > 0 && low[1] > 0 && high[0] < PICTURE - 1 && high[1] < PICTURE - 1);
            float tall = (high[1] - low[1]) / PICTURE, across = (high[0] - low[0]) / PICTURE;
            assert_true(tall < 0.97f && (tall > 0.53f || across > 0.85f));
            float focal_mm = 36 * camera[v].K[0] / PICTURE;
            assert_true(focal_mm > 25.9f && focal_mm < 70.1f);
            camera_position(&camera[v], at);
            assert_true(at[1] > -0.9f + 0.2f && at[1] < -0.9f + 1.8f);
            assert_true(fabsf(camera[v].R[7]) < 0.45f); /* the axis is within 27 degrees of level */
            assert_true(-camera[v].R[4] > 0.88f);       /* and up is up */
            /* view 4 sees the front, view 0 the back */
            assert_true(v != VIEWS / 2 || at[2] > 0.8f);
            assert_true(v != 0 || at[2] < -0.8f);
        }
    }
    sherf_context_free(c);
}

static void people_in_photos_stand(void **state) {
    static const float unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, none[72];
    context *c = test_context();
    body_model *body;
    pose_library *l;
    posed_body *posed;
    float pose[72];
    assert_ok(c, tubeman_create(c, &body));
    assert_ok(c, posed_body_create(c, body, none, none, unit, none, &posed));
    assert_true(pose_imbalance(body, posed->vertices_smpl) < 0.02f);
    float *tipped = mem_alloc(c, (size_t)body->vertices, 3 * sizeof *tipped);
    for (int v = 0; v < body->vertices; v++) { /* half a radian forward about the toes */
        const float *p = posed->vertices_smpl + 3 * v;
        tipped[3 * v] = p[0];
        tipped[3 * v + 1] = cosf(0.5f) * p[1] - sinf(0.5f) * p[2];
        tipped[3 * v + 2] = sinf(0.5f) * p[1] + cosf(0.5f) * p[2];
    }
    assert_true(pose_imbalance(body, tipped) > 0.15f);
    memcpy(pose, none, sizeof pose);
    pose[3 * 1] = -1.2f; /* a leg lifted forward */
    posed_body_free(posed);
    assert_ok(c, posed_body_create(c, body, pose, none, unit, none, &posed));
    assert_true(pose_imbalance(body, posed->vertices_smpl) > 0.15f);
    posed_body_free(posed);
    mem_free(tipped);
    assert_ok(c, pose_library_create(c, &l));
    int straight = 0;
    for (uint64_t i = 0; i < 600; i++) {
        pose_draw_photo(l, i, pose);
        assert_true(pose_within(pose));
        straight += pose[3 * 4] < 0.3f && pose[3 * 5] < 0.3f; /* both knees */
    }
    assert_in_range(straight, 280, 500);
    pose_library_free(l);
    sherf_body_free(body);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(noise_repeats),
                                       cmocka_unit_test(patterns_follow_from_their_key),
                                       cmocka_unit_test(meshes_are_there_for_some),
                                       cmocka_unit_test(glowing_things_need_no_light),
                                       cmocka_unit_test(places_fill_the_picture),
                                       cmocka_unit_test(places_follow_from_their_key),
                                       cmocka_unit_test(people_cast_shadows_and_are_not_seen),
                                       cmocka_unit_test(light_belongs_to_the_place),
                                       cmocka_unit_test(photos_show_people_whole),
                                       cmocka_unit_test(people_in_photos_stand)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
