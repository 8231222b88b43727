/* Decoding: the allowed containers and decoders, a file's frames in order, the frame for each time, and its
 * conversion to an upright picture. */
#include "io/video_read.h"

#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/display.h>
#include <libavutil/pixdesc.h>
#include <libswscale/swscale.h>
#include <math.h>
#include <string.h>

#include "base/path.h"

/* Formats of cameras, phones and editors. Playlists etc., which open other files, are not among them. */
static const char containers[] =
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpeg,mpegts,ogg,flv,live_flv,asf,gif",
                  decoders[] = "h264,hevc,vp8,vp9,libdav1d,av1,mpeg4,h263,mpeg1video,mpeg2video,mjpeg,gif,"
                               "theora,msmpeg4v2,msmpeg4,wmv1,wmv2,wmv3,vc1,flv,prores,dvvideo,png,rawvideo";
enum { IO_BYTES = 1 << 15, BROKEN_MAX = 1000, FPS_WISH_MAX = 1000 };
static const double jump_s = 2, fps_assumed = 25;

struct video_reader {
    char name[PATH_LENGTH]; /* for messages */
    FILE *file;             /* or: */
    const unsigned char *data;
    int64_t bytes, at;
    AVIOContext *io;
    AVFormatContext *container;
    AVCodecContext *codec;
    AVStream *stream; /* owned by container */
    AVPacket *packet;
    AVFrame *shown, *ahead;
    bool has_shown, has_ahead, drained, ended;
    double ahead_s, shown_s, shift_s; /* times from the first frame on; the offset of the file's times */
    int64_t count;
    int broken;
    struct SwsContext *scaler;
    int turn_x[2], turn_y[2];    /* the display matrix: the output's x and y from the frame's, -1, 0 or 1 */
    int flat_width, flat_height; /* of the frame before rotation */
    uint8_t *flat;               /* scaled; the rows are padded */
    image_u8 picture;            /* rotated */
    video_read_info info;
};

static sherf_status failed(context *c, sherf_status status, const video_reader *v, const char *what,
                           int code) {
    char text[AV_ERROR_MAX_STRING_SIZE] = "";
    if (cancelled(c)) return failure(c, SHERF_CANCELLED, "%s: cancelled", v->name);
    if (code == AVERROR(ENOMEM)) return failure(c, SHERF_NO_MEMORY, "%s: out of memory", v->name);
    if (code < 0) av_strerror(code, text, sizeof text);
    return failure(c, status, "%s: %s%s%s", v->name, what, *text ? ": " : "", text);
}

/* ---- bytes ---- */

static int read_bytes(void *user, uint8_t *to, int wanted) {
    video_reader *v = user;
    size_t got;
    if (wanted <= 0) return AVERROR(EINVAL);
    if (v->file) {
        got = fread(to, 1, (size_t)wanted, v->file);
    } else {
        got = (size_t)(v->bytes - v->at < wanted ? v->bytes - v->at : wanted);
        memcpy(to, v->data + v->at, got);
        v->at += (int64_t)got;
    }
    return got ? (int)got : AVERROR_EOF;
}

static int64_t seek_bytes(void *user, int64_t offset, int whence) {
    video_reader *v = user;
    whence &= ~AVSEEK_FORCE;
    if (whence == AVSEEK_SIZE) return v->bytes;
    if (whence == SEEK_CUR) offset += v->file ? (int64_t)ftello(v->file) : v->at;
    if (whence == SEEK_END) offset += v->bytes;
    if (offset < 0 || offset > v->bytes) return AVERROR(EINVAL);
    if (v->file) return fseeko(v->file, (off_t)offset, SEEK_SET) == 0 ? offset : AVERROR(errno);
    return v->at = offset;
}

static int open_nothing(AVFormatContext *container, AVIOContext **io, const char *url, int flags,
                        AVDictionary **options) {
    return AVERROR(EPERM);
}

static int interrupted(void *user) {
    return cancelled(user);
}

/* ---- opening ---- */

