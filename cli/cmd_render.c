/* sherf render: renders frames of an avatar (shots.h) to pictures or a video (sink.h), with depth and opacity
 * on request. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "session.h"
#include "shared.h"
#include "shots.h"
#include "sink.h"
#include "verbs.h"

static struct {
    shots_request shots;
    const char *model, *body, *output, *strip, *background;
    int64_t strip_frames, samples;
    double fps;
    bool npy, depth, opacity, exact, no_detail, whole, spooled;
} set = {.shots = {.fov_deg = 30}, .strip_frames = 8, .fps = 25, .background = "black"};

static const option options[] = {
    SHARED_BODY_OF_AVATAR(&set.body),
    SHARED_WEIGHTS_OF_OBSERVATION('m', &set.model),
    {'o', "output", OPTION_FILE, &set.output, "OUT",
     "OUT.mp4, .webm, .mov or .gif for a video, OUT.png, .jpg or .webp for one picture, - for a PNG on "
     "standard "
     "output, otherwise a folder of pictures",
     .needed = true},
    {'n', "orbit", OPTION_INTEGER, &set.shots.orbit, "N", "N cameras round the body, from its front", 1,
     100000},
    {0, "azimuth", OPTION_REAL, &set.shots.azimuth_deg, "DEG", "where the orbit begins (0, the body's front)",
     -3600, 3600},
    {0, "elevation", OPTION_REAL, &set.shots.elevation_deg, "DEG", "of the orbit above the horizon (0)", -89,
     89},
    {0, "distance", OPTION_REAL, &set.shots.distance_m, "M",
     "of the orbit from the body (what shows all of it)", 0.01, 1e4},
    {0, "fov", OPTION_REAL, &set.shots.fov_deg, "DEG", "vertical field of view of the orbit (30)", 1, 150},
    {'c', "cameras", OPTION_FILE, &set.shots.cameras, "FILE",
     "cameras of a file or folder, as docs/observation.md says"},
    {'d', "data", OPTION_FILE, &set.shots.data, "SPEC", "take cameras, and --poses LIST, from this data set"},
    {'P', "people", OPTION_TEXT, &set.shots.people, "NAME", "person of the data set: name or list line"},
    {0, "views", OPTION_LIST, &set.shots.views, "LIST",
     "views of the data set: 0,2 or first:step:count (all)"},
    {'p', "poses", OPTION_FILE, &set.shots.poses, "FILE|LIST",
     "poses from a file (npz, npy, JSON), or with --data its poses 0,2 or first:step:count (the picture's "
     "pose)"},
    {0, "their-shape", OPTION_FLAG, &set.shots.their_shape, NULL,
     "take the body shape too from a file of poses; otherwise the person keeps their own"},
    {0, "every", OPTION_FLAG, &set.shots.every, NULL,
     "each pose from each camera; otherwise frame i takes pose i and camera i, starting over in the shorter "
     "list"},
    {'s', "size", OPTION_TEXT, &set.shots.size, "N|WxH",
     "size of the frames (512 in an orbit, else the camera's)"},
    {0, "background", OPTION_TEXT, &set.background, "COLOUR",
     "black, white, r,g,b in 0 to 1, or transparent (black)"},
    {0, "depth", OPTION_FLAG, &set.depth, NULL, "depth pictures too, near is bright; with --npy in metres"},
    {0, "opacity", OPTION_FLAG, &set.opacity, NULL, "opacity pictures too"},
    {0, "npy", OPTION_FLAG, &set.npy, NULL, "each frame also as H x W x channels float32 .npy"},
    {0, "strip", OPTION_FILE, &set.strip, "FILE", "frames side by side in one .png"},
    {0, "strip-frames", OPTION_INTEGER, &set.strip_frames, "N", "at most N of them, evenly spread (8)", 1,
     1000},
    {0, "fps", OPTION_REAL, &set.fps, "X", "frames a second of a video (25)", 0.1, 1000},
    SHARED_SAMPLES(&set.samples),
    SHARED_WHOLE(&set.whole),
    SHARED_NO_DETAIL(&set.no_detail),
    SHARED_EXACT(&set.exact),
    {0},
};

/* Checks options against each other. */
static int options_check(background *ground) {
    const shots_request *w = &set.shots;
    const char *verb_name = "render";
    int width, height;
    if (w->size && !size_parse(w->size, &width, &height))
        return usage_error(verb_name, "--size: '%s' is not a size like 512 or 640x360", w->size);
    if (!background_parse(verb_name, set.background, ground)) return EXIT_USAGE;
    if (sink_output_check(verb_name, set.output, ground->transparent)) return EXIT_USAGE;
    if (!strcmp(set.output, "-") && (common.json || set.depth || set.opacity || set.npy))
        return usage_error(verb_name, "--output -: one picture and nothing else goes to standard output");
    if ((w->orbit != 0) + (w->cameras != NULL) + (w->views != NULL) > 1)
        return usage_error(verb_name, "--orbit, --cameras and --views exclude each other");
    if (w->data && !w->people) return usage_error(verb_name, "--data needs --people, one person");
    if (!w->data && (w->people || w->views))
        return usage_error(verb_name, "--people and --views need --data");
    if (!w->data && w->poses && list_valid(w->poses))
        return usage_error(verb_name, "--poses: the list '%s' needs --data", w->poses);
    return EXIT_DONE;
}

