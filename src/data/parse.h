/* Cameras, poses and body arrays out of the values that files hold. Messages name the key; the caller puts
 * the file before it. */
#ifndef SHERF_DATA_PARSE_H
#define SHERF_DATA_PARSE_H

#include "data/data.h"

/* A one-element list (a 0-d or 1-long object array) stands for its element. */
const value *parse_unwrapped(const value *v);
/* Element i of a list, or of an array along its first axis, as exactly `count` numbers. */
sherf_status parse_row(context *c, const value *v, size_t i, const char *what, size_t count, double *out);
/* Elements along the first axis of a list or array; -1 when it is neither. */
int64_t parse_rows(const value *v);
/* 1 to any number of values, of which the first `max` are kept; the others are 0. */
sherf_status parse_prefix(context *c, const value *v, const char *what, int max, float *out);
/* 3 (axis-angle) or 9 (matrix) numbers to a checked rotation matrix. */
sherf_status parse_rotation(context *c, const value *v, const char *what, float R[9]);
sherf_status rotation_check(context *c, const float R[9], const char *what);

/* {poses, shapes, R or Rh, Th} or {global_orient, body_pose, transl, betas}. */
sherf_status parse_pose(context *c, const value *v, sherf_pose *out);
/* The world-to-camera part and K: {K, R, T}; D (5 coefficients, zeros when there is none) may be NULL. */
typedef struct {
    double K[9], R[9], T[3], D[5];
} parsed_camera;
sherf_status parse_camera(context *c, const value *v, parsed_camera *out);
/* Finite, K with focal lengths and no zero determinant, R a rotation. */
sherf_status parsed_camera_check(context *c, const parsed_camera *camera);
/* R, T and K (times the picture's scaling) as the engine wants them. */
void parsed_camera_to(const parsed_camera *in, int file_width, int file_height, int width, int height,
                      sherf_camera *out);

/* A tree from any file with its name in every message. */
sherf_status parse_file(context *c, const char *path, document **out, const char **kind);
/* folder/name into `out`; fails when it is too long. */
sherf_status path_join(context *c, char *out, size_t size, const char *folder, const char *name);
/* No absolute path and no "..": paths inside files stay below the folder of the file. */
sherf_status path_inside(context *c, const char *relative);
#endif
