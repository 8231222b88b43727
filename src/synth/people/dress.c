/* From a person's parameters to meshes: shapes, fits, poses in T-pose, hides covered parts, dyes. */
#include "synth/people/dress.h"

#include <math.h>
#include <string.h>

#include "data/data.h"
#include "synth/body/open_body.h"

static const float over_skin_m = 0.003f, over_cloth_m = 0.006f;

/* ---- parts common to all people ---- */

sherf_status studio_open(context *c, const char *source, const char *body_path, studio **out) {
    *out = NULL;
    studio *s = mem_zero(c, 1, sizeof *s);
    if (!s) return SHERF_NO_MEMORY;
    sherf_status status = makehuman_open(c, source, &s->human);
    if (!status) status = tpose_rig_create(c, s->human, &s->rig);
    if (!status) status = sherf_body_load(c, body_path, &s->body);
    if (!status && s->body->vertices != s->human->body_vertices)
        status = failure(c, SHERF_MISMATCH, "%s: %d vertices; the people's body has %d", body_path,
                         s->body->vertices, s->human->body_vertices);
    if (!status) {
        s->weights = mem_alloc(c, (size_t)s->human->vertices, BODY_JOINTS * sizeof *s->weights);
        status =
            s->weights ? tpose_weights(c, s->human, s->rig, TPOSE_SMOOTHING, s->weights) : SHERF_NO_MEMORY;
    }
    if (!status)
        status = wardrobe_open(c, source, s->human->vertices, s->human->body_vertices, s->human->vertex,
                               s->human->triangles, s->human->triangle, &s->wardrobe);
    if (status)
        studio_close(s);
    else
        *out = s;
    return status;
}

void studio_close(studio *s) {
    if (!s) return;
    wardrobe_close(s->wardrobe);
    mem_free(s->weights);
    sherf_body_free(s->body);
    tpose_rig_free(s->rig);
    makehuman_close(s->human);
    mem_free(s);
}

/* ---- textures ---- */

sherf_status tint_texture(context *c, const image_u8 *in, const float color[3], float detail, image_u8 *out) {
    *out = (image_u8){0};
    size_t texels = (size_t)in->width * (size_t)in->height;
    int64_t count[256] = {0}, all = 0, sum = 0;
    uint8_t *rgba = mem_alloc(c, texels, 4);
    if (!rgba) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < texels; i++) {
        const uint8_t *p = in->data + 4 * i;
        if (p[3] < 100) continue;
        count[(p[0] * 299 + p[1] * 587 + p[2] * 114) / 1000]++;
        all++;
    }
    int middle = 0;
    while (middle < 255 && (sum += count[middle]) * 2 < all) middle++;
    for (size_t i = 0; i < texels; i++) {
        const uint8_t *p = in->data + 4 * i;
        float luminance = (float)(p[0] * 299 + p[1] * 587 + p[2] * 114) / 1000;
        float factor = 1 + detail * (luminance - (float)middle) / fmaxf((float)middle, 40);
        if (p[3] < 16) factor = 1; /* mixed in by filters at the edges */
        factor = fminf(fmaxf(factor, 0.3f), 2.2f);
        for (int k = 0; k < 3; k++) rgba[4 * i + (size_t)k] = float_to_u8(color[k] * factor);
        rgba[4 * i + 3] = p[3];
    }
    *out = (image_u8){in->width, in->height, 4, rgba};
    return SHERF_OK;
}

static sherf_status dye_garment(context *c, const person *p, int layer, const worn *t, int texture,
                                const dye_cut *cut, trace_texture **out) {
    dye_recipe recipe[DYE_PARTS];
    image_u8 image = {0};
    const dye_map *map = t->map[texture];
    sherf_status status = SHERF_OK;
    if (t->item->kind == WEAR_HAIR)
        status = tint_texture(c, &t->texture[texture], p->hair_color, 1, &image);
    else if (t->item->kind == WEAR_BROWS || t->item->kind == WEAR_LASHES)
        status = tint_texture(c, &t->texture[texture], p->brow_color, 0.5f, &image);
    else if (map) {
        for (int k = 0; k < map->parts; k++)
            person_recipe(p, layer, t->item->kind, &map->of[k], k, &recipe[k]);
        status = dye_apply(c, map, &t->texture[texture], recipe, cut, &image);
    }
    const image_u8 *dyed = image.data ? &image : &t->texture[texture];
    if (!status) status = trace_texture_create(c, dyed->width, dyed->height, 4, dyed->data, out);
    mem_free(image.data);
    return status;
}

