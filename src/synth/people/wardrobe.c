/* The tables of wearable things. */
#include "synth/people/wardrobe.h"

#include <string.h>
#include <strings.h>

#define TEAM "CC0", "MakeHuman team"
#define PUNKDUCK "CC-BY", "punkduck"
#define MINDFRONT "CC-BY", "Mindfront"
#define DRED "CC-BY", "DredNicolson"

const wear_item wear_items[] = {
    {"male_casualsuit01", WEAR_SUIT, FOR_MEN, TEAM},
    {"male_casualsuit02", WEAR_SUIT, FOR_ALL, TEAM},
    {"male_casualsuit03", WEAR_SUIT, FOR_MEN, TEAM},
    {"male_casualsuit04", WEAR_SUIT, FOR_ALL, TEAM},
    {"male_casualsuit05", WEAR_SUIT, FOR_MEN, TEAM},
    {"male_casualsuit06", WEAR_SUIT, FOR_ALL, TEAM},
    {"male_elegantsuit01", WEAR_SUIT, FOR_MEN, TEAM},
    {"male_worksuit01", WEAR_SUIT, FOR_ALL, TEAM},
    {"female_casualsuit01", WEAR_SUIT, FOR_WOMEN, TEAM},
    {"female_casualsuit02", WEAR_SUIT, FOR_WOMEN, TEAM},
    {"female_elegantsuit01", WEAR_SUIT, FOR_WOMEN, TEAM},
    {"female_sportsuit01", WEAR_SUIT, FOR_WOMEN, TEAM},
    {"F_Dress_01", WEAR_DRESS, FOR_WOMEN, MINDFRONT},
    {"F_Dress_02", WEAR_DRESS, FOR_WOMEN, MINDFRONT},
    {"F_Dress_03", WEAR_DRESS, FOR_WOMEN, MINDFRONT},
    {"F_Dress_04", WEAR_DRESS, FOR_WOMEN, MINDFRONT},
    {"Asymmetric_Tunic_and_Sash", WEAR_DRESS, FOR_WOMEN, DRED},
    {"Tank_Top_01", WEAR_TOP, FOR_ALL, MINDFRONT},
    {"Sleeveless", WEAR_TOP, FOR_WOMEN, PUNKDUCK},
    {"VNeckTop", WEAR_TOP, FOR_WOMEN, PUNKDUCK},
    {"spaghetti-top", WEAR_TOP, FOR_WOMEN, PUNKDUCK},
    {"short_tail_camo_tee", WEAR_TOP, FOR_ALL, DRED},
    {"Tightjeans", WEAR_BOTTOM, FOR_ALL, PUNKDUCK},
    {"ShortJeans", WEAR_BOTTOM, FOR_WOMEN, PUNKDUCK},
    {"miniskirt", WEAR_BOTTOM, FOR_WOMEN, PUNKDUCK},
    {"Coat", WEAR_COAT, FOR_WOMEN, PUNKDUCK},
    {"shoes01", WEAR_SHOES, FOR_ALL, TEAM},
    {"shoes02", WEAR_SHOES, FOR_ALL, TEAM},
    {"shoes03", WEAR_SHOES, FOR_ALL, TEAM},
    {"shoes04", WEAR_SHOES, FOR_ALL, TEAM},
    {"shoes05", WEAR_SHOES, FOR_ALL, TEAM},
    {"shoes06", WEAR_SHOES, FOR_ALL, TEAM},
    {"WinterBoots", WEAR_SHOES, FOR_WOMEN, PUNKDUCK, false, true},
    {"fedora", WEAR_HAT, FOR_ALL, TEAM},
    {"fedora_cocked", WEAR_HAT, FOR_ALL, TEAM},
    {"Fishing_Hat_01", WEAR_HAT, FOR_ALL, MINDFRONT},
    {"pith_helmet", WEAR_HAT, FOR_ALL, DRED},
    {"glasses", WEAR_GLASSES, FOR_ALL, PUNKDUCK},
    {"afro01", WEAR_HAIR, FOR_ALL, TEAM},
    {"bob01", WEAR_HAIR, FOR_WOMEN, TEAM},
    {"bob02", WEAR_HAIR, FOR_WOMEN, TEAM},
    {"Braid01", WEAR_HAIR, FOR_WOMEN, TEAM},
    {"long01", WEAR_HAIR, FOR_WOMEN, TEAM},
    {"ponytail01", WEAR_HAIR, FOR_WOMEN, TEAM},
    {"short01", WEAR_HAIR, FOR_MEN, TEAM, true},
    {"short02", WEAR_HAIR, FOR_ALL, TEAM, true},
    {"short03", WEAR_HAIR, FOR_ALL, TEAM, true},
    {"short04", WEAR_HAIR, FOR_MEN, TEAM, true},
    {"eyebrow001", WEAR_BROWS, FOR_ALL, TEAM},
    {"eyebrow002", WEAR_BROWS, FOR_ALL, TEAM},
    {"eyebrow003", WEAR_BROWS, FOR_ALL, TEAM},
    {"eyebrow004", WEAR_BROWS, FOR_ALL, TEAM},
    {"eyebrow005", WEAR_BROWS, FOR_ALL, TEAM},
    {"eyebrow006", WEAR_BROWS, FOR_ALL, TEAM},
    {"eyebrow007", WEAR_BROWS, FOR_ALL, TEAM},
    {"eyebrow008", WEAR_BROWS, FOR_ALL, TEAM},
    {"eyebrow009", WEAR_BROWS, FOR_ALL, TEAM},
    {"eyebrow010", WEAR_BROWS, FOR_ALL, TEAM},
    {"eyebrow011", WEAR_BROWS, FOR_ALL, TEAM},
    {"eyebrow012", WEAR_BROWS, FOR_ALL, TEAM},
    {"Eyelashes01", WEAR_LASHES, FOR_ALL, TEAM},
    {"eyelashes02", WEAR_LASHES, FOR_ALL, TEAM},
    {"eyelashes03", WEAR_LASHES, FOR_ALL, TEAM},
    {"eyelashes04", WEAR_LASHES, FOR_ALL, TEAM},
    {"HighPolyEyes", WEAR_EYES, FOR_ALL, TEAM},
};
const int wear_item_count = (int)COUNT_OF(wear_items);

