#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/path.h"
#include "eval/lpips_file.h"
#include "eval/metrics.h"
#include "eval/report.h"

/* Everything an evaluation holds. */
typedef struct {
    context *c;
    const sherf_eval_options *options;
    sherf_dataset *data;
    body_model *body;
    sherf_model *model;
    lpips_network *lpips; /* NULL: not computed */
    tape *tape;           /* of LPIPS */
    int *people, people_count;
    selection *selection; /* one a person */
    int64_t done, total;
    sherf_frame frame;
    report report;
} evaluation;

static void evaluation_free(evaluation *e) {
    for (int i = 0; e->selection && i < e->people_count; i++) selection_free(&e->selection[i]);
    mem_free(e->selection);
    mem_free(e->people);
    report_free(&e->report);
    sherf_frame_free(&e->frame);
    tape_free(e->tape);
    lpips_free(e->lpips);
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
    if ((status = sherf_dataset_open(c, o->data, &e->data)) != SHERF_OK) return status;
    if ((status = sherf_body_load(c, o->body, &e->body)) != SHERF_OK) return status;
    if ((status = sherf_model_load(c, o->model, &e->model)) != SHERF_OK) return status;
    if (o->lpips) {
        if ((status = lpips_load(c, o->lpips, &e->lpips)) != SHERF_OK) return status;
        if (!(e->tape = tape_create(c, (tape_options){.backend = &backend_cpu}))) return SHERF_NO_MEMORY;
    } else {
        log_line(c, SHERF_LOG_INFO, "LPIPS is not computed: no VGG16 weights were given");
    }
    status = dataset_people(c, e->data, o->people, false, &e->people, &e->people_count);
    if (status != SHERF_OK) return status;
    e->selection = mem_zero(c, (size_t)e->people_count, sizeof *e->selection);
    if (!e->selection) return SHERF_NO_MEMORY;
    for (int i = 0; i < e->people_count; i++) {
        status =
            selection_create(c, e->data, e->people[i], o->observations, o->poses, o->views, &e->selection[i]);
        if (status != SHERF_OK) return status;
        e->total += selection_pairs(&e->selection[i]);
    }
    if (!e->total) return failure(c, SHERF_BAD_ARGUMENT, "%s: no picture is left to compare with", o->data);
    return o->output ? folder_make(c, o->output) : SHERF_OK;
}

/* ---- one picture ---- */

static sherf_status lpips_score(evaluation *e, rectangle r, const float *a, const float *b, double *out) {
    const int64_t shape[3] = {r.height, r.width, 3};
    *out = NAN;
    if (!e->lpips || r.width < LPIPS_SIDE_MIN || r.height < LPIPS_SIDE_MIN) return SHERF_OK;
    tensor *d =
        lpips_distance(e->tape, e->lpips, tape_input(e->tape, a, 3, shape), tape_input(e->tape, b, 3, shape));
    sherf_status status = tape_status(e->tape);
    if (status == SHERF_OK) *out = *tensor_f32(d);
    tape_reset(e->tape);
    return status;
}

/* network.md: PSNR over the pixels of the projected box; SSIM and LPIPS on its bounding rectangle with
 * everything outside the box mask black. psnr is NaN when the box is not in the picture. */
static sherf_status score(evaluation *e, const float *prediction, const data_view *truth,
                          report_entry *entry) {
    context *c = e->c;
    const int width = truth->image.width, height = truth->image.height;
    float min_world[3], max_world[3];
    float *crop = NULL;
    posed_body *posed = NULL;
    rectangle r;
    const sherf_pose *p = &truth->pose;
    entry->psnr = entry->ssim = entry->lpips = NAN;
    uint8_t *mask = mem_zero(c, (size_t)width * (size_t)height, 1);
    if (!mask) return SHERF_NO_MEMORY;
    sherf_status status = posed_body_create(c, e->body, p->poses_rad, p->shapes, p->R, p->Th_m, &posed);
    if (status != SHERF_OK) goto done;
    body_world_box(e->body, posed, min_world, max_world);
    box_ray_mask(&truth->camera, min_world, max_world, mask);
    if (!mask_bounds(mask, width, height, &r) || r.width < METRIC_SSIM_WINDOW ||
        r.height < METRIC_SSIM_WINDOW)
        goto done;
    size_t n = (size_t)r.width * (size_t)r.height * 3;
    if (!(crop = mem_alloc(c, 2 * n, sizeof *crop))) {
        status = SHERF_NO_MEMORY;
        goto done;
    }
    masked_crop(prediction, mask, width, r, crop);
    masked_crop(truth->image.data, mask, width, r, crop + n);
    status = metric_ssim(c, r.width, r.height, 3, crop, crop + n, metric_ssim_range, &entry->ssim);
    if (status != SHERF_OK) goto done;
    status = lpips_score(e, r, crop, crop + n, &entry->lpips);
    entry->psnr = metric_psnr((int64_t)width * height, prediction, truth->image.data, mask);
done:
    posed_body_free(posed);
    mem_free(crop);
    mem_free(mask);
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

/* Prediction on the left, ground truth on the right. */
static sherf_status write_pair(context *c, const char *path, const float *prediction,
                               const data_view *truth) {
    const size_t width = (size_t)truth->image.width, height = (size_t)truth->image.height;
    uint8_t *pair = mem_alloc(c, width * height, 6);
    if (!pair) return SHERF_NO_MEMORY;
    for (size_t y = 0; y < height; y++)
        for (size_t x = 0; x < 3 * width; x++) {
            pair[y * 6 * width + x] = float_to_u8(prediction[y * 3 * width + x]);
            pair[y * 6 * width + 3 * width + x] = float_to_u8(truth->image.data[y * 3 * width + x]);
        }
    sherf_status status = png_write(c, path, 2 * (int)width, (int)height, 3, pair);
    mem_free(pair);
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
        status = i ? write_pair(c, path, e->frame.color.data, truth)
                   : npy_write_f32(c, path, 3, shape, e->frame.color.data);
    }
    return status;
}

