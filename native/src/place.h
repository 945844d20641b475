/* Where a convex shape is nearest to a surface, as Python gets it. */
#ifndef BACKHOE_PLACE
#define BACKHOE_PLACE
#include "arrays.h"
#include "distance.h"

typedef struct {
    double distance, normal[3], on_shape[3], on_other[3];
} Place;

/* the hull of a shape and its radius, see `nearest_on_ground`; 0, or -1 with an exception */
int as_shape(PyObject *hull, PyObject *radius, Hull *shape, double *more);
/* The normal, and the two nearest points, of a shape within `radius` of the hull that was compared, from `base`. */
void vectors_of(const Place *found, double radius, const double *base, double *to);
/* None where nothing is `nearer` (0), () where that is not decided (-1) or they touch, else (10,) in a tuple. */
PyObject *answer_of_place(int nearer, const Place *found, double radius, const double *base);

#endif
