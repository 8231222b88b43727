/* A person written in the layout of THuman. */
#include "data/thuman_write.h"

#include <stdio.h>
#include <sys/stat.h>

#include "data/pickle_write.h"

sherf_status thuman_path(context *c, char out[PATH_LENGTH], const char *folder, const char *name) {
    int n = snprintf(out, PATH_LENGTH, "%s/%s", folder, name);
    if (n > 0 && n < PATH_LENGTH) return SHERF_OK;
    return failure(c, SHERF_BAD_ARGUMENT, "%.200s: path too long", folder);
}

sherf_status thuman_picture_path(context *c, char out[PATH_LENGTH], const char *folder, const char *kind,
                                 int view, int pose, const char *suffix) {
    char name[128];
    snprintf(name, sizeof name, "%.40sview%02d/%06d%.10s", kind, view, pose, suffix);
    return thuman_path(c, out, folder, name);
}

sherf_status thuman_make_folders(context *c, const char *folder, int views, const char *const *kinds) {
    char name[64], path[PATH_LENGTH];
    sherf_status status = thuman_path(c, path, folder, "new_params_neutral");
    if (!status) status = folder_make(c, path);
    if (!status) status = thuman_path(c, path, folder, "new_vertices");
    if (!status) status = folder_make(c, path);
    for (; *kinds && !status; kinds++)
        for (int v = 0; v < views && !status; v++) {
            snprintf(name, sizeof name, "%.40sview%02d", *kinds, v);
            status = thuman_path(c, path, folder, name);
            if (!status) status = folder_make(c, path);
        }
    return status;
}

sherf_status thuman_write_parameters(context *c, const char *folder, int pose, const sherf_pose *body_pose) {
    static const int poses_dim[] = {72, 1}, shapes_dim[] = {10}, R_dim[] = {3, 3}, Th_dim[] = {1, 3};
    char name[64], path[PATH_LENGTH];
    pickle_writer w;
    snprintf(name, sizeof name, "new_params_neutral/%d.npy", pose);
    sherf_status status = thuman_path(c, path, folder, name);
    if (status) return status;
    pickle_begin(&w, c);
    pickle_dict_open(&w);
    pickle_string(&w, "poses");
    pickle_floats(&w, 2, poses_dim, body_pose->poses_rad);
    pickle_string(&w, "shapes");
    pickle_floats(&w, 1, shapes_dim, body_pose->shapes);
    pickle_string(&w, "R");
    pickle_floats(&w, 2, R_dim, body_pose->R);
    pickle_string(&w, "Th");
    pickle_floats(&w, 2, Th_dim, body_pose->Th_m);
    pickle_dict_close(&w);
    return pickle_finish_npy(&w, path);
}

sherf_status thuman_write_vertices(context *c, const char *folder, int pose, int vertices,
                                   const float *vertices_world) {
    char name[64], path[PATH_LENGTH];
    const int64_t dim[2] = {vertices, 3};
    snprintf(name, sizeof name, "new_vertices/%d.npy", pose);
    sherf_status status = thuman_path(c, path, folder, name);
    return status ? status : npy_write_f32(c, path, 2, dim, vertices_world);
}

static void write_camera_list(pickle_writer *w, int views, const sherf_camera *cameras, char what) {
    static const int square[] = {3, 3}, column[] = {3, 1}, five[] = {5, 1};
    char name[2] = {what, 0};
    pickle_string(w, name);
    pickle_list_open(w);
    for (int v = 0; v < views; v++) {
        const sherf_camera *camera = &cameras[v];
        double number[9] = {0};
        for (int i = 0; i < 9; i++) number[i] = what == 'K' ? camera->K[i] : what == 'R' ? camera->R[i] : 0;
        for (int i = 0; i < 3 && what == 'T'; i++) number[i] = camera->T_m[i];
        pickle_doubles(w, 2, what == 'T' ? column : what == 'D' ? five : square, number);
    }
    pickle_list_close(w);
}

sherf_status thuman_write_annots(context *c, const char *folder, int poses, int views,
                                 const sherf_camera *camera) {
    char name[64], path[PATH_LENGTH];
    pickle_writer w;
    sherf_status status = thuman_path(c, path, folder, "annots.npy");
    if (status) return status;
    pickle_begin(&w, c);
    pickle_dict_open(&w);
    pickle_string(&w, "cams");
    pickle_dict_open(&w);
    for (const char *what = "KDRT"; *what; what++) write_camera_list(&w, views, camera, *what);
    pickle_dict_close(&w);
    pickle_string(&w, "ims");
    pickle_list_open(&w);
    for (int p = 0; p < poses; p++) {
        pickle_dict_open(&w);
        pickle_string(&w, "ims");
        pickle_list_open(&w);
        for (int v = 0; v < views; v++) {
            snprintf(name, sizeof name, "view%02d/%06d.png", v, p);
            pickle_string(&w, name);
        }
        pickle_list_close(&w);
        pickle_dict_close(&w);
    }
    pickle_list_close(&w);
    pickle_dict_close(&w);
    return pickle_finish_npy(&w, path);
}

sherf_status thuman_write_picture(context *c, const char *folder, int view, int pose, int width, int height,
                                  const uint8_t *rgb, const uint8_t *mask) {
    char path[PATH_LENGTH];
    sherf_status status = thuman_picture_path(c, path, folder, "", view, pose, ".png");
    if (!status) status = png_write(c, path, width, height, 3, rgb);
    if (!status) status = thuman_picture_path(c, path, folder, "mask_cihp/", view, pose, ".png");
    return status ? status : png_write(c, path, width, height, 1, mask);
}
