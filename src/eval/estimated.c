/* Maps the true world to an estimate's, and computes the estimates' errors. */
#include "eval/estimated.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* ---- observations ---- */

sherf_status estimate_by_photo(context *c, void *state, const sherf_image *photo,
                               const sherf_observation *truth, sherf_observation **out) {
    const photo_estimator *e = state;
    sherf_estimate *found = NULL;
    *out = NULL;
    sherf_status status = sherf_estimate_picture(c, e->networks, e->body, photo, NULL, NULL, &found);
    if (status == SHERF_MISMATCH) return SHERF_OK; /* nobody was found */
    if (!status) status = sherf_estimate_observation(c, found, out);
    sherf_estimate_free(found);
    return status;
}

sherf_status estimated_observation(context *c, const eval_estimator *e, const sherf_dataset *d, int person,
                                   int pose, int view, const sherf_observation *truth,
                                   sherf_observation **out) {
    sherf_image photo = {0};
    *out = NULL;
    sherf_status status = dataset_photo(c, d, person, pose, view, 0, &photo);
    if (status == SHERF_OK) status = e->estimate(c, e->state, &photo, truth, out);
    if (status == SHERF_OK && *out)
        status = observation_resize(c, *out, truth->image.width, truth->image.height);
    sherf_image_free(&photo);
    if (status == SHERF_OK) return status;
    sherf_observation_free(*out);
    *out = NULL;
    return status;
}

/* ---- carrying over ---- */

/* How many metres a pixel of the observed picture is at the pelvis, along x. */
static double metres_a_pixel(const sherf_camera *k, const double pelvis[3]) {
    double z = (double)k->T_m[2];
    for (int i = 0; i < 3; i++) z += (double)k->R[6 + i] * pelvis[i];
    return z / (double)k->K[0];
}

/* In the world; joints alone. */
static sherf_status joints_world(context *c, const body_model *body, const sherf_pose *p,
                                 double out[BODY_JOINTS][3]) {
    posed_body *posed = NULL;
    sherf_status status = posed_joints_create(c, body, p->poses_rad, p->shapes, p->R, p->Th_m, &posed);
    if (status) return status;
    for (int j = 0; j < BODY_JOINTS; j++)
        for (int k = 0; k < 3; k++) {
            out[j][k] = (double)posed->Th[k];
            for (int i = 0; i < 3; i++)
                out[j][k] += (double)posed->R[3 * k + i] * (double)posed->joints_smpl[j][i];
        }
    posed_body_free(posed);
    return SHERF_OK;
}

static bool same_observation(const sherf_observation *a, const sherf_observation *b) {
    return !memcmp(&a->camera, &b->camera, sizeof a->camera) && !memcmp(&a->pose, &b->pose, sizeof a->pose);
}

sherf_status carried_create(context *c, const body_model *body, const sherf_observation *truth,
                            const sherf_observation *estimate, carried *out) {
    double from[BODY_JOINTS][3], to[BODY_JOINTS][3];
    *out = (carried){.same = same_observation(truth, estimate), .pose = estimate->pose};
    sherf_status status = joints_world(c, body, &truth->pose, from);
    if (!status) status = joints_world(c, body, &estimate->pose, to);
    for (int i = 0; i < 9; i++) /* R_estimate^T R_truth of the cameras */
        for (int k = 0; k < 3; k++)
            out->R[i] += (double)estimate->camera.R[3 * k + i / 3] * (double)truth->camera.R[3 * k + i % 3];
    if (status) return status;
    out->scale = metres_a_pixel(&estimate->camera, to[0]) / metres_a_pixel(&truth->camera, from[0]);
    if (!(out->scale > 0.01 &&
          out->scale < 100)) /* a pelvis behind the camera: nothing would be visible anyway */
        out->scale = 1;
    for (int k = 0; k < 3; k++) {
        out->t_m[k] = to[0][k];
        for (int i = 0; i < 3; i++) out->t_m[k] -= out->scale * out->R[3 * k + i] * from[0][i];
    }
    return SHERF_OK;
}

