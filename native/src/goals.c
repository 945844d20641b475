/* Tests whether boxes of configurations miss a goal: proof/box_tests.py and proof/goal_features.py. */
#include "arrays.h"

#include <math.h>

#define MOST_FEATURES MOST_JOINTS

static const double TINY = 1e-300, DAMPING = 1e-3, LEAST_SHARE = 1e-3; /* as of the plain versions */
static const int STEPS = 3;

/* (boxes, rows, columns) doubles */
typedef struct {
    char *data;
    npy_intp boxes, rows, columns, along, down, right;
} Cube;

#define AT3(c, b, i, j) (*(double *)((c).data + (b) * (c).along + (i) * (c).down + (j) * (c).right))

static int as_cube(PyObject *object, const char *name, npy_intp boxes, npy_intp rows, npy_intp columns, Cube *out)
{
    if (is_array(object, name, NPY_DOUBLE, 3) < 0)
        return -1;
    PyArrayObject *array = (PyArrayObject *)object;
    out->data = PyArray_BYTES(array);
    out->boxes = PyArray_DIM(array, 0), out->rows = PyArray_DIM(array, 1), out->columns = PyArray_DIM(array, 2);
    out->along = PyArray_STRIDE(array, 0), out->down = PyArray_STRIDE(array, 1), out->right = PyArray_STRIDE(array, 2);
    return has_length(out->boxes, boxes, name) < 0 || has_length(out->rows, rows, name) < 0 ||
                   has_length(out->columns, columns, name) < 0
               ? -1
               : 0;
}

/* Features of a goal over B boxes, see `Features`. */
typedef struct {
    Mat error, slack;
    Cube J;
    const double *H;
    Ind group;
    npy_intp boxes, m, n, groups;
} Features;

static int as_features(PyObject *const *args, npy_intp boxes, npy_intp n, Features *out)
{
    npy_intp shape[4];
    out->n = n, out->boxes = boxes;
    if (some_joints(n) < 0 || as_mat(args[0], "error", boxes, -1, &out->error) < 0 ||
        as_mat(args[3], "slack", boxes, -1, &out->slack) < 0 ||
        as_ind(args[4], "group", out->slack.columns, &out->group) < 0 ||
        has_length(out->group.n, out->error.columns, "group") < 0 ||
        as_cube(args[1], "J", boxes, out->error.columns, n, &out->J) < 0 ||
        !(out->H = block(args[2], "H", 4, shape)) || has_length(shape[0], boxes, "H") < 0 ||
        has_length(shape[1], out->error.columns, "H") < 0 || has_length(shape[2], n, "H") < 0 ||
        has_length(shape[3], n, "H") < 0)
        return -1;
    out->m = out->error.columns, out->groups = out->slack.columns;
    if (out->m > MOST_FEATURES || out->groups > MOST_FEATURES) {
        PyErr_Format(joints_beyond, "at most %d features are wanted", MOST_FEATURES);
        return -1;
    }
    return 0;
}

/* The length of each group of x (m,). */
static void lengths_of(const Features *of, const double *x, double *out)
{
    for (npy_intp g = 0; g < of->groups; g++)
        out[g] = 0.0;
    for (npy_intp f = 0; f < of->m; f++)
        out[INDEX(of->group, f)] += x[f] * x[f];
    for (npy_intp g = 0; g < of->groups; g++)
        out[g] = sqrt(out[g]);
}

