/* What a step does to the bounds of all pairs: live/braking/odometers.py, and the line of a braking path. */
#include "arrays.h"

#include <math.h>

/* sum of travel (C, n) |moved|, added to an odometer: the most of these */
static double count_up(const Mat *travel, const Vec *moved, const Vec *odometer, double *came)
{
    double most = -INFINITY;
    for (npy_intp c = 0; c < travel->rows; c++) {
        double sum = 0.0;
        for (npy_intp j = 0; j < travel->columns; j++)
            sum += AT2(*travel, c, j) * fabs(AT(*moved, j));
        AT(*odometer, c) += sum;
        if (came)
            came[c] = sum;
        if (!(sum <= most)) /* what is no number is kept */
            most = sum;
    }
    return most;
}

PyObject *count_travel(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat travel;
    Vec moved, ends, bound, start, path, proven;
    Ind pairs, classes;
    double *came, most_on_path = 0.0;
    if (count_is(count, 9, "count_travel") < 0 || as_mat(args[0], "travel", -1, -1, &travel) < 0 ||
        as_vec(args[1], "moved", travel.columns, &moved) < 0 || as_vec(args[6], "start", travel.rows, &start) < 0 ||
        as_vec(args[7], "path", travel.rows, &path) < 0 || as_vec(args[8], "proven", -1, &proven) < 0 ||
        as_ind(args[3], "pairs", proven.n, &pairs) < 0 || as_vec(args[4], "bound", pairs.n, &bound) < 0 ||
        as_rows(args[5], "classes", travel.rows, proven.n, &pairs, &classes) < 0 ||
        is_writeable(args[6], "start") < 0 || is_writeable(args[7], "path") < 0 || is_writeable(args[8], "proven") < 0)
        return NULL;
    const int moves = args[2] != Py_None;
    if (moves && as_vec(args[2], "end_moved", travel.columns, &ends) < 0)
        return NULL;
    if (travel.rows < 1) {
        PyErr_SetString(PyExc_ValueError, "travel: has no row");
        return NULL;
    }
    PyObject *moved_by = new_vec(travel.rows, &came);
    if (!moved_by)
        return NULL;
    const double most = count_up(&travel, &moved, &start, came);
    if (moves) {
        most_on_path = count_up(&travel, &ends, &path, NULL);
        for (npy_intp k = 0; k < pairs.n; k++)
            AT(proven, INDEX(pairs, k)) = AT(bound, k) + AT(path, INDEX(classes, INDEX(pairs, k)));
    }
    return Py_BuildValue("Ndd", moved_by, most, most_on_path);
}

PyObject *keep_proven(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Ind pairs;
    Vec bound, clearance, required;
    Flg stands;
    if (count_is(count, 5, "keep_proven") < 0 || as_vec(args[4], "required", -1, &required) < 0 ||
        as_ind(args[0], "pairs", required.n, &pairs) < 0 || as_vec(args[1], "bound", pairs.n, &bound) < 0 ||
        as_vec(args[2], "clearance", required.n, &clearance) < 0 ||
        as_flags(args[3], "stands", required.n, &stands) < 0 || is_writeable(args[4], "required") < 0)
        return NULL;
    for (npy_intp k = 0; k < pairs.n; k++) {
        const npy_intp pair = INDEX(pairs, k);
        const double before = AT(required, pair), own = AT(bound, k);
        const double kept = FLAG(stands, pair) && before > own ? before : own;
        AT(required, pair) = kept < AT(clearance, pair) ? kept : AT(clearance, pair);
    }
    Py_RETURN_NONE;
}

