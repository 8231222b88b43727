/* Several ways in which what was not seen may look. What the best guess is off by, over made people, is half
 * the light: one factor a person, 0.12 either way, explains 1.0 dB of it (docs/model-card.md). So light is
 * drawn, and with it from where patterns go on and how strongly.
 */
#include <math.h>

#include "avatar/detail.h"

static const float light_spread = 0.13f, light_max = 0.3f;
static const float pattern_min = 0.5f, pattern_max = 1.4f, source_min = 0.2f;

detail_variant variant_draw(uint64_t seed) {
    detail_variant v = {1, 1, 1, 1, 1};
    if (!seed) return v;
    const uint64_t key = random_key(seed, "variant", 0);
    const float light = light_spread * (float)random_normal(key, 0);
    v.light = 1 + fminf(fmaxf(light, -light_max), light_max);
    v.pattern = pattern_min + (pattern_max - pattern_min) * (float)random_uniform(key, 2);
    float *source[] = {&v.beside, &v.through, &v.across};
    for (int i = 0; i < 3; i++)
        *source[i] = source_min + (1 - source_min) * (float)random_uniform(key, 3 + (uint64_t)i);
    return v;
}

sherf_status sherf_avatar_choose(sherf_context *c, sherf_avatar *a, uint64_t variant) {
    if (a->form)
        return failure(c, SHERF_UNSUPPORTED, "a %s avatar keeps the variant that it was made of",
                       a->form->name);
    pthread_mutex_lock(&a->detail->lock);
    a->variant = variant;
    a->detail->made.variant = variant_draw(variant);
    pthread_mutex_unlock(&a->detail->lock);
    return SHERF_OK;
}

uint64_t sherf_avatar_variant(const sherf_avatar *a) {
    return a->variant;
}
