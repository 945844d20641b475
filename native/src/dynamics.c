/* Torques and energies of a serial chain: machine/dynamics/chain_dynamics.py, where the formulas stand. */
#include "arrays.h"

#include <math.h>
#include <string.h>

/* One joint with its body in one moment: vectors of six are a point's velocity or a force, then a turning or a moment. */
typedef struct {
    double S[6], v[6], a[6], f[6], h[6]; /* h is I v */
    double mass, centre[3], about[6];    /* the body, with its inertia about the chain's origin: xx, xy, yy, xz, yz, zz */
} Body;

typedef struct {
    Mat q, v, a, factors, bodies;
    Vec slides, gravity;
} Chain;

static int as_chain(PyObject *const *args, npy_intp n, Chain *chain)
{
    return some_joints(n) < 0 || as_mat(args[0], "factors", 33, n, &chain->factors) < 0 ||
                   as_vec(args[1], "slides", n, &chain->slides) < 0 ||
                   as_mat(args[2], "bodies", n, 10, &chain->bodies) < 0 ||
                   as_vec(args[3], "gravity", 3, &chain->gravity) < 0
               ? -1
               : 0;
}

static int as_moments(PyObject *const *args, Py_ssize_t count, const char *name, Chain *chain)
{
    return count_is(count, 7, name) < 0 || as_mat(args[0], "q", -1, -1, &chain->q) < 0 ||
                   as_mat(args[1], "v", chain->q.rows, chain->q.columns, &chain->v) < 0 ||
                   as_mat(args[2], "a", chain->q.rows, chain->q.columns, &chain->a) < 0
               ? -1
               : as_chain(args + 3, chain->q.columns, chain);
}

static void cross(const double *x, const double *y, double *out)
{
    out[0] = x[1] * y[2] - x[2] * y[1], out[1] = x[2] * y[0] - x[0] * y[2], out[2] = x[0] * y[1] - x[1] * y[0];
}

static void add_cross(const double *x, const double *y, double *out)
{
    out[0] += x[1] * y[2] - x[2] * y[1], out[1] += x[2] * y[0] - x[0] * y[2], out[2] += x[0] * y[1] - x[1] * y[0];
}

static double dot6(const double *x, const double *y)
{
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2] + x[3] * y[3] + x[4] * y[4] + x[5] * y[5];
}

/* x x y of two motions */
static void motion_product(const double *x, const double *y, double *out)
{
    cross(x + 3, y, out), add_cross(x, y + 3, out), cross(x + 3, y + 3, out + 3);
}

/* out += x x* f of a motion and a force */
static void add_force_product(const double *x, const double *f, double *out)
{
    add_cross(x + 3, f, out), add_cross(x + 3, f + 3, out + 3), add_cross(x, f, out + 3);
}

/* I y of a body */
static void inertia_times(const Body *body, const double *y, double *out)
{
    const double *J = body->about, *w = y + 3;
    double turned[3], pulled[3];
    cross(w, body->centre, turned);
    for (int c = 0; c < 3; c++)
        out[c] = body->mass * (y[c] + turned[c]);
    cross(body->centre, y, pulled);
    out[3] = body->mass * pulled[0] + (J[0] * w[0] + J[1] * w[1] + J[3] * w[2]);
    out[4] = body->mass * pulled[1] + (J[1] * w[0] + J[2] * w[1] + J[4] * w[2]);
    out[5] = body->mass * pulled[2] + (J[3] * w[0] + J[4] * w[1] + J[5] * w[2]);
}