/* Knees lie 0.36 m below the base mesh's origin, elbows 0.31 m from its middle. */
const outfit outfits[] = {
    {{"male_casualsuit01"}, FOR_MEN, 0, 0, 3},
    {{"male_casualsuit02"}, FOR_ALL, 0, 0, 4},
    {{"male_casualsuit02"}, FOR_ALL, -0.33f, 0, 1.5},      /* shorts */
    {{"male_casualsuit02"}, FOR_ALL, 0, 0.27f, 1.5, true}, /* short sleeves */
    {{"male_casualsuit03"}, FOR_MEN, 0, 0, 3},
    {{"male_casualsuit03"}, FOR_MEN, -0.33f, 0.27f, 1.5}, /* a shirt with short sleeves, shorts */
    {{"male_casualsuit04"}, FOR_ALL, 0, 0, 4},
    {{"male_casualsuit04"}, FOR_ALL, -0.31f, 0, 2},
    {{"male_casualsuit05"}, FOR_MEN, 0, 0, 3},
    {{"male_casualsuit06"}, FOR_ALL, 0, 0, 3},
    {{"male_casualsuit06"}, FOR_ALL, -0.33f, 0, 1.5, true},
    {{"male_elegantsuit01"}, FOR_MEN, 0, 0, 4},
    {{"male_worksuit01"}, FOR_ALL, 0, 0, 2, true},
    {{"female_casualsuit01"}, FOR_WOMEN, 0, 0, 4},
    {{"female_casualsuit01"}, FOR_WOMEN, -0.4f, 0, 1.5},
    {{"female_casualsuit02"}, FOR_WOMEN, 0, 0, 3},
    {{"female_elegantsuit01"}, FOR_WOMEN, 0, 0, 4},
    {{"female_sportsuit01"}, FOR_WOMEN, 0, 0, 2, true},
    {{"Tightjeans", "Tank_Top_01"}, FOR_ALL, 0, 0, 2},
    {{"Tightjeans", "short_tail_camo_tee"}, FOR_ALL, 0, 0, 3},
    {{"Tightjeans", "Sleeveless"}, FOR_WOMEN, 0, 0, 2},
    {{"Tightjeans", "VNeckTop"}, FOR_WOMEN, 0, 0, 2, true},
    {{"Tightjeans", "spaghetti-top"}, FOR_WOMEN, 0, 0, 1.5},
    {{"Tightjeans", "F_Dress_01"}, FOR_WOMEN, 0, 0, 1.5},
    {{"Tightjeans", "F_Dress_02"}, FOR_WOMEN, 0, 0, 2, true},
    {{"Tightjeans", "F_Dress_03"}, FOR_WOMEN, 0, 0, 2},
    {{"Tightjeans", "F_Dress_04"}, FOR_WOMEN, 0, 0, 1.5},
    {{"Tightjeans", "Asymmetric_Tunic_and_Sash"}, FOR_WOMEN, 0, 0, 2},
    {{"Tightjeans", "short_tail_camo_tee", "Coat"}, FOR_WOMEN, 0, 0, 3},
};
const int outfit_count = (int)COUNT_OF(outfits);

