/* Striped tube people in the THuman layout, drawn by the rasteriser. Everything follows from the seed. */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "base/path.h"
#include "data/surface_truth.h"
#include "data/thuman_write.h"
#include "synth/tube/tubeman.h"

enum { PEOPLE_MAX = 10000, POSES_MAX = 10000, VIEWS_MAX = 100, SIDE_MIN = 16, SIDE_MAX = 2048, SAMPLES = 2 };

typedef struct {
    sherf_synth_options o;
    const body_model *body;
    float (*color)[3];    /* V, of the current person */
    sherf_camera *camera; /* views, of the current person */
    char folder[PATH_LENGTH];
} synth_job;

/* Uniform in [low, high]. */
static float between(uint64_t key, uint64_t i, double low, double high) {
    return (float)(low + (high - low) * random_uniform(key, i));
}

/* ---- people ---- */

/* Ranges in radians that people reach easily, about the axes of the rest pose (arms to the sides, y up, z
 * forward). The right side mirrors the left: y and z change sign. */
static const struct {
    int joint, mirror; /* mirror: the right side's joint; -1: none */
    double low[3], high[3];
} reach[] = {
    {1, 2, {-0.7, -0.15, -0.05}, {0.3, 0.15, 0.25}}, /* hips */
    {4, 5, {0, 0, 0}, {0.9, 0, 0}},                  /* knees */
    {7, 8, {-0.2, -0.1, 0}, {0.2, 0.1, 0}},          /* ankles */
    {3, -1, {-0.1, -0.15, -0.08}, {0.2, 0.15, 0.08}},
    {6, -1, {-0.05, -0.15, -0.08}, {0.15, 0.15, 0.08}},
    {9, -1, {-0.05, -0.1, -0.05}, {0.1, 0.1, 0.05}},
    {12, -1, {-0.1, -0.25, -0.1}, {0.15, 0.25, 0.1}},
    {15, -1, {-0.1, -0.25, -0.1}, {0.15, 0.25, 0.1}},
    {13, 14, {0, -0.1, -0.1}, {0, 0.1, 0.1}},        /* collars */
    {16, 17, {-0.2, -0.6, -1.1}, {0.2, 0.2, 0.25}},  /* shoulders: mostly hanging, sometimes raised */
    {18, 19, {-0.1, -1.1, -0.1}, {0.1, -0.05, 0.1}}, /* elbows */
    {20, 21, {-0.1, -0.15, -0.2}, {0.1, 0.15, 0.2}}, /* wrists */
};

static void make_pose(uint64_t key, sherf_pose *pose) {
    uint64_t n = 0;
    for (size_t i = 0; i < COUNT_OF(reach); i++)
        for (int side = 0; side < (reach[i].mirror < 0 ? 1 : 2); side++)
            for (int k = 0; k < 3; k++) {
                float angle = between(key, n++, reach[i].low[k], reach[i].high[k]);
                int joint = side ? reach[i].mirror : reach[i].joint;
                pose->poses_rad[joint * 3 + k] = side && k > 0 ? -angle : angle;
            }
    float turn[3] = {between(key, n, -0.08, 0.08), between(key, n + 1, -0.5, 0.5),
                     between(key, n + 2, -0.08, 0.08)};
    rodrigues(turn, pose->R);
    for (uint64_t k = 0; k < 3; k++) pose->Th_m[k] = between(key, n + 3 + k, -0.06, 0.06);
}

/* View 12 of 24 looks at the front, as in the paper's protocol; heights and distances vary a little. */
static void make_cameras(const synth_job *job, uint64_t key) {
    const float centre[3] = {0, -0.27f, 0};
    int views = job->o.views, size = job->o.size_px;
    for (int v = 0; v < views; v++) {
        float azimuth = (float)(2 * M_PI * (v - views / 2) / views);
        float distance = between(key, (uint64_t)v * 2, 2.35, 2.6);
        float elevation = between(key, (uint64_t)v * 2 + 1, -0.1, 0.45);
        sherf_camera_orbit(centre, distance, azimuth, elevation, 0.8f, size, size, &job->camera[v]);
    }
}

/* ---- pictures ---- */

