/* Tests of the variants of motion formats that users make with tools: dicts of frames and of people, arrays
 * in arrays, degrees, quaternions separate from the root's, BVHs whose joint names are unknown. */
#include "formats.h"

#include "base/path.h"

static void rest_of(const arrays *a, int frame, pickle_writer *w, const char *trans) {
    pickle_string(w, "global_orient");
    pickle_floats(w, 2, (const int[]){1, 3}, a->root[frame]);
    pickle_string(w, "body_pose");
    pickle_floats(w, 2, (const int[]){1, 69}, a->body[frame]);
    pickle_string(w, trans);
    pickle_floats(w, 2, (const int[]){1, 3}, a->trans[frame]);
}

/* A nested dict under any key, as np.savez stores a dict. A frame rate inside it counts too. */
static void in_one_dict(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("one.npy");
    const float rate = 50;
    arrays z;
    pickle_writer w;
    arrays_of(&f->walk, walk_z_up, &z);
    pickle_begin(&w, f->c);
    pickle_dict_open(&w);
    pickle_string(&w, "arr_0");
    pickle_dict_open(&w);
    floats(&w, "poses", 72, z.smpl[0]);
    floats(&w, "trans", 3, z.trans[0]);
    pickle_string(&w, "mocap_framerate");
    pickle_floats(&w, 1, (const int[]){1}, &rate);
    pickle_dict_close(&w);
    pickle_dict_close(&w);
    assert_ok(f->c, pickle_finish_npy(&w, path));
    assert_walk(f, path, NULL, 50, "AMASS, SMPL", "z up");
}

/* ROMP's results of a video: one dict per picture, whose rows are the people in it. */
static void frames_by_picture(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("video_results.npy");
    arrays down;
    pickle_writer w;
    arrays_of(&f->walk, walk_y_down, &down);
    pickle_begin(&w, f->c);
    pickle_dict_open(&w);
    for (int i = 0; i < WALK_FRAMES; i++) {
        const int people = 1 + (i % 3 == 1);
        float pose[2][72], place[2][3] = {{0}}, sure[2][1] = {{1}, {1}};
        char name[32];
        memcpy(pose[0], down.smpl[i], sizeof pose[0]);
        memcpy(pose[1], down.smpl[0], sizeof pose[1]);
        memcpy(place[0], down.trans[i], sizeof place[0]);
        snprintf(name, sizeof name, "%08d.jpg", 7 + i);
        pickle_string(&w, name);
        pickle_dict_open(&w);
        pickle_string(&w, "smpl_thetas");
        pickle_floats(&w, 2, (const int[]){people, 72}, pose[0]);
        pickle_string(&w, "cam_trans");
        pickle_floats(&w, 2, (const int[]){people, 3}, place[0]);
        pickle_string(&w, "center_confs");
        pickle_floats(&w, 2, (const int[]){people, 1}, sure[0]);
        pickle_dict_close(&w);
    }
    pickle_dict_close(&w);
    assert_ok(f->c, pickle_finish_npy(&w, path));
    assert_walk(f, path, NULL, 30, "ROMP", "row 0 of each frame's up to 2 people");
    sherf_motion *motion; /* row 1 exists in frames 1, 4, 7 and 10: gaps are filled */
    assert_ok(f->c, sherf_motion_load(f->c, path, &(sherf_motion_options){.track = "1"}, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), 10);
    sherf_motion_free(motion);
    path = test_path("picture.npz"); /* in one picture: two people are not two frames */
    const float sure[2] = {1, 1};
    npz_member picture[] = {{"smpl_thetas", 2, {2, 72}, down.smpl[0]},
                            {"cam_trans", 2, {2, 3}, down.trans[0]},
                            {"center_confs", 2, {2, 1}, sure}};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(picture), picture));
    assert_ok(f->c, sherf_motion_load(f->c, path, NULL, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), 1);
    sherf_motion_free(motion);
}

/* {person: {body_pose (F, 69), ...}}: the person present longest, or one by name. {frame: {body_pose (1, 69),
 * ...}}. */
static void dicts_of_dicts(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("people.pkl");
    static const char *const name[] = {"person_1", "person_0"};
    arrays up;
    pickle_writer w;
    arrays_of(&f->walk, walk_y_up, &up);
    pickle_begin(&w, f->c);
    pickle_dict_open(&w);
    for (int k = 0; k < 2; k++) {
        const int frames = k ? WALK_FRAMES : 2;
        pickle_string(&w, name[k]);
        pickle_dict_open(&w);
        pickle_string(&w, "poses");
        pickle_floats(&w, 2, (const int[]){frames, 72}, up.smpl[0]);
        pickle_string(&w, "transl");
        pickle_floats(&w, 2, (const int[]){frames, 3}, up.trans[0]);
        pickle_dict_close(&w);
    }
    pickle_dict_close(&w);
    assert_ok(f->c, pickle_finish_file(&w, path));
    assert_walk(f, path, NULL, 30, "track person_0 of 2", "y up");
    sherf_motion *motion;
    assert_ok(f->c, sherf_motion_load(f->c, path, &(sherf_motion_options){.track = "person_1"}, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), 2);
    sherf_motion_free(motion);
    refused(f, path, &(sherf_motion_options){.track = "2"}, SHERF_BAD_ARGUMENT, "'2' among the 2");
    for (int people = 2; people; people--) { /* a list of people, also of a single one */
        pickle_begin(&w, f->c);
        pickle_list_open(&w);
        for (int k = 0; k < people; k++) {
            const int frames = k == people - 1 ? WALK_FRAMES : 2;
            pickle_dict_open(&w);
            pickle_string(&w, "poses");
            pickle_floats(&w, 2, (const int[]){frames, 72}, up.smpl[0]);
            pickle_string(&w, "transl");
            pickle_floats(&w, 2, (const int[]){frames, 3}, up.trans[0]);
            pickle_dict_close(&w);
        }
        pickle_list_close(&w);
        assert_ok(f->c, pickle_finish_file(&w, path));
        assert_walk(f, path, NULL, 30, people > 1 ? "track 1 of 2" : "SMPL poses", "y up");
    }
    pickle_begin(&w, f->c); /* frames, by number */
    pickle_dict_open(&w);
    for (int i = 0; i < WALK_FRAMES; i++) {
        pickle_int(&w, 3 + i);
        pickle_dict_open(&w);
        rest_of(&up, i, &w, "transl");
        pickle_dict_close(&w);
    }
    pickle_dict_close(&w);
    assert_ok(f->c, pickle_finish_file(&w, path));
    assert_walk(f, path, NULL, 30, "SMPL poses", "y up");
}

