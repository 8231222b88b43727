/* Tests of the fused radiance field against the network written out step by step in double, at every
 * instruction set that the machine has. */
#include "support.h"

#include "radiance_field_made.h"

/* ---- the network, un-fused ---- */
enum { WIDE = 512 };

static void linear(const float *w, const float *b, const double *x, int in, int out, double *y) {
    for (int o = 0; o < out; o++) {
        y[o] = b ? b[o] : 0;
        for (int k = 0; k < in; k++) y[o] += (double)w[(size_t)o * (size_t)in + (size_t)k] * x[k];
    }
}

static int encode(const double x[3], int frequencies, double *y) {
    int n = 0;
    for (int i = 0; i < 3; i++) y[n++] = x[i];
    for (int k = 0; k < frequencies; k++) {
        for (int i = 0; i < 3; i++) y[n++] = sin(ldexp(x[i], k));
        for (int i = 0; i < 3; i++) y[n++] = sin(ldexp(x[i], k) + 1.5707963267948966);
    }
    return n;
}

static void bilinear(const float *map, int width, int height, int channels, double x, double y, double *out) {
    for (int c = 0; c < channels; c++) out[c] = 0;
    if (!(fabs(x) < 1e6 && fabs(y) < 1e6)) return;
    for (int k = 0; k < 4; k++) {
        int ix = (int)floor(x) + (k & 1), iy = (int)floor(y) + (k >> 1);
        if (ix < 0 || iy < 0 || ix >= width || iy >= height) continue;
        double w = (1 - fabs(x - ix)) * (1 - fabs(y - iy));
        for (int c = 0; c < channels; c++)
            out[c] += w * map[((size_t)iy * (size_t)width + (size_t)ix) * (size_t)channels + (size_t)c];
    }
}

static void trilinear(const radiance_bank *b, int level, const float p[3], int channels, double *out) {
    for (int c = 0; c < channels; c++) out[c] = 0;
    const int *size = b->level[level].size;
    double at[3];
    for (int i = 0; i < 3; i++) {
        double g = ((double)p[i] - b->volume_min[i]) / b->voxel_size_m / b->volume_size[2 - i] * 2 - 1;
        at[i] = (g + 1) / 2 * (size[2 - i] - 1);
        if (!(fabs(at[i]) < 1e6)) return;
    }
    for (int k = 0; k < 8; k++) {
        int x = (int)floor(at[0]) + (k & 1), y = (int)floor(at[1]) + (k >> 1 & 1),
            z = (int)floor(at[2]) + (k >> 2);
        if (x < 0 || y < 0 || z < 0 || x >= size[2] || y >= size[1] || z >= size[0]) continue;
        int32_t row =
            b->level[level].grid[((size_t)z * (size_t)size[1] + (size_t)y) * (size_t)size[2] + (size_t)x];
        if (row < 0) continue;
        double w = (1 - fabs(at[0] - x)) * (1 - fabs(at[1] - y)) * (1 - fabs(at[2] - z));
        for (int c = 0; c < channels; c++)
            out[c] += w * b->level[level].value[(size_t)row * (size_t)channels + (size_t)c];
    }
}

static void norm(const double *x, int n, const float *w, const float *b, double *y) {
    double mean = 0, variance = 0;
    for (int i = 0; i < n; i++) mean += x[i] / n;
    for (int i = 0; i < n; i++) variance += (x[i] - mean) * (x[i] - mean) / n;
    for (int i = 0; i < n; i++) y[i] = (x[i] - mean) / sqrt(variance + 1e-5) * w[i] + b[i];
}