static sherf_status open_container(context *c, video_reader *v) {
    uint8_t *buffer = av_malloc(IO_BYTES);
    v->io = buffer ? avio_alloc_context(buffer, IO_BYTES, 0, v, read_bytes, NULL, seek_bytes) : NULL;
    if (!v->io) av_free(buffer);
    v->container = v->io ? avformat_alloc_context() : NULL;
    if (!v->container) return failure(c, SHERF_NO_MEMORY, "out of memory");
    v->container->pb = v->io;
    v->container->flags |= AVFMT_FLAG_CUSTOM_IO;
    v->container->io_open = open_nothing;
    v->container->interrupt_callback = (AVIOInterruptCB){interrupted, c};
    v->container->format_whitelist = av_strdup(containers);
    v->container->codec_whitelist = av_strdup(decoders);
    v->container->max_streams = 64;
    int code = avformat_open_input(&v->container, NULL, NULL, NULL);
    if (code < 0)
        return failed(c, SHERF_BAD_FILE, v, "not a video, or not of a kind that is read here", code);
    snprintf(v->info.kind, sizeof v->info.kind, "%s", v->container->iformat->name);
    for (unsigned i = 0; i < v->container->nb_streams; i++)
        if (v->container->streams[i]->codecpar->codec_type != AVMEDIA_TYPE_VIDEO)
            v->container->streams[i]->discard = AVDISCARD_ALL;
    return SHERF_OK;
}

static sherf_status check_size(context *c, const video_reader *v, int width, int height, int pixels_max) {
    if (width < 1 || height < 1) return failed(c, SHERF_BAD_FILE, v, "its frames have no size", 0);
    if (width > VIDEO_READ_SIDE_MAX || height > VIDEO_READ_SIDE_MAX || (int64_t)width * height > pixels_max)
        return failure(c, SHERF_UNSUPPORTED, "%s: frames of %d x %d pixels are too large", v->name, width,
                       height);
    return SHERF_OK;
}

static sherf_status find_stream(context *c, video_reader *v, int pixels_max) {
    char max[16];
    const unsigned streams = v->container->nb_streams;
    snprintf(max, sizeof max, "%d", pixels_max);
    AVDictionary **options = streams ? av_calloc(streams, sizeof *options) : NULL;
    for (unsigned i = 0; i < streams && options; i++) av_dict_set(&options[i], "max_pixels", max, 0);
    avformat_find_stream_info(v->container, options); /* its findings are checked below */
    for (unsigned i = 0; i < streams && options; i++) av_dict_free(&options[i]);
    av_free(options);
    const int best = av_find_best_stream(v->container, AVMEDIA_TYPE_VIDEO, -1, -1, NULL, 0);
    if (best < 0 || v->container->streams[best]->disposition & AV_DISPOSITION_ATTACHED_PIC)
        return failed(c, SHERF_BAD_FILE, v, "there is no picture in this video", 0);
    v->stream = v->container->streams[best];
    for (unsigned i = 0; i < v->container->nb_streams; i++)
        if ((int)i != best) v->container->streams[i]->discard = AVDISCARD_ALL;
    snprintf(v->info.codec, sizeof v->info.codec, "%s", avcodec_get_name(v->stream->codecpar->codec_id));
    return check_size(c, v, v->stream->codecpar->width, v->stream->codecpar->height, pixels_max);
}

static bool listed(const char *list, const char *name) {
    const size_t length = strlen(name);
    for (const char *at = list; (at = strstr(at, name)); at += length)
        if ((at == list || at[-1] == ',') && (at[length] == ',' || !at[length])) return true;
    return false;
}

static sherf_status open_codec(context *c, video_reader *v, int pixels_max) {
    const AVCodec *codec = NULL, *one;
    void *place = NULL;
    while (!codec && (one = av_codec_iterate(&place)))
        if (av_codec_is_decoder(one) && one->id == v->stream->codecpar->codec_id &&
            listed(decoders, one->name))
            codec = one;
    if (!codec)
        return failure(c, SHERF_UNSUPPORTED, "%s: its pictures are coded as %s, which is not read here",
                       v->name, v->info.codec);
    AVCodecContext *x = v->codec = avcodec_alloc_context3(codec);
    if (!x) return failure(c, SHERF_NO_MEMORY, "out of memory");
    int code = avcodec_parameters_to_context(x, v->stream->codecpar);
    x->pkt_timebase = v->stream->time_base;
    x->max_pixels = pixels_max;
    x->thread_count = c->threads < 4 ? c->threads : 4; /* each holds frames */
    if (code >= 0) code = avcodec_open2(x, codec, NULL);
    return code < 0 ? failed(c, SHERF_UNSUPPORTED, v, "its pictures cannot be decoded here", code) : SHERF_OK;
}