/* The joints and bodies where the chain stands in moment b. */
static void place(const Chain *chain, npy_intp b, Body *body)
{
    double R[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0}, p[3] = {0.0}; /* R row by row */
    for (npy_intp j = 0; j < chain->q.columns; j++, body++) {
        const double q = AT2(chain->q, b, j), sine = sin(q), versine = 1.0 - cos(q);
        const int slides = AT(chain->slides, j) != 0.0;
        double f[33], own[9], z[3], lever[3], M[6], half[9];
        for (int k = 0; k < 33; k++)
            f[k] = AT2(chain->factors, k, j);
        for (int c = 0; c < 9; c++)
            own[c] = slides ? f[c] : f[c] + sine * f[9 + c] + versine * f[18 + c]; /* column by column */
        for (int r = 0; r < 3; r++) {
            z[r] = R[3 * r] * f[27] + R[3 * r + 1] * f[28] + R[3 * r + 2] * f[29];
            p[r] += R[3 * r] * f[30] + R[3 * r + 1] * f[31] + R[3 * r + 2] * f[32] + (slides ? z[r] * q : 0.0);
        }
        for (int r = 0; r < 3; r++) {
            const double x = R[3 * r], y = R[3 * r + 1], w = R[3 * r + 2];
            for (int c = 0; c < 3; c++)
                R[3 * r + c] = x * own[3 * c] + y * own[3 * c + 1] + w * own[3 * c + 2];
        }
        for (int c = 0; c < 3; c++)
            body->S[c] = slides ? z[c] : 0.0, body->S[3 + c] = slides ? 0.0 : z[c];
        if (!slides)
            cross(p, z, body->S);
        body->mass = AT2(chain->bodies, j, 0);
        for (int c = 0; c < 3; c++)
            lever[c] = AT2(chain->bodies, j, 1 + c);
        for (int c = 0; c < 6; c++)
            M[c] = AT2(chain->bodies, j, 4 + c);
        for (int r = 0; r < 3; r++) {
            const double x = R[3 * r], y = R[3 * r + 1], w = R[3 * r + 2];
            body->centre[r] = p[r] + (x * lever[0] + y * lever[1] + w * lever[2]);
            half[3 * r] = x * M[0] + y * M[1] + w * M[3]; /* R I */
            half[3 * r + 1] = x * M[1] + y * M[2] + w * M[4];
            half[3 * r + 2] = x * M[3] + y * M[4] + w * M[5];
        }
        const double *c = body->centre, square = c[0] * c[0] + c[1] * c[1] + c[2] * c[2];
        for (int r = 0, k = 0; r < 3; r++)
            for (int s = 0; s <= r; s++, k++)
                body->about[k] = half[3 * r] * R[3 * s] + half[3 * r + 1] * R[3 * s + 1] + half[3 * r + 2] * R[3 * s + 2] +
                                 body->mass * ((r == s ? square : 0.0) - c[r] * c[s]);
    }
}

/* Velocities, accelerations and forces of the placed bodies in moment b. */
static void move(const Chain *chain, npy_intp b, Body *body)
{
    double v[6] = {0.0}, a[6] = {0.0};
    for (int c = 0; c < 3; c++)
        a[c] = -AT(chain->gravity, c);
    for (npy_intp j = 0; j < chain->q.columns; j++, body++) {
        double added[6], product[6];
        for (int c = 0; c < 6; c++)
            added[c] = body->S[c] * AT2(chain->v, b, j), v[c] += added[c];
        motion_product(v, added, product);
        for (int c = 0; c < 6; c++)
            a[c] += body->S[c] * AT2(chain->a, b, j) + product[c];
        memcpy(body->v, v, sizeof v), memcpy(body->a, a, sizeof a);
        inertia_times(body, v, body->h);
        inertia_times(body, a, body->f);
        add_force_product(v, body->h, body->f);
    }
}

PyObject *chain_torques(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Chain chain;
    Body body[MOST_JOINTS];
    double *torque;
    if (as_moments(args, count, "chain_torques", &chain) < 0)
        return NULL;
    const npy_intp n = chain.q.columns;
    PyObject *found = new_mat(chain.q.rows, n, &torque);
    for (npy_intp b = 0; found && b < chain.q.rows; b++) {
        double F[6] = {0.0};
        place(&chain, b, body), move(&chain, b, body);
        for (npy_intp j = n - 1; j >= 0; j--) {
            for (int c = 0; c < 6; c++)
                F[c] += body[j].f[c];
            torque[b * n + j] = dot6(body[j].S, F);
        }
    }
    return found;
}

/* To the sums over the bodies further out: I (6, 6), and B of the formulas. */
static void add_body(const Body *body, double M[6][6], double B[6][6])
{
    const double m = body->mass, *c = body->centre, *J = body->about, *v = body->v, *h = body->h;
    const double own[6][6] = {
        {m, 0.0, 0.0, 0.0, m * c[2], -m * c[1]},         {0.0, m, 0.0, -m * c[2], 0.0, m * c[0]},
        {0.0, 0.0, m, m * c[1], -m * c[0], 0.0},         {0.0, -m * c[2], m * c[1], J[0], J[1], J[3]},
        {m * c[2], 0.0, -m * c[0], J[1], J[2], J[4]},    {-m * c[1], m * c[0], 0.0, J[3], J[4], J[5]},
    };
    double across[6][6]; /* own times (v x): the columns of (v x) are v x e */
    for (int k = 0; k < 6; k++) {
        const double *x = own[k];
        cross(x, v + 3, across[k]);
        cross(x, v, across[k] + 3), add_cross(x + 3, v + 3, across[k] + 3);
    }
    for (int k = 0; k < 6; k++)
        for (int l = 0; l < 6; l++)
            M[k][l] += own[k][l], B[k][l] -= across[k][l] + across[l][k];
    for (int part = 0; part < 3; part++) { /* y x* h: turning times force, turning times moment, velocity times force */
        const int down = part ? 3 : 0, right = part == 2 ? 0 : 3;
        const double *x = h + (part == 1 ? 3 : 0);
        B[down][right + 1] += x[2], B[down][right + 2] -= x[1], B[down + 1][right] -= x[2];
        B[down + 1][right + 2] += x[0], B[down + 2][right] += x[1], B[down + 2][right + 1] -= x[0];
    }
}

