/* Tests of videos: written, reopened through FFmpeg, with the right number and size of frames and similar
 * colours. */
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/pixdesc.h>
#include <math.h>
#include <stdlib.h>

#include "io/palette.h"
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

typedef struct {
    int frames;
    double fps, seconds;
    int luma[2];  /* in the last frame, at a quarter and three quarters of the middle row */
    int alpha[2]; /* at the same places; -1: the format has none */
} decoded;

/* Decodes the whole file. `decoder`: by name; NULL: any decoder. */
static void decode(const char *path, enum AVCodecID id, const char *decoder, int width, int height,
                   decoded *out) {
    AVFormatContext *f = NULL;
    *out = (decoded){.alpha = {-1, -1}};
    assert_int_equal(avformat_open_input(&f, path, NULL, NULL), 0);
    assert_true(avformat_find_stream_info(f, NULL) >= 0);
    const AVStream *stream = f->streams[0];
    const AVCodec *codec = decoder ? avcodec_find_decoder_by_name(decoder) : avcodec_find_decoder(id);
    assert_int_equal(stream->codecpar->codec_id, id);
    out->fps = av_q2d(stream->avg_frame_rate);
    out->seconds = (double)f->duration / AV_TIME_BASE;
    AVCodecContext *x = avcodec_alloc_context3(codec);
    avcodec_parameters_to_context(x, stream->codecpar);
    assert_int_equal(avcodec_open2(x, codec, NULL), 0);
    AVPacket *packet = av_packet_alloc();
    AVFrame *frame = av_frame_alloc();
    bool more = true;
    while (more) {
        more = av_read_frame(f, packet) >= 0;
        avcodec_send_packet(x, more ? packet : NULL);
        av_packet_unref(packet);
        while (avcodec_receive_frame(x, frame) >= 0) {
            bool bytes4 = frame->format == AV_PIX_FMT_BGRA; /* GIF */
            out->frames++;
            assert_int_equal(frame->width, width);
            assert_int_equal(frame->height, height);
            for (int k = 0; k < 2; k++) {
                int at = width / 4 + k * (width / 2), y = height / 2;
                const uint8_t *p = frame->data[0] + y * frame->linesize[0] + at * (bytes4 ? 4 : 1);
                out->luma[k] = bytes4 ? p[1] : p[0]; /* green at its place */
                if (bytes4) out->alpha[k] = p[3];
                const AVPixFmtDescriptor *form = av_pix_fmt_desc_get(frame->format);
                if (form->comp[0].depth > 8) { /* 10 or 12 bits */
                    const uint16_t *wide =
                        (const uint16_t *)(const void *)(frame->data[0] + y * frame->linesize[0]);
                    out->luma[k] = wide[at] >> (form->comp[0].depth - 8);
                    if (form->nb_components == 4) {
                        wide = (const uint16_t *)(const void *)(frame->data[3] + y * frame->linesize[3]);
                        out->alpha[k] = wide[at] >> (form->comp[3].depth - 8);
                    }
                }
                if (frame->format == AV_PIX_FMT_YUVA420P)
                    out->alpha[k] = frame->data[3][y * frame->linesize[3] + at];
            }
        }
    }
    av_packet_free(&packet);
    av_frame_free(&frame);
    avcodec_free_context(&x);
    avformat_close_input(&f);
}

static void test_video(void **state) {
    context *c = *state;
    const char *path = test_path("v.mp4");
    sherf_image image = {61, 45, 3, calloc(61 * 45 * 3, sizeof(float))};
    sherf_video *v;
    decoded d;
    assert_ok(c, sherf_video_open(c, path, 61, 45, 25, &v));
    for (int i = 0; i < FRAMES; i++) {
        paint(&image, i);
        assert_ok(c, sherf_video_add(c, v, &image));
    }
    assert_false(path_is_file(path)); /* not before it is complete */
    assert_ok(c, sherf_video_close(c, v));
    decode(path, AV_CODEC_ID_H264, NULL, 62, 46, &d);
    assert_int_equal(d.frames, FRAMES);
    assert_float_equal(d.fps, 25, 0.01);
    /* BT.709, limited: 16 + 219 (.2126 r + .7152 g + .0722 b), b = 0.9 in the last frame */
    for (int k = 0; k < 2; k++) {
        double want = 16 + 219 * (0.2126 * (k ? 0.1 : 0.9) + 0.7152 * 0.5 + 0.0722 * 0.9);
        if (fabs(d.luma[k] - want) > 4) fail_msg("luma %d, not %.1f", d.luma[k], want);
    }
    free(image.data);
}

