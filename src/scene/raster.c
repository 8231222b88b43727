/* z-buffered triangles. With q_k = K x_k the corners in homogeneous pixels, a pixel P = (i, j, 1) is
 *   P = l_0 q_0 + l_1 q_1 + l_2 q_2,  l_0 = (q_1 x q_2) . P / det, ...
 * It lies in the triangle where all l_k >= 0; its depth is 1 / (l_0 + l_1 + l_2) and its perspective-correct
 * barycentric coordinates are l_k times that. Nothing is divided by a corner's depth, so triangles that cross
 * the camera's plane need no clipping. Neighbours share an edge function up to its sign: no gaps. */
#include <math.h>
#include <string.h>

#include "base/vector3.h"
#include "scene/scene.h"

enum { BAND = 16 }; /* rows in a unit of work */
static const double near_m = 1e-3;

typedef struct {
    const uint32_t *face;
    int64_t faces, vertices;
    const float *vertex_world;
    double K[6], R[9], T[3]; /* K of the finer picture */
    double *q;               /* V x 3 */
    int32_t *rows;           /* F x 2: first row, one past the last */
    raster *out;
} raster_job;

static void project_vertices(void *arg, int64_t begin, int64_t end, int thread) {
    const raster_job *job = arg;
    const double *K = job->K, *R = job->R;
    for (int64_t v = begin; v < end; v++) {
        const float *p = job->vertex_world + 3 * v;
        double x[3], *q = job->q + 3 * v;
        for (int k = 0; k < 3; k++)
            x[k] = R[3 * k] * p[0] + R[3 * k + 1] * p[1] + R[3 * k + 2] * p[2] + job->T[k];
        q[0] = K[0] * x[0] + K[1] * x[1] + K[2] * x[2];
        q[1] = K[3] * x[0] + K[4] * x[1] + K[5] * x[2];
        q[2] = x[2];
    }
}

/* Bounds along one axis (0: columns, 1: rows) of a triangle's part beyond the near plane, as the pixels
 * [*first, *end) inside the picture. */
static void pixel_range(const double *const q[3], int axis, int size, int *first, int *end) {
    double min = INFINITY, max = -INFINITY;
    for (int k = 0; k < 3; k++) {
        const double *a = q[k], *b = q[(k + 1) % 3];
        if (a[2] >= near_m) {
            min = fmin(min, a[axis] / a[2]);
            max = fmax(max, a[axis] / a[2]);
        }
        if ((a[2] >= near_m) != (b[2] >= near_m)) {
            double at = a[axis] + (b[axis] - a[axis]) * (near_m - a[2]) / (b[2] - a[2]);
            min = fmin(min, at / near_m);
            max = fmax(max, at / near_m);
        }
    }
    /* a hundredth of a pixel covers rounding; the edge functions decide */
    min = ceil(min - 0.01), max = floor(max + 0.01);
    *first = !(min > 0) ? 0 : min < size ? (int)min : size;
    *end = !(max >= 0) ? 0 : max < size ? (int)max + 1 : size;
}

static void face_corners(const raster_job *job, int64_t f, const double *q[3]) {
    for (int k = 0; k < 3; k++) q[k] = job->q + 3 * (size_t)job->face[3 * f + k];
}

static void bound_faces(void *arg, int64_t begin, int64_t end, int thread) {
    const raster_job *job = arg;
    for (int64_t f = begin; f < end; f++) {
        const double *q[3];
        face_corners(job, f, q);
        pixel_range(q, 1, job->out->height, job->rows + 2 * f, job->rows + 2 * f + 1);
    }
}

static void draw_face(const raster_job *job, int64_t f, int row0, int row1) {
    raster *r = job->out;
    const double *q[3];
    double e[3][3];
    int column0, column1;
    face_corners(job, f, q);
    for (int k = 0; k < 3; k++) cross3(q[(k + 1) % 3], q[(k + 2) % 3], e[k]);
    double det = q[0][0] * e[0][0] + q[0][1] * e[0][1] + q[0][2] * e[0][2];
    if (!(fabs(det) > 0) || !isfinite(det)) return; /* seen edge-on, or not finite */
    pixel_range(q, 0, r->width, &column0, &column1);
    for (int j = row0; j < row1; j++)
        for (int i = column0; i < column1; i++) {
            double l[3];
            for (int k = 0; k < 3; k++) l[k] = (e[k][0] * i + e[k][1] * j + e[k][2]) / det;
            if (!(l[0] >= 0 && l[1] >= 0 && l[2] >= 0)) continue;
            double z = 1 / (l[0] + l[1] + l[2]);
            size_t n = (size_t)j * (size_t)r->width + (size_t)i;
            if (!(z >= near_m && (float)z < r->depth[n])) continue;
            r->depth[n] = (float)z;
            r->face[n] = (int32_t)f;
            for (int k = 0; k < 3; k++) r->barycentric[3 * n + k] = (float)(l[k] * z);
        }
}

