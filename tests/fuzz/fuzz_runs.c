/* Fuzz target: files that trainings and evaluations write and read again, scores.json and log.jsonl. The
 * first byte chooses. */
#include "experiment/scores.h"
#include "fuzz_folder.h"
#include "train/history.h"

static sherf_status scores_use(context *c, const char *path) {
    scores s;
    interval i;
    sherf_status status = scores_read(c, path, &s);
    for (int k = 0; k < s.pictures && !status; k++)
        if (s.picture[k].person < 0 || s.picture[k].person >= s.people || s.picture[k].view < 0) abort();
    if (!status && s.people < 8 && scores_interval(c, &s, NULL, 1, false, METRIC_PSNR, &i) == SHERF_NO_MEMORY)
        abort();
    scores_free(&s);
    return status;
}

static sherf_status history_use(context *c, const char *path) {
    history h;
    sherf_status status = history_open(c, path, 1000, &h);
    for (int64_t i = 0; i < h.count && !status; i++)
        if (h.point[i].step < 1 || h.point[i].step > 1000) abort();
    history_close(&h);
    return status;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    context *c = fuzz_context();
    if (!size) return 0;
    const char *path = fuzz_file("file", data + 1, size - 1);
    const size_t live = mem_live();
    sherf_status status = data[0] % 2 ? scores_use(c, path) : history_use(c, path);
    return fuzz_end(c, status, live);
}
