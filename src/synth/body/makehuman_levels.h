/* The levels of macro variables, as in targets' names, in the order of level_names. */
#ifndef SHERF_MAKEHUMAN_LEVELS_H
#define SHERF_MAKEHUMAN_LEVELS_H

#define LEVEL_LIST(X)                                                                                        \
    X(FEMALE, "female")                                                                                      \
    X(MALE, "male")                                                                                          \
    X(BABY, "baby")                                                                                          \
    X(CHILD, "child")                                                                                        \
    X(YOUNG, "young")                                                                                        \
    X(OLD, "old")                                                                                            \
    X(MIN_WEIGHT, "minweight")                                                                               \
    X(AVERAGE_WEIGHT, "averageweight")                                                                       \
    X(MAX_WEIGHT, "maxweight")                                                                               \
    X(MIN_MUSCLE, "minmuscle")                                                                               \
    X(AVERAGE_MUSCLE, "averagemuscle")                                                                       \
    X(MAX_MUSCLE, "maxmuscle")                                                                               \
    X(MIN_HEIGHT, "minheight")                                                                               \
    X(AVERAGE_HEIGHT, "averageheight")                                                                       \
    X(MAX_HEIGHT, "maxheight")                                                                               \
    X(UNCOMMON, "uncommonproportions")                                                                       \
    X(REGULAR, "regularproportions")                                                                         \
    X(IDEAL, "idealproportions")                                                                             \
    X(MIN_CUP, "mincup")                                                                                     \
    X(AVERAGE_CUP, "averagecup")                                                                             \
    X(MAX_CUP, "maxcup")                                                                                     \
    X(MIN_FIRMNESS, "minfirmness")                                                                           \
    X(AVERAGE_FIRMNESS, "averagefirmness")                                                                   \
    X(MAX_FIRMNESS, "maxfirmness")                                                                           \
    X(AFRICAN, "african")                                                                                    \
    X(ASIAN, "asian")                                                                                        \
    X(CAUCASIAN, "caucasian")

enum makehuman_level {
#define X(name, text) LEVEL_##name,
    LEVEL_LIST(X)
#undef X
        LEVELS
};

#endif
