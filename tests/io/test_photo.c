/* Tests of users' photos: every orientation in every format, alpha, focal lengths, and messages for files
 * that are not pictures. The picture is always the same: 24 x 16 pixels with one colour in each quarter. */
#include <lcms2.h>
#include <math.h>
#include <zlib.h>

#include "io/exif.h"
#include "sample.h"

enum { W = 24, H = 16 };
static const uint8_t quarter[4][4] = {
    {200, 40, 40, 255}, {40, 180, 60, 255}, {50, 60, 200, 128}, {220, 210, 120, 0}};

static const uint8_t *colour_at(int x, int y) {
    return quarter[(x >= W / 2) + 2 * (y >= H / 2)];
}

/* The pixels as a camera stores them with this orientation. The standard defines where the stored row 0 and
 * column 0 are seen. */
static void stored(int orientation, int channels, int *width, int *height, uint8_t *out) {
    static const struct {
        bool row_is_x, row_back,
            column_back; /* rows run along x; rows start at the far end; columns start at the far end */
    } way[9] = {{0},          {0, 0, 0},    {0, 0, 1},    {0, 1, 1},   {0, 1, 0},
                {true, 0, 0}, {true, 1, 0}, {true, 1, 1}, {true, 0, 1}};
    const bool swap = way[orientation].row_is_x;
    *width = swap ? H : W, *height = swap ? W : H;
    for (int v = 0; v < *height; v++)
        for (int u = 0; u < *width; u++) {
            int row = way[orientation].row_back ? *height - 1 - v : v;
            int column = way[orientation].column_back ? *width - 1 - u : u;
            memcpy(out + (v * *width + u) * channels, swap ? colour_at(row, column) : colour_at(column, row),
                   (size_t)channels);
        }
}

/* ---- files by rule ---- */
typedef struct {
    size_t n;
    uint8_t data[4096];
} bytes;

static void put(bytes *b, const void *data, size_t n) {
    assert_true(b->n + n <= sizeof b->data);
    memcpy(b->data + b->n, data, n);
    b->n += n;
}
static void put_number(bytes *b, uint32_t v, int n, bool big) {
    for (int i = 0; i < n; i++) b->data[b->n++] = (uint8_t)(v >> 8 * (big ? n - 1 - i : i));
}

/* tag, type (3 short, 4 long, 5 rational), numerator, denominator */
typedef struct {
    unsigned tag, type, value, below;
} tag;

static void put_entry(bytes *b, const tag *t, size_t *rational, bool big) {
    put_number(b, t->tag, 2, big);
    put_number(b, t->type, 2, big);
    put_number(b, 1, 4, big);
    put_number(b, t->type == 5 ? (uint32_t)*rational : t->value, t->type == 3 ? 2 : 4, big);
    if (t->type == 3) put_number(b, 0, 2, big);
    if (t->type == 5) *rational += 8;
}

/* A TIFF header, a directory with the orientation and the offset of the Exif directory, the Exif directory
 * and its fractions. */
static void put_exif(bytes *b, bool big, int orientation, const tag *tags, size_t n) {
    const size_t exif = 8 + 2 + 2 * 12 + 4;
    size_t rational = exif + 2 + n * 12 + 4;
    const tag first[2] = {{0x112, 3, (unsigned)orientation, 1}, {0x8769, 4, (unsigned)exif, 1}};
    put(b, big ? "MM" : "II", 2);
    put_number(b, 42, 2, big);
    put_number(b, 8, 4, big);
    put_number(b, 2, 2, big);
    for (int i = 0; i < 2; i++) put_entry(b, &first[i], &rational, big);
    put_number(b, 0, 4, big);
    put_number(b, (uint32_t)n, 2, big);
    for (size_t i = 0; i < n; i++) put_entry(b, &tags[i], &rational, big);
    put_number(b, 0, 4, big);
    for (size_t i = 0; i < n; i++)
        if (tags[i].type == 5) put_number(b, tags[i].value, 4, big), put_number(b, tags[i].below, 4, big);
}

