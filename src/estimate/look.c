/* Looks with BlazePose's landmark network: moves a region until it settles, lets straight and mirrored looks
 * vote on which way the person faces, and looks once with the head hidden. */
#include <math.h>
#include <string.h>

#include "estimate/look.h"
#include "estimate/region.h"

/* Lower probabilities of a person are dropped: after any look, and after the last. */
static const float score_first = .1f, score_min = .5f;
/* The region is settled when it would move by less; parts of its side. */
static const float settled_size = .06f, settled_place = .05f;
/* If the region is a third too small or too large, the network only requests a change of a tenth, so the next
 * look goes further than it says. */
static const float stride = 2.2f, grow_max = 1.8f;
/* Two looks show one person if `apart` is less. */
static const float same_place = .1f;
/* Cosine between the lines through hips and shoulders, seen from above, of two looks that agree. */
static const float same_turn = .5f;
static const float pi = 3.14159265f;
enum { HELPER_MIDDLE = 33, HELPER_TOP = 34, LOOKS_MAX = 5, VOTES_MAX = 6 };

static float sigmoid(float x) {
    return 1 / (1 + expf(-x));
}

static bool finite_all(const float *x, int count) {
    for (int i = 0; i < count; i++)
        if (!isfinite(x[i])) return false;
    return true;
}

/* The landmark's number on the other side: inner eye, eye, outer eye; from the ears on they are in pairs. */
static int other_side(int i) {
    if (i == LANDMARK_NOSE) return i;
    if (i < LANDMARK_LEFT_EAR) return i < 4 ? i + 3 : i - 3;
    return i % 2 ? i + 1 : i - 1;
}

static void place_of(const photo_region *region, const float *places, int i, bool mirrored,
                     float place_px[2]) {
    const float *p = places + i * LANDMARK_COLUMNS, unit = 1.f / LANDMARKS_SIDE;
    region_place(region, mirrored ? 1 - unit * p[0] : unit * p[0], unit * p[1], place_px);
}

/* Converts the network's numbers to the photo's and the camera's axes: both are rotated with the region. */
static void read_outputs(const float *const *output, bool mirrored, photo_person *out) {
    const float *places = output[LANDMARKS_PICTURE], *world = output[LANDMARKS_WORLD];
    const float cosine = cosf(out->region.angle_rad), sine = sinf(out->region.angle_rad);
    float middle_px[2], top_px[2];
    for (int i = 0; i < LANDMARKS; i++) {
        const int from = mirrored ? other_side(i) : i;
        const float *p = places + from * LANDMARK_COLUMNS, *w = world + from * 3,
                    right = mirrored ? -w[0] : w[0];
        landmark *to = &out->landmark[i];
        place_of(&out->region, places, from, mirrored, to->place_px);
        to->place_m[0] = cosine * right - sine * w[1];
        to->place_m[1] = sine * right + cosine * w[1];
        to->place_m[2] = w[2];
        to->visible = sigmoid(p[3]);
        to->present = sigmoid(p[4]);
    }
    place_of(&out->region, places, HELPER_MIDDLE, mirrored, middle_px);
    place_of(&out->region, places, HELPER_TOP, mirrored, top_px);
    out->next = region_about(middle_px, top_px);
    for (int i = 0; i < PERSON_MASK_SIDE * PERSON_MASK_SIDE; i++)
        out->inside[i] =
            output[LANDMARKS_MASK]
                  [mirrored ? i - i % PERSON_MASK_SIDE + PERSON_MASK_SIDE - 1 - i % PERSON_MASK_SIDE : i];
}

static void mirror_rows(float *picture, int side) {
    for (int y = 0; y < side; y++)
        for (int x = 0; x < side / 2; x++)
            for (int k = 0; k < 3; k++) {
                float *a = picture + ((size_t)y * (size_t)side + (size_t)x) * 3 + k,
                      *b = picture + ((size_t)y * (size_t)side + (size_t)(side - 1 - x)) * 3 + k;
                const float kept = *a;
                *a = *b;
                *b = kept;
            }
}

/* Fills a disc of the network's input with the mean colour of its surroundings above and beside it. */
typedef struct {
    float u, v, radius; /* pixels of the input */
} disc;

