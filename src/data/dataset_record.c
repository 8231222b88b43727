/* What the two families of layouts say about a person: annots.npy (THuman, ZJU-MoCap) and cameras.json
 * (RenderPeople, HuMMan). */
#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "data/dataset.h"

void record_free(person_record *r) {
    if (!r) return;
    for (int64_t i = 0; r->image && i < (int64_t)r->poses * r->views; i++) mem_free(r->image[i]);
    mem_free(r->image);
    mem_free(r->camera);
    mem_free(r->number);
    mem_free(r->pose);
    mem_free(r->present);
    mem_free(r);
}

/* A one-element list or 0-d object array stands for its element. */
static const value *unwrapped(const value *v) {
    while (v && v->kind == VALUE_LIST && v->list.count == 1) v = v->list.item[0];
    return v;
}

/* ---- annots.npy ---- */

static sherf_status annots_cameras(context *c, data_kind kind, const value *cams, person_record *r) {
    const value *K = value_get(cams, "K"), *D = value_get(cams, "D"), *R = value_get(cams, "R"),
                *T = value_get(cams, "T");
    int64_t views = parse_rows(K);
    if (!K || !R || !T || views < 1 || views > DATASET_VIEWS_MAX || parse_rows(R) != views ||
        parse_rows(T) != views || (D && parse_rows(D) != views))
        return failure(c, SHERF_BAD_FILE, "cams: K, R, T (and D) should have one entry a view");
    r->camera = mem_zero(c, (size_t)views, sizeof *r->camera);
    if (!r->camera) return SHERF_NO_MEMORY;
    r->views = (int)views;
    double unit = kind == DATA_ZJU ? 1e-3 : 1; /* ZJU-MoCap's T is in millimetres */
    for (int v = 0; v < r->views; v++) {
        parsed_camera *camera = &r->camera[v];
        sherf_status status = parse_row(c, K, (size_t)v, "K", 9, camera->K);
        if (!status) status = parse_row(c, R, (size_t)v, "R", 9, camera->R);
        if (!status) status = parse_row(c, T, (size_t)v, "T", 3, camera->T);
        if (!status && D) status = parse_row(c, D, (size_t)v, "D", 5, camera->D);
        for (int i = 0; i < 3; i++) camera->T[i] *= unit;
        if (!status) status = parsed_camera_check(c, camera);
        if (status) return failure_prefix(c, status, "view %d", v);
    }
    return SHERF_OK;
}

/* The pose's number: of 000012.jpg 12; of names by camera (CoreView_313, 315) the fifth "_" field. */
static sherf_status file_number(context *c, const char *path, int *out) {
    const char *name = strrchr(path, '/');
    name = name ? name + 1 : path;
    const char *field = name;
    size_t digits = strspn(field, "0123456789");
    if (!digits || (field[digits] != '.' && field[digits])) {
        for (int i = 0; i < 4 && field; i++) {
            field = strchr(field, '_');
            if (field) field++;
        }
        digits = field ? strspn(field, "0123456789") : 0;
    }
    if (!digits || digits > 9) return failure(c, SHERF_BAD_FILE, "%s: no frame number in the name", path);
    *out = (int)strtol(field, NULL, 10);
    return SHERF_OK;
}

static sherf_status annots_pose(context *c, const value *ims, int pose, person_record *r) {
    sherf_status status;
    const value *views = value_get(ims, "ims");
    bool numbered = false;
    for (int v = 0; v < r->views && (size_t)v < value_count(views); v++) {
        const value *name = value_at(views, (size_t)v);
        if (!name || name->kind != VALUE_STRING)
            return failure(c, SHERF_BAD_FILE, "ims[%d]: view %d is no file name", pose, v);
        char *path = mem_string(c, name->string.text);
        if (!path) return SHERF_NO_MEMORY;
        r->image[(int64_t)pose * r->views + v] = path;
        for (char *p = path; *p; p++)
            if (*p == '\\') *p = '/';
        if ((status = path_inside(c, path))) return status;
        if (!numbered && (status = file_number(c, path, &r->number[pose]))) return status;
        numbered = true;
    }
    if (!numbered) return failure(c, SHERF_BAD_FILE, "ims[%d]: no pictures", pose);
    return SHERF_OK;
}

sherf_status record_read_annots(context *c, data_kind kind, const char *folder, person_record *r) {
    char path[PATH_LENGTH];
    document *d = NULL;
    sherf_status status = path_join(c, path, sizeof path, folder, "annots.npy");
    if (status || (status = parse_file(c, path, &d, NULL))) return status;
    const value *root = unwrapped(d->root), *ims = value_get(root, "ims");
    size_t poses = value_count(ims);
    if (!value_get(root, "cams") || !poses || poses > DATASET_POSES_MAX)
        status = failure(c, SHERF_BAD_FILE, "expected a dict of cams and ims");
    else
        status = annots_cameras(c, kind, value_get(root, "cams"), r);
    if (!status) {
        r->number = mem_zero(c, poses, sizeof *r->number);
        r->image = mem_zero(c, poses * (size_t)r->views, sizeof *r->image);
        if (!r->number || !r->image) {
            status = SHERF_NO_MEMORY;
            goto done;
        }
        r->poses = (int)poses;
        for (int p = 0; p < r->poses && !status; p++) status = annots_pose(c, value_at(ims, (size_t)p), p, r);
    }
done:
    if (status) failure_prefix(c, status, "%s", path);
    document_free(d);
    return status;
}

/* ---- cameras.json ---- */

