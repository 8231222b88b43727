/* Frame by frame. EasyMocap: [{id, Rh, Th, poses, shapes}, ...], a file a frame in a folder, or one list of
 * such lists. LHM and ExAvatar: a folder of {root_pose, body_pose, trans, betas, ...}. */
#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/path.h"
#include "motion/source.h"

static const int whole_joints[] = {24, 22, 52, 55, 29, 0}, body_joints[] = {21, 23, 0}, root_joint[] = {1, 0};

/* ---- what a frame holds ---- */

static bool person_is(const value *v) {
    return value_numbers(value_get(v, "poses")) > 0;
}

/* The people of a frame: a list, or a dict with such a list under "annots". */
static const value *people_of(const value *frame) {
    const value *inner = frame && frame->kind == VALUE_DICT ? value_get(frame, "annots") : NULL;
    const value *list = inner ? inner : frame;
    return list && list->kind == VALUE_LIST ? list : NULL;
}

static bool lhm_is(const value *v) {
    return value_get(v, "root_pose") && value_get(v, "body_pose");
}

static bool frame_is(const value *frame) {
    const value *people = people_of(frame);
    if (person_is(frame) || lhm_is(frame)) return true;
    for (size_t i = 0; people && i < people->list.count; i++)
        if (person_is(people->list.item[i])) return true;
    return false;
}

/* {"frames": [...]}: the list within. */
static const value *frames_of(const value *root) {
    const value *inner = value_get(root, "frames");
    return inner && inner->kind == VALUE_LIST ? inner : root;
}

bool frame_list_is(const value *root) {
    root = frames_of(root);
    if (frame_is(root)) return true;
    for (size_t i = 0; root && root->kind == VALUE_LIST && i < root->list.count; i++)
        if (frame_is(root->list.item[i])) return true;
    return false;
}

static void person_name(const value *person, size_t place, char out[64]) {
    const value *id = value_get(person, "id");
    snprintf(out, 64, "%zu", place);
    if (id && id->kind == VALUE_INTEGER) snprintf(out, 64, "%lld", (long long)id->integer);
    if (id && id->kind == VALUE_STRING) snprintf(out, 64, "%.60s", id->string.text);
}

/* The person wanted in a frame, by name; `name` empty: the first, whose name is then stored. */
static const value *person_in(const value *frame, char name[64]) {
    if (person_is(frame) || lhm_is(frame)) return frame;
    const value *people = people_of(frame);
    for (size_t i = 0; people && i < people->list.count; i++) {
        char own[64];
        if (!person_is(people->list.item[i])) continue;
        person_name(people->list.item[i], i, own);
        if (!*name) memcpy(name, own, sizeof own);
        if (!strcmp(own, name)) return people->list.item[i];
    }
    return NULL;
}

/* Rh and Th turn and move SMPL's own space: x = R(Rh) x_smpl + Th, so the pelvis, at J0 there, comes to
 * R J0 + Th. */
static sherf_status easymocap_frame(context *c, const value *person, const sherf_motion_options *o, source *s,
                                    int at) {
    float(*turn)[4] = s->clip.turn[at], world[4] = {1, 0, 0, 0};
    double Th[3] = {0}, J0[3];
    const value *poses = value_get(person, "poses");
    int64_t n = value_numbers(poses);
    sherf_status status =
        n == 69 || n == 63 /* without the root */
            ? rotation_frame(c, "poses", poses, o->rotations, body_joints, 1, 23, turn)
            : rotation_frame(c, "poses", poses, o->rotations, whole_joints, 0, n == 72 ? 24 : 22, turn);
    const value *turned = value_get(person, "Rh") ? value_get(person, "Rh") : value_get(person, "R");
    if (!status && turned)
        status = rotation_frame(c, "Rh", turned, SHERF_ROTATIONS_AUTO, root_joint, 0, 1, &world);
    if (!status && value_get(person, "Th")) status = value_doubles(c, value_get(person, "Th"), "Th", 3, Th);
    if (status) return status;
    quaternion_multiply(world, turn[0], turn[0]);
    quaternion_rotate(world, s->skeleton.rest_m[0], J0);
    for (int a = 0; a < 3; a++) s->clip.pelvis_m[at][a] = (float)(Th[a] + J0[a] / s->unit_m);
    return SHERF_OK;
}

