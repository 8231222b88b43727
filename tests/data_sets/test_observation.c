/* Tests of observations from memory, JSON, folders and data sets, of pose and camera files, and of refused
 * input. */
#include "synth/tube/tubeman.h"
#include "make_files.h"

#define CAMERA "{\"K\": [[50, 0, 20], [0, 55, 15], [0, 0, 1]], \"T\": [0, 0.2, 3]}"
#define BODY                                                                                                 \
    "{\"body_pose\": %s, \"global_orient\": [0.1, 0.2, 0.3], \"transl\": [1, 2, 3], \"betas\": [0.5, -1]}"

static char folder[PATH_LENGTH], zeros_69[1024], zeros_72[1024];

static void zeros(char *out, int n) {
    strcpy(out, "[0");
    for (int i = 1; i < n; i++) strcat(out, i == 5 ? ", 0.25" : ", 0");
    strcat(out, "]");
}

/* A JPEG that states a width of 33000 pixels. */
static void make_wide(context *c, const char *path) {
    uint8_t rgb[16 * 2 * 3] = {0}, *data;
    size_t bytes;
    assert_ok(c, jpeg_to_memory(c, 16, 2, rgb, 90, &data, &bytes));
    for (size_t i = 0; i + 9 < bytes; i++)
        if (data[i] == 0xff && data[i + 1] == 0xc0) data[i + 7] = 33000 >> 8, data[i + 8] = 33000 & 255;
    FILE *f = fopen(path, "wb");
    assert_non_null(f);
    assert_int_equal(fwrite(data, 1, bytes, f), bytes);
    fclose(f);
    mem_free(data);
}

static int make_basics(void **state) {
    context *c = test_context();
    snprintf(folder, sizeof folder, "%s", test_path("observation"));
    zeros(zeros_69, 69);
    zeros(zeros_72, 72);
    make_picture(c, join(folder, "a.png"), 0, MADE_WIDTH, MADE_HEIGHT);
    make_mask(c, join(folder, "m.png"), MADE_WIDTH, MADE_HEIGHT, 0, 255);
    make_mask(c, join(folder, "empty.png"), MADE_WIDTH, MADE_HEIGHT, 0, 0);
    make_mask(c, join(folder, "full.png"), MADE_WIDTH, MADE_HEIGHT, 255, 255);
    make_mask(c, join(folder, "small.png"), MADE_WIDTH - 1, MADE_HEIGHT, 0, 255);
    make_wide(c, join(folder, "wide.jpg"));
    make_text(c, join(folder, "rubbish.png"), "\x89PNG\r\n\x1a\nrubbish");
    sherf_context_free(c);
    return 0;
}

/* Writes an observation.json from these parts. */
static const char *json(context *c, const char *image, const char *mask, const char *camera,
                        const char *body) {
    static char text[16384];
    char object[4096];
    snprintf(object, sizeof object, body ? body : BODY, zeros_69);
    snprintf(text, sizeof text, "{\"image\": \"%s\", %s%s%s \"camera\": %s, \"body\": %s}", image,
             mask ? "\"mask\": \"" : "", mask ? mask : "", mask ? "\"," : "", camera ? camera : CAMERA,
             object);
    const char *path = join(folder, "o.json");
    make_text(c, path, text);
    return path;
}

static void from_json(void **state) {
    context *c = test_context();
    sherf_observation *o = NULL;
    assert_ok(c, sherf_observation_load(c, json(c, "a.png", "m.png", NULL, NULL), &o));
    const sherf_image *image = sherf_observation_image(o);
    const sherf_camera *camera = sherf_observation_camera(o);
    const sherf_pose *pose = sherf_observation_pose(o);
    assert_int_equal(image->width, MADE_WIDTH);
    assert_int_equal(camera->height_px, MADE_HEIGHT);
    assert_float_equal(image->data[0], 0, 0);
    int at = 10 * MADE_WIDTH + 15;
    assert_float_equal(image->data[at * 3 + 2], made_color(0, 15, 10, 2) / 255., 1e-7);
    assert_float_equal(camera->K[4], 55, 0);
    assert_float_equal(camera->R[0], 1, 0);
    assert_float_equal(camera->T_m[2], 3, 0);
    assert_float_equal(pose->poses_rad[1], 0.2, 1e-7);
    assert_float_equal(pose->poses_rad[8], 0.25, 1e-7);
    assert_float_equal(pose->Th_m[2], 3, 0);
    assert_float_equal(pose->shapes[1], -1, 0);
    assert_float_equal(pose->shapes[2], 0, 0);
    assert_float_equal(pose->R[4], 1, 0);
    sherf_observation_free(o);
    /* a field of view of 90 degrees: focal length half the height */
    assert_ok(c, sherf_observation_load(c, json(c, "a.png", "m.png", "{\"fov_deg\": 90}", NULL), &o));
    assert_float_equal(o->camera.K[0], 15, 1e-5);
    assert_float_equal(o->camera.K[2], 20, 1e-5);
    sherf_observation_free(o);
    assert_ok(c, sherf_observation_load(
                     c, json(c, "a.png", "m.png", "{\"focal_px\": 77, \"R\": [0, 0, 0.5]}", NULL), &o));
    assert_float_equal(o->camera.K[4], 77, 0);
    assert_float_equal(o->camera.R[0], cos(0.5), 1e-6);
    sherf_observation_free(o);
    sherf_context_free(c);
}

/* Rotation matrices instead of axis-angles, with Rh beside the pose. */
static void body_forms(void **state) {
    context *c = test_context();
    sherf_observation *o = NULL;
    char matrices[8192] = "{\"body_pose\": [";
    float turn[3] = {0.1f, -0.2f, 0.3f}, R[9];
    rodrigues(turn, R);
    for (int j = 0; j < 23; j++) {
        strcat(matrices, j ? ", [" : "[");
        for (int i = 0; i < 9; i++) sprintf(matrices + strlen(matrices), "%s%.7f", i ? ", " : "", R[i]);
        strcat(matrices, "]");
    }
    strcat(matrices, "], \"Rh\": [0, 1, 0], \"Th\": [[4, 5, 6]]}");
    make_text(c, join(folder, "body.json"), matrices);
    assert_ok(c, sherf_observation_load(c, json(c, "a.png", "m.png", NULL, "\"body.json\""), &o));
    for (int j = 1; j < 24; j++)
        for (int i = 0; i < 3; i++) assert_float_equal(o->pose.poses_rad[j * 3 + i], turn[i], 1e-5);
    assert_float_equal(o->pose.R[0], cos(1), 1e-6);
    assert_float_equal(o->pose.Th_m[1], 5, 0);
    sherf_observation_free(o);
    sherf_context_free(c);
}

/* ---- names of other tools ---- */

static char warned[2048]; /* all warnings since the last reset */

static void keep_warnings(void *user, sherf_log_level level, const char *line) {
    if (level == SHERF_LOG_WARNING && strlen(warned) + strlen(line) + 2 < sizeof warned)
        strcat(strcat(warned, line), "\n");
}

static context *listening_context(void) {
    context *c = NULL;
    sherf_options o = {.threads = 1, .log = keep_warnings};
    assert_int_equal(sherf_context_create(&o, &c), SHERF_OK);
    warned[0] = 0;
    return c;
}

