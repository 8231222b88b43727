/* Tests of TensorFlow.js layers models: the manifest and its files, refused input, and ResNet-50 from such a
 * model. */
#include <math.h>
#include <unistd.h>

#include "io/tfjs.h"
#include "sample.h"

/* ---- small manifests; every file contains the bytes 0, 1, 2, ... and is as long as its name says ---- */
static sherf_status counting(void *user, context *c, const char *path, size_t limit_bytes,
                             unsigned char **data, size_t *bytes) {
    size_t n = (size_t)atoi(path);
    if (n > limit_bytes)
        return failure(c, SHERF_BAD_FILE, "%s: more than the %zu allowed", path, limit_bytes);
    if (!(*data = mem_alloc(c, n + 1, 1))) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) (*data)[i] = (unsigned char)(*(int *)user)++;
    *bytes = n;
    return SHERF_OK;
}

static sherf_status arrays_of(context *c, const char *paths, const char *weights, document **out) {
    char text[2048];
    document *d;
    int next = 0;
    snprintf(text, sizeof text,
             "{\"modelTopology\": {}, \"weightsManifest\": [{\"paths\": [%s], \"weights\": [%s]}]}", paths,
             weights);
    *out = NULL;
    sherf_status status = json_parse(c, text, strlen(text), &d);
    if (status != SHERF_OK) return status;
    assert_true(tfjs_is(d->root));
    status = tfjs_arrays(c, d->root, counting, &next, out);
    document_free(d);
    return status;
}

static void arrays_lie_end_to_end(void **state) {
    context *c = *state;
    document *d;
    assert_ok(c, arrays_of(c, "\"5\", \"3.bin\", \"4\", \"0\"",
                           "{\"name\": \"a/kernel\", \"shape\": [1, 1], \"dtype\": \"float32\"},"
                           "{\"name\": \"a/bias\", \"shape\": [4], \"dtype\": \"float32\", \"quantization\": "
                           "{\"dtype\": \"uint8\", \"min\": -1, \"scale\": 0.5}},"
                           "{\"name\": \"b\", \"shape\": [2], \"dtype\": \"float32\", \"quantization\": "
                           "{\"dtype\": \"uint16\", \"min\": 1, \"scale\": 2}},"
                           "{\"name\": \"c\", \"shape\": [0, 3], \"dtype\": \"float32\"}",
                           &d));
    assert_int_equal(value_count(d->root), 4);
    const value *array = value_get(d->root, "a/kernel");
    assert_shape(array, T_F32, 2, (int64_t[]){1, 1});
    assert_memory_equal(array->array.data, "\0\1\2\3", 4);
    assert_numbers(c, value_get(d->root, "a/bias"), 4, (double[]){1, 1.5, 2, 2.5});
    assert_numbers(c, value_get(d->root, "b"), 2, (double[]){1 + 2 * 0x0908, 1 + 2 * 0x0b0a});
    assert_shape(value_get(d->root, "c"), T_F32, 2, (int64_t[]){0, 3});
    document_free(d);
}

