/* Tests of the viewer without its HTTP: who may send requests, which are accepted, whose turn it is, what is
 * painted. */
#include "support.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "viewer/viewer.h"

/* ---- who may send requests ---- */
static void tokens(void **state) {
    context *c = *state;
    char token[VIEWER_TOKEN + 1], other[VIEWER_TOKEN + 1], path[2 * VIEWER_TOKEN];
    const char *rest;
    assert_ok(c, token_make(c, token));
    assert_ok(c, token_make(c, other));
    assert_int_equal(strlen(token), VIEWER_TOKEN);
    assert_string_not_equal(token, other);
    snprintf(path, sizeof path, "/%s/frame", token);
    assert_true(token_matches(token, path, &rest));
    assert_string_equal(rest, "/frame");
    assert_false(token_matches(other, path, &rest));
    for (int i = 1; i <= VIEWER_TOKEN; i++) { /* one letter wrong, or truncated */
        path[i] ^= 1;
        assert_false(token_matches(token, path, &rest));
        path[i] ^= 1;
        char cut[2 * VIEWER_TOKEN];
        snprintf(cut, sizeof cut, "%.*s", i, path);
        assert_false(token_matches(token, cut, &rest));
    }
    path[VIEWER_TOKEN + 1] = 'x'; /* too long */
    assert_false(token_matches(token, path, &rest));
    path[VIEWER_TOKEN + 1] = 0;
    assert_true(token_matches(token, path, &rest));
    assert_string_equal(rest, "");
    assert_false(token_matches(token, "", &rest));
    assert_false(token_matches(token, "/", &rest));
    assert_false(token_matches(token, "*", &rest));
}

static void hosts_and_origins(void **state) {
    static const char *const good[] = {"127.0.0.1",   "127.0.0.1:8080", "localhost",       "LocalHost:1",
                                       "[::1]:65535", "[::1]",          "192.168.0.7:8000"};
    static const char *const bad[] = {"",
                                      "evil.example",
                                      "evil.example:80",
                                      "localhost.evil.example",
                                      "127.0.0.1.evil.example:80",
                                      "127.0.0.1:",
                                      "127.0.0.1:123456",
                                      "127.0.0.1:80x",
                                      "[::1",
                                      "[evil]:80",
                                      "[::1]evil",
                                      "0x7f.1",
                                      "127.1",
                                      " 127.0.0.1",
                                      "user@127.0.0.1",
                                      "localhost:80:80"};
    char longest[300];
    for (size_t i = 0; i < COUNT_OF(good); i++)
        if (!host_is_allowed(good[i])) fail_msg("'%s' should be allowed", good[i]);
    for (size_t i = 0; i < COUNT_OF(bad); i++)
        if (host_is_allowed(bad[i])) fail_msg("'%s' should not be allowed", bad[i]);
    memset(longest, '1', sizeof longest);
    longest[sizeof longest - 1] = 0;
    assert_false(host_is_allowed(longest));
    assert_false(host_is_allowed(NULL));
    assert_true(origin_is_allowed(NULL, "127.0.0.1:80"));
    assert_true(origin_is_allowed("http://127.0.0.1:80", "127.0.0.1:80"));
    assert_false(origin_is_allowed("http://127.0.0.1:81", "127.0.0.1:80"));
    assert_false(origin_is_allowed("https://127.0.0.1:80", "127.0.0.1:80"));
    assert_false(origin_is_allowed("http://evil.example", "127.0.0.1:80"));
    assert_false(origin_is_allowed("null", "127.0.0.1:80"));
    assert_false(origin_is_allowed("", "127.0.0.1:80"));
}

static const char *const good_fields[][2] = {
    {"client", "abc123"}, {"n", "12"},    {"avatar", "0"}, {"motion", "2"},  {"frame", "100"},
    {"w", "128"},         {"h", "96"},    {"az", "-1.5"},  {"el", "0.3"},    {"zoom", "2e0"},
    {"ox", "0.1"},        {"oy", "-0.2"}, {"oz", "0"},     {"bg", "0a80ff"}, {"mode", "depth"},
    {"follow", "0"},      {"png", "1"},   {"fine", "1"},   {"turn", "48"},   {"fps", "25"},
    {"speed", "0.5"}};