static void body_names(void **state) {
    static const char *const bodies[] = {
        "{\"pose\": [%s], \"shape\": [[7]], \"global_t\": [[4, 5, 6]], \"focal_l\": [710]}", /* CLIFF */
        "{\"pred_smpl_params\": {\"global_orient\": [[0, 0, 0]], \"body_pose\": [%s], \"betas\": [[7]]}, "
        "\"pred_cam_t\": [[0, 0, 1]], \"pred_cam_t_full\": [[4, 5, 6]]}",                      /* HMR 2 */
        "{\"root_pose\": [0, 0, 0], \"body_pose\": %s, \"betas\": [7], \"trans\": [4, 5, 6]}", /* LHM */
        "{\"global_orient\": [0, 0, 0], \"body_pose\": %s, \"betas\": [7], \"transl\": null, "
        "\"camera_rotation\": [[[1, 0, 0], [0, 1, 0], [0, 0, 1]]], "
        "\"camera_translation\": [[4, 5, 6]]}", /* SMPLify-X */
        "{\"results\": {\"smpl_thetas\": [%s], \"smpl_betas\": [[7]], \"cam_trans\": [[4, 5, 6]]}}", /* ROMP
                                                                                                      */
        "{\"smpl_poses\": %s, \"betas\": [7], \"cam_t\": [4, 5, 6]}",
        "{\"body_pose\": %s, \"betas\": [7], \"Rh\": [0, 0, 0], \"Th\": [-6, 5, 4], "
        "\"camera_rotation\": [0, 1.5707963267948966, 0], \"cam_t\": [0, 0, 0]}", /* z to x, x to -z */
        "{\"person_0\": {\"poses\": %s, \"betas\": [7]}, \"cam_t\": [4, 5, 6]}",  /* under any key */
        "{\"annots\": [{\"id\": 0, \"poses\": [%s], \"shapes\": [[7]], \"Rh\": [[0, 0, 0]], "
        "\"Th\": [[4, 5, 6]]}]}", /* EasyMocap */
    };
    static const bool whole[] = {true, false, false, false, true, true, false, true, true};
    context *c = listening_context();
    for (size_t i = 0; i < COUNT_OF(bodies); i++) {
        char body[4096];
        sherf_observation *o = NULL;
        snprintf(body, sizeof body, bodies[i], whole[i] ? zeros_72 : zeros_69);
        make_text(c, join(folder, "named.json"), body);
        assert_ok(c, sherf_observation_load(
                         c, json(c, "a.png", "m.png", "{\"fov_deg\": 50}", "\"named.json\""), &o));
        for (int k = 0; k < 3; k++) assert_float_equal(o->pose.Th_m[k], 4 + k, 1e-5);
        assert_float_equal(o->pose.shapes[0], 7, 0);
        assert_float_equal(o->pose.poses_rad[whole[i] ? 5 : 8], 0.25, 1e-6);
        assert_float_equal(o->pose.R[2], i == 6 ? 1 : 0, 1e-6);
        assert_string_equal(warned, "");
        sherf_observation_free(o);
    }
    sherf_context_free(c);
}

/* At rest SMPL-X's pelvis lies 0.128 m lower. Its translations are converted to SMPL's, so that the pelvis
 * comes to the same place. */
static void smplx_bodies(void **state) {
    static const struct {
        const char *body;
        float Th[3];
    } cases[] = {
        {"{\"body_pose\": %s, \"transl\": [4, 5, 6], \"left_hand_pose\": [0]}", {4, 5, 6}}, /* SMPL+H */
        {"{\"body_pose\": %s, \"transl\": [4, 5, 6], \"eye\": [0, 1, 3]}", {4, 5, 6}},      /* a camera's */
        {"{\"body_pose\": %s, \"transl\": [4, 5, 6], \"jaw_pose\": [0, 0, 0]}", {4.0049f, 4.8719f, 5.9838f}},
        {"{\"body_pose\": %s, \"cam_t\": [4, 5, 6], \"expression\": [0]}", {4.0049f, 4.8719f, 5.9838f}},
        {"{\"smplx_body_pose\": %s, \"cam_trans\": [4, 5, 6]}", {4.0049f, 4.8719f, 5.9838f}},
        {"{\"smpl_params_incam\": {\"body_pose\": %s, \"transl\": [4, 5, 6]}}", {4.0049f, 4.8719f, 5.9838f}},
        {"{\"body_pose\": %s, \"Th\": [4, 5, 6], \"expression\": [0], \"Rh\": [0, 0, 1.5707963]}",
         {4.1281f, 5.0049f, 5.9838f}},
        {"{\"body_pose\": %s, \"jaw_pose\": [0, 0, 0]}",
         {0, 0, 0}}, /* without a translation there is nothing to convert */
    };
    char camera[] = "{\"fov_deg\": 50, \"R\": [0, 0, 0], \"T\": [0, 0, 1]}", body[4096];
    context *c = test_context();
    sherf_observation *o;
    for (size_t i = 0; i < COUNT_OF(cases); i++) {
        snprintf(body, sizeof body, cases[i].body, zeros_69);
        assert_ok(c, sherf_observation_load(c, json(c, "a.png", "m.png", camera, body), &o));
        for (int k = 0; k < 3; k++) assert_float_equal(o->pose.Th_m[k], cases[i].Th[k], 1e-5);
        sherf_observation_free(o);
    }
    size_t n = (size_t)sprintf(body, "{\"poses\": [0");
    for (int i = 1; i < 165; i++) n += (size_t)sprintf(body + n, ", 0");
    sprintf(body + n, "], \"trans\": [4, 5, 6]}");
    assert_ok(c, sherf_observation_load(c, json(c, "a.png", "m.png", camera, body), &o));
    assert_float_equal(o->pose.Th_m[1], 4.8719f, 1e-5);
    sherf_observation_free(o);
    sherf_context_free(c);
}

/* Multi-HMR: 53 rotations of SMPL-X; its transl is the head's place and transl_pelvis the pelvis's, to which
 * the template's pelvis is put. */
static void multi_hmr(void **state) {
    static const double template_pelvis[3] = {-0.0018, -0.2233, 0.0282};
    char camera[] = "{\"fov_deg\": 50, \"R\": [0, 0, 0], \"T\": [0, 0, 1]}", body[4096];
    context *c = listening_context();
    for (int pelvis = 1; pelvis >= 0; pelvis--) {
        size_t n = (size_t)sprintf(body, "{\"transl\": [[7, 7, 7]], \"shape\": [7], %s\"rotvec\": [[",
                                   pelvis ? "\"transl_pelvis\": [[4, 5, 6]], " : "");
        for (int j = 0; j < 53; j++)
            n += (size_t)sprintf(body + n, "%s[0, %g, 0]", j ? ", " : "", j < 22 ? 0.2 : 0.9);
        strcpy(body + n, "]]}");
        sherf_observation *o;
        assert_ok(c, sherf_observation_load(c, json(c, "a.png", "m.png", camera, body), &o));
        for (int j = 0; j < 72; j++)
            assert_float_equal(o->pose.poses_rad[j], j < 66 && j % 3 == 1 ? 0.2 : 0, 1e-6);
        for (int k = 0; k < 3; k++)
            assert_float_equal(o->pose.Th_m[k], pelvis ? 4 + k - template_pelvis[k] : 0, 1e-5);
        assert_int_equal(strstr(warned, "transl is its head's") != NULL, !pelvis);
        sherf_observation_free(o);
    }
    sherf_context_free(c);
}

/* Quaternions with the real part first or last, with the root included or separate; EasyMocap's hands and
 * AIST++'s scaling. */
static void quaternions_and_scaling(void **state) {
    context *c = test_context();
    char camera[] = "{\"fov_deg\": 50, \"R\": [0, 0, 0], \"T\": [0, 0, 1]}", body[4096];
    sherf_observation *o;
    for (int i = 0; i < 4; i++) { /* joints turned by 0.6 about y, the root by 3 about x */
        const bool last = i & 1, apart = i & 2;
        size_t n =
            (size_t)sprintf(body, "{\"transl\": [1, 2, 3], \"%s\": [", apart ? "global_orient" : "poses");
        for (int j = 0; j < 24; j++) {
            const double w = cos(j ? 0.3 : 1.5), x = j ? 0 : sin(1.5), y = j ? sin(0.3) : 0;
            if (apart && j == 1) n += (size_t)sprintf(body + n - 2, "], \"body_pose\": [") - 2;
            n += (size_t)(last ? sprintf(body + n, "%.8f, %.8f, 0, %.8f, ", x, y, w)
                               : sprintf(body + n, "%.8f, %.8f, %.8f, 0, ", w, x, y));
        }
        strcpy(body + n - 2, "]}");
        assert_ok(c, sherf_observation_load(c, json(c, "a.png", "m.png", camera, body), &o));
        for (int j = 0; j < 72; j++)
            assert_float_equal(o->pose.poses_rad[j], !j ? 3 : j > 3 && j % 3 == 1 ? 0.6 : 0, 1e-5);
        sherf_observation_free(o);
    }
    for (int joints = 26; joints <= 29; joints += 3) { /* 29 joints are SMPL-X's */
        size_t n = (size_t)sprintf(body, "{\"Th\": [4, 5, 6], \"poses\": [");
        for (int j = 0; j < joints * 3; j++)
            n += (size_t)sprintf(body + n, "%s%g", j ? ", " : "", j < 66 ? 0.2 : 0.9);
        strcpy(body + n, "]}");
        assert_ok(c, sherf_observation_load(c, json(c, "a.png", "m.png", camera, body), &o));
        for (int j = 0; j < 72; j++) assert_float_equal(o->pose.poses_rad[j], j < 66 ? 0.2 : 0, 1e-6);
        assert_float_equal(o->pose.Th_m[1], joints == 26 ? 5 : 4.8719, 1e-5);
        sherf_observation_free(o);
    }
    snprintf(body, sizeof body,
             "{\"smpl_poses\": %s, \"smpl_trans\": [200, 100, 300], \"smpl_scaling\": [100]}", zeros_72);
    assert_ok(c, sherf_observation_load(c, json(c, "a.png", "m.png", camera, body), &o));
    assert_true(o->pose.Th_m[0] == 2 && o->pose.Th_m[1] == 1 && o->pose.Th_m[2] == 3);
    sherf_observation_free(o);
    sherf_context_free(c);
}

