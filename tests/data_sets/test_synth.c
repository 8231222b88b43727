/* Tests of tube people, which are made, read again, checked and described; and of body files. */
#include <cjson/cJSON.h>
#include <sys/stat.h>

#include "data/silhouette.h"
#include "synth/tube/tubeman.h"
#include "make_files.h"

static char people[PATH_LENGTH];
static const sherf_synth_options options = {.people = 2, .poses = 2, .views = 4, .size_px = 64, .seed = 3};

static int make_people(void **state) {
    context *c = test_context();
    snprintf(people, sizeof people, "%s", test_path("people"));
    assert_ok(c, sherf_synth_tube(c, people, &options));
    sherf_context_free(c);
    return 0;
}

static void assert_same_file(context *c, const char *a, const char *b) {
    unsigned char *x = NULL, *y = NULL;
    size_t n, m;
    assert_ok(c, file_read(c, a, 1 << 27, &x, &n));
    assert_ok(c, file_read(c, b, 1 << 27, &y, &m));
    assert_int_equal(n, m);
    assert_memory_equal(x, y, n);
    mem_free(x);
    mem_free(y);
}

static void stop_in_the_second(void *user, const char *text, double done, double total) {
    if (done > total / 2) sherf_cancel(user);
}

static void the_seed_decides(void **state) {
    static const char *const files[] = {"human_list.txt",
                                        "tubeman.safetensors",
                                        "tube_001/annots.npy",
                                        "tube_001/view03/000001.png",
                                        "tube_000/mask_cihp/view02/000000.png",
                                        "tube_001/new_params_neutral/1.npy",
                                        "tube_000/new_vertices/0.npy"};
    context *c = test_context();
    char again[PATH_LENGTH];
    snprintf(again, sizeof again, "%s", test_path("again"));
    make_text(c, join(again, "tube_000.part/rubbish"), "left by an interrupted run");
    make_text(c, join(again, "tube_001/rubbish"), "left by an interrupted run");
    c->threads = 1;
    assert_ok(c, sherf_synth_tube(c, again, &options));
    for (size_t i = 0; i < COUNT_OF(files); i++)
        assert_same_file(c, join(people, files[i]), join(again, files[i]));
    assert_false(path_is_file(join(again, "tube_001/rubbish")) ||
                 path_is_folder(join(again, "tube_000.part")));
    assert_fails(c, sherf_synth_tube(c, again, &options), SHERF_WRITE_FAILED, "holds a data set already");
    sherf_synth_options bad = options;
    bad.size_px = 1;
    assert_fails(c, sherf_synth_tube(c, test_path("bad"), &bad), SHERF_BAD_ARGUMENT, "pixels");
    assert_false(path_is_folder(test_path("bad")));
    make_text(c, test_path("file"), "");
    assert_fails(c, sherf_synth_tube(c, test_path("file/below"), &options), SHERF_WRITE_FAILED, "file");
    sherf_cancel(c);
    assert_fails(c, sherf_synth_tube(c, test_path("cancelled"), &options), SHERF_CANCELLED, "cancelled");
    assert_false(path_is_folder(test_path("cancelled")));
    make_text(c, test_path("own/notes.txt"), "somebody's");
    assert_fails(c, sherf_synth_tube(c, test_path("own"), &options), SHERF_CANCELLED, "cancelled");
    assert_true(path_is_file(test_path("own/notes.txt")));
    assert_false(path_is_file(test_path("own/tubeman.safetensors")) ||
                 path_is_folder(test_path("own/tube_000")) || path_is_folder(test_path("own/tube_000.part")));
    sherf_cancel_reset(c);
    c->user = c, c->progress = stop_in_the_second;
    assert_fails(c, sherf_synth_tube(c, test_path("second"), &options), SHERF_CANCELLED, "cancelled");
    assert_false(path_is_folder(test_path("second")));
    sherf_context_free(c);
}

