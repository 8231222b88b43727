/* Tests of pictures: decoded as by OpenCV (hashes of cv2.imread's bytes), written, refused. */
#include <math.h>
#include <stdlib.h>

#include <zlib.h>

#include "sample.h"

static uint64_t hash_bytes(const uint8_t *p, size_t n) { /* FNV-1a */
    uint64_t h = 0xcbf29ce484222325u;
    while (n--) h = (h ^ *p++) * 0x100000001b3u;
    return h;
}

static const struct {
    const char *name;
    int width, height;
    uint64_t rgb, grey; /* 0: not compared */
} pictures[] = {
    {"cmyk_c.jpg", 37, 29, 0x8abcb9ff7135b266u, 0}, /* OpenCV rounds the grey of CMYK in its own way */
    {"cmyk_y.jpg", 37, 29, 0x46e8d825b3c7a765u, 0},
    {"g1_0.png", 37, 29, 0xec724e9635109384u, 0xe7ddba2e679bdd6eu},
    {"g2_1.png", 37, 29, 0xf091d2ba446215e6u, 0x30653261ed632228u},
    {"g4_0.png", 37, 29, 0x233abfd167aea081u, 0x59931deb83018979u},
    {"g8_1.png", 37, 29, 0xc59694ea7f6e3187u, 0xb9715de09e0bd8efu},
    {"ga8_0.png", 37, 29, 0x96f761e4151d4e50u, 0x468eb262fe502766u},
    {"grey.jpg", 37, 29, 0xa851707d866f6685u, 0x878efa2d0506905du},
    {"gt.png", 37, 29, 0xef3ec440be071476u, 0x869857abec05ab70u},
    {"o3M.jpg", 37, 29, 0x55fe71b1e0f6904eu, 0xac4ad9fb0d930f30u},
    {"o6I.jpg", 29, 37, 0x838f4dcf4d1e359au, 0x7a727f02b9a5f5d8u},
    {"o7M.jpg", 29, 37, 0x0d211aaac4d13ac2u, 0x766f1e8ce38e4a24u},
    {"p1_0.png", 37, 29, 0xabef7cdba67d723eu, 0xa7ae930919e9f9a7u},
    {"p4_1.png", 37, 29, 0x2bb020c090f399b4u, 0xae0cbb1b6ddf985au},
    {"p8_1.png", 37, 29, 0x6e86a95c9a155ba2u, 0x0fcad078e5b109cbu},
    {"prog.jpg", 37, 29, 0xb630b531bc2fd955u, 0x0490f13617925ab6u},
    {"q90.jpg", 37, 29, 0xad82e30614b2f48au, 0xaf74ee2288ce4b94u},
    {"rgb8_0.png", 37, 29, 0x70619483ec0b84eeu, 0x9f675adb57297ab3u},
    {"rgb8_1.png", 37, 29, 0xcac8406748fd74acu, 0x76bf4da3306ab2e5u},
    {"rgba8_1.png", 37, 29, 0x084a241f35bffc99u, 0x62b64d180ffeda83u},
    {"s11.jpg", 37, 29, 0x3938131e51e30700u, 0x224036768222db90u},
    {"s12.jpg", 37, 29, 0x5a5961c2587cd758u, 0x224036768222db90u},
    {"s21.jpg", 37, 29, 0x7bcab9754000c176u, 0x224036768222db90u}};

static void test_as_opencv(void **state) {
    context *c = *state;
    for (size_t i = 0; i < COUNT_OF(pictures); i++)
        for (int channels = 1; channels <= 3; channels += 2) {
            image_u8 p;
            uint64_t want = channels == 3 ? pictures[i].rgb : pictures[i].grey;
            assert_ok(c, image_read(c, sample_path(pictures[i].name), channels, &p));
            assert_int_equal(p.width, pictures[i].width);
            assert_int_equal(p.height, pictures[i].height);
            assert_int_equal(p.channels, channels);
            uint64_t have = hash_bytes(p.data, (size_t)p.width * (size_t)p.height * (size_t)channels);
            if (want && have != want) fail_msg("%s, %d channels: other pixels", pictures[i].name, channels);
            mem_free(p.data);
        }
}

