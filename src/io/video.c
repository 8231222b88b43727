/* video: frames to H.264 in MP4 through FFmpeg's libraries. The file appears under its name when it is whole.
 * Colours are BT.709, limited range, and say so; sizes are made even by doubling the last row and column. */
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

enum { VIDEO_SIDE_MAX = 8192 };

struct sherf_video {
    char final[PATH_LENGTH], temporary[PATH_LENGTH];
    int width, height; /* as given */
    AVFormatContext *container;
    AVCodecContext *codec;
    AVStream *stream; /* owned by container */
    AVFrame *frame;
    AVPacket *packet;
    struct SwsContext *scaler;
    uint8_t *rgb; /* even size */
    int64_t count;
    bool created; /* the temporary file is there */
};

static sherf_status failed(context *c, sherf_status status, const sherf_video *v, const char *what,
                           int code) {
    char text[AV_ERROR_MAX_STRING_SIZE] = "";
    if (code < 0) av_strerror(code, text, sizeof text);
    return failure(c, status, "%s: %s%s%s", v->final, what, *text ? ": " : "", text);
}

/* libx264 at good quality, or whatever else makes H.264 from 4:2:0 here. */
static sherf_status open_codec(context *c, sherf_video *v, AVRational rate) {
    const AVCodec *codec = avcodec_find_encoder_by_name("libx264");
    if (!codec) codec = avcodec_find_encoder(AV_CODEC_ID_H264);
    if (!codec) return failed(c, SHERF_UNSUPPORTED, v, "FFmpeg has no H.264 encoder here", 0);
    AVCodecContext *x = v->codec = avcodec_alloc_context3(codec);
    if (!x) return failure(c, SHERF_NO_MEMORY, "out of memory");
    x->width = (v->width + 1) & ~1;
    x->height = (v->height + 1) & ~1;
    x->pix_fmt = AV_PIX_FMT_YUV420P;
    x->framerate = rate;
    x->time_base = av_inv_q(rate);
    x->gop_size = 48;
    x->thread_count = c->threads;
    x->color_range = AVCOL_RANGE_MPEG;
    x->colorspace = AVCOL_SPC_BT709;
    x->color_primaries = AVCOL_PRI_BT709;
    x->color_trc = AVCOL_TRC_BT709;
    if (v->container->oformat->flags & AVFMT_GLOBALHEADER) x->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
    if (!strcmp(codec->name, "libx264")) {
        av_opt_set(x->priv_data, "preset", "medium", 0);
        av_opt_set(x->priv_data, "crf", "18", 0);
    } else
        x->bit_rate = (int64_t)x->width * x->height * 8;
    int code = avcodec_open2(x, codec, NULL);
    return code < 0 ? failed(c, SHERF_UNSUPPORTED, v, "the H.264 encoder cannot be opened", code) : SHERF_OK;
}

static sherf_status open_file(context *c, sherf_video *v, AVRational rate) {
    int code = avformat_alloc_output_context2(&v->container, NULL, "mp4", v->temporary);
    if (code < 0) return failed(c, SHERF_UNSUPPORTED, v, "FFmpeg cannot write MP4 here", code);
    sherf_status status = open_codec(c, v, rate);
    if (status != SHERF_OK) return status;
    v->stream = avformat_new_stream(v->container, NULL);
    if (!v->stream) return failure(c, SHERF_NO_MEMORY, "out of memory");
    v->stream->time_base = v->codec->time_base;
    v->stream->avg_frame_rate = rate;
    code = avcodec_parameters_from_context(v->stream->codecpar, v->codec);
    if (code < 0) return failed(c, SHERF_NO_MEMORY, v, "the stream cannot be described", code);
    code = avio_open(&v->container->pb, v->temporary, AVIO_FLAG_WRITE);
    if (code < 0) return failed(c, SHERF_WRITE_FAILED, v, "cannot be written", code);
    v->created = true;
    AVDictionary *options = NULL;
    av_dict_set(&options, "movflags", "+faststart", 0);
    code = avformat_write_header(v->container, &options);
    av_dict_free(&options);
    return code < 0 ? failed(c, SHERF_WRITE_FAILED, v, "cannot be written", code) : SHERF_OK;
}