/* The set reads as THuman, the body lies over every mask, and the stored vertices are the body's. */
static void people_fit_their_pictures(void **state) {
    context *c = test_context();
    sherf_dataset *d = NULL;
    body_model *body = NULL;
    assert_ok(c, body_load(c, join(people, "tubeman.safetensors"), &body));
    assert_ok(c, sherf_dataset_open(c, people, &d));
    assert_string_equal(dataset_protocol(d)->name, "thuman");
    assert_string_equal(sherf_dataset_person(d, 1), "tube_001");
    for (int i = 0; i < 16; i++) {
        data_view *v = NULL;
        double overlap;
        assert_ok(c, dataset_view(c, d, i / 8, i / 4 % 2, i % 4, 0, &v));
        assert_ok(c, observation_check(c, v));
        assert_ok(c, observation_check_body(c, v, body));
        assert_ok(c, silhouette_overlap(c, v, body, &v->pose, &v->camera, MASK_AS_IT_IS, &overlap));
        assert_true(overlap > 0.9);
        size_t person = 0;
        double bright = 0;
        for (int k = 0; k < 64 * 64; k++) {
            person += v->mask[k];
            bright += v->image.data[k * 3] + v->image.data[k * 3 + 1] + v->image.data[k * 3 + 2];
        }
        assert_in_range(person, 64 * 64 / 25, 64 * 64 / 3);
        assert_true(bright / (double)person > 0.5); /* coloured, not black */
        sherf_observation_free(v);
    }
    sherf_dataset_free(d);
    sherf_body_free(body);
    sherf_context_free(c);
}

/* A body outside the camera's view makes no avatar. */
static void a_body_outside_makes_no_avatar(void **state) {
    context *c = test_context();
    sherf_model *model = NULL;
    body_model *body = NULL;
    sherf_observation *o = NULL;
    sherf_avatar *avatar = NULL;
    char path[PATH_LENGTH];
    snprintf(path, sizeof path, "%.2000s#tube_000/0/2", people);
    assert_ok(c, sherf_model_create(c, "small", 1, &model));
    assert_ok(c, tubeman_create(c, &body));
    assert_ok(c, sherf_observation_load(c, path, &o));
    o->pose.Th_m[0] = 50;
    assert_fails(c, sherf_avatar_create(c, model, body, o, &avatar), SHERF_MISMATCH, "outside the picture");
    assert_null(avatar);
    sherf_observation_free(o);
    sherf_body_free(body);
    sherf_model_free(model);
    sherf_context_free(c);
}

/* ---- check ---- */

static void assert_finding(context *c, const char *path, const body_model *body, int errors,
                           const char *text) {
    sherf_findings f;
    assert_ok(c, sherf_check(c, path, body, NULL, &f));
    if (f.errors != errors || !strstr(f.text, text))
        fail_msg("%s: %d errors, expected %d and \"%s\":\n%s", path, f.errors, errors, text, f.text);
    sherf_free(f.text);
}

/* Reads the THuman annots of person 0 and writes them again with T scaled and, on request, inverted. The R of
 * view `turned` is transposed (-1: of no view). */
