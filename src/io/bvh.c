/* A reader of BVH. It reads the text word by word, checks every number and trusts no size. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "base/path.h"
#include "base/vector3.h"
#include "io/bvh.h"
#include "io/utf16.h"

static const size_t file_limit_bytes = (size_t)1 << 30;

typedef struct {
    context *c;
    const char *at, *end;
    int line;
    bvh *b;
    int room; /* joints */
} reader;

typedef struct {
    const char *text;
    size_t length;
} word;

static bool is_space(char ch) {
    return ch == ' ' || ch == '\t' || ch == '\n' || ch == '\r' || ch == '\f' || ch == '\v';
}

/* The next word, of length 0 at the end. Braces are words of their own, and a colon ends a word. */
static word next_word(reader *r) {
    while (r->at < r->end && is_space(*r->at)) r->line += *r->at++ == '\n';
    word w = {r->at, 0};
    while (r->at < r->end && !is_space(*r->at)) {
        if ((*r->at == '{' || *r->at == '}') && w.length) break;
        r->at++, w.length++;
        if (*w.text == '{' || *w.text == '}' || r->at[-1] == ':') break;
    }
    return w;
}

static bool word_is(word w, const char *text) {
    return w.length == strlen(text) && !strncasecmp(w.text, text, w.length);
}

static sherf_status expected(reader *r, const char *what, word got) {
    return failure(r->c, SHERF_BAD_FILE, "line %d: %s expected%s%.*s", r->line, what,
                   got.length ? ", not " : ", not the end", (int)(got.length < 40 ? got.length : 40),
                   got.text);
}

static sherf_status expect(reader *r, const char *text) {
    word w = next_word(r);
    return word_is(w, text) ? SHERF_OK : expected(r, text, w);
}

/* "0,033": some locales write commas. */
static void decimal_point(char *text) {
    char *comma = strchr(text, ',');
    if (comma && !strchr(text, '.') && !strchr(comma + 1, ',')) *comma = '.';
}

static sherf_status read_number(reader *r, double *out) {
    char text[64];
    word w = next_word(r);
    if (!w.length || w.length >= sizeof text) return expected(r, "a number", w);
    memcpy(text, w.text, w.length);
    text[w.length] = 0;
    decimal_point(text);
    char *rest;
    *out = strtod(text, &rest);
    if (*rest || !isfinite(*out) || fabs(*out) > 1e9) return expected(r, "a number", w);
    return SHERF_OK;
}

static sherf_status read_count(reader *r, const char *what, int max, int *out) {
    double number;
    word here = {r->at, 0};
    sherf_status status = read_number(r, &number);
    if (status) return status;
    if (!(number >= 0 && number <= max) || number != floor(number)) return expected(r, what, here);
    *out = (int)number;
    return SHERF_OK;
}

static sherf_status add_joint(reader *r, int parent, bool end, bvh_joint **out) {
    bvh *b = r->b;
    if (b->joints == BVH_JOINTS_MAX)
        return failure(r->c, SHERF_BAD_FILE, "line %d: more than %d joints", r->line, BVH_JOINTS_MAX);
    if (b->joints == r->room) {
        int room = r->room ? 2 * r->room : 64;
        bvh_joint *grown = mem_grow(r->c, b->joint, (size_t)r->room, (size_t)room, sizeof *grown);
        if (!grown) return SHERF_NO_MEMORY;
        b->joint = grown, r->room = room;
    }
    bvh_joint *j = &b->joint[b->joints++];
    *j = (bvh_joint){.parent = parent, .end = end, .first = b->channels};
    *out = j;
    return SHERF_OK;
}

/* A name may contain blanks: it is the rest of the line up to the brace. */
static sherf_status read_name(reader *r, bvh_joint *j) {
    size_t n = 0;
    while (r->at < r->end && *r->at != '\n' && *r->at != '{') {
        if (n + 1 < BVH_NAME && (n || !is_space(*r->at))) j->name[n++] = *r->at;
        r->at++;
    }
    while (n && is_space(j->name[n - 1])) n--;
    j->name[n] = 0;
    return n ? SHERF_OK : failure(r->c, SHERF_BAD_FILE, "line %d: a joint without a name", r->line);
}

static sherf_status read_channels(reader *r, bvh_joint *j) {
    static const char *const name[] = {"Xposition", "Yposition", "Zposition",
                                       "Xrotation", "Yrotation", "Zrotation"};
    int n = 0;
    if (j->channels) return failure(r->c, SHERF_BAD_FILE, "line %d: channels given twice", r->line);
    sherf_status status = read_count(r, "0 to 6 channels", 6, &n);
    for (int i = 0; i < n && !status; i++) {
        word w = next_word(r);
        size_t k = 0;
        while (k < COUNT_OF(name) && !word_is(w, name[k])) k++;
        if (k == COUNT_OF(name)) return expected(r, "a channel", w);
        j->channel[i] = (uint8_t)k;
    }
    if (status) return status;
    j->first = r->b->channels;
    j->channels = n;
    r->b->channels += n;
    return SHERF_OK;
}

