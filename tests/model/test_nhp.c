/* Tests of Neural Human Performer against a second implementation, in double and written only from its
 * description: values and gradients of whole frames, in the observed pose and in another; and of its use. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "io/safetensors.h"
#include "model/depths.h"
#include "model/nhp/nhp.h"
#include "rival.h"

enum { SIDE = 32, ENCODER = 8, FEATURES = 4 * ENCODER, WIDTH = 16, RAYS = 10, LEVELS = 5 };
static const int channels[LEVELS] = {4, 4, 5, 6, 8};
static const double voxel_m = 0.08;

typedef struct {
    int size[3], count; /* z y x */
    int *grid, (*zyx)[3];
    double *v; /* [count, channels] */
} level;

typedef struct {
    const rival_scene *scene;
    rival_weights w;
    bool own;
    double min[3];
    int *voxel; /* [V]: the vertex's row in level 0 */
    level level[LEVELS];
    int rays, ray[RAYS];
} second;

/* ---- the painted body ---- */
static void level_new(level *l, const int size[3], int max) {
    memcpy(l->size, size, sizeof l->size);
    const int cells = size[0] * size[1] * size[2];
    l->grid = malloc((size_t)cells * sizeof *l->grid);
    memset(l->grid, 0xff, (size_t)cells * sizeof *l->grid);
    l->zyx = malloc((size_t)max * sizeof *l->zyx);
    l->count = 0;
}

static int *cell(const level *l, int z, int y, int x) {
    if (z < 0 || y < 0 || x < 0 || z >= l->size[0] || y >= l->size[1] || x >= l->size[2]) return NULL;
    return &l->grid[(z * l->size[1] + y) * l->size[2] + x];
}

static int put(level *l, int z, int y, int x) {
    int *at = cell(l, z, y, x);
    if (at && *at < 0) {
        memcpy(l->zyx[l->count], (int[]){z, y, x}, sizeof *l->zyx);
        *at = l->count++;
    }
    return at ? *at : -1;
}

static void lay_out(second *s) {
    const posed_body *p = s->scene->geometry->body;
    const int V = s->scene->body->vertices;
    int size[3];
    for (int k = 0; k < 3; k++) {
        double low = INFINITY, high = -INFINITY;
        for (int v = 0; v < V; v++) {
            low = fmin(low, p->vertices_smpl[3 * v + k]);
            high = fmax(high, p->vertices_smpl[3 * v + k]);
        }
        s->min[k] = low - 0.05;
        size[2 - k] = ((int)ceil((high + 0.05 - s->min[k]) / voxel_m) | 31) + 1;
    }
    s->voxel = malloc((size_t)V * sizeof *s->voxel);
    level_new(&s->level[0], size, V);
    for (int v = 0; v < V; v++) {
        int at[3];
        for (int k = 0; k < 3; k++)
            at[k] = (int)nearbyint((p->vertices_smpl[3 * v + k] - s->min[k]) / voxel_m);
        s->voxel[v] = put(&s->level[0], at[2], at[1], at[0]);
        assert_true(s->voxel[v] >= 0);
    }
    for (int l = 1; l < LEVELS; l++) {
        const level *from = &s->level[l - 1];
        for (int k = 0; k < 3; k++) size[k] /= 2;
        level_new(&s->level[l], size, 8 * from->count);
        for (int i = 0; i < from->count; i++) /* 2 o + k - 1 = i for k = 0, 1 or 2 */
            for (int n = 0; n < 27; n++) {
                int o[3];
                bool whole = true;
                for (int a = 0; a < 3; a++) {
                    const int twice = from->zyx[i][a] - (a == 0 ? n / 9 : a == 1 ? n / 3 % 3 : n % 3) + 1;
                    whole = whole && twice >= 0 && twice % 2 == 0;
                    o[a] = twice / 2;
                }
                if (whole) put(&s->level[l], o[0], o[1], o[2]);
            }
    }
    for (int l = 0; l < LEVELS; l++)
        assert_int_equal(s->level[l].count, ((nhp_geometry *)s->scene->geometry->own)->level[l].voxels);
}

