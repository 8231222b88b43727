/* Draws a person's parameters. Each choice has its own random stream, so that a new garment changes only the
 * clothes. */
#include "synth/people/person.h"

#include <math.h>
#include <string.h>

#include "synth/body/open_body.h"

static uint64_t stream(const person *p, const char *name, int index) {
    return random_key(p->key, name, (uint64_t)index);
}

static float between(uint64_t key, uint64_t i, double low, double high) {
    return (float)(low + (high - low) * random_uniform(key, i));
}

/* Draws an item of this kind for these people; -1: there is none. */
static int draw_item(uint64_t key, uint64_t i, wear_kind kind, int whom, bool short_hair, bool boots) {
    int found = 0, which = -1;
    for (int pass = 0; pass < 2; pass++) {
        int64_t left = pass && found ? random_below(key, i, found) : 0;
        for (int k = 0; k < wear_item_count; k++) {
            if (wear_items[k].kind != kind || !(wear_items[k].whom & whom)) continue;
            if ((short_hair && !wear_items[k].short_hair) || (!boots && wear_items[k].boots)) continue;
            if (!pass)
                found++;
            else if (left-- == 0)
                which = k;
        }
    }
    return which;
}

static int draw_outfit(uint64_t key, uint64_t i, int whom, bool test) {
    double sum = 0;
    for (int pass = 0; pass < 2; pass++) {
        double at = sum * random_uniform(key, i);
        int last = -1;
        for (int k = 0; k < outfit_count; k++) {
            if (!(outfits[k].whom & whom) || (outfits[k].test_only && !test)) continue;
            double share = outfits[k].share * (outfits[k].test_only ? 2 : 1);
            if (!pass)
                sum += share;
            else if (at < share)
                return k;
            at -= share;
            last = k;
        }
        if (pass) return last;
    }
    return 0;
}

static int draw_skin(uint64_t key, uint64_t i, int whom, int age, int origin) {
    int found = 0, which = 0;
    for (int pass = 0; pass < 2; pass++) {
        int64_t left = pass && found ? random_below(key, i, found) : 0;
        for (int k = 0; k < skin_count; k++) {
            if (skins[k].whom != whom || skins[k].age != age || skins[k].origin != origin) continue;
            if (!pass)
                found++;
            else if (left-- == 0)
                which = k;
        }
    }
    return which;
}

/* ---- colours ---- */

static void from_hsv(double h, double s, double v, float rgb[3]) {
    for (int k = 0; k < 3; k++) {
        double x = fmod(6 * h + (k == 0 ? 0 : k == 1 ? 4 : 2), 6), level = fabs(x - 3) - 1;
        level = level < 0 ? 0 : level > 1 ? 1 : level;
        rgb[k] = (float)(v * (1 - s * (1 - level)));
    }
}

/* A colour of cloth: neutral, muted or strong. */
static void cloth_color(uint64_t key, uint64_t i, float rgb[3]) {
    double what = random_uniform(key, i), h = random_uniform(key, i + 1), s = random_uniform(key, i + 2),
           v = random_uniform(key, i + 3);
    if (what < 0.3) /* black to white */
        from_hsv(0.08 + 0.5 * h, 0.08 * s, 0.1 + 0.83 * v, rgb);
    else if (what < 0.42) /* blues of denim and navy */
        from_hsv(0.57 + 0.1 * h, 0.35 + 0.4 * s, 0.2 + 0.5 * v, rgb);
    else if (what < 0.54) /* beige, brown, olive */
        from_hsv(0.05 + 0.14 * h, 0.25 + 0.4 * s, 0.25 + 0.55 * v, rgb);
    else if (what < 0.76) /* dull */
        from_hsv(h, 0.2 + 0.35 * s, 0.3 + 0.55 * v, rgb);
    else
        from_hsv(h, 0.55 + 0.4 * s, 0.35 + 0.6 * v, rgb);
}

/* A colour of trousers and shoes: rarely a strong one. */
static void muted_color(uint64_t key, uint64_t i, float rgb[3]) {
    cloth_color(key, i, rgb);
    float mean = (rgb[0] + rgb[1] + rgb[2]) / 3, strength = random_uniform(key, i + 4) < 0.08 ? 1 : 0.5f;
    for (int k = 0; k < 3; k++) rgb[k] = 0.85f * (mean + strength * (rgb[k] - mean));
}