typedef struct {
    const synth_job *job;
    const float *vertices, *normals; /* V x 3, world */
    const char *folder;              /* the person's */
    int pose;
    context *c;
    sherf_status *status; /* by view */
    char (*message)[sizeof((context *)0)->message];
} pose_job;

/* Light from above and in front, three quarters of it ambient. */
static float light(const float normal[3]) {
    static const float from[3] = {0.3f, 0.75f, 0.59f};
    float d = normal[0] * from[0] + normal[1] * from[1] + normal[2] * from[2];
    return 0.78f + 0.22f * (d > 0 ? d : 0);
}

/* Sums a pixel's samples; returns how many hit the body. */
static int pixel_samples(const pose_job *p, const raster *r, int x, int y, float rgb[3]) {
    const body_model *body = p->job->body;
    int hits = 0;
    for (int s = 0; s < SAMPLES * SAMPLES; s++) {
        size_t at = (size_t)(y * SAMPLES + s / SAMPLES) * r->width + x * SAMPLES + s % SAMPLES;
        if (r->face[at] < 0) continue;
        const uint32_t *corner = body->face + 3 * (size_t)r->face[at];
        const float *weight = r->barycentric + 3 * at;
        float color[3] = {0}, normal[3] = {0};
        for (int k = 0; k < 3; k++)
            for (int i = 0; i < 3; i++) {
                color[k] += weight[i] * p->job->color[corner[i]][k];
                normal[k] += weight[i] * p->normals[3 * (size_t)corner[i] + k];
            }
        float shade = light(normal);
        for (int k = 0; k < 3; k++) rgb[k] += shade * color[k];
        hits++;
    }
    return hits;
}

static sherf_status draw_view(context *c, const pose_job *p, int view) {
    const synth_job *job = p->job;
    int size = job->o.size_px;
    raster *r = NULL;
    sherf_status status = SHERF_NO_MEMORY;
    uint8_t *rgb = mem_zero(c, (size_t)size * size, 3), *mask = mem_zero(c, (size_t)size * size, 1);
    if (!rgb || !mask) goto done;
    status = raster_create(c, &job->camera[view], SAMPLES, job->body->vertices, p->vertices, job->body->faces,
                           job->body->face, &r);
    if (status) goto done;
    for (int y = 0; y < size; y++)
        for (int x = 0; x < size; x++) {
            float sum[3] = {0};
            size_t at = (size_t)y * size + x;
            int hits = pixel_samples(p, r, x, y, sum);
            mask[at] = hits * 2 >= SAMPLES * SAMPLES;
            for (int k = 0; k < 3 && mask[at]; k++) rgb[at * 3 + k] = float_to_u8(sum[k] / hits);
        }
    status = thuman_write_picture(c, p->folder, view, p->pose, size, size, rgb, mask);
done:
    raster_free(r);
    mem_free(rgb);
    mem_free(mask);
    return status;
}

static void draw_views(void *arg, int64_t begin, int64_t end, int thread) {
    pose_job *p = arg;
    context own = {.threads = 1}; /* a context belongs to one thread */
    for (int64_t v = begin; v < end; v++) {
        if (cancelled(p->c))
            p->status[v] = SHERF_CANCELLED;
        else
            p->status[v] = draw_view(&own, p, (int)v);
        if (p->status[v]) {
            memcpy(p->message[v], own.message, sizeof own.message);
            return;
        }
    }
}

/* ---- surfaces ---- */
static const float surface_cell_m = 0.006f;

static bool surface_color_at(void *user, const solid_point *place, bool behind, uint8_t rgb[3]) {
    const pose_job *p = user;
    const uint32_t *corner = p->job->body->face + 3 * (size_t)place->triangle;
    float color[3] = {0}, normal[3] = {0};
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < 3; i++) {
            color[k] += place->weight[i] * p->job->color[corner[i]][k];
            normal[k] += place->weight[i] * p->normals[3 * (size_t)corner[i] + (size_t)k];
        }
    for (int k = 0; k < 3; k++) rgb[k] = float_to_u8(light(normal) * color[k]);
    return !behind;
}

