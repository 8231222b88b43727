/* sink: the destination of frames: one picture, a folder of pictures, or a video; and the strip. */
#ifndef CLI_SINK_H
#define CLI_SINK_H

#include "session.h"

typedef struct {
    const char *output; /* a picture, a video or a folder, by sherf_output_kind */
    const char *kind;   /* "frame", "depth", "opacity": starts the names in a folder, ends file names */
    bool npy;           /* write .npy too */
    double fps;
    sherf_video *video;
} sink;

/* Whether output is a video or a single picture; otherwise it is a folder. */
bool sink_is_video(const char *output);
bool sink_is_picture(const char *output);
/* EXIT_USAGE, after one line, for an output of another kind, or one that lacks the requested transparency. */
int sink_output_check(const char *verb_name, const char *output, bool transparent);
/* picture: shown, 1, 3 or 4 channels; exact: for the .npy. */
int sink_add(session *s, sink *k, int n, const sherf_image *picture, const sherf_image *exact);
int sink_close(session *s, sink *k);
void sink_abort(sink *k);

/* The background behind the person. */
typedef struct {
    float rgb[3];
    bool transparent;
} background;
/* "black", "white", "transparent" or "r,g,b"; false after one line on stderr. */
bool background_parse(const char *verb_name, const char *text, background *out);

/* Frames side by side. */
typedef struct {
    const char *path; /* NULL: no strip */
    int max, frames;  /* at most `max` of the `frames`, evenly spread */
    sherf_image image;
} strip;
int strip_add(strip *t, int n, const sherf_image *picture);
int strip_close(session *s, strip *t); /* writes and frees */
void strip_abort(strip *t);

#endif
