/* Tests of the viewer over raw sockets: its answers, and what it withstands. */
#include "support.h"

#include <arpa/inet.h>
#include <cjson/cJSON.h>
#include <errno.h>
#include <math.h>
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include "io/image.h"
#include "scene/scene.h"
#include "viewer/viewer.h"

enum { ANSWER_MAX = 4 << 20, POSES = 6 };

static struct {
    context *c, *runs; /* the second one renders */
    sherf_body *body;
    sherf_avatar *avatar, *baked;
    sherf_pose poses[POSES];
    sherf_viewer *viewer;
    pthread_t thread;
    char token[VIEWER_TOKEN + 1];
    int port;
} all;

/* ---- a client ---- */
typedef struct {
    int status; /* 0: no answer */
    char head[4096];
    uint8_t *body;
    size_t bytes;
} answer;

static int connected(void) {
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons((uint16_t)all.port)};
    struct timeval patience = {.tv_sec = 240};
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    int fd = socket(AF_INET, SOCK_STREAM, 0);
    assert_true(fd >= 0);
    setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &patience, sizeof patience);
    assert_int_equal(connect(fd, (struct sockaddr *)&to, sizeof to), 0);
    return fd;
}

static void send_text(int fd, const char *text, size_t bytes) {
    while (bytes) {
        ssize_t n = send(fd, text, bytes, MSG_NOSIGNAL);
        if (n <= 0) return; /* closed by the other side: its answer is read below */
        text += n;
        bytes -= (size_t)n;
    }
}

/* Reads until the connection closes; the answer is valid until the next call. */
static const answer *receive(int fd) {
    static uint8_t text[ANSWER_MAX];
    static answer a;
    size_t n = 0;
    for (ssize_t got; n < sizeof text - 1 && (got = recv(fd, text + n, sizeof text - 1 - n, 0)) > 0;)
        n += (size_t)got;
    close(fd);
    text[n] = 0;
    a = (answer){0};
    uint8_t *end = memmem(text, n, "\r\n\r\n", 4);
    if (!end || sscanf((char *)text, "HTTP/1.%*d %d", &a.status) != 1) return &a;
    snprintf(a.head, sizeof a.head, "%.*s", (int)(end + 2 - text), (char *)text);
    a.body = end + 4;
    a.bytes = n - (size_t)(a.body - text);
    return &a;
}

static int start_request(const char *method, const char *path, const char *lines) {
    char text[8192];
    int fd = connected();
    int n = snprintf(text, sizeof text, "%s %s HTTP/1.1\r\n%sConnection: close\r\n\r\n", method, path, lines);
    send_text(fd, text, (size_t)n);
    return fd;
}

#define HOST "Host: 127.0.0.1\r\n"
/* GET of a path after the token. */
static const answer *get(const char *format, ...) {
    char rest[2048], path[2200];
    va_list list;
    va_start(list, format);
    vsnprintf(rest, sizeof rest, format, list);
    va_end(list);
    snprintf(path, sizeof path, "/%s%s", all.token, rest);
    return receive(start_request("GET", path, HOST));
}

static const answer *with(const char *method, const char *rest, const char *lines) {
    char path[2200];
    snprintf(path, sizeof path, "/%s%s", all.token, rest);
    return receive(start_request(method, path, lines));
}

static bool has(const answer *a, const char *line) {
    return strcasestr(a->head, line) != NULL;
}

static void assert_status(const answer *a, int status) {
    if (a->status != status)
        fail_msg("status %d, not %d: %.*s", a->status, status, (int)(a->bytes < 200 ? a->bytes : 200),
                 a->body ? (char *)a->body : "");
}

/* Checks that the viewer still works. */
static void assert_alive(void) {
    assert_status(get("/about"), 200);
}

/* ---- answers ---- */
static void page(void **state) {
    const answer *a = get("/");
    assert_status(a, 200);
    assert_true(has(a, "Content-Type: text/html"));
    assert_true(has(a, "Cache-Control: no-store"));
    assert_true(has(a, "Content-Security-Policy: default-src 'none'"));
    assert_true(has(a, "X-Content-Type-Options: nosniff"));
    assert_true(has(a, "Referrer-Policy: no-referrer"));
    assert_non_null(memmem(a->body, a->bytes, "viewer.js", 9));
    assert_status(a = get("/viewer.js"), 200);
    assert_true(has(a, "text/javascript") && a->bytes > 1000);
    assert_status(a = get("/viewer.css"), 200);
    assert_true(has(a, "text/css"));
    assert_status(a = get(""), 302);
    assert_true(has(a, all.token));
    static const char *const nothing[] = {"/index.html", "/../etc/passwd", "/%2e%2e/x", "//",
                                          "/viewer.js/", "/frames",        "/viewer"};
    for (size_t i = 0; i < COUNT_OF(nothing); i++) assert_status(get("%s", nothing[i]), 404);
    assert_status(a = with("HEAD", "/", HOST), 200);
    assert_int_equal(a->bytes, 0);
}