/* The tubes' ends are closed, or the flood would enter. */
static sherf_status write_surface(context *c, pose_job *p) {
    const body_model *m = p->job->body;
    uint32_t *walls = mem_alloc(c, (size_t)m->faces + TUBEMAN_CAPS, 3 * sizeof *walls);
    char path[PATH_LENGTH];
    surface_truth truth = {0};
    sherf_status status = walls ? thuman_path(c, path, p->folder, "surface") : SHERF_NO_MEMORY;
    if (!status) status = folder_make(c, path);
    if (!status) status = surface_truth_path(c, p->folder, p->pose, path);
    if (!status) {
        memcpy(walls, m->face, 3 * (size_t)m->faces * sizeof *walls);
        tubeman_caps(walls + 3 * (size_t)m->faces);
        const solid_mesh drawn = {m->vertices, m->faces, p->vertices, m->face},
                         closed = {m->vertices, m->faces + TUBEMAN_CAPS, p->vertices, walls};
        const surface_source from = {.meshes = 1,
                                     .drawn = &drawn,
                                     .walls = &closed,
                                     .cell_m = surface_cell_m,
                                     .key = random_key(p->job->o.seed, "synth.surface", (uint64_t)p->pose),
                                     .color = surface_color_at,
                                     .user = p};
        status = surface_truth_make(c, &from, &truth);
    }
    if (!status) status = surface_truth_write(c, &truth, path);
    surface_truth_free(&truth);
    mem_free(walls);
    return status;
}

/* ---- files ---- */

static sherf_status make_pose_files(context *c, const synth_job *job, const char *folder, int pose,
                                    const sherf_pose *body_pose) {
    posed_body *posed = NULL;
    size_t V = (size_t)job->body->vertices, views = (size_t)job->o.views;
    float *vertices = mem_alloc(c, V * 3, sizeof *vertices), *normals = mem_alloc(c, V * 3, sizeof *normals);
    pose_job p = {job,
                  vertices,
                  normals,
                  folder,
                  pose,
                  c,
                  mem_zero(c, views, sizeof *p.status),
                  mem_zero(c, views, sizeof *p.message)};
    sherf_status status = SHERF_NO_MEMORY;
    if (!vertices || !normals || !p.status || !p.message) goto done;
    status = posed_body_create(c, job->body, body_pose->poses_rad, body_pose->shapes, body_pose->R,
                               body_pose->Th_m, &posed);
    if (status) goto done;
    body_vertices_world(job->body, posed, vertices);
    if ((status = body_normals(c, job->body, vertices, normals)) ||
        (status = thuman_write_parameters(c, folder, pose, body_pose)) ||
        (status = thuman_write_vertices(c, folder, pose, job->body->vertices, vertices)))
        goto done;
    if (job->o.surfaces && (status = write_surface(c, &p))) goto done;
    parallel_for(c, job->o.views, 1, draw_views, &p);
    for (size_t v = 0; v < views && !status; v++)
        if (p.status[v])
            status =
                failure(c, p.status[v], "%s", p.status[v] == SHERF_CANCELLED ? "cancelled" : p.message[v]);
done:
    mem_free(vertices);
    mem_free(normals);
    mem_free(p.status);
    mem_free(p.message);
    posed_body_free(posed);
    return status;
}

static sherf_status make_person(context *c, synth_job *job, int person) {
    static const char *const kinds[] = {"", "mask_cihp/", NULL};
    char name[64], part[PATH_LENGTH], final[PATH_LENGTH];
    uint64_t key = random_key(job->o.seed, "synth.person", (uint64_t)person);
    snprintf(name, sizeof name, "tube_%03d", person);
    sherf_status status = thuman_path(c, final, job->folder, name);
    snprintf(name, sizeof name, "tube_%03d.part", person);
    if (status || (status = thuman_path(c, part, job->folder, name))) return status;
    folder_remove(part);
    make_cameras(job, random_key(job->o.seed, "synth.cameras", (uint64_t)person));
    for (int i = 0; i < job->body->vertices; i++) tubeman_color(key, i, job->color[i]);
    if ((status = thuman_make_folders(c, part, job->o.views, kinds)) ||
        (status = thuman_write_annots(c, part, job->o.poses, job->o.views, job->camera)))
        goto fail;
    for (int p = 0; p < job->o.poses; p++) {
        sherf_pose pose;
        sherf_pose_identity(&pose);
        for (uint64_t i = 0; i < BODY_SHAPES; i++) pose.shapes[i] = between(key, 100 + i, -1, 1);
        make_pose(random_key(key, "synth.pose", (uint64_t)p), &pose);
        if ((status = make_pose_files(c, job, part, p, &pose))) goto fail;
        status = progress(c, "pictures", ((double)person * job->o.poses + p + 1) * job->o.views,
                          (double)job->o.people * job->o.poses * job->o.views);
        if (status) goto fail;
    }
    folder_remove(final); /* remains of an interrupted run: the list is written last */
    if (rename(part, final) == 0) return SHERF_OK;
    status = failure(c, SHERF_WRITE_FAILED, "%s: cannot be made", final);
fail:
    folder_remove(part);
    return status;
}

