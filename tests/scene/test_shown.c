/* Tests of what a picture shows of a body, against rays and triangles one by one, and of where the rest is
 * read. */
#include <math.h>

#include "body/deform_point.h"
#include "scene/scene.h"
#include "support.h"
#include "synth/tube/tubeman.h"

enum { SIDE = 400 };
typedef struct {
    context *c;
    body_model *body;
    posed_body *p;
    sherf_camera camera;
    float *world, *uv, *depth;
    uint8_t *shown;
} scene;

/* An arm in front of the chest, seen from slightly beside the front. */
static void open_scene(scene *s, float azimuth_rad) {
    static const float R[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, Th[3], shape[10];
    float pose[72] = {0};
    context *c = s->c = test_context();
    pose[3 * 16 + 1] = -1.5f; /* the left arm forward, its forearm across */
    pose[3 * 18 + 1] = -1.9f;
    assert_ok(c, tubeman_create(c, &s->body));
    assert_ok(c, posed_body_create(c, s->body, pose, shape, R, Th, &s->p));
    sherf_camera_orbit((float[]){0, 0, 0}, 3, azimuth_rad, 0, 0.8f, SIDE, SIDE, &s->camera);
    const size_t V = (size_t)s->body->vertices;
    s->world = mem_alloc(c, V, 3 * sizeof *s->world);
    s->uv = mem_alloc(c, V, 2 * sizeof *s->uv);
    s->depth = mem_alloc(c, V, sizeof *s->depth);
    s->shown = mem_alloc(c, V, sizeof *s->shown);
    body_vertices_world(s->body, s->p, s->world);
    camera_project(&s->camera, s->body->vertices, s->world, s->uv, s->depth);
}

static void close_scene(scene *s) {
    mem_free(s->world);
    mem_free(s->uv);
    mem_free(s->depth);
    mem_free(s->shown);
    posed_body_free(s->p);
    sherf_body_free(s->body);
    sherf_context_free(s->c);
    assert_int_equal(mem_live(), 0);
}

/* The depth, relative to the distance to x, at which the line from the eye hits a triangle; 0: no hit. */
static double crossing(const float eye[3], const float x[3], const float *a, const float *b, const float *d) {
    double e[2][3], line[3], from[3], p[3], q[3];
    for (int k = 0; k < 3; k++) {
        e[0][k] = (double)b[k] - a[k], e[1][k] = (double)d[k] - a[k];
        line[k] = (double)x[k] - eye[k], from[k] = (double)eye[k] - a[k];
    }
    for (int k = 0; k < 3; k++) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        p[k] = line[i] * e[1][j] - line[j] * e[1][i];
        q[k] = from[i] * e[0][j] - from[j] * e[0][i];
    }
    double det = 0, u = 0, v = 0, t = 0;
    for (int k = 0; k < 3; k++) {
        det += e[0][k] * p[k], u += from[k] * p[k];
        v += line[k] * q[k], t += e[1][k] * q[k];
    }
    return det != 0 && u / det >= 0 && v / det >= 0 && (u + v) / det <= 1 ? t / det : 0;
}

/* The distance in metres by which the first triangle is in front of vertex v. */
static double before(const scene *s, int v) {
    float eye[3];
    const float *x = s->world + 3 * (size_t)v;
    double first = 1;
    camera_position(&s->camera, eye);
    for (int f = 0; f < s->body->faces; f++) {
        const uint32_t *i = s->body->face + 3 * (size_t)f;
        const double t = crossing(eye, x, s->world + 3 * i[0], s->world + 3 * i[1], s->world + 3 * i[2]);
        if (t > 0 && t < first) first = t;
    }
    return (1 - first) * (double)s->depth[v];
}

static void what_is_seen_agrees_with_rays(void **state) {
    scene s;
    int seen = 0, wrong = 0, kinds[4] = {0};
    float eye[3];
    open_scene(&s, 0.3f);
    camera_position(&s.camera, eye);
    float *normal = mem_alloc(s.c, (size_t)s.body->vertices, 3 * sizeof *normal);
    assert_ok(s.c, body_normals(s.c, s.body, s.world, normal));
    assert_ok(s.c, body_shown(s.c, s.body, s.world, &s.camera, NULL, 0, s.shown));
    for (int v = 0; v < s.body->vertices; v++) kinds[s.shown[v]]++;
    for (int v = 0; v < s.body->vertices; v += 13) {
        const double way = before(&s, v);
        double faces = 0;
        for (int k = 0; k < 3; k++) faces += normal[3 * v + k] * ((double)eye[k] - s.world[3 * v + k]);
        const bool is_seen = s.shown[v] == SHOWN_SEEN;
        seen += is_seen;
        if (fabs(way - 0.02) < 0.01) continue; /* about the distance from which a vertex counts as behind */
        wrong += is_seen != (way < 0.02 && faces > 0);
    }
    print_message("%d seen, %d behind, %d covered, %d outside; of every 13th %d are seen, %d differ\n",
                  kinds[0], kinds[1], kinds[2], kinds[3], seen, wrong);
    assert_true(kinds[SHOWN_SEEN] > s.body->vertices / 5 && kinds[SHOWN_BEHIND] > s.body->vertices / 5);
    assert_true(kinds[SHOWN_COVERED] > 50 && kinds[SHOWN_OUTSIDE] == 0);
    assert_true(wrong <= 6); /* vertices beside outlines share their pixel with what is in front of them */
    mem_free(normal);
    close_scene(&s);
}

