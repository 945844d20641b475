/* The servo: what one step can do to the joints, the pairs that are near or could come too close, the hand's force. */
#include "arrays.h"

#include <math.h>

/* --- joints ----------------------------------------------------------------------------- */

#define OF(j, column) joints[COLUMNS * (j) + (column)]
enum { LOWER, UPPER, FASTEST, CHANGE, ACCELERATION, PER, COLUMNS };
enum { PER_MISSING, SLOWEST, QUICKEST, TOLERANCE, BRAKING, RATES };

static double way_back(double missing, const double *set)
{
    const double back = set[PER_MISSING] * missing, least = back > set[SLOWEST] ? back : set[SLOWEST];
    return least < set[QUICKEST] ? least : set[QUICKEST];
}

static double clipped(double value, double low, double high)
{
    return value < low ? low : value > high ? high : value;
}

PyObject *reachable_velocities(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec q, v, wish;
    double dt, set[RATES], joints[COLUMNS * MOST_JOINTS], time = 0.0;
    if (count_is(count, 6, "reachable_velocities") < 0 || as_vec(args[0], "q", -1, &q) < 0 ||
        as_vec(args[1], "v", q.n, &v) < 0 || as_vec(args[2], "wish", q.n, &wish) < 0 ||
        as_double(args[3], "dt", &dt) < 0 || some_joints(q.n) < 0 ||
        as_table(args[4], "joints", q.n, COLUMNS, joints) < 0 || as_doubles(args[5], "rates", RATES, set) < 0)
        return NULL;
    double *low, *high, *least, *most;
    PyObject *lows = new_vec(q.n, &low), *highs = new_vec(q.n, &high), *leasts = new_vec(q.n, &least),
             *mosts = new_vec(q.n, &most);
    if (!lows || !highs || !leasts || !mosts) {
        Py_XDECREF(lows), Py_XDECREF(highs), Py_XDECREF(leasts), Py_XDECREF(mosts);
        return NULL;
    }
    for (npy_intp j = 0; j < q.n; j++) {
        const double stop = fabs(AT(v, j)) * OF(j, PER);
        if (stop > time)
            time = stop;
    }
    const double look = dt + 0.5 * (time + dt / set[BRAKING]);
    int tight = 0, cut = 0;
    for (npy_intp j = 0; j < q.n; j++) {
        const double fastest = OF(j, FASTEST), room = fastest * look, rate = AT(v, j), wished = AT(wish, j);
        const double above = OF(j, UPPER) - AT(q, j), below = AT(q, j) - OF(j, LOWER);
        const double down = rate - OF(j, CHANGE), up = rate + OF(j, CHANGE);
        double to = above > room ? fastest : above / look, from = below > room ? -fastest : -below / look;
        if (above < -set[TOLERANCE]) {
            to = -way_back(-above, set);
            from = from < to ? from : to;
        } else if (below < -set[TOLERANCE]) {
            from = way_back(-below, set);
            to = to > from ? to : from;
        } else if (to < down || from > up)
            tight = 1;
        if (wished > to + set[TOLERANCE] || wished < from - set[TOLERANCE])
            cut = 1;
        least[j] = from, most[j] = to;
        low[j] = clipped(from, down, up), high[j] = clipped(to, down, up);
    }
    for (npy_intp j = 0; tight && j < q.n; j++) {
        /* a joint needs all that is left of its range to brake: the others must not make that way longer */
        const double cap = OF(j, ACCELERATION) * (time > dt ? time - dt : 0.0), rate = AT(v, j);
        const double change = OF(j, CHANGE);
        if (most[j] > cap)
            most[j] = cap;
        if (least[j] < -cap)
            least[j] = -cap;
        low[j] = clipped(least[j], rate - change, rate + change);
        high[j] = clipped(most[j], rate - change, rate + change);
    }
    return Py_BuildValue("NNNNdN", lows, highs, leasts, mosts, look, PyBool_FromLong(cut));
}

PyObject *straight_towards(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec wish, v;
    double *next, change[MOST_JOINTS], part = 1.0;
    if (count_is(count, 3, "straight_towards") < 0 || as_vec(args[0], "wish", -1, &wish) < 0 ||
        as_vec(args[1], "v", wish.n, &v) < 0 || some_joints(wish.n) < 0 ||
        as_doubles(args[2], "change", wish.n, change) < 0)
        return NULL;
    PyObject *found = new_vec(wish.n, &next);
    if (!found)
        return NULL;
    for (npy_intp j = 0; j < wish.n; j++) {
        const double amount = fabs(AT(wish, j) - AT(v, j));
        if (amount * part > change[j])
            part = change[j] / amount;
    }
    for (npy_intp j = 0; j < wish.n; j++)
        next[j] = AT(v, j) + part * (AT(wish, j) - AT(v, j));
    return found;
}

