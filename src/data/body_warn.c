/* Whether a body model is the one that a data set's poses were fitted with. */
#include "data/dataset.h"
#include "data/silhouette.h"

enum { PEOPLE_MAX = 4 };

/* The first pose that is there. */
static int first_pose(const person_record *r) {
    int pose = 0;
    while (r->present && pose + 1 < r->poses && !r->present[pose]) pose++;
    return pose;
}

/* Vertices that the data set stores for the person; 0: none that can be read. */
static int64_t vertices_stored(context *quiet, const sherf_dataset *d, int person, int pose,
                               char path[PATH_LENGTH]) {
    char parameters[PATH_LENGTH];
    document *doc = NULL;
    if (dataset_pose_paths(quiet, d, person, pose, parameters, path) || !*path || !path_is_file(path))
        return 0;
    const int64_t numbers = npy_read(quiet, path, &doc) ? 0 : value_numbers(doc->root);
    document_free(doc);
    return numbers > 0 && numbers % 3 == 0 ? numbers / 3 : 0;
}

/* Adds the overlap of the body with the person's mask, if it can be told. */
static void overlap_add(context *quiet, const sherf_dataset *d, const body_model *body, int person, int pose,
                        int view, double *sum, int *count) {
    data_view *v = NULL;
    double overlap;
    if (dataset_view(quiet, d, person, pose, view, 0, &v)) return;
    if (!silhouette_overlap(quiet, v, body, &v->pose, &v->camera, MASK_AS_IT_IS, &overlap))
        *sum += overlap, ++*count;
    sherf_observation_free(v);
}

void dataset_body_warn(context *c, const sherf_dataset *d, const body_model *body, const char *name,
                       const int *person, int people) {
    context quiet = {.threads = c->threads};
    const int some = people < PEOPLE_MAX ? people : PEOPLE_MAX;
    char path[PATH_LENGTH];
    double sum = 0;
    int count = 0;
    for (int i = 0; i < some && !cancelled(c); i++) {
        const person_record *r;
        const int one = person[(int64_t)i * people / some];
        if (dataset_record(&quiet, d, one, &r) || r->poses < 1 || r->views < 1) continue;
        const int64_t stored = i ? 0 : vertices_stored(&quiet, d, one, first_pose(r), path);
        if (stored && stored != body->vertices) {
            log_line(
                c, SHERF_LOG_WARNING,
                "%s has %d vertices, and %s has %lld: the poses are another body's, and will not fit this "
                "one (--body)",
                name, body->vertices, path, (long long)stored);
            return;
        }
        overlap_add(&quiet, d, body, one, first_pose(r), protocol_front(dataset_protocol(d), r->views), &sum,
                    &count);
    }
    if (count && sum < 0.6 * count)
        log_line(
            c, SHERF_LOG_WARNING,
            "%s covers %.0f %% of the masks of %s: the poses are another body's (--body), or the cameras "
            "do not fit; see sherf check",
            name, 100 * sum / count, d->root);
}