/* A body of rotations with six numbers: by rows, by columns, or interleaved columns. bend: of the knees. */
static void six_body(char *out, int layout, double bend, const char *more) {
    size_t n = (size_t)sprintf(out, "{\"transl\": [1, 2, 3], %s\"global_orient\": [[", more);
    for (int j = 0; j < 24; j++) {
        const float turn[3] = {j == 4 || j == 5 ? (float)bend : 0, j ? 0 : 1, j == 16 ? 0.5f : 0};
        float R[9];
        rodrigues(turn, R);
        if (j == 1) n += (size_t)sprintf(out + n - 2, "], \"body_pose\": [[") - 2;
        for (int k = 0; k < 6; k++) {
            const int vector = layout == 2 ? k % 2 : k / 3, entry = layout == 2 ? k / 2 : k % 3;
            n += (size_t)sprintf(out + n, "%.7f%s", R[layout ? 3 * entry + vector : 3 * vector + entry],
                                 k < 5 ? ", " : "");
        }
        n += (size_t)sprintf(out + n, "%s", j && j < 23 ? "], [" : "], ");
    }
    strcpy(out + n - 2, "]}");
}

static void six_numbers(void **state) {
    char camera[] = "{\"fov_deg\": 50, \"R\": [0, 0, 0], \"T\": [0, 0, 1]}";
    static char body[8192];
    context *c = listening_context();
    for (int layout = 0; layout < 3; layout++)
        for (int said = 0; said < 2; said++) {
            sherf_observation *o;
            six_body(body, layout, said ? 0 : 0.4,
                     !said    ? ""
                     : layout ? "\"rotations\": \"6d-columns\", "
                              : "\"rotations\": \"6d-rows\", ");
            make_text(c, join(folder, "six.json"), body);
            assert_ok(c, sherf_observation_load(c, json(c, "a.png", "m.png", camera, "\"six.json\""), &o));
            for (int j = 0; j < 72; j++)
                assert_float_equal(o->pose.poses_rad[j],
                                   j == 1               ? 1
                                   : j == 12 || j == 15 ? (said ? 0 : 0.4)
                                   : j == 50            ? 0.5
                                                        : 0,
                                   1e-5);
            assert_string_equal(warned, "");
            sherf_observation_free(o);
        }
    sherf_pose *pose;
    int count;
    six_body(body, 0, 0, "");
    make_text(c, join(folder, "six.json"), body);
    assert_fails(c, sherf_poses_load(c, join(folder, "six.json"), &pose, &count), SHERF_BAD_FILE,
                 "say \"rotations\": \"6d-rows\" or \"6d-columns\"");
    sherf_context_free(c);
}

/* All frames of a file together show it: the first one's limbs are straight. */
static void six_numbers_of_frames(void **state) {
    context *c = test_context();
    static float poses[3][24][6];
    sherf_pose *pose;
    int count;
    for (int i = 0; i < 72; i++) {
        float R[9];
        rodrigues(
            (const float[3]){i / 24 && (i % 24 == 4 || i % 24 == 5) ? 0.5f : 0, 0, i % 24 == 1 ? 0.3f : 0},
            R);
        for (int k = 0; k < 6; k++) poses[i / 24][i % 24][k] = R[k % 3 * 3 + k / 3];
    }
    const char *path = join(folder, "six.npz");
    npz_member member[] = {{"poses", 3, {3, 24, 6}, poses[0][0]}};
    assert_ok(c, npz_write(c, path, 1, member));
    assert_ok(c, sherf_poses_load(c, path, &pose, &count));
    assert_int_equal(count, 3);
    assert_float_equal(pose[0].poses_rad[5], 0.3, 1e-5);
    assert_float_equal(pose[2].poses_rad[12], 0.5, 1e-5);
    sherf_free(pose);
    static char list[2 * 8192 + 8] = "[", body[8192]; /* so do all bodies of a list */
    for (int bent = 0; bent < 2; bent++) {
        six_body(body, 1, bent, "");
        strcat(strcat(list, body), bent ? "]" : ", ");
    }
    make_text(c, join(folder, "list.json"), list);
    assert_ok(c, sherf_poses_load(c, join(folder, "list.json"), &pose, &count));
    assert_int_equal(count, 2);
    for (int i = 0; i < 2; i++) {
        assert_float_equal(pose[i].poses_rad[50], 0.5, 1e-5);
        assert_float_equal(pose[i].poses_rad[12], i, 1e-5);
    }
    sherf_free(pose);
    sherf_context_free(c);
}

/* HumanNeRF's mesh_infos: the body that is called like the picture. Th is SMPL's, unless the T-pose's pelvis
 * is at the origin: then it is the pelvis's place. */
static void mesh_infos(void **state) {
    static const int dims[] = {24, 3}, one[] = {72}, three[] = {3};
    context *c = listening_context();
    for (int own = 0; own < 2; own++) {
        pickle_writer w;
        pickle_begin(&w, c);
        pickle_dict_open(&w);
        for (int f = 0; f < 3; f++) {
            const float Rh[3] = {0, 0, 1.5707963f}, Th[3] = {4, 5, 6.f + (float)f};
            float poses[72] = {0}, joints[24][3] = {{0, own ? 0 : -0.2233f, 0}};
            poses[5] = 0.1f * (float)f;
            pickle_string(&w, (const char *[]){"x", "a", "b"}[f]);
            pickle_dict_open(&w);
            pickle_string(&w, "Rh");
            pickle_floats(&w, 1, three, Rh);
            pickle_string(&w, "Th");
            pickle_floats(&w, 1, three, Th);
            pickle_string(&w, "poses");
            pickle_floats(&w, 1, one, poses);
            pickle_string(&w, "tpose_joints");
            pickle_floats(&w, 2, dims, joints[0]);
            pickle_dict_close(&w);
        }
        pickle_dict_close(&w);
        assert_ok(c, pickle_finish_file(&w, join(folder, "mesh_infos.pkl")));
        sherf_observation *o;
        assert_ok(c, sherf_observation_load(c, json(c, "a.png", "m.png", NULL, "\"mesh_infos.pkl\""), &o));
        assert_float_equal(o->pose.poses_rad[5], 0.1, 1e-6);
        assert_float_equal(o->pose.Th_m[0], own ? 4 - 0.2233 : 4, 1e-5); /* x to y, y to -x */
        assert_float_equal(o->pose.Th_m[1], own ? 5 + 0.0018 : 5, 1e-5);
        assert_float_equal(o->pose.Th_m[2], own ? 7 - 0.0282 : 7, 1e-5);
        assert_string_equal(warned, "");
        sherf_observation_free(o);
        assert_ok(c, sherf_observation_load(
                         c, json(c, "a.png", "m.png", NULL, "\"mesh_infos.pkl\", \"body_index\": 2"), &o));
        assert_float_equal(o->pose.poses_rad[5], 0.2, 1e-6);
        sherf_observation_free(o);
    }
    sherf_context_free(c);
}

