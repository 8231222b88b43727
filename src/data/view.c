/* Loads a picture with its mask, camera and pose from files: reads, undistorts, scales, masks. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "data/view.h"

enum { MASK_OUT = 0, MASK_PERSON = 1, MASK_EDGE = 100, EDGE_REACH = 2 };

/* Checks size and limits before anything is decoded. */
static sherf_status size_check(context *c, const char *path, int *width, int *height) {
    int channels;
    sherf_status status = image_size(c, path, width, height, &channels);
    if (status) return status;
    if (*width > VIEW_READ_SIDE_MAX || *height > VIEW_READ_SIDE_MAX)
        return failure(c, SHERF_UNSUPPORTED,
                       "%s: %d x %d pixels, at most %d on a side: scale the picture (and K) down", path,
                       *width, *height, VIEW_READ_SIDE_MAX);
    return SHERF_OK;
}

/* Whether there are some shades near black and some near white: a hard mask saved as a JPEG, whose background
 * is not quite black. */
static bool is_noisy(const size_t count[256]) {
    enum { BESIDE = 16, SHADES = 3 };
    int dark = 0, light = 0;
    for (int v = 1; v <= BESIDE; v++) dark += count[v] > 0, light += count[255 - v] > 0;
    return dark >= SHADES && light >= SHADES;
}

/* A soft mask is grey and has mostly white apart from black, or many shades, or the shades of a JPEG. Masks
 * of labels have few values or colours. Returns half of its brightest value, the smallest that counts as the
 * person; 0: it is not soft. */
static int mask_half(const image_u8 *color) {
    enum { SHADES_MIN = 32, WHITE = 250 };
    const size_t n = (size_t)color->width * color->height;
    size_t count[256] = {0}, white = 0;
    int shades = 0, brightest = 0;
    for (size_t i = 0; i < n; i++) {
        const uint8_t *p = color->data + 4 * i;
        if (abs(p[0] - p[1]) > 2 || abs(p[1] - p[2]) > 2) return 0;
        count[p[1]]++;
    }
    for (int v = 1; v < 256; v++) {
        shades += count[v] > 0;
        if (v >= WHITE) white += count[v];
        if (count[v]) brightest = v;
    }
    if (2 * white > n - count[0] || is_noisy(count)) return 128;
    return shades >= SHADES_MIN ? (brightest + 1) / 2 : 0;
}

/* Whether no colour is 0 and transparency marks the person. */
static bool mask_is_alpha(const image_u8 *color, const image_u8 *mask) {
    const size_t n = (size_t)mask->width * mask->height;
    size_t clear = 0;
    for (size_t i = 0; i < n; i++) {
        if (!mask->data[i]) return false;
        clear += color->data[4 * i + 3] < 128;
    }
    return clear > 0 && clear < n;
}

/* In a soft or transparent mask, the person begins at one half. In others, values may be labels. */
static sherf_status mask_harden(context *c, const char *path, const mask_label *label, image_u8 *mask) {
    image_u8 color = {0};
    sherf_status status = image_read(c, path, 4, &color);
    if (status) return status;
    const size_t n = (size_t)mask->width * mask->height;
    const bool alpha = mask_is_alpha(&color, mask);
    const int half = alpha ? 128 : label->kind == MASK_LABEL_ONE ? 0 : mask_half(&color);
    for (size_t i = 0; i < n && half; i++) mask->data[i] = color.data[4 * i + (alpha ? 3 : 1)] >= half;
    if (!alpha) status = mask_labels(c, path, &color, label, half > 0, mask);
    mem_free(color.data);
    return status;
}

/* A person does not fill a picture's border. */
static void mask_inverted_warn(context *c, const char *path, const image_u8 *mask) {
    const int w = mask->width, h = mask->height;
    int64_t border = 0, person = 0;
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            if (x && x < w - 1 && y && y < h - 1) continue;
            border++;
            person += mask->data[(size_t)y * w + x] != 0;
        }
    if (person * 4 > border * 3)
        log_line(c, SHERF_LOG_WARNING, "%s: the mask covers the border of the picture: is it inverted?",
                 path);
}

/* 1 where any channel is not 0; in soft masks, and for the picture's alpha if there is no mask file, where
 * the value is at least one half. */
static sherf_status mask_read(context *c, const view_source *s, image_u8 *out) {
    image_u8 color = {0};
    if (s->mask) {
        sherf_status read = image_read(c, s->mask, IMAGE_MASK, out);
        if (!read && s->observed) read = mask_harden(c, s->mask, &s->label, out);
        if (!read && s->observed) mask_inverted_warn(c, s->mask, out);
        return read;
    }
    sherf_status status = image_read(c, s->image, 4, &color);
    if (status) return status;
    size_t n = (size_t)color.width * color.height;
    for (size_t i = 0; i < n; i++) color.data[i] = color.data[i * 4 + 3] >= 128; /* in place: i <= 4 i */
    color.channels = 1;
    *out = color;
    return SHERF_OK;
}

/* The mask's size must be the picture's; without a mask file the picture needs an alpha channel. */
static sherf_status mask_check(context *c, const view_source *s, int width, int height) {
    int mask_width, mask_height, channels;
    if (!s->mask) {
        sherf_status status = image_size(c, s->image, &mask_width, &mask_height, &channels);
        if (status || channels == 4 || channels == 2) return status;
        return failure(c, SHERF_BAD_FILE, "%s: no mask is named, and the picture has no alpha channel",
                       s->image);
    }
    sherf_status status = size_check(c, s->mask, &mask_width, &mask_height);
    if (status || (width == mask_width && height == mask_height)) return status;
    return failure(c, SHERF_MISMATCH, "%s: a mask of %d x %d pixels for a picture of %d x %d", s->mask,
                   mask_width, mask_height, width, height);
}

