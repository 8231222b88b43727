/* image: converts colours by the file's profile to sRGB, through Little CMS. */
#include <lcms2.h>
#include <stdlib.h>
#include <string.h>

#include "io/image_inside.h"

bool image_profile_take(image_decoder *d, const void *data, size_t bytes) {
    if (!d->photo || !bytes || d->profile) return true;
    if (bytes > profile_bytes_max) {
        d->profile_fate = PROFILE_BROKEN;
        return true;
    }
    if (!(d->profile = mem_alloc(d->c, bytes, 1))) {
        d->status = SHERF_NO_MEMORY;
        return false;
    }
    memcpy(d->profile, data, bytes);
    d->profile_bytes = bytes;
    return true;
}

/* Primaries by ITU-T H.273 as x, y of red, green, blue; the white is D65. */
static cmsHPROFILE profile_of_primaries(cmsContext lcms, int code) {
    static const struct {
        int code;
        cmsCIExyYTRIPLE xy;
    } known[] = {{9, {{0.708, 0.292, 1}, {0.170, 0.797, 1}, {0.131, 0.046, 1}}},   /* BT.2020 */
                 {12, {{0.680, 0.320, 1}, {0.265, 0.690, 1}, {0.150, 0.060, 1}}}}; /* Display P3 */
    const cmsCIExyY white = {0.3127, 0.3290, 1};
    const double srgb[] = {2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045};
    cmsHPROFILE profile = NULL;
    cmsToneCurve *curve = cmsBuildParametricToneCurve(lcms, 4, srgb);
    cmsToneCurve *const curves[] = {curve, curve, curve};
    for (size_t i = 0; curve && i < COUNT_OF(known); i++)
        if (known[i].code == code) profile = cmsCreateRGBProfileTHR(lcms, &white, &known[i].xy, curves);
    if (curve) cmsFreeToneCurve(curve);
    return profile;
}

/* Whether it changes no colour by more than one step: it is sRGB under any name. */
static bool is_srgb(cmsHTRANSFORM to_srgb, int channels) {
    enum { STEPS = 6 };
    for (int i = 0; i < STEPS * STEPS * STEPS; i++) {
        uint8_t in[4] = {(uint8_t)(i % STEPS * 51), (uint8_t)(i / STEPS % STEPS * 51),
                         (uint8_t)(i / STEPS / STEPS * 51), 255},
                out[4];
        cmsDoTransform(to_srgb, in, out, 1);
        for (int k = 0; k < 3; k++)
            if (abs(in[k] - out[k]) > 1) return false;
    }
    return channels >= 3;
}

typedef struct {
    image_u8 *picture;
    cmsHTRANSFORM to_srgb;
} converting;

static void convert_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const converting *k = arg;
    const size_t row = (size_t)k->picture->width * (size_t)k->picture->channels;
    for (int64_t y = begin; y < end; y++) {
        uint8_t *at = k->picture->data + (size_t)y * row;
        cmsDoTransform(k->to_srgb, at, at, (cmsUInt32Number)k->picture->width);
    }
}

static void convert(image_decoder *d, cmsContext lcms, cmsHPROFILE from) {
    const cmsUInt32Number kind = d->channels == 4 ? TYPE_RGBA_8 : TYPE_RGB_8;
    /* threads would share the cache of the last pixel */
    const cmsUInt32Number flags = cmsFLAGS_NOCACHE | (d->channels == 4 ? cmsFLAGS_COPY_ALPHA : 0);
    cmsHPROFILE srgb = cmsCreate_sRGBProfileTHR(lcms);
    cmsHTRANSFORM to_srgb =
        srgb ? cmsCreateTransformTHR(lcms, from, kind, srgb, kind, INTENT_RELATIVE_COLORIMETRIC, flags)
             : NULL;
    d->profile_fate = to_srgb ? PROFILE_NONE : PROFILE_BROKEN;
    if (to_srgb && !is_srgb(to_srgb, d->channels)) {
        converting k = {&d->out, to_srgb};
        parallel_for(d->c, d->out.height, 64, convert_rows, &k);
        d->profile_fate = PROFILE_TAKEN;
    }
    if (to_srgb) cmsDeleteTransform(to_srgb);
    if (srgb) cmsCloseProfile(srgb);
}

void image_profile_apply(image_decoder *d) {
    if (d->channels < 3 || (!d->profile && !d->primaries)) return;
    cmsContext lcms = cmsCreateContext(NULL, NULL);
    if (!lcms) {
        d->status = failure(d->c, SHERF_NO_MEMORY, "out of memory");
        return;
    }
    cmsHPROFILE from = d->profile
                           ? cmsOpenProfileFromMemTHR(lcms, d->profile, (cmsUInt32Number)d->profile_bytes)
                           : profile_of_primaries(lcms, d->primaries);
    const cmsColorSpaceSignature space = from ? cmsGetColorSpace(from) : 0;
    if (space == cmsSigRgbData)
        convert(d, lcms, from);
    else if (d->profile && space != cmsSigGrayData && space != cmsSigCmykData)
        d->profile_fate = PROFILE_BROKEN; /* inks and greys are read as without a profile, which is usual */
    if (from) cmsCloseProfile(from);
    cmsDeleteContext(lcms);
}
