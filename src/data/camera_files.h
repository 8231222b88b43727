/* camera_files: cameras that other tools write into several files, as one document. */
#ifndef SHERF_DATA_CAMERA_FILES_H
#define SHERF_DATA_CAMERA_FILES_H

#include "data/parse.h"
#include "io/build.h"

/* Any file of cameras; EasyMocap's and COLMAP's by either of their two files, or the folder, as
 * {"cameras": [...]} with OpenCV's axes. Messages name the file. */
sherf_status camera_document_read(context *c, const char *path, document **out);
/* COLMAP's text model (colmap.c): a camera for each image, in the order of the file. */
sherf_status colmap_read(context *c, const char *cameras, const char *images, document **out);
#endif