static sherf_status evaluate_picture(evaluation *e, const sherf_avatar *avatar, report_entry entry) {
    context *c = e->c;
    data_view *truth = NULL;
    sherf_status status =
        dataset_view(c, e->data, entry.person, entry.target.pose, entry.target.view, 0, &truth);
    if (status != SHERF_OK) return status;
    if (e->frame.color.width != truth->image.width || e->frame.color.height != truth->image.height)
        sherf_frame_free(&e->frame);
    status = sherf_render(c, avatar, e->body, &truth->pose, &truth->camera, NULL, &e->frame);
    if (status != SHERF_OK) goto done;
    if ((status = score(e, e->frame.color.data, truth, &entry)) != SHERF_OK) goto done;
    if (isnan(entry.psnr)) {
        log_line(c, SHERF_LOG_WARNING, "%s: the person of pose %d is outside view %d, which is left out",
                 sherf_dataset_person(e->data, entry.person), entry.target.pose, entry.target.view);
        goto done;
    }
    if ((status = write_files(e, truth, &entry)) != SHERF_OK) goto done;
    if ((status = report_add(c, &e->report, &entry)) != SHERF_OK) goto done;
    entry.rgb = entry.png = NULL;
done:
    mem_free(entry.rgb);
    mem_free(entry.png);
    sherf_observation_free(truth);
    return status;
}

/* ---- one observation, and all the pictures it is compared with ---- */
static sherf_status evaluate_observation(evaluation *e, const selection *s, int i) {
    context *c = e->c;
    sherf_observation *observation = NULL;
    sherf_avatar *avatar = NULL;
    picture from = s->observation[i];
    sherf_status status =
        sherf_dataset_observation(c, e->data, s->person, from.pose, from.view, &observation);
    if (status != SHERF_OK) goto done;
    if ((status = sherf_avatar_create(c, e->model, e->body, observation, &avatar)) != SHERF_OK) goto done;
    for (int p = 0; p < s->poses; p++)
        for (int v = 0; v < s->views; v++) {
            report_entry entry = {
                .person = s->person, .observation = from, .target = {s->pose[p], s->view[v]}};
            if (!selection_target(s, i, entry.target, &entry.novel_pose)) continue;
            if ((status = evaluate_picture(e, avatar, entry)) != SHERF_OK) goto done;
            status = progress(c, "pictures", (double)++e->done, (double)e->total);
            if (status != SHERF_OK) goto done;
        }
done:
    sherf_avatar_free(avatar);
    sherf_observation_free(observation);
    return status;
}

sherf_status sherf_eval(sherf_context *c, const sherf_eval_options *options, sherf_scores *out) {
    evaluation e = {.c = c, .options = options};
    char path[PATH_LENGTH];
    const sherf_precision precision = c->precision;
    *out = (sherf_scores){0};
    c->precision = options->precision == SHERF_PRECISION_AUTO ? SHERF_PRECISION_FP32 : options->precision;
    sherf_status status = evaluation_open(&e);
    for (int i = 0; i < e.people_count && status == SHERF_OK; i++)
        for (int k = 0; k < e.selection[i].observations && status == SHERF_OK; k++)
            status = evaluate_observation(&e, &e.selection[i], k);
    if (status != SHERF_OK) goto done;
    if (options->output) {
        if (snprintf(path, sizeof path, "%s/scores.json", options->output) >= (int)sizeof path) {
            status = failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", options->output);
            goto done;
        }
        if ((status = report_write_json(c, &e.report, e.data, path)) != SHERF_OK) goto done;
    }
    char *table = report_table(c, &e.report, e.data);
    if (!table) {
        status = SHERF_NO_MEMORY;
        goto done;
    }
    *out = (sherf_scores){report_mean(&e.report, -1, false), report_mean(&e.report, -1, true), table};
done:
    evaluation_free(&e);
    c->precision = precision;
    return status;
}