/* A root that is turned around has a small real part: the body shows where it is. */
static void quaternions_apart(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("quaternions.npz");
    static float body[WALK_FRAMES][23][4], root[WALK_FRAMES][4];
    arrays a;
    for (int last = 0; last < 2; last++) {
        arrays_of(&f->walk, walk_y_down, &a);
        for (int i = 0; i < WALK_FRAMES; i++)
            for (int j = 0; j < 24; j++) {
                const float *turn = a.smpl[i] + 3 * j;
                float q[4], *to = j ? body[i][j - 1] : root[i];
                quaternion_from_axis_angle((const double[3]){turn[0], turn[1], turn[2]}, q);
                for (int k = 0; k < 4; k++) to[last ? (k + 3) % 4 : k] = q[k];
            }
        assert_true(fabsf(root[0][last ? 3 : 0]) < 0.3f);
        npz_member member[] = {{"body_pose", 3, {WALK_FRAMES, 23, 4}, body[0][0]},
                               {"global_orient", 2, {WALK_FRAMES, 4}, root[0]},
                               {"transl", 2, {WALK_FRAMES, 3}, a.trans[0]}};
        assert_ok(f->c, npz_write(f->c, path, COUNT_OF(member), member));
        assert_walk(f, path, NULL, 30, "SMPL poses", "y down");
    }
}

/* Numbers that are not radians are refused; a motion without a translation is read with a remark. */
static void said_not_guessed(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("said.npz");
    arrays a;
    arrays_of(&f->walk, walk_y_up, &a);
    npz_member member[] = {{"poses", 2, {WALK_FRAMES, 72}, a.smpl[0]}};
    assert_ok(f->c, npz_write(f->c, path, 1, member));
    sherf_motion *motion;
    assert_ok(f->c, sherf_motion_load(f->c, path, NULL, &motion));
    if (!strstr(sherf_motion_description(motion), "no translation"))
        fail_msg("\"%s\"", sherf_motion_description(motion));
    sherf_motion_free(motion);
    for (int i = 0; i < WALK_FRAMES * 72; i++) a.smpl[i / 72][i % 72] *= (float)(180 / M_PI);
    assert_ok(f->c, npz_write(f->c, path, 1, member));
    refused(f, path, NULL, SHERF_BAD_FILE, "these are degrees");
    path = test_path("said.npy");
    assert_ok(f->c, npy_write_f32(f->c, path, 2, (const int64_t[]){WALK_FRAMES, 71}, a.smpl[0]));
    refused(f, path, NULL, SHERF_BAD_FILE, "an array of 12 x 71");
}

/* Transposed matrices, and angles with the wrong sign, bend the knees forwards. */
static void knees_that_bend_forwards(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("knees.npz");
    enum { FRAMES = 5 };
    static float turn[FRAMES][24][3][3];
    npz_member member[] = {{"poses", 4, {FRAMES, 24, 3, 3}, turn[0][0][0]}};
    for (int transposed = 0; transposed < 2; transposed++) {
        for (int i = 0; i < FRAMES * 24; i++) {
            const double angle = i % 24 == 4 || i % 24 == 5 ? 0.2 + 0.1 * (i / 24) : 0;
            float(*R)[3] = turn[i / 24][i % 24];
            memset(R, 0, sizeof turn[0][0]);
            R[0][0] = 1;
            R[1][1] = R[2][2] = (float)cos(angle);
            R[2 - transposed][1 + transposed] = (float)sin(angle);
            R[1 + transposed][2 - transposed] = -(float)sin(angle);
        }
        assert_ok(f->c, npz_write(f->c, path, 1, member));
        sherf_motion *motion;
        assert_ok(f->c, sherf_motion_load(f->c, path, NULL, &motion));
        assert_int_equal(strstr(sherf_motion_description(motion), "knees bend forwards") != NULL, transposed);
        sherf_motion_free(motion);
    }
}

/* Frames x people is not taken for people x frames. */
static void frames_before_people(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("axes.npz");
    static float frames_first[WALK_FRAMES][2][72], people_first[2][WALK_FRAMES][72];
    arrays a;
    arrays_of(&f->walk, walk_y_up, &a);
    for (int i = 0; i < WALK_FRAMES; i++)
        for (int person = 0; person < 2; person++) {
            memcpy(people_first[person][i], a.smpl[i], sizeof a.smpl[i]);
            for (int k = 3; k < 72; k++) people_first[person][i][k] += person ? 0.5f : 0;
            memcpy(frames_first[i][person], people_first[person][i], sizeof a.smpl[i]);
        }
    npz_member member[] = {{"poses", 3, {2, WALK_FRAMES, 72}, people_first[0][0]}};
    sherf_motion *motion;
    assert_ok(f->c, npz_write(f->c, path, 1, member));
    assert_ok(f->c, sherf_motion_load(f->c, path, NULL, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), WALK_FRAMES);
    sherf_motion_free(motion);
    member[0] = (npz_member){"poses", 3, {WALK_FRAMES, 2, 72}, frames_first[0][0]};
    assert_ok(f->c, npz_write(f->c, path, 1, member));
    refused(f, path, NULL, SHERF_BAD_FILE, "frames come first");
}

