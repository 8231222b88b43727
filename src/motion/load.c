/* Loads a motion from a file: recognises the format and applies the options. */
#include <ctype.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/path.h"
#include "io/scene_clip.h"
#include "io/utf16.h"
#include "motion/source.h"

static const char *const up_name[] = {"", "y up", "z up", "y down"};

/* ---- the world ---- */

/* The format's usual up, unless the body's own up is far from it on average and near to another one. */
static sherf_up up_find(const source *s) {
    static const double axis[][3] = {
        [SHERF_UP_Y] = {0, 1, 0}, [SHERF_UP_Z] = {0, 0, 1}, [SHERF_UP_MINUS_Y] = {0, -1, 0}};
    double mean[3], along[4], best = 0.7;
    sherf_up up = s->up;
    clip_mean_up(&s->clip, mean);
    for (int u = SHERF_UP_Y; u <= SHERF_UP_MINUS_Y; u++)
        along[u] = mean[0] * axis[u][0] + mean[1] * axis[u][1] + mean[2] * axis[u][2];
    if (along[s->up] >= 0.35) return s->up;
    for (int u = SHERF_UP_Y; u <= SHERF_UP_MINUS_Y; u++)
        if (along[u] > best) best = along[u], up = (sherf_up)u;
    return up;
}