/* Files with random 16-bit values, which are scaled to the nearest of v * 255 / 65535. */
static void test_sixteen_bits(void **state) {
    context *c = *state;
    static const char *const name[] = {"g16_1.png", "rgb16_0.png", "rgba16_0.png"};
    static const int own[] = {1, 3, 4};
    for (int i = 0; i < 3; i++) {
        image_u8 p;
        int width, height, channels;
        assert_ok(c, image_read(c, sample_path(name[i]), 3, &p));
        double mean = 0;
        for (int k = 0; k < 37 * 29 * 3; k++) mean += p.data[k] / (37.0 * 29 * 3);
        assert_true(fabs(mean - 127.5) < 8); /* uniform values: 3 standard errors are 7 */
        mem_free(p.data);
        assert_ok(c, image_size(c, sample_path(name[i]), &width, &height, &channels));
        assert_int_equal(width, 37);
        assert_int_equal(height, 29);
        assert_int_equal(channels, own[i]);
    }
}

static void chunk(FILE *f, const char *type, const unsigned char *data, unsigned n) {
    unsigned char head[8] = {0, 0, 0, (unsigned char)n}, sum[4];
    memcpy(head + 4, type, 4);
    uLong crc = crc32(crc32(0, head + 4, 4), data, n);
    for (int i = 0; i < 4; i++) sum[i] = (unsigned char)(crc >> (24 - 8 * i));
    fwrite(head, 1, 8, f);
    if (n) fwrite(data, 1, n, f);
    fwrite(sum, 1, 4, f);
}

/* A mask of 16-bit values 0 and 1, as some labelling tools write it: 1 is the person, although as a colour it
 * is nearly 0. */
static void test_mask(void **state) {
    context *c = *state;
    const unsigned char head[13] = {0, 0, 0, 3, 0, 0, 0, 2, 16, 0, 0, 0, 0};
    const unsigned char rows[14] = {0, 0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 255, 255}; /* 1 0 256; 0 0 65535 */
    const uint8_t want[6] = {1, 0, 1, 0, 0, 1};
    unsigned char packed[64];
    uLongf n = sizeof packed;
    const char *path = test_path("mask16.png");
    FILE *f = fopen(path, "wb");
    assert_int_equal(compress(packed, &n, rows, sizeof rows), Z_OK);
    fwrite("\x89PNG\r\n\x1a\n", 1, 8, f);
    chunk(f, "IHDR", head, 13);
    chunk(f, "IDAT", packed, (unsigned)n);
    chunk(f, "IEND", packed, 0);
    fclose(f);
    image_u8 p;
    assert_ok(c, image_read(c, path, IMAGE_MASK, &p));
    assert_int_equal(p.channels, 1);
    assert_memory_equal(p.data, want, 6);
    mem_free(p.data);
    const uint8_t colours[12] = {0, 0, 1, 0, 0, 0, 0, 2, 0, 255, 0, 0}, of_colours[4] = {1, 0, 1, 1};
    assert_ok(c, png_write(c, path, 4, 1, 3, colours));
    assert_ok(c, image_read(c, path, IMAGE_MASK, &p));
    assert_memory_equal(p.data, of_colours, 4);
    mem_free(p.data);
}

static void test_alpha(void **state) {
    context *c = *state;
    image_u8 p;
    uint8_t rgba[6 * 4];
    for (int i = 0; i < 24; i++) rgba[i] = (uint8_t)(i * 10);
    const char *path = test_path("a.png");
    assert_ok(c, png_write(c, path, 3, 2, 4, rgba));
    assert_ok(c, image_read(c, path, 4, &p));
    assert_memory_equal(p.data, rgba, sizeof rgba);
    mem_free(p.data);
    assert_ok(c, image_read(c, sample_path("q90.jpg"), 4, &p));
    for (int i = 0; i < 37 * 29; i++) assert_int_equal(p.data[i * 4 + 3], 255);
    mem_free(p.data);
    assert_int_equal(image_read(c, path, 2, &p), SHERF_BAD_ARGUMENT);
}

