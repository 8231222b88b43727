/* From a photo to an observation: the steps in their order, and the facts reported about them. */
#include "estimate/estimate.h"

#include <math.h>
#include <string.h>

#include "estimate/mask.h"
#include "estimate/shrink.h"

sherf_status sherf_estimator_load(sherf_context *c, const char *path, sherf_estimator **out) {
    *out = NULL;
    sherf_estimator *e = mem_zero(c, 1, sizeof *e);
    if (!e) return SHERF_NO_MEMORY;
    sherf_status status = pose_networks_load(c, path, &e->networks);
    if (status)
        mem_free(e);
    else
        *out = e;
    return status;
}

void sherf_estimator_free(sherf_estimator *e) {
    if (!e) return;
    pose_networks_free(e->networks);
    mem_free(e);
}

void sherf_estimate_free(sherf_estimate *e) {
    if (!e) return;
    sherf_image_free(&e->photo);
    sherf_image_free(&e->color);
    sherf_image_free(&e->mask);
    mem_free(e);
}
const sherf_image *sherf_estimate_image(const sherf_estimate *e) {
    return &e->color;
}
const sherf_image *sherf_estimate_mask(const sherf_estimate *e) {
    return &e->mask;
}
const sherf_camera *sherf_estimate_camera(const sherf_estimate *e) {
    return &e->fit.camera;
}
const sherf_pose *sherf_estimate_pose(const sherf_estimate *e) {
    return &e->fit.pose;
}
const sherf_estimate_facts *sherf_estimate_found(const sherf_estimate *e) {
    return &e->facts;
}

/* ---- the photo ---- */

typedef struct {
    const image_u8 *from;
    int first, count;
} channels;

static void channels_row(const void *user, int y, float *row) {
    const channels *k = user;
    const uint8_t *in = k->from->data + (size_t)y * (size_t)k->from->width * (size_t)k->from->channels;
    for (int x = 0; x < k->from->width; x++, in += k->from->channels)
        for (int i = 0; i < k->count; i++) *row++ = (float)in[k->first + i] / 255;
}

/* Channels [first, first + count) of a picture, no longer than longest on a side: as floats in [0, 1]. */
static sherf_status take_channels(context *c, const image_u8 *from, int first, int count, int longest,
                                  sherf_image *out) {
    const double longer = from->width > from->height ? from->width : from->height;
    const double scale = longer > longest ? longest / longer : 1;
    const int width = (int)fmax(1, floor(from->width * scale + 0.5)),
              height = (int)fmax(1, floor(from->height * scale + 0.5));
    const channels k = {from, first, count};
    *out = (sherf_image){width, height, count, NULL};
    return picture_shrink(c, channels_row, &k, from->width, from->height, out);
}

/* The alpha channel is a mask, if any of the picture is transparent. */
static bool has_cutout(const image_u8 *picture) {
    const size_t n = (size_t)picture->width * (size_t)picture->height;
    size_t clear = 0;
    for (size_t i = 0; picture->channels == 4 && i < n; i++) clear += picture->data[4 * i + 3] < 128;
    return clear > n / 200 && clear < n;
}

static sherf_status given_mask(context *c, const char *path, const image_u8 *photo, sherf_image *out) {
    image_u8 grey;
    sherf_status status = image_read(c, path, 1, &grey);
    if (status) return status;
    if (grey.width != photo->width || grey.height != photo->height)
        status = failure(c, SHERF_MISMATCH, "%s: a mask of %d x %d pixels for a photo of %d x %d", path,
                         grey.width, grey.height, photo->width, photo->height);
    else
        status = take_channels(c, &grey, 0, 1, ESTIMATE_SIDE_MAX, out);
    mem_free(grey.data);
    return status;
}

/* ---- the steps ---- */

