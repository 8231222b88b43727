/* annots: the layout that THuman and ZJU-MoCap share: annots.npy, pictures with masks below mask_cihp/ or
 * mask/, a file of parameters and one of vertices for each pose. */
#ifndef SHERF_DATA_ANNOTS_H
#define SHERF_DATA_ANNOTS_H

#include "data/dataset.h"

/* unit_m: metres of the unit that the cameras' T is in. */
sherf_status annots_read(context *c, const char *folder, double unit_m, person_record *r);
sherf_status annots_picture(context *c, const person_record *r, const char *folder, int pose, int view,
                            char image[PATH_LENGTH], char mask[PATH_LENGTH]);
/* kind: the folder of the parameters. */
sherf_status annots_pose_files(context *c, const person_record *r, const char *folder, const char *kind,
                               int pose, char parameters[PATH_LENGTH], char vertices[PATH_LENGTH]);

#endif
