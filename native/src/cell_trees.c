/* How near a convex shape is to triangles or cubes in a tree of boxes: machine/clusters/cell_tree.py, and whether pieces of
 * a machine keep their distances from them: site/pairs/beside_solids.py. */
#include "arrays.h"
#include "asked.h"
#include "distance.h"
#include "grids.h"
#include "place.h"
#include "rings.h"

#include <math.h>
#include <string.h>

enum { DEEPEST = 64 }; /* levels of a tree, far more than any has */
enum { OF_TRIANGLE = 9, OF_CUBE = 3, MOST_CORNERS = 8 };

/* node k of the tree has the children 2 k and 2 k + 1; the last half of the nodes are its leaves */
typedef struct {
    const double *boxes, *cells;           /* (nodes, 6) lowest and highest corner; (count, width) */
    npy_intp nodes, count, width, in_leaf; /* width: of a triangle all corners, of a cube the middle */
    double half;                           /* edge of a cube */
} Cells;

/* The hull of a cell; the corners of a cube are put into `corners`. */
static Hull cell_at_place(const Cells *cells, npy_intp k, double *corners)
{
    const double *own = cells->cells + cells->width * k;
    if (cells->width == OF_TRIANGLE)
        return (Hull){own, 3};
    for (int corner = 0; corner < MOST_CORNERS; corner++)
        for (int c = 0; c < 3; c++)
            corners[3 * corner + c] = own[c] + (corner >> c & 1 ? cells->half : -cells->half);
    return (Hull){corners, MOST_CORNERS};
}

/* the shape, the box around it, and the nearest place found so far */
typedef struct {
    Hull shape;
    double low[3], high[3];
    Place place;
    double across[3], face; /* the normal of a plane beside the shape, and how far that extends along it */
} Nearest;

static double along(const double *n, const double *x)
{
    return n[0] * x[0] + n[1] * x[1] + n[2] * x[2];
}

static void take_plane(Nearest *found, const double *normal)
{
    double furthest[3];
    memcpy(found->across, normal, sizeof(found->across));
    furthest_on_hull(&found->shape, normal, furthest);
    found->face = along(normal, furthest);
}

/* How far the boxes around a node and around the shape are apart. */
static double box_gap(const double *box, const Nearest *found)
{
    double square = 0.0;
    for (int c = 0; c < 3; c++) {
        const double gap = gap_between(found->low[c], found->high[c], box[c], box[3 + c]);
        square += gap * gap;
    }
    return sqrt(square);
}

/* Whether the box of a node is beyond the plane by as much as what was found. */
static int is_beyond(const double *box, const Nearest *found)
{
    double nearest = -found->face;
    for (int c = 0; c < 3; c++)
        nearest += found->across[c] * (found->across[c] > 0.0 ? box[c] : box[3 + c]);
    return nearest >= found->place.distance;
}

/* Look at the cells of a leaf for what is nearer than `found`: 1 where something is, 0, or -1 undecided. */
static int look_at_leaf(const Cells *cells, npy_intp leaf, Nearest *found)
{
    const npy_intp begin = leaf * cells->in_leaf, end = begin + cells->in_leaf;
    int nearer = 0;
    for (npy_intp k = begin; k < end && k < cells->count; k++) {
        double corners[3 * MOST_CORNERS], least = INFINITY, guess[3], distance, normal[3], on_shape[3], on_cell[3];
        const Hull other = cell_at_place(cells, k, corners);
        for (npy_intp corner = 0; corner < other.count; corner++)
            least = fmin(least, along(found->across, other.points + 3 * corner));
        if (least - found->face >= found->place.distance)
            continue;
        memcpy(guess, found->across, sizeof(guess));
        if (come_nearer(furthest_on_hull, &found->shape, &other, found->place.distance, guess) == 0) {
            take_plane(found, guess);
            continue;
        }
        if (hull_distance(&found->shape, &other, &distance, normal, on_shape, on_cell) < 0)
            return -1;
        if (distance < found->place.distance) {
            found->place.distance = distance, nearer = 1;
            take_plane(found, normal);
            memcpy(found->place.normal, normal, sizeof(normal));
            memcpy(found->place.on_shape, on_shape, sizeof(on_shape));
            memcpy(found->place.on_other, on_cell, sizeof(on_cell));
        }
    }
    return nearer;
}

