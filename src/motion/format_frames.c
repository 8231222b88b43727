/* Formats with one dict per frame. EasyMocap: [{id, Rh, Th, poses, shapes}, ...], one file per frame in a
 * folder, or one list of such lists. LHM and ExAvatar: a folder of {root_pose, body_pose, trans, betas, ...}.
 * SMPLify-X and others: a folder of pickles or npz. */
#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/path.h"
#include "motion/source.h"

static const int whole_joints[] = {24, 22, 52, 55, 53, 29, 0}, body_joints[] = {21, 23, 0},
                 root_joint[] = {1, 0};

/* ---- the contents of a frame ---- */

static bool person_is(const value *v) {
    body_parts p;
    if (!v || (v->kind != VALUE_DICT && v->kind != VALUE_RECORD)) return false;
    body_parts_find(v, &p);
    return value_numbers(p.part[PART_POSES].item) > 0 || value_numbers(p.part[PART_BODY].item) > 0;
}

/* The people of a frame: a list, or a dict with such a list under "annots". */
static const value *people_of(const value *frame) {
    const value *inner = frame && frame->kind == VALUE_DICT ? value_get(frame, "annots") : NULL;
    const value *list = inner ? inner : frame;
    return list && list->kind == VALUE_LIST ? list : NULL;
}

