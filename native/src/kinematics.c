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

#define MOST_ROWS 7 /* of what is asked of a tip: its position, a rotation, a pitch */
#define LANES 8     /* equations that are solved side by side */

PyObject *damped_steps(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat error;
    Vec damping;
    if (count_is(count, 3, "damped_steps") < 0 || is_array(args[0], "J", NPY_DOUBLE, 3) < 0 ||
        as_vec(args[2], "damping", -1, &damping) < 0 || as_mat(args[1], "error", -1, damping.n, &error) < 0)
        return NULL;
    PyArrayObject *J = (PyArrayObject *)args[0];
    const npy_intp m = PyArray_DIM(J, 0), n = PyArray_DIM(J, 1), B = damping.n;
    if (m != error.rows || PyArray_DIM(J, 2) != B) {
        PyErr_SetString(PyExc_ValueError, "J, error, damping: arrays (m, n, B), (m, B) and (B,) are wanted");
        return NULL;
    }
    if (some_joints(n) < 0)
        return NULL;
    if (m > MOST_ROWS) {
        PyErr_Format(joints_beyond, "at most %d rows are wanted", MOST_ROWS);
        return NULL;
    }
    double *step, j[MOST_ROWS][MOST_JOINTS][LANES], square[MOST_ROWS][MOST_ROWS][LANES], x[MOST_ROWS][LANES];
    PyObject *steps = new_mat(n, B, &step);
    if (!steps)
        return NULL;
    for (npy_intp first = 0; first < B; first += LANES) {
        const npy_intp used = B - first < LANES ? B - first : LANES;
        double below[LANES];
        for (npy_intp a = 0; a < m; a++)
            for (int l = 0; l < LANES; l++) {
                const npy_intp b = first + (l < used ? l : used - 1);
                x[a][l] = AT2(error, a, b);
                for (npy_intp i = 0; i < n; i++)
                    j[a][i][l] = *(double *)PyArray_GETPTR3(J, a, i, b);
            }
        for (npy_intp a = 0; a < m; a++)
            for (npy_intp c = 0; c < m; c++) {
                for (int l = 0; l < LANES; l++)
                    square[a][c][l] = 0.0;
                for (npy_intp i = 0; i < n; i++)
                    for (int l = 0; l < LANES; l++)
                        square[a][c][l] += j[a][i][l] * j[c][i][l];
            }
        for (npy_intp a = 0; a < m; a++)
            for (int l = 0; l < LANES; l++)
                square[a][a][l] += AT(damping, first + (l < used ? l : used - 1));
        for (npy_intp row = 0; row < m; row++)
            for (npy_intp a = row + 1; a < m; a++) {
                for (int l = 0; l < LANES; l++)
                    below[l] = square[a][row][l] / square[row][row][l];
                for (npy_intp c = row + 1; c < m; c++)
                    for (int l = 0; l < LANES; l++)
                        square[a][c][l] -= below[l] * square[row][c][l];
                for (int l = 0; l < LANES; l++)
                    x[a][l] -= below[l] * x[row][l];
            }
        for (npy_intp row = m - 1; row >= 0; row--) {
            for (int l = 0; l < LANES; l++)
                x[row][l] /= square[row][row][l];
            for (npy_intp a = 0; a < row; a++)
                for (int l = 0; l < LANES; l++)
                    x[a][l] -= square[a][row][l] * x[row][l];
        }
        for (npy_intp i = 0; i < n; i++) {
            double sum[LANES] = {0.0};
            for (npy_intp a = 0; a < m; a++)
                for (int l = 0; l < LANES; l++)
                    sum[l] += j[a][i][l] * x[a][l];
            for (npy_intp l = 0; l < used; l++)
                step[B * i + first + l] = sum[l];
        }
    }
    return steps;
}

/* One axis of the world for one joint in all B configurations: the components along it of the rotation's columns
 * `now` and of the joint's axis and origin, from the columns `R` before the joint. */
static void place_row(const double *f, npy_intp B, int slides, const double *const R[3], const double *q,
                      const double *sine, const double *versine, const double *from, double *const now[3],
                      double *axis, double *origin)
{
    for (npy_intp b = 0; b < B; b++) {
        const double x = R[0][b], y = R[1][b], z = R[2][b];
        axis[b] = f[27] * x + f[28] * y + f[29] * z;
        origin[b] = from[b] + (f[30] * x + f[31] * y + f[32] * z);
    }
    if (slides) {
        for (npy_intp b = 0; b < B; b++)
            origin[b] += axis[b] * q[b];
        for (int c = 0; c < 3; c++)
            for (npy_intp b = 0; b < B; b++)
                now[c][b] = f[3 * c] * R[0][b] + f[3 * c + 1] * R[1][b] + f[3 * c + 2] * R[2][b];
        return;
    }
    for (int c = 0; c < 3; c++) {
        const double *still = f + 3 * c, *turned = f + 9 + 3 * c, *bent = f + 18 + 3 * c;
        for (npy_intp b = 0; b < B; b++) {
            const double x = R[0][b], y = R[1][b], z = R[2][b];
            now[c][b] = sine[b] * (turned[0] * x + turned[1] * y + turned[2] * z) +
                        (still[0] * x + still[1] * y + still[2] * z) +
                        versine[b] * (bent[0] * x + bent[1] * y + bent[2] * z);
        }
    }
}

