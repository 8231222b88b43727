/* Tests of other tools' camera files: EasyMocap's YAML, COLMAP's text model, cameras stacked in arrays, and
 * which camera an observation takes. */
#include "data/parse.h"
#include "make_files.h"

static char folder[PATH_LENGTH], said[4096]; /* said: all lines since the last reset */

static void keep_lines(void *user, sherf_log_level level, const char *line) {
    if (strlen(said) + strlen(line) + 2 < sizeof said) strcat(strcat(said, line), "\n");
}

static context *listening_context(void) {
    context *c = NULL;
    sherf_options o = {.threads = 1, .log = keep_lines};
    assert_int_equal(sherf_context_create(&o, &c), SHERF_OK);
    said[0] = 0;
    return c;
}

static int make_basics(void **state) {
    context *c = test_context();
    snprintf(folder, sizeof folder, "%s", test_path("cameras"));
    make_picture(c, join(folder, "a.png"), 0, MADE_WIDTH, MADE_HEIGHT);
    make_mask(c, join(folder, "m.png"), MADE_WIDTH, MADE_HEIGHT, 0, 255);
    char body[1024] = "{\"Th\": [0, 0, 1], \"poses\": [0";
    for (int i = 1; i < 72; i++) strcat(body, ", 0");
    make_text(c, join(folder, "body.json"), strcat(body, "]}"));
    sherf_context_free(c);
    return 0;
}

/* The cameras of a file or folder, which are `expected`; mem_free them. */
static parsed_camera *cameras_of(context *c, const char *name, int expected) {
    parsed_camera *camera;
    int count;
    assert_ok(c, cameras_read(c, join(folder, name), NULL, &camera, &count));
    assert_int_equal(count, expected);
    return camera;
}

/* An observation with the camera of this file. */
static const char *observation(context *c, const char *camera, const char *more) {
    char text[1024];
    snprintf(text, sizeof text,
             "{\"image\": \"a.png\", \"mask\": \"m.png\", \"camera\": \"%s\", %s \"body\": \"body.json\"}",
             camera, more);
    const char *path = join(folder, "o.json");
    make_text(c, path, text);
    return path;
}

static void assert_numbers(const double *got, const double *expected, int count) {
    for (int i = 0; i < count; i++) assert_float_equal(got[i], expected[i], 1e-9);
}

/* ---- EasyMocap ---- */

static const char intri[] =
    "%YAML:1.0\n---\nnames:\n  - \"01\"\n  - \"B 2\"\n"
    "K_01: !!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d\n"
    "  data: [50.,0.,20.,\n     0.,55.,1.5e+01, 0.,0.,1.]\n"
    "dist_01: !!opencv-matrix\n  rows: 1\n  cols: 5\n  dt: d\n  data: [-0.1,0.01,0.,0.,0.]\n"
    "H_01: 30\nW_01: 40\n"
    "K_B 2: !!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d\n"
    "  data: [60, 0, 20, 0, 60, 15, 0, 0, 1]\n";
static const char extri[] =
    "%YAML:1.0\r\n---\r\nnames:\r\n  - \"01\"\r\n  - \"B 2\"\r\n"
    "R_01: !!opencv-matrix\r\n  rows: 3\r\n  cols: 1\r\n  dt: d\r\n  data: [0, 0, 0]\r\n"
    "Rot_01: !!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d\n"
    "  data: [0.,-1.,0., 1.,0.,0., 0.,0.,1.]\n"
    "T_01: !!opencv-matrix\n  rows: 3\n  cols: 1\n  dt: d\n  data: [0.1,0.2,3.]\n"
    "R_B 2: !!opencv-matrix\n  rows: 3\n  cols: 1\n  dt: d\n"
    "  data: [0, 0, 1.5707963267948966]\n"
    "T_B 2: !!opencv-matrix\n  rows: 3\n  cols: 1\n  dt: d\n  data: [0, 0, 4]\n";

