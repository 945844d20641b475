/* The cells around a link in a few boxes: machine/clusters/cluster.py. */
#include "cells.h"

#include <math.h>
#include <string.h>

static double corner_of(const Cells *cells, npy_intp triangle, int corner, int c)
{
    return *(const double *)(cells->corners + corner * cells->step[0] + c * cells->step[1] + triangle * cells->step[2]);
}

/* the least and the most of n . x over a cell */
static void span(const Cells *cells, npy_intp cell, const double *n, double *least, double *most)
{
    if (cell < cells->cubes) {
        const double at = n[0] * AT2(cells->middle, 0, cell) + n[1] * AT2(cells->middle, 1, cell) +
                          n[2] * AT2(cells->middle, 2, cell);
        const double more = (fabs(n[0]) + fabs(n[1]) + fabs(n[2])) * AT(cells->half, cell);
        *least = at - more, *most = at + more;
        return;
    }
    *least = INFINITY, *most = -INFINITY;
    for (int corner = 0; corner < 3; corner++) {
        double at = 0.0;
        for (int c = 0; c < 3; c++)
            at += n[c] * corner_of(cells, cell - cells->cubes, corner, c);
        *least = at < *least ? at : *least;
        *most = at > *most ? at : *most;
    }
}

/* the corners of a cell, from `base` */
static npy_intp corners_of(const Cells *cells, npy_intp cell, const double *base, double *points)
{
    const int is_cube = cell < cells->cubes;
    for (int k = 0; k < (is_cube ? 8 : 3); k++)
        for (int c = 0; c < 3; c++)
            points[3 * k + c] =
                (is_cube ? AT2(cells->middle, c, cell) + (k >> c & 1 ? 1.0 : -1.0) * AT(cells->half, cell)
                         : corner_of(cells, cell - cells->cubes, k, c)) - base[c];
    return is_cube ? 8 : 3;
}

/* Columns of `axes`: the first along n, the second across it and as near as can be to one of those of R. */
static void frame_along(const double *n, const Mat *R, double *axes)
{
    double best = -1.0, across[3] = {0.0, 0.0, 0.0};
    for (int k = 0; k < 3; k++) {
        double way[3], along = 0.0, size = 0.0;
        for (int c = 0; c < 3; c++)
            along += AT2(*R, c, k) * n[c];
        for (int c = 0; c < 3; c++)
            way[c] = AT2(*R, c, k) - along * n[c], size += way[c] * way[c];
        if (size > best)
            best = size, memcpy(across, way, sizeof(across));
    }
    for (int c = 0; c < 3; c++)
        axes[3 * c] = n[c], axes[3 * c + 1] = across[c] / sqrt(best);
    for (int c = 0; c < 3; c++) {
        const int next = (c + 1) % 3, last = (c + 2) % 3;
        axes[3 * c + 2] = n[next] * axes[3 * last + 1] - n[last] * axes[3 * next + 1];
    }
}

enum { DISTANCE, NORMAL, POINT = NORMAL + 3, OTHER = POINT + 3, AXES = OTHER + 3, MIDDLE = AXES + 9, EDGES = MIDDLE + 3 };
enum { CORNERS = EDGES + 3, IS_CELL = CORNERS + 24, NUMBERS };

static void turn(const Mat *R, double *v)
{
    const double x = v[0], y = v[1], z = v[2];
    for (int c = 0; c < 3; c++)
        v[c] = AT2(*R, c, 0) * x + AT2(*R, c, 1) * y + AT2(*R, c, 2) * z;
}

/* Put what was found in the frame of the solid, with the box between `low` and `high`, where R and t say. */
static void place_box(double *box, const double *low, const double *high, const Mat *R, const Vec *t)
{
    static const int order[8] = {0, 4, 6, 2, 1, 5, 7, 3}; /* one rim, and then the other */
    double axes[9];
    memcpy(axes, box + AXES, sizeof(axes));
    for (int k = 0; k < 3; k++) {
        double axis[3] = {axes[k], axes[3 + k], axes[6 + k]};
        turn(R, axis);
        for (int c = 0; c < 3; c++)
            box[AXES + 3 * c + k] = axis[c];
        box[EDGES + k] = high[k] - low[k];
    }
    turn(R, box + NORMAL), turn(R, box + POINT), turn(R, box + OTHER);
    for (int c = 0; c < 3; c++) {
        const double *axis = box + AXES + 3 * c;
        box[POINT + c] += AT(*t, c), box[OTHER + c] += AT(*t, c), box[MIDDLE + c] = AT(*t, c);
        for (int k = 0; k < 3; k++)
            box[MIDDLE + c] += axis[k] * 0.5 * (low[k] + high[k]);
        for (int i = 0; i < 8; i++) {
            double *corner = box + CORNERS + 3 * i + c;
            *corner = box[MIDDLE + c];
            for (int k = 0; k < 3; k++)
                *corner += (order[i] >> (2 - k) & 1 ? 0.5 : -0.5) * axis[k] * box[EDGES + k];
        }
    }
}

