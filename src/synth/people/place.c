/* The things in a place, and its light. */
#include "synth/people/place.h"

#include <math.h>
#include <string.h>

/* ---- chance ---- */

/* Every draw in this file has its own number, since compilers choose the order in which arguments are
 * computed; `step` renews all of them. */
typedef struct {
    uint64_t key, steps;
    shapes *s;
    const place *p;
    float camera_m;
} builder;

static void step(builder *b) {
    b->key = random_key(b->p->key, "place.step", b->steps++);
}

static float roll(const builder *b, uint64_t i, double low, double high) {
    return (float)(low + (high - low) * random_uniform(b->key, i));
}

static bool chance(const builder *b, uint64_t i, double share) {
    return random_uniform(b->key, i) < share;
}

static int pick(const builder *b, uint64_t i, int n) {
    return (int)random_below(b->key, i, n);
}

/* ---- colours ---- */

typedef enum { COLOR_WALL, COLOR_WOOD, COLOR_STONE, COLOR_GREEN, COLOR_ANY } family;

static void from_hsv(float h, float s, float v, float rgb[3]) {
    for (int k = 0; k < 3; k++) {
        float x = fmodf(6 * h + (k == 0 ? 0 : k == 1 ? 4 : 2), 6), level = fabsf(x - 3) - 1;
        level = level < 0 ? 0 : level > 1 ? 1 : level;
        rgb[k] = v * (1 - s * (1 - level));
    }
}

static void one_color(builder *b, family f, float rgb[3]) {
    step(b);
    if (f == COLOR_WALL && chance(b, 1, 0.6))
        from_hsv(roll(b, 2, 0.05, 0.16), roll(b, 3, 0, 0.18), roll(b, 4, 0.7, 0.93), rgb);
    else if (f == COLOR_WALL)
        from_hsv(roll(b, 5, 0, 1), roll(b, 6, 0.08, 0.5), roll(b, 7, 0.4, 0.85), rgb);
    else if (f == COLOR_WOOD)
        from_hsv(roll(b, 8, 0.045, 0.1), roll(b, 9, 0.25, 0.6), roll(b, 10, 0.25, 0.75), rgb);
    else if (f == COLOR_STONE)
        from_hsv(roll(b, 11, 0.03, 0.14), roll(b, 12, 0.02, 0.3), roll(b, 13, 0.3, 0.75), rgb);
    else if (f == COLOR_GREEN)
        from_hsv(roll(b, 14, 0.17, 0.32), roll(b, 15, 0.4, 0.75), roll(b, 16, 0.2, 0.55), rgb);
    else
        from_hsv(roll(b, 17, 0, 1), roll(b, 18, 0, 0.75), roll(b, 19, 0.12, 0.9), rgb);
    if (f != COLOR_GREEN && chance(b, 20, 0.12)) { /* like the person's */
        const float *near = b->p->near_color[pick(b, 21, PLACE_NEAR_COLORS)];
        for (int k = 0; k < 3; k++) rgb[k] = fmaxf(0.04f, near[k] * roll(b, 22, 0.9, 1.1));
    }
}

/* The second is near the first, the third darker. */
static void colors(builder *b, family f, float rgb[PATTERN_COLORS][3]) {
    float away = f == COLOR_ANY ? 0.7f : 0.4f, other[3];
    one_color(b, f, rgb[0]);
    one_color(b, f, other);
    for (int k = 0; k < 3; k++) {
        rgb[1][k] = rgb[0][k] + away * (other[k] - rgb[0][k]);
        rgb[2][k] = 0.5f * rgb[0][k];
    }
}

static shape_mesh *mesh_of(builder *b, place_pattern pattern, family f, float repeat_m) {
    float rgb[PATTERN_COLORS][3];
    colors(b, f, rgb);
    return shapes_mesh(b->s, pattern, rgb, random_key(b->key, "place.pattern", 0), repeat_m);
}

static shape_mesh *plain(builder *b, family f) {
    return mesh_of(b, PATTERN_PLASTER, f, 1.5f);
}

static shape_mesh *cloth(builder *b) {
    step(b);
    static const place_pattern kind[] = {PATTERN_PLASTER, PATTERN_PLASTER, PATTERN_SPECKS,
                                         PATTERN_STRIPES, PATTERN_CHECKS,  PATTERN_WAVES};
    return mesh_of(b, kind[pick(b, 23, COUNT_OF(kind))], COLOR_ANY, roll(b, 24, 0.3, 1.2));
}

static void box(builder *b, shape_mesh *mesh, float x, float y, float z, float wide, float tall, float deep) {
    shapes_box(b->s, mesh, (float[3]){x, y, z}, (float[3]){wide, tall, deep}, 0);
}