/* The direction w (m,) of one box whose part is low .. high (n,). */
static void best_direction(const Features *of, npy_intp b, const double *low, const double *high, double *w)
{
    const npy_intp m = of->m, n = of->n;
    double half[MOST_JOINTS], x[MOST_JOINTS], bend[MOST_FEATURES], weight[MOST_FEATURES], size[MOST_FEATURES];
    double curved = 0.0, square = TINY;
    for (npy_intp i = 0; i < n; i++)
        half[i] = fmax(fmax(-low[i], high[i]), 0.0), x[i] = 0.0;
    for (npy_intp f = 0; f < m; f++) {
        const double *H = of->H + (b * m + f) * n * n;
        bend[f] = 0.0;
        for (npy_intp i = 0; i < n; i++)
            for (npy_intp j = 0; j < n; j++)
                bend[f] += 0.5 * fabs(H[n * i + j]) * half[i] * half[j];
    }
    lengths_of(of, bend, size);
    for (npy_intp f = 0; f < m; f++) {
        const npy_intp g = INDEX(of->group, f);
        const double unsure = size[g] + AT2(of->slack, b, g);
        weight[f] = 1.0 / (unsure * unsure);
        for (npy_intp i = 0; i < n; i++)
            curved += AT3(of->J, b, f, i) * AT3(of->J, b, f, i) * half[i] * half[i] * weight[f];
    }
    square = curved > TINY ? curved : TINY;
    for (int turn = 0; turn <= STEPS; turn++) {
        for (npy_intp i = 0; i < n; i++)
            x[i] = fmin(fmax(x[i], low[i]), high[i]);
        for (npy_intp f = 0; f < m; f++) {
            w[f] = AT2(of->error, b, f);
            for (npy_intp i = 0; i < n; i++)
                w[f] -= AT3(of->J, b, f, i) * x[i];
        }
        lengths_of(of, w, size);
        for (npy_intp f = 0; f < m; f++) {
            const npy_intp g = INDEX(of->group, f);
            const double slack = AT2(of->slack, b, g);
            w[f] *= weight[f] * (size[g] > slack ? 1.0 - slack / fmax(size[g], TINY) : 0.0);
        }
        for (npy_intp i = 0; turn < STEPS && i < n; i++) {
            double pull = 0.0;
            for (npy_intp f = 0; f < m; f++)
                pull += AT3(of->J, b, f, i) * w[f];
            x[i] += half[i] * half[i] / square * pull;
        }
    }
}

/* The test along one direction: g d + d h d / 2 >= needed on the goal. */
typedef struct {
    double g[MOST_JOINTS], h[MOST_JOINTS * MOST_JOINTS], needed;
} Test;

static void test_along(const Features *of, npy_intp b, const double *w, Test *test)
{
    const npy_intp m = of->m, n = of->n;
    double size[MOST_FEATURES];
    for (npy_intp i = 0; i < n; i++)
        test->g[i] = 0.0;
    for (npy_intp k = 0; k < n * n; k++)
        test->h[k] = 0.0;
    lengths_of(of, w, size);
    test->needed = 0.0;
    for (npy_intp f = 0; f < m; f++) {
        const double *H = of->H + (b * m + f) * n * n;
        for (npy_intp i = 0; i < n; i++)
            test->g[i] += w[f] * AT3(of->J, b, f, i);
        for (npy_intp k = 0; k < n * n; k++)
            test->h[k] += w[f] * H[k];
        test->needed += w[f] * AT2(of->error, b, f);
    }
    for (npy_intp g = 0; g < of->groups; g++)
        test->needed -= size[g] > 0.0 ? size[g] * AT2(of->slack, b, g) : 0.0;
}

/* Whether no configuration within low .. high (n,) is on the goal. */
static int misses(const Test *test, npy_intp n, const double *low, const double *high)
{
    double found = 0.0, across = 0.0, size[MOST_JOINTS];
    for (npy_intp i = 0; i < n; i++)
        size[i] = fmax(fabs(low[i]), fabs(high[i]));
    for (npy_intp i = 0; i < n; i++) {
        const double g = test->g[i], own = test->h[n * i + i], top = own < 0.0 ? -g / own : INFINITY;
        found += top > low[i] && top < high[i]
                     ? 0.5 * g * top
                     : fmax((g + 0.5 * own * low[i]) * low[i], (g + 0.5 * own * high[i]) * high[i]);
        for (npy_intp j = 0; j < n; j++)
            across += j == i ? 0.0 : fabs(test->h[n * i + j]) * size[i] * size[j];
    }
    return found + 0.5 * across < test->needed;
}

