/* What makes the samples near the body shares with what makes those of a coarse frame. */
#ifndef SHERF_POINTS_INSIDE_H
#define SHERF_POINTS_INSIDE_H

#include "sampling/coarse.h"
#include "scene/ray.h"

/* The coarse field's values on every stride-th ray of every stride-th row; rays in between interpolate them.
 * A pixel of a large picture is much smaller than a cell of the field. stride 1: there is no lattice. */
typedef struct {
    int stride, columns, rows;
    int32_t *low, *high; /* by ray of the lattice: values are kept of its samples low <= i < high */
    int32_t *end;        /* the first sample that was not evaluated, since it is hidden */
    int64_t *first;      /* the slot of sample `low`; one more for the number of slots */
    float (*value)[4];   /* by slot; 0 for samples that are not near the body */
} ray_lattice;

/* ---- one frame's work ---- */
typedef struct {
    const body_model *body;
    const posed_body *target, *observation;
    const sherf_camera *camera;
    const ray_bundle *rays;
    int samples, words; /* words: 64-bit words of sample bits a ray */
    int64_t chunk;      /* rays of one piece of work */
    const vertex_grid *grid;
    const vertex_shell *shell;
    const occupancy_grid *empty; /* or NULL */
    /* coarse frames only: `out` has the queried samples, `sample` the bits of all */
    const coarse_field *coarse;
    float pitch_m; /* between pixels */
    coarse_points *answer;
    float heavy_per_m; /* samples with a larger weight per metre of their ray are queried */
    bool sparse;       /* every other sample of medium weight is queried */
    ray_lattice lattice;
    uint64_t *query;    /* rays x words: bits of the queried samples */
    float (*value)[4];  /* of all, by chunk from candidate[chunk] on */
    float *fraction;    /* depth i = near + (far - near) * fraction[i] */
    uint64_t *sample;   /* rays x words: first the candidates, then the kept */
    int64_t *candidate; /* chunks + 1: the first slot of a chunk in `nearest` */
    int32_t *nearest;   /* of the kept, by chunk from candidate[chunk] on */
    int32_t *kept;      /* chunks */
    point_set *out;
} points_job;

static inline int64_t chunk_count(const points_job *job) {
    return (job->out->rays + job->chunk - 1) / job->chunk;
}

static inline int64_t chunk_end(const points_job *job, int64_t chunk) {
    int64_t end = (chunk + 1) * job->chunk;
    return end < job->out->rays ? end : job->out->rays;
}

static inline void sample_smpl(const points_job *job, int64_t n, int i, float out[3]) {
    const ray_bundle *r = job->rays;
    const float *R = job->target->R, *Th = job->target->Th, *d = r->direction + 3 * n;
    const float t = r->near[n] + (r->far[n] - r->near[n]) * job->fraction[i];
    ray_point_smpl(r->origin_world, d, t, R, Th, out);
}

/* ---- coarse frames: the field and its lattice (points_lattice.c) ---- */
/* Transmittance below which the rest of a ray is hidden. */
#define COARSE_HIDDEN 3e-3f
/* A ray's opacity over one of its steps is 1 - exp(-density times this). */
float points_step_m(const points_job *job, int64_t n);
/* A sample's place and nearest vertex; false if it is not near the body. *guess: a vertex near it, or -1;
 * becomes its nearest one. */
bool points_nearest(const points_job *job, int64_t n, int i, float x[3], int32_t *guess);
/* The coarse field's value at a sample; as points_nearest. */
bool points_coarse_value(const points_job *job, int64_t n, int i, int32_t *guess, float value[4]);
/* Between passes 1 and 2: evaluates the lattice's rays. Free with ray_lattice_free, even after an error. */
sherf_status ray_lattice_create(context *c, points_job *job);
/* The lattice's rays round another ray: up to four, with their weights. */
typedef struct {
    int count;
    float weight[4];
    struct {
        int64_t at; /* the slot of sample 0, if there were one */
        int32_t low, high, end;
    } ray[4];
    float opaque; /* densities above this count as equal */
    float differ; /* others may differ by this */
} ray_surrounding;
/* False where the lattice ends, or where samples of its rays have other depths than ray n's. step_m: the
 * ray's. */
bool ray_lattice_surround(const points_job *job, int64_t n, float step_m, ray_surrounding *s);
/* Interpolates the value of sample i. False if a ray of the lattice does not reach it, or if their opacities
 * over a step differ. */
bool ray_lattice_value(const ray_lattice *l, const ray_surrounding *s, int i, float value[4]);
void ray_lattice_free(ray_lattice *l);

/* ---- coarse frames: their passes (points_coarse.c) ---- */
/* Pass 2: goes along a chunk's rays and chooses the samples to query. */
void points_walk(const points_job *job, int64_t chunk);
/* Between passes 2 and 3. */
sherf_status points_allocate_coarse(context *c, points_job *job);
/* Pass 3 for all samples. */
void points_fill_coarse(const points_job *job, int64_t chunk);

#endif