/* Convolution, batch norm with eps 1e-3 and ReLU: computes to->v from the values of `from`. */
static double *sparse(second *s, const level *from, const double *x, int in, const level *to, int out,
                      int stride, const char *name, int index) {
    const double *w = rival_weight(&s->w, "%s.%d.weight", name, index);
    const double *gain = rival_weight(&s->w, "%s.%d.weight", name, index + 1);
    const double *bias = rival_weight(&s->w, "%s.%d.bias", name, index + 1);
    double *y = calloc((size_t)(to->count * out), sizeof *y);
    for (int i = 0; i < to->count; i++)
        for (int k = 0; k < 27; k++) {
            const int *at = cell(from, stride * to->zyx[i][0] + k / 9 - 1,
                                 stride * to->zyx[i][1] + k / 3 % 3 - 1, stride * to->zyx[i][2] + k % 3 - 1);
            if (!at || *at < 0) continue;
            for (int o = 0; o < out; o++)
                for (int c = 0; c < in; c++) y[i * out + o] += w[(o * 27 + k) * in + c] * x[*at * in + c];
        }
    for (int o = 0; o < out; o++) {
        double mean = 0, variance = 0;
        for (int i = 0; i < to->count; i++) mean += y[i * out + o] / to->count;
        for (int i = 0; i < to->count; i++) variance += pow(y[i * out + o] - mean, 2) / to->count;
        for (int i = 0; i < to->count; i++)
            y[i * out + o] = fmax((y[i * out + o] - mean) / sqrt(variance + 1e-3) * gain[o] + bias[o], 0);
    }
    return y;
}

static void project(const sherf_camera *k, const double x[3], double px[2], double *depth) {
    double c[3];
    for (int i = 0; i < 3; i++)
        c[i] = k->R[3 * i] * x[0] + k->R[3 * i + 1] * x[1] + k->R[3 * i + 2] * x[2] + k->T_m[i];
    for (int i = 0; i < 2; i++)
        px[i] = (k->K[3 * i] * c[0] + k->K[3 * i + 1] * c[1] + k->K[3 * i + 2] * c[2]) / (c[2] + 1e-5);
    *depth = c[2];
}

static void feature_at(rival_map map, const double px[2], double *out) {
    rival_bilinear(map, fmin(fmax(px[0] / SIDE * map.width, 0), map.width - 1),
                   fmin(fmax(px[1] / SIDE * map.height, 0), map.height - 1), out);
}

static void vertex_world(const second *s, int v, double x[3]) {
    const posed_body *p = s->scene->geometry->body;
    for (int k = 0; k < 3; k++) {
        x[k] = p->Th[k];
        for (int a = 0; a < 3; a++) x[k] += p->R[3 * k + a] * p->vertices_smpl[3 * v + a];
    }
}

static void paint(second *s, rival_map map) {
    const nhp_geometry *own = s->scene->geometry->own;
    const int V = s->scene->body->vertices, C = channels[0];
    double *sum = calloc((size_t)(s->level[0].count * C), sizeof *sum);
    int *count = calloc((size_t)s->level[0].count, sizeof *count);
    for (int v = 0; v < V; v++) {
        double x[3], px[2], depth, feature[FEATURES], value[8];
        vertex_world(s, v, x);
        project(&s->scene->camera, x, px, &depth);
        count[s->voxel[v]]++;
        if (!own->visible[v]) continue;
        feature_at(map, px, feature);
        rival_linear(&s->w, "volume.project", FEATURES, feature, C, value);
        for (int c = 0; c < C; c++) sum[s->voxel[v] * C + c] += value[c];
    }
    for (int i = 0; i < s->level[0].count * C; i++) sum[i] /= count[i / C];
    free(count);
    s->level[0].v = sum;
}