void carried_camera(const carried *w, const sherf_camera *truth, sherf_camera *out) {
    *out = *truth;
    if (w->same) return;
    for (int r = 0; r < 3; r++) {
        double T = w->scale * (double)truth->T_m[r];
        for (int k = 0; k < 3; k++) {
            double sum = 0;
            for (int i = 0; i < 3; i++) sum += (double)truth->R[3 * r + i] * w->R[3 * k + i];
            out->R[3 * r + k] = (float)sum;
            T -= sum * w->t_m[k];
        }
        out->T_m[r] = (float)T;
    }
}

sherf_status carried_pose(context *c, const carried *w, const body_model *body, const sherf_pose *truth,
                          bool own_pose, sherf_pose *out) {
    double pelvis[BODY_JOINTS][3], own[BODY_JOINTS][3];
    *out = w->pose;
    if (own_pose) return SHERF_OK;
    *out = *truth;
    if (w->same) return SHERF_OK;
    sherf_status status = joints_world(c, body, truth, pelvis);
    if (status) return status;
    memcpy(out->shapes, w->pose.shapes, sizeof out->shapes);
    for (int i = 0; i < 9; i++) {
        double sum = 0;
        for (int k = 0; k < 3; k++) sum += w->R[i / 3 * 3 + k] * (double)truth->R[3 * k + i % 3];
        out->R[i] = (float)sum;
    }
    memset(out->Th_m, 0, sizeof out->Th_m);
    if ((status = joints_world(c, body, out, own))) return status;
    for (int k = 0; k < 3; k++) {
        double at = w->t_m[k];
        for (int i = 0; i < 3; i++) at += w->scale * w->R[3 * k + i] * pelvis[0][i];
        out->Th_m[k] = (float)(at - own[0][k]);
    }
    return SHERF_OK;
}

/* ---- errors ---- */

static sherf_status joints_camera(context *c, const body_model *body, const sherf_observation *o,
                                  float out[BODY_JOINTS][3]) {
    double world[BODY_JOINTS][3];
    sherf_status status = joints_world(c, body, &o->pose, world);
    for (int j = 0; j < BODY_JOINTS && !status; j++)
        for (int k = 0; k < 3; k++) {
            double x = (double)o->camera.T_m[k];
            for (int i = 0; i < 3; i++) x += (double)o->camera.R[3 * k + i] * world[j][i];
            out[j][k] = (float)x;
        }
    return status;
}

sherf_status estimated_error(context *c, const body_model *body, const sherf_observation *truth,
                             const sherf_observation *estimate, pose_error *out) {
    float t[BODY_JOINTS][3], e[BODY_JOINTS][3];
    if (truth->image.width != estimate->image.width || truth->image.height != estimate->image.height)
        return failure(c, SHERF_MISMATCH, "an estimate of %d x %d pixels for a picture of %d x %d",
                       estimate->image.width, estimate->image.height, truth->image.width,
                       truth->image.height);
    sherf_status status = joints_camera(c, body, truth, t);
    if (!status) status = joints_camera(c, body, estimate, e);
    if (status) return status;
    pose_error_measure((const float(*)[3])t, (const float(*)[3])e, out);
    out->overlap =
        mask_overlap((size_t)truth->image.width * (size_t)truth->image.height, truth->mask, estimate->mask);
    return SHERF_OK;
}

/* ---- lists ---- */

sherf_status estimate_list_add(context *c, estimate_list *l, const estimate_entry *e) {
    if (l->count == l->capacity) {
        int64_t capacity = l->capacity ? 2 * l->capacity : 64;
        estimate_entry *grown = mem_grow(c, l->entry, (size_t)l->count, (size_t)capacity, sizeof *grown);
        if (!grown) return SHERF_NO_MEMORY;
        l->entry = grown;
        l->capacity = capacity;
    }
    l->entry[l->count++] = *e;
    return SHERF_OK;
}

