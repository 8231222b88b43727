/* Tests of reading videos: files of the project's own writer are read back upright, in time and in the
 * requested size; other data is refused. */
#include <libavformat/avformat.h>
#include <libavutil/display.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/path.h"
#include "io/video_read.h"
#include "support.h"

enum { FRAMES = 8, WIDE = 64, HIGH = 48 };

/* A frame with a bright square in the upper left corner; the rest gets lighter from frame to frame. */
static float shade(int frame) {
    return 0.1f + 0.07f * (float)frame;
}

static void write_clip(context *c, const char *path, double fps) {
    sherf_video *v;
    sherf_image image = {WIDE, HIGH, 3, mem_alloc(c, WIDE * HIGH * 3, sizeof(float))};
    assert_ok(c, sherf_video_open(c, path, WIDE, HIGH, fps, &v));
    for (int i = 0; i < FRAMES; i++) {
        for (int y = 0; y < HIGH; y++)
            for (int x = 0; x < WIDE; x++)
                for (int k = 0; k < 3; k++)
                    image.data[(y * WIDE + x) * 3 + k] = x < 16 && y < 16 ? (k == 0 ? 0.9f : 0.8f) : shade(i);
        assert_ok(c, sherf_video_add(c, v, &image));
    }
    assert_ok(c, sherf_video_close(c, v));
    mem_free(image.data);
}

static int value(const image_u8 *p, double u, double v, int channel) {
    int x = (int)(u * p->width), y = (int)(v * p->height);
    return p->data[((size_t)y * (size_t)p->width + (size_t)x) * 3 + (size_t)channel];
}

/* Reads all frames and counts repeated ones. shades (may be NULL): the middle of each frame. */
static int read_all(context *c, video_reader *v, int *repeated, int *shades, int max) {
    const image_u8 *p;
    int count = 0;
    bool again;
    *repeated = 0;
    for (;; count++) {
        assert_ok(c, video_read_next(c, v, &p, &again));
        if (!p) break;
        *repeated += again;
        if (shades && count < max) shades[count] = value(p, 0.6, 0.6, 1);
    }
    return count;
}

static void own_videos(void **state) {
    context *c = *state;
    static const char *const names[] = {"a.mp4", "b.webm", "c.gif"};
    for (size_t i = 0; i < COUNT_OF(names); i++) {
        const char *path = test_path(names[i]);
        video_reader *v;
        int shades[FRAMES], repeated;
        const image_u8 *p;
        write_clip(c, path, 20);
        assert_ok(c, video_read_open(c, path, NULL, &v));
        assert_int_equal(video_read_information(v)->width, WIDE);
        assert_int_equal(video_read_information(v)->height, HIGH);
        assert_true(fabs(video_read_information(v)->fps - 20) < 0.01);
        assert_ok(c, video_read_next(c, v, &p, NULL));
        assert_non_null(p);
        assert_in_range(value(p, 0.1, 0.1, 0), 222, 238); /* 0.9 and 0.8 */
        assert_in_range(value(p, 0.1, 0.1, 1), 196, 212);
        video_read_close(v);
        assert_ok(c, video_read_open(c, path, NULL, &v));
        assert_int_equal(read_all(c, v, &repeated, shades, FRAMES), FRAMES);
        assert_int_equal(repeated, 0);
        for (int f = 0; f < FRAMES; f++)
            if (fabs(shades[f] - 255 * (double)shade(f)) > 8)
                fail_msg("%s, frame %d: %d, not %.0f", names[i], f, shades[f], 255 * (double)shade(f));
        assert_ok(c, video_read_next(c, v, &p, NULL)); /* after the end, reading stays at the end */
        assert_null(p);
        video_read_close(v);
    }
}

static void smaller_and_at_another_rate(void **state) {
    context *c = *state;
    const char *path = test_path("d.mp4");
    video_reader *v;
    int shades[2 * FRAMES], repeated;
    write_clip(c, path, 20);
    assert_ok(c, video_read_open(c, path, &(video_read_options){.side_px = 32, .fps = 10}, &v));
    assert_int_equal(video_read_information(v)->width, 32);
    assert_int_equal(video_read_information(v)->height, 24);
    assert_int_equal(video_read_information(v)->full_width, WIDE);
    assert_int_equal(read_all(c, v, &repeated, shades, 2 * FRAMES), FRAMES / 2);
    assert_int_equal(repeated, 0);
    assert_true(fabs(shades[2] - 255 * (double)shade(4)) < 10);
    video_read_close(v);
    assert_ok(c, video_read_open(c, path, &(video_read_options){.fps = 40}, &v));
    assert_in_range(read_all(c, v, &repeated, shades, 2 * FRAMES), 2 * FRAMES - 1, 2 * FRAMES);
    assert_in_range(repeated, FRAMES - 1, FRAMES);
    video_read_close(v);
}

