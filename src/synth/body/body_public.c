/* sherf_synth_body: makes a body file from the package. */
#include <math.h>

#include "data/text.h"
#include "synth/body/open_body.h"

static void report_text(text_builder *t, const body_source *source, const open_body_report *r) {
    text_add(t, "%d adults: %.2f %% of their variance kept, vertices off by %.1f mm (root mean square)\n",
             r->samples, 100 * r->kept, r->error_mm);
    text_add(t, "joints regressed within %.1f mm on average, %.1f mm at most\n", r->joint_error_mean_mm,
             r->joint_error_mm);
    for (int k = 0; k < BODY_SHAPES; k++) {
        text_add(t, "shape %d: ", k);
        char line[OPEN_BODY_LINE];
        open_body_describe(source, r, k, line);
        text_add(t, "%s\n", line);
    }
}

sherf_status sherf_synth_body(sherf_context *c, const sherf_synth_body_options *options, char **text) {
    if (text) *text = NULL;
    if (!options || !options->source || !options->output)
        return failure(c, SHERF_BAD_ARGUMENT, "synth body: source and output are needed");
    makehuman *human = NULL;
    tpose_rig *rig = NULL;
    makehuman_source *s = NULL;
    body_model *body = NULL;
    open_body_report report;
    text_builder t = {.c = c};
    sherf_status status = makehuman_open(c, options->source, &human);
    if (!status) status = tpose_rig_create(c, human, &rig);
    if (!status) status = makehuman_source_create(c, human, rig, &s);
    if (!status)
        status = open_body_create(c, &s->source, options->people ? options->people : 1000, &body, &report);
    if (!status) status = open_body_save(c, &s->source, body, &report, options->output);
    if (!status && options->sheet) status = open_body_sheet(c, body, options->sheet);
    if (!status && text) {
        report_text(&t, &s->source, &report);
        *text = text_take(&t);
        if (!*text) status = SHERF_NO_MEMORY;
    }
    sherf_body_free(body);
    makehuman_source_free(s);
    tpose_rig_free(rig);
    makehuman_close(human);
    return status;
}
