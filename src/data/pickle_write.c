/* Writes pickles by protocol, in .npy files, as NumPy reads them. */
#include "data/pickle_write.h"

#include <string.h>

#include "base/path.h"

/* Opcodes of protocol 3 (Python's pickletools). */
enum {
    OP_PROTO = 0x80,
    OP_MARK = '(',
    OP_STOP = '.',
    OP_EMPTY_LIST = ']',
    OP_APPEND = 'a',
    OP_APPENDS = 'e',
    OP_EMPTY_DICT = '}',
    OP_SETITEMS = 'u',
    OP_GLOBAL = 'c',
    OP_REDUCE = 'R',
    OP_BUILD = 'b',
    OP_TUPLE = 't',
    OP_BININT = 'J',
    OP_BINUNICODE = 'X',
    OP_BINBYTES = 'B',
    OP_NONE = 'N',
    OP_TRUE = 0x88,
    OP_FALSE = 0x89
};

static void put(pickle_writer *w, const void *data, size_t bytes) {
    if (w->status) return;
    if (w->room - w->bytes < bytes) {
        size_t room = 2 * (w->bytes + bytes) + 4096;
        unsigned char *more = mem_grow(w->c, w->data, w->bytes, room, 1);
        if (!more) {
            w->status = SHERF_NO_MEMORY;
            return;
        }
        w->data = more;
        w->room = room;
    }
    memcpy(w->data + w->bytes, data, bytes);
    w->bytes += bytes;
}

static void put_byte(pickle_writer *w, int op) {
    unsigned char byte = (unsigned char)op;
    put(w, &byte, 1);
}

static void put_counted(pickle_writer *w, int op, const void *data, uint32_t bytes) {
    put_byte(w, op);
    put(w, &bytes, 4);
    put(w, data, bytes);
}

static void put_integer(pickle_writer *w, int32_t i) {
    put_byte(w, OP_BININT);
    put(w, &i, 4);
}

static void put_class(pickle_writer *w, const char *module, const char *name) {
    put_byte(w, OP_GLOBAL);
    put(w, module, strlen(module));
    put_byte(w, '\n');
    put(w, name, strlen(name));
    put_byte(w, '\n');
}

void pickle_begin(pickle_writer *w, context *c) {
    *w = (pickle_writer){.c = c};
}

void pickle_string(pickle_writer *w, const char *text) {
    put_counted(w, OP_BINUNICODE, text, (uint32_t)strlen(text));
}

void pickle_list_open(pickle_writer *w) {
    put_byte(w, OP_EMPTY_LIST);
    put_byte(w, OP_MARK);
}

void pickle_list_close(pickle_writer *w) {
    put_byte(w, OP_APPENDS);
}

void pickle_dict_open(pickle_writer *w) {
    put_byte(w, OP_EMPTY_DICT);
    put_byte(w, OP_MARK);
}

void pickle_dict_close(pickle_writer *w) {
    put_byte(w, OP_SETITEMS);
}

/* numpy.core.multiarray._reconstruct(ndarray, (0,), b"b") and the open state up to the data:
 * (1, shape, dtype, False, ... */
static void array_open(pickle_writer *w, int rank, const int *dim, const char *type) {
    put_class(w, "numpy.core.multiarray", "_reconstruct");
    put_byte(w, OP_MARK);
    put_class(w, "numpy", "ndarray");
    put_byte(w, OP_MARK);
    put_integer(w, 0);
    put_byte(w, OP_TUPLE);
    put_counted(w, OP_BINBYTES, "b", 1);
    put_byte(w, OP_TUPLE);
    put_byte(w, OP_REDUCE);
    put_byte(w, OP_MARK);
    put_integer(w, 1);
    put_byte(w, OP_MARK);
    for (int i = 0; i < rank; i++) put_integer(w, dim[i]);
    put_byte(w, OP_TUPLE);
    /* dtype(type, False, True) with the state (3, order, None, None, None, -1, -1, flags) */
    bool object = type[0] == 'O';
    put_class(w, "numpy", "dtype");
    put_byte(w, OP_MARK);
    pickle_string(w, type);
    put_byte(w, OP_FALSE);
    put_byte(w, OP_TRUE);
    put_byte(w, OP_TUPLE);
    put_byte(w, OP_REDUCE);
    put_byte(w, OP_MARK);
    put_integer(w, 3);
    pickle_string(w, object ? "|" : "<");
    for (int i = 0; i < 3; i++) put_byte(w, OP_NONE);
    put_integer(w, -1);
    put_integer(w, -1);
    put_integer(w, object ? 63 : 0);
    put_byte(w, OP_TUPLE);
    put_byte(w, OP_BUILD);
    put_byte(w, OP_FALSE);
}

static void array_close(pickle_writer *w) {
    put_byte(w, OP_TUPLE);
    put_byte(w, OP_BUILD);
}

static void put_array(pickle_writer *w, int rank, const int *dim, const char *type, const void *data,
                      size_t size) {
    size_t bytes = size;
    for (int i = 0; i < rank; i++) bytes *= (size_t)dim[i];
    array_open(w, rank, dim, type);
    put_counted(w, OP_BINBYTES, data, (uint32_t)bytes);
    array_close(w);
}

void pickle_floats(pickle_writer *w, int rank, const int *dim, const float *data) {
    put_array(w, rank, dim, "f4", data, sizeof *data);
}

void pickle_doubles(pickle_writer *w, int rank, const int *dim, const double *data) {
    put_array(w, rank, dim, "f8", data, sizeof *data);
}

void pickle_int(pickle_writer *w, int32_t i) {
    put_integer(w, i);
}

/* Writes `all` and frees both. */
static sherf_status finish(pickle_writer *w, pickle_writer *all, const char *path) {
    output_file file = {0};
    sherf_status status = w->status ? w->status : all->status;
    if (!status) status = output_open(w->c, path, &file);
    if (!status) status = output_write(w->c, &file, all->data, all->bytes);
    if (!status) status = output_commit(w->c, &file);
    output_abort(&file);
    mem_free(all->data);
    mem_free(w->data);
    *w = (pickle_writer){0};
    return status;
}

sherf_status pickle_finish_file(pickle_writer *w, const char *path) {
    pickle_writer all;
    pickle_begin(&all, w->c);
    put_byte(&all, OP_PROTO);
    put_byte(&all, 3);
    put(&all, w->data, w->bytes);
    put_byte(&all, OP_STOP);
    return finish(w, &all, path);
}

sherf_status pickle_finish_npy(pickle_writer *w, const char *path) {
    static const char text[] = "{'descr': '|O', 'fortran_order': False, 'shape': (), }";
    enum { HEADER = 128, PREFIX = 10 }; /* magic, version 1.0 and the length of the rest, 118 */
    unsigned char header[HEADER] = "\x93NUMPY\x01\x00\x76\x00";
    memset(header + PREFIX, ' ', HEADER - PREFIX);
    memcpy(header + PREFIX, text, sizeof text - 1);
    header[HEADER - 1] = '\n';
    pickle_writer all;
    pickle_begin(&all, w->c);
    put(&all, header, sizeof header);
    put_byte(&all, OP_PROTO);
    put_byte(&all, 3);
    array_open(&all, 0, NULL, "O8");
    put_byte(&all, OP_EMPTY_LIST);
    put(&all, w->data, w->bytes);
    put_byte(&all, OP_APPEND);
    array_close(&all);
    put_byte(&all, OP_STOP);
    return finish(w, &all, path);
}
