/* Computes losses and their values at once, on the device of the tape. */
#ifndef TEST_LOSSES_OF_H
#define TEST_LOSSES_OF_H

#include "tensor/block.h"
#include "train/losses.h"

static inline sherf_status losses_of(tape *t, const loss_networks *networks, tensor *frame,
                                     const loss_target *target, tensor **total, loss_values *values) {
    const tensor_memory *memory = tape_backend(t)->memory;
    context *c = tape_context(t);
    loss_tensors l;
    float row[LOSSES];
    *total = NULL;
    *values = (loss_values){0};
    float *there = block_take(c, memory, LOSSES, sizeof *there);
    sherf_status status = there ? losses_forward(t, networks, frame, target, &l) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = losses_store(t, &l, there);
    if (status == SHERF_OK) status = block_download(c, memory, row, there, sizeof row);
    block_give(memory, there);
    if (status != SHERF_OK) return status;
    *total = l.total;
    *values = losses_values(row);
    return SHERF_OK;
}

#endif
