/* view: the viewer that `sherf view` serves. Two threads: the HTTP library's, which reads requests and hands
 * out answers (server.c), and the one in sherf_viewer_run, which renders (studio.c). Between them stands the
 * desk (desk.c): at most one picture a client is asked for, a newer wish takes the place of an older one, and
 * clients take turns, a band of a picture each. */
#ifndef SHERF_VIEW_H
#define SHERF_VIEW_H

#include <pthread.h>

#include "model/model.h"

enum {
    VIEW_TOKEN = 32,      /* letters of the token, 128 bits */
    VIEW_CLIENTS = 10,    /* at the desk at a time */
    VIEW_NAME = 16,       /* letters of a client's name */
    VIEW_JOBS_EACH = 4,   /* answers a client may have under way, read or not */
    VIEW_SIDE_MIN = 16,   /* of a picture */
    VIEW_SIDE_MAX = 2048, /* the shorter one; the longer one up to twice */
    VIEW_FILM_FRAMES = 3000,
    VIEW_FILM_SIDE = 1024,
    VIEW_FILM_LONG = 1920,
    VIEW_AVATARS = 64,
    VIEW_MOTIONS = 256,
    VIEW_OWN_MOTIONS = 2, /* the picture's pose and the T-pose, before those of the options */
    VIEW_POSED = 6        /* posed bodies kept, some 7 MB each */
};

/* ---- what a client asks for (wish.c) ---- */
typedef enum { VIEW_COLOR, VIEW_OPACITY, VIEW_DEPTH, VIEW_NORMAL } view_mode;

typedef struct {
    int avatar, motion, frame;
    int width, height;
    float azimuth_rad, elevation_rad, zoom;
    float offset_m[3]; /* of the point looked at: right, up and front of the body */
    view_mode mode;
    bool transparent, follow;
    bool lossless; /* PNG; otherwise JPEG where nothing is transparent */
    bool fine;     /* a picture to stay: encoded better */
    float background[3];
} view_wish;

/* A query's fields, taken one by one; what they may be is checked here, and what there is by wish_fits. */
typedef struct {
    view_wish wish;
    char client[VIEW_NAME + 1];
    uint64_t sequence;
    unsigned seen; /* a bit a field: none comes twice */
    /* of films */
    int film_frames; /* of a turntable; 0: the motion */
    float film_fps;
    float film_speed;
} view_query;
void query_start(view_query *q);
/* False: an unknown field, one that came before, or a value that is not one. */
bool query_take(view_query *q, const char *name, const char *value);

/* ---- who may ask (guard.c) ---- */
sherf_status token_make(context *c, char out[VIEW_TOKEN + 1]);
/* Whether `path` begins with "/token"; the time taken does not depend on how much of it is right. *rest: what
 * follows. */
bool token_matches(const char token[VIEW_TOKEN + 1], const char *path, const char **rest);
/* A Host line that a page of another site cannot bring about by pointing its own name here: an address in
 * figures, or localhost; any port, as a tunnel may change it. */
bool host_is_allowed(const char *host);
/* Whether the Origin (NULL: none was sent, which is fine) is the page's own, http://HOST. */
bool origin_is_allowed(const char *origin, const char *host);

/* ---- what there is to see (scene.c) ---- */
typedef struct {
    bool known;
    double axes[9]; /* columns: right, up, front of the body in its first pose, in the world */
    float centre_m[3];
    double half_m[3], distance_m;
    float root_m[3]; /* where the root joint is in the first frame */
} view_framing;

typedef struct {
    const char *name;
    const sherf_pose *poses;
    int count;
    double fps;
} view_motion;

typedef struct {
    uint64_t used; /* 0: free */
    int avatar, motion, frame;
    posed_body *body;
} view_posed;

typedef struct {
    int avatar_count, motion_count;
    sherf_viewer_avatar *avatars; /* names are the scene's own */
    view_motion *motions;         /* the first VIEW_OWN_MOTIONS are made here */
    view_framing *framings;       /* avatar_count x motion_count */
    sherf_pose rest;
    view_posed posed[VIEW_POSED];
    uint64_t clock;
    int side_max;
    bool detail;
    char *about; /* JSON */
} view_scene;
sherf_status scene_create(context *c, const sherf_viewer_options *o, view_scene *out);
void scene_free(view_scene *s);
bool wish_fits(const view_scene *s, const view_wish *w);
/* The rest is for the thread that renders. */
sherf_status scene_framing(context *c, view_scene *s, int avatar, int motion, const view_framing **out);
sherf_status scene_posed(context *c, view_scene *s, const view_wish *w, const posed_body **out);
/* camera of w; *scale_m: metres a picture's height spans at the point looked at. */
void scene_camera(const view_scene *s, const view_framing *f, const view_wish *w, sherf_camera *camera,
                  float *scale_m);
/* The observation's picture as PNG. */
sherf_status scene_picture(context *c, const view_scene *s, int avatar, uint8_t **out, size_t *bytes);

/* ---- from a frame to a picture (paint.c) ---- */
typedef struct {
    float focal_px, centre_px[2];
    float near_m, far_m; /* of the depth picture */
} view_optics;
/* color: over black. out: width x height x channels, 3 or 4. scratch: 2 floats a pixel, for normals. */
void paint(const view_wish *w, const view_optics *o, const float *color, const float *opacity,
           const float *depth, int channels, float *scratch, uint8_t *out);

