/* Tests of baked avatars: their frames compared with the network's, their files, and refused files and
 * requests. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "baked/form.h"
#include "baked/person.h"
#include "io/safetensors.h"
#include "scene/scene.h"
#include "solid_avatar.h"

static body_model *body;
static sherf_avatar *avatar, *baked;

static int make(void **state) {
    context *c = *state = test_context();
    const sherf_bake_options quick = {.resolution = 96, .triangles = 8000, .texture_px = 256};
    sherf_status status = solid_avatar_make(c, &body, &avatar);
    if (!status) status = sherf_avatar_bake(c, avatar, body, &quick, &baked);
    if (status) fprintf(stderr, "%s\n", c->message);
    return status != SHERF_OK;
}

static int leave(void **state) {
    sherf_avatar_free(baked);
    sherf_avatar_free(avatar);
    sherf_body_free(body);
    sherf_context_free(*state);
    return mem_live() != 0;
}

/* From a side and a little above. */
static sherf_camera camera_at(float azimuth_rad, int side) {
    const sherf_pose *p = sherf_avatar_pose(avatar);
    sherf_camera camera;
    sherf_camera_orbit(p->Th_m, 3, azimuth_rad, 0.2f, 0.7f, side, side, &camera);
    return camera;
}

static sherf_pose bent(void) {
    sherf_pose pose = *sherf_avatar_pose(avatar);
    pose.poses_rad[3 * 18 + 1] -= 0.7f; /* an elbow */
    pose.poses_rad[3 * 4] += 0.6f;      /* a knee */
    return pose;
}

/* Both frames are at the same place, in a pose and from sides that were not observed. */
static void stands_where_the_networks_frame_stands(void **state) {
    enum { SIDE = 96 };
    context *c = *state;
    const sherf_pose pose = bent();
    const sherf_render_options plain = {.detail = SHERF_DETAIL_OFF};
    for (int view = 0; view < 3; view++) {
        const sherf_camera camera = camera_at(0.4f + 2.1f * (float)view, SIDE);
        sherf_frame a = {0}, b = {0};
        double both = 0, either = 0, x[2] = {0, 0}, y[2] = {0, 0}, sum[2] = {0, 0}, inside = 0, depth = 0;
        assert_ok(c, sherf_render(c, avatar, body, &pose, &camera, &plain, &a));
        assert_ok(c, sherf_render(c, baked, body, &pose, &camera, &plain, &b));
        for (int i = 0; i < SIDE * SIDE; i++) {
            const double o[2] = {(double)a.opacity.data[i], (double)b.opacity.data[i]};
            both += fmin(o[0], o[1]);
            either += fmax(o[0], o[1]);
            for (int k = 0; k < 2; k++) {
                sum[k] += o[k];
                x[k] += o[k] * (i % SIDE);
                y[k] += o[k] * (double)(i / SIDE);
            }
            if (o[0] < 0.98 || o[1] < 1) continue;
            inside++;
            depth += fabs((double)a.depth.data[i] - (double)b.depth.data[i]);
        }
        assert_true(sum[0] > 300 && inside > 200);
        if (!(both > 0.93 * either)) fail_msg("view %d: they overlap by %g", view, both / either);
        assert_float_equal(x[0] / sum[0], x[1] / sum[1], 0.15);
        assert_float_equal(y[0] / sum[0], y[1] / sum[1], 0.15);
        if (!(depth / inside < 0.03)) fail_msg("view %d: depths are %g m apart", view, depth / inside);
        sherf_frame_free(&a);
        sherf_frame_free(&b);
    }
}

/* The surface's corners in the world, in double. */
static void corners_world(context *c, const baked_form *f, const sherf_pose *pose, float *out) {
    posed_body *p = NULL;
    assert_ok(c, posed_joints_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, &p));
    for (int64_t i = 0; i < f->corners; i++) {
        double x[3] = {0, 0, 0};
        for (int w = 0; w < 4; w++) {
            const float *A = p->transform[f->joint[4 * i + w]], *r = f->rest + 3 * i;
            for (int k = 0; k < 3; k++)
                x[k] += (double)f->weight[4 * i + w] *
                        ((double)A[4 * k] * (double)r[0] + (double)A[4 * k + 1] * (double)r[1] +
                         (double)A[4 * k + 2] * (double)r[2] + (double)A[4 * k + 3]);
        }
        for (int k = 0; k < 3; k++)
            out[3 * i + k] = (float)((double)p->R[3 * k] * x[0] + (double)p->R[3 * k + 1] * x[1] +
                                     (double)p->R[3 * k + 2] * x[2] + (double)p->Th[k]);
    }
    posed_body_free(p);
}