static void about(void **state) {
    const answer *a = get("/about");
    assert_status(a, 200);
    cJSON *json = cJSON_ParseWithLength((const char *)a->body, a->bytes);
    assert_non_null(json);
    const cJSON *avatar = cJSON_GetArrayItem(cJSON_GetObjectItem(json, "avatars"), 0),
                *motions = cJSON_GetObjectItem(json, "motions");
    assert_string_equal(cJSON_GetObjectItem(avatar, "name")->valuestring, "tube \"<b>\" man");
    assert_int_equal(cJSON_GetArraySize(motions), VIEWER_OWN_MOTIONS + 1);
    assert_int_equal(cJSON_GetObjectItem(cJSON_GetArrayItem(motions, 2), "frames")->valueint, POSES);
    assert_true(cJSON_IsTrue(cJSON_GetObjectItem(avatar, "picture")));
    assert_true(cJSON_IsFalse(cJSON_GetObjectItem(avatar, "baked")));
    const cJSON *baked = avatar->next;
    assert_true(cJSON_IsFalse(cJSON_GetObjectItem(baked, "picture")));
    assert_true(cJSON_IsTrue(cJSON_GetObjectItem(baked, "baked")));
    cJSON_Delete(json);
}

static image_u8 picture_of(const answer *a, const char *type, int channels) {
    image_u8 picture;
    assert_status(a, 200);
    assert_true(has(a, type));
    assert_ok(all.c, image_parse(all.c, a->body, a->bytes, channels, &picture));
    return picture;
}

static void pictures(void **state) {
    const answer *a = get("/frame?client=anna&n=1&w=96&h=64&bg=204060");
    assert_true(has(a, "X-Render-Ms: ") && has(a, "X-Scale: "));
    image_u8 p = picture_of(a, "image/jpeg", 3);
    assert_int_equal(p.width, 96);
    assert_int_equal(p.height, 64);
    assert_true(abs(p.data[0] - 0x20) < 4 && abs(p.data[1] - 0x40) < 4 && abs(p.data[2] - 0x60) < 4);
    mem_free(p.data);
    /* the body's position, lossless */
    p = picture_of(get("/frame?client=anna&n=2&w=64&h=64&mode=opacity&png=1"), "image/png", 1);
    int full = 0, sum_x = 0;
    for (int i = 0; i < 64 * 64; i++)
        if (p.data[i] > 127) full++, sum_x += i % 64;
    mem_free(p.data);
    if (full < 100 || full > 2500) fail_msg("%d pixels of 4096 are opaque", full);
    assert_true(abs(sum_x / full - 32) < 6);
    p = picture_of(get("/frame?client=anna&n=3&w=64&h=64&bg=none"), "image/png", 4);
    assert_int_equal(p.data[3], 0);
    mem_free(p.data);
    p = picture_of(get("/frame?client=anna&n=4&w=48&h=128&mode=normal&az=1&el=0.5&zoom=2&oy=0.3"),
                   "image/jpeg", 3);
    assert_int_equal(p.height, 128);
    mem_free(p.data);
    p = picture_of(get("/picture?avatar=0"), "image/png", 3);
    assert_int_equal(p.width, 64);
    mem_free(p.data);
}

/* ---- what the page draws itself ---- */

/* The bounds, in pixels, of the opaque part of a query's frame. */
static void opaque_bounds(const char *query, int side, float low[2], float high[2]) {
    image_u8 p = picture_of(get("%s&w=%d&h=%d&mode=opacity&png=1", query, side, side), "image/png", 1);
    for (int k = 0; k < 2; k++) low[k] = (float)side, high[k] = 0;
    for (int i = 0; i < side * side; i++)
        for (int k = 0; k < 2 && p.data[i] > 127; k++) {
            const float x = (float)(k ? i / side : i % side);
            low[k] = fminf(low[k], x);
            high[k] = fmaxf(high[k], x + 1);
        }
    mem_free(p.data);
}