/* Files of other programs are named, with advice on what to do. */
static void other_programs(void **state) {
    const walk_fixture *f = *state;
    static const struct {
        size_t at;
        const char *begins, *says;
    } files[] = {
        {0, "\x89HDF\r\n\x1a\n", "an HDF5 file"},
        {0, "MATLAB 5.0 MAT-file", "a MATLAB file"},
        {0, "PAR1", "a Parquet table"},
        {0, "PXR-USDC", "a USD scene: export it as BVH, FBX or GLB"},
        {0, "BLENDER-v300", "a Blender file: export it"},
        {0, "Vocaloid Motion Data 0002", "MikuMikuDance"},
        {0, "\x02P", "a C3D of markers"},
        {0, "7z\xbc\xaf\x27\x1c", "a 7z archive"},
        {0, "Rar!\x1a\x07", "a RAR archive"},
        {257, "ustar", "a tar archive"},
    };
    const char *path = test_path("other.bin");
    for (size_t i = 0; i < COUNT_OF(files); i++) {
        unsigned char data[600] = {'a'};
        memcpy(data + files[i].at, files[i].begins, strlen(files[i].begins));
        FILE *out = fopen(path, "wb");
        assert_int_equal(fwrite(data, 1, sizeof data, out), sizeof data);
        fclose(out);
        refused(f, path, NULL, SHERF_BAD_FILE, files[i].says);
    }
    FILE *glb = fopen(path, "wb"); /* a motion, but nothing that the other verbs read */
    fputs("glTF\2", glb);
    fclose(glb);
    char *text;
    assert_int_equal(sherf_info(f->c, path, 0, &text), SHERF_BAD_FILE);
    assert_non_null(strstr(sherf_message(f->c), "a GLB, of which sherf animate reads the animation"));
}

/* In (F, 24, 3) the lengths of limbs distinguish positions from rotations. A leading axis of 1 is dropped. */
static void arrays_of_three(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("three.npy");
    static float places[WALK_FRAMES][24][3], few[WALK_FRAMES][22][3];
    static double at[WALK_FRAMES][22][3];
    arrays up;
    for (int i = 0; i < WALK_FRAMES; i++) {
        float turn[BODY_JOINTS][4], pelvis[3];
        double all[BODY_JOINTS][3];
        pose_to_turns(&f->walk.pose[i], &f->walk.skeleton, turn, pelvis);
        skeleton_joints(&f->walk.skeleton, (const float(*)[4])turn, pelvis, all);
        for (int j = 0; j < 24; j++)
            for (int k = 0; k < 3; k++) places[i][j][k] = (float)all[j][k];
        memcpy(few[i], places[i], sizeof few[i]);
        memcpy(at[i], all, sizeof at[i]);
    }
    assert_ok(f->c, npy_write_f32(f->c, path, 3, (const int64_t[]){WALK_FRAMES, 24, 3}, places[0][0]));
    assert_joints(f, path, (const double(*)[22][3])at, "HumanML3D", "from joints");
    assert_ok(f->c, npy_write_f32(f->c, path, 4, (const int64_t[]){1, WALK_FRAMES, 22, 3}, few[0][0]));
    assert_joints(f, path, (const double(*)[22][3])at, "HumanML3D", "from joints");
    arrays_of(&f->walk, walk_y_up, &up);
    assert_ok(f->c, npy_write_f32(f->c, path, 3, (const int64_t[]){WALK_FRAMES, 24, 3}, up.smpl[0]));
    sherf_motion *motion;
    assert_ok(f->c, sherf_motion_load(f->c, path, NULL, &motion));
    for (int i = 0; i < WALK_FRAMES; i++) {
        sherf_pose p;
        sherf_motion_pose(motion, i, &p);
        for (int k = 3; k < 72; k++) assert_float_equal(p.poses_rad[k], up.smpl[i][k], 1e-4);
    }
    sherf_motion_free(motion);
}

/* ---- BVH ---- */

/* Collars, toes and head are found from the hierarchy; the rigs' words for the middle are known. */
static void bvh_by_place(void **state) {
    static const struct {
        const char *name[6]; /* names of joints 10 to 15; NULL: as in the rig */
    } renamed[] = {
        {{"ball_01_l", "ball_01_r", "spine_04", "thorax_l", "thorax_r", "spine_05"}}, /* Rigify */
        {{NULL, NULL, "Neck_M", "Scapula_l", "Scapula_r", "Head_M"}},                 /* Advanced Skeleton */
    };
    const walk_fixture *f = *state;
    const char *path = test_path("place.bvh"), *names[BODY_JOINTS];
    for (size_t i = 0; i < COUNT_OF(renamed); i++) {
        memcpy(names, walk_unreal_names, sizeof names);
        for (int j = 0; j < 6; j++)
            if (renamed[i].name[j]) names[10 + j] = renamed[i].name[j];
        walk_write_bvh(&f->walk, path, &(bvh_style){names, 22, 0.01});
        assert_walk(f, path, NULL, 20, "names of Unreal", "y up");
    }
    walk_write_bvh(&f->walk, path, &(bvh_style){walk_unreal_names, 20, 0.01});
    sherf_motion *motion;
    assert_ok(f->c, sherf_motion_load(f->c, path, NULL, &motion));
    if (!strstr(sherf_motion_description(motion), ", without wrists"))
        fail_msg("%s", sherf_motion_description(motion));
    sherf_motion_free(motion);
}

