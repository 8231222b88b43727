/* sherf bench: how long an avatar, a frame and a training step take, on the built-in tube person with made-up
 * weights, and the work that people wait for (bench_real.c). Reports medians of the repeats. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "synth/tube/tubeman.h"
#include "tensor/block.h"
#include "train/bench.h"

enum { SIDE_MAX = 8192 };

/* ---- the tube person, photographed ---- */

/* Arms down, legs apart by this angle as in a stride, and arms swinging against them. */
static void stride(float angle_rad, sherf_pose *out) {
    sherf_pose_identity(out);
    out->poses_rad[3 * 16 + 2] = -1.1f;
    out->poses_rad[3 * 17 + 2] = 1.1f;
    out->poses_rad[3 * 16 + 1] = angle_rad;
    out->poses_rad[3 * 17 + 1] = angle_rad;
    out->poses_rad[3 * 1] = -angle_rad;
    out->poses_rad[3 * 2] = angle_rad;
    out->poses_rad[3 * 5] = angle_rad / 2;
}

/* A camera in which the body's larger extent takes 90 % of the picture. */
static sherf_status frame_camera(context *c, const body_model *body, const sherf_pose *pose,
                                 float azimuth_rad, int size, sherf_camera *out) {
    const float fov = 0.7f;
    float low[3], high[3], centre[3], extent = 0, depth = 0;
    posed_body *posed = NULL;
    sherf_status status =
        posed_body_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, &posed);
    if (status != SHERF_OK) return status;
    body_world_box(body, posed, low, high);
    posed_body_free(posed);
    for (int k = 0; k < 3; k++) {
        centre[k] = (low[k] + high[k]) / 2;
        extent = fmaxf(extent, high[k] - low[k]);
    }
    depth = (high[2] - low[2]) / 2;
    sherf_camera_orbit(centre, extent / 2 / 0.9f / tanf(fov / 2) + depth, azimuth_rad, 0, fov, size, size,
                       out);
    return SHERF_OK;
}

static void paint(const raster *r, const body_model *body, sherf_image *image, sherf_image *mask) {
    const uint64_t key = fnv1a64("bench");
    for (int64_t i = 0; i < (int64_t)r->width * r->height; i++) {
        if (r->face[i] < 0) continue;
        mask->data[i] = 1;
        for (int k = 0; k < 3; k++) {
            float rgb[3];
            tubeman_color(key, (int)body->face[3 * r->face[i] + k], rgb);
            for (int channel = 0; channel < 3; channel++)
                image->data[3 * i + channel] += r->barycentric[3 * i + k] * rgb[channel];
        }
    }
}

static sherf_status photograph(context *c, const body_model *body, const sherf_pose *pose, float azimuth_rad,
                               int size, sherf_observation **out) {
    sherf_camera camera;
    raster *r = NULL;
    const size_t pixels = (size_t)size * (size_t)size;
    sherf_image image = {size, size, 3, mem_zero(c, pixels, 3 * sizeof(float))};
    sherf_image mask = {size, size, 1, mem_zero(c, pixels, sizeof(float))};
    float *vertices = mem_alloc(c, (size_t)body->vertices, 3 * sizeof(float));
    sherf_status status = SHERF_NO_MEMORY;
    if (!image.data || !mask.data || !vertices) goto done;
    if ((status = frame_camera(c, body, pose, azimuth_rad, size, &camera)) != SHERF_OK) goto done;
    if ((status = sherf_body_pose(c, body, pose, vertices, NULL)) != SHERF_OK) goto done;
    status = raster_create(c, &camera, 1, body->vertices, vertices, body->faces, body->face, &r);
    if (status != SHERF_OK) goto done;
    paint(r, body, &image, &mask);
    status = sherf_observation_create(c, &image, &mask, &camera, pose, out);
done:
    raster_free(r);
    mem_free(vertices);
    mem_free(mask.data);
    mem_free(image.data);
    return status;
}

/* ---- timing ---- */
static void bench_free(bench *b) {
    model_free(b->model);
    sherf_observation_free(b->target);
    sherf_observation_free(b->observation);
    sherf_body_free(b->body);
}