/* Computes the position of a surface corner in a frame, from the bytes of the answers. */
static void corner_world(const uint8_t *surface, const float *frame, uint32_t corners, uint32_t i,
                         float out[3]) {
    float p[4] = {0, 0, 0, 1};
    const uint8_t *joint = surface + 16 + 16 * (size_t)corners + 4 * i, *weight = joint + 4 * (size_t)corners;
    int sum = 0;
    memcpy(p, surface + 16 + 12 * (size_t)i, 12);
    for (int k = 0; k < 3; k++) out[k] = 0;
    for (int j = 0; j < 4; j++) {
        assert_true(joint[j] < BODY_JOINTS);
        sum += weight[j];
        for (int k = 0; k < 12; k++)
            out[k / 4] += (float)weight[j] / 255 * frame[3 + 12 * joint[j] + k] * p[k % 4];
    }
    assert_int_equal(sum, 255);
}

/* The surface as the page gets it, once it is ready; the caller frees it. */
static uint8_t *take_surface(uint32_t *corners) {
    const answer *a = get("/surface?avatar=0");
    for (int i = 0; i < 2000 && a->status == 202; i++, a = get("/surface?avatar=0")) usleep(50000);
    assert_status(a, 200);
    assert_true(has(a, "application/octet-stream"));
    uint32_t head[4];
    memcpy(head, a->body, sizeof head);
    const uint32_t triangles = head[2];
    *corners = head[1];
    assert_int_equal(head[0], LIVE_SURFACE);
    assert_true(*corners > 200 && triangles > 200);
    assert_int_equal(a->bytes, 16 + 24 * (size_t)*corners + 12 * (size_t)triangles + head[3]);
    uint8_t *surface = mem_alloc(all.c, a->bytes, 1);
    memcpy(surface, a->body, a->bytes);
    for (uint32_t i = 0, index; i < 3 * triangles; i++) {
        memcpy(&index, surface + 16 + 24 * (size_t)*corners + 4 * (size_t)i, sizeof index);
        assert_true(index < *corners);
    }
    image_u8 texture;
    assert_ok(all.c, image_parse(all.c, surface + a->bytes - head[3], head[3], 3, &texture));
    assert_int_equal(texture.width, texture.height);
    mem_free(texture.data);
    return surface;
}

/* The surface, placed into a frame with the page's bytes, is where the network's picture shows the body. */
static void surface_stands_in_the_picture(void **state) {
    enum { SIDE = 128 };
    static const char query[] = "/frame?client=lena&n=1&motion=2&frame=4&az=0.7&el=0.2";
    viewer *v = all.viewer;
    v->live.resolution = 64;
    uint32_t corners, moves[4];
    uint8_t *surface = take_surface(&corners);
    const answer *a = get("/moves?motion=2&frame=3");
    assert_status(a, 200);
    memcpy(moves, a->body, sizeof moves);
    assert_true(moves[0] == LIVE_MOVES && moves[1] == 3 && moves[2] == POSES - 3);
    assert_int_equal(a->bytes, 16 + 4 * (LIVE_FRAMING + (POSES - 3) * (size_t)LIVE_FRAME));
    float frame[LIVE_FRAME];
    memcpy(frame, a->body + 16 + 4 * (LIVE_FRAMING + LIVE_FRAME), sizeof frame); /* the second one: frame 4 */
    assert_true(fabsf(frame[0] - 2) < 1e-4f);                                    /* half a metre per frame */

    viewer_query q;
    const viewer_framing *f;
    sherf_camera camera;
    float scale, low[2], high[2], found_low[2] = {SIDE, SIDE}, found_high[2] = {0, 0};
    query_start(&q);
    q.request = (viewer_request){.motion = 2,
                                 .frame = 4,
                                 .width = SIDE,
                                 .height = SIDE,
                                 .azimuth_rad = 0.7f,
                                 .elevation_rad = 0.2f,
                                 .zoom = 1,
                                 .follow = true};
    assert_ok(all.c, scene_framing(all.c, &v->scene, 0, 2, &f));
    scene_camera(&v->scene, f, &q.request, &camera, &scale);
    for (uint32_t i = 0; i < corners; i++) {
        float x[3], y[3];
        corner_world(surface, frame, corners, i, x);
        for (int r = 0; r < 3; r++)
            y[r] = camera.R[3 * r] * x[0] + camera.R[3 * r + 1] * x[1] + camera.R[3 * r + 2] * x[2] +
                   camera.T_m[r];
        for (int k = 0; k < 2; k++) {
            const float px = camera.K[4 * k] * y[k] / y[2] + camera.K[3 * k + 2];
            found_low[k] = fminf(found_low[k], px);
            found_high[k] = fmaxf(found_high[k], px);
        }
    }
    mem_free(surface);
    opaque_bounds(query, SIDE, low, high);
    for (int k = 0; k < 2; k++) {
        if (fabsf(low[k] - found_low[k]) > 3 || fabsf(high[k] - found_high[k]) > 3)
            fail_msg("along %d: the surface from %g to %g, the picture from %g to %g", k,
                     (double)found_low[k], (double)found_high[k], (double)low[k], (double)high[k]);
    }
}