/* One box, for the nearest of `count` cells, which are left with those that are not in it; -1 without an answer. */
static npy_intp take_box(const Cells *cells, npy_intp *those, npy_intp count, const Vec *off, const Finding *finding,
                         double *least, double *box)
{
    const double radius = finding->rules[0], slack = finding->rules[1];
    const double finest = finding->rules[2], beyond = finding->rules[3], *base = finding->base;
    double points[24], plane = INFINITY, first, most, lowest[3], highest[3];
    npy_intp nearest = those[0], left = 0;
    for (npy_intp i = 1; i < count; i++)
        if (AT(*off, those[i]) < AT(*off, nearest))
            nearest = those[i];
    const Hull cell = {points, corners_of(cells, nearest, base, points)};
    double *n = box + NORMAL;
    if (hull_distance(&finding->hull, &cell, box + DISTANCE, n, box + POINT, box + OTHER) < 0)
        return -1;
    const double distance = box[DISTANCE] - radius;
    if (!(distance > beyond))
        return -1;
    frame_along(n, &finding->R, box + AXES);
    for (int c = 0; c < 3; c++) {
        box[POINT + c] += base[c] + radius * n[c], box[OTHER + c] += base[c];
        lowest[c] = INFINITY, highest[c] = -INFINITY;
    }
    span(cells, nearest, n, &first, &most);
    const double from = first - (slack * distance + beyond);
    for (npy_intp i = 0; i < count; i++) {
        span(cells, those[i], n, least + i, &most);
        if (least[i] >= from && least[i] < plane)
            plane = least[i];
    }
    for (npy_intp i = 0; i < count; i++) {
        if (least[i] < from) {
            those[left++] = those[i];
            continue;
        }
        for (int axis = 0; axis < 3; axis++) {
            const double along[3] = {box[AXES + axis], box[AXES + 3 + axis], box[AXES + 6 + axis]};
            double low, high;
            span(cells, those[i], along, &low, &high);
            lowest[axis] = low < lowest[axis] ? low : lowest[axis];
            highest[axis] = high > highest[axis] ? high : highest[axis];
        }
    }
    for (int axis = 0; axis < 3; axis++)
        if (highest[axis] < lowest[axis] + finest)
            highest[axis] = lowest[axis] + finest;
    box[DISTANCE] = distance + (plane < first ? plane - first : 0.0);
    box[IS_CELL] = nearest >= cells->cubes || AT(cells->half, nearest) < 0.75 * finest;
    place_box(box, lowest, highest, &finding->placed, &finding->at);
    return left;
}

/* Let the hull be that of points, from their mean. */
static void set_hull(Finding *finding, const Mat *hull, double *points)
{
    for (npy_intp k = 0; k < hull->rows; k++)
        for (int c = 0; c < 3; c++)
            finding->base[c] += AT2(*hull, k, c) / hull->rows;
    for (npy_intp k = 0; k < hull->rows; k++)
        for (int c = 0; c < 3; c++)
            points[3 * k + c] = AT2(*hull, k, c) - finding->base[c];
    finding->hull = (Hull){points, hull->rows};
}

PyObject *find_boxes(const Cells *cells, const Vec *off, const Finding *finding, npy_intp most, npy_intp *those,
                     npy_intp *left)
{
    Room room;
    double *least = room_for(&room, (cells->all + 1) * sizeof(double)), *row;
    PyObject *numbers = least ? new_mat(most, NUMBERS, &row) : NULL, *found = NULL;
    npy_intp boxes = 0;
    *left = cells->all;
    if (numbers) {
        for (npy_intp k = 0; k < cells->all; k++)
            those[k] = k;
        while (*left > 0 && boxes < most)
            *left = take_box(cells, those, *left, off, finding, least, row + NUMBERS * boxes++);
        found = PySequence_GetSlice(numbers, 0, boxes);
        Py_DECREF(numbers);
    }
    if (least)
        release(&room);
    return found;
}

