/* Tests of every format of values, compared with the data from which the samples were made. */
#include "sample.h"

static void test_json(void **state) {
    context *c = *state;
    document *d = sample_read(c, "values.json", "json");
    assert_numbers(c, value_get(d->root, "K"), 9, (double[]){1, 0, 0.5, 0, 1, 0, 0, 0, 1});
    assert_true(value_is_string(value_get(d->root, "name"), "\xc3\xa4\n"));
    assert_int_equal(value_get(d->root, "none")->kind, VALUE_NONE);
    assert_true(value_get(d->root, "yes")->boolean);
    assert_int_equal(value_count(value_get(d->root, "list")), 0);
    assert_int_equal(value_numbers(value_get(d->root, "list")), 0);
    assert_int_equal(value_at(value_get(value_get(value_get(d->root, "deep"), "a"), "b"), 0)->integer, -3);
    assert_int_equal(value_get(d->root, "big")->integer, 9007199254740991);
    assert_null(value_get(d->root, "missing"));
    assert_null(value_at(d->root, 0));
    assert_int_equal(value_numbers(d->root), -1);
    document_free(d);
}

static void test_json_refused(void **state) {
    context *c = *state;
    static const char *const bad[] = {
        "",           "{",     "[1,]",      "[NaN]",       "[Infinity]", "[-Infinity]",
        "[1e999]",    "[1] 2", "{\"a\":}",  "{\"a\" 1}",   "nul",        "[\"a]",
        "[\"\x01\"]", "{1:2}", "[\"\\q\"]", "[\"\\u12\"]", "[1}",        "\"\\ud800\""};
    for (size_t i = 0; i < COUNT_OF(bad); i++) {
        document *d = (document *)1;
        c->message[0] = 0;
        assert_int_not_equal(json_parse(c, bad[i], strlen(bad[i]), &d), SHERF_OK);
        assert_null(d);
        assert_true(c->message[0] != 0);
    }
    char deep[2001];
    document *d;
    memset(deep, '[', 1000);
    memset(deep + 1000, ']', 1000);
    assert_int_equal(json_parse(c, deep, 2000, &d), SHERF_BAD_FILE);
    assert_ok(c, json_parse(c, deep + 900, 200, &d)); /* 100 levels */
    document_free(d);
}

/* JSON with two bytes per character, in both byte orders. Python's json writes names for numbers that are not
 * finite. */
static void test_json_wide(void **state) {
    static const char wide[] = "\xff\xfe{\0\"\0\xe4\0\"\0:\0002\0}\0", big[] = "\xfe\xff\0[\0003\0]";
    context *c = *state;
    document *d;
    const char *kind;
    assert_ok(c, document_parse(c, (const unsigned char *)wide, sizeof wide - 1, &d, &kind));
    assert_string_equal(kind, "json");
    assert_int_equal(value_get(d->root, "\xc3\xa4")->integer, 2);
    document_free(d);
    assert_ok(c, document_parse(c, (const unsigned char *)big, sizeof big - 1, &d, &kind));
    assert_int_equal(value_at(d->root, 0)->integer, 3);
    document_free(d);
}

static void test_json_names_nan(void **state) {
    context *c = *state;
    static const char *const bad[] = {"{\"K\": [NaN, 0]}", "[1, -Infinity]", "[Infinity]"};
    for (size_t i = 0; i < COUNT_OF(bad); i++) {
        document *d;
        assert_int_equal(json_parse(c, bad[i], strlen(bad[i]), &d), SHERF_BAD_FILE);
        assert_non_null(strstr(c->message, "not finite"));
    }
}

static void test_numbers(void **state) {
    context *c = *state;
    const char *text = "{\"n\": 3, \"r\": 2.5, \"l\": [1, [2, 3]], \"s\": \"x\", \"m\": [1, \"x\"]}";
    document *d;
    float f[3];
    double r;
    int64_t n;
    assert_ok(c, json_parse(c, text, strlen(text), &d));
    assert_ok(c, value_integer(c, value_get(d->root, "n"), "n", &n));
    assert_int_equal(n, 3);
    assert_int_equal(value_integer(c, value_get(d->root, "r"), "r", &n), SHERF_BAD_FILE);
    assert_ok(c, value_doubles(c, value_get(d->root, "r"), "r", 1, &r));
    assert_true(r == 2.5);
    assert_ok(c, value_floats(c, value_get(d->root, "l"), "l", 3, f));
    assert_true(f[0] == 1 && f[1] == 2 && f[2] == 3);
    assert_int_equal(value_numbers(value_get(d->root, "l")), 3);
    assert_int_equal(value_floats(c, value_get(d->root, "l"), "l", 2, f), SHERF_BAD_FILE);
    assert_string_equal(c->message, "l has 3 numbers, not 2");
    assert_int_equal(value_floats(c, value_get(d->root, "s"), "s", 1, f), SHERF_BAD_FILE);
    assert_int_equal(value_floats(c, value_get(d->root, "m"), "m", 2, f), SHERF_BAD_FILE);
    assert_int_equal(value_floats(c, NULL, "gone", 1, f), SHERF_BAD_FILE);
    assert_string_equal(c->message, "gone is missing");
    document_free(d);
}

