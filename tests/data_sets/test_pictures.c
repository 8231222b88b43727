/* Tests of undistortion and resizing against OpenCV 4.6: hashes and sums of its results on pictures from the
 * hash generator. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "data/data.h"
#include "support.h"

static image_u8 hash_picture(context *c, int width, int height, int channels) {
    char name[64];
    snprintf(name, sizeof name, "pictures.%dx%dx%d", width, height, channels);
    uint64_t key = fnv1a64(name);
    size_t n = (size_t)width * height * channels;
    image_u8 image = {width, height, channels, mem_alloc(c, n, 1)};
    assert_non_null(image.data);
    for (size_t i = 0; i < n; i++) image.data[i] = (uint8_t)(256 * random_uniform(key, i));
    return image;
}

static sherf_image to_floats(context *c, const image_u8 *bytes) {
    size_t n = (size_t)bytes->width * bytes->height * bytes->channels;
    sherf_image image = {bytes->width, bytes->height, bytes->channels, mem_alloc(c, n, sizeof(float))};
    assert_non_null(image.data);
    for (size_t i = 0; i < n; i++) image.data[i] = bytes->data[i] / 255.f;
    return image;
}

static uint64_t hash_bytes(const image_u8 *image) {
    uint64_t h = 0xCBF29CE484222325u;
    size_t n = (size_t)image->width * image->height * image->channels;
    for (size_t i = 0; i < n; i++) h = (h ^ image->data[i]) * 0x100000001B3u;
    return h;
}

/* Each value is multiplied by its own random weight, so a value in another place changes the sum. */
static double weighted_sum(const sherf_image *image) {
    uint64_t key = fnv1a64("pictures.weights");
    size_t n = (size_t)image->width * image->height * image->channels;
    double sum = 0;
    for (size_t i = 0; i < n; i++) sum += image->data[i] * random_uniform(key, i);
    return sum;
}

static const struct {
    int width, height, channels;
    double K[9], D[DISTORTION_MAX];
    uint64_t bytes, mask;
    double sum;
} distorted[] = {
    {64,
     48,
     3,
     {70.25, 0, 30.75, 0, 71.5, 25.5, 0, 0, 1},
     {-0.2, 0.1, 0.003, -0.002, 0.01},
     0xed1b850505ed151bu,
     0x8edb21fbf0d08e8bu,
     2321.357334289},
    {200,
     120,
     1,
     {150, 0, 99.25, 0, 160.5, 61, 0, 0, 1},
     {0.1, 0.05, 0, 0, 0},
     0x2ab2fc8a3d2d9f94u,
     0x4d81ac2469e075e9u,
     5506.535724055},
    {97,
     131,
     3,
     {120, 0, 48, 0, 120, 65, 0, 0, 1},
     {-0.4, 0.2, 0.01, 0.02, -0.03},
     0x7a565b0c36d63868u,
     0xd59853771106cc8fu,
     9536.898837096},
    {64,
     48,
     3,
     {70.25, 0, 30.75, 0, 71.5, 25.5, 0, 0, 1},
     {-0.2, 0.1, 0.003, -0.002},
     0x4f9a394250834658u,
     0x79dd0531c7611dffu,
     2321.605592732},
    {80, /* rational */
     60,
     1,
     {70.25, 0, 38.75, 0, 71.5, 30.5, 0, 0, 1},
     {0.4, -0.3, 0.002, -0.004, 0.05, 0.25, 0.1, -0.02},
     0x6c8a98b0352aea5cu,
     0x4c37193d260688beu,
     1184.218699344},
    {64, /* and with a thin prism */
     48,
     3,
     {70.25, 0, 30.75, 0, 71.5, 25.5, 0, 0, 1},
     {-0.2, 0.1, 0.003, -0.002, 0.01, 0.1, -0.05, 0.02, 0.03, -0.02, 0.01, 0.04},
     0xb6bb80818fd8a8a5u,
     0x9bfdfbed081bdf48u,
     2320.596556952},
    {64, /* and tilted */
     48,
     3,
     {70.25, 0, 30.75, 0, 71.5, 25.5, 0, 0, 1},
     {-0.2, 0.1, 0.003, -0.002, 0.01, 0.1, -0.05, 0.02, 0.03, -0.02, 0.01, 0.04, 0.06, -0.09},
     0x1d59899d530e0c16u,
     0xd75ad0b4fdd69705u,
     2312.138739536},
};

