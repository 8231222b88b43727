/* Clips in time: interpolation, resampling, smoothing, loops. */
#include <math.h>
#include <string.h>

#include "motion/motion.h"

sherf_status clip_create(context *c, int frames, double fps, clip *out) {
    *out = (clip){.frames = frames, .fps = fps};
    if (frames < 1 || frames > MOTION_FRAMES_MAX)
        return failure(c, SHERF_BAD_FILE, "%d frames, of 1 to %d", frames, MOTION_FRAMES_MAX);
    if (!(fps >= 0.01 && fps <= 10000)) return failure(c, SHERF_BAD_FILE, "%g frames a second", fps);
    out->turn = mem_zero(c, (size_t)frames, sizeof *out->turn);
    out->pelvis_m = mem_zero(c, (size_t)frames, sizeof *out->pelvis_m);
    if (out->turn && out->pelvis_m) return SHERF_OK;
    clip_free(out);
    return SHERF_NO_MEMORY;
}

void clip_free(clip *k) {
    mem_free(k->turn);
    mem_free(k->pelvis_m);
    *k = (clip){0};
}

static void replace(clip *k, clip *with) {
    clip_free(k);
    *k = *with;
}

static void between(const clip *k, int a, int b, double t, float turn[BODY_JOINTS][4], float pelvis_m[3]) {
    for (int j = 0; j < BODY_JOINTS; j++) quaternion_slerp(k->turn[a][j], k->turn[b][j], t, turn[j]);
    for (int i = 0; i < 3; i++) pelvis_m[i] = (float)((1 - t) * k->pelvis_m[a][i] + t * k->pelvis_m[b][i]);
}

void clip_at(const clip *k, double at, float turn[BODY_JOINTS][4], float pelvis_m[3]) {
    at = !(at > 0) ? 0 : at < k->frames - 1 ? at : k->frames - 1;
    int a = (int)at, b = a + 1 < k->frames ? a + 1 : a;
    between(k, a, b, at - a, turn, pelvis_m);
}

sherf_status clip_spread(context *c, clip *k, const int64_t *number) {
    clip out;
    int64_t span = number[k->frames - 1] - number[0];
    if (span < k->frames - 1 || span >= MOTION_FRAMES_MAX)
        return failure(c, SHERF_BAD_FILE, "frames numbered from %lld to %lld, of which %d are there",
                       (long long)number[0], (long long)number[k->frames - 1], k->frames);
    if (span == k->frames - 1) return SHERF_OK;
    sherf_status status = clip_create(c, (int)span + 1, k->fps, &out);
    if (status) return status;
    for (int i = 0, a = 0; i < out.frames; i++) {
        int64_t n = number[0] + i;
        while (a + 1 < k->frames && number[a + 1] <= n) a++;
        int b = a + 1 < k->frames ? a + 1 : a;
        double t = b > a ? (double)(n - number[a]) / (double)(number[b] - number[a]) : 0;
        between(k, a, b, t, out.turn[i], out.pelvis_m[i]);
    }
    replace(k, &out);
    return SHERF_OK;
}

sherf_status clip_crop(context *c, clip *k, int first, int count) {
    clip out;
    if (first == 0 && count == k->frames) return SHERF_OK;
    sherf_status status = clip_create(c, count, k->fps, &out);
    if (status) return status;
    memcpy(out.turn, k->turn + first, (size_t)count * sizeof *out.turn);
    memcpy(out.pelvis_m, k->pelvis_m + first, (size_t)count * sizeof *out.pelvis_m);
    replace(k, &out);
    return SHERF_OK;
}

sherf_status clip_resample(context *c, clip *k, double fps) {
    clip out;
    if (fps == k->fps) return SHERF_OK;
    double frames = floor((k->frames - 1) / k->fps * fps + 1e-6) + 1;
    if (!(frames <= MOTION_FRAMES_MAX))
        return failure(c, SHERF_BAD_ARGUMENT, "%g frames at %g a second: more than %d", frames, fps,
                       MOTION_FRAMES_MAX);
    sherf_status status = clip_create(c, (int)frames, fps, &out);
    if (status) return status;
    for (int i = 0; i < out.frames; i++) clip_at(k, i * k->fps / fps, out.turn[i], out.pelvis_m[i]);
    replace(k, &out);
    return SHERF_OK;
}

/* ---- smoothing ---- */
enum { RADIUS_MAX = 1000 };

/* Frame i of a clip that continues beyond its ends: mirrored in time and about the end's value, x(-i) = 2
 * x(0) - x(i), so that a steady motion stays steady. */
static void beyond(const clip *k, int joint, int i, float out[4]) {
    int last = k->frames - 1, end = i < 0 ? 0 : last, mirrored = i < 0 ? -i : 2 * last - i;
    if (i >= 0 && i <= last) {
        memcpy(out, k->turn[i][joint], sizeof k->turn[i][joint]);
        return;
    }
    mirrored = mirrored < 0 ? 0 : mirrored > last ? last : mirrored;
    float back[4];
    quaternion_inverse(k->turn[mirrored][joint], back);
    quaternion_multiply(back, k->turn[end][joint], out);
    quaternion_multiply(k->turn[end][joint], out, out);
}

static double beyond_place(const float (*path)[3], int count, int axis, int i) {
    int last = count - 1, end = i < 0 ? 0 : last, mirrored = i < 0 ? -i : 2 * last - i;
    if (i >= 0 && i <= last) return path[i][axis];
    mirrored = mirrored < 0 ? 0 : mirrored > last ? last : mirrored;
    return 2.0 * path[end][axis] - path[mirrored][axis];
}

