/* What a step that is held back asks. Some of it calls other functions of this extension, as the plain versions do. */
#include "arrays.h"

#include <math.h>
#include <string.h>

/* H and f of the cost whose least is at the target, see `cost_of_tip`; without a task each joint counts alike. */
static PyObject *cost_of(PyObject *self, PyObject *task, PyObject *target, PyObject *null, PyObject *free)
{
    if (task != Py_None)
        return cost_of_tip(self, (PyObject *[]){task, target, null, free}, 4);
    Vec wanted;
    if (as_vec(target, "target", -1, &wanted) < 0)
        return NULL;
    double *H, *f;
    PyObject *square = new_mat(wanted.n, wanted.n, &H), *linear = new_vec(wanted.n, &f);
    if (!square || !linear) {
        Py_XDECREF(square), Py_XDECREF(linear);
        return NULL;
    }
    for (npy_intp i = 0; i < wanted.n; i++) {
        f[i] = -AT(wanted, i);
        for (npy_intp j = 0; j < wanted.n; j++)
            H[wanted.n * i + j] = i == j;
    }
    return Py_BuildValue("NN", square, linear);
}

/* The x nearest to a target within bounds and rows, and the iterations in `more`. */
static PyObject *nearest_within(PyObject *self, PyObject *cost, PyObject *low, PyObject *high, PyObject *G, PyObject *h,
                                PyObject *most, Py_ssize_t *more)
{
    Vec least, largest;
    PyObject *found = cost ? soft_solution(self, (PyObject *[]){PyTuple_GET_ITEM(cost, 0), PyTuple_GET_ITEM(cost, 1), low,
                                                               high, G, h, most}, 7) : NULL;
    Py_XDECREF(cost);
    if (!found)
        return NULL;
    PyObject *x = Py_NewRef(PyTuple_GET_ITEM(found, 0));
    *more += PyLong_AsSsize_t(PyTuple_GET_ITEM(found, 1));
    Py_DECREF(found);
    double *at = PyArray_DATA((PyArrayObject *)x);
    if (as_vec(low, "low", -1, &least) < 0 || as_vec(high, "high", -1, &largest) < 0) {
        Py_DECREF(x);
        return NULL;
    }
    for (npy_intp j = 0; j < least.n; j++) { /* the solution keeps them to its tolerance alone */
        const double up = at[j] < AT(least, j) ? AT(least, j) : at[j];
        at[j] = up > AT(largest, j) ? AT(largest, j) : up;
    }
    return x;
}

PyObject *velocity_within_rows(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec wish, null;
    if (count_is(count, 15, "velocity_within_rows") < 0 || as_vec(args[0], "wish", -1, &wish) < 0 ||
        as_vec(args[2], "null", wish.n, &null) < 0)
        return NULL;
    PyObject *task = args[1], *low = args[5], *high = args[6], *G = args[9], *h = args[10], *most = args[14];
    Py_ssize_t iterations = 0;
    PyObject *steady = nearest_within(self, cost_of(self, task, args[0], args[2], args[3]), args[7], args[8], G, h, most,
                                      &iterations);
    PyObject *load = steady ? PyFloat_FromDouble(1.0) : NULL;
    PyObject *next = load ? next_within(self, (PyObject *[]){steady, args[4], low, high, args[11], args[12], load, G, h,
                                                            args[13]}, 10) : NULL;
    Py_XDECREF(steady), Py_XDECREF(load);
    if (!next)
        return NULL;
    PyObject *v;
    int problems = 1;
    if (PyTuple_GET_ITEM(next, 2) == Py_True)
        v = Py_NewRef(PyTuple_GET_ITEM(next, 1));
    else {
        problems = 2;
        v = nearest_within(self, cost_of(self, task, PyTuple_GET_ITEM(next, 0), args[2], args[3]), low, high, G, h, most,
                           &iterations);
    }
    Py_DECREF(next);
    return v ? Py_BuildValue("Nin", v, problems, iterations) : NULL;
}

/* a new array (a, b, c) */
static PyObject *new_block(npy_intp a, npy_intp b, npy_intp c)
{
    npy_intp shape[3] = {a, b, c};
    return PyArray_EMPTY(3, shape, NPY_DOUBLE, 0);
}