/* Whether G x <= h + tolerance, where x is a part of v (n,). */
static int keeps(const Mat *G, const Vec *h, const double *v, double part, double tolerance)
{
    for (npy_intp i = 0; i < G->rows; i++) {
        double sum = 0.0;
        for (npy_intp j = 0; j < G->columns; j++)
            sum += AT2(*G, i, j) * (part * v[j]);
        if (sum > AT(*h, i) + tolerance)
            return 0;
    }
    return 1;
}

PyObject *keeps_rows(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat G;
    Vec h, x;
    double at[MOST_JOINTS], tolerance;
    if (count_is(count, 4, "keeps_rows") < 0 || as_mat(args[0], "G", -1, -1, &G) < 0 || some_joints(G.columns) < 0 ||
        as_vec(args[1], "h", G.rows, &h) < 0 || as_vec(args[2], "x", G.columns, &x) < 0 ||
        as_double(args[3], "tolerance", &tolerance) < 0)
        return NULL;
    for (npy_intp j = 0; j < x.n; j++)
        at[j] = AT(x, j);
    return PyBool_FromLong(keeps(&G, &h, at, 1.0, tolerance));
}

PyObject *next_within(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec wish, v, low, high, h;
    Mat G;
    double change[MOST_JOINTS], fastest[MOST_JOINTS], aim[MOST_JOINTS], over, tolerance, part = 1.0, off = 0.0;
    if (count_is(count, 10, "next_within") < 0 || as_vec(args[0], "wish", -1, &wish) < 0 || some_joints(wish.n) < 0 ||
        as_vec(args[1], "v", wish.n, &v) < 0 || as_vec(args[2], "low", wish.n, &low) < 0 ||
        as_vec(args[3], "high", wish.n, &high) < 0 || as_doubles(args[4], "changes", wish.n, change) < 0 ||
        as_doubles(args[5], "fastest", wish.n, fastest) < 0 || as_double(args[6], "load", &over) < 0 ||
        as_mat(args[7], "G", -1, wish.n, &G) < 0 || as_vec(args[8], "h", G.rows, &h) < 0 ||
        as_double(args[9], "tolerance", &tolerance) < 0)
        return NULL;
    over = over > 1.0 ? over : 1.0;
    for (npy_intp j = 0; j < wish.n; j++) {
        aim[j] = AT(wish, j);
        if (fabs(aim[j]) / fastest[j] > over)
            over = fabs(aim[j]) / fastest[j];
    }
    if (over > 1.0 && keeps(&G, &h, aim, 1.0 / over, tolerance))
        for (npy_intp j = 0; j < wish.n; j++)
            aim[j] /= over;
    double *target, *next;
    PyObject *targets = new_vec(wish.n, &target), *nexts = new_vec(wish.n, &next);
    if (!targets || !nexts) {
        Py_XDECREF(targets), Py_XDECREF(nexts);
        return NULL;
    }
    for (npy_intp j = 0; j < wish.n; j++) {
        const double amount = fabs(aim[j] - AT(v, j));
        if (amount * part > change[j])
            part = change[j] / amount;
    }
    for (npy_intp j = 0; j < wish.n; j++) {
        target[j] = AT(v, j) + part * (aim[j] - AT(v, j));
        const double up = target[j] < AT(low, j) ? AT(low, j) : target[j];
        next[j] = up > AT(high, j) ? AT(high, j) : up;
        const double cut = fabs(next[j] - target[j]);
        if (!(cut <= off)) /* what is no number is kept */
            off = cut;
    }
    return Py_BuildValue("NNN", targets, nexts, PyBool_FromLong(off <= tolerance && keeps(&G, &h, next, 1.0, tolerance)));
}