static sherf_status bench_open(bench *b) {
    context *c = b->c;
    model_config config;
    sherf_pose seen, shown;
    stride(0.2f, &seen);
    stride(0.6f, &shown);
    sherf_status status = model_config_parse(c, b->preset, &config);
    if (status == SHERF_OK && config.kind->one_pose) shown = seen;
    if (status == SHERF_OK) status = model_create(c, &config, 1, &b->model);
    if (status == SHERF_OK) status = model_place(c, b->model);
    if (status == SHERF_OK) status = tubeman_create(c, &b->body);
    if (status == SHERF_OK) status = photograph(c, b->body, &seen, 0.2f, b->size, &b->observation);
    if (status == SHERF_OK) status = photograph(c, b->body, &shown, 0.8f, b->size, &b->target);
    return status;
}

/* ---- render ---- */
static sherf_status avatar_once(bench *b, void *arg) {
    sherf_avatar **avatar = arg;
    sherf_avatar_free(*avatar);
    *avatar = NULL;
    return sherf_avatar_create(b->c, b->model, b->body, b->observation, avatar);
}

typedef struct {
    sherf_avatar *avatar;
    bool exact;
    sherf_frame frame;
} frame_job;

static sherf_status frame_once(bench *b, void *arg) {
    frame_job *j = arg;
    const sherf_render_options model_steps = {
        .samples = SHERF_SAMPLES_MODEL, .exact = j->exact, .detail = SHERF_DETAIL_OFF};
    return sherf_render(b->c, j->avatar, b->body, &b->target->pose, &b->target->camera, &model_steps,
                        &j->frame);
}

static const char *precision_name(const context *c) {
    return c->precision == SHERF_PRECISION_BF16 ? "bf16" : "fp32";
}

static const char *device_name(const context *c) {
    return c->device == SHERF_DEVICE_CUDA ? "cuda" : "cpu";
}

/* For people: the GPU's name, or the processor's instructions. */
static const char *device_text(const context *c, char text[200]) {
    if (c->device != SHERF_DEVICE_CUDA || sherf_device_find(c->device, text, 200) != SHERF_OK)
        snprintf(text, 200, "%s", isa_name(isa_best()));
    return text;
}

/* Of the device's memory on a GPU, and otherwise the resident set. */
static double peak_mb(const context *c) {
    const tensor_memory *memory = backend_of(c)->memory;
    return (double)(memory ? memory->peak() : memory_peak_bytes()) / 1e6;
}

static const char *peak_name(const context *c) {
    return c->device == SHERF_DEVICE_CUDA ? "gpu" : "rss";
}

/* Appends the conditions of the measurement. Freed with mem_free. */
static char *setting_json(context *c, const bench_shares *shares) {
    char *told = bench_shares_json(c, shares);
    char *text =
        told ? mem_format(c,
                          "\"precision\": \"%s\", \"device\": \"%s\", \"isa\": \"%s\", \"threads\": %d, %s, "
                          "\"peak_%s_mb\": %.1f}\n",
                          precision_name(c), device_name(c), isa_name(isa_best()), c->threads, told,
                          peak_name(c), peak_mb(c))
             : NULL;
    mem_free(told);
    return text;
}

static char *setting_text(context *c, const bench_shares *shares) {
    char device[200];
    char *told = bench_shares_text(c, shares);
    char *text = told ? mem_format(c, "%s on %s, %d threads, at most %.0f MB; %s", precision_name(c),
                                   device_text(c, device), c->threads, peak_mb(c), told)
                      : NULL;
    mem_free(told);
    return text;
}

/* `begin` followed by the setting; frees begin. */
static sherf_status tell(context *c, int json, const bench_shares *shares, char *begin, char **text) {
    char *setting = json ? setting_json(c, shares) : setting_text(c, shares);
    if (begin && setting) *text = mem_format(c, "%s%s", begin, setting);
    mem_free(begin);
    mem_free(setting);
    return *text ? SHERF_OK : SHERF_NO_MEMORY;
}