static char *text_of(context *c, const char *path) {
    unsigned char *data;
    size_t bytes;
    assert_ok(c, file_read(c, path, 1 << 24, &data, &bytes));
    char *text = calloc(bytes + 1, 1);
    memcpy(text, data, bytes);
    mem_free(data);
    return text;
}

/* The file with `to` instead of `from`. */
static void changed(const char *path, const char *text, const char *from, const char *to) {
    const char *at = strstr(text, from);
    FILE *out = fopen(path, "wb");
    assert_non_null(at);
    fprintf(out, "%.*s%s%s", (int)(at - text), text, to, at + strlen(from));
    fclose(out);
}

static void bvh_texts(void **state) {
    const walk_fixture *f = *state;
    char path[4096];
    snprintf(path, sizeof path, "%s", test_path("texts.bvh"));
    walk_write_bvh(&f->walk, path, &(bvh_style){walk_unreal_names, 22, 0.01});
    char *text = text_of(f->c, path);
    changed(path, text, "Frames: ", "Frames:");
    assert_walk(f, path, NULL, 20, "BVH", "y up");
    changed(path, text, "MOTION\n", "ROOT other\n{\nOFFSET 0 0 0\n}\nMOTION\n");
    refused(f, path, NULL, SHERF_UNSUPPORTED, "a second ROOT");
    static const char *const times[] = {"Frame Time: 33.3\n", "Frame Time: 0.000000\n"};
    for (size_t i = 0; i < COUNT_OF(times); i++) {
        changed(path, text, "Frame Time: 0.05\n", times[i]);
        refused(f, path, NULL, SHERF_BAD_FILE, "--source-fps");
        assert_walk(f, path, &(sherf_motion_options){.source_fps = 20}, 20, "BVH", "y up");
    }
    for (int big = 0; big < 2; big++) { /* UTF-16 without a byte order mark */
        FILE *out = fopen(path, "wb");
        for (const char *p = text; *p; p++) fputc(big ? 0 : *p, out), fputc(big ? *p : 0, out);
        fclose(out);
        assert_walk(f, path, NULL, 20, "BVH", "y up");
    }
    free(text);
}

/* A frame rate under any usual name, beside the bodies or in a dict beside them. */
static void rates(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("rates.npz");
    static const char *const names[] = {"framerate", "mocap_fps", "frame_time"};
    arrays a;
    pickle_writer w;
    arrays_of(&f->walk, walk_y_up, &a);
    for (size_t i = 0; i < COUNT_OF(names); i++) {
        const float rate = i == 2 ? 0.02f : 50;
        npz_member member[] = {{"poses", 2, {WALK_FRAMES, 72}, a.smpl[0]},
                               {"trans", 2, {WALK_FRAMES, 3}, a.trans[0]},
                               {names[i], 0, {0}, &rate}};
        assert_ok(f->c, npz_write(f->c, path, 3, member));
        assert_walk(f, path, NULL, 50, "50 a second,", "y up");
        assert_walk(f, path, &(sherf_motion_options){.source_fps = 20}, 20, "20 a second,", "y up");
    }
    npz_member text[] = {{"poses", 2, {WALK_FRAMES, 72}, a.smpl[0]},
                         {"trans", 2, {WALK_FRAMES, 3}, a.trans[0]},
                         {.name = "fps", .text = "50"}};
    assert_ok(f->c, npz_write(f->c, path, 3, text));
    assert_walk(f, path, NULL, 50, "50 a second,", "y up");
    for (int inside = 0; inside < 2; inside++) { /* two people as in InterHuman; MoSh++ */
        pickle_begin(&w, f->c);
        pickle_dict_open(&w);
        pickle_string(&w, inside ? "details" : "mocap_framerate");
        if (inside) pickle_dict_open(&w), pickle_string(&w, "mocap_frame_rate");
        pickle_int(&w, 50);
        if (inside) pickle_dict_close(&w);
        for (int i = 0; i < 2; i++) {
            pickle_string(&w, i ? "person2" : "person1");
            pickle_dict_open(&w);
            floats(&w, "poses", 72, a.smpl[0]);
            floats(&w, "trans", 3, a.trans[0]);
            pickle_dict_close(&w);
        }
        pickle_dict_close(&w);
        assert_ok(f->c, pickle_finish_file(&w, path));
        assert_walk(f, path, NULL, 50, "track person1 of 2", "50 a second,");
    }
}

