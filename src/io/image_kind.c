/* image: recognises a file's kind by its first bytes: the supported kinds, and files that people mistake for
 * pictures, which the error message then names. */
#include <ctype.h>
#include <stdio.h>
#include <string.h>

#include "io/image.h"

typedef struct {
    size_t at;
    const char *bytes;
    size_t count;
    const char *name;
} sign;
#define SIGN(at, bytes, name)                                                                                \
    { at, bytes, sizeof(bytes) - 1, name }

static bool shows(const unsigned char *data, size_t n, const sign *s) {
    return n >= s->at + s->count && !memcmp(data + s->at, s->bytes, s->count);
}

/* Brands identify ISO's containers: the first one, then those that it claims to be compatible with. */
static bool has_brand(const unsigned char *data, size_t n, const char *const *brand) {
    size_t end = (size_t)data[0] << 24 | (size_t)data[1] << 16 | (size_t)data[2] << 8 | data[3];
    if (end > n) end = n;
    for (size_t at = 8; at + 4 <= end; at += at == 8 ? 8 : 4)
        for (size_t i = 0; brand[i]; i++)
            if (!memcmp(data + at, brand[i], 4)) return true;
    return false;
}

static const char *iso_kind(const unsigned char *data, size_t n) {
    static const char *const avif[] = {"avif", "avis", NULL};
    static const char *const heic[] = {"heic", "heix", "heim", "heis", "hevc", "hevx", "mif1", "msf1", NULL};
    if (has_brand(data, n, avif)) return "AVIF";
    return has_brand(data, n, heic) ? "HEIC" : NULL;
}

const char *image_kind(const unsigned char *data, size_t n) {
    static const sign signs[] = {SIGN(0, "\x89PNG\r\n\x1a\n", "PNG"), SIGN(0, "\xff\xd8\xff", "JPEG")};
    static const sign riff = SIGN(0, "RIFF", ""), webp = SIGN(8, "WEBP", ""), iso = SIGN(4, "ftyp", "");
    for (size_t i = 0; i < COUNT_OF(signs); i++)
        if (shows(data, n, &signs[i])) return signs[i].name;
    if (shows(data, n, &riff) && shows(data, n, &webp)) return "WebP";
    return n >= 12 && shows(data, n, &iso) ? iso_kind(data, n) : NULL;
}

const char *image_file_kind(const char *path) {
    unsigned char start[IMAGE_KIND_BYTES];
    FILE *f = fopen(path, "rb");
    size_t n = f ? fread(start, 1, sizeof start, f) : 0;
    if (f) fclose(f);
    return image_kind(start, n);
}

/* Whether the text's first word with "<" or a known beginning matches, ignoring case. */
static bool text_starts(const unsigned char *data, size_t n, const char *word) {
    size_t at = n >= 3 && !memcmp(data, "\xef\xbb\xbf", 3) ? 3 : 0;
    while (at < n && isspace(data[at])) at++;
    for (; *word; word++, at++)
        if (at >= n || tolower(data[at]) != *word) return false;
    return true;
}

static bool text_has(const unsigned char *data, size_t n, const char *word) {
    size_t count = strlen(word);
    for (size_t at = 0; at + count <= n; at++)
        if (!memcmp(data + at, word, count)) return true;
    return false;
}

static const char *text_kind(const unsigned char *data, size_t n) {
    size_t start = n < 1024 ? n : 1024;
    if (text_starts(data, n, "version https://git-lfs"))
        return "a Git LFS pointer: the file itself was not fetched (git lfs pull)";
    if (text_starts(data, n, "<svg") || (text_starts(data, n, "<?xml") && text_has(data, start, "<svg")))
        return "an SVG drawing";
    if (text_starts(data, n, "<!doctype html") || text_starts(data, n, "<html") ||
        text_starts(data, n, "<head"))
        return "a web page (HTML), not the file it offers";
    if (text_starts(data, n, "<?xml")) return "an XML text";
    for (size_t i = 0; i < start; i++)
        if (data[i] < 9 || (data[i] > 13 && data[i] < 32) || data[i] == 127) return NULL;
    return "a text";
}

