/* mask: the network's mask, followed along the picture's edges by two guided filters: a wide one, in which
 * only pixels count that the network is sure of, so that an uncertain pixel follows nearby pixels of its
 * colour; and a narrow one for hair and edges, whose planes over colour are then applied to the photo at its
 * own resolution. */
#include "estimate/mask.h"

#include <math.h>
#include <string.h>

#include "estimate/guided.h"
#include "estimate/local_color.h"
#include "estimate/mask_clean.h"
#include "estimate/shrink.h"

enum { WORK_SIDE = 1024 };

/* In pixels of the network's mask: cells and rounds of the colours, windows of the two filters. */
static const float cell_mask_px = 8, wide_mask_px = 6, narrow_mask_px = 2;
enum { COLOR_ROUNDS = 2 };
static const float epsilon = 1e-4f, certainty_min = 0.02f;
/* A fitted value up to the first is background, from 1 - it on person; after the wide filter and the narrow
 * one. */
static const float cut_wide = 0.2f, cut_narrow = 0.1f;
static const float over_share = 0.02f;

/* The part of the photo to work on, and its scaled size. */
typedef struct {
    int left, top, width, height; /* photo pixels */
    int to_width, to_height;
} window;

static bool window_of(const sherf_image *photo, const photo_region *region, window *out) {
    const float co = cosf(region->angle_rad), si = sinf(region->angle_rad);
    const float reach = region->side_px / 2 * (fabsf(co) + fabsf(si));
    const float left = fmaxf(0, floorf(region->centre_px[0] - reach)),
                top = fmaxf(0, floorf(region->centre_px[1] - reach)),
                right = fminf((float)photo->width, ceilf(region->centre_px[0] + reach) + 1),
                bottom = fminf((float)photo->height, ceilf(region->centre_px[1] + reach) + 1);
    if (!(right - left >= 1 && bottom - top >= 1 && region->side_px >= 1)) return false;
    *out = (window){(int)left, (int)top, (int)right - (int)left, (int)bottom - (int)top, 0, 0};
    const int longest = out->width > out->height ? out->width : out->height;
    const double scale = longest > WORK_SIDE ? (double)WORK_SIDE / longest : 1;
    out->to_width = (int)fmax(1, lrint(out->width * scale));
    out->to_height = (int)fmax(1, lrint(out->height * scale));
    return true;
}

/* ---- the window as a small picture ---- */
typedef struct {
    const sherf_image *photo;
    const window *window;
} window_view;

static void window_row(const void *user, int y, float *row) {
    const window_view *v = user;
    const window *w = v->window;
    memcpy(row, v->photo->data + ((size_t)(w->top + y) * (size_t)v->photo->width + (size_t)w->left) * 3,
           (size_t)w->width * 3 * sizeof *row);
}

static sherf_status window_picture(context *c, const sherf_image *photo, const window *w, sherf_image *out) {
    const window_view v = {photo, w};
    *out = (sherf_image){w->to_width, w->to_height, 3, NULL};
    return picture_shrink(c, window_row, &v, w->width, w->height, out);
}

/* ---- the network's mask ---- */

/* Bilinear; 0 outside the region. */
static float inside_at(const photo_person *p, float co, float si, double x_px, double y_px) {
    const double dx = (x_px - p->region.centre_px[0]) / p->region.side_px,
                 dy = (y_px - p->region.centre_px[1]) / p->region.side_px;
    const double u = co * dx + si * dy + 0.5, v = co * dy - si * dx + 0.5;
    if (!(u >= 0 && u <= 1 && v >= 0 && v <= 1)) return 0;
    const double max = PERSON_MASK_SIDE - 1;
    const double x = fmin(fmax(u * PERSON_MASK_SIDE - 0.5, 0), max),
                 y = fmin(fmax(v * PERSON_MASK_SIDE - 0.5, 0), max);
    const int x0 = (int)x, y0 = (int)y, x1 = x0 + (x0 < max), y1 = y0 + (y0 < max);
    const float fx = (float)(x - x0), fy = (float)(y - y0);
    const float *a = p->inside + y0 * PERSON_MASK_SIDE, *b = p->inside + y1 * PERSON_MASK_SIDE;
    return (a[x0] * (1 - fx) + a[x1] * fx) * (1 - fy) + (b[x0] * (1 - fx) + b[x1] * fx) * fy;
}

typedef struct {
    const photo_person *person, *others;
    int other_count;
    const window *window;
    float *out;
} reading;

