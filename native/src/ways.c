/* How far pieces of links move on straight motions: site/pairs/ways.py. */
#include "screen.h"

#include <math.h>

static const double ROUNDING = 1e-12; /* m; as of the plain version */

static void cross(const double *x, const double *y, double *out)
{
    out[0] = x[1] * y[2] - x[2] * y[1], out[1] = x[2] * y[0] - x[0] * y[2], out[2] = x[0] * y[1] - x[1] * y[0];
}

static double length(const double *x)
{
    return sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
}

/* For each joint's body, its velocity at the world's origin and its angular velocity, on a motion by delta (n,). */
static void motions_of(const Screen *s, const Machine *m, const double *delta, double (*shift)[3], double (*turn)[3])
{
    for (int c = 0; c < 3; c++)
        shift[0][c] = turn[0][c] = 0.0;
    for (npy_intp j = 0; j < s->factors.columns; j++) {
        const double *R = m->pose[j].R, *g = m->factors[j] + 27;
        double axis[3], moment[3];
        for (int r = 0; r < 3; r++)
            axis[r] = R[3 * r] * g[0] + R[3 * r + 1] * g[1] + R[3 * r + 2] * g[2];
        cross(m->pose[j + 1].t, axis, moment);
        const int slides = m->slides[j] != 0.0;
        for (int c = 0; c < 3; c++) {
            shift[j + 1][c] = shift[j][c] + delta[j] * (slides ? axis[c] : moment[c]);
            turn[j + 1][c] = turn[j][c] + (slides ? 0.0 : delta[j] * axis[c]);
        }
    }
}

/* The greatest speed of any point of a piece, by its balls. */
static double speed_of(const Screen *s, const Machine *m, npy_intp piece, const double *shift, const double *turn)
{
    double most = 0.0;
    const double turning = length(turn);
    for (npy_intp i = INDEX(s->starts, piece); i < INDEX(s->starts, piece + 1); i++) {
        double passing[3];
        cross(turn, m->ball[i], passing);
        for (int c = 0; c < 3; c++)
            passing[c] += shift[c];
        const double speed = length(passing) + turning * s->fine[4 * i + 3];
        most = speed > most ? speed : most;
    }
    return most;
}

PyObject *ways_of_pairs(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Screen s = {0};
    Machine m;
    Mat q, travel;
    Flg around;
    Room room;
    npy_intp fine[2];
    double *found, middle[MOST_JOINTS], delta[MOST_JOINTS], bend[MOST_JOINTS];
    double shift[MOST_JOINTS + 1][3], turn[MOST_JOINTS + 1][3];
    if (count_is(count, 9, "ways_of_pairs") < 0 || as_mat(args[1], "factors", 33, -1, &s.factors) < 0 ||
        some_joints(s.factors.columns) < 0 || as_mat(args[0], "q", -1, s.factors.columns, &q) < 0 ||
        as_vec(args[2], "slides", s.factors.columns, &s.slides) < 0 ||
        as_ind(args[3], "joint", s.factors.columns + 1, &s.joint) < 0 || !(s.fine = block(args[5], "fine", 2, fine)) ||
        has_length(fine[1], 4, "fine") < 0 || as_ind(args[4], "starts", fine[0] + 1, &s.starts) < 0 ||
        has_length(s.starts.n, s.joint.n + 1, "starts") < 0 ||
        as_mat(args[6], "travel", -1, s.factors.columns, &travel) < 0 ||
        as_ind(args[7], "first", s.joint.n, &s.first) < 0 || has_length(s.first.n, travel.rows, "first") < 0 ||
        as_flags(args[8], "around", travel.rows, &around) < 0)
        return NULL;
    const npy_intp n = s.factors.columns, P = travel.rows, N = q.rows > 1 ? q.rows - 1 : 0;
    s.own = s.joint.n, s.balls = fine[0], s.q = (Mat){(char *)middle, 1, n, sizeof middle, sizeof *middle};
    PyObject *ways = new_mat(N, P, &found);
    double *speed = room_for(&room, (s.own + 1) * sizeof *speed);
    if (!ways || !speed || machine_of(&s, &m) < 0) {
        Py_XDECREF(ways);
        if (speed)
            release(&room);
        return NULL;
    }
    for (npy_intp row = 0; row < N; row++) {
        double angle = 0.0;
        for (npy_intp j = 0; j < n; j++) {
            delta[j] = AT2(q, row + 1, j) - AT2(q, row, j);
            middle[j] = AT2(q, row, j) + 0.5 * delta[j];
            const double own = m.slides[j] != 0.0 ? 0.0 : fabs(delta[j]);
            bend[j] = fabs(delta[j]) * (2.0 * angle + own);
            angle += own;
        }
        place_at(&s, &m, 0);
        motions_of(&s, &m, delta, shift, turn);
        for (npy_intp piece = 0; piece < s.own; piece++)
            speed[piece] = speed_of(&s, &m, piece, shift[INDEX(s.joint, piece)], turn[INDEX(s.joint, piece)]);
        for (npy_intp p = 0; p < P; p++) {
            double straight = 0.0, bent = 0.0;
            for (npy_intp j = 0; j < n; j++) {
                straight += fabs(delta[j]) * AT2(travel, p, j);
                bent += bend[j] * AT2(travel, p, j);
            }
            const double local = speed[INDEX(s.first, p)] + 0.5 * bent + ROUNDING;
            *found++ = FLAG(around, p) && local < straight ? local : straight;
        }
    }
    release(&m.room), release(&room);
    return ways;
}
