/* What the tensors' memory is made of (memory.cu): the CUDA runtime's part, of runtime.cu. All of it belongs
 * to the one stream; nothing waits that does not say so. */
#ifndef SHERF_CUDA_MEMORY_H
#define SHERF_CUDA_MEMORY_H

#include "tensor/cuda/cuda.h"

namespace cuda_backend {

void *device_take(context *c, size_t bytes); /* NULL and message on lack */
void device_give(void *p);
void *pinned_take(size_t bytes); /* memory of the host that the GPU reads by itself; NULL: none is left */

enum copy_way { TO_DEVICE, TO_HOST, WITHIN };
sherf_status copy_begin(context *c, copy_way way, void *to, const void *from, size_t bytes);
sherf_status clear_begin(context *c, void *to, size_t bytes);
sherf_status wait_for_all(context *c);

/* A place in the stream's order, to be waited for. */
struct mark;
mark *mark_make();          /* NULL: it cannot be */
void mark_set(mark *place); /* here, anew */
void mark_wait(mark *place);

} // namespace cuda_backend
#endif