/* ---- pixels that two people claim: they belong to the one whose bones are nearer ---- */
static float distance_to_bone(const landmark *a, const landmark *b, float x, float y) {
    const float dx = b->place_px[0] - a->place_px[0], dy = b->place_px[1] - a->place_px[1];
    const float length2 = dx * dx + dy * dy;
    float t = length2 > 0 ? ((x - a->place_px[0]) * dx + (y - a->place_px[1]) * dy) / length2 : 0;
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    return hypotf(a->place_px[0] + t * dx - x, a->place_px[1] + t * dy - y);
}

static float distance_to_bones(const photo_person *p, float x, float y) {
    static const uint8_t bone[][2] = {
        {LANDMARK_LEFT_SHOULDER, LANDMARK_RIGHT_SHOULDER}, {LANDMARK_LEFT_SHOULDER, LANDMARK_LEFT_ELBOW},
        {LANDMARK_LEFT_ELBOW, LANDMARK_LEFT_WRIST},        {LANDMARK_LEFT_WRIST, LANDMARK_LEFT_INDEX},
        {LANDMARK_RIGHT_SHOULDER, LANDMARK_RIGHT_ELBOW},   {LANDMARK_RIGHT_ELBOW, LANDMARK_RIGHT_WRIST},
        {LANDMARK_RIGHT_WRIST, LANDMARK_RIGHT_INDEX},      {LANDMARK_LEFT_SHOULDER, LANDMARK_LEFT_HIP},
        {LANDMARK_RIGHT_SHOULDER, LANDMARK_RIGHT_HIP},     {LANDMARK_LEFT_SHOULDER, LANDMARK_RIGHT_HIP},
        {LANDMARK_RIGHT_SHOULDER, LANDMARK_LEFT_HIP},      {LANDMARK_LEFT_HIP, LANDMARK_RIGHT_HIP},
        {LANDMARK_LEFT_HIP, LANDMARK_LEFT_KNEE},           {LANDMARK_LEFT_KNEE, LANDMARK_LEFT_ANKLE},
        {LANDMARK_LEFT_ANKLE, LANDMARK_LEFT_TOE},          {LANDMARK_RIGHT_HIP, LANDMARK_RIGHT_KNEE},
        {LANDMARK_RIGHT_KNEE, LANDMARK_RIGHT_ANKLE},       {LANDMARK_RIGHT_ANKLE, LANDMARK_RIGHT_TOE},
        {LANDMARK_LEFT_EAR, LANDMARK_RIGHT_EAR},           {LANDMARK_NOSE, LANDMARK_LEFT_SHOULDER},
        {LANDMARK_NOSE, LANDMARK_RIGHT_SHOULDER}};
    float min = INFINITY;
    for (size_t i = 0; i < COUNT_OF(bone); i++)
        min = fminf(min, distance_to_bone(&p->landmark[bone[i][0]], &p->landmark[bone[i][1]], x, y));
    return min;
}

/* The share of `mine` that remains where others claim the pixel too. */
static float without_others(const reading *r, float mine, float x, float y) {
    float left = mine, own = -1;
    for (int i = 0; i < r->other_count && left > 0.01f; i++) {
        const photo_person *o = &r->others[i];
        const float theirs = inside_at(o, cosf(o->region.angle_rad), sinf(o->region.angle_rad), x, y);
        if (theirs < 0.02f) continue;
        if (own < 0) own = distance_to_bones(r->person, x, y);
        const float nearer = (own - distance_to_bones(o, x, y)) / (0.02f * r->person->region.side_px);
        left = fminf(left, mine / (1 + theirs * expf(fminf(nearer, 20))));
    }
    return left;
}

static void prior_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const reading *r = arg;
    const window *w = r->window;
    const float co = cosf(r->person->region.angle_rad), si = sinf(r->person->region.angle_rad);
    const double scale_x = (double)w->width / w->to_width, scale_y = (double)w->height / w->to_height;
    for (int y = (int)begin; y < end; y++)
        for (int x = 0; x < w->to_width; x++) {
            const double x_px = w->left + (x + 0.5) * scale_x - 0.5,
                         y_px = w->top + (y + 0.5) * scale_y - 0.5;
            float v = inside_at(r->person, co, si, x_px, y_px);
            if (v > 0.01f && r->other_count) v = without_others(r, v, (float)x_px, (float)y_px);
            r->out[(size_t)y * w->to_width + x] = v;
        }
}

sherf_status person_mask_network(context *c, const sherf_image *photo, const photo_person *person,
                                 sherf_image *mask) {
    const window all = {0, 0, photo->width, photo->height, photo->width, photo->height};
    *mask = (sherf_image){photo->width, photo->height, 1,
                          mem_alloc(c, (size_t)photo->width * photo->height, sizeof(float))};
    if (!mask->data) return SHERF_NO_MEMORY;
    reading r = {person, NULL, 0, &all, mask->data};
    parallel_for(c, photo->height, 16, prior_rows, &r);
    return SHERF_OK;
}