/* The layer that hides skin or cloth poking through by mistake. `number`: of a garment, from the skin
 * outward. */
static int layer_of(const wear_item *item, int number) {
    switch (item->kind) {
    case WEAR_EYES:
    case WEAR_LASHES:
    case WEAR_GLASSES:
        return 0; /* as the skin: lids are in front of eyes */
    case WEAR_BROWS:
    case WEAR_HAIR:
        return OUTFIT_ITEMS + 2;
    case WEAR_HAT:
        return OUTFIT_ITEMS + 3;
    case WEAR_SHOES:
        return item->boots ? OUTFIT_ITEMS + 1 : 1;
    default:
        return number + 1;
    }
}

static trace_material material_of(const wear_item *item, int number, const trace_texture *texture) {
    trace_material material = trace_material_plain();
    wear_kind kind = item->kind;
    material.color = texture;
    material.layer = layer_of(item, number);
    material.roughness = 0.6f;
    material.specular = 0.015f;
    if (kind == WEAR_EYES) {
        material.specular = 0.04f, material.roughness = 0.08f;
        material.alpha = TRACE_CUTOUT, material.cutoff = 0.3f, material.coat = true;
    } else if (kind == WEAR_HAIR || kind == WEAR_BROWS || kind == WEAR_LASHES) {
        material.alpha = TRACE_BLENDED;
        material.specular = 0.008f, material.roughness = 0.6f; /* more of it makes the cards' edges visible */
        material.near_m = 0.005f;
        for (int k = 0; k < 3; k++) material.wrap[k] = 0.3f;
    } else if (kind == WEAR_GLASSES) {
        material.alpha = TRACE_BLENDED;
        material.specular = 0.04f, material.roughness = 0.1f;
    } else if (kind == WEAR_SHOES) {
        material.specular = 0.03f, material.roughness = 0.4f;
        material.alpha = TRACE_CUTOUT, material.cutoff = 0.5f;
    } else { /* lace is half transparent: cut at one half it has specks with nothing behind them */
        material.alpha = TRACE_CUTOUT, material.cutoff = 0.3f;
    }
    return material;
}

/* ---- meshes ---- */

typedef struct {
    context *c;
    studio *s;
    const person *p;
    dressed *d;
    float *shaped;   /* base V x 3, A-pose */
    float *rest;     /* base V x 3, T-pose */
    float *blend;    /* base V x 15: A-pose to T-pose, and the remainder */
    uint8_t *hidden; /* base V */
} fitting;

/* The base mesh's rest pose, and each vertex's affine map to it, which cloth takes over. */
static sherf_status to_rest(fitting *f) {
    const makehuman *human = f->s->human;
    double joints[BODY_JOINTS][3], *bone = mem_alloc(f->c, (size_t)human->bones, 12 * sizeof *bone);
    if (!bone) return SHERF_NO_MEMORY;
    sherf_status status = tpose_apply(f->c, human, f->s->rig, f->shaped, f->rest, joints, bone);
    for (int v = 0; v < human->vertices && !status; v++) {
        float *row = f->blend + 15 * (size_t)v;
        const float *x = f->shaped + 3 * (size_t)v;
        memset(row, 0, 15 * sizeof *row);
        for (int n = 0; n < MAKEHUMAN_SKIN; n++)
            for (int k = 0; k < 12; k++)
                row[k] += human->skin_weight[MAKEHUMAN_SKIN * v + n] *
                          (float)bone[12 * (size_t)human->skin_bone[MAKEHUMAN_SKIN * v + n] + (size_t)k];
        for (int k = 0; k < 3; k++)
            row[12 + k] = f->rest[3 * (size_t)v + (size_t)k] - (row[4 * k] * x[0] + row[4 * k + 1] * x[1] +
                                                                row[4 * k + 2] * x[2] + row[4 * k + 3]);
    }
    mem_free(bone);
    return status;
}

