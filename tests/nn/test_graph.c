/* Tests of graphs: convolutions against plain sums in double, the other nodes by hand, and refused input. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "nn/graph.h"
#include "support.h"

enum { H = 9, W = 7, I = 8, O = 6 };

static graph *begin_with_input(context *c) {
    graph *g = graph_begin(c);
    assert_non_null(g);
    assert_ok(c,
              graph_add(c, g, &(graph_node){.name = "x", .kind = GRAPH_INPUT, .rank = 3, .size = {H, W, I}}));
    return g;
}

static int64_t out_of(int64_t in, int64_t kernel, int64_t stride, bool same, int64_t pad, int64_t *before) {
    const int64_t out = same ? (in + stride - 1) / stride : (in + 2 * pad - kernel) / stride + 1;
    const int64_t lacks = (out - 1) * stride + kernel - in;
    *before = same ? (lacks > 0 ? lacks / 2 : 0) : pad;
    return out;
}

/* y = relu6(sum + bias + w * x), depthwise or not; the sum comes from the same convolution without bias,
 * addition and relu6. */
static void convolve(context *c, bool depthwise, int k, int stride, bool same, int pad) {
    const int out = depthwise ? I : O, taps = k * k * I * (depthwise ? 1 : O);
    float x[H * W * I], w[5 * 5 * I * O], b[I];
    const float *y;
    test_centred("x", H * W * I, 2, x);
    test_centred("w", taps, 1, w);
    test_centred("b", out, 1, b);
    graph *g = begin_with_input(c);
    graph_node n = {.name = "plain",
                    .kind = depthwise ? GRAPH_DEPTHWISE : GRAPH_CONVOLUTION,
                    .inputs = 1,
                    .weight = w,
                    .weight_size = {k, k, I, depthwise ? 1 : O},
                    .stride = {stride, stride},
                    .same = same,
                    .pad = {pad, pad, pad, pad}};
    assert_ok(c, graph_add(c, g, &n));
    n.name = "whole", n.bias = b, n.bias_size = out, n.inputs = 2, n.input[1] = 1, n.then = GRAPH_RELU6;
    assert_ok(c, graph_add(c, g, &n));
    assert_ok(c, graph_finish(c, g, 1, (int[]){2}));
    arena *memory = arena_create(c);
    assert_non_null(memory);
    assert_ok(c, graph_run(c, g, x, memory, &y));
    int64_t size[3], top, left;
    assert_int_equal(graph_output_size(g, 0, size), 3);
    assert_int_equal(size[0], out_of(H, k, stride, same, pad, &top));
    assert_int_equal(size[1], out_of(W, k, stride, same, pad, &left));
    assert_int_equal(size[2], out);
    for (int64_t i = 0; i < size[0] * size[1] * out; i++) {
        const int64_t o = i % out, column = i / out % size[1], row = i / out / size[1];
        double sum = 0;
        for (int t = 0; t < k * k; t++) {
            const int64_t r = row * stride + t / k - top, s = column * stride + t % k - left;
            if (r < 0 || s < 0 || r >= H || s >= W) continue;
            for (int m = depthwise ? (int)o : 0; m < (depthwise ? (int)o + 1 : I); m++)
                sum +=
                    (double)x[(r * W + s) * I + m] * (double)w[depthwise ? t * I + m : (t * I + m) * O + o];
        }
        assert_true(fabs((double)y[i] - fmin(fmax(2 * sum + (double)b[o], 0), 6)) < 1e-4);
    }
    arena_free(memory);
    graph_free(g);
}

static void convolutions(void **state) {
    for (int depthwise = 0; depthwise < 2; depthwise++)
        for (int stride = 1; stride < 3; stride++) {
            convolve(*state, depthwise, 3, stride, true, 0);
            convolve(*state, depthwise, 3, stride, false, 1);
            convolve(*state, depthwise, 5, stride, false, 2);
            convolve(*state, depthwise, 5, stride, false, 0);
            convolve(*state, depthwise, 2, stride, true, 0);
            convolve(*state, depthwise, 1, stride, false, 0);
        }
}

/* Checks the numbers that one node gives for an input [2, 2, 4] of 0, 1, ..., 15. */
static void gives(context *c, graph_node n, int count, const float *want) {
    float x[16];
    const float *y;
    int64_t size[3], have = 1;
    for (int i = 0; i < 16; i++) x[i] = (float)i;
    graph *g = graph_begin(c);
    arena *memory = arena_create(c);
    assert_true(g && memory);
    assert_ok(c,
              graph_add(c, g, &(graph_node){.name = "x", .kind = GRAPH_INPUT, .rank = 3, .size = {2, 2, 4}}));
    n.name = "y";
    assert_ok(c, graph_add(c, g, &n));
    assert_ok(c, graph_finish(c, g, 1, (int[]){1}));
    assert_ok(c, graph_run(c, g, x, memory, &y));
    for (int k = graph_output_size(g, 0, size) - 1; k >= 0; k--) have *= size[k];
    assert_int_equal(have, count);
    for (int i = 0; i < count; i++) assert_true(fabsf(y[i] - want[i]) < 1e-5f);
    arena_free(memory);
    graph_free(g);
}