static int heaviest(const body_model *body, uint32_t v) {
    const float *w = body->weights + (size_t)v * BODY_JOINTS;
    int best = 0;
    for (int k = 1; k < BODY_JOINTS; k++)
        if (w[k] > w[best]) best = k;
    return best;
}

static bool is_left_forearm(const body_model *body, uint32_t v) {
    const int j = heaviest(body, v);
    return j == 18 || j == 20 || j == 22;
}

/* Where vertices are read, and how many of the trunk's are read on the arm in front of it. */
static int prints(scene *s, float *read_uv) {
    int count = 0;
    raster *r;
    float *world = mem_alloc(s->c, (size_t)s->body->vertices, 3 * sizeof *world);
    int32_t *self = mem_alloc(s->c, (size_t)s->body->vertices, sizeof *self);
    for (int v = 0; v < s->body->vertices; v++) self[v] = v;
    deform_to_picture(s->body, s->p, s->body->vertices, s->body->canonical->vertices_smpl, self, world);
    camera_project(&s->camera, s->body->vertices, world, read_uv, NULL);
    assert_ok(s->c, raster_create(s->c, &s->camera, 1, s->body->vertices, s->world, s->body->faces,
                                  s->body->face, &r));
    for (int v = 0; v < s->body->vertices; v++) {
        const int x = (int)lrintf(read_uv[2 * v]), y = (int)lrintf(read_uv[2 * v + 1]),
                  j = heaviest(s->body, v);
        assert_true(x >= 0 && y >= 0 && x < SIDE && y < SIDE);
        const int32_t face = r->face[y * SIDE + x];
        const bool trunk = j == 0 || j == 3 || j == 6 || j == 9;
        count += trunk && face >= 0 && is_left_forearm(s->body, s->body->face[3 * face]);
    }
    raster_free(r);
    mem_free(world);
    mem_free(self);
    return count;
}

static void no_limb_is_read_for_what_it_covers(void **state) {
    scene s;
    open_scene(&s, 0.3f);
    float *uv = mem_alloc(s.c, (size_t)s.body->vertices, 2 * sizeof *uv);
    const int plain = prints(&s, uv);
    for (int i = 0; i < 2 * s.body->vertices; i++) assert_true(fabsf(uv[i] - s.uv[i]) < 1e-2f);
    for (int mirror = 0; mirror < 2; mirror++) {
        int moved = 0, mirrored = 0;
        mem_free(s.p->read_from);
        mem_free(s.p->together);
        mem_free(s.p->seen);
        assert_ok(s.c, body_read_pictures(s.c, s.body, 1, &(body_picture){s.p, &s.camera, NULL, NULL}, mirror,
                                          s.p));
        const int now = prints(&s, uv);
        for (int v = 0; v < s.body->vertices; v++) {
            const bool stays =
                fabsf(uv[2 * v] - s.uv[2 * v]) + fabsf(uv[2 * v + 1] - s.uv[2 * v + 1]) < 1e-2f;
            mirrored += map_mirrors(s.p->read_from + 12 * v);
            moved += !stays;
            if (s.p->seen[v]) assert_true(stays);
        }
        print_message("trunk's vertices that read the forearm: %d, now %d; %d moved, %d of them mirrored\n",
                      plain, now, moved, mirrored);
        assert_true(plain > 40 && now == 0 && moved > plain);
        assert_true(mirror ? mirrored > 100 : mirrored == 0);
    }
    mem_free(uv);
    close_scene(&s);
}

