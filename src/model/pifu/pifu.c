/* PIFu as an entry of the table: from one picture to occupancy and colour. */
#include <string.h>

#include "model/pifu/settings.h"

/* ---- settings ---- */
static const model_preset presets[] = {
    {"own", ""},
    {"own-small", "stacks=2,width=128,color_width=32,hidden0=256,hidden1=128,hidden2=64,hidden3=0,"
                  "side_px=256,z_gain=10,resolution=128,image_size=256"},
    {0}};

#define AT(field) MODEL_SETTING_AT(pifu_settings, field)
static const model_setting settings[] = {{"stacks", AT(stacks), 1, PIFU_STACKS, 1},
                                         {"width", AT(width), 16, 1024, 16},
                                         {"color_width", AT(color_width), 4, 256, 4},
                                         {"hidden0", AT(hidden[0]), 4, 4096, 4},
                                         {"hidden1", AT(hidden[1]), 0, 4096, 4},
                                         {"hidden2", AT(hidden[2]), 0, 4096, 4},
                                         {"hidden3", AT(hidden[3]), 0, 4096, 4},
                                         {"side_px", AT(side_px), 64, 2048, 16},
                                         {"z_gain", AT(z_gain), 0.1, 100, 0},
                                         {"points", AT(points), 16, 1 << 20, 16},
                                         {"resolution", AT(resolution), 16, 512, 16},
                                         {"coarse", AT(coarse), 16, 512, 16},
                                         {0}};

static void defaults(model_config *out) {
    pifu_settings own = {.stacks = pifu_paper.stacks,
                         .width = pifu_paper.width,
                         .color_width = pifu_paper.color_width,
                         .side_px = 512,
                         .z_gain = 1,
                         .points = 4992,
                         .resolution = 256,
                         .coarse = 64};
    memcpy(own.hidden, pifu_paper.hidden, sizeof own.hidden);
    memcpy(out->own.bytes, &own, sizeof own);
    out->samples = 2; /* no ray is sampled */
    out->image_size = 512;
}

static sherf_status check(context *c, const model_config *config) {
    const pifu_settings *k = pifu_settings_of(config);
    for (int i = 1; i < PIFU_HIDDEN; i++)
        if (k->hidden[i] && !k->hidden[i - 1])
            return failure(c, SHERF_BAD_ARGUMENT, "hidden%d: the layers end before it", i);
    if (!(k->resolution & (k->resolution - 1)) && !(k->coarse & (k->coarse - 1))) return SHERF_OK;
    return failure(c, SHERF_BAD_ARGUMENT, "resolution %d, coarse %d: powers of two", k->resolution,
                   k->coarse);
}

/* Adam without a first moment instead of RMSprop, for both networks at once. */
static const training_recipe *recipe(const model_config *config) {
    static const training_recipe own = {
        .batch = 2, .learning_rate = 1e-3, .beta1 = 0, .beta2 = 0.99, .halve_every = 0};
    return &own;
}

static void network_declare(declaration *d, const model_config *config, void *network) {
    const pifu_settings *k = pifu_settings_of(config);
    pifu_sizes sizes = {k->stacks, k->width, k->color_width, {0}};
    memcpy(sizes.hidden, k->hidden, sizeof sizes.hidden);
    pifu_declare(d, &sizes, network);
}

/* ---- an observation ---- */
static sherf_status observe(context *c, const model_config *config, const body_model *body, bool training,
                            observation_geometry *g) {
    pifu_crop *crop;
    const sherf_status status = pifu_crop_create(c, body, g, pifu_settings_of(config), &crop);
    g->own = crop;
    return status;
}

/* Copies values so that no gradient flows back. */
static tensor *detached(tape *t, tensor *x) {
    tensor *copy = x ? tape_tensor(t, x->type, x->rank, x->dim) : NULL;
    if (!copy) return NULL;
    const sherf_status status = tensor_copy_rows(tape_context(t), copy, 0, x, 0, tensor_rows(x));
    return status == SHERF_OK ? copy : tape_fail(t, status, "%s", tape_context(t)->message);
}

/* The bank: the last stack's map without gradient, the colour's map, the maps of all stacks. */
enum { LAST, COLOR, STACK };

