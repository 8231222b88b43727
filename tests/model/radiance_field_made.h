/* A made-up radiance field (hash weights of the reference's scale rules, a made-up bank and points) for the
 * test and the benchmark of the radiance field. */
#ifndef RADIANCE_FIELD_MADE_H
#define RADIANCE_FIELD_MADE_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model/sherf/fused/radiance_field.h"

static const radiance_sizes made_paper = {32, 64, {32, 64, 96}, 3, 16, 128, 8, 4, 64, 6, 4, 5};
static const radiance_sizes made_narrow = {32, 68, {8, 20, 28}, 2, 8, 40, 3, 0, 24, 4, 3, 5};
static const radiance_sizes made_odd = {24, 40, {8, 20, 28}, 2, 12, 48, 5, 2, 24, 4, 3, 5};

typedef struct {
    radiance_sizes s;
    radiance_weights w;
    radiance_bank bank;
    ray_bundle rays;
    point_set points;
    void *owned[128];
    int owned_count;
} made;

static void *made_memory(made *fixture, size_t count, size_t size) {
    void *p = calloc(count ? count : 1, size);
    if (!p || fixture->owned_count == 128) abort();
    return fixture->owned[fixture->owned_count++] = p;
}

static inline void made_free(made *fixture) {
    for (int i = 0; i < fixture->owned_count; i++) free(fixture->owned[i]);
    memset(fixture, 0, sizeof *fixture);
}

static float *made_values(made *fixture, const char *name, size_t n, double middle, double scale) {
    float *x = made_memory(fixture, n, sizeof *x);
    uint64_t key = fnv1a64(name);
    for (size_t i = 0; i < n; i++) x[i] = (float)(middle + scale * (2.0 * random_uniform(key, i) - 1.0));
    return x;
}

static float *made_weight(made *fixture, const char *name, int out, int in, double gain) {
    return made_values(fixture, name, (size_t)out * (size_t)in, 0, gain * sqrt(3.0 / in));
}

static void made_weights(made *fixture) {
    const radiance_sizes *s = &fixture->s;
    int d = s->token_width, all = s->heads * s->head_width, h = s->decoder_width;
    int volume = s->volume_channels[0] + s->volume_channels[1] + s->volume_channels[2];
    int x = 3 * (1 + 2 * s->position_frequencies) + d;
    radiance_weights *w = &fixture->w;
    w->volume_projection_w = made_weight(fixture, "vp.w", 3 * d, volume, 1);
    w->volume_projection_b = made_values(fixture, "vp.b", (size_t)(3 * d), 0, 0.05);
    w->token_projection_w = made_weight(fixture, "tp.w", d, 3 * d, 1);
    w->token_projection_b = made_values(fixture, "tp.b", (size_t)d, 0, 0.05);
    w->norm0_w = made_values(fixture, "n0.w", (size_t)d, 1, 0.1);
    w->norm0_b = made_values(fixture, "n0.b", (size_t)d, 0, 0.05);
    w->norm1_w = made_values(fixture, "n1.w", (size_t)d, 1, 0.1);
    w->norm1_b = made_values(fixture, "n1.b", (size_t)d, 0, 0.05);
    w->qkv_w = made_weight(fixture, "qkv.w", 3 * all, d, 1);
    w->attention_out_w = made_weight(fixture, "ao.w", d, all, 1);
    w->attention_out_b = made_values(fixture, "ao.b", (size_t)d, 0, 0.05);
    w->mlp0_w = made_weight(fixture, "m0.w", d, d, 1);
    w->mlp0_b = made_values(fixture, "m0.b", (size_t)d, 0, 0.05);
    w->mlp1_w = made_weight(fixture, "m1.w", d, d, 1);
    w->mlp1_b = made_values(fixture, "m1.b", (size_t)d, 0, 0.05);
    for (int i = 0; i < s->decoder_depth; i++) {
        char name[32];
        snprintf(name, sizeof name, "pts.%d.w", i);
        w->pts_w[i] = made_weight(fixture, name, h,
                                  i == 0                     ? x
                                  : i == s->decoder_skip + 1 ? x + h
                                                             : h,
                                  sqrt(2.0));
        snprintf(name, sizeof name, "pts.%d.b", i);
        w->pts_b[i] = made_values(fixture, name, (size_t)h, 0, 0.05);
    }
    w->alpha_w = made_weight(fixture, "alpha.w", 1, h, 40);
    w->alpha_b = made_values(fixture, "alpha.b", 1, 0, 0.05);
    w->feature_w = made_weight(fixture, "feature.w", h, h, 1);
    w->feature_b = made_values(fixture, "feature.b", (size_t)h, 0, 0.05);
    int view = h + 3 * (1 + 2 * s->direction_frequencies) + d;
    w->views_w = made_weight(fixture, "views.w", s->view_width, view, sqrt(2.0));
    w->views_b = made_values(fixture, "views.b", (size_t)s->view_width, 0, 0.05);
    w->rgb_w = made_weight(fixture, "rgb.w", 3, s->view_width, 1);
    w->rgb_b = made_values(fixture, "rgb.b", 3, 0, 0.05);
}

