/* sherf animate: moves an avatar, or an observation's person, by a motion file into a video or pictures;
 * --npz writes the motion itself. */
#include <math.h>
#include <string.h>

#include "session.h"
#include "shared.h"
#include "sink.h"
#include "verbs.h"

static struct {
    const char *avatar, *model, *body, *motion, *output, *npz, *bvh, *glb;
    int up, rotations, root, camera;
    double unit_m, source_fps, fps, smooth_s, blend_s;
    const char *track, *joints, *size, *background;
    int64_t first, last, samples;
    bool loop, own_place, their_shape, exact, no_detail, whole;
    double turn_s, azimuth_deg, elevation_deg, distance_m, fov_deg;
} set = {.background = "black", .blend_s = -1, .turn_s = 8, .azimuth_deg = NAN, .elevation_deg = NAN};

static const option options[] = {
    {'a', "avatar", OPTION_FILE, &set.avatar, "INPUT", "the same as INPUT as an argument"},
    {'m', "motion", OPTION_FILE, &set.motion, "FILE|FOLDER", "the motion, recognised by its content",
     .needed = true},
    {'o', "output", OPTION_FILE, &set.output, "OUT",
     "OUT.mp4, .webm, .mov or .gif for a video, otherwise a folder of pictures"},
    SHARED_BODY_OF_AVATAR(&set.body),
    SHARED_WEIGHTS_OF_OBSERVATION(0, &set.model),
    {0, "npz", OPTION_FILE, &set.npz, "FILE",
     "write the motion, as it is played, in AMASS's form for Blender's SMPL add-on"},
    {0, "bvh", OPTION_FILE, &set.bvh, "FILE", "write the motion, as it is played, as BVH with SMPL's joints"},
    {0, "glb", OPTION_FILE, &set.glb, "FILE",
     "the same as a binary glTF's animation of SMPL's joints, without a mesh"},
    /* the file */
    {0, "up", OPTION_CHOICE, &set.up, "auto|y|z|down", "the file's up axis; down: y points down"},
    {0, "rotations", OPTION_CHOICE, &set.rotations, "auto|axis-angle|matrix|wxyz|xyzw|6d-rows|6d-columns",
     "form of the file's rotations; wxyz and xyzw are quaternions"},
    {0, "unit", OPTION_REAL, &set.unit_m, "M", "metres in the file's unit of length (found)", 1e-6, 1e6},
    {0, "source-fps", OPTION_REAL, &set.source_fps, "X", "the file's frames a second (as it states)", 0.01,
     10000},
    {0, "track", OPTION_TEXT, &set.track, "ID",
     "the person, if the file has several (the one present longest)"},
    {0, "joints", OPTION_FILE, &set.joints, "MAP.json",
     "names of a BVH's joints, {\"left_hip\": \"LegL\", ...} (recognised)"},
    {0, "their-shape", OPTION_FLAG, &set.their_shape, NULL,
     "take the file's body shape; otherwise the person keeps their own"},
    /* in time */
    {0, "first", OPTION_INTEGER, &set.first, "N", "the file's frame to begin with (0)", 0, 1e6},
    {0, "last", OPTION_INTEGER, &set.last, "N", "the file's frame to end with (its last)", 1, 1e6},
    {0, "fps", OPTION_REAL, &set.fps, "X",
     "frames a second of the output, resampled by slerp (the file's, divided to be at most 60)", 0.1, 1000},
    {0, "smooth", OPTION_REAL, &set.smooth_s, "S", "smooth by a Gaussian of this many seconds (0)", 0, 10},
    {0, "loop", OPTION_FLAG, &set.loop, NULL, "make the end meet the start"},
    {0, "blend", OPTION_REAL, &set.blend_s, "S",
     "blend from the picture's pose in this many seconds (0.5; 0 in a loop)", 0, 60},
    /* in place */
    {0, "root", OPTION_CHOICE, &set.root, "kept|dropped|grounded",
     "how the person moves: as in the file, on the spot, or with the feet on the ground in every frame"},
    {0, "own-place", OPTION_FLAG, &set.own_place, NULL, "begin at the file's place, not at the picture's"},
    /* the camera */
    {'c', "camera", OPTION_CHOICE, &set.camera, "fixed|follow|orbit|observation",
     "shows the whole motion from one place, follows the person, follows and circles, or is the picture's "
     "own"},
    {0, "turn", OPTION_REAL, &set.turn_s, "S", "seconds for once round (8)", 0.1, 3600},
    {0, "azimuth", OPTION_REAL, &set.azimuth_deg, "DEG",
     "of the camera, 0 the front of the first frame's body (as in the picture)", -3600, 3600},
    {0, "elevation", OPTION_REAL, &set.elevation_deg, "DEG",
     "of the camera above the horizon (as in the picture)", -89, 89},
    {0, "distance", OPTION_REAL, &set.distance_m, "M", "of the camera (far enough to show everything)", 0.01,
     1e4},
    {0, "fov", OPTION_REAL, &set.fov_deg, "DEG", "vertical field of view (the picture's)", 1, 150},
    {'s', "size", OPTION_TEXT, &set.size, "N|WxH", "size of the frames (512)"},
    {0, "background", OPTION_TEXT, &set.background, "COLOUR",
     "black, white, r,g,b in 0 to 1, or transparent (.webm, .mov, .gif, pictures)"},
    SHARED_SAMPLES(&set.samples),
    SHARED_WHOLE(&set.whole),
    SHARED_NO_DETAIL(&set.no_detail),
    SHARED_EXACT(&set.exact),
    {0},
};

