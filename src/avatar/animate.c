/* An avatar moving: frames rendered here, written on another thread. */
#include <stdio.h>
#include <string.h>

#include "base/path.h"
#include "avatar/frame_queue.h"
#include "motion/motion.h"

/* ---- where frames go ---- */

typedef struct {
    const char *output;
    sherf_video *video; /* NULL: a folder of pictures */
    int written;
} target;

static sherf_status write_frame(context *c, void *user, int n, const sherf_image *image) {
    target *t = user;
    char path[PATH_LENGTH];
    sherf_status status;
    if (t->video) {
        status = sherf_video_add(c, t->video, image);
    } else {
        if (snprintf(path, sizeof path, "%s/frame_%04d.png", t->output, n) >= (int)sizeof path)
            return failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", t->output);
        status = sherf_image_write(c, path, image);
    }
    if (!status) t->written++;
    return status;
}

/* Finishes the file with the frames written so far, even when some are missing. */
static sherf_status target_close(context *c, target *t) {
    sherf_video *video = t->video;
    t->video = NULL;
    if (!video) return SHERF_OK;
    if (t->written) return sherf_video_close(c, video);
    sherf_video_abort(video);
    return SHERF_OK;
}

/* ---- frames ---- */

typedef struct {
    const sherf_avatar *avatar;
    const sherf_body *body;
    const sherf_motion *motion;
    const sherf_animate_options *o;
    sherf_camera *camera;
    sherf_frame frame;
    int rendered;
    double render_s, points;
} job;

static sherf_status render_frame(context *c, job *j, int n, sherf_image *out) {
    sherf_render_options render = j->o->render;
    sherf_pose pose;
    if (j->o->transparent) memset(render.background, 0, sizeof render.background);
    sherf_motion_pose(j->motion, n, &pose);
    double begun_s = time_seconds();
    sherf_status status = sherf_render(c, j->avatar, j->body, &pose, &j->camera[n], &render, &j->frame);
    if (status) return status;
    j->render_s += time_seconds() - begun_s;
    j->points += (double)j->frame.points;
    j->rendered++;
    if (j->o->transparent) return sherf_frame_rgba(c, &j->frame, out);
    const sherf_image *color = &j->frame.color;
    memcpy(out->data, color->data, (size_t)color->width * (size_t)color->height * 3 * sizeof *out->data);
    return SHERF_OK;
}

/* Renders into the queue until everything is done, the writer fails or somebody cancels. */
static sherf_status render_all(context *c, job *j, frame_queue *q) {
    int frames = sherf_motion_frame_count(j->motion);
    sherf_status status = progress(c, "frames", 0, frames);
    for (int n = 0; n < frames && !status; n++) {
        sherf_image *slot = frame_queue_slot(q);
        if (!slot) break;
        status = render_frame(c, j, n, slot);
        if (status) break;
        frame_queue_push(q);
        status = progress(c, "frames", n + 1, frames);
        if (n + 1 == frames) status = SHERF_OK; /* too late to stop */
    }
    return status;
}

static sherf_status run(context *c, job *j, target *t) {
    const sherf_camera *k = &j->camera[0];
    frame_queue *q;
    sherf_status status = SHERF_OK;
    const sherf_output kind = sherf_output_kind(t->output);
    if (kind == SHERF_OUTPUT_PICTURE || kind == SHERF_OUTPUT_UNKNOWN)
        return failure(c, SHERF_BAD_ARGUMENT,
                       "%s: a motion goes into .mp4, .webm, .mov or .gif, or a folder of pictures",
                       t->output);
    if (kind == SHERF_OUTPUT_VIDEO) {
        const sherf_video_options video = {.width = k->width_px,
                                           .height = k->height_px,
                                           .fps = sherf_motion_fps(j->motion),
                                           .alpha = j->o->transparent};
        status = sherf_video_create(c, t->output, &video, &t->video);
    } else
        status = folder_make(c, t->output);
    if (!status)
        status =
            frame_queue_create(c, k->width_px, k->height_px, j->o->transparent ? 4 : 3, write_frame, t, &q);
    if (status) return status;
    status = render_all(c, j, q);
    char message[sizeof c->message];
    memcpy(message, c->message, sizeof message);
    sherf_status written = frame_queue_end(c, q);
    bool stopped = status == SHERF_CANCELLED;
    if (written) return written;
    if (status && !stopped) return failure(c, status, "%s", message);
    status = target_close(c, t);
    if (stopped && !status)
        status = failure(c, SHERF_CANCELLED, "%s: stopped after %d of %d frames%s", t->output, t->written,
                         sherf_motion_frame_count(j->motion), t->written ? "; these are there" : "");
    return status;
}

sherf_status sherf_animate(sherf_context *c, const sherf_avatar *avatar, const sherf_body *body,
                           const sherf_motion *motion, const sherf_animate_options *options,
                           const char *output, sherf_animate_result *result) {
    static const sherf_animate_options none;
    job j = {avatar, body, motion, options ? options : &none};
    target t = {.output = output};
    j.camera = mem_alloc(c, (size_t)motion->clip.frames, sizeof *j.camera);
    sherf_status status = j.camera ? SHERF_OK : SHERF_NO_MEMORY;
    if (!status) status = sherf_animate_cameras(c, avatar, body, motion, j.o, j.camera);
    if (!status) status = run(c, &j, &t);
    if (t.video) sherf_video_abort(t.video);
    if (result) {
        int n = j.rendered ? j.rendered : 1;
        *result = (sherf_animate_result){t.written, 1e3 * j.render_s / n, j.points / n};
    }
    sherf_frame_free(&j.frame);
    mem_free(j.camera);
    return status;
}
