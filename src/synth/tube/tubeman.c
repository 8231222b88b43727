/* tubeman: tubes between joints, ten vertices in each ring; blend weights, shapes and pose blend shapes by
 * formula. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/vector3.h"
#include "synth/tube/tubeman.h"

enum { V = 6890, SEGMENTS = 10, RINGS = 689, TUBES = 25, FACES_MAX = 2 * V, JOINTS = BODY_JOINTS };

static const int64_t parents[JOINTS] = {-1, 0, 0, 0,  1,  2,  3,  4,  5,  6,  7,  8,
                                        9,  9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21};
static const double joint[JOINTS][3] = {
    {0, -0.22, 0.02},      {0.07, -0.31, 0.01},  {-0.07, -0.31, 0.01}, {0, -0.11, 0.0},
    {0.10, -0.69, 0.0},    {-0.10, -0.69, 0.0},  {0, 0.03, 0.01},      {0.09, -1.09, -0.03},
    {-0.09, -1.09, -0.03}, {0, 0.08, 0.01},      {0.12, -1.14, 0.09},  {-0.12, -1.14, 0.09},
    {0, 0.29, -0.02},      {0.08, 0.20, -0.01},  {-0.08, 0.20, -0.01}, {0, 0.36, 0.03},
    {0.17, 0.23, -0.02},   {-0.17, 0.23, -0.02}, {0.43, 0.21, -0.04},  {-0.43, 0.21, -0.04},
    {0.68, 0.22, -0.04},   {-0.68, 0.22, -0.04}, {0.76, 0.21, -0.05},  {-0.76, 0.21, -0.05}};

/* From joint `a` to joint `b`, or to the point `end` if b is -1; radii at both ends. */
static const struct {
    int a, b;
    double end[3], radius_a, radius_b;
} tube[TUBES] = {{0, 3, {0}, 0.15, 0.14},
                 {3, 6, {0}, 0.14, 0.14},
                 {6, 9, {0}, 0.145, 0.15},
                 {9, 12, {0}, 0.15, 0.06},
                 {12, 15, {0}, 0.06, 0.07},
                 {15, -1, {0, 0.56, 0.03}, 0.095, 0.05},
                 {0, -1, {0, -0.34, 0.02}, 0.15, 0.10},
                 {1, 4, {0}, 0.085, 0.055},
                 {2, 5, {0}, 0.085, 0.055},
                 {4, 7, {0}, 0.055, 0.04},
                 {5, 8, {0}, 0.055, 0.04},
                 {7, 10, {0}, 0.04, 0.035},
                 {8, 11, {0}, 0.04, 0.035},
                 {10, -1, {0.125, -1.145, 0.17}, 0.035, 0.02},
                 {11, -1, {-0.125, -1.145, 0.17}, 0.035, 0.02},
                 {13, 16, {0}, 0.07, 0.06},
                 {14, 17, {0}, 0.07, 0.06},
                 {16, 18, {0}, 0.055, 0.042},
                 {17, 19, {0}, 0.055, 0.042},
                 {18, 20, {0}, 0.042, 0.03},
                 {19, 21, {0}, 0.042, 0.03},
                 {20, 22, {0}, 0.032, 0.034},
                 {21, 23, {0}, 0.032, 0.034},
                 {22, -1, {0.86, 0.205, -0.055}, 0.034, 0.012},
                 {23, -1, {-0.86, 0.205, -0.055}, 0.034, 0.012}};
/* Rings of each tube: RINGS distributed by length, rounded down, the rest to the longest ones. */
static const int rings[TUBES] = {17, 22, 7,  33, 13, 31, 18, 59, 59, 62, 62, 20, 20,
                                 12, 12, 14, 14, 41, 41, 39, 39, 12, 12, 15, 15};

/* A joint is the mean of its 20 nearest vertices. For these joints the 20th and 21st are equally far (up to
 * the last bit), and the generator's sort decided; this is its choice. */
