/* Tests of the parts of people on small made-up data, without external files. */
#include "support.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "data/data.h"
#include "synth/tube/tubeman.h"
#include "synth/people/dress.h"
#include "synth/people/person.h"
#include "synth/people/person_pose.h"

/* ---- proxies ---- */

/* A base mesh: a square of 0.2 m and a point above it. */
static const float base[] = {0, 0, 0, 0.2f, 0, 0, 0.2f, 0.2f, 0, 0, 0.2f, 0, 0.1f, 0.1f, 0.1f};
static const char cloth[] =
    "{\"ref_vIdxs\": [[0,1,2],[1,2,3],[2,3,0],[3,3,3]], \"weights\": "
    "[[1,0,0],[0.5,0.25,0.25],[2,-0.5,-0.5],[1,0,0]],"
    " \"offsets\": [[0,0,0.1],[0,0,0.1],[0.1,0,0],[0,0,0]], \"uvs\": [[0,0, 1,0, 1,1, 0,1]],"
    " \"faces\": [11, 0,1,2,3, 0, 0,1,2,3], \"materials\": [{\"mapDiffuse\": \"textures/a.png\"}],"
    " \"metadata\": {\"deleteVerts\": [0,1,false,true,0]}}";

static sherf_status parse(context *c, const char *text, proxy **out) {
    document *d;
    *out = NULL;
    sherf_status status = json_parse(c, text, strlen(text), &d);
    if (status) return status;
    status = proxy_parse(c, d->root, "cloth", 5, base, out);
    document_free(d);
    return status;
}

static void test_binding(void **state) {
    context *c = test_context();
    proxy *p;
    assert_ok(c, parse(c, cloth, &p));
    assert_int_equal(p->vertices, 4);
    assert_int_equal(p->triangles, 2);
    assert_int_equal(p->hidden, 2);
    assert_int_equal(p->hides[1] + p->hides[3], 2);
    assert_string_equal(p->texture[0], "textures/a.png");
    float at[12];
    proxy_fit(p, base, at); /* offsets are decimetres */
    const float expected[12] = {0, 0, 0.01f, 0.15f, 0.1f, 0.01f, 0.4f + 0.01f, 0.3f, 0, 0, 0.2f, 0};
    for (int i = 0; i < 12; i++) assert_float_equal(at[i], expected[i], 1e-6);
    float moved[15], again[12];
    for (int i = 0; i < 15; i++) moved[i] = base[i] + (i % 3 == 1 ? 0.5f : 0); /* it follows the base */
    proxy_fit(p, moved, again);
    for (int i = 0; i < 12; i++) assert_float_equal(again[i], (at[i] + (i % 3 == 1 ? 0.5f : 0)), 1e-6);
    for (int i = 0; i < 15; i++) moved[i] = base[i] * (i % 3 == 0 ? 1.2f : 1); /* offsets grow in x only */
    proxy_fit(p, moved, again);
    assert_float_equal(again[6], 1.2f * at[6], 1e-6);
    assert_float_equal(again[2], at[2], 1e-6);
    /* transferred weights are not negative and sum to 1, even where the binding extrapolates */
    const float row[10] = {1, 0, 0, 1, 0.5f, 0.5f, 1, 0, 0, 1};
    float out[8];
    proxy_carry(p, 2, row, out);
    for (int v = 0; v < 4; v++) assert_float_equal(out[2 * v] + out[2 * v + 1], 1, 1e-6);
    assert_float_equal(out[4], 0.5f, 1e-6);
    proxy_free(p);
    sherf_context_free(c);
}

static void test_broken_proxies(void **state) {
    context *c = test_context();
    static const struct {
        const char *from, *to;
    } wrong[] = {{"[3,3,3]", "[3,3,5]"},
                 {"[3,3,3]", "[3,3,-1]"},
                 {"[3,3,3]", "[3,3]"},
                 {"[3,3,3]", "[3,3,0.5]"},
                 {"11, 0,1,2,3", "11, 0,1,2,4"},
                 {"0, 0,1,2,3]", "0, 0,1,2,4]"},
                 {"11, 0", "203, 0"},
                 {"11, 0", "3, 0"},
                 {"0, 0,1,2,3]", "0, 0,1,2]"},
                 {"textures/a", "../a"},
                 {"textures/a", "/etc/a"},
                 {"\"uvs\": [[0,", "\"uvs\": [["},
                 {"[2,-0.5,-0.5]", "[1e9,0,0]"}};
    size_t live = mem_live();
    for (size_t i = 0; i < COUNT_OF(wrong); i++) {
        char text[sizeof cloth + 64];
        const char *at = strstr(cloth, wrong[i].from);
        proxy *p;
        assert_non_null(at);
        snprintf(text, sizeof text, "%.*s%s%s", (int)(at - cloth), cloth, wrong[i].to,
                 at + strlen(wrong[i].from));
        if (parse(c, text, &p) != SHERF_BAD_FILE) fail_msg("%s is taken", wrong[i].to);
        assert_null(p);
    }
    assert_int_equal(mem_live(), live);
    sherf_context_free(c);
}

