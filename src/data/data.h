/* data: body files, observations, data sets, and images as the protocol requires them. */
#ifndef SHERF_DATA_H
#define SHERF_DATA_H

#include "body/body.h"
#include "io/value.h"
#include "io/safetensors.h"
#include "io/image.h"
#include "scene/scene.h"

/* ---- body files ---- */
sherf_status body_load(context *c, const char *path, body_model **out); /* = sherf_body_load */
bool document_is_body(const document *d);
/* Tensors v_template, shapedirs, posedirs (V,3,207) or pose_volume (24) or both or none, weights,
 * J_regressor, f, kintree_table; metadata format=sherf-body. */
sherf_status body_save(context *c, const body_model *body, const char *path);

/* ---- pictures ---- */
enum { DISTORTION_MAX = 14 };
/* As OpenCV's undistort with the same camera matrix: bilinear, border 0. D: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3
 * s4 tx ty. Bit for bit (masks are bytes, pictures floats, as the data sets' loaders have them). */
sherf_status image_undistort(context *c, image_u8 *image, const double K[9], const double D[DISTORTION_MAX]);
sherf_status image_undistort_f32(context *c, sherf_image *image, const double K[9],
                                 const double D[DISTORTION_MAX]);
/* cv::resize INTER_AREA (shrinking) to width x height; INTER_LINEAR when growing. nearest: INTER_NEAREST
 * (masks). */
sherf_status image_resize_area(context *c, sherf_image *image, int width, int height);
sherf_status image_resize_nearest(context *c, image_u8 *image, int width, int height);

/* ---- observation ---- */
struct sherf_observation {
    sherf_image image; /* RGB, black outside the mask */
    uint8_t *mask;     /* H x W: 0 or 1 */
    /* H x W: 1 where the mask's edge is uncertain (ZJU-MoCap: left out of losses; the picture is kept there,
     * and mask is 0); NULL: none */
    uint8_t *unknown;
    sherf_camera camera;
    sherf_pose pose;
    sherf_image fine; /* the same picture with more pixels, where it was scaled down; or no data */
};
/* The view of a target to be compared with: the same struct. */
typedef struct sherf_observation data_view;
/* Scales a size down to VIEW_OBSERVED_SIDE_MAX, and logs it. */
void observation_limit_size(context *c, const char *what, int *width, int *height);
/* Checks that a mask of `total` pixels shows some of the person but not only the person (`uncertain` pixels
 * may belong to it). */
sherf_status observation_check_shares(context *c, size_t person, size_t uncertain, size_t total);
sherf_status observation_check_mask(context *c, const sherf_observation *o); /* neither empty nor full */
sherf_status observation_check(context *c,
                               const sherf_observation *o); /* finite, sizes, mask not empty or full */
/* Picture, mask and K of an observation without `unknown` and `fine`, as pictures from files are resized. */
sherf_status observation_resize(context *c, sherf_observation *o, int width, int height);

/* SHERF_MISMATCH when no vertex of the posed body falls into the picture, or none into its mask. */
sherf_status observation_check_body(context *c, const sherf_observation *o, const body_model *body);

/* ---- data sets ---- */
typedef struct {
    const char *name;                                     /* of the data set, as in thuman:PATH */
    int train_first, train_count, test_first, test_count; /* lines of human_list.txt; -1: named lists */
    int train_poses, train_pose_step, views;
    int view_step; /* targets in tests: every second view, HuMMan every view */
    int observation_views[3];
    int pose_first, pose_step, pose_count; /* tests */
    int observation_pose;                  /* of novel pose */
    int front_view;
    double image_scale;
} data_protocol;
const data_protocol *dataset_protocol(const sherf_dataset *d);
/* The view that sees a person from the front: the protocol's, or, where the person has fewer views, the one
 * as far round the ring of cameras. Made people of any number of views are seen from the front there. */
int protocol_front(const data_protocol *p, int views);
/* All of these may be called from several contexts at once on one data set. HuMMan's poses are the numbers in
 * its files' names, so a pose below sherf_dataset_pose_count may be missing. */
/* Views of one person at the protocol's scale; width 0: the protocol's size, otherwise scaled (K too) to this
 * width. */
sherf_status dataset_view(context *c, const sherf_dataset *d, int person, int pose, int view, int width,
                          data_view **out);
/* Its picture alone, with the background. sherf_image_free it. */
sherf_status dataset_photo(context *c, const sherf_dataset *d, int person, int pose, int view, int width,
                           sherf_image *out);
/* As dataset_view, for training: fails with the mask's file name where the mask is empty or covers the whole
 * picture. */
sherf_status dataset_person_view(context *c, const sherf_dataset *d, int person, int pose, int view,
                                 int width, data_view **out);
/* Of a view that was read with these numbers. */
sherf_status dataset_view_check_mask(context *c, const sherf_dataset *d, int person, int pose, int view,
                                     const data_view *v);
/* Of the mask's file alone: cheaper than to read the picture. */
sherf_status dataset_mask_check(context *c, const sherf_dataset *d, int person, int pose, int view);
/* Warns in one line where the body, from the file `name`, is not the one that the poses were fitted with: its
 * number of vertices is not the stored ones', or it covers little of some of these people's masks. */
void dataset_body_warn(context *c, const sherf_dataset *d, const body_model *body, const char *name,
                       const int *person, int people);
/* As dataset_person_view, and checks that it can be observed (observation_check). */
sherf_status dataset_observation(context *c, const sherf_dataset *d, int person, int pose, int view,
                                 int width, sherf_observation **out);
/* Reads only pose and shape, not the picture. */
sherf_status dataset_pose(context *c, const sherf_dataset *d, int person, int pose, sherf_pose *out);
sherf_status dataset_camera(context *c, const sherf_dataset *d, int person, int view, sherf_camera *out);
/* People by names or list lines ("a,b" or "90-99"); NULL: the paper's split. *indices is mem_free'd. */
sherf_status dataset_people(context *c, const sherf_dataset *d, const char *names, bool training,
                            int **indices, int *count);

#endif
