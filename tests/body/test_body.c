/* Tests of the body model: posing, deformation and the nearest vertex against the reference and by
 * properties, and refused input. */
#include "body_reference.h"

static void vertices_agree(void **state) {
    body_reference *r = *state;
    int64_t rows;
    const int32_t *row = reference_ints(r, "vertex", &rows);
    float *x = mem_alloc(r->c, (size_t)r->body->vertices, 3 * sizeof *x);
    body_vertices_world(r->body, r->target, x);
    assert_rows(x, reference_floats(r, "smpl.target.vertices"), row, rows, 3, 1e-6, "target");
    body_vertices_world(r->body, r->observation, x);
    assert_rows(x, reference_floats(r, "smpl.observation.vertices"), row, rows, 3, 1e-6, "observation");
    assert_rows(r->body->canonical->vertices_smpl, reference_floats(r, "smpl.canonical.vertices"), row, rows,
                3, 1e-6, "canonical");
    deform_to_canonical(r->body, r->observation, r->body->vertices, r->observation->vertices_smpl, NULL, NULL,
                        x, NULL);
    assert_rows(x, reference_floats(r, "deform.observation_vertices"), row, rows, 3, 2e-6, "to canonical");
    float bounds[6];
    static const int32_t both[2] = {0, 1};
    body_canonical_bounds_z(r->body, bounds, bounds + 3);
    assert_rows(bounds, reference_floats(r, "canonical.bounds"), both, 2, 3, 1e-6, "bounds");
    mem_free(x);
}

static void poses_agree_with_public_function(void **state) {
    body_reference *r = *state;
    sherf_pose pose;
    sherf_pose_identity(&pose);
    memcpy(pose.poses_rad, reference_floats(r, "in.target.poses"), sizeof pose.poses_rad);
    memcpy(pose.shapes, reference_floats(r, "in.target.shapes"), sizeof pose.shapes);
    memcpy(pose.R, reference_floats(r, "in.target.R"), sizeof pose.R);
    memcpy(pose.Th_m, reference_floats(r, "in.target.Th"), sizeof pose.Th_m);
    assert_int_equal(sherf_body_vertex_count(r->body), 6890);
    assert_int_equal(sherf_body_face_count(r->body), 13280);
    float *x = mem_alloc(r->c, 6890, 6 * sizeof *x), joints[72];
    assert_ok(r->c, sherf_body_pose(r->c, r->body, &pose, x, joints));
    body_vertices_world(r->body, r->target, x + 3 * 6890);
    assert_memory_equal(x, x + 3 * 6890, 3 * 6890 * sizeof *x);
    for (int i = 0; i < 72; i++) assert_true(fabsf(joints[i]) < 2);
    pose.poses_rad[7] = NAN;
    assert_int_equal(sherf_body_pose(r->c, r->body, &pose, x, NULL), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(r->c->message, "joint 2"));
    pose.poses_rad[7] = 0;
    pose.R[4] = 2;
    assert_int_equal(sherf_body_pose(r->c, r->body, &pose, x, NULL), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(r->c->message, "not a rotation"));
    mem_free(x);
}

/* A round trip by the same vertex is the identity. */
static void deformation_round_trip(void **state) {
    body_reference *r = *state;
    enum { N = 2000 };
    float x[3 * N], y[3 * N], z[3 * N];
    int32_t nearest[N];
    for (int i = 0; i < N; i++) {
        nearest[i] = (int32_t)random_below(5, (uint64_t)i, r->body->vertices);
        for (int k = 0; k < 3; k++)
            x[3 * i + k] = r->target->vertices_smpl[3 * nearest[i] + k] +
                           0.05f * (float)(2 * random_uniform(6, (uint64_t)(3 * i + k)) - 1);
    }
    deform_to_canonical(r->body, r->target, N, x, NULL, nearest, y, NULL);
    deform_from_canonical(r->body, r->target, N, y, nearest, z);
    for (int i = 0; i < N; i++)
        for (int k = 0; k < 3; k++) { /* back in SMPL space: (world - Th) R */
            double back = 0;
            for (int a = 0; a < 3; a++)
                back += ((double)z[3 * i + a] - r->target->Th[a]) * r->target->R[3 * a + k];
            assert_true(fabs(back - x[3 * i + k]) < 3e-6);
        }
    /* a vertex goes to its canonical place, up to the difference of the shapes */
    float *v = mem_alloc(r->c, 6890, 3 * sizeof *v);
    deform_to_canonical(r->body, r->body->canonical, 6890, r->body->canonical->vertices_smpl, NULL, NULL, v,
                        NULL);
    for (int i = 0; i < 3 * 6890; i++)
        assert_true(fabsf(v[i] - r->body->canonical->vertices_smpl[i]) < 1e-6f);
    mem_free(v);
}

