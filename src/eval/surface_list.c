/* An avatar's triangles against the person's, and means over observations. */
#include "eval/surface_list.h"

#include <math.h>

#include "data/surface_truth.h"

enum { PLACES = 5000, TRIANGLES_MIN = 4 };
static const float cell_m = 0.008f;

void surface_list_free(surface_list *l) {
    mem_free(l->entry);
    *l = (surface_list){0};
}

static sherf_status add(context *c, surface_list *l, const surface_entry *e) {
    if (l->count == l->capacity) {
        const int64_t capacity = l->capacity ? 2 * l->capacity : 64;
        surface_entry *grown = mem_grow(c, l->entry, (size_t)l->count, (size_t)capacity, sizeof *grown);
        if (!grown) return SHERF_NO_MEMORY;
        l->entry = grown;
        l->capacity = capacity;
    }
    l->entry[l->count++] = *e;
    return SHERF_OK;
}

sherf_status surface_list_measure(context *c, surface_list *l, const sherf_dataset *d,
                                  const sherf_avatar *avatar, int person, picture observation) {
    surface_truth t;
    surface_entry e = {.person = person, .observation = observation};
    if (!avatar->field_kind || !avatar->field_kind->surface ||
        !surface_truth_is_there(c, d, person, observation.pose))
        return SHERF_OK;
    const solid_mesh found = avatar->field_kind->surface(avatar->field);
    if (found.triangles < TRIANGLES_MIN) {
        l->missed++;
        return SHERF_OK;
    }
    sherf_status status = surface_truth_load(c, d, person, observation.pose, TRUTH_MESH, &t);
    if (status != SHERF_OK) return status;
    const solid_mesh truth = {t.vertices, t.triangles, t.vertex, t.triangle};
    const uint64_t key = random_key((uint64_t)person, "eval.surface", (uint64_t)observation.pose);
    status = surfaces_compare(c, PLACES, key, cell_m, 1, &found, 1, &truth, &e.scores);
    surface_truth_free(&t);
    return status == SHERF_OK ? add(c, l, &e) : status;
}

surface_scores surface_list_mean(const surface_list *l, int person, int64_t *count) {
    surface_scores s = {0};
    *count = 0;
    for (int64_t i = 0; i < l->count; i++) {
        const surface_scores *one = &l->entry[i].scores;
        if (person >= 0 && l->entry[i].person != person) continue;
        s.to_truth_m += one->to_truth_m;
        s.from_truth_m += one->from_truth_m;
        s.chamfer_m += one->chamfer_m;
        s.normal_deg += one->normal_deg;
        ++*count;
    }
    const double n = *count ? (double)*count : NAN;
    return (surface_scores){s.to_truth_m / n, s.from_truth_m / n, s.chamfer_m / n, s.normal_deg / n};
}

char *surface_list_text(context *c, const surface_list *l) {
    int64_t n;
    const surface_scores s = surface_list_mean(l, -1, &n);
    if (!n) return mem_format(c, "surfaces: nothing came out of %lld observations\n", (long long)l->missed);
    return mem_format(
        c,
        "surfaces of %lld observations: Chamfer %.2f cm (to the truth %.2f, from it %.2f), normals "
        "%.1f degrees; nothing came out of %lld\n",
        (long long)n, 100 * s.chamfer_m, 100 * s.to_truth_m, 100 * s.from_truth_m, s.normal_deg,
        (long long)l->missed);
}