static void corners_stand_in_the_poses_world(void **state) {
    context *c = *state;
    const baked_form *f = baked->formed;
    const sherf_pose pose = bent();
    float *is = malloc((size_t)f->corners * 3 * sizeof *is),
          *should = malloc((size_t)f->corners * 3 * sizeof *should);
    assert_null(f->fold); /* this body keeps no volume */
    corners_world(c, f, &pose, should);
    assert_ok(c, baked_places(c, f, body, &pose, is));
    for (int64_t i = 0; i < 3 * f->corners; i++) assert_float_equal(is[i], should[i], 1e-5);
    free(is);
    free(should);
}

/* If colours encode the texture's columns and rows, the inside of a frame has the columns and rows that the
 * scene's rasteriser gives. */
static void colours_are_those_of_the_texture(void **state) {
    enum { SIDE = 120 };
    context *c = *state;
    baked_form *f = baked->formed;
    const sherf_pose pose = bent();
    const sherf_camera camera = camera_at(5, SIDE);
    float *world = malloc((size_t)f->corners * 3 * sizeof *world);
    sherf_frame frame = {0};
    raster *r = NULL;
    for (int i = 0; i < f->side_px * f->side_px; i++) {
        f->texture[0][3 * i] = (uint8_t)(i % f->side_px);
        f->texture[0][3 * i + 1] = (uint8_t)(i / f->side_px);
    }
    for (int level = 1; level < BAKED_LEVELS; level++) mem_free(f->texture[level]);
    assert_ok(c, baked_levels_make(c, f));
    corners_world(c, f, &pose, world);
    assert_ok(c, raster_create(c, &camera, 1, f->corners, world, f->triangles, f->triangle, &r));
    assert_ok(c, sherf_render(c, baked, body, &pose, &camera, NULL, &frame));
    int inside = 0, far = 0;
    for (int y = 1; y < SIDE - 1; y++)
        for (int x = 1; x < SIDE - 1; x++) {
            const int n = y * SIDE + x;
            bool flat = r->face[n] >= 0; /* the neighbourhood is on one surface */
            for (int k = 0; k < 9 && flat; k++) {
                const int m = n + (k / 3 - 1) * SIDE + k % 3 - 1;
                flat = r->face[m] >= 0 && fabsf(r->depth[m] - r->depth[n]) < 0.02f;
            }
            if (!flat) continue;
            inside++;
            assert_true(frame.opacity.data[n] == 1);
            assert_float_equal(frame.depth.data[n], r->depth[n], 0.02);
            for (int k = 0; k < 2; k++) {
                float at = 0;
                for (int v = 0; v < 3; v++)
                    at += r->barycentric[3 * n + v] *
                          f->uv[2 * (size_t)f->triangle[3 * (size_t)r->face[n] + (size_t)v] + (size_t)k];
                far += fabsf(255 * frame.color.data[3 * n + k] - at) > 4; /* more than four texels away */
            }
        }
    assert_true(inside > 700);
    if (far * 50 > inside) fail_msg("%d of %d pixels have another texel", far, inside);
    raster_free(r);
    free(world);
    sherf_frame_free(&frame);
}

/* A pixel whose neighbours are all covered is covered: there are no gaps between triangles. */
static void the_surface_has_no_gaps(void **state) {
    enum { SIDE = 300 };
    context *c = *state;
    const sherf_pose pose = bent();
    const sherf_camera camera = camera_at(1, SIDE);
    sherf_frame f = {0};
    int covered = 0;
    assert_ok(c, sherf_render(c, baked, body, &pose, &camera, NULL, &f));
    for (int y = 1; y < SIDE - 1; y++)
        for (int x = 1; x < SIDE - 1; x++) {
            bool around = true;
            for (int k = 0; k < 9; k++)
                around = around && (k == 4 || f.opacity.data[(y + k / 3 - 1) * SIDE + x + k % 3 - 1] == 1);
            if (!around) continue;
            covered++;
            if (f.opacity.data[y * SIDE + x] != 1)
                fail_msg("a gap at %d, %d: %g", x, y, (double)f.opacity.data[y * SIDE + x]);
        }
    assert_true(covered > 2000);
    sherf_frame_free(&f);
}

