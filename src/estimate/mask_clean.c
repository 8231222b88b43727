/* mask_clean: pieces are found by filling; four neighbours make one. */
#include "estimate/mask_clean.h"

#include <math.h>
#include <string.h>

static const double piece_share = 0.03; /* of the largest: a foot cut off by a rail stays */
static const float hole_mask_px = 3, soft_mask_px = 5;

typedef struct {
    int width, height;
    uint8_t *side;   /* 1: value >= 1/2; 2 is added once a pixel has been visited */
    int32_t *filled; /* the pixels of the piece, also the queue of its filling */
} pieces;

typedef struct {
    int64_t count;
    double prior;
    bool at_border;
} piece;

/* Fills from `start`; p->filled holds the pixels then. */
static piece fill(const pieces *p, int32_t start, const float *prior) {
    const uint8_t side = p->side[start];
    piece out = {0};
    int64_t done = 0;
    p->filled[out.count++] = start;
    p->side[start] |= 2;
    while (done < out.count) {
        const int32_t at = p->filled[done++];
        const int x = at % p->width, y = at / p->width;
        const bool there[4] = {x > 0, x + 1 < p->width, y > 0, y + 1 < p->height};
        const int32_t next[4] = {at - 1, at + 1, at - p->width, at + p->width};
        out.prior += prior[at];
        for (int i = 0; i < 4; i++) {
            if (!there[i]) out.at_border = true;
            if (!there[i] || p->side[next[i]] != side) continue;
            p->side[next[i]] |= 2;
            p->filled[out.count++] = next[i];
        }
    }
    return out;
}

static void split(pieces *p, const float *value) {
    const size_t n = (size_t)p->width * p->height;
    for (size_t i = 0; i < n; i++) p->side[i] = value[i] >= 0.5f;
}

static void holes_fill(pieces *p, const float *prior, float mask_px, float *value) {
    const double small = hole_mask_px * mask_px * hole_mask_px * mask_px;
    split(p, value);
    for (int32_t i = 0; i < p->width * p->height; i++) {
        if (p->side[i] != 0) continue;
        const piece hole = fill(p, i, prior);
        if (hole.at_border || (hole.count > small && hole.prior < 0.5 * (double)hole.count)) continue;
        for (int64_t k = 0; k < hole.count; k++) value[p->filled[k]] = 1;
    }
}

static void islands_drop(pieces *p, const float *prior, float *value) {
    int64_t largest = 0;
    split(p, value);
    for (int32_t i = 0; i < p->width * p->height; i++)
        if (p->side[i] == 1) {
            const piece one = fill(p, i, prior);
            if (one.count > largest) largest = one.count;
        }
    split(p, value);
    for (int32_t i = 0; i < p->width * p->height; i++) {
        if (p->side[i] != 1) continue;
        const piece one = fill(p, i, prior);
        if ((double)one.count >= piece_share * (double)largest) continue;
        for (int64_t k = 0; k < one.count; k++) value[p->filled[k]] = 0;
    }
}

/* Walks along rows and columns from the pieces through the soft pixels that belong to them. */
static void far_drop(pieces *p, float mask_px, float *value) {
    const int32_t n = p->width * p->height, reach = (int32_t)ceilf(soft_mask_px * mask_px);
    int64_t end = 0, done = 0;
    split(p, value);
    for (int32_t i = 0; i < n; i++)
        if (p->side[i]) p->filled[end++] = i;
    for (int32_t step = 0; step < reach; step++) {
        const int64_t ring = end;
        for (; done < ring; done++) {
            const int32_t at = p->filled[done];
            const int x = at % p->width, y = at / p->width;
            const bool there[4] = {x > 0, x + 1 < p->width, y > 0, y + 1 < p->height};
            const int32_t next[4] = {at - 1, at + 1, at - p->width, at + p->width};
            for (int i = 0; i < 4; i++)
                if (there[i] && !p->side[next[i]]) p->side[next[i]] = 1, p->filled[end++] = next[i];
        }
    }
    for (int32_t i = 0; i < n; i++)
        if (!p->side[i]) value[i] = 0;
}

sherf_status mask_clean(context *c, int width, int height, const float *prior, float mask_px, float *value) {
    const size_t n = (size_t)width * height;
    pieces p = {width, height, mem_alloc(c, n, 1), mem_alloc(c, n, sizeof(int32_t))};
    const bool there = p.side && p.filled;
    if (there) {
        islands_drop(&p, prior, value);
        holes_fill(&p, prior, mask_px, value);
        far_drop(&p, mask_px, value);
    }
    mem_free(p.side);
    mem_free(p.filled);
    return there ? SHERF_OK : SHERF_NO_MEMORY;
}
