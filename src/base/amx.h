/* Tile instructions of AMX with room between them. A core whose other hardware thread is busy (another guest
 * of the host, as a rule) takes a tile instruction that follows another at once at half the rate or less, and
 * at nearly the full rate where seven or more ordinary instructions lie between: docs/speed.md has the
 * measurements. On a core of one's own they cost nothing, since the product unit is slower. So tiles are
 * loaded and multiplied with these, unless other work is put between them by hand (tile_*_bare). */
#ifndef SHERF_AMX_H
#define SHERF_AMX_H

#include <immintrin.h>

#define TILE_ROOM() __asm__ volatile("nop\n\tnop\n\tnop\n\tnop\n\tnop\n\tnop\n\tnop")

#define tile_load(tile, at, stride)                                                                          \
    do {                                                                                                     \
        _tile_loadd(tile, at, stride);                                                                       \
        TILE_ROOM();                                                                                         \
    } while (0)

/* sum += a b */
#define tile_product(sum, a, b)                                                                              \
    do {                                                                                                     \
        _tile_dpbf16ps(sum, a, b);                                                                           \
        TILE_ROOM();                                                                                         \
    } while (0)

#endif