/* The nearest of the eight rotations and mirrorings: output = A frame, A's entries -1, 0 or 1. */
static void read_turn(video_reader *v) {
    size_t bytes = 0;
    const int32_t *m =
        (const int32_t *)(const void *)av_stream_get_side_data(v->stream, AV_PKT_DATA_DISPLAYMATRIX, &bytes);
    v->turn_x[0] = v->turn_y[1] = 1;
    if (!m || bytes < 9 * sizeof *m) return;
    const double a = m[0], b = m[1], p = m[3], q = m[4]; /* x' = a x + p y, y' = b x + q y */
    if (!(fabs(a * q - b * p) > 0)) return;
    const bool across = fabs(b) + fabs(p) > fabs(a) + fabs(q);
    v->turn_x[0] = across ? 0 : a < 0 ? -1 : 1;
    v->turn_x[1] = !across ? 0 : p < 0 ? -1 : 1;
    v->turn_y[0] = !across ? 0 : b < 0 ? -1 : 1;
    v->turn_y[1] = across ? 0 : q < 0 ? -1 : 1;
}

static double rate_of(const AVStream *stream) {
    const AVRational list[] = {stream->avg_frame_rate, stream->r_frame_rate};
    for (size_t i = 0; i < COUNT_OF(list); i++) {
        const double fps = list[i].den > 0 && list[i].num > 0 ? av_q2d(list[i]) : 0;
        if (fps > 0)
            return fmax(1, fps > VIDEO_READ_FPS_MAX ? fps / ceil(fps / VIDEO_READ_FPS_MAX - 1e-3) : fps);
    }
    return fps_assumed;
}

static sherf_status open_picture(context *c, video_reader *v, const video_read_options *o) {
    const AVRational shape = av_guess_sample_aspect_ratio(v->container, v->stream, NULL);
    double wide = v->stream->codecpar->width, high = v->stream->codecpar->height, scale = 1;
    double aspect = shape.num > 0 && shape.den > 0 ? fmin(fmax(av_q2d(shape), 0.25), 4) : 1;
    wide = fmin(round(wide * aspect), VIDEO_READ_SIDE_MAX);
    if (o->side_px > 0) scale = fmin(1, o->side_px / fmax(wide, high));
    v->flat_width = (int)fmax(1, round(wide * scale));
    v->flat_height = (int)fmax(1, round(high * scale));
    read_turn(v);
    const bool across = v->turn_x[0] == 0;
    v->info.full_width = (int)(across ? high : wide);
    v->info.full_height = (int)(across ? wide : high);
    v->info.width = v->picture.width = across ? v->flat_height : v->flat_width;
    v->info.height = v->picture.height = across ? v->flat_width : v->flat_height;
    v->picture.channels = 3;
    v->info.fps = o->fps > 0 ? o->fps : rate_of(v->stream);
    if (v->container->duration > 0) v->info.seconds = (double)v->container->duration / AV_TIME_BASE;
    /* swscale writes whole vectors, slightly past a row */
    v->flat = mem_zero(c, (size_t)v->flat_height + 1, ((size_t)v->flat_width + 64) * 3);
    v->picture.data = mem_alloc(c, (size_t)v->flat_width * (size_t)v->flat_height, 3);
    v->packet = av_packet_alloc();
    v->shown = av_frame_alloc();
    v->ahead = av_frame_alloc();
    if (!v->flat || !v->picture.data) return SHERF_NO_MEMORY;
    if (!v->packet || !v->shown || !v->ahead) return failure(c, SHERF_NO_MEMORY, "out of memory");
    return SHERF_OK;
}

static sherf_status open_reader(context *c, video_reader *v, const video_read_options *o,
                                video_reader **out) {
    static const video_read_options none;
    if (!o) o = &none;
    const int pixels_max =
        o->pixels_max > 0 && o->pixels_max < VIDEO_READ_PIXELS_MAX ? o->pixels_max : VIDEO_READ_PIXELS_MAX;
    av_log_set_level(AV_LOG_QUIET); /* otherwise FFmpeg prints messages */
    sherf_status status = SHERF_OK;
    if (!(o->fps >= 0 && o->fps <= FPS_WISH_MAX) || o->side_px < 0)
        status = failure(c, SHERF_BAD_ARGUMENT, "%s: %g frames a second of %d pixels", v->name, o->fps,
                         o->side_px);
    if (status == SHERF_OK) status = open_container(c, v);
    if (status == SHERF_OK) status = find_stream(c, v, pixels_max);
    if (status == SHERF_OK) status = open_codec(c, v, pixels_max);
    if (status == SHERF_OK) status = open_picture(c, v, o);
    if (status == SHERF_OK)
        *out = v;
    else
        video_read_close(v);
    return status;
}

