/* An avatar's triangles against the person's, and means over observations. */
#include "eval/surface_list.h"

#include <math.h>

#include "baked/form.h"
#include "baked/person.h"
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

static bool has_surface(const sherf_avatar *a) {
    return a->form == &baked_avatar_form || (a->field_kind && a->field_kind->surface);
}

/* The avatar's surface in the observed pose; *room, which may hold its vertices, is mem_free'd, whatever the
 * answer. */
static sherf_status surface_of(context *c, const sherf_avatar *a, const body_model *body, float **room,
                               solid_mesh *out) {
    *room = NULL;
    if (a->form != &baked_avatar_form) {
        *out = a->field_kind->surface(a->field);
        return SHERF_OK;
    }
    const baked_form *f = a->formed;
    *room = mem_alloc(c, (size_t)f->corners, 3 * sizeof **room);
    if (!*room) return SHERF_NO_MEMORY;
    *out = (solid_mesh){f->corners, f->triangles, *room, f->triangle};
    return baked_places(c, f, body, sherf_avatar_pose(a), *room);
}

static sherf_status compare(context *c, const sherf_dataset *d, const solid_mesh *found, surface_entry *e) {
    surface_truth t;
    sherf_status status =
        surface_truth_load(c, d, e->person, e->observation.pose, TRUTH_MESH | TRUTH_SAMPLES, &t);
    if (status != SHERF_OK) return status;
    const solid_mesh truth = {t.vertices, t.triangles, t.vertex, t.triangle};
    const uint64_t key = random_key((uint64_t)e->person, "eval.surface", (uint64_t)e->observation.pose);
    status = surfaces_compare(c, PLACES, key, cell_m, 1, found, 1, &truth, &e->scores);
    if (status == SHERF_OK)
        status = surfaces_overlap(c, cell_m, 1, found, t.points, t.point, t.inside, &e->scores.overlap);
    surface_truth_free(&t);
    return status;
}

static sherf_status take(context *c, surface_list *l, const sherf_dataset *d, const solid_mesh *found,
                         int person, picture observation) {
    surface_entry e = {.person = person, .observation = observation};
    if (found->triangles < TRIANGLES_MIN) {
        l->missed++;
        return SHERF_OK;
    }
    const sherf_status status = compare(c, d, found, &e);
    return status == SHERF_OK ? add(c, l, &e) : status;
}

sherf_status surface_list_measure(context *c, surface_list *l, const sherf_dataset *d, const body_model *body,
                                  const sherf_avatar *avatar, int person, picture observation) {
    solid_mesh found;
    float *room;
    if (!surface_truth_is_there(c, d, person, observation.pose) || !has_surface(avatar)) return SHERF_OK;
    sherf_status status = surface_of(c, avatar, body, &room, &found);
    if (status == SHERF_OK) status = take(c, l, d, &found, person, observation);
    mem_free(room);
    return status;
}

sherf_status surface_list_bake(context *c, surface_list *l, const sherf_dataset *d, const body_model *body,
                               const sherf_avatar *avatar, int person, picture observation) {
    const baked_options how = {.resolution = BAKED_RESOLUTION,
                               .islands = BAKED_ISLANDS,
                               .triangles = BAKED_TRIANGLES,
                               .pose = sherf_avatar_pose(avatar)};
    baked_person p = {0};
    if (has_surface(avatar)) return surface_list_measure(c, l, d, body, avatar, person, observation);
    if (!surface_truth_is_there(c, d, person, observation.pose)) return SHERF_OK;
    sherf_status status = baked_person_make(c, avatar, body, &how, &p);
    if (status == SHERF_BAD_ARGUMENT) {
        log_line(c, SHERF_LOG_WARNING, "%s", c->message);
        l->missed++;
        status = SHERF_OK;
    } else if (status == SHERF_OK) {
        const solid_mesh found = {p.surface.vertices, p.surface.triangles, p.surface.position,
                                  p.surface.triangle};
        status = take(c, l, d, &found, person, observation);
    }
    baked_person_free(&p);
    return status;
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
        s.overlap += one->overlap;
        ++*count;
    }
    const double n = *count ? (double)*count : NAN;
    return (surface_scores){s.to_truth_m / n, s.from_truth_m / n, s.chamfer_m / n, s.normal_deg / n,
                            s.overlap / n};
}

char *surface_list_text(context *c, const surface_list *l) {
    int64_t n;
    const surface_scores s = surface_list_mean(l, -1, &n);
    if (!n) return mem_format(c, "surfaces: nothing came out of %lld observations\n", (long long)l->missed);
    return mem_format(
        c,
        "surfaces of %lld observations: Chamfer %.2f cm (to the truth %.2f, from it %.2f), normals "
        "%.1f degrees, insides overlap by %.3f; nothing came out of %lld\n",
        (long long)n, 100 * s.chamfer_m, 100 * s.to_truth_m, 100 * s.from_truth_m, s.normal_deg, s.overlap,
        (long long)l->missed);
}