/* Look at all cells, nearer nodes first; as `look_at_leaf`. */
static int look_at_cells(const Cells *cells, Nearest *found)
{
    const npy_intp leaves = cells->nodes / 2;
    npy_intp open[DEEPEST] = {1};
    double gaps[DEEPEST] = {box_gap(cells->boxes + 6, found)};
    int count = 1, nearer = 0;
    while (count) {
        const npy_intp node = open[--count];
        if (gaps[count] >= found->place.distance || is_beyond(cells->boxes + 6 * node, found))
            continue;
        if (node >= leaves) {
            const int more = look_at_leaf(cells, node - leaves, found);
            if (more < 0)
                return -1;
            nearer |= more;
            continue;
        }
        const npy_intp first = 2 * node;
        const double gap[2] = {box_gap(cells->boxes + 6 * first, found), box_gap(cells->boxes + 6 * (first + 1), found)};
        const int near = gap[1] < gap[0]; /* the nearer one is looked at first, so it is put last */
        for (int k = 0; k < 2; k++) {
            const int which = k ? near : !near;
            if (gap[which] < found->place.distance)
                open[count] = first + which, gaps[count++] = gap[which];
        }
    }
    return nearer;
}

enum { OF_CELLS = 4 };

/* Four arguments of `nearest_on_cells`, from `boxes` on; 0, or -1 with an exception. */
static int read_cells(PyObject *const *args, Cells *cells)
{
    npy_intp boxes[2], shape[2];
    if (!(cells->boxes = block(args[0], "boxes", 2, boxes)) || has_length(boxes[1], 6, "boxes") < 0 ||
        !(cells->cells = block(args[1], "cells", 2, shape)) || as_double(args[3], "half", &cells->half) < 0)
        return -1;
    if (shape[1] != OF_TRIANGLE && shape[1] != OF_CUBE) {
        PyErr_SetString(PyExc_ValueError, "cells: 9 numbers of each triangle or 3 of each cube are wanted");
        return -1;
    }
    cells->nodes = boxes[0], cells->count = shape[0], cells->width = shape[1];
    cells->in_leaf = PyLong_AsSsize_t(args[2]);
    return cells->in_leaf == -1 && PyErr_Occurred() ? -1 : 0;
}

/* Whether all cells are in leaves. */
static int is_whole(const Cells *cells)
{
    return cells->nodes >= 2 && cells->in_leaf >= 1 && cells->in_leaf * (cells->nodes / 2) >= cells->count;
}

/* The box around the corners of the shape. */
static void take_box(Nearest *found)
{
    for (int c = 0; c < 3; c++) {
        found->low[c] = INFINITY, found->high[c] = -INFINITY;
        for (npy_intp k = 0; k < found->shape.count; k++) {
            found->low[c] = fmin(found->low[c], found->shape.points[3 * k + c]);
            found->high[c] = fmax(found->high[c], found->shape.points[3 * k + c]);
        }
    }
}

PyObject *nearest_on_cells(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Cells cells;
    Hull shape;
    double radius, reach;
    if (count_is(count, 7, "nearest_on_cells") < 0 || as_shape(args[0], args[1], &shape, &radius) < 0 ||
        read_cells(args + 2, &cells) < 0 || as_double(args[6], "reach", &reach) < 0)
        return NULL;
    if (shape.count < 1 || !is_whole(&cells))
        return PyTuple_New(0);
    Nearest found = {.shape = shape, .place.distance = reach + radius};
    take_box(&found);
    take_plane(&found, (double[]){0.0, 0.0, -1.0});
    return answer_of_place(look_at_cells(&cells, &found), &found.place, radius, (double[]){0.0, 0.0, 0.0});
}

/* Whether a shape comes as near to a cell of a node as `found` says: 1, 0, or -1 undecided. */
static int comes_to_node(const Cells *cells, npy_intp node, Nearest *found)
{
    const double *box = cells->boxes + 6 * node;
    const npy_intp leaves = cells->nodes / 2;
    if (box_gap(box, found) >= found->place.distance || is_beyond(box, found))
        return 0;
    if (node < leaves) {
        const int first = comes_to_node(cells, 2 * node, found);
        return first ? first : comes_to_node(cells, 2 * node + 1, found);
    }
    const npy_intp begin = (node - leaves) * cells->in_leaf, end = begin + cells->in_leaf;
    for (npy_intp k = begin; k < end && k < cells->count; k++) {
        double corners[3 * MOST_CORNERS], guess[3];
        const Hull other = cell_at_place(cells, k, corners);
        memcpy(guess, found->across, sizeof(guess));
        const int nearer = come_nearer(furthest_on_hull, &found->shape, &other, found->place.distance, guess);
        if (nearer)
            return nearer;
        take_plane(found, guess);
    }
    return 0;
}

/* which cells of a grid around a closed mesh are inside of it; none where the mesh is not closed */
typedef struct {
    Frame frame;
    const npy_uint8 *side; /* 0 outside, 1 inside, 2 the surface */
    int any;
} Sides;

