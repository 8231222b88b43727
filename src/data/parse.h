/* Reads cameras, poses and body arrays from the values in files. Messages name the key; the caller prefixes
 * the file. */
#ifndef SHERF_DATA_PARSE_H
#define SHERF_DATA_PARSE_H

#include "data/data.h"
#include "data/parts.h"

/* Element i of a list, or of an array along its first axis, looked at in place; 0 <= i < parse_rows. */
value parse_row_of(const value *v, size_t i);
/* The same as exactly `count` numbers. */
sherf_status parse_row(context *c, const value *v, size_t i, const char *what, size_t count, double *out);
/* Elements along the first axis of a list or array; -1 when it is neither. */
int64_t parse_rows(const value *v);
/* 1 to any number of values, of which the first `max` are kept; the others are 0. */
sherf_status parse_prefix(context *c, const value *v, const char *what, int max, float *out);
/* 3 (axis-angle) or 9 (matrix) numbers to a checked rotation matrix. */
sherf_status parse_rotation(context *c, const value *v, const char *what, float R[9]);
sherf_status rotation_check(context *c, const float R[9], const char *what);
/* Fails where a body's rotations are too large on average to be radians: `squares` is the sum of their
 * squared lengths, over `count` of them. A root alone may be wound up. */
sherf_status radians_check(context *c, const char *what, bool root, double squares, int64_t count);
/* Fails where the last axis is that of the joints, and not of a joint's numbers. */
sherf_status joints_last_check(context *c, const char *what, const value *v, int joints);

/* One body under the names of parts.h. A camera in the body's file (camera_rotation, cam_t, ...) is included
 * in R and Th: the body is then in that camera's frame. */
sherf_status parse_pose(context *c, const value *v, sherf_pose *out);
sherf_status parse_parts(context *c, const body_parts *parts, sherf_pose *out); /* the dict has poses */

/* All bodies of a file (sherf_poses_load); *out is mem_free'd. same: the only one that the file calls `name`
 * (may be NULL); -1: none. */
sherf_status poses_named_read(context *c, const char *path, const char *name, sherf_pose **out, int *count,
                              int *same);

/* ---- cameras (parse_camera.c) ---- */
/* OpenCV's axes, world to camera. D: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty, zeros where there are none.
 */
typedef struct {
    double K[9], R[9], T[3], D[DISTORTION_MAX];
    int width, height;  /* of the picture it is for, where the file says so; else 0 */
    bool turned, moved; /* whether R and T were given; otherwise they are 1 and 0 */
    char name[128];     /* in the file, or of its picture; empty: there is none, or a longer one */
} parsed_camera;
void parsed_camera_name(parsed_camera *camera, const char *name);
/* shared: part of a file with lens and size for cameras that do not state their own; NULL: none. K or its
 * alternatives; R and T, or one matrix; D; width and height: under the names in docs/observation.md. size: of
 * the picture, used if focal lengths have no centre; NULL: K must be complete. */
sherf_status parse_camera(context *c, const value *v, const value *shared, const int size[2],
                          parsed_camera *out);
/* All of a file (sherf_cameras_load); *out is mem_free'd. size as above. */
sherf_status cameras_read(context *c, const char *path, const int size[2], parsed_camera **out, int *count);
/* 0 (or none), 4, 5, 8, 12 or 14 coefficients. */
sherf_status parse_distortion(context *c, const value *v, double D[DISTORTION_MAX]);
sherf_status parsed_camera_placed(context *c, const parsed_camera *camera); /* fails without R or T */
/* Finite, K with focal lengths and no zero determinant, R a rotation. */
sherf_status parsed_camera_check(context *c, const parsed_camera *camera);
/* Warns of a camera's keys that are not read, and, where `camera` is not NULL, of an R that it has without
 * T. */
void camera_warn(context *c, const value *v, const parsed_camera *camera, const char *what);
/* Whether a dict is a camera. */
bool camera_is(const value *v);
/* How many cameras a dict holds, in arrays with one more axis than one camera's (N x 3 x 3); 1: no such. */
int64_t camera_stack(const value *v);
/* Camera i of them. pair, item: room for as many as the dict has, used by the value. */
value camera_unstack(const value *v, int64_t count, int64_t i, value_pair *pair, value *item);
/* R, T and K (times the picture's scaling) as the engine wants them. */
void parsed_camera_to(const parsed_camera *in, int file_width, int file_height, int width, int height,
                      sherf_camera *out);

/* Reads any file's values; every message names the file. */
sherf_status parse_file(context *c, const char *path, document **out, const char **kind);
/* folder/name into `out`; fails when it is too long. */
sherf_status path_join(context *c, char *out, size_t size, const char *folder, const char *name);
/* No absolute path and no "..": paths inside files stay below the folder of the file. */
sherf_status path_inside(context *c, const char *relative);
#endif
