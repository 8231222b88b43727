/* Hierarchical features, the pixel-aligned ones (section 3.3; network.md 1): a feature map of the picture and
 * its colours, read where points project to. body/deform.c maps them from canonical space to the observation
 * (network.md, "Canonical to observation"). */
#include "model/sherf/sherf.h"

void pixel_declare(declaration *d, const sherf_settings *k, pixel_stage *s) {
    s->frequencies = k->color_frequencies;
    s->color_width = 3 * k->token_width - k->feature_width; /* the paper's: 33 values, the last one dropped */
    resnet_declare(d, "encoder_2d_feature.backbone", 18, k->feature_width, 1, &s->encoder);
}

tensor *pixel_features(tape *t, const pixel_stage *s, tensor *image) {
    tensor *x = resnet_stem(t, &s->encoder, image); /* no max pooling */
    return tape_instead(t, resnet_stage(t, &s->encoder, 1, x), x);
}

/* (u / W (W_f - 1), v / H (H_f - 1)) */
static tensor *map_positions(tape *t, const float *position_px, int64_t count, const tensor *image,
                             const tensor *map) {
    float *p = tape_alloc(t, (size_t)count * 2, sizeof *p);
    if (!p) return NULL;
    float W = (float)image->dim[1], H = (float)image->dim[0];
    float right = (float)(map->dim[1] - 1), bottom = (float)(map->dim[0] - 1);
    for (int64_t i = 0; i < count; i++) {
        p[2 * i] = position_px[2 * i] / W * right;
        p[2 * i + 1] = position_px[2 * i + 1] / H * bottom;
    }
    return tape_input(t, p, 2, (int64_t[]){count, 2});
}

tensor *pixel_sample(tape *t, const pixel_stage *s, const model_bank *bank, const float *position_px,
                     int64_t count) {
    tensor *features = bank->tensor[BANK_FEATURES], *image = bank->tensor[BANK_IMAGE];
    if (!features || !image) return NULL;
    tensor *at = map_positions(t, position_px, count, image, features);
    tensor *feature = op_sample_bilinear(t, features, at);
    tensor *rgb = op_sample_bilinear(t, image, map_positions(t, position_px, count, image, image));
    tensor *color = op_positional_encode(t, rgb, s->frequencies, s->color_width);
    return op_concat(t, 2, (tensor *[]){feature, color});
}
