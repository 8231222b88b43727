/* The verbs: one struct for each, in its cmd_VERB.c. */
#ifndef CLI_VERBS_H
#define CLI_VERBS_H

#include "options.h"

/* In the order of `sherf --help`; verb_NAME is in cmd_NAME.c. */
#define VERBS(X)                                                                                             \
    X(avatar)                                                                                                \
    X(estimate)                                                                                              \
    X(render)                                                                                                \
    X(animate)                                                                                               \
    X(bake) X(view) X(export) X(train) X(eval) X(experiment) X(synth) X(convert) X(check) X(info) X(bench)
#define VERB_DECLARE(name) extern const verb verb_##name;
VERBS(VERB_DECLARE)

#endif
