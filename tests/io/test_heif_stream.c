/* Tests of HEIF and AVIF files whose streams state larger frames than their containers: they are refused
 * before a decoder sees them. All files are synthetic. */
#include <stdlib.h>
#include <string.h>

#include "io/heif_stream.h"
#include "io/image.h"
#include "support.h"

enum { SHOWN = 64, LARGE = 20000 };

/* ---- bits and boxes ---- */
typedef struct {
    size_t bits;
    uint8_t data[1024];
} out;

static void bits(out *o, uint64_t v, int count) {
    while (count--) {
        if (v >> count & 1) o->data[o->bits / 8] |= (uint8_t)(128 >> o->bits % 8);
        o->bits++;
    }
}
static void golomb(out *o, uint32_t v) {
    int n = 0;
    while ((v + 1) >> (n + 1)) n++;
    bits(o, v + 1, 2 * n + 1);
}
static void bytes(out *o, const void *data, size_t n) {
    for (size_t i = 0; i < n; i++) bits(o, ((const uint8_t *)data)[i], 8);
}
static void aligned(out *o) {
    bits(o, 1, 1);
    while (o->bits % 8) o->bits++;
}
static void put(out *o, const out *more) {
    bytes(o, more->data, more->bits / 8);
}
static void box(out *o, const char *type, const out *inside) {
    bits(o, 8 + inside->bits / 8, 32);
    bytes(o, type, 4);
    put(o, inside);
}

/* ---- streams ---- */
static void obu(out *o, int type, const out *inside) {
    bits(o, (uint64_t)type << 3 | 2, 8);
    bits(o, inside->bits / 8, 8);
    put(o, inside);
}

/* An AV1 stream. reduced: with a still picture's header; otherwise with a header whose frame has its own
 * size. */
static void av1(out *o, bool reduced, int size) {
    out q = {0}, f = {0};
    bits(&q, 0, 3);
    bits(&q, reduced ? 3 : 0, 2);
    if (reduced) bits(&q, 0, 5);
    if (!reduced) bits(&q, 0, 1 + 1 + 5 + 12 + 5); /* one operating point */
    bits(&q, 15, 4);
    bits(&q, 15, 4);
    for (int k = 0; k < 2; k++) bits(&q, (uint64_t)(reduced ? size : SHOWN) - 1, 16);
    if (!reduced) bits(&q, 0, 1);
    bits(&q, 0, 3);
    if (!reduced) bits(&q, 1, 5); /* an order hint */
    if (!reduced) bits(&q, 0, 2);
    if (!reduced) bits(&q, 3, 2); /* the frame states its screen content and integer motion */
    if (!reduced) bits(&q, 6, 3);
    aligned(&q);
    obu(o, 1, &q);
    if (reduced) return;
    bits(&f, 0, 1); /* a key frame that is shown */
    bits(&f, 0, 2);
    bits(&f, 1, 1);
    bits(&f, 0, 1);
    bits(&f, 3, 2);
    bits(&f, 1, 1); /* its own size */
    bits(&f, 0, 7);
    for (int k = 0; k < 2; k++) bits(&f, (uint64_t)size - 1, 16);
    aligned(&f);
    obu(o, 6, &f);
}

static void sps(out *o, int size) {
    bits(o, 33 << 1, 8);
    bits(o, 1, 8);
    bits(o, 0, 4);
    bits(o, 1, 3); /* two layers */
    bits(o, 1, 1);
    for (int i = 0; i < 12; i++) bits(o, i == 3 ? 0x60 : 1, 8);
    bits(o, 3, 2);
    bits(o, 0, 14);
    for (int i = 0; i < 12; i++) bits(o, 1, 8);
    golomb(o, 0);
    golomb(o, 1);
    golomb(o, (uint32_t)size);
    golomb(o, (uint32_t)size);
    aligned(o);
}

/* A container that states a picture of SHOWN x SHOWN, in one item of `type` that is split into `pieces`
 * pieces. */