/* The same packets with another display matrix. */
static void turn_file(const char *from, const char *to, double degrees, bool mirrored) {
    AVFormatContext *in = NULL, *out = NULL;
    assert_int_equal(avformat_open_input(&in, from, NULL, NULL), 0);
    assert_true(avformat_find_stream_info(in, NULL) >= 0);
    assert_true(avformat_alloc_output_context2(&out, NULL, "mp4", to) >= 0);
    AVStream *a = in->streams[0], *b = avformat_new_stream(out, NULL);
    assert_true(avcodec_parameters_copy(b->codecpar, a->codecpar) >= 0);
    b->codecpar->codec_tag = 0;
    b->time_base = a->time_base;
    int32_t *matrix =
        (int32_t *)(void *)av_stream_new_side_data(b, AV_PKT_DATA_DISPLAYMATRIX, 9 * sizeof *matrix);
    assert_non_null(matrix);
    av_display_rotation_set(matrix, degrees);
    if (mirrored) av_display_matrix_flip(matrix, 1, 0);
    assert_true(avio_open(&out->pb, to, AVIO_FLAG_WRITE) >= 0);
    assert_true(avformat_write_header(out, NULL) >= 0);
    AVPacket *p = av_packet_alloc();
    while (av_read_frame(in, p) >= 0) {
        av_packet_rescale_ts(p, a->time_base, b->time_base);
        assert_true(av_interleaved_write_frame(out, p) >= 0);
    }
    assert_int_equal(av_write_trailer(out), 0);
    av_packet_free(&p);
    avio_closep(&out->pb);
    avformat_free_context(out);
    avformat_close_input(&in);
}

/* Where the bright corner is after turning. A phone held upright states 90 degrees clockwise, which FFmpeg's
 * helper writes as +90 in its own sense (av_display_rotation_set turns clockwise). */
static void display_matrix(void **state) {
    context *c = *state;
    static const struct {
        double degrees;
        bool mirrored;
        double u, v;
    } list[] = {{90, false, 0.9, 0.1}, {180, false, 0.9, 0.9}, {270, false, 0.1, 0.9},
                {0, true, 0.9, 0.1},   {0, false, 0.1, 0.1},   {90, true, 0.1, 0.1}};
    char flat[PATH_LENGTH];
    snprintf(flat, sizeof flat, "%s", test_path("flat.mp4")); /* copied, because the storage is reused */
    write_clip(c, flat, 20);
    for (size_t i = 0; i < COUNT_OF(list); i++) {
        char name[32];
        snprintf(name, sizeof name, "turned%zu.mp4", i);
        const char *path = test_path(name);
        turn_file(flat, path, list[i].degrees, list[i].mirrored);
        video_reader *v;
        const image_u8 *p;
        assert_ok(c, video_read_open(c, path, NULL, &v));
        const bool across = fmod(list[i].degrees, 180) != 0;
        assert_int_equal(video_read_information(v)->width, across ? HIGH : WIDE);
        assert_int_equal(video_read_information(v)->full_height, across ? WIDE : HIGH);
        assert_ok(c, video_read_next(c, v, &p, NULL));
        for (int corner = 0; corner < 4; corner++) {
            const double x = corner & 1 ? 0.9 : 0.1, y = corner & 2 ? 0.9 : 0.1;
            const bool bright = value(p, x, y, 0) > 180, wanted = x == list[i].u && y == list[i].v;
            if (bright != wanted)
                fail_msg("%g degrees%s: corner %d is %d", list[i].degrees,
                         list[i].mirrored ? ", mirrored" : "", corner, value(p, x, y, 0));
        }
        video_read_close(v);
    }
}

static void refuse(context *c, const void *data, size_t bytes, sherf_status wanted, const char *word) {
    video_reader *v;
    sherf_status status = video_read_parse(c, data, bytes, NULL, &v);
    if (status == SHERF_OK) {
        const image_u8 *p;
        status = video_read_next(c, v, &p, NULL);
        video_read_close(v);
    }
    if (status != wanted || !strstr(c->message, word) || strchr(c->message, '\n'))
        fail_msg("status %d, not %d: %s", (int)status, (int)wanted, c->message);
}

static void hostile(void **state) {
    context *c = *state;
    video_reader *v;
    unsigned char *data;
    size_t bytes;
    const char *path = test_path("e.mp4");
    write_clip(c, path, 20);
    assert_ok(c, file_read(c, path, 1 << 24, &data, &bytes));
    refuse(c, "", 0, SHERF_BAD_FILE, "not a video");
    refuse(c, "no video at all, only text", 26, SHERF_BAD_FILE, "not a video");
    static const char list[] = "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n/etc/passwd\n#EXT-X-ENDLIST\n",
                      more[] = "ffconcat version 1.0\nfile /etc/passwd\n";
    refuse(c, list, sizeof list - 1, SHERF_BAD_FILE, "not a video"); /* it would open other files */
    refuse(c, more, sizeof more - 1, SHERF_BAD_FILE, "not a video");
    assert_int_equal(video_read_parse(c, data, bytes, &(video_read_options){.pixels_max = 1000}, &v),
                     SHERF_UNSUPPORTED);
    assert_non_null(strstr(c->message, "too large"));
    /* truncated anywhere, it gives frames or an error line */
    const size_t live = mem_live();
    for (size_t n = 0; n < bytes; n += bytes / 40) {
        const image_u8 *p;
        sherf_status status = video_read_parse(c, data, n, NULL, &v);
        assert_true(status == SHERF_OK || !v);
        for (int i = 0; status == SHERF_OK && i < 100; i++)
            if ((status = video_read_next(c, v, &p, NULL)) == SHERF_OK && !p) break;
        video_read_close(v);
        assert_true(status == SHERF_OK || c->message[0]);
        assert_int_equal(mem_live(), live);
    }
    mem_free(data);
    assert_int_equal(video_read_open(c, test_path("absent.mp4"), NULL, &v), SHERF_NO_FILE);
    assert_int_equal(video_read_open(c, "/tmp", NULL, &v), SHERF_NO_FILE);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(own_videos),
        cmocka_unit_test(smaller_and_at_another_rate),
        cmocka_unit_test(display_matrix),
        cmocka_unit_test(hostile),
    };
    return cmocka_run_group_tests(tests, test_open, test_close);
}