/* A stand-in for a body: a capsule along y with radius 0.25 m and half length 0.75 m. Returns the distance of
 * a point to its skin. */
static double made_distance(double x, double y, double z) {
    double cy = y < -0.6 ? y + 0.6 : y > 0.6 ? y - 0.6 : 0;
    return sqrt(x * x + cy * cy + z * z) - 0.25;
}

/* Voxels of a level: those within a voxel of the capsule's skin. */
static void made_level(made *fixture, int level, int shrink) {
    radiance_bank *b = &fixture->bank;
    double voxel = (double)b->voxel_size_m * shrink;
    size_t cells = 1;
    for (int i = 0; i < 3; i++) cells *= (size_t)(b->level[level].size[i] = b->volume_size[i] / shrink);
    int32_t *grid = made_memory(fixture, cells, sizeof *grid);
    int32_t rows = 0;
    const int *size = b->level[level].size;
    for (int z = 0, i = 0; z < size[0]; z++)
        for (int y = 0; y < size[1]; y++)
            for (int x = 0; x < size[2]; x++, i++) {
                double d = made_distance(b->volume_min[0] + x * voxel, b->volume_min[1] + y * voxel,
                                         b->volume_min[2] + z * voxel);
                grid[i] = fabs(d) < voxel * 0.9 ? rows++ : -1;
            }
    char name[16];
    snprintf(name, sizeof name, "level%d", level);
    float *v = made_values(fixture, name, (size_t)rows * (size_t)fixture->s.volume_channels[level], 0, 2);
    for (size_t i = 0; i < (size_t)rows * (size_t)fixture->s.volume_channels[level]; i++)
        v[i] = v[i] > 0 ? v[i] : 0;
    b->level[level].voxels = rows;
    b->level[level].grid = grid;
    b->level[level].value = v;
}

static void made_bank(made *fixture, int plane_size, int image, float voxel_m) {
    radiance_bank *b = &fixture->bank;
    static const float min[3] = {-0.32f, -0.93f, -0.31f}, max[3] = {0.31f, 0.92f, 0.32f};
    b->plane_size = plane_size;
    b->planes =
        made_values(fixture, "planes",
                    3 * (size_t)plane_size * (size_t)plane_size * (size_t)fixture->s.token_width, 0, 1.5);
    for (int i = 0; i < 3; i++) {
        b->plane_min[i] = min[i] - (i == 2 ? 0.1f : 0);
        b->plane_max[i] = max[i] + (i == 2 ? 0.1f : 0);
        b->volume_min[i] = min[i];
        b->volume_size[2 - i] = ((int)ceil((max[i] - min[i]) / voxel_m) | 31) + 1;
    }
    b->voxel_size_m = voxel_m;
    b->feature_width = image / 2;
    b->feature_height = image / 2;
    b->features = made_values(fixture, "map",
                              (size_t)(image / 2) * (size_t)(image / 2) * (size_t)fixture->s.feature_channels,
                              0.5, 0.5);
    b->image_width = b->image_height = image;
    b->image = made_values(fixture, "image", (size_t)image * (size_t)image * 3, 0.5, 0.5);
    for (int i = 0; i < POINT_LEVELS; i++) made_level(fixture, i, 2 << i);
}

