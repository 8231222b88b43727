/* viewer: what `sherf view` serves. It has two threads: the HTTP library's, which reads requests and sends
 * answers (server.c), and the one in sherf_viewer_run, which renders (viewer.c; studio.c, film.c). The desk
 * (desk.c) connects them: each client has at most one picture in progress, a newer request replaces an older
 * one, and clients take turns, one band of a picture each. */
#ifndef SHERF_VIEWER_H
#define SHERF_VIEWER_H

#include <pthread.h>

#include "avatar/avatar.h"

typedef struct sherf_viewer viewer;

enum {
    VIEWER_TOKEN = 32,      /* letters of the token, 128 bits */
    VIEWER_CLIENTS = 10,    /* at the desk at a time */
    VIEWER_NAME = 16,       /* letters of a client's name */
    VIEWER_JOBS_EACH = 4,   /* answers in progress for a client, read or not */
    VIEWER_SIDE_MIN = 16,   /* of a picture */
    VIEWER_SIDE_MAX = 2048, /* the shorter one; the longer one up to twice */
    VIEWER_FILM_FRAMES = 3000,
    VIEWER_FILM_SIDE = 1024,
    VIEWER_FILM_LONG = 1920,
    VIEWER_AVATARS = 64,
    VIEWER_MOTIONS = 256,
    VIEWER_OWN_MOTIONS = 2, /* the picture's pose and the T-pose, before those of the options */
    VIEWER_POSED = 6        /* posed bodies kept, about 7 MB each */
};

/* ---- a client's requests (request.c) ---- */
typedef enum { VIEWER_COLOR, VIEWER_OPACITY, VIEWER_DEPTH, VIEWER_NORMAL } viewer_mode;

typedef struct {
    int avatar, motion, frame;
    int width, height;
    float azimuth_rad, elevation_rad, zoom;
    float offset_m[3]; /* of the point looked at: right, up and front of the body */
    viewer_mode mode;
    bool transparent, follow;
    bool lossless; /* PNG; otherwise JPEG if nothing is transparent */
    bool fine;     /* the final picture of a view: encoded better */
    bool quick;    /* from the baked surface, if there is one; a baked avatar has no other pictures */
    float background[3];
} viewer_request;

/* Parses a query's fields one by one and checks their form; request_misfit checks that the scene has what
 * they name. */
typedef struct {
    viewer_request request;
    char client[VIEWER_NAME + 1];
    uint64_t sequence;
    unsigned seen;  /* a bit for each field: none may occur twice */
    char wrong[64]; /* the field that was not taken, and why; empty: none */
    /* of films */
    int film_frames; /* of a turntable; 0: the motion */
    float film_fps;
    float film_speed;
} viewer_query;
void query_start(viewer_query *q);
/* False: an unknown field, a repeated one, or an invalid value, which `wrong` then says. */
bool query_take(viewer_query *q, const char *name, const char *value);

/* ---- who may send requests (guard.c) ---- */
sherf_status token_make(context *c, char out[VIEWER_TOKEN + 1]);
/* Whether `path` begins with "/token"; the time taken does not depend on how many letters match. *rest: what
 * follows. */
bool token_matches(const char token[VIEWER_TOKEN + 1], const char *path, const char **rest);
/* Whether a Host line is safe from DNS rebinding (another site's name pointing here): a numeric address, or
 * localhost; any port, since a tunnel may change it. */
bool host_is_allowed(const char *host);
/* Whether the Origin (NULL: none was sent, which is fine) is the page's own, http://HOST. */
bool origin_is_allowed(const char *origin, const char *host);

/* ---- the scene (scene.c) ---- */
typedef struct {
    bool known;
    double axes[9]; /* columns: right, up, front of the body in its first pose, in the world */
    float centre_m[3];
    double half_m[3], distance_m;
    float root_m[3]; /* place of the root joint in the first frame */
} viewer_framing;

typedef struct {
    const char *name;
    const sherf_pose *poses;
    int count;
    double fps;
} viewer_motion;

typedef struct {
    uint64_t used; /* 0: free */
    int avatar, motion, frame;
    posed_body *body;
} viewer_posed;

