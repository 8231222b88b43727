/* people: `sherf synth people`: dressed people in poses, drawn into the layout of THuman. */
#ifndef SHERF_PEOPLE_H
#define SHERF_PEOPLE_H

#include "synth/people/dress.h"
#include "synth/people/person_pose.h"

/* The folder of the CMU clips in Debian's assimp-testmodels. */
extern const char people_motions[];
/* Adds the package's poses, converted to SMPL's, and the motions that exist. Poses that the community made
 * are left out. */
sherf_status people_poses(context *c, const studio *s, const char *source, const char *motions,
                          pose_library **out);
/* Draws pictures of existing people, one person in each row, into a PNG; leaves out people without pictures.
 */
sherf_status people_sheet(context *c, const char *folder, int people, const char *const *name, int poses,
                          int views, const char *png);

#endif
