/* Functions shared by all families of motion formats. */
#include <stdlib.h>
#include <string.h>

#include "motion/source.h"

void source_free(source *s) {
    clip_free(&s->clip);
    mem_free(s->number);
    *s = (source){0};
}

sherf_status source_frames(context *c, source *s, const sherf_motion_options *o, int64_t frames, double fps) {
    if (frames < 1 || frames > MOTION_FRAMES_MAX)
        return failure(c, SHERF_BAD_FILE, "%s: %lld frames, of 1 to %d", s->format, (long long)frames,
                       MOTION_FRAMES_MAX);
    skeleton_of(o->body, o->their_shape && s->has_shapes ? s->shapes : o->shapes, &s->skeleton);
    for (int k = 0; k < 3; k++)
        s->pelvis_m[k] = s->skeleton.rest_m[0][k] + (s->smplx ? smplx_pelvis_m[k] : 0);
    sherf_status status = clip_create(c, (int)frames, o->source_fps > 0 ? o->source_fps : fps, &s->clip);
    for (int i = 0; i < s->clip.frames; i++)
        for (int j = 0; j < BODY_JOINTS; j++) s->clip.turn[i][j][0] = 1;
    return status;
}

bool source_is_frame(const value *v) {
    static const int joints[] = {24, 22, 52, 55, 53, 23, 21, 0};
    static const int8_t per[] = {3, 4, 9};
    const int64_t numbers = value_numbers(v);
    for (const int *j = joints; *j; j++)
        for (size_t p = 0; p < COUNT_OF(per); p++)
            if (numbers == *j * per[p]) return true;
    return six_joints(v, joints) > 0;
}

bool source_rows_are_frames(const value *rows) {
    const int64_t n = value_numbers(rows), count = parse_rows(rows);
    if (count < 1 || n < 1) return false;
    const value row = parse_row_of(rows, 0);
    return n % count == 0 && value_numbers(&row) == n / count && source_is_frame(&row);
}

int source_body_joints(int64_t numbers) {
    const int64_t per = numbers % BODY_JOINTS ? 0 : numbers / BODY_JOINTS;
    return per == 3 || per == 4 || per == SIX || per == 9 ? BODY_JOINTS : 22;
}

void source_take_person(named_value *part, int64_t people, int64_t person, value *room) {
    const value *v = part->item;
    if (!v || parse_rows(v) != people || (v->kind == VALUE_ARRAY && v->array.rank < 2)) return;
    *room = parse_row_of(v, (size_t)person);
    part->item = room;
}

static sherf_status rate_read(context *c, named_value rate, bool seconds, double *fps, bool *said) {
    double number = 0;
    char *end = NULL;
    sherf_status status = SHERF_OK;
    if (rate.item->kind == VALUE_STRING) {
        number = strtod(rate.item->string.text, &end);
        if (end == rate.item->string.text || *end) return SHERF_OK; /* "auto" */
    } else
        status = value_doubles(c, rate.item, "frame rate", 1, &number);
    if (!status && seconds) number = 1 / number;
    if (!status && !(number >= 0.01 && number <= 10000))
        status = failure(c, SHERF_BAD_FILE, "frame rate: %g a second, must be 0.01 to 10000; give another",
                         number);
    if (!status) *fps = number, *said = true;
    return status;
}

sherf_status source_rate(context *c, const value *root, double *fps, bool *said) {
    static const char *const names[] =
        {"mocap_framerate", "mocap_frame_rate", "fps",       "frame_rate", "framerate", "frameRate",
         "mocap_fps",       "motion_fps",       "video_fps", "FPS",        NULL},
                             *const times[] = {"frame_time", "frametime", "frameTime", NULL};
    if (!root || root->kind != VALUE_DICT) return SHERF_OK;
    const named_value rate = value_first(root, names), time = value_first(root, times);
    if (rate.item) return rate_read(c, rate, false, fps, said);
    if (time.item && value_numbers(time.item) <= 1) return rate_read(c, time, true, fps, said);
    for (size_t i = 0; i < root->dict.count; i++) {
        const value *inner = value_unwrapped(root->dict.pair[i].item);
        const named_value own = value_first(inner, names);
        if (own.item) return rate_read(c, own, false, fps, said);
    }
    return SHERF_OK;
}

int64_t source_people(const body_parts *p) {
    const value *rows = p->part[PART_BODY].item ? p->part[PART_BODY].item : p->part[PART_POSES].item;
    const int64_t people = parse_rows(rows);
    return people > 1 && source_rows_are_frames(rows) ? people : 1;
}

sherf_status source_numbers(context *c, source *s) {
    s->number = mem_alloc(c, (size_t)s->clip.frames, sizeof *s->number);
    for (int i = 0; i < s->clip.frames && s->number; i++) s->number[i] = i;
    return s->number ? SHERF_OK : SHERF_NO_MEMORY;
}

sherf_status source_shapes(context *c, source *s, const value *betas) {
    enum { LONGEST = 1000 };
    double row[LONGEST];
    int64_t n = value_numbers(betas);
    if (n < 1) return SHERF_OK;
    /* (B), (1, B) or (F, B): the last axis is that of the shapes. */
    const value *v = betas;
    int64_t rows = parse_rows(v), width = n;
    bool nested =
        v->kind == VALUE_ARRAY ? v->array.rank > 1 : v->list.count && value_numbers(v->list.item[0]) >= 0;
    if (nested && rows > 0) width = n / rows;
    if (width < 1 || width > LONGEST || (nested && rows < 1))
        return failure(c, SHERF_BAD_FILE, "betas: %lld numbers", (long long)width);
    sherf_status status = nested ? parse_row(c, v, 0, "betas", (size_t)width, row)
                                 : value_doubles(c, v, "betas", (size_t)n, row);
    if (status) return status;
    for (int i = 0; i < BODY_SHAPES; i++) s->shapes[i] = i < width ? (float)row[i] : 0;
    s->has_shapes = true;
    return SHERF_OK;
}
