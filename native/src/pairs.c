/* Pairs of pieces: bounds of their distances, which of them are to be measured, and their rows. */
#include "arrays.h"

#include <math.h>

/* (M,) the most that `travel` (M, n) makes of moves (n,) [m], written to `way` */
static void ways(const Mat *travel, const double *moves, double *way)
{
    for (npy_intp i = 0; i < travel->rows; i++)
        way[i] = AT2(*travel, i, 0) * moves[0];
    for (npy_intp j = 1; j < travel->columns; j++) {
        const double move = moves[j];
        const char *column = travel->data + j * travel->right;
        if (travel->down == sizeof(double)) {
            const double *r = (const double *)column;
            for (npy_intp i = 0; i < travel->rows; i++)
                way[i] += r[i] * move;
        } else
            for (npy_intp i = 0; i < travel->rows; i++)
                way[i] += *(const double *)(column + i * travel->down) * move;
    }
}

static int moves_between(PyObject *q_0, PyObject *q, npy_intp n, double *moves)
{
    Vec from, to;
    if (as_vec(q_0, "q_0", n, &from) < 0 || as_vec(q, "q", n, &to) < 0)
        return -1;
    for (npy_intp j = 0; j < n; j++)
        moves[j] = fabs(AT(to, j) - AT(from, j));
    return 0;
}

PyObject *bounds_after(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec lower;
    Mat travel;
    double moves[MOST_JOINTS], *left;
    if (count_is(count, 4, "bounds_after") < 0 || as_vec(args[0], "lower", -1, &lower) < 0 ||
        as_mat(args[1], "travel", lower.n, -1, &travel) < 0 || some_joints(travel.columns) < 0 ||
        moves_between(args[2], args[3], travel.columns, moves) < 0)
        return NULL;
    PyObject *found = new_vec(lower.n, &left);
    if (!found)
        return NULL;
    ways(&travel, moves, left);
    for (npy_intp i = 0; i < lower.n; i++)
        left[i] = AT(lower, i) - left[i];
    return found;
}

PyObject *reach_of_lead(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec lower, speed, clearance, least, fastest;
    Mat travel;
    double stop, moves[MOST_JOINTS], *reach;
    if (count_is(count, 7, "reach_of_lead") < 0 || as_vec(args[0], "lower", -1, &lower) < 0 ||
        as_mat(args[1], "travel", lower.n, -1, &travel) < 0 || as_vec(args[2], "speed", lower.n, &speed) < 0 ||
        as_vec(args[3], "clearance", lower.n, &clearance) < 0 || as_vec(args[4], "least", lower.n, &least) < 0 ||
        some_joints(travel.columns) < 0 || as_vec(args[5], "fastest", travel.columns, &fastest) < 0 ||
        as_double(args[6], "stop", &stop) < 0)
        return NULL;
    for (npy_intp j = 0; j < fastest.n; j++)
        moves[j] = AT(fastest, j);
    PyObject *found = new_vec(lower.n, &reach);
    if (!found)
        return NULL;
    ways(&travel, moves, reach);
    npy_intp within = 0;
    for (npy_intp i = 0; i < lower.n; i++) {
        const double far = (reach[i] + AT(speed, i)) * stop + AT(clearance, i), near = AT(least, i);
        reach[i] = far > near ? far : near;
        within += AT(lower, i) <= reach[i];
    }
    return Py_BuildValue("Nn", found, (Py_ssize_t)within);
}

