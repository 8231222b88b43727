/* bench: what the files of `sherf bench` share. */
#ifndef SHERF_BENCH_H
#define SHERF_BENCH_H

#include "avatar/avatar.h"
#include "train/trainer.h"

typedef struct {
    context *c;
    const char *preset;
    int size, repeats;
    body_model *body; /* the tube person's */
    sherf_observation *observation, *target;
    model *model; /* with made-up weights */
    /* What people use: given with the options, or NULL. */
    const sherf_model *real_model;
    const sherf_body *real_body;
    const sherf_observation *real_observation;
} bench;

enum { REPEATS_MAX = 1000 };
/* bench_time.c: the median milliseconds of `once`: one run to warm up, then b->repeats, or what fits in some
 * seconds. */
sherf_status bench_timed(bench *b, sherf_status (*once)(bench *b, void *arg), void *arg, double *ms);

/* ---- bench_share.c: how near the processor's peak ---- */
/* GFLOP/s of float32 multiply-adds (two each) of the context's threads together, in registers: the best of
 * some short runs. Once a process. */
double bench_fma_gflops(const context *c);
enum { SHARE_CONVOLUTIONS, SHARE_SPARSE, SHARE_LINEAR, SHARE_NETWORK, SHARES };
/* GFLOP/s of each part; 0: not measured. */
typedef struct {
    double gflops[SHARES];
} bench_shares;
/* Measures an encoding's ops, forwards and with `training` also backwards, on the tube person. */
sherf_status bench_encode_shares(bench *b, bool training, bench_shares *out);
/* Measures querying all points of one frame, skipping none. Not measured where the model does not give its
 * multiply-adds per point. */
sherf_status bench_network_share(bench *b, const sherf_avatar *a, bench_shares *out);
/* `"fma_gflops": X, "share_of_peak": {"convolutions": X, ...}`, and for people a line. Free with mem_free. */
char *bench_shares_json(context *c, const bench_shares *s);
char *bench_shares_text(context *c, const bench_shares *s);

/* ---- bench_real.c: a person rendered by the model that ships, as people use it ---- */
/* All three are given. */
bool bench_has_real(const bench *b);
/* Milliseconds of an avatar, of its first frame, including what is computed once, and of a further frame with
 * detail, seen from the front, size x size. */
typedef struct {
    double avatar_ms, first_frame_ms, frame_ms;
} bench_real_times;
sherf_status bench_real_render(bench *b, bench_real_times *out);
/* An avatar alone, and its GLB as `sherf export` writes it: all of it, and the parts of sherf_exported. */
sherf_status bench_real_avatar(bench *b, double *ms);
sherf_status bench_real_export(bench *b, double *ms, double parts_ms[4]);

#endif