static void volume(second *s, rival_map map) {
    char name[32];
    paint(s, map);
    for (int l = 0; l < LEVELS; l++) {
        level *to = &s->level[l];
        if (l) {
            snprintf(name, sizeof name, "volume.down%d", l);
            const level *from = &s->level[l - 1];
            to->v = sparse(s, from, from->v, channels[l - 1], to, channels[l], 2, name, 0);
        }
        snprintf(name, sizeof name, "volume.level%d", l);
        for (int i = 0; i < (l < 2 ? 2 : 3); i++) {
            double *y = sparse(s, to, to->v, channels[l], to, channels[l], 1, name, 2 * i);
            free(to->v);
            to->v = y;
        }
    }
}

/* All four levels at a point in the pose's own space, trilinear; zero where there is nothing. */
static void volume_at(const second *s, const double smpl[3], double *out) {
    for (int l = 1; l < LEVELS; out += channels[l++]) {
        const level *at = &s->level[l];
        double p[3];
        memset(out, 0, (size_t)channels[l] * sizeof *out);
        for (int a = 0; a < 3; a++) {
            const double n = (smpl[a] - s->min[a]) / voxel_m / s->level[0].size[2 - a] * 2 - 1;
            p[a] = (n + 1) / 2 * (at->size[2 - a] - 1);
        }
        for (int k = 0; k < 8; k++) {
            const int x = (int)floor(p[0]) + k % 2, y = (int)floor(p[1]) + k / 2 % 2,
                      z = (int)floor(p[2]) + k / 4;
            const int *row = cell(at, z, y, x);
            const double share = (1 - fabs(p[0] - x)) * (1 - fabs(p[1] - y)) * (1 - fabs(p[2] - z));
            for (int c = 0; row && *row >= 0 && c < channels[l]; c++)
                out[c] += share * at->v[*row * channels[l] + c];
        }
    }
}

/* ---- the network of a point ---- */
static void layer(second *s, const char *name, int in, const double *x, int out, double *y, bool relu) {
    char full[64];
    snprintf(full, sizeof full, "field.%s", name);
    rival_linear(&s->w, full, in, x, out, y);
    for (int i = 0; relu && i < out; i++) y[i] = fmax(y[i], 0);
}

static void point(second *s, rival_map map, const double x[3], const double direction[3], double out[4]) {
    const posed_body *p = s->scene->geometry->body;
    double px[2], depth, smpl[3] = {0}, v[64], f[FEATURES], h[WIDTH], q[WIDTH], a[WIDTH], b[WIDTH],
                         c[WIDTH + 27];
    project(&s->scene->camera, x, px, &depth);
    feature_at(map, px, f);
    for (int k = 0; k < 3; k++)
        for (int j = 0; j < 3; j++) smpl[k] += (x[j] - p->Th[j]) * p->R[3 * j + k];
    volume_at(s, smpl, v);
    layer(s, "from_volume", 4 + 5 + 6 + 8, v, WIDTH, h, true);
    layer(s, "from_pixel", FEATURES, f, WIDTH, q, true);
    layer(s, "volume_value", WIDTH, h, WIDTH, a, false);
    layer(s, "pixel_value", WIDTH, q, WIDTH, b, false);
    for (int i = 0; i < WIDTH; i++) h[i] = a[i] + b[i];
    layer(s, "hidden", WIDTH, h, WIDTH, a, true);
    layer(s, "geometry", WIDTH, a, WIDTH, h, true);
    layer(s, "density.0", WIDTH, h, WIDTH, a, true);
    layer(s, "density.1", WIDTH, a, 1, &out[3], false);
    layer(s, "color_geometry", WIDTH, h, WIDTH, c, false);
    layer(s, "color_pixel", FEATURES, f, WIDTH, b, false);
    for (int i = 0; i < WIDTH; i++) c[i] += b[i];
    for (int k = 0; k < 3; k++) {
        c[WIDTH + k] = direction[k];
        for (int n = 0; n < 4; n++) {
            c[WIDTH + 3 + 6 * n + k] = sin(pow(2, n) * direction[k]);
            c[WIDTH + 6 + 6 * n + k] = cos(pow(2, n) * direction[k]);
        }
    }
    layer(s, "view", WIDTH + 27, c, WIDTH / 2, a, true);
    layer(s, "view_pixel", FEATURES, f, WIDTH / 2, b, false);
    for (int i = 0; i < WIDTH / 2; i++) a[i] += b[i];
    layer(s, "last", WIDTH / 2, a, WIDTH / 2, b, true);
    layer(s, "color", WIDTH / 2, b, 3, out, false);
    for (int k = 0; k < 3; k++) out[k] = 1 / (1 + exp(-out[k]));
}