static sherf_status bench_render(bench *b, int json, char **text) {
    context *c = b->c;
    frame_job job = {0};
    bench_real_times real = {0};
    bench_shares shares = {0};
    double avatar_ms = 0, frame_ms = 0, exact_ms = 0;
    char *real_text = NULL;
    sherf_status status = bench_timed(b, avatar_once, &job.avatar, &avatar_ms);
    if (status == SHERF_OK) status = bench_timed(b, frame_once, &job, &frame_ms);
    const long long points = (long long)job.frame.points;
    job.exact = true;
    if (status == SHERF_OK) status = bench_timed(b, frame_once, &job, &exact_ms);
    if (status == SHERF_OK) status = bench_encode_shares(b, false, &shares);
    if (status == SHERF_OK) status = bench_network_share(b, job.avatar, &shares);
    if (status == SHERF_OK && bench_has_real(b)) status = bench_real_render(b, &real);
    if (status != SHERF_OK) goto done;
    real_text = !bench_has_real(b) ? mem_string(c, "")
                : json
                    ? mem_format(c,
                                 "\"default_frame_ms\": %.3f, \"default_first_frame_ms\": %.3f, "
                                 "\"default_avatar_ms\": %.3f, ",
                                 real.frame_ms, real.first_frame_ms, real.avatar_ms)
                    : mem_format(c,
                                 "the model that ships, %d px, with detail: a frame %.1f ms, the first one "
                                 "%.1f ms, an avatar %.1f ms\n",
                                 b->size, real.frame_ms, real.first_frame_ms, real.avatar_ms);
    status =
        !real_text ? SHERF_NO_MEMORY
        : json     ? tell(c, json, &shares,
                          mem_format(c,
                                     "{\"what\": \"render\", \"preset\": \"%s\", \"size\": %d, \"frame_ms\": "
                                         "%.3f, \"exact_frame_ms\": %.3f, %s\"avatar_ms\": %.3f, \"points\": %lld, ",
                                     b->preset, b->size, frame_ms, exact_ms, real_text, avatar_ms, points),
                          text)
                   : tell(c, json, &shares,
                          mem_format(
                              c, "%s, %d px: a frame %.1f ms (exact %.1f ms), an avatar %.1f ms, %lld points\n%s",
                              b->preset, b->size, frame_ms, exact_ms, avatar_ms, points, real_text),
                          text);
done:
    mem_free(real_text);
    sherf_frame_free(&job.frame);
    sherf_avatar_free(job.avatar);
    return status;
}

/* ---- avatar, export ---- */
static sherf_status bench_avatar(bench *b, int json, char **text) {
    context *c = b->c;
    sherf_avatar *avatar = NULL;
    bench_shares shares = {0};
    double avatar_ms = 0, real_ms = 0;
    sherf_status status = bench_timed(b, avatar_once, &avatar, &avatar_ms);
    if (status == SHERF_OK) status = bench_encode_shares(b, false, &shares);
    if (status == SHERF_OK && bench_has_real(b)) status = bench_real_avatar(b, &real_ms);
    if (status == SHERF_OK)
        status = tell(c, json, &shares,
                      json ? mem_format(c,
                                        "{\"what\": \"avatar\", \"preset\": \"%s\", \"size\": %d, "
                                        "\"avatar_ms\": %.3f, \"default_avatar_ms\": %.3f, ",
                                        b->preset, b->size, avatar_ms, real_ms)
                           : mem_format(c, "%s, %d px: an avatar %.1f ms; the model that ships %.1f ms\n",
                                        b->preset, b->size, avatar_ms, real_ms),
                      text);
    sherf_avatar_free(avatar);
    return status;
}

static sherf_status bench_export(bench *b, int json, char **text) {
    context *c = b->c;
    const bench_shares shares = {0};
    double ms = 0, part[4];
    if (!bench_has_real(b))
        return failure(c, SHERF_BAD_ARGUMENT,
                       "bench: an export is of a person: model, body and observation "
                       "are wanted");
    const sherf_status status = bench_real_export(b, &ms, part);
    if (status != SHERF_OK) return status;
    return tell(
        c, json, &shares,
        json ? mem_format(c,
                          "{\"what\": \"export\", \"export_ms\": %.1f, \"surface_ms\": %.1f, "
                          "\"reduction_ms\": %.1f, \"skin_ms\": %.1f, \"colors_ms\": %.1f, ",
                          ms, part[0], part[1], part[2], part[3])
             : mem_format(c,
                          "GLB of the model that ships: %.2f s (surface %.2f, reduction %.2f, skin and "
                          "charts %.2f, colours %.2f)\n",
                          ms / 1e3, part[0] / 1e3, part[1] / 1e3, part[2] / 1e3, part[3] / 1e3),
        text);
}