/* Chooses the person: the one with most of the given mask's pixels, or the one requested by number. */
static sherf_status choose(context *c, const photo_person *people, int count, int wanted,
                           const sherf_image *mask, int *chosen) {
    if (count < 1)
        return failure(c, SHERF_MISMATCH,
                       "nobody was found in the photo: a whole person, at least 60 pixels high, is needed");
    if (wanted > count)
        return failure(c, SHERF_BAD_ARGUMENT, "person %d was requested, %d %s found", wanted, count,
                       count == 1 ? "was" : "were");
    *chosen = wanted > 0 ? wanted - 1 : 0;
    if (wanted > 0 || !mask->data) return SHERF_OK;
    double best = -1;
    for (int i = 0; i < count; i++) {
        double inside = 0;
        for (int k = 0; k < LANDMARKS; k++) {
            const long x = lrintf(people[i].landmark[k].place_px[0]),
                       y = lrintf(people[i].landmark[k].place_px[1]);
            if (x >= 0 && y >= 0 && x < mask->width && y < mask->height)
                inside += (double)mask->data[(size_t)y * (size_t)mask->width + (size_t)x];
        }
        if (inside > best) best = inside, *chosen = i;
    }
    return SHERF_OK;
}

static void find_box(const sherf_image *mask, float box_px[4]) {
    int box[4] = {mask->width, mask->height, -1, -1};
    for (int y = 0; y < mask->height; y++)
        for (int x = 0; x < mask->width; x++) {
            if (!(mask->data[(size_t)y * (size_t)mask->width + (size_t)x] >= 0.5f)) continue;
            if (x < box[0]) box[0] = x;
            if (x > box[2]) box[2] = x;
            if (y < box[1]) box[1] = y;
            if (y > box[3]) box[3] = y;
        }
    for (int k = 0; k < 4; k++) box_px[k] = (float)box[k];
}

/* Refused: a head alone does not determine a body; a guessed one could be anywhere, of any size. */
static sherf_status only_a_piece(context *c) {
    return failure(c, SHERF_MISMATCH,
                   "only a head, or a small part of a person, is in the photo: take one of the whole person");
}

static bool shoulders_seen(const photo_person *p, const sherf_image *photo) {
    bool seen = false;
    for (int k = LANDMARK_LEFT_SHOULDER; k <= LANDMARK_RIGHT_SHOULDER; k++) {
        const float x = p->landmark[k].place_px[0], y = p->landmark[k].place_px[1];
        seen |= x >= 0 && y >= 0 && x < (float)photo->width && y < (float)photo->height;
    }
    return seen;
}

/* A head is a seventh of a body. */
static bool fits_the_photo(const sherf_estimate *e) {
    const float *box = e->facts.box_px;
    return e->fit.height_px < 7 * fmax(box[2] - box[0] + 1, box[3] - box[1] + 1);
}

static void describe(sherf_estimate *e) {
    const body_fit_result *fit = &e->fit;
    sherf_estimate_facts *f = &e->facts;
    find_box(&e->mask, f->box_px);
    f->width_px = e->photo.width;
    f->height_px = e->photo.height;
    f->focal_px = (double)fit->camera.K[0];
    f->pitch_deg = fit->pitch_rad * 180 / M_PI;
    f->lean_deg = fit->lean_rad * 180 / M_PI;
    f->person_px = fit->height_px;
    f->landmarks_off = fit->height_px > 0 ? fit->landmarks_px / fit->height_px : 1;
    f->mask_covered = fit->mask_covered;
    f->body_inside = fit->body_inside;
    const bool warned[] = {fit->from_behind, fit->cut_feet, fit->cut_head, fit->small,
                           fit->hidden_arms, fit->poor,     e->mask_over};
    f->warnings = 0;
    for (size_t i = 0; i < COUNT_OF(warned); i++) f->warnings |= warned[i] ? 1u << i : 0;
}

/* Fits the found person's body, with this shape, or estimates the shape too if it is NULL. */
static sherf_status fit(context *c, const body_model *body, const float *shape, sherf_estimate *e) {
    const double begun_s = time_seconds();
    const body_fit_input input = {.person = &e->person,
                                  .width_px = e->photo.width,
                                  .height_px = e->photo.height,
                                  .focal_px = e->focal_px,
                                  .mask = &e->mask,
                                  .shape = shape};
    sherf_status status = body_fit(c, body, &input, &e->fit);
    if (status) return status;
    e->facts.fit_ms += 1e3 * (time_seconds() - begun_s);
    describe(e);
    return fits_the_photo(e) ? SHERF_OK : only_a_piece(c);
}