static void check_list(const value *list) {
    static const char bytes[3] = {0, (char)0xff, '\n'};
    assert_int_equal(value_count(list), 13);
    assert_int_equal(value_at(list, 0)->integer, 1);
    assert_true(value_at(list, 1)->real == 2.5);
    assert_int_equal(value_at(list, 2)->kind, VALUE_NONE);
    assert_true(value_at(list, 3)->boolean);
    assert_true(value_is_string(value_at(list, 4), "\xc3\xa4\n\xe6\x97\xa5"));
    assert_int_equal(value_at(list, 5)->string.length, 3);
    assert_memory_equal(value_at(list, 5)->string.text, bytes, 3);
    assert_true(value_at(list, 6)->real == 1e30);
    assert_true(value_at(list, 7)->real == -0x1p70);
    assert_int_equal(value_at(list, 8)->integer, (int64_t)1 << 40);
    assert_int_equal(value_at(list, 9)->integer, -1);
    assert_int_equal(value_count(value_at(list, 10)), 2);
    assert_int_equal(value_at(value_at(list, 11), 0)->integer, 3);
    assert_int_equal(value_at(value_at(list, 12), 0)->integer, 4);
}

static void check_arrays(context *c, const value *root) {
    const double six[] = {0, 1, 2, 3, 4, 5};
    const int64_t two_three[] = {2, 3}, three[] = {3}, two[] = {2};
    assert_shape(value_get(root, "c"), T_F64, 2, two_three);
    assert_numbers(c, value_get(root, "c"), 6, six);
    assert_shape(value_get(root, "fortran"), T_F64, 2, two_three);
    assert_numbers(c, value_get(root, "fortran"), 6, six);
    assert_shape(value_get(root, "big"), T_I32, 1, three);
    assert_numbers(c, value_get(root, "big"), 3, six);
    assert_shape(value_get(root, "u1"), T_U8, 1, three);
    assert_shape(value_get(root, "i2"), T_I32, 1, three);
    assert_numbers(c, value_get(root, "i2"), 3, (double[]){-1, 0, 1});
    assert_shape(value_get(root, "bool"), T_U8, 1, two);
    assert_shape(value_get(root, "half"), T_F16, 1, three);
    assert_numbers(c, value_get(root, "half"), 3, six);
    assert_true(value_get(root, "real")->real == 1.5);
    assert_int_equal(value_get(root, "whole")->integer, -5);
    assert_true(value_is_string(value_at(value_get(root, "words"), 0), "ab"));
    assert_int_equal(value_get(value_at(value_get(root, "objects"), 0), "a")->integer, 1);
}

/* Objects without a value stay records; a list that contains itself is cut. */
static void check_records(const value *root) {
    const value *odd = value_get(root, "odd"), *within = value_get(root, "within");
    assert_int_equal(odd->kind, VALUE_RECORD);
    assert_string_equal(odd->record.class_name, "odd.things.Odd");
    assert_true(value_is_string(value_get(odd, "colour"), "red"));
    assert_int_equal(value_get(odd, "size")->integer, 3);
    assert_int_equal(value_get(value_get(root, "odddict"), "k")->integer, 5);
    assert_int_equal(value_count(value_get(root, "oddlist")->record.state), 2);
    assert_int_equal(value_get(root, "date")->kind, VALUE_RECORD);
    assert_int_equal(value_get(root, "structure")->kind, VALUE_RECORD);
    assert_int_equal(value_get(root, "complex")->kind, VALUE_RECORD);
    assert_ptr_equal(value_at(within, 0), value_get(root, "c"));
    assert_int_equal(value_at(within, 1)->kind, VALUE_RECORD);
}

