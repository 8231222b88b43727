/* Tests of the mask on a made person in front of a made background. A made network sees the true mask,
 * blurred over several of its pixels, with a bite, a leak and an island. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "support.h"

#include "estimate/guided.h"
#include "estimate/local_color.h"
#include "estimate/mask.h"
#include "estimate/mask_clean.h"

enum { W = 320, H = 288 };
static photo_person person;

/* Head, trunk, spread legs and an arm away from the trunk. Straight edges run between pixels, so that they
 * cover no pixel by half. */
static bool shape(double x, double y) {
    const double u = x - 160.5, v = y - 20.5;
    const bool head = hypot(u, v - 30) < 26, trunk = fabs(u) < 40 && v > 50 && v < 150;
    const bool legs = fabs(fabs(u) - 22) < 15 && v >= 150 && v < 240,
               arm = fabs(u - 70) < 10 && v > 60 && v < 160;
    const bool shoulder = u > 0 && u < 80 && v > 60 && v < 80;
    return head || trunk || legs || arm || shoulder;
}

/* The covered share of the pixel, from 4 x 4 samples. */
static float coverage(int x, int y) {
    int in = 0;
    for (int i = 0; i < 16; i++) in += shape(x + (i % 4 - 1.5) / 4, y + (i / 4 - 1.5) / 4);
    return (float)in / 16;
}

static float noise(int x, int y, int k) {
    return (float)random_uniform(random_key(7, "mask", (uint64_t)k), (uint64_t)(y * W + x)) - 0.5f;
}

static void color_of_person(int x, int y, float out[3]) {
    const bool stripe = y / 12 % 2;
    const float c[2][3] = {{0.75f, 0.25f, 0.2f}, {0.85f, 0.8f, 0.7f}};
    for (int k = 0; k < 3; k++) out[k] = c[stripe][k] + 0.04f * noise(x, y, k);
}

static void color_of_background(int x, int y, float out[3]) {
    const float wave = 0.5f + 0.5f * sinf(0.21f * (float)x) * cosf(0.13f * (float)y);
    const float c[3] = {0.15f + 0.25f * wave, 0.35f + 0.3f * wave, 0.3f + 0.1f * wave};
    for (int k = 0; k < 3; k++) out[k] = c[k] + 0.06f * noise(x, y, k + 3);
}

static sherf_image picture(context *c, int width, int height, int channels) {
    sherf_image p = {width, height, channels,
                     mem_zero(c, (size_t)width * (size_t)height, (size_t)channels * 4)};
    assert_non_null(p.data);
    return p;
}

/* scale: pixels per pixel of the shape, on each side. */
static void make(context *c, int scale, sherf_image *photo, sherf_image *truth) {
    *photo = picture(c, W * scale, H * scale, 3);
    *truth = picture(c, W * scale, H * scale, 1);
    for (int i = 0; i < W * H; i++) {
        float mine[3], other[3], seen[3];
        const float share = coverage(i % W, i / W);
        color_of_person(i % W, i / W, mine);
        color_of_background(i % W, i / W, other);
        for (int k = 0; k < 3; k++) seen[k] = share * mine[k] + (1 - share) * other[k];
        for (int j = 0; j < scale * scale; j++) {
            const int at = (i / W * scale + j / scale) * W * scale + i % W * scale + j % scale;
            truth->data[at] = share;
            memcpy(photo->data + 3 * at, seen, sizeof seen);
        }
    }
}

/* A network's output in a turned region: blurred, a bite at the trunk, a leak between the legs, an island. */
static void see(int scale) {
    const float turn = 0.3f, side = 340;
    person = (photo_person){
        .score = 1, .region = {{160.f * (float)scale, 144.f * (float)scale}, side * (float)scale, turn}};
    for (int i = 0; i < PERSON_MASK_SIDE * PERSON_MASK_SIDE; i++) {
        const float u = ((float)(i % PERSON_MASK_SIDE) + 0.5f) / PERSON_MASK_SIDE - 0.5f,
                    v = ((float)(i / PERSON_MASK_SIDE) + 0.5f) / PERSON_MASK_SIDE - 0.5f;
        const float x = 160 + side * (cosf(turn) * u - sinf(turn) * v),
                    y = 144 + side * (sinf(turn) * u + cosf(turn) * v);
        float p = 0;
        for (int k = 0; k < 49; k++) p += (float)shape(x + (k % 7 - 3) * 2.0, y + (k / 7 - 3) * 2.0) / 49;
        if (hypotf(x - 121, y - 120) < 9) p = fminf(p, 0.4f);
        if (hypotf(x - 160, y - 200) < 9) p = fmaxf(p, 0.6f);
        if (hypotf(x - 60, y - 60) < 7) p = 0.9f;
        person.inside[i] = 0.002f + 0.996f * p;
    }
}

