/* Dicts of arrays with a row for each frame: AMASS of SMPL+H and SMPL-X, AIST++, EDGE, GVHMR, CLIFF, ROMP,
 * TRAM, SLAHMR, 3DPW, EMDB, aitviewer, plain SMPL poses. Some have an axis for people before the one for
 * frames. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "motion/source.h"

/* Numbers of joints in SMPL, SMPL+H and SMPL-X files; the first 22 are the same in all of them. */
static const int whole_joints[] = {24, 22, 52, 55, 53, 0}, body_joints[] = {23, 21, 0}, root_joint[] = {1, 0};

static const char *const rate_names[] = {"mocap_framerate", "mocap_frame_rate", "fps", "frame_rate", NULL};
static const char *const number_names[] = {"frame", "frame_ids", "frame_id", NULL};
static const char *const mask_names[] = {"track_mask", "vis_mask", NULL};

/* GVHMR's own, in a dict, or with the dict's name before the keys; PromptHMR's. */
static const value *gvhmr_params(const value *root) {
    static const char *const names[] = {"smpl_params_global", "smplx_world", NULL};
    return value_unwrapped(value_first(root, names).item);
}

static const value *get_prefixed(const value *root, const char *key) {
    static const char *const between[] = {"/", ".", "_", "__"};
    for (size_t i = 0; i < COUNT_OF(between); i++) {
        char name[64];
        snprintf(name, sizeof name, "smpl_params_global%s%s", between[i], key);
        const value *v = value_get(root, name);
        if (v) return v;
    }
    return NULL;
}

static bool gvhmr_is(const value *root) {
    return gvhmr_params(root) || get_prefixed(root, "body_pose");
}

static void find_parts(const value *root, body_parts *out) {
    if (gvhmr_params(root) || !get_prefixed(root, "body_pose")) {
        body_parts_find(gvhmr_params(root) ? gvhmr_params(root) : root, out);
        return;
    }
    *out = (body_parts){.smplx = true};
    out->part[PART_BODY] = (named_value){"body_pose", get_prefixed(root, "body_pose")};
    out->part[PART_ROOT] = (named_value){"global_orient", get_prefixed(root, "global_orient")};
    out->part[PART_PLACE] = (named_value){"transl", get_prefixed(root, "transl")};
    out->part[PART_SHAPES] = (named_value){"betas", get_prefixed(root, "betas")};
}

/* If the file has both all joints and all but the root, the latter count. */
static const value *rows_of(const body_parts *p) {
    return p->part[PART_BODY].item ? p->part[PART_BODY].item : p->part[PART_POSES].item;
}

bool smpl_file_is(const value *root) {
    body_parts p;
    if (!root || (root->kind != VALUE_DICT && root->kind != VALUE_RECORD)) return false;
    find_parts(root, &p);
    return rows_of(&p) != NULL;
}

/* ---- people and frames ---- */

typedef struct {
    int64_t people, frames; /* people 0: there is no axis for them */
} layout;

static int64_t second_axis(const value *v) {
    if (v->kind == VALUE_LIST) return v->list.count ? parse_rows(v->list.item[0]) : -1;
    return v->array.rank > 1 ? v->array.dim[1] : -1;
}

/* If a row's length fits no number of joints, the first axis counts the frames; reading reports the error. */
static layout layout_of(const value *rows) {
    const int64_t n = value_numbers(rows), first = parse_rows(rows), second = n > 0 ? second_axis(rows) : -1;
    if (n < 1 || first < 1) return (layout){0, 0};
    if (source_rows_are_frames(rows)) return (layout){0, first};
    if (source_is_frame(rows)) return (layout){0, 1};
    const value person = parse_row_of(rows, 0);
    if (second > 0 && source_rows_are_frames(&person) &&
        (rows->kind == VALUE_LIST || n == first * value_numbers(&person)))
        return (layout){first, second}; /* in lists, people may have different lengths */
    return (layout){0, second > 0 ? first : 1};
}

/* A person's frames are more alike than people are. Detects that many short people are actually few long ones
 * with exchanged axes. */