/* Reads from ROOT to its closing brace, with an explicit stack instead of recursion. */
static sherf_status read_hierarchy(reader *r) {
    int stack[BVH_DEPTH_MAX], depth = 0;
    bvh_joint *j;
    sherf_status status;
    if ((status = expect(r, "HIERARCHY")) || (status = expect(r, "ROOT")) ||
        (status = add_joint(r, -1, false, &j)) || (status = read_name(r, j)) || (status = expect(r, "{")))
        return status;
    stack[depth++] = 0;
    while (depth) {
        word w = next_word(r);
        int own = stack[depth - 1];
        bool end = word_is(w, "End");
        if (word_is(w, "OFFSET")) {
            for (int k = 0; k < 3; k++)
                if ((status = read_number(r, &r->b->joint[own].offset[k]))) return status;
        } else if (word_is(w, "CHANNELS") && !r->b->joint[own].end) {
            if ((status = read_channels(r, &r->b->joint[own]))) return status;
        } else if ((end || word_is(w, "JOINT")) && !r->b->joint[own].end) {
            if (depth == BVH_DEPTH_MAX)
                return failure(r->c, SHERF_BAD_FILE, "line %d: joints nested too deeply", r->line);
            if ((status = add_joint(r, own, end, &j)) ||
                (status = end ? expect(r, "Site") : read_name(r, j)) || (status = expect(r, "{")))
                return status;
            stack[depth++] = r->b->joints - 1;
        } else if (word_is(w, "}")) {
            depth--;
        } else {
            return expected(r, "OFFSET, CHANNELS, JOINT, End Site or }", w);
        }
    }
    return SHERF_OK;
}

static bool at_end(reader *r) {
    while (r->at < r->end && is_space(*r->at)) r->line += *r->at++ == '\n';
    return r->at == r->end;
}

/* Reads the whole frames that exist, at most `frames`: recordings may be cut off. */
static sherf_status read_frames(reader *r, int frames, size_t room) {
    bvh *b = r->b;
    for (b->frames = 0; b->frames < frames; b->frames++)
        for (int i = 0; i < b->channels; i++) {
            const size_t at = (size_t)b->frames * (size_t)b->channels + (size_t)i;
            if (at == room || at_end(r)) return SHERF_OK;
            double number;
            sherf_status status = read_number(r, &number);
            if (status) return status;
            b->value[at] = (float)number;
        }
    if (!at_end(r))
        log_line(r->c, SHERF_LOG_WARNING, "BVH: the file goes on after the %d frames that it says", frames);
    return SHERF_OK;
}

static sherf_status motion_begins(reader *r) {
    const word w = next_word(r);
    if (word_is(w, "ROOT"))
        return failure(
            r->c, SHERF_UNSUPPORTED,
            "line %d: a second ROOT: several people in one BVH are not read, export them one by one",
            r->line);
    return word_is(w, "MOTION") ? SHERF_OK : expected(r, "MOTION", w);
}

static sherf_status read_motion(reader *r) {
    bvh *b = r->b;
    sherf_status status;
    int frames = 0;
    if ((status = motion_begins(r)) || (status = expect(r, "Frames:")) ||
        (status = read_count(r, "a number of frames", 1 << 24, &frames)) || (status = expect(r, "Frame")) ||
        (status = expect(r, "Time:")) || (status = read_number(r, &b->frame_time_s)))
        return status;
    if (!b->channels || !frames) return failure(r->c, SHERF_BAD_FILE, "no channels or no frames");
    if (!(b->frame_time_s >= 0 && b->frame_time_s < 1e3)) /* 0: the motion's reader requests the rate */
        return failure(r->c, SHERF_BAD_FILE, "a frame takes %g s", b->frame_time_s);
    /* each number takes at least two characters, except the last one */
    size_t room = (size_t)frames * (size_t)b->channels, left = ((size_t)(r->end - r->at) + 1) / 2;
    if (room > left) room = left;
    b->value = mem_alloc(r->c, room, sizeof *b->value);
    if (!b->value) return SHERF_NO_MEMORY;
    if ((status = read_frames(r, frames, room)) || b->frames == frames) return status;
    if (2 * b->frames <= frames)
        return failure(r->c, SHERF_BAD_FILE,
                       "%d frames of %d channels, but the file ends before: %d are there; copy it again, or "
                       "write that number after Frames:",
                       frames, b->channels, b->frames);
    log_line(r->c, SHERF_LOG_WARNING, "BVH: cut off, %d of %d frames are there", b->frames, frames);
    return SHERF_OK;
}

/* Some skeletons have their bones only in the positions of every frame. The first frame's positions are then
 * used as offsets. */
