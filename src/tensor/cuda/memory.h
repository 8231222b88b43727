/* The CUDA runtime's part of the tensors' memory (memory.cu), implemented in runtime.cu. All of it belongs to
 * the one stream; nothing waits unless it says so. */
#ifndef SHERF_CUDA_MEMORY_H
#define SHERF_CUDA_MEMORY_H

#include "tensor/cuda/cuda.h"

namespace cuda_backend {

void *device_take(context *c, size_t bytes); /* NULL and message: out of memory */
void device_give(void *p);
void *pinned_take(size_t bytes); /* host memory that the GPU reads directly; NULL: none left */

enum copy_way { TO_DEVICE, TO_HOST, WITHIN };
sherf_status copy_begin(context *c, copy_way way, void *to, const void *from, size_t bytes);
sherf_status clear_begin(context *c, void *to, size_t bytes);
sherf_status wait_for_all(context *c);

/* A position in the stream that can be waited for. */
struct mark;
mark *mark_make();          /* NULL: failed */
void mark_set(mark *place); /* sets it to the current position */
void mark_wait(mark *place);

} // namespace cuda_backend
#endif