static int options_check(const char *input, sherf_animate_options *o) {
    const char *verb_name = "animate";
    background ground;
    if (!set.output && !set.npz && !set.bvh && !set.glb)
        return usage_error(verb_name, "--output OUT is missing (or --npz FILE, --bvh FILE or --glb FILE)");
    if (set.output && !input) return usage_error(verb_name, "INPUT is missing, an avatar");
    if (set.size && !size_parse(set.size, &o->width_px, &o->height_px))
        return usage_error(verb_name, "--size: '%s' is not a size like 512 or 640x360", set.size);
    if (set.last && set.last < set.first) return usage_error(verb_name, "--last comes before --first");
    if (!background_parse(verb_name, set.background, &ground)) return EXIT_USAGE;
    if (set.output && sink_output_check(verb_name, set.output, ground.transparent)) return EXIT_USAGE;
    if (set.output && sink_is_picture(set.output))
        return usage_error(verb_name, "--output %s: a motion does not go into one picture", set.output);
    if (isnan(set.azimuth_deg) != isnan(set.elevation_deg)) {
        if (isnan(set.azimuth_deg)) set.azimuth_deg = 0;
        if (isnan(set.elevation_deg)) set.elevation_deg = 0;
    }
    const double degree = M_PI / 180;
    o->camera = (sherf_camera_path)set.camera;
    o->aimed = !isnan(set.azimuth_deg);
    if (o->aimed) o->azimuth_rad = set.azimuth_deg * degree, o->elevation_rad = set.elevation_deg * degree;
    o->distance_m = set.distance_m;
    o->fov_rad = set.fov_deg * degree;
    o->turn_s = set.turn_s;
    o->transparent = ground.transparent;
    memcpy(o->render.background, ground.rgb, sizeof o->render.background);
    o->render.samples = (int)set.samples;
    o->render.exact = set.exact;
    o->render.detail = set.no_detail ? SHERF_DETAIL_OFF : SHERF_DETAIL_ON;
    return EXIT_DONE;
}

static int motion_get(session *s, const sherf_body *body, const sherf_avatar *avatar, sherf_motion **motion) {
    const sherf_pose *pose = avatar ? sherf_avatar_pose(avatar) : NULL;
    sherf_motion_options o = {.up = (sherf_up)set.up,
                              .rotations = (sherf_rotations)set.rotations,
                              .scale = set.unit_m,
                              .source_fps = set.source_fps,
                              .fps = set.fps,
                              .fps_max = 60,
                              .track = set.track,
                              .joints = set.joints,
                              .first = (int)set.first,
                              .last = (int)set.last,
                              .root = (sherf_root)set.root,
                              .smooth_s = set.smooth_s,
                              .loop = set.loop,
                              .start = set.own_place ? NULL : pose,
                              .blend_s = set.blend_s >= 0 ? set.blend_s
                                         : set.loop       ? 0
                                                          : 0.5,
                              .body = body,
                              .shapes = pose ? pose->shapes : NULL,
                              .their_shape = set.their_shape};
    int status = session_status(s, sherf_motion_load(s->context, set.motion, &o, motion));
    if (!status) session_remark("%s: %s", set.motion, sherf_motion_description(*motion));
    return status;
}