static bool frame_is(const value *frame) {
    const value *people = people_of(frame);
    if (person_is(frame)) return true;
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

const value *frame_list_within(const value *root) {
    const value *found = NULL;
    if (!root || root->kind != VALUE_DICT || person_is(root) || people_of(root)) return NULL;
    for (size_t i = 0; i < root->dict.count; i++) {
        const value *item = root->dict.pair[i].item;
        if (!frame_is(item)) continue;
        if (item->kind != VALUE_LIST || found) return NULL;
        found = item;
    }
    return found;
}

static void person_name(const value *person, size_t place, char out[64]) {
    const value *id = value_get(person, "id");
    snprintf(out, 64, "%zu", place);
    if (id && id->kind == VALUE_INTEGER) snprintf(out, 64, "%lld", (long long)id->integer);
    if (id && id->kind == VALUE_STRING) snprintf(out, 64, "%.60s", id->string.text);
}

/* The requested person in a frame, by name; `name` empty: the first, whose name is then stored. */
static const value *person_in(const value *frame, char name[64]) {
    if (person_is(frame)) return frame;
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

static sherf_status place_of(context *c, const named_value *n, double out[3]) {
    return n->item ? value_doubles(c, n->item, n->name, 3, out) : SHERF_OK;
}

static sherf_status turn_of(context *c, const named_value *n, float (*turn)[4]) {
    if (!n->item) return SHERF_OK;
    return rotation_frame(c, n->name, n->item, SHERF_ROTATIONS_AUTO, root_joint, 0, 1, turn);
}

static sherf_status joints_of(context *c, const body_parts *p, const sherf_motion_options *o,
                              float (*turn)[4]) {
    const named_value *part = p->part;
    const sherf_rotations rotations = rotation_said(p, o->rotations);
    const named_value *whole = &part[PART_POSES], *body = &part[PART_BODY], *root = &part[PART_ROOT];
    const named_value *rest = body->item ? body : whole;
    const int64_t n = value_numbers(rest->item);
    if (!body->item && n != 69 && n != 63)
        return rotation_frame(c, rest->name, rest->item, rotations, whole_joints, 0, source_body_joints(n),
                              turn);
    sherf_status status = rotation_frame(c, rest->name, rest->item, rotations, body_joints, 1, 23, turn);
    if (status || !root->item) return status; /* EasyMocap's poses are without the root, too */
    const sherf_rotations form = rotation_root_form(c, rest->item, root->item, 1, body_joints, rotations);
    return rotation_frame(c, root->name, root->item, form, root_joint, 0, 1, turn);
}

/* R and Th rotate and move SMPL's own space: x = R x_smpl + Th, so the pelvis, at J0 there, comes to R J0 +
 * Th. A camera stored with the body rotates and moves that: the frame's world is then the camera's. */
static sherf_status person_frame(context *c, const body_parts *all, const sherf_motion_options *o, source *s,
                                 int at) {
    float(*turn)[4] = s->clip.turn[at], world[4] = {1, 0, 0, 0}, camera[4] = {1, 0, 0, 0};
    double Th[3] = {0}, Tc[3] = {0}, pelvis[3];
    const named_value *part = all->part;
    sherf_status status = joints_of(c, all, o, turn);
    if (!status) status = turn_of(c, &part[PART_TURN], &world);
    if (!status) status = turn_of(c, &part[PART_CAMERA_TURN], &camera);
    if (!status) status = place_of(c, &part[PART_PLACE], Th);
    if (!status) status = place_of(c, &part[PART_CAMERA_PLACE], Tc);
    if (status) return status;
    quaternion_rotate(world, s->pelvis_m, pelvis);
    for (int a = 0; a < 3; a++) pelvis[a] = Th[a] + pelvis[a] / s->unit_m;
    if ((status = place_of(c, &part[PART_PELVIS], pelvis))) return status;
    quaternion_rotate(camera, pelvis, pelvis);
    for (int a = 0; a < 3; a++) s->clip.pelvis_m[at][a] = (float)(pelvis[a] + Tc[a]);
    quaternion_multiply(world, turn[0], turn[0]);
    quaternion_multiply(camera, turn[0], turn[0]);
    return SHERF_OK;
}

/* ---- frames one by one, from a list or a folder ---- */

typedef struct {
    const sherf_motion_options *o;
    source *s;
    char name[64];  /* the person's; "" until the first was met */
    int64_t max;    /* frames that there can be */
    int64_t people; /* maximum number of rows of people in one frame's arrays */
    int count;
} taker;

/* What networks say of one picture, a row a person: ROMP's, HMR 2's. Rows of other dicts are frames. */
static bool person_is_row(const body_parts *p) {
    const char *poses = p->part[PART_POSES].name, *place = p->part[PART_CAMERA_PLACE].name;
    return (poses && !strcmp(poses, "smpl_thetas")) || (place && !strncmp(place, "pred_cam_t", 10));
}

static int64_t row_wanted(const sherf_motion_options *o) {
    return o->track ? strtoll(o->track, NULL, 10) : 0;
}

/* Shapes, format and memory follow from the first frame that has the person. */
/* Of six numbers a joint, each frame shows what they are. */
static void six_say(context *c, const body_parts *p, const sherf_motion_options *o) {
    const named_value *rest = &p->part[p->part[PART_BODY].item ? PART_BODY : PART_POSES];
    if (rotation_said(p, o->rotations) ||
        (!six_joints(rest->item, whole_joints) && !six_joints(rest->item, body_joints)))
        return;
    log_line(
        c, SHERF_LOG_INFO,
        "%s: six numbers a joint, read as the first two rows or columns of the matrices, as knees and elbows "
        "bend in each frame (--rotations)",
        rest->name);
}

static sherf_status take_first(context *c, taker *t, const value *person, const body_parts *p) {
    source *s = t->s;
    const char *root = p->part[PART_ROOT].name, *place = p->part[PART_CAMERA_PLACE].name;
    const bool lhm = root && !strcmp(root, "root_pose"), easymocap = value_get(person, "Rh") != NULL,
               mesh_infos = easymocap && value_get(person, "tpose_joints");
    const char *poses = p->part[PART_POSES].name;
    const bool romp = poses && !strcmp(poses, "smpl_thetas"),
               smplify = place && !strcmp(place, "camera_translation"),
               multi = poses && !strcmp(poses, "rotvec");
    s->format = lhm          ? "LHM or ExAvatar"
                : mesh_infos ? "HumanNeRF's mesh_infos"
                : easymocap  ? "EasyMocap"
                : smplify    ? "SMPLify-X"
                : romp       ? "ROMP"
                : multi      ? "Multi-HMR"
                             : "SMPL poses";
    s->up = lhm || place || multi ? SHERF_UP_MINUS_Y : easymocap ? SHERF_UP_Z : SHERF_UP_Y;
    s->unit_m = t->o->scale > 0 ? t->o->scale : 1;
    s->is_pelvis = true;
    s->smplx = p->smplx || (!p->part[PART_BODY].item && value_numbers(p->part[PART_POSES].item) == 165);
    s->unplaced = !place && !p->part[PART_PLACE].item && !p->part[PART_PELVIS].item;
    body_parts_warn(c, person, s->format);
    six_say(c, p, t->o);
    sherf_status status = source_shapes(c, s, p->part[PART_SHAPES].item);
    if (!status) status = source_frames(c, s, t->o, t->max, 30);
    return status ? status : source_numbers(c, s);
}

static sherf_status take(context *c, taker *t, const value *frame, int64_t number) {
    const value *person = person_in(frame, t->name);
    body_parts p;
    value room[PARTS];
    if (!person) return SHERF_OK;
    body_parts_find(person, &p);
    const int64_t people = source_people(&p), row = people > 1 || person_is_row(&p) ? row_wanted(t->o) : 0;
    if (row < 0 || row >= people) return SHERF_OK; /* not in this frame */
    if (people > t->people) t->people = people;
    for (int i = 0; i < PARTS && people > 1; i++) source_take_person(&p.part[i], people, row, &room[i]);
    sherf_status status = t->count ? SHERF_OK : take_first(c, t, person, &p);
    if (status) return status;
    if (t->count >= t->s->clip.frames) return failure(c, SHERF_BAD_FILE, "more frames than there were");
    t->s->number[t->count] = number;
    status = person_frame(c, &p, t->o, t->s, t->count);
    t->count++;
    return status;
}

static sherf_status take_end(context *c, taker *t) {
    if (!t->count && t->o->track)
        return failure(c, SHERF_BAD_ARGUMENT, "nobody with the id '%.60s' in it", t->o->track);
    if (!t->count) return failure(c, SHERF_BAD_FILE, "no frame with a person in it");
    t->s->clip.frames = t->count; /* there is room for more */
    if (*t->name) snprintf(t->s->detail, sizeof t->s->detail, "person %.40s", t->name);
    if (t->people > 1)
        snprintf(t->s->detail, sizeof t->s->detail, "row %.40s of each frame's up to %lld people",
                 t->o->track ? t->o->track : "0", (long long)t->people);
    return SHERF_OK;
}

static taker taker_of(const sherf_motion_options *o, source *s, int64_t max) {
    taker t = {.o = o, .s = s, .max = max};
    if (o->track) snprintf(t.name, sizeof t.name, "%.60s", o->track);
    return t;
}

/* A list of frames, or a single one. number: of each frame; NULL: consecutive. */
static sherf_status frames_read(context *c, const value *root, bool one, const int64_t *number,
                                const sherf_motion_options *o, source *s) {
    const size_t frames = one ? 1 : root->list.count;
    taker t = taker_of(o, s, (int64_t)frames);
    sherf_status status = SHERF_OK;
    for (size_t i = 0; i < frames && !status; i++) {
        status = take(c, &t, one ? root : root->list.item[i], number ? number[i] : (int64_t)i);
        if (status) failure_prefix(c, status, "frame %zu", i);
    }
    return status ? status : take_end(c, &t);
}

bool picture_is(const value *root) {
    static const char *const names[] = {"center_confs", "center_preds", NULL};
    body_parts p;
    if (!value_first(root, names).item && !value_first(value_get(root, "results"), names).item) return false;
    body_parts_find(root, &p);
    return source_people(&p) > 1;
}

/* The frame's number that a dict holds; -1: none. */
static int64_t number_within(const value *frame) {
    static const char *const names[] = {"frame",       "frame_id",     "frame_idx",
                                        "frame_index", "frame_number", NULL};
    const value *v = value_first(frame, names).item;
    const bool one = v && v->kind == VALUE_ARRAY && value_numbers(v) == 1;
    const double number = one                             ? value_array_number(v, 0)
                          : v && v->kind == VALUE_INTEGER ? (double)v->integer
                                                          : -1;
    return number >= 0 && number < 1e9 ? (int64_t)number : -1;
}

/* A list of frames, with the numbers that they hold if these ascend. */
static sherf_status numbered_read(context *c, const value *list, const sherf_motion_options *o, source *s) {
    const size_t frames = list->list.count;
    int64_t *number = mem_alloc(c, frames, sizeof *number);
    bool ascend = number != NULL;
    if (!number) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < frames && ascend; i++) {
        number[i] = number_within(list->list.item[i]);
        ascend = number[i] >= 0 && (!i || number[i] > number[i - 1]);
    }
    const sherf_status status = frames_read(c, list, false, ascend ? number : NULL, o, s);
    mem_free(number);
    return status;
}

sherf_status frame_list_read(context *c, const value *root, const sherf_motion_options *o, source *s) {
    root = frames_of(root);
    bool one = frame_is(root) && (root->kind == VALUE_DICT || person_is(value_at(root, 0)));
    /* A list of people is a frame, unless they have no names or a name repeats: then it is a list of frames.
     */
    if (one && root->kind == VALUE_LIST && root->list.count > 1) {
        char first[64], second[64];
        person_name(root->list.item[0], 0, first);
        person_name(root->list.item[1], 1, second);
        one = value_get(root->list.item[1], "id") && strcmp(first, second) != 0;
    }
    return one ? frames_read(c, root, true, NULL, o, s) : numbered_read(c, root, o, s);
}

/* ---- dicts of dicts ---- */

/* The number that ends at `end` in the text, with `end` moved to its beginning; -1: there is none. */
static int64_t number_before(const char *name, size_t *end) {
    while (*end && (name[*end - 1] < '0' || name[*end - 1] > '9')) --*end;
    size_t begin = *end;
    while (begin && name[begin - 1] >= '0' && name[begin - 1] <= '9' && *end - begin < 12) begin--;
    const int64_t number = *end > begin ? strtoll(name + begin, NULL, 10) : -1;
    *end = begin;
    return number;
}

static const value *nested_at(const value *root, size_t i) {
    return value_unwrapped(root->kind == VALUE_LIST ? root->list.item[i] : root->dict.pair[i].item);
}

/* Rows of one of the dicts; 0: it contains no body. people: whether they are those of one picture. */
static int64_t nested_rows(const value *root, size_t i, bool *people) {
    body_parts p;
    const value *v = nested_at(root, i);
    *people = true;
    if (!frame_is(v)) return 0;
    body_parts_find(v, &p);
    const int64_t rows = source_people(&p);
    *people = rows == 1 || person_is_row(&p);
    return rows;
}

/* Whether all are frames; *bodies: how many there are. */
static bool nested_are_frames(const value *root, size_t *bodies) {
    bool frames = true, people;
    *bodies = 0;
    for (size_t i = 0; i < value_count(root); i++) {
        *bodies += nested_rows(root, i, &people) > 0;
        frames &= people;
    }
    return frames;
}

bool nested_file_is(const value *root) {
    size_t bodies;
    if (!root || (root->kind != VALUE_DICT && root->kind != VALUE_LIST) || person_is(root)) return false;
    const bool frames = nested_are_frames(root, &bodies);
    return bodies && (root->kind == VALUE_DICT || !frames); /* lists of frames are read as such */
}

/* The last number in a key; -1: none. */
static int64_t key_number(const value *key) {
    if (key->kind == VALUE_INTEGER) return key->integer;
    if (key->kind != VALUE_STRING) return -1;
    const char *point = strrchr(key->string.text, '.');
    size_t end = point ? (size_t)(point - key->string.text) : strlen(key->string.text);
    return number_before(key->string.text, &end);
}

static sherf_status nested_frames(context *c, const value *root, const sherf_motion_options *o, source *s) {
    value **frame = mem_alloc(c, root->dict.count, sizeof *frame);
    int64_t *number = mem_alloc(c, root->dict.count, sizeof *number);
    size_t n = 0;
    bool ascend = true;
    sherf_status status = SHERF_NO_MEMORY;
    if (frame && number) {
        for (size_t i = 0; i < root->dict.count; i++) {
            bool people;
            if (!nested_rows(root, i, &people)) continue;
            frame[n] = root->dict.pair[i].item;
            number[n] = key_number(root->dict.pair[i].key);
            ascend &= number[n] >= 0 && (!n || number[n] > number[n - 1]);
            n++;
        }
        const value list = {.kind = VALUE_LIST, .list = {frame, n}};
        status = frames_read(c, &list, false, ascend ? number : NULL, o, s);
    }
    mem_free(frame);
    mem_free(number);
    return status;
}

/* A dict's key, or the index in a list. */
static void nested_name(const value *root, size_t i, char out[64]) {
    const value *key = root->kind == VALUE_DICT ? root->dict.pair[i].key : NULL;
    snprintf(out, 64, "%zu", i);
    if (key && key->kind == VALUE_STRING) snprintf(out, 64, "%.60s", key->string.text);
    if (key && key->kind == VALUE_INTEGER) snprintf(out, 64, "%lld", (long long)key->integer);
}

static sherf_status nested_person(context *c, const value *root, const sherf_motion_options *o, source *s) {
    int64_t longest = 0;
    int people = 0;
    const value *taken = NULL;
    char name[64] = "";
    for (size_t i = 0; i < value_count(root); i++) {
        char own[64];
        bool picture;
        const int64_t rows = nested_rows(root, i, &picture);
        if (!rows) continue;
        people++;
        nested_name(root, i, own);
        if (o->track ? strcmp(own, o->track) != 0 : rows <= longest) continue;
        longest = rows, taken = nested_at(root, i);
        memcpy(name, own, sizeof name);
    }
    if (!taken)
        return failure(c, SHERF_BAD_ARGUMENT, "no track '%.60s' among the %d of the file",
                       o->track ? o->track : "", people);
    sherf_motion_options alone = *o;
    alone.track = NULL;
    sherf_status status = smpl_file_read(c, taken, &alone, s);
    if (!status && people > 1) snprintf(s->detail, sizeof s->detail, "track %.40s of %d", name, people);
    return status;
}

sherf_status nested_file_read(context *c, const value *root, const sherf_motion_options *o, source *s) {
    size_t bodies;
    return nested_are_frames(root, &bodies) ? nested_frames(c, root, o, s) : nested_person(c, root, o, s);
}

/* ---- folders ---- */

typedef struct {
    int64_t number, person; /* of two numbers in the name: "00012_0.npz" */
    char name[128];
} frame_file;

static bool has_kind(const char *name) {
    static const char *const kinds[] = {".json", ".npz", ".npy", ".pkl", ".pickle", ".pt"};
    for (size_t i = 0; i < COUNT_OF(kinds); i++)
        if (path_ends(name, kinds[i])) return true;
    return false;
}

/* "000012.json", "frame_12.pkl": the last number in the name, and the one before. SMPLify-X has a folder a
 * frame, with 000.pkl in it. */
static bool frame_file_of(const char *folder, const char *name, frame_file *out) {
    char path[PATH_LENGTH];
    const int n = snprintf(path, sizeof path, "%s/%s/000.pkl", folder, name);
    const bool deeper = n > 0 && n < PATH_LENGTH && *name != '.' && path_is_file(path);
    const int length = snprintf(out->name, sizeof out->name, "%s%s", name, deeper ? "/000.pkl" : "");
    if (length < 0 || (size_t)length >= sizeof out->name || (!deeper && !has_kind(name))) return false;
    size_t end = deeper ? strlen(name) : (size_t)(strrchr(name, '.') - name);
    const int64_t last = number_before(name, &end), before = number_before(name, &end);
    *out = (frame_file){.number = last, .person = before};
    snprintf(out->name, sizeof out->name, "%s%s", name, deeper ? "/000.pkl" : "");
    return last >= 0;
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
        frame_file own;
        if (!frame_file_of(path, e->d_name, &own)) continue;
        if (*count == room) {
            int more = room ? 2 * room : 256;
            frame_file *grown = mem_grow(c, *out, (size_t)room, (size_t)more, sizeof *grown);
            if (grown) *out = grown, room = more;
            status = !grown                         ? SHERF_NO_MEMORY
                     : more > 4 * MOTION_FRAMES_MAX ? failure(c, SHERF_BAD_FILE, "too many files")
                                                    : status;
        }
        if (!status) (*out)[(*count)++] = own;
    }
    closedir(d);
    if (!status && !*count)
        status = failure(c, SHERF_BAD_FILE, "a folder without numbered files (.json, .npz, .npy, .pkl, .pt)");
    if (!status) qsort(*out, (size_t)*count, sizeof **out, by_number);
    return status;
}