/* A plane of 21 x 21 vertices, 1 cm apart, at a height; `half` is half of its side. */
enum { SIDE = 21, PLANE = SIDE * SIDE, PLANE_FACES = 2 * (SIDE - 1) * (SIDE - 1) };
static void make_plane(float height, float scale, float *vertex, uint32_t *triangle) {
    int n = 0;
    for (int y = 0; y < SIDE; y++)
        for (int x = 0; x < SIDE; x++) {
            float *v = vertex + 3 * (y * SIDE + x);
            v[0] = scale * 0.01f * (float)(x - SIDE / 2), v[1] = scale * 0.01f * (float)(y - SIDE / 2),
            v[2] = height;
            if (x + 1 == SIDE || y + 1 == SIDE) continue;
            uint32_t a = (uint32_t)(y * SIDE + x), b = a + 1, d = a + SIDE, e = d + 1;
            const uint32_t two[6] = {a, b, e, a, e, d};
            memcpy(triangle + 3 * n, two, sizeof two);
            n += 2;
        }
}

static void test_cover(void **state) {
    context *c = test_context();
    static float low[3 * PLANE], high[3 * PLANE], out[3 * PLANE];
    static uint32_t triangle[3 * PLANE_FACES];
    static uint8_t hidden[PLANE];
    make_plane(0, 1, low, triangle);
    make_plane(0.01f, 0.5f, high, triangle); /* covers its middle */
    proxy_surface below = {PLANE, PLANE_FACES, low, triangle}, above = {PLANE, PLANE_FACES, high, triangle};
    memset(hidden, 0, sizeof hidden);
    assert_ok(c, proxy_cover(c, &below, &above, 0.03f, 0, hidden));
    int wide = 0, narrow = 0;
    for (int i = 0; i < PLANE; i++) wide += hidden[i];
    assert_true(hidden[PLANE / 2]);
    assert_false(hidden[0]);
    assert_in_range(wide, 11 * 11, 13 * 13);
    memset(hidden, 0, sizeof hidden);
    assert_ok(c, proxy_cover(c, &below, &above, 0.03f, 2, hidden));
    for (int i = 0; i < PLANE; i++) narrow += hidden[i];
    assert_true(hidden[PLANE / 2]);
    assert_in_range(narrow, 7 * 7, wide - 30);
    memset(hidden, 0, sizeof hidden); /* a layer below does not cover it */
    assert_ok(c, proxy_cover(c, &above, &below, 0.03f, 0, hidden));
    for (int i = 0; i < PLANE; i++) assert_false(hidden[i]);
    for (int i = 0; i < PLANE; i++) high[3 * i + 2] = -0.004f; /* a sunken layer moves out to the gap */
    assert_ok(c, proxy_push(c, &below, &above, 0.003f, out));
    for (int i = 0; i < PLANE; i++) assert_float_equal(out[3 * i + 2], 0.003f, 1e-5);
    for (int i = 0; i < PLANE; i++) high[3 * i + 2] = 0.01f; /* a layer far enough outside stays */
    assert_ok(c, proxy_push(c, &below, &above, 0.003f, out));
    assert_memory_equal(out, high, sizeof out);
    sherf_context_free(c);
}

/* ---- dyeing ---- */

enum { W = 40, H = 40 };

/* Blue with a red print on the left, white on the right. */
static void make_texels(uint8_t texel[4 * W * H]) {
    for (int i = 0; i < W * H; i++) {
        int x = i % W, y = i / W;
        bool print = x > 4 && x < 9 && y > 10 && y < 15;
        const uint8_t color[4] = {x > 20  ? 240
                                  : print ? 200
                                          : 40,
                                  x > 20  ? 240
                                  : print ? 60
                                          : 60,
                                  x > 20  ? 240
                                  : print ? 20
                                          : 160,
                                  255};
        memcpy(texel + 4 * i, color, 4);
    }
}