enum { NEAREST = 20 };
static const struct {
    int joint;
    int16_t vertex[NEAREST];
} tied[] = {{9, {540,  541,  542,  543,  545,  546,  4470, 4471, 4479, 4480,
                 4489, 4490, 4499, 4614, 4615, 4616, 4624, 4625, 4635, 4636}},
            {10, {4021, 4023, 4024, 4026, 4028, 4029, 4230, 4234, 4235, 4239,
                  4240, 4241, 4242, 4243, 4244, 4245, 4246, 4247, 4248, 4249}},
            {11, {4220, 4221, 4223, 4225, 4226, 4227, 4228, 4229, 4350, 4355,
                  4360, 4361, 4362, 4363, 4364, 4365, 4366, 4367, 4368, 4369}},
            {15, {777, 787, 788, 890, 892, 893, 896, 897, 898, 899,
                  900, 901, 902, 903, 904, 905, 906, 907, 908, 909}},
            {22, {6460, 6461, 6463, 6466, 6469, 6590, 6594, 6595, 6596, 6597,
                  6600, 6601, 6602, 6603, 6604, 6605, 6606, 6607, 6608, 6609}},
            {23, {6583, 6584, 6588, 6589, 6740, 6741, 6744, 6745, 6748, 6749,
                  6750, 6751, 6752, 6753, 6754, 6755, 6756, 6757, 6758, 6759}}};

static const double *tube_end(int t) {
    return tube[t].b >= 0 ? joint[tube[t].b] : tube[t].end;
}

/* The tube of a vertex, its ring in the tube. */
static int tube_of(int vertex, int *ring) {
    int r = vertex / SEGMENTS, t = 0;
    while (r >= rings[t]) r -= rings[t++];
    *ring = r;
    return t;
}

static void make_vertices(double *v, int64_t *face, int *faces) {
    double(*out)[3] = (double(*)[3])v;
    int base = 0, f = 0;
    for (int t = 0; t < TUBES; t++) {
        const double *p = joint[tube[t].a], *end = tube_end(t);
        double along[3], d[3], u[3], w[3];
        for (int k = 0; k < 3; k++) along[k] = end[k] - p[k];
        double length = sqrt(dot3(along, along));
        for (int k = 0; k < 3; k++) d[k] = along[k] / length;
        cross3(d, fabs(d[2]) < 0.9 ? (double[3]){0, 0, 1} : (double[3]){0, 1, 0}, u);
        double norm = sqrt(dot3(u, u));
        for (int k = 0; k < 3; k++) u[k] /= norm;
        cross3(d, u, w);
        for (int r = 0; r < rings[t]; r++) {
            double s = (double)r / (rings[t] - 1);
            double radius = tube[t].radius_a + (tube[t].radius_b - tube[t].radius_a) * s;
            for (int i = 0; i < SEGMENTS; i++) {
                double angle = 2 * M_PI * (i + 0.5 * (r % 2)) / SEGMENTS;
                for (int k = 0; k < 3; k++)
                    out[base + r * SEGMENTS + i][k] =
                        p[k] + along[k] * s + radius * (cos(angle) * u[k] + sin(angle) * w[k]);
            }
        }
        for (int r = 0; r + 1 < rings[t]; r++)
            for (int i = 0; i < SEGMENTS; i++) {
                int64_t i0 = base + r * SEGMENTS + i, i1 = base + r * SEGMENTS + (i + 1) % SEGMENTS;
                int64_t two[6] = {i0, i1, i0 + SEGMENTS, i1, i1 + SEGMENTS, i0 + SEGMENTS};
                memcpy(face + 3 * f, two, sizeof two);
                f += 2;
            }
        base += rings[t] * SEGMENTS;
    }
    *faces = f;
}

