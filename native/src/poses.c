/* The search for configurations that put the tip on given poses. */
#include "arrays.h"

#include <math.h>

#define ROWS 6 /* of position and orientation */

/* A chain of joints: its constants joint by joint, which of them slide, its tip, its limits. */
typedef struct {
    npy_intp n;
    double factors[MOST_JOINTS][33], lower[MOST_JOINTS], upper[MOST_JOINTS], tip[4][3];
    int slides[MOST_JOINTS];
} Chain;

/* The numbers of a search, in the order of the plain version's tuple. */
typedef struct {
    double tolerance, stalled_at, most_stalled, damping, most_damped, least_damping, largest, immovable, no_sine,
        near_half_turn;
} Settings;

#define SETTINGS (sizeof(Settings) / sizeof(double))

/* The axes and origins of the joints at x, the tip's rotation by columns, and its position. */
static void place(const Chain *chain, const double *x, double axis[][3], double origin[][3], double turned[3][3],
                  double *at)
{
    double R[3][3] = {{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}}, from[3] = {0.0, 0.0, 0.0}, now[3][3];
    for (npy_intp j = 0; j < chain->n; j++) {
        const double *f = chain->factors[j], sine = sin(x[j]), versine = 1.0 - cos(x[j]);
        for (int r = 0; r < 3; r++) {
            const double a = R[0][r], b = R[1][r], c = R[2][r];
            axis[j][r] = f[27] * a + f[28] * b + f[29] * c;
            from[r] += f[30] * a + f[31] * b + f[32] * c;
            if (chain->slides[j])
                from[r] += axis[j][r] * x[j];
            origin[j][r] = from[r];
            for (int k = 0; k < 3; k++) {
                const double *still = f + 3 * k, *swung = f + 9 + 3 * k, *bent = f + 18 + 3 * k;
                now[k][r] = still[0] * a + still[1] * b + still[2] * c;
                if (!chain->slides[j])
                    now[k][r] = sine * (swung[0] * a + swung[1] * b + swung[2] * c) + now[k][r] +
                                versine * (bent[0] * a + bent[1] * b + bent[2] * c);
            }
        }
        for (int k = 0; k < 3; k++)
            for (int r = 0; r < 3; r++)
                R[k][r] = now[k][r];
    }
    for (int r = 0; r < 3; r++) {
        for (int k = 0; k < 3; k++)
            turned[k][r] = chain->tip[k][0] * R[0][r] + chain->tip[k][1] * R[1][r] + chain->tip[k][2] * R[2][r];
        at[r] = from[r] + (chain->tip[3][0] * R[0][r] + chain->tip[3][1] * R[1][r] + chain->tip[3][2] * R[2][r]);
    }
}

/* The rotation vector of T. */
static void rotation_vector(double T[3][3], const Settings *of, double *out)
{
    const double twice[3] = {T[2][1] - T[1][2], T[0][2] - T[2][0], T[1][0] - T[0][1]};
    const double sine = 0.5 * sqrt(twice[0] * twice[0] + twice[1] * twice[1] + twice[2] * twice[2]);
    const double trace = T[0][0] + T[1][1] + T[2][2], cosine = 0.5 * (trace - 1.0);
    if (cosine < of->near_half_turn) {
        int k = 0;
        for (int c = 1; c < 3; c++)
            if (T[c][c] > T[k][k])
                k = c;
        double axis[3], square = 0.0, along = 0.0;
        for (int c = 0; c < 3; c++) {
            axis[c] = T[c][k] + T[k][c] + (c == k ? 1.0 - trace : 0.0);
            square += axis[c] * axis[c];
        }
        for (int c = 0; c < 3; c++)
            axis[c] /= sqrt(square), along += 0.5 * axis[c] * twice[c];
        for (int c = 0; c < 3; c++)
            out[c] = atan2(along, cosine) * axis[c];
        return;
    }
    const double ratio = sine > of->no_sine ? atan2(sine, cosine) / sine : 1.0;
    for (int c = 0; c < 3; c++)
        out[c] = 0.5 * ratio * twice[c];
}