/* Where the observation sees point i of the target. */
static void observed(const second *s, int64_t i, const double world[3], double out[3]) {
    const point_set *p = s->scene->target->points;
    float x[3];
    if (s->own) {
        memcpy(out, world, 3 * sizeof *out);
        return;
    }
    const int32_t nearest =
        vertex_grid_nearest(body_canonical_grid(s->scene->body), p->canonical + 3 * i, NULL);
    deform_from_canonical(s->scene->body, s->scene->geometry->body, 1, p->canonical + 3 * i, &nearest, x);
    for (int k = 0; k < 3; k++) out[k] = x[k];
}

static void second_frame(second *s, double out[RAYS][4]) {
    const ray_bundle *r = s->scene->target->rays;
    const point_set *p = s->scene->target->points;
    rival_map x = rival_image(s->scene->observation, 1, 0), stage[3];
    x = rival_conv_norm(&s->w, x, "encoder.conv1", "encoder.bn1", 2, 3, true);
    stage[0] = rival_map_copy(x);
    x = rival_max_pool(x);
    for (int i = 1; i < 3; i++) {
        x = rival_resnet_stage(&s->w, x, "encoder", i, 2);
        stage[i] = rival_map_copy(x);
    }
    free(x.v);
    rival_map map = rival_side_by_side(3, stage);
    volume(s, map);
    for (int n = 0; n < s->rays; n++) {
        const int ray = s->ray[n];
        double sigma[64], rgb[64][3], way[64], weight[64], d[3], unit[3];
        const double length = rival_direction(r, ray, d),
                     step = ((double)r->far[ray] - r->near[ray]) / (p->samples - 1);
        int count = 0;
        for (int64_t i = p->first[ray]; i < p->first[ray + 1]; i++, count++) {
            double world[3], there[3], y[4];
            for (int k = 0; k < 3; k++) {
                world[k] = r->origin_world[k] + (r->near[ray] + step * p->sample[i]) * d[k];
                unit[k] = d[k] / length;
            }
            observed(s, i, world, there);
            point(s, map, there, unit, y);
            memcpy(rgb[count], y, sizeof rgb[count]);
            sigma[count] = y[3];
            way[count] = p->sample[i] + 1 < p->samples ? step : 1e10;
        }
        rival_composite(count, sigma, &rgb[0][0], way, length, weight, out[n]);
    }
    for (int l = 0; l < LEVELS; l++) free(s->level[l].v);
    free(map.v);
}

static double second_sum(void *arg, const void *mix) {
    second *s = arg;
    double out[RAYS][4], sum = 0;
    second_frame(s, out);
    for (int n = 0; n < s->rays; n++)
        for (int k = 0; k < 4; k++) sum += ((const double *)mix)[4 * n + k] * out[n][k];
    return sum;
}

/* The vertices hidden by the body: every triangle against every vertex's pixel. */
static void visibility_agrees(const second *s) {
    const body_model *body = s->scene->body;
    const nhp_geometry *own = s->scene->geometry->own;
    double(*at)[3] = malloc((size_t)body->vertices * sizeof *at);
    int apart = 0, seen = 0;
    for (int v = 0; v < body->vertices; v++) {
        double x[3];
        vertex_world(s, v, x);
        project(&s->scene->camera, x, at[v], &at[v][2]);
    }
    for (int v = 0; v < body->vertices; v++) {
        const double x = nearbyint(at[v][0]), y = nearbyint(at[v][1]);
        bool visible = x >= 0 && y >= 0 && x < SIDE && y < SIDE;
        for (int f = 0; visible && f < body->faces; f++) {
            const double *a = at[body->face[3 * f]], *b = at[body->face[3 * f + 1]],
                         *c = at[body->face[3 * f + 2]];
            const double area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            const double u = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area;
            const double w = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area;
            if (!(u >= 0 && w >= 0 && u + w <= 1)) continue;
            const double z = 1 / ((1 - u - w) / a[2] + u / b[2] + w / c[2]);
            visible = at[v][2] <= z + 0.02;
        }
        apart += visible != (own->visible[v] != 0);
        seen += visible;
    }
    free(at);
    assert_true(seen > body->vertices / 5 && seen < body->vertices * 3 / 4);
    if (apart > body->vertices / 200) fail_msg("%d of %d vertices are seen otherwise", apart, body->vertices);
}

