/* Frames of baked avatars: skinning before the camera, and a rasteriser of small triangles.
 *
 * The person's rows are cut into bands, which threads take one by one; a band's samples, SUPER x SUPER per
 * pixel, fit into the L2 cache. A corner's place is rounded to 1/256 of a sample, so that edges are exact
 * integers and neighbours leave no gaps. A pixel's colour is the mean over its samples, or the colour at its
 * middle where all samples hit one surface; its opacity is the share of samples that hit a surface. */
#include "baked/form.h"

#include <math.h>
#include <string.h>

#include "sampling/tiles.h"
#include "scene/scene.h"

enum { SUPER = 3, SAMPLES = SUPER * SUPER, BAND_ROWS = 8, SUBPIXEL = 256 };
static const float near_m = 0.02f, far_px = 60000; /* triangles beyond these are not drawn */
/* At silhouettes opacity rises over twice this length, as far as pixels allow. The network's rises over more,
 * but imitating that costs more than it gains (docs/baked.md). */
static const float rim_m = 0.004f;
/* Samples of a pixel whose depths differ by more belong to different surfaces. */
static const float one_surface_m = 0.03f;

typedef struct {
    float u, v, inverse_z; /* in samples; inverse_z 0: not in front of the camera */
} corner;

typedef struct {
    int32_t row0, row1; /* of samples, [row0, row1); empty: not drawn */
    uint8_t level;      /* of the texture */
} span;

typedef struct {
    const baked_form *f;
    float joint[BODY_JOINTS][12]; /* rest pose to the camera */
    float bend[BODY_JOINTS][9];   /* -(F + F^T) / 2, see form.h */
    float focal[2], centre[2], skew, pelvis_z;
    /* in pixels: the picture, and the person's rectangle in it */
    int width, height, left, right, top, bottom;
    corner *corner;
    span *span;
    int bands;
    int32_t *first, *list; /* triangles by band: of band b, list[first[b]] to list[first[b + 1]] */
    float *sample_z;       /* inverse depth; a band's samples for each thread */
    int32_t *sample_face;
    const float *background;
    sherf_frame *frame;
} drawing;

static void joints_to_camera(const posed_body *p, const sherf_camera *k, drawing *d) {
    for (int j = 0; j < BODY_JOINTS; j++)
        for (int r = 0; r < 3; r++)
            for (int col = 0; col < 4; col++) {
                double x = col == 3 ? (double)k->T_m[r] : 0;
                for (int i = 0; i < 3; i++) {
                    double world = col == 3 ? (double)p->Th[i] : 0;
                    for (int m = 0; m < 3; m++)
                        world += (double)p->R[3 * i + m] * (double)p->transform[j][4 * m + col];
                    x += (double)k->R[3 * r + i] * world;
                }
                d->joint[j][4 * r + col] = (float)x;
            }
    for (int j = 1; j < BODY_JOINTS; j++) {
        const double *F = p->joints->feature + 9 * (j - 1);
        for (int r = 0; r < 3; r++)
            for (int col = 0; col < 3; col++)
                d->bend[j][3 * r + col] = (float)(-0.5 * (F[3 * r + col] + F[3 * col + r]));
    }
}

/* The corner in the rest pose, with the correction that keeps the body's volume. */
static void rest_place(const drawing *d, int64_t i, float rest[3]) {
    const baked_form *f = d->f;
    memcpy(rest, f->rest + 3 * i, 3 * sizeof *rest);
    for (int w = 0; w < 4 && f->fold; w++) {
        const float *bend = d->bend[f->fold_joint[4 * i + w]], *fold = f->fold + 12 * i + 3 * w;
        for (int r = 0; r < 3; r++)
            rest[r] += bend[3 * r] * fold[0] + bend[3 * r + 1] * fold[1] + bend[3 * r + 2] * fold[2];
    }
}

/* The corner before the camera, linearly blended. */
static void corner_place(const drawing *d, int64_t i, float x[3]) {
    const baked_form *f = d->f;
    float m[12] = {0}, rest[3];
    rest_place(d, i, rest);
    for (int w = 0; w < 4; w++) {
        const float weight = f->weight[4 * i + w], *joint = d->joint[f->joint[4 * i + w]];
        for (int k = 0; k < 12; k++) m[k] += weight * joint[k];
    }
    for (int r = 0; r < 3; r++)
        x[r] = m[4 * r] * rest[0] + m[4 * r + 1] * rest[1] + m[4 * r + 2] * rest[2] + m[4 * r + 3];
}

