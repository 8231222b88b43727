/* Fuzz target: requests to the viewer from a browser or anybody else. Host, origin, path and the fields of a
 * query are on one line each. */
#include <string.h>

#include "fuzz.h"
#include "viewer/viewer.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const char token[VIEWER_TOKEN + 1] = "0123456789abcdef0123456789abcdef";
    char *text = malloc(size + 1), *rest = text;
    const char *behind, *line[3];
    viewer_query q;
    memcpy(text, data, size);
    text[size] = 0;
    for (int i = 0; i < 3; i++) {
        line[i] = strsep(&rest, "\n");
        if (!line[i]) line[i] = "";
    }
    bool host = host_is_allowed(line[0]);
    if (host && strlen(line[0]) > 64) abort();
    origin_is_allowed(line[1], line[0]);
    if (token_matches(token, line[2], &behind) && (strncmp(line[2] + 1, token, VIEWER_TOKEN) || !behind))
        abort();
    query_start(&q);
    for (char *field; (field = strsep(&rest, "\n"));) {
        char *name = strsep(&field, "=");
        if (!query_take(&q, name, field)) break;
    }
    if (q.request.width < VIEWER_SIDE_MIN || q.request.width > 2 * VIEWER_SIDE_MAX || !(q.request.zoom > 0) ||
        !(q.request.azimuth_rad > -1e4f && q.request.azimuth_rad < 1e4f) || strlen(q.client) > VIEWER_NAME)
        abort();
    free(text);
    return 0;
}