static dressed_mesh *add_mesh(fitting *f, wear_kind kind, int vertices, int triangles) {
    dressed *d = f->d;
    if (d->meshes == DRESSED_MAX) {
        failure(f->c, SHERF_UNSUPPORTED, "more than %d things on one person", DRESSED_MAX);
        return NULL;
    }
    dressed_mesh *mesh = &d->mesh[d->meshes++];
    mesh->kind = kind;
    mesh->vertices = vertices, mesh->triangles = triangles;
    mesh->rest = mem_alloc(f->c, (size_t)vertices, 3 * sizeof *mesh->rest);
    mesh->weights = mem_alloc(f->c, (size_t)vertices, BODY_JOINTS * sizeof *mesh->weights);
    mesh->triangle = mem_alloc(f->c, (size_t)triangles, 3 * sizeof *mesh->triangle);
    mesh->triangle_uv = mem_alloc(f->c, (size_t)triangles, 3 * sizeof *mesh->triangle_uv);
    return mesh->rest && mesh->weights && mesh->triangle && mesh->triangle_uv ? mesh : NULL;
}

/* Removes triangles whose corners are all hidden. */
static void drop_hidden(dressed_mesh *mesh, const uint8_t *hidden) {
    int kept = 0;
    for (int t = 0; t < mesh->triangles; t++) {
        const uint32_t *v = mesh->triangle + 3 * t;
        if (hidden[v[0]] && hidden[v[1]] && hidden[v[2]]) continue;
        memmove(mesh->triangle + 3 * kept, v, 3 * sizeof *v);
        memmove(mesh->triangle_uv + 3 * kept, mesh->triangle_uv + 3 * t, 3 * sizeof *v);
        kept++;
    }
    mesh->triangles = kept;
}

static sherf_status add_body(fitting *f) {
    const makehuman *human = f->s->human;
    const image_u8 *image;
    dressed_mesh *mesh = add_mesh(f, WEAR_KINDS, human->body_vertices, human->triangles);
    if (!mesh) return SHERF_NO_MEMORY;
    memcpy(mesh->rest, f->rest, (size_t)human->body_vertices * 3 * sizeof *mesh->rest);
    memcpy(mesh->weights, f->s->body->weights,
           (size_t)human->body_vertices * BODY_JOINTS * sizeof *mesh->weights);
    memcpy(mesh->triangle, human->triangle, (size_t)human->triangles * 3 * sizeof *mesh->triangle);
    memcpy(mesh->triangle_uv, human->triangle_uv, (size_t)human->triangles * 3 * sizeof *mesh->triangle_uv);
    mesh->uvs = human->uvs, mesh->uv = human->uv;
    sherf_status status = wardrobe_skin(f->c, f->s->wardrobe, f->p->skin, &image);
    if (!status)
        status = trace_texture_create(f->c, image->width, image->height, 3, image->data, &mesh->texture);
    mesh->material = trace_material_plain();
    mesh->material.color = mesh->texture;
    mesh->material.specular = 0.03f, mesh->material.roughness = 0.45f;
    static const float wrap[3] = {0.35f, 0.18f, 0.12f};
    memcpy(mesh->material.wrap, wrap, sizeof wrap);
    memcpy(mesh->material.tint, f->p->skin_tint, sizeof f->p->skin_tint);
    return status;
}

/* Hides the body under the garment; a cut-off part hides nothing. */
static void hide_body(fitting *f, const worn *t, const dye_cut *cut) {
    const makehuman *human = f->s->human;
    for (int v = 0; v < human->vertices; v++) {
        if (!(t->proxy->hides[v] || t->under[v])) continue;
        if (human->vertex[3 * v + 1] < cut->legs_m + 0.03f ||
            fabsf(human->vertex[3 * v]) > cut->arms_m - 0.03f)
            continue;
        f->hidden[v] = 1;
    }
}