PyObject *note_gaps(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Ind pairs;
    Vec lower, counted, clearance, distance;
    Mat least;
    double *found, *left;
    if (count_is(count, 6, "note_gaps") < 0 || as_vec(args[5], "distance", -1, &distance) < 0 ||
        as_ind(args[0], "pairs", distance.n, &pairs) < 0 || as_vec(args[1], "lower", pairs.n, &lower) < 0 ||
        as_vec(args[2], "counted", pairs.n, &counted) < 0 || as_mat(args[3], "least", pairs.n, -1, &least) < 0 ||
        as_vec(args[4], "clearance", distance.n, &clearance) < 0 || is_writeable(args[5], "distance") < 0)
        return NULL;
    if (least.columns < 1) {
        PyErr_SetString(PyExc_IndexError, "least: has no sample");
        return NULL;
    }
    PyObject *distances = new_vec(pairs.n, &found), *margins = new_vec(pairs.n, &left);
    if (!distances || !margins) {
        Py_XDECREF(distances), Py_XDECREF(margins);
        return NULL;
    }
    for (npy_intp k = 0; k < pairs.n; k++) {
        const npy_intp pair = INDEX(pairs, k);
        found[k] = AT(lower, k) > AT2(least, k, 0) ? AT(lower, k) : AT2(least, k, 0);
        AT(distance, pair) = AT(counted, k) + found[k];
        left[k] = found[k] - AT(clearance, pair);
    }
    return Py_BuildValue("NN", distances, margins);
}

PyObject *braking_line(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec q, v;
    double dt, acceleration[MOST_JOINTS], braking = -1.0, *delta, *end;
    int slowest = 0;
    if (count_is(count, 4, "braking_line") < 0 || as_vec(args[0], "q", -1, &q) < 0 || some_joints(q.n) < 0 ||
        as_vec(args[1], "v", q.n, &v) < 0 || as_double(args[2], "dt", &dt) < 0 ||
        as_doubles(args[3], "acceleration", q.n, acceleration) < 0)
        return NULL;
    for (int j = 0; j < (int)q.n; j++)
        if (fabs(AT(v, j)) / acceleration[j] > braking)
            braking = fabs(AT(v, j)) / acceleration[j], slowest = j;
    PyObject *deltas = new_vec(q.n, &delta), *ends = new_vec(q.n, &end);
    if (!deltas || !ends) {
        Py_XDECREF(deltas), Py_XDECREF(ends);
        return NULL;
    }
    const double look = dt + 0.5 * braking;
    for (npy_intp j = 0; j < q.n; j++)
        delta[j] = AT(v, j) * look, end[j] = AT(q, j) + delta[j];
    const double sharper = braking > 0.0 ? copysign(0.5 / acceleration[slowest], AT(v, slowest)) : 0.0;
    return Py_BuildValue("NNddid", deltas, ends, look, dt + braking, slowest, sharper);
}

PyObject *largest_part(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec v;
    double fastest[MOST_JOINTS], most = 1.0;
    if (count_is(count, 2, "largest_part") < 0 || as_vec(args[0], "v", -1, &v) < 0 || some_joints(v.n) < 0 ||
        as_doubles(args[1], "fastest", v.n, fastest) < 0)
        return NULL;
    for (npy_intp j = 0; j < v.n; j++)
        if (fabs(AT(v, j)) / fastest[j] > most)
            most = fabs(AT(v, j)) / fastest[j];
    return PyFloat_FromDouble(most);
}

PyObject *left_over_path(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Ind pairs;
    Vec bound, required;
    double tolerance, *left;
    if (count_is(count, 4, "left_over_path") < 0 || as_vec(args[2], "required", -1, &required) < 0 ||
        as_ind(args[0], "pairs", required.n, &pairs) < 0 || as_vec(args[1], "bound", pairs.n, &bound) < 0 ||
        as_double(args[3], "tolerance", &tolerance) < 0)
        return NULL;
    Room room;
    npy_intp *rows = room_for(&room, pairs.n * sizeof(npy_intp)), some = 0;
    if (!rows)
        return NULL;
    PyObject *lefts = new_vec(pairs.n, &left);
    for (npy_intp k = 0; lefts && k < pairs.n; k++) {
        left[k] = AT(bound, k) - AT(required, INDEX(pairs, k));
        if (left[k] < -tolerance)
            rows[some++] = k;
    }
    PyObject *shorts = lefts ? ind_of(rows, some) : NULL;
    release(&room);
    if (!shorts) {
        Py_XDECREF(lefts);
        return NULL;
    }
    return Py_BuildValue("NN", lefts, shorts);
}