static PyObject *new_array(int axes, const npy_intp *shape, double **data)
{
    PyObject *array = PyArray_EMPTY(axes, (npy_intp *)shape, NPY_DOUBLE, 0);
    if (array)
        *data = (double *)PyArray_DATA((PyArrayObject *)array);
    return array;
}

PyObject *chain_placements(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat q, sine, versine, tip, factors;
    Vec slides;
    if (count_is(count, 6, "chain_placements") < 0 || as_mat(args[0], "q", -1, -1, &q) < 0 ||
        as_mat(args[1], "sine", q.rows, q.columns, &sine) < 0 ||
        as_mat(args[2], "versine", q.rows, q.columns, &versine) < 0 ||
        as_mat(args[3], "factors", 33, q.rows, &factors) < 0 || as_vec(args[4], "slides", q.rows, &slides) < 0 ||
        as_mat(args[5], "tip", 4, 3, &tip) < 0)
        return NULL;
    const npy_intp n = q.rows, B = q.columns, each = sizeof(double);
    if (B > 1 && (q.right != each || sine.right != each || versine.right != each)) {
        PyErr_SetString(PyExc_ValueError, "q, sine, versine: the configurations have to lie side by side");
        return NULL;
    }
    double *axes = NULL, *origins = NULL, *rotations = NULL, *at = NULL, *turned = NULL;
    PyObject *found[5] = {
        new_array(3, (npy_intp[]){n, 3, B}, &axes), new_array(3, (npy_intp[]){n, 3, B}, &origins),
        new_array(4, (npy_intp[]){n, 3, 3, B}, &rotations), new_mat(3, B, &at),
        new_array(3, (npy_intp[]){3, 3, B}, &turned),
    };
    Room room;
    double *unit = room_for(&room, 2 * (B + 1) * sizeof(double)); /* B times 1, then B times 0 */
    if (!found[0] || !found[1] || !found[2] || !found[3] || !found[4] || !unit) {
        for (int i = 0; i < 5; i++)
            Py_XDECREF(found[i]);
        if (unit)
            release(&room);
        return NULL;
    }
    const double *nought = unit + B;
    for (npy_intp b = 0; b < B; b++)
        unit[b] = 1.0, unit[B + b] = 0.0;
    for (npy_intp j = 0; j < n; j++) {
        double f[33];
        for (int k = 0; k < 33; k++)
            f[k] = AT2(factors, k, j);
        for (int r = 0; r < 3; r++) {
            const double *R[3], *from = j ? origins + (3 * (j - 1) + r) * B : nought;
            double *now[3];
            for (int c = 0; c < 3; c++) {
                R[c] = j ? rotations + (9 * (j - 1) + 3 * c + r) * B : c == r ? unit : nought;
                now[c] = rotations + (9 * j + 3 * c + r) * B;
            }
            place_row(f, B, AT(slides, j) != 0.0, R, (const double *)(q.data + j * q.down),
                      (const double *)(sine.data + j * sine.down), (const double *)(versine.data + j * versine.down),
                      from, now, axes + (3 * j + r) * B, origins + (3 * j + r) * B);
        }
    }
    for (int r = 0; r < 3; r++) {
        const double *R[3], *from = n ? origins + (3 * (n - 1) + r) * B : nought;
        for (int c = 0; c < 3; c++)
            R[c] = n ? rotations + (9 * (n - 1) + 3 * c + r) * B : c == r ? unit : nought;
        for (int c = 0; c < 4; c++) {
            const double x = AT2(tip, c, 0), y = AT2(tip, c, 1), z = AT2(tip, c, 2);
            double *into = c < 3 ? turned + (3 * c + r) * B : at + r * B;
            for (npy_intp b = 0; b < B; b++)
                into[b] = (c < 3 ? 0.0 : from[b]) + (x * R[0][b] + y * R[1][b] + z * R[2][b]);
        }
    }
    release(&room);
    return Py_BuildValue("NNNNN", found[0], found[1], found[2], found[3], found[4]);
}
