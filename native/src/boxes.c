/* The boxes that stand for clusters around links: how far these may come from where the boxes were found. */
#include "arrays.h"

#include <math.h>

PyObject *line_ahead(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec q, v, end, gained, acceleration, furthest, turning;
    Mat travel;
    double rules[3], braking = 0.0, now = 0.0, bent = 0.0, angles = 0.0;
    double delta[MOST_JOINTS], spread[MOST_JOINTS], bend[MOST_JOINTS];
    if (count_is(count, 9, "line_ahead") < 0 || as_vec(args[0], "q", -1, &q) < 0 || some_joints(q.n) < 0 ||
        as_vec(args[1], "v", q.n, &v) < 0 || as_vec(args[2], "end", q.n, &end) < 0 ||
        as_vec(args[3], "gained", q.n, &gained) < 0 || as_vec(args[4], "acceleration", q.n, &acceleration) < 0 ||
        as_mat(args[5], "travel", -1, q.n, &travel) < 0 || as_vec(args[6], "furthest", q.n, &furthest) < 0 ||
        as_vec(args[7], "turning", q.n, &turning) < 0 || as_doubles(args[8], "rules", 3, rules) < 0)
        return NULL;
    const npy_intp n = q.n;
    for (npy_intp j = 0; j < n; j++) {
        const double speed = fabs(AT(v, j)), a = AT(acceleration, j), time = (speed + AT(gained, j)) / a;
        if (time > braking)
            braking = time;
        if (speed / a > now)
            now = speed / a;
    }
    const double begins = rules[0], look = begins + 0.5 * braking;
    for (npy_intp j = 0; j < n; j++) {
        const double off = fabs(AT(end, j) - AT(q, j) - 0.5 * now * AT(v, j)), gain = look * AT(gained, j);
        delta[j] = look * AT(v, j);
        spread[j] = off > gain ? off : gain;
        const double size = fabs(delta[j]), angle = size * AT(turning, j);
        angles += angle;
        bend[j] = size * (2.0 * angles - angle);
        bent += bend[j] * AT(furthest, j);
    }
    const double wanted = ceil(sqrt(bent / (8.0 * rules[1])));
    const npy_intp parts = wanted < 1.0 ? 1 : (npy_intp)(wanted > rules[2] ? rules[2] : wanted);
    double *at, *beside, *way, *change;
    PyObject *ends = new_mat(parts + 1, n, &at), *besides = new_vec(travel.rows, &beside),
             *ways = new_vec(travel.rows, &way), *changes = new_vec(travel.rows, &change);
    if (!ends || !besides || !ways || !changes) {
        Py_XDECREF(ends), Py_XDECREF(besides), Py_XDECREF(ways), Py_XDECREF(changes);
        return NULL;
    }
    for (npy_intp s = 0; s <= parts; s++)
        for (npy_intp j = 0; j < n; j++)
            at[n * s + j] = AT(q, j) + (double)s / parts * delta[j];
    for (npy_intp c = 0; c < travel.rows; c++) {
        beside[c] = way[c] = change[c] = 0.0;
        for (npy_intp j = 0; j < n; j++) {
            const double r = AT2(travel, c, j);
            beside[c] += r * (bend[j] / (8.0 * parts * parts) + spread[j]);
            way[c] += r * (fabs(delta[j]) + spread[j]);
            change[c] += r * (begins * fabs(AT(v, j)) + spread[j]);
        }
    }
    return Py_BuildValue("NNNNd", ends, besides, ways, changes, begins + braking);
}

/* the least gap between a plane and the corners (4, V) of a link, placed by T row by row */
static double least_gap(const Mat *planes, npy_intp pair, const double *T, const double *corners, npy_intp V)
{
    double local[4], least = INFINITY;
    for (int c = 0; c < 4; c++)
        local[c] = AT2(*planes, pair, 0) * T[c] + AT2(*planes, pair, 1) * T[4 + c] + AT2(*planes, pair, 2) * T[8 + c];
    local[3] += AT2(*planes, pair, 3);
    for (npy_intp v = 0; v < V; v++) {
        const double gap = local[0] * corners[v] + local[1] * corners[V + v] + local[2] * corners[2 * V + v] +
                           local[3] * corners[3 * V + v];
        if (!(gap >= least)) /* what is no number is kept */
            least = gap;
    }
    return least;
}

