/* The public viewer. */
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

const char *sherf_viewer_address(const sherf_viewer *v) {
    return v->address;
}

void sherf_viewer_free(sherf_viewer *v) {
    if (!v) return;
    desk_close(&v->desk); /* the server stops only when no request is laid aside */
    server_close(v->server);
    live_close(v);
    films_close(v);
    desk_finish(&v->desk);
    scene_free(&v->scene);
    sherf_frame_free(&v->band);
    mem_free(v);
}
