/* Makes src/estimate/fit_depths_table.c from people whose bodies are known, and prints how good it is.
 *
 *     fit_depths thuman:FOLDER BODY NETWORKS CACHE >src/estimate/fit_depths_table.c
 *
 * The set is `sherf synth people --background scenes --cameras photo`; every view of every pose is looked at
 * once, and what was seen is kept in CACHE, which later runs read instead. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "data/data.h"
#include "estimate/fit_inside.h"
#include "estimate/landmarks.h"
#include "fit_tools.h"

enum { N = FIT_DEPTH_NUMBERS, D = FIT_DEPTHS, FOLDS = 8 };
/* In units of the numbers' spread. */
static const double ridge = 300, spread_min = 0.02;

typedef struct {
    int32_t person;
    float focal_px, mark_m[LANDMARKS][3]; /* of the true body, in the camera's frame */
    photo_person seen;
} look;

typedef struct {
    int person;
    double number[N], short_of[D]; /* what is missing at the network's depths */
} sample;

/* ---- looking ---- */

static void look_at(context *c, const pose_networks *n, const sherf_dataset *d, const body_model *body,
                    body_points *marks, int person, int pose, int view, FILE *out) {
    sherf_image photo;
    data_view *v;
    photo_person *people;
    body_state s;
    double place[LANDMARKS][3];
    int count;
    must(c, dataset_photo(c, d, person, pose, view, 0, &photo));
    must(c, dataset_view(c, d, person, pose, view, 0, &v));
    must(c, people_find(c, n, &photo, 1, &people, &count));
    body_in_camera(c, body, v, &s);
    body_points_place(marks, &s, place[0], NULL, NULL);
    look *l = count ? mem_zero(c, 1, sizeof *l) : NULL;
    if (l) {
        l->person = person;
        l->focal_px = v->camera.K[0];
        l->seen = people[0];
        for (int i = 0; i < 3 * LANDMARKS; i++) l->mark_m[i / 3][i % 3] = (float)place[i / 3][i % 3];
        need(fwrite(l, sizeof *l, 1, out) == 1, "the cache cannot be written");
    }
    mem_free(l);
    mem_free(people);
    sherf_observation_free(v);
    sherf_image_free(&photo);
}

static void look_at_all(context *c, char **argument) {
    body_model *body;
    pose_networks *n;
    sherf_dataset *d;
    body_points *marks;
    body_point list[LANDMARKS] = {0};
    FILE *out = fopen(argument[4], "wb");
    need(out, "the cache cannot be written");
    must(c, sherf_dataset_open(c, argument[1], &d));
    must(c, body_load(c, argument[2], &body));
    must(c, pose_networks_load(c, argument[3], &n));
    for (int i = 0; i < LANDMARKS; i++) {
        list[i].vertex = -1;
        if (fit_landmarks[i].joint < 0) continue;
        list[i].joint = fit_landmarks[i].joint;
        memcpy(list[i].offset_m, fit_landmarks[i].offset_m, sizeof list[i].offset_m);
    }
    must(c, body_points_create(c, body, LANDMARKS, list, &marks));
    for (int i = 0; i < sherf_dataset_person_count(d); i++)
        for (int q = 0; q < sherf_dataset_pose_count(d, i); q++)
            for (int v = 0; v < sherf_dataset_view_count(d, i); v++)
                look_at(c, n, d, body, marks, i, q, v, out);
    body_points_free(marks);
    pose_networks_free(n);
    sherf_body_free(body);
    sherf_dataset_free(d);
    need(!fclose(out), "the cache cannot be written");
}

/* ---- samples ---- */

static int other_side(int i) {
    if (i == LANDMARK_NOSE) return i;
    if (i < LANDMARK_LEFT_EAR) return i < 4 ? i + 3 : i - 3;
    return i % 2 ? i + 1 : i - 1;
}

