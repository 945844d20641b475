/* The shield: whether a wish may be kept as it is, and the program of the nearest one that may. */
#include "arrays.h"

#include <math.h>

enum { STOPPING_PART, RECOVERY, FASTEST_RECOVERY, RATES };
#define OF(j, column) joints[COLUMNS * (j) + (column)]
enum { LEAST, MOST, FIRST, LAST, VELOCITY, ACCELERATION, CHANGE, PER, COLUMNS };

static double stoppable(double gap, double a, double lead, const double *set)
{
    if (gap < 0.0) {
        const double back = -set[RECOVERY] * gap;
        return -(back < set[FASTEST_RECOVERY] ? back : set[FASTEST_RECOVERY]);
    }
    return a * (sqrt(lead * lead + 2.0 * gap / a) - lead);
}

PyObject *step_conditions(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec wish, q, before, margin, drift, extra = {0};
    Mat gradient;
    double dt, joints[COLUMNS * MOST_JOINTS], set[RATES], same = 0.0, time = 0.0;
    if (count_is(count, 10, "step_conditions") < 0 || as_vec(args[0], "wish", -1, &wish) < 0 ||
        as_vec(args[1], "q", wish.n, &q) < 0 || as_vec(args[2], "v_before", wish.n, &before) < 0 ||
        as_double(args[3], "dt", &dt) < 0 || some_joints(wish.n) < 0 ||
        as_table(args[4], "joints", wish.n, COLUMNS, joints) < 0 ||
        as_vec(args[5], "margin", -1, &margin) < 0 || as_mat(args[7], "gradient", margin.n, wish.n, &gradient) < 0 ||
        as_vec(args[8], "drift", margin.n, &drift) < 0 || as_doubles(args[9], "rates", RATES, set) < 0)
        return NULL;
    if (PyFloat_Check(args[6]))
        same = PyFloat_AS_DOUBLE(args[6]);
    else if (as_vec(args[6], "extra", margin.n, &extra) < 0)
        return NULL;
    double *low, *high, *bound;
    PyObject *low_high = new_mat(2, wish.n, &low), *bounds = new_vec(margin.n, &bound);
    if (!low_high || !bounds) {
        Py_XDECREF(low_high), Py_XDECREF(bounds);
        return NULL;
    }
    high = low + wish.n;
    int kept = 1;
    for (npy_intp j = 0; j < wish.n; j++) {
        const double position = AT(q, j), rate = AT(before, j), wished = AT(wish, j);
        const double velocity = OF(j, VELOCITY), a = OF(j, ACCELERATION), per = OF(j, PER);
        const double slowest = rate - OF(j, CHANGE), fastest = rate + OF(j, CHANGE);
        double upper = velocity, lower = -velocity;
        if (!(OF(j, FIRST) < position && position < OF(j, LAST))) {
            const double up = stoppable(OF(j, MOST) - position, a, 1.5 * dt, set);
            const double down = stoppable(position - OF(j, LEAST), a, 1.5 * dt, set);
            upper = velocity < up ? velocity : up;
            lower = -(velocity < down ? velocity : down);
        }
        low[j] = lower > slowest ? (lower < fastest ? lower : fastest) : slowest;
        high[j] = upper < fastest ? (upper > slowest ? upper : slowest) : fastest;
        if (high[j] < low[j])
            high[j] = low[j];
        if (!(low[j] <= wished && wished <= high[j]))
            kept = 0;
        const double stop = fabs(rate) * per, stop_after = fabs(wished) * per;
        if (stop > time)
            time = stop;
        if (stop_after > time)
            time = stop_after;
    }
    const double shortest = set[STOPPING_PART] * 2.0 * dt;
    const double gamma = set[STOPPING_PART] / (time > shortest ? time : shortest);
    for (npy_intp k = 0; k < margin.n; k++) {
        const double left = AT(margin, k) - (extra.data ? AT(extra, k) : same);
        double may = left * gamma, rate = 0.0;
        if (left < 0.0) {
            const double back = -set[RECOVERY] * left;
            may = -(back < set[FASTEST_RECOVERY] ? back : set[FASTEST_RECOVERY]);
        }
        bound[k] = may + AT(drift, k);
        for (npy_intp j = 0; j < wish.n; j++)
            rate += AT2(gradient, k, j) * AT(wish, j);
        if (!(rate + bound[k] >= 0.0))
            kept = 0;
    }
    if (kept) {
        Py_DECREF(low_high);
        low_high = Py_NewRef(Py_None);
    }
    return Py_BuildValue("NNdN", PyBool_FromLong(kept), low_high, time, bounds);
}

