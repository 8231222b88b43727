/* Fuzz target: --joints, a JSON of names for a BVH file whose own names are unknown. */
#include <math.h>
#include <string.h>

#include "fuzz_folder.h"
#include "motion/source.h"

#define JOINT(name, offset, inside)                                                                          \
    "JOINT " name " { OFFSET " offset " CHANNELS 3 Zrotation Xrotation Yrotation " inside " } "
#define END "End Site { OFFSET 0 1 0 }"
#define LIMB(a, b, c, at, along) JOINT(a, at, JOINT(b, along, JOINT(c, along, END)))
static const char rig[] =
    "HIERARCHY ROOT a { OFFSET 0 0 0 CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation "
    "Yrotation " LIMB("b", "c", "d", "9 0 0", "0 -40 0") LIMB("e", "f", "g", "-9 0 0", "0 -40 0")
        JOINT("h", "0 20 0",
              JOINT("i", "0 20 0",
                    JOINT("j", "0 15 0", END) LIMB("k", "l", "m", "15 5 0", "25 0 0")
                        LIMB("n", "o", "p", "-15 5 0", "-25 0 0"))) "} MOTION Frames: 1 Frame Time: 0.04 ";

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static unsigned char text[sizeof rig + 256];
    context *c = fuzz_context();
    if (!*text) {
        strcpy((char *)text, rig);
        for (int i = 0; i < 3 + 3 * 16; i++) strcat((char *)text, "0 ");
    }
    const sherf_motion_options o = {.joints = fuzz_file("map.json", data, size)};
    const size_t live = mem_live();
    sherf_motion *motion = NULL;
    sherf_pose pose;
    sherf_status status = motion_parse(c, text, strlen((char *)text), &o, &motion);
    if ((status == SHERF_OK) != (motion != NULL)) abort();
    if (motion) sherf_motion_pose(motion, 0, &pose);
    for (int k = 0; k < 72 && motion; k++)
        if (!isfinite(pose.poses_rad[k])) abort();
    sherf_motion_free(motion);
    return fuzz_end(c, status, live);
}
