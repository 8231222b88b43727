/* sherf_eval: observations and targets, rendered and scored. */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "avatar/avatar.h"
#include "base/path.h"
#include "eval/lpips_file.h"
#include "eval/metrics.h"
#include "eval/protocol.h"
#include "eval/report.h"
#include "eval/resnet50_file.h"
#include "eval/sheet.h"
#include "eval/baseline.h"
#include "model/model.h"

/* Everything an evaluation holds. */
typedef struct {
    context *c;
    const sherf_eval_options *options;
    sherf_dataset *data;
    body_model *body;
    sherf_model *model;
    lpips_network *lpips;       /* NULL: not computed */
    resnet50_network *resnet50; /* NULL: not computed */
    tape *tape;                 /* of these two */
    baselines baselines;        /* of the observation */
    uint8_t *shown;             /* the parts of the body that it shows */
    sherf_image painted;        /* the painted body's picture */
    int *people, people_count;
    selection *selection; /* one per person */
    int64_t done, total;
    sherf_frame frame;
    report report;
    const eval_estimator *estimator; /* NULL: bodies and cameras are the data set's */
    carried carried;                 /* of the observation */
    sheet sheet;
    int sheet_row;
    bool folder_is_new;
} evaluation;

static void evaluation_free(evaluation *e) {
    for (int i = 0; e->selection && i < e->people_count; i++) selection_free(&e->selection[i]);
    mem_free(e->selection);
    mem_free(e->people);
    report_free(&e->report);
    sheet_free(&e->sheet);
    sherf_frame_free(&e->frame);
    tape_free(e->tape);
    lpips_free(e->lpips);
    resnet50_free(e->resnet50);
    mem_free(e->shown);
    baselines_free(&e->baselines);
    sherf_image_free(&e->painted);
    sherf_model_free(e->model);
    sherf_body_free(e->body);
    sherf_dataset_free(e->data);
}

static sherf_status evaluation_open(evaluation *e) {
    context *c = e->c;
    const sherf_eval_options *o = e->options;
    sherf_status status;
    if (!o->data || !o->body || !o->model)
        return failure(c, SHERF_BAD_ARGUMENT, "a data set, a body and a model are needed");
    if (o->pictures < 0 || o->pictures > SHERF_PICTURES_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "%d pictures of an observation: 1 to %d", o->pictures,
                       SHERF_PICTURES_MAX);
    if (o->size_px < 0) return failure(c, SHERF_BAD_ARGUMENT, "the pictures' size is out of range");
    if ((status = sherf_dataset_open(c, o->data, &e->data)) != SHERF_OK) return status;
    if ((status = sherf_body_load(c, o->body, &e->body)) != SHERF_OK) return status;
    if ((status = sherf_model_load(c, o->model, &e->model)) != SHERF_OK) return status;
    if (o->lpips && (status = lpips_load(c, o->lpips, &e->lpips)) != SHERF_OK) return status;
    if (o->perceptual && (status = resnet50_load(c, o->perceptual, &e->resnet50)) != SHERF_OK) return status;
    if (!o->lpips)
        log_line(c, SHERF_LOG_INFO, "LPIPS is not computed: no VGG16 weights were given (--lpips)");
    if (!(e->tape = tape_create(c, (tape_options){.backend = backend_of(c)}))) return SHERF_NO_MEMORY;
    status = lpips_place(c, e->lpips, tape_backend(e->tape)->memory);
    if (status == SHERF_OK) status = resnet50_place(c, e->resnet50, tape_backend(e->tape)->memory);
    if (status != SHERF_OK) return status;
    e->report.baselines = o->baselines != 0;
    e->report.pictures = o->pictures;
    e->report.variant = o->variant;
    e->report.plain_mean = selection_is_random(o->observations);
    status = dataset_people(c, e->data, o->people, false, &e->people, &e->people_count);
    if (status != SHERF_OK) return status;
    dataset_body_warn(c, e->data, e->body, o->body, e->people, e->people_count);
    int64_t observations = 0;
    const bool one_pose = e->model->config.kind->one_pose;
    if (one_pose)
        log_line(c, SHERF_LOG_INFO, "model %s shows the observed pose alone: novel poses are left out",
                 e->model->config.kind->name);
    e->selection = mem_zero(c, (size_t)e->people_count, sizeof *e->selection);
    if (!e->selection) return SHERF_NO_MEMORY;
    for (int i = 0; i < e->people_count; i++) {
        status = selection_create(c, e->data, e->people[i], o->observations, o->poses, o->views, o->seed,
                                  &e->selection[i]);
        if (status != SHERF_OK) return status;
        e->selection[i].one_pose = one_pose;
        e->selection[i].pictures = o->pictures;
        if (o->pictures > e->selection[i].all_views)
            return failure(
                c, SHERF_BAD_ARGUMENT, "%s has %d views, which are no %d pictures of an observation",
                sherf_dataset_person(e->data, e->people[i]), e->selection[i].all_views, o->pictures);
        e->total += selection_pairs(&e->selection[i]);
        observations += e->selection[i].observations;
    }
    if (!e->total) return failure(c, SHERF_BAD_ARGUMENT, "%s: no picture is left to compare with", o->data);
    if (o->output) {
        e->folder_is_new = !path_is_folder(o->output);
        if ((status = folder_make(c, o->output)) != SHERF_OK) return status;
    }
    if (o->sheet) { /* it may go into that folder */
        const int rows = observations < SHEET_ROWS_MAX ? (int)observations : SHEET_ROWS_MAX;
        if ((status = output_try(c, o->sheet)) != SHERF_OK) return status;
        if ((status = sheet_create(c, rows, &e->sheet)) != SHERF_OK) return status;
    }
    return SHERF_OK;
}

