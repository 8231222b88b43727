/* json: copies cJSON's tree into ours. cJSON reads NaN as a name, accepts 1e999 as infinity, recurses into
 * nesting and ignores text after the value; all of this is checked here. */
#include <cjson/cJSON.h>
#include <math.h>
#include <string.h>

#include "base/path.h"
#include "io/build.h"
#include "io/image.h"
#include "io/utf16.h"

/* cJSON takes up to 30 bytes for each byte of text. Its memory is its own: its hooks belong to the whole
 * process. */
static const size_t json_bytes_max = (size_t)64 << 20;
enum { JSON_NESTING = 128 };

/* The deepest nesting of brackets outside strings; also refuses a 0 byte and bare control characters, which
 * cJSON would accept. */
static bool scan(builder *b, const char *text, size_t bytes) {
    int depth = 0;
    bool quoted = false;
    for (size_t i = 0; i < bytes; i++) {
        unsigned char ch = (unsigned char)text[i];
        if (!ch || (quoted && ch < 0x20)) {
            build_fail(b, SHERF_BAD_FILE, "JSON: a control character at byte %zu", i);
            return false;
        }
        if (quoted) {
            if (ch == '\\')
                i++;
            else if (ch == '"')
                quoted = false;
        } else if (ch == '"')
            quoted = true;
        else if ((ch == '[' || ch == '{') && ++depth > JSON_NESTING) {
            build_fail(b, SHERF_BAD_FILE, "JSON: nested deeper than %d", JSON_NESTING);
            return false;
        } else if ((ch == ']' || ch == '}') && depth > 0)
            depth--;
    }
    return true;
}

static value *number(builder *b, double x) {
    if (!isfinite(x)) return build_fail(b, SHERF_BAD_FILE, "JSON: a number that is not finite");
    if (x == floor(x) && fabs(x) <= 9007199254740992.0) return build_integer(b, (int64_t)x);
    return build_real(b, x);
}

/* Nesting is at most JSON_NESTING here. */
static value *tree(builder *b, const cJSON *j) {
    if (cJSON_IsNull(j)) return build_none(b);
    if (cJSON_IsBool(j)) return build_bool(b, cJSON_IsTrue(j));
    if (cJSON_IsNumber(j)) return number(b, j->valuedouble);
    if (cJSON_IsString(j)) return build_string(b, j->valuestring, strlen(j->valuestring));
    if (!cJSON_IsArray(j) && !cJSON_IsObject(j)) return build_fail(b, SHERF_BAD_FILE, "JSON: unknown item");
    bool dict = cJSON_IsObject(j);
    value *v = build_value(b, dict ? VALUE_DICT : VALUE_LIST);
    for (const cJSON *child = j->child; child && v; child = child->next) {
        value *item = tree(b, child);
        if (dict ? !build_pair(b, v, build_string(b, child->string, strlen(child->string)), item)
                 : !build_append(b, v, item))
            return NULL;
    }
    return v;
}

/* Refuses the text where parsing stopped; the message names NaN and Infinity, which Python writes. */
static value *refuse(builder *b, const char *text, size_t bytes, size_t at) {
    static const char *const not_finite[] = {"NaN", "Infinity", "nan", "inf"};
    const size_t sign = at < bytes && text[at] == '-';
    for (size_t i = 0; i < COUNT_OF(not_finite); i++) {
        const size_t n = strlen(not_finite[i]);
        if (at + sign + n <= bytes && !memcmp(text + at + sign, not_finite[i], n))
            return build_fail(b, SHERF_BAD_FILE, "a number that is not finite (%s), at byte %zu",
                              not_finite[i], at);
    }
    return build_fail(b, SHERF_BAD_FILE, "not JSON, near byte %zu", at);
}

static value *parse(builder *b, const char *text, size_t bytes) {
    if (bytes > json_bytes_max)
        return build_fail(b, SHERF_BAD_FILE, "JSON: %zu bytes, more than the %zu allowed", bytes,
                          json_bytes_max);
    if (!scan(b, text, bytes)) return NULL;
    const char *end = NULL;
    cJSON *j = cJSON_ParseWithLengthOpts(text, bytes, &end, 0);
    if (!j) return refuse(b, text, bytes, end ? (size_t)(end - text) : 0);
    value *v = NULL;
    size_t rest = (size_t)(end - text);
    while (rest < bytes && strchr(" \t\r\n", text[rest])) rest++;
    if (rest < bytes)
        build_fail(b, SHERF_BAD_FILE, "JSON: something follows it at byte %zu%s", rest,
                   text[rest] == *text ? ": if each line is one value, make one list of them, [..., ...]"
                                       : "");
    else
        v = tree(b, j);
    cJSON_Delete(j);
    return v;
}

static sherf_status parse_narrow(context *c, const char *text, size_t bytes, document **out) {
    builder b;
    /* our values take about 150 bytes, a number in the text as few as two */
    if (!build_start(&b, c, ((size_t)64 << 20) + (bytes < SIZE_MAX / 512 ? bytes * 128 : 0))) return b.status;
    return build_finish(&b, parse(&b, text, bytes), out);
}

sherf_status json_parse(context *c, const char *text, size_t bytes, document **out) {
    unsigned char *narrow;
    size_t length;
    *out = NULL;
    if (!utf16_is((const unsigned char *)text, bytes)) return parse_narrow(c, text, bytes, out);
    if (bytes > json_bytes_max) return failure(c, SHERF_BAD_FILE, "JSON: %zu bytes, too many", bytes);
    sherf_status status = utf16_narrow(c, (const unsigned char *)text, bytes, &narrow, &length);
    if (!status) status = parse_narrow(c, (const char *)narrow, length, out);
    mem_free(narrow);
    return status;
}

sherf_status json_read(context *c, const char *path, document **out) {
    unsigned char *data;
    size_t bytes;
    *out = NULL;
    sherf_status status = file_read(c, path, json_bytes_max, &data, &bytes);
    if (status != SHERF_OK) return status;
    status = json_parse(c, (const char *)data, bytes, out);
    if (status == SHERF_BAD_FILE && bytes && *data != '{' && *data != '[') image_other_name(c, data, bytes);
    mem_free(data);
    return status == SHERF_OK ? status : failure_prefix(c, status, "%s", path);
}
