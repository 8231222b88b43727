/* makehuman: lookups, and shapes from macro parameters. Reading is in makehuman_read.c. */
#include "synth/body/makehuman.h"

#include <math.h>
#include <string.h>

#include "synth/body/makehuman_levels.h"

const makehuman_macro makehuman_average = {.sex = 0.5,
                                           .age_years = 25,
                                           .weight = 0.5,
                                           .muscle = 0.5,
                                           .height = 0.5,
                                           .proportions = 0.5,
                                           .cup = 0.5,
                                           .firmness = 0.5,
                                           .african = 1,
                                           .asian = 1,
                                           .caucasian = 1};

int makehuman_target_find(const makehuman *human, const char *name) {
    for (int i = 0; i < human->targets; i++)
        if (!strcmp(human->target[i].name, name)) return i;
    return -1;
}

int makehuman_bone_find(const makehuman *human, const char *name) {
    for (int i = 0; i < human->bones; i++)
        if (!strcmp(human->bone[i].name, name)) return i;
    return -1;
}

int makehuman_part_find(const makehuman *human, const char *name) {
    for (int i = 0; i < human->parts; i++)
        if (!strcmp(human->part[i].name, name)) return i;
    return -1;
}

/* NaN and infinity give `average`. */
static double within(double x, double low, double high, double average) {
    if (!isfinite(x)) return average;
    return x < low ? low : x > high ? high : x;
}

/* Low at 0, middle at 0.5, high at 1. */
static void three_levels(double x, double *low, double *middle, double *high) {
    x = within(x, 0, 1, 0.5);
    *low = x < 0.5 ? 1 - 2 * x : 0;
    *high = x > 0.5 ? 2 * x - 1 : 0;
    *middle = 1 - *low - *high;
}

static void level_weights(const makehuman_macro *macro, double w[LEVELS]) {
    double sex = within(macro->sex, 0, 1, 0.5);
    w[LEVEL_FEMALE] = 1 - sex;
    w[LEVEL_MALE] = sex;
    /* hat functions over the years that targets were made for */
    static const double years[] = {1, 10, 25, 90};
    double age = within(macro->age_years, 1, 90, 25);
    for (int i = 0; i < 4; i++) {
        double up = i ? (age - years[i - 1]) / (years[i] - years[i - 1]) : 1;
        double down = i < 3 ? (years[i + 1] - age) / (years[i + 1] - years[i]) : 1;
        double hat = up < down ? up : down;
        w[LEVEL_BABY + i] = hat < 0 ? 0 : hat > 1 ? 1 : hat;
    }
    three_levels(macro->weight, &w[LEVEL_MIN_WEIGHT], &w[LEVEL_AVERAGE_WEIGHT], &w[LEVEL_MAX_WEIGHT]);
    three_levels(macro->muscle, &w[LEVEL_MIN_MUSCLE], &w[LEVEL_AVERAGE_MUSCLE], &w[LEVEL_MAX_MUSCLE]);
    three_levels(macro->height, &w[LEVEL_MIN_HEIGHT], &w[LEVEL_AVERAGE_HEIGHT], &w[LEVEL_MAX_HEIGHT]);
    three_levels(macro->proportions, &w[LEVEL_UNCOMMON], &w[LEVEL_REGULAR], &w[LEVEL_IDEAL]);
    three_levels(macro->cup, &w[LEVEL_MIN_CUP], &w[LEVEL_AVERAGE_CUP], &w[LEVEL_MAX_CUP]);
    three_levels(macro->firmness, &w[LEVEL_MIN_FIRMNESS], &w[LEVEL_AVERAGE_FIRMNESS], &w[LEVEL_MAX_FIRMNESS]);
    double part[3] = {within(macro->african, 0, 1e6, 0), within(macro->asian, 0, 1e6, 0),
                      within(macro->caucasian, 0, 1e6, 0)};
    double sum = part[0] + part[1] + part[2];
    for (int i = 0; i < 3; i++) w[LEVEL_AFRICAN + i] = sum > 0 ? part[i] / sum : 1. / 3;
}

/* Parameters out of range are clamped; ones that are not finite count as average. weight: one for each
 * target. */
static void makehuman_weights(const makehuman *human, const makehuman_macro *macro, double *weight) {
    double level[LEVELS];
    level_weights(macro, level);
    for (int t = 0; t < human->targets; t++) {
        const makehuman_target *target = &human->target[t];
        double product = target->factors > 0;
        for (int i = 0; i < target->factors; i++) product *= level[target->factor[i]];
        weight[t] = product;
    }
}

/* sum += weight * target */
static void add_target(const makehuman *human, int t, double weight, double *sum) {
    const makehuman_target *target = &human->target[t];
    const int16_t *offset = human->offset + (size_t)t * human->vertices * 3;
    double scale = weight * makehuman_offset_m;
    size_t end = 3 * ((size_t)target->first + (size_t)target->count);
    for (size_t i = 3 * (size_t)target->first; i < end; i++) sum[i] += scale * offset[i];
}

sherf_status makehuman_shape(context *c, const makehuman *human, const makehuman_macro *macro, int details,
                             const makehuman_detail *detail, float *vertices) {
    sherf_status status = SHERF_NO_MEMORY;
    size_t n = (size_t)human->vertices * 3;
    double *weight = mem_alloc(c, (size_t)human->targets, sizeof *weight);
    double *sum = mem_alloc(c, n, sizeof *sum);
    if (!weight || !sum) goto done;
    makehuman_weights(human, macro, weight);
    for (int i = 0; i < details; i++) {
        if (detail[i].target < 0 || detail[i].target >= human->targets || !isfinite(detail[i].weight)) {
            status = failure(c, SHERF_BAD_ARGUMENT, "detail %d: target %d of %d, weight %g", i,
                             detail[i].target, human->targets, detail[i].weight);
            goto done;
        }
        weight[detail[i].target] += detail[i].weight;
    }
    for (size_t i = 0; i < n; i++) sum[i] = (double)human->vertex[i];
    for (int t = 0; t < human->targets; t++)
        if (weight[t] != 0) add_target(human, t, weight[t], sum);
    for (size_t i = 0; i < n; i++) vertices[i] = (float)sum[i];
    status = SHERF_OK;
done:
    mem_free(weight);
    mem_free(sum);
    return status;
}

void makehuman_points(const makehuman *human, const float *vertices, double *points) {
    for (int p = 0; p < human->points; p++) {
        double sum[3] = {0};
        for (int i = 0; i < human->point[p].count; i++) {
            const float *v = vertices + 3 * (size_t)human->point_vertex[human->point[p].first + i];
            for (int k = 0; k < 3; k++) sum[k] += (double)v[k];
        }
        for (int k = 0; k < 3; k++) points[3 * (size_t)p + k] = sum[k] / human->point[p].count;
    }
}
