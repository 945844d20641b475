/* The fastest run along a path, and the least durations in which joints get what they need: proof/least_times.py. */
#include "arrays.h"

#include <math.h>

#define STEPS 60
#define ROUNDING 1e-10
#define MOST_SUPPLIED 8 /* joints of which all sets are looked at */

/* u <= level + slope x, or u >= it, of one interval */
typedef struct {
    const double *level, *slope;
    npy_intp count;
} Lines;

static void bound(const Lines *lines, double sign, double x, double *level, double *slope)
{
    *level = sign * INFINITY, *slope = 0.0;
    for (npy_intp i = 0; i < lines->count; i++) {
        const double at = lines->level[i] + lines->slope[i] * x;
        if (sign * at < sign * *level)
            *level = at, *slope = lines->slope[i];
    }
}

/* The greatest x, at most as given, with a u so that 0 <= x + twice u <= ahead; -1 where there is none. */
static double greatest(const Lines *tops, const Lines *bottoms, double x, double twice, double ahead)
{
    for (int step = 0; step < STEPS; step++) {
        double top, rise, bottom, fall;
        bound(tops, 1.0, x, &top, &rise);
        bound(bottoms, -1.0, x, &bottom, &fall);
        if ((ahead - x) / twice < top)
            top = (ahead - x) / twice, rise = -1.0 / twice;
        if (-x / twice > bottom)
            bottom = -x / twice, fall = -1.0 / twice;
        const double room = top - bottom;
        if (room >= -ROUNDING * (fabs(top) + fabs(bottom)))
            return x;
        const double slope = rise - fall;
        if (slope >= 0.0 || x <= 0.0)
            return -1.0;
        x = fmax(x - room / slope, 0.0);
    }
    return x;
}

PyObject *fastest_run(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec grid, caps;
    Mat rows[2][3];
    static const char *const names[2][3] = {{"alpha before", "beta before", "gamma before"},
                                            {"alpha after", "beta after", "gamma after"}};
    if (count_is(count, 9, "fastest_run") < 0 || as_vec(args[0], "grid", -1, &grid) < 0 ||
        as_vec(args[1], "caps", grid.n, &caps) < 0)
        return NULL;
    if (grid.n < 2) {
        PyErr_SetString(PyExc_ValueError, "grid: two values at least are wanted");
        return NULL;
    }
    const npy_intp N = grid.n - 1;
    for (int end = 0; end < 2; end++)
        for (int k = 0; k < 3; k++)
            if (as_mat(args[2 + 3 * end + k], names[end][k], N, k ? rows[end][0].columns : -1, &rows[end][k]) < 0)
                return NULL;
    const int rests = PyObject_IsTrue(args[8]);
    if (rests < 0)
        return NULL;
    const npy_intp each = rows[0][0].columns + rows[1][0].columns;
    double *x, *time;
    PyObject *xs = new_vec(N + 1, &x), *times = new_vec(N + 1, &time);
    Room room, interval_room;
    double *lines = room_for(&room, (4 * N * each + 1) * sizeof(double));
    struct {
        Lines tops, bottoms;
        double twice;
    } *at = lines ? room_for(&interval_room, N * sizeof *at) : NULL;
    if (!xs || !times || !at) {
        Py_XDECREF(xs), Py_XDECREF(times);
        if (lines)
            release(&room);
        if (at)
            release(&interval_room);
        return NULL;
    }
    int found = 1;
    for (npy_intp i = 0; i <= N; i++)
        x[i] = AT(caps, i);
    for (npy_intp i = 0; i < N; i++) {
        const double step = AT(grid, i + 1) - AT(grid, i);
        double *top = lines + 4 * each * i, *rise = top + each, *bottom = rise + each, *fall = bottom + each;
        npy_intp above = 0, below = 0;
        for (int end = 0; end < 2; end++)
            for (npy_intp r = 0; r < rows[end][0].columns; r++) {
                const double beta = AT2(rows[end][1], i, r), gamma = AT2(rows[end][2], i, r);
                const double alpha = AT2(rows[end][0], i, r) + (end ? 2.0 * step * beta : 0.0);
                if (fabs(alpha) / step <= ROUNDING * fmax(fabs(beta), 1e-9)) {
                    if (beta > 0.0 && gamma / beta < x[i])
                        x[i] = gamma / beta;
                } else if (alpha > 0.0)
                    top[above] = gamma / alpha, rise[above++] = -beta / alpha;
                else
                    bottom[below] = gamma / alpha, fall[below++] = -beta / alpha;
            }
        at[i].tops = (Lines){top, rise, above};
        at[i].bottoms = (Lines){bottom, fall, below};
        at[i].twice = 2.0 * step;
    }
    if (rests)
        x[0] = x[N] = 0.0;
    for (npy_intp i = N - 1; i >= 0 && found; i--) {
        x[i] = greatest(&at[i].tops, &at[i].bottoms, x[i], at[i].twice, x[i + 1]);
        found = x[i] >= 0.0;
    }
    time[0] = 0.0;
    for (npy_intp i = 0; i < N && found; i++) {
        double hardest, slope;
        bound(&at[i].tops, 1.0, x[i], &hardest, &slope);
        x[i + 1] = fmin(fmax(x[i] + at[i].twice * hardest, 0.0), x[i + 1]);
        const double mean = 0.5 * (sqrt(x[i]) + sqrt(x[i + 1]));
        found = mean > 0.0 && isfinite(mean);
        time[i + 1] = time[i] + 0.5 * at[i].twice / mean;
    }
    release(&room), release(&interval_room);
    if (!found) {
        Py_DECREF(xs), Py_DECREF(times);
        Py_RETURN_NONE;
    }
    return Py_BuildValue("NN", xs, times);
}