/* ---- one picture ---- */

/* The crops that are compared, and where. */
typedef struct {
    uint8_t *mask;
    rectangle r;
    float *truth, *prediction; /* r.height x r.width x 3, black outside the mask; NULL: the box is outside the
                                  picture */
} comparison;

static void comparison_free(comparison *k) {
    mem_free(k->mask);
    mem_free(k->truth);
}

/* A picture whose mask is empty or full does not show the person. */
static sherf_status truth_check(evaluation *e, const data_view *truth, const posed_body *posed, int person,
                                picture p) {
    context quiet = {.threads = 1}, *c = e->c;
    sherf_status status = dataset_view_check_mask(c, e->data, person, p.pose, p.view, truth);
    if (status == SHERF_OK) return status;
    for (size_t i = 0, n = (size_t)truth->image.width * (size_t)truth->image.height; i < n; i++)
        if (truth->mask[i]) return status;
    const sherf_status seen = body_in_picture(&quiet, e->body, posed, &truth->camera, NULL);
    return seen == SHERF_MISMATCH ? SHERF_OK : status;
}

static sherf_status compare_with(evaluation *e, const data_view *truth, int person, picture p,
                                 comparison *k) {
    context *c = e->c;
    const int width = truth->image.width, height = truth->image.height;
    const sherf_pose *pose = &truth->pose;
    float min_world[3], max_world[3];
    posed_body *posed = NULL;
    *k = (comparison){.mask = mem_zero(c, (size_t)width * (size_t)height, 1)};
    if (!k->mask) return SHERF_NO_MEMORY;
    sherf_status status =
        posed_body_create(c, e->body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, &posed);
    if (status != SHERF_OK) return status;
    body_world_box(e->body, posed, min_world, max_world);
    status = truth_check(e, truth, posed, person, p);
    posed_body_free(posed);
    if (status != SHERF_OK) return status;
    box_ray_mask(&truth->camera, min_world, max_world, k->mask);
    if (!mask_bounds(k->mask, width, height, &k->r) || k->r.width < METRIC_SSIM_WINDOW ||
        k->r.height < METRIC_SSIM_WINDOW)
        return SHERF_OK;
    size_t n = (size_t)k->r.width * (size_t)k->r.height * 3;
    if (!(k->truth = mem_alloc(c, 2 * n, sizeof *k->truth))) return SHERF_NO_MEMORY;
    k->prediction = k->truth + n;
    masked_crop(truth->image.data, k->mask, width, k->r, k->truth);
    return SHERF_OK;
}

/* One of the two distances; NaN if its network is missing or the rectangle is too small for it. */
static sherf_status distance(evaluation *e, const comparison *k, bool lpips, double *out) {
    const int64_t shape[3] = {k->r.height, k->r.width, 3};
    const int min = lpips ? LPIPS_SIDE_MIN : RESNET50_SIDE_MIN;
    *out = NAN;
    if (!(lpips ? (void *)e->lpips : (void *)e->resnet50) || k->r.width < min || k->r.height < min)
        return SHERF_OK;
    tensor *a = tape_input(e->tape, k->prediction, 3, shape), *b = tape_input(e->tape, k->truth, 3, shape);
    tensor *d =
        lpips ? lpips_distance(e->tape, e->lpips, a, b) : resnet50_distance(e->tape, e->resnet50, a, b);
    sherf_status status = tape_status(e->tape);
    if (status == SHERF_OK) *out = tape_value(e->tape, d);
    tape_reset(e->tape);
    return status;
}

