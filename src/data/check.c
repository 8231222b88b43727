/* Finds errors in a body file, an observation or a data set, with one line for each finding. A file that
 * cannot be read is a finding, not a failure; the only failures are out of memory, cancelling and writing the
 * overlay. */
#include <math.h>
#include <string.h>

#include "data/alike.h"
#include "data/dataset.h"
#include "data/silhouette.h"
#include "data/text.h"

enum { SAME_KIND_MAX = 20 }; /* findings of one kind that are written out */

typedef enum { NOTE, WARNING, FINDING_ERROR } severity;
typedef struct {
    context *c;
    const body_model *body; /* may be NULL */
    const char *overlay;    /* may be NULL; emptied once written */
    sherf_findings *out;
    text_builder text;
    alike_lines lines; /* of a data set's people, before they are written to the text */
    const char *name;  /* of the person in work; NULL: none */
    int person;
    bool pictured;          /* lines are about a picture, and stay apart */
    sherf_log_function log; /* the context's own, with its user */
    sherf_progress_function progress;
    void *user;
} checker;

/* True: a line of its own, not one that was said of another person. */
static bool PRINTF_LIKE(3, 4) finding(checker *k, severity s, const char *format, ...) {
    static const char *const names[] = {"", "warning: ", "error: "};
    text_builder own = {.c = k->c}, *line = k->name ? &own : &k->text;
    va_list args;
    va_start(args, format);
    text_add(line, "%s", names[s]);
    text_add_list(line, format, args);
    va_end(args);
    k->out->errors += s == FINDING_ERROR;
    k->out->warnings += s == WARNING;
    if (k->name) return alike_add(&k->lines, text_take(line), k->name, k->person, !k->pictured);
    text_add(line, "\n");
    return true;
}

/* A failed read becomes an error finding; out of memory stays a failure. */
static sherf_status finding_of(checker *k, sherf_status status) {
    if (status == SHERF_NO_MEMORY || status == SHERF_CANCELLED || status == SHERF_OK) return status;
    finding(k, FINDING_ERROR, "%s", k->c->message);
    return SHERF_OK;
}

/* ---- cameras ---- */

static void check_camera(checker *k, const char *what, const double K[9], const double T[3], int width,
                         int height) {
    double distance = sqrt(T[0] * T[0] + T[1] * T[1] + T[2] * T[2]);
    if (distance > 100)
        finding(k, FINDING_ERROR, "%s: T is %.0f long: metres are expected, these look like %s", what,
                distance, distance > 1000 ? "millimetres" : "centimetres");
    if (!width) return;
    if (K[2] < 0 || K[2] > width || K[5] < 0 || K[5] > height)
        finding(k, WARNING,
                "%s: the centre (%.0f, %.0f) lies outside the picture of %d x %d pixels: is K for "
                "another size?",
                what, K[2], K[5], width, height);
    else if (fabs(K[2] - width / 2.) > 0.3 * width || fabs(K[5] - height / 2.) > 0.3 * height)
        finding(k, WARNING,
                "%s: the centre (%.0f, %.0f) is far from the middle of %d x %d pixels: is K for "
                "another size?",
                what, K[2], K[5], width, height);
    double longer = width > height ? width : height;
    if (K[0] < 0 || K[4] < 0) finding(k, WARNING, "%s: a negative focal length mirrors the picture", what);
    if (fabs(K[0]) < 0.2 * longer || fabs(K[0]) > 30 * longer)
        finding(k, WARNING, "%s: a focal length of %.0f pixels for a picture of %d x %d", what, K[0], width,
                height);
}

/* ---- the body over the mask ---- */

static void mirrored_pose(const sherf_pose *in, sherf_pose *out) {
    static const int left[] = {1, 4, 7, 10, 13, 16, 18, 20, 22}, right[] = {2, 5, 8, 11, 14, 17, 19, 21, 23};
    *out = *in;
    for (size_t i = 0; i < COUNT_OF(left); i++)
        for (int a = 0; a < 3; a++) {
            out->poses_rad[left[i] * 3 + a] = in->poses_rad[right[i] * 3 + a];
            out->poses_rad[right[i] * 3 + a] = in->poses_rad[left[i] * 3 + a];
        }
    for (int j = 0; j < BODY_JOINTS; j++)
        for (int a = 1; a < 3; a++) out->poses_rad[j * 3 + a] *= -1;
}