static void fill_offsets(bvh *b) {
    for (int i = 1; i < b->joints; i++) {
        bvh_joint *j = &b->joint[i];
        if (j->offset[0] != 0 || j->offset[1] != 0 || j->offset[2] != 0) continue;
        for (int k = 0; k < j->channels; k++)
            if (j->channel[k] < BVH_X_ROTATION) j->offset[j->channel[k]] = b->value[j->first + k];
    }
}

static sherf_status parse_text(context *c, const unsigned char *data, size_t bytes, bvh **out) {
    reader r = {.c = c, .at = (const char *)data, .end = (const char *)data + bytes, .line = 1};
    r.b = mem_zero(c, 1, sizeof *r.b);
    if (!r.b) return SHERF_NO_MEMORY;
    if (bytes >= 3 && !memcmp(data, "\xef\xbb\xbf", 3)) r.at += 3;
    sherf_status status = read_hierarchy(&r);
    if (!status) status = read_motion(&r);
    if (status) {
        bvh_free(r.b);
        return status;
    }
    fill_offsets(r.b);
    *out = r.b;
    return SHERF_OK;
}

sherf_status bvh_parse(context *c, const unsigned char *data, size_t bytes, bvh **out) {
    unsigned char *narrow;
    size_t length;
    *out = NULL;
    if (!utf16_is(data, bytes)) return parse_text(c, data, bytes, out);
    sherf_status status = utf16_narrow(c, data, bytes, &narrow, &length);
    if (!status) status = parse_text(c, narrow, length, out);
    mem_free(narrow);
    return status;
}

sherf_status bvh_read(context *c, const char *path, bvh **out) {
    unsigned char *data = NULL;
    size_t bytes;
    *out = NULL;
    sherf_status status = file_read(c, path, file_limit_bytes, &data, &bytes);
    if (status) return status;
    status = bvh_parse(c, data, bytes, out);
    mem_free(data);
    return status == SHERF_BAD_FILE ? failure_prefix(c, status, "%s", path) : status;
}

void bvh_free(bvh *b) {
    if (!b) return;
    mem_free(b->joint);
    mem_free(b->value);
    mem_free(b);
}

/* R = R(channel 0) R(channel 1) ..., about the joint's own axes. */
static void joint_rotation(const bvh_joint *j, const float *value, double out[9]) {
    static const double unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    memcpy(out, unit, sizeof unit);
    for (int i = 0; i < j->channels; i++) {
        if (j->channel[i] < BVH_X_ROTATION) continue;
        int a = j->channel[i] - BVH_X_ROTATION, p = (a + 1) % 3, q = (a + 2) % 3;
        double angle = value[i] * (M_PI / 180), turn[9] = {0};
        turn[4 * a] = 1;
        turn[4 * p] = turn[4 * q] = cos(angle);
        turn[3 * p + q] = -sin(angle);
        turn[3 * q + p] = sin(angle);
        multiply3(out, turn, out);
    }
}

void bvh_rotations(const bvh *b, int frame, double *local, double *global) {
    const float *value = b->value + (size_t)frame * (size_t)b->channels;
    for (int i = 0; i < b->joints; i++) {
        double R[9];
        joint_rotation(&b->joint[i], value + b->joint[i].first, R);
        if (local) memcpy(local + 9 * i, R, sizeof R);
        if (!global) continue;
        if (b->joint[i].parent >= 0)
            multiply3(global + 9 * b->joint[i].parent, R, global + 9 * i);
        else
            memcpy(global + 9 * i, R, sizeof R);
    }
}

/* The position relative to the parent, in the parent's axes: the offset, replaced by position channels if
 * there are any. */
static void joint_offset(const bvh_joint *j, const float *value, double out[3]) {
    memcpy(out, j->offset, sizeof j->offset);
    for (int i = 0; i < j->channels; i++)
        if (j->channel[i] < BVH_X_ROTATION) out[j->channel[i]] = value[j->first + i];
}

void bvh_root_position(const bvh *b, int frame, double position[3]) {
    joint_offset(&b->joint[0], b->value + (size_t)frame * (size_t)b->channels, position);
}

void bvh_joint_position(const bvh *b, int frame, int joint, double position[3], double rotation[9]) {
    const float *value = b->value + (size_t)frame * (size_t)b->channels;
    double turned[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    position[0] = position[1] = position[2] = 0;
    for (int i = joint; i >= 0; i = b->joint[i].parent) { /* x in the axes of i, then of i's parent */
        double R[9], x[3] = {position[0], position[1], position[2]};
        joint_rotation(&b->joint[i], value + b->joint[i].first, R);
        joint_offset(&b->joint[i], value, position);
        for (int k = 0; k < 3; k++)
            position[k] += R[3 * k] * x[0] + R[3 * k + 1] * x[1] + R[3 * k + 2] * x[2];
        multiply3(R, turned, turned);
    }
    if (rotation) memcpy(rotation, turned, sizeof turned);
}

int bvh_find(const bvh *b, const char *name) {
    for (int i = 0; i < b->joints; i++)
        if (!strcmp(b->joint[i].name, name)) return i;
    return -1;
}
