/* pickle: numpy's arrays, scipy's sparse matrices (made dense) and chumpy's arrays (the array inside). */
#include <stdio.h>
#include <string.h>

#include "io/pickle.h"

/* ---------------------------------------------------------------- numpy ------------------------------ */
/* The name inside numpy's module of C functions, in any version, or NULL. */
static const char *multiarray(const char *name) {
    static const char *const module[] = {"numpy.core.multiarray.", "numpy._core.multiarray.",
                                         "numpy.core._multiarray_umath.", "numpy._core._multiarray_umath."};
    for (size_t i = 0; i < COUNT_OF(module); i++) {
        size_t n = strlen(module[i]);
        if (!strncmp(name, module[i], n)) return name + n;
    }
    return NULL;
}

/* dtype(descriptor, align, copy) */
static value *make_dtype(builder *b, value *arguments) {
    value *v = pickle_record(b, "numpy.dtype", arguments);
    if (!v) return NULL;
    object *o = object_of(v);
    o->role = ROLE_DTYPE;
    o->numpy = (numpy_type){.kind = 'V'};
    const value *text = value_at(arguments, 0);
    if (text && text->kind == VALUE_STRING) {
        numpy_type t;
        if (numpy_type_parse(text->string.text, text->string.length, &t)) o->numpy = t;
    }
    return v;
}

/* State of a dtype: (version, byte order, subtype, names, fields, ...). */
static bool set_dtype(value *v, const value *state) {
    const value *order = value_at(state, 1), *names = value_at(state, 3);
    if (value_is_string(order, ">")) object_of(v)->numpy.big_endian = true;
    if (names && names->kind != VALUE_NONE) object_of(v)->numpy.kind = 'V';
    return true;
}

static bool dtype_of(const value *v, numpy_type *out) {
    if (!v || ((const object *)v)->role != ROLE_DTYPE) return false;
    *out = ((const object *)v)->numpy;
    return true;
}

static bool is_read(numpy_type t) {
    return t.kind == 'S' || t.kind == 'U' || t.kind == 'b' || (t.kind == 'u' && t.size <= 8) ||
           (t.kind == 'i' && t.size <= 8) || (t.kind == 'f' && t.size <= 8);
}

static value *array_of(builder *b, numpy_type t, value *shape, bool fortran, const value *data) {
    int rank;
    int64_t dim[8];
    if (!pickle_dims(shape, &rank, dim))
        return build_fail(b, SHERF_BAD_FILE, "pickle: an array without a shape");
    if (t.kind == 'O') {
        if (data->kind != VALUE_LIST)
            return build_fail(b, SHERF_BAD_FILE, "pickle: an object array without items");
        return numpy_objects(b, rank, dim, fortran, data->list.item, data->list.count);
    }
    if (!is_read(t)) { /* dates, complex numbers, structures: inert */
        value *v = pickle_record(b, "numpy.ndarray", NULL);
        if (v) v->record.arguments = shape;
        return v;
    }
    if (data->kind != VALUE_STRING) return build_fail(b, SHERF_BAD_FILE, "pickle: an array without data");
    return numpy_array(b, t, rank, dim, fortran, (const unsigned char *)data->string.text,
                       data->string.length);
}

/* State of an array: (version, shape, dtype, fortran, data); old files lack the version. */
static bool set_array(builder *b, value *v, const value *state) {
    size_t first = value_count(state) == 4 ? 0 : 1;
    numpy_type t;
    int64_t fortran;
    const value *data = value_at(state, first + 3);
    if (!data || !dtype_of(value_at(state, first + 1), &t) ||
        !pickle_integer(value_at(state, first + 2), &fortran)) {
        build_fail(b, SHERF_BAD_FILE, "pickle: an array whose state is not understood");
        return false;
    }
    value *made = array_of(b, t, pickle_item(state, first), fortran != 0, data);
    if (made) *v = *made;
    return made != NULL;
}