static void others(void **state) {
    context *c = *state;
    gives(c, (graph_node){.kind = GRAPH_MAX_POOL, .inputs = 1, .kernel = {2, 2}, .stride = {2, 2}}, 4,
          (float[]){12, 13, 14, 15});
    gives(c, (graph_node){.kind = GRAPH_UNFOLD, .inputs = 1, .block = 2}, 16,
          (float[]){0, 1, 4, 5, 2, 3, 6, 7, 8, 9, 12, 13, 10, 11, 14, 15});
    gives(c, (graph_node){.kind = GRAPH_RESIZE, .inputs = 1, .size = {1, 1}, .half_pixel = true}, 4,
          (float[]){6, 7, 8, 9});
    gives(c, (graph_node){.kind = GRAPH_RESIZE, .inputs = 1, .size = {1, 3}, .corners = true}, 12,
          (float[]){0, 1, 2, 3, 2, 3, 4, 5, 4, 5, 6, 7});
    gives(c, (graph_node){.kind = GRAPH_ADD, .inputs = 2, .then = GRAPH_RELU6}, 16,
          (float[]){0, 2, 4, 6, 6, 6, 6, 6, 6, 6, 6, 6, 6, 6, 6, 6});
    gives(c, (graph_node){.kind = GRAPH_PAD, .inputs = 1, .pad = {1, 0, 0, 0, 0, 1}}, 30,
          (float[]){0, 0, 0, 0, 0, 0, 0, 0,  0,  0, 0,  1,  2,  3,  0,
                    4, 5, 6, 7, 0, 8, 9, 10, 11, 0, 12, 13, 14, 15, 0});
    gives(c, (graph_node){.kind = GRAPH_CONCAT, .inputs = 2, .axis = -1}, 32,
          (float[]){0, 1, 2,  3,  0, 1, 2,  3,  4,  5,  6,  7,  4,  5,  6,  7,
                    8, 9, 10, 11, 8, 9, 10, 11, 12, 13, 14, 15, 12, 13, 14, 15});
}

static const float w[3 * 3 * I * O], bad[1 * 1 * I * 1] = {NAN};
static const struct {
    graph_node node;
    const char *why;
} wrong_nodes[] = {
    {{.kind = GRAPH_ADD, .inputs = 2, .input = {0, 1}}, "no earlier node"},
    {{.kind = GRAPH_ADD, .inputs = 1}, "1 inputs"},
    {{.kind = GRAPH_KINDS}, "unknown kind"},
    {{.kind = GRAPH_INPUT, .rank = 3, .size = {1, 1, 1}}, "second input"},
    {{.kind = GRAPH_CONVOLUTION, .inputs = 1, .stride = {1, 1}}, "no weights"},
    {{.kind = GRAPH_CONVOLUTION, .inputs = 1, .weight = w, .weight_size = {3, 3, I + 1, O}, .stride = {1, 1}},
     "for 8 channels"},
    {{.kind = GRAPH_CONVOLUTION, .inputs = 1, .weight = w, .weight_size = {3, 3, I, O}}, "kernel or stride"},
    {{.kind = GRAPH_CONVOLUTION,
      .inputs = 1,
      .weight = w,
      .weight_size = {3, 3, I, O},
      .stride = {1, 1},
      .pad = {3, 0, 0, 0}},
     "padding"},
    {{.kind = GRAPH_CONVOLUTION,
      .inputs = 1,
      .weight = w,
      .weight_size = {3, 3, I, O},
      .stride = {1, 1},
      .then = GRAPH_SIGMOID},
     "activation"},
    {{.kind = GRAPH_CONVOLUTION, .inputs = 1, .weight = bad, .weight_size = {1, 1, I, 1}, .stride = {1, 1}},
     "not finite"},
    {{.kind = GRAPH_RESIZE, .inputs = 1, .size = {30000, 30000}}, "more than"},
    {{.kind = GRAPH_RESHAPE, .inputs = 1, .rank = 2, .size = {-1, 5}}, "another number"},
    {{.kind = GRAPH_RESHAPE, .inputs = 1, .rank = 2, .size = {-1, -1}}, "another number"},
    {{.kind = GRAPH_CONCAT, .inputs = 1, .axis = 3}, "axis"},
    {{.kind = GRAPH_UNFOLD, .inputs = 1, .block = 3}, "blocks"},
};

static void refused(void **state) {
    context *c = *state;
    for (size_t i = 0; i < COUNT_OF(wrong_nodes); i++) {
        const size_t live = mem_live();
        graph *g = begin_with_input(c);
        graph_node n = wrong_nodes[i].node;
        n.name = "wrong_nodes";
        const sherf_status status = graph_add(c, g, &n);
        if (status == SHERF_OK || !strstr(c->message, wrong_nodes[i].why) ||
            !strstr(c->message, "node wrong_nodes"))
            fail_msg("%zu: %s", i, c->message);
        graph_free(g);
        assert_int_equal(mem_live(), live);
    }
    graph *g = begin_with_input(c);
    assert_int_equal(graph_finish(c, g, 1, (int[]){1}), SHERF_BAD_FILE);
    graph_free(g);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(convolutions), cmocka_unit_test(others),
                                       cmocka_unit_test(refused)};
    return cmocka_run_group_tests(tests, test_open, test_close);
}