/* The neighbours are exactly the edges of all faces, once in each direction. */
static void neighbours_share_an_edge(void **state) {
    body_reference *r = *state;
    const body_model *body = r->body;
    const int32_t *first = body->neighbour_first, *list = body->neighbour;
    uint8_t *met = mem_zero(r->c, (size_t)first[body->vertices], 1);
    assert_non_null(met);
    assert_int_equal(first[0], 0);
    for (int v = 0; v < body->vertices; v++) {
        assert_true(first[v] <= first[v + 1] && first[v + 1] - first[v] <= 32);
        for (int32_t i = first[v]; i < first[v + 1]; i++) {
            assert_true(list[i] >= 0 && list[i] < body->vertices && list[i] != v);
            for (int32_t k = first[v]; k < i; k++) assert_true(list[k] != list[i]);
        }
    }
    for (int i = 0; i < 6 * body->faces; i++) {
        const int corner = i / 2, next = corner / 3 * 3 + (corner + 1) % 3;
        const int32_t a = (int32_t)body->face[i % 2 ? next : corner],
                      b = (int32_t)body->face[i % 2 ? corner : next];
        int32_t k = first[a];
        while (k < first[a + 1] && list[k] != b) k++;
        assert_true(k < first[a + 1]);
        met[k] = 1;
    }
    for (int32_t i = 0; i < first[body->vertices]; i++) assert_true(met[i]);
    mem_free(met);
}

/* The mean distance between canonical places of two points a hundredth of a millimetre apart, between which
 * the nearest vertex changes to a neighbour, up to 4 cm above the skin. */
static double jump(body_reference *r, float blend_m, int *pairs) {
    posed_body *p = r->target;
    vertex_grid *grid;
    double sum = 0;
    const float before = p->blend_m;
    p->blend_m = blend_m;
    *pairs = 0;
    assert_ok(r->c, vertex_grid_create(r->c, r->body->vertices, p->vertices_smpl, 0, &grid));
    for (int i = 0; i < 3000; i++) {
        const int v = (int)random_below(21, (uint64_t)i, r->body->vertices);
        float x[6], y[6];
        for (int k = 0; k < 6; k++)
            x[k] = p->vertices_smpl[3 * v + k % 3] +
                   0.03f * (float)(2 * random_uniform(22, (uint64_t)(6 * i + k)) - 1);
        int32_t nearest[2] = {vertex_grid_nearest(grid, x, NULL), vertex_grid_nearest(grid, x + 3, NULL)};
        if (nearest[0] == nearest[1]) continue;
        for (int halving = 0; halving < 13; halving++) {
            float middle[3];
            for (int k = 0; k < 3; k++) middle[k] = (x[k] + x[3 + k]) / 2;
            const int32_t found = vertex_grid_nearest(grid, middle, NULL);
            const int side = found != nearest[0];
            memcpy(x + 3 * side, middle, sizeof middle);
            nearest[side] = found;
        }
        bool neighbours = false;
        for (int32_t k = r->body->neighbour_first[nearest[0]]; k < r->body->neighbour_first[nearest[0] + 1];
             k++)
            neighbours |= r->body->neighbour[k] == nearest[1];
        if (!neighbours) continue;
        deform_to_canonical(r->body, p, 2, x, NULL, nearest, y, NULL);
        sum += sqrt(pow(y[0] - y[3], 2) + pow(y[1] - y[4], 2) + pow(y[2] - y[5], 2));
        ++*pairs;
    }
    vertex_grid_free(grid);
    p->blend_m = before;
    return sum / *pairs;
}

