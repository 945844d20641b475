/* The voxels around a link, and boxes around these: machine/clusters/cluster.py. */
#include "cells.h"

#include <math.h>

static const double HALF_DIAGONAL = 0.86602540378443864676; /* of a cube's edge */

enum { HULL, AXES, R_BODY, T_BODY, R_SOLID, T_SOLID, REGIONS, RULES, MOST, COARSE, COARSE_TILES };
enum { KEYS = COARSE_TILES + OF_TILES, BASE, EDGE, TILES, GIVEN = TILES + OF_TILES };
enum { BOX_RULES = 4, REACH = 4, FINE_WITHIN, STEP, OF_RULES };

/* cubes, with room for so many: their middles coordinate by coordinate, half edges, and how far they are off */
typedef struct {
    double *middle, *half, *off;
    npy_intp count, room;
} Cubes;

/* (3, n) whole numbers of 32 bits */
typedef struct {
    const char *data;
    npy_intp n, down, right;
} Keys;

static int as_keys(PyObject *object, Keys *keys)
{
    if (is_array(object, "keys", NPY_INT, 2) < 0)
        return -1;
    PyArrayObject *array = (PyArrayObject *)object;
    keys->data = PyArray_BYTES(array), keys->n = PyArray_DIM(array, 1);
    keys->down = PyArray_STRIDE(array, 0), keys->right = PyArray_STRIDE(array, 1);
    return has_length(PyArray_DIM(array, 0), 3, "keys");
}

static void put(Cubes *cubes, const double *middle, double half, double off)
{
    for (int c = 0; c < 3; c++)
        cubes->middle[cubes->room * c + cubes->count] = middle[c];
    cubes->half[cubes->count] = half, cubes->off[cubes->count++] = off;
}

/* The link in the frame of the solid: its points, the box around it, and the upright box around all within 0 of it. */
static void place_link(const Mat *own, PyObject *const *args, const Mat *turned, double radius, double *points, Finding *finding,
                       double (*R)[3], Box *box, double *low, double *high)
{
    Mat body, solid;
    Vec t, at;
    double R_local[3][3], t_local[3], least[3], most[3];
    as_mat(args[R_BODY], "R", 3, 3, &body), as_mat(args[R_SOLID], "T_R", 3, 3, &solid); /* both were looked at */
    as_vec(args[T_BODY], "t", 3, &t), as_vec(args[T_SOLID], "T_t", 3, &at);
    for (int r = 0; r < 3; r++) {
        t_local[r] = 0.0;
        for (int c = 0; c < 3; c++) {
            t_local[r] += AT2(solid, c, r) * (AT(t, c) - AT(at, c));
            R_local[r][c] = 0.0;
            for (int k = 0; k < 3; k++)
                R_local[r][c] += AT2(solid, k, r) * AT2(body, k, c);
        }
        least[r] = low[r] = INFINITY, most[r] = high[r] = -INFINITY, finding->base[r] = 0.0;
    }
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++) {
            R[r][c] = 0.0;
            for (int k = 0; k < 3; k++)
                R[r][c] += R_local[r][k] * AT2(*turned, k, c);
            box->R[3 * r + c] = R[r][c];
        }
    for (npy_intp k = 0; k < own->rows; k++) {
        double *at_point = points + 3 * k;
        for (int r = 0; r < 3; r++) {
            at_point[r] = t_local[r];
            for (int c = 0; c < 3; c++)
                at_point[r] += R_local[r][c] * AT2(*own, k, c);
            low[r] = at_point[r] < low[r] ? at_point[r] : low[r], high[r] = at_point[r] > high[r] ? at_point[r] : high[r];
            finding->base[r] += at_point[r] / own->rows;
        }
        for (int c = 0; c < 3; c++) {
            const double along = R[0][c] * at_point[0] + R[1][c] * at_point[1] + R[2][c] * at_point[2];
            least[c] = along < least[c] ? along : least[c], most[c] = along > most[c] ? along : most[c];
        }
    }
    for (int c = 0; c < 3; c++) {
        box->middle[c] = 0.5 * (least[c] + most[c]), box->half[c] = 0.5 * (most[c] - least[c]);
        low[c] -= radius, high[c] += radius;
    }
    box->radius = radius;
    for (npy_intp k = 0; k < own->rows; k++)
        for (int r = 0; r < 3; r++)
            points[3 * k + r] -= finding->base[r];
    finding->hull = (Hull){points, own->rows};
    finding->R = (Mat){(char *)R, 3, 3, 3 * sizeof(double), sizeof(double)};
}

/* whether the coarse cubes, which are those of a region, hold all of the solid that is within reach of a link */
static int coarse_hold(const Mat *regions, const double *low, const double *high, double reach)
{
    int hold = 1;
    for (int c = 0; c < 3; c++) {
        const double from = low[c] - reach, to = high[c] + reach;
        const double least = from > AT2(*regions, 2, c) ? from : AT2(*regions, 2, c);
        const double most = to < AT2(*regions, 3, c) ? to : AT2(*regions, 3, c);
        if (most < least)
            return 1;
        hold &= least >= AT2(*regions, 0, c) && most <= AT2(*regions, 1, c);
    }
    return hold;
}