static void mirror(look *l) {
    const look was = *l;
    l->seen.region.angle_rad *= -1;
    for (int i = 0; i < LANDMARKS; i++) {
        landmark *to = &l->seen.landmark[i];
        *to = was.seen.landmark[other_side(i)];
        to->place_px[0] *= -1;
        to->place_m[0] *= -1;
        memcpy(l->mark_m[i], was.mark_m[other_side(i)], sizeof l->mark_m[i]);
        l->mark_m[i][0] *= -1;
    }
}

/* Left and right as seen from above are not exchanged. */
static bool same_turn(const look *l) {
    const float *a = l->mark_m[LANDMARK_LEFT_SHOULDER], *b = l->mark_m[LANDMARK_RIGHT_SHOULDER],
                *p = l->seen.landmark[LANDMARK_LEFT_SHOULDER].place_m,
                *q = l->seen.landmark[LANDMARK_RIGHT_SHOULDER].place_m;
    return (a[0] - b[0]) * (p[0] - q[0]) + (a[2] - b[2]) * (p[2] - q[2]) > 0;
}

/* false: the networks confused front and back, or saw something else. */
static bool sample_of(const look *l, sample *s) {
    double ray[3], length = 0, hips = 0, px_per_m, off = 0;
    const float *a = l->mark_m[LANDMARK_LEFT_HIP], *b = l->mark_m[LANDMARK_RIGHT_HIP];
    for (int k = 0; k < 3; k++) ray[k] = 0.5 * (double)(a[k] + b[k]), length += ray[k] * ray[k];
    for (int k = 0; k < 3; k++) ray[k] /= sqrt(length), hips += ray[k] * 0.5 * (double)(a[k] + b[k]);
    s->person = l->person;
    if (!same_turn(l)) return false;
    if (!fit_depth_numbers(&l->seen, s->number, &px_per_m)) return false;
    const double scale = (double)l->focal_px / (hips * px_per_m);
    for (int i = 0, n = 0; i < LANDMARKS; i++) {
        if (fit_landmarks[i].joint < 0) continue;
        double z = -hips;
        for (int k = 0; k < 3; k++) z += ray[k] * (double)l->mark_m[i][k];
        s->short_of[n] = scale * z - (double)l->seen.landmark[i].place_m[2];
        off += fabs(s->short_of[n++]) / D;
    }
    return off < 0.25;
}

static int read_samples(const char *path, sample **out) {
    FILE *in = fopen(path, "rb");
    int count = 0, room = 0;
    look *l = malloc(sizeof *l);
    *out = NULL;
    need(in && l, "the cache cannot be read");
    while (fread(l, sizeof *l, 1, in) == 1)
        for (int side = 0; side < 2; side++) {
            if (count == room) *out = realloc(*out, (size_t)(room = 2 * room + 64) * sizeof **out);
            need(*out, "no memory");
            if (side) mirror(l);
            count += sample_of(l, *out + count);
        }
    free(l);
    fclose(in);
    return count;
}

/* ---- the regression ---- */

static void solve(double A[N][N], double x[N][D]) {
    for (int i = 0; i < N; i++) { /* Cholesky in place, then both substitutions */
        for (int j = 0; j <= i; j++) {
            double sum = A[i][j];
            for (int k = 0; k < j; k++) sum -= A[i][k] * A[j][k];
            A[i][j] = i == j ? sqrt(sum) : sum / A[j][j];
        }
        for (int d = 0; d < D; d++) {
            for (int k = 0; k < i; k++) x[i][d] -= A[i][k] * x[k][d];
            x[i][d] /= A[i][i];
        }
    }
    for (int i = N - 1; i >= 0; i--)
        for (int d = 0; d < D; d++) {
            for (int k = i + 1; k < N; k++) x[i][d] -= A[k][i] * x[k][d];
            x[i][d] /= A[i][i];
        }
}