/* A number (or string) of numpy: one element. */
static value *make_scalar(builder *b, value *arguments) {
    numpy_type t;
    value *data = pickle_item(arguments, 1);
    if (!dtype_of(value_at(arguments, 0), &t) || !data)
        return build_fail(b, SHERF_BAD_FILE, "pickle: a numpy number that is not understood");
    if (t.kind == 'O') return data;
    if (!is_read(t) || data->kind != VALUE_STRING) return pickle_record(b, "numpy.generic", arguments);
    value *v =
        numpy_array(b, t, 0, NULL, false, (const unsigned char *)data->string.text, data->string.length);
    if (!v || v->kind != VALUE_ARRAY) return v;
    if (t.kind == 'b') return build_bool(b, *(uint8_t *)v->array.data);
    double real = 0;
    int64_t whole = 0;
    if (t.kind == 'f') {
        if (value_doubles(b->c, v, "a numpy number", 1, &real) == SHERF_OK) return build_real(b, real);
        return v; /* not finite: stays an array of one */
    }
    value_integer(b->c, v, "a numpy number", &whole);
    return build_integer(b, whole);
}

static value *from_buffer(builder *b, const value *arguments) {
    numpy_type t;
    const value *data = value_at(arguments, 0), *order = value_at(arguments, 3);
    if (!data || !dtype_of(value_at(arguments, 1), &t))
        return build_fail(b, SHERF_BAD_FILE, "pickle: an array whose state is not understood");
    return array_of(b, t, pickle_item(arguments, 2), value_is_string(order, "F"), data);
}

value *pickle_call_numpy(builder *b, const char *name, value *function, value *arguments, bool *known) {
    const char *inner = multiarray(name);
    *known = true;
    if (inner && !strcmp(inner, "_reconstruct") && arguments->list.count >= 1)
        return pickle_record(b, "numpy.ndarray", arguments);
    if (inner && !strcmp(inner, "scalar") && arguments->list.count >= 2) return make_scalar(b, arguments);
    if (!strcmp(name, "numpy.dtype") && arguments->list.count >= 1) return make_dtype(b, arguments);
    if ((pickle_name_is(name, "numpy.core.numeric", "_frombuffer") ||
         pickle_name_is(name, "numpy._core.numeric", "_frombuffer")) &&
        arguments->list.count >= 3)
        return from_buffer(b, arguments);
    *known = false;
    return NULL;
}

/* ---------------------------------------------------------------- whole numbers ---------------------- */
static int64_t length_of(const value *v) {
    if (!v) return -1;
    if (v->kind == VALUE_LIST) return (int64_t)v->list.count;
    return v->kind == VALUE_ARRAY ? build_count(v->array.rank, v->array.dim) : -1;
}

static bool whole_at(const value *v, int64_t i, int64_t *out) {
    if (v->kind == VALUE_LIST) return pickle_integer(v->list.item[i], out);
    if (v->array.type == T_I32)
        *out = ((const int32_t *)v->array.data)[i];
    else if (v->array.type == T_I64)
        *out = ((const int64_t *)v->array.data)[i];
    else if (v->array.type == T_U8)
        *out = ((const uint8_t *)v->array.data)[i];
    else
        return false;
    return true;
}

/* ---------------------------------------------------------------- joblib ----------------------------- */
const char pickle_joblib_class[] = "joblib.numpy_pickle.NumpyArrayWrapper";

/* Newer versions align the data: a byte gives the number of bytes to skip. */
value *pickle_joblib(builder *b, const value *state, const unsigned char *data, size_t left, size_t *used) {
    const value *aligned = value_get(state, "numpy_array_alignment_bytes");
    numpy_type t;
    int rank;
    int64_t dim[8], n, bytes;
    size_t skip = aligned && aligned->kind != VALUE_NONE && left ? 1 + (size_t)data[0] : 0;
    if (!dtype_of(value_get(state, "dtype"), &t) || !pickle_dims(value_get(state, "shape"), &rank, dim) ||
        !is_read(t))
        return build_fail(b, SHERF_BAD_FILE, "pickle: an array of joblib's that is not of plain numbers");
    n = build_count(rank, dim);
    if (n < 0 || __builtin_mul_overflow(n, t.size, &bytes) || skip > left || (uint64_t)bytes > left - skip)
        return build_fail(b, SHERF_BAD_FILE, "pickle: an array of joblib's is truncated");
    *used = skip + (size_t)bytes;
    return numpy_array(b, t, rank, dim, value_is_string(value_get(state, "order"), "F"), data + skip,
                       (size_t)bytes);
}

