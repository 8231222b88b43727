/* The reference network: its weights by rule, and the contents of its file (reference.h). */
#include "reference.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static bool ends(const char *name, const char *suffix) {
    size_t n = strlen(name), m = strlen(suffix);
    return n >= m && !strcmp(name + n - m, suffix);
}

/* The scale, and 1 or 0 to add; rules are tried from the top. */
static double rule(const char *name, const tensor *w, double *add) {
    double fan_in = 1;
    for (int i = 1; i < w->rank; i++) fan_in *= (double)w->dim[i];
    *add = 0;
    if (ends(name, ".running_mean")) return 0.05;
    if (ends(name, ".running_var")) return *add = 1, 0.2;
    if (w->rank == 1 && ends(name, ".weight")) return *add = 1, 0.1;
    if (ends(name, ".bias")) {
        if (!strstr(name, ".affine.")) return 0.05;
        return *add = 1, 0.1;
    }
    if (ends(name, ".const")) return 1;
    if (strstr(name, "backbone.mapping")) return sqrt(3) / 0.01;
    if (strstr(name, "backbone.synthesis")) return sqrt(3);
    if (strstr(name, "encoder_3d")) return sqrt(3 / (27 * (double)w->dim[w->rank - 1] / 6));
    double scale = sqrt(3 / fan_in);
    if (strstr(name, "alpha_linear")) scale *= 40;
    if (strstr(name, "pts_linears") || strstr(name, "views_linear")) scale *= sqrt(2);
    return scale;
}

void reference_weights(model *m) {
    for (int i = 0; i < m->weights->count; i++) {
        parameter *q = m->weights->item[i];
        int64_t n = tensor_count(&q->value), C = q->value.dim[2];
        float *v = q->value.data;
        double add, scale = rule(q->name, &q->value, &add);
        uint64_t key = fnv1a64(q->name);
        bool is_const = ends(q->name, ".const"); /* [C, 4, 4] in the rules, [4, 4, C] here */
        for (int64_t k = 0; k < n; k++) {
            float u = (float)(scale * (2 * random_uniform(key, (uint64_t)k) - 1));
            v[is_const ? k % 16 * C + k / 16 : k] = add != 0 ? (float)add + u : u;
        }
    }
}

safetensors *reference_read(context *c, const char *file) {
    char path[256];
    safetensors *s = NULL;
    snprintf(path, sizeof path, "data/%s", file);
    assert_ok(c, safetensors_read(c, path, &s));
    return s;
}

const float *reference_floats(const safetensors *s, const char *name, int64_t count) {
    const safetensor *t = safetensors_find(s, name);
    if (!t) fail_msg("the reference has no %s", name);
    int64_t n = 1;
    for (int i = 0; i < t->rank; i++) n *= t->dim[i];
    if (n != count || t->type != T_F32)
        fail_msg("%s has %lld values, not %lld", name, (long long)n, (long long)count);
    return t->data;
}

static void take(const safetensors *s, const char *who, const char *what, int64_t count, float *out) {
    char name[96];
    snprintf(name, sizeof name, "in.%s.%s", who, what);
    memcpy(out, reference_floats(s, name, count), (size_t)count * sizeof *out);
}

void reference_camera(const safetensors *s, const char *who, sherf_camera *out) {
    out->width_px = out->height_px = REFERENCE_SIZE;
    take(s, who, "camera.K", 9, out->K);
    take(s, who, "camera.R", 9, out->R);
    take(s, who, "camera.T", 3, out->T_m);
}

void reference_pose(const safetensors *s, const char *who, sherf_pose *out) {
    take(s, who, "poses", 72, out->poses_rad);
    take(s, who, "shapes", 10, out->shapes);
    take(s, who, "R", 9, out->R);
    take(s, who, "Th", 3, out->Th_m);
}

void reference_image(context *c, bool target, sherf_image *out) {
    const int S = REFERENCE_SIZE;
    *out = (sherf_image){S, S, 3, mem_alloc(c, (size_t)(S * S * 3), sizeof(float))};
    assert_non_null(out->data);
    for (int i = 0; i < S * S * 3; i++) {
        int k = i % 3;
        double x = (double)(i / 3 % S) / S, y = (double)(i / 3 / S) / S;
        double a = target ? 5 * (3 - k) * x + 3 * y * (k + 1) + 2 * k : 6 * (k + 1) * x + 4 * y * (3 - k) + k;
        out->data[i] = (float)(0.5 + 0.5 * sin(a));
    }
}

void reference_compare(const char *what, const float *want, const float *got, int64_t count,
                       reference_bound bound) {
    double top = 0, worst = 0, squares = 0;
    int64_t at = 0;
    for (int64_t i = 0; i < count; i++) {
        double error = fabs((double)got[i] - (double)want[i]);
        top = fmax(top, fabs((double)want[i]));
        squares += error * error;
        if (error <= worst) continue;
        worst = error;
        at = i;
    }
    double rms = sqrt(squares / (double)count);
    if (getenv("SHERF_TEST_VERBOSE"))
        printf("%-28s largest error %.2e, rms %.2e of %g\n", what, worst / top, rms / top, top);
    if (!(worst <= bound.largest * top && rms <= bound.rms * top))
        fail_msg("%s: largest error %g at %lld (%g instead of %g), rms %g, of %g", what, worst, (long long)at,
                 (double)got[at], (double)want[at], rms, top);
}