/* All protocols; a text pickle whose line ends were changed by FTP or git; packed files. */
static void test_pickles(void **state) {
    static const char *const name[] = {"values_p0.pkl", "values_p1.pkl",  "values_p2.pkl",   "values_p3.pkl",
                                       "values_p4.pkl", "values_p5.pkl",  "values_crlf.pkl", "values.pkl.gz",
                                       "values.pkl.xz", "values.pkl.bz2", "values.pkl.lzma"};
    context *c = *state;
    for (size_t p = 0; p < COUNT_OF(name); p++) {
        document *d = sample_read(c, name[p], "pickle");
        check_list(value_get(d->root, "list"));
        check_arrays(c, d->root);
        check_records(d->root);
        assert_true(value_is_string(value_get(d->root, "bytes"), "xy"));
        assert_int_equal(value_get(value_get(d->root, "ordered"), "x")->integer, 1);
        assert_int_equal(value_get(value_get(d->root, "defaults"), "q")->integer, 2);
        document_free(d);
    }
}

static void test_bodies(void **state) {
    context *c = *state;
    static const char *const name[] = {"smpl_chumpy_py2_p0.pkl", "smpl_chumpy_py2_p2.pkl", "smpl_py3_p2.pkl",
                                       "smpl_py3_p5.pkl", "smpl.npz"};
    const double v_template[] = {0.375, 0.875, 0.375, -1.25, 0.875, 0.5, -0.5, 0.625, 0.375};
    const double shape[] = {0.25, 1.25, -0.25, -0.75, 0.75, 0.25, 0.875, -0.375, -1.5, -0.125};
    const double pose[] = {-1.25, -0.25, -1.0, -0.375};
    for (size_t i = 0; i < COUNT_OF(name); i++) {
        document *d = sample_read(c, name[i], i == 4 ? "npz" : "pickle");
        int64_t shapes = i < 2 ? 10 : 12; /* chumpy's Select takes the first ten values */
        assert_shape(value_get(d->root, "v_template"), T_F64, 2, (int64_t[]){3, 3});
        assert_numbers(c, value_get(d->root, "v_template"), 9, v_template);
        assert_shape(value_get(d->root, "f"), T_I64, 2, (int64_t[]){2, 3});
        assert_numbers(c, value_get(d->root, "f"), 6, (double[]){0, 1, 2, 0, 2, 1});
        const value *weights = value_get(d->root, "weights"), *shapes_v = value_get(d->root, "shapedirs");
        assert_shape(weights, T_F64, 2, (int64_t[]){3, 24});
        assert_true(((double *)weights->array.data)[24 + 5] == 1);
        assert_shape(shapes_v, T_F64, 3, (int64_t[]){3, 3, shapes});
        assert_memory_equal((double *)shapes_v->array.data + 5 * shapes, shape, sizeof shape);
        const value *poses = value_get(d->root, "posedirs"), *regressor = value_get(d->root, "J_regressor");
        assert_shape(poses, T_F32, 3, (int64_t[]){3, 3, 207});
        for (int k = 0; k < 4; k++) assert_true(((float *)poses->array.data)[7 * 207 + k] == pose[k]);
        assert_shape(regressor, T_F64, 2, (int64_t[]){24, 3});
        for (int k = 0; k < 72; k++)
            assert_true(((double *)regressor->array.data)[k] == (k % 3 == k / 3 % 3 ? 1 : 0));
        document_free(d);
    }
}

static void test_npy(void **state) {
    context *c = *state;
    double ramp[24];
    for (int i = 0; i < 24; i++) ramp[i] = i;
    static const struct {
        const char *name;
        dtype type;
        int rank;
        int64_t dim[3], count;
    } file[] = {{"c.npy", T_F64, 2, {2, 3}, 6},
                {"fortran.npy", T_F32, 3, {2, 3, 4}, 24},
                {"big.npy", T_F64, 1, {4}, 4},
                {"v2.npy", T_I64, 1, {3}, 3},
                {"v3.npy", T_I32, 1, {3}, 3}};
    for (size_t i = 0; i < COUNT_OF(file); i++) {
        document *d = sample_read(c, file[i].name, "npy");
        assert_shape(d->root, file[i].type, file[i].rank, file[i].dim);
        assert_numbers(c, d->root, (size_t)file[i].count, ramp);
        document_free(d);
    }
    document *d = sample_read(c, "scalar.npy", "npy");
    int64_t n;
    assert_ok(c, value_integer(c, d->root, "scalar", &n));
    assert_int_equal(n, 3);
    document_free(d);
    d = sample_read(c, "dict.npy", "npy"); /* the dict inside, not an array */
    assert_numbers(c, value_at(value_get(d->root, "K"), 1), 9, (double[]){2, 0, 0, 0, 2, 0, 0, 0, 2});
    assert_true(value_is_string(value_get(d->root, "name"), "x"));
    document_free(d);
}