static void rewrite_cameras(context *c, const char *folder, double scale, bool invert, int turned) {
    static const int square[] = {3, 3}, column[] = {3, 1};
    document *d = NULL;
    pickle_writer w;
    assert_ok(c, npy_read(c, join(people, "tube_000/annots.npy"), &d));
    const value *cams = value_get(d->root, "cams"), *ims = value_get(d->root, "ims");
    pickle_begin(&w, c);
    pickle_dict_open(&w);
    pickle_string(&w, "cams");
    pickle_dict_open(&w);
    for (const char *what = "KRT"; *what; what++) {
        char name[2] = {*what, 0};
        pickle_string(&w, name);
        pickle_list_open(&w);
        for (size_t v = 0; v < 4; v++) {
            double K[9], R[9], T[3], Ri[9], Ti[3] = {0};
            assert_ok(c, value_doubles(c, value_at(value_get(cams, "K"), v), "K", 9, K));
            assert_ok(c, value_doubles(c, value_at(value_get(cams, "R"), v), "R", 9, R));
            assert_ok(c, value_doubles(c, value_at(value_get(cams, "T"), v), "T", 3, T));
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) {
                    Ri[i * 3 + j] = R[j * 3 + i];
                    Ti[i] -= R[j * 3 + i] * T[j];
                }
            for (int i = 0; i < 3; i++) T[i] = scale * (invert ? Ti[i] : T[i]);
            if (*what == 'T')
                pickle_doubles(&w, 2, column, T);
            else
                pickle_doubles(&w, 2, square, *what == 'K' ? K : invert || (int)v == turned ? Ri : R);
        }
        pickle_list_close(&w);
    }
    pickle_dict_close(&w);
    pickle_string(&w, "ims");
    pickle_list_open(&w);
    for (size_t p = 0; p < 2; p++) {
        pickle_dict_open(&w);
        pickle_string(&w, "ims");
        pickle_list_open(&w);
        for (size_t v = 0; v < 4; v++)
            pickle_string(&w, value_at(value_get(value_at(ims, p), "ims"), v)->string.text);
        pickle_list_close(&w);
        pickle_dict_close(&w);
    }
    pickle_list_close(&w);
    pickle_dict_close(&w);
    assert_ok(c, pickle_finish_npy(&w, join(folder, "tube_000/annots.npy")));
    document_free(d);
}

/* Writes the observation of a data set's picture as JSON, with the body in camera coordinates and its
 * translation multiplied by `scale`. */
static void observation_write(context *c, const char *path, double scale) {
    char from[PATH_LENGTH + 20];
    sherf_observation *o = NULL;
    snprintf(from, sizeof from, "%.2000s#tube_000/0/2", people);
    assert_ok(c, sherf_observation_load(c, from, &o));
    FILE *f = fopen(path, "wb");
    fprintf(f, "{\"image\": \"%s/tube_000/view02/000000.png\", ", people);
    fprintf(f, "\"mask\": \"%s/tube_000/mask_cihp/view02/000000.png\", \"camera\": {\"K\": [", people);
    for (int i = 0; i < 9; i++) fprintf(f, "%s%.9g", i ? ", " : "", o->camera.K[i]);
    fprintf(f, "]}, \"body\": {\"poses\": [");
    for (int i = 0; i < 72; i++) fprintf(f, "%s%.9g", i ? ", " : "", o->pose.poses_rad[i]);
    fprintf(f, "], \"R\": [");
    for (int i = 0; i < 9; i++) {
        double sum = 0;
        for (int k = 0; k < 3; k++) sum += o->camera.R[i / 3 * 3 + k] * o->pose.R[3 * k + i % 3];
        fprintf(f, "%s%.9g", i ? ", " : "", sum);
    }
    fprintf(f, "], \"Th\": [");
    for (int i = 0; i < 3; i++) {
        double sum = o->camera.T_m[i];
        for (int k = 0; k < 3; k++) sum += o->camera.R[3 * i + k] * o->pose.Th_m[k];
        fprintf(f, "%s%.9g", i ? ", " : "", scale * sum);
    }
    fprintf(f, "]}}\n");
    fclose(f);
    sherf_observation_free(o);
}

static void keep_line(void *user, sherf_log_level level, const char *text) {
    snprintf(user, 1000, "%s", text);
}

static void assert_body_warning(context *c, const char *data, const body_model *body, const char *part) {
    static char line[1000];
    const int both[] = {0, 1};
    sherf_dataset *d = NULL;
    c->log = keep_line, c->user = line, *line = 0;
    assert_ok(c, sherf_dataset_open(c, data, &d));
    dataset_body_warn(c, d, body, "b.safetensors", both, sherf_dataset_person_count(d));
    if (*part ? !strstr(line, part) : *line) fail_msg("\"%s\", not \"%s\"", line, part);
    sherf_dataset_free(d);
    c->log = NULL;
}

