/* Quadratic programs with bounds and soft rows, as the servo has them: a few joints, and a few conditions that bind. */
#include "arrays.h"

#include <math.h>

#define MOST_ROWS 48
#define MOST_CONDITIONS (MOST_JOINTS + MOST_ROWS)

static const double KEPT = 1e-6; /* rad/s or m/s, in the measure of the cost: the tolerance of daqp, the plain version */
static const double ROUNDING = 1e-5; /* a row without a greater entry is noise; see the plain version */
static const double PRICE = 1e6; /* of what soft rows miss, as of the plain version */

typedef struct {
    npy_intp n, K;
    double rows[MOST_ROWS * MOST_JOINTS], h[MOST_ROWS], low[MOST_JOINTS], high[MOST_JOINTS];
    double back[MOST_CONDITIONS * MOST_JOINTS]; /* H^-1 g of each condition g: those of the joints come first */
    double size[MOST_CONDITIONS];               /* how far x moves, as the cost measures it, for a change of 1; or 0 */
} Program;

/* A condition that binds: x_j <= high_j, or by the sign -x_j <= -low_j, or a row; and the force that keeps it. */
typedef struct {
    npy_intp of;
    double sign, force;
} Binding;

/* g x of a condition */
static double along(const Program *program, npy_intp of, const double *x)
{
    const npy_intp n = program->n;
    if (of < n)
        return x[of];
    double sum = 0.0;
    for (npy_intp j = 0; j < n; j++)
        sum += program->rows[n * (of - n) + j] * x[j];
    return sum;
}

/* by how much x (n,) breaks a condition on the side of `sign` */
static double beyond(const Program *program, npy_intp of, double sign, const double *x)
{
    const double limit = of >= program->n ? program->h[of - program->n] : sign > 0.0 ? program->high[of] : program->low[of];
    return sign * (along(program, of, x) - limit);
}

/* The inactive condition that x (n,) breaks most, in the measure of the cost; without a sign where none is broken. */
static Binding most_broken(const Program *program, const double *x, const Binding *binding, npy_intp count)
{
    Binding found = {0, 0.0, 0.0};
    double most = KEPT;
    for (npy_intp k = 0; k < program->n + program->K; k++) {
        int binds = 0;
        for (npy_intp p = 0; p < count; p++)
            binds |= binding[p].of == k;
        if (binds || !(program->size[k] > 0.0)) /* such a row keeps nobody */
            continue;
        for (double sign = 1.0; sign >= (k < program->n ? -1.0 : 1.0); sign -= 2.0) {
            const double missed = beyond(program, k, sign, x) / program->size[k];
            if (missed > most)
                most = missed, found.of = k, found.sign = sign;
        }
    }
    return found;
}

/* The forces (count,) with which all that bind are just kept, soft ones but for what they miss; -1 where none are. */
static int balance(const Program *program, const double *free, const Binding *binding, npy_intp count, double *Q,
                   double *forces)
{
    const npy_intp n = program->n;
    for (npy_intp p = 0; p < count; p++) {
        for (npy_intp q = 0; q <= p; q++)
            Q[count * p + q] = binding[p].sign * binding[q].sign * along(program, binding[p].of, program->back + n * binding[q].of);
        if (binding[p].of >= n)
            Q[count * p + p] *= 1.0 + 1.0 / PRICE;
        forces[p] = beyond(program, binding[p].of, binding[p].sign, free);
    }
    if (cholesky(Q, (int)count) < 0)
        return -1;
    solve_cholesky(Q, (int)count, forces);
    return 0;
}