static void undistort_as_opencv(void **state) {
    context *c = test_context();
    for (size_t i = 0; i < COUNT_OF(distorted); i++) {
        image_u8 image = hash_picture(c, distorted[i].width, distorted[i].height, distorted[i].channels);
        sherf_image floats = to_floats(c, &image);
        assert_ok(c, image_undistort_f32(c, &floats, distorted[i].K, distorted[i].D));
        assert_float_equal(weighted_sum(&floats), distorted[i].sum, 1e-4);
        assert_ok(c, image_undistort(c, &image, distorted[i].K, distorted[i].D));
        assert_true(hash_bytes(&image) == distorted[i].bytes);
        mem_free(image.data);
        mem_free(floats.data);
        image = hash_picture(c, distorted[i].width, distorted[i].height, distorted[i].channels);
        for (int k = 0; k < image.width * image.height * image.channels; k++)
            image.data[k] = image.data[k] > 127;
        assert_ok(c, image_undistort(c, &image, distorted[i].K, distorted[i].D));
        assert_true(hash_bytes(&image) == distorted[i].mask);
        mem_free(image.data);
    }
    sherf_context_free(c);
}

/* A lens that moves pixels far away or has a singular K must not crash; the picture is then empty. */
static void undistort_of_nonsense(void **state) {
    context *c = test_context();
    static const double K[][9] = {{1e-30, 0, 0, 0, 1e-30, 0, 0, 0, 1},
                                  {1e30, 0, 0, 0, 1e30, 0, 0, 0, 1},
                                  {0, 0, 0, 0, 0, 0, 0, 0, 0},
                                  {NAN, 0, 8, 0, NAN, 8, 0, 0, 1}};
    static const double D[][DISTORTION_MAX] = {{1e300, 1e300, 1, 1, 1}, {NAN, 0, 0, 0, 0}, {1, 1, 1, 1, 1}};
    for (size_t i = 0; i < COUNT_OF(K); i++)
        for (size_t j = 0; j < COUNT_OF(D); j++) {
            image_u8 image = hash_picture(c, 16, 16, 1);
            assert_ok(c, image_undistort(c, &image, K[i], D[j]));
            mem_free(image.data);
        }
    sherf_context_free(c);
}

static const struct {
    int width, height, channels, to_width, to_height;
    uint64_t nearest;
    double sum;
    float value[4]; /* 0, 7, the middle and the last */
} resized[] = {
    {64,
     48,
     3,
     32,
     24,
     0x7d9279ce4fb31d58u,
     580.674106152,
     {0.623529434f, 0.403921604f, 0.385294139f, 0.509803951f}},
    {60,
     60,
     1,
     20,
     20,
     0x05db3e04aaeb3b58u,
     103.681518060,
     {0.350326806f, 0.581699312f, 0.414379090f, 0.512418330f}},
    {100,
     80,
     3,
     37,
     29,
     0xb1743b2268d05a35u,
     810.296737088,
     {0.376511276f, 0.650400519f, 0.366440684f, 0.462527454f}},
    {101,
     77,
     1,
     64,
     50,
     0xb99bf38e7ca9409du,
     813.189973447,
     {0.745147943f, 0.649625480f, 0.792050004f, 0.542623162f}},
    {192,
     108,
     3,
     64,
     36,
     0xbefddf62e325c0a4u,
     1730.297722747,
     {0.411764741f, 0.505010903f, 0.488017410f, 0.497167736f}},
    {30,
     20,
     3,
     50,
     41,
     0xc9923f5d504c7471u,
     1511.715768476,
     {0.317647070f, 0.921568632f, 0.498431444f, 0.835294127f}},
    {48,
     64,
     3,
     12,
     16,
     0x6cf536ef938ec23bu,
     148.528125902,
     {0.486764729f, 0.572058856f, 0.558088243f, 0.444117665f}},
};

static void resize_as_opencv(void **state) {
    context *c = test_context();
    for (size_t i = 0; i < COUNT_OF(resized); i++) {
        image_u8 image = hash_picture(c, resized[i].width, resized[i].height, resized[i].channels);
        sherf_image floats = to_floats(c, &image);
        assert_ok(c, image_resize_area(c, &floats, resized[i].to_width, resized[i].to_height));
        assert_float_equal(weighted_sum(&floats), resized[i].sum, 1e-5);
        int n = floats.width * floats.height * floats.channels, at[4] = {0, 7, n / 2, n - 1};
        for (int k = 0; k < 4; k++) assert_float_equal(floats.data[at[k]], resized[i].value[k], 1.2e-7);
        assert_ok(c, image_resize_nearest(c, &image, resized[i].to_width, resized[i].to_height));
        assert_int_equal(image.width, resized[i].to_width);
        assert_true(hash_bytes(&image) == resized[i].nearest);
        assert_int_equal(image_resize_area(c, &floats, 0, 5), SHERF_BAD_ARGUMENT);
        mem_free(image.data);
        mem_free(floats.data);
    }
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(undistort_as_opencv),
        cmocka_unit_test(undistort_of_nonsense),
        cmocka_unit_test(resize_as_opencv),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
