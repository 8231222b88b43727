/* The terms of the loss, on the tape. */
#include <math.h>
#include <string.h>

#include "tensor/block.h"
#include "train/losses.h"

enum { SSIM_WINDOW = 11 };
static const float weight_color = 100, weight_mask = 10; /* of SSIM and LPIPS: 1 */

/* The rays in the loss, as a row mask, and the bounding rectangle of those at the box; NULL when there are
 * none. */
static tensor *selected(tape *t, const loss_target *g, bool by_box, shift_scale_attr *rectangle) {
    int64_t N = (int64_t)g->width * g->height;
    int64_t left = g->width, right = -1, top = g->height, bottom = -1;
    int32_t *rows = tape_alloc(t, (size_t)N, sizeof *rows);
    if (!rows) return NULL;
    for (int64_t i = 0; i < N; i++) {
        rows[i] = (!by_box || g->at_box[i]) && !(g->unknown && g->unknown[i]);
        if (!g->at_box[i]) continue;
        int64_t x = i % g->width, y = i / g->width;
        if (x < left) left = x;
        if (x > right) right = x;
        if (y < top) top = y;
        bottom = y;
    }
    if (right < 0) return NULL;
    *rectangle = (shift_scale_attr){.scale = {1, 1, 1, 1},
                                    .left = left,
                                    .top = top,
                                    .width = right - left + 1,
                                    .height = bottom - top + 1};
    return tape_input_i32(t, rows, 1, &N);
}

static tensor *mask_column(tape *t, const loss_target *g) {
    int64_t shape[2] = {(int64_t)g->width * g->height, 1};
    float *mask = tape_alloc(t, (size_t)shape[0], sizeof *mask);
    if (!mask) return NULL;
    for (int64_t i = 0; i < shape[0]; i++) mask[i] = g->mask[i] != 0;
    return tape_input(t, mask, 2, shape);
}

/* [N, 3], the picture before the background. */
static tensor *truth_column(tape *t, const loss_target *g) {
    const int64_t shape[2] = {(int64_t)g->width * g->height, 3};
    if (g->background == 0) return tape_input(t, g->image, 2, shape);
    float *rgb = tape_alloc(t, (size_t)shape[0] * 3, sizeof *rgb);
    if (!rgb) return NULL;
    for (int64_t i = 0; i < 3 * shape[0]; i++) rgb[i] = g->mask[i / 3] ? g->image[i] : g->background;
    return tape_input(t, rgb, 2, shape);
}

/* [N, 3] -> [height, width, 3] of the rectangle; unknown pixels are black on both sides. */
static tensor *cropped(tape *t, const loss_target *g, tensor *rgb, tensor *known, const shift_scale_attr *r) {
    if (g->unknown) rgb = op_mask_rows(t, rgb, known);
    return op_shift_scale(t, tape_reshape(t, rgb, 3, (int64_t[]){g->height, g->width, 3}), r);
}

static tensor *sum(tape *t, tensor *a, tensor *b, float factor) {
    if (!a) return op_scale(t, b, factor);
    return op_add(t, a, factor == 1 ? b : op_scale(t, b, factor));
}

sherf_status losses_parse(context *c, const char *list, unsigned *out) {
    static const char *const name[] = {"color", "mask", "ssim", "perceptual"};
    *out = 0;
    for (const char *p = list ? list : ""; *p;) {
        const size_t length = strcspn(p, ",");
        int k = 0;
        while (k < (int)COUNT_OF(name) && (strlen(name[k]) != length || strncmp(name[k], p, length))) k++;
        if (k == (int)COUNT_OF(name))
            return failure(c, SHERF_BAD_ARGUMENT,
                           "the losses are color, mask, ssim and perceptual, not '%.*s'", (int)length, p);
        *out |= 1u << k;
        p += length + (p[length] == ',');
    }
    if (*out != LOSS_ALL) return SHERF_OK;
    return failure(c, SHERF_BAD_ARGUMENT, "'%s' leaves no loss to train with", list);
}