/* An upright edge, cut off above and below: opacity rises by a tent's integral about the same middle, colours
 * stay, new pixels outside have the colour next to them, and the picture's own border cuts nothing. */
static void rims_are_as_soft_as_told(void **state) {
    enum { W = 24, H = 12, EDGE = 10 };
    context *c = *state;
    static const float background[3] = {0.25f, 1, 0};
    const float rgb[3] = {1, 0.5f, 0.125f};
    float color[3 * W * H], opacity[W * H], depth[W * H];
    sherf_frame f = {{W, H, 3, color}, {W, H, 1, opacity}, {W, H, 1, depth}, 0};
    baked_soft s = {0, W, 0, H, 0.9f, background};
    for (int i = 0; i < W * H; i++) {
        const float o = i % W < EDGE ? 1 : 0;
        opacity[i] = o;
        depth[i] = 2 * o;
        for (int k = 0; k < 3; k++) color[3 * i + k] = o > 0 ? rgb[k] : background[k];
    }
    assert_ok(c, baked_soften(c, &s, &f)); /* already as sharp as possible */
    for (int i = 0; i < W * H; i++) assert_true(opacity[i] == (i % W < EDGE));
    s.radius_px = 3;
    assert_ok(c, baked_soften(c, &s, &f));
    static const float rise[6] = {1, 8 / 9.0f, 6 / 9.0f, 3 / 9.0f, 1 / 9.0f, 0};
    for (int i = 0; i < W * H; i++) {
        const int x = i % W, at = x < EDGE - 3 ? 0 : x > EDGE + 2 ? 5 : x - EDGE + 3;
        assert_float_equal(opacity[i], rise[at], 1e-5);
        assert_float_equal(depth[i], at < 5 ? 2 : 0, 1e-5);
        for (int k = 0; k < 3; k++)
            assert_float_equal(color[3 * i + k], rise[at] * rgb[k] + (1 - rise[at]) * background[k], 1e-5);
    }
}

/* If the radius is less than a pixel, opacity rises faster, around one half, and the person's own colours
 * stay. */
static void rims_of_large_pixels_are_sharp(void **state) {
    context *c = *state;
    static const float background[3] = {0.25f, 1, 0}, rgb[3] = {1, 0.5f, 0.125f};
    static const struct {
        float radius_px, was[6], is[6];
    } cases[] = {{1, {0, 0.1f, 0.3f, 0.5f, 0.8f, 1}, {0, 0.1f, 0.3f, 0.5f, 0.8f, 1}},
                 {0.75f, {0, 0.1f, 0.3f, 0.5f, 0.8f, 1}, {0, 0, 0.25f, 0.5f, 0.875f, 1}},
                 {0.1f, {0, 0.1f, 0.3f, 0.5f, 0.8f, 1}, {0, 0, 0.2f, 0.5f, 0.95f, 1}}};
    for (size_t n = 0; n < COUNT_OF(cases); n++) {
        float color[3 * 6], opacity[6], depth[6] = {0};
        sherf_frame f = {{6, 1, 3, color}, {6, 1, 1, opacity}, {6, 1, 1, depth}, 0};
        const baked_soft s = {0, 6, 0, 1, cases[n].radius_px, background};
        for (int i = 0; i < 6; i++) {
            const float o = opacity[i] = cases[n].was[i];
            for (int k = 0; k < 3; k++) color[3 * i + k] = o * rgb[k] + (1 - o) * background[k];
        }
        assert_ok(c, baked_soften(c, &s, &f));
        for (int i = 0; i < 6; i++) {
            const float o = cases[n].is[i];
            assert_float_equal(opacity[i], o, 1e-6);
            for (int k = 0; k < 3; k++)
                assert_float_equal(color[3 * i + k], o * rgb[k] + (1 - o) * background[k], 1e-5);
        }
    }
}

static void assert_same_frame(const sherf_frame *a, const sherf_frame *b) {
    const size_t n = (size_t)a->color.width * (size_t)a->color.height;
    assert_memory_equal(a->color.data, b->color.data, 3 * n * sizeof(float));
    assert_memory_equal(a->opacity.data, b->opacity.data, n * sizeof(float));
    assert_memory_equal(a->depth.data, b->depth.data, n * sizeof(float));
}

