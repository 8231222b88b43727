/* Tests of every motion format, written by its rules: the same walk gives the same body poses; and of hostile
 * files. */
#include "formats.h"

#include "base/path.h"
#include "data/bvh_names.h"
#include "io/value.h"

/* Copies the first `width` numbers of rows of 165. */
static float *rows(const float (*from)[165], int width) {
    static float out[WALK_FRAMES * 165];
    for (int i = 0; i < WALK_FRAMES; i++) memcpy(out + i * width, from[i], (size_t)width * sizeof *out);
    return out;
}

static const float betas[16] = {0.5f, -0.25f};

static void amass(void **state) {
    const walk_fixture *f = *state;
    const float rate = 20;
    arrays a;
    arrays_of(&f->walk, walk_z_up, &a);
    const char *path = test_path("amass.npz");
    npz_member smplh[] = {{"poses", 2, {WALK_FRAMES, 156}, rows(a.whole, 156)},
                          {"trans", 2, {WALK_FRAMES, 3}, a.trans[0]},
                          {"betas", 1, {16}, betas},
                          {"mocap_framerate", 0, {0}, &rate},
                          {.name = "gender", .text = "female"}};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(smplh), smplh));
    assert_walk(f, path, NULL, 20, "AMASS, SMPL+H", "z up");
    sherf_motion *motion;
    assert_ok(f->c, sherf_motion_load(f->c, path, NULL, &motion));
    assert_float_equal(sherf_motion_shapes(motion)[1], -0.25, 0);
    sherf_pose p;
    sherf_motion_pose(motion, 0, &p);
    assert_float_equal(p.shapes[0], 0, 0); /* not requested */
    sherf_motion_free(motion);
    assert_ok(f->c, sherf_motion_load(f->c, path, &(sherf_motion_options){.their_shape = 1}, &motion));
    sherf_motion_pose(motion, 0, &p);
    assert_float_equal(p.shapes[0], 0.5, 0);
    sherf_motion_free(motion);

    npz_member smplx[] = {{"poses", 2, {WALK_FRAMES, 165}, a.whole[0]},
                          {"trans", 2, {WALK_FRAMES, 3}, a.transx[0]},
                          {"mocap_frame_rate", 1, {1}, &rate}};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(smplx), smplx));
    assert_walk(f, path, NULL, 20, "AMASS, SMPL-X", "z up");

    float body[WALK_FRAMES][63], jaw[WALK_FRAMES][3] = {{0}};
    for (int i = 0; i < WALK_FRAMES; i++) memcpy(body[i], a.body[i], sizeof body[i]);
    npz_member parts[] = {{"root_orient", 2, {WALK_FRAMES, 3}, a.root[0]},
                          {"pose_body", 2, {WALK_FRAMES, 63}, body[0]},
                          {"trans", 2, {WALK_FRAMES, 3}, a.trans[0]},
                          {"mocap_frame_rate", 0, {0}, &rate}};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(parts), parts));
    assert_walk(f, path, NULL, 20, "SMPL-X by parts", "z up");
    assert_walk(f, path, &(sherf_motion_options){.source_fps = 24}, 24, "24 a second", "z up");
    npz_member faced[] = {parts[0],
                          parts[1],
                          {"trans", 2, {WALK_FRAMES, 3}, a.transx[0]},
                          parts[3],
                          {"pose_jaw", 2, {WALK_FRAMES, 3}, jaw[0]}};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(faced), faced)); /* a jaw: SMPL-X */
    assert_walk(f, path, NULL, 20, "SMPL-X by parts", "z up");
    faced[4] = (npz_member){.name = "surface_model_type", .text = "smplx"};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(faced), faced));
    assert_walk(f, path, NULL, 20, "SMPL-X by parts", "z up");
    parts[2].data = a.trans[0]; /* in centimetres and millimetres, detected by the height of the pelvis */
    for (int i = 0; i < WALK_FRAMES * 3; i++) a.trans[i / 3][i % 3] *= 100;
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(parts), parts));
    assert_walk(f, path, NULL, 20, "centimetres", "z up");
    for (int i = 0; i < WALK_FRAMES * 3; i++) a.trans[i / 3][i % 3] *= 10;
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(parts), parts));
    assert_walk(f, path, NULL, 20, "millimetres", "z up");
    assert_walk(f, path, &(sherf_motion_options){.scale = 0.001}, 20, "millimetres", "z up");
}

/* A file with y up whose format usually has z up, and rotations as matrices and quaternions. */
static void found_by_content(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("found.npz");
    const float rate = 20;
    arrays a;
    static float matrix[WALK_FRAMES][24][9], wxyz[WALK_FRAMES][24][4], xyzw[WALK_FRAMES][24][4];
    arrays_of(&f->walk, walk_y_up, &a);
    for (int i = 0; i < WALK_FRAMES; i++)
        for (int j = 0; j < 24; j++) {
            double v[3] = {a.smpl[i][3 * j], a.smpl[i][3 * j + 1], a.smpl[i][3 * j + 2]};
            quaternion_from_axis_angle(v, wxyz[i][j]);
            for (int k = 0; k < 4; k++) xyzw[i][j][(k + 3) % 4] = wxyz[i][j][k];
            rodrigues(a.smpl[i] + 3 * j, matrix[i][j]);
        }
    npz_member member[] = {{"poses", 2, {WALK_FRAMES, 72}, a.smpl[0]},
                           {"trans", 2, {WALK_FRAMES, 3}, a.trans[0]},
                           {"mocap_frame_rate", 0, {0}, &rate}};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(member), member));
    assert_walk(f, path, NULL, 20, "AMASS, SMPL", "y up");
    refused(f, path, &(sherf_motion_options){.rotations = SHERF_ROTATIONS_MATRIX}, SHERF_BAD_FILE,
            "72 numbers");
    member[0] = (npz_member){"poses", 4, {WALK_FRAMES, 24, 3, 3}, matrix[0][0]};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(member), member));
    assert_walk(f, path, NULL, 20, "AMASS, SMPL", "y up");
    member[0] = (npz_member){"poses", 3, {WALK_FRAMES, 24, 4}, wxyz[0][0]};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(member), member));
    assert_walk(f, path, NULL, 20, "AMASS, SMPL", "y up");
    member[0] = (npz_member){"poses", 3, {WALK_FRAMES, 24, 4}, xyzw[0][0]};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(member), member));
    assert_walk(f, path, NULL, 20, "AMASS, SMPL", "y up");
    assert_walk(f, path, &(sherf_motion_options){.rotations = SHERF_ROTATIONS_XYZW}, 20, "AMASS", "y up");
    sherf_motion
        *motion; /* the wrong order turns the person over or is not a rotation, but it was requested */
    assert_ok(f->c, sherf_motion_load(f->c, path, &(sherf_motion_options){.rotations = SHERF_ROTATIONS_WXYZ},
                                      &motion));
    sherf_motion_free(motion);
}

static void aist(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("aist.pkl");
    const float scaling = 93.5f;
    arrays a;
    arrays_of(&f->walk, walk_y_up, &a);
    for (int i = 0; i < WALK_FRAMES * 3; i++) a.trans[i / 3][i % 3] *= scaling;
    pickle_writer w;
    pickle_begin(&w, f->c);
    pickle_dict_open(&w);
    pickle_string(&w, "smpl_loss");
    pickle_int(&w, 3);
    floats(&w, "smpl_poses", 72, a.smpl[0]);
    pickle_string(&w, "smpl_scaling");
    pickle_floats(&w, 1, (const int[]){1}, &scaling);
    floats(&w, "smpl_trans", 3, a.trans[0]);
    pickle_dict_close(&w);
    assert_ok(f->c, pickle_finish_file(&w, path));
    assert_walk(f, path, NULL, 60, "AIST++", "y up");
    sherf_motion *motion; /* at 25 frames a second */
    assert_ok(f->c, sherf_motion_load(f->c, path, &(sherf_motion_options){.fps = 25}, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), 5); /* 11 / 60 s */
    sherf_motion_free(motion);
    assert_ok(f->c, sherf_motion_load(f->c, path, &(sherf_motion_options){.fps_max = 40}, &motion));
    assert_float_equal(sherf_motion_fps(motion), 30, 1e-9);
    sherf_motion_free(motion);
}