/* An upright quad that faces the camera; if the mesh repeats by 0 the texture fills it once. */
static void panel(builder *b, shape_mesh *mesh, float x, float y, float z, float wide, float tall) {
    shapes_quad(b->s, mesh, (float[3]){x - wide / 2, y, z}, (float[3]){wide, 0, 0}, (float[3]){0, tall, 0},
                0.4f);
}

/* ---- things on walls; z: the wall ---- */

static void frame(builder *b, shape_mesh *mesh, float x, float y, float z, float wide, float tall, float w) {
    box(b, mesh, x - wide / 2, y, z, w, tall, 0.05f);
    box(b, mesh, x + wide / 2, y, z, w, tall, 0.05f);
    box(b, mesh, x, y, z, wide, w, 0.05f);
    box(b, mesh, x, y + tall - w, z, wide, w, 0.05f);
}

static void window(builder *b, float x, float z, bool outdoors) {
    step(b);
    float wide = roll(b, 25, 0.7, 1.6), tall = roll(b, 26, 1, 1.5), y = roll(b, 27, 0.75, 1);
    shape_mesh *pane = mesh_of(b, PATTERN_VIEW, COLOR_GREEN, 0), *wood = plain(b, COLOR_WALL);
    if (outdoors) {
        for (int k = 0; k < 3; k++) pane->material.tint[k] = 0.25f;
        pane->material.specular = 0.05f, pane->material.roughness = 0.1f;
    } else {
        float bright = roll(b, 28, 0.8, 1.3);
        for (int k = 0; k < 3; k++) pane->material.glow[k] = bright;
    }
    panel(b, pane, x, y, z - 0.012f, wide, tall);
    frame(b, wood, x, y, z, wide, tall, 0.07f);
    if (chance(b, 29, 0.7)) box(b, wood, x, y, z, 0.05f, tall, 0.05f);
    if (chance(b, 30, 0.5)) box(b, wood, x, y + 0.62f * tall, z, wide, 0.05f, 0.05f);
    box(b, wood, x, y - 0.04f, z - 0.08f, wide + 0.15f, 0.04f, 0.2f);
    if (outdoors || chance(b, 31, 0.4)) return;
    shape_mesh *curtain = cloth(b);
    for (int side = -1; side <= 1; side += 2)
        for (int fold = 0; fold < 5; fold++) {
            const float foot[3] = {x + (float)side * (wide / 2 + 0.02f + 0.075f * (float)fold), 0.06f,
                                   z - 0.12f + 0.02f * (float)(fold % 2)};
            shapes_cylinder(b->s, curtain, foot, 0.055f, 0.045f, y + tall + 0.1f);
        }
}

static void door(builder *b, float x, float z) {
    step(b);
    shape_mesh *leaf = mesh_of(b, chance(b, 32, 0.5) ? PATTERN_PLANKS : PATTERN_PLASTER, COLOR_WOOD, 1),
               *around = plain(b, COLOR_WALL);
    box(b, leaf, x, 0, z, 0.88f, 2.02f, 0.05f);
    for (int i = 0; i < 2; i++) box(b, leaf, x, i ? 1.1f : 0.2f, z - 0.03f, 0.6f, i ? 0.75f : 0.7f, 0.02f);
    frame(b, around, x, -0.1f, z, 0.98f, 2.22f, 0.09f);
    const float knob[3] = {x + 0.36f, 1, z - 0.07f}, size[3] = {0.03f, 0.03f, 0.03f};
    shapes_ball(b->s, around, knob, size);
}

static void picture_on(builder *b, float x, float z) {
    step(b);
    float wide = roll(b, 33, 0.3, 1.1), tall = roll(b, 34, 0.3, 0.9), y = roll(b, 35, 1.2, 1.6);
    shape_mesh *paint = mesh_of(b, chance(b, 36, 0.5) ? PATTERN_WAVES : PATTERN_BLOCKS, COLOR_ANY, 0),
               *wood = plain(b, COLOR_WOOD);
    panel(b, paint, x, y, z - 0.015f, wide, tall);
    frame(b, wood, x, y, z, wide, tall, 0.04f);
}

/* ---- standing things; z: their middle ---- */

static void legs(builder *b, shape_mesh *mesh, float x, float z, float wide, float deep, float tall) {
    for (int i = 0; i < 4; i++)
        box(b, mesh, x + (i % 2 ? 0.46f : -0.46f) * wide, 0, z + (i / 2 ? 0.44f : -0.44f) * deep, 0.045f,
            tall, 0.045f);
}