/* A list of frames beside other entries; rows of people in each frame; PromptHMR's people. */
static void packed_with_more(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("more.pkl");
    arrays a;
    pickle_writer w;
    arrays_of(&f->walk, walk_y_up, &a);
    for (int rows = 1; rows <= 2; rows++) {
        pickle_begin(&w, f->c);
        pickle_dict_open(&w);
        pickle_string(&w, "fps");
        pickle_int(&w, 50);
        pickle_string(&w, "frames");
        pickle_list_open(&w);
        for (int i = 0; i < WALK_FRAMES; i++) {
            float pose[2][72] = {{0}}, place[2][3] = {{0}};
            memcpy(pose[rows - 1], a.smpl[i], sizeof pose[0]);
            memcpy(place[rows - 1], a.trans[i], sizeof place[0]);
            pickle_dict_open(&w);
            pickle_string(&w, "poses");
            pickle_floats(&w, 2, (const int[]){rows, 72}, pose[0]);
            pickle_string(&w, "trans");
            pickle_floats(&w, 2, (const int[]){rows, 3}, place[0]);
            pickle_dict_close(&w);
        }
        pickle_list_close(&w);
        pickle_dict_close(&w);
        assert_ok(f->c, pickle_finish_file(&w, path));
        assert_walk(f, path, &(sherf_motion_options){.track = rows > 1 ? "1" : NULL}, 50, "50 a second,",
                    rows > 1 ? "row 1 of each frame's up to 2 people" : "SMPL poses");
    }
    pickle_begin(&w, f->c);
    pickle_dict_open(&w);
    pickle_string(&w, "camera");
    pickle_dict_open(&w);
    pickle_dict_close(&w);
    pickle_string(&w, "people");
    pickle_dict_open(&w);
    pickle_int(&w, 7);
    pickle_dict_open(&w);
    for (int world = 0; world < 2; world++) {
        pickle_string(&w, world ? "smplx_world" : "smplx_cam");
        pickle_dict_open(&w);
        pickle_string(&w, "pose");
        pickle_floats(&w, 2, (const int[]){WALK_FRAMES, 165},
                      world ? a.whole[0] : (const float[WALK_FRAMES * 165]){0});
        floats(&w, "trans", 3, a.transx[0]);
        pickle_dict_close(&w);
    }
    pickle_dict_close(&w);
    pickle_dict_close(&w);
    pickle_dict_close(&w);
    assert_ok(f->c, pickle_finish_file(&w, path));
    assert_walk(f, path, NULL, 30, "PromptHMR", "y up");
}

/* Axes of joints and numbers swapped; a root in degrees; a world with another up axis. */
static void exchanged(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("exchanged.npz");
    static float across[WALK_FRAMES][3][24];
    arrays a;
    arrays_of(&f->walk, walk_y_up, &a);
    for (int i = 0; i < WALK_FRAMES; i++)
        for (int j = 0; j < 72; j++) across[i][j % 3][j / 3] = a.smpl[i][j];
    npz_member member[] = {{"poses", 3, {WALK_FRAMES, 3, 24}, across[0][0]},
                           {"trans", 2, {WALK_FRAMES, 3}, a.trans[0]}};
    assert_ok(f->c, npz_write(f->c, path, 2, member));
    refused(f, path, NULL, SHERF_BAD_FILE, "must be last");
    for (int i = 0; i < WALK_FRAMES * 3; i++) a.root[i / 3][i % 3] = i % 3 == 1 ? 90 : 0;
    npz_member parts[] = {{"body_pose", 2, {WALK_FRAMES, 69}, a.body[0]},
                          {"global_orient", 2, {WALK_FRAMES, 3}, a.root[0]},
                          {"transl", 2, {WALK_FRAMES, 3}, a.trans[0]}};
    assert_ok(f->c, npz_write(f->c, path, 3, parts));
    refused(f, path, NULL, SHERF_BAD_FILE, "global_orient: 90 radians");
    for (int i = 0; i < WALK_FRAMES * 3; i++) a.root[i / 3][i % 3] = i % 3 == 2 ? 1.5f : 0; /* x is up */
    assert_ok(f->c, npz_write(f->c, path, 3, parts));
    sherf_motion *m;
    assert_ok(f->c, sherf_motion_load(f->c, path, NULL, &m));
    assert_non_null(strstr(sherf_motion_description(m), "is another axis up (--up)?"));
    sherf_motion_free(m);
}

/* ---- rotations as six numbers ---- */

enum { BY_ROWS, BY_COLUMNS, WOVEN, SIX_LAYOUTS };

static void six_of(const float turn[3], int layout, float six[6]) {
    float R[9];
    rodrigues(turn, R);
    for (int k = 0; k < 3; k++) {
        six[layout == WOVEN ? 2 * k : k] = R[layout == BY_ROWS ? k : 3 * k];
        six[layout == WOVEN ? 2 * k + 1 : 3 + k] = R[layout == BY_ROWS ? 3 + k : 3 * k + 1];
    }
}

static void sixes_of(const arrays *a, int layout, float (*six)[24][6]) {
    for (int i = 0; i < WALK_FRAMES; i++)
        for (int j = 0; j < 24; j++) six_of(a->smpl[i] + 3 * j, layout, six[i][j]);
}

/* Joint j of the motion's frame 5 is turned as in the walk. */
static void assert_turned(const walk_fixture *f, const sherf_motion *motion, int j) {
    const float *v = f->walk.pose[5].poses_rad + 3 * j;
    float q[4];
    quaternion_from_axis_angle((const double[3]){v[0], v[1], v[2]}, q);
    assert_true(quaternion_angle(motion->clip.turn[5][j], q) < 1e-3);
}