/* Far sides are read at the near ones, even if maps are blended. */
static void mirrored_places_are_the_other_sides(void **state) {
    scene s;
    open_scene(&s, 1.2f);
    s.p->blend_m = 0.025f;
    assert_ok(s.c,
              body_read_pictures(s.c, s.body, 1, &(body_picture){s.p, &s.camera, NULL, NULL}, true, s.p));
    int mirrored = 0;
    for (int32_t v = 0; v < s.body->vertices; v++) {
        float x[3], off = 0;
        if (!map_mirrors(s.p->read_from + 12 * v)) continue;
        const int32_t other = s.body->mirror[v];
        assert_true(!s.p->seen[v]);
        if (!s.p->seen[other]) continue; /* beside a mirrored one */
        deform_to_picture(s.body, s.p, 1, s.body->canonical->vertices_smpl + 3 * v, &v, x);
        for (int k = 0; k < 3; k++) off = fmaxf(off, fabsf(x[k] - s.world[3 * other + k]));
        assert_true(off < 0.035f); /* there need not be a vertex exactly at the mirror image */
        mirrored++;
    }
    print_message("%d vertices are read at their mirror image\n", mirrored);
    assert_true(mirrored > 500);
    close_scene(&s);
}

/* Neighbours' maps that are marked as leading together do so wherever near the vertex; most are marked, and
 * those of other places are not. */
static void maps_lead_together(void **state) {
    scene s;
    int64_t marked = 0, apart = 0;
    open_scene(&s, 1.2f);
    assert_ok(s.c,
              body_read_pictures(s.c, s.body, 1, &(body_picture){s.p, &s.camera, NULL, NULL}, true, s.p));
    const float *vertex = s.body->canonical->vertices_smpl, *maps = s.p->read_from;
    for (int32_t v = 0; v < s.body->vertices; v++)
        for (int32_t i = s.body->neighbour_first[v]; i < s.body->neighbour_first[v + 1]; i++) {
            const float *own = maps + 12 * v, *other = maps + 12 * s.body->neighbour[i];
            marked += s.p->together[i];
            apart += maps_part(own, other, vertex + 3 * v);
            for (int k = 0; k < 6 && s.p->together[i]; k++) {
                float x[3];
                memcpy(x, vertex + 3 * v, sizeof x);
                x[k / 2] += k % 2 ? MAPS_JOIN_M : -MAPS_JOIN_M;
                assert_true(!maps_part(own, other, x));
            }
        }
    const int64_t all = s.body->neighbour_first[s.body->vertices];
    print_message("%lld of %lld pairs lead together, %lld apart\n", (long long)marked, (long long)all,
                  (long long)apart);
    assert_true(marked > all * 8 / 10 && apart > 100);
    close_scene(&s);
}

/* If a mask or a wrong pose puts the person outside the picture, nothing is read there. */
static void black_is_not_read(void **state) {
    scene s;
    int outside = 0;
    open_scene(&s, 0);
    float *image = mem_zero(s.c, SIDE * SIDE, 3 * sizeof *image);
    float *uv = mem_alloc(s.c, (size_t)s.body->vertices, 2 * sizeof *uv);
    for (int i = 0; i < SIDE * SIDE; i++)
        if (i / SIDE < SIDE / 2) image[3 * i + 1] = 0.5f;
    assert_ok(s.c, body_shown(s.c, s.body, s.world, &s.camera, image, 0, s.shown));
    for (int v = 0; v < s.body->vertices; v++) {
        const bool below = lrintf(s.uv[2 * v + 1]) >= SIDE / 2;
        assert_int_equal(s.shown[v] == SHOWN_OUTSIDE, below);
        outside += below;
    }
    assert_true(outside > 500);
    assert_ok(s.c,
              body_read_pictures(s.c, s.body, 1, &(body_picture){s.p, &s.camera, image, NULL}, true, s.p));
    prints(&s, uv);
    for (int v = 0; v < s.body->vertices; v++) assert_true(uv[2 * v + 1] < SIDE / 2);
    mem_free(image);
    mem_free(uv);
    close_scene(&s);
}

/* The template's other side. */
static void left_is_right(void **state) {
    scene s;
    int moved = 0;
    open_scene(&s, 0);
    for (int v = 0; v < s.body->vertices; v++) {
        const int32_t other = s.body->mirror[v];
        assert_true(other >= 0 && other < s.body->vertices);
        const float *a = s.body->v_template + 3 * v, *b = s.body->v_template + 3 * other;
        assert_true(fabsf(a[0] + b[0] - 2 * s.body->mirror_x_m) < 0.02f && fabsf(a[1] - b[1]) < 0.02f &&
                    fabsf(a[2] - b[2]) < 0.02f);
        moved += other != v;
    }
    assert_true(moved > s.body->vertices / 2);
    close_scene(&s);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(what_is_seen_agrees_with_rays),
                                       cmocka_unit_test(no_limb_is_read_for_what_it_covers),
                                       cmocka_unit_test(mirrored_places_are_the_other_sides),
                                       cmocka_unit_test(maps_lead_together),
                                       cmocka_unit_test(black_is_not_read),
                                       cmocka_unit_test(left_is_right)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