/* Keys that are not understood are named, in a body, a camera and the whole file. */
static void unknown_keys_are_named(void **state) {
    static const struct {
        const char *camera, *body, *says;
    } cases[] = {
        {CAMERA,
         "{\"body_pose\": %s, \"transl\": [1, 2, 3], \"moved_by\": [0, 0, 4], \"jaw_pose\": [0, 0, 0]}",
         "o.json: body: not read: moved_by\n"},
        {CAMERA,
         "{\"body_pose\": %s, \"transl_frame\": [1, 2, 3], \"outtime\": 3, \"frame_ids\": [0], "
         "\"lhand_pose\": [0], "
         "\"joints3d\": [0], \"bboxes\": [0], \"mocap_framerate\": 3, \"poseConfidence\": 1, \"num_betas\": "
         "10}",
         "o.json: body: not read: transl_frame, outtime; no translation"},
        {CAMERA, "{\"body_pose\": %s, \"pelvis_at\": [0, 0, 4]}",
         "o.json: body: not read: pelvis_at; no translation is among what is (transl, Th, cam_t, ...)\n"},
        {CAMERA, "{\"body_pose\": %s, \"transl\": [1, 2, 3], \"root_rot\": [0, 0, 4]}",
         "o.json: body: body_pose without the root's rotation (global_orient, root_orient, ...)"},
        {CAMERA, "{\"body_pose\": %s, \"transl\": [1, 2, 3], \"trans\": [2, 2, 3]}",
         "o.json: body: not read: trans, because transl is there too and is taken\n"},
        {"{\"fov_deg\": 50, \"camera_model\": \"PINHOLE\", \"skew\": 1, \"zoom\": 2}", BODY,
         "o.json: camera: not read: skew, zoom\n"},
        {"{\"fov_deg\": 50}, \"masks\": \"x\"", BODY, "o.json: not read: masks\n"},
        {"{\"fov_deg\": 50, \"R\": [0, 0, 0], \"t_vec\": [0, 0, 4]}", BODY,
         "o.json: camera: R without T: it stands at the world's origin\n"},
    };
    context *c = listening_context();
    for (size_t i = 0; i < COUNT_OF(cases); i++) {
        sherf_observation *o = NULL;
        warned[0] = 0;
        assert_ok(c,
                  sherf_observation_load(c, json(c, "a.png", "m.png", cases[i].camera, cases[i].body), &o));
        if (!strstr(warned, cases[i].says)) fail_msg("%zu: \"%s\", not \"%s\"", i, warned, cases[i].says);
        sherf_observation_free(o);
    }
    sherf_context_free(c);
}

static void camera_names(void **state) {
    static const char *const cameras[] = {
        "{\"K\": [[50, 0, 20], [0, 55, 15], [0, 0, 1]], \"R\": [0, 0, 0.5], \"T\": [1, 2, 3], \"D\": []}",
        "{\"intrinsics\": [50, 55, 20, 15], \"rvec\": [0, 0, 0.5], \"tvec\": [[1], [2], [3]], \"dist\": "
        "null}",
        "{\"focal\": [50, 55], \"princpt\": [20, 15], \"D\": [0, 0, 0, 0], \"RT\": [[%s, 1], [%s, 2], [%s, "
        "3]]}",
        "{\"fx\": 50, \"fy\": 55, \"cx\": 20, \"cy\": 15, \"w\": 40, \"h\": 30, "
        "\"extrinsic\": [[%s, 1], [%s, 2], [%s, 3], [0, 0, 0, 1]], \"D\": [0, 0, 0, 0, 0, 0, 0, 0]}",
        "[{\"img_focal\": [50, 55], \"img_center\": [20, 15], \"Rot\": [%s, %s, %s], \"T\": [1, 2, 3]}]",
        "{\"K\": [[50, 0, 20, 0], [0, 55, 15, 0], [0, 0, 1, 0], [0, 0, 0, 1]], \"tvec\": [1, 2, 3], "
        "\"qvec\": [0.96891242, 0, 0, 0.24740396]}", /* COLMAP */
        "{\"camera_f\": [50, 55], \"camera_c\": [20, 15], \"camera_rt\": [0, 0, 0.5], \"camera_t\": [1, 2, "
        "3], "
        "\"camera_k\": [0, 0, 0, 0, 0]}", /* People-Snapshot */
        "{\"intrinsics\": {\"fx\": 50, \"fy\": 55, \"cx\": 20, \"cy\": 15}, \"extrinsics\": {\"R\": [0, 0, "
        "0.5], "
        "\"T\": [1, 2, 3]}, \"distortions\": [0, 0, 0, 0, 0]}",
        "{\"fx\": 50, \"fy\": 55, \"cx\": 20, \"cy\": 15, \"position\": [-1.83643364, -1.27573958, -3], "
        "\"rotation\": [[0.87758256, 0.47942554, 0], [-0.47942554, 0.87758256, 0], [0, 0, 1]]}", /* splats */
        "{\"fl_x\": 50, \"fl_y\": 55, \"cx\": 20, \"cy\": 15, \"rotation\": 0.01, \"transform_matrix\": "
        "[[0.87758256, -0.47942554, 0, -1.83643364], [-0.47942554, -0.87758256, 0, -1.27573958], "
        "[0, 0, -1, -3], [0, 0, 0, 1]]}", /* NeRF: OpenGL's axes */
    };
    static const char rows[3][64] = {"0.87758256, -0.47942554, 0", "0.47942554, 0.87758256, 0", "0, 0, 1"};
    context *c = listening_context();
    for (size_t i = 0; i < COUNT_OF(cameras); i++) {
        char camera[1024];
        sherf_observation *o = NULL;
        snprintf(camera, sizeof camera, cameras[i], rows[0], rows[1], rows[2]);
        assert_ok(c, sherf_observation_load(c, json(c, "a.png", "m.png", camera, NULL), &o));
        const double K[9] = {50, 0, 20, 0, 55, 15, 0, 0, 1};
        for (int k = 0; k < 9; k++) assert_float_equal(o->camera.K[k], K[k], 0);
        assert_float_equal(o->camera.R[1], -0.47942554, 1e-6);
        for (int k = 0; k < 3; k++) assert_float_equal(o->camera.T_m[k], k + 1, i < 5 ? 0 : 1e-5);
        assert_string_equal(warned, "");
        sherf_observation_free(o);
    }
    sherf_observation *o = NULL; /* camera to world is inverted */
    assert_ok(c, sherf_observation_load(
                     c,
                     json(c, "a.png", "m.png",
                          "{\"fov_deg\": 50, \"c2w\": [[0, 0, 1, 5], [0, 1, 0, 6], [-1, 0, 0, 7], "
                          "[0, 0, 0, 1]]}",
                          NULL),
                     &o));
    assert_true(o->camera.T_m[0] == 7 && o->camera.T_m[1] == -6 && o->camera.T_m[2] == -5);
    assert_true(o->camera.R[2] == -1 && o->camera.R[6] == 1);
    sherf_observation_free(o);
    sherf_context_free(c);
}

/* NeRF's transforms.json: the lens beside the frames or inside them; a horizontal field of view. */
static void transforms(void **state) {
    static const char frames[] =
        "\"frames\": [{\"file_path\": \"b\", \"transform_matrix\": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, "
        "0], "
        "[0, 0, 0, 1]]}, {\"transform_matrix\": [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]%s}]";
    static const char lens[] = "\"fl_x\": 50, \"fl_y\": 55, \"cx\": 20, \"cy\": 15, \"w\": 40, \"h\": 30";
    context *c = listening_context();
    for (int i = 0; i < 3; i++) {
        sherf_observation *o = NULL;
        char inside[256] = "", text[1024];
        size_t n = 1;
        strcpy(text, "{");
        if (i == 2) snprintf(inside, sizeof inside, ", %s", lens);
        n += (size_t)sprintf(text + n, "%s, ", i ? lens : "\"camera_angle_x\": 0.7610127542247298");
        n += (size_t)snprintf(text + n, sizeof text - n, frames, inside);
        strcat(text, "}");
        make_text(c, join(folder, "transforms.json"), text);
        warned[0] = 0;
        assert_ok(c, sherf_observation_load(
                         c, json(c, "a.png", "m.png", "\"transforms.json\", \"camera_index\": 1", NULL), &o));
        const double K[9] = {50, 0, 20, 0, i ? 55 : 50, 15, 0, 0, 1};
        for (int k = 0; k < 9; k++) assert_float_equal(o->camera.K[k], K[k], 1e-5);
        assert_true(o->camera.R[0] == 1 && o->camera.R[4] == -1 && o->camera.R[8] == -1);
        assert_true(o->camera.T_m[0] == -1 && o->camera.T_m[1] == 2 && o->camera.T_m[2] == 3);
        assert_null(strstr(warned, "camera_index"));
        sherf_observation_free(o);
    }
    sherf_observation *o = NULL; /* the first of several is taken, with a warning */
    assert_ok(c, sherf_observation_load(c, json(c, "a.png", "m.png", "\"transforms.json\"", NULL), &o));
    assert_non_null(strstr(warned, "the first of 2 is taken; \"camera_index\""));
    sherf_observation_free(o);
    sherf_context_free(c);
}