static void gvhmr(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("gvhmr.npz"), *nested = test_path("gvhmr.pkl");
    arrays a;
    float body[WALK_FRAMES][63], shape[WALK_FRAMES][10] = {{0}};
    arrays_of(&f->walk, walk_y_up, &a);
    for (int i = 0; i < WALK_FRAMES; i++) memcpy(body[i], a.body[i], sizeof body[i]);
    npz_member member[] = {{"smpl_params_global/body_pose", 2, {WALK_FRAMES, 63}, body[0]},
                           {"smpl_params_global/global_orient", 2, {WALK_FRAMES, 3}, a.root[0]},
                           {"smpl_params_global/transl", 2, {WALK_FRAMES, 3}, a.transx[0]},
                           {"smpl_params_global/betas", 2, {WALK_FRAMES, 10}, shape[0]}};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(member), member));
    assert_walk(f, path, NULL, 30, "GVHMR", "(assumed)");
    for (int i = 0; i < 4; i++) member[i].name += strlen("smpl_params_global/");
    member[2].data = a.trans[0]; /* nothing shows that it is SMPL-X now */
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(member), member));
    assert_walk(f, path, NULL, 30, "SMPL poses", "body shape");
    pickle_writer w;
    pickle_begin(&w, f->c);
    pickle_dict_open(&w);
    pickle_string(&w, "smpl_params_global");
    pickle_dict_open(&w);
    floats(&w, "body_pose", 63, body[0]);
    floats(&w, "betas", 10, shape[0]);
    floats(&w, "global_orient", 3, a.root[0]);
    floats(&w, "transl", 3, a.transx[0]);
    pickle_dict_close(&w);
    pickle_string(&w, "K_fullimg");
    pickle_list_open(&w);
    pickle_list_close(&w);
    pickle_dict_close(&w);
    assert_ok(f->c, pickle_finish_file(&w, nested));
    assert_walk(f, nested, NULL, 30, "GVHMR", "y up");
}

static void wham_track(pickle_writer *w, int id, int frames, const arrays *world, const arrays *camera,
                       const double *ids) {
    pickle_int(w, id);
    pickle_dict_open(w);
    const struct {
        const char *key;
        int width;
        const float *data;
    } part[] = {{"pose", 72, camera->smpl[0]},
                {"trans", 3, camera->trans[0]},
                {"pose_world", 72, world->smpl[0]},
                {"trans_world", 3, world->trans[0]}};
    for (size_t i = 0; i < COUNT_OF(part); i++) {
        pickle_string(w, part[i].key);
        pickle_floats(w, 2, (const int[]){frames, part[i].width}, part[i].data);
    }
    pickle_string(w, "frame_ids");
    pickle_doubles(w, 1, (const int[]){frames}, ids);
    pickle_dict_close(w);
}

static void wham(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("wham.pkl");
    arrays world, camera;
    double ids[WALK_FRAMES], wrong[WALK_FRAMES] = {5, 4};
    arrays_of(&f->walk, walk_y_up, &world);
    arrays_of(&f->walk, walk_y_down, &camera);
    for (int i = 0; i < WALK_FRAMES; i++) ids[i] = 40 + i;
    pickle_writer w;
    pickle_begin(&w, f->c);
    pickle_dict_open(&w);
    wham_track(&w, 3, 4, &world, &camera, ids);
    wham_track(&w, 7, WALK_FRAMES, &world, &camera, ids);
    wham_track(&w, 9, 3, &world, &camera, wrong);
    pickle_dict_close(&w);
    assert_ok(f->c, pickle_finish_file(&w, path));
    assert_walk(f, path, NULL, 30, "WHAM", "track 7 of 3");
    sherf_motion *motion;
    assert_ok(f->c, sherf_motion_load(f->c, path, &(sherf_motion_options){.track = "3"}, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), 4);
    sherf_motion_free(motion);
    refused(f, path, &(sherf_motion_options){.track = "4"}, SHERF_BAD_ARGUMENT, "'4' among the 3");
    refused(f, path, &(sherf_motion_options){.track = "9"}, SHERF_BAD_FILE, "ascend");
}

/* The first version's files: matrices, with a separate root. */
static void wham_by_parts(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("wham_parts.pkl");
    static float body[WALK_FRAMES][23][9], root[WALK_FRAMES][9];
    double ids[WALK_FRAMES];
    arrays world;
    arrays_of(&f->walk, walk_y_up, &world);
    for (int i = 0; i < WALK_FRAMES; i++) {
        ids[i] = i;
        rodrigues(world.smpl[i], root[i]);
        for (int j = 1; j < 24; j++) rodrigues(world.smpl[i] + 3 * j, body[i][j - 1]);
    }
    pickle_writer w;
    pickle_begin(&w, f->c);
    pickle_dict_open(&w);
    pickle_int(&w, 0);
    pickle_dict_open(&w);
    pickle_string(&w, "poses_body");
    pickle_floats(&w, 4, (const int[]){WALK_FRAMES, 23, 3, 3}, body[0][0]);
    pickle_string(&w, "poses_root_world");
    pickle_floats(&w, 4, (const int[]){WALK_FRAMES, 1, 3, 3}, root[0]);
    pickle_string(&w, "trans_world");
    pickle_floats(&w, 2, (const int[]){WALK_FRAMES, 3}, world.trans[0]);
    pickle_string(&w, "frame_id");
    pickle_doubles(&w, 1, (const int[]){WALK_FRAMES}, ids);
    pickle_dict_close(&w);
    pickle_dict_close(&w);
    assert_ok(f->c, pickle_finish_file(&w, path));
    assert_walk(f, path, NULL, 30, "WHAM", "y up");
}

/* ---- other tools' dicts ---- */

static void other_dicts(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("other.npz");
    static float matrix[WALK_FRAMES][24][9], body[2][WALK_FRAMES][63], root[2][WALK_FRAMES][3],
        trans[2][WALK_FRAMES][3], mask[2][WALK_FRAMES], numbers[WALK_FRAMES];
    arrays down, up;
    arrays_of(&f->walk, walk_y_down, &down);
    arrays_of(&f->walk, walk_y_up, &up);
    for (int i = 0; i < WALK_FRAMES; i++) {
        for (int j = 0; j < 24; j++) rodrigues(down.smpl[i] + 3 * j, matrix[i][j]);
        memcpy(body[1][i], up.body[i], sizeof body[1][i]);
        memcpy(root[1][i], up.root[i], sizeof root[1][i]);
        memcpy(trans[1][i], up.trans[i], sizeof trans[1][i]);
        mask[1][i] = 1, mask[0][i] = i < 4;
        numbers[i] = (float)i;
    }
    npz_member cliff[] = {{"pose", 2, {WALK_FRAMES, 72}, down.smpl[0]},
                          {"shape", 2, {1, 10}, betas},
                          {"global_t", 2, {WALK_FRAMES, 3}, down.trans[0]}};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(cliff), cliff));
    assert_walk(f, path, NULL, 30, "CLIFF", "y down");
    npz_member tram[] = {{"pred_rotmat", 4, {WALK_FRAMES, 24, 3, 3}, matrix[0][0]},
                         {"pred_shape", 2, {1, 10}, betas},
                         {"frame", 1, {WALK_FRAMES}, numbers},
                         {"pred_trans", 3, {WALK_FRAMES, 1, 3}, down.trans[0]}};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(tram), tram));
    assert_walk(f, path, NULL, 30, "TRAM", "y down");
    npz_member slahmr[] = {{"pose_body", 3, {2, WALK_FRAMES, 63}, body[0][0]},
                           {"root_orient", 3, {2, WALK_FRAMES, 3}, root[0][0]},
                           {"trans", 3, {2, WALK_FRAMES, 3}, trans[0][0]},
                           {"betas", 2, {2, 5}, betas},
                           {"track_mask", 2, {2, WALK_FRAMES}, mask[0]}};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(slahmr), slahmr));
    assert_walk(f, path, NULL, 30, "SLAHMR", "track 1 of 2");
    sherf_motion *motion;
    assert_ok(f->c, sherf_motion_load(f->c, path, &(sherf_motion_options){.track = "0"}, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), 4);
    sherf_motion_free(motion);
    refused(f, path, &(sherf_motion_options){.track = "2"}, SHERF_BAD_ARGUMENT, "'2' among the 2");
    npz_member aitviewer[] = {{"poses_body", 2, {WALK_FRAMES, 63}, body[1][0]},
                              {"poses_root", 2, {WALK_FRAMES, 3}, up.root[0]},
                              {"trans", 2, {WALK_FRAMES, 3}, up.trans[0]}};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(aitviewer), aitviewer));
    assert_walk(f, path, NULL, 30, "aitviewer", "y up");
    npz_member batch[] = {{"smpl_params_global/body_pose", 3, {1, WALK_FRAMES, 63}, body[1][0]},
                          {"smpl_params_global/global_orient", 3, {1, WALK_FRAMES, 3}, up.root[0]},
                          {"smpl_params_global/transl", 3, {1, WALK_FRAMES, 3}, up.transx[0]}};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(batch), batch));
    assert_walk(f, path, NULL, 30, "GVHMR", "y up");
}