static void threads_and_files_change_nothing(void **state) {
    context *c = *state, *other = NULL;
    const sherf_options three = {.threads = 3, .device = SHERF_DEVICE_CPU};
    const sherf_render_options grey = {.background = {0.5f, 0.25f, 1}};
    const sherf_pose pose = bent();
    const sherf_camera camera = camera_at(2, 100);
    sherf_frame a = {0}, b = {0};
    sherf_avatar *again = NULL;
    assert_int_equal(sherf_context_create(&three, &other), SHERF_OK);
    assert_ok(c, sherf_render(c, baked, body, &pose, &camera, &grey, &a));
    assert_ok(other, sherf_render(other, baked, body, &pose, &camera, &grey, &b));
    assert_same_frame(&a, &b);
    assert_true(a.color.data[2] == 1 && a.opacity.data[0] == 0);
    assert_ok(c, sherf_avatar_save(c, baked, test_path("a.baked.safetensors")));
    assert_ok(c, sherf_avatar_load(c, test_path("a.baked.safetensors"), body, &again));
    assert_ok(c, sherf_render(c, again, body, &pose, &camera, &grey, &b));
    assert_same_frame(&a, &b);
    assert_memory_equal(sherf_avatar_pose(again), sherf_avatar_pose(avatar), sizeof(sherf_pose));
    assert_memory_equal(sherf_avatar_camera(again)->K, sherf_avatar_camera(avatar)->K, 9 * sizeof(float));
    sherf_avatar_free(again);
    sherf_frame_free(&a);
    sherf_frame_free(&b);
    sherf_context_free(other);
}

/* Inside the body, and with the person outside the picture or behind the camera: there is always a picture.
 */
static void cameras_anywhere(void **state) {
    context *c = *state;
    const sherf_pose pose = *sherf_avatar_pose(avatar);
    sherf_frame f = {0};
    for (int i = 0; i < 5; i++) {
        static const float distance_m[5] = {0, 0.15f, -3, 40, 3};
        sherf_camera camera;
        sherf_camera_orbit(pose.Th_m, distance_m[i], 0.3f, 0.1f, 0.9f, 80, 60, &camera);
        if (i == 4) camera.K[2] += 10000;
        assert_ok(c, sherf_render(c, baked, body, &pose, &camera, NULL, &f));
        double sum = 0;
        for (int k = 0; k < 80 * 60; k++) {
            assert_true(f.opacity.data[k] >= 0 && f.opacity.data[k] <= 1 && isfinite(f.color.data[3 * k]));
            sum += (double)f.opacity.data[k];
        }
        if (i == 2 || i == 4) assert_true(sum == 0);
        if (i == 3) assert_true(sum > 0);
    }
    sherf_frame_free(&f);
}

/* ---- damaged files ---- */

typedef void (*change)(safetensor *t, void *data);
static void joint_beyond(safetensor *t, void *data) {
    ((uint8_t *)data)[5] = 24;
}
static void weight_less(safetensor *t, void *data) {
    ((float *)data)[4] -= 0.25f;
}
static void weight_negative(safetensor *t, void *data) {
    ((float *)data)[0] = -1;
    ((float *)data)[1] += 1;
}
static void corner_beyond(safetensor *t, void *data) {
    ((uint32_t *)data)[7] = 1u << 30;
}
static void corner_negative(safetensor *t, void *data) {
    ((int32_t *)data)[2] = -1;
}
static void infinite(safetensor *t, void *data) {
    ((float *)data)[3] = INFINITY;
}
static void huge(safetensor *t, void *data) {
    ((float *)data)[3] = 1e30f;
}
static void garbage(safetensor *t, void *data) {
    memset((uint8_t *)data + 4, 0x5a, 40);
}
static void shorter(safetensor *t, void *data) {
    t->dim[0]--;
}
static void narrower(safetensor *t, void *data) {
    t->dim[0] *= t->dim[1];
    t->dim[1] = 1;
}
static void renamed(safetensor *t, void *data) {
    t->name[0] = 'x';
}

static void *copy_of(const safetensor *t) {
    size_t bytes = dtype_size(t->type);
    for (int k = 0; k < t->rank; k++) bytes *= (size_t)t->dim[k];
    void *copy = malloc(bytes);
    assert_non_null(copy);
    return memcpy(copy, t->data, bytes);
}

