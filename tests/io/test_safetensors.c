/* Tests of safetensors: written, read back, and refused if the format's rules are broken. */
#include "sample.h"

static void test_round(void **state) {
    context *c = *state;
    const float f[6] = {1, -2, 3.5f, 4, 5, 6};
    const int64_t i[2] = {-1, (int64_t)1 << 40};
    const uint8_t u[3] = {1, 2, 3};
    const uint16_t half[2] = {0x3c00, 0xc000}, bf[2] = {0x3f80, 0xc000};
    const safetensor_item item[] = {
        {"u", T_U8, 1, {3}, u},           {"f \"q\"\\\n\xc3\xa4", T_F32, 2, {2, 3}, f},
        {"none", T_F32, 2, {0, 7}, NULL}, {"i", T_I64, 1, {2}, i},
        {"one", T_F32, 0, {0}, f + 1},    {"h", T_F16, 1, {2}, half},
        {"b", T_BF16, 1, {2}, bf}};
    const safetensor_metadata metadata[] = {{"format", "x"}, {"k\t", "v\"\\"}};
    const char *path = test_path("a.safetensors");
    safetensors *s;
    float out[6];
    assert_ok(c, safetensors_write(c, path, COUNT_OF(item), item, 2, metadata));
    assert_ok(c, safetensors_read(c, path, &s));
    assert_int_equal(s->count, COUNT_OF(item));
    assert_string_equal(s->tensor[0].name, "u");
    assert_string_equal(safetensors_metadata(s, "format"), "x");
    assert_string_equal(safetensors_metadata(s, "k\t"), "v\"\\");
    assert_null(safetensors_metadata(s, "other"));
    assert_null(safetensors_find(s, "other"));
    for (size_t k = 0; k < s->count; k++) assert_true((uintptr_t)s->tensor[k].data % 64 == 0);
    assert_memory_equal(safetensors_find(s, item[1].name)->data, f, sizeof f);
    assert_memory_equal(safetensors_find(s, "i")->data, i, sizeof i);
    assert_int_equal(safetensors_find(s, "none")->dim[1], 7);
    assert_ok(c, safetensors_floats(c, s, item[1].name, 2, (int64_t[]){2, 3}, out));
    assert_memory_equal(out, f, sizeof f);
    assert_ok(c, safetensors_floats(c, s, "h", 1, (int64_t[]){2}, out));
    assert_true(out[0] == 1 && out[1] == -2);
    assert_ok(c, safetensors_floats(c, s, "b", 1, (int64_t[]){2}, out));
    assert_true(out[0] == 1 && out[1] == -2);
    assert_int_equal(safetensors_floats(c, s, "h", 1, (int64_t[]){3}, out), SHERF_MISMATCH);
    assert_string_equal(c->message, "tensor h is [2], not [3]");
    assert_int_equal(safetensors_floats(c, s, "u", 1, (int64_t[]){3}, out), SHERF_MISMATCH);
    assert_int_equal(safetensors_floats(c, s, "gone", 1, (int64_t[]){3}, out), SHERF_MISMATCH);
    safetensors_free(s);
    document *d;
    const char *kind;
    assert_ok(c, document_read(c, path, &d, &kind));
    assert_string_equal(kind, "safetensors");
    assert_true(value_is_string(value_get(value_get(d->root, "__metadata__"), "format"), "x"));
    assert_numbers(c, value_get(d->root, "h"), 2, (double[]){1, -2});
    document_free(d);
}

/* A file with a checksum is refused if any of its bits is flipped, unless that bit is in the checksum's name.
 */