/* Take conditions in and out until all forces push: as in Lawson and Hanson's least squares. -1 where that fails. */
static int settle(const Program *program, const double *free, Binding *binding, npy_intp *count, double *Q)
{
    double forces[MOST_CONDITIONS];
    for (npy_intp round = 0; round <= MOST_CONDITIONS; round++) {
        if (balance(program, free, binding, *count, Q, forces) < 0)
            return -1;
        double part = 1.0;
        for (npy_intp p = 0; p < *count; p++)
            if (!(forces[p] > 0.0)) {
                const double until = binding[p].force / (binding[p].force - forces[p]);
                part = until < part ? until : part;
            }
        npy_intp left = 0;
        int all = 1;
        for (npy_intp p = 0; p < *count; p++) {
            const double force = binding[p].force + part * (forces[p] - binding[p].force);
            const int stays = forces[p] > 0.0 || force > 0.0;
            all &= forces[p] > 0.0;
            binding[left] = binding[p], binding[left].force = force;
            left += stays;
        }
        if (all)
            return 0;
        if (left == *count || left == 0) /* by rounding: the general solver answers */
            return -1;
        *count = left;
    }
    return -1;
}

PyObject *soft_solution(PyObject *self, PyObject *const *args, Py_ssize_t given)
{
    Vec f, low, high, h;
    Mat H, G;
    if (count_is(given, 7, "soft_solution") < 0 || as_vec(args[1], "f", -1, &f) < 0 || some_joints(f.n) < 0 ||
        as_mat(args[0], "H", f.n, f.n, &H) < 0 || as_vec(args[2], "low", f.n, &low) < 0 ||
        as_vec(args[3], "high", f.n, &high) < 0 || as_vec(args[5], "h", -1, &h) < 0 ||
        as_mat(args[4], "G", h.n, f.n, &G) < 0)
        return NULL;
    const npy_intp most = PyNumber_AsSsize_t(args[6], PyExc_IndexError), n = f.n, K = h.n;
    if (most == -1 && PyErr_Occurred())
        return NULL;
    Program program;
    Binding binding[MOST_CONDITIONS];
    double L[MOST_JOINTS * MOST_JOINTS], Q[MOST_CONDITIONS * MOST_CONDITIONS], free[MOST_JOINTS], x[MOST_JOINTS];
    npy_intp count = 0, iterations = 0;
    int fails = K > MOST_ROWS;
    if (!fails) {
        program.n = n, program.K = K;
        for (npy_intp i = 0; i < n; i++) {
            free[i] = -AT(f, i), program.low[i] = AT(low, i), program.high[i] = AT(high, i);
            for (npy_intp j = 0; j < n; j++)
                L[n * i + j] = AT2(H, i, j);
        }
        fails = cholesky(L, (int)n) < 0;
    }
    if (!fails) {
        solve_cholesky(L, (int)n, free);
        for (npy_intp k = 0; k < n + K; k++) {
            double *back = program.back + n * k, *row = k < n ? NULL : program.rows + n * (k - n);
            for (npy_intp j = 0; j < n; j++) {
                back[j] = row ? AT2(G, k - n, j) : (double)(j == k);
                if (row)
                    row[j] = back[j];
            }
            int says = !row;
            if (row)
                program.h[k - n] = AT(h, k - n);
            for (npy_intp j = 0; row && j < n; j++)
                says |= fabs(row[j]) > ROUNDING;
            solve_cholesky(L, (int)n, back);
            program.size[k] = says ? sqrt(along(&program, k, back)) : 0.0;
        }
    }
    while (!fails) {
        for (npy_intp j = 0; j < n; j++) {
            x[j] = free[j];
            for (npy_intp p = 0; p < count; p++)
                x[j] -= binding[p].force * binding[p].sign * program.back[n * binding[p].of + j];
        }
        const Binding next = most_broken(&program, x, binding, count);
        if (next.sign == 0.0)
            break;
        binding[count++] = next;
        iterations++;
        fails = iterations > most || settle(&program, free, binding, &count, Q) < 0;
    }
    for (npy_intp j = 0; !fails && j < n; j++)
        fails = !isfinite(x[j]);
    if (fails) { /* the plain version answers */
        PyErr_SetNone(joints_beyond);
        return NULL;
    }
    double *to;
    PyObject *found = new_vec(n, &to);
    for (npy_intp j = 0; found && j < n; j++)
        to[j] = x[j];
    return found ? Py_BuildValue("Nn", found, iterations) : NULL;
}