PyObject *changes_of_end(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec q, v, end;
    double look, later, change[MOST_JOINTS], *by;
    if (count_is(count, 6, "changes_of_end") < 0 || as_vec(args[0], "q", -1, &q) < 0 ||
        as_vec(args[1], "v", q.n, &v) < 0 || as_vec(args[2], "end", q.n, &end) < 0 ||
        some_joints(q.n) < 0 ||
        as_doubles(args[3], "change", q.n, change) < 0 || as_double(args[4], "look", &look) < 0 ||
        as_double(args[5], "later", &later) < 0)
        return NULL;
    PyObject *found = new_vec(q.n, &by);
    if (!found)
        return NULL;
    for (npy_intp j = 0; j < q.n; j++)
        by[j] = fabs(AT(q, j) + AT(v, j) * look - AT(end, j)) + look * change[j] + fabs(AT(v, j)) * later;
    return found;
}

/* --- pairs ------------------------------------------------------------------------------ */

PyObject *near_now(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec distance, within, odometer;
    Ind pairs, classes;
    if (count_is(count, 5, "near_now") < 0 || as_vec(args[0], "distance", -1, &distance) < 0 ||
        as_vec(args[1], "within", distance.n, &within) < 0 || as_ind(args[2], "pairs", distance.n, &pairs) < 0 ||
        as_vec(args[4], "odometer", -1, &odometer) < 0 || as_ind(args[3], "classes", odometer.n, &classes) < 0 ||
        has_length(classes.n, pairs.n, "classes") < 0)
        return NULL;
    npy_intp some = 0, *near;
    double *lower, *moved;
#define LEFT(k) (AT(distance, INDEX(pairs, k)) - AT(odometer, INDEX(classes, k)))
    for (npy_intp k = 0; k < pairs.n; k++)
        some += LEFT(k) < AT(within, INDEX(pairs, k));
    PyObject *nears = new_ind(some, &near), *lowers = new_vec(some, &lower), *moves = new_vec(some, &moved);
    if (!nears || !lowers || !moves) {
        Py_XDECREF(nears), Py_XDECREF(lowers), Py_XDECREF(moves);
        return NULL;
    }
    for (npy_intp k = 0; k < pairs.n; k++)
        if (LEFT(k) < AT(within, INDEX(pairs, k)))
            *near++ = INDEX(pairs, k), *lower++ = LEFT(k), *moved++ = AT(odometer, INDEX(classes, k));
#undef LEFT
    return Py_BuildValue("NNN", nears, lowers, moves);
}

PyObject *not_proven(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec proven, required, odometer, budget;
    Ind pairs, classes;
    double buffer;
    if (count_is(count, 7, "not_proven") < 0 || as_vec(args[0], "proven", -1, &proven) < 0 ||
        as_vec(args[1], "required", proven.n, &required) < 0 || as_ind(args[2], "pairs", proven.n, &pairs) < 0 ||
        as_vec(args[4], "odometer", -1, &odometer) < 0 || as_vec(args[5], "budget", odometer.n, &budget) < 0 ||
        as_ind(args[3], "classes", odometer.n, &classes) < 0 || has_length(classes.n, pairs.n, "classes") < 0 ||
        as_double(args[6], "buffer", &buffer) < 0)
        return NULL;
    Room room;
    npy_intp *chosen = room_for(&room, pairs.n * sizeof(npy_intp)), some = 0;
    if (!chosen)
        return NULL;
    for (npy_intp k = 0; k < pairs.n; k++) {
        const npy_intp pair = INDEX(pairs, k), row = INDEX(classes, k);
        if (AT(proven, pair) - AT(required, pair) < AT(odometer, row) + AT(budget, row) + buffer)
            chosen[some++] = pair;
    }
    PyObject *found = ind_of(chosen, some);
    release(&room);
    return found;
}

PyObject *margins_now(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec distance, clearance, odometer;
    Ind pairs, classes;
    double *margin;
    if (count_is(count, 5, "margins_now") < 0 || as_vec(args[1], "distance", -1, &distance) < 0 ||
        as_ind(args[0], "pairs", distance.n, &pairs) < 0 || as_vec(args[2], "clearance", distance.n, &clearance) < 0 ||
        as_vec(args[4], "odometer", -1, &odometer) < 0 || as_rows(args[3], "classes", odometer.n, distance.n, &pairs, &classes) < 0)
        return NULL;
    PyObject *found = new_vec(pairs.n, &margin);
    for (npy_intp k = 0; found && k < pairs.n; k++) {
        const npy_intp pair = INDEX(pairs, k);
        margin[k] = AT(distance, pair) - AT(odometer, INDEX(classes, pair)) - AT(clearance, pair);
    }
    return found;
}