/* A baked avatar's pictures are its own frames, whether quick or not; its surface is ready at once. */
static void baked_avatars(void **state) {
    enum { SIDE = 160 };
    uint32_t head[LIVE_HEAD];
    const answer *a = get("/surface?avatar=1");
    assert_status(a, 200);
    memcpy(head, a->body, sizeof head);
    assert_int_equal(head[0], LIVE_SURFACE);
    assert_true(head[1] > 100 && head[2] > 100);
    assert_status(get("/picture?avatar=1"), 404);
    viewer_request r = {
        .avatar = 1, .motion = 2, .frame = 4, .width = SIDE, .height = SIDE, .zoom = 1, .follow = true};
    const viewer_framing *framing;
    sherf_camera camera;
    sherf_frame f = {0};
    float scale_m;
    assert_ok(all.c, scene_framing(all.c, &all.viewer->scene, 1, 2, &framing));
    scene_camera(&all.viewer->scene, framing, &r, &camera, &scale_m);
    const sherf_pose pose = scene_pose(&all.viewer->scene, 1, 2, 4);
    assert_ok(all.c, sherf_render(all.c, all.baked, all.body, &pose, &camera, NULL, &f));
    for (int quick = 0; quick < 2; quick++) {
        a = get("/frame?client=baker&n=%d&avatar=1&motion=2&frame=4&w=%d&h=%d&png=1&quick=%d", quick + 1,
                SIDE, SIDE, quick);
        assert_false(has(a, "X-Baked"));
        image_u8 picture = picture_of(a, "image/png", 3);
        int64_t solid = 0;
        for (size_t i = 0; i < SIDE * SIDE; i++) {
            const float opacity = f.opacity.data[i];
            if (opacity < 1) continue;
            solid++;
            for (size_t k = 0; k < 3; k++)
                assert_int_equal(picture.data[3 * i + k], float_to_u8(f.color.data[3 * i + k]));
        }
        assert_true(solid > 200);
        mem_free(picture.data);
    }
    sherf_frame_free(&f);
}

static void surfaces_and_moves_there_are_not(void **state) {
    static const char *const wrong[] = {"/surface?avatar=2", "/surface?avatar=-1",      "/surface?avatar=x",
                                        "/moves?motion=3",   "/moves?motion=2&frame=6", "/moves?frame=1",
                                        "/moves?avatar=64"};
    for (size_t i = 0; i < COUNT_OF(wrong); i++) assert_status(get("%s", wrong[i]), 400);
    assert_status(get("/moves"), 200); /* the picture's own pose */
    assert_alive();
}

/* A picture made in bands equals one made at once. Following the body keeps it in the middle. */
static void bands_and_following(void **state) {
    viewer *v = all.viewer;
    viewer_query q;
    context *c = all.c;
    query_start(&q);
    q.request.width = q.request.height = 96;
    q.request.azimuth_rad = 0.4f;
    q.request.motion = 2;
    q.request.frame = 3;
    viewer_scene scene; /* our own context: the other one belongs to the rendering thread */
    sherf_viewer_avatar avatar = {"a", all.avatar, all.body};
    sherf_viewer_motion motion = {"m", all.poses, POSES, 10};
    sherf_viewer_options o = {.avatars = &avatar, .avatar_count = 1, .motions = &motion, .motion_count = 1};
    assert_ok(c, scene_create(c, &o, &scene));
    viewer own = {.scene = scene};
    sherf_image picture[2];
    for (int bands = 0; bands < 2; bands++) {
        viewer_job *job = job_create(c, &q.request);
        bool complete = false;
        int turns = 0;
        for (; !complete; turns++) {
            own.pixel_s[0] = bands ? 1 : 1e-9;
            assert_ok(c, job_render(c, &own, job, &complete));
        }
        assert_int_equal(turns, bands ? 6 : 1);
        picture[bands] = (sherf_image){96, 96, 1, malloc(96 * 96 * sizeof(float))};
        memcpy(picture[bands].data, job->opacity, 96 * 96 * sizeof(float));
        job_free(job);
    }
    double worst = 0, weight = 0, x = 0;
    for (int i = 0; i < 96 * 96; i++) {
        worst = fmax(worst, fabs((double)picture[0].data[i] - picture[1].data[i]));
        weight += picture[0].data[i];
        x += picture[0].data[i] * (i % 96);
    }
    assert_true(weight > 100);
    if (!(worst < 1e-3)) fail_msg("bands differ by %g", worst);
    if (!(fabs(x / weight - 48) < 5))
        fail_msg("the body is at %g of 96", x / weight); /* by then it is 1.5 m away */
    free(picture[0].data);
    free(picture[1].data);
    scene_free(&own.scene);
    sherf_frame_free(&own.band);
    assert_non_null(v);
}

