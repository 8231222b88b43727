/* Scores by the observing camera's angle, and by the angle between it and the target's camera. */
#include "experiment/angles.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/vector3.h"
#include "experiment/experiment.h"

enum { ANGLES = 12, STEP_DEG = 30 };

/* ---- geometry ---- */
/* Up along the pelvis, in the world. */
static void vertical(const sherf_pose *pose, double up[3]) {
    float turn[9];
    rodrigues(pose->poses_rad, turn);
    for (int i = 0; i < 3; i++) {
        up[i] = 0;
        for (int k = 0; k < 3; k++) up[i] += (double)pose->R[3 * i + k] * (double)turn[3 * k + 1];
    }
}

static void level(const sherf_camera *camera, const float root[3], const double up[3], double out[3]) {
    float eye[3];
    camera_position(camera, eye);
    for (int k = 0; k < 3; k++) out[k] = (double)eye[k] - (double)root[k];
    const double height = dot3(out, up);
    for (int k = 0; k < 3; k++) out[k] -= height * up[k];
}

sherf_status camera_angle(context *c, const sherf_body *body, const sherf_pose *pose,
                          const sherf_camera *from, const sherf_camera *to, double *degrees) {
    float joint[24][3];
    double up[3], a[3], b[3];
    sherf_status status = sherf_body_pose(c, body, pose, NULL, joint[0]);
    if (status != SHERF_OK) return status;
    vertical(pose, up);
    level(from, joint[0], up, a);
    level(to, joint[0], up, b);
    const double cross[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
    *degrees = atan2(dot3(up, cross), dot3(a, b)) * 180 / M_PI;
    return SHERF_OK;
}

int angle_rounded(double degrees) {
    const int turn = (int)lround(degrees / STEP_DEG) % ANGLES;
    return STEP_DEG * (turn > ANGLES / 2 ? turn - ANGLES : turn <= -ANGLES / 2 ? turn + ANGLES : turn);
}

/* ---- scores by angle ---- */
/* What the test people's files say about their cameras. */
typedef struct {
    experiment_job *j;
    sherf_dataset *data;
    sherf_body *body;
} angle_source;
/* Sums of one person's pictures by bin; a bin is a twelfth of a turn. */
typedef struct {
    double sum[ANGLES];
    int count[ANGLES];
} angle_sums;

static int bin_of(int degrees) {
    return (degrees / STEP_DEG + ANGLES) % ANGLES;
}

static sherf_status picture_bin(const angle_source *s, int person, const picture_scores *k, bool difference,
                                int *bin) {
    sherf_camera seen, other;
    sherf_pose pose;
    double degrees;
    context *c = s->j->c;
    const int front = protocol_front(dataset_protocol(s->data), sherf_dataset_view_count(s->data, person));
    sherf_status status = dataset_camera(c, s->data, person, k->observed_view, &seen);
    if (status == SHERF_OK) status = dataset_camera(c, s->data, person, difference ? k->view : front, &other);
    if (status == SHERF_OK) status = dataset_pose(c, s->data, person, k->observed_pose, &pose);
    if (status == SHERF_OK) status = camera_angle(c, s->body, &pose, &other, &seen, &degrees);
    if (status == SHERF_OK) *bin = bin_of(angle_rounded(difference ? fabs(degrees) : degrees));
    return status;
}

static int person_index(const sherf_dataset *d, const char *name) {
    for (int i = 0; i < sherf_dataset_person_count(d); i++)
        if (!strcmp(sherf_dataset_person(d, i), name)) return i;
    return -1;
}

static sherf_status add_pictures(const angle_source *s, const scores *of, bool difference, angle_sums *sums) {
    for (int i = 0; i < of->pictures; i++) {
        const picture_scores *k = &of->picture[i];
        const char *name = of->person[k->person].name;
        const int person = person_index(s->data, name);
        int bin;
        if (person < 0) return failure(s->j->c, SHERF_MISMATCH, "%s is not among the test people", name);
        sherf_status status = picture_bin(s, person, k, difference, &bin);
        if (status != SHERF_OK) return status;
        sums[k->person].sum[bin] += k->psnr;
        sums[k->person].count[bin]++;
    }
    return SHERF_OK;
}

/* Adds all poses' scorings of a method to each person's sums; mem_free *sums. */
static sherf_status method_sums(const angle_source *s, const experiment_method *method, bool difference,
                                angle_sums **sums, int *people) {
    experiment_job *j = s->j;
    const scoring *how = &j->experiment->scoring[0];
    scoring_selection k = {.poses_observed = 1};
    sherf_status status = SHERF_OK;
    *sums = NULL;
    for (int pose = 0; pose < k.poses_observed && status == SHERF_OK; pose++) {
        scores of[SEEDS_MAX];
        int count;
        if ((status = scoring_select(j, &j->data[0], how, pose, &k)) != SHERF_OK) break;
        if ((status = report_read(j, method, &j->data[0], how, pose, of, &count)) != SHERF_OK) break;
        *people = of->people;
        if (!*sums && !(*sums = mem_zero(j->c, (size_t)of->people + 1, sizeof **sums)))
            status = SHERF_NO_MEMORY;
        for (int i = 0; i < count && status == SHERF_OK; i++)
            status = of[i].people == *people
                         ? add_pictures(s, &of[i], difference, *sums)
                         : failure(j->c, SHERF_MISMATCH, "scores of other people than before");
        scores_free_all(of, count);
    }
    return status;
}

static sherf_status bin_interval(context *c, const angle_sums *sums, int people, int bin, interval *out) {
    double *x = mem_alloc(c, (size_t)people + 1, 2 * sizeof *x), *weight = x + people;
    if (!x) return SHERF_NO_MEMORY;
    for (int i = 0; i < people; i++) weight[i] = sums[i].count[bin];
    for (int i = 0; i < people; i++) x[i] = sums[i].count[bin] ? sums[i].sum[bin] / sums[i].count[bin] : NAN;
    sherf_status status =
        interval_bootstrap(c, people, x, weight, random_key(1, "experiment.people", 0), out);
    mem_free(x);
    return status;
}

/* A row of the table and a line of the plot. */
static sherf_status method_line(const angle_source *s, const experiment_method *method, bool difference,
                                int first, page_table *t, page_plot *plot) {
    context *c = s->j->c;
    angle_sums *sums;
    int people = 0;
    sherf_status status = method_sums(s, method, difference, &sums, &people);
    page_series *line = page_add_series(c, plot, method->label);
    page_row *row = page_add_row(c, t, "%s", method->label);
    if (status == SHERF_OK && (!line || !row)) status = SHERF_NO_MEMORY;
    for (int i = 0; i < t->columns && status == SHERF_OK; i++) {
        const int degrees = first + i * STEP_DEG;
        status = bin_interval(c, sums, people, bin_of(degrees), &row->value[i]);
        if (status == SHERF_OK) status = page_add_point(c, line, degrees, row->value[i]);
    }
    mem_free(sums);
    return status;
}

static sherf_status report_angles(experiment_job *j, page *p, bool difference) {
    context *c = j->c;
    angle_source s = {.j = j};
    const int first = difference ? STEP_DEG : STEP_DEG - 180, last = 180;
    char name[32];
    sherf_status status = sherf_dataset_open(c, j->data[0].test, &s.data);
    if (status == SHERF_OK) status = sherf_body_load(c, j->data[0].body, &s.body);
    page_table *t =
        page_add_table(c, p, "PSNR by %s, %s",
                       difference ? "the angle between input and target" : "input angle", j->data[0].label);
    page_plot *plot = page_add_plot(c, p, j->experiment->name, j->experiment->title);
    if (status == SHERF_OK && (!t || !plot)) status = SHERF_NO_MEMORY;
    for (int a = first; a <= last && status == SHERF_OK; a += STEP_DEG) {
        snprintf(name, sizeof name, "%d", a);
        status = page_add_column(
            c, t, difference ? "degrees between the views" : "degrees from the front view", name, 2, 1);
    }
    if (status == SHERF_OK) {
        plot->step = difference ? STEP_DEG : 60;
        snprintf(plot->x, sizeof plot->x, "%s", t->column[0].group);
        snprintf(plot->y, sizeof plot->y, "PSNR (dB)");
    }
    for (int i = 0; status == SHERF_OK && i < EXPERIMENT_METHODS && j->experiment->method[i]; i++)
        status =
            method_line(&s, experiment_method_find(j->experiment->method[i]), difference, first, t, plot);
    sherf_body_free(s.body);
    sherf_dataset_free(s.data);
    if (status == SHERF_OK)
        status = page_add_note(
            c, p,
            "Angles are of camera centres about the body's vertical axis, to the nearest 30 degrees; the "
            "paper shows these as a figure alone, and its poses and bins are not known.");
    return status == SHERF_OK ? report_end(j, p) : status;
}

sherf_status report_input_angle(experiment_job *j, page *p) {
    return report_angles(j, p, false);
}

sherf_status report_angle_difference(experiment_job *j, page *p) {
    return report_angles(j, p, true);
}
