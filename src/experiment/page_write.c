/* A page as files: Markdown, LaTeX, JSON and HTML, with the same tables in each. */
#include <stdio.h>
#include <string.h>

#include "data/text.h"
#include "experiment/page.h"

/* The number of columns from `column` on in the same group. */
static int group_span(const page_table *t, int column) {
    int n = 1;
    while (column + n < t->columns && !strcmp(t->column[column].group, t->column[column + n].group)) n++;
    return n;
}

static bool has_groups(const page_table *t) {
    for (int k = 0; k < t->columns; k++)
        if (*t->column[k].group) return true;
    return false;
}

/* ---- Markdown ---- */
static void md_table(text_builder *to, const page_table *t) {
    char text[64];
    text_add(to, "### %s\n\n|  |", t->title);
    for (int k = 0; k < t->columns; k++)
        text_add(to, " %s%s%s |", t->column[k].group, *t->column[k].group && *t->column[k].name ? " " : "",
                 t->column[k].name);
    text_add(to, "\n| --- |");
    for (int k = 0; k < t->columns; k++) text_add(to, " --- |");
    for (int i = 0; i < t->rows; i++) {
        text_add(to, "\n| %s |", t->row[i].label);
        for (int k = 0; k < t->columns; k++) {
            const char *bold = page_is_best(t, i, k) ? "**" : "";
            page_value_text(t->row[i].value[k], t->column[k].decimals, text);
            text_add(to, " %s%s%s |", bold, text, bold);
        }
    }
    text_add(to, "\n\n");
}

static sherf_status md_write(context *c, const page *p, const char *folder) {
    text_builder to = {.c = c};
    text_add(&to, "# %s\n\n", p->title);
    for (int i = 0; i < p->tables; i++) md_table(&to, &p->table[i]);
    for (int i = 0; i < p->plots; i++) text_add(&to, "![%s](%s.png)\n\n", p->plot[i].title, p->plot[i].name);
    for (int i = 0; i < p->sheets; i++) text_add(&to, "![%s](%s)\n\n", p->sheet[i].caption, p->sheet[i].file);
    for (int i = 0; i < p->notes; i++) text_add(&to, "%s\n\n", p->note[i]);
    char *text = text_take(&to);
    sherf_status status = page_file_write(c, folder, "table.md", text);
    mem_free(text);
    return status;
}

/* ---- LaTeX ---- */
static void tex_text(text_builder *to, const char *text) {
    for (; *text; text++) {
        if (strchr("&%$#_{}", *text))
            text_add(to, "\\%c", *text);
        else if (*text == '~' || *text == '^' || *text == '\\')
            text_add(to, "\\char%d{}", *text);
        else
            text_add(to, "%c", *text);
    }
}

static void tex_head(text_builder *to, const page_table *t) {
    for (int k = 0; k < t->columns && has_groups(t); k += group_span(t, k)) {
        text_add(to, " & \\multicolumn{%d}{c}{", group_span(t, k));
        tex_text(to, t->column[k].group);
        text_add(to, "}");
    }
    if (has_groups(t)) text_add(to, " \\\\\n");
    for (int k = 0; k < t->columns; k++) {
        text_add(to, " & ");
        tex_text(to, t->column[k].name);
    }
    text_add(to, " \\\\\n\\hline\n");
}

static void tex_table(text_builder *to, const page_table *t) {
    char text[64];
    text_add(to, "\\begin{table}\n\\centering\n\\begin{tabular}{l");
    for (int k = 0; k < t->columns; k++) text_add(to, "c");
    text_add(to, "}\n\\hline\n");
    tex_head(to, t);
    for (int i = 0; i < t->rows; i++) {
        tex_text(to, t->row[i].label);
        for (int k = 0; k < t->columns; k++) {
            page_value_text(t->row[i].value[k], t->column[k].decimals, text);
            text_add(to, page_is_best(t, i, k) ? " & \\textbf{%s}" : " & %s", text);
        }
        text_add(to, " \\\\\n");
    }
    text_add(to, "\\hline\n\\end{tabular}\n\\caption{");
    tex_text(to, t->title);
    text_add(to, "}\n\\end{table}\n\n");
}