static void refused(void **state) {
    context *c = *state;
#define ARRAY(name, shape, type) "{\"name\": " name ", \"shape\": " shape ", \"dtype\": " type "}"
#define FLOATS ARRAY("\"w\"", "[2]", "\"float32\"")
    static const struct {
        const char *paths, *weights, *why;
    } wrong[] = {
        {"\"4\"", FLOATS, "hold 4 bytes"},
        {"\"12\"", FLOATS, "more than the 8"},
        {"\"8\", \"1\"", FLOATS, "more than the 0"},
        {"", FLOATS, "hold 0 bytes"},
        {"8", FLOATS, "path 0"},
        {"\"\"", FLOATS, "path 0"},
        {"\"4\", \"../4\"", FLOATS, "path 1"},
        {"\"/8\"", FLOATS, "path 0"},
        {"\"8/..\"", FLOATS, "path 0"},
        {"\"8//x\"", FLOATS, "path 0"},
        {"\"./8\"", FLOATS, "path 0"},
        {"\"8\\\\x\"", FLOATS, "path 0"},
        {"\"8:x\"", FLOATS, "path 0"},
        {"\"8 x\"", FLOATS, "path 0"},
        {"\"8\"", ARRAY("\"w\"", "[2]", "\"bool\""), "only float32"},
        {"\"8\"", ARRAY("\"w\"", "[-2]", "\"float32\""), "out of range"},
        {"\"8\"", ARRAY("\"w\"", "[4294967296, 4294967296]", "\"float32\""), "out of range"},
        {"\"8\"", ARRAY("\"w\"", "[1000000, 1000000]", "\"float32\""), "out of range"},
        {"\"8\"", ARRAY("\"w\"", "[1,1,1,1,1,1,1,1,2]", "\"float32\""), "shape"},
        {"\"8\"", ARRAY("\"w\"", "[1.5]", "\"float32\""), "a size"},
        {"\"8\"", ARRAY("\"w\"", "\"2\"", "\"float32\""), "shape"},
        {"\"8\"", ARRAY("\"\"", "[2]", "\"float32\""), "proper name"},
        {"\"8\"", ARRAY("\"a\\u0007\"", "[2]", "\"float32\""), "proper name"},
        {"\"8\"", ARRAY("7", "[2]", "\"float32\""), "proper name"},
        {"\"8\"", "7", "proper name"},
        {"\"2\"",
         "{\"name\": \"w\", \"shape\": [2], \"dtype\": \"float32\", \"quantization\": {\"dtype\": \"int4\"}}",
         "neither float16"},
        {"\"2\"",
         "{\"name\": \"w\", \"shape\": [2], \"dtype\": \"float32\", \"quantization\": {\"dtype\": \"uint8\", "
         "\"min\": \"x\", \"scale\": 1}}",
         "min"},
    };
    for (size_t i = 0; i < COUNT_OF(wrong); i++) {
        document *d;
        size_t live = mem_live();
        c->message[0] = 0;
        sherf_status status = arrays_of(c, wrong[i].paths, wrong[i].weights, &d);
        if (status == SHERF_OK || d || !strstr(c->message, wrong[i].why) || strchr(c->message, '\n'))
            fail_msg("%s %s: %s", wrong[i].paths, wrong[i].weights, c->message);
        assert_int_equal(mem_live(), live);
    }
}

static void no_memory(void **state) {
    context *c = *state;
    for (long n = 0;; n++) {
        document *d;
        size_t live = mem_live();
        long before = mem_count();
        mem_fail_after(n);
        sherf_status status = arrays_of(c, "\"4\", \"4\"", FLOATS, &d);
        mem_fail_after(-1);
        document_free(d);
        assert_int_equal(mem_live(), live);
        if (mem_count() - before <= n) {
            assert_ok(c, status);
            break;
        }
        assert_int_equal(status, SHERF_NO_MEMORY);
    }
}

/* ---- ResNet-50, of which only the first stages exist ---- */
enum { LAYERS = 24 };
static const struct {
    const char *name;
    int side, in, out, stride;
} layer[LAYERS] = {{"conv1", 7, 3, 64, 2},
                   {"res2a_branch2a", 1, 64, 64, 1},
                   {"res2a_branch2b", 3, 64, 64, 1},
                   {"res2a_branch2c", 1, 64, 256, 1},
                   {"res2a_branch1", 1, 64, 256, 1},
                   {"res2b_branch2a", 1, 256, 64, 1},
                   {"res2b_branch2b", 3, 64, 64, 1},
                   {"res2b_branch2c", 1, 64, 256, 1},
                   {"res2c_branch2a", 1, 256, 64, 1},
                   {"res2c_branch2b", 3, 64, 64, 1},
                   {"res2c_branch2c", 1, 64, 256, 1},
                   {"res3a_branch2a", 1, 256, 128, 2},
                   {"res3a_branch2b", 3, 128, 128, 1},
                   {"res3a_branch2c", 1, 128, 512, 1},
                   {"res3a_branch1", 1, 256, 512, 2},
                   {"res3b_branch2a", 1, 512, 128, 1},
                   {"res3b_branch2b", 3, 128, 128, 1},
                   {"res3b_branch2c", 1, 128, 512, 1},
                   {"res3c_branch2a", 1, 512, 128, 1},
                   {"res3c_branch2b", 3, 128, 128, 1},
                   {"res3c_branch2c", 1, 128, 512, 1},
                   {"res3d_branch2a", 1, 512, 128, 1},
                   {"res3d_branch2b", 3, 128, 128, 1},
                   {"res3d_branch2c", 1, 128, 512, 1}};