static void test_flipped(void **state) {
    context *c = *state;
    const float f[3] = {1, -2, 3.5f};
    const safetensor_item item[] = {{"a", T_F32, 1, {3}, f}, {"none", T_F32, 1, {0}, NULL}};
    const safetensor_metadata metadata[] = {SAFETENSORS_CHECKSUM, {"format", "x"}};
    const char *path = test_path("flip.safetensors");
    unsigned char *data;
    size_t bytes, read = 0;
    safetensors *s;
    assert_ok(c, safetensors_write(c, path, COUNT_OF(item), item, COUNT_OF(metadata), metadata));
    assert_ok(c, file_read(c, path, 4096, &data, &bytes));
    assert_ok(c, safetensors_parse(c, data, bytes, &s));
    assert_int_equal(strlen(safetensors_metadata(s, "crc32")), 8);
    assert_string_not_equal(safetensors_metadata(s, "crc32"), "00000000");
    safetensors_free(s);
    for (size_t bit = 0; bit < 8 * bytes; bit++) {
        data[bit / 8] ^= (unsigned char)(1 << bit % 8);
        if (safetensors_parse(c, data, bytes, &s) == SHERF_OK) {
            read++;
            assert_true(bit / 8 >= 8 && bit / 8 < 8 + sizeof "{\"__metadata__\":{\"crc32\"");
            assert_memory_equal(safetensors_find(s, "a")->data, f, sizeof f);
            safetensors_free(s);
        }
        data[bit / 8] ^= (unsigned char)(1 << bit % 8);
    }
    assert_in_range(read, 1, 60); /* some flips leave a file that is read */
    data[bytes - 1] ^= 1;
    assert_int_equal(safetensors_parse(c, data, bytes, &s), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "damaged"));
    mem_free(data);
}

static sherf_status parse(context *c, const char *header, size_t data_bytes, safetensors **s) {
    unsigned char file[1024] = {0};
    size_t n = strlen(header);
    file[0] = (unsigned char)n;
    file[1] = (unsigned char)(n >> 8);
    memcpy(file + 8, header, n);
    *s = (safetensors *)1;
    c->message[0] = 0;
    return safetensors_parse(c, file, 8 + n + data_bytes, s);
}

static void test_strict(void **state) {
    context *c = *state;
    safetensors *s;
#define A "{\"a\":{\"dtype\":\"F32\",\"shape\":[2],\"data_offsets\":"
#define B "\"b\":{\"dtype\":\"U8\",\"shape\":[4],\"data_offsets\":"
    assert_ok(c, parse(c, A "[0,8]}," B "[8,12]}}", 12, &s));
    safetensors_free(s);
    assert_ok(c, parse(c, A "[4,12]}," B "[0,4]}}", 12, &s)); /* the header may have any order */
    assert_string_equal(s->tensor[0].name, "b");
    safetensors_free(s);
    assert_ok(c, parse(c, "{}", 0, &s));
    safetensors_free(s);
    static const struct {
        const char *header;
        size_t data;
    } bad[] = {{A "[0,8]}," B "[4,8]}}", 12},
               {A "[0,8]}," B "[9,13]}}", 13},
               {A "[0,8]}}", 7},
               {A "[0,8]}}", 9},
               {A "[8,0]}}", 8},
               {A "[-8,0]}}", 8},
               {A "[0,7]}}", 7},
               {A "[0,8.5]}}", 8},
               {A "[0,8,8]}}", 8},
               {A "[0,8],\"x\":1}}", 8},
               {A "[0,8]},\"a\":{\"dtype\":\"U8\",\"shape\":[4],\"data_offsets\":[8,12]}}", 12},
               {"{\"a\":{\"dtype\":\"F33\",\"shape\":[2],\"data_offsets\":[0,8]}}", 8},
               {"{\"a\":{\"dtype\":\"F32\",\"shape\":[-2],\"data_offsets\":[0,8]}}", 8},
               {"{\"a\":{\"dtype\":\"F32\",\"shape\":[4294967296,4294967296],\"data_offsets\":[0,0]}}", 0},
               {"{\"a\":{\"dtype\":\"F32\",\"shape\":[1,1,1,1,1,1],\"data_offsets\":[0,4]}}", 4},
               {"{\"a\":{\"dtype\":\"F32\",\"shape\":2,\"data_offsets\":[0,8]}}", 8},
               {"{\"a\":3}", 0},
               {"{\"__metadata__\":{\"a\":3}}", 0},
               {"{\"__metadata__\":3}", 0},
               {"[]", 0},
               {"{", 0},
               {" {}", 0}};
    for (size_t i = 0; i < COUNT_OF(bad); i++) {
        if (parse(c, bad[i].header, bad[i].data, &s) == SHERF_OK) fail_msg("accepted: %s", bad[i].header);
        assert_null(s);
        assert_true(c->message[0]);
    }
    const unsigned char huge[9] = {0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f, '{'};
    assert_int_equal(safetensors_parse(c, huge, 9, &s), SHERF_BAD_FILE);
}

