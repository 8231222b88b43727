/* Computes which share of the sky and of each lamp a place on a surface sees, traced on the first request.
 *
 * A point stores its result in one 64-bit word: a flag and four shares of 15 bits. If two threads request it
 * at once, both trace and store the same word. */
#include <stdlib.h>
#include <string.h>

#include "synth/trace/trace_inside.h"

enum { PACKET = 16, SHARE_BITS = 15, SHARE_MAX = (1 << SHARE_BITS) - 1 };
static const uint64_t traced = (uint64_t)1 << 63;
/* Origins of shadow rays are this far off the surface. */
static const float standoff_m = 0.0006f;
/* Rays to a lamp leave the surface at least this steeply (sine); below it, shading's own cosine darkens. */
static const float steepness = 0.06f;

/* Nothing is traced between points that agree this well and are at most this many spacings apart. */
enum { agreement = SHARE_MAX / 25 };
static const float reach = 3;

/* ---- packing ---- */

static uint64_t visible_pack(const visible *v) {
    uint64_t word = traced;
    for (int k = 0; k <= TRACE_LAMPS; k++) {
        float share = clamp01(k == 0 ? v->sky : v->lamp[k - 1]);
        word |= (uint64_t)(share * SHARE_MAX + 0.5f) << (k * SHARE_BITS);
    }
    return word;
}

static void visible_add(uint64_t word, float weight, visible *sum) {
    float scale = weight / SHARE_MAX;
    sum->sky += scale * (float)(word & SHARE_MAX);
    for (int k = 0; k < TRACE_LAMPS; k++)
        sum->lamp[k] += scale * (float)(word >> ((k + 1) * SHARE_BITS) & SHARE_MAX);
}

/* ---- the sky ---- */

/* The colour of a white surface whose normal has the cosine x with "up": the lower half is ground, the upper
 * horizon + (zenith - horizon) sin(height). With g = acos(x), the integral of cos(n, d) cos(up, d) over the
 * directions d that both see is 2/3 (sin g + (pi - g) cos g). */
static void sky_shade(const trace_light *l, float x, float rgb[3]) {
    double g = acos(x), gradient = 2 / (3 * M_PI) * (sin(g) + (M_PI - g) * x);
    for (int k = 0; k < 3; k++)
        rgb[k] = (float)(l->ground[k] * (1 - x) / 2 + l->horizon[k] * (1 + x) / 2 +
                         ((double)l->zenith[k] - l->horizon[k]) * gradient);
}

/* The sky's radiance towards d, as grey. */
static float sky_grey(const trace_light *l, const float d[3]) {
    float height = dot3(d, l->up);
    if (height < 0) return (l->ground[0] + l->ground[1] + l->ground[2]) / 3;
    float sum = 0;
    for (int k = 0; k < 3; k++) sum += l->horizon[k] + (l->zenith[k] - l->horizon[k]) * height;
    return sum / 3;
}

static float turned(float x, float by) {
    x += by;
    return x < 1 ? x : x - 1;
}

/* ---- preparation ---- */

static bool in_range(int n, int max) {
    return n >= PACKET && n <= max && n % PACKET == 0;
}

static bool colors_valid(const float rgb[3]) {
    for (int k = 0; k < 3; k++)
        if (!(rgb[k] >= 0 && rgb[k] <= 1e6f)) return false;
    return true;
}

static bool direction_valid(const float v[3]) {
    float square = dot3(v, v);
    return square > 1e-12f && square < 1e12f;
}

