/* The public viewer, and the loop of the thread that renders. */
#include <stdio.h>
#include <string.h>

#include "viewer/viewer.h"

sherf_status sherf_viewer_create(sherf_context *c, const sherf_viewer_options *options, sherf_viewer **out) {
    *out = NULL;
    viewer *v = mem_zero(c, 1, sizeof *v);
    if (!v) return SHERF_NO_MEMORY;
    if (!desk_open(&v->desk)) {
        mem_free(v);
        return failure(c, SHERF_NO_MEMORY, "out of memory");
    }
    sherf_status status = scene_create(c, options, &v->scene);
    if (status == SHERF_OK) status = token_make(c, v->token);
    if (status == SHERF_OK) status = live_open(c, v);
    if (status == SHERF_OK) status = server_open(c, v, options->listen, options->port);
    if (status != SHERF_OK) {
        sherf_viewer_free(v);
        return status;
    }
    *out = v;
    return SHERF_OK;
}

/* One turn of a job. */
static void serve(context *c, viewer *v, viewer_job *job) {
    bool complete;
    sherf_status status = job_render(c, v, job, &complete);
    if (status == SHERF_OK && complete) {
        double begun = time_seconds();
        status = job_encode(c, job);
        job->render_s += time_seconds() - begun;
    }
    if (status != SHERF_OK) {
        snprintf(job->message, sizeof job->message, "%.150s", c->message);
        desk_done(&v->desk, job, status == SHERF_CANCELLED ? JOB_CLOSED : JOB_FAILED);
    } else if (complete) {
        desk_done(&v->desk, job, JOB_DONE);
    }
}

sherf_status sherf_viewer_run(sherf_context *c, sherf_viewer *v) {
    double tended = 0;
    while (!cancelled(c)) {
        viewer_job *job;
        int seat;
        viewer_turn turn = desk_turn(&v->desk, 0.1, &job, &seat);
        if (turn == TURN_CLOSED) break;
        if (turn == TURN_FILM) film_render(c, v, seat);
        if (turn == TURN_JOB) {
            serve(c, v, job);
            desk_release(&v->desk, job);
        }
        if (time_seconds() - tended > 0.25) {
            server_tend(v->server);
            tended = time_seconds();
        }
    }
    return SHERF_OK;
}

const char *sherf_viewer_address(const sherf_viewer *v) {
    return v->address;
}

void sherf_viewer_free(sherf_viewer *v) {
    if (!v) return;
    desk_close(&v->desk); /* the server stops only when no request is suspended */
    server_close(v->server);
    live_close(v);
    films_close(v);
    desk_finish(&v->desk);
    scene_free(&v->scene);
    sherf_frame_free(&v->band);
    mem_free(v);
}
