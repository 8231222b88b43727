/* export: baked avatars in the formats of other programs. A format is one file that defines an export_format,
 * and its name in EXPORT_FORMATS. */
#ifndef SHERF_EXPORT_H
#define SHERF_EXPORT_H

#include "baked/person.h"

typedef struct {
    const char *path;
    const char *axes; /* the person's axes, a line for the file */
    const baked_person *person;
    const body_model *body;
    const sherf_export_options *options; /* pose, motion, lit */
} export_job;

typedef struct {
    const char *name;   /* in sherf_export_options.format */
    const char *ending; /* of file names, with the dot; NULL: chosen only by name */
    bool texture;       /* has a texture, unless the options request vertex colours */
    bool splats;        /* takes splats instead of a surface */
    bool rigged;        /* the surface is bound in the rest pose, +y up; joints hold the pose, and a motion */
    sherf_status (*write)(context *c, const export_job *job); /* completely or not at all */
} export_format;

#define EXPORT_FORMATS(X) X(glb) X(obj) X(ply) X(splats)
#define EXPORT_DECLARE(name) extern const export_format export_##name;
EXPORT_FORMATS(EXPORT_DECLARE)

#endif
