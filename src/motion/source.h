/* source: a motion as a file stores it, before it is made upright, resampled and placed. One file per family
 * of formats; each checks every size and refuses numbers that are not finite. */
#ifndef SHERF_MOTION_SOURCE_H
#define SHERF_MOTION_SOURCE_H

#include "data/parse.h"
#include "io/bvh.h"
#include "motion/motion.h"

typedef struct {
    const char *format; /* "AMASS, SMPL+H"; static */
    char detail[192];   /* further details, such as which track of how many; may be empty */
    clip clip;          /* file's axes; pelvis_m is the translation in the file's unit until it is placed */
    int64_t *number;    /* of each frame, ascending; NULL: one after the other. mem_free'd with the source */
    sherf_up up;        /* usual value of the format */
    double unit_m;      /* metres in the unit of the translations; 0: to be detected */
    bool fps_said;      /* by the file, not assumed */
    bool unplaced;      /* there is no translation in the file */
    /* The translations are the pelvis's place itself; otherwise SMPL's, from which the pelvis at rest is
     * missing: pelvis = J0 + translation. */
    bool is_pelvis;
    bool smplx; /* the translations are SMPL-X's; told before source_frames */
    bool has_shapes;
    float shapes[BODY_SHAPES];
    skeleton skeleton;  /* whose pelvis is meant: of the options' body, or of the file's shapes */
    double pelvis_m[3]; /* at rest in the file's body: J0 above */
} source;

void source_free(source *s);
/* Frames of zeros, and the skeleton, for which shapes must have been read before. */
sherf_status source_frames(context *c, source *s, const sherf_motion_options *o, int64_t frames, double fps);
/* One person's part of an array with a row per person. room: for the row, as long as the part. */
void source_take_person(named_value *part, int64_t people, int64_t person, value *room);
/* The frame rate in a dict or in one of its dicts, under any usual name; fps keeps its value without one. */
sherf_status source_rate(context *c, const value *root, double *fps, bool *said);
/* How many people the rows of one frame are; 1 where there is no axis for them. */
int64_t source_people(const body_parts *p);
/* Whether the value can be the rotations of one frame. */
bool source_is_frame(const value *v);
/* The same of each row of rows of one length. */
bool source_rows_are_frames(const value *rows);
/* Joints to take of a whole body's numbers in a frame: 24 of SMPL's, else the 22 that all bodies share. */
int source_body_joints(int64_t numbers);
/* Shapes of a file, one row or one for every frame (the first is taken). NULL is fine. */
sherf_status source_shapes(context *c, source *s, const value *betas);
/* Reduces the number of frames. */
sherf_status source_numbers(context *c, source *s); /* room for frames' numbers, counting from 0 */

/* ---- rotations (rotations.c) ---- */
enum { ROTATION_JOINTS_MAX = 60 };
/* The option, or for AUTO what the file itself says of six numbers a joint. */
sherf_rotations rotation_said(const body_parts *p, sherf_rotations given);
/* Reads the rows of an array or list, one per frame, into joints `first`, `first` + 1, ... of the clip, at
 * most `max`. */
sherf_status rotation_rows(context *c, const char *what, const value *v, sherf_rotations given,
                           const int *joints, int first, int max, clip *k);
/* The form of a root's quaternions or six numbers: that of the body's, which are many enough to show where
 * the real part is, or whether they are rows. `given` if that is not AUTO, or the body has neither. joints:
 * a list that ends with 0. */
sherf_rotations rotation_root_form(context *c, const value *body, const value *root, int64_t frames,
                                   const int *joints, sherf_rotations given);
/* One frame's: as rotation_rows on a clip of one frame. */
sherf_status rotation_frame(context *c, const char *what, const value *v, sherf_rotations given,
                            const int *joints, int first, int max, float (*turn)[4]);

/* ---- families ---- */
/* Dicts of arrays with a row a frame: AMASS in both forms, AIST++, GVHMR, plain poses. */
bool smpl_file_is(const value *root);
sherf_status smpl_file_read(context *c, const value *root, const sherf_motion_options *o, source *out);
/* Dicts of people, or of frames with people in them: WHAM, PHALP. */
bool track_file_is(const value *root);
sherf_status track_file_read(context *c, const value *root, const sherf_motion_options *o, source *out);
/* JSON a frame: EasyMocap (folder or list), LHM and ExAvatar (folder). */
bool frame_list_is(const value *root);
sherf_status frame_list_read(context *c, const value *root, const sherf_motion_options *o, source *out);
sherf_status frame_folder_read(context *c, const char *path, const sherf_motion_options *o, source *out);
/* The list in a dict that has one list of frames beside other things; else NULL. */
const value *frame_list_within(const value *root);
/* ROMP's results for one picture, a row per person. */
bool picture_is(const value *root);
/* Dicts of dicts: one per frame, by the picture's name (ROMP's videos), or one per person. */
bool nested_file_is(const value *root);
sherf_status nested_file_read(context *c, const value *root, const sherf_motion_options *o, source *out);
/* Bare arrays, and where joints are: HumanML3D, MDM, Motion-X, plain poses. */
bool joints_file_is(const value *root);
sherf_status joints_file_read(context *c, const value *root, const sherf_motion_options *o, source *out);
sherf_status bvh_source_read(context *c, const bvh *b, const sherf_motion_options *o, source *out);

/* A source with the options applied to it: the motion. Frees nothing of the source. */
sherf_status motion_finish(context *c, source *s, const sherf_motion_options *o, sherf_motion **out);
/* A file's content; for tests and fuzzing. */
sherf_status motion_parse(context *c, const unsigned char *data, size_t bytes, const sherf_motion_options *o,
                          sherf_motion **out);

#endif
