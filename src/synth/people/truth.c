/* Dresses a person once, and poses it for each request. */
#include "synth/people/truth.h"

#include <stdlib.h>
#include <string.h>

struct people_truth {
    studio *studio;
    uint64_t number; /* of `dressed` */
    dressed *dressed;
    float *position[DRESSED_MAX];
    people_surface surface;
};

static void person_clear(people_truth *t) {
    for (int i = 0; i < DRESSED_MAX; i++) {
        mem_free(t->position[i]);
        t->position[i] = NULL;
    }
    dressed_free(t->dressed);
    t->dressed = NULL;
}

void people_truth_close(people_truth *t) {
    if (!t) return;
    person_clear(t);
    studio_close(t->studio);
    mem_free(t);
}

sherf_status people_truth_open(context *c, const char *source, const char *body_path, people_truth **out) {
    people_truth *t = *out = mem_zero(c, 1, sizeof *t);
    if (!t) return SHERF_NO_MEMORY;
    const sherf_status status = studio_open(c, source, body_path, &t->studio);
    if (status == SHERF_OK) return status;
    people_truth_close(t);
    *out = NULL;
    return status;
}

bool people_truth_number(const char *name, uint64_t *number) {
    static const char before[] = "person_";
    const size_t n = strlen(before);
    if (strncmp(name, before, n) || strspn(name + n, "0123456789") != strlen(name + n) ||
        strlen(name + n) < 6 || strlen(name + n) > 18)
        return false;
    *number = strtoull(name + n, NULL, 10);
    return true;
}

static sherf_status person_take(context *c, people_truth *t, uint64_t number) {
    person p;
    if (t->dressed && t->number == number) return SHERF_OK;
    person_clear(t);
    person_draw(t->studio->human, number, &p);
    sherf_status status = dressed_create(c, t->studio, &p, &t->dressed);
    for (int i = 0; status == SHERF_OK && i < t->dressed->meshes; i++) {
        t->position[i] = mem_alloc(c, (size_t)t->dressed->mesh[i].vertices, 3 * sizeof **t->position);
        if (!t->position[i]) status = SHERF_NO_MEMORY;
    }
    t->number = number;
    if (status != SHERF_OK) person_clear(t);
    return status;
}

void people_surface_of(const studio *s, const dressed *d, float *const *position, people_surface *out) {
    out->meshes = 0;
    for (int i = 0; i < d->meshes; i++) {
        const dressed_mesh *mesh = &d->mesh[i];
        if (mesh->material.alpha == TRACE_BLENDED) continue;
        const int n = out->meshes++;
        out->mesh[n] = i;
        out->drawn[n] = out->walls[n] =
            (solid_mesh){mesh->vertices, mesh->triangles, position[i], mesh->triangle};
        if (mesh->kind == WEAR_KINDS)
            out->walls[n] =
                (solid_mesh){mesh->vertices, s->human->triangles, position[i], s->human->triangle};
    }
}

sherf_status people_truth_pose(context *c, people_truth *t, uint64_t number, const sherf_pose *p,
                               const people_surface **out) {
    posed_body *posed = NULL;
    *out = &t->surface;
    sherf_status status = person_take(c, t, number);
    if (status == SHERF_OK)
        status = posed_body_create(c, t->studio->body, p->poses_rad, p->shapes, p->R, p->Th_m, &posed);
    if (status == SHERF_OK) {
        for (int i = 0; i < t->dressed->meshes; i++)
            dressed_pose(t->studio, t->dressed, i, posed, t->position[i]);
        people_surface_of(t->studio, t->dressed, t->position, &t->surface);
    }
    posed_body_free(posed);
    return status;
}
