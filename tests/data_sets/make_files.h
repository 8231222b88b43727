/* Small files for the tests of data sets and observations. */
#ifndef TEST_MAKE_FILES_H
#define TEST_MAKE_FILES_H
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <zip.h>

#include "base/path.h"
#include "data/data.h"
#include "data/pickle_write.h"
#include "support.h"

enum { MADE_WIDTH = 40, MADE_HEIGHT = 30 };

static inline const char *join(const char *folder, const char *name) {
    static char path[8][PATH_LENGTH];
    static int next;
    char made[PATH_LENGTH]; /* `folder` may be an earlier result in the same storage */
    snprintf(made, sizeof made, "%.2000s/%.2000s", folder, name);
    next = (next + 1) % 8;
    return memcpy(path[next], made, sizeof made);
}

static inline void make_parent(context *c, const char *path) {
    char folder[PATH_LENGTH];
    snprintf(folder, sizeof folder, "%s", path);
    *strrchr(folder, '/') = 0;
    assert_ok(c, folder_make(c, folder));
}

static inline void make_text(context *c, const char *path, const char *text) {
    make_parent(c, path);
    FILE *f = fopen(path, "wb");
    assert_non_null(f);
    fputs(text, f);
    fclose(f);
}

/* The value of channel k at (x, y) of the picture with number `seed`. */
static inline uint8_t made_color(int seed, int x, int y, int k) {
    return (uint8_t)(30 + 200 * random_uniform(random_key(5, "made", (uint64_t)seed),
                                               (uint64_t)((y * 1000 + x) * 3 + k)));
}

/* The person: a rectangle with a hole of one pixel in its middle. */
static inline bool made_person(int x, int y) {
    return x >= 12 && x < 28 && y >= 5 && y < 25 && !(x == 20 && y == 15);
}

static inline void make_picture(context *c, const char *path, int seed, int width, int height) {
    make_parent(c, path);
    uint8_t *rgb = mem_alloc(c, (size_t)width * height, 3);
    assert_non_null(rgb);
    for (int i = 0; i < width * height * 3; i++)
        rgb[i] = made_color(seed, i / 3 % width, i / 3 / width, i % 3);
    if (path_ends(path, ".jpg"))
        assert_ok(c, jpeg_write(c, path, width, height, rgb, 95));
    else
        assert_ok(c, png_write(c, path, width, height, 3, rgb));
    mem_free(rgb);
}

/* The mask's values: outside and person. */
static inline void make_mask(context *c, const char *path, int width, int height, int outside, int person) {
    make_parent(c, path);
    uint8_t *mask = mem_alloc(c, (size_t)width * height, 1);
    assert_non_null(mask);
    for (int i = 0; i < width * height; i++)
        mask[i] = (uint8_t)(made_person(i % width, i / width) ? person : outside);
    assert_ok(c, png_write(c, path, width, height, 1, mask));
    mem_free(mask);
}

/* A rotation about y, row-major. */
static inline void made_rotation(double angle, double R[9]) {
    double turn[9] = {cos(angle), 0, sin(angle), 0, 1, 0, -sin(angle), 0, cos(angle)};
    memcpy(R, turn, sizeof turn);
}

static inline void pickle_key_doubles(pickle_writer *w, const char *key, int rows, int columns,
                                      const double *v) {
    int dim[2] = {rows, columns};
    pickle_string(w, key);
    pickle_doubles(w, 2, dim, v);
}

typedef struct {
    int poses, views;
    double unit; /* unit of T: 1 or 1000 */
    double D[5];
    double K0;            /* K[0][0]; 0: 50 */
    double R0;            /* R[0][0] of view 1; 0: unchanged */
    const char *image[8]; /* by pose * views + view */
    int views_listed;     /* views of the last pose; 0: all */
} made_annots;