/* ---------------------------------------------------------------- scipy.sparse ----------------------- */
static const char *sparse_format(const char *class_name) {
    static const char *const format[] = {"csc", "csr", "coo"};
    const char *last = strrchr(class_name, '.');
    if (strncmp(class_name, "scipy.sparse.", 13) || !last) return NULL;
    for (size_t i = 0; i < COUNT_OF(format); i++)
        if (!strncmp(last + 1, format[i], 3) && (!strcmp(last + 4, "_matrix") || !strcmp(last + 4, "_array")))
            return format[i];
    return NULL;
}

static bool add_entry(value *dense, const value *data, int64_t k, int64_t row, int64_t column) {
    if (row < 0 || row >= dense->array.dim[0] || column < 0 || column >= dense->array.dim[1]) return false;
    double x = data->array.type == T_F32 ? ((const float *)data->array.data)[k]
                                         : ((const double *)data->array.data)[k];
    ((double *)dense->array.data)[row * dense->array.dim[1] + column] += x;
    return true;
}

/* csc: column j's entries are indptr[j] .. indptr[j + 1] - 1, rows in indices; csr the reverse. */
static bool fill_compressed(value *dense, const value *state, const value *data, int64_t n, bool by_column) {
    const value *indices = value_get(state, "indices"), *indptr = value_get(state, "indptr");
    int64_t lines = dense->array.dim[by_column ? 1 : 0], begin = 0, end, other;
    if (length_of(indices) < n || length_of(indptr) != lines + 1) return false;
    if (!whole_at(indptr, 0, &begin) || begin < 0) return false;
    for (int64_t j = 0; j < lines; j++, begin = end) {
        if (!whole_at(indptr, j + 1, &end) || end < begin || end > n) return false;
        for (int64_t k = begin; k < end; k++)
            if (!whole_at(indices, k, &other) ||
                !add_entry(dense, data, k, by_column ? other : j, by_column ? j : other))
                return false;
    }
    return true;
}

static bool fill_coordinates(value *dense, const value *state, const value *data, int64_t n) {
    const value *coords = value_get(state, "coords"), *row = value_get(state, "row"), *column;
    column = value_get(state, "col");
    if (coords) {
        row = value_at(coords, 0);
        column = value_at(coords, 1);
    }
    int64_t i, j;
    if (length_of(row) < n || length_of(column) < n) return false;
    for (int64_t k = 0; k < n; k++)
        if (!whole_at(row, k, &i) || !whole_at(column, k, &j) || !add_entry(dense, data, k, i, j))
            return false;
    return true;
}

static bool set_sparse(builder *b, value *v, const char *format, const value *state) {
    int rank;
    int64_t dim[8];
    const value *data = value_get(state, "data"), *shape = value_get(state, "_shape");
    if (!shape) shape = value_get(state, "shape");
    bool right = data && data->kind == VALUE_ARRAY &&
                 (data->array.type == T_F64 || data->array.type == T_F32) && pickle_dims(shape, &rank, dim) &&
                 rank == 2;
    value *dense = right ? build_array(b, T_F64, 2, dim) : NULL;
    if (dense) {
        int64_t n = length_of(data);
        memset(dense->array.data, 0, (size_t)build_count(2, dim) * sizeof(double));
        right = !strcmp(format, "coo") ? fill_coordinates(dense, state, data, n)
                                       : fill_compressed(dense, state, data, n, !strcmp(format, "csc"));
        if (right) *v = *dense;
    }
    if (!right)
        build_fail(b, SHERF_BAD_FILE, "pickle: %s is not a right sparse matrix", v->record.class_name);
    return right && dense;
}

/* ---------------------------------------------------------------- chumpy ----------------------------- */
/* Select: a.ravel()[idxs].reshape(preferred_shape) */
static value *chumpy_select(builder *b, const value *a, const value *state) {
    const value *places = value_get(state, "idxs");
    int64_t n = length_of(places), total = length_of(a), at, dim[8] = {n};
    int rank = 1;
    if (n < 0) return NULL;
    if (pickle_dims(value_get(state, "preferred_shape"), &rank, dim) ? build_count(rank, dim) != n
                                                                     : (rank = 1, dim[0] = n, false))
        return NULL;
    value *v = build_array(b, a->array.type, rank, dim);
    size_t size = dtype_size(a->array.type);
    for (int64_t i = 0; v && i < n; i++) {
        if (!whole_at(places, i, &at) || at < -total || at >= total) return NULL;
        if (at < 0) at += total;
        memcpy((char *)v->array.data + (size_t)i * size, (const char *)a->array.data + (size_t)at * size,
               size);
    }
    return v;
}