PyObject *inexact_boxes(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Ind joint, pairs, classes;
    Mat planes;
    Vec clearance, beside, way, change, distance, odometer, proven, path;
    npy_intp t[4], c[3], w[3];
    double rules[3], *inexact;
    if (count_is(count, 16, "inexact_boxes") < 0)
        return NULL;
    const double *T = block(args[0], "T", 4, t), *columns = T ? block(args[2], "columns", 3, c) : NULL;
    const double *witnesses = columns ? block(args[3], "witnesses", 3, w) : NULL;
    if (!witnesses || as_ind(args[1], "joint", t[1], &joint) < 0 || as_mat(args[4], "planes", -1, 4, &planes) < 0 ||
        as_ind(args[5], "pairs", planes.rows, &pairs) < 0 || as_vec(args[8], "beside", -1, &beside) < 0 ||
        as_ind(args[6], "classes", beside.n, &classes) < 0 || has_length(classes.n, joint.n, "classes") < 0 ||
        as_vec(args[7], "clearance", joint.n, &clearance) < 0 || as_vec(args[9], "way", beside.n, &way) < 0 ||
        as_vec(args[10], "change", beside.n, &change) < 0 || as_vec(args[11], "distance", planes.rows, &distance) < 0 ||
        as_vec(args[12], "odometer", beside.n, &odometer) < 0 || as_vec(args[13], "proven", planes.rows, &proven) < 0 ||
        as_vec(args[14], "path_odometer", beside.n, &path) < 0 || as_doubles(args[15], "rules", 3, rules) < 0)
        return NULL;
    const npy_intp S = t[0], K = joint.n, V = c[2], B = w[1];
    if (S < 1 || t[2] != 4 || t[3] != 4 || c[0] != K || c[1] != 4 || V < 1 || w[0] != K || w[2] != 6 || pairs.n != K * B) {
        PyErr_SetString(PyExc_ValueError, "T, columns, witnesses and pairs do not fit together");
        return NULL;
    }
    PyObject *found = new_vec(K, &inexact);
    for (npy_intp k = 0; found && k < K; k++) {
        const npy_intp row = INDEX(classes, k);
        const double *corners = columns + 4 * V * k, *now = T + 16 * INDEX(joint, k);
        const double acts = AT(clearance, k) + rules[0], needed = AT(clearance, k) + rules[1];
        inexact[k] = 0.0;
        for (npy_intp i = B * k; i < B * (k + 1) && inexact[k] == 0.0; i++) {
            const npy_intp pair = INDEX(pairs, i);
            const double here = AT(distance, pair) - AT(odometer, row), *witness = witnesses + 6 * i;
            double off = 0.0, along = INFINITY;
            const int stays = here - AT(way, row) >= needed || AT(proven, pair) - (AT(path, row) + AT(change, row)) >= needed;
            if (stays && here >= acts)
                continue;
            const double gap = least_gap(&planes, pair, now, corners, V);
            for (int r = 0; r < 3; r++) {
                const double *m = now + 4 * r;
                const double away = m[0] * witness[0] + m[1] * witness[1] + m[2] * witness[2] + m[3] - witness[3 + r];
                off += away * away;
            }
            const double least = gap > here ? gap : here;
            if (least >= rules[2] * sqrt(off))
                continue;
            if (least < acts)
                inexact[k] = 1.0;
            if (stays)
                continue;
            for (npy_intp s = 0; s < S; s++) {
                const double later = s ? least_gap(&planes, pair, now + 16 * t[1] * s, corners, V) : gap;
                along = later < along ? later : along;
            }
            if (along - AT(beside, row) < needed)
                inexact[k] = 1.0;
        }
    }
    return found;
}