/* x = R^T (x' - T): the camera, if R and T are actually camera to world. */
static void inverted_camera(const sherf_camera *in, sherf_camera *out) {
    *out = *in;
    for (int i = 0; i < 3; i++) {
        double sum = 0;
        for (int j = 0; j < 3; j++) {
            out->R[i * 3 + j] = in->R[j * 3 + i];
            sum += (double)in->R[j * 3 + i] * in->T_m[j];
        }
        out->T_m[i] = (float)-sum;
    }
}

/* K for another size of the same picture: moves its centre to the middle. */
static void rescaled_camera(sherf_camera *camera) {
    const float scale = camera->K[2] > 0 ? (float)camera->width_px / 2 / camera->K[2] : 1;
    for (int i = 0; i < 6; i++) camera->K[i] *= scale;
}

static void transposed_camera(const sherf_camera *in, sherf_camera *out) {
    *out = *in;
    for (int i = 0; i < 9; i++) out->R[i] = in->R[i % 3 * 3 + i / 3];
}

/* T is the camera's place: x_camera = R (x - T). */
static void centred_camera(const sherf_camera *in, sherf_camera *out) {
    *out = *in;
    for (int i = 0; i < 3; i++) {
        double sum = 0;
        for (int j = 0; j < 3; j++) sum += (double)in->R[3 * i + j] * in->T_m[j];
        out->T_m[i] = (float)-sum;
    }
}

typedef enum {
    MILLIMETRES,
    METRES,
    TO_WORLD,
    TRANSPOSED,
    CENTRE,
    OPENGL,
    TH_MILLIMETRES,
    TH_CENTIMETRES,
    RESCALED,
    MIRRORED_POSE,
    MIRRORED_PICTURE,
    INVERTED_MASK,
    EXPLANATIONS
} explanation;
static const char *const explanation_says[EXPLANATIONS] = {
    "the camera's T in metres (are these millimetres?)",
    "the camera's T times 1000 (are these metres, where the layout has millimetres?)",
    "R and T inverted (are these camera to world? world to camera is expected)",
    "R transposed (is it camera to world, beside a T that is not?)",
    "T taken for the camera's place (world to camera is expected: T = -R place)",
    "y and z of the camera turned round (OpenGL axes? OpenCV's are expected)",
    "Th in metres (are these millimetres?)",
    "Th in metres (are these centimetres?)",
    "K scaled to the picture (is it for another size?)",
    "left and right of the pose exchanged",
    "the picture mirrored",
    "the mask inverted (is it black where the person is?)",
};

/* The overlap if the mistake were corrected. */
static sherf_status explained_overlap(checker *k, const sherf_observation *o, explanation e,
                                      double *overlap) {
    sherf_camera camera = o->camera;
    sherf_pose pose = o->pose;
    if (e == TO_WORLD) inverted_camera(&o->camera, &camera);
    if (e == TRANSPOSED) transposed_camera(&o->camera, &camera);
    if (e == CENTRE) centred_camera(&o->camera, &camera);
    if (e == RESCALED) rescaled_camera(&camera);
    if (e == MIRRORED_POSE) mirrored_pose(&o->pose, &pose);
    for (int i = 0; i < 3; i++) {
        if (e == MILLIMETRES) camera.T_m[i] /= 1000;
        if (e == METRES) camera.T_m[i] *= 1000;
        if (e == TH_MILLIMETRES) pose.Th_m[i] /= 1000;
        if (e == TH_CENTIMETRES) pose.Th_m[i] /= 100;
    }
    for (int i = 1; i < 3 && e == OPENGL; i++) {
        camera.T_m[i] *= -1;
        for (int j = 0; j < 3; j++) camera.R[i * 3 + j] *= -1;
    }
    const mask_reading reading = e == MIRRORED_PICTURE ? MASK_MIRRORED
                                 : e == INVERTED_MASK  ? MASK_INVERTED
                                                       : MASK_AS_IT_IS;
    return silhouette_overlap(k->c, o, k->body, &pose, &camera, reading, overlap);
}

static double mask_share(const sherf_observation *o) {
    const size_t n = (size_t)o->image.width * o->image.height;
    size_t person = 0;
    for (size_t i = 0; i < n; i++) person += o->mask[i] != 0;
    return (double)person / (double)n;
}