PyObject *missed_up_to(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Features of;
    Mat middle, lower, upper, from, to;
    Ind known;
    npy_intp *missed;
    if (count_is(count, 11, "missed_up_to") < 0 || as_mat(args[5], "middle", -1, -1, &middle) < 0 ||
        as_features(args, middle.rows, middle.columns, &of) < 0 ||
        as_mat(args[6], "lower", of.boxes, of.n, &lower) < 0 || as_mat(args[7], "upper", of.boxes, of.n, &upper) < 0 ||
        as_mat(args[8], "furthest_down", -1, of.n, &from) < 0 ||
        as_mat(args[9], "furthest_up", from.rows, of.n, &to) < 0 ||
        as_ind(args[10], "known", from.rows - 1, &known) < 0 || has_length(known.n, of.boxes, "known") < 0)
        return NULL;
    PyObject *found = new_ind(of.boxes, &missed);
    for (npy_intp b = 0; found && b < of.boxes; b++) {
        npy_intp least = INDEX(known, b), reached = from.rows, level = least + 1;
        double low[MOST_JOINTS], high[MOST_JOINTS], w[MOST_FEATURES];
        Test test;
        for (int first = 1; first || reached - least > 1; first = 0) {
            for (npy_intp i = 0; i < of.n; i++) {
                low[i] = fmax(AT2(lower, b, i), AT2(from, level, i)) - AT2(middle, b, i);
                high[i] = fmin(AT2(upper, b, i), AT2(to, level, i)) - AT2(middle, b, i);
            }
            if (first) { /* the direction is that for the lowest level, and the highest one is tested first */
                best_direction(&of, b, low, high, w);
                test_along(&of, b, w, &test);
                level = from.rows - 1;
                continue;
            }
            if (misses(&test, of.n, low, high))
                least = level;
            else
                reached = level;
            level = (least + reached) / 2;
        }
        missed[b] = least;
    }
    return found;
}

/* The bounds least, most (n,) of one box; -1 where its equations cannot be solved. */
static int contract(const Features *of, npy_intp b, const Mat *half, double *least, double *most)
{
    const npy_intp m = of->m, n = of->n;
    double square[MOST_JOINTS * MOST_JOINTS], W[MOST_FEATURES * MOST_JOINTS], size[MOST_FEATURES], trace = 0.0;
    double slack[MOST_FEATURES];
    int known[MOST_FEATURES];
    for (npy_intp f = 0; f < m; f++)
        known[f] = isfinite(AT2(of->slack, b, INDEX(of->group, f))) != 0;
    for (npy_intp g = 0; g < of->groups; g++)
        slack[g] = isfinite(AT2(of->slack, b, g)) ? AT2(of->slack, b, g) : 0.0;
    for (npy_intp i = 0; i < n; i++)
        for (npy_intp j = 0; j < n; j++) {
            double sum = 0.0;
            for (npy_intp f = 0; f < m; f++)
                if (known[f])
                    sum += AT3(of->J, b, f, i) * AT2(*half, b, i) * AT3(of->J, b, f, j) * AT2(*half, b, j);
            square[n * i + j] = sum;
        }
    for (npy_intp i = 0; i < n; i++)
        trace += square[n * i + i];
    for (npy_intp i = 0; i < n; i++)
        square[n * i + i] += DAMPING * trace / n + TINY;
    if (cholesky(square, (int)n) < 0)
        return -1;
    for (npy_intp f = 0; f < m; f++) { /* W (m, n): of each feature, by joints */
        for (npy_intp i = 0; i < n; i++)
            W[n * f + i] = known[f] ? AT3(of->J, b, f, i) * AT2(*half, b, i) : 0.0;
        solve_cholesky(square, (int)n, W + n * f);
    }
    for (npy_intp j = 0; j < n; j++) {
        double w[MOST_FEATURES], others = 0.0, middle = 0.0, share = 0.0, rises = 0.0, falls = 0.0;
        for (npy_intp f = 0; f < m; f++) {
            w[f] = W[n * f + j];
            middle += known[f] ? w[f] * AT2(of->error, b, f) : 0.0;
        }
        lengths_of(of, w, size);
        for (npy_intp g = 0; g < of->groups; g++)
            others += size[g] * slack[g];
        for (npy_intp i = 0; i < n; i++) {
            const double wide = AT2(*half, b, i);
            double first = 0.0;
            for (npy_intp f = 0; f < m; f++)
                first += known[f] ? w[f] * AT3(of->J, b, f, i) : 0.0;
            if (i == j)
                share = first;
            else
                others += fabs(first) * wide;
            for (npy_intp k = 0; k < n; k++) {
                double second = 0.0;
                for (npy_intp f = 0; f < m; f++)
                    second += w[f] * of->H[((b * m + f) * n + i) * n + k];
                const double bend = 0.5 * second * wide * AT2(*half, b, k);
                if (k != i)
                    others += fabs(bend);
                else if (bend > 0.0)
                    rises += bend;
                else
                    falls += bend;
            }
        }
        const double wide = AT2(*half, b, j);
        least[j] = -wide, most[j] = wide;
        if (share * wide > LEAST_SHARE) {
            least[j] = fmax((middle - others - rises) / share, -wide);
            most[j] = fmin((middle + others - falls) / share, wide);
        }
    }
    return 0;
}