static void test_write(void **state) {
    context *c = *state;
    enum { W = 61, H = 43 };
    uint8_t *rgb = malloc(W * H * 3);
    for (int y = 0; y < H; y++)
        for (int x = 0; x < W * 3; x++)
            rgb[y * W * 3 + x] = (uint8_t)(128 + 100 * sin(0.05 * (x / 3) + 0.1 * y + x % 3));
    image_u8 p;
    const char *png = test_path("b.png"), *jpg = test_path("b.jpg");
    assert_ok(c, png_write(c, png, W, H, 3, rgb));
    assert_ok(c, image_read(c, png, 3, &p));
    assert_memory_equal(p.data, rgb, W * H * 3);
    mem_free(p.data);
    assert_ok(c, png_write(c, png, W * 3, H, 1, rgb));
    assert_ok(c, image_read(c, png, 1, &p));
    assert_memory_equal(p.data, rgb, W * H * 3);
    mem_free(p.data);
    assert_ok(c, jpeg_write(c, jpg, W, H, rgb, 95));
    assert_ok(c, image_read(c, jpg, 3, &p));
    double sum = 0;
    for (int i = 0; i < W * H * 3; i++) sum += pow(p.data[i] - rgb[i], 2);
    assert_true(10 * log10(255.0 * 255.0 / (sum / (W * H * 3))) > 30); /* colours at half resolution */
    mem_free(p.data);
    assert_int_equal(png_write(c, "/nowhere/at/all.png", W, H, 3, rgb), SHERF_WRITE_FAILED);
    assert_int_equal(jpeg_write(c, "/nowhere/at/all.jpg", W, H, rgb, 90), SHERF_WRITE_FAILED);
    assert_int_equal(jpeg_write(c, jpg, 0, H, rgb, 90), SHERF_BAD_ARGUMENT);
    free(rgb);
}

/* Output formats recognised by file names. */
static void test_outputs(void **state) {
    static const struct {
        const char *name;
        sherf_output kind;
    } cases[] = {
        {"a.png", SHERF_OUTPUT_PICTURE}, {"b/a.JPG", SHERF_OUTPUT_PICTURE}, {"a.webp", SHERF_OUTPUT_PICTURE},
        {"a.mov", SHERF_OUTPUT_VIDEO},   {"a.MP4", SHERF_OUTPUT_VIDEO},     {"a.gif", SHERF_OUTPUT_VIDEO},
        {"a", SHERF_OUTPUT_FOLDER},      {"a.mkv/", SHERF_OUTPUT_FOLDER},   {"a.2024", SHERF_OUTPUT_FOLDER},
        {"b.c/a", SHERF_OUTPUT_FOLDER},  {".hidden", SHERF_OUTPUT_FOLDER},  {"a.frames", SHERF_OUTPUT_FOLDER},
        {"a.mkv", SHERF_OUTPUT_UNKNOWN}, {"a.v2", SHERF_OUTPUT_UNKNOWN},    {"b/a.tif", SHERF_OUTPUT_UNKNOWN},
        {"-", SHERF_OUTPUT_FOLDER},
    };
    for (size_t i = 0; i < COUNT_OF(cases); i++)
        if (sherf_output_kind(cases[i].name) != cases[i].kind)
            fail_msg("%s: %d", cases[i].name, (int)sherf_output_kind(cases[i].name));
    const char *there = test_path("old.run");
    context *c = *state;
    assert_ok(c, folder_make(c, there));
    assert_int_equal(sherf_output_kind(there), SHERF_OUTPUT_FOLDER);
    assert_true(sherf_output_has_alpha("a.mov") && !sherf_output_has_alpha("a.mp4"));
}