static void put_file(context *c, bytes *b, const char *name) {
    unsigned char *data;
    size_t n;
    assert_ok(c, file_read(c, sample_path(name), 4096, &data, &n));
    put(b, data, n);
    mem_free(data);
}

static void make_jpeg(context *c, bytes *b, int orientation, bool big, const tag *tags, size_t n) {
    uint8_t rgb[W * H * 3], *data;
    int width, height;
    size_t length;
    bytes exif = {0};
    put(&exif, "Exif\0", 6);
    put_exif(&exif, big, orientation, tags, n);
    stored(orientation, 3, &width, &height, rgb);
    assert_ok(c, jpeg_to_memory(c, width, height, rgb, 95, &data, &length));
    put(b, "\xff\xd8\xff\xe1", 4);
    put_number(b, (uint32_t)exif.n + 2, 2, true);
    put(b, exif.data, exif.n);
    put(b, data + 2, length - 2);
    mem_free(data);
}

/* eXIf before or after the pixels. */
static void make_png(context *c, bytes *b, int orientation, bool big, bool behind) {
    uint8_t rgba[W * H * 4], *data;
    int width, height;
    size_t length;
    bytes chunk = {0};
    put(&chunk, "eXIf", 4);
    put_exif(&chunk, big, orientation, NULL, 0);
    stored(orientation, 4, &width, &height, rgba);
    assert_ok(c, png_to_memory(c, width, height, 4, rgba, 6, &data, &length));
    size_t at = behind ? length - 12 : 8 + 25;
    put(b, data, at);
    put_number(b, (uint32_t)chunk.n - 4, 4, true);
    put(b, chunk.data, chunk.n);
    put_number(b, (uint32_t)crc32(0, chunk.data, (uInt)chunk.n), 4, true);
    put(b, data + at, length - at);
    mem_free(data);
}

/* quad.webp in the container that can hold EXIF. */
static void make_webp(context *c, bytes *b, int orientation, bool prefixed) {
    bytes plain = {0}, exif = {0};
    put_file(c, &plain, "quad.webp");
    if (prefixed) put(&exif, "Exif\0", 6);
    put_exif(&exif, false, orientation, NULL, 0);
    if (exif.n % 2) put(&exif, "", 1);
    put(b, "RIFF", 4);
    put_number(b, (uint32_t)(4 + 18 + plain.n - 12 + 8 + exif.n), 4, false);
    put(b, "WEBPVP8X", 8);
    put_number(b, 10, 4, false);
    put_number(b, 8, 4, false);
    put_number(b, W - 1, 3, false);
    put_number(b, H - 1, 3, false);
    put(b, plain.data + 12, plain.n - 12);
    put(b, "EXIF", 4);
    put_number(b, (uint32_t)exif.n, 4, false);
    put(b, exif.data, exif.n);
}

/* ---- reading them ---- */
static void assert_upright(const image_u8 *p, int tolerance, const char *what) {
    assert_int_equal(p->width, W);
    assert_int_equal(p->height, H);
    for (int y = 2; y < H; y += 11) /* away from the borders of the colours, where codecs blur */
        for (int x = 2; x < W; x += 19)
            for (int k = 0; k < p->channels; k++) {
                int have = p->data[(y * W + x) * p->channels + k], want = colour_at(x, y)[k];
                if (k < 3 && p->channels == 4 && !colour_at(x, y)[3]) continue; /* an invisible pixel */
                if (abs(have - want) > tolerance)
                    fail_msg("%s: %d at %d %d, channel %d: not %d", what, have, x, y, k, want);
            }
}

static void assert_turned(context *c, const bytes *b, const char *kind, int orientation, int tolerance) {
    image_u8 p;
    photo_info info;
    assert_ok(c, image_photo_parse(c, b->data, b->n, &p, &info));
    assert_string_equal(info.kind, kind);
    assert_int_equal(info.orientation, orientation);
    assert_true(info.width == W && info.height == H && p.channels == (info.alpha ? 4 : 3));
    assert_upright(&p, tolerance, kind);
    mem_free(p.data);
    assert_ok(c, image_parse(c, b->data, b->n, 0, &p)); /* the stated size is also the turned one */
    assert_true(p.width == W && p.height == H && !p.data);
    assert_ok(c, image_parse(c, b->data, b->n, IMAGE_MASK, &p));
    assert_true(p.channels == 1 && p.data[0] == 1);
    mem_free(p.data);
}