static sherf_status open_frame(context *c, sherf_video *v) {
    int w = v->codec->width, h = v->codec->height;
    v->frame = av_frame_alloc();
    v->packet = av_packet_alloc();
    v->rgb = mem_alloc(c, (size_t)w * (size_t)h, 3);
    if (!v->rgb) return SHERF_NO_MEMORY;
    if (!v->frame || !v->packet) return failure(c, SHERF_NO_MEMORY, "out of memory");
    v->frame->format = AV_PIX_FMT_YUV420P;
    v->frame->width = w;
    v->frame->height = h;
    v->frame->color_range = AVCOL_RANGE_MPEG;
    v->frame->colorspace = AVCOL_SPC_BT709;
    if (av_frame_get_buffer(v->frame, 0) < 0) return failure(c, SHERF_NO_MEMORY, "out of memory");
    v->scaler = sws_getContext(w, h, AV_PIX_FMT_RGB24, w, h, AV_PIX_FMT_YUV420P,
                               SWS_BICUBIC | SWS_ACCURATE_RND | SWS_FULL_CHR_H_INP, NULL, NULL, NULL);
    if (!v->scaler) return failure(c, SHERF_NO_MEMORY, "out of memory");
    const int *bt709 = sws_getCoefficients(SWS_CS_ITU709);
    sws_setColorspaceDetails(v->scaler, bt709, 1, bt709, 0, 0, 1 << 16, 1 << 16);
    return SHERF_OK;
}

sherf_status sherf_video_open(sherf_context *c, const char *path, int width, int height, double fps,
                              sherf_video **out) {
    *out = NULL;
    if (width < 2 || height < 2 || width > VIDEO_SIDE_MAX || height > VIDEO_SIDE_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: a video of %d x %d pixels cannot be written", path, width,
                       height);
    if (!(fps >= 0.01 && fps <= 1000))
        return failure(c, SHERF_BAD_ARGUMENT, "%s: %g frames per second are not possible", path, fps);
    if (!path_ends(path, ".mp4"))
        return failure(c, SHERF_BAD_ARGUMENT, "%s: videos are written as .mp4", path);
    av_log_set_level(AV_LOG_QUIET); /* FFmpeg prints by itself otherwise */
    sherf_video *v = mem_zero(c, 1, sizeof *v);
    if (!v) return SHERF_NO_MEMORY;
    v->width = width;
    v->height = height;
    sherf_status status = SHERF_OK;
    if (snprintf(v->final, sizeof v->final, "%s", path) >= (int)sizeof v->final ||
        snprintf(v->temporary, sizeof v->temporary, "%s.%ld.part", path, (long)getpid()) >=
            (int)sizeof v->temporary)
        status = failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", path);
    if (status == SHERF_OK) status = open_file(c, v, av_d2q(fps, 100000));
    if (status == SHERF_OK) status = open_frame(c, v);
    if (status != SHERF_OK)
        sherf_video_abort(v);
    else
        *out = v;
    return status;
}

/* Sends a frame (NULL: the end) and writes what comes out. */
static sherf_status encode(context *c, sherf_video *v, const AVFrame *frame) {
    int code = avcodec_send_frame(v->codec, frame);
    if (code < 0) return failed(c, SHERF_WRITE_FAILED, v, "a frame cannot be encoded", code);
    while ((code = avcodec_receive_packet(v->codec, v->packet)) >= 0) {
        av_packet_rescale_ts(v->packet, v->codec->time_base, v->stream->time_base);
        v->packet->stream_index = v->stream->index;
        code = av_interleaved_write_frame(v->container, v->packet);
        if (code < 0) return failed(c, SHERF_WRITE_FAILED, v, "cannot be written", code);
    }
    if (code == AVERROR(EAGAIN) || code == AVERROR_EOF) return SHERF_OK;
    return failed(c, SHERF_WRITE_FAILED, v, "a frame cannot be encoded", code);
}

static void fill_rgb(sherf_video *v, const sherf_image *image) {
    int w = v->codec->width, h = v->codec->height;
    for (int y = 0; y < h; y++) {
        const float *row = image->data + (size_t)(y < v->height ? y : v->height - 1) * (size_t)v->width * 3;
        uint8_t *to = v->rgb + (size_t)y * (size_t)w * 3;
        for (int i = 0; i < v->width * 3; i++) to[i] = float_to_u8(row[i]);
        if (w > v->width) memcpy(to + (size_t)v->width * 3, to + (size_t)(v->width - 1) * 3, 3);
    }
}

sherf_status sherf_video_add(sherf_context *c, sherf_video *v, const sherf_image *image) {
    if (!image->data || image->width != v->width || image->height != v->height || image->channels != 3)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: a frame of %d x %d x %d in a video of %d x %d x 3",
                       v->final, image->width, image->height, image->channels, v->width, v->height);
    int code = av_frame_make_writable(v->frame);
    if (code < 0) return failure(c, SHERF_NO_MEMORY, "out of memory");
    fill_rgb(v, image);
    const uint8_t *plane[1] = {v->rgb};
    const int stride[1] = {v->codec->width * 3};
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
    mem_free(v->rgb);
    mem_free(v);
}
