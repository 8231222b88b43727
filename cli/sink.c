/* Frames to PNG, npy or a video: each file's name, the background's colour, the strip. */
#include "sink.h"

#include <stdlib.h>
#include <string.h>

enum { PATH_BYTES = 4096 };

bool sink_is_video(const char *output) {
    return sherf_output_kind(output) == SHERF_OUTPUT_VIDEO;
}
bool sink_is_picture(const char *output) {
    return sherf_output_kind(output) == SHERF_OUTPUT_PICTURE;
}

int sink_output_check(const char *verb_name, const char *output, bool transparent) {
    const char *end = strrchr(output, '.');
    if (sherf_output_kind(output) == SHERF_OUTPUT_UNKNOWN)
        return usage_error(
            verb_name,
            "--output %s: %s is not written here; .mp4, .webm, .mov and .gif are (a video), .png, .jpg and "
            ".webp (a picture), or a folder: %s/",
            output, end, output);
    if (transparent && !sherf_output_has_alpha(output))
        return usage_error(verb_name, "--background transparent: %s has no transparency; %s have",
                           end ? end : output, sink_is_video(output) ? ".webm and .mov" : ".png and .webp");
    return EXIT_DONE;
}

/* In a folder: FOLDER/depth_0007.png. Beside OUT.png and OUT.mp4: OUT_depth.png and OUT_depth.mp4. The arrays
 * of a video are one file per frame: OUT_depth_0007.npy. */
static int name(const sink *k, int n, const char *extension, char path[PATH_BYTES]) {
    int length;
    if (sink_is_video(k->output) || sink_is_picture(k->output)) {
        const bool main = strcmp(k->kind, "frame") == 0;
        const char *end = strrchr(k->output, '.');
        const int base = (int)(end - k->output);
        char number[16] = "";
        if (sink_is_video(k->output) && strcmp(extension, end) != 0)
            snprintf(number, sizeof number, "_%04d", n);
        length = snprintf(path, PATH_BYTES, "%.*s%s%s%s%s", base, k->output, main ? "" : "_",
                          main ? "" : k->kind, number, extension);
    } else {
        length = snprintf(path, PATH_BYTES, "%s/%s_%04d%s", k->output, k->kind, n, extension);
    }
    if (length >= PATH_BYTES) return session_failure("%.60s...: path too long", k->output);
    return EXIT_DONE;
}

/* A video needs colours: grey is tripled. */
static int video_add(session *s, sink *k, const sherf_image *picture) {
    if (picture->channels >= 3) return session_status(s, sherf_video_add(s->context, k->video, picture));
    size_t pixels = (size_t)picture->width * (size_t)picture->height;
    sherf_image rgb = {picture->width, picture->height, 3, malloc(pixels * 3 * sizeof(float))};
    if (!rgb.data) return session_failure("out of memory");
    for (size_t i = 0; i < 3 * pixels; i++) rgb.data[i] = picture->data[i / 3 * (size_t)picture->channels];
    int status = session_status(s, sherf_video_add(s->context, k->video, &rgb));
    free(rgb.data);
    return status;
}

int sink_add(session *s, sink *k, int n, const sherf_image *picture, const sherf_image *exact) {
    char path[PATH_BYTES];
    bool video = sink_is_video(k->output);
    const bool file = video || sink_is_picture(k->output);
    int status = name(k, n, file ? strrchr(k->output, '.') : ".png", path);
    if (status) return status;
    const sherf_video_options options = {picture->width, picture->height, k->fps, picture->channels == 4};
    if (video && !k->video)
        status = session_status(s, sherf_video_create(s->context, path, &options, &k->video));
    if (!status && video) status = video_add(s, k, picture);
    if (!status && !video) status = session_status(s, sherf_image_write(s->context, path, picture));
    if (!status && k->npy) {
        status = name(k, n, ".npy", path);
        if (!status) status = session_status(s, sherf_image_write(s->context, path, exact));
    }
    return status;
}

int sink_close(session *s, sink *k) {
    if (!k->video) return EXIT_DONE;
    sherf_video *video = k->video;
    k->video = NULL;
    return session_status(s, sherf_video_close(s->context, video));
}

void sink_abort(sink *k) {
    if (k->video) sherf_video_abort(k->video);
    k->video = NULL;
}

/* ---- background ---- */
static bool color_parse(const char *text, float rgb[3]) {
    int used = 0;
    if (sscanf(text, "%f,%f,%f%n", &rgb[0], &rgb[1], &rgb[2], &used) != 3 || text[used]) return false;
    for (int i = 0; i < 3; i++)
        if (!(rgb[i] >= 0 && rgb[i] <= 1)) return false;
    return true;
}

bool background_parse(const char *verb_name, const char *text, background *out) {
    *out = (background){0};
    if (strcmp(text, "black") == 0) return true;
    if (strcmp(text, "transparent") == 0) return out->transparent = true;
    if (color_parse(strcmp(text, "white") ? text : "1,1,1", out->rgb)) return true;
    usage_error(verb_name, "--background: '%s' is not black, white, transparent or r,g,b in 0 to 1", text);
    return false;
}

/* ---- strip ---- */
int strip_add(strip *t, int n, const sherf_image *picture) {
    if (!t->path) return EXIT_DONE;
    int kept = t->frames < t->max ? t->frames : t->max;
    /* Place p shows frame p * frames / kept. */
    int place = (int)(((int64_t)n * kept + t->frames - 1) / t->frames);
    if (place >= kept || (int)((int64_t)place * t->frames / kept) != n) return EXIT_DONE;
    sherf_image *i = &t->image;
    if (!i->data) {
        *i = (sherf_image){picture->width * kept, picture->height, picture->channels, NULL};
        i->data = calloc((size_t)i->width * (size_t)i->height, (size_t)i->channels * sizeof(float));
        if (!i->data) return session_failure("%s: out of memory", t->path);
    }
    if (picture->height != i->height || picture->width * kept != i->width)
        return session_failure("%s: frames of different sizes do not make a strip", t->path);
    size_t row = (size_t)picture->width * (size_t)picture->channels;
    for (int y = 0; y < i->height; y++)
        memcpy(i->data + ((size_t)y * (size_t)kept + (size_t)place) * row, picture->data + (size_t)y * row,
               row * sizeof(float));
    return EXIT_DONE;
}

int strip_close(session *s, strip *t) {
    int status = EXIT_DONE;
    if (t->image.data) status = session_status(s, sherf_image_write(s->context, t->path, &t->image));
    strip_abort(t);
    return status;
}

void strip_abort(strip *t) {
    free(t->image.data);
    t->image = (sherf_image){0};
}
