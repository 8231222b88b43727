/* report: scores of pictures and their means, as a table and as JSON; of the model and perhaps of baselines.
 */
#ifndef SHERF_REPORT_H
#define SHERF_REPORT_H

#include "eval/estimated.h"
#include "eval/regions.h"
#include "eval/surface_list.h"

enum { SCORE_MODEL, SCORE_MEAN_COLOR, SCORE_PAINTED_BODY, SCORE_KINDS };

typedef struct {
    double psnr, ssim, lpips, resnet50; /* the last two NaN: not computed */
} picture_score;

typedef struct {
    int person; /* of the data set */
    picture observation, target;
    bool novel_pose;
    picture_score score[SCORE_KINDS];
    region_errors regions; /* of the model */
    char *rgb, *png;       /* file names below the output folder; NULL: not written; owned */
} report_entry;

typedef struct {
    int64_t count, capacity;
    report_entry *entry;
    bool baselines;          /* false: only SCORE_MODEL is filled in */
    estimate_list estimates; /* empty: bodies and cameras are the data set's */
    surface_list surfaces;   /* empty: the avatars have none, or the data set */
    int pictures;            /* of an observation; 0: 1 */
    uint64_t variant;        /* of the avatars; 0: the best guess */
    bool plain_mean;         /* over all pictures alike: observations drawn by chance */
} report;

sherf_status report_add(context *c, report *r, const report_entry *e); /* takes over rgb and png on success */
void report_free(report *r);
/* Means of one kind over one person (-1: everyone) of novel view or novel pose. Observations from different
 * views are averaged on their own first, then the means, as in the paper, unless it is a plain mean. */
sherf_score report_mean(const report *r, int kind, int person, bool novel_pose);
/* Text to print; mem_free it. NULL: out of memory. */
char *report_table(context *c, const report *r, const sherf_dataset *d);
sherf_status report_write_json(context *c, const report *r, const sherf_dataset *d, const char *path);

#endif
