/* The fit: its input, its starts, its stages, and the result. */
#include "estimate/fit.h"

#include <math.h>
#include <string.h>

#include "base/vector3.h"
#include "estimate/fit_inside.h"
#include "sampling/sampling.h"

enum { STAGE_3D = 12, STAGE_LANDMARKS = 15, STAGE_MASK = 12, ROUNDS_MASK = 3 };
static const double focal_usual = 1.3, skin_spacing_m = 0.045;

static double clamp(double x, double low, double high) {
    return x < low ? low : x > high ? high : x;
}

/* 1 below `full`, 0 above `none`. */
static double fade(double x, double full, double none) {
    return clamp((none - x) / (none - full), 0, 1);
}

static bool unit(double v[3]) {
    double length = sqrt(dot3(v, v));
    if (!(length > 1e-6)) return false;
    for (int k = 0; k < 3; k++) v[k] /= length;
    return true;
}

/* ---- weights ---- */

static sherf_status check_input(context *c, const body_fit_input *in) {
    enum { SIDE_MAX = 1 << 16 };
    bool finite = isfinite(in->focal_px) && isfinite(in->person->region.angle_rad) &&
                  in->person->region.side_px > 0 && in->person->region.side_px < SIDE_MAX;
    for (int k = 0; k < 2; k++) finite &= fabsf(in->person->region.centre_px[k]) < SIDE_MAX;
    for (int l = 0; l < LANDMARKS; l++) {
        const landmark *mark = &in->person->landmark[l];
        for (int k = 0; k < 2; k++) finite &= fabsf(mark->place_px[k]) < 4 * SIDE_MAX;
        for (int k = 0; k < 3; k++) finite &= fabsf(mark->place_m[k]) < 100;
        finite &= mark->visible >= 0 && mark->visible <= 1 && mark->present >= 0 && mark->present <= 1;
    }
    if (in->width_px < 1 || in->height_px < 1 || in->width_px > SIDE_MAX || in->height_px > SIDE_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "fit: a photo of %d x %d pixels", in->width_px, in->height_px);
    if (!finite) return failure(c, SHERF_BAD_ARGUMENT, "fit: landmarks that are not finite, or far outside");
    if (in->mask && (in->mask->width != in->width_px || in->mask->height != in->height_px ||
                     in->mask->channels != 1 || !in->mask->data))
        return failure(c, SHERF_MISMATCH,
                       "fit: the mask is not of the photo's size, %d x %d, with one channel", in->width_px,
                       in->height_px);
    return SHERF_OK;
}

static bool in_photo(const body_fit_input *in, int l) {
    const float *at = in->person->landmark[l].place_px;
    return at[0] >= 0 && at[1] >= 0 && at[0] <= (float)(in->width_px - 1) &&
           at[1] <= (float)(in->height_px - 1);
}

/* The networks guess hidden landmarks rather well (5 cm off instead of 2), so these have a small weight.
 * Landmarks outside the photo have almost none. Several landmarks of fingers and faces carry the same
 * information, so each weighs less. */
static void weigh_landmarks(fit_problem *p) {
    for (int l = 0; l < LANDMARKS; l++) {
        if (fit_landmarks[l].joint < 0) continue;
        const landmark *mark = &p->in->person->landmark[l];
        double seen = (double)(mark->visible * mark->present);
        double share = l >= LANDMARK_LEFT_PINKY && l <= LANDMARK_RIGHT_THUMB ? 0.4
                       : l <= LANDMARK_RIGHT_EAR                             ? 0.6
                                                                             : 1;
        bool inside = in_photo(p->in, l);
        p->seen[l] = inside ? share * (0.12 + 0.88 * seen) : 0;
        p->seen_3d[l] = inside ? share * (0.25 + 0.75 * seen) : 0.05 * share;
    }
}

/* The angle between the two bones of a leg in 3D, and of the leg against the picture's vertical. Knees look
 * bent by some 11 degrees where they are straight. */
