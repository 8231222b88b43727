/* Dicts of arrays with a row a frame: AMASS of SMPL+H and SMPL-X, AIST++, GVHMR, plain SMPL poses. */
#include <stdio.h>
#include <string.h>

#include "motion/source.h"

/* Joints that SMPL, SMPL+H and SMPL-X files tell; the first 22 are the same in all of them. */
static const int whole_joints[] = {24, 22, 52, 55, 0}, body_joints[] = {23, 21, 0}, root_joint[] = {1, 0};

static const value *first_of(const value *v, const char *const *names) {
    const value *found = NULL;
    for (; *names && !found; names++) found = value_get(v, *names);
    return found;
}

static const char *const whole_names[] = {"poses", "pose", "smpl_poses", NULL};
static const char *const body_names[] = {"pose_body", "body_pose", NULL};
static const char *const root_names[] = {"root_orient", "global_orient", "root_pose", NULL};
static const char *const trans_names[] = {"trans", "transl", "smpl_trans", "Th", NULL};
static const char *const shape_names[] = {"betas", "shapes", NULL};
static const char *const rate_names[] = {"mocap_framerate", "mocap_frame_rate", "fps", "frame_rate", NULL};

/* A one-element list (a 0-d object array) stands for its element. */
static const value *unwrapped(const value *v) {
    for (int depth = 0; v && v->kind == VALUE_LIST && v->list.count == 1 && depth < 4; depth++)
        v = v->list.item[0];
    return v;
}

/* GVHMR's own, in a dict, or with the dict's name before the keys. */
static const value *gvhmr_params(const value *root) {
    return unwrapped(value_get(root, "smpl_params_global"));
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

bool smpl_file_is(const value *root) {
    return first_of(root, whole_names) || first_of(root, body_names) || gvhmr_params(root) ||
           get_prefixed(root, "body_pose");
}

typedef struct {
    const value *whole, *body, *root, *trans, *shapes, *rate, *scaling;
} parts;

static void find_parts(const value *v, parts *p) {
    const value *inner = gvhmr_params(v);
    if (!inner && get_prefixed(v, "body_pose")) {
        *p = (parts){.body = get_prefixed(v, "body_pose"),
                     .root = get_prefixed(v, "global_orient"),
                     .trans = get_prefixed(v, "transl"),
                     .shapes = get_prefixed(v, "betas")};
        return;
    }
    v = inner ? inner : v;
    *p = (parts){first_of(v, whole_names),    first_of(v, body_names),  first_of(v, root_names),
                 first_of(v, trans_names),    first_of(v, shape_names), first_of(v, rate_names),
                 value_get(v, "smpl_scaling")};
    if (p->body) p->whole = NULL;
}

/* Rows of `numbers` numbers: an array's first axis, or 1 where it has none. */
static int64_t row_count(const value *v) {
    int64_t rows = parse_rows(v), n = value_numbers(v);
    if (n < 1 || rows < 1) return n < 1 ? 0 : 1;
    if (v->kind == VALUE_ARRAY) return v->array.rank > 1 ? rows : 1;
    return value_numbers(v->list.item[0]) >= 0 ? rows : 1;
}

/* What is usual where the keys are those of a known source. */
static void recognise(const value *root, const parts *p, int64_t numbers, source *s, double *fps) {
    s->format = "SMPL poses";
    s->up = SHERF_UP_Y;
    *fps = 30;
    if (value_get(root, "smpl_poses")) {
        s->format = "AIST++";
        s->unit_m = 1;
        *fps = 60;
    } else if (gvhmr_params(root) || get_prefixed(root, "body_pose")) {
        s->format = "GVHMR";
        s->unit_m = 1;
    } else if (p->rate || value_get(root, "gender")) {
        s->up = SHERF_UP_Z;
        s->format = numbers == 156                 ? "AMASS, SMPL+H"
                    : numbers == 165               ? "AMASS, SMPL-X"
                    : value_get(root, "pose_body") ? "AMASS, SMPL-X by parts"
                                                   : "AMASS, SMPL";
    }
}

/* What the options say counts more, and helps where the file talks nonsense. */
static sherf_status read_rate(context *c, const parts *p, const sherf_motion_options *o, double *fps,
                              bool *said) {
    if (!p->rate || o->source_fps > 0) return SHERF_OK;
    double rate;
    sherf_status status = value_doubles(c, p->rate, "frame rate", 1, &rate);
    if (!status && !(rate >= 0.01 && rate <= 10000))
        status =
            failure(c, SHERF_BAD_FILE, "frame rate: %g a second, must be 0.01 to 10000; give another", rate);
    if (!status) *fps = rate, *said = true;
    return status;
}

static sherf_status read_places(context *c, const value *trans, clip *k) {
    int64_t rows = row_count(trans), n = value_numbers(trans);
    if (rows != k->frames || n != 3 * (int64_t)k->frames)
        return failure(c, SHERF_BAD_FILE, "translations: %lld numbers for %d frames, not three each",
                       (long long)n, k->frames);
    for (int i = 0; i < k->frames; i++) {
        double place[3];
        sherf_status status = k->frames == 1 ? value_doubles(c, trans, "translation", 3, place)
                                             : parse_row(c, trans, (size_t)i, "translation", 3, place);
        if (status) return status;
        for (int a = 0; a < 3; a++) k->pelvis_m[i][a] = (float)place[a];
    }
    return SHERF_OK;
}

sherf_status smpl_file_read(context *c, const value *root, const sherf_motion_options *o, source *s) {
    parts p;
    double fps;
    find_parts(root, &p);
    const value *rows = p.whole ? p.whole : p.body;
    int64_t frames = row_count(rows);
    if (frames < 1) return failure(c, SHERF_BAD_FILE, "poses: no rows of numbers");
    recognise(root, &p, value_numbers(rows) / frames, s, &fps);
    sherf_status status = source_shapes(c, s, p.shapes);
    if (!status) status = read_rate(c, &p, o, &fps, &s->fps_said);
    if (!status) status = source_frames(c, s, o, frames, fps);
    if (!status && p.whole)
        status = rotation_rows(c, "poses", p.whole, o->rotations, whole_joints, 0, 22, &s->clip);
    if (!status && p.whole && value_numbers(p.whole) % (24 * frames) == 0) /* SMPL's own hands */
        status = rotation_rows(c, "poses", p.whole, o->rotations, whole_joints, 0, 24, &s->clip);
    if (!status && p.body)
        status = rotation_rows(c, "body_pose", p.body, o->rotations, body_joints, 1, 23, &s->clip);
    if (!status && p.body && p.root)
        status = rotation_rows(c, "global_orient", p.root, o->rotations, root_joint, 0, 1, &s->clip);
    if (!status && p.trans) status = read_places(c, p.trans, &s->clip);
    if (!status && p.scaling) { /* AIST++: its vertices are SMPL's times the scaling plus the translation */
        double scaling;
        status = value_doubles(c, p.scaling, "smpl_scaling", 1, &scaling);
        if (!status && !(scaling > 1e-6 && scaling < 1e6))
            status = failure(c, SHERF_BAD_FILE, "smpl_scaling is %g", scaling);
        if (!status) s->unit_m = 1 / scaling;
    }
    return status;
}