static sherf_status check_light(context *c, const trace_light *l) {
    if (!direction_valid(l->up)) return failure(c, SHERF_BAD_ARGUMENT, "light: \"up\" is no direction");
    if (!colors_valid(l->zenith) || !colors_valid(l->horizon) || !colors_valid(l->ground))
        return failure(c, SHERF_BAD_ARGUMENT, "light: a colour of the sky is negative or not finite");
    if (l->lamps < 0 || l->lamps > TRACE_LAMPS)
        return failure(c, SHERF_BAD_ARGUMENT, "light: %d lamps, at most %d", l->lamps, TRACE_LAMPS);
    for (int i = 0; i < l->lamps; i++)
        if (!direction_valid(l->lamp[i].to_lamp) || !colors_valid(l->lamp[i].color) ||
            !(l->lamp[i].half_angle_rad >= 0 && l->lamp[i].half_angle_rad <= 1))
            return failure(c, SHERF_BAD_ARGUMENT, "light: lamp %d: direction, colour or angle out of range",
                           i);
    if (!(l->bounce >= 0 && l->bounce <= 1))
        return failure(c, SHERF_BAD_ARGUMENT, "light: bounce %g, must be 0 to 1", l->bounce);
    if (!in_range(l->sky_rays, 1024) || !in_range(l->lamp_rays, 256))
        return failure(c, SHERF_BAD_ARGUMENT,
                       "light: %d and %d rays, must be multiples of 16, 16 to 1024 and 256", l->sky_rays,
                       l->lamp_rays);
    return SHERF_OK;
}

static sherf_status make_samples(context *c, trace_scene *s) {
    mem_free(s->sky_sample);
    mem_free(s->lamp_sample);
    s->sky_sample = mem_alloc(c, (size_t)s->light.sky_rays, sizeof *s->sky_sample);
    s->lamp_sample = mem_alloc(c, (size_t)s->light.lamp_rays, sizeof *s->lamp_sample);
    if (!s->sky_sample || !s->lamp_sample) return SHERF_NO_MEMORY;
    for (int i = 0; i < s->light.sky_rays; i++) { /* Hammersley: 16 neighbours have similar directions */
        uint32_t bits[2];
        sobol2((uint32_t)i, bits);
        s->sky_sample[i][0] = ((float)i + 0.5f) / (float)s->light.sky_rays;
        s->sky_sample[i][1] = fraction32(bits[0]);
    }
    for (int i = 0; i < s->light.lamp_rays; i++) {
        uint32_t bits[2];
        sobol2((uint32_t)i, bits);
        for (int k = 0; k < 2; k++) s->lamp_sample[i][k] = fraction32(bits[k]);
    }
    return SHERF_OK;
}

sherf_status light_prepare(context *c, trace_scene *s, const trace_light *light) {
    trace_light l = *light;
    if (!l.sky_rays) l.sky_rays = 64;
    if (!l.lamp_rays) l.lamp_rays = 48;
    sherf_status status = check_light(c, &l);
    if (status != SHERF_OK) return status;
    unit3(l.up);
    for (int i = 0; i < l.lamps; i++) unit3(l.lamp[i].to_lamp);
    s->light = l;
    for (int i = 0; i < l.lamps; i++) {
        frame3(l.lamp[i].to_lamp, s->lamp_u[i], s->lamp_v[i]);
        for (int k = 0; k < 3; k++) {
            s->lamp_u[i][k] *= tanf(l.lamp[i].half_angle_rad);
            s->lamp_v[i][k] *= tanf(l.lamp[i].half_angle_rad);
        }
    }
    for (int i = 0; i <= SKY_STEPS; i++) sky_shade(&l, 2 * (float)i / SKY_STEPS - 1, s->sky[i]);
    return make_samples(c, s);
}

void light_forget(trace_scene *s) {
    memset(s->lit, 0, 2 * (size_t)s->points * sizeof *s->lit);
}

/* ---- tracing ---- */

typedef struct {
    float origin[3], normal[3], near_m;
    unsigned layer, mask;
    uint64_t key; /* of the point's random numbers */
} light_point;