static void times(const double M[6][6], const double *x, double *out)
{
    for (int k = 0; k < 6; k++)
        out[k] = dot6(M[k], x);
}

PyObject *chain_torque_slopes(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Chain chain;
    Body body[MOST_JOINTS];
    double *torque, *slope, u[MOST_JOINTS][6], x[MOST_JOINTS][6];
    if (as_moments(args, count, "chain_torque_slopes", &chain) < 0)
        return NULL;
    const npy_intp n = chain.q.columns;
    PyObject *found = new_mat(chain.q.rows, n, &torque);
    PyObject *slopes = PyArray_EMPTY(3, ((npy_intp[]){chain.q.rows, n, 3 * n}), NPY_DOUBLE, 0);
    if (!found || !slopes) {
        Py_XDECREF(found), Py_XDECREF(slopes);
        return NULL;
    }
    slope = PyArray_DATA((PyArrayObject *)slopes);
    for (npy_intp b = 0; b < chain.q.rows; b++, slope += 3 * n * n) {
        double F[6] = {0.0}, M[6][6] = {{0.0}}, B[6][6] = {{0.0}};
        double v[6] = {0.0}, a[6] = {-AT(chain.gravity, 0), -AT(chain.gravity, 1), -AT(chain.gravity, 2), 0.0, 0.0, 0.0};
        place(&chain, b, body), move(&chain, b, body);
        for (npy_intp j = 0; j < n; j++) {
            double more[6];
            motion_product(v, body[j].S, u[j]);
            motion_product(a, body[j].S, x[j]), motion_product(v, u[j], more);
            for (int c = 0; c < 6; c++)
                x[j][c] += more[c], v[c] = body[j].v[c], a[c] = body[j].a[c];
        }
        for (npy_intp k = n - 1; k >= 0; k--) { /* the outer one of two joints */
            double Mx[6], Mu[6], MS[6], Bu[6], BS[6], of_q[6] = {0.0};
            for (int c = 0; c < 6; c++)
                F[c] += body[k].f[c];
            add_body(&body[k], M, B);
            const double *S = body[k].S;
            torque[b * n + k] = dot6(S, F);
            times(M, x[k], Mx), times(M, u[k], Mu), times(M, S, MS), times(B, u[k], Bu), times(B, S, BS);
            add_force_product(S, F, of_q);
            for (int c = 0; c < 6; c++)
                of_q[c] += Mx[c] + Bu[c], BS[c] += 2.0 * Mu[c];
            for (npy_intp i = 0; i <= k; i++) { /* by joint k: of itself and of the joints further in */
                double *row = slope + 3 * n * i;
                row[k] = dot6(body[i].S, of_q), row[n + k] = dot6(body[i].S, BS);
                row[2 * n + k] = slope[3 * n * k + 2 * n + i] = dot6(body[i].S, MS);
            }
            double SM[6], SB[6] = {0.0}; /* S I and S B: B is not symmetric */
            memcpy(SM, MS, sizeof SM);
            for (int c = 0; c < 6; c++)
                for (int d = 0; d < 6; d++)
                    SB[d] += S[c] * B[c][d];
            for (npy_intp j = 0; j < k; j++) { /* of joint k, by those further in */
                slope[3 * n * k + j] = dot6(SM, x[j]) + dot6(SB, u[j]);
                slope[3 * n * k + n + j] = dot6(SB, body[j].S) + 2.0 * dot6(SM, u[j]);
            }
        }
    }
    return Py_BuildValue("NN", found, slopes);
}

PyObject *chain_energies(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Chain chain;
    Body body[MOST_JOINTS];
    double *kinetic, *potential;
    if (count_is(count, 6, "chain_energies") < 0 || as_mat(args[0], "q", -1, -1, &chain.q) < 0 ||
        as_mat(args[1], "v", chain.q.rows, chain.q.columns, &chain.v) < 0 ||
        as_chain(args + 2, chain.q.columns, &chain) < 0)
        return NULL;
    const npy_intp n = chain.q.columns;
    PyObject *moving = new_vec(chain.q.rows, &kinetic), *lifted = new_vec(chain.q.rows, &potential);
    if (!moving || !lifted) {
        Py_XDECREF(moving), Py_XDECREF(lifted);
        return NULL;
    }
    for (npy_intp b = 0; b < chain.q.rows; b++) {
        double v[6] = {0.0}, h[6];
        place(&chain, b, body);
        kinetic[b] = potential[b] = 0.0;
        for (npy_intp j = 0; j < n; j++) {
            for (int c = 0; c < 6; c++)
                v[c] += body[j].S[c] * AT2(chain.v, b, j);
            inertia_times(&body[j], v, h);
            kinetic[b] += 0.5 * dot6(v, h);
            for (int c = 0; c < 3; c++)
                potential[b] -= body[j].mass * body[j].centre[c] * AT(chain.gravity, c);
        }
    }
    return Py_BuildValue("NN", moving, lifted);
}