/* Another body than the data's is named, by its vertices or by what it covers. */
static void another_body_is_named(void **state) {
    context *c = test_context();
    body_model *own = NULL, *other = NULL;
    char broken[PATH_LENGTH];
    sherf_synth_options one = options;
    one.people = 1;
    assert_ok(c, tubeman_create(c, &own));
    assert_ok(c, body_load(c, "../assets/body.safetensors", &other));
    assert_body_warning(c, people, own, "");
    assert_body_warning(c, people, other, "b.safetensors has 13380 vertices, and ");
    assert_body_warning(c, people, other,
                        "tube_000/new_vertices/0.npy has 6890: the poses are another body's");
    snprintf(broken, sizeof broken, "%s", test_path("another"));
    assert_ok(c, sherf_synth_tube(c, broken, &one));
    rewrite_cameras(c, broken, 20, false, -1);
    assert_body_warning(c, broken, own, "% of the masks of ");
    sherf_body_free(own);
    sherf_body_free(other);
    sherf_context_free(c);
}

static void check_finds_faults(void **state) {
    context *c = test_context();
    body_model *body = NULL;
    char broken[PATH_LENGTH], overlay[PATH_LENGTH];
    assert_ok(c, tubeman_create(c, &body));
    snprintf(overlay, sizeof overlay, "%s", test_path("overlay.png"));
    sherf_findings f;
    assert_ok(c, sherf_check(c, people, body, overlay, &f));
    assert_int_equal(f.errors, 0);
    assert_int_equal(f.warnings, 2); /* 4 views of both people where the paper has 24, in one line */
    assert_non_null(strstr(f.text, "tube_000: 4 views, the paper uses 24 (and so for 1 more person)\n"));
    assert_null(strstr(f.text, "tube_001: 4 views"));
    assert_non_null(strstr(f.text, "tube_001: and so it does in 3 other views and 1 other pose\n"));
    sherf_free(f.text);
    int width, height, channels;
    assert_ok(c, image_size(c, overlay, &width, &height, &channels));
    assert_int_equal(width, 64);
    assert_finding(c, join(people, "tubeman.safetensors"), NULL, 0, "a body of 6890 vertices");
    /* another person: the first one's folder, with one fault added after the other */
    sherf_synth_options one = options;
    one.people = 1;
    snprintf(broken, sizeof broken, "%s", test_path("faults"));
    assert_ok(c, sherf_synth_tube(c, broken, &one));
    rewrite_cameras(c, broken, 1000, false, -1);
    assert_finding(c, broken, body, 4, "millimetres");
    snprintf(overlay, sizeof overlay, "%s", test_path("o.json"));
    observation_write(c, overlay, 1);
    assert_finding(c, overlay, body, 0, "covers the mask");
    observation_write(c, overlay, 100);
    assert_finding(c, overlay, body, 1, "with Th in metres (are these centimetres?)");
    observation_write(c, overlay, 1000);
    assert_finding(c, overlay, body, 1, "with Th in metres (are these millimetres?)");
    rewrite_cameras(c, broken, 20, false, -1);
    assert_finding(c, broken, body, 1, "does not cover the mask");
    rewrite_cameras(c, broken, 1, true, -1);
    assert_finding(c, broken, body, 1, "camera to world");
    rewrite_cameras(c, broken, 0.001, false, -1);
    assert_finding(c, broken, body, 1, "are these metres");
    rewrite_cameras(c, broken, 1, false, 1);
    assert_finding(c, broken, body, 0, "view 1: with R transposed");
    rewrite_cameras(c, broken, 1, false, -1);
    assert_finding(c, broken, body, 0, "covers the mask");
    assert_finding(c, broken, body, 0, "and so it does in 3 other views and 1 other pose");
    make_mask(c, join(broken, "tube_000/mask_cihp/view01/000000.png"), 40, 30, 0, 1);
    assert_int_equal(unlink(join(broken, "tube_000/view03/000001.png")), 0);
    assert_finding(c, broken, body, 2, "a mask of 40 x 30 pixels for a picture of 64 x 64");
    assert_finding(c, broken, body, 2, "view03/000001.png: the picture is missing");
    make_mask(c, join(broken, "tube_000/mask_cihp/view01/000000.png"), 64, 64, 9, 1);
    assert_finding(c, broken, body, 2, "view01/000000.png: the mask covers the whole picture");
    make_mask(c, join(broken, "tube_000/mask_cihp/view01/000000.png"), 64, 64, 0, 0);
    assert_finding(c, broken, body, 2, "view01/000000.png: the mask is empty");
    make_text(c, join(broken, "tube_000/mask_cihp/view01/000000.png"), "");
    assert_finding(c, broken, body, 2, "an empty file; PNG, JPEG, WebP, HEIC and AVIF are read");
    assert_int_equal(unlink(join(broken, "tube_000/new_params_neutral/1.npy")), 0);
    assert_finding(c, broken, NULL, 3, "1.npy: the pose is missing");
    make_text(c, join(broken, "tube_000/annots.npy"), "rubbish");
    assert_finding(c, broken, NULL, 1, "annots.npy");
    assert_finding(c, "/nonexistent", NULL, 1, "/nonexistent");
    assert_finding(c, "thuman:/nonexistent", NULL, 1, "/nonexistent");
    assert_finding(c, join(people, "tube_000/annots.npy"), NULL, 1, "no SMPL body");
    assert_fails(c, sherf_check(c, people, NULL, overlay, &f), SHERF_BAD_ARGUMENT, "needs a body");
    assert_fails(c, sherf_check(c, people, body, "/nonexistent/o.png", &f), SHERF_WRITE_FAILED,
                 "/nonexistent/o.png");
    assert_null(f.text);
    sherf_body_free(body);
    sherf_context_free(c);
}