static void ray_init(struct RTCRay16 *rays, int lane, const light_point *p, const float d[3], int number) {
    rays->org_x[lane] = p->origin[0], rays->org_y[lane] = p->origin[1], rays->org_z[lane] = p->origin[2];
    rays->dir_x[lane] = d[0], rays->dir_y[lane] = d[1], rays->dir_z[lane] = d[2];
    rays->tnear[lane] = p->near_m, rays->tfar[lane] = INFINITY, rays->time[lane] = 0;
    rays->mask[lane] = p->mask, rays->flags[lane] = p->layer;
    rays->id[lane] = (unsigned)(p->key >> 32) + (unsigned)number;
}

/* Bit n: lane n's ray is unoccluded. */
static unsigned free_rays(const trace_scene *s, struct RTCRay16 *rays, int lanes) {
    _Alignas(64) int valid[PACKET];
    struct RTCIntersectContext how;
    rtcInitIntersectContext(&how);
    how.flags = RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
    for (int i = 0; i < PACKET; i++) valid[i] = i < lanes ? -1 : 0;
    rtcOccluded16(valid, s->scene, &how, rays);
    unsigned bits = 0;
    for (int i = 0; i < lanes; i++)
        if (rays->tfar[i] > 0) bits |= 1u << i; /* an occluded ray's tfar is minus infinity */
    return bits;
}

static float sky_share(const trace_scene *s, const light_point *p) {
    _Alignas(64) struct RTCRay16 rays;
    float a[3], b[3], all = 0, seen = 0;
    float turn = (float)random_uniform(p->key, 0), rise = (float)random_uniform(p->key, 1);
    frame3(p->normal, a, b);
    for (int first = 0; first < s->light.sky_rays; first += PACKET) {
        float grey[PACKET];
        for (int i = 0; i < PACKET; i++) { /* cosine-weighted about the normal */
            const float *at = s->sky_sample[first + i];
            float angle = 2 * (float)M_PI * turned(at[0], turn), square = turned(at[1], rise), d[3];
            float radius = sqrtf(square), height = sqrtf(1 - square), x = radius * cosf(angle),
                  y = radius * sinf(angle);
            for (int k = 0; k < 3; k++) d[k] = x * a[k] + y * b[k] + height * p->normal[k];
            grey[i] = sky_grey(&s->light, d);
            ray_init(&rays, i, p, d, first + i);
        }
        unsigned bits = free_rays(s, &rays, PACKET);
        for (int i = 0; i < PACKET; i++) {
            all += grey[i];
            if (bits >> i & 1) seen += grey[i];
        }
    }
    return all > 0 ? seen / all : 1;
}

/* Maps the unit square to the unit disc and preserves areas (Shirley and Chiu). */
static void disc(float x, float y, float out[2]) {
    x = 2 * x - 1, y = 2 * y - 1;
    if (x == 0 && y == 0) {
        out[0] = out[1] = 0;
        return;
    }
    float radius = fabsf(x) > fabsf(y) ? x : y;
    float angle = fabsf(x) > fabsf(y) ? (float)M_PI_4 * y / x : (float)M_PI_2 - (float)M_PI_4 * x / y;
    out[0] = radius * cosf(angle), out[1] = radius * sinf(angle);
}