/* ---- refinement ---- */
typedef struct {
    const sherf_image *photo;
    sherf_image picture; /* the window */
    window window;
    float *prior, *value, *weight, *planes; /* [h, w] of each, planes [h, w, 4] */
} work;

static void work_free(work *k) {
    sherf_image_free(&k->picture);
    mem_free(k->prior);
    mem_free(k->value);
    mem_free(k->weight);
    mem_free(k->planes);
}

/* Smooth step from 0 at `from` to 1 at `to`. */
static float ramp(float v, float from, float to) {
    float t = (v - from) / (to - from);
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    return t * t * (3 - 2 * t);
}

typedef struct {
    work *k;
    const photo_region *region;
    sherf_image *mask;
} laying;

static float fitted(const float plane[4], const float color[3], float cut) {
    return ramp(guided_value(plane, color), cut, 1 - cut);
}

static void planes_apply(work *k, float cut) {
    const size_t n = (size_t)k->picture.width * k->picture.height;
    for (size_t i = 0; i < n; i++) k->value[i] = fitted(k->planes + 4 * i, k->picture.data + 3 * i, cut);
}

/* Applies the narrow filter's planes, interpolated from the small picture, to the photo's own pixels. */
static void lay_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const laying *l = arg;
    const window *w = &l->k->window;
    const double scale_x = (double)w->to_width / w->width, scale_y = (double)w->to_height / w->height;
    const float co = cosf(l->region->angle_rad), si = sinf(l->region->angle_rad),
                half = l->region->side_px / 2;
    for (int row = (int)begin; row < end; row++) {
        const int y = w->top + row;
        const double v = fmin(fmax((row + 0.5) * scale_y - 0.5, 0), w->to_height - 1);
        const int v0 = (int)v, v1 = v0 + (v0 + 1 < w->to_height);
        const float fv = (float)(v - v0), dy = (float)y - l->region->centre_px[1];
        for (int column = 0; column < w->width; column++) {
            const float dx = (float)(w->left + column) - l->region->centre_px[0];
            if (fabsf(co * dx + si * dy) > half || fabsf(co * dy - si * dx) > half) continue;
            const double u = fmin(fmax((column + 0.5) * scale_x - 0.5, 0), w->to_width - 1);
            const int u0 = (int)u, u1 = u0 + (u0 + 1 < w->to_width);
            const float fu = (float)(u - u0);
            const float *p[4] = {l->k->planes + ((size_t)v0 * w->to_width + u0) * 4,
                                 l->k->planes + ((size_t)v0 * w->to_width + u1) * 4,
                                 l->k->planes + ((size_t)v1 * w->to_width + u0) * 4,
                                 l->k->planes + ((size_t)v1 * w->to_width + u1) * 4};
            bool nothing = true; /* most of the region: far from the person */
            for (int i = 0; i < 4 && nothing; i++) nothing = !p[i][3] && !p[i][0] && !p[i][1] && !p[i][2];
            if (nothing) continue;
            float plane[4];
            for (int i = 0; i < 4; i++)
                plane[i] =
                    (p[0][i] * (1 - fu) + p[1][i] * fu) * (1 - fv) + (p[2][i] * (1 - fu) + p[3][i] * fu) * fv;
            const size_t at = (size_t)y * l->mask->width + (size_t)(w->left + column);
            l->mask->data[at] = fitted(plane, l->k->photo->data + 3 * at, cut_narrow);
        }
    }
}

static int radius_of(float px, int min) {
    const int radius = (int)lrintf(px);
    return radius < min ? min : radius;
}

/* mask_px: of the small picture, one of the network's mask. */
static sherf_status refine(context *c, work *k, float mask_px) {
    sherf_status status = SHERF_OK;
    const int width = k->picture.width, height = k->picture.height;
    const size_t n = (size_t)width * height;
    memcpy(k->prior, k->value, n * sizeof *k->prior);
    for (int i = 0; i < COLOR_ROUNDS && !status; i++)
        status = local_color_sharpen(c, &k->picture, radius_of(mask_px * cell_mask_px, 4), k->value);
    if (status) return status;
    for (size_t i = 0; i < n; i++) {
        const float certainty = (2 * k->value[i] - 1) * (2 * k->value[i] - 1);
        k->weight[i] = certainty_min + certainty * certainty;
    }
    status = guided_fit(c, &k->picture, k->value, k->weight, radius_of(mask_px * wide_mask_px, 3), epsilon,
                        k->planes);
    if (status) return status;
    planes_apply(k, cut_wide);
    if ((status = mask_clean(c, width, height, k->prior, mask_px, k->value))) return status;
    for (size_t i = 0; i < n; i++) k->weight[i] = 1;
    return guided_fit(c, &k->picture, k->value, k->weight, radius_of(mask_px * narrow_mask_px, 2), epsilon,
                      k->planes);
}