/* ---- bake ---- */
/* Raises the density to that of a person's surface where made-up weights would give haze. */
static void make_dense(model *m) {
    parameter *bias = parameter_find(m->weights, "decoder.alpha_linear.bias");
    if (bias) *tensor_f32(&bias->value) = 100;
}

static sherf_status bench_bake(bench *b, int json, char **text) {
    context *c = b->c;
    frame_job job = {0};
    sherf_avatar *avatar = NULL;
    const bench_shares shares = {0};
    double frame_ms = 0;
    make_dense(b->model);
    sherf_status status = sherf_avatar_create(c, b->model, b->body, b->observation, &avatar);
    const double begun_s = time_seconds();
    if (status == SHERF_OK) status = sherf_avatar_bake(c, avatar, b->body, NULL, &job.avatar);
    const double bake_ms = 1e3 * (time_seconds() - begun_s); /* once: it is seconds */
    if (status == SHERF_OK) status = bench_timed(b, frame_once, &job, &frame_ms);
    if (status == SHERF_OK)
        status = tell(c, json, &shares,
                      json ? mem_format(c,
                                        "{\"what\": \"bake\", \"preset\": \"%s\", \"size\": %d, \"bake_ms\": "
                                        "%.1f, \"baked_frame_ms\": %.3f, ",
                                        b->preset, b->size, bake_ms, frame_ms)
                           : mem_format(c, "%s, %d px: baked in %.2f s, a frame %.2f ms\n", b->preset,
                                        b->size, bake_ms / 1e3, frame_ms),
                      text);
    sherf_frame_free(&job.frame);
    sherf_avatar_free(job.avatar);
    sherf_avatar_free(avatar);
    return status;
}

/* ---- train ---- */
typedef struct {
    sample sample;
    tape *tape;
    adam adam;
    model *average;
    loss_networks networks;
    float *rows; /* losses, in the tape's memory */
    int64_t step;
} step_job;

/* A surface that takes a step as long as any other. */
static sherf_status made_up_surface(context *c, const body_model *body, const posed_body *posed,
                                    int64_t count, surface_draw *out) {
    surface_draw_free(out);
    float *vertex = mem_alloc(c, (size_t)body->vertices, 3 * sizeof *vertex);
    sherf_status status = vertex ? surface_draw_room(c, count, out) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        body_vertices_world(body, posed, vertex);
        for (int64_t i = 0; i < count; i++) {
            memcpy(out->point + 3 * i, vertex + 3 * (i % body->vertices), 3 * sizeof *vertex);
            memcpy(out->place + 3 * i, vertex + 3 * (i % body->vertices), 3 * sizeof *vertex);
            out->inside[i] = (float)(i & 1);
            for (int k = 0; k < 3; k++) out->color[3 * i + k] = 0.5f;
        }
    }
    mem_free(vertex);
    return status;
}

static sherf_status prepare_once(bench *b, void *arg) {
    step_job *j = arg;
    const sherf_observation *o = b->observation, *t = b->target;
    const training_recipe *r = model_recipe(&b->model->config);
    const ray_draw rays = {.count = r ? r->rays : 0,
                           .inside = r ? r->rays_inside : 0,
                           .mask = t->mask,
                           .jitter = r && r->jitter,
                           .key = 1};
    context one = *b->c; /* a loading thread works on its own */
    one.threads = 1;
    observation_geometry_free(j->sample.observation_geometry);
    target_geometry_free(j->sample.target_geometry);
    j->sample.observation_geometry = NULL;
    j->sample.target_geometry = NULL;
    sherf_status status = observation_geometry_create(&one, &b->model->config, b->body, &o->image, &o->camera,
                                                      &o->pose, true, &j->sample.observation_geometry);
    const model_surface_training *surfaces = b->model->config.kind->surfaces;
    if (status == SHERF_OK && surfaces)
        status = made_up_surface(&one, b->body, j->sample.observation_geometry->body,
                                 surfaces->count(&b->model->config), &j->sample.surface);
    else if (status == SHERF_OK)
        status = target_geometry_draw(&one, &b->model->config, b->body, &t->camera, &t->pose,
                                      j->sample.observation_geometry, &rays, &j->sample.target_geometry);
    if (status != SHERF_OK) failure(b->c, status, "%s", one.message);
    return status;
}