static void test_turns(void **state) {
    context *c = *state;
    for (int o = 1; o <= 8; o++)
        for (int way = 0; way < 2; way++) {
            bytes jpeg = {0}, png = {0};
            make_jpeg(c, &jpeg, o, way, NULL, 0);
            assert_turned(c, &jpeg, "JPEG", o, 12);
            make_png(c, &png, o, way, way);
            assert_turned(c, &png, "PNG", o, 0);
        }
    bytes jpeg = {0};
    make_jpeg(c, &jpeg, 1, true, NULL, 0);
    jpeg.data[6 + 6 + 8 + 2 + 8 + 1] = 9; /* there is no such orientation */
    assert_turned(c, &jpeg, "JPEG", 1, 12);
}

/* quad.webp is upright, so its orientation turns it away: the first pixel has the colour of the quarter that
 * moves there. */
static void test_webp_turns(void **state) {
    context *c = *state;
    static const int first[9] = {0, 0, 1, 3, 2, 0, 2, 3, 1};
    for (int o = 1; o <= 8; o++)
        for (int prefixed = 0; prefixed < 2; prefixed++) {
            bytes b = {0};
            image_u8 p;
            make_webp(c, &b, o, prefixed);
            assert_ok(c, image_parse(c, b.data, b.n, 3, &p));
            assert_int_equal(p.width, o >= 5 ? H : W);
            assert_memory_equal(p.data, quarter[first[o]], 3);
            mem_free(p.data);
        }
}

/* Made with Debian 12's libheif, cwebp and webpmux: a HEIC with every orientation, AVIF with some. */
static void test_files(void **state) {
    context *c = *state;
    char name[32];
    for (int i = 1; i <= 8 + 3; i++) {
        static const int of_avif[3] = {1, 6, 7};
        bool heic = i <= 8;
        bytes b = {0};
        snprintf(name, sizeof name, "turn%d.%s", heic ? i : of_avif[i - 9], heic ? "heic" : "avif");
        put_file(c, &b, name);
        assert_turned(c, &b, heic ? "HEIC" : "AVIF", 1, 10);
        assert_string_equal(image_file_kind(sample_path(name)), heic ? "HEIC" : "AVIF");
    }
    bytes lossy = {0};
    put_file(c, &lossy, "lossy.webp");
    assert_turned(c, &lossy, "WebP", 1, 12);
}

static void test_alpha(void **state) {
    context *c = *state;
    static const char *const name[] = {"alpha.webp", "alpha.heic", "alpha.avif"};
    for (int i = 0; i < 3; i++) {
        image_u8 p, rgb;
        photo_info info;
        assert_ok(c, image_photo_read(c, sample_path(name[i]), &p, &info));
        assert_true(info.alpha && p.channels == 4);
        assert_upright(&p, i ? 12 : 0, name[i]);
        assert_ok(c, image_read(c, sample_path(name[i]), 3, &rgb));
        assert_int_equal(rgb.channels, 3);
        for (int k = 0; k < 3; k++) assert_int_equal(rgb.data[k], p.data[k]);
        int width, height, channels;
        assert_ok(c, image_size(c, sample_path(name[i]), &width, &height, &channels));
        assert_int_equal(channels, 4);
        mem_free(p.data);
        mem_free(rgb.data);
    }
}

static float focal_of(context *c, int orientation, bool big, const tag *tags, size_t n) {
    bytes b = {0};
    image_u8 p;
    photo_info info;
    make_jpeg(c, &b, orientation, big, tags, n);
    assert_ok(c, image_photo_parse(c, b.data, b.n, &p, &info));
    mem_free(p.data);
    return info.focal_px;
}