/* If the body misses the mask: would a usual mistake explain it? A body very close to the camera covers any
 * mask that is nearly everything, so for a large mask inversion is tested first. */
static sherf_status explain_miss(checker *k, const char *what, const sherf_observation *o, double overlap) {
    double best = overlap + 0.15, now = 0;
    int which = -1;
    sherf_status status = SHERF_OK;
    if (mask_share(o) > 0.5) status = explained_overlap(k, o, INVERTED_MASK, &now);
    if (now > 0.6) best = now, which = INVERTED_MASK;
    for (int e = 0; e < INVERTED_MASK && which != INVERTED_MASK && !status; e++) {
        status = explained_overlap(k, o, (explanation)e, &now);
        if (now > best) best = now, which = e;
    }
    if (which >= 0 && !status)
        finding(k, NOTE, "%s: with %s the body would cover the mask to %.0f %%", what,
                explanation_says[which], best * 100);
    return status;
}

/* aside: one of several views; a good result then gets no line and no drawing. */
static sherf_status check_view(checker *k, const char *what, const sherf_observation *o, bool aside) {
    size_t n = (size_t)o->image.width * o->image.height, person = 0, lit = 0;
    for (size_t i = 0; i < n; i++) {
        person += o->mask[i] != 0;
        const float *p = o->image.data + i * 3;
        lit += p[0] > 0.02f || p[1] > 0.02f || p[2] > 0.02f;
    }
    if (person * 100 < n)
        finding(k, WARNING, "%s: the person fills only %.2f %% of the picture", what, 100. * person / n);
    if (lit * 4 < person) finding(k, WARNING, "%s: the picture is nearly black inside the mask", what);
    if (!k->body) return SHERF_OK;
    double overlap;
    sherf_status status = silhouette_overlap(k->c, o, k->body, &o->pose, &o->camera, MASK_AS_IT_IS, &overlap);
    if (status) return finding_of(k, failure_prefix(k->c, status, "%s", what));
    severity s = overlap < 0.3 ? FINDING_ERROR : overlap < 0.6 ? WARNING : NOTE;
    if (s == NOTE && aside) return SHERF_OK;
    finding(k, s,
            s == NOTE ? "%s: the body covers the mask (overlap %.0f %%)"
                      : "%s: the body does not cover the mask (overlap %.0f %%)",
            what, overlap * 100);
    if (s != NOTE) status = explain_miss(k, what, o, overlap);
    if (!status && k->overlay && !aside) {
        status = silhouette_draw(k->c, o, k->body, k->overlay);
        if (!status) finding(k, NOTE, "%s: the body is drawn over the picture of %s", k->overlay, what);
        k->overlay = NULL;
    }
    return status;
}

static sherf_status check_observation(checker *k, const char *path) {
    sherf_observation *o = NULL;
    sherf_status status = sherf_observation_load(k->c, path, &o);
    if (status) return finding_of(k, status);
    double K[9], T[3];
    for (int i = 0; i < 9; i++) K[i] = o->camera.K[i];
    for (int i = 0; i < 3; i++) T[i] = o->camera.T_m[i];
    finding(k, NOTE, "%s: an observation of %d x %d pixels", path, o->image.width, o->image.height);
    check_camera(k, "camera", K, T, o->image.width, o->image.height);
    for (int i = 0; i < 10; i++)
        if (fabsf(o->pose.shapes[i]) > 6) {
            finding(k, WARNING, "body: shape %d is %.1f, people lie within 5 or so", i, o->pose.shapes[i]);
            break;
        }
    status = check_view(k, path, o, false);
    sherf_observation_free(o);
    return status;
}

/* ---- body files ---- */