static sherf_status tex_write(context *c, const page *p, const char *folder) {
    text_builder to = {.c = c};
    for (int i = 0; i < p->tables; i++) tex_table(&to, &p->table[i]);
    char *text = text_take(&to);
    sherf_status status = page_file_write(c, folder, "table.tex", text);
    mem_free(text);
    return status;
}

/* ---- HTML ---- */
static void html_text(text_builder *to, const char *text) {
    for (; *text; text++) {
        if (*text == '&' || *text == '<' || *text == '>' || *text == '"')
            text_add(to, "&#%d;", *text);
        else
            text_add(to, "%c", *text);
    }
}

static void html_head(text_builder *to, const page_table *t) {
    text_add(to, "<tr><th rowspan=\"%d\"></th>", has_groups(t) ? 2 : 1);
    for (int k = 0; k < t->columns && has_groups(t); k += group_span(t, k)) {
        text_add(to, "<th colspan=\"%d\">", group_span(t, k));
        html_text(to, t->column[k].group);
        text_add(to, "</th>");
    }
    if (has_groups(t)) text_add(to, "</tr>\n<tr>");
    for (int k = 0; k < t->columns; k++) {
        text_add(to, "<th>");
        html_text(to, t->column[k].name);
        text_add(to, "</th>");
    }
    text_add(to, "</tr>\n");
}

static void html_table(text_builder *to, const page_table *t) {
    char text[64];
    text_add(to, "<h2>");
    html_text(to, t->title);
    text_add(to, "</h2>\n<div class=\"wide\"><table>\n");
    html_head(to, t);
    for (int i = 0; i < t->rows; i++) {
        text_add(to, "<tr><td>");
        html_text(to, t->row[i].label);
        text_add(to, "</td>");
        for (int k = 0; k < t->columns; k++) {
            page_value_text(t->row[i].value[k], t->column[k].decimals, text);
            text_add(to, page_is_best(t, i, k) ? "<td><b>%s</b></td>" : "<td>%s</td>", text);
        }
        text_add(to, "</tr>\n");
    }
    text_add(to, "</table></div>\n");
}

static void html_picture(text_builder *to, const char *file, const char *caption) {
    text_add(to, "<figure><img src=\"%s\" alt=\"", file);
    html_text(to, caption);
    text_add(to, "\"><figcaption>");
    html_text(to, caption);
    text_add(to, "</figcaption></figure>\n");
}

static sherf_status html_write(context *c, const page *p, const char *folder) {
    text_builder to = {.c = c};
    char file[64];
    text_add(&to, "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n"
                  "<meta name=\"viewport\" content=\"width=device-width\">\n<title>");
    html_text(&to, p->title);
    text_add(&to,
             "</title>\n<style>body{font:16px/1.5 sans-serif;margin:2em auto;max-width:75em;padding:0 1em}"
             "table{border-collapse:collapse}td,th{border:1px solid #ccc;padding:.2em .6em}"
             "td+td{text-align:right}.wide{overflow-x:auto}figure{margin:1em 0}img{max-width:100%%}"
             "</style></head><body>\n<h1>");
    html_text(&to, p->title);
    text_add(&to, "</h1>\n");
    for (int i = 0; i < p->tables; i++) html_table(&to, &p->table[i]);
    for (int i = 0; i < p->plots; i++) {
        snprintf(file, sizeof file, "%s.svg", p->plot[i].name);
        html_picture(&to, file, p->plot[i].title);
    }
    for (int i = 0; i < p->sheets; i++) html_picture(&to, p->sheet[i].file, p->sheet[i].caption);
    for (int i = 0; i < p->notes; i++) {
        text_add(&to, "<p>");
        html_text(&to, p->note[i]);
        text_add(&to, "</p>\n");
    }
    text_add(&to, "<p><a href=\"table.md\">table.md</a> <a href=\"table.tex\">table.tex</a> "
                  "<a href=\"results.json\">results.json</a></p>\n</body></html>\n");
    char *text = text_take(&to);
    sherf_status status = page_file_write(c, folder, "index.html", text);
    mem_free(text);
    return status;
}

/* ---- JSON ---- */
/* NaN is written as null. */
static bool json_interval(cJSON *to, interval v) {
    return cJSON_AddNumberToObject(to, "mean", v.mean) && cJSON_AddNumberToObject(to, "low", v.low) &&
           cJSON_AddNumberToObject(to, "high", v.high);
}

