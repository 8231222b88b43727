/* Reads things from the package when they are first worn. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/path.h"
#include "synth/people/wardrobe.h"

static const char *const kind_folder[WEAR_KINDS] = {"clothes", "clothes",  "clothes",   "clothes",
                                                    "clothes", "clothes",  "clothes",   "clothes",
                                                    "hair",    "eyebrows", "eyelashes", "eyes"};
static const float waist_m =
    0.06f; /* over the base mesh's origin: a shirt's hem is lower, its middle higher */
static const float covered_m = 0.045f; /* skin this deep under cloth is invisible */
enum { COVER_RINGS = 2 };

struct wardrobe {
    char source[PATH_LENGTH];
    int base_vertices, body_vertices, triangles;
    float *base_vertex;
    const uint32_t *triangle; /* borrowed */
    worn **worn;              /* by item */
    image_u8 *skin;
};

sherf_status wardrobe_open(context *c, const char *source, int base_vertices, int body_vertices,
                           const float *base_vertex, int triangles, const uint32_t *triangle,
                           wardrobe **out) {
    *out = NULL;
    if (strlen(source) > PATH_LENGTH / 2)
        return failure(c, SHERF_BAD_ARGUMENT, "%.200s: path too long", source);
    wardrobe *w = mem_zero(c, 1, sizeof *w);
    if (!w) return SHERF_NO_MEMORY;
    snprintf(w->source, sizeof w->source, "%s", source);
    w->base_vertices = base_vertices, w->body_vertices = body_vertices;
    w->triangles = triangles, w->triangle = triangle;
    w->base_vertex = mem_alloc(c, (size_t)base_vertices, 3 * sizeof *w->base_vertex);
    w->worn = mem_zero(c, (size_t)wear_item_count, sizeof *w->worn);
    w->skin = mem_zero(c, (size_t)skin_count, sizeof *w->skin);
    if (!w->base_vertex || !w->worn || !w->skin) {
        wardrobe_close(w);
        return SHERF_NO_MEMORY;
    }
    memcpy(w->base_vertex, base_vertex, (size_t)base_vertices * 3 * sizeof *base_vertex);
    *out = w;
    return SHERF_OK;
}

static void worn_free(worn *t) {
    if (!t) return;
    proxy_free(t->proxy);
    for (int i = 0; i < t->textures; i++) {
        mem_free(t->texture[i].data);
        dye_map_free(t->map[i]);
    }
    mem_free(t->base);
    mem_free(t->under);
    mem_free(t);
}

void wardrobe_close(wardrobe *w) {
    if (!w) return;
    for (int i = 0; i < wear_item_count && w->worn; i++) worn_free(w->worn[i]);
    for (int i = 0; i < skin_count && w->skin; i++) mem_free(w->skin[i].data);
    mem_free(w->base_vertex);
    mem_free(w->worn);
    mem_free(w->skin);
    mem_free(w);
}

static bool is_cloth(wear_kind kind) {
    return kind <= WEAR_SHOES;
}

static bool is_dyed(wear_kind kind) {
    return kind <= WEAR_HAT;
}

static sherf_status read_worn(context *c, wardrobe *w, int item, worn *t) {
    const wear_item *of = &wear_items[item];
    char folder[PATH_LENGTH], path[PATH_LENGTH * 2];
    t->item = of;
    snprintf(folder, sizeof folder, "%.2048s/public/data/proxies/%s/%.64s", w->source, kind_folder[of->kind],
             of->name);
    sherf_status status = proxy_read(c, folder, w->base_vertices, w->base_vertex, &t->proxy);
    if (status) return status;
    t->base = mem_alloc(c, (size_t)t->proxy->vertices, 3 * sizeof *t->base);
    t->under = mem_zero(c, (size_t)w->base_vertices, 1);
    if (!t->base || !t->under) return SHERF_NO_MEMORY;
    proxy_fit(t->proxy, w->base_vertex, t->base);
    for (int i = 0; i < t->proxy->textures && !status; i++) {
        snprintf(path, sizeof path, "%s/%s", folder, t->proxy->texture[i]);
        if (!path_is_file(path)) continue;
        status = image_read(c, path, 4, &t->texture[t->textures]);
        if (!status && is_dyed(of->kind))
            status = dye_map_create(c, t->proxy, t->base, of->kind == WEAR_SUIT, waist_m,
                                    &t->texture[t->textures], &t->map[t->textures]);
        t->textures++;
    }
    if (!status && !t->textures) status = failure(c, SHERF_NO_FILE, "%s: has no texture", folder);
    if (status || !is_cloth(of->kind)) return status;
    proxy_surface body = {w->body_vertices, w->triangles, w->base_vertex, w->triangle};
    proxy_surface cloth = {t->proxy->vertices, t->proxy->triangles, t->base, t->proxy->triangle};
    return proxy_cover(c, &body, &cloth, covered_m, COVER_RINGS, t->under);
}

sherf_status wardrobe_worn(context *c, wardrobe *w, int item, const worn **out) {
    *out = NULL;
    if (item < 0 || item >= wear_item_count) return failure(c, SHERF_BAD_ARGUMENT, "no item %d", item);
    if (!w->worn[item]) {
        worn *t = mem_zero(c, 1, sizeof *t);
        if (!t) return SHERF_NO_MEMORY;
        sherf_status status = read_worn(c, w, item, t);
        if (status) {
            worn_free(t);
            return status;
        }
        w->worn[item] = t;
    }
    *out = w->worn[item];
    return SHERF_OK;
}

sherf_status wardrobe_skin(context *c, wardrobe *w, int index, const image_u8 **out) {
    *out = NULL;
    if (index < 0 || index >= skin_count) return failure(c, SHERF_BAD_ARGUMENT, "no skin %d", index);
    if (!w->skin[index].data) {
        char path[PATH_LENGTH];
        snprintf(path, sizeof path, "%.2048s/public/data/skins/%s/textures/%s", w->source,
                 skins[index].folder, skins[index].texture);
        sherf_status status = image_read(c, path, 3, &w->skin[index]);
        if (status) return status;
    }
    *out = &w->skin[index];
    return SHERF_OK;
}