static void draw_band(const raster_job *job, int row0, int row1) {
    raster *r = job->out;
    for (size_t n = (size_t)row0 * (size_t)r->width; n < (size_t)row1 * (size_t)r->width; n++) {
        r->depth[n] = INFINITY;
        r->face[n] = -1;
        memset(r->barycentric + 3 * n, 0, 3 * sizeof *r->barycentric);
    }
    for (int64_t f = 0; f < job->faces; f++) {
        int first = job->rows[2 * f], end = job->rows[2 * f + 1];
        first = first > row0 ? first : row0;
        end = end < row1 ? end : row1;
        if (first < end) draw_face(job, f, first, end);
    }
}

static sherf_status check_raster(context *c, const sherf_camera *camera, int supersample, int64_t vertices,
                                 int64_t faces, const uint32_t *face) {
    enum { SUPERSAMPLE_MAX = 16, SIDE_MAX = 1 << 15 };
    sherf_status status = camera_check(c, camera);
    if (status != SHERF_OK) return status;
    if (supersample < 1 || supersample > SUPERSAMPLE_MAX || camera->width_px > SIDE_MAX / supersample ||
        camera->height_px > SIDE_MAX / supersample)
        return failure(c, SHERF_BAD_ARGUMENT, "raster: %d x %d pixels, %d times finer, sides are at most %d",
                       camera->width_px, camera->height_px, supersample, SIDE_MAX);
    if (vertices < 0 || faces < 0 || faces > INT32_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "raster: %lld vertices and %lld faces", (long long)vertices,
                       (long long)faces);
    for (int64_t i = 0; i < 3 * faces; i++)
        if (face[i] >= vertices)
            return failure(c, SHERF_BAD_ARGUMENT, "raster: face %lld names vertex %u of %lld",
                           (long long)i / 3, face[i], (long long)vertices);
    return SHERF_OK;
}

sherf_status raster_create(context *c, const sherf_camera *camera, int supersample, int64_t vertices,
                           const float *vertex_world, int64_t faces, const uint32_t *face, raster **out) {
    *out = NULL;
    sherf_status status = check_raster(c, camera, supersample, vertices, faces, face);
    if (status != SHERF_OK) return status;
    raster_job job = {.face = face, .faces = faces, .vertices = vertices, .vertex_world = vertex_world};
    raster *r = mem_zero(c, 1, sizeof *r);
    if (!r) return SHERF_NO_MEMORY;
    r->width = camera->width_px * supersample;
    r->height = camera->height_px * supersample;
    size_t pixels = (size_t)r->width * (size_t)r->height;
    r->depth = mem_alloc(c, pixels, sizeof *r->depth);
    r->face = mem_alloc(c, pixels, sizeof *r->face);
    r->barycentric = mem_alloc(c, pixels, 3 * sizeof *r->barycentric);
    job.q = mem_alloc(c, (size_t)vertices, 3 * sizeof *job.q);
    job.rows = mem_alloc(c, (size_t)faces, 2 * sizeof *job.rows);
    job.out = r;
    if (!r->depth || !r->face || !r->barycentric || !job.q || !job.rows) {
        status = SHERF_NO_MEMORY;
        goto done;
    }
    /* pixel centres at integers: column i of the finer picture is column (i + 0.5) / s - 0.5 of the camera's
     */
    for (int k = 0; k < 6; k++)
        job.K[k] = supersample * (double)camera->K[k] + 0.5 * (supersample - 1) * camera->K[6 + k % 3];
    for (int k = 0; k < 9; k++) job.R[k] = camera->R[k];
    for (int k = 0; k < 3; k++) job.T[k] = camera->T_m[k];
    parallel_for(c, vertices, 4096, project_vertices, &job);
    parallel_for(c, faces, 4096, bound_faces, &job);
    int bands = (r->height + BAND - 1) / BAND;
#pragma omp parallel for schedule(dynamic) num_threads(c->threads)
    for (int b = 0; b < bands; b++)
        draw_band(&job, b * BAND, (b + 1) * BAND < r->height ? (b + 1) * BAND : r->height);
done:
    mem_free(job.q);
    mem_free(job.rows);
    if (status == SHERF_OK)
        *out = r;
    else
        raster_free(r);
    return status;
}

void raster_free(raster *r) {
    if (!r) return;
    mem_free(r->depth);
    mem_free(r->face);
    mem_free(r->barycentric);
    mem_free(r);
}
