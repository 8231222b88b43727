/* Variants: several plausible looks of unseen parts. The best guess errs most in brightness: one factor
 * per person, 0.12 either way on synthetic people, makes up 1.0 dB of its error (docs/model-card.md). So a
 * variant draws the brightness of unseen parts, the places that patterns continue from, and their strength.
 */
#include <math.h>

#include "avatar/detail.h"

static const float light_max = 0.1f, pattern_min = 1.1f, pattern_max = 1.7f, source_min = 0.05f;

/* Consecutive seeds give values far apart: steps of the golden ratio round the unit interval. */
static float spread_out(uint64_t seed) {
    return (float)((double)(seed * 0x9e3779b97f4a7c15u >> 11) * 0x1p-53);
}

detail_variant variant_draw(uint64_t seed) {
    detail_variant v = {1, 1, 1, 1, 1};
    if (!seed) return v;
    const uint64_t key = random_key(seed, "variant", 0);
    float *source[] = {&v.beside, &v.through, &v.across};
    v.light = 1 + light_max * (2 * spread_out(seed) - 1);
    v.pattern = pattern_min + (pattern_max - pattern_min) * (float)random_uniform(key, 0);
    for (uint64_t i = 0; i < 3; i++)
        *source[i] = source_min + (1 - source_min) * (float)random_uniform(key, 1 + i);
    return v;
}

sherf_status sherf_avatar_choose(sherf_context *c, sherf_avatar *a, uint64_t variant) {
    if (a->form)
        return avatar_named(
            c, a,
            failure(c, SHERF_UNSUPPORTED, "a %s avatar keeps the variant it was made with", a->form->name));
    pthread_mutex_lock(&a->detail->lock);
    a->variant = variant;
    a->detail->made.variant = variant_draw(variant);
    pthread_mutex_unlock(&a->detail->lock);
    return SHERF_OK;
}

uint64_t sherf_avatar_variant(const sherf_avatar *a) {
    return a->variant;
}
