/* Tests of finding people in synthetic pictures: their landmarks are at the true joints, and nobody is found
 * in empty pictures. */
#include "scene.h"

#include "estimate/landmarks.h"
#include "estimate/look.h"

/* The shoulders, elbows, wrists, hips, knees and ankles: landmark and joint. */
static const int pair[][2] = {
    {LANDMARK_LEFT_SHOULDER, 16}, {LANDMARK_RIGHT_SHOULDER, 17}, {LANDMARK_LEFT_ELBOW, 18},
    {LANDMARK_RIGHT_ELBOW, 19},   {LANDMARK_LEFT_WRIST, 20},     {LANDMARK_RIGHT_WRIST, 21},
    {LANDMARK_LEFT_HIP, 1},       {LANDMARK_RIGHT_HIP, 2},       {LANDMARK_LEFT_KNEE, 4},
    {LANDMARK_RIGHT_KNEE, 5},     {LANDMARK_LEFT_ANKLE, 7},      {LANDMARK_RIGHT_ANKLE, 8}};
static const char standing[] = "thuman:../assets/demo#person_900006/0/0",
                  walking[] = "thuman:../assets/demo#person_900006/2/3";
static const char *const side[] = {"thuman:../assets/demo#person_900006/2/2",
                                   "thuman:../assets/demo#person_900006/2/0"};
enum { FRONT, BACK, SIDES, ROOM = 480 };

/* Made once: a person from both sides, and what the networks see of them. */
static pose_networks *networks;
static sherf_image seen_photo[SIDES];
static float seen_joint_px[SIDES][24][2];
static photo_person *seen[SIDES];

/* The mean distance, relative to the height of the joints in the picture. */
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
    assert_ok(c, people_find(c, networks, photo, PHOTO_PEOPLE_MAX, people, &count));
    assert_true((count == 0) == (*people == NULL));
    return count;
}

/* The share of the joints' neighbourhood that is inside, and of the picture's corners that is outside. */
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

static void front_and_back(void **state) {
    double sum = 0;
    for (int i = 0; i < SIDES; i++) {
        const double error = error_of(seen[i], seen_joint_px[i]);
        if (error > .04) fail_msg("side %d: landmarks are %.3f of the height off", i, error);
        sum += error / SIDES;
        assert_true(seen[i]->score > .9f);
        mask_fits(seen[i], seen_joint_px[i]);
        /* joints 16 and 17, the shoulders: the left one is on the right if the person faces the camera */
        const float apart_px = seen_joint_px[i][16][0] - seen_joint_px[i][17][0];
        assert_true(i == FRONT ? apart_px > 20 : apart_px < -20);
        const landmark *left = &seen[i]->landmark[LANDMARK_LEFT_SHOULDER],
                       *right = &seen[i]->landmark[LANDMARK_RIGHT_SHOULDER];
        assert_true(fabsf(left->place_px[0] - right->place_px[0] - apart_px) < 15);
        assert_true(i == FRONT ? left->place_m[0] - right->place_m[0] > .15f
                               : left->place_m[0] - right->place_m[0] < -.15f);
    }
    if (sum > .03) fail_msg("landmarks are %.3f of the height off", sum);
}

