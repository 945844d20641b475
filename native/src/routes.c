/* The cheapest route through layers of neighbours: planning/paths/dynamic_programming.py. */
#include "arrays.h"

#include <math.h>
#include <string.h>

/* layers of `width` places each, one more than there are steps; rates[joint][step][from][to] */
typedef struct {
    const double *steps, *rates, *closed;
    double price;
    npy_intp layers, width, joints;
    double *value, *next, *before, *after, *most; /* (width, width) twice, (joints, width) twice, (width,) */
    npy_intp *sources;                            /* (layers - 2, width, width) the place before each pair of places */
} Layers;

/* The rates of all steps to a place, or from it: those of one joint after those of another. */
static void rates_at(const Layers *s, npy_intp step, npy_intp place, int from, double *to)
{
    const npy_intp square = s->width * s->width;
    for (npy_intp joint = 0; joint < s->joints; joint++) {
        const double *rates = s->rates + (joint * (s->layers - 1) + step) * square;
        for (npy_intp other = 0; other < s->width; other++)
            to[joint * s->width + other] = from ? rates[place * s->width + other] : rates[other * s->width + place];
    }
}

/* The largest change among the joints from the rates of each step to a place to those of the step on to `next`. */
static void largest_changes(const Layers *s, npy_intp next, double *most)
{
    memset(most, 0, s->width * sizeof(double));
    for (npy_intp joint = 0; joint < s->joints; joint++) {
        const double after = s->after[joint * s->width + next], *before = s->before + joint * s->width;
        for (npy_intp i = 0; i < s->width; i++) {
            const double change = fabs(after - before[i]);
            most[i] = change > most[i] ? change : most[i];
        }
    }
}

/* Bellman's recursion over pairs of neighbouring layers: the least cost of each last pair is left in `value`. */
static void find_costs(Layers *s)
{
    const npy_intp width = s->width, square = width * width;
    for (npy_intp i = 0; i < width; i++)
        for (npy_intp j = 0; j < width; j++)
            s->value[i * width + j] = s->closed[i] + s->steps[i * width + j] + s->closed[width + j];
    for (npy_intp k = 0; k + 2 < s->layers; k++) {
        const double *steps = s->steps + (k + 1) * square, *closed = s->closed + (k + 2) * width;
        for (npy_intp j = 0; j < width; j++) {
            rates_at(s, k, j, 0, s->before), rates_at(s, k + 1, j, 1, s->after);
            for (npy_intp c = 0; c < width; c++) {
                double least = INFINITY;
                npy_intp source = 0;
                largest_changes(s, c, s->most);
                for (npy_intp i = 0; i < width; i++) {
                    const double cost = s->value[i * width + j] + s->most[i] * s->price;
                    if (cost < least)
                        least = cost, source = i;
                }
                s->next[j * width + c] = least + steps[j * width + c] + closed[c];
                s->sources[k * square + j * width + c] = source;
            }
        }
        memcpy(s->value, s->next, square * sizeof(double));
    }
}

PyObject *cheapest_with_turns(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Layers s;
    npy_intp steps[3], rates[4], closed[2];
    if (count_is(count, 4, "cheapest_with_turns") < 0 || !(s.steps = block(args[0], "steps", 3, steps)) ||
        !(s.rates = block(args[1], "rates", 4, rates)) || !(s.closed = block(args[2], "closed", 2, closed)) ||
        as_double(args[3], "price", &s.price) < 0)
        return NULL;
    s.layers = closed[0], s.width = closed[1], s.joints = rates[0];
    if (has_length(steps[0], s.layers - 1, "steps") < 0 || has_length(steps[1], s.width, "steps") < 0 ||
        has_length(steps[2], s.width, "steps") < 0 || has_length(rates[1], s.layers - 1, "rates") < 0 ||
        has_length(rates[2], s.width, "rates") < 0 || has_length(rates[3], s.width, "rates") < 0)
        return NULL;
    if (s.layers < 2 || s.width < 1) {
        PyErr_SetString(PyExc_ValueError, "closed: has fewer than two layers, or no places");
        return NULL;
    }
    const npy_intp square = s.width * s.width;
    Room costs, places;
    s.value = room_for(&costs, (2 * square + (2 * s.joints + 1) * s.width) * sizeof(double));
    if (!s.value)
        return NULL;
    s.sources = room_for(&places, ((s.layers - 2) * square + 1) * sizeof(npy_intp));
    npy_intp *chosen;
    PyObject *result = s.sources ? new_ind(s.layers, &chosen) : NULL;
    if (result) {
        s.next = s.value + square, s.before = s.next + square, s.after = s.before + s.width * s.joints;
        s.most = s.after + s.width * s.joints;
        find_costs(&s);
        npy_intp best = 0;
        for (npy_intp pair = 1; pair < square; pair++)
            if (s.value[pair] < s.value[best])
                best = pair;
        chosen[s.layers - 1] = best % s.width, chosen[s.layers - 2] = best / s.width;
        for (npy_intp k = s.layers - 3; k >= 0; k--)
            chosen[k] = s.sources[k * square + chosen[k + 1] * s.width + chosen[k + 2]];
    }
    release(&costs);
    if (s.sources)
        release(&places);
    return result;
}
