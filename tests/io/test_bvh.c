/* Tests of BVH files: their contents, and what hostile files must not be able to do. */
#include "support.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "data/bvh_body.h"
#include "io/bvh.h"

static const char small[] =
    "HIERARCHY\nROOT Hips\n{\n  OFFSET 0 1 0\n"
    "  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation\n"
    "  JOINT Left Arm\n  {\n    OFFSET 0 1.5 0\n    CHANNELS 3 Zrotation Xrotation Yrotation\n"
    "    End Site\n    {\n      OFFSET 0 1 0\n    }\n  }\n}\n"
    "MOTION\nFrames: 2\nFrame Time: .0083333\n"
    "0 0 0 0 0 0 0 0 0\n1 2 3 90 0 0 0 90 0\n";

static void test_small(void **state) {
    context *c = test_context();
    bvh *b;
    assert_ok(c, bvh_parse(c, (const unsigned char *)small, strlen(small), &b));
    assert_int_equal(b->joints, 3);
    assert_int_equal(b->channels, 9);
    assert_int_equal(b->frames, 2);
    assert_string_equal(b->joint[1].name, "Left Arm");
    assert_int_equal(b->joint[2].parent, 1);
    assert_true(b->joint[2].end);
    assert_int_equal(bvh_find(b, "Left Arm"), 1);
    assert_int_equal(bvh_find(b, "Right Arm"), -1);
    double root[3], local[27], global[27];
    bvh_root_position(b, 1, root);
    assert_float_equal(root[0], 1, 1e-6);
    assert_float_equal(root[2], 3, 1e-6);
    bvh_rotations(b, 1, local, global);
    /* Z by 90 degrees takes x to y; then X by 90 takes y to z. Together: x to y, y to z, z to x. */
    static const double turned[9] = {0, 0, 1, 1, 0, 0, 0, 1, 0};
    for (int i = 0; i < 9; i++) {
        assert_float_equal(global[9 + i], turned[i], 1e-6);
        assert_float_equal(global[18 + i], turned[i], 1e-6); /* an end site moves along */
    }
    bvh_rotations(b, 0, NULL, global);
    for (int i = 0; i < 27; i++) assert_float_equal(global[i], (i % 9 % 4 == 0 ? 1.0 : 0.0), 1e-9);
    bvh_free(b);
    sherf_context_free(c);
}

/* A file truncated anywhere is refused with a message, and nothing leaks. Only the last number may lose
 * digits. */
static void test_truncated(void **state) {
    context *c = test_context();
    size_t live = mem_live(), whole = strlen(small);
    for (size_t n = 0; n + 2 < whole; n++) {
        bvh *b;
        char *copy = malloc(n + 1); /* in its own block, so that the sanitizer sees reads past the end */
        memcpy(copy, small, n);
        c->message[0] = 0;
        assert_int_equal(bvh_parse(c, (const unsigned char *)copy, n, &b), SHERF_BAD_FILE);
        assert_null(b);
        assert_true(c->message[0]);
        free(copy);
    }
    assert_int_equal(mem_live(), live);
    sherf_context_free(c);
}

static bvh *parsed(context *c, const char *from, const char *to) {
    char text[sizeof small + 300];
    const char *at = strstr(small, from);
    bvh *b;
    assert_non_null(at);
    snprintf(text, sizeof text, "%.*s%s%s", (int)(at - small), small, to, at + strlen(from));
    assert_ok(c, bvh_parse(c, (const unsigned char *)text, strlen(text), &b));
    return b;
}