PyObject *near_gaps(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Ind pairs;
    Vec distance;
    npy_intp t[4], c[3];
    if (count_is(count, 11, "near_gaps") < 0 || as_vec(args[10], "distance", -1, &distance) < 0 ||
        as_ind(args[0], "pairs", distance.n, &pairs) < 0 || !block(args[8], "T", 4, t) ||
        !block(args[7], "corners", 3, c))
        return NULL;
    PyObject *gaps = new_block(pairs.n, t[0], c[2]), *zero = PyFloat_FromDouble(0.0), *least = NULL, *found = NULL;
    if (gaps && zero)
        least = corner_gaps(self, (PyObject *[]){args[0], args[3], args[4], args[5], args[6], args[7], args[8], Py_None,
                                                 zero, gaps}, 10);
    if (least)
        found = note_gaps(self, (PyObject *[]){args[0], args[1], args[2], PyTuple_GET_ITEM(least, 1), args[9], args[10]}, 6);
    PyObject *result = found ? PyTuple_Pack(5, gaps, PyTuple_GET_ITEM(least, 0), PyTuple_GET_ITEM(least, 1),
                                            PyTuple_GET_ITEM(found, 0), PyTuple_GET_ITEM(found, 1)) : NULL;
    Py_XDECREF(gaps), Py_XDECREF(zero), Py_XDECREF(least), Py_XDECREF(found);
    return result;
}

PyObject *nearest_rows(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Ind pairs, piece;
    Mat planes, rows;
    npy_intp c[3], *own;
    if (count_is(count, 12, "nearest_rows") < 0 || as_mat(args[6], "planes", -1, 4, &planes) < 0 ||
        as_ind(args[0], "pairs", planes.rows, &pairs) < 0 || !block(args[4], "corners", 3, c) ||
        as_rows(args[3], "piece", c[0], planes.rows, &pairs, &piece) < 0)
        return NULL;
    PyObject *pieces = new_ind(pairs.n, &own), *first = PyLong_FromLong(0), *points = NULL, *found = NULL;
    for (npy_intp k = 0; pieces && k < pairs.n; k++)
        own[k] = INDEX(piece, INDEX(pairs, k));
    if (pieces && first)
        points = blended_points(self, (PyObject *[]){args[1], args[2], pieces, args[4], args[5]}, 5);
    if (points)
        found = plane_rows(self, (PyObject *[]){args[0], first, points, args[6], args[7], args[8], args[9], args[10],
                                                args[11]}, 9);
    Py_XDECREF(pieces), Py_XDECREF(first), Py_XDECREF(points);
    if (!found || as_mat(found, "rows", -1, -1, &rows) < 0)
        return NULL;
    for (npy_intp k = 0; k < rows.rows; k++)
        for (npy_intp j = 0; j < rows.columns; j++)
            AT2(rows, k, j) = -AT2(rows, k, j);
    return found;
}

enum { Q, DELTA, PARTS_OF, BEND, FACTORS, SLIDES, TRAVEL, OF_PAIR, PLANES_OF, JOINTS, OTHERS, PIECES, CORNERS_OF, DRIFTS };
enum { STEP = DRIFTS + 1, CLASSES_OF, REQUIRED_OF, TOLERANCE, T_OF, J_OF, GAPS_OF, ALONG };

PyObject *gaps_along_path(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat travel;
    Vec bend;
    if (count_is(count, ALONG, "gaps_along_path") < 0 || as_mat(args[TRAVEL], "travel", -1, -1, &travel) < 0 ||
        as_vec(args[BEND], "bend", travel.columns, &bend) < 0)
        return NULL;
    PyObject *one = PyLong_FromLong(1), *T = NULL, *offs = NULL, *least = NULL, *bound = NULL, *left = NULL, *result = NULL;
    PyObject *placed = one ? place_on_line(self, (PyObject *[]){args[Q], args[DELTA], args[PARTS_OF], one, args[FACTORS],
                                                                args[SLIDES], args[T_OF], args[J_OF]}, 8) : NULL;
    Py_XDECREF(one);
    if (!placed)
        return NULL;
    Py_DECREF(placed);
    const Py_ssize_t parts = PyNumber_AsSsize_t(args[PARTS_OF], PyExc_IndexError);
    double *off;
    if (!(T = PySequence_GetSlice(args[T_OF], 0, parts + 1)) || !(offs = new_vec(travel.rows, &off)))
        goto done;
    for (npy_intp c = 0; c < travel.rows; c++) {
        off[c] = 0.0;
        for (npy_intp j = 0; j < travel.columns; j++)
            off[c] += AT2(travel, c, j) * AT(bend, j);
        off[c] /= 8.0 * parts * parts;
    }
    least = corner_gaps(self, (PyObject *[]){args[OF_PAIR], args[PLANES_OF], args[JOINTS], args[OTHERS], args[PIECES],
                                             args[CORNERS_OF], T, args[DRIFTS], args[STEP], args[GAPS_OF]}, 10);
    if (least)
        bound = least_over_path(self, (PyObject *[]){args[OF_PAIR], PyTuple_GET_ITEM(least, 1), args[CLASSES_OF], offs}, 4);
    if (bound)
        left = left_over_path(self, (PyObject *[]){args[OF_PAIR], bound, args[REQUIRED_OF], args[TOLERANCE]}, 4);
    if (left)
        result = PyTuple_Pack(6, offs, PyTuple_GET_ITEM(least, 0), PyTuple_GET_ITEM(least, 1), bound,
                              PyTuple_GET_ITEM(left, 0), PyTuple_GET_ITEM(left, 1));
done:
    Py_XDECREF(T), Py_XDECREF(offs), Py_XDECREF(least), Py_XDECREF(bound), Py_XDECREF(left);
    return result;
}

