/* A motion as AMASS has them. */
#include <string.h>

#include "io/value.h"
#include "motion/motion.h"

sherf_status sherf_motion_save(sherf_context *c, const sherf_motion *m, const char *path) {
    int frames = m->clip.frames;
    sherf_status status = SHERF_NO_MEMORY;
    float *poses = mem_alloc(c, (size_t)frames, 72 * sizeof *poses);
    float *trans = mem_alloc(c, (size_t)frames, 3 * sizeof *trans);
    float rate = (float)m->clip.fps;
    if (!poses || !trans) goto done;
    for (int i = 0; i < frames; i++) {
        static const float y_to_z[4] = {0.70710678f, 0.70710678f, 0, 0};
        double place[3] = {m->clip.pelvis_m[i][0], m->clip.pelvis_m[i][1], m->clip.pelvis_m[i][2]};
        float root[4];
        for (int j = 1; j < BODY_JOINTS; j++)
            quaternion_to_axis_angle(m->clip.turn[i][j], poses + 72 * i + 3 * j);
        quaternion_multiply(y_to_z, m->clip.turn[i][0], root);
        quaternion_to_axis_angle(root, poses + 72 * i);
        quaternion_rotate(y_to_z, place, place);
        for (int a = 0; a < 3; a++) trans[3 * i + a] = (float)(place[a] - m->skeleton.rest_m[0][a]);
    }
    const npz_member member[] = {
        {"poses", 2, {frames, 72}, poses},      {"trans", 2, {frames, 3}, trans},
        {"betas", 1, {BODY_SHAPES}, m->shapes}, {"mocap_frame_rate", 0, {0}, &rate},
        {.name = "gender", .text = "neutral"},
    };
    status = npz_write(c, path, COUNT_OF(member), member);
done:
    mem_free(poses);
    mem_free(trans);
    return status;
}
