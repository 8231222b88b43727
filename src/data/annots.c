/* annots.npy (THuman, ZJU-MoCap): a person's cameras, and the names of the pictures by pose and view. */
#include "data/annots.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* R and T of view v, or both in one matrix of 3 or 4 rows. */
static sherf_status annots_place(context *c, const value *R, const value *T, const value *RT, size_t v,
                                 parsed_camera *camera) {
    if (R && T) {
        sherf_status status = parse_row(c, R, v, "R", 9, camera->R);
        return status ? status : parse_row(c, T, v, "T", 3, camera->T);
    }
    double m[16];
    const value row = parse_row_of(RT, v);
    sherf_status status = value_doubles(c, &row, "RT", value_numbers(&row) == 16 ? 16 : 12, m);
    for (int i = 0; i < 12 && !status; i++)
        if (i % 4 < 3)
            camera->R[i / 4 * 3 + i % 4] = m[i];
        else
            camera->T[i / 4] = m[i];
    return status;
}

static sherf_status annots_cameras(context *c, double unit_m, const value *cams, person_record *r) {
    static const char *const matrices[] = {"RT", "extrinsic", "extrinsics", NULL};
    const value *K = value_get(cams, "K"), *D = value_get(cams, "D"), *R = value_get(cams, "R"),
                *T = value_get(cams, "T"), *RT = value_first(cams, matrices).item;
    const int64_t views = parse_rows(K);
    const bool apart = parse_rows(R) == views && parse_rows(T) == views;
    if (!K || views < 1 || views > DATASET_VIEWS_MAX || (!apart && parse_rows(RT) != views) ||
        (D && parse_rows(D) != views))
        return failure(c, SHERF_BAD_FILE, "cams: K, R, T (and D) should have one entry a view");
    r->camera = mem_zero(c, (size_t)views, sizeof *r->camera);
    if (!r->camera) return SHERF_NO_MEMORY;
    r->views = (int)views;
    for (int v = 0; v < r->views; v++) {
        parsed_camera *camera = &r->camera[v];
        sherf_status status = parse_row(c, K, (size_t)v, "K", 9, camera->K);
        if (!status) status = annots_place(c, apart ? R : NULL, apart ? T : NULL, RT, (size_t)v, camera);
        if (!status && D) {
            const value row = parse_row_of(D, (size_t)v);
            status = parse_distortion(c, &row, camera->D);
        }
        for (int i = 0; i < 3; i++) camera->T[i] *= unit_m;
        if (!status) status = parsed_camera_check(c, camera);
        if (status) return failure_prefix(c, status, "view %d", v);
    }
    return SHERF_OK;
}

/* The pose's number: 12 for 000012.jpg; for names by camera (CoreView_313, 315) the fifth "_" field. */
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

static sherf_status annots_listed(context *c, const value *ims, person_record *r) {
    const size_t poses = value_count(ims);
    if (poses > DATASET_POSES_MAX) return failure(c, SHERF_BAD_FILE, "ims: %zu are too many", poses);
    r->number = mem_zero(c, poses, sizeof *r->number);
    r->image = mem_zero(c, poses * (size_t)r->views, sizeof *r->image);
    if (!r->number || !r->image) return SHERF_NO_MEMORY;
    r->poses = (int)poses;
    sherf_status status = SHERF_OK;
    for (int p = 0; p < r->poses && !status; p++) status = annots_pose(c, value_at(ims, (size_t)p), p, r);
    return status;
}

/* annots.npy, or annots_new.npy of refined releases. */
static sherf_status annots_path(context *c, const char *folder, char out[PATH_LENGTH]) {
    char other[PATH_LENGTH];
    sherf_status status = path_join(c, out, PATH_LENGTH, folder, "annots.npy");
    if (status || path_is_file(out)) return status;
    status = path_join(c, other, sizeof other, folder, "annots_new.npy");
    if (!status && path_is_file(other)) memcpy(out, other, sizeof other);
    return status;
}

bool annots_are_in(const char *folder) {
    return path_has(folder, "annots.npy") || path_has(folder, "annots_new.npy");
}

sherf_status annots_read(context *c, const char *folder, double unit_m, person_record *r) {
    char path[PATH_LENGTH];
    document *d = NULL;
    sherf_status status = annots_path(c, folder, path);
    if (status || (status = parse_file(c, path, &d, NULL))) return status;
    const value *root = value_unwrapped(d->root), *ims = value_get(root, "ims");
    if (!value_get(root, "cams"))
        status = failure(c, SHERF_BAD_FILE, "expected a dict of cams and ims");
    else
        status = annots_cameras(c, unit_m, value_get(root, "cams"), r);
    if (!status) status = value_count(ims) ? annots_listed(c, ims, r) : annots_from_folders(c, folder, r);
    if (status) failure_prefix(c, status, "%s", path);
    document_free(d);
    return status;
}

sherf_status annots_picture(context *c, const person_record *r, const char *folder, int pose, int view,
                            char image[PATH_LENGTH], char mask[PATH_LENGTH]) {
    const char *relative = r->image[(int64_t)pose * r->views + view];
    if (!relative)
        return failure(c, SHERF_BAD_FILE, "%s: annots.npy lists no view %d of pose %d", folder, view, pose);
    sherf_status status = annots_image(c, folder, relative, image);
    return status ? status : annots_mask(c, folder, relative, mask);
}

sherf_status annots_pose_files(context *c, const person_record *r, const char *folder,
                               const char *const *kinds, int pose, char parameters[PATH_LENGTH],
                               char vertices[PATH_LENGTH]) {
    char name[64], other[PATH_LENGTH];
    snprintf(name, sizeof name, "new_vertices/%d.npy", r->number[pose]);
    sherf_status status = path_join(c, vertices, PATH_LENGTH, folder, name);
    for (int i = 0; kinds[i] && !status; i++) { /* the first one if none exists */
        snprintf(name, sizeof name, "%.32s/%d.npy", kinds[i], r->number[pose]);
        status = path_join(c, other, sizeof other, folder, name);
        if (!status && i && !path_is_file(other)) continue;
        if (!status) memcpy(parameters, other, sizeof other);
        if (!status && path_is_file(other)) break;
    }
    return status;
}
