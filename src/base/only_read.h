/* A pointer for what only reads there and does not say so: functions of libraries, tensors that are inputs.
 * It stands in place of a cast, which would take const away unseen (-Wcast-qual). */
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
