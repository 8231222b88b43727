/* What the page draws itself while something moves: an avatar's baked surface, and a motion as joint
 * matrices. A separate thread makes surfaces, when a page first requests one. */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/resource.h>

#include "baked/form.h"
#include "scene/scene.h"
#include "viewer/viewer.h"

enum { RESOLUTION = 256, NICE = 5 };

/* ---- a surface as bytes ---- */

/* Bytes that sum to 255; the rounding error goes to the heaviest weight, which is first. */
static void weights_to_bytes(const float weight[4], uint8_t out[4]) {
    int left = 255;
    for (int i = 1; i < 4; i++) {
        out[i] = (uint8_t)(255 * weight[i] + 0.5f);
        left -= out[i];
    }
    out[0] = (uint8_t)left;
}

static uint8_t *put(uint8_t *to, const void *from, size_t bytes) {
    memcpy(to, from, bytes);
    return to + bytes;
}

static sherf_status pack(context *c, const baked_form *f, uint8_t **out, size_t *bytes) {
    const size_t n = (size_t)f->corners, triangles = (size_t)f->triangles;
    const uint32_t head[LIVE_HEAD] = {LIVE_SURFACE, (uint32_t)n, (uint32_t)triangles, (uint32_t)f->png_bytes};
    *bytes = sizeof head + n * LIVE_CORNER_BYTES + triangles * 12 + f->png_bytes;
    uint8_t *to = *out = mem_alloc(c, *bytes, 1);
    if (!to) return SHERF_NO_MEMORY;
    to = put(put(to, head, sizeof head), f->rest, n * 12);
    for (size_t i = 0; i < 2 * n; i++) {
        const float at = (f->uv[i] + 0.5f) / (float)f->side_px;
        const uint16_t share = (uint16_t)(65535 * fminf(fmaxf(at, 0), 1) + 0.5f);
        to = put(to, &share, sizeof share);
    }
    to = put(to, f->joint, 4 * n);
    for (size_t i = 0; i < n; i++, to += 4) weights_to_bytes(f->weight + 4 * i, to);
    put(put(to, f->triangle, triangles * 12), f->png, f->png_bytes);
    return SHERF_OK;
}

/* ---- the thread ---- */

static sherf_status bake(context *c, const viewer *v, int avatar, live_surface *out) {
    const sherf_viewer_avatar *a = &v->scene.avatars[avatar];
    const sherf_bake_options o = {.resolution = v->live.resolution,
                                  .detail = v->scene.detail ? SHERF_DETAIL_ON : SHERF_DETAIL_OFF};
    sherf_status status = sherf_avatar_bake(c, a->avatar, a->body, &o, &out->avatar);
    return status == SHERF_OK ? pack(c, out->avatar->formed, &out->data, &out->bytes) : status;
}

/* The avatar that was requested last, which the user is viewing; -1: none. Under the lock. */
static int wanted(const viewer_live *l) {
    int best = -1;
    for (int i = 0; i < VIEWER_AVATARS; i++)
        if (l->surface[i].state == LIVE_REQUESTED &&
            (best < 0 || l->surface[i].request > l->surface[best].request))
            best = i;
    return best;
}

static void *work(void *arg) {
    viewer *v = arg;
    viewer_live *l = &v->live;
    setpriority(PRIO_PROCESS, 0, NICE); /* of this thread: pictures have priority */
    pthread_mutex_lock(&l->lock);
    while (!l->closed) {
        const int i = wanted(l);
        if (i < 0) {
            pthread_cond_wait(&l->news, &l->lock);
            continue;
        }
        live_surface made = {.state = LIVE_BAKING};
        l->surface[i].state = LIVE_BAKING;
        pthread_mutex_unlock(&l->lock);
        made.state = bake(l->c, v, i, &made) == SHERF_OK ? LIVE_READY : LIVE_FAILED;
        pthread_mutex_lock(&l->lock);
        l->surface[i] = made;
    }
    pthread_mutex_unlock(&l->lock);
    return NULL;
}

/* Takes avatars that were baked before. */
static sherf_status take_baked(context *c, viewer *v) {
    sherf_status status = SHERF_OK;
    for (int i = 0; i < v->scene.avatar_count && status == SHERF_OK; i++) {
        const sherf_avatar *a = v->scene.avatars[i].avatar;
        live_surface *s = &v->live.surface[i];
        if (!a->form) continue;
        status = pack(c, a->formed, &s->data, &s->bytes);
        if (status == SHERF_OK) s->state = LIVE_READY;
    }
    return status;
}

sherf_status live_open(context *c, viewer *v) {
    viewer_live *l = &v->live;
    const sherf_options own = {.threads = 1, .precision = c->precision, .device = SHERF_DEVICE_CPU};
    pthread_mutex_init(&l->lock, NULL);
    pthread_cond_init(&l->news, NULL);
    l->open = true;
    l->resolution = RESOLUTION;
    const sherf_status status = take_baked(c, v);
    if (status != SHERF_OK) return status;
    if (c->device != SHERF_DEVICE_CPU)
        return SHERF_OK; /* that context's memory holds the avatars: the page requests pictures */
    if (sherf_context_create(&own, &l->c) == SHERF_OK) return SHERF_OK;
    return failure(c, SHERF_NO_MEMORY, "out of memory");
}