/* Small things on a board. */
static void trinkets(builder *b, float x, float y, float z, float wide) {
    for (int n = pick(b, 37, 5); n > 0; n--) {
        step(b);
        shape_mesh *mesh = mesh_of(b, (place_pattern)pick(b, 38, PATTERN_BOOKS), COLOR_ANY, 0.3f);
        float at[3] = {x + wide * roll(b, 39, -0.42, 0.42), y, z + roll(b, 40, -0.1, 0.1)},
              size = roll(b, 41, 0.05, 0.13);
        int what = pick(b, 42, 3);
        if (what == 0) {
            shapes_box(b->s, mesh, at, (float[3]){size, size * roll(b, 43, 0.6, 2.2), size},
                       roll(b, 44, 0, 1.5));
        } else if (what == 1) {
            shapes_cylinder(b->s, mesh, at, 0.5f * size, size * roll(b, 45, 0.3, 0.7),
                            size * roll(b, 46, 1, 2.5));
        } else {
            at[1] += size;
            shapes_ball(b->s, mesh, at, (float[3]){size, size, size});
        }
    }
}

static void sofa(builder *b, float x, float z, float wide) {
    step(b);
    shape_mesh *mesh = cloth(b), *pillow = cloth(b);
    float deep = 0.85f;
    box(b, mesh, x, 0.08f, z, wide, 0.32f, deep);
    box(b, mesh, x, 0.08f, z + 0.36f * deep, wide, 0.75f, 0.24f);
    for (int side = -1; side <= 1; side += 2)
        box(b, mesh, x + (float)side * (wide / 2 - 0.09f), 0.08f, z, 0.18f, 0.52f, deep);
    for (int n = pick(b, 47, 4); n > 0; n--) {
        step(b);
        const float at[3] = {x + roll(b, 48, -0.35, 0.35) * wide, 0.58f, z + 0.1f};
        shapes_ball(b->s, pillow, at, (float[3]){0.22f, 0.19f, 0.1f});
    }
}

static void table(builder *b, float x, float z, float wide) {
    step(b);
    shape_mesh *mesh = mesh_of(b, PATTERN_PLANKS, COLOR_WOOD, 0.9f);
    float tall = roll(b, 49, 0.45, 0.78), deep = roll(b, 50, 0.45, 0.7);
    box(b, mesh, x, tall, z, wide, 0.04f, deep);
    legs(b, mesh, x, z, wide, deep, tall);
    trinkets(b, x, tall + 0.04f, z, wide);
}

static void chair(builder *b, float x, float z) {
    step(b);
    shape_mesh *mesh = mesh_of(b, chance(b, 51, 0.5) ? PATTERN_PLANKS : PATTERN_PLASTER, COLOR_WOOD, 0.8f);
    legs(b, mesh, x, z, 0.42f, 0.42f, 0.45f);
    box(b, mesh, x, 0.44f, z, 0.44f, 0.04f, 0.44f);
    for (int i = 0; i < 4; i++)
        box(b, mesh, x + 0.13f * (float)(i - 1) - 0.065f, 0.46f, z + 0.2f, 0.035f, 0.45f, 0.03f);
    box(b, mesh, x, 0.86f, z + 0.2f, 0.44f, 0.08f, 0.035f);
}

static void cabinet(builder *b, float x, float z, float wide) {
    step(b);
    shape_mesh *mesh = mesh_of(b, chance(b, 52, 0.6) ? PATTERN_PLANKS : PATTERN_PLASTER, COLOR_WOOD, 1),
               *handle = plain(b, COLOR_STONE);
    float tall = roll(b, 53, 0.6, 2), deep = 0.45f;
    int doors = (int)(wide / 0.45f);
    box(b, mesh, x, 0.05f, z, wide, tall, deep);
    for (int i = 0; i < doors; i++) {
        float at = x + wide * (((float)i + 0.5f) / (float)doors - 0.5f);
        box(b, mesh, at, 0.09f, z - deep / 2, wide / (float)doors - 0.025f, tall - 0.08f, 0.03f);
        box(b, handle, at + 0.3f * wide / (float)doors, 0.45f * tall, z - deep / 2 - 0.03f, 0.02f, 0.14f,
            0.02f);
    }
    trinkets(b, x, tall + 0.05f, z, wide);
}

static void shelf(builder *b, float x, float z, float wide) {
    step(b);
    shape_mesh *board = mesh_of(b, PATTERN_PLANKS, COLOR_WOOD, 1),
               *books = mesh_of(b, PATTERN_BOOKS, COLOR_ANY, 1.3f);
    float tall = roll(b, 54, 1.2, 2.1);
    box(b, board, x, 0, z + 0.02f, wide, tall, 0.3f);
    panel(b, books, x, 0.04f, z - 0.135f, wide - 0.06f, tall - 0.08f);
    for (int side = -1; side <= 1; side += 2)
        box(b, board, x + (float)side * wide / 2, 0, z - 0.05f, 0.04f, tall, 0.34f);
    box(b, board, x, tall, z - 0.05f, wide + 0.04f, 0.04f, 0.34f);
}

