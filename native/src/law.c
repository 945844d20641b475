/* The completed law's terms. */
#include "arrays.h"

#include <math.h>

enum { S_E, S_O, INFLUENCE, UNITY, NOMINAL, HOLDS, EPSILON, NEAREST_PUSH, STANDING, UNDAMPED, LARGEST_DAMPING, RANK_TOLERANCE,
       SETTINGS };

/* S = J J^T of a task J (m, n) */
static void square(const double *J, int m, int n, double *S)
{
    for (int a = 0; a < m; a++)
        for (int b = 0; b <= a; b++) {
            double sum = 0.0;
            for (int j = 0; j < n; j++)
                sum += J[n * a + j] * J[n * b + j];
            S[m * a + b] = S[m * b + a] = sum;
        }
}

/* plus = J^T A (n, m), for A (m, m) symmetric */
static void from_left(const double *J, int m, int n, const double *A, double *plus)
{
    for (int j = 0; j < n; j++)
        for (int a = 0; a < m; a++) {
            double sum = 0.0;
            for (int b = 0; b < m; b++)
                sum += J[n * b + j] * A[m * b + a];
            plus[m * j + a] = sum;
        }
}

/* N = I - X Y (n, n), for X (n, m) and Y (m, n) */
static void projector(const double *X, const double *Y, int m, int n, double *N)
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            double sum = i == j ? 1.0 : 0.0;
            for (int a = 0; a < m; a++)
                sum -= X[m * i + a] * Y[n * a + j];
            N[n * i + j] = sum;
        }
}

/* J^+ (n, m) and N (n, n), where J (m, n) is known not to be damped; 0 elsewhere. */
static int inverse_if_undamped(const double *J, int m, int n, const double *set, double *plus, double *N)
{
    double S[MOST_TASKS * MOST_TASKS], inverse[MOST_TASKS * MOST_TASKS], trace = 0.0;
    square(J, m, n, S);
    if (cholesky(S, m) < 0)
        return 0;
    for (int a = 0; a < m; a++) {
        double column[MOST_TASKS] = {0.0};
        column[a] = 1.0;
        solve_cholesky(S, m, column);
        for (int b = 0; b < m; b++)
            inverse[m * b + a] = column[b];
        trace += column[a];
    }
    /* the smallest eigenvalue of J J^T is at least 1 / trace of its inverse */
    if (!(trace * set[UNDAMPED] * set[UNDAMPED] < 1.0))
        return 0;
    from_left(J, m, n, inverse, plus);
    projector(plus, J, m, n, N);
    return 1;
}

/* The same for any J, damped near a singularity: the damping, or -1 where no singular values are found. */
static double inverse_by_singular_values(const double *J, int m, int n, const double *set, double *plus, double *N)
{
    double S[MOST_TASKS * MOST_TASKS], U[MOST_TASKS * MOST_TASKS], A[MOST_TASKS * MOST_TASKS];
    double s[MOST_TASKS], V[MOST_JOINTS * MOST_TASKS], V_T[MOST_TASKS * MOST_JOINTS];
    double smallest = INFINITY, largest = 0.0, damping = 0.0;
    square(J, m, n, S);
    if (eigenvectors(S, m, U) < 0)
        return -1.0;
    for (int k = 0; k < m; k++) {
        s[k] = sqrt(S[m * k + k] > 0.0 ? S[m * k + k] : 0.0);
        smallest = s[k] < smallest ? s[k] : smallest;
        largest = s[k] > largest ? s[k] : largest;
    }
    for (int j = 0; j < n; j++)
        for (int k = 0; k < m; k++) {
            double sum = 0.0;
            for (int b = 0; b < m; b++)
                sum += J[n * b + j] * U[m * b + k];
            V[m * j + k] = V_T[n * k + j] = s[k] > set[RANK_TOLERANCE] * largest ? sum / s[k] : 0.0;
        }
    projector(V, V_T, m, n, N);
    if (smallest < set[UNDAMPED]) {
        const double part = smallest / set[UNDAMPED];
        damping = set[LARGEST_DAMPING] * sqrt(1.0 - part * part);
    }
    for (int a = 0; a < m; a++)
        for (int b = 0; b < m; b++) {
            double sum = 0.0;
            for (int k = 0; k < m; k++)
                if (damping > 0.0 || s[k] > set[RANK_TOLERANCE] * largest)
                    sum += U[m * a + k] * U[m * b + k] / (s[k] * s[k] + damping * damping);
            A[m * a + b] = sum;
        }
    from_left(J, m, n, A, plus);
    return damping;
}

