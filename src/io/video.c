/* video: frames to a file through FFmpeg's libraries: H.264 in MP4, VP9 in WebM and ProRes in MOV (with alpha
 * on request), GIF. The file gets its name when it is complete. Colours are BT.709, limited range, and tagged
 * so; except in GIF, odd sizes are made even by repeating the last row and column. */
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/imgutils.h>
#include <libavutil/opt.h>
#include <libswscale/swscale.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "base/path.h"
#include "io/image.h"
#include "io/palette.h"

enum { VIDEO_SIDE_MAX = 8192 };

typedef struct {
    const char *extension, *container, *name; /* name: for messages */
    const char *encoder;                      /* the preferred one */
    enum AVCodecID codec;                     /* or any of these */
    bool alpha;                               /* may have it */
} video_form;

static const video_form forms[] = {
    {".mp4", "mp4", "H.264", "libx264", AV_CODEC_ID_H264, false},
    {".webm", "webm", "VP9", "libvpx-vp9", AV_CODEC_ID_VP9, true},
    {".mov", "mov", "ProRes", "prores_ks", AV_CODEC_ID_PRORES, true},
    {".gif", "gif", "GIF", "gif", AV_CODEC_ID_GIF, true},
};

struct sherf_video {
    char final[PATH_LENGTH], temporary[PATH_LENGTH];
    const video_form *form;
    int width, height, channels; /* as given */
    AVFormatContext *container;
    AVCodecContext *codec;
    AVStream *stream; /* owned by container */
    AVFrame *frame;
    AVPacket *packet;
    struct SwsContext *scaler; /* NULL for a palette */
    palette *palette;          /* NULL for others */
    uint8_t *rgba;             /* 4 bytes per pixel, of the size that is written */
    int64_t count;
    bool created; /* the temporary file exists */
};

static sherf_status failed(context *c, sherf_status status, const sherf_video *v, const char *what,
                           int code) {
    char text[AV_ERROR_MAX_STRING_SIZE] = "";
    if (code < 0) av_strerror(code, text, sizeof text);
    return failure(c, status, "%s: %s %s%s%s", v->final, v->form->name, what, *text ? ": " : "", text);
}

static enum AVPixelFormat pixels_of(const sherf_video *v) {
    if (v->form->codec == AV_CODEC_ID_GIF) return AV_PIX_FMT_PAL8;
    if (v->form->codec == AV_CODEC_ID_PRORES)
        return v->channels == 4 ? AV_PIX_FMT_YUVA444P10 : AV_PIX_FMT_YUV444P10;
    return v->channels == 4 ? AV_PIX_FMT_YUVA420P : AV_PIX_FMT_YUV420P;
}

/* Good constant quality; VP9 is set fast enough to keep up with the frames. */
static void choose_quality(AVCodecContext *x, bool alpha) {
    if (!strcmp(x->codec->name, "libx264")) {
        av_opt_set(x->priv_data, "preset", "medium", 0);
        av_opt_set(x->priv_data, "crf", "18", 0);
    } else if (!strcmp(x->codec->name, "libvpx-vp9")) {
        av_opt_set(x->priv_data, "crf", "24", 0);
        av_opt_set(x->priv_data, "deadline", "good", 0);
        av_opt_set(x->priv_data, "cpu-used", "5", 0);
        av_opt_set(x->priv_data, "row-mt", "1", 0);
        if (alpha) av_opt_set(x->priv_data, "auto-alt-ref", "0", 0); /* it does not support alpha */
    } else if (!strcmp(x->codec->name, "prores_ks")) {
        av_opt_set(x->priv_data, "profile", "4444", 0);
        av_opt_set(x->priv_data, "vendor", "apl0", 0); /* QuickTime requires it */
    } else if (x->codec_id != AV_CODEC_ID_GIF)
        x->bit_rate = (int64_t)x->width * x->height * 8;
}

static sherf_status open_codec(context *c, sherf_video *v, AVRational rate) {
    const AVCodec *codec = avcodec_find_encoder_by_name(v->form->encoder);
    if (!codec) codec = avcodec_find_encoder(v->form->codec);
    if (!codec) return failed(c, SHERF_UNSUPPORTED, v, "cannot be encoded by the FFmpeg here", 0);
    AVCodecContext *x = v->codec = avcodec_alloc_context3(codec);
    if (!x) return failure(c, SHERF_NO_MEMORY, "out of memory");
    bool even = v->form->codec != AV_CODEC_ID_GIF;
    x->width = even ? (v->width + 1) & ~1 : v->width;
    x->height = even ? (v->height + 1) & ~1 : v->height;
    x->pix_fmt = pixels_of(v);
    x->framerate = rate;
    x->time_base = av_inv_q(rate);
    x->gop_size = 48;
    x->thread_count = c->threads;
    if (even) {
        x->color_range = AVCOL_RANGE_MPEG;
        x->colorspace = AVCOL_SPC_BT709;
        x->color_primaries = AVCOL_PRI_BT709;
        x->color_trc = AVCOL_TRC_BT709;
    }
    if (v->container->oformat->flags & AVFMT_GLOBALHEADER) x->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
    choose_quality(x, v->channels == 4);
    int code = avcodec_open2(x, codec, NULL);
    return code < 0 ? failed(c, SHERF_UNSUPPORTED, v, "cannot be encoded here", code) : SHERF_OK;
}

