/* Looks canonical points up in the observation's pictures: what to add to the colour of a seen point, and
 * what the opposite side lends to an unseen one (detail_carry.c). */
#include <math.h>
#include <string.h>

#include "avatar/detail.h"

/* How far a point may be behind the observed view's surface, and in front of it: its weight falls from the
 * first number on and is 0 at the second. */
static const float behind_m[2] = {0.03f, 0.06f}, before_m[2] = {0.03f, 0.07f};
/* How far an unseen colour moves towards the opposite side's, and how much of that side's pattern it takes.
 * Chosen on synthetic people (docs/model-card.md). */
static const float toward_share = 0.5f, pattern_share = 0.6f;
enum { SOME = 64 };

/* The four texels round a place and their weights. false: the place is outside the picture. */
typedef struct {
    const detail_texel *texel[4];
    float share[4];
} four;
static bool four_at(const detail_view *d, const float px[2], float depth, four *out) {
    if (!(px[0] >= 0 && px[1] >= 0 && px[0] < (float)(d->width - 1) && px[1] < (float)(d->height - 1)))
        return false;
    const int x = (int)px[0], y = (int)px[1];
    const float fx = px[0] - (float)x, fy = px[1] - (float)y;
    for (int i = 0; i < 4; i++) {
        out->texel[i] = d->texel + (size_t)(y + i / 2) * (size_t)d->width + (size_t)(x + i % 2);
        out->share[i] = (i % 2 ? fx : 1 - fx) * (i / 2 ? fy : 1 - fy);
    }
    return depth > 0;
}

static float in_depth(const detail_texel *t, float depth) {
    return (1 - detail_rise(depth - t->depth, behind_m)) * (1 - detail_rise(t->depth - depth, before_m));
}

/* ---- seen points ---- */

static float seen_at(const detail_view *d, const float px[2], float depth, float add[3]) {
    float seen = 0;
    four f;
    memset(add, 0, 3 * sizeof *add);
    if (!four_at(d, px, depth, &f)) return 0;
    for (int i = 0; i < 4; i++) {
        const detail_texel *t = f.texel[i];
        for (int k = 0; k < 3; k++) add[k] += f.share[i] * t->weight * t->difference[k];
        if (t->weight > 0) seen += f.share[i] * in_depth(t, depth);
    }
    return seen;
}

/* A mean over the pictures; the one that sees the point best has the largest weight. */
static void look_up_seen(const avatar_detail *d, const body_model *body, int64_t count,
                         const float *points_canonical, const int32_t *nearest, detail_gift *out) {
    float world[3 * SOME], px[2 * SOME], depth[SOME], sum[SOME] = {0};
    for (int v = 0; v < d->views; v++) {
        const detail_view *view = &d->view[v];
        deform_from_canonical(body, view->posed, count, points_canonical, nearest, world);
        camera_project(&view->camera, count, world, px, depth);
        for (int64_t i = 0; i < count; i++) {
            float add[3];
            if (nearest[i] < 0) continue;
            const float s = seen_at(view, px + 2 * i, depth[i], add) *
                            detail_seen_near(view, body, points_canonical + 3 * i, nearest[i]);
            const float weight = d->views > 1 ? s * s : 1;
            sum[i] += weight;
            out[i].seen += weight * s;
            for (int k = 0; k < 3; k++) out[i].add[k] += weight * s * add[k];
        }
    }
    for (int64_t i = 0; i < count; i++) {
        for (int k = 0; k < 3 && out[i].seen > 0; k++) out[i].add[k] /= out[i].seen;
        if (sum[i] > 0) out[i].seen /= sum[i];
    }
}

/* ---- the opposite side ---- */

/* The colour around a place, the pattern on it, and how far to trust both. */
static float lent_at(const detail_view *d, const float px[2], float depth, float color[3], float pattern[3]) {
    float trust = 0;
    four f;
    for (int k = 0; k < 3; k++) color[k] = pattern[k] = 0;
    if (!four_at(d, px, depth, &f)) return 0;
    for (int i = 0; i < 4; i++) {
        const detail_texel *t = f.texel[i];
        const float share = f.share[i] * t->weight * in_depth(t, depth);
        for (int k = 0; k < 3; k++) color[k] += share * t->color[k], pattern[k] += share * t->pattern[k];
        trust += share;
    }
    for (int k = 0; k < 3 && trust > 0; k++) color[k] /= trust, pattern[k] /= trust;
    return trust;
}

static void look_up_lent(const avatar_detail *d, const body_model *body, const float x[3], int32_t nearest,
                         detail_gift *out) {
    carry_place from[CARRY_PLACES];
    float sum = 0;
    const int places = carry_places(&d->carry, &d->variant, body, x, nearest, from);
    for (int i = 0; i < places * d->views; i++) {
        const detail_view *view = &d->view[i / places];
        const carry_place *p = &from[i % places];
        float world[3], px[2], depth, color[3], pattern[3];
        deform_from_canonical(body, view->posed, 1, p->x, &p->nearest, world);
        camera_project(&view->camera, 1, world, px, &depth);
        const float trust = lent_at(view, px, depth, color, pattern);
        if (!(trust > 0)) continue;
        const float s = trust * p->sure * detail_seen_near(view, body, p->x, p->nearest),
                    weight = p->prefer * s * s;
        sum += weight;
        out->lent += weight * s;
        for (int k = 0; k < 3; k++) {
            out->toward[k] += weight * color[k];
            out->pattern[k] += weight * view->patterned[p->nearest] * pattern[k];
        }
    }
    if (!(sum > 0)) return;
    out->lent *= (1 - out->seen) / sum;
    for (int k = 0; k < 3; k++) out->toward[k] /= sum, out->pattern[k] /= sum;
}

void detail_look_up(const avatar_detail *d, const body_model *body, int64_t n, const float *points_canonical,
                    const int32_t *nearest, detail_gift *out) {
    memset(out, 0, (size_t)n * sizeof *out);
    for (int64_t b = 0; b < n; b += SOME)
        look_up_seen(d, body, n - b < SOME ? n - b : SOME, points_canonical + 3 * b, nearest + b, out + b);
    for (int64_t i = 0; i < n && d->carry.opposite; i++)
        if (nearest[i] >= 0 && out[i].seen < 1)
            look_up_lent(d, body, points_canonical + 3 * i, nearest[i], &out[i]);
}

void detail_give(const avatar_detail *d, const detail_gift *g, float seen, float lent, float hidden,
                 float rgb[3]) {
    const float light = 1 + hidden * (d->variant.light - 1);
    lent = fminf(lent, 2 * g->lent); /* smoothing may have raised it where there is no colour to take */
    for (int k = 0; k < 3; k++) {
        const float take =
            toward_share * (g->toward[k] - rgb[k]) + pattern_share * d->variant.pattern * g->pattern[k];
        rgb[k] = fminf(fmaxf(light * (rgb[k] + seen * g->add[k] + lent * take), 0), 1);
    }
}
