/* The devices that this build can use on this machine. NVIDIA's driver is looked up at run time, so a build
 * with CUDA runs on machines without one. */
#include <dlfcn.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>

#include "base/device.h"

#ifdef SHERF_HAVE_CUDA
enum { BUILD_HAS_CUDA = 1 };
/* Of the driver's interface (libcuda.so.1), as in cuda.h: 0 is success. */
typedef struct {
    int (*init)(unsigned flags);
    int (*count)(int *out);
    int (*name)(char *out, int size, int device);
    int (*attribute)(int *out, int which, int device);
} driver;
enum { ATTRIBUTE_MAJOR = 75, ATTRIBUTE_MINOR = 76, MAJOR_MIN = 8 };

static bool driver_open(driver *d) {
    void *library = dlopen("libcuda.so.1", RTLD_NOW | RTLD_LOCAL); /* stays open */
    if (!library) return false;
    *(void **)&d->init = dlsym(library, "cuInit");
    *(void **)&d->count = dlsym(library, "cuDeviceGetCount");
    *(void **)&d->name = dlsym(library, "cuDeviceGetName");
    *(void **)&d->attribute = dlsym(library, "cuDeviceGetAttribute");
    return d->init && d->count && d->name && d->attribute;
}

int device_gpu_number(void) {
    const char *place = getenv("OMPI_COMM_WORLD_LOCAL_RANK");
    const int number = place ? atoi(place) : 0;
    return number > 0 ? number : 0;
}

static bool look(char *line, size_t size) {
    driver d;
    char name[96] = "";
    int code = 0, count = 0, major = 0, minor = 0;
    const int number = device_gpu_number();
    if (!driver_open(&d)) {
        snprintf(line, size, "no NVIDIA driver was found on this machine (libcuda.so.1)");
        return false;
    }
    if ((code = d.init(0)) != 0 || d.count(&count) != 0 || count < 1) {
        snprintf(line, size, "the NVIDIA driver finds no GPU on this machine (its code is %d)", code);
        return false;
    }
    if (number >= count) {
        snprintf(line, size, "process %d of this machine needs a GPU of its own, and there are %d",
                 number + 1, count);
        return false;
    }
    d.name(name, sizeof name, number);
    d.attribute(&major, ATTRIBUTE_MAJOR, number);
    d.attribute(&minor, ATTRIBUTE_MINOR, number);
    if (major < MAJOR_MIN) {
        snprintf(line, size, "%s has compute capability %d.%d, and %d.0 is the least", name, major, minor,
                 MAJOR_MIN);
        return false;
    }
    snprintf(line, size, "%s", name);
    return true;
}

/* Starting the driver takes a while, so the answer is kept; it does not change. */
static struct {
    pthread_once_t once;
    bool present;
    char line[160];
} found = {.once = PTHREAD_ONCE_INIT};

static void look_once(void) {
    found.present = look(found.line, sizeof found.line);
}

bool device_gpu_present(char *line, size_t size) {
    pthread_once(&found.once, look_once);
    snprintf(line, size, "%s", found.line);
    return found.present;
}
#else
enum { BUILD_HAS_CUDA = 0 };
int device_gpu_number(void) {
    return 0;
}
bool device_gpu_present(char *line, size_t size) {
    snprintf(line, size, "this sherf was built without CUDA; configure with -DSHERF_CUDA=ON");
    return false;
}
#endif

sherf_device device_resolve(sherf_device device) {
    char line[160];
    if (device != SHERF_DEVICE_AUTO) return device;
    return device_gpu_present(line, sizeof line) ? SHERF_DEVICE_CUDA : SHERF_DEVICE_CPU;
}

sherf_status sherf_device_find(sherf_device device, char *line, size_t size) {
    char unwanted[160], gpu[160];
    if (!line || !size) {
        line = unwanted;
        size = sizeof unwanted;
    }
    gpu[0] = 0;
    const bool present = device != SHERF_DEVICE_CPU && device_gpu_present(gpu, sizeof gpu);
    if (present)
        snprintf(line, size, "%s (CUDA)", gpu);
    else if (device == SHERF_DEVICE_CUDA)
        snprintf(line, size, "%s", gpu);
    else if (device == SHERF_DEVICE_AUTO && BUILD_HAS_CUDA)
        snprintf(line, size, "CPU (%s): %s", isa_name(isa_best()), gpu);
    else
        snprintf(line, size, "CPU (%s)", isa_name(isa_best()));
    return present || device != SHERF_DEVICE_CUDA ? SHERF_OK : SHERF_UNSUPPORTED;
}