static sherf_status open_file(context *c, sherf_video *v, AVRational rate) {
    int code = avformat_alloc_output_context2(&v->container, NULL, v->form->container, v->temporary);
    if (code < 0) return failed(c, SHERF_UNSUPPORTED, v, "cannot be written by the FFmpeg here", code);
    sherf_status status = open_codec(c, v, rate);
    if (status != SHERF_OK) return status;
    v->stream = avformat_new_stream(v->container, NULL);
    if (!v->stream) return failure(c, SHERF_NO_MEMORY, "out of memory");
    v->stream->time_base = v->codec->time_base;
    v->stream->avg_frame_rate = rate;
    if (v->channels == 4 && v->form->codec == AV_CODEC_ID_VP9)
        av_dict_set(&v->stream->metadata, "alpha_mode", "1", 0);
    code = avcodec_parameters_from_context(v->stream->codecpar, v->codec);
    if (code < 0) return failed(c, SHERF_NO_MEMORY, v, "stream cannot be described", code);
    code = avio_open(&v->container->pb, v->temporary, AVIO_FLAG_WRITE);
    if (code < 0) return failed(c, SHERF_WRITE_FAILED, v, "cannot be written", code);
    v->created = true;
    AVDictionary *options = NULL;
    if (v->form->codec == AV_CODEC_ID_H264) av_dict_set(&options, "movflags", "+faststart", 0);
    code = avformat_write_header(v->container, &options);
    av_dict_free(&options);
    return code < 0 ? failed(c, SHERF_WRITE_FAILED, v, "cannot be written", code) : SHERF_OK;
}

static sherf_status open_scaler(context *c, sherf_video *v) {
    int w = v->codec->width, h = v->codec->height;
    if (v->codec->pix_fmt == AV_PIX_FMT_PAL8) return palette_create(c, &v->palette);
    v->scaler = sws_getContext(w, h, AV_PIX_FMT_RGBA, w, h, v->codec->pix_fmt,
                               SWS_BICUBIC | SWS_ACCURATE_RND | SWS_FULL_CHR_H_INP, NULL, NULL, NULL);
    if (!v->scaler) return failure(c, SHERF_NO_MEMORY, "out of memory");
    const int *bt709 = sws_getCoefficients(SWS_CS_ITU709);
    sws_setColorspaceDetails(v->scaler, bt709, 1, bt709, 0, 0, 1 << 16, 1 << 16);
    return SHERF_OK;
}

static sherf_status open_frame(context *c, sherf_video *v) {
    v->frame = av_frame_alloc();
    v->packet = av_packet_alloc();
    v->rgba = mem_alloc(c, (size_t)v->codec->width * (size_t)v->codec->height, 4);
    if (!v->rgba) return SHERF_NO_MEMORY;
    if (!v->frame || !v->packet) return failure(c, SHERF_NO_MEMORY, "out of memory");
    v->frame->format = v->codec->pix_fmt;
    v->frame->width = v->codec->width;
    v->frame->height = v->codec->height;
    v->frame->color_range = v->codec->color_range;
    v->frame->colorspace = v->codec->colorspace;
    if (av_frame_get_buffer(v->frame, 0) < 0) return failure(c, SHERF_NO_MEMORY, "out of memory");
    return open_scaler(c, v);
}

static sherf_status check_options(context *c, const char *path, const sherf_video_options *o,
                                  sherf_video *v) {
    if (o->width < 2 || o->height < 2 || o->width > VIDEO_SIDE_MAX || o->height > VIDEO_SIDE_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: a video of %d x %d pixels cannot be written", path,
                       o->width, o->height);
    if (!(o->fps >= 0.01 && o->fps <= 1000))
        return failure(c, SHERF_BAD_ARGUMENT, "%s: %g frames per second are not possible", path, o->fps);
    for (size_t i = 0; i < COUNT_OF(forms); i++)
        if (path_ends(path, forms[i].extension)) v->form = &forms[i];
    if (!v->form)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: videos are written as .mp4, .webm, .mov or .gif", path);
    if (o->alpha && !v->form->alpha)
        return failure(c, SHERF_UNSUPPORTED, "%s: %s has no transparency; .webm, .mov, .gif and .png have",
                       path, v->form->name);
    if (snprintf(v->final, sizeof v->final, "%s", path) >= (int)sizeof v->final ||
        snprintf(v->temporary, sizeof v->temporary, "%s.%ld.part", path, (long)getpid()) >=
            (int)sizeof v->temporary)
        return failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", path);
    v->width = o->width;
    v->height = o->height;
    v->channels = o->alpha ? 4 : 3;
    return SHERF_OK;
}