static void hide(const disc *d, int side, float *input) {
    float mean[3] = {0};
    int beside = 0;
    for (int pass = 0; pass < 2; pass++) {
        for (int y = 0; y < side; y++)
            for (int x = 0; x < side; x++) {
                float *at = input + 3 * ((size_t)y * (size_t)side + (size_t)x);
                const float far = hypotf((float)x - d->u, (float)y - d->v);
                if (pass && far < d->radius) memcpy(at, mean, sizeof mean);
                if (pass || far < d->radius || far > 1.5f * d->radius || (float)y > d->v) continue;
                beside++;
                for (int k = 0; k < 3; k++) mean[k] += at[k];
            }
        for (int k = 0; k < 3 && !pass; k++) mean[k] = beside ? mean[k] / (float)beside : .5f;
    }
}

/* hidden may be NULL. */
static sherf_status look_past(context *c, const pose_networks *n, const sherf_image *photo,
                              const photo_region *region, const disc *hidden, bool mirrored,
                              photo_person *out) {
    const photo_region looked_at = *region; /* may be one of out's */
    const float *output[LANDMARKS_OUTPUTS];
    sherf_status status = SHERF_NO_MEMORY;
    arena *memory = arena_create(c);
    float *input =
        memory ? arena_alloc(c, memory, (size_t)LANDMARKS_SIDE * LANDMARKS_SIDE * 3, sizeof *input) : NULL;
    if (!input) goto done;
    status = region_sample(c, photo, &looked_at, LANDMARKS_SIDE, false, 1, 0, input);
    if (status != SHERF_OK) goto done;
    if (hidden) hide(hidden, LANDMARKS_SIDE, input);
    if (mirrored) mirror_rows(input, LANDMARKS_SIDE);
    status = graph_run(c, n->landmarks, input, memory, output);
    if (status != SHERF_OK) goto done;
    memset(out, 0, sizeof *out);
    out->region = out->next = looked_at;
    if (finite_all(output[LANDMARKS_PICTURE], LANDMARKS_IN_FILE * LANDMARK_COLUMNS) &&
        finite_all(output[LANDMARKS_WORLD], LANDMARKS_IN_FILE * 3) &&
        finite_all(output[LANDMARKS_MASK], PERSON_MASK_SIDE * PERSON_MASK_SIDE) &&
        isfinite(output[LANDMARKS_FLAG][0])) {
        read_outputs(output, mirrored, out);
        out->score = output[LANDMARKS_FLAG][0];
    }
done:
    if (memory) arena_free(memory);
    return status;
}

sherf_status look_once(context *c, const pose_networks *n, const sherf_image *photo,
                       const photo_region *region, bool mirrored, photo_person *out) {
    return look_past(c, n, photo, region, NULL, mirrored, out);
}

bool look_is_sound(const sherf_image *photo, const photo_region *r) {
    const float longest = (float)(photo->width > photo->height ? photo->width : photo->height);
    return r->side_px > 8 && r->side_px < 8 * longest && r->centre_px[0] > -.5f * r->side_px &&
           r->centre_px[0] < (float)photo->width + .5f * r->side_px && r->centre_px[1] > -.5f * r->side_px &&
           r->centre_px[1] < (float)photo->height + .5f * r->side_px;
}

static float moved(const photo_region *a, const photo_region *b) {
    return hypotf(a->centre_px[0] - b->centre_px[0], a->centre_px[1] - b->centre_px[1]);
}

static photo_region further(const photo_region *from, const photo_region *to) {
    photo_region r = *to;
    const float grow = powf(to->side_px / from->side_px, stride);
    r.side_px = from->side_px * fminf(fmaxf(grow, 1 / grow_max), grow_max);
    r.angle_rad = from->angle_rad + stride * remainderf(to->angle_rad - from->angle_rad, 2 * pi);
    return r;
}

/* The unit vector from the right to the left side, as seen from above. */
static void line_across(const photo_person *p, float line[2]) {
    const landmark *l = p->landmark;
    for (int k = 0; k < 2; k++)
        line[k] = l[LANDMARK_LEFT_HIP].place_m[2 * k] - l[LANDMARK_RIGHT_HIP].place_m[2 * k] +
                  l[LANDMARK_LEFT_SHOULDER].place_m[2 * k] - l[LANDMARK_RIGHT_SHOULDER].place_m[2 * k];
    const float length = hypotf(line[0], line[1]);
    for (int k = 0; k < 2; k++) line[k] = length > 0 ? line[k] / length : 0;
}

