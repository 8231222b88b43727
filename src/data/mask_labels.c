/* Masks with several values or colours: parts of a person, which touch each other, or several people. */
#include <stdio.h>
#include <string.h>

#include "data/view.h"

enum { LABELS_MAX = 64, REACH = 3, TOUCHES_MIN = 4, LISTED_MAX = 6 };

typedef struct {
    uint32_t color;
    size_t pixels;
    int group; /* of labels that touch: another label's place, or its own */
} label;
typedef struct {
    label item[LABELS_MAX];
    int count;
    bool many; /* more than fit */
} label_set;

static uint32_t color_at(const image_u8 *color, size_t i) {
    const uint8_t *p = color->data + 4 * i;
    return (uint32_t)p[0] << 16 | (uint32_t)p[1] << 8 | p[2];
}

/* The place of a colour, which is added if it is new; -1: there is no room. */
static int label_find(label_set *s, uint32_t color) {
    int i = 0;
    while (i < s->count && s->item[i].color != color) i++;
    if (i == LABELS_MAX) return -1;
    if (i == s->count) s->item[s->count++] = (label){color, 0, i};
    return i;
}

/* The labels of the mask's pixels; place: of each pixel's, plus 1, or NULL. */
static void labels_gather(const image_u8 *color, const image_u8 *mask, label_set *s, uint8_t *place) {
    const size_t n = (size_t)mask->width * mask->height;
    uint32_t last = 0;
    int at = -1;
    *s = (label_set){.count = 0};
    for (size_t i = 0; i < n && !s->many; i++) {
        if (place) place[i] = 0;
        if (!mask->data[i]) continue;
        const uint32_t own = color_at(color, i);
        if (at < 0 || own != last) at = label_find(s, own), last = own;
        s->many = at < 0;
        if (s->many) return;
        s->item[at].pixels++;
        if (place) place[i] = (uint8_t)(at + 1);
    }
}

static int group_of(const label_set *s, int i) {
    while (s->item[i].group != i) i = s->item[i].group;
    return i;
}

/* Joins the labels that come near each other at some places. */
static void labels_join(label_set *s, const uint8_t *place, int width, int height) {
    static const int8_t towards[2][2] = {{1, 0}, {0, 1}};
    uint8_t touches[LABELS_MAX][LABELS_MAX] = {{0}};
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            const int own = place[(size_t)y * width + x];
            for (int k = 1; k <= REACH && own; k++)
                for (int d = 0; d < 2; d++) {
                    const int u = x + k * towards[d][0], v = y + k * towards[d][1];
                    const int other = u < width && v < height ? place[(size_t)v * width + u] : 0;
                    if (!other || other == own) continue;
                    uint8_t *met =
                        &touches[own < other ? own - 1 : other - 1][own < other ? other - 1 : own - 1];
                    if (*met < TOUCHES_MIN && ++*met == TOUCHES_MIN)
                        s->item[group_of(s, own - 1)].group = group_of(s, other - 1);
                }
        }
}

/* Groups with at least a tenth of the mask. */
static int groups_count(const label_set *s) {
    size_t pixels[LABELS_MAX] = {0}, all = 0;
    int groups = 0;
    for (int i = 0; i < s->count; i++) pixels[group_of(s, i)] += s->item[i].pixels, all += s->item[i].pixels;
    for (int i = 0; i < s->count; i++) groups += 10 * pixels[i] >= all;
    return groups;
}

/* "1 (12 %), [128, 0, 0] (3 %)": shares of the picture. */
static void labels_list(const label_set *s, size_t total, char *out, size_t size) {
    size_t n = 0;
    *out = 0;
    for (int i = 0; i < s->count && i < LISTED_MAX && n + 64 < size; i++) {
        const unsigned color = s->item[i].color, r = color >> 16, g = color >> 8 & 255, b = color & 255;
        const double share = 100. * (double)s->item[i].pixels / (double)total;
        n +=
            (size_t)(r == g && g == b ? snprintf(out + n, size - n, "%s%u (%.2g %%)", i ? ", " : "", r, share)
                                      : snprintf(out + n, size - n, "%s[%u, %u, %u] (%.2g %%)", i ? ", " : "",
                                                 r, g, b, share));
    }
    if (s->count > LISTED_MAX) snprintf(out + n, size - n, " and %d more", s->count - LISTED_MAX);
}

static sherf_status label_take(context *c, const char *path, const image_u8 *color, uint32_t wanted,
                               image_u8 *mask) {
    const size_t n = (size_t)mask->width * mask->height;
    size_t found = 0;
    char listed[400];
    label_set s;
    labels_gather(color, mask, &s, NULL);
    labels_list(&s, n, listed, sizeof listed);
    for (size_t i = 0; i < n; i++) {
        mask->data[i] = mask->data[i] && color_at(color, i) == wanted;
        found += mask->data[i];
    }
    if (found) return SHERF_OK;
    return failure(c, SHERF_BAD_FILE, "%s: no pixel has the value of \"mask_label\"; it has %s", path,
                   listed);
}

static sherf_status labels_judge(context *c, const char *path, const label_set *s, size_t total, bool soft) {
    char listed[400];
    const int people = groups_count(s);
    labels_list(s, total, listed, sizeof listed);
    if (people > 1)
        return failure(c, SHERF_BAD_FILE,
                       "%s: %d people apart, by values %s: choose one by \"mask_label\", or \"all\" of them",
                       path, people, listed);
    if (!soft)
        log_line(c, SHERF_LOG_WARNING,
                 "%s: values %s are taken together as one person; \"mask_label\" takes one of them", path,
                 listed);
    return SHERF_OK;
}

sherf_status mask_labels(context *c, const char *path, const image_u8 *color, const mask_label *wanted,
                         bool soft, image_u8 *mask) {
    const size_t n = (size_t)mask->width * mask->height;
    label_set s;
    if (wanted->kind == MASK_LABEL_ALL) return SHERF_OK;
    if (wanted->kind == MASK_LABEL_ONE) return label_take(c, path, color, wanted->color, mask);
    labels_gather(color, mask, &s, NULL);
    for (int i = 0; i < s.count && !s.many; i++)
        if (!s.item[i].color)
            log_line(c, SHERF_LOG_WARNING,
                     "%s: values that are black in 8 bits are not told apart: write labels with 8 bits",
                     path);
    if (s.many || s.count < 2) return SHERF_OK;
    uint8_t *place = mem_alloc(c, n, 1);
    if (!place) return SHERF_NO_MEMORY;
    labels_gather(color, mask, &s, place);
    labels_join(&s, place, mask->width, mask->height);
    mem_free(place);
    return labels_judge(c, path, &s, n, soft);
}
