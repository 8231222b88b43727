/* The paper's own numbers (Hu, Hong et al., ICCV 2023, and its appendix). They appear next to ours, never in
 * the same table. */
#include <string.h>

#include "experiment/experiment.h"

enum { GROUPS = 8, ROWS = 8, NUMBERS = 24 };
#define NO NAN
typedef struct {
    const char *experiment, *title;
    const char *group[GROUPS]; /* of columns, up to NULL */
    int metrics;               /* in each: PSNR, SSIM, LPIPS; or PSNR alone */
    struct {
        const char *label; /* NULL ends the list */
        double value[NUMBERS];
    } row[ROWS];
} published_table;

static const published_table tables[] = {
    {"main",
     "The paper: THuman and RenderPeople",
     {"THuman view", "THuman pose", "RenderPeople view", "RenderPeople pose"},
     3,
     {{"PixelNeRF", {16.51, .65, .35, NO, NO, NO, NO, NO, NO, NO, NO, NO}},
      {"NHP", {22.53, .88, .17, 20.25, .86, .19, 20.59, .81, .22, 19.60, .77, .25}},
      {"MPS-NeRF", {21.72, .87, .18, 21.68, .87, .18, 20.72, .81, .24, 20.19, .80, .25}},
      {"SHERF", {24.66, .91, .10, 24.26, .91, .11, 22.88, .88, .14, 21.98, .86, .15}}}},
    {"main",
     "The paper: ZJU-MoCap and HuMMan",
     {"ZJU-MoCap view", "ZJU-MoCap pose", "HuMMan view", "HuMMan pose"},
     3,
     {{"NHP", {21.66, .87, .17, 21.57, .87, .17, 18.99, .84, .18, 18.32, .83, .18}},
      {"MPS-NeRF", {21.86, .87, .17, 21.60, .87, .17, 17.44, .82, .19, 17.43, .82, .19}},
      {"SHERF", {22.87, .89, .12, 22.38, .89, .12, 20.83, .89, .12, 20.43, .88, .11}}}},
    {"ablation",
     "The paper: THuman",
     {"novel view", "novel pose"},
     3,
     {{"global", {22.38, .89, .14, 22.35, .89, .14}},
      {"global, point", {23.26, .89, .13, 23.03, .89, .14}},
      {"global, pixel", {23.72, .90, .12, 23.65, .90, .12}},
      {"point, pixel", {24.08, .90, .12, 23.73, .90, .12}},
      {"global, point, pixel", {24.44, .91, .11, 24.08, .91, .11}},
      {"all, and the transformer", {24.66, .91, .10, 24.26, .91, .11}}}},
    {"fusion",
     "The paper: RenderPeople",
     {"novel view", "novel pose"},
     3,
     {{"AdaIN", {22.38, .87, .16, 21.65, .85, .17}},
      {"SIREN", {21.62, .85, .18, 21.09, .84, .19}},
      {"transformer", {22.88, .88, .14, 21.98, .86, .15}}}},
    {"front-view",
     "The paper: THuman, trained on front views, PSNR",
     {"from the front: view", "from the front: pose", "freely: view", "freely: pose"},
     1,
     {{"NHP", {24.00, 19.75, 20.59, 19.17}},
      {"MPS-NeRF", {23.29, 23.15, 21.56, 21.46}},
      {"SHERF", {24.63, 24.05, 22.60, 22.36}}}},
    {"cross-data",
     "The paper: trained on THuman, tested on ZJU-MoCap",
     {"novel view", "novel pose"},
     3,
     {{"NHP", {22.07, .88, .16, 20.70, .86, .18}},
      {"MPS-NeRF", {20.36, .85, .17, 19.96, .85, .17}},
      {"SHERF", {21.87, .89, .11, 21.50, .88, .12}}}},
    {"estimated-body",
     "The paper: RenderPeople, true bodies and CLIFF's",
     {"true: view", "true: pose", "estimated: view", "estimated: pose"},
     3,
     {{"NHP", {20.59, .81, .22, 19.60, .77, .25, 18.04, .72, .31, 17.59, .70, .33}},
      {"MPS-NeRF", {20.72, .81, .24, 20.19, .80, .25, 17.81, .74, .30, 17.33, .71, .32}},
      {"SHERF", {22.88, .88, .14, 21.98, .86, .15, 19.64, .79, .22, 19.22, .78, .24}}}},
    {"runtime",
     "The paper (hardware and picture's size are not told)",
     {"frames a second"},
     1,
     {{"NHP", {0.15}}, {"MPS-NeRF", {0.60}}, {"SHERF", {1.33}}}}};

static sherf_status add_one(context *c, page *p, const published_table *from) {
    page_table *t = page_add_table(c, p, "%s", from->title);
    sherf_status status = t ? SHERF_OK : SHERF_NO_MEMORY;
    const bool times = !strcmp(from->experiment, "runtime");
    for (int g = 0; g < GROUPS && from->group[g]; g++)
        for (int metric = 0; metric < from->metrics && status == SHERF_OK; metric++)
            status = page_add_column(c, t, from->group[g], times ? "" : score_metrics[metric].label, 2,
                                     times ? 1 : score_metrics[metric].better);
    for (int i = 0; i < ROWS && from->row[i].label && status == SHERF_OK; i++) {
        page_row *row = page_add_row(c, t, "%s", from->row[i].label);
        if (!row) return SHERF_NO_MEMORY;
        for (int k = 0; k < t->columns; k++) row->value[k] = interval_of(from->row[i].value[k]);
    }
    return status;
}

sherf_status published_add(context *c, page *p, const char *experiment_name) {
    sherf_status status = SHERF_OK;
    for (size_t i = 0; i < COUNT_OF(tables) && status == SHERF_OK; i++)
        if (!strcmp(tables[i].experiment, experiment_name)) status = add_one(c, p, &tables[i]);
    return status;
}