/* EasyMocap: a separate root rotation about the origin. */
static void root_apart(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("mocap.npz");
    static float whole[WALK_FRAMES][72], Th[WALK_FRAMES][3];
    arrays up;
    arrays_of(&f->walk, walk_y_up, &up);
    for (int i = 0; i < WALK_FRAMES; i++) {
        float R[9];
        const double *J0 = f->walk.skeleton.rest_m[0];
        memcpy(whole[i] + 3, up.body[i], sizeof up.body[i]);
        rodrigues(up.root[i], R);
        for (int k = 0; k < 3; k++)
            Th[i][k] = (float)(up.trans[i][k] + J0[k] -
                               (R[3 * k] * J0[0] + R[3 * k + 1] * J0[1] + R[3 * k + 2] * J0[2]));
    }
    npz_member mocap[] = {{"poses", 2, {WALK_FRAMES, 72}, whole[0]},
                          {"Rh", 2, {WALK_FRAMES, 3}, up.root[0]},
                          {"Th", 2, {WALK_FRAMES, 3}, Th[0]}};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(mocap), mocap));
    assert_walk(f, path, NULL, 30, "SMPL poses", "y up");
}

/* Nested dicts, and lists with one entry per person. */
static void other_pickles(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("other.pkl");
    arrays up, down, z;
    pickle_writer w;
    arrays_of(&f->walk, walk_y_up, &up);
    arrays_of(&f->walk, walk_y_down, &down);
    arrays_of(&f->walk, walk_z_up, &z);
    pickle_begin(&w, f->c);
    pickle_dict_open(&w);
    pickle_string(&w, "results");
    pickle_dict_open(&w);
    floats(&w, "smpl_thetas", 72, down.smpl[0]);
    floats(&w, "cam_trans", 3, down.trans[0]);
    pickle_dict_close(&w);
    pickle_dict_close(&w);
    assert_ok(f->c, pickle_finish_file(&w, path));
    assert_walk(f, path, NULL, 30, "ROMP", "y down");
    pickle_begin(&w, f->c); /* EMDB */
    pickle_dict_open(&w);
    pickle_string(&w, "smpl");
    pickle_dict_open(&w);
    floats(&w, "poses_root", 3, up.root[0]);
    floats(&w, "poses_body", 69, up.body[0]);
    floats(&w, "trans", 3, up.trans[0]);
    pickle_dict_close(&w);
    pickle_string(&w, "name");
    pickle_string(&w, "P0");
    pickle_dict_close(&w);
    assert_ok(f->c, pickle_finish_file(&w, path));
    assert_walk(f, path, NULL, 30, "EMDB", "y up");
    pickle_begin(&w, f->c); /* 3DPW: a person with fewer frames comes first */
    pickle_dict_open(&w);
    static const char *const key[] = {"poses", "trans"};
    for (int k = 0; k < 2; k++) {
        const int width = k ? 3 : 72;
        pickle_string(&w, key[k]);
        pickle_list_open(&w);
        pickle_floats(&w, 2, (const int[]){2, width}, k ? z.trans[0] : z.smpl[0]);
        pickle_floats(&w, 2, (const int[]){WALK_FRAMES, width}, k ? up.trans[0] : up.smpl[0]);
        pickle_list_close(&w);
    }
    pickle_string(&w, "cam_poses");
    pickle_floats(&w, 2, (const int[]){4, 4}, z.smpl[0]);
    pickle_dict_close(&w);
    assert_ok(f->c, pickle_finish_file(&w, path));
    assert_walk(f, path, NULL, 30, "3DPW", "track 1 of 2");
}

/* EDGE in metres, z up; AIST++ in centimetres without its scaling. */
static void dances(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("dance.pkl");
    arrays up, z;
    pickle_writer w;
    arrays_of(&f->walk, walk_y_up, &up);
    arrays_of(&f->walk, walk_z_up, &z);
    for (int full = 0; full < 2; full++) {
        for (int i = 0; i < WALK_FRAMES * 3 && !full; i++) up.trans[i / 3][i % 3] *= 100;
        pickle_begin(&w, f->c);
        pickle_dict_open(&w);
        floats(&w, "smpl_poses", 72, full ? z.smpl[0] : up.smpl[0]);
        floats(&w, "smpl_trans", 3, full ? z.trans[0] : up.trans[0]);
        if (full) floats(&w, "full_pose", 72, z.smpl[0]);
        pickle_dict_close(&w);
        assert_ok(f->c, pickle_finish_file(&w, path));
        assert_walk(f, path, NULL, full ? 30 : 60, full ? "EDGE" : "AIST++ without its scaling",
                    full ? "z up" : "centimetres");
    }
}

/* Plain arrays: one row with everything, and 6 numbers per rotation with the frames last. */
static void other_arrays(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("other.npy");
    static float row[WALK_FRAMES][322], six[24][6][WALK_FRAMES], place[3][WALK_FRAMES];
    arrays up;
    arrays_of(&f->walk, walk_y_up, &up);
    for (int i = 0; i < WALK_FRAMES; i++) {
        memcpy(row[i], up.smpl[i], 66 * sizeof(float));
        memcpy(row[i] + 309, up.transx[i], 3 * sizeof(float));
        for (int j = 0; j < 24; j++) {
            float R[9];
            rodrigues(up.smpl[i] + 3 * j, R);
            for (int k = 0; k < 6; k++) six[j][k][i] = R[k];
        }
        for (int k = 0; k < 3; k++) place[k][i] = (float)(up.trans[i][k] + f->walk.skeleton.rest_m[0][k]);
    }
    assert_ok(f->c, npy_write_f32(f->c, path, 2, (const int64_t[]){WALK_FRAMES, 322}, row[0]));
    assert_walk(f, path, NULL, 30, "Motion-X", "y up");
    path = test_path("mdm.npz");
    npz_member mdm[] = {{"thetas", 3, {24, 6, WALK_FRAMES}, six[0][0]},
                        {"root_translation", 2, {3, WALK_FRAMES}, place[0]}};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(mdm), mdm));
    assert_walk(f, path, NULL, 20, "MDM", "y up");
    memset(six, 0, sizeof six);
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(mdm), mdm));
    refused(f, path, NULL, SHERF_BAD_FILE, "not a rotation");
}

