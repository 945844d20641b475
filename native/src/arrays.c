#include "arrays.h"

#include <math.h>

int is_array(PyObject *object, const char *name, int kind, int axes)
{
    PyArrayObject *array = (PyArrayObject *)object;
    if (!PyArray_Check(object) || PyArray_TYPE(array) != kind || PyArray_NDIM(array) != axes ||
        !PyArray_ISALIGNED(array) || !PyArray_ISNOTSWAPPED(array)) {
        PyErr_Format(PyExc_TypeError, "%s: an array of %s with %d axes is wanted", name,
                     kind == NPY_DOUBLE ? "float64" : kind == NPY_FLOAT ? "float32" : kind == NPY_BOOL ? "bool"
                     : kind == NPY_INT ? "int32" : "intp", axes);
        return -1;
    }
    return 0;
}

int is_writeable(PyObject *object, const char *name)
{
    if (PyArray_ISWRITEABLE((PyArrayObject *)object))
        return 0;
    PyErr_Format(PyExc_ValueError, "%s: is read-only", name);
    return -1;
}

int has_length(npy_intp found, npy_intp wanted, const char *name)
{
    if (wanted >= 0 && found != wanted) {
        PyErr_Format(PyExc_ValueError, "%s: has length %zd, not %zd", name, (Py_ssize_t)found, (Py_ssize_t)wanted);
        return -1;
    }
    return 0;
}

int as_vec(PyObject *object, const char *name, npy_intp length, Vec *out)
{
    if (is_array(object, name, NPY_DOUBLE, 1) < 0)
        return -1;
    PyArrayObject *array = (PyArrayObject *)object;
    out->data = PyArray_BYTES(array);
    out->n = PyArray_DIM(array, 0);
    out->step = PyArray_STRIDE(array, 0);
    return has_length(out->n, length, name);
}

int as_mat(PyObject *object, const char *name, npy_intp rows, npy_intp columns, Mat *out)
{
    if (is_array(object, name, NPY_DOUBLE, 2) < 0)
        return -1;
    PyArrayObject *array = (PyArrayObject *)object;
    out->data = PyArray_BYTES(array);
    out->rows = PyArray_DIM(array, 0);
    out->columns = PyArray_DIM(array, 1);
    out->down = PyArray_STRIDE(array, 0);
    out->right = PyArray_STRIDE(array, 1);
    if (has_length(out->rows, rows, name) < 0)
        return -1;
    return has_length(out->columns, columns, name);
}

static const void *in_one_piece(PyObject *object, const char *name, int kind, int axes, npy_intp *shape)
{
    PyArrayObject *array = (PyArrayObject *)object;
    if (is_array(object, name, kind, axes) < 0)
        return NULL;
    if (!PyArray_IS_C_CONTIGUOUS(array)) {
        PyErr_Format(PyExc_TypeError, "%s: is not in one piece", name);
        return NULL;
    }
    for (int axis = 0; axis < axes; axis++)
        shape[axis] = PyArray_DIM(array, axis);
    return PyArray_DATA(array);
}

const double *block(PyObject *object, const char *name, int axes, npy_intp *shape)
{
    return in_one_piece(object, name, NPY_DOUBLE, axes, shape);
}

const npy_intp *index_block(PyObject *object, const char *name, int axes, npy_intp *shape)
{
    return in_one_piece(object, name, NPY_INTP, axes, shape);
}

int as_flags(PyObject *object, const char *name, npy_intp length, Flg *out)
{
    if (is_array(object, name, NPY_BOOL, 1) < 0)
        return -1;
    PyArrayObject *array = (PyArrayObject *)object;
    out->data = PyArray_BYTES(array);
    out->n = PyArray_DIM(array, 0);
    out->step = PyArray_STRIDE(array, 0);
    return has_length(out->n, length, name);
}