static sherf_status write_list(context *c, const synth_job *job, const char *path) {
    output_file file = {0};
    sherf_status status = output_open(c, path, &file);
    for (int i = 0; i < job->o.people && !status; i++) {
        char line[64];
        int n = snprintf(line, sizeof line, "tube_%03d\n", i);
        status = output_write(c, &file, line, (size_t)n);
    }
    if (!status) status = output_commit(c, &file);
    output_abort(&file);
    return status;
}

/* An unfinished data set would look like a finished one: removes its people and body, and a folder made for
 * it. */
static void leave_nothing(const synth_job *job, int people, const char *body, bool folder_is_new) {
    context quiet = {.threads = 1};
    char name[64], path[PATH_LENGTH];
    for (int i = 0; i < people; i++) {
        snprintf(name, sizeof name, "tube_%03d", i);
        if (thuman_path(&quiet, path, job->folder, name) == SHERF_OK) folder_remove(path);
    }
    unlink(body);
    if (folder_is_new) rmdir(job->folder);
}

static sherf_status options_check(context *c, sherf_synth_options *o) {
    if (!o->people) o->people = 4;
    if (!o->poses) o->poses = 6;
    if (!o->views) o->views = 24;
    if (!o->size_px) o->size_px = 256;
    if (o->people < 1 || o->people > PEOPLE_MAX || o->poses < 1 || o->poses > POSES_MAX || o->views < 1 ||
        o->views > VIEWS_MAX || o->size_px < SIDE_MIN || o->size_px > SIDE_MAX)
        return failure(c, SHERF_BAD_ARGUMENT,
                       "1 to %d people, 1 to %d poses, 1 to %d views and %d to %d pixels can be made",
                       PEOPLE_MAX, POSES_MAX, VIEWS_MAX, SIDE_MIN, SIDE_MAX);
    return SHERF_OK;
}

sherf_status sherf_synth_tube(sherf_context *c, const char *folder, const sherf_synth_options *options) {
    body_model *body = NULL;
    char list[PATH_LENGTH], path[PATH_LENGTH];
    synth_job job = {0};
    int made = 0;
    const bool folder_is_new = !path_is_folder(folder);
    if (options) job.o = *options;
    sherf_status status = options_check(c, &job.o);
    if (status || (status = thuman_path(c, list, folder, "human_list.txt")) ||
        (status = thuman_path(c, path, folder, "tubeman.safetensors")))
        return status;
    if (path_is_file(list))
        return failure(c, SHERF_WRITE_FAILED, "%s: holds a data set already; choose another folder", folder);
    snprintf(job.folder, sizeof job.folder, "%s", folder);
    if ((status = tubeman_create(c, &body))) return status;
    job.body = body;
    job.color = mem_alloc(c, (size_t)body->vertices, sizeof *job.color);
    job.camera = mem_alloc(c, (size_t)job.o.views, sizeof *job.camera);
    if (!job.color || !job.camera)
        status = SHERF_NO_MEMORY;
    else
        status = folder_make(c, folder);
    if (!status) status = body_save(c, body, path);
    for (; made < job.o.people && !status; made++) status = make_person(c, &job, made);
    if (!status) status = write_list(c, &job, list);
    if (status) leave_nothing(&job, made, path, folder_is_new);
    mem_free(job.color);
    mem_free(job.camera);
    sherf_body_free(body);
    return status;
}