static void joints_alone(void **state) {
    const walk_fixture *f = *state;
    static double at[WALK_FRAMES][22][3];
    static float rows[WALK_FRAMES][22][3], samples[2][22][3][WALK_FRAMES + 3], features[WALK_FRAMES][263];
    double facing[WALK_FRAMES];
    for (int i = 0; i < WALK_FRAMES; i++) {
        float turn[BODY_JOINTS][4], pelvis[3];
        double all[BODY_JOINTS][3];
        pose_to_turns(&f->walk.pose[i], &f->walk.skeleton, turn, pelvis);
        skeleton_joints(&f->walk.skeleton, (const float(*)[4])turn, pelvis, all);
        facing[i] = 0.3 * i;
        for (int j = 0; j < 22; j++)
            for (int k = 0; k < 3; k++) {
                at[i][j][k] = all[j][k];
                rows[i][j][k] = (float)all[j][k];
                samples[1][j][k][i] = (float)all[j][k];
            }
    }
    /* HumanML3D's: each frame in axes of its own (turned by `facing` about y), from which the first ones
     * follow */
    for (int i = 0; i < WALK_FRAMES; i++) {
        const double c = cos(facing[i]), s = sin(facing[i]);
        float *p = features[i];
        p[3] = (float)at[i][0][1];
        for (int j = 1; j < 22; j++) {
            const double x = at[i][j][0] - at[i][0][0], z = at[i][j][2] - at[i][0][2];
            p[4 + 3 * (j - 1)] = (float)(c * x + s * z);
            p[5 + 3 * (j - 1)] = (float)at[i][j][1];
            p[6 + 3 * (j - 1)] = (float)(-s * x + c * z);
        }
        if (i + 1 == WALK_FRAMES) break;
        const double dx = at[i + 1][0][0] - at[i][0][0], dz = at[i + 1][0][2] - at[i][0][2];
        const double cn = cos(facing[i + 1]), sn = sin(facing[i + 1]);
        p[0] = (float)((facing[i + 1] - facing[i]) / 2);
        p[1] = (float)(cn * dx + sn * dz);
        p[2] = (float)(-sn * dx + cn * dz);
    }
    const char *path = test_path("joints.npy");
    assert_ok(f->c, npy_write_f32(f->c, path, 3, (const int64_t[]){WALK_FRAMES, 22, 3}, rows[0][0]));
    assert_joints(f, path, (const double(*)[22][3])at, "HumanML3D", "20 a second");
    const float lengths[2] = {2, WALK_FRAMES};
    path = test_path("results.npz");
    npz_member results[] = {{"motion", 4, {2, 22, 3, WALK_FRAMES + 3}, samples[0][0][0]},
                            {"lengths", 1, {2}, lengths}};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(results), results));
    sherf_motion *motion;
    assert_int_equal(sherf_motion_load(f->c, path, NULL, &motion), SHERF_BAD_FILE); /* zeros are not a body */
    assert_ok(f->c, sherf_motion_load(f->c, path, &(sherf_motion_options){.track = "1"}, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), WALK_FRAMES);
    sherf_motion_free(motion);
    path = test_path("features.npy");
    assert_ok(f->c, npy_write_f32(f->c, path, 2, (const int64_t[]){WALK_FRAMES, 263}, features[0]));
    const double begin[3] = {at[0][0][0], 0, at[0][0][2]};
    for (int i = 0; i < WALK_FRAMES; i++) /* they begin at the origin */
        for (int j = 0; j < 22; j++)
            for (int k = 0; k < 3; k += 2) at[i][j][k] -= begin[k];
    assert_joints(f, path, (const double(*)[22][3])at, "HumanML3D", "from joints");
}

/* One file per frame that is not JSON: SMPLify-X's folders that contain 000.pkl, and FRAME_PERSON.npz. */
static void folders_of_arrays(void **state) {
    const walk_fixture *f = *state;
    char folder[4096], path[4200];
    arrays down;
    arrays_of(&f->walk, walk_y_down, &down);
    snprintf(folder, sizeof folder, "%s", test_path("people_npz"));
    assert_ok(f->c, folder_make(f->c, folder));
    for (int i = 0; i < WALK_FRAMES; i++)
        for (int person = 0; person < (i < 3 ? 2 : 1); person++) {
            const int from = person ? 0 : i;
            snprintf(path, sizeof path, "%s/%05d_%d.npz", folder, i, person);
            npz_member one[] = {{"global_orient", 2, {1, 3}, down.root[from]},
                                {"body_pose", 3, {1, 23, 3}, down.body[from]},
                                {"transl", 2, {1, 3}, down.trans[from]}};
            assert_ok(f->c, npz_write(f->c, path, COUNT_OF(one), one));
        }
    assert_walk(f, folder, NULL, 30, "SMPL poses", "track 0 of 2");
    sherf_motion *motion;
    assert_ok(f->c, sherf_motion_load(f->c, folder, &(sherf_motion_options){.track = "1"}, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), 3);
    sherf_motion_free(motion);
    snprintf(folder, sizeof folder, "%s", test_path("smplifyx"));
    for (int i = 0; i < WALK_FRAMES; i++) {
        static const float unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
        pickle_writer w;
        snprintf(path, sizeof path, "%s/img_%04d", folder, i);
        assert_ok(f->c, folder_make(f->c, path));
        strcat(path, "/000.pkl");
        pickle_begin(&w, f->c);
        pickle_dict_open(&w);
        pickle_string(&w, "global_orient");
        pickle_floats(&w, 2, (const int[]){1, 3}, down.root[i]);
        pickle_string(&w, "body_pose");
        pickle_floats(&w, 2, (const int[]){1, 69}, down.body[i]);
        pickle_string(&w, "camera_rotation");
        pickle_floats(&w, 3, (const int[]){1, 3, 3}, unit);
        pickle_string(&w, "camera_translation");
        pickle_floats(&w, 2, (const int[]){1, 3}, down.trans[i]);
        pickle_dict_close(&w);
        assert_ok(f->c, pickle_finish_file(&w, path));
    }
    assert_walk(f, folder, NULL, 30, "SMPLify-X", "y down");
}

/* Writes one frame of PHALP: the matrices of every person. */
static void phalp_frame(pickle_writer *w, const walk *k, int frame, int others_before) {
    char name[32];
    snprintf(name, sizeof name, "video/%06d.jpg", frame);
    pickle_string(w, name);
    pickle_dict_open(w);
    pickle_string(w, "tid");
    pickle_list_open(w);
    for (int i = 0; i <= others_before; i++) pickle_int(w, i == others_before ? 12 : i);
    pickle_list_close(w);
    float root[3], trans[3], R[9], all[23][9];
    walk_in(k, frame, walk_y_down, root, trans);
    rodrigues(root, R);
    for (int j = 1; j < 24; j++) rodrigues(k->pose[frame].poses_rad + 3 * j, all[j - 1]);
    pickle_string(w, "smpl");
    pickle_list_open(w);
    for (int i = 0; i <= others_before; i++) {
        pickle_dict_open(w);
        pickle_string(w, "global_orient");
        pickle_floats(w, 3, (const int[]){1, 3, 3}, R);
        pickle_string(w, "body_pose");
        pickle_floats(w, 3, (const int[]){23, 3, 3}, all[0]);
        pickle_string(w, "betas");
        pickle_floats(w, 1, (const int[]){10}, betas);
        pickle_dict_close(w);
    }
    pickle_list_close(w);
    pickle_string(w, "camera");
    pickle_list_open(w);
    for (int i = 0; i <= others_before; i++) pickle_floats(w, 1, (const int[]){3}, trans);
    pickle_list_close(w);
    pickle_dict_close(w);
}

static void phalp(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("phalp.pkl");
    pickle_writer w;
    pickle_begin(&w, f->c);
    pickle_dict_open(&w);
    for (int i = 0; i < WALK_FRAMES; i++) phalp_frame(&w, &f->walk, i, i % 3);
    pickle_dict_close(&w);
    assert_ok(f->c, pickle_finish_file(&w, path));
    assert_walk(f, path, NULL, 30, "PHALP", "track 12 of 3");
    sherf_motion *motion; /* person 1 is in every third frame, from 2 to 11: gaps are filled */
    assert_ok(f->c,
              sherf_motion_load(f->c, path, &(sherf_motion_options){.track = "1", .body = f->body}, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), 10);
    sherf_pose p;
    sherf_motion_pose(motion, 3, &p);
    assert_true(walk_distance(f->c, f->body, &p, &f->walk.pose[5]) < 1e-3);
    sherf_motion_free(motion);
}