static sherf_status add_worn(fitting *f, int item, int layer, const dye_cut *cut, int texture) {
    const worn *t;
    sherf_status status = wardrobe_worn(f->c, f->s->wardrobe, item, &t);
    if (status) return status;
    const proxy *p = t->proxy;
    dressed_mesh *mesh = add_mesh(f, t->item->kind, p->vertices, p->triangles);
    float *blend = mem_alloc(f->c, (size_t)p->vertices, 15 * sizeof *blend);
    if (!mesh || !blend) {
        mem_free(blend);
        return SHERF_NO_MEMORY;
    }
    proxy_fit(p, f->shaped, mesh->rest);
    proxy_carry(p, 15, f->blend, blend);
    proxy_carry(p, BODY_JOINTS, f->s->weights, mesh->weights);
    for (int v = 0; v < p->vertices; v++) {
        const float *a = blend + 15 * (size_t)v;
        float *x = mesh->rest + 3 * (size_t)v, in[3] = {x[0], x[1], x[2]};
        for (int k = 0; k < 3; k++)
            x[k] = a[4 * k] * in[0] + a[4 * k + 1] * in[1] + a[4 * k + 2] * in[2] + a[4 * k + 3] + a[12 + k];
    }
    mem_free(blend);
    memcpy(mesh->triangle, p->triangle, (size_t)p->triangles * 3 * sizeof *mesh->triangle);
    memcpy(mesh->triangle_uv, p->triangle_uv, (size_t)p->triangles * 3 * sizeof *mesh->triangle_uv);
    mesh->uvs = p->uvs, mesh->uv = p->uv;
    hide_body(f, t, cut);
    status = dye_garment(f->c, f->p, layer, t, texture % t->textures, cut, &mesh->texture);
    mesh->material = material_of(t->item, layer, mesh->texture);
    return status;
}

static proxy_surface surface_of(const dressed_mesh *mesh) {
    return (proxy_surface){mesh->vertices, mesh->triangles, mesh->rest, mesh->triangle};
}

/* Hides the parts of `below` that lie under `above`. */
static sherf_status hide_covered(fitting *f, int below, int above, float reach_m, int rings) {
    dressed_mesh *under = &f->d->mesh[below];
    proxy_surface lower = surface_of(under), upper = surface_of(&f->d->mesh[above]);
    uint8_t *hidden = mem_zero(f->c, (size_t)under->vertices, 1);
    if (!hidden) return SHERF_NO_MEMORY;
    sherf_status status = proxy_cover(f->c, &lower, &upper, reach_m, rings, hidden);
    if (!status) drop_hidden(under, hidden);
    mem_free(hidden);
    return status;
}

/* Pushes cloth off the skin and off the cloth under it, and hides what it covers. */
static sherf_status layer_clothes(fitting *f, int first, int count) {
    sherf_status status = SHERF_OK;
    for (int i = first; i < first + count && !status; i++) {
        dressed_mesh *above = &f->d->mesh[i];
        proxy_surface over = surface_of(above), naked = surface_of(&f->d->mesh[0]);
        status = proxy_push(f->c, &naked, &over, over_skin_m, above->rest);
        for (int k = first; k < i && !status; k++) {
            dressed_mesh *below = &f->d->mesh[k];
            proxy_surface under = surface_of(below);
            status = proxy_push(f->c, &under, &over, over_cloth_m, above->rest);
            if (!status) status = hide_covered(f, k, i, 0.06f, 1);
        }
    }
    return status;
}

/* Trouser legs in boots: pushes boots off the cloth and hides the covered cloth. */
static sherf_status put_boots_on(fitting *f, int clothes, int boots) {
    sherf_status status = SHERF_OK;
    for (int i = clothes; i < boots && !status; i++) {
        proxy_surface under = surface_of(&f->d->mesh[i]), over = surface_of(&f->d->mesh[boots]);
        status = proxy_push(f->c, &under, &over, over_cloth_m, f->d->mesh[boots].rest);
        if (!status) status = hide_covered(f, i, boots, 0.06f, 1);
    }
    return status;
}

/* Socks in trouser legs: pushes the legs off the socks and hides the covered socks. */
static sherf_status tuck_socks(fitting *f, int clothes, int shoes) {
    sherf_status status = SHERF_OK;
    for (int i = clothes; i < shoes && !status; i++) {
        proxy_surface under = surface_of(&f->d->mesh[shoes]), over = surface_of(&f->d->mesh[i]);
        status = proxy_push(f->c, &under, &over, 0.003f, f->d->mesh[i].rest);
        if (!status) status = hide_covered(f, shoes, i, 0.05f, 0);
    }
    return status;
}