#define TINY                                                                                                 \
    "encoder_width=8,width=16,volume_channels0=4,volume_channels1=5,volume_channels2=6,volume_channels3=8,"  \
    "voxel_size_m=0.08,"

static void agrees(const char *preset, int pose, bool own, float steep, float dense) {
    context *c = test_context();
    rival_scene scene;
    model_config config;
    model *m;
    model_bank bank;
    tensor *frame;
    assert_ok(c, model_config_parse(c, preset, &config));
    rival_scene_open(c, &config, pose, RAYS, &scene);
    assert_ok(c, model_create(c, &config, 7, &m));
    rival_shake(m);
    /* so that some rays see something and others do not */
    for (int i = 0; i < WIDTH; i++) tensor_f32(model_tensor(m, "field.density.1.weight"))[i] *= steep;
    tensor_f32(model_tensor(m, "field.density.1.bias"))[0] = dense;
    assert_ok(c, parameters_make_grads(c, m->weights));
    second s = {.scene = &scene, .own = own};
    rival_weights_take(m, &s.w);
    lay_out(&s);
    visibility_agrees(&s);
    for (int n = 0; n < SIDE * SIDE; n++)
        if (scene.target->rays->at_box[n]) s.ray[s.rays++] = n;
    double want[RAYS][4], mix[RAYS][4];
    for (int i = 0; i < RAYS * 4; i++) (&mix[0][0])[i] = random_normal(78, (uint64_t)i);
    second_frame(&s, want);
    tape *t = tape_create(c, (tape_options){.backend = &backend_cpu, .record = true, .training = true});
    assert_ok(c, model_encode(t, m, scene.body, scene.geometry, &bank));
    assert_ok(c, model_frame(t, m, scene.body, scene.geometry, &bank, scene.target, 0, 0, &frame));
    rival_frame_agrees(t, frame, s.rays, s.ray, want, mix, 1e-5);
    assert_ok(c, tape_backward_seeded(t));
    tape_free(t);
    rival_gradients_agree(m, &s.w, 1, 1e-4, second_sum, &s, mix);
    for (int l = 0; l < LEVELS; l++) free(s.level[l].grid), free(s.level[l].zyx);
    free(s.voxel);
    rival_weights_free(&s.w);
    model_free(m);
    rival_scene_close(&scene);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void the_box_agrees(void **state) {
    agrees("nhp:own," TINY "samples=9", 0, true, 40, -10);
}
static void another_pose_agrees(void **state) {
    agrees("nhp:matched," TINY "samples=20", 1, false, 1, 10);
}

static void counts_are_those_of_the_paper(void **state) {
    /* without the keys and queries of attention, which have no gradient with one view */
    static const rival_count known[] = {{"nhp:own", 683072 + 16448 + 4316288 + 579716 + 197376 - 65792},
                                        {"nhp:matched", 5727108},
                                        {"nhp:own-small", 1991652}};
    rival_counts(COUNT_OF(known), known);
}

/* Even depths are moved by up to half a step, but not beyond the ends. */
static void depths_are_jittered(void **state) {
    context *c = test_context();
    model_config config;
    rival_scene s;
    assert_ok(c, model_config_parse(c, "nhp:own,samples=6," TINY "own=1", &config));
    rival_scene_open(c, &config, 0, 30, &s);
    tape *t = tape_create(c, (tape_options){.backend = &backend_cpu});
    const point_set *p = s.target->points, *a = depths_jittered(t, p, 7, 5), *b = depths_jittered(t, p, 7, 6);
    assert_true(a && b && a->last_way == 7 && a->count == 180);
    int moved = 0;
    for (int64_t i = 0; i < p->count; i++) {
        const float near = s.target->rays->near[p->ray[i]], far = s.target->rays->far[p->ray[i]];
        const float half = (far - near) / 10;
        assert_true(fabsf(a->depth[i] - point_depth(p, i)) <= half * 1.001f);
        assert_true(a->depth[i] >= near && a->depth[i] <= far);
        moved += a->depth[i] != b->depth[i];
    }
    assert_true(moved > 170);
    tape_free(t);
    rival_scene_close(&s);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* ---- use ---- */
#define USED "nhp:matched-small," TINY "samples=24"
#define USED_OWN "nhp:own-small," TINY "samples=12"

static void an_avatar_shows_any_pose(void **state) {
    rival_use(USED);
    rival_use(USED_OWN);
    rival_moves(USED);
    rival_moves(USED_OWN);
}

/* Voxels of a file that are outside the volume or occur twice. */
static void bad_voxels_are_refused(void **state) {
    context *c = test_context();
    for (int kind = 0; kind < 3; kind++) {
        safetensors *s;
        sherf_avatar *a;
        sherf_body *body;
        const char *path = rival_avatar(c, USED, &body);
        assert_ok(c, safetensors_read(c, path, &s));
        safetensor_item item[128];
        safetensor_metadata metadata[8];
        assert_true(s->count < COUNT_OF(item) && s->metadata_count < COUNT_OF(metadata));
        for (size_t i = 0; i < s->count; i++) {
            const safetensor *x = &s->tensor[i];
            item[i] = (safetensor_item){.name = x->name, .type = x->type, .rank = x->rank, .data = x->data};
            memcpy(item[i].dim, x->dim, sizeof x->dim);
            if (strcmp(x->name, "volume.2.voxel")) continue;
            int32_t *voxel = (int32_t *)(uintptr_t)x->data;
            voxel[1] = kind == 0 ? -1 : kind == 1 ? 1 << 30 : voxel[0];
        }
        size_t kept = 0; /* all metadata except the checksum, which belongs to the old contents */
        for (size_t i = 0; i < s->metadata_count; i++)
            if (strcmp(s->metadata_key[i], "crc32"))
                metadata[kept++] = (safetensor_metadata){s->metadata_key[i], s->metadata_value[i]};
        const char *other = test_path("bad.safetensors");
        assert_ok(c, safetensors_write(c, other, s->count, item, kept, metadata));
        safetensors_free(s);
        assert_fails(c, sherf_avatar_load(c, other, body, &a), SHERF_BAD_FILE,
                     "tensor volume.2.voxel: a voxel outside the volume, or twice");
        sherf_body_free(body);
    }
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void every_allocation_fails(void **state) {
    rival_no_memory("nhp:matched-small," TINY "samples=2");
}
static void it_trains_as_its_authors_do(void **state) {
    rival_trains(USED_OWN, 30, 0.7);
}
static void it_trains_as_sherf_does(void **state) {
    rival_trains(USED, 60, 0.8);
}
static void it_is_scored_in_any_pose(void **state) {
    rival_is_scored(USED, 3);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(the_box_agrees),
                                       cmocka_unit_test(another_pose_agrees),
                                       cmocka_unit_test(counts_are_those_of_the_paper),
                                       cmocka_unit_test(depths_are_jittered),
                                       cmocka_unit_test(an_avatar_shows_any_pose),
                                       cmocka_unit_test(bad_voxels_are_refused),
                                       cmocka_unit_test(every_allocation_fails),
                                       cmocka_unit_test(it_trains_as_its_authors_do),
                                       cmocka_unit_test(it_trains_as_sherf_does),
                                       cmocka_unit_test(it_is_scored_in_any_pose)};
    return cmocka_run_group_tests(tests, rival_data, NULL);
}