static void plant(builder *b, float x, float z) {
    step(b);
    shape_mesh *pot = plain(b, COLOR_ANY), *leaf = mesh_of(b, PATTERN_LEAVES, COLOR_GREEN, 0);
    float tall = roll(b, 55, 0.5, 1.3), wide = roll(b, 56, 0.2, 0.4);
    shapes_cylinder(b->s, pot, (float[3]){x, 0, z}, 0.13f, 0.18f, 0.32f);
    shapes_cards(b->s, leaf, (float[3]){x, 0.3f + 0.5f * tall, z}, (float[3]){wide, 0.5f * tall, wide}, 40,
                 0.3f, random_key(b->key, "place.cards", 0));
}

static void lamp(builder *b, float x, float z) {
    step(b);
    shape_mesh *pole = plain(b, COLOR_STONE), *shade = plain(b, COLOR_WALL);
    bool lit = chance(b, 57, 0.5);
    for (int k = 0; k < 3; k++) shade->material.glow[k] = lit ? 0.9f - 0.15f * (float)k : 0.2f;
    float tall = roll(b, 58, 1.1, 1.6);
    shapes_cylinder(b->s, pole, (float[3]){x, 0, z}, 0.15f, 0.14f, 0.03f);
    shapes_cylinder(b->s, pole, (float[3]){x, 0, z}, 0.015f, 0.015f, tall);
    shapes_cylinder(b->s, shade, (float[3]){x, tall, z}, 0.22f, 0.15f, 0.28f);
}

static void radiator(builder *b, float x, float z, float wide) {
    step(b);
    shape_mesh *mesh = plain(b, COLOR_WALL);
    for (float at = -wide / 2; at < wide / 2; at += 0.07f)
        box(b, mesh, x + at, 0.12f, z, 0.055f, 0.6f, 0.09f);
}

/* ---- rooms ---- */

static void wall_along(builder *b, float z, float x, float to) {
    while (x < to) {
        step(b);
        float wide = roll(b, 59, 0.7, 1.8), middle = x + wide / 2;
        int what = pick(b, 60, 11);
        bool deep = z > 1.1f; /* furniture stays behind the person */
        if (what == 0 && deep)
            sofa(b, middle, z - 0.5f, wide);
        else if (what == 1 && deep)
            table(b, middle, z - 0.4f, wide);
        else if (what == 2 && deep)
            cabinet(b, middle, z - 0.26f, wide);
        else if (what == 3 && z > 0.8f)
            shelf(b, middle, z - 0.2f, wide);
        else if (what == 4 && z > 0.9f)
            plant(b, middle, z - 0.35f);
        else if (what == 5 && z > 0.8f)
            lamp(b, middle, z - 0.3f);
        else if (what == 6)
            door(b, middle, z);
        else if (what == 7)
            window(b, middle, z, false);
        else if (what == 8 && deep)
            chair(b, middle, z - 0.4f);
        else if (what == 9)
            radiator(b, middle, z - 0.08f, wide);
        if ((what < 3 || what > 7) && chance(b, 61, 0.6)) picture_on(b, middle, z);
        x += wide + roll(b, 62, 0, 0.5);
    }
}

static void floor_of(builder *b, shape_mesh *mesh, float x, float z, float z_to, float cell_m) {
    shapes_quad(b->s, mesh, (float[3]){-x, 0, z}, (float[3]){2 * x, 0, 0}, (float[3]){0, 0, z_to - z},
                cell_m);
}

static void wall_of(builder *b, shape_mesh *mesh, float x, float z, float dx, float dz, float tall) {
    mesh->material.seen = TRACE_NOT_BY_LAMPS;
    shapes_quad(b->s, mesh, (float[3]){x, 0, z}, (float[3]){dx, 0, dz}, (float[3]){0, tall, 0}, 0.5f);
}