/* how many cells of `all` some tiles hold; or -1 with an exception */
static npy_intp cells_in(const Tiles *tiles, const npy_intp *near, npy_intp count, npy_intp all)
{
    npy_intp cells = 0;
    for (npy_intp i = 0; i < count; i++) {
        const npy_intp from = INDEX(tiles->start, near[i]), to = INDEX(tiles->start, near[i] + 1);
        if (from < 0 || to < from || to > all) {
            PyErr_SetString(PyExc_ValueError, "start: places of cells that there are, ascending, are wanted");
            return -1;
        }
        cells += to - from;
    }
    return cells;
}

/* Room for so many more cubes behind those that are there; or -1, also where `more` is none. */
static int make_room(Cubes *cubes, npy_intp more)
{
    if (more < 0)
        return -1;
    Cubes wider = {NULL, NULL, NULL, 0, cubes->count + more};
    wider.middle = PyMem_Malloc(5 * wider.room * sizeof(double) + 1);
    if (!wider.middle) {
        PyErr_NoMemory();
        return -1;
    }
    wider.half = wider.middle + 3 * wider.room, wider.off = wider.half + wider.room;
    for (npy_intp k = 0; k < cubes->count; k++) {
        const double *m = cubes->middle + k;
        put(&wider, (double[]){m[0], m[cubes->room], m[2 * cubes->room]}, cubes->half[k], cubes->off[k]);
    }
    PyMem_Free(cubes->middle);
    *cubes = wider;
    return 0;
}

static void widened(const double *low, const double *high, double more, double *from, double *to)
{
    for (int c = 0; c < 3; c++)
        from[c] = low[c] - more, to[c] = high[c] + more;
}

/* Coarse cubes beyond `fine_within` of a link and within reach of it: whether there are others nearer; or -1. */
static int add_coarse(const Tiles *tiles, const Mat *coarse, const Box *box, const double *low, const double *high,
                      const double *rules, Cubes *cubes)
{
    double from[3], to[3];
    Room room;
    npy_intp *near;
    int any = 0;
    widened(low, high, rules[REACH], from, to);
    const npy_intp count = tiles_near(tiles, from, to, box, rules[REACH] + rules[STEP], &room, &near);
    if (count < 0)
        return -1;
    if (make_room(cubes, cells_in(tiles, near, count, coarse->columns)) < 0)
        any = -1;
    for (npy_intp i = 0; any >= 0 && i < count; i++)
        for (npy_intp cell = INDEX(tiles->start, near[i]); cell < INDEX(tiles->start, near[i] + 1); cell++) {
            const double middle[3] = {AT2(*coarse, 0, cell), AT2(*coarse, 1, cell), AT2(*coarse, 2, cell)};
            const double away = off_box(box, middle[0], middle[1], middle[2]);
            if (away <= rules[FINE_WITHIN])
                any = 1;
            else if (away <= rules[REACH] + rules[STEP])
                put(cubes, middle, 0.5 * rules[STEP], away);
        }
    release(&room);
    return any;
}

/* Voxels within reach of a link, or -1. */
static int add_fine(const Tiles *tiles, const Keys *keys, const double *base, double edge, const Box *box, const double *low,
                    const double *high, double reach, Cubes *cubes)
{
    double from[3], to[3];
    Room room;
    npy_intp *near;
    widened(low, high, reach, from, to);
    const npy_intp count = tiles_near(tiles, from, to, box, reach, &room, &near);
    if (count < 0)
        return -1;
    const int failed = make_room(cubes, cells_in(tiles, near, count, keys->n));
    for (npy_intp i = 0; !failed && i < count; i++)
        for (npy_intp cell = INDEX(tiles->start, near[i]); cell < INDEX(tiles->start, near[i] + 1); cell++) {
            double middle[3];
            for (int c = 0; c < 3; c++)
                middle[c] = edge * (*(const int *)(keys->data + c * keys->down + cell * keys->right) + base[c]);
            const double off = off_box(box, middle[0], middle[1], middle[2]);
            if (off - HALF_DIAGONAL * edge <= reach)
                put(cubes, middle, 0.5 * edge, off);
        }
    release(&room);
    return failed;
}

