/* Writing a person in the layout of THuman (docs/datasets.md): viewVV/PPPPPP.png, masks below mask_cihp/,
 * annots.npy with cameras and lists, new_params_neutral/P.npy, new_vertices/P.npy. */
#ifndef SHERF_THUMAN_WRITE_H
#define SHERF_THUMAN_WRITE_H

#include "base/path.h"
#include "data/data.h"

/* folder/name; SHERF_BAD_ARGUMENT when it is too long. */
sherf_status thuman_path(context *c, char out[PATH_LENGTH], const char *folder, const char *name);
/* `kind` is "" for pictures, "mask_cihp/", or another folder with a slash behind it. */
sherf_status thuman_picture_path(context *c, char out[PATH_LENGTH], const char *folder, const char *kind,
                                 int view, int pose, const char *suffix);
/* The person's folder and those in it for `views` views of every kind; kinds ends with NULL. */
sherf_status thuman_make_folders(context *c, const char *folder, int views, const char *const *kinds);
sherf_status thuman_write_parameters(context *c, const char *folder, int pose, const sherf_pose *body_pose);
sherf_status thuman_write_vertices(context *c, const char *folder, int pose, int vertices,
                                   const float *vertices_world);
sherf_status thuman_write_annots(context *c, const char *folder, int poses, int views,
                                 const sherf_camera *camera);
/* Writes one mask and one picture. rgb is written unchanged; the caller makes it black outside the mask. */
sherf_status thuman_write_picture(context *c, const char *folder, int view, int pose, int width, int height,
                                  const uint8_t *rgb, const uint8_t *mask);

#endif