static void info_describes(void **state) {
    static const struct {
        const char *file, *says;
    } cases[] = {
        {"", "a multi-view data set"},
        {"#tube_001/1/2", "one picture of a person"},
        {"tubeman.safetensors", "a body model"},
        {"tube_000/annots.npy", "a data set's cameras and pictures"},
        {"tube_000/new_params_neutral/0.npy", "poses"},
        {"tube_000/new_vertices/0.npy", "an array"},
        {"tube_000/view00/000000.png", "a picture"},
    };
    context *c = test_context();
    for (size_t i = 0; i < COUNT_OF(cases); i++) {
        char path[PATH_LENGTH], *text = NULL;
        snprintf(path, sizeof path, "%.2000s%s%s", people,
                 cases[i].file[0] && cases[i].file[0] != '#' ? "/" : "", cases[i].file);
        assert_ok(c, sherf_info(c, path, 0, &text));
        assert_non_null(strstr(text, cases[i].says));
        sherf_free(text);
        assert_ok(c, sherf_info(c, path, 1, &text));
        cJSON *json = cJSON_Parse(text);
        assert_non_null(json);
        const char *what = cJSON_GetStringValue(cJSON_GetObjectItem(json, "what"));
        assert_true(what && strstr(what, cases[i].says));
        cJSON_Delete(json);
        sherf_free(text);
    }
    char *text = NULL;
    assert_fails(c, sherf_info(c, "/nonexistent", 0, &text), SHERF_NO_FILE, "/nonexistent");
    assert_fails(c, sherf_info(c, "/tmp", 0, &text), SHERF_BAD_FILE, "/tmp");
    make_text(c, test_path("odd\"name.json"), "{\"a\\u0001\\\"b\": [1, {\"c\": null}]}");
    assert_ok(c, sherf_info(c, test_path("odd\"name.json"), 1, &text));
    cJSON *json = cJSON_Parse(text);
    assert_non_null(json);
    assert_non_null(cJSON_GetObjectItem(cJSON_GetObjectItem(json, "content"), "a\x01\"b"));
    cJSON_Delete(json);
    sherf_free(text);
    sherf_context_free(c);
}

/* ---- body files ---- */

