/* tubeman: a body of tubes in the layout of an SMPL file, without any owner; for tests, synth and bench. The
 * same numbers as the reference's generator: 6890 vertices, 24 joints, 10 shapes, 207 pose blend shapes. */
#ifndef SHERF_TUBEMAN_H
#define SHERF_TUBEMAN_H
#include "body/body.h"
sherf_status tubeman_create(context *c, body_model **out);
/* The same in double, as in the generator's file: for writing files in SMPL's formats. */
typedef struct {
    double *v_template, *shapedirs, *posedirs, *weights, *regressor;
    int64_t *face;
    body_arrays arrays; /* the same, as body_create takes it */
} tubeman_arrays;
sherf_status tubeman_arrays_create(context *c, tubeman_arrays *out);
void tubeman_arrays_free(tubeman_arrays *t);
/* Triangles that close the tubes' open ends. */
enum { TUBEMAN_CAPS = 400 };
void tubeman_caps(uint32_t triangle[3 * TUBEMAN_CAPS]);
/* Colour of a surface point of the striped tube person number `person`: limb colours and stripes. */
void tubeman_color(uint64_t person_key, int vertex, float rgb[3]);
#endif
