/* Random numbers: SplitMix64 of key and counter, converted to uniform, normal or integer numbers. Keys come
 * from a seed and a stream's name (FNV-1a). */
#include <math.h>

#include "base/base.h"

uint64_t fnv1a64(const char *text) {
    uint64_t h = 0xCBF29CE484222325u;
    for (; *text; text++) h = (h ^ (unsigned char)*text) * 0x100000001B3u;
    return h;
}

uint64_t splitmix64(uint64_t x) {
    uint64_t z = x + 0x9E3779B97F4A7C15u;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

double random_uniform(uint64_t key, uint64_t i) {
    return (double)(splitmix64(key + i) >> 40) / (double)(1 << 24);
}

double random_normal(uint64_t key, uint64_t i) {
    double u = 1.0 - (double)(splitmix64(key + 2 * i) >> 11) / 9007199254740992.0; /* (0, 1] */
    double v = (double)(splitmix64(key + 2 * i + 1) >> 11) / 9007199254740992.0;
    return sqrt(-2.0 * log(u)) * cos(6.283185307179586 * v);
}

uint64_t random_key(uint64_t seed, const char *stream, uint64_t index) {
    return splitmix64(splitmix64(seed ^ fnv1a64(stream)) + index * 0xD1342543DE82EF95u);
}

int64_t random_below(uint64_t key, uint64_t i, int64_t n) {
    return (int64_t)(((unsigned __int128)splitmix64(key + i) * (uint64_t)n) >> 64);
}