enum { TINY = 12 };
typedef struct {
    float v_template[TINY * 3], shapedirs[TINY * 3 * 300], posedirs[TINY * 3 * 207], weights[TINY * 55],
        regressor[24 * TINY], face[6 * 3], tree[2 * 24];
} tiny_body;

static void make_tiny(tiny_body *b) {
    static const int parent[] = {-1, 0, 0, 0,  1,  2,  3,  4,  5,  6,  7,  8,
                                 9,  9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21};
    memset(b, 0, sizeof *b);
    test_centred("tiny.v", TINY * 3, 1, b->v_template);
    test_centred("tiny.s", TINY * 3 * 300, 0.1, b->shapedirs);
    test_centred("tiny.p", TINY * 3 * 207, 0.01, b->posedirs);
    for (int i = 0; i < TINY; i++) b->weights[i * 24 + 2 * i] = 1;
    for (int j = 0; j < 24; j++) b->regressor[j * TINY + j / 2] = 1;
    for (int i = 0; i < 18; i++) b->face[i] = (float)((i * 5 + i / 3) % TINY);
    for (int j = 0; j < 24; j++) {
        b->tree[j] = parent[j] < 0 ? 4294967296.f : (float)parent[j];
        b->tree[24 + j] = (float)j;
    }
}

static sherf_status load_tiny(context *c, const tiny_body *b, int joints, int shapes, int faces,
                              const char *without, body_model **out) {
    npz_member all[] = {
        {"v_template", 2, {TINY, 3}, b->v_template},  {"shapedirs", 3, {TINY, 3, shapes}, b->shapedirs},
        {"posedirs", 3, {TINY, 3, 207}, b->posedirs}, {"weights", 2, {TINY, joints}, b->weights},
        {"J_regressor", 2, {24, TINY}, b->regressor}, {"f", 2, {faces, 3}, b->face},
        {"kintree_table", 2, {2, 24}, b->tree}};
    int n = 0;
    for (size_t i = 0; i < COUNT_OF(all); i++)
        if (!without || strcmp(all[i].name, without) != 0) all[n++] = all[i];
    assert_ok(c, npz_write(c, test_path("tiny.npz"), n, all));
    return sherf_body_load(c, test_path("tiny.npz"), out);
}

/* Pose blend shapes in both layouts of the smplx package. */
static void flat_pose_blendshapes(void **state) {
    context *c = test_context();
    static tiny_body b;
    static float turned[207 * TINY * 3];
    make_tiny(&b);
    for (int i = 0; i < TINY * 3; i++)
        for (int k = 0; k < 207; k++) turned[k * TINY * 3 + i] = b.posedirs[i * 207 + k];
    for (int form = 0; form < 2; form++) {
        body_model *body = NULL;
        npz_member all[] = {
            {"v_template", 2, {TINY, 3}, b.v_template},
            {"shapedirs", 3, {TINY, 3, 10}, b.shapedirs},
            {"posedirs", 2, {form ? 207 : TINY * 3, form ? TINY * 3 : 207}, form ? turned : b.posedirs},
            {"weights", 2, {TINY, 24}, b.weights},
            {"J_regressor", 2, {24, TINY}, b.regressor},
            {"f", 2, {6, 3}, b.face},
            {"kintree_table", 2, {2, 24}, b.tree}};
        assert_ok(c, npz_write(c, test_path("flat.npz"), COUNT_OF(all), all));
        assert_ok(c, sherf_body_load(c, test_path("flat.npz"), &body));
        for (int k = 0; k < 207; k++)
            for (int i = 0; i < TINY * 3; i++)
                assert_float_equal(body->posedirs[k * TINY * 3 + i], b.posedirs[i * 207 + k], 0);
        sherf_body_free(body);
    }
    /* the archive that was downloaded */
    body_model *body = NULL;
    char zip[PATH_LENGTH];
    snprintf(zip, sizeof zip, "%s", test_path("SMPL.zip"));
    const char *files[] = {test_path("flat.npz"), test_path("flat.npz")};
    make_zip(zip, 2, (const char *const[]){"LICENSE.txt", "models/body.pkl"}, files);
    assert_fails(c, sherf_body_load(c, zip, &body), SHERF_UNSUPPORTED,
                 "2 files (models/body.pkl, ...): unpack it");
    sherf_context_free(c);
}