/* Views are the keys camera0000, camera0001, ... (kinect_color_000, ...) up to the first gap. */
static sherf_status json_cameras(context *c, data_kind kind, const value *root, person_record *r) {
    const char *format = kind == DATA_HUMMAN ? "kinect_color_%03d" : "camera%04d";
    char key[32];
    int views = 0;
    while (views < DATASET_VIEWS_MAX) {
        snprintf(key, sizeof key, format, views);
        if (!value_get(root, key)) break;
        views++;
    }
    if (!views) return failure(c, SHERF_BAD_FILE, "no camera %s", key);
    r->camera = mem_zero(c, (size_t)views, sizeof *r->camera);
    if (!r->camera) return SHERF_NO_MEMORY;
    r->views = views;
    for (int v = 0; v < views; v++) {
        snprintf(key, sizeof key, format, v);
        sherf_status status = parse_camera(c, value_get(root, key), &r->camera[v]);
        if (status) return failure_prefix(c, status, "%s", key);
    }
    return SHERF_OK;
}

/* One file for all poses: {betas (1,10), global_orient (P,3), body_pose (P,69), transl (P,3)}. */
static sherf_status renderpeople_poses(context *c, const char *folder, person_record *r) {
    char path[PATH_LENGTH];
    document *d = NULL;
    sherf_status status = path_join(c, path, sizeof path, folder, "outputs_re_fitting/refit_smpl_2nd.npz");
    if (status || (status = parse_file(c, path, &d, NULL))) return status;
    const value *smpl = unwrapped(value_get(d->root, "smpl"));
    const value *root = value_get(smpl, "global_orient"), *body = value_get(smpl, "body_pose"),
                *transl = value_get(smpl, "transl"), *betas = value_get(smpl, "betas");
    int64_t poses = parse_rows(root);
    double joint[69], t[3], orient[3];
    float shapes[10];
    if (!root || !body || !transl || !betas || poses < 1 || poses > DATASET_POSES_MAX ||
        parse_rows(body) != poses || parse_rows(transl) != poses) {
        status = failure(c, SHERF_BAD_FILE,
                         "smpl: betas, and global_orient, body_pose, transl with one row a pose are needed");
        goto done;
    }
    r->pose = mem_zero(c, (size_t)poses, sizeof *r->pose);
    if (!r->pose) {
        status = SHERF_NO_MEMORY;
        goto done;
    }
    r->poses = (int)poses;
    status = parse_prefix(c, betas, "betas", BODY_SHAPES, shapes);
    bool betas_by_pose = poses > 1 && value_numbers(betas) == poses * BODY_SHAPES;
    for (int p = 0; p < r->poses && !status; p++) {
        sherf_pose *pose = &r->pose[p];
        double own[10];
        sherf_pose_identity(pose);
        memcpy(pose->shapes, shapes, sizeof shapes);
        status = parse_row(c, root, (size_t)p, "global_orient", 3, orient);
        if (!status) status = parse_row(c, body, (size_t)p, "body_pose", 69, joint);
        if (!status) status = parse_row(c, transl, (size_t)p, "transl", 3, t);
        if (!status && betas_by_pose) status = parse_row(c, betas, (size_t)p, "betas", 10, own);
        if (status) break;
        for (int i = 0; i < 3; i++) pose->poses_rad[i] = (float)orient[i], pose->Th_m[i] = (float)t[i];
        for (int i = 0; i < 69; i++) pose->poses_rad[3 + i] = (float)joint[i];
        for (int i = 0; i < 10 && betas_by_pose; i++) pose->shapes[i] = (float)own[i];
    }
done:
    if (status) failure_prefix(c, status, "%s", path);
    document_free(d);
    return status;
}

/* The frame's number in 000012.npz, or -1. */
static int humman_number(const char *name) {
    size_t digits = strspn(name, "0123456789");
    if (digits != 6 || strcmp(name + digits, ".npz") != 0) return -1;
    return (int)strtol(name, NULL, 10);
}

/* Poses are the numbers of the files in smpl_params; releases that keep every sixth frame have gaps. */
static sherf_status humman_poses(context *c, const char *folder, person_record *r) {
    char path[PATH_LENGTH];
    sherf_status status = path_join(c, path, sizeof path, folder, "smpl_params");
    if (status) return status;
    for (int pass = 0; pass < 2; pass++) {
        DIR *dir = opendir(path);
        if (!dir) return failure(c, SHERF_NO_FILE, "%s: cannot be opened", path);
        for (struct dirent *e; (e = readdir(dir));) {
            int n = humman_number(e->d_name);
            if (n < 0) continue;
            if (pass && n < r->poses)
                r->present[n] = true;
            else if (!pass && n + 1 > r->poses)
                r->poses = n + 1;
        }
        closedir(dir);
        if (!r->poses) return failure(c, SHERF_BAD_FILE, "%s: no files like 000000.npz", path);
        if (!pass && !(r->present = mem_zero(c, (size_t)r->poses, sizeof *r->present)))
            return SHERF_NO_MEMORY;
    }
    return SHERF_OK;
}

sherf_status record_read_cameras_json(context *c, data_kind kind, const char *folder, person_record *r) {
    char path[PATH_LENGTH];
    document *d = NULL;
    sherf_status status = path_join(c, path, sizeof path, folder, "cameras.json");
    if (status || (status = json_read(c, path, &d))) return status;
    status = json_cameras(c, kind, d->root, r);
    if (status) failure_prefix(c, status, "%s", path);
    document_free(d);
    if (status) return status;
    return kind == DATA_HUMMAN ? humman_poses(c, folder, r) : renderpeople_poses(c, folder, r);
}
