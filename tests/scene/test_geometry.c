/* Tests of cameras, rays, masks and the rasteriser, against the reference, brute force and analysis. */
#include "body_reference.h"

/* ---- cameras ---- */
static void projection_agrees(void **state) {
    body_reference *r = *state;
    int64_t rows;
    const int32_t *row = reference_ints(r, "vertex", &rows);
    float *x = mem_alloc(r->c, 6890, 3 * sizeof *x), *uv = mem_alloc(r->c, 6890, 2 * sizeof *uv);
    int32_t *visible = mem_alloc(r->c, 6890, sizeof *visible);
    body_vertices_world(r->body, r->observation, x);
    camera_project(&r->observation_camera, 6890, x, uv, NULL);
    assert_rows(uv, reference_floats(r, "project.vertices"), row, rows, 2, 1e-4, "pixels");
    assert_ok(r->c, vertices_visible(r->c, r->body, x, &r->observation_camera, visible));
    const uint8_t *expected = reference_find(r, "project.visible")->data;
    for (int v = 0; v < 6890; v++) assert_int_equal(visible[v], expected[v]);
    mem_free(x);
    mem_free(uv);
    mem_free(visible);
}

static void orbit_looks_at_the_centre(void **state) {
    context *c = ((body_reference *)*state)->c;
    const float centre[3] = {0.3f, -0.2f, 0.1f};
    for (int i = 0; i < 200; i++) {
        float azimuth = 0.2f * (float)i, elevation = 1.5f * (float)sin(i), uv[4], depth[2], at[3];
        float points[6] = {0.3f, -0.2f, 0.1f, 0.3f, 0.1f, 0.1f}; /* the centre, and above it */
        sherf_camera k;
        sherf_camera_orbit(centre, 2, azimuth, elevation, 0.8f, 320, 200, &k);
        assert_ok(c, camera_check(c, &k));
        camera_project(&k, 2, points, uv, depth);
        assert_true(fabsf(uv[0] - 160) < 0.01f && fabsf(uv[1] - 100) < 0.01f && fabsf(depth[0] - 2) < 1e-5f);
        assert_true(uv[3] < uv[1]); /* up is up */
        camera_position(&k, at);
        assert_true(fabs(at[0] - (0.3 + 2 * sin(azimuth) * cos(elevation))) < 1e-5);
        assert_true(fabs(at[1] - (-0.2 + 2 * sin(elevation))) < 1e-5);
        assert_true(fabs(at[2] - (0.1 + 2 * cos(azimuth) * cos(elevation))) < 1e-5);
    }
    sherf_camera k;
    sherf_camera_orbit(centre, 2, 0, 0, 0.8f, 320, 200, &k);
    float p[3] = {0.3f, -0.2f + 2 * (float)tan(0.4), 0.1f}, uv[2]; /* upwards by half the field of view */
    camera_project(&k, 1, p, uv, NULL);
    assert_true(fabsf(uv[1]) < 0.01f);
    camera_resize(&k, 160, 50);
    camera_project(&k, 1, centre, uv, NULL);
    assert_true(fabsf(uv[0] - 80) < 0.01f && fabsf(uv[1] - 25) < 0.01f);
}

static void bad_cameras_are_refused(void **state) {
    body_reference *r = *state;
    context *c = r->c;
    const float box[6] = {0, 0, 0, 1, 1, 1};
    static const struct {
        int field; /* the product K R T */
        float value;
        const char *says;
    } bad[] = {{0, NAN, "K is not finite"},      {13, INFINITY, "R is not finite"},
               {20, NAN, "T is not finite"},     {4, 0, "K is singular"},
               {9, 2, "R is not a rotation"},    {8, 2, "last row of K"},
               {10, 0.5f, "R is not a rotation"}};
    for (size_t i = 0; i < COUNT_OF(bad); i++) {
        sherf_camera k = r->target_camera;
        float *field = bad[i].field < 9    ? k.K + bad[i].field
                       : bad[i].field < 18 ? k.R + (bad[i].field - 9)
                                           : k.T_m + (bad[i].field - 18);
        *field = bad[i].value;
        ray_bundle *rays;
        assert_int_equal(rays_create(c, &k, box, box + 3, &rays), SHERF_BAD_ARGUMENT);
        assert_null(rays);
        if (!strstr(c->message, bad[i].says)) fail_msg("%s, not: %s", c->message, bad[i].says);
        raster *picture;
        assert_int_equal(raster_create(c, &k, 1, 0, NULL, 0, NULL, &picture), SHERF_BAD_ARGUMENT);
    }
    sherf_camera k = r->target_camera;
    k.width_px = 0;
    assert_int_equal(camera_check(c, &k), SHERF_BAD_ARGUMENT);
    k.width_px = 100000;
    assert_int_equal(camera_check(c, &k), SHERF_BAD_ARGUMENT);
}