sherf_status video_read_open(context *c, const char *path, const video_read_options *options,
                             video_reader **out) {
    *out = NULL;
    if (path_is_folder(path)) return failure(c, SHERF_NO_FILE, "%s: a folder, not a video", path);
    video_reader *v = mem_zero(c, 1, sizeof *v);
    if (!v) return SHERF_NO_MEMORY;
    snprintf(v->name, sizeof v->name, "%s", path);
    v->file = fopen(path, "rb");
    if (!v->file || fseeko(v->file, 0, SEEK_END) || (v->bytes = (int64_t)ftello(v->file)) < 0 ||
        fseeko(v->file, 0, SEEK_SET)) {
        const int code = errno;
        video_read_close(v);
        return failure(c, SHERF_NO_FILE, "%s: cannot be opened: %s", path, strerror(code));
    }
    return open_reader(c, v, options, out);
}

sherf_status video_read_parse(context *c, const unsigned char *data, size_t bytes,
                              const video_read_options *options, video_reader **out) {
    *out = NULL;
    video_reader *v = mem_zero(c, 1, sizeof *v);
    if (!v) return SHERF_NO_MEMORY;
    snprintf(v->name, sizeof v->name, "video");
    v->data = data;
    v->bytes = (int64_t)bytes;
    return open_reader(c, v, options, out);
}

void video_read_close(video_reader *v) {
    if (!v) return;
    avcodec_free_context(&v->codec);
    avformat_close_input(&v->container);
    if (v->io) av_freep(&v->io->buffer);
    avio_context_free(&v->io);
    av_packet_free(&v->packet);
    av_frame_free(&v->shown);
    av_frame_free(&v->ahead);
    sws_freeContext(v->scaler);
    if (v->file) fclose(v->file);
    mem_free(v->flat);
    mem_free(v->picture.data);
    mem_free(v);
}

const video_read_info *video_read_information(const video_reader *v) {
    return &v->info;
}

/* ---- frames ---- */

/* Sends one more packet to the decoder, or at the end the flush signal. */
static sherf_status feed(context *c, video_reader *v) {
    int code = 0;
    if (v->drained) {
        v->ended = true;
        return SHERF_OK;
    }
    if (cancelled(c)) return failure(c, SHERF_CANCELLED, "%s: cancelled", v->name);
    code = av_read_frame(v->container, v->packet);
    if (code == AVERROR(ENOMEM) || code == AVERROR_EXIT) return failed(c, SHERF_BAD_FILE, v, "", code);
    v->drained = code < 0; /* also for a truncated file: the frames before are shown */
    if (v->drained)
        code = avcodec_send_packet(v->codec, NULL);
    else if (v->packet->stream_index == v->stream->index)
        code = avcodec_send_packet(v->codec, v->packet);
    av_packet_unref(v->packet);
    if (code == AVERROR(ENOMEM)) return failed(c, SHERF_NO_MEMORY, v, "", code);
    if (code < 0 && !v->drained && code != AVERROR(EAGAIN)) v->broken++;
    if (v->broken > BROKEN_MAX) v->drained = v->ended = true;
    return SHERF_OK;
}

/* A frame's time, counted from the first one; jumps are removed. */
static double time_of(video_reader *v, const AVFrame *frame) {
    const double step = 1 / v->info.fps, last = v->ahead_s;
    const bool first = !v->has_shown;
    double at = frame->best_effort_timestamp == AV_NOPTS_VALUE
                    ? NAN
                    : (double)frame->best_effort_timestamp * av_q2d(v->stream->time_base);
    if (!isfinite(at)) return first ? 0 : last + step;
    if (first) v->shift_s = -at;
    at += v->shift_s;
    if (!first && (at <= last || at > last + jump_s)) {
        v->shift_s += last + step - at;
        at = last + step;
    }
    return at;
}

/* Decodes the next frame that can be shown into `ahead`. */
static sherf_status look_ahead(context *c, video_reader *v) {
    v->has_ahead = false;
    while (!v->ended) {
        const int code = avcodec_receive_frame(v->codec, v->ahead);
        if (code >= 0) {
            const AVFrame *f = v->ahead;
            if (f->width > 0 && f->height > 0 && f->width <= VIDEO_READ_SIDE_MAX &&
                f->height <= VIDEO_READ_SIDE_MAX && f->data[0] && sws_isSupportedInput(f->format)) {
                v->ahead_s = time_of(v, f);
                v->has_ahead = true;
                return SHERF_OK;
            }
            if (++v->broken > BROKEN_MAX) v->ended = true;
            continue;
        }
        if (code == AVERROR(ENOMEM)) return failed(c, SHERF_NO_MEMORY, v, "", code);
        if (code != AVERROR(EAGAIN) && code != AVERROR_EOF && ++v->broken > BROKEN_MAX) v->ended = true;
        if (code == AVERROR_EOF && v->drained) v->ended = true;
        if (v->ended) break;
        const sherf_status status = feed(c, v);
        if (status != SHERF_OK) return status;
    }
    return SHERF_OK;
}