/* ---- refused requests ---- */
static void strangers(void **state) {
    char path[200];
    const answer *a = receive(start_request("GET", "/", HOST));
    assert_status(a, 403);
    assert_null(memmem(a->body, a->bytes, "script", 6));
    assert_status(receive(start_request("GET", "/00000000000000000000000000000000/", HOST)), 403);
    snprintf(path, sizeof path, "/%.31s/", all.token);
    assert_status(receive(start_request("GET", path, HOST)), 403);
    snprintf(path, sizeof path, "/%sx/", all.token);
    assert_status(receive(start_request("GET", path, HOST)), 403);
    snprintf(path, sizeof path, "http://127.0.0.1/%s/", all.token);
    assert_true(receive(start_request("GET", path, HOST))->status >= 400);
    assert_status(with("GET", "/", "Host: evil.example\r\n"), 403);
    assert_status(with("GET", "/", "Host: evil.example:80\r\nOrigin: http://evil.example:80\r\n"), 403);
    assert_true(with("GET", "/", "")->status >= 400);
    assert_status(with("GET", "/", "Host: localhost:9999\r\n"), 200); /* the end of a tunnel */
    assert_status(with("GET", "/about", HOST "Origin: http://127.0.0.1\r\n"), 200);
    assert_status(with("GET", "/about", HOST "Origin: http://evil.example\r\n"), 403);
    assert_status(with("GET", "/about", HOST "Origin: null\r\n"), 403);
    assert_status(with("GET", "/about", HOST "Sec-Fetch-Site: cross-site\r\n"), 403);
    assert_status(with("GET", "/about", HOST "Sec-Fetch-Site: same-site\r\n"), 403);
    assert_status(with("GET", "/about", HOST "Sec-Fetch-Site: same-origin\r\n"), 200);
    assert_status(with("GET", "/", HOST "Sec-Fetch-Site: cross-site\r\n"), 200); /* a link to the page */
    assert_status(with("POST", "/frame?client=anna&n=1", HOST), 405);
    assert_status(with("PUT", "/film?client=anna", HOST), 405);
    assert_status(with("OPTIONS", "/", HOST), 405);
}

static void nonsense(void **state) {
    static const char *const queries[][2] = {
        {"client=anna&n=1&w=100000", "w: not a value"},
        {"client=anna&n=1&w=-5", "w: not a value"},
        {"client=anna&n=1&w=2048&h=2048", "w, h: more pixels"},
        {"client=anna&n=1&zoom=nan", "zoom: not a value"},
        {"client=anna&n=1&what=1", "what: there is no such field"},
        {"client=anna&n=1&%3Cb%3E=1", "a field: there is no such field"},
        {"client=anna&n=1&w=64&w=64", "w: it occurs twice"},
        {"client=anna&n=1&avatar=2", "avatar: there is no such one"},
        {"client=anna&n=1&motion=3", "motion: there is no such one"},
        {"client=anna&n=1&motion=2&frame=6", "frame: the motion has no such one"},
        {"client=anna&n=1&w", "w: not a value"},
        {"client=%00anna&n=1", "client: not a value"},
        {"client=anna%27%22%3C&n=1", "client: not a value"},
        {"n=1&w=64&h=64", "client: it is missing"},
        {"", "client: it is missing"}};
    static const char *const raw[] = {"GET\r\n\r\n",
                                      "\r\n\r\n\r\n\r\n",
                                      "GET / HTTP/9.9\r\n\r\n",
                                      "\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03 tls hello \r\n\r\n",
                                      "GET / HTTP/1.1\r\nHost 127.0.0.1\r\n\r\n",
                                      "GET / HTTP/1.1\nHost: 127.0.0.1\n: \n\n",
                                      "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"};
    for (size_t i = 0; i < COUNT_OF(queries); i++) {
        const answer *a = get("/frame?%s", queries[i][0]);
        if (a->status != 400) fail_msg("'%s': status %d", queries[i][0], a->status);
        if (strncmp((char *)a->body, queries[i][1], strlen(queries[i][1])))
            fail_msg("'%s': %s", queries[i][0], (char *)a->body);
    }
    for (size_t i = 0; i < COUNT_OF(raw); i++) {
        int fd = connected();
        send_text(fd, raw[i], strlen(raw[i]));
        shutdown(fd, SHUT_WR);
        int status = receive(fd)->status;
        if (status && status < 400) fail_msg("'%s': status %d", raw[i], status);
    }
    assert_alive();
}