PyObject *stalest_pair(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec distance, clearance, renewed, odometer;
    Ind pairs, classes;
    double rules[3];
    if (count_is(count, 9, "stalest_pair") < 0 || as_vec(args[1], "distance", -1, &distance) < 0 ||
        as_ind(args[0], "pairs", distance.n, &pairs) < 0 || as_vec(args[2], "clearance", distance.n, &clearance) < 0 ||
        as_vec(args[3], "renewed", distance.n, &renewed) < 0 || as_vec(args[5], "odometer", -1, &odometer) < 0 ||
        as_rows(args[4], "classes", odometer.n, distance.n, &pairs, &classes) < 0 ||
        as_doubles(args[8], "rules", 3, rules) < 0)
        return NULL;
    const int nearest_first = PyObject_IsTrue(args[6]), far = PyObject_IsTrue(args[7]);
    if (nearest_first < 0 || far < 0)
        return NULL;
    double least = INFINITY, most = -INFINITY, of_nearest = 0.0;
    npy_intp nearest = -1, stalest = -1;
    for (npy_intp k = 0; k < pairs.n; k++) {
        const npy_intp pair = INDEX(pairs, k);
        const double counted = AT(odometer, INDEX(classes, pair));
        const double margin = AT(distance, pair) - counted - AT(clearance, pair);
        const double moved = (counted - AT(renewed, pair)) / (rules[1] + (margin > 0.0 ? margin : 0.0));
        if (margin < least)
            least = margin, nearest = pair, of_nearest = moved;
        if (moved > most)
            most = moved, stalest = pair;
    }
    const int is_close = least <= rules[0];
    if (!(is_close || far))
        return PyLong_FromLong(-1);
    if (is_close && nearest_first && of_nearest > rules[2])
        return PyLong_FromSsize_t(nearest);
    return PyLong_FromSsize_t(most > rules[2] ? stalest : -1);
}

PyObject *tightest_pair(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Ind pairs;
    Vec margin, distance;
    npy_intp tightest = 0;
    if (count_is(count, 5, "tightest_pair") < 0)
        return NULL;
    PyObject *margins = margins_now(self, args, count);
    if (!margins)
        return NULL;
    if (as_vec(margins, "margins", -1, &margin) < 0 || as_vec(args[1], "distance", -1, &distance) < 0 ||
        as_ind(args[0], "pairs", distance.n, &pairs) < 0) {
        Py_DECREF(margins);
        return NULL;
    }
    if (margin.n < 1) {
        Py_DECREF(margins);
        PyErr_SetString(PyExc_ValueError, "pairs: there are none");
        return NULL;
    }
    for (npy_intp k = 1; k < margin.n; k++)
        if (AT(margin, k) < AT(margin, tightest))
            tightest = k;
    const double least = AT(margin, tightest);
    Py_DECREF(margins);
    return Py_BuildValue("nd", (Py_ssize_t)INDEX(pairs, tightest), least);
}

PyObject *known_apart(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat velocity, points, faces;
    Ind joint, other;
    Vec shift;
    npy_intp t[3], at;
    if (count_is(count, 8, "known_apart") < 0 || as_mat(args[3], "velocity", -1, 3, &velocity) < 0 ||
        as_mat(args[4], "points", velocity.rows, 6, &points) < 0 || as_mat(args[5], "faces", velocity.rows, 15, &faces) < 0 ||
        as_vec(args[6], "shift", 3, &shift) < 0)
        return NULL;
    const double *T = block(args[7], "T", 3, t);
    const npy_intp pair = PyNumber_AsSsize_t(args[0], PyExc_IndexError);
    if (!T || (pair == -1 && PyErr_Occurred()))
        return NULL;
    at = pair;
    const Ind one = {(char *)&at, 1, sizeof(at)};
    if (pair < 0 || pair >= velocity.rows || t[1] != 4 || t[2] != 4) {
        PyErr_SetString(PyExc_IndexError, "pair and T: one of all pairs, and poses (4, 4), are wanted");
        return NULL;
    }
    if (as_rows(args[1], "joint", t[0], velocity.rows, &one, &joint) < 0 ||
        as_rows(args[2], "other", t[0], velocity.rows, &one, &other) < 0)
        return NULL;
    double point[3], sum = 0.0, off = 0.0;
    for (int r = 0; r < 3; r++) {
        if (AT2(velocity, pair, r) != 0.0)
            return PyFloat_FromDouble(INFINITY);
        const double *own = T + 16 * INDEX(joint, pair) + 4 * r, *there = T + 16 * INDEX(other, pair) + 4 * r;
        double beyond = there[3];
        point[r] = own[3];
        for (int c = 0; c < 3; c++)
            point[r] += own[c] * AT2(points, pair, c), beyond += there[c] * AT2(points, pair, 3 + c);
        sum += (point[r] - beyond) * (point[r] - beyond);
    }
    for (int k = 0; k < 3; k++) {
        double along = 0.0;
        for (int c = 0; c < 3; c++)
            along += (point[c] - AT(shift, c) - AT2(faces, pair, 9 + c)) * AT2(faces, pair, 3 * c + k);
        const double more = fabs(along) - AT2(faces, pair, 12 + k);
        off += more > 0.0 || more != more ? more * more : 0.0; /* what is no number is kept */
    }
    const double least = off < sum ? off : sum;
    return PyFloat_FromDouble(least == least ? sqrt(least) : off == off ? sqrt(off) : INFINITY);
}

