/* Frames on a GPU: the interface of src/model/sherf/cuda for host code. An avatar's body, observation, bank
 * and weights are placed once; a frame sends a pose and a camera and gets the picture back, and nothing waits
 * for the host between. */
#ifndef SHERF_RADIANCE_GPU_H
#define SHERF_RADIANCE_GPU_H

#include "model/sherf/fused/parts.h"
#include "model/sherf/fused/train.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct gpu_avatar gpu_avatar;

/* Training in bf16: the fused radiance field, forwards and backwards, as train.h is on the processor.
 * All arrays lie in the device's memory: the bank's (which is merged, with images and grids), the weights'
 * and the gradients'; what is made lives until the tape is reset. Scratch is the tape's. */
typedef struct gpu_points gpu_points;
typedef struct {
    int64_t count;
    const float *canonical, *direction_canonical, *observed_px; /* as in point_set */
} gpu_point_set;
typedef struct {
    bool (*possible)(const radiance_sizes *s);
    sherf_status (*create)(tape *t, const radiance_sizes *sizes, const radiance_weights *weights,
                           const radiance_bank *bank, gpu_points **out);
    sherf_status (*run)(tape *t, const gpu_points *n, const gpu_point_set *points, float *rgb, float *sigma);
    /* As radiance_field_backward; the same bits every time. */
    sherf_status (*backward)(tape *t, const gpu_points *n, const gpu_point_set *points, const float *rgb,
                             const float *drgb, const float *dsigma, const radiance_gradients *out);
} gpu_point_training;

/* The functions of one device. Not for two threads at once with one avatar. */
typedef struct {
    const tensor_memory *memory;
    /* The result keeps no pointers to its arguments, only `m`'s sizes. */
    sherf_status (*place)(context *c, const body_model *body, const posed_body *observed,
                          const sherf_camera *observed_camera, const radiance_parts *network, bool bf16,
                          gpu_avatar **out);
    void (*release)(gpu_avatar *a);       /* NULL is fine */
    bool (*in_bf16)(const gpu_avatar *a); /* as it was created, where the kernel supports bf16 */
    size_t (*bytes)(const gpu_avatar *a); /* of the device's memory, so far */
    /* `posed` has joints (posed_joints_create). Does the work of points_create and radiance_field_render. */
    sherf_status (*render)(context *c, gpu_avatar *a, const posed_body *posed, const sherf_camera *camera,
                           const gpu_frame_options *options, sherf_frame *frame);
    /* The points that a frame is made of, for tests; free with points_free. */
    sherf_status (*points)(context *c, gpu_avatar *a, const posed_body *posed, const sherf_camera *camera,
                           const gpu_frame_options *options, point_set **out);
    /* As radiance_field_run: points, rgb and sigma are the host's. */
    sherf_status (*run)(context *c, gpu_avatar *a, const point_set *points, float *rgb, float *sigma);
    const gpu_point_training *training;
} gpu_renderer;

extern const gpu_renderer gpu_renderer_cuda;           /* in builds with SHERF_CUDA only */
const gpu_renderer *gpu_renderer_of(const context *c); /* of the context's device; NULL: the processor */
void gpu_renderer_stand_in(const gpu_renderer *r); /* for tests: what contexts of a GPU take from now on */

#ifdef __cplusplus
}
#endif
#endif