static double standing_of(const body_fit_input *in) {
    double min = 1;
    for (int side = 0; side < 2; side++) {
        const landmark *hip = &in->person->landmark[LANDMARK_LEFT_HIP + side],
                       *knee = &in->person->landmark[LANDMARK_LEFT_KNEE + side],
                       *ankle = &in->person->landmark[LANDMARK_LEFT_ANKLE + side];
        double thigh[3], shin[3], leg[2];
        for (int k = 0; k < 3; k++) {
            thigh[k] = (double)knee->place_m[k] - (double)hip->place_m[k];
            shin[k] = (double)ankle->place_m[k] - (double)knee->place_m[k];
        }
        for (int k = 0; k < 2; k++) leg[k] = (double)ankle->place_px[k] - (double)hip->place_px[k];
        if (!unit(thigh) || !unit(shin)) return 0;
        double bent = acos(clamp(dot3(thigh, shin), -1, 1)), off = atan2(fabs(leg[0]), leg[1]);
        double seen = (double)(ankle->visible * ankle->present) * in_photo(in, LANDMARK_LEFT_ANKLE + side);
        min = fmin(min, fade(bent, 0.75, 1.15) * fade(off, 0.55, 0.85) * clamp(2 * seen, 0, 1));
    }
    return min;
}

/* A trunk that looks upright in the picture is probably upright in depth too. */
static double upright_of(const body_fit_input *in) {
    const landmark *l = in->person->landmark;
    double trunk[2];
    for (int k = 0; k < 2; k++)
        trunk[k] = (double)(l[LANDMARK_LEFT_HIP].place_px[k] + l[LANDMARK_RIGHT_HIP].place_px[k] -
                            l[LANDMARK_LEFT_SHOULDER].place_px[k] - l[LANDMARK_RIGHT_SHOULDER].place_px[k]);
    return fade(atan2(fabs(trunk[0]), trunk[1]), 0.2, 0.5);
}

/* The rotation that takes the optical axis to the ray through the hips: the network sees the person in the
 * middle of its own picture. */
static void ray_of(fit_problem *p, double focal_px) {
    const landmark *l = p->in->person->landmark;
    double ray[3] = {0, 0, 1}, axis[3];
    for (int k = 0; k < 2; k++)
        ray[k] = (0.5 * (double)(l[LANDMARK_LEFT_HIP].place_px[k] + l[LANDMARK_RIGHT_HIP].place_px[k]) -
                  p->centre_px[k]) /
                 focal_px;
    unit(ray);
    const double forward[3] = {0, 0, 1};
    cross3(forward, ray, axis);
    double sine = sqrt(dot3(axis, axis)), angle = atan2(sine, ray[2]);
    for (int k = 0; k < 3 && sine > 0; k++) axis[k] *= angle / sine;
    rotation_exp(axis, p->ray, NULL);
}

/* ---- points ---- */

double fit_clothes_at(const body_model *body, int vertex, const double normal[3]) {
    double sum = 0;
    for (int j = 0; j < BODY_JOINTS; j++) {
        const fit_clothes *f = &fit_clothes_table[j];
        double beyond = (double)f->beyond_m;
        for (int k = 0; k < 3; k++) beyond += (double)f->along_m[k] * normal[k];
        sum += (double)body->weights[(size_t)vertex * BODY_JOINTS + (size_t)j] * beyond;
    }
    return sum;
}