/* The step J^T (J J^T + damping I)^-1 error of the joints that are free. */
static void damped_step(double J[ROWS][MOST_JOINTS], const double *error, int rows, npy_intp n, double damping,
                        const int *free, double *step)
{
    double square[ROWS][ROWS], x[ROWS];
    for (int a = 0; a < rows; a++) {
        x[a] = error[a];
        for (int c = 0; c <= a; c++) {
            double sum = 0.0;
            for (npy_intp i = 0; i < n; i++)
                if (free[i])
                    sum += J[a][i] * J[c][i];
            square[a][c] = square[c][a] = sum;
        }
    }
    for (int a = 0; a < rows; a++)
        square[a][a] += damping;
    for (int row = 0; row < rows; row++)
        for (int a = row + 1; a < rows; a++) {
            const double below = square[a][row] / square[row][row];
            for (int c = row + 1; c < rows; c++)
                square[a][c] -= below * square[row][c];
            x[a] -= below * x[row];
        }
    for (int row = rows - 1; row >= 0; row--) {
        x[row] /= square[row][row];
        for (int a = 0; a < row; a++)
            x[a] -= square[a][row] * x[row];
    }
    for (npy_intp i = 0; i < n; i++) {
        step[i] = 0.0;
        for (int a = 0; free[i] && a < rows; a++)
            step[i] += J[a][i] * x[a];
    }
}

/* Moves x by one step towards an error, within the limits. */
static void move(const Chain *chain, const Settings *of, double J[ROWS][MOST_JOINTS], const double *error, int rows,
                 double cost, double *x)
{
    const npy_intp n = chain->n;
    const double damping = fmin(cost, of->most_damped) * of->damping + of->least_damping;
    double step[MOST_JOINTS];
    int free[MOST_JOINTS];
    for (npy_intp i = 0; i < n; i++)
        free[i] = 1;
    for (npy_intp round = 0; round < n; round++) {
        int hits = 0;
        damped_step(J, error, rows, n, damping, free, step);
        for (npy_intp i = 0; i < n && round + 1 < n; i++)
            if (free[i] && ((x[i] <= chain->lower[i] && step[i] < 0.0) || (x[i] >= chain->upper[i] && step[i] > 0.0)))
                free[i] = 0, hits++;
        if (!hits)
            break;
    }
    for (npy_intp i = 0; i < n; i++)
        x[i] = fmin(fmax(x[i] + fmin(fmax(step[i], -of->largest), of->largest), chain->lower[i]), chain->upper[i]);
}

/* Searches from x, which it moves; whether it arrives. `rotation` is NULL if only the position is asked. */
static int search(const Chain *chain, const Settings *of, npy_intp iterations, const double *position,
                  const double *rotation, double *x)
{
    double before = INFINITY, axis[MOST_JOINTS][3], origin[MOST_JOINTS][3], turned[3][3], at[3], error[ROWS];
    double stalled = 0.0;
    for (npy_intp iteration = 0;; iteration++) {
        double cost = 0.0, J[ROWS][MOST_JOINTS], kept[ROWS];
        int rows = 0;
        place(chain, x, axis, origin, turned, at);
        for (int c = 0; c < 3; c++)
            error[c] = position[c] - at[c];
        if (rotation) {
            double T[3][3];
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) {
                    T[i][j] = 0.0;
                    for (int k = 0; k < 3; k++)
                        T[i][j] += rotation[3 * i + k] * turned[k][j];
                }
            rotation_vector(T, of, error + 3);
        }
        for (int a = 0; a < (rotation ? 6 : 3); a++)
            cost += error[a] * error[a];
        if (sqrt(cost) <= of->tolerance)
            return 1;
        stalled = cost > of->stalled_at * before ? stalled + 1.0 : 0.0;
        before = cost;
        if (stalled > of->most_stalled || iteration >= iterations || !(cost < INFINITY)) /* a NaN leads nowhere */
            return 0;
        for (int a = 0; a < (rotation ? 6 : 3); a++) {
            double largest = 0.0;
            for (npy_intp i = 0; i < chain->n; i++) {
                const int c = a % 3, d = (c + 1) % 3, e = (c + 2) % 3;
                if (chain->slides[i])
                    J[rows][i] = a < 3 ? axis[i][c] : 0.0;
                else
                    J[rows][i] = a < 3 ? axis[i][d] * (at[e] - origin[i][e]) - axis[i][e] * (at[d] - origin[i][d])
                                       : axis[i][c];
                largest = fmax(largest, fabs(J[rows][i]));
            }
            if (largest > of->immovable) /* otherwise the next row takes its place */
                kept[rows++] = error[a];
        }
        move(chain, of, J, kept, rows, cost, x);
    }
}