PyObject *approach_rates(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat own, centre, J, shift, velocity;
    Vec size, v;
    Ind joint, piece, body;
    if (count_is(count, 11, "approach_rates") < 0 || is_array(args[0], "poses", NPY_DOUBLE, 3) < 0)
        return NULL;
    PyArrayObject *poses = (PyArrayObject *)args[0];
    if (PyArray_DIM(poses, 1) != 3 || PyArray_DIM(poses, 2) != 4) {
        PyErr_SetString(PyExc_ValueError, "poses: an array (joints, 3, 4) is wanted");
        return NULL;
    }
    const npy_intp joints = PyArray_DIM(poses, 0);
    if (as_mat(args[1], "own", -1, 4, &own) < 0 || as_mat(args[2], "centre", 3, -1, &centre) < 0 ||
        as_vec(args[3], "size", centre.columns, &size) < 0 || as_ind(args[4], "joint", joints, &joint) < 0 ||
        as_mat(args[5], "J", 6, joints - 1, &J) < 0 || some_joints(joints - 1) < 0 ||
        as_vec(args[6], "v", joints - 1, &v) < 0 || as_ind(args[7], "piece", centre.columns, &piece) < 0 ||
        as_ind(args[8], "body", centre.columns, &body) < 0 || as_mat(args[9], "shift", piece.n, 3, &shift) < 0 ||
        as_mat(args[10], "velocity", piece.n, 3, &velocity) < 0)
        return NULL;
    if (joint.n != centre.columns || own.rows > joint.n || body.n != piece.n) {
        PyErr_SetString(PyExc_ValueError, "joint, body: as many as in centre and piece are wanted");
        return NULL;
    }
    const char *pose = PyArray_BYTES(poses);
    const npy_intp p0 = PyArray_STRIDE(poses, 0), p1 = PyArray_STRIDE(poses, 1), p2 = PyArray_STRIDE(poses, 2);
    double motion[MOST_JOINTS + 1][6]; /* of each joint's body: velocity at the world's origin, angular velocity */
    memset(motion[0], 0, sizeof(motion[0]));
    for (npy_intp j = 1; j < joints; j++)
        for (int c = 0; c < 6; c++)
            motion[j][c] = motion[j - 1][c] + AT2(J, c, j - 1) * AT(v, j - 1);
    double *rate;
    PyObject *found = new_vec(piece.n, &rate);
    if (!found)
        return NULL;
    for (npy_intp k = 0; k < piece.n; k++) {
        double place[2][3];
        const npy_intp which[2] = {INDEX(piece, k), INDEX(body, k)};
        for (int b = 0; b < 2; b++) {
            const npy_intp row = which[b];
            for (int c = 0; c < 3; c++) {
                if (row >= own.rows) { /* it stands, in the world's frame */
                    place[b][c] = AT2(centre, c, row);
                    continue;
                }
                const char *at = pose + INDEX(joint, row) * p0 + c * p1;
                double sum = 0.0;
                for (int d = 0; d < 4; d++)
                    sum += *(const double *)(at + d * p2) * AT2(own, row, d);
                place[b][c] = sum;
            }
        }
        const double *first = motion[INDEX(joint, which[0])], *second = motion[INDEX(joint, which[1])];
        double seen[6], passing[3], away[3], length = 0.0, speed2 = 0.0, along = 0.0, turn = 0.0;
        for (int c = 0; c < 6; c++)
            seen[c] = first[c] - second[c];
        for (int c = 0; c < 3; c++) {
            const int next = (c + 1) % 3, last = (c + 2) % 3;
            passing[c] = seen[c] + seen[3 + next] * place[0][last] - seen[3 + last] * place[0][next] - AT2(velocity, k, c);
            away[c] = place[1][c] - place[0][c] + AT2(shift, k, c);
            length += away[c] * away[c];
            speed2 += passing[c] * passing[c];
            along += away[c] * passing[c];
            turn += seen[3 + c] * seen[3 + c];
        }
        const double radius = AT(size, which[0]), both = radius + AT(size, which[1]);
        length = sqrt(length);
        if (!(length > 1e-9)) /* centres that coincide have no direction */
            length = 1e-9;
        double sine = both / length, speed = sqrt(speed2), towards = speed;
        if (sine < 1.0) {
            const double cosine = sqrt(1.0 - sine * sine);
            along /= length;
            if (along < speed * cosine) {
                const double across2 = speed2 - along * along;
                towards = along * cosine + sqrt(across2 > 0.0 ? across2 : 0.0) * sine;
            }
        }
        rate[k] = towards + sqrt(turn) * radius;
    }
    return found;
}