static void test_public(void **state) {
    context *c = *state;
    sherf_image image = {0}, back = {0};
    assert_ok(c, sherf_image_read(c, sample_path("rgb8_0.png"), &image));
    assert_int_equal(image.channels, 3);
    const char *png = test_path("p.png"), *npy = test_path("p.npy");
    assert_ok(c, sherf_image_write(c, png, &image));
    assert_ok(c, sherf_image_read(c, png, &back));
    assert_memory_equal(back.data, image.data, 37 * 29 * 3 * sizeof(float));
    sherf_image_free(&back);
    assert_null(back.data);
    assert_ok(c, sherf_image_write(c, npy, &image));
    document *d;
    assert_ok(c, npy_read(c, npy, &d));
    assert_shape(d->root, T_F32, 3, (int64_t[]){29, 37, 3});
    assert_memory_equal(d->root->array.data, image.data, 37 * 29 * 3 * sizeof(float));
    document_free(d);
    assert_int_equal(sherf_image_write(c, test_path("p.tiff"), &image), SHERF_BAD_ARGUMENT);
    const char *webp = test_path("p.webp");
    assert_ok(c, sherf_image_write(c, webp, &image));
    assert_string_equal(sherf_image_kind(webp), "WebP");
    assert_ok(c, sherf_image_read(c, webp, &back));
    assert_memory_equal(back.data, image.data, 37 * 29 * 3 * sizeof(float)); /* lossless */
    sherf_image_free(&back);
    float soft[16 * 16 * 4];
    for (int i = 0; i < 16 * 16 * 4; i++) soft[i] = (float)(i % 4 == 3 ? i / 64 : 8) / 16; /* alpha by row */
    sherf_image rgba = {16, 16, 4, soft}, grey = {16, 16, 1, soft};
    image_u8 four;
    assert_ok(c, sherf_image_write(c, webp, &rgba));
    assert_ok(c, image_read(c, webp, 4, &four));
    assert_int_equal(four.data[4 * 200 + 3], float_to_u8(12 / 16.f));
    mem_free(four.data);
    const char *jpg = test_path("p.jpg");
    assert_int_equal(sherf_image_write(c, jpg, &rgba), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(c->message, "no transparency"));
    for (int i = 0; i < 256; i++) soft[i] = 0.25f + 0.002f * (float)i;
    assert_ok(c, sherf_image_write(c, jpg, &grey));
    assert_ok(c, sherf_image_read(c, jpg, &back));
    for (int i = 0; i < 256 * 3; i++) assert_float_equal(back.data[i], soft[i / 3], 0.02);
    sherf_image_free(&back);
    sherf_image_free(&image);
    assert_int_equal(sherf_image_read(c, test_path("missing.png"), &image), SHERF_NO_FILE);
    assert_int_equal(sherf_image_read(c, sample_path("values.json"), &image), SHERF_BAD_FILE);
    assert_int_equal(float_to_u8(-1), 0);
    assert_int_equal(float_to_u8(NAN), 0);
    assert_int_equal(float_to_u8(0.5f), 128);
    assert_int_equal(float_to_u8(2), 255);
}

/* A header alone must not make us allocate 60000 x 60000 pixels. */
static void test_too_large(void **state) {
    context *c = *state;
    unsigned char *data;
    size_t bytes;
    image_u8 p;
    assert_ok(c, file_read(c, sample_path("q90.jpg"), 1 << 20, &data, &bytes));
    for (size_t i = 2; i + 9 < bytes; i++)
        if (data[i] == 0xff && data[i + 1] == 0xc0) {
            data[i + 5] = data[i + 7] = 0xff;
            break;
        }
    assert_int_equal(image_parse(c, data, bytes, 3, &p), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "pixels"));
    mem_free(data);
}