/* The first vertex in each cell of a grid over the rest pose. */
static sherf_status choose_skin(context *c, fit_problem *p) {
    const body_model *body = p->body;
    enum { CELLS = 96 };
    sherf_status status = SHERF_NO_MEMORY;
    uint8_t *taken = mem_zero(c, (size_t)CELLS * CELLS * CELLS, 1);
    body_point *list = mem_alloc(c, (size_t)body->vertices, sizeof *list);
    float *normals = mem_alloc(c, (size_t)body->vertices, 3 * sizeof *normals);
    int count = 0;
    if (!taken || !list || !normals || (status = body_normals(c, body, body->v_template, normals))) goto done;
    for (int v = 0; v < body->vertices; v++) {
        size_t cell = 0;
        for (int k = 0; k < 3; k++) {
            double at = (double)body->v_template[3 * (size_t)v + (size_t)k] / skin_spacing_m + CELLS / 2;
            cell = cell * CELLS + (size_t)clamp(at, 0, CELLS - 1);
        }
        if (taken[cell]) continue;
        taken[cell] = 1;
        list[count++] = (body_point){.vertex = v};
    }
    status = SHERF_NO_MEMORY;
    p->skin_vertex = mem_alloc(c, (size_t)count, sizeof *p->skin_vertex);
    p->skin_clothes_m = mem_alloc(c, (size_t)count, sizeof *p->skin_clothes_m);
    p->skin_normal = mem_alloc(c, (size_t)count, sizeof *p->skin_normal);
    p->skin_place = mem_alloc(c, (size_t)count, 7 * sizeof *p->skin_place);
    p->skin_blend = mem_alloc(c, (size_t)count, 9 * sizeof *p->skin_blend);
    p->skin_slope = mem_alloc(c, (size_t)count, 3 * BODY_UNKNOWNS * sizeof *p->skin_slope);
    if (!p->skin_vertex || !p->skin_clothes_m || !p->skin_normal || !p->skin_place || !p->skin_blend ||
        !p->skin_slope)
        goto done;
    for (int i = 0; i < count; i++) {
        p->skin_vertex[i] = list[i].vertex;
        for (int k = 0; k < 3; k++)
            p->skin_normal[i][k] = (double)normals[3 * (size_t)list[i].vertex + (size_t)k];
        p->skin_clothes_m[i] = fit_clothes_at(body, list[i].vertex, p->skin_normal[i]);
    }
    status = body_points_create(c, body, count, list, &p->skin);
done:
    mem_free(taken);
    mem_free(list);
    mem_free(normals);
    return status;
}

static sherf_status choose_points(context *c, fit_problem *p) {
    body_point list[FIT_MARKS] = {0};
    for (int i = 0; i < FIT_MARKS; i++) {
        list[i].vertex = -1;
        if (i >= LANDMARKS) {
            list[i].joint = i - LANDMARKS;
        } else if (fit_landmarks[i].joint >= 0) {
            list[i].joint = fit_landmarks[i].joint;
            memcpy(list[i].offset_m, fit_landmarks[i].offset_m, sizeof list[i].offset_m);
        }
    }
    p->mark_place = mem_alloc(c, FIT_MARKS, 3 * sizeof *p->mark_place);
    p->mark_slope = mem_alloc(c, FIT_MARKS, 3 * BODY_UNKNOWNS * sizeof *p->mark_slope);
    if (!p->mark_place || !p->mark_slope) return SHERF_NO_MEMORY;
    sherf_status status = body_points_create(c, p->body, FIT_MARKS, list, &p->marks);
    return status ? status : choose_skin(c, p);
}

void fit_problem_clear(fit_problem *p) {
    fit_mask_free(p->mask);
    body_points_free(p->marks);
    body_points_free(p->skin);
    mem_free(p->skin_normal);
    mem_free(p->skin_clothes_m);
    mem_free(p->skin_vertex);
    mem_free(p->mark_place);
    mem_free(p->mark_slope);
    mem_free(p->skin_place);
    mem_free(p->skin_slope);
    mem_free(p->skin_blend);
}

/* ---- starts ---- */

/* The trunk's up and left directions in 3D; false where they have no length. */
static bool first_turn(const fit_problem *p, double root[9]) {
    const landmark *l = p->in->person->landmark;
    double left[3], up[3], front[3], turned[9];
    for (int k = 0; k < 3; k++) {
        left[k] = (double)(l[LANDMARK_LEFT_HIP].place_m[k] - l[LANDMARK_RIGHT_HIP].place_m[k] +
                           l[LANDMARK_LEFT_SHOULDER].place_m[k] - l[LANDMARK_RIGHT_SHOULDER].place_m[k]);
        up[k] = (double)(l[LANDMARK_LEFT_SHOULDER].place_m[k] + l[LANDMARK_RIGHT_SHOULDER].place_m[k] -
                         l[LANDMARK_LEFT_HIP].place_m[k] - l[LANDMARK_RIGHT_HIP].place_m[k]);
    }
    if (!unit(up)) return false;
    double along = dot3(left, up);
    for (int k = 0; k < 3; k++) left[k] -= along * up[k];
    if (!unit(left)) return false;
    cross3(left, up, front);
    for (int k = 0; k < 3; k++)
        turned[3 * k] = left[k], turned[3 * k + 1] = up[k], turned[3 * k + 2] = front[k];
    multiply3(p->ray, turned, root);
    return true;
}