static void test_focal_length(void **state) {
    context *c = *state;
    const double diagonal = sqrt(W * W + H * H) / sqrt(36. * 36 + 24 * 24);
    const tag film[] = {{0xa405, 3, 28, 1}};
    const tag film_and_other[] = {{0x920a, 5, 425, 100}, {0xa405, 3, 26, 1}};
    /* 50 mm; the sensor's 240 pixels (here scaled to 24) span 30 mm: 40 pixels of 24 */
    const tag plane[] = {
        {0x920a, 5, 50, 1}, {0xa002, 4, 240, 1}, {0xa003, 3, 160, 1}, {0xa20e, 5, 80, 1}, {0xa210, 3, 3, 1}};
    const tag inches[] = {{0x920a, 5, 50, 1}, {0xa20e, 5, 2032, 10}}; /* 203.2 pixels per inch */
    const tag cut[] = {{0xa002, 4, 240, 1}, {0xa003, 3, 240, 1}, {0xa405, 3, 28, 1}};
    const tag no_sensor[] = {{0x920a, 5, 50, 1}};
    const tag nothing_below[] = {{0x920a, 5, 50, 0}, {0xa20e, 5, 2032, 10}};
    const tag absurd[] = {{0xa405, 3, 60000, 1}};
    for (int way = 0; way < 4; way++) { /* both byte orders, upright and turned */
        int o = way / 2 ? 6 : 1;
        assert_float_equal(focal_of(c, o, way % 2, film, 1), 28 * diagonal, 1e-4);
        assert_float_equal(focal_of(c, o, way % 2, film_and_other, 2), 26 * diagonal, 1e-4);
        assert_float_equal(focal_of(c, o, way % 2, plane, 5), 40, 1e-4);
        assert_float_equal(focal_of(c, o, way % 2, inches, 2), 400, 1e-3);
        assert_float_equal(focal_of(c, o, way % 2, cut, 3), 0, 0);
        assert_float_equal(focal_of(c, o, way % 2, no_sensor, 1), 0, 0);
        assert_float_equal(focal_of(c, o, way % 2, nothing_below, 2), 0, 0);
        assert_float_equal(focal_of(c, o, way % 2, absurd, 1), 0, 0);
        assert_float_equal(focal_of(c, o, way % 2, NULL, 0), 0, 0);
    }
}

/* Every truncation of the data, and every byte of it set to 255: nothing is read beyond the end (the
 * sanitizers would see it). */
static void test_broken_exif(void **state) {
    const tag tags[] = {{0x920a, 5, 50, 1}, {0xa405, 3, 26, 1}};
    exif_facts facts;
    bytes b = {0};
    put_exif(&b, true, 6, tags, 2);
    exif_read(b.data, b.n, &facts);
    assert_true(facts.orientation == 6 && facts.focal_mm == 50 && facts.focal_35mm_mm == 26);
    for (size_t n = 0; n < b.n; n++) {
        uint8_t *copy = malloc(n ? n : 1);
        memcpy(copy, b.data, n);
        exif_read(copy, n, &facts);
        assert_true(facts.orientation >= 1 && facts.orientation <= 8);
        if (n) copy[n - 1] = 255;
        exif_read(copy, n, &facts);
        assert_true(facts.orientation >= 1 && facts.orientation <= 8);
        free(copy);
    }
}