static bool frames_before_people(const value *rows, const layout *all) {
    if (rows->kind != VALUE_ARRAY || all->people <= all->frames || all->frames < 2) return false;
    const int64_t n = value_numbers(rows), row = n / all->people / all->frames, person = row * all->frames;
    double first = 0, second = 0; /* how much neighbours along either axis differ */
    for (int64_t i = 0; i < n; i++) {
        const double x = value_array_number(rows, i);
        if (i + person < n) first += fabs(value_array_number(rows, i + person) - x);
        if (i % person + row < person) second += fabs(value_array_number(rows, i + row) - x);
    }
    return 4 * first / (double)(n - person) < second / (double)(n - all->people * row);
}

static int64_t mask_count(const value *mask) {
    int64_t count = 0, n = mask && mask->kind == VALUE_ARRAY ? value_numbers(mask) : 0;
    for (int64_t i = 0; i < n; i++) count += value_array_number(mask, i) != 0;
    return count;
}

/* The requested person, or the one present longest. */
static sherf_status choose_person(context *c, const value *root, const value *rows, int64_t people,
                                  const sherf_motion_options *o, source *s, int64_t *out) {
    const value *mask = value_first(root, mask_names).item;
    int64_t longest = -1;
    char *end = NULL;
    *out = 0;
    if (o->track) {
        *out = strtoll(o->track, &end, 10);
        if (end == o->track || *end || *out < 0 || *out >= people)
            return failure(c, SHERF_BAD_ARGUMENT, "no track '%.60s' among the %lld of the file", o->track,
                           (long long)people);
    }
    for (int64_t i = 0; i < people && !o->track; i++) {
        const value own = parse_row_of(rows, (size_t)i);
        int64_t length = parse_rows(&own);
        if (mask && parse_rows(mask) == people && mask->kind == VALUE_ARRAY && mask->array.rank > 1) {
            const value seen = parse_row_of(mask, (size_t)i);
            length = mask_count(&seen);
        }
        if (length > longest) longest = length, *out = i;
    }
    snprintf(s->detail, sizeof s->detail, "track %lld of %lld", (long long)*out, (long long)people);
    return SHERF_OK;
}

/* ---- recognising the format ---- */

/* Sources that have a key of their own, and their usual settings. In a camera's view y points down. */
static const struct {
    const char *key, *other, *format; /* other: must be there as well; NULL: none */
    sherf_up up;
    double fps, unit_m; /* 0: to be found */
} sources[] = {
    {"smpl_poses", "smpl_scaling", "AIST++", SHERF_UP_Y, 60, 1},
    {"smpl_poses", "full_pose", "EDGE", SHERF_UP_Z, 30, 1},
    {"smpl_poses", "smpl_trans", "AIST++ without its scaling", SHERF_UP_Y, 60, 0},
    {"smpl_poses", NULL, "AIST++", SHERF_UP_Y, 60, 1},
    {"pose", "global_t", "CLIFF", SHERF_UP_MINUS_Y, 30, 1},
    {"pred_rotmat", NULL, "TRAM", SHERF_UP_MINUS_Y, 30, 1},
    {"pose_lhand", "pose_body", "Inter-X", SHERF_UP_Y, 120, 1},
    {"rotvec", NULL, "Multi-HMR", SHERF_UP_MINUS_Y, 30, 1},
    {"track_mask", "pose_body", "SLAHMR", SHERF_UP_Y, 30, 1},
    {"cam_poses", "poses", "3DPW", SHERF_UP_Y, 30, 1},
};

static void recognise(const value *root, const body_parts *p, int64_t numbers, source *s, double *fps) {
    const char *pose = p->part[PART_POSES].name ? p->part[PART_POSES].name : "";
    const bool parts = p->part[PART_BODY].name && !strcmp(p->part[PART_BODY].name, "poses_body");
    s->format = "SMPL poses";
    s->up = SHERF_UP_Y;
    *fps = 30;
    for (size_t i = 0; i < COUNT_OF(sources); i++)
        if (value_get(root, sources[i].key) && (!sources[i].other || value_get(root, sources[i].other))) {
            s->format = sources[i].format, s->up = sources[i].up, s->unit_m = sources[i].unit_m;
            *fps = sources[i].fps;
            return;
        }
    if (gvhmr_is(root)) {
        s->format = value_get(root, "smplx_world") ? "PromptHMR" : "GVHMR";
        s->unit_m = 1;
    } else if (!strcmp(pose, "smpl_thetas")) {
        s->format = "ROMP";
        s->up = SHERF_UP_MINUS_Y;
        s->unit_m = 1;
    } else if (parts) {
        s->format = value_get(root, "smpl") ? "EMDB" : "aitviewer";
    } else if (value_first(root, rate_names).item || value_get(root, "gender")) {
        s->up = SHERF_UP_Z;
        s->format = numbers == 156                 ? "AMASS, SMPL+H"
                    : numbers == 165               ? "AMASS, SMPL-X"
                    : value_get(root, "pose_body") ? "AMASS, SMPL-X by parts"
                                                   : "AMASS, SMPL";
    }
}

