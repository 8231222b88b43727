/* Parses a query's fields: names and values come from the network. */
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "viewer/viewer.h"

void query_start(viewer_query *q) {
    *q = (viewer_query){
        .request = {.width = 128, .height = 128, .zoom = 1, .follow = true}, .film_fps = 25, .film_speed = 1};
}

static bool whole(const char *text, long min, long max, int *out) {
    char *end;
    if ((*text < '0' || *text > '9') && *text != '-') return false;
    errno = 0;
    long v = strtol(text, &end, 10);
    if (errno || *end || end == text || v < min || v > max) return false;
    *out = (int)v;
    return true;
}

static bool real(const char *text, float min, float max, float *out) {
    char *end;
    if (strspn(text, "0123456789+-.e") != strlen(text)) return false; /* no hexadecimal, no names */
    float v = strtof(text, &end);
    if (*end || end == text || !(v >= min && v <= max)) return false;
    *out = v;
    return true;
}

static bool yes_or_no(const char *text, bool *out) {
    if ((*text != '0' && *text != '1') || text[1]) return false;
    *out = *text == '1';
    return true;
}

static bool mode(const char *text, viewer_mode *out) {
    static const char *const names[] = {"color", "opacity", "depth", "normal"};
    for (size_t i = 0; i < COUNT_OF(names); i++)
        if (strcmp(text, names[i]) == 0) {
            *out = (viewer_mode)i;
            return true;
        }
    return false;
}

/* "rrggbb" or "none". */
static bool background(const char *text, viewer_request *r) {
    r->transparent = strcmp(text, "none") == 0;
    if (r->transparent) return true;
    if (strlen(text) != 6 || strspn(text, "0123456789abcdef") != 6) return false;
    unsigned long v = strtoul(text, NULL, 16);
    for (int k = 0; k < 3; k++) r->background[k] = (float)(v >> (16 - 8 * k) & 255) / 255;
    return true;
}

static bool client_name(const char *text, char out[VIEWER_NAME + 1]) {
    size_t n = strlen(text);
    if (n < 4 || n > VIEWER_NAME || strspn(text, "0123456789abcdefghijklmnopqrstuvwxyz") != n) return false;
    memcpy(out, text, n + 1);
    return true;
}

static bool sequence(const char *text, uint64_t *out) {
    size_t n = strlen(text);
    if (n < 1 || n > 15 || strspn(text, "0123456789") != n) return false;
    *out = strtoull(text, NULL, 10);
    return true;
}

/* The value of the field with this number. */
static bool value_take(viewer_query *q, size_t field, const char *value) {
    viewer_request *r = &q->request;
    switch (field) {
    case 0:
        return client_name(value, q->client);
    case 1:
        return sequence(value, &q->sequence);
    case 2:
        return whole(value, 0, VIEWER_AVATARS, &r->avatar);
    case 3:
        return whole(value, 0, VIEWER_MOTIONS + VIEWER_OWN_MOTIONS, &r->motion);
    case 4:
        return whole(value, 0, 100000000, &r->frame);
    case 5:
        return whole(value, VIEWER_SIDE_MIN, 2 * VIEWER_SIDE_MAX, &r->width);
    case 6:
        return whole(value, VIEWER_SIDE_MIN, 2 * VIEWER_SIDE_MAX, &r->height);
    case 7:
        return real(value, -1000, 1000, &r->azimuth_rad);
    case 8:
        return real(value, -1.5708f, 1.5708f, &r->elevation_rad);
    case 9:
        return real(value, 0.05f, 50, &r->zoom);
    case 10:
    case 11:
    case 12:
        return real(value, -20, 20, &r->offset_m[field - 10]);
    case 13:
        return mode(value, &r->mode);
    case 14:
        return background(value, r);
    case 15:
        return yes_or_no(value, &r->follow);
    case 16:
        return yes_or_no(value, &r->lossless);
    case 17:
        return yes_or_no(value, &r->fine);
    case 18:
        return whole(value, 0, VIEWER_FILM_FRAMES, &q->film_frames);
    case 19:
        return real(value, 1, 120, &q->film_fps);
    case 20:
        return real(value, 0.05f, 20, &q->film_speed);
    default:
        return yes_or_no(value, &r->quick);
    }
}

static bool not_taken(viewer_query *q, const char *name, const char *why) {
    const bool plain = *name && strspn(name, "abcdefghijklmnopqrstuvwxyz") == strlen(name);
    snprintf(q->wrong, sizeof q->wrong, "%.20s: %s", plain ? name : "a field", why);
    return false;
}

bool query_take(viewer_query *q, const char *name, const char *value) {
    static const char *const names[] = {"client", "n",    "avatar", "motion", "frame", "w",    "h",  "az",
                                        "el",     "zoom", "ox",     "oy",     "oz",    "mode", "bg", "follow",
                                        "png",    "fine", "turn",   "fps",    "speed", "quick"};
    size_t i = 0;
    while (i < COUNT_OF(names) && strcmp(name, names[i]) != 0) i++;
    if (i == COUNT_OF(names)) return not_taken(q, name, "there is no such field");
    if (q->seen >> i & 1) return not_taken(q, name, "it occurs twice");
    q->seen |= 1u << i;
    return (value && value_take(q, i, value)) || not_taken(q, name, "not a value that it may have");
}