static void reference_tokens(const made *fixture, int64_t p, double token[3][WIDE]) {
    static const int axis[3][2] = {{0, 1}, {0, 2}, {2, 1}};
    const radiance_bank *b = &fixture->bank;
    int d = fixture->s.token_width, f = fixture->s.feature_channels;
    const float *x = fixture->points.canonical + 3 * p, *uv = fixture->points.observed_px + 2 * p;
    double plane[3][WIDE], pixel[WIDE], volume[WIDE], point[WIDE], rgb[3], n[3];
    for (int i = 0; i < 3; i++)
        n[i] = ((double)x[i] - b->plane_min[i]) / ((double)b->plane_max[i] - b->plane_min[i]) * 2 - 1;
    int size = b->plane_size;
    for (int i = 0; i < 3; i++)
        bilinear(b->planes + (size_t)i * (size_t)size * (size_t)size * (size_t)d, size, size, d,
                 ((n[axis[i][0]] + 1) * size - 1) / 2, ((n[axis[i][1]] + 1) * size - 1) / 2, plane[i]);
    double u = (double)uv[0] / b->image_width, v = (double)uv[1] / b->image_height;
    bilinear(b->features, b->feature_width, b->feature_height, f, u * (b->feature_width - 1),
             v * (b->feature_height - 1), pixel);
    bilinear(b->image, b->image_width, b->image_height, 3, u * (b->image_width - 1),
             v * (b->image_height - 1), rgb);
    encode(rgb, fixture->s.color_frequencies, pixel + f);
    int columns = 0;
    for (int l = 0; l < 3; l++) {
        trilinear(b, l, x, fixture->s.volume_channels[l], volume + columns);
        columns += fixture->s.volume_channels[l];
    }
    linear(fixture->w.volume_projection_w, fixture->w.volume_projection_b, volume, columns, 3 * d, point);
    for (int i = 0; i < 3; i++) {
        double in[WIDE];
        memcpy(in, plane[i], (size_t)d * sizeof *in);
        memcpy(in + d, pixel + i * d, (size_t)d * sizeof *in);
        memcpy(in + 2 * d, point + i * d, (size_t)d * sizeof *in);
        linear(fixture->w.token_projection_w, fixture->w.token_projection_b, in, 3 * d, d, token[i]);
    }
}

static void reference_transformer(const made *fixture, double token[3][WIDE]) {
    int d = fixture->s.token_width, head = fixture->s.head_width, all = fixture->s.heads * head;
    double qkv[3][WIDE], mixed[3][WIDE], y[WIDE], z[WIDE];
    for (int i = 0; i < 3; i++) {
        norm(token[i], d, fixture->w.norm0_w, fixture->w.norm0_b, y);
        linear(fixture->w.qkv_w, NULL, y, d, 3 * all, qkv[i]);
    }
    for (int h = 0; h < fixture->s.heads; h++)
        for (int i = 0; i < 3; i++) {
            double e[3], sum = 0;
            for (int j = 0; j < 3; j++) {
                e[j] = 0;
                for (int k = 0; k < head; k++) e[j] += qkv[i][h * head + k] * qkv[j][all + h * head + k];
                sum += e[j] = exp(e[j] / sqrt(head));
            }
            for (int k = 0; k < head; k++) {
                mixed[i][h * head + k] = 0;
                for (int j = 0; j < 3; j++)
                    mixed[i][h * head + k] += e[j] / sum * qkv[j][2 * all + h * head + k];
            }
        }
    for (int i = 0; i < 3; i++) {
        linear(fixture->w.attention_out_w, fixture->w.attention_out_b, mixed[i], all, d, y);
        for (int k = 0; k < d; k++) token[i][k] += y[k];
        norm(token[i], d, fixture->w.norm1_w, fixture->w.norm1_b, y);
        linear(fixture->w.mlp0_w, fixture->w.mlp0_b, y, d, d, z);
        for (int k = 0; k < d; k++) z[k] *= 0.5 * (1 + erf(z[k] / sqrt(2)));
        linear(fixture->w.mlp1_w, fixture->w.mlp1_b, z, d, d, y);
        for (int k = 0; k < d; k++) token[i][k] += y[k];
    }
}