void live_close(viewer *v) {
    viewer_live *l = &v->live;
    if (!l->open) return;
    pthread_mutex_lock(&l->lock);
    l->closed = true;
    if (l->c) sherf_cancel(l->c);
    pthread_cond_signal(&l->news);
    pthread_mutex_unlock(&l->lock);
    if (l->started) pthread_join(l->thread, NULL);
    for (int i = 0; i < VIEWER_AVATARS; i++) {
        mem_free(l->surface[i].data);
        sherf_avatar_free(l->surface[i].avatar);
    }
    if (l->c) sherf_context_free(l->c);
    pthread_cond_destroy(&l->news);
    pthread_mutex_destroy(&l->lock);
}

live_state live_ask(viewer *v, int avatar, const uint8_t **data, size_t *bytes) {
    viewer_live *l = &v->live;
    live_surface *s = &l->surface[avatar];
    pthread_mutex_lock(&l->lock);
    if (s->state == LIVE_NONE) {
        if (!l->started && l->c) l->started = pthread_create(&l->thread, NULL, work, v) == 0;
        if (!l->started) s->state = LIVE_FAILED;
    }
    if (s->state == LIVE_NONE || s->state == LIVE_REQUESTED) {
        s->state = LIVE_REQUESTED;
        s->request = ++l->request;
        pthread_cond_signal(&l->news);
    }
    const live_state state = s->state;
    *data = s->data;
    *bytes = s->bytes;
    pthread_mutex_unlock(&l->lock);
    return state;
}

const sherf_avatar *live_avatar(viewer *v, int avatar) {
    const sherf_avatar *a = v->scene.avatars[avatar].avatar;
    const uint8_t *data;
    size_t bytes;
    if (a->form) return a;
    return live_ask(v, avatar, &data, &bytes) == LIVE_READY ? v->live.surface[avatar].avatar : NULL;
}

/* ---- motions ---- */

/* Writes the framing's numbers in the order that the page's camera reads. */
static float *put_framing(float *to, const viewer_framing *f) {
    for (int i = 0; i < 9; i++) *to++ = (float)f->axes[i];
    for (int i = 0; i < 3; i++) *to++ = f->centre_m[i];
    for (int i = 0; i < 3; i++) *to++ = (float)f->half_m[i];
    *to++ = (float)f->distance_m;
    return to;
}

/* Writes the root's displacement and the joints' matrices, rest pose to world: [R | Th] A. */
static sherf_status put_frame(context *c, const viewer_scene *s, const viewer_framing *f, int avatar,
                              int motion, int frame, float *to) {
    const sherf_pose pose = scene_pose(s, avatar, motion, frame);
    posed_body *p = NULL;
    sherf_status status =
        posed_joints_create(c, s->avatars[avatar].body, pose.poses_rad, pose.shapes, pose.R, pose.Th_m, &p);
    if (status != SHERF_OK) return status;
    scene_root_way(f, p, to);
    to += 3;
    for (int j = 0; j < BODY_JOINTS; j++)
        for (int r = 0; r < 3; r++)
            for (int k = 0; k < 4; k++) {
                double x = k == 3 ? (double)p->Th[r] : 0;
                for (int i = 0; i < 3; i++) x += (double)p->R[3 * r + i] * (double)p->transform[j][4 * i + k];
                *to++ = (float)x;
            }
    posed_body_free(p);
    return SHERF_OK;
}

sherf_status live_moves(context *c, viewer_scene *s, int avatar, int motion, int frame, uint8_t **out,
                        size_t *bytes) {
    const int left = s->motions[motion].count - frame, count = left < LIVE_FRAMES ? left : LIVE_FRAMES;
    const uint32_t head[LIVE_HEAD] = {LIVE_MOVES, (uint32_t)frame, (uint32_t)count, 0};
    const viewer_framing *f;
    *out = NULL;
    *bytes = sizeof head + (LIVE_FRAMING + (size_t)count * LIVE_FRAME) * sizeof(float);
    sherf_status status = scene_framing(c, s, avatar, motion, &f);
    if (status != SHERF_OK) return status;
    float *number = mem_alloc(c, *bytes, 1);
    if (!number) return SHERF_NO_MEMORY;
    memcpy(number, head, sizeof head);
    float *to = put_framing(number + LIVE_HEAD, f);
    for (int i = 0; i < count && status == SHERF_OK; i++, to += LIVE_FRAME)
        status = put_frame(c, s, f, avatar, motion, frame + i, to);
    if (status == SHERF_OK)
        *out = (uint8_t *)number;
    else
        mem_free(number);
    return status;
}
