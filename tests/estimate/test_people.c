/* People in pictures made by rule: found, with their landmarks where the truth has the joints, and nobody
 * where nobody is. */
#include "scene.h"

#include "estimate/landmarks.h"

/* The shoulders, elbows, wrists, hips, knees and ankles: landmark and joint. */
static const int pair[][2] = {
    {LANDMARK_LEFT_SHOULDER, 16}, {LANDMARK_RIGHT_SHOULDER, 17}, {LANDMARK_LEFT_ELBOW, 18},
    {LANDMARK_RIGHT_ELBOW, 19},   {LANDMARK_LEFT_WRIST, 20},     {LANDMARK_RIGHT_WRIST, 21},
    {LANDMARK_LEFT_HIP, 1},       {LANDMARK_RIGHT_HIP, 2},       {LANDMARK_LEFT_KNEE, 4},
    {LANDMARK_RIGHT_KNEE, 5},     {LANDMARK_LEFT_ANKLE, 7},      {LANDMARK_RIGHT_ANKLE, 8}};
static const char front[] = "thuman:../assets/demo#person_900006/0/0",
                  walking[] = "thuman:../assets/demo#person_900006/2/3";

static pose_networks *networks;

/* Mean distance, as a part of the joints' height in the picture. */
static double error_of(const photo_person *p, float (*joint_px)[2]) {
    double sum = 0, top = 1e9, low = -1e9;
    for (size_t i = 0; i < COUNT_OF(pair); i++) {
        const float *have = p->landmark[pair[i][0]].place_px, *want = joint_px[pair[i][1]];
        sum += hypot(have[0] - want[0], have[1] - want[1]) / COUNT_OF(pair);
    }
    for (int i = 0; i < 24; i++) {
        top = fmin(top, joint_px[i][1]);
        low = fmax(low, joint_px[i][1]);
    }
    return sum / (low - top);
}

static int find(context *c, const sherf_image *photo, photo_person **people) {
    int count;
    assert_ok(c, people_find(c, networks, photo, PEOPLE_MOST, people, &count));
    assert_true((count == 0) == (*people == NULL));
    return count;
}

/* Share of the joints' neighbourhood that is inside, and of the picture's corners that is outside. */
static void mask_fits(const photo_person *p, float (*joint_px)[2]) {
    int inside = 0, corners = 0;
    for (size_t i = 0; i < COUNT_OF(pair); i++) {
        const photo_region *r = &p->region;
        const float x = joint_px[pair[i][1]][0] - r->centre_px[0],
                    y = joint_px[pair[i][1]][1] - r->centre_px[1];
        const float u = (cosf(r->angle_rad) * x + sinf(r->angle_rad) * y) / r->side_px + .5f,
                    v = (cosf(r->angle_rad) * y - sinf(r->angle_rad) * x) / r->side_px + .5f;
        assert_true(u > 0 && u < 1 && v > 0 && v < 1);
        inside +=
            p->inside[(int)(v * PERSON_MASK_SIDE) * PERSON_MASK_SIDE + (int)(u * PERSON_MASK_SIDE)] > .5f;
    }
    for (int i = 0; i < 4; i++)
        corners += p->inside[(i / 2 * (PERSON_MASK_SIDE - 8) + 4) * PERSON_MASK_SIDE +
                             i % 2 * (PERSON_MASK_SIDE - 8) + 4] < .1f;
    assert_true(inside >= 10);
    assert_int_equal(corners, 4);
}

static void from_all_sides(void **state) {
    context *c = *state;
    double sum = 0;
    for (int view = 0; view < 4; view += 2) {
        char name[64];
        float joint_px[24][2];
        sherf_image p;
        photo_person *people;
        snprintf(name, sizeof name, "thuman:../assets/demo#person_900006/2/%d", view);
        draw_room(&p, 640, 640);
        put_person(c, &p, name, 1, 60, 70, joint_px);
        assert_int_equal(find(c, &p, &people), 1);
        const double error = error_of(people, joint_px);
        if (error > .04) fail_msg("view %d: landmarks are %.3f of the height off", view, error);
        sum += error / 2;
        assert_true(people->score > .9f);
        mask_fits(people, joint_px);
        mem_free(people);
        free(p.data);
    }
    if (sum > .03) fail_msg("landmarks are %.3f of the height off", sum);
}

/* 3D landmarks lie under the 2D ones: no turn is forgotten. The person lies on the side. */
static void turned_people(void **state) {
    context *c = *state;
    sherf_image p, turned;
    photo_person *people;
    draw_room(&p, 640, 640);
    put_person(c, &p, front, 1, 60, 70, NULL);
    draw_room(&turned, 640, 640);
    for (int y = 0; y < 640; y++)
        for (int x = 0; x < 640; x++)
            memcpy(turned.data + (size_t)(y * 640 + x) * 3, p.data + (size_t)((639 - x) * 640 + y) * 3,
                   3 * sizeof(float));
    assert_int_equal(find(c, &turned, &people), 1);
    assert_true(fabsf(people->region.angle_rad - 1.57f) < .3f);
    const landmark *l = people->landmark;
    const float side = people->region.side_px, *a = l[LANDMARK_LEFT_SHOULDER].place_px,
                *b = l[LANDMARK_LEFT_ANKLE].place_px;
    const float *am = l[LANDMARK_LEFT_SHOULDER].place_m, *bm = l[LANDMARK_LEFT_ANKLE].place_m;
    assert_true(a[0] - b[0] > .4f * side && fabsf(a[1] - b[1]) < .2f * side);
    assert_true(am[0] - bm[0] > .8f && fabsf(am[1] - bm[1]) < .4f);
    mem_free(people);
    free(p.data);
    free(turned.data);
}