/* A camera position under an unknown key, or a lens in other units, is refused instead of guessed. */
static void cameras_refused(void **state) {
    static const struct {
        const char *camera, *says;
    } cases[] = {
        {"{\"fov_deg\": 50, \"viewmatrix\": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}",
         "viewmatrix of 16 numbers is not read"},
        {"{\"fov_deg\": 50, \"tvec\": [0, 0, 3], \"cam_quat\": [1, 0, 0, 0]}", "cam_quat of 4 numbers"},
        {"{\"K\": [1.2, 0, 0.5, 0, 1.6, 0.5, 0, 0, 1]}",
         "a focal length of 1.2 pixels for a picture of 40 x 30"},
        {"{\"focal_length\": 50, \"sensor_width\": 36}", "millimetres"},
        {"{\"fov_deg\": 0.7}", "radians?"},
        {"{\"K\": [50, 0, 0, 0, 55, 0, 20, 15, 1]}", "this is the transposed matrix"},
        {"{\"K\": [50, 0, 20, 7, 0, 55, 15, 0, 0, 0, 1, 0]}", "its last column is not 0"},
        {"{\"fov_deg\": 50, \"R\": [178, 40, 2], \"T\": [0, 0, 3]}", "these are degrees"},
        {"{\"fov_deg\": 50, \"R\": [0, 0, 0], \"C\": [0, 0, -3]}", "C of 3 numbers is not read"},
        {"{\"fov_deg\": 50, \"R\": [0, 0, 0], \"camera_center\": [0, 0, -3]}", "camera_center of 3 numbers"},
    };
    static const struct {
        const char *camera, *says;
    } fisheyes[] = {
        {"{\"fov_deg\": 50, \"camera_model\": \"OPENCV_FISHEYE\"}",
         "camera_model OPENCV_FISHEYE: only pinhole"},
        {"{\"fov_deg\": 50, \"is_fisheye\": true}", "undistort the picture first"},
    };
    context *c = test_context();
    for (size_t i = 0; i < COUNT_OF(cases); i++) {
        sherf_observation *o = NULL;
        assert_fails(c, sherf_observation_load(c, json(c, "a.png", "m.png", cases[i].camera, NULL), &o),
                     SHERF_BAD_FILE, cases[i].says);
    }
    for (size_t i = 0; i < COUNT_OF(fisheyes); i++) {
        sherf_observation *o = NULL;
        assert_fails(c, sherf_observation_load(c, json(c, "a.png", "m.png", fisheyes[i].camera, NULL), &o),
                     SHERF_UNSUPPORTED, fisheyes[i].says);
    }
    sherf_context_free(c);
}

/* A distortion in a camera file counts like one in the JSON. */
static void camera_files_have_lenses(void **state) {
    static const char lens[] =
        "\"K\": [[50, 0, 20], [0, 55, 15], [0, 0, 1]], \"R\": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "
        "\"T\": [0, 0.2, 3], \"D\": [-1.5, 0.4, 0.02, -0.02]";
    context *c = test_context();
    sherf_observation *named = NULL, *own = NULL;
    char text[1024];
    snprintf(text, sizeof text, "{\"cameras\": [{%s}]}", lens);
    make_text(c, join(folder, "lens.json"), text);
    snprintf(text, sizeof text, "{%s}", lens);
    assert_ok(c, sherf_observation_load(c, json(c, "a.png", "m.png", "\"lens.json\"", NULL), &named));
    assert_ok(c, sherf_observation_load(c, json(c, "a.png", "m.png", text, NULL), &own));
    assert_memory_equal(named->mask, own->mask, MADE_WIDTH * MADE_HEIGHT);
    int differ = 0;
    for (int i = 0; i < MADE_WIDTH * MADE_HEIGHT; i++)
        differ += own->mask[i] != made_person(i % MADE_WIDTH, i / MADE_WIDTH);
    assert_true(differ > 10);
    sherf_observation_free(named);
    sherf_observation_free(own);
    sherf_context_free(c);
}

static void from_a_folder_with_alpha(void **state) {
    context *c = test_context();
    sherf_observation *o = NULL;
    uint8_t *rgba = mem_zero(c, MADE_WIDTH * MADE_HEIGHT, 4);
    for (int i = 0; i < MADE_WIDTH * MADE_HEIGHT; i++) {
        for (int k = 0; k < 3; k++) rgba[i * 4 + k] = 200;
        rgba[i * 4 + 3] = made_person(i % MADE_WIDTH, i / MADE_WIDTH) ? 128 : 127;
    }
    make_text(c, join(folder, "alpha/camera.json"), "{\"camera\": " CAMERA "}");
    char body[2048];
    snprintf(body, sizeof body, "{\"poses\": %s}", zeros_72);
    make_text(c, join(folder, "alpha/body.json"), body);
    const char *alpha = join(folder, "alpha");
    assert_fails(c, sherf_observation_load(c, alpha, &o), SHERF_NO_FILE, "image.png");
    assert_ok(c, png_write(c, join(folder, "alpha/image.png"), MADE_WIDTH, MADE_HEIGHT, 4, rgba));
    assert_ok(c, sherf_observation_load(c, alpha, &o));
    for (int i = 0; i < MADE_WIDTH * MADE_HEIGHT; i++)
        assert_int_equal(o->mask[i], made_person(i % MADE_WIDTH, i / MADE_WIDTH));
    sherf_observation_free(o);
    make_mask(c, join(folder, "alpha/mask.png"), MADE_WIDTH, MADE_HEIGHT, 255,
              0); /* a mask file takes precedence */
    assert_ok(c, sherf_observation_load(c, alpha, &o));
    assert_int_equal(o->mask[0], 1);
    sherf_observation_free(o);
    mem_free(rgba);
    sherf_context_free(c);
}

/* Soft masks count from one half on, and so do JPEGs, whose black is not quite black. Of labels, and of a few
 * soft values among them, every value counts. */
static void soft_masks(void **state) {
    enum { N = MADE_WIDTH * MADE_HEIGHT };
    context *c = test_context();
    uint8_t mask[N];
    for (int form = 0; form < 3; form++) {
        const bool labels = form == 1;
        for (int i = 0; i < N; i++) {
            int x = i % MADE_WIDTH, y = i / MADE_WIDTH;
            mask[i] = made_person(x, y) ? (labels ? 1 + x % 20 : 255) : 0;
            if (y == 0) mask[i] = labels ? 1 : x < 20 ? 127 : 128;
            if (form == 2 && y) mask[i] = (uint8_t)abs(mask[i] - x % 5);
        }
        assert_ok(c, png_write(c, join(folder, "soft.png"), MADE_WIDTH, MADE_HEIGHT, 1, mask));
        sherf_observation *o = NULL;
        assert_ok(c, sherf_observation_load(c, json(c, "a.png", "soft.png", NULL, NULL), &o));
        for (int i = 0; i < N; i++)
            assert_int_equal(o->mask[i], i < MADE_WIDTH ? labels || i >= 20
                                                        : made_person(i % MADE_WIDTH, i / MADE_WIDTH));
        sherf_observation_free(o);
    }
    sherf_context_free(c);
}

/* Two people with values of their own are not merged; parts of one person, which touch, are, with a line. */
static void labelled_masks(void **state) {
    enum { N = MADE_WIDTH * MADE_HEIGHT };
    static const struct {
        const char *more, *says; /* says: an error if taken is 0, else a warning */
        int taken;               /* sum of the bits of the two people */
        bool parts, color;
    } cases[] = {
        {"", "2 people apart, by values 1 (13 %), 2 (13 %): choose one by \"mask_label\"", 0, false, false},
        {"", "by values [128, 0, 0] (13 %), [0, 128, 0] (13 %)", 0, false, true},
        {", \"mask_label\": 2", "", 2, false, false},
        {", \"mask_label\": [128, 0, 0]", "", 1, false, true},
        {", \"mask_label\": \"all\"", "", 3, false, false},
        {", \"mask_label\": 7", "no pixel has the value of \"mask_label\"; it has 1 (13 %), 2 (13 %)", 0,
         false, false},
        {", \"mask_label\": 0.5", "should be a value of the mask (1 to 255)", 0, false, false},
        {"", "values 1 (13 %), 2 (13 %) are taken together as one person", 3, true, false},
    };
    context *c = listening_context();
    for (size_t i = 0; i < COUNT_OF(cases); i++) {
        uint8_t rgb[N * 3] = {0}, person[N] = {0};
        char name[128];
        for (int p = 0; p < N; p++) {
            const int x = p % MADE_WIDTH, y = p / MADE_WIDTH, left = cases[i].parts ? 12 : 4;
            if (y < 5 || y >= 25) continue;
            person[p] = (uint8_t)(x >= left && x < left + 8 ? 1 : x >= 20 && x < 28 ? 2 : 0);
            for (int k = 0; k < 3; k++)
                rgb[3 * p + k] = cases[i].color ? (person[p] == k + 1 ? 128 : 0) : person[p];
        }
        assert_ok(c, png_write(c, join(folder, "labels.png"), MADE_WIDTH, MADE_HEIGHT, 3, rgb));
        snprintf(name, sizeof name, "{\"fov_deg\": 50}%s", cases[i].more);
        warned[0] = 0;
        sherf_observation *o;
        const char *path = json(c, "a.png", "labels.png", name, NULL);
        if (!cases[i].taken) {
            assert_fails(c, sherf_observation_load(c, path, &o), SHERF_BAD_FILE, cases[i].says);
            continue;
        }
        assert_ok(c, sherf_observation_load(c, path, &o));
        for (int p = 0; p < N; p++) assert_int_equal(o->mask[p], (person[p] & cases[i].taken) != 0);
        if (*cases[i].says ? !strstr(warned, cases[i].says) : *warned) fail_msg("%zu: \"%s\"", i, warned);
        sherf_observation_free(o);
    }
    sherf_context_free(c);
}