static inline void make_annots(context *c, const char *path, const made_annots *a) {
    static const int square[] = {3, 3}, column[] = {3, 1}, five[] = {5, 1};
    pickle_writer w;
    make_parent(c, path);
    pickle_begin(&w, c);
    pickle_dict_open(&w);
    pickle_string(&w, "cams");
    pickle_dict_open(&w);
    for (const char *what = "KDRT"; *what; what++) {
        char name[2] = {*what, 0};
        pickle_string(&w, name);
        pickle_list_open(&w);
        for (int v = 0; v < a->views; v++) {
            double K[9] = {a->K0 != 0 ? a->K0 : 50, 0, 20, 0, 55, 15, 0, 0, 1}, R[9];
            double T[3] = {0.1 * a->unit, -0.2 * a->unit, (2 + v) * a->unit};
            made_rotation(0.3 * v, R);
            if (v == 1 && a->R0 != 0) R[0] = a->R0;
            if (*what == 'K') pickle_doubles(&w, 2, square, K);
            if (*what == 'D') pickle_doubles(&w, 2, five, a->D);
            if (*what == 'R') pickle_doubles(&w, 2, square, R);
            if (*what == 'T') pickle_doubles(&w, 2, column, T);
        }
        pickle_list_close(&w);
    }
    pickle_dict_close(&w);
    pickle_string(&w, "ims");
    pickle_list_open(&w);
    for (int p = 0; p < a->poses; p++) {
        pickle_dict_open(&w);
        pickle_string(&w, "ims");
        pickle_list_open(&w);
        int listed = a->views_listed && p == a->poses - 1 ? a->views_listed : a->views;
        for (int v = 0; v < listed; v++) pickle_string(&w, a->image[p * a->views + v]);
        pickle_list_close(&w);
        pickle_dict_close(&w);
    }
    pickle_list_close(&w);
    pickle_dict_close(&w);
    assert_ok(c, pickle_finish_npy(&w, path));
}

/* The pose with number `seed`: root 0, global rotation as axis-angle. */
static inline void made_pose(int seed, double poses[72], double shapes[10], double Rh[3], double Th[3]) {
    uint64_t key = random_key(9, "pose", (uint64_t)seed);
    for (uint64_t i = 0; i < 72; i++) poses[i] = i < 3 ? 0 : 0.4 * random_uniform(key, i) - 0.2;
    for (uint64_t i = 0; i < 10; i++) shapes[i] = random_uniform(key, 100 + i) - 0.5;
    for (uint64_t i = 0; i < 3; i++) {
        Rh[i] = random_uniform(key, 200 + i) - 0.5;
        Th[i] = random_uniform(key, 300 + i) - 0.5;
    }
}

/* with_Rh: ZJU-MoCap's form, otherwise THuman's form with R. The key `without` is left out (NULL: none). */
static inline void make_parameters_without(context *c, const char *path, int seed, bool with_Rh,
                                           const char *without) {
    double poses[72], shapes[10], Rh[3], Th[3];
    pickle_writer w;
    make_parent(c, path);
    made_pose(seed, poses, shapes, Rh, Th);
    float turn[3] = {(float)Rh[0], (float)Rh[1], (float)Rh[2]}, R[9];
    rodrigues(turn, R);
    double wide[9];
    for (int i = 0; i < 9; i++) wide[i] = R[i];
    pickle_begin(&w, c);
    pickle_dict_open(&w);
    const struct {
        const char *key;
        int rows, columns;
        const double *v;
    } all[] = {{"poses", with_Rh ? 1 : 72, with_Rh ? 72 : 1, poses},
               {"shapes", 1, 10, shapes},
               {with_Rh ? "Rh" : "R", with_Rh ? 1 : 3, 3, with_Rh ? Rh : wide},
               {"Th", 1, 3, Th}};
    for (size_t i = 0; i < COUNT_OF(all); i++)
        if (!without || strcmp(all[i].key, without) != 0)
            pickle_key_doubles(&w, all[i].key, all[i].rows, all[i].columns, all[i].v);
    pickle_dict_close(&w);
    assert_ok(c, pickle_finish_npy(&w, path));
}

static inline void make_parameters(context *c, const char *path, int seed, bool with_Rh) {
    make_parameters_without(c, path, seed, with_Rh, NULL);
}

/* Makes an npz from existing files. */
static inline void make_zip(const char *path, int count, const char *const *names, const char *const *files) {
    int error;
    zip_t *z = zip_open(path, ZIP_CREATE | ZIP_TRUNCATE, &error);
    assert_non_null(z);
    for (int i = 0; i < count; i++) {
        zip_source_t *s = zip_source_file(z, files[i], 0, -1);
        assert_non_null(s);
        assert_true(zip_file_add(z, names[i], s, ZIP_FL_OVERWRITE) >= 0);
    }
    assert_int_equal(zip_close(z), 0);
}

/* A camera in the form of cameras.json. */
static inline int made_camera_json(char *out, size_t size, const char *name, int view) {
    double R[9];
    made_rotation(0.3 * view, R);
    return snprintf(out, size,
                    "%s\"%s\": {\"K\": [[50, 0, 20], [0, 55, 15], [0, 0, 1]], \"R\": [[%.9f, %.9f, %.9f], "
                    "[%.9f, %.9f, %.9f], [%.9f, %.9f, %.9f]], \"T\": [0.1, -0.2, %d]}",
                    view ? ", " : "", name, R[0], R[1], R[2], R[3], R[4], R[5], R[6], R[7], R[8], 2 + view);
}
#endif