/* The body's place that best projects the marks to where they are seen, by linear least squares. */
static bool first_place(fit_problem *p, fit_state *s) {
    double A[9] = {0}, b[3] = {0}, focal = exp(s->log_focal);
    memset(s->body.pelvis_m, 0, sizeof s->body.pelvis_m);
    body_points_place(p->marks, &s->body, p->mark_place, NULL, NULL);
    for (int l = 0; l < LANDMARKS; l++)
        for (int k = 0; k < 2; k++) {
            const double *x = p->mark_place + 3 * l, w = p->seen[l];
            double slope = ((double)p->in->person->landmark[l].place_px[k] - p->centre_px[k]) / focal;
            double row[3] = {k == 0, k == 1, -slope}, right = slope * x[2] - x[k];
            for (int i = 0; i < 3; i++) {
                b[i] += w * row[i] * right;
                for (int j = 0; j < 3; j++) A[3 * i + j] += w * row[i] * row[j];
            }
        }
    double minor[3][3], det = 0;
    for (int i = 0; i < 3; i++) cross3(A + 3 * ((i + 1) % 3), A + 3 * ((i + 2) % 3), minor[i]);
    det = dot3(A, minor[0]);
    if (!(fabs(det) > 1e-12)) return false;
    for (int k = 0; k < 3; k++) {
        double sum = 0;
        for (int i = 0; i < 3; i++) sum += minor[i][k] * b[i];
        s->body.pelvis_m[k] = sum / det;
    }
    p->px_per_m = focal / s->body.pelvis_m[2];
    return s->body.pelvis_m[2] > 0.3 && s->body.pelvis_m[2] < 1e4;
}

static void keep_known(const body_fit_input *in, fit_state *s) {
    const body_fit_result *known = in->known;
    const float *shape = fit_shape(in);
    for (int b = 0; shape && b < BODY_SHAPES; b++) s->body.shape[b] = (double)shape[b];
    if (!known) return;
    s->pitch = known->pitch_rad;
    s->roll = known->roll_rad;
    s->log_focal = log((double)known->camera.K[0]);
}

/* Starts from the end of another fit. */
static double start_from(fit_problem *p, const body_fit_result *r, fit_state *s, fit_equations *e) {
    double turned[9], camera[9], w[3], place[3];
    *s = (fit_state){.clothes = 1};
    for (int k = 0; k < 9; k++) camera[k] = (double)r->camera.R[k];
    for (int k = 0; k < 3; k++) w[k] = (double)r->pose.poses_rad[k];
    rotation_exp(w, turned, NULL);
    multiply3(camera, turned, s->body.root);
    for (int j = 1; j < BODY_JOINTS; j++)
        for (int k = 0; k < 3; k++) s->body.bend[j][k] = (double)r->pose.poses_rad[3 * j + k];
    for (int k = 0; k < 3; k++) {
        place[k] = (double)r->pose.Th_m[k] + p->body->joint_template[0][k];
        for (int b = 0; b < BODY_SHAPES; b++)
            place[k] += (double)r->pose.shapes[b] * p->body->joint_shape[0][k][b];
    }
    for (int k = 0; k < 3; k++) s->body.pelvis_m[k] = dot3(camera + 3 * k, place) + (double)r->camera.T_m[k];
    keep_known(p->in, s);
    p->px_per_m = exp(s->log_focal) / s->body.pelvis_m[2];
    p->weight_2d = 1;
    p->weight_3d = 0.15; /* the frame before says more about depth */
    p->weight_mask = 0;
    return fit_solve(p, s, STAGE_LANDMARKS, e);
}