static void oversized(void **state) {
    static char lines[70000];
    char text[400];
    /* a body, announced, in chunks or endless */
    assert_status(with("POST", "/film?client=anna", HOST "Content-Length: 5\r\n"), 413);
    assert_status(with("POST", "/film?client=anna", HOST "Content-Length: 99999999999999\r\n"), 413);
    assert_status(with("POST", "/film?client=anna", HOST "Transfer-Encoding: chunked\r\n"), 413);
    assert_true(with("GET", "/about", HOST "Content-Length: -1\r\n")->status >= 400);
    /* endless lines */
    int n = sprintf(lines, "GET /%s/about HTTP/1.1\r\n" HOST "X: ", all.token);
    memset(lines + n, 'x', sizeof lines - (size_t)n);
    int fd = connected();
    send_text(fd, lines, sizeof lines);
    int status = receive(fd)->status;
    assert_true(status == 0 || status >= 400);
    n = sprintf(lines, "GET /%s/", all.token);
    memset(lines + n, 'y', sizeof lines - (size_t)n);
    fd = connected();
    send_text(fd, lines, sizeof lines);
    status = receive(fd)->status;
    assert_true(status == 0 || status >= 400);
    /* very many lines */
    fd = connected();
    n = snprintf(text, sizeof text, "GET /%s/about HTTP/1.1\r\n" HOST, all.token);
    send_text(fd, text, (size_t)n);
    for (int i = 0; i < 5000; i++) {
        n = snprintf(text, sizeof text, "X-%d: y\r\n", i);
        send_text(fd, text, (size_t)n);
    }
    send_text(fd, "\r\n", 2);
    status = receive(fd)->status;
    assert_true(status == 0 || status >= 400);
    assert_alive();
}

/* ---- slow and lost clients ---- */
static void newest_request_wins(void **state) {
    char path[300];
    snprintf(path, sizeof path, "/%s/frame?client=berta&n=1&w=704&h=704&png=1", all.token);
    int large = start_request("GET", path, HOST);
    usleep(150000); /* the picture is being made */
    double begun = time_seconds();
    const answer *a = get("/frame?client=berta&n=2&w=32&h=32");
    double small_s = time_seconds() - begun;
    assert_status(a, 200);
    assert_status(receive(large), 204);
    /* another client's large picture does not delay ours */
    large = start_request("GET", path, HOST); /* overtaken: an older number */
    assert_status(receive(large), 204);
    snprintf(path, sizeof path, "/%s/frame?client=conny&n=1&w=512&h=512", all.token);
    large = start_request("GET", path, HOST);
    usleep(100000);
    for (int i = 3; i < 6; i++) assert_status(get("/frame?client=berta&n=%d&w=32&h=32", i), 200);
    assert_status(receive(large), 200);
    print_message("a small picture while a large one is given up: %.0f ms\n", 1e3 * small_s);
}

static void vanishing(void **state) {
    char path[300];
    for (int i = 0; i < 12; i++) { /* gone while the picture is made */
        snprintf(path, sizeof path, "/%s/frame?client=gone&n=%d&w=%d&h=64", all.token, i + 1, 64 + 16 * i);
        int fd = start_request("GET", path, HOST);
        if (i % 2) usleep(20000);
        struct linger now = {.l_onoff = 1}; /* with a reset */
        if (i % 3) setsockopt(fd, SOL_SOCKET, SO_LINGER, &now, sizeof now);
        close(fd);
    }
    for (int i = 0; i < 8; i++) { /* or while it is requested */
        int fd = connected();
        send_text(fd, "GET /0123", 9);
        close(fd);
    }
    assert_status(get("/frame?client=other&n=1&w=32&h=32"), 200);
}

/* Whether the other side closes the connection within `seconds`. */
static bool closes(int fd, double seconds) {
    char byte;
    struct timeval wait = {.tv_sec = (time_t)seconds, .tv_usec = (suseconds_t)(1e6 * fmod(seconds, 1))};
    setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &wait, sizeof wait);
    ssize_t n = recv(fd, &byte, 1, 0);
    return n == 0 || (n < 0 && errno == ECONNRESET);
}