const skin skins[] = {
    {"young_african_female", "young_darkskinned_female_diffuse.png", FOR_WOMEN, 0, 0},
    {"young_african_male", "young_darkskinned_male_diffuse.png", FOR_MEN, 0, 0},
    {"young_asian_female", "young_lightskinned_female_diffuse3.png", FOR_WOMEN, 0, 1},
    {"young_asian_male", "young_lightskinned_male_diffuse3.png", FOR_MEN, 0, 1},
    {"young_caucasian_female", "young_lightskinned_female_diffuse.png", FOR_WOMEN, 0, 2},
    {"young_caucasian_male", "young_lightskinned_male_diffuse.png", FOR_MEN, 0, 2},
    {"young_caucasian_female", "young_lightskinned_female_diffuse2.png", FOR_WOMEN, 0, 2},
    {"young_caucasian_male", "young_lightskinned_male_diffuse2.png", FOR_MEN, 0, 2},
    {"middleage_african_female", "middleage_darkskinned_female_diffuse.png", FOR_WOMEN, 1, 0},
    {"middleage_african_male", "middleage_darkskinned_male_diffuse.png", FOR_MEN, 1, 0},
    {"middleage_asian_female", "middleage_lightskinned_female_diffuse2.png", FOR_WOMEN, 1, 1},
    {"middleage_asian_male", "middleage_lightskinned_male_diffuse2.png", FOR_MEN, 1, 1},
    {"middleage_caucasian_female", "middleage_lightskinned_female_diffuse.png", FOR_WOMEN, 1, 2},
    {"middleage_caucasian_male", "middleage_lightskinned_male_diffuse.png", FOR_MEN, 1, 2},
    {"old_african_female", "old_darkskinned_female_diffuse.png", FOR_WOMEN, 2, 0},
    {"old_african_male", "old_darkskinned_male_diffuse.png", FOR_MEN, 2, 0},
    {"old_asian_female", "old_lightskinned_female_diffuse2.png", FOR_WOMEN, 2, 1},
    {"old_asian_male", "old_lightskinned_male_diffuse2.png", FOR_MEN, 2, 1},
    {"old_caucasian_female", "old_lightskinned_female_diffuse.png", FOR_WOMEN, 2, 2},
    {"old_caucasian_male", "old_lightskinned_male_diffuse.png", FOR_MEN, 2, 2},
};
const int skin_count = (int)COUNT_OF(skins);

/* Under AGPL, of unknown origin, or indecent. */
static const char *const forbidden[] = {"Harvey",
                                        "Cocktaildress",
                                        "Sari1",
                                        "Rucksack1",
                                        "Rolled_neck_blouse",
                                        "bandeau",
                                        "toenail",
                                        "curly",
                                        "junglebookhair",
                                        "minoan",
                                        "alpha7",
                                        "Wig_bun",
                                        "blondwithheadband",
                                        "beard",
                                        "moustache",
                                        "southernbelleringlets",
                                        "bikini",
                                        "swimsuit",
                                        "Babydoll",
                                        "Teddy",
                                        "String",
                                        "bra",
                                        "panties",
                                        "transparent",
                                        "fishnet",
                                        "lingerie",
                                        "penis",
                                        "genital",
                                        "special_suit",
                                        "toon"};

bool wardrobe_forbidden(const char *name) {
    if (!strcasecmp(name, "Braid01")) return false; /* a hair style */
    for (size_t i = 0; i < COUNT_OF(forbidden); i++)
        if (strcasestr(name, forbidden[i])) return true;
    return false;
}

int wear_find(const char *name) {
    for (int i = 0; i < wear_item_count; i++)
        if (!strcmp(wear_items[i].name, name)) return i;
    return -1;
}

bool wardrobe_kept_for_tests(int outfit_index, int skin_index, int hair_item) {
    if (outfits[outfit_index].test_only) return true;
    uint64_t key = random_key((uint64_t)outfit_index, "wardrobe.split", (uint64_t)skin_index);
    return random_uniform(key, (uint64_t)(hair_item + 1)) < 0.2;
}