static void small_ones(void **state) {
    context *c = *state;
    float joint_px[24][2];
    sherf_image p;
    photo_person *people;
    draw_room(&p, 900, 1200);
    put_person(c, &p, front, .2, 300, 500, joint_px);
    assert_int_equal(find(c, &p, &people), 1);
    assert_true(error_of(people, joint_px) < .05);
    mem_free(people);
    free(p.data);
}

static void several_largest_first(void **state) {
    context *c = *state;
    float joint_px[3][24][2];
    sherf_image p;
    photo_person *people, *one;
    int count;
    draw_room(&p, 1200, 900);
    put_person(c, &p, walking, .6, 900, 350, joint_px[2]);
    put_person(c, &p, front, 1.4, 0, 100, joint_px[0]);
    put_person(c, &p, walking, .9, 540, 200, joint_px[1]);
    assert_int_equal(find(c, &p, &people), 3);
    for (int i = 0; i < 3; i++)
        if (error_of(&people[i], joint_px[i]) > .05)
            fail_msg("person %d: landmarks are %.3f of the height off", i, error_of(&people[i], joint_px[i]));
    assert_ok(c, people_find(c, networks, &p, 1, &one, &count));
    assert_int_equal(count, 1);
    assert_memory_equal(one, people, sizeof *one);
    mem_free(one);
    mem_free(people);
    free(p.data);
}

static void nobody(void **state) {
    context *c = *state;
    static const int size[][2] = {{320, 240}, {1, 1}, {3, 300}, {20000, 20}};
    sherf_image p;
    photo_person *people;
    int count;
    for (size_t i = 0; i < COUNT_OF(size); i++) {
        draw_noise(&p, size[i][0], size[i][1], i);
        assert_int_equal(find(c, &p, &people), 0);
        free(p.data);
    }
    draw_room(&p, 320, 240);
    assert_int_equal(find(c, &p, &people), 0);
    for (int i = 0; i < 320 * 240 * 3; i++) p.data[i] = NAN;
    assert_int_equal(find(c, &p, &people), 0);
    p.channels = 1;
    assert_int_equal(people_find(c, networks, &p, 1, &people, &count), SHERF_BAD_ARGUMENT);
    assert_int_equal(people_find(c, networks, &p, PEOPLE_MOST + 1, &people, &count), SHERF_BAD_ARGUMENT);
    free(p.data);
}

/* Frame by frame, a person who moves to the right, without the detector; then nobody is there. */
static void tracked(void **state) {
    context *c = *state;
    float joint_px[24][2];
    sherf_image p;
    photo_person *people, now;
    bool there;
    draw_room(&p, 800, 640);
    put_person(c, &p, walking, 1, 60, 70, NULL);
    assert_int_equal(find(c, &p, &people), 1);
    now = *people;
    mem_free(people);
    for (int i = 1; i <= 3; i++) {
        free(p.data);
        draw_room(&p, 800, 640);
        put_person(c, &p, walking, 1, 60 + 25 * i, 70, joint_px);
        assert_ok(c, landmarks_track(c, networks, &p, &now, &now, &there));
        assert_true(there);
        assert_true(error_of(&now, joint_px) < .05);
    }
    free(p.data);
    draw_room(&p, 800, 640);
    assert_ok(c, landmarks_track(c, networks, &p, &now, &now, &there));
    assert_false(there);
    assert_true(now.score < .5f);
    free(p.data);
}

static void same_bits_for_any_threads(void **state) {
    context *c = *state;
    const int threads = c->threads;
    photo_person *people[2];
    sherf_image p;
    draw_room(&p, 500, 640);
    put_person(c, &p, walking, .9, 20, 70, NULL);
    for (int i = 0; i < 2; i++) {
        pose_networks *shared = networks;
        c->threads = i ? 3 : 1;
        assert_ok(c, pose_networks_load(c, networks_path, &networks));
        assert_int_equal(find(c, &p, &people[i]), 1);
        pose_networks_free(networks);
        networks = shared;
    }
    c->threads = threads;
    assert_memory_equal(people[0], people[1], sizeof *people[0]);
    mem_free(people[0]);
    mem_free(people[1]);
    free(p.data);
}

static void no_memory(void **state) {
    context *c = *state;
    sherf_image p;
    photo_person person;
    const photo_region region = {{100, 100}, 300, .3f};
    draw_room(&p, 200, 300);
    for (long n = 0;; n++) {
        const size_t live = mem_live();
        const long before = mem_count();
        mem_fail_after(n);
        sherf_status status = landmarks_find(c, networks, &p, &region, &person);
        mem_fail_after(-1);
        assert_int_equal(mem_live(), live);
        if (mem_count() - before <= n) {
            assert_ok(c, status);
            break;
        }
        assert_int_equal(status, SHERF_NO_MEMORY);
    }
    free(p.data);
}

static int begin(void **state) {
    context *c = test_context();
    *state = c;
    return pose_networks_load(c, networks_path, &networks) == SHERF_OK ? 0 : -1;
}

static int end(void **state) {
    pose_networks_free(networks);
    sherf_context_free(*state);
    return 0;
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(from_all_sides),
        cmocka_unit_test(turned_people),
        cmocka_unit_test(small_ones),
        cmocka_unit_test(several_largest_first),
        cmocka_unit_test(nobody),
        cmocka_unit_test(tracked),
        cmocka_unit_test(same_bits_for_any_threads),
        cmocka_unit_test(no_memory),
    };
    return cmocka_run_group_tests(tests, begin, end);
}
