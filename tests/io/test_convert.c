/* Tests of sherf_convert: every kind of input with its result, and refused input. */
#include "sample.h"

static safetensors *convert(context *c, const char *input, const char *said) {
    const char *path = test_path("out.safetensors");
    char *description = NULL;
    safetensors *s = NULL;
    assert_ok(c, sherf_convert(c, input, path, &description));
    if (!strstr(description, said)) fail_msg("%s: said %s", input, description);
    sherf_free(description);
    assert_ok(c, safetensors_read(c, path, &s));
    return s;
}

static void assert_tensor(const safetensors *s, const char *name, dtype type, int rank, const int64_t *dim) {
    const safetensor *t = safetensors_find(s, name);
    if (!t) fail_msg("%s is missing", name);
    assert_int_equal(t->type, type);
    assert_int_equal(t->rank, rank);
    for (int i = 0; i < rank; i++) assert_int_equal(t->dim[i], dim[i]);
}

static void test_bodies(void **state) {
    context *c = *state;
    static const char *const name[] = {"smpl_chumpy_py2_p0.pkl", "smpl_chumpy_py2_p2.pkl", "smpl_py3_p2.pkl",
                                       "smpl_py3_p5.pkl", "smpl.npz"};
    for (size_t i = 0; i < COUNT_OF(name); i++) {
        safetensors *s = convert(c, sample_path(name[i]), "SMPL body: 3 vertices, 2 faces");
        assert_string_equal(safetensors_metadata(s, "format"), "sherf-body");
        assert_int_equal(s->count, 7);
        assert_tensor(s, "v_template", T_F32, 2, (int64_t[]){3, 3});
        assert_tensor(s, "weights", T_F32, 2, (int64_t[]){3, 24});
        assert_tensor(s, "posedirs", T_F32, 3, (int64_t[]){3, 3, 207});
        assert_tensor(s, "J_regressor", T_F64, 2, (int64_t[]){24, 3});
        assert_tensor(s, "shapedirs", T_F32, 3, (int64_t[]){3, 3, 10});
        assert_tensor(s, "f", T_I32, 2, (int64_t[]){2, 3});
        assert_tensor(s, "kintree_table", T_I64, 2, (int64_t[]){2, 24});
        const float *shapes = safetensors_find(s, "shapedirs")->data;
        assert_true(shapes[50] == 0.25f && shapes[59] == -0.125f);
        const int64_t *tree = safetensors_find(s, "kintree_table")->data;
        assert_true(tree[0] == -1 && tree[23] == 21 && tree[24 + 23] == 23);
        safetensors_free(s);
    }
}

static void test_snapshot(void **state) {
    context *c = *state;
    safetensors *s = convert(c, sample_path("snapshot.pkl"), "SHERF snapshot (G_ema): 6 tensors");
    assert_string_equal(safetensors_metadata(s, "format"), "sherf-model");
    assert_string_equal(safetensors_metadata(s, "source"), "snapshot");
    assert_string_equal(safetensors_metadata(s, "snapshot.class"), "TriPlaneGenerator");
    assert_string_equal(safetensors_metadata(s, "snapshot.depth_resolution"), "48");
    assert_string_equal(safetensors_metadata(s, "snapshot.channel_base"), "2048");
    assert_string_equal(safetensors_metadata(s, "snapshot.data_resolution"), "512");
    assert_tensor(s, "renderer.encoder_3d.conv0.0.weight", T_F32, 5, (int64_t[]){2, 3, 3, 3, 2});
    assert_tensor(s, "renderer.encoder_3d.conv0.1.num_batches_tracked", T_F32, 0, NULL);
    assert_tensor(s, "backbone.synthesis.b4.const", T_F32, 3, (int64_t[]){4, 2, 2});
    float mean[2]; /* 2 in G_ema, 1 in G */
    assert_ok(c,
              safetensors_floats(c, s, "renderer.encoder_3d.conv0.1.running_mean", 1, (int64_t[]){2}, mean));
    assert_true(mean[0] == 2 && mean[1] == 2);
    safetensors_free(s);
}