int as_out(PyObject *object, const char *name, npy_intp rows, npy_intp columns, Mat *out)
{
    return as_mat(object, name, rows, columns, out) < 0 ? -1 : is_writeable(object, name);
}

static int as_indices(PyObject *object, const char *name, Ind *out)
{
    if (is_array(object, name, NPY_INTP, 1) < 0)
        return -1;
    PyArrayObject *array = (PyArrayObject *)object;
    out->data = PyArray_BYTES(array);
    out->n = PyArray_DIM(array, 0);
    out->step = PyArray_STRIDE(array, 0);
    return 0;
}

static int is_below(npy_intp index, npy_intp below, const char *name)
{
    if (index >= 0 && index < below)
        return 0;
    PyErr_Format(PyExc_IndexError, "%s: %zd is not below %zd", name, (Py_ssize_t)index, (Py_ssize_t)below);
    return -1;
}

int as_ind(PyObject *object, const char *name, npy_intp below, Ind *out)
{
    if (as_indices(object, name, out) < 0)
        return -1;
    for (npy_intp i = 0; i < out->n; i++)
        if (is_below(INDEX(*out, i), below, name) < 0)
            return -1;
    return 0;
}

int as_rows(PyObject *object, const char *name, npy_intp below, npy_intp length, const Ind *pairs, Ind *out)
{
    if (!pairs->n)
        return as_ind(object, name, below, out) < 0 ? -1 : has_length(out->n, length, name);
    if (as_indices(object, name, out) < 0 || has_length(out->n, length, name) < 0)
        return -1;
    for (npy_intp k = 0; k < pairs->n; k++)
        if (is_below(INDEX(*out, INDEX(*pairs, k)), below, name) < 0)
            return -1;
    return 0;
}

int as_double(PyObject *object, const char *name, double *out)
{
    *out = PyFloat_AsDouble(object);
    if (*out == -1.0 && PyErr_Occurred()) {
        PyErr_Format(PyExc_TypeError, "%s: a number is wanted", name);
        return -1;
    }
    return 0;
}

int as_doubles(PyObject *tuple, const char *name, Py_ssize_t count, double *out)
{
    if (!PyTuple_Check(tuple) || PyTuple_GET_SIZE(tuple) != count) {
        PyErr_Format(PyExc_TypeError, "%s: a tuple of %zd numbers is wanted", name, count);
        return -1;
    }
    for (Py_ssize_t i = 0; i < count; i++)
        if (as_double(PyTuple_GET_ITEM(tuple, i), name, out + i) < 0)
            return -1;
    return 0;
}

int as_table(PyObject *tuple, const char *name, Py_ssize_t rows, Py_ssize_t columns, double *out)
{
    if (!PyTuple_Check(tuple) || PyTuple_GET_SIZE(tuple) != rows) {
        PyErr_Format(PyExc_TypeError, "%s: a tuple of %zd tuples is wanted", name, rows);
        return -1;
    }
    for (Py_ssize_t i = 0; i < rows; i++)
        if (as_doubles(PyTuple_GET_ITEM(tuple, i), name, columns, out + columns * i) < 0)
            return -1;
    return 0;
}

int some_joints(npy_intp n)
{
    if (n >= 1 && n <= MOST_JOINTS)
        return 0;
    PyErr_Format(joints_beyond, "1 to %d joints are wanted, not %zd", MOST_JOINTS, (Py_ssize_t)n);
    return -1;
}

int count_is(Py_ssize_t given, Py_ssize_t wanted, const char *function)
{
    if (given == wanted)
        return 0;
    PyErr_Format(PyExc_TypeError, "%s takes %zd arguments, not %zd", function, wanted, given);
    return -1;
}

PyObject *new_vec(npy_intp n, double **data)
{
    PyObject *array = PyArray_EMPTY(1, &n, NPY_DOUBLE, 0);
    if (array)
        *data = (double *)PyArray_DATA((PyArrayObject *)array);
    return array;
}