static double overlap(const sherf_image *a, const sherf_image *b) {
    size_t both = 0, any = 0;
    for (size_t i = 0; i < (size_t)a->width * (size_t)a->height; i++) {
        const bool x = a->data[i] >= 0.5f, y = b->data[i] >= 0.5f;
        both += x && y, any += x || y;
    }
    return (double)both / (double)any;
}

/* The refined mask is nearly the truth, also at four times the size, and the same for any number of threads.
 */
static void test_overlap(void **state) {
    context *c = *state;
    for (int scale = 1; scale <= 4; scale += 3) {
        sherf_image photo, truth, rough, mask, again;
        person_mask_facts facts;
        make(c, scale, &photo, &truth);
        see(scale);
        assert_ok(c, person_mask_network(c, &photo, &person, &rough));
        assert_ok(c, person_mask(c, &photo, &person, NULL, 0, &mask, &facts));
        const double before = overlap(&rough, &truth), after = overlap(&mask, &truth);
        if (!(before < 0.96 && after > 0.99)) fail_msg("scale %d: overlap %g, then %g", scale, before, after);
        assert_false(facts.over);
        assert_true(facts.border[0] == 0 && facts.border[3] == 0 && facts.area > 0.1f);
        for (int k = 0; k < W * H * scale * scale; k++) assert_true(mask.data[k] >= 0 && mask.data[k] <= 1);
        assert_float_equal(mask.data[(60 * W * scale + 60) * scale], 0, 0); /* the island */
        const int threads = c->threads;
        for (c->threads = 1; c->threads <= (scale > 1 ? 1 : 3); c->threads += 2) {
            assert_ok(c, person_mask(c, &photo, &person, NULL, 0, &again, NULL));
            assert_memory_equal(again.data, mask.data, (size_t)(W * H * scale * scale) * sizeof(float));
            sherf_image_free(&again);
        }
        c->threads = threads;
        sherf_image_free(&photo), sherf_image_free(&truth), sherf_image_free(&rough), sherf_image_free(&mask);
    }
}

/* The region ends at the hips: the mask is 0 below them, with a warning. */
static void test_region(void **state) {
    context *c = *state;
    sherf_image photo, truth, mask;
    person_mask_facts facts;
    make(c, 1, &photo, &truth);
    see(1);
    person.region = (photo_region){{160, 40}, 240, 0};
    for (int i = 0; i < PERSON_MASK_SIDE * PERSON_MASK_SIDE; i++)
        person.inside[i] =
            shape(40 + 240 * (i % 256 + 0.5) / 256, -80 + 240 * (i / 256 + 0.5) / 256) ? 0.99f : 0.01f;
    assert_ok(c, person_mask(c, &photo, &person, NULL, 0, &mask, &facts));
    assert_true(facts.over && facts.cut_off > 0.05f);
    for (int x = 0; x < W; x++) assert_float_equal(mask.data[161 * W + x], 0, 0);
    assert_true(mask.data[150 * W + 160] > 0.9f);
    sherf_image_free(&mask);
    person.region.centre_px[0] = -5000;
    assert_int_equal(person_mask(c, &photo, &person, NULL, 0, &mask, &facts), SHERF_BAD_ARGUMENT);
    assert_null(mask.data);
    see(1);
    memset(person.inside, 0, sizeof person.inside);
    assert_int_equal(person_mask(c, &photo, &person, NULL, 0, &mask, &facts), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(c->message, "nothing of the person"));
    sherf_image_free(&photo), sherf_image_free(&truth);
}