typedef struct {
    int radius;
    double weight[RADIUS_MAX + 1];
} kernel;

/* A Gaussian, its standard deviation in frames. */
static void kernel_make(double sigma, int frames, kernel *out) {
    double sum = 0;
    out->radius = (int)fmin(ceil(3 * sigma), fmin(RADIUS_MAX, frames - 1));
    for (int d = 0; d <= out->radius; d++) {
        out->weight[d] = exp(-0.5 * d * d / (sigma * sigma));
        sum += d ? 2 * out->weight[d] : out->weight[d];
    }
    for (int d = 0; d <= out->radius; d++) out->weight[d] /= sum;
}

static void smooth_place(const float (*path)[3], int count, const kernel *g, int at, float out[3]) {
    for (int a = 0; a < 3; a++) {
        double sum = 0;
        for (int d = -g->radius; d <= g->radius; d++)
            sum += g->weight[d < 0 ? -d : d] * beyond_place(path, count, a, at + d);
        out[a] = (float)sum;
    }
}

void path_smooth(const float (*path)[3], int count, double sigma, float (*out)[3]) {
    kernel g;
    kernel_make(sigma, count, &g);
    for (int i = 0; i < count; i++) smooth_place(path, count, &g, i, out[i]);
}

/* The mean of nearby rotations is that of their quaternions, on one half of the sphere. */
static void smooth_turns(const clip *k, const kernel *g, int frame, float (*out)[4]) {
    for (int j = 0; j < BODY_JOINTS; j++) {
        const float *middle = k->turn[frame][j];
        double sum[4] = {0}, length = 0;
        for (int d = -g->radius; d <= g->radius; d++) {
            float q[4];
            beyond(k, j, frame + d, q);
            double side = 0, w = g->weight[d < 0 ? -d : d];
            for (int i = 0; i < 4; i++) side += (double)q[i] * middle[i];
            for (int i = 0; i < 4; i++) sum[i] += side < 0 ? -w * q[i] : w * q[i];
        }
        for (int i = 0; i < 4; i++) length += sum[i] * sum[i];
        for (int i = 0; i < 4; i++) out[j][i] = length > 1e-12 ? (float)(sum[i] / sqrt(length)) : middle[i];
    }
}

typedef struct {
    const clip *from;
    clip *to;
    const kernel *kernel;
} smooth_job;

static void smooth_range(void *arg, int64_t begin, int64_t end, int thread) {
    const smooth_job *s = arg;
    for (int i = (int)begin; i < (int)end; i++) {
        smooth_turns(s->from, s->kernel, i, s->to->turn[i]);
        smooth_place((const float(*)[3])s->from->pelvis_m, s->from->frames, s->kernel, i, s->to->pelvis_m[i]);
    }
}

sherf_status clip_smooth(context *c, clip *k, double seconds) {
    double sigma = seconds * k->fps;
    kernel g;
    clip out;
    if (!(sigma > 0.01)) return SHERF_OK;
    sherf_status status = clip_create(c, k->frames, k->fps, &out);
    if (status) return status;
    kernel_make(sigma, k->frames, &g);
    parallel_for(c, k->frames, 64, smooth_range, &(smooth_job){k, &out, &g});
    replace(k, &out);
    return SHERF_OK;
}

/* ---- loops and the blend before the motion ---- */

static double eased(double t) { /* 0 to 1, slow at both ends */
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    return t * t * (3 - 2 * t);
}

void clip_loop(clip *k) {
    static const float unit[4] = {1, 0, 0, 0};
    int last = k->frames - 1;
    if (last < 1) return;
    double window = fmin(fmax(1, 0.5 * k->fps), fmax(1, last / 2.0));
    for (int j = 0; j < BODY_JOINTS; j++) {
        float gain[4], part[4];
        quaternion_inverse(k->turn[last][j], gain);
        quaternion_multiply(k->turn[0][j], gain, gain);
        for (int i = 0; i <= last; i++) {
            double t = j ? eased(1 - (last - i) / window) : (double)i / last;
            quaternion_slerp(unit, gain, t, part);
            quaternion_multiply(part, k->turn[i][j], k->turn[i][j]);
        }
    }
    for (int a = 0; a < 3; a++) {
        double gain = (double)k->pelvis_m[0][a] - k->pelvis_m[last][a];
        for (int i = 0; i <= last; i++) k->pelvis_m[i][a] += (float)(gain * i / last);
    }
    k->frames = last;
}

sherf_status clip_lead_in(context *c, clip *k, int count, const float turn[BODY_JOINTS][4],
                          const float pelvis_m[3]) {
    clip out;
    if (count < 1) return SHERF_OK;
    if (count > MOTION_FRAMES_MAX - k->frames)
        return failure(c, SHERF_BAD_ARGUMENT, "more than %d frames with the blend", MOTION_FRAMES_MAX);
    sherf_status status = clip_create(c, k->frames + count, k->fps, &out);
    if (status) return status;
    for (int i = 0; i < count; i++) {
        double t = eased((double)i / count);
        for (int j = 0; j < BODY_JOINTS; j++) quaternion_slerp(turn[j], k->turn[0][j], t, out.turn[i][j]);
        for (int a = 0; a < 3; a++)
            out.pelvis_m[i][a] = (float)((1 - t) * pelvis_m[a] + t * k->pelvis_m[0][a]);
    }
    memcpy(out.turn + count, k->turn, (size_t)k->frames * sizeof *out.turn);
    memcpy(out.pelvis_m + count, k->pelvis_m, (size_t)k->frames * sizeof *out.pelvis_m);
    replace(k, &out);
    return SHERF_OK;
}