static void test_names(void **state) {
    context *c = *state;
    static const struct {
        const char *bytes;
        size_t n;
        const char *said;
    } kinds[] = {
#define KIND(bytes, said) {bytes, sizeof(bytes) - 1, said}
        KIND("", "an empty file; PNG"),
        KIND("GIF89a\1\0\1\0", "a GIF; PNG"),
        KIND("II*\0\x08\0\0\0\0\0\0\0", "a TIFF, or a camera's RAW;"),
        KIND("MM\0*\0\0\0\x08\0\0\0\0", "a TIFF, or a camera's RAW;"),
        KIND("II*\0\x10\0\0\0CR\2\0", "a camera's RAW (CR2);"),
        KIND("\0\0\0\x18"
             "ftypcrx \0\0\0\1crx isom",
             "a camera's RAW (CR3);"),
        KIND("FUJIFILMCCD-RAW 0201", "a camera's RAW (RAF);"),
        KIND("BM\x36\0\1\0\0\0\0\0\x36\0\0\0", "a BMP;"),
        KIND("%PDF-1.7\n", "a PDF;"),
        KIND("<?xml version='1.0'?>\n<svg xmlns='http://www.w3.org/2000/svg'/>", "an SVG drawing;"),
        KIND("\n <SVG width='3'/>", "an SVG drawing;"),
        KIND("<!DOCTYPE html><html>404</html>", "a web page (HTML)"),
        KIND("\xef\xbb\xbf<html>", "a web page (HTML)"),
        KIND("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 3\n", "Git LFS pointer"),
        KIND("\0\0\0\x20"
             "ftypisom\0\0\2\0isomiso2avc1mp41",
             "a video (MP4 or MOV);"),
        KIND("RIFF\x24\0\0\0AVI LIST", "a video (AVI);"),
        KIND("\x1a\x45\xdf\xa3\1\0\0\0", "a video (WebM or Matroska);"),
        KIND("PK\3\4\x14\0", "a ZIP archive;"),
        KIND("P6\n3 3\n255\n", "a PBM, PGM or PPM;"),
        KIND("hello\n", "a text;"),
        KIND("\0\0\0\0\0\0", "nothing but zeros"),
        KIND("\x13\x37\xfe\1\2", "not a known picture;"),
        KIND("RIFF\x24\0\0\0WEBPVP8 ", "WebP: "),
        KIND("\0\0\0\x18"
             "ftypheic\0\0\0\0mif1heic",
             "HEIC: "),
        KIND("\0\0\0\x18"
             "ftypmif1\0\0\0\0mif1avif",
             "AVIF: "),
    };
    for (size_t i = 0; i < COUNT_OF(kinds); i++) {
        image_u8 p;
        sherf_status status = image_parse(c, (const unsigned char *)kinds[i].bytes, kinds[i].n, 3, &p);
        if (status == SHERF_OK || !strstr(c->message, kinds[i].said) || strchr(c->message, '\n'))
            fail_msg("not \"%s\": %s", kinds[i].said, c->message);
        assert_null(p.data);
    }
    image_u8 p;
    assert_int_equal(image_read(c, sample_path("moving.webp"), 3, &p), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "moving.webp: a moving WebP"));
}

/* A file truncated anywhere is refused with a reason, or read if only parts after the pixels are missing. */
static void test_cut_off(void **state) {
    context *c = *state;
    static const char *const name[] = {"quad.webp", "alpha.webp", "turn6.heic", "alpha.avif"};
    for (size_t i = 0; i < COUNT_OF(name); i++) {
        bytes b = {0};
        put_file(c, &b, name[i]);
        for (size_t n = 0; n < b.n; n += 1 + b.n / 60) {
            image_u8 p;
            uint8_t *copy = malloc(n ? n : 1);
            memcpy(copy, b.data, n);
            c->message[0] = 0;
            if (image_parse(c, copy, n, 4, &p) == SHERF_OK)
                mem_free(p.data);
            else
                assert_true(c->message[0] && !strchr(c->message, '\n') && !p.data);
            free(copy);
        }
    }
}

static void test_without_memory(void **state) {
    context *c = *state;
    static const char *const name[] = {"quad.webp", "alpha.webp", "turn6.heic", "alpha.avif"};
    for (size_t i = 0; i < COUNT_OF(name); i++)
        for (long n = 0;; n++) {
            image_u8 p;
            photo_info info;
            size_t live = mem_live();
            long before = mem_count();
            mem_fail_after(n);
            sherf_status status = image_photo_read(c, sample_path(name[i]), &p, &info);
            mem_fail_after(-1);
            mem_free(p.data);
            assert_int_equal(mem_live(), live);
            if (mem_count() - before <= n) break;
            assert_int_equal(status, SHERF_NO_MEMORY);
        }
}