static sherf_status put_on(fitting *f) {
    const person *p = f->p;
    const outfit *o = &outfits[p->outfit];
    static const dye_cut whole = {-INFINITY, INFINITY};
    dye_cut cut = {o->legs_m != 0 ? o->legs_m : -INFINITY, o->arms_m != 0 ? o->arms_m : INFINITY};
    int clothes = f->d->meshes, layer = 0, hair = -1;
    sherf_status status = SHERF_OK;
    for (int i = 0; i < OUTFIT_ITEMS && o->item[i] && !status; i++)
        status = add_worn(f, wear_find(o->item[i]), layer++, &cut, 0);
    if (!status) status = layer_clothes(f, clothes, f->d->meshes - clothes);
    int shoes = f->d->meshes;
    if (!status) status = add_worn(f, p->shoes, layer++, &whole, 0);
    if (!status)
        status = wear_items[p->shoes].boots ? put_boots_on(f, clothes, shoes) : tuck_socks(f, clothes, shoes);
    const int other[] = {p->eyes, p->brows, p->lashes, p->hair, p->glasses, p->hat};
    for (size_t i = 0; i < COUNT_OF(other) && !status; i++, layer++) {
        if (other[i] < 0) continue;
        if (other[i] == p->hair) hair = f->d->meshes;
        status = add_worn(f, other[i], layer, &whole, other[i] == p->eyes ? p->eye_texture : layer);
        if (!status && other[i] == p->hat && hair >= 0)
            status = hide_covered(f, hair, f->d->meshes - 1, 0.08f, 0);
    }
    if (!status) drop_hidden(&f->d->mesh[0], f->hidden);
    return status;
}

sherf_status dressed_create(context *c, studio *s, const person *p, dressed **out) {
    *out = NULL;
    size_t V = (size_t)s->human->vertices;
    fitting f = {.c = c, .s = s, .p = p};
    sherf_status status = SHERF_NO_MEMORY;
    f.d = mem_zero(c, 1, sizeof *f.d);
    f.shaped = mem_alloc(c, V, 3 * sizeof *f.shaped);
    f.rest = mem_alloc(c, V, 3 * sizeof *f.rest);
    f.blend = mem_alloc(c, V, 15 * sizeof *f.blend);
    f.hidden = mem_zero(c, V, 1);
    if (!f.d || !f.shaped || !f.rest || !f.blend || !f.hidden) goto done;
    status = makehuman_shape(c, s->human, &p->macro, p->details, p->detail, f.shaped);
    if (!status) status = to_rest(&f);
    if (!status) status = open_body_project(c, s->body, f.rest, f.d->shape);
    if (!status) status = add_body(&f);
    if (!status) status = put_on(&f);
done:
    mem_free(f.shaped);
    mem_free(f.rest);
    mem_free(f.blend);
    mem_free(f.hidden);
    if (status)
        dressed_free(f.d);
    else
        *out = f.d;
    return status;
}

void dressed_free(dressed *d) {
    for (int i = 0; d && i < d->meshes; i++) {
        mem_free(d->mesh[i].rest);
        mem_free(d->mesh[i].weights);
        mem_free(d->mesh[i].triangle);
        mem_free(d->mesh[i].triangle_uv);
        trace_texture_free(d->mesh[i].texture);
    }
    mem_free(d);
}

/* ---- posing ---- */

void dressed_pose(const studio *s, const dressed *d, int i, const posed_body *posed, float *positions) {
    const dressed_mesh *mesh = &d->mesh[i];
    float world[BODY_JOINTS][12]; /* rest pose to world */
    for (int j = 0; j < BODY_JOINTS; j++)
        for (int r = 0; r < 3; r++)
            for (int k = 0; k < 4; k++) {
                float sum = k == 3 ? posed->Th[r] : 0;
                for (int n = 0; n < 3; n++) sum += posed->R[3 * r + n] * posed->transform[j][4 * n + k];
                world[j][4 * r + k] = sum;
            }
    for (int v = 0; v < mesh->vertices; v++) {
        const float *w = mesh->weights + (size_t)v * BODY_JOINTS;
        float x[3], blend[12] = {0};
        for (int k = 0; k < 3; k++)
            x[k] = mesh->rest[3 * v + k] + (mesh->kind == WEAR_KINDS ? posed->pose_offset[3 * v + k] : 0);
        for (int j = 0; j < BODY_JOINTS; j++)
            for (int k = 0; k < 12 && w[j] != 0; k++) blend[k] += w[j] * world[j][k];
        for (int k = 0; k < 3; k++)
            positions[3 * v + k] =
                blend[4 * k] * x[0] + blend[4 * k + 1] * x[1] + blend[4 * k + 2] * x[2] + blend[4 * k + 3];
    }
}
