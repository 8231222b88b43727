/* Projects canonical points into the observed picture, through the observed pose and its camera, and queries
 * them in batches. */
#include "avatar/canonical.h"

void canonical_observe(const sherf_avatar *a, const body_model *body, int64_t n,
                       const float *points_canonical, const int32_t *nearest, float *observed_px) {
    enum { SOME = 256 };
    float world[3 * SOME];
    for (int64_t b = 0; b < n; b += SOME) {
        const int64_t count = n - b < SOME ? n - b : SOME;
        deform_to_picture(body, a->sheet.body, count, points_canonical + 3 * b, nearest + b, world);
        camera_project(&a->sheet.camera, count, world, observed_px + 2 * b, NULL);
    }
}

sherf_status canonical_batch_make(context *c, size_t points, canonical_batch *b) {
    *b = (canonical_batch){0};
    b->set.canonical = mem_alloc(c, points, 3 * sizeof(float));
    b->set.direction_canonical = mem_zero(c, points, 3 * sizeof(float));
    b->set.observed_px = mem_alloc(c, points, 2 * sizeof(float));
    b->nearest = mem_alloc(c, points, sizeof *b->nearest);
    b->rgb = mem_alloc(c, points, 3 * sizeof(float));
    b->sigma = mem_alloc(c, points, sizeof(float));
    const bool good = b->set.canonical && b->set.direction_canonical && b->set.observed_px && b->nearest &&
                      b->rgb && b->sigma;
    return good ? SHERF_OK : SHERF_NO_MEMORY;
}

void canonical_batch_free(canonical_batch *b) {
    mem_free(b->set.canonical);
    mem_free(b->set.direction_canonical);
    mem_free(b->set.observed_px);
    mem_free(b->nearest);
    mem_free(b->rgb);
    mem_free(b->sigma);
}

typedef struct {
    const sherf_avatar *a;
    const body_model *body;
    const canonical_batch *b;
} observe_job;

static void observe_range(void *arg, int64_t begin, int64_t end, int thread) {
    const observe_job *j = arg;
    canonical_observe(j->a, j->body, end - begin, j->b->set.canonical + 3 * begin, j->b->nearest + begin,
                      j->b->set.observed_px + 2 * begin);
}

sherf_status canonical_batch_run(context *c, const sherf_avatar *a, const body_model *body,
                                 canonical_batch *b) {
    observe_job job = {a, body, b};
    sherf_status status = model_needs_canonical(c, &a->config);
    if (status != SHERF_OK) return status;
    parallel_for(c, b->set.count, 1024, observe_range, &job);
    return avatar_query(c, a, body, &b->set, b->rgb, b->sigma);
}