/* A picture of the capsule: rays along z from z = -2 (parallel, then slightly tilted) with 48 samples
 * from 1.5 to 2.5; those within 5 cm of the skin are kept. The observation looks along x. */
static void made_points(made *fixture, int width, int height, int samples) {
    int64_t n = (int64_t)width * height, count = 0, room = 1024;
    fixture->rays = (ray_bundle){.width = width, .height = height, .origin_world = {0, 0, -2}};
    fixture->rays.direction = made_memory(fixture, (size_t)n * 3, sizeof(float));
    fixture->rays.near = made_memory(fixture, (size_t)n, sizeof(float));
    fixture->rays.far = made_memory(fixture, (size_t)n, sizeof(float));
    fixture->rays.at_box = made_memory(fixture, (size_t)n, 1);
    point_set *p = &fixture->points;
    p->rays = n;
    p->samples = samples;
    p->first = made_memory(fixture, (size_t)n + 1, sizeof(int32_t));
    float *point = malloc((size_t)room * 3 * sizeof(float));
    int32_t *ray = malloc((size_t)room * sizeof *ray), *sample = malloc((size_t)room * sizeof *sample);
    for (int64_t i = 0; i < n; i++) {
        p->first[i] = (int32_t)count;
        float *d = fixture->rays.direction + 3 * i;
        d[0] = ((float)(i % width) - (float)width / 2) / (float)height * 1.85f;
        d[1] = ((float)(i / width) - (float)height / 2) / (float)height * 1.85f;
        d[2] = 1;
        if (fabsf(d[0] * 2) > 0.4f || fabsf(d[1] * 2) > 1) {
            fixture->rays.far[i] = 1;
            continue;
        }
        fixture->rays.at_box[i] = 1;
        fixture->rays.near[i] = 1.6f + 0.02f * d[0];
        fixture->rays.far[i] = 2.4f + 0.01f * d[1];
        for (int k = 0; k < samples; k++) {
            float t = fixture->rays.near[i] +
                      (fixture->rays.far[i] - fixture->rays.near[i]) * (float)k / (float)(samples - 1);
            float x[3] = {d[0] * t, d[1] * t, t - 2};
            if (fabs(made_distance(x[0], x[1], x[2])) > 0.05) continue;
            if (count == room) {
                room *= 2;
                point = realloc(point, (size_t)room * 3 * sizeof(float));
                ray = realloc(ray, (size_t)room * sizeof *ray);
                sample = realloc(sample, (size_t)room * sizeof *sample);
                if (!point || !ray || !sample) abort();
            }
            memcpy(point + 3 * count, x, sizeof x);
            ray[count] = (int32_t)i;
            sample[count++] = k;
        }
    }
    p->first[n] = (int32_t)count;
    p->count = count;
    fixture->owned[fixture->owned_count++] = p->canonical = point;
    fixture->owned[fixture->owned_count++] = p->ray = ray;
    fixture->owned[fixture->owned_count++] = p->sample = sample;
    p->direction_canonical = made_memory(fixture, (size_t)count * 3, sizeof(float));
    p->observed_px = made_memory(fixture, (size_t)count * 2, sizeof(float));
    for (int64_t i = 0; i < count; i++) {
        memcpy(p->direction_canonical + 3 * i, fixture->rays.direction + 3 * ray[i], 3 * sizeof(float));
        p->observed_px[2 * i] = (point[3 * i + 2] + 1) / 2 * (float)fixture->bank.image_width;
        p->observed_px[2 * i + 1] = (point[3 * i + 1] + 1) / 2 * (float)fixture->bank.image_height;
    }
}

static inline void made_create(made *fixture, const radiance_sizes *s, int plane_size, int image,
                               float voxel_m, int width, int height, int samples) {
    memset(fixture, 0, sizeof *fixture);
    fixture->s = *s;
    made_weights(fixture);
    made_bank(fixture, plane_size, image, voxel_m);
    made_points(fixture, width, height, samples);
}
#endif