PyObject *box_urgency(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat moved;
    Vec covered, nearest, clearance, speed, counts, beside, inexact;
    Ind classes;
    double time, rules[2], *urgency;
    if (count_is(count, 11, "box_urgency") < 0 || as_vec(args[1], "covered", -1, &covered) < 0 ||
        as_mat(args[0], "moved", -1, covered.n, &moved) < 0 || as_vec(args[2], "nearest", covered.n, &nearest) < 0 ||
        as_vec(args[3], "clearance", covered.n, &clearance) < 0 || as_vec(args[4], "speed", covered.n, &speed) < 0 ||
        as_vec(args[5], "counts", covered.n, &counts) < 0 || as_vec(args[7], "beside", -1, &beside) < 0 ||
        as_ind(args[6], "classes", beside.n, &classes) < 0 || has_length(classes.n, covered.n, "classes") < 0 ||
        as_double(args[8], "time", &time) < 0 || as_vec(args[9], "inexact", covered.n, &inexact) < 0 ||
        as_doubles(args[10], "rules", 2, rules) < 0)
        return NULL;
    if (covered.n && moved.rows < 1) {
        PyErr_SetString(PyExc_ValueError, "moved: at least one row is wanted");
        return NULL;
    }
    PyObject *found = new_vec(covered.n, &urgency);
    const double close = rules[0], least = rules[1];
    for (npy_intp k = 0; found && k < covered.n; k++) {
        double furthest = AT2(moved, 0, k);
        for (npy_intp s = 1; s < moved.rows; s++)
            if (!(AT2(moved, s, k) <= furthest))
                furthest = AT2(moved, s, k);
        const double left = AT(covered, k) - AT(clearance, k) - AT(speed, k) * time - furthest -
                            AT(beside, INDEX(classes, k));
        const double part = close * AT(nearest, k);
        urgency[k] = INFINITY;
        if (left > 0.0) {
            const double aside = AT2(moved, 0, k) / (part > least ? part : least);
            urgency[k] = least / left;
            if (AT(inexact, k) > 0.0 && aside > urgency[k])
                urgency[k] = aside;
        }
        if (!(AT(counts, k) > 0.0))
            urgency[k] = 0.0;
    }
    return found;
}

PyObject *ways_of_links(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Ind joint;
    Vec fat;
    npy_intp t[4], b[3], c[3];
    double *way;
    if (count_is(count, 5, "ways_of_links") < 0)
        return NULL;
    const double *T = block(args[0], "T", 4, t), *begun = T ? block(args[2], "begun", 3, b) : NULL;
    const double *columns = begun ? block(args[3], "columns", 3, c) : NULL;
    if (!columns || as_ind(args[1], "joint", t[1], &joint) < 0 || as_vec(args[4], "fat", joint.n, &fat) < 0)
        return NULL;
    const npy_intp S = t[0], K = joint.n, V = c[2];
    if (t[2] != 4 || t[3] != 4 || b[0] != K || b[1] != 3 || b[2] != 4 || c[0] != K || c[1] != 4 || V < 1) {
        PyErr_SetString(PyExc_ValueError, "T, begun and columns do not fit together");
        return NULL;
    }
    PyObject *found = new_mat(S, K, &way);
    if (!found)
        return NULL;
    for (npy_intp s = 0; s < S; s++)
        for (npy_intp k = 0; k < K; k++) {
            const double *now = T + 16 * (t[1] * s + INDEX(joint, k)), *corner = columns + 4 * V * k;
            double change[12], turn = 0.0, most = 0.0;
            for (int i = 0; i < 12; i++) {
                change[i] = now[i] - begun[12 * k + i];
                if (i % 4 < 3)
                    turn += change[i] * change[i];
            }
            for (npy_intp v = 0; v < V; v++) {
                double off = 0.0;
                for (int r = 0; r < 3; r++) {
                    const double *m = change + 4 * r;
                    const double x = m[0] * corner[v] + m[1] * corner[V + v] + m[2] * corner[2 * V + v] + m[3] * corner[3 * V + v];
                    off += x * x;
                }
                if (!(off <= most)) /* what is no number is kept */
                    most = off;
            }
            way[K * s + k] = sqrt(most) + AT(fat, k) * sqrt(turn);
        }
    return found;
}