static void blended_maps_hardly_jump(void **state) {
    body_reference *r = *state;
    int pairs;
    const double paper = jump(r, 0, &pairs), blended = jump(r, 0.025f, &pairs);
    print_message("mean jump %.3g mm, blended %.3g mm, of %d\n", 1e3 * paper, 1e3 * blended, pairs);
    assert_true(pairs > 500 && blended < paper / 3);
    /* at a vertex far from its neighbours, that vertex's transformation is used; without `nearest` it always
     * is */
    float y[3], z[3];
    const int32_t own = 100;
    r->target->blend_m = 1e-4f;
    deform_to_canonical(r->body, r->target, 1, r->target->vertices_smpl + 300, NULL, &own, y, NULL);
    r->target->blend_m = 0;
    deform_to_canonical(r->body, r->target, 1, r->target->vertices_smpl + 300, NULL, &own, z, NULL);
    assert_memory_equal(y, z, sizeof y);
}

static int32_t brute(const float *v, int n, const float p[3], float radius, float *best) {
    int32_t found = -1;
    *best = radius > 0 ? nextafterf(radius * radius, 0) : INFINITY;
    for (int i = 0; i < n; i++) {
        float dx = v[3 * i] - p[0], dy = v[3 * i + 1] - p[1], dz = v[3 * i + 2] - p[2];
        float d2 = (dx * dx + dy * dy) + dz * dz;
        if (d2 < *best || (d2 == *best && found < 0)) *best = d2, found = i;
    }
    return found;
}

static void check_grid(context *c, const float *v, int n, float radius, float reach, float voxel,
                       double spread) {
    vertex_grid *g;
    assert_ok(c, vertex_grid_create(c, n, v, radius, &g));
    if (reach > 0) assert_ok(c, vertex_grid_refine(c, g, reach, voxel));
    for (int i = 0; i < 1500; i++) {
        int near = (int)random_below(1, (uint64_t)i, n);
        float p[3], d2, expected_d2;
        for (int k = 0; k < 3; k++)
            p[k] = v[3 * near + k] + (float)(spread * random_normal(2, (uint64_t)(3 * i + k)));
        if (i % 10 == 0)
            memcpy(p, v + 3 * near, sizeof p); /* at a vertex: ties between coinciding vertices */
        int32_t expected = brute(v, n, p, radius, &expected_d2);
        int32_t found = vertex_grid_nearest_from(g, p, (int32_t)random_below(3, (uint64_t)i, n), &d2);
        if (found != expected || (found >= 0 && d2 != expected_d2))
            fail_msg("n %d radius %g reach %g: %d at %.9g, should be %d at %.9g", n, radius, reach, found, d2,
                     expected, expected_d2);
        assert_int_equal(vertex_grid_nearest(g, p, NULL), expected);
    }
    const float no_number[3] = {NAN, 0, 0};
    assert_int_equal(vertex_grid_nearest(g, no_number, NULL), -1);
    vertex_grid_free(g);
}

