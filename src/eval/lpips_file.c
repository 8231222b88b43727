/* The weights of LPIPS from converted files. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "eval/lpips_file.h"
#include "io/safetensors.h"

/* Fills `to` from the first of the files that has `name`. A head's rank may differ ([1, C, 1, 1]). */
static sherf_status fill(context *c, safetensors *const *file, int files, const char *name, tensor *to,
                         bool *found) {
    *found = false;
    for (int f = 0; f < files; f++) {
        const safetensor *s = safetensors_find(file[f], name);
        if (!s) continue;
        int64_t n = 1;
        bool same = to->rank == 1 || s->rank == to->rank;
        for (int i = 0; i < s->rank; i++) {
            n *= s->dim[i]; /* checked by the reader: it fits the file */
            same = same && (to->rank == 1 || s->dim[i] == to->dim[i]);
        }
        if (n != tensor_count(to))
            return failure(c, SHERF_MISMATCH, "%s holds %lld values, %lld are expected", name, (long long)n,
                           (long long)tensor_count(to));
        if (!same) return failure(c, SHERF_MISMATCH, "%s has another shape than VGG16's", name);
        *found = true;
        sherf_status status = safetensors_floats(c, file[f], name, s->rank, s->dim, to->data);
        for (int64_t i = 0; i < n && status == SHERF_OK; i++)
            if (!isfinite(((const float *)to->data)[i]))
                status = failure(c, SHERF_BAD_FILE, "%s holds a number that is not finite", name);
        return status;
    }
    return SHERF_OK;
}

static sherf_status fill_layer(context *c, safetensors *const *file, int files, int layer, const char *part,
                               tensor *to) {
    char name[96];
    bool found = false;
    sherf_status status = SHERF_OK;
    for (int i = 0; i < 3 && !found && status == SHERF_OK; i++) {
        if (i == 1)
            snprintf(name, sizeof name, "net.slice%d.%d.%s", lpips_layers[layer].stage + 1,
                     lpips_layers[layer].index, part);
        else
            snprintf(name, sizeof name, i ? "vgg16.features.%d.%s" : "features.%d.%s",
                     lpips_layers[layer].index, part);
        status = fill(c, file, files, name, to, &found);
    }
    if (status == SHERF_OK && !found)
        status =
            failure(c, SHERF_MISMATCH, "features.%d.%s of VGG16 is missing", lpips_layers[layer].index, part);
    return status;
}

/* A distance is a sum of squares by these: LPIPS learns them under that bound, and with others it could fall
 * below 0. */
static sherf_status head_check(context *c, int stage, const tensor *t) {
    for (int64_t i = 0; i < tensor_count(t); i++)
        if (((const float *)t->data)[i] < 0)
            return failure(c, SHERF_BAD_FILE, "lin%d, a head of LPIPS, holds %g: no weight of it is negative",
                           stage, (double)((const float *)t->data)[i]);
    return SHERF_OK;
}

static sherf_status fill_head(context *c, safetensors *const *file, int files, int stage, tensor *to) {
    char name[96];
    bool found = false;
    sherf_status status = SHERF_OK;
    static const char *const tail[] = {".model.1.weight", ".weight", ""};
    for (int i = 0; i < (int)COUNT_OF(tail) && !found && status == SHERF_OK; i++) {
        snprintf(name, sizeof name, "lin%d%s", stage, tail[i]);
        status = fill(c, file, files, name, to, &found);
        if (status != SHERF_OK || found) break;
        snprintf(name, sizeof name, "lins.%d%s", stage, tail[i]);
        status = fill(c, file, files, name, to, &found);
    }
    if (status == SHERF_OK && !found)
        status =
            failure(c, SHERF_MISMATCH,
                    "lin%d, a head of LPIPS, is missing: give VGG16 and the heads as VGG16,HEADS", stage);
    return status == SHERF_OK ? head_check(c, stage, to) : status;
}

sherf_status lpips_load(context *c, const char *paths, lpips_network **out) {
    enum { FILES = 4 };
    safetensors *file[FILES] = {0};
    int files = 0;
    sherf_status status;
    lpips_network *n = NULL;
    *out = NULL;
    char *copy = mem_string(c, paths), *next = NULL;
    if (!copy) return SHERF_NO_MEMORY;
    for (char *path = strtok_r(copy, ",", &next); path; path = strtok_r(NULL, ",", &next)) {
        if (files == FILES) {
            status = failure(c, SHERF_BAD_ARGUMENT, "%s: more than %d files", paths, FILES);
            goto done;
        }
        if ((status = safetensors_read(c, path, &file[files])) != SHERF_OK) goto done;
        files++;
    }
    if (!files) {
        status = failure(c, SHERF_BAD_ARGUMENT, "\"%s\": no file of VGG16 is named", paths);
        goto done;
    }
    if ((status = lpips_create(c, &n)) != SHERF_OK) goto done;
    for (int i = 0; i < LPIPS_CONVOLUTIONS && status == SHERF_OK; i++) {
        status = fill_layer(c, file, files, i, "weight", n->weight[i]);
        if (status == SHERF_OK) status = fill_layer(c, file, files, i, "bias", n->bias[i]);
    }
    for (int i = 0; i < LPIPS_STAGES && status == SHERF_OK; i++)
        status = fill_head(c, file, files, i, n->head[i]);
    if (status != SHERF_OK) {
        failure_prefix(c, status, "%s", paths);
        goto done;
    }
    *out = n;
    n = NULL;
done:
    lpips_free(n);
    for (int i = 0; i < files; i++) safetensors_free(file[i]);
    mem_free(copy);
    return status;
}
