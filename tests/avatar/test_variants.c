/* Tests of variants: other guesses of unseen parts, which do not change the seen ones. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "avatar/detail.h"
#include "demo_scene.h"

enum { SIDE = 256 };

/* From azimuth 0 (as observed) or pi, round the pelvis. */
static void render(scene *s, bool behind, sherf_frame *out) {
    const sherf_render_options o = {.samples = SHERF_SAMPLES_MODEL};
    float joints[72];
    sherf_camera k = s->camera;
    assert_ok(s->c, sherf_body_pose(s->c, s->body, sherf_avatar_pose(s->avatar), NULL, joints));
    for (int i = 0; i < 3 && behind; i++) { /* turns x and z of the world about the pelvis */
        k.R[3 * i] *= -1;
        k.R[3 * i + 2] *= -1;
        k.T_m[i] += 2 * (s->camera.R[3 * i] * joints[0] + s->camera.R[3 * i + 2] * joints[2]);
    }
    assert_ok(s->c, sherf_render(s->c, s->avatar, s->body, sherf_avatar_pose(s->avatar), &k, &o, out));
}

static void render_variant(scene *s, uint64_t variant, bool behind, sherf_frame *out) {
    assert_ok(s->c, sherf_avatar_choose(s->c, s->avatar, variant));
    render(s, behind, out);
}

/* PSNR over pixels where either shows the person. */
static double psnr(const sherf_frame *a, const sherf_frame *b) {
    double sum = 0;
    size_t count = 0;
    for (size_t n = 0; n < SIDE * SIDE; n++) {
        if (!(a->opacity.data[n] > 0 || b->opacity.data[n] > 0)) continue;
        count += 3;
        for (size_t k = 3 * n; k < 3 * n + 3; k++) sum += pow((double)a->color.data[k] - b->color.data[k], 2);
    }
    assert_true(count > 3000);
    return -10 * log10(sum / (double)count + 1e-12);
}

static void variants_differ_in_what_was_not_seen_alone(void **state) {
    scene s;
    sherf_frame best[2] = {0}, one = {0}, again = {0};
    double far = 99;
    open_scene_of(&s, SHERF_PRECISION_AUTO, "thuman:../assets/demo#person_900006/0/2");
    for (int behind = 0; behind < 2; behind++) render(&s, behind, &best[behind]);
    for (uint64_t v = 1; v <= 4; v++) {
        render_variant(&s, v, false, &one);
        if (!(psnr(&one, &best[0]) > 40))
            fail_msg("variant %d: %g dB of what was seen", (int)v, psnr(&one, &best[0]));
        render_variant(&s, v, true, &one);
        far = fmin(far, psnr(&one, &best[1]));
        render_variant(&s, v, true, &again);
        assert_memory_equal(one.color.data, again.color.data, 3 * SIDE * SIDE * sizeof(float));
    }
    if (!(far < 30)) fail_msg("the most different of four backs is at %g dB", far);
    render_variant(&s, 0, true, &again);
    assert_memory_equal(best[1].color.data, again.color.data, 3 * SIDE * SIDE * sizeof(float));
    for (int behind = 0; behind < 2; behind++) sherf_frame_free(&best[behind]);
    sherf_frame_free(&one);
    sherf_frame_free(&again);
    close_scene(&s);
}

/* In an existing file, replaces `from` by `to`, which has the same length. */
static void replace_in_file(const char *path, const char *from, const char *to) {
    FILE *f = fopen(path, "rb");
    assert_non_null(f);
    assert_int_equal(fseek(f, 0, SEEK_END), 0);
    const size_t size = (size_t)ftell(f);
    char *bytes = malloc(size), *at;
    assert_non_null(bytes);
    rewind(f);
    assert_int_equal(fread(bytes, 1, size, f), size);
    fclose(f);
    assert_non_null(at = memmem(bytes, size, from, strlen(from)));
    memcpy(at, to, strlen(to));
    assert_non_null(f = fopen(path, "wb"));
    assert_int_equal(fwrite(bytes, 1, size, f), size);
    fclose(f);
    free(bytes);
}

static void files_keep_the_variant(void **state) {
    const uint64_t seed = 18446744073709551557u;
    static const char *const bad[] = {"1844674407370955155x", "-8446744073709551557", "98446744073709551557"};
    scene s;
    sherf_avatar *read = NULL;
    char path[256];
    snprintf(path, sizeof path, "%s", test_path("variant"));
    open_scene(&s, SHERF_PRECISION_AUTO);
    assert_int_equal(sherf_avatar_variant(s.avatar), 0);
    assert_ok(s.c, sherf_avatar_choose(s.c, s.avatar, seed));
    for (int i = 0; i <= 3; i++) {
        assert_ok(s.c, sherf_avatar_save(s.c, s.avatar, path));
        if (i < 3) {
            replace_in_file(path, "18446744073709551557", bad[i]);
            assert_int_equal(sherf_avatar_load(s.c, path, s.body, &read), SHERF_BAD_FILE);
            assert_non_null(strstr(sherf_message(s.c), "variant"));
            continue;
        }
        assert_ok(s.c, sherf_avatar_load(s.c, path, s.body, &read));
        assert_true(sherf_avatar_variant(read) == seed);
        sherf_avatar_free(read);
    }
    close_scene(&s);
}

static void baked_avatars_keep_theirs(void **state) {
    static const avatar_form form = {.name = "baked"};
    context *c;
    sherf_avatar *a;
    assert_int_equal(sherf_context_create(NULL, &c), SHERF_OK);
    assert_non_null(a = mem_zero(c, 1, sizeof *a));
    a->form = &form;
    assert_int_equal(sherf_avatar_choose(c, a, 3), SHERF_UNSUPPORTED);
    mem_free(a);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(variants_differ_in_what_was_not_seen_alone),
                                       cmocka_unit_test(files_keep_the_variant),
                                       cmocka_unit_test(baked_avatars_keep_theirs)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