/* If the file does not say, large pictures are BT.709 and others BT.601. */
static int colours_of(const AVFrame *f) {
    switch (f->colorspace) {
    case AVCOL_SPC_BT709:
        return SWS_CS_ITU709;
    case AVCOL_SPC_BT2020_NCL:
    case AVCOL_SPC_BT2020_CL:
        return SWS_CS_BT2020;
    case AVCOL_SPC_UNSPECIFIED:
        return f->height >= 720 ? SWS_CS_ITU709 : SWS_CS_ITU601;
    default:
        return SWS_CS_ITU601;
    }
}

static void turn(video_reader *v) {
    const int w = v->picture.width, h = v->picture.height;
    const size_t stride = ((size_t)v->flat_width + 64) * 3;
    /* A is orthogonal: the frame's x is A's first column times the output's position, likewise y */
    for (int y = 0; y < h; y++) {
        uint8_t *to = v->picture.data + (size_t)y * (size_t)w * 3;
        for (int x = 0; x < w; x++) {
            int at[2] = {v->turn_x[0] * x + v->turn_y[0] * y, v->turn_x[1] * x + v->turn_y[1] * y};
            if (v->turn_x[0] + v->turn_y[0] < 0) at[0] += v->flat_width - 1;
            if (v->turn_x[1] + v->turn_y[1] < 0) at[1] += v->flat_height - 1;
            memcpy(to + 3 * x, v->flat + (size_t)at[1] * stride + 3 * (size_t)at[0], 3);
        }
    }
}

static sherf_status paint(context *c, video_reader *v) {
    const AVFrame *f = v->shown;
    uint8_t *plane[4] = {v->flat};
    const int stride[4] = {(v->flat_width + 64) * 3};
    const bool smaller = v->flat_width < f->width || v->flat_height < f->height;
    v->scaler = sws_getCachedContext(
        v->scaler, f->width, f->height, f->format, v->flat_width, v->flat_height, AV_PIX_FMT_RGB24,
        (smaller ? SWS_AREA : SWS_BILINEAR) | SWS_ACCURATE_RND | SWS_BITEXACT | SWS_FULL_CHR_H_INT, NULL,
        NULL, NULL);
    if (!v->scaler) return failure(c, SHERF_UNSUPPORTED, "%s: a frame cannot be brought to RGB", v->name);
    const AVPixFmtDescriptor *form = av_pix_fmt_desc_get(f->format);
    if (form && !(form->flags & AV_PIX_FMT_FLAG_RGB)) {
        const bool full = f->color_range == AVCOL_RANGE_JPEG || !strncmp(form->name, "yuvj", 4);
        const int *from = sws_getCoefficients(colours_of(f));
        sws_setColorspaceDetails(v->scaler, from, full, sws_getCoefficients(SWS_CS_DEFAULT), 1, 0, 1 << 16,
                                 1 << 16);
    }
    if (sws_scale(v->scaler, (const uint8_t *const *)f->data, f->linesize, 0, f->height, plane, stride) < 0)
        return failure(c, SHERF_BAD_FILE, "%s: a frame cannot be brought to RGB", v->name);
    turn(v);
    return SHERF_OK;
}

sherf_status video_read_next(context *c, video_reader *v, const image_u8 **frame, bool *repeated) {
    const double step = 1 / v->info.fps, at = (double)v->count * step;
    bool fresh = false;
    sherf_status status = SHERF_OK;
    *frame = NULL;
    if (!v->has_shown) status = look_ahead(c, v);
    while (status == SHERF_OK && v->has_ahead &&
           (!v->has_shown || v->ahead_s - at < fabs(at - v->shown_s) - 1e-9)) {
        AVFrame *empty = v->shown;
        av_frame_unref(empty);
        v->shown = v->ahead;
        v->ahead = empty;
        v->shown_s = v->ahead_s;
        v->has_shown = fresh = true;
        status = look_ahead(c, v);
    }
    if (status != SHERF_OK) return status;
    if (!v->has_shown) return failed(c, SHERF_BAD_FILE, v, "not a single frame of it can be decoded", 0);
    /* The end; the rest of a faster video is nearer to the frame before. */
    if (!v->has_ahead && v->count && (!fresh || v->shown_s < at - (0.5 - 1e-6) * step)) return SHERF_OK;
    if (fresh && (status = paint(c, v)) != SHERF_OK) return status;
    v->count++;
    if (repeated) *repeated = !fresh;
    *frame = &v->picture;
    return SHERF_OK;
}