void estimate_list_free(estimate_list *l) {
    mem_free(l->entry);
    *l = (estimate_list){0};
}

static void add_error(pose_error *to, const pose_error *from, double factor) {
    to->joints_mm += factor * from->joints_mm;
    to->aligned_mm += factor * from->aligned_mm;
    to->lean_deg += factor * from->lean_deg;
    to->forward_deg += factor * from->forward_deg;
    to->turn_deg += factor * from->turn_deg;
    to->overlap += factor * from->overlap;
}

static void take_worse(pose_error *to, const pose_error *from) {
    to->joints_mm = fmax(to->joints_mm, from->joints_mm);
    to->aligned_mm = fmax(to->aligned_mm, from->aligned_mm);
    to->lean_deg = fmax(to->lean_deg, from->lean_deg);
    if (fabs(from->forward_deg) > fabs(to->forward_deg)) to->forward_deg = from->forward_deg;
    to->turn_deg = fmax(to->turn_deg, from->turn_deg);
    to->overlap = fmin(to->overlap, from->overlap);
}

estimate_summary estimate_list_summary(const estimate_list *l, int person) {
    static const pose_error none = {NAN, NAN, NAN, NAN, NAN, NAN};
    estimate_summary s = {0};
    for (int64_t i = 0; i < l->count; i++) {
        const estimate_entry *e = &l->entry[i];
        if (person >= 0 && e->person != person) continue;
        add_error(&s.mean, &e->error, 1);
        if (s.count++)
            take_worse(&s.worst, &e->error);
        else
            s.worst = e->error;
        s.wrong_way += pose_error_wrong_way(&e->error);
    }
    if (!s.count) return (estimate_summary){.mean = none, .worst = none};
    pose_error sum = s.mean;
    s.mean = (pose_error){0};
    add_error(&s.mean, &sum, 1.0 / s.count);
    return s;
}

/* ---- table ---- */

enum { NAME_WIDTH = 40, LINE = 192 };

static size_t table_line(char *to, size_t room, const char *name, const pose_error *e, int wrong_way,
                         int count) {
    return (size_t)snprintf(to, room, "%-*.*s %8.1f %9.1f %6.1f %8.1f %6.1f %8.4f %10d %6d\n", NAME_WIDTH / 2,
                            NAME_WIDTH, name, e->joints_mm, e->aligned_mm, e->lean_deg, e->forward_deg,
                            e->turn_deg, e->overlap, wrong_way, count);
}

char *estimate_list_table(context *c, const estimate_list *l, const sherf_dataset *d) {
    int people = 0, previous = -1;
    for (int64_t i = 0; i < l->count; i++) people += i == 0 || l->entry[i].person != l->entry[i - 1].person;
    size_t room = ((size_t)people + 5) * LINE, used = 0;
    char *text = mem_alloc(c, room, 1);
    if (!text) return NULL;
    used += (size_t)snprintf(text, room, "%-*s %8s %9s %6s %8s %6s %8s %10s %6s\n", NAME_WIDTH / 2,
                             "estimated bodies", "mm", "aligned", "lean", "forward", "turn", "overlap",
                             "wrong way", "count");
    for (int64_t i = 0; i < l->count; i++) {
        int person = l->entry[i].person;
        if (person == previous) continue;
        estimate_summary s = estimate_list_summary(l, person);
        used += table_line(text + used, room - used, sherf_dataset_person(d, person), &s.mean, s.wrong_way,
                           s.count);
        previous = person;
    }
    estimate_summary all = estimate_list_summary(l, -1);
    used += table_line(text + used, room - used, "mean", &all.mean, all.wrong_way, all.count);
    used += table_line(text + used, room - used, "worst", &all.worst, all.wrong_way, all.count);
    if (l->missed) snprintf(text + used, room - used, "nobody found in %d of the pictures\n", l->missed);
    return text;
}