typedef struct {
    int avatar_count, motion_count;
    sherf_viewer_avatar *avatars; /* names are the scene's own */
    viewer_motion *motions;       /* the first VIEWER_OWN_MOTIONS are made here */
    viewer_framing *framings;     /* avatar_count x motion_count */
    sherf_pose rest;
    viewer_posed posed[VIEWER_POSED];
    uint64_t clock;
    pthread_mutex_t framing_lock; /* guards framings, which any thread may request */
    int side_max;
    bool detail;
    char *about; /* JSON */
} viewer_scene;
sherf_status scene_create(context *c, const sherf_viewer_options *o, viewer_scene *out);
void scene_free(viewer_scene *s);
/* NULL, or the field whose value the scene does not have; static. */
const char *request_misfit(const viewer_scene *s, const viewer_request *r);
/* The pose of a motion's frame, with the avatar's own shape. */
sherf_pose scene_pose(const viewer_scene *s, int avatar, int motion, int frame);
sherf_status scene_framing(context *c, viewer_scene *s, int avatar, int motion, const viewer_framing **out);
/* The root joint's displacement along the ground since the motion's first frame, in world axes. */
void scene_root_way(const viewer_framing *f, const posed_body *p, float way[3]);
/* Only the rendering thread calls the functions below. */
sherf_status scene_posed(context *c, viewer_scene *s, const viewer_request *r, const posed_body **out);
/* r's camera; *scale_m: metres that a picture's height spans at the point looked at. */
void scene_camera(const viewer_scene *s, const viewer_framing *f, const viewer_request *r,
                  sherf_camera *camera, float *scale_m);
/* The observation's picture as PNG. */
sherf_status scene_picture(context *c, const viewer_scene *s, int avatar, uint8_t **out, size_t *bytes);

/* ---- from a frame to a picture (paint.c) ---- */
typedef struct {
    float focal_px, centre_px[2];
    float near_m, far_m; /* of the depth picture */
} viewer_optics;
/* color: over black. out: width x height x channels, 3 or 4. scratch: 2 floats per pixel, for normals. */
void paint(const viewer_request *r, const viewer_optics *o, const float *color, const float *opacity,
           const float *depth, int channels, float *scratch, uint8_t *out);

/* ---- the desk (desk.c) ---- */
typedef enum { JOB_WAITING, JOB_RUNNING, JOB_DONE, JOB_REPLACED, JOB_FAILED, JOB_CLOSED } job_state;

/* A picture that a client waits for. */
typedef struct {
    viewer_request request;
    uint64_t sequence;
    int seat;
    int references; /* these two under the desk's lock */
    job_state state;
    void (*wake)(void *arg); /* called once when state becomes one of the last four; not under the lock */
    void *wake_arg;
    double asked_s;
    /* of the thread that renders */
    const viewer_framing *framing; /* NULL: not begun */
    sherf_camera camera;
    float scale_m;
    float *color, *opacity, *depth; /* in one piece, which begins at color */
    int rows_done;
    bool baked; /* drawn from the baked surface; the network's picture can be requested */
    double render_s;
    int64_t points;
    /* the answer */
    uint8_t *data;
    size_t bytes;
    bool png;
    char message[160];
} viewer_job;

typedef enum { FILM_NONE, FILM_RUNNING, FILM_DONE, FILM_FAILED } film_state;
typedef struct {
    film_state state;
    bool stop;              /* no longer wanted */
    viewer_request request; /* of frame 0 */
    bool turns;             /* round the body; otherwise through the motion */
    int frames, done;
    float fps, speed;
    int fd; /* of the finished file, which no longer has a name */
    int64_t bytes;
    char message[160];
    /* of the thread that renders */
    sherf_video *video;
    viewer_job *job; /* the frame under way */
    char path[64];
} viewer_film;

typedef struct {
    char name[VIEWER_NAME + 1]; /* empty: a free seat */
    double seen_s;
    uint64_t newest; /* sequence */
    viewer_job *job; /* waiting or running */
    int jobs;        /* in existence, including those whose answer is being sent */
    uint64_t turn;   /* its last turn */
    viewer_film film;
} viewer_client;

typedef struct {
    pthread_mutex_t lock;
    pthread_cond_t news; /* wakes the rendering thread; monotonic clock */
    viewer_client client[VIEWER_CLIENTS];
    uint64_t turns;
    int turns_since_film;
    bool closed;
} viewer_desk;

bool desk_open(viewer_desk *d);
void desk_close(viewer_desk *d);  /* accepts no more jobs; closes and wakes the waiting ones */
void desk_finish(viewer_desk *d); /* after desk_close, when no job is left */
/* The seat of a client; a client without one gets a free seat, or the seat of a client that was silent for a
 * while. -1: all are taken. Under the lock. */
int desk_seat(viewer_desk *d, const char *name);
typedef enum { ADMITTED, ADMITTED_NO_SEAT, ADMITTED_TOO_MANY, ADMITTED_NO_MEMORY } admission;
/* Makes a job, which the caller holds until desk_release; desk_submit queues it. */
admission desk_admit(viewer_desk *d, const viewer_query *q, viewer_job **out);
void desk_submit(viewer_desk *d, viewer_job *job, void (*wake)(void *arg), void *arg);
void desk_release(viewer_desk *d, viewer_job *job);
typedef enum { TURN_NONE, TURN_JOB, TURN_FILM, TURN_CLOSED } viewer_turn;
/* Decides whose turn it is; waits at most `wait_s`. The caller owns the job until desk_release. */
viewer_turn desk_turn(viewer_desk *d, double wait_s, viewer_job **job, int *seat);
/* Ends a job, unless it has been replaced meanwhile. */
void desk_done(viewer_desk *d, viewer_job *job, job_state state);
viewer_job *job_create(context *c, const viewer_request *r);
void job_free(viewer_job *job);

