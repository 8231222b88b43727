/* A pointer for code that only reads but does not say so: functions of libraries, input tensors. It replaces
 * a cast, which would silently remove const (-Wcast-qual). */
#ifndef SHERF_ONLY_READ_H
#define SHERF_ONLY_READ_H

static inline void *only_read(const void *p) {
    union {
        const void *in;
        void *out;
    } same = {p};
    return same.out;
}

#endif