/* Decimal commas of a locale, a recording that was cut off, and two bytes per character. */
static void test_texts(void **state) {
    context *c = test_context();
    bvh *b = parsed(c, "OFFSET 0 1.5 0", "OFFSET 0,000 1,5 -2,25");
    assert_true(b->joint[1].offset[1] == 1.5 && b->joint[1].offset[2] == -2.25);
    bvh_free(b);
    b = parsed(c, "Frames: 2", "Frames: 3"); /* two of three frames */
    assert_int_equal(b->frames, 2);
    assert_float_equal(b->value[12], 90, 0);
    bvh_free(b);
    b = parsed(c, "0 0 0 0 0 0 0 0 0\n1 2 3 90", "0 0 0 0 0 0 0 0 0\n0 0 0 0 0 0 0 0 0\n1 2 3 90");
    assert_int_equal(b->frames, 2); /* more frames than announced: only the announced ones are read */
    assert_float_equal(b->value[12], 0, 0);
    bvh_free(b);
    for (int big = 0; big < 2; big++) {
        unsigned char wide[2 * sizeof small + 2] = {big ? 0xfe : 0xff, big ? 0xff : 0xfe};
        for (size_t i = 0; i < sizeof small - 1; i++) wide[2 * i + 2 + (size_t)big] = (unsigned char)small[i];
        assert_ok(c, bvh_parse(c, wide, 2 * sizeof small, &b));
        assert_string_equal(b->joint[1].name, "Left Arm");
        assert_int_equal(b->frames, 2);
        bvh_free(b);
    }
    sherf_context_free(c);
}

static void refused(context *c, const char *from, const char *to, const char *word) {
    char text[sizeof small + 200];
    const char *at = strstr(small, from);
    bvh *b;
    assert_non_null(at);
    snprintf(text, sizeof text, "%.*s%s%s", (int)(at - small), small, to, at + strlen(from));
    assert_int_equal(bvh_parse(c, (const unsigned char *)text, strlen(text), &b), SHERF_BAD_FILE);
    if (!strstr(c->message, word)) fail_msg("\"%s\" does not say \"%s\"", c->message, word);
}

static void test_hostile(void **state) {
    context *c = test_context();
    refused(c, "Frames: 2", "Frames: 16000000", "ends before");
    refused(c, "Frames: 2", "Frames: 99999999999", "a number");
    refused(c, "Frames: 2", "Frames: -1", "number of frames");
    refused(c, "Frames: 2", "Frames: 0", "no frames");
    refused(c, "CHANNELS 6", "CHANNELS 60", "channels");
    refused(c, "CHANNELS 3", "CHANNELS 3.5", "channels");
    refused(c, "Zrotation Xr", "Wrotation Xr", "channel");
    refused(c, "OFFSET 0 1.5 0", "OFFSET 0 nan 0", "number");
    refused(c, "OFFSET 0 1.5 0", "OFFSET 0 1e999 0", "number");
    refused(c, ".0083333", "-1", "frame takes");
    refused(c, "1 2 3 90", "1 2 x 90", "number");
    refused(c, "End Site", "End Sight", "Site");
    refused(c, "JOINT Left Arm", "JOINT \n", "name");
    sherf_context_free(c);
}

/* Too many joints, or joints nested too deep. */
static void test_many(void **state) {
    context *c = test_context();
    size_t room = 200000, n = 0;
    char *text = malloc(room);
    bvh *b;
    for (int deep = 0; deep < 2; deep++) {
        n = (size_t)snprintf(text, room, "HIERARCHY ROOT a {");
        for (int i = 0; i < 3000; i++)
            n += (size_t)snprintf(text + n, room - n,
                                  deep ? " JOINT b { OFFSET 0 0 0" : " JOINT b { OFFSET 0 0 0 }");
        assert_int_equal(bvh_parse(c, (const unsigned char *)text, n, &b), SHERF_BAD_FILE);
        assert_non_null(strstr(c->message, deep ? "deep" : "more than"));
    }
    free(text);
    sherf_context_free(c);
}

/* ---- onto the body ---- */

static const struct {
    const char *name;
    int parent;
    double offset[3];
} skeleton[] = {
    {"Hips", -1, {0, 0, 0}},          {"LeftUpLeg", 0, {1, -1, 0}},   {"LeftLeg", 1, {2, -6, 0}},
    {"LeftFoot", 2, {2, -6, 0}},      {"RightUpLeg", 0, {-1, -1, 0}}, {"RightLeg", 4, {-2, -6, 0}},
    {"RightFoot", 5, {-2, -6, 0}},    {"Spine", 0, {0, 2, 0}},        {"LeftArm", 7, {3, 4, 0}},
    {"LeftForeArm", 8, {0, -5, 0}},   {"LeftHand", 9, {0, -4, 0}},    {"RightArm", 7, {-3, 4, 0}},
    {"RightForeArm", 11, {0, -5, 0}}, {"RightHand", 12, {0, -4, 0}}};

