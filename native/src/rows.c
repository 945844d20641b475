/* Along a braking path: the placements, the corners that could bind, and what they ask of a velocity. */
#include "arrays.h"

#include <math.h>

/* What is asked of one pair: gaps below `within` count, from the column `first` to before `after`. */
typedef struct {
    const double *gaps; /* of all columns, the samples after the first */
    double needed, wanted, within, room;
    npy_intp first, after, nearest;
    int stands;
} Asked;

typedef struct {
    npy_intp k, column;
} Corner;

/* All columns that count: how many, of which up to `most` are written. */
static npy_intp all_of(const Asked *asked, npy_intp K, npy_intp most, Corner *out)
{
    npy_intp found = 0;
    for (npy_intp k = 0; k < K; k++)
        for (npy_intp c = asked[k].first; asked[k].within > -INFINITY && c < asked[k].after; c++)
            if (asked[k].gaps[c] < asked[k].within) {
                if (found == most)
                    return most + 1;
                out[found++] = (Corner){k, c};
            }
    return found;
}

static int is_of(const Asked *one, int which)
{
    return one->within > -INFINITY && (which < 0 || one->stands == which);
}

/* Corners with the least gaps of every pair, at most `most` of all together; `rank` has room for K, `best` for `most`. */
static npy_intp tightest(const Asked *asked, npy_intp K, npy_intp columns, int which, npy_intp most, npy_intp *rank,
                         npy_intp *best, Corner *out)
{
    npy_intp some = 0, found = 0;
    for (npy_intp k = 0; k < K; k++)
        if (is_of(asked + k, which))
            rank[some++] = k;
    if (some > most) { /* those with the least room come to the front, and stand in their order again */
        for (npy_intp i = 0; i < most; i++) {
            npy_intp least = i;
            for (npy_intp j = i + 1; j < some; j++)
                if (asked[rank[j]].room < asked[rank[least]].room)
                    least = j;
            const npy_intp k = rank[least];
            rank[least] = rank[i], rank[i] = k;
        }
        some = most;
        for (npy_intp i = 1; i < some; i++) {
            const npy_intp k = rank[i];
            npy_intp j = i;
            for (; j > 0 && rank[j - 1] > k; j--)
                rank[j] = rank[j - 1];
            rank[j] = k;
        }
    }
    if (2 * some > most) {
        for (npy_intp i = 0; i < some; i++)
            out[found++] = (Corner){rank[i], asked[rank[i]].nearest};
        return found;
    }
    npy_intp each = most / (some > 0 ? some : 1);
    if (each > columns)
        each = columns;
    for (npy_intp i = 0; i < some; i++) {
        const Asked *one = asked + rank[i];
        npy_intp kept = 0;
        for (npy_intp c = one->first; c < one->after; c++) { /* the least so far, in the order of their gaps */
            if (!(one->gaps[c] < one->within) || (kept == each && !(one->gaps[c] < one->gaps[best[kept - 1]])))
                continue;
            npy_intp j = kept < each ? kept++ : kept - 1;
            for (; j > 0 && one->gaps[c] < one->gaps[best[j - 1]]; j--)
                best[j] = best[j - 1];
            best[j] = c;
        }
        for (npy_intp a = 1; a < kept; a++) {
            const npy_intp c = best[a];
            npy_intp j = a;
            for (; j > 0 && best[j - 1] > c; j--)
                best[j] = best[j - 1];
            best[j] = c;
        }
        for (npy_intp a = 0; a < kept; a++)
            out[found++] = (Corner){rank[i], best[a]};
    }
    return found;
}

enum { BUFFER, MOST, OF_STANDING, RULES };

