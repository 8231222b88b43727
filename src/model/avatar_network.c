/* Where an avatar's point network is: packed for the processor, or placed on the GPU of the context that the
 * avatar was made or loaded in. */
#include "model/model.h"

/* From the avatar's bank and weights. */
static sherf_status network_make(context *c, sherf_avatar *a, bool bf16) {
    point_sizes sizes;
    point_weights weights;
    model_point_sizes(&a->config, &sizes);
    model_point_weights(a->weights, &a->config, &weights);
    return point_network_create(c, &sizes, &weights, &a->bank, bf16, &a->network);
}

static sherf_status network_place(context *c, sherf_avatar *a, const body_model *body, bool bf16) {
    point_sizes sizes;
    point_weights weights;
    point_parts parts;
    model_point_sizes(&a->config, &sizes);
    model_point_weights(a->weights, &a->config, &weights);
    sherf_status status = point_parts_create(c, &sizes, &weights, &a->bank, &parts);
    if (status != SHERF_OK) return status;
    status = a->renderer->place(c, body, a->observed, &a->camera, &parts, bf16, &a->gpu);
    point_parts_free(&parts);
    return status;
}

sherf_status avatar_network_start(context *c, sherf_avatar *a, const body_model *body) {
    const bool bf16 = c->precision == SHERF_PRECISION_BF16;
    a->renderer = gpu_renderer_of(c);
    return a->renderer ? network_place(c, a, body, bf16) : network_make(c, a, bf16);
}

void avatar_network_free(sherf_avatar *a) {
    if (a->gpu) a->renderer->release(a->gpu);
    point_network_free(a->network);
}

sherf_status avatar_ask(context *c, const sherf_avatar *a, const point_set *points, float *rgb,
                        float *sigma) {
    if (!a->gpu) return point_network_run(c, a->network, points, rgb, sigma);
    sherf_avatar *own = (sherf_avatar *)a; /* avatars are on the heap */
    pthread_mutex_lock(&own->gpu_lock);
    sherf_status status = a->renderer->run(c, a->gpu, points, rgb, sigma);
    pthread_mutex_unlock(&own->gpu_lock);
    return status;
}

sherf_status avatar_host_network(context *c, const sherf_avatar *a, const point_network **out) {
    sherf_avatar *own = (sherf_avatar *)a;
    sherf_status status = SHERF_OK;
    pthread_mutex_lock(&own->gpu_lock);
    if (!a->network) status = network_make(c, own, c->precision == SHERF_PRECISION_BF16);
    pthread_mutex_unlock(&own->gpu_lock);
    *out = a->network;
    return status;
}

sherf_status avatar_render_gpu(context *c, const sherf_avatar *a, const posed_body *posed,
                               const sherf_camera *camera, const gpu_frame_options *options,
                               sherf_frame *frame) {
    sherf_avatar *own = (sherf_avatar *)a;
    if (!posed->joints)
        return failure(c, SHERF_MISMATCH, "the avatar is on a GPU, and the pose was made for the processor");
    pthread_mutex_lock(&own->gpu_lock);
    sherf_status status = a->renderer->render(c, a->gpu, posed, camera, options, frame);
    pthread_mutex_unlock(&own->gpu_lock);
    return status;
}
