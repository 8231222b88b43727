/* photo: for verbs that accept a photo instead of an observation. */
#ifndef CLI_PHOTO_H
#define CLI_PHOTO_H

#include "session.h"

/* A verb's options about photos; 0 and NULL: not given. */
typedef struct {
    int64_t person;
    double focal_px;
    const char *mask, *overlay;
} photo_request;
extern photo_request photo_wanted;

/* The lines for them in a verb's option table. */
#define PHOTO_OPTIONS                                                                                        \
    {0,                                                                                                      \
     "person",                                                                                               \
     OPTION_INTEGER,                                                                                         \
     &photo_wanted.person,                                                                                   \
     "N",                                                                                                    \
     "which of the people in a photo, from the largest, 1",                                                  \
     1,                                                                                                      \
     8},                                                                                                     \
        {0,           "mask",                                                                                \
         OPTION_FILE, &photo_wanted.mask,                                                                    \
         "FILE",      "picture as large as the photo, bright where the person is, hard or soft (found)"},    \
    {                                                                                                        \
        0, "focal-px", OPTION_REAL, &photo_wanted.focal_px, "N",                                             \
            "focal length of the photo at its full size, pixels (EXIF's, or else estimated)", 1, 1e6         \
    }

/* By its first bytes, or by a picture's file ending. */
bool photo_is(const char *path);
#define PHOTO_NETWORKS "models/blazepose.safetensors"
/* The shipped networks' file; NULL, after one line on stderr: it is missing. */
const char *photo_networks(void);
/* Loads them; an exit status. */
int photo_estimator(session *s, sherf_estimator **out);
/* Estimates, prints a line about the result, and a line for each warning. */
int photo_estimate(session *s, const sherf_estimator *n, const sherf_body *body, const char *path,
                   sherf_estimate **out);
/* Estimates all photos, as observations of one person with one shape, at most SHERF_PICTURES_MAX; draws the
 * requested picture. out: NULLs; free them for any result. */
int photo_observations(session *s, const sherf_body *body, int count, const char *const *path,
                       sherf_observation **out);
/* The estimate's facts, for --json. */
cJSON *photo_json(const char *path, const sherf_estimate_facts *f);

#endif