/* FRAME_PERSON.npz: the number before is the frame's if the last one repeats. Only the requested person is
 * kept, or else the one in most frames. */
static sherf_status take_people_apart(context *c, const sherf_motion_options *o, source *s, frame_file *file,
                                      int *count) {
    bool again = false, before = true;
    for (int i = 0; i < *count; i++) {
        again |= i && file[i].number == file[i - 1].number;
        before &= file[i].person >= 0;
    }
    if (!again || !before) return SHERF_OK;
    int64_t taken = file[0].number;
    int kept = 0, run = 0, longest = 0, people = 0; /* file is sorted by the last number, the person */
    for (int i = 0; i < *count; i++) {
        run = i && file[i].number == file[i - 1].number ? run + 1 : 1;
        people += run == 1;
        if (run > longest) longest = run, taken = file[i].number;
    }
    if (o->track) taken = strtoll(o->track, NULL, 10);
    for (int i = 0; i < *count; i++)
        if (file[i].number == taken) file[kept] = file[i], file[kept++].number = file[i].person;
    if (!kept)
        return failure(c, SHERF_BAD_ARGUMENT, "no track '%.60s' among the %d of the folder", o->track,
                       people);
    snprintf(s->detail, sizeof s->detail, "track %lld of %d", (long long)taken, people);
    *count = kept;
    qsort(file, (size_t)kept, sizeof *file, by_number);
    return SHERF_OK;
}

sherf_status frame_folder_read(context *c, const char *path, const sherf_motion_options *o, source *s) {
    frame_file *file;
    int count;
    sherf_status status = list_folder(c, path, &file, &count);
    if (!status) status = take_people_apart(c, o, s, file, &count);
    const bool apart = *s->detail;
    sherf_motion_options own = *o;
    if (apart) own.track = NULL; /* done with */
    taker t = taker_of(&own, s, count);
    for (int i = 0; i < count && !status; i++) {
        char name[PATH_LENGTH];
        document *d = NULL;
        if (i && file[i].number == file[i - 1].number) { /* one and the same frame twice */
            status =
                failure(c, SHERF_BAD_FILE, "%s and %s have the same number", file[i - 1].name, file[i].name);
            break;
        }
        status = path_join(c, name, sizeof name, path, file[i].name);
        if (!status) status = document_read(c, name, &d, NULL);
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