static void leather_color(uint64_t key, uint64_t i, float rgb[3]) {
    double what = random_uniform(key, i), s = random_uniform(key, i + 1), v = random_uniform(key, i + 2);
    if (what < 0.45)
        from_hsv(0.6, 0.05, 0.07 + 0.15 * v, rgb);
    else if (what < 0.75)
        from_hsv(0.05 + 0.04 * s, 0.45 + 0.25 * s, 0.2 + 0.4 * v, rgb);
    else if (what < 0.88) /* white, grey */
        from_hsv(0.6, 0.03, 0.4 + 0.5 * v, rgb);
    else
        muted_color(key, i + 3, rgb);
}

static void hair_colors(person *p, uint64_t key) {
    static const float natural[][3] = {{0.11f, 0.1f, 0.1f},   {0.15f, 0.11f, 0.09f}, {0.21f, 0.14f, 0.09f},
                                       {0.33f, 0.22f, 0.13f}, {0.47f, 0.33f, 0.19f}, {0.66f, 0.51f, 0.31f},
                                       {0.75f, 0.64f, 0.45f}, {0.44f, 0.19f, 0.09f}, {0.52f, 0.5f, 0.48f},
                                       {0.78f, 0.77f, 0.75f}};
    bool dark = p->macro.caucasian < 0.5;
    int which = (int)(dark ? random_below(key, 0, 3) : random_below(key, 0, 8));
    double grey = (p->macro.age_years - 40) / 35; /* chance */
    if (random_uniform(key, 1) < grey) which = random_uniform(key, 2) < 0.5 ? 8 : 9;
    bool dyed = p->macro.age_years < 50 && random_uniform(key, 3) < 0.06;
    for (int k = 0; k < 3; k++) p->hair_color[k] = natural[which][k] * between(key, 4, 0.85, 1.15);
    for (int k = 0; k < 3; k++) p->brow_color[k] = 0.8f * p->hair_color[k];
    if (dyed) from_hsv(random_uniform(key, 5), 0.5 + 0.3 * random_uniform(key, 6), 0.5, p->hair_color);
}

/* Textures are sorted by name: blue, blue-green, brown, light brown, ... */
static int draw_eyes(uint64_t key, uint64_t i, int origin) {
    enum { BROWN = 2, ALL = 9 };
    double what = random_uniform(key, i), brown = origin == 2 ? 0.35 : 0.97;
    if (what < brown) return BROWN + (what > 0.75 * brown);
    return (int)random_below(key, i + 100, ALL);
}

/* ---- the person ---- */

/* Face targets may have any strength; their names begin like this. */
static void draw_face(const makehuman *human, uint64_t key, person *p) {
    static const char *const group[] = {"head/",  "forehead/", "eyebrows/", "eyes/", "nose/",
                                        "mouth/", "ears/",     "chin/",     "cheek/"};
    if (!human) return;
    for (uint64_t i = 0; i < PERSON_DETAILS * 4 && p->details < PERSON_DETAILS / 2; i++) {
        int target = (int)random_below(key, 3 * i, human->targets);
        bool face = false;
        for (size_t g = 0; g < COUNT_OF(group); g++)
            face |= !strncmp(human->target[target].name, group[g], strlen(group[g]));
        if (!face || human->target[target].factors || strstr(human->target[target].name, "head-age"))
            continue;
        double weight = 0.35 * random_uniform(key, 3 * i + 1);
        p->detail[p->details++] = (makehuman_detail){target, weight};
    }
}

static void draw_combination(person *p, int whom) {
    bool test = p->seed >= person_test_first;
    int age = p->macro.age_years < 38 ? 0 : p->macro.age_years < 58 ? 1 : 2;
    int origin = p->macro.african > p->macro.asian ? (p->macro.african > p->macro.caucasian ? 0 : 2)
                                                   : (p->macro.asian > p->macro.caucasian ? 1 : 2);
    uint64_t key = stream(p, "person.combination", 0);
    p->hat = random_uniform(key, 0) < 0.1 ? draw_item(key, 1, WEAR_HAT, whom, false, false) : -1;
    for (uint64_t i = 2;; i += 4) { /* at least a fifth on either side */
        p->outfit = draw_outfit(key, i, whom, test);
        p->skin = draw_skin(key, i + 1, whom, age, origin);
        p->hair = draw_item(key, i + 2, WEAR_HAIR, whom, p->hat >= 0, false);
        if (whom == FOR_MEN && p->hat < 0 && random_uniform(key, i + 3) < 0.04 + 0.12 * (age == 2))
            p->hair = -1;
        if (wardrobe_kept_for_tests(p->outfit, p->skin, p->hair) == test) return;
    }
}

