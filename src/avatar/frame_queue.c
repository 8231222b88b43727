/* A ring of pictures under a lock: one thread fills slots, the other takes them. */
#include <pthread.h>

#include "avatar/frame_queue.h"

enum { SLOTS = 4 };

struct frame_queue {
    pthread_t thread;
    pthread_mutex_t lock;
    pthread_cond_t changed;
    sherf_context *own; /* the thread's */
    frame_writer write;
    void *user;
    sherf_image slot[SLOTS];
    int made, written; /* pictures; made - written are waiting */
    bool ended;
    sherf_status status;
};

static void *run(void *arg) {
    frame_queue *q = arg;
    pthread_mutex_lock(&q->lock);
    while (!q->status) {
        while (q->made == q->written && !q->ended) pthread_cond_wait(&q->changed, &q->lock);
        if (q->made == q->written) break;
        int n = q->written;
        pthread_mutex_unlock(&q->lock); /* slot n is this thread's until it counts as written */
        sherf_status status = q->write(q->own, q->user, n, &q->slot[n % SLOTS]);
        pthread_mutex_lock(&q->lock);
        q->status = status;
        q->written++;
        pthread_cond_signal(&q->changed);
    }
    pthread_mutex_unlock(&q->lock);
    return NULL;
}

static void dispose(frame_queue *q) {
    for (int i = 0; i < SLOTS; i++) mem_free(q->slot[i].data);
    pthread_mutex_destroy(&q->lock);
    pthread_cond_destroy(&q->changed);
    sherf_context_free(q->own);
    mem_free(q);
}

sherf_status frame_queue_create(context *c, int width, int height, int channels, frame_writer write,
                                void *user, frame_queue **out) {
    const sherf_options options = {
        .threads = c->threads, .precision = SHERF_PRECISION_FP32, .device = SHERF_DEVICE_CPU};
    sherf_status status = SHERF_NO_MEMORY;
    *out = NULL;
    frame_queue *q = mem_zero(c, 1, sizeof *q);
    if (!q) return status;
    pthread_mutex_init(&q->lock, NULL);
    pthread_cond_init(&q->changed, NULL);
    q->write = write;
    q->user = user;
    for (int i = 0; i < SLOTS; i++) {
        float *data = mem_alloc(c, (size_t)width * (size_t)height, (size_t)channels * sizeof *data);
        if (!data) goto fail;
        q->slot[i] = (sherf_image){width, height, channels, data};
    }
    if ((status = sherf_context_create(&options, &q->own))) {
        failure(c, status, "out of memory");
        goto fail;
    }
    if (pthread_create(&q->thread, NULL, run, q)) {
        status = failure(c, SHERF_NO_MEMORY, "no thread can be started");
        goto fail;
    }
    *out = q;
    return SHERF_OK;
fail:
    dispose(q);
    return status;
}

sherf_image *frame_queue_slot(frame_queue *q) {
    pthread_mutex_lock(&q->lock);
    while (q->made - q->written == SLOTS && !q->status) pthread_cond_wait(&q->changed, &q->lock);
    sherf_image *slot = q->status ? NULL : &q->slot[q->made % SLOTS];
    pthread_mutex_unlock(&q->lock);
    return slot;
}

void frame_queue_push(frame_queue *q) {
    pthread_mutex_lock(&q->lock);
    q->made++;
    pthread_cond_signal(&q->changed);
    pthread_mutex_unlock(&q->lock);
}

sherf_status frame_queue_end(context *c, frame_queue *q) {
    pthread_mutex_lock(&q->lock);
    q->ended = true;
    pthread_cond_signal(&q->changed);
    pthread_mutex_unlock(&q->lock);
    pthread_join(q->thread, NULL);
    sherf_status status = q->status;
    if (status) failure(c, status, "%s", sherf_message(q->own));
    dispose(q);
    return status;
}
