/* Cells of clusters: which are near a link, and how far they reach. */
#include "cells.h"

#include <math.h>

int as_three(PyObject *object, const char *name, double *out)
{
    Vec three;
    if (as_vec(object, name, 3, &three) < 0)
        return -1;
    for (int c = 0; c < 3; c++)
        out[c] = AT(three, c);
    return 0;
}

static int as_box(PyObject *const *args, Box *box)
{
    Mat R;
    if (as_mat(args[0], "R", 3, 3, &R) < 0 || as_three(args[1], "middle", box->middle) < 0 ||
        as_three(args[2], "half", box->half) < 0 || as_double(args[3], "radius", &box->radius) < 0)
        return -1;
    for (int c = 0; c < 9; c++)
        box->R[c] = AT2(R, c / 3, c % 3);
    return 0;
}

double off_box(const Box *box, double x, double y, double z)
{
    double most = -INFINITY, sum = 0.0;
    for (int c = 0; c < 3; c++) {
        const double off = fabs(box->R[c] * x + box->R[3 + c] * y + box->R[6 + c] * z - box->middle[c]) - box->half[c];
        if (!(off <= most))
            most = off;
        if (!(off <= 0.0))
            sum += off * off;
    }
    return (most < 0.0 ? most : 0.0) + sqrt(sum) - box->radius;
}

PyObject *off_turned_box(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat points;
    Box box;
    double *off;
    if (count_is(count, 5, "off_turned_box") < 0 || as_mat(args[0], "points", 3, -1, &points) < 0 ||
        as_box(args + 1, &box) < 0)
        return NULL;
    PyObject *found = new_vec(points.columns, &off);
    for (npy_intp k = 0; found && k < points.columns; k++)
        off[k] = off_box(&box, AT2(points, 0, k), AT2(points, 1, k), AT2(points, 2, k));
    return found;
}

/* whole numbers that are no indices: there may be very many, and they are not looked at */
int as_numbers(PyObject *object, const char *name, npy_intp length, Ind *out)
{
    PyArrayObject *array = (PyArrayObject *)object;
    if (is_array(object, name, NPY_INTP, 1) < 0 || has_length(PyArray_DIM(array, 0), length, name) < 0)
        return -1;
    out->data = PyArray_BYTES(array), out->n = PyArray_DIM(array, 0), out->step = PyArray_STRIDE(array, 0);
    return 0;
}