static sherf_status check_body_file(checker *k, const char *path) {
    body_model *body = NULL;
    posed_body *posed = NULL;
    sherf_pose rest;
    sherf_status status = body_load(k->c, path, &body);
    if (status) return finding_of(k, status);
    sherf_pose_identity(&rest);
    status = posed_body_create(k->c, body, rest.poses_rad, rest.shapes, rest.R, rest.Th_m, &posed);
    if (!status) {
        finding(k, NOTE, "%s: a body of %d vertices, %d faces, 24 joints", path, body->vertices, body->faces);
        float size[3];
        for (int i = 0; i < 3; i++) size[i] = posed->max_smpl[i] - posed->min_smpl[i];
        float tall = fmaxf(size[0], fmaxf(size[1], size[2]));
        if (tall < 0.5f || tall > 3)
            finding(k, FINDING_ERROR, "the body is %.3g tall: metres are expected", tall);
        if (size[1] < size[2]) finding(k, WARNING, "the body does not stand along y");
        if (posed->joints_rest[1][0] < posed->joints_rest[2][0])
            finding(k, WARNING,
                    "joint 1, the left hip, lies to the right of joint 2: are left and right "
                    "exchanged?");
        int bad = 0;
        for (int j = 0; j < BODY_JOINTS; j++) {
            double sum = 0;
            for (int i = 0; i < body->vertices; i++) sum += body->regressor[(size_t)j * body->vertices + i];
            bad += fabs(sum - 1) > 1e-2;
        }
        if (bad) finding(k, WARNING, "J_regressor: the rows of %d joints do not sum to 1", bad);
        if (!body->faces) finding(k, WARNING, "f: no faces, so nothing can face a camera");
    }
    posed_body_free(posed);
    sherf_body_free(body);
    return status;
}

/* ---- data sets ---- */

/* Lines of a kind, and files that have none because there would be too many. */
typedef struct {
    int lines, more;
} missing_count;
typedef struct {
    missing_count pictures, masks, poses;
    int bad_vertices;
} dataset_count;

static void missing(checker *k, missing_count *n, const char *what, const char *path) {
    if (n->lines < SAME_KIND_MAX)
        n->lines += finding(k, FINDING_ERROR, "%s: %s is missing", path, what);
    else
        n->more++, k->out->errors++;
}

/* Checks every file that the person's records name. */
static sherf_status check_files(checker *k, const sherf_dataset *d, int person, const person_record *r,
                                dataset_count *n) {
    char image[PATH_LENGTH], other[PATH_LENGTH];
    sherf_status status;
    for (int pose = 0; pose < r->poses; pose++) {
        if (r->present && !r->present[pose]) continue;
        if ((status = dataset_pose_paths(k->c, d, person, pose, image, other))) return status;
        if (!path_is_file(image)) missing(k, &n->poses, "the pose", image);
        for (int view = 0; view < r->views; view++) {
            status = dataset_picture_paths(k->c, d, person, pose, view, image, other);
            if (status == SHERF_BAD_FILE) {
                missing(k, &n->pictures, "a view", k->c->message);
                continue;
            }
            if (status) return status;
            if (!path_is_file(image)) missing(k, &n->pictures, "the picture", image);
            if (!path_is_file(other)) missing(k, &n->masks, "the mask", other);
        }
        if (cancelled(k->c)) return failure(k->c, SHERF_CANCELLED, "cancelled");
    }
    return SHERF_OK;
}

/* Checks sizes, cameras and masks of every view, by one pose's files. */
static sherf_status check_views(checker *k, const sherf_dataset *d, int person, int pose,
                                const person_record *r) {
    char image[PATH_LENGTH], mask[PATH_LENGTH], what[1200];
    for (int view = 0; view < r->views; view++) {
        int size[2] = {0}, mask_size[2] = {0}, channels;
        snprintf(what, sizeof what, "%.1000s, view %d", d->name[person], view);
        sherf_status status = dataset_picture_paths(k->c, d, person, pose, view, image, mask);
        bool there = !status && path_is_file(image) && path_is_file(mask);
        if (there && !(status = image_size(k->c, image, &size[0], &size[1], &channels)))
            status = image_size(k->c, mask, &mask_size[0], &mask_size[1], &channels);
        if (there && status) {
            if ((status = finding_of(k, status))) return status;
            continue;
        }
        if (there && (size[0] != mask_size[0] || size[1] != mask_size[1]))
            finding(k, FINDING_ERROR, "%s: a mask of %d x %d pixels for a picture of %d x %d", mask,
                    mask_size[0], mask_size[1], size[0], size[1]);
        else if (there && (status = finding_of(k, dataset_mask_check(k->c, d, person, pose, view))))
            return status;
        check_camera(k, what, r->camera[view].K, r->camera[view].T, size[0], size[1]);
    }
    return SHERF_OK;
}

