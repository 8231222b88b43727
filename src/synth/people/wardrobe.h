/* wardrobe: the things that people may wear, by name: the MakeHuman team's own things (CC0 since 2020) and
 * community things under CC-BY, whose authors assets/LICENSES.md names. Nothing else in the package is ever
 * opened. */
#ifndef SHERF_WARDROBE_H
#define SHERF_WARDROBE_H

#include "synth/people/dye.h"
#include "synth/people/proxy.h"

typedef enum {
    WEAR_SUIT, /* top and trousers in one */
    WEAR_DRESS,
    WEAR_TOP,
    WEAR_BOTTOM,
    WEAR_COAT,
    WEAR_SHOES,
    WEAR_HAT,
    WEAR_GLASSES,
    WEAR_HAIR,
    WEAR_BROWS,
    WEAR_LASHES,
    WEAR_EYES,
    WEAR_KINDS
} wear_kind;

enum { FOR_WOMEN = 1, FOR_MEN = 2, FOR_ALL = 3 };

typedef struct {
    const char *name; /* folder below public/data/proxies/ and the kind's own */
    wear_kind kind;
    int whom;
    const char *license; /* "CC0" or "CC-BY" */
    const char *author;
    bool short_hair; /* hair that fits under a hat */
    bool boots;      /* only over tight trousers */
} wear_item;
extern const wear_item wear_items[];
extern const int wear_item_count;
int wear_find(const char *name); /* -1: not in the table */

/* A complete set of clothes without shoes. */
enum { OUTFIT_ITEMS = 4 };
typedef struct {
    const char *item[OUTFIT_ITEMS]; /* from the skin outward; NULL ends it */
    int whom;
    float legs_m, arms_m; /* cut off there (0: not), metres on the base mesh: trousers to shorts, sleeves */
    double share;
    bool test_only; /* reserved for people that nobody trains on */
} outfit;
extern const outfit outfits[];
extern const int outfit_count;

/* Skins: paths below public/data/skins. */
typedef struct {
    const char *folder, *texture;
    int whom;
    int age;    /* 0 young, 1 middle, 2 old */
    int origin; /* 0 african, 1 asian, 2 caucasian */
} skin;
extern const skin skins[];
extern const int skin_count;

/* Combinations of outfit, skin and hair belong to training or tests for good; true: reserved for tests. */
bool wardrobe_kept_for_tests(int outfit_index, int skin_index, int hair_item);
/* Names that must never occur in the table. */
bool wardrobe_forbidden(const char *name);

/* ---- things read from the package, each once ---- */
typedef struct {
    const wear_item *item;
    proxy *proxy;
    int textures;
    image_u8 texture[PROXY_TEXTURES_MAX]; /* RGBA */
    dye_map *map[PROXY_TEXTURES_MAX];
    float *base;    /* V x 3: fitted to the base mesh, metres */
    uint8_t *under; /* base vertices (all) under it, measured on the base mesh */
} worn;
typedef struct wardrobe wardrobe;
/* source: the unpacked package. base: the unshaped mesh with the body's vertices first and its triangles. */
sherf_status wardrobe_open(context *c, const char *source, int base_vertices, int body_vertices,
                           const float *base_vertex, int triangles, const uint32_t *triangle, wardrobe **out);
void wardrobe_close(wardrobe *w);
/* Owned by the wardrobe. One thread at a time. */
sherf_status wardrobe_worn(context *c, wardrobe *w, int item, const worn **out);
sherf_status wardrobe_skin(context *c, wardrobe *w, int index, const image_u8 **out);

#endif
