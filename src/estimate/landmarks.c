#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "estimate/detect.h"
#include "estimate/landmarks.h"
#include "estimate/region.h"

/* What is less probably a person is dropped: after the detector's region, and after the second look. */
static const float score_first = .1f, score_least = .5f;
/* Two people are one when their landmarks lie this close, as a part of the region's side. */
static const float same_place = .08f;
enum { HELPER_MIDDLE = 33, HELPER_TOP = 34 };

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

/* Two looks: the second one's region is the network's own. *there: a person. */
static sherf_status look_twice(context *c, const pose_networks *n, const sherf_image *photo,
                               const photo_region *region, photo_person *out, bool *there) {
    *there = false;
    if (!region_is_sound(photo, region)) return SHERF_OK;
    sherf_status status = landmarks_find(c, n, photo, region, out);
    if (status != SHERF_OK || !(out->score >= score_first) || !region_is_sound(photo, &out->next))
        return status;
    status = landmarks_find(c, n, photo, &out->next, out);
    *there = status == SHERF_OK && out->score >= score_least && region_is_sound(photo, &out->next);
    return status;
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

static int by_size(const void *x, const void *y) {
    const photo_person *a = x, *b = y;
    return a->next.side_px > b->next.side_px ? -1 : a->next.side_px < b->next.side_px;
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
    people = d ? mem_alloc(c, (size_t)most + 1, sizeof *people) : NULL;
    sherf_status status = people ? people_detect(c, n, photo, d, &detections) : SHERF_NO_MEMORY;
    for (int i = 0; status == SHERF_OK && i < detections && found < most; i++) {
        photo_person *p = &people[found];
        bool there;
        if (cancelled(c)) status = SHERF_CANCELLED;
        if (status == SHERF_OK) status = look_twice(c, n, photo, &d[i].region, p, &there);
        if (status != SHERF_OK || !there) continue;
        int twin = 0;
        while (twin < found && !same_person(&people[twin], p)) twin++;
        if (twin == found)
            found++;
        else if (p->score > people[twin].score)
            people[twin] = *p;
    }
    mem_free(d);
    if (status != SHERF_OK || !found) {
        mem_free(people);
        return status;
    }
    qsort(people, (size_t)found, sizeof *people, by_size);
    *out = people;
    *count = found;
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
