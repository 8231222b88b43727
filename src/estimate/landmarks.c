/* The people of a photo. Detections are checked, duplicates and parts of others are dropped, and where the
 * mirrored picture disagrees other regions are tried. Also one person from frame to frame. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "estimate/detect.h"
#include "estimate/landmarks.h"
#include "estimate/look.h"
#include "estimate/region.h"

/* A look with a lower probability of a person is dropped. */
static const float score_min = .5f;
/* Two people are one if their landmarks are this close, as a share of the region's side. */
static const float same_place = .08f;
/* Or if this share of one's mask is in the other's. */
static const float part_min = .7f;
/* Parts of a region's side. */
static const float settled_size = .15f, settled_place = .08f;
/* Disagreement of a straight and a mirrored look (look_mirrored): up to the first is usual, from the second
 * it is no person. */
static const float doubt_little = .015f, doubt_cut = .03f, doubt_max = .15f;
/* The share of a region's side without any knee or ankle, if the whole person is in the region. */
static const float rim = .06f;
enum { OTHER_REGIONS = 3, SHORT_SIDE_MIN = 32 };
static const float pi = 3.14159265f;

sherf_status landmarks_find(context *c, const pose_networks *n, const sherf_image *photo,
                            const photo_region *region, photo_person *out) {
    return look_once(c, n, photo, region, false, out);
}

/* Whether the next look would be at nearly the same square. */
static bool settled(const photo_region *a, const photo_region *b) {
    const float moved = hypotf(a->centre_px[0] - b->centre_px[0], a->centre_px[1] - b->centre_px[1]);
    return fabsf(logf(a->side_px / b->side_px)) < settled_size && moved < settled_place * a->side_px;
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

/* Whether most of a's mask belongs to b's: a detection of a person's upper half, for example. */
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
    return all && (float)shared >= part_min * (float)all;
}

/* Whether the detection is so near a person already found that a look would find the same person again. */
static bool is_known(const detection *d, const photo_person *people, int count) {
    for (int i = 0; i < count; i++) {
        const photo_region *r = &people[i].next;
        const float turn = fabsf(remainderf(d->region.angle_rad - r->angle_rad, 2 * pi));
        if (settled(r, &d->region) && turn < .3f) return true;
    }
    return false;
}

/* Merges the last person into those before (people come in order of the detector's score): drops duplicates
 * and parts of others. One that covers several others is not a person. Returns the new count. */
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

/* Other regions for a person whom a look at this region (NULL: none) does not show well: below it, if it
 * showed a head or a trunk; at the photo's full height there; or in the photo's middle. Returns their
 * number. */
static int other_regions(const sherf_image *photo, const photo_region *seen, photo_region *out) {
    const float width = (float)photo->width, height = (float)photo->height;
    int count = 0;
    if (fminf(width, height) < SHORT_SIDE_MIN) return 0;
    if (seen) {
        const float x = fminf(fmaxf(seen->centre_px[0], 0), width - 1);
        out[count++] =
            (photo_region){{x, seen->centre_px[1] + .35f * seen->side_px}, 1.8f * seen->side_px, 0};
        out[count++] = (photo_region){{x, .5f * (height - 1)}, .95f * height, 0};
    }
    out[count++] = (photo_region){{.5f * (width - 1), .5f * (height - 1)}, height, 0};
    return count;
}

/* Whether limbs reach the region's edge, which may have cut them off; edges outside the photo do not
 * count. */
static bool is_cut(const sherf_image *photo, const photo_person *p) {
    static const int end[] = {LANDMARK_NOSE,       LANDMARK_LEFT_HIP,   LANDMARK_RIGHT_HIP,
                              LANDMARK_LEFT_KNEE,  LANDMARK_RIGHT_KNEE, LANDMARK_LEFT_ANKLE,
                              LANDMARK_RIGHT_ANKLE};
    for (size_t i = 0; i < COUNT_OF(end); i++) {
        const float *place = p->landmark[end[i]].place_px;
        float uv[2];
        region_find(&p->region, place, uv);
        const bool in_photo = place[0] > 0 && place[1] > 0 && place[0] < (float)photo->width - 1 &&
                              place[1] < (float)photo->height - 1;
        if (in_photo && !(fminf(uv[0], uv[1]) > rim && fmaxf(uv[0], uv[1]) < 1 - rim)) return true;
    }
    return false;
}

