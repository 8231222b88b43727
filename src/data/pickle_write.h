/* A pickle of dicts, lists, strings and float arrays in an .npy file, as NumPy would write it. np.load(path,
 * allow_pickle=True).item() reads it. */
#ifndef SHERF_DATA_PICKLE_WRITE_H
#define SHERF_DATA_PICKLE_WRITE_H

#include "base/base.h"

typedef struct {
    context *c;
    unsigned char *data;
    size_t bytes, room;
    sherf_status status; /* the first failure; everything after it does nothing */
} pickle_writer;

void pickle_begin(pickle_writer *w, context *c);
void pickle_string(pickle_writer *w, const char *text);
void pickle_int(pickle_writer *w, int32_t i);
/* Elements, or keys and items in turn, go between open and close. */
void pickle_list_open(pickle_writer *w);
void pickle_list_close(pickle_writer *w);
void pickle_dict_open(pickle_writer *w);
void pickle_dict_close(pickle_writer *w);
/* C order; dim has `rank` entries, at most 3. */
void pickle_floats(pickle_writer *w, int rank, const int *dim, const float *data);
void pickle_doubles(pickle_writer *w, int rank, const int *dim, const double *data);
/* Writes the one value that was made as a 0-d object array, and frees the writer whatever happens. */
sherf_status pickle_finish_npy(pickle_writer *w, const char *path);
/* The same as a plain pickle, which pickle.load reads. */
sherf_status pickle_finish_file(pickle_writer *w, const char *path);
#endif
