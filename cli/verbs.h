/* One of these a verb, each in its cmd_VERB.c. */
#ifndef CLI_VERBS_H
#define CLI_VERBS_H

#include "options.h"

extern const verb verb_avatar, verb_estimate, verb_render, verb_animate, verb_view, verb_export, verb_train,
    verb_eval, verb_synth, verb_convert, verb_check, verb_info, verb_bench;

#endif