PyObject *quick_terms(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat J, gradient;
    Vec xdot, q, margin, drift;
    double set[SETTINGS], ranges[3 * MOST_JOINTS];
    if (count_is(count, 8, "quick_terms") < 0 || as_vec(args[0], "q", -1, &q) < 0 ||
        as_mat(args[1], "J", -1, q.n, &J) < 0 || as_vec(args[2], "xdot", J.rows, &xdot) < 0 ||
        as_vec(args[3], "margin", -1, &margin) < 0 || as_mat(args[4], "gradient", margin.n, q.n, &gradient) < 0 ||
        as_vec(args[5], "drift", margin.n, &drift) < 0 || some_joints(q.n) < 0 ||
        as_table(args[6], "ranges", q.n, 3, ranges) < 0 ||
        as_doubles(args[7], "settings", SETTINGS, set) < 0)
        return NULL;
    const int m = (int)J.rows, n = (int)q.n;
    if (m < 1 || m > MOST_TASKS || m > n)
        Py_RETURN_NONE;
    double Jd[MOST_TASKS * MOST_JOINTS], plus[MOST_JOINTS * MOST_TASKS], N[MOST_JOINTS * MOST_JOINTS], damping;
    for (int a = 0; a < m; a++)
        for (int j = 0; j < n; j++)
            Jd[n * a + j] = AT2(J, a, j);
    damping = inverse_if_undamped(Jd, m, n, set, plus, N) ? 0.0 : inverse_by_singular_values(Jd, m, n, set, plus, N);
    if (damping < 0.0)
        Py_RETURN_NONE;
    double *primary, *null;
    PyObject *first = new_vec(n, &primary), *second = new_vec(n, &null);
    if (!first || !second)
        goto failed;
    for (int i = 0; i < n; i++) {
        double rate = 0.0;
        for (int a = 0; a < m; a++)
            rate += plus[m * i + a] * AT(xdot, a);
        primary[i] = set[S_E] * rate;
        null[i] = 0.0;
    }
    double A[MOST_JOINTS * MOST_JOINTS] = {0.0}, b[MOST_JOINTS] = {0.0};
    int acts = 0;
    for (int i = 0; i < n; i++)
        A[n * i + i] = set[EPSILON];
    const double influence = set[INFLUENCE], unity = set[UNITY], nearest = unity / set[NEAREST_PUSH];
    for (npy_intp k = 0; set[S_O] > 0.0 && k < margin.n; k++) {
        const double left = AT(margin, k);
        if (left >= influence)
            continue;
        acts = 1;
        double weight = set[S_O], missing = -AT(drift, k), g[MOST_JOINTS];
        for (int j = 0; j < n; j++)
            missing -= AT2(gradient, k, j) * primary[j];
        if (left > unity)
            weight *= 0.5 + 0.5 * cos(M_PI / (influence - unity) * (left - unity));
        else if (left < unity) {
            const double push = unity / (left > nearest ? left : nearest);
            missing += set[NOMINAL] * (push * push - 1.0);
        }
        for (int j = 0; j < n; j++) {
            double sum = 0.0;
            for (int i = 0; i < n; i++)
                sum += AT2(gradient, k, i) * N[n * i + j];
            g[j] = sum;
        }
        for (int i = 0; i < n; i++) {
            const double weighted = weight * g[i];
            if (missing > 0.0)
                b[i] += weighted * missing;
            for (int j = 0; j <= i; j++)
                A[n * i + j] += weighted * g[j];
        }
    }
    for (int j = 0; set[HOLDS] != 0.0 && n > m && j < n; j++) {
        const double rate = primary[j], low = ranges[3 * j], high = ranges[3 * j + 1];
        if (fabs(rate) < set[STANDING])
            continue;
        double hold = 1.0 - (rate > 0.0 ? high - AT(q, j) : AT(q, j) - low) / ranges[3 * j + 2];
        if (!(hold > 0.0))
            continue;
        acts = 1;
        if (hold > 1.0)
            hold = 1.0;
        hold *= hold;
        for (int i = 0; i < n; i++) {
            const double weighted = hold * N[n * i + j];
            b[i] -= weighted * rate;
            for (int c = 0; c <= i; c++)
                A[n * i + c] += weighted * N[n * j + c];
        }
    }
    if (acts) {
        if (cholesky(A, n) < 0) {
            Py_DECREF(first), Py_DECREF(second);
            Py_RETURN_NONE;
        }
        solve_cholesky(A, n, b);
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++)
                null[i] += N[n * i + j] * b[j];
    }
    return Py_BuildValue("NNd", first, second, damping);
failed:
    Py_XDECREF(first);
    Py_XDECREF(second);
    return NULL;
}