PyObject *solve_poses(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat guesses, position, factors, tip;
    Vec slides, lower, upper;
    Chain chain;
    Settings of;
    npy_intp shape[3];
    double *x;
    if (count_is(count, 10, "solve_poses") < 0 || as_mat(args[0], "guesses", -1, -1, &guesses) < 0 ||
        as_mat(args[1], "position", guesses.rows, 3, &position) < 0 ||
        as_mat(args[3], "factors", 33, guesses.columns, &factors) < 0 ||
        as_vec(args[4], "slides", guesses.columns, &slides) < 0 || as_mat(args[5], "tip", 4, 3, &tip) < 0 ||
        as_vec(args[6], "lower", guesses.columns, &lower) < 0 ||
        as_vec(args[7], "upper", guesses.columns, &upper) < 0 ||
        as_doubles(args[8], "settings", SETTINGS, (double *)&of) < 0)
        return NULL;
    const npy_intp B = guesses.rows, iterations = PyLong_AsSsize_t(args[9]);
    const double *rotation = block(args[2], "rotation", 3, shape);
    if (!rotation || PyErr_Occurred() || some_joints(guesses.columns) < 0)
        return NULL;
    if ((shape[0] && shape[0] != B) || shape[1] != 3 || shape[2] != 3) {
        PyErr_SetString(PyExc_ValueError, "rotation: an array (B, 3, 3) or (0, 3, 3) is wanted");
        return NULL;
    }
    chain.n = guesses.columns;
    for (npy_intp j = 0; j < chain.n; j++) {
        for (int k = 0; k < 33; k++)
            chain.factors[j][k] = AT2(factors, k, j);
        chain.slides[j] = AT(slides, j) != 0.0;
        chain.lower[j] = AT(lower, j), chain.upper[j] = AT(upper, j);
    }
    for (int k = 0; k < 4; k++)
        for (int c = 0; c < 3; c++)
            chain.tip[k][c] = AT2(tip, k, c);
    PyObject *found = new_mat(B, chain.n, &x), *flags = PyArray_EMPTY(1, (npy_intp *)&B, NPY_BOOL, 0);
    if (!found || !flags) {
        Py_XDECREF(found), Py_XDECREF(flags);
        return NULL;
    }
    npy_bool *reached = (npy_bool *)PyArray_DATA((PyArrayObject *)flags);
    for (npy_intp b = 0; b < B; b++) {
        const double target[3] = {AT2(position, b, 0), AT2(position, b, 1), AT2(position, b, 2)};
        double *own = x + chain.n * b;
        for (npy_intp j = 0; j < chain.n; j++) {
            own[j] = AT2(guesses, b, j); /* one that is not a number stays so */
            own[j] = own[j] < chain.lower[j] ? chain.lower[j] : own[j] > chain.upper[j] ? chain.upper[j] : own[j];
        }
        reached[b] = (npy_bool)search(&chain, &of, iterations, target, shape[0] ? rotation + 9 * b : NULL, own);
    }
    return Py_BuildValue("NN", found, flags);
}
