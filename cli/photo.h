/* photo: verbs that take a photo where they take an observation. */
#ifndef CLI_PHOTO_H
#define CLI_PHOTO_H

#include "session.h"

/* What a verb's options say about photos; 0 and NULL: nothing. */
typedef struct {
    int64_t person;
    double focal_px;
    const char *mask, *overlay;
} photo_request;
extern photo_request photo_wanted;

/* The lines of a verb's table of options for them. */
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

/* By its first bytes, or by a name that pictures have. */
bool photo_is(const char *path);
#define PHOTO_NETWORKS "models/blazepose.safetensors"
/* The networks that ship; NULL, after one line on stderr: they are not there. */
const char *photo_networks(void);
/* Loads them; an exit status. */
int photo_estimator(session *s, sherf_estimator **out);
/* Estimates and says in a line what was found, and a line each warning. */
int photo_estimate(session *s, const sherf_estimator *n, const sherf_body *body, const char *path,
                   sherf_estimate **out);
/* All of it, to observations of one person, at most SHERF_PICTURES_MAX, of one shape; with the drawing that
 * was requested. out: NULLs; theirs to free, whatever the answer. */
int photo_observations(session *s, const sherf_body *body, int count, const char *const *path,
                       sherf_observation **out);
/* What was found, for --json. */
cJSON *photo_json(const char *path, const sherf_estimate_facts *f);

#endif
