/* Recognises an output by its name: a picture, a video, or a folder of pictures. */
#include <ctype.h>
#include <string.h>

#include "base/path.h"

static const char *const pictures[] = {".png", ".jpg", ".jpeg", ".webp"};
static const char *const videos[] = {".mp4", ".webm", ".mov", ".gif"};

static bool ends_with_one(const char *path, const char *const *endings, size_t count) {
    for (size_t i = 0; i < count; i++)
        if (path_ends(path, endings[i])) return true;
    return false;
}

/* Whether a name ends like a file's: a point, and up to five letters and digits that are not all digits. */
static bool looks_like_a_file(const char *path) {
    const char *slash = strrchr(path, '/'), *name = slash ? slash + 1 : path, *point = strrchr(name, '.');
    bool letter = false;
    if (!point || point == name || !point[1] || strlen(point + 1) > 5) return false;
    for (const char *p = point + 1; *p; p++) {
        if (!isalnum((unsigned char)*p)) return false;
        letter |= isalpha((unsigned char)*p) != 0;
    }
    return letter;
}

sherf_output sherf_output_kind(const char *path) {
    if (ends_with_one(path, pictures, COUNT_OF(pictures))) return SHERF_OUTPUT_PICTURE;
    if (ends_with_one(path, videos, COUNT_OF(videos))) return SHERF_OUTPUT_VIDEO;
    return looks_like_a_file(path) && !path_is_folder(path) ? SHERF_OUTPUT_UNKNOWN : SHERF_OUTPUT_FOLDER;
}

int sherf_output_has_alpha(const char *path) {
    return !path_ends(path, ".mp4") && !path_ends(path, ".jpg") && !path_ends(path, ".jpeg");
}
