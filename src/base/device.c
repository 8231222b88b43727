/* Which devices this build can compute on, on this machine. NVIDIA's driver is looked for at run time, so a
 * build with CUDA runs on machines without one. */
#include <dlfcn.h>
#include <stdio.h>

#include "base/device.h"

#ifdef SHERF_HAVE_CUDA
/* Of the driver's interface (libcuda.so.1), as in cuda.h: 0 is success. */
typedef struct {
    int (*init)(unsigned flags);
    int (*count)(int *out);
    int (*name)(char *out, int size, int device);
    int (*attribute)(int *out, int which, int device);
} driver;
enum { ATTRIBUTE_MAJOR = 75, ATTRIBUTE_MINOR = 76, MAJOR_LEAST = 8 };

static bool driver_open(driver *d) {
    void *library = dlopen("libcuda.so.1", RTLD_NOW | RTLD_LOCAL); /* stays open */
    if (!library) return false;
    *(void **)&d->init = dlsym(library, "cuInit");
    *(void **)&d->count = dlsym(library, "cuDeviceGetCount");
    *(void **)&d->name = dlsym(library, "cuDeviceGetName");
    *(void **)&d->attribute = dlsym(library, "cuDeviceGetAttribute");
    return d->init && d->count && d->name && d->attribute;
}

bool device_gpu_present(char *line, size_t size) {
    driver d;
    char name[96] = "";
    int code = 0, count = 0, major = 0, minor = 0;
    if (!driver_open(&d)) {
        snprintf(line, size, "no NVIDIA driver was found on this machine (libcuda.so.1)");
        return false;
    }
    if ((code = d.init(0)) != 0 || d.count(&count) != 0 || count < 1) {
        snprintf(line, size, "the NVIDIA driver finds no GPU on this machine (its code is %d)", code);
        return false;
    }
    d.name(name, sizeof name, 0);
    d.attribute(&major, ATTRIBUTE_MAJOR, 0);
    d.attribute(&minor, ATTRIBUTE_MINOR, 0);
    if (major < MAJOR_LEAST) {
        snprintf(line, size, "%s has compute capability %d.%d, and %d.0 is the least", name, major, minor,
                 MAJOR_LEAST);
        return false;
    }
    snprintf(line, size, "%s", name);
    return true;
}
#else
bool device_gpu_present(char *line, size_t size) {
    snprintf(line, size, "this sherf was built without CUDA; configure with -DSHERF_CUDA=ON");
    return false;
}
#endif

sherf_status sherf_device_find(sherf_device device, char *line, size_t size) {
    char unwanted[8];
    if (!line || !size) {
        line = unwanted;
        size = sizeof unwanted;
    }
    if (device == SHERF_DEVICE_CUDA) {
        char name[96];
        if (!device_gpu_present(line, size)) return SHERF_UNSUPPORTED;
        snprintf(name, sizeof name, "%s", line);
        snprintf(line, size,
                 "%s is there, but no verb computes on a GPU yet (docs/cuda.md says what is missing)", name);
        return SHERF_UNSUPPORTED;
    }
    snprintf(line, size, "CPU (%s)", isa_name(isa_best()));
    return SHERF_OK;
}