static value *chumpy_transpose(builder *b, const value *a, const value *state) {
    int rank = a->array.rank, given = 0;
    int64_t axis[8], dim[8], step[8], index[8] = {0};
    bool seen[8] = {false};
    if (!pickle_dims(value_get(state, "axes"), &given, axis) || !given)
        for (int i = 0; i < rank; i++) axis[i] = rank - 1 - i;
    else if (given != rank)
        return NULL;
    for (int i = 0; i < rank; i++) {
        if (axis[i] < 0) axis[i] += rank;
        if (axis[i] < 0 || axis[i] >= rank || seen[axis[i]]) return NULL;
        seen[axis[i]] = true;
        dim[i] = a->array.dim[axis[i]];
        step[i] = 1;
        for (int64_t k = axis[i] + 1; k < rank; k++) step[i] *= a->array.dim[k];
    }
    value *v = build_array(b, a->array.type, rank, dim);
    size_t size = dtype_size(a->array.type);
    int64_t n = build_count(rank, dim);
    for (int64_t i = 0; v && i < n; i++) {
        int64_t at = 0;
        for (int k = 0; k < rank; k++) at += index[k] * step[k];
        memcpy((char *)v->array.data + (size_t)i * size, (const char *)a->array.data + (size_t)at * size,
               size);
        for (int k = rank - 1; k >= 0 && ++index[k] == dim[k]; k--) index[k] = 0;
    }
    return v;
}

static value *chumpy_reshape(builder *b, const value *a, const value *state) {
    int rank, open = -1;
    int64_t dim[8], n = length_of(a), rest;
    if (!pickle_dims(value_get(state, "newshape"), &rank, dim)) return NULL;
    for (int i = 0; i < rank; i++)
        if (dim[i] == -1) {
            if (open >= 0) return NULL;
            open = i;
            dim[i] = 1;
        }
    rest = build_count(rank, dim);
    if (open >= 0 && rest > 0) {
        dim[open] = n / rest;
        rest = build_count(rank, dim);
    }
    if (rest != n) return NULL;
    value *v = build_array(b, a->array.type, rank, dim);
    if (v) memcpy(v->array.data, a->array.data, (size_t)n * dtype_size(a->array.type));
    return v;
}

/* Ch holds its array in x; Select, transpose and Reshape hold another array in a. Others stay records. */
static void set_chumpy(builder *b, value *v, const value *state) {
    const char *name = strrchr(v->record.class_name, '.') + 1;
    const value *x = value_get(state, "x"), *a = value_get(state, "a");
    const value *made = NULL;
    if (!strcmp(name, "Ch"))
        made = x;
    else if (a && a->kind == VALUE_ARRAY && !strcmp(name, "Select"))
        made = chumpy_select(b, a, state);
    else if (a && a->kind == VALUE_ARRAY && !strcasecmp(name, "transpose"))
        made = chumpy_transpose(b, a, state);
    else if (a && a->kind == VALUE_ARRAY && !strcasecmp(name, "reshape"))
        made = chumpy_reshape(b, a, state);
    if (made && (made->kind == VALUE_ARRAY || made->kind == VALUE_REAL || made->kind == VALUE_INTEGER))
        *v = *made;
}

/* ---------------------------------------------------------------- states ----------------------------- */
bool pickle_state_numpy(builder *b, value *v, value *state, bool *known) {
    *known = true;
    if (object_of(v)->role == ROLE_DTYPE) return set_dtype(v, state);
    if (v->kind != VALUE_RECORD || object_of(v)->role != ROLE_PLAIN) {
        *known = false;
        return true;
    }
    if (!strcmp(v->record.class_name, "numpy.ndarray")) return set_array(b, v, state);
    const char *format = sparse_format(v->record.class_name);
    if (format) return set_sparse(b, v, format, state);
    if (!strncmp(v->record.class_name, "chumpy.", 7)) {
        value *kept = state;
        v->record.state = kept;
        set_chumpy(b, v, state);
        return b->status == SHERF_OK;
    }
    *known = false;
    return true;
}