static void test_dye(void **state) {
    context *c = test_context();
    /* two squares: one low and blue with a red print, one high and white */
    static const char two[] =
        "{\"ref_vIdxs\": [[0,0,0],[1,1,1],[2,2,2],[3,3,3],[0,0,0],[1,1,1],[2,2,2],[3,3,3]],"
        " \"weights\": [[1,0,0],[1,0,0],[1,0,0],[1,0,0],[1,0,0],[1,0,0],[1,0,0],[1,0,0]],"
        " \"offsets\": [[0,0,0],[0,0,0],[0,0,0],[0,0,0],[0,5,0],[0,5,0],[0,5,0],[0,5,0]],"
        " \"uvs\": [[0,0, 0.4,0, 0.4,1, 0,1, 0.6,0, 1,0, 1,1, 0.6,1]], \"faces\": [11,0,1,2,3,0,0,1,2,3, "
        "11,4,5,6,7,0,4,5,6,7]}";
    proxy *p;
    assert_ok(c, parse(c, two, &p));
    float at[24];
    proxy_fit(p, base, at);
    static uint8_t texel[4 * W * H];
    make_texels(texel);
    image_u8 texture = {W, H, 4, texel}, out;
    dye_map *map;
    assert_ok(c, dye_map_create(c, p, at, true, 0.3f, &texture, &map));
    assert_int_equal(map->parts, 2);
    int blue = map->part[20 * W + 2], white = map->part[20 * W + 36];
    assert_int_not_equal(blue, white);
    assert_float_equal(map->of[blue].share, 0.5f, 0.05f);
    assert_float_equal(map->of[white].low[1], 0.5f, 0.02f);
    assert_float_equal(map->place[3 * (H / 2 * W + 8)], 0.1f, 0.02f); /* halfway along the first square */
    dye_recipe r[DYE_PARTS] = {0};
    r[blue] = (dye_recipe){.pattern = DYE_PLAIN, .color = {{0.1f, 0.6f, 0.2f}}, .detail = 1};
    r[white] = (dye_recipe){
        .pattern = DYE_BANDS, .color = {{1, 1, 0}, {0, 0, 1}}, .scale_m = 0.05f, .ratio = 0.5f, .key = 7};
    dye_cut cut = {-INFINITY, INFINITY};
    assert_ok(c, dye_apply(c, map, &texture, r, &cut, &out));
    const uint8_t *plain = out.data + 4 * (30 * W + 2), *print = out.data + 4 * (12 * W + 6);
    assert_in_range(plain[1], 140, 165);
    assert_in_range(plain[0], 20, 32);
    for (int k = 0; k < 3; k++) assert_true(abs(plain[k] - print[k]) < 25); /* the print is gone */
    int bands = 0, yellow = 0;
    for (int y = 1; y < H; y++) {
        yellow += out.data[4 * (y * W + 30)] > 128;
        bands += (out.data[4 * (y * W + 30)] > 128) != (out.data[4 * ((y - 1) * W + 30)] > 128);
    }
    assert_in_range(bands, 6, 9); /* 0.2 m of bands of 0.05 m, two changes each */
    assert_in_range(yellow, 12, 28);
    mem_free(out.data);
    cut = (dye_cut){0.1f, INFINITY}; /* shorts: the lower half of the lower square is removed */
    assert_ok(c, dye_apply(c, map, &texture, r, &cut, &out));
    assert_int_equal(out.data[4 * ((H - 2) * W + 2) + 3], 0);
    assert_int_equal(out.data[4 * (2 * W + 2) + 3], 255);
    assert_int_equal(out.data[4 * ((H - 2) * W + 36) + 3], 255);
    mem_free(out.data);
    assert_int_equal(dye_apply(c, map, &(image_u8){W, H / 2, 4, texel}, r, &cut, &out), SHERF_BAD_ARGUMENT);
    dye_map_free(map);
    proxy_free(p);
    sherf_context_free(c);
}