enum { PAIRS, GAPS, NEAREST, LEAST, BOUND, CLOSELY, REQUIRED, CLASSES, OFF, BUDGET, STANDS, RULES, OF_CORNERS };
enum { PLANES = OF_CORNERS, JOINT, OTHER, PIECE, CORNERS, MASK, PLACED, JACOBIANS, DRIFT, OF_PAIRS };
enum { PARTS = OF_PAIRS, VELOCITY, LOOK, SLOWEST, SHARPER, START, END, NOW_START, NOW_END, DT, OF_PATH };

PyObject *rows_of_path(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    Ind pairs, piece, k, corner;
    Vec drift, from[2], to[2];
    npy_intp c[3];
    double dt;
    if (count_is(given, OF_PATH, "rows_of_path") < 0 || as_vec(args[DRIFT], "drift", -1, &drift) < 0 ||
        as_ind(args[PAIRS], "pairs", drift.n, &pairs) < 0 || as_double(args[DT], "dt", &dt) < 0)
        return NULL;
    const double *hull = block(args[CORNERS], "corners", 3, c);
    if (!hull || as_rows(args[PIECE], "piece", c[0], drift.n, &pairs, &piece) < 0 ||
        has_length(c[2], 4, "corners") < 0)
        return NULL;
    const int moves = args[NOW_START] != Py_None;
    for (int end = 0; end < 2; end++)
        if (as_vec(args[START + end], "start and end", end ? from[0].n : -1, from + end) < 0 ||
            (moves && as_vec(args[NOW_START + end], "their place now", from[0].n, to + end) < 0))
            return NULL;
    PyObject *binding = binding_corners(self, args, OF_CORNERS), *result = NULL;
    if (!binding)
        return NULL;
    PyObject *samples = PyTuple_GET_ITEM(binding, 1);
    PyObject *of = NULL, *points = NULL, *moved = Py_NewRef(Py_None), *comes = Py_NewRef(Py_None), *falls = NULL, *G_h = NULL;
    npy_intp *pair;
    double *point, *move, *come;
    if (as_ind(PyTuple_GET_ITEM(binding, 0), "k", pairs.n, &k) < 0 ||
        as_ind(PyTuple_GET_ITEM(binding, 2), "corner", c[1], &corner) < 0 || !(of = new_ind(k.n, &pair)) ||
        !(points = new_mat(k.n, 4, &point)))
        goto done;
    for (npy_intp i = 0; i < k.n; i++) {
        pair[i] = INDEX(pairs, INDEX(k, i));
        memcpy(point + 4 * i, hull + 4 * (c[1] * INDEX(piece, pair[i]) + INDEX(corner, i)), 4 * sizeof(double));
    }
    if (moves) {
        Py_DECREF(moved), Py_DECREF(comes);
        moved = new_mat(2, from[0].n, &move), comes = new_vec(k.n, &come);
        if (!moved || !comes)
            goto done;
        for (int end = 0; end < 2; end++)
            for (npy_intp j = 0; j < from[0].n; j++)
                *move++ = AT(to[end], j) - AT(from[end], j);
        for (npy_intp i = 0; i < k.n; i++)
            come[i] = dt * AT(drift, pair[i]);
    }
    falls = plane_rows(self, (PyObject *[]){of, samples, points, args[PLANES], args[JOINT], args[OTHER], args[MASK],
                                            args[PLACED], args[JACOBIANS]}, 9);
    if (falls)
        G_h = rows_by_velocity(self, (PyObject *[]){falls, PyTuple_GET_ITEM(binding, 3), PyTuple_GET_ITEM(binding, 4),
                                                    samples, args[PARTS], args[VELOCITY], args[LOOK], args[SLOWEST],
                                                    args[SHARPER], moved, comes}, 11);
    if (G_h)
        result = PyTuple_Pack(3, of, PyTuple_GET_ITEM(G_h, 0), PyTuple_GET_ITEM(G_h, 1));
done:
    Py_DECREF(binding);
    Py_XDECREF(of), Py_XDECREF(points), Py_XDECREF(moved), Py_XDECREF(comes), Py_XDECREF(falls), Py_XDECREF(G_h);
    return result;
}

