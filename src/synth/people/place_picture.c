/* A place's picture: traces its objects and the people's shadows, fills in the sky, and blurs parts out of
 * focus. */
#include <math.h>
#include <string.h>

#include "synth/people/place.h"
#include "scene/scene.h"

static const float light_spacing_m = 0.022f;
enum { SAMPLES = 8, SKY_RAYS = 32, LAMP_RAYS = 32 };

/* ---- from the place's axes to the world's ---- */

typedef struct {
    float right[2], away[2]; /* x and z in the world of the place's x and z */
    float camera_m;          /* the camera's distance along the floor */
} stand;

static stand find_stand(const sherf_camera *camera) {
    stand s;
    float at[3], length = 0;
    camera_position(camera, at);
    /* The direction of view along the floor. A camera that looks straight down uses its own up. */
    float x = camera->R[6], z = camera->R[8];
    if (x * x + z * z < 1e-6f) x = -camera->R[3], z = -camera->R[5];
    length = sqrtf(x * x + z * z);
    s.away[0] = x / length, s.away[1] = z / length;
    s.right[0] = -s.away[1], s.right[1] = s.away[0];
    s.camera_m = fmaxf(0.5f, -(at[0] * s.away[0] + at[2] * s.away[1]));
    return s;
}

static void to_world(const stand *s, float floor_world, shape_mesh *mesh) {
    for (int i = 0; i < mesh->vertices; i++) {
        float *v = mesh->vertex + 3 * (size_t)i, x = v[0], z = v[2];
        v[0] = s->right[0] * x + s->away[0] * z;
        v[1] += floor_world;
        v[2] = s->right[1] * x + s->away[1] * z;
    }
}

/* ---- the scene ---- */

static sherf_status add_shapes(context *c, trace_scene *scene, const shapes *s) {
    sherf_status status = SHERF_OK;
    for (int i = 0; i < s->meshes && !status; i++) {
        const shape_mesh *shape = &s->mesh[i];
        if (!shape->faces) continue;
        const trace_mesh mesh = {.vertices = shape->vertices,
                                 .faces = shape->faces,
                                 .face = shape->face,
                                 .uvs = shape->vertices,
                                 .uv = shape->uv,
                                 .rest = shape->vertex};
        status = trace_scene_add(c, scene, &mesh, &shape->material);
    }
    return status;
}

static sherf_status add_people(context *c, trace_scene *scene, const place_people *people) {
    sherf_status status = SHERF_OK;
    for (int i = 0; i < people->meshes && !status; i++) {
        trace_material material = people->material[i];
        material.layer = 0;
        material.seen = TRACE_NOT_BY_CAMERAS;
        status = trace_scene_add(c, scene, &people->mesh[i], &material);
    }
    return status;
}

static sherf_status trace_place(context *c, const place *p, const trace_light *light,
                                const place_people *people, const sherf_camera *camera, trace_picture *out) {
    shapes s;
    trace_scene *scene = NULL;
    const float *position[SHAPES_MAX + 64];
    int count = 0;
    const stand at = find_stand(camera);
    if (people->meshes > 64) return failure(c, SHERF_BAD_ARGUMENT, "place: too many meshes");
    sherf_status status = place_build(c, p, at.camera_m, &s);
    if (status) return status;
    for (int i = 0; i < s.meshes; i++) to_world(&at, p->floor_world, &s.mesh[i]);
    if ((status = trace_scene_create(c, light_spacing_m, &scene))) goto done;
    if ((status = add_shapes(c, scene, &s)) || (status = add_people(c, scene, people))) goto done;
    for (int i = 0; i < s.meshes; i++)
        if (s.mesh[i].faces) position[count++] = s.mesh[i].vertex;
    for (int i = 0; i < people->meshes; i++) position[count++] = people->position[i];
    trace_light own = *light;
    own.sky_rays = SKY_RAYS, own.lamp_rays = LAMP_RAYS;
    own.bounce = 0.85f; /* walls light each other */
    if ((status = trace_scene_pose(c, scene, position, &own))) goto done;
    const trace_options options = {
        .samples = SAMPLES, .depth = true, .seed = random_key(p->key, "place.rays", 0)};
    status = trace_render(c, scene, camera, &options, out);
done:
    trace_scene_free(scene);
    shapes_free(&s);
    return status;
}

/* ---- the sky ---- */

static void sky_color(const place *p, const trace_light *l, const float d[3], float rgb[3]) {
    uint64_t key = random_key(p->key, "place.sky", 0);
    float height = d[1] > 0 ? d[1] : 0;
    float cover = (float)random_uniform(key, 0), u = d[0] / (height + 0.35f), v = d[2] / (height + 0.35f);
    float cloud = place_clouds(key, 6, 5, 0.12f * u + 0.5f, 0.12f * v + 0.5f) - 0.75f + 0.55f * cover;
    cloud = cloud > 0 ? cloud < 0.25f ? 4 * cloud : 1 : 0;
    for (int k = 0; k < 3; k++) {
        float blue = (float[3]){0.55f, 0.75f, 1.05f}[k], pale = (float[3]){1, 1.02f, 1.05f}[k];
        float clear = pale + (blue - pale) * sqrtf(height);
        rgb[k] = (0.9f * clear + cloud * (1.1f - 0.9f * clear)) * fminf(1.6f * l->horizon[1], 0.95f);
    }
}