static void file(out *o, const char *type, const out *config, const out *data, int pieces) {
    out ftyp = {0}, meta = {0}, hdlr = {0}, pitm = {0}, iloc = {0}, iinf = {0}, infe = {0}, iprp = {0},
        ipco = {0}, ispe = {0}, ipma = {0};
    const bool avif = type[0] == 'a';
    bytes(&ftyp, avif ? "avif\0\0\0\0avifmif1" : "heic\0\0\0\0heicmif1", 16);
    box(o, "ftyp", &ftyp);
    bits(&hdlr, 0, 64);
    bytes(&hdlr, "pict", 4);
    for (int i = 0; i < 13; i++) bits(&hdlr, 0, 8);
    bits(&pitm, 0, 32);
    bits(&pitm, 1, 16);
    bits(&infe, 2u << 24, 32);
    bits(&infe, 1u << 16, 32);
    bytes(&infe, type, 5);
    bits(&iinf, 1, 48);
    box(&iinf, "infe", &infe);
    bits(&ispe, 0, 32);
    bits(&ispe, SHOWN, 32);
    bits(&ispe, SHOWN, 32);
    box(&ipco, "ispe", &ispe);
    box(&ipco, avif ? "av1C" : "hvcC", config);
    box(&iprp, "ipco", &ipco);
    bits(&ipma, 0, 32);
    bits(&ipma, 1, 32);
    bits(&ipma, 1, 16);
    bits(&ipma, 0x020182, 24);
    box(&iprp, "ipma", &ipma);
    const size_t n = data->bits / 8, iloc_bytes = 8 + 4 + 2 + 2 + 2 + 2 + 2 + 8 * (size_t)pieces;
    const size_t before = o->bits / 8 + 8 + 4 + (8 + hdlr.bits / 8) + (8 + pitm.bits / 8) + iloc_bytes +
                          (8 + iinf.bits / 8) + (8 + iprp.bits / 8) + 8;
    bits(&iloc, 0, 32);
    bits(&iloc, 0x4400, 16);
    bits(&iloc, 1, 16);
    bits(&iloc, 1, 16);
    bits(&iloc, 0, 16);
    bits(&iloc, (uint64_t)pieces, 16);
    for (int i = 0; i < pieces; i++) {
        const size_t at = n * (size_t)i / (size_t)pieces, end = n * (size_t)(i + 1) / (size_t)pieces;
        bits(&iloc, before + at, 32);
        bits(&iloc, end - at, 32);
    }
    bits(&meta, 0, 32);
    box(&meta, "hdlr", &hdlr);
    box(&meta, "pitm", &pitm);
    box(&meta, "iloc", &iloc);
    box(&meta, "iinf", &iinf);
    box(&meta, "iprp", &iprp);
    box(o, "meta", &meta);
    box(o, "mdat", data);
}

/* ---- reading them ---- */
static void look(context *c, const out *f, int coded) {
    heif_sizes sizes;
    image_u8 p;
    assert_ok(c, heif_stream_sizes(c, f->data, f->bits / 8, &sizes));
    assert_false(sizes.odd);
    for (int k = 0; k < 2; k++) {
        assert_int_equal(sizes.stated[k], SHOWN);
        assert_int_equal(sizes.coded[k], coded);
    }
    assert_int_equal(image_parse(c, f->data, f->bits / 8, 3, &p), SHERF_BAD_FILE); /* there are no pixels */
    assert_null(p.data);
    const bool said = strstr(sherf_message(c), "20000 x 20000 pixels, and it states 64 x 64") != NULL;
    if (said != (coded == LARGE)) fail_msg("%s", sherf_message(c));
}

static void av1_streams(void **state) {
    context *c = *state;
    for (int reduced = 0; reduced < 2; reduced++)
        for (int pieces = 1; pieces <= 3; pieces++)
            for (int in_config = 0; in_config < 2; in_config++) {
                out data = {0}, large = {0}, config = {0}, f = {0};
                av1(&data, reduced, SHOWN);
                av1(&large, reduced, LARGE);
                bytes(&config, "\x81\0\x0c", 4);
                if (in_config) put(&config, &large);
                file(&f, "av01", &config, in_config ? &data : &large, pieces);
                look(c, &f, LARGE);
                f = config = (out){0};
                bytes(&config, "\x81\0\x0c", 4);
                file(&f, "av01", &config, &data, pieces);
                look(c, &f, SHOWN);
            }
}

