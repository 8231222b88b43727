/* protocol: sherf_eval, with the data set's observations or an estimator's. */
#ifndef SHERF_PROTOCOL_H
#define SHERF_PROTOCOL_H

#include "eval/estimated.h"

/* estimator NULL: sherf_eval. */
sherf_status eval_run(context *c, const sherf_eval_options *options, const eval_estimator *estimator,
                      sherf_scores *out);

#endif
