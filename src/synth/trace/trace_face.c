/* The colour of a place on a mesh, without a camera. */
#include <string.h>

#include "synth/trace/trace_inside.h"

static const float from_m = 3e-4f, reach_m = TRACE_COVER_M, width_m = 0.002f;
static const float opaque_min = 0.5f;

/* Whether something visible to cameras is just in front of the place. */
static bool is_covered(const trace_scene *s, const float place[3], const float outwards[3]) {
    struct RTCIntersectContext how;
    struct RTCRayHit hit = {.ray = {.org_x = place[0],
                                    .org_y = place[1],
                                    .org_z = place[2],
                                    .dir_x = outwards[0],
                                    .dir_y = outwards[1],
                                    .dir_z = outwards[2],
                                    .tnear = from_m,
                                    .tfar = reach_m,
                                    .mask = ~seen_mask(TRACE_NOT_BY_CAMERAS)}};
    hit.hit.geomID = hit.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    rtcInitIntersectContext(&how);
    rtcIntersect1(s->scene, &how, &hit);
    if (hit.hit.geomID == RTC_INVALID_GEOMETRY_ID) return false;
    return s->mesh[hit.hit.geomID].material.alpha != TRACE_BLENDED;
}

bool trace_face_color(const trace_scene *s, int mesh, uint32_t face, const float weight[3], bool behind,
                      uint8_t rgb[3]) {
    const scene_mesh *owner = &s->mesh[mesh];
    const uint32_t *corner = owner->face + 3 * (size_t)face;
    float place[3] = {0}, edge[2][3], outwards[3], look[3], color[3], coat[3], alpha = 1;
    static const float black[3] = {0, 0, 0};
    surface at;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) place[k] += weight[i] * owner->vertex[3 * (size_t)corner[i] + (size_t)k];
    for (int i = 0; i < 2; i++)
        for (int k = 0; k < 3; k++)
            edge[i][k] = owner->vertex[3 * (size_t)corner[i + 1] + (size_t)k] -
                         owner->vertex[3 * (size_t)corner[0] + (size_t)k];
    cross3(edge[0], edge[1], outwards);
    unit3(outwards);
    for (int k = 0; k < 3; k++) outwards[k] *= behind ? -1.0f : 1.0f, look[k] = -outwards[k];
    if (is_covered(s, place, outwards)) return false;
    surface_at(s, mesh, face, weight[1], weight[2], behind, width_m, &at);
    if (at.rgba[3] < opaque_min) return false;
    surface_shade(s, &at, look, color, coat);
    for (int k = 0; k < 3; k++) color[k] += coat[k];
    const trace_picture one = {.width = 1, .height = 1, .color = color, .alpha = &alpha};
    trace_picture_srgb(&one, black, rgb);
    return true;
}
