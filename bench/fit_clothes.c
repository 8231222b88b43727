/* Makes src/estimate/fit_clothes_table.c: how far the mask's edge lies beyond the bare body, from people
 * whose bodies are known, and prints how good it is.
 *
 *     fit_clothes thuman:FOLDER BODY NETWORKS CACHE >src/estimate/fit_clothes_table.c
 *
 * The set is `sherf synth people --background scenes --cameras photo`; masks are those that are found in each
 * picture, bodies the true ones. What was found is kept in CACHE, which later runs read instead. Least
 * absolute deviations over all edges, left and right mirrored. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "data/data.h"
#include "estimate/fit_inside.h"
#include "estimate/landmarks.h"
#include "estimate/mask.h"
#include "fit_tools.h"

enum { N = 4 * BODY_JOINTS, ROUNDS = 30 };
/* Edges further off do not belong to that limb; smaller deviations count the same; hardly visible numbers
 * stay 0. */
static const double far_m = 0.1, near_m = 0.003, ridge = 20;

typedef struct {
    int32_t vertex;
    float normal[3], off_m;
} sample;

/* ---- looking ---- */

static void find_edges(context *c, const body_model *body, const photo_person *person,
                       const sherf_image *mask, const data_view *truth, FILE *out) {
    const body_fit_input in = {person, mask->width, mask->height, (double)truth->camera.K[0], mask};
    fit_problem p;
    fit_edge edge[FIT_OUTLINE_MAX];
    body_state s;
    must(c, fit_problem_begin(c, body, &in, &p));
    body_in_camera(c, body, truth, &s);
    p.px_per_m = in.focal_px / s.pelvis_m[2];
    p.centre_px[0] = (double)truth->camera.K[2];
    p.centre_px[1] = (double)truth->camera.K[5];
    body_points_place(p.skin, &s, p.skin_place, NULL, p.skin_blend);
    for (int i = 0, count = fit_edges(&p, in.focal_px, edge); i < count; i++) {
        const double *n = p.skin_normal[edge[i].skin];
        const sample one = {p.skin_vertex[edge[i].skin],
                            {(float)n[0], (float)n[1], (float)n[2]},
                            (float)(edge[i].off_px / p.px_per_m)};
        if (fabs((double)one.off_m) < far_m)
            need(fwrite(&one, sizeof one, 1, out) == 1, "the cache cannot be written");
    }
    fit_problem_clear(&p);
}

static void look_at(context *c, const pose_networks *n, const sherf_dataset *d, const body_model *body,
                    int person, int pose, int view, FILE *out) {
    sherf_image photo, mask = {0};
    data_view *truth;
    photo_person *people;
    int count;
    must(c, dataset_photo(c, d, person, pose, view, 0, &photo));
    must(c, dataset_view(c, d, person, pose, view, 0, &truth));
    must(c, people_find(c, n, &photo, 1, &people, &count));
    if (count && person_mask(c, &photo, people, NULL, 0, &mask, NULL) == SHERF_OK)
        find_edges(c, body, people, &mask, truth, out);
    mem_free(people);
    sherf_observation_free(truth);
    sherf_image_free(&mask);
    sherf_image_free(&photo);
}

static void look_at_all(context *c, const body_model *body, char **argument) {
    pose_networks *n;
    sherf_dataset *d;
    FILE *out = fopen(argument[4], "wb");
    need(out, "the cache cannot be written");
    must(c, sherf_dataset_open(c, argument[1], &d));
    must(c, pose_networks_load(c, argument[3], &n));
    for (int i = 0; i < sherf_dataset_person_count(d); i++)
        for (int q = 0; q < sherf_dataset_pose_count(d, i); q++)
            for (int v = 0; v < sherf_dataset_view_count(d, i); v++) look_at(c, n, d, body, i, q, v, out);
    pose_networks_free(n);
    sherf_dataset_free(d);
    need(!fclose(out), "the cache cannot be written");
}

/* ---- the regression ---- */

/* The table's numbers that a sample contributes to. */
static void numbers_of(const body_model *body, const sample *s, bool mirrored, double x[N]) {
    for (int j = 0; j < BODY_JOINTS; j++) {
        const double w = (double)body->weights[(size_t)s->vertex * BODY_JOINTS + (size_t)j];
        double *to = x + 4 * (mirrored ? other_joint(j) : j);
        to[0] = w;
        for (int k = 0; k < 3; k++) to[1 + k] = w * (double)s->normal[k] * (mirrored && k == 0 ? -1 : 1);
    }
}