/* Mean squared colour of both passes, and mask. */
static tensor *total_of_recipe(tape *t, const loss_target *g, tensor *color, tensor *mask, tensor *truth,
                               tensor *rows) {
    if (g->coarse) color = op_add(t, color, op_mean_square(t, op_slice(t, g->coarse, 0, 3), truth, rows));
    return g->recipe->mask_weight > 0 ? sum(t, color, mask, g->recipe->mask_weight) : color;
}

sherf_status losses_forward(tape *t, const loss_networks *networks, tensor *frame, const loss_target *g,
                            loss_tensors *out) {
    shift_scale_attr r = {.scale = {0}};
    tensor *ssim = NULL, *lpips = NULL, *resnet50 = NULL;
    const loss_networks none = {0}, *n = networks ? networks : &none;
    *out = (loss_tensors){NULL};
    tensor *rows = selected(t, g, true, &r);
    if (!rows) return tape_status(t);
    tensor *rgb = op_slice(t, frame, 0, 3), *truth = truth_column(t, g);
    tensor *color = op_mean_square(t, rgb, truth, rows);
    tensor *mask = op_mean_square(t, op_slice(t, frame, 3, 1), mask_column(t, g), rows);
    if (g->recipe) {
        *out = (loss_tensors){
            .total = total_of_recipe(t, g, color, mask, truth, rows), .color = color, .mask = mask};
        return tape_status(t);
    }
    tensor *loss = NULL;
    if (!(n->without & LOSS_COLOR)) loss = sum(t, loss, color, weight_color);
    if (!(n->without & LOSS_MASK)) loss = sum(t, loss, mask, weight_mask);
    if (r.width >= SSIM_WINDOW && r.height >= SSIM_WINDOW) {
        const bool perceptual = !(n->without & LOSS_PERCEPTUAL);
        tensor *known = g->unknown ? selected(t, g, false, &r) : NULL;
        tensor *a = cropped(t, g, rgb, known, &r), *b = cropped(t, g, truth, known, &r);
        if (!(n->without & LOSS_SSIM)) loss = sum(t, loss, ssim = op_ssim(t, a, b), -1);
        if (perceptual && n->lpips && r.width >= LPIPS_SIDE_MIN && r.height >= LPIPS_SIDE_MIN) {
            lpips = lpips_distance(t, n->lpips, a, b);
            loss = sum(t, loss, lpips, 1);
        }
        if (perceptual && n->resnet50 && r.width >= RESNET50_SIDE_MIN && r.height >= RESNET50_SIDE_MIN) {
            resnet50 = resnet50_distance(t, n->resnet50, a, b);
            double weight = n->resnet50_weight > 0 ? n->resnet50_weight : losses_resnet50_weight;
            loss = sum(t, loss, resnet50, (float)weight);
        }
    }
    *out = (loss_tensors){loss, color, mask, ssim, lpips, resnet50};
    return tape_status(t);
}

sherf_status losses_store(tape *t, const loss_tensors *l, float *row) {
    const tensor *const one[LOSSES] = {l->total, l->color, l->mask, l->ssim, l->lpips, l->resnet50};
    const tensor_memory *memory = tape_backend(t)->memory;
    const float base = l->total ? NAN : 0;
    const float plain[LOSSES] = {base, base, base, NAN, NAN, NAN};
    sherf_status status = block_upload(tape_context(t), memory, row, plain, sizeof plain);
    for (int i = 0; i < LOSSES && status == SHERF_OK; i++)
        if (one[i]) status = block_copy(tape_context(t), memory, row + i, one[i]->data, sizeof *row);
    return status;
}

loss_values losses_values(const float row[LOSSES]) {
    const double total = (double)row[0] + (isnan(row[3]) ? 0 : 1);
    return (loss_values){total, row[1], row[2], row[3], row[4], row[5]};
}
