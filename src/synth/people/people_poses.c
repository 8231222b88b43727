/* Converts poses of MakeHuman's package to SMPL's joints. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/path.h"
#include "base/vector3.h"
#include "synth/people/people.h"

const char people_motions[] = "/usr/share/assimp/models/BVH";

/* The team's own poses; the package's others are the community's, under unknown terms. */
static const char *const postures[] = {"akimbo01",   "fight01",    "fight03",    "fight04",    "genuflect01",
                                       "run01",      "sit01",      "standing01", "standing02", "standing03",
                                       "standing04", "standing05", "standing06", "tpose"};
static const char *const clips[] = {"01_01.bvh", "01_03.bvh"};

static void transposed_times(const double a[9], const double b[9], double out[9]) {
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) out[3 * i + k] = a[i] * b[k] + a[3 + i] * b[3 + k] + a[6 + i] * b[6 + k];
}

static bool from_quaternion(const double q[4], double R[9]) {
    double n = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    if (!(n > 0.5 && n < 2)) return false;
    double s = 2 / n, x = q[0], y = q[1], z = q[2], w = q[3];
    const double m[9] = {1 - s * (y * y + z * z), s * (x * y - z * w),     s * (x * z + y * w),
                         s * (x * y + z * w),     1 - s * (x * x + z * z), s * (y * z - x * w),
                         s * (x * z - y * w),     s * (y * z + x * w),     1 - s * (x * x + y * y)};
    memcpy(R, m, sizeof m);
    return true;
}

/* The bone whose rotation a joint takes: the last one before the next joint, so that it includes all twist on
 * the way. */
static const char *const taken[BODY_JOINTS] = {"root",
                                               "upperleg02.L",
                                               "upperleg02.R",
                                               "spine03",
                                               "lowerleg02.L",
                                               "lowerleg02.R",
                                               "spine02",
                                               "foot.L",
                                               "foot.R",
                                               "spine01",
                                               "",
                                               "",
                                               "neck02",
                                               "shoulder01.L",
                                               "shoulder01.R",
                                               "head",
                                               "upperarm02.L",
                                               "upperarm02.R",
                                               "lowerarm01.L",
                                               "lowerarm01.R",
                                               "wrist.L",
                                               "wrist.R",
                                               "",
                                               ""};

/* to_rest: each bone's map from the A-pose to the T-pose (bones x 12). */
static sherf_status convert(context *c, const makehuman *human, const double *to_rest,
                            const value *quaternions, double (*global)[9], float pose[72]) {
    double joint[BODY_JOINTS][9];
    for (int b = 0; b < human->bones; b++) {
        double q[4] = {0, 0, 0, 1}, R[9];
        const value *v = value_get(quaternions, human->bone[b].name);
        if (v) {
            sherf_status status = value_doubles(c, v, human->bone[b].name, 4, q);
            if (status) return status;
        }
        if (!from_quaternion(q, R))
            return failure(c, SHERF_BAD_FILE, "%s: not a rotation", human->bone[b].name);
        if (human->bone[b].parent < 0)
            memcpy(global[b], R, sizeof R);
        else
            multiply3(global[human->bone[b].parent], R, global[b]);
    }
    for (int j = 0; j < BODY_JOINTS; j++) {
        int parent = tpose_parent[j], bone = *taken[j] ? makehuman_bone_find(human, taken[j]) : -1;
        double local[9];
        float R[9];
        if (bone < 0) { /* same as its parent */
            memcpy(joint[j], joint[parent < 0 ? 0 : parent], sizeof joint[j]);
        } else {
            double A[9]; /* transposed: T-pose to A-pose */
            for (int i = 0; i < 9; i++) A[i % 3 * 3 + i / 3] = to_rest[12 * bone + i / 3 * 4 + i % 3];
            multiply3(global[bone], A, joint[j]);
        }
        if (parent < 0)
            memcpy(local, joint[j], sizeof local);
        else
            transposed_times(joint[parent], joint[j], local);
        for (int i = 0; i < 9; i++) R[i] = (float)local[i];
        rotation_to_axis_angle(R, pose + 3 * j);
    }
    return SHERF_OK;
}

static sherf_status add_postures(context *c, const studio *s, const char *source, pose_library *l) {
    char path[PATH_LENGTH];
    const makehuman *human = s->human;
    double joints[BODY_JOINTS][3];
    document *d = NULL;
    double *bone = mem_alloc(c, (size_t)human->bones, 12 * sizeof *bone),
           (*global)[9] = mem_alloc(c, (size_t)human->bones, sizeof *global);
    float *shaped = mem_alloc(c, (size_t)human->vertices, 3 * sizeof *shaped);
    sherf_status status = SHERF_NO_MEMORY;
    if (!bone || !global || !shaped) goto done;
    snprintf(path, sizeof path, "%.2048s/src/json/poses/poses.json", source);
    status = json_read(c, path, &d);
    if (!status) status = makehuman_shape(c, human, &makehuman_average, 0, NULL, shaped);
    if (!status) status = tpose_apply(c, human, s->rig, shaped, shaped, joints, bone);
    for (size_t i = 0; i < COUNT_OF(postures) && !status; i++) {
        const value *v = value_get(d->root, postures[i]);
        float pose[72];
        if (!v) continue;
        status = convert(c, human, bone, v, global, pose);
        if (status == SHERF_BAD_FILE) failure_prefix(c, status, "%s", path);
        if (!status) status = pose_library_add_posture(c, l, postures[i], pose);
    }
done:
    document_free(d);
    mem_free(bone);
    mem_free(global);
    mem_free(shaped);
    return status;
}

sherf_status people_poses(context *c, const studio *s, const char *source, const char *motions,
                          pose_library **out) {
    *out = NULL;
    pose_library *l;
    posed_body *rest = NULL;
    static const float none[72], unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    sherf_status status = pose_library_create(c, &l);
    if (status) return status;
    status = add_postures(c, s, source, l);
    if (!status) status = posed_body_create(c, s->body, none, none, unit, none, &rest);
    for (size_t i = 0; i < COUNT_OF(clips) && !status; i++) {
        char path[PATH_LENGTH];
        snprintf(path, sizeof path, "%.2048s/%s", motions ? motions : people_motions, clips[i]);
        if (path_is_file(path))
            status = pose_library_add_bvh(c, l, path, (const float(*)[3])rest->joints_rest, 0.1);
        else
            log_line(c, SHERF_LOG_WARNING, "%s: not there, so none of its poses (Debian: assimp-testmodels)",
                     path);
    }
    posed_body_free(rest);
    if (status)
        pose_library_free(l);
    else
        *out = l;
    return status;
}
