/* skin: weights of the surface's vertices, and the surface in other poses. */
#ifndef SHERF_SKIN_H
#define SHERF_SKIN_H

#include "body/body.h"

enum { SKIN_NEAR = 16 };

typedef struct {
    int64_t vertices;
    uint8_t *joint; /* V x 4, heaviest first; 0 where the weight is 0 */
    float *weight;  /* V x 4, sum 1 */
    int32_t *near;  /* V x SKIN_NEAR: body vertices whose offsets count, with their shares (sum 1) */
    float *share;
    float *rest; /* V x 3: the mean body's rest pose, before offsets of shape and pose */
} skin;
sherf_status skin_make(context *c, const body_model *body, int64_t vertices, const float *positions_canonical,
                       skin *out);
void skin_free(skin *s);
/* Positions, and normals unless they are NULL, in the world of a posed body: linear blending of rest pose and
 * offsets. Posed as the canonical body is, all come back to where they were. */
void skin_pose(const context *c, const body_model *body, const skin *s, const posed_body *p,
               const float *normals_canonical, float *positions_world, float *normals_world);

#endif