/* Files written by the rules of joblib 1.x, packed or not: the bytes of arrays are in the stream, after
 * wrappers. */
static void joblib(void **state) {
    const walk_fixture *f = *state;
    static const char *const path[] = {"data/io/joblib.pkl", "data/io/joblib_zlib.pkl"};
    for (size_t n = 0; n < COUNT_OF(path); n++) {
        sherf_motion *motion;
        sherf_pose p;
        assert_ok(f->c, sherf_motion_load(f->c, path[n], NULL, &motion));
        assert_non_null(strstr(sherf_motion_description(motion), "WHAM"));
        assert_int_equal(sherf_motion_frame_count(motion), 5);
        for (int i = 0; i < 5;
             i++) { /* pose_world[i, k] = (i + k / 100) / 10; trans_world is in Fortran order */
            sherf_motion_pose(motion, i, &p);
            assert_float_equal(p.poses_rad[10], (i + 0.1) / 10, 1e-5);
            for (int a = 0; a < 3; a++) assert_float_equal(p.Th_m[a], i + 0.25 * a, 1e-5);
        }
        sherf_motion_free(motion);
    }
}

/* ---- JSON ---- */

static void numbers(FILE *out, const char *key, int count, const float *data, const char *open,
                    const char *close) {
    fprintf(out, "\"%s\": %s", key, open);
    for (int i = 0; i < count; i++) fprintf(out, "%s%.9g", i ? ", " : "", data[i]);
    fprintf(out, "%s", close);
}

/* x = R(Rh) x_smpl + Th, poses without the root, z up. */
static void easymocap_person(FILE *out, const walk *w, int frame, int id) {
    float root[3], trans[3], R[9], Th[3], poses[72], shapes[10] = {0};
    walk_in(w, frame, walk_z_up, root, trans);
    rodrigues(root, R);
    for (int k = 0; k < 3; k++) { /* J0 + trans = R J0 + Th */
        const double *J0 = w->skeleton.rest_m[0];
        Th[k] = (float)(J0[k] + trans[k] - R[3 * k] * J0[0] - R[3 * k + 1] * J0[1] - R[3 * k + 2] * J0[2]);
    }
    memcpy(poses, w->pose[frame].poses_rad, sizeof poses);
    memset(poses, 0, 3 * sizeof *poses);
    fprintf(out, "{\"id\": %d, ", id);
    numbers(out, "Rh", 3, root, "[[", "]], ");
    numbers(out, "Th", 3, Th, "[[", "]], ");
    numbers(out, "poses", 72, poses, "[[", "]], ");
    numbers(out, "shapes", 10, shapes, "[[", "]]}");
}

static void easymocap(void **state) {
    const walk_fixture *f = *state;
    char folder[512], path[600];
    snprintf(folder, sizeof folder, "%s", test_path("easymocap"));
    assert_ok(f->c, folder_make(f->c, folder));
    snprintf(path, sizeof path, "%s/readme.txt", folder);
    fclose(fopen(path, "wb"));
    for (int i = 0; i < WALK_FRAMES; i++) {
        snprintf(path, sizeof path, "%s/%06d.json", folder, i + 8);
        FILE *out = fopen(path, "wb");
        fprintf(out, "[");
        if (i > 3)
            easymocap_person(out, &f->walk, 0, 5), fprintf(out, ", "); /* another person at the same time */
        easymocap_person(out, &f->walk, i, 2);
        fprintf(out, "]");
        fclose(out);
    }
    assert_walk(f, folder, NULL, 30, "EasyMocap", "person 2");
    sherf_motion *motion;
    assert_ok(f->c, sherf_motion_load(f->c, folder, &(sherf_motion_options){.track = "5"}, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), 8);
    sherf_motion_free(motion);
    refused(f, folder, &(sherf_motion_options){.track = "6"}, SHERF_BAD_ARGUMENT, "'6'");
    const char *list = test_path("easymocap.json");
    for (int nested = 0; nested < 2; nested++) { /* a list of people per frame, or of one person */
        FILE *out = fopen(list, "wb");
        fprintf(out, "[");
        for (int i = 0; i < WALK_FRAMES; i++) {
            fprintf(out, nested ? "%s[" : "%s", i ? ", " : "");
            easymocap_person(out, &f->walk, i, 0);
            if (nested) fprintf(out, "]");
        }
        fprintf(out, "]");
        fclose(out);
        assert_walk(f, list, NULL, 30, "EasyMocap", "z up");
    }
}

/* The input of `sherf render --poses`: a list of poses under "frames". */
static void poses_in_frames(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("frames.json");
    FILE *out = fopen(path, "wb");
    fprintf(out, "{\"frames\": [");
    for (int i = 0; i < WALK_FRAMES; i++) {
        fprintf(out, "%s{", i ? ", " : "");
        numbers(out, "poses", 72, f->walk.pose[i].poses_rad, "[", "], ");
        numbers(out, "Th", 3, f->walk.pose[i].Th_m, "[", "]}");
    }
    fprintf(out, "]}");
    fclose(out);
    assert_walk(f, path, NULL, 30, "SMPL poses", "y up");
}

static void lhm(void **state) {
    const walk_fixture *f = *state;
    char folder[512], path[600];
    snprintf(folder, sizeof folder, "%s", test_path("smplx_params"));
    assert_ok(f->c, folder_make(f->c, folder));
    for (int i = 0; i < WALK_FRAMES; i++) {
        float root[3], trans[3];
        static const float focal[2] = {1500, 1500};
        walk_in(&f->walk, i, walk_y_down, root, trans);
        snprintf(path, sizeof path, "%s/%05d.json", folder, i + 1);
        FILE *out = fopen(path, "wb");
        fprintf(out, "{");
        numbers(out, "betas", 10, betas, "[", "], ");
        numbers(out, "root_pose", 3, root, "[", "], ");
        fprintf(out, "\"body_pose\": [");
        for (int j = 1; j < 22; j++)
            fprintf(out, "%s[%.9g, %.9g, %.9g]", j > 1 ? ", " : "", f->walk.pose[i].poses_rad[3 * j],
                    f->walk.pose[i].poses_rad[3 * j + 1], f->walk.pose[i].poses_rad[3 * j + 2]);
        fprintf(out, "], ");
        numbers(out, "trans", 3, trans, "[", "], ");
        numbers(out, "focal", 2, focal, "[", "]}");
        fclose(out);
    }
    assert_walk(f, folder, NULL, 30, "LHM", "y down");
}

/* ---- BVH ---- */

static void bvh_files(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("walk.bvh");
    walk_write_bvh(&f->walk, path, &(bvh_style){walk_smpl_names, 24, 0.01});
    assert_walk(f, path, NULL, 20, "names of SMPL", "y up");
    walk_write_bvh(&f->walk, path, &(bvh_style){walk_mixamo_names, 22, 0.01});
    assert_walk(f, path, NULL, 20, "names of Mixamo", "a unit is 0.01 m");
    /* a rest pose with the arms 50 degrees down, in inches */
    walk_write_bvh(&f->walk, path, &(bvh_style){walk_mixamo_names, 22, 0.0254, 50 * M_PI / 180});
    assert_walk(f, path, NULL, 20, "names of Mixamo", "a unit is 0.0254 m");
    assert_walk(f, path, &(sherf_motion_options){.scale = 0.0254}, 20, "BVH", "y up");
    /* a rest pose with z up, or one that faces the other way */
    static const double about_y[9] = {-1, 0, 0, 0, 1, 0, 0, 0, -1};
    walk_write_bvh(&f->walk, path, &(bvh_style){walk_mixamo_names, 22, 0.01, 0.5, walk_z_up});
    assert_walk(f, path, NULL, 20, "names of Mixamo", "y up");
    walk_write_bvh(&f->walk, path, &(bvh_style){walk_mixamo_names, 22, 0.01, 0, about_y});
    assert_walk(f, path, NULL, 20, "names of Mixamo", "y up");
    static const double between[9] = {0.70710678118,  0, 0.70710678118, 0, 1, 0,
                                      -0.70710678118, 0, 0.70710678118};
    walk_write_bvh(&f->walk, path, &(bvh_style){walk_mixamo_names, 22, 0.01, 0.3, between});
    assert_walk(f, path, NULL, 20, "names of Mixamo", "y up");
    walk_write_bvh(&f->walk, path, &(bvh_style){walk_mixamo_names, 22, 0.01, 0.3, .placed = true});
    assert_walk(f, path, NULL, 20, "names of Mixamo", "a unit is 0.01 m");
}