/* One start: the trunk's orientation, rotated by `yaw` about its own axis. */
static double try_start(fit_problem *p, double yaw, fit_state *s, fit_equations *e) {
    const double axis[3] = {0, yaw, 0};
    double R[9];
    *s = (fit_state){.clothes = 1};
    if (!first_turn(p, s->body.root)) return INFINITY;
    rotation_exp(axis, R, NULL);
    multiply3(s->body.root, R, s->body.root);
    for (int j = 1; j < BODY_JOINTS; j++)
        memcpy(s->body.bend[j], fit_joints[j].usual, sizeof s->body.bend[j]);
    s->pitch = 0.12;
    s->log_focal = log(p->focal_guess_px);
    keep_known(p->in, s);
    s->body.pelvis_m[2] = 4;
    p->weight_2d = p->weight_mask = 0;
    p->weight_3d = 1;
    fit_solve(p, s, STAGE_3D, e);
    if (!first_place(p, s)) return INFINITY;
    p->weight_2d = 1;
    p->weight_3d = 0.5;
    return fit_solve(p, s, STAGE_LANDMARKS, e);
}

static sherf_status find(context *c, fit_problem *p, fit_state *best, fit_equations *e) {
    static const double yaw[] = {0, M_PI};
    const bool begun = p->in->known && p->in->before;
    double min = begun ? start_from(p, p->in->before, best, e) : INFINITY;
    for (size_t i = 0; i < COUNT_OF(yaw) && !begun; i++) {
        fit_state s;
        double cost = try_start(p, yaw[i], &s, e);
        if (cost < min) min = cost, *best = s;
    }
    if (!(min < INFINITY)) return failure(c, SHERF_MISMATCH, "fit: no body lies where the landmarks are");
    p->weight_mask = 100;
    if (!begun) p->weight_3d = 0.35; /* the depths have already decided the limbs' directions */
    for (int round = 0; round < (begun ? 1 : ROUNDS_MASK); round++) {
        p->px_per_m = exp(best->log_focal) / best->body.pelvis_m[2];
        ray_of(p, exp(best->log_focal));
        fit_solve(p, best, STAGE_MASK, e);
        if (cancelled(c)) return failure(c, SHERF_CANCELLED, "fit: cancelled");
    }
    return SHERF_OK;
}

/* ---- the result ---- */

static void set_camera(const body_fit_input *in, const fit_problem *p, const fit_state *s,
                       body_fit_result *out) {
    double cp = cos(s->pitch), sp = sin(s->pitch), cr = cos(s->roll), sr = sin(s->roll);
    /* rows: right, down, forward of a camera that looks along -z and down by the pitch; then turned by the
     * roll */
    const double R[9] = {cr, sr * cp, -sr * sp, sr, -cr * cp, cr * sp, 0, -sp, -cp};
    sherf_camera *k = &out->camera;
    k->width_px = in->width_px;
    k->height_px = in->height_px;
    k->K[0] = k->K[4] = (float)exp(s->log_focal);
    k->K[2] = (float)p->centre_px[0];
    k->K[5] = (float)p->centre_px[1];
    k->K[8] = 1;
    for (int i = 0; i < 9; i++) k->R[i] = (float)R[i];
    for (int i = 0; i < 3; i++) k->T_m[i] = (float)s->body.pelvis_m[i];
    out->pitch_rad = s->pitch;
    out->roll_rad = s->roll;
}

/* With the pelvis at the origin; the floor follows from the vertices. */
static void set_pose(const body_model *body, const fit_state *s, body_fit_result *out) {
    float root[9];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double sum = 0;
            for (int k = 0; k < 3; k++) sum += (double)out->camera.R[3 * k + i] * s->body.root[3 * k + j];
            root[3 * i + j] = (float)sum;
        }
    sherf_pose_identity(&out->pose);
    rotation_to_axis_angle(root, out->pose.poses_rad);
    for (int j = 1; j < BODY_JOINTS; j++)
        for (int k = 0; k < 3; k++) out->pose.poses_rad[3 * j + k] = (float)s->body.bend[j][k];
    for (int b = 0; b < BODY_SHAPES; b++) out->pose.shapes[b] = (float)s->body.shape[b];
    for (int k = 0; k < 3; k++) {
        double J = body->joint_template[0][k];
        for (int b = 0; b < BODY_SHAPES; b++) J += s->body.shape[b] * body->joint_shape[0][k][b];
        out->pose.Th_m[k] = (float)-J;
    }
}