/* Every instruction set blends to the same bits, also maps of which some lead to other places. */
static void instruction_sets_blend_alike(void **state) {
    enum { N = 3000 };
    body_reference *r = *state;
    posed_body *p = r->target;
    const isa_level isa = p->isa;
    const size_t V = (size_t)r->body->vertices;
    float x[3 * N], d[3 * N], out[4][3 * N];
    int32_t nearest[N];
    float *apart = mem_alloc(r->c, V, 12 * sizeof *apart);
    for (int i = 0; i < N; i++) {
        nearest[i] = (int32_t)random_below(7, (uint64_t)i, r->body->vertices);
        for (int k = 0; k < 3; k++) {
            x[3 * i + k] = p->vertices_smpl[3 * nearest[i] + k] +
                           (float)(0.04 * random_normal(8, (uint64_t)(3 * i + k)));
            d[3 * i + k] = (float)random_normal(9, (uint64_t)(3 * i + k));
        }
    }
    memcpy(apart, p->from_canonical, V * 12 * sizeof *apart);
    for (size_t v = 0; v < V; v += 3) apart[12 * v + 3] += 0.5f; /* metres */
    p->blend_m = 0.025f;
    for (int plain = 0; plain < 2; plain++) {
        p->isa = plain ? ISA_PLAIN : isa;
        deform_to_canonical(r->body, p, N, x, d, nearest, out[plain], out[2 + plain]);
    }
    assert_memory_equal(out[0], out[1], sizeof out[0]);
    assert_memory_equal(out[2], out[3], sizeof out[0]);
    p->read_from = apart;
    for (int plain = 0; plain < 2; plain++) {
        p->isa = plain ? ISA_PLAIN : isa;
        deform_to_picture(r->body, p, N, x, nearest, out[plain]);
    }
    assert_memory_equal(out[0], out[1], sizeof out[0]);
    p->read_from = NULL;
    p->isa = isa;
    p->blend_m = 0;
    mem_free(apart);
}

static void nearest_is_exact(void **state) {
    body_reference *r = *state;
    const float *v = r->body->canonical->vertices_smpl;
    float few[3 * 200];
    for (int i = 0; i < 600; i++) /* coarse values: many ties */
        few[i] = 0.05f * (float)random_below(4, (uint64_t)i, 12);
    for (int level = ISA_PLAIN; level <= ISA_AVX512; level++) {
        if (!test_isa((isa_level)level)) continue;
        check_grid(r->c, v, r->body->vertices, 0, 0, 0, 0.03);
        check_grid(r->c, v, r->body->vertices, 0, 0.06f, 0.02f, 0.03);
        check_grid(r->c, v, r->body->vertices, 0.05f, 0.05f, 0.02f, 0.03);
        check_grid(r->c, v, r->body->vertices, 0.05f, 0.05f, 0.04f, 0.03);
        check_grid(r->c, v, r->body->vertices, 0.05f, 0, 0, 0.03);
        check_grid(r->c, few, 200, 0, 0.1f, 0.02f, 0.05);
        check_grid(r->c, few, 200, 0.1f, 0, 0, 0.5);
        check_grid(r->c, few, 1, 0, 0.1f, 0.02f, 100);
        check_grid(r->c, few, 2, 0, 0, 0, 0.01);
    }
    test_isa_restore();
    vertex_grid *g;
    few[4] = INFINITY;
    assert_int_equal(vertex_grid_create(r->c, 200, few, 0, &g), SHERF_BAD_ARGUMENT);
    assert_null(g);
}

static void rotations_round_trip(void **state) {
    for (int i = 0; i < 2000; i++) {
        float a[3], R[9], b[3], S[9];
        double norm = 0, angle = i % 5 == 0 ? M_PI - 1e-5 * i : M_PI * random_uniform(8, (uint64_t)i);
        if (i % 7 == 0) angle = 1e-6 * i;
        for (int k = 0; k < 3; k++) {
            a[k] = (float)random_normal(7, (uint64_t)(3 * i + k));
            norm += a[k] * a[k];
        }
        for (int k = 0; k < 3; k++) a[k] = (float)(a[k] * angle / sqrt(norm));
        rodrigues(a, R);
        assert_true(rotation_is_valid(R));
        rotation_to_axis_angle(R, b);
        rodrigues(b, S);
        for (int k = 0; k < 9; k++) assert_true(fabsf(R[k] - S[k]) < 1e-6f);
    }
    const float quarter[3] = {0, 0, (float)M_PI_2}, expected[9] = {0, -1, 0, 1, 0, 0, 0, 0, 1};
    float R[9];
    rodrigues(quarter, R);
    for (int k = 0; k < 9; k++) assert_true(fabsf(R[k] - expected[k]) < 1e-7f);
}

