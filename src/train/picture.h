/* picture: the averaged model's result for one draw: observation | target | prediction. */
#ifndef SHERF_PICTURE_H
#define SHERF_PICTURE_H

#include "train/loader.h"

sherf_status picture_write(context *c, const sherf_dataset *d, const model *m, const body_model *body,
                           draw drawn, int width, const char *path);

#endif
