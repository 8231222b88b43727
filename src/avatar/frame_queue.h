/* frame_queue: passes pictures from the thread that makes them to one that writes them, with room for a few
 * in between. */
#ifndef SHERF_FRAME_QUEUE_H
#define SHERF_FRAME_QUEUE_H

#include "base/base.h"

/* Writes picture number n; called in order, on the queue's thread, with the queue's own context. */
typedef sherf_status (*frame_writer)(context *c, void *user, int n, const sherf_image *image);

typedef struct frame_queue frame_queue;
sherf_status frame_queue_create(context *c, int width, int height, int channels, frame_writer write,
                                void *user, frame_queue **out);
/* Waits for a free slot and returns its picture to fill. NULL: writing has failed; frame_queue_end says
 * why. */
sherf_image *frame_queue_slot(frame_queue *q);
void frame_queue_push(frame_queue *q); /* hands over the slot from the last frame_queue_slot */
/* Waits until all is written, stores the first failure in c, frees. */
sherf_status frame_queue_end(context *c, frame_queue *q);
#endif