/* ---- reading ---- */

static sherf_status read_places(context *c, const named_value *trans, clip *k) {
    const int64_t n = value_numbers(trans->item);
    const bool one = k->frames == 1 && n == 3; /* perhaps without an axis for frames */
    if (n != 3 * (int64_t)k->frames || (!one && parse_rows(trans->item) != k->frames))
        return failure(c, SHERF_BAD_FILE, "%s: %lld numbers for %d frames, not three each", trans->name,
                       (long long)n, k->frames);
    for (int i = 0; i < k->frames; i++) {
        double place[3];
        sherf_status status = one ? value_doubles(c, trans->item, trans->name, 3, place)
                                  : parse_row(c, trans->item, (size_t)i, trans->name, 3, place);
        if (status) return status;
        for (int a = 0; a < 3; a++) k->pelvis_m[i][a] = (float)place[a];
    }
    return SHERF_OK;
}

static sherf_status read_turns(context *c, const body_parts *p, const sherf_motion_options *o, clip *k) {
    const named_value *whole = &p->part[PART_POSES], *body = &p->part[PART_BODY], *root = &p->part[PART_ROOT];
    const sherf_rotations rotations = rotation_said(p, o->rotations);
    if (body->item) {
        sherf_status status = rotation_rows(c, body->name, body->item, rotations, body_joints, 1, 23, k);
        if (status || !root->item) return status;
        return rotation_rows(c, root->name, root->item,
                             rotation_root_form(c, body->item, root->item, k->frames, body_joints, rotations),
                             root_joint, 0, 1, k);
    }
    return rotation_rows(c, whole->name, whole->item, rotations, whole_joints, 0,
                         source_body_joints(value_numbers(whole->item) / k->frames), k);
}

/* R or Rh of EasyMocap, a row a frame or one for all: x = R x_smpl + Th, so the pelvis comes to R J0 + Th. */
static sherf_status read_world(context *c, const named_value *turn, source *s) {
    const int64_t frames = s->clip.frames, n = value_numbers(turn->item);
    const bool rows = frames > 1 && parse_rows(turn->item) == frames && n >= 3 * frames;
    const double unit_m = s->unit_m > 0 ? s->unit_m : 1;
    for (int i = 0; i < frames; i++) {
        const value own = rows ? parse_row_of(turn->item, (size_t)i) : *turn->item;
        float world[1][4];
        double J0[3];
        sherf_status status =
            rotation_frame(c, turn->name, &own, SHERF_ROTATIONS_AUTO, root_joint, 0, 1, world);
        if (status) return status;
        quaternion_multiply(world[0], s->clip.turn[i][0], s->clip.turn[i][0]);
        quaternion_rotate(world[0], s->pelvis_m, J0);
        for (int a = 0; a < 3; a++) s->clip.pelvis_m[i][a] += (float)((J0[a] - s->pelvis_m[a]) / unit_m);
    }
    return SHERF_OK;
}

/* AIST++: its vertices are SMPL's times the scaling plus the translation. */
static sherf_status read_scaling(context *c, const value *root, source *s) {
    const value *v = value_get(root, "smpl_scaling");
    double scaling;
    if (!v) return SHERF_OK;
    sherf_status status = value_doubles(c, v, "smpl_scaling", 1, &scaling);
    if (!status && !(scaling > 1e-6 && scaling < 1e6))
        status = failure(c, SHERF_BAD_FILE, "smpl_scaling is %g", scaling);
    if (!status) s->unit_m = 1 / scaling;
    return status;
}

