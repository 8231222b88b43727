/* heif_stream: reads the boxes of `meta`, then OBUs or NAL units. It follows only offsets inside the data. */
#include "io/heif_stream.h"

#include <string.h>

enum { ITEMS_MAX = 65536, DEPTH_MAX = 4 };

typedef struct {
    const uint8_t *data;
    size_t bytes;
} piece;

static piece piece_of(piece p, size_t at, uint64_t bytes) {
    if (at > p.bytes) at = p.bytes;
    return (piece){p.data + at, bytes < p.bytes - at ? (size_t)bytes : p.bytes - at};
}

/* Big-endian, of `count` bytes at *at, which moves on; 0 beyond the end. */
static uint64_t number(piece p, size_t *at, int count) {
    uint64_t v = 0;
    for (int i = 0; i < count; i++, ++*at) v = v << 8 | (*at < p.bytes ? p.data[*at] : 0);
    return v;
}

static void grow(uint32_t max[2], uint64_t width, uint64_t height) {
    const uint64_t size[2] = {width, height};
    for (int k = 0; k < 2; k++)
        if (size[k] > max[k]) max[k] = size[k] < UINT32_MAX ? (uint32_t)size[k] : UINT32_MAX;
}

/* ---- bits ---- */
typedef struct {
    piece from;
    size_t at; /* bits */
} bits;

static uint32_t take(bits *b, int count) {
    uint32_t v = 0;
    for (; count > 0; count--, b->at++) {
        const size_t byte = b->at / 8;
        v = v << 1 | (byte < b->from.bytes ? b->from.data[byte] >> (7 - b->at % 8) & 1u : 0);
    }
    return v;
}

/* Exp-Golomb: ue of H.265, uvlc of AV1. */
static uint32_t golomb(bits *b) {
    int zeros = 0;
    while (zeros < 32 && b->at / 8 < b->from.bytes && !take(b, 1)) zeros++;
    return zeros < 32 ? (1u << zeros) - 1 + take(b, zeros) : UINT32_MAX;
}

/* ---- AV1 ---- */
/* The fields of the sequence header that frame headers need. */
typedef struct {
    bool there, reduced, decoder_model, equal_interval, frame_ids;
    int size_bits[2], id_bits, time_bits, order_bits, screen_content, integer_mv; /* 2: each frame says */
} av1_sequence;

static void av1_operating_points(bits *b, av1_sequence *q) {
    bool delays = false;
    int delay_bits = 0;
    if (take(b, 1)) { /* timing */
        take(b, 32), take(b, 32);
        if ((q->equal_interval = take(b, 1))) golomb(b);
        if ((q->decoder_model = take(b, 1))) {
            delay_bits = (int)take(b, 5) + 1;
            take(b, 32);
            take(b, 5);
            q->time_bits = (int)take(b, 5) + 1;
        }
    }
    delays = take(b, 1);
    for (int i = (int)take(b, 5); i >= 0; i--) {
        take(b, 12);
        if (take(b, 5) > 7) take(b, 1);
        if (q->decoder_model && take(b, 1)) take(b, delay_bits), take(b, delay_bits), take(b, 1);
        if (delays && take(b, 1)) take(b, 4);
    }
}

static void av1_tools(bits *b, av1_sequence *q) {
    take(b, 3); /* superblocks, filter intra, intra edge */
    q->screen_content = q->integer_mv = 2;
    if (q->reduced) return;
    take(b, 4);
    const bool order = take(b, 1);
    if (order) take(b, 2);
    if (!take(b, 1)) q->screen_content = (int)take(b, 1);
    if (q->screen_content && !take(b, 1)) q->integer_mv = (int)take(b, 1);
    if (order) q->order_bits = (int)take(b, 3) + 1;
}

static void av1_sequence_header(piece p, av1_sequence *q, heif_sizes *out) {
    bits b = {p, 0};
    *q = (av1_sequence){.there = true};
    take(&b, 3 + 1);
    if ((q->reduced = take(&b, 1)))
        take(&b, 5);
    else
        av1_operating_points(&b, q);
    for (int k = 0; k < 2; k++) q->size_bits[k] = (int)take(&b, 4) + 1;
    const uint64_t width = (uint64_t)take(&b, q->size_bits[0]) + 1;
    const uint64_t height = (uint64_t)take(&b, q->size_bits[1]) + 1;
    grow(out->coded, width, height);
    if (!q->reduced && (q->frame_ids = take(&b, 1))) {
        const int delta_bits = (int)take(&b, 4) + 2;
        q->id_bits = (int)take(&b, 3) + delta_bits + 1;
    }
    av1_tools(&b, q);
}

/* A frame may have its own size, which no decoder limits to the sequence's. If this reader does not get that
 * far, the size counts as the maximum of its bits. */