/* The mirrored photo gives the mirrored person, with left and right exchanged. */
static void mirrored(void **state) {
    context *c = *state;
    sherf_image p;
    photo_person *people;
    double apart_px = 0, apart_m = 0;
    draw_room(&p, ROOM, ROOM);
    for (int y = 0; y < ROOM; y++)
        for (int x = 0; x < ROOM; x++)
            memcpy(p.data + (size_t)(y * ROOM + x) * 3,
                   seen_photo[BACK].data + (size_t)(y * ROOM + ROOM - 1 - x) * 3, 3 * sizeof(float));
    assert_int_equal(find(c, &p, &people), 1);
    for (size_t k = 0; k < COUNT_OF(pair); k++) {
        const int l = pair[k][0], other = l % 2 ? l + 1 : l - 1;
        const landmark *a = &people->landmark[l], *b = &seen[BACK]->landmark[other];
        apart_px += hypot(a->place_px[0] - (ROOM - 1 - b->place_px[0]), a->place_px[1] - b->place_px[1]);
        apart_m += hypot(hypot(a->place_m[0] + b->place_m[0], a->place_m[1] - b->place_m[1]),
                         a->place_m[2] - b->place_m[2]);
    }
    apart_px /= COUNT_OF(pair);
    apart_m /= COUNT_OF(pair);
    if (apart_px > 3 || apart_m > .03) fail_msg("%.2f pixels and %.4f m between the two", apart_px, apart_m);
    mem_free(people);
    free(p.data);
}

/* A person whose front was taken for the back is turned back; nobody else changes. */
static void turned_back_without_the_head(void **state) {
    context *c = *state;
    for (int i = 0; i < SIDES; i++) {
        photo_person p = *seen[i];
        assert_ok(c, look_without_head(c, networks, &seen_photo[i], &p));
        assert_memory_equal(&p, seen[i], sizeof p);
        for (int l = LANDMARK_LEFT_EAR; l < LANDMARKS; l++)
            p.landmark[l] = seen[i]->landmark[l % 2 ? l + 1 : l - 1];
        assert_ok(c, look_without_head(c, networks, &seen_photo[i], &p));
        const double error = error_of(&p, seen_joint_px[i]);
        if (error > .05) fail_msg("side %d: landmarks are %.3f of the height off", i, error);
        assert_memory_equal(p.inside, seen[i]->inside, sizeof p.inside);
    }
}

/* 3D landmarks match the 2D ones: no rotation is lost. The person lies on the side. */
static void turned_people(void **state) {
    context *c = *state;
    sherf_image turned;
    photo_person *people;
    draw_room(&turned, ROOM, ROOM);
    for (int y = 0; y < ROOM; y++)
        for (int x = 0; x < ROOM; x++)
            memcpy(turned.data + (size_t)(y * ROOM + x) * 3,
                   seen_photo[FRONT].data + (size_t)((ROOM - 1 - x) * ROOM + y) * 3, 3 * sizeof(float));
    assert_int_equal(find(c, &turned, &people), 1);
    assert_true(fabsf(people->region.angle_rad - 1.57f) < .3f);
    const landmark *l = people->landmark;
    const float length = people->region.side_px, *a = l[LANDMARK_LEFT_SHOULDER].place_px,
                *b = l[LANDMARK_LEFT_ANKLE].place_px;
    const float *am = l[LANDMARK_LEFT_SHOULDER].place_m, *bm = l[LANDMARK_LEFT_ANKLE].place_m;
    assert_true(a[0] - b[0] > .4f * length && fabsf(a[1] - b[1]) < .2f * length);
    assert_true(am[0] - bm[0] > .8f && fabsf(am[1] - bm[1]) < .4f);
    mem_free(people);
    free(turned.data);
}

/* Visible only in squares of a quarter of the longer side. */
static void small_ones(void **state) {
    context *c = *state;
    float joint_px[24][2];
    sherf_image p;
    photo_person *people;
    draw_room(&p, 800, 300);
    put_person(c, &p, standing, .2, 300, 120, joint_px);
    assert_int_equal(find(c, &p, &people), 1);
    assert_true(error_of(people, joint_px) < .05);
    mem_free(people);
    free(p.data);
}