/* --- planes ----------------------------------------------------------------------------- */

/* The normal of a plane (4,), as it stands in a body placed at T (4, 4), in the world. */
static void turned(const double *T, const double *n, double *out)
{
    for (int c = 0; c < 3; c++)
        out[c] = T[4 * c] * n[0] + T[4 * c + 1] * n[1] + T[4 * c + 2] * n[2];
}

PyObject *corner_gaps(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Ind pairs, joint, other = {0}, piece;
    Mat planes;
    Vec drift = {0};
    npy_intp t[4], c[3], g[3];
    double step;
    if (count_is(count, 10, "corner_gaps") < 0 || as_mat(args[1], "planes", -1, 4, &planes) < 0 ||
        as_ind(args[0], "pairs", planes.rows, &pairs) < 0 || as_double(args[8], "step", &step) < 0)
        return NULL;
    const double *T = block(args[6], "T", 4, t), *corners = T ? block(args[5], "corners", 3, c) : NULL;
    double *gaps = corners ? (double *)block(args[9], "gaps", 3, g) : NULL;
    if (!gaps || is_writeable(args[9], "gaps") < 0 || as_rows(args[4], "piece", c[0], planes.rows, &pairs, &piece) < 0 ||
        as_rows(args[2], "joint", t[1], planes.rows, &pairs, &joint) < 0 ||
        (args[3] != Py_None &&
         (as_rows(args[3], "other", t[1], planes.rows, &pairs, &other) < 0)) ||
        (args[7] != Py_None && as_vec(args[7], "drift", planes.rows, &drift) < 0))
        return NULL;
    const npy_intp K = pairs.n, S = t[0], V = c[2];
    if (t[2] != 4 || t[3] != 4 || c[1] != 4 || g[0] != K || g[1] != S || g[2] != V || V < 1) {
        PyErr_SetString(PyExc_ValueError, "T, corners and gaps do not fit together");
        return NULL;
    }
    npy_intp shape[2] = {K, S}, *nearest;
    double *least;
    PyObject *columns = PyArray_EMPTY(2, shape, NPY_INTP, 0), *leasts = new_mat(K, S, &least);
    if (!columns || !leasts) {
        Py_XDECREF(columns), Py_XDECREF(leasts);
        return NULL;
    }
    nearest = (npy_intp *)PyArray_DATA((PyArrayObject *)columns);
    for (npy_intp k = 0; k < K; k++) {
        const npy_intp pair = INDEX(pairs, k), on = INDEX(joint, pair), body = other.data ? INDEX(other, pair) : 0;
        const double n[3] = {AT2(planes, pair, 0), AT2(planes, pair, 1), AT2(planes, pair, 2)};
        const double away = AT2(planes, pair, 3), *corner = corners + 4 * V * INDEX(piece, pair);
        const double comes = drift.data && AT(drift, pair) < 0.0 ? step * AT(drift, pair) : 0.0;
        for (npy_intp s = 0; s < S; s++, gaps += V) {
            double world[4] = {n[0], n[1], n[2], away}, local[4];
            if (body) {
                const double *placed = T + 16 * (t[1] * s + body);
                turned(placed, n, world);
                world[3] = away - (world[0] * placed[3] + world[1] * placed[7] + world[2] * placed[11]);
            }
            world[3] += s * comes;
            const double *link = T + 16 * (t[1] * s + on); /* its last row is 0, 0, 0, 1 */
            for (int d = 0; d < 4; d++)
                local[d] = world[0] * link[d] + world[1] * link[4 + d] + world[2] * link[8 + d];
            local[3] += world[3];
            npy_intp at = 0;
            for (npy_intp v = 0; v < V; v++) {
                gaps[v] = local[0] * corner[v] + local[1] * corner[V + v] + local[2] * corner[2 * V + v] +
                          local[3] * corner[3 * V + v];
                if (gaps[v] < gaps[at])
                    at = v;
            }
            nearest[S * k + s] = at;
            least[S * k + s] = gaps[at];
        }
    }
    return Py_BuildValue("NN", columns, leasts);
}