/* The same two people as 1 and 2 of 16 bits, which are read with 8. */
static void labels_of_16_bits(void **state) {
    static const uint8_t png[] = {
        137, 80,  78,  71,  13,  10,  26,  10,  0,   0,  0,  13, 73,  72,  68,  82,  0,   0,   0,
        40,  0,   0,   0,   30,  16,  0,   0,   0,   0,  43, 38, 223, 66,  0,   0,   0,   37,  73,
        68,  65,  84,  120, 218, 237, 204, 161, 1,   0,  0,  8,  195, 176, 193, 255, 71,  227, 119,
        1,   34,  173, 79,  162, 199, 77,  221, 109, 13, 4,  2,  129, 64,  160, 222, 119, 244, 38,
        1,   225, 55,  103, 177, 47,  0,   0,   0,   0,  73, 69, 78,  68,  174, 66,  96,  130};
    context *c = listening_context();
    sherf_observation *o;
    FILE *f = fopen(join(folder, "deep.png"), "wb");
    assert_non_null(f);
    assert_int_equal(fwrite(png, 1, sizeof png, f), sizeof png);
    fclose(f);
    assert_ok(c, sherf_observation_load(c, json(c, "a.png", "deep.png", "{\"fov_deg\": 50}", NULL), &o));
    assert_non_null(strstr(warned, "deep.png: values that are black in 8 bits are not told apart"));
    sherf_observation_free(o);
    sherf_context_free(c);
}

/* A matte with a wide soft edge and little white; and one that is white everywhere with a transparent
 * background. */
static void mattes(void **state) {
    enum { N = MADE_WIDTH * MADE_HEIGHT };
    context *c = listening_context();
    for (int form = 0; form < 4; form++) { /* form 3 is a darker form 0 */
        uint8_t pixels[N * 4];
        warned[0] = 0;
        sherf_observation *o = NULL;
        for (int i = 0; i < N; i++) {
            const int x = i % MADE_WIDTH, shade = 12 * (x < 20 ? x : 39 - x) + i / MADE_WIDTH % 7;
            if (form == 3) pixels[i] = (uint8_t)(shade / 2);
            if (form == 0) pixels[i] = (uint8_t)shade; /* at least half of the maximum in columns 11 to 28 */
            for (int k = 0; k < 4 && form == 1; k++) pixels[4 * i + k] = (uint8_t)(k < 3 ? 255 : shade);
            if (form == 2) pixels[i] = made_person(x, i / MADE_WIDTH) ? 0 : 255; /* inverted */
        }
        assert_ok(
            c, png_write(c, join(folder, "matte.png"), MADE_WIDTH, MADE_HEIGHT, form == 1 ? 4 : 1, pixels));
        assert_ok(c, sherf_observation_load(c, json(c, "a.png", "matte.png", NULL, NULL), &o));
        for (int i = 0; i < N; i++) {
            const int x = i % MADE_WIDTH;
            const int first =
                form == 1 ? 11 : 10; /* an alpha counts from 128 on, a grey from half its maximum */
            const bool is = form == 2 ? !made_person(x, i / MADE_WIDTH) : x >= first && x <= 39 - first;
            assert_int_equal(o->mask[i], is);
        }
        assert_int_equal(strstr(warned, "matte.png: the mask covers the border") != NULL, form == 2);
        sherf_observation_free(o);
    }
    sherf_context_free(c);
}

/* A picture without camera and body is recognised under any name. */
static void pictures_are_named(void **state) {
    context *c = test_context();
    sherf_observation *o = NULL;
    uint8_t grey[4] = {0};
    assert_ok(c, png_write(c, join(folder, "alone"), 2, 2, 1, grey));
    assert_fails(c, sherf_observation_load(c, join(folder, "alone"), &o), SHERF_BAD_FILE, "picture alone");
    sherf_context_free(c);
}

static const struct {
    const char *image, *mask, *camera, *body, *message;
    sherf_status status;
} faults[] = {
    {"none.png", "m.png", NULL, NULL, "none.png: cannot be opened", SHERF_NO_FILE},
    {"rubbish.png", "m.png", NULL, NULL, "rubbish.png", SHERF_BAD_FILE},
    {"a.png", "none.png", NULL, NULL, "none.png: cannot be opened", SHERF_NO_FILE},
    {"a.png", NULL, NULL, NULL, "no alpha channel", SHERF_BAD_FILE},
    {"a.png", "small.png", NULL, NULL, "a mask of 39 x 30 pixels for a picture of 40 x 30", SHERF_MISMATCH},
    {"a.png", "empty.png", NULL, NULL, "the mask is empty", SHERF_BAD_ARGUMENT},
    {"a.png", "full.png", NULL, NULL, "covers the whole picture", SHERF_BAD_ARGUMENT},
    {"wide.jpg", "m.png", NULL, NULL, "33000 x 2 pixels: from 1 to 32768 on a side", SHERF_BAD_FILE},
    {"a.png", "m.png", "{}", NULL, "needs K, fov_deg or focal_px", SHERF_BAD_FILE},
    {"a.png", "m.png", "{\"fov_x\": 1}", NULL, "focal_px; this has fov_x", SHERF_BAD_FILE},
    {"a.png", "m.png", "{\"K\": [50, 0, 20, 0, 55, 15, 0, 0]}", NULL, "camera: K", SHERF_BAD_FILE},
    {"a.png", "m.png", "{\"K\": [50, 0, 20, 0, 0, 15, 0, 0, 1]}", NULL, "K is singular", SHERF_BAD_FILE},
    {"a.png", "m.png", "{\"K\": [1e999, 0, 20, 0, 5, 15, 0, 0, 1]}", NULL, "finite", SHERF_BAD_FILE},
    {"a.png", "m.png", "{\"fov_deg\": 180}", NULL, "fov_deg", SHERF_BAD_FILE},
    {"a.png", "m.png", "{\"fov_deg\": 60, \"R\": [1, 0, 0, 0, 1, 0, 0, 0, 2]}", NULL, "not a rotation",
     SHERF_BAD_FILE},
    {"a.png", "m.png", "{\"fov_deg\": 60, \"R\": [1, 0, 0, 0, 1, 0, 0, 0, -1]}", NULL, "mirroring",
     SHERF_BAD_FILE},
    {"a.png", "m.png", "{\"fov_deg\": 60, \"width\": 80}", NULL, "the picture has 40 x 30", SHERF_MISMATCH},
    {"a.png", "m.png", "\"none.json\"", NULL, "none.json", SHERF_NO_FILE},
    {"a.png", "m.png", "{\"fov_deg\": 60, \"D\": [1, 2, 3, 4, 5, 6]}", NULL, "D has 6 numbers",
     SHERF_BAD_FILE},
    {"a.png", "m.png", "{\"fov_deg\": 60, \"RT\": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 2, 3, 1]}", NULL,
     "RT: the last row is not 0 0 0 1, the last column is", SHERF_BAD_FILE},
    {"a.png", "m.png", "{\"fov_deg\": 60, \"T\": [1, 2, 3], \"RT\": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}",
     NULL, "told twice, by RT and by T", SHERF_BAD_FILE},
    {"a.png", "m.png", "{\"fov_deg\": 60}", "{\"body_pose\": %s, \"pred_cam\": [0.9, 0, 0]}",
     "the body has no translation", SHERF_BAD_FILE},
    {"a.png", "m.png", NULL, "{\"mhr_model_params\": [0], \"pred_cam_t\": [0, 0, 2]}", "SAM 3D Body",
     SHERF_UNSUPPORTED},
    {"a.png", "m.png", NULL, "{\"pose3d\": [0]}", "body_pose (69); this has pose3d", SHERF_BAD_FILE},
    {"a.png", "m.png", NULL, "{}", "a body needs poses", SHERF_BAD_FILE},
    {"a.png", "m.png", NULL, "{\"poses\": [1, 2, 3]}", "poses", SHERF_BAD_FILE},
    {"a.png", "m.png", NULL, "{\"body_pose\": \"x\"}", "body_pose", SHERF_BAD_FILE},
    {"a.png", "m.png", NULL, "7", "body", SHERF_BAD_FILE},
    {"a.png", "m.png", NULL, "\"none.npz\"", "none.npz", SHERF_NO_FILE},
    {"", "m.png", NULL, NULL, "\"image\" should name a file", SHERF_BAD_FILE},
};