static void reference_point(const made *fixture, int64_t p, double out[4]) {
    const radiance_sizes *s = &fixture->s;
    int d = s->token_width, h = s->decoder_width;
    double token[3][WIDE], x[WIDE], a[WIDE], y[WIDE], at[3], direction[3];
    reference_tokens(fixture, p, token);
    reference_transformer(fixture, token);
    for (int i = 0; i < 3; i++) {
        at[i] = fixture->points.canonical[3 * p + i];
        direction[i] = fixture->points.direction_canonical[3 * p + i];
    }
    int n = encode(at, s->position_frequencies, x);
    memcpy(x + n, token[0], (size_t)d * sizeof *x);
    n += d;
    memcpy(a, x, (size_t)n * sizeof *x);
    for (int i = 0, in = n; i < s->decoder_depth; i++) {
        linear(fixture->w.pts_w[i], fixture->w.pts_b[i], a, in, h, y);
        for (int k = 0; k < h; k++) y[k] = y[k] > 0 ? y[k] : 0;
        in = h;
        memcpy(a, y, (size_t)h * sizeof *y);
        if (i == s->decoder_skip) {
            memcpy(a, x, (size_t)n * sizeof *x);
            memcpy(a + n, y, (size_t)h * sizeof *y);
            in += n;
        }
    }
    linear(fixture->w.alpha_w, fixture->w.alpha_b, y, h, 1, out + 3);
    linear(fixture->w.feature_w, fixture->w.feature_b, y, h, h, a);
    n = h + encode(direction, s->direction_frequencies, a + h);
    memcpy(a + n, token[1], (size_t)d * sizeof *a);
    linear(fixture->w.views_w, fixture->w.views_b, a, n + d, s->view_width, y);
    for (int k = 0; k < s->view_width; k++) y[k] = y[k] > 0 ? y[k] : 0;
    linear(fixture->w.rgb_w, fixture->w.rgb_b, y, s->view_width, 3, out);
    for (int k = 0; k < 3; k++) out[k] = 1.002 / (1 + exp(-out[k])) - 0.001;
}

