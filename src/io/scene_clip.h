/* scene_clip: a skeleton's animation in a scene file (FBX, GLB), read through assimp in the form of a BVH. */
#ifndef SHERF_SCENE_CLIP_H
#define SHERF_SCENE_CLIP_H

#include "io/bvh.h"

/* "FBX" or "GLB" by the first bytes; NULL: neither. */
const char *scene_clip_kind(const unsigned char *data, size_t bytes);
/* The animation with the most joints, sampled at its keys' rate. Joints are the scene's nodes; the rest pose
 * is the skin's bind pose, or else the nodes' own. Free it with bvh_free. SHERF_UNSUPPORTED in a build
 * without assimp. Assimp reads the file, with its own level of care. */
sherf_status scene_clip_read(context *c, const char *path, bvh **out);

#endif