/* Soft distance to each joint's own tubes. */
static void make_weights(const double *v, double *weights) {
    for (int i = 0; i < V; i++) {
        double distance[JOINTS], min = 1e3, sum = 0;
        for (int j = 0; j < JOINTS; j++) distance[j] = 1e3;
        for (int t = 0; t < TUBES; t++) {
            const double *p = joint[tube[t].a], *end = tube_end(t);
            double along[3], to[3];
            for (int k = 0; k < 3; k++) along[k] = end[k] - p[k], to[k] = v[3 * i + k] - p[k];
            double s = dot3(to, along) / dot3(along, along);
            s = s < 0 ? 0 : s > 1 ? 1 : s;
            for (int k = 0; k < 3; k++) to[k] = v[3 * i + k] - (p[k] + s * along[k]);
            double d = sqrt(dot3(to, to));
            if (d < distance[tube[t].a]) distance[tube[t].a] = d;
            if (d < min) min = d;
        }
        double *w = weights + (size_t)i * JOINTS;
        for (int j = 0; j < JOINTS; j++) {
            w[j] = exp(-(distance[j] - min) / 0.02);
            if (w[j] < 0.02) w[j] = 0;
            sum += w[j];
        }
        for (int j = 0; j < JOINTS; j++) w[j] /= sum;
    }
}

static void make_regressor(const double *v, double *regressor) {
    for (int j = 0; j < JOINTS; j++) {
        double *row = regressor + (size_t)j * V;
        const int16_t *known = NULL;
        for (size_t t = 0; t < COUNT_OF(tied); t++)
            if (tied[t].joint == j) known = tied[t].vertex;
        for (int n = 0; n < NEAREST; n++) {
            int best = -1;
            double min = 1e30;
            for (int i = 0; i < V && !known; i++) {
                double to[3] = {v[3 * i] - joint[j][0], v[3 * i + 1] - joint[j][1],
                                v[3 * i + 2] - joint[j][2]};
                double d = dot3(to, to);
                if (d < min && row[i] == 0) min = d, best = i;
            }
            row[known ? known[n] : best] = 1.0 / NEAREST;
        }
    }
}

static void centred(const char *name, int index, const char *suffix, int n, double scale, double *out) {
    char text[64];
    snprintf(text, sizeof text, "tubeman.%s%d%s", name, index, suffix);
    uint64_t key = fnv1a64(text);
    for (int i = 0; i < n; i++) /* the generator's values are float32 */
        out[i] = (double)(float)(scale * (2.0 * random_uniform(key, (uint64_t)i) - 1.0));
}

/* Height, girth, limb length, then low-frequency waves. */
static void make_shapes(const double *v, double *shapedirs) {
    double freq[BODY_SHAPES][9], amp[BODY_SHAPES][3];
    for (int k = 3; k < BODY_SHAPES; k++) {
        centred("shape", k, ".freq", 9, 4.0, freq[k]);
        centred("shape", k, ".amp", 3, 0.006, amp[k]);
    }
    for (int i = 0; i < V; i++) {
        const double *p = v + 3 * i;
        double *out = shapedirs + (size_t)i * 3 * BODY_SHAPES;
        int ring;
        const double *origin = joint[tube[tube_of(i, &ring)].a];
        out[1 * BODY_SHAPES + 0] = 0.05 * p[1];
        out[0 * BODY_SHAPES + 1] = 0.06 * (p[0] - origin[0]);
        out[2 * BODY_SHAPES + 1] = 0.06 * (p[2] - origin[2]);
        out[0 * BODY_SHAPES + 2] = 0.04 * p[0];
        for (int k = 3; k < BODY_SHAPES; k++)
            for (int a = 0; a < 3; a++)
                out[a * BODY_SHAPES + k] =
                    sin(p[0] * freq[k][a] + p[1] * freq[k][3 + a] + p[2] * freq[k][6 + a]) * amp[k][a];
    }
}

static void make_pose_shapes(const double *v, double *posedirs) {
    double amp[BODY_POSE_FEATURES][3];
    for (int k = 0; k < BODY_POSE_FEATURES; k++) centred("pose", k, "", 3, 0.008, amp[k]);
    for (int i = 0; i < V; i++)
        for (int j = 1; j < JOINTS; j++) {
            double to[3] = {v[3 * i] - joint[j][0], v[3 * i + 1] - joint[j][1], v[3 * i + 2] - joint[j][2]};
            double fall = exp(-dot3(to, to) / (2 * 0.08 * 0.08));
            for (int a = 0; a < 3; a++)
                for (int k = 9 * (j - 1); k < 9 * j; k++)
                    posedirs[((size_t)i * 3 + a) * BODY_POSE_FEATURES + k] = fall * amp[k][a];
        }
}

