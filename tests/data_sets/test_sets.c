/* Tests of the four data set layouts on small made-up sets: pictures, masks, cameras, bodies, splits, and
 * refused input. */
#include <pthread.h>
#include <sys/stat.h>

#include "data/dataset.h"
#include "make_files.h"

static char root_[PATH_LENGTH];
static const char *fresh_root(const char *name) {
    snprintf(root_, sizeof root_, "%s", test_path(name));
    return root_;
}

static const char *const plain_images[] = {"view00\\000003.png", "view01/000003.png", "view00\\000007.png",
                                           "view01/000007.png"};

static made_annots plain_annots(void) {
    made_annots a = {.poses = 2, .views = 2, .unit = 1};
    for (int i = 0; i < 4; i++) a.image[i] = plain_images[i];
    return a;
}

static void make_thuman_person(context *c, const char *path, const made_annots *a) {
    char name[256], folder[PATH_LENGTH];
    snprintf(folder, sizeof folder, "%s", path);
    make_annots(c, join(folder, "annots.npy"), a);
    for (int i = 0; i < a->poses * a->views; i++) {
        int number = i / a->views ? 7 : 3;
        snprintf(name, sizeof name, "view%02d/%06d.png", i % a->views, number);
        make_picture(c, join(folder, name), i, MADE_WIDTH, MADE_HEIGHT);
        snprintf(name, sizeof name, "mask_cihp/view%02d/%06d.png", i % a->views, number);
        make_mask(c, join(folder, name), MADE_WIDTH, MADE_HEIGHT, 0, i % 2 ? 255 : 1);
        snprintf(name, sizeof name, "new_params_neutral/%d.npy", number);
        make_parameters(c, join(folder, name), number, false);
    }
}

static sherf_dataset *opened(context *c, const char *spec) {
    sherf_dataset *d = NULL;
    assert_ok(c, sherf_dataset_open(c, spec, &d));
    return d;
}