static void av1_frame_header(piece p, const av1_sequence *q, heif_sizes *out) {
    enum { KEY = 0, SWITCH = 3 };
    bits b = {p, 0};
    if (!q->there || q->reduced || take(&b, 1)) return;
    const uint32_t type = take(&b, 2);
    const bool shown = take(&b, 1), plain = type == KEY && shown;
    if (shown && q->decoder_model && !q->equal_interval) take(&b, q->time_bits);
    if (!shown) take(&b, 1);
    if (type != SWITCH && !plain) take(&b, 1);
    take(&b, 1);
    const uint32_t screen_content = q->screen_content == 2 ? take(&b, 1) : (uint32_t)q->screen_content;
    if (screen_content && q->integer_mv == 2) take(&b, 1);
    if (q->frame_ids) take(&b, q->id_bits);
    if (type != SWITCH && !take(&b, 1)) return;
    take(&b, q->order_bits);
    if (!plain || q->decoder_model) {
        grow(out->coded, (uint64_t)1 << q->size_bits[0], (uint64_t)1 << q->size_bits[1]);
        return;
    }
    const uint64_t width = (uint64_t)take(&b, q->size_bits[0]) + 1;
    grow(out->coded, width, (uint64_t)take(&b, q->size_bits[1]) + 1);
}

static void av1_stream(piece p, av1_sequence *q, heif_sizes *out) {
    enum { SEQUENCE = 1, FRAME_HEADER = 3, FRAME = 6 };
    for (size_t at = 0; at < p.bytes;) {
        const uint64_t head = number(p, &at, 1);
        uint64_t length = 0;
        if (head & 4) at++;
        if (head & 2)
            for (int i = 0; i < 8; i++) {
                const uint64_t byte = number(p, &at, 1);
                length |= (byte & 127) << 7 * i;
                if (!(byte & 128)) break;
            }
        const piece obu = piece_of(p, at, head & 2 ? length : UINT64_MAX);
        const int type = (int)(head >> 3 & 15);
        if (type == SEQUENCE) av1_sequence_header(obu, q, out);
        if (type == FRAME_HEADER || type == FRAME) av1_frame_header(obu, q, out);
        at += obu.bytes;
    }
}

/* ---- H.265 ---- */
static void hevc_sps(piece p, heif_sizes *out) {
    enum { MAX = 512 }; /* the needed fields are in the first hundred bytes */
    uint8_t plain[MAX];
    size_t n = 0, zeros = 0;
    for (size_t i = 2; i < p.bytes && n < MAX; i++) {
        const bool escape = zeros >= 2 && p.data[i] == 3;
        zeros = p.data[i] ? 0 : zeros + 1;
        if (!escape) plain[n++] = p.data[i];
    }
    bits b = {{plain, n}, 4};
    const int layers = (int)take(&b, 3);
    uint32_t there[8];
    b.at += 1 + 88 + 8;
    for (int i = 0; i < layers; i++) there[i] = take(&b, 2);
    if (layers) b.at += 2 * (size_t)(8 - layers);
    for (int i = 0; i < layers; i++) b.at += (there[i] & 2 ? 88 : 0) + (there[i] & 1 ? 8 : 0);
    golomb(&b);
    if (golomb(&b) == 3) take(&b, 1);
    const uint32_t width = golomb(&b);
    grow(out->coded, width, golomb(&b));
}

static void hevc_nal(piece p, heif_sizes *out) {
    enum { SPS = 33 };
    if (p.bytes > 2 && (p.data[0] >> 1 & 63) == SPS) hevc_sps(p, out);
}

static void hevc_stream(piece p, int length_bytes, heif_sizes *out) {
    for (size_t at = 0; at < p.bytes;) {
        const uint64_t length = number(p, &at, length_bytes);
        const piece nal = piece_of(p, at, length);
        hevc_nal(nal, out);
        at += nal.bytes;
    }
}

/* ---- boxes ---- */
typedef struct {
    piece file, idat, iloc;
    bool av1[ITEMS_MAX], hevc[ITEMS_MAX]; /* by number of the item, from 0 */
    int length_bytes;                     /* before a NAL unit, by hvcC */
    uint64_t left; /* steps: one an extent, one a byte of it; no honest file uses them up */
    av1_sequence sequence;
    heif_sizes *out;
    context *c;
} walk;

static void hvcc(walk *w, piece p) {
    size_t at = 22;
    if (p.bytes < 23) return;
    w->length_bytes = (p.data[21] & 3) + 1;
    for (uint64_t arrays = number(p, &at, 1); arrays && at < p.bytes; arrays--) {
        at++;
        for (uint64_t n = number(p, &at, 2); n && at < p.bytes; n--) {
            const uint64_t length = number(p, &at, 2);
            hevc_nal(piece_of(p, at, length), w->out);
            at += (size_t)length;
        }
    }
}

static void infe(walk *w, piece p) {
    size_t at = 0;
    const uint64_t version = number(p, &at, 4) >> 24;
    if (version < 2) return;
    const uint64_t id = number(p, &at, version == 2 ? 2 : 4);
    const piece type = piece_of(p, at + 2, 4);
    if (type.bytes < 4) return;
    const bool av1 = !memcmp(type.data, "av01", 4), hevc = !memcmp(type.data, "hvc1", 4);
    if (id >= ITEMS_MAX) {
        w->out->odd |= av1 || hevc;
        return;
    }
    w->av1[id] |= av1;
    w->hevc[id] |= hevc;
}