static void test_npz(void **state) {
    context *c = *state;
    document *d = sample_read(c, "stored.npz", "npz");
    assert_numbers(c, value_get(d->root, "x"), 6, (double[]){0, 1, 2, 3, 4, 5});
    assert_true(value_is_string(value_get(d->root, "gender"), "neutral"));
    assert_numbers(c, value_get(value_get(d->root, "o"), "k"), 3, (double[]){0, 1, 2});
    document_free(d);
    d = sample_read(c, "packed.npz", "npz");
    assert_shape(value_get(d->root, "x"), T_F64, 2, (int64_t[]){40, 40});
    document_free(d);
}

static void check_tensors(context *c, const value *root) {
    double ramp[24], turned[24];
    for (int i = 0; i < 24; i++) ramp[i] = i;
    for (int a = 0; a < 4; a++)
        for (int b = 0; b < 6; b++) turned[a * 6 + b] = b * 4 + a;
    assert_shape(value_get(root, "plain"), T_F32, 3, (int64_t[]){2, 3, 4});
    assert_numbers(c, value_get(root, "plain"), 24, ramp);
    assert_shape(value_get(root, "turned"), T_F32, 3, (int64_t[]){4, 2, 3});
    assert_numbers(c, value_get(root, "turned"), 24, turned);
    assert_numbers(c, value_get(root, "slice"), 8, (double[]){4, 5, 6, 7, 16, 17, 18, 19});
    assert_shape(value_get(root, "whole"), T_I64, 1, (int64_t[]){5});
    assert_shape(value_get(root, "half"), T_F16, 1, (int64_t[]){4});
    assert_numbers(c, value_get(root, "half"), 4, (double[]){0.5, -2, 65504, 0x1p-24});
    assert_shape(value_get(root, "bf"), T_BF16, 1, (int64_t[]){2});
    assert_numbers(c, value_get(root, "bf"), 2, (double[]){1.5, -3});
    assert_shape(value_get(root, "double"), T_F64, 2, (int64_t[]){1, 1});
    assert_shape(value_get(root, "bool"), T_U8, 1, (int64_t[]){2});
    assert_shape(value_get(root, "i32"), T_I32, 0, NULL);
    assert_numbers(c, value_get(root, "i32"), 1, (double[]){7});
    assert_numbers(c, value_get(root, "parameter"), 2, (double[]){1, 2});
    assert_shape(value_get(root, "none"), T_F32, 2, (int64_t[]){0, 3});
    assert_numbers(c, value_get(root, "spread"), 4, (double[]){9, 9, 9, 9});
}

static void test_torch(void **state) {
    context *c = *state;
    static const char *const name[] = {"tensors_zip.pt", "tensors_legacy.pt", "tensors_embedded.pkl"};
    for (int i = 0; i < 3; i++) {
        document *d = sample_read(c, name[i], i < 2 ? "torch" : "pickle");
        check_tensors(c, d->root);
        document_free(d);
        if (i == 2) continue;
        assert_ok(c, torch_read(c, sample_path(name[i]), &d));
        check_tensors(c, d->root);
        document_free(d);
    }
    document *d;
    assert_int_equal(torch_read(c, sample_path("stored.npz"), &d), SHERF_BAD_FILE);
    assert_null(d);
}

static void test_writing(void **state) {
    context *c = *state;
    const float data[6] = {0, 1, 2, 3, 4, 5};
    const double same[6] = {0, 1, 2, 3, 4, 5};
    const char *path = test_path("a.npy");
    document *d;
    assert_ok(c, npy_write_f32(c, path, 2, (int64_t[]){2, 3}, data));
    assert_ok(c, npy_read(c, path, &d));
    assert_shape(d->root, T_F32, 2, (int64_t[]){2, 3});
    assert_numbers(c, d->root, 6, same);
    document_free(d);
    assert_ok(c, npy_write_f32(c, path, 0, NULL, data + 1));
    assert_ok(c, npy_read(c, path, &d));
    assert_shape(d->root, T_F32, 0, NULL);
    document_free(d);
    path = test_path("a.npz");
    npz_member member[] = {{"one", 1, {6}, data}, {"two", 2, {3, 2}, data}};
    assert_ok(c, npz_write(c, path, 2, member));
    assert_ok(c, npz_read(c, path, &d));
    assert_shape(value_get(d->root, "one"), T_F32, 1, (int64_t[]){6});
    assert_numbers(c, value_get(d->root, "two"), 6, same);
    document_free(d);
    assert_int_equal(npz_write(c, "/nowhere/at/all.npz", 2, member), SHERF_WRITE_FAILED);
    assert_int_equal(npy_write_f32(c, "/nowhere/at/all.npy", 1, (int64_t[]){6}, data), SHERF_WRITE_FAILED);
}

