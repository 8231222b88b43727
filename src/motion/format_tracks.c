/* Files of several people: WHAM (a dict of tracks) and PHALP (a dict of frames with people in them). */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "motion/source.h"

enum { TRACKS_MAX = 256, PEOPLE_MAX = 1 << 23 }; /* in all frames together */
static const int whole_joints[] = {24, 0}, body_joints[] = {23, 21, 0}, root_joint[] = {1, 0};

/* ---- WHAM: {track: {pose, trans, pose_world, trans_world, betas, frame_ids}}, axis-angle; its first version
 * {track: {poses_root_world, poses_body, trans_world, betas, frame_id}}, matrices ---- */

static const value *either(const value *v, const char *a, const char *b) {
    const value *found = value_get(v, a);
    return found ? found : value_get(v, b);
}

static bool wham_track_by_parts(const value *v) {
    return value_get(v, "poses_root_world") && value_get(v, "poses_body");
}

static bool wham_track_is(const value *v) {
    return value_get(v, "pose_world") || wham_track_by_parts(v) ||
           (value_get(v, "pose") && either(v, "frame_ids", "frame_id"));
}

/* Rotations, a row a frame. */
static const value *wham_rows(const value *track) {
    return wham_track_by_parts(track) ? value_get(track, "poses_body") : either(track, "pose_world", "pose");
}

/* The item of frame n; NULL where nobody is in it. */
static bool phalp_frame_is(const value *v) {
    const value *people = value_get(v, "smpl");
    return people && people->kind == VALUE_LIST;
}

bool track_file_is(const value *root) {
    if (wham_track_is(root)) return true;
    if (!root || root->kind != VALUE_DICT || !root->dict.count) return false;
    for (size_t i = 0; i < root->dict.count; i++) {
        const value *item = root->dict.pair[i].item;
        if (wham_track_is(item) || phalp_frame_is(item)) return true;
    }
    return false;
}

/* Converts a number or a text to the text that requests a track. */
static void key_text(const value *key, char out[64]) {
    out[0] = 0;
    if (!key) return;
    if (key->kind == VALUE_STRING) snprintf(out, 64, "%.60s", key->string.text);
    if (key->kind == VALUE_INTEGER) snprintf(out, 64, "%lld", (long long)key->integer);
    if (key->kind == VALUE_REAL) snprintf(out, 64, "%.0f", key->real);
    if (key->kind == VALUE_ARRAY && value_numbers(key) == 1)
        snprintf(out, 64, "%.0f", value_array_number(key, 0));
}

static sherf_status no_track(context *c, const char *wanted, int count) {
    return failure(c, SHERF_BAD_ARGUMENT, "no track '%.60s' among the %d of the file", wanted, count);
}

static sherf_status wham_find(context *c, const value *root, const sherf_motion_options *o, source *s,
                              const value **out) {
    char name[64], taken[64] = "";
    int64_t longest = 0;
    int count = 0;
    *out = NULL;
    if (wham_track_is(root)) {
        *out = root;
        return SHERF_OK;
    }
    for (size_t i = 0; i < root->dict.count; i++) {
        const value *track = root->dict.pair[i].item;
        if (!wham_track_is(track)) continue;
        count++;
        key_text(root->dict.pair[i].key, name);
        int64_t rows = parse_rows(wham_rows(track));
        if (o->track ? strcmp(name, o->track) : rows <= longest) continue;
        longest = rows, *out = track;
        memcpy(taken, name, sizeof taken);
    }
    if (!*out) return o->track ? no_track(c, o->track, count) : failure(c, SHERF_BAD_FILE, "no frames");
    snprintf(s->detail, sizeof s->detail, "track %.40s of %d", taken, count);
    return SHERF_OK;
}

static sherf_status read_numbers(context *c, const value *ids, source *s) {
    if (!ids) return SHERF_OK;
    sherf_status status = source_numbers(c, s);
    for (int i = 0; i < s->clip.frames && !status; i++) {
        double number;
        status = parse_row(c, ids, (size_t)i, "frame_ids", 1, &number);
        if (!status && !(number >= 0 && number < 1e9))
            status = failure(c, SHERF_BAD_FILE, "frame_ids: %g", number);
        if (status) return status;
        s->number[i] = (int64_t)number;
        if (i && s->number[i] <= s->number[i - 1])
            status = failure(c, SHERF_BAD_FILE, "frame_ids do not ascend");
    }
    return status;
}

static sherf_status wham_read(context *c, const value *root, const sherf_motion_options *o, source *s) {
    const value *track;
    sherf_status status = wham_find(c, root, o, s, &track);
    if (status) return status;
    const bool parts = wham_track_by_parts(track);
    const bool world = parts || (value_get(track, "pose_world") && value_get(track, "trans_world"));
    const value *pose = parts ? wham_rows(track) : value_get(track, world ? "pose_world" : "pose");
    const value *trans = value_get(track, world ? "trans_world" : "trans");
    s->format = world ? "WHAM" : "WHAM, camera's view";
    s->up = world ? SHERF_UP_Y : SHERF_UP_MINUS_Y;
    s->unit_m = 1;
    s->unplaced = !trans;
    status = source_shapes(c, s, value_get(track, "betas"));
    if (!status) status = source_frames(c, s, o, parse_rows(pose), 30);
    if (!status && parts) {
        status = rotation_rows(c, "poses_body", pose, o->rotations, body_joints, 1, 23, &s->clip);
        if (!status)
            status = rotation_rows(c, "poses_root_world", value_get(track, "poses_root_world"), o->rotations,
                                   root_joint, 0, 1, &s->clip);
    } else if (!status) {
        status = rotation_rows(c, "pose", pose, o->rotations, whole_joints, 0, 24, &s->clip);
    }
    for (int i = 0; i < s->clip.frames && trans && !status; i++) {
        double place[3];
        status = parse_row(c, trans, (size_t)i, "trans", 3, place);
        for (int a = 0; a < 3 && !status; a++) s->clip.pelvis_m[i][a] = (float)place[a];
    }
    return status ? status : read_numbers(c, either(track, "frame_ids", "frame_id"), s);
}

