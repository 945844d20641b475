/* What is asked of pieces of a machine in some configurations, each with a number: site/pairs/link_corners.py. */
#include "asked.h"

#include <string.h>

int read_asked(PyObject *const *args, Asked *a)
{
    npy_intp R[4], t[3], corner[2], radius[1], turn[2], at[1];
    if (!(a->R = block(args[0], "R", 4, R)) || !(a->t = block(args[1], "t", 3, t)) ||
        has_length(R[2], 3, "R") < 0 || has_length(R[3], 3, "R") < 0 || has_length(t[0], R[0], "t") < 0 ||
        has_length(t[1], R[1], "t") < 0 || has_length(t[2], 3, "t") < 0 ||
        !(a->corner = block(args[3], "corners", 2, corner)) || has_length(corner[1], 3, "corners") < 0 ||
        !(a->radius = block(args[5], "radius", 1, radius)) || as_ind(args[2], "slot", R[1], &a->slot) < 0 ||
        has_length(a->slot.n, radius[0], "slot") < 0 || as_ind(args[4], "starts", corner[0] + 1, &a->starts) < 0 ||
        has_length(a->starts.n, radius[0] + 1, "starts") < 0 || as_ind(args[6], "row", R[0], &a->row) < 0 ||
        as_ind(args[7], "piece", radius[0], &a->piece) < 0 || has_length(a->piece.n, a->row.n, "piece") < 0 ||
        as_vec(args[8], "number", a->row.n, &a->number) < 0 || !(a->frame = block(args[9], "frame", 2, turn)) ||
        has_length(turn[0], 3, "frame") < 0 || has_length(turn[1], 3, "frame") < 0 ||
        !(a->origin = block(args[10], "origin", 1, at)) || has_length(at[0], 3, "origin") < 0)
        return -1;
    a->joints = R[1], a->most = 0;
    for (npy_intp k = 0; k < radius[0]; k++) {
        const npy_intp count = INDEX(a->starts, k + 1) - INDEX(a->starts, k);
        a->most = count > a->most ? count : a->most;
    }
    return 0;
}

int read_balls(PyObject *const *args, const Asked *asked, Balls *balls)
{
    npy_intp lengths[2];
    if (!(balls->ball = block(args[0], "balls", 2, lengths)) || has_length(lengths[1], 4, "balls") < 0 ||
        as_ind(args[1], "ball_starts", lengths[0] + 1, &balls->starts) < 0 ||
        has_length(balls->starts.n, asked->slot.n + 1, "ball_starts") < 0)
        return -1;
    return 0;
}

void place_asked(const Asked *a, npy_intp k, const double *own, double *point)
{
    const npy_intp at = a->joints * INDEX(a->row, k) + INDEX(a->slot, INDEX(a->piece, k));
    const double *R = a->R + 9 * at, *t = a->t + 3 * at;
    double world[3];
    for (int r = 0; r < 3; r++)
        world[r] = R[3 * r] * own[0] + R[3 * r + 1] * own[1] + R[3 * r + 2] * own[2] + t[r] - a->origin[r];
    for (int c = 0; c < 3; c++)
        point[c] = a->frame[c] * world[0] + a->frame[3 + c] * world[1] + a->frame[6 + c] * world[2];
}

npy_intp corners_asked(const Asked *a, npy_intp k, double *points)
{
    const npy_intp piece = INDEX(a->piece, k), first = INDEX(a->starts, piece);
    const npy_intp count = INDEX(a->starts, piece + 1) - first;
    for (npy_intp i = 0; i < count; i++)
        place_asked(a, k, a->corner + 3 * (first + i), points + 3 * i);
    return count > 0 ? count : 0;
}

void put_reading(const double *R, const double *t, double distance, const double *own, double *to)
{
    to[0] = distance;
    for (int part = 0; part < 3; part++, own += 3, to += 3)
        for (int r = 0; r < 3; r++)
            to[1 + r] = R[3 * r] * own[0] + R[3 * r + 1] * own[1] + R[3 * r + 2] * own[2] + (part ? t[r] : 0.0);
}

PyObject *verdicts_on(const Asked *a, Judge judge, const void *around)
{
    npy_intp *verdict, given_up = -1; /* the last configuration of which one piece is nearer */
    Room room;
    double *points = room_for(&room, (3 * a->most + 1) * sizeof(double));
    PyObject *found = points ? new_ind(a->row.n, &verdict) : NULL;
    for (npy_intp k = 0; found && k < a->row.n; k++) {
        const npy_intp row = INDEX(a->row, k);
        verdict[k] = row == given_up ? -1 : judge(around, k, points);
        if (verdict[k] == 0)
            given_up = row;
    }
    if (points)
        release(&room);
    return found;
}

PyObject *readings_of(const Asked *a, Read read, const void *around)
{
    npy_intp *state;
    double *reading;
    Room room;
    double *points = room_for(&room, (3 * a->most + 1) * sizeof(double));
    PyObject *states = points ? new_ind(a->row.n, &state) : NULL;
    PyObject *readings = states ? new_mat(a->row.n, 10, &reading) : NULL;
    for (npy_intp k = 0; readings && k < a->row.n; k++) {
        memset(reading + 10 * k, 0, 10 * sizeof(double));
        state[k] = read(around, k, points, reading + 10 * k);
    }
    if (points)
        release(&room);
    if (!readings) {
        Py_XDECREF(states);
        return NULL;
    }
    return Py_BuildValue("(NN)", states, readings);
}
