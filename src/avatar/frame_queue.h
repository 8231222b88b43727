/* frame_queue: pictures made on one thread and written on another, a few of them waiting in between. */
#ifndef SHERF_FRAME_QUEUE_H
#define SHERF_FRAME_QUEUE_H

#include "base/base.h"

/* Writes picture number n; called in order, on the queue's thread, with the queue's own context. */
typedef sherf_status (*frame_writer)(context *c, void *user, int n, const sherf_image *image);

typedef struct frame_queue frame_queue;
sherf_status frame_queue_create(context *c, int width, int height, int channels, frame_writer write,
                                void *user, frame_queue **out);
/* A picture to be filled, when one is free. NULL: writing has failed; frame_queue_end tells. */
sherf_image *frame_queue_slot(frame_queue *q);
void frame_queue_push(frame_queue *q); /* the slot given last is filled */
/* Waits until all is written, stores the first failure in c, frees. */
sherf_status frame_queue_end(context *c, frame_queue *q);
#endif