/* network.md: PSNR over the pixels of the projected box; SSIM and the distances on its bounding rectangle
 * with everything outside the box mask black. All NaN when the box is not in the picture. */
static sherf_status score(evaluation *e, comparison *k, const float *prediction, const data_view *truth,
                          picture_score *out) {
    const int width = truth->image.width, height = truth->image.height;
    *out = (picture_score){NAN, NAN, NAN, NAN};
    if (!k->truth) return SHERF_OK;
    masked_crop(prediction, k->mask, width, k->r, k->prediction);
    sherf_status status =
        metric_ssim(e->c, k->r.width, k->r.height, 3, k->prediction, k->truth, metric_ssim_range, &out->ssim);
    if (status == SHERF_OK) status = distance(e, k, true, &out->lpips);
    if (status == SHERF_OK) status = distance(e, k, false, &out->resnet50);
    out->psnr = metric_psnr((int64_t)width * height, prediction, truth->image.data, k->mask);
    if (e->options->round_psnr) out->psnr = rint(out->psnr * 1000) / 1000;
    return status;
}

/* The two baselines; the painted body stays in e->painted. */
static sherf_status score_baselines(evaluation *e, comparison *k, const data_view *truth,
                                    const sherf_camera *camera, const sherf_pose *pose, report_entry *entry) {
    context *c = e->c;
    const int width = truth->image.width, height = truth->image.height;
    if (e->painted.width != width || e->painted.height != height) {
        sherf_image_free(&e->painted);
        e->painted =
            (sherf_image){width, height, 3, mem_alloc(c, (size_t)width * (size_t)height, 3 * sizeof(float))};
        if (!e->painted.data) return SHERF_NO_MEMORY;
    }
    baseline_mean_color(&e->baselines, truth, e->painted.data);
    sherf_status status = score(e, k, e->painted.data, truth, &entry->score[SCORE_MEAN_COLOR]);
    if (status == SHERF_OK)
        status = baseline_painted_body(c, &e->baselines, e->body, camera, pose, e->painted.data);
    if (status == SHERF_OK) status = score(e, k, e->painted.data, truth, &entry->score[SCORE_PAINTED_BODY]);
    return status;
}

static char *file_name(evaluation *e, const report_entry *r, const char *suffix) {
    char *name = mem_format(e->c, "%s_obs%d_%d_pose%d_view%02d%s", sherf_dataset_person(e->data, r->person),
                            r->observation.pose, r->observation.view, r->target.pose, r->target.view, suffix);
    for (char *p = name; p && *p; p++)
        if (*p == '/' || *p == '\\' || (unsigned char)*p < 0x21) *p = '_';
    if (name && name[0] == '.') name[0] = '_';
    return name;
}

/* Prediction on the left, ground truth beside it, then the painted body if there is one. */
static sherf_status write_pictures(evaluation *e, const char *path, const data_view *truth) {
    const float *const part[] = {e->frame.color.data, truth->image.data, e->painted.data};
    const size_t parts = e->options->baselines ? 3 : 2;
    const size_t row = 3 * (size_t)truth->image.width, height = (size_t)truth->image.height;
    uint8_t *all = mem_alloc(e->c, row * height, parts);
    if (!all) return SHERF_NO_MEMORY;
    for (size_t y = 0; y < height; y++)
        for (size_t k = 0; k < parts; k++)
            for (size_t x = 0; x < row; x++)
                all[(y * parts + k) * row + x] = float_to_u8(part[k][y * row + x]);
    sherf_status status = png_write(e->c, path, (int)parts * truth->image.width, (int)height, 3, all);
    mem_free(all);
    return status;
}