static void test_heads(void **state) {
    context *c = *state;
    static const int64_t width[5] = {64, 128, 256, 512, 512};
    safetensors *s = convert(c, sample_path("heads.pt"), "LPIPS: five heads");
    assert_string_equal(safetensors_metadata(s, "format"), "lpips-heads");
    for (int k = 0; k < 5; k++) {
        char name[8];
        snprintf(name, sizeof name, "lin%d", k);
        assert_tensor(s, name, T_F32, 1, &width[k]);
        assert_true(((const float *)safetensors_find(s, name)->data)[5] == 0.625f);
    }
    safetensors_free(s);
}

/* The 26 tensors of VGG16, all zeros, under the names of torchvision or of the LPIPS package; and heads. */
static void write_vgg16(context *c, const char *path, bool slices, bool heads) {
    static const int index[13] = {0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28};
    static const int width[13] = {64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512};
    static const int slice[13] = {1, 1, 2, 2, 3, 3, 3, 4, 4, 4, 5, 5, 5};
    static const int head[5] = {64, 128, 256, 512, 512};
    static char name[32][40];
    npz_member member[32];
    int n = 0;
    float *zeros = calloc(512 * 512 * 9, sizeof *zeros);
    for (int k = 0, in = 3; k < 13; in = width[k++])
        for (int bias = 0; bias < 2; bias++, n++) {
            const char *part = bias ? "bias" : "weight";
            if (slices)
                snprintf(name[n], sizeof name[n], "net.slice%d.%d.%s", slice[k], index[k], part);
            else
                snprintf(name[n], sizeof name[n], "features.%d.%s", index[k], part);
            member[n] = (npz_member){name[n], bias ? 1 : 4, {width[k], in, 3, 3}, zeros};
        }
    for (int k = 0; k < 5 && heads; k++, n++) {
        snprintf(name[n], sizeof name[n], "lin%d.model.1.weight", k);
        member[n] = (npz_member){name[n], 4, {1, head[k], 1, 1}, zeros};
    }
    snprintf(name[n], sizeof name[n], "classifier.0.bias");
    member[n] = (npz_member){name[n], 1, {16}, zeros};
    assert_ok(c, npz_write(c, path, n + 1, member));
    free(zeros);
}

static void test_vgg16(void **state) {
    context *c = *state;
    const char *path = test_path("vgg.npz");
    write_vgg16(c, path, false, false);
    safetensors *s = convert(c, path, "VGG16");
    assert_string_equal(safetensors_metadata(s, "format"), "vgg16");
    assert_int_equal(s->count, 26);
    assert_null(safetensors_find(s, "classifier.0.bias"));
    safetensors_free(s);
    write_vgg16(c, path, true, true);
    s = convert(c, path, "LPIPS: VGG16 and its five heads");
    assert_string_equal(safetensors_metadata(s, "format"), "lpips");
    assert_int_equal(s->count, 31);
    assert_tensor(s, "features.28.weight", T_F32, 4, (int64_t[]){512, 512, 3, 3});
    safetensors_free(s);
}

/* If a file is meant to be VGG16, the message names the wrong tensor. */
static void test_vgg16_faults(void **state) {
    context *c = *state;
    static char name[26][32];
    float *zeros = calloc(512 * 512 * 9, sizeof *zeros);
    static const int index[] = {0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28},
                     width[] = {64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512};
    npz_member member[26];
    for (int k = 0, in = 3; k < 13; in = width[k++])
        for (int bias = 0; bias < 2; bias++) {
            snprintf(name[2 * k + bias], sizeof name[0], "features.%d.%s", index[k],
                     bias ? "bias" : "weight");
            member[2 * k + bias] =
                (npz_member){name[2 * k + bias], bias ? 1 : 4, {width[k], in, 3, 3}, zeros};
        }
    const char *path = test_path("vgg_faults.npz"), *out = test_path("no.safetensors");
    assert_ok(c, npz_write(c, path, 25, member));
    assert_int_equal(sherf_convert(c, path, out, NULL), SHERF_MISMATCH);
    assert_non_null(strstr(c->message, "features.28.bias is missing"));
    member[4].dim[1] = 32;
    assert_ok(c, npz_write(c, path, 26, member));
    assert_int_equal(sherf_convert(c, path, out, NULL), SHERF_MISMATCH);
    assert_non_null(strstr(c->message, "features.5.weight has another shape"));
    assert_false(path_is_file(out));
    remove(path);
    free(zeros);
}