/* ---- pictures made of a frame ---- */
typedef struct {
    sherf_image rgba, depth; /* of a frame, in addition to its own; depth's data is freed with free */
} pictures;

static int room(sherf_image *image, const sherf_image *like, int channels) {
    if (image->data && image->width == like->width && image->height == like->height) return EXIT_DONE;
    free(image->data);
    *image = (sherf_image){like->width, like->height, channels, NULL};
    image->data = calloc((size_t)like->width * (size_t)like->height, (size_t)channels * sizeof(float));
    return image->data ? EXIT_DONE : session_failure("out of memory");
}

/* Near 1, far 0.2, empty 0; the ends are the posed body's. */
static int picture_depth(const sherf_frame *f, const float range_m[2], sherf_image *out) {
    int status = room(out, &f->depth, 1);
    size_t pixels = (size_t)f->depth.width * (size_t)f->depth.height;
    float scale = range_m[1] > range_m[0] ? 0.8f / (range_m[1] - range_m[0]) : 0;
    for (size_t i = 0; i < pixels && !status; i++) {
        float d = f->depth.data[i];
        bool hit = isfinite(d) && f->opacity.data[i] > 0.5f;
        out->data[i] = hit ? fminf(fmaxf(1 - (d - range_m[0]) * scale, 0.2f), 1) : 0;
    }
    return status;
}

/* ---- the frames ---- */
typedef struct {
    sink color, depth, opacity;
    strip strip;
    pictures pictures;
    sherf_frame frame;
    double *frame_ms;
    int64_t points; /* of all frames */
} studio;

static int frame_write(session *s, studio *t, const shots *all, const sherf_body *body, int n,
                       bool transparent) {
    const sherf_frame *f = &t->frame;
    const sherf_image *picture = &f->color;
    int status = EXIT_DONE;
    if (transparent) {
        status = session_status(s, sherf_frame_rgba(s->context, f, &t->pictures.rgba));
        picture = &t->pictures.rgba;
    }
    if (!status) status = sink_add(s, &t->color, n, picture, picture);
    if (!status) status = strip_add(&t->strip, n, picture);
    if (!status && set.opacity) status = sink_add(s, &t->opacity, n, &f->opacity, &f->opacity);
    if (!status && set.depth) {
        float range_m[2];
        status = shots_depth_range(s, all, body, n, range_m);
        if (!status) status = picture_depth(f, range_m, &t->pictures.depth);
        if (!status) status = sink_add(s, &t->depth, n, &t->pictures.depth, &f->depth);
    }
    return status;
}

static int frames_take(session *s, studio *t, const shots *all, const sherf_avatar *avatar,
                       const sherf_body *body, const background *ground) {
    sherf_render_options o = {.samples = (int)set.samples,
                              .exact = set.exact,
                              .detail = set.no_detail ? SHERF_DETAIL_OFF : SHERF_DETAIL_ON};
    memcpy(o.background, ground->rgb, sizeof o.background);
    int status = EXIT_DONE;
    for (int n = 0; n < all->count && !status; n++) {
        const sherf_camera *k = shots_camera(all, n);
        if (t->frame.color.data &&
            (k->width_px != t->frame.color.width || k->height_px != t->frame.color.height))
            sherf_frame_free(&t->frame);
        double begun_s = seconds_now();
        status =
            session_status(s, sherf_render(s->context, avatar, body, shots_pose(all, n), k, &o, &t->frame));
        t->frame_ms[n] = 1e3 * (seconds_now() - begun_s);
        t->points += t->frame.points;
        if (!status) status = frame_write(s, t, all, body, n, ground->transparent);
        session_progress("frames", n + 1, all->count);
    }
    sink *sinks[] = {&t->color, &t->depth, &t->opacity};
    for (int i = 0; i < 3; i++) {
        if (!status) status = sink_close(s, sinks[i]);
        sink_abort(sinks[i]);
    }
    if (!status) status = strip_close(s, &t->strip);
    strip_abort(&t->strip);
    return status;
}