/* Each layout is recognised by its numbers and by how knees and elbows bend, in all shapes. */
static void six_numbers(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("six.npz"), *bare = test_path("six.npy");
    static float six[WALK_FRAMES][24][6], body[WALK_FRAMES][23][6], root[WALK_FRAMES][6];
    arrays a;
    arrays_of(&f->walk, walk_y_up, &a);
    for (int layout = 0; layout < SIX_LAYOUTS; layout++) {
        sixes_of(&a, layout, six);
        for (int i = 0; i < WALK_FRAMES; i++) {
            memcpy(body[i], six[i] + 1, sizeof body[i]);
            memcpy(root[i], six[i][0], sizeof root[i]);
        }
        const npz_member trans = {"trans", 2, {WALK_FRAMES, 3}, a.trans[0]};
        npz_member forms[][3] = {
            {{"poses", 3, {WALK_FRAMES, 24, 6}, six[0][0]}, trans},
            {{"poses_6d", 2, {WALK_FRAMES, 144}, six[0][0]}, trans},
            {{"smpl_poses", 4, {WALK_FRAMES, 24, 2, 3}, six[0][0]}, trans},
            {{"body_pose", 3, {WALK_FRAMES, 23, 6}, body[0][0]},
             trans,
             {"global_orient", 2, {WALK_FRAMES, 6}, root[0]}},
        };
        for (size_t i = 0; i < COUNT_OF(forms); i++) {
            assert_ok(f->c, npz_write(f->c, path, i == 3 ? 3 : 2, forms[i]));
            assert_walk(f, path, NULL, i == 2 ? 60 : 30, "y up", "");
        }
        assert_ok(f->c, npy_write_f32(f->c, bare, 3, (const int64_t[]){WALK_FRAMES, 24, 6}, six[0][0]));
        sherf_motion *motion;
        assert_ok(f->c, sherf_motion_load(f->c, bare, NULL, &motion));
        for (int j = 1; j < 24; j++) /* without a place */
            assert_turned(f, motion, j);
        sherf_motion_free(motion);
    }
}

/* A dict a frame, as other tools write them: each shows it, or it is said. */
/* Frames' own numbers in a list: what is between them is filled in. */
static void numbered_frames(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("numbered.pkl");
    arrays a;
    pickle_writer w;
    arrays_of(&f->walk, walk_y_up, &a);
    pickle_begin(&w, f->c);
    pickle_list_open(&w);
    for (int i = 0; i < WALK_FRAMES; i += 2 - (i == WALK_FRAMES - 2)) { /* the last two are neighbours */
        const float number = (float)(100 + i);
        pickle_dict_open(&w);
        pickle_string(&w, "frame");
        pickle_floats(&w, 1, (const int[]){1}, &number);
        rest_of(&a, i, &w, "transl");
        pickle_dict_close(&w);
    }
    pickle_list_close(&w);
    assert_ok(f->c, pickle_finish_file(&w, path));
    sherf_motion *motion;
    assert_ok(f->c, sherf_motion_load(f->c, path, &(sherf_motion_options){.body = f->body}, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), WALK_FRAMES);
    sherf_pose p;
    sherf_motion_pose(motion, 4, &p);
    assert_true(walk_distance(f->c, f->body, &p, &f->walk.pose[4]) < 1e-3);
    sherf_motion_free(motion);
}

static void six_numbers_by_frame(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("six_frames.pkl");
    static float six[WALK_FRAMES][24][6];
    arrays a;
    arrays_of(&f->walk, walk_y_up, &a);
    for (int layout = 0; layout < SIX_LAYOUTS; layout++) {
        const sherf_motion_options said = {.rotations =
                                               layout ? SHERF_ROTATIONS_6D_COLUMNS : SHERF_ROTATIONS_6D_ROWS};
        pickle_writer w;
        sixes_of(&a, layout, six);
        pickle_begin(&w, f->c);
        pickle_list_open(&w);
        for (int i = 0; i < WALK_FRAMES; i++) {
            pickle_dict_open(&w);
            pickle_string(&w, "body_pose");
            pickle_floats(&w, 2, (const int[]){23, 6}, six[i][1]);
            pickle_string(&w, "global_orient");
            pickle_floats(&w, 2, (const int[]){1, 6}, six[i][0]);
            pickle_string(&w, "trans");
            pickle_floats(&w, 1, (const int[]){3}, a.trans[i]);
            pickle_dict_close(&w);
        }
        pickle_list_close(&w);
        assert_ok(f->c, pickle_finish_file(&w, path));
        assert_walk(f, path, &said, 30, "SMPL poses", "y up");
        assert_walk(f, path, NULL, 30, "SMPL poses", "y up");
    }
}

/* Where nothing shows which they are, they are refused until it is said; and what is no rotation. */
static void six_numbers_said(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("said.npz");
    static float six[WALK_FRAMES][24][6];
    arrays a;
    arrays_of(&f->walk, walk_y_up, &a);
    for (int said = 0; said < 2; said++) {
        const int turned = 16; /* a shoulder */
        npz_member member[] = {{"poses", 3, {WALK_FRAMES, 24, 6}, six[0][0]},
                               {"trans", 2, {WALK_FRAMES, 3}, a.trans[0]},
                               {.name = "rotations", .text = said ? "6d-columns" : "6d-rows"}};
        sixes_of(&a, said ? BY_COLUMNS : BY_ROWS, six);
        for (int i = 0; i < WALK_FRAMES; i++)
            for (int j = 0; j < 4; j++)
                six_of((const float[3]){0, 0, 0}, BY_ROWS, six[i][(const int[]){4, 5, 18, 19}[j]]);
        assert_ok(f->c, npz_write(f->c, path, 2, member));
        refused(f, path, NULL, SHERF_BAD_FILE, "\"rotations\": \"6d-rows\" or \"6d-columns\"");
        sherf_motion *motion;
        const sherf_motion_options options = {.rotations = said ? SHERF_ROTATIONS_6D_COLUMNS
                                                                : SHERF_ROTATIONS_6D_ROWS};
        for (int inside = 0; inside < 2; inside++) {
            assert_ok(f->c, npz_write(f->c, path, 2 + inside, member));
            assert_ok(f->c, sherf_motion_load(f->c, path, inside ? NULL : &options, &motion));
            assert_turned(f, motion, turned);
            sherf_motion_free(motion);
        }
    }
    for (int i = 0; i < WALK_FRAMES * 24 * 6; i++) six[i / 144][i / 6 % 24][i % 6] *= 1.4f;
    npz_member longer[] = {{"poses", 3, {WALK_FRAMES, 24, 6}, six[0][0]}};
    assert_ok(f->c, npz_write(f->c, path, 1, longer));
    refused(f, path, NULL, SHERF_BAD_FILE, "no two rows or columns of rotations");
    path = test_path("said.npy"); /* with places among them */
    assert_ok(f->c, npy_write_f32(f->c, path, 2, (const int64_t[]){WALK_FRAMES, 135}, six[0][0]));
    refused(f, path, NULL, SHERF_BAD_FILE, "an array of 12 x 135: six numbers a joint and more");
}