static sherf_status encode(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                           model_bank *bank) {
    const pifu_crop *crop = g->own;
    const pifu_network *n = m->network;
    tensor *image = tape_input(t, crop->image, 3, (int64_t[]){crop->side, crop->side, 3});
    bank->count = STACK + n->sizes.stacks;
    tensor *last = pifu_maps(t, n, image, bank->tensor + STACK);
    bank->tensor[LAST] = tape_records(t) ? detached(t, last) : last;
    bank->tensor[COLOR] = pifu_color_map(t, n, image);
    return tape_status(t);
}

/* ---- training ---- */
static int64_t count(const model_config *config) {
    return pifu_settings_of(config)->points;
}

/* uv and z of points, in the tape's memory, and which of them lie in the square. */
static const float *placed(tape *t, const observation_geometry *g, int64_t n, const float *world, tensor **z,
                           tensor **rows) {
    float *uv = tape_alloc(t, (size_t)n, 3 * sizeof *uv);
    int32_t *row = tape_alloc(t, (size_t)n, sizeof *row);
    uint8_t *in = tape_alloc(t, (size_t)n, 1);
    if (!uv || !row || !in) return NULL;
    pifu_crop_place(g->own, &g->camera, n, world, uv, uv + 2 * n, in);
    for (int64_t i = 0; i < n; i++) row[i] = in[i];
    *z = tape_input(t, uv + 2 * n, 2, (int64_t[]){n, 1});
    *rows = tape_input_i32(t, row, 1, &n);
    return uv;
}

static sherf_status losses(tape *t, const model *m, const observation_geometry *g, const model_bank *bank,
                           const surface_draw *truth, tensor **inside, tensor **color) {
    const pifu_network *n = m->network;
    const int64_t P = truth->points, N = truth->places;
    tensor *z, *rows, *sum = NULL;
    const float *uv = placed(t, g, P, truth->point, &z, &rows);
    tensor *label = tape_input(t, truth->inside, 2, (int64_t[]){P, 1});
    for (int i = 0; i < n->sizes.stacks && uv; i++) {
        tensor *y = pifu_occupancy(t, n, bank->tensor[STACK + i], uv, z, P);
        tensor *one = op_mean_square(t, y, label, rows);
        sum = sum ? op_add(t, sum, one) : one;
    }
    *inside = op_scale(t, sum, 1 / (float)n->sizes.stacks);
    float *wanted = tape_alloc(t, (size_t)N, 3 * sizeof *wanted);
    if (!wanted || !(uv = placed(t, g, N, truth->place, &z, &rows))) return tape_status(t);
    for (int64_t i = 0; i < 3 * N; i++) wanted[i] = 2 * truth->color[i] - 1;
    tensor *y = pifu_color(t, n, bank->tensor[LAST], bank->tensor[COLOR], uv, z, N);
    *color = op_mean_square(t, y, tape_input(t, wanted, 2, (int64_t[]){N, 3}), rows);
    return tape_status(t);
}

static const model_surface_training surfaces = {.count = count, .losses = losses};

/* ---- arrays that avatars keep ---- */
static void kept(const model_config *config, kept_bank *out) {
    *out = (kept_bank){.count = PIFU_KEPT,
                       .array = {[PIFU_VERTICES] = {"surface.vertices", T_F32, 2, {0, 3}},
                                 [PIFU_TRIANGLES] = {"surface.triangles", T_I32, 2, {0, 3}},
                                 [PIFU_COLORS] = {"surface.colors", T_F32, 2, {0, 3}}}};
}

static const field_kind *field(const model_config *config) {
    return &pifu_field;
}

const model_kind model_pifu = {.name = "pifu",
                               .presets = presets,
                               .settings = settings,
                               .defaults = defaults,
                               .check = check,
                               .network_bytes = sizeof(pifu_network),
                               .declare = network_declare,
                               .queried = (const char *const[]){NULL},
                               .observe = observe,
                               .observed_free = pifu_crop_free,
                               .encode = encode,
                               .surfaces = &surfaces,
                               .one_pose = true,
                               .recipe = recipe,
                               .kept = kept,
                               .keep = pifu_surface,
                               .field = field};
