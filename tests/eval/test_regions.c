/* Tests of separate errors for the parts that the observed picture shows and does not show, on a tube person.
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "eval/regions.h"
#include "tube_people.h"

enum { SIDE = 96, PIXELS = SIDE * SIDE, FRONT = 0, BACK = 3 };

/* Measures the target's own picture with 0.1 added to every value, separately for the parts of the person
 * that view `from` shows and does not show. */
static void measure(context *c, const body_model *body, sherf_dataset *data, int from, int to,
                    region_errors *out) {
    data_view *seen, *target;
    uint8_t *shown;
    static float off[3 * PIXELS];
    assert_ok(c, dataset_view(c, data, 0, 0, from, 0, &seen));
    assert_ok(c, dataset_view(c, data, 0, 0, to, 0, &target));
    for (int i = 0; i < 3 * PIXELS; i++) off[i] = target->image.data[i] + 0.1f;
    assert_ok(c, regions_look(c, body, seen, &shown));
    assert_ok(c, regions_measure(c, body, shown, target, off, out));
    mem_free(shown);
    sherf_observation_free(seen);
    sherf_observation_free(target);
}

static void sides_are_told_apart(void **state) {
    context *c = test_context();
    const char *root = test_path("regions");
    tube_people people;
    sherf_dataset *data;
    body_model *body;
    region_errors same, other, both = {0};
    const sherf_synth_options synth = {.people = 1, .poses = 1, .views = 6, .size_px = SIDE, .seed = 5};
    assert_ok(c, tube_people_make(c, root, &synth, &people));
    assert_ok(c, sherf_dataset_open(c, people.spec, &data));
    assert_ok(c, body_load(c, people.body, &body));
    measure(c, body, data, FRONT, FRONT, &same);
    measure(c, body, data, FRONT, BACK, &other);
    print_message("front: %d pixels seen, %d not; back: %d and %d\n", (int)same.pixels[REGION_SEEN],
                  (int)same.pixels[REGION_UNSEEN], (int)other.pixels[REGION_SEEN],
                  (int)other.pixels[REGION_UNSEEN]);
    assert_true(same.pixels[REGION_SEEN] > 300 && same.pixels[REGION_UNSEEN] < same.pixels[REGION_SEEN] / 4);
    assert_true(other.pixels[REGION_UNSEEN] > 300 &&
                other.pixels[REGION_SEEN] < other.pixels[REGION_UNSEEN] / 4);
    assert_true(same.pixels[REGION_COVERED] <= same.pixels[REGION_UNSEEN]);
    assert_true(fabs(regions_psnr(&same, REGION_SEEN) - 20) < 1e-3);
    assert_true(fabs(regions_psnr(&other, REGION_UNSEEN) - 20) < 1e-3);
    regions_add(&both, &same);
    regions_add(&both, &other);
    assert_int_equal(both.pixels[REGION_SEEN], same.pixels[REGION_SEEN] + other.pixels[REGION_SEEN]);
    assert_true(fabs(regions_psnr(&both, REGION_SEEN) - 20) < 1e-3);
    assert_true(isnan(regions_psnr(&(region_errors){0}, REGION_SEEN)));
    sherf_body_free(body);
    sherf_dataset_free(data);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(sides_are_told_apart)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
