/* person: a person's parameters: shape, skin, hair, clothes and colours, all drawn from one number. */
#ifndef SHERF_PERSON_H
#define SHERF_PERSON_H

#include "synth/body/makehuman.h"
#include "synth/people/wardrobe.h"

/* People from this number on are for tests: they wear outfits and combinations that nobody below it wears. */
static const uint64_t person_test_first = 900000;

enum { PERSON_DETAILS = 24 };

typedef struct {
    uint64_t seed, key;
    makehuman_macro macro;
    int outfit, skin;              /* indices into the tables */
    int hair, brows, lashes, eyes; /* items; hair -1: bald */
    int shoes, hat, glasses;       /* items; hat, glasses -1: none */
    int eye_texture;
    float skin_tint[3];                 /* linear factors */
    float hair_color[3], brow_color[3]; /* sRGB */
    int details;                        /* of the face: targets and their amounts */
    makehuman_detail detail[PERSON_DETAILS];
} person;

/* human (may be NULL: no details of the face) names the targets. */
void person_draw(const makehuman *human, uint64_t seed, person *out);
/* Colours and pattern for part `part` of garment number `layer`. Only small parts, glasses, eyes and some
 * trousers keep the original's colours. */
void person_recipe(const person *p, int layer, wear_kind kind, const dye_part *part, int part_index,
                   dye_recipe *out);

#endif