/* The cubes around a link, and in each case those that are nearer as voxels; or -1. */
static int cubes_around(PyObject *const *args, const Box *box, const double *low, const double *high, const double *rules,
                        Cubes *cubes)
{
    Tiles coarse_tiles, tiles;
    Mat coarse, regions;
    Keys keys;
    double base[3], edge;
    if (as_tiles(args + COARSE_TILES, &coarse_tiles) < 0 || as_tiles(args + TILES, &tiles) < 0 ||
        as_mat(args[COARSE], "coarse", 3, -1, &coarse) < 0 || as_keys(args[KEYS], &keys) < 0 ||
        as_three(args[BASE], "base", base) < 0 || as_double(args[EDGE], "edge", &edge) < 0 ||
        as_mat(args[REGIONS], "regions", 4, 3, &regions) < 0)
        return -1;
    double reach = rules[REACH];
    Cubes outer = {NULL, NULL, NULL, 0, 0};
    int failed = 0;
    if (reach > rules[FINE_WITHIN] && coarse_hold(&regions, low, high, reach)) {
        const int any = add_coarse(&coarse_tiles, &coarse, box, low, high, rules, &outer);
        reach = any > 0 ? rules[FINE_WITHIN] + HALF_DIAGONAL * rules[STEP] : -1.0;
        failed = any < 0;
    }
    if (!failed && reach >= 0.0)
        failed = add_fine(&tiles, &keys, base, edge, box, low, high, reach, cubes);
    if (!failed && !(failed = make_room(cubes, outer.count)))
        for (npy_intp k = 0; k < outer.count; k++)
            put(cubes, (double[]){outer.middle[k], outer.middle[outer.room + k], outer.middle[2 * outer.room + k]},
                outer.half[k], outer.off[k]);
    PyMem_Free(outer.middle);
    return failed ? -1 : 0;
}

/* Boxes around cubes, and the cubes that are in none of them; None where it takes coal. */
static PyObject *boxes_and_rest(const Cubes *cubes, const Finding *finding, npy_intp most)
{
    const npy_intp n = cubes->count, size = sizeof(double);
    const Cells cells = {{(char *)cubes->middle, 3, n, size * cubes->room, size}, {(char *)cubes->half, n, size}, NULL, n, n,
                         {0, 0, 0}};
    const Vec off = {(char *)cubes->off, n, size};
    Room room;
    double *middle, *half, *away;
    npy_intp *those = room_for(&room, (n + 1) * sizeof(npy_intp)), left = 0;
    PyObject *numbers = those ? find_boxes(&cells, &off, finding, most, those, &left) : NULL, *found = NULL;
    if (numbers && left < 0)
        found = Py_NewRef(Py_None);
    else if (numbers) {
        PyObject *middles = new_mat(3, left, &middle), *halves = new_vec(left, &half), *offs = new_vec(left, &away);
        for (npy_intp i = 0; middles && halves && offs && i < left; i++) {
            for (int c = 0; c < 3; c++)
                middle[left * c + i] = cubes->middle[cubes->room * c + those[i]];
            half[i] = cubes->half[those[i]], away[i] = cubes->off[those[i]];
        }
        found = middles && halves && offs ? PyTuple_Pack(4, numbers, middles, halves, offs) : NULL;
        Py_XDECREF(middles), Py_XDECREF(halves), Py_XDECREF(offs);
    }
    Py_XDECREF(numbers);
    if (those)
        release(&room);
    return found;
}

PyObject *boxes_of_voxels(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat own, turned, any;
    Vec three;
    Finding finding;
    Box box;
    double rules[OF_RULES], low[3], high[3], R[3][3];
    if (count_is(count, GIVEN, "boxes_of_voxels") < 0 || as_mat(args[HULL], "hull", -1, 3, &own) < 0 ||
        as_mat(args[AXES], "axes", 3, 3, &turned) < 0 || as_mat(args[R_BODY], "R", 3, 3, &any) < 0 ||
        as_vec(args[T_BODY], "t", 3, &three) < 0 || as_mat(args[R_SOLID], "T_R", 3, 3, &finding.placed) < 0 ||
        as_vec(args[T_SOLID], "T_t", 3, &finding.at) < 0 || as_doubles(args[RULES], "rules", OF_RULES, rules) < 0)
        return NULL;
    const npy_intp most = PyNumber_AsSsize_t(args[MOST], PyExc_IndexError);
    if (most == -1 && PyErr_Occurred())
        return NULL;
    if (most < 0 || own.rows < 1) {
        PyErr_SetString(PyExc_ValueError, "hull and most: some points and no negative number are wanted");
        return NULL;
    }
    for (int k = 0; k < BOX_RULES; k++)
        finding.rules[k] = rules[k];
    Room room;
    double *points = room_for(&room, 3 * own.rows * sizeof(double));
    if (!points)
        return NULL;
    place_link(&own, args, &turned, rules[0], points, &finding, R, &box, low, high);
    Cubes cubes = {NULL, NULL, NULL, 0, 0};
    PyObject *found = NULL;
    if (cubes_around(args, &box, low, high, rules, &cubes) == 0)
        found = boxes_and_rest(&cubes, &finding, most);
    PyMem_Free(cubes.middle);
    release(&room);
    return found;
}