/* The photo, and perhaps the mask, are in e already. */
static sherf_status estimate(context *c, const sherf_estimator *n, const body_model *body,
                             const sherf_estimate_options *o, double focal_px, sherf_estimate *e) {
    enum { STEPS = 4 };
    photo_person *people = NULL;
    person_mask_facts mask = {0};
    int count = 0, chosen = 0;
    sherf_status status = progress(c, "finding people", 0, STEPS);
    double begun_s = time_seconds();
    if (!status) status = people_find(c, n->networks, &e->photo, PHOTO_PEOPLE_MAX, &people, &count);
    if (!status) status = choose(c, people, count, o ? o->person : 0, &e->mask, &chosen);
    if (!status && !shoulders_seen(&people[chosen], &e->photo)) status = only_a_piece(c);
    if (status) goto done;
    e->facts.people = count;
    e->facts.person = chosen + 1;
    e->facts.find_ms = 1e3 * (time_seconds() - begun_s);
    begun_s = time_seconds();
    if ((status = progress(c, "cutting out", 1, STEPS))) goto done;
    if (!e->mask.data) {
        const photo_person person = people[chosen]; /* the others are then contiguous */
        people[chosen] = people[0];
        people[0] = person;
        status = person_mask(c, &e->photo, people, people + 1, count - 1, &e->mask, &mask);
        chosen = 0;
    }
    if (!status) status = mask_free_colors(c, &e->photo, &e->mask, &e->color);
    if (status) goto done;
    e->facts.mask_ms = 1e3 * (time_seconds() - begun_s);
    e->person = people[chosen];
    e->focal_px = focal_px;
    e->mask_over = mask.over;
    if ((status = progress(c, "fitting the body", 2, STEPS))) goto done;
    if ((status = fit(c, body, NULL, e))) goto done;
    status = progress(c, "fitting the body", STEPS, STEPS);
done:
    mem_free(people);
    return status;
}

static sherf_status check_options(context *c, const sherf_estimate_options *o) {
    if (!o) return SHERF_OK;
    if (o->person < 0 || o->person > PHOTO_PEOPLE_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "person %d, must be 1 to %d, or 0 for the largest", o->person,
                       PHOTO_PEOPLE_MAX);
    if (!(o->focal_px >= 0 && o->focal_px < 1e6))
        return failure(c, SHERF_BAD_ARGUMENT, "a focal length of %g pixels", o->focal_px);
    return SHERF_OK;
}

static sherf_status finish(context *c, sherf_status status, sherf_estimate *e, sherf_estimate **out) {
    if (status)
        sherf_estimate_free(e);
    else
        *out = e;
    return status;
}

sherf_status sherf_estimate_photo(sherf_context *c, const sherf_estimator *n, const sherf_body *body,
                                  const char *path, const sherf_estimate_options *o, sherf_estimate **out) {
    *out = NULL;
    image_u8 picture = {0};
    photo_info info = {0};
    sherf_estimate *e = NULL;
    double focal_px = 0;
    sherf_status status = check_options(c, o);
    if (!status) status = image_photo_read(c, path, &picture, &info);
    if (status) return status;
    if (!(e = mem_zero(c, 1, sizeof *e))) status = SHERF_NO_MEMORY;
    if (!status && o && o->mask) status = given_mask(c, o->mask, &picture, &e->mask);
    if (!status && !e->mask.data && has_cutout(&picture))
        status = take_channels(c, &picture, 3, 1, ESTIMATE_SIDE_MAX, &e->mask);
    if (!status) status = take_channels(c, &picture, 0, 3, ESTIMATE_SIDE_MAX, &e->photo);
    mem_free(picture.data);
    if (status) return finish(c, status, e, out);
    focal_px = o && o->focal_px > 0 ? o->focal_px : (double)info.focal_px;
    status = estimate(c, n, body, o, focal_px * e->photo.width / picture.width, e);
    if (status) failure_prefix(c, status, "%s", path);
    return finish(c, status, e, out);
}

