/* The weights of ResNet-50 from a converted file. */
#include <math.h>
#include <stdio.h>

#include "eval/resnet50_file.h"
#include "io/safetensors.h"

static sherf_status fill(context *c, const safetensors *file, const char *layer, const char *part,
                         tensor *to) {
    char name[64];
    snprintf(name, sizeof name, "%s.%s", layer, part);
    sherf_status status = safetensors_floats(c, file, name, to->rank, to->dim, to->data);
    for (int64_t i = 0, n = tensor_count(to); i < n && status == SHERF_OK; i++)
        if (!isfinite(((const float *)to->data)[i]))
            status = failure(c, SHERF_BAD_FILE, "%s holds a number that is not finite", name);
    return status;
}

sherf_status resnet50_load(context *c, const char *path, resnet50_network **out) {
    safetensors *file;
    resnet50_network *n = NULL;
    *out = NULL;
    sherf_status status = safetensors_read(c, path, &file);
    if (status != SHERF_OK) return status;
    status = resnet50_create(c, &n);
    for (int i = 0; i < RESNET50_CONVOLUTIONS && status == SHERF_OK; i++) {
        status = fill(c, file, resnet50_layers[i].name, "weight", n->weight[i]);
        if (status == SHERF_OK) status = fill(c, file, resnet50_layers[i].name, "bias", n->bias[i]);
    }
    if (status == SHERF_OK) {
        *out = n;
        n = NULL;
    } else {
        failure_prefix(c, status, "%s", path);
    }
    resnet50_free(n);
    safetensors_free(file);
    return status;
}