/* ---- the desk (desk.c) ---- */
typedef enum { JOB_WAITING, JOB_RUNNING, JOB_DONE, JOB_REPLACED, JOB_FAILED, JOB_CLOSED } job_state;

/* A picture that a client waits for. */
typedef struct {
    view_wish wish;
    uint64_t sequence;
    int seat;
    int references; /* these two under the desk's lock */
    job_state state;
    void (*wake)(void *arg); /* called once when state has become one of the last four; not under the lock */
    void *wake_arg;
    double asked_s;
    /* of the thread that renders */
    const view_framing *framing; /* NULL: not begun */
    sherf_camera camera;
    float scale_m;
    float *color, *opacity, *depth; /* in one piece, which begins at color */
    int rows_done;
    double render_s;
    int64_t points;
    /* the answer */
    uint8_t *data;
    size_t bytes;
    bool png;
    char message[160];
} view_job;

typedef enum { FILM_NONE, FILM_RUNNING, FILM_DONE, FILM_FAILED } film_state;
typedef struct {
    film_state state;
    bool stop;      /* nobody wants it any more */
    view_wish wish; /* of frame 0 */
    bool turns;     /* round the body; otherwise through the motion */
    int frames, done;
    float fps, speed;
    int fd; /* of the finished file, which has no name any more */
    int64_t bytes;
    char message[160];
    /* of the thread that renders */
    sherf_video *video;
    view_job *job; /* the frame under way */
    char path[64];
} view_film;

typedef struct {
    char name[VIEW_NAME + 1]; /* empty: a free seat */
    double seen_s;
    uint64_t newest; /* sequence */
    view_job *job;   /* waiting or running */
    int jobs;        /* alive, with those whose answer is being sent */
    uint64_t turn;   /* when it was served last */
    view_film film;
} view_client;

typedef struct {
    pthread_mutex_t lock;
    pthread_cond_t news; /* for the thread that renders; monotonic clock */
    view_client client[VIEW_CLIENTS];
    uint64_t turns;
    int turns_since_film;
    bool closed;
} view_desk;

bool desk_open(view_desk *d);
void desk_close(view_desk *d);  /* no more jobs: those that wait are closed and woken */
void desk_finish(view_desk *d); /* after desk_close, when no job is left */
/* The seat of a client, a new one where it has none: one that is free, or whose client was not seen for a
 * while. -1: all are taken. Under the lock. */
int desk_seat(view_desk *d, const char *name);
typedef enum { ADMITTED, ADMITTED_NO_SEAT, ADMITTED_TOO_MANY, ADMITTED_NO_MEMORY } admission;
/* A job, which is the caller's until desk_release; it is put up with desk_submit. */
admission desk_admit(view_desk *d, const view_query *q, view_job **out);
void desk_submit(view_desk *d, view_job *job, void (*wake)(void *arg), void *arg);
void desk_release(view_desk *d, view_job *job);
typedef enum { TURN_NONE, TURN_JOB, TURN_FILM, TURN_CLOSED } view_turn;
/* Whose turn it is; waits for `wait_s` at most. A job is the caller's until desk_release. */
view_turn desk_turn(view_desk *d, double wait_s, view_job **job, int *seat);
/* The end of a job that has not been replaced meanwhile. */
void desk_done(view_desk *d, view_job *job, job_state state);
view_job *job_create(context *c, const view_wish *w);
void job_free(view_job *job);

/* ---- the viewer ---- */
struct sherf_viewer {
    view_scene scene;
    view_desk desk;
    char token[VIEW_TOKEN + 1];
    char address[160];
    char folder[64]; /* of films being written; empty: not made yet */
    struct view_server *server;
    /* of the thread that renders */
    sherf_frame band;
    double pixel_s[VIEW_AVATARS]; /* seconds a pixel, lately; 0: not known */
};
typedef struct sherf_viewer view;

/* ---- rendering (studio.c) ---- */
/* A band of the job's picture; *complete when that was the last. */
sherf_status job_render(context *c, view *v, view_job *job, bool *complete);
/* To 8 bit, by the wish's mode. Freed with mem_free. */
sherf_status job_paint(context *c, const view_job *job, int channels, uint8_t **out);

/* ---- films (film.c) ---- */
/* Under the desk's lock. NULL, or what is wrong. */
const char *film_start(view *v, int seat, const view_query *q);
void film_drop(view *v, int seat);
/* The thread that renders: one band of a film. */
void film_render(context *c, view *v, int seat);
void films_close(view *v);

/* ---- HTTP (server.c) ---- */
sherf_status server_open(context *c, view *v, const char *listen, int port);
void server_tend(struct view_server *s); /* ends connections that take too long; now and then */
void server_close(struct view_server *s);
extern _Atomic double server_patience; /* factor of all time limits but that of silence; tests lower it */

/* ---- the page (made by the build of web/) ---- */
typedef struct {
    const char *name, *type;
    const unsigned char *data;
    size_t bytes;
} view_file;
extern const view_file view_files[];
extern const int view_file_count;

#endif
