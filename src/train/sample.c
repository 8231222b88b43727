/* One sample: its targets' frames and their losses. */
#include "tensor/block.h"
#include "train/trainer.h"

/* One target's frame from the encoded observation, and its losses, whose total is NULL where no ray meets
 * the box. */
static sherf_status target_losses(tape *t, const model *m, const body_model *body,
                                  const loss_networks *networks, const observation_geometry *observation,
                                  model_bank *bank, const data_view *view, const target_geometry *geometry,
                                  float background, uint64_t noise_key, loss_tensors *losses) {
    tensor *frame;
    sherf_status status = model_frame(t, m, body, observation, bank, geometry, background, noise_key, &frame);
    if (status != SHERF_OK) return status;
    const loss_target target = {.width = view->image.width,
                                .height = view->image.height,
                                .image = view->image.data,
                                .mask = view->mask,
                                .unknown = view->unknown,
                                .at_box = geometry->rays->at_box,
                                .background = background,
                                .recipe = model_recipe(&m->config),
                                .coarse = bank->coarse};
    return losses_forward(t, networks, frame, &target, losses);
}

/* As if all that was to be inside were the mask. */
static sherf_status surface_gradients(tape *t, const model *m, const sample *s, const model_bank *bank,
                                      double scale, float *rows) {
    loss_tensors l = {NULL};
    sherf_status status =
        m->config.kind->surfaces->losses(t, m, s->observation_geometry, bank, &s->surface, &l.mask, &l.color);
    if (status != SHERF_OK) return status;
    l.total = op_add(t, l.mask, l.color);
    status = l.total ? losses_store(t, &l, rows) : tape_status(t);
    return status == SHERF_OK ? tape_backward(t, l.total, scale) : status;
}

sherf_status sample_gradients(tape *t, const model *m, const body_model *body, const loss_networks *networks,
                              const sample *s, double scale, float *rows) {
    model_bank bank;
    tensor *total = NULL;
    tape_reset(t);
    sherf_status status = model_encode(t, m, body, s->observation_geometry, &bank);
    if (status == SHERF_OK && m->config.kind->surfaces) return surface_gradients(t, m, s, &bank, scale, rows);
    for (int k = 0; k <= s->drawn.further && status == SHERF_OK; k++) {
        const data_view *view = k ? s->more[k - 1].target : s->target;
        const target_geometry *geometry = k ? s->more[k - 1].geometry : s->target_geometry;
        const uint64_t noise = k ? splitmix64(s->drawn.noise_key + (uint64_t)k) | 1 : s->drawn.noise_key;
        loss_tensors one;
        status = target_losses(t, m, body, networks, s->observation_geometry, &bank, view, geometry,
                               s->drawn.background[k], noise, &one);
        if (status == SHERF_OK) status = losses_store(t, &one, rows + (size_t)k * LOSSES);
        if (status != SHERF_OK) return status;
        if (one.total) total = total ? op_add(t, total, one.total) : one.total;
    }
    if (status != SHERF_OK || !total) return status;
    return tape_backward(t, total, scale / (1 + s->drawn.further));
}
