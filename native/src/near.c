/* How far apart the near pairs are in many configurations, and how that changes: site/pairs/hull_distances.py. */
#include "screen.h"

#include <math.h>
#include <string.h>

static const double ROUNDING = 1e-9; /* m: far above what sums of a few products are off */

/* The signed distance of a pair, its normal from the first to the second, and the point of the first; 1 with these, 0 with
 * a lower bound of the distance that is more than `needed`, or -1 where that takes coal. */
static int measure_pair(const Screen *s, const Machine *m, npy_intp pair, double needed, double *distance,
                        double *normal, double *point)
{
    const npy_intp a = INDEX(s->first, pair), b = INDEX(s->second, pair);
    const double *box = b < s->own ? NULL : s->box + 15 * (b - s->own);
    if (box && box[12] < 0.0) {
        const Corners corners = corners_of(s, a, m->pose);
        for (int c = 0; c < 3; c++)
            normal[c] = -box[c];
        furthest_corner(&corners, normal, point);
        *distance = box[0] * point[0] + box[1] * point[1] + box[2] * point[2] - box[9] - s->radius[a];
        return 1;
    }
    const int found = distance_from_kept(s, pair, m->pose, needed + 2.0 * ROUNDING, distance, normal, point);
    if (found == 0)
        *distance -= ROUNDING;
    return found;
}

/* How fast a distance changes with each joint, from its normal and the link's point. */
static void gradient_of(const Machine *m, const Mat *sense, npy_intp pair, npy_intp n, const double *normal,
                        const double *point, double *gradient)
{
    for (npy_intp j = 0; j < n; j++) {
        const Pose *from = m->pose + j, *own = m->pose + j + 1;
        const double sign = AT2(*sense, pair, j), *g = m->factors[j] + 27;
        double axis[3];
        for (int r = 0; r < 3; r++)
            axis[r] = from->R[3 * r] * g[0] + from->R[3 * r + 1] * g[1] + from->R[3 * r + 2] * g[2];
        if (m->slides[j] == 0.0) {
            const double x = point[0] - own->t[0], y = point[1] - own->t[1], z = point[2] - own->t[2];
            const double turned[3] = {axis[1] * z - axis[2] * y, axis[2] * x - axis[0] * z, axis[0] * y - axis[1] * x};
            for (int r = 0; r < 3; r++)
                axis[r] = turned[r];
        }
        gradient[j] = sign * (normal[0] * axis[0] + normal[1] * axis[1] + normal[2] * axis[2]);
    }
}

/* what is found, row after row; it grows */
typedef struct {
    npy_intp *row, *pair;
    double *distance, *gradient;
    npy_intp count, most;
} Found;

static int make_room(Found *found, npy_intp n)
{
    if (found->count < found->most)
        return 0;
    const npy_intp most = 2 * found->most + 256;
    npy_intp *row = PyMem_RawRealloc(found->row, most * sizeof *row);
    found->row = row ? row : found->row;
    npy_intp *pair = row ? PyMem_RawRealloc(found->pair, most * sizeof *pair) : NULL;
    found->pair = pair ? pair : found->pair;
    double *distance = pair ? PyMem_RawRealloc(found->distance, most * sizeof *distance) : NULL;
    found->distance = distance ? distance : found->distance;
    double *gradient = distance ? PyMem_RawRealloc(found->gradient, most * n * sizeof *gradient) : NULL;
    found->gradient = gradient ? gradient : found->gradient;
    if (!gradient)
        return PyErr_NoMemory(), -1;
    found->most = most;
    return 0;
}

/* The pairs of one configuration, in a row of q; the distance of one that takes coal is not a number. 0, or -1 with an
 * exception. */
static int near_in_one(const Screen *s, const Machine *m, const Mat *sense, npy_intp row, double margin, double *lower,
                       Found *found)
{
    const npy_intp n = s->factors.columns;
    for (npy_intp pair = 0; pair < s->least.n; pair++) {
        const double needed = AT(s->least, pair) + margin;
        double distance, normal[3], point[3];
        if (lower[pair] > needed)
            continue;
        const double apart = balls_apart(s, INDEX(s->first, pair), INDEX(s->second, pair),
                                         (const double (*)[3])m->ball, s->radius + s->own) - ROUNDING;
        if (apart > 0.0) /* where balls may touch, nothing is known */
            lower[pair] = fmax(lower[pair], apart);
        if (lower[pair] > needed)
            continue;
        const int known = measure_pair(s, m, pair, needed, &distance, normal, point), takes_coal = known < 0;
        if (!takes_coal)
            lower[pair] = known ? distance : fmax(lower[pair], distance);
        if (known == 0 || (known > 0 && distance > needed))
            continue;
        if (make_room(found, n) < 0)
            return -1;
        double *gradient = found->gradient + n * found->count;
        found->row[found->count] = row, found->pair[found->count] = pair;
        found->distance[found->count++] = takes_coal ? NAN : distance;
        if (takes_coal)
            for (npy_intp j = 0; j < n; j++)
                gradient[j] = NAN;
        else
            gradient_of(m, sense, pair, n, normal, point, gradient);
    }
    return 0;
}

PyObject *distances_within(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Screen s;
    Machine m;
    Vec margin;
    Mat known, sense;
    if (count_is(count, 18, "distances_within") < 0 || read_screen(args + 3, &s) < 0 ||
        as_vec(args[0], "margin", s.q.rows, &margin) < 0 ||
        as_mat(args[1], "known", s.q.rows, s.least.n, &known) < 0 ||
        as_mat(args[2], "sense", s.least.n, s.factors.columns, &sense) < 0 || machine_of(&s, &m) < 0)
        return NULL;
    const npy_intp rows = s.q.rows, pairs = s.least.n, n = s.factors.columns;
    double *lower, *distance, *gradient;
    npy_intp *at, *pair;
    Found found = {0};
    PyObject *parts[5] = {new_mat(rows, pairs, &lower), NULL, NULL, NULL, NULL}, *result = NULL;
    if (!parts[0])
        goto done;
    for (npy_intp row = 0; row < rows; row++) {
        for (npy_intp k = 0; k < pairs; k++)
            lower[pairs * row + k] = AT2(known, row, k);
        place_at(&s, &m, row);
        if (near_in_one(&s, &m, &sense, row, AT(margin, row), lower + pairs * row, &found) < 0)
            goto done;
    }
    if (!(parts[1] = new_ind(found.count, &at)) || !(parts[2] = new_ind(found.count, &pair)) ||
        !(parts[3] = new_vec(found.count, &distance)) || !(parts[4] = new_mat(found.count, n, &gradient)))
        goto done;
    if (found.count) {
        memcpy(at, found.row, found.count * sizeof *at);
        memcpy(pair, found.pair, found.count * sizeof *pair);
        memcpy(distance, found.distance, found.count * sizeof *distance);
        memcpy(gradient, found.gradient, found.count * n * sizeof *gradient);
    }
    result = PyTuple_New(5);
    for (int part = 0; part < 5 && result; part++)
        PyTuple_SET_ITEM(result, part, Py_NewRef(parts[part]));
done:
    for (int part = 0; part < 5; part++)
        Py_XDECREF(parts[part]);
    PyMem_RawFree(found.row), PyMem_RawFree(found.pair), PyMem_RawFree(found.distance), PyMem_RawFree(found.gradient);
    release(&m.room);
    return result;
}
