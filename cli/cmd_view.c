/* sherf view: loads avatars and motions, starts the viewer's server and prints its address. */
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "session.h"
#include "shared.h"
#include "verbs.h"

enum { AVATARS_MAX = 64, MOTIONS_MAX = 256 };

static struct {
    const char *model, *body, *listen, *joints;
    option_files motions;
    int64_t port, size;
    bool open, no_detail, whole;
} set = {.listen = "127.0.0.1", .size = 1024};

static const option options[] = {
    {'b', "body", OPTION_FILE, &set.body, "FILE",
     "the body model the avatars were made with (one beside the first, or else the open body)"},
    {'m', "model", OPTION_FILE, &set.model, "FILE",
     "weights; all INPUTs are observations then (the model that ships)"},
    {'M', "motion", OPTION_FILES, &set.motions, "FILE",
     "a motion or poses to play, as sherf animate and --poses of sherf render take them; may be given again"},
    {0, "joints", OPTION_FILE, &set.joints, "MAP.json",
     "names of the motions' joints, as for sherf animate (recognised)"},
    SHARED_WHOLE(&set.whole),
    SHARED_NO_DETAIL(&set.no_detail),
    {0, "listen", OPTION_TEXT, &set.listen, "ADDR",
     "address to listen at (127.0.0.1, which only this machine reaches; 0.0.0.0: everybody who does)"},
    {0, "port", OPTION_INTEGER, &set.port, "N", "port to listen at (0: any that is free)", 0, 65535},
    {'s', "size", OPTION_INTEGER, &set.size, "N",
     "pictures are refined up to this size, the shorter side (1024)", 64, 2048},
    {'O', "open", OPTION_FLAG, &set.open, NULL, "open the page in the browser"},
    {0},
};

typedef struct {
    sherf_body *body;
    sherf_viewer_avatar avatar[AVATARS_MAX];
    sherf_avatar *made[AVATARS_MAX];
    char *avatar_name[AVATARS_MAX];
    int avatars;
    sherf_viewer_motion motion[MOTIONS_MAX];
    sherf_pose *poses[MOTIONS_MAX];
    char *motion_name[MOTIONS_MAX];
    int motions;
} gallery;

/* "walk" of "motions/walk.npz", "p7/0/4" of "thuman:people#p7/0/4". */
static char *plain_name(const char *path) {
    const char *picture = strrchr(path, '#'), *slash = strrchr(path, '/');
    if (picture) return strdup(picture + 1);
    if (slash && !slash[1]) { /* a folder */
        while (slash > path && *slash == '/') slash--;
        const char *end = slash + 1;
        while (slash > path && slash[-1] != '/') slash--;
        return strndup(slash, (size_t)(end - slash));
    }
    const char *name = slash ? slash + 1 : path, *dot = strrchr(name, '.');
    return dot && dot > name ? strndup(name, (size_t)(dot - name)) : strdup(name);
}

static int avatar_add(session *s, gallery *g, const char *input) {
    sherf_avatar **avatar = &g->made[g->avatars];
    int status = session_avatar(s, input, set.model, g->body, set.whole, avatar);
    if (status) return status;
    char *name = g->avatar_name[g->avatars] = plain_name(input);
    if (!name) return session_failure("out of memory");
    g->avatar[g->avatars++] = (sherf_viewer_avatar){name, *avatar, g->body};
    return EXIT_DONE;
}

/* Adds a motion file, or otherwise a pose file as for sherf render. */
static int motion_add(session *s, gallery *g, const char *path) {
    sherf_motion_options load = {
        .joints = set.joints, .body = g->body, .shapes = sherf_avatar_pose(g->made[0])->shapes};
    sherf_motion *motion = NULL;
    sherf_pose *poses = NULL;
    int count = 0, said = EXIT_DONE;
    double fps = 0;
    sherf_status status = sherf_motion_load(s->context, path, &load, &motion);
    if (status == SHERF_OK) {
        count = sherf_motion_frame_count(motion);
        fps = sherf_motion_fps(motion);
        poses = malloc((size_t)count * sizeof *poses);
        for (int i = 0; i < count && poses; i++) sherf_motion_pose(motion, i, &poses[i]);
        session_remark("%s: %s", path, sherf_motion_description(motion));
        sherf_motion_free(motion);
    } else {
        char *why = strdup(sherf_message(s->context));
        sherf_pose *loaded = NULL;
        if (status != SHERF_CANCELLED && !sherf_poses_load(s->context, path, &loaded, &count)) {
            poses = malloc((size_t)count * sizeof *poses);
            if (poses) memcpy(poses, loaded, (size_t)count * sizeof *poses);
        } else {
            said = session_failure("%s", why ? why : path);
        }
        sherf_free(loaded);
        free(why);
        if (said) return said;
    }
    char *name = g->motion_name[g->motions] = plain_name(path);
    g->poses[g->motions] = poses;
    if (!poses || !name) return session_failure("out of memory");
    g->motion[g->motions++] = (sherf_viewer_motion){name, poses, count, fps};
    return EXIT_DONE;
}

