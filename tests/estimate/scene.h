/* Synthetic pictures: people of assets/demo in front of backgrounds that are drawn here. */
#ifndef SCENE_H
#define SCENE_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "data/data.h"
#include "scene/scene.h"
#include "support.h"

static const char networks_path[] = "../assets/models/blazepose.safetensors";

/* A wall and a floor, both with some texture. */
static inline void draw_room(sherf_image *p, int width, int height) {
    *p = (sherf_image){width, height, 3, malloc((size_t)width * (size_t)height * 3 * sizeof(float))};
    assert_non_null(p->data);
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            const double down = (double)y / height, across = (double)x / width;
            const bool floor = down > .8;
            const double wave =
                floor ? sin(40 * down * down + 9 * across) : sin(23 * across) * sin(11 * down);
            const double grain = random_uniform(7, (uint64_t)y * (uint64_t)width + (uint64_t)x) - .5;
            float *to = p->data + ((size_t)y * (size_t)width + (size_t)x) * 3;
            for (int k = 0; k < 3; k++) {
                const double base = floor ? .35 - .05 * k : .75 - .1 * across + .04 * k;
                to[k] = (float)(base + .05 * wave + .04 * grain);
            }
        }
}

/* Every pixel has a different colour. */
static inline void draw_noise(sherf_image *p, int width, int height, uint64_t seed) {
    const size_t count = (size_t)width * (size_t)height * 3;
    *p = (sherf_image){width, height, 3, malloc(count * sizeof(float))};
    assert_non_null(p->data);
    for (size_t i = 0; i < count; i++) p->data[i] = (float)random_uniform(seed, i);
}

/* Loaded once for all, when joints are first requested; reading takes a tenth of a second. */
static sherf_body *scene_body;

static inline void scene_free(void) {
    sherf_body_free(scene_body);
    scene_body = NULL;
}

/* Draws the observed person into the picture at this scale, with the corner of its picture at (left, top).
 * Returns the places of its 24 joints (NULL: not wanted; otherwise call scene_free at the end). */
static inline void put_person(context *c, sherf_image *p, const char *observed, double scale, int left,
                              int top, float joint_px[24][2]) {
    sherf_observation *o;
    assert_ok(c, sherf_observation_load(c, observed, &o));
    const size_t count = (size_t)o->image.width * (size_t)o->image.height;
    const int width = (int)(o->image.width * scale + .5), height = (int)(o->image.height * scale + .5);
    sherf_image four = {o->image.width, o->image.height, 4, mem_alloc(c, count * 4, sizeof(float))};
    assert_non_null(four.data);
    for (size_t i = 0; i < count; i++) {
        memcpy(four.data + 4 * i, o->image.data + 3 * i, 3 * sizeof(float)); /* black outside the mask */
        four.data[4 * i + 3] = o->mask[i];
    }
    assert_ok(c, image_resize_area(c, &four, width, height));
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            const int column = left + x, row = top + y;
            if (column < 0 || row < 0 || column >= p->width || row >= p->height) continue;
            const float *from = four.data + ((size_t)y * (size_t)width + (size_t)x) * 4;
            float *to = p->data + ((size_t)row * (size_t)p->width + (size_t)column) * 3;
            for (int k = 0; k < 3; k++) to[k] = to[k] * (1 - from[3]) + from[k];
        }
    if (joint_px) {
        float world_m[24 * 3], uv[24 * 2], depth[24];
        if (!scene_body) assert_ok(c, sherf_body_load(c, "../assets/body.safetensors", &scene_body));
        assert_ok(c, sherf_body_pose(c, scene_body, &o->pose, NULL, world_m));
        camera_project(&o->camera, 24, world_m, uv, depth);
        for (int i = 0; i < 24; i++) {
            joint_px[i][0] = (float)((uv[2 * i] + .5) * width / o->image.width - .5 + left);
            joint_px[i][1] = (float)((uv[2 * i + 1] + .5) * height / o->image.height - .5 + top);
        }
    }
    mem_free(four.data);
    sherf_observation_free(o);
}
#endif