static sherf_status load_changed(context *c, const char *name, change how, const char *key,
                                 const char *says) {
    safetensors *s = NULL;
    safetensor_item item[16];
    safetensor_metadata metadata[8];
    sherf_avatar *a = NULL;
    void *copy = NULL; /* copy of the changed tensor */
    assert_ok(c, sherf_avatar_save(c, baked, test_path("good.safetensors")));
    assert_ok(c, safetensors_read(c, test_path("good.safetensors"), &s));
    assert_true(s->count <= COUNT_OF(item) && s->metadata_count <= COUNT_OF(metadata));
    for (size_t i = 0; i < s->count; i++) {
        safetensor *t = &s->tensor[i];
        const bool changes = name && !strcmp(t->name, name);
        const void *data = t->data;
        if (changes) {
            data = copy = copy_of(t);
            how(t, copy);
            name = NULL;
        }
        item[i] = (safetensor_item){.name = t->name, .type = t->type, .rank = t->rank, .data = data};
        memcpy(item[i].dim, t->dim, sizeof t->dim);
    }
    assert_null(name);
    size_t kept = 0; /* all metadata except the checksum, which belongs to the old contents */
    for (size_t i = 0; i < s->metadata_count; i++)
        if (strcmp(s->metadata_key[i], "crc32"))
            metadata[kept++] = (safetensor_metadata){
                s->metadata_key[i], key && !strcmp(key, s->metadata_key[i]) ? says : s->metadata_value[i]};
    assert_ok(c, safetensors_write(c, test_path("bad.safetensors"), s->count, item, kept, metadata));
    free(copy);
    safetensors_free(s);
    sherf_status status = sherf_avatar_load(c, test_path("bad.safetensors"), body, &a);
    assert_true((a == NULL) == (status != SHERF_OK));
    sherf_avatar_free(a);
    return status;
}

static void files_that_are_not_right(void **state) {
    context *c = *state;
    static const struct {
        const char *tensor;
        change how;
        const char *says;
    } bad[] = {{"joint", joint_beyond, "joint 24 of 24"},
               {"weight", weight_less, "do not sum to 1"},
               {"weight", weight_negative, "do not sum to 1"},
               {"triangle", corner_beyond, "has corner 1073741824"},
               {"triangle", corner_negative, "has corner"},
               {"rest", infinite, "not finite"},
               {"uv", huge, "far too large"},
               {"texture.png", garbage, "texture.png"},
               {"rest", shorter, "wrong shape"},
               {"uv", shorter, "wrong shape"},
               {"joint", narrower, "wrong shape"},
               {"texture.png", renamed, "missing"},
               {"observation", infinite, "not a finite"},
               {"observation", renamed, "observation"}};
    assert_ok(c, load_changed(c, NULL, NULL, NULL, NULL));
    for (size_t i = 0; i < COUNT_OF(bad); i++) {
        assert_int_not_equal(load_changed(c, bad[i].tensor, bad[i].how, NULL, NULL), SHERF_OK);
        if (!strstr(c->message, bad[i].says) || !strstr(c->message, "bad.safetensors"))
            fail_msg("case %zu: %s", i, c->message);
    }
    assert_int_equal(load_changed(c, NULL, NULL, "version", "2"), SHERF_UNSUPPORTED);
    assert_int_equal(load_changed(c, NULL, NULL, "body", "0123456789abcdef"), SHERF_MISMATCH);
    assert_int_equal(load_changed(c, NULL, NULL, "format", "sherf-avatar"), SHERF_BAD_FILE);
}

/* The number of pixels that only one of the two pictures has. */
static int differing(const sherf_frame *f, const raster *r) {
    int count = 0;
    for (int i = 0; i < f->opacity.width * f->opacity.height; i++)
        count += (f->opacity.data[i] > 0.5f) != (r->face[i] >= 0);
    return count;
}

/* A body that keeps its volume at bent joints: the frame's outline is that of the surface as skin_pose
 * computes it, rather than of the joints alone. */