static void boxes(walk *w, piece p, int depth);

static void box(walk *w, const uint8_t type[4], piece p, int depth) {
    size_t at = 4;
    if (!memcmp(type, "meta", 4)) boxes(w, piece_of(p, 4, UINT64_MAX), depth + 1);
    if (!memcmp(type, "iprp", 4) || !memcmp(type, "ipco", 4)) boxes(w, p, depth + 1);
    if (!memcmp(type, "iinf", 4)) boxes(w, piece_of(p, p.bytes && p.data[0] ? 8 : 6, UINT64_MAX), depth + 1);
    if (!memcmp(type, "infe", 4)) infe(w, p);
    if (!memcmp(type, "idat", 4)) w->idat = p;
    if (!memcmp(type, "iloc", 4)) w->iloc = p;
    if (!memcmp(type, "hvcC", 4)) hvcc(w, p);
    if (!memcmp(type, "av1C", 4)) av1_stream(piece_of(p, 4, UINT64_MAX), &w->sequence, w->out);
    if (!memcmp(type, "ispe", 4)) {
        const uint64_t width = number(p, &at, 4);
        grow(w->out->stated, width, number(p, &at, 4));
    }
}

static void boxes(walk *w, piece p, int depth) {
    for (size_t at = 0; depth <= DEPTH_MAX && at + 8 <= p.bytes;) {
        const size_t begin = at;
        uint64_t length = number(p, &at, 4);
        const uint8_t *type = p.data + at;
        at += 4;
        if (length == 1) length = number(p, &at, 8);
        if (length == 0) length = p.bytes - begin;
        if (length < at - begin || at > p.bytes) return;
        box(w, type, piece_of(p, at, length - (at - begin)), depth);
        if (length > p.bytes - begin) return;
        at = begin + (size_t)length;
    }
}

/* ---- the pictures' data ---- */
static void stream(walk *w, uint64_t id, piece p) {
    if (w->av1[id]) av1_stream(p, &w->sequence, w->out);
    if (w->hevc[id]) hevc_stream(p, w->length_bytes, w->out);
}

/* Concatenates the pieces of one item; more bytes than the file or the memory has are odd. */
static size_t item(walk *w, uint64_t id, int version, const int size[4], size_t at) {
    const piece p = w->iloc;
    uint64_t method = 0;
    if (version > 0) method = number(p, &at, 2) & 15;
    at += 2;
    const uint64_t base = number(p, &at, size[2]), extents = number(p, &at, 2);
    const piece from = method == 1 ? w->idat : w->file;
    const bool wanted = id < ITEMS_MAX && (w->av1[id] || w->hevc[id]);
    uint8_t *whole = wanted && extents > 1 ? mem_alloc(w->c, from.bytes + 1, 1) : NULL;
    size_t done = 0;
    for (uint64_t i = 0; i < extents && at < p.bytes && w->left; i++) {
        if (version > 0) at += (size_t)size[3];
        const uint64_t offset = base + number(p, &at, size[0]), length = number(p, &at, size[1]);
        const piece part =
            piece_of(from, offset < from.bytes ? (size_t)offset : from.bytes, length ? length : UINT64_MAX);
        const uint64_t steps = 1 + (wanted ? part.bytes : 0);
        w->out->odd |= steps >= w->left;
        w->left = steps < w->left ? w->left - steps : 0;
        if (wanted && extents == 1) stream(w, id, part);
        if (!wanted || extents == 1) continue;
        if (!whole || part.bytes > from.bytes - done) {
            w->out->odd = true;
            continue;
        }
        memcpy(whole + done, part.data, part.bytes);
        done += part.bytes;
    }
    if (whole) stream(w, id, (piece){whole, done});
    mem_free(whole);
    return at;
}

static void items(walk *w) {
    const piece p = w->iloc;
    size_t at = 0;
    const int version = (int)(number(p, &at, 4) >> 24);
    const uint64_t sizes = number(p, &at, 2);
    const int size[4] = {(int)(sizes >> 12), (int)(sizes >> 8 & 15), (int)(sizes >> 4 & 15),
                         version ? (int)(sizes & 15) : 0}; /* offset, length, base, index */
    for (int k = 0; k < 4; k++)
        if (size[k] > 8) return;
    for (uint64_t n = number(p, &at, version < 2 ? 2 : 4); n && at < p.bytes && w->left; n--) {
        const uint64_t id = number(p, &at, version < 2 ? 2 : 4);
        at = item(w, id, version, size, at);
    }
}

sherf_status heif_stream_sizes(context *c, const uint8_t *data, size_t bytes, heif_sizes *out) {
    *out = (heif_sizes){0};
    walk *w = mem_zero(c, 1, sizeof *w);
    if (!w) return SHERF_NO_MEMORY;
    w->file = (piece){data, bytes};
    w->idat = w->iloc = (piece){data, 0}; /* until their boxes come */
    w->length_bytes = 4;
    w->left = 4 * (uint64_t)bytes + ITEMS_MAX;
    w->out = out;
    w->c = c;
    boxes(w, w->file, 0);
    items(w);
    mem_free(w);
    return SHERF_OK;
}