/* ---- what the page draws by itself (live.c) ----
 * Answers in the machine's byte order, which is little-endian wherever this runs. Each begins with LIVE_HEAD
 * numbers of 32 bits.
 * A surface: LIVE_SURFACE, C corners, T triangles, bytes of the PNG; C x 3 float, the rest pose of the
 * avatar's shape, metres; C x 2 16-bit shares of the texture, from its upper left corner; C x 4 bytes,
 * joints; C x 4 bytes, their weights, which sum to 255; T x 3 corners, 32 bits; the texture, PNG. Frames of a
 * motion: LIVE_MOVES, the first one, how many, 0; LIVE_FRAMING float: axes (3 x 3), centre, half size,
 * distance of viewer_framing; and for each frame LIVE_FRAME float: the way of the root joint that a camera
 * follows, and 24 matrices (3 x 4) from the rest pose to the world. */
enum {
    LIVE_HEAD = 4,
    LIVE_SURFACE = 0x31464c53, /* "SLF1" */
    LIVE_MOVES = 0x314d4c53,   /* "SLM1" */
    LIVE_CORNER_BYTES = 12 + 4 + 4 + 4,
    LIVE_FRAMING = 16,
    LIVE_FRAME = 3 + 12 * BODY_JOINTS,
    LIVE_FRAMES = 128 /* in an answer */
};
typedef enum { LIVE_NONE, LIVE_REQUESTED, LIVE_BAKING, LIVE_READY, LIVE_FAILED } live_state;
typedef struct {
    live_state state;
    uint64_t request;     /* its number */
    sherf_avatar *avatar; /* baked here; NULL if the scene's avatar is baked already */
    uint8_t *data;
    size_t bytes;
} live_surface;
typedef struct {
    bool open, started, closed;
    pthread_mutex_t lock;
    pthread_cond_t news;
    pthread_t thread;
    context *c;       /* the thread's own; NULL: nothing can be baked */
    uint64_t request; /* the last one's number */
    int resolution;   /* of the baked surface, cells along the body; tests lower it */
    live_surface surface[VIEWER_AVATARS];
} viewer_live;
sherf_status live_open(context *c, viewer *v);
void live_close(viewer *v); /* call it when no more requests can come */
/* An avatar's surface; the first call starts making it. The viewer owns data. */
live_state live_ask(viewer *v, int avatar, const uint8_t **data, size_t *bytes);
/* The baked avatar, for pictures drawn on the server; NULL: not ready yet, or none. */
const sherf_avatar *live_avatar(viewer *v, int avatar);
/* Up to LIVE_FRAMES from `frame` on. Freed with mem_free. */
sherf_status live_moves(context *c, viewer_scene *s, int avatar, int motion, int frame, uint8_t **out,
                        size_t *bytes);

/* ---- the viewer ---- */
struct sherf_viewer {
    viewer_scene scene;
    viewer_desk desk;
    viewer_live live;
    char token[VIEWER_TOKEN + 1];
    char address[160];
    char folder[64]; /* of films being written; empty: not made yet */
    struct viewer_server *server;
    /* of the thread that renders */
    sherf_frame band;
    double pixel_s[VIEWER_AVATARS]; /* measured lately; 0: unknown */
};

/* ---- rendering (studio.c) ---- */
/* Renders a band of the job's picture; *complete: it was the last. */
sherf_status job_render(context *c, viewer *v, viewer_job *job, bool *complete);
/* Converts to 8 bit, by the request's mode; mem_free *out. */
sherf_status job_paint(context *c, const viewer_job *job, int channels, uint8_t **out);
/* Encodes into job->data a PNG or JPEG, as requested. */
sherf_status job_encode(context *c, viewer_job *job);

/* ---- films (film.c) ---- */
/* Under the desk's lock. NULL, or the error. */
const char *film_start(viewer *v, int seat, const viewer_query *q);
void film_drop(viewer *v, int seat);
/* Renders one band of a film, on the rendering thread. */
void film_render(context *c, viewer *v, int seat);
void films_close(viewer *v);

/* ---- HTTP (server.c) ---- */
sherf_status server_open(context *c, viewer *v, const char *listen, int port);
void server_tend(struct viewer_server *s); /* ends connections that are too slow; call it now and then */
void server_close(struct viewer_server *s);
extern _Atomic double server_patience; /* factor of all time limits but SILENCE_S; tests lower it */

/* ---- the page (made by the build of web/) ---- */
typedef struct {
    const char *name, *type;
    const unsigned char *data;
    size_t bytes;
} viewer_file;
extern const viewer_file viewer_files[];
extern const int viewer_file_count;

#endif