static sherf_status write_files(evaluation *e, const data_view *truth, report_entry *entry) {
    context *c = e->c;
    const sherf_eval_options *o = e->options;
    const int64_t shape[3] = {truth->image.height, truth->image.width, 3};
    char path[PATH_LENGTH];
    sherf_status status = SHERF_OK;
    for (int i = 0; i < 2 && status == SHERF_OK; i++) {
        if (!o->output || !(i ? o->write_png : o->write_npy)) continue;
        char *name = file_name(e, entry, i ? ".png" : ".npy");
        if (!name) return SHERF_NO_MEMORY;
        *(i ? &entry->png : &entry->rgb) = name;
        if (snprintf(path, sizeof path, "%s/%s", o->output, name) >= (int)sizeof path)
            return failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", o->output);
        status = i ? write_pictures(e, path, truth) : npy_write_f32(c, path, 3, shape, e->frame.color.data);
    }
    return status;
}

/* Prediction and truth of a pair, as they are compared. */
static sherf_status show_pair(evaluation *e, const comparison *k, const data_view *truth, int pair) {
    context *c = e->c;
    if (!k->truth) return SHERF_OK;
    sherf_status status = sheet_put(c, &e->sheet, e->sheet_row, 1 + 2 * pair, &e->frame.color, k->r);
    if (status == SHERF_OK) status = sheet_put(c, &e->sheet, e->sheet_row, 2 + 2 * pair, &truth->image, k->r);
    return status;
}

static sherf_status show_observation(evaluation *e, const sherf_observation *o) {
    rectangle r;
    const int width = o->image.width, height = o->image.height;
    if (!mask_bounds(o->mask, width, height, &r)) return SHERF_OK;
    const int margin = (r.width > r.height ? r.width : r.height) / 16;
    r = (rectangle){r.left - margin, r.top - margin, r.width + 2 * margin, r.height + 2 * margin};
    return sheet_put(e->c, &e->sheet, e->sheet_row, 0, &o->image, r);
}

/* Adds to the message whose picture failed. */
static sherf_status named(evaluation *e, sherf_status status, int person, picture p) {
    if (status == SHERF_OK || status == SHERF_NO_MEMORY || status == SHERF_CANCELLED) return status;
    return failure_prefix(e->c, status, "%s, pose %d, view %d", sherf_dataset_person(e->data, person), p.pose,
                          p.view);
}

/* A target's camera and pose; with an estimator, in the estimate's world. */
static sherf_status target_of(evaluation *e, const data_view *truth, const report_entry *entry,
                              sherf_camera *camera, sherf_pose *pose) {
    *camera = truth->camera;
    *pose = truth->pose;
    if (!e->estimator) return SHERF_OK;
    carried_camera(&e->carried, &truth->camera, camera);
    return carried_pose(e->c, &e->carried, e->body, &truth->pose,
                        e->options->own_pose && entry->target.pose == entry->observation.pose, pose);
}

/* pair: where on the sheet; -1: not on it. */
static sherf_status evaluate_picture(evaluation *e, const sherf_avatar *avatar, report_entry entry,
                                     int pair) {
    context *c = e->c;
    data_view *truth = NULL;
    comparison k = {0};
    sherf_camera camera;
    sherf_pose pose;
    sherf_status status = dataset_view(c, e->data, entry.person, entry.target.pose, entry.target.view,
                                       e->options->size_px, &truth);
    if (status != SHERF_OK) return status;
    if ((status = target_of(e, truth, &entry, &camera, &pose)) != SHERF_OK) goto done;
    if (e->frame.color.width != truth->image.width || e->frame.color.height != truth->image.height)
        sherf_frame_free(&e->frame);
    const sherf_render_options how = {.samples =
                                          e->options->samples ? e->options->samples : SHERF_SAMPLES_MODEL,
                                      .exact = c->precision == SHERF_PRECISION_FP32 && !e->options->baked,
                                      .detail = e->options->detail ? e->options->detail : SHERF_DETAIL_OFF};
    status = sherf_render(c, avatar, e->body, &pose, &camera, &how, &e->frame);
    if ((status = named(e, status, entry.person, entry.target)) != SHERF_OK) goto done;
    if ((status = compare_with(e, truth, entry.person, entry.target, &k)) != SHERF_OK) goto done;
    if ((status = score(e, &k, e->frame.color.data, truth, &entry.score[SCORE_MODEL])) != SHERF_OK) goto done;
    if ((status = regions_measure(c, e->body, e->shown, truth, e->frame.color.data, &entry.regions)))
        goto done;
    if (e->options->baselines && (status = score_baselines(e, &k, truth, &camera, &pose, &entry)) != SHERF_OK)
        goto done;
    if (isnan(entry.score[SCORE_MODEL].psnr)) {
        log_line(c, SHERF_LOG_WARNING, "%s: the person of pose %d is outside view %d, which is left out",
                 sherf_dataset_person(e->data, entry.person), entry.target.pose, entry.target.view);
        goto done;
    }
    if (pair >= 0 && (status = show_pair(e, &k, truth, pair)) != SHERF_OK) goto done;
    if ((status = write_files(e, truth, &entry)) != SHERF_OK) goto done;
    if ((status = report_add(c, &e->report, &entry)) != SHERF_OK) goto done;
    entry.rgb = entry.png = NULL;
done:
    mem_free(entry.rgb);
    mem_free(entry.png);
    comparison_free(&k);
    sherf_observation_free(truth);
    return status;
}