static void project(void *arg, int64_t begin, int64_t end, int thread) {
    const drawing *d = arg;
    for (int64_t i = begin; i < end; i++) {
        float x[3];
        corner_place(d, i, x);
        corner *out = &d->corner[i];
        out->inverse_z = x[2] > near_m ? 1 / x[2] : 0;
        const float u = (d->focal[0] * x[0] + d->skew * x[1]) * out->inverse_z + d->centre[0],
                    v = d->focal[1] * x[1] * out->inverse_z + d->centre[1];
        out->u = (u + 0.5f) * SUPER - 0.5f;
        out->v = (v + 0.5f) * SUPER - 0.5f;
        if (!(fabsf(u) < far_px && fabsf(v) < far_px)) out->inverse_z = 0;
    }
}

/* The texture level whose texels are as large as the picture's pixels. */
static uint8_t level_of(const baked_form *f, const uint32_t t[3], float area_samples) {
    const float *a = f->uv + 2 * (size_t)t[0], *b = f->uv + 2 * (size_t)t[1], *e = f->uv + 2 * (size_t)t[2];
    const float texels = fabsf((b[0] - a[0]) * (e[1] - a[1]) - (b[1] - a[1]) * (e[0] - a[0]));
    float pixel = texels * SAMPLES / area_samples; /* texels a pixel */
    uint8_t level = 0;
    for (; pixel > 2 && level + 1 < BAKED_LEVELS; pixel /= 4) level++;
    return level;
}

static void bound(void *arg, int64_t begin, int64_t end, int thread) {
    const drawing *d = arg;
    for (int64_t i = begin; i < end; i++) {
        const uint32_t *t = d->f->triangle + 3 * i;
        const corner *a = &d->corner[t[0]], *b = &d->corner[t[1]], *e = &d->corner[t[2]];
        d->span[i] = (span){0};
        const float area = (b->u - a->u) * (e->v - a->v) - (b->v - a->v) * (e->u - a->u);
        if (!(a->inverse_z > 0 && b->inverse_z > 0 && e->inverse_z > 0 && area < 0))
            continue; /* it shows its back */
        const float low = fminf(a->v, fminf(b->v, e->v)), high = fmaxf(a->v, fmaxf(b->v, e->v));
        const int32_t row0 = low < 0 ? 0 : (int32_t)low,
                      row1 = high < 0 ? 0 : (int32_t)fminf(high + 2, (float)(d->height * SUPER));
        d->span[i] = (span){row0, row1, level_of(d->f, t, -area)};
    }
}

/* The rectangle of pixels that the person can be in; false: none. */
static bool person_rectangle(drawing *d) {
    float low[2] = {1e9f, 1e9f}, high[2] = {-1e9f, -1e9f};
    for (int64_t i = 0; i < d->f->corners; i++) {
        const corner *p = &d->corner[i];
        if (!(p->inverse_z > 0)) continue;
        low[0] = fminf(low[0], p->u), high[0] = fmaxf(high[0], p->u);
        low[1] = fminf(low[1], p->v), high[1] = fmaxf(high[1], p->v);
    }
    if (low[0] > high[0]) return false;
    d->left = (int)fmaxf(0, floorf(low[0] / SUPER));
    d->top = (int)fmaxf(0, floorf(low[1] / SUPER));
    d->right = (int)fminf((float)d->width, ceilf(high[0] / SUPER) + 1);
    d->bottom = (int)fminf((float)d->height, ceilf(high[1] / SUPER) + 1);
    return d->left < d->right && d->top < d->bottom;
}

/* The bands that a triangle is in: [*b0, *b1). */
static void bands_of(const drawing *d, const span *s, int *b0, int *b1) {
    const int rows = BAND_ROWS * SUPER, top = d->top * SUPER, end = d->bottom * SUPER;
    const int row0 = s->row0 > top ? s->row0 : top, row1 = s->row1 < end ? s->row1 : end;
    *b0 = *b1 = 0;
    if (row0 >= row1) return;
    *b0 = (row0 - top) / rows;
    *b1 = (row1 - 1 - top) / rows + 1;
}