static void body_files(void **state) {
    context *c = test_context();
    static tiny_body b;
    body_model *body = NULL, *again = NULL;
    make_tiny(&b);
    assert_ok(c, load_tiny(c, &b, 24, 300, 6, NULL, &body)); /* 300 shapes, any number of vertices */
    assert_int_equal(sherf_body_vertex_count(body), TINY);
    assert_int_equal(body->parent[0], -1);
    assert_int_equal(body->parent[23], 21);
    for (int i = 0; i < TINY * 3; i++)
        for (int k = 0; k < 10; k++)
            assert_float_equal(body->shapedirs[i * 10 + k], b.shapedirs[i * 300 + k], 0);
    for (int k = 0; k < 207; k++)
        for (int i = 0; i < TINY * 3; i++)
            assert_float_equal(body->posedirs[k * TINY * 3 + i], b.posedirs[i * 207 + k], 0);
    const char *path = test_path("tiny.safetensors");
    assert_ok(c, body_save(c, body, path));
    assert_ok(c, body_load(c, path, &again));
    assert_true(again->fingerprint == body->fingerprint);
    sherf_body_free(again);
    sherf_body_free(body);
    body = NULL;
    assert_fails(c, load_tiny(c, &b, 52, 10, 6, NULL, &body), SHERF_UNSUPPORTED, "SMPL-H");
    assert_fails(c, load_tiny(c, &b, 55, 10, 6, NULL, &body), SHERF_UNSUPPORTED, "SMPL-X");
    assert_fails(c, load_tiny(c, &b, 24, 10, 6, "weights", &body), SHERF_BAD_FILE, "weights is missing");
    assert_fails(c, load_tiny(c, &b, 24, 10, 6, "v_template", &body), SHERF_BAD_FILE, "holds no SMPL body");
    b.face[4] = TINY;
    assert_fails(c, load_tiny(c, &b, 24, 10, 6, NULL, &body), SHERF_BAD_FILE, "tiny.npz");
    b.face[4] = -1;
    assert_fails(c, load_tiny(c, &b, 24, 10, 6, NULL, &body), SHERF_BAD_FILE, "tiny.npz");
    make_tiny(&b);
    b.tree[5] = 7; /* a child before its parent */
    assert_fails(c, load_tiny(c, &b, 24, 10, 6, NULL, &body), SHERF_BAD_FILE, "tiny.npz");
    make_tiny(&b);
    b.weights[3] = NAN;
    assert_fails(c, load_tiny(c, &b, 24, 10, 6, NULL, &body), SHERF_BAD_FILE, "weights");
    assert_null(body);
    assert_fails(c, body_load(c, people, &body), SHERF_BAD_FILE, "a folder");
    size_t live = mem_live();
    make_tiny(&b);
    assert_ok(c, load_tiny(c, &b, 24, 10, 6, NULL, &body));
    sherf_body_free(body);
    long n = 0;
    for (bool done = false; !done; n++) {
        body = NULL;
        mem_fail_after(n);
        sherf_status status = body_load(c, test_path("tiny.npz"), &body);
        mem_fail_after(-1);
        done = status == SHERF_OK;
        if (!done) assert_int_equal(status, SHERF_NO_MEMORY);
        sherf_body_free(body);
        assert_true(mem_live() == live);
    }
    assert_true(n > 15);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_seed_decides),
        cmocka_unit_test(people_fit_their_pictures),
        cmocka_unit_test(a_body_outside_makes_no_avatar),
        cmocka_unit_test(another_body_is_named),
        cmocka_unit_test(check_finds_faults),
        cmocka_unit_test(info_describes),
        cmocka_unit_test(flat_pose_blendshapes),
        cmocka_unit_test(body_files),
    };
    return cmocka_run_group_tests(tests, make_people, NULL);
}