/* Every pattern stays within its colours. */
static void test_patterns(void **state) {
    dye_part part = {.low = {-1, -1, -1}, .high = {1, 1, 1}};
    for (int pattern = DYE_PLAIN; pattern < DYE_PATTERNS; pattern++) {
        dye_recipe r = {.pattern = (dye_pattern)pattern, .scale_m = 0.05f, .ratio = 0.5f, .key = 11};
        float max = 0;
        for (int i = 0; i < 4000; i++) {
            float place[3], second, third;
            for (int k = 0; k < 3; k++) place[k] = (float)random_uniform(5, (uint64_t)(3 * i + k)) * 2 - 1;
            dye_shares(&r, &part, place, &second, &third);
            assert_true(second >= 0 && third >= 0 && second + third <= 1 + 1e-6f);
            if (second + third > max) max = second + third;
        }
        assert_true(pattern == DYE_PLAIN ? max == 0 : max > 0.4f);
    }
}

static void test_tint(void **state) {
    context *c = test_context();
    static uint8_t texel[4 * 64];
    for (int i = 0; i < 64; i++)
        for (int k = 0; k < 4; k++)
            texel[4 * i + k] = k == 3 ? (i < 60 ? 255 : 0) : (uint8_t)(100 + i % 3 * 20);
    image_u8 in = {8, 8, 4, texel}, out;
    const float color[3] = {0.8f, 0.4f, 0.2f};
    assert_ok(c, tint_texture(c, &in, color, 1, &out));
    assert_in_range(out.data[4 * 1], 200, 208); /* the middle brightness takes the colour */
    assert_in_range(out.data[4 * 1 + 2], 49, 53);
    assert_true(out.data[0] < out.data[4] && out.data[4] < out.data[8]);
    assert_int_equal(out.data[4 * 61 + 3], 0);
    mem_free(out.data);
    sherf_context_free(c);
}

/* ---- the wardrobe ---- */

static void test_wardrobe(void **state) {
    int kinds[WEAR_KINDS] = {0}, kept = 0;
    for (int i = 0; i < wear_item_count; i++) {
        const wear_item *t = &wear_items[i];
        if (wardrobe_forbidden(t->name)) fail_msg("%s must not be worn", t->name);
        assert_true(!strcmp(t->license, "CC0") || !strcmp(t->license, "CC-BY"));
        assert_true(t->author && *t->author && t->whom);
        assert_int_equal(wear_find(t->name), i); /* no name occurs twice */
        kinds[t->kind]++;
    }
    for (int k = 0; k < WEAR_KINDS; k++) assert_true(kinds[k] || k == WEAR_COAT);
    static const char *const never[] = {"Harvey_Sweater2",
                                        "Sari1",
                                        "Rucksack1",
                                        "bandeau_bra",
                                        "toenail",
                                        "F_Bikini_01",
                                        "Babydoll",
                                        "Full_beard",
                                        "Moustache",
                                        "curly2",
                                        "long_alpha7",
                                        "penis01",
                                        "female_panties_01",
                                        "String3",
                                        "armsleeve_fishnet_medium",
                                        "transparent_bra",
                                        "F_One-piece_Swimsuit_01",
                                        "Teddy",
                                        "frenchbra"};
    for (size_t i = 0; i < COUNT_OF(never); i++) {
        assert_true(wardrobe_forbidden(never[i]));
        assert_int_equal(wear_find(never[i]), -1);
    }
    for (int i = 0; i < outfit_count; i++) {
        bool top = false, bottom = false;
        kept += outfits[i].test_only;
        for (int k = 0; k < OUTFIT_ITEMS && outfits[i].item[k]; k++) {
            int item = wear_find(outfits[i].item[k]);
            assert_true(item >= 0);
            assert_int_equal(wear_items[item].whom & outfits[i].whom, outfits[i].whom);
            wear_kind kind = wear_items[item].kind;
            top |= kind == WEAR_SUIT || kind == WEAR_DRESS || kind == WEAR_TOP;
            bottom |= kind == WEAR_SUIT || kind == WEAR_BOTTOM;
        }
        assert_true(top && bottom); /* nobody is half dressed */
    }
    assert_in_range(kept * 100 / outfit_count, 15, 30);
    for (int i = 0; i < skin_count; i++) assert_false(wardrobe_forbidden(skins[i].texture));
}

/* ---- people ---- */

