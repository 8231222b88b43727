/* Tests of several pictures of a person used as one: their places side by side, and where each vertex is read
 * in them. */
#include <math.h>
#include <string.h>

#include "model/model.h"
#include "scene/scene.h"
#include "support.h"
#include "synth/tube/tubeman.h"

enum { PICTURES = 3 };
static const int side[PICTURES] = {200, 256, 180};

typedef struct {
    context *c;
    body_model *body;
    model_config config;
    observed_picture picture[PICTURES];
    posed_body *posed[PICTURES];
    uint8_t *shown[PICTURES];
    float *uv[PICTURES];
} scene;

/* Front, back and left of a person who moves in between, each from its own camera; grey pictures, no two
 * alike. */
static void open_scene(scene *s) {
    static const float azimuth[PICTURES] = {0.2f, 3.2f, 1.4f}, lens[PICTURES] = {0.8f, 0.6f, 0.9f};
    context *c = s->c = test_context();
    assert_ok(c, tubeman_create(c, &s->body));
    assert_ok(c, model_config_parse(c, "small,skin_blend_mm=25", &s->config));
    const size_t V = (size_t)s->body->vertices;
    for (int i = 0; i < PICTURES; i++) {
        observed_picture *p = &s->picture[i];
        const size_t n = (size_t)side[i] * (size_t)side[i] * 3;
        float *world = mem_alloc(c, V, 3 * sizeof *world);
        sherf_pose_identity(&p->pose);
        p->pose.poses_rad[3 * 16 + 2] = -0.5f * (float)i;
        p->pose.shapes[0] = 0.3f * (float)i;
        sherf_camera_orbit((float[]){0, 0, 0}, 3, azimuth[i], 0.1f, lens[i], side[i], side[i], &p->camera);
        p->image = (sherf_image){side[i], side[i], 3, mem_alloc(c, n, sizeof(float))};
        for (size_t k = 0; k < n; k++) p->image.data[k] = 0.1f + 0.2f * (float)i + (float)(k % 100) / 1000;
        assert_ok(c, posed_body_create(c, s->body, p->pose.poses_rad, p->pose.shapes, p->pose.R, p->pose.Th_m,
                                       &s->posed[i]));
        body_vertices_world(s->body, s->posed[i], world);
        s->uv[i] = mem_alloc(c, V, 2 * sizeof(float));
        s->shown[i] = mem_alloc(c, V, 1);
        camera_project(&p->camera, s->body->vertices, world, s->uv[i], NULL);
        assert_ok(c, body_shown(c, s->body, world, &p->camera, p->image.data, 0.015f, s->shown[i]));
        mem_free(world);
    }
}

static void close_scene(scene *s) {
    for (int i = 0; i < PICTURES; i++) {
        mem_free(s->picture[i].image.data);
        mem_free(s->uv[i]);
        mem_free(s->shown[i]);
        posed_body_free(s->posed[i]);
    }
    sherf_body_free(s->body);
    sherf_context_free(s->c);
    assert_int_equal(mem_live(), 0);
}

/* Left edges, found from the pictures' first rows in the sheet. */
static void find_pictures(const scene *s, const observed_sheet *sheet, int left[PICTURES]) {
    for (int i = 0; i < PICTURES; i++) {
        const sherf_image *p = &s->picture[i].image;
        left[i] = -1;
        for (int x = 0; x + side[i] <= sheet->width; x++)
            if (!memcmp(sheet->image + 3 * x, p->data, 3 * (size_t)side[i] * sizeof(float))) left[i] = x;
        assert_true(left[i] >= 0 && left[i] % 32 == 0);
        if (i) assert_true(left[i] >= left[i - 1] + side[i - 1] + 16);
        for (int y = 0; y < side[i]; y++)
            assert_memory_equal(sheet->image + 3 * ((size_t)y * (size_t)sheet->width + (size_t)left[i]),
                                p->data + 3 * (size_t)y * (size_t)side[i],
                                3 * (size_t)side[i] * sizeof(float));
    }
}

static void vertices_are_read_where_they_are_seen(void **state) {
    scene s;
    observed_sheet sheet;
    int left[PICTURES], in[PICTURES] = {0}, unseen = 0;
    open_scene(&s);
    assert_ok(s.c, observed_sheet_create(s.c, &s.config, s.body, PICTURES, s.picture, &sheet));
    find_pictures(&s, &sheet, left);
    const int V = s.body->vertices;
    float *world = mem_alloc(s.c, (size_t)V, 3 * sizeof *world),
          *px = mem_alloc(s.c, (size_t)V, 2 * sizeof *px);
    deform_to_picture(s.body, sheet.body, V, s.body->canonical->vertices_smpl, NULL, world);
    camera_project(&sheet.camera, V, world, px, NULL);
    for (int v = 0; v < V; v++) {
        bool any = false, at = false;
        for (int i = 0; i < PICTURES; i++) {
            if (s.shown[i][v] != SHOWN_SEEN) continue;
            any = true;
            const float dx = px[2 * v] - s.uv[i][2 * v] - (float)left[i],
                        dy = px[2 * v + 1] - s.uv[i][2 * v + 1];
            if (fabsf(dx) + fabsf(dy) > 0.02f) continue;
            at = true;
            in[i]++;
        }
        assert_int_equal(sheet.body->seen[v], any);
        assert_int_equal(at, any);
        unseen += !any;
    }
    print_message("%d, %d and %d vertices are read in a picture, %d of %d are seen in none\n", in[0], in[1],
                  in[2], unseen, V);
    for (int i = 0; i < PICTURES; i++) assert_true(in[i] > V / 10);
    assert_true(unseen < V / 5);
    mem_free(world);
    mem_free(px);
    observed_sheet_free(&sheet);
    close_scene(&s);
}