/* ---- rays ---- */
static void rays_agree(void **state) {
    body_reference *r = *state;
    int64_t rows;
    const int32_t *row = reference_ints(r, "ray", &rows);
    ray_bundle *rays = target_rays(r, &r->target_camera);
    assert_memory_equal(rays->direction, reference_floats(r, "rays.direction.0"), 48 * sizeof(float));
    assert_rows(rays->near, reference_floats(r, "rays.near"), row, rows, 1, 5e-7, "near");
    assert_rows(rays->far, reference_floats(r, "rays.far"), row, rows, 1, 5e-7, "far");
    assert_memory_equal(rays->at_box, reference_find(r, "rays.at_box")->data, 128 * 128);
    uint8_t *mask = mem_alloc(r->c, 128, 128);
    float min[3], max[3];
    body_world_box(r->body, r->target, min, max);
    box_ray_mask(&r->target_camera, min, max, mask);
    assert_memory_equal(mask, rays->at_box, 128 * 128);
    mem_free(mask);
    rays_free(rays);
}

/* Sixteen columns at a time give the same bits as one at a time, including rays along the axes, from inside
 * the box and missing it. */
static void rays_are_exact(void **state) {
    context *c = ((body_reference *)*state)->c;
    const float min[3] = {-0.4f, -0.9f, -0.25f}, max[3] = {0.5f, 0.8f, 0.2f}, centre[3] = {0};
    int64_t met = 0, all = 0;
    for (int i = 0; i < 60; i++) {
        const int width = 3 + i * 7 % 64, height = 5 + i % 9;
        const float distance = i % 3 == 0 ? 0.1f : i % 3 == 1 ? 1.5f : 4;
        sherf_camera k;
        ray_bundle *rays[2];
        sherf_camera_orbit(centre, distance, i < 8 ? (float)i * 1.57079633f : 0.37f * (float)i,
                           i < 8 ? 0 : (float)sin(i), 1.2f, width, height, &k);
        for (int run = 0; run < 2; run++) {
            if (run)
                test_isa_restore();
            else
                test_isa(ISA_PLAIN);
            assert_ok(c, rays_create(c, &k, min, max, &rays[run]));
        }
        const size_t n = (size_t)width * (size_t)height;
        assert_memory_equal(rays[0]->direction, rays[1]->direction, 3 * n * sizeof(float));
        assert_memory_equal(rays[0]->near, rays[1]->near, n * sizeof(float));
        assert_memory_equal(rays[0]->far, rays[1]->far, n * sizeof(float));
        assert_memory_equal(rays[0]->at_box, rays[1]->at_box, n);
        for (size_t p = 0; p < n; p++) met += rays[0]->at_box[p], all++;
        rays_free(rays[0]);
        rays_free(rays[1]);
    }
    assert_true(met > all / 4 && met < all * 3 / 4);
}

/* A box is convex, so the rays of a row that hit it are adjacent. The paper's method misses some of them. */
static int rows_with_holes(const ray_bundle *r) {
    int holes = 0;
    for (int y = 0; y < r->height; y++) {
        const uint8_t *met = r->at_box + (size_t)y * (size_t)r->width;
        int begun = 0;
        for (int x = 0; x < r->width; x++) begun += met[x] && (x == 0 || !met[x - 1]);
        holes += begun > 1;
    }
    return holes;
}

static void repaired_rays_have_no_holes(void **state) {
    context *c = ((body_reference *)*state)->c;
    const float min[3] = {-0.43f, -0.91f, -0.27f}, max[3] = {0.51f, 0.83f, 0.22f}, centre[3] = {0, 0.1f, 0};
    int before = 0, after = 0;
    for (int i = 0; i < 6; i++) {
        sherf_camera k;
        ray_bundle *r, *whole;
        sherf_camera_orbit(centre, 3.5f, 1.57079633f * (float)(i % 4), i < 4 ? 0.087f : 0.3f, 0.52f, 768, 768,
                           &k);
        assert_ok(c, rays_create(c, &k, min, max, &r));
        assert_ok(c, rays_create(c, &k, min, max, &whole));
        rays_repair(c, whole, min, max);
        before += rows_with_holes(r);
        after += rows_with_holes(whole);
        for (size_t n = 0; n < (size_t)768 * 768; n++) {
            if (!whole->at_box[n]) assert_true(whole->near[n] == 0 && whole->far[n] == 1);
            if (r->at_box[n] && r->far[n] - r->near[n] > 1e-3f)
                assert_true(whole->near[n] == r->near[n] && whole->far[n] == r->far[n]);
            if (whole->at_box[n] && !r->at_box[n])
                assert_true(whole->near[n] > 2 && whole->near[n] < whole->far[n] && whole->far[n] < 5);
        }
        rays_free(r);
        rays_free(whole);
    }
    if (before == 0 || after != 0) fail_msg("%d rows with holes, %d when repaired", before, after);
}

/* ---- rasteriser ---- */
/* A slanted plane in perspective: depth and barycentric coordinates at every pixel; one face begins behind
 * the camera and extends in front of it. */
