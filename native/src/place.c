/* Where a convex shape is nearest to a surface, as Python gets it. */
#include "place.h"

int as_shape(PyObject *hull, PyObject *radius, Hull *shape, double *more)
{
    npy_intp lengths[2];
    if (!(shape->points = block(hull, "hull", 2, lengths)) || has_length(lengths[1], 3, "hull") < 0 ||
        as_double(radius, "radius", more) < 0)
        return -1;
    shape->count = lengths[0];
    return 0;
}

void vectors_of(const Place *found, double radius, const double *base, double *to)
{
    for (int c = 0; c < 3; c++) {
        to[c] = found->normal[c];
        to[3 + c] = found->on_shape[c] + radius * found->normal[c] + base[c];
        to[6 + c] = found->on_other[c] + base[c];
    }
}

PyObject *answer_of_place(int nearer, const Place *found, double radius, const double *base)
{
    if (nearer == 0)
        Py_RETURN_NONE;
    if (nearer < 0 || !(found->distance > radius))
        return PyTuple_New(0);
    double *to;
    PyObject *reading = new_vec(10, &to);
    if (!reading)
        return NULL;
    to[0] = found->distance - radius;
    vectors_of(found, radius, base, to + 1);
    return Py_BuildValue("(N)", reading);
}