/* Two people claim everything; each keeps the part at their own bones. */
static void test_others(void **state) {
    enum { N = 96 };
    static photo_person two[2];
    context *c = *state;
    sherf_image photo = picture(c, N, N, 3), mask;
    for (int i = 0; i < N * N; i++) photo.data[3 * i + (i % N < N / 2)] = 0.8f; /* green left, red right */
    for (int k = 0; k < 2; k++) {
        two[k] = (photo_person){.score = 1, .region = {{N / 2, N / 2}, N, 0}};
        for (int i = 0; i < LANDMARKS; i++) {
            two[k].landmark[i].place_px[0] = k ? 72 : 24;
            two[k].landmark[i].place_px[1] = (float)(10 + 2 * i);
        }
        for (int i = 0; i < PERSON_MASK_SIDE * PERSON_MASK_SIDE; i++)
            two[k].inside[i] = i / 256 > 20 && i / 256 < 236 && i % 256 > 20 && i % 256 < 236 ? 0.97f : 0.01f;
    }
    for (int k = 0; k < 2; k++) {
        assert_ok(c, person_mask(c, &photo, &two[k], &two[!k], 1, &mask, NULL));
        for (int y = 20; y < 76; y++) {
            assert_true(mask.data[y * N + (k ? 72 : 24)] > 0.9f);
            assert_true(mask.data[y * N + (k ? 24 : 72)] < 0.1f);
        }
        sherf_image_free(&mask);
    }
    sherf_image_free(&photo);
}

static void test_clean(void **state) {
    enum { N = 64 };
    context *c = *state;
    float value[N * N] = {0}, prior[N * N] = {0};
    for (int y = 0; y < N; y++)
        for (int x = 0; x < N; x++) {
            const bool body = x >= 10 && x < 40 && y >= 10 && y < 50;
            const bool small = x >= 20 && x < 22 && y == 20, unseen = x >= 14 && x < 24 && y >= 30 && y < 40;
            const bool real = x >= 28 && x < 38 && y >= 30 && y < 40;
            value[y * N + x] = body && !small && !unseen && !real;
            prior[y * N + x] = body && !real;
            if (x >= 55 && x < 58 && y >= 5 && y < 8) value[y * N + x] = 1; /* an island */
            if (x >= 45 && x < 52 && y >= 20 && y < 30)
                value[y * N + x] = 1;                                  /* such as a foot: 7 % of the rest */
            if (x == 60 && y > 40) value[y * N + x] = 0.3f;            /* soft and far away */
            if (x == 41 && y < 50 && y >= 10) value[y * N + x] = 0.3f; /* soft and at the body */
        }
    assert_ok(c, mask_clean(c, N, N, prior, 1, value));
    assert_true(value[20 * N + 20] == 1 && value[35 * N + 18] == 1 && value[35 * N + 33] == 0);
    assert_true(value[6 * N + 56] == 0 && value[25 * N + 48] == 1);
    assert_true(value[45 * N + 60] == 0 && value[30 * N + 41] == 0.3f);
}

/* A plane over colour is reproduced, for any weights. */
static void test_guided(void **state) {
    enum { A = 70, B = 150 };
    context *c = *state;
    sherf_image guide = picture(c, A, B, 3), value = picture(c, A, B, 1), weight = picture(c, A, B, 1);
    float *planes = mem_alloc(c, A * B, 4 * sizeof *planes);
    for (int i = 0; i < A * B; i++) {
        float *I = guide.data + 3 * i;
        for (int k = 0; k < 3; k++) I[k] = 0.5f + noise(i % A, i / A, k);
        value.data[i] = 0.3f * I[0] - 0.5f * I[1] + 0.2f * I[2] + 0.4f;
        weight.data[i] = 0.02f + (float)(i % 7);
    }
    assert_ok(c, guided_fit(c, &guide, value.data, weight.data, 5, 1e-9f, planes));
    for (int i = 0; i < A * B; i++)
        assert_float_equal(guided_value(planes + 4 * i, guide.data + 3 * i), value.data[i], 2e-6);
    mem_free(planes);
    sherf_image_free(&guide), sherf_image_free(&value), sherf_image_free(&weight);
}

