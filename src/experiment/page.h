/* page: an experiment's results, and the folder that they are written to: table.md, table.tex, results.json,
 * NAME.svg and NAME.png for each plot, and index.html, which shows them all. */
#ifndef SHERF_PAGE_H
#define SHERF_PAGE_H

#include <cjson/cJSON.h>

#include "experiment/interval.h"

enum {
    PAGE_TABLES = 8,
    PAGE_COLUMNS = 20,
    PAGE_PLOTS = 4,
    PAGE_SERIES = 8,
    PAGE_NOTES = 16,
    PAGE_SHEETS = 4
};

typedef struct {
    char group[64], name[32]; /* columns of one group are adjacent, under its name; "": none */
    int decimals, better;     /* 1: larger is better, -1: smaller, 0: neither */
} page_column;
typedef struct {
    char label[160];
    interval value[PAGE_COLUMNS];
} page_row;
typedef struct {
    char title[256];
    int columns, rows, capacity;
    page_column column[PAGE_COLUMNS];
    page_row *row; /* owned */
} page_table;

typedef struct {
    double x;
    interval y;
} page_point;
typedef struct {
    char label[64];
    int points, capacity;
    page_point *point; /* owned */
} page_series;
typedef struct {
    char name[32], title[160], x[64], y[64]; /* of files; above the plot; of the axes */
    double step;                             /* between ticks of x */
    int series;
    page_series line[PAGE_SERIES];
} page_plot;

typedef struct {
    char file[64], caption[256];
} page_sheet;

typedef struct {
    char name[32], title[160];
    int tables, plots, sheets, notes;
    page_table table[PAGE_TABLES];
    page_plot plot[PAGE_PLOTS];
    page_sheet sheet[PAGE_SHEETS];
    char *note[PAGE_NOTES]; /* paragraphs; owned */
    cJSON *made;            /* how it was made: settings and trainings, for results.json; owned */
} page;
void page_free(page *p);

/* NULL, with the message set: no room or no memory. */
page_table *page_add_table(context *c, page *p, const char *format, ...) PRINTF_LIKE(3, 4);
sherf_status page_add_column(context *c, page_table *t, const char *group, const char *name, int decimals,
                             int better);
page_row *page_add_row(context *c, page_table *t, const char *format, ...) PRINTF_LIKE(3, 4);
page_plot *page_add_plot(context *c, page *p, const char *name, const char *title);
page_series *page_add_series(context *c, page_plot *p, const char *label);
sherf_status page_add_point(context *c, page_series *s, double x, interval y);
sherf_status page_add_note(context *c, page *p, const char *format, ...) PRINTF_LIKE(3, 4);
sherf_status page_add_sheet(context *c, page *p, const char *file, const char *caption);

/* Writes a text as one of the page's files; NULL: out of memory. */
sherf_status page_file_write(context *c, const char *folder, const char *name, const char *text);
/* page_write.c: writes all of it. The folder and the sheets' files must exist. */
sherf_status page_write(context *c, const page *p, const char *folder);
/* plot.c: NAME.svg and NAME.png. */
sherf_status page_plot_write(context *c, const page_plot *p, const char *folder);
/* "24.66 [24.10, 25.20]"; "-" if there is none. */
void page_value_text(interval v, int decimals, char text[64]);
/* Whether a row's value is the best of several in its column. */
bool page_is_best(const page_table *t, int row, int column);

#endif