static void faults_are_told(void **state) {
    context *c = test_context();
    size_t live = mem_live();
    for (size_t i = 0; i < COUNT_OF(faults); i++) {
        sherf_observation *o = NULL;
        const char *path = json(c, faults[i].image, faults[i].mask, faults[i].camera, faults[i].body);
        assert_fails(c, sherf_observation_load(c, path, &o), faults[i].status, faults[i].message);
        assert_null(o);
        assert_null(strchr(c->message, '\n'));
        assert_true(mem_live() == live);
    }
    sherf_observation *o = NULL;
    make_text(c, join(folder, "bad.json"), "{\"image\": ");
    assert_fails(c, sherf_observation_load(c, join(folder, "bad.json"), &o), SHERF_BAD_FILE, "bad.json");
    make_text(c, join(folder, "bad.json"), "[1, 2]");
    assert_fails(c, sherf_observation_load(c, join(folder, "bad.json"), &o), SHERF_BAD_FILE, "bad.json");
    assert_fails(c, sherf_observation_load(c, "/nonexistent", &o), SHERF_NO_FILE, "/nonexistent");
    assert_fails(c, sherf_observation_load(c, "/nonexistent#a/0/1", &o), SHERF_NO_FILE, "/nonexistent");
    assert_fails(c, sherf_observation_load(c, "thuman:x#a/0", &o), SHERF_BAD_ARGUMENT, "PERSON/POSE/VIEW");
    assert_fails(c, sherf_observation_load(c, "thuman:x#a/0/1x", &o), SHERF_BAD_ARGUMENT, "PERSON/POSE/VIEW");
    sherf_context_free(c);
}

static void from_memory(void **state) {
    context *c = test_context();
    float pixels[6 * 4 * 3], mask_pixels[6 * 4] = {0};
    for (int i = 0; i < 72; i++) pixels[i] = 0.5f;
    mask_pixels[9] = 0.001f;
    sherf_image image = {6, 4, 3, pixels}, mask = {6, 4, 1, mask_pixels};
    sherf_camera camera;
    sherf_pose pose;
    const float centre[3] = {0, -0.3f, 0};
    sherf_camera_orbit(centre, 3, 0, 0, 0.8f, 6, 4, &camera);
    sherf_pose_identity(&pose);
    sherf_observation *o = NULL;
    assert_ok(c, sherf_observation_create(c, &image, &mask, &camera, &pose, &o));
    assert_float_equal(o->image.data[9 * 3], 0.5, 0);
    assert_float_equal(o->image.data[8 * 3], 0, 0);
    body_model *body = NULL;
    assert_ok(c, tubeman_create(c, &body));
    assert_ok(c, observation_check_body(c, o, body));
    o->pose.Th_m[0] = 50;
    assert_fails(c, observation_check_body(c, o, body), SHERF_MISMATCH, "outside the picture");
    o->pose.Th_m[0] = 0;
    o->pose.Th_m[2] = 10; /* behind the camera */
    assert_fails(c, observation_check_body(c, o, body), SHERF_MISMATCH, "outside the picture");
    o->pose.Th_m[2] = -50;
    assert_fails(c, observation_check_body(c, o, body), SHERF_MISMATCH, "less than 2 pixels");
    o->pose.Th_m[2] = 0;
    memset(o->mask, 0, 6 * 4);
    o->mask[23] = 1; /* a corner without the body */
    assert_fails(c, observation_check_body(c, o, body), SHERF_MISMATCH, "inside the mask");
    sherf_observation_free(o);
    sherf_body_free(body);
    mask.width = 5;
    assert_fails(c, sherf_observation_create(c, &image, &mask, &camera, &pose, &o), SHERF_BAD_ARGUMENT,
                 "5 x 4 x 1");
    mask.width = 6;
    pose.poses_rad[70] = NAN;
    assert_fails(c, sherf_observation_create(c, &image, &mask, &camera, &pose, &o), SHERF_BAD_ARGUMENT,
                 "value 70");
    pose.poses_rad[70] = 0;
    pose.R[0] = 2;
    assert_fails(c, sherf_observation_create(c, &image, &mask, &camera, &pose, &o), SHERF_BAD_FILE, "R");
    pose.R[0] = 1;
    camera.T_m[1] = INFINITY;
    assert_fails(c, sherf_observation_create(c, &image, &mask, &camera, &pose, &o), SHERF_BAD_ARGUMENT, "T");
    camera.T_m[1] = 0;
    camera.width_px = 7;
    assert_fails(c, sherf_observation_create(c, &image, &mask, &camera, &pose, &o), SHERF_MISMATCH, "7 x 4");
    camera.width_px = 6;
    pixels[9 * 3 + 1] = NAN;
    assert_fails(c, sherf_observation_create(c, &image, &mask, &camera, &pose, &o), SHERF_BAD_ARGUMENT,
                 "picture");
    assert_null(o);
    sherf_context_free(c);
}

/* A picture of 8192 x 64 pixels in equal blocks of 4 x 4 is scaled down by four, in file and memory. Larger
 * ones are refused. */
static void large_pictures_shrink(void **state) {
    enum { W = 8192, H = 64 };
    context *c = test_context();
    uint8_t *rgb = mem_zero(c, W * H, 3), *inside = mem_zero(c, W * H, 1);
    float *pixels = mem_zero(c, W * H, 3 * sizeof *pixels), *person = mem_zero(c, W * H, sizeof *person);
    for (int i = 0; i < W * H; i++) {
        int x = i % W / 4, y = i / W / 4;
        person[i] = inside[i] = x >= 1000 && x < 1100 && y >= 4 && y < 14;
        for (int k = 0; k < 3; k++)
            rgb[3 * i + k] = made_color(3, x, y, k), pixels[3 * i + k] = rgb[3 * i + k] / 255.f;
    }
    assert_ok(c, png_write(c, join(folder, "large.png"), W, H, 3, rgb));
    assert_ok(c, png_write(c, join(folder, "large_mask.png"), W, H, 1, inside));
    sherf_image image = {W, H, 3, pixels}, mask = {W, H, 1, person};
    sherf_camera camera = {
        W, H, {5000, 0, 4096, 0, 5500, 32, 0, 0, 1}, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0.2f, 3}};
    sherf_pose pose;
    sherf_pose_identity(&pose);
    for (int from_memory = 0; from_memory < 2; from_memory++) {
        sherf_observation *o = NULL;
        if (from_memory)
            assert_ok(c, sherf_observation_create(c, &image, &mask, &camera, &pose, &o));
        else
            assert_ok(c, sherf_observation_load(c,
                                                json(c, "large.png", "large_mask.png",
                                                     "{\"K\": [5000, 0, 4096, 0, 5500, 32, 0, 0, 1]}", NULL),
                                                &o));
        assert_true(o->image.width == 2048 && o->image.height == 16 && o->camera.width_px == 2048);
        assert_true(o->camera.K[0] == 1250 && o->camera.K[2] == 1024 && o->camera.K[4] == 1375 &&
                    o->camera.K[5] == 8);
        for (int i = 0; i < 2048 * 16; i++) {
            int x = i % 2048, y = i / 2048;
            bool is = x >= 1000 && x < 1100 && y >= 4 && y < 14;
            assert_int_equal(o->mask[i], is);
            for (int k = 0; k < 3; k++)
                assert_float_equal(o->image.data[3 * i + k], is ? made_color(3, x, y, k) / 255. : 0, 1e-6);
        }
        sherf_observation_free(o);
    }
    sherf_observation *o = NULL;
    image.width = mask.width = 32769;
    assert_fails(c, sherf_observation_create(c, &image, &mask, &camera, &pose, &o), SHERF_UNSUPPORTED,
                 "at most 32768");
    image.width = mask.width = W;
    camera.width_px = 0;
    assert_fails(c, sherf_observation_create(c, &image, &mask, &camera, &pose, &o), SHERF_BAD_ARGUMENT,
                 "0 x 64");
    mem_free(rgb), mem_free(inside), mem_free(pixels), mem_free(person);
    sherf_context_free(c);
}