static void solve(double A[N][N], double x[N]) {
    for (int i = 0; i < N; i++) { /* Cholesky in place, then both substitutions */
        for (int j = 0; j <= i; j++) {
            double sum = A[i][j];
            for (int k = 0; k < j; k++) sum -= A[i][k] * A[j][k];
            A[i][j] = i == j ? sqrt(sum) : sum / A[j][j];
        }
        for (int k = 0; k < i; k++) x[i] -= A[i][k] * x[k];
        x[i] /= A[i][i];
    }
    for (int i = N - 1; i >= 0; i--) {
        for (int k = i + 1; k < N; k++) x[i] -= A[k][i] * x[k];
        x[i] /= A[i][i];
    }
}

/* One round of least squares, weighted by the previous round's deviations. Returns their mean. */
static double round_of(const body_model *body, const sample *s, int count, double table[N]) {
    static double A[N][N];
    double right[N] = {0}, off = 0;
    memset(A, 0, sizeof A);
    for (int n = 0; n < 2 * count; n++) {
        double x[N], left = -(double)s[n / 2].off_m;
        numbers_of(body, s + n / 2, n % 2, x);
        for (int i = 0; i < N; i++) left -= x[i] * table[i];
        off += fabs(left) / (2 * count);
        const double weight = 1 / (fabs(left) + near_m) * near_m;
        for (int i = 0; i < N; i++) {
            if (x[i] == 0) continue;
            right[i] -= weight * x[i] * (double)s[n / 2].off_m;
            for (int j = 0; j <= i; j++) A[i][j] += weight * x[i] * x[j];
        }
    }
    for (int i = 0; i < N; i++) A[i][i] += ridge;
    solve(A, right);
    memcpy(table, right, sizeof right);
    return off;
}

int main(int arguments, char **argument) {
    context *c;
    sherf_options options = {0};
    body_model *body;
    double table[N] = {0};
    need(arguments == 5, "usage: fit_clothes thuman:FOLDER BODY NETWORKS CACHE");
    if (sherf_context_create(&options, &c) != SHERF_OK) return 1;
    must(c, sherf_body_load(c, argument[2], &body));
    FILE *in = fopen(argument[4], "rb");
    if (!in) {
        look_at_all(c, body, argument);
        in = fopen(argument[4], "rb");
    }
    need(in && !fseek(in, 0, SEEK_END), "the cache cannot be read");
    const int count = (int)(ftell(in) / (long)sizeof(sample));
    sample *s = malloc((size_t)count * sizeof *s);
    rewind(in);
    need(count > 0 && s && fread(s, sizeof *s, (size_t)count, in) == (size_t)count,
         "the cache cannot be read");
    fclose(in);
    for (int i = 0; i < count; i++)
        need(s[i].vertex >= 0 && s[i].vertex < body->vertices, "the cache is of another body");
    for (int i = 0; i < ROUNDS; i++) {
        const double off = round_of(body, s, count, table);
        if (i == 0 || i + 1 == ROUNDS)
            fprintf(stderr, "round %d: edges %.1f mm off on the mean\n", i, 1000 * off);
    }
    printf("/* The table of clothes: how far beyond the bare body the mask's edge lies, by joint "
           "(fit_inside.h).\n"
           " *\n"
           " * bench/fit_clothes.c writes this file; it was fitted to %d points on masks' edges and their "
           "mirror\n"
           " * images. */\n"
           "#include \"estimate/fit_inside.h\"\n\n/* clang-format off */\n"
           "const fit_clothes fit_clothes_table[BODY_JOINTS] = {\n",
           count);
    for (int j = 0; j < BODY_JOINTS; j++)
        printf("    {%.4ff, {%.4ff, %.4ff, %.4ff}},\n", table[4 * j], table[4 * j + 1], table[4 * j + 2],
               table[4 * j + 3]);
    printf("};\n/* clang-format on */\n");
    free(s);
    sherf_body_free(body);
    sherf_context_free(c);
    return 0;
}