sherf_status sherf_estimate_picture(sherf_context *c, const sherf_estimator *n, const sherf_body *body,
                                    const sherf_image *photo, const sherf_image *mask,
                                    const sherf_estimate_options *o, sherf_estimate **out) {
    *out = NULL;
    sherf_status status = check_options(c, o);
    if (status) return status;
    const size_t pixels = (size_t)photo->width * (size_t)photo->height;
    if (!photo->data || photo->width < 1 || photo->height < 1 || photo->channels != 3 ||
        photo->width > ESTIMATE_SIDE_MAX || photo->height > ESTIMATE_SIDE_MAX ||
        (mask && (!mask->data || mask->channels != 1 || mask->width != photo->width ||
                  mask->height != photo->height)))
        return failure(
            c, SHERF_BAD_ARGUMENT,
            "a photo of %d x %d x %d: must be RGB, at most %d on a side, its mask of the same size",
            photo->width, photo->height, photo->channels, ESTIMATE_SIDE_MAX);
    sherf_estimate *e = mem_zero(c, 1, sizeof *e);
    if (!e) return SHERF_NO_MEMORY;
    e->photo = (sherf_image){photo->width, photo->height, 3, mem_alloc(c, pixels, 3 * sizeof(float))};
    if (mask) e->mask = (sherf_image){photo->width, photo->height, 1, mem_alloc(c, pixels, sizeof(float))};
    if (!e->photo.data || (mask && !e->mask.data)) return finish(c, SHERF_NO_MEMORY, e, out);
    memcpy(e->photo.data, photo->data, pixels * 3 * sizeof(float));
    if (mask) memcpy(e->mask.data, mask->data, pixels * sizeof(float));
    return finish(c, estimate(c, n, body, o, o ? o->focal_px : 0, e), e, out);
}

/* How well an estimate determines the shape: little where the body fits badly or is cut off. */
static double worth(const sherf_estimate *e) {
    const unsigned partly = SHERF_ESTIMATE_CUT_FEET | SHERF_ESTIMATE_CUT_HEAD | SHERF_ESTIMATE_POOR;
    return e->facts.warnings & partly ? 0.25 * e->fit.iou + 1e-3 : e->fit.iou + 1e-3;
}

sherf_status sherf_estimate_share_shape(sherf_context *c, const sherf_body *body, int count,
                                        sherf_estimate *const *estimates) {
    float shape[BODY_SHAPES];
    double sum[BODY_SHAPES] = {0}, weights = 0;
    sherf_status status = SHERF_OK;
    if (count < 2) return SHERF_OK;
    for (int i = 0; i < count; i++) {
        const double w = worth(estimates[i]);
        for (int b = 0; b < BODY_SHAPES; b++) sum[b] += w * (double)estimates[i]->fit.pose.shapes[b];
        weights += w;
    }
    for (int b = 0; b < BODY_SHAPES; b++) shape[b] = (float)(sum[b] / weights);
    for (int i = 0; i < count && status == SHERF_OK; i++) {
        status = progress(c, "fitting one shape", i, count);
        if (status == SHERF_OK) status = fit(c, body, shape, estimates[i]);
        if (status != SHERF_OK) failure_prefix(c, status, "photo %d", i + 1);
    }
    return status == SHERF_OK ? progress(c, "fitting one shape", count, count) : status;
}

sherf_status sherf_estimate_observation(sherf_context *c, const sherf_estimate *e, sherf_observation **out) {
    const size_t n = (size_t)e->mask.width * (size_t)e->mask.height;
    *out = NULL;
    sherf_image hard = {e->mask.width, e->mask.height, 1, mem_alloc(c, n, sizeof(float))};
    if (!hard.data) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) hard.data[i] = e->mask.data[i] >= 0.5f;
    sherf_status status = sherf_observation_create(c, &e->color, &hard, &e->fit.camera, &e->fit.pose, out);
    mem_free(hard.data);
    return status;
}