static void normals_point_out(void **state) {
    body_reference *r = *state;
    /* a cube's corner: the mean of three unit normals, whatever the faces' areas */
    float *n = mem_alloc(r->c, 6890, 3 * sizeof *n);
    assert_ok(r->c, body_normals(r->c, r->body, r->body->v_template, n));
    for (int v = 0; v < 6890; v++) {
        double length = 0;
        for (int k = 0; k < 3; k++) length += (double)n[3 * v + k] * n[3 * v + k];
        assert_true(fabs(length - 1) < 1e-5);
    }
    mem_free(n);
}

static void bad_bodies_are_refused(void **state) {
    body_reference *r = *state;
    context *c = r->c;
    tubeman_arrays own;
    body_model *body;
    assert_ok(c, tubeman_arrays_create(c, &own));
    body_arrays a = own.arrays;
    double *w = own.weights, *v = own.v_template;
    int64_t *f = own.face;
    const double w0 = w[0], v0 = v[5];
    w[0] += 0.1;
    assert_int_equal(body_create(c, &a, &body), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "vertex 0"));
    w[0] = w0, v[5] = NAN;
    assert_int_equal(body_create(c, &a, &body), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "v_template"));
    v[5] = v0, f[7] = 6890;
    assert_int_equal(body_create(c, &a, &body), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "face 2"));
    f[7] = 0;
    int64_t parent[BODY_JOINTS];
    memcpy(parent, a.parent, sizeof parent);
    a.parent = parent;
    parent[4] = 9;
    assert_int_equal(body_create(c, &a, &body), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "joint 4"));
    parent[4] = 1;
    a.vertices = 0;
    assert_int_equal(body_create(c, &a, &body), SHERF_BAD_FILE);
    a.vertices = 6890;
    assert_ok(c, body_create(c, &a, &body));
    assert_true(body->fingerprint != r->body->fingerprint); /* face 2 is different */
    sherf_body_free(body);
    tubeman_arrays_free(&own);
}

static void allocations_may_fail(void **state) {
    body_reference *r = *state;
    context *c = r->c;
    tubeman_arrays own;
    assert_ok(c, tubeman_arrays_create(c, &own));
    body_arrays a = own.arrays;
    a.vertices = 40, a.faces = 20; /* the first 40 vertices: quick */
    for (int j = 0; j < BODY_JOINTS; j++)
        memmove(own.regressor + 40 * j, a.regressor + (size_t)6890 * (size_t)j, 40 * sizeof(double));
    size_t live = mem_live();
    for (long n = 0;; n++) {
        body_model *body;
        mem_fail_after(n);
        sherf_status status = body_create(c, &a, &body);
        mem_fail_after(-1);
        if (status == SHERF_OK) {
            sherf_body_free(body);
            assert_true(n > 10);
            break;
        }
        assert_int_equal(status, SHERF_NO_MEMORY);
        assert_null(body);
        assert_int_equal(mem_live(), live);
    }
    assert_int_equal(mem_live(), live);
    tubeman_arrays_free(&own);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(vertices_agree),           cmocka_unit_test(poses_agree_with_public_function),
        cmocka_unit_test(deformation_round_trip),   cmocka_unit_test(neighbours_share_an_edge),
        cmocka_unit_test(blended_maps_hardly_jump), cmocka_unit_test(instruction_sets_blend_alike),
        cmocka_unit_test(nearest_is_exact),         cmocka_unit_test(rotations_round_trip),
        cmocka_unit_test(normals_point_out),        cmocka_unit_test(bad_bodies_are_refused),
        cmocka_unit_test(allocations_may_fail)};
    return cmocka_run_group_tests(tests, body_reference_open, body_reference_close);
}
