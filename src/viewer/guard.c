/* Checks who may send requests: the token in the address, the Host line, the Origin. A page of another site
 * can make a browser send requests here, so a loopback address alone is no protection. */
#include <arpa/inet.h>
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <sys/random.h>

#include "viewer/viewer.h"

sherf_status token_make(context *c, char out[VIEWER_TOKEN + 1]) {
    unsigned char bytes[VIEWER_TOKEN / 2];
    ssize_t n;
    do n = getrandom(bytes, sizeof bytes, 0);
    while (n < 0 && errno == EINTR);
    if (n != (ssize_t)sizeof bytes)
        return failure(c, SHERF_UNSUPPORTED, "viewer: the system gives no random numbers");
    for (size_t i = 0; i < sizeof bytes; i++) snprintf(out + 2 * i, 3, "%02x", bytes[i]);
    return SHERF_OK;
}

bool token_matches(const char token[VIEWER_TOKEN + 1], const char *path, const char **rest) {
    char given[VIEWER_TOKEN + 1] = {0};
    size_t length = strlen(path);
    *rest = NULL;
    if (path[0] == '/') memcpy(given, path + 1, length - 1 < VIEWER_TOKEN ? length - 1 : VIEWER_TOKEN);
    unsigned difference = 0;
    for (int i = 0; i < VIEWER_TOKEN; i++) difference |= (unsigned char)(given[i] ^ token[i]);
    if (difference || length < 1 + VIEWER_TOKEN) return false;
    *rest = path + 1 + VIEWER_TOKEN;
    return **rest == 0 || **rest == '/';
}

/* ":PORT" or empty. */
static bool port_is_fine(const char *p) {
    if (!*p) return true;
    if (*p++ != ':') return false;
    size_t digits = strspn(p, "0123456789");
    return digits >= 1 && digits <= 5 && !p[digits];
}

bool host_is_allowed(const char *host) {
    char name[64];
    unsigned char address[16];
    if (!host || strlen(host) >= sizeof name) return false;
    snprintf(name, sizeof name, "%s", host);
    if (name[0] == '[') {
        char *end = strchr(name, ']');
        if (!end || !port_is_fine(end + 1)) return false;
        *end = 0;
        return inet_pton(AF_INET6, name + 1, address) == 1;
    }
    size_t length = strcspn(name, ":");
    if (!port_is_fine(name + length)) return false;
    name[length] = 0;
    return strcasecmp(name, "localhost") == 0 || inet_pton(AF_INET, name, address) == 1;
}

bool origin_is_allowed(const char *origin, const char *host) {
    static const char scheme[] = "http://";
    if (!origin) return true;
    return host && strncmp(origin, scheme, sizeof scheme - 1) == 0 &&
           strcasecmp(origin + sizeof scheme - 1, host) == 0;
}
