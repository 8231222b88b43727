/* annots: the layout that THuman and ZJU-MoCap share: annots.npy (or annots_new.npy), pictures with masks
 * below mask_cihp/, mask/ or masks/, a file of parameters and one of vertices for each pose. */
#ifndef SHERF_DATA_ANNOTS_H
#define SHERF_DATA_ANNOTS_H

#include "data/dataset.h"

bool annots_are_in(const char *folder);
/* unit_m: metres of the unit that the cameras' T is in. */
sherf_status annots_read(context *c, const char *folder, double unit_m, person_record *r);
sherf_status annots_picture(context *c, const person_record *r, const char *folder, int pose, int view,
                            char image[PATH_LENGTH], char mask[PATH_LENGTH]);
/* kinds: folders of the parameters, up to NULL; the first that has the pose. */
sherf_status annots_pose_files(context *c, const person_record *r, const char *folder,
                               const char *const *kinds, int pose, char parameters[PATH_LENGTH],
                               char vertices[PATH_LENGTH]);

/* ---- annots_folders.c ---- */
/* Takes poses and pictures from the folders of views if there is no ims. r has its cameras. */
sherf_status annots_from_folders(context *c, const char *folder, person_record *r);
/* Finds a picture and its mask: with another ending (.jpg for .png), or below images/ if it is only there;
 * else at the usual place. */
sherf_status annots_image(context *c, const char *folder, const char *image, char out[PATH_LENGTH]);
sherf_status annots_mask(context *c, const char *folder, const char *image, char out[PATH_LENGTH]);

#endif
