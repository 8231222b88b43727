/* people: `sherf synth people`: dressed people in poses, drawn into the layout of THuman. */
#ifndef SHERF_PEOPLE_H
#define SHERF_PEOPLE_H

#include "synth/people/dress.h"
#include "synth/people/person_pose.h"

/* Where the CMU clips of Debian's assimp-testmodels lie. */
extern const char people_motions[];
/* The package's poses, as SMPL's, and the motions that are there. A pose named by the community is left out.
 */
sherf_status people_poses(context *c, const studio *s, const char *source, const char *motions,
                          pose_library **out);
/* Pictures of people that are there, one a row, into a PNG; people without pictures are left out. */
sherf_status people_sheet(context *c, const char *folder, int people, const char *const *name, int poses,
                          int views, const char *png);

#endif