static sherf_status step_once(bench *b, void *arg) {
    step_job *j = arg;
    parameters *p = b->model->weights;
    double squares;
    j->sample.drawn.noise_key = (uint64_t)++j->step;
    parameters_zero_grads(p);
    sherf_status status = sample_gradients(j->tape, b->model, b->body, &j->networks, &j->sample, 1, j->rows);
    if (status == SHERF_OK) status = gradients_square_sum(b->c, &j->adam, p->grads, &squares);
    if (status != SHERF_OK) return status;
    if (!isfinite(squares)) return failure(b->c, SHERF_BAD_ARGUMENT, "the step's gradients are not finite");
    status = adam_step(b->c, &j->adam, p->values, p->grads, 1e-4);
    if (status != SHERF_OK) return status;
    return average_update(b->c, p->memory, p->total_floats, j->average->weights->values, p->values,
                          average_decay(j->step));
}

static void made_up(tensor *w, int layer) {
    double bound = sqrt(6.0 / (double)(tensor_count(w) / w->dim[0]));
    for (int64_t k = 0; k < tensor_count(w); k++)
        tensor_f32(w)[k] = (float)(bound * (2 * random_uniform((uint64_t)layer << 32, (uint64_t)k) - 1));
}

static sherf_status made_up_resnet50(context *c, resnet50_network **out) {
    sherf_status status = resnet50_create(c, out);
    for (int i = 0; i < RESNET50_CONVOLUTIONS && status == SHERF_OK; i++) made_up((*out)->weight[i], i);
    return status;
}

static sherf_status made_up_lpips(context *c, lpips_network **out) {
    sherf_status status = lpips_create(c, out);
    for (int i = 0; i < LPIPS_CONVOLUTIONS && status == SHERF_OK; i++) made_up((*out)->weight[i], i);
    for (int i = 0; i < LPIPS_STAGES && status == SHERF_OK; i++)
        for (int64_t k = 0; k < tensor_count((*out)->head[i]); k++) tensor_f32((*out)->head[i])[k] = 1e-3f;
    return status;
}

/* The memory of a training, on the context's device. */
static sherf_status step_open(bench *b, step_job *job, lpips_network *lpips, resnet50_network *resnet50) {
    context *c = b->c;
    const backend *on = backend_of(c);
    sherf_status status = parameters_make_grads(c, b->model->weights);
    if (status == SHERF_OK) status = adam_of_model(c, b->model, 0, &job->adam);
    if (status == SHERF_OK) status = adam_place(c, &job->adam, on->memory);
    if (status == SHERF_OK) status = model_create(c, &b->model->config, 1, &job->average);
    if (status == SHERF_OK) status = model_place(c, job->average);
    if (status == SHERF_OK) status = lpips_place(c, lpips, on->memory);
    if (status == SHERF_OK) status = resnet50_place(c, resnet50, on->memory);
    if (status != SHERF_OK) return status;
    job->rows = block_take(c, on->memory, LOSSES, sizeof *job->rows);
    job->tape = tape_create(c, (tape_options){.backend = on,
                                              .record = true,
                                              .training = true,
                                              .bf16 = c->precision == SHERF_PRECISION_BF16});
    return job->rows && job->tape ? SHERF_OK : SHERF_NO_MEMORY;
}

