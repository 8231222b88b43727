/* The desk between clients that request pictures and the thread that makes them. */
#include <errno.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "viewer/viewer.h"

static const double gone_s = 20; /* a client that was silent for this long loses its seat to a new one */
static const int film_every = 3; /* a film gets one turn after this many turns of pictures */

bool desk_open(viewer_desk *d) {
    pthread_condattr_t monotonic;
    *d = (viewer_desk){0};
    if (pthread_mutex_init(&d->lock, NULL)) return false;
    pthread_condattr_init(&monotonic);
    pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
    bool good = pthread_cond_init(&d->news, &monotonic) == 0;
    pthread_condattr_destroy(&monotonic);
    if (!good) pthread_mutex_destroy(&d->lock);
    return good;
}

viewer_job *job_create(context *c, const viewer_request *w) {
    viewer_job *job = mem_zero(c, 1, sizeof *job);
    if (job) job->request = *w;
    return job;
}

void job_free(viewer_job *job) {
    if (!job) return;
    mem_free(job->color);
    mem_free(job->data);
    mem_free(job);
}

/* True: that was the last reference, and the caller frees the job, not under the lock. */
static bool let_go(viewer_desk *d, viewer_job *job) {
    if (--job->references) return false;
    d->client[job->seat].jobs--;
    return true;
}

/* Takes the job off its client. */
static void conclude(viewer_desk *d, viewer_job *job, job_state state) {
    job->state = state;
    d->client[job->seat].job = NULL;
}

void desk_release(viewer_desk *d, viewer_job *job) {
    pthread_mutex_lock(&d->lock);
    bool last = let_go(d, job);
    pthread_mutex_unlock(&d->lock);
    if (last) job_free(job);
}

int desk_seat(viewer_desk *d, const char *name) {
    double now = time_seconds();
    int seat = -1;
    for (int i = 0; i < VIEWER_CLIENTS && seat < 0; i++)
        if (strcmp(d->client[i].name, name) == 0) seat = i;
    for (int i = 0; i < VIEWER_CLIENTS && seat < 0; i++)
        if (!d->client[i].name[0]) seat = i;
    for (int i = 0; i < VIEWER_CLIENTS && seat < 0; i++) {
        const viewer_client *k = &d->client[i];
        if (!k->jobs && k->film.state != FILM_RUNNING && now - k->seen_s > gone_s) seat = i;
    }
    if (seat < 0) return -1;
    viewer_client *k = &d->client[seat];
    if (strcmp(k->name, name) != 0) {
        if (k->film.state == FILM_DONE) close(k->film.fd);
        *k = (viewer_client){0};
        memcpy(k->name, name, strlen(name) + 1);
    }
    k->seen_s = now;
    return seat;
}

admission desk_admit(viewer_desk *d, const viewer_query *q, viewer_job **out) {
    context quiet = {0};
    admission answer = ADMITTED;
    viewer_job *job = job_create(&quiet, &q->request);
    *out = NULL;
    if (!job) return ADMITTED_NO_MEMORY;
    job->sequence = q->sequence;
    pthread_mutex_lock(&d->lock);
    job->seat = desk_seat(d, q->client);
    if (job->seat < 0)
        answer = ADMITTED_NO_SEAT;
    else if (d->client[job->seat].jobs >= VIEWER_JOBS_EACH)
        answer = ADMITTED_TOO_MANY;
    else {
        d->client[job->seat].jobs++;
        job->references = 1;
    }
    pthread_mutex_unlock(&d->lock);
    if (answer == ADMITTED)
        *out = job;
    else
        job_free(job);
    return answer;
}