/* ---- colour profiles ---- */

/* Display P3 to sRGB with the published matrix; both have sRGB's curve. */
static int from_p3(const uint8_t *p, int k) {
    static const double m[3][3] = {{1.2249, -0.2247, 0}, {-0.0420, 1.0419, 0}, {-0.0197, -0.0786, 1.0979}};
    double sum = 0;
    for (int i = 0; i < 3; i++) {
        const double v = p[i] / 255.;
        sum += m[k][i] * (v > 0.04045 ? pow((v + 0.055) / 1.055, 2.4) : v / 12.92);
    }
    sum = sum < 0 ? 0 : sum > 1 ? 1 : sum;
    return (int)lrint(255 * (sum > 0.0031308 ? 1.055 * pow(sum, 1 / 2.4) - 0.055 : 12.92 * sum));
}

/* An ICC profile with sRGB's curve and the given red and green. */
static void make_profile(bytes *b, const double red[2], const double green[2]) {
    const cmsCIExyY white = {0.3127, 0.3290, 1};
    const cmsCIExyYTRIPLE primaries = {{red[0], red[1], 1}, {green[0], green[1], 1}, {0.15, 0.06, 1}};
    const double srgb[] = {2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045};
    cmsToneCurve *curve = cmsBuildParametricToneCurve(NULL, 4, srgb), *curves[] = {curve, curve, curve};
    cmsHPROFILE profile = cmsCreateRGBProfile(&white, &primaries, curves);
    cmsUInt32Number n = 0;
    assert_true(cmsSaveProfileToMem(profile, NULL, &n) && n <= sizeof b->data);
    assert_true(cmsSaveProfileToMem(profile, b->data, &n));
    b->n = n;
    cmsCloseProfile(profile);
    cmsFreeToneCurve(curve);
}

static void jpeg_with(context *c, bytes *b, const bytes *profile) {
    uint8_t rgb[W * H * 3], *data;
    int width, height;
    size_t length;
    stored(1, 3, &width, &height, rgb);
    assert_ok(c, jpeg_to_memory(c, W, H, rgb, 98, &data, &length));
    put(b, "\xff\xd8\xff\xe2", 4);
    put_number(b, (uint32_t)profile->n + 16, 2, true);
    put(b, "ICC_PROFILE\0\1\1", 14);
    put(b, profile->data, profile->n);
    put(b, data + 2, length - 2);
    mem_free(data);
}

static void png_with(context *c, bytes *b, const bytes *profile) {
    uint8_t rgba[W * H * 4], *data;
    int width, height;
    size_t length;
    uLongf packed = 3000;
    bytes chunk = {0};
    put(&chunk, "iCCPx\0", 7);
    assert_int_equal(compress(chunk.data + chunk.n, &packed, profile->data, profile->n), Z_OK);
    chunk.n += packed;
    stored(1, 4, &width, &height, rgba);
    assert_ok(c, png_to_memory(c, W, H, 4, rgba, 6, &data, &length));
    put(b, data, 8 + 25);
    put_number(b, (uint32_t)chunk.n - 4, 4, true);
    put(b, chunk.data, chunk.n);
    put_number(b, (uint32_t)crc32(0, chunk.data, (uInt)chunk.n), 4, true);
    put(b, data + 8 + 25, length - 8 - 25);
    mem_free(data);
}

static void webp_with(context *c, bytes *b, const bytes *profile) {
    bytes plain = {0};
    put_file(c, &plain, "quad.webp");
    const uint32_t padded = (uint32_t)(profile->n + profile->n % 2);
    put(b, "RIFF", 4);
    put_number(b, (uint32_t)(4 + 18 + 8 + padded + plain.n - 12), 4, false);
    put(b, "WEBPVP8X", 8);
    put_number(b, 10, 4, false);
    put_number(b, 32, 4, false);
    put_number(b, W - 1, 3, false);
    put_number(b, H - 1, 3, false);
    put(b, "ICCP", 4);
    put_number(b, (uint32_t)profile->n, 4, false);
    put(b, profile->data, profile->n);
    if (profile->n % 2) put(b, "", 1);
    put(b, plain.data + 12, plain.n - 12);
}