/* ---- one observation, and all the pictures it is compared with ---- */
static int observation_targets(const selection *s, int i) {
    int count = 0;
    bool novel_pose;
    for (int p = 0; p < s->poses; p++)
        for (int v = 0; v < s->views; v++)
            count += selection_target(s, i, (picture){s->pose[p], s->view[v]}, &novel_pose);
    return count;
}

/* The sheet's pair that target n of `count` takes, so that pairs are spread evenly. */
static int sheet_pair(const evaluation *e, int n, int count) {
    if (!e->sheet.rgb) return -1;
    const int pairs = count < SHEET_PAIRS ? count : SHEET_PAIRS, pair = n * pairs / count;
    return n == (2 * pair + 1) * count / (2 * pairs) ? pair : -1;
}

/* Replaces the observation by an estimate from the picture alone, at the protocol's size, and records its
 * errors; *o NULL: nobody was found. first: targets are mapped to its world. */
static sherf_status estimate(evaluation *e, int person, picture from, bool first, sherf_observation **o) {
    context *c = e->c;
    sherf_observation *truth = *o, *found = NULL;
    estimate_entry entry = {.person = person, .observation = from};
    sherf_status status =
        estimated_observation(c, e->estimator, e->data, person, from.pose, from.view, truth, &found);
    if (status == SHERF_OK && found) status = estimated_error(c, e->body, truth, found, &entry.error);
    if (status == SHERF_OK && found && first) status = carried_create(c, e->body, truth, found, &e->carried);
    if (status == SHERF_OK && found) status = estimate_list_add(c, &e->report.estimates, &entry);
    if (status == SHERF_OK && !found) {
        log_line(c, SHERF_LOG_WARNING, "%s: nobody was found in pose %d, view %d, which is left out",
                 sherf_dataset_person(e->data, person), from.pose, from.view);
        e->report.estimates.missed++;
    }
    sherf_observation_free(truth);
    if (status != SHERF_OK) sherf_observation_free(found), found = NULL;
    *o = found;
    return named(e, status, person, from);
}

/* Makes an observation's picture for the network; *out NULL: an estimate was requested and nobody was found.
 * Adds the parts that it shows to e->shown. */
static sherf_status observe(evaluation *e, int person, picture from, bool first, sherf_observation **out) {
    context *c = e->c;
    uint8_t *shown = NULL;
    sherf_status status =
        dataset_observation(c, e->data, person, from.pose, from.view, e->options->size_px, out);
    if (status == SHERF_OK) status = regions_look(c, e->body, *out, &shown);
    if (status == SHERF_OK && e->estimator) status = estimate(e, person, from, first, out);
    if (status == SHERF_OK && *out) regions_join(e->body, &shown, &e->shown);
    mem_free(shown);
    return status;
}

/* The pictures in which a person was found; *count 0: none in the first one. */
static sherf_status observe_all(evaluation *e, const selection *s, int i,
                                sherf_observation *out[SHERF_PICTURES_MAX], int *count) {
    sherf_status status = SHERF_OK;
    mem_free(e->shown);
    e->shown = NULL;
    for (int k = 0; status == SHERF_OK && (!k || (k < s->pictures && *count)); k++) {
        status = observe(e, s->person, selection_picture(s, i, k), !k, &out[*count]);
        if (out[*count]) ++*count;
    }
    return status;
}

/* Makes the avatar. If frames have detail, it uses pictures cropped and scaled for the network, as users do;
 * otherwise it uses unscaled pictures, as in the paper. */