enum { PARTS_BEFORE = OF_PAIRS, START_BEFORE, END_BEFORE, Q_NOW, TARGET, DT_OF, ACCELERATION, WISH, TASK, NULL_SPACE, FREE };
enum { V_NOW = FREE + 1, LOW, HIGH, LOWEST, HIGHEST, CHANGES, FASTEST, FOR_TIP, HELD_RULES, OF_HELD };

/* The rows of `rows_of_path` for the path at the target, by those of the path before. */
static PyObject *rows_at_target(PyObject *self, PyObject *const *args)
{
    PyObject *line = braking_line(self, (PyObject *[]){args[Q_NOW], args[TARGET], args[DT_OF], args[ACCELERATION]}, 4);
    if (!line)
        return NULL;
    PyObject *of[OF_PATH];
    for (int i = 0; i < OF_PAIRS; i++)
        of[i] = args[i];
    of[PARTS] = args[PARTS_BEFORE], of[VELOCITY] = args[TARGET], of[LOOK] = PyTuple_GET_ITEM(line, 2);
    of[SLOWEST] = PyTuple_GET_ITEM(line, 4), of[SHARPER] = PyTuple_GET_ITEM(line, 5);
    of[START] = args[START_BEFORE], of[END] = args[END_BEFORE], of[NOW_START] = args[Q_NOW];
    of[NOW_END] = PyTuple_GET_ITEM(line, 1), of[DT] = args[DT_OF];
    PyObject *rows = rows_of_path(self, of, OF_PATH);
    Py_DECREF(line);
    return rows;
}

/* 1 where a target is out of its bounds, else 0; or -1 */
static int is_out(PyObject *const *args, double tolerance)
{
    Vec target, low, high;
    int out = 0;
    if (as_vec(args[TARGET], "target", -1, &target) < 0 || as_vec(args[LOW], "low", target.n, &low) < 0 ||
        as_vec(args[HIGH], "high", target.n, &high) < 0)
        return -1;
    for (npy_intp j = 0; j < target.n; j++)
        out |= AT(target, j) < AT(low, j) - tolerance || AT(target, j) > AT(high, j) + tolerance;
    return out;
}

/* The `velocity_within_rows` for these rows, without the null space where the target is cut. */
static PyObject *held_within(PyObject *self, PyObject *const *args, PyObject *G, PyObject *h, int is_cut, const double *rules)
{
    Vec wish, own;
    double *zeros;
    if (as_vec(args[WISH], "wish", -1, &wish) < 0 || as_vec(args[NULL_SPACE], "null", wish.n, &own) < 0)
        return NULL;
    PyObject *null = is_cut ? new_vec(wish.n, &zeros) : Py_NewRef(args[NULL_SPACE]), *found = NULL;
    PyObject *tolerance = PyFloat_FromDouble(rules[1]), *most = PyLong_FromLong((long)rules[3]);
    for (npy_intp j = 0; null && is_cut && j < wish.n; j++)
        zeros[j] = 0.0;
    if (null && tolerance && most)
        found = velocity_within_rows(
            self, (PyObject *[]){args[WISH], args[TASK], null, args[FREE], args[V_NOW], args[LOW], args[HIGH], args[LOWEST],
                                 args[HIGHEST], G, h, args[CHANGES], args[FASTEST], tolerance, most}, 15);
    Py_XDECREF(null), Py_XDECREF(tolerance), Py_XDECREF(most);
    return found;
}

