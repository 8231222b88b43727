/* proxy: a worn thing (clothes, hair, eyes, brows, lashes, shoes): a mesh bound to the base mesh. Each vertex
 * is a weighted sum of three vertices of the base mesh plus an offset, so it follows every shape. */
#ifndef SHERF_PROXY_H
#define SHERF_PROXY_H

#include "base/base.h"
#include "io/value.h"

enum { PROXY_VERTICES_MAX = 1 << 17, PROXY_TEXTURES_MAX = 16 };

typedef struct {
    char *name;
    int vertices, uvs, triangles, textures;
    uint32_t *ref;         /* V x 3, vertices of the base mesh */
    float *weight;         /* V x 3; sums to 1, may be negative */
    float *offset;         /* V x 3, metres, for the base mesh itself */
    float extent[3];       /* size of the bound part of the base mesh itself: offsets scale with it */
    uint32_t *triangle;    /* T x 3 */
    uint32_t *triangle_uv; /* T x 3 */
    float *uv;             /* uvs x 2, v upwards */
    uint8_t *hides;        /* base vertices: 1 where this covers the base mesh; never NULL */
    int hidden;            /* the number of them that the file names */
    char *texture[PROXY_TEXTURES_MAX]; /* paths below the proxy's folder */
} proxy;

/* base_vertex: vertices x 3 in metres, the unshaped mesh the file was made for; lengths in the file are
 * decimetres. */
sherf_status proxy_parse(context *c, const value *root, const char *name, int base_vertices,
                         const float *base_vertex, proxy **out);
/* folder/NAME.json, NAME the folder's own. */
sherf_status proxy_read(context *c, const char *folder, int base_vertices, const float *base_vertex,
                        proxy **out);
void proxy_free(proxy *p);
/* Its place on a shaped mesh: V x 3. */
void proxy_fit(const proxy *p, const float *base_vertex, float *vertex);
/* Carries numbers of base vertices (skinning weights: `count` in each row, not negative, sum 1) over to the
 * proxy. */
void proxy_carry(const proxy *p, int count, const float *base_row, float *row);

/* A surface for the functions below. */
typedef struct {
    int vertices, triangles;
    const float *vertex;
    const uint32_t *triangle;
} proxy_surface;
/* hidden[i] = 1 if vertex i of `below` lies under `above`: at most `reach_m` under it and at least `rings`
 * edges away from the uncovered part. Other entries stay. */
sherf_status proxy_cover(context *c, const proxy_surface *below, const proxy_surface *above, float reach_m,
                         int rings, uint8_t *hidden);
/* Moves the vertices of `above` that are deeper than `gap_m` over the surface `below` (within 3 cm of it) out
 * to that gap, smoothly. */
sherf_status proxy_push(context *c, const proxy_surface *below, const proxy_surface *above, float gap_m,
                        float *vertex_above);

#endif