static void gallery_free(gallery *g) {
    for (int i = 0; i < AVATARS_MAX; i++) {
        sherf_avatar_free(g->made[i]);
        free(g->avatar_name[i]);
    }
    for (int i = 0; i < MOTIONS_MAX; i++) {
        free(g->poses[i]);
        free(g->motion_name[i]);
    }
    sherf_body_free(g->body);
    free(g);
}

/* The browser is a grandchild, so nobody waits for it; its output is discarded. */
static void browser_open(const char *address) {
    pid_t child = fork();
    if (child == 0) {
        int nowhere = open("/dev/null", O_RDWR);
        if (nowhere < 0 || dup2(nowhere, 0) < 0 || dup2(nowhere, 1) < 0 || dup2(nowhere, 2) < 0) _exit(1);
        setsid();
        if (fork() == 0) {
            execlp("xdg-open", "xdg-open", address, (char *)NULL);
            _exit(1);
        }
        _exit(0);
    }
    if (child < 0 || waitpid(child, NULL, 0) < 0) session_remark("no browser could be opened");
}

static bool loopback(const char *address) {
    return strncmp(address, "127.", 4) == 0 || strcmp(address, "::1") == 0;
}

static int serve(session *s, gallery *g) {
    sherf_viewer *viewer = NULL;
    sherf_viewer_options o = {.detail = set.no_detail ? SHERF_DETAIL_OFF : SHERF_DETAIL_ON,
                              .avatars = g->avatar,
                              .avatar_count = g->avatars,
                              .motions = g->motion,
                              .motion_count = g->motions,
                              .listen = set.listen,
                              .port = (int)set.port,
                              .size_px = (int)set.size};
    int status = session_status(s, sherf_viewer_create(s->context, &o, &viewer));
    if (status) return status;
    if (!loopback(set.listen))
        session_remark("sherf: warning: listening at %s: everybody who reaches this machine and knows the "
                       "address can look, and what is sent is not encrypted",
                       set.listen);
    if (common.json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "address", sherf_viewer_address(viewer));
        session_json(json);
    } else {
        printf("%s\n", sherf_viewer_address(viewer));
        session_remark("open this address in a browser; Ctrl-C ends");
    }
    fflush(stdout);
    if (set.open) browser_open(sherf_viewer_address(viewer));
    status = session_status(s, sherf_viewer_run(s->context, viewer));
    sherf_viewer_free(viewer);
    return status;
}

static int run(session *s, int count, char **argument) {
    const char *body_path = session_body(s, set.body, argument[0]);
    if (!body_path) return EXIT_USAGE;
    gallery *g = calloc(1, sizeof *g);
    if (!g) return session_failure("out of memory");
    int status = session_status(s, sherf_body_load(s->context, body_path, &g->body));
    for (int i = 0; i < count && !status; i++) status = avatar_add(s, g, argument[i]);
    for (int i = 0; i < set.motions.count && !status; i++) status = motion_add(s, g, set.motions.file[i]);
    if (!status) status = serve(s, g);
    gallery_free(g);
    return status;
}

const verb verb_view = {
    .name = "view",
    .arguments = "INPUT...",
    .summary = "turn, pose and play avatars in the browser",
    .description =
        "Opens a page, served by the program itself, on which avatars are turned with the mouse, "
        "put into poses and made to move, at a small size while something moves and then at full "
        "size. INPUTs are avatar files, baked or not, or observations. The address that is printed "
        "holds a key, and without it nothing is shown; only this machine reaches it unless "
        "--listen says otherwise. Ctrl-C ends.",
    .example = "sherf view ann.safetensors --open\n"
               "sherf view ann.safetensors bob.safetensors -b body.safetensors --motion walk.npz --motion "
               "dance.bvh\n"
               "sherf view ann/ -m model.safetensors --listen 0.0.0.0 --port 8080",
    .options = options,
    .arguments_min = 1,
    .arguments_max = AVATARS_MAX,
    .computes = true,
    .run = run,
};