/* Largest and smallest value within EDGE_REACH along one axis, both kept as bits: 1 some are set, 2 some are
 * not. Pixels beyond the border count as neither, as in OpenCV's dilate and erode. */
static void reach_along(const uint8_t *in, uint8_t *out, int n, size_t stride) {
    for (int i = 0; i < n; i++) {
        uint8_t bits = 0;
        for (int k = i - EDGE_REACH; k <= i + EDGE_REACH; k++)
            if (k >= 0 && k < n) bits |= in[(size_t)k * stride];
        out[(size_t)i * stride] = bits;
    }
}

/* Where the 5 x 5 dilated and eroded masks differ, the pixel is uncertain. */
static sherf_status mark_edge(context *c, image_u8 *mask) {
    size_t n = (size_t)mask->width * mask->height;
    uint8_t *a = mem_alloc(c, n, 1), *b = mem_alloc(c, n, 1);
    if (a && b) {
        for (size_t i = 0; i < n; i++) a[i] = mask->data[i] ? 1 : 2;
        for (int y = 0; y < mask->height; y++)
            reach_along(a + (size_t)y * mask->width, b + (size_t)y * mask->width, mask->width, 1);
        for (int x = 0; x < mask->width; x++) reach_along(b + x, a + x, mask->height, (size_t)mask->width);
        for (size_t i = 0; i < n; i++)
            if (a[i] == 3) mask->data[i] = MASK_EDGE;
    }
    bool ok = a && b;
    mem_free(a);
    mem_free(b);
    return ok ? SHERF_OK : SHERF_NO_MEMORY;
}

static sherf_status picture_read(context *c, const char *path, sherf_image *out) {
    image_u8 bytes = {0};
    sherf_status status = image_read(c, path, 3, &bytes);
    if (status) return status;
    size_t n = (size_t)bytes.width * bytes.height * 3;
    *out = (sherf_image){bytes.width, bytes.height, 3, mem_alloc(c, n, sizeof(float))};
    if (out->data)
        for (size_t i = 0; i < n; i++) out->data[i] = bytes.data[i] / 255.f;
    mem_free(bytes.data);
    return out->data ? SHERF_OK : SHERF_NO_MEMORY;
}

/* mask: MASK_* and, after undistortion, blends of them: whatever lies between person and edge is uncertain.
 */
static sherf_status masks_split(context *c, data_view *v, const image_u8 *mask, bool edge_band) {
    size_t n = (size_t)mask->width * mask->height;
    v->mask = mem_alloc(c, n, 1);
    if (!v->mask) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) v->mask[i] = mask->data[i] == MASK_PERSON;
    if (!edge_band) return SHERF_OK;
    v->unknown = mem_alloc(c, n, 1);
    if (!v->unknown) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) v->unknown[i] = mask->data[i] > MASK_PERSON;
    return SHERF_OK;
}

static sherf_status target_size(context *c, const view_source *s, int width, int height, int *to_width,
                                int *to_height) {
    double scale = s->width ? (double)s->width / width : s->scale;
    *to_width = s->width ? s->width : (int)(width * scale + 1e-6);
    *to_height = (int)(height * scale + 1e-6);
    if (s->observed && *to_width >= 1 && *to_height >= 1)
        observation_limit_size(c, s->image, to_width, to_height);
    if (*to_width >= 1 && *to_height >= 1 && *to_width <= VIEW_SIDE_MAX && *to_height <= VIEW_SIDE_MAX)
        return SHERF_OK;
    return failure(c, SHERF_BAD_ARGUMENT, "%s: %d x %d pixels cannot become %d x %d", s->image, width, height,
                   *to_width, *to_height);
}

sherf_status view_assemble(context *c, const view_source *s, data_view **out) {
    *out = NULL;
    image_u8 mask = {0};
    int width, height, to_width, to_height;
    data_view *v = mem_zero(c, 1, sizeof *v);
    sherf_status status = v ? SHERF_OK : SHERF_NO_MEMORY;
    if (status || (status = size_check(c, s->image, &width, &height)) ||
        (status = mask_check(c, s, width, height)))
        goto done;
    if ((status = target_size(c, s, width, height, &to_width, &to_height)) ||
        (status = mask_read(c, s, &mask)) || (status = picture_read(c, s->image, &v->image)) ||
        (s->edge_band && (status = mark_edge(c, &mask))) ||
        (status = image_undistort_f32(c, &v->image, s->camera.K, s->camera.D)) ||
        (status = image_undistort(c, &mask, s->camera.K, s->camera.D)))
        goto done;
    for (size_t i = 0; i < (size_t)width * height && !s->whole; i++)
        if (mask.data[i] == MASK_OUT) memset(v->image.data + i * 3, 0, 3 * sizeof(float));
    if ((status = image_resize_area(c, &v->image, to_width, to_height)) ||
        (status = image_resize_nearest(c, &mask, to_width, to_height)) ||
        (status = masks_split(c, v, &mask, s->edge_band)))
        goto done;
    parsed_camera_to(&s->camera, width, height, to_width, to_height, &v->camera);
    v->pose = s->pose;
    *out = v;
    v = NULL;
done:
    mem_free(mask.data);
    sherf_observation_free(v);
    return status;
}