/* Compares new_vertices/N.npy with the body model in the stored pose. */
static sherf_status check_vertices(checker *k, const sherf_dataset *d, int person, int pose,
                                   const sherf_pose *p, dataset_count *n) {
    char parameters[PATH_LENGTH], path[PATH_LENGTH];
    document *doc = NULL;
    posed_body *posed = NULL;
    size_t count = (size_t)k->body->vertices * 3;
    float *ours = NULL, *theirs = NULL;
    sherf_status status = dataset_pose_paths(k->c, d, person, pose, parameters, path);
    if (status || !path[0] || !path_is_file(path)) return status;
    ours = mem_alloc(k->c, count, sizeof *ours);
    theirs = mem_alloc(k->c, count, sizeof *theirs);
    status = SHERF_NO_MEMORY;
    if (!ours || !theirs) goto done;
    status = npy_read(k->c, path, &doc);
    if (!status) status = value_floats(k->c, doc->root, path, count, theirs);
    if (status) {
        status = finding_of(k, status);
        goto done;
    }
    status = posed_body_create(k->c, k->body, p->poses_rad, p->shapes, p->R, p->Th_m, &posed);
    if (status) {
        status = finding_of(k, failure_prefix(k->c, status, "%s", parameters));
        goto done;
    }
    body_vertices_world(k->body, posed, ours);
    double worst = 0;
    for (size_t i = 0; i < count; i++) worst = fmax(worst, fabs((double)ours[i] - theirs[i]));
    if (worst > 5e-3 && n->bad_vertices < SAME_KIND_MAX)
        n->bad_vertices +=
            finding(k, WARNING,
                    "%s: up to %.3g m away from the body in the stored pose: another body model (gender, "
                    "version), or other conventions",
                    path, worst);
done:
    document_free(doc);
    posed_body_free(posed);
    mem_free(ours);
    mem_free(theirs);
    return status;
}

/* The body's overlap with the mask in one picture. */
static sherf_status check_overlap(checker *k, const sherf_dataset *d, int person, int pose, int view,
                                  bool aside) {
    data_view *v = NULL;
    char what[1200];
    sherf_status status = dataset_view(k->c, d, person, pose, view, 0, &v);
    if (status) return finding_of(k, status);
    snprintf(what, sizeof what, "%.1000s, pose %d, view %d", d->name[person], pose, view);
    status = observation_check(k->c, v);
    k->pictured = true;
    status = status ? finding_of(k, failure_prefix(k->c, status, "%s", what)) : check_view(k, what, v, aside);
    k->pictured = false;
    sherf_observation_free(v);
    return status;
}

/* Checks views other than the front one, and poses other than the first: a camera may be wrong, or pictures
 * and poses may not belong together. With few people it checks all views, with many a spread selection. */
static sherf_status check_others(checker *k, const sherf_dataset *d, int person, const person_record *r,
                                 int first, int front) {
    enum { FEW_PEOPLE = 5, SOME_VIEWS = 4, SOME_POSES = 3 };
    const int others = r->views - 1,
              some = d->people > FEW_PEOPLE && others > SOME_VIEWS ? SOME_VIEWS : others;
    const int faults = k->out->errors + k->out->warnings;
    int poses = 0, last = first;
    char views[40], also[40];
    sherf_status status = SHERF_OK;
    for (int i = 1; i <= some && !status; i++)
        status = check_overlap(k, d, person, first,
                               (front + (some == others ? i : i * r->views / (some + 1))) % r->views, true);
    for (int i = 1; i <= SOME_POSES && !status; i++) {
        int pose = first + (int)((int64_t)(r->poses - 1 - first) * i / SOME_POSES);
        while (r->present && pose > last && !r->present[pose]) pose--;
        if (pose <= last) continue;
        status = check_overlap(k, d, person, pose, front, true);
        last = pose, poses++;
    }
    snprintf(views, sizeof views, "%d other view%s", some, some == 1 ? "" : "s");
    snprintf(also, sizeof also, "%d other pose%s", poses, poses == 1 ? "" : "s");
    k->pictured = true; /* goes on from the line about the front view */
    if (!status && k->body && some + poses && k->out->errors + k->out->warnings == faults)
        finding(k, NOTE, "%s: and so it does in %s%s%s", d->name[person], some ? views : "",
                some && poses ? " and " : "", poses ? also : "");
    k->pictured = false;
    return status;
}