/* Over all samples but those of every FOLDS-th person from `without` on (-1: all). */
static void regress(const sample *s, int count, int without, double weight[N][D]) {
    static double A[N][N];
    double mean[N] = {0}, spread[N] = {0};
    int used = 0;
    for (int pass = 0; pass < 2; pass++) {
        for (int n = 0; n < count; n++) {
            if (s[n].person % FOLDS == without) continue;
            used += !pass;
            for (int i = 0; i < N; i++) {
                double d = s[n].number[i] - mean[i];
                if (pass)
                    spread[i] += d * d / used;
                else
                    mean[i] += d;
            }
        }
        for (int i = 0; i < N && !pass; i++) mean[i] /= used;
    }
    for (int i = 0; i < N; i++) spread[i] = fmax(sqrt(spread[i]), spread_min);
    mean[N - 1] = 0, spread[N - 1] = 1; /* of the constant, which is not regularised */
    memset(A, 0, sizeof A);
    memset(weight, 0, N * sizeof *weight);
    for (int n = 0; n < count; n++) {
        double x[N];
        if (s[n].person % FOLDS == without) continue;
        for (int i = 0; i < N; i++) x[i] = (s[n].number[i] - mean[i]) / spread[i];
        for (int i = 0; i < N; i++) {
            for (int j = 0; j <= i; j++) A[i][j] += x[i] * x[j];
            for (int d = 0; d < D; d++) weight[i][d] += x[i] * s[n].short_of[d];
        }
    }
    for (int i = 0; i < N - 1; i++) A[i][i] += ridge;
    solve(A, weight);
    for (int i = 0; i < N - 1; i++)
        for (int d = 0; d < D; d++) {
            weight[i][d] /= spread[i];
            weight[N - 1][d] -= weight[i][d] * mean[i];
        }
}

/* Root mean squares, each person's by weights fitted without that person. */
static void judge(const sample *s, int count) {
    static double weight[N][D];
    double before[D] = {0}, after[D] = {0};
    for (int without = 0; without < FOLDS; without++) {
        regress(s, count, without, weight);
        for (int n = 0; n < count; n++) {
            if (s[n].person % FOLDS != without) continue;
            for (int d = 0; d < D; d++) {
                double left = s[n].short_of[d];
                before[d] += left * left / count;
                for (int i = 0; i < N; i++) left -= weight[i][d] * s[n].number[i];
                after[d] += left * left / count;
            }
        }
    }
    for (int i = 0, d = 0; i < LANDMARKS; i++) {
        if (fit_landmarks[i].joint < 0) continue;
        fprintf(stderr, "landmark %2d: depth off by %3.0f mm, corrected %3.0f\n", i, 1000 * sqrt(before[d]),
                1000 * sqrt(after[d]));
        d++;
    }
}

int main(int arguments, char **argument) {
    context *c;
    sherf_options options = {0};
    sample *s;
    static double weight[N][D];
    need(arguments == 5, "usage: fit_depths thuman:FOLDER BODY NETWORKS CACHE");
    if (sherf_context_create(&options, &c) != SHERF_OK) return 1;
    FILE *there = fopen(argument[4], "rb");
    if (there)
        fclose(there);
    else
        look_at_all(c, argument);
    const int count = read_samples(argument[4], &s);
    need(count > 0 && s[count - 1].person >= FOLDS, "too few people were seen: more than 8 are needed");
    fprintf(stderr, "%d looks, left and right mirrored\n", count);
    judge(s, count);
    regress(s, count, -1, weight);
    printf("/* Corrections of the landmarks' depths, linear in all landmarks' places (fit_inside.h).\n"
           " *\n"
           " * bench/fit_depths.c writes this file; it was fitted to %d views of people whose bodies are "
           "known, half\n"
           " * of them mirrored. */\n"
           "#include \"estimate/fit_inside.h\"\n\n/* clang-format off */\n"
           "const int16_t fit_depth_weights[FIT_DEPTHS][FIT_DEPTH_NUMBERS] = {\n",
           count);
    for (int d = 0; d < D; d++) {
        printf("{\n");
        for (int i = 0; i < N; i++)
            printf("%ld,%s", lrint(fmin(fmax(weight[i][d] / FIT_DEPTH_UNIT, -32767), 32767)),
                   i % 18 == 17 || i + 1 == N ? "\n" : " ");
        printf("},\n");
    }
    printf("};\n/* clang-format on */\n");
    free(s);
    sherf_context_free(c);
    return 0;
}