static const char *const bad_fields[][2] = {{"w", "15"},
                                            {"w", "4097"},
                                            {"w", "128 "},
                                            {"w", "0x80"},
                                            {"w", ""},
                                            {"w", "-128"},
                                            {"w", "99999999999999999999"},
                                            {"w", "12.5"},
                                            {"az", "nan"},
                                            {"az", "inf"},
                                            {"az", "0x1p3"},
                                            {"az", "1e9"},
                                            {"az", ""},
                                            {"az", "1,5"},
                                            {"el", "2"},
                                            {"zoom", "0"},
                                            {"zoom", "-1"},
                                            {"mode", "colour"},
                                            {"mode", ""},
                                            {"bg", "fff"},
                                            {"bg", "gggggg"},
                                            {"bg", "0a80ff0"},
                                            {"follow", "2"},
                                            {"follow", "yes"},
                                            {"client", "abc"},
                                            {"client", "abcdefghijklmnopq"},
                                            {"client", "../../x"},
                                            {"client", "ABCD"},
                                            {"n", "-1"},
                                            {"n", "1234567890123456"},
                                            {"turn", "3001"},
                                            {"fps", "0"},
                                            {"speed", "1000"},
                                            {"avatar", "-1"},
                                            {"frame", "1e3"},
                                            {"unknown", "1"},
                                            {"", "1"}};

/* ---- which requests are accepted ---- */
static void fields(void **state) {
    viewer_query q;
    query_start(&q);
    for (size_t i = 0; i < COUNT_OF(good_fields); i++)
        if (!query_take(&q, good_fields[i][0], good_fields[i][1]))
            fail_msg("%s=%s", good_fields[i][0], good_fields[i][1]);
    assert_int_equal(q.request.width, 128);
    assert_int_equal(q.request.height, 96);
    assert_int_equal(q.request.mode, VIEWER_DEPTH);
    assert_true(q.request.azimuth_rad == -1.5f && q.request.offset_m[1] == -0.2f && q.request.zoom == 2);
    assert_true(fabsf(q.request.background[2] - 1) < 1e-6f &&
                fabsf(q.request.background[1] - 128 / 255.f) < 1e-6f);
    assert_false(q.request.follow);
    for (size_t i = 0; i < COUNT_OF(good_fields); i++) /* none occurs twice */
        if (query_take(&q, good_fields[i][0], good_fields[i][1])) fail_msg("%s twice", good_fields[i][0]);
    for (size_t i = 0; i < COUNT_OF(bad_fields); i++) {
        query_start(&q);
        if (query_take(&q, bad_fields[i][0], bad_fields[i][1]))
            fail_msg("'%s=%s' was taken", bad_fields[i][0], bad_fields[i][1]);
    }
    query_start(&q);
    assert_false(query_take(&q, "w", NULL));
    assert_true(query_take(&q, "bg", "none"));
    assert_true(q.request.transparent);
}

/* ---- whose turn it is ---- */
static void count_wake(void *arg) {
    ++*(int *)arg;
}

static viewer_query from(const char *client, uint64_t sequence) {
    viewer_query q;
    query_start(&q);
    snprintf(q.client, sizeof q.client, "%s", client);
    q.sequence = sequence;
    return q;
}

static viewer_job *request(viewer_desk *d, const char *client, uint64_t sequence, int *wakes) {
    viewer_query q = from(client, sequence);
    viewer_job *job;
    assert_int_equal(desk_admit(d, &q, &job), ADMITTED);
    desk_submit(d, job, count_wake, wakes);
    return job;
}