static float agreement(const photo_person *a, const photo_person *b) {
    float p[2], q[2];
    line_across(a, p);
    line_across(b, q);
    return p[0] * q[0] + p[1] * q[1];
}

/* Mean distance of the midpoints between left and right, so that exchanged sides do not matter. */
static float apart(const photo_person *a, const photo_person *b) {
    static const int left[] = {LANDMARK_LEFT_SHOULDER, LANDMARK_LEFT_ELBOW, LANDMARK_LEFT_WRIST,
                               LANDMARK_LEFT_HIP,      LANDMARK_LEFT_KNEE,  LANDMARK_LEFT_ANKLE};
    float sum = 0;
    for (size_t i = 0; i < COUNT_OF(left); i++) {
        float middle[2];
        for (int k = 0; k < 2; k++)
            middle[k] = .5f * (a->landmark[left[i]].place_px[k] + a->landmark[left[i] + 1].place_px[k] -
                               b->landmark[left[i]].place_px[k] - b->landmark[left[i] + 1].place_px[k]);
        sum += hypotf(middle[0], middle[1]);
    }
    return sum / ((float)COUNT_OF(left) * a->region.side_px);
}

sherf_status look_until_settled(context *c, const pose_networks *n, const sherf_image *photo,
                                const photo_region *region, const photo_person *known, int count,
                                photo_person *out, bool *there) {
    photo_region next = *region;
    sherf_status status = SHERF_OK;
    *there = false;
    for (int look = 0; look < LOOKS_MAX; look++) {
        if (!look_is_sound(photo, &next)) return SHERF_OK;
        status = look_once(c, n, photo, &next, false, out);
        if (status != SHERF_OK || !(out->score >= score_first)) return status;
        for (int i = 0; i < count; i++)
            if (apart(&known[i], out) < same_place) return SHERF_OK;
        if (look && fabsf(logf(out->next.side_px / out->region.side_px)) < settled_size &&
            moved(&out->region, &out->next) < settled_place * out->region.side_px)
            break;
        next = further(&out->region, &out->next);
    }
    *there = out->score >= score_min && look_is_sound(photo, &out->next);
    return SHERF_OK;
}

static void add_landmark(landmark *to, const landmark *from, float part) {
    for (int k = 0; k < 2; k++) to->place_px[k] += part * from->place_px[k];
    for (int k = 0; k < 3; k++) to->place_m[k] += part * from->place_m[k];
    to->visible += part * from->visible;
    to->present += part * from->present;
}

static bool same_region(const photo_person *a, const photo_person *b) {
    return !memcmp(&a->region, &b->region, sizeof a->region);
}

/* The mean of the looks that agree with the chosen one; masks of those that looked at the same region. */
static void join(const photo_person *vote, int count, int chosen, photo_person *out) {
    const photo_person *first = NULL;
    int members = 0, masks = 0;
    bool member[VOTES_MAX];
    for (int i = 0; i < count; i++) {
        member[i] = i == chosen || agreement(&vote[i], &vote[chosen]) >= same_turn;
        if (!member[i]) continue;
        if (!first) first = &vote[i];
        members++;
        masks += same_region(&vote[i], first);
    }
    memset(out, 0, sizeof *out);
    out->region = first->region;
    out->next = first->next;
    for (int i = 0; i < count; i++) {
        if (!member[i]) continue;
        const float part = 1 / (float)members, mask_part = 1 / (float)masks;
        out->score += part * vote[i].score;
        for (int l = 0; l < LANDMARKS; l++) add_landmark(&out->landmark[l], &vote[i].landmark[l], part);
        if (!same_region(&vote[i], first)) continue;
        for (int k = 0; k < PERSON_MASK_SIDE * PERSON_MASK_SIDE; k++)
            out->inside[k] += mask_part * vote[i].inside[k];
    }
}

/* The look that agrees most with the others, by the sum of the cosines. */
static int choose(const photo_person *vote, int count, float *lead) {
    int best = 0;
    float max = -1e9f;
    for (int i = 0; i < count; i++) {
        float sum = 0;
        for (int k = 0; k < count; k++) sum += agreement(&vote[i], &vote[k]);
        if (sum > max) max = sum, best = i;
    }
    *lead = max;
    return best;
}

