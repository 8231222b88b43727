#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "estimate/detect.h"
#include "estimate/landmarks.h"
#include "estimate/region.h"

/* What is less probably a person is dropped: after the detector's region, and after the last look. */
static const float score_first = .1f, score_least = .5f;
/* Two people are one when their landmarks lie this close, as a part of the region's side. */
static const float same_place = .08f;
/* Or when this much of one's mask is the other's. */
static const float part_least = .7f;
/* Parts of a region's side. */
static const float settled_size = .15f, settled_place = .08f;
static const float pi = 3.14159265f;
enum { HELPER_MIDDLE = 33, HELPER_TOP = 34, LOOKS_MOST = 4 };

static float sigmoid(float x) {
    return 1 / (1 + expf(-x));
}

static bool finite_all(const float *x, int count) {
    for (int i = 0; i < count; i++)
        if (!isfinite(x[i])) return false;
    return true;
}

static void helper_place(const photo_region *region, const float *places, int helper, float place_px[2]) {
    const float *p = places + helper * LANDMARK_COLUMNS, unit = 1.f / LANDMARKS_SIDE;
    region_place(region, unit * p[0], unit * p[1], place_px);
}

/* The network's numbers to the photo's and the camera's axes: both are turned as the region is. */
static void read_outputs(const float *const *output, photo_person *out) {
    const float *places = output[LANDMARKS_PICTURE], *world = output[LANDMARKS_WORLD];
    const float cosine = cosf(out->region.angle_rad), sine = sinf(out->region.angle_rad);
    float middle_px[2], top_px[2];
    for (int i = 0; i < LANDMARKS; i++) {
        const float *p = places + i * LANDMARK_COLUMNS, *w = world + i * 3;
        landmark *to = &out->landmark[i];
        helper_place(&out->region, places, i, to->place_px);
        to->place_m[0] = cosine * w[0] - sine * w[1];
        to->place_m[1] = sine * w[0] + cosine * w[1];
        to->place_m[2] = w[2];
        to->visible = sigmoid(p[3]);
        to->present = sigmoid(p[4]);
    }
    helper_place(&out->region, places, HELPER_MIDDLE, middle_px);
    helper_place(&out->region, places, HELPER_TOP, top_px);
    out->next = region_about(middle_px, top_px);
    memcpy(out->inside, output[LANDMARKS_MASK], sizeof out->inside);
}

sherf_status landmarks_find(context *c, const pose_networks *n, const sherf_image *photo,
                            const photo_region *region, photo_person *out) {
    const photo_region looked_at = *region; /* may be one of out's */
    const float *output[LANDMARKS_OUTPUTS];
    sherf_status status = SHERF_NO_MEMORY;
    arena *memory = arena_create(c);
    float *input =
        memory ? arena_alloc(c, memory, (size_t)LANDMARKS_SIDE * LANDMARKS_SIDE * 3, sizeof *input) : NULL;
    if (!input) goto done;
    status = region_sample(c, photo, &looked_at, LANDMARKS_SIDE, false, 1, 0, input);
    if (status == SHERF_OK) status = graph_run(c, n->landmarks, input, memory, output);
    if (status != SHERF_OK) goto done;
    memset(out, 0, sizeof *out);
    out->region = out->next = looked_at;
    if (finite_all(output[LANDMARKS_PICTURE], LANDMARKS_IN_FILE * LANDMARK_COLUMNS) &&
        finite_all(output[LANDMARKS_WORLD], LANDMARKS_IN_FILE * 3) &&
        finite_all(output[LANDMARKS_MASK], PERSON_MASK_SIDE * PERSON_MASK_SIDE) &&
        isfinite(output[LANDMARKS_FLAG][0])) {
        read_outputs(output, out);
        out->score = output[LANDMARKS_FLAG][0];
    }
done:
    if (memory) arena_free(memory);
    return status;
}

/* A region that can be looked at: not a point, and not beside the photo. */
static bool region_is_sound(const sherf_image *photo, const photo_region *r) {
    const float longest = (float)(photo->width > photo->height ? photo->width : photo->height);
    return r->side_px > 8 && r->side_px < 8 * longest && r->centre_px[0] > -.5f * r->side_px &&
           r->centre_px[0] < (float)photo->width + .5f * r->side_px && r->centre_px[1] > -.5f * r->side_px &&
           r->centre_px[1] < (float)photo->height + .5f * r->side_px;
}

/* The next look would be at much the same square. */
static bool settled(const photo_region *a, const photo_region *b) {
    const float moved = hypotf(a->centre_px[0] - b->centre_px[0], a->centre_px[1] - b->centre_px[1]);
    return fabsf(logf(a->side_px / b->side_px)) < settled_size && moved < settled_place * a->side_px;
}

/* At least two looks, each at the region that the one before gave; more where that is quite another one, as
 * after a detection that took in a neighbour or half the room. *there: a person. */
static sherf_status look_well(context *c, const pose_networks *n, const sherf_image *photo,
                              const photo_region *region, photo_person *out, bool *there) {
    photo_region next = *region;
    sherf_status status = SHERF_OK;
    *there = false;
    for (int look = 0; look < LOOKS_MOST; look++) {
        if (!region_is_sound(photo, &next)) return SHERF_OK;
        status = landmarks_find(c, n, photo, &next, out);
        if (status != SHERF_OK || !(out->score >= score_first)) return status;
        if (look && settled(&out->region, &out->next)) break;
        next = out->next;
    }
    *there = out->score >= score_least && region_is_sound(photo, &out->next);
    return SHERF_OK;
}