static sherf_status sort_by_band(context *c, drawing *d) {
    int b0, b1;
    d->bands = (d->bottom - d->top + BAND_ROWS - 1) / BAND_ROWS;
    if (!(d->first = mem_zero(c, (size_t)d->bands + 2, sizeof *d->first))) return SHERF_NO_MEMORY;
    int64_t entries = 0;
    for (int64_t i = 0; i < d->f->triangles; i++) {
        bands_of(d, &d->span[i], &b0, &b1);
        for (int b = b0; b < b1; b++) d->first[b + 2]++;
        entries += b1 - b0;
    }
    if (entries > INT32_MAX) return failure(c, SHERF_BAD_ARGUMENT, "a picture of this size is not drawn");
    for (int b = 0; b < d->bands; b++) d->first[b + 2] += d->first[b + 1];
    if (!(d->list = mem_alloc(c, (size_t)entries + 1, sizeof *d->list))) return SHERF_NO_MEMORY;
    for (int64_t i = 0; i < d->f->triangles; i++) {
        bands_of(d, &d->span[i], &b0, &b1);
        for (int b = b0; b < b1; b++) d->list[d->first[b + 1]++] = (int32_t)i;
    }
    return SHERF_OK;
}

/* ---- a band ---- */
typedef struct {
    int row0, row1, column0, columns; /* of samples: rows [row0, row1), columns from column0 on */
    float *z;
    int32_t *face;
} band;

/* An edge from a to b: value at sample (x, y) is at + dx x + dy y, negative inside; a sample on it belongs to
 * one of the two triangles that share it. */
typedef struct {
    int64_t at, dx, dy;
} edge;
static edge edge_of(const int64_t a[2], const int64_t b[2]) {
    const int64_t x = b[0] - a[0], y = b[1] - a[1];
    edge e = {x * -a[1] + y * a[0], -y * SUBPIXEL, x * SUBPIXEL};
    if (y > 0 || (y == 0 && x < 0)) e.at -= 1;
    return e;
}

static void draw_triangle(const drawing *d, const band *b, int32_t n) {
    const uint32_t *t = d->f->triangle + 3 * (size_t)n;
    int64_t p[3][2];
    float iz[3], left = 1e9f, right = -1e9f;
    edge e[3];
    for (int k = 0; k < 3; k++) {
        const corner *q = &d->corner[t[k]];
        p[k][0] = lrintf(q->u * SUBPIXEL);
        p[k][1] = lrintf(q->v * SUBPIXEL);
        iz[k] = q->inverse_z;
        left = fminf(left, q->u), right = fmaxf(right, q->u);
    }
    const int64_t area =
        (p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) - (p[1][1] - p[0][1]) * (p[2][0] - p[0][0]);
    if (area >= 0) return;
    for (int k = 0; k < 3; k++) e[k] = edge_of(p[(k + 1) % 3], p[(k + 2) % 3]);
    const int end = b->column0 + b->columns, x0 = left < (float)b->column0 ? b->column0 : (int)left,
              x1 = right + 2 < (float)end ? (int)(right + 2) : end;
    const int y0 = d->span[n].row0 > b->row0 ? d->span[n].row0 : b->row0,
              y1 = d->span[n].row1 < b->row1 ? d->span[n].row1 : b->row1;
    const float scale = 1 / (float)area;
    for (int y = y0; y < y1; y++) {
        int64_t v[3];
        for (int k = 0; k < 3; k++) v[k] = e[k].at + e[k].dx * x0 + e[k].dy * y;
        const size_t row = (size_t)(y - b->row0) * (size_t)b->columns - (size_t)b->column0;
        for (int x = x0; x < x1; x++) {
            if ((v[0] & v[1] & v[2]) < 0) { /* all are negative */
                const float z = scale * ((float)v[0] * iz[0] + (float)v[1] * iz[1] + (float)v[2] * iz[2]);
                if (z > b->z[row + (size_t)x]) {
                    b->z[row + (size_t)x] = z;
                    b->face[row + (size_t)x] = n;
                }
            }
            for (int k = 0; k < 3; k++) v[k] += e[k].dx;
        }
    }
}

