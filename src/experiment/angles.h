/* angles: the positions of cameras around a person. */
#ifndef SHERF_ANGLES_H
#define SHERF_ANGLES_H

#include "scene/scene.h"

/* The angle in degrees, in (-180, 180], about the body's vertical axis (the pelvis's own) through its root,
 * from the camera `from` to `to`; counter-clockwise as seen from above is positive. */
sherf_status camera_angle(context *c, const sherf_body *body, const sherf_pose *pose,
                          const sherf_camera *from, const sherf_camera *to, double *degrees);
/* Rounds to the nearest of twelve angles, -150, -120, ... 180. */
int angle_rounded(double degrees);

#endif