static void report(session *s, const sherf_motion *motion, const sherf_animate_result *result) {
    double fps = sherf_motion_fps(motion);
    if (!common.json) {
        const int all = sherf_motion_frame_count(motion);
        if (set.npz) session_remark("%s: %d frame%s", set.npz, all, all == 1 ? "" : "s");
        if (set.bvh) session_remark("%s: %d frame%s", set.bvh, all, all == 1 ? "" : "s");
        if (set.glb) session_remark("%s: %d frame%s", set.glb, all, all == 1 ? "" : "s");
        if (set.output)
            session_remark("%s: %d frame%s, %.4g a second, %.0f ms each", set.output, result->frames,
                           result->frames == 1 ? "" : "s", fps, result->frame_ms);
        return;
    }
    cJSON *json = cJSON_CreateObject();
    cJSON_AddStringToObject(json, "motion", sherf_motion_description(motion));
    if (set.npz) cJSON_AddStringToObject(json, "npz", set.npz);
    if (set.bvh) cJSON_AddStringToObject(json, "bvh", set.bvh);
    if (set.glb) cJSON_AddStringToObject(json, "glb", set.glb);
    cJSON_AddNumberToObject(json, "frames", sherf_motion_frame_count(motion));
    cJSON_AddNumberToObject(json, "fps", fps);
    if (set.output) {
        cJSON_AddStringToObject(json, "output", set.output);
        cJSON_AddNumberToObject(json, "frame_ms", result->frame_ms);
        cJSON_AddNumberToObject(json, "points", result->points);
        cJSON_AddStringToObject(json, "precision", session_precision(s));
    }
    session_json(json);
}

static int run(session *s, int count, char **argument) {
    sherf_animate_options o = {0};
    sherf_animate_result result = {0};
    sherf_body *body = NULL;
    sherf_avatar *avatar = NULL;
    sherf_motion *motion = NULL;
    if (count && set.avatar) return usage_error(s->verb_name, "INPUT is given twice, once by --avatar");
    const char *input = count ? argument[0] : set.avatar;
    int status = options_check(input, &o);
    if (!status) status = session_person(s, input, set.body, set.model, set.whole, &body, &avatar);
    if (!status) status = motion_get(s, body, avatar, &motion);
    if (!status && set.npz) status = session_status(s, sherf_motion_save(s->context, motion, set.npz));
    if (!status && set.bvh) status = session_status(s, sherf_motion_save(s->context, motion, set.bvh));
    if (!status && set.glb) status = session_status(s, sherf_motion_save(s->context, motion, set.glb));
    if (!status && set.output)
        status = session_status(s, sherf_animate(s->context, avatar, body, motion, &o, set.output, &result));
    if (!status) report(s, motion, &result);
    sherf_motion_free(motion);
    sherf_avatar_free(avatar);
    sherf_body_free(body);
    return status;
}

const verb verb_animate = {
    .name = "animate",
    .arguments = "[INPUT]",
    .summary = "move an avatar by a motion file: a video or pictures",
    .description =
        "Moves an avatar, or the person of an observation, as a motion file says: "
        "AMASS (SMPL+H, "
        "SMPL-X), AIST++, EDGE, GVHMR, WHAM, PHALP, EasyMocap, LHM and ExAvatar folders, CLIFF, ROMP, "
        "TRAM, SLAHMR, 3DPW, EMDB, Motion-X, HumanML3D, MDM, BVH of most rigs. The motion begins where the "
        "picture has the person. Ctrl-C leaves a whole "
        "file of the frames "
        "so far. Without --output the motion alone is written, by --npz, --bvh or --glb.",
    .example = "sherf animate ann.safetensors --motion walk.npz -o walk.mp4\n"
               "sherf animate -a ann.safetensors -m 01_01.bvh --first 240 --last 960 --fps 30 -c follow -o "
               "climb.mp4\n"
               "sherf animate ann.safetensors -m dance.pkl --loop --root dropped -c orbit --background "
               "transparent -o dance.webm\n"
               "sherf animate -m wham_output.pkl --track 2 --root grounded --smooth 0.05 --npz blender.npz",
    .options = options,
    .arguments_min = 0,
    .arguments_max = 1,
    .computes = true,
    .many_kinds = true,
    .run = run,
};