enum { DISTANCE, NORMAL, POINT = NORMAL + 3, OTHER = POINT + 3, AXES = 10, CORNERS = 25, IS_CELL = 49, NUMBERS };

PyObject *put_planes(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat numbers, velocity, at, planes, points, faces, witnesses;
    Ind pairs;
    Vec shift, drift;
    double fat, far, *distance;
    if (count_is(count, 12, "put_planes") < 0 || as_mat(args[0], "numbers", -1, NUMBERS, &numbers) < 0 ||
        as_out(args[7], "planes", -1, 4, &planes) < 0 || as_ind(args[1], "pairs", planes.rows, &pairs) < 0 ||
        as_double(args[2], "fat", &fat) < 0 || as_mat(args[3], "velocity", planes.rows, 3, &velocity) < 0 ||
        as_vec(args[4], "shift", 3, &shift) < 0 || as_mat(args[5], "found_at", 3, 4, &at) < 0 ||
        as_double(args[6], "far", &far) < 0 || as_vec(args[8], "drift", planes.rows, &drift) < 0 ||
        is_writeable(args[8], "drift") < 0 || as_out(args[9], "points", planes.rows, 6, &points) < 0 ||
        as_out(args[10], "faces", planes.rows, 15, &faces) < 0 || as_out(args[11], "witnesses", pairs.n, 6, &witnesses) < 0)
        return NULL;
    if (numbers.rows > pairs.n) {
        PyErr_SetString(PyExc_ValueError, "numbers: there are more boxes than pairs");
        return NULL;
    }
    PyObject *found = new_vec(pairs.n, &distance);
    for (npy_intp k = 0; found && k < pairs.n; k++) {
        const npy_intp pair = INDEX(pairs, k);
        double along = 0.0, least = INFINITY, rate = 0.0;
        for (int c = 0; c < 6; c++)
            AT2(points, pair, c) = AT2(witnesses, k, c) = NAN;
        for (int c = 0; c < 15; c++)
            AT2(faces, pair, c) = k < numbers.rows ? (c < 12 ? 1.0 : 0.5) * AT2(numbers, k, AXES + c) : NAN;
        distance[k] = far, AT(drift, pair) = 0.0, AT2(planes, pair, 3) = far;
        for (int c = 0; c < 3; c++)
            AT2(planes, pair, c) = 0.0;
        if (k >= numbers.rows)
            continue;
        for (int i = 0; i < 8; i++) {
            double at_corner = 0.0;
            for (int c = 0; c < 3; c++)
                at_corner += AT2(numbers, k, NORMAL + c) * AT2(numbers, k, CORNERS + 3 * i + c);
            if (!(at_corner >= least)) /* what is no number is kept */
                least = at_corner;
        }
        for (int c = 0; c < 3; c++) {
            const double n = AT2(numbers, k, NORMAL + c);
            along += n * AT(shift, c), rate += n * AT2(velocity, pair, c), AT2(planes, pair, c) = -n;
        }
        distance[k] = AT2(numbers, k, DISTANCE), AT(drift, pair) = rate, AT2(planes, pair, 3) = least + along - fat;
        if (!(AT2(numbers, k, IS_CELL) > 0.0))
            continue;
        for (int c = 0; c < 3; c++) {
            double own = 0.0;
            for (int r = 0; r < 3; r++)
                own += (AT2(numbers, k, POINT + r) + (AT(shift, r) - AT2(at, r, 3))) * AT2(at, r, c);
            AT2(witnesses, k, c) = own, AT2(witnesses, k, 3 + c) = AT2(numbers, k, OTHER + c) + AT(shift, c);
        }
    }
    return found;
}
