/* Tests of the shipped open body, assets/body.safetensors: skeleton, rest pose, weights, shapes, volume at
 * bent joints; and of the builder, with a source made of a few balls. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "support.h"
#include "data/data.h"
#include "synth/body/components.h"
#include "synth/body/open_body.h"

static const char path[] = "../assets/body.safetensors";

typedef struct {
    context *c;
    body_model *body;
    safetensors *file;
} shipped;

static int open_shipped(void **state) {
    static shipped s;
    s.c = test_context();
    assert_ok(s.c, body_load(s.c, path, &s.body));
    assert_ok(s.c, safetensors_read(s.c, path, &s.file));
    *state = &s;
    return 0;
}

static int close_shipped(void **state) {
    shipped *s = *state;
    safetensors_free(s->file);
    sherf_body_free(s->body);
    sherf_context_free(s->c);
    return 0;
}

static void skeleton(void **state) {
    shipped *s = *state;
    const body_model *body = s->body;
    const double(*J)[3] = body->joint_template;
    static const int pairs[][2] = {{1, 2},   {4, 5},   {7, 8},   {10, 11}, {13, 14},
                                   {16, 17}, {18, 19}, {20, 21}, {22, 23}};
    for (int j = 0; j < BODY_JOINTS; j++) assert_int_equal(body->parent[j], tpose_parent[j]);
    for (size_t i = 0; i < COUNT_OF(pairs); i++) {
        const double *left = J[pairs[i][0]], *right = J[pairs[i][1]];
        assert_true(left[0] > 0.03); /* left is +x */
        assert_float_equal(left[0], -right[0], 3e-3);
        assert_float_equal(left[1], right[1], 3e-3);
        assert_float_equal(left[2], right[2], 3e-3);
    }
    static const int middle[] = {0, 3, 6, 9, 12, 15};
    for (size_t i = 0; i < COUNT_OF(middle); i++) {
        assert_float_equal(J[middle[i]][0], 0, 3e-3);
        if (i) assert_true(J[middle[i]][1] > J[middle[i - 1]][1] + 0.03); /* one above the other */
    }
    /* a T: elbows and wrists have the height and depth of the shoulders */
    for (int j = 18; j <= 21; j++)
        for (int k = 1; k < 3; k++) assert_float_equal(J[j][k], J[16][k], 0.015);
    /* joints are SMPL's neutral ones, within the variation of people, so SMPL's poses mean the same */
    static const double smpl[][4] = {{0, 0, -0.223, 0.028},   {1, 0.07, -0.31, 0.01}, {4, 0.10, -0.69, 0},
                                     {7, 0.09, -1.09, -0.03}, {12, 0, 0.29, -0.02},   {16, 0.17, 0.23, -0.02},
                                     {18, 0.43, 0.21, -0.04}, {20, 0.68, 0.22, -0.04}};
    for (size_t i = 0; i < COUNT_OF(smpl); i++)
        for (int k = 0; k < 3; k++) assert_float_equal(J[(int)smpl[i][0]][k], smpl[i][1 + k], 0.11);
    /* toes are in front, and the face is in front of the head joint */
    assert_true(J[10][2] > J[7][2] + 0.08);
}

static void weights(void **state) {
    shipped *s = *state;
    const body_model *body = s->body;
    bool used[BODY_JOINTS] = {0};
    for (int v = 0; v < body->vertices; v++) {
        double sum = 0;
        int count = 0;
        for (int j = 0; j < BODY_JOINTS; j++) {
            float w = body->weights[(size_t)v * BODY_JOINTS + j];
            assert_true(w >= 0);
            sum += w;
            count += w > 0;
            used[j] |= w > 0.5f;
        }
        assert_float_equal(sum, 1, 1e-5);
        assert_true(count <= 8);
        /* the left hand does not depend on the right one */
        const float *w = body->weights + (size_t)v * BODY_JOINTS;
        assert_true(w[20] + w[22] == 0 || w[21] + w[23] == 0);
    }
    for (int j = 0; j < BODY_JOINTS; j++)
        if (!used[j]) fail_msg("%s moves nothing", tpose_joint_names[j]);
    for (int j = 0; j < BODY_JOINTS; j++) {
        double sum = 0;
        for (int v = 0; v < body->vertices; v++)
            sum += body->regressor[(size_t)j * (size_t)body->vertices + (size_t)v];
        assert_float_equal(sum, 1, 1e-4);
    }
}