static void bvh_rigs(void **state) {
    static const struct {
        const char *const *names, *whose;
    } rigs[] = {
        {walk_unreal_names, "names of Unreal"},
        {walk_vrm_names, "names of Unity or VRM"},
        {walk_unity_names, "names of Unity or VRM"},
        {walk_biped_names, "names of Biped"},
        {walk_rigify_names, "names of Rigify"},
        {walk_optitrack_names, "names of OptiTrack"},
        {walk_mhr_names, "names of MHR"},
        {walk_soma_names, "names of SOMA"},
        {walk_arkit_names, "names of Mixamo"},
        {walk_ipi_names, "names of iPi"},
        {walk_asf_names, "names of ASF"},
    };
    const walk_fixture *f = *state;
    const char *path = test_path("rig.bvh");
    for (size_t i = 0; i < COUNT_OF(rigs); i++) {
        walk_write_bvh(&f->walk, path, &(bvh_style){rigs[i].names, 22, 0.01});
        assert_walk(f, path, NULL, 20, rigs[i].whose, "y up");
    }
    const char *no_colon[22]; /* mixamorigHips */
    char text[22][64];
    for (int j = 0; j < 22; j++)
        no_colon[j] = text[j], snprintf(text[j], 64, "mixamorig%s", strchr(walk_mixamo_names[j], ':') + 1);
    walk_write_bvh(&f->walk, path, &(bvh_style){no_colon, 22, 0.01});
    assert_walk(f, path, NULL, 20, "names of Mixamo", "y up");
}

/* Names of no known rig, with a map of all of them, and of some. */
static void bvh_joints_by_map(void **state) {
    const walk_fixture *f = *state;
    char path[4096], map[4096];
    snprintf(path, sizeof path, "%s", test_path("other.bvh"));
    snprintf(map, sizeof map, "%s", test_path("map.json"));
    const sherf_motion_options o = {.joints = map};
    walk_write_bvh(&f->walk, path, &(bvh_style){walk_other_names, 22, 0.01});
    refused(f, path, NULL, SHERF_UNSUPPORTED, "no left_hip");
    FILE *out = fopen(map, "wb");
    for (int j = 0; j < 22; j++) fprintf(out, "%s\"%s\": \"a%d\"", j ? ", " : "{", joint_name(j), j);
    fprintf(out, "}");
    fclose(out);
    assert_walk(f, path, &o, 20, "names of the map", "y up");
    out = fopen(map, "wb"); /* the trunk is found from the hierarchy, except the head */
    for (int j = 1; j < 22; j++)
        if (j != 3 && j != 6 && j != 9 && j != 12)
            fprintf(out, "%s\"%s\": \"a%d\"", j > 1 ? ", " : "{", joint_name(j), j);
    fprintf(out, ", \"neck\": \"a12\"}");
    fclose(out);
    assert_walk(f, path, &o, 20, "names of the map", "y up");
    out = fopen(map, "wb"); /* from the file's names to SMPL's */
    for (int j = 0; j < 22; j++) fprintf(out, "%s\"a%d\": \"%s\"", j ? ", " : "{", j, joint_name(j));
    fprintf(out, "}");
    fclose(out);
    assert_walk(f, path, &o, 20, "names of the map", "y up");
    static const char *const wrong[][2] = {{"{\"left_hip\": \"zz\"}", "no joint 'zz'"},
                                           {"{\"leg\": \"a1\"}", "'leg' is no joint of SMPL"},
                                           {"[1]", "a dict of SMPL's names"},
                                           {"{\"left_hip\": \"a1\"}", "no right_hip"}};
    for (size_t i = 0; i < COUNT_OF(wrong); i++) {
        out = fopen(map, "wb");
        fputs(wrong[i][0], out);
        fclose(out);
        refused(f, path, &o, i == 3 ? SHERF_UNSUPPORTED : SHERF_BAD_FILE, wrong[i][1]);
    }
}

/* Axes whose x points from `from` to `to`, with `turn` about it: the convention of LAFAN1, MotionBuilder and
 * many others. */
static void along_bone(const double from[3], const double to[3], double turn, double out[9]) {
    double x[3], y[3], length = 0;
    float axis_angle[3], R[9];
    for (int k = 0; k < 3; k++) x[k] = to[k] - from[k], length += x[k] * x[k];
    for (int k = 0; k < 3; k++) x[k] /= sqrt(length);
    y[0] = -x[1], y[1] = x[0], y[2] = 0;
    length = sqrt(y[0] * y[0] + y[1] * y[1]);
    for (int k = 0; k < 3; k++)
        y[k] = length > 1e-6 ? y[k] / length : k == 1, axis_angle[k] = (float)(x[k] * turn);
    rodrigues(axis_angle, R);
    for (int k = 0; k < 3; k++) {
        const double z = x[(k + 1) % 3] * y[(k + 2) % 3] - x[(k + 2) % 3] * y[(k + 1) % 3];
        out[3 * k] = x[k], out[3 * k + 1] = y[k], out[3 * k + 2] = z;
    }
    double first[9], wide[9];
    memcpy(first, out, sizeof first);
    for (int k = 0; k < 9; k++) wide[k] = R[k];
    walk_multiply(wide, first, out);
}

/* Checks the largest vertex error of a calibrated motion. */
static void assert_calibrated(const walk_fixture *f, const char *path, double most_m) {
    sherf_motion *motion;
    assert_ok(f->c, sherf_motion_load(f->c, path, &(sherf_motion_options){.body = f->body}, &motion));
    assert_non_null(strstr(sherf_motion_description(motion), "calibrated"));
    double worst = 0;
    for (int i = 0; i < WALK_FRAMES; i++) {
        sherf_pose p;
        sherf_motion_pose(motion, i, &p);
        worst = fmax(worst, walk_distance(f->c, f->body, &p, &f->walk.pose[i]));
    }
    sherf_motion_free(motion);
    if (!(worst < most_m)) fail_msg("a vertex is %g m off", worst);
}

/* Each joint has its own axes, with any turn about the bone, so the rest pose is a tangle. The frames
 * determine the axes. */
static void bvh_tangled_rest(void **state) {
    static const int8_t end[BODY_JOINTS] = {3,  4,  5,  6,  7,  8,  9,  10, 11, 12,
                                            10, 11, 15, 16, 17, 15, 18, 19, 20, 21};
    const walk_fixture *f = *state;
    const char *path = test_path("tangle.bvh");
    double own[BODY_JOINTS][9] = {{0, 0, 1, 1, 0, 0, 0, 1, 0}}; /* of the pelvis: x up, y to the front */
    for (int j = 1; j < 22; j++) {
        const int from = j == 10 || j == 11 || j == 15 || j > 19 ? skeleton_parent[j] : j,
                  to = from == j ? end[j] : j;
        along_bone(f->walk.skeleton.rest_m[from], f->walk.skeleton.rest_m[to], 0.7 * j, own[j]);
    }
    walk_write_bvh(&f->walk, path, &(bvh_style){walk_mixamo_names, 22, 0.01, .own = (const double(*)[9])own});
    assert_calibrated(f, path, 0.03);
}

