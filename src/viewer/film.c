/* Films: the motion, or a turn round the body, as MP4. They are written to a temporary folder. A finished one
 * is unlinked at once and stays as an open file, which ends with the program. */
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "io/image.h"
#include "viewer/viewer.h"

enum { FILMS_MAX = 4 };

const char *film_start(viewer *v, int seat, const viewer_query *q) {
    viewer_film *f = &v->desk.client[seat].film;
    const viewer_motion *motion = &v->scene.motions[q->request.motion];
    int films = 0, frames = q->film_frames;
    for (int i = 0; i < VIEWER_CLIENTS; i++) films += i != seat && v->desk.client[i].film.state != FILM_NONE;
    if (films >= FILMS_MAX) return "too many films at once: try again later";
    if (f->state == FILM_RUNNING) return "a film is being made already";
    const int w = q->request.width, h = q->request.height;
    if ((w < h ? w : h) > VIEWER_FILM_SIDE || w > VIEWER_FILM_LONG || h > VIEWER_FILM_LONG)
        return "the film is too large";
    if (!frames) {
        if (motion->count < 2) return "this is a pose, not a motion: make a turntable";
        double fps = motion->fps > 0 ? motion->fps : 1;
        double wanted = ceil((double)motion->count / fps / q->film_speed * q->film_fps);
        if (wanted > VIEWER_FILM_FRAMES) return "the film would be too long: raise the speed";
        frames = wanted < 1 ? 1 : (int)wanted;
    }
    film_drop(v, seat);
    *f = (viewer_film){.state = FILM_RUNNING,
                       .request = q->request,
                       .turns = q->film_frames > 0,
                       .frames = frames,
                       .fps = q->film_fps,
                       .speed = q->film_speed,
                       .fd = -1};
    f->request.transparent = false;
    pthread_cond_signal(&v->desk.news);
    return NULL;
}

void film_drop(viewer *v, int seat) {
    viewer_film *f = &v->desk.client[seat].film;
    if (f->state == FILM_RUNNING) {
        f->stop = true;
        return;
    }
    if (f->state == FILM_DONE) close(f->fd);
    *f = (viewer_film){0};
}

static viewer_request frame_request(const viewer *v, const viewer_film *f) {
    viewer_request r = f->request;
    const viewer_motion *motion = &v->scene.motions[r.motion];
    if (f->turns) {
        r.azimuth_rad += (float)(2 * M_PI * f->done / f->frames);
    } else {
        double fps = motion->fps > 0 ? motion->fps : 1,
               at = floor(f->done / (double)f->fps * f->speed * fps + 1e-6);
        r.frame = at < motion->count ? (int)at : motion->count - 1;
    }
    return r;
}

static sherf_status video_start(context *c, viewer *v, viewer_film *f) {
    static atomic_int number;
    if (!v->folder[0]) {
        const char *base = getenv("TMPDIR");
        if (!base || strlen(base) > 30 || access(base, W_OK)) base = "/tmp";
        snprintf(v->folder, sizeof v->folder, "%s/sherf-view-XXXXXX", base);
        if (!mkdtemp(v->folder)) {
            v->folder[0] = 0;
            return failure(c, SHERF_WRITE_FAILED, "%s: cannot make a folder for the film: %s", base,
                           strerror(errno));
        }
    }
    snprintf(f->path, sizeof f->path, "%.48s/%d.mp4", v->folder, atomic_fetch_add(&number, 1) % 1000000);
    return sherf_video_open(c, f->path, f->request.width, f->request.height, f->fps, &f->video);
}

static sherf_status frame_add(context *c, viewer_film *f) {
    const viewer_job *job = f->job;
    size_t n = 3 * (size_t)job->request.width * (size_t)job->request.height;
    uint8_t *rgb;
    sherf_status status = job_paint(c, job, 3, &rgb);
    if (status != SHERF_OK) return status;
    sherf_image picture = {job->request.width, job->request.height, 3, job->color}; /* reuses the memory */
    for (size_t i = 0; i < n; i++) picture.data[i] = (float)rgb[i] / 255;
    mem_free(rgb);
    return sherf_video_add(c, f->video, &picture);
}

/* Closes the video and keeps only the open file. */
static sherf_status video_end(context *c, viewer_film *f, int *fd, int64_t *bytes) {
    sherf_status status = sherf_video_close(c, f->video);
    struct stat st;
    f->video = NULL;
    if (status != SHERF_OK) return status;
    *fd = open(f->path, O_RDONLY | O_CLOEXEC);
    unlink(f->path);
    if (*fd < 0 || fstat(*fd, &st)) {
        if (*fd >= 0) close(*fd);
        return failure(c, SHERF_WRITE_FAILED, "%s: cannot be read again: %s", f->path, strerror(errno));
    }
    *bytes = st.st_size;
    return SHERF_OK;
}

static void let_go(viewer_film *f) {
    sherf_video_abort(f->video);
    job_free(f->job);
    f->video = NULL;
    f->job = NULL;
}

/* The fields up to `done` change under the lock, the others are this thread's while the film is running. */
void film_render(context *c, viewer *v, int seat) {
    viewer_film *f = &v->desk.client[seat].film;
    bool complete = false;
    int fd = -1;
    int64_t bytes = 0;
    sherf_status status = SHERF_OK;
    pthread_mutex_lock(&v->desk.lock);
    bool stop = f->stop;
    pthread_mutex_unlock(&v->desk.lock);
    if (!stop && !f->video) status = video_start(c, v, f);
    if (!stop && status == SHERF_OK && !f->job) {
        viewer_request w = frame_request(v, f);
        f->job = job_create(c, &w);
        if (!f->job) status = SHERF_NO_MEMORY;
    }
    if (!stop && status == SHERF_OK) status = job_render(c, v, f->job, &complete);
    if (status == SHERF_OK && complete) {
        status = frame_add(c, f);
        job_free(f->job);
        f->job = NULL;
    }
    bool last = complete && f->done + 1 == f->frames;
    if (status == SHERF_OK && last) status = video_end(c, f, &fd, &bytes);
    if (stop || status != SHERF_OK) let_go(f);
    pthread_mutex_lock(&v->desk.lock);
    if (complete) f->done++;
    if (status != SHERF_OK) {
        f->state = FILM_FAILED;
        snprintf(f->message, sizeof f->message, "%.150s", c->message);
    } else if (last) {
        f->fd = fd;
        f->bytes = bytes;
        f->state = FILM_DONE;
    }
    if (stop) *f = (viewer_film){0};
    if (f->stop && f->state != FILM_RUNNING) { /* requested while it was ending */
        if (f->state == FILM_DONE) close(f->fd);
        *f = (viewer_film){0};
    }
    pthread_mutex_unlock(&v->desk.lock);
}

void films_close(viewer *v) {
    for (int i = 0; i < VIEWER_CLIENTS; i++) {
        viewer_film *f = &v->desk.client[i].film;
        let_go(f);
        if (f->state == FILM_DONE) close(f->fd);
        *f = (viewer_film){0};
    }
    if (v->folder[0]) rmdir(v->folder);
}