void person_draw(const makehuman *human, uint64_t seed, person *p) {
    memset(p, 0, sizeof *p);
    p->seed = seed;
    p->key = random_key(seed, "person", 0);
    open_body_adult(stream(p, "person.shape", 0), &p->macro);
    p->macro.sex = p->macro.sex < 0.5 ? 0.35 * p->macro.sex : 1 - 0.35 * (1 - p->macro.sex);
    int whom = p->macro.sex < 0.5 ? FOR_WOMEN : FOR_MEN;
    draw_combination(p, whom);
    uint64_t key = stream(p, "person.rest", 0);
    p->brows = draw_item(key, 0, WEAR_BROWS, whom, false, false);
    p->lashes = draw_item(key, 1, WEAR_LASHES, whom, false, false);
    p->eyes = draw_item(key, 2, WEAR_EYES, whom, false, false);
    p->shoes = draw_item(key, 3, WEAR_SHOES, whom, false, !strcmp(outfits[p->outfit].item[0], "Tightjeans"));
    p->glasses = random_uniform(key, 4) < 0.1 ? draw_item(key, 5, WEAR_GLASSES, whom, false, false) : -1;
    p->eye_texture = draw_eyes(key, 6, skins[p->skin].origin);
    float tone = between(key, 7, 0.8, 1.12), warm = between(key, 8, -0.05, 0.05);
    for (int k = 0; k < 3; k++) p->skin_tint[k] = tone * (1 + warm * (float)(1 - k));
    hair_colors(p, stream(p, "person.hair", 0));
    draw_face(human, stream(p, "person.face", 0), p);
}

/* ---- clothes ---- */

static void shoe_recipe(uint64_t key, const dye_part *part, dye_recipe *r) {
    if (part->share < 0.08f) return;
    r->pattern = DYE_PLAIN;
    leather_color(key, 10, r->color[0]);
    r->detail = 0.9f;
}

void person_recipe(const person *p, int layer, wear_kind kind, const dye_part *part, int part_index,
                   dye_recipe *r) {
    uint64_t key = random_key(stream(p, "person.dye", layer), "part", (uint64_t)part_index);
    *r = (dye_recipe){.pattern = DYE_KEEP, .value = 1, .key = key, .ratio = between(key, 0, 0.25, 0.65)};
    float middle = 0.5f * (part->low[1] + part->high[1]);
    bool legs = kind == WEAR_BOTTOM || (kind == WEAR_SUIT && middle < 0.02f);
    if (kind == WEAR_GLASSES || kind == WEAR_EYES) return;
    if (kind == WEAR_SHOES) {
        shoe_recipe(key, part, r);
        return;
    }
    if (part->share < 0.015f) return; /* buttons, buckles */
    double what = random_uniform(key, 1);
    for (uint64_t k = 0; k < 3; k++)
        legs ? muted_color(key, 20 + 8 * k, r->color[k]) : cloth_color(key, 20 + 8 * k, r->color[k]);
    r->scale_m = (float)exp(log(0.02) + (log(0.16) - log(0.02)) * random_uniform(key, 2));
    r->detail = between(key, 3, 0.7, 1);
    if (legs && what < 0.4) { /* denim in other shades */
        r->value = between(key, 4, 0.5, 1.25);
        r->hue_turn = between(key, 5, -0.04, 0.04);
    } else if (what < (legs ? 0.88 : kind == WEAR_COAT || kind == WEAR_HAT ? 0.8 : 0.35)) {
        r->pattern = DYE_PLAIN;
    } else {
        r->pattern = (dye_pattern)(DYE_BANDS + random_below(key, 6, DYE_PATTERNS - DYE_BANDS));
        if (r->pattern == DYE_CLOUDS) r->scale_m += 0.04f;
        if (r->pattern == DYE_SPECKS) r->scale_m = fminf(r->scale_m, 0.07f);
    }
}