/* An uncertain pixel follows its colour, even if no plane over colour separates: black and white belong to
 * the person, grey does not. */
static void test_local_color(void **state) {
    enum { N = 60 };
    context *c = *state;
    sherf_image p = picture(c, N, N, 3), value = picture(c, N, N, 1);
    for (int i = 0; i < N * N; i++) {
        const int x = i % N, y = i / N;
        for (int k = 0; k < 3; k++) p.data[3 * i + k] = x >= 30 ? 0.5f : (x + y) % 2 ? 0.05f : 0.95f;
        value.data[i] = x < 26 ? 0.999f : x >= 34 ? 0.001f : 0.5f;
    }
    assert_ok(c, local_color_sharpen(c, &p, 10, value.data));
    for (int i = 0; i < N * N; i++) assert_true(i % N < 30 ? value.data[i] > 0.95f : value.data[i] < 0.05f);
    sherf_image_free(&p), sherf_image_free(&value);
}

/* The edge has the person's own colour instead of the mixture; inside and outside nothing changes. */
static void test_rim_colors(void **state) {
    context *c = *state;
    sherf_image photo = picture(c, 80, 60, 3), mask = picture(c, 80, 60, 1), out;
    for (int i = 0; i < 80 * 60; i++) {
        const double r = hypot(i % 80 - 40, i / 80 - 30);
        mask.data[i] = r < 18 ? 1 : r > 22 ? 0 : (float)(22 - r) / 4;
        for (int k = 0; k < 3; k++)
            photo.data[3 * i + k] = mask.data[i] * (k ? 0.3f : 0.8f) + (1 - mask.data[i]) * (float)(k == 1);
    }
    assert_ok(c, mask_free_colors(c, &photo, &mask, &out));
    for (int i = 0; i < 80 * 60; i++)
        for (int k = 0; k < 3; k++) {
            if (mask.data[i] > 0.01f) assert_float_equal(out.data[3 * i + k], k ? 0.3f : 0.8f, 1e-5);
            if (mask.data[i] == 0) assert_float_equal(out.data[3 * i + k], photo.data[3 * i + k], 0);
        }
    sherf_image_free(&out);
    mask.width--;
    assert_int_equal(mask_free_colors(c, &photo, &mask, &out), SHERF_BAD_ARGUMENT);
    assert_null(out.data);
    sherf_image_free(&photo), sherf_image_free(&mask);
}

static void test_without_memory(void **state) {
    enum { N = 32 };
    context *c = *state;
    sherf_image photo = picture(c, N, N, 3), mask, colors;
    person = (photo_person){.score = 1, .region = {{N / 2, N / 2}, N, 0}};
    for (int i = 0; i < PERSON_MASK_SIDE * PERSON_MASK_SIDE; i++)
        person.inside[i] = hypot(i % 256 - 128, i / 256 - 128) < 80;
    for (long n = 0;; n++) {
        size_t live = mem_live();
        long before = mem_count();
        mem_fail_after(n);
        sherf_status status = person_mask(c, &photo, &person, NULL, 0, &mask, NULL);
        if (status == SHERF_OK) {
            status = mask_free_colors(c, &photo, &mask, &colors);
            sherf_image_free(&colors);
        }
        mem_fail_after(-1);
        sherf_image_free(&mask);
        assert_int_equal(mem_live(), live);
        if (mem_count() - before <= n) break;
        assert_int_equal(status, SHERF_NO_MEMORY);
    }
    sherf_image_free(&photo);
}

static int setup(void **state) {
    *state = test_context();
    return 0;
}
static int teardown(void **state) {
    sherf_context_free(*state);
    return mem_live() == 0 ? 0 : -1;
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_overlap),    cmocka_unit_test(test_region),
        cmocka_unit_test(test_others),     cmocka_unit_test(test_clean),
        cmocka_unit_test(test_guided),     cmocka_unit_test(test_local_color),
        cmocka_unit_test(test_rim_colors), cmocka_unit_test(test_without_memory)};
    return cmocka_run_group_tests(tests, setup, teardown);
}