/* One joint of the trunk has its own axes, turned about up or left, while the limbs hang like a person's. */
static void bvh_turned_trunk(void **state) {
    static const double turns[][9] = {
        {0, 0, 1, 0, 1, 0, -1, 0, 0}, /* by 90 degrees about up, and by 100 about left */
        {1, 0, 0, 0, -0.17364817767, -0.98480775301, 0, 0.98480775301, -0.17364817767}};
    static const int8_t joints[] = {0, 9};
    const walk_fixture *f = *state;
    const char *path = test_path("trunk.bvh");
    for (int i = 0; i < 4; i++) {
        double own[BODY_JOINTS][9];
        for (int j = 0; j < BODY_JOINTS; j++) memcpy(own[j], walk_y_up, sizeof own[j]);
        memcpy(own[joints[i / 2]], turns[i % 2], sizeof own[0]);
        walk_write_bvh(&f->walk, path,
                       &(bvh_style){walk_mixamo_names, 22, 0.01, .own = (const double(*)[9])own});
        assert_calibrated(f, path, 0.05);
    }
}

/* Files that begin like a scene but are not one, or that have no animation. */
static void broken_scenes(void **state) {
    const walk_fixture *f = *state;
    static const char *const begins[] = {"glTF\2\0\0\0\xff\xff\xff\xff", "Kaydara FBX Binary  ",
                                         "; FBX 7.3.0 project file\n{"};
    for (size_t i = 0; i < COUNT_OF(begins); i++) {
        const char *path = test_path("broken.fbx");
        FILE *out = fopen(path, "wb");
        fwrite(begins[i], 1, i ? strlen(begins[i]) : 12, out);
        fclose(out);
        sherf_motion *motion;
        const sherf_status status = sherf_motion_load(f->c, path, NULL, &motion);
        assert_null(motion);
        assert_true(status == SHERF_BAD_FILE ||
                    (status == SHERF_UNSUPPORTED && strstr(f->c->message, "libassimp")));
        assert_non_null(strstr(f->c->message, "broken.fbx: "));
        assert_null(strchr(f->c->message, '\n'));
    }
}

/* CMU's own clips from Debian's assimp-testmodels: people stand upright on the ground. */
static void captured_clips(void **state) {
    const walk_fixture *f = *state;
    static const char *const clip_of[] = {"/usr/share/assimp/models/BVH/01_01.bvh",
                                          "/usr/share/assimp/models/BVH/01_03.bvh"};
    static const double y[3] = {0, 1, 0};
    for (size_t n = 0; n < COUNT_OF(clip_of); n++) {
        sherf_motion *motion;
        if (!path_is_file(clip_of[n])) skip();
        assert_ok(f->c, sherf_motion_load(f->c, clip_of[n],
                                          &(sherf_motion_options){.body = f->body, .fps_max = 30}, &motion));
        assert_non_null(strstr(sherf_motion_description(motion), "names of CMU"));
        assert_float_equal(sherf_motion_fps(motion), 30, 1e-9);
        double lowest = INFINITY;
        for (int i = 1; i < motion->clip.frames; i++)
            lowest = fmin(lowest, skeleton_lowest(&motion->skeleton, (const float(*)[4])motion->clip.turn[i],
                                                  motion->clip.pelvis_m[i], y));
        assert_float_equal(lowest, 0, 0.08);
        sherf_motion_free(motion);
    }
}

/* The file's animation, read like any other motion, equals m. */
static void assert_glb_is(const walk_fixture *f, const char *path, const sherf_motion *motion) {
    sherf_motion *got = NULL;
    sherf_pose now, then;
    sherf_status status = sherf_motion_load(f->c, path, &(sherf_motion_options){.body = f->body}, &got);
    if (status == SHERF_UNSUPPORTED && strstr(f->c->message, "libassimp"))
        return; /* a build without assimp */
    assert_ok(f->c, status);
    assert_int_equal(got->clip.frames, motion->clip.frames);
    assert_float_equal(got->clip.fps, motion->clip.fps, 1e-3);
    for (int i = 0; i < motion->clip.frames; i++) {
        sherf_motion_pose(got, i, &now);
        sherf_motion_pose(motion, i, &then);
        for (int k = 0; k < 72; k++) assert_float_equal(now.poses_rad[k], then.poses_rad[k], 1e-3);
        for (int k = 0; k < 3; k++) assert_float_equal(now.Th_m[k], then.Th_m[k], 1e-3);
    }
    sherf_motion_free(got);
}

/* A motion written in AMASS's form and read again. */
static void saved(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("walk2.bvh"), *npz = test_path("saved.npz");
    walk_write_bvh(&f->walk, path, &(bvh_style){walk_smpl_names, 24, 0.01});
    sherf_motion *motion;
    assert_ok(f->c, sherf_motion_load(f->c, path, &(sherf_motion_options){.body = f->body}, &motion));
    assert_ok(f->c, sherf_motion_save(f->c, motion, npz));
    const char *text = test_path("saved.bvh");
    assert_ok(f->c, sherf_motion_save(f->c, motion, text));
    assert_walk(f, text, NULL, 20, "names of SMPL", "a unit is 0.01 m");
    assert_int_equal(sherf_motion_save(f->c, motion, test_path("saved.fbx")), SHERF_BAD_ARGUMENT);
    const char *scene = test_path("saved.glb");
    assert_ok(f->c, sherf_motion_save(f->c, motion, scene));
    assert_glb_is(f, scene, motion);
    sherf_motion_free(motion);
    assert_walk(f, npz, NULL, 20, "AMASS, SMPL", "z up");
    document *d;
    assert_ok(f->c, npz_read(f->c, npz, &d));
    assert_true(value_is_string(value_get(d->root, "gender"), "neutral"));
    double rate;
    assert_ok(f->c, value_doubles(f->c, value_get(d->root, "mocap_frame_rate"), "rate", 1, &rate));
    assert_float_equal(rate, 20, 1e-4);
    document_free(d);
}

/* ---- the options together ---- */

static void options_together(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("options.bvh");
    walk_write_bvh(&f->walk, path, &(bvh_style){walk_smpl_names, 24, 0.01});
    sherf_motion *motion;
    sherf_pose p, start = f->walk.pose[2];
    start.Th_m[2] = 7;
    sherf_motion_options o = {.body = f->body, .first = 2, .last = 9, .start = &start, .blend_s = 0.5};
    assert_ok(f->c, sherf_motion_load(f->c, path, &o, &motion));
    assert_int_equal(sherf_motion_blend_frames(motion), 10);
    assert_int_equal(sherf_motion_frame_count(motion), 18);
    sherf_motion_pose(motion, 0, &p);
    assert_true(walk_distance(f->c, f->body, &p, &start) < 1e-3);
    sherf_motion_pose(motion, 10, &p); /* the pose is the walk's frame 2, so nothing moves until then */
    assert_true(walk_distance(f->c, f->body, &p, &start) < 1e-3);
    sherf_motion_pose_at(motion, 10.5 / walk_fps, &p);
    assert_true(walk_distance(f->c, f->body, &p, &start) > 5e-3);
    sherf_motion_free(motion);
    o.loop = 1;
    assert_ok(f->c, sherf_motion_load(f->c, path, &o, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), 17);
    sherf_pose q;
    for (int i = 0; i < 30; i++) { /* 7 frames repeat after the blend of 10 */
        sherf_motion_pose_at(motion, (10 + i * 0.3) / walk_fps, &p);
        sherf_motion_pose_at(motion, (10 + i * 0.3 + 21) / walk_fps, &q);
        assert_true(walk_distance(f->c, f->body, &p, &q) < 1e-3);
    }
    sherf_motion_free(motion);
    refused(f, path, &(sherf_motion_options){.first = 12}, SHERF_BAD_ARGUMENT, "frame 12");
    refused(f, path, &(sherf_motion_options){.first = 10, .loop = 1}, SHERF_BAD_ARGUMENT, "loop");
    refused(f, path, &(sherf_motion_options){.smooth_s = NAN}, SHERF_BAD_ARGUMENT, "smooth");
    refused(f, path, &(sherf_motion_options){.fps = -1}, SHERF_BAD_ARGUMENT, "fps");
    start.R[0] = 3;
    refused(f, path, &(sherf_motion_options){.start = &start}, SHERF_BAD_ARGUMENT, "rotation");
}

/* ---- hostile ---- */