/* Inter-X's motions are SMPL-X's by their hands alone, y up, 120 frames a second. */
static void inter_x(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("P1.npz");
    static float body[WALK_FRAMES][21][3], hand[WALK_FRAMES][15][3];
    const float betas[10] = {0};
    arrays a;
    arrays_of(&f->walk, walk_y_up, &a);
    for (int i = 0; i < WALK_FRAMES; i++) memcpy(body[i], a.body[i], sizeof body[i]);
    npz_member member[] = {{"pose_body", 3, {WALK_FRAMES, 21, 3}, body[0][0]},
                           {"pose_lhand", 3, {WALK_FRAMES, 15, 3}, hand[0][0]},
                           {"pose_rhand", 3, {WALK_FRAMES, 15, 3}, hand[0][0]},
                           {"root_orient", 2, {WALK_FRAMES, 3}, a.root[0]},
                           {"trans", 2, {WALK_FRAMES, 3}, a.transx[0]},
                           {"betas", 2, {1, 10}, betas},
                           {.name = "gender", .text = "male"},
                           {.name = "model", .text = "smplh"}};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(member) - 1, member));
    assert_walk(f, path, NULL, 120, "Inter-X", "y up");
    member[4].data = a.trans[0]; /* unless the file says otherwise */
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(member), member));
    assert_walk(f, path, NULL, 120, "Inter-X", "y up");
}

/* Multi-HMR's people: 53 rotations of SMPL-X, root first; transl is the head's place, transl_pelvis the
 * pelvis's. */
static void multi_hmr_person(pickle_writer *w, const walk_fixture *f, const arrays *down, int frame,
                             bool pelvis) {
    const float head[3] = {7, 8, 9};
    float turns[53][3] = {{0}}, at[3];
    memcpy(turns, down->smpl[frame], 66 * sizeof(float));
    for (int k = 0; k < 3; k++) at[k] = down->trans[frame][k] + (float)f->walk.skeleton.rest_m[0][k];
    pickle_dict_open(w);
    pickle_string(w, "rotvec");
    pickle_floats(w, 3, (const int[]){1, 53, 3}, turns[0]);
    pickle_string(w, "transl");
    pickle_floats(w, 2, (const int[]){1, 3}, head);
    if (pelvis) pickle_string(w, "transl_pelvis");
    if (pelvis) pickle_floats(w, 2, (const int[]){1, 3}, at);
    pickle_dict_close(w);
}

/* HumanNeRF's mesh_infos: Th is SMPL's, unless the T-pose's pelvis is at the origin: then it is the pelvis's
 * place. */
static void mesh_infos(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("mesh_infos.pkl");
    arrays up;
    arrays_of(&f->walk, walk_y_up, &up);
    for (int own = 0; own < 2; own++) {
        pickle_writer w;
        pickle_begin(&w, f->c);
        pickle_dict_open(&w);
        for (int i = 0; i < WALK_FRAMES; i++) {
            char name[32];
            float R[9], at[3], joints[24][3] = {{0}};
            rodrigues(up.root[i], R);
            for (int k = 0; k < 3; k++) {
                const double *J0 = f->walk.skeleton.rest_m[0];
                at[k] = up.trans[i][k] + (float)J0[k]; /* pelvis */
                joints[0][k] = own ? 0 : (float)J0[k];
                for (int n = 0; n < 3 && !own; n++) at[k] -= R[3 * k + n] * (float)J0[n];
            }
            memset(up.smpl[i], 0, 3 * sizeof(float));
            snprintf(name, sizeof name, "frame_%06d", i);
            pickle_string(&w, name);
            pickle_dict_open(&w);
            pickle_string(&w, "Rh");
            pickle_floats(&w, 1, (const int[]){3}, up.root[i]);
            pickle_string(&w, "Th");
            pickle_floats(&w, 1, (const int[]){3}, at);
            pickle_string(&w, "poses");
            pickle_floats(&w, 1, (const int[]){72}, up.smpl[i]);
            pickle_string(&w, "tpose_joints");
            pickle_floats(&w, 2, (const int[]){24, 3}, joints[0]);
            pickle_dict_close(&w);
        }
        pickle_dict_close(&w);
        assert_ok(f->c, pickle_finish_file(&w, path));
        assert_walk(f, path, NULL, 30, "mesh_infos", "y up");
    }
}

/* MDM's models of actions: SMPL's 24 joints in a camera's view, or six numbers for each and the place as a
 * 25th. Other numbers of joints are named. */
