/* The fields of a query: names and values come from the network. */
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "viewer/viewer.h"

void query_start(view_query *q) {
    *q = (view_query){
        .wish = {.width = 128, .height = 128, .zoom = 1, .follow = true}, .film_fps = 25, .film_speed = 1};
}

static bool whole(const char *text, long least, long most, int *out) {
    char *end;
    if ((*text < '0' || *text > '9') && *text != '-') return false;
    errno = 0;
    long v = strtol(text, &end, 10);
    if (errno || *end || end == text || v < least || v > most) return false;
    *out = (int)v;
    return true;
}

static bool real(const char *text, float least, float most, float *out) {
    char *end;
    if (strspn(text, "0123456789+-.e") != strlen(text)) return false; /* no hexadecimals, no names */
    float v = strtof(text, &end);
    if (*end || end == text || !(v >= least && v <= most)) return false;
    *out = v;
    return true;
}

static bool yes_or_no(const char *text, bool *out) {
    if ((*text != '0' && *text != '1') || text[1]) return false;
    *out = *text == '1';
    return true;
}

static bool mode(const char *text, view_mode *out) {
    static const char *const names[] = {"color", "opacity", "depth", "normal"};
    for (size_t i = 0; i < COUNT_OF(names); i++)
        if (strcmp(text, names[i]) == 0) {
            *out = (view_mode)i;
            return true;
        }
    return false;
}

/* "rrggbb" or "none". */
static bool background(const char *text, view_wish *w) {
    w->transparent = strcmp(text, "none") == 0;
    if (w->transparent) return true;
    if (strlen(text) != 6 || strspn(text, "0123456789abcdef") != 6) return false;
    unsigned long v = strtoul(text, NULL, 16);
    for (int k = 0; k < 3; k++) w->background[k] = (float)(v >> (16 - 8 * k) & 255) / 255;
    return true;
}

static bool client_name(const char *text, char out[VIEW_NAME + 1]) {
    size_t n = strlen(text);
    if (n < 4 || n > VIEW_NAME || strspn(text, "0123456789abcdefghijklmnopqrstuvwxyz") != n) return false;
    memcpy(out, text, n + 1);
    return true;
}

static bool sequence(const char *text, uint64_t *out) {
    size_t n = strlen(text);
    if (n < 1 || n > 15 || strspn(text, "0123456789") != n) return false;
    *out = strtoull(text, NULL, 10);
    return true;
}

bool query_take(view_query *q, const char *name, const char *value) {
    static const char *const names[] = {"client", "n",      "avatar", "motion", "frame", "w",   "h",
                                        "az",     "el",     "zoom",   "ox",     "oy",    "oz",  "mode",
                                        "bg",     "follow", "png",    "fine",   "turn",  "fps", "speed"};
    view_wish *w = &q->wish;
    size_t i = 0;
    while (i < COUNT_OF(names) && strcmp(name, names[i]) != 0) i++;
    if (i == COUNT_OF(names) || !value || q->seen >> i & 1) return false;
    q->seen |= 1u << i;
    switch (i) {
    case 0:
        return client_name(value, q->client);
    case 1:
        return sequence(value, &q->sequence);
    case 2:
        return whole(value, 0, VIEW_AVATARS, &w->avatar);
    case 3:
        return whole(value, 0, VIEW_MOTIONS + VIEW_OWN_MOTIONS, &w->motion);
    case 4:
        return whole(value, 0, 100000000, &w->frame);
    case 5:
        return whole(value, VIEW_SIDE_MIN, 2 * VIEW_SIDE_MAX, &w->width);
    case 6:
        return whole(value, VIEW_SIDE_MIN, 2 * VIEW_SIDE_MAX, &w->height);
    case 7:
        return real(value, -1000, 1000, &w->azimuth_rad);
    case 8:
        return real(value, -1.5708f, 1.5708f, &w->elevation_rad);
    case 9:
        return real(value, 0.05f, 50, &w->zoom);
    case 10:
    case 11:
    case 12:
        return real(value, -20, 20, &w->offset_m[i - 10]);
    case 13:
        return mode(value, &w->mode);
    case 14:
        return background(value, w);
    case 15:
        return yes_or_no(value, &w->follow);
    case 16:
        return yes_or_no(value, &w->lossless);
    case 17:
        return yes_or_no(value, &w->fine);
    case 18:
        return whole(value, 0, VIEW_FILM_FRAMES, &q->film_frames);
    case 19:
        return real(value, 1, 120, &q->film_fps);
    default:
        return real(value, 0.05f, 20, &q->film_speed);
    }
}
