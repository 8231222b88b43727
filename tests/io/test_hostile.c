/* Tests of damaged input to every reader: truncated at every length, bytes changed, out of memory at every
 * allocation. A reader may succeed or fail, but may not crash, leak, or fail without a message. */
#include <dirent.h>

#include "sample.h"

enum { SAMPLES_MAX = 128, CHANGES = 400 };

typedef struct {
    char name[128];
    unsigned char *data;
    size_t bytes;
} sample;
static sample samples[SAMPLES_MAX];
static int sample_count;

static bool is_picture(const sample *s) {
    return path_ends(s->name, ".png") || path_ends(s->name, ".jpg");
}

/* Reads from memory once and frees the result. */
static sherf_status attempt(context *c, const sample *s, const unsigned char *data, size_t bytes) {
    c->message[0] = 0;
    if (is_picture(s)) {
        image_u8 picture;
        sherf_status status = image_parse(c, data, bytes, 3, &picture);
        if (status != SHERF_OK) assert_null(picture.data);
        mem_free(picture.data);
        return status;
    }
    document *d = (document *)1;
    sherf_status status = document_parse(c, data, bytes, &d, NULL);
    if (status != SHERF_OK) assert_null(d);
    document_free(d);
    return status;
}

static void check_attempt(context *c, const sample *s, const unsigned char *data, size_t bytes,
                          const char *what, size_t at) {
    size_t live = mem_live();
    sherf_status status = attempt(c, s, data, bytes);
    if (mem_live() != live) fail_msg("%s, %s %zu: leaks", s->name, what, at);
    if (status != SHERF_OK && !c->message[0]) fail_msg("%s, %s %zu: no message", s->name, what, at);
    if (strchr(c->message, '\n')) fail_msg("%s, %s %zu: more than a line", s->name, what, at);
}

/* Steps through long files: every byte near the ends, some in the middle. */
static void test_cut(void **state) {
    context *c = *state;
    for (int i = 0; i < sample_count; i++) {
        sample *s = &samples[i];
        for (size_t n = 0; n < s->bytes; n += n < 700 || n + 300 > s->bytes ? 1 : 13) {
            unsigned char *cut =
                malloc(n + 1); /* in its own block, so that the sanitizer sees one byte too far */
            memcpy(cut, s->data, n);
            cut[n] = 0;
            check_attempt(c, s, cut, n, "cut at", n);
            free(cut);
        }
    }
}

static void test_cut_is_refused(void **state) {
    context *c = *state;
    for (int i = 0; i < sample_count; i++) {
        sample *s = &samples[i];
        assert_ok(c, attempt(c, s, s->data, s->bytes));
        if (path_ends(s->name, ".json")) continue; /* its last byte is a line feed */
        if (attempt(c, s, s->data, s->bytes - 3) == SHERF_OK)
            fail_msg("%s: accepted without its end", s->name);
    }
}

static void test_changed(void **state) {
    context *c = *state;
    for (int i = 0; i < sample_count; i++) {
        sample *s = &samples[i];
        uint64_t key = random_key(1, s->name, 0);
        for (uint64_t k = 0; k < CHANGES; k++) {
            size_t at[3];
            unsigned char old[3];
            int changes = 1 + (int)(k % 3);
            for (int n = 0; n < changes; n++) {
                uint64_t draw = k * 8 + (uint64_t)n * 2;
                /* half of them near the beginning, where the structure is */
                int64_t reach = k % 2 && s->bytes > 400 ? 400 : (int64_t)s->bytes;
                at[n] = (size_t)random_below(key, draw, reach);
                old[n] = s->data[at[n]];
                int64_t r = random_below(key, draw + 1, 11);
                s->data[at[n]] = r < 8    ? (unsigned char)(old[n] ^ 1u << r)
                                 : r == 8 ? 0xff
                                 : r == 9 ? 0
                                          : 0x7f;
            }
            check_attempt(c, s, s->data, s->bytes, "change", (size_t)k);
            for (int n = changes; n-- > 0;) s->data[at[n]] = old[n];
        }
    }
}

static void test_no_memory(void **state) {
    context *c = *state;
    for (int i = 0; i < sample_count; i++) {
        sample *s = &samples[i];
        for (long n = 0;; n++) {
            assert_true(n < 10000);
            size_t live = mem_live();
            mem_fail_after(n);
            long before = mem_count();
            sherf_status status = attempt(c, s, s->data, s->bytes);
            mem_fail_after(-1);
            if (mem_live() != live) fail_msg("%s, allocation %ld: leaks", s->name, n);
            if (mem_count() - before <= n) { /* nothing failed: all allocations have been tried */
                assert_int_equal(status, SHERF_OK);
                break;
            }
            if (status != SHERF_NO_MEMORY) fail_msg("%s, allocation %ld: status %d", s->name, n, (int)status);
        }
    }
}

