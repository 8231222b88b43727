/* Videos: written, opened again through FFmpeg, right number and size of frames, colours near. */
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <math.h>

#include "sample.h"

enum { FRAMES = 10 };

static void paint(sherf_image *image, int frame) {
    for (int y = 0; y < image->height; y++)
        for (int x = 0; x < image->width; x++) {
            float *p = image->data + ((size_t)y * (size_t)image->width + (size_t)x) * 3;
            p[0] = x < image->width / 2 ? 0.9f : 0.1f;
            p[1] = 0.5f;
            p[2] = (float)frame / FRAMES;
        }
}

/* Frames in the file; the luma of the last one at two places. */
static int decode(const char *path, int width, int height, int luma[2]) {
    AVFormatContext *f = NULL;
    int frames = 0;
    assert_int_equal(avformat_open_input(&f, path, NULL, NULL), 0);
    assert_true(avformat_find_stream_info(f, NULL) >= 0);
    const AVCodec *codec = avcodec_find_decoder(f->streams[0]->codecpar->codec_id);
    assert_int_equal(f->streams[0]->codecpar->codec_id, AV_CODEC_ID_H264);
    AVCodecContext *x = avcodec_alloc_context3(codec);
    avcodec_parameters_to_context(x, f->streams[0]->codecpar);
    assert_int_equal(avcodec_open2(x, codec, NULL), 0);
    AVPacket *packet = av_packet_alloc();
    AVFrame *frame = av_frame_alloc();
    bool more = true;
    while (more) {
        more = av_read_frame(f, packet) >= 0;
        avcodec_send_packet(x, more ? packet : NULL);
        av_packet_unref(packet);
        while (avcodec_receive_frame(x, frame) >= 0) {
            frames++;
            assert_int_equal(frame->width, width);
            assert_int_equal(frame->height, height);
            luma[0] = frame->data[0][(height / 2) * frame->linesize[0] + width / 4];
            luma[1] = frame->data[0][(height / 2) * frame->linesize[0] + width * 3 / 4];
        }
    }
    av_packet_free(&packet);
    av_frame_free(&frame);
    avcodec_free_context(&x);
    avformat_close_input(&f);
    return frames;
}

static void test_video(void **state) {
    context *c = *state;
    const char *path = test_path("v.mp4");
    sherf_image image = {61, 45, 3, calloc(61 * 45 * 3, sizeof(float))};
    sherf_video *v;
    int luma[2];
    assert_ok(c, sherf_video_open(c, path, 61, 45, 25, &v));
    for (int i = 0; i < FRAMES; i++) {
        paint(&image, i);
        assert_ok(c, sherf_video_add(c, v, &image));
    }
    assert_false(path_is_file(path)); /* not before it is whole */
    assert_ok(c, sherf_video_close(c, v));
    assert_int_equal(decode(path, 62, 46, luma), FRAMES);
    /* BT.709, limited: 16 + 219 (.2126 r + .7152 g + .0722 b), b = 0.9 in the last frame */
    for (int k = 0; k < 2; k++) {
        double want = 16 + 219 * (0.2126 * (k ? 0.1 : 0.9) + 0.7152 * 0.5 + 0.0722 * 0.9);
        if (fabs(luma[k] - want) > 4) fail_msg("luma %d, not %.1f", luma[k], want);
    }
    free(image.data);
}

static void test_refused(void **state) {
    context *c = *state;
    sherf_video *v;
    const char *path = test_path("w.mp4");
    float data[8 * 8 * 3] = {0};
    sherf_image image = {8, 8, 3, data};
    assert_int_equal(sherf_video_open(c, "/nowhere/v.mp4", 64, 64, 25, &v), SHERF_WRITE_FAILED);
    assert_null(v);
    assert_int_equal(sherf_video_open(c, path, 0, 64, 25, &v), SHERF_BAD_ARGUMENT);
    assert_int_equal(sherf_video_open(c, path, 64, 64, 0, &v), SHERF_BAD_ARGUMENT);
    assert_int_equal(sherf_video_open(c, test_path("v.avi"), 64, 64, 25, &v), SHERF_BAD_ARGUMENT);
    assert_ok(c, sherf_video_open(c, path, 64, 64, 25, &v));
    assert_int_equal(sherf_video_add(c, v, &image), SHERF_BAD_ARGUMENT);
    sherf_video_abort(v);
    assert_false(path_is_file(path));
    assert_ok(c, sherf_video_open(c, path, 64, 64, 25, &v));
    assert_int_equal(sherf_video_close(c, v), SHERF_BAD_ARGUMENT); /* no frames */
    assert_false(path_is_file(path));
    sherf_video_abort(NULL);
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
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_video), cmocka_unit_test(test_refused)};
    return cmocka_run_group_tests(tests, setup, teardown);
}
