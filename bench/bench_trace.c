/* Pictures a second of the ray tracer: a person of 28,000 triangles (tube people's body, a shirt around it,
 * hair of blended cards), 24 cameras a pose, two poses; building the tree and tracing the light included. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "synth/tube/tubeman.h"
#include "io/image.h"
#include "synth/trace/trace.h"

enum { VIEWS = 24, POSES = 2, CARDS = 300 };

static double cpu_seconds(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void must(context *c, sherf_status status) {
    if (status == SHERF_OK) return;
    fprintf(stderr, "%s\n", c->message);
    exit(1);
}

static void *allocated(context *c, size_t count, size_t size) {
    void *p = mem_zero(c, count, size);
    if (!p) exit(1);
    return p;
}

typedef struct {
    body_model *body;
    trace_scene *scene;
    trace_texture *stripes;
    float *vertex[3], *normal;
} person;

/* Strips 1 cm wide and 20 cm long that hang from the head. */
static void make_cards(float *vertex, float *uv, uint32_t *face, const float head[3]) {
    for (uint32_t i = 0; i < CARDS; i++) {
        float angle = (float)(2 * M_PI * random_uniform(5, i)), x = cosf(angle), z = sinf(angle);
        float radius = 0.1f + 0.02f * (float)random_uniform(6, i), top = 0.1f * (float)random_uniform(7, i);
        for (int k = 0; k < 6; k++) {
            float side = k % 2 ? 0.005f : -0.005f, down = 0.1f * (float)(k / 2);
            float *v = vertex + 3 * (6 * (size_t)i + (size_t)k);
            v[0] = head[0] + x * radius - z * side, v[1] = head[1] + top - down,
            v[2] = head[2] + z * radius + x * side;
            uv[2 * (6 * (size_t)i + (size_t)k)] = (float)(k % 2);
            uv[2 * (6 * (size_t)i + (size_t)k) + 1] = 0.5f * (float)(k / 2);
        }
        for (uint32_t k = 0; k < 2; k++) {
            uint32_t p = 6 * i + 2 * k, six[6] = {p, p + 1, p + 3, p, p + 3, p + 2};
            for (int n = 0; n < 6; n++) face[6 * (2 * i + k) + (uint32_t)n] = six[n];
        }
    }
}

static void make_person(context *c, float spacing_m, person *p) {
    static uint8_t texel[256][256][4];
    for (int y = 0; y < 256; y++)
        for (int x = 0; x < 256; x++)
            for (int k = 0; k < 4; k++)
                texel[y][x][k] = (uint8_t)(k < 3 ? 90 + 30 * k : 128 + 120 * (x / 8 % 2));
    must(c, tubeman_create(c, &p->body));
    must(c, trace_texture_create(c, 256, 256, 4, texel[0][0], &p->stripes));
    must(c, trace_scene_create(c, spacing_m, &p->scene));
    size_t V = (size_t)p->body->vertices;
    float *uv = allocated(c, V + 6 * CARDS, 8);
    uint32_t *face = allocated(c, 4 * CARDS, 12);
    for (int i = 0; i < 3; i++) p->vertex[i] = allocated(c, V + 6 * CARDS, 12);
    p->normal = allocated(c, V, 12);
    for (size_t v = 0; v < V; v++) uv[2 * v] = (float)(v % 97) / 97, uv[2 * v + 1] = (float)(v % 89) / 89;
    sherf_pose rest;
    posed_body *posed;
    sherf_pose_identity(&rest);
    must(c, posed_body_create(c, p->body, rest.poses_rad, rest.shapes, rest.R, rest.Th_m, &posed));
    body_vertices_world(p->body, posed, p->vertex[0]);
    make_cards(p->vertex[2], uv, face, (float[3]){0, 0.45f, 0.03f});
    trace_material material = trace_material_plain();
    material.color = p->stripes, material.specular = 0.03f, material.roughness = 0.5f;
    trace_mesh mesh = {(int64_t)V, p->body->faces, p->body->face, (int64_t)V, uv, NULL, p->vertex[0]};
    must(c, trace_scene_add(c, p->scene, &mesh, &material));
    must(c, trace_scene_add(c, p->scene, &mesh, &material));
    material.alpha = TRACE_BLENDED, material.near_m = 0.005f;
    mesh = (trace_mesh){6 * CARDS, 4 * CARDS, face, 6 * CARDS, uv, NULL, p->vertex[2]};
    must(c, trace_scene_add(c, p->scene, &mesh, &material));
    posed_body_free(posed);
    mem_free(uv);
    mem_free(face);
}