PyObject *binding_corners(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Ind pairs, closely, classes;
    Vec bound, required, off, budget;
    Mat least;
    Flg stands;
    npy_intp g[3], nearests[2];
    double rules[RULES];
    if (count_is(count, 12, "binding_corners") < 0 || as_vec(args[6], "required", -1, &required) < 0 ||
        as_ind(args[0], "pairs", required.n, &pairs) < 0 || as_vec(args[4], "bound", pairs.n, &bound) < 0 ||
        as_vec(args[8], "off", -1, &off) < 0 || as_vec(args[9], "budget", off.n, &budget) < 0 ||
        as_rows(args[7], "classes", off.n, required.n, &pairs, &classes) < 0 ||
        (args[10] != Py_None && as_flags(args[10], "stands", required.n, &stands) < 0) ||
        as_doubles(args[11], "rules", RULES, rules) < 0)
        return NULL;
    const double *gaps = block(args[1], "gaps", 3, g);
    const npy_intp *nearest = gaps ? index_block(args[2], "nearest", 2, nearests) : NULL;
    if (!nearest || as_mat(args[3], "least", pairs.n, g[1], &least) < 0 ||
        as_ind(args[5], "closely", g[1], &closely) < 0 || has_length(closely.n, pairs.n, "closely") < 0)
        return NULL;
    const npy_intp K = pairs.n, S = g[1], V = g[2];
    if (g[0] != K || nearests[0] != K || nearests[1] != S || S < 2 || V < 1 || !(rules[MOST] >= 1.0) ||
        !(rules[MOST] <= 1e6) || !(rules[OF_STANDING] >= 1.0) || !(rules[OF_STANDING] < rules[MOST])) {
        PyErr_SetString(PyExc_ValueError, "gaps, nearest and rules do not fit together");
        return NULL;
    }
    const npy_intp most = (npy_intp)rules[MOST], of_standing = (npy_intp)rules[OF_STANDING];
    Room room;
    Asked *asked = room_for(&room, (K + 1) * sizeof(Asked) + K * sizeof(npy_intp) + most * (sizeof(npy_intp) + sizeof(Corner)));
    if (!asked)
        return NULL;
    Corner *corners = (Corner *)(asked + K + 1);
    npy_intp *rank = (npy_intp *)(corners + most), *best = rank + K, standing = 0, some = 0;
    for (npy_intp k = 0; k < K; k++) {
        Asked *one = asked + k;
        const npy_intp pair = INDEX(pairs, k), row = INDEX(classes, pair), at = INDEX(closely, k);
        one->gaps = gaps + V * (S * k + 1);
        one->wanted = AT(required, pair) + rules[BUFFER];
        one->needed = AT(off, row) + one->wanted;
        one->within = one->needed + 2.0 * AT(budget, row);
        one->stands = args[10] != Py_None && FLAG(stands, pair);
        standing += one->stands;
        npy_intp tight = 0;
        one->first = 0, one->after = V * (S - 1);
        if (at > 0) {
            if (AT(bound, k) >= one->within - one->needed + one->wanted)
                one->within = -INFINITY;
            tight = at - 1;
            one->first = V * tight, one->after = V * at;
        } else
            for (npy_intp s = 1; s < S - 1; s++)
                if (AT2(least, k, 1 + s) < AT2(least, k, 1 + tight))
                    tight = s;
        const double found = AT2(least, k, 1 + tight);
        if (found >= one->within)
            one->within = -INFINITY;
        one->room = found - one->needed;
        one->nearest = V * tight + nearest[S * k + 1 + tight];
        if (one->nearest < V * tight || one->nearest >= V * (tight + 1)) {
            release(&room);
            PyErr_SetString(PyExc_IndexError, "nearest: is not one of the corners");
            return NULL;
        }
        some += one->within > -INFINITY;
    }
    npy_intp found = some > most ? most + 1 : all_of(asked, K, most, corners);
    if (found > most) {
        if (args[10] != Py_None && standing < K) {
            found = tightest(asked, K, V * (S - 1), 1, of_standing, rank, best, corners);
            found += tightest(asked, K, V * (S - 1), 0, most - of_standing, rank, best, corners + found);
        } else
            found = tightest(asked, K, V * (S - 1), -1, most, rank, best, corners);
    }
    npy_intp *row, *sample, *corner;
    double *left, *missing;
    PyObject *rows = new_ind(found, &row), *samples = new_ind(found, &sample), *numbers = new_ind(found, &corner),
             *rooms = new_vec(found, &left), *shorts = new_vec(found, &missing);
    if (!rows || !samples || !numbers || !rooms || !shorts) {
        Py_XDECREF(rows), Py_XDECREF(samples), Py_XDECREF(numbers), Py_XDECREF(rooms), Py_XDECREF(shorts);
        release(&room);
        return NULL;
    }
    for (npy_intp i = 0; i < found; i++) {
        const Asked *one = asked + corners[i].k;
        row[i] = corners[i].k, sample[i] = 1 + corners[i].column / V, corner[i] = corners[i].column % V;
        left[i] = one->gaps[corners[i].column] - one->needed;
        missing[i] = one->wanted - one->gaps[corner[i] - V];
    }
    release(&room);
    return Py_BuildValue("NNNNN", rows, samples, numbers, rooms, shorts);
}

