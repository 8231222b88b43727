/* Public functions about a data set that need no picture. */
#include "data/data.h"

sherf_status sherf_dataset_camera(sherf_context *c, const sherf_dataset *d, int person, int view,
                                  sherf_camera *out) {
    return dataset_camera(c, d, person, view, out);
}

sherf_status sherf_dataset_pose(sherf_context *c, const sherf_dataset *d, int person, int pose,
                                sherf_pose *out) {
    return dataset_pose(c, d, person, pose, out);
}
