/* Runs a video's frames through the networks: follows the person, keeps what is needed of each frame, and
 * finds frames with left and right exchanged. */
#include <math.h>
#include <string.h>

#include "estimate/clip_inside.h"
#include "estimate/landmarks.h"

/* While nobody is seen, the detector runs this often; it takes as long as tracking ten frames. */
static const double search_s = 0.2;

void clip_track_free(clip_track *t) {
    for (int i = 0; i < t->count; i++) mem_free(t->frame[i]);
    mem_free(t->frame);
    mem_free(t->repeated);
    mem_free(t->thumbnail);
    *t = (clip_track){0};
}

/* ---- kept data ---- */

static void pack(const photo_person *p, clip_frame *out) {
    memset(out, 0, sizeof *out);
    out->score = p->score;
    out->region = p->region;
    out->next = p->next;
    memcpy(out->landmark, p->landmark, sizeof out->landmark);
    for (int y = 0; y < CLIP_MASK_SIDE; y++)
        for (int x = 0; x < CLIP_MASK_SIDE; x++) {
            const float *at = p->inside + 2 * y * PERSON_MASK_SIDE + 2 * x;
            const float mean = 0.25f * (at[0] + at[1] + at[PERSON_MASK_SIDE] + at[PERSON_MASK_SIDE + 1]);
            out->inside[y * CLIP_MASK_SIDE + x] = (uint8_t)(255 * fminf(fmaxf(mean, 0), 1) + 0.5f);
        }
}

/* The mask between the centres of its cells is bilinear. */
void clip_frame_person(const clip_frame *f, photo_person *out) {
    memset(out, 0, sizeof *out);
    out->score = f->score;
    out->region = f->region;
    out->next = f->next;
    memcpy(out->landmark, f->landmark, sizeof out->landmark);
    for (int y = 0; y < PERSON_MASK_SIDE; y++)
        for (int x = 0; x < PERSON_MASK_SIDE; x++) {
            const int near[2] = {x / 2, y / 2}, step[2] = {x % 2 ? 1 : -1, y % 2 ? 1 : -1};
            int far[2];
            for (int k = 0; k < 2; k++) {
                far[k] = near[k] + step[k];
                far[k] = far[k] < 0 ? 0 : far[k] < CLIP_MASK_SIDE ? far[k] : CLIP_MASK_SIDE - 1;
            }
            const int sum = 9 * f->inside[near[1] * CLIP_MASK_SIDE + near[0]] +
                            3 * f->inside[near[1] * CLIP_MASK_SIDE + far[0]] +
                            3 * f->inside[far[1] * CLIP_MASK_SIDE + near[0]] +
                            f->inside[far[1] * CLIP_MASK_SIDE + far[0]];
            out->inside[y * PERSON_MASK_SIDE + x] = (float)sum / (16 * 255);
        }
}

/* Room for another frame, and its thumbnail. */
static sherf_status make_room(context *c, clip_track *t, const image_u8 *picture, bool repeated) {
    if (t->count == t->room) {
        const int room = t->room ? 2 * t->room : 256;
        clip_frame **frame = mem_grow(c, t->frame, (size_t)t->count, (size_t)room, sizeof *frame);
        if (!frame) return SHERF_NO_MEMORY;
        t->frame = frame;
        bool *flags = mem_grow(c, t->repeated, (size_t)t->count, (size_t)room, sizeof *flags);
        if (!flags) return SHERF_NO_MEMORY;
        t->repeated = flags;
        clip_thumbnail *small = mem_grow(c, t->thumbnail, (size_t)t->count, (size_t)room, sizeof *small);
        if (!small) return SHERF_NO_MEMORY;
        t->thumbnail = small;
        t->room = room;
    }
    if (repeated && t->count)
        t->thumbnail[t->count] = t->thumbnail[t->count - 1];
    else
        clip_thumbnail_make(picture, &t->thumbnail[t->count]);
    return SHERF_OK;
}

static sherf_status add(context *c, clip_track *t, const photo_person *person, bool repeated) {
    clip_frame *f = NULL;
    if (person) {
        if (!(f = mem_alloc(c, 1, sizeof *f))) return SHERF_NO_MEMORY;
        pack(person, f);
    }
    t->repeated[t->count] = repeated;
    t->frame[t->count++] = f;
    return SHERF_OK;
}

