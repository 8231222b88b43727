#include "train/trainer.h"

sherf_status image_gradients(tape *t, const model *m, const body_model *body, const loss_networks *networks,
                             const sample *s, double scale, loss_values *values) {
    model_bank bank;
    tensor *frame, *total;
    tape_reset(t);
    sherf_status status = model_encode(t, m, body, s->observation_geometry, &bank, NULL);
    if (status == SHERF_OK)
        status = model_frame(t, m, body, s->observation_geometry, &bank, s->target_geometry, 0,
                             s->drawn.noise_key, &frame);
    if (status != SHERF_OK) return status;
    const loss_target target = {.width = s->target->image.width,
                                .height = s->target->image.height,
                                .image = s->target->image.data,
                                .mask = s->target->mask,
                                .unknown = s->target->unknown,
                                .at_box = s->target_geometry->rays->at_box};
    status = losses_forward(t, networks, frame, &target, &total, values);
    if (status != SHERF_OK || !total) return status;
    return tape_backward(t, total, scale);
}