static void easymocap(void **state) {
    static const double K[] = {50, 0, 20, 0, 55, 15, 0, 0, 1}, R[] = {0, -1, 0, 1, 0, 0, 0, 0, 1},
                        T[] = {0.1, 0.2, 3}, D[] = {-0.1, 0.01, 0, 0, 0};
    static const char *const ways[] = {"mocap", "mocap/intri.yml", "mocap/extri.yml"};
    context *c = listening_context();
    make_text(c, join(folder, "mocap/intri.yml"), intri);
    make_text(c, join(folder, "mocap/extri.yml"), extri);
    for (size_t i = 0; i < COUNT_OF(ways); i++) {
        parsed_camera *camera = cameras_of(c, ways[i], 2);
        assert_numbers(camera[0].K, K, 9);
        assert_numbers(camera[0].R, R, 9);
        assert_numbers(camera[0].T, T, 3);
        assert_numbers(camera[0].D, D, 5);
        assert_true(camera[0].width == 40 && camera[0].height == 30 && camera[1].width == 0);
        assert_float_equal(camera[1].K[0], 60, 0);
        for (int k = 0; k < 9; k++) assert_float_equal(camera[1].R[k], R[k], 1e-6);
        assert_string_equal(camera[1].name, "B 2");
        mem_free(camera);
    }
    assert_string_equal(said, "");
    sherf_observation *o;
    assert_ok(c,
              sherf_observation_load(c, observation(c, "mocap/extri.yml", "\"camera_name\": \"B 2\","), &o));
    assert_float_equal(o->camera.K[0], 60, 0);
    sherf_observation_free(o);
    assert_fails(c, sherf_observation_load(c, observation(c, "mocap", "\"camera_name\": \"3\","), &o),
                 SHERF_BAD_FILE, "\"3\" is the name of no single one of the 2 cameras; the first is \"01\"");
    sherf_context_free(c);
}

/* One line says what is wrong, and where. */
static void yaml_refused(void **state) {
    static const struct {
        const char *intri, *says;
    } cases[] = {
        {"%YAML:1.0\nnames:\n  - \"01\"\n", "intri.yml: no camera: K_NAME is missing"},
        {"%YAML:1.0\nK_1: !!opencv-matrix\n  rows: 3\n  cols: 3\n  data: [1, 2]\n",
         "line 6: a matrix whose data"},
        {"%YAML:1.0\nK_1: !!opencv-matrix\n  rows: 3\n  cols: 3\n  data: [1, 2\n", "a bracket is not closed"},
        {"%YAML:1.0\nK_1: !!opencv-matrix\n  rows: 1\n  cols: 1\n  data: [.Nan]\n",
         "line 5: a number that is not"},
        {"%YAML:1.0\nK_1: !!opencv-matrix\n  rows: 1\n  cols: 1\n  data: [a]\n", "a matrix of texts"},
        {"%YAML:1.0\nK_1: !!opencv-matrix\n  rows: 1\n  cols: 1\n", "without rows, cols or data"},
        {"%YAML:1.0\nK_1: [1] 2\n", "line 2: something follows a bracket"},
        {"%YAML:1.0\nK_1: [[1]]\n", "brackets within brackets"},
        {"%YAML:1.0\ncam:\n  K: 3\n", "line 3: neither a matrix"},
        {"%YAML:1.0\nK_01: 5\n", "camera 0: camera: K"},
    };
    context *c = test_context();
    make_text(c, join(folder, "bad/extri.yml"), extri);
    for (size_t i = 0; i < COUNT_OF(cases); i++) {
        parsed_camera *camera;
        int count;
        make_text(c, join(folder, "bad/intri.yml"), cases[i].intri);
        assert_fails(c, cameras_read(c, join(folder, "bad/intri.yml"), NULL, &camera, &count), SHERF_BAD_FILE,
                     cases[i].says);
        assert_null(camera);
    }
    sherf_context_free(c);
}

/* ---- COLMAP ---- */

static const char lenses[] = "# Camera list with one line of data per camera:\n"
                             "7 SIMPLE_RADIAL 40 30 50 20.5 15.5 0.02\n\n"
                             "2 OPENCV 80 60 100 110 40.5 30.5 0.1 0.2 0.3 0.4\n";
static const char images[] = "# Image list with two lines of data per image:\n"
                             "1 1 0 0 0 0.5 0 2 2 left/b.png\n10.5 11.5 -1 3 4 5\n"
                             "5 0.70710678118654757 0 0 0.70710678118654757 0 0 3 7 left/a.png\n\n"
                             "6 1 0 0 0 0 0 4 7 with space.png";