void desk_submit(viewer_desk *d, viewer_job *job, void (*wake)(void *arg), void *arg) {
    viewer_job *older = NULL;
    bool last = false;
    pthread_mutex_lock(&d->lock);
    viewer_client *k = &d->client[job->seat];
    job->wake = wake;
    job->wake_arg = arg;
    job->asked_s = time_seconds();
    if (d->closed || job->sequence < k->newest) { /* requests may overtake each other */
        job->state = d->closed ? JOB_CLOSED : JOB_REPLACED;
    } else {
        older = k->job;
        if (older) conclude(d, older, JOB_REPLACED);
        k->newest = job->sequence;
        k->job = job;
        job->references++;
        pthread_cond_signal(&d->news);
    }
    job_state state = job->state;
    pthread_mutex_unlock(&d->lock);
    if (state != JOB_WAITING) wake(arg);
    if (!older) return;
    older->wake(older->wake_arg);
    pthread_mutex_lock(&d->lock);
    last = let_go(d, older);
    pthread_mutex_unlock(&d->lock);
    if (last) job_free(older);
}

/* The client that waits for a picture and whose last turn was longest ago; -1: none waits. */
static int next_client(const viewer_desk *d) {
    int best = -1;
    for (int i = 0; i < VIEWER_CLIENTS; i++)
        if (d->client[i].job && (best < 0 || d->client[i].turn < d->client[best].turn)) best = i;
    return best;
}

static int next_film(const viewer_desk *d) {
    int best = -1;
    for (int i = 0; i < VIEWER_CLIENTS; i++)
        if (d->client[i].film.state == FILM_RUNNING && (best < 0 || d->client[i].turn < d->client[best].turn))
            best = i;
    return best;
}

viewer_turn desk_turn(viewer_desk *d, double wait_s, viewer_job **job, int *seat) {
    struct timespec until;
    clock_gettime(CLOCK_MONOTONIC, &until);
    double end = (double)until.tv_sec + 1e-9 * (double)until.tv_nsec + wait_s;
    until.tv_sec = (time_t)end;
    until.tv_nsec = (long)(1e9 * (end - (double)until.tv_sec));
    viewer_turn turn = TURN_NONE;
    *job = NULL;
    pthread_mutex_lock(&d->lock);
    for (;;) {
        int client = next_client(d), film = next_film(d);
        if (d->closed) {
            turn = TURN_CLOSED;
        } else if (film >= 0 && (client < 0 || d->turns_since_film >= film_every)) {
            turn = TURN_FILM;
            *seat = film;
            d->turns_since_film = 0;
        } else if (client >= 0) {
            turn = TURN_JOB;
            *seat = client;
            *job = d->client[client].job;
            (*job)->references++;
            (*job)->state = JOB_RUNNING;
            d->turns_since_film++;
        }
        if (turn == TURN_JOB || turn == TURN_FILM) d->client[*seat].turn = ++d->turns;
        if (turn != TURN_NONE || pthread_cond_timedwait(&d->news, &d->lock, &until) == ETIMEDOUT) break;
    }
    pthread_mutex_unlock(&d->lock);
    return turn;
}

void desk_done(viewer_desk *d, viewer_job *job, job_state state) {
    pthread_mutex_lock(&d->lock);
    bool ours = job->state == JOB_RUNNING;
    if (ours) conclude(d, job, state);
    pthread_mutex_unlock(&d->lock);
    if (!ours) return;
    job->wake(job->wake_arg);
    desk_release(d, job);
}

void desk_close(viewer_desk *d) {
    viewer_job *left[VIEWER_CLIENTS];
    int count = 0;
    pthread_mutex_lock(&d->lock);
    d->closed = true;
    for (int i = 0; i < VIEWER_CLIENTS; i++)
        if (d->client[i].job) {
            left[count] = d->client[i].job;
            conclude(d, left[count++], JOB_CLOSED);
        }
    pthread_cond_signal(&d->news);
    pthread_mutex_unlock(&d->lock);
    for (int i = 0; i < count; i++) {
        left[i]->wake(left[i]->wake_arg);
        desk_release(d, left[i]);
    }
}

void desk_finish(viewer_desk *d) {
    pthread_cond_destroy(&d->news);
    pthread_mutex_destroy(&d->lock);
}