/* Moves the floor to y = 0 and finds the body's extent in the picture. */
static void set_floor(const body_model *body, const float *vertices, body_fit_result *out) {
    float lowest = INFINITY, low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    sherf_camera *k = &out->camera;
    for (int v = 0; v < body->vertices; v++) {
        float uv[2];
        lowest = fminf(lowest, vertices[3 * v + 1]);
        camera_project(k, 1, vertices + 3 * (size_t)v, uv, NULL);
        for (int i = 0; i < 2; i++) low[i] = fminf(low[i], uv[i]), high[i] = fmaxf(high[i], uv[i]);
    }
    out->height_px = fmax((double)(high[0] - low[0]), (double)(high[1] - low[1]));
    out->pose.Th_m[1] -= lowest;
    for (int i = 0; i < 3; i++) k->T_m[i] += k->R[3 * i + 1] * lowest; /* R (x - (0, lowest, 0)) + T */
}

/* Body and mask on the mask's grid. vertices: in the world whose origin is the pelvis, T before the floor. */
static sherf_status compare_mask(context *c, const body_model *body, const fit_mask *mask,
                                 const float *vertices, const sherf_camera *camera, body_fit_result *out) {
    raster *r;
    sherf_camera grid = *camera;
    double scale = 1 / mask->cell_px, both = 0, covered = 0, person = 0;
    grid.width_px = mask->width;
    grid.height_px = mask->height;
    for (int k = 0; k < 6; k++) grid.K[k] = (float)((double)grid.K[k] * scale);
    grid.K[2] -= (float)(mask->left * scale);
    grid.K[5] -= (float)(mask->top * scale);
    sherf_status status = raster_create(c, &grid, 1, body->vertices, vertices, body->faces, body->face, &r);
    if (status) return status;
    for (size_t i = 0; i < (size_t)mask->width * (size_t)mask->height; i++) {
        bool hit = r->face[i] >= 0, in = mask->inside[i] >= 0.5f;
        both += hit && in;
        covered += hit;
        person += in;
    }
    raster_free(r);
    out->mask_covered = person > 0 ? both / person : 0;
    out->body_inside = covered > 0 ? both / covered : 0;
    out->iou = covered + person - both > 0 ? both / (covered + person - both) : 0;
    return SHERF_OK;
}

static void set_words(const fit_problem *p, const fit_state *s, body_fit_result *out) {
    const landmark *l = p->in->person->landmark;
    double sum = 0, weight = 0, focal = exp(s->log_focal), up[3], trunk[3], front[3];
    body_points_place(p->marks, &s->body, p->mark_place, NULL, NULL);
    for (int i = 0; i < LANDMARKS; i++) {
        const double *x = p->mark_place + 3 * i,
                     w = in_photo(p->in, i) ? p->seen[i] * (double)l[i].visible : 0;
        double dx = focal * x[0] / x[2] + p->centre_px[0] - (double)l[i].place_px[0],
               dy = focal * x[1] / x[2] + p->centre_px[1] - (double)l[i].place_px[1];
        if (w > 0) sum += w * hypot(dx, dy), weight += w;
    }
    out->landmarks_px = weight > 0 ? sum / weight : 0;
    fit_up(s, up);
    const double *pelvis = p->mark_place + 3 * LANDMARKS, *neck = pelvis + 3 * 12;
    for (int k = 0; k < 3; k++) trunk[k] = neck[k] - pelvis[k], front[k] = s->body.root[3 * k + 2];
    out->from_behind = dot3(front, pelvis) > 0;
    double rise = dot3(front, up);
    for (int k = 0; k < 3; k++) front[k] -= rise * up[k];
    if (unit(front)) out->lean_rad = atan2(dot3(trunk, front), dot3(trunk, up));
    out->stands = p->stands > 0.5;
    for (int side = 0; side < 2; side++) {
        out->cut_feet |=
            !in_photo(p->in, LANDMARK_LEFT_ANKLE + side) || !in_photo(p->in, LANDMARK_LEFT_TOE + side);
        out->hidden_arms |=
            l[LANDMARK_LEFT_ELBOW + side].visible < 0.4f || l[LANDMARK_LEFT_WRIST + side].visible < 0.4f;
    }
    out->cut_head = !in_photo(p->in, LANDMARK_NOSE);
    out->small = out->height_px < 150;
    out->poor = out->landmarks_px > 0.02 * out->height_px || out->iou < 0.6;
}