/* Compositing with every sample of the ray, whether kept or not. */
static void reference_ray(const made *fixture, int64_t ray, const double *out, const float background[3],
                          double y[5], double depth_min, double depth_max) {
    const point_set *p = &fixture->points;
    const float *d = fixture->rays.direction + 3 * ray;
    double near = fixture->rays.near[ray], far = fixture->rays.far[ray], left = 1,
           length = sqrt((double)d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    memset(y, 0, 5 * sizeof *y);
    int64_t at = p->first[ray];
    for (int k = 0; k < p->samples; k++) {
        bool kept = at < p->first[ray + 1] && p->sample[at] == k;
        double sigma = kept ? fmax(out[4 * at + 3], 0) : 0;
        double delta = k == p->samples - 1 ? 1e10 : (far - near) / (p->samples - 1);
        double alpha = 1 - exp(-sigma * delta * length), w = alpha * left;
        for (int i = 0; i < 3 && kept; i++) y[i] += w * out[4 * at + i];
        y[3] += w;
        y[4] += w * (near + (far - near) * k / (p->samples - 1));
        left *= 1 - alpha + 1e-10;
        at += kept;
    }
    y[4] = y[3] > 0 ? fmin(fmax(y[4] / y[3], depth_min), depth_max) : depth_max;
    for (int i = 0; i < 3; i++) y[i] += (1 - y[3]) * background[i];
}

/* ---- fixtures ---- */
typedef struct {
    made fixture;
    double *out; /* P x 4 */
} example;
static example paper, narrow, odd;

static void example_create(example *e, const radiance_sizes *s) {
    made_create(&e->fixture, s, 40, 64, 0.02f, 56, 60, 24);
    /* hostile positions: far away, exactly on borders, not a number */
    float *x = e->fixture.points.canonical, *uv = e->fixture.points.observed_px;
    x[0] = 100;
    x[3] = e->fixture.bank.plane_min[0];
    for (int i = 0; i < 3; i++) x[6 + i] = e->fixture.bank.plane_max[i];
    x[9] = x[10] = x[11] = -40;
    uv[8] = -1e9f;
    uv[10] = INFINITY;
    uv[13] = NAN;
    uv[14] = (float)e->fixture.bank.image_width;
    uv[17] = -0.5f;
    e->out = malloc((size_t)e->fixture.points.count * 4 * sizeof(double));
    for (int64_t p = 0; p < e->fixture.points.count; p++) reference_point(&e->fixture, p, e->out + 4 * p);
}

static int create(void **state) {
    example_create(&paper, &made_paper);
    example_create(&narrow, &made_narrow);
    example_create(&odd, &made_odd);
    return 0;
}

static int destroy(void **state) {
    free(paper.out);
    free(narrow.out);
    free(odd.out);
    made_free(&paper.fixture);
    made_free(&narrow.fixture);
    made_free(&odd.fixture);
    return 0;
}

static radiance_field *network(context *c, const example *e, bool bf16) {
    radiance_field *n = NULL;
    assert_ok(c, radiance_field_create(c, &e->fixture.s, &e->fixture.w, &e->fixture.bank, bf16, &n));
    return n;
}

/* Largest error relative to the largest value, [0] colour, [1] density; rms likewise. */
static void compare_points(const example *e, const float *rgb, const float *sigma, double worst[2],
                           double rms[2]) {
    double top[2] = {0, 0}, error[2] = {0, 0}, sum[2] = {0, 0};
    int64_t n = e->fixture.points.count;
    for (int64_t p = 0; p < n; p++)
        for (int k = 0; k < 4; k++) {
            double want = e->out[4 * p + k], got = k < 3 ? rgb[3 * p + k] : sigma[p], d = fabs(want - got);
            if (!(d < 1e30)) d = 1e30;
            top[k / 3] = fmax(top[k / 3], fabs(want));
            error[k / 3] = fmax(error[k / 3], d);
            sum[k / 3] += d * d;
        }
    for (int i = 0; i < 2; i++) {
        worst[i] = error[i] / top[i];
        rms[i] = sqrt(sum[i] / (double)n / (i ? 1 : 3)) / top[i];
    }
}

static void check_run(const example *e, isa_level level, bool bf16, double worst_allowed,
                      double rms_allowed) {
    if (!test_isa(level)) return;
    context *c = test_context();
    radiance_field *n = network(c, e, bf16);
    size_t count = (size_t)e->fixture.points.count;
    float *rgb = malloc(count * 3 * sizeof *rgb), *sigma = malloc(count * sizeof *sigma);
    assert_ok(c, radiance_field_run(c, n, &e->fixture.points, rgb, sigma));
    double worst[2], rms[2];
    compare_points(e, rgb, sigma, worst, rms);
    print_message("%s%s D %d: colour %.1e (rms %.1e), density %.1e (rms %.1e)\n", isa_name(level),
                  bf16 ? " bf16" : "", e->fixture.s.token_width, worst[0], rms[0], worst[1], rms[1]);
    for (int i = 0; i < 2; i++) {
        assert_true(worst[i] < worst_allowed);
        assert_true(rms[i] < rms_allowed);
    }
    /* run again with one thread: the same bits */
    float *again = malloc(count * 3 * sizeof *rgb), *sigma_again = malloc(count * sizeof *sigma);
    c->threads = 1;
    assert_ok(c, radiance_field_run(c, n, &e->fixture.points, again, sigma_again));
    assert_memory_equal(rgb, again, count * 3 * sizeof *rgb);
    assert_memory_equal(sigma, sigma_again, count * sizeof *sigma);
    free(rgb);
    free(sigma);
    free(again);
    free(sigma_again);
    radiance_field_free(n);
    sherf_context_free(c);
    test_isa_restore();
}

static void float_points(void **state) {
    for (int level = ISA_PLAIN; level <= ISA_AVX512; level++) {
        check_run(&paper, (isa_level)level, false, 2e-5, 2e-6);
        check_run(&odd, (isa_level)level, false, 2e-5, 2e-6);
    }
}

static void bf16_points(void **state) {
    skip_without_bf16();
    check_run(&paper, ISA_AMX, true, 4e-2, 8e-3);
    check_run(&narrow, ISA_AMX, true, 4e-2, 8e-3);
    check_run(&odd, ISA_AMX, true, 2e-5, 2e-6); /* tokens of 24 do not fit tiles, so it computes in float32 */
}

/* If bf16 is requested but unavailable, the bits are those of float32. */
static void bf16_in_vain(void **state) {
    const size_t count = (size_t)narrow.fixture.points.count;
    float *y[2] = {malloc(count * 4 * sizeof(float)), malloc(count * 4 * sizeof(float))};
    for (int level = ISA_PLAIN; level <= ISA_AVX512; level++) {
        if (!test_isa((isa_level)level)) continue;
        context *c = test_context();
        for (int bf16 = 0; bf16 < 2; bf16++) {
            radiance_field *n = network(c, &narrow, bf16);
            assert_false(radiance_field_in_bf16(n));
            assert_ok(c, radiance_field_run(c, n, &narrow.fixture.points, y[bf16], y[bf16] + 3 * count));
            radiance_field_free(n);
        }
        assert_memory_equal(y[0], y[1], count * 4 * sizeof(float));
        sherf_context_free(c);
    }
    test_isa_restore();
    free(y[0]);
    free(y[1]);
}

/* Largest and root mean square error of the frame's colours and opacity. */
static void check_frame(const example *e, isa_level level, bool bf16, bool early_stop, double allowed,
                        double psnr_needed) {
    static const float background[3] = {0.25f, 0.5f, 1};
    if (!test_isa(level)) return;
    context *c = test_context();
    radiance_field *n = network(c, e, bf16);
    sherf_frame frame = {0};
    assert_ok(
        c, radiance_field_render(c, n, &e->fixture.rays, &e->fixture.points, background, early_stop, &frame));
    long before = mem_count();
    float *data = frame.color.data;
    assert_ok(
        c, radiance_field_render(c, n, &e->fixture.rays, &e->fixture.points, background, early_stop, &frame));
    assert_ptr_equal(data, frame.color.data);
    assert_true(mem_count() - before <= 1); /* scratch */
    double worst = 0, sum = 0, depth_error = 0;
    int64_t rays = e->fixture.points.rays;
    for (int64_t i = 0; i < rays; i++) {
        double y[5];
        reference_ray(&e->fixture, i, e->out, background, y, 0, 2.41);
        for (int k = 0; k < 4; k++) {
            double d = fabs(y[k] - (k < 3 ? frame.color.data[3 * i + k] : frame.opacity.data[i]));
            worst = d >= 0 ? fmax(worst, d) : INFINITY;
            sum += k < 3 ? d * d : 0;
        }
        if (y[3] > 0.01 && y[4] < 2.3) depth_error = fmax(depth_error, fabs(y[4] - frame.depth.data[i]));
        if (y[3] == 0) assert_true(frame.depth.data[i] > 2.4f);
    }
    double psnr = -10 * log10(sum / (double)(3 * rays));
    print_message("%s%s%s D %d: picture worst %.1e, %.1f dB, depth %.1e m\n", isa_name(level),
                  bf16 ? " bf16" : "", early_stop ? " early" : "", e->fixture.s.token_width, worst, psnr,
                  depth_error);
    assert_true(worst < allowed);
    assert_true(depth_error < 20 * allowed);
    assert_true(psnr > psnr_needed);
    assert_int_equal(frame.points, e->fixture.points.count);
    mem_free(frame.color.data);
    mem_free(frame.opacity.data);
    mem_free(frame.depth.data);
    radiance_field_free(n);
    sherf_context_free(c);
    test_isa_restore();
}

static void frames(void **state) {
    for (int level = ISA_PLAIN; level <= ISA_AVX512; level++) {
        check_frame(&paper, (isa_level)level, false, false, 1e-4, 90);
        check_frame(&odd, (isa_level)level, false, true, 1e-4, 90);
    }
}

static void bf16_frames(void **state) {
    skip_without_bf16();
    check_frame(&paper, ISA_AMX, true, false, 0.1, 45);
    check_frame(&paper, ISA_AMX, true, true, 0.1, 45);
    check_frame(&narrow, ISA_AMX, true, true, 0.1, 45);
    check_frame(&odd, ISA_AMX, true, true, 1e-4, 90);
}

static void nothing_to_do(void **state) {
    context *c = test_context();
    radiance_field *n = network(c, &odd, true);
    point_set none = {.samples = 24};
    assert_ok(c, radiance_field_run(c, n, &none, NULL, NULL));
    point_set lacking = odd.fixture.points;
    lacking.observed_px = NULL;
    float sigma[1], rgb[3];
    assert_int_equal(radiance_field_run(c, n, &lacking, rgb, sigma), SHERF_BAD_ARGUMENT);
    sherf_frame frame = {0};
    static const float black[3];
    assert_int_equal(radiance_field_render(c, n, &odd.fixture.rays, &none, black, false, &frame),
                     SHERF_BAD_ARGUMENT);
    sherf_cancel(c);
    float *all = malloc((size_t)odd.fixture.points.count * 4 * sizeof(float));
    assert_int_equal(radiance_field_run(c, n, &odd.fixture.points, all, all + odd.fixture.points.count * 3),
                     SHERF_CANCELLED);
    free(all);
    radiance_field_free(n);
    sherf_context_free(c);
}

static void bad_sizes(void **state) {
    context *c = test_context();
    radiance_field *n = NULL;
    for (int i = 0; i < 6; i++) {
        radiance_sizes s = made_odd;
        radiance_bank b = odd.fixture.bank;
        int32_t row = (int32_t)b.level[1].voxels;
        if (i == 0) s.token_width = 0;
        if (i == 1) s.decoder_depth = POINT_DECODER_MAX + 1;
        if (i == 2) s.feature_channels = 12; /* the encoded colour is too short */
        if (i == 3) b.plane_max[1] = b.plane_min[1];
        if (i == 4) b.level[2].size[0] = 1 << 20;
        if (i == 5) {
            b.level[1].size[0] = b.level[1].size[1] = b.level[1].size[2] = 1;
            b.level[1].grid = &row;
        }
        assert_int_equal(radiance_field_create(c, &s, &odd.fixture.w, &b, false, &n), SHERF_BAD_ARGUMENT);
        assert_null(n);
        assert_true(c->message[0]);
    }
    sherf_context_free(c);
}

static void every_allocation_fails(void **state) {
    context *c = test_context();
    for (int bf16 = 0; bf16 < 2; bf16++) {
        bool done = false;
        for (long k = 0; !done; k++) {
            size_t live = mem_live();
            radiance_field *n = NULL;
            sherf_frame frame = {0};
            static const float black[3];
            mem_fail_after(k);
            sherf_status status = radiance_field_create(c, &narrow.fixture.s, &narrow.fixture.w,
                                                        &narrow.fixture.bank, bf16, &n);
            if (!status)
                status = radiance_field_render(c, n, &narrow.fixture.rays, &narrow.fixture.points, black,
                                               false, &frame);
            mem_fail_after(-1);
            done = !status;
            assert_true(done || status == SHERF_NO_MEMORY);
            mem_free(frame.color.data);
            mem_free(frame.opacity.data);
            mem_free(frame.depth.data);
            radiance_field_free(n);
            assert_int_equal(mem_live(), live);
            if (k > 1000) fail();
        }
    }
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(float_points), cmocka_unit_test(bf16_points),
        cmocka_unit_test(bf16_in_vain), cmocka_unit_test(frames),
        cmocka_unit_test(bf16_frames),  cmocka_unit_test(nothing_to_do),
        cmocka_unit_test(bad_sizes),    cmocka_unit_test(every_allocation_fails),
    };
    return cmocka_run_group_tests(tests, create, destroy);
}