/* ---- PHALP: {frame: {smpl: [{global_orient, body_pose, betas}], camera: [..], tid: [..]}} ---- */

/* Track of person i in a frame; without a list of tracks the place in the frame. */
static void phalp_track(const value *frame, size_t i, char out[64]) {
    const value *tracks = either(frame, "tid", "tracked_ids");
    if (tracks && tracks->kind == VALUE_ARRAY && tracks->array.rank == 1 &&
        i < (uint64_t)tracks->array.dim[0]) {
        snprintf(out, 64, "%.0f", value_array_number(tracks, (int64_t)i));
        return;
    }
    const value *track = tracks && tracks->kind == VALUE_LIST ? value_at(tracks, i) : NULL;
    if (track)
        key_text(track, out);
    else
        snprintf(out, 64, "%zu", i);
}

/* Which person of the frame is the track; -1: none. */
static int phalp_person(const value *frame, const char *track) {
    const value *people = value_get(frame, "smpl");
    size_t n = phalp_frame_is(frame) ? people->list.count : 0;
    for (size_t i = 0; i < n && i < TRACKS_MAX; i++) {
        char name[64];
        phalp_track(frame, i, name);
        if (!strcmp(name, track)) return (int)i;
    }
    return -1;
}

typedef struct {
    char name[64];
    int64_t frames;
} tally;

/* The track in the most frames, and the number of tracks. */
static sherf_status phalp_longest(context *c, const value *root, tally *best, int *count) {
    tally *all = mem_zero(c, TRACKS_MAX, sizeof *all);
    int64_t people_met = 0;
    *count = 0;
    *best = (tally){{0}, 0};
    if (!all) return SHERF_NO_MEMORY;
    for (size_t f = 0; f < root->dict.count; f++) {
        const value *frame = root->dict.pair[f].item, *people = value_get(frame, "smpl");
        for (size_t i = 0; phalp_frame_is(frame) && i < people->list.count && i < TRACKS_MAX; i++) {
            char name[64];
            int t = 0;
            phalp_track(frame, i, name);
            while (t < *count && strcmp(all[t].name, name)) t++;
            if (++people_met > PEOPLE_MAX || t == TRACKS_MAX) {
                mem_free(all);
                return failure(c, SHERF_BAD_FILE, "more than %d tracks, or people in all", TRACKS_MAX);
            }
            if (t == *count) memcpy(all[(*count)++].name, name, sizeof name);
            if (++all[t].frames > best->frames) *best = all[t];
        }
    }
    mem_free(all);
    return SHERF_OK;
}

static sherf_status phalp_frame(context *c, const value *frame, int person, const sherf_motion_options *o,
                                source *s, int at) {
    const value *smpl = value_at(value_get(frame, "smpl"), (size_t)person),
                *camera = value_get(frame, "camera");
    float(*turn)[4] = s->clip.turn[at];
    double place[3] = {0};
    sherf_status status =
        rotation_frame(c, "body_pose", value_get(smpl, "body_pose"), o->rotations, body_joints, 1, 23, turn);
    if (!status)
        status = rotation_frame(c, "global_orient", value_get(smpl, "global_orient"), o->rotations,
                                root_joint, 0, 1, turn);
    if (!status && camera) status = parse_row(c, camera, (size_t)person, "camera", 3, place);
    for (int a = 0; a < 3 && !status; a++) s->clip.pelvis_m[at][a] = (float)place[a];
    return status;
}

static sherf_status phalp_read(context *c, const value *root, const sherf_motion_options *o, source *s) {
    tally best;
    int count, at = 0;
    int64_t frames = 0;
    s->format = "PHALP";
    s->up = SHERF_UP_MINUS_Y;
    s->unit_m = 1;
    sherf_status status = phalp_longest(c, root, &best, &count);
    if (status) return status;
    const char *track = o->track ? o->track : best.name;
    for (size_t f = 0; f < root->dict.count; f++) {
        int person = phalp_person(root->dict.pair[f].item, track);
        if (person < 0) continue;
        const value *smpl = value_at(value_get(root->dict.pair[f].item, "smpl"), (size_t)person);
        if (!frames++ && (status = source_shapes(c, s, value_get(smpl, "betas")))) return status;
        s->unplaced = !value_get(root->dict.pair[f].item, "camera");
    }
    if (!frames) return o->track ? no_track(c, track, count) : failure(c, SHERF_BAD_FILE, "nobody in it");
    snprintf(s->detail, sizeof s->detail, "track %.40s of %d", track, count);
    status = source_frames(c, s, o, frames, 30);
    if (!status) status = source_numbers(c, s);
    for (size_t f = 0; f < root->dict.count && !status; f++) { /* frames stand in order of time */
        const value *frame = root->dict.pair[f].item;
        int person = phalp_person(frame, track);
        if (person < 0) continue;
        s->number[at] = (int64_t)f;
        status = phalp_frame(c, frame, person, o, s, at++);
        if (status) failure_prefix(c, status, "frame %zu", f);
    }
    return status;
}

sherf_status track_file_read(context *c, const value *root, const sherf_motion_options *o, source *s) {
    if (wham_track_is(root)) return wham_read(c, root, o, s);
    for (size_t i = 0; i < root->dict.count; i++)
        if (wham_track_is(root->dict.pair[i].item)) return wham_read(c, root, o, s);
    return phalp_read(c, root, o, s);
}