PyObject *new_mat(npy_intp rows, npy_intp columns, double **data)
{
    npy_intp shape[2] = {rows, columns};
    PyObject *array = PyArray_EMPTY(2, shape, NPY_DOUBLE, 0);
    if (array)
        *data = (double *)PyArray_DATA((PyArrayObject *)array);
    return array;
}

PyObject *new_ind(npy_intp n, npy_intp **data)
{
    PyObject *array = PyArray_EMPTY(1, &n, NPY_INTP, 0);
    if (array)
        *data = (npy_intp *)PyArray_DATA((PyArrayObject *)array);
    return array;
}

PyObject *ind_of(const npy_intp *values, npy_intp n)
{
    npy_intp *data;
    PyObject *array = new_ind(n, &data);
    if (array)
        memcpy(data, values, n * sizeof(npy_intp));
    return array;
}

void *room_for(Room *room, size_t bytes)
{
    room->many = NULL;
    if (bytes <= sizeof(room->few))
        return room->few;
    room->many = PyMem_Malloc(bytes);
    if (!room->many)
        PyErr_NoMemory();
    return room->many;
}

void release(Room *room)
{
    if (room->many)
        PyMem_Free(room->many);
}

int cholesky(double *A, int n)
{
    for (int j = 0; j < n; j++) {
        double d = A[n * j + j];
        for (int k = 0; k < j; k++)
            d -= A[n * j + k] * A[n * j + k];
        if (!(d > 0.0))
            return -1;
        d = sqrt(d);
        A[n * j + j] = d;
        for (int i = j + 1; i < n; i++) {
            double s = A[n * i + j];
            for (int k = 0; k < j; k++)
                s -= A[n * i + k] * A[n * j + k];
            A[n * i + j] = s / d;
        }
    }
    return 0;
}

void solve_cholesky(const double *L, int n, double *b)
{
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < i; k++)
            b[i] -= L[n * i + k] * b[k];
        b[i] /= L[n * i + i];
    }
    for (int i = n - 1; i >= 0; i--) {
        for (int k = i + 1; k < n; k++)
            b[i] -= L[n * k + i] * b[k];
        b[i] /= L[n * i + i];
    }
}

int eigenvectors(double *A, int n, double *U)
{
    double size = 0.0;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            U[n * i + j] = i == j;
            size += A[n * i + j] * A[n * i + j];
        }
    for (int sweep = 0; sweep < 30; sweep++) {
        double off = 0.0;
        for (int p = 0; p < n; p++)
            for (int q = p + 1; q < n; q++)
                off += A[n * p + q] * A[n * p + q];
        /* 1e-15 of A, of which its own rounding leaves as much: where eigenvalues are equal it gets no less */
        if (!(off > 1e-30 * size))
            return off <= 1e-30 * size ? 0 : -1;
        for (int p = 0; p < n; p++)
            for (int q = p + 1; q < n; q++) {
                if (A[n * p + q] == 0.0)
                    continue;
                const double half = 0.5 * (A[n * q + q] - A[n * p + p]) / A[n * p + q];
                const double t = copysign(1.0, half) / (fabs(half) + sqrt(half * half + 1.0));
                const double c = 1.0 / sqrt(t * t + 1.0), s = t * c;
                for (int k = 0; k < n; k++) {
                    const double x = A[n * k + p], y = A[n * k + q];
                    A[n * k + p] = c * x - s * y, A[n * k + q] = s * x + c * y;
                }
                for (int k = 0; k < n; k++) {
                    const double x = A[n * p + k], y = A[n * q + k];
                    A[n * p + k] = c * x - s * y, A[n * q + k] = s * x + c * y;
                }
                for (int k = 0; k < n; k++) {
                    const double x = U[n * k + p], y = U[n * k + q];
                    U[n * k + p] = c * x - s * y, U[n * k + q] = s * x + c * y;
                }
            }
    }
    return -1;
}
