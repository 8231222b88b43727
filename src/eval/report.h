/* report: scores of pictures and their means, as a table and as JSON. */
#ifndef SHERF_REPORT_H
#define SHERF_REPORT_H

#include "eval/selection.h"

typedef struct {
    int person; /* of the data set */
    picture observation, target;
    bool novel_pose;
    double psnr, ssim, lpips; /* lpips NaN: not computed */
    char *rgb, *png;          /* file names below the output folder; NULL: not written; owned */
} report_entry;

typedef struct {
    int64_t count, capacity;
    report_entry *entry;
} report;

sherf_status report_add(context *c, report *r, const report_entry *e); /* takes over rgb and png on success */
void report_free(report *r);
/* Means over one person (-1: everyone) of novel view or novel pose. Observations from different views are
 * averaged on their own first, then the means, as in the paper. */
sherf_score report_mean(const report *r, int person, bool novel_pose);
/* Text to print; mem_free it. NULL when memory lacks. */
char *report_table(context *c, const report *r, const sherf_dataset *d);
sherf_status report_write_json(context *c, const report *r, const sherf_dataset *d, const char *path);

#endif