static void stalling(void **state) {
    int quiet[3];
    server_patience = 0.05; /* half a second for the first request */
    for (int i = 0; i < 3; i++) quiet[i] = connected();
    send_text(quiet[1], "GET / HT", 8);
    double begun = time_seconds();
    assert_alive();
    /* a client that sends a letter now and then is never silent, but is not waited for */
    for (int i = 0; i < 8; i++) {
        send_text(quiet[2], "x", 1);
        usleep(100000);
    }
    for (int i = 0; i < 3; i++) {
        if (!closes(quiet[i], 10)) fail_msg("connection %d is still open", i);
        close(quiet[i]);
    }
    assert_true(time_seconds() - begun < 12);
    server_patience = 1;
    assert_alive();
}

static void many_connections(void **state) {
    enum { MANY = 150 };
    int fd[MANY];
    server_patience = 0.1;
    for (int i = 0; i < MANY; i++) fd[i] = connected(); /* more clients than are served at a time */
    assert_alive(); /* as soon as the first ones have used up their time */
    for (int i = 0; i < MANY; i++) close(fd[i]);
    server_patience = 1;
    assert_alive();
}

/* ---- videos ---- */
static cJSON *film_state_of(const char *client) {
    const answer *a = get("/film?client=%s", client);
    assert_status(a, 200);
    cJSON *json = cJSON_ParseWithLength((const char *)a->body, a->bytes);
    assert_non_null(json);
    return json;
}

static void films(void **state) {
    char state_text[32] = "running";
    assert_status(with("POST", "/film?client=dora&w=64&h=48&turn=0&motion=1", HOST), 409); /* a pose */
    assert_status(with("POST", "/film?client=dora&w=1600&h=1600&turn=2", HOST), 400);
    assert_status(with("POST", "/film?client=dora&w=64&h=48&turn=3&fps=10", HOST), 200);
    for (int i = 0; i < 600 && strcmp(state_text, "running") == 0; i++) {
        usleep(50000);
        cJSON *json = film_state_of("dora");
        snprintf(state_text, sizeof state_text, "%s", cJSON_GetObjectItem(json, "state")->valuestring);
        if (strcmp(state_text, "failed") == 0)
            print_message("%s\n", cJSON_GetObjectItem(json, "message")->valuestring);
        cJSON_Delete(json);
    }
    if (strcmp(state_text, "failed") == 0) skip(); /* FFmpeg without an H.264 encoder */
    assert_string_equal(state_text, "done");
    const answer *a = get("/film.mp4?client=dora");
    assert_status(a, 200);
    assert_true(has(a, "video/mp4") && a->bytes > 200);
    assert_memory_equal(a->body + 4, "ftyp", 4);
    assert_status(with("DELETE", "/film?client=dora", HOST), 200);
    assert_status(get("/film.mp4?client=dora"), 404);
    /* a video that is given up while it is made */
    assert_status(with("POST", "/film?client=emil&w=256&h=256&turn=300", HOST), 200);
    assert_status(with("POST", "/film?client=emil&w=64&h=64&turn=3", HOST), 409);
    assert_status(get("/frame?client=dora&n=1&w=32&h=32"), 200); /* pictures do not wait for the video */
    assert_status(with("DELETE", "/film?client=emil", HOST), 200);
    for (int i = 0; i < 200; i++) {
        cJSON *json = film_state_of("emil");
        bool none = strcmp(cJSON_GetObjectItem(json, "state")->valuestring, "none") == 0;
        cJSON_Delete(json);
        if (none) return;
        usleep(50000);
    }
    fail_msg("the film goes on");
}

static void bad_options(void **state) {
    context *c = all.c;
    sherf_viewer *v;
    sherf_viewer_avatar avatar = {"a", all.avatar, all.body};
    sherf_viewer_options o = {.avatars = &avatar, .avatar_count = 1, .listen = "localhost"};
    assert_int_equal(sherf_viewer_create(c, &o, &v), SHERF_BAD_ARGUMENT);
    assert_null(v);
    o.listen = NULL;
    o.port = all.port; /* the port is taken */
    assert_int_equal(sherf_viewer_create(c, &o, &v), SHERF_UNSUPPORTED);
    o.port = 70000;
    assert_int_equal(sherf_viewer_create(c, &o, &v), SHERF_BAD_ARGUMENT);
    o.port = 0;
    o.avatar_count = 0;
    assert_int_equal(sherf_viewer_create(c, &o, &v), SHERF_BAD_ARGUMENT);
    o.avatar_count = 1;
    o.size_px = 5000;
    assert_int_equal(sherf_viewer_create(c, &o, &v), SHERF_BAD_ARGUMENT);
    o.size_px = 0;
    assert_ok(c, sherf_viewer_create(c, &o, &v)); /* closed without clients, and never run */
    sherf_viewer_free(v);
}

/* ---- setting up ---- */
static void *run(void *arg) {
    return sherf_viewer_run(all.runs, all.viewer) == SHERF_OK ? arg : NULL;
}