static void test_resnet(void **state) {
    context *c = *state;
    float *zeros = calloc(512 * 512 * 9, sizeof *zeros);
    npz_member member[] = {{"conv1.weight", 4, {64, 3, 7, 7}, zeros},
                           {"layer1.0.conv1.weight", 4, {64, 64, 3, 3}, zeros},
                           {"layer4.1.conv2.weight", 4, {512, 512, 3, 3}, zeros},
                           {"layer1.2.conv1.weight", 4, {64, 64, 3, 3}, zeros},
                           {"layer3.5.conv1.weight", 4, {256, 256, 3, 3}, zeros},
                           {"layer4.2.conv2.weight", 4, {512, 512, 3, 3}, zeros}};
    const char *path = test_path("resnet.npz");
    assert_ok(c, npz_write(c, path, 3, member));
    safetensors *s = convert(c, path, "ResNet-18: 3 tensors");
    assert_string_equal(safetensors_metadata(s, "format"), "resnet18");
    assert_tensor(s, "layer4.1.conv2.weight", T_F32, 4, (int64_t[]){512, 512, 3, 3});
    safetensors_free(s);
    assert_ok(c, npz_write(c, path, 4, member)); /* neither 18 nor all 34 */
    assert_int_equal(sherf_convert(c, path, test_path("no.safetensors"), NULL), SHERF_MISMATCH);
    assert_ok(c, npz_write(c, path, 6, member));
    s = convert(c, path, "ResNet-34: 6 tensors");
    assert_string_equal(safetensors_metadata(s, "format"), "resnet34");
    safetensors_free(s);
    free(zeros);
}

static void test_refused(void **state) {
    context *c = *state;
    const char *out = test_path("refused.safetensors");
    static const char *const name[] = {"values_p2.pkl", "tensors_zip.pt", "values.json", "c.npy",
                                       "stored.npz",    "q90.jpg",        "README.md"};
    for (size_t i = 0; i < COUNT_OF(name); i++) {
        char *said = (char *)1;
        c->message[0] = 0;
        assert_int_not_equal(sherf_convert(c, sample_path(name[i]), out, &said), SHERF_OK);
        assert_null(said);
        if (!strstr(c->message, name[i])) fail_msg("%s is not named: %s", name[i], c->message);
        assert_false(path_is_file(out));
    }
    assert_int_equal(sherf_convert(c, sample_path("heads.pt"), "/nowhere/at/all", NULL), SHERF_WRITE_FAILED);
}

static void test_no_memory(void **state) {
    context *c = *state;
    static const char *const name[] = {"smpl_chumpy_py2_p2.pkl", "snapshot.pkl", "heads.pt", "smpl.npz"};
    const char *out = test_path("memory.safetensors");
    for (size_t i = 0; i < COUNT_OF(name); i++)
        for (long n = 0;; n++) {
            size_t live = mem_live();
            long before = mem_count();
            char *said = NULL;
            mem_fail_after(n);
            sherf_status status = sherf_convert(c, sample_path(name[i]), out, &said);
            mem_fail_after(-1);
            sherf_free(said);
            assert_int_equal(mem_live(), live);
            if (mem_count() - before <= n) {
                assert_int_equal(status, SHERF_OK);
                remove(out);
                break;
            }
            assert_int_equal(status, SHERF_NO_MEMORY);
            assert_false(path_is_file(out));
        }
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_bodies),       cmocka_unit_test(test_snapshot),
                                       cmocka_unit_test(test_heads),        cmocka_unit_test(test_vgg16),
                                       cmocka_unit_test(test_vgg16_faults), cmocka_unit_test(test_resnet),
                                       cmocka_unit_test(test_refused),      cmocka_unit_test(test_no_memory)};
    return cmocka_run_group_tests(tests, test_open, test_close);
}