static void colmap(void **state) {
    static const double K[] = {100, 0, 40, 0, 110, 30, 0, 0, 1}, D[] = {0.1, 0.2, 0.3, 0.4, 0, 0, 0, 0},
                        R[] = {0, -1, 0, 1, 0, 0, 0, 0, 1}, simple[] = {50, 0, 20, 0, 50, 15, 0, 0, 1};
    static const char *const ways[] = {"sparse/0", "sparse/0/cameras.txt", "sparse/0/images.txt"};
    context *c = listening_context();
    make_text(c, join(folder, "sparse/0/cameras.txt"), lenses);
    make_text(c, join(folder, "sparse/0/images.txt"), images);
    for (size_t i = 0; i < COUNT_OF(ways); i++) {
        parsed_camera *camera = cameras_of(c, ways[i], 3);
        assert_numbers(camera[0].K, K, 9);
        assert_numbers(camera[0].D, D, 8);
        assert_float_equal(camera[0].T[0], 0.5, 0);
        assert_true(camera[0].width == 80 && camera[1].height == 30);
        assert_numbers(camera[1].K, simple, 9);
        assert_numbers(camera[1].R, R, 9);
        assert_float_equal(camera[1].T[2], 3, 0);
        assert_float_equal(camera[1].D[0], 0.02, 0);
        assert_string_equal(camera[2].name, "with space.png");
        mem_free(camera);
    }
    assert_non_null(strstr(said, "COLMAP's unit of length"));
    sherf_observation *o; /* the second, as the picture is called */
    assert_ok(c, sherf_observation_load(c, observation(c, "sparse/0", ""), &o));
    assert_float_equal(o->camera.T_m[2], 3, 0);
    assert_non_null(strstr(said, "the camera left/a.png of 3, by the picture's name"));
    sherf_observation_free(o);
    assert_ok(c, sherf_observation_load(c, observation(c, "sparse/0", "\"camera_index\": 2,"), &o));
    assert_float_equal(o->camera.T_m[2], 4, 0);
    sherf_observation_free(o);
    sherf_context_free(c);
}

static void colmap_refused(void **state) {
    static const struct {
        const char *lenses, *images, *says;
        sherf_status status;
    } cases[] = {
        {"", images, "cameras.txt: no cameras", SHERF_BAD_FILE},
        {"1 PINHOLE 40 30 50 50 20\n", images, "cameras.txt, line 1: numbers are missing", SHERF_BAD_FILE},
        {"x PINHOLE\n", images, "line 1: not CAMERA_ID MODEL", SHERF_BAD_FILE},
        {"\n1 OPENCV_FISHEYE 40 30 50 50 20 15 0 0 0 0\n", images, "line 2: COLMAP's model OPENCV_FISHEYE",
         SHERF_UNSUPPORTED},
        {lenses, "# nothing\n", "images.txt: no images", SHERF_BAD_FILE},
        {lenses, "1 1 0 0 0 0 0 2 2\n", "line 1: not IMAGE_ID", SHERF_BAD_FILE},
        {lenses, "1 1 0 0 0 0 0 2 3 a.png\n", "line 1: its camera is not in cameras.txt", SHERF_BAD_FILE},
        {lenses, "1 2 0 0 0 0 0 2 2 a.png\n", "qvec: a quaternion of length 2", SHERF_BAD_FILE},
    };
    context *c = test_context();
    parsed_camera *camera;
    int count;
    for (size_t i = 0; i < COUNT_OF(cases); i++) {
        make_text(c, join(folder, "bad/cameras.txt"), cases[i].lenses);
        make_text(c, join(folder, "bad/images.txt"), cases[i].images);
        assert_fails(c, cameras_read(c, join(folder, "bad/images.txt"), NULL, &camera, &count),
                     cases[i].status, cases[i].says);
        assert_null(camera);
    }
    assert_fails(c, cameras_read(c, join(folder, "cameras.bin"), NULL, &camera, &count), SHERF_UNSUPPORTED,
                 "--output_type TXT");
    assert_fails(c, cameras_read(c, folder, NULL, &camera, &count), SHERF_BAD_FILE,
                 "a folder without cameras");
    sherf_context_free(c);
}