/* ---- following the person ---- */

typedef struct {
    const pose_networks *n;
    const char *path;
    int wanted;
    sherf_image image;
    photo_person person; /* as last seen */
    bool known, there;   /* has been seen at all; was seen in the frame before */
    bool cut;            /* since the person was last seen */
    int search_at;       /* the next frame in which the detector may run */
} follower;

/* The difference of two detections in position and size. */
static double apart(const photo_person *a, const photo_person *b) {
    const double side = (double)fmaxf(a->next.side_px, b->next.side_px);
    return hypot((double)(a->next.centre_px[0] - b->next.centre_px[0]),
                 (double)(a->next.centre_px[1] - b->next.centre_px[1])) /
               side +
           fabs(log((double)a->next.side_px / (double)b->next.side_px));
}

static sherf_status search(context *c, follower *f, clip_track *t) {
    photo_person *people;
    int count, best = -1;
    sherf_status status = people_find(c, f->n, &f->image, PHOTO_PEOPLE_MAX, &people, &count);
    if (status != SHERF_OK || !count) return status;
    if (!f->known) {
        t->people = count;
        best = f->wanted < count ? f->wanted : -1;
    } else {
        /* A detection further away is another person. After a cut so is everybody, except after a flash. */
        double min = f->cut ? 0.3 : 1.5;
        for (int i = 0; i < count; i++) {
            const double d = apart(&people[i], &f->person);
            if (d < min) min = d, best = i;
        }
        if (best < 0 && f->cut) best = f->wanted < count ? f->wanted : 0;
    }
    if (best >= 0) f->person = people[best], f->cut = false;
    f->there = best >= 0;
    mem_free(people);
    if (!f->known && best < 0)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: person %d is requested, and %d %s there", f->path,
                       f->wanted + 1, t->people, t->people == 1 ? "is" : "are");
    f->known = true;
    return SHERF_OK;
}

static sherf_status look_at(context *c, follower *f, clip_track *t, const image_u8 *picture) {
    for (size_t i = 0; i < (size_t)picture->width * (size_t)picture->height * 3; i++)
        f->image.data[i] = (float)picture->data[i] / 255;
    sherf_status status = SHERF_OK;
    if (clip_cut_at(t, t->count, t->count + 1)) {
        f->there = false;
        f->cut = true;
        f->search_at = t->count;
    }
    const bool was_there = f->there;
    if (was_there) {
        photo_person *next = mem_alloc(c, 1, sizeof *next);
        if (!next) return SHERF_NO_MEMORY;
        status = landmarks_track(c, f->n, &f->image, &f->person, next, &f->there);
        if (status == SHERF_OK && f->there) f->person = *next;
        mem_free(next);
    }
    if (status == SHERF_OK && !f->there && (was_there || t->count >= f->search_at)) {
        status = search(c, f, t);
        f->search_at = t->count + (int)ceil(search_s * t->fps);
    }
    return status == SHERF_OK ? add(c, t, f->there ? &f->person : NULL, false) : status;
}

sherf_status clip_look(context *c, const pose_networks *n, const char *path, const sherf_clip_options *o,
                       clip_track *t) {
    const video_read_options request = {.side_px = CLIP_SIDE_PX, .fps = o->fps};
    const image_u8 *picture = NULL;
    bool repeated = false;
    video_reader *v;
    *t = (clip_track){0};
    sherf_status status = video_read_open(c, path, &request, &v);
    if (status != SHERF_OK) return status;
    const video_read_info *info = video_read_information(v);
    follower *f = mem_zero(c, 1, sizeof *f);
    float *data = f ? mem_alloc(c, (size_t)info->width * (size_t)info->height, 3 * sizeof *data) : NULL;
    if (!data) status = SHERF_NO_MEMORY;
    t->width = info->width;
    t->height = info->height;
    t->fps = info->fps;
    t->scale = (double)info->full_width / info->width;
    if (f) {
        f->n = n;
        f->path = path;
        f->wanted = o->person;
        f->image = (sherf_image){info->width, info->height, 3, data};
    }
    while (status == SHERF_OK && (status = video_read_next(c, v, &picture, &repeated)) == SHERF_OK &&
           picture) {
        if (t->count == CLIP_FRAMES_MAX)
            status = failure(c, SHERF_UNSUPPORTED, "%s: more than %d frames", path, CLIP_FRAMES_MAX);
        else
            status = make_room(c, t, picture, repeated);
        if (status == SHERF_OK) status = repeated ? add(c, t, NULL, true) : look_at(c, f, t, picture);
        if (status == SHERF_OK)
            status = progress(c, "frames looked at", t->count, round(info->seconds * info->fps));
    }
    if (status == SHERF_OK && t->count < 0.9 * info->seconds * info->fps)
        log_line(c, SHERF_LOG_WARNING,
                 "%s: only %.1f of its %.1f seconds can be read: it is damaged or was not copied whole", path,
                 t->count / info->fps, info->seconds);
    video_read_close(v);
    mem_free(data);
    mem_free(f);
    if (status != SHERF_OK) clip_track_free(t);
    return status;
}