static void step_close(bench *b, step_job *job) {
    tape_free(job->tape);
    block_give(backend_of(b->c)->memory, job->rows);
    model_free(job->average);
    adam_free(&job->adam);
    observation_geometry_free(job->sample.observation_geometry);
    target_geometry_free(job->sample.target_geometry);
    surface_draw_free(&job->sample.surface);
}

static sherf_status bench_train(bench *b, int json, char **text) {
    context *c = b->c;
    double prepare_ms = 0, step_ms = 0, lpips_ms = 0, resnet50_ms = 0, peak = 0;
    bench_shares shares = {0};
    step_job job = {.sample = {.observation = b->observation, .target = b->target}};
    lpips_network *lpips = NULL;
    resnet50_network *perceptual = NULL;
    sherf_status status = bench_timed(b, prepare_once, &job, &prepare_ms);
    if (status == SHERF_OK) status = made_up_lpips(c, &lpips);
    if (status == SHERF_OK) status = made_up_resnet50(c, &perceptual);
    if (status == SHERF_OK) status = step_open(b, &job, lpips, perceptual);
    if (status == SHERF_OK) status = bench_timed(b, step_once, &job, &step_ms);
    job.networks = (loss_networks){.resnet50 = perceptual};
    if (status == SHERF_OK) status = bench_timed(b, step_once, &job, &resnet50_ms);
    job.networks = (loss_networks){.lpips = lpips};
    if (status == SHERF_OK) status = bench_timed(b, step_once, &job, &lpips_ms);
    peak = peak_mb(c);
    if (status == SHERF_OK) status = bench_encode_shares(b, true, &shares);
    if (status != SHERF_OK) goto done;
    const target_geometry *target = job.sample.target_geometry;
    const long long points = target ? target->points->count : job.sample.surface.points;
    status = tell(
        c, json, &shares,
        json ? mem_format(c,
                          "{\"what\": \"train\", \"preset\": \"%s\", \"size\": %d, \"step_ms\": %.3f, "
                          "\"step_resnet50_ms\": %.3f, \"step_lpips_ms\": %.3f, \"prepare_ms\": %.3f, "
                          "\"points\": %lld, \"peak_%s_lpips_mb\": %.1f, ",
                          b->preset, b->size, step_ms, resnet50_ms, lpips_ms, prepare_ms, points,
                          peak_name(c), peak)
             : mem_format(c,
                          "%s, %d px: a step of one picture %.1f ms (with resnet50 %.1f ms, with LPIPS %.1f "
                          "ms), its preparation by a loading thread %.1f ms, %lld points\n",
                          b->preset, b->size, step_ms, resnet50_ms, lpips_ms, prepare_ms, points),
        text);
done:
    step_close(b, &job);
    lpips_free(lpips);
    resnet50_free(perceptual);
    return status;
}

sherf_status sherf_bench(sherf_context *c, const char *what, const sherf_bench_options *options,
                         char **text) {
    const sherf_bench_options none = {0};
    if (!options) options = &none;
    *text = NULL;
    bench b = {.c = c,
               .preset = options->preset ? options->preset : "paper",
               .size = options->size_px ? options->size_px : 512,
               .repeats = options->repeats,
               .real_model = options->model,
               .real_body = options->body,
               .real_observation = options->observation};
    static const struct {
        const char *name;
        sherf_status (*run)(bench *b, int json, char **text);
    } known[] = {{"render", bench_render},
                 {"avatar", bench_avatar},
                 {"train", bench_train},
                 {"export", bench_export},
                 {"bake", bench_bake}};
    size_t k = 0;
    while (k < COUNT_OF(known) && (!what || strcmp(what, known[k].name))) k++;
    if (k == COUNT_OF(known))
        return failure(c, SHERF_BAD_ARGUMENT,
                       "bench: \"render\", \"avatar\", \"train\", \"export\" or \"bake\" is expected");
    if (b.size < 16 || b.size > SIDE_MAX || b.repeats < 0 || b.repeats > REPEATS_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "bench: sizes are 16 to %d pixels, repeats at most %d",
                       SIDE_MAX, REPEATS_MAX);
    sherf_status status = bench_open(&b);
    if (status == SHERF_OK) status = known[k].run(&b, options->json, text);
    bench_free(&b);
    return status;
}