PyObject *rows_by_velocity(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat G, moves;
    Vec room, shorts, v, comes;
    Ind samples;
    double look, sharper, *row, *h;
    if (count_is(count, 11, "rows_by_velocity") < 0)
        return NULL;
    const npy_intp parts = PyNumber_AsSsize_t(args[4], PyExc_IndexError);
    if (parts == -1 && PyErr_Occurred())
        return NULL;
    const npy_intp slowest = PyNumber_AsSsize_t(args[7], PyExc_IndexError);
    const int moved = args[9] != Py_None && args[10] != Py_None;
    if ((slowest == -1 && PyErr_Occurred()) || as_mat(args[0], "G", -1, -1, &G) < 0 ||
        as_vec(args[1], "room", G.rows, &room) < 0 || as_vec(args[2], "short", G.rows, &shorts) < 0 ||
        as_ind(args[3], "samples", parts + 1, &samples) < 0 || has_length(samples.n, G.rows, "samples") < 0 ||
        as_vec(args[5], "v", G.columns, &v) < 0 || as_double(args[6], "look", &look) < 0 ||
        as_double(args[8], "sharper", &sharper) < 0 ||
        (moved && (as_mat(args[9], "moves", 2, G.columns, &moves) < 0 || as_vec(args[10], "comes", G.rows, &comes) < 0)))
        return NULL;
    if (slowest < 0 || slowest >= G.columns) {
        PyErr_SetString(PyExc_IndexError, "slowest: is not one of the joints");
        return NULL;
    }
    PyObject *rows = new_mat(G.rows, G.columns, &row), *bounds = new_vec(G.rows, &h);
    if (!rows || !bounds) {
        Py_XDECREF(rows), Py_XDECREF(bounds);
        return NULL;
    }
    for (npy_intp i = 0; i < G.rows; i++, row += G.columns) {
        double missing = AT(shorts, i), left = AT(room, i), rate = 0.0, along = 0.0;
        const double part = (double)INDEX(samples, i) / (double)parts;
        if (moved) {
            double start = -AT(comes, i), end = -AT(comes, i);
            for (npy_intp j = 0; j < G.columns; j++)
                start += AT2(G, i, j) * AT2(moves, 0, j), end += AT2(G, i, j) * AT2(moves, 1, j);
            missing += start;
            left -= start + part * (end - start);
        }
        for (npy_intp j = 0; j < G.columns; j++)
            rate += AT2(G, i, j) * AT(v, j);
        for (npy_intp j = 0; j < G.columns; j++) {
            row[j] = (look * AT2(G, i, j) + (j == slowest ? sharper * rate : 0.0)) / look;
            along += row[j] * AT(v, j);
        }
        const double asks = left / (part * look) + along, most = -2.0 * (missing > 0.0 ? missing : 0.0);
        h[i] = asks > most ? asks : most;
    }
    return Py_BuildValue("NN", rows, bounds);
}

PyObject *place_on_line(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec q, delta, slides;
    Mat factors;
    npy_intp t[4], j[3];
    if (count_is(count, 8, "place_on_line") < 0 || as_vec(args[0], "q", -1, &q) < 0 || some_joints(q.n) < 0 ||
        as_vec(args[1], "delta", q.n, &delta) < 0 || as_mat(args[4], "factors", 33, q.n, &factors) < 0 ||
        as_vec(args[5], "slides", q.n, &slides) < 0)
        return NULL;
    const npy_intp parts = PyNumber_AsSsize_t(args[2], PyExc_IndexError);
    const npy_intp every = parts == -1 && PyErr_Occurred() ? -1 : PyNumber_AsSsize_t(args[3], PyExc_IndexError);
    if (every == -1 && PyErr_Occurred())
        return NULL;
    double *T = (double *)block(args[6], "T", 4, t), *J = T ? (double *)block(args[7], "J", 3, j) : NULL;
    if (!J || is_writeable(args[6], "T") < 0 || is_writeable(args[7], "J") < 0)
        return NULL;
    const npy_intp n = q.n;
    if (t[1] != n + 1 || t[2] != 4 || t[3] != 4 || j[0] != t[0] || j[1] != 6 || j[2] != n || parts < 1 ||
        parts >= t[0] || every < 1) {
        PyErr_SetString(PyExc_ValueError, "T, J, parts and every do not fit together");
        return NULL;
    }
    for (npy_intp i = 1; i <= parts; i += every) {
        double R[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0}, p[3] = {0.0, 0.0, 0.0}; /* R column by column */
        for (npy_intp k = 0; k < n; k++) {
            double moved[33];
            for (int m = 0; m < 11; m++)
                for (int r = 0; r < 3; r++)
                    moved[3 * m + r] = AT2(factors, 3 * m, k) * R[r] + AT2(factors, 3 * m + 1, k) * R[3 + r] +
                                       AT2(factors, 3 * m + 2, k) * R[6 + r];
            const double at = AT(q, k) + (double)i / parts * AT(delta, k), *axis = moved + 27;
            const int turns = AT(slides, k) == 0.0;
            const double sine = turns ? sin(at) : 0.0, versine = turns ? 1.0 - cos(at) : 0.0;
            for (int m = 0; m < 9; m++)
                R[m] = sine * moved[9 + m] + moved[m] + versine * moved[18 + m];
            for (int r = 0; r < 3; r++)
                p[r] += moved[30 + r] + (turns ? 0.0 : axis[r] * at);
            double *placed = T + 16 * ((n + 1) * i + k + 1), *column = J + 6 * n * i + k;
            for (int r = 0; r < 3; r++) {
                const int next = (r + 1) % 3, last = (r + 2) % 3;
                for (int c = 0; c < 3; c++)
                    placed[4 * r + c] = R[3 * c + r];
                placed[4 * r + 3] = p[r];
                column[n * r] = turns ? p[next] * axis[last] - p[last] * axis[next] : axis[r];
                column[n * (3 + r)] = turns ? axis[r] : 0.0;
            }
        }
    }
    Py_RETURN_NONE;
}