static const char *const parts[6] = {"kernel", "bias", "gamma", "beta", "moving_mean", "moving_variance"};

static void norm_of(int l, char out[32]) {
    snprintf(out, 32, l ? "bn%s" : "bn_%s", l ? layer[l].name + 3 : layer[l].name);
}

/* Value i of a part; variances are positive. */
static float number(int l, int part, int64_t i) {
    float u = (float)random_uniform((uint64_t)(l * 8 + part) << 40, (uint64_t)i) - 0.5f;
    return part == 5 ? 1 + u : u;
}

static void write_model(const char *folder, int odd_stride) {
    char path[700], norm[32];
    snprintf(path, sizeof path, "%s/model.json", folder);
    FILE *json = fopen(path, "w");
    fprintf(json, "{\"modelTopology\": {\"model_config\": {\"config\": {\"layers\": [");
    for (int l = 0; l < LAYERS; l++) {
        norm_of(l, norm);
        int s = l == odd_stride ? 3 : layer[l].stride;
        fprintf(
            json,
            "{\"class_name\": \"Conv2D\", \"config\": {\"name\": \"%s\", \"kernel_size\": [%d, %d], "
            "\"strides\": "
            "[%d, %d], \"dilation_rate\": [1, 1], \"padding\": \"%s\", \"data_format\": \"channels_last\"}},"
            "{\"class_name\": \"BatchNormalization\", \"config\": {\"name\": \"%s\", \"epsilon\": 0.001}},",
            layer[l].name, layer[l].side, layer[l].side, s, s, layer[l].side == 3 ? "same" : "valid", norm);
    }
    for (int k = 0; k < 2; k++)
        fprintf(
            json,
            "{\"class_name\": \"ZeroPadding2D\", \"config\": {\"name\": \"%s_pad\", \"padding\": [[%d, %d], "
            "[%d, %d]]}}%s",
            k ? "pool1" : "conv1", 3 - 2 * k, 3 - 2 * k, 3 - 2 * k, 3 - 2 * k, k ? "]}}}," : ",");
    fprintf(json,
            "\"convertedBy\": \"a test\", \"weightsManifest\": [{\"paths\": [\"one.bin\", \"two.bin\"], "
            "\"weights\": [");
    FILE *shard[2];
    for (int k = 0; k < 2; k++) {
        snprintf(path, sizeof path, "%s/%s.bin", folder, k ? "two" : "one");
        shard[k] = fopen(path, "wb");
    }
    const size_t first = 1234567; /* bytes: the cut is inside a number */
    size_t at = 0;
    for (int l = 0; l < LAYERS; l++)
        for (int part = 0; part < 6; part++) {
            int64_t count = part ? layer[l].out : layer[l].side * layer[l].side * layer[l].in * layer[l].out;
            norm_of(l, norm);
            fprintf(json, "%s{\"name\": \"%s/%s\", \"dtype\": \"float32\", \"shape\": [",
                    l || part ? "," : "", part < 2 ? layer[l].name : norm, parts[part]);
            if (!part) fprintf(json, "%d, %d, %d, ", layer[l].side, layer[l].side, layer[l].in);
            fprintf(json, "%d]}", layer[l].out);
            for (int64_t i = 0; i < count; i++) {
                float v = number(l, part, i);
                for (size_t k = 0; k < sizeof v; k++) putc(((unsigned char *)&v)[k], shard[at++ >= first]);
            }
        }
    for (int k = 0; k < 2; k++) fclose(shard[k]);
    fprintf(json, "]}]}\n");
    fclose(json);
}