const char *image_other_kind(const unsigned char *data, size_t n) {
    static const sign signs[] = {
        SIGN(0, "GIF8", "a GIF"),
        SIGN(0, "II*\0", "a TIFF, or a camera's RAW"),
        SIGN(0, "MM\0*", "a TIFF, or a camera's RAW"),
        SIGN(0, "II+\0", "a TIFF"),
        SIGN(0, "MM\0+", "a TIFF"),
        SIGN(0, "FUJIFILMCCD-RAW", "a camera's RAW (RAF)"),
        SIGN(0, "IIRO", "a camera's RAW (ORF)"),
        SIGN(0, "IIRS", "a camera's RAW (ORF)"),
        SIGN(0, "IIU\0", "a camera's RAW (RW2)"),
        SIGN(0, "FOVb", "a camera's RAW (X3F)"),
        SIGN(4, "ftypcrx", "a camera's RAW (CR3)"),
        SIGN(0, "%PDF", "a PDF"),
        SIGN(0, "%!PS", "a PostScript file"),
        SIGN(0, "\0\0\0\x0cJXL ", "a JPEG XL"),
        SIGN(0, "\xff\x0a", "a JPEG XL"),
        SIGN(0, "\0\0\0\x0cjP  ", "a JPEG 2000"),
        SIGN(0, "\xff\x4f\xff\x51", "a JPEG 2000"),
        SIGN(0, "8BPS", "a Photoshop file"),
        SIGN(0, "gimp xcf", "a GIMP file"),
        SIGN(0, "v/1\x01", "an OpenEXR"),
        SIGN(0, "#?RADIANCE", "a Radiance HDR"),
        SIGN(0, "\0\0\1\0", "an icon"),
        SIGN(8, "AVI ", "a video (AVI)"),
        SIGN(4, "ftyp", "a video (MP4 or MOV)"),
        SIGN(4, "moov", "a video (MOV)"),
        SIGN(4, "mdat", "a video (MOV)"),
        SIGN(0, "\x1a\x45\xdf\xa3", "a video (WebM or Matroska)"),
        SIGN(0, "FLV\x01", "a video (FLV)"),
        SIGN(0, "OggS", "a video or sound (Ogg)"),
        SIGN(0, "\0\0\1\xba", "a video (MPEG)"),
        SIGN(0, "\0\0\1\xb3", "a video (MPEG)"),
        SIGN(0, "PK\3\4", "a ZIP archive"),
        SIGN(0, "\x1f\x8b", "a gzip archive"),
        SIGN(0, "7z\xbc\xaf\x27\x1c", "a 7z archive: unpack it"),
        SIGN(0, "Rar!\x1a\x07", "a RAR archive: unpack it"),
        SIGN(257, "ustar", "a tar archive: unpack it"),
        SIGN(0, "\x89HDF\r\n\x1a\n", "an HDF5 file (or MATLAB's of 7.3): export its arrays as .npz"),
        SIGN(0, "MATLAB 5.0", "a MATLAB file: export its arrays as .npz"),
        SIGN(0, "PAR1", "a Parquet table"),
        SIGN(0, "PXR-USDC", "a USD scene: export it as BVH, FBX or GLB"),
        SIGN(0, "Ogawa", "an Alembic scene: export it as BVH, FBX or GLB"),
        SIGN(0, "glTF", "a GLB, of which sherf animate reads the animation"),
        SIGN(0, "Kaydara FBX", "an FBX, of which sherf animate reads the animation"),
        SIGN(0, "BLENDER", "a Blender file: export it as BVH, FBX or GLB"),
        SIGN(0, "Vocaloid Motion Data", "a motion of MikuMikuDance (VMD): export it as BVH, FBX or GLB"),
        SIGN(0, "\x02P", "a C3D of markers, which has no joints: fit a body to it first"),
    };
    if (!n) return "an empty file";
    if (n > 10 && !memcmp(data, "II*\0", 4) && !memcmp(data + 8, "CR", 2)) return "a camera's RAW (CR2)";
    for (size_t i = 0; i < COUNT_OF(signs); i++)
        if (shows(data, n, &signs[i])) return signs[i].name;
    if (n > 6 && !memcmp(data, "BM", 2) && !data[5] && !memcmp(data + 6, "\0\0\0\0", n < 10 ? n - 6 : 4))
        return "a BMP";
    if (n > 3 && data[0] == 'P' && data[1] >= '1' && data[1] <= '7' && isspace(data[2]))
        return "a PBM, PGM or PPM";
    size_t i = 0;
    while (i < n && !data[i]) i++;
    if (i == n) return "nothing but zeros, as a copy that broke off leaves";
    return text_kind(data, n);
}

/* A pickle of protocol 0 is text: a mark, a class on its own line, a number or a quoted string. */
static bool pickle_text_is(const unsigned char *data, size_t n) {
    if (n < 2 || strchr("}])N", data[0])) return true;
    if (data[0] == '(') return strchr("(dltcIFLNSV", data[1]) != NULL;
    if (data[0] == 'S') return data[1] == '\'' || data[1] == '"';
    if (strchr("IFL", data[0])) return isdigit(data[1]) || data[1] == '-';
    size_t i = data[0] == 'c';
    while (i && i < n && (isalnum(data[i]) || data[i] == '.' || data[i] == '_')) i++;
    return i > 1 && i < n && (data[i] == '\n' || data[i] == '\r');
}

/* Writes a text's first words; unprintable characters become '?'. */
static void text_beginning(const unsigned char *data, size_t n, char *out, size_t room) {
    size_t from = 0, k = 0;
    while (from < n && isspace(data[from])) from++;
    for (; from < n && data[from] != '\n' && data[from] != '\r' && k + 1 < room; from++)
        out[k++] = data[from] < 32 || data[from] > 126 ? '?' : (char)data[from];
    out[k] = 0;
}

void image_other_name(context *c, const unsigned char *data, size_t bytes) {
    const size_t n = bytes < IMAGE_KIND_BYTES ? bytes : IMAGE_KIND_BYTES;
    const char *picture = image_kind(data, n), *other = image_other_kind(data, n);
    const bool text = other && !strcmp(other, "a text");
    char begins[41];
    if (picture) {
        failure(c, SHERF_BAD_FILE, "a picture (%s), where a file of numbers should be", picture);
    } else if (other && !text) { /* some names say already what to do */
        const bool advice = strpbrk(other, ":,") != NULL;
        failure(c, SHERF_BAD_FILE, "%s%s", other, advice ? "" : ", where a file of numbers should be");
    } else if (text && !pickle_text_is(data, n)) {
        text_beginning(data, n, begins, sizeof begins);
        failure(c, SHERF_BAD_FILE, "a text that is neither JSON nor a pickle; it begins \"%s\"", begins);
    }
}