PyObject *blended_points(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    npy_intp g[3], c[3];
    Mat least;
    Ind pieces;
    double width, *point;
    if (count_is(count, 5, "blended_points") < 0)
        return NULL;
    const double *gaps = block(args[0], "gaps", 3, g), *corners = gaps ? block(args[3], "corners", 3, c) : NULL;
    if (!corners || as_mat(args[1], "least", g[0], g[1], &least) < 0 || as_ind(args[2], "pieces", c[0], &pieces) < 0 ||
        has_length(pieces.n, g[0], "pieces") < 0 || as_double(args[4], "width", &width) < 0)
        return NULL;
    const npy_intp K = g[0], V = g[2];
    if (g[1] < 1 || c[1] != 4 || c[2] != V) {
        PyErr_SetString(PyExc_ValueError, "gaps and corners do not fit together");
        return NULL;
    }
    PyObject *found = new_mat(K, 4, &point);
    if (!found)
        return NULL;
    for (npy_intp k = 0; k < K; k++, point += 4) {
        const double within = AT2(least, k, 0) + width, *gap = gaps + g[1] * V * k, *corner = corners + 4 * V * INDEX(pieces, k);
        double sum[4] = {0.0};
        for (npy_intp v = 0; v < V; v++) {
            double part = within - gap[v];
            if (!(part > 0.0))
                continue;
            part *= part;
            for (int d = 0; d < 4; d++)
                sum[d] += part * corner[V * d + v];
        }
        for (int d = 0; d < 4; d++)
            point[d] = sum[d] / sum[3];
    }
    return found;
}

PyObject *plane_rows(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Ind pairs, joint, other = {0}, samples = {0};
    Mat planes, points, mask;
    npy_intp t[4], j[3], same = 0;
    double *row;
    if (count_is(count, 9, "plane_rows") < 0 || as_mat(args[3], "planes", -1, 4, &planes) < 0 ||
        as_ind(args[0], "pairs", planes.rows, &pairs) < 0 || as_mat(args[2], "points", pairs.n, 4, &points) < 0)
        return NULL;
    const double *T = block(args[7], "T", 4, t), *J = T ? block(args[8], "J", 3, j) : NULL;
    if (!J || as_rows(args[4], "joint", t[1], planes.rows, &pairs, &joint) < 0 ||
        (args[5] != Py_None &&
         (as_rows(args[5], "other", t[1], planes.rows, &pairs, &other) < 0)) ||
        as_mat(args[6], "mask", planes.rows, j[2], &mask) < 0)
        return NULL;
    if (PyLong_Check(args[1])) {
        same = PyLong_AsSsize_t(args[1]);
        if (same < 0 || same >= t[0]) {
            PyErr_SetString(PyExc_IndexError, "samples: is not one of those of T");
            return NULL;
        }
    } else if (as_ind(args[1], "samples", t[0], &samples) < 0 || has_length(samples.n, pairs.n, "samples") < 0)
        return NULL;
    if (t[2] != 4 || t[3] != 4 || j[0] != t[0] || j[1] != 6) {
        PyErr_SetString(PyExc_ValueError, "T and J do not fit together");
        return NULL;
    }
    const npy_intp n = j[2];
    PyObject *found = new_mat(pairs.n, n, &row);
    if (!found)
        return NULL;
    for (npy_intp k = 0; k < pairs.n; k++, row += n) {
        const npy_intp pair = INDEX(pairs, k), s = samples.data ? INDEX(samples, k) : same;
        const npy_intp body = other.data ? INDEX(other, pair) : 0;
        double normal[3] = {AT2(planes, pair, 0), AT2(planes, pair, 1), AT2(planes, pair, 2)}, x[3];
        if (body) {
            double world[3];
            turned(T + 16 * (t[1] * s + body), normal, world);
            memcpy(normal, world, sizeof(normal));
        }
        const double *link = T + 16 * (t[1] * s + INDEX(joint, pair));
        for (int c = 0; c < 3; c++)
            x[c] = link[4 * c] * AT2(points, k, 0) + link[4 * c + 1] * AT2(points, k, 1) +
                   link[4 * c + 2] * AT2(points, k, 2) + link[4 * c + 3] * AT2(points, k, 3);
        const double m[6] = {-normal[0],
                             -normal[1],
                             -normal[2],
                             x[2] * normal[1] - x[1] * normal[2],
                             x[0] * normal[2] - x[2] * normal[0],
                             x[1] * normal[0] - x[0] * normal[1]};
        const double *columns = J + 6 * n * s;
        for (npy_intp i = 0; i < n; i++) {
            double sum = 0.0;
            for (int c = 0; c < 6; c++)
                sum += m[c] * columns[n * c + i];
            row[i] = sum * AT2(mask, pair, i);
        }
    }
    return found;
}