PyObject *nearest_safe_program(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec wish, bound, low, high;
    Mat J, gradient;
    double weights[3]; /* across the wish, along it, free */
    Py_ssize_t few;
    if (count_is(count, 8, "nearest_safe_program") < 0 || as_vec(args[0], "wish", -1, &wish) < 0 ||
        as_mat(args[1], "J_tip", 3, wish.n, &J) < 0 || as_vec(args[3], "bound", -1, &bound) < 0 ||
        as_mat(args[2], "gradient", bound.n, wish.n, &gradient) < 0 || as_vec(args[4], "low", wish.n, &low) < 0 ||
        as_vec(args[5], "high", wish.n, &high) < 0 || as_doubles(args[6], "weights", 3, weights) < 0)
        return NULL;
    few = PyLong_AsSsize_t(args[7]);
    if (few == -1 && PyErr_Occurred())
        return NULL;
    const npy_intp n = wish.n;
    if (some_joints(n) < 0)
        return NULL;
    double tip[3] = {0.0}, speed2 = 0.0, along[MOST_JOINTS] = {0.0};
    for (int c = 0; c < 3; c++) {
        for (npy_intp j = 0; j < n; j++)
            tip[c] += AT2(J, c, j) * AT(wish, j);
        speed2 += tip[c] * tip[c];
    }
    for (npy_intp j = 0; j < n; j++)
        for (int c = 0; c < 3; c++)
            along[j] += tip[c] * AT2(J, c, j);
    const double less = speed2 > 1e-12 ? (weights[1] - weights[0]) / speed2 : 0.0;
    Room room;
    npy_intp *chosen = room_for(&room, bound.n * sizeof(npy_intp)), some = 0;
    if (!chosen)
        return NULL;
    for (npy_intp k = 0; k < bound.n; k++) {
        if (bound.n > few) {
            double fastest = 0.0;
            for (npy_intp j = 0; j < n; j++) {
                const double g = -AT2(gradient, k, j), middle = 0.5 * (AT(low, j) + AT(high, j));
                fastest += fabs(g) * (AT(high, j) - middle) + g * middle;
            }
            if (!(AT(bound, k) <= fastest))
                continue;
        }
        chosen[some++] = k;
    }
    double *H, *f, *G, *h;
    PyObject *result = NULL, *parts[5] = {new_mat(n, n, &H), new_vec(n, &f), new_mat(some, n, &G), new_vec(some, &h),
                                          ind_of(chosen, some)};
    for (int part = 0; part < 5; part++)
        if (!parts[part])
            goto done;
    for (npy_intp i = 0; i < n; i++) {
        f[i] = 0.0;
        for (npy_intp j = 0; j < n; j++) {
            double sum = along[i] * along[j] * less + (i == j ? weights[2] : 0.0);
            for (int c = 0; c < 3; c++)
                sum += weights[0] * AT2(J, c, i) * AT2(J, c, j);
            H[n * i + j] = sum;
            f[i] -= sum * AT(wish, j);
        }
    }
    for (npy_intp k = 0; k < some; k++) {
        h[k] = AT(bound, chosen[k]);
        for (npy_intp j = 0; j < n; j++)
            G[n * k + j] = -AT2(gradient, chosen[k], j);
    }
    result = PyTuple_New(5);
    if (result)
        for (int part = 0; part < 5; part++)
            PyTuple_SET_ITEM(result, part, Py_NewRef(parts[part]));
done:
    for (int part = 0; part < 5; part++)
        Py_XDECREF(parts[part]);
    release(&room);
    return result;
}
