/* Sheets of pictures side by side, as in the paper's figures: the observation, the truth and each method's
 * result, assembled from the sheets of the methods' scorings. */
#include <stdio.h>
#include <string.h>

#include "eval/sheet.h"
#include "experiment/experiment.h"
#include "io/canvas.h"

enum { CELL = SHEET_CELL_PX, COLUMNS_MAX = EXPERIMENT_METHODS + 2, SHOWN_PAIRS = 2, HEAD = 20, ROWS_MAX = 8 };
/* The pairs of a sheet that are shown. */
static const int shown_pair[SHOWN_PAIRS] = {1, 3};

typedef struct {
    int methods, rows, pairs; /* rows: people; pairs: in every sheet */
    const char *label[EXPERIMENT_METHODS];
    image_u8 sheet[EXPERIMENT_METHODS];
} gallery;

static void cell_copy(const image_u8 *from, int row, int column, canvas *to, int row_to, int column_to) {
    for (int y = 0; y < CELL; y++)
        memcpy(to->rgb +
                   3 * ((size_t)(HEAD + row_to * CELL + y) * (size_t)to->width + (size_t)(column_to * CELL)),
               from->data + 3 * ((size_t)(row * CELL + y) * (size_t)from->width + (size_t)(column * CELL)),
               3 * CELL);
}

/* Draws as many letters as fit in a cell. */
static void heading(canvas *to, int column, const char *text) {
    char cut[CELL / CANVAS_LETTER_WIDTH];
    snprintf(cut, sizeof cut, "%s", text);
    canvas_text(to, column * CELL + 3, 2, cut, 0x202020);
}

static void draw(const gallery *g, canvas *to) {
    heading(to, 0, "input");
    heading(to, 1, "truth");
    for (int method = 0; method < g->methods; method++) heading(to, 2 + method, g->label[method]);
    for (int row = 0; row < g->rows; row++)
        for (int k = 0; k < SHOWN_PAIRS; k++) {
            const int at = row * SHOWN_PAIRS + k,
                      pair = shown_pair[k] < g->pairs ? shown_pair[k] : g->pairs - 1;
            cell_copy(&g->sheet[0], row, 0, to, at, 0);
            cell_copy(&g->sheet[0], row, 2 + 2 * pair, to, at, 1);
            for (int method = 0; method < g->methods; method++)
                cell_copy(&g->sheet[method], row, 1 + 2 * pair, to, at, 2 + method);
        }
}

/* Reads the methods' sheets of the first seed and the first data set; skips methods that have none. */
static sherf_status gallery_read(experiment_job *j, const scoring *s, gallery *g) {
    run r;
    char path[PATH_LENGTH];
    sherf_status status = SHERF_OK;
    for (int i = 0; status == SHERF_OK && run_at(j, i, &r); i++) {
        if (!run_has(&r, s) || r.data != &j->data[0]) continue;
        image_u8 *read = &g->sheet[g->methods];
        status = scoring_path(j, &r, s, 0, "sheet.png", path);
        if (status != SHERF_OK || !path_is_file(path)) continue;
        if ((status = image_read(j->c, path, 3, read)) != SHERF_OK) continue;
        const int rows = read->height / CELL, pairs = (read->width / CELL - 1) / 2;
        if (read->width > SHEET_COLUMNS * CELL || pairs < 1 || rows < 1)
            status = failure(j->c, SHERF_BAD_FILE, "%s: not the sheet of an evaluation", path);
        g->pairs = g->methods && g->pairs < pairs ? g->pairs : pairs;
        g->rows = g->methods && g->rows < rows ? g->rows : rows < ROWS_MAX ? rows : ROWS_MAX;
        g->label[g->methods++] = r.method->label;
    }
    return status;
}

static sherf_status sheet_add(experiment_job *j, page *p, const scoring *s) {
    const bool poses = s->kind == SCORING_POSES;
    const char *name = poses ? "novel-pose.png" : "novel-view.png";
    gallery g = {0};
    canvas to = {0};
    char path[PATH_LENGTH];
    sherf_status status = gallery_read(j, s, &g);
    if (status == SHERF_OK && g.methods) {
        status = job_path(j, path, "%s/%s", j->experiment->name, name);
        if (status == SHERF_OK)
            status = canvas_create(j->c, (2 + g.methods) * CELL, HEAD + g.rows * SHOWN_PAIRS * CELL, &to);
        if (status == SHERF_OK) draw(&g, &to);
        if (status == SHERF_OK) status = canvas_write(j->c, &to, path);
        if (status == SHERF_OK)
            status = page_add_sheet(j->c, p, name,
                                    poses ? "Novel poses of test people" : "Novel views of test people");
    }
    canvas_free(&to);
    for (int i = 0; i < EXPERIMENT_METHODS; i++) mem_free(g.sheet[i].data);
    return status;
}

sherf_status gallery_add(experiment_job *j, page *p) {
    sherf_status status = SHERF_OK;
    for (int i = 0; i < j->experiment->scorings && status == SHERF_OK; i++) {
        const scoring *s = &j->experiment->scoring[i];
        if (s->kind == SCORING_VIEWS || s->kind == SCORING_POSES) status = sheet_add(j, p, s);
    }
    return status;
}