static void raster_is_analytic(void **state) {
    context *c = ((body_reference *)*state)->c;
    sherf_camera k = {.width_px = 60, .height_px = 40, .K = {50, 0, 29.5f, 0, 50, 19.5f, 0, 0, 1}};
    k.R[0] = k.R[4] = k.R[8] = 1;
    const float v[9] = {-3, 1, -2, 3, 1, -1, 0.5f, 1, 30}; /* the ground, y = 1, from behind to far ahead */
    const uint32_t f[3] = {0, 1, 2};
    for (int s = 1; s <= 3; s++) {
        raster *r;
        int inside = 0;
        assert_ok(c, raster_create(c, &k, s, 3, v, 1, f, &r));
        assert_int_equal(r->width, 60 * s);
        for (int j = 0; j < r->height; j++)
            for (int i = 0; i < r->width; i++) {
                size_t n = (size_t)(j * r->width + i);
                double x = ((i + 0.5) / s - 0.5 - 29.5) / 50, y = ((j + 0.5) / s - 0.5 - 19.5) / 50,
                       z = 1 / y;
                double p[3] = {x * z, 1, z}, b[3], det = 6 * 32 - 1 * 3.5; /* in the plane's x, z */
                b[1] = ((p[0] + 3) * 32 - (p[2] + 2) * 3.5) / det;
                b[2] = (6 * (p[2] + 2) - 1 * (p[0] + 3)) / det;
                b[0] = 1 - b[1] - b[2];
                double smallest = fmin(b[0], fmin(b[1], b[2]));
                if (y > 0 && fabs(smallest) < 1e-9) continue;
                bool hit = y > 0 && smallest > 0;
                assert_int_equal(r->face[n], hit ? 0 : -1);
                if (!hit) {
                    assert_true(isinf(r->depth[n]));
                    continue;
                }
                inside++;
                assert_true(fabs(r->depth[n] - z) < 1e-5 * z);
                for (int a = 0; a < 3; a++)
                    assert_true(fabs(r->barycentric[3 * n + (size_t)a] - b[a]) < 1e-5);
            }
        assert_true(inside > 300 * s * s);
        raster_free(r);
    }
}

/* The body: the surface at each vertex's pixel is not behind the vertex, there are no holes inside, and the
 * result is the same for any number of threads. */
static void raster_draws_the_body(void **state) {
    body_reference *r = *state;
    float *x = mem_alloc(r->c, 6890, 3 * sizeof *x), *uv = mem_alloc(r->c, 6890, 3 * sizeof *uv);
    body_vertices_world(r->body, r->target, x);
    camera_project(&r->target_camera, 6890, x, uv, uv + 2 * 6890);
    raster *one, *two;
    r->c->threads = 1;
    assert_ok(r->c, raster_create(r->c, &r->target_camera, 2, 6890, x, r->body->faces, r->body->face, &one));
    r->c->threads = 2;
    assert_ok(r->c, raster_create(r->c, &r->target_camera, 2, 6890, x, r->body->faces, r->body->face, &two));
    assert_memory_equal(one->depth, two->depth, 256 * 256 * sizeof(float));
    assert_memory_equal(one->face, two->face, 256 * 256 * sizeof(int32_t));
    int seen = 0;
    for (size_t n = 0; n < 256 * 256; n++) {
        if (one->face[n] < 0) continue;
        double depth = 0, sum = 0;
        for (int k = 0; k < 3; k++) {
            depth += one->barycentric[3 * n + (size_t)k] *
                     uv[2 * 6890 + r->body->face[3 * (size_t)one->face[n] + (size_t)k]];
            sum += one->barycentric[3 * n + (size_t)k];
        }
        assert_true(fabs(sum - 1) < 1e-5 && fabs(depth - one->depth[n]) < 1e-4);
        seen++;
    }
    assert_in_range(seen, 3000, 20000);
    uint32_t bad[3] = {0, 1, 6890};
    raster *none;
    assert_int_equal(raster_create(r->c, &r->target_camera, 1, 6890, x, 1, bad, &none), SHERF_BAD_ARGUMENT);
    assert_int_equal(raster_create(r->c, &r->target_camera, 0, 6890, x, 0, bad, &none), SHERF_BAD_ARGUMENT);
    raster_free(one);
    raster_free(two);
    mem_free(x);
    mem_free(uv);
}

/* ---- every allocation failing in turn ---- */
static sherf_status draw_body(body_reference *r, const sherf_camera *small, const ray_bundle *rays) {
    raster *picture = NULL;
    const sherf_status status = raster_create(r->c, small, 1, 6890, r->target->vertices_smpl, r->body->faces,
                                              r->body->face, &picture);
    raster_free(picture);
    return status;
}

static void allocations_may_fail(void **state) {
    target_no_memory(*state, draw_body, 10);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(projection_agrees),       cmocka_unit_test(orbit_looks_at_the_centre),
        cmocka_unit_test(bad_cameras_are_refused), cmocka_unit_test(rays_agree),
        cmocka_unit_test(rays_are_exact),          cmocka_unit_test(repaired_rays_have_no_holes),
        cmocka_unit_test(raster_is_analytic),      cmocka_unit_test(raster_draws_the_body),
        cmocka_unit_test(allocations_may_fail)};
    return cmocka_run_group_tests(tests, body_reference_open, body_reference_close);
}