/* The texture's colour of a triangle at a place in samples, bilinear between four texels. */
static void shade(const drawing *d, int32_t n, float x, float y, float rgb[3]) {
    const baked_form *f = d->f;
    const uint32_t *t = f->triangle + 3 * (size_t)n;
    const corner *a = &d->corner[t[0]], *b = &d->corner[t[1]], *e = &d->corner[t[2]];
    const float area = (b->u - a->u) * (e->v - a->v) - (b->v - a->v) * (e->u - a->u);
    float w[3];
    w[1] = ((x - a->u) * (e->v - a->v) - (y - a->v) * (e->u - a->u)) / area * b->inverse_z;
    w[2] = ((b->u - a->u) * (y - a->v) - (b->v - a->v) * (x - a->u)) / area * e->inverse_z;
    w[0] = a->inverse_z * (1 - w[1] / b->inverse_z - w[2] / e->inverse_z);
    const float sum = 1 / (w[0] + w[1] + w[2]);
    float at[2];
    for (int k = 0; k < 2; k++)
        at[k] = (w[0] * f->uv[2 * (size_t)t[0] + (size_t)k] + w[1] * f->uv[2 * (size_t)t[1] + (size_t)k] +
                 w[2] * f->uv[2 * (size_t)t[2] + (size_t)k]) *
                sum;
    const int level = d->span[n].level, side = f->side_px >> level;
    const float size = 1 / (float)(1 << level), last = (float)(side - 1);
    for (int k = 0; k < 2; k++) at[k] = fminf(fmaxf((at[k] + 0.5f) * size - 0.5f, 0), last);
    const int column = (int)fminf(at[0], last - 1), row = (int)fminf(at[1], last - 1);
    const float fx = at[0] - (float)column, fy = at[1] - (float)row;
    const uint8_t *p = f->texture[level] + 3 * ((size_t)row * (size_t)side + (size_t)column),
                  *q = p + 3 * side;
    for (int k = 0; k < 3; k++) {
        const float upper = (float)p[k] + fx * (float)(p[k + 3] - p[k]),
                    lower = (float)q[k] + fx * (float)(q[k + 3] - q[k]);
        rgb[k] = (upper + fy * (lower - upper)) * (1.0f / 255);
    }
}

static void write_pixel(const drawing *d, const band *b, int column, int row) {
    const size_t out = (size_t)row * (size_t)d->width + (size_t)column;
    const int x0 = column * SUPER, y0 = row * SUPER;
    float near = 0, far = 1e9f, sum[3] = {0, 0, 0}, depth = 0;
    int count = 0;
    int32_t middle = -1;
    for (int y = 0; y < SUPER; y++)
        for (int x = 0; x < SUPER; x++) {
            const size_t at = (size_t)(y0 + y - b->row0) * (size_t)b->columns + (size_t)(x0 + x - b->column0);
            if (b->face[at] < 0) continue;
            near = fmaxf(near, b->z[at]);
            far = fminf(far, b->z[at]);
            depth += b->z[at];
            if (middle < 0 || (x == SUPER / 2 && y == SUPER / 2)) middle = b->face[at];
            count++;
        }
    if (count == 0) return;
    const bool one = count == SAMPLES && 1 / far - 1 / near < one_surface_m;
    if (one) shade(d, middle, (float)x0 + 0.5f * (SUPER - 1), (float)y0 + 0.5f * (SUPER - 1), sum);
    for (int y = 0; y < SUPER && !one; y++)
        for (int x = 0; x < SUPER; x++) {
            const size_t at = (size_t)(y0 + y - b->row0) * (size_t)b->columns + (size_t)(x0 + x - b->column0);
            float rgb[3];
            if (b->face[at] < 0) continue;
            shade(d, b->face[at], (float)(x0 + x), (float)(y0 + y), rgb);
            for (int k = 0; k < 3; k++) sum[k] += rgb[k] * (1.0f / SAMPLES);
        }
    const float opacity = (float)count * (1.0f / SAMPLES);
    for (int k = 0; k < 3; k++)
        d->frame->color.data[3 * out + (size_t)k] = sum[k] + (1 - opacity) * d->background[k];
    d->frame->opacity.data[out] = opacity;
    d->frame->depth.data[out] = (float)count / depth;
}

static void draw_bands(void *arg, int64_t begin, int64_t end, int thread) {
    const drawing *d = arg;
    const size_t columns = (size_t)(d->right - d->left) * SUPER, room = columns * BAND_ROWS * SUPER;
    for (int64_t n = begin; n < end; n++) {
        const int top = d->top + (int)n * BAND_ROWS,
                  bottom = top + BAND_ROWS < d->bottom ? top + BAND_ROWS : d->bottom;
        band b = {top * SUPER,
                  bottom * SUPER,
                  d->left * SUPER,
                  (int)columns,
                  d->sample_z + (size_t)thread * room,
                  d->sample_face + (size_t)thread * room};
        memset(b.z, 0, room * sizeof *b.z);
        memset(b.face, 0xff, room * sizeof *b.face);
        for (int32_t i = d->first[n]; i < d->first[n + 1]; i++) draw_triangle(d, &b, d->list[i]);
        for (int row = top; row < bottom; row++)
            for (int column = d->left; column < d->right; column++) write_pixel(d, &b, column, row);
    }
}