static void room(builder *b) {
    step(b);
    static const place_pattern below[] = {PATTERN_PLANKS, PATTERN_PLANKS, PATTERN_TILES, PATTERN_SPECKS,
                                          PATTERN_WAVES},
                               behind[] = {PATTERN_PLASTER, PATTERN_PLASTER, PATTERN_PLASTER, PATTERN_STRIPES,
                                           PATTERN_CHECKS,  PATTERN_BRICKS,  PATTERN_TILES,   PATTERN_WAVES};
    float z = roll(b, 63, 0.6, 3.8), tall = roll(b, 64, 2.4, 3.1), near = -b->camera_m - 1.5f;
    b->s->turn_rad = roll(b, 65, -0.5, 0.5);
    int under = pick(b, 66, COUNT_OF(below));
    shape_mesh *floor = mesh_of(b, below[under], under < 2 ? COLOR_WOOD : COLOR_STONE, roll(b, 67, 0.8, 1.8));
    if (under < 3) floor->material.specular = 0.03f, floor->material.roughness = roll(b, 68, 0.25, 0.6);
    shape_mesh *wall = mesh_of(b, behind[pick(b, 69, COUNT_OF(behind))], COLOR_WALL, roll(b, 70, 0.6, 2)),
               *skirting = plain(b, COLOR_WALL), *ceiling = plain(b, COLOR_WALL);
    floor_of(b, floor, 6, near, z + 0.05f, 0.3f);
    wall_of(b, wall, -6, z, 12, 0, tall);
    box(b, skirting, 0, 0, z, 12, roll(b, 71, 0.06, 0.16), 0.03f);
    float bright = roll(b, 72, 0.45, 0.6);
    for (int k = 0; k < 3; k++) ceiling->material.glow[k] = bright;
    ceiling->material.seen = TRACE_BY_CAMERAS;
    shapes_quad(b->s, ceiling, (float[3]){-6, tall, near}, (float[3]){12, 0, 0}, (float[3]){0, 0, z - near},
                2);
    float left = -6, right = 6;
    if (chance(b, 73, 0.6)) left = -roll(b, 74, 1.2, 3.5), wall_of(b, wall, left, near, 0, z - near, tall);
    if (chance(b, 75, 0.6)) right = roll(b, 76, 1.2, 3.5), wall_of(b, wall, right, near, 0, z - near, tall);
    if (left > -6) box(b, skirting, left, 0, (z + near) / 2, 0.03f, 0.1f, z - near);
    if (right < 6) box(b, skirting, right, 0, (z + near) / 2, 0.03f, 0.1f, z - near);
    wall_along(b, z, fmaxf(left, -4.5f) + 0.1f, fminf(right, 4.5f) - 0.4f);
    if (chance(b, 77, 0.35)) {
        shape_mesh *rug =
            mesh_of(b, (place_pattern)(PATTERN_STRIPES + pick(b, 78, 4)), COLOR_ANY, roll(b, 79, 0.7, 1.6));
        box(b, rug, roll(b, 80, -0.5, 0.5), 0, roll(b, 81, -0.2, 0.4), roll(b, 82, 1.4, 2.6), 0.004f,
            roll(b, 83, 1, 1.6));
    }
}

/* ---- outdoors ---- */

static void tree(builder *b, shape_mesh *bark, shape_mesh *leaf, float x, float z) {
    step(b);
    float tall = roll(b, 84, 1.5, 3), crown = roll(b, 85, 0.9, 1.8);
    shapes_cylinder(b->s, bark, (float[3]){x, 0, z}, roll(b, 86, 0.1, 0.22), 0.08f, tall + 0.6f * crown);
    for (int i = 0; i < 3; i++) {
        step(b);
        const float at[3] = {x + roll(b, 87, -0.4, 0.4) * crown, tall + crown * roll(b, 88, 0.4, 1),
                             z + roll(b, 89, -0.4, 0.4)};
        shapes_cards(b->s, leaf, at, (float[3]){crown, 0.8f * crown, crown}, 60, 0.75f,
                     random_key(b->key, "place.cards", 0));
    }
}

static void bushes(builder *b, shape_mesh *leaf, float x, float to, float z, float tall) {
    while (x < to) {
        step(b);
        float wide = roll(b, 90, 0.5, 1.1), high = tall * roll(b, 91, 0.75, 1.15);
        const float at[3] = {x, 0.45f * high, z + roll(b, 92, -0.2, 0.2)};
        shapes_cards(b->s, leaf, at, (float[3]){wide, 0.5f * high, 0.5f}, 70, 0.4f,
                     random_key(b->key, "place.cards", 0));
        x += 0.7f * wide;
    }
}

static void fence(builder *b, float z) {
    step(b);
    shape_mesh *mesh = mesh_of(b, PATTERN_PLANKS, COLOR_WOOD, 0.8f);
    float tall = roll(b, 93, 0.8, 1.9), wide = roll(b, 94, 0.07, 0.16),
          gap = chance(b, 95, 0.5) ? 0.01f : 0.07f;
    for (float x = -7; x < 7; x += wide + gap) {
        step(b);
        box(b, mesh, x, 0.04f, z, wide, tall * roll(b, 96, 0.97, 1.02), 0.03f);
    }
    for (int i = 0; i < 2; i++) box(b, mesh, 0, tall * (i ? 0.8f : 0.25f), z + 0.03f, 14, 0.08f, 0.04f);
}

static void far_trees(builder *b) {
    step(b);
    shape_mesh *leaf = mesh_of(b, PATTERN_LEAVES, COLOR_GREEN, 0),
               *core = mesh_of(b, PATTERN_GRASS, COLOR_GREEN, 3);
    for (float x = -26; x < 26; x += roll(b, 97, 2, 4)) {
        step(b);
        float tall = roll(b, 98, 2, 6), z = roll(b, 99, 17, 24);
        shapes_ball(b->s, core, (float[3]){x, 0.4f * tall, z + 1}, (float[3]){2, 0.55f * tall, 1.5f});
        shapes_cards(b->s, leaf, (float[3]){x, 0.5f * tall, z}, (float[3]){2, 0.5f * tall, 1.5f}, 40, 1.4f,
                     random_key(b->key, "place.cards", 0));
    }
}

