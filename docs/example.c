/* One picture in, one picture from behind out: the whole of sherf's API that most programs need.
 *   cc example.c $(pkg-config --cflags --libs sherf) -o example
 *   ./example body.safetensors model.safetensors observation/ behind.png */
#include <stdio.h>

#include <sherf/sherf.h>

int main(int count, char **argument) {
    if (count != 5) {
        fprintf(stderr, "usage: %s BODY MODEL OBSERVATION OUT.png\n", argument[0]);
        return 2;
    }
    sherf_context *c = NULL;
    sherf_body *body = NULL;
    sherf_model *model = NULL;
    sherf_observation *observation = NULL;
    sherf_avatar *avatar = NULL;
    sherf_frame frame = {0};
    sherf_status status = sherf_context_create(NULL, &c);
    if (status != SHERF_OK) return 1;

    /* The avatar: everything the picture tells, in one object. */
    status = sherf_body_load(c, argument[1], &body);
    if (!status) status = sherf_model_load(c, argument[2], &model);
    if (!status) status = sherf_observation_load(c, argument[3], &observation);
    if (!status) status = sherf_avatar_create(c, model, body, observation, &avatar);

    /* A frame: the same pose with the left elbow bent, from behind the hips, on white. */
    if (!status) {
        sherf_pose pose = *sherf_observation_pose(observation);
        float joints_m[24][3];
        pose.poses_rad[3 * 18 + 1] -= 1.0f;
        status = sherf_body_pose(c, body, &pose, NULL, joints_m[0]);
        sherf_camera camera;
        sherf_camera_orbit(joints_m[0], 3.0f, 3.14159265f, 0.1f, 0.8f, 256, 256, &camera);
        sherf_render_options options = {.background = {1, 1, 1}};
        if (!status) status = sherf_render(c, avatar, body, &pose, &camera, &options, &frame);
    }
    if (!status) status = sherf_image_write(c, argument[4], &frame.color);
    if (status) fprintf(stderr, "%s\n", sherf_message(c));

    sherf_frame_free(&frame);
    sherf_avatar_free(avatar);
    sherf_observation_free(observation);
    sherf_model_free(model);
    sherf_body_free(body);
    sherf_context_free(c);
    return status ? 1 : 0;
}
