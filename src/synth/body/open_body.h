/* open_body: a freely usable body with SMPL's skeleton and axes, made from a source's shapes: the mean, ten
 * principal components of one standard deviation each, joints regressed from the mesh, weights. docs/body.md
 * describes the file. */
#ifndef SHERF_OPEN_BODY_H
#define SHERF_OPEN_BODY_H

#include "synth/body/body_source.h"
#include "synth/body/makehuman.h"
#include "synth/body/tpose.h"

/* ---- MakeHuman as a source ---- */
/* The adult with this number: sex, 18 to 80 years, weight, muscle, height, proportions, breasts, ethnicity.
 * The same number is always the same person. */
void open_body_adult(uint64_t key, makehuman_macro *out);
/* Keeps pointers to human and rig; weights: of the body. */
typedef struct {
    body_source source;
    const makehuman *human;
    const tpose_rig *rig;
    float *weights;
} makehuman_source;
sherf_status makehuman_source_create(context *c, const makehuman *human, const tpose_rig *rig,
                                     makehuman_source **out);
void makehuman_source_free(makehuman_source *s);

/* ---- building ---- */
typedef struct {
    int samples;
    double kept;                   /* share of the samples' variance in the components */
    double share[BODY_SHAPES];     /* of each */
    double stature_m[BODY_SHAPES]; /* by one standard deviation */
    double volume_l[BODY_SHAPES];  /* litres */
    double correlation[BODY_SHAPES][SOURCE_PARAMETERS_MAX]; /* of the samples' betas with their parameters */
    double joint_error_mm, joint_error_mean_mm; /* regressed joints against the source's, over the samples */
    double error_mm; /* root mean square distance of vertices with ten components */
} open_body_report;
/* samples: 64 to 4096. Memory: samples * V * 12 bytes. The same source and number give the same bytes. */
sherf_status open_body_create(context *c, const body_source *source, int samples, body_model **out,
                              open_body_report *report);
/* The body with UVs (uv, f_uv) and its known properties as metadata. */
sherf_status open_body_save(context *c, const body_source *source, const body_model *body,
                            const open_body_report *report, const char *path);

/* One line about component k: variance, the effect of one standard deviation, correlated parameters. */
enum { OPEN_BODY_LINE = 256 };
void open_body_describe(const body_source *source, const open_body_report *report, int k,
                        char out[OPEN_BODY_LINE]);

/* The betas whose body is nearest to this rest-pose mesh (least squares over the body's vertices); the mesh
 * may have more vertices after them. They describe a person that is drawn with its exact mesh. */
sherf_status open_body_project(context *c, const body_model *body, const float *vertices,
                               float shape[BODY_SHAPES]);

/* Volume of a closed mesh in cubic metres. */
double mesh_volume(int64_t triangles, const uint32_t *triangle, const float *vertices);

/* Pictures to check by eye: rest pose, walk, sitting, arms up from four sides, and every component at -2
 * and 2. */
sherf_status open_body_sheet(context *c, const body_model *body, const char *png);

#endif