/* Small pickles that demand much memory: each must be refused at once. */
static void test_greedy(void **state) {
    context *c = *state;
    static const struct {
        const char *what;
        size_t bytes;
        const char *data;
    } greedy[] = {
#define GREEDY(what, text) {what, sizeof text - 1, text}
        GREEDY("memo index", "\x80\x02Nr\xff\xff\xff\x7f."),
        GREEDY("memo index in text", "Np99999999999\n."),
        GREEDY("string length", "\x80\x04\x8e\xff\xff\xff\xff\xff\xff\xff\x7fx."),
        GREEDY("negative string", "\x80\x02T\xff\xff\xff\xffx."),
        GREEDY("nothing to pop", "0."),
        GREEDY("mark returned", "(."),
        GREEDY("no mark", "Nt."),
        GREEDY("sparse matrix", "cscipy.sparse.csc\ncsc_matrix\n)\x81}(U\x06_shape(I9999999\nI9999999\ntU\x04"
                                "datacnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntU\x01"
                                "btR(I1\n(I1\ntcnumpy\ndtype\n(U\x02"
                                "f8I0\nI1\ntR(I3\nU\x01<NNNI-1\nI-1\nI0\ntbI0\nU\x08\0\0\0\0\0\0\0\0tbub."),
        GREEDY("array shape", "cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntU\x01"
                              "btR(I1\n(L4611686018427387904L\nI4\ntcnumpy\ndtype\n(U\x02"
                              "f8I0\nI1\ntRI0\nU\0tb."),
        GREEDY("extension", "\x80\x02\x82\x01."),
        GREEDY("protocol", "\x80\x09N."),
        GREEDY("state of a class", "cos\nsystem\n}b."),
#undef GREEDY
    };
    for (size_t i = 0; i < COUNT_OF(greedy); i++) {
        document *d;
        size_t live = mem_live();
        c->message[0] = 0;
        if (pickle_parse(c, (const unsigned char *)greedy[i].data, greedy[i].bytes, &d) == SHERF_OK)
            fail_msg("%s: accepted", greedy[i].what);
        assert_null(d);
        assert_true(c->message[0]);
        assert_int_equal(mem_live(), live);
    }
}

/* Lists of lists of lists: 2^40 numbers in a few hundred bytes, and 100000 levels. */
static void test_nested(void **state) {
    context *c = *state;
    unsigned char text[1024];
    size_t n = 0;
    document *d;
    double x;
    memcpy(text, "\x80\x02]K\1a", 6);
    n = 6;
    for (int i = 0; i < 40; i++) { /* memoises the list, then makes a new list that holds it twice */
        memcpy(text + n, "q\0]h\0ah\0a", 9);
        text[n + 1] = text[n + 4] = text[n + 7] = (unsigned char)i;
        n += 9;
    }
    text[n++] = '.';
    assert_ok(c, pickle_parse(c, text, n, &d));
    assert_int_equal(value_numbers(d->root), -1);
    assert_int_equal(value_doubles(c, d->root, "it", 1, &x), SHERF_BAD_FILE);
    document_free(d);
    enum { LEVELS = 100000 };
    char *deep = malloc(LEVELS * 2 + 1);
    for (int i = 0; i < LEVELS; i++) {
        deep[i] = ']';
        deep[LEVELS + i] = i < LEVELS - 1 ? 'a' : '.';
    }
    assert_int_equal(pickle_parse(c, (unsigned char *)deep, LEVELS * 2, &d), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "nested"));
    free(deep);
}

/* torch.save streams nested in each other, in place of the protocol number: each is one more call level. */
static void test_streams_within_streams(void **state) {
    enum { LEVELS = 300 };
    static const char magic[] = "\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.",
                      call[] = "\x80\x02"
                               "ctorch.storage\n_load_from_bytes\nB",
                      end[] = "\x85R.";
    enum { BEFORE = sizeof magic - 1 + sizeof call - 1 + 4, EACH = BEFORE + sizeof end - 1 };
    static unsigned char stream[LEVELS * EACH];
    context *c = *state;
    document *d;
    for (size_t i = 0; i < LEVELS; i++) {
        unsigned char *p = stream + i * BEFORE;
        const size_t left = (LEVELS - 1 - i) * EACH;
        memcpy(p, magic, sizeof magic - 1);
        memcpy(p + sizeof magic - 1, call, sizeof call - 1);
        for (size_t k = 0; k < 4; k++) p[BEFORE - 4 + k] = (unsigned char)(left >> 8 * k);
        memcpy(stream + LEVELS * BEFORE + i * (sizeof end - 1), end, sizeof end - 1);
    }
    assert_int_equal(document_parse(c, stream, sizeof stream, &d, NULL), SHERF_BAD_FILE);
    assert_string_equal(c->message, "torch: storages within storages");
    assert_null(d);
}

static int setup(void **state) {
    context *c = *state = test_context();
    DIR *folder = opendir("data/io");
    struct dirent *e;
    while (folder && (e = readdir(folder)) && sample_count < SAMPLES_MAX) {
        sample *s = &samples[sample_count];
        char path[512];
        if (e->d_name[0] == '.' || path_ends(e->d_name, ".md")) continue;
        /* test_photo.c and the fuzzers damage these: their decoders are other libraries and take milliseconds
         * each */
        if (path_ends(e->d_name, ".webp") || path_ends(e->d_name, ".heic") || path_ends(e->d_name, ".avif"))
            continue;
        snprintf(s->name, sizeof s->name, "%.100s", e->d_name);
        snprintf(path, sizeof path, "data/io/%s", s->name);
        if (file_read(c, path, 1 << 20, &s->data, &s->bytes) != SHERF_OK) return -1;
        sample_count++;
    }
    if (folder) closedir(folder);
    return sample_count > 30 ? 0 : -1;
}
static int teardown(void **state) {
    for (int i = 0; i < sample_count; i++) mem_free(samples[i].data);
    sherf_context_free(*state);
    return mem_live() == 0 ? 0 : -1;
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_cut_is_refused),
                                       cmocka_unit_test(test_cut),
                                       cmocka_unit_test(test_changed),
                                       cmocka_unit_test(test_no_memory),
                                       cmocka_unit_test(test_greedy),
                                       cmocka_unit_test(test_nested),
                                       cmocka_unit_test(test_streams_within_streams)};
    return cmocka_run_group_tests(tests, setup, teardown);
}