/* Files as their authors release them get the command that reads them. */
static void test_unconverted(void **state) {
    context *c = *state;
    static const struct {
        const char *name, *said;
    } file[] = {{"snapshot.pkl", "snapshot.pkl: a pickle: convert it first (sherf convert"},
                {"smpl_chumpy_py2_p2.pkl", "a pickle: convert it first"},
                {"tensors_legacy.pt", "a pickle: convert it first"},
                {"heads.pt", "heads.pt: a PyTorch file: convert it first (sherf convert"},
                {"tensors_zip.pt", "a PyTorch file: convert it first"},
                {"stored.npz", "a ZIP archive, where a file of numbers should be"}};
    for (size_t i = 0; i < COUNT_OF(file); i++) {
        safetensors *s;
        assert_int_equal(safetensors_read(c, sample_path(file[i].name), &s), SHERF_BAD_FILE);
        if (!strstr(c->message, file[i].said)) fail_msg("%s: %s", file[i].name, c->message);
    }
}

/* Truncated anywhere, and with any allocation failing. */
static void test_hostile(void **state) {
    context *c = *state;
    const float f[6] = {1, 2, 3, 4, 5, 6};
    const safetensor_item item[] = {{"x", T_F32, 2, {2, 3}, f}, {"y", T_F32, 1, {3}, f}};
    const safetensor_metadata metadata[] = {{"format", "x"}};
    const char *path = test_path("b.safetensors");
    unsigned char *data;
    size_t bytes;
    safetensors *s;
    assert_ok(c, safetensors_write(c, path, 2, item, 1, metadata));
    assert_ok(c, file_read(c, path, 1 << 20, &data, &bytes));
    size_t live = mem_live();
    for (size_t n = 0; n < bytes; n++) {
        assert_int_equal(safetensors_parse(c, data, n, &s), SHERF_BAD_FILE);
        assert_null(s);
        assert_int_equal(mem_live(), live);
    }
    for (size_t n = 0; n < bytes * 8; n++) {
        data[n / 8] ^= (unsigned char)(1 << n % 8);
        if (safetensors_parse(c, data, bytes, &s) == SHERF_OK) safetensors_free(s);
        assert_int_equal(mem_live(), live);
        data[n / 8] ^= (unsigned char)(1 << n % 8);
    }
    for (long n = 0;; n++) {
        long before = mem_count();
        mem_fail_after(n);
        sherf_status status = safetensors_parse(c, data, bytes, &s);
        mem_fail_after(-1);
        if (status == SHERF_OK) safetensors_free(s);
        assert_int_equal(mem_live(), live);
        if (mem_count() - before <= n) break;
        assert_int_equal(status, SHERF_NO_MEMORY);
    }
    mem_free(data);
    assert_int_equal(safetensors_write(c, "/nowhere/x", 2, item, 1, metadata), SHERF_WRITE_FAILED);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_round), cmocka_unit_test(test_flipped),
                                       cmocka_unit_test(test_strict), cmocka_unit_test(test_unconverted),
                                       cmocka_unit_test(test_hostile)};
    return cmocka_run_group_tests(tests, test_open, test_close);
}