/* A blend of positions between vertices of two pictures would be in neither picture. */
static void points_are_read_in_one_picture(void **state) {
    scene s;
    observed_sheet sheet;
    int left[PICTURES];
    open_scene(&s);
    assert_ok(s.c, observed_sheet_create(s.c, &s.config, s.body, PICTURES, s.picture, &sheet));
    find_pictures(&s, &sheet, left);
    assert_true(sheet.body->blend_m > 0);
    for (int f = 0; f < s.body->faces; f++) {
        const uint32_t *corner = s.body->face + 3 * (size_t)f;
        float x[3], world[3], px[2], best = INFINITY;
        for (int k = 0; k < 3; k++) {
            x[k] = 0;
            for (int i = 0; i < 3; i++)
                x[k] += s.body->canonical->vertices_smpl[3 * corner[i] + (size_t)k] / 3;
        }
        const int32_t nearest = vertex_grid_nearest(body_canonical_grid(s.body), x, NULL);
        deform_to_picture(s.body, sheet.body, 1, x, &nearest, world);
        camera_project(&sheet.camera, 1, world, px, NULL);
        for (int i = 0; i < PICTURES; i++) { /* the point's own place in one of them */
            float posed[3], uv[2];
            deform_from_canonical(s.body, s.posed[i], 1, x, &nearest, posed);
            camera_project(&s.picture[i].camera, 1, posed, uv, NULL);
            best = fminf(best, fabsf(uv[0] + (float)left[i] - px[0]) + fabsf(uv[1] - px[1]));
        }
        if (sheet.body->seen[nearest]) assert_true(best < 4);
    }
    observed_sheet_free(&sheet);
    close_scene(&s);
}

/* One picture is used as it is, and nothing moves. */
static void one_picture_is_itself(void **state) {
    scene s;
    observed_sheet sheet;
    open_scene(&s);
    assert_ok(s.c, observed_sheet_create(s.c, &s.config, s.body, 1, s.picture + 1, &sheet));
    assert_int_equal(sheet.width, side[1]);
    assert_memory_equal(sheet.image, s.picture[1].image.data,
                        3 * (size_t)side[1] * (size_t)side[1] * sizeof(float));
    assert_memory_equal(&sheet.camera, &s.picture[1].camera, sizeof sheet.camera);
    assert_null(sheet.body->read_from);
    observed_sheet_free(&sheet);
    close_scene(&s);
}

static void what_cannot_be_read_is_refused(void **state) {
    scene s;
    observed_sheet sheet;
    observed_picture many[OBSERVED_PICTURES_MAX + 1];
    open_scene(&s);
    for (size_t i = 0; i < COUNT_OF(many); i++) many[i] = s.picture[0];
    assert_int_equal(observed_sheet_create(s.c, &s.config, s.body, COUNT_OF(many), many, &sheet),
                     SHERF_BAD_ARGUMENT);
    assert_int_equal(observed_sheet_create(s.c, &s.config, s.body, 0, many, &sheet), SHERF_BAD_ARGUMENT);
    s.picture[1].camera.K[0] = NAN;
    assert_int_not_equal(observed_sheet_create(s.c, &s.config, s.body, 2, s.picture, &sheet), SHERF_OK);
    s.picture[1].camera = s.picture[0].camera;
    assert_int_equal(observed_sheet_create(s.c, &s.config, s.body, 2, s.picture, &sheet), SHERF_MISMATCH);
    assert_ok(s.c, model_config_parse(s.c, "pixelnerf:own-small", &s.config));
    assert_int_equal(observed_sheet_create(s.c, &s.config, s.body, 2, many, &sheet), SHERF_UNSUPPORTED);
    assert_non_null(strstr(sherf_message(s.c), "pixelnerf takes one picture of a person, 2 were given"));
    close_scene(&s);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(vertices_are_read_where_they_are_seen),
        cmocka_unit_test(points_are_read_in_one_picture),
        cmocka_unit_test(one_picture_is_itself),
        cmocka_unit_test(what_cannot_be_read_is_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