/* A file whose rest pose has the arms down and the legs apart: at rest, the body's bones point in the
 * directions of the file's. */
static void test_retarget(void **state) {
    context *c = test_context();
    bvh_joint joint[COUNT_OF(skeleton)] = {0};
    float degrees[3 * COUNT_OF(skeleton)] = {0};
    for (size_t i = 0; i < COUNT_OF(skeleton); i++) {
        strcpy(joint[i].name, skeleton[i].name);
        joint[i].parent = skeleton[i].parent;
        memcpy(joint[i].offset, skeleton[i].offset, sizeof joint[i].offset);
        joint[i].first = (int)(3 * i), joint[i].channels = 3;
        for (int k = 0; k < 3; k++) joint[i].channel[k] = (uint8_t)(BVH_Z_ROTATION - k);
    }
    bvh b = {.joints = COUNT_OF(skeleton),
             .channels = 3 * COUNT_OF(skeleton),
             .frames = 1,
             .frame_time_s = 0.01,
             .joint = joint,
             .value = degrees};
    float rest[BODY_JOINTS][3] = {0};
    static const struct {
        int joint;
        float at[3];
    } places[] = {{1, {0.1f, -0.1f, 0}},  {4, {0.1f, -0.5f, 0}},   {7, {0.1f, -0.9f, 0}},
                  {2, {-0.1f, -0.1f, 0}}, {5, {-0.1f, -0.5f, 0}},  {8, {-0.1f, -0.9f, 0}},
                  {16, {0.2f, 0.4f, 0}},  {18, {0.45f, 0.4f, 0}},  {20, {0.7f, 0.4f, 0}},
                  {17, {-0.2f, 0.4f, 0}}, {19, {-0.45f, 0.4f, 0}}, {21, {-0.7f, 0.4f, 0}}};
    for (size_t i = 0; i < COUNT_OF(places); i++) memcpy(rest[places[i].joint], places[i].at, sizeof rest[0]);
    bvh_body map;
    float pose[72], R[9];
    assert_ok(c, bvh_body_match(c, &b, NULL, (const float(*)[3])rest, &map));
    bvh_body_pose(&b, &map, 0, pose);
    rodrigues(pose + 3 * 16, R); /* the left arm, along x, hangs down */
    assert_float_equal(R[0], 0, 1e-5);
    assert_float_equal(R[3], -1, 1e-5);
    for (int k = 0; k < 3; k++) assert_float_equal(pose[3 * 18 + k], 0, 1e-5); /* the elbow is straight */
    rodrigues(pose + 3 * 1, R); /* the left leg, along -y, points to (2, -6, 0) */
    assert_float_equal(-R[1] / -R[4], 2.0 / -6.0, 1e-4);
    degrees[3 * 9 + 2] = -90; /* the left elbow bends forward about x */
    bvh_body_pose(&b, &map, 0, pose);
    float upper[9], lower[9];
    rodrigues(pose + 3 * 16, upper);
    rodrigues(pose + 3 * 18, lower);
    double z = 0; /* the direction of the forearm, which is x at rest: upper * lower * x */
    for (int k = 0; k < 3; k++) z += upper[6 + k] * lower[3 * k];
    assert_float_equal(z, 1, 1e-4);
    strcpy(joint[1].name, "Unknown");
    assert_int_equal(bvh_body_match(c, &b, NULL, (const float(*)[3])rest, &map), SHERF_UNSUPPORTED);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_small), cmocka_unit_test(test_truncated),
                                       cmocka_unit_test(test_texts), cmocka_unit_test(test_hostile),
                                       cmocka_unit_test(test_many),  cmocka_unit_test(test_retarget)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
