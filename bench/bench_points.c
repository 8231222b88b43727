/* Times the steps from a pose to the points of a 512 x 512 frame: median of some repeats. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "synth/tube/tubeman.h"
#include "sampling/sampling.h"

enum { REPEATS = 15 };

static int by_value(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median_ms(double *seconds) {
    qsort(seconds, REPEATS, sizeof *seconds, by_value);
    return 1e3 * seconds[REPEATS / 2];
}

/* Processor time of all threads, which matters on a busy machine. */
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

static void time_nearest(context *c, const char *name, const vertex_grid *g, int64_t n, const float *points) {
    double t[REPEATS];
    int threads = c->threads;
    int32_t *nearest = mem_alloc(c, (size_t)n, sizeof *nearest);
    if (!nearest) exit(1);
    c->threads = 1;
    for (int i = 0; i < REPEATS; i++) {
        t[i] = cpu_seconds();
        vertex_grid_nearest_many(c, g, n, points, nearest);
        t[i] = cpu_seconds() - t[i];
    }
    printf("%-40s %8.1f ns a query, one thread\n", name, 1e6 * median_ms(t) / (double)n);
    c->threads = threads;
    mem_free(nearest);
}

/* Runs the stages of a frame up to its points and returns their canonical places, to be freed; NULL: out of
 * memory. */
static float *time_frame(context *c, const body_model *m, int64_t *count) {
    sherf_pose pose;
    sherf_pose_identity(&pose);
    for (int i = 3; i < 72; i++) pose.poses_rad[i] = (float)(0.3 * random_normal(1, (uint64_t)i));
    pose.poses_rad[50] = -0.9f, pose.poses_rad[53] = 0.9f; /* arms down */
    const float centre[3] = {0, -0.3f, 0};
    sherf_camera camera, observer;
    sherf_camera_orbit(centre, 2.6f, 0.6f, 0.1f, 0.72f, 512, 512, &camera);
    sherf_camera_orbit(centre, 2.6f, 0, 0, 0.72f, 512, 512, &observer);
    double t_pose[REPEATS], t_rays[REPEATS], t_points[REPEATS], cpu[REPEATS];
    int64_t rays_at_box = 0;
    float *points = NULL;
    for (int i = 0; i < REPEATS; i++) {
        posed_body *p;
        ray_bundle *rays;
        point_set *set;
        float min_world[3], max_world[3];
        double t = time_seconds();
        must(c, posed_body_create(c, m, pose.poses_rad, pose.shapes, pose.R, pose.Th_m, &p));
        t_pose[i] = time_seconds() - t;
        body_world_box(m, p, min_world, max_world);
        t = time_seconds();
        must(c, rays_create(c, &camera, min_world, max_world, &rays));
        t_rays[i] = time_seconds() - t;
        t = time_seconds();
        cpu[i] = cpu_seconds();
        must(c, points_create(c, m, p, rays, 48, p, &observer, NULL, false, &set));
        t_points[i] = time_seconds() - t;
        cpu[i] = cpu_seconds() - cpu[i];
        if (!points) {
            *count = set->count;
            for (int64_t n = 0; n < set->rays; n++) rays_at_box += rays->at_box[n];
            points = mem_alloc(c, (size_t)*count, 3 * sizeof *points);
            if (!points) break;
            memcpy(points, set->canonical, 3 * (size_t)*count * sizeof *points);
        }
        points_free(set);
        rays_free(rays);
        posed_body_free(p);
    }
    printf("%lld rays at the box, %lld points, %s, %d threads\n", (long long)rays_at_box, (long long)*count,
           isa_name(isa_best()), c->threads);
    printf("%-40s %8.2f ms\n", "posed_body_create", median_ms(t_pose));
    printf("%-40s %8.2f ms\n", "rays_create", median_ms(t_rays));
    printf("%-40s %8.2f ms, processor time %.2f ms\n", "points_create", median_ms(t_points), median_ms(cpu));
    return points;
}

int main(void) {
    context *c;
    sherf_options options = {.threads = 2};
    if (sherf_context_create(&options, &c) != SHERF_OK) return 1;
    body_model *m;
    must(c, tubeman_create(c, &m));
    int64_t count;
    float *points = time_frame(c, m, &count);
    if (!points) return 1;
    time_nearest(c, "nearest canonical vertex, points of the frame", body_canonical_grid(m), count, points);
    for (int64_t n = 0; n < 3 * count; n++) points[n] = (float)(2 * random_uniform(3, (uint64_t)n) - 1);
    vertex_grid *near;
    must(c, vertex_grid_create(c, m->vertices, m->canonical->vertices_smpl, BODY_SHELL_M, &near));
    time_nearest(c, "nearest within 5 cm, random places", near, count, points);
    time_nearest(c, "nearest, random places", body_canonical_grid(m), count / 50, points);
    vertex_grid_free(near);
    mem_free(points);
    sherf_body_free(m);
    sherf_context_free(c);
    return 0;
}