static void assert_pose(const sherf_pose *pose, int seed, bool global_in_root) {
    double poses[72], shapes[10], Rh[3], Th[3];
    made_pose(seed, poses, shapes, Rh, Th);
    float turn[3] = {(float)Rh[0], (float)Rh[1], (float)Rh[2]}, R[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    if (!global_in_root) rodrigues(turn, R);
    for (int i = 0; i < 72; i++)
        assert_float_equal(pose->poses_rad[i], global_in_root && i < 3 ? Rh[i] : poses[i], 1e-6);
    for (int i = 0; i < 10; i++) assert_float_equal(pose->shapes[i], shapes[i], 1e-6);
    for (int i = 0; i < 9; i++) assert_float_equal(pose->R[i], R[i], 1e-6);
    for (int i = 0; i < 3; i++) assert_float_equal(pose->Th_m[i], Th[i], 1e-6);
}

/* Checks the camera of view v at `scale`; T is in metres whatever the file's unit. */
static void assert_camera(const sherf_camera *camera, int view, double scale) {
    double R[9], K[9] = {50 * scale, 0, 20 * scale, 0, 55 * scale, 15 * scale, 0, 0, 1};
    double T[3] = {0.1, -0.2, 2 + view};
    made_rotation(0.3 * view, R);
    for (int i = 0; i < 9; i++) assert_float_equal(camera->K[i], K[i], 1e-5);
    for (int i = 0; i < 9; i++) assert_float_equal(camera->R[i], R[i], 1e-6);
    for (int i = 0; i < 3; i++) assert_float_equal(camera->T_m[i], T[i], 1e-6);
}

static void assert_made_picture(const data_view *v, int seed) {
    assert_int_equal(v->image.width, MADE_WIDTH);
    assert_int_equal(v->image.height, MADE_HEIGHT);
    for (int i = 0; i < MADE_WIDTH * MADE_HEIGHT; i++) {
        int x = i % MADE_WIDTH, y = i / MADE_WIDTH;
        assert_int_equal(v->mask[i], made_person(x, y));
        for (int k = 0; k < 3; k++)
            assert_float_equal(v->image.data[i * 3 + k],
                               made_person(x, y) ? made_color(seed, x, y, k) / 255.f : 0, 1e-7);
    }
}

static void thuman_is_read(void **state) {
    context *c = test_context();
    const char *root = fresh_root("thuman");
    made_annots a = plain_annots();
    make_thuman_person(c, join(root, "b_person"), &a);
    make_thuman_person(c, join(root, "a_person"), &a);
    make_text(c, join(root, "human_list.txt"), "b_person\r\n\n../elsewhere/a_person\n");
    sherf_dataset *d = opened(c, root);
    assert_string_equal(dataset_protocol(d)->name, "thuman");
    assert_int_equal(sherf_dataset_person_count(d), 2);
    assert_string_equal(sherf_dataset_person(d, 0), "b_person");
    assert_string_equal(sherf_dataset_person(d, 1), "a_person");
    assert_null(sherf_dataset_person(d, 2));
    assert_int_equal(sherf_dataset_pose_count(d, 1), 2);
    assert_int_equal(sherf_dataset_view_count(d, 1), 2);
    for (int i = 0; i < 4; i++) {
        data_view *v = NULL;
        assert_ok(c, dataset_view(c, d, i % 2, i / 2, i % 2, 0, &v));
        assert_made_picture(v, i);
        assert_null(v->unknown);
        assert_camera(&v->camera, i % 2, 1);
        assert_int_equal(v->camera.width_px, MADE_WIDTH);
        assert_pose(&v->pose, i / 2 ? 7 : 3, false);
        sherf_observation_free(v);
    }
    data_view *v = NULL;
    assert_ok(c, dataset_view(c, d, 0, 0, 1, 20, &v));
    assert_int_equal(v->image.width, 20);
    assert_int_equal(v->image.height, 15);
    assert_camera(&v->camera, 1, 0.5);
    double mean = 0; /* a whole number of source pixels: the plain mean */
    for (int i = 0; i < 4; i++) mean += made_color(1, 16 + i % 2, 10 + i / 2, 1) / 255. / 4;
    assert_float_equal(v->image.data[(5 * 20 + 8) * 3 + 1], mean, 1e-6);
    sherf_observation_free(v);
    sherf_camera camera;
    assert_ok(c, dataset_camera(c, d, 0, 1, &camera));
    assert_camera(&camera, 1, 1);
    assert_int_equal(camera.height_px, MADE_HEIGHT);
    assert_fails(c, dataset_view(c, d, 0, 2, 0, 0, &v), SHERF_BAD_ARGUMENT, "no pose 2");
    assert_fails(c, dataset_view(c, d, 0, 0, 2, 0, &v), SHERF_BAD_ARGUMENT, "no view 2");
    assert_fails(c, dataset_view(c, d, 7, 0, 0, 0, &v), SHERF_BAD_ARGUMENT, "no person 7");
    assert_fails(c, dataset_view(c, d, 0, 0, 0, 100000, &v), SHERF_BAD_ARGUMENT, "cannot become");
    sherf_dataset_free(d);
    sherf_context_free(c);
}

/* Names that releases and their repackings use instead of the usual ones, and pictures that no list names. */
static void other_names_are_read(void **state) {
    context *c = test_context();
    char person[PATH_LENGTH], name[256];
    const char *root = fresh_root("other_names");
    snprintf(person, sizeof person, "%s", join(root, "someone"));
    made_annots a = plain_annots(); /* lists .png files */
    make_annots(c, join(person, "annots_new.npy"), &a);
    for (int i = 0; i < 4; i++) {
        const int number = i / 2 ? 7 : 3;
        snprintf(name, sizeof name, "view%02d/%06d.%s", i % 2, number, i ? "png" : "jpg");
        make_picture(c, join(person, name), i, MADE_WIDTH, MADE_HEIGHT);
        snprintf(name, sizeof name, "masks/view%02d/%06d.png", i % 2, number);
        make_mask(c, join(person, name), MADE_WIDTH, MADE_HEIGHT, 0, 1);
        snprintf(name, sizeof name, "new_params/%d.npy", number);
        make_parameters(c, join(person, name), number, false);
    }
    snprintf(name, sizeof name, "thuman:%.200s", root);
    sherf_dataset *d = opened(c, name);
    data_view *v = NULL;
    assert_ok(c, dataset_view(c, d, 0, 0, 0, 0, &v)); /* a JPEG: its mask is exact, its colours are close */
    for (int i = 0; i < MADE_WIDTH * MADE_HEIGHT; i++)
        assert_int_equal(v->mask[i], made_person(i % MADE_WIDTH, i / MADE_WIDTH));
    sherf_observation_free(v);
    for (int i = 1; i < 4; i++) {
        assert_ok(c, dataset_view(c, d, 0, i / 2, i % 2, 0, &v));
        assert_made_picture(v, i);
        assert_pose(&v->pose, i / 2 ? 7 : 3, false);
        sherf_observation_free(v);
    }
    sherf_dataset_free(d);
    sherf_context_free(c);
}

static void unlisted_pictures_are_found(void **state) {
    static const char *const folders[] = {"Camera_B1", "images/2"};
    context *c = test_context();
    for (int form = 0; form < 2;
         form++) { /* folders of cameras numbered from 1, without gaps; the second form is below images/ */
        char person[PATH_LENGTH], name[256];
        const char *root = fresh_root(form ? "unlisted_images" : "unlisted");
        snprintf(person, sizeof person, "%s", join(root, "someone"));
        made_annots a = {.poses = 0, .views = 2, .unit = 1000};
        make_annots(c, join(person, "annots.npy"), &a);
        for (int i = 0; i < 4; i++) {
            const int number = i / 2 ? 7 : 3;
            snprintf(name, sizeof name, "%.*s%d/%06d.png", (int)strlen(folders[form]) - 1, folders[form],
                     i % 2 + 1, number);
            make_picture(c, join(person, name), i, MADE_WIDTH, MADE_HEIGHT);
            snprintf(name, sizeof name, "mask/%s%d/%06d.png", form ? "" : "Camera_B", i % 2 + 1, number);
            make_mask(c, join(person, name), MADE_WIDTH, MADE_HEIGHT, 0, 1);
            snprintf(name, sizeof name, "new_params_neutral/%d.npy", number);
            make_parameters(c, join(person, name), number, false);
        }
        snprintf(name, sizeof name, "thuman:%.200s", root);
        sherf_dataset *d = opened(c, name);
        assert_int_equal(sherf_dataset_pose_count(d, 0), 2);
        for (int i = 0; i < 4; i++) {
            data_view *v = NULL;
            if (dataset_view(c, d, 0, i / 2, i % 2, 0, &v)) fail_msg("%s", c->message);
            assert_made_picture(v, i);
            assert_pose(&v->pose, i / 2 ? 7 : 3, false);
            sherf_observation_free(v);
        }
        sherf_dataset_free(d);
        make_picture(c, join(person, form ? "images/9/000003.png" : "Camera_B9/000003.png"), 0, 4, 4);
        assert_ok(c, sherf_dataset_open(c, name, &d)); /* one folder more than cameras */
        data_view *v = NULL;
        assert_fails(c, dataset_view(c, d, 0, 0, 0, 0, &v), SHERF_BAD_FILE, "3 folders of pictures");
        sherf_dataset_free(d);
    }
    sherf_context_free(c);
}

/* The picture as OpenCV would undistort it, black where the undistorted mask is 0. */
static void distortion_is_taken_out(void **state) {
    context *c = test_context();
    const char *root = fresh_root("distorted");
    made_annots a = plain_annots();
    const double D[DISTORTION_MAX] = {-1.5, 0.4, 0.02, -0.02, 0.02}, K[9] = {50, 0, 20, 0, 55, 15, 0, 0, 1};
    memcpy(a.D, D, sizeof a.D);
    make_thuman_person(c, join(root, "person"), &a);
    sherf_dataset *d = opened(c, root);
    data_view *v = NULL;
    assert_ok(c, dataset_view(c, d, 0, 0, 0, 0, &v));
    size_t n = MADE_WIDTH * MADE_HEIGHT, differ = 0;
    sherf_image image = {MADE_WIDTH, MADE_HEIGHT, 3, mem_alloc(c, n * 3, sizeof(float))};
    image_u8 mask = {MADE_WIDTH, MADE_HEIGHT, 1, mem_alloc(c, n, 1)};
    for (size_t i = 0; i < n * 3; i++)
        image.data[i] =
            made_color(0, (int)(i / 3 % MADE_WIDTH), (int)(i / 3 / MADE_WIDTH), (int)(i % 3)) / 255.f;
    for (size_t i = 0; i < n; i++) mask.data[i] = made_person((int)(i % MADE_WIDTH), (int)(i / MADE_WIDTH));
    assert_ok(c, image_undistort_f32(c, &image, K, D));
    assert_ok(c, image_undistort(c, &mask, K, D));
    for (size_t i = 0; i < n; i++) {
        assert_int_equal(v->mask[i], mask.data[i]);
        differ += v->mask[i] != made_person((int)(i % MADE_WIDTH), (int)(i / MADE_WIDTH));
        for (size_t k = 0; k < 3; k++)
            assert_float_equal(v->image.data[i * 3 + k], mask.data[i] ? image.data[i * 3 + k] : 0, 0);
    }
    assert_true(differ > 10); /* the lens has an effect */
    mem_free(image.data);
    mem_free(mask.data);
    sherf_observation_free(v);
    sherf_dataset_free(d);
    sherf_context_free(c);
}

/* Frame as the fifth "_" field, T in millimetres, Rh, half size, and the band along the mask's edge. */
static void zju_is_read(void **state) {
    context *c = test_context();
    const char *root = fresh_root("zju");
    made_annots a = {.poses = 1, .views = 2, .unit = 1000};
    a.image[0] = "Camera_B1/Camera_B1_2019_x_0004_17.png";
    a.image[1] = "Camera_B2/Camera_B2_2019_x_0004_18.png";
    static const char *const people[] = {"CoreView_313", "CoreView_386", "CoreView_377"};
    for (int p = 0; p < 3; p++) {
        const char *folder = people[p];
        char name[256];
        for (int v = 0; v < 2; v++) {
            snprintf(name, sizeof name, "%s/%s", folder, a.image[v]);
            make_picture(c, join(root, name), v, MADE_WIDTH, MADE_HEIGHT);
            snprintf(name, sizeof name, "%s/mask_cihp/%s", folder, a.image[v]);
            make_mask(c, join(root, name), MADE_WIDTH, MADE_HEIGHT, 0, 13);
        }
        snprintf(name, sizeof name, "%s/annots.npy", folder);
        make_annots(c, join(root, name), &a);
        snprintf(name, sizeof name, "%s/new_params/4.npy", folder);
        make_parameters(c, join(root, name), 4, true);
    }
    char spec[PATH_LENGTH + 8];
    snprintf(spec, sizeof spec, "zju:%s/", root);
    sherf_dataset *d = opened(c, spec);
    assert_string_equal(sherf_dataset_person(d, 0), "CoreView_313");
    data_view *v = NULL;
    assert_ok(c, dataset_view(c, d, 0, 0, 1, 0, &v));
    assert_int_equal(v->image.width, MADE_WIDTH / 2);
    assert_camera(&v->camera, 1, 0.5);
    assert_pose(&v->pose, 4, false);
    sherf_observation_free(v);
    assert_ok(c, dataset_view(c, d, 0, 0, 1, MADE_WIDTH, &v));
    assert_non_null(v->unknown);
    for (int y = 0; y < MADE_HEIGHT; y++)
        for (int x = 0; x < MADE_WIDTH; x++) {
            int some = 0, all = 1, at = y * MADE_WIDTH + x;
            for (int i = -2; i <= 2; i++)
                for (int j = -2; j <= 2; j++) {
                    if (x + i < 0 || x + i >= MADE_WIDTH || y + j < 0 || y + j >= MADE_HEIGHT) continue;
                    some |= made_person(x + i, y + j);
                    all &= made_person(x + i, y + j);
                }
            assert_int_equal(v->unknown[at], some && !all);
            assert_int_equal(v->mask[at], all);
            assert_float_equal(v->image.data[at * 3], some ? made_color(1, x, y, 0) / 255.f : 0, 1e-7);
        }
    sherf_observation_free(v);
    int *index = NULL, count = 0;
    assert_ok(c, dataset_people(c, d, NULL, true, &index, &count)); /* the paper's names */
    assert_int_equal(count, 1);
    assert_string_equal(sherf_dataset_person(d, index[0]), "CoreView_386");
    mem_free(index);
    assert_ok(c, dataset_people(c, d, NULL, false, &index, &count));
    assert_int_equal(count, 2);
    assert_string_equal(sherf_dataset_person(d, index[0]), "CoreView_377");
    assert_string_equal(sherf_dataset_person(d, index[1]), "CoreView_313");
    mem_free(index);
    sherf_dataset_free(d);
    sherf_context_free(c);
}

/* Writes an npz whose dict "smpl" has {betas, global_orient, body_pose, transl} with `poses` rows. */
static void make_smpl_npz(context *c, const char *path, int poses) {
    pickle_writer w;
    double *orient = mem_zero(c, (size_t)poses * 3, sizeof *orient),
           *body = mem_zero(c, (size_t)poses * 69, sizeof *body),
           *transl = mem_zero(c, (size_t)poses * 3, sizeof *transl), shapes[10] = {0};
    for (int p = poses - 1; p >= 0; p--) {
        double all[72];
        made_pose(p, all, shapes, orient + p * 3, transl + p * 3);
        memcpy(body + p * 69, all + 3, 69 * sizeof *body);
    }
    pickle_begin(&w, c);
    pickle_dict_open(&w);
    pickle_key_doubles(&w, "betas", 1, 10, shapes); /* the betas of pose 0 */
    pickle_key_doubles(&w, "global_orient", poses, 3, orient);
    pickle_key_doubles(&w, "body_pose", poses, 69, body);
    pickle_key_doubles(&w, "transl", poses, 3, transl);
    pickle_dict_close(&w);
    make_parent(c, path);
    const char *member = test_path("smpl.npy"), *name = "smpl.npy";
    assert_ok(c, pickle_finish_npy(&w, member));
    make_zip(path, 1, &name, &member);
    mem_free(orient);
    mem_free(body);
    mem_free(transl);
}

static void renderpeople_is_read(void **state) {
    context *c = test_context();
    const char *root = fresh_root("renderpeople");
    char name[256], json[4096] = "{";
    for (int v = 0; v < 3; v++) {
        snprintf(name, sizeof name, "camera%04d", v);
        made_camera_json(json + strlen(json), sizeof json - strlen(json), name, v);
        for (int p = 0; p < 2; p++) {
            snprintf(name, sizeof name, "rp_one/img/camera%04d/%04d.jpg", v, p);
            make_picture(c, join(root, name), v, MADE_WIDTH, MADE_HEIGHT);
            snprintf(name, sizeof name, "rp_one/mask/camera%04d/%04d.png", v, p);
            make_mask(c, join(root, name), MADE_WIDTH, MADE_HEIGHT, 0, 255);
        }
    }
    strcat(json, "}");
    make_text(c, join(root, "rp_one/cameras.json"), json);
    make_smpl_npz(c, join(root, "rp_one/outputs_re_fitting/refit_smpl_2nd.npz"), 2);
    sherf_dataset *d = opened(c, root);
    assert_string_equal(dataset_protocol(d)->name, "renderpeople");
    assert_int_equal(sherf_dataset_view_count(d, 0), 3);
    assert_int_equal(sherf_dataset_pose_count(d, 0), 2);
    data_view *v = NULL;
    assert_ok(c, dataset_view(c, d, 0, 0, 2, 0, &v));
    assert_camera(&v->camera, 2, 1);
    assert_pose(&v->pose, 0, true);
    assert_true(v->mask[10 * MADE_WIDTH + 20] && !v->mask[0]);
    assert_float_equal(v->image.data[0], 0, 0);
    sherf_observation_free(v);
    sherf_pose pose;
    assert_ok(c, dataset_pose(c, d, 0, 1, &pose));
    double all[72], shapes[10], Rh[3], Th[3];
    made_pose(1, all, shapes, Rh, Th);
    assert_float_equal(pose.poses_rad[1], Rh[1], 1e-6);
    assert_float_equal(pose.Th_m[2], Th[2], 1e-6);
    make_text(c, join(root, "rp_one/cameras.json"), "{\"camera0000\": {\"K\": [1,2], \"R\": 3}}");
    sherf_dataset_free(d);
    d = opened(c, root);
    assert_fails(c, dataset_view(c, d, 0, 0, 0, 0, &v), SHERF_BAD_FILE, "camera0000: camera: K");
    assert_non_null(strstr(c->message, "cameras.json"));
    sherf_dataset_free(d);
    sherf_context_free(c);
}

/* Two people with two views and the frames 0 and 6. */
static void make_humman(context *c, const char *root) {
    char name[256], json[4096] = "{\"kinect_depth_000\": {}, ";
    double all[72], shapes[10], Rh[3], Th[3];
    for (int v = 0; v < 2; v++) {
        snprintf(name, sizeof name, "kinect_color_%03d", v);
        made_camera_json(json + strlen(json), sizeof json - strlen(json), name, v);
    }
    strcat(json, "}");
    static const char *const people[] = {"p1_a1", "p0_a0"};
    for (int p = 0; p < 2; p++) {
        snprintf(name, sizeof name, "%s/cameras.json", people[p]);
        make_text(c, join(root, name), json);
        for (int pose = 0; pose <= 6; pose += 6) {
            for (int v = 0; v < 2; v++) {
                snprintf(name, sizeof name, "%s/kinect_color/kinect_%03d/%06d.png", people[p], v, pose);
                make_picture(c, join(root, name), v, MADE_WIDTH * 3, MADE_HEIGHT * 3);
                snprintf(name, sizeof name, "%s/kinect_mask/kinect_%03d/%06d.png", people[p], v, pose);
                make_mask(c, join(root, name), MADE_WIDTH * 3, MADE_HEIGHT * 3, 0, 255);
            }
            made_pose(pose, all, shapes, Rh, Th);
            float betas[10], orient[3], body[69], transl[3];
            for (int i = 0; i < 69; i++) body[i] = (float)all[3 + i];
            for (int i = 0; i < 10; i++) betas[i] = (float)shapes[i];
            for (int i = 0; i < 3; i++) orient[i] = (float)Rh[i], transl[i] = (float)Th[i];
            npz_member member[] = {{"betas", 1, {10}, betas},
                                   {"global_orient", 1, {3}, orient},
                                   {"body_pose", 1, {69}, body},
                                   {"transl", 1, {3}, transl}};
            snprintf(name, sizeof name, "%s/smpl_params/%06d.npz", people[p], pose);
            make_parent(c, join(root, name));
            assert_ok(c, npz_write(c, join(root, name), 4, member));
        }
    }
}

static void humman_is_read(void **state) {
    context *c = test_context();
    const char *root = fresh_root("humman");
    make_humman(c, root);
    sherf_dataset *d = opened(c, root);
    assert_string_equal(dataset_protocol(d)->name, "humman");
    assert_string_equal(sherf_dataset_person(d, 0), "p0_a0"); /* without a list people are sorted */
    assert_int_equal(sherf_dataset_pose_count(d, 0), 7);
    assert_int_equal(sherf_dataset_view_count(d, 0), 2);
    data_view *v = NULL;
    assert_ok(c, dataset_view(c, d, 0, 6, 1, 0, &v));
    assert_int_equal(v->image.width, MADE_WIDTH);
    assert_int_equal(v->image.height, MADE_HEIGHT);
    assert_camera(&v->camera, 1, 1. / 3);
    assert_pose(&v->pose, 6, true);
    sherf_observation_free(v);
    assert_fails(c, dataset_view(c, d, 0, 3, 1, 0, &v), SHERF_NO_FILE, "000003.npz");
    float some[69] = {0};
    npz_member three[] = {{"betas", 1, {10}, some}, {"body_pose", 1, {69}, some}, {"transl", 1, {3}, some}};
    assert_ok(c, npz_write(c, join(root, "p0_a0/smpl_params/000006.npz"), 3, three));
    assert_fails(c, dataset_view(c, d, 0, 6, 1, 0, &v), SHERF_BAD_FILE, "000006.npz: no global_orient");
    npz_member two[] = {{"betas", 1, {10}, some},
                        {"body_pose", 1, {69}, some},
                        {"global_orient", 1, {3}, some},
                        {"transl", 1, {2}, some}};
    assert_ok(c, npz_write(c, join(root, "p0_a0/smpl_params/000006.npz"), 4, two));
    assert_fails(c, dataset_view(c, d, 0, 6, 1, 0, &v), SHERF_BAD_FILE, "transl has 2 numbers");
    sherf_dataset_free(d);
    make_text(c, join(root, "train.txt"), "p1_a1\n");
    make_text(c, join(root, "test.txt"), "p0_a0\n");
    d = opened(c, root);
    int *index = NULL, count = 0;
    assert_ok(c, dataset_people(c, d, NULL, true, &index, &count));
    assert_int_equal(count, 1);
    assert_string_equal(sherf_dataset_person(d, index[0]), "p1_a1");
    mem_free(index);
    assert_ok(c, dataset_people(c, d, NULL, false, &index, &count));
    assert_string_equal(sherf_dataset_person(d, index[0]), "p0_a0");
    mem_free(index);
    sherf_dataset_free(d);
    sherf_context_free(c);
}

/* Without its own lists, the 22 sequences are for testing and all others for training. */
static void hummans_test_list(void **state) {
    context *c = test_context();
    const char *root = fresh_root("humman_list");
    char spec[PATH_LENGTH + 32];
    int *index = NULL, count = 0;
    make_text(c, join(root, "human_list.txt"),
              "p000455_a000986\np000455_a000987\np000547_a000145\np100074_a000048\n");
    snprintf(spec, sizeof spec, "humman:%s", root);
    sherf_dataset *d = opened(c, spec);
    assert_ok(c, dataset_people(c, d, NULL, false, &index, &count));
    assert_true(count == 3 && index[0] == 0 && index[1] == 2 && index[2] == 3);
    mem_free(index);
    assert_ok(c, dataset_people(c, d, NULL, true, &index, &count));
    assert_true(count == 1 && index[0] == 1);
    mem_free(index);
    sherf_dataset_free(d);
    make_text(c, join(root, "human_list.txt"), "somebody\n");
    d = opened(c, spec);
    assert_fails(c, dataset_people(c, d, NULL, false, &index, &count), SHERF_BAD_ARGUMENT,
                 "nobody of the paper's test split");
    sherf_dataset_free(d);
    sherf_context_free(c);
}

/* With one of train.txt and test.txt the others are not in the set, and messages say where the list is. */
static void half_a_split(void **state) {
    context *c = test_context();
    const char *root = fresh_root("half");
    char spec[PATH_LENGTH + 32];
    int *index = NULL, count = 0;
    make_text(c, join(root, "human_list.txt"), "a\nb\n");
    make_text(c, join(root, "test.txt"), "b\n");
    snprintf(spec, sizeof spec, "humman:%s", root);
    sherf_dataset *d = opened(c, spec);
    assert_fails(c, dataset_people(c, d, NULL, true, &index, &count), SHERF_BAD_ARGUMENT,
                 "test.txt gives the people, and there is no train.txt");
    assert_fails(c, dataset_people(c, d, "0-1", true, &index, &count), SHERF_BAD_ARGUMENT,
                 "lines 0 to 0 of train.txt and test.txt together are there");
    assert_fails(c, dataset_people(c, d, "a", true, &index, &count), SHERF_BAD_ARGUMENT,
                 "no person \"a\" in train.txt or test.txt");
    assert_ok(c, dataset_people(c, d, NULL, false, &index, &count));
    assert_true(count == 1 && index[0] == 0);
    mem_free(index);
    sherf_dataset_free(d);
    sherf_context_free(c);
}

/* The table in docs/datasets.md, by line numbers of a list of 500 people. */
static void the_papers_splits(void **state) {
    context *c = test_context();
    const char *root = fresh_root("splits");
    char *text = mem_zero(c, 500 * 16, 1);
    for (int i = 0; i < 500; i++) sprintf(text + strlen(text), "p%03d\n", i);
    make_text(c, join(root, "human_list.txt"), text);
    mem_free(text);
    static const struct {
        const char *spec, *names;
        bool training;
        int count, first, last;
    } cases[] = {
        {"thuman", NULL, true, 90, 0, 89},         {"thuman", NULL, false, 10, 90, 99},
        {"renderpeople", NULL, true, 450, 0, 449}, {"renderpeople", NULL, false, 30, 450, 479},
        {"thuman", "90-99", false, 10, 90, 99},    {"thuman", "p007,9,p011", false, 3, 7, 11},
        {"thuman", "499", false, 1, 499, 499},     {"thuman", "p001,1,0-1", false, 2, 1, 0},
    };
    for (size_t i = 0; i < COUNT_OF(cases); i++) {
        char spec[PATH_LENGTH + 32];
        snprintf(spec, sizeof spec, "%s:%s", cases[i].spec, root);
        sherf_dataset *d = opened(c, spec);
        int *index = NULL, count = 0;
        assert_ok(c, dataset_people(c, d, cases[i].names, cases[i].training, &index, &count));
        assert_int_equal(count, cases[i].count);
        assert_int_equal(index[0], cases[i].first);
        assert_int_equal(index[count - 1], cases[i].last);
        mem_free(index);
        sherf_dataset_free(d);
    }
    char spec[PATH_LENGTH + 32];
    snprintf(spec, sizeof spec, "thuman:%s", root);
    sherf_dataset *d = opened(c, spec);
    int *index = NULL, count = 0;
    assert_fails(c, dataset_people(c, d, "nobody", false, &index, &count), SHERF_BAD_ARGUMENT, "no person");
    assert_fails(c, dataset_people(c, d, "90-500", false, &index, &count), SHERF_BAD_ARGUMENT, "no people");
    assert_fails(c, dataset_people(c, d, "9-3", false, &index, &count), SHERF_BAD_ARGUMENT, "no people");
    assert_fails(c, dataset_people(c, d, "3x", false, &index, &count), SHERF_BAD_ARGUMENT, "no person");
    assert_fails(c, dataset_people(c, d, "", false, &index, &count), SHERF_BAD_ARGUMENT, "no people");
    assert_null(index);
    sherf_dataset_free(d);
    const data_protocol *p = &dataset_renderpeople.protocol;
    assert_int_equal(p->observation_views[2], 31);
    assert_int_equal(p->observation_pose, 2);
    assert_int_equal(p->train_pose_step, 2);
    p = &dataset_zju_mocap.protocol;
    assert_int_equal(p->pose_count, 25);
    assert_int_equal(p->views, 20);
    assert_int_equal(dataset_humman.protocol.view_step, 1);
    assert_float_equal(dataset_humman.protocol.image_scale, 1. / 3, 1e-12);
    sherf_context_free(c);
}

/* A THuman person with one fault. */
static void make_broken_person(context *c, const char *person, const char *what) {
    made_annots a = plain_annots();
    if (!strcmp(what, "nan")) a.K0 = NAN;
    if (!strcmp(what, "singular")) a.K0 = 1e-20;
    if (!strcmp(what, "rotation")) a.R0 = 0.5;
    if (!strcmp(what, "leaves")) a.image[3] = "view01/../../../etc/000007.png";
    if (!strcmp(what, "unnumbered")) a.image[2] = "view00/picture.png";
    if (!strcmp(what, "unlisted")) a.views_listed = 1;
    make_thuman_person(c, person, &a);
    const char *mask = join(person, "mask_cihp/view01/000007.png");
    if (!strcmp(what, "annots")) make_text(c, join(person, "annots.npy"), "\x93NUMPY rubbish");
    if (!strcmp(what, "picture")) assert_int_equal(unlink(join(person, "view01/000007.png")), 0);
    if (!strcmp(what, "mask")) assert_int_equal(unlink(mask), 0);
    if (!strcmp(what, "mask size")) make_mask(c, mask, 39, 30, 0, 1);
    if (!strcmp(what, "pose")) assert_int_equal(unlink(join(person, "new_params_neutral/7.npy")), 0);
    if (!strcmp(what, "shape")) {
        double short_pose[69] = {0};
        pickle_writer w;
        pickle_begin(&w, c);
        pickle_dict_open(&w);
        pickle_key_doubles(&w, "poses", 1, 69, short_pose);
        pickle_key_doubles(&w, "shapes", 1, 10, short_pose);
        pickle_key_doubles(&w, "Rh", 1, 3, short_pose);
        pickle_key_doubles(&w, "Th", 1, 3, short_pose);
        pickle_dict_close(&w);
        assert_ok(c, pickle_finish_npy(&w, join(person, "new_params_neutral/7.npy")));
    }
}

/* Each fault and its message. */
static void broken_sets_are_refused(void **state) {
    context *c = test_context();
    data_view *v = NULL;
    sherf_dataset *d = NULL;
    assert_fails(c, sherf_dataset_open(c, "thuman:/nonexistent", &d), SHERF_NO_FILE, "no such folder");
    const char *root = fresh_root("broken");
    assert_ok(c, folder_make(c, root));
    assert_fails(c, sherf_dataset_open(c, root, &d), SHERF_BAD_FILE, "no people");
    char person[PATH_LENGTH];
    snprintf(person, sizeof person, "%s", join(root, "p"));
    static const struct {
        const char *what, *message;
        sherf_status status;
    } cases[] = {
        {"nan", "view 0: K", SHERF_BAD_FILE},
        {"singular", "K is singular", SHERF_BAD_FILE},
        {"rotation", "not a rotation", SHERF_BAD_FILE},
        {"leaves", "leaves its folder", SHERF_BAD_FILE},
        {"unnumbered", "no frame number", SHERF_BAD_FILE},
        {"unlisted", "lists no view 1 of pose 1", SHERF_BAD_FILE},
        {"annots", "annots.npy", SHERF_BAD_FILE},
        {"picture", "000007.png: cannot be opened", SHERF_NO_FILE},
        {"mask", "000007.png: cannot be opened", SHERF_NO_FILE},
        {"mask size", "a mask of 39 x 30 pixels for a picture of 40 x 30", SHERF_MISMATCH},
        {"pose", "7.npy", SHERF_NO_FILE},
        {"shape", "poses has 69 numbers", SHERF_BAD_FILE},
    };
    for (size_t i = 0; i < COUNT_OF(cases); i++) {
        make_broken_person(c, person, cases[i].what);
        d = opened(c, root);
        assert_fails(c, dataset_view(c, d, 0, 1, 1, 0, &v), cases[i].status, cases[i].message);
        assert_null(v);
        if (i == 0) assert_int_equal(sherf_dataset_pose_count(d, 0), 0);
        sherf_dataset_free(d);
    }
    assert_fails(c, sherf_dataset_open(c, person, &d), SHERF_BAD_FILE, "one person's folder");
    size_t live = mem_live(); /* an error leaves nothing behind */
    assert_fails(c, sherf_dataset_open(c, person, &d), SHERF_BAD_FILE, "one person's folder");
    assert_true(mem_live() == live);
    sherf_context_free(c);
}

/* A missing part of a pose file is reported. Taken as zero, it would silently give a wrong pose. */
static void poses_are_whole(void **state) {
    context *c = test_context();
    const char *root = fresh_root("whole");
    char person[PATH_LENGTH], spec[PATH_LENGTH + 32], no[32];
    snprintf(person, sizeof person, "%s", join(root, "p"));
    made_annots a = plain_annots();
    sherf_pose pose;
    for (int zju = 0; zju < 2; zju++) {
        const char *const keys[] = {"poses", "shapes", zju ? "Rh" : "R", "Th"};
        snprintf(spec, sizeof spec, "%s:%s", zju ? "zju" : "thuman", root);
        for (size_t i = 0; i < COUNT_OF(keys); i++) {
            make_thuman_person(c, person, &a);
            const char *file = join(person, zju ? "new_params/3.npy" : "new_params_neutral/3.npy");
            make_parameters(c, file, 3, zju);
            sherf_dataset *d = opened(c, spec);
            assert_ok(c, dataset_pose(c, d, 0, 0, &pose));
            make_parameters_without(c, file, 3, zju, keys[i]);
            snprintf(no, sizeof no, "3.npy: no %s:", keys[i]);
            assert_fails(c, dataset_pose(c, d, 0, 0, &pose), SHERF_BAD_FILE, no);
            sherf_dataset_free(d);
        }
    }
    sherf_context_free(c);
}

/* ---- several contexts at once ---- */
typedef struct {
    const sherf_dataset *d;
    int wrong;
} reader;

static void *read_views(void *arg) {
    reader *r = arg;
    context *c = test_context();
    for (int i = 0; i < 40; i++) {
        data_view *v = NULL;
        if (dataset_view(c, r->d, i % 4, i / 4 % 2, i % 2, 0, &v) || v->pose.shapes[0] == 0) r->wrong++;
        sherf_observation_free(v);
    }
    sherf_context_free(c);
    return NULL;
}

static void threads_share_a_set(void **state) {
    context *c = test_context();
    const char *root = fresh_root("threads");
    made_annots a = plain_annots();
    char name[16];
    for (int i = 0; i < 4; i++) {
        snprintf(name, sizeof name, "p%d", i);
        make_thuman_person(c, join(root, name), &a);
    }
    sherf_dataset *d = opened(c, root);
    pthread_t thread[4];
    reader r[4];
    for (int i = 0; i < 4; i++) {
        r[i] = (reader){d, 0};
        assert_int_equal(pthread_create(&thread[i], NULL, read_views, &r[i]), 0);
    }
    for (int i = 0; i < 4; i++) {
        pthread_join(thread[i], NULL);
        assert_int_equal(r[i].wrong, 0);
    }
    sherf_dataset_free(d);
    sherf_context_free(c);
}

/* Every allocation of opening a set and reading a view fails once: an error, and no leak. */
static void memory_runs_out(void **state) {
    context *c = test_context();
    const char *root = fresh_root("memory");
    made_annots a = plain_annots();
    a.D[0] = -0.1;
    make_thuman_person(c, join(root, "person"), &a);
    size_t live = mem_live();
    long n = 0;
    for (bool done = false; !done; n++) {
        sherf_dataset *d = NULL;
        data_view *v = NULL;
        mem_fail_after(n);
        sherf_status status = sherf_dataset_open(c, root, &d);
        if (!status) status = dataset_view(c, d, 0, 1, 1, 20, &v);
        mem_fail_after(-1);
        done = status == SHERF_OK;
        if (!done) {
            assert_int_equal(status, SHERF_NO_MEMORY);
            assert_null(v);
        }
        sherf_observation_free(v);
        sherf_dataset_free(d);
        assert_true(mem_live() == live);
    }
    assert_true(n > 30);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(thuman_is_read),
        cmocka_unit_test(other_names_are_read),
        cmocka_unit_test(unlisted_pictures_are_found),
        cmocka_unit_test(distortion_is_taken_out),
        cmocka_unit_test(zju_is_read),
        cmocka_unit_test(renderpeople_is_read),
        cmocka_unit_test(humman_is_read),
        cmocka_unit_test(hummans_test_list),
        cmocka_unit_test(half_a_split),
        cmocka_unit_test(the_papers_splits),
        cmocka_unit_test(broken_sets_are_refused),
        cmocka_unit_test(poses_are_whole),
        cmocka_unit_test(threads_share_a_set),
        cmocka_unit_test(memory_runs_out),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