/* ---- stacked ---- */

enum { STACK = 3 };

/* Camera i: K[0] 50 + i, turned about z by i right angles, T_z 3 + i. */
static void stack_make(float (*K)[9], float (*RT)[16], float (*R)[9], float (*T)[3], float (*D)[5]) {
    for (int i = 0; i < STACK; i++) {
        const float k[9] = {50.f + (float)i, 0, 20, 0, 55, 15, 0, 0, 1}, cosine = (float[]){1, 0, -1}[i],
                    sine = (float[]){0, 1, 0}[i], r[9] = {cosine, -sine, 0, sine, cosine, 0, 0, 0, 1};
        memcpy(K[i], k, sizeof k);
        memcpy(R[i], r, sizeof r);
        memset(RT[i], 0, sizeof RT[i]);
        for (int n = 0; n < 9; n++) RT[i][n / 3 * 4 + n % 3] = r[n];
        RT[i][11] = T[i][2] = 3.f + (float)i, RT[i][15] = 1;
        T[i][0] = T[i][1] = 0;
        D[i][0] = 0.1f * (float)i, D[i][1] = D[i][2] = D[i][3] = D[i][4] = 0;
    }
}

/* annots.npy: cams beside the pictures' names, T in metres or, as ZJU-MoCap's, in millimetres. */
static void annots(void **state) {
    context *c = listening_context();
    for (int mm = 0; mm < 2; mm++) {
        char text[1024];
        snprintf(
            text, sizeof text,
            "{\"cams\": {\"K\": [[[9, 0, 3], [0, 9, 2], [0, 0, 1]], [[8, 0, 3], [0, 8, 2], [0, 0, 1]]], "
            "\"R\": [[[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, -1, 0], [1, 0, 0], [0, 0, 1]]], "
            "\"T\": [[[0], [0], [%g]], [[%g], [0], [%g]]], \"D\": [[0, 0, 0, 0, 0], [0.1, 0, 0, 0, 0]]}, "
            "\"ims\": [{\"ims\": [\"Camera_B1/000000.jpg\", \"Camera_B2/000000.jpg\"]}]}",
            mm ? 3000. : 3, mm ? 500. : 0.5, mm ? 2500. : 2.5);
        make_text(c, join(folder, "annots.json"), text);
        said[0] = 0;
        parsed_camera *camera = cameras_of(c, "annots.json", 2);
        assert_numbers(camera[1].T, (const double[]){0.5, 0, 2.5}, 3);
        assert_numbers(camera[1].R, (const double[]){0, -1, 0, 1, 0, 0, 0, 0, 1}, 9);
        assert_true(camera[1].K[0] == 8 && camera[1].D[0] == 0.1 && camera[0].T[2] == 3);
        assert_string_equal(camera[1].name, "Camera_B2");
        assert_int_equal(strstr(said, "read as millimetres, as ZJU-MoCap's") != NULL, mm);
        mem_free(camera);
    }
    sherf_context_free(c);
}