static void green(builder *b) {
    step(b);
    float z = roll(b, 100, 1.6, 8);
    b->s->turn_rad = roll(b, 101, -0.4, 0.4);
    bool paved = chance(b, 102, 0.4);
    shape_mesh *ground = mesh_of(b, paved ? PATTERN_SPECKS : PATTERN_GRASS, paved ? COLOR_STONE : COLOR_GREEN,
                                 roll(b, 103, 1, 2)),
               *leaf = mesh_of(b, PATTERN_LEAVES, COLOR_GREEN, 0),
               *bark = mesh_of(b, PATTERN_SPECKS, COLOR_WOOD, 0.5f);
    floor_of(b, ground, 28, -b->camera_m - 2, 26, 0.5f);
    if (!paved && chance(b, 104, 0.5)) {
        shape_mesh *path =
            mesh_of(b, chance(b, 105, 0.5) ? PATTERN_SPECKS : PATTERN_BRICKS, COLOR_STONE, 1.2f);
        box(b, path, roll(b, 106, -1, 1), 0, 4, roll(b, 107, 0.9, 2.5), 0.006f, 30);
    }
    far_trees(b);
    int what = pick(b, 108, 4);
    if (what < 2)
        bushes(b, leaf, -6, 6, z, roll(b, 109, 0.7, 2.2));
    else if (what == 2)
        fence(b, z);
    for (int n = 1 + pick(b, 110, 4); n > 0; n--)
        tree(b, bark, leaf, roll(b, 111, -4, 4), z + roll(b, 112, 0.8, 6));
    if (chance(b, 113, 0.3)) {
        shape_mesh *wood = mesh_of(b, PATTERN_PLANKS, COLOR_WOOD, 0.8f);
        float x = roll(b, 114, -2, 2), at = fmaxf(1.1f, z - 0.6f);
        box(b, wood, x, 0.42f, at, 1.5f, 0.04f, 0.4f);
        box(b, wood, x, 0.6f, at + 0.2f, 1.5f, 0.25f, 0.03f);
        legs(b, wood, x, at, 1.4f, 0.35f, 0.42f);
    }
}

static void car(builder *b, float x, float z) {
    step(b);
    shape_mesh *body = plain(b, COLOR_ANY), *glass = plain(b, COLOR_STONE), *tyre = plain(b, COLOR_STONE);
    for (int k = 0; k < 3; k++) glass->material.tint[k] = 0.12f, tyre->material.tint[k] = 0.06f;
    body->material.specular = glass->material.specular = 0.05f;
    body->material.roughness = glass->material.roughness = 0.2f;
    box(b, body, x, 0.3f, z, 4.1f, 0.5f, 1.65f);
    shapes_ball(b->s, body, (float[3]){x, 0.72f, z}, (float[3]){2.05f, 0.22f, 0.8f});
    shapes_ball(b->s, glass, (float[3]){x + 0.1f, 0.9f, z}, (float[3]){1.25f, 0.48f, 0.7f});
    shapes_ball(b->s, body, (float[3]){x + 0.1f, 1.3f, z}, (float[3]){0.9f, 0.14f, 0.6f});
    for (int i = 0; i < 2; i++)
        shapes_ball(b->s, tyre, (float[3]){x + (i ? 1.25f : -1.25f), 0.32f, z - 0.78f},
                    (float[3]){0.32f, 0.32f, 0.12f});
}

static void house_front(builder *b, float z, float from, float to, float tall) {
    float story = roll(b, 115, 2.7, 3.3);
    for (int floor = 0; (float)floor * story + 2.3f < tall && floor < 2; floor++) {
        for (float x = from + 1; x < to - 1; x += roll(b, 116, 1.6, 2.6)) {
            step(b);
            if (floor == 0 && chance(b, 117, 0.25)) {
                door(b, x, z);
            } else if (floor == 0 && chance(b, 118, 0.2)) {
                shape_mesh *sign =
                    mesh_of(b, chance(b, 119, 0.5) ? PATTERN_BLOCKS : PATTERN_WAVES, COLOR_ANY, 0);
                panel(b, sign, x, roll(b, 120, 0.4, 1.2), z - 0.02f, roll(b, 121, 0.8, 1.5),
                      roll(b, 122, 0.6, 1.6));
            } else if (floor == 0) {
                window(b, x, z, true);
            }
        }
    }
}