/* turn1.avif with a different code for its primaries. */
static void avif_with(context *c, bytes *b, int primaries) {
    put_file(c, b, "turn1.avif");
    for (size_t i = 0; i + 6 < b->n; i++)
        if (!memcmp(b->data + i, "nclx", 4)) {
            b->data[i + 4] = 0, b->data[i + 5] = (uint8_t)primaries;
            return;
        }
    fail_msg("no nclx");
}

static void assert_colours(context *c, const bytes *b, profile_fate fate, int tolerance) {
    image_u8 p, other, plain;
    photo_info info;
    c->threads = 1;
    assert_ok(c, image_photo_parse(c, b->data, b->n, &p, &info));
    c->threads = 2;
    assert_ok(c, image_photo_parse(c, b->data, b->n, &other, &info));
    assert_ok(c, image_parse(c, b->data, b->n, p.channels,
                             &plain)); /* not read as a photo: colours stay as in the file */
    assert_memory_equal(p.data, other.data, (size_t)(W * H * p.channels));
    assert_int_equal(info.profile, fate);
    for (int y = 2; y < H; y += 11)
        for (int x = 2; x < W; x += 19)
            for (int k = 0; k < p.channels; k++) {
                const size_t at = (size_t)((y * W + x) * p.channels + k);
                const uint8_t *own = plain.data + at - k;
                const int want = k < 3 && fate == PROFILE_TAKEN ? from_p3(own, k) : own[k];
                if (abs(p.data[at] - want) > tolerance)
                    fail_msg("%s, channel %d: %d, not %d", info.kind, k, p.data[at], want);
            }
    assert_int_equal(abs(p.data[0] - plain.data[0]) > 10, fate == PROFILE_TAKEN);
    mem_free(p.data);
    mem_free(other.data);
    mem_free(plain.data);
}

static void test_profiles(void **state) {
    static void (*const make[])(context *, bytes *, const bytes *) = {jpeg_with, png_with, webp_with};
    static const double p3[2][2] = {{0.680, 0.320}, {0.265, 0.690}}, srgb[2][2] = {{0.64, 0.33}, {0.3, 0.6}};
    context *c = *state;
    for (size_t i = 0; i < COUNT_OF(make); i++) {
        bytes wide = {0}, usual = {0}, broken, file = {0};
        make_profile(&wide, p3[0], p3[1]);
        make[i](c, &file, &wide);
        assert_colours(c, &file, PROFILE_TAKEN, 2);
        make_profile(&usual, srgb[0], srgb[1]);
        file.n = 0;
        make[i](c, &file, &usual);
        assert_colours(c, &file, PROFILE_NONE, 0);
        if (make[i] == png_with) continue; /* libpng drops a broken profile itself */
        broken = wide;
        memset(broken.data + 128, 255, 200); /* the number of tags and their positions */
        file.n = 0;
        make[i](c, &file, &broken);
        assert_colours(c, &file, PROFILE_BROKEN, 0);
    }
    for (int primaries = 1; primaries <= 12; primaries += 11) {
        bytes file = {0};
        avif_with(c, &file, primaries);
        assert_colours(c, &file, primaries == 12 ? PROFILE_TAKEN : PROFILE_NONE, primaries == 12 ? 2 : 0);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_turns),          cmocka_unit_test(test_webp_turns),
        cmocka_unit_test(test_files),          cmocka_unit_test(test_alpha),
        cmocka_unit_test(test_focal_length),   cmocka_unit_test(test_broken_exif),
        cmocka_unit_test(test_names),          cmocka_unit_test(test_cut_off),
        cmocka_unit_test(test_without_memory), cmocka_unit_test(test_profiles)};
    return cmocka_run_group_tests(tests, test_open, test_close);
}