static void test_people(void **state) {
    person a, b;
    person_draw(NULL, 17, &a);
    person_draw(NULL, 17, &b);
    assert_memory_equal(&a, &b, sizeof a);
    person_draw(NULL, 18, &b);
    assert_true(memcmp(&a.macro, &b.macro, sizeof a.macro));
    int women = 0;
    for (uint64_t i = 0; i < 3000; i++) {
        bool test = i >= 1500;
        person_draw(NULL, test ? person_test_first + i : i, &a);
        const outfit *o = &outfits[a.outfit];
        int whom = a.macro.sex < 0.5 ? FOR_WOMEN : FOR_MEN;
        women += whom == FOR_WOMEN;
        assert_true(o->whom & whom);
        assert_true(skins[a.skin].whom == whom);
        assert_true(a.shoes >= 0 && wear_items[a.shoes].kind == WEAR_SHOES && a.eyes >= 0 && a.brows >= 0);
        assert_true(a.hair < 0 || wear_items[a.hair].kind == WEAR_HAIR);
        assert_true(a.macro.age_years >= 18);
        assert_true(test || !o->test_only);
        /* train and test people share no combination of clothes */
        assert_int_equal(wardrobe_kept_for_tests(a.outfit, a.skin, a.hair), test);
    }
    assert_in_range(women, 1200, 1800);
}

/* ---- poses ---- */

static void test_poses(void **state) {
    context *c = test_context();
    pose_library *l;
    float pose[72], again[72], odd[72];
    assert_ok(c, pose_library_create(c, &l));
    for (int i = 0; i < 72; i++) odd[i] = i % 2 ? 3 : -3; /* outside every range */
    assert_ok(c, pose_library_add_posture(c, l, "odd", odd));
    int count[POSE_KINDS] = {0};
    for (uint64_t i = 0; i < 2000; i++) {
        count[pose_draw(l, i, pose)]++;
        if (!pose_within(pose)) fail_msg("pose %d is out of range", (int)i);
    }
    assert_true(count[POSE_WALK] > 200 && count[POSE_RUN] > 80 && count[POSE_FREE] > 500 &&
                count[POSE_POSTURE] > 100);
    assert_int_equal(count[POSE_CAPTURED], 0); /* none was given */
    pose_draw(l, 5, pose);
    pose_draw(l, 5, again);
    assert_memory_equal(pose, again, sizeof pose);
    pose[3 * 4] = 3;
    assert_false(pose_within(pose));
    pose_clamp(pose);
    assert_true(pose_within(pose));
    pose_library_free(l);
    /* half a step later left and right have swapped */
    pose_walk(0.2, 1, pose);
    pose_walk(0.7, 1, again);
    assert_float_equal(pose[3 * 1], again[3 * 2], 1e-5);
    assert_float_equal(pose[3 * 4], again[3 * 5], 1e-5);
    assert_float_equal(pose[3 * 16 + 2], -again[3 * 17 + 2], 1e-5);
    assert_true(fabsf(pose[3 * 1] - pose[3 * 2]) > 0.3f); /* legs swing in opposite directions */
    sherf_context_free(c);
}

static void test_overlap(void **state) {
    context *c = test_context();
    body_model *body;
    static const float unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, none[72];
    float pose[72] = {0}, share;
    posed_body *posed;
    assert_ok(c, tubeman_create(c, &body));
    assert_ok(c, posed_body_create(c, body, none, none, unit, none, &posed));
    assert_ok(c, pose_overlap(c, body, posed->vertices_smpl, &share));
    assert_float_equal(share, 0, 1e-6);
    posed_body_free(posed);
    pose[3 * 16 + 2] = -1.5f, pose[3 * 18 + 2] = -0.9f; /* the left forearm goes through the hips */
    assert_ok(c, posed_body_create(c, body, pose, none, unit, none, &posed));
    assert_ok(c, pose_overlap(c, body, posed->vertices_smpl, &share));
    assert_true(share > 0.02f);
    posed_body_free(posed);
    sherf_body_free(body);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_binding),  cmocka_unit_test(test_broken_proxies),
                                       cmocka_unit_test(test_cover),    cmocka_unit_test(test_dye),
                                       cmocka_unit_test(test_patterns), cmocka_unit_test(test_tint),
                                       cmocka_unit_test(test_wardrobe), cmocka_unit_test(test_people),
                                       cmocka_unit_test(test_poses),    cmocka_unit_test(test_overlap)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
