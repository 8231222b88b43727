/* scene_clip: the animation of a skeleton in a scene file (FBX, GLB), through assimp, as if it were a BVH. */
#ifndef SHERF_SCENE_CLIP_H
#define SHERF_SCENE_CLIP_H

#include "io/bvh.h"

/* "FBX" or "GLB" by the first bytes; NULL: neither. */
const char *scene_clip_kind(const unsigned char *data, size_t bytes);
/* The animation of the most joints, sampled at its keys' rate: joints are the scene's nodes; the rest pose is
 * the one that the skin was bound in, or else the nodes' own. Freed by bvh_free. SHERF_UNSUPPORTED in a build
 * without assimp. Assimp reads the file, with its own care or lack of it. */
sherf_status scene_clip_read(context *c, const char *path, bvh **out);

#endif