static int by_size(const void *a, const void *b) {
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

/* A pelvis is about a metre above the ground. If it is tens or hundreds of units high, the unit is
 * centimetres or millimetres. */
static sherf_status unit_find(context *c, const source *s, sherf_up up, double *unit_m) {
    float *height = mem_alloc(c, (size_t)s->clip.frames, sizeof *height);
    if (!height) return SHERF_NO_MEMORY;
    for (int i = 0; i < s->clip.frames; i++) height[i] = fabsf(s->clip.pelvis_m[i][up == SHERF_UP_Z ? 2 : 1]);
    qsort(height, (size_t)s->clip.frames, sizeof *height, by_size);
    float median = height[s->clip.frames / 2];
    *unit_m = median < 30 ? 1 : median < 300 ? 0.01 : 0.001;
    mem_free(height);
    return SHERF_OK;
}

static sherf_status place_pelvis(context *c, source *s, const sherf_motion_options *o, sherf_up up,
                                 double *unit_m) {
    *unit_m = o->scale > 0 ? o->scale : s->unit_m;
    sherf_status status = *unit_m > 0 ? SHERF_OK : unit_find(c, s, up, unit_m);
    for (int i = 0; i < s->clip.frames && !status; i++)
        for (int a = 0; a < 3; a++) {
            double place = *unit_m * s->clip.pelvis_m[i][a] + (s->is_pelvis ? 0 : s->pelvis_m[a]);
            if (!(fabs(place) < 1e5))
                return failure(c, SHERF_BAD_FILE, "frame %d is %g m away", i, fabs(place));
            s->clip.pelvis_m[i][a] = (float)place;
        }
    return status;
}

/* ---- options ---- */

static bool in_range(double x, double low, double high) {
    return x >= low && x <= high;
}

static sherf_status motion_options_check(context *c, const sherf_motion_options *o) {
    const char *wrong = NULL;
    if (o->up < SHERF_UP_AUTO || o->up > SHERF_UP_MINUS_Y) wrong = "up";
    if (o->rotations < SHERF_ROTATIONS_AUTO || o->rotations > SHERF_ROTATIONS_6D_COLUMNS) wrong = "rotations";
    if (o->root < SHERF_ROOT_KEPT || o->root > SHERF_ROOT_GROUNDED) wrong = "root";
    if (o->scale != 0 && !in_range(o->scale, 1e-6, 1e6)) wrong = "scale";
    if (o->source_fps != 0 && !in_range(o->source_fps, 0.01, 10000)) wrong = "source_fps";
    if (o->fps != 0 && !in_range(o->fps, 0.01, 10000)) wrong = "fps";
    if (o->fps_max != 0 && !in_range(o->fps_max, 0.01, 10000)) wrong = "fps_max";
    if (!in_range(o->smooth_s, 0, 60)) wrong = "smooth_s";
    if (!in_range(o->blend_s, 0, 600)) wrong = "blend_s";
    if (o->first < 0 || o->last < 0 || (o->last && o->last < o->first)) wrong = "first and last";
    if (wrong) return failure(c, SHERF_BAD_ARGUMENT, "motion: %s out of range", wrong);
    for (int b = 0; b < BODY_SHAPES && o->shapes; b++)
        if (!isfinite(o->shapes[b])) return failure(c, SHERF_BAD_ARGUMENT, "motion: shapes are not finite");
    for (int i = 0; i < 72 && o->start; i++)
        if (!isfinite(o->start->poses_rad[i]) || !isfinite(o->start->Th_m[i % 3]))
            return failure(c, SHERF_BAD_ARGUMENT, "motion: the start pose is not finite");
    if (o->start && !rotation_is_valid(o->start->R))
        return failure(c, SHERF_BAD_ARGUMENT, "motion: R of the start pose is not a rotation");
    return SHERF_OK;
}

/* Crops, smooths, resamples and loops the clip. */
static sherf_status apply_time(context *c, clip *k, const sherf_motion_options *o) {
    int last = o->last && o->last < k->frames ? o->last : k->frames - 1;
    if (o->first > last)
        return failure(c, SHERF_BAD_ARGUMENT, "frame %d cannot be the first of %d, counted from 0", o->first,
                       k->frames);
    sherf_status status = clip_crop(c, k, o->first, last - o->first + 1);
    if (!status) status = clip_smooth(c, k, o->smooth_s);
    double fps = o->fps > 0 ? o->fps : k->fps;
    if (!(o->fps > 0) && o->fps_max > 0) fps /= ceil(k->fps / o->fps_max - 1e-6);
    if (!status) status = clip_resample(c, k, fps);
    if (!status && o->loop && k->frames < 3)
        status = failure(c, SHERF_BAD_ARGUMENT, "%d frames make no loop", k->frames);
    if (!status && o->loop) clip_loop(k);
    return status;
}

static sherf_status apply_place(context *c, sherf_motion *motion, const sherf_motion_options *o) {
    clip_root(&motion->clip, &motion->skeleton, o->root);
    if (!o->start) return SHERF_OK;
    float turn[BODY_JOINTS][4], pelvis_m[3];
    clip_start_at(&motion->clip, &motion->skeleton, o->start);
    pose_to_turns(o->start, &motion->skeleton, turn, pelvis_m);
    motion->blend_frames = (int)lround(fmin(o->blend_s * motion->clip.fps, 2 * MOTION_FRAMES_MAX));
    return clip_lead_in(c, &motion->clip, motion->blend_frames, (const float(*)[4])turn, pelvis_m);
}

/* Knees bend one way, about +x. If nearly all of them bend the other way, matrices are transposed, or angles
 * have the wrong sign. */
static bool knees_forward(const clip *k) {
    enum { LEFT_KNEE = 4, RIGHT_KNEE = 5 };
    double sum = 0;
    int backward = 0;
    for (int i = 0; i < k->frames; i++)
        for (int j = LEFT_KNEE; j <= RIGHT_KNEE; j++) {
            float turn[3];
            quaternion_to_axis_angle(k->turn[i][j], turn);
            sum += turn[0];
            backward += turn[0] > 0.1f;
        }
    return sum < -0.2 * 2 * k->frames && backward * 20 < 2 * k->frames;
}

/* Whether the body's own up, over the frames, is far from the file's. */
static bool lies(const clip *k, sherf_up up) {
    double mean[3];
    clip_mean_up(k, mean);
    return (up == SHERF_UP_Z ? mean[2] : up == SHERF_UP_Y ? mean[1] : -mean[1]) < 0.35;
}

static void describe(const source *s, int frames, sherf_up up, double unit_m, char *out, size_t size) {
    char unit[48] = "metres";
    if (unit_m == 0.01) snprintf(unit, sizeof unit, "centimetres");
    if (unit_m == 0.001) snprintf(unit, sizeof unit, "millimetres");
    if (unit_m != 1 && unit_m != 0.01 && unit_m != 0.001)
        snprintf(unit, sizeof unit, "%.4g m a unit", unit_m);
    const bool told = s->is_pelvis && *s->detail; /* a BVH's detail has its unit */
    snprintf(out, size, "%s: %d frame%s, %.4g a second%s, %s%s%s%s%s%s%s%s%s", s->format, frames,
             frames == 1 ? "" : "s", s->clip.fps, s->fps_said ? "" : " (assumed)", up_name[up],
             told ? "" : ", ", told ? "" : unit, *s->detail ? ", " : "", s->detail,
             s->unplaced ? ", no translation: on the spot" : "", s->has_shapes ? ", with a body shape" : "",
             lies(&s->clip, up) ? ", lying or upside down: is another axis up (--up)?" : "",
             knees_forward(&s->clip) ? ", knees bend forwards: are the rotations transposed?" : "");
}

sherf_status motion_finish(context *c, source *s, const sherf_motion_options *o, sherf_motion **out) {
    double unit_m;
    *out = NULL;
    sherf_up up = o->up == SHERF_UP_AUTO ? up_find(s) : o->up;
    sherf_motion *motion = mem_zero(c, 1, sizeof *motion);
    sherf_status status = motion ? place_pelvis(c, s, o, up, &unit_m) : SHERF_NO_MEMORY;
    if (!status && s->number) status = clip_spread(c, &s->clip, s->number);
    if (!status) {
        if (o->source_fps > 0) s->fps_said = true;
        describe(s, s->clip.frames, up, unit_m, motion->description, sizeof motion->description);
        clip_upright(&s->clip, up);
        motion->clip = s->clip;
        s->clip = (clip){0};
        motion->skeleton = s->skeleton;
        motion->loop = o->loop;
        motion->file_has_shapes = s->has_shapes;
        memcpy(motion->file_shapes, s->shapes, sizeof s->shapes);
        const float *worn = o->their_shape && s->has_shapes ? s->shapes : o->shapes;
        if (worn) memcpy(motion->shapes, worn, sizeof motion->shapes);
        status = apply_time(c, &motion->clip, o);
    }
    if (!status) status = apply_place(c, motion, o);
    if (status)
        sherf_motion_free(motion);
    else
        *out = motion;
    return status;
}

/* ---- recognising the format ---- */

static bool bvh_is(const unsigned char *data, size_t bytes) {
    static const char word[] = "HIERARCHY";
    if (utf16_is(data, bytes)) {
        size_t at = data[0] >= 0xfe ? 2 : 0;
        return bytes > at + 2 && (data[at] == 'H' || data[at + 1] == 'H');
    }
    size_t at = bytes >= 3 && !memcmp(data, "\xef\xbb\xbf", 3) ? 3 : 0;
    while (at < bytes && isspace(data[at])) at++;
    return bytes - at >= sizeof word - 1 && !strncasecmp((const char *)data + at, word, sizeof word - 1);
}

/* Rows of 22 or 24 joints, six numbers each, with a place, or a place and four contacts; in which order, only
 * their maker knows. */
static bool sixes_and_more(const value *root) {
    static const int16_t widths[] = {22 * SIX + 3, 24 * SIX + 3, 24 * SIX + 6, 24 * SIX + 7};
    const bool rows = root && root->kind == VALUE_ARRAY && root->array.rank == 2;
    for (size_t i = 0; rows && i < COUNT_OF(widths); i++)
        if (root->array.dim[1] == widths[i]) return true;
    return false;
}

/* A dict without poses: the message lists its keys; SAM 3D Body's is named. */
static sherf_status not_known(context *c, const value *root) {
    sherf_status status = body_parts_missing(c, root);
    char has[400];
    if (status == SHERF_UNSUPPORTED) return status;
    const value *format = value_get(value_get(root, "__metadata__"), "format"); /* of our own files */
    if (format && format->kind == VALUE_STRING)
        return failure(c, SHERF_BAD_FILE, "a %.40s, not a motion (docs/motion.md)", format->string.text);
    const char *keys = strstr(c->message, "; this has ");
    snprintf(has, sizeof has, "%s", keys ? keys : "");
    if (root && root->kind == VALUE_ARRAY) {
        size_t n = (size_t)snprintf(has, sizeof has, "; this is an array of");
        for (int k = 0; k < root->array.rank; k++)
            n += (size_t)snprintf(has + n, sizeof has - n, "%s%lld", k ? " x " : " ",
                                  (long long)root->array.dim[k]);
    }
    return failure(c, SHERF_BAD_FILE, "not a motion that is known here (docs/motion.md)%s%s%s", has,
                   sixes_and_more(root) ? ": six numbers a joint and more, it seems" : "",
                   root && root->kind == VALUE_ARRAY
                       ? "; write a dict of poses and trans, as np.savez(file, poses=..., trans=...) does"
                       : "");
}

/* Unwraps a single item in a list or dict (np.savez of a dict, "results"). */
static const value *unpacked(const value *root) {
    for (int depth = 0; root && depth < 8; depth++) {
        const value *only = NULL;
        if (root->kind == VALUE_LIST && root->list.count == 1 && !frame_list_is(root))
            only = root->list.item[0];
        if (root->kind == VALUE_DICT && root->dict.count == 1 && !track_file_is(root))
            only = root->dict.pair[0].item;
        if (!only || (root->kind == VALUE_DICT && only->kind != VALUE_DICT && only->kind != VALUE_LIST))
            break;
        root = only;
    }
    return root;
}

static sherf_status source_of_family(context *c, const value *root, const sherf_motion_options *o,
                                     source *s) {
    if (track_file_is(root)) return track_file_read(c, root, o, s);
    if (joints_file_is(root)) return joints_file_read(c, root, o, s);
    if (picture_is(root)) return frame_list_read(c, root, o, s);
    if (nested_file_is(root)) return nested_file_read(c, root, o, s);
    if (smpl_file_is(root)) return smpl_file_read(c, root, o, s);
    if (frame_list_is(root)) return frame_list_read(c, root, o, s);
    return not_known(c, root);
}

/* Data beside the bodies may be packed with them: a list of frames, people, a frame rate. */
static sherf_status source_of_tree(context *c, const value *root, const sherf_motion_options *o, source *s) {
    double fps = 0;
    bool said = false;
    const value *within = unpacked(root), *people = value_unwrapped(value_get(within, "people"));
    if (people && people->kind == VALUE_DICT && nested_file_is(people)) within = unpacked(people);
    const value *list = frame_list_within(within);
    sherf_status status = list && value_get(within, "frames") == list
                              ? frame_list_read(c, list, o, s)
                              : source_of_family(c, list ? list : within, o, s);
    if (status || s->fps_said || o->source_fps > 0) return status;
    status = source_rate(c, root, &fps, &said);
    if (!status && said) s->clip.fps = fps, s->fps_said = true;
    return status;
}

sherf_status motion_parse(context *c, const unsigned char *data, size_t bytes, const sherf_motion_options *o,
                          sherf_motion **out) {
    document *d = NULL;
    bvh *b = NULL;
    source s = {0};
    sherf_status status;
    *out = NULL;
    if (!bytes) return failure(c, SHERF_BAD_FILE, "the file is empty");
    if (bvh_is(data, bytes)) {
        status = bvh_parse(c, data, bytes, &b);
        if (!status) status = bvh_source_read(c, b, o, &s);
    } else {
        status = document_parse(c, data, bytes, &d, NULL);
        if (!status) status = source_of_tree(c, d->root, o, &s);
    }
    document_free(d);
    bvh_free(b);
    if (!status) status = motion_finish(c, &s, o, out);
    source_free(&s);
    return status;
}

/* Scene files of other programs are loaded like BVH. */
static sherf_status load_scene(context *c, const char *path, const char *kind, const sherf_motion_options *o,
                               source *s) {
    bvh *b = NULL;
    sherf_status status = scene_clip_read(c, path, &b);
    if (!status) status = bvh_source_read(c, b, o, s);
    s->format = kind;
    bvh_free(b);
    return status;
}

static sherf_status load_file(context *c, const char *path, const sherf_motion_options *o,
                              sherf_motion **out) {
    static const size_t limit_bytes = (size_t)4 << 30;
    unsigned char start[32] = {0}, *data = NULL;
    size_t bytes = 0;
    FILE *f = path_is_file(path) ? fopen(path, "rb") : NULL;
    if (f) bytes = fread(start, 1, sizeof start, f), fclose(f);
    const char *scene = scene_clip_kind(start, bytes);
    const bool zip = bytes >= 4 && !memcmp(start, "PK\3\4", 4);
    source s = {0};
    sherf_status status;
    if (zip) { /* read piece by piece */
        document *d = NULL;
        if ((status = document_read(c, path, &d, NULL))) return status; /* names the file itself */
        status = source_of_tree(c, d->root, o, &s);
        document_free(d);
    } else if (scene) {
        status = load_scene(c, path, scene, o, &s);
    } else {
        if ((status = file_read(c, path, limit_bytes, &data, &bytes))) return status;
        status = motion_parse(c, data, bytes, o, out);
        mem_free(data);
        return status ? failure_prefix(c, status, "%s", path) : SHERF_OK;
    }
    if (!status) status = motion_finish(c, &s, o, out);
    source_free(&s);
    return status ? failure_prefix(c, status, "%s", path) : SHERF_OK;
}

sherf_status sherf_motion_load(sherf_context *c, const char *path, const sherf_motion_options *options,
                               sherf_motion **out) {
    static const sherf_motion_options none;
    const sherf_motion_options *o = options ? options : &none;
    *out = NULL;
    sherf_status status = motion_options_check(c, o);
    if (status) return status;
    if (!path_is_folder(path)) return load_file(c, path, o, out);
    source s = {0};
    status = frame_folder_read(c, path, o, &s);
    if (!status) status = motion_finish(c, &s, o, out);
    source_free(&s);
    return status ? failure_prefix(c, status, "%s", path) : SHERF_OK;
}