PyObject *contracted(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Features of;
    Mat half;
    double *least, *most;
    if (count_is(count, 6, "contracted") < 0 || as_mat(args[5], "half", -1, -1, &half) < 0 ||
        as_features(args, half.rows, half.columns, &of) < 0)
        return NULL;
    PyObject *low = new_mat(half.rows, half.columns, &least), *high = new_mat(half.rows, half.columns, &most);
    int fails = !low || !high;
    for (npy_intp b = 0; !fails && b < of.boxes; b++) {
        fails = contract(&of, b, &half, least + b * of.n, most + b * of.n) < 0;
        if (fails) /* by rounding: the plain version answers */
            PyErr_SetNone(joints_beyond);
    }
    if (fails) {
        Py_XDECREF(low), Py_XDECREF(high);
        return NULL;
    }
    return Py_BuildValue("NN", low, high);
}

PyObject *second_order(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Cube first, axes;
    Mat half;
    Vec hinge, bound;
    double *H, *rest, *longest;
    if (count_is(count, 5, "second_order") < 0 || as_mat(args[2], "half", -1, -1, &half) < 0 ||
        some_joints(half.columns) < 0 || as_cube(args[0], "first", half.rows, half.columns, 3, &first) < 0 ||
        as_cube(args[1], "axes", half.rows, half.columns, 3, &axes) < 0 ||
        as_vec(args[3], "hinge", half.columns, &hinge) < 0 || as_vec(args[4], "bound", half.columns, &bound) < 0)
        return NULL;
    const npy_intp k = half.columns;
    PyObject *second = PyArray_ZEROS(4, ((npy_intp[]){half.rows, 3, k, k}), NPY_DOUBLE, 0);
    PyObject *left = new_vec(half.rows, &rest), *lengths = new_mat(half.rows, k, &longest);
    if (!second || !left || !lengths) {
        Py_XDECREF(second), Py_XDECREF(left), Py_XDECREF(lengths);
        return NULL;
    }
    H = PyArray_DATA((PyArrayObject *)second);
    for (npy_intp b = 0; b < half.rows; b++, H += 3 * k * k) {
        double moved = 0.0, up_to = 0.0;
        for (npy_intp j = k - 1; j >= 0; j--) {
            double square = 0.0;
            for (int c = 0; c < 3; c++)
                square += AT3(first, b, j, c) * AT3(first, b, j, c);
            double *own = longest + b * k + j;
            *own = sqrt(square);
            if (AT(hinge, j) != 0.0) {
                *own = fmin(*own + moved, AT(bound, j));
                const double x = AT3(axes, b, j, 0), y = AT3(axes, b, j, 1), z = AT3(axes, b, j, 2);
                for (npy_intp i = j; i < k; i++) {
                    const double u = AT3(first, b, i, 0), v = AT3(first, b, i, 1), w = AT3(first, b, i, 2);
                    H[k * j + i] = H[k * i + j] = y * w - z * v;
                    H[k * k + k * j + i] = H[k * k + k * i + j] = z * u - x * w;
                    H[2 * k * k + k * j + i] = H[2 * k * k + k * i + j] = x * v - y * u;
                }
            }
            moved += *own * AT2(half, b, j);
        }
        rest[b] = 0.0;
        for (npy_intp j = 0; j < k; j++) {
            const double wide = AT2(half, b, j), before = up_to;
            if (AT(hinge, j) > 0.0) {
                up_to += wide * AT(hinge, j);
                rest[b] += longest[b * k + j] * (up_to * up_to * up_to - before * before * before) / 6.0;
            } else
                rest[b] += longest[b * k + j] * 3.0 * wide * before * before / 6.0;
        }
    }
    return Py_BuildValue("NNN", second, left, lengths);
}