/* WebM, GIF and MOV with and without alpha: the left half is opaque, the right half transparent. */
static void test_alpha(void **state) {
    context *c = *state;
    static const struct {
        const char *name, *decoder;
        enum AVCodecID id;
        int width, height;
    } kind[] = {{"v.webm", "libvpx-vp9", AV_CODEC_ID_VP9, 62, 46},
                {"v.gif", NULL, AV_CODEC_ID_GIF, 61, 45},
                {"v.mov", NULL, AV_CODEC_ID_PRORES, 62, 46}};
    for (size_t n = 0; n < 2 * COUNT_OF(kind); n++) {
        const char *path = test_path(kind[n / 2].name);
        bool alpha = n % 2;
        int channels = alpha ? 4 : 3;
        sherf_image image = {61, 45, channels, calloc(61 * 45 * 4, sizeof(float))};
        sherf_video *v;
        decoded d;
        const sherf_video_options o = {.width = 61, .height = 45, .fps = 20, .alpha = alpha};
        assert_ok(c, sherf_video_create(c, path, &o, &v));
        for (int i = 0; i < FRAMES; i++) {
            for (int p = 0; p < 61 * 45; p++)
                for (int k = 0; k < channels; k++)
                    image.data[channels * p + k] = k < 3 ? 0.6f : p % 61 < 30 ? 1 : 0;
            image.data[(size_t)channels * (size_t)i] = 0.1f; /* unchanged frames would be left out */
            assert_ok(c, sherf_video_add(c, v, &image));
        }
        assert_ok(c, sherf_video_close(c, v));
        decode(path, kind[n / 2].id, kind[n / 2].decoder, kind[n / 2].width, kind[n / 2].height, &d);
        assert_int_equal(d.frames, FRAMES);
        assert_float_equal(d.fps, 20, 0.01);
        assert_float_equal(d.seconds, FRAMES / 20.0, 0.051);
        bool gif = kind[n / 2].id == AV_CODEC_ID_GIF;
        assert_float_equal(d.luma[0], gif ? 0.6 * 255 : 16 + 219 * 0.6, 5);
        if (alpha) assert_true(d.alpha[0] > 250 && d.alpha[1] < 5);
        if (gif && !alpha) assert_true(d.alpha[1] == 255);
        if (!gif && !alpha) assert_int_equal(d.alpha[1], -1);
        free(image.data);
    }
    const sherf_video_options mp4 = {.width = 61, .height = 45, .fps = 20, .alpha = 1};
    sherf_video *v;
    assert_int_equal(sherf_video_create(c, test_path("a.mp4"), &mp4, &v), SHERF_UNSUPPORTED);
    assert_non_null(strstr(c->message, "transparency"));
}

/* 256 colours for a picture with more: none is far off, and greys stay grey. */
static void test_palette(void **state) {
    context *c = *state;
    enum { SIDE = 64 };
    static uint8_t rgba[SIDE * SIDE * 4], index[SIDE * SIDE];
    uint32_t color[256];
    palette *p;
    assert_ok(c, palette_create(c, &p));
    for (int i = 0; i < SIDE * SIDE; i++) {
        rgba[4 * i] = (uint8_t)(i % SIDE * 4);
        rgba[4 * i + 1] = (uint8_t)(i / SIDE * 4);
        rgba[4 * i + 2] = (uint8_t)((i % SIDE + i / SIDE) * 2);
        rgba[4 * i + 3] = i < 100 ? 0 : 255;
    }
    palette_apply(p, rgba, SIDE, SIDE, true, color, index, SIDE);
    double error = 0;
    for (int i = 0; i < SIDE * SIDE; i++) {
        assert_int_equal(index[i] == PALETTE_CLEAR, i < 100);
        for (int k = 0; k < 3 && i >= 100; k++) {
            int off = (int)(color[index[i]] >> (16 - 8 * k) & 255) - rgba[4 * i + k];
            error += off * off / (3.0 * SIDE * SIDE);
        }
    }
    assert_true(sqrt(error) < 9);
    for (int i = 0; i < SIDE * SIDE; i++) memset(rgba + 4 * i, i % 3 * 100, 3), rgba[4 * i + 3] = 255;
    palette_apply(p, rgba, SIDE, SIDE, false, color, index, SIDE);
    for (int i = 0; i < SIDE * SIDE; i++)
        for (int k = 0; k < 3; k++)
            assert_true(abs((int)(color[index[i]] >> (16 - 8 * k) & 255) - i % 3 * 100) <= 4);
    memset(rgba, 0, sizeof rgba); /* everything is transparent */
    palette_apply(p, rgba, SIDE, SIDE, true, color, index, SIDE);
    for (int i = 0; i < SIDE * SIDE; i++) assert_int_equal(index[i], PALETTE_CLEAR);
    palette_free(p);
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

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_video), cmocka_unit_test(test_alpha),
                                       cmocka_unit_test(test_palette), cmocka_unit_test(test_refused)};
    return cmocka_run_group_tests(tests, test_open, test_close);
}