static sherf_status make_avatar(evaluation *e, int pictures, sherf_observation *const *observation,
                                sherf_avatar **out) {
    context *c = e->c;
    sherf_observation *cropped[SHERF_PICTURES_MAX] = {NULL};
    const bool crop = e->options->detail && e->options->detail != SHERF_DETAIL_OFF;
    sherf_status status = SHERF_OK;
    for (int k = 0; k < pictures && crop && status == SHERF_OK; k++)
        status = sherf_observation_crop(c, e->model, e->body, observation[k], &cropped[k]);
    if (status == SHERF_OK)
        status = avatar_create(c, e->model, e->body, pictures,
                               (const sherf_observation *const *)(crop ? cropped : observation),
                               e->options->batch_statistics != 0, out);
    for (int k = 0; k < pictures; k++) sherf_observation_free(cropped[k]);
    return status;
}

/* Replaces the avatar by its baked form. */
static sherf_status bake(evaluation *e, sherf_avatar **avatar) {
    const sherf_bake_options how = {.detail = e->options->detail ? e->options->detail : SHERF_DETAIL_OFF};
    sherf_avatar *baked = NULL;
    sherf_status status = sherf_avatar_bake(e->c, *avatar, e->body, &how, &baked);
    sherf_avatar_free(*avatar);
    *avatar = baked;
    return status;
}

static sherf_status evaluate_observation(evaluation *e, const selection *s, int i) {
    context *c = e->c;
    sherf_observation *observation[SHERF_PICTURES_MAX] = {NULL};
    sherf_avatar *avatar = NULL;
    picture from = s->observation[i];
    int pictures = 0;
    sherf_status status = observe_all(e, s, i, observation, &pictures);
    if (status != SHERF_OK) goto done;
    if (!pictures) {
        e->done += observation_targets(s, i);
        e->sheet_row++;
        goto done;
    }
    baselines_free(&e->baselines);
    if (e->options->baselines) status = baselines_create(c, e->body, observation[0], &e->baselines);
    if (status == SHERF_OK) status = make_avatar(e, pictures, observation, &avatar);
    if (status == SHERF_OK && e->options->variant)
        status = sherf_avatar_choose(c, avatar, e->options->variant);
    if (status == SHERF_OK && e->options->baked) status = bake(e, &avatar);
    if ((status = named(e, status, s->person, from)) != SHERF_OK) goto done;
    if (!e->estimator) /* estimates have a world of their own */
        status = (e->options->surfaces ? surface_list_bake : surface_list_measure)(
            c, &e->report.surfaces, e->data, e->body, avatar, s->person, from);
    if ((status = named(e, status, s->person, from)) != SHERF_OK) goto done;
    if (e->sheet.rgb && (status = show_observation(e, observation[0])) != SHERF_OK) goto done;
    const int targets = observation_targets(s, i);
    int target = 0;
    for (int p = 0; p < s->poses; p++)
        for (int v = 0; v < s->views; v++) {
            report_entry entry = {
                .person = s->person, .observation = from, .target = {s->pose[p], s->view[v]}};
            if (!selection_target(s, i, entry.target, &entry.novel_pose)) continue;
            const int pair = sheet_pair(e, target++, targets);
            if ((status = evaluate_picture(e, avatar, entry, pair)) != SHERF_OK) goto done;
            status = progress(c, "pictures", (double)++e->done, (double)e->total);
            if (status != SHERF_OK) goto done;
        }
    e->sheet_row++;
done:
    sherf_avatar_free(avatar);
    for (int k = 0; k < pictures; k++) sherf_observation_free(observation[k]);
    return status;
}

sherf_status sherf_eval(sherf_context *c, const sherf_eval_options *options, sherf_scores *out) {
    *out = (sherf_scores){0};
    if (!options->estimated) return eval_run(c, options, NULL, out);
    photo_estimator e = {0};
    sherf_body *body = NULL;
    sherf_status status = sherf_estimator_load(c, options->estimated, &e.networks);
    if (!status) status = sherf_body_load(c, options->body, &body);
    e.body = body;
    if (!status) status = eval_run(c, options, &(eval_estimator){estimate_by_photo, &e}, out);
    sherf_body_free(body);
    sherf_estimator_free(e.networks);
    return status;
}