static double stature(const body_model *body, const float shape[BODY_SHAPES], double *volume_l) {
    float low = INFINITY, high = -INFINITY, *v = malloc((size_t)body->vertices * 3 * sizeof *v);
    for (size_t i = 0; i < 3 * (size_t)body->vertices; i++) {
        v[i] = body->v_template[i];
        for (int k = 0; k < BODY_SHAPES; k++) v[i] += shape[k] * body->shapedirs[i * BODY_SHAPES + k];
        if (i % 3 == 1 && v[i] < low) low = v[i];
        if (i % 3 == 1 && v[i] > high) high = v[i];
    }
    *volume_l = 1000 * mesh_volume(body->faces, body->face, v);
    free(v);
    return (double)high - (double)low;
}

static void shapes(void **state) {
    shipped *s = *state;
    float shape[BODY_SHAPES] = {0};
    double litres, mean = stature(s->body, shape, &litres);
    assert_true(mean > 1.6 && mean < 1.75); /* between the average woman and man */
    assert_true(litres > 50 && litres < 80);
    const char *kept = safetensors_metadata(s->file, "shape_variance_kept");
    assert_true(kept && atof(kept) >= 0.95);
    assert_string_equal(safetensors_metadata(s->file, "licence"), "CC0-1.0");
    for (int k = 0; k < BODY_SHAPES; k++)
        for (int sign = -1; sign <= 1; sign += 2) {
            float one[BODY_SHAPES] = {0};
            one[k] = 3.f * (float)sign;
            double h = stature(s->body, one, &litres);
            assert_true(h > 1.25 && h < 2.1);
            assert_true(litres > 15 && litres < 130);
        }
    /* components are orthogonal and decrease in length */
    double last = INFINITY;
    for (int a = 0; a < BODY_SHAPES; a++)
        for (int b = 0; b <= a; b++) {
            double dot = 0;
            for (size_t i = 0; i < 3 * (size_t)s->body->vertices; i++)
                dot += (double)s->body->shapedirs[i * BODY_SHAPES + (size_t)a] *
                       s->body->shapedirs[i * BODY_SHAPES + (size_t)b];
            if (a == b) {
                assert_true(dot > 0 && dot <= last);
                last = dot;
            } else {
                assert_true(fabs(dot) < 1e-4 * last);
            }
        }
    /* betas can be recovered from the mesh */
    float want[BODY_SHAPES] = {1.5f, -0.5f, 0.3f, 0, 0, 2, 0, 0, -1, 1}, got[BODY_SHAPES];
    float *v = malloc((size_t)s->body->vertices * 3 * sizeof *v);
    for (size_t i = 0; i < 3 * (size_t)s->body->vertices; i++) {
        v[i] = s->body->v_template[i];
        for (int k = 0; k < BODY_SHAPES; k++) v[i] += want[k] * s->body->shapedirs[i * BODY_SHAPES + k];
    }
    assert_ok(s->c, open_body_project(s->c, s->body, v, got));
    for (int k = 0; k < BODY_SHAPES; k++) assert_float_equal(got[k], want[k], 1e-2);
    free(v);
}

/* The surface is closed, and every corner has UVs. */
static void surface(void **state) {
    shipped *s = *state;
    const body_model *body = s->body;
    const safetensor *uv = safetensors_find(s->file, "uv"), *f_uv = safetensors_find(s->file, "f_uv");
    assert_non_null(uv);
    assert_non_null(f_uv);
    assert_int_equal(f_uv->dim[0], body->faces);
    for (int64_t i = 0; i < 3 * (int64_t)body->faces; i++) {
        int32_t at = ((const int32_t *)f_uv->data)[i];
        assert_true(at >= 0 && at < uv->dim[0]);
        for (int k = 0; k < 2; k++) {
            float x = ((const float *)uv->data)[2 * at + k];
            assert_true(x >= 0 && x <= 1);
        }
    }
    /* directed edges cancel: the sum of their vectors' hashes is 0 if each occurs once in either direction */
    uint64_t sum = 0;
    for (int f = 0; f < body->faces; f++)
        for (int i = 0; i < 3; i++) {
            uint64_t a = body->face[3 * f + i], b = body->face[3 * f + (i + 1) % 3];
            sum += a < b ? splitmix64(a << 32 | b) : -splitmix64(b << 32 | a);
        }
    assert_int_equal(sum, 0);
}

/* The kept volume at a joint: the volume of the cone from the joint to all triangles within `reach` of it at
 * rest, in the bent pose relative to the unbent one. */