/* Frame numbers with gaps, as trackers write them; others are ignored. */
static sherf_status read_frame_numbers(context *c, const value *root, source *s) {
    const value *v = value_first(root, number_names).item;
    double last = -1, number = 0;
    if (!v || v->kind != VALUE_ARRAY || value_numbers(v) != s->clip.frames) return SHERF_OK;
    for (int i = 0; i < s->clip.frames; i++, last = number) {
        number = value_array_number(v, i);
        if (!(number > last && number < 1e9)) return SHERF_OK;
    }
    sherf_status status = source_numbers(c, s);
    for (int i = 0; i < s->clip.frames && !status; i++) s->number[i] = (int64_t)value_array_number(v, i);
    return status;
}

/* Frames in which the person was not seen are left out, to be filled in. */
static sherf_status drop_unseen(context *c, const value *mask, source *s) {
    const int frames = s->clip.frames;
    if (!mask || mask->kind != VALUE_ARRAY || value_numbers(mask) != frames || s->number) return SHERF_OK;
    if (mask_count(mask) < 1 || mask_count(mask) == frames) return SHERF_OK;
    sherf_status status = source_numbers(c, s);
    int kept = 0;
    for (int i = 0; i < frames && !status; i++) {
        if (value_array_number(mask, i) == 0) continue;
        memcpy(s->clip.turn[kept], s->clip.turn[i], sizeof *s->clip.turn);
        memcpy(s->clip.pelvis_m[kept], s->clip.pelvis_m[i], sizeof *s->clip.pelvis_m);
        s->number[kept++] = i;
    }
    if (!status) s->clip.frames = kept;
    return status;
}

sherf_status smpl_file_read(context *c, const value *root, const sherf_motion_options *o, source *s) {
    body_parts p;
    value room[PARTS], mask_room;
    double fps;
    int64_t person = 0;
    find_parts(root, &p);
    layout all = layout_of(rows_of(&p));
    named_value mask = value_first(root, mask_names);
    sherf_status status = SHERF_OK;
    if (all.frames < 1) return failure(c, SHERF_BAD_FILE, "poses: no rows of numbers");
    if (all.people > 1 && frames_before_people(rows_of(&p), &all))
        return failure(
            c, SHERF_BAD_FILE,
            "poses: %lld people of %lld frames, but neighbours along the first axis are alike: frames come "
            "first; write people x frames",
            (long long)all.people, (long long)all.frames);
    if (all.people > 1) status = choose_person(c, root, rows_of(&p), all.people, o, s, &person);
    if (status) return status;
    if (all.people) {
        for (int i = 0; i < PARTS; i++) source_take_person(&p.part[i], all.people, person, &room[i]);
        source_take_person(&mask, all.people, person, &mask_room);
        all.frames = layout_of(rows_of(&p)).frames;
    }
    const int64_t numbers = value_numbers(rows_of(&p)) / all.frames;
    recognise(root, &p, numbers, s, &fps);
    s->smplx = p.smplx || gvhmr_is(root) || (!p.part[PART_BODY].item && (numbers == 165 || numbers == 495));
    body_parts_warn(c, gvhmr_is(root) ? NULL : root, s->format);
    const named_value *place = p.part[PART_PELVIS].item  ? &p.part[PART_PELVIS]
                               : p.part[PART_PLACE].item ? &p.part[PART_PLACE]
                                                         : &p.part[PART_CAMERA_PLACE];
    s->is_pelvis = p.part[PART_PELVIS].item != NULL;
    status = source_shapes(c, s, p.part[PART_SHAPES].item);
    if (!status && !(o->source_fps > 0)) status = source_rate(c, root, &fps, &s->fps_said);
    if (!status) status = source_frames(c, s, o, all.frames, fps);
    if (!status) status = read_turns(c, &p, o, &s->clip);
    s->unplaced = !place->item;
    if (!status && place->item) status = read_places(c, place, &s->clip);
    if (!status) status = read_scaling(c, root, s);
    if (!status && p.part[PART_TURN].item) status = read_world(c, &p.part[PART_TURN], s);
    if (!status) status = read_frame_numbers(c, root, s);
    return status ? status : drop_unseen(c, mask.item, s);
}
