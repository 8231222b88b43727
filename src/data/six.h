/* six: rotations as six numbers (Zhou et al. 2019): the first two rows of the matrix, one after the other
 * (PyTorch3D, MDM, EDGE), or its first two columns, one after the other (HMR 2) or interleaved (HMR, SPIN,
 * PARE). Rows and columns are each other's inverse rotations: only a word in the file, or the joints that
 * bend one way, show which they are. */
#ifndef SHERF_DATA_SIX_H
#define SHERF_DATA_SIX_H

#include "io/value.h"

enum { SIX = 6 };
typedef enum { SIX_UNKNOWN, SIX_ROWS, SIX_COLUMNS } six_kind;
typedef struct {
    six_kind kind;
    bool woven; /* the two vectors' numbers alternate */
} six_form;
/* What a body's numbers show, summed over joints and frames. Zeros to begin with. */
typedef struct {
    double apart, woven;           /* squared distance from orthonormal, either way */
    double bend_apart, bend_woven; /* of knees and elbows in their own direction, taken as rows */
    int64_t joints, frames;
} six_evidence;

/* How many joints have six numbers each in the value of one frame, by its last axes: 6, 2 x 3 or 3 x 2, or
 * one axis for all. 0: not six, or none of `joints` (up to 0). */
int six_joints(const value *v, const int *joints);
/* The word under "rotations" in a dict, "6d-rows" or "6d-columns"; unknown: there is neither. */
six_kind six_said(const value *dict);
/* One frame: `joints` times six numbers, the first of them of SMPL's joint `first`. */
void six_add(six_evidence *e, const double *numbers, int joints, int first);
/* Fails for numbers that are not orthonormal, and, where nothing is said, for limbs that show nothing. */
sherf_status six_decide(context *c, const char *what, const six_evidence *e, six_kind said, six_form *out);
/* Logs what was found without a word in the file. */
void six_log(context *c, const char *what, const six_form *form);
/* Orthonormalised; fails where that would change them much. */
sherf_status six_matrix(context *c, const char *what, const six_form *form, const double six[SIX],
                        double R[9]);
#endif