static double kept(const shipped *s, int joint, int axis, double angle_rad, double reach) {
    static const float zero[BODY_SHAPES], R[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, Th[3];
    float pose[72] = {0};
    posed_body *p[2];
    double volume[2] = {0};
    for (int bent = 0; bent < 2; bent++) {
        if (bent) pose[3 * joint + axis] = (float)angle_rad;
        assert_ok(s->c, posed_body_create(s->c, s->body, pose, zero, R, Th, &p[bent]));
    }
    for (int f = 0; f < s->body->faces; f++) {
        const uint32_t *corner = s->body->face + 3 * (size_t)f;
        bool near = true;
        for (int i = 0; i < 3; i++) {
            double d2 = 0;
            for (int k = 0; k < 3; k++) {
                double d =
                    (double)p[0]->vertices_smpl[3 * (size_t)corner[i] + k] - p[0]->joints_smpl[joint][k];
                d2 += d * d;
            }
            near &= d2 < reach * reach;
        }
        for (int bent = 0; bent < 2 && near; bent++) {
            double x[3][3];
            for (int i = 0; i < 3; i++)
                for (int k = 0; k < 3; k++)
                    x[i][k] = (double)p[bent]->vertices_smpl[3 * (size_t)corner[i] + k] -
                              p[bent]->joints_smpl[joint][k];
            volume[bent] += x[0][0] * (x[1][1] * x[2][2] - x[1][2] * x[2][1]) +
                            x[0][1] * (x[1][2] * x[2][0] - x[1][0] * x[2][2]) +
                            x[0][2] * (x[1][0] * x[2][1] - x[1][1] * x[2][0]);
        }
    }
    posed_body_free(p[0]);
    posed_body_free(p[1]);
    return volume[1] / volume[0];
}

static void volume(void **state) {
    const shipped *s = *state;
    static const struct {
        const char *what;
        int joint, axis;
        double angle_rad, reach, min, max;
    } bends[] = {
        {"left elbow", 18, 1, -M_PI / 2, 0.09, 0.85, 1.1},
        {"right elbow", 19, 1, M_PI / 2, 0.09, 0.85, 1.1},
        {"left knee", 4, 0, M_PI / 2, 0.13, 0.85, 1.1},
        {"right knee", 5, 0, M_PI / 2, 0.13, 0.85, 1.1},
        {"left hip", 1, 0, -M_PI / 2, 0.17, 0.8, 1.1},
        {"left shoulder", 16, 2, -1.2, 0.14, 0.75, 1.15},
        {"neck", 12, 1, 1, 0.1, 0.85, 1.15},
        {"forearm", 18, 0, 1.2, 0.09, 0.85, 1.15},
    };
    for (size_t i = 0; i < COUNT_OF(bends); i++) {
        double k = kept(s, bends[i].joint, bends[i].axis, bends[i].angle_rad, bends[i].reach);
        print_message("%s: %.3f of its volume\n", bends[i].what, k);
        if (!(k >= bends[i].min && k <= bends[i].max)) fail_msg("%s keeps %.3f", bends[i].what, k);
    }
}

/* The inverse of skinning includes the offsets: to canonical space and back. */
static void there_and_back(void **state) {
    const shipped *s = *state;
    float pose[72] = {0}, R[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, Th[3] = {0.1f, 0, 0},
          shape[BODY_SHAPES] = {1, -1};
    posed_body *p;
    pose[3 * 4] = 1.4f, pose[3 * 18 + 1] = -1.5f, pose[3 * 16 + 2] = -1;
    assert_ok(s->c, posed_body_create(s->c, s->body, pose, shape, R, Th, &p));
    size_t n = 3 * (size_t)s->body->vertices;
    float *x = malloc(n * sizeof *x);
    int32_t *own = malloc(n / 3 * sizeof *own);
    for (size_t v = 0; v < n / 3; v++) own[v] = (int32_t)v;
    deform_to_canonical(s->body, p, (int64_t)(n / 3), p->vertices_smpl, NULL, own, x, NULL);
    for (size_t i = 0; i < n; i++) assert_float_equal(x[i], s->body->canonical->vertices_smpl[i], 2e-4);
    deform_from_canonical(s->body, p, (int64_t)(n / 3), x, own, x);
    for (size_t i = 0; i < n; i++)
        assert_float_equal(x[i], p->vertices_smpl[i] + (i % 3 == 0 ? Th[0] : 0), 2e-4);
    free(x);
    free(own);
    posed_body_free(p);
}

/* A body that is saved and read again is the same. */
static void saved(void **state) {
    const shipped *s = *state;
    body_model *again = NULL;
    assert_ok(s->c, body_save(s->c, s->body, test_path("again.safetensors")));
    assert_ok(s->c, body_load(s->c, test_path("again.safetensors"), &again));
    assert_true(again->fingerprint == s->body->fingerprint);
    assert_memory_equal(again->volume, s->body->volume, sizeof again->volume);
    sherf_body_free(again);
}

/* ---- the builder ---- */

/* A ball of 400 vertices with a random radius and length and a little noise; joints lie along it. */
enum { BALL = 400 };
static sherf_status ball(context *c, const void *arg, uint64_t key, float *v, double joints[BODY_JOINTS][3],
                         double *parameter) {
    double r = 0.1 * (1 + 0.2 * random_normal(key + 1, 0)), l = 0.3 * (1 + 0.1 * random_normal(key + 1, 1));
    if (arg && key == 70) return failure(c, SHERF_BAD_FILE, "no such person");
    for (int i = 0; i < BALL; i++) {
        double t = M_PI * (i + 0.5) / BALL, p = 2.4 * i;
        v[3 * i] = (float)(r * sin(t) * cos(p));
        v[3 * i + 1] = (float)(l * cos(t) + 1e-4 * random_normal(key + 1, (uint64_t)(2 + i)));
        v[3 * i + 2] = (float)(r * sin(t) * sin(p));
    }
    for (int j = 0; j < BODY_JOINTS; j++) {
        joints[j][0] = joints[j][2] = 0;
        joints[j][1] = l * (j - 11.5) / 13;
    }
    parameter[0] = r, parameter[1] = l;
    return SHERF_OK;
}

static void builder(void **state) {
    context *c = test_context();
    static float weights[BALL * BODY_JOINTS], uv[2];
    static uint32_t face[3] = {0, 1, 2};
    for (int i = 0; i < BALL; i++) weights[i * BODY_JOINTS + i % BODY_JOINTS] = 1;
    body_source source = {.name = "balls",
                          .version = "1",
                          .licence = "none",
                          .vertices = BALL,
                          .triangles = 1,
                          .uvs = 1,
                          .triangle = face,
                          .triangle_uv = (uint32_t[3]){0, 0, 0},
                          .uv = uv,
                          .weights = weights,
                          .parameters = 2,
                          .parameter = {"radius", "length"},
                          .sample = ball};
    body_model *body = NULL, *again = NULL;
    open_body_report report;
    assert_ok(c, open_body_create(c, &source, 200, &body, &report));
    assert_true(report.share[0] + report.share[1] > 0.999); /* expected components */
    assert_true(report.share[0] >= report.share[1] && report.share[1] > report.share[2]);
    /* the larger one comes first: the length deviates by 0.03 m, the radius by 0.02 m */
    assert_true(fabs(report.correlation[0][1]) > 0.98 && fabs(report.correlation[1][0]) > 0.98);
    assert_float_equal(report.stature_m[0], 0.06, 0.006);
    assert_true(report.joint_error_mm < 1);
    /* people at the ends differ by their parameters: one standard deviation is 1 */
    float v[BALL * 3], shape[BODY_SHAPES];
    double joints[BODY_JOINTS][3], parameter[2];
    assert_ok(c, ball(c, NULL, 12345, v, joints, parameter));
    assert_ok(c, open_body_project(c, body, v, shape));
    assert_float_equal(shape[0], (parameter[1] - 0.3) / 0.03, 0.3);
    context one = *c;
    one.threads = 1;
    assert_ok(c, open_body_create(&one, &source, 200, &again, &report));
    assert_true(again->fingerprint == body->fingerprint); /* the number of threads does not matter */
    sherf_body_free(again);
    sherf_body_free(body);
    source.arg = "";
    assert_int_equal(open_body_create(c, &source, 200, &body, &report), SHERF_BAD_FILE);
    assert_int_equal(open_body_create(c, &source, 10, &body, &report), SHERF_BAD_ARGUMENT);
    assert_null(body);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(skeleton), cmocka_unit_test(weights),
                                       cmocka_unit_test(shapes),   cmocka_unit_test(surface),
                                       cmocka_unit_test(volume),   cmocka_unit_test(there_and_back),
                                       cmocka_unit_test(saved),    cmocka_unit_test(builder)};
    return cmocka_run_group_tests(tests, open_shipped, close_shipped);
}