static float lamp_share(const trace_scene *s, int lamp, const light_point *p) {
    _Alignas(64) struct RTCRay16 rays;
    const trace_lamp *l = &s->light.lamp[lamp];
    if (dot3(l->to_lamp, p->normal) < -0.7f) return 1; /* light does not wrap around this far */
    uint64_t stream = 2 + 2 * (uint64_t)lamp;
    float turn[2] = {(float)random_uniform(p->key, stream), (float)random_uniform(p->key, stream + 1)};
    int lanes = l->half_angle_rad > 0 ? PACKET : 1, cast = 0, seen = 0;
    if (lanes < PACKET) memset(&rays, 0, sizeof rays); /* Embree asserts about idle lanes too */
    /* After the first packet, full light and full shadow are final. */
    while (cast < s->light.lamp_rays && (cast == 0 || (seen > 0 && seen < cast))) {
        for (int i = 0; i < lanes; i++) {
            const float *at = s->lamp_sample[cast + i];
            float on[2], d[3];
            disc(turned(at[0], turn[0]), turned(at[1], turn[1]), on);
            for (int k = 0; k < 3; k++)
                d[k] = l->to_lamp[k] + on[0] * s->lamp_u[lamp][k] + on[1] * s->lamp_v[lamp][k];
            unit3(d);
            float below = steepness - dot3(d, p->normal);
            for (int k = 0; k < 3 && below > 0; k++) d[k] += below * p->normal[k];
            ray_init(&rays, i, p, d, 4096 * (lamp + 1) + cast + i);
        }
        unsigned bits = free_rays(s, &rays, lanes);
        for (int i = 0; i < lanes; i++) seen += bits >> i & 1;
        cast += lanes;
        if (lanes == 1) break;
    }
    return (float)seen / (float)cast;
}

/* The point on the curved surface that the smooth normals imply (Hanika: Hacking the shadow terminator), so
 * that a coarse mesh does not shadow itself. */
static void place_point(const scene_mesh *mesh, const light_corner *at, int side, light_point *out) {
    float sign = side ? -1 : 1, flat[3] = {0}, own[3], curved[3] = {0};
    for (int k = 0; k < 3; k++) out->normal[k] = 0;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3 && at->share[i] > 0; k++) {
            flat[k] += at->share[i] * mesh->vertex[3 * (size_t)at->vertex[i] + (size_t)k];
            out->normal[k] += sign * at->share[i] * mesh->normal[3 * (size_t)at->vertex[i] + (size_t)k];
        }
    unit3(out->normal);
    if (!(dot3(out->normal, out->normal) > 0)) out->normal[1] = 1; /* a vertex without area */
    for (int i = 0; i < 3; i++) {
        if (!(at->share[i] > 0)) continue;
        const float *n = mesh->normal + 3 * (size_t)at->vertex[i],
                    *p = mesh->vertex + 3 * (size_t)at->vertex[i];
        for (int k = 0; k < 3; k++) own[k] = flat[k] - p[k];
        float inside = sign * dot3(own, n);
        if (inside > 0) inside = 0;
        for (int k = 0; k < 3; k++) curved[k] += at->share[i] * (flat[k] - inside * sign * n[k]);
    }
    for (int k = 0; k < 3; k++) out->origin[k] = curved[k] + standoff_m * out->normal[k];
}

static uint64_t trace_point(const trace_scene *s, const scene_mesh *mesh, const light_corner *at, int side) {
    light_point p;
    visible v = {0};
    place_point(mesh, at, side, &p);
    p.near_m = mesh->material.near_m;
    p.layer = (unsigned)mesh->material.layer;
    p.key = splitmix64(s->light.seed ^
                       splitmix64(2 * ((uint64_t)mesh->points_before + at->point) + (uint64_t)side));
    p.mask = ~seen_mask(TRACE_BY_CAMERAS);
    v.sky = sky_share(s, &p);
    p.mask &= ~seen_mask(TRACE_NOT_BY_LAMPS);
    for (int i = 0; i < s->light.lamps; i++) v.lamp[i] = lamp_share(s, i, &p);
    return visible_pack(&v);
}

static uint64_t light_word(const trace_scene *s, const scene_mesh *mesh, uint32_t face,
                           const light_corner *at, int side);

/* The value that the surrounding points suggest; 0 if they differ or are too far apart. */
static uint64_t guess_word(const trace_scene *s, const scene_mesh *mesh, uint32_t face,
                           const light_corner *at, int side) {
    light_corner parent[4];
    visible v = {0};
    uint64_t word[4];
    float apart_m;
    int count = light_parents(mesh, face, at, parent, &apart_m);
    if (apart_m > reach * s->spacing_m) return 0;
    for (int i = 0; i < count; i++) {
        word[i] = light_word(s, mesh, face, &parent[i], side);
        for (int k = 0; k <= TRACE_LAMPS && i > 0; k++) {
            int a = (int)(word[i] >> (k * SHARE_BITS) & SHARE_MAX);
            if (abs(a - (int)(word[0] >> (k * SHARE_BITS) & SHARE_MAX)) > agreement) return 0;
        }
        visible_add(word[i], parent[i].weight, &v);
    }
    return visible_pack(&v);
}