/* ---- front and back ---- */

static void exchange(clip_frame *f) {
    /* from the eyes on, pairs are adjacent, except the nose's and the eyes' corners */
    static const int pair[][2] = {{1, 4}, {2, 5}, {3, 6}, {7, 8}, {9, 10}};
    for (size_t i = 0; i < COUNT_OF(pair); i++) {
        const landmark l = f->landmark[pair[i][0]];
        f->landmark[pair[i][0]] = f->landmark[pair[i][1]];
        f->landmark[pair[i][1]] = l;
    }
    for (int i = LANDMARK_LEFT_SHOULDER; i < LANDMARKS; i += 2) {
        const landmark l = f->landmark[i];
        f->landmark[i] = f->landmark[i + 1];
        f->landmark[i + 1] = l;
    }
    for (int i = 0; i < LANDMARKS; i++) f->landmark[i].place_m[2] *= -1;
    f->swapped = !f->swapped;
}

/* Where the trunk's left side points, seen from above; exchanged: with left and right exchanged. */
static double facing(const clip_frame *f, bool exchanged) {
    const landmark *l = f->landmark;
    double left[2] = {0};
    for (int k = 0; k < 2; k++)
        left[k] =
            (double)(l[LANDMARK_LEFT_HIP].place_m[2 * k] - l[LANDMARK_RIGHT_HIP].place_m[2 * k] +
                     l[LANDMARK_LEFT_SHOULDER].place_m[2 * k] - l[LANDMARK_RIGHT_SHOULDER].place_m[2 * k]);
    return atan2(left[1], exchanged ? -left[0] : left[0]);
}

/* The cheapest sequence of "as seen" and "exchanged": nobody turns faster than `turn_rate`, and the networks
 * are mostly right. A wrong stretch is corrected if it is shorter than about a second. */
sherf_status clip_repair(context *c, clip_track *t, int *repaired) {
    const double turn_rate = 8, slack = 0.4, jump_cost = 4, wrong_s = 25;
    uint8_t(*from)[2] = mem_zero(c, (size_t)t->count, sizeof *from);
    double cost[2] = {0, 0};
    int before = -1, state;
    *repaired = 0;
    if (!from) return SHERF_NO_MEMORY;
    for (int i = 0; i < t->count; i++) {
        if (!t->frame[i]) continue;
        double next[2];
        for (int s = 0; s < 2; s++) {
            double min = INFINITY;
            for (int r = 0; r < 2; r++) {
                double sum = cost[r];
                if (before >= 0) {
                    const double seconds = (i - before) / t->fps;
                    double turn = remainder(facing(t->frame[i], s) - facing(t->frame[before], r), 2 * M_PI);
                    turn = fmax(0, fabs(turn) - slack - turn_rate * seconds);
                    sum += jump_cost * turn * turn;
                }
                if (sum < min) min = sum, from[i][s] = (uint8_t)r;
            }
            next[s] = min + (s ? wrong_s / t->fps : 0);
        }
        memcpy(cost, next, sizeof cost);
        before = i;
    }
    state = cost[1] < cost[0];
    for (int i = t->count - 1; i >= 0; i--) {
        if (!t->frame[i]) continue;
        const int here = state;
        state = from[i][here];
        if (here) exchange(t->frame[i]), ++*repaired;
    }
    mem_free(from);
    return SHERF_OK;
}
