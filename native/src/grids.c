/* Lower bounds of distances on a grid: machine/clusters/distance_grid.py, site/pairs/beside_solids.py. */
#include "grids.h"
#include "cells.h"

#include <math.h>

int read_frame(PyObject *const *args, Frame *frame)
{
    Ind counts;
    if (as_three(args[0], "low", frame->low) < 0 || as_double(args[1], "per_step", &frame->per_step) < 0 ||
        as_numbers(args[2], "counts", 3, &counts) < 0)
        return -1;
    for (int c = 0; c < 3; c++)
        frame->counts[c] = INDEX(counts, c);
    return 0;
}

int has_cells(npy_intp length, const Frame *frame)
{
    npy_intp all = 1;
    for (int c = 0; c < 3; c++)
        all = frame->counts[c] > 0 && all <= length ? all * frame->counts[c] : 0;
    if (all > 0 && all == length)
        return 1;
    PyErr_SetString(PyExc_ValueError, "values: one for each cell is wanted");
    return 0;
}

int read_grid(PyObject *const *args, Grid *grid)
{
    Mat box;
    if (read_frame(args, &grid->frame) < 0 || is_array(args[3], "values", NPY_FLOAT, 1) < 0 ||
        as_mat(args[4], "bounds", 2, 3, &box) < 0)
        return -1;
    PyArrayObject *values = (PyArrayObject *)args[3];
    if (!has_cells(PyArray_DIM(values, 0), &grid->frame))
        return -1;
    grid->values = PyArray_BYTES(values), grid->step = PyArray_STRIDE(values, 0);
    for (int c = 0; c < 6; c++)
        grid->box[c] = AT2(box, c / 3, c % 3);
    return 0;
}

npy_intp cell_at(const Frame *frame, const double *point, int *inside)
{
    npy_intp place = 0;
    *inside = 1;
    for (int c = 0; c < 3; c++) {
        const double at = (point[c] - frame->low[c]) * frame->per_step, last = frame->counts[c] - 1e-9;
        *inside &= at >= 0.0 && at <= last;
        place = place * frame->counts[c] + (at > 0.0 ? (npy_intp)(at < last ? at : last) : 0);
    }
    return place;
}

double lower_at(const Grid *grid, const double *point)
{
    int inside;
    double off = 0.0;
    const npy_intp place = cell_at(&grid->frame, point, &inside);
    if (inside)
        return *(const float *)(grid->values + place * grid->step);
    for (int c = 0; c < 3; c++) {
        const double below = grid->box[c] - point[c], above = point[c] - grid->box[3 + c];
        const double away = below > above ? below : above;
        off += away > 0.0 ? away * away : 0.0;
    }
    return sqrt(off);
}

PyObject *lower_on_grid(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat points;
    Grid grid;
    double *lower;
    if (count_is(count, 6, "lower_on_grid") < 0 || as_mat(args[0], "points", 3, -1, &points) < 0 ||
        read_grid(args + 1, &grid) < 0)
        return NULL;
    PyObject *found = new_vec(points.columns, &lower);
    for (npy_intp k = 0; found && k < points.columns; k++) {
        const double point[3] = {AT2(points, 0, k), AT2(points, 1, k), AT2(points, 2, k)};
        lower[k] = lower_at(&grid, point);
    }
    return found;
}

/* A lower bound of how far away the piece of question k is, from balls around it; less where they may touch. */
static double least_of_balls(const Asked *asked, npy_intp k, const Grid *grid, const Balls *balls)
{
    const npy_intp piece = INDEX(asked->piece, k);
    double least = INFINITY;
    for (npy_intp i = INDEX(balls->starts, piece); i < INDEX(balls->starts, piece + 1); i++) {
        double centre[3];
        place_asked(asked, k, balls->ball + 4 * i, centre);
        const double apart = lower_at(grid, centre) - balls->ball[4 * i + 3];
        if (!(apart >= least))
            least = apart;
    }
    return least;
}

int read_covered(PyObject *const *args, Covered *covered)
{
    return read_asked(args, &covered->asked) < 0 || read_balls(args + OF_ASKED, &covered->asked, &covered->coarse) < 0 ||
                   read_balls(args + OF_ASKED + OF_BALLS, &covered->asked, &covered->fine) < 0 ||
                   read_grid(args + OF_ASKED + 2 * OF_BALLS, &covered->grid) < 0
               ? -1
               : 0;
}

double least_on_grid_of(const Covered *covered, npy_intp k)
{
    const double coarse = least_of_balls(&covered->asked, k, &covered->grid, &covered->coarse);
    if (coarse >= AT(covered->asked.number, k))
        return coarse;
    const double fine = least_of_balls(&covered->asked, k, &covered->grid, &covered->fine);
    return fine > coarse ? fine : coarse;
}

PyObject *least_on_grid(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Covered covered;
    double *least;
    if (count_is(count, OF_COVERED, "least_on_grid") < 0 || read_covered(args, &covered) < 0)
        return NULL;
    PyObject *found = new_vec(covered.asked.row.n, &least);
    for (npy_intp k = 0; found && k < covered.asked.row.n; k++)
        least[k] = least_on_grid_of(&covered, k);
    return found;
}
