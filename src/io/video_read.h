/* video_read: the frames of a video, decoded by FFmpeg's libraries: MP4 and MOV, WebM and Matroska, AVI,
 * MPEG, Ogg, FLV, WMV and GIF, recognised by content. Frames are upright as the file's display matrix says,
 * with square pixels, at a constant rate, one at a time.
 *
 * Files are hostile: no other file or address in one is opened, rare decoders are left out, sides and pixels
 * are bounded, and so is a video's memory (about 20 frames of its own size, 2 of the wanted size). */
#ifndef SHERF_VIDEO_READ_H
#define SHERF_VIDEO_READ_H

#include "io/image.h"

enum { VIDEO_READ_SIDE_MAX = 8192, VIDEO_READ_PIXELS_MAX = 8192 * 4352, VIDEO_READ_FPS_MAX = 60 };

typedef struct {
    int side_px; /* the longer side is reduced to this; 0: as in the file */
    double fps;  /* frames per second to return, up to 1000; 0: the video's average, divided by an integer if
                    it exceeds VIDEO_READ_FPS_MAX */
    int pixels_max; /* of a frame; 0: VIDEO_READ_PIXELS_MAX */
} video_read_options;

typedef struct {
    int width, height;           /* of the returned frames */
    int full_width, full_height; /* upright, with square pixels, before reduction */
    double fps;                  /* of the returned frames */
    double seconds;              /* according to the file; 0: it does not say */
    char kind[64], codec[32];    /* FFmpeg's names of container and codec */
} video_read_info;

typedef struct video_reader video_reader;
/* options may be NULL. */
sherf_status video_read_open(context *c, const char *path, const video_read_options *options,
                             video_reader **out);
/* From memory, which must outlive the reader. */
sherf_status video_read_parse(context *c, const unsigned char *data, size_t bytes,
                              const video_read_options *options, video_reader **out);
const video_read_info *video_read_information(const video_reader *v);
/* The next frame, RGB, owned by the reader until the next call; NULL after the last one. Frame i shows the
 * time i / fps: it is the video's frame nearest to it. *repeated (may be NULL): the same picture as before.
 * If time stamps jump (back, or by more than two seconds) the gap is removed. Broken frames are skipped; a
 * video without any good frame is SHERF_BAD_FILE. */
sherf_status video_read_next(context *c, video_reader *v, const image_u8 **frame, bool *repeated);
void video_read_close(video_reader *v); /* NULL is fine */
#endif