static void volume_is_kept_at_bent_joints(void **state) {
    enum { SIDE = 200 };
    context *c = *state;
    const sherf_bake_options quick = {.resolution = 96, .triangles = 8000, .texture_px = 256};
    const baked_options same = {.resolution = 96, .islands = 0.02, .triangles = 8000, .texture_px = 256};
    const sherf_pose pose = bent();
    const sherf_camera camera = camera_at(0.7f, SIDE);
    sherf_avatar *full = NULL;
    baked_person person = {0};
    posed_body *p = NULL;
    sherf_frame f = {0};
    raster *r[2] = {NULL, NULL};
    float *posedirs = body->posedirs;
    body->posedirs = NULL;
    body->pose_volume = calloc((size_t)body->vertices * BODY_JOINTS, sizeof(float));
    for (int i = 0; i < body->vertices * BODY_JOINTS; i++)
        body->pose_volume[i] = i % BODY_JOINTS ? 4 * body->weights[i] * (1 - body->weights[i]) : 0;
    assert_ok(c, sherf_avatar_bake(c, avatar, body, &quick, &full));
    assert_ok(c, baked_person_make(c, avatar, body, &same, &person));
    assert_ok(c, posed_body_create(c, body, pose.poses_rad, pose.shapes, pose.R, pose.Th_m, &p));
    const surface *s = &person.surface;
    const baked_form *form = full->formed;
    assert_non_null(form->fold);
    float *world = malloc((size_t)s->vertices * 3 * sizeof *world),
          *stiff = malloc((size_t)form->corners * 3 * sizeof *stiff);
    skin_pose(c, body, &person.skin, p, NULL, world, NULL);
    corners_world(c, form, &pose, stiff);
    assert_ok(c, raster_create(c, &camera, 1, s->vertices, world, s->triangles, s->triangle, &r[0]));
    assert_ok(c, raster_create(c, &camera, 1, form->corners, stiff, form->triangles, form->triangle, &r[1]));
    assert_ok(c, sherf_render(c, full, body, &pose, &camera, NULL, &f));
    const int kept = differing(&f, r[0]), lost = differing(&f, r[1]);
    if (!(kept < 60 && lost > 2 * kept)) fail_msg("%d pixels differ, %d without", kept, lost);
    sherf_avatar *const stiff_one = baked;
    baked = full;
    assert_ok(c, load_changed(c, NULL, NULL, NULL, NULL));
    assert_int_equal(load_changed(c, "fold_joint", joint_beyond, NULL, NULL), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "bends with joint 24"));
    assert_int_equal(load_changed(c, "fold_joint", renamed, NULL, NULL), SHERF_BAD_FILE);
    assert_int_equal(load_changed(c, "fold", shorter, NULL, NULL), SHERF_BAD_FILE);
    assert_int_equal(load_changed(c, "fold", infinite, NULL, NULL), SHERF_BAD_FILE);
    baked = stiff_one;
    for (int i = 0; i < 2; i++) raster_free(r[i]);
    free(world);
    free(stiff);
    free(body->pose_volume);
    body->pose_volume = NULL;
    body->posedirs = posedirs;
    posed_body_free(p);
    baked_person_free(&person);
    sherf_avatar_free(full);
    sherf_frame_free(&f);
}

static void what_needs_the_network_is_refused(void **state) {
    context *c = *state;
    const sherf_pose *pose = sherf_avatar_pose(baked);
    const sherf_camera camera = camera_at(0, 64);
    const sherf_render_options exact = {.exact = 1};
    const sherf_bake_options bad[] = {{.resolution = 8}, {.triangles = 10}, {.texture_px = 100}};
    sherf_avatar *other = NULL;
    sherf_frame f = {0};
    assert_int_equal(sherf_render(c, baked, body, pose, &camera, &exact, &f), SHERF_UNSUPPORTED);
    assert_int_equal(sherf_export(c, baked, body, NULL, test_path("a.glb"), NULL), SHERF_UNSUPPORTED);
    assert_non_null(strstr(c->message, "baked avatar has no network"));
    assert_int_equal(sherf_avatar_bake(c, baked, body, NULL, &other), SHERF_UNSUPPORTED);
    for (size_t i = 0; i < COUNT_OF(bad); i++)
        assert_int_equal(sherf_avatar_bake(c, avatar, body, &bad[i], &other), SHERF_BAD_ARGUMENT);
    assert_null(other);
    sherf_frame_free(&f);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(stands_where_the_networks_frame_stands),
        cmocka_unit_test(corners_stand_in_the_poses_world),
        cmocka_unit_test(the_surface_has_no_gaps),
        cmocka_unit_test(rims_are_as_soft_as_told),
        cmocka_unit_test(rims_of_large_pixels_are_sharp),
        cmocka_unit_test(volume_is_kept_at_bent_joints),
        cmocka_unit_test(threads_and_files_change_nothing),
        cmocka_unit_test(cameras_anywhere),
        cmocka_unit_test(files_that_are_not_right),
        cmocka_unit_test(what_needs_the_network_is_refused),
        cmocka_unit_test(colours_are_those_of_the_texture) /* still true afterwards */};
    return cmocka_run_group_tests(tests, make, leave);
}