static void hevc_streams(void **state) {
    context *c = *state;
    for (int in_config = 0; in_config < 2; in_config++)
        for (int size = SHOWN; size <= LARGE; size += LARGE - SHOWN) {
            out nal = {0}, data = {0}, config = {0}, f = {0};
            sps(&nal, size);
            bits(&config, 1, 8);
            for (int i = 0; i < 20; i++) bits(&config, 0, 8);
            bits(&config, 3, 8); /* four bytes before a NAL unit */
            bits(&config, (uint64_t)in_config, 8);
            if (in_config) bits(&config, 33, 8);
            if (in_config) bits(&config, 1, 16);
            if (in_config) bits(&config, nal.bits / 8, 16);
            if (in_config) put(&config, &nal);
            bits(&data, nal.bits / 8, 32);
            put(&data, &nal);
            file(&f, "hvc1", &config, in_config ? &(out){.bits = 64} : &data, 1);
            look(c, &f, size);
        }
}

/* An item in an idat box that does not exist. */
static void without_idat(void **state) {
    context *c = *state;
    heif_sizes sizes;
    out data = {0}, config = {0}, f = {0};
    av1(&data, false, SHOWN);
    bytes(&config, "\x81\0\x0c", 4);
    for (int pieces = 1; pieces < 3; pieces++) {
        f.bits = 0;
        memset(f.data, 0, sizeof f.data);
        file(&f, "av01", &config, &data, pieces);
        uint8_t *iloc = memmem(f.data, f.bits / 8, "iloc", 4);
        assert_non_null(iloc);
        iloc[4] = 1;                /* the version that can place items elsewhere */
        iloc[15] = 1;               /* in idat */
        iloc[19] = (uint8_t)pieces; /* the number of extents */
        assert_ok(c, heif_stream_sizes(c, f.data, f.bits / 8, &sizes));
    }
}

/* Items with very many pieces of length zero: reading takes no longer than a file of this size justifies. */
static void endless(void **state) {
    context *c = *state;
    heif_sizes sizes;
    out meta = {0}, iloc = {0}, f = {0};
    bits(&iloc, 0, 32);
    bits(&iloc, 0, 16);
    bits(&iloc, 100, 16);
    for (int i = 0; i < 100; i++) {
        bits(&iloc, 7, 16);
        bits(&iloc, 0, 16);
        bits(&iloc, 65535, 16);
    }
    bits(&meta, 0, 32);
    box(&meta, "iloc", &iloc);
    box(&f, "meta", &meta);
    assert_ok(c, heif_stream_sizes(c, f.data, f.bits / 8, &sizes));
    assert_true(sizes.odd);
}

/* Every truncation, and every byte set to 255: nothing is read beyond the end (the sanitizers would see it).
 */
static void broken(void **state) {
    context *c = *state;
    heif_sizes sizes;
    out data = {0}, config = {0}, f = {0};
    av1(&data, false, SHOWN);
    bytes(&config, "\x81\0\x0c", 4);
    file(&f, "av01", &config, &data, 3);
    for (size_t n = 0; n <= f.bits / 8; n++) {
        uint8_t *copy = malloc(n ? n : 1);
        memcpy(copy, f.data, n);
        assert_ok(c, heif_stream_sizes(c, copy, n, &sizes));
        if (n) copy[n - 1] = 255;
        assert_ok(c, heif_stream_sizes(c, copy, n, &sizes));
        free(copy);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(av1_streams), cmocka_unit_test(hevc_streams),
                                       cmocka_unit_test(endless), cmocka_unit_test(broken),
                                       cmocka_unit_test(without_idat)};
    return cmocka_run_group_tests(tests, test_open, test_close);
}