/* --- the hand --------------------------------------------------------------------------- */

enum { DT, DAMPING, LARGEST, SHARPEST, PART, MOST_STORED, SLOW_HAND, SEED, LEAK, SETTINGS };
enum { FORCE, SMOOTH = 3, STORED = 6, SCALE, STATE };

PyObject *force_on_hand(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec hand, refused, normal;
    double nearness, state[STATE], set[SETTINGS], *out;
    if (count_is(count, 6, "force_on_hand") < 0 || as_vec(args[0], "hand", 3, &hand) < 0 ||
        as_vec(args[1], "refused", 3, &refused) < 0 || as_vec(args[2], "normal", 3, &normal) < 0 ||
        as_double(args[3], "nearness", &nearness) < 0 || as_doubles(args[4], "state", STATE, state) < 0 ||
        as_doubles(args[5], "settings", SETTINGS, set) < 0)
        return NULL;
    double *force = state + FORCE, *smooth = state + SMOOTH, into = 0.0, given = 0.0, t[3], along = 0.0, size = 0.0;
    double inward = 0.0;
    for (int c = 0; c < 3; c++) {
        given += force[c] * AT(hand, c);
        into += AT(hand, c) * AT(normal, c);
        inward += AT(refused, c) * AT(normal, c);
    }
    const double stored = state[STORED] - set[DT] * given;
    state[STORED] = stored < set[MOST_STORED] ? stored : set[MOST_STORED];
    for (int c = 0; c < 3; c++) {
        t[c] = AT(hand, c) - nearness * into * AT(normal, c);
        along += AT(refused, c) * t[c];
        size += t[c] * t[c];
    }
    size = sqrt(size) + set[SLOW_HAND];
    along = (along > 0.0 ? along : 0.0) / (size * size);
    inward = nearness * ((inward > 0.0 ? inward : 0.0) + (into > 0.0 ? into : 0.0));
    size = given = 0.0;
    for (int c = 0; c < 3; c++) {
        smooth[c] -= set[PART] * (set[DAMPING] * (inward * AT(normal, c) + along * t[c]) + smooth[c]);
        size += smooth[c] * smooth[c];
        given += smooth[c] * AT(hand, c);
    }
    size = sqrt(size);
    double by = 1.0;
    if (size > 0.0) {
        const double bounded = set[LARGEST] * tanh(size / set[LARGEST]);
        along = given * bounded / size;
        const double most = set[DT] * (along + bounded * set[SHARPEST] * set[DT]);
        double held = state[STORED] + (along <= 0.0 ? set[SEED] : 0.0), scale = state[SCALE] + set[PART];
        if (held < set[LEAK])
            held = set[LEAK];
        if (scale > 1.0)
            scale = 1.0;
        if (most > 0.0) {
            const double may = (set[PART] * held > set[LEAK] ? set[PART] * held : set[LEAK]) / most;
            if (may < scale)
                scale = may;
        }
        state[SCALE] = scale;
        by = bounded / size * scale;
    }
    PyObject *found = new_vec(3, &out);
    if (!found)
        return NULL;
    for (int c = 0; c < 3; c++)
        out[c] = force[c] = smooth[c] * by;
    return Py_BuildValue("N(dddddddd)", found, state[0], state[1], state[2], state[3], state[4], state[5], state[6],
                         state[7]);
}