static sherf_status conclude(context *c, fit_problem *p, const fit_state *s, body_fit_result *out) {
    posed_body *posed = NULL;
    float *vertices = mem_alloc(c, (size_t)p->body->vertices, 3 * sizeof *vertices);
    sherf_status status = SHERF_NO_MEMORY;
    if (!vertices) goto done;
    set_camera(p->in, p, s, out);
    set_pose(p->body, s, out);
    const sherf_pose *q = &out->pose;
    status = posed_body_create(c, p->body, q->poses_rad, q->shapes, q->R, q->Th_m, &posed);
    if (status) goto done;
    body_vertices_world(p->body, posed, vertices);
    if ((status = compare_mask(c, p->body, p->mask, vertices, &out->camera, out))) goto done;
    set_floor(p->body, vertices, out);
    set_words(p, s, out);
    if (!(out->landmarks_px < 0.15 * out->height_px))
        status =
            failure(c, SHERF_MISMATCH, "fit: no body lies on the landmarks (%.0f pixels off on the mean)",
                    out->landmarks_px);
done:
    posed_body_free(posed);
    mem_free(vertices);
    return status;
}

sherf_status fit_problem_begin(context *c, const body_model *body, const body_fit_input *in, fit_problem *p) {
    const double longer = in->width_px > in->height_px ? in->width_px : in->height_px;
    fit_mask *mask;
    *p = (fit_problem){.body = body, .in = in};
    p->centre_px[0] = 0.5 * (in->width_px - 1);
    p->centre_px[1] = 0.5 * (in->height_px - 1);
    p->focal_guess_px = in->known          ? (double)in->known->camera.K[0]
                        : in->focal_px > 0 ? in->focal_px
                                           : focal_usual * longer;
    p->focal_spread = in->known ? 0.001 : in->focal_px > 0 ? 0.01 : 0.3;
    weigh_landmarks(p);
    fit_depths(in->person, p->depth_m);
    p->stands = standing_of(in);
    p->upright = upright_of(in) * (0.25 + 0.75 * p->stands);
    ray_of(p, p->focal_guess_px);
    sherf_status status = fit_mask_create(c, in, &mask);
    p->mask = mask;
    return status ? status : choose_points(c, p);
}

sherf_status body_fit(context *c, const body_model *body, const body_fit_input *in, body_fit_result *out) {
    memset(out, 0, sizeof *out);
    sherf_status status = check_input(c, in);
    if (status) return status;
    fit_problem p = {0};
    fit_state s = {0};
    int seen = 0;
    fit_equations *e = mem_alloc(c, 1, sizeof *e);
    if (!e) return SHERF_NO_MEMORY;
    if ((status = fit_problem_begin(c, body, in, &p))) goto done;
    for (int l = 0; l < LANDMARKS; l++) seen += p.seen[l] > 0.3;
    if (seen < 4) {
        status = failure(c, SHERF_BAD_ARGUMENT, "fit: hardly a landmark is seen in the photo");
        goto done;
    }
    if ((status = find(c, &p, &s, e))) goto done;
    status = conclude(c, &p, &s, out);
done:
    if (status) memset(out, 0, sizeof *out);
    fit_problem_clear(&p);
    mem_free(e);
    return status;
}