static uint64_t light_word(const trace_scene *s, const scene_mesh *mesh, uint32_t face,
                           const light_corner *at, int side) {
    _Atomic uint64_t *lit = &s->lit[2 * ((size_t)mesh->points_before + at->point) + (size_t)side].word;
    uint64_t word = atomic_load_explicit(lit, memory_order_relaxed);
    if (word) return word;
    if (at->kind != AT_VERTEX) word = guess_word(s, mesh, face, at, side);
    if (!word) word = trace_point(s, mesh, at, side);
    atomic_store_explicit(lit, word, memory_order_relaxed);
    return word;
}

void light_at(const trace_scene *s, int mesh, uint32_t face, const float barycentric[3], int side,
              visible *out) {
    light_corner corner[LIGHT_CORNERS];
    int count = light_corners(&s->mesh[mesh], face, barycentric, corner);
    *out = (visible){0};
    for (int i = 0; i < count; i++)
        visible_add(light_word(s, &s->mesh[mesh], face, &corner[i], side), corner[i].weight, out);
}

/* Embree's arrays of N: word n of ray or hit i is at [n * N + i]; its accessors are C++ only. */
enum { RAY_DIRECTION = 4, RAY_TFAR = 8, RAY_ID = 10, RAY_FLAGS = 11, HIT_U = 3, HIT_V = 4, HIT_FACE = 5 };

/* From a garment outward through skin that should be under it. */
static bool pokes_through(const scene_mesh *mesh, const struct RTCFilterFunctionNArguments *args,
                          unsigned i) {
    unsigned N = args->N;
    const float *ray = (const float *)args->ray, *hit = (const float *)args->hit;
    if (((const unsigned *)args->ray)[RAY_FLAGS * N + i] <= (unsigned)mesh->material.layer) return false;
    if (!(ray[RAY_TFAR * N + i] < TRACE_COVER_M)) return false;
    float out = 0;
    for (unsigned k = 0; k < 3; k++) out += hit[k * N + i] * ray[(RAY_DIRECTION + k) * N + i];
    return out > 0;
}

static bool lets_pass(const scene_mesh *mesh, const struct RTCFilterFunctionNArguments *args, unsigned i) {
    unsigned N = args->N, face = ((const unsigned *)args->hit)[HIT_FACE * N + i];
    if (mesh->solid[face]) return false;
    const float *hit = (const float *)args->hit, *corner = mesh->corner_uv + 6 * (size_t)face;
    float u = hit[HIT_U * N + i], v = hit[HIT_V * N + i], uv[2];
    for (int k = 0; k < 2; k++) uv[k] = (1 - u - v) * corner[k] + u * corner[2 + k] + v * corner[4 + k];
    float opacity = texture_opacity(mesh->material.color, uv), min = mesh->material.cutoff;
    if (mesh->material.alpha == TRACE_BLENDED) {
        uint64_t id = ((const unsigned *)args->ray)[RAY_ID * N + i], dice = splitmix64(id << 32 | face);
        min = (float)(dice >> 40) * 0x1p-24f + 0x1p-25f;
    }
    return opacity < min;
}

void light_filter(const struct RTCFilterFunctionNArguments *args) {
    const scene_mesh *mesh = args->geometryUserPtr;
    for (unsigned i = 0; i < args->N; i++) {
        if (!args->valid[i]) continue;
        if (pokes_through(mesh, args, i) || lets_pass(mesh, args, i)) args->valid[i] = 0;
    }
}