static void street(builder *b) {
    step(b);
    static const place_pattern below[] = {PATTERN_TILES, PATTERN_BRICKS, PATTERN_SPECKS, PATTERN_SPECKS},
                               behind[] = {PATTERN_BRICKS, PATTERN_BRICKS, PATTERN_PLASTER, PATTERN_TILES};
    float z = roll(b, 123, 0.9, 8), tall = roll(b, 124, 3, 8), from = -roll(b, 125, 3, 14),
          to = roll(b, 126, 3, 14);
    b->s->turn_rad = roll(b, 127, -0.6, 0.6);
    shape_mesh *ground =
                   mesh_of(b, below[pick(b, 128, COUNT_OF(below))], COLOR_STONE, roll(b, 129, 0.8, 1.8)),
               *wall = mesh_of(b, behind[pick(b, 130, COUNT_OF(behind))],
                               chance(b, 131, 0.5) ? COLOR_WALL : COLOR_STONE, roll(b, 132, 0.9, 1.4)),
               *base = plain(b, COLOR_STONE);
    floor_of(b, ground, 26, -b->camera_m - 2, 26, 0.5f);
    far_trees(b);
    wall_of(b, wall, from, z, to - from, 0, tall);
    wall_of(b, wall, from, z, 0, 8, tall);
    wall_of(b, wall, to, z, 0, 8, tall);
    box(b, base, (from + to) / 2, 0, z, to - from, roll(b, 133, 0.1, 0.5), 0.06f);
    house_front(b, z, from, to, tall);
    if (z > 4 && chance(b, 134, 0.7)) car(b, roll(b, 135, -3, 3), z - 1.6f);
    if (z > 2 && chance(b, 136, 0.5)) {
        shape_mesh *iron = plain(b, COLOR_STONE);
        float x = roll(b, 137, -2.5, 2.5);
        shapes_cylinder(b->s, iron, (float[3]){x, 0, z - 0.7f}, 0.06f, 0.045f, 4);
        for (int n = pick(b, 138, 4); n > 0; n--) {
            step(b);
            shapes_cylinder(b->s, iron, (float[3]){roll(b, 139, -3, 3), 0, z - 0.7f}, 0.07f, 0.07f, 0.9f);
        }
    }
    if (z > 1.8f && chance(b, 140, 0.4)) {
        shape_mesh *leaf = mesh_of(b, PATTERN_LEAVES, COLOR_GREEN, 0);
        bushes(b, leaf, roll(b, 141, -4, 0), 2, z - 0.5f, 0.9f);
    }
    if (z > 1.6f && chance(b, 142, 0.4)) {
        shape_mesh *bin = plain(b, COLOR_ANY);
        shapes_cylinder(b->s, bin, (float[3]){roll(b, 143, -2, 2), 0, z - 0.5f}, 0.22f, 0.26f, 0.85f);
    }
}

/* ---- studios and clutter ---- */

/* A roll of paper: floor, a bend, wall. */
static void studio_of(builder *b) {
    step(b);
    enum { STEPS = 12 };
    shape_mesh *mesh = mesh_of(b, chance(b, 144, 0.7) ? PATTERN_PLASTER : PATTERN_WAVES,
                               chance(b, 145, 0.5) ? COLOR_ANY : COLOR_WALL, roll(b, 146, 2, 4));
    float z = roll(b, 147, 0.8, 2.5), bend = roll(b, 148, 0.3, 0.7), y0 = 0, z0 = z - bend;
    mesh->material.seen = TRACE_NOT_BY_LAMPS;
    floor_of(b, mesh, 7, -b->camera_m - 1.5f, z0, 0.3f);
    for (int i = 1; i <= STEPS; i++) {
        float angle = (float)M_PI_2 * (float)i / STEPS, y = bend * (1 - cosf(angle)),
              at = z - bend + bend * sinf(angle);
        shapes_quad(b->s, mesh, (float[3]){-7, y0, z0}, (float[3]){14, 0, 0}, (float[3]){0, y - y0, at - z0},
                    0.3f);
        y0 = y, z0 = at;
    }
    shapes_quad(b->s, mesh, (float[3]){-7, bend, z}, (float[3]){14, 0, 0}, (float[3]){0, 5, 0}, 0.4f);
}