static void set_pose(context *c, person *p, int number) {
    trace_light light = {.up = {0, 1, 0}, .lamps = 2, .bounce = 0.5f};
    for (int k = 0; k < 3; k++) light.zenith[k] = 0.5f, light.horizon[k] = 0.4f, light.ground[k] = 0.15f;
    light.lamp[0] = (trace_lamp){{0.6f, 0.9f, 0.8f}, 0.12f, {0.7f, 0.7f, 0.7f}};
    light.lamp[1] = (trace_lamp){{-0.8f, 0.4f, -0.5f}, 0.3f, {0.25f, 0.25f, 0.25f}};
    sherf_pose pose;
    posed_body *posed;
    sherf_pose_identity(&pose);
    for (int i = 3; i < 72; i++)
        pose.poses_rad[i] = (float)(0.1 * random_normal((uint64_t)number, (uint64_t)i));
    pose.poses_rad[50] = -1, pose.poses_rad[53] = 1; /* arms down */
    must(c, posed_body_create(c, p->body, pose.poses_rad, pose.shapes, pose.R, pose.Th_m, &posed));
    body_vertices_world(p->body, posed, p->vertex[0]);
    must(c, body_normals(c, p->body, p->vertex[0], p->normal));
    for (int64_t i = 0; i < 3 * (int64_t)p->body->vertices; i++)
        p->vertex[1][i] = p->vertex[0][i] + 0.01f * p->normal[i];
    must(c, trace_scene_pose(c, p->scene, (const float *const *)p->vertex, &light));
    posed_body_free(posed);
}

static void bench(context *c, int size, int samples, float spacing_m, const char *path) {
    person p;
    double t_pose = 0, t_draw = 0, t_srgb = 0, cover = 0;
    make_person(c, spacing_m, &p);
    uint8_t *rgb = allocated(c, (size_t)size * (size_t)size, 3);
    double cpu = cpu_seconds();
    for (int pose = 0; pose < POSES; pose++) {
        double t = time_seconds();
        set_pose(c, &p, pose);
        t_pose += time_seconds() - t;
        for (int view = 0; view < VIEWS; view++) {
            sherf_camera camera;
            trace_picture picture;
            sherf_camera_orbit((float[3]){0, -0.27f, 0}, 2.3f, (float)(2 * M_PI * view / VIEWS), 0.2f, 0.8f,
                               size, size, &camera);
            t = time_seconds();
            must(c, trace_render(c, p.scene, &camera, &(trace_options){.samples = samples}, &picture));
            t_draw += time_seconds() - t;
            t = time_seconds();
            trace_picture_srgb(&picture, (float[3]){0}, rgb);
            t_srgb += time_seconds() - t;
            for (int i = 0; i < size * size; i++)
                cover += picture.alpha[i] / (double)(size * size * POSES * VIEWS);
            trace_picture_free(&picture);
        }
    }
    cpu = cpu_seconds() - cpu;
    if (path) must(c, png_write(c, path, size, size, 3, rgb));
    double n = POSES * VIEWS, all = t_pose + t_draw + t_srgb;
    printf("%4d x %-4d %2d samples, light every %2.0f mm, %2.0f %% covered: %6.1f pictures/s; %5.1f ms a "
           "picture, "
           "processor %5.1f ms; a pose %4.1f ms\n",
           size, size, samples, 1e3 * spacing_m, 100 * cover, n / all, 1e3 * all / n, 1e3 * cpu / n,
           1e3 * t_pose / POSES);
    trace_scene_free(p.scene);
    trace_texture_free(p.stripes);
    sherf_body_free(p.body);
    for (int i = 0; i < 3; i++) mem_free(p.vertex[i]);
    mem_free(p.normal);
    mem_free(rgb);
}

/* bench_trace [PNG]: writes the last picture there. */
int main(int count, char **argument) {
    context *c;
    sherf_options options = {.threads = 2};
    if (sherf_context_create(&options, &c) != SHERF_OK) return 1;
    bench(c, 256, 8, 0.015f, NULL);
    bench(c, 256, 16, 0.012f, NULL);
    bench(c, 512, 16, 0.008f, count > 1 ? argument[1] : NULL);
    sherf_context_free(c);
    return 0;
}