PyObject *velocity_held_as_before(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec h;
    double rules[4];
    if (count_is(count, OF_HELD, "velocity_held_as_before") < 0 || as_doubles(args[HELD_RULES], "rules", 4, rules) < 0)
        return NULL;
    const int for_tip = PyObject_IsTrue(args[FOR_TIP]), out = for_tip < 0 ? -1 : is_out(args, rules[1]);
    PyObject *rows = out < 0 ? NULL : rows_at_target(self, args), *found = NULL, *result = NULL;
    PyObject *binding = rows ? PyFloat_FromDouble(-rules[0]) : NULL;
    PyObject *kept = binding ? keeps_rows(self, (PyObject *[]){PyTuple_GET_ITEM(rows, 1), PyTuple_GET_ITEM(rows, 2),
                                                               args[TARGET], binding}, 4) : NULL;
    Py_XDECREF(binding);
    if (kept && as_vec(PyTuple_GET_ITEM(rows, 2), "h", -1, &h) == 0) {
        PyObject *is_cut = for_tip && out ? Py_True : Py_False;
        /* what is not asked has to fit as well */
        found = held_within(self, args, PyTuple_GET_ITEM(rows, 1), PyTuple_GET_ITEM(rows, 2), is_cut == Py_True, rules);
        if (found && kept == Py_True)
            result = Py_NewRef(Py_None);
        else if (found && (double)h.n > rules[2])
            result = Py_BuildValue("OOnii", Py_None, is_cut, (Py_ssize_t)h.n, 0, 0);
        else if (found)
            result = Py_BuildValue("OOnOO", PyTuple_GET_ITEM(found, 0), is_cut, (Py_ssize_t)h.n, PyTuple_GET_ITEM(found, 1),
                                   PyTuple_GET_ITEM(found, 2));
    }
    Py_XDECREF(rows), Py_XDECREF(kept), Py_XDECREF(found);
    return result;
}

static const double SIDEWAYS = 0.2, STEEP = 0.9; /* as in the plain version */

PyObject *turn_along_surface(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec tip, normal, sense;
    double *found, *along, into = 0.0, before = 0.0, size = 0.0, any = 0.0;
    if (count_is(count, 4, "turn_along_surface") < 0 || as_vec(args[0], "tip", 3, &tip) < 0 ||
        as_vec(args[1], "normal", 3, &normal) < 0 || as_vec(args[2], "sense", 3, &sense) < 0)
        return NULL;
    const int rises = PyObject_IsTrue(args[3]);
    if (rises < 0)
        return NULL;
    PyObject *wish = new_vec(3, &found), *unit = new_vec(3, &along);
    if (!wish || !unit) {
        Py_XDECREF(wish), Py_XDECREF(unit);
        return NULL;
    }
    for (int c = 0; c < 3; c++)
        into += AT(tip, c) * AT(normal, c), before += AT(sense, c) * AT(normal, c);
    for (int c = 0; c < 3; c++) {
        along[c] = AT(tip, c) - into * AT(normal, c);
        size += along[c] * along[c];
    }
    size = sqrt(size);
    if (size <= SIDEWAYS * into) {
        for (int c = 0; c < 3; c++) {
            along[c] = AT(sense, c) - before * AT(normal, c);
            any += along[c] != 0.0;
        }
        const double up = AT(normal, 2);
        if (any == 0.0 && (fabs(up) > STEEP || !rises))
            along[0] = -AT(normal, 1), along[1] = AT(normal, 0), along[2] = 0.0;
        else if (any == 0.0)
            for (int c = 0; c < 3; c++)
                along[c] = (c == 2) - up * AT(normal, c);
        size = sqrt(along[0] * along[0] + along[1] * along[1] + along[2] * along[2]);
        size = size > 1e-9 ? size : 1e-9;
    }
    for (int c = 0; c < 3; c++) {
        along[c] /= size;
        found[c] = AT(tip, c) + into * along[c];
    }
    return Py_BuildValue("NN", wish, unit);
}

enum { Q_OF, LINE_RULES = 8, FACTORS_OF, SLIDES_OF, LINKS, COLUMNS, WITNESSES, PLANES_NOW, PAIRS_OF, CLASSES_NOW, CLEARANCE };
enum { DISTANCE = CLEARANCE + 1, EXACT_RULES = DISTANCE + 4, BEGUN, FAT, COVERED, URGENT_RULES = COVERED + 4, NOW, T_LINE, J_LINE };
enum { OF_URGENT = J_LINE + 1 };