static sherf_status lhm_frame(context *c, const value *v, const sherf_motion_options *o, source *s, int at) {
    float(*turn)[4] = s->clip.turn[at];
    double place[3] = {0};
    sherf_status status =
        rotation_frame(c, "body_pose", value_get(v, "body_pose"), o->rotations, body_joints, 1, 23, turn);
    if (!status)
        status =
            rotation_frame(c, "root_pose", value_get(v, "root_pose"), o->rotations, root_joint, 0, 1, turn);
    if (!status && value_get(v, "trans")) status = value_doubles(c, value_get(v, "trans"), "trans", 3, place);
    for (int a = 0; a < 3 && !status; a++)
        s->clip.pelvis_m[at][a] = (float)(place[a] + s->skeleton.rest_m[0][a] / s->unit_m);
    return status;
}

/* ---- frames one by one, from a list or a folder ---- */

typedef struct {
    const sherf_motion_options *o;
    source *s;
    char name[64]; /* the person's; "" until the first was met */
    int64_t max;   /* frames that there can be */
    int count;
} taker;

/* Shapes, format and room follow from the first frame that has the person. */
static sherf_status take_first(context *c, taker *t, const value *person) {
    source *s = t->s;
    bool lhm = lhm_is(person);
    bool easymocap = value_get(person, "Rh") != NULL;
    s->format = lhm ? "LHM or ExAvatar" : easymocap ? "EasyMocap" : "SMPL poses";
    s->up = lhm ? SHERF_UP_MINUS_Y : easymocap ? SHERF_UP_Z : SHERF_UP_Y;
    s->unit_m = t->o->scale > 0 ? t->o->scale : 1;
    s->is_pelvis = true;
    const value *shapes = value_get(person, "shapes");
    sherf_status status = source_shapes(c, s, shapes ? shapes : value_get(person, "betas"));
    if (!status) status = source_frames(c, s, t->o, t->max, 30);
    return status ? status : source_numbers(c, s);
}

static sherf_status take(context *c, taker *t, const value *frame, int64_t number) {
    const value *person = person_in(frame, t->name);
    if (!person) return SHERF_OK;
    sherf_status status = t->count ? SHERF_OK : take_first(c, t, person);
    if (status) return status;
    if (t->count >= t->s->clip.frames) return failure(c, SHERF_BAD_FILE, "more frames than there were");
    t->s->number[t->count] = number;
    status = lhm_is(person) ? lhm_frame(c, person, t->o, t->s, t->count)
                            : easymocap_frame(c, person, t->o, t->s, t->count);
    t->count++;
    return status;
}

static sherf_status take_end(context *c, taker *t) {
    if (!t->count && t->o->track)
        return failure(c, SHERF_BAD_ARGUMENT, "nobody with the id '%.60s' in it", t->o->track);
    if (!t->count) return failure(c, SHERF_BAD_FILE, "no frame with a person in it");
    t->s->clip.frames = t->count; /* there is room for more */
    if (*t->name) snprintf(t->s->detail, sizeof t->s->detail, "person %.40s", t->name);
    return SHERF_OK;
}

static taker taker_of(const sherf_motion_options *o, source *s, int64_t max) {
    taker t = {.o = o, .s = s, .max = max};
    if (o->track) snprintf(t.name, sizeof t.name, "%.60s", o->track);
    return t;
}

