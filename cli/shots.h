/* shots: the pictures that `sherf render` makes: a list of poses, a list of cameras, and their pairs. */
#ifndef CLI_SHOTS_H
#define CLI_SHOTS_H

#include "session.h"

typedef struct {
    const char *poses; /* a file, or a list of a data set's poses; NULL: the avatar's own */
    const char *data, *people, *views;
    const char *cameras;
    int64_t orbit;                                          /* cameras of an orbit; 0: none */
    double azimuth_deg, elevation_deg, distance_m, fov_deg; /* distance 0: far enough to see everything */
    const char *size;
    bool their_shape; /* also take the body shape from a pose file */
    bool every;       /* every camera for every pose */
} shots_request;

typedef struct {
    sherf_pose *pose;
    int pose_count;
    sherf_camera *camera;
    int camera_count;
    int count;         /* shots */
    bool every;        /* shot n is pose n / cameras, camera n % cameras; otherwise n % poses, n % cameras */
    float *vertices_m; /* room for one posed body */
} shots;

/* Returns an exit status; free `out` in any case. */
int shots_create(session *s, const shots_request *request, const sherf_body *body, const sherf_avatar *avatar,
                 shots *out);
void shots_free(shots *t);
const sherf_pose *shots_pose(const shots *t, int n);
const sherf_camera *shots_camera(const shots *t, int n);
/* The nearest and farthest depth of the body in shot n: the range of its depth picture. */
int shots_depth_range(session *s, const shots *t, const sherf_body *body, int n, float range_m[2]);

#endif