static void fill_sky(const place *p, const trace_light *l, const sherf_camera *camera, trace_picture *out) {
    for (int y = 0; y < out->height; y++)
        for (int x = 0; x < out->width; x++) {
            size_t i = (size_t)y * (size_t)out->width + (size_t)x;
            float through = 1 - out->alpha[i], rgb[3], d[3], length = 0;
            if (!(through > 0)) continue;
            float a = ((float)x - camera->K[2]) / camera->K[0], b = ((float)y - camera->K[5]) / camera->K[4];
            for (int k = 0; k < 3; k++) {
                d[k] = a * camera->R[k] + b * camera->R[3 + k] + camera->R[6 + k];
                length += d[k] * d[k];
            }
            for (int k = 0; k < 3; k++) d[k] /= sqrtf(length);
            sky_color(p, l, d, rgb);
            for (int k = 0; k < 3; k++) out->color[3 * i + (size_t)k] += through * rgb[k];
            out->alpha[i] = 1;
        }
}

/* ---- out of focus ---- */

/* Mean of 2 radius + 1 pixels along a row or column of n pixels `stride` apart. */
static void box_line(const float *from, float *to, int n, size_t stride, int radius) {
    double sum = 0;
    for (int i = -radius; i <= radius; i++)
        sum += (double)from[stride * (size_t)(i < 0 ? 0 : i < n ? i : n - 1)];
    for (int i = 0; i < n; i++) {
        to[stride * (size_t)i] = (float)(sum / (2 * radius + 1));
        int in = i + radius + 1, out = i - radius;
        sum += (double)from[stride * (size_t)(in < n ? in : n - 1)] -
               (double)from[stride * (size_t)(out > 0 ? out : 0)];
    }
}

/* Two box filters in each direction; scratch: of the same size. */
static void blur(float *color, float *scratch, int width, int height, int radius) {
    for (int pass = 0; pass < 2; pass++)
        for (size_t k = 0; k < 3; k++) {
            for (size_t y = 0; y < (size_t)height; y++)
                box_line(color + 3 * y * (size_t)width + k, scratch + 3 * y * (size_t)width + k, width, 3,
                         radius);
            for (size_t x = 0; x < (size_t)width; x++)
                box_line(scratch + 3 * x + k, color + 3 * x + k, height, 3 * (size_t)width, radius);
        }
}

/* Mixes every pixel from two of the blurred pictures: those with the next smaller and the next larger circle
 * of confusion. */
static sherf_status defocus(context *c, const place *p, const sherf_camera *camera, trace_picture *out) {
    enum { LEVELS = 5 };
    uint64_t key = random_key(p->key, "place.lens", 0);
    size_t n = 3 * (size_t)out->width * (size_t)out->height;
    int unit = (out->height + 256) / 512; /* pixels; radii of the blurred pictures are in it */
    if (unit < 1) unit = 1;
    float focus_m = camera->T_m[2], lens = (float)random_uniform(key, 0);
    /* the radius at infinity: a third of the pictures sharp, up to 2.5 % of the height */
    float max = fmaxf(0, lens - 0.33f) / 0.67f * 0.025f * (float)out->height;
    if (max < 0.7f) return SHERF_OK;
    float *level = mem_alloc(c, n, LEVELS * sizeof *level), *scratch = mem_alloc(c, n, sizeof *scratch);
    sherf_status status = level && scratch ? SHERF_OK : SHERF_NO_MEMORY;
    for (int i = 0; i < LEVELS && !status; i++) { /* radii 0, 1, 2, 4, 8, and twice that by two boxes */
        memcpy(level + (size_t)i * n, out->color, n * sizeof *level);
        if (i) blur(level + (size_t)i * n, scratch, out->width, out->height, (1 << (i - 1)) * unit);
    }
    for (size_t i = 0; i < n && !status; i++) {
        float z = out->depth_m[i / 3];
        float radius = max * (isfinite(z) ? fabsf(1 - focus_m / fmaxf(z, 0.2f)) : 1);
        float at = radius / (float)unit;
        at = at < 1 ? at : 1 + log2f(at);
        at = fminf(at, LEVELS - 1.001f);
        int low = (int)at;
        float t = at - (float)low;
        out->color[i] = (1 - t) * level[(size_t)low * n + i] + t * level[(size_t)(low + 1) * n + i];
    }
    mem_free(level);
    mem_free(scratch);
    return status;
}

sherf_status place_picture(context *c, const place *p, const trace_light *light, const place_people *people,
                           const sherf_camera *camera, trace_picture *out) {
    sherf_status status = trace_place(c, p, light, people, camera, out);
    if (status) return status;
    fill_sky(p, light, camera, out);
    if ((status = defocus(c, p, camera, out))) trace_picture_free(out);
    return status;
}