/* The largest person comes first; the same bits for any number of threads and of requested people. */
static void several(void **state) {
    context *c = *state;
    const int threads = c->threads;
    float joint_px[2][24][2];
    sherf_image p;
    photo_person *people, *one;
    pose_networks *shared = networks;
    int count;
    draw_room(&p, 800, 600);
    put_person(c, &p, walking, .6, 420, 133, joint_px[1]);
    put_person(c, &p, standing, .93, 0, 67, joint_px[0]);
    c->threads = 1;
    assert_int_equal(find(c, &p, &people), 2);
    for (int i = 0; i < 2; i++)
        if (error_of(&people[i], joint_px[i]) > .05)
            fail_msg("person %d: landmarks are %.3f of the height off", i, error_of(&people[i], joint_px[i]));
    c->threads = 3;
    assert_ok(c, pose_networks_load(c, networks_path, &networks));
    assert_ok(c, people_find(c, networks, &p, 1, &one, &count));
    pose_networks_free(networks);
    networks = shared;
    c->threads = threads;
    assert_int_equal(count, 1);
    assert_memory_equal(one, people, sizeof *one);
    mem_free(one);
    mem_free(people);
    free(p.data);
}

static void nobody(void **state) {
    context *c = *state;
    static const int size[][2] = {{320, 80}, {1, 1}, {3, 300}, {20000, 20}};
    sherf_image p;
    photo_person *people;
    int count;
    for (size_t i = 0; i < COUNT_OF(size); i++) {
        draw_noise(&p, size[i][0], size[i][1], i);
        assert_int_equal(find(c, &p, &people), 0);
        free(p.data);
    }
    draw_room(&p, 320, 80);
    assert_int_equal(find(c, &p, &people), 0);
    free(p.data);
    draw_room(&p, 80, 60);
    for (int i = 0; i < 80 * 60 * 3; i++) p.data[i] = NAN;
    assert_int_equal(find(c, &p, &people), 0);
    p.channels = 1;
    assert_int_equal(people_find(c, networks, &p, 1, &people, &count), SHERF_BAD_ARGUMENT);
    assert_int_equal(people_find(c, networks, &p, PHOTO_PEOPLE_MAX + 1, &people, &count), SHERF_BAD_ARGUMENT);
    free(p.data);
}

/* The tracker follows a person who moves to the right frame by frame, without the detector; then nobody is
 * there. */
static void tracked(void **state) {
    context *c = *state;
    float joint_px[24][2];
    sherf_image p;
    photo_person now = *seen[FRONT];
    bool there;
    for (int i = 1; i <= 2; i++) {
        draw_room(&p, ROOM, ROOM);
        put_person(c, &p, side[FRONT], .75, 45 + 18 * i, 50, joint_px);
        assert_ok(c, landmarks_track(c, networks, &p, &now, &now, &there));
        assert_true(there);
        assert_true(error_of(&now, joint_px) < .05);
        free(p.data);
    }
    draw_room(&p, ROOM, ROOM);
    assert_ok(c, landmarks_track(c, networks, &p, &now, &now, &there));
    assert_false(there);
    assert_true(now.score < .5f);
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
    if (pose_networks_load(c, networks_path, &networks) != SHERF_OK) return -1;
    for (int i = 0; i < SIDES; i++) {
        draw_room(&seen_photo[i], ROOM, ROOM);
        put_person(c, &seen_photo[i], side[i], .75, 45, 50, seen_joint_px[i]);
        assert_int_equal(find(c, &seen_photo[i], &seen[i]), 1);
    }
    return 0;
}

static int end(void **state) {
    for (int i = 0; i < SIDES; i++) {
        free(seen_photo[i].data);
        mem_free(seen[i]);
    }
    pose_networks_free(networks);
    scene_free();
    sherf_context_free(*state);
    return 0;
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(front_and_back), cmocka_unit_test(turned_back_without_the_head),
        cmocka_unit_test(mirrored),       cmocka_unit_test(turned_people),
        cmocka_unit_test(small_ones),     cmocka_unit_test(several),
        cmocka_unit_test(nobody),         cmocka_unit_test(tracked),
        cmocka_unit_test(no_memory),
    };
    return cmocka_run_group_tests(tests, begin, end);
}
