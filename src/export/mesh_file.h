/* mesh_file: PLY, OBJ and splats. `axes` is a line that goes into the file. */
#ifndef SHERF_EXPORT_MESH_FILE_H
#define SHERF_EXPORT_MESH_FILE_H

#include "baked/atlas.h"
#include "baked/baked.h"
#include "baked/splats.h"

/* Binary, with normals and colours (V x 3) of the vertices. */
sherf_status ply_mesh_write(context *c, const char *path, const char *axes, const surface *s,
                            const float *rgb);
/* With an atlas and its picture (side x side x 3) as NAME.mtl and NAME.png beside it; without, with colours
 * behind the vertices. */
sherf_status obj_write(context *c, const char *path, const char *axes, const surface *s, const atlas *a,
                       const uint8_t *picture, const float *rgb);
/* As the viewers of 3D Gaussian splatting (Kerbl et al., 2023) expect it: logarithms of scales, logit of
 * opacity, colours as the constant spherical harmonic, rotation w x y z. */
sherf_status ply_splats_write(context *c, const char *path, const char *axes, const splats *s);

#endif