static sherf_status check_person(checker *k, const sherf_dataset *d, int person, dataset_count *n) {
    const person_record *r;
    sherf_pose pose;
    const data_protocol *protocol = dataset_protocol(d);
    sherf_status status = dataset_record(k->c, d, person, &r);
    if (status) return finding_of(k, status);
    int first = 0, errors = k->out->errors, front = protocol_front(protocol, r->views);
    while (r->present && first + 1 < r->poses && !r->present[first]) first++;
    if (r->views < protocol->views)
        finding(k, WARNING, "%s: %d views, the paper uses %d", d->name[person], r->views, protocol->views);
    if ((status = check_files(k, d, person, r, n)) || (status = check_views(k, d, person, first, r)))
        return status;
    if (k->out->errors > errors) return SHERF_OK; /* already reported */
    if ((status = dataset_pose(k->c, d, person, first, &pose))) return finding_of(k, status);
    const int faults = k->out->errors + k->out->warnings;
    status = check_overlap(k, d, person, first, front, false);
    if (!status && k->out->errors + k->out->warnings == faults)
        status = check_others(k, d, person, r, first, front);
    if (!status && k->body) status = check_vertices(k, d, person, first, &pose, n);
    return status;
}

static sherf_status check_dataset(checker *k, const char *spec) {
    sherf_dataset *d = NULL;
    dataset_count n = {0};
    sherf_status status = sherf_dataset_open(k->c, spec, &d);
    if (status) return finding_of(k, status);
    finding(k, NOTE, "%s: %s, %d %s", d->root, dataset_protocol(d)->name, d->people,
            d->people == 1 ? "person" : "people");
    for (int i = 0; i < d->people && !status; i++) {
        k->name = d->name[i], k->person = i;
        status = check_person(k, d, i, &n);
        if (!status) status = progress(k->c, "people", i + 1, d->people);
    }
    k->name = NULL;
    alike_write(&k->lines, &k->text);
    const int more = n.pictures.more + n.masks.more + n.poses.more;
    if (more) finding(k, NOTE, "%s: %d more files are missing", d->root, more);
    sherf_dataset_free(d);
    return status;
}

/* ---- which of the three ---- */

static bool is_dataset(const char *path) {
    context quiet = {.threads = 1};
    sherf_dataset *d = NULL;
    bool is = sherf_dataset_open(&quiet, path, &d) == SHERF_OK;
    sherf_dataset_free(d);
    return is;
}

static sherf_status check_any(checker *k, const char *path) {
    bool file = path_is_file(path), folder = path_is_folder(path);
    const char *root;
    if (file && !path_ends(path, ".json")) return check_body_file(k, path);
    if (!file && !folder && strchr(path, '#')) return check_observation(k, path);
    if (!file && dataset_reader_named(path, &root)) return check_dataset(k, path);
    if (folder && is_dataset(path)) return check_dataset(k, path);
    return check_observation(k, path);
}

/* Readers' warnings become findings. */
static void on_log(void *user, sherf_log_level level, const char *text) {
    checker *k = user;
    if (level == SHERF_LOG_WARNING)
        finding(k, WARNING, "%s", text);
    else if (k->log)
        k->log(k->user, level, text);
}

static void on_progress(void *user, const char *text, double done, double total) {
    checker *k = user;
    if (k->progress) k->progress(k->user, text, done, total);
}

static sherf_status check_listening(checker *k, const char *path) {
    context *c = k->c;
    k->log = c->log, k->progress = c->progress, k->user = c->user;
    c->log = on_log, c->progress = on_progress, c->user = k;
    sherf_status status = check_any(k, path);
    c->log = k->log, c->progress = k->progress, c->user = k->user;
    return status;
}

sherf_status sherf_check(sherf_context *c, const char *path, const sherf_body *body, const char *overlay_png,
                         sherf_findings *out) {
    *out = (sherf_findings){0};
    checker k = {
        .c = c, .body = body, .overlay = overlay_png, .out = out, .text = {.c = c}, .lines = {.c = c}};
    if (overlay_png && !body)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: an overlay needs a body", overlay_png);
    sherf_status status = check_listening(&k, path);
    if (!status && k.overlay)
        finding(&k, NOTE, "%s: not written, there is no picture to draw over", k.overlay);
    out->text = text_take(&k.text);
    if (!status && !out->text) status = SHERF_NO_MEMORY;
    if (status) {
        mem_free(out->text);
        *out = (sherf_findings){0};
    }
    return status;
}