static void mdm_actions(void **state) {
    enum { ALL = WALK_FRAMES + 3 };
    const walk_fixture *f = *state;
    const char *path = test_path("actions.npz");
    static double at[WALK_FRAMES][22][3];
    static float joints[2][24][3][ALL], sixes[2][25][6][ALL];
    const float lengths[2] = {2, WALK_FRAMES};
    arrays down;
    arrays_of(&f->walk, walk_y_down, &down);
    for (int i = 0; i < WALK_FRAMES; i++) {
        float turn[BODY_JOINTS][4], pelvis[3], R[9];
        double all[BODY_JOINTS][3];
        pose_to_turns(&f->walk.pose[i], &f->walk.skeleton, turn, pelvis);
        skeleton_joints(&f->walk.skeleton, (const float(*)[4])turn, pelvis, all);
        memcpy(at[i], all, sizeof at[i]);
        for (int j = 0; j < 24; j++) {
            for (int k = 0; k < 3; k++) joints[1][j][k][i] = (float)(walk_y_down[4 * k] * all[j][k]);
            rodrigues(down.smpl[i] + 3 * j, R);
            for (int k = 0; k < 6; k++) sixes[1][j][k][i] = R[k];
        }
        for (int k = 0; k < 3; k++) sixes[1][24][k][i] = joints[1][0][k][i];
    }
    npz_member file[] = {{"motion", 4, {2, 24, 3, ALL}, joints[0][0][0]}, {"lengths", 1, {2}, lengths}};
    const sherf_motion_options second = {.body = f->body, .track = "1"};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(file), file));
    sherf_motion *motion;
    assert_ok(f->c, sherf_motion_load(f->c, path, &second, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), WALK_FRAMES);
    assert_non_null(
        strstr(sherf_motion_description(motion), "MDM: 12 frames, 20 a second (assumed), y down"));
    assert_joints_at(f, path, motion, (const double(*)[22][3])at);
    sherf_motion_free(motion);
    file[0] = (npz_member){"motion", 4, {2, 25, 6, ALL}, sixes[0][0][0]};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(file), file));
    assert_walk(f, path, &second, 20, "MDM", "y down");
    file[0] = (npz_member){"motion", 4, {2, 21, 3, ALL}, joints[0][0][0]};
    assert_ok(f->c, npz_write(f->c, path, COUNT_OF(file), file));
    refused(f, path, NULL, SHERF_BAD_FILE, "a motion of 2 x 21 x 3 x 15");
    refused(f, path, NULL, SHERF_BAD_FILE, "KIT-ML's skeleton");
    path = test_path("bare.npy");
    assert_ok(f->c, npy_write_f32(f->c, path, 3, (const int64_t[]){2, 21, 3}, joints[0][0][0]));
    refused(f, path, NULL, SHERF_BAD_FILE, "an array of 2 x 21 x 3; write a dict of poses and trans");
    path = test_path("lines.jsonl");
    FILE *lines = fopen(path, "w");
    fputs("{\"poses\": 1}\n{\"poses\": 2}\n", lines);
    fclose(lines);
    refused(f, path, NULL, SHERF_BAD_FILE, "if each line is one value, make one list of them");
}

static void multi_hmr(void **state) {
    const walk_fixture *f = *state;
    const char *path = test_path("multi.pkl");
    arrays down;
    pickle_writer w;
    arrays_of(&f->walk, walk_y_down, &down);
    for (int pelvis = 1; pelvis >= 0; pelvis--) {
        pickle_begin(&w, f->c);
        pickle_list_open(&w);
        for (int i = 0; i < WALK_FRAMES; i++) {
            pickle_list_open(&w);
            multi_hmr_person(&w, f, &down, i, pelvis);
            pickle_list_close(&w);
        }
        pickle_list_close(&w);
        assert_ok(f->c, pickle_finish_file(&w, path));
        if (pelvis) assert_walk(f, path, NULL, 30, "Multi-HMR", "y down");
    }
    sherf_motion *motion; /* the head's place is not taken for the body's */
    assert_ok(f->c, sherf_motion_load(f->c, path, NULL, &motion));
    assert_non_null(strstr(sherf_motion_description(motion), "no translation"));
    sherf_motion_free(motion);
    pickle_begin(&w, f->c); /* one person in a dict */
    multi_hmr_person(&w, f, &down, 0, true);
    assert_ok(f->c, pickle_finish_file(&w, path));
    assert_ok(f->c, sherf_motion_load(f->c, path, &(sherf_motion_options){.body = f->body}, &motion));
    sherf_pose p;
    sherf_motion_pose(motion, 0, &p);
    assert_true(walk_distance(f->c, f->body, &p, &f->walk.pose[0]) < 1e-3);
    sherf_motion_free(motion);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(in_one_dict),
                                       cmocka_unit_test(frames_by_picture),
                                       cmocka_unit_test(dicts_of_dicts),
                                       cmocka_unit_test(quaternions_apart),
                                       cmocka_unit_test(said_not_guessed),
                                       cmocka_unit_test(arrays_of_three),
                                       cmocka_unit_test(other_programs),
                                       cmocka_unit_test(bvh_by_place),
                                       cmocka_unit_test(bvh_texts),
                                       cmocka_unit_test(knees_that_bend_forwards),
                                       cmocka_unit_test(frames_before_people),
                                       cmocka_unit_test(rates),
                                       cmocka_unit_test(packed_with_more),
                                       cmocka_unit_test(exchanged),
                                       cmocka_unit_test(six_numbers),
                                       cmocka_unit_test(six_numbers_said),
                                       cmocka_unit_test(six_numbers_by_frame),
                                       cmocka_unit_test(numbered_frames),
                                       cmocka_unit_test(inter_x),
                                       cmocka_unit_test(mdm_actions),
                                       cmocka_unit_test(multi_hmr),
                                       cmocka_unit_test(mesh_infos)};
    return cmocka_run_group_tests(tests, walk_setup, walk_teardown);
}