static cJSON *json_object(cJSON *array) {
    cJSON *o = cJSON_CreateObject();
    if (o && cJSON_AddItemToArray(array, o)) return o;
    cJSON_Delete(o);
    return NULL;
}

static bool json_row(cJSON *rows, const page_table *t, const page_row *r) {
    cJSON *o = json_object(rows), *values = NULL;
    if (!o || !cJSON_AddStringToObject(o, "label", r->label)) return false;
    if (!(values = cJSON_AddArrayToObject(o, "values"))) return false;
    for (int k = 0; k < t->columns; k++) {
        cJSON *v = json_object(values);
        if (!v || !cJSON_AddStringToObject(v, "group", t->column[k].group) ||
            !cJSON_AddStringToObject(v, "name", t->column[k].name) || !json_interval(v, r->value[k]))
            return false;
    }
    return true;
}

static bool json_table(cJSON *tables, const page_table *t) {
    cJSON *o = json_object(tables);
    if (!o || !cJSON_AddStringToObject(o, "title", t->title)) return false;
    cJSON *rows = cJSON_AddArrayToObject(o, "rows");
    for (int i = 0; i < t->rows && rows; i++)
        if (!json_row(rows, t, &t->row[i])) return false;
    return rows != NULL;
}

static bool json_series(cJSON *list, const page_series *s) {
    cJSON *o = json_object(list);
    if (!o || !cJSON_AddStringToObject(o, "label", s->label)) return false;
    cJSON *points = cJSON_AddArrayToObject(o, "points");
    for (int i = 0; i < s->points && points; i++) {
        cJSON *at = json_object(points);
        if (!at || !cJSON_AddNumberToObject(at, "x", s->point[i].x) || !json_interval(at, s->point[i].y))
            return false;
    }
    return points != NULL;
}

static bool json_plot(cJSON *plots, const page_plot *p) {
    cJSON *o = json_object(plots);
    if (!o || !cJSON_AddStringToObject(o, "name", p->name) ||
        !cJSON_AddStringToObject(o, "title", p->title) || !cJSON_AddStringToObject(o, "x", p->x) ||
        !cJSON_AddStringToObject(o, "y", p->y))
        return false;
    cJSON *series = cJSON_AddArrayToObject(o, "series");
    for (int i = 0; i < p->series && series; i++)
        if (!json_series(series, &p->line[i])) return false;
    return series != NULL;
}

static bool json_fill(cJSON *root, const page *p) {
    if (!cJSON_AddStringToObject(root, "experiment", p->name) ||
        !cJSON_AddStringToObject(root, "title", p->title))
        return false;
    cJSON *tables = cJSON_AddArrayToObject(root, "tables");
    for (int i = 0; i < p->tables && tables; i++)
        if (!json_table(tables, &p->table[i])) return false;
    cJSON *plots = cJSON_AddArrayToObject(root, "plots");
    for (int i = 0; i < p->plots && plots; i++)
        if (!json_plot(plots, &p->plot[i])) return false;
    cJSON *notes = cJSON_AddArrayToObject(root, "notes");
    for (int i = 0; i < p->notes && notes; i++) {
        cJSON *note = cJSON_CreateString(p->note[i]);
        if (!note || !cJSON_AddItemToArray(notes, note)) return false;
    }
    return tables && plots && notes && (!p->made || cJSON_AddItemReferenceToObject(root, "made", p->made));
}

static sherf_status json_write(context *c, const page *p, const char *folder) {
    cJSON *root = cJSON_CreateObject();
    char *text = root && json_fill(root, p) ? cJSON_Print(root) : NULL;
    sherf_status status = text ? page_file_write(c, folder, "results.json", text)
                               : failure(c, SHERF_NO_MEMORY, "out of memory: the results");
    cJSON_free(text);
    cJSON_Delete(root);
    return status;
}

sherf_status page_write(context *c, const page *p, const char *folder) {
    sherf_status status = SHERF_OK;
    for (int i = 0; i < p->plots && status == SHERF_OK; i++) status = page_plot_write(c, &p->plot[i], folder);
    if (status == SHERF_OK) status = md_write(c, p, folder);
    if (status == SHERF_OK) status = tex_write(c, p, folder);
    if (status == SHERF_OK) status = json_write(c, p, folder);
    return status == SHERF_OK ? html_write(c, p, folder) : status;
}