/* The length of a safetensors' header comes first, and may be the mark of zlib or gzip. */
static void test_lengths_that_look_packed(void **state) {
    static const unsigned marks[] = {0x0178, 0x3f78, 0x8b1f};
    static unsigned char data[0x8b1f + 12];
    context *c = *state;
    for (size_t i = 0; i < COUNT_OF(marks); i++) {
        const size_t bytes = 8 + marks[i] + 4;
        static const char header[] =
            "{\"__metadata__\": {\"format\": \"x\"}, \"a\": {\"dtype\": \"F32\", \"shape\": [1], "
            "\"data_offsets\": [0, 4]}";
        document *d;
        memset(data, ' ', sizeof data);
        memset(data, 0, 8);
        data[0] = marks[i] & 255, data[1] = (unsigned char)(marks[i] >> 8);
        memcpy(data + 8, header, sizeof header - 1);
        data[7 + marks[i]] = '}';
        memset(data + 8 + marks[i], 0, 4);
        assert_ok(c, document_parse(c, data, bytes, &d, NULL));
        assert_non_null(value_get(d->root, "a"));
        document_free(d);
    }
}

static void test_refused_by_name(void **state) {
    context *c = *state;
    document *d;
    static const struct {
        const char *data;
        size_t bytes;
        const char *says;
    } cases[] = {
        {"\x1f\x8b\x08\0", 4, "packed by gzip, but damaged"},
        {"\xfd"
         "7zXZ\0\0\4",
         8, "packed by xz, but damaged"},
        {"version https://git-lfs.github.com/spec/v1\noid sha256:aa\n", 56, "a Git LFS pointer"},
        {"<!DOCTYPE html><html></html>", 28, "a web page (HTML), not the file it offers"},
        {"\x89PNG\r\n\x1a\n\0\0\0\0", 12, "a picture (PNG), where a file of numbers should be"},
        {"%PDF-1.7", 8, "a PDF"},
        {"some words", 10, "a text that is neither JSON nor a pickle; it begins \"some words\""},
    };
    for (size_t i = 0; i < COUNT_OF(cases); i++) {
        assert_int_equal(document_parse(c, (const unsigned char *)cases[i].data, cases[i].bytes, &d, NULL),
                         SHERF_BAD_FILE);
        assert_null(d);
        if (!strstr(c->message, cases[i].says))
            fail_msg("\"%s\" does not say \"%s\"", c->message, cases[i].says);
    }
    assert_int_equal(document_read(c, test_path("missing"), &d, NULL), SHERF_NO_FILE);
    assert_int_equal(document_read(c, "data", &d, NULL), SHERF_BAD_FILE); /* a folder */
    assert_null(d);
    /* a harmful class called as a constructor stays a name */
    const char *harm = "cos\nsystem\n(S'echo harm'\ntR.";
    assert_ok(c, pickle_parse(c, (const unsigned char *)harm, strlen(harm), &d));
    assert_int_equal(d->root->kind, VALUE_RECORD);
    assert_string_equal(d->root->record.class_name, "os.system");
    document_free(d);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_json),
                                       cmocka_unit_test(test_lengths_that_look_packed),
                                       cmocka_unit_test(test_json_refused),
                                       cmocka_unit_test(test_json_names_nan),
                                       cmocka_unit_test(test_json_wide),
                                       cmocka_unit_test(test_numbers),
                                       cmocka_unit_test(test_pickles),
                                       cmocka_unit_test(test_bodies),
                                       cmocka_unit_test(test_npy),
                                       cmocka_unit_test(test_npz),
                                       cmocka_unit_test(test_torch),
                                       cmocka_unit_test(test_writing),
                                       cmocka_unit_test(test_refused_by_name)};
    return cmocka_run_group_tests(tests, test_open, test_close);
}