static int setup(void **state) {
    context *c = all.c = test_context();
    all.runs = test_context();
    const sherf_synth_options synth = {.people = 1, .poses = 1, .views = 1, .size_px = 64};
    sherf_model *m = NULL;
    sherf_dataset *d = NULL;
    sherf_observation *o = NULL;
    char folder[600];
    snprintf(folder, sizeof folder, "%s", test_path("people"));
    assert_ok(c, sherf_synth_tube(c, folder, &synth));
    assert_ok(c, sherf_body_load(c, test_path("people/tubeman.safetensors"), &all.body));
    assert_ok(c, sherf_model_create(
                     c, "small,encoder_width=8,style_width=16,plane_resolution=16,channel_max=16", 3, &m));
    /* dense everywhere, so that everything near the body is visible */
    *(float *)parameter_find(m->weights, "decoder.alpha_linear.bias")->value.data = 100;
    assert_ok(c, sherf_dataset_open(c, folder, &d));
    assert_ok(c, sherf_dataset_observation(c, d, 0, 0, 0, &o));
    assert_ok(c, sherf_avatar_create(c, m, all.body, o, &all.avatar));
    sherf_observation_free(o);
    sherf_dataset_free(d);
    sherf_model_free(m);
    for (int i = 0; i < POSES; i++) { /* a walk of half a metre a frame */
        sherf_pose_identity(&all.poses[i]);
        all.poses[i].Th_m[0] = 0.5f * (float)i;
        all.poses[i].poses_rad[3 * 16] = 0.1f * (float)i;
    }
    const sherf_bake_options coarse = {.resolution = 64, .triangles = 2000, .texture_px = 128};
    assert_ok(c, sherf_avatar_bake(c, all.avatar, all.body, &coarse, &all.baked));
    sherf_viewer_avatar avatars[] = {{"tube \"<b>\" man", all.avatar, all.body}, {"b", all.baked, all.body}};
    sherf_viewer_motion motion = {"walk", all.poses, POSES, 10};
    sherf_viewer_options options = {
        .avatars = avatars, .avatar_count = 2, .motions = &motion, .motion_count = 1};
    sherf_status status = sherf_viewer_create(c, &options, &all.viewer);
    if (status == SHERF_UNSUPPORTED) return 1;
    assert_ok(c, status);
    assert_int_equal(
        sscanf(sherf_viewer_address(all.viewer), "http://127.0.0.1:%d/%32s", &all.port, all.token), 2);
    assert_int_equal(strlen(all.token), VIEWER_TOKEN);
    return pthread_create(&all.thread, NULL, run, &all);
}

static int teardown(void **state) {
    void *good = &all;
    if (all.viewer) {
        char path[300]; /* a client waits for a large picture when the end comes */
        snprintf(path, sizeof path, "/%s/frame?client=last&n=1&w=1024&h=1024", all.token);
        int fd = start_request("GET", path, HOST);
        usleep(100000);
        sherf_cancel(all.runs);
        double begun = time_seconds();
        pthread_join(all.thread, &good);
        if (time_seconds() - begun > 5) good = NULL;
        sherf_viewer_free(all.viewer);
        int status = receive(fd)->status;
        if (status != 503 && status != 0) good = NULL;
    }
    sherf_avatar_free(all.avatar);
    sherf_avatar_free(all.baked);
    sherf_body_free(all.body);
    sherf_context_free(all.runs);
    sherf_context_free(all.c);
    if (mem_live()) print_error("%zu blocks are left\n", mem_live());
    return good && mem_live() == 0 ? 0 : -1;
}

int main(void) {
    void *none = NULL;
    if (setup(&none)) { /* built without libmicrohttpd */
        teardown(&none);
        return 77;
    }
    const struct CMUnitTest tests[] = {cmocka_unit_test(page),
                                       cmocka_unit_test(about),
                                       cmocka_unit_test(pictures),
                                       cmocka_unit_test(surface_stands_in_the_picture),
                                       cmocka_unit_test(baked_avatars),
                                       cmocka_unit_test(surfaces_and_moves_there_are_not),
                                       cmocka_unit_test(bands_and_following),
                                       cmocka_unit_test(strangers),
                                       cmocka_unit_test(nonsense),
                                       cmocka_unit_test(oversized),
                                       cmocka_unit_test(newest_request_wins),
                                       cmocka_unit_test(vanishing),
                                       cmocka_unit_test(stalling),
                                       cmocka_unit_test(many_connections),
                                       cmocka_unit_test(films),
                                       cmocka_unit_test(bad_options)};
    return cmocka_run_group_tests(tests, NULL, teardown);
}