static sherf_status look_mirrored_and_judge(context *c, const pose_networks *n, const sherf_image *photo,
                                            photo_person *p, float *doubt) {
    const sherf_status status = look_mirrored(c, n, photo, p, doubt);
    if (status == SHERF_OK && is_cut(photo, p)) *doubt = fmaxf(*doubt, doubt_cut);
    return status;
}

/* Looks at a found person's region again, mirrored, and at other regions if the two disagree. `p` is the last
 * of `people`; nobody is found twice. *there: a person was found. */
static sherf_status look_elsewhere(context *c, const pose_networks *n, const sherf_image *photo,
                                   const photo_person *others, int count, photo_person *p, bool *there) {
    photo_region region[OTHER_REGIONS];
    float doubt = 1, other_doubt;
    sherf_status status = SHERF_OK;
    if (*there) status = look_mirrored_and_judge(c, n, photo, p, &doubt);
    if (status != SHERF_OK || doubt < doubt_little) return status;
    photo_person *other = mem_alloc(c, 1, sizeof *other);
    if (!other) return SHERF_NO_MEMORY;
    const int regions = other_regions(photo, *there ? &p->region : NULL, region);
    for (int i = 0; i < regions && status == SHERF_OK && doubt >= doubt_little; i++) {
        bool seen;
        status = look_until_settled(c, n, photo, &region[i], others, count, other, &seen);
        if (status != SHERF_OK || !seen) continue;
        status = look_mirrored_and_judge(c, n, photo, other, &other_doubt);
        if (status != SHERF_OK || !(other_doubt < doubt)) continue;
        *p = *other;
        doubt = other_doubt;
    }
    *there = doubt < (*there ? doubt_max : doubt_little);
    mem_free(other);
    return status;
}

/* The second round: checks everybody mirrored; if nobody was found, tries the photo as a whole. */
static sherf_status look_again(context *c, const pose_networks *n, const sherf_image *photo,
                               photo_person *people, int *count) {
    sherf_status status = SHERF_OK;
    const int found = *count;
    *count = 0;
    for (int i = 0; (i < found || !i) && status == SHERF_OK; i++) {
        bool there = found > 0;
        photo_person *p = &people[*count];
        if (there && i != *count) *p = people[i];
        status = cancelled(c) ? failure(c, SHERF_CANCELLED, "cancelled")
                              : look_elsewhere(c, n, photo, people, *count, p, &there);
        if (status == SHERF_OK && there) *count = settle_newest(people, *count + 1);
    }
    return status;
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

sherf_status people_find(context *c, const pose_networks *n, const sherf_image *photo, int max,
                         photo_person **out, int *count) {
    detection *d = NULL;
    photo_person *people = NULL;
    int detections, found = 0;
    *out = NULL;
    *count = 0;
    if (max < 1 || max > PHOTO_PEOPLE_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "%d people: 1 to %d are looked for", max, PHOTO_PEOPLE_MAX);
    d = mem_alloc(c, DETECTIONS_MAX, sizeof *d);
    people = d ? mem_alloc(c, DETECTIONS_MAX, sizeof *people) : NULL;
    sherf_status status = people ? people_detect(c, n, photo, d, &detections) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) qsort(d, (size_t)detections, sizeof *d, by_score);
    for (int i = 0; status == SHERF_OK && i < detections; i++) {
        bool there = false;
        if (is_known(&d[i], people, found)) continue;
        status = cancelled(c)
                     ? failure(c, SHERF_CANCELLED, "cancelled")
                     : look_until_settled(c, n, photo, &d[i].region, people, found, &people[found], &there);
        if (there) found = settle_newest(people, found + 1);
    }
    mem_free(d);
    if (status == SHERF_OK) status = look_again(c, n, photo, people, &found);
    if (status != SHERF_OK || !found) {
        mem_free(people);
        return status;
    }
    qsort(people, (size_t)found, sizeof *people, by_size);
    if (found > max) found = max;
    for (int i = 0; i < found && status == SHERF_OK; i++) status = look_without_head(c, n, photo, &people[i]);
    if (status != SHERF_OK) {
        mem_free(people);
        return status;
    }
    *out = people;
    *count = found;
    return SHERF_OK;
}

sherf_status landmarks_track(context *c, const pose_networks *n, const sherf_image *frame,
                             const photo_person *before, photo_person *out, bool *there) {
    *there = false;
    if (!look_is_sound(frame, &before->next)) {
        if (out != before) *out = *before;
        out->score = 0;
        return SHERF_OK;
    }
    sherf_status status = landmarks_find(c, n, frame, &before->next, out);
    *there = status == SHERF_OK && out->score >= score_min && look_is_sound(frame, &out->next);
    return status;
}
