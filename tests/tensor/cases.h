/* The table of op cases. The same table serves gradients (double, central differences) and backends (against
 * the reference). A case builds one op from made-up inputs. */
#ifndef TEST_CASES_H
#define TEST_CASES_H

#include "support.h"
#include "tensor/tensor.h"

typedef struct {
    int rank; /* -1: no such input */
    int64_t dim[TENSOR_RANK];
    double low, high;     /* uniform values; for I32: integers low .. high - 1 */
    dtype type;           /* T_F32 (0): real, which is double in the gradient check */
    bool constant;        /* real, but not differentiated */
    const int32_t *fixed; /* I32 values given instead of random ones */
    double away;          /* > 0: values this close to a kink at 0 are pushed away from it */
} case_input;

typedef struct {
    const char *name;
    op_id op;
    int inputs;
    case_input in[OP_MAX_IN];
    tensor *(*build)(tape *t, tensor **in); /* the op may not read the inputs' values */
    bool training;                          /* batch norms */
    bool large;                             /* too large for central differences: backends only */
    void (*prepare)(tensor **in);           /* changes I32 inputs before anything reads them */
    double
        tolerance; /* tolerance of a backend against the reference, relative to the largest value; 0: 2e-5 */
} op_case;

extern const op_case cases_dense[], cases_spatial[];
extern const int cases_dense_count, cases_spatial_count;

/* For the tables: a shape, and a missing input. */
#define SHAPE(...) .rank = (int)COUNT_OF(((int64_t[]){__VA_ARGS__})), .dim = {__VA_ARGS__}
#define NONE                                                                                                 \
    { .rank = -1 }

#endif