static void stacks(void **state) {
    static float K[STACK][9], RT[STACK][16], R[STACK][9], T[STACK][3], D[STACK][5];
    const float far[1] = {0};
    context *c = listening_context();
    stack_make(K, RT, R, T, D);
    const npz_member members[][4] = {
        {{"K", 3, {STACK, 3, 3}, K[0]},
         {"R", 3, {STACK, 3, 3}, R[0]},
         {"T", 2, {STACK, 3}, T[0]},
         {"D", 2, {STACK, 5}, D[0]}},
        {{"intrinsics", 3, {STACK, 3, 3}, K[0]},
         {"w2c", 3, {STACK, 4, 4}, RT[0]},
         {"dist", 2, {STACK, 5}, D[0]},
         {"id", 1, {1}, far}},
        {{"K", 2, {3, 3}, K[0]},
         {"extrinsics", 3, {STACK, 4, 4}, RT[0]},
         {"D", 2, {STACK, 5}, D[0]},
         {"id", 1, {1}, far}},
        {{"K", 3, {STACK, 3, 3}, K[0]},
         {"R", 3, {STACK, 3, 3}, R[0]},
         {"T", 3, {STACK, 3, 1}, T[0]},
         {"D", 2, {STACK, 5}, D[0]}},
    };
    const char *path = join(folder, "stack.npz");
    for (size_t m = 0; m < COUNT_OF(members); m++) {
        parsed_camera *camera;
        int count;
        assert_ok(c, npz_write(c, path, 4, members[m]));
        assert_ok(c, cameras_read(c, path, NULL, &camera, &count));
        assert_int_equal(count, STACK);
        for (int i = 0; i < STACK; i++) {
            assert_float_equal(camera[i].K[0], m == 2 ? 50 : 50 + i, 0);
            assert_float_equal(camera[i].R[3], R[i][3], 0);
            assert_float_equal(camera[i].T[2], 3 + i, 0);
            assert_float_equal(camera[i].D[0], D[i][0], 0);
        }
        mem_free(camera);
    }
    sherf_observation *o;
    assert_ok(c, sherf_observation_load(c, observation(c, "stack.npz", "\"camera_index\": 1,"), &o));
    assert_float_equal(o->camera.T_m[2], 4, 0);
    sherf_observation_free(o);
    assert_ok(c, sherf_observation_load(c, observation(c, "stack.npz", ""), &o));
    assert_non_null(strstr(said, "the first of 3 is taken; \"camera_index\" takes another"));
    sherf_observation_free(o);
    sherf_context_free(c);
}

/* Stacks of different lengths, bare arrays, and a stack written into the observation. */
static void stacks_refused(void **state) {
    static float K[STACK][9], RT[STACK][16], R[STACK][9], T[STACK][3], D[STACK][5];
    context *c = test_context();
    parsed_camera *camera;
    sherf_observation *o;
    int count;
    stack_make(K, RT, R, T, D);
    const npz_member uneven[] = {
        {"K", 3, {STACK, 3, 3}, K[0]}, {"R", 3, {2, 3, 3}, R[0]}, {"T", 2, {STACK, 3}, T[0]}};
    const char *path = join(folder, "uneven.npz"), *bare = join(folder, "bare.npy");
    assert_ok(c, npz_write(c, path, 3, uneven));
    assert_fails(c, cameras_read(c, path, NULL, &camera, &count), SHERF_BAD_FILE, "camera 0: camera: R");
    assert_ok(c, npy_write_f32(c, bare, 3, (const int64_t[]){STACK, 4, 4}, RT[0]));
    assert_fails(c, cameras_read(c, bare, NULL, &camera, &count), SHERF_BAD_FILE,
                 "np.savez(file, K=..., RT=...)");
    const char one[] = "[[50, 0, 20], [0, 55, 15], [0, 0, 1]]", *inside = join(folder, "inside.json");
    char text[1024];
    snprintf(
        text, sizeof text,
        "{\"image\": \"a.png\", \"mask\": \"m.png\", \"camera\": {\"K\": [%s, %s]}, \"body\": \"body.json\"}",
        one, one);
    make_text(c, inside, text);
    assert_fails(c, sherf_observation_load(c, inside, &o), SHERF_BAD_FILE, "choose by \"camera_index\"");
    sherf_context_free(c);
}

/* Every allocation of these readers may fail. */
static void memory_runs_out(void **state) {
    static const char *const files[] = {"mocap", "sparse/0", "stack.npz"};
    context *c = test_context();
    for (size_t i = 0; i < COUNT_OF(files); i++) {
        const char *path = join(folder, files[i]);
        const size_t live = mem_live();
        long n = 0;
        for (bool done = false; !done; n++) {
            parsed_camera *camera;
            int count;
            mem_fail_after(n);
            sherf_status status = cameras_read(c, path, NULL, &camera, &count);
            mem_fail_after(-1);
            done = status == SHERF_OK;
            if (!done) assert_int_equal(status, SHERF_NO_MEMORY);
            mem_free(camera);
            assert_true(mem_live() == live);
        }
        assert_true(n > 5);
    }
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(easymocap),      cmocka_unit_test(yaml_refused),    cmocka_unit_test(colmap),
        cmocka_unit_test(colmap_refused), cmocka_unit_test(annots),          cmocka_unit_test(stacks),
        cmocka_unit_test(stacks_refused), cmocka_unit_test(memory_runs_out),
    };
    return cmocka_run_group_tests(tests, make_basics, NULL);
}