PyObject *near_rows(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Ind pairs;
    Mat found, sense, velocity, J;
    Vec reach, clearance, v, change;
    double margin = 0.0, longest = 0.0;
    if (count_is(count, 11, "near_rows") < 0)
        return NULL;
    const int drifts = args[5] != Py_None, leads = args[8] != Py_None;
    if (as_vec(args[3], "clearance", -1, &clearance) < 0 || as_ind(args[0], "pairs", clearance.n, &pairs) < 0 ||
        as_mat(args[1], "found", pairs.n, 10, &found) < 0 || as_vec(args[2], "reach", pairs.n, &reach) < 0 ||
        as_mat(args[4], "sense", clearance.n, -1, &sense) < 0 || some_joints(sense.columns) < 0 ||
        (drifts && as_mat(args[5], "velocity", clearance.n, 3, &velocity) < 0) ||
        as_mat(args[6], "J", 6, sense.columns, &J) < 0)
        return NULL;
    if (leads && (as_double(args[7], "margin", &margin) < 0 || as_vec(args[8], "v", sense.columns, &v) < 0 ||
                  as_vec(args[9], "change", sense.columns, &change) < 0 || as_double(args[10], "longest", &longest) < 0))
        return NULL;
    const npy_intp n = sense.columns, most = pairs.n;
    double Jc[6 * MOST_JOINTS]; /* by columns */
    for (npy_intp j = 0; j < n; j++)
        for (int c = 0; c < 6; c++)
            Jc[6 * j + c] = AT2(J, c, j);
    Room room;
    /* of the near ones: row of `found`, whether they count, what they have left, drift, gradient */
    npy_intp *row = room_for(&room, most * (2 * sizeof(npy_intp) + (2 + n) * sizeof(double)));
    if (!row)
        return NULL;
    npy_intp *counts = row + most;
    double *left = (double *)(counts + most), *drift = left + most, *gradient = drift + most;
    npy_intp near = 0, counting = 0;
    for (npy_intp k = 0; k < most; k++) {
        const double distance = AT2(found, k, 0);
        if (!(distance <= AT(reach, k)))
            continue;
        const npy_intp pair = INDEX(pairs, k);
        const double nx = AT2(found, k, 1), ny = AT2(found, k, 2), nz = AT2(found, k, 3);
        const double px = AT2(found, k, 4), py = AT2(found, k, 5), pz = AT2(found, k, 6);
        const double m[6] = {nx, ny, nz, py * nz - pz * ny, pz * nx - px * nz, px * ny - py * nx};
        double *g = gradient + n * near;
        for (npy_intp j = 0; j < n; j++) {
            const double *column = Jc + 6 * j;
            g[j] = (m[0] * column[0] + m[1] * column[1] + m[2] * column[2] + m[3] * column[3] + m[4] * column[4] +
                    m[5] * column[5]) * AT2(sense, pair, j);
        }
        left[near] = distance - AT(clearance, pair);
        drift[near] = drifts ? nx * AT2(velocity, pair, 0) + ny * AT2(velocity, pair, 1) + nz * AT2(velocity, pair, 2) : 0.0;
        int does = 1;
        if (leads && !(left[near] <= margin)) {
            double rate = -drift[near];
            for (npy_intp j = 0; j < n; j++)
                rate += fabs(g[j]) * AT(change, j) - g[j] * AT(v, j);
            does = left[near] < longest * rate;
        }
        if (does)
            counts[counting++] = near;
        row[near++] = k;
    }
    PyObject *result = NULL;
    npy_intp *near_pairs, *some_pairs;
    double *near_found, *some_found, *some_left, *some_gradient, *some_drift;
    PyObject *parts[7] = {new_ind(near, &near_pairs), new_mat(near, 10, &near_found), NULL, NULL,
                          new_vec(counting, &some_left), new_mat(counting, n, &some_gradient),
                          new_vec(counting, &some_drift)};
    if (counting == near) {
        parts[2] = Py_XNewRef(parts[0]), parts[3] = Py_XNewRef(parts[1]);
        some_pairs = near_pairs, some_found = NULL;
    } else
        parts[2] = new_ind(counting, &some_pairs), parts[3] = new_mat(counting, 10, &some_found);
    for (int part = 0; part < 7; part++)
        if (!parts[part])
            goto done;
    for (npy_intp k = 0; k < near; k++) {
        near_pairs[k] = INDEX(pairs, row[k]);
        for (int c = 0; c < 10; c++)
            near_found[10 * k + c] = AT2(found, row[k], c);
    }
    for (npy_intp k = 0; k < counting; k++) {
        const npy_intp from = counts[k];
        if (some_found) {
            some_pairs[k] = near_pairs[from];
            memcpy(some_found + 10 * k, near_found + 10 * from, 10 * sizeof(double));
        }
        some_left[k] = left[from], some_drift[k] = drift[from];
        memcpy(some_gradient + n * k, gradient + n * from, n * sizeof(double));
    }
    result = PyTuple_New(7);
    if (result)
        for (int part = 0; part < 7; part++)
            PyTuple_SET_ITEM(result, part, Py_NewRef(parts[part]));
done:
    for (int part = 0; part < 7; part++)
        Py_XDECREF(parts[part]);
    release(&room);
    return result;
}

