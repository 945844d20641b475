/* Lower bounds of the distance from ground: machine/clusters/height_bounds.py. */
#include "rings.h"

static int is_float_block(PyObject *object, const char *name, npy_intp rows, npy_intp columns)
{
    if (is_array(object, name, NPY_FLOAT, 2) < 0)
        return 0;
    PyArrayObject *array = (PyArrayObject *)object;
    if (PyArray_IS_C_CONTIGUOUS(array) && PyArray_DIM(array, 0) == rows && PyArray_DIM(array, 1) == columns)
        return 1;
    PyErr_Format(PyExc_ValueError, "%s: %zd rows of %zd in one piece are wanted", name, (Py_ssize_t)rows,
                 (Py_ssize_t)columns);
    return 0;
}

static int are_counts(const npy_intp *counts)
{
    const npy_intp most = (npy_intp)1 << 30; /* so that their product is a number */
    if (counts[0] >= 0 && counts[1] >= 0 && counts[0] < most && counts[1] < most)
        return 0;
    PyErr_SetString(PyExc_ValueError, "counts: are below 0 or too large");
    return -1;
}

/* The last seven arguments of `lower_over_heights`; 0, or -1 with an exception. */
int read_rings(PyObject *const *args, Rings *rings)
{
    Vec low, per_cell;
    Mat box;
    npy_intp axes[1];
    if (as_vec(args[0], "low", 2, &low) < 0 || as_vec(args[1], "per_cell", 2, &per_cell) < 0 ||
        !(rings->counts = index_block(args[2], "counts", 1, axes)) || has_length(axes[0], 2, "counts") < 0 ||
        are_counts(rings->counts) < 0 || as_vec(args[4], "squared_aside", -1, &rings->squares) < 0 ||
        !is_float_block(args[3], "highest", rings->counts[0] * rings->counts[1], rings->squares.n) ||
        as_double(args[5], "furthest", &rings->furthest) < 0 || as_mat(args[6], "bounds", 2, 3, &box) < 0)
        return -1;
    rings->highest = PyArray_DATA((PyArrayObject *)args[3]);
    for (int c = 0; c < 2; c++)
        rings->low[c] = AT(low, c), rings->per_cell[c] = AT(per_cell, c);
    for (int c = 0; c < 6; c++)
        rings->box[c] = AT2(box, c / 3, c % 3);
    return 0;
}

/* What is known of the distance of a point in the frame of the ground. */
double lower_by_rings(const Rings *rings, const double *point)
{
    double off = 0.0;
    for (int c = 0; c < 3; c++) {
        const double away = gap_between(point[c], point[c], rings->box[c], rings->box[3 + c]);
        off += away * away;
    }
    const double x = (point[0] - rings->low[0]) * rings->per_cell[0];
    const double y = (point[1] - rings->low[1]) * rings->per_cell[1];
    if (!(x >= 0.0 && x < (double)rings->counts[0] && y >= 0.0 && y < (double)rings->counts[1]))
        return sqrt(off);
    const float *highest = rings->highest + ((npy_intp)x * rings->counts[1] + (npy_intp)y) * rings->squares.n;
    double least = INFINITY;
    for (npy_intp ring = 0; ring < rings->squares.n; ring++) {
        const double above = fmax(point[2] - highest[ring], 0.0), square = above * above + AT(rings->squares, ring);
        if (square < least)
            least = square;
    }
    return fmax(sqrt(off), fmin(sqrt(least), rings->furthest));
}

PyObject *lower_over_heights(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat points;
    Rings rings;
    double *lower;
    if (count_is(count, 8, "lower_over_heights") < 0 || as_mat(args[0], "points", 3, -1, &points) < 0 ||
        read_rings(args + 1, &rings) < 0)
        return NULL;
    PyObject *found = new_vec(points.columns, &lower);
    for (npy_intp k = 0; found && k < points.columns; k++) {
        const double point[3] = {AT2(points, 0, k), AT2(points, 1, k), AT2(points, 2, k)};
        lower[k] = lower_by_rings(&rings, point);
    }
    return found;
}
