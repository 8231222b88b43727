/* Builds a page in memory. */
#include "experiment/page.h"

#include <stdio.h>
#include <string.h>

#include "base/path.h"

void page_free(page *p) {
    for (int i = 0; i < p->tables; i++) mem_free(p->table[i].row);
    for (int i = 0; i < p->plots; i++)
        for (int k = 0; k < p->plot[i].series; k++) mem_free(p->plot[i].line[k].point);
    for (int i = 0; i < p->notes; i++) mem_free(p->note[i]);
    cJSON_Delete(p->made);
    *p = (page){0};
}

static void *full(context *c, const char *what, int max) {
    failure(c, SHERF_BAD_ARGUMENT, "a page has at most %d %s", max, what);
    return NULL;
}

#define FORMAT_INTO(to, format)                                                                              \
    do {                                                                                                     \
        va_list args;                                                                                        \
        va_start(args, format);                                                                              \
        vsnprintf(to, sizeof to, format, args);                                                              \
        va_end(args);                                                                                        \
    } while (0)

page_table *page_add_table(context *c, page *p, const char *format, ...) {
    if (p->tables == PAGE_TABLES) return full(c, "tables", PAGE_TABLES);
    page_table *t = &p->table[p->tables++];
    FORMAT_INTO(t->title, format);
    return t;
}

sherf_status page_add_column(context *c, page_table *t, const char *group, const char *name, int decimals,
                             int better) {
    if (t->columns == PAGE_COLUMNS) {
        full(c, "columns in a table", PAGE_COLUMNS);
        return SHERF_BAD_ARGUMENT;
    }
    page_column *k = &t->column[t->columns++];
    snprintf(k->group, sizeof k->group, "%s", group);
    snprintf(k->name, sizeof k->name, "%s", name);
    k->decimals = decimals;
    k->better = better;
    return SHERF_OK;
}

page_row *page_add_row(context *c, page_table *t, const char *format, ...) {
    if (t->rows == t->capacity) {
        const int capacity = t->capacity ? 2 * t->capacity : 8;
        page_row *grown = mem_grow(c, t->row, (size_t)t->rows, (size_t)capacity, sizeof *grown);
        if (!grown) return NULL;
        t->row = grown;
        t->capacity = capacity;
    }
    page_row *r = &t->row[t->rows++];
    FORMAT_INTO(r->label, format);
    for (int i = 0; i < PAGE_COLUMNS; i++) r->value[i] = interval_none;
    return r;
}

page_plot *page_add_plot(context *c, page *p, const char *name, const char *title) {
    if (p->plots == PAGE_PLOTS) return full(c, "plots", PAGE_PLOTS);
    page_plot *q = &p->plot[p->plots++];
    snprintf(q->name, sizeof q->name, "%s", name);
    snprintf(q->title, sizeof q->title, "%s", title);
    return q;
}

page_series *page_add_series(context *c, page_plot *p, const char *label) {
    if (p->series == PAGE_SERIES) return full(c, "lines in a plot", PAGE_SERIES);
    page_series *s = &p->line[p->series++];
    snprintf(s->label, sizeof s->label, "%s", label);
    return s;
}

sherf_status page_add_point(context *c, page_series *s, double x, interval y) {
    if (s->points == s->capacity) {
        const int capacity = s->capacity ? 2 * s->capacity : 16;
        page_point *grown = mem_grow(c, s->point, (size_t)s->points, (size_t)capacity, sizeof *grown);
        if (!grown) return SHERF_NO_MEMORY;
        s->point = grown;
        s->capacity = capacity;
    }
    s->point[s->points++] = (page_point){x, y};
    return SHERF_OK;
}

sherf_status page_add_note(context *c, page *p, const char *format, ...) {
    char text[1024];
    if (p->notes == PAGE_NOTES) {
        full(c, "notes", PAGE_NOTES);
        return SHERF_BAD_ARGUMENT;
    }
    FORMAT_INTO(text, format);
    char *note = mem_string(c, text);
    if (!note) return SHERF_NO_MEMORY;
    p->note[p->notes++] = note;
    return SHERF_OK;
}

sherf_status page_add_sheet(context *c, page *p, const char *file, const char *caption) {
    if (p->sheets == PAGE_SHEETS) {
        full(c, "sheets", PAGE_SHEETS);
        return SHERF_BAD_ARGUMENT;
    }
    page_sheet *s = &p->sheet[p->sheets++];
    snprintf(s->file, sizeof s->file, "%s", file);
    snprintf(s->caption, sizeof s->caption, "%s", caption);
    return SHERF_OK;
}

void page_value_text(interval v, int decimals, char text[64]) {
    if (isnan(v.mean))
        snprintf(text, 64, "-");
    else if (isnan(v.low))
        snprintf(text, 64, "%.*f", decimals, v.mean);
    else
        snprintf(text, 64, "%.*f [%.*f, %.*f]", decimals, v.mean, decimals, v.low, decimals, v.high);
}

bool page_is_best(const page_table *t, int row, int column) {
    const int better = t->column[column].better;
    const double v = t->row[row].value[column].mean;
    int known = 0;
    if (!better || isnan(v)) return false;
    for (int i = 0; i < t->rows; i++) {
        const double other = t->row[i].value[column].mean;
        known += !isnan(other);
        if (better * other > better * v) return false;
    }
    return known > 1;
}

/* ---- files ---- */
sherf_status page_file_write(context *c, const char *folder, const char *name, const char *text) {
    char path[PATH_LENGTH];
    if (!text) return SHERF_NO_MEMORY;
    if (snprintf(path, sizeof path, "%s/%s", folder, name) >= (int)sizeof path)
        return failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", folder);
    return file_write(c, path, text, strlen(text));
}
