/* BVH: fits the file's skeleton to the body's, hips on hips, by the length of the legs. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "data/bvh_body.h"
#include "motion/source.h"

static const double longest_s = 5; /* that a frame takes: no recording is slower */

/* Thigh and shin of both sides, from points. */
static double leg_length(const double at[BODY_JOINTS][3]) {
    double sum = 0;
    for (int j = 4; j <= 8; j++) {
        if (j == 6) continue;
        double length = 0;
        for (int k = 0; k < 3; k++) {
            double d = at[j][k] - at[skeleton_parent[j]][k];
            length += d * d;
        }
        sum += sqrt(length);
    }
    return sum;
}

/* Positions of the matched joints in the file's rest pose. */
static void rest_joints(const bvh *b, const bvh_body *map, double at[BODY_JOINTS][3]) {
    for (int j = 0; j < BODY_JOINTS; j++) {
        at[j][0] = at[j][1] = at[j][2] = 0;
        for (int i = map->joint[j]; i >= 0; i = b->joint[i].parent)
            for (int k = 0; k < 3; k++) at[j][k] += b->joint[i].offset[k];
    }
}

/* Frame times are rounded: 0.0083333 s means 120 frames per second. */
static double rate_of(double frame_time_s) {
    double fps = 1 / frame_time_s, whole = round(fps);
    return fabs(fps - whole) < 1e-4 * fps ? whole : fps;
}

/* Uses the names of --joints, if there are any. */
static sherf_status match(context *c, const bvh *b, const sherf_motion_options *o, const skeleton *own,
                          bvh_body *map) {
    float rest[BODY_JOINTS][3];
    document *d = NULL;
    for (int j = 0; j < BODY_JOINTS; j++)
        for (int k = 0; k < 3; k++) rest[j][k] = (float)own->rest_m[j][k];
    sherf_status status = o->joints ? json_read(c, o->joints, &d) : SHERF_OK;
    if (!status) status = bvh_body_match(c, b, d ? d->root : NULL, (const float(*)[3])rest, map);
    document_free(d);
    return status;
}

/* Body parts that no joint of the file moves, for the line: ", without a neck". */
static void without(const bvh_body *map, char out[96]) {
    static const struct {
        int8_t left, right;
        const char *name;
    } parts[] = {{7, 8, "ankles"},    {10, 11, "toes"}, {12, 12, "neck"},
                 {13, 14, "collars"}, {15, 15, "head"}, {20, 21, "wrists"}};
    size_t n = 0;
    out[0] = 0;
    for (size_t i = 0; i < COUNT_OF(parts); i++)
        if (map->joint[parts[i].left] < 0 || map->joint[parts[i].right] < 0)
            n += (size_t)snprintf(out + n, 96 - n, "%s%s", n ? ", " : ", without ", parts[i].name);
}

sherf_status bvh_source_read(context *c, const bvh *b, const sherf_motion_options *o, source *s) {
    double at[BODY_JOINTS][3], hips[3], own_hips[3];
    bvh_body map;
    char lacks[96];
    s->format = "BVH";
    s->up = SHERF_UP_Y;
    s->is_pelvis = s->fps_said = true;
    if (!(o->source_fps > 0) && !(b->frame_time_s > 0 && b->frame_time_s < longest_s))
        return failure(c, SHERF_BAD_FILE,
                       "a frame takes %g s: are these milliseconds, or frames a second? Give the rate "
                       "(--source-fps)",
                       b->frame_time_s);
    sherf_status status = source_frames(c, s, o, b->frames, rate_of(b->frame_time_s));
    if (status) return status;
    if ((status = match(c, b, o, &s->skeleton, &map))) return status;
    rest_joints(b, &map, at);
    double legs = leg_length(at);
    if (!(legs > 1e-9)) return failure(c, SHERF_BAD_FILE, "a skeleton with legs of no length");
    s->unit_m = o->scale > 0 ? o->scale : leg_length(s->skeleton.rest_m) / legs;
    without(&map, lacks);
    snprintf(s->detail, sizeof s->detail, "names of %s, a unit is %.3g m by the legs%s%s", map.names,
             s->unit_m, lacks,
             map.calibrated ? ", its rest pose is none of a person: calibrated by its frames" : "");
    /* From the file's root to the middle of its hips at rest, minus the body's own, so that the hips meet. */
    for (int k = 0; k < 3; k++) {
        hips[k] = (at[1][k] + at[2][k]) / 2 - at[0][k];
        own_hips[k] = (s->skeleton.rest_m[1][k] + s->skeleton.rest_m[2][k]) / 2 - s->skeleton.rest_m[0][k];
    }
    for (int i = 0; i < b->frames; i++) {
        float pose[72];
        double place[3], turned[9], off[3], own[3];
        bvh_body_pose(b, &map, i, pose);
        for (int j = 0; j < BODY_JOINTS; j++) {
            double v[3] = {pose[3 * j], pose[3 * j + 1], pose[3 * j + 2]};
            quaternion_from_axis_angle(v, s->clip.turn[i][j]);
        }
        bvh_joint_position(b, i, map.joint[0], place, turned);
        for (int k = 0; k < 3; k++)
            off[k] = turned[3 * k] * hips[0] + turned[3 * k + 1] * hips[1] + turned[3 * k + 2] * hips[2];
        quaternion_rotate(s->clip.turn[i][0], own_hips, own);
        for (int k = 0; k < 3; k++) /* in the file's unit */
            s->clip.pelvis_m[i][k] = (float)(place[k] + off[k] - own[k] / s->unit_m);
    }
    return SHERF_OK;
}