sherf_status sherf_video_create(sherf_context *c, const char *path, const sherf_video_options *options,
                                sherf_video **out) {
    *out = NULL;
    av_log_set_level(AV_LOG_QUIET); /* otherwise FFmpeg prints messages */
    sherf_video *v = mem_zero(c, 1, sizeof *v);
    if (!v) return SHERF_NO_MEMORY;
    sherf_status status = check_options(c, path, options, v);
    if (status == SHERF_OK) status = open_file(c, v, av_d2q(options->fps, 100000));
    if (status == SHERF_OK) status = open_frame(c, v);
    if (status != SHERF_OK)
        sherf_video_abort(v);
    else
        *out = v;
    return status;
}

sherf_status sherf_video_open(sherf_context *c, const char *path, int width, int height, double fps,
                              sherf_video **out) {
    const sherf_video_options o = {.width = width, .height = height, .fps = fps};
    return sherf_video_create(c, path, &o, out);
}

/* Sends a frame (NULL: the end) and writes the resulting packets. */
static sherf_status encode(context *c, sherf_video *v, const AVFrame *frame) {
    int code = avcodec_send_frame(v->codec, frame);
    if (code < 0) return failed(c, SHERF_WRITE_FAILED, v, "frame cannot be encoded", code);
    while ((code = avcodec_receive_packet(v->codec, v->packet)) >= 0) {
        av_packet_rescale_ts(v->packet, v->codec->time_base, v->stream->time_base);
        v->packet->stream_index = v->stream->index;
        code = av_interleaved_write_frame(v->container, v->packet);
        if (code < 0) return failed(c, SHERF_WRITE_FAILED, v, "cannot be written", code);
    }
    if (code == AVERROR(EAGAIN) || code == AVERROR_EOF) return SHERF_OK;
    return failed(c, SHERF_WRITE_FAILED, v, "frame cannot be encoded", code);
}

static void fill_rgba(sherf_video *v, const sherf_image *image) {
    int w = v->codec->width, h = v->codec->height, n = v->channels;
    for (int y = 0; y < h; y++) {
        int from = y < v->height ? y : v->height - 1;
        const float *row = image->data + (size_t)from * (size_t)v->width * (size_t)n;
        uint8_t *to = v->rgba + (size_t)y * (size_t)w * 4;
        for (int x = 0; x < v->width; x++)
            for (int k = 0; k < 4; k++) to[4 * x + k] = k < n ? float_to_u8(row[n * x + k]) : 255;
        if (w > v->width) memcpy(to + (size_t)v->width * 4, to + (size_t)(v->width - 1) * 4, 4);
    }
}

sherf_status sherf_video_add(sherf_context *c, sherf_video *v, const sherf_image *image) {
    if (!image->data || image->width != v->width || image->height != v->height ||
        image->channels != v->channels)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: a frame of %d x %d x %d in a video of %d x %d x %d",
                       v->final, image->width, image->height, image->channels, v->width, v->height,
                       v->channels);
    int code = av_frame_make_writable(v->frame);
    if (code < 0) return failure(c, SHERF_NO_MEMORY, "out of memory");
    fill_rgba(v, image);
    const uint8_t *plane[1] = {v->rgba};
    const int stride[1] = {v->codec->width * 4};
    if (v->palette)
        palette_apply(v->palette, v->rgba, v->codec->width, v->codec->height, v->channels == 4,
                      (uint32_t *)(void *)v->frame->data[1], v->frame->data[0], v->frame->linesize[0]);
    else
        sws_scale(v->scaler, plane, stride, 0, v->codec->height, v->frame->data, v->frame->linesize);
    v->frame->pts = v->count++;
    return encode(c, v, v->frame);
}

sherf_status sherf_video_close(sherf_context *c, sherf_video *v) {
    sherf_status status = v->count ? encode(c, v, NULL)
                                   : failure(c, SHERF_BAD_ARGUMENT, "%s: a video without frames", v->final);
    int code = status == SHERF_OK ? av_write_trailer(v->container) : 0;
    if (code < 0) status = failed(c, SHERF_WRITE_FAILED, v, "cannot be written", code);
    if (status == SHERF_OK) {
        code = avio_closep(&v->container->pb);
        if (code < 0) status = failed(c, SHERF_WRITE_FAILED, v, "cannot be written", code);
    }
    if (status == SHERF_OK && rename(v->temporary, v->final) != 0)
        status = failed(c, SHERF_WRITE_FAILED, v, "cannot be written", AVERROR(errno));
    if (status == SHERF_OK) v->created = false; /* nothing left to remove */
    sherf_video_abort(v);
    return status;
}

void sherf_video_abort(sherf_video *v) {
    if (!v) return;
    if (v->container) avio_closep(&v->container->pb);
    if (v->created) unlink(v->temporary);
    avcodec_free_context(&v->codec);
    avformat_free_context(v->container);
    av_frame_free(&v->frame);
    av_packet_free(&v->packet);
    sws_freeContext(v->scaler);
    palette_free(v->palette);
    mem_free(v->rgba);
    mem_free(v);
}