/* Write where the machine is, and the placements of a line's ends behind that: the part of T with these, or NULL. */
static PyObject *placed_line(PyObject *self, PyObject *const *args, PyObject *ends)
{
    Mat end;
    Vec q;
    npy_intp n[3], t[4];
    double *way;
    const double *now = block(args[NOW], "now", 3, n), *T = now ? block(args[T_LINE], "T", 4, t) : NULL;
    if (!T || as_mat(ends, "ends", -1, -1, &end) < 0 || as_vec(args[Q_OF], "q", end.columns, &q) < 0 ||
        is_writeable(args[T_LINE], "T") < 0)
        return NULL;
    if (n[0] != t[1] || n[1] != t[2] || n[2] != t[3] || t[0] < 1) {
        PyErr_SetString(PyExc_ValueError, "now and T do not fit together");
        return NULL;
    }
    memcpy((double *)T, now, n[0] * n[1] * n[2] * sizeof(double));
    PyObject *delta = new_vec(q.n, &way), *parts = PyLong_FromSsize_t(end.rows - 1), *one = PyLong_FromLong(1), *placed = NULL;
    for (npy_intp j = 0; delta && j < q.n; j++)
        way[j] = AT2(end, end.rows - 1, j) - AT(q, j);
    if (delta && parts && one)
        placed = place_on_line(self, (PyObject *[]){args[Q_OF], delta, parts, one, args[FACTORS_OF], args[SLIDES_OF],
                                                    args[T_LINE], args[J_LINE]}, 8);
    Py_XDECREF(delta), Py_XDECREF(parts), Py_XDECREF(one), Py_XDECREF(placed);
    return placed ? PySequence_GetSlice(args[T_LINE], 0, end.rows) : NULL;
}

PyObject *most_urgent_boxes(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec urgency;
    if (count_is(count, OF_URGENT, "most_urgent_boxes") < 0)
        return NULL;
    PyObject *line = line_ahead(self, args, LINE_RULES + 1), *found = NULL, *inexact = NULL, *ways = NULL, *urgent = NULL;
    PyObject *at = line ? placed_line(self, args, PyTuple_GET_ITEM(line, 0)) : NULL;
    if (at)
        inexact = inexact_boxes(
            self, (PyObject *[]){at, args[LINKS], args[COLUMNS], args[WITNESSES], args[PLANES_NOW], args[PAIRS_OF],
                                 args[CLASSES_NOW], args[CLEARANCE], PyTuple_GET_ITEM(line, 1), PyTuple_GET_ITEM(line, 2),
                                 PyTuple_GET_ITEM(line, 3), args[DISTANCE], args[DISTANCE + 1], args[DISTANCE + 2],
                                 args[DISTANCE + 3], args[EXACT_RULES]}, 16);
    if (inexact)
        ways = ways_of_links(self, (PyObject *[]){at, args[LINKS], args[BEGUN], args[COLUMNS], args[FAT]}, 5);
    if (ways)
        urgent = box_urgency(
            self, (PyObject *[]){ways, args[COVERED], args[COVERED + 1], args[CLEARANCE], args[COVERED + 2],
                                 args[COVERED + 3], args[CLASSES_NOW], PyTuple_GET_ITEM(line, 1), PyTuple_GET_ITEM(line, 4),
                                 inexact, args[URGENT_RULES]}, 11);
    if (urgent && as_vec(urgent, "urgency", -1, &urgency) == 0) {
        npy_intp most = 0;
        for (npy_intp k = 1; k < urgency.n; k++)
            if (AT(urgency, k) > AT(urgency, most))
                most = k;
        if (urgency.n < 1)
            PyErr_SetString(PyExc_ValueError, "joint: there are no links");
        else
            found = Py_BuildValue("ndOOOOO", (Py_ssize_t)most, AT(urgency, most), PyTuple_GET_ITEM(line, 0),
                                  PyTuple_GET_ITEM(line, 1), PyTuple_GET_ITEM(line, 2), PyTuple_GET_ITEM(line, 3),
                                  PyTuple_GET_ITEM(line, 4));
    }
    Py_XDECREF(line), Py_XDECREF(at), Py_XDECREF(inexact), Py_XDECREF(ways), Py_XDECREF(urgent);
    return found;
}