sherf_status frame_list_read(context *c, const value *root, const sherf_motion_options *o, source *s) {
    root = frames_of(root);
    bool one = frame_is(root) && (root->kind == VALUE_DICT || person_is(value_at(root, 0)));
    /* A list of people is a frame, unless they have no names or the same one comes again: then it is a list
     * of frames. */
    if (one && root->kind == VALUE_LIST && root->list.count > 1) {
        char first[64], second[64];
        person_name(root->list.item[0], 0, first);
        person_name(root->list.item[1], 1, second);
        one = value_get(root->list.item[1], "id") && strcmp(first, second) != 0;
    }
    size_t frames = one ? 1 : root->list.count;
    taker t = taker_of(o, s, (int64_t)frames);
    sherf_status status = SHERF_OK;
    for (size_t i = 0; i < frames && !status; i++) {
        status = take(c, &t, one ? root : root->list.item[i], (int64_t)i);
        if (status) failure_prefix(c, status, "frame %zu", i);
    }
    return status ? status : take_end(c, &t);
}

/* ---- folders ---- */

typedef struct {
    int64_t number;
    char name[64];
} frame_file;

/* "000012.json", "frame_12.json": the last number in the name. -1: no JSON, or none in it. */
static int64_t frame_number(const char *name) {
    size_t n = strlen(name);
    if (n < 6 || n >= sizeof((frame_file *)0)->name || strcmp(name + n - 5, ".json")) return -1;
    size_t end = n - 5;
    while (end && (name[end - 1] < '0' || name[end - 1] > '9')) end--;
    size_t begin = end;
    while (begin && name[begin - 1] >= '0' && name[begin - 1] <= '9' && end - begin < 12) begin--;
    return end > begin ? strtoll(name + begin, NULL, 10) : -1;
}

static int by_number(const void *a, const void *b) {
    const frame_file *x = a, *y = b;
    return x->number != y->number ? (x->number > y->number) - (x->number < y->number)
                                  : strcmp(x->name, y->name);
}

static sherf_status list_folder(context *c, const char *path, frame_file **out, int *count) {
    DIR *d = opendir(path);
    int room = 0;
    sherf_status status = SHERF_OK;
    *out = NULL;
    *count = 0;
    if (!d) return failure(c, SHERF_NO_FILE, "cannot be opened");
    for (struct dirent *e; !status && (e = readdir(d));) {
        int64_t number = frame_number(e->d_name);
        if (number < 0) continue;
        if (*count == room) {
            int more = room ? 2 * room : 256;
            frame_file *grown = mem_grow(c, *out, (size_t)room, (size_t)more, sizeof *grown);
            if (grown) *out = grown, room = more;
            status = !grown                         ? SHERF_NO_MEMORY
                     : more > 4 * MOTION_FRAMES_MAX ? failure(c, SHERF_BAD_FILE, "too many files")
                                                    : status;
        }
        if (status) break;
        (*out)[*count].number = number;
        memcpy((*out)[(*count)++].name, e->d_name, strlen(e->d_name) + 1);
    }
    closedir(d);
    if (!status && !*count) status = failure(c, SHERF_BAD_FILE, "a folder without numbered .json files");
    if (!status) qsort(*out, (size_t)*count, sizeof **out, by_number);
    return status;
}

sherf_status frame_folder_read(context *c, const char *path, const sherf_motion_options *o, source *s) {
    frame_file *file;
    int count;
    sherf_status status = list_folder(c, path, &file, &count);
    taker t = taker_of(o, s, count);
    for (int i = 0; i < count && !status; i++) {
        char name[PATH_LENGTH];
        document *d = NULL;
        if (i && file[i].number == file[i - 1].number) { /* one and the same frame twice */
            status =
                failure(c, SHERF_BAD_FILE, "%s and %s have the same number", file[i - 1].name, file[i].name);
            break;
        }
        status = path_join(c, name, sizeof name, path, file[i].name);
        if (!status) status = json_read(c, name, &d);
        if (!status) {
            status = take(c, &t, d->root, file[i].number);
            if (status) failure_prefix(c, status, "%s", file[i].name);
        }
        document_free(d);
        if (!status && cancelled(c)) status = failure(c, SHERF_CANCELLED, "cancelled");
    }
    mem_free(file);
    return status ? status : take_end(c, &t);
}