sherf_status look_mirrored(context *c, const pose_networks *n, const sherf_image *photo, photo_person *p,
                           float *doubt) {
    static const float scale[VOTES_MAX / 2] = {1, 1.25f, 1.12f};
    photo_person *vote = mem_alloc(c, VOTES_MAX, sizeof *vote);
    sherf_status status = vote ? SHERF_OK : SHERF_NO_MEMORY;
    int count = 0, chosen = 0;
    float lead = 0;
    *doubt = 1;
    for (int pair = 0; pair < VOTES_MAX / 2 && status == SHERF_OK; pair++) {
        photo_region r = p->region;
        r.side_px *= scale[pair];
        for (int k = 0; k < 2 && status == SHERF_OK; k++) {
            if (!count)
                vote[count] = *p;
            else
                status = look_once(c, n, photo, &r, k, &vote[count]);
            if (status == SHERF_OK && (!count || vote[count].score >= score_min)) count++;
        }
        if (status != SHERF_OK || !count) break;
        if (!pair && count == 2) *doubt = apart(&vote[0], &vote[1]);
        chosen = choose(vote, count, &lead);
        if (lead >= same_turn * (float)count) break;
    }
    if (status == SHERF_OK) join(vote, count, chosen, p);
    mem_free(vote);
    return status;
}

/* The head's place in the network's input for p's region. */
static disc head_of(const photo_person *p) {
    static const int head[] = {LANDMARK_NOSE, LANDMARK_LEFT_EYE, LANDMARK_RIGHT_EYE, LANDMARK_LEFT_EAR,
                               LANDMARK_RIGHT_EAR};
    const landmark *l = p->landmark;
    float middle[2] = {0}, uv[2], up[2];
    for (int k = 0; k < 2; k++) {
        for (size_t i = 0; i < COUNT_OF(head); i++)
            middle[k] += l[head[i]].place_px[k] / (float)COUNT_OF(head);
        up[k] = middle[k] -
                .5f * (l[LANDMARK_LEFT_SHOULDER].place_px[k] + l[LANDMARK_RIGHT_SHOULDER].place_px[k]);
    }
    region_find(&p->region, middle, uv);
    return (disc){LANDMARKS_SIDE * uv[0] - .5f, LANDMARKS_SIDE * uv[1] - .5f,
                  LANDMARKS_SIDE * .75f * hypotf(up[0], up[1]) / p->region.side_px};
}

/* The region about shoulders and arms. */
static photo_region upper_half(const photo_person *p) {
    photo_region r = p->region;
    r.side_px *= .5f;
    for (int k = 0; k < 2; k++)
        r.centre_px[k] = .5f * (p->landmark[LANDMARK_LEFT_SHOULDER].place_px[k] +
                                p->landmark[LANDMARK_RIGHT_SHOULDER].place_px[k]);
    return r;
}

sherf_status look_without_head(context *c, const pose_networks *n, const sherf_image *photo,
                               photo_person *p) {
    enum { LOOKS = 4 }; /* straight and mirrored, each without the head and at the upper half */
    photo_person *look = mem_alloc(c, LOOKS, sizeof *look);
    sherf_status status = look ? SHERF_OK : SHERF_NO_MEMORY;
    const disc head = head_of(p);
    const photo_region upper = upper_half(p);
    bool turned = look_is_sound(photo, &upper);
    for (int i = 0; i < LOOKS && turned && status == SHERF_OK; i++) {
        status = look_past(c, n, photo, i < 2 ? &p->region : &upper, i < 2 ? &head : NULL, i % 2, &look[i]);
        turned = status == SHERF_OK && look[i].score >= score_min && agreement(p, &look[i]) < -same_turn &&
                 agreement(&look[0], &look[i]) >= same_turn;
    }
    for (int i = 0; i < LANDMARKS && turned; i++) {
        memset(&p->landmark[i], 0, sizeof p->landmark[i]);
        for (int k = 0; k < 2; k++) add_landmark(&p->landmark[i], &look[k].landmark[i], .5f);
    }
    mem_free(look);
    return status;
}