static void test_writing_without_memory(void **state) {
    context *c = *state;
    uint8_t rgb[12 * 12 * 3] = {0};
    const char *path = test_path("m.png");
    for (long n = 0;; n++) {
        size_t live = mem_live();
        long before = mem_count();
        mem_fail_after(n);
        sherf_status status = png_write(c, path, 12, 12, 3, rgb);
        mem_fail_after(-1);
        assert_int_equal(mem_live(), live);
        if (mem_count() - before <= n) break;
        assert_int_equal(status, SHERF_NO_MEMORY);
        assert_false(path_is_file(path));
    }
    assert_true(path_is_file(path));
}

/* Encoding to memory and decoding: PNG is exact, JPEG nearly; a failed allocation leaks nothing. */
static void test_to_memory(void **state) {
    enum { W = 37, H = 23 };
    context *c = *state;
    uint8_t data[W * H * 4], *out;
    size_t bytes;
    image_u8 p;
    for (int i = 0; i < W * H * 4; i++)
        data[i] = (uint8_t)(i % 4 == 3 ? 255 - i % 97 : i / 16 + 40 * (i % 4));
    for (int channels = 1; channels <= 4; channels++) {
        sherf_status status = png_to_memory(c, W, H, channels, data, channels, &out, &bytes);
        if (channels == 2) {
            assert_int_equal(status, SHERF_BAD_ARGUMENT);
            continue;
        }
        assert_int_equal(status, SHERF_OK);
        assert_ok(c, image_parse(c, out, bytes, channels, &p));
        assert_int_equal(p.width, W);
        assert_memory_equal(p.data, data, (size_t)(W * H * channels));
        mem_free(p.data);
        mem_free(out);
    }
    for (int i = 0; i < W * H * 3; i++) data[i] = (uint8_t)(20 + i / 3 % W * 5);
    for (int quality = 80; quality < 100; quality += 15) {
        assert_ok(c, jpeg_to_memory(c, W, H, data, quality, &out, &bytes));
        assert_ok(c, image_parse(c, out, bytes, 3, &p));
        int worst = 0;
        for (int i = 0; i < W * H * 3; i++)
            worst = abs(p.data[i] - data[i]) > worst ? abs(p.data[i] - data[i]) : worst;
        assert_true(p.width == W && p.height == H && worst < 12);
        mem_free(p.data);
        mem_free(out);
    }
    assert_int_equal(jpeg_to_memory(c, W, H, data, 0, &out, &bytes), SHERF_BAD_ARGUMENT);
    assert_int_equal(jpeg_to_memory(c, 0, H, data, 90, &out, &bytes), SHERF_BAD_ARGUMENT);
    assert_int_equal(png_to_memory(c, W, 100000, 3, data, 1, &out, &bytes), SHERF_BAD_ARGUMENT);
    for (int png = 0; png < 2; png++)
        for (long n = 0;; n++) {
            size_t live = mem_live();
            long before = mem_count();
            mem_fail_after(n);
            sherf_status status = png ? png_to_memory(c, W, H, 3, data, 1, &out, &bytes)
                                      : jpeg_to_memory(c, W, H, data, 90, &out, &bytes);
            mem_fail_after(-1);
            if (status == SHERF_OK) mem_free(out);
            assert_int_equal(mem_live(), live);
            if (mem_count() - before <= n) break;
            assert_int_equal(status, SHERF_NO_MEMORY);
        }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_as_opencv), cmocka_unit_test(test_sixteen_bits),
        cmocka_unit_test(test_alpha),     cmocka_unit_test(test_mask),
        cmocka_unit_test(test_write),     cmocka_unit_test(test_outputs),
        cmocka_unit_test(test_public),    cmocka_unit_test(test_too_large),
        cmocka_unit_test(test_to_memory), cmocka_unit_test(test_writing_without_memory)};
    return cmocka_run_group_tests(tests, test_open, test_close);
}