static void wrong_numbers(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("wrong.npz");
    const float rate = 20, none = 0;
    arrays a;
    arrays_of(&f->walk, walk_z_up, &a);
    npz_member member[] = {{"poses", 2, {WALK_FRAMES, 72}, a.smpl[0]},
                           {"trans", 2, {WALK_FRAMES, 3}, a.trans[0]},
                           {"mocap_frame_rate", 0, {0}, &rate}};
    const struct {
        int member, at;
        float value;
        const char *says;
    } broken[] = {{0, 100, NAN, "not finite"},
                  {0, 5, 900, "degrees"},
                  {1, 7, INFINITY, "not finite"},
                  {1, 7, 1e9f, "away"}};
    for (size_t i = 0; i < COUNT_OF(broken); i++) {
        float *at = (float *)(uintptr_t)member[broken[i].member].data + broken[i].at, was = *at;
        *at = broken[i].value;
        assert_ok(f->c, npz_write(f->c, path, COUNT_OF(member), member));
        refused(f, path, NULL, SHERF_BAD_FILE, broken[i].says);
        *at = was;
    }
    const struct {
        int member;
        int64_t rows, width;
        const char *says;
    } shaped[] = {
        {0, 12, 71, "71 numbers"}, {0, 0, 72, "no rows"}, {1, 11, 3, "33 numbers"}, {1, 18, 2, "not three"}};
    for (size_t i = 0; i < COUNT_OF(shaped); i++) {
        npz_member *entry = &member[shaped[i].member], was = *entry;
        entry->dim[0] = shaped[i].rows, entry->dim[1] = shaped[i].width;
        assert_ok(f->c, npz_write(f->c, path, COUNT_OF(member), member));
        refused(f, path, NULL, SHERF_BAD_FILE, shaped[i].says);
        *entry = was;
    }
    member[2].data = &none;
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(member), member));
    refused(f, path, NULL, SHERF_BAD_FILE, "frame rate");
    refused(f, "/no/such/motion", NULL, SHERF_NO_FILE, "/no/such/motion");
    refused(f, "../assets/body.safetensors", NULL, SHERF_BAD_FILE, "not a motion");
    refused(f, "/proc/self/fd", NULL, SHERF_BAD_FILE, "without numbered files");
    FILE *out = fopen(path, "wb");
    fwrite("\x78\x9c\x01\x02\x03\x04", 1, 6, out);
    fclose(out);
    refused(f, path, NULL, SHERF_BAD_FILE, "zlib");
}

/* Truncated files of all families and files with changed bytes give an error line or a motion, and nothing
 * leaks. */
static void damaged(void **state) {
    const walk_fixture *f = *state;
    static const char *const made[] = {"joblib",   "amass.npz", "aist.pkl", "gvhmr.pkl",
                                       "wham.pkl", "phalp.pkl", "walk.bvh", "easymocap.json"};
    size_t live = mem_live();
    for (size_t n = 0; n < COUNT_OF(made); n++) {
        unsigned char *data;
        size_t bytes;
        const char *path = n ? test_path(made[n]) : "data/io/joblib.pkl";
        assert_ok(f->c, file_read(f->c, path, 1 << 24, &data, &bytes));
        for (int round = 0; round < 120; round++) {
            uint64_t key = random_key(3, made[n], (uint64_t)round);
            size_t length = round < 60 ? (size_t)random_below(key, 0, (int64_t)bytes) : bytes;
            unsigned char *copy = malloc(length + 1);
            sherf_motion *motion;
            memcpy(copy, data, length);
            for (int k = 0; k < 4 && round >= 60; k++)
                copy[random_below(key, 2 * (uint64_t)k + 1, (int64_t)length)] =
                    (unsigned char)random_below(key, 2 * (uint64_t)k + 2, 256);
            f->c->message[0] = 0;
            sherf_status status = motion_parse(f->c, copy, length, &(sherf_motion_options){0}, &motion);
            if (status ? motion != NULL || !f->c->message[0] : !motion)
                fail_msg("%s, round %d", made[n], round);
            for (int i = 0; motion && i < sherf_motion_frame_count(motion); i++) {
                sherf_pose p;
                sherf_motion_pose(motion, i, &p);
                for (int k = 0; k < 72; k++) assert_true(isfinite(p.poses_rad[k]));
            }
            sherf_motion_free(motion);
            free(copy);
        }
        mem_free(data);
    }
    assert_int_equal(mem_live(), live);
}

/* A text file is called a text. A file that begins like a text pickle keeps the pickle's message. */
static void plain_texts(void **state) {
    const walk_fixture *f = *state;
    static const struct {
        const char *text, *says;
    } cases[] = {
        {"frame,hip_x,hip_y\n0,1,2\n",
         "a text that is neither JSON nor a pickle; it begins \"frame,hip_x,hip_y\""},
        {"\n  # caf\xc3\xa9\r\n0 1 2\n", "begins \"# caf??\""},
        {"count the frames\n", "begins \"count the frames\""},
        {"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"},
        {"cnumpy.core\nnothing", "pickle: "},
        {"(dp0\nS'poses'\n", "pickle: "},
    };
    for (size_t i = 0; i < COUNT_OF(cases); i++) {
        const char *path = test_path("plain.txt");
        FILE *file = fopen(path, "wb");
        assert_non_null(file);
        assert_true(fputs(cases[i].text, file) >= 0);
        assert_int_equal(fclose(file), 0);
        refused(f, path, NULL, SHERF_BAD_FILE, cases[i].says);
    }
}

/* Every allocation fails once: the status reports it, and nothing leaks. */
static void without_memory(void **state) {
    const walk_fixture *f = *state;
    static const char *const made[] = {"amass.npz", "wham.pkl", "phalp.pkl", "walk.bvh", "easymocap.json"};
    sherf_pose start = f->walk.pose[0];
    const sherf_motion_options o = {
        .fps = 15, .smooth_s = 0.1, .loop = 1, .start = &start, .blend_s = 0.2, .body = f->body, .first = 1};
    for (size_t n = 0; n < COUNT_OF(made); n++) {
        size_t live = mem_live();
        sherf_status status = SHERF_NO_MEMORY;
        for (long k = 0; status; k++) {
            sherf_motion *motion;
            mem_fail_after(k);
            status = sherf_motion_load(f->c, test_path(made[n]), &o, &motion);
            mem_fail_after(-1);
            if (status && status != SHERF_NO_MEMORY) fail_msg("%s: %s", made[n], f->c->message);
            assert_true(k < 5000);
            sherf_motion_free(motion);
            assert_int_equal(mem_live(), live);
        }
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(amass),
                                       cmocka_unit_test(found_by_content),
                                       cmocka_unit_test(aist),
                                       cmocka_unit_test(gvhmr),
                                       cmocka_unit_test(wham),
                                       cmocka_unit_test(wham_by_parts),
                                       cmocka_unit_test(phalp),
                                       cmocka_unit_test(joblib),
                                       cmocka_unit_test(easymocap),
                                       cmocka_unit_test(other_dicts),
                                       cmocka_unit_test(root_apart),
                                       cmocka_unit_test(other_pickles),
                                       cmocka_unit_test(dances),
                                       cmocka_unit_test(other_arrays),
                                       cmocka_unit_test(joints_alone),
                                       cmocka_unit_test(folders_of_arrays),
                                       cmocka_unit_test(poses_in_frames),
                                       cmocka_unit_test(lhm),
                                       cmocka_unit_test(bvh_files),
                                       cmocka_unit_test(bvh_rigs),
                                       cmocka_unit_test(broken_scenes),
                                       cmocka_unit_test(bvh_joints_by_map),
                                       cmocka_unit_test(bvh_tangled_rest),
                                       cmocka_unit_test(bvh_turned_trunk),
                                       cmocka_unit_test(captured_clips),
                                       cmocka_unit_test(saved),
                                       cmocka_unit_test(options_together),
                                       cmocka_unit_test(wrong_numbers),
                                       cmocka_unit_test(damaged),
                                       cmocka_unit_test(plain_texts),
                                       cmocka_unit_test(without_memory)};
    return cmocka_run_group_tests(tests, walk_setup, walk_teardown);
}