PyObject *boxes_of_cells(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat hull;
    Vec off;
    Cells cells;
    Finding finding = {.base = {0.0, 0.0, 0.0}};
    if (count_is(count, 10, "boxes_of_cells") < 0 || as_mat(args[0], "hull", -1, 3, &hull) < 0 ||
        as_mat(args[1], "R", 3, 3, &finding.R) < 0 || as_cells(args + 2, &cells) < 0 ||
        as_vec(args[5], "off", cells.all, &off) < 0 || as_doubles(args[7], "rules", 4, finding.rules) < 0 ||
        as_mat(args[8], "T_R", 3, 3, &finding.placed) < 0 || as_vec(args[9], "T_t", 3, &finding.at) < 0)
        return NULL;
    const npy_intp most = PyNumber_AsSsize_t(args[6], PyExc_IndexError);
    if (most == -1 && PyErr_Occurred())
        return NULL;
    if (most < 0 || hull.rows < 1) {
        PyErr_SetString(PyExc_ValueError, "hull and most: some points and no negative number are wanted");
        return NULL;
    }
    Room at_points, at_those;
    double *points = room_for(&at_points, 3 * hull.rows * sizeof(double));
    npy_intp *those = points ? room_for(&at_those, (cells.all + 1) * sizeof(npy_intp)) : NULL, left;
    PyObject *found = NULL;
    if (those) {
        set_hull(&finding, &hull, points);
        PyObject *numbers = find_boxes(&cells, &off, &finding, most, those, &left);
        if (numbers)
            found = left < 0 ? Py_NewRef(Py_None) : Py_BuildValue("ON", numbers, ind_of(those, left));
        Py_XDECREF(numbers);
        release(&at_those);
    }
    if (points)
        release(&at_points);
    return found;
}

/* points in a frame, less a shift, as seen from `base` in the world */
static void place_points(const Mat *own, const Mat *T, const double *shift, const double *base, double *points)
{
    for (npy_intp k = 0; k < own->rows; k++)
        for (int r = 0; r < 3; r++) {
            points[3 * k + r] = AT2(*T, r, 3) - base[r];
            for (int c = 0; c < 3; c++)
                points[3 * k + r] += AT2(*T, r, c) * (AT2(*own, k, c) + shift[c]);
        }
}

PyObject *hulls_apart(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    static const double none[3] = {0.0, 0.0, 0.0};
    Mat own, other, T, T_other;
    double fat, other_fat, shift[3], distance, n[3], on_own[3], on_other[3], *normal, *point;
    if (count_is(count, 7, "hulls_apart") < 0 || as_mat(args[0], "corners", -1, 4, &own) < 0 ||
        as_double(args[1], "fat", &fat) < 0 || as_mat(args[2], "T", 4, 4, &T) < 0 ||
        as_mat(args[3], "other", -1, -1, &other) < 0 || as_double(args[4], "other_fat", &other_fat) < 0 ||
        as_three(args[5], "shift", shift) < 0 || as_mat(args[6], "T_other", 4, 4, &T_other) < 0)
        return NULL;
    if (other.columns < 3) {
        PyErr_SetString(PyExc_ValueError, "other: three coordinates are wanted");
        return NULL;
    }
    if (own.rows < 1 || other.rows < 1)
        Py_RETURN_NONE;
    double base[3] = {AT2(T, 0, 3), AT2(T, 1, 3), AT2(T, 2, 3)};
    Room room, more;
    double *points = room_for(&room, 3 * own.rows * sizeof(double));
    double *others = points ? room_for(&more, 3 * other.rows * sizeof(double)) : NULL;
    PyObject *found = NULL;
    if (others) {
        place_points(&own, &T, none, base, points);
        place_points(&other, &T_other, shift, base, others);
        const Hull first = {points, own.rows}, second = {others, other.rows};
        if (hull_distance(&first, &second, &distance, n, on_own, on_other) < 0)
            found = Py_NewRef(Py_None);
        else {
            PyObject *normals = new_vec(3, &normal), *at = new_vec(3, &point);
            double offset = 0.0;
            for (int c = 0; normals && at && c < 3; c++) {
                point[c] = base[c] + on_own[c] + fat * n[c];
                normal[c] = 0.0;
                for (int r = 0; r < 3; r++)
                    normal[c] += n[r] * AT2(T_other, r, c);
                offset += n[c] * (base[c] + on_other[c] - other_fat * n[c] - AT2(T_other, c, 3));
            }
            found = normals && at ? Py_BuildValue("dOdO", distance - fat - other_fat, normals, offset, at) : NULL;
            Py_XDECREF(normals), Py_XDECREF(at);
        }
        release(&more);
    }
    if (points)
        release(&room);
    return found;
}