sherf_status tubeman_arrays_create(context *c, tubeman_arrays *t) {
    *t = (tubeman_arrays){.v_template = mem_zero(c, V, 3 * sizeof(double)),
                          .shapedirs = mem_zero(c, V, 3 * BODY_SHAPES * sizeof(double)),
                          .posedirs = mem_zero(c, V, 3 * BODY_POSE_FEATURES * sizeof(double)),
                          .weights = mem_zero(c, V, JOINTS * sizeof(double)),
                          .regressor = mem_zero(c, V, JOINTS * sizeof(double)),
                          .face = mem_zero(c, FACES_MAX, 3 * sizeof(int64_t))};
    if (!t->v_template || !t->shapedirs || !t->posedirs || !t->weights || !t->regressor || !t->face) {
        tubeman_arrays_free(t);
        return SHERF_NO_MEMORY;
    }
    t->arrays = (body_arrays){.vertices = V,
                              .shape_count = BODY_SHAPES,
                              .v_template = t->v_template,
                              .shapedirs = t->shapedirs,
                              .posedirs = t->posedirs,
                              .weights = t->weights,
                              .regressor = t->regressor,
                              .face = t->face,
                              .parent = parents};
    make_vertices(t->v_template, t->face, &t->arrays.faces);
    make_weights(t->v_template, t->weights);
    make_regressor(t->v_template, t->regressor);
    make_shapes(t->v_template, t->shapedirs);
    make_pose_shapes(t->v_template, t->posedirs);
    return SHERF_OK;
}

void tubeman_arrays_free(tubeman_arrays *t) {
    mem_free(t->v_template);
    mem_free(t->shapedirs);
    mem_free(t->posedirs);
    mem_free(t->weights);
    mem_free(t->regressor);
    mem_free(t->face);
    *t = (tubeman_arrays){0};
}

sherf_status tubeman_create(context *c, body_model **out) {
    *out = NULL;
    tubeman_arrays t;
    sherf_status status = tubeman_arrays_create(c, &t);
    if (status == SHERF_OK) status = body_create(c, &t.arrays, out);
    tubeman_arrays_free(&t);
    return status;
}

/* Limbs that share a colour: trunk, head, hips, and each half of each limb. */
void tubeman_caps(uint32_t triangle[3 * TUBEMAN_CAPS]) {
    uint32_t ring = 0, *out = triangle;
    for (int t = 0; t < TUBES; ring += (uint32_t)rings[t++])
        for (int end = 0; end < 2; end++) {
            const uint32_t first = SEGMENTS * (ring + (end ? (uint32_t)rings[t] - 1 : 0));
            for (uint32_t i = 1; i + 1 < SEGMENTS; i++) {
                *out++ = first;
                *out++ = first + i;
                *out++ = first + i + 1;
            }
        }
}

void tubeman_color(uint64_t person_key, int vertex, float rgb[3]) {
    int ring, t = tube_of(vertex < 0 ? 0 : vertex >= V ? V - 1 : vertex, &ring);
    /* Hues of neighbouring tubes are far apart (golden ratio); the person's key rotates the whole wheel. */
    double hue = random_uniform(person_key, 0) + 0.61803398875 * t,
           full = 0.75 + 0.2 * random_uniform(person_key, 1);
    hue = 6 * (hue - floor(hue));
    int width = 5 + (int)(4 * random_uniform(person_key, 2)); /* rings in a stripe: 4 to 6 cm */
    int dark = ring / width % 2;
    for (int k = 0; k < 3; k++) { /* hue to RGB: a trapezoid, shifted by a third of the wheel */
        double x = fmod(hue + (k == 0 ? 0 : k == 1 ? 4 : 2), 6);
        double level = fabs(x - 3) - 1;
        level = level < 0 ? 0 : level > 1 ? 1 : level;
        double value = 1 - full * (1 - level);
        rgb[k] = (float)(dark ? 0.35 * value : 0.15 + 0.85 * value);
    }
}