static void newest_wins(void **state) {
    viewer_desk d;
    viewer_job *turn;
    int wakes[5] = {0}, seat;
    assert_true(desk_open(&d));
    viewer_job *a = request(&d, "anna", 1, &wakes[0]), *b = request(&d, "anna", 2, &wakes[1]);
    assert_int_equal(a->state, JOB_REPLACED); /* while it was waiting */
    assert_int_equal(wakes[0], 1);
    assert_int_equal(desk_turn(&d, 0, &turn, &seat), TURN_JOB);
    assert_ptr_equal(turn, b);
    viewer_job *c = request(&d, "anna", 3, &wakes[2]); /* while it was being rendered */
    assert_int_equal(b->state, JOB_REPLACED);
    assert_int_equal(wakes[1], 1);
    desk_done(&d, turn, JOB_DONE); /* too late: nobody is woken again */
    assert_int_equal(b->state, JOB_REPLACED);
    assert_int_equal(wakes[1], 1);
    desk_release(&d, turn);
    viewer_job *late = request(&d, "anna", 2, &wakes[3]); /* overtaken on the way */
    assert_int_equal(late->state, JOB_REPLACED);
    assert_int_equal(wakes[3], 1);
    assert_int_equal(c->state, JOB_WAITING);
    /* four answers are under way, the limit for one client */
    viewer_query q = from("anna", 9);
    viewer_job *none;
    assert_int_equal(desk_admit(&d, &q, &none), ADMITTED_TOO_MANY);
    desk_release(&d, a);
    viewer_job *last = request(&d, "anna", 9, &wakes[4]);
    assert_int_equal(c->state, JOB_REPLACED);
    assert_int_equal(desk_turn(&d, 0, &turn, &seat), TURN_JOB);
    assert_ptr_equal(turn, last);
    desk_done(&d, turn, JOB_DONE);
    desk_release(&d, turn);
    assert_int_equal(last->state, JOB_DONE);
    assert_int_equal(wakes[4], 1);
    assert_int_equal(desk_turn(&d, 0.01, &turn, &seat), TURN_NONE);
    viewer_job *jobs[] = {b, c, late, last};
    for (size_t i = 0; i < COUNT_OF(jobs); i++) desk_release(&d, jobs[i]);
    desk_close(&d);
    desk_finish(&d);
}

static void turns_are_taken(void **state) {
    viewer_desk d;
    viewer_job *turn, *own[3];
    int wakes = 0, seat, served[VIEWER_CLIENTS] = {0}, films = 0;
    static const char *const names[] = {"anna", "bert", "carl"};
    assert_true(desk_open(&d));
    for (int i = 0; i < 3; i++) own[i] = request(&d, names[i], 1, &wakes);
    pthread_mutex_lock(&d.lock);
    int film = desk_seat(&d, "film");
    d.client[film].film.state = FILM_RUNNING;
    pthread_mutex_unlock(&d.lock);
    for (int i = 0; i < 40; i++) { /* large pictures: none is finished */
        viewer_turn t = desk_turn(&d, 0, &turn, &seat);
        if (t == TURN_FILM)
            films++;
        else {
            assert_int_equal(t, TURN_JOB);
            served[seat]++;
            desk_release(&d, turn);
        }
    }
    assert_int_equal(films, 10);
    for (int i = 0; i < 3; i++) assert_int_equal(served[own[i]->seat], 10);
    /* nobody else waits: the video gets all turns */
    desk_close(&d);
    assert_int_equal(wakes, 3);
    assert_int_equal(desk_turn(&d, 0, &turn, &seat), TURN_CLOSED);
    for (int i = 0; i < 3; i++) {
        assert_int_equal(own[i]->state, JOB_CLOSED);
        desk_release(&d, own[i]);
    }
    viewer_job *late = request(&d, "anna", 7, &wakes); /* after the end */
    assert_int_equal(late->state, JOB_CLOSED);
    assert_int_equal(wakes, 4);
    desk_release(&d, late);
    desk_finish(&d);
}

static void seats_are_few(void **state) {
    viewer_desk d;
    viewer_job *job[VIEWER_CLIENTS], *none;
    int wakes = 0;
    char name[16];
    assert_true(desk_open(&d));
    for (int i = 0; i < VIEWER_CLIENTS; i++) {
        snprintf(name, sizeof name, "client%d", i);
        job[i] = request(&d, name, 1, &wakes);
    }
    viewer_query q = from("onemore", 1);
    assert_int_equal(desk_admit(&d, &q, &none), ADMITTED_NO_SEAT);
    d.client[job[3]->seat].seen_s -= 3600; /* it still waits for its picture */
    assert_int_equal(desk_admit(&d, &q, &none), ADMITTED_NO_SEAT);
    desk_close(&d);
    int seat = job[3]->seat;
    for (int i = 0; i < VIEWER_CLIENTS; i++) desk_release(&d, job[i]);
    d.closed = false;
    assert_int_equal(desk_admit(&d, &q, &none), ADMITTED); /* gone long ago, and nothing under way */
    assert_int_equal(none->seat, seat);
    desk_release(&d, none);
    desk_close(&d);
    desk_finish(&d);
}

