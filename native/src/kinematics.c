/* What follows from the placements of the joints. */
#include "arrays.h"

PyObject *placed_arrays(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat origins, J;
    Vec tip;
    if (count_is(count, 3, "placed_arrays") < 0 || as_mat(args[0], "J", 6, -1, &J) < 0 ||
        as_mat(args[1], "origins", J.columns, 3, &origins) < 0 || as_vec(args[2], "tip", 3, &tip) < 0)
        return NULL;
    const npy_intp n = J.columns;
    double *point, *world;
    PyObject *points = new_mat(n + 1, 3, &point), *copy = new_mat(6, n, &world);
    if (!points || !copy) {
        Py_XDECREF(points), Py_XDECREF(copy);
        return NULL;
    }
    for (int c = 0; c < 3; c++) {
        for (npy_intp i = 0; i < n; i++)
            point[3 * i + c] = AT2(origins, i, c);
        point[3 * n + c] = AT(tip, c);
    }
    for (int c = 0; c < 6; c++)
        for (npy_intp j = 0; j < n; j++)
            world[n * c + j] = AT2(J, c, j);
    return Py_BuildValue("NN", copy, points);
}

PyObject *keep_placements(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat J, into;
    if (count_is(count, 4, "keep_placements") < 0 || as_mat(args[1], "J", 6, -1, &J) < 0 ||
        as_out(args[3], "own_J", 6, J.columns, &into) < 0 || is_array(args[0], "poses", NPY_DOUBLE, 3) < 0 ||
        is_array(args[2], "own_poses", NPY_DOUBLE, 3) < 0 || is_writeable(args[2], "own_poses") < 0)
        return NULL;
    PyArrayObject *poses = (PyArrayObject *)args[0], *own = (PyArrayObject *)args[2];
    if (PyArray_DIM(own, 0) != PyArray_DIM(poses, 0) || PyArray_DIM(poses, 1) != 3 || PyArray_DIM(own, 1) != 3 ||
        PyArray_DIM(poses, 2) != 4 || PyArray_DIM(own, 2) != 4) {
        PyErr_SetString(PyExc_ValueError, "poses, own_poses: arrays (joints, 3, 4) are wanted");
        return NULL;
    }
    for (npy_intp i = 0; i < PyArray_DIM(poses, 0); i++)
        for (npy_intp r = 0; r < 3; r++)
            for (npy_intp c = 0; c < 4; c++)
                *(double *)PyArray_GETPTR3(own, i, r, c) = *(double *)PyArray_GETPTR3(poses, i, r, c);
    for (npy_intp c = 0; c < 6; c++)
        for (npy_intp j = 0; j < J.columns; j++)
            AT2(into, c, j) = AT2(J, c, j);
    Py_RETURN_NONE;
}

PyObject *place_tip(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat pose, J, to, jacobian;
    Vec tip;
    double *at;
    if (count_is(count, 5, "place_tip") < 0 || as_mat(args[0], "pose", 4, 4, &pose) < 0 ||
        as_vec(args[1], "tip", 4, &tip) < 0 || as_mat(args[2], "J", 6, -1, &J) < 0 ||
        as_out(args[3], "to_tip", 6, 6, &to) < 0 || as_out(args[4], "jacobian", 6, J.columns, &jacobian) < 0)
        return NULL;
    PyObject *position = new_vec(3, &at);
    if (!position)
        return NULL;
    for (int c = 0; c < 3; c++) {
        at[c] = 0.0;
        for (int d = 0; d < 4; d++)
            at[c] += AT2(pose, c, d) * AT(tip, d);
    }
    AT2(to, 0, 4) = at[2], AT2(to, 0, 5) = -at[1], AT2(to, 1, 3) = -at[2];
    AT2(to, 1, 5) = at[0], AT2(to, 2, 3) = at[1], AT2(to, 2, 4) = -at[0];
    for (npy_intp j = 0; j < J.columns; j++) {
        double t[6];
        for (int c = 0; c < 6; c++)
            t[c] = AT2(J, c, j);
        AT2(jacobian, 0, j) = t[0] + t[4] * at[2] - t[5] * at[1];
        AT2(jacobian, 1, j) = t[1] + t[5] * at[0] - t[3] * at[2];
        AT2(jacobian, 2, j) = t[2] + t[3] * at[1] - t[4] * at[0];
        for (int c = 3; c < 6; c++)
            AT2(jacobian, c, j) = t[c];
    }
    return position;
}