static void clear_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const drawing *d = arg;
    const size_t width = (size_t)d->width, first = (size_t)begin * width, n = (size_t)(end - begin) * width;
    for (size_t i = first; i < first + n; i++)
        memcpy(d->frame->color.data + 3 * i, d->background, 3 * sizeof(float));
    memset(d->frame->opacity.data + first, 0, n * sizeof(float));
    memset(d->frame->depth.data + first, 0, n * sizeof(float));
}

/* Softens the silhouette by the rim's width at the pelvis' depth, over the person's rectangle enlarged by
 * that width. */
static sherf_status soften(context *c, const drawing *d) {
    const float z = d->pelvis_z > near_m ? d->pelvis_z : near_m;
    const float radius = rim_m * sqrtf(fabsf(d->focal[0] * d->focal[1])) / z;
    const int spare = (int)fminf(ceilf(radius), 32);
    const baked_soft s = {.left = d->left > spare ? d->left - spare : 0,
                          .right = d->right + spare < d->width ? d->right + spare : d->width,
                          .top = d->top > spare ? d->top - spare : 0,
                          .bottom = d->bottom + spare < d->height ? d->bottom + spare : d->height,
                          .radius_px = radius,
                          .background = d->background};
    return baked_soften(c, &s, d->frame);
}

static sherf_status draw(context *c, const posed_body *p, const sherf_camera *camera, drawing *d) {
    const baked_form *f = d->f;
    const size_t threads = (size_t)(c->threads > 0 ? c->threads : 1);
    d->width = camera->width_px;
    d->height = camera->height_px;
    d->focal[0] = camera->K[0], d->focal[1] = camera->K[4], d->skew = camera->K[1];
    d->centre[0] = camera->K[2], d->centre[1] = camera->K[5];
    joints_to_camera(p, camera, d);
    for (int k = 0; k < 3; k++) d->pelvis_z += d->joint[0][8 + k] * p->joints_rest[0][k];
    d->pelvis_z += d->joint[0][11];
    d->corner = mem_alloc(c, (size_t)f->corners, sizeof *d->corner);
    d->span = mem_alloc(c, (size_t)f->triangles, sizeof *d->span);
    if (!d->corner || !d->span) return SHERF_NO_MEMORY;
    sherf_status status = frame_shape(c, d->width, d->height, d->frame);
    if (status != SHERF_OK) return status;
    d->frame->points = 0;
    parallel_for(c, d->height, 64, clear_rows, d);
    parallel_for(c, f->corners, 1024, project, d);
    if (!person_rectangle(d)) return SHERF_OK;
    parallel_for(c, f->triangles, 1024, bound, d);
    if ((status = sort_by_band(c, d)) != SHERF_OK) return status;
    const size_t room = (size_t)(d->right - d->left) * SAMPLES * BAND_ROWS;
    d->sample_z = mem_alloc(c, threads * room, sizeof *d->sample_z);
    d->sample_face = mem_alloc(c, threads * room, sizeof *d->sample_face);
    if (!d->sample_z || !d->sample_face) return SHERF_NO_MEMORY;
    parallel_for(c, d->bands, 1, draw_bands, d);
    return soften(c, d);
}

sherf_status baked_draw(context *c, const baked_form *f, const body_model *body, const sherf_pose *pose,
                        const sherf_camera *camera, const float background[3], sherf_frame *frame) {
    drawing d = {.f = f, .background = background, .frame = frame};
    posed_body *p = NULL;
    sherf_status status = camera_check(c, camera);
    if (status == SHERF_OK)
        status = posed_joints_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, &p);
    if (status == SHERF_OK) status = draw(c, p, camera, &d);
    posed_body_free(p);
    mem_free(d.corner);
    mem_free(d.span);
    mem_free(d.first);
    mem_free(d.list);
    mem_free(d.sample_z);
    mem_free(d.sample_face);
    return status;
}

sherf_status baked_places(context *c, const baked_form *f, const body_model *body, const sherf_pose *pose,
                          float *world) {
    const sherf_camera here = {.R = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    drawing d = {.f = f};
    posed_body *p = NULL;
    const sherf_status status =
        posed_joints_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, &p);
    if (status == SHERF_OK) {
        joints_to_camera(p, &here, &d);
        for (int64_t i = 0; i < f->corners; i++) corner_place(&d, i, world + 3 * i);
    }
    posed_body_free(p);
    return status;
}