/* ---- what is painted ---- */
enum { SIDE = 64 };

static void painted(void **state) {
    static float color[SIDE * SIDE * 3], opacity[SIDE * SIDE], depth[SIDE * SIDE], scratch[SIDE * SIDE * 2];
    static uint8_t out[SIDE * SIDE * 4];
    viewer_request w = {.width = SIDE, .height = SIDE, .zoom = 1, .background = {1, 0, 0}};
    viewer_optics o = {.focal_px = 100, .centre_px = {SIDE / 2, SIDE / 2}, .near_m = 2, .far_m = 4};
    /* a plane that leans back: z = 3 - y, so its normal is (0, -1, -1) / sqrt 2 with y down */
    for (int y = 0; y < SIDE; y++)
        for (int x = 0; x < SIDE; x++) {
            int i = y * SIDE + x;
            bool inside = x >= 8 && x < 56 && y >= 8 && y < 56;
            float v = ((float)y - SIDE / 2) / o.focal_px;
            opacity[i] = inside ? x < 32 ? 1 : 0.5f : 0;
            depth[i] = inside ? 3 / (1 + v) : 4;
            for (int k = 0; k < 3; k++) color[3 * i + k] = 0.6f * opacity[i];
        }
    const int corner = 0, solid = 32 * SIDE + 20, half = 32 * SIDE + 44;
    paint(&w, &o, color, opacity, depth, 3, scratch, out);
    assert_memory_equal(out + 3 * corner, ((uint8_t[]){255, 0, 0}), 3);
    assert_memory_equal(out + 3 * solid, ((uint8_t[]){153, 153, 153}), 3);
    assert_memory_equal(out + 3 * half, ((uint8_t[]){204, 77, 77}), 3);
    paint(&w, &o, color, opacity, depth, 4, scratch, out); /* the colour, and how much of it */
    assert_memory_equal(out + 4 * corner, ((uint8_t[]){0, 0, 0, 0}), 4);
    assert_memory_equal(out + 4 * half, ((uint8_t[]){153, 153, 153, 128}), 4);
    w.mode = VIEWER_OPACITY;
    paint(&w, &o, color, opacity, depth, 3, scratch, out);
    assert_memory_equal(out + 3 * corner, ((uint8_t[]){0, 0, 0}), 3);
    assert_memory_equal(out + 3 * half, ((uint8_t[]){128, 128, 128}), 3);
    w.mode = VIEWER_DEPTH;
    paint(&w, &o, color, opacity, depth, 3, scratch, out);
    assert_int_equal(out[3 * solid], 153); /* in the middle: 1 - 0.8 / 2 */
    assert_true(out[3 * (50 * SIDE + 20)] > out[3 * (12 * SIDE + 20)]);
    w.mode = VIEWER_NORMAL;
    paint(&w, &o, color, opacity, depth, 3, scratch, out);
    assert_memory_equal(out + 3 * corner, ((uint8_t[]){255, 0, 0}), 3);
    const float expected[3] = {0.5f, 0.5f + 0.5f * (float)M_SQRT1_2, 0.5f + 0.5f * (float)M_SQRT1_2};
    for (int k = 0; k < 3; k++)
        if (fabsf((float)out[3 * solid + k] / 255 - expected[k]) > 0.02f)
            fail_msg("channel %d of the normal is %d, should be %.0f", k, out[3 * solid + k],
                     255 * expected[k]);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(tokens),          cmocka_unit_test(hosts_and_origins),
                                       cmocka_unit_test(fields),          cmocka_unit_test(newest_wins),
                                       cmocka_unit_test(turns_are_taken), cmocka_unit_test(seats_are_few),
                                       cmocka_unit_test(painted)};
    return cmocka_run_group_tests(tests, test_open, test_close);
}