static void clutter(builder *b) {
    step(b);
    enum { MATERIALS = 14 };
    float z = roll(b, 149, 1.6, 4.5);
    shape_mesh *mesh[MATERIALS];
    b->s->turn_rad = roll(b, 150, -0.4, 0.4);
    shape_mesh *floor = mesh_of(b, (place_pattern)pick(b, 151, PATTERN_GRASS), COLOR_STONE, 1.2f),
               *wall =
                   mesh_of(b, (place_pattern)pick(b, 152, PATTERN_LEAVES), COLOR_ANY, roll(b, 153, 0.5, 2));
    floor_of(b, floor, 7, -b->camera_m - 1.5f, z + 0.1f, 0.3f);
    wall_of(b, wall, -7, z, 14, 0, 3.4f);
    for (int i = 0; i < MATERIALS; i++)
        mesh[i] = mesh_of(b, (place_pattern)pick(b, 154, PATTERN_LEAVES), COLOR_ANY, roll(b, 155, 0.2, 1));
    for (int n = 30 + pick(b, 156, 50); n > 0; n--) {
        step(b);
        float size = roll(b, 157, 0.08, 0.4), tall = size * roll(b, 158, 0.5, 3);
        float at[3] = {roll(b, 159, -4, 4), chance(b, 160, 0.5) ? 0 : roll(b, 161, 0, 2.2),
                       roll(b, 162, 0.9, z - 0.1)};
        shape_mesh *own = mesh[pick(b, 163, MATERIALS)];
        int what = pick(b, 164, 3);
        if (what == 0) {
            shapes_box(b->s, own, at, (float[3]){size, tall, size * roll(b, 165, 0.5, 1.5)},
                       roll(b, 166, 0, 3));
        } else if (what == 1) {
            shapes_cylinder(b->s, own, at, 0.5f * size, size * roll(b, 167, 0.1, 0.6), tall);
        } else {
            at[1] += 0.6f * size;
            shapes_ball(b->s, own, at, (float[3]){0.6f * size, 0.6f * size, 0.6f * size});
        }
    }
}

/* ---- the whole ---- */

sherf_status place_build(context *c, const place *p, float camera_m, shapes *out) {
    *out = (shapes){.c = c};
    builder b = {.s = out, .p = p, .camera_m = camera_m};
    if (p->kind == PLACE_ROOM)
        room(&b);
    else if (p->kind == PLACE_STREET)
        street(&b);
    else if (p->kind == PLACE_GREEN)
        green(&b);
    else if (p->kind == PLACE_STUDIO)
        studio_of(&b);
    else
        clutter(&b);
    sherf_status status = out->status;
    if (status) shapes_free(out);
    return status;
}

static float between(uint64_t key, uint64_t i, double low, double high) {
    return (float)(low + (high - low) * random_uniform(key, i));
}

static void set_lamp(uint64_t key, trace_lamp *l, float power, float warm, double low, double high,
                     float half) {
    float azimuth = between(key, 0, -M_PI, M_PI), height = between(key, 1, low, high);
    l->to_lamp[0] = sinf(azimuth) * cosf(height);
    l->to_lamp[1] = sinf(height);
    l->to_lamp[2] = cosf(azimuth) * cosf(height);
    l->half_angle_rad = half;
    for (int k = 0; k < 3; k++) l->color[k] = power * (1 + warm * (float)(1 - k));
}

place_kind place_light(uint64_t key, trace_light *out) {
    static const double share[PLACE_KINDS] = {0.42, 0.2, 0.18, 0.08, 0.12};
    double at = random_uniform(key, 0);
    int kind = 0;
    while (kind + 1 < PLACE_KINDS && at >= share[kind]) at -= share[kind++];
    bool outdoors = kind == PLACE_STREET || kind == PLACE_GREEN,
         sun = outdoors && random_uniform(key, 1) < 0.6;
    float warm = between(key, 2, -0.05, 0.1);
    *out = (trace_light){.up = {0, 1, 0}, .bounce = 0.4f, .seed = key};
    float sky = sun        ? between(key, 3, 0.4, 0.55)
                : outdoors ? between(key, 3, 0.75, 0.95)
                           : between(key, 3, 0.4, 0.65);
    for (int k = 0; k < 3; k++) {
        float tint = 1 + (sun ? -0.16f : outdoors ? -0.03f : warm) * (float)(1 - k);
        out->zenith[k] = (outdoors ? 1 : 1.15f) * sky * tint;
        out->horizon[k] = (outdoors ? 1 : 0.75f) * sky;
        out->ground[k] = 0.42f * sky * (1 + 0.06f * (float)(1 - k));
    }
    if (sun) {
        out->lamps = 1;
        set_lamp(random_key(key, "place.lamp", 0), &out->lamp[0], between(key, 4, 0.5, 0.8), 0.08f, 0.35, 1.1,
                 between(key, 5, 0.01, 0.06));
    } else if (outdoors) { /* the brighter side of the clouds */
        out->lamps = 1;
        set_lamp(random_key(key, "place.lamp", 0), &out->lamp[0], between(key, 4, 0.1, 0.3), 0, 0.6, 1.2,
                 0.6f);
    } else {
        out->lamps = 1 + (int)random_below(key, 6, 2);
        for (int i = 0; i < out->lamps; i++)
            set_lamp(random_key(key, "place.lamp", (uint64_t)i), &out->lamp[i],
                     between(key, 7 + (uint64_t)i, 0.3, 0.6) / (float)(1 + i), warm, 0.25, 1,
                     between(key, 10 + (uint64_t)i, 0.12, 0.4));
    }
    return (place_kind)kind;
}