static sherf_estimate_scores estimate_scores(const estimate_list *l) {
    const estimate_summary s = estimate_list_summary(l, -1);
    return (sherf_estimate_scores){.count = s.count,
                                   .missed = l->missed,
                                   .wrong_way = s.wrong_way,
                                   .joints_mm = s.mean.joints_mm,
                                   .aligned_mm = s.mean.aligned_mm,
                                   .lean_deg = s.mean.lean_deg,
                                   .forward_deg = s.mean.forward_deg,
                                   .turn_deg = s.mean.turn_deg,
                                   .overlap = s.mean.overlap,
                                   .overlap_min = s.worst.overlap};
}

/* `text` below `table`, which go; NULL where either is. */
static char *table_join(context *c, char *table, char *text) {
    char *both = table && text ? mem_format(c, "%s\n%s", table, text) : NULL;
    mem_free(table);
    mem_free(text);
    return both;
}

/* The tables, one below the other. */
static char *whole_table(const evaluation *e) {
    const surface_list *surfaces = &e->report.surfaces;
    char *all = report_table(e->c, &e->report, e->data);
    if (all && e->estimator)
        all = table_join(e->c, all, estimate_list_table(e->c, &e->report.estimates, e->data));
    if (all && (surfaces->count || surfaces->missed))
        all = table_join(e->c, all, surface_list_text(e->c, surfaces));
    return all;
}

static sherf_surface_scores surface_means(const surface_list *l) {
    int64_t count;
    const surface_scores s = surface_list_mean(l, -1, &count);
    return (sherf_surface_scores){(int)count,           (int)l->missed, 100 * s.chamfer_m, 100 * s.to_truth_m,
                                  100 * s.from_truth_m, s.normal_deg,   s.overlap};
}

sherf_status eval_run(context *c, const sherf_eval_options *options, const eval_estimator *estimator,
                      sherf_scores *out) {
    evaluation e = {.c = c, .options = options, .estimator = estimator};
    char path[PATH_LENGTH];
    const sherf_precision precision = c->precision;
    *out = (sherf_scores){0};
    c->precision = options->precision == SHERF_PRECISION_AUTO ? SHERF_PRECISION_FP32
                                                              : precision_resolve(c, options->precision);
    sherf_status status = evaluation_open(&e);
    for (int i = 0; i < e.people_count && status == SHERF_OK; i++)
        for (int k = 0; k < e.selection[i].observations && status == SHERF_OK; k++)
            status = evaluate_observation(&e, &e.selection[i], k);
    if (status == SHERF_OK && !e.report.count && e.report.estimates.missed)
        status =
            failure(c, SHERF_MISMATCH, "%s: nobody was found in any of the observed pictures", options->data);
    if (status == SHERF_OK && !e.report.count)
        status =
            failure(c, SHERF_MISMATCH,
                    "%s: the person is in none of the pictures: cameras and bodies do not belong together "
                    "(metres? see sherf check)",
                    options->data);
    if (status == SHERF_OK && e.sheet.rgb) status = sheet_write(c, &e.sheet, options->sheet);
    if (status != SHERF_OK) goto done;
    if (options->output) {
        if (snprintf(path, sizeof path, "%s/scores.json", options->output) >= (int)sizeof path) {
            status = failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", options->output);
            goto done;
        }
        if ((status = report_write_json(c, &e.report, e.data, path)) != SHERF_OK) goto done;
    }
    if (options->surfaces && !e.report.surfaces.count && !e.report.surfaces.missed)
        log_line(c, SHERF_LOG_WARNING, "%s: no surfaces are compared: %s", options->data,
                 estimator ? "estimates have a world of their own" : "the data set has none");
    char *table = whole_table(&e);
    if (!table) {
        status = SHERF_NO_MEMORY;
        goto done;
    }
    const report *r = &e.report;
    *out =
        (sherf_scores){report_mean(r, SCORE_MODEL, -1, false), report_mean(r, SCORE_MODEL, -1, true), table};
    for (int pose = 0; pose < 2 && r->baselines; pose++) {
        out->mean_color[pose] = report_mean(r, SCORE_MEAN_COLOR, -1, pose);
        out->painted_body[pose] = report_mean(r, SCORE_PAINTED_BODY, -1, pose);
    }
    if (estimator) out->estimates = estimate_scores(&r->estimates);
    out->surfaces = surface_means(&r->surfaces);
done:
    if (status != SHERF_OK && e.folder_is_new) rmdir(options->output); /* goes only if nothing is in it */
    evaluation_free(&e);
    c->precision = precision;
    return status;
}