PyObject *unproven_of_near(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Ind pairs;
    Vec left, speed, furthest;
    Mat travel;
    double beyond, dt, spare, moves[MOST_JOINTS], fastest;
    if (count_is(count, 11, "unproven_of_near") < 0 || as_mat(args[3], "travel", -1, -1, &travel) < 0 ||
        as_ind(args[0], "pairs", travel.rows, &pairs) < 0 || as_vec(args[1], "left", pairs.n, &left) < 0 ||
        as_double(args[2], "beyond", &beyond) < 0 || as_vec(args[4], "speed", travel.rows, &speed) < 0 ||
        some_joints(travel.columns) < 0 || as_vec(args[5], "furthest", travel.columns, &furthest) < 0 ||
        as_double(args[6], "fastest", &fastest) < 0 ||
        moves_between(args[7], args[8], travel.columns, moves) < 0 || as_double(args[9], "dt", &dt) < 0 ||
        as_double(args[10], "spare", &spare) < 0)
        return NULL;
    double way = 0.0;
    dt = fabs(dt);
    for (npy_intp j = 0; j < travel.columns; j++)
        way += AT(furthest, j) * moves[j];
    way += fastest * dt;
    way += spare;
    if (!(beyond >= way))
        Py_RETURN_NONE;
    Room room;
    npy_intp *unproven = room_for(&room, pairs.n * sizeof(npy_intp)), some = 0;
    if (!unproven)
        return NULL;
    for (npy_intp k = 0; k < pairs.n; k++) {
        if (AT(left, k) >= way)
            continue;
        const npy_intp pair = INDEX(pairs, k);
        double needed = 0.0;
        for (npy_intp j = 0; j < travel.columns; j++)
            needed += AT2(travel, pair, j) * moves[j];
        needed += AT(speed, pair) * dt;
        needed += spare;
        if (!(AT(left, k) >= needed))
            unproven[some++] = pair;
    }
    PyObject *found = ind_of(unproven, some);
    release(&room);
    return found;
}

PyObject *read_results(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat numbers;
    Ind pairs;
    double contact, *to;
    if (count_is(count, 3, "read_results") < 0 || as_mat(args[0], "numbers", -1, 10, &numbers) < 0 ||
        as_ind(args[1], "pairs", numbers.rows, &pairs) < 0 || as_double(args[2], "contact", &contact) < 0)
        return NULL;
    PyObject *found = new_mat(pairs.n, 10, &to);
    if (!found)
        return NULL;
    int doubtful = 0;
    for (npy_intp k = 0; k < pairs.n; k++, to += 10) {
        const npy_intp pair = INDEX(pairs, k);
        for (int c = 0; c < 10; c++)
            to[c] = AT2(numbers, pair, c);
        if (!(to[0] > contact))
            doubtful = 1;
    }
    return Py_BuildValue("NN", found, PyBool_FromLong(doubtful));
}

PyObject *pairs_within(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Ind pairs;
    Vec lower, reach;
    if (count_is(count, 3, "pairs_within") < 0 || as_ind(args[0], "pairs", NPY_MAX_INTP, &pairs) < 0 ||
        as_vec(args[1], "lower", pairs.n, &lower) < 0 || as_vec(args[2], "reach", pairs.n, &reach) < 0)
        return NULL;
    npy_intp some = 0, *row, *near;
    double *within;
    for (npy_intp i = 0; i < pairs.n; i++)
        some += AT(lower, i) <= AT(reach, i);
    PyObject *rows = new_ind(some, &row), *nears = new_ind(some, &near), *reaches = new_vec(some, &within);
    if (!rows || !nears || !reaches) {
        Py_XDECREF(rows), Py_XDECREF(nears), Py_XDECREF(reaches);
        return NULL;
    }
    for (npy_intp i = 0; i < pairs.n; i++)
        if (AT(lower, i) <= AT(reach, i))
            *row++ = i, *near++ = INDEX(pairs, i), *within++ = AT(reach, i);
    return Py_BuildValue("NNN", rows, nears, reaches);
}
