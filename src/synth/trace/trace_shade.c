/* From a hit to a colour: texture, smooth normal, soft diffuse, reflections of lamps and sky. */
#include "synth/trace/trace_inside.h"

void surface_at(const trace_scene *s, int mesh, uint32_t face, float u, float v, int side, float width_m,
                surface *out) {
    const scene_mesh *owner = &s->mesh[mesh];
    const uint32_t *corner = owner->face + 3 * (size_t)face;
    float b[3] = {1 - u - v, u, v}, sign = side ? -1 : 1;
    *out = (surface){.mesh = mesh, .face = face, .side = side};
    for (int i = 0; i < 3; i++) {
        out->barycentric[i] = b[i] = clamp01(b[i]);
        for (int k = 0; k < 3; k++)
            out->normal[k] += sign * b[i] * owner->normal[3 * (size_t)corner[i] + (size_t)k];
    }
    unit3(out->normal);
    for (int k = 0; k < 4; k++) out->rgba[k] = 1;
    if (owner->material.color && owner->corner_uv) {
        const float *t = owner->corner_uv + 6 * (size_t)face;
        float uv[2] = {b[0] * t[0] + b[1] * t[2] + b[2] * t[4], b[0] * t[1] + b[1] * t[3] + b[2] * t[5]};
        texture_sample(owner->material.color, uv, width_m * owner->uv_per_m[face], out->rgba);
    }
    for (int k = 0; k < 3; k++) out->rgba[k] *= owner->material.tint[k];
    if (owner->solid[face])
        out->rgba[3] = 1;
    else if (owner->material.alpha == TRACE_CUTOUT)
        out->rgba[3] = out->rgba[3] >= owner->material.cutoff;
}

/* The open sky's table at a cosine with "up". */
static void sky_lookup(const trace_scene *s, const float direction[3], float rgb[3]) {
    float at = (dot3(direction, s->light.up) + 1) * (SKY_STEPS / 2);
    int i = at > 0 ? (int)at : 0;
    if (i > SKY_STEPS - 1) i = SKY_STEPS - 1;
    float t = clamp01(at - (float)i);
    for (int k = 0; k < 3; k++) rgb[k] = s->sky[i][k] + t * (s->sky[i + 1][k] - s->sky[i][k]);
}

/* Schlick's reflectance at the cosine x. At grazing angles all light is reflected, or less if the head-on
 * reflectance is small. */
static float fresnel(float head_on, float x) {
    float y = 1 - clamp01(x), y2 = y * y, rim = clamp01(25 * head_on);
    return head_on + (rim - head_on) * y2 * y2 * y;
}

/* GGX lobe times cosine over 4 (n l)(n v), and times pi since a lamp's colour is what white shows; `wide`:
 * squared roughness, plus that of the lamp's size. Smith's masking in Hammon's form. */
static float lobe(const float n[3], const float v[3], const float l[3], float head_on, float wide) {
    float nl = dot3(n, l), nv = dot3(n, v);
    if (!(nl > 0)) return 0;
    nv = nv > 0.05f ? nv : 0.05f;
    float h[3] = {l[0] + v[0], l[1] + v[1], l[2] + v[2]};
    unit3(h);
    float nh = clamp01(dot3(n, h)), a2 = wide * wide, q = nh * nh * (a2 - 1) + 1;
    float masking = 0.5f / (2 * nl * nv * (1 - wide) + (nl + nv) * wide);
    return a2 / (q * q) * masking * fresnel(head_on, dot3(h, l)) * nl;
}

static void reflect_light(const trace_scene *s, const surface *at, const visible *seen,
                          const float direction[3], float rgb[3]) {
    const trace_material *material = &s->mesh[at->mesh].material;
    const float *n = at->normal;
    float viewer[3] = {-direction[0], -direction[1], -direction[2]};
    float wide = material->roughness * material->roughness, nd = dot3(n, direction), mirrored[3], sky[3];
    wide = wide > 0.002f ? wide < 1 ? wide : 1 : 0.002f;
    for (int i = 0; i < s->light.lamps; i++) {
        const trace_lamp *lamp = &s->light.lamp[i];
        float wider = wide + 0.5f * lamp->half_angle_rad;
        float share =
            lobe(n, viewer, lamp->to_lamp, material->specular, wider < 1 ? wider : 1) * seen->lamp[i];
        for (int k = 0; k < 3; k++) rgb[k] += share * lamp->color[k];
    }
    for (int k = 0; k < 3; k++) mirrored[k] = direction[k] - 2 * nd * n[k];
    sky_lookup(s, mirrored, sky);
    /* A rough surface's rim shines less than a smooth one's. */
    float smooth = 1 - material->roughness, rim = fresnel(material->specular, -nd) - material->specular;
    float share = (material->specular + rim * smooth * smooth) * seen->sky;
    for (int k = 0; k < 3; k++) rgb[k] += share * sky[k];
}

void surface_shade(const trace_scene *s, const surface *at, const float direction[3], float rgb[3],
                   float coat[3]) {
    const trace_material *material = &s->mesh[at->mesh].material;
    visible seen;
    float sky[3], shine[3] = {0};
    light_at(s, at->mesh, at->face, at->barycentric, at->side, &seen);
    sky_lookup(s, at->normal, sky);
    for (int k = 0; k < 3; k++) {
        /* light reflected by neighbours of the same colour: a + a (1 - a) r + a (1 - a)^2 r^2 + ... */
        float again = s->light.bounce * clamp01(at->rgba[k]) * (1 - seen.sky);
        rgb[k] = sky[k] * seen.sky / (1 - (again < 0.95f ? again : 0.95f));
    }
    for (int i = 0; i < s->light.lamps; i++) {
        const trace_lamp *lamp = &s->light.lamp[i];
        float cosine = dot3(at->normal, lamp->to_lamp);
        for (int k = 0; k < 3; k++) {
            float soft = (cosine + material->wrap[k]) / (1 + material->wrap[k]);
            if (soft > 0) rgb[k] += lamp->color[k] * seen.lamp[i] * soft;
        }
    }
    for (int k = 0; k < 3; k++) rgb[k] = (rgb[k] + material->glow[k]) * at->rgba[k], coat[k] = 0;
    if (!(material->specular > 0)) return;
    reflect_light(s, at, &seen, direction, shine);
    for (int k = 0; k < 3; k++)
        if (material->coat)
            coat[k] = shine[k];
        else
            rgb[k] += shine[k];
}