/* Mean distance of the shoulders, hips, knees and ankles. */
static bool same_person(const photo_person *a, const photo_person *b) {
    static const int joint[] = {LANDMARK_LEFT_SHOULDER, LANDMARK_RIGHT_SHOULDER, LANDMARK_LEFT_HIP,
                                LANDMARK_RIGHT_HIP,     LANDMARK_LEFT_KNEE,      LANDMARK_RIGHT_KNEE,
                                LANDMARK_LEFT_ANKLE,    LANDMARK_RIGHT_ANKLE};
    float sum = 0;
    for (size_t i = 0; i < COUNT_OF(joint); i++) {
        const float *p = a->landmark[joint[i]].place_px, *q = b->landmark[joint[i]].place_px;
        sum += hypotf(p[0] - q[0], p[1] - q[1]);
    }
    const float side = fminf(a->next.side_px, b->next.side_px);
    return sum < same_place * side * (float)COUNT_OF(joint);
}

static float inside_at(const photo_person *p, const float place_px[2]) {
    float uv[2];
    int at[2];
    region_find(&p->region, place_px, uv);
    for (int k = 0; k < 2; k++) {
        if (!(uv[k] >= 0 && uv[k] < 1)) return 0;
        at[k] = (int)(uv[k] * PERSON_MASK_SIDE);
    }
    return p->inside[at[1] * PERSON_MASK_SIDE + at[0]];
}

/* Most of a's mask belongs to b's: a detection of somebody's upper half, say. */
static bool is_part(const photo_person *a, const photo_person *b) {
    enum { STEP = 4 };
    int all = 0, shared = 0;
    for (int i = STEP / 2; i < PERSON_MASK_SIDE; i += STEP)
        for (int j = STEP / 2; j < PERSON_MASK_SIDE; j += STEP) {
            float place_px[2];
            if (a->inside[i * PERSON_MASK_SIDE + j] < .5f) continue;
            region_place(&a->region, ((float)j + .5f) / PERSON_MASK_SIDE, ((float)i + .5f) / PERSON_MASK_SIDE,
                         place_px);
            all++;
            shared += inside_at(b, place_px) >= .5f;
        }
    return (float)shared >= part_least * (float)all;
}

/* The detection lies so near a person who was found from another that a look would find that one again. */
static bool is_known(const detection *d, const photo_person *people, int count) {
    for (int i = 0; i < count; i++) {
        const photo_region *r = &people[i].next;
        const float turn = fabsf(remainderf(d->region.angle_rad - r->angle_rad, 2 * pi));
        if (settled(r, &d->region) && turn < .3f) return true;
    }
    return false;
}

/* Puts the last of the people, who come by the detector's score, among those before: a twin goes, and so does
 * somebody's piece. Whoever takes in several is none. Returns how many there are then. */
static int settle_newest(photo_person *people, int count) {
    const photo_person *p = &people[count - 1];
    int piece = -1;
    for (int i = 0; i + 1 < count; i++) {
        if (same_person(&people[i], p) || is_part(p, &people[i])) return count - 1;
        if (!is_part(&people[i], p)) continue;
        if (piece >= 0) return count - 1;
        piece = i;
    }
    if (piece < 0) return count;
    people[piece] = *p;
    return count - 1;
}

static int by_size(const void *x, const void *y) {
    const photo_person *a = x, *b = y;
    return a->next.side_px > b->next.side_px ? -1 : a->next.side_px < b->next.side_px;
}

static int by_score(const void *x, const void *y) {
    const detection *a = x, *b = y;
    if (a->score != b->score) return a->score > b->score ? -1 : 1;
    return a->region.side_px > b->region.side_px ? -1 : a->region.side_px < b->region.side_px;
}

sherf_status people_find(context *c, const pose_networks *n, const sherf_image *photo, int most,
                         photo_person **out, int *count) {
    detection *d = NULL;
    photo_person *people = NULL;
    int detections, found = 0;
    *out = NULL;
    *count = 0;
    if (most < 1 || most > PEOPLE_MOST)
        return failure(c, SHERF_BAD_ARGUMENT, "%d people: 1 to %d are looked for", most, PEOPLE_MOST);
    d = mem_alloc(c, DETECTIONS_MAX, sizeof *d);
    people = d ? mem_alloc(c, DETECTIONS_MAX, sizeof *people) : NULL;
    sherf_status status = people ? people_detect(c, n, photo, d, &detections) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) qsort(d, (size_t)detections, sizeof *d, by_score);
    for (int i = 0; status == SHERF_OK && i < detections; i++) {
        bool there = false;
        if (is_known(&d[i], people, found)) continue;
        status = cancelled(c) ? failure(c, SHERF_CANCELLED, "cancelled")
                              : look_well(c, n, photo, &d[i].region, &people[found], &there);
        if (there) found = settle_newest(people, found + 1);
    }
    mem_free(d);
    if (status != SHERF_OK || !found) {
        mem_free(people);
        return status;
    }
    qsort(people, (size_t)found, sizeof *people, by_size);
    *out = people;
    *count = found < most ? found : most;
    return SHERF_OK;
}

sherf_status landmarks_track(context *c, const pose_networks *n, const sherf_image *frame,
                             const photo_person *before, photo_person *out, bool *there) {
    *there = false;
    if (!region_is_sound(frame, &before->next)) {
        if (out != before) *out = *before;
        out->score = 0;
        return SHERF_OK;
    }
    sherf_status status = landmarks_find(c, n, frame, &before->next, out);
    *there = status == SHERF_OK && out->score >= score_least && region_is_sound(frame, &out->next);
    return status;
}
