/* surface_list: scores of the surfaces of avatars that have one, against those of the data set. */
#ifndef SHERF_SURFACE_LIST_H
#define SHERF_SURFACE_LIST_H

#include "avatar/avatar.h"
#include "eval/selection.h"
#include "eval/surfaces.h"

typedef struct {
    int person; /* of the data set */
    picture observation;
    surface_scores scores;
} surface_entry;
typedef struct {
    int64_t count, capacity, missed; /* missed: observations that gave no surface */
    surface_entry *entry;
} surface_list;
void surface_list_free(surface_list *l);
/* Compares the avatar's surface with the person's in the observed pose; does nothing where the avatar or the
 * data set has none. */
sherf_status surface_list_measure(context *c, surface_list *l, const sherf_dataset *d, const body_model *body,
                                  const sherf_avatar *avatar, int person, picture observation);
/* The same, but of an avatar without a surface it takes the one that it would be baked to. Where it is
 * nowhere dense enough, it counts as missed. */
sherf_status surface_list_bake(context *c, surface_list *l, const sherf_dataset *d, const body_model *body,
                               const sherf_avatar *avatar, int person, picture observation);
/* Means of one person (-1: of all); *count: of how many. */
surface_scores surface_list_mean(const surface_list *l, int person, int64_t *count);
/* A line to print, or NULL: out of memory; mem_free it. */
char *surface_list_text(context *c, const surface_list *l);

#endif