static int read_sides(PyObject *const *args, Sides *sides)
{
    if (is_array(args[OF_FRAME], "sides", NPY_UINT8, 1) < 0)
        return -1;
    PyArrayObject *array = (PyArrayObject *)args[OF_FRAME];
    sides->any = PyArray_DIM(array, 0) > 0;
    if (!sides->any)
        return 0;
    if (read_frame(args, &sides->frame) < 0 || !has_cells(PyArray_DIM(array, 0), &sides->frame))
        return -1;
    if (!PyArray_IS_C_CONTIGUOUS(array)) {
        PyErr_SetString(PyExc_ValueError, "sides: an array in one piece is wanted");
        return -1;
    }
    sides->side = PyArray_DATA(array);
    return 0;
}

/* Where points of a shape are that touches no cell: 1 inside, 0 outside, -1 unknown. A point inside is enough of any. */
static int is_within(const Sides *sides, const double *points, npy_intp count)
{
    int found = sides->any ? -1 : 0;
    for (npy_intp k = 0; k < count && sides->any; k++) {
        int inside;
        const npy_intp cell = cell_at(&sides->frame, points + 3 * k, &inside);
        if (inside && sides->side[cell] == 1)
            return 1;
        if (!inside || sides->side[cell] == 0)
            found = 0;
    }
    return found;
}

/* the cells around a machine, and what is asked of its pieces */
typedef struct {
    Cells cells;
    Sides sides;
    Covered covered;
} Around;

enum { AROUND = OF_CELLS + OF_FRAME + 1 };

/* The arguments of `kept_over_cells` from `boxes` on; 0, or -1 with an exception. */
static int read_around(PyObject *const *args, Around *around)
{
    return read_cells(args, &around->cells) < 0 ? -1 : read_sides(args + OF_CELLS, &around->sides);
}

/* The corners of the piece of question k, around which a hull is, and how near it may come; 0, or -1 where that is not
 * to be answered here. */
static int ask_near(const Around *around, const Asked *asked, npy_intp k, double *points, Nearest *found)
{
    const double number = AT(asked->number, k), reach = asked->radius[INDEX(asked->piece, k)] + number;
    *found = (Nearest){.shape = {points, corners_asked(asked, k, points)}, .place.distance = reach};
    if (!is_whole(&around->cells) || !isfinite(reach) || !(number > 0.0) || found->shape.count < 1)
        return -1;
    for (npy_intp i = 0; i < 3 * found->shape.count; i++)
        if (!isfinite(points[i]))
            return -1;
    take_box(found);
    take_plane(found, (double[]){0.0, 0.0, -1.0});
    return 0;
}

static int judge_over_cells(const void *what, npy_intp k, double *points)
{
    const Around *around = what;
    const Asked *asked = &around->covered.asked;
    const double apart = least_on_grid_of(&around->covered, k);
    Nearest found;
    if (apart > 0.0 && apart >= AT(asked->number, k)) /* where a ball may touch, nothing is known */
        return 1;
    if (ask_near(around, asked, k, points, &found) < 0)
        return -1;
    const int within = is_within(&around->sides, points, found.shape.count);
    const int nearer = within == 1 ? 1 : comes_to_node(&around->cells, 1, &found);
    return nearer > 0 ? 0 : nearer < 0 || within < 0 ? -1 : 1;
}

PyObject *kept_over_cells(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Around around;
    if (count_is(count, OF_COVERED + AROUND, "kept_over_cells") < 0 || read_covered(args, &around.covered) < 0 ||
        read_around(args + OF_COVERED, &around) < 0)
        return NULL;
    return verdicts_on(&around.covered.asked, judge_over_cells, &around);
}

static int read_near_cells(const void *what, npy_intp k, double *points, double *to)
{
    const Around *around = what;
    const Asked *asked = &around->covered.asked;
    Nearest found;
    if (ask_near(around, asked, k, points, &found) < 0 || is_within(&around->sides, points, found.shape.count) != 0)
        return -1;
    const double radius = asked->radius[INDEX(asked->piece, k)];
    const int nearer = look_at_cells(&around->cells, &found);
    if (nearer <= 0)
        return nearer;
    if (!(found.place.distance > radius))
        return -1;
    double own[9];
    vectors_of(&found.place, radius, (double[]){0.0, 0.0, 0.0}, own);
    put_reading(asked->frame, asked->origin, found.place.distance - radius, own, to);
    return 1;
}

PyObject *read_over_cells(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Around around;
    if (count_is(count, OF_ASKED + AROUND, "read_over_cells") < 0 || read_asked(args, &around.covered.asked) < 0 ||
        read_around(args + OF_ASKED, &around) < 0)
        return NULL;
    return readings_of(&around.covered.asked, read_near_cells, &around);
}