PyObject *bend_in_parts(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Vec delta, turning, furthest;
    double fine[2], *bend, angle = 0.0, most = 0.0;
    if (count_is(count, 4, "bend_in_parts") < 0 || as_vec(args[0], "delta", -1, &delta) < 0 ||
        as_vec(args[1], "turning", delta.n, &turning) < 0 || as_vec(args[2], "furthest", delta.n, &furthest) < 0 ||
        as_doubles(args[3], "fine", 2, fine) < 0)
        return NULL;
    PyObject *found = new_vec(delta.n, &bend);
    if (!found)
        return NULL;
    for (npy_intp j = 0; j < delta.n; j++) {
        const double size = fabs(AT(delta, j)), turn = size * AT(turning, j);
        angle += turn;
        bend[j] = size * (2.0 * angle - turn);
        most += bend[j] * AT(furthest, j);
    }
    const double wanted = ceil(sqrt(most / (8.0 * fine[0])));
    return Py_BuildValue("Nn", found, (Py_ssize_t)(wanted < 1.0 ? 1.0 : wanted < fine[1] ? wanted : fine[1]));
}

PyObject *least_over_path(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Ind pairs, classes;
    Mat least;
    Vec off;
    double *bound;
    if (count_is(count, 4, "least_over_path") < 0 || as_vec(args[3], "off", -1, &off) < 0 ||
        is_array(args[2], "classes", NPY_INTP, 1) < 0 ||
        as_ind(args[0], "pairs", PyArray_DIM((PyArrayObject *)args[2], 0), &pairs) < 0 ||
        as_rows(args[2], "classes", off.n, -1, &pairs, &classes) < 0 ||
        as_mat(args[1], "least", pairs.n, -1, &least) < 0)
        return NULL;
    if (least.columns < 1) {
        PyErr_SetString(PyExc_ValueError, "least: at least one sample is wanted");
        return NULL;
    }
    PyObject *found = new_vec(pairs.n, &bound);
    for (npy_intp k = 0; found && k < pairs.n; k++) {
        double at = AT2(least, k, 0);
        for (npy_intp s = 1; s < least.columns; s++)
            if (!(AT2(least, k, s) >= at)) /* what is no number is kept */
                at = AT2(least, k, s);
        bound[k] = at - AT(off, INDEX(classes, INDEX(pairs, k)));
    }
    return found;
}

PyObject *cost_of_tip(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mat task;
    Vec target, null;
    double free, *H, *f;
    if (count_is(count, 4, "cost_of_tip") < 0 || as_mat(args[0], "task", -1, -1, &task) < 0 ||
        as_vec(args[1], "target", task.columns, &target) < 0 || as_vec(args[2], "null", task.columns, &null) < 0 ||
        as_double(args[3], "free", &free) < 0)
        return NULL;
    const npy_intp n = task.columns;
    PyObject *square = new_mat(n, n, &H), *linear = new_vec(n, &f);
    if (!square || !linear) {
        Py_XDECREF(square), Py_XDECREF(linear);
        return NULL;
    }
    for (npy_intp i = 0; i < n; i++) {
        double along = 0.0;
        for (npy_intp j = 0; j < n; j++) {
            double sum = 0.0;
            for (npy_intp m = 0; m < task.rows; m++)
                sum += AT2(task, m, i) * AT2(task, m, j);
            H[n * i + j] = sum;
            along += sum * AT(target, j);
        }
        f[i] = -along - free * AT(null, i);
        H[(n + 1) * i] += free;
    }
    return Py_BuildValue("NN", square, linear);
}