/* `y` at x, linear between the points of `at`, which does not decrease; constant beyond its ends. As numpy's interp. */
static double read_line(double x, const Mat *at, npy_intp row, const Vec *y)
{
    npy_intp low = 0, high = y->n - 1;
    if (x > AT2(*at, row, high))
        return AT(*y, high);
    if (x < AT2(*at, row, 0))
        return AT(*y, 0);
    while (high - low > 1) {
        const npy_intp middle = low + (high - low) / 2;
        if (x >= AT2(*at, row, middle))
            low = middle;
        else
            high = middle;
    }
    if (x >= AT2(*at, row, high))
        return AT(*y, high);
    const double begin = AT2(*at, row, low);
    const double slope = (AT(*y, high) - AT(*y, low)) / (AT2(*at, row, high) - begin);
    return slope * (x - begin) + AT(*y, low);
}

PyObject *least_supplied(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat need, amounts;
    Vec time;
    npy_intp shape[2], sets = 1, power[MOST_SUPPLIED];
    double *found;
    const npy_intp *way;
    if (count_is(count, 4, "least_supplied") < 0 || as_mat(args[0], "need", -1, -1, &need) < 0 ||
        some_joints(need.columns) < 0 || !(way = index_block(args[1], "way", 2, shape)) ||
        has_length(shape[0], need.rows, "way") < 0 || has_length(shape[1], need.columns, "way") < 0 ||
        as_vec(args[3], "time", -1, &time) < 0)
        return NULL;
    if (need.columns > MOST_SUPPLIED) {
        PyErr_SetString(joints_beyond, "need: too many joints");
        return NULL;
    }
    for (npy_intp j = 0; j < need.columns; j++, sets *= 3)
        power[j] = sets;
    if (as_mat(args[2], "amounts", sets, time.n, &amounts) < 0)
        return NULL;
    if (time.n < 1) {
        PyErr_SetString(PyExc_ValueError, "time: is empty");
        return NULL;
    }
    for (npy_intp k = 0; k < need.rows * need.columns; k++)
        if (way[k] < 0 || way[k] > 2) {
            PyErr_SetString(PyExc_IndexError, "way: is not 0, 1 or 2");
            return NULL;
        }
    PyObject *durations = new_vec(need.rows, &found);
    if (!durations)
        return NULL;
    for (npy_intp k = 0; k < need.rows; k++) {
        const npy_intp *own = way + k * need.columns;
        found[k] = 0.0;
        for (int set = 1; set < 1 << need.columns; set++) {
            double asked = 0.0;
            npy_intp row = 0, moves = 1;
            for (npy_intp j = 0; j < need.columns && moves; j++)
                if (set >> j & 1) {
                    asked += AT2(need, k, j);
                    row += own[j] * power[j];
                    moves = own[j] > 0;
                }
            if (!moves)
                continue;
            const double least = 2.0 * read_line(0.5 * asked, &amounts, row, &time);
            if (least > found[k])
                found[k] = least;
        }
    }
    return durations;
}
