/* session: used by every verb: the context, the terminal, results and errors. */
#ifndef CLI_SESSION_H
#define CLI_SESSION_H

#include <cjson/cJSON.h>

#include "options.h"
#include "sherf/sherf.h"

struct session {
    sherf_context *context;
    const char *verb_name;
};

/* Makes the context from the common options and handles Ctrl-C. Returns an exit status. */
int session_open(session *s, const verb *v);
void session_close(session *s);
/* EXIT_DONE for SHERF_OK; otherwise the context's message as one line on stderr, and EXIT_FAILED. */
int session_status(session *s, sherf_status status);
/* The same, with the file's name if the message does not have it. */
int session_status_of(session *s, const char *path, sherf_status status);
/* One line on stderr, EXIT_FAILED. */
int session_failure(const char *format, ...) __attribute__((format(printf, 1, 2)));
/* A remark on stderr, not with --quiet. */
void session_remark(const char *format, ...) __attribute__((format(printf, 1, 2)));
/* A bar on a terminal, otherwise occasional lines; nothing with --quiet. */
void session_progress(const char *text, double done, double total);
bool session_interrupted(void);                  /* by Ctrl-C */
const char *session_precision(const session *s); /* in use: "fp32" or "bf16" */
const char *session_device(const session *s);    /* "cpu" or "cuda" */
/* Prints and deletes `json`. */
void session_json(cJSON *json);
/* Prints a text; with --json, as "text" together with `what` and its path. */
void session_text(const char *what, const char *path, const char *text);

/* The file that an option names: `given`, NULL for "none". If it was not given, the asset `name` from the
 * folder $SHERF_ASSETS, ./assets, beside the program (../assets if built there, ../share/sherf if moved), or
 * the installation's; NULL: none of them has it. */
const char *session_asset(const char *given, const char *name);
/* The resnet50 distance's network, of --perceptual. */
const char *session_perceptual(const char *given);
/* The folders in which it looks, for messages. */
const char *session_asset_places(void);

/* The folder into which `make assets` puts the people's material: here, or next to the program. */
const char *session_people_source(void);

/* The body file for --body: `given`. If it was not given, body.safetensors or tubeman.safetensors in the
 * folder of `data` (an observation, a data set's spec or one of its pictures; may be NULL), otherwise the
 * asset body.safetensors, the open body, with a remark on stderr. NULL, after one line on stderr: there is
 * none. */
const char *session_body(const session *s, const char *given, const char *data);

/* The weights for --model: `given`. If they were not given, the asset models/people.safetensors, the shipped
 * model, with a remark. NULL, after one line on stderr: there are none. */
const char *session_model(const session *s, const char *given);

/* Loads the pictures of one observation, at most SHERF_PICTURES_MAX, for this model: fitted to it
 * (sherf_observation_crop) unless they are to stay whole. out: NULLs; free them for any result. */
int session_observations(session *s, int count, const char *const *path, const sherf_model *model,
                         const sherf_body *body, bool whole, sherf_observation **out);

/* The avatar in `input`: an avatar file, or an observation (a photo, a folder, a .json, a picture of a data
 * set, or anything if `model` is given), encoded by these weights or the shipped ones. */
int session_avatar(session *s, const char *input, const char *model, const sherf_body *body, bool whole,
                   sherf_avatar **out);

/* The body for --body, and the avatar in `input` unless that is NULL: session_body and session_avatar
 * together. The caller frees both for any result. */
int session_person(session *s, const char *input, const char *body, const char *model, bool whole,
                   sherf_body **body_out, sherf_avatar **avatar_out);

double seconds_now(void); /* monotonic */
/* Makes the folder and those above it. */
int session_folder(const char *path);

#endif