/* ---- facts ---- */
static bool is_person(const sherf_image *mask, float x, float y, bool *in_photo) {
    const long column = lrintf(x), row = lrintf(y);
    *in_photo = column >= 0 && row >= 0 && column < mask->width && row < mask->height;
    return *in_photo && mask->data[(size_t)row * mask->width + (size_t)column] >= 0.5f;
}

static void tell(const sherf_image *mask, const photo_region *region, person_mask_facts *out) {
    const size_t n = (size_t)mask->width * mask->height;
    const float co = cosf(region->angle_rad), si = sinf(region->angle_rad), step = region->side_px / 256;
    const float inner = region->side_px / 2 - 1.5f; /* just inside, where the mask is not 0 by rule */
    size_t person = 0, outline = 0, crossed = 0, touched[4] = {0};
    for (size_t i = 0; i < n; i++) person += mask->data[i] >= 0.5f;
    for (int i = 0; i < 4 * 256; i++) {
        const float along = ((float)(i / 4) + 0.5f) * step - region->side_px / 2,
                    off = i & 1 ? inner : -inner;
        const float dx = i & 2 ? along : off, dy = i & 2 ? off : along;
        bool in_photo;
        crossed += is_person(mask, region->centre_px[0] + co * dx - si * dy,
                             region->centre_px[1] + si * dx + co * dy, &in_photo);
        outline += in_photo;
    }
    for (int y = 0; y < mask->height; y++) {
        const float *row = mask->data + (size_t)y * mask->width;
        touched[0] += row[0] >= 0.5f, touched[2] += row[mask->width - 1] >= 0.5f;
    }
    for (int x = 0; x < mask->width; x++)
        touched[1] += mask->data[x] >= 0.5f, touched[3] += mask->data[n - (size_t)mask->width + x] >= 0.5f;
    *out = (person_mask_facts){.area = (float)person / (float)n,
                               .cut_off = outline ? (float)crossed / (float)outline : 0};
    out->over = out->cut_off > over_share;
    for (int i = 0; i < 4; i++)
        out->border[i] = (float)touched[i] / (float)(i % 2 ? mask->width : mask->height);
}

static sherf_status work_take(context *c, const sherf_image *photo, work *k) {
    const size_t n = (size_t)k->window.to_width * k->window.to_height;
    k->photo = photo;
    k->prior = mem_alloc(c, n, sizeof *k->prior);
    k->value = mem_alloc(c, n, sizeof *k->value);
    k->weight = mem_alloc(c, n, sizeof *k->weight);
    k->planes = mem_alloc(c, n, 4 * sizeof *k->planes);
    if (!k->prior || !k->value || !k->weight || !k->planes) return SHERF_NO_MEMORY;
    return window_picture(c, photo, &k->window, &k->picture);
}

sherf_status person_mask(context *c, const sherf_image *photo, const photo_person *person,
                         const photo_person *others, int other_count, sherf_image *mask,
                         person_mask_facts *facts) {
    work k = {0};
    person_mask_facts said;
    *mask = (sherf_image){0};
    if (photo->channels != 3 || !window_of(photo, &person->region, &k.window))
        return failure(c, SHERF_BAD_ARGUMENT, "mask: the person's region lies outside the photo");
    sherf_status status = work_take(c, photo, &k);
    if (status) goto done;
    reading r = {person, others, other_count, &k.window, k.value};
    parallel_for(c, k.window.to_height, 16, prior_rows, &r);
    const float mask_px =
        person->region.side_px / PERSON_MASK_SIDE * (float)k.window.to_width / (float)k.window.width;
    if ((status = refine(c, &k, mask_px))) goto done;
    *mask = (sherf_image){photo->width, photo->height, 1,
                          mem_zero(c, (size_t)photo->width * photo->height, sizeof(float))};
    if (!mask->data) {
        status = SHERF_NO_MEMORY;
        goto done;
    }
    laying l = {&k, &person->region, mask};
    parallel_for(c, k.window.height, 16, lay_rows, &l);
    tell(mask, &person->region, &said);
    if (!(said.area > 0)) status = failure(c, SHERF_BAD_ARGUMENT, "mask: nothing of the person is seen");
    if (facts) *facts = said;
done:
    work_free(&k);
    if (status) sherf_image_free(mask);
    return status;
}