static int ascending(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static void report(session *s, studio *t, int frames) {
    qsort(t->frame_ms, (size_t)frames, sizeof *t->frame_ms, ascending);
    double median_ms = t->frame_ms[frames / 2];
    if (!common.json) {
        session_remark("%s: %d frame%s, %.0f ms each", set.spooled ? "standard output" : set.output, frames,
                       frames == 1 ? "" : "s", median_ms);
        return;
    }
    cJSON *json = cJSON_CreateObject();
    cJSON_AddStringToObject(json, "output", set.output);
    cJSON_AddNumberToObject(json, "frames", frames);
    cJSON_AddNumberToObject(json, "frame_ms", median_ms);
    cJSON_AddNumberToObject(json, "points", (double)t->points / frames);
    cJSON_AddStringToObject(json, "precision", session_precision(s));
    session_json(json);
}

static int frames_make(session *s, const sherf_avatar *avatar, const sherf_body *body,
                       const background *ground) {
    shots all;
    studio t = {0};
    int status = shots_create(s, &set.shots, body, avatar, &all);
    if (!status && sink_is_picture(set.output) && all.count > 1)
        status = usage_error(s->verb_name,
                             "--output: %d frames do not go into one picture; give a folder, "
                             "a video, or --strip",
                             all.count);
    if (!status && !sink_is_picture(set.output) && !sink_is_video(set.output))
        status = session_folder(set.output);
    if (!status && !(t.frame_ms = calloc((size_t)all.count, sizeof *t.frame_ms)))
        status = session_failure("out of memory");
    if (!status) {
        t.color = (sink){set.output, "frame", set.npy, set.fps, NULL};
        t.depth = (sink){set.output, "depth", set.npy, set.fps, NULL};
        t.opacity = (sink){set.output, "opacity", set.npy, set.fps, NULL};
        t.strip = (strip){set.strip, (int)set.strip_frames, all.count, {0}};
        status = frames_take(s, &t, &all, avatar, body, ground);
    }
    if (!status) report(s, &t, all.count);
    sherf_frame_free(&t.frame);
    sherf_image_free(&t.pictures.rgba);
    free(t.pictures.depth.data);
    free(t.frame_ms);
    shots_free(&all);
    return status;
}

/* A picture for standard output is written to a file first, so that it arrives completely or not at all. */
static int spool_open(char path[64]) {
    const char *folder = getenv("TMPDIR");
    snprintf(path, 64, "%s/sherf-XXXXXX.png", folder && strlen(folder) < 40 ? folder : "/tmp");
    const int file = mkstemps(path, 4);
    if (file < 0) return session_failure("%s: cannot be made", path);
    close(file);
    return EXIT_DONE;
}

static int spool_close(const char *path, int status) {
    char data[1 << 14];
    size_t bytes;
    FILE *f = status ? NULL : fopen(path, "rb");
    if (!status && !f) status = session_failure("%s: cannot be opened", path);
    while (f && !status && (bytes = fread(data, 1, sizeof data, f)))
        if (fwrite(data, 1, bytes, stdout) != bytes)
            status = session_failure("standard output cannot be written");
    if (f) fclose(f);
    if (!status && fflush(stdout)) status = session_failure("standard output cannot be written");
    unlink(path);
    return status;
}

static int frames_to_stdout(session *s, const sherf_avatar *avatar, const sherf_body *body,
                            const background *ground) {
    static char path[64]; /* set.output outlives this */
    int status = spool_open(path);
    if (status) return status;
    set.output = path;
    set.spooled = true;
    return spool_close(path, frames_make(s, avatar, body, ground));
}

static int run(session *s, int count, char **argument) {
    background ground;
    sherf_body *body = NULL;
    sherf_avatar *avatar = NULL;
    int status = options_check(&ground);
    if (!status) status = session_person(s, argument[0], set.body, set.model, set.whole, &body, &avatar);
    if (!status)
        status = strcmp(set.output, "-") ? frames_make(s, avatar, body, &ground)
                                         : frames_to_stdout(s, avatar, body, &ground);
    sherf_avatar_free(avatar);
    sherf_body_free(body);
    return status;
}

const verb verb_render = {
    .name = "render",
    .arguments = "INPUT",
    .summary = "render an avatar: pictures or a video",
    .description = "Renders an avatar file or an observation from cameras round it (--orbit), "
                   "from listed "
                   "ones (--cameras), from those of a data set (--data), or from the picture's own, in the "
                   "picture's pose "
                   "or others (--poses).",
    .example =
        "sherf render ann.safetensors --body body.safetensors --orbit 60 -o turn.mp4 --strip turn.png\n"
        "sherf render ann.safetensors -b body.safetensors --poses walk.npz --orbit 1 -o walk.mp4\n"
        "sherf render ann/ -m model.safetensors -b body.safetensors --background transparent -o ann.png",
    .options = options,
    .arguments_min = 1,
    .arguments_max = 1,
    .computes = true,
    .to_stdout = true,
    .many_kinds = true,
    .run = run,
};