static void poses_from_files(void **state) {
    context *c = test_context();
    sherf_pose *pose = NULL;
    int count = 0;
    float poses[3 * 72], trans[9], betas[10] = {1, 2}, few[3 * 69];
    for (int i = 0; i < 216; i++) poses[i] = (float)i / 100;
    for (int i = 0; i < 207; i++) few[i] = (float)i / 100;
    for (int i = 0; i < 9; i++) trans[i] = (float)i;
    const char *path = join(folder, "motion.npz");
    npz_member member[] = {
        {"poses", 2, {3, 72}, poses}, {"trans", 2, {3, 3}, trans}, {"betas", 1, {10}, betas}};
    assert_ok(c, npz_write(c, path, 3, member));
    assert_ok(c, sherf_poses_load(c, path, &pose, &count));
    assert_int_equal(count, 3);
    assert_float_equal(pose[2].poses_rad[1], 1.45, 1e-6);
    assert_float_equal(pose[1].Th_m[2], 5, 0);
    assert_float_equal(pose[2].shapes[1], 2, 0);
    sherf_free(pose);
    npz_member smpl[] = {{"body_pose", 2, {3, 69}, few},
                         {"global_orient", 2, {3, 3}, trans},
                         {"transl", 2, {1, 3}, trans + 3}};
    assert_ok(c, npz_write(c, path, 3, smpl)); /* 3 x 69 numbers, not 23 matrices */
    assert_ok(c, sherf_poses_load(c, path, &pose, &count));
    assert_int_equal(count, 3);
    assert_float_equal(pose[1].poses_rad[3], 0.69, 1e-6);
    assert_float_equal(pose[2].poses_rad[0], 6, 0);
    assert_float_equal(pose[2].Th_m[0], 3, 0); /* one row applies to all frames */
    sherf_free(pose);
    make_parameters(c, join(folder, "7.npy"), 7, true);
    assert_ok(c, sherf_poses_load(c, join(folder, "7.npy"), &pose, &count));
    assert_int_equal(count, 1);
    sherf_free(pose);
    char text[8192];
    snprintf(text, sizeof text, "{\"frames\": [{\"poses\": %s}, {\"body_pose\": %s, \"Th\": [0, 1, 2]}]}",
             zeros_72, zeros_69);
    make_text(c, join(folder, "frames.json"), text);
    assert_ok(c, sherf_poses_load(c, join(folder, "frames.json"), &pose, &count));
    assert_int_equal(count, 2);
    assert_float_equal(pose[0].poses_rad[5], 0.25, 1e-7);
    assert_float_equal(pose[1].Th_m[2], 2, 0);
    sherf_free(pose);
    assert_ok(c, sherf_poses_load(c, json(c, "a.png", "m.png", NULL, NULL), &pose, &count));
    assert_float_equal(pose->Th_m[0], 1, 0);
    sherf_free(pose);
    npz_member hands[] = {{"poses", 2, {1, 156}, poses}};
    assert_ok(c, npz_write(c, path, 1, hands));
    assert_ok(c,
              sherf_poses_load(c, path, &pose, &count)); /* SMPL+H: fingers are ignored, hands stay at rest */
    assert_int_equal(count, 1);
    assert_float_equal(pose->poses_rad[65], 0.65, 1e-6);
    assert_float_equal(pose->poses_rad[66], 0, 0);
    sherf_free(pose);
    hands[0].dim[1] = 157;
    assert_ok(c, npz_write(c, path, 1, hands));
    assert_fails(c, sherf_poses_load(c, path, &pose, &count), SHERF_BAD_FILE, "poses has 157 numbers");
    for (int i = 0; i < 72; i++) few[i] = 57.3f * poses[i + 72];
    npz_member degrees = {"poses", 2, {1, 72}, few};
    assert_ok(c, npz_write(c, path, 1, &degrees));
    assert_fails(c, sherf_poses_load(c, path, &pose, &count), SHERF_BAD_FILE, "these are degrees");
    poses[80] = NAN;
    assert_ok(c, npz_write(c, path, 3, member));
    assert_fails(c, sherf_poses_load(c, path, &pose, &count), SHERF_BAD_FILE, "pose 1: poses");
    assert_null(pose);
    make_text(c, join(folder, "frames.json"), "[]");
    assert_fails(c, sherf_poses_load(c, join(folder, "frames.json"), &pose, &count), SHERF_BAD_FILE,
                 "no poses");
    sherf_context_free(c);
}

static void cameras_from_files(void **state) {
    context *c = test_context();
    sherf_camera *camera = NULL;
    int count = 0;
    char text[4096] = "{\"kinect_depth_000\": {\"K\": [1]}, ";
    for (int v = 0; v < 2; v++) {
        char name[32];
        snprintf(name, sizeof name, "kinect_color_%03d", v);
        made_camera_json(text + strlen(text), sizeof text - strlen(text), name, v);
    }
    strcat(text, "}");
    const char *path = join(folder, "cameras.json");
    make_text(c, path, text);
    assert_ok(c, sherf_cameras_load(c, path, &camera, &count));
    assert_int_equal(count, 2);
    assert_int_equal(camera[1].width_px, 0);
    assert_float_equal(camera[1].T_m[2], 3, 0);
    sherf_free(camera);
    make_text(c, path,
              "{\"cameras\": [{\"K\": [9, 0, 1, 0, 9, 2, 0, 0, 1], \"R\": [1, 0, 0, 0, 1, 0, 0, 0, 1], "
              "\"T\": [0, 0, 4], "
              "\"width\": 640, \"height\": 480}]}");
    assert_ok(c, sherf_cameras_load(c, path, &camera, &count));
    assert_int_equal(count, 1);
    assert_int_equal(camera->height_px, 480);
    sherf_free(camera);
    make_text(c, path, "{\"cameras\": []}");
    assert_fails(c, sherf_cameras_load(c, path, &camera, &count), SHERF_BAD_FILE, "no cameras");
    make_text(c, path,
              "{\"cameras\": [{\"K\": [0, 0, 1, 0, 9, 2, 0, 0, 1], \"R\": [1, 0, 0, 0, 1, 0, 0, 0, 1], "
              "\"T\": [0, 0, 4]}]}");
    assert_fails(c, sherf_cameras_load(c, path, &camera, &count), SHERF_BAD_FILE,
                 "camera 0: camera: K is singular");
    assert_null(camera);
    sherf_context_free(c);
}

static void memory_runs_out(void **state) {
    context *c = test_context();
    make_text(c, join(folder, "camera_of.json"),
              "{\"cameras\": [{\"K\": [50, 0, 20, 0, 50, 15, 0, 0, 1], \"R\": [1, 0, 0, 0, 1, 0, 0, 0, 1], "
              "\"T\": [0, 0, 4]}]}");
    make_parameters(c, join(folder, "body_of.npy"), 3, true);
    char path[PATH_LENGTH];
    strcpy(path, json(c, "a.png", "m.png", "\"camera_of.json\"", "\"body_of.npy\""));
    size_t live = mem_live();
    long n = 0;
    for (bool done = false; !done; n++) {
        sherf_observation *o = NULL;
        mem_fail_after(n);
        sherf_status status = sherf_observation_load(c, path, &o);
        mem_fail_after(-1);
        done = status == SHERF_OK;
        if (!done) {
            assert_int_equal(status, SHERF_NO_MEMORY);
            assert_null(o);
            assert_non_null(strstr(c->message, "memory"));
        }
        sherf_observation_free(o);
        assert_true(mem_live() == live);
    }
    assert_true(n > 15);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(from_json),
        cmocka_unit_test(body_forms),
        cmocka_unit_test(body_names),
        cmocka_unit_test(smplx_bodies),
        cmocka_unit_test(multi_hmr),
        cmocka_unit_test(quaternions_and_scaling),
        cmocka_unit_test(six_numbers),
        cmocka_unit_test(mesh_infos),
        cmocka_unit_test(six_numbers_of_frames),
        cmocka_unit_test(transforms),
        cmocka_unit_test(cameras_refused),
        cmocka_unit_test(unknown_keys_are_named),
        cmocka_unit_test(camera_names),
        cmocka_unit_test(camera_files_have_lenses),
        cmocka_unit_test(mattes),
        cmocka_unit_test(from_a_folder_with_alpha),
        cmocka_unit_test(soft_masks),
        cmocka_unit_test(labelled_masks),
        cmocka_unit_test(labels_of_16_bits),
        cmocka_unit_test(pictures_are_named),
        cmocka_unit_test(faults_are_told),
        cmocka_unit_test(from_memory),
        cmocka_unit_test(large_pictures_shrink),
        cmocka_unit_test(poses_from_files),
        cmocka_unit_test(cameras_from_files),
        cmocka_unit_test(memory_runs_out),
    };
    return cmocka_run_group_tests(tests, make_basics, NULL);
}
