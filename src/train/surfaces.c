/* Points and places of a person's surface, drawn for a sample. */
#include "train/surfaces.h"

#include "data/surface_truth.h"

static const double place_deviation_m = 0.001;

void surface_draw_free(surface_draw *s) {
    mem_free(s->point);
    mem_free(s->inside);
    mem_free(s->place);
    mem_free(s->color);
    *s = (surface_draw){0};
}

sherf_status surface_draw_room(context *c, int64_t count, surface_draw *s) {
    const size_t n = (size_t)count;
    *s = (surface_draw){count,
                        count,
                        mem_alloc(c, n, 3 * sizeof(float)),
                        mem_alloc(c, n, sizeof(float)),
                        mem_alloc(c, n, 3 * sizeof(float)),
                        mem_alloc(c, n, 3 * sizeof(float))};
    if (s->point && s->inside && s->place && s->color) return SHERF_OK;
    surface_draw_free(s);
    return SHERF_NO_MEMORY;
}

/* The numbers of the points that are inside come first, then the others'. */
static int64_t sorted(const surface_truth *t, int32_t *number) {
    int64_t inside = 0, outside = 0;
    for (int64_t i = 0; i < t->points; i++) inside += t->inside[i];
    for (int64_t i = 0, k = 0; i < t->points; i++)
        number[t->inside[i] ? k++ : inside + outside++] = (int32_t)i;
    return inside;
}

static void points_take(const surface_truth *t, const int32_t *number, int64_t inside, uint64_t key,
                        surface_draw *s) {
    for (int64_t i = 0; i < s->points; i++) {
        const bool in = i < s->points / 2;
        const int64_t from = in ? 0 : inside, range = in ? inside : t->points - inside;
        const int32_t n = number[from + random_below(key, (uint64_t)i, range)];
        for (int k = 0; k < 3; k++) s->point[3 * i + k] = t->point[3 * n + k];
        s->inside[i] = in;
    }
}

static void places_take(const surface_truth *t, uint64_t key, surface_draw *s) {
    const uint64_t off = splitmix64(key);
    for (int64_t i = 0; i < s->places; i++) {
        const int64_t n = random_below(key, (uint64_t)i, t->places);
        const float by = (float)(place_deviation_m * random_normal(off, (uint64_t)i));
        for (int k = 0; k < 3; k++) {
            s->place[3 * i + k] = t->place[3 * n + k] + by * t->normal[3 * n + k];
            s->color[3 * i + k] = (float)t->color[3 * n + k] / 255;
        }
    }
}

sherf_status surface_draw_create(context *c, const sherf_dataset *d, int person, int pose, int64_t count,
                                 uint64_t key, surface_draw *out) {
    surface_truth t;
    *out = (surface_draw){0};
    sherf_status status = surface_truth_load(c, d, person, pose, TRUTH_SAMPLES, &t);
    if (status != SHERF_OK) return status;
    int32_t *number = mem_alloc(c, (size_t)t.points, sizeof *number);
    status = number ? surface_draw_room(c, count, out) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        points_take(&t, number, sorted(&t, number), random_key(key, "surface.points", 0), out);
        places_take(&t, random_key(key, "surface.places", 0), out);
    }
    mem_free(number);
    surface_truth_free(&t);
    return status;
}

sherf_status surfaces_are_there(context *c, const sherf_dataset *d, const sampling *s) {
    char path[PATH_LENGTH];
    sherf_status status = SHERF_OK;
    for (int i = 0; i < s->people && status == SHERF_OK; i++)
        for (int p = 0; p < s->poses[i] && status == SHERF_OK; p++)
            status = surface_truth_find(c, d, s->person[i], p * s->pose_step, path);
    return status;
}