/* the first of ascending numbers from `low` on that is not less: looked for near by before further away */
static npy_intp lower_bound(const Ind *numbers, npy_intp wanted, npy_intp low)
{
    npy_intp step = 1, high;
    for (; low + step <= numbers->n && INDEX(*numbers, low + step - 1) < wanted; step *= 2)
        low += step;
    high = low + step - 1 < numbers->n ? low + step - 1 : numbers->n;
    while (low < high) {
        const npy_intp middle = low + (high - low) / 2;
        if (INDEX(*numbers, middle) < wanted)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

int as_tiles(PyObject *const *args, Tiles *tiles)
{
    if (as_three(args[0], "origin", tiles->origin) < 0 || as_three(args[1], "spread", tiles->spread) < 0 ||
        as_double(args[2], "edge", &tiles->edge) < 0 || as_numbers(args[3], "counts", 3, &tiles->counts) < 0 ||
        as_numbers(args[4], "number", -1, &tiles->number) < 0 ||
        as_numbers(args[5], "start", tiles->number.n + 1, &tiles->start) < 0 ||
        as_mat(args[6], "middle", 3, tiles->number.n, &tiles->middle) < 0 ||
        as_vec(args[7], "size", tiles->number.n, &tiles->size) < 0)
        return -1;
    return 0;
}

npy_intp tiles_near(const Tiles *tiles, const double *low, const double *high, const Box *box, double reach, Room *room,
                    npy_intp **found)
{
    npy_intp first[3], last[3], near = 0;
    *found = room_for(room, 0);
    for (int c = 0; c < 3; c++) {
        const double from = floor((low[c] - tiles->spread[c] - tiles->origin[c]) / tiles->edge);
        const double to = floor((high[c] + tiles->spread[c] - tiles->origin[c]) / tiles->edge);
        const double most = (double)INDEX(tiles->counts, c) - 1.0;
        if (!(from <= most) || !(to >= 0.0))
            return 0;
        first[c] = from > 0.0 ? (npy_intp)from : 0, last[c] = (npy_intp)(to < most ? to : most);
        if (last[c] < first[c])
            return 0;
    }
    const npy_intp rows = INDEX(tiles->counts, 1), columns = INDEX(tiles->counts, 2);
    npy_intp tile = lower_bound(&tiles->number, (first[0] * rows + first[1]) * columns + first[2], 0);
    const npy_intp after = lower_bound(&tiles->number, (last[0] * rows + last[1]) * columns + last[2] + 1, tile);
    if (!(*found = room_for(room, (after - tile) * sizeof(npy_intp))))
        return -1;
    for (npy_intp x = first[0]; x <= last[0]; x++)
        for (npy_intp y = first[1]; y <= last[1]; y++) {
            const npy_intp column = (x * rows + y) * columns;
            tile = lower_bound(&tiles->number, column + first[2], tile);
            for (; tile < after && INDEX(tiles->number, tile) <= column + last[2]; tile++)
                if (off_box(box, AT2(tiles->middle, 0, tile), AT2(tiles->middle, 1, tile), AT2(tiles->middle, 2, tile)) -
                    AT(tiles->size, tile) <= reach)
                    (*found)[near++] = tile;
        }
    return near;
}

PyObject *cells_of_tiles(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    double low[3], high[3], reach;
    Tiles tiles;
    Box box;
    if (count_is(count, 15, "cells_of_tiles") < 0 || as_three(args[0], "low", low) < 0 ||
        as_three(args[1], "high", high) < 0 || as_tiles(args + 2, &tiles) < 0 || as_box(args + 10, &box) < 0 ||
        as_double(args[14], "reach", &reach) < 0)
        return NULL;
    Room room;
    npy_intp *found, *place, cells = 0;
    const npy_intp near = tiles_near(&tiles, low, high, &box, reach, &room, &found);
    if (near < 0)
        return NULL;
    for (npy_intp i = 0; i < near; i++) {
        const npy_intp more = INDEX(tiles.start, found[i] + 1) - INDEX(tiles.start, found[i]);
        cells += more > 0 ? more : 0;
    }
    PyObject *places = new_ind(cells, &place);
    for (npy_intp i = 0; places && i < near; i++)
        for (npy_intp cell = INDEX(tiles.start, found[i]); cell < INDEX(tiles.start, found[i] + 1); cell++)
            *place++ = cell;
    release(&room);
    return places;
}

int as_cells(PyObject *const *args, Cells *cells)
{
    if (as_vec(args[1], "half", -1, &cells->half) < 0 || as_mat(args[0], "middle", 3, cells->half.n, &cells->middle) < 0 ||
        is_array(args[2], "corners", NPY_DOUBLE, 3) < 0)
        return -1;
    PyArrayObject *corners = (PyArrayObject *)args[2];
    if (PyArray_DIM(corners, 0) != 3 || PyArray_DIM(corners, 1) != 3) {
        PyErr_SetString(PyExc_ValueError, "corners: an array (3, 3, triangles) is wanted");
        return -1;
    }
    cells->corners = PyArray_BYTES(corners), cells->cubes = cells->half.n;
    cells->all = cells->cubes + PyArray_DIM(corners, 2);
    for (int axis = 0; axis < 3; axis++)
        cells->step[axis] = PyArray_STRIDE(corners, axis);
    return 0;
}

static double along_corner(const Cells *cells, npy_intp triangle, int corner, const double *n)
{
    const char *at = cells->corners + triangle * cells->step[2] + corner * cells->step[0];
    return n[0] * *(const double *)at + n[1] * *(const double *)(at + cells->step[1]) +
           n[2] * *(const double *)(at + 2 * cells->step[1]);
}

PyObject *split_by_plane(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    double n[3], slack;
    Cells cells;
    if (count_is(count, 6, "split_by_plane") < 0 || as_three(args[0], "n", n) < 0 ||
        as_double(args[2], "slack", &slack) < 0 || as_cells(args + 3, &cells) < 0)
        return NULL;
    const npy_intp nearest = PyLong_AsSsize_t(args[1]), cubes = cells.cubes, all = cells.all;
    if (nearest == -1 && PyErr_Occurred())
        return NULL;
    if (nearest < 0 || nearest >= all) {
        PyErr_SetString(PyExc_IndexError, "nearest: is not one of the cells");
        return NULL;
    }
    Room room;
    double *along = room_for(&room, all * sizeof(double)), least = INFINITY;
    if (!along)
        return NULL;
    const double wide = fabs(n[0]) + fabs(n[1]) + fabs(n[2]);
    for (npy_intp k = 0; k < cubes; k++)
        along[k] = n[0] * AT2(cells.middle, 0, k) + n[1] * AT2(cells.middle, 1, k) + n[2] * AT2(cells.middle, 2, k) -
                   wide * AT(cells.half, k);
    for (npy_intp t = 0; t < cells.all - cells.cubes; t++) {
        along[cubes + t] = along_corner(&cells, t, 0, n);
        for (int corner = 1; corner < 3; corner++) {
            const double other = along_corner(&cells, t, corner, n);
            if (other < along[cubes + t])
                along[cubes + t] = other;
        }
    }
    const double plane = along[nearest], from = plane - slack;
    npy_intp some = 0, *own, *left;
    for (npy_intp k = 0; k < all; k++)
        if (along[k] >= from) {
            some++;
            if (along[k] < least)
                least = along[k];
        }
    PyObject *owns = new_ind(some, &own), *lefts = new_ind(all - some, &left);
    if (!owns || !lefts) {
        Py_XDECREF(owns), Py_XDECREF(lefts);
        release(&room);
        return NULL;
    }
    for (npy_intp k = 0; k < all; k++)
        if (along[k] >= from)
            *own++ = k;
        else
            *left++ = k;
    release(&room);
    return Py_BuildValue("NNd", owns, lefts, least < plane ? least - plane : 0.0);
}

PyObject *extent_along(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat axes;
    Cells cells;
    double *low, *high;
    if (count_is(count, 4, "extent_along") < 0 || as_mat(args[0], "axes", 3, 3, &axes) < 0 || as_cells(args + 1, &cells) < 0)
        return NULL;
    PyObject *lows = new_vec(3, &low), *highs = new_vec(3, &high);
    if (!lows || !highs) {
        Py_XDECREF(lows), Py_XDECREF(highs);
        return NULL;
    }
    for (int axis = 0; axis < 3; axis++) {
        const double n[3] = {AT2(axes, 0, axis), AT2(axes, 1, axis), AT2(axes, 2, axis)};
        const double wide = fabs(n[0]) + fabs(n[1]) + fabs(n[2]);
        double least = INFINITY, most = -INFINITY;
        for (npy_intp k = 0; k < cells.half.n; k++) {
            const double more = wide * AT(cells.half, k), at = n[0] * AT2(cells.middle, 0, k) +
                                                              n[1] * AT2(cells.middle, 1, k) + n[2] * AT2(cells.middle, 2, k);
            least = at - more < least ? at - more : least;
            most = at + more > most ? at + more : most;
        }
        for (npy_intp t = 0; t < cells.all - cells.cubes; t++)
            for (int corner = 0; corner < 3; corner++) {
                const double at = along_corner(&cells, t, corner, n);
                least = at < least ? at : least;
                most = at > most ? at : most;
            }
        low[axis] = least, high[axis] = most;
    }
    return Py_BuildValue("NN", lows, highs);
}