static void resnet50(void **state) {
    context *c = *state;
    char folder[512], model[600], out[512];
    char *said;
    snprintf(folder, sizeof folder, "%s", test_path("model"));
    snprintf(model, sizeof model, "%s/model.json", folder);
    snprintf(out, sizeof out, "%s", test_path("resnet50.safetensors"));
    assert_ok(c, folder_make(c, folder));
    write_model(folder, -1);
    for (int by_folder = 0; by_folder < 2; by_folder++) {
        assert_ok(c, sherf_convert(c, by_folder ? folder : model, out, &said));
        assert_non_null(strstr(said, "ResNet-50"));
        sherf_free(said);
        safetensors *s;
        assert_ok(c, safetensors_read(c, out, &s));
        assert_int_equal(s->count, 2 * LAYERS);
        assert_string_equal(safetensors_metadata(s, "format"), "resnet50");
        assert_string_equal(safetensors_metadata(s, "licence"), "unknown"); /* not the known weights */
        assert_string_equal(safetensors_metadata(s, "version"), "a test");
        for (int l = 0; l < LAYERS; l++) {
            char name[64];
            snprintf(name, sizeof name, "%s.weight", layer[l].name);
            const safetensor *w = safetensors_find(s, name);
            snprintf(name, sizeof name, "%s.bias", layer[l].name);
            const safetensor *b = safetensors_find(s, name);
            const int k = layer[l].side, in = layer[l].in, o = layer[l].out / 3, i = in / 2 + 1, y = k - 1,
                      x = k / 2;
            assert_true(w && b && w->rank == 4 && w->dim[0] == layer[l].out && w->dim[1] == in &&
                        w->dim[3] == k);
            double factor = number(l, 2, o) / sqrt((double)number(l, 5, o) + 0.001);
            int from = l ? i : 2 - i; /* the stem takes RGB, but the file has BGR */
            double weight = factor * number(l, 0, (((int64_t)y * k + x) * in + from) * layer[l].out + o);
            double bias = ((double)number(l, 1, o) - number(l, 4, o)) * factor + number(l, 3, o);
            assert_true(fabs(((const float *)w->data)[((o * in + i) * k + y) * k + x] - weight) < 1e-6);
            assert_true(fabs(((const float *)b->data)[o] - bias) < 1e-6);
        }
        safetensors_free(s);
    }
    /* another network, a file that is a link to somewhere else, a missing file */
    size_t live = mem_live();
    write_model(folder, 14);
    assert_int_equal(sherf_convert(c, folder, out, NULL), SHERF_MISMATCH);
    assert_non_null(strstr(c->message, "res3a_branch1"));
    write_model(folder, -1);
    char shard[600], elsewhere[600];
    snprintf(shard, sizeof shard, "%s/two.bin", folder);
    snprintf(elsewhere, sizeof elsewhere, "%s", test_path("elsewhere.bin"));
    assert_int_equal(rename(shard, elsewhere), 0);
    assert_int_equal(sherf_convert(c, folder, out, NULL), SHERF_NO_FILE);
    assert_int_equal(symlink(elsewhere, shard), 0);
    assert_int_equal(sherf_convert(c, folder, out, NULL), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "link"));
    assert_int_equal(unlink(model), 0);
    assert_int_equal(sherf_convert(c, folder, out, NULL), SHERF_NO_FILE);
    assert_int_equal(mem_live(), live);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(arrays_lie_end_to_end), cmocka_unit_test(refused),
                                       cmocka_unit_test(no_memory), cmocka_unit_test(resnet50)};
    return cmocka_run_group_tests(tests, test_open, test_close);
}
