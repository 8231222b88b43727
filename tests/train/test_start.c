/* Tests of other projects' files from which a training starts: ResNet-18 for the encoders, VGG16 with its
 * heads for the loss. They are complete, of the right shapes and finite, or refused with the tensor's name.
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "eval/lpips_file.h"
#include "io/safetensors.h"
#include "model/model.h"
#include "support.h"

/* ---- ResNet-18 ---- */
static const char feature[] = "encoder_2d_feature.backbone.";

static model *model_of(context *c, const char *text, uint64_t seed) {
    model_config config;
    model *m;
    assert_ok(c, model_config_parse(c, text, &config));
    assert_ok(c, model_create(c, &config, seed, &m));
    return m;
}

/* The feature encoder of `m` under torchvision's names. */
static size_t resnet_items(const model *m, safetensor_item *item) {
    size_t count = 0;
    for (int i = 0; i < m->weights->count; i++) {
        const parameter *p = m->weights->item[i];
        if (strncmp(p->name, feature, strlen(feature))) continue;
        item[count] = (safetensor_item){
            .name = p->name + strlen(feature), .type = T_F32, .rank = p->value.rank, .data = p->value.data};
        memcpy(item[count++].dim, p->value.dim, sizeof item->dim);
    }
    return count;
}

static void an_encoder_starts_whole_or_not_at_all(void **state) {
    context *c = test_context();
    static safetensor_item item[200];
    const char *path = test_path("resnet.safetensors"),
               *small = "small,encoder_width=8,style_width=16,plane_resolution=16,channel_max=16";
    model *from = model_of(c, small, 1), *m = model_of(c, small, 2);
    const size_t count = resnet_items(from, item);
    assert_true(count > 20 && count < 200);
    assert_ok(c, safetensors_write(c, path, count, item, 0, NULL));
    assert_ok(c, model_load_resnet(c, m, path)); /* the global encoder is narrower and does not change */
    for (int i = 0; i < m->weights->count; i++) {
        const parameter *a = m->weights->item[i], *b = from->weights->item[i];
        if (!strncmp(a->name, feature, strlen(feature)))
            assert_memory_equal(a->value.data, b->value.data,
                                (size_t)tensor_count(&a->value) * sizeof(float));
    }
    for (size_t i = 0; i < count; i++) {
        safetensor_item kept = item[i];
        if (i % 7 != 0 && i + 1 != count) continue;
        item[i].name = "elsewhere";
        assert_ok(c, safetensors_write(c, path, count, item, 0, NULL));
        assert_fails(c, model_load_resnet(c, m, path), SHERF_MISMATCH, kept.name);
        assert_non_null(strstr(c->message, "is missing"));
        item[i] = kept;
        if (!strcmp(kept.name, "conv1.weight")) continue;
        float one = 1;
        item[i].rank = 1, item[i].dim[0] = 1, item[i].data = &one;
        assert_ok(c, safetensors_write(c, path, count, item, 0, NULL));
        assert_fails(c, model_load_resnet(c, m, path), SHERF_MISMATCH, "has shape");
        item[i] = kept;
    }
    *(float *)(uintptr_t)item[count / 2].data = NAN; /* in `from`, to which the items point */
    assert_ok(c, safetensors_write(c, path, count, item, 0, NULL));
    assert_fails(c, model_load_resnet(c, m, path), SHERF_BAD_FILE, "not finite");
    /* another network that begins with the same layer by chance */
    for (size_t i = 0; i < count; i++)
        if (!strcmp(item[i].name, "conv1.weight"))
            assert_ok(c, safetensors_write(c, path, 1, item + i, 0, NULL));
    assert_fails(c, model_load_resnet(c, m, path), SHERF_MISMATCH, "no ResNet-18");
    assert_non_null(strstr(c->message, path));
    model_free(from);
    model_free(m);
    sherf_context_free(c);
}

/* ---- VGG16 and the heads ---- */
enum { ITEMS = 2 * LPIPS_CONVOLUTIONS + LPIPS_STAGES };

static void lpips_is_whole_finite_and_no_less_than_zero(void **state) {
    context *c = test_context();
    static char name[ITEMS][32];
    static safetensor_item item[ITEMS];
    const char *path = test_path("lpips.safetensors");
    lpips_network *n, *read;
    size_t count = 0;
    assert_ok(c, lpips_create(c, &n));
    for (int i = 0; i < LPIPS_CONVOLUTIONS; i++)
        for (int bias = 0; bias < 2; bias++, count++) {
            const tensor *t = bias ? n->bias[i] : n->weight[i];
            snprintf(name[count], sizeof name[count], "features.%d.%s", lpips_layers[i].index,
                     bias ? "bias" : "weight");
            item[count] =
                (safetensor_item){.name = name[count], .type = T_F32, .rank = t->rank, .data = t->data};
            memcpy(item[count].dim, t->dim, sizeof item->dim);
        }
    for (int i = 0; i < LPIPS_STAGES; i++, count++) {
        snprintf(name[count], sizeof name[count], "lin%d", i);
        item[count] = (safetensor_item){.name = name[count],
                                        .type = T_F32,
                                        .rank = 1,
                                        .dim = {n->head[i]->dim[0]},
                                        .data = n->head[i]->data};
    }
    assert_ok(c, safetensors_write(c, path, count, item, 0, NULL));
    assert_ok(c, lpips_load(c, path, &read));
    lpips_free(read);
    item[4].dim[0] = 64, item[4].dim[1] = 128; /* features.5.weight, transposed */
    assert_ok(c, safetensors_write(c, path, count, item, 0, NULL));
    assert_fails(c, lpips_load(c, path, &read), SHERF_MISMATCH, "features.5.weight has another shape");
    item[4].dim[0] = 128, item[4].dim[1] = 64;
    ((float *)n->head[2]->data)[5] = NAN;
    assert_ok(c, safetensors_write(c, path, count, item, 0, NULL));
    assert_fails(c, lpips_load(c, path, &read), SHERF_BAD_FILE, "lin2 holds a number that is not finite");
    assert_non_null(strstr(c->message, path));
    ((float *)n->head[2]->data)[5] = -0.25f;
    assert_ok(c, safetensors_write(c, path, count, item, 0, NULL));
    assert_fails(c, lpips_load(c, path, &read), SHERF_BAD_FILE, "lin2, a head of LPIPS, holds -0.25");
    assert_fails(c, lpips_load(c, ",", &read), SHERF_BAD_ARGUMENT, "no file");
    assert_null(read);
    remove(path);
    lpips_free(n);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(an_encoder_starts_whole_or_not_at_all),
                                       cmocka_unit_test(lpips_is_whole_finite_and_no_less_than_zero)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
